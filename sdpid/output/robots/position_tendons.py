"""Friction over position as tendons of MuJoCo.

A tendon from a site on a link to a site on the next one has the length L(q); its dry friction F
turns into the torque F·abs(dL/dq) at the joint. With the sites at distances 1 m and b from the
axis, and the joint's angle θ = q − q0 between them, dL/dq = b·sin(θ)/L: nearly a sine where b is
short, and sharply bent where it is not. A few tendons with different q0 and b beside the joint's
own dry friction make any friction that bends slowly over the position.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from sdpid._common.arrays import Array
from sdpid.robot.description.xml import numbers
from sdpid.robot.friction.posed import PositionFriction
from sdpid.robot.model.model import RobotModel

# Distances (m) b that are tried. The longest lever of a tendon is b.
_NEAR = (0.1, 0.5, 0.8)

# Angles q0 that are tried, and positions at which friction is compared.
_ANGLES, _POSITIONS = 72, 41

# MuJoCo scales the softness of friction by the lever where all joints are at zero: tendons with
# less than this share of the longest lever there would be far too stiff.
_LEAST_LEVER = 0.3

# Rounds of nonnegative least squares: columns are much alike.
_MOST_ROUNDS = 10_000

# Tendons are left out as long as friction stays within this share of its largest level.
_LITTLE = 0.02


class BentFriction(NamedTuple):
    """Friction over the position of one joint: the joint's own, and tendons' (b, q0, friction)."""

    own: float
    tendons: tuple[tuple[float, float, float], ...]
    error: float
    mean: float


def lever(position: Array, near: Array | float, angle: Array | float) -> Array:
    """Return abs(dL/dq), m."""
    theta = position - angle
    return np.asarray(
        np.abs(near * np.sin(theta)) / np.sqrt(1 + near**2 - 2 * near * np.cos(theta))
    )


def bent_friction(term: PositionFriction, values: Array) -> list[BentFriction]:
    """Return the tendons of every joint that fit its friction best over its range.

    Parameters
    ----------
    term : PositionFriction
        The term.
    values : ndarray, shape (3·n,)
        Its parameters.
    """
    found = []
    near, angles = (
        x.ravel() for x in np.meshgrid(_NEAR, np.linspace(-np.pi, np.pi, _ANGLES, endpoint=False))
    )
    usable = lever(np.zeros(1), near, angles) >= _LEAST_LEVER * near
    near, angles = near[usable], angles[usable]
    for j, (low, high) in enumerate(zip(term.lower, term.upper, strict=True)):
        at = np.linspace(low, high, _POSITIONS)
        whole = np.tile(at[:, None], (1, len(term.lower)))
        three = np.reshape(values, (3, -1))[:, j]
        level = np.einsum("k,ki->i", three, term.shapes(whole)[:, :, j])
        columns = np.column_stack([np.ones(len(at)), lever(at[:, None], near, angles)])
        fit, error = _few(columns, level)
        tendons = tuple(
            (float(near[k]), float(angles[k]), float(fit[1 + k])) for k in np.flatnonzero(fit[1:])
        )
        mean = float(np.mean(columns[:, 1:] @ fit[1:]))
        found.append(BentFriction(float(fit[0]), tendons, error, mean))
    return found


def _few(columns: Array, level: Array) -> tuple[Array, float]:
    """Return few numbers, none negative, that fit a level, the first one kept; and their error."""
    from scipy.optimize import nnls

    def fitted(used: list[int]) -> tuple[Array, float]:
        values = np.zeros(columns.shape[1])
        if used:
            values[used] = nnls(columns[:, used], level, maxiter=_MOST_ROUNDS)[0]
        return values, float(np.abs(columns @ values - level).max())

    values, error = fitted(list(range(columns.shape[1])))
    allowed = max(1.5 * error, _LITTLE * float(level.max()))
    used = np.flatnonzero(values).tolist()
    while used:
        trials = [fitted([k for k in used if k != left]) for left in used]
        best = min(trials, key=lambda trial: trial[1])
        if best[1] > allowed:
            break
        (values, error), used = best, np.flatnonzero(best[0]).tolist()
    return values, error


def tendon_elements(
    robot: RobotModel, i: int, bent: BentFriction, child: Any, parent: Any
) -> list[Any]:
    """Add sites to the elements of a joint's bodies, and return the tendons between them.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    i : int
        Number of the joint in Pinocchio's order.
    bent : BentFriction
        What they make.
    child, parent : Element
        The bodies, whose frames are those of the joint and of what carries it.
    """
    from lxml import etree

    name, placement = robot.pin_model.names[i], robot.pin_model.jointPlacements[i].homogeneous
    axis = np.asarray(robot.tree.axis[i - 1])
    first = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    hidden = {"size": "0.001", "rgba": "0 0 0 0"}
    found = []
    for k, (distance, angle, dry) in enumerate(bent.tendons):
        near, far = f"{name}/near{k + 1}", f"{name}/far{k + 1}"
        etree.SubElement(child, "site", name=near, pos=numbers(distance * first), **hidden)
        place = np.cos(angle) * first + np.sin(angle) * second
        place = placement[:3, :3] @ place + placement[:3, 3]
        etree.SubElement(parent, "site", name=far, pos=numbers(place), **hidden)
        own = {"name": f"{name}/friction{k + 1}", "frictionloss": numbers(dry)}
        spatial = etree.Element("spatial", own | {"rgba": "0 0 0 0"})
        for site in (far, near):
            etree.SubElement(spatial, "site", site=site)
        found.append(spatial)
    return found
