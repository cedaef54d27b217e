"""Choose friction over position and the delay forward: fit the slower part, judge the faster."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.estimation.positions.drives import LONGEST_DELAY, Drives
from sdpid.estimation.positions.fit import PositionFit, conditional, fit_positions
from sdpid.estimation.positions.rollout import Commands, Rollout, Stiction
from sdpid.robot.model.dynamics import RobotDynamics

# Kinds of numbers that are tried, each with what is kept of those before it.
CONSTANTS = ("armature", "damping", "friction")
LADDER: tuple[tuple[str, ...], ...] = (
    CONSTANTS,
    (*CONSTANTS, "slope"),
    (*CONSTANTS, "slope", "curve"),
)

# A richer friction must lower the error on the faster part by this share.
_WORTH = 0.02

# Seconds after which a controlled joint has forgotten how it started.
_FORGOTTEN = 0.3

# The part of a log that is judged, the length (s) that each part needs, and how much the error on
# it may rise above the least for a delay to stay possible.
_JUDGED, _LEAST_PART, _OPEN = 0.35, 1.5, 0.05


@dataclass(frozen=True, kw_only=True, eq=False)
class Choice:
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
    """

    rows: tuple[str, ...]
    errors: dict[tuple[str, ...], float]
    delay: float
    open: tuple[float, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class Followed:
    """A log of positions and what its drives were told, for rollouts over parts of it.

    Attributes
    ----------
    time : ndarray, shape (N,)
        Time stamps, s.
    position : ndarray, shape (N, n)
        Measured positions, rad (m).
    told : Commands
        Commands, added efforts and limits.
    step : float
        Length of a step of the rollouts, s.
    stiction : Stiction
        How dry friction holds.
    """

    time: Array
    position: Array
    told: Commands
    step: float
    stiction: Stiction

    def rollout(self, links: RobotDynamics, part: slice = slice(None)) -> Rollout:
        """Return a rollout over rows of the log."""
        told = self.told._replace(
            command=self.told.command[part], feedforward=self.told.feedforward[part]
        )
        return Rollout(
            links,
            self.time[part],
            self.position[part],
            told,
            step=self.step,
            stiction=self.stiction,
        )

    def split(self) -> tuple[list[slice], slice]:
        """Return the slower rows, in one or two pieces, and the faster ones.

        Raises
        ------
        DataError
            When the log is too short to be judged by a part of it.
        """
        N, rate = len(self.time), (len(self.time) - 1) / (self.time[-1] - self.time[0])
        width, least = int(_JUDGED * N), int(_LEAST_PART * rate)
        if width < least:
            raise DataError(
                f"fit of positions: the log has {self.time[-1] - self.time[0]:.3g} s; friction and "
                f"delay are chosen on a part of it, which needs {_LEAST_PART / _JUDGED:.2g} s."
            )
        speed = np.sum(np.diff(self.position, axis=0) ** 2, axis=1)
        total = np.concatenate([[0.0], np.cumsum(speed)])
        first = int(np.argmax(total[width:] - total[:-width]))
        pieces = [slice(0, first), slice(first + width, N)]
        kept = [each for each in pieces if each.stop - each.start >= least]
        return kept, slice(first, first + width)


def choose_forward(
    log: Followed, links: RobotDynamics, drives: Drives, *, delay: float | None = None
) -> tuple[Choice, PositionFit]:
    """Choose kinds of friction and a delay; return them with the fit of the slower part.

    Parameters
    ----------
    log : Followed
        The log.
    links : RobotDynamics
        The robot and the inertia of its links.
    drives : Drives
        Where to begin.
    delay : float, optional
        The delay, s; by default it is looked for.
    """
    slow, fast = log.split()
    training, judge = [log.rollout(links, part) for part in slow], log.rollout(links, fast)
    start = drives if delay is None else replace(drives, delay=delay)
    errors: dict[tuple[str, ...], float] = {}
    best: PositionFit | None = None
    for rows in LADDER:
        fit = fit_positions(training, start, rows, delay=delay is None)
        start = fit.drives
        errors[rows] = judged(judge, fit.drives)
        if best is None or errors[rows] < (1.0 - _WORTH) * errors[best.unknowns.rows]:
            best = fit
    assert best is not None
    if delay is not None:
        choice = Choice(rows=best.unknowns.rows, errors=errors, delay=delay, open=(delay, delay))
        return choice, best
    tried = {d: judged(judge, conditional(best, d)) for d in np.linspace(0.0, LONGEST_DELAY, 11)}
    least = min(tried, key=lambda d: tried[d])
    possible = [d for d, e in tried.items() if e <= (1.0 + _OPEN) * tried[least]]
    width = LONGEST_DELAY / 10.0
    found = minimize_scalar(
        lambda d: judged(judge, conditional(best, d)),
        bounds=(max(least - width, 0.0), min(least + width, LONGEST_DELAY)),
        method="bounded",
        options={"xatol": 1e-4, "maxiter": 8},
    )
    return Choice(
        rows=best.unknowns.rows,
        errors=errors,
        delay=float(found.x) if found.fun < tried[least] else float(least),
        open=(float(min(possible)), float(max(possible))),
    ), best


def judged(rollout: Rollout, drives: Drives) -> float:
    """Return the error (rad, rms) of given drives on a rollout, after its start is forgotten."""
    motion = rollout.run(drives, rollout.start())
    missed = (rollout.measured - rollout.positions(motion))[rollout.after(_FORGOTTEN) :]
    return float(np.sqrt(np.mean(missed**2))) if motion.converged else np.inf
