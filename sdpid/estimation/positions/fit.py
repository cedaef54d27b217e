"""Gauss-Newton fit of the drives to positions of rollouts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid.errors import SolverError
from sdpid.estimation.positions.drives import DriveNumbers, Unknowns
from sdpid.estimation.positions.rollout import STEP, LawRollout, SolvedMotion

# Rounds of Gauss-Newton, and the relative fall of the cost that a round must promise.
_ROUNDS, FALL = 40, 1e-5

# Damping of the first round, relative to a diagonal of ones; beyond the last no step helps.
_DAMPING, _MOST_DAMPING = 1e-3, 1e4

# Numbers whose unit moves all positions together by less (rad², m²) are not seen, and stay.
UNSEEN = 1e-8

# Added to the unit diagonal of the normal equations: numbers that the log does not show stay.
_RIDGE = 1e-9

# Blocks of rows whose scores count as independent: at least this many, and none shorter (s) than
# residuals of controlled joints stay alike.
_BLOCKS, _LEAST_BLOCK = 10, 0.3


@dataclass(frozen=True, eq=False)
class SolvedRollouts:
    """Motions of rollouts for some numbers, and what they miss of the positions.

    Attributes
    ----------
    rollouts : sequence of LawRollout
        Stretches of logs of one robot.
    drives : DriveNumbers
        The numbers.
    starts : sequence of ndarray, shape (2, n)
        Position and velocity at the start of every motion.
    motions : list of SolvedMotion
        The motions.
    missed : list of ndarray, shape (N, n)
        Measured less solved positions, rad (m).
    cost : float
        Sum of squared errors of position, rad² (m²); infinite where a motion was not solved.
    """

    rollouts: Sequence[LawRollout]
    drives: DriveNumbers
    starts: Sequence[Array]
    motions: list[SolvedMotion]
    missed: list[Array]
    cost: float

    @classmethod
    @np.errstate(over="ignore")
    def of(
        cls,
        rollouts: Sequence[LawRollout],
        drives: DriveNumbers,
        starts: Sequence[Array] | None = None,
        near: SolvedRollouts | None = None,
    ) -> SolvedRollouts:
        """Solve the motions, from those of numbers nearby where there are any.

        They start as given, or as the first samples say.
        """
        starts = [each.start() for each in rollouts] if starts is None else starts
        guesses: list[Array | None] = [None] * len(rollouts)
        if near is not None and np.isfinite(near.cost):
            guesses = [each.position for each in near.motions]
        motions = [
            each.run(drives, start, guess)
            for each, start, guess in zip(rollouts, starts, guesses, strict=True)
        ]
        missed = [r.measured - r.positions(m) for r, m in zip(rollouts, motions, strict=True)]
        cost = float(sum(np.sum(each**2) for each in missed))
        solved = all(each.converged for each in motions) and np.isfinite(cost)
        return cls(rollouts, drives, starts, motions, missed, cost if solved else np.inf)

    @property
    def size(self) -> int:
        """How many positions there are."""
        return sum(each.size for each in self.missed)

    @property
    def rms(self) -> float:
        """Root of the mean squared error of position, rad (m)."""
        return float(np.sqrt(self.cost / self.size))

    @property
    def correlation(self) -> float:
        """Correlation of residuals one row apart: of encoder noise alone it is 0."""
        products = sum(float(np.sum(e[1:] * e[:-1])) for e in self.missed)
        return products / max(self.cost, np.finfo(float).tiny)


@dataclass(frozen=True, kw_only=True, eq=False)
class PositionFit(SolvedRollouts):
    """The best drives and starts that were found.

    Attributes
    ----------
    unknowns : Unknowns
        What was free.
    information : ndarray, shape (k, k)
        Gauss-Newton's matrix of the cost, half of its second derivative.
    gradient : ndarray, shape (k,)
        Minus half of the derivative of the cost.
    scores : ndarray, shape (blocks, k)
        Parts of the gradient.
    within : ndarray of bool, shape (k,)
        Unknowns that are at no bound.
    """

    unknowns: Unknowns
    information: Array
    gradient: Array
    scores: Array
    within: Mask

    @property
    def covariance(self) -> Array:
        """Covariance of the unknowns, from blocks of residuals; zero for those at a bound."""
        found, at = np.zeros_like(self.information), np.ix_(self.within, self.within)
        spread = scaled_inverse(self.information[at]) @ self.scores[:, self.within].T
        blocks = len(self.scores)
        found[at] = spread @ spread.T * blocks / max(blocks - 1, 1)
        return found


def fit_positions(
    begin: SolvedRollouts,
    rows: Sequence[str],
    *,
    delay: bool = True,
    held: bool = False,
    fall: float = FALL,
) -> PositionFit:
    """Fit kinds of numbers, the delay and the starts to the positions of rollouts.

    Parameters
    ----------
    begin : SolvedRollouts
        Where to begin, and the values of what is not free.
    rows : sequence of str
        Kinds of numbers that are free.
    delay : bool
        Whether the delay is.
    held : bool
        Whether the delay stays where it is, though it counts as unknown.
    fall : float
        The relative fall of the cost that a round must promise.

    Raises
    ------
    SolverError
        When the robot cannot follow from the numbers given.
    """
    drives, n = begin.drives, len(begin.drives.middle)
    unknowns = Unknowns(rows=tuple(rows), delay=delay, motions=len(begin.rollouts), n=n)
    low, high = unknowns.bounds()
    if held:
        low[len(rows) * n] = high[len(rows) * n] = drives.delay

    def solved(x: Array, near: SolvedRollouts) -> SolvedRollouts:
        return SolvedRollouts.of(begin.rollouts, *unknowns.unpack(x, drives), near)

    given = unknowns.pack(drives, begin.starts)
    x = np.clip(given, low, high)
    state = begin if np.array_equal(x, given) else solved(x, begin)
    if not np.isfinite(state.cost):
        raise SolverError(
            "fit of positions: the robot does not follow its commands under this law and these "
            "links; check the gains' units (N.m/rad, N.m.s/rad) and signs, and that the commands "
            "are those of this log, in rad."
        )
    what = unknowns.rows, delay, unknowns.count, unknowns.at
    H, g, scores = normal_equations(state, *what)
    damping = _DAMPING
    for _ in range(_ROUNDS):
        step = _bounded_step(H, g, damping, low - x, high - x)
        expected = float(step @ (2.0 * g - H @ step))
        if expected < fall * state.cost:
            break
        there = np.clip(x + step, low, high)
        trial = solved(there, state)
        if not trial.cost < state.cost:
            damping *= 10.0
            if damping > _MOST_DAMPING:
                break
            continue
        gained = state.cost - trial.cost
        damping *= 0.1 if gained > 0.5 * expected else 0.5
        x, state = there, trial
        H, g, scores = normal_equations(state, *what)
    return PositionFit(
        **{each.name: getattr(state, each.name) for each in fields(SolvedRollouts)},
        unknowns=unknowns,
        information=H,
        gradient=g,
        scores=scores,
        within=(x > low) & (x < high),
    )


def conditional(fit: PositionFit, delay: float) -> tuple[DriveNumbers, float]:
    """Return the best drives for another delay and their error, by a fit's quadratic model."""
    unknowns, names = fit.unknowns, fit.unknowns.names
    x = unknowns.pack(fit.drives, fit.starts)
    low, high = unknowns.bounds()
    k = names.index("delay")
    low[k] = high[k] = delay
    step = _bounded_step(fit.information, fit.gradient, 0.0, low - x, high - x)
    found = np.clip(x + step, low, high)
    step = found - x
    cost = fit.cost - float(step @ (2.0 * fit.gradient - fit.information @ step))
    error = fit.rms * float(np.sqrt(max(cost, 0.0) / fit.cost))
    return unknowns.unpack(found, fit.drives)[0], error


