"""Predictions, bands, what was held out, what errors go with, and where parameters come from."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sdpid
from sdpid import Prior, RobotModel, Samples, build_problem, load_robot, solve_sdp, solve_wls
from sdpid._common.arrays import Array
from sdpid.assurance.diagnostics import bands, held_out
from sdpid.assurance.diagnostics import provenance as origins
from sdpid.assurance.diagnostics.active_constraints import ConstraintState, constraint_states
from sdpid.assurance.diagnostics.causes import Cause, find_causes, held_back, joint_errors
from sdpid.assurance.diagnostics.described import described_dynamics
from sdpid.assurance.diagnostics.mass_matrix import proven_bound
from sdpid.assurance.diagnostics.provenance import collinear_friction, in_words, provenance
from sdpid.assurance.diagnostics.rest import REST_SECONDS, REST_SPEED, moving_and_resting
from sdpid.assurance.diagnostics.validation import Validation, validate_dynamics, validate_robot
from sdpid.assurance.tables.csv_table import read_base_table
from sdpid.cli.commands import errors_table
from sdpid.errors import DataError
from sdpid.estimation.estimate import FEASIBLE, Estimate
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling
from sdpid.experiment.preparation.prepare import samples_of
from sdpid.experiment.processing.contact_samples import ContactSamples
from sdpid.experiment.processing.robot_contacts import base_held
from sdpid.output.tables.parameter_tables import theta_table
from sdpid.robot.description.catalog import bundled_folder
from sdpid.robot.inertia import Consistency, from_pseudo_inertia, point_masses, spatial_inertia
from sdpid.robot.model.jacobians import joint_rates, link_jacobians
from tests.helpers import legged
from tests.helpers.arm import ARM, BOTH, CONDITIONS, FIRST, LAST, LIGHT, TURNED, arm_problem
from tests.helpers.data import flat_links, make_samples, random_links, random_theta
from tests.helpers.identified import FRICTION, RATE, arm_theta, identified, moved
from tests.helpers.motions import sines
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE, TREE_MIMIC, described_arm, small_arm
from tests.helpers.runs import arm, recorded
from tests.helpers.small_robots import MODELS
from tests.helpers.strategies import SEEDS, random_states


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("size", [0.0, 1e-300, 1e-153, 1e-100])
def test_beside_an_effort_that_is_all_but_zero_no_share_is_told(size: float) -> None:
    samples = moved(arm_theta(), 1)
    effort = samples.effort * [size, 1.0]
    fit = sdpid.validate(identified(samples).estimate, replace(samples, effort=effort))
    assert fit.rmse[0] > 0.0
    assert fit.nrmse[0] > 1e90
    assert fit.r2[0] == -np.inf or fit.r2[0] < -1e90
    assert np.isfinite([fit.nrmse[1], fit.r2[1], fit.relative]).all()
    if size:
        return
    assert fit.nrmse[0] == np.inf
    told = fit.to_dict()["joints"]["joint_1"]
    assert told["nrmse"] is told["r2"] is None
    assert told["rmse"] > 0.0
    printed = errors_table({"training": fit}).splitlines()
    assert printed[-1] == "no effort of which errors are a share: joint_1"
    assert next(line for line in printed if line.startswith("joint_1")).split()[-1] == "-"
    # Where nothing is predicted either, nothing is missed.
    still = replace(fit, moving=replace(fit.moving, nrmse=np.zeros(len(fit.nrmse))))
    assert "no effort" not in errors_table({"training": still})


def test_recordings_and_files_are_read_as_by_identify(tmp_path: Path) -> None:
    log, other = recorded(0), recorded(1)
    file = tmp_path / "other.npz"
    names = np.array(other.joint_names)
    np.savez(file, t=other.time, q=other.position, tau=other.effort, joint_names=names)
    found = sdpid.identify(arm(), log, validation=other, intervals=False, effects="none")
    processing = {"cutoff_hz": 5.0}
    for fresh in (other, file, [str(file)]):
        fit = sdpid.validate(found.estimate, fresh)
        np.testing.assert_allclose(fit.relative, found.validation.relative, rtol=0.05)
        slow = sdpid.validate(found.estimate, fresh, processing=processing, without_effort=["a"])
        assert slow.rows[0] == 0 < slow.rows[1]
    turned = replace(other, effort=-other.effort)
    refuses(DataError, r"validation.*effort_sign", sdpid.validate, found.estimate, turned)
    assert sdpid.validate(found.estimate, turned, accept="effort_sign").relative > 1.0
    refuses(DataError, "validation: is or holds int", sdpid.validate, found.estimate, 3)


def test_a_description_on_legs_is_judged_beside_the_forces_that_suit_it() -> None:
    made = legged.gait(160)
    right = validate_robot(made.robot, made.samples)
    assert right.relative < 1e-9
    assert right.floating.force < 1e-9 > right.floating.torque
    # Every body a tenth heavier, and noise: neither is hidden among the forces.
    samples = made.noisy(noise=0.1 * legged.NOISE)
    heavy = described_dynamics(made.robot, samples, bodies=1.1 * made.robot.prior)
    wrong = validate_dynamics(heavy, samples)
    assert wrong.relative > 3.0 * validate_robot(made.robot, samples).relative


def test_coordinates_of_a_base_are_no_joints_in_tables() -> None:
    made = legged.gait(40)
    flight = replace(made.samples, contacts=None)
    for samples in (made.samples, flight):
        fit = validate_robot(made.robot, samples)
        assert repr(fit).startswith("Validation(relative=")
        assert "root_joint" not in fit.table() + str(fit.to_dict()) + fit.moving.table()
        assert fit.table().count("\n") == 14
        assert "base, force in N" in fit.table()
        assert not fit.rows[:6].any()
    # Without the forces of the feet the base misses its weight.
    assert fit.floating.force > 10.0
    assert fit.to_dict()["floating"] == fit.floating.to_dict()


def test_a_held_base_leaves_an_arm_of_legs() -> None:
    """An arm's recording predicts the same with its base said to be held as with a fixed one."""
    arm = sdpid.load_robot("solo12")
    t, rates = 0.002 * np.arange(1000), 2.0 * np.pi * np.linspace(0.6, 1.7, arm.n)[None]
    q, v, a = sines(t, rates, np.zeros_like(rates), 0.4)
    effort = 1.1 * arm.inverse_dynamics(arm.prior, q, v, a)
    log = sdpid.Recording(time=t, position=q, effort=effort, joint_names=arm.joint_names)
    held = log.with_held_base("base_link")
    refuses(DataError, "has the motion of a base already", held.with_held_base, "base_link")
    processing = sdpid.Processing(cutoff_hz=20.0, filter="finite", filter_friction=False)
    both = [
        validate_robot(robot, samples_of(robot, recording, processing))
        for robot, recording in ((arm, log), (legged.quadruped(), held))
    ]
    np.testing.assert_allclose(both[0].rmse, both[1].rmse[6:], rtol=1e-6)
    assert both[1].relative == pytest.approx(0.1 / 1.1, rel=0.02)
    # What holds the base takes any force.
    assert both[1].floating is None
    assert "base" not in both[1].table()


