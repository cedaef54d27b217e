"""`Finding`: one statement of the verdict, and how its numbers are written."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from sdpid.output.report.grades import Level

# Names listed before "and 3 more".
_LISTED = 4


@dataclass(frozen=True)
class Finding:
    """A finding of the verdict.

    Attributes
    ----------
    level : {"good", "caution", "bad"}
        What it means for the model.
    text : str
        A sentence or two.
    warning : str
        What not to do with the result, in words that follow "do not"; every bad finding has some.
    """

    level: Level
    text: str
    warning: str = ""


def listed(names: Iterable[str], most: int = _LISTED) -> str:
    """Join up to `most` names with commas, and count the rest."""
    every = list(names)
    more = f" and {len(every) - most} more" if len(every) > most else ""
    return ", ".join(every[:most]) + more


def percent(share: float) -> str:
    """Return a share in percent."""
    return f"{100.0 * share:.3g} %"
