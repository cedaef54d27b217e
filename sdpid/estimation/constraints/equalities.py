"""Conditions that are equations: what is known, symmetric, or alike."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import KW_ONLY, dataclass

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen, is_number, real_array
from sdpid.errors import DataError, ModelError
from sdpid.estimation.constraints.condition import Condition, Layout, Row
from sdpid.estimation.constraints.mass import ORTHOGONAL, link_row, off_orthogonal, vector
from sdpid.robot.inertia import PARAMETER_NAMES, matrix_basis, transform
from sdpid.robot.model.geometry import link_placements


@dataclass(frozen=True, eq=False)
class Fixed(Condition):
    """Standard parameters are known.

    Attributes
    ----------
    values : mapping of str to float
        Values in SI units by the parameters' names, such as ``{"m_3": 2.0, "Fv2": 0.1}``.

    Examples
    --------
    >>> known = sdpid.constraints.Fixed({"m_6": 1.5, "Fv6": 2.0})
    >>> limits = sdpid.Constraints(others=(known,))
    >>> found = sdpid.solve_sdp(problem.constrained(constraints=limits)).named_theta()
    >>> round(found["m_6"], 6), round(found["Fv6"], 6)
    (1.5, 2.0)
    """

    values: Mapping[str, float]

    def __post_init__(self) -> None:
        if not isinstance(self.values, Mapping) or not self.values:
            raise DataError(
                f"Fixed: values is {self.values!r}; give a mapping such as {{'m_3': 2.0}}."
            )
        for name, value in self.values.items():
            if not (is_number(value) and np.isfinite(value)):
                raise DataError(f"Fixed: {name} is {value!r}; give a finite number.")
        object.__setattr__(self, "values", {name: float(x) for name, x in self.values.items()})

    def compile(self, layout: Layout) -> Iterator[Row]:
        """Return an equation a parameter, in its unit."""
        for name, value in self.values.items():
            coefficients = np.zeros(layout.count)
            coefficients[layout.parameter(name)] = 1.0
            yield Row(f"{name} fixed", frozen(coefficients), value, value)


@dataclass(frozen=True, eq=False)
class FixedLink(Condition):
    """All ten inertial parameters of a link are known.

    A body that no matter can have contradicts the consistency of the problem.

    Attributes
    ----------
    link : str
        The link.
    body : array_like, shape (10,), optional
        Its parameters about its joint frame; by default those of the robot's description.

    Examples
    --------
    >>> body = [1.5, 0.0, 0.0, 0.1, 0.02, 0.0, 0.02, 0.0, 0.0, 0.005]
    >>> limits = sdpid.Constraints(others=(sdpid.constraints.FixedLink("link_6", body),))
    >>> found = sdpid.solve_sdp(problem.constrained(constraints=limits)).theta
    >>> bool(np.allclose(found[50:60], body, atol=1e-9))
    True
    """

    link: str
    body: ArrayLike | None = None

    def __post_init__(self) -> None:
        if self.body is not None:
            what = f"FixedLink of '{self.link}'"
            body = vector(self.body, f"{what}: body", 10)
            if not body[0] > 0.0:
                raise DataError(f"{what}: the mass is {body[0]} kg; give a positive one.")
            object.__setattr__(self, "body", body)

    def compile(self, layout: Layout) -> Iterator[Row]:
        """Return ten equations, each in its parameter's unit."""
        link = layout.link(self.link)
        body = layout.robot.prior[link] if self.body is None else np.asarray(self.body)
        if not body[0] > 0.0:
            raise ModelError(
                f"FixedLink of '{self.link}': the description of '{layout.robot.name}' gives it a "
                f"mass of {body[0]} kg; give the body."
            )
        yield from _ten(f"{self.link} fixed", layout.body(link, np.eye(10)), body)


