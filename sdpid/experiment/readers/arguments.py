"""The arguments of `read_recording`, completed by a mapping beside the log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.tables import plain
from sdpid.errors import DataError
from sdpid.experiment.drive_gains.gains import DriveGains
from sdpid.experiment.readers.floating.quantities import HELD, SETTINGS
from sdpid.experiment.readers.mapping import checked, find_mapping, read_mapping
from sdpid.experiment.recording.motor_side import MotorSide


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
    gains: Any = None
    currents: bool = False
    without_effort: tuple[str, ...] = ()
    base: dict[str, Any] = field(default_factory=dict)
    imu: dict[str, Any] = field(default_factory=dict)
    contacts: dict[str, Any] = field(default_factory=dict)
    rows: tuple[int, int] | None = None

    @property
    def scaled(self) -> bool:
        """Whether there are factors that turn currents into torques, or currents are wanted."""
        constants = None if self.motors is None else self.motors.torque_constants
        given = (self.effort_scale, constants, self.gains)
        return self.currents or any(each is not None for each in given)

    @property
    def amperes(self) -> bool:
        """Whether efforts are to be read as currents in A, which are turned into torques last."""
        return self.currents or self.gains is not None

    @property
    def selection(self) -> dict[str, Any]:
        """Arguments of `select`."""
        return {
            "columns": self.columns,
            "wanted": self.joint_names,
            "scaled": self.scaled,
            "timeless": self.rate_hz is not None,
            "floating": self.floating,
        }

    @property
    def floating(self) -> dict[str, Any]:
        """What is said of the columns of base, IMU and contacts."""
        said: dict[str, Any] = {name: plain(getattr(self, name)) for name in SETTINGS}
        said["base"] = {key: value for key, value in said["base"].items() if key not in HELD}
        return said

    def to_dict(self) -> dict[str, Any]:
        """Return the arguments that differ from their defaults, as plain values.

        ``read_recording(path, mapping=False, **arguments)`` reads the same again.
        """
        given = {each.name: plain(getattr(self, each.name)) for each in fields(self)}
        if isinstance(self.gains, DriveGains):
            given["gains"] = self.gains.to_dict()
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
    chosen = checked(how)
    beside = find_mapping(log) if log is not None and mapping in (None, True) else None
    if mapping is True and beside is None:
        raise DataError(f"{log}: there is no mapping beside it.")
    if beside is None and not isinstance(mapping, (bool, type(None), Mapping)):
        beside = Path(mapping)
    stated = read_mapping(beside or mapping) if beside or isinstance(mapping, Mapping) else {}
    # Either turns currents into torques: what is given wins over what the mapping says.
    if "gains" in chosen and not only_signs(stated.get("effort_scale")):
        stated.pop("effort_scale", None)
    if "effort_scale" in chosen and not only_signs(chosen["effort_scale"]):
        stated.pop("gains", None)
    tables = ("columns", "units", *SETTINGS)
    merged = {name: {**stated.get(name, {}), **chosen.get(name, {})} for name in tables}
    arguments = Arguments(**{**stated, **chosen, **merged})
    if arguments.currents and arguments.gains is not None:
        raise DataError("gains: turn currents into torques, and currents=True asks for currents.")
    return arguments, None if beside is None else str(beside)


def only_signs(scale: Any) -> bool:
    """Tell whether factors only turn signs."""
    try:
        return scale is not None and bool(np.all(np.abs(np.asarray(scale, dtype=float)) == 1.0))
    except (TypeError, ValueError):
        return False
