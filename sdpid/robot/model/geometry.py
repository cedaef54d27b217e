"""Geometry of a robot: points around each link's collision shapes, and placements of links."""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, real_array
from sdpid.errors import ModelError
from sdpid.robot.description.catalog import example_robots
from sdpid.robot.description.origin import read_origin, read_triple
from sdpid.robot.description.xml import parse_xml
from sdpid.robot.model.model import RobotModel

# Sides of the prism around a cylinder: its corners stand out by 2 % of the radius.
_SIDES = 16

# Circumscribed shapes are grown by this share, so that rounding does not let the true shape out.
_ROUNDING = 1e-12


def collision_points(
    robot: RobotModel, link: str, *, package_dirs: Iterable[str | os.PathLike[str]] = ()
) -> Array:
    """Return points whose convex hull contains the collision geometry of a link.

    Links that are fixed to a moving link belong to it, and so does their geometry. Boxes give
    their corners and meshes their vertices, so that the hull is exact. Cylinders give a
    circumscribed prism of 16 sides (2 % wider), spheres and the ends of capsules a circumscribed
    polyhedron of 42 corners (7 % wider at its corners).

    Parameters
    ----------
    robot : RobotModel
        A robot that was loaded from a URDF.
    link : str
        One of its moving links.
    package_dirs : iterable of paths, optional
        Folders in which ``package://`` names and relative file names are looked up: the folder
        that holds the package, the package itself, or the URDF's own folder. Meshes of
        example-robot-data are found without.

    Returns
    -------
    ndarray, shape (N, 3)
        Points in the link's joint frame, m.

    Raises
    ------
    ModelError
        When the robot has no such link or no URDF, the link has no collision geometry, a number
        or a kind of shape is not understood, or a mesh cannot be found or read.
    """
    if link not in robot.link_names:
        raise ModelError(
            f"'{robot.name}' has no moving link '{link}'; it has {', '.join(robot.link_names)}."
        )
    if robot.urdf is None:
        raise ModelError(
            f"'{robot.name}' was not loaded from a URDF, so the shape of '{link}' is not known; "
            "give the points."
        )
    import pinocchio as pin

    folders = [Path(folder) for folder in package_dirs]
    bodies = {
        frame.name: np.array(frame.placement.homogeneous)
        for frame in robot.pin_model.frames
        if frame.type == pin.FrameType.BODY
        and frame.parentJoint == robot.link_names.index(link) + 1
    }
    points = []
    for element in parse_xml(robot.urdf, robot.name).findall("link"):
        name = element.get("name")
        if name in bodies:
            own = link_points(element, "collision", robot.name, folders)
            points.append(own @ bodies[name][:3, :3].T + bodies[name][:3, 3])
    if not any(len(own) for own in points):
        raise ModelError(
            f"'{robot.name}': link '{link}' and what is fixed to it have no collision geometry; "
            "give the points, or leave this link out."
        )
    return np.concatenate(points)


def link_points(element: Any, kind: str, robot: str, folders: Sequence[Path]) -> Array:
    """Return points whose convex hull contains the shapes of a URDF's ``<link>``, in its frame.

    Parameters
    ----------
    element : element
        The ``<link>``.
    kind : {"collision", "visual"}
        Which shapes.
    robot : str
        What the robot is called in messages.
    folders : sequence of Path
        Folders in which the names of meshes are looked up.

    Returns
    -------
    ndarray, shape (N, 3)
        m; N is zero where the link has no such shape.

    Raises
    ------
    ModelError
        When a shape is not understood, or a mesh cannot be found or read.
    """
    points = [np.empty((0, 3))]
    for shape in element.findall(kind):
        what = f"'{robot}', link '{element.get('name')}', {kind} geometry"
        try:
            placement = read_origin(shape)
        except ValueError as cause:
            raise ModelError(f"{what}: <origin>: {cause}.") from None
        corners = _corners(shape.find("geometry"), what, folders)
        points.append(corners @ placement[:3, :3].T + placement[:3, 3])
    return np.concatenate(points)


def neutral(robot: RobotModel) -> Array:
    """Return the position at which all joints are at zero and a floating base at the origin."""
    if not robot.free_flyer:
        return np.zeros(robot.n)
    import pinocchio as pin

    return np.asarray(pin.neutral(robot.pin_model))


def link_placements(robot: RobotModel, position: ArrayLike | None = None) -> Array:
    """Return the placements of the links' joint frames in the base frame, shape (links, 4, 4).

    Parameters
    ----------
    robot : RobotModel
        The robot.
    position : array_like, shape (n,), optional
        Joint positions in rad or m, a configuration (nq,) with a floating base; by default all
        zero, with the base at the origin.

    Raises
    ------
    DataError
        When the position has another shape.
    """
    import pinocchio as pin

    model = robot.pin_model
    if position is None:
        position = neutral(robot)
    q = robot.configuration(real_array(position, "position", ndim=1)[None])[0]
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    return np.stack([data.oMi[i + 1].homogeneous for i in range(robot.n_links)])


def _numbers(element: Any, key: str, what: str, default: str | None = None) -> list[float]:
    text = element.get(key, default)
    try:
        values = [float(word) for word in text.split()]
    except (AttributeError, ValueError):
        values = []
    if not values or not np.isfinite(values).all():
        raise ModelError(f"{what}: <{element.tag}> has {key}={text!r}; give numbers.")
    return values


