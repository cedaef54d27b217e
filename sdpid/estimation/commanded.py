"""What was commanded in recordings, at their time stamps: as they say themselves, or as given."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, real_array
from sdpid.errors import DataError
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.simulation.reference import DesiredMotion
from sdpid.experiment.trajectory.trajectory import Trajectory


def commanded(logs: Sequence[Recording], reference: Any) -> tuple[Array, ...] | None:
    """Return commanded positions (N, n) of each recording; None where nobody says.

    Parameters
    ----------
    logs : sequence of Recording
        The recordings.
    reference : Trajectory, array_like of shape (N, n), or a sequence of these, optional
        One a recording; by default `Recording.reference`.

    Raises
    ------
    DataError
        When a given reference does not fit the recordings.
    """
    if reference is None:
        known = [log.reference for log in logs]
        return None if any(each is None for each in known) else tuple(map(np.asarray, known))
    alone = isinstance(reference, (Trajectory, np.ndarray)) or not isinstance(reference, Sequence)
    given = [reference] if alone else list(reference)
    if len(given) != len(logs):
        raise DataError(
            f"reference: {len(given)} for {len(logs)} recordings; give one each, in their order: a "
            "Trajectory or an array (N, n)."
        )
    return tuple(_at_stamps(log, each) for log, each in zip(logs, given, strict=True))


def _at_stamps(log: Recording, reference: Any) -> Array:
    """Return commanded positions (N, n) at a recording's time stamps."""
    if not isinstance(reference, Trajectory):
        array = real_array(reference, "reference", ndim=2)
        if array.shape != log.position.shape:
            raise DataError(
                f"reference: has shape {array.shape}, expected {log.position.shape} as the "
                "positions have: one row a time stamp, one column a joint."
            )
        return array
    if reference.joint_names != log.joint_names:
        raise DataError(
            f"reference: moves {', '.join(reference.joint_names)}; the recording has "
            f"{', '.join(log.names)}."
        )
    planned = DesiredMotion.of(reference, log.n, None)
    time = np.asarray(log.time) - log.time[0]
    if time[-1] > planned.curve.duration + log.step:
        raise DataError(
            f"reference: the trajectory ends after {planned.curve.duration:.6g} s, the recording "
            f"after {time[-1]:.6g} s; cut the recording, or give the positions at its time stamps."
        )
    return np.asarray(planned.at(time)[:, 0])
