"""Instruments: where they come from, the estimate they make without constraints, their strength.

Columns are taken in coordinates in which the measured regressor's are orthonormal, so that sums of
products lose nothing to rounding, and directions that the data do not show are left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid.errors import DataError, IdentifiabilityError
from sdpid.estimation.closed_loop.loop import ClosedLoop, commanded, is_commanded, references
from sdpid.estimation.compression.factor import Factor, compressed
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.whitening import whitened_chunks
from sdpid.estimation.problem import Problem
from sdpid.experiment.preparation.prepare import ProcessingOf
from sdpid.experiment.preparation.twin import Twin
from sdpid.experiment.processing.process import process
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.simulation.controllers import Controller
from sdpid.robot.model.dynamics import RobotDynamics

Instruments = Literal["simulated", "reference", "periods"]

# Each half of the periods is at least one.
_FEWEST_PERIODS = 2

# A direction whose canonical correlation with the instruments is below this is not seen by them at
# all. Above, instruments may be weak, which is told parameter by parameter: raw accelerations of
# light wrists are noise by 99.9 %, and a prior or inequalities still hold such directions.
_UNSEEN = 1e-6

# Instruments are weak for a parameter whose F statistic of the first stage is below this
# [staiger1997]_: the estimate then leans towards least squares, and its errors are not normal.
WEAK = 10.0

# Where they are weak for more than this share, they are not of this motion.
_MOST_WEAK = 0.5

# A block of samples is at least this many time constants of the filter; samples closer than one
# are not independent.
_TIME_CONSTANTS = 20.0

# Lags are looked for up to this many seconds either way, and this part of a piece of the log: arms
# follow within a few tenths, and longer ones are no lag but another run.
_LONGEST, _PART = 1.0, 0.25

# The step of a piece with more samples than this is known.
_FEWEST_SAMPLES = 2

# A lag is one if it explains this part of what the two velocities differ by.
_EXPLAINED = 0.5


@dataclass(frozen=True)
class PairedRows(RowSource):
    """Rows ``[Z | W | y]``: the regressors of another and of the measured motion, and the efforts.

    Attributes
    ----------
    samples : Samples
        The measured motion and efforts.
    instruments : Samples
        The other motion, aligned row by row.
    """

    instruments: Samples

    def pieces(self) -> Iterator[PairedRows]:
        """Yield the rows of each piece of the samples."""
        for own, others in zip(self.samples.pieces, self.instruments.pieces, strict=True):
            yield replace(self, samples=own, instruments=others)

    def rows(self, part: slice) -> Array:
        """Return both regressors side by side, and the efforts, (k, n, 2 b + 1)."""
        Z = self.on(self.instruments).regressor(part)
        return np.concatenate([Z, super().rows(part)], axis=2)


@dataclass(frozen=True)
class InstrumentalRows(PairedRows):
    """The second stage of two-stage least squares, as rows of an ordinary problem.

    Let Z be the regressor of the instruments' motion, W that of the measured one, y the efforts,
    ``X = Z·L`` the projection of W on Z, and β the instrumental estimate,
    ``X^T·(y − W·β) = 0``. The rows are ``[X | X·(β − δ) + y − W·β]``. Their least-squares fit is β,
    their residual there is ``y − W·β``, and their scores are those of instruments and residuals:
    whatever computes costs, errors or proofs from rows does so of the instrumental estimate.

    Attributes
    ----------
    samples, instruments : Samples
        As of `PairedRows`.
    link : ndarray, shape (b, b)
        L.
    fit : ndarray, shape (b,)
        β.
    shift : ndarray, shape (b,)
        δ, which makes β the fit exactly where the equations above hold but nearly; else zero.
    """

    link: Array
    fit: Array
    shift: Array

    def rows(self, part: slice) -> Array:
        """Return X with the efforts of the second stage as last column; as `RowSource.rows`."""
        Z, W, y = np.split(super().rows(part), [self.base.count, -1], axis=2)
        X = Z @ self.link
        effort = y[:, :, 0] - W @ self.fit + X @ (self.fit - self.shift)
        return np.concatenate([X, effort[:, :, None]], axis=2)

    @property
    def hashed(self) -> tuple[Array, ...]:
        """What the rows are made of beside the samples, for their digest."""
        other = self.instruments
        motion = (other.position, other.velocity, other.acceleration)
        return (*motion, self.link, self.fit, self.shift)


def paired(problem: Problem, samples: Samples, instruments: Samples) -> PairedRows:
    """Return the rows of some samples beside another motion."""
    rows = problem.require_rows_here("instruments")
    return PairedRows(rows.robot, rows.friction, rows.base, samples, instruments)


def products(problem: Problem, pairs: Sequence[PairedRows]) -> Array:
    """Return the products of ``[Z·T | W·T | y]``, whitened, over all rows of pairs.

    Shape (2 r + 1, 2 r + 1), with T of `Excitation.root`.
    """
    root = problem.excitation.root
    found = [each for pair in pairs for each in pair.map(_products, root, sigma=problem.sigma)]
    return np.asarray(np.sum(found, axis=0))


def _products(rows: PairedRows, sigma: Array, root: Array) -> Array:
    """Return the products of one piece."""
    b, r = root.shape
    gram = np.zeros((2 * r + 1, 2 * r + 1))
    for _, both, _ in whitened_chunks(rows, sigma):
        parts = both[:, :, :b] @ root, both[:, :, b:-1] @ root, both[:, :, -1:]
        flat = np.concatenate(parts, axis=2).reshape(-1, 2 * r + 1)
        gram += flat.T @ flat
    return gram


class FirstStage:
    """The instrumental estimate in coordinates of the excitation, and how X follows from Z.

    The instruments are another motion, or each half of a record's periods is the other's. The sum
    of the halves' estimating equations is least squares of the mean motion less what their
    difference contributes to it; so X is then made of the mean motion.

    Parameters
    ----------
    problem : Problem
        Of the measured samples.
    pairs : sequence of PairedRows
        The rows of the estimating equations.

    Raises
    ------
    IdentifiabilityError
        When the instruments do not move with the measured motion.

    Attributes
    ----------
    problem, pairs
        As given.
    instruments : Samples
        Whose regressor X is made of.
    fit : ndarray, shape (r,)
        The estimate β.
    link : ndarray, shape (r, r)
        ``X = Z·link``.
    shift : ndarray, shape (r,)
        δ of `InstrumentalRows`.
    information : ndarray, shape (r, r)
        ``X^T·X``. That of the measured regressor is the identity.
    projection : ndarray, shape (r, r)
        The projection of the pairs' W on their Z is Z times it.
    least_squares : ndarray, shape (r,)
        The least-squares fit of the pairs' W, whose residuals a test starts from.
    """

    def __init__(self, problem: Problem, pairs: Sequence[PairedRows]) -> None:
        self.problem, self.pairs = problem, pairs
        gram = products(problem, pairs)
        r = len(gram) // 2
        z, w = slice(r), slice(r, 2 * r)
        cross = gram[z, w]
        self.projection = _solved(gram[z, z], cross)
        self.least_squares = _solved(gram[w, w], gram[w, -1])
        if len(pairs) == 1:
            self.link, self.instruments = self.projection, pairs[0].instruments
            self.information = cross.T @ self.link
            values = np.linalg.eigvalsh(0.5 * (self.information + self.information.T))
        else:
            self.link, self.instruments = 0.25 * (cross + cross.T), problem.samples
            self.information = self.link.T @ self.link
            values = np.linalg.eigvalsh(self.link)
            values = values * np.abs(values)
        # Squares of the canonical correlations.
        least, unseen = (
            float(values.min(initial=1.0)),
            int(np.count_nonzero(~(values > _UNSEEN**2))),
        )
        if unseen:
            raise IdentifiabilityError(
                f"instruments: {unseen} of {r} directions of the base parameters do not move with "
                f"the measured motion (correlation {max(least, 0.0) ** 0.5:.1e}, limit "
                f"{_UNSEEN:.0e}); check that the reference is that of this recording and the "
                "joints are in its order, or record a larger motion."
            )
        self.fit, self.shift = _solved(cross, gram[z, -1]), np.zeros(r)
        if len(pairs) > 1:
            plain = (problem.A @ problem.excitation.root).T @ problem.rhs
            self.shift = _solved(self.link, plain - self.fit)

    def second_stage(self, meaning: str) -> Problem:
        """Return the problem whose unconstrained fit is β; `meaning` says what its cost is."""
        found, source = self.problem.excitation, self.problem.require_rows_here("instruments")
        rows = InstrumentalRows(
            *(source.robot, source.friction, source.base, source.samples, self.instruments),
            link=frozen(found.root @ self.link @ found.inverse),
            fit=frozen(found.root @ self.fit),
            shift=frozen(found.root @ self.shift),
        )
        return of_rows(self.problem, rows, weighed(rows, self.problem.sigma), meaning)

    @cached_property
    def relevance(self) -> Array:
        """Shea's partial R² of each base parameter, (b,) [shea1997]_.

        The variance of least squares over that with instruments, were the errors alike; zero where
        the data show nothing.
        """
        root = self.problem.excitation.root
        own = np.einsum("ij,ij->i", root, root)
        other = np.einsum("ij,ji->i", root, _solved(self.information, root.T))
        seen = own > 0.0
        return frozen(np.where(seen, own / np.where(seen, np.maximum(other, own), 1.0), 0.0))

    @cached_property
    def statistics(self) -> Array:
        """F statistic of the first stage of each base parameter, (b,); infinite without a loss."""
        samples = self.problem.samples
        independent = samples.n_rows / max(1.0, samples.block / _TIME_CONSTANTS)
        freedom = max(independent - len(self.fit), 1.0)
        with np.errstate(divide="ignore"):
            return frozen(freedom * self.relevance / (1.0 - self.relevance))

    @property
    def weak(self) -> tuple[str, ...]:
        """Base parameters whose instruments are weak."""
        weak = (self.relevance > 0.0) & (self.statistics < WEAK)
        return tuple(n for n, own in zip(self.problem.base.names, weak, strict=True) if own)

    @cached_property
    def lag(self) -> float | None:
        """By how many seconds the measured motion comes later than the instruments'."""
        return lag_of(self.problem.samples, self.instruments)


