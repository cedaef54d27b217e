"""From instruments to a problem: two-stage least squares under the same constraints and prior."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid.errors import DataError, IdentifiabilityError
from sdpid.estimation.compression.triangle import Triangle
from sdpid.estimation.compression.whitening import compress
from sdpid.estimation.information import require_excitation
from sdpid.estimation.instrumental.lag import lag_of, lag_words
from sdpid.estimation.instrumental.moments import Columns, Moments, Pair
from sdpid.estimation.instrumental.rows import InstrumentalRows
from sdpid.estimation.problem import Problem
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.model.contacts.open_chain import require_fixed_robot

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


@dataclass(frozen=True, kw_only=True, eq=False)
class SecondStage:
    """A problem of instruments, and how strong they are.

    Attributes
    ----------
    problem : Problem
        The second stage: its unconstrained fit is the instrumental estimate.
    relevance : ndarray, shape (b,)
        Shea's partial R² of each base parameter [shea1997]_: the variance of least squares over
        that with instruments, were the errors alike. Zero where the data show nothing.
    first_stage : ndarray, shape (b,)
        F statistic of the first stage, from it; infinite where instruments lose nothing.
    """

    problem: Problem
    relevance: Array
    first_stage: Array
    weak: tuple[str, ...]


def require_instrumentable(problem: Problem, purpose: str) -> None:
    """Raise when a problem cannot have instruments.

    Raises
    ------
    ModelError
        When the robot has a floating base.
    DataError
        When its rows were not kept or are elsewhere, or it is not plain.
    """
    problem.require_plain(purpose)
    rows = problem.require_rows_here(purpose)
    require_fixed_robot(problem.robot, purpose)
    if rows.samples.contacts is not None:
        raise DataError(
            f"{purpose}: contacts tie the rows of a sample together, and instruments are made for "
            "single rows; use solve_sdp."
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class FirstStage:
    """The instrumental estimate in the coordinates of `Columns`, and how X follows from Z.

    Attributes
    ----------
    columns : Columns
        The coordinates.
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
    pairs : tuple of Pair
        The rows of the estimating equations.
    projection : ndarray, shape (r, r)
        The projection of the pairs' W on their Z is Z times it.
    least_squares : ndarray, shape (r,)
        The least-squares fit of the pairs' W, whose residuals a test starts from.
    """

    columns: Columns
    instruments: Samples
    fit: Array
    link: Array
    shift: Array
    information: Array
    pairs: tuple[Pair, ...]
    projection: Array
    least_squares: Array

    @classmethod
    def of_motion(cls, columns: Columns, instruments: Samples) -> FirstStage:
        """Take another motion as instrument.

        Raises
        ------
        IdentifiabilityError
            When it does not move with the measured one.
        """
        pair = Pair(measured=columns.rows.samples, instruments=instruments)
        moments = Moments.of(columns, (pair,))
        link = _solved(moments.instruments, moments.cross)
        information = moments.cross.T @ link
        _require_seen(columns, np.asarray(np.linalg.eigvalsh(0.5 * (information + information.T))))
        fit = _solved(moments.cross, moments.target)
        return cls(
            columns=columns,
            instruments=instruments,
            fit=fit,
            link=link,
            shift=np.zeros_like(fit),
            information=information,
            pairs=(pair,),
            projection=link,
            least_squares=_solved(moments.measured, moments.plain),
        )

    @classmethod
    def of_halves(cls, columns: Columns, first: Samples, second: Samples) -> FirstStage:
        """Take each half of a record's periods as the other's instrument.

        The sum of both estimating equations is least squares of the mean motion less what the
        halves' difference contributes to it; so X is made of the mean motion.

        Raises
        ------
        IdentifiabilityError
            When the halves do not move alike.
        """
        pairs = Pair(measured=first, instruments=second), Pair(measured=second, instruments=first)
        moments = Moments.of(columns, pairs)
        link = 0.25 * (moments.cross + moments.cross.T)
        values = np.asarray(np.linalg.eigvalsh(link))
        _require_seen(columns, values * np.abs(values))
        fit = _solved(link, 0.5 * moments.target)
        A, rhs = columns.problem.A, columns.problem.rhs
        plain = (A @ columns.root).T @ rhs
        return cls(
            columns=columns,
            instruments=columns.rows.samples,
            fit=fit,
            link=link,
            shift=_solved(link, plain - fit),
            information=link.T @ link,
            pairs=pairs,
            projection=_solved(moments.instruments, moments.cross),
            least_squares=_solved(moments.measured, moments.plain),
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

    def second(self, words: str) -> SecondStage:
        """Return the problem of the second stage; `words` say what its cost is."""
        columns = self.columns
        problem, root, inverse = columns.problem, columns.root, columns.inverse
        rows = InstrumentalRows(
            robot=columns.rows.robot,
            friction=columns.rows.friction,
            base=columns.rows.base,
            samples=columns.rows.samples,
            instruments=self.instruments,
            link=frozen(root @ self.link @ inverse),
            fit=frozen(root @ self.fit),
            shift=frozen(root @ self.shift),
        )
        triangle = Triangle(problem.base.count + 1)
        for piece, _ in rows.map(compress, sigma=problem.sigma):
            triangle.merge(piece)
        A, rhs, floor = triangle.split()
        found = replace(problem, A=frozen(A), rhs=frozen(rhs), floor=floor, rows=rows)
        found = found.with_origin(meaning=words)
        if problem.prior is None:
            require_excitation(found.excitation)
        return SecondStage(
            problem=found,
            relevance=frozen(self.relevance),
            first_stage=frozen(self.statistics),
            weak=self.weak,
        )

    @cached_property
    def relevance(self) -> Array:
        """Shea's partial R² of each base parameter, (b,)."""
        root = self.columns.root
        own = np.einsum("ij,ij->i", root, root)
        other = np.einsum("ij,ji->i", root, _solved(self.information, root.T))
        seen = own > 0.0
        return np.where(seen, own / np.where(seen, np.maximum(other, own), 1.0), 0.0)

    @cached_property
    def statistics(self) -> Array:
        """F statistic of the first stage of each base parameter, (b,)."""
        samples = self.columns.rows.samples
        independent = samples.n_rows / max(1.0, samples.block / _TIME_CONSTANTS)
        freedom = max(independent - len(self.fit), 1.0)
        lost = self.relevance < 1.0
        missed = np.where(lost, 1.0 - self.relevance, 1.0)
        return np.where(lost, freedom * self.relevance / missed, np.inf)

    @cached_property
    def lag(self) -> float | None:
        """By how many seconds the measured motion comes later than the instruments'; see `lag`."""
        return lag_of(self.columns.rows.samples, self.instruments)

    @property
    def weak(self) -> tuple[str, ...]:
        """Base parameters whose instruments are weak."""
        weak = (self.relevance > 0.0) & (self.statistics < WEAK)
        names = self.columns.problem.base.names
        return tuple(name for name, own in zip(names, weak, strict=True) if own)


def _require_seen(columns: Columns, squares: Array) -> None:
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


def _solved(matrix: Array, rhs: Array) -> Array:
    return np.asarray(np.linalg.solve(matrix, rhs))
