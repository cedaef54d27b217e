"""`Scene`: a robot in three dimensions as a part of a page, with what its player needs.

A uniform solid ellipsoid of mass m has the second-moment matrix ``m/5·A·A^T`` about its center,
where the columns of A are its semi-axes. So the semi-axes of the ellipsoid of a body are the
eigenvectors of its second-moment matrix, of lengths ``sqrt(5·λ/m)``; it exists exactly for bodies
that are physically consistent. Of a plate or a rod one or two lengths are zero.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, Indices, frozen
from sdpid._common.extras import require
from sdpid.excitation.geometry.solids import assumed_radius, assumed_shapes
from sdpid.experiment.processing.samples import Samples
from sdpid.output.charts.page import beside, packed, packed_indices, rendered
from sdpid.robot.inertia import physical_parameters, second_moment_from_inertia
from sdpid.robot.model.geometry import described_links, described_shapes, link_placements
from sdpid.robot.model.model import RobotModel
from sdpid.robot.model.shapes import Shape, hull_faces, mesh_faces

# Cells of the finest grid along the robot: what is nearer than a cell becomes one corner.
_FINEST = 2000.0

# Corners farther away than this are no robot's, m.
_FARTHEST = 1e3

# Radius of capsules where a robot is too short to tell one, m.
_LEAST_RADIUS = 0.01

# Factors by which cells grow until few enough triangles are left.
_LEAST_STEP, _LARGEST_STEP = 1.15, 2.0


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles that move with a link.

    Attributes
    ----------
    link : int
        The moving link, -1 for what stands still.
    points : ndarray, shape (N, 3)
        Corners in the link's joint frame, m.
    faces : ndarray of int, shape (M, 3)
        Corners of the triangles.
    group : str
        The key of the group that it is shown and hidden with.
    color : str
        ``#rrggbb``; empty for that of the group.
    """

    link: int
    points: Array
    faces: Indices
    group: str = "links"
    color: str = ""


def described_surfaces(robot: RobotModel) -> tuple[list[Surface], tuple[str, ...]]:
    """Return the surfaces of a robot's links as its description has them, and what was assumed.

    Visual shapes are taken where a link has some that can be read, else collision shapes. Links
    whose shapes cannot be read, and all links of a robot without any, become capsules.

    Parameters
    ----------
    robot : RobotModel
        The robot; meshes are looked up as `load_robot` found its description.

    Returns
    -------
    surfaces : list of Surface
    notes : tuple of str
        Sentences.
    """
    links = described_links(robot)
    folders = [] if robot.folder is None else [robot.folder]
    surfaces: list[Surface] = []
    missing: list[str] = []
    for each in links:
        kinds = ("visual", "collision")
        shapes, _, lacks = described_shapes([each], kinds, robot.name, folders)
        drawn = [surface_of(shape, each.joint - 1) for shape in shapes]
        surfaces += (fit := [surface for surface in drawn if _drawable(surface)])
        if lacks or len(fit) < len(drawn):
            missing.append(each.name)
            surfaces += _capsules(robot, each.joint)
    if not surfaces:
        for joint in range(robot.n_links + 1):
            surfaces += _capsules(robot, joint)
        why = "is no URDF, so its shapes are not read" if robot.urdf is None else "has no shapes"
        return surfaces, (f"The description {why}: links are drawn as capsules between joints.",)
    if not missing:
        return surfaces, ()
    return surfaces, (
        f"Shapes were not found, or make no picture, of {', '.join(dict.fromkeys(missing))}: "
        "capsules stand for them.",
    )


def surface_of(shape: Shape, link: int) -> Surface:
    """Return the surface of a shape: a mesh's triangles, the convex hull of anything else."""
    if shape.mesh is None:
        return Surface(link, *hull(shape.points()))
    return Surface(link, shape.points(), mesh_faces(shape.mesh))


def hull(points: Array) -> tuple[Array, Indices]:
    """Return corners and outward triangles of the convex hull of points; none of a single one."""
    from scipy.spatial import QhullError

    nothing = np.empty((0, 3), dtype=np.intp)
    if not np.ptp(points, axis=0).any():
        return points, nothing
    try:
        used, faces = np.unique(hull_faces(points), return_inverse=True)
    except (QhullError, ValueError):
        return points, nothing
    return points[used], faces.reshape(-1, 3)