@dataclass(frozen=True, eq=False)
class EqualLinks(Condition):
    """Two links have the same ten parameters, each in its own joint frame.

    Attributes
    ----------
    first, second : str
        The links.

    Examples
    --------
    >>> same = sdpid.constraints.EqualLinks("link_4", "link_5")
    >>> limits = sdpid.Constraints(others=(same,))
    >>> theta = sdpid.solve_sdp(problem.constrained(constraints=limits)).theta
    >>> bool(np.allclose(theta[30:40], theta[40:50], atol=1e-6))
    True
    """

    first: str
    second: str

    def __post_init__(self) -> None:
        _require_two("EqualLinks", self.first, self.second, "name two links")

    def compile(self, layout: Layout) -> Iterator[Row]:
        """Return ten equations, each in its parameter's unit."""
        yield from _pair(layout, self.first, self.second, np.eye(10), "equal to that of")


@dataclass(frozen=True, eq=False)
class MirrorSymmetry(Condition):
    """A link's ten parameters are those of its own mirror image in a plane.

    Attributes
    ----------
    link : str
        The link.
    normal : array_like, shape (3,)
        Normal of the plane in the link's joint frame, of any length.
    point : array_like, shape (3,)
        A point of the plane in the same frame, m.

    Examples
    --------
    >>> flat = sdpid.constraints.MirrorSymmetry("link_6", normal=(0, 1, 0))
    >>> limits = sdpid.Constraints(others=(flat,))
    >>> found = sdpid.solve_sdp(problem.constrained(constraints=limits)).named_theta()
    >>> bool(abs(found["my_6"]) < 1e-6)
    True
    """

    link: str
    normal: ArrayLike
    point: ArrayLike = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        what = f"MirrorSymmetry of '{self.link}'"
        object.__setattr__(self, "normal", unit_normal(self.normal, what))
        object.__setattr__(self, "point", vector(self.point, f"{what}: point"))

    def compile(self, layout: Layout) -> Iterator[Row]:
        """Return three equations: a first moment in kg·m, two products of inertia in kg·m².

        Of the ten moments along the plane's normal and two directions in it, these are the ones
        that change their sign in the mirror; the other seven do not change at all.
        """
        link = layout.link(self.link)
        n = np.asarray(self.normal)
        u = np.cross(n, np.eye(3)[np.argmin(np.abs(n))])
        u /= np.linalg.norm(u)
        point = np.asarray(self.point)
        height, along, across = (np.append(a, -a @ point) for a in (n, u, np.cross(n, u)))
        factors = {
            "center of mass": np.eye(4)[3],
            "product of inertia 1": along,
            "product of inertia 2": across,
        }
        for name, factor in factors.items():
            row = np.einsum("kij,i,j->k", matrix_basis("pseudo_inertia"), height, factor)
            yield link_row(layout, link, f"mirror symmetry of {self.link}: {name}", row, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class MirrorPair(Condition):
    """The body of a link is the mirror image of that of another.

    The mirror is given in one of two ways. A `normal` and a `point` are those of a plane in the
    robot's base frame while the robot stands at `position`, so ``normal=(0, 1, 0)`` says that
    left is the mirror image of right, whatever the two joint frames are. Or `reflection` maps the
    first link's joint frame to the second's: a piece of matter at x in the first has its
    image at ``reflection @ (x, 1)`` in the second.

    Attributes
    ----------
    first, second : str
        The links.
    normal : array_like, shape (3,), optional
        Normal of the plane in the base frame, of any length.
    point : array_like, shape (3,)
        A point of the plane in the base frame, m.
    position : array_like, shape (n,), optional
        Joint positions at which the two links are mirror images, rad or m; by default all zero.
        With a floating base, a configuration (nq,).
    reflection : array_like, shape (4, 4), optional
        Instead of the plane: ``[[R, t], [0, 1]]`` with R orthogonal of determinant -1.

    Examples
    --------
    >>> pair = sdpid.constraints.MirrorPair("link_4", "link_6", reflection=np.diag([1, -1, 1, 1]))
    >>> limits = sdpid.Constraints(others=(pair,))
    >>> found = sdpid.solve_sdp(problem.constrained(constraints=limits)).named_theta()
    >>> bool(np.isclose(found["my_4"], -found["my_6"], atol=1e-6))
    True
    """

    first: str
    second: str
    normal: ArrayLike | None = None
    point: ArrayLike = (0.0, 0.0, 0.0)
    _: KW_ONLY
    position: ArrayLike | None = None
    reflection: ArrayLike | None = None

    def __post_init__(self) -> None:
        what = f"MirrorPair of '{self.first}' and '{self.second}'"
        _require_two("MirrorPair", self.first, self.second, "name two links, or use MirrorSymmetry")
        if (self.normal is None) == (self.reflection is None):
            raise DataError(f"{what}: give either the normal of a plane or a reflection.")
        object.__setattr__(self, "point", vector(self.point, f"{what}: point"))
        if self.reflection is not None:
            if self.position is not None or np.any(self.point):
                raise DataError(
                    f"{what}: a reflection needs no point and no position; leave them out."
                )
            object.__setattr__(self, "reflection", _reflection(self.reflection, what))
            return
        object.__setattr__(self, "normal", unit_normal(self.normal, what))
        if self.position is not None:
            position = frozen(real_array(self.position, f"{what}: position", ndim=1))
            object.__setattr__(self, "position", position)

    def between(self, layout: Layout) -> Array:
        """Return the reflection (4, 4) that maps the first link's joint frame to the second's."""
        if self.reflection is not None:
            return np.asarray(self.reflection)
        first, second = layout.link(self.first), layout.link(self.second)
        n, point = np.asarray(self.normal), np.asarray(self.point)
        mirror = np.eye(4)
        mirror[:3, :3] -= 2.0 * np.outer(n, n)
        mirror[:3, 3] = 2.0 * (n @ point) * n
        placements = link_placements(layout.robot, self.position)
        return np.asarray(np.linalg.solve(placements[second], mirror @ placements[first]))

    def compile(self, layout: Layout) -> Iterator[Row]:
        """Return ten equations, each in its parameter's unit."""
        M = self.between(layout)
        image = transform(np.eye(10), M[:3, :3], M[:3, 3]).T
        yield from _pair(layout, self.first, self.second, image, "mirror image of")


def unit_normal(values: ArrayLike | None, what: str) -> Array:
    """Return the normal of a plane (3,), of unit length.

    Raises
    ------
    DataError
        When it has another shape, is zero, or a value is not finite.
    """
    normal = vector(() if values is None else values, f"{what}: normal")
    largest = float(np.abs(normal).max())
    if largest == 0.0:
        raise DataError(f"{what}: normal is zero; give the direction across the plane.")
    # Squares of very small and very large numbers are zero and infinite.
    direction = normal / largest
    return frozen(direction / np.linalg.norm(direction))


def _require_two(kind: str, first: str, second: str, remedy: str) -> None:
    if first == second:
        raise DataError(f"{kind}: '{first}' is named twice; {remedy}.")


def _reflection(values: ArrayLike, what: str) -> Array:
    matrix = real_array(values, f"{what}: reflection", ndim=2)
    if matrix.shape != (4, 4) or (matrix[3] != (0.0, 0.0, 0.0, 1.0)).any():
        raise DataError(
            f"{what}: reflection has shape {matrix.shape}; give (4, 4) with last row 0 0 0 1."
        )
    R = matrix[:3, :3]
    error = off_orthogonal(R)
    if error > ORTHOGONAL or np.linalg.det(R) > 0.0:
        raise DataError(
            f"{what}: reflection is none: R^T R differs from the identity by {error:.2g} (at most "
            f"{ORTHOGONAL:g}), its determinant is {np.linalg.det(R):.3g} and must be -1."
        )
    return frozen(matrix)


def _pair(layout: Layout, first: str, second: str, image: Array, says: str) -> Iterator[Row]:
    """Yield ``second = image @ first``, one equation a parameter."""
    differences = layout.body(layout.link(second), np.eye(10))
    differences = differences - layout.body(layout.link(first), image)
    yield from _ten(f"{second} {says} {first}", differences, np.zeros(10))


def _ten(says: str, coefficients: Array, values: Array) -> Iterator[Row]:
    """Yield an equation for each of the ten parameters of a link."""
    for name, row, value in zip(PARAMETER_NAMES, coefficients, values.tolist(), strict=True):
        yield Row(f"{name} of {says}", frozen(row), value, value)
