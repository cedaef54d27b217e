"""A small plan for a robot that stands, made once for all tests of a process."""

from functools import cache

from sdpid.excitation.standing.design import design_standing
from sdpid.excitation.standing.plan import StandingPlan


@cache
def standing_plan() -> StandingPlan:
    """Return a plan for Solo12 from a short search."""
    return design_standing("solo12", duration=3.0, steps=12, progress=False)