def _sizes(element: Any, keys: Sequence[str], what: str) -> list[float]:
    sizes = [_numbers(element, key, what)[0] for key in keys]
    if min(sizes) < 0.0:
        raise ModelError(f"{what}: <{element.tag}> has a size of {min(sizes)} m, the least is 0.")
    return sizes


def _triple(element: Any, key: str, what: str, default: str = "") -> Array:
    try:
        return read_triple(element, key, default)
    except ValueError as cause:
        raise ModelError(f"{what}: <{element.tag}>: {cause}.") from None


def _corners(geometry: Any, what: str, folders: Sequence[Path]) -> Array:
    """Return the points of one shape in its own frame."""
    shapes = [] if geometry is None else [e for e in geometry if isinstance(e.tag, str)]
    if len(shapes) != 1:
        raise ModelError(f"{what}: {len(shapes)} shapes in <geometry>, a URDF has one.")
    shape = shapes[0]
    if shape.tag == "box":
        size = _triple(shape, "size", what)
        signs = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), axis=-1).reshape(-1, 3)
        return signs * size
    if shape.tag == "sphere":
        (radius,) = _sizes(shape, ("radius",), what)
        return radius * _unit_ball()
    if shape.tag == "cylinder":
        radius, length = _sizes(shape, ("radius", "length"), what)
        return _prism(radius, length)
    if shape.tag == "capsule":
        radius, length = _sizes(shape, ("radius", "length"), what)
        end = np.array([0.0, 0.0, 0.5 * length])
        ball = radius * _unit_ball()
        return np.concatenate([ball - end, ball + end])
    if shape.tag == "mesh":
        path = _find_mesh(shape.get("filename", ""), what, folders)
        return _mesh_vertices(path, _triple(shape, "scale", what, "1 1 1"), what)
    raise ModelError(
        f"{what}: a <{shape.tag}> is not understood; supported are box, cylinder, sphere, "
        "capsule and mesh."
    )


def _prism(radius: float, length: float) -> Array:
    """Return the corners of the prism around a cylinder along z."""
    angles = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    outer = radius * (1.0 + _ROUNDING) / np.cos(np.pi / _SIDES)
    ring = np.stack([outer * np.cos(angles), outer * np.sin(angles), np.zeros(_SIDES)], axis=-1)
    end = np.array([0.0, 0.0, 0.5 * length])
    return np.concatenate([ring - end, ring + end])


@cache
def _unit_ball() -> Array:
    """Return 42 corners of a polyhedron around the unit ball: an icosahedron, split once."""
    from scipy.spatial import ConvexHull

    golden = 0.5 * (1.0 + np.sqrt(5.0))
    corners = np.array([[0.0, s, t * golden] for s in (-1.0, 1.0) for t in (-1.0, 1.0)])
    corners = np.concatenate([np.roll(corners, k, axis=1) for k in range(3)])
    # The edges of this icosahedron have length 2, all other distances are above 3.
    middles = [
        a + b for i, a in enumerate(corners) for b in corners[:i] if np.linalg.norm(a - b) < 2.5
    ]
    points = np.concatenate([corners, middles])
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    inner = float(np.min(-ConvexHull(points).equations[:, 3]))
    points *= (1.0 + _ROUNDING) / inner
    points.setflags(write=False)
    return points


def _example_folders() -> Iterator[Path]:
    """Yield the folders that example-robot-data's package names start from."""
    path = next(iter(example_robots().values()), None)
    for parent in path.parents if path is not None else ():
        if parent.name == "robots" and parent.parent.name == "example-robot-data":
            yield parent.parent.parent
            yield parent


def _find_mesh(filename: str, what: str, folders: Sequence[Path]) -> Path:
    scheme, separator, rest = filename.partition("://")
    if not separator:
        scheme, rest = "", filename
    if scheme not in ("", "file", "package"):
        raise ModelError(
            f"{what}: mesh '{filename}': names start with package:// or file://, or are paths."
        )
    if scheme == "file":
        rest = unquote(rest)
    candidates = []
    if scheme != "package" and Path(rest).is_absolute():
        candidates.append(Path(rest))
    else:
        rest = rest.lstrip("/")
        package, _, inside = rest.partition("/")
        for folder in (*folders, *_example_folders()):
            candidates.append(folder / rest)
            # The folder may be the package, or lie inside it as the folder of the URDF does.
            whole = folder.resolve()
            candidates += [p / inside for p in (whole, *whole.parents) if p.name == package]
    for path in candidates:
        if path.is_file():
            return path
    looked = ", ".join(str(folder) for folder in folders) or "no folder given"
    raise ModelError(
        f"{what}: mesh '{filename}' is not found (looked in: {looked}); give the folder that "
        "holds its package, or the URDF's own, as package_dirs."
    )


def _mesh_library() -> ModuleType:
    # It comes with Pinocchio, under its old name in old releases.
    import pinocchio  # noqa: F401 - brings the converters of the arrays

    for name in ("coal", "hppfcl"):
        try:
            return importlib.import_module(name)
        except ImportError:
            continue
    raise ModelError("meshes need the library coal, which comes with the package pin.")


def _mesh_vertices(path: Path, scale: Array, what: str) -> Array:
    try:
        mesh: Any = _mesh_library().MeshLoader().load(str(path), scale)
        vertices = np.array(mesh.vertices(), dtype=np.float64).reshape(-1, 3)
    except (RuntimeError, ValueError, TypeError) as cause:
        raise ModelError(f"{what}: mesh {path} cannot be read ({cause}).") from None
    if not len(vertices) or not np.isfinite(vertices).all():
        raise ModelError(f"{what}: mesh {path} has no vertices, or some that are not finite.")
    return vertices
