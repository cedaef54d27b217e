"""Gauss-Newton fit of the drives to positions of rollouts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid.errors import SolverError
from sdpid.estimation.positions.drives import DriveNumbers, Unknowns
from sdpid.estimation.positions.rollout import LawRollout, SolvedMotion

# Rounds of Gauss-Newton, and the relative fall of the cost that a round must promise.
_ROUNDS, FALL = 40, 1e-5

# Damping of the first round, relative to a diagonal of ones; beyond the last no step helps.
_DAMPING, _MOST_DAMPING = 1e-3, 1e4

# Numbers whose unit moves all positions together by less (rad², m²) are not seen, and stay.
_UNSEEN = 1e-8

# Added to the unit diagonal of the normal equations: numbers that the log does not show stay.
_RIDGE = 1e-9

# Blocks of rows whose scores count as independent: at least this many, and none shorter (s) than
# residuals of controlled joints stay alike.
_BLOCKS, _LEAST_BLOCK = 10, 0.3


@dataclass(frozen=True, kw_only=True, eq=False)
class PositionFit:
    """Drives fitted to positions.

    Attributes
    ----------
    drives : DriveNumbers
        The best numbers found.
    starts : tuple of ndarray, shape (2, n)
        Position and velocity at the start of every motion.
    unknowns : Unknowns
        What was free.
    cost : float
        Sum of squared errors of position, rad² (m²).
    rms : float
        Root of their mean, rad (m).
    information : ndarray, shape (k, k)
        Gauss-Newton's matrix of the cost, half of its second derivative.
    gradient : ndarray, shape (k,)
        Minus half of the derivative of the cost.
    covariance : ndarray, shape (k, k)
        Of the unknowns, from blocks of residuals; rows of numbers at a bound are zero.
    correlation : float
        Of residuals one row apart: of encoder noise alone it is 0.
    """

    drives: DriveNumbers
    starts: tuple[Array, ...]
    unknowns: Unknowns
    cost: float
    rms: float
    information: Array
    gradient: Array
    covariance: Array
    correlation: float


def fit_positions(
    rollouts: Sequence[LawRollout],
    drives: DriveNumbers,
    rows: Sequence[str],
    *,
    delay: bool = True,
    starts: Sequence[Array] | None = None,
    held: bool = False,
    fall: float = FALL,
) -> PositionFit:
    """Fit kinds of numbers, the delay and the starts to the positions of rollouts.

    Parameters
    ----------
    rollouts : sequence of LawRollout
        Stretches of logs of one robot.
    drives : DriveNumbers
        Where to begin, and the values of what is not free.
    rows : sequence of str
        Kinds of numbers that are free.
    delay : bool
        Whether the delay is.
    starts : sequence of ndarray, shape (2, n), optional
        Where the motions begin; by default as the first samples say.
    held : bool
        Whether the delay stays where it is, though it counts as unknown.
    fall : float
        The relative fall of the cost that a round must promise.

    Raises
    ------
    SolverError
        When the robot cannot follow from the numbers given.
    """
    n = len(drives.middle)
    unknowns = Unknowns(rows=tuple(rows), delay=delay, motions=len(rollouts), n=n)
    low, high = unknowns.bounds()
    if held:
        low[len(rows) * n] = high[len(rows) * n] = drives.delay
    first = [each.start() for each in rollouts] if starts is None else list(starts)
    x = np.clip(unknowns.pack(drives, first), low, high)
    state = _State.of(rollouts, *unknowns.unpack(x, drives), None)
    if not np.isfinite(state.cost):
        raise SolverError(
            "fit of positions: the robot does not follow its commands under this law and these "
            "links; check the gains' units (N.m/rad, N.m.s/rad) and signs, and that the commands "
            "are those of this log, in rad."
        )
    H, g, scores = state.normal(rollouts, unknowns)
    damping = _DAMPING
    for _ in range(_ROUNDS):
        step = _bounded_step(H, g, damping, low - x, high - x)
        expected = float(step @ (2.0 * g - H @ step))
        if expected < fall * state.cost:
            break
        there = np.clip(x + step, low, high)
        trial = _State.of(rollouts, *unknowns.unpack(there, drives), state)
        if not trial.cost < state.cost:
            damping *= 10.0
            if damping > _MOST_DAMPING:
                break
            continue
        gained = state.cost - trial.cost
        damping *= 0.1 if gained > 0.5 * expected else 0.5
        x, state = there, trial
        H, g, scores = state.normal(rollouts, unknowns)
    within = (x > low) & (x < high)
    found, begins = unknowns.unpack(x, drives)
    size = sum(each.measured.size for each in rollouts)
    return PositionFit(
        drives=found,
        starts=tuple(begins),
        unknowns=unknowns,
        cost=state.cost,
        rms=float(np.sqrt(state.cost / size)),
        information=H,
        gradient=g,
        covariance=_sandwich(H, scores, within),
        correlation=_correlation(state.missed),
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


@dataclass(frozen=True, eq=False)
class _State:
    """Motions of all rollouts for some numbers, and what they miss."""

    drives: DriveNumbers
    motions: list[SolvedMotion]
    missed: list[Array]
    cost: float

    @classmethod
    def of(
        cls,
        rollouts: Sequence[LawRollout],
        drives: DriveNumbers,
        starts: Sequence[Array],
        near: _State | None,
    ) -> _State:
        """Solve the motions, from those of a state nearby."""
        guesses = [None] * len(rollouts) if near is None else [m.position for m in near.motions]
        motions = [
            each.run(drives, start, guess)
            for each, start, guess in zip(rollouts, starts, guesses, strict=True)
        ]
        missed = [r.measured - r.positions(m) for r, m in zip(rollouts, motions, strict=True)]
        cost = float(sum(np.sum(each**2) for each in missed))
        solved = all(each.converged for each in motions) and np.isfinite(cost)
        return cls(drives, motions, missed, cost if solved else np.inf)

    def normal(
        self, rollouts: Sequence[LawRollout], unknowns: Unknowns
    ) -> tuple[Array, Array, Array]:
        """Return JᵀJ, Jᵀe, and the sums of Jᵀe over blocks of rows, (blocks, count)."""
        count, n = unknowns.count, unknowns.n
        H, g, scores = np.zeros((count, count)), np.zeros(count), []
        joint, size = unknowns.joint(), len(unknowns.names)
        for k, (each, motion, e) in enumerate(
            zip(rollouts, self.motions, self.missed, strict=True)
        ):
            begins = np.arange(count) >= size
            own = ~begins
            own[size + 2 * n * k : size + 2 * n * (k + 1)] = True
            starts = block_starts(each)
            score = np.zeros((len(starts), count))
            blocks = each.columns(motion, self.drives, unknowns.rows, unknowns.delay)
            for joints, J in blocks:
                at = np.flatnonzero(own & (np.isin(joint, joints) | (joint < 0)))
                flat = J.reshape(-1, J.shape[2])
                H[np.ix_(at, at)] += flat.T @ flat
                moved = np.einsum("tik,ti->tk", J, e[:, joints])
                score[:, at] += np.add.reduceat(moved, starts, axis=0)
            g += score.sum(axis=0)
            scores.append(score)
        return H, g, np.concatenate(scores)


def block_starts(rollout: LawRollout) -> Indices:
    """Return the first rows of blocks that count as independent."""
    rows = len(rollout.measured)
    count = max(_BLOCKS, int(rollout.count * rollout.step / _LEAST_BLOCK))
    return np.unique(np.linspace(0, rows, min(count, rows), endpoint=False).astype(np.intp))


def _correlation(missed: Sequence[Array]) -> float:
    """Return the correlation of residuals one row apart."""
    products = sum(float(np.sum(e[1:] * e[:-1])) for e in missed)
    return products / max(sum(float(np.sum(e**2)) for e in missed), np.finfo(float).tiny)


def _bounded_step(H: Array, g: Array, damping: float, low: Array, high: Array) -> Array:
    """Minimize the damped quadratic model within bounds."""
    from scipy.optimize import lsq_linear

    scale = 1.0 / np.sqrt(np.maximum(np.diag(H), _UNSEEN))
    ridge = max(damping, _RIDGE)
    L = np.linalg.cholesky(H * scale * scale[:, None] + ridge * np.eye(len(g)))
    wanted = np.linalg.solve(L, g * scale)
    # Solvers want room between the bounds.
    limits = (low / scale - 1e-12, high / scale + 1e-12)
    return np.asarray(scale * lsq_linear(L.T, wanted, bounds=limits).x)


def _sandwich(H: Array, scores: Array, within: Mask) -> Array:
    """Return the covariance of the unknowns from the scores of blocks; zero where not within."""
    found, at = np.zeros_like(H), np.ix_(within, within)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(H)[within], _UNSEEN))
    inverse = (
        np.linalg.pinv(H[at] * scale * scale[:, None], hermitian=True) * scale * scale[:, None]
    )
    spread = inverse @ scores[:, within].T
    blocks = len(scores)
    found[at] = spread @ spread.T * blocks / max(blocks - 1, 1)
    return found
