"""Motions of a robot whose feet stay in place, its joints, and rows without the ground's forces."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid._common.kept import last_kept
from sdpid.excitation.criterion.rows import BaseRows
from sdpid.experiment.trajectory.curve import Curve
from sdpid.robot.legs import Legs
from sdpid.robot.model.jacobians import contact_jacobians, frame_axes, frame_places
from sdpid.robot.model.model import RobotModel, each_state

# Coordinates of the base: metres from where it stands, and angles about its own x, then the
# turned y, then the vertical axis, rad.
COORDINATES = ("base_x", "base_y", "base_z", "base_roll", "base_pitch", "base_yaw")
# Newton's method for the joints ends here, m and rad: below the steps of differences by far.
_REACHED, _STEPS = 1e-10, 12
# A step moves no joint by more, rad, and is damped by this length over the leg's: legs that do not
# reach are not thrown about.
_LONGEST, _DAMPING = 0.5, 1e-4
# Rounds in which balls are rolled along a motion: a ball is a tenth of a leg, and each round
# leaves a tenth of the error.
_ROUNDS = 6
# Step of central differences by coordinates and their rates, m and rad (and s): far below the width
# of a smooth sign. Efforts are linear in accelerations: a step of any size is exact.
_DIFFERENCE = 1e-5
# Samples a second of a plan's motion.
RATE_HZ = 500.0
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Poses:
    """Configurations of a stance, and what moves there.

    Attributes
    ----------
    configuration : ndarray, shape (K, nq)
        Pinocchio's, the base at the height at which it stands.
    miss : ndarray, shape (K,)
        By how much the worst foot misses its place, m or rad.
    jacobians : ndarray, shape (K, c, 6, n)
        Of the feet's frames, world axes.
    turned : ndarray, shape (K, 3, 3)
        Axes of the base.
    angles : ndarray, shape (K, 3)
        Roll, pitch, yaw.
    basis : ndarray, shape (K, n, m)
        Speeds of all coordinates by the base's twist in its own axes and by the free joints.
    inverse : ndarray, shape (K, c, k, k)
        Of each leg's Jacobian at its contact.
    """

    configuration: Array
    miss: Array
    jacobians: Array
    turned: Array
    angles: Array
    basis: Array
    inverse: Array

    def take(self, index: Indices) -> Poses:
        """Return some of them, in any order."""
        return Poses(**{name: value[index] for name, value in vars(self).items()})

    def joined(self, others: Poses) -> Poses:
        """Return these, then others."""
        pairs = zip(vars(self).items(), vars(others).values(), strict=True)
        return Poses(**{name: np.concatenate([own, other]) for (name, own), other in pairs})


@dataclass(frozen=True, eq=False)
class StanceStates:
    """States of a robot that stands; the base's linear velocity is left out (Galilei)."""

    poses: Poses
    velocity: Array
    acceleration: Array

    def take(self, index: Indices) -> StanceStates:
        """Return some of them, in any order."""
        return StanceStates(self.poses.take(index), self.velocity[index], self.acceleration[index])


