"""Conditions on how much mass there is and where it lies."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import KW_ONLY, dataclass

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen, real_array
from sdpid.errors import DataError
from sdpid.estimation.constraints.condition import Condition, Cone, Layout, Row
from sdpid.estimation.constraints.hull import Hull, hull_facets
from sdpid.robot.inertia import matrix_basis
from sdpid.robot.model.geometry import collision_points

AXES = ("x", "y", "z")

# A mass that may differ by more than this share of it is not known: half the 4 % from which the
# inspection tells torques that carry another mass.
_ROUGHLY = 0.02
# A matrix written with eight digits or more is taken for a rotation or a reflection.
ORTHOGONAL = 1e-7


def vector(values: ArrayLike, what: str, size: int = 3) -> Array:
    """Return a read-only vector of finite numbers.

    Raises
    ------
    DataError
        When it has another shape, or a value is not finite.
    """
    array = real_array(values, what, ndim=1)
    if array.shape != (size,):
        raise DataError(f"{what}: {array.size} numbers, give {size}.")
    return frozen(array)


def _require_tolerance(tolerance: float, what: str, unit: str) -> None:
    """Raise DataError when a tolerance is not a number of at least 0."""
    if not (np.isfinite(tolerance) and tolerance >= 0.0):
        raise DataError(f"{what}: tolerance is {tolerance} {unit}; give a number of at least 0.")


def off_orthogonal(R: Array) -> float:
    """Return by how much a matrix differs from an orthogonal one, infinite for another shape."""
    return float(np.max(np.abs(R.T @ R - np.eye(3)))) if R.shape == (3, 3) else np.inf


def link_row(
    layout: Layout, link: int, name: str, coefficients: Array, lower: float, upper: float
) -> Row:
    """Return a row on the ten parameters of one link."""
    return Row(name, frozen(layout.body(link, coefficients)), lower, upper)


@dataclass(frozen=True, eq=False)
class TotalMass(Condition):
    """The mass of the whole robot, or of a group of links, is known.

    Attributes
    ----------
    mass : float
        The mass in kg.
    tolerance : float
        By how much it may differ, kg.
    links : sequence of str, optional
        The group; by default all moving links.

    Examples
    --------
    >>> wrist = sdpid.constraints.TotalMass(4.0, tolerance=0.1, links=("link_5", "link_6"))
    >>> limits = sdpid.Constraints(others=(wrist,))
    >>> found = sdpid.solve_sdp(problem.constrained(constraints=limits)).named_theta()
    >>> bool(3.9 - 1e-6 <= found["m_5"] + found["m_6"] <= 4.1 + 1e-6)
    True
    """

    mass: float
    _: KW_ONLY
    tolerance: float = 0.0
    links: Sequence[str] | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.mass) and self.mass > 0.0):
            raise DataError(f"TotalMass: mass is {self.mass} kg; give a positive number.")
        _require_tolerance(self.tolerance, "TotalMass", "kg")
        if self.links is None:
            return
        if isinstance(self.links, str):
            raise DataError(f"TotalMass: give a tuple of links, such as ('{self.links}',).")
        links = tuple(self.links)
        if not links or len(set(links)) < len(links):
            raise DataError(
                f"TotalMass: the group is {links}; name at least one link, and each link once."
            )
        object.__setattr__(self, "links", links)

    def compile(self, layout: Layout) -> Iterator[Row]:
        """Return the one row, in kg."""
        coefficients = np.zeros(layout.count)
        for name in layout.robot.link_names if self.links is None else self.links:
            coefficients[10 * layout.link(name)] = 1.0
        group = "" if self.links is None else f" of {', '.join(self.links)}"
        lower, upper = self.mass - self.tolerance, self.mass + self.tolerance
        yield Row(f"total mass{group}", frozen(coefficients), lower, upper)


def known_mass(conditions: Sequence[Condition]) -> float | None:
    """Return what a robot weighs by conditions, kg; None where that is not said, or roughly."""
    for condition in conditions:
        if not isinstance(condition, TotalMass) or condition.links is not None:
            continue
        if condition.tolerance <= _ROUGHLY * condition.mass:
            return condition.mass
    return None


@dataclass(frozen=True, eq=False)
class CenterOfMassInBox(Condition):
    """The center of mass of a link lies in a box along the axes of its joint frame.

    Attributes
    ----------
    link : str
        The link.
    lower, upper : array_like, shape (3,)
        Corners of the box, m; infinite where there is no limit, equal where it is known.

    Examples
    --------
    >>> place = sdpid.constraints.CenterOfMassInBox("link_6", (-0.05, -0.05, 0), (0.05, 0.05, 0.1))
    >>> limits = sdpid.Constraints(others=(place,))
    >>> body = sdpid.solve_sdp(problem.constrained(constraints=limits)).theta[50:60]
    >>> bool(np.all(np.abs(body[1:3] / body[0]) <= 0.05 + 1e-9))
    True
    """

    link: str
    lower: ArrayLike
    upper: ArrayLike

    def __post_init__(self) -> None:
        what = f"CenterOfMassInBox of '{self.link}'"
        bounds = []
        for name, wrong in (("lower", np.inf), ("upper", -np.inf)):
            try:
                values = frozen(getattr(self, name))
            except (TypeError, ValueError) as cause:
                raise DataError(f"{what}: {name}: not numbers ({cause}); give 3.") from None
            if values.shape != (3,) or np.isnan(values).any() or (values == wrong).any():
                raise DataError(
                    f"{what}: {name} is {values.tolist()}; give 3 numbers (m), "
                    f"{-wrong} where there is no limit."
                )
            bounds.append(values)
            object.__setattr__(self, name, values)
        if (bounds[0] > bounds[1]).any():
            raise DataError(
                f"{what}: the lower corner {bounds[0].tolist()} is above the upper one "
                f"{bounds[1].tolist()} (m); swap the numbers."
            )
        if not np.isfinite(bounds).any():
            raise DataError(f"{what}: no bound is finite, so it says nothing; leave it out.")

    def compile(self, layout: Layout) -> Iterator[Row]:
        """Return a row a finite bound, ``h − bound·m``, in kg·m."""
        link = layout.link(self.link)
        lower, upper = np.asarray(self.lower), np.asarray(self.upper)
        for k, axis in enumerate(AXES):
            ends = [(lower[k], "at least", 0.0, np.inf), (upper[k], "at most", -np.inf, 0.0)]
            if lower[k] == upper[k]:
                ends = [(lower[k], "known", 0.0, 0.0)]
            for bound, says, least, most in ends:
                if np.isfinite(bound):
                    row = np.eye(10)[1 + k]
                    row[0] = -bound
                    name = f"center of mass of {self.link}, {axis} {says}"
                    yield link_row(layout, link, name, row, least, most)


@dataclass(frozen=True, eq=False)
class _InEllipsoid(Condition):
    """An ellipsoid in the joint frame of a link."""

    link: str
    center: ArrayLike
    semi_axes: ArrayLike
    _: KW_ONLY
    rotation: ArrayLike | None = None

    def __post_init__(self) -> None:
        what = f"{type(self).__name__} of '{self.link}'"
        object.__setattr__(self, "center", vector(self.center, f"{what}: center"))
        semi_axes = vector(self.semi_axes, f"{what}: semi_axes")
        if not (semi_axes > 0.0).all():
            raise DataError(f"{what}: semi_axes are {semi_axes.tolist()} m; give positive numbers.")
        object.__setattr__(self, "semi_axes", semi_axes)
        if self.rotation is None:
            return
        R = frozen(real_array(self.rotation, f"{what}: rotation", ndim=2))
        error = off_orthogonal(R)
        if error > ORTHOGONAL:
            raise DataError(
                f"{what}: rotation is no rotation matrix (shape {R.shape}, R^T R differs from the "
                f"identity by {error:.2g}, at most {ORTHOGONAL:g}); its columns are the axes."
            )
        object.__setattr__(self, "rotation", R)

    def to_ball(self) -> Array:
        """Return T (3, 4) with ``T @ (x, 1)`` in the unit ball where x is in the ellipsoid."""
        R = np.eye(3) if self.rotation is None else np.asarray(self.rotation)
        scaled = (R / np.asarray(self.semi_axes)).T
        return np.column_stack([scaled, -scaled @ np.asarray(self.center)])


@dataclass(frozen=True, eq=False)
class CenterOfMassInEllipsoid(_InEllipsoid):
    """The center of mass of a link lies in an ellipsoid.

    Attributes
    ----------
    link : str
        The link.
    center : array_like, shape (3,)
        Its center in the link's joint frame, m.
    semi_axes : array_like, shape (3,)
        Half its lengths, m.
    rotation : array_like, shape (3, 3), optional
        Its axes in the joint frame, as columns; by default the frame's own.

    Examples
    --------
    >>> place = sdpid.constraints.CenterOfMassInEllipsoid(
    ...     "link_6", center=(0.0, 0.0, 0.05), semi_axes=(0.05, 0.05, 0.1))
    >>> limits = sdpid.Constraints(others=(place,))
    >>> sdpid.solve_sdp(problem.constrained(constraints=limits)).feasible
    True
    """

    def compile(self, layout: Layout) -> Iterator[Cone]:
        """Return the one cone, in kg."""
        T = self.to_ball()
        axis = np.zeros(10)
        axis[0] = 1.0
        vectors = np.zeros((3, 10))
        vectors[:, 1:4], vectors[:, 0] = T[:, :3], T[:, 3]
        name = f"center of mass of {self.link} in an ellipsoid"
        yield Cone(name, layout.link(self.link), frozen(axis), frozen(vectors))


@dataclass(frozen=True, eq=False)
class MassInEllipsoid(_InEllipsoid):
    """All mass of a link lies in an ellipsoid [wensing2018]_.

    With y the position in which the ellipsoid is the unit ball, mass inside has
    ``∫ (1 − ‖y‖²) dm ≥ 0``, which is linear in the pseudo-inertia: tr(Q·J) ≥ 0. Every body inside
    satisfies it. A pseudo-inertia J ⪰ 0 that satisfies it is that of some mass distribution on
    the ellipsoid, so nothing stronger can be said about the ten parameters. (Under 6×6
    consistency, where second moments may be negative, it is still necessary, but says less.)

    Attributes
    ----------
    link : str
        The link.
    center : array_like, shape (3,)
        Its center in the link's joint frame, m.
    semi_axes : array_like, shape (3,)
        Half its lengths, m.
    rotation : array_like, shape (3, 3), optional
        Its axes in the joint frame, as columns; by default the frame's own.

    Examples
    --------
    >>> place = sdpid.constraints.MassInEllipsoid("link_6", (0.0, 0.0, 0.05), (0.2, 0.2, 0.3))
    >>> limits = sdpid.Constraints(others=(place,))
    >>> sdpid.solve_sdp(problem.constrained(constraints=limits)).feasible
    True
    """

    def compile(self, layout: Layout) -> Iterator[Row]:
        """Return the one row, ``tr(Q·J)`` in kg."""
        T = self.to_ball()
        Q = np.diag([0.0, 0.0, 0.0, 1.0]) - T.T @ T
        row = np.einsum("kij,ij->k", matrix_basis("pseudo_inertia"), Q)
        name = f"mass of {self.link} in an ellipsoid"
        yield link_row(layout, layout.link(self.link), name, row, 0.0, np.inf)


@dataclass(frozen=True, eq=False)
class CenterOfMassInHull(Condition):
    """The center of mass of a link lies in the convex hull of points.

    Attributes
    ----------
    link : str
        The link.
    points : array_like, shape (N, 3), optional
        In the link's joint frame, m; by default those of the link's collision geometry and of
        what is fixed to it (see `sdpid.robot.model.geometry.collision_points`).
    tolerance : float
        Facets are left out as long as the rest lets the center of mass go no farther beyond one
        of them, m. Meshes have some 300 facets, one row each; a millimeter leaves about 130 of
        them, five leave 40. 0 takes all.
    package_dirs : sequence of paths
        Where meshes are looked up.

    Examples
    --------
    >>> corners = [(x, y, z) for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (0.0, 0.2)]
    >>> place = sdpid.constraints.CenterOfMassInHull("link_6", corners)
    >>> limits = sdpid.Constraints(others=(place,))
    >>> sdpid.solve_sdp(problem.constrained(constraints=limits)).feasible
    True
    """

    link: str
    points: ArrayLike | None = None
    _: KW_ONLY
    tolerance: float = 0.0
    package_dirs: Sequence[str | os.PathLike[str]] = ()

    def __post_init__(self) -> None:
        what = f"CenterOfMassInHull of '{self.link}'"
        _require_tolerance(self.tolerance, what, "m")
        if isinstance(self.package_dirs, (str, os.PathLike)):
            raise DataError(f"{what}: give a tuple of folders, such as ('{self.package_dirs}',).")
        object.__setattr__(self, "package_dirs", tuple(self.package_dirs))
        if self.points is not None:
            points = frozen(real_array(self.points, f"{what}: points", ndim=2))
            Hull.of(points, what)  # refuses what has no volume
            object.__setattr__(self, "points", points)

    def compile(self, layout: Layout) -> Iterator[Row]:
        """Return a row a facet, ``a·h − b·m ≤ 0`` with unit normal a, in kg·m."""
        link = layout.link(self.link)
        if self.points is None:
            points = collision_points(layout.robot, self.link, package_dirs=self.package_dirs)
        else:
            points = np.asarray(self.points)
        what = f"CenterOfMassInHull of '{self.link}'"
        normals, offsets = hull_facets(points, what, tolerance=self.tolerance)
        row = np.zeros(10)
        for i, (normal, offset) in enumerate(zip(normals, offsets, strict=True)):
            row[1:4], row[0] = normal, -offset
            name = f"center of mass of {self.link} in its hull, facet {i + 1}"
            yield link_row(layout, link, name, row, -np.inf, 0.0)
