"""Intervals in the form that tables, files and the report need."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from sdpid.assurance.intervals.intervals import Intervals

_ABOUT = {
    "profile": "the values of physically possible parameters that the data do not rule out",
    "gauss_markov": "how far the estimate may be from the truth; standard parameters that the data "
    "alone do not determine have none",
    "bootstrap": "how the constrained estimate scatters when blocks of the data are drawn again",
}


class Ends(NamedTuple):
    """An interval and its label; an end that is not finite is None."""

    lower: float | None
    upper: float | None
    label: str


def ends_of(intervals: Intervals | None) -> dict[str, Ends]:
    """Return the intervals by parameter."""
    if intervals is None:
        return {}
    columns = (intervals.names, intervals.lower, intervals.upper, intervals.label)
    return {
        str(name): Ends(_plain(low), _plain(high), str(label))
        for name, low, high, label in zip(*columns, strict=True)
    }


def intervals_dict(intervals: Intervals) -> dict[str, Any]:
    """Return intervals as plain values, with the ends that tables show."""
    ends = ends_of(intervals)
    content = intervals.to_dict()
    for entry in content["parameters"]:
        entry["lower"], entry["upper"], _ = ends[entry["name"]]
    return content


def in_words(intervals: Intervals | None) -> str | None:
    """Return level and meaning of intervals in words; None for an unknown method."""
    method = getattr(intervals, "method", None)
    level = getattr(intervals, "level", None)
    if method not in _ABOUT or level is None:
        return None
    return f"{100.0 * level:g} % intervals ({method}): {_ABOUT[method]}"


def _plain(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None
