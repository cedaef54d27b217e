"""Bounds and conditions that an estimate must satisfy."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sdpid._common.tables import Settings
from sdpid.errors import DataError, InfeasibleError
from sdpid.estimation.constraints.condition import Condition
from sdpid.robot.model.model import RobotModel

# Descriptions are wrong, but not by more than this factor.
_TIMES = 3.0


@dataclass(frozen=True, kw_only=True, repr=False)
class Constraints(Settings):
    """Bounds on the links and the friction terms.

    Attributes
    ----------
    margin : float
        How far inside the consistent set every link must lie, kg·m² (see
        `sdpid.robot.inertia.margin`).
    mass_min, mass_max : float
        Bounds on every link's mass, kg. A positive lower bound keeps the center of mass defined;
        a finite upper bound makes the optimum attained.
    theta_max : float
        Bound on the size of every parameter of a link, in its unit. It is part of the problem so
        that a lower bound on the cost covers everything that is feasible.
    friction_max : float or None
        Likewise of every parameter of friction and drives. By default `build_problem` takes ten
        times what makes the efforts of the data alone, rounded up to a power of ten, and at least
        `theta_max`: the size of a robot says nothing about its friction.
    friction_nonnegative : bool
        Whether terms that cannot be negative (Coulomb, viscous, rotor) are bounded by zero.
    others : tuple of Condition
        Further conditions, such as a total mass (see `sdpid.estimation.constraints.mass`). A
        single one may be given as it is.

    Examples
    --------
    >>> limits = sdpid.Constraints(margin=1e-4, mass_max=40.0)
    >>> found = sdpid.solve_sdp(problem.constrained(constraints=limits))
    >>> bool(found.worst_margin >= 1e-4)
    True

    The bounds that `identify` takes by default, and the mass of the whole robot:

    >>> total = sdpid.constraints.TotalMass(40.0, tolerance=0.5)
    >>> limits = sdpid.Constraints.of_size(robot, others=(total,))
    """

    margin: float = 0.0
    mass_min: float = 1e-3
    mass_max: float = 100.0
    theta_max: float = 1e4
    friction_max: float | None = None
    friction_nonnegative: bool = True
    others: tuple[Condition, ...] = ()

    def __post_init__(self) -> None:
        for name in ("margin", "mass_min", "mass_max", "theta_max", "friction_max"):
            value = getattr(self, name)
            if value is not None and not np.isfinite(value):
                raise DataError(f"Constraints: {name} is {value}; give a finite number.")
        if self.margin < 0.0:
            raise DataError(f"Constraints: margin is {self.margin} kg.m2, the least is 0.")
        if not self.mass_min > 0.0:
            raise DataError(
                f"Constraints: mass_min is {self.mass_min} kg; it must be positive, or the center "
                "of mass is not defined."
            )
        if self.mass_min > self.mass_max:
            raise InfeasibleError(
                f"Constraints: mass_min {self.mass_min} kg is above mass_max {self.mass_max} kg."
            )
        others: object = self.others
        if not isinstance(others, Iterable) or isinstance(others, str):
            others = (others,)
        object.__setattr__(self, "others", tuple(others))
        for other in self.others:
            if not isinstance(other, Condition):
                raise DataError(f"Constraints: {other!r} among the others is not a Condition.")
        if self.friction_max is not None and not self.friction_max > 0.0:
            raise DataError(
                f"Constraints: friction_max is {self.friction_max}; give a positive number, or "
                "None for one that follows the efforts."
            )
        if self.theta_max < self.mass_max:
            raise DataError(
                f"Constraints: theta_max {self.theta_max} is below mass_max {self.mass_max} kg; "
                "raise theta_max or lower mass_max."
            )

    @classmethod
    def of_size(cls, robot: RobotModel, **changes: Any) -> Constraints:
        """Return constraints whose widest bounds follow the size of a described robot.

        No link is heavier than three times all links together in the description, and no mass lies
        farther from its joint than three times the way from the base to the farthest joint.
        Tighter bounds make stronger proofs: where the data are weak, what they leave open is only
        limited by them. Where no link has a mass the defaults stay.

        Parameters
        ----------
        robot : RobotModel
            The robot.
        **changes
            Attributes to set, which go before.
        """
        total = float(np.sum(np.maximum(robot.prior[:, 0], 0.0)))
        if total > 0.0:
            mass = changes.get("mass_max", _TIMES * total)
            reach = max(_TIMES * robot.reach, 1.0)
            changes = {"mass_max": mass, "theta_max": mass * reach**2, **changes}
        return cls(**changes)

    def replace(self, **changes: Any) -> Constraints:
        """Return a copy with some bounds changed."""
        return replace(self, **changes)
