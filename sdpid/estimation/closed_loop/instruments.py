"""Instruments: where they come from, the estimate they make without constraints, their strength.

Columns are taken in coordinates in which the measured regressor's are orthonormal, so that sums of
products lose nothing to rounding, and directions that the data do not show are left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np

from sdpid._common.arrays import Array, Mask, frozen
from sdpid.errors import DataError, IdentifiabilityError
from sdpid.estimation.closed_loop.loop import ClosedLoop, commanded
from sdpid.estimation.compression.whitening import whiten
from sdpid.estimation.problem import Problem
from sdpid.experiment.preparation.several import ProcessingOf
from sdpid.experiment.preparation.twin import Twin
from sdpid.experiment.processing.process import process
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.simulation.law import Controller
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

# Measured samples, and those of a motion that is to be their instrument, row by row.
Pair = tuple[Samples, Samples]


def chunks(
    problem: Problem, pair: Pair, block: int = 1
) -> Iterator[tuple[Array, Array, Array, Mask]]:
    """Yield the rows of a pair in order, cut between blocks of samples.

    Returns
    -------
    instruments : ndarray, shape (k, n, b)
        Regressor of the instruments' motion.
    measured : ndarray, shape (k, n, b + 1)
        Regressor of the measured motion, efforts last.
    sigma : ndarray, shape (n, n) or (k, n, n)
        Effort covariance.
    mask : ndarray of bool, shape (k, n)
        Rows that are used.
    """
    source, sigma = problem.require_rows_here("instruments"), problem.sigma
    for piece, measured, other in zip(pair[0].parts, pair[0].pieces, pair[1].pieces, strict=True):
        own = sigma if sigma.ndim == 2 else sigma[piece]
        rows, others = source.on(measured), source.on(other)
        # Two regressors stand side by side.
        size = max(rows.chunk_size // (2 * block), 1) * block
        for part in rows.parts(size):
            here = own if own.ndim == 2 else own[part]
            yield others.regressor(part), rows.rows(part), here, rows.mask(part)


def products(problem: Problem, pairs: tuple[Pair, ...]) -> Array:
    """Return the products of ``[Z·T | W·T | y]``, whitened, over all rows of pairs.

    Shape (2 r + 1, 2 r + 1), with T of `Excitation.root`.
    """
    root = problem.excitation.root
    b, r = root.shape
    gram = np.zeros((2 * r + 1, 2 * r + 1))
    for pair in pairs:
        for instruments, measured, sigma, mask in chunks(problem, pair):
            both = whiten(np.concatenate([instruments, measured], axis=2), sigma, mask)
            parts = both[:, :, :b] @ root, both[:, :, b:-1] @ root, both[:, :, -1:]
            flat = np.concatenate(parts, axis=2).reshape(-1, 2 * r + 1)
            gram += flat.T @ flat
    return gram


@dataclass(frozen=True, kw_only=True, eq=False)
class FirstStage:
    """The instrumental estimate in coordinates of the excitation, and how X follows from Z.

    Attributes
    ----------
    problem : Problem
        Of the measured samples.
    pairs : tuple of Pair
        The rows of the estimating equations.
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

    problem: Problem
    pairs: tuple[Pair, ...]
    instruments: Samples
    fit: Array
    link: Array
    shift: Array
    information: Array
    projection: Array
    least_squares: Array

    @classmethod
    def of(cls, problem: Problem, pairs: tuple[Pair, ...]) -> FirstStage:
        """Take another motion as instrument, or each half of a record's periods as the other's.

        The sum of the halves' estimating equations is least squares of the mean motion less what
        their difference contributes to it; so X is then made of the mean motion.

        Raises
        ------
        IdentifiabilityError
            When the instruments do not move with the measured motion.
        """
        gram = products(problem, pairs)
        r = len(gram) // 2
        z, w = slice(r), slice(r, 2 * r)
        cross, target = gram[z, w], gram[z, -1]
        if len(pairs) == 1:
            link = _solved(gram[z, z], cross)
            information = cross.T @ link
            _require_seen(np.asarray(np.linalg.eigvalsh(0.5 * (information + information.T))))
            projection, fit = link, _solved(cross, target)
            instruments, shift = pairs[0][1], np.zeros(r)
        else:
            link = 0.25 * (cross + cross.T)
            values = np.asarray(np.linalg.eigvalsh(link))
            _require_seen(values * np.abs(values))
            information, projection = link.T @ link, _solved(gram[z, z], cross)
            fit = _solved(link, 0.5 * target)
            plain = (problem.A @ problem.excitation.root).T @ problem.rhs
            instruments, shift = problem.samples, _solved(link, plain - fit)
        return cls(
            problem=problem,
            pairs=pairs,
            instruments=instruments,
            fit=fit,
            link=link,
            shift=shift,
            information=information,
            projection=projection,
            least_squares=_solved(gram[w, w], gram[w, -1]),
        )

    def require_strong(self, words: str = "the motion given") -> None:
        """Raise where the instruments are weak for most base parameters that the data show.

        Any motion is a strong instrument for an offset, and so may another robot's be for gravity.

        Parameters
        ----------
        words : str, optional
            What the instruments are.

        Raises
        ------
        IdentifiabilityError
            With their number.
        """
        seen = int(np.count_nonzero(self.relevance > 0.0))
        if len(self.weak) <= _MOST_WEAK * seen:
            return
        known = "" if self.lag is None else f"; {lag_words(self.lag)}"
        raise IdentifiabilityError(
            f"instruments: {words} does not move with the measured motion: weak for "
            f"{len(self.weak)} of {seen} base parameters (F statistic of the first stage below "
            f"{WEAK:g}){known}. Check that the commanded positions are those of this recording, "
            "not late, and in its order of joints; a robot that lags behind its commands needs its "
            "own controller (controller=, one of sdpid.controllers or 'fit'). Where noise of the "
            "encoders drowns the motion, lower the cut-off."
        )

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
        lost = self.relevance < 1.0
        missed = np.where(lost, 1.0 - self.relevance, 1.0)
        return frozen(np.where(lost, freedom * self.relevance / missed, np.inf))

    @property
    def weak(self) -> tuple[str, ...]:
        """Base parameters whose instruments are weak."""
        weak = (self.relevance > 0.0) & (self.statistics < WEAK)
        return tuple(n for n, own in zip(self.problem.base.names, weak, strict=True) if own)

    @cached_property
    def lag(self) -> float | None:
        """By how many seconds the measured motion comes later than the instruments'."""
        return lag_of(self.problem.samples, self.instruments)