@pytest.mark.parametrize("measured", [False, True])
def test_the_base_is_judged_where_it_is_not_held(measured: bool) -> None:
    made = legged.gait(80)
    first = np.arange(80) < 50
    down = np.column_stack([made.samples.contacts.down & ~first[:, None], first])
    known = {"forces": np.zeros((80, 5, 6)), "force_covariance": np.eye(6)} if measured else {}
    frames, kind = (*legged.FEET, "base_link"), (*["point"] * 4, "plane")
    contacts = ContactSamples(frames=frames, kind=kind, down=down, **known)
    samples = replace(made.samples, contacts=contacts)
    assert base_held(made.robot, samples).tolist() == first.tolist()
    both = validate_robot(made.robot, samples)
    assert both.floating.samples == 30
    always = replace(contacts, down=np.tile(down[:1], (80, 1)))
    alone = validate_robot(made.robot, replace(samples, contacts=always))
    assert alone.floating is None
    if not measured:
        printed = errors_table({"training": alone, "validation": both})
        told = next(line for line in printed.splitlines() if line.startswith("base, force"))
        assert told.split()[-4:-2] == ["-", "-"]


# ---- Bands hold what they say, on motion that the parameters did not see.


def test_bands_hold_95_percent_of_other_motion() -> None:
    inside = []
    for seed in range(8):
        theta = arm_theta()
        estimate = identified(moved(theta, seed, seconds=10.0, block=20)).estimate
        fresh = moved(theta, 100 + seed)
        fit = sdpid.validate(estimate, fresh)
        assert fit.effort_band.shape == fresh.effort.shape
        inside.append(np.abs(fresh.effort - fit.effort_predicted) <= fit.effort_band)
    assert 0.93 <= np.mean(inside) <= 0.98


def test_bands_widen_where_the_motion_has_not_been() -> None:
    theta = arm_theta()
    estimate = identified(moved(theta, 1, seconds=10.0, amplitude=0.05)).estimate
    near, far = (
        sdpid.validate(estimate, moved(theta, 2, amplitude=amplitude)) for amplitude in (0.05, 1.0)
    )
    assert np.all(np.mean(far.effort_band, axis=0) > 2.0 * np.mean(near.effort_band, axis=0))
    fresh = moved(theta, 2)
    assert np.mean(np.abs(fresh.effort - far.effort_predicted) <= far.effort_band) > 0.9


