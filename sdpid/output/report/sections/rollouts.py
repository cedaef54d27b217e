"""Simulations of the validation recording: tables and curves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sdpid.output.charts.charts import Charts
from sdpid.output.report.judged import Judged, Rolled


def values(result: Judged, charts: Charts) -> dict[str, Any]:
    """Return the values of the template: one entry a rollout."""
    return {
        "rollouts": [
            {
                "title": "All joints free" if each.free == "all" else "One joint free at a time",
                "starts": len(each.start),
                "verdict": each.verdict,
                "notes": told,
                "models": each.as_table(),
                "joints": each.joint_table(),
                "chart": _chart(each, charts),
                "own": each.own,
                "names": list(each.medians),
            }
            for each, told in zip(result.rollouts, fresh_notes(result.rollouts), strict=True)
        ]
    }


def _chart(rolled: Rolled, charts: Charts) -> int:
    """Return the median errors over time, exponents of ten of mrad; what ran away is missing."""
    with np.errstate(divide="ignore"):
        powers = {name: np.log10(1e3 * median) for name, median in rolled.medians.items()}
    return charts.add(x=rolled.time, **powers)


def fresh_notes(rollouts: Sequence[Rolled]) -> list[list[str]]:
    """Return the notes of each rollout that those before it have not said."""
    said: set[str] = set()
    fresh = []
    for each in rollouts:
        fresh.append([note for note in each.notes if note not in said])
        said.update(each.notes)
    return fresh
