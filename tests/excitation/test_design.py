import itertools
import json
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sdpid
from sdpid.errors import DataError, InfeasibleError, MissingExtraError, ModelError
from sdpid.excitation.criterion.criterion import Criterion, ObjectiveKind
from sdpid.excitation.geometry.obstacles import table
from sdpid.excitation.plan.plan import Plan
from sdpid.excitation.search import search
from sdpid.excitation.search.search import Search, checked, mend
from sdpid.excitation.search.space import random_start
from sdpid.experiment.trajectory.curve import Spline
from tests.helpers.plans import small_plan
from tests.helpers.refusals import refuses
from tests.helpers.robots import planar_arm, small_arm
from tests.helpers.searches import LIMITS, criterion_of, search_of
from tests.helpers.studies import study

# Plans: within every limit at every instant, the same for a seed, and stoppable.


QUICK: dict[str, Any] = {"duration": 6.0, "starts": 1, "seed": 1}


@pytest.fixture(scope="module")
def plan() -> Plan:
    limits = sdpid.Limits(acceleration=4.0, jerk=60.0, clearance=0.02)
    return sdpid.design_excitation("denso_vp6242", limits=limits, obstacles=[table()], **QUICK)


def test_a_plan_holds_its_limits_at_every_instant(plan: Plan) -> None:
    assert plan.limits.ok
    assert all(row.slack >= 0.0 for row in plan.limits.rows)
    kinds = {row.kind for row in plan.limits.rows}
    assert kinds >= {"position", "velocity", "acceleration", "jerk", "distance"}
    position, velocity, acceleration = plan.trajectory.sample()
    np.testing.assert_allclose([velocity[0], acceleration[0]], 0.0, atol=1e-9)
    np.testing.assert_allclose(
        *plan.trajectory.series.evaluate(np.array([0.0, plan.trajectory.period])), atol=1e-9
    )
    assert np.ptp(position, axis=0).min() > 0.1


def test_a_plan_shows_every_parameter(plan: Plan) -> None:
    assert plan.condition_number < 1e3
    assert plan.standard_errors.shape == (len(plan.names),)
    assert np.all(plan.standard_errors > 0.0)
    assert plan.expected.sentences()
    assert json.loads(json.dumps(plan.settings))["duration"] == 6.0


def test_the_same_seed_makes_the_same_plan() -> None:
    plans = small_plan(), small_plan.__wrapped__()
    one, other = (plan.trajectory.series.control_points for plan in plans)
    np.testing.assert_array_equal(one, other)


SHORT: dict[str, Any] = {"duration": 20.0, "time_limit": 1.5, "objective": "D"}
START = np.array([0.3, 0.2, -1.2, 0.1, -0.3, 0.2])


@pytest.mark.parametrize(
    ("name", "asked"),
    [
        ("denso_vp6242", {"start": START, "objective": "D", "friction": ("viscous",), **QUICK}),
        ("denso_vp6242", {"purpose": "payload", **QUICK}),
        ("panda", {"torque_spread": 2.0, "duration": 6.0, "time_limit": 2.0, "collisions": False}),
        *(
            (
                "denso_vp6242",
                {"motion": kind, "duration": 20.0, "time_limit": 1.5, "objective": "D"},
            )
            for kind in ("fourier", "postures", "one_by_one")
        ),
    ],
    ids=["start", "payload", "torque", "fourier", "postures", "one_by_one"],
)
def test_whatever_is_asked_for_the_limits_hold(name: str, asked: dict[str, Any]) -> None:
    found = sdpid.design_excitation(name, **asked)
    assert found.limits.ok
    assert found.purpose == asked.get("purpose", "all")
    motion = asked.get("motion", "spline")
    assert found.motion == motion
    assert any(note.startswith(f"motion '{motion}'") for note in found.notes)
    if "start" in asked:
        np.testing.assert_allclose(found.trajectory.sample()[0][0], START, atol=1e-6)
    assert name != "panda" or any(row.kind == "torque" for row in found.limits.rows)


