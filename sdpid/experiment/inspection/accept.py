"""Refuse recordings from which no result means anything, unless a finding is overruled by name."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from difflib import get_close_matches

from sdpid.errors import DataError
from sdpid.experiment.inspection.finding import Finding
from sdpid.experiment.inspection.kinds import KINDS

# Kinds of findings that one may overrule. Any other that is refused stands in the way of processing
# the log as well, whatever is accepted.
REFUSED = tuple(sorted(name for name, kind in KINDS.items() if kind.accepted))


def kinds_accepted(accept: str | Iterable[str]) -> tuple[str, ...]:
    """Return the kinds of findings that are accepted, checked.

    Raises
    ------
    DataError
        When one is no kind that is ever refused.
    """
    if not isinstance(accept, Iterable):
        raise DataError(
            f"accept: is {accept!r:.80}; give kinds of findings, such as 'effort_sign', or () for "
            "none."
        )
    kinds = (accept,) if isinstance(accept, str) else tuple(accept)
    for kind in kinds:
        if kind not in REFUSED:
            near = get_close_matches(str(kind), REFUSED, n=1)
            meant = f"did you mean {near[0]}? " if near else ""
            raise DataError(
                f"accept: {kind!r} is no kind of finding that is refused; {meant}There are "
                f"{', '.join(REFUSED)}."
            )
    return kinds


def joints_left_out(findings: Iterable[Finding], accept: Iterable[str] = ()) -> tuple[str, ...]:
    """Return the joints whose effort is left out, for findings that are not accepted."""
    left_out = [f for f in findings if KINDS[f.kind].leaves_out and f.kind not in set(accept)]
    return tuple(dict.fromkeys(f.joint for f in left_out if f.joint))


def require_accepted(findings: Sequence[Finding], accept: str | Iterable[str] = ()) -> None:
    """Raise when a finding of severity ``"refuse"`` is not accepted.

    Parameters
    ----------
    findings : sequence of Finding
        Of the inspection.
    accept : str or iterable of str, optional
        Kinds of findings that are overruled.

    Raises
    ------
    DataError
        With the findings, their remedies, and the kinds that would have to be accepted.
    """
    kinds = kinds_accepted(accept)
    refused = [each for each in findings if each.severity == "refuse" and each.kind not in kinds]
    if not refused:
        return
    listed = ". ".join(f"{each.kind}: {each}".rstrip(".") for each in refused)
    names = dict.fromkeys(each.kind for each in refused)
    overruled = [name for name in names if name in REFUSED]
    asked = ", ".join(repr(name) for name in overruled)
    options = " ".join(f"--accept {name}" for name in overruled)
    rest = (
        f" If that is as it should be, accept=[{asked}] ({options}) overrules it."
        if overruled
        else ""
    )
    raise DataError(
        f"the log is refused, for no result from it would mean anything. {listed}.{rest}"
    )
