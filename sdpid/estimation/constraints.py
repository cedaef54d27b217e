"""What an estimate must satisfy, as linear and matrix inequalities in theta."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sdpid._arrays import Array, Mask
from sdpid.errors import DataError, InfeasibleError
from sdpid.robot.inertia import Consistency, margin, margin_shift, matrix_basis


@dataclass(frozen=True, kw_only=True)
class Constraints:
    """Bounds on the links and the friction terms.

    Attributes
    ----------
    margin : float
        How far inside the consistent set every link must lie, kg·m² (see
        `sdpid.robot.inertia.margin`).
    mass_min, mass_max : float
        Bounds on every link's mass, kg. A positive lower bound keeps the centre of mass defined;
        a finite upper bound makes the optimum attained.
    theta_max : float
        Bound on the size of every standard parameter, in its unit. It is part of the problem so
        that a lower bound on the cost covers everything that is feasible.
    friction_nonnegative : bool
        Whether terms that physics says are not negative (Coulomb, viscous, rotor) are bound so.
    """

    margin: float = 0.0
    mass_min: float = 1e-3
    mass_max: float = 100.0
    theta_max: float = 1e4
    friction_nonnegative: bool = True

    def __post_init__(self) -> None:
        for name in ("margin", "mass_min", "mass_max", "theta_max"):
            value = getattr(self, name)
            if not np.isfinite(value):
                raise DataError(f"Constraints: {name} is {value}; give a finite number.")
        if self.margin < 0.0:
            raise DataError(f"Constraints: margin is {self.margin} kg.m2, the least is 0.")
        if not self.mass_min > 0.0:
            raise DataError(
                f"Constraints: mass_min is {self.mass_min} kg; it must be positive, or the centre "
                "of mass is not defined."
            )
        if self.mass_min > self.mass_max:
            raise InfeasibleError(
                f"Constraints: mass_min {self.mass_min} kg is above mass_max {self.mass_max} kg."
            )
        if self.theta_max < self.mass_max:
            raise DataError(
                f"Constraints: theta_max {self.theta_max} is below mass_max {self.mass_max} kg; "
                "raise theta_max or lower mass_max."
            )

    def replace(self, **changes: float | bool) -> Constraints:
        """Return a copy with some bounds changed."""
        return replace(self, **changes)  # type: ignore[arg-type]


@dataclass(frozen=True, kw_only=True, eq=False)
class FeasibleSet:
    """The constraints of one problem, as ``F0 + Σ theta_k·F_k`` ⪰ 0 a link, and bounds.

    Attributes
    ----------
    consistency : {"pseudo_inertia", "spatial_inertia", "none"}
        Which matrix inequality each link obeys.
    constraints : Constraints
        The numbers.
    n_links : int
        Links; their parameters are the first 10·links entries of theta.
    lower, upper : ndarray, shape (p,)
        Bounds on theta.
    """

    consistency: Consistency
    constraints: Constraints
    n_links: int
    lower: Array
    upper: Array

    @classmethod
    def build(
        cls,
        constraints: Constraints,
        consistency: Consistency,
        n_links: int,
        nonnegative: np.ndarray,
    ) -> FeasibleSet:
        """Build for a robot whose friction parameters are `nonnegative` or free."""
        upper = np.full(10 * n_links + len(nonnegative), constraints.theta_max)
        lower = -upper
        if consistency != "none":
            lower[: 10 * n_links : 10] = constraints.mass_min
            upper[: 10 * n_links : 10] = constraints.mass_max
        if constraints.friction_nonnegative and consistency != "none":
            lower[10 * n_links :][nonnegative] = 0.0
        lower.setflags(write=False)
        upper.setflags(write=False)
        return cls(
            consistency=consistency,
            constraints=constraints,
            n_links=n_links,
            lower=lower,
            upper=upper,
        )

    @property
    def bounded(self) -> Mask:
        """Parameters with bounds of their own, beside theta_max: masses, and signs of friction."""
        wide = self.constraints.theta_max
        return (self.lower > -wide) | (self.upper < wide)

    def require_feasible(self) -> None:
        """Raise when no parameters satisfy the constraints.

        A ball about the joint frame's origin has the largest margin for given moments of
        inertia, so it alone decides: its moments are the margin (6×6) or twice it (4×4).

        Raises
        ------
        InfeasibleError
            When the margin asks for more inertia than theta_max allows.
        """
        if self.consistency == "none":
            return
        factor = 2.0 if self.consistency == "pseudo_inertia" else 1.0
        needed = factor * self.constraints.margin
        if needed > self.constraints.theta_max:
            raise InfeasibleError(
                f"the margin of {self.constraints.margin} kg.m2 needs moments of inertia of "
                f"{needed} kg.m2, theta_max allows {self.constraints.theta_max}; lower the margin "
                "or raise theta_max."
            )

    @property
    def size(self) -> int:
        """Size of a link's matrix: 4 or 6."""
        return 4 if self.consistency == "pseudo_inertia" else 6

    def basis(self) -> Array:
        """Return F_k of one link, shape (10, s, s)."""
        return matrix_basis(self.consistency)

    def constant(self) -> Array:
        """Return F0 of one link, shape (s, s)."""
        return -self.constraints.margin * margin_shift(self.consistency)

    def bodies(self, theta: Array) -> Array:
        """Return the links of theta, shape (links, 10)."""
        return theta[: 10 * self.n_links].reshape(self.n_links, 10)

    def matrices(self, theta: Array) -> Array:
        """Return every link's matrix, shape (links, s, s), to be positive semidefinite."""
        blocks = np.einsum("lk,kij->lij", self.bodies(theta), self.basis())
        return np.asarray(blocks + self.constant())

    def margins(self, theta: Array) -> Array:
        """Return every link's margin in kg·m², NaN where the mass is not positive."""
        return margin(self.bodies(theta), self.consistency)

    def violation(self, theta: Array) -> float:
        """Return by how much theta violates the worst of its constraints, 0 when feasible.

        Margins count in kg·m², masses in kg, other bounds in their own unit; a link without a
        positive mass counts with the size of the mass it lacks.
        """
        worst = float(np.max(np.maximum(self.lower - theta, theta - self.upper), initial=0.0))
        if self.consistency != "none":
            margins = self.margins(theta)
            short = self.constraints.margin - margins[np.isfinite(margins)]
            worst = max(worst, float(np.max(short, initial=0.0)))
        return worst
