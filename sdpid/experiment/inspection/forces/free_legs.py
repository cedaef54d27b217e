"""Legs as free bodies: what their torques say of the force at their feet.

The rows of a leg's joints hold its own links, which move as they were measured to, its torques, its
friction and the force at its foot. Neither the rest of the robot nor flags of contacts enter them.
The links may differ from their description as far as is believed of them, so that errors of the
description are not taken for a scale of forces.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.experiment.inspection.places.block_fit import BlockFit, BlockSums
from sdpid.experiment.processing.contacts.contact_samples import ContactSamples
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.model.contacts.jacobians import contact_jacobians
from sdpid.robot.model.model import RobotModel

# Samples that are compared.
_ROWS = 600
# A link's mass may be off by this share of it, its first moments and moments of inertia by what
# this share makes at such a distance (m): twice the 15 % that simulated links are off, and more.
_BELIEF, _AT = 0.3, 0.1
# Width of the smooth sign of the velocity, rad/s.
_WIDTH = 0.02
# Friction and rotor inertia are free: in units of the largest effort no joint has as much.
_FREE = 100.0
# A foot bears something where it is down so often, or where the root mean square of its force is
# this share of the weight: below it there is nothing that checks would tell, such as the noise of
# sensors in the air.
_OFTEN, _BEARING = 0.1, 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class FreeLeg:
    """Rows of the j joints between the base and a contact.

    Attributes
    ----------
    linear, angular : ndarray, shape (K, 3, j)
        Jacobians of the contact point by these joints, in the world's axes.
    own : ndarray, shape (K, j, p)
        Columns of the leg's links, friction and rotor inertias.
    size : ndarray, shape (p,)
        How large their coefficients may be.
    due : ndarray, shape (K, j)
        Torques less those that the description's links need, N·m.
    """

    linear: Array
    angular: Array
    own: Array
    size: Array
    due: Array

    def by_forces(self, forces: Array) -> Array:
        """Return the torques that forces (K, 3, m) at the contact take off, (K, j, m)."""
        return -np.swapaxes(self.linear, 1, 2) @ forces

    def by_moments(self, moments: Array) -> Array:
        """Return the torques that moments (K, 3, m) at the contact take off, (K, j, m)."""
        return -np.swapaxes(self.angular, 1, 2) @ moments

    def sums(self, columns: Array, size: Array) -> BlockSums:
        """Return the normal equations of the p own columns, and of others (K, j, m) behind them."""
        every = np.concatenate([self.own, columns], axis=2)
        return BlockSums.of(every, self.due, np.concatenate([self.size, size]))

    def fit(self, columns: Array, size: Array) -> BlockFit:
        """Fit the p own columns, and others (K, j, m) behind them."""
        return self.sums(columns, size).fit(range(len(self.size) + len(size)))


@dataclass(frozen=True, kw_only=True, eq=False)
class FreeLegs:
    """The legs of a robot whose contact forces were measured.

    Attributes
    ----------
    robot : RobotModel
        The description.
    legs : tuple of FreeLeg
        One for each of the c contacts.
    position : ndarray, shape (K, 7 + n)
        Configurations of the robot.
    frames : tuple of str
        Of the contacts.
    flat : tuple of bool
        Whether contacts transmit moments too.
    down : ndarray of bool, shape (K, c)
        Whether they are closed.
    wrenches : ndarray, shape (K, c, 6)
        Their forces and moments as recorded.
    needed : ndarray, shape (K, 3)
        Force on the base that weight and inertia of the description need, in its axes, N.
    whole : bool
        Whether these are all contacts that bear something, and so together the robot.
    """

    robot: RobotModel
    legs: tuple[FreeLeg, ...]
    position: Array
    frames: tuple[str, ...]
    flat: tuple[bool, ...]
    down: Mask
    wrenches: Array
    needed: Array
    whole: bool

    @property
    def weight(self) -> float:
        """Of the description, N."""
        return described_weight(self.robot)

    def borne(self, forces: Array) -> float:
        """Return what part of the description's weight and inertia forces (K, c, 3) bear."""
        J = contact_jacobians(self.robot, self.position, self.frames)[..., :3, :3]
        given = np.einsum("kcij,kci->kj", J, forces)
        return float(np.sum(self.needed * given) / np.sum(self.needed**2))


