"""The arguments of `read_recording`, completed by a mapping beside the log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from sdpid._common.tables import plain
from sdpid.errors import DataError
from sdpid.experiment.readers.column_names import CONVENTIONS
from sdpid.experiment.readers.mapping import find_mapping, read_mapping
from sdpid.experiment.readers.missing import MISSING
from sdpid.experiment.readers.unit_names import UNITS
from sdpid.experiment.recording.motor_side import MotorSide

__all__ = ["Arguments", "complete_arguments"]


@dataclass(kw_only=True)
class Arguments:
    """The arguments of `read_recording` that say what is in a log; see there."""

    columns: dict[str, Any] = field(default_factory=dict)
    units: dict[str, Any] = field(default_factory=dict)
    motors: MotorSide | None = None
    joint_names: tuple[str, ...] | None = None
    topic: str | None = None
    rate_hz: float | None = None
    missing: str = "refuse"
    period: float | None = None
    start: float | None = None
    periods: int | None = None
    effort_scale: Any = None
    without_effort: tuple[str, ...] = ()

    @property
    def scaled(self) -> bool:
        """Whether there are factors that turn currents into torques."""
        constants = None if self.motors is None else self.motors.torque_constants
        return self.effort_scale is not None or constants is not None

    @property
    def selection(self) -> dict[str, Any]:
        """Arguments of `select`."""
        return {
            "columns": self.columns,
            "wanted": self.joint_names,
            "scaled": self.scaled,
            "timeless": self.rate_hz is not None,
        }

    def to_dict(self) -> dict[str, Any]:
        """Return the arguments that differ from their defaults, as plain values.

        ``read_recording(path, mapping=False, **arguments)`` reads the same again.
        """
        given = {each.name: plain(getattr(self, each.name)) for each in fields(self)}
        standard = plain(vars(Arguments()))
        return {name: value for name, value in given.items() if value != standard[name]}


def complete_arguments(
    log: Path | None, mapping: Any, how: Mapping[str, Any]
) -> tuple[Arguments, str | None]:
    """Return the arguments, those of the mapping where none are given, and the mapping's path.

    Parameters
    ----------
    log : Path or None
        The log, beside which a mapping may lie; None for a data frame.
    mapping : path-like, mapping or bool, optional
        As in `read_recording`.
    how : mapping
        The other arguments of `read_recording`.

    Raises
    ------
    DataError
        When an argument or a quantity is not known, or the mapping cannot be read.
    """
    known = [each.name for each in fields(Arguments)]
    if unknown := sorted(set(how) - set(known)):
        raise DataError(
            f"read_recording: {', '.join(unknown)} is no argument; known are path, mapping, "
            f"stored, {', '.join(known)}."
        )
    beside = find_mapping(log) if log is not None and mapping in (None, True) else None
    if mapping is True and beside is None:
        raise DataError(f"{log}: there is no mapping beside it.")
    stated: dict[str, Any] = {}
    if beside is not None:
        stated = read_mapping(beside)
    elif mapping is not None and mapping is not False:
        stated = read_mapping(mapping)
        beside = None if isinstance(mapping, Mapping) else Path(mapping)
    merged = {**stated, **{name: value for name, value in how.items() if value is not None}}
    for name, allowed in (("columns", CONVENTIONS), ("units", UNITS)):
        merged[name] = _known({**stated.get(name, {}), **(how.get(name) or {})}, allowed, name)
    merged["columns"] = {q: _as_names(value) for q, value in merged["columns"].items()}
    if isinstance(merged.get("motors"), Mapping):
        merged["motors"] = MotorSide.from_mapping(merged["motors"])
    merged["joint_names"] = _tuple(merged.get("joint_names"))
    merged["without_effort"] = _tuple(merged.get("without_effort"), "without_effort") or ()
    arguments = Arguments(**merged)
    if arguments.missing not in MISSING:
        raise DataError(f"missing: is {arguments.missing!r}, expected one of {', '.join(MISSING)}.")
    return arguments, None if beside is None else str(beside)


def _as_names(value: Any) -> Any:
    """Return the names of columns as texts; numbers stand for columns without names."""
    if isinstance(value, (list, tuple)):
        return [str(entry) for entry in value]
    return value if value is None else str(value)


def _tuple(names: Any, argument: str = "joint_names") -> tuple[str, ...] | None:
    """Return joint names as a tuple of texts."""
    if names is None:
        return None
    if isinstance(names, str) or not all(isinstance(name, str) for name in names):
        raise DataError(f"{argument}: is {names!r}, expected a sequence of names.")
    return tuple(names)


def _known(given: Mapping[str, Any], allowed: Mapping[str, Any], what: str) -> dict[str, Any]:
    """Return a mapping whose keys are all allowed."""
    unknown = sorted(set(given) - set(allowed))
    if unknown:
        raise DataError(
            f"{what}: {', '.join(unknown)} is not a quantity; known are {', '.join(allowed)}."
        )
    return dict(given)
