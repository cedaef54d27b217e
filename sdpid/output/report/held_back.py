"""Name what holds back joints that least squares predicts much better on held-out data."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from sdpid._common.kept import kept
from sdpid.assurance.diagnostics.causes import held_back
from sdpid.assurance.diagnostics.cost_of_constraints import cost_of_constraints
from sdpid.assurance.diagnostics.held_out import LEAST_SQUARES
from sdpid.errors import SdpidError
from sdpid.output.report.cause_words import NEGLIGIBLE
from sdpid.output.report.finding import Finding, listed
from sdpid.output.report.judged import Judged

# Constraints are named that add this share of the training error that least squares leaves.
_ADDS = 0.01


@dataclass(frozen=True)
class Held:
    """A joint that is held back.

    Attributes
    ----------
    joint : str
        The joint.
    rmse, free : float
        Errors in motion on what was held out, of the estimate and of least squares, N·m or N.
    constraints : tuple of str
        Constraints that add error at the joint on the training data, the largest share first;
        empty where none does, and the prior holds it.
    """

    joint: str
    rmse: float
    free: float
    constraints: tuple[str, ...]

    @property
    def words(self) -> str:
        """What holds it, with the numbers."""
        return (
            f"held-out error {self.rmse:.3g}, of least squares {self.free:.3g} in the joint's "
            f"unit: held by {listed(self.by)}"
        )

    @property
    def by(self) -> tuple[str, ...]:
        """What holds it."""
        return self.constraints or ("the prior",)

    @property
    def step(self) -> str:
        """What to do about it."""
        end = (
            "or leave these constraints out (cost_of_constraints tells what each costs)"
            if self.constraints
            else "or weaken the prior (--no-prior leaves it out)"
        )
        return (
            f"find why {self.joint} does not agree with {listed(self.by)}: check the sign "
            f"and the unit of its effort, its zero, its links in the description and its "
            f"friction terms, {end}"
        )


@kept
def held_of(result: Judged) -> dict[str, Held]:
    """Return the joints that are held back, by name; none where nothing was held out."""
    return {each.joint: each for each in _held(result)}


def _held(result: Judged) -> Iterator[Held]:
    if result.held_out is None:
        return
    fit, free = result.held_out.fit, result.held_out.baselines[LEAST_SQUARES]
    names = [
        name
        for name in held_back(fit, free)
        if fit.moving.nrmse[fit.joint_names.index(name)] >= NEGLIGIBLE
    ]
    if not names:
        return
    try:
        cost = cost_of_constraints(result.estimate)
    except SdpidError:  # no standard parameters, or no optimum; a verdict must not cost the run
        return
    for name in names:
        j = fit.joint_names.index(name)
        adds = cost.increase[:, j]
        order = [k for k in adds.argsort()[::-1] if adds[k] > _ADDS * cost.rmse_free[j]]
        yield Held(
            joint=name,
            rmse=float(fit.moving.rmse[j]),
            free=float(free.moving.rmse[j]),
            constraints=tuple(cost.constraints[k] for k in order),
        )


def held_back_findings(result: Judged) -> Iterator[Finding]:
    """Yield the joints that are held back, and by what."""
    for each in held_of(result).values():
        yield Finding("caution", f"{each.joint} is held back: {each.words}. Next: {each.step}.")
