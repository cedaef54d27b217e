"""Put the states of the base, and its contacts, beside those of the joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sdpid._common.arrays import frozen_view
from sdpid.errors import DataError
from sdpid.experiment.processing.floating.base_states import base_states
from sdpid.experiment.processing.floating.feet import feet_of
from sdpid.experiment.processing.floating.on_grid import OnGrid
from sdpid.experiment.processing.period_mean import Chain
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.recording import Recording

# Velocity coordinates of a floating base, as Pinocchio and a loaded robot call them.
BASE_NAMES = tuple(f"root_joint/{axis}" for axis in ("vx", "vy", "vz", "wx", "wy", "wz"))
# Where no robot says another: that of `load_robot`, m/s².
GRAVITY = (0.0, 0.0, -9.81)


def require_finite(log: Recording, processing: Processing) -> None:
    """Refuse what is not known of recordings with a base.

    Raises
    ------
    DataError
        For a filter of unlimited memory, periods, and gains of drives.
    """
    if processing.filter != "finite":
        raise DataError(
            f"filter: is '{processing.filter}', whose memory has no end; a recording with a base "
            "needs 'finite': behind another filter a foot that is in the air still carries what it "
            "carried on the ground."
        )
    if log.period is not None:
        raise DataError(
            "period: a recording with a base has none: where a robot walks, no period repeats the "
            "one before; leave the period out."
        )
    if log.gains is not None:
        raise DataError(
            "gains: errors of drive gains are not known for recordings with a base; read them "
            "with torques (currents times gains)."
        )


def with_base(
    joints: Samples,
    log: Recording,
    chain: Chain,
    processing: Processing,
    gravity: Sequence[float] = GRAVITY,
) -> Samples:
    """Return samples of a floating robot, made of those of its joints.

    Parameters
    ----------
    joints : Samples
        Of the joints alone, (K, n).
    log : Recording
        A piece without gaps, with a base.
    chain : Chain
        What the joints were filtered with.
    processing : Processing
        Where accelerations are from, and what becomes of contacts.
    gravity : sequence of 3 floats
        In world axes, m/s².

    Returns
    -------
    Samples
        In Pinocchio's order: position (K, 7 + n), the rest (K, 6 + n). The base's rows are used:
        nothing drives it, so that its efforts are zero.
    """
    assert log.base is not None
    on_grid = OnGrid(chain=chain)
    position, velocity, acceleration, note = base_states(
        log.base, on_grid, np.array(gravity), processing.base_motion
    )
    K = joints.n_samples
    nothing = np.zeros((K, len(BASE_NAMES)))
    mask = None
    if joints.mask is not None:
        mask = np.hstack([np.ones(nothing.shape, dtype=np.bool_), joints.mask])
    notes = [*joints.notes, note]
    contacts = None
    if log.contacts is not None:
        contacts, clear, told = feet_of(log.contacts, on_grid, processing)
        notes += told
        if not clear.all():
            if not clear.any():
                raise DataError(
                    f"impact_s: {processing.impact_s:g} s around landings leave no sample; make "
                    "it shorter, or leave it out (None)."
                )
            every = np.ones((K, len(BASE_NAMES) + joints.n), dtype=np.bool_)
            mask = (every if mask is None else mask) & clear[:, None]
    wide = None
    if joints.wide is not None:
        wide = tuple(
            replace(
                each,
                velocity=frozen_view(np.pad(each.velocity, ((0, 0), (len(BASE_NAMES), 0)))),
            )
            for each in joints.wide
        )
    names = None if joints.joint_names is None else (*BASE_NAMES, *joints.joint_names)
    return replace(
        joints,
        position=np.hstack([position, joints.position]),
        velocity=np.hstack([velocity, joints.velocity]),
        acceleration=np.hstack([acceleration, joints.acceleration]),
        effort=np.hstack([nothing, joints.effort]),
        mask=mask,
        joint_names=names,
        notes=tuple(notes),
        wide=wide,
        contacts=contacts,
    )
