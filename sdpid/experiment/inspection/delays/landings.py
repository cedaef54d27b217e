"""By how much flags, or forces, of contacts are later than the efforts that carry them."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.experiment.inspection.delays.dynamic import first_scale, processing_at
from sdpid.experiment.inspection.delays.lag import Delay, lag
from sdpid.experiment.inspection.delays.standing import on_legs
from sdpid.experiment.processing.contacts.contact_samples import TRANSMITS
from sdpid.experiment.processing.process import process
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.model.contacts.jacobians import contact_jacobians
from sdpid.robot.model.model import RobotModel

# Cut-off (Hz) at which a landing is a step of 8 ms.
_CUTOFF_HZ = 120.0
# A landing is looked for this far from its flag (s), and must not be at the edge of that.
_WINDOW, _INSIDE = 0.03, 0.9
_LEAST_LANDINGS = 6
# Times the median deviation, a normal error's standard deviation; times that, a median's error.
_NORMAL, _OF_MEDIAN = 1.4826, 1.2533
# Forces as recorded must explain those from efforts to this share.
_UNLIKE = 0.5


def contacts_delay(robot: RobotModel, log: Recording, unused: Collection[str] = ()) -> Delay | None:
    """Return by how much contacts are late against efforts and joints that are on time.

    The forces that the description's bodies need, less the efforts, jump where a foot lands. Flags
    are compared with the steepest rise, the median of all landings; recorded forces with the
    forces themselves. Bodies that are 15 % off move neither.

    Returns
    -------
    Delay or None
        None where no foot lands often enough, or forces do not follow from efforts.
    """
    contacts, step = log.contacts, log.step
    if contacts is None or not on_legs(robot, log).all():
        return None
    wide = [TRANSMITS[kind] for kind in contacts.kind]
    if sum(wide) >= robot.n or not robot.prior[:, 0].sum() > 0.0:
        return None
    down = contacts.down
    steps = round(_WINDOW / step)
    if contacts.forces is None and (down is None or not _landings(down, steps)):
        return None
    std = None if contacts.forces is None else 1.0
    processing = processing_at(log, _CUTOFF_HZ, decimation=1, contact_force_std=std)
    samples = process(log, processing, gravity=robot.gravity.tolist())
    q, v, a = samples.position, samples.velocity, samples.acceleration
    need = robot.inverse_dynamics(robot.prior, q, v, a) - samples.effort
    scale = first_scale(robot, samples.effort, unused)
    J = contact_jacobians(robot, q, contacts.frames, contacts.offset)
    closed = np.concatenate([J[:, i, :rows] for i, rows in enumerate(wide)], axis=1) / scale
    normal = closed @ closed.transpose(0, 2, 1)
    # Legs that are stretched have forces that no effort shows.
    normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(normal.shape[1])
    solved = np.linalg.solve(normal, closed @ (need / scale)[:, :, None])
    first_rows = np.cumsum([0, *wide[:-1]])
    force: Array = np.stack([solved[:, row : row + 3, 0] for row in first_rows], axis=1)
    assert samples.time is not None
    first = round(float(samples.time[0] - log.time[0]) / step)
    if samples.contacts is not None and samples.contacts.forces is not None:
        return _of_forces(samples.contacts.forces[:, :, :3], force, step)
    assert down is not None
    return _of_flags(down[first : first + len(q)], force[:, :, 2], step)


def _of_forces(recorded: Array, force: Array, step: float) -> Delay | None:
    """Return the delay of recorded forces against others, up to their scales."""
    mine, other = (each.reshape(len(each), -1) for each in (recorded, force))
    moves = np.ptp(mine, axis=0) > 0.0
    alike = [
        bool(moves[i]) and np.corrcoef(mine[:, i], other[:, i])[0, 1] ** 2 > _UNLIKE
        for i in range(mine.shape[1])
    ]
    if not any(alike):
        return None
    return lag(mine[:, alike], other[:, alike], step, gain=True)


def _of_flags(down: Mask, upward: Array, step: float) -> Delay | None:
    """Return the delay of flags against the steepest rise of upward forces (K, c)."""
    steps = round(_WINDOW / step)
    found = []
    for foot, row in _landings(down, steps):
        rise = np.gradient(upward[row - steps : row + steps, foot])
        peak = int(rise.argmax())
        if abs(peak - steps) > _INSIDE * steps or not 0 < peak < len(rise) - 1:
            continue
        before, top, after = rise[peak - 1 : peak + 2]
        curved = before - 2.0 * top + after
        shift = 0.5 * (before - after) / curved if curved < 0.0 else 0.0
        # A foot lands between the last sample without its flag and the first with it.
        found.append((steps - 0.5 - peak - shift) * step)
    if len(found) < _LEAST_LANDINGS:
        return None
    value = float(np.median(found))
    spread = _NORMAL * float(np.median(np.abs(np.array(found) - value)))
    return Delay(value=value, error=_OF_MEDIAN * spread / float(np.sqrt(len(found))))


def _landings(down: Mask, steps: int) -> list[tuple[int, int]]:
    """Return feet and rows of landings that are clear of others, (foot, first row down)."""
    found = []
    for foot in range(down.shape[1]):
        flags = down[:, foot]
        for row in (np.flatnonzero(flags[1:] & ~flags[:-1]) + 1).tolist():
            inside = steps <= row <= len(flags) - steps
            if inside and not flags[row - steps : row].any() and flags[row : row + steps].all():
                found.append((foot, row))
    return found
