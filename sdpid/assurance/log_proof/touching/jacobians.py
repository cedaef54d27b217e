"""Jacobians of contact points, enclosed: what `sdpid.robot.model.contacts` computes, and its error.

With u and l the angular and the linear velocity that a coordinate gives a link at unit speed, in
the link's own frame, R the rotation of that frame in the world, p the contact's frame in the link's
and o the offset in the world's axes, the point has the velocity ``R (l + u × p) + (R u) × o``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.certificate.outward import SLACK as UP
from sdpid.assurance.log_proof.enclosure import TINY, Enclosed, root
from sdpid.assurance.log_proof.joints import Joint, constant_vector
from sdpid.assurance.log_proof.regressor import Motion, moving_links
from sdpid.experiment.processing.contacts.contact_samples import ContactSamples
from sdpid.robot.model.model import RobotModel


def jacobian_errors(
    robot: RobotModel,
    joints: Sequence[Joint],
    states: Motion,
    contacts: ContactSamples,
    computed: Array,
) -> Array:
    """Return bounds of what Jacobians are off by, (k, c, 2, n).

    Of each coordinate they bound the norm of the error of the point's velocity, and of the angular
    velocity.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    joints : sequence of Joint
        Its joints.
    states : Motion
        Of k samples.
    contacts : ContactSamples
        Frames and offsets of c contacts.
    computed : ndarray, shape (k, c, 6, n)
        From `sdpid.robot.model.contacts.jacobians.contact_jacobians`.
    """
    model: Any = robot.pin_model
    links, turned = moving_links(joints, states), _Turned(joints, states)
    parts = computed.reshape(*computed.shape[:2], 2, 3, computed.shape[3])
    found: Array = np.sqrt(np.einsum("kcdin,kcdin->kcdn", parts, parts)) * UP
    for i, name in enumerate(contacts.frames):
        frame = model.frames[model.getFrameId(name)]
        at = frame.parentJoint - 1
        if at < 0:
            # A frame of the world: it does not move, and nothing that was computed may.
            continue
        link, R = links[at], turned.of(at)
        place = constant_vector(np.array(frame.placement.translation))
        spin = R.apply(link.u)
        offset = constant_vector(contacts.offset[i])
        exact = R.apply(link.l + link.u.cross(place)) + spin.cross(offset)
        for d, each in enumerate((exact, spin)):
            off = parts[:, i, d][:, :, link.coordinates].transpose(2, 1, 0) - each.mid
            norm = root(np.einsum("mik,mik->mk", off, off)) + each.rad[:, None] + TINY
            found[:, i, d, link.coordinates] = norm.T * UP
    return found


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