def of_rows(problem: Problem, rows: RowSource, factor: Factor, meaning: str) -> Problem:
    """Return the problem of other rows under the same constraints and prior."""
    return replace(
        problem,
        sigma=frozen(factor.sigma),
        A=frozen(factor.A),
        rhs=frozen(factor.rhs),
        floor=factor.floor,
        n_rows=factor.used,
        rows=rows,
    ).with_origin(meaning=meaning)


def weighed(rows: RowSource, sigma: Array) -> Factor:
    """Weight and compress rows with a covariance."""
    triangle, used = compressed(rows, sigma)
    return Factor(sigma, *triangle.split(), used)


def _solved(matrix: Array, rhs: Array) -> Array:
    return np.asarray(np.linalg.solve(matrix, rhs))


def lag_of(measured: Samples, instruments: Samples) -> float | None:
    """Return by how many seconds the measured motion comes later than another, negative: earlier.

    Velocities are compared, all joints in units of their rms, so that sagging does not matter. None
    where no lag of at least one sample explains half of the difference.
    """
    time, pieces = measured.time, measured.parts
    long = [part for part in pieces if part.stop - part.start > _FEWEST_SAMPLES]
    if time is None or not long:
        return None
    step = max(float(np.median(np.diff(time[part]))) for part in long)
    most = int(min(_LONGEST / step, _PART * min(part.stop - part.start for part in pieces)))
    size = np.sqrt(np.mean(measured.velocity**2, axis=0))
    # A joint that does not move has nothing to compare.
    size = np.where(size > 0.0, size, np.inf)
    mine, other = measured.velocity / size, instruments.velocity / size
    left = np.array([_left(mine, other, pieces, shift) for shift in range(-most, most + 1)])
    best = int(np.argmin(left))
    if best == most or not left[best] < (1.0 - _EXPLAINED) * left[most]:
        return None
    shift = float(best - most)
    if 0 < best < len(left) - 1:
        # Where a parabola through the least value and its neighbors is least.
        before, here, after = left[best - 1 : best + 2]
        shift += float(0.5 * (before - after) / (before - 2.0 * here + after))
    return step * shift