def test_a_description_tells_nothing_of_its_errors() -> None:
    samples = moved(arm_theta(), 1)
    result = identified(samples)
    assert validate_robot(result.problem.robot, samples).effort_band is None
    root, _ = bands.parameter_root(result.estimate)
    covariance = result.estimate.covariance
    np.testing.assert_allclose(root @ root.T, covariance, atol=1e-9 * covariance.max())
    # The same bits, whoever asks.
    first, second = (sdpid.validate(result.estimate, samples).effort_band for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_the_deviation_on_other_motion_is_what_noise_brings() -> None:
    theta = arm_theta()
    drawn = [identified(moved(theta, 1, seconds=5.0, noise_seed=k)).estimate for k in range(20)]
    truth = replace(drawn[0], base=drawn[0].problem.base_of(theta))
    told, expected = bands.random_motion(drawn[0])[0], bands.random_motion(truth)[1]
    errors = [bands.random_motion(estimate)[1] - expected for estimate in drawn]
    assert told == pytest.approx(np.sqrt(np.mean(np.square(errors), axis=(0, 1))), rel=0.4)


# ---- What was held out is predicted by fits that saw nothing of it.


BLOCK = 20
GUARD = 5


@pytest.fixture(scope="module")
def problem() -> Problem:
    return identified(moved(arm_theta(), 1, block=BLOCK)).problem


def test_a_block_is_predicted_by_the_fit_to_the_rows_outside_it(problem: Problem) -> None:
    found = bands.held_out_blocks(problem)
    assert len(found.estimates) == 5
    for k, estimate in enumerate(found.estimates):
        start, *_, stop = np.flatnonzero(found.owner == k)
        mask = np.ones((problem.n_samples, 2), dtype=bool)
        mask[max(start - GUARD, 0) : stop + 1 + GUARD] = False
        samples = replace(problem.samples, mask=mask, covariance=problem.sigma)
        alone = build_problem(ARM, samples, friction=FRICTION, weighting="gls")
        expected = sdpid.solve_sdp(alone).base
        np.testing.assert_allclose(estimate.base, expected, rtol=1e-5, atol=1e-7)


def test_every_recording_is_cut_and_short_ones_are_left_alone() -> None:
    theta = arm_theta()
    pieces = [moved(theta, seed, seconds=s, block=BLOCK) for seed, s in ((1, 20.0), (2, 0.5))]
    samples = Samples.join([pieces[0], pieces[1], moved(theta, 3, block=BLOCK)])
    estimate = identified(samples).estimate
    inside = bands.held_out_blocks(estimate.problem).inside
    assert not inside[1000:1025].any()
    assert inside.sum() == 2000
    held = held_out.hold_out(estimate, sdpid.solve_wls(estimate.problem), None)
    assert held.fit.rows.tolist() == [2000, 2000]


def test_short_records_get_fewer_blocks_or_none() -> None:
    theta = arm_theta()
    for block, count in ((100, 5), (500, 4), (600, 3), (800, 0)):
        found = bands.held_out_blocks(identified(moved(theta, 1, block=block)).problem)
        assert (0 if found is None else len(found.estimates)) == count


def test_blocks_are_not_held_out_where_they_cannot_be(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    samples = replace(problem.samples, covariance=np.eye(2))
    printed = build_problem(ARM, samples, friction=FRICTION, weighting="eq18")
    assert bands.held_out_blocks(printed) is None
    monkeypatch.setattr(bands, "MOST_ROWS", problem.n_rows - 1)
    assert bands.held_out_blocks(replace(problem)) is None


def test_blocks_without_which_nothing_is_determined() -> None:
    """Joint 2 moves in one block only: without it, friction is not determined."""
    samples = moved(arm_theta(), 1, block=BLOCK)
    fields = {name: np.array(getattr(samples, name)) for name in ("velocity", "acceleration")}
    q = np.array(samples.position)
    for each in (*fields.values(), q):
        each[200:, 1] = 0.0
    still = replace(samples, position=q, **fields)
    assert bands.held_out_blocks(identified(still).problem) is None


def test_an_estimate_stands_beside_what_costs_less() -> None:
    result = sdpid.identify(arm(), recorded(1), validation=recorded(2), intervals=False)
    names = [held_out.DESCRIPTION, held_out.FRICTION_FITTED, held_out.LEAST_SQUARES]
    for fresh, by in ((result.validation_samples, "recording"), (None, "blocks")):
        held = held_out.hold_out(result.estimate, result.wls, fresh)
        assert held.by == by == held.to_dict()["by"]
        assert list(held.baselines) == names
        # The recording is of the description's links, with friction that it does not tell.
        described, fitted, _, ours = (fit.relative for fit in held.every.values())
        assert described > 2.0 * fitted
        assert described > ours
        assert [row[0] for row in held.as_table().rows] == list(held.every)
        if fresh is not None:
            np.testing.assert_allclose(held.fit.rmse, result.validation.rmse)


def test_a_robot_without_masses_has_no_baselines_of_its_description() -> None:
    result = identified(moved(arm_theta(), 1), robot=replace(ARM, prior=0.0 * ARM.prior))
    held = held_out.hold_out(result.estimate, result.wls, None)
    assert list(held.baselines) == [held_out.LEAST_SQUARES]


# ---- Rest is told from motion, and the errors of the two are kept apart.


RESTING_RATE = 100.0


def stopped(still: tuple[int, int]) -> Samples:
    """Return ten seconds of a joint that moves, but for samples in a range."""
    t = np.arange(1000) / RESTING_RATE
    v = np.cos(2.0 * t)[:, None]
    v[slice(*still)] = 0.0
    return Samples(position=v, velocity=v, acceleration=v, effort=1.0 + v, time=t)


def resting(samples: Samples) -> list[int]:
    return np.flatnonzero(moving_and_resting(samples)[1][:, 0]).tolist()


def test_a_stop_is_rest_and_a_reversal_is_not() -> None:
    samples = stopped((300, 400))
    assert resting(samples) == list(range(300, 400))
    # Reversals are slow too, and over at once.
    assert np.abs(samples.velocity).min(axis=0) < REST_SPEED
    short = round(REST_SECONDS * RESTING_RATE) - 5
    assert not resting(stopped((300, 300 + short)))
    # Forty samples before a break are too short, sixty behind it are not.
    assert resting(replace(samples, starts=(0, 340))) == list(range(340, 400))
    assert not resting(replace(samples, time=None))


def test_rows_masked_around_a_reversal_belong_to_the_motion() -> None:
    samples = stopped((300, 400))
    turn = int(np.flatnonzero(np.diff(np.sign(samples.velocity[:, 0])))[0])
    mask = np.ones((1000, 1), dtype=bool)
    mask[turn - 5 : turn + 5] = False  # a reversal
    mask[300:400] = False  # rest
    mask[600:650] = False  # fast motion, with an effort that is wrong
    assert np.abs(samples.velocity[600:650]).min() > REST_SPEED
    masked = replace(samples, mask=mask)
    moving = moving_and_resting(masked)[0][:, 0]
    assert moving[turn - 5 : turn + 5].all()
    assert not moving[600:650].any()
    assert resting(masked) == list(range(300, 400))


def test_errors_at_rest_do_not_spoil_those_in_motion() -> None:
    samples = stopped((300, 400))
    predicted = np.array(samples.effort)
    predicted[300:400] += 1.0
    fit = Validation.of_prediction(small_arm(1), samples, predicted)
    assert (fit.moving.rmse[0], fit.resting.rmse[0]) == (0.0, 1.0)
    assert (fit.moving.rows[0], fit.resting.rows[0], fit.rows[0]) == (900, 100, 1000)
    assert fit.to_dict()["resting"] is not None
    # Rows masked for slowness are not fitted, and their error at rest is told all the same.
    mask = np.ones((1000, 1), dtype=bool)
    mask[300:400] = False
    masked = Validation.of_prediction(small_arm(1), replace(samples, mask=mask), predicted)
    assert (masked.resting.rmse[0], masked.rmse[0]) == (1.0, 0.0)
    # A joint whose effort was not measured has none.
    names = ("position", "velocity", "acceleration", "effort")
    twice = {name: np.repeat(getattr(samples, name), 2, axis=1) for name in names}
    wide = replace(samples, **twice, mask=np.tile([True, False], (1000, 1)))
    both = Validation.of_prediction(ARM, wide, np.repeat(predicted, 2, axis=1))
    assert both.resting.rows.tolist() == [100, 0]


# ---- What an error goes with is named, where it is put in; noise has no cause.


ROBOT = small_arm(3)
BODIES = random_links(np.random.default_rng(5), 3)


@cache
def slow_motion(seconds: float = 120.0) -> Samples:
    """Return samples of a slow random motion of a tilted-axis arm, predicted but for noise."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, seconds, 1.0 / RATE)
    w = rng.uniform(0.3, 4.0, (6, ROBOT.n))
    q, v, a = sines(t, w, rng.uniform(0.0, 6.0, w.shape))
    effort = ROBOT.inverse_dynamics(BODIES, q, v, a)
    return Samples(position=q, velocity=v, acceleration=a, effort=effort, time=t)


SECOND = ROBOT.joint_names[1]


def judged(effort: Array, *free: Array) -> tuple[Any, ...]:
    """Return samples with other efforts, and errors of what is predicted, and of other numbers."""
    samples = replace(slow_motion(), effort=effort)
    every = (slow_motion().effort, *free)
    return samples, *(Validation.of_prediction(ROBOT, samples, x) for x in every)


def causes_of(effort: Array, *free: Array) -> dict[str, Cause]:
    """Return the causes that are found where efforts are measured otherwise than predicted."""
    samples, fit, *others = judged(effort, *free)
    return find_causes(ROBOT, BODIES, samples, fit, joint_errors(samples, fit), *others)


def causes(error: Array | None = None, factor: float = 1.0) -> dict[str, Cause]:
    """Return the causes that are found of an error (K,) of the second joint, beside noise.

    Or where its effort is measured with another factor.
    """
    rng = np.random.default_rng(8)
    size = 0.1 * slow_motion().effort.std(axis=0)
    effort = slow_motion().effort + 0.5 * size * rng.standard_normal(slow_motion().effort.shape)
    if error is not None:
        effort[:, 1] += size[1] * error / np.sqrt(np.mean(error**2))
    return causes_of(effort * [1.0, factor, 1.0])


def tilted(samples: Samples) -> Array:
    """Return how the second joint's effort differs on a base that stands tilted by 1.5 degrees."""
    states = samples.position, samples.velocity, samples.acceleration
    axis = np.array([0.6, 0.8, 0.0])
    axis -= ROBOT.gravity * (axis @ ROBOT.gravity) / (ROBOT.gravity @ ROBOT.gravity)
    gravity = ROBOT.gravity + 0.026 * np.cross(axis, ROBOT.gravity)
    leaning = ROBOT.with_gravity(gravity).inverse_dynamics(BODIES, *states)
    return (leaning - samples.effort)[:, 1]


@pytest.mark.parametrize(("factor", "kind"), [(-1.0, "sign"), (0.1, "scale"), (1.7, "scale")])
def test_a_wrong_sign_or_scale_of_the_effort_is_no_missing_effect(factor: float, kind: str) -> None:
    found = causes(factor=factor)
    assert {name: each.kind for name, each in found.items()} == {SECOND: kind}
    assert found[SECOND].share > 0.9


def test_what_constraints_hold_back_has_no_shape_of_an_effect() -> None:
    shape = SHAPES["acceleration"](slow_motion())
    size = 0.5 * slow_motion().effort[:, 1].std()
    effort = np.array(slow_motion().effort)
    effort[:, 1] += size * shape / shape.std()
    for left, expected in ((0.9, ("acceleration",)), (0.3, ())):
        less = effort + left * (slow_motion().effort - effort)
        found = causes_of(effort, less)
        assert tuple(each.kind for each in found.values()) == expected
        _, fit, free = judged(effort, less)
        assert held_back(fit, free) == (() if expected else (SECOND,))
    # Nor has an error beside which the mean predicts better.
    effort[:, 1] += 20.0 * slow_motion().effort[:, 1].std()
    assert causes_of(effort) == {}


SHAPES: dict[str, Callable[[Samples], Array]] = {
    "direction": lambda s: np.sign(s.velocity[:, 1]),
    "velocity": lambda s: s.velocity[:, 1],
    "speed": lambda s: np.cos(0.6 * s.velocity[:, 1]),
    "acceleration": lambda s: s.acceleration[:, 1],
    "load": lambda s: np.abs(s.effort[:, 1]) * np.sign(s.velocity[:, 1]),
    "gravity": tilted,
    "position": lambda s: np.sin(s.position[:, 1] + 1.0),
    "frequency": lambda s: np.sin(2.0 * np.pi * 15.0 * np.asarray(s.time)),
}


@pytest.mark.parametrize("kind", SHAPES)
def test_the_cause_of_an_error_is_named(kind: str) -> None:
    found = causes(SHAPES[kind](slow_motion()))
    # The others have noise alone.
    assert list(found) == [SECOND]
    assert found[SECOND].kind == kind
    assert found[SECOND].share > 0.5
    if kind == "frequency":
        assert found[SECOND].frequency == pytest.approx(15.0, abs=0.1)


def test_noise_has_no_cause() -> None:
    rng = np.random.default_rng(1)
    assert causes(rng.standard_normal(slow_motion().n_samples)) == {}
    # Neither has noise that is alike for a second, however well it fits some shape by chance.
    smooth = np.convolve(rng.standard_normal(slow_motion().n_samples), np.ones(50), "same")
    assert causes(smooth) == {}


def test_a_robot_without_gravity_or_motion_has_no_cause() -> None:
    floating = ROBOT.with_gravity([0.0, 0.0, 0.0])
    still = {name: np.zeros_like(slow_motion().velocity) for name in ("velocity", "acceleration")}
    samples = replace(slow_motion(), **still)
    fit = Validation.of_prediction(ROBOT, samples, slow_motion().effort)
    assert find_causes(floating, BODIES, samples, fit, joint_errors(samples, fit)) == {}


# ---- Friction terms that a recording cannot tell apart are named; the prior shares between them.


LINKS = random_links(np.random.default_rng(3), 2)


def alike(spread: float) -> Problem:
    """Return a problem whose second joint moves at speeds that differ by a share of one."""
    rng = np.random.default_rng(1)
    q, v, a = random_states(rng, 2, 300)
    v[:, 1] = np.where(v[:, 1] > 0.0, 1.0, -1.0) * (1.0 + spread * rng.uniform(-1.0, 1.0, 300))
    effort = ARM.inverse_dynamics(LINKS.ravel(), q, v, a) + 0.5 * np.sign(v) + 0.5 * v
    effort += 0.01 * rng.standard_normal(effort.shape)
    samples = Samples(position=q, velocity=v, acceleration=a, effort=effort)
    terms = ("coulomb", "viscous", "offset")
    prior = Prior(bodies=LINKS)
    return build_problem(ARM, samples, friction=terms, weighting="residual", prior=prior)


def test_speeds_that_never_vary_are_told_and_others_are_not() -> None:
    (pair,) = collinear_friction(alike(0.01))
    assert (pair.joint, pair.first, pair.second) == (ARM.joint_names[1], "Fs2", "Fv2")
    assert pair.correlation > 0.999
    note = in_words((pair,))
    assert "Fs2 and Fv2 of" in note
    assert collinear_friction(alike(0.9)) == ()
    assert in_words(()) is None


def test_the_prior_keeps_them_from_being_torn_apart() -> None:
    """What the data leave open is shared: either term gets half of what both make."""
    theta = solve_sdp(alike(0.0)).named_theta()
    np.testing.assert_allclose([theta["Fs2"], theta["Fv2"]], 0.5, atol=0.02)


# ---- The worst mass matrix: found by search, bounded by proof, and able to be bad.


# Sums of a few hundred products of order one.
ROUNDING = 1e-11


ROBOTS = {
    "tree": load_robot(TREE),
    "mimic": load_robot(TREE_MIMIC),
    "arm2": ARM,
    "arm4": small_arm(4),
    "denso": load_robot("denso_vp6242"),
    "flying": load_robot(TREE, root="free_flyer"),
    **MODELS,
}


@pytest.mark.parametrize("name", ROBOTS)
@given(seed=SEEDS)
def test_no_position_goes_below_the_proven_bound(name: str, seed: int) -> None:
    """Of a floating base the place does not matter."""
    arm, rng = ROBOTS[name], np.random.default_rng(seed)
    theta, q = random_links(rng, arm.n_links), rng.uniform(-3.2, 3.2, (4, arm.n - arm.n_base))
    J = link_jacobians(arm, q)
    M = np.einsum("klai,lab,klbj->kij", J, spatial_inertia(theta), J)
    least = proven_bound(arm, theta)
    assert np.linalg.eigvalsh(M).min() >= least > 0.0
    # Velocities of links make the mass matrix, and show those of joints.
    shown = np.broadcast_to(arm.expansion, (4, *arm.expansion.shape))
    np.testing.assert_allclose(joint_rates(arm) @ J.reshape(4, -1, arm.n), shown, atol=ROUNDING)
    if not arm.n_base:
        np.testing.assert_allclose(M, arm.mass_matrix(theta, q), atol=ROUNDING)


@cache
def estimate_of(consistency: str, margin: float) -> Estimate:
    """Return an estimate that its constraints press on."""
    problem = arm_problem(consistency=consistency, margin=margin)  # type: ignore[arg-type]
    return sdpid.solve_sdp(problem)


def smallest_eigenvalues(estimate: Estimate, q: Array) -> Array:
    return np.asarray(np.linalg.eigvalsh(estimate.mass_matrix(q))[:, 0])


def least_on_a_grid(estimate: Estimate, bounds: Any, count: int) -> float:
    grid = np.meshgrid(*[np.linspace(*ends, count) for ends in bounds])
    points = np.stack(grid, axis=-1).reshape(-1, len(bounds))
    return float(smallest_eigenvalues(estimate, points).min())


@pytest.mark.parametrize("consistency", BOTH)
def test_the_search_finds_the_worst_and_the_bound_is_below(consistency: str) -> None:
    estimate = estimate_of(consistency, 1e-3)
    worst = sdpid.smallest_mass_eigenvalue(estimate)
    assert worst.value <= least_on_a_grid(estimate, [(-np.pi, np.pi)] * 2, 181) + ROUNDING
    assert smallest_eigenvalues(estimate, worst.q[None])[0] == pytest.approx(worst.value)
    assert 0.0 < worst.lower_bound <= worst.value
    assert worst.positive_definite
    assert sdpid.smallest_mass_eigenvalue(estimate).value == worst.value
    assert worst.to_dict()["lower_bound"] == worst.lower_bound


def test_a_box_limits_the_search() -> None:
    estimate = estimate_of("pseudo_inertia", 1e-3)
    anywhere = sdpid.smallest_mass_eigenvalue(estimate)
    box = np.column_stack([anywhere.q + 1.0, anywhere.q + 1.2])
    inside = sdpid.smallest_mass_eigenvalue(estimate, bounds=box)
    assert np.all((box[:, 0] <= inside.q) & (inside.q <= box[:, 1]))
    assert inside.value >= anywhere.value
    refuses(DataError, "bounds", sdpid.smallest_mass_eigenvalue, estimate, bounds=[[0.0, 1.0]])


def test_rotors_prove_nothing_of_the_links() -> None:
    """Rotor inertia is in a base parameter with a link's, and no part of the links' bound."""
    samples, terms = arm_problem().samples, ("coulomb", "viscous", "rotor_inertia")
    effort = samples.effort + 2.0 * samples.acceleration
    problem = build_problem(ARM, replace(samples, effort=effort), friction=terms)
    worst = sdpid.smallest_mass_eigenvalue(solve_sdp(problem))
    assert 0.0 < worst.lower_bound <= worst.value


# Three joints whose far limits, or whose slide, a search within half a turn would miss.
LIMITED = """<robot name="limited"><link name="base"/>
<joint name="turn" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
 <limit lower="0.5" upper="{upper}" velocity="1" effort="1"/></joint>
<link name="a"><inertial><mass value="1"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0"
 izz="0.1"/></inertial></link>
<joint name="elbow" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
 <origin xyz="0.5 0 0"/><limit lower="0.5" upper="{upper}" velocity="1" effort="1"/></joint>
<link name="b"><inertial><origin xyz="0.4 0.4 0" rpy="0 0 0"/><mass value="2"/>
 <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
<joint name="slide" type="prismatic"><parent link="b"/><child link="c"/><axis xyz="1 0 0"/>
 {limit}</joint>
<link name="c"><inertial><mass value="0.5"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0"
 izz="0.01"/></inertial></link></robot>"""


def estimate_from_description(source: str) -> Estimate:
    arm, rng = load_robot(source), np.random.default_rng(0)
    theta = np.concatenate([arm.prior.ravel(), np.ones(2 * arm.n)])
    return sdpid.solve_sdp(build_problem(arm, make_samples(arm, theta, rng)))


def test_the_box_is_the_description_s_limits() -> None:
    slide = '<limit lower="-5" upper="-4" velocity="1" effort="1"/>'
    estimate = estimate_from_description(LIMITED.format(upper=6.2, limit=slide))
    worst = sdpid.smallest_mass_eigenvalue(estimate)
    np.testing.assert_array_equal(worst.bounds, [[0.5, 6.2], [0.5, 6.2], [-5.0, -4.0]])
    assert worst.value <= least_on_a_grid(estimate, worst.bounds, 41) + ROUNDING
    # Where it is least is beyond half a turn.
    half = sdpid.smallest_mass_eigenvalue(estimate, bounds=np.clip(worst.bounds, -5.0, np.pi))
    assert worst.value < half.value
    # Without limits a joint turns once or slides a meter.
    turn = [0.5, 0.5 + 2.0 * np.pi]
    for ends in ('lower="-1e9" upper="1e9"', ""):
        slide = f'<limit {ends} velocity="1" effort="1"/>'
        estimate = estimate_from_description(LIMITED.format(upper=60.0, limit=slide))
        worst = sdpid.smallest_mass_eigenvalue(estimate)
        np.testing.assert_allclose(worst.bounds, [turn, turn, [-1.0, 1.0]])


@pytest.mark.parametrize("mass", [-10.0, 0.0, 1e-320])
def test_links_without_mass_prove_nothing_and_overflow_nowhere(mass: float) -> None:
    theta = random_links(np.random.default_rng(5), ARM.n_links)
    theta[0] = [mass, 0.0, 0.0, 0.0, 0.1, 0.0, 0.1, 0.0, 0.0, -10.0]
    with np.errstate(all="raise"):
        assert proven_bound(ARM, theta) is None


@pytest.mark.parametrize("column", ["wls", "cwls"])
def test_published_parameters_can_fail(denso: RobotModel, column: str) -> None:
    rng = np.random.default_rng(3)
    problem = build_problem(denso, make_samples(denso, random_theta(denso, rng), rng))
    values = read_base_table(bundled_folder("denso_vp6242") / "table_iv.csv", value=column).values
    base = np.array([float(values[name]) for name in problem.base.names])
    published = replace(sdpid.solve_wls(problem), base=base)
    worst = sdpid.smallest_mass_eigenvalue(published)
    # Without constraints far from it, with constraints after rounding to two digits.
    assert worst.value < (-0.5 if column == "wls" else 0.0)
    assert worst.lower_bound is None
    assert not worst.positive_definite
    # Any links with these base parameters have this mass matrix.
    matrix = problem.base.matrix
    free = np.linalg.svd(matrix)[2][problem.base.count :]
    other = np.linalg.pinv(matrix) @ base + free.T @ rng.standard_normal(len(free))
    M = denso.mass_matrix(other, worst.q)
    assert np.linalg.eigvalsh(M)[0] == pytest.approx(worst.value, abs=1e-8)


# ---- Slacks and multipliers of constraints, against optimal costs under other limits.


# Central differences of optimal costs, which are known to some 1e-9 of the cost.
SLOPE = 1e-3


def cost_beside(problem: Problem, state: ConstraintState, by: float) -> float:
    """Return the optimal cost with the limit of one constraint moved."""
    names = {"least": ["lower"], "most": ["upper"], None: ["lower", "upper"]}[state.side]
    names = [f"row_{name}" if state.kind == "row" else name for name in names]
    changes = {name: np.array(getattr(problem.feasible, name)) for name in names}
    for each in changes.values():
        each[state.index] += by
    return solve_sdp(replace(problem, feasible=replace(problem.feasible, **changes))).cost


def slope(cost: Callable[[float], float], step: float) -> float:
    """Return the derivative at zero, by central differences of fourth order."""
    near = (cost(step) - cost(-step)) / (2.0 * step)
    far = (cost(2.0 * step) - cost(-2.0 * step)) / (4.0 * step)
    return (4.0 * near - far) / 3.0


def backwards() -> Problem:
    """Return a problem whose friction drives the joints."""
    rng = np.random.default_rng(10)
    theta = random_theta(ARM, rng)
    theta[20:] = -1.0
    return build_problem(ARM, make_samples(ARM, theta, rng, noise=0.3))


# Heavy links cost something only where their center of mass may not follow.
BOX = sdpid.constraints.CenterOfMassInBox
FAR = (BOX(FIRST, (0.1,) * 3, (0.2,) * 3), BOX(LAST, (-0.01,) * 3, (0.01,) * 3))
PRESSED: dict[str, Callable[..., Problem]] = {
    **{
        name: partial(arm_problem, *CONDITIONS[name])
        for name in ("total", "group", "box", "hull", "fixed", "fixed link", "equal", "symmetric")
    },
    "light links": partial(arm_problem, mass_max=0.2),
    "heavy links": partial(arm_problem, *FAR, mass_min=4.0, mass_max=10.0),
    "little friction": partial(arm_problem, mass_max=0.2, friction_max=0.25),
    "friction that drives": lambda consistency: backwards().constrained(consistency=consistency),
}


@pytest.mark.parametrize("consistency", BOTH)
@pytest.mark.parametrize("name", PRESSED)
def test_multipliers_of_limits(name: str, consistency: Consistency) -> None:
    """Each limit that matters, moved by itself."""
    problem = PRESSED[name](consistency=consistency)
    estimate = solve_sdp(problem)
    rows = name in CONDITIONS
    pressing = [
        state
        for state in constraint_states(estimate)
        if state.kind in (("row",) if rows else ("mass", "sign", "theta_max"))
        and abs(state.multiplier or 0.0) > 1e-2
        # The total mass is there to make others press.
        if name == "total" or not state.name.startswith("total mass, ")
    ]
    assert pressing
    # The three that press most, in units of their own.
    for state in sorted(pressing, key=lambda state: -abs(state.multiplier))[:3]:
        assert state.active
        multiplier, cost = state.multiplier, cache(partial(cost_beside, problem, state))
        # Small beside a centimeter of a kilogram.
        step = 2e-4 if rows else max(0.02 * abs(state.limit), 5e-3)
        # Optimal costs are convex in the limits.
        rounding = SLOPE * step * abs(multiplier) + 1e-7 * estimate.cost
        for by in (-step, step):
            assert cost(by) >= estimate.cost + by * multiplier - rounding
        if name not in ("symmetric", "equal"):
            # There the cost has a kink (a thin link in the plane gets thin across it), and any
            # multiplier between the slopes on either side will do.
            close = {"rel": 10.0 * SLOPE, "abs": 0.05} if rows else {"rel": SLOPE}
            assert slope(cost, step) == pytest.approx(multiplier, **close)


@pytest.mark.parametrize("consistency", BOTH)
def test_multipliers_of_the_margin(consistency: Consistency) -> None:
    problem = arm_problem(consistency=consistency, margin=5e-3)

    def cost(step: float) -> float:
        moved = problem.constraints.replace(margin=5e-3 + step)
        return solve_sdp(problem.constrained(constraints=moved)).cost

    states = constraint_states(solve_sdp(problem))
    found = sum(state.multiplier for state in states if state.kind == "consistency")
    assert found > 1.0
    assert slope(cost, 1e-4) == pytest.approx(found, rel=SLOPE)


@pytest.mark.parametrize(
    ("kind", "consistency", "place", "semi_axes", "masses"),
    [
        (sdpid.constraints.CenterOfMassInEllipsoid, BOTH[0], (0, 0.01, 0), (0.02, 0.05, 0.03), 1.0),
        (sdpid.constraints.CenterOfMassInEllipsoid, BOTH[1], (0, 0.01, 0), (0.02, 0.05, 0.03), 1.0),
        (sdpid.constraints.MassInEllipsoid, BOTH[0], (0, 0.1, 0), (0.1, 0.2, 0.3), 2.0),
    ],
)
def test_the_multiplier_of_an_ellipsoid(
    kind: Any, consistency: Consistency, place: Any, semi_axes: Any, masses: float
) -> None:
    """Larger by a share s of its size it has ``‖v‖ ≤ a·(1 + s)`` of the center of mass.

    Of all mass it has ``∫ (1 − ‖y‖²/(1 + s)²) dm ≥ 0``, twice the mass per unit of s.
    """

    def problem(size: float) -> Problem:
        condition = kind(LAST, place, size * np.array(semi_axes), rotation=TURNED)
        return arm_problem(LIGHT, condition, consistency=consistency)

    estimate = solve_sdp(problem(1.0))
    state = constraint_states(estimate)[-1]
    assert state.active
    found = slope(lambda step: solve_sdp(problem(1.0 + step)).cost, 0.02 / masses)
    mass = estimate.problem.feasible.bodies(estimate.theta)[1, 0]
    assert found == pytest.approx(-masses * state.multiplier * mass, rel=SLOPE)


def test_states_of_everything_in_turn() -> None:
    problem = arm_problem(LIGHT, CONDITIONS["fixed"][-1], CONDITIONS["ellipsoid"][-1], mass_max=0.5)
    estimate = solve_sdp(problem)
    states = constraint_states(estimate)
    ends = ("least 0.001", "most 0.5")
    assert [state.name for state in states] == [
        *(f"consistency of {link}" for link in (FIRST, LAST)),
        *(f"mass of {link} at {end} kg" for link in (FIRST, LAST) for end in ends),
        *(f"{name} at least 0" for name in ("Fs1", "Fs2", "Fv1", "Fv2")),
        "total mass, at least 0.5",
        "total mass, at most 0.7",
        "m_2 fixed",
        "Fv1 fixed",
        f"center of mass of {LAST} in an ellipsoid",
    ]
    by_name = {state.name: state for state in states}
    assert by_name[f"consistency of {LAST}"].slack == pytest.approx(estimate.margins[1] - 1e-3)
    assert by_name[f"consistency of {LAST}"].unit == "kg.m2"
    assert by_name[f"mass of {LAST} at most 0.5 kg"].slack == pytest.approx(0.1)
    # What does not bind does not cost.
    free = [state for state in states if state.slack > 1e-2 and state.multiplier is not None]
    assert free
    for state in free:
        assert not state.active
        assert state.multiplier == pytest.approx(0.0, abs=1e-6)
    assert by_name["m_2 fixed"].active
    assert by_name["m_2 fixed"].slack == pytest.approx(0.0, abs=FEASIBLE)
    values = {state.slack is None or state.slack >= -FEASIBLE for state in states}
    assert values == {True}
    for state in states:
        keys = {"name", "kind", "side", "slack", "multiplier", "active", "unit"}
        assert set(state.to_dict()) == keys
        if state.multiplier is not None and not state.name.endswith("fixed"):
            lower = "most" not in state.name
            assert state.multiplier * (1.0 if lower else -1.0) >= -1e-9


def test_states_without_multipliers_or_parameters() -> None:
    problem = arm_problem(LIGHT)
    assert constraint_states(solve_wls(problem)) == ()
    local = sdpid.solve_slsqp(problem, seed=0, max_iterations=300)
    states = constraint_states(local)
    assert len(states) == len(constraint_states(solve_sdp(problem)))
    assert {state.multiplier for state in states} == {None}
    nothing = solve_sdp(arm_problem(LIGHT, consistency="none"))
    assert [state.name for state in constraint_states(nothing)] == [
        "total mass, at least 0.5",
        "total mass, at most 0.7",
    ]
    # A link without a mass has no margin.
    broken = Estimate.of_theta(problem, np.zeros(problem.n_theta), method="sdp", status="bad")
    assert constraint_states(broken)[0].slack is None


# ---- Where parameters come from: laws, limits, and a brute-force division of variances.


KINDS = ("euclidean", "scaled_euclidean", "pullback", "entropic")

# Shares are ratios of variances, from factorizations that lose a few hundred roundings.
SHARE = 1e-6


def problem_of(seed: int, prior: Prior | None, *, noise: float = 0.3, **options) -> Problem:
    rng = np.random.default_rng(seed)
    robot = described_arm(random_links(rng, 3))
    samples = make_samples(robot, random_theta(robot, rng), rng, noise=noise)
    return build_problem(robot, samples, prior=prior, **options)


def of(problem: Problem, theta: Array) -> origins.Provenance:
    return provenance(Estimate.of_theta(problem, theta, method="sdp", status="optimal"))


def interior(problem: Problem, seed: int = 0) -> Array:
    return random_theta(problem.robot, np.random.default_rng(seed + 1))


@given(SEEDS, st.sampled_from((None, *KINDS)), st.floats(1e-3, 1e3), st.booleans())
def test_shares_sum_to_one(seed: int, kind: str | None, strength: float, flat: bool):
    prior = None if kind is None else Prior(kind=kind, strength=strength)
    problem = problem_of(seed, prior)
    theta = interior(problem, seed)
    rng = np.random.default_rng(seed)
    if flat and kind != "entropic":
        theta[:30] = flat_links(rng, 3).ravel()
    theta[30:] *= rng.integers(0, 2, len(theta) - 30)
    found = of(problem, theta)
    shares = np.stack([found.data, found.physics, found.prior])
    assert np.all((shares >= 0.0) & (shares <= 1.0))
    assert np.allclose(found.data + found.physics + found.prior, 1.0, atol=1e-12)
    # Friction at its sign constraint is physics, and nothing else in friction is.
    assert np.allclose(found.physics[30:], theta[30:] == 0.0, atol=SHARE)
    assert (found.physics[:30].max() > 0.5) == (flat and kind != "entropic")


@given(SEEDS)
def test_without_a_prior_the_visible_share_is_data(seed: int):
    problem = problem_of(seed, None)
    scaled = problem.base.matrix * np.linalg.norm(Scaling.of(problem).basis(), axis=1)
    expected = np.diag(np.linalg.pinv(scaled) @ scaled)
    assert of(problem, interior(problem, seed)).data == pytest.approx(expected, abs=SHARE)
    # It does not matter how well the data show it, and so it is the limit of a weak prior.
    loud = problem_of(seed, None, noise=100.0)
    assert of(loud, interior(problem, seed)).data == pytest.approx(expected, abs=SHARE)
    faint = problem_of(seed, Prior(strength=1e-9, friction=False, kind="pullback"))
    assert of(faint, interior(problem, seed)).data[30:] == pytest.approx(1.0, abs=1e-3)


@given(SEEDS, st.sampled_from(KINDS), st.floats(1e-2, 1e2))
def test_it_divides_variances(seed: int, kind: str, strength: float):
    problem = problem_of(seed, Prior(kind=kind, strength=strength))
    theta = interior(problem, seed)
    theta[0] = problem.constraints.mass_min
    theta[:10] = from_pseudo_inertia(1e-3 * np.diag([0.04, 0.05, 0.06, 1.0]))
    R = np.vstack([term.curvature_rows(theta) for term in problem.prior.terms])
    G = problem.A @ problem.base.matrix
    before = np.diag(np.linalg.inv(R.T @ R))
    # The first mass is held: the rest of the parameters, on their own.
    rest = np.arange(1, len(theta))
    both = np.diag(1.0 / before[rest]) + (G.T @ G)[np.ix_(rest, rest)]
    after = np.append(0.0, np.diag(np.linalg.inv(both))) / before
    held = np.append(1.0, np.zeros(len(rest)))
    found = of(problem, theta)
    assert found.physics == pytest.approx(held, abs=SHARE)
    assert found.prior == pytest.approx(after, abs=SHARE)
    assert found.data == pytest.approx(1.0 - held - after, abs=SHARE)


def test_the_unconstrained_fit_does_not_look_at_bounds():
    problem = problem_of(1, Prior())
    theta = interior(problem)
    theta[10:20] *= problem.constraints.mass_min / theta[10]
    assert of(problem, theta).physics == pytest.approx(np.eye(len(theta))[10], abs=SHARE)
    unconstrained = Estimate.of_theta(problem, theta, method="wls", status="optimal")
    assert provenance(unconstrained).physics.max() < SHARE


def test_an_equation_is_physics():
    name = described_arm(random_links(np.random.default_rng(2), 3)).parameter_names[20]
    known = sdpid.Constraints(others=(sdpid.constraints.Fixed({name: 0.7}),))
    problem = problem_of(2, Prior(), constraints=known)
    theta = interior(problem)
    theta[20:30] *= 0.7 / theta[20]
    found = of(problem, theta)
    assert found.names[20] == name
    assert found.physics[[10, 20]] == pytest.approx([0.0, 1.0], abs=SHARE)


@pytest.mark.parametrize("consistency", ["pseudo_inertia", "spatial_inertia"])
def test_a_flat_body_stays_free_to_be_another_flat_one(consistency):
    problem = problem_of(3, Prior(), consistency=consistency)
    theta = interior(problem)
    rng = np.random.default_rng(3)
    masses, points = rng.uniform(0.2, 1.0, 2), rng.uniform(-0.2, 0.2, (2, 3))
    # Two points: of rank two (4×4), and a rod that has no inertia about its own line (6×6).
    theta[20:30] = point_masses(masses, points)
    found = of(problem, theta)
    lost = 3 if consistency == "pseudo_inertia" else 1
    assert found.physics[:20].max() < SHARE
    assert found.physics[20:30].max() > 0.1
    normals = origins._active_normals(problem, theta)
    assert np.linalg.matrix_rank(normals / np.linalg.norm(normals, axis=1)[:, None]) == lost
    for k in range(2):
        for step in 1e-6 * np.eye(3):
            moved = points.copy()
            moved[k] += step
            change = np.zeros_like(theta)
            change[20:30] = point_masses(masses, moved) - theta[20:30]
            seen = normals @ change
            size = np.linalg.norm(normals, axis=1) * np.linalg.norm(change)
            assert np.all(np.abs(seen) <= 1e-4 * size)


def test_estimates_have_it_and_tables_show_it():
    problem = problem_of(8, Prior())
    estimate = solve_wls(problem)
    found = provenance(estimate)
    named = found.to_dict()
    assert tuple(named) == problem.base.theta_names
    name = found.names[3]
    assert named[name]["data"] == found.data[3]
    assert name in found.table()
    assert len(found.table().splitlines()) == 1 + problem.n_theta
    table = theta_table(estimate)
    assert table.header == ("parameter", "unit", "value", "data", "physics", "prior")
    assert table.rows[3][3:] == (found.data[3], found.physics[3], found.prior[3])
    bare = solve_wls(problem_of(8, None))
    assert theta_table(bare).rows[3][2:] == (None, None, None, None)
    refuses(DataError, "no standard parameters", provenance, bare)