def thinned(surfaces: Sequence[Surface], most: int) -> list[Surface]:
    """Return surfaces of at most so many triangles together, coarse alike.

    Corners within a cell of a grid become their mean [rossignac1993]_; the cells grow until few
    enough triangles are left.
    """
    if not surfaces:
        return []
    spans = [np.ptp(each.points, axis=0).max(initial=0.0) for each in surfaces]
    cell = max(float(np.max(spans)), 1e-6) / _FINEST
    found = [_clustered(each, cell) for each in surfaces]
    while (count := sum(len(each.faces) for each in found)) > most:
        cell *= float(np.clip(np.sqrt(count / most), _LEAST_STEP, _LARGEST_STEP))
        found = [_clustered(each, cell) for each in surfaces]
    return [each for each in found if len(each.faces)]


def _clustered(surface: Surface, cell: float) -> Surface:
    """Return a surface with one corner a cell, without triangles that this leaves flat or twice."""
    places = np.floor((surface.points - surface.points.min(axis=0)) / cell).astype(np.int64)
    sizes = places.max(axis=0) + 1
    keys = (places[:, 0] * sizes[1] + places[:, 1]) * sizes[2] + places[:, 2]
    cells, owner, counts = np.unique(keys, return_inverse=True, return_counts=True)
    owner = owner.reshape(-1)
    points = np.stack(
        [np.bincount(owner, column, len(cells)) / counts for column in surface.points.T], axis=-1
    )
    faces = owner[surface.faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    # One number of three indices below `count`, of at most two million.
    count = len(cells)
    numbers = np.sort(faces, axis=1) @ np.array([count * count, count, 1])
    _, kept = np.unique(numbers, return_index=True)
    used, faces = np.unique(faces[np.sort(kept)], return_inverse=True)
    return replace(surface, points=points[used], faces=faces.reshape(-1, 3))


def _drawable(surface: Surface) -> bool:
    """Return whether a surface has triangles, and those near the robot."""
    return len(surface.faces) > 0 and bool(np.abs(surface.points).max() < _FARTHEST)


def _capsules(robot: RobotModel, joint: int) -> list[Surface]:
    """Return what stands for the link that a joint moves, or for the base at 0."""
    radius = max(assumed_radius(robot), _LEAST_RADIUS)
    return [surface_of(shape, joint - 1) for shape in assumed_shapes(robot, joint, radius)]


_HERE = "sdpid.output.scene"

# Triangles of all surfaces: 0.4 MB of page.
_TRIANGLES = 24000

# Yaw and pitch of the first view, rad.
_EYE = (-0.9, 0.42)

# Distances at which one meter across, and up, still fits, m: the lens is the player's, and pages
# are wider than high.
_ACROSS, _UP = 2.2, 3.4

# Lines of a square's grid on either side of its middle.
_GRID = 5

# Least semi-axis of an ellipsoid that is drawn, as a share of the scene.
_THIN = 2e-3

# Half a size below which nothing is a robot, m.
_LEAST_SIZE = 0.05

# Frames a second: the player blends between them.
FRAME_RATE = 25.0

# Share of a frame by which a recording may end before it.
_ROUNDING = 1e-6

# Frames of a recording: its first minute.
_MOST = 1500


@dataclass(frozen=True)
class Group:
    """What is shown and hidden together.

    Attributes
    ----------
    key : str
        Short name of letters.
    name : str
        What it is called beside the picture; groups without a name have no switch.
    color : str
        ``#rrggbb``.
    opacity : float
        Of surfaces; below one, what lies within is seen through them.
    filled : float
        Opacity of ellipsoids but for their rims, which are dashed in the picture without a player
        where this is zero.
    """

    key: str
    name: str
    color: str
    opacity: float = 1.0
    filled: float = 0.3


@dataclass(frozen=True, eq=False)
class ShownMotion:
    """Positions on an even grid.

    Attributes
    ----------
    rate_hz : float
        Frames per second.
    position : ndarray, shape (F, n) or (F, nq)
        Joint positions, configurations with a floating base; F is at least one.
    note : str
        What part of a recording it is, a sentence; may be empty.
    sample : ndarray of int, shape (F,), optional
        The recorded sample that each frame is.
    """

    rate_hz: float
    position: Array
    note: str = ""
    sample: Indices | None = None

    def placements(self, robot: RobotModel) -> Array:
        """Return the placements of the links' joint frames, shape (F, links, 4, 4)."""
        return np.stack([link_placements(robot, q) for q in self.position])


def recorded_motion(samples: Samples) -> ShownMotion:
    """Return the first minute of a motion that was recorded, pieces one after the other."""
    if samples.time is None:
        position = samples.position[:_MOST]
        told = f"The recording has no stamps: {FRAME_RATE:g} samples are played a second"
        if len(position) < samples.n_samples:
            told += f", the first {len(position):,} of {samples.n_samples:,}"
        return ShownMotion(FRAME_RATE, position, f"{told}.", np.arange(len(position)))
    # Seconds of play: pieces follow each other without a break.
    steps = np.diff(samples.time, prepend=samples.time[0])
    usual = float(np.median(steps[1:])) if len(steps) > 1 else 1.0 / FRAME_RATE
    steps[list(samples.starts)] = usual
    steps[0] = 0.0
    played = np.cumsum(np.maximum(steps, 0.0))
    rate = min(FRAME_RATE, 1.0 / usual) if usual > 0.0 else FRAME_RATE
    frames = np.arange(int(played[-1] * rate + _ROUNDING) + 1) / rate
    nearest = np.searchsorted(played, frames[:_MOST] - 0.5 * usual).clip(0, len(played) - 1)
    seconds = min(frames[-1], (_MOST - 1) / rate)
    told = ""
    if len(frames) > _MOST:
        told = f"The first {seconds:.0f} s of {played[-1]:.0f} s are played."
    return ShownMotion(rate, samples.position[nearest], told, nearest)


# Second moments negative by less than this share of the body's largest about its frame's origin
# are zero: the shift to the center of mass cancels, and solvers end as near to a boundary.
_ZERO = 1e-9


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """A solid ellipsoid.

    Attributes
    ----------
    center : ndarray, shape (3,)
        In the body's frame, m.
    rotation : ndarray, shape (3, 3)
        Directions of the semi-axes as columns.
    lengths : ndarray, shape (3,)
        Of the semi-axes, m, from the shortest.
    """

    center: Array
    rotation: Array
    lengths: Array

    @property
    def axes(self) -> Array:
        """The semi-axes as columns, shape (3, 3), m."""
        return np.asarray(self.rotation * self.lengths)


def inertia_ellipsoid(body: ArrayLike) -> Ellipsoid | None:
    """Return the uniform ellipsoid of a body's inertia; None for one that cannot exist.

    Parameters
    ----------
    body : array_like, shape (10,)
        Inertial parameters in the order of `sdpid.robot.inertia`.
    """
    theta = np.asarray(body, dtype=np.float64)
    if not np.isfinite(theta).all() or theta[0] <= 0.0:
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        mass, center, inertia = physical_parameters(theta)
        moments = second_moment_from_inertia(inertia)
        largest = float(np.abs(moments).max() + mass * center @ center)
    if not np.isfinite(largest):
        return None
    values, axes = np.linalg.eigh(moments)
    if values[0] < -_ZERO * largest:
        return None
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    with np.errstate(over="ignore"):
        lengths = np.sqrt(5.0 * (np.maximum(values, 0.0) / mass))
    if not np.isfinite(lengths).all():
        return None
    return Ellipsoid(frozen(center), frozen(axes), frozen(lengths))


# Size of the picture in its own units, some two a pixel, and the share of it that the robot takes.
_WIDTH, _HEIGHT, _FILLED = 1920, 1080, 0.94

# Triangles of the picture: half of them face away.
_STILL_TRIANGLES = 3000

# Points of an ellipsoid's outline.
_OUTLINE = 60

# From where light comes, in the frame of the view: right, up, toward the eye.
_LIGHT = np.array([0.35, 0.75, 0.55]) / np.linalg.norm([0.35, 0.75, 0.55])


def still_picture(
    groups: Sequence[Group],
    surfaces: Sequence[Surface],
    ellipsoids: Sequence[tuple[int, str, Ellipsoid]],
    placements: Array,
    eye: tuple[float, float],
) -> str:
    """Return links and ellipsoids as a data URI with an SVG, in parallel projection.

    Parameters
    ----------
    groups : sequence of Group
        In the order in which they are painted.
    surfaces : sequence of Surface
        Painted from far to near.
    ellipsoids : sequence of (link, key of the group, Ellipsoid)
        Painted after the surfaces.
    placements : ndarray, shape (links + 1, 4, 4)
        Of the links' joint frames, last of what stands still.
    eye : (float, float)
        Yaw and pitch of the view, rad.
    """
    turned = view(*eye)
    few = thinned(surfaces, _STILL_TRIANGLES)
    seen = [moved(each.points, placements[each.link]) @ turned.T for each in few]
    outlines = [(key, _outline(each, placements[link], turned)) for link, key, each in ellipsoids]
    joints = placements[:, :3, 3] @ turned.T
    every = np.concatenate([*(each[:, :2] for each in (*seen, joints)), *(o for _, o in outlines)])
    low, high = every.min(axis=0), every.max(axis=0)
    scale = _FILLED * float(np.min([_WIDTH, _HEIGHT] / np.maximum(high - low, 1e-6)))
    middle = 0.5 * (low + high)

    def path(points: Array) -> str:
        flat = (points[:, :2] - middle) * [scale, -scale] + [0.5 * _WIDTH, 0.5 * _HEIGHT]
        (x, y), *steps = np.diff(np.rint(flat), axis=0, prepend=0.0).astype(int).tolist()
        return f'd="M{x} {y}l{" ".join(f"{dx} {dy}" for dx, dy in steps)}z"'

    lines = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}">']
    for group in groups:
        paint = 'fill="currentColor" stroke="currentColor" stroke-linejoin="round"'
        lines.append(f'<g {paint} opacity="{group.opacity:g}">')
        own = [
            (each.color or group.color, points[each.faces])
            for each, points in zip(few, seen, strict=True)
            if each.group == group.key
        ]
        triangles = np.concatenate([np.empty((0, 3, 3)), *(corners for _, corners in own)])
        colors, lights = [color for color, corners in own for _ in corners], _lights(triangles)
        # From far to near.
        for k in np.argsort(triangles[:, :, 2].mean(axis=1), kind="stable"):
            lines.append(f'<path color="{_shaded(colors[k], lights[k])}" {path(triangles[k])}/>')
        lines.append("</g>")
    for group in groups:
        paint = f'fill="{group.color}" fill-opacity="{group.filled:g}" stroke="{group.color}"'
        dashed = ' stroke-width="4" stroke-dasharray="10 6"' if group.filled == 0.0 else ""
        lines += [f"<path {paint}{dashed} {path(o)}/>" for key, o in outlines if key == group.key]
    text = "\n".join([*lines, "</svg>"])
    return f"data:image/svg+xml;base64,{base64.b64encode(text.encode()).decode('ascii')}"