def _left(mine: Array, other: Array, pieces: tuple[slice, ...], shift: int) -> float:
    """Return the mean square of ``mine(t + shift) − other(t)`` over all pieces."""
    early, late = max(-shift, 0), max(shift, 0)
    off = [
        mine[part.start + late : part.stop - early] - other[part.start + early : part.stop - late]
        for part in pieces
    ]
    return float(np.mean(np.concatenate(off) ** 2))


def _lag_words(lag: float) -> str:
    """Return a lag in words: 'the measured motion lags 40 ms behind it'."""
    how = ("the measured motion runs {} ahead of it", "the measured motion lags {} behind it")
    return how[lag > 0.0].format(f"{1e3 * abs(lag):.3g} ms")


@dataclass(frozen=True, eq=False)
class MotionSource:
    """Something that makes instruments for a problem.

    Attributes
    ----------
    problem : Problem
        The problem.
    words : str
        What the instruments are.
    pairs : sequence of PairedRows
        Measured rows and instruments; none where a model makes them.
    loop : ClosedLoop or None
        Where a model moves, whose motion is the instrument.
    """

    problem: Problem
    words: str
    pairs: Sequence[PairedRows] = ()
    loop: ClosedLoop | None = None

    def first_stage(self, model: RobotDynamics | None) -> FirstStage:
        """Return the estimate without constraints, with the instruments that a model gives.

        Any motion is a strong instrument for an offset, and so may another robot's be for gravity:
        instruments that are weak for most base parameters that the data show are refused.

        Raises
        ------
        DataError
            When the model diverges in its loop.
        IdentifiabilityError
            When the instruments do not move with the measured motion.
        """
        pairs = self.pairs
        if self.loop is not None:
            assert model is not None
            moved = self.loop.samples(self.loop.require(model, "the model", DataError))
            pairs = [paired(self.problem, self.problem.samples, moved)]
        first = FirstStage(self.problem, pairs)
        seen = int(np.count_nonzero(first.relevance > 0.0))
        if len(first.weak) <= _MOST_WEAK * seen:
            return first
        known = "" if first.lag is None else f"; {_lag_words(first.lag)}"
        raise IdentifiabilityError(
            f"instruments: {self.words} does not move with the measured motion: weak for "
            f"{len(first.weak)} of {seen} base parameters (F statistic of the first stage below "
            f"{WEAK:g}){known}. Check that the commanded positions are those of this recording, "
            "not late, and in its order of joints; a robot that lags behind its commands needs its "
            "own controller (controller=, one of sdpid.controllers or 'fit'). Where noise of the "
            "encoders drowns the motion, lower the cut-off."
        )

    def note(self, first: FirstStage) -> str | None:
        """Return that the measured motion comes at another time than it should, None if not.

        A robot comes later than what is commanded, but never earlier; and its model in the same
        loop moves when it does.
        """
        lag = first.lag
        if lag is None or (lag > 0.0 and self.loop is None):
            return None
        cause = "the commanded positions are not those of these times"
        if self.loop is not None:
            cause += ", or the controller is not that of this log"
        return f"{self.words}: {_lag_words(lag)}, so {cause}"


