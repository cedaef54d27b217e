"""Costs of iterations that weigh joints differently, under the same weights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.estimation.estimate import Step


@dataclass(frozen=True, eq=False)
class Trial:
    """What an iteration ended with.

    Attributes
    ----------
    seconds : float
        Since the iterations began.
    squares : ndarray, shape (n,), or None
        Sum of each joint's squared residuals, in its units; None where no variance changes.
    cost : float
        As the iteration saw it, with its own variances.
    variances : ndarray, shape (n,), or None
        These.
    violation : float
        Of the constraints.
    """

    seconds: float
    squares: Array | None
    cost: float
    variances: Array | None
    violation: float


def compared(trials: Sequence[Trial]) -> list[Step]:
    """Return the history of trials with all costs under the variances of the last one.

    Variances are estimated from the residuals of each iteration, so that its own cost is about the
    number of samples, whatever the residuals are.
    """
    last = trials[-1].variances if trials else None
    steps = []
    for trial in trials:
        cost = trial.cost
        if trial.squares is not None and trial.variances is not None and last is not None:
            cost += float(np.sum(trial.squares * (1.0 / last - 1.0 / trial.variances)))
        steps.append(Step(trial.seconds, cost, trial.violation))
    return steps