def test_an_interrupted_search_returns_the_best_so_far(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = 0
    whole = Criterion.gradient

    def interrupted(*arguments: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls == 20:
            raise KeyboardInterrupt
        return whole(*arguments)

    monkeypatch.setattr(Criterion, "gradient", interrupted)
    found = sdpid.design_excitation("denso_vp6242", **QUICK)
    assert found.limits.ok
    assert any("interrupted" in note for note in found.notes)


def test_what_is_delivered_is_hardly_worse_than_what_was_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    broken, worse = [], []

    def mended(search: Any, found: Any) -> Any:
        broken.append(not checked(search, found[0])[1].ok)
        best, check = mend(search, found)
        worse.append(best.value - found[0].value)
        return best, check

    monkeypatch.setattr(search, "mend", mended)
    # The tool is too fast between the instants of the grid.
    plan = sdpid.design_excitation(
        "denso_vp6242", limits=sdpid.Limits(tool_speed=0.5), collisions=False, **QUICK
    )
    assert plan.limits.ok
    assert broken == [True]
    assert worse[0] <= 0.1


def test_the_search_begins_with_the_best_of_its_random_motions(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class SeenError(Exception):
        pass

    def seen(search: Search, starts: Any, *_: Any, **__: Any) -> Any:
        values = [search.value_and_gradient(x)[0] for x in itertools.islice(starts, 4)]
        assert values[0] == min(values)
        # A finger that slides by centimeters is moved as much of its range as the arm.
        np.testing.assert_allclose(search.space.sizes[:7], 1.0)
        assert search.space.sizes[7] == pytest.approx(0.019)
        # Its mass, which no motion shows beside the arm's, does not rule the condition number.
        shown, names = search.criterion.objective.shown, search.criterion.rows.base.names
        hidden = np.linalg.svd(shown.T)[2][-1]
        assert shown.shape == (len(names), len(names) - 1)
        assert {names[k] for k in np.argsort(-np.abs(hidden))[:3]} == {"m8", "m9", "myr4"}
        raise SeenError

    monkeypatch.setattr(Search, "run", seen)
    with pytest.raises(SeenError):
        sdpid.design_excitation("panda", collisions=False, seed=2)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"duration": 0.2}, "too short for the limits"),
        ({"duration": -1.0}, "positive time"),
        ({"duration": 1e9}, "repeat a shorter motion"),
        ({"starts": 0}, "at least 1"),
        ({"time_limit": 0.0}, "positive time"),
        ({"motion": "chirp"}, "use one of spline"),
        ({"purpose": "fun"}, "use one of all"),
        ({"objective": "G"}, "use one of mixed"),
        ({"harmonics": 5}, "Fourier"),
        ({"motion": "fourier", "closed": False}, "closed"),
        ({"periods": 0}, "from 1"),
        ({"periods": 2, "closed": False}, "ends elsewhere"),
        ({"purpose": "torque"}, "give the motion"),
    ],
)
def test_bad_arguments_are_told_before_the_search(arguments: Any, words: str) -> None:
    refuses(DataError, words, sdpid.design_excitation, "denso_vp6242", **{**QUICK, **arguments})


def test_a_motion_that_tells_nothing_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def nothing(*_: Any, **__: Any) -> Any:
        raise DataError("mask: leaves none of 10 rows.")

    monkeypatch.setattr("sdpid.excitation.design.design.expect", nothing)
    with pytest.raises(InfeasibleError, match=r"tells nothing.*none of 10 rows"):
        sdpid.design_excitation("denso_vp6242", collisions=False, time_limit=2.0, duration=6.0)


def test_a_floating_base_is_refused() -> None:
    solo = sdpid.load_robot("solo12", root="free_flyer")
    refuses(ModelError, "floating base", sdpid.design_excitation, solo)


def test_without_casadi_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    # None stands for a module that cannot be found.
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(MissingExtraError, match=r"pip install .*\[excite\]'"):
        sdpid.design_excitation("denso_vp6242", **QUICK)


# Laws of designs: tighter limits never gain, and mirrored or turned motions show as much.


pytest.importorskip("casadi", reason="needs the extra excite")

KINDS = ("velocity", "acceleration", "jerk")