def _lights(triangles: Array) -> Array:
    """Return how light triangles (M, 3, 3) are, whichever way they face."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    normals *= np.where(normals[:, 2:] < 0.0, -1.0, 1.0)
    return np.asarray(0.45 + 0.55 * np.maximum(normals @ _LIGHT, 0.0))


def _shaded(color: str, light: float) -> str:
    """Return a color ``#rrggbb`` darkened by a factor, in steps that the eye does not see."""
    values = (int(color[k : k + 2], 16) for k in (1, 3, 5))
    return "#" + "".join(f"{min(round(value * light), 255):02x}" for value in values)


def view(yaw: float, pitch: float) -> Array:
    """Return the rotation into the frame of the view: right, up, toward the eye."""
    cy, sy, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    return np.array([[-sy, cy, 0.0], [-sp * cy, -sp * sy, cp], [cp * cy, cp * sy, sp]])


def moved(points: Array, placements: Array) -> Array:
    """Return points (N, 3) of a link in the base frame, for placements (…, 4, 4)."""
    turns, ways = placements[..., :3, :3], placements[..., None, :3, 3]
    return np.asarray(points @ np.swapaxes(turns, -1, -2) + ways)


def _outline(ellipsoid: Ellipsoid, placement: Array, view: Array) -> Array:
    """Return the outline of an ellipsoid as it is seen, (N, 2): the image of a ball's."""
    flat = (view @ placement[:3, :3] @ ellipsoid.axes)[:2]
    sides, lengths, _ = np.linalg.svd(flat)
    angles = np.linspace(0.0, 2.0 * np.pi, _OUTLINE + 1)[:-1]
    ring = np.stack([lengths[0] * np.cos(angles), lengths[1] * np.sin(angles)], axis=-1)
    middle = view @ moved(ellipsoid.center[None], placement)[0]
    return np.asarray(ring @ sides.T + middle[:2])


