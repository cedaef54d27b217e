"""The legs of a robot, found by the names of its links: feet, their joints, and how they reach."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, Indices, frozen
from sdpid.errors import DataError, ModelError
from sdpid.robot.model.geometry import collision_points, described_links, link_placements
from sdpid.robot.model.jacobians import frame_axes, frame_places
from sdpid.robot.model.model import RobotModel, each_state
from sdpid.robot.model.shapes import link_shapes

# Inverse kinematics ends at this distance in m; Newton's method is there after a few steps.
_REACHED, _STEPS = 1e-9, 50
# Damping of the inverse kinematics in m: a stretched leg is not thrown about.
_DAMPING = 1e-4


# Names of frames at which legs end, in any spelling: of balls, and of flat soles.
_FOOT, _SOLE = "foot", "sole"
# What every leg is bent to, in rad, by the number of its joints. Three: abduction, hip, knee
# backward, as quadrupeds stand. Six: hip yaw, roll, pitch, knee forward, ankle pitch, roll.
_BENT = {3: (0.0, 0.8, -1.6), 6: (0.0, 0.0, -0.4, 0.8, -0.4, 0.0)}
# Soles of a standing robot are level within this, rad.
_LEVEL = 1e-6
# Of feet that the description shows no shape of, m: those of most quadrupeds of a metre or less.
_RADIUS = 0.02
# Of soles that the description shows no shape of, m: to the back, to the front, to both sides.
_BACK, _FRONT, _SIDE = -0.1, 0.1, 0.06
# What is this near to the lowest point of a foot is its sole, m.
_THICK = 0.01
# Joints beside the legs rest this far inside their limits, rad, or a quarter of their range.
_INSIDE = 0.25


@dataclass(frozen=True, eq=False)
class Legs:
    """The legs of a robot: of three joints and a ball for a foot, or of six and a flat sole.

    Attributes
    ----------
    robot : RobotModel
        The robot, on a floating base; its coordinates are its joints.
    frames : tuple of str
        The frame at the center of each foot's ball, or in the plane of each sole.
    joints : ndarray of int, shape (c, 3) or (c, 6)
        The joints of each leg, counted from 0 after the base.
    radius : float
        Radius of the balls, m; 0 of soles.
    standing : ndarray, shape (joints,)
        Joint positions in which the robot stands, rad.
    sole : ndarray, shape (2, 2), or None
        The lower and the upper corner of all soles in their frames' x and y, m; None for balls.
    """

    robot: RobotModel
    frames: tuple[str, ...]
    joints: Indices
    radius: float
    standing: Array
    sole: Array | None = None

    @property
    def flat(self) -> bool:
        """Whether the feet are soles."""
        return self.sole is not None

    @functools.cached_property
    def free(self) -> Indices:
        """The joints beside the legs, counted from 0 after the base."""
        return np.setdiff1d(np.arange(self.n_joints), self.joints)

    @functools.cached_property
    def loads(self) -> tuple[Array, Array]:
        """What each joint bears: a mass, kg, and its lever, m, two arrays (joints,).

        A leg bears its share of the robot at its length; other joints what they move, at the
        distance of the farthest center of mass.
        """
        model, mass = self.robot.pin_model, self.robot.prior[:, 0]
        masses = np.full(self.n_joints, mass.sum() / len(self.frames))
        levers = np.full(self.n_joints, self.height)
        placed = link_placements(self.robot, self.robot.at_rest(self.standing[None])[0])
        centers = [
            place[:3, :3] @ body.lever + place[:3, 3]
            for place, body in zip(placed, list(model.inertias)[1:], strict=True)
        ]
        for joint in self.free:
            own = next(i for i in range(2, model.njoints) if model.joints[i].idx_v == joint + 6)
            moved, axis = np.array(model.subtrees[own]) - 1, placed[own - 1, :3, 3]
            masses[joint] = mass[moved].sum()
            levers[joint] = np.linalg.norm(np.array(centers)[moved] - axis, axis=1).max()
        return frozen(masses), frozen(levers)

    @property
    def n_joints(self) -> int:
        """Number of joints without the base."""
        return self.robot.n - self.robot.n_base

    @functools.cached_property
    def height(self) -> float:
        """Height of the base above the feet's centers when the robot stands, m."""
        return float(-self.feet(self.standing[None])[0, :, 2].mean())

    def centers_of_mass(self, joints: Array) -> Array:
        """Return the description's center of mass in the base frame, (K, 3), for (K, joints)."""
        import pinocchio as pin

        q = self.robot.at_rest(joints)
        return each_state(pin.centerOfMass, self.robot.pin_model, (3,), q)

    @functools.cached_property
    def center_of_mass(self) -> Array:
        """The center of mass when the robot stands, m, (3,)."""
        return frozen(self.centers_of_mass(self.standing[None])[0])

    def axes(self) -> Array:
        """Return the axes of the feet's frames as columns when the robot stands, (c, 3, 3)."""
        q = self.robot.at_rest(self.standing[None])
        return np.asarray(frame_axes(self.robot, q, self.frames)[0])

    @property
    def frame_ids(self) -> list[int]:
        """Pinocchio's numbers of the feet's frames."""
        return [self.robot.pin_model.getFrameId(name) for name in self.frames]

    def feet(self, joints: Array) -> Array:
        """Return the feet's centers in the base frame, shape (K, c, 3), for (K, joints)."""
        return frame_places(self.robot, self.robot.at_rest(joints), self.frames)

    def reach(self, targets: Array, turned: Array | None = None) -> Array:
        """Return the joints that put the feet where they are wanted.

        Parameters
        ----------
        targets : ndarray, shape (K, c, 3)
            Centers of the feet in the base frame, m; a motion, so that each is near the last.
        turned : ndarray, shape (K, 3, 3), optional
            The world's axes in the base frame, in which soles are level.

        Returns
        -------
        ndarray, shape (K, joints)

        Raises
        ------
        DataError
            When a foot cannot be reached.
        """
        import pinocchio as pin

        model = self.robot.pin_model
        data = model.createData()
        q = self.robot.at_rest(self.standing[None])[0]
        out = np.empty((len(targets), self.n_joints))
        for k, wanted in enumerate(targets):
            for _ in range(_STEPS):
                pin.computeJointJacobians(model, data, q)
                worst = 0.0
                for i, frame in enumerate(self.frame_ids):
                    foot = pin.updateFramePlacement(model, data, frame)
                    error = wanted[i] - foot.translation
                    if self.flat and turned is not None:
                        error = np.concatenate([error, pin.log3(turned[k] @ foot.rotation.T)])
                    worst = max(worst, float(np.abs(error).max()))
                    J = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
                    J = J[: len(error), 6 + self.joints[i]]
                    q[7 + self.joints[i]] += J.T @ np.linalg.solve(
                        J @ J.T + _DAMPING**2 * np.eye(len(error)), error
                    )
                if worst < _REACHED:
                    break
            else:
                raise DataError(
                    f"legs of '{self.robot.name}': a foot misses its place by "
                    f"{worst:.2g} m at instant {k} of the motion (limit {_REACHED:g}); take a "
                    "smaller motion."
                )
            out[k] = q[7:]
        return out


