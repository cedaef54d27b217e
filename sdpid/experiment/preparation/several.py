"""One recording or several, made ready for one fit."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any, TypeAlias

from sdpid.errors import DataError
from sdpid.experiment.preparation.for_robot import default_processing, prepare
from sdpid.experiment.processing.process import Processing
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.readers.read import read_recording
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.model.model import RobotModel

Log: TypeAlias = "Recording | str | os.PathLike[str]"
Logs: TypeAlias = "Log | Sequence[Log]"
# All of it, or what is to be other than by default.
ProcessingOf: TypeAlias = "Processing | Mapping[str, Any] | None"


def all_recordings(logs: Logs) -> tuple[Recording, ...]:
    """Return recordings that are given as such or by their files.

    Raises
    ------
    DataError
        When there are none, or a file cannot be read.
    """
    given = (logs,) if isinstance(logs, (Recording, str, os.PathLike)) else tuple(logs)
    if not given:
        raise DataError("recordings: there are none; give at least one.")
    return tuple(log if isinstance(log, Recording) else read_recording(log) for log in given)


def recordings(logs: Logs) -> tuple[Recording, ...]:
    """Return recordings that can be fitted together.

    Raises
    ------
    DataError
        Beside that of `all_recordings`, when there are several and one of them has periods:
        averages of different motions have no common covariance.
    """
    read = all_recordings(logs)
    periodic = [number for number, log in enumerate(read, 1) if log.period is not None]
    if len(read) > 1 and periodic:
        raise DataError(
            f"recording {periodic[0]} of {len(read)} has a period, and averages over periods "
            "cannot be joined with other recordings: fit one periodic recording alone, or leave "
            "its period out (period=None) so that it counts sample by sample."
        )
    return read


def common_processing(logs: Sequence[Recording]) -> tuple[Processing, str | None]:
    """Return one way to process recordings that are fitted together, and where it comes from.

    Each recording has its own default, chosen from its rate and its motion
    (`default_processing`). All are processed by that of the recording with the median cut-off, of
    an even number the lower one of the middle two: one unusual recording then decides nothing, and
    the choice is one that was made for a whole recording.

    Returns
    -------
    Processing
        For all of them.
    str or None
        The choice in words, where there was one.
    """
    return agreed([default_processing(log) for log in logs])


def agreed(choices: Sequence[Processing]) -> tuple[Processing, str | None]:
    """Return what `common_processing` makes of the recordings' own choices."""
    if len(choices) == 1:
        return choices[0], None
    ranked = sorted(range(len(choices)), key=lambda i: (choices[i].cutoff_hz, i))
    chosen = ranked[(len(ranked) - 1) // 2]
    cutoffs = ", ".join(f"{each.cutoff_hz:.3g}" for each in choices)
    return choices[chosen], (
        f"the {len(choices)} recordings are processed alike, as suits recording {chosen + 1}, "
        f"which has the median of their cut-offs ({cutoffs} Hz)"
    )


def chosen_processing(
    logs: Sequence[Recording], given: ProcessingOf
) -> tuple[Processing, str | None]:
    """Return what is given, or `common_processing` with the changes that are given, and why.

    Raises
    ------
    DataError
        When a change names no setting, or its value is out of range.
    """
    if isinstance(given, Processing):
        return given, None
    changes = {} if given is None else given
    if not isinstance(changes, Mapping):
        raise DataError(
            f"processing: is {changes!r}, expected a Processing or a mapping of its settings."
        )
    settings = [field.name for field in fields(Processing) if field.name != "reasons"]
    unknown = [str(name) for name in changes if name not in settings]
    if unknown:
        raise DataError(
            f"processing: has no setting {', '.join(unknown)}; choose from {', '.join(settings)}."
        )
    common, why = common_processing(logs)
    return replace(common, **changes), why


def joined(robot: RobotModel, logs: Sequence[Recording], processing: Processing) -> Samples:
    """Return the samples of recordings that are each processed alone, in one."""
    return Samples.join([prepare(robot, log, processing) for log in logs])
