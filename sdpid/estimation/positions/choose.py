"""Choose friction over position and the delay forward: fit the slower part, judge the faster."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sdpid.errors import DataError
from sdpid.estimation.positions.drives import LONGEST_DELAY, DriveNumbers
from sdpid.estimation.positions.fit import (
    PositionFit,
    SolvedRollouts,
    conditional,
    fit_positions,
)
from sdpid.estimation.positions.rollout import CommandedLog
from sdpid.robot.model.dynamics import RobotDynamics

# Kinds of numbers that are free, and those that are tried beside them, one after the other.
CONSTANTS = ("armature", "damping", "friction")
RICHER = ("slope", "curve")

# A richer friction must lower the error on the faster part by this share.
_WORTH = 0.02

# Seconds after which a controlled joint has forgotten how it started.
_FORGOTTEN = 0.3

# The part of a log that is judged, the length (s) that each part needs, and how much the error on
# it may rise above the least for a delay to stay possible.
_JUDGED, _LEAST_PART, _OPEN = 0.35, 1.5, 0.05


# Residuals one row apart that correlate by less are those of encoders: the model is complete. Then
# a richer friction is there that lowers the sum of squares by so many variances a number.
WHITE, _SHOWN = 0.3, 6.0

# Fits that are compared end where a round promises this relative fall of the cost.
ROUGH = 1e-4

# The least square between delays that were tried, as a share of the least that was found there.
_DEEPEST = 0.25

# Delays that are judged, and between which their errors are interpolated.
_TRIED, _FINE = 9, 401


@dataclass(frozen=True, kw_only=True, eq=False)
class ForwardChoice:
    """What was found by the slower and judged by the faster part.

    Attributes
    ----------
    rows : tuple of str
        Kinds of numbers that are free.
    errors : dict
        Error on the faster part (rad, rms) by kinds tried.
    delay : float
        Delay (s) of the least error there.
    open : tuple of 2 float
        Delays whose error is not much larger.
    fitted : float
        Delay (s) that fits the slower part best.
    correlation : float
        Of residuals of the slower part one row apart; near 0 where nothing is missing.
    """

    rows: tuple[str, ...]
    errors: dict[tuple[str, ...], float]
    delay: float
    open: tuple[float, float]
    fitted: float
    correlation: float


def split(log: CommandedLog) -> tuple[list[slice], slice]:
    """Return the slower rows, in one or two pieces, and the faster ones.

    Raises
    ------
    DataError
        When the log is too short to be judged by a part of it.
    """
    N, duration = len(log.time), log.time[-1] - log.time[0]
    width, least = int(_JUDGED * N), int(_LEAST_PART * ((N - 1) / duration))
    if width < least:
        raise DataError(
            f"fit of positions: the log has {duration:.3g} s; friction and delay are chosen on a "
            f"part of it, which needs {_LEAST_PART / _JUDGED:.2g} s."
        )
    speed = np.sum(np.diff(log.position, axis=0) ** 2, axis=1)
    total = np.concatenate([[0.0], np.cumsum(speed)])
    first = int(np.argmax(total[width:] - total[:-width]))
    pieces = [slice(0, first), slice(first + width, N)]
    kept = [each for each in pieces if each.stop - each.start >= least]
    return kept, slice(first, first + width)


def choose_forward(
    logs: Sequence[CommandedLog],
    links: RobotDynamics,
    drives: DriveNumbers,
    *,
    rows: Sequence[str] = CONSTANTS,
    delay: float | None = None,
) -> tuple[ForwardChoice, PositionFit]:
    """Choose kinds of friction and a delay; return them with the fit of the slower part.

    Parameters
    ----------
    logs : sequence of CommandedLog
        The logs.
    links : RobotDynamics
        The robot and the inertia of its links.
    drives : DriveNumbers
        Where to begin.
    rows : sequence of str
        Kinds of numbers that are free whatever the data say.
    delay : float, optional
        The delay, s; by default it is looked for.
    """
    from scipy.interpolate import PchipInterpolator

    parts = [split(each) for each in logs]
    training = [
        log.rollout(links, x) for log, (slow, _) in zip(logs, parts, strict=True) for x in slow
    ]
    judges = [log.rollout(links, fast) for log, (_, fast) in zip(logs, parts, strict=True)]
    errors: dict[tuple[str, ...], float] = {}
    start = drives if delay is None else replace(drives, delay=delay)
    how: dict[str, Any] = {"delay": delay is None, "fall": ROUGH}
    fit = best = fit_positions(SolvedRollouts.of(training, start), rows, **how)
    judge = SolvedRollouts.of(judges, fit.drives)
    errors[fit.unknowns.rows] = judged(judge)
    for k in range(1, len(RICHER) + 1):
        kinds = (*rows, *RICHER[:k])
        fit = fit_positions(fit, kinds, **how)
        errors[kinds] = judged(SolvedRollouts.of(judges, fit.drives, near=judge))
        better = errors[kinds] < (1.0 - _WORTH) * errors[best.unknowns.rows]
        # Where encoders' noise is all that is left, a share of it says little.
        numbers = fit.unknowns.count - best.unknowns.count
        shown = best.cost - fit.cost > _SHOWN * numbers * fit.cost / fit.size
        if better or (shown and fit.correlation < WHITE):
            best = fit
    found: dict[str, Any] = {
        "rows": best.unknowns.rows,
        "errors": errors,
        "fitted": best.drives.delay,
        "correlation": best.correlation,
    }
    grid = np.linspace(0.0, LONGEST_DELAY, _TRIED if delay is None else 0)
    solved = (SolvedRollouts.of(judges, conditional(best, d)[0], near=judge) for d in grid)
    squares = np.array([judged(each) for each in solved]) ** 2
    follows = np.isfinite(squares)
    if not follows.any():
        # No delay was tried, or no motion follows at another one: that of the fit is kept.
        at = best.drives.delay
        return ForwardChoice(delay=at, open=(at, at), **found), best
    # A few delays that no motion follows are as bad as the worst.
    squares = np.where(follows, squares, squares[follows].max())
    k = int(np.clip(np.argmin(squares), 1, _TRIED - 2))
    bend = np.polynomial.Polynomial.fit(grid[k - 1 : k + 2], squares[k - 1 : k + 2], 2).convert()
    chosen = float(grid[np.argmin(squares)])
    if bend.coef[-1] > 0.0:
        chosen = float(np.clip(bend.deriv().roots()[0], grid[k - 1], grid[k + 1]))
    fine = np.sort([*np.linspace(0.0, LONGEST_DELAY, _FINE), chosen])
    smooth = PchipInterpolator(grid, squares)(fine)
    near = (fine >= grid[k - 1]) & (fine <= grid[k + 1])
    # A parabola through three points of a steep valley may fall below any error.
    smooth[near] = np.maximum(bend(fine[near]), _DEEPEST * squares.min())
    possible = fine[smooth <= (1.0 + _OPEN) ** 2 * smooth.min()]
    return ForwardChoice(
        delay=chosen, open=(float(possible[0]), float(possible[-1])), **found
    ), best


def judged(solved: SolvedRollouts) -> float:
    """Return the error (rad, rms) of rollouts after their start is forgotten."""
    if not np.isfinite(solved.cost):
        return np.inf
    pairs = zip(solved.rollouts, solved.missed, strict=True)
    late = [missed[each.after(_FORGOTTEN) :] for each, missed in pairs]
    return float(np.sqrt(np.mean(np.concatenate(late) ** 2)))
