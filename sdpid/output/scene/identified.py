"""A robot as its report shows it: the recorded motion, and inertia ellipsoids of its links."""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.processing.samples import Samples
from sdpid.output.scene.contents import Ellipsoid, Group, inertia_ellipsoid, recorded_motion
from sdpid.output.scene.scene import Scene, grid, robot_scene
from sdpid.output.scene.surfaces import described_surfaces
from sdpid.robot.model.model import RobotModel

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
