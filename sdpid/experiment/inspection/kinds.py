"""Findings, and their kinds: how serious each is, in what words, and what else it explains.

A file of checks adds its kinds to `KINDS`, beside the functions that find them, which yield
``found("foot_high", foot=..., height=..., limit=...)``: the kind has the words.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import pi
from numbers import Real
from string import Formatter
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from sdpid._common.arrays import Array

Severity = Literal["refuse", "warning", "note"]


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One defect of a recording, or a remark about it.

    Attributes
    ----------
    kind : str
        Name of the kind of defect, such as ``"effort_sign"``.
    message : str
        The defect, its place, and its number against a limit.
    severity : {"refuse", "warning", "note"}
        What is to be refused makes a result meaningless; a warning may make it wrong; a note does
        not.
    remedy : str
        What to do next; may be empty.
    joint : str or None
        The joint; None where it is the whole recording.
    numbers : mapping of str to float
        The numbers of the message.

    Examples
    --------
    >>> still = sdpid.Recording(time=log.time, position=0.0 * log.position, effort=log.effort)
    >>> finding = sdpid.inspect_recording(still, robot).findings[0]
    >>> finding.severity, finding.kind, finding.joint
    ('warning', 'joint_at_rest', 'joint_1')
    >>> dict(finding.numbers)
    {'range': 0.0, 'limit': 0.001}
    """

    kind: str
    message: str
    severity: Severity = "warning"
    remedy: str = ""
    joint: str | None = None
    numbers: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        numbers = {name: float(value) for name, value in self.numbers.items()}
        object.__setattr__(self, "numbers", MappingProxyType(numbers))

    def __str__(self) -> str:
        return f"{self.message}; {self.remedy}" if self.remedy else self.message

    def line(self, *, used: bool = True) -> str:
        """Return the finding in a line, headed by its severity and its kind.

        What is to be refused is headed ``accepted`` where its recording is used all the same.
        """
        head = "accepted" if used and self.severity == "refuse" else self.severity
        return f"{head} {self.kind}: {self}"

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {**vars(self), "numbers": dict(self.numbers), "text": str(self)}


@dataclass(frozen=True)
class Kind:
    """One kind of finding.

    Attributes
    ----------
    severity : {"refuse", "warning", "note"}
        Unless the check says another.
    words, remedy : str
        Message, and what to do next, with fields in braces. Beside Python's formats numbers have
        those of `_UNITS`.
    about : str
        What it is about, together with other kinds: ``"speed"``, ``"base"``, ``"imu"``, ``"feet"``,
        ``"late"``, ``"forces"``, ``"flags"``, or ``"log"``, which ``"everything"`` does not hide.
    hides : tuple of str
        Kinds, or subjects (`about`), whose findings it explains, and which are left out beside it:
        those of its joint, or all of them where it has none. A note explains only findings of its
        joint.
    spoils : bool
        Whether efforts say nothing of what else is wrong, unless it is a note.
    excuses : bool
        Whether other findings about the effort of its joint are left out.
    leaves_out : bool
        Whether that effort is left out of fits, unless it is accepted.
    final : bool
        Whether it cannot be accepted: it stands in the way of processing the log as well.
    """

    severity: Severity
    words: str
    remedy: str = ""
    about: str = ""
    hides: tuple[str, ...] = ()
    spoils: bool = False
    excuses: bool = False
    leaves_out: bool = False
    final: bool = False

    @property
    def accepted(self) -> bool:
        """Whether it changes what is done with a log, and may be overruled."""
        return (self.severity == "refuse" and not self.final) or self.leaves_out


refuse, warning, note = (partial(Kind, each) for each in ("refuse", "warning", "note"))

# A kind of finding that leaves out a joint's effort.
left_out = partial(
    warning,
    remedy="identify leaves its effort out, as without_effort does; accept=['{kind}'] (--accept "
    "{kind}) uses it as it is",
    excuses=True,
    leaves_out=True,
)

# Every kind by its name, once the files of checks are imported.
KINDS: dict[str, Kind] = {}

# How many of a unit a number in SI is.
_UNITS = {" %": 100.0, " ms": 1e3, " °": 180.0 / pi}


class _Words(Formatter):
    """Formats that may end in a unit: ``{share:.3g %}``."""

    def format_field(self, value: Any, format_spec: str) -> Any:
        for unit, size in _UNITS.items():
            if format_spec.endswith(unit):
                number = f"{size * value:{format_spec.removesuffix(unit)}}"
                return number + unit.replace(" °", "°")
        if isinstance(value, np.ndarray):
            return vector(value)
        return super().format_field(value, format_spec)


def words(kind: str, **fields: Any) -> str:
    """Return the message of a kind of finding with its fields."""
    return _Words().vformat(KINDS[kind].words, (), fields)


def found(
    kind: str, joint: str | None = None, severity: Severity | None = None, /, **fields: Any
) -> Finding:
    """Return a finding of a kind; fields that are numbers, or vectors, are the finding's."""
    row = KINDS[kind]
    numbers: dict[str, float] = {}
    for name, value in fields.items():
        if isinstance(value, np.ndarray):
            numbers |= {f"{name}_{axis}": x for axis, x in zip("xyz", value, strict=True)}
        elif isinstance(value, Real):
            numbers[name] = float(value)
    return Finding(
        kind=kind,
        joint=joint,
        severity=severity or row.severity,
        message=words(kind, joint=joint, **fields),
        remedy=_Words().vformat(row.remedy, (), {"kind": kind, **fields}),
        numbers=numbers,
    )


def explained(finding: Finding, others: list[Finding]) -> bool:
    """Return whether another finding explains one, so that it is left out."""
    about = KINDS[finding.kind].about
    names = {finding.kind, about, "" if about == "log" else "everything"}
    return any(
        names & {*KINDS[other.kind].hides}
        and (
            finding.joint in (None, other.joint)
            if other.joint is not None
            else other.severity != "note"
        )
        for other in others
    )


def exchanged(names: Sequence[str], order: Sequence[float]) -> str:
    """Return of which other feet columns are, where `order` has the column of each foot."""
    pairs = ((int(j), i) for i, j in enumerate(order) if i != j)
    return ", ".join(f"those of {names[j]} are of {names[i]}" for j, i in pairs)


def vector(values: Array) -> str:
    """Return a vector with three digits, what is below 0.0005 as 0."""
    rounded = [float(f"{value:.3g}") if abs(value) >= 5e-4 else 0.0 for value in values]
    return f"({', '.join(f'{value:g}' for value in rounded)})"