def test_no_grid_finds_less_slack_than_is_stated() -> None:
    plan = small_plan()
    dense = study("dense_check")
    states, limits = dense.states_of(plan.trajectory), plan.joint_limits
    kinds = ("lower", "upper", *KINDS)
    found = list(
        dense.joints_reached(
            plan.robot.joint_names, states, **{kind: getattr(limits, kind) for kind in kinds}
        )
    )
    effort = dense.efforts(plan.robot, states)
    found += dense.efforts_reached(plan.robot.joint_names, states.time, effort, limits.torque)
    stated: dict[tuple[str, str], float] = {}
    for row in plan.limits.rows:
        key = row.kind, row.subject
        stated[key] = min(row.slack, stated.get(key, np.inf))
    assert found
    assert all(reached.held for reached in found)
    for reached in found:
        assert reached.slack >= stated[reached.kind, reached.subject] - 1e-9


FLOATING = small_arm(3).with_gravity((0.0, 0.0, 0.0))
BOTH = ("coulomb", "viscous")


@pytest.mark.parametrize(
    ("robot", "kind", "friction", "changed"),
    [
        # Without gravity motions may take longer.
        (FLOATING, "condition", (), lambda q, v, a, x: (q, v / x, a / x**2)),
        # Joint angle zero is horizontal: the mirror turns the first joint by half a turn.
        *(
            (planar_arm(), kind, BOTH, lambda q, v, a, _: (np.array([np.pi, 0.0]) - q, -v, -a))
            for kind in ("condition", "D", "mixed")
        ),
        # A first joint that is vertical.
        (small_arm(3), "mixed", BOTH, lambda q, v, a, x: (q + np.array([x, 0.0, 0.0]), v, a)),
    ],
)
@given(seed=st.integers(0, 1000), x=st.floats(0.2, 5.0))
def test_motions_that_are_alike_show_as_much(
    robot: sdpid.RobotModel, kind: ObjectiveKind, friction: Any, changed: Any, seed: int, x: float
) -> None:
    points = np.random.default_rng(seed).uniform(-1.5, 1.5, (20, robot.n))
    curve, time = Spline(duration=8.0, control_points=points), (np.arange(80) + 0.5) / 10.0
    states = [curve.evaluate(time, derivative=order) for order in range(3)]
    criterion = criterion_of(robot, kind, friction)
    usual, other = (criterion.value(*each, 8.0) for each in (states, changed(*states, x)))
    assert other == pytest.approx(usual, abs=1e-6)


@settings(max_examples=6, deadline=None)
@given(st.sampled_from(KINDS), st.floats(0.3, 0.9), st.integers(0, 100))
def test_a_tighter_limit_never_gains(kind: str, factor: float, seed: int) -> None:
    # What is best within the tighter limits is within the wider ones, and may get better there.
    wide = search_of(LIMITS)
    tight = search_of(replace(LIMITS, **{kind: factor * getattr(LIMITS, kind)}))
    rng = np.random.default_rng(seed)
    start = random_start(tight.space, tight.linear, rng.uniform(-1, 0.5, 2), rng, lambda x: True)
    within = tight.improve(start)
    matrix, lower, upper = wide.linear
    assert np.all((matrix @ within.x >= lower) & (matrix @ within.x <= upper))
    assert wide.improve(within.x).value <= within.value


# A plan draws its motion against its limits.


def test_a_plan_is_drawn_against_its_limits() -> None:
    pytest.importorskip("matplotlib")
    plan = small_plan()
    axes = plan.plot()
    assert axes.shape == (5, plan.robot.n)
    assert [axis.get_title(loc="left") for axis in axes[0]] == list(plan.robot.joint_names)
    assert [axis.get_ylabel() for axis in axes[:, 0]] == ["rad", "rad/s", "rad/s²", "rad/s³", "N·m"]
    for j in range(plan.robot.n):
        motion, *limits = axes[2, j].get_lines()
        most = plan.joint_limits.acceleration[j]
        assert np.abs(motion.get_ydata()).max() <= most * (1.0 + 1e-9)
        assert sorted(line.get_ydata()[0] for line in limits) == pytest.approx([-most, most])
