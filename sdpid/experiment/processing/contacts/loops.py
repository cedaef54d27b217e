"""Loops of a robot as contacts of its links, closed in every sample."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.processing.contacts.contact_samples import ContactSamples
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.model.model import RobotModel


def with_loops(robot: RobotModel, samples: Samples) -> Samples:
    """Return samples with the loops of a robot beside other contacts.

    The forces in loops are eliminated: no sensor is there. They are closed all the time, so that
    the filter's memory does not matter.
    """
    if not robot.loops:
        return samples
    closed = ContactSamples(
        frames=tuple(loop.frame for loop in robot.loops),
        against=tuple(loop.against for loop in robot.loops),
        kind=tuple(loop.kind for loop in robot.loops),
        down=np.ones((samples.n_samples, len(robot.loops)), dtype=np.bool_),
    )
    feet = samples.contacts
    return replace(samples, contacts=closed if feet is None else _beside(feet, closed))


def _beside(feet: ContactSamples, loops: ContactSamples) -> ContactSamples:
    """Return the contacts of feet, then those of loops."""
    forces: Array | None = None
    covariance: Array | None = None
    if feet.forces is not None and feet.force_covariance is not None:
        forces = np.concatenate([feet.forces, np.zeros((len(feet.down), loops.n, 6))], axis=1)
        unknown = np.zeros((loops.n, 6, 6))
        unknown[:] = np.diag(np.full(6, np.inf))
        covariance = np.concatenate([feet.force_covariance, unknown])
    return replace(
        feet,
        frames=(*feet.frames, *loops.frames),
        against=(*feet.against, *loops.against),
        kind=(*feet.kind, *loops.kind),
        offset=np.concatenate([feet.offset, loops.offset]),
        down=np.concatenate([feet.down, loops.down], axis=1),
        forces=forces,
        force_covariance=covariance,
    )
