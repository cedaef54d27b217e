"""`Finding`: one defect of a recording, as data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal

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
