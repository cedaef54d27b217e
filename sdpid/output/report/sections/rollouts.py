"""Simulations of the validation recording: tables and curves."""

from __future__ import annotations

from typing import Any

from sdpid.output.report.judged import Judged
from sdpid.plots.in_pages import image_source


def values(result: Judged, draw: bool) -> dict[str, Any]:
    """Return the values of the template: one entry a rollout."""
    return {
        "rollouts": [
            {
                "title": "All joints free" if each.free == "all" else "One joint free at a time",
                "starts": len(each.start),
                "verdict": each.verdict,
                "notes": each.notes,
                "models": each.as_table(),
                "joints": each.joint_table(),
                "source": image_source(each.plot()) if draw else None,
            }
            for each in result.rollouts
        ]
    }
