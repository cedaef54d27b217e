"""Simulations of the validation recording: tables and curves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from sdpid.output.report.judged import Judged, Rolled
from sdpid.plots.in_pages import image_source


def values(result: Judged, draw: bool) -> dict[str, Any]:
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
                "source": image_source(each.plot()) if draw else None,
            }
            for each, told in zip(result.rollouts, fresh_notes(result.rollouts), strict=True)
        ]
    }


def fresh_notes(rollouts: Sequence[Rolled]) -> list[list[str]]:
    """Return the notes of each rollout that those before it have not said."""
    said: set[str] = set()
    fresh = []
    for each in rollouts:
        fresh.append([note for note in each.notes if note not in said])
        said.update(each.notes)
    return fresh
