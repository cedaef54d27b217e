"""What a run was given: files by their SHA-256, and recordings in memory by theirs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from sdpid._common.files import Source
from sdpid._common.tables import plain
from sdpid.experiment.recording.recording import CHANNELS, OPTIONAL, Recording
from sdpid.experiment.recording.stored import blocks
from sdpid.robot.model.base_parameters import kinematics_digest
from sdpid.robot.model.model import RobotModel


def input_files(
    robot: RobotModel, logs: Sequence[Recording], validation: Sequence[Recording] = ()
) -> list[dict[str, Any]]:
    """Return role, name, bytes and SHA-256 of description, every log in order, and gains.

    What came from no file has neither name nor bytes; its SHA-256 is that of its numbers
    (`recording_digest`, `kinematics_digest`).
    """
    gains = {}
    for log in (*logs, *validation):
        if log.gains is not None:
            text = json.dumps(log.gains.to_dict(), sort_keys=True)
            sha256 = hashlib.sha256(text.encode("utf-8")).hexdigest()
            entry = file_entry("gains", log.gains.source, sha256)
            # Those of several logs count once.
            gains[entry["sha256"]] = entry
    return [
        *(log_entry(log, "log") for log in logs),
        *(log_entry(log, "validation") for log in validation),
        file_entry("robot", robot.source, kinematics_digest(robot)),
        *gains.values(),
    ]


def log_entry(log: Recording, role: str) -> dict[str, Any]:
    """Return role, name, bytes and SHA-256 of a recording."""
    return file_entry(role, log.source, None if log.source else recording_digest(log))


def file_entry(role: str, source: Source | None, of_numbers: str | None = None) -> dict[str, Any]:
    """Return role, name, bytes and SHA-256 of a file, or the SHA-256 of numbers from no file."""
    if source is None:
        return {"role": role, "name": None, "bytes": None, "sha256": of_numbers}
    name = source.name or None
    return {"role": role, "name": name, "bytes": source.size, "sha256": source.sha256}


def recording_digest(log: Recording) -> str:
    """Return the SHA-256 of a recording's numbers: its names and periods, then its arrays.

    Arrays count as their shape and little-endian doubles, row by row. References and positions of
    links that are not there do not count, nor do a base and contacts.
    """
    stated = plain({name: getattr(log, name) for name in ("period", "start", "periods")})
    stated["joints"] = plain(log.joint_names)
    stated |= log.settings()
    digest = hashlib.sha256(json.dumps(stated, sort_keys=True).encode("ascii"))
    counted = [name for name in CHANNELS if name not in OPTIONAL or name in log.channels]
    tables = {name: getattr(log, name) for name in ("time", *counted)}
    for floating in (log.base, log.contacts):
        tables |= {} if floating is None else floating.columns()
    for name, values in tables.items():
        shape = None if values is None else list(values.shape)
        digest.update(f"\n{name} {shape}\n".encode())
        for _, part in () if values is None else blocks(values):
            digest.update(np.ascontiguousarray(part, dtype="<f8").data)
    return digest.hexdigest()
