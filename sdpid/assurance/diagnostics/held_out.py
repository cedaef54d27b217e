"""Judge an estimate on what it was not trained on, beside what costs less than it.

Held out is another recording where there is one, else blocks of the training recording in turn.
The estimate stands beside three others that are trained on the same rows: the robot's description
as it is, the description with friction fitted, and least squares.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.tables import Table, plain_dict
from sdpid.assurance.diagnostics.bands import Folds, held_out_blocks, predicted_by
from sdpid.assurance.diagnostics.described import described_friction
from sdpid.assurance.diagnostics.validation import Validation, validate
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.information import least_squares
from sdpid.estimation.problem import Problem
from sdpid.estimation.wls import solve_wls
from sdpid.experiment.processing.samples import Samples

DESCRIPTION = "description as it is"
FRICTION_FITTED = "description, friction fitted"
LEAST_SQUARES = "least squares"
OURS = "this estimate"

# Another motion makes errors differ by some 20 % either way: beyond, a baseline is better.
BEATEN = 1.2


@dataclass(frozen=True, kw_only=True, eq=False)
class HeldOut:
    """Predictions of what was not trained on.

    Attributes
    ----------
    by : {"recording", "blocks"}
        What was held out: other recordings, or blocks of the training recording in turn.
    samples : Samples
        What was predicted.
    fit : Validation
        The estimate's errors; of blocks those of the fits to the other rows.
    baselines : dict of str to Errors
        Errors of `DESCRIPTION` and `FRICTION_FITTED`, where the description has masses, and of
        `LEAST_SQUARES`.
    blocks : int
        Number of blocks, 0 where other recordings were held out.
    """

    by: Literal["recording", "blocks"]
    samples: Samples
    fit: Validation
    baselines: dict[str, Validation]
    blocks: int = 0

    @property
    def every(self) -> dict[str, Validation]:
        """The baselines, then the estimate, by name."""
        return {**self.baselines, OURS: self.fit}

    @property
    def beaten_by(self) -> str | None:
        """What costs less and predicts clearly better in motion; None where nothing does."""
        own = self.fit.moving
        errors = {n: fit.moving.relative for n, fit in self.baselines.items() if n != DESCRIPTION}
        best = min(errors, key=lambda name: errors[name], default="")
        beaten = own.rows.any() and own.relative > BEATEN * errors.get(best, np.inf)
        return best if beaten else None

    def as_table(self) -> Table:
        """Return a row a model: relative residual in motion in %, RMSE in motion of each joint."""
        first, base = self.fit.n_base, self.fit.floating
        of_base = () if base is None else tuple(name for name, _ in base.rows)
        header = ("model", "relative residual, %", *self.fit.joint_names[first:], *of_base)
        rows = []
        for name, each in self.every.items():
            sizes = () if each.floating is None else (size for _, size in each.floating.rows)
            rows.append((name, 100.0 * each.moving.relative, *each.moving.rmse[first:], *sizes))
        return Table(header, tuple(rows))

    def table(self) -> str:
        """Return `as_table` as aligned text under a title."""
        where = "other recordings" if self.by == "recording" else f"{self.blocks} blocks"
        title = f"on {where}, held out, in motion: relative residual, RMSE of every joint in N.m"
        return f"{title}\n{self.as_table().text(3)}"

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return plain_dict({"by": self.by, "blocks": self.blocks or None, **self.every})


@dataclass(frozen=True, kw_only=True)
class Remedy:
    """What was tried where something that costs less predicts better, and what it gives.

    Attributes
    ----------
    cause : str
        What would be wrong, in words.
    option : str
        What was changed: an option of ``sdpid identify``.
    before, error : float
        Relative residual in motion on what was held out, without and with it.
    of : str
        Of which joints, in words; empty for all.
    """

    cause: str
    option: str
    before: float
    error: float
    of: str = ""

    @property
    def helps(self) -> bool:
        """Whether the error falls by more than another motion makes of it."""
        return self.before > BEATEN * self.error

    @property
    def words(self) -> str:
        """What was tried, and what it gives."""
        both = f"{100.0 * self.error:.3g} % in place of {100.0 * self.before:.3g} %"
        return f"{self.option}: {both}{self.of}{'' if self.helps else ', no remedy'}"


def hold_out(
    estimate: Estimate, wls: Estimate, fresh: Samples | None, fit: Validation | None = None
) -> HeldOut | None:
    """Predict other recordings, or blocks of the training recording in turn.

    Parameters
    ----------
    estimate : Estimate
        The constrained estimate.
    wls : Estimate
        The unconstrained fit to the same rows.
    fresh : Samples or None
        Other recordings.
    fit : Validation, optional
        The estimate's prediction of `fresh`, where it is known.

    Returns
    -------
    HeldOut or None
        None where there is no other recording and blocks cannot be held out (see
        `held_out_blocks`).
    """
    problem, robot = estimate.problem, estimate.problem.robot
    ways: dict[str, Callable[[Estimate], Array]] = {}
    if np.any(robot.prior[:, 0] > 0.0):
        ways = {
            DESCRIPTION: lambda each: problem.base_of(_described(problem)),
            FRICTION_FITTED: lambda each: problem.base_of(friction_fitted(each)),
        }
    if fresh is not None:
        folds = Folds((estimate,), np.zeros(fresh.n_samples, dtype=np.intp))
        samples, ways[LEAST_SQUARES] = fresh, lambda _: wls.base
    else:
        found, samples = held_out_blocks(problem), problem.samples
        if found is None:
            return None
        folds = found
        if not folds.inside.all():
            # Rows of recordings too short to be cut into blocks do not count.
            samples = replace(samples, mask=samples.used & folds.inside)
        ways[LEAST_SQUARES] = lambda each: solve_wls(replace(each.problem, prior=None)).base
        ways[OURS] = lambda each: each.base
    predicted = predicted_by(folds, problem, ways, fresh)
    if DESCRIPTION in predicted:
        predicted[DESCRIPTION] += described_friction(robot, samples)
    every = {
        name: Validation.of_prediction(robot, samples, effort) for name, effort in predicted.items()
    }
    if fresh is not None:
        fit = validate(estimate, fresh) if fit is None else fit
        return HeldOut(by="recording", samples=fresh, fit=fit, baselines=every)
    fit, count = every.pop(OURS), len(folds.estimates)
    return HeldOut(by="blocks", samples=samples, fit=fit, baselines=every, blocks=count)


def _described(problem: Problem) -> Array:
    """Return standard parameters (p,): the description's links, without friction."""
    theta = np.zeros(problem.n_theta)
    theta[: problem.robot.prior.size] = problem.robot.prior.ravel()
    return theta


def friction_fitted(estimate: Estimate) -> Array:
    """Return standard parameters (p,): the description's links, friction fitted to the rows."""
    theta, squared = _described(estimate.problem), estimate.problem.squared
    friction = slice(estimate.problem.robot.prior.size, None)
    # Beside the data's rows the prior's of the friction alone, where there is one: terms that the
    # data cannot tell apart are then held to their size.
    own = np.any(squared.matrix[:, friction] != 0.0, axis=1)
    rows, missing = squared.matrix[own], squared.rhs[own]
    theta[friction] = least_squares(rows[:, friction], missing - rows @ theta)
    return theta