@dataclass(frozen=True, eq=False)
class Line:
    """Points (N, 3) in the base frame that are joined one to the next, or two by two."""

    points: Array
    pairs: bool = False


def grid(middle: Array, sides: Array) -> Line:
    """Return the lines of a square from its middle (3,) and its half sides as rows (2, 3)."""
    steps = np.linspace(-1.0, 1.0, 2 * _GRID + 1)
    ends = [pair for s in steps for pair in ((s, -1.0), (s, 1.0), (-1.0, s), (1.0, s))]
    return Line(middle + np.array(ends) @ sides, pairs=True)


@dataclass(frozen=True)
class Scene:
    """A part of a page.

    Attributes
    ----------
    markup : str
        The picture with its controls and data, safe to put into a page.
    style : str
        What the markup needs of the page's style.
    script : str
        The player, to run after the markup.
    """

    markup: str
    style: str
    script: str


def robot_scene(
    robot: RobotModel,
    motion: ShownMotion,
    groups: Sequence[Group],
    surfaces: Sequence[Surface],
    *,
    label: str,
    ellipsoids: Sequence[tuple[int, str, Ellipsoid]] = (),
    lines: Sequence[Line] = (),
    distances: dict[str, Any] | None = None,
    instants: Array | None = None,
    notes: Sequence[str] = (),
) -> Scene:
    """Return a robot that moves, as a part of a page that loads nothing.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    motion : ShownMotion
        What is played.
    groups : sequence of Group
        In the order in which they are painted.
    surfaces : sequence of Surface
        At least one; together at most 24,000 triangles of them are drawn.
    label : str
        What the picture shows, for who does not see it.
    ellipsoids : sequence of (link, key of the group, Ellipsoid)
        Inertia ellipsoids.
    lines : sequence of Line
        Lines that stand still.
    distances : dict, optional
        ``pairs``: names; ``frames``: for each frame the nearest pair and its distance, m.
    instants : ndarray, shape (F,), optional
        Where each frame is on the charts of the page; by default they begin at zero.
    notes : sequence of str
        Sentences below the picture.

    Raises
    ------
    MissingExtraError
        When jinja2 is not installed (extra ``report``).
    """
    placements = motion.placements(robot)
    still = np.broadcast_to(np.eye(4), (len(placements), 1, 4, 4))
    placements = np.concatenate([placements, still], axis=1)
    # A floating base is followed: the view is as wide as if it stayed in place.
    around = placements.copy()
    if robot.free_flyer:
        around[:, :-1, :3, 3] -= (placements[:, 0, :3, 3] - placements[0, 0, :3, 3])[:, None]
    center, size, distance = _extent(surfaces, ellipsoids, around)
    few = thinned(surfaces, _TRIANGLES)
    data = {
        "center": center.tolist(),
        "size": size,
        "eye": [*_EYE, distance],
        "follow": robot.free_flyer,
        "groups": [vars(each) for each in groups],
        "surfaces": [
            vars(each) | {"points": packed(each.points), "faces": packed_indices(each.faces)}
            for each in few
        ],
        "ellipsoids": [
            {
                "link": link,
                "group": key,
                "center": each.center.tolist(),
                "axes": each.rotation.T.tolist(),
                # None too thin to be seen.
                "lengths": np.maximum(each.lengths, _THIN * size).tolist(),
            }
            for link, key, each in ellipsoids
        ],
        "lines": [vars(each) | {"points": packed(each.points)} for each in lines],
        "frames": {
            "rate": motion.rate_hz,
            "count": len(placements),
            "poses": packed(_poses(placements[:, :-1])),
            "q": packed(motion.position),
            "instants": None if instants is None else packed(instants[:, None]),
        },
        "distances": distances,
    }
    markup = require("markupsafe", extra="report").Markup
    # No "<" may end the element early.
    text = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    shown = rendered(
        _HERE,
        "scene.html.j2",
        data=markup(text),
        groups=[each for each in groups if each.name],
        picture=still_picture(groups, few, ellipsoids, placements[0], _EYE),
        label=label,
        notes=notes,
        seconds=(len(placements) - 1) / motion.rate_hz,
    )
    return Scene(shown, *(markup(beside(_HERE, name)) for name in ("scene.css", "player.js")))