def free_legs(
    robot: RobotModel, samples: Samples, without: Collection[str] = ()
) -> FreeLegs | None:
    """Return the legs that bear measured forces, None where there are none.

    Contacts that bear nothing, that share joints with others, or have joints whose effort says
    nothing, are left out.

    Parameters
    ----------
    robot : RobotModel
        On a floating base.
    samples : Samples
        Of one recording.
    without : collection of str
        Joints whose effort says nothing.
    """
    contacts = samples.contacts
    if contacts is None or contacts.forces is None or not robot.prior[:, 0].sum() > 0.0:
        return None
    some = np.unique(np.linspace(0, samples.n_samples - 1, _ROWS).astype(np.intp))
    q, v, a = (each[some] for each in (samples.position, samples.velocity, samples.acceleration))
    contacts = contacts.picked(some)
    J = contact_jacobians(robot, q, contacts.frames, contacts.offset)
    moved: Mask = np.abs(J[..., robot.n_base :]).max(axis=(0, 2)) > 0.0
    known = np.array([name not in without for name in robot.joint_names[robot.n_base :]])
    shared = moved & (moved.sum(axis=0) > 1)
    bearing = _bearing(robot, contacts)
    taken = bearing & moved.any(axis=1) & ~shared.any(axis=1)
    taken &= ~(moved & ~known).any(axis=1)
    if not np.any(taken) or contacts.forces is None:
        return None
    feet = np.flatnonzero(taken).tolist()
    Y = robot.regressor(q, v, a)
    described = robot.described_efforts(q, v, a)
    legs = []
    for contact in feet:
        joints = robot.n_base + np.flatnonzero(moved[contact])
        rows = Y[:, joints]
        links = np.flatnonzero(np.any(rows != 0.0, axis=(0, 1)))
        count = len(joints)
        friction = np.zeros((len(some), count, 3 * count))
        speed, rate = v[:, joints], a[:, joints]
        for place, column in enumerate((np.tanh(speed / _WIDTH), speed, rate)):
            friction[:, np.arange(count), place * count + np.arange(count)] = column
        effort = samples.effort[some][:, joints]
        largest = max(float(np.abs(effort).max()), 1e-9)
        legs.append(
            FreeLeg(
                linear=J[:, contact, :3, joints].transpose(1, 2, 0),
                angular=J[:, contact, 3:, joints].transpose(1, 2, 0),
                own=np.concatenate([rows[:, :, links], friction], axis=2),
                size=np.append(_believed(robot)[links], np.full(3 * count, _FREE * largest)),
                due=effort - described[:, joints],
            )
        )
    return FreeLegs(
        robot=robot,
        legs=tuple(legs),
        position=q,
        frames=tuple(contacts.frames[i] for i in feet),
        flat=tuple(contacts.kind[i] != "point" for i in feet),
        down=contacts.down[:, feet],
        wrenches=contacts.forces[:, feet],
        needed=described[:, :3],
        whole=bool(taken[bearing].all()),
    )


def described_weight(robot: RobotModel) -> float:
    """Return the weight of a description, N."""
    return float(robot.prior[:, 0].sum() * np.linalg.norm(robot.gravity))


def _bearing(robot: RobotModel, contacts: ContactSamples) -> Mask:
    """Return which contacts bear something, (c,)."""
    assert contacts.forces is not None
    weight = described_weight(robot)
    size = np.sqrt(np.mean(np.sum(contacts.forces[..., :3] ** 2, axis=2), axis=0))
    bears: Mask = (contacts.down.mean(axis=0) >= _OFTEN) | (size >= _BEARING * weight)
    return bears


def _believed(robot: RobotModel) -> Array:
    """Return by how much the links' parameters may be off the description, (10·links,)."""
    of_mass = np.array([1.0, *3 * (_AT,), *6 * (_AT**2,)])
    masses = np.maximum(robot.prior[:, :1], 1e-3 * robot.prior[:, 0].sum())
    return np.asarray((_BELIEF * masses * of_mass).ravel())
