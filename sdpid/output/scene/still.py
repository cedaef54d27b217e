"""The picture that stands where no player runs: on paper, without scripts or without WebGL."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence

import numpy as np

from sdpid._common.arrays import Array
from sdpid.output.scene.contents import Group
from sdpid.output.scene.ellipsoids import Ellipsoid
from sdpid.output.scene.surfaces import Surface, thinned

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
    seen = [_seen(each.points, placements[each.link], turned) for each in few]
    outlines = [(key, _outline(each, placements[link], turned)) for link, key, each in ellipsoids]
    joints = _seen(placements[:, :3, 3], np.eye(4), turned)
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
        own = [(each, at) for each, at in zip(few, seen, strict=True) if each.group == group.key]
        lines += [f'<path color="{c}" {path(points)}/>' for points, c in _painted(own, group.color)]
        lines.append("</g>")
    for group in groups:
        paint = f'fill="{group.color}" fill-opacity="{group.filled:g}" stroke="{group.color}"'
        dashed = ' stroke-width="4" stroke-dasharray="10 6"' if group.filled == 0.0 else ""
        lines += [f"<path {paint}{dashed} {path(o)}/>" for key, o in outlines if key == group.key]
    text = "\n".join([*lines, "</svg>"])
    return f"data:image/svg+xml;base64,{base64.b64encode(text.encode()).decode('ascii')}"


def _painted(own: Sequence[tuple[Surface, Array]], color: str) -> Iterator[tuple[Array, str]]:
    """Yield the triangles of surfaces from far to near, and their colors."""
    corners = [seen[each.faces] for each, seen in own]
    if not corners:
        return
    colors = [each.color or color for each, _ in own for _ in each.faces]
    triangles = np.concatenate(corners)
    sides = triangles[:, 1:] - triangles[:, :1]
    normals = np.cross(sides[:, 0], sides[:, 1])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    normals *= np.where(normals[:, 2:] < 0.0, -1.0, 1.0)
    light = 0.45 + 0.55 * np.maximum(normals @ _LIGHT, 0.0)
    for k in np.argsort(triangles[:, :, 2].mean(axis=1), kind="stable"):
        yield triangles[k], _shaded(colors[k], float(light[k]))


def _shaded(color: str, light: float) -> str:
    """Return a color ``#rrggbb`` darkened by a factor, in steps that the eye does not see."""
    values = (int(color[k : k + 2], 16) for k in (1, 3, 5))
    return "#" + "".join(f"{min(round(value * light), 255):02x}" for value in values)


def view(yaw: float, pitch: float) -> Array:
    """Return the rotation into the frame of the view: right, up, toward the eye."""
    cy, sy, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    return np.array([[-sy, cy, 0.0], [-sp * cy, -sp * sy, cp], [cp * cy, cp * sy, sp]])


def _seen(points: Array, placement: Array, view: Array) -> Array:
    """Return points of a link in the frame of the view, (N, 3)."""
    return np.asarray((points @ placement[:3, :3].T + placement[:3, 3]) @ view.T)


def _outline(ellipsoid: Ellipsoid, placement: Array, view: Array) -> Array:
    """Return the outline of an ellipsoid as it is seen, (N, 2): the image of a ball's."""
    flat = (view @ placement[:3, :3] @ ellipsoid.axes)[:2]
    sides, lengths, _ = np.linalg.svd(flat)
    angles = np.linspace(0.0, 2.0 * np.pi, _OUTLINE + 1)[:-1]
    ring = np.stack([lengths[0] * np.cos(angles), lengths[1] * np.sin(angles)], axis=-1)
    return np.asarray(ring @ sides.T + _seen(ellipsoid.center[None], placement, view)[0, :2])
