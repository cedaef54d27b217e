"""What a scene shows: groups, a motion, inertia ellipsoids, and a picture where nothing plays it.

A uniform solid ellipsoid of mass m has the second-moment matrix ``m/5·A·A^T`` about its center,
where the columns of A are its semi-axes. So the semi-axes of the ellipsoid of a body are the
eigenvectors of its second-moment matrix, of lengths ``sqrt(5·λ/m)``; it exists exactly for bodies
that are physically consistent. Of a plate or a rod one or two lengths are zero.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, Indices, frozen
from sdpid.experiment.processing.samples import Samples
from sdpid.output.scene.surfaces import Surface, thinned
from sdpid.robot.inertia import physical_parameters, second_moment_from_inertia
from sdpid.robot.model.geometry import link_placements
from sdpid.robot.model.model import RobotModel

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

# Triangles that are drawn: half of them face away.
_TRIANGLES = 3000

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
    few = thinned(surfaces, _TRIANGLES)
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
