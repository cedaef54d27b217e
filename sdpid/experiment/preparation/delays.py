"""Take delays that recordings with a base show off their channels."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

from sdpid.experiment.inspection.delays.find import channel_delays, is_told, pooled_delays
from sdpid.experiment.processing.delays.on_time import CHANNELS
from sdpid.experiment.processing.settings import Processing, Reason
from sdpid.experiment.recording.joints import match_joints
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.model.model import RobotModel

# Delays are kept to this many digits of a second: 10 µs.
_DIGITS = 5


def with_delays(
    robot: RobotModel,
    logs: Sequence[Recording],
    processing: Processing,
    given: Mapping[str, Any] | None = None,
    unused: Collection[str] = (),
) -> Processing:
    """Return a processing that takes late channels of recordings with a base on time.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    logs : sequence of Recording
        What is to be processed alike; their sensors are the same, and so are the delays.
    processing : Processing
        Chosen for them.
    given : mapping, optional
        Settings that stand as they are.
    unused : collection of str, optional
        Joints whose efforts say nothing.

    Returns
    -------
    Processing
        With a reason for each delay that was found.
    """
    own = [match_joints(robot, log) for log in logs if log.base is not None]
    if not robot.free_flyer or robot.loops or not own:
        return processing
    each = [channel_delays(robot, log, unused) for log in own]
    changes: dict[str, Any] = {}
    reasons = []
    for channel, delay in pooled_delays(each).items():
        field = f"{channel}_delay_s"
        if field in (given or {}) or not is_told(channel, delay):
            continue
        value = round(delay.value, _DIGITS)
        count = sum(channel in found for found in each)
        shown = "the recording shows" if len(own) == 1 else f"{count} of {len(own)} recordings show"
        text = (
            f"{CHANNELS[channel]} late by {1e3 * value:.3g} ± {1e3 * delay.error:.2g} ms against "
            f"the joints, as {shown}"
        )
        changes[field] = value
        reasons.append(Reason(field=field, value=value, text=text))
    return replace(processing, **changes, reasons=(*processing.reasons, *reasons))
