"""What output error hands back."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any

from sdpid._common.arrays import Array
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.output_error.rows import MEANING
from sdpid.experiment.simulation.law import Controller


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class OutputErrorEstimate(Estimate):
    """An estimate whose simulated motion is the measured one.

    `problem` is the last linearized problem. It is what certificates, standard errors and
    intervals speak of: nothing says that no other parameters simulate better.

    Attributes
    ----------
    controller : Controller
        What closed the loop.
    position_error : ndarray, shape (n,)
        Root mean square of measured less simulated positions of each joint, filtered alike, rad
        (m).
    effort_ratio : ndarray, shape (n,)
        Measured efforts over those that the controller gives on the measured motion, by
        instruments. Far from one, the controller is another.
    effort_ratio_error : ndarray, shape (n,)
        Its standard error; infinite where a joint has no effort.
    simulations : int
        How often the recordings were simulated.

    Examples
    --------
    >>> law = sdpid.controllers.PD(np.full(6, 4000.0), np.full(6, 200.0))
    >>> found = sdpid.solve_output_error(problem, log, controller=law, reference=log.position)
    >>> found.status, found.simulations == found.iterations + 1
    ('optimal', True)
    >>> print(sdpid.certify(found).summary())
    of the last linearized problem, and no more: feasible with margin ...
    """

    controller: Controller
    position_error: Array = field(repr=False)
    effort_ratio: Array = field(repr=False)
    effort_ratio_error: Array = field(repr=False)
    simulations: int

    def __repr__(self) -> str:
        return f"{super().__repr__()[:-1]}, of {MEANING})"

    @classmethod
    def of(cls, found: Estimate, **more: Any) -> OutputErrorEstimate:
        """Take an estimate of the last linearized problem, with what `more` says of it."""
        names = [each.name for each in fields(Estimate)]
        return cls(**{**{name: getattr(found, name) for name in names}, **more})


def moved(estimate: Estimate, towards: Estimate, share: float) -> Estimate:
    """Return the parameters some way from one estimate to another; between two feasible ones.

    They belong to the problem of the second.
    """
    base = estimate.base + share * (towards.base - estimate.base)
    if towards.theta is None:
        return replace(towards, base=base, multipliers=None)
    theta = estimate.some_theta + share * (towards.theta - estimate.some_theta)
    return replace(towards, theta=theta, base=towards.problem.base_of(theta), multipliers=None)
