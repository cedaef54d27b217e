"""Obstacles around a robot: half spaces (a table, a wall), boxes and meshes, and their TOML."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Mask, real_array
from sdpid._common.files import load_toml
from sdpid.errors import DataError
from sdpid.robot.description.xml import LARGEST, rpy_matrix
from sdpid.robot.model.shapes import mesh_faces, read_mesh

_DIRECTIONS = {
    sign + axis: tuple((-1.0 if sign == "-" else 1.0) * (axis == other) for other in "xyz")
    for sign in ("+", "-", "")
    for axis in "xyz"
}

# Squared area, relative to the squared size of a mesh, below which a triangle has no sides.
_THIN = 1e-30


def _triple(values: Any, what: str) -> tuple[float, float, float]:
    array = real_array(values, what, ndim=1)
    if array.shape != (3,) or not (np.abs(array) <= LARGEST).all():
        raise DataError(f"{what}: {array.tolist()}, give 3 numbers of at most {LARGEST:g}.")
    return float(array[0]), float(array[1]), float(array[2])


def _unit(values: Any, what: str, wrong: str) -> Array:
    """Return a vector (3,) at length one."""
    direction = np.array(_triple(values, what))
    length = float(np.linalg.norm(direction))
    if length == 0.0:
        raise DataError(wrong)
    return np.asarray(direction / length)


@dataclass(frozen=True, kw_only=True)
class _Placed:
    """What all obstacles of a limited size have: a place in the base frame, and a name."""

    translation: Sequence[float] = (0.0, 0.0, 0.0)
    rpy: Sequence[float] = (0.0, 0.0, 0.0)
    name: str = ""

    def __post_init__(self) -> None:
        self._settle("translation", _triple(self.translation, f"{self._what}: translation"))
        self._settle("rpy", _triple(self.rpy, f"{self._what}: rpy"))
        if not self.name:
            self._settle("name", type(self).__name__.lower())

    @property
    def _what(self) -> str:
        return f"obstacle '{self.name or type(self).__name__.lower()}'"

    def _settle(self, field: str, value: Any) -> None:
        object.__setattr__(self, field, value)

    @property
    def placement(self) -> Array:
        """The obstacle's frame in the base frame, shape (4, 4)."""
        placement = np.eye(4)
        placement[:3, :3] = rpy_matrix(self.rpy)
        placement[:3, 3] = self.translation
        return placement

    def _inside(self, points: Array) -> Array:
        """Return points of the base frame in the obstacle's frame."""
        return np.asarray((points - self.placement[:3, 3]) @ self.placement[:3, :3])


@dataclass(frozen=True, kw_only=True)
class Plane:
    """A half space that is not free: everything behind a plane.

    Attributes
    ----------
    point : sequence of 3 floats
        A point of the plane in the base frame, m.
    normal : sequence of 3 floats
        Towards the free side; of any length but zero.
    name : str
        What the plane is called in results.

    Examples
    --------
    >>> from sdpid.excitation.geometry.obstacles import Plane
    >>> table = Plane(point=(0.0, 0.0, -0.1), name="table")
    >>> table.contains(np.array([[0.0, 0.0, -0.2], [0.0, 0.0, 0.5]]))
    array([ True, False])
    """

    point: Sequence[float] = (0.0, 0.0, 0.0)
    normal: Sequence[float] = (0.0, 0.0, 1.0)
    name: str = "plane"

    def __post_init__(self) -> None:
        what = f"plane '{self.name}':"
        object.__setattr__(self, "point", _triple(self.point, f"{what} point"))
        wrong = f"{what} the normal is zero, give a direction."
        normal = _unit(self.normal, f"{what} normal", wrong)
        object.__setattr__(self, "normal", tuple(normal.tolist()))

    def contains(self, points: Array) -> Mask:
        """Return which points (N, 3) of the base frame lie inside."""
        return np.asarray((points - np.array(self.point)) @ np.array(self.normal) < 0.0)