def normal_equations(
    solved: SolvedRollouts,
    rows: Sequence[str],
    delay: bool,
    count: int,
    at: Callable[[int, Indices], Indices],
    regressor: Callable[[SolvedMotion], Array] | None = None,
) -> tuple[Array, Array, Array]:
    """Return JᵀJ, Jᵀe, and the sums of Jᵀe over blocks of rows, (blocks, count).

    `at` says which numbers the columns of a motion's joints are by. With a regressor these are
    those of links, too; else as in `LawRollout.columns`.
    """
    H, scores = np.zeros((count, count)), []
    for k, (rollout, motion) in enumerate(zip(solved.rollouts, solved.motions, strict=True)):
        starts, e = _block_starts(rollout), solved.missed[k]
        score = np.zeros((len(starts), count))
        Y = None if regressor is None else regressor(motion)
        for joints, J in rollout.columns(motion, solved.drives, rows, delay, Y):
            where = at(k, joints)
            flat = J.reshape(-1, len(where))
            H[np.ix_(where, where)] += flat.T @ flat
            moved = np.einsum("tik,ti->tk", J, e[:, joints])
            score[:, where] += np.add.reduceat(moved, starts, axis=0)
        scores.append(score)
    every_score = np.concatenate(scores)
    return H, every_score.sum(axis=0), every_score


def scaled_inverse(H: Array) -> Array:
    """Return the inverse of normal equations; numbers that are not seen stay."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(H), 1e-12 * max(float(np.diag(H).max()), 1e-300)))
    inverse = np.linalg.pinv(H * scale * scale[:, None], hermitian=True)
    return np.asarray(inverse * scale * scale[:, None])


def _block_starts(rollout: LawRollout) -> Indices:
    """Return the first rows of blocks that count as independent."""
    rows = len(rollout.measured)
    count = max(_BLOCKS, int(rollout.count * STEP / _LEAST_BLOCK))
    return np.unique(np.linspace(0, rows, min(count, rows), endpoint=False).astype(np.intp))


def _bounded_step(H: Array, g: Array, damping: float, low: Array, high: Array) -> Array:
    """Minimize the damped quadratic model within bounds."""
    from scipy.optimize import lsq_linear

    scale = 1.0 / np.sqrt(np.maximum(np.diag(H), UNSEEN))
    ridge = max(damping, _RIDGE)
    L = np.linalg.cholesky(H * scale * scale[:, None] + ridge * np.eye(len(g)))
    wanted = np.linalg.solve(L, g * scale)
    # Solvers want room between the bounds.
    limits = (low / scale - 1e-12, high / scale + 1e-12)
    return np.asarray(scale * lsq_linear(L.T, wanted, bounds=limits).x)