def source_of(
    problem: Problem,
    recording: Any,
    purpose: str,
    processing: ProcessingOf,
    reference: Any,
    controller: Controller | Literal["fit"] | None,
    instruments: Instruments | Samples | None,
) -> MotionSource:
    """Return where instruments for a problem come from.

    Parameters
    ----------
    problem : Problem
        The problem.
    recording : Recording or path, a sequence of these, or None
        What it was built of.
    purpose : str
        For messages.
    processing, reference, controller, instruments
        As for `solve_instrumental`.

    Raises
    ------
    DataError
        When there is nothing to take, or what is given does not belong to the problem.
    """
    samples = problem.samples
    if isinstance(instruments, Samples):
        shapes = instruments.position.shape, samples.position.shape
        if shapes[0] != shapes[1] or instruments.starts != samples.starts:
            raise DataError(
                f"instruments: {instruments!r} do not stand beside the problem's {samples!r}, row "
                "by row; process both alike (sdpid.Processing) and keep every sample."
            )
        return MotionSource(problem, "the motion given", [paired(problem, samples, instruments)])
    if instruments is not None and instruments not in get_args(Instruments):
        raise DataError(
            f"instruments: is {instruments!r:.80}; use one of 'simulated', 'reference' and "
            "'periods', or Samples of another motion."
        )
    if recording is None:
        raise DataError(
            f"{purpose}: needs the recording that the problem was built of, to know what was "
            "commanded or to split its periods; give it, or instruments=Samples(...)."
        )
    twin = commanded(Twin.of(problem.robot, recording, processing, measured=samples), reference)
    layout = twin.logs[0].period_layout
    repeats = layout is not None and layout[2] >= _FEWEST_PERIODS
    if instruments is None:
        # A robot may lag far behind what is commanded, but follows itself.
        instruments = "periods" if repeats or not is_commanded(twin) else "reference"
        if controller is not None and is_commanded(twin):
            instruments = "simulated"
    if instruments == "periods":
        if not repeats:
            raise DataError(
                f"{purpose}: the recording has neither commanded positions nor two periods, so "
                "nothing tells its motion from its noise; read the log with its columns of "
                "commanded positions (Recording.reference), give reference=, or record the motion "
                "twice."
            )
        halves = _halves(twin)
        pairs = [paired(problem, *halves), paired(problem, *halves[::-1])]
        return MotionSource(problem, "the motion in the other half of the periods", pairs)
    purpose = f"{purpose}: instruments={instruments!r}"
    told = references(twin, purpose)
    if instruments == "reference":
        pairs = [paired(problem, samples, twin.samples(told))]
        return MotionSource(problem, "the commanded motion", pairs)
    if controller is None:
        raise DataError(
            f"{purpose} needs the controller that followed the reference; give one of "
            "sdpid.controllers, or controller='fit', or take instruments='reference'."
        )
    loop = ClosedLoop(twin, controller, purpose=purpose, as_measured=False)
    fitted = ", its controller fitted" * (not isinstance(controller, Controller))
    return MotionSource(problem, f"the motion of the model in closed loop{fitted}", loop=loop)


def _halves(twin: Twin) -> list[Samples]:
    """Return the samples of the first and of the second half of a record's periods."""
    log, samples = twin.logs[0], twin.measured
    first, length, count = log.period_layout or (0, 0, 0)
    half = count // 2
    plain = replace(twin.processing, covariance=None)
    begin = log.stamps.first + first * log.step
    halves = []
    for start, periods in ((0, half), (half, count - half)):
        own = replace(log, start=begin + start * length * log.step, periods=periods)
        found = process(own, plain, progress=False)
        halves.append(
            replace(found, mask=samples.mask, block=samples.block, covariance=samples.covariance)
        )
    return halves
