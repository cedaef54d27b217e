"""Read the mapping of a log: a TOML file beside it with names, units and motors."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sdpid._common.toml import load_toml
from sdpid.errors import DataError
from sdpid.experiment.readers.floating.quantities import SETTINGS, checked_settings
from sdpid.experiment.recording.floating.columns import mapping_beside
from sdpid.experiment.recording.motor_side import MotorSide

__all__ = ["find_mapping", "read_mapping"]

_NUMBERS = ("period", "start", "periods", "rate_hz")
_TEXTS = ("topic", "missing")
_SCALES = ("effort_scale", "gains")
_KNOWN = (
    *("columns", "units", "motors", "joint_names", *_TEXTS, *_SCALES, *_NUMBERS),
    *(*SETTINGS, "rows"),
)
# How TOML, which has no null, says that a quantity is not to be read.
_NOTHING = (False, "none")


def find_mapping(log: Path) -> Path | None:
    """Return the mapping beside a log, if there is one."""
    beside = mapping_beside(log)
    return beside if beside.is_file() and beside != log else None


def read_mapping(source: str | os.PathLike[str] | Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of `read_recording` that a mapping holds.

    Parameters
    ----------
    source : path-like or mapping
        A TOML file, or its content. Keys are ``columns``, ``units`` and ``motors`` (tables),
        ``joint_names``, ``topic``, ``missing``, ``effort_scale``, ``gains`` (a file beside the
        mapping), ``rate_hz``, ``rows``, ``period``, ``start`` and ``periods``; of a floating
        base the tables ``base``, ``imu`` and ``contacts``.

    Returns
    -------
    dict

    Raises
    ------
    DataError
        When the file cannot be read, or a key or value is not as expected.
    """
    where = "mapping" if isinstance(source, Mapping) else os.fspath(source)
    content = dict(source) if isinstance(source, Mapping) else load_toml(source)
    if unknown := sorted(map(str, set(content) - set(_KNOWN))):
        raise DataError(
            f"{where}: {', '.join(unknown)} is not known; known are {', '.join(_KNOWN)}. "
            "Where this is no mapping of a log, read the log with mapping=False."
        )
    for key in ("columns", "units"):
        for quantity, value in _table(where, content, key).items():
            if key == "columns" and value in _NOTHING:
                content[key] = {**content[key], quantity: None}
            elif not _texts(value) and not (key == "columns" and _counts(value)):
                raise DataError(
                    f"{where}: {key}.{quantity} is {value!r}, expected a text or a list of texts."
                )
    if not _texts(content.get("joint_names", [])) or isinstance(content.get("joint_names"), str):
        raise DataError(f"{where}: joint_names is {content['joint_names']!r}, expected names.")
    for key in _TEXTS:
        if not isinstance(content.get(key, ""), str):
            raise DataError(f"{where}: {key} is {content[key]!r}, expected a text.")
    if isinstance(content.get("gains"), str) and not isinstance(source, Mapping):
        content["gains"] = os.fspath(Path(where).parent / content["gains"])
    for key in _NUMBERS:
        value = content.get(key, 0)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise DataError(f"{where}: {key} is {value!r}, expected a number.")
    for key in SETTINGS:
        if key in content:
            content[key] = checked_settings(f"{key}", content[key])
    if "motors" in content:
        try:
            content["motors"] = MotorSide.from_mapping(_table(where, content, "motors"))
        except DataError as cause:
            raise DataError(f"{where}: {cause}") from None
    return content


def _table(where: str, content: dict[str, Any], key: str) -> Mapping[str, Any]:
    """Return a table of the mapping."""
    value = content.get(key, {})
    if not isinstance(value, Mapping):
        raise DataError(f"{where}: {key} is {value!r}, expected a table [{key}].")
    return value


def _texts(value: Any) -> bool:
    """Tell whether a value is a text or a list of texts."""
    return isinstance(value, str) or (
        isinstance(value, (list, tuple)) and all(isinstance(entry, str) for entry in value)
    )


def _counts(value: Any) -> bool:
    """Tell whether a value is the number of a column, or a list of such numbers."""
    each = value if isinstance(value, (list, tuple)) else [value]
    return all(isinstance(entry, int) and not isinstance(entry, bool) for entry in each)
