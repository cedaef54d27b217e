"""A small plan for a robot that stands, made once for all tests of a process."""

from __future__ import annotations

from functools import cache

from sdpid.excitation.standing.design import design_standing
from sdpid.excitation.standing.plan import StandingPlan


@cache
def standing_plan() -> StandingPlan:
    """Return a plan for Solo12, searched for a few seconds: the search may be cut short."""
    return design_standing("solo12", duration=3.0, time_limit=8.0, progress=False)