def _extent(
    surfaces: Sequence[Surface],
    ellipsoids: Sequence[tuple[int, str, Ellipsoid]],
    placements: Array,
) -> tuple[Array, float, float]:
    """Return middle and half diagonal of all links over time, and the first view's distance, m."""
    seen = [placements[:, :-1, :3, 3].reshape(-1, 3)]
    for each in surfaces:
        if each.group == "links":
            ends = np.stack([each.points.min(axis=0), each.points.max(axis=0)])
            corners = np.stack(np.meshgrid(*ends.T), axis=-1).reshape(-1, 3)
            seen.append(moved(corners, placements[:, each.link]).reshape(-1, 3))
    for link, _, ellipsoid in ellipsoids:
        ends = ellipsoid.center + np.vstack([ellipsoid.axes.T, -ellipsoid.axes.T])
        seen.append(moved(ends, placements[:, link]).reshape(-1, 3))
    every = np.concatenate(seen)
    low, high = every.min(axis=0), every.max(axis=0)
    across, up, back = view(*_EYE) @ (every - 0.5 * (low + high)).T
    distance = float(np.max(np.maximum(_ACROSS * np.abs(across), _UP * np.abs(up)) + back))
    size = float(np.linalg.norm(high - low)) / 2.0
    return 0.5 * (low + high), max(size, _LEAST_SIZE), max(distance, _LEAST_SIZE)