@dataclass(frozen=True, kw_only=True)
class Box(_Placed):
    """A box.

    Attributes
    ----------
    size : sequence of 3 floats
        Lengths of the edges, m.
    translation, rpy : sequence of 3 floats
        Middle of the box in the base frame, m, and its roll, pitch and yaw, rad.
    name : str
        What the box is called in results.

    Examples
    --------
    >>> from sdpid.excitation.geometry.obstacles import Box
    >>> post = Box(size=(0.1, 0.1, 1.0), translation=(0.6, 0.0, 0.5), name="post")
    >>> post.contains(np.array([[0.6, 0.0, 0.2], [0.0, 0.0, 0.2]]))
    array([ True, False])
    """

    size: Sequence[float]

    def __post_init__(self) -> None:
        super().__post_init__()
        self._settle("size", _triple(self.size, f"{self._what}: size"))
        if min(self.size) <= 0.0:
            raise DataError(f"{self._what}: size {list(self.size)}, every edge is longer than 0 m.")

    def contains(self, points: Array) -> Mask:
        """Return which points (N, 3) of the base frame lie inside."""
        return np.asarray((np.abs(self._inside(points)) < 0.5 * np.array(self.size)).all(axis=1))


@dataclass(frozen=True, kw_only=True)
class Mesh(_Placed):
    """A surface of triangles from a file (STL, OBJ, DAE, PLY…).

    Attributes
    ----------
    path : str or path
        The file.
    scale : float or sequence of 3 floats
        Factors of the file's coordinates: 0.001 where it is in mm.
    convex : bool
        Whether to take the convex hull: a hundred times faster, and nothing fits into a hollow
        of it any more.
    translation, rpy : sequence of 3 floats
        The file's frame in the base frame: m, and roll, pitch and yaw in rad.
    name : str
        What the mesh is called in results.

    Examples
    --------
    >>> from sdpid.excitation.geometry.obstacles import Mesh
    >>> Mesh(path="fixture.stl", scale=0.001, translation=(0.5, 0.0, 0.0), name="fixture").name
    'fixture'
    """

    path: str | os.PathLike[str]
    scale: float | Sequence[float] = 1.0
    convex: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.name or self.name == "mesh":
            self._settle("name", Path(self.path).stem)
        scale = (self.scale,) * 3 if isinstance(self.scale, (int, float)) else self.scale
        self._settle("scale", _triple(scale, f"{self._what}: scale"))
        if 0.0 in self.scale:  # type: ignore[operator]
            raise DataError(f"{self._what}: scale {list(self.scale)}, no factor is 0.")  # type: ignore[arg-type]

    def load(self) -> tuple[Any, Array]:
        """Return the file's mesh for Coal and its vertices (N, 3), both in the mesh's frame.

        Raises
        ------
        ModelError
            When the file cannot be read.
        """
        return read_mesh(Path(self.path), np.array(self.scale), self._what)

    def triangles(self) -> Array:
        """Return the corners of the triangles in the base frame, shape (M, 3, 3)."""
        mesh, vertices = self.load()
        corners = vertices[mesh_faces(mesh)]
        return np.asarray(corners @ self.placement[:3, :3].T + self.placement[:3, 3])

    def contains(self, points: Array) -> Mask:
        """Return which points (N, 3) of the base frame the surface surrounds.

        The solid angle that all triangles fill as seen from the point [vanoosterom1983]_: the
        full sphere inside of a closed surface, nothing outside, whatever side triangles face.
        """
        out = np.empty(len(points), dtype=bool)
        triangles = self.triangles()
        for k, point in enumerate(points):
            a, b, c = np.moveaxis(triangles - point, 1, 0)
            la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
            volume = np.einsum("mi,mi->m", a, np.cross(b, c))
            shares = la * lb * lc
            for side, other, length in ((a, b, lc), (b, c, la), (c, a, lb)):
                shares = shares + np.einsum("mi,mi->m", side, other) * length
            out[k] = abs(2.0 * np.arctan2(volume, shares).sum()) > 2.0 * np.pi
        return out


Obstacle = Plane | Box | Mesh


def table(height: float = 0.0) -> Plane:
    """Return a table under the arm: all below a height in the base frame (m) is taken."""
    return Plane(point=(0.0, 0.0, height), normal=(0.0, 0.0, 1.0), name="table")