def find_legs(
    robot: RobotModel,
    *,
    feet: Sequence[str] | None = None,
    radius: float | None = None,
    standing: ArrayLike | None = None,
) -> Legs:
    """Find the legs of a robot.

    Parameters
    ----------
    robot : RobotModel
        A robot on a floating base, ``load_robot(..., root="free_flyer")``. Behind a transmission
        the legs are of its joints, of which each needs a motor of its own.
    feet : sequence of str, optional
        Frames at the centers of the feet; by default the links with 'sole' in their names,
        else with 'foot'.
    radius : float, optional
        Radius of the feet, m; by default that of their collision geometry.
    standing : array_like, shape (joints,), optional
        Joint positions in which the robot stands, rad; by default knees are
        bent, of legs of three joints backward, of six forward.

    Returns
    -------
    Legs

    Raises
    ------
    ModelError
        When the base is fixed, joints mimic others, there are no such frames, a leg has neither
        three nor six joints, or a sole is not level.

    Examples
    --------
    >>> from sdpid.robot.legs import find_legs
    >>> legs = find_legs(sdpid.load_robot("solo12", root="free_flyer"))
    >>> legs.frames, round(legs.height, 3), round(legs.radius, 3)
    (('FL_FOOT', 'FR_FOOT', 'HL_FOOT', 'HR_FOOT'), 0.223, 0.016)
    """
    model = robot.pin_model
    if not robot.free_flyer:
        raise ModelError(
            f"legs: '{robot.name}' is on a fixed base; load it with "
            'load_robot(..., root="free_flyer").'
        )
    if feet is None:
        feet = _named(robot, _SOLE) or _named(robot, _FOOT)
    if not feet:
        raise ModelError(
            f"legs: '{robot.name}' has no link with '{_FOOT}' or '{_SOLE}' in its name: "
            "it is no robot on legs, or its feet are called otherwise (feet=)."
        )
    if robot.expansion.shape != (robot.n, robot.n):
        raise ModelError(
            f"legs of '{robot.name}': joints that mimic others are not supported; make "
            "them fixed or free in the description."
        )
    robot = robot if robot.direct else robot.of_joints()
    chains: list[list[int]] = []
    for name in feet:
        if not model.existFrame(name):
            raise ModelError(
                f"legs: '{robot.name}' has no frame '{name}'; name frames of the robot (feet=)."
            )
        chain, joint = [], model.frames[model.getFrameId(name)].parentJoint
        while joint > 1:
            chain.append(model.joints[joint].idx_v - 6)
            joint = model.parents[joint]
        if len(chain) not in _BENT or len(chain) != len(chains[0] if chains else chain):
            raise ModelError(
                f"legs of '{robot.name}': {len(chain)} joints lead to '{name}'; legs of "
                "3 joints with balls for feet, or of 6 with soles, are supported."
            )
        chains.append(chain[::-1])
    angles = _resting(robot)
    angles[np.array(chains)] = _BENT[len(chains[0])]
    if standing is not None:
        angles = np.asarray(standing, dtype=np.float64)
        if angles.shape != (robot.n - 6,):
            raise DataError(
                f"standing: shape {angles.shape}, expected {(robot.n - 6,)}: one angle a joint."
            )
        if not np.isfinite(angles).all():
            j = int(np.argmin(np.isfinite(angles)))
            raise DataError(
                f"standing: the angle of '{robot.joint_names[6 + j]}' is {angles[j]}; give finite "
                "ones, in rad."
            )
    legs = Legs(robot, tuple(feet), np.array(chains), 0.0, frozen(angles))
    if len(chains[0]) == 3:
        return replace(legs, radius=_foot_radius(legs) if radius is None else radius)
    _require_level(legs)
    return replace(legs, sole=frozen(_sole_corners(robot, legs.frames)))


