"""Plans: within every limit at every instant, the same for a seed, and stoppable."""

import itertools
import sys
from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid.errors import DataError, InfeasibleError, MissingExtraError, ModelError
from sdpid.excitation.criterion.criterion import Criterion
from sdpid.excitation.design import design
from sdpid.excitation.design.repair import checked, mend
from sdpid.excitation.geometry.obstacles import table
from sdpid.excitation.plan.plan import Plan
from sdpid.excitation.search.search import Search
from tests.helpers.dense_check import dense_check
from tests.helpers.refusals import refuses

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


def test_a_plan_holds_its_limits_on_a_dense_grid(plan: Plan) -> None:
    states = dense_check().states_of(plan.trajectory)
    limits = plan.joint_limits
    for reached, most in (
        (states.velocity, limits.velocity),
        (states.acceleration, limits.acceleration),
        (states.jerk, limits.jerk),
    ):
        assert np.all(np.abs(reached).max(axis=0) <= most)
    assert np.all(states.position >= limits.lower)
    assert np.all(states.position <= limits.upper)


def test_a_plan_is_at_rest_where_it_begins_and_ends(plan: Plan) -> None:
    position, velocity, acceleration = plan.trajectory.sample()
    np.testing.assert_allclose(velocity[0], 0.0, atol=1e-9)
    np.testing.assert_allclose(acceleration[0], 0.0, atol=1e-9)
    ends = plan.trajectory.series.evaluate(np.array([0.0, plan.trajectory.period]))
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)
    assert np.ptp(position, axis=0).min() > 0.1


def test_a_plan_shows_every_parameter(plan: Plan) -> None:
    assert plan.condition_number < 1e3
    assert plan.standard_errors.shape == (len(plan.names),)
    assert np.all(plan.standard_errors > 0.0)
    assert plan.expected.sentences()


def test_the_same_seed_makes_the_same_plan(plan: Plan) -> None:
    limits = sdpid.Limits(acceleration=4.0, jerk=60.0, clearance=0.02)
    again = sdpid.design_excitation("denso_vp6242", limits=limits, obstacles=[table()], **QUICK)
    np.testing.assert_array_equal(
        again.trajectory.series.control_points, plan.trajectory.series.control_points
    )


def test_a_plan_begins_where_it_is_asked_to() -> None:
    start = np.array([0.3, 0.2, -1.2, 0.1, -0.3, 0.2])
    found = sdpid.design_excitation(
        "denso_vp6242", start=start, objective="D", friction=("viscous",), **QUICK
    )
    np.testing.assert_allclose(found.trajectory.sample()[0][0], start, atol=1e-6)
    assert found.limits.ok


@pytest.mark.parametrize("motion", ["fourier", "postures", "one_by_one"])
def test_every_kind_of_motion_holds_its_limits(motion: Any) -> None:
    found = sdpid.design_excitation(
        "denso_vp6242", motion=motion, duration=20.0, starts=1, time_limit=3.0, objective="D"
    )
    assert found.limits.ok
    assert found.motion == motion
    assert any(note.startswith(f"motion '{motion}'") for note in found.notes)


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

    def mended(task: Any, search: Any, found: Any, inequalities: Any) -> Any:
        broken.append(not checked(task, found[0])[1].ok)
        best, check = mend(task, search, found, inequalities)
        worse.append(best.value - found[0].value)
        return best, check

    monkeypatch.setattr(design, "mend", mended)
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


def test_a_payload_is_asked_for_by_name() -> None:
    found = sdpid.design_excitation("denso_vp6242", purpose="payload", **QUICK)
    assert found.purpose == "payload"
    assert found.limits.ok


def test_torque_limits_with_a_spread_are_held() -> None:
    robot = sdpid.load_robot("panda")
    found = sdpid.design_excitation(
        robot, torque_spread=2.0, duration=6.0, starts=1, time_limit=4.0, collisions=False
    )
    rows = [row for row in found.limits.rows if row.kind == "torque"]
    assert rows
    assert found.limits.ok


def test_settings_are_plain(plan: Plan) -> None:
    import json

    assert json.loads(json.dumps(plan.settings))["duration"] == 6.0


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
    with pytest.raises(ModelError, match="floating base"):
        sdpid.design_excitation(sdpid.load_robot("solo12", root="free_flyer"))


def test_without_casadi_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    # None stands for a module that cannot be found.
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(MissingExtraError, match=r"pip install .casadi"):
        sdpid.design_excitation("denso_vp6242", **QUICK)
