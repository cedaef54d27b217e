"""The limits of a standing robot: joints, motors, and feet that neither slip nor lift."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sdpid._common.arrays import Array
from sdpid.excitation.limits.check import LimitCheck, LimitRow
from sdpid.excitation.limits.joint_limits import JointLimits
from sdpid.excitation.search.space import InstantRows, Space
from sdpid.excitation.standing.stance import RATE_HZ, Stance, StanceStates, slopes
from sdpid.experiment.trajectory.curve import Curve

# A leg's determinant keeps this share of that when standing: one that is stretched cannot follow.
# It is the limit that plans come to first: 0.51 on a Solo12.
STRETCHED = 0.5

# The soft least of slacks that are alike is below them by the logarithm of their number over this:
# a tenth of a limit for twelve joints.
_SHARPNESS = 30.0

# Moments on a sole count as forces at this share of its width: half of the half width.
_LEVER = 0.25

# Share of limits that a search uses; by how much less than what was missing that becomes, and by
# which share at least and at most: nothing bounds the friction that a foot would need which is
# pulled.
_SEARCHED, _BEYOND, _LEAST, _MOST = 0.97, 1.3, 1e-3, 1.0

# Feet miss their places by no more, m and rad.
_MISS = 1e-9

# Kind, subject, unit, values (K,), lower and upper limit; infinite where there is none.
Quantity = tuple[str, str, str, Array, float, float]


@dataclass(kw_only=True, eq=False)
class Held:
    """Limits of a stance, as functions of a state that are to be at least zero.

    Attributes
    ----------
    stance : Stance
        The robot on its feet.
    joints : JointLimits
        Of all joints.
    bodies : ndarray, shape (links, 10)
        The bodies that torques and forces are of.
    grip : float
        Coefficient of friction of the ground that may be used.
    load : float
        Least normal force of a foot, N.
    share : float
        Share of joints' limits and of friction that is used.
    searched : float
        That which a search uses.
    """

    stance: Stance
    joints: JointLimits
    bodies: Array
    grip: float
    load: float
    share: float = 1.0
    searched: float = _SEARCHED

    @cached_property
    def weight(self) -> float:
        """Normal force of a foot that bears its share of the weight, N."""
        mass = float(self.bodies[:, 0].sum())
        gravity = float(np.linalg.norm(self.stance.robot.gravity))
        return mass * gravity / len(self.stance.legs.frames)

    def rows(self, space: Space, share: float | None = None) -> InstantRows:
        """Return a share of the limits at the instants at which the criterion looks.

        At others a leg might be stretched where only the criterion looks: its rows grow without
        bound there, and the search would find little else.
        """
        held = replace(self, share=share or self.searched)
        return InstantRows(space=space, parts=[(held, space.grid())])

    def learn(self, check: LimitCheck) -> None:
        """Search with a smaller share of the limits, by what a check found broken."""
        worst = max(-row.slack / (abs(row.limit) or 1.0) for row in check.broken)
        self.searched /= 1.0 + _BEYOND * min(max(worst, _LEAST), _MOST)

    def evaluate(self, q: Array, v: Array, a: Array) -> Array:
        """Return slacks (K, g) at coordinates (K, m) and derivatives, in units of their limits.

        One of each foot and kind, and the soft least of all joints of a kind: a row for each joint
        would take the search three times as long.
        """
        joints, feet = self._slacks(self._outputs(self.stance.at(q, v, a)))
        return np.column_stack([*(_least(own)[0] for own in joints), feet])

    def derivatives(self, q: Array, v: Array, a: Array) -> tuple[Array | None, ...]:
        """Return derivatives (K, g, m) of them by coordinates and both derivatives."""
        states = self.stance.at(q, v, a), self.stance.beside(q, v, a)
        here, aside = map(self._outputs, states)
        shares = [_least(own)[1] for own in self._slacks(here)[0]]
        found = []
        for slope in slopes(here, aside):
            columns = []
            for along in np.moveaxis(slope, -1, 0):
                # Slacks are of second degree: differences over any step are exact.
                ahead, behind = self._slacks(here + along), self._slacks(here - along)
                moves = zip(shares, ahead[0], behind[0], strict=True)
                joints = [np.sum(share * (up - down), axis=1) / 2.0 for share, up, down in moves]
                columns.append(np.column_stack([*joints, (ahead[1] - behind[1]) / 2.0]))
            found.append(np.stack(columns, axis=-1))
        return tuple(found)

    def loads(self, states: StanceStates) -> tuple[Array, Array]:
        """Return the torques and the forces of the ground that carry a motion.

        Of the forces that carry it those are taken whose weighted sum of squares is least: forces
        along the ground count as normal forces of theirs over `grip`. A controller that asks for
        these torques gets these forces, and they are centered in the friction cones.

        Returns
        -------
        ndarray, shape (K, joints)
            Torques of the joints without friction, N·m.
        ndarray, shape (K, c, 3) or (K, c, 6)
            Forces on the robot at balls, or forces and moments about soles' frames; world axes.
        """
        stance, poses, grip = self.stance, states.poses, self.grip
        effort = stance.robot.efforts_of_bodies(
            self.bodies, poses.configuration, states.velocity, states.acceleration
        )
        J = stance.at_contacts(poses.jacobians)[:, :, : 6 if stance.legs.flat else 3]
        k, c, rows, _ = J.shape
        size = np.array([grip, grip, 1.0])
        if stance.legs.flat:
            lever = _LEVER * float(np.ptp(self._sole, axis=0).min())
            size = np.concatenate([size, lever * np.array([1.0, 1.0, grip])])
        scaled = (J * size[:, None]).reshape(k, c * rows, -1)
        A = scaled[:, :, :6]
        shares = np.linalg.solve(np.swapaxes(A, 1, 2) @ A, effort[:, :6, None])
        force = A @ shares
        torque = effort[:, 6:] - (np.swapaxes(scaled, 1, 2)[:, 6:] @ force)[:, :, 0]
        return torque, force.reshape(k, c, rows) * size

    def _outputs(self, states: StanceStates) -> Array:
        """Return positions, velocities, torques, forces and determinants side by side, (K, ·)."""
        torque, wrenches = self.loads(states)
        position, speed = states.poses.configuration[:, 7:], states.velocity[:, 6:]
        determinants = self.stance.determinants(states.poses)
        forces = wrenches.reshape(len(torque), -1)
        return np.hstack([position, speed, torque, forces, determinants])

    def _split(self, outputs: Array) -> tuple[Array, Array, Array, Array, Array]:
        n, c = self.stance.legs.n_joints, len(self.stance.legs.frames)
        ends = [n, 2 * n, 3 * n, outputs.shape[1] - c]
        position, speed, torque, force, stretched = np.split(outputs, ends, axis=1)
        return position, speed, torque, force.reshape(len(force), c, -1), stretched

    def _slacks(self, outputs: Array) -> tuple[list[Array], Array]:
        """Return slacks of joints by kind, (K, ·) each, and of feet (K, ·), in their units."""
        position, speed, torque, force, stretched = self._split(outputs)
        limits, share = self.joints, self.share
        middle = 0.5 * (limits.lower + limits.upper)
        half = 0.5 * (limits.upper - limits.lower)
        joints = []
        for values, size in (
            (position - np.where(np.isfinite(middle), middle, 0.0), half),
            (speed, limits.velocity),
            (torque, limits.torque),
        ):
            own = np.isfinite(size)
            if own.any():
                joints.append(1.0 - (values[:, own] / (share * size[own])) ** 2)
        along, normal = force[:, :, :2] / self.weight, force[:, :, 2] / self.weight
        grip = share * self.grip
        feet = [normal - self.load / self.weight / share]
        feet.append((grip * normal) ** 2 - np.sum(along**2, axis=2))
        for _, low, high in self._pressure(force):
            size = 0.5 * np.ptp(self._sole, axis=0).min() * self.weight
            feet += [low / size, high / size]
        return joints, np.hstack([*feet, stretched - STRETCHED])

    @property
    def _sole(self) -> Array:
        sole = self.stance.legs.sole
        return np.zeros((2, 2)) if sole is None else sole

    def _pressure(self, force: Array) -> Iterator[tuple[str, Array, Array]]:
        """Yield moments (K, c) that are left until a sole tips or turns, two of each kind."""
        if not self.stance.legs.flat:
            return
        low, high = self.share * self._sole
        normal, moment = force[:, :, 2], force[:, :, 3:]
        turn = self.share * self.grip * 0.5 * np.ptp(self._sole, axis=0).min()
        tips = {"x": -moment[:, :, 1], "y": moment[:, :, 0]}
        for axis, least, most in zip(tips, low, high, strict=True):
            tip = tips[axis]
            yield f"pressure along {axis}", tip - least * normal, most * normal - tip
        yield "torsion", turn * normal - moment[:, :, 2], turn * normal + moment[:, :, 2]

    def quantities(self, states: StanceStates) -> Iterator[Quantity]:
        """Yield everything that has a limit, as it is."""
        position, speed, torque, force, stretched = self._split(self._outputs(states))
        limits, names = self.joints, self.stance.robot.joint_names[6:]
        for j, name in enumerate(names):
            yield "position", name, "rad", position[:, j], limits.lower[j], limits.upper[j]
            yield "velocity", name, "rad/s", speed[:, j], *_both(limits.velocity[j])
            yield "torque", name, "N.m", torque[:, j], *_both(limits.torque[j])
        for i, name in enumerate(self.stance.legs.frames):
            normal = force[:, i, 2]
            yield "normal force", name, "N", normal, self.load, np.inf
            along = np.linalg.norm(force[:, i, :2], axis=1)
            # A foot that pulls has no friction at all.
            used = np.where(normal > 0.0, along / np.where(normal > 0.0, normal, 1.0), np.inf)
            yield "friction", name, "1", used, -np.inf, self.grip
            yield "determinant", name, "1", stretched[:, i], STRETCHED, np.inf
        for kind, low, high in self._pressure(force):
            for i, name in enumerate(self.stance.legs.frames):
                least = np.minimum(low[:, i], high[:, i])
                yield kind, name, "N.m", least, 0.0, np.inf

    def check(self, curve: Curve) -> LimitCheck:
        """Return what a motion of the coordinates comes to, 500 times a second."""
        time, states = self.stance.sampled(curve)
        miss: Quantity = ("miss", "feet", "m", states.poses.miss, -np.inf, _MISS)
        rows = []
        for kind, subject, unit, values, low, high in (*self.quantities(states), miss):
            for sign, limit in ((-1.0, low), (1.0, high)):
                if not np.isfinite(limit):
                    continue
                k = int(np.argmax(sign * values))
                most, reached = sign * float(limit), sign * float(values[k])
                of = {"kind": kind, "subject": subject, "unit": unit, "time": float(time[k])}
                rows.append(LimitRow.of(sign, most, reached, reached, most, **of))
        notes = (
            *self.joints.assumed,
            f"limits were checked {RATE_HZ:g} times a second, not between.",
            "whether legs touch each other or the body was not checked.",
        )
        return LimitCheck(rows=tuple(rows), notes=notes)


def _least(slacks: Array) -> tuple[Array, Array]:
    """Return the soft least (K,) of slacks (K, ·), and how much each counts, (K, ·)."""
    least = slacks.min(axis=1, keepdims=True)
    shares = np.exp(-_SHARPNESS * (slacks - least))
    total = shares.sum(axis=1, keepdims=True)
    return (least - np.log(total) / _SHARPNESS)[:, 0], shares / total


def _both(limit: float) -> tuple[float, float]:
    return -limit, limit