def _named(robot: RobotModel, word: str) -> list[str]:
    """Return links with a word in their names: bodies, not the joints before them."""
    frames = robot.pin_model.frames
    return [f.name for f in frames if word in f.name.lower() and str(f.type) == "BODY"]


def _resting(robot: RobotModel) -> Array:
    """Return joint positions of zero, or the next to it well inside the limits, (joints,)."""
    lower, upper = np.clip(robot.position_limits[6:].T, -np.pi, np.pi)
    inside = np.minimum(_INSIDE, (upper - lower) / 4.0)
    return np.clip(np.zeros(robot.n - 6), lower + inside, upper - inside)


def _require_level(legs: Legs) -> None:
    """Refuse soles that are not level when the robot stands."""
    import pinocchio as pin

    tilts = [float(np.abs(pin.log3(axes)).max()) for axes in legs.axes()]
    if not max(tilts) < _LEVEL:
        raise ModelError(
            f"legs of '{legs.robot.name}': sole '{legs.frames[int(np.argmax(tilts))]}' is "
            f"turned by {max(tilts):.3g} rad when the robot stands (limit {_LEVEL:g}); give "
            "standing=."
        )


def _foot_radius(legs: Legs) -> float:
    """Return how far the feet reach below their frames when the robot stands, m.

    That of balls is their radius. The largest of all feet; 0.02 m where the description has no
    collision geometry of them.
    """
    elements = {each.name: each.element for each in described_links(legs.robot)}
    depths = []
    for name, axes in zip(legs.frames, legs.axes(), strict=True):
        if elements.get(name) is None:
            continue
        try:
            shapes = link_shapes(elements[name], "collision", legs.robot.name, [])
        except ModelError:
            # A mesh that is not at hand.
            continue
        for shape in shapes:
            if shape.kind == "sphere":
                depths.append(float(shape.placement[:3, 3] @ -axes[2] + shape.sizes[0]))
            else:
                depths.append(float(np.max(shape.points() @ -axes[2])))
    return max(depths, default=_RADIUS)


def _sole_corners(robot: RobotModel, frames: tuple[str, ...]) -> Array:
    """Return the lower and the upper corner of all soles in their frames, m, (2, 2).

    The rectangle that every foot's collision geometry has, about the plane that the frame lies
    in; 0.2 m by 0.12 m where the description has none.
    """
    model = robot.pin_model
    corners = []
    for name in frames:
        frame = model.frames[model.getFrameId(name)]
        try:
            points = collision_points(robot, robot.link_names[frame.parentJoint - 1])
        except ModelError:
            continue
        own = (points - frame.placement.translation) @ frame.placement.rotation
        own = own[own[:, 2] < own[:, 2].min() + _THICK, :2]
        corners.append([own.min(axis=0), own.max(axis=0)])
    if not corners:
        return np.array([[_BACK, -_SIDE], [_FRONT, _SIDE]])
    lower, upper = np.swapaxes(corners, 0, 1)
    return np.array([lower.max(axis=0), upper.min(axis=0)])
