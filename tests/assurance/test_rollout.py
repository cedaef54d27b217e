"""The truth moves as the robot did, a wrong model does not, and what runs away is told."""

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sdpid
from sdpid import validate
from sdpid._common.arrays import Array
from sdpid.assurance.diagnostics.held_out import FRICTION_FITTED, LEAST_SQUARES
from sdpid.assurance.diagnostics.light_joints import LightJoint, light_joints
from sdpid.assurance.rollouts.result import CONSTANT_VELOCITY, FLOOR, STAND_STILL
from sdpid.errors import DataError, ModelError
from sdpid.estimation.estimate import Estimate
from sdpid.experiment.processing.motion import noise_of
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.workflow.result import Identification
from tests.helpers.data import random_theta
from tests.helpers.motions import sines
from tests.helpers.refusals import refuses
from tests.helpers.robots import small_arm

TERMS = ("viscous", "offset")
HORIZONS = (0.1, 0.5, 2.0)
OURS = "this estimate"


@cache
def truth() -> RobotDynamics:
    bare = small_arm(2)
    theta = random_theta(bare, np.random.default_rng(7), TERMS)
    robot = replace(bare, prior=theta[:20].reshape(2, 10))
    terms = FrictionModel.from_terms(TERMS, robot.joint_names)
    return RobotDynamics(robot=robot, terms=terms, theta=theta)


def arm() -> sdpid.RobotModel:
    return truth().robot


def but_for(place: int, value: float) -> RobotDynamics:
    """Return the truth with another value of one parameter."""
    theta = np.array(truth().theta)
    theta[place] = value
    return replace(truth(), theta=theta)


