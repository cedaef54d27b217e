"""The feasible set of one problem: bounds, matrix inequalities and linear rows in theta.

Its constraints are named objects, of which messages, multipliers, verdicts and prices are made.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask, frozen
from sdpid._common.tables import Shown
from sdpid.errors import InfeasibleError
from sdpid.estimation.constraints.condition import Cone, Layout, Row
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.constraints.equalities import Fixed
from sdpid.robot.inertia import Consistency, margin, margin_shift, matrix_basis

ConstraintKind = Literal["consistency", "mass", "sign", "theta_max", "row", "cone", "exists"]
Side = Literal["least", "most"]
_SIDES: tuple[Side, Side] = ("least", "most")


@dataclass(frozen=True)
class Constraint:
    """One inequality or equation of a feasible set.

    Attributes
    ----------
    kind : {"consistency", "mass", "sign", "theta_max", "row", "cone", "exists"}
        Consistency of a link, bound on a mass, sign of a friction parameter, the widest bound on a
        parameter, a linear row or cone of a further condition, or that a body exists, which an
        entropic prior asks for.
    name : str
        The constraint in words, unlike any other's.
    index : int
        Of the matrix inequality, the parameter or the linear row in the `FeasibleSet`.
    link : str or None
        The link that it is about; None where it is about none, or several.
    side : {"least", "most"} or None
        Which limit of the quantity it is; None for consistency, equations and cones.
    limit : float or None
        The limit, of consistency the margin; None for cones.
    unit : str or None
        Of the limit; None where a condition does not say.
    """

    kind: ConstraintKind
    name: str
    index: int
    link: str | None = None
    side: Side | None = None
    limit: float | None = None
    unit: str | None = None

    @property
    def sign(self) -> float:
        """1 for a lower limit and for what has no side, −1 for an upper one."""
        return -1.0 if self.side == "most" else 1.0

    @property
    def group(self) -> str:
        """What it belongs to: all links' consistency, all masses' upper bounds, or itself."""
        if self.kind == "mass":
            return f"masses at {self.side} {self.limit:g} kg"
        groups = {
            "consistency": "consistency of the links",
            "sign": "friction_nonnegative",
            "exists": "entropic prior",
        }
        return groups.get(self.kind, self.name)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class FeasibleSet(Shown):
    """All theta with ``lower ≤ theta ≤ upper``, matrices ⪰ 0 and rows within their limits.

    Every matrix inequality is ``F0 + Σ body_k·F_k`` ⪰ 0 in the ten parameters of one link. First
    come the links' own (none without a consistency), then the cones of further conditions: the
    cone ``‖v‖ ≤ a`` is the matrix ``[[a·E, v], [v^T, a]]``, v filled up with zeros to the size.

    Attributes
    ----------
    consistency : {"pseudo_inertia", "spatial_inertia", "none"}
        Which matrix inequality each link obeys.
    constraints : Constraints
        The numbers.
    link_names : tuple of str
        Links; their parameters are the first 10·links entries of theta.
    theta_names, theta_units : tuple of str
        Of theta.
    lower, upper : ndarray, shape (p,)
        Bounds on theta.
    block_names : tuple of str
        Name of each of the N matrix inequalities.
    block_links : ndarray of int, shape (N,)
        Whose parameters it is about.
    block_basis : ndarray, shape (N, 10, s, s)
        F_k.
    block_constants : ndarray, shape (N, s, s)
        F0.
    row_names : tuple of str
        Name of each of the r linear rows.
    rows : ndarray, shape (r, p)
        The rows.
    row_lower, row_upper : ndarray, shape (r,)
        Their limits, equal for equations, infinite where there is none.
    """

    consistency: Consistency
    constraints: Constraints
    link_names: tuple[str, ...]
    theta_names: tuple[str, ...]
    theta_units: tuple[str, ...]
    lower: Array
    upper: Array
    block_names: tuple[str, ...]
    block_links: Indices
    block_basis: Array
    block_constants: Array
    row_names: tuple[str, ...]
    rows: Array
    row_lower: Array
    row_upper: Array

    _facts = ("theta_names", "link_names", "block_names", "rows", "consistency")

    @classmethod
    def build(
        cls, constraints: Constraints, consistency: Consistency, layout: Layout
    ) -> FeasibleSet:
        """Build for a robot with its friction terms.

        Raises
        ------
        ModelError, DataError
            When a condition does not fit the robot.
        """
        robot, n_links = layout.robot, layout.robot.n_links
        nonnegative = np.array([p.nonnegative for p in layout.friction.parameters], dtype=bool)
        upper = _widest(constraints, layout.count, n_links)
        lower = -upper
        if consistency != "none":
            lower[: 10 * n_links : 10] = constraints.mass_min
            upper[: 10 * n_links : 10] = constraints.mass_max
        if constraints.friction_nonnegative and consistency != "none":
            lower[10 * n_links :][nonnegative] = 0.0
        values = {p.name: p.value for p in layout.friction.parameters if p.value is not None}
        known = (Fixed(values),) if values else ()
        compiled = _numbered(
            [part for other in (*constraints.others, *known) for part in other.compile(layout)]
        )
        rows = [part for part in compiled if isinstance(part, Row)]
        cones = [part for part in compiled if isinstance(part, Cone)]
        size = 6 if consistency == "spatial_inertia" else 4
        names = [cone.name for cone in cones]
        links = [cone.link for cone in cones]
        basis = [_arrow(cone, size) for cone in cones]
        constants = [np.zeros((size, size))] * len(cones)
        if consistency != "none":
            names = [f"consistency of {name}" for name in robot.link_names] + names
            links = [*range(n_links), *links]
            basis = [matrix_basis(consistency)] * n_links + basis
            constants = [-constraints.margin * margin_shift(consistency)] * n_links + constants
        block_links = np.array(links, dtype=np.intp)
        block_links.setflags(write=False)
        return cls(
            consistency=consistency,
            constraints=constraints,
            link_names=tuple(robot.link_names),
            theta_names=layout.names,
            theta_units=layout.units,
            lower=frozen(lower),
            upper=frozen(upper),
            block_names=tuple(names),
            block_links=block_links,
            block_basis=frozen(np.reshape(basis, (len(basis), 10, size, size))),
            block_constants=frozen(np.reshape(constants, (len(constants), size, size))),
            row_names=tuple(row.name for row in rows),
            rows=frozen(np.reshape([row.coefficients for row in rows], (len(rows), layout.count))),
            row_lower=frozen([row.lower for row in rows]),
            row_upper=frozen([row.upper for row in rows]),
        )

    def without(self, constraint: Constraint) -> FeasibleSet:
        """Return the set that leaves out one constraint.

        A parameter without its own bound still has the widest. Sizes of matrices and rows stay.
        Local solvers and `repair` keep every link consistent all the same: solve such a set as a
        program.

        Parameters
        ----------
        constraint : Constraint
            One of `named`.
        """
        k = constraint.index
        if constraint.kind in ("consistency", "cone"):
            # The unit matrix, whatever theta is.
            basis, constants = self.block_basis.copy(), self.block_constants.copy()
            basis[k], constants[k] = 0.0, np.eye(self.size)
            return replace(self, block_basis=frozen(basis), block_constants=frozen(constants))
        row = constraint.kind == "row"
        names = ("row_lower", "row_upper") if row else ("lower", "upper")
        wide = float(self.widest[k]) if constraint.kind in ("mass", "sign") else np.inf
        changes: dict[str, Any] = {}
        for name, end, other in zip(names, (-wide, wide), ("most", "least"), strict=True):
            if constraint.side != other:
                limits = getattr(self, name).copy()
                limits[k] = end
                changes[name] = frozen(limits)
        return replace(self, **changes)

    @cached_property
    def required(self) -> Mask:
        """Which matrix inequalities (N,) hold anything: all, unless one was left out."""
        return np.asarray(np.any(self.block_basis != 0.0, axis=(1, 2, 3)))

    @cached_property
    def widest(self) -> Array:
        """Bounds (p,) of the size of each parameter that has none of its own."""
        return frozen(_widest(self.constraints, len(self.theta_names), self.n_links))

    @property
    def n_links(self) -> int:
        """Number of links."""
        return len(self.link_names)

    @cached_property
    def named(self) -> tuple[Constraint, ...]:
        """Every constraint: consistency, masses, signs, theta_max, rows by limit, cones."""
        matrices = [self._matrix(i) for i in np.flatnonzero(self.required).tolist()]
        links = sum(matrix.kind == "consistency" for matrix in matrices)
        limits = np.stack([self.lower, self.upper], axis=1)
        bounds = [
            self._bound(k, _SIDES[end], float(limits[k, end]))
            for k, end in np.argwhere(np.isfinite(limits)).tolist()
        ]
        bounds.sort(key=lambda bound: bound.kind == "theta_max")
        rows = [row for j in range(len(self.rows)) for row in self._row(j)]
        return (*matrices[:links], *bounds, *rows, *matrices[links:])

    def _matrix(self, i: int) -> Constraint:
        """Return a link's consistency, or a cone."""
        name, link = self.block_names[i], self.link_names[self.block_links[i]]
        if i >= self.n_own:
            return Constraint("cone", name, i, link)
        return Constraint("consistency", name, i, link, None, self.constraints.margin, "kg.m2")

    def _bound(self, k: int, side: Side, limit: float) -> Constraint:
        """Return one side of the bounds of a parameter."""
        name, unit = self.theta_names[k], self.theta_units[k]
        link = self.link_names[k // 10] if k < 10 * self.n_links else None
        kind: ConstraintKind = "sign" if link is None else "mass"
        words = f"{name} at {side} {limit:g}"
        if abs(limit) >= self.widest[k]:
            kind = "theta_max"
        elif kind == "mass":
            words = f"mass of {link} at {side} {limit:g} kg"
        return Constraint(kind, words, k, link, side, limit, unit)

    def _row(self, j: int) -> Iterator[Constraint]:
        """Yield an equation, or the finite limits of a linear row."""
        name, limits = self.row_names[j], (float(self.row_lower[j]), float(self.row_upper[j]))
        if limits[0] == limits[1]:
            yield Constraint("row", name, j, limit=limits[0])
            return
        both = bool(np.isfinite(limits).all())
        for side, limit in zip(_SIDES, limits, strict=True):
            if np.isfinite(limit):
                words = f"{name}, at {side} {limit:g}" if both else name
                yield Constraint("row", words, j, None, side, limit)

    @property
    def bounded(self) -> Mask:
        """Parameters with bounds of their own, not the widest: masses, and signs of friction."""
        return (self.lower > -self.widest) | (self.upper < self.widest)

    @property
    def n_own(self) -> int:
        """Number of the links' own matrix inequalities, which come first."""
        return 0 if self.consistency == "none" else self.n_links

    @property
    def equations(self) -> Mask:
        """Which rows are equations."""
        return np.asarray(self.row_lower == self.row_upper)

    def require_feasible(self) -> None:
        """Raise when the margin alone leaves no parameters.

        A ball about the joint frame's origin has the largest margin for given moments of
        inertia, so without further conditions it alone decides: its moments are the margin (6×6)
        or twice it (4×4).

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
                "or raise theta_max.",
                conflict=("margin", "theta_max"),
            )

    @property
    def size(self) -> int:
        """Size s of the matrices: 4 or 6."""
        return int(self.block_basis.shape[-1])

    def bodies(self, theta: Array) -> Array:
        """Return the links of theta, shape (links, 10)."""
        return theta[: 10 * self.n_links].reshape(self.n_links, 10)

    def matrices(self, theta: Array) -> Array:
        """Return the matrices that are to be positive semidefinite, shape (N, s, s)."""
        bodies = self.bodies(theta)[self.block_links]
        blocks = np.einsum("nk,nkij->nij", bodies, self.block_basis)
        return np.asarray(blocks + self.block_constants)

    def adjoint(self, Z: Array) -> Array:
        """Return Σ F*(Z_i) as a vector over theta, of multipliers (N, s, s)."""
        out = np.zeros(len(self.lower))
        values = np.einsum("nij,nkij->nk", Z, self.block_basis)
        np.add.at(out[: 10 * self.n_links].reshape(-1, 10), self.block_links, values)
        return out

    def margins(self, theta: Array) -> Array:
        """Return every link's margin in kg·m², NaN where the mass is not positive."""
        return margin(self.bodies(theta), self.consistency)

    def cones(self, theta: Array) -> Array:
        """Return the further conditions' cones ``‖v‖ ≤ t`` at parameters, (c, s): v, then t."""
        own = slice(self.n_own, None)
        bodies, basis = self.bodies(theta)[self.block_links[own]], self.block_basis[own, :, -1]
        return np.asarray(np.einsum("nk,nkj->nj", bodies, basis) + self.block_constants[own, -1])

    def slacks(self, theta: Array) -> Array:
        """Return by how much each cone of the further conditions holds, in its own unit."""
        rows = self.cones(theta)
        return np.asarray(rows[:, -1] - np.linalg.norm(rows[:, :-1], axis=1))

    def limits_of(self, functions: Array) -> tuple[Array, Array]:
        """Return the declared limits (k,) of functions (k, p) of theta.

        Infinite for all that are no multiple of one parameter.
        """
        least, most = np.full((2, len(functions)), np.inf)
        least = -least
        for k in np.flatnonzero(np.count_nonzero(functions, axis=1) == 1):
            index = int(np.flatnonzero(functions[k])[0])
            ends = functions[k, index] * np.array([self.lower[index], self.upper[index]])
            least[k], most[k] = ends.min(), ends.max()
        return least, most

    def violation(self, theta: Array) -> float:
        """Return by how much theta violates the worst of its constraints, 0 when feasible.

        Margins count in kg·m², masses in kg, everything else in its own unit; a link without a
        positive mass counts with the size of the mass it lacks.
        """
        worst = float(np.max(np.maximum(self.lower - theta, theta - self.upper), initial=0.0))
        if self.consistency != "none":
            margins = self.margins(theta)[self.required[: self.n_own]]
            short = self.constraints.margin - margins[np.isfinite(margins)]
            worst = max(worst, float(np.max(short, initial=0.0)))
        values = self.rows @ theta
        outside = np.maximum(self.row_lower - values, values - self.row_upper)
        worst = max(worst, float(np.max(outside, initial=0.0)))
        return max(worst, float(np.max(-self.slacks(theta), initial=0.0)))


def _widest(constraints: Constraints, count: int, n_links: int) -> Array:
    """Return the widest bounds (p,): of the links' parameters, then of friction and drives."""
    widest = np.full(count, float(constraints.theta_max))
    widest[10 * n_links :] = constraints.friction_max or constraints.theta_max
    return widest


def _numbered(parts: list[Row | Cone]) -> list[Row | Cone]:
    """Return rows and cones with a number behind names that occur more than once."""
    counts, used, out = Counter(part.name for part in parts), Counter[str](), []
    for part in parts:
        used[part.name] += 1
        number = f" ({used[part.name]})" if counts[part.name] > 1 else ""
        out.append(replace(part, name=part.name + number))
    return out


def _arrow(cone: Cone, size: int) -> Array:
    """Return F_k, shape (10, s, s), of ``[[a·E, v], [v^T, a]]`` ⪰ 0."""
    basis = np.asarray(cone.axis)[:, None, None] * np.eye(size)
    basis[:, -1, :3] = basis[:, :3, -1] = np.asarray(cone.vectors).T
    return basis