def _solved(matrix: Array, rhs: Array) -> Array:
    return np.asarray(np.linalg.solve(matrix, rhs))


def _require_seen(squares: Array) -> None:
    """Raise unless every direction of the measured regressor is seen by the instruments."""
    least = float(squares.min(initial=1.0))
    if least > _UNSEEN**2:
        return
    unseen = int(np.count_nonzero(squares <= _UNSEEN**2))
    raise IdentifiabilityError(
        f"instruments: {unseen} of {len(squares)} directions of the base parameters do not move "
        f"with the measured motion (correlation {max(least, 0.0) ** 0.5:.1e}, limit "
        f"{_UNSEEN:.0e}); check that the reference is that of this recording and the joints are in "
        "its order, or record a larger motion."
    )


def lag_of(measured: Samples, instruments: Samples) -> float | None:
    """Return by how many seconds the measured motion comes later than another, negative: earlier.

    Velocities are compared, all joints in units of their rms, so that sagging does not matter. None
    where no lag of at least one sample explains half of the difference.
    """
    time, pieces = measured.time, measured.parts
    lengths = [part.stop - part.start for part in pieces]
    if time is None or max(lengths) <= _FEWEST_SAMPLES:
        return None
    long = [part for part in pieces if part.stop - part.start > _FEWEST_SAMPLES]
    step = max(float(np.median(np.diff(time[part]))) for part in long)
    most = int(min(_LONGEST / step, _PART * min(lengths)))
    size = np.sqrt(np.mean(measured.velocity**2, axis=0))
    moved = size > 0.0
    mine, other = (each.velocity[:, moved] / size[moved] for each in (measured, instruments))
    left = np.array([_left(mine, other, pieces, shift) for shift in range(-most, most + 1)])
    best = int(np.argmin(left))
    if best == most or not left[best] < (1.0 - _EXPLAINED) * left[most]:
        return None
    shift = float(best - most)
    if 0 < best < len(left) - 1:
        # Where a parabola through the least value and its neighbors is least.
        before, here, after = left[best - 1 : best + 2]
        bend = before - 2.0 * here + after
        shift += float(0.5 * (before - after) / bend) if bend > 0.0 else 0.0
    return step * shift


