"""Shapes of a robot's links as its URDF describes them: primitives, and meshes from files."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any
from urllib.parse import unquote

import numpy as np

from sdpid._common.arrays import Array, Indices, frozen
from sdpid.errors import ModelError
from sdpid.robot.description.catalog import example_robots
from sdpid.robot.description.xml import read_numbers, read_origin

# Sides of the prism around a cylinder: its corners stand out by 2 % of the radius.
_SIDES = 16

_LENGTHS = {
    "sphere": ("radius",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
}

# Circumscribed shapes are grown by this share, so that rounding does not let the true shape out.
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class Shape:
    """A shape of a link.

    Attributes
    ----------
    kind : str
        ``"box"``, ``"sphere"``, ``"cylinder"``, ``"capsule"`` or ``"mesh"``.
    sizes : ndarray
        Edges of a box (3,), radius of a sphere (1,), radius and length of a cylinder or of a
        capsule's straight part, along z (2,), m; empty for a mesh.
    vertices : ndarray, shape (N, 3)
        Vertices of a mesh in the frame of the shape, m; empty for other kinds.
    placement : ndarray, shape (4, 4)
        The shape's frame in the frame of the link.
    mesh : Any
        Coal's surface of a mesh from a file (see `mesh_faces`); None for other kinds, and hulls.
    """

    kind: str
    sizes: Array = field(default_factory=lambda: np.empty(0))
    vertices: Array = field(default_factory=lambda: np.empty((0, 3)))
    placement: Array = field(default_factory=lambda: np.eye(4))
    mesh: Any = None

    def __post_init__(self) -> None:
        for name in ("sizes", "vertices", "placement"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    def points(self) -> Array:
        """Return points in the frame of the link whose convex hull contains the shape, (N, 3)."""
        if self.kind == "box":
            signs = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), axis=-1).reshape(-1, 3)
            own = signs * self.sizes
        elif self.kind == "sphere":
            own = self.sizes[0] * _unit_ball()
        elif self.kind == "cylinder":
            own = _prism(*self.sizes)
        elif self.kind == "capsule":
            end = np.array([0.0, 0.0, 0.5 * self.sizes[1]])
            ball = self.sizes[0] * _unit_ball()
            own = np.concatenate([ball - end, ball + end])
        else:
            own = self.vertices
        return np.asarray(own @ self.placement[:3, :3].T + self.placement[:3, 3])


def link_shapes(element: Any, kind: str, robot: str, folders: Sequence[Path]) -> list[Shape]:
    """Return the shapes of a URDF's ``<link>``, in its frame.

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

    Raises
    ------
    ModelError
        When a shape is not understood, or a mesh cannot be found or read.
    """
    shapes = []
    for shape in element.findall(kind):
        what = f"'{robot}', link '{element.get('name')}', {kind} geometry"
        placement = read_origin(shape, f"{what}: <origin>")
        shapes.append(_shape(shape.find("geometry"), placement, what, folders))
    return shapes


def _sizes(element: Any, keys: Sequence[str], what: str) -> Array:
    """Return the lengths in some attributes."""
    where = f"{what}: <{element.tag}>"
    sizes = np.array([read_numbers(element, key, where, "", 1)[0] for key in keys])
    if (sizes < 0.0).any():
        raise ModelError(f"{where} has a size of {sizes.min()} m, the least is 0.")
    return sizes


def _shape(geometry: Any, placement: Array, what: str, folders: Sequence[Path]) -> Shape:
    shapes = [] if geometry is None else [e for e in geometry if isinstance(e.tag, str)]
    if len(shapes) != 1:
        raise ModelError(f"{what}: {len(shapes)} shapes in <geometry>, a URDF has one.")
    shape = shapes[0]
    place: dict[str, Any] = {"placement": placement}
    if shape.tag == "box":
        return Shape("box", read_numbers(shape, "size", f"{what}: <box>", ""), **place)
    if shape.tag in _LENGTHS:
        return Shape(shape.tag, _sizes(shape, _LENGTHS[shape.tag], what), **place)
    if shape.tag == "mesh":
        path = _find_mesh(shape.get("filename", ""), what, folders)
        scale = read_numbers(shape, "scale", f"{what}: <mesh>", "1 1 1")
        mesh, vertices = read_mesh(path, scale, what)
        return Shape("mesh", vertices=vertices, mesh=mesh, **place)
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


def hull_faces(points: Array) -> Indices:
    """Return the triangles of the convex hull of points, (M, 3), counterclockwise from outside."""
    from scipy.spatial import ConvexHull

    # Joggled: a plate has faces, too, and faces of hundreds of corners would be cut into fans from
    # one of them, of which Coal takes at most 255; what this shifts is far below any accuracy.
    hull = ConvexHull(points, qhull_options="QJ")
    a, b, c = np.moveaxis(points[hull.simplices], 1, 0)
    # Qhull's triangles face any way.
    inward = np.einsum("mi,mi->m", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    return np.asarray(np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices))


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


def collision_library() -> ModuleType:
    """Return Coal, the library of collisions and distances that comes with Pinocchio."""
    # Old releases have it under its old name.
    import pinocchio  # noqa: F401 - brings the converters of the arrays

    for name in ("coal", "hppfcl"):
        try:
            return importlib.import_module(name)
        except ImportError:
            continue
    raise ModelError("shapes need the library coal, which comes with the package pin.")


def read_mesh(path: Path, scale: Array, what: str) -> tuple[Any, Array]:
    """Return the mesh of a file as Coal's surface of triangles, and its vertices (N, 3) in m.

    Raises
    ------
    ModelError
        When the file cannot be read, or a vertex is not finite; `what` names its owner.
    """
    try:
        mesh: Any = collision_library().MeshLoader().load(str(path), scale)
        vertices = np.array(mesh.vertices(), dtype=np.float64).reshape(-1, 3)
    except (RuntimeError, ValueError, TypeError) as cause:
        raise ModelError(f"{what}: mesh {path} cannot be read ({cause}).") from None
    if not len(vertices) or not np.isfinite(vertices).all():
        raise ModelError(f"{what}: mesh {path} has no vertices, or some that are not finite.")
    return mesh, vertices


def mesh_faces(mesh: Any) -> Indices:
    """Return the corners of the triangles of Coal's surface as indices of vertices, (M, 3)."""
    triangles = (mesh.tri_indices(k) for k in range(mesh.num_tris))
    return np.array([(t[0], t[1], t[2]) for t in triangles], dtype=np.int64).reshape(-1, 3)
