"""Jacobians of contact points, enclosed: what `sdpid.robot.model.contacts` computes, and its error.

With u and l the angular and the linear velocity that a coordinate gives a link at unit speed, in
the link's own frame, R the rotation of that frame in the world, p the contact's frame in the link's
and o the offset in the world's axes, the point has the velocity ``R (l + u × p) + (R u) × o``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.assurance.certificate.outward import SLACK as UP
from sdpid.assurance.certificate.outward import gamma
from sdpid.assurance.log_proof.enclosure import TINY, Enclosed, root
from sdpid.assurance.log_proof.joints import Joint, constant_vector
from sdpid.assurance.log_proof.regressor import Motion, moving_links
from sdpid.experiment.processing.contacts.contact_samples import ContactSamples
from sdpid.robot.model.contacts.jacobians import carrying_both, frame_axes
from sdpid.robot.model.model import RobotModel


class JacobianErrors:
    """What Jacobians of contacts are off by.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    joints : sequence of Joint
        Its joints.
    states : Motion
        Of k samples.
    contacts : ContactSamples
        Frames, those that they touch, and offsets of c contacts.
    computed : ndarray, shape (k, c, 6, n)
        From `sdpid.robot.model.contacts.jacobians.relative_jacobians`.

    Attributes
    ----------
    of_columns : ndarray, shape (k, c, 2, n)
        Of each coordinate bounds of the norm of the error of the point's velocity, and of the
        angular velocity; against the link that it touches, where there is one.
    """

    def __init__(
        self,
        robot: RobotModel,
        joints: Sequence[Joint],
        states: Motion,
        contacts: ContactSamples,
        computed: Array,
    ) -> None:
        self.robot, self.contacts, self.computed = robot, contacts, computed
        self._links, self._turned = moving_links(joints, states), _Turned(joints, states)
        self._spins: list[Enclosed] = []
        parts = computed.reshape(*computed.shape[:2], 2, 3, computed.shape[3])
        self.of_columns: Array = np.zeros((*computed.shape[:2], 2, computed.shape[3]))
        for i, (own, other) in enumerate(zip(contacts.frames, contacts.against, strict=True)):
            offset = constant_vector(contacts.offset[i])
            exact = self._velocities(own, offset)
            if other is not None:
                apart = ~carrying_both(robot, own, other)
                pairs = zip(exact, self._velocities(other, offset), strict=True)
                exact = [_where(apart, a - b) for a, b in pairs]
            self._spins.append(exact[1])
            for d, each in enumerate(exact):
                off = parts[:, i, d].transpose(2, 1, 0) - each.mid
                norm = root(np.einsum("mik,mik->mk", off, off)) + each.rad[:, None] + TINY
                self.of_columns[:, i, d] = norm.T * UP

    def of_eliminated(self, position: Array, down: Mask) -> Array:
        """Return the errors (k, c, 2, n) of what contacts transmit and nobody measures.

        Nothing of contacts that are open, and of a line the moments across it.

        Parameters
        ----------
        position : ndarray, shape (k, n) or (k, nq)
            Of the same samples.
        down : ndarray of bool, shape (k, c)
            Whether contacts are closed.
        """
        found = self.of_columns * down[:, :, None, None]
        for i, kind in enumerate(self.contacts.kind):
            if kind == "point":
                found[:, i, 1] = 0.0
            elif kind == "line":
                across = self._across(i, position)
                found[:, i, 1] = np.maximum(found[:, i, 1], across * down[:, i, None])
        return found

    def _across(self, i: int, position: Array) -> Array:
        """Return bounds (k, n) of what the two moments across an axis are off by."""
        name = self.contacts.frames[i]
        axes = frame_axes(self.robot, position, [name])[:, 0]
        spin = self.computed[:, i, 3:]
        frame: Any = self.robot.pin_model.frames[self.robot.frame_numbers[name]]
        rotation, at = np.array(frame.placement.rotation), frame.parentJoint - 1
        squares = []
        for a in (0, 2):
            own = axes[:, :, a]
            computed = np.einsum("ki,kin->kn", own, spin)
            vector = constant_vector(rotation[:, a])
            if at >= 0:
                vector = self._turned.of(at).apply(vector)
            exact = vector.dot(self._spins[i])
            # The rows' own sum of the same three products may round otherwise.
            rounding = 2.0 * gamma(4) * np.einsum("ki,kin->kn", np.abs(own), np.abs(spin))
            off = np.abs(computed - exact.mid.T) + exact.rad + rounding + TINY
            squares.append((off * UP) ** 2)
        return np.asarray(root(squares[0] + squares[1]) * UP)

    def _velocities(self, name: str, offset: Enclosed) -> list[Enclosed]:
        """Return the velocity of a point and the angular one, for all coordinates: (n, 3, k)."""
        frame: Any = self.robot.pin_model.frames[self.robot.frame_numbers[name]]
        k, _, _, n = self.computed.shape
        at, whole = frame.parentJoint - 1, []
        if at >= 0:
            link, R = self._links[at], self._turned.of(at)
            place = constant_vector(np.array(frame.placement.translation))
            spin = R.apply(link.u)
            for each in (R.apply(link.l + link.u.cross(place)) + spin.cross(offset), spin):
                mid, rad, size = np.zeros((n, 3, k)), np.zeros(n), np.zeros(n)
                mid[link.coordinates] = each.mid
                rad[link.coordinates], size[link.coordinates] = each.rad, each.size
                whole.append(Enclosed(mid, rad, size))
            return whole
        # A frame of the world: it does not move.
        return [Enclosed(np.zeros((n, 3, k)), np.zeros(n), np.zeros(n))] * 2


def _where(some: Mask, vectors: Enclosed) -> Enclosed:
    """Return some of vectors (n, 3, k), and zeros in place of the others."""
    return Enclosed(vectors.mid * some[:, None, None], vectors.rad * some, vectors.size * some)


class _Turned:
    """Rotations of links in the world, each made when it is asked for."""

    def __init__(self, joints: Sequence[Joint], states: Motion) -> None:
        self._joints, self._states = joints, states
        self._found: dict[int, Enclosed] = {}

    def of(self, link: int) -> Enclosed:
        """Return the rotation of a link."""
        if link not in self._found:
            joint = self._joints[link]
            own = joint.rotation(self._states.q[link])
            self._found[link] = own if joint.parent < 0 else self.of(joint.parent).compose(own)
        return self._found[link]