def _left(mine: Array, other: Array, pieces: tuple[slice, ...], shift: int) -> float:
    """Return the mean square of ``mine(t + shift) − other(t)`` over all pieces."""
    early, late = max(-shift, 0), max(shift, 0)
    pairs = [(mine[part][late:], other[part][early:]) for part in pieces]
    off = np.concatenate([a[: len(b) - late] - b[: len(a) - early] for a, b in pairs])
    return float(np.mean(off**2))


def lag_words(lag: float) -> str:
    """Return a lag in words: 'the measured motion lags 40 ms behind it'."""
    how = ("the measured motion runs {} ahead of it", "the measured motion lags {} behind it")
    return how[lag > 0.0].format(f"{1e3 * abs(lag):.3g} ms")


@dataclass(frozen=True, kw_only=True, eq=False)
class Source:
    """Something that makes instruments for a problem.

    Attributes
    ----------
    words : str
        What the instruments are.
    pairs : tuple of Pair
        Measured samples and instruments; none where a model makes them.
    loop : ClosedLoop or None
        Where a model moves, whose motion is the instrument.
    """

    words: str
    pairs: tuple[Pair, ...] = ()
    loop: ClosedLoop | None = None

    def first_stage(self, problem: Problem, model: RobotDynamics | None) -> FirstStage:
        """Return the estimate without constraints, with the instruments that a model gives.

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
            motions = self.loop.require(model, "the model", DataError)
            pairs = ((problem.samples, self.loop.samples(motions)),)
        first = FirstStage.of(problem, pairs)
        first.require_strong(self.words)
        return first

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
        return f"{self.words}: {lag_words(lag)}, so {cause}"


def source_of(
    problem: Problem,
    recording: Any,
    purpose: str,
    processing: ProcessingOf,
    reference: Any,
    controller: Controller | Literal["fit"] | None,
    instruments: Instruments | Samples | None,
) -> Source:
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
        return Source(words="the motion given", pairs=((samples, instruments),))
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
    twin = Twin.of(problem.robot, recording, processing, measured=samples)
    told = commanded(twin, reference)
    if instruments is None:
        instruments = _strongest(twin.logs[0], told, controller)
    if instruments == "periods":
        words = "the motion in the other half of the periods"
        return Source(words=words, pairs=_halves(twin, purpose))
    purpose = f"{purpose}: instruments={instruments!r}"
    told = commanded(twin, told, purpose)
    assert told is not None
    if instruments == "reference":
        return Source(words="the commanded motion", pairs=((samples, twin.samples(told)),))
    if controller is None:
        raise DataError(
            f"{purpose} needs the controller that followed the reference; give one of "
            "sdpid.controllers, or controller='fit', or take instruments='reference'."
        )
    loop = ClosedLoop.of(twin, controller, told, purpose=purpose, as_measured=False)
    fitted = ", its controller fitted" * (not isinstance(controller, Controller))
    return Source(words=f"the motion of the model in closed loop{fitted}", loop=loop)


def _strongest(log: Recording, told: tuple[Array, ...] | None, controller: object) -> Instruments:
    """Return the instruments that are strongest, of those that there are."""
    if told is not None and controller is not None:
        return "simulated"
    layout = log.period_layout
    repeats = layout is not None and layout[2] >= _FEWEST_PERIODS
    # A robot may lag far behind what is commanded, but follows itself.
    return "periods" if told is None or repeats else "reference"


def _halves(twin: Twin, purpose: str) -> tuple[Pair, ...]:
    """Return either half of a record's periods, as the other's instrument."""
    log, samples = twin.logs[0], twin.measured
    layout = log.period_layout
    if layout is None or layout[2] < _FEWEST_PERIODS:
        raise DataError(
            f"{purpose}: the recording has neither commanded positions nor two periods, so "
            "nothing tells its motion from its noise; read the log with its columns of commanded "
            "positions (Recording.reference), give reference=, or record the motion twice."
        )
    first, length, count = layout
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
    return (halves[0], halves[1]), (halves[1], halves[0])
