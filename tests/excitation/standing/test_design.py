"""Plans for robots that stand: limits are held, feet stay down in MuJoCo, bad input is told."""

from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid.errors import DataError, ModelError
from sdpid.excitation.limits.check import LimitCheck, LimitRow
from sdpid.excitation.search.space import SplineSpace
from sdpid.excitation.standing.design import _narrowed, _rows
from tests.helpers.refusals import refuses
from tests.helpers.standing import standing_plan


def test_a_plan_holds_its_limits_and_tells_what_it_buys() -> None:
    plan = standing_plan()
    assert plan.limits.ok
    kinds = {row.kind for row in plan.limits.rows}
    assert {"torque", "normal force", "friction", "determinant", "miss"} <= kinds
    assert np.all(plan.standard_errors <= plan.before * (1.0 + 1e-9))
    assert np.min(plan.standard_errors / plan.before) < 0.2
    motion = plan.motion
    # From rest to rest, and somewhere between.
    np.testing.assert_allclose(motion.velocity[[0, -1]], 0.0, atol=1e-9)
    assert np.ptp(motion.base_position, axis=0).max() > 0.01
    assert motion.forces[:, :, 2].min() >= plan.held.load
    np.testing.assert_allclose(
        np.gradient(motion.position, motion.time, axis=0), motion.velocity, atol=0.02
    )


def test_feet_stay_down_in_mujoco() -> None:
    """With links that differ from the plan's, rotors and friction, no foot slips or lifts."""
    motion = standing_plan().motion
    run = sdpid.simulate_legged("solo12", motion)
    assert run.motion.down.all()
    force = run.motion.wrenches[:, :, :3]
    # The ground of the plant holds one; the plan uses half of that.
    used = np.linalg.norm(force[:, :, :2], axis=2) / force[:, :, 2]
    assert used.max() < 0.9
    rows = np.searchsorted(motion.time, run.recording.time)
    off = run.motion.position[:, :3] - motion.base_position[np.minimum(rows, len(motion.time) - 1)]
    assert np.abs(off).max() < 0.02


def test_the_same_design_is_found_again_beside_an_earlier_one() -> None:
    """Earlier plans count: what they tell is known before."""
    plan = standing_plan()
    again = sdpid.design_standing("solo12", duration=3.0, steps=2, previous=plan, progress=False)
    np.testing.assert_allclose(again.before, plan.standard_errors, rtol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"duration": 0.5}, "duration: is 0.5 s; give more than 1"),
        ({"sway": 2.0}, "sway: is 2 m; give more than 0 and less than the base's height"),
        ({"grip": 0.0}, "grip: is 0; give more than 0"),
        ({"load": 0.99}, "load: is 0.99; give more than 0 and at most 0.9"),
        ({"starts": 0}, "starts: is 0"),
        ({"steps": 0}, "steps: is 0; give at least 1"),
        ({"standing": [np.nan] * 12}, "standing: the angle of 'FL_HAA' is nan; give finite ones"),
        ({"standing": [0.0] * 12}, "the leg of 'FL_FOOT' is straight: .* bend its knee"),
        (
            {"limits": sdpid.Limits(torque=0.1)},
            "standing still, torque of .* is .* N.m, the limit is",
        ),
    ],
)
def test_bad_input_is_told_before_the_search(arguments: dict[str, Any], message: str) -> None:
    refuses(DataError, message, sdpid.design_standing, "solo12", **arguments)


def test_limits_are_held_where_the_criterion_looks() -> None:
    """A leg that is stretched there, and nowhere else, would make rows without bound."""
    plan = standing_plan()
    space = SplineSpace.of(plan.stance.n, 3.0)
    finer = space.refined(np.zeros(space.size))
    for each in (space, finer[0]):
        ((_, instants),) = _rows(each, plan.held, 0.9).parts
        np.testing.assert_array_equal(instants, each.grid())


@pytest.mark.parametrize(("slack", "narrower"), [(-1e-6, 1.0013), (-0.05, 1.13), (-np.inf, 2.3)])
def test_limits_are_narrowed_by_what_was_missing(slack: float, narrower: float) -> None:
    """Also where a foot is pulled, and no friction holds it."""
    row = LimitRow(
        kind="friction", subject="foot", side="upper", limit=0.5, worst=0.5 - slack,
        reached=0.5 - slack, time=0.0, slack=slack, unit="1", verdict="broken",
    )  # fmt: skip
    check = LimitCheck(rows=(row,), notes=())
    assert _narrowed(0.97, check) == pytest.approx(0.97 / narrower)


def test_robots_without_legs_are_refused() -> None:
    refuses(ModelError, "has no link with 'foot' or 'sole'", sdpid.design_standing, "ur10_robot")
    # Its fingers mimic each other, which is not what is wrong.
    with pytest.raises(ModelError, match=r"has no link with 'foot' or 'sole'.*no robot on legs"):
        sdpid.design_standing("panda")


def test_limits_that_limit_nothing_are_told() -> None:
    plan = sdpid.design_standing("solo12", duration=2.0, steps=2, progress=False)
    told = [note for note in plan.notes if "limit nothing" in note]
    assert len(told) == 3
    assert told[1].startswith("all joints have velocity limits in the description")


def test_motions_of_other_robots_are_refused() -> None:
    with pytest.raises(DataError, match="'go1' has 12 joints and feet FL_foot"):
        sdpid.simulate_legged("go1", standing_plan().motion)
    with pytest.raises(DataError, match="duration: 9 s, the motion ends after 3 s"):
        sdpid.simulate_legged("solo12", standing_plan().motion, duration=9.0)
