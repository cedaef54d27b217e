"""What a run is planned for: earlier runs, noise, bodies, objectives and purposes."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sdpid
from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.noise_spectrum import NoiseSpectrum
from sdpid.estimation.problem import build_problem
from sdpid.excitation.criterion.belief import (
    ExpectedNoise,
    default_prior,
    earlier_information,
    information_of_rows,
    marginal,
    nominal_bodies,
    nominal_theta,
    prior_information,
    usual_effort,
)
from sdpid.excitation.criterion.criterion import Criterion, Objective
from sdpid.excitation.criterion.purpose import PURPOSES, Purpose, effort_functionals, purpose_of
from sdpid.excitation.criterion.rows import BaseRows
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.inertia import margin
from tests.helpers.arm import ARM
from tests.helpers.data import FRICTION as LINEAR
from tests.helpers.data import make_samples, random_theta
from tests.helpers.refusals import refuses
from tests.helpers.robots import planar_arm, small_arm
from tests.helpers.small_robots import SMALL, URDFS

TERMS = ("coulomb", "viscous")
ROWS = BaseRows.of(ARM, TERMS)
BASE = ROWS.base
THETA = random_theta(ARM, np.random.default_rng(0))


def estimated(count: int = 300, terms: tuple[str, ...] = TERMS) -> Estimate:
    samples = make_samples(ARM, THETA, np.random.default_rng(1), count=count, noise=0.1)
    samples = replace(samples, time=np.arange(count) / 50.0)
    return sdpid.solve_wls(sdpid.build_problem(ARM, samples, friction=terms))


def scaled(J: np.ndarray, by: np.ndarray) -> np.ndarray:
    size = np.sqrt(np.diag(by))
    return J / np.outer(size, size)


@pytest.mark.parametrize("terms", [TERMS, (*TERMS, "offset")])
def test_it_is_the_inverse_of_the_covariance_others_marginalized(terms: tuple[str, ...]) -> None:
    estimate = estimated(terms=terms)
    found = earlier_information(ROWS, estimate)
    covariance = NoiseSpectrum.of(estimate.problem, estimate.theta).covariance
    own = [estimate.problem.base.names.index(name) for name in BASE.names]
    dense = np.linalg.inv(covariance[np.ix_(own, own)])
    np.testing.assert_allclose(scaled(found.information, dense), scaled(dense, dense), atol=1e-6)
    np.testing.assert_allclose(BASE.matrix @ found.theta, estimate.base[own], atol=1e-9)
    np.testing.assert_allclose(found.noise.deviation, 0.1, rtol=0.15)
    # What holds an estimate will do.
    whole = earlier_information(ROWS, SimpleNamespace(estimate=estimate))
    np.testing.assert_array_equal(whole.information, found.information)


def test_of_terms_that_it_did_not_have_it_tells_nothing() -> None:
    rows = BaseRows.of(ARM, (*TERMS, "offset"))
    found = earlier_information(rows, estimated())
    offsets = [rows.base.names.index(name) for name in ("Fo1", "Fo2")]
    assert not found.information[offsets].any()
    assert any("Fo1" in note for note in found.notes)


def test_another_robot_is_refused() -> None:
    other = BaseRows.of(small_arm(3), TERMS)
    refuses(DataError, "the plan is for", earlier_information, other, estimated())


# Information of some parameters, and of a prior, against dense inverses.


seeds = st.integers(0, 2**32 - 1)


@given(seeds, st.integers(1, 4), st.integers(0, 4))
def test_marginal_information_is_the_inverse_of_a_block(seed: int, k: int, rest: int) -> None:
    X = np.random.default_rng(seed).standard_normal((20, k + rest))
    J = X.T @ X
    kept = np.arange(k + rest) < k
    np.testing.assert_allclose(
        marginal(J, kept), np.linalg.inv(np.linalg.inv(J)[:k, :k]), rtol=1e-6, atol=1e-9
    )
    # What is open takes nothing with it.
    open_one = marginal(np.diag([4.0, 0.0, 1.0]), np.array([True, False, True]))
    np.testing.assert_allclose(open_one, np.diag([4.0, 1.0]))


@given(seeds)
def test_information_of_rows_is_the_inverse_of_a_covariance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    R = rng.standard_normal((12, 9)) * 10.0 ** rng.uniform(-2, 2, 9)
    B = rng.standard_normal((4, 9))
    dense = np.linalg.inv(B @ np.linalg.inv(R.T @ R) @ B.T)
    size = np.sqrt(np.diag(dense))
    found = information_of_rows(R, B)
    np.testing.assert_allclose(
        found / np.outer(size, size), dense / np.outer(size, size), atol=1e-5
    )


def test_a_prior_says_nothing_of_what_it_does_not_believe() -> None:
    bodies = np.tile([1.0, 0.1, 0.0, 0.0, 0.1, 0.0, 0.2, 0.0, 0.0, 0.2], (ARM.n_links, 1))
    rms = np.array([1.0, 2.0])
    of_links = BASE.kept < 10 * ARM.n_links
    without, whole, doubled = (
        prior_information(ROWS, sdpid.Prior(bodies=bodies, **how), rms)
        for how in ({"friction": False}, {}, {"strength": 2.0})
    )
    size = np.sqrt(np.diag(without)[of_links].max())
    assert np.all(np.abs(without[~of_links]) < 1e-9 * size)
    assert np.all(np.linalg.eigvalsh(whole) > 0.0)
    own = np.ix_(of_links, of_links)
    np.testing.assert_allclose(doubled[own], 2.0 * whole[own], rtol=1e-6, atol=1e-9)
    assert not prior_information(ROWS, False, rms).any()


@pytest.mark.parametrize("name", ["ur10_robot", "denso_vp6242", *URDFS])
def test_the_default_is_that_of_identify(name: str) -> None:
    robot = sdpid.load_robot(name)
    described = bool(np.any(robot.prior[:, 0] > 0.0))
    assert (default_prior(robot, None) is not None) == described
    assert default_prior(robot, False) is None
    assert default_prior(robot, True) == sdpid.Prior()


# Expected noise: densities, what is assumed, and what earlier residuals say.


NAMES = ("joint_1", "joint_2", "joint_3")
RMS = np.array([3.0, 48.0, 0.0])


def test_white_noise_has_a_density() -> None:
    noise = ExpectedNoise.of(NAMES, [1.0, 2.0, 3.0], RMS, 250.0)
    np.testing.assert_allclose(noise.density, np.array([1.0, 4.0, 9.0]) / 250.0)
    np.testing.assert_allclose(noise.filtered_variance(25.0), np.array([1.0, 4.0, 9.0]) / 10.0)
    # A filter takes nothing away beyond the noise itself.
    np.testing.assert_allclose(noise.filtered_variance(1e6), [1.0, 4.0, 9.0])


def test_numbers_serve_all_joints_or_each_and_without_them_it_is_assumed() -> None:
    one = ExpectedNoise.of(NAMES, 0.5, RMS, 100.0)
    np.testing.assert_allclose(one.deviation, 0.5)
    named = ExpectedNoise.of(NAMES, dict(zip(NAMES, (3.0, 2.0, 1.0), strict=True)), RMS, 100.0)
    np.testing.assert_allclose(named.deviation, [3.0, 2.0, 1.0])
    assert ExpectedNoise.of(NAMES, named, RMS, 1.0) is named
    assumed = ExpectedNoise.of(NAMES, None, RMS, 100.0)
    assert 0.0 < assumed.deviation[2] < assumed.deviation[0] < assumed.deviation[1]
    assert "assumed" in assumed.notes[0]


@pytest.mark.parametrize(
    ("noise", "says"),
    [
        ([1.0, 2.0], "give one number or 3"),
        ({"joint_1": 1.0, "elbow": 2.0}, "elbow"),
        ([1.0, -1.0, 1.0], "positive"),
        ([1.0, np.nan, 1.0], "not finite"),
    ],
)
def test_wrong_numbers_are_refused(noise: object, says: str) -> None:
    refuses(DataError, says, ExpectedNoise.of, NAMES, noise, RMS, 100.0)


@given(st.lists(st.floats(0.0, 1e4), min_size=1, max_size=7), st.floats(1e-3, 1e3))
def test_usual_efforts_scale_and_are_never_zero(rms: list[float], factor: float) -> None:
    usual = usual_effort(np.array(rms))
    assert np.all(usual > 0.0)
    if max(rms) > 1e-3:
        np.testing.assert_allclose(usual_effort(factor * np.array(rms)), factor * usual)


@pytest.mark.parametrize("weighting", ["gls", "residual"])
def test_residuals_of_white_noise_give_its_density(weighting: str) -> None:
    deviations = np.array([0.1, 0.3])
    theta = random_theta(ARM, np.random.default_rng(0))
    found = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        samples = make_samples(ARM, theta, rng, count=400, noise=0.0)
        effort = samples.effort + deviations * rng.standard_normal(samples.effort.shape)
        samples = replace(samples, effort=effort, time=np.arange(400) / 50.0)
        problem = build_problem(ARM, samples, friction=LINEAR, weighting=weighting)  # type: ignore[arg-type]
        found.append(ExpectedNoise.of_residuals(problem, theta))
    density: Array = np.mean([each.density for each in found], axis=0)
    np.testing.assert_allclose(density, deviations**2 / 50.0, rtol=0.15)
    deviation = np.mean([each.deviation for each in found], axis=0)
    np.testing.assert_allclose(deviation, deviations, rtol=0.1)


# What a robot is taken to be before a run.


NOMINAL = small_arm(3)
RNG = np.random.default_rng(0)
STATES = tuple(RNG.standard_normal((50, 3)) for _ in range(3))


@pytest.mark.parametrize("robot", [NOMINAL, sdpid.load_robot("ur10_robot")])
def test_bodies_are_possible_as_described_or_assumed_and_told(robot: sdpid.RobotModel) -> None:
    bodies, notes = nominal_bodies(robot)
    known = robot.prior[:, 0] > 0.0
    np.testing.assert_allclose(bodies[known, 0], robot.prior[known, 0])
    assert np.all(bodies[:, 0] > 0.0)
    assert np.all(margin(bodies, "pseudo_inertia") > 0.0)
    assert known.any() or "no masses" in notes[0]
    assert len(notes) == (0 if known.any() else 1)


def test_friction_is_of_a_usual_size_and_other_terms_are_zero() -> None:
    friction = FrictionModel.from_terms(("coulomb", "viscous", "offset"), NOMINAL.joint_names)
    theta, _ = nominal_theta(NOMINAL, friction, *STATES)
    coulomb, viscous, offset = theta[-9:].reshape(3, 3)
    assert np.all(coulomb > 0.0)
    assert np.all(viscous > 0.0)
    assert not offset.any()
    faster, _ = nominal_theta(NOMINAL, friction, STATES[0], 2.0 * STATES[1], STATES[2])
    assert np.all(faster[-6:-3] / faster[-9:-6] < viscous / coulomb)


# The objectives: their derivatives, and what each is invariant to.


KINDS = ("mixed", "D", "A", "E", "V", "condition")


def matrix(rng: np.random.Generator, b: int) -> np.ndarray:
    root = rng.standard_normal((b + 3, b))
    return root.T @ root


def objective(kind: str, rng: np.random.Generator, b: int) -> Objective:
    functionals = rng.standard_normal((3, b)) if kind == "V" else None
    shown = np.linalg.qr(rng.standard_normal((b, b - 1)))[0]
    return Objective(
        kind=kind, functionals=functionals, scale=rng.uniform(0.5, 2.0, b), shown=shown
    )


@given(st.sampled_from(KINDS), st.integers(0, 1000))
def test_derivatives_agree_with_differences(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    total, plain, d1, d2 = (matrix(rng, 5) for _ in range(4))
    made = objective(kind, rng, 5)
    _, by_total, by_plain = made.value(total, plain)
    h = 1e-6
    ahead = made.value(total + h * d1, plain + h * d2)[0]
    behind = made.value(total - h * d1, plain - h * d2)[0]
    expected = np.sum(by_total * d1) + np.sum(by_plain * d2)
    # Central differences err by h², and by rounding of the values over h.
    assert (ahead - behind) / (2.0 * h) == pytest.approx(expected, rel=1e-4, abs=1e-6)
    # More information is never worse.
    more = made.value(total + d1, plain)[0]
    assert kind == "condition" or more <= made.value(total, plain)[0] + 1e-9


@given(st.sampled_from(["D", "mixed", "condition"]), st.integers(0, 1000))
def test_units_do_not_matter(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    first, second = (matrix(rng, 5) for _ in range(2))
    units = 10.0 ** rng.uniform(-2, 2, 5)
    made = objective(kind, rng, 5)
    before = made.value(first, first)[0] - made.value(second, second)[0]
    first, second = (m * np.outer(units, units) for m in (first, second))
    after = made.value(first, first)[0] - made.value(second, second)[0]
    # Each eigenvalue is rounded by a share of the largest one.
    rounding = np.finfo(float).eps * max(np.linalg.cond(first), np.linalg.cond(second))
    assert after == pytest.approx(before, abs=1e-9 + rounding)


def test_the_smooth_condition_number_is_above_the_true_one_and_near_it() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        plain = matrix(rng, 8)
        smooth = np.exp(Objective(kind="condition").value(plain, plain)[0])
        true = np.sqrt(np.linalg.cond(scaled(plain, plain)))
        assert true <= smooth <= 8 ** (1 / 32) * true


def test_functionals_of_a_part_are_log_det_of_its_covariance() -> None:
    rng = np.random.default_rng(1)
    total = matrix(rng, 5)
    L = np.eye(5)[:2]
    value = Objective(kind="D", functionals=L).value(total, total)[0]
    expected = np.linalg.slogdet(np.linalg.inv(total)[:2, :2])[1] / 2
    assert value == pytest.approx(expected)


def test_unknown_objectives_are_refused() -> None:
    refuses(DataError, "use one of mixed, D", Objective, kind="G")
    refuses(DataError, "needs functionals", Objective, kind="V")


@pytest.mark.parametrize("friction", [("coulomb", "viscous", "offset"), ("viscous", "tilt"), ()])
def test_the_gradient_of_a_motion_agrees_with_differences(friction: tuple[str, ...]) -> None:
    robot = sdpid.load_robot("denso_vp6242")
    rng = np.random.default_rng(2)
    state = list(rng.standard_normal((3, 60, robot.n)))
    rows = BaseRows.of(robot, friction).smooth(state[1])
    criterion = Criterion(
        rows=rows,
        objective=Objective(),
        rates=rng.uniform(0.5, 2.0, robot.n),
        known=1e-3 * np.eye(rows.count),
    )
    _, slopes = criterion.gradient(*state, 20.0)
    for order in range(3):
        step = rng.standard_normal(state[order].shape)
        values = []
        for h in (1e-6, -1e-6):
            moved = list(state)
            moved[order] = state[order] + h * step
            values.append(criterion.value(*moved, 20.0))
        found = (values[0] - values[1]) / 2e-6
        assert found == pytest.approx(float(np.sum(slopes[order] * step)), rel=1e-4, abs=1e-5)


@given(st.floats(0.005, 10.0))
def test_signs_are_told_from_viscous_friction_at_any_speed(speed: float) -> None:
    v = speed * np.sin(np.linspace(0.0, 10.0, 200))[:, None] * np.array([1.0, 0.5])
    rows = BaseRows.of(planar_arm(), ("coulomb", "viscous")).smooth(v)
    W = rows.rows(v, v, v)
    for j in range(2):
        sign, viscous = (W[:, j, rows.base.names.index(f"{kind}{j + 1}")] for kind in ("Fs", "Fv"))
        assert np.corrcoef(sign, viscous)[0, 1] < 0.98


def test_rows_are_the_regressor_of_the_base_parameters() -> None:
    robot = sdpid.load_robot("denso_vp6242")
    rows = BaseRows.of(robot, ("coulomb", "viscous"))
    rng = np.random.default_rng(3)
    q, v, a = rng.standard_normal((3, 10, robot.n))
    theta = np.concatenate([robot.prior.ravel(), rng.uniform(0.0, 1.0, 2 * robot.n)])
    effort = robot.inverse_dynamics(theta, q, v, a)
    effort = effort + np.sign(v) * theta[-2 * robot.n : -robot.n] + v * theta[-robot.n :]
    np.testing.assert_allclose(rows.rows(q, v, a) @ (rows.base.matrix @ theta), effort, atol=1e-9)


# Purposes: which functions of the base parameters count.


ROBOT = small_arm(3)
LAWS = BaseRows.of(ROBOT, ("coulomb", "viscous"))
BASIS = LAWS.base
MOTION = tuple(RNG.standard_normal((40, 3)) for _ in range(3))
X = RNG.standard_normal((200, BASIS.count))
INFORMATION = X.T @ X


C = np.linalg.inv(INFORMATION)


def covariance(purpose: Purpose, information: Array) -> Array:
    """Return the covariance of what counts."""
    own = np.linalg.inv(purpose.directions.T @ information @ purpose.directions)
    return np.asarray(purpose.functionals @ own @ purpose.functionals.T)


@pytest.mark.parametrize("name", PURPOSES)
def test_more_information_never_widens(name: str) -> None:
    purpose = purpose_of(name, LAWS, motion=MOTION)
    before = covariance(purpose, INFORMATION)
    after = covariance(purpose, INFORMATION + np.outer(X[0], X[0]))
    assert np.linalg.eigvalsh(before - after).min() > -1e-12 * np.trace(before)


def test_all_and_friction_are_blocks_of_the_covariance() -> None:
    own = BASIS.kept >= 10 * ROBOT.n_links
    for name, block in (("all", C), ("friction", C[np.ix_(own, own)])):
        found = covariance(purpose_of(name, LAWS), INFORMATION)
        np.testing.assert_allclose(found, block, atol=1e-12)


def test_a_payload_is_the_last_link_with_all_else_known() -> None:
    purpose = purpose_of("payload", LAWS)
    columns = BASIS.matrix[:, 10 * ROBOT.n_links - 10 : 10 * ROBOT.n_links]
    assert purpose.directions.shape[1] == np.linalg.matrix_rank(columns)
    # Knowing all else is knowing more.
    back = np.linalg.pinv(purpose.directions)
    wider = back @ C @ back.T - covariance(purpose, INFORMATION)
    assert np.linalg.eigvalsh(wider).min() > -1e-12


def test_torque_is_the_mean_variance_of_efforts() -> None:
    scale = np.array([1.0, 2.0, 3.0])
    L = effort_functionals(LAWS, *MOTION, scale=scale)
    W = ROBOT.regressor(*MOTION)
    W = np.concatenate([W, LAWS.friction.columns(*MOTION[1:])], axis=2)[:, :, BASIS.kept]
    variance = np.einsum("kjb,bc,kjc->kj", W, C, W) / scale**2
    np.testing.assert_allclose(np.trace(L @ C @ L.T), variance.mean())


def test_gravity_asks_nothing_of_friction() -> None:
    purpose = purpose_of("gravity", LAWS)
    assert purpose.kind == "sum"
    assert not purpose.functionals[:, BASIS.kept >= 10 * ROBOT.n_links].any()


def test_gravity_counts_all_around_where_the_description_has_no_limits() -> None:
    purpose = purpose_of("gravity", BaseRows.of(SMALL["without_limits"].model, ()))
    assert np.linalg.matrix_rank(purpose.functionals, tol=1e-6) == 4  # mx and mz of two links


def test_wrong_purposes_are_refused() -> None:
    upright = BaseRows.of(small_arm(1), ("viscous",))
    for words, name, rows in (
        ("use one of", "speed", LAWS),
        ("give the motion", "torque", LAWS),
        ("no friction terms", "friction", BaseRows.of(ROBOT, ())),
        ("'gravity', and none of the robot's 2 base parameters", "gravity", upright),
    ):
        refuses(DataError, words, purpose_of, name, rows)