def motion(seed: int, seconds: float = 12.0, rate: float = 200.0) -> tuple[Array, ...]:
    """Return time, positions, velocities and accelerations of a smooth motion."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, seconds, 1.0 / rate)
    w, c = rng.uniform(0.5, 3.0, (3, 2)), rng.uniform(0.0, 6.0, (3, 2))
    return t, *sines(t, w, c)


def recorded(seed: int, noise: float = 0.0) -> sdpid.Recording:
    t, q, v, a = motion(seed)
    rng = np.random.default_rng(seed)
    effort = truth().inverse_dynamics(q, v, a)
    return sdpid.Recording(
        time=t,
        position=q + noise * rng.standard_normal(q.shape),
        effort=effort + 100.0 * noise * rng.standard_normal(q.shape),
        joint_names=arm().joint_names,
    )


def identified(**options: Any) -> Identification:
    options = {"friction": TERMS, "effects": "none", "intervals": False, **options}
    return sdpid.identify(arm(), recorded(1, 1e-4), **options)


@cache
def estimated() -> Estimate:
    return identified().estimate


@pytest.mark.parametrize("free", ["all", "each"])
def test_the_truth_has_only_the_floor(free: str) -> None:
    noisy = recorded(2, 1e-4)
    exact = sdpid.rollout(truth(), recorded(2), HORIZONS, free=free)
    found = sdpid.rollout(truth(), noisy, HORIZONS, free=free)
    assert not exact.diverged.any()
    # The filter and the interpolation leave less than a thousandth of a radian.
    assert exact.median[-1] < 1e-3
    floor = found.models[FLOOR].quantile(0.5)
    assert np.all(found.median < 4.0 * floor + 1e-3)
    assert np.all(floor < 4.0 * found.median + 1e-3)
    assert found.level == "good"


def test_models_are_told_apart() -> None:
    estimate = estimated()
    worse = Estimate.of_theta(
        estimate.problem, estimate.theta * 1.2, method="given", status="given"
    )
    log = recorded(2, 1e-4)
    own, other = (sdpid.rollout(each, log, HORIZONS, free="all") for each in (estimate, worse))
    assert own.median[1] < 0.2 * other.median[1]
    for name in (FRICTION_FITTED, LEAST_SQUARES, CONSTANT_VELOCITY, STAND_STILL, FLOOR):
        assert name in own.models
    assert own.median[1] < 0.1 * own.models[CONSTANT_VELOCITY].quantile(0.5)[1]
    frame = own.to_frame()
    assert len(frame) == len(own.models) * 2 * 3
    assert frame[frame.model == OURS]["median"].max() < 0.1
    assert "never judge at 0.1 s alone" in own.notes[-1]
    assert own.to_dict()["models"][OURS]["diverged"] == [0.0, 0.0, 0.0]


def test_what_runs_away_is_told_and_raises_nothing() -> None:
    # A negative rotational inertia about the last axis: no body has it, and friction drives it.
    found = sdpid.rollout(but_for(10 + 9, -0.01), recorded(2), HORIZONS, free="all")
    assert found.diverged[-1] == 1.0
    assert np.isinf(found.median[-1])
    assert "runs away" in found.verdict
    assert found.level == "bad"
    assert "-" in found.table()
    assert found.to_dict()["models"]["this model"]["median"][-1] is None


def test_one_joint_free_leaves_the_others_on_the_record() -> None:
    # Viscous friction of the second joint alone.
    wrong = but_for(20 + 1, 3.0 * truth().theta[20 + 1])
    found = sdpid.rollout(wrong, recorded(2), (0.5,), free="each")
    first, second = found.models["this model"].joints()[0]
    assert first < 1e-3 < 1e-2 < second
    alone = sdpid.rollout(wrong, recorded(2), (0.5,), free=arm().joint_names[1])
    assert alone.joint_names == arm().joint_names[1:]
    assert alone.models["this model"].joints()[0, 0] == pytest.approx(second, rel=1e-9)
    left = sdpid.rollout(wrong, recorded(2), (0.5,), without_effort=arm().joint_names[1])
    assert left.joint_names == arm().joint_names[:1]


@pytest.mark.parametrize(
    ("given_", "message"),
    [
        ({"horizons": ()}, "each above 0"),
        ({"horizons": (0.1, -1.0)}, "each above 0"),
        ({"horizons": (100.0,)}, "without a break"),
        ({"free": "elbow"}, "no joint elbow"),
        ({"free": ()}, "none named"),
        ({"start_every": 0.0}, "above 0"),
        ({"without_effort": "elbow"}, "no joint elbow"),
        ({"without_effort": small_arm(2).joint_names}, "every joint"),
    ],
)
def test_bad_arguments_are_told(given_: dict[str, Any], message: str) -> None:
    refuses(DataError, message, sdpid.rollout, truth(), recorded(2), **given_)


def test_what_cannot_be_simulated_is_told() -> None:
    refuses(DataError, "give an Estimate", sdpid.rollout, arm(), recorded(2))
    samples = replace(sdpid.process(recorded(2)), time=None)
    refuses(DataError, "have no time", sdpid.rollout, truth(), samples)
    base = sdpid.load_robot("solo12", root="free_flyer")
    terms = FrictionModel.from_terms((), base.joint_names, first=6)
    floating = RobotDynamics(robot=base, terms=terms, theta=base.prior.ravel())
    refuses(ModelError, "floating base", sdpid.rollout, floating, recorded(2))


def test_samples_have_no_floor_and_long_horizons_are_left_out() -> None:
    found = sdpid.rollout(truth(), sdpid.process(recorded(2)), (0.5, 60.0), free="all")
    assert found.horizons == (0.5,)
    assert FLOOR not in found.models
    assert any("no horizon of 60 s" in note for note in found.notes)
    assert any("no floor" in note for note in found.notes)


def test_noise_is_found_on_top_of_motion() -> None:
    _, q, _, _ = motion(3)
    levels = np.array([1e-5, 1e-3])
    noisy = q + levels * np.random.default_rng(0).standard_normal(q.shape)
    assert noise_of(noisy, 200.0) == pytest.approx(levels, rel=0.1)
    assert noise_of(q, 200.0).max() < 1e-7


@given(st.floats(1e-4, 1.0), st.just(0.0) | st.floats(1e-3, 10.0), st.floats(1e-3, 1.0))
def test_the_drift_is_that_of_a_damped_body(M: float, d: float, e: float) -> None:
    joint = LightJoint(joint="j", inertia=M, damping=d, error=e, velocity=1.0, acceleration=1.0)
    # Exact for piecewise constant efforts, of which there is one.
    rate, t = d / M, 0.1
    exact = e * t * t / (2 * M) if rate == 0.0 else e / d * (t + math.expm1(-rate * t) / rate)
    assert joint.drift == pytest.approx(exact, rel=1e-3, abs=1e-12)


def test_light_joints_are_named() -> None:
    estimate = estimated()
    samples = estimate.problem.samples
    errors = validate(estimate).moving
    assert light_joints(estimate.model(), samples, errors) == ()
    every = light_joints(estimate.model(), samples, errors, limit=0.0)
    assert [each.joint for each in every] == list(arm().joint_names)
    worse = replace(errors, rmse=1e4 * errors.rmse)
    found = light_joints(estimate.model(), samples, worse)
    assert found
    assert "too light to be simulated" in found[0].words
    assert "prior" in found[0].remedy
    hopeless = replace(found[0], inertia=1e-9, damping=0.0)
    assert "no faster run" in hopeless.remedy
    assert "no viscous friction" in hopeless.remedy


def test_identify_shows_it(tmp_path: Any) -> None:
    refuses(DataError, "validation", identified, rollout=True)
    result = identified(validation=recorded(2, 1e-4), rollout=True)
    assert [each.free for each in result.rollouts] == ["all", "each"]
    assert any("It moves as the robot does" in text for text in result.verdict)
    page = sdpid.write_report(result, tmp_path / "report.html").read_text("utf-8")
    assert "Motion in open loop" in page
    assert result.to_dict()["rollouts"][0]["verdict"] in page
    # What both have in common is said once.
    assert page.count("under the filtered efforts, which raw ones hardly change") == 1


def test_closed_loop_follows_the_reference() -> None:
    law = sdpid.controllers.PD(np.full(2, 200.0), np.full(2, 20.0))
    t, q, _, _ = motion(2, seconds=6.0)
    moved = sdpid.simulate_closed_loop(truth(), q, law, rate_hz=200.0)
    log = sdpid.Recording(
        time=t,
        position=moved.position,
        effort=moved.effort,
        reference=q,
        joint_names=arm().joint_names,
    )
    found = sdpid.rollout(truth(), log, (0.1, 0.5), controller=law, start_every=1.0)
    assert found.free == "closed loop"
    assert found.median[-1] < 1e-3
    assert found.median[-1] < 0.1 * found.models["reference followed exactly"].quantile(0.5)[-1]
    assert "in closed loop" in found.verdict
    refuses(DataError, "has none", sdpid.rollout, truth(), recorded(2), controller=law)
    with pytest.raises(DataError, match="moves all joints"):
        sdpid.rollout(truth(), log, controller=law, free=arm().joint_names[0])