@dataclass(frozen=True, eq=False)
class Stance:
    """A robot whose feet stay at their places.

    Its coordinates are those of the base (`COORDINATES`), then the joints beside the legs, less
    their standing positions. Balls roll: a foot's center goes by the radius times what the foot
    turns. Joints and their rates follow in closed form from Jacobians.

    Attributes
    ----------
    legs : Legs
        The robot's legs, and how it stands.
    """

    legs: Legs

    @property
    def robot(self) -> RobotModel:
        """The robot, on a floating base."""
        return self.legs.robot

    @property
    def n(self) -> int:
        """Number m of coordinates."""
        return 6 + len(self.legs.free)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        joints = self.robot.joint_names[6:]
        return (*COORDINATES, *(joints[j] for j in self.legs.free))

    @cached_property
    def standing(self) -> Poses:
        """The pose in which the robot stands."""
        return self.poses(np.zeros((1, self.n)))

    @cached_property
    def _places(self) -> tuple[Array, Array]:
        """Centers of the feet from the standing base (c, 3), and their axes (c, 3, 3)."""
        q = self._configurations(np.zeros((1, self.n)))
        q[:, 7:] = self.legs.standing
        frames = self.legs.frames
        return frame_places(self.robot, q, frames)[0], frame_axes(self.robot, q, frames)[0]

    def _configurations(self, x: Array) -> Array:
        """Return configurations (K, nq) whose legs are as when standing."""
        from scipy.spatial.transform import Rotation

        q = np.empty((len(x), self.robot.pin_model.nq))
        q[:, :3] = x[:, :3]
        q[:, 2] += self.legs.height + self.legs.radius
        q[:, 3:7] = Rotation.from_euler("ZYX", x[:, 5:2:-1]).as_quat()
        q[:, 7:] = self.legs.standing
        q[:, 7 + self.legs.free] += x[:, 6:]
        return q

    def poses(self, x: Array, near: Array | None = None, *, centers: Array | None = None) -> Poses:
        """Return the poses at coordinates (K, m), by Newton's method.

        Parameters
        ----------
        x : ndarray, shape (K, m)
            Coordinates.
        near : ndarray, shape (K, nq), optional
            Configurations nearby, where the method starts.
        centers : ndarray, shape (K, c, 3), optional
            Where the feet's centers are from the standing base, m; by default as far as a ball
            rolls on the shortest way to how it is turned.
        """
        legs, robot = self.legs, self.robot
        q = self._configurations(x)
        if near is not None:
            q[:, 7 + legs.joints.ravel()] = near[:, 7 + legs.joints.ravel()]
        miss = np.full(len(x), np.inf)
        far, index = np.arange(len(x)), 7 + legs.joints
        for _ in range(_STEPS):
            error = self._errors(q[far], x[far], None if centers is None else centers[far])
            miss[far] = np.abs(error).max(axis=(1, 2))
            error, far = error[miss[far] > _REACHED], far[miss[far] > _REACHED]
            if not len(far):
                break
            A = self._own(contact_jacobians(robot, q[far], legs.frames, self._offset))
            damped = A @ np.swapaxes(A, 2, 3)
            damped += (_DAMPING * legs.height) ** 2 * np.eye(damped.shape[-1])
            move = np.swapaxes(A, 2, 3) @ np.linalg.solve(damped, error[..., None])
            q[far[:, None, None], index] += np.clip(move[..., 0], -_LONGEST, _LONGEST)
        return self._moved(q, x, miss)

    @property
    def _offset(self) -> Array:
        return np.array([0.0, 0.0, -self.legs.radius])

    def _own(self, J: Array) -> Array:
        """Return each leg's square Jacobian (K, c, k, k) from those of all feet."""
        rows = 6 if self.legs.flat else 3
        feet = np.arange(J.shape[1])[:, None, None]
        found = J[:, feet, np.arange(rows)[:, None], self.legs.joints[:, None, :] + 6]
        return np.asarray(found)

    def _errors(self, q: Array, x: Array, centers: Array | None) -> Array:
        """Return how far feet are from where they are wanted, (K, c, 3 or 6), world axes."""
        places, axes = self._places
        wanted = places if centers is None else centers
        error = wanted - x[:, None, :3] - frame_places(self.robot, q, self.legs.frames)
        if self.legs.flat:
            R = frame_axes(self.robot, q, self.legs.frames)
            return np.concatenate([error, -_turns(R @ np.swapaxes(axes, 1, 2))], axis=2)
        return np.asarray(error if centers is not None else error + self._rolled(q))

    def along(self, x: Array) -> Poses:
        """Return the poses of a motion through coordinates (K, m), in small steps.

        Balls roll on the way that the motion takes: they do not come back to where they were when
        the base does.
        """
        poses = self.poses(x)
        if self.legs.flat or not self.legs.radius:
            return poses
        for _ in range(_ROUNDS):
            R = frame_axes(self.robot, poses.configuration, self.legs.frames)
            turns = _turns(R[1:] @ np.swapaxes(R[:-1], 2, 3))
            rolled = np.cumsum(self.legs.radius * np.cross(turns, _UP), axis=0)
            first = self._places[0] + self._rolled(poses.configuration[:1])
            centers = np.concatenate([first, first + rolled])
            poses = self.poses(x, poses.configuration, centers=centers)
        return poses

    def _rolled(self, q: Array) -> Array:
        """Return how far balls roll on the shortest way to how they are turned, (K, c, 3)."""
        R = frame_axes(self.robot, q, self.legs.frames) @ np.swapaxes(self._places[1], 1, 2)
        return np.asarray(self.legs.radius * np.cross(_turns(R), _UP))

    def _moved(self, q: Array, x: Array, miss: Array) -> Poses:
        """Return poses with all that moves there."""
        from scipy.spatial.transform import Rotation

        legs, n, k = self.legs, self.robot.n, len(q)
        J = contact_jacobians(self.robot, q, legs.frames)
        at = self.at_contacts(J)
        A = self._own(at)
        # Of a leg that is stretched no inverse: it is told by its determinant, elsewhere.
        damped = A @ np.swapaxes(A, 2, 3) + (_DAMPING * legs.height) ** 4 * np.eye(A.shape[-1])
        inverse = np.swapaxes(A, 2, 3) @ np.linalg.inv(damped)
        N = np.zeros((k, n, self.n))
        N[:, :6, :6] = np.eye(6)
        N[:, 6 + legs.free, 6 + np.arange(len(legs.free))] = 1.0
        N[:, 6 + legs.joints, :6] = -inverse @ at[:, :, : A.shape[2], :6]
        return Poses(
            configuration=q,
            miss=miss,
            jacobians=J,
            turned=Rotation.from_quat(q[:, 3:7]).as_matrix(),
            angles=x[:, 3:6],
            basis=N,
            inverse=inverse,
        )

    def at_contacts(self, J: Array) -> Array:
        """Return Jacobians (K, c, 6, n) at the contacts from those at the feet's frames."""
        out = J.copy()
        # v + w × (0, 0, -radius).
        out[:, :, 0] -= self.legs.radius * J[:, :, 4]
        out[:, :, 1] += self.legs.radius * J[:, :, 3]
        return out

    def determinants(self, poses: Poses) -> Array:
        """Return each leg's determinant (K, c), as a share of that when standing."""
        own = np.linalg.det(self._own(self.at_contacts(poses.jacobians)))
        return np.asarray(own / self._standing_determinants)

    @cached_property
    def _standing_determinants(self) -> Array:
        return np.asarray(np.linalg.det(self._standing_jacobians))

    @property
    def _standing_jacobians(self) -> Array:
        return np.asarray(self._own(self.at_contacts(self.standing.jacobians))[0])

    @property
    def bent(self) -> Array:
        """How far each leg is from straight when standing, (c,), from 0 to 1.

        The size of its determinant, as a share of the product of its columns' lengths.
        """
        lengths = np.linalg.norm(self._standing_jacobians, axis=1)
        return np.asarray(np.abs(self._standing_determinants) / np.prod(lengths, axis=1))

    def states(self, poses: Poses, rate: Array, second: Array) -> StanceStates:
        """Return states from the coordinates' first and second derivatives, (K, m) each."""
        legs = self.legs
        twist, slope = _twist(poses, rate, second)
        velocity = np.einsum("knm,km->kn", poses.basis, twist)
        acceleration = np.einsum("knm,km->kn", poses.basis, slope)
        velocity[:, :3] = 0.0
        own = poses.inverse @ self._drift(poses, velocity)[..., None]
        acceleration[:, 6 + legs.joints] -= own[..., 0]
        return StanceStates(poses, velocity, acceleration)

    @last_kept
    def at(self, x: Array, rate: Array, second: Array) -> StanceStates:
        """Return the states of coordinates and their derivatives, (K, m) each."""
        return self.states(self.poses(x), rate, second)

    def sampled(self, curve: Curve) -> tuple[Array, StanceStates]:
        """Return instants (K,) of a motion of the coordinates, 500 a second, and states there."""
        count = max(2, round(curve.duration * RATE_HZ))
        time = np.linspace(0.0, curve.duration, count + 1)
        x, rate, second = (curve.evaluate(time, derivative=order) for order in range(3))
        return time, self.states(self.along(x), rate, second)

    @last_kept
    def beside(self, x: Array, rate: Array, second: Array) -> StanceStates:
        """Return the 5·m·K states beside those of coordinates (K, m), for `slopes`.

        Coordinates ahead and behind, rates ahead and behind, accelerations ahead; of each the m
        coordinates one after the other, K states each.
        """
        (k, m), poses = x.shape, self.at(x, rate, second).poses
        steps = np.eye(m)[:, None, :]
        ahead = _DIFFERENCE * steps
        moved = np.concatenate([x + ahead, x - ahead]).reshape(-1, m)
        # Where they are after small moves, to first order.
        moves = moved - np.tile(x, (2 * m, 1))
        still = poses.take(np.tile(np.arange(k), 2 * m))
        near = still.configuration.copy()
        near[:, 7:] += self.states(still, moves, np.zeros_like(moves)).velocity[:, 6:]
        every = self.poses(moved, near).joined(poses.take(np.tile(np.arange(k), 3 * m)))
        rates, seconds = (np.broadcast_to(each, (m, k, m)) for each in (rate, second))
        all_rates = np.concatenate([rates, rates, rates + ahead, rates - ahead, rates])
        all_seconds = np.concatenate([seconds] * 4 + [seconds + steps])
        return self.states(every, all_rates.reshape(-1, m), all_seconds.reshape(-1, m))

    def _drift(self, poses: Poses, velocity: Array) -> Array:
        """Return the contacts' accelerations (K, c, 3 or 6) without any of the coordinates'."""
        import pinocchio as pin

        numbers = [self.robot.frame_numbers[name] for name in self.legs.frames]
        still, axes = np.zeros(self.robot.pin_model.nv), pin.LOCAL_WORLD_ALIGNED

        def accelerations(model: Any, data: Any, q: Array, v: Array) -> list[Array]:
            pin.forwardKinematics(model, data, q, v, still)
            found = (pin.getFrameClassicalAcceleration(model, data, k, axes) for k in numbers)
            return [each.vector for each in found]

        states, shape = (poses.configuration, velocity), (len(numbers), 6)
        found = each_state(accelerations, self.robot.pin_model, shape, *states)
        return self.at_contacts(found[..., None])[:, :, : 6 if self.legs.flat else 3, 0]