def _poses(placements: Array) -> Array:
    """Return position and quaternion (x, y, z, w) of links, shape (F·links, 7)."""
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_matrix(placements[..., :3, :3].reshape(-1, 3, 3)).as_quat()
    return np.concatenate([placements[..., :3, 3].reshape(-1, 3), turns], axis=-1)


# Groups of a report's scene.
_GROUPS = (
    Group("links", "links", "#8d99a6", 0.45),
    Group("identified", "inertia as identified", "#0072b2", filled=0.35),
    Group("described", "inertia as described", "#e69f00", filled=0.0),
)

# Ellipsoids that reach farther than this many lengths of the arm from their link are not drawn.
_FAR = 2.0

# What is told of links without an ellipsoid: their names, and what is far, m.
_BARE = "has no inertia of {0}."
_WRONG = "has inertias that no body can have of {0}: there is no ellipsoid to draw."
_LARGE = (
    "has ellipsoids that reach farther than {1:.2g} m from their joint, which are not drawn: {0}."
)

# What a picture of ellipsoids is.
_MEANING = (
    "An ellipsoid is the uniform solid of the same mass, center of mass and inertia as its link. "
    "Efforts tell base parameters only; what they leave open of a link is the prior's, or the "
    "solver's choice."
)


def identified_scene(
    robot: RobotModel, samples: Samples, theta: Array | None, instants: Array | None = None
) -> Scene:
    """Return the robot along its recorded motion, with inertia ellipsoids of its links.

    Parameters
    ----------
    robot : RobotModel
        Its description's inertias are compared with the identified ones.
    samples : Samples
        The recorded motion.
    theta : ndarray, shape (p,), optional
        Identified parameters, link by link, friction last.
    instants : ndarray, shape (K,), optional
        Where the samples are on the charts of the page.
    """
    surfaces, notes = described_surfaces(robot)
    motion = recorded_motion(samples)
    bodies = {} if theta is None else {"identified": theta[: 10 * robot.n_links].reshape(-1, 10)}
    bodies["described"] = robot.prior
    reach = max(robot.reach, *(float(np.abs(each.points).max()) for each in surfaces))
    drawn: list[tuple[int, str, Ellipsoid]] = []
    told: list[str] = []
    for key, own in bodies.items():
        whose = "The description" if key == "described" else "The estimate"
        # Links without an ellipsoid, by what is told of them.
        names: dict[str, list[str]] = {_BARE: [], _WRONG: [], _LARGE: []}
        for link, (name, body) in enumerate(zip(robot.link_names, own, strict=True)):
            if not np.any(body):
                names[_BARE].append(name)
            elif (found := inertia_ellipsoid(body)) is None:
                names[_WRONG].append(name)
            elif np.linalg.norm(found.center) + found.lengths[-1] > _FAR * reach:
                names[_LARGE].append(name)
            else:
                drawn.append((link, key, found))
        told += [
            f"{whose} {text.format(', '.join(each), _FAR * reach)}"
            for text, each in names.items()
            if each
        ]
    both = "the description and the estimate" if len(bodies) > 1 else "the description"
    return robot_scene(
        robot,
        motion,
        [each for each in _GROUPS if each.key == "links" or each.key in bodies],
        surfaces,
        label=f"{robot.name} along the recorded motion, with the inertia ellipsoids of {both}",
        ellipsoids=drawn,
        instants=None if instants is None else instants[motion.sample],
        lines=[] if robot.free_flyer else [grid(np.zeros(3), 0.7 * reach * np.eye(3)[:2])],
        notes=[*told, *(each for each in (*notes, motion.note, _MEANING) if each)],
    )
