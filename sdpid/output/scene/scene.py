"""`Scene`: a robot in three dimensions as a part of a page, with what its player needs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.extras import require
from sdpid.output.charts.charts import packed, packed_indices
from sdpid.output.charts.page import beside, rendered
from sdpid.output.scene.contents import Ellipsoid, Group, ShownMotion, moved, still_picture, view
from sdpid.output.scene.surfaces import Surface, thinned
from sdpid.robot.model.model import RobotModel

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
