"""A small plan, made once for all tests of a process."""

from functools import cache

import sdpid
from sdpid.excitation.geometry.obstacles import Box, table
from sdpid.excitation.plan.plan import Plan
from sdpid.excitation.standing.design import design_standing
from sdpid.excitation.standing.plan import StandingPlan
from tests.helpers.arm_files import ARM_URDF

LIMITS = sdpid.Limits(acceleration={"a": 5.0, "b": 8.0}, jerk=200.0, clearance=0.02)
AROUND = (table(-0.5), Box(size=(0.1, 0.1, 0.1), translation=(0.0, 2.0, 0.0), name="<b>box"))


@cache
def small_plan() -> Plan:
    """Return a plan for the arm of `ARM_URDF`, found from one start."""
    return sdpid.design_excitation(
        sdpid.load_robot(ARM_URDF),
        duration=4.0,
        limits=LIMITS,
        obstacles=AROUND,
        starts=1,
        seed=3,
        progress=False,
    )


# A small plan for a robot that stands, made once for all tests of a process.


@cache
def standing_plan() -> StandingPlan:
    """Return a plan for Solo12 from a short search."""
    return design_standing("solo12", duration=3.0, steps=12, progress=False)