def wall(distance: float, direction: str | Sequence[float] = "-x", *, name: str = "") -> Plane:
    """Return a wall: all that lies farther from the base's origin in a direction is taken.

    Parameters
    ----------
    distance : float
        From the origin of the base frame to the wall, m.
    direction : str or sequence of 3 floats, optional
        Where the wall is seen from the base: ``"x"``, ``"-y"``, …, or a vector in its frame.
    name : str, optional
        What the wall is called in results; by default ``wall -x`` and the like.

    Raises
    ------
    DataError
        When the direction is not understood.
    """
    if isinstance(direction, str):
        if direction not in _DIRECTIONS:
            raise DataError(f"wall: direction '{direction}'; give one of {', '.join(_DIRECTIONS)}.")
        name = name or f"wall {direction}"
        direction = _DIRECTIONS[direction]
    wrong = "wall: the direction is zero, give one that is not."
    outwards = _unit(direction, "wall: direction", wrong)
    return Plane(
        point=tuple((float(distance) * outwards).tolist()),
        normal=tuple((-outwards).tolist()),
        name=name or "wall",
    )


_KINDS: dict[str, Any] = {"plane": Plane, "box": Box, "mesh": Mesh, "table": table, "wall": wall}


def obstacles_from_toml(
    source: str | os.PathLike[str] | Mapping[str, Any],
    folder: str | os.PathLike[str] = "",
) -> tuple[Obstacle, ...]:
    """Read obstacles from a TOML file.

    Every kind is an array of tables, ``[[plane]]``, ``[[box]]``, ``[[mesh]]``, ``[[table]]`` or
    ``[[wall]]``, whose keys are the arguments of the classes and functions of those names.

    Parameters
    ----------
    source : path or mapping
        The file, or what it contains. Paths of meshes are relative to the file.
    folder : path, optional
        Of a mapping: what paths of meshes are relative to; by default the working folder.

    Raises
    ------
    DataError
        When the file cannot be read, or has keys or values that are not understood.
    """
    if isinstance(source, Mapping):
        content, where, beside = dict(source), "obstacles", Path(folder)
    else:
        content, where, beside = load_toml(source), str(source), Path(source).parent
    obstacles: list[Obstacle] = []
    for kind, entries in content.items():
        if kind not in _KINDS:
            raise DataError(f"{where}: '{kind}' is no obstacle; known are {', '.join(_KINDS)}.")
        for entry in entries if isinstance(entries, list) else [entries]:
            if not isinstance(entry, Mapping):
                raise DataError(f"{where}: '{kind}' is {entry!r}; write it as [[{kind}]].")
            keys = dict(entry)
            if kind == "mesh" and "path" in keys:
                keys["path"] = str(beside / str(keys["path"]))
            try:
                obstacles.append(_KINDS[kind](**keys))
            except (TypeError, ValueError) as cause:
                raise DataError(f"{where}: [[{kind}]]: {cause}") from None
    return tuple(obstacles)


def obstacles_to_dict(obstacles: Iterable[Obstacle]) -> dict[str, list[dict[str, Any]]]:
    """Return obstacles as what `obstacles_from_toml` reads, with numbers, strings and lists."""
    out: dict[str, list[dict[str, Any]]] = {}
    for obstacle in obstacles:
        entry: dict[str, Any] = {}
        for key, value in vars(obstacle).items():
            entry[key] = list(value) if isinstance(value, tuple) else value
        if isinstance(obstacle, Mesh):
            entry["path"] = str(Path(obstacle.path).absolute())
        out.setdefault(type(obstacle).__name__.lower(), []).append(entry)
    return out


def named_apart(obstacles: Iterable[Obstacle], taken: Iterable[str]) -> tuple[Obstacle, ...]:
    """Return the obstacles with names that differ from each other and from those taken."""
    names, out = set(taken), []
    for obstacle in obstacles:
        if not isinstance(obstacle, (Plane, Box, Mesh)):
            raise DataError(f"obstacles: {obstacle!r} is no Plane, Box or Mesh.")
        name, count = obstacle.name, 2
        while name in names:
            name, count = f"{obstacle.name} {count}", count + 1
        names.add(name)
        out.append(obstacle if name == obstacle.name else replace(obstacle, name=name))
    return tuple(out)