def _turns(rotations: Array) -> Array:
    """Return the rotation vectors (K, c, 3) of matrices (K, c, 3, 3)."""
    from scipy.spatial.transform import Rotation

    found = Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_rotvec()
    return np.asarray(found.reshape(*rotations.shape[:2], 3))


def _twist(poses: Poses, rate: Array, second: Array) -> tuple[Array, Array]:
    """Return the base's twist in its own axes and the free joints' speeds, and their derivatives.

    The linear part's derivative is the acceleration of the origin, in the base's axes.
    """
    out, slope = rate.copy(), second.copy()
    for each in (out, slope):
        each[:, :3] = np.einsum("kji,kj->ki", poses.turned, each[:, :3])
    # Axes of roll, pitch and yaw, the first at rest in the base, the last in the world.
    roll, zero = poses.angles[:, 0], np.zeros(len(rate))
    pitch, yaw = np.stack([zero, np.cos(roll), -np.sin(roll)], axis=1), poses.turned[:, 2]
    axes = np.stack([np.tile(np.eye(3)[0], (len(rate), 1)), pitch, yaw], axis=1)
    for each in (out, slope):
        each[:, 3:6] = np.einsum("kai,ka->ki", axes, each[:, 3:6])
    slope[:, 3:6] += rate[:, 4, None] * np.cross(pitch, rate[:, 3, None] * axes[:, 0])
    slope[:, 3:6] += rate[:, 5, None] * np.cross(yaw, out[:, 3:6])
    return out, slope


def slopes(here: Array, aside: Array) -> tuple[Array, Array, Array]:
    """Return derivatives (K, ..., m) by coordinates, their rates and their accelerations.

    Parameters
    ----------
    here : ndarray, shape (K, ...)
        A function of states.
    aside : ndarray, shape (5·m·K, ...)
        The same of those that `Stance.beside` returns.
    """
    ahead, behind, faster, slower, pushed = aside.reshape(5, -1, *here.shape)
    step = 2.0 * _DIFFERENCE
    by_x, by_rate, by_second = (ahead - behind) / step, (faster - slower) / step, pushed - here
    return np.moveaxis(by_x, 0, -1), np.moveaxis(by_rate, 0, -1), np.moveaxis(by_second, 0, -1)


# Bytes of regressors that are made at a time.
_BLOCK = 1 << 24


@dataclass(frozen=True, kw_only=True, eq=False)
class StandingRows:
    """Whitened rows of a stance: one for each coordinate.

    They are the equations of motion along the motions that the feet leave free: ``L^-1·N^T·Y``
    with N these motions, and ``L·L^T = N^T·S·N`` for errors of covariance S. Their products are
    those of the rows that an estimate uses, which are projected onto the null space of the
    contacts (docs/theory/model.md): the columns of N are a basis of it.

    Attributes
    ----------
    stance : Stance
        The robot on its feet.
    regressor : BaseRows
        The equations of motion with all forces in them, and friction of the joints.
    spread : ndarray, shape (n,)
        Spectral density of the errors of each of these: of the base's in N²·s and (N·m)²·s, of the
        joints' in (N·m)²·s.
    """

    stance: Stance
    regressor: BaseRows
    spread: Array

    @property
    def count(self) -> int:
        """Number b of base parameters."""
        return self.regressor.count

    def rows(self, q: Array, v: Array, a: Array) -> Array:
        """Return W (K, m, b) at coordinates (K, m) and their first and second derivatives."""
        return self.of_states(self.stance.at(q, v, a))

    def of_states(self, states: StanceStates) -> Array:
        """Return W (K, m, b)."""
        poses = states.poses
        N = poses.basis
        L = np.linalg.cholesky(np.einsum("kni,n,knj->kij", N, self.spread, N, optimize=True))
        Y = self.regressor.rows(poses.configuration, states.velocity, states.acceleration)
        return np.asarray(np.linalg.solve(L, np.swapaxes(N, 1, 2) @ Y))

    def gradient(self, C: Array, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
        """Return the derivatives (K, m) of ``sum(C * rows(q, v, a))`` for constant C (K, m, b)."""
        stance = self.stance
        beside = stance.beside(q, v, a)
        here = np.einsum("kmb,kmb->k", C, self.rows(q, v, a))
        which = np.tile(np.arange(len(q)), 5 * stance.n)
        # In blocks: the regressors of all at once would take gigabytes of humanoids.
        count = max(1, _BLOCK // (8 * stance.robot.n * self.count))
        aside = [
            np.einsum("kmb,kmb->k", C[which[some]], self.of_states(beside.take(some)))
            for some in np.split(np.arange(len(which)), range(count, len(which), count))
        ]
        return slopes(here, np.concatenate(aside))
