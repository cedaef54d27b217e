"""Enclosures of rows against the same in 50 digits."""

import math
import pickle
from dataclasses import replace
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import sdpid
from sdpid import Constraints, DhTable, RobotModel, Samples, build_problem, load_robot
from sdpid._common.arrays import Array
from sdpid.assurance.log_proof.box import Box
from sdpid.assurance.log_proof.chain.totals import of_rows, of_true_rows
from sdpid.assurance.log_proof.elementary import decaying, hyperbolic_tangent, sine_cosine
from sdpid.assurance.log_proof.enclosure import Enclosed, U, largest
from sdpid.assurance.log_proof.joints import Joint
from sdpid.assurance.log_proof.regressor import motion, regressor
from sdpid.assurance.log_proof.row_error import RowError, row_error
from sdpid.assurance.log_proof.touching.forces import ForceErrors, Near
from sdpid.assurance.log_proof.touching.jacobians import JacobianErrors
from sdpid.assurance.log_proof.weights import diagonal_weights, lesser_weights
from sdpid.constraints import Layout
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.constraints.feasible_set import FeasibleSet
from sdpid.estimation.problem import Problem
from sdpid.experiment.processing.contacts.contact_samples import ContactSamples
from sdpid.friction import (
    AsymmetricCoulomb,
    Coulomb,
    Coupling,
    Offset,
    RotorInertia,
    SigmoidFriction,
    SquareRootFriction,
    Stribeck,
    Tilt,
    Viscous,
)
from sdpid.robot.description.dh_table import DhJoint
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.inertia import inertia_tensor
from sdpid.robot.model.base_parameters import generic_states
from sdpid.robot.model.contacts.jacobians import contact_jacobians, frame_axes, relative_jacobians
from sdpid.verifier.exact import root_below
from tests.helpers import world
from tests.helpers.arm import ARM
from tests.helpers.data import (
    flat_links,
    friction_model,
    matrix_power,
    random_covariance,
    random_links,
    random_theta,
)
from tests.helpers.equations import DIGITS, ExactMotion, exact_jacobian, exact_regressor, numbers
from tests.helpers.legged import FEET, NOISE, RADIUS, gait, quadruped
from tests.helpers.robots import TREE, TREE_MIMIC, pendulum
from tests.helpers.small_robots import URDFS
from tests.helpers.strategies import SEEDS, dh_tables, reals

SAMPLES = 3


def exact(values: Any) -> Any:
    return np.vectorize(Fraction, otypes=[object])(np.asarray(values, dtype=float))


def spread(rng: np.random.Generator, *shape: int) -> Array:
    """Return numbers of very different size."""
    return np.asarray(rng.standard_normal(shape) * 10.0 ** rng.integers(-8, 8, shape))


class Ball:
    """An enclosure of vectors, numbers or a matrix, and exact samples within it."""

    def __init__(self, rng: np.random.Generator, *shape: int) -> None:
        mid = spread(rng, *shape, SAMPLES)
        rad = float(np.abs(spread(rng))) * 1e-9
        error = spread(rng, *shape, SAMPLES)
        # Smaller than the radius by its Frobenius norm, which is no smaller than any other.
        error *= 0.999 * rad / np.sqrt(np.sum(error**2, axis=tuple(range(len(shape)))))
        self.inside = exact(mid) + exact(error)
        norm = np.sqrt(np.sum(mid**2, axis=tuple(range(len(shape))))).max()
        self.ball = Enclosed(mid, np.asarray(rad), np.asarray(norm * (1.0 + 1e-14)))


def holds(found: Enclosed, truth: Any) -> bool:
    """Return whether an error is below the radius in the Frobenius norm, or may be."""
    error = exact(found.mid) - truth
    squares = (error * error).reshape(-1, SAMPLES).sum(axis=0)
    # A matrix's spectral norm is at least its Frobenius norm over √3.
    share = 3 if error.ndim == 3 else 1
    bound = Fraction(float(found.rad)) ** 2 * share
    size = (exact(found.mid) ** 2).reshape(-1, SAMPLES).sum(axis=0)
    within = size <= Fraction(float(found.size)) ** 2 * share
    return bool(np.all(squares <= bound) and np.all(within))


def cross(a: Any, b: Any) -> Any:
    return np.array([a[i] * b[j] - a[j] * b[i] for i, j in ((1, 2), (2, 0), (0, 1))])


@given(SEEDS)
def test_numbers(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = Ball(rng), Ball(rng)
    assert holds(x.ball + y.ball, x.inside + y.inside)
    assert holds(x.ball - y.ball, x.inside - y.inside)
    assert holds(x.ball * y.ball, x.inside * y.inside)
    v = Ball(rng, 3)
    assert holds(x.ball.times(v.ball), x.inside * v.inside)


@given(SEEDS)
def test_vectors(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = Ball(rng, 3), Ball(rng, 3)
    assert holds(x.ball + y.ball, x.inside + y.inside)
    assert holds(x.ball.dot(y.ball), (x.inside * y.inside).sum(axis=0))
    assert holds(x.ball.cross(y.ball), cross(x.inside, y.inside))
    assert holds(x.ball.measured(), x.inside)


@given(SEEDS)
def test_matrices(seed: int) -> None:
    rng = np.random.default_rng(seed)
    R, S, x = Ball(rng, 3, 3), Ball(rng, 3, 3), Ball(rng, 3)
    applied = sum(R.inside[:, j] * x.inside[j] for j in range(3))
    back = sum(R.inside[j] * x.inside[j] for j in range(3))
    composed = sum(R.inside[:, j, None] * S.inside[None, j] for j in range(3))
    assert holds(R.ball.apply(x.ball), applied)
    assert holds(R.ball.back(x.ball), back)
    assert holds(R.ball.compose(S.ball), composed)


@given(SEEDS, st.integers(1, 3))
def test_stacked_vectors_have_radii_of_their_own(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    balls = [Ball(rng, 3) for _ in range(count)]
    stacked = Enclosed(
        np.stack([b.ball.mid for b in balls]),
        np.array([b.ball.rad for b in balls]),
        np.array([b.ball.size for b in balls]),
    )
    y, R = Ball(rng, 3), Ball(rng, 3, 3)
    for found, single in (
        (stacked.cross(y.ball), [b.ball.cross(y.ball) for b in balls]),
        (stacked.dot(y.ball), [b.ball.dot(y.ball) for b in balls]),
        (R.ball.back(stacked), [R.ball.back(b.ball) for b in balls]),
        (y.ball.dot(y.ball).times(stacked), [y.ball.dot(y.ball).times(b.ball) for b in balls]),
    ):
        for k, one in enumerate(single):
            np.testing.assert_array_equal(found.mid[k], one.mid)
            assert found.rad[k] == one.rad
            assert found.size[k] == one.size


def test_the_largest_is_exact() -> None:
    np.testing.assert_array_equal(largest(np.array([[1.0, -3.0], [-0.0, 0.0]])), [3.0, 0.0])


# ---- Sine, cosine, exponential and hyperbolic tangent hold the true values.


# What is left open of a function of size one, in units of rounding: sums and products of numbers
# up to one, some ten of them.
SHARP_FUNCTIONS = 10 * U
ANGLES = st.one_of(
    st.floats(-1e6, 1e6),
    st.integers(-(10**5), 10**5).map(lambda k: k * math.pi / 4),
    st.floats(-1.0, 1.0),
)


def is_within(found: Enclosed, k: int, truth: mp.mpf) -> bool:
    return bool(abs(mp.mpf(float(found.mid[k])) - truth) <= mp.mpf(float(found.rad)))


@given(st.lists(ANGLES, min_size=1, max_size=6))
@example([math.pi / 4, -math.pi / 4, 0.0, 5e-324, 1e6])
@example([math.nextafter(math.pi / 4, 1.0), 3 * math.pi / 4, 11.0])
def test_sine_and_cosine(angles: list[float]) -> None:
    sine, cosine = sine_cosine(Enclosed.exact(np.array(angles)))
    assert sine.rad < SHARP_FUNCTIONS
    assert cosine.rad < SHARP_FUNCTIONS
    with mp.workdps(60):
        for k, angle in enumerate(angles):
            assert is_within(sine, k, mp.sin(mp.mpf(angle)))
            assert is_within(cosine, k, mp.cos(mp.mpf(angle)))


@given(st.floats(-3.0, 3.0), st.floats(0.0, 0.1))
def test_an_angle_that_is_only_enclosed(angle: float, error: float) -> None:
    sine, cosine = sine_cosine(Enclosed.exact(np.array([angle])).off(error))
    with mp.workdps(60):
        for end in (mp.mpf(angle) - mp.mpf(error), mp.mpf(angle) + mp.mpf(error)):
            assert is_within(sine, 0, mp.sin(end))
            assert is_within(cosine, 0, mp.cos(end))


@pytest.mark.parametrize("angle", [2e6, -1e22, 1e300])
def test_huge_angles_are_anywhere(angle: float) -> None:
    sine, cosine = sine_cosine(Enclosed.exact(np.array([0.5, angle])))
    for found in (sine, cosine):
        assert np.all(found.mid - found.rad <= -1.0)
        assert np.all(found.mid + found.rad >= 1.0)


@given(st.lists(st.floats(0.0, 800.0), min_size=1, max_size=6))
@example([0.0, 5e-324, 745.2, 800.0, math.log(2.0) / 2])
def test_decaying_exponential(values: list[float]) -> None:
    found = decaying(Enclosed.exact(np.array(values)))
    assert found.rad < SHARP_FUNCTIONS
    with mp.workdps(60):
        for k, x in enumerate(values):
            assert is_within(found, k, mp.exp(-mp.mpf(x)))


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=6))
@example([0.0, -0.0, 1e-300, -25.0, 1e308])
def test_hyperbolic_tangent(values: list[float]) -> None:
    found = hyperbolic_tangent(Enclosed.exact(np.array(values)))
    assert found.rad < 2 * SHARP_FUNCTIONS
    with mp.workdps(60):
        for k, x in enumerate(values):
            # Beyond, its distance from one is far below what is left open.
            assert is_within(found, k, mp.tanh(max(min(mp.mpf(x), 1000), -1000)))


# ---- Feasible bodies lie in the box.


A_LITTLE = 1.0 + 1e-12


def feasible(consistency: Any, bodies: Array) -> FeasibleSet:
    """Return a set on whose bounds these bodies lie."""
    limits = Constraints(mass_max=float(bodies[:, 0].max()), theta_max=float(np.abs(bodies).max()))
    return FeasibleSet.build(limits, consistency, Layout(ARM, friction_model(ARM, ())))


@given(SEEDS, st.sampled_from(["pseudo_inertia", "spatial_inertia"]), st.booleans())
def test_feasible_bodies_are_inside(seed: int, consistency: Any, flat: bool) -> None:
    rng = np.random.default_rng(seed)
    bodies = flat_links(rng, 2) if flat else random_links(rng, 2)
    # Lighter than far out: masses and inertias of any proportion.
    scale = 10.0 ** rng.uniform(-1.0, 1.0)
    bodies[:, 1:4] *= scale
    bodies[:, 4:] *= scale**2
    box = Box.of(feasible(consistency, bodies))
    assert np.all(np.abs(bodies.ravel()) <= box.theta * A_LITTLE)
    norms = np.linalg.norm(inertia_tensor(bodies), 2, axis=(-2, -1))
    sizes = np.stack([bodies[:, 0], np.linalg.norm(bodies[:, 1:4], axis=1), norms], axis=1)
    assert np.all(sizes <= box.bodies * A_LITTLE)
    own = Box.around(bodies.ravel(), 2)
    assert np.all(sizes <= own.bodies * A_LITTLE)


@pytest.mark.parametrize("consistency", ["none", "pseudo_inertia", "spatial_inertia"])
def test_consistency_makes_it_smaller(consistency: Any) -> None:
    rng = np.random.default_rng(0)
    bodies = random_links(rng, 2)
    box = Box.of(feasible(consistency, bodies))
    wide = np.abs(bodies).max()
    products = box.theta.reshape(2, 10)[:, [5, 7, 8]]
    expected = wide / 2.0 if consistency == "pseudo_inertia" else wide
    np.testing.assert_allclose(products, expected)


# ---- Diagonal weights are at least the covariance's power.


# Of the powers of covariances with a condition number of some hundred.
OF_POWERS = 1e-10


@given(SEEDS, st.integers(1, 7), st.sampled_from([-1.0, -0.5]))
def test_the_difference_is_positive(seed: int, n: int, exponent: float) -> None:
    rng = np.random.default_rng(seed)
    many = random_covariance(rng, n, 3) * 10.0 ** rng.uniform(-6.0, 6.0)
    weights = diagonal_weights(many, exponent)
    used = rng.uniform(size=n) < 0.7
    for sigma, w in zip(many, weights, strict=True):
        np.testing.assert_array_equal(diagonal_weights(sigma, exponent), w)
        for part in (np.ones(n, dtype=bool), used):
            if not part.any():
                continue
            power = matrix_power(sigma[np.ix_(part, part)], exponent)
            least = np.linalg.eigvalsh(np.diag(w[part] ** 2) - power)[0]
            assert least >= -OF_POWERS * np.abs(power).max()
            lesser = lesser_weights(sigma, exponent)[part]
            least = np.linalg.eigvalsh(power - np.diag(lesser**2))[0]
            assert least >= -OF_POWERS * np.abs(power).max()


def test_variances_that_are_independent_are_kept() -> None:
    weights = diagonal_weights(np.diag([4.0, 0.25]), -1.0)
    np.testing.assert_allclose(weights, [0.5, 2.0], rtol=1e-5)


@pytest.mark.parametrize("off", [1.0, -1.0, 1.5])
def test_without_proof_they_are_infinite(off: float) -> None:
    assert np.all(np.isinf(diagonal_weights(np.array([[1.0, off], [off, 1.0]]), -1.0)))
    assert np.all(np.isinf(diagonal_weights(np.zeros((2, 2)), -1.0)))


# ---- Bounds of the rows' cost hold whatever the rows are, within the premises.


SIZES = st.one_of(st.just(0.0), reals(1e-12, 1e6))
SHARES = st.fractions(0, 1, max_denominator=1000)


def compressed(cost: Fraction, prior: Fraction) -> Any:
    """Return the parts of `Recomputed` at a point where the bound is sharp."""
    return SimpleNamespace(
        theta=[0.0],
        lower=[-1.0],
        upper=[1.0],
        problem={"floor": 0.0},
        broken=[],
        data_cost=cost,
        prior_cost=prior,
        lower_bound=cost + prior,
        scale=Fraction(1, 10**6),
    )


@given(SIZES, SIZES, reals(0.0, 0.999), SIZES, SIZES, SHARES, SHARES)
def test_every_cost_that_the_premises_allow_is_between_the_bounds(
    root: float,
    prior: float,
    relative: float,
    absolute: float,
    error: float,
    of_rows_share: Fraction,
    of_error_share: Fraction,
) -> None:
    # The rows' cost is a square, so that its root is a number.
    rows_root = Fraction(root)
    rows_cost = rows_root**2
    # A compressed cost that is near enough, anywhere between the ends.
    share, constant = Fraction(relative), Fraction(absolute)
    least = max((rows_cost - constant) / (1 + share), Fraction(0))
    most = (rows_cost + constant) / (1 - share)
    found = compressed(least + of_rows_share * (most - least), Fraction(prior))
    rows = of_rows(found, relative, absolute)
    assert rows.lower_bound <= rows_cost + found.prior_cost <= rows.cost
    true_root = max(rows_root + (2 * of_error_share - 1) * Fraction(error), Fraction(0))
    true = of_true_rows(rows, error, error)
    assert true.lower_bound <= true_root**2 + found.prior_cost <= true.cost
    assert true.gap >= 0


@given(st.fractions(0, 10**20) | st.fractions(0, 1, max_denominator=10**60))
def test_a_root_below_is_just_below(value: Fraction) -> None:
    root = root_below(value)
    assert root**2 <= value
    assert value < (root + Fraction(1, 2**80)) ** 2


def test_parameters_outside_their_bounds_have_no_cost() -> None:
    found = compressed(Fraction(3), Fraction(1))
    found.theta = [2.0]
    assert of_rows(found, 0.5, 0.0).cost is None


def test_without_parameters_there_is_a_bound_and_no_cost() -> None:
    found = compressed(Fraction(3), Fraction(1))
    found.theta = None
    true = of_true_rows(of_rows(found, 0.5, 0.0), 0.0, 0.0)
    assert true.cost is None
    assert true.gap is None
    assert Fraction(19, 10) < true.lower_bound <= 2


# ---- The enclosed regressor holds the equations of motion, and Pinocchio's regressor.


# What is left open beside the largest entry, in units of rounding: some hundred operations one
# after the other on the way to the last link, with entries that are differences of larger numbers.
SHARP = 20_000 * U


def enclosed(robot: RobotModel, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
    """Return midpoints (links, n, 10, K) and radii (links, n, 3)."""
    tree = robot.tree
    assert tree is not None
    joints = [Joint.of(tree, i) for i in range(robot.n_links)]
    mid = np.zeros((robot.n, 10 * robot.n_links, len(q)))
    rad = np.zeros((robot.n, robot.n_links, 3))
    regressor(joints, motion(tree, robot.offset, q, v, a), mid, rad)
    return mid.reshape(robot.n, robot.n_links, 10, -1).swapaxes(0, 1), rad.swapaxes(0, 1)


def off(error: Array) -> list[Array]:
    """Return how large errors (..., 10) of m, h and I are: the last is a nuclear norm.

    That is the largest effort of the errors for an I of spectral norm one.
    """
    tensor = inertia_tensor(error)
    tensor = tensor / (2.0 - np.eye(3))
    nuclear = np.abs(np.linalg.eigvalsh(tensor)).sum(axis=-1)
    return [np.abs(error[..., 0]), np.linalg.norm(error[..., 1:4], axis=-1), nuclear]


def check(robot: RobotModel, seed: int, count: int = 2) -> None:
    q, v, a = generic_states(robot, count, seed)
    mid, rad = enclosed(robot, q, v, a)
    scale = max(1.0, float(np.abs(mid).max()))
    assert rad.max() < SHARP * scale
    with mp.workdps(DIGITS):
        for k in range(count):
            exact = exact_regressor(robot, q[k], v[k], a[k])
            exact = exact.reshape(robot.n, robot.n_links, 10).swapaxes(0, 1)
            error = exact - np.vectorize(mp.mpf, otypes=[object])(mid[..., k])
            for group, size in enumerate(off(error.astype(float))):
                # The norms round, by far less than this.
                assert np.all(size <= rad[..., group] * (1.0 + 1e-9))


@settings(max_examples=8)
@given(dh_tables(most=4), SEEDS)
def test_serial_arms(table: Any, seed: int) -> None:
    check(RobotModel.from_mdh(table), seed)


@pytest.mark.parametrize("text", [TREE, TREE_MIMIC, "pendulum", *URDFS])
def test_trees_and_mimics(text: str) -> None:
    check(pendulum() if text == "pendulum" else load_robot(text), 3)


def test_lengths_whose_squares_are_no_doubles() -> None:
    joints = (DhJoint(d=1e-236), DhJoint(), DhJoint(d=1e-170, r=0.3))
    check(RobotModel.from_mdh(DhTable(joints=joints, gravity=(0.0, 10.0, 0.0))), 0)


@pytest.mark.parametrize("text", [TREE, "ur5_robot", *URDFS])
def test_a_floating_base(text: str) -> None:
    check(load_robot(text, root="free_flyer"), 2, count=1)


@pytest.mark.parametrize("name", ["denso_vp6242", "panda", "solo12", "tiago", "talos_reduced"])
@pytest.mark.parametrize("root", [None, "free_flyer"])
def test_pinocchio_is_inside(name: str, root: Any) -> None:
    robot = load_robot(name, root=root)
    q, v, a = generic_states(robot, 50, 5)
    mid, rad = enclosed(robot, q, v, a)
    expected = robot._pinocchio_regressor(*robot._states(q, v, a)).transpose(1, 2, 0)
    error = expected.reshape(robot.n, robot.n_links, 10, -1).swapaxes(0, 1) - mid
    # Its own rounding, where the equations leave next to nothing open.
    own = 8.0 * U * np.abs(mid).max()
    for group, size in enumerate(off(error.swapaxes(-1, -2))):
        assert np.all(size.max(axis=-1) <= rad[..., group] + own)


# ---- The bound of the rows' error, against the same rows in 50 digits.


ONE, TWO = ARM.joint_names
PLAIN = (Coulomb(), Viscous(), Offset())

# What is left open beside the efforts that parameters of size one have, in units of rounding.
SHARP_ROWS = 20_000 * U


def problem_of(
    friction: tuple[FrictionTerm, ...] = PLAIN,
    *,
    robot: RobotModel = ARM,
    seed: int = 0,
    count: int = 6,
    weighting: Any = "gls",
    **fields: Any,
) -> Problem:
    samples, _ = world.samples(robot, seed, count=count, noise=0.1, friction=friction, **fields)
    return build_problem(
        robot, samples, friction=friction, weighting=weighting, check_excitation=False
    )


def found(problem: Problem) -> RowError:
    result = row_error(
        problem.require_rows("test"), problem.sigma, problem.weighting, problem.feasible
    )
    assert result is not None
    return result


def sign(v: Any, width: float) -> Any:
    return mp.tanh(v / width) if width else mp.sign(v)


def shape(term: Any, v: Any, a: Any) -> Any:
    """Return a term's effort for a unit parameter of one joint."""
    if isinstance(term, Coulomb):
        return mp.mpf(0) if abs(v) < term.dead_zone else sign(v, float(term.width or 0.0))
    if isinstance(term, SigmoidFriction):
        return mp.tanh(v / mp.mpf(term.velocity))
    if isinstance(term, Stribeck):
        peak = mp.exp(-((abs(v) / mp.mpf(term.velocity)) ** term.exponent))
        return peak * sign(v, float(term.width or 0.0))
    root = mp.sign(v) * mp.sqrt(abs(v))
    return {Viscous: v, Offset: mp.mpf(1), RotorInertia: a, SquareRootFriction: root}[type(term)]


def friction_columns(terms: tuple[Any, ...], v: Any, a: Any) -> Any:
    """Return the friction columns (2, parameters) of a sample of two joints."""
    blocks = []
    for term in terms:
        if isinstance(term, Coupling):
            s = sign(v[0] + v[1], float(term.width or 0.0))
            blocks.append(np.array([[a[1], v[1], s], [a[0], v[0], s]]))
        elif isinstance(term, AsymmetricCoulomb):
            s = [sign(x, float(term.width or 0.0)) for x in v]
            blocks += [np.diag([max(x, 0) for x in s]), np.diag([min(x, 0) for x in s])]
        else:
            blocks.append(np.diag([shape(term, *x) for x in zip(v, a, strict=True)]))
    return np.concatenate(blocks, axis=1) if blocks else np.zeros((2, 0))


def rows_of(problem: Problem) -> tuple[Any, Any]:
    """Return true rows (K, n, p) and computed ones (K, n, b), in 50 digits."""
    s = problem.samples
    true = []
    for q, v, a in zip(s.position, s.velocity, s.acceleration, strict=True):
        inertial = exact_regressor(problem.robot, q, v, a)
        friction = friction_columns(problem.friction.terms, numbers(v), numbers(a))
        true.append(np.concatenate([inertial, friction], axis=1))
    computed = problem.require_rows_here("test").rows(slice(None))[:, :, :-1]
    return np.array(true), numbers(computed)


def distance(problem: Problem, theta: Array) -> Any:
    """Return the weighted distance of the two rows' efforts."""
    true, computed = rows_of(problem)
    values = numbers(theta)
    errors = true.dot(values) - computed.dot(numbers(problem.base.matrix).dot(values))
    mask = problem.samples.used
    total = mp.mpf(0)
    for k, error in enumerate(errors):
        used = np.flatnonzero(mask[k])
        sigma = problem.sigma if problem.sigma.ndim == 2 else problem.sigma[k]
        part = mp.matrix(sigma[np.ix_(used, used)].tolist())
        e = mp.matrix(error[used].tolist())
        total += (e.T * mp.lu_solve(part, e))[0] if len(used) else 0
    return mp.sqrt(total)


def check_rows(problem: Problem, seed: int = 0) -> None:
    result = found(problem)
    rng = np.random.default_rng(seed)
    p = problem.n_theta
    box = np.maximum(np.abs(problem.feasible.lower), np.abs(problem.feasible.upper))
    effort = np.abs(problem.samples.effort).max()
    with mp.workdps(DIGITS):
        for theta in (rng.standard_normal(p), box, -box * rng.uniform(0.0, 1.0, p)):
            assert distance(problem, theta) <= mp.mpf(result.at(theta))
    # Rows of next to no variance have large weights.
    least = min(1.0, float(np.sqrt(np.linalg.eigvalsh(problem.sigma).min())))
    assert result.at(np.ones(p)) < SHARP_ROWS * 100.0 * (1.0 + effort) / least
    assert result.at(random_theta(problem.robot, rng, problem.friction.terms)) < result.total


TERMS: tuple[tuple[FrictionTerm, ...], ...] = (
    (),
    (Coulomb(width=0.3), Viscous(), Offset()),
    (Coulomb(dead_zone=2.0), RotorInertia()),
    (AsymmetricCoulomb(), SquareRootFriction()),
    (AsymmetricCoulomb(width=0.5), SigmoidFriction(velocity=2.0)),
    (Coulomb(), Stribeck(velocity=1.5), Stribeck(velocity=1.0, exponent=1.0, width=0.2)),
    (Coulomb(), Coupling(ONE, TWO)),
    (Viscous(), Coupling(ONE, TWO, width=0.4)),
)


@pytest.mark.parametrize("terms", TERMS[:5] + TERMS[6:])
def test_the_bound_holds_for_friction(terms: tuple[FrictionTerm, ...]) -> None:
    problem = problem_of(terms)
    check_rows(problem)
    assert not found(problem).taken_as_computed


@pytest.mark.parametrize("exponent", [1.0, 2.0])
def test_the_bound_holds_for_stribeck(exponent: float) -> None:
    check_rows(problem_of((Coulomb(), Stribeck(velocity=1.5, exponent=exponent, width=0.2))))


@settings(max_examples=5)
@example(40312209, "residual", True)
@given(SEEDS, st.sampled_from(["gls", "gls_per_sample", "residual"]), st.booleans())
def test_the_bound_holds_for_weights(seed: int, weighting: Any, masked: bool) -> None:
    rng = np.random.default_rng(seed)
    count = None if weighting == "gls" else 8
    fields: dict[str, Any] = {}
    if weighting != "residual":
        fields["covariance"] = random_covariance(rng, 2, count)
    if masked:
        fields["mask"] = rng.uniform(size=(8, 2)) < 0.7
        fields["mask"][0] = True
    check_rows(problem_of(seed=seed, count=8, weighting=weighting, **fields), seed)


@pytest.mark.parametrize("weighting", ["eq9", "eq18"])
def test_the_bound_holds_for_normal_equations(weighting: Any) -> None:
    rng = np.random.default_rng(5)
    covariance = random_covariance(rng, 2, 12)
    problem = problem_of(weighting=weighting, covariance=covariance, count=12)
    result = found(problem)
    assert result.share < 1e-6
    exponent = -0.5 if weighting == "eq9" else -1.0
    with mp.workdps(DIGITS):
        true, computed = rows_of(problem)
        effort = numbers(problem.samples.effort)
        for theta in (rng.standard_normal(problem.n_theta), np.full(problem.n_theta, 1e3)):
            values = numbers(theta)
            base = numbers(problem.base.matrix).dot(values)
            costs = []
            for W, e in (
                (true[:, :, problem.base.kept], effort - true.dot(values)),
                (computed, effort - computed.dot(base)),
            ):
                normal = 0
                for k, sigma in enumerate(problem.sigma):
                    w, V = mp.eigsy(mp.matrix(sigma.tolist()))
                    power = np.array((V * mp.diag([x**exponent for x in w]) * V.T).tolist())
                    normal = normal + W[k].T.dot(power.dot(e[k]))
                costs.append(mp.sqrt(np.sum(normal * normal)))
            bound = mp.mpf(result.share) * costs[1] + mp.mpf(result.at(theta))
            assert abs(costs[0] - costs[1]) <= bound


def test_normal_equations_that_are_singular_have_no_bound() -> None:
    covariance = random_covariance(np.random.default_rng(5), 2, 6)
    assert found(problem_of(weighting="eq9", covariance=covariance)).share == np.inf


def test_a_mimic_joint() -> None:
    robot = load_robot(TREE_MIMIC)
    problem = problem_of((), robot=robot, count=40)
    result = found(problem)
    with mp.workdps(DIGITS):
        s = problem.samples
        true = np.array(
            [
                exact_regressor(robot, s.position[k], s.velocity[k], s.acceleration[k])
                for k in range(3)
            ]
        )
        theta = numbers(random_theta(robot, np.random.default_rng(0), ()))
        rows = numbers(problem.require_rows_here("test").rows(slice(0, 3))[:, :, :-1])
        error = true.dot(theta) - rows.dot(numbers(problem.base.matrix).dot(theta))
        assert mp.sqrt(np.sum(error * error)) <= mp.mpf(result.at(theta.astype(float)))


def planted(monkeypatch: pytest.MonkeyPatch, sample: int, joint: int, column: int) -> None:
    """Add 1e-6 to one entry of the rows."""
    rows = RowSource.rows

    def wrong(self: RowSource, part: slice, out: Array | None = None) -> Array:
        block = rows(self, part, out)
        if part.start <= sample < part.stop:
            block[sample - part.start, joint, column] += 1e-6
        return block

    monkeypatch.setattr(RowSource, "rows", wrong)


def test_a_mistake_of_the_regressor_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = problem_of(count=3000)
    before = found(problem)
    column = problem.base.names.index("zz2")
    planted(monkeypatch, 1234, 1, column)
    after = found(problem)
    assert before.total < 1e-6
    assert after.total > 1e-6 * problem.feasible.upper[19]
    assert (after.worst.joint, after.worst.sample) == (TWO, 1234)
    assert after.worst.error == pytest.approx(-1e-6)
    whole = problem.base.matrix[column] != 0.0
    assert after.worst.parameter in np.array(problem.base.theta_names)[whole]


def test_a_mistake_in_a_later_piece_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    one, two = (problem_of(seed=k, count=30).samples for k in (1, 2))
    problem = build_problem(ARM, Samples.join([one, two]), friction=PLAIN)
    planted(monkeypatch, 7, 0, 0)
    worst = found(problem).worst
    assert worst.joint == ONE
    assert worst.sample in (7, 37)  # it is planted in both


@pytest.mark.parametrize("weighting", ["gls", "eq18"])
def test_rows_may_be_elsewhere(weighting: Any) -> None:
    problem = problem_of(weighting=weighting, count=30)
    rows = problem.require_rows_here("test")

    class Sent:
        """Rows of another process: what goes there and comes back is pickled."""

        robot, friction, base, samples, n_samples = ARM, rows.friction, rows.base, rows.samples, 30

        def map(self, function: Any, *arguments: Any, sigma: Array | None = None) -> list[Any]:
            there, given = pickle.loads(pickle.dumps((function, arguments)))
            found: list[Any] = pickle.loads(pickle.dumps(rows.map(there, *given, sigma=sigma)))
            return found

    result = row_error(Sent(), problem.sigma, weighting, problem.feasible)
    assert result.total == found(problem).total


def test_a_wrong_regrouping_is_found() -> None:
    problem = problem_of()
    matrix = problem.base.matrix.copy()
    row, column = np.argwhere((matrix != 0.0) & (matrix != 1.0))[0]
    matrix[row, column] *= 1.0 + 1e-7
    base = replace(problem.base, matrix=matrix)
    rows = replace(problem.require_rows_here("test"), base=base)
    wrong = row_error(rows, problem.sigma, problem.weighting, problem.feasible)
    assert wrong.total > 1e3 * found(problem).total
    assert wrong.worst.parameter == base.theta_names[column]


def test_what_is_taken_as_computed_is_told() -> None:
    problem = problem_of((Coulomb(), Tilt()))
    assert found(problem).taken_as_computed == ("Tilt",)


def test_no_covariance_no_bound() -> None:
    problem = problem_of()
    rows = problem.require_rows("test")
    singular = np.array([[1.0, 1.0], [1.0, 1.0]])
    result = row_error(rows, singular, "gls", problem.feasible)
    assert result.total == np.inf


# ---- Errors of contacts' Jacobians, and what they do to a cost, against the same in 50 digits.


def exact_jacobians(samples: sdpid.Samples, k: int) -> Any:
    """Return the Jacobians (c, 6, n) of one sample."""
    robot, contacts = quadruped(), samples.contacts
    found = []
    for name, offset in zip(contacts.frames, contacts.offset, strict=True):
        frame = robot.pin_model.frames[robot.pin_model.getFrameId(name)]
        place = np.array(frame.placement.translation)
        at = frame.parentJoint - 1
        pair = exact_jacobian(robot, samples.position[k], at, place, offset)
        found.append(np.concatenate(pair, axis=1).T)
    return np.array(found, dtype=object)


def test_jacobians_are_within_their_bounds() -> None:
    samples, robot = gait(3).samples, quadruped()
    contacts, tree = samples.contacts, robot.tree
    assert contacts is not None
    joints = [Joint.of(tree, i) for i in range(len(tree.kind))]
    states = motion(tree, robot.offset, samples.position, samples.velocity, samples.acceleration)
    J = contact_jacobians(robot, samples.position, FEET, RADIUS)
    rng = np.random.default_rng(0)
    for spoil in (0.0, 1e-9):
        given = J + spoil * rng.standard_normal(J.shape)
        bounds = JacobianErrors(robot, joints, states, contacts, given).of_columns
        assert bounds.max() < 1e3 * U + 10.0 * spoil
        for k in range(3):
            off = given[k] - exact_jacobians(samples, k)
            for part in (0, 1):
                rows = off[:, 3 * part : 3 * part + 3]
                norm = np.array([[mp.norm(list(x)) for x in each.T] for each in rows])
                assert np.all(norm <= bounds[k, :, part])


def exact_axes(samples: sdpid.Samples, k: int, name: str) -> Any:
    """Return the axes of a frame in the world, as columns (3, 3)."""
    robot = quadruped()
    tree, frame = robot.tree, robot.pin_model.frames[robot.pin_model.getFrameId(name)]
    still = np.zeros(robot.n)
    turns = ExactMotion(tree, robot.offset, samples.position[k], still, still).R
    R, i = numbers(np.array(frame.placement.rotation)), frame.parentJoint - 1
    while i >= 0:
        R, i = turns[i].dot(R), int(tree.parent[i])
    return R


def test_axes_and_links_that_meet_are_within_their_bounds() -> None:
    samples, robot = gait(3).samples, quadruped()
    contacts = ContactSamples(
        frames=FEET,
        against=(None, FEET[0], None, "base_link"),
        kind=("line",),
        offset=np.array(RADIUS),
        down=samples.contacts.down,
    )
    tree = robot.tree
    joints = [Joint.of(tree, i) for i in range(len(tree.kind))]
    states = motion(tree, robot.offset, samples.position, samples.velocity, samples.acceleration)
    J = relative_jacobians(robot, samples.position, FEET, contacts.against, RADIUS)
    found = JacobianErrors(robot, joints, states, contacts, J)
    bounds = found.of_eliminated(samples.position, np.ones_like(contacts.down))
    assert bounds.max() < 1e3 * U
    axes = frame_axes(robot, samples.position, FEET)
    others = replace(samples, contacts=replace(contacts, frames=("base_link",) * 4, against=()))
    with mp.workdps(DIGITS):
        for k in range(3):
            exact = exact_jacobians(samples, k)
            exact[1] = exact[1] - exact[0]
            exact[3] = exact[3] - exact_jacobians(others, k)[3]
            # The base carries both links, whose places are not one here.
            exact[1][:, :6] = exact[3][:, :6] = mp.mpf(0)
            for i, name in enumerate(FEET):
                off = J[k, i] - exact[i]
                across = exact_axes(samples, k, name)[:, [0, 2]].T.dot(exact[i, 3:])
                moments = axes[k, i][:, [0, 2]].T @ J[k, i, 3:] - across
                for part, rows in enumerate((off[:3], moments)):
                    norm = np.array([mp.norm(list(x)) for x in rows.T])
                    assert np.all(norm <= bounds[k, i, part])
    assert not found.of_eliminated(samples.position, np.zeros_like(contacts.down)).any()


def least(r: Any, A: Any, C: Any) -> Any:
    """Return the least cost over all forces."""
    n, m = A.shape
    whole = mp.zeros(n + m)
    for i in range(n):
        for j in range(n):
            whole[i, j] = C[i, j]
        for j in range(m):
            whole[i, n + j] = whole[n + j, i] = A[i, j]
    x = mp.lu_solve(whole, mp.matrix([*r, *[0] * m]))
    return sum(r[i] * x[i] for i in range(n))


def costs(problem: Problem, theta: Array) -> tuple[Any, Any]:
    """Return the roots of the cost of the rows as computed, and of the equations of motion."""
    rows = problem.rows
    assert isinstance(rows, RowSource)
    samples = rows.samples
    contacts, touching, block = samples.contacts, rows.contacts(slice(None)), rows.rows(slice(None))
    computed = true = mp.mpf(0)
    for k in range(samples.n_samples):
        whole = problem.sigma
        if touching.covariance is not None:
            whole = whole + touching.covariance[k]
        C = numbers(np.tril(whole) + np.tril(whole, -1).T)
        A = numbers(touching.directions[k][:, touching.active[k]])
        base = numbers(problem.base.matrix).dot(numbers(theta))
        r = numbers(block[k, :, -1]) - numbers(block[k, :, :-1]).dot(base)
        computed += least(r, A, C)
        J = exact_jacobians(samples, k)
        r = numbers(samples.effort[k]) - exact_regressor(
            rows.robot, samples.position[k], samples.velocity[k], samples.acceleration[k]
        ).dot(numbers(theta))
        A = A[:, :0]
        if contacts.forces is None:
            closed = np.flatnonzero(contacts.down[k]).tolist()
            A = np.concatenate([J[i, :3].T for i in closed], axis=1)
            for i in (i for i in closed if contacts.kind[i] == "line"):
                across = exact_axes(samples, k, contacts.frames[i])[:, [0, 2]].T.dot(J[i, 3:])
                A = np.concatenate([A, across.T], axis=1)
        else:
            r = r + sum(J[i].T.dot(numbers(contacts.forces[k, i])) for i in range(contacts.n))
        true += least(r, A, C)
    return mp.sqrt(computed), mp.sqrt(true)


@pytest.mark.parametrize("known", ["nothing", "forces", "lines"])
def test_the_cost_of_the_equations_is_within_the_bound(known: str) -> None:
    made = gait(2, seed=3, share=0.5 if known == "lines" else 0.7)
    samples = made.measured(0.01 * np.eye(6)) if known == "forces" else made.samples
    if known == "lines":
        assert samples.contacts is not None
        lines = replace(samples.contacts, kind=("line", "point", "point", "point"))
        samples = replace(samples, contacts=lines)
    samples = replace(samples, effort=made.noisy().effort, covariance=np.diag(NOISE**2))
    problem = sdpid.build_problem(
        quadruped(), samples, friction=(), weighting="gls", check_excitation=False
    )
    assert problem.rows is not None
    B = problem.base.matrix
    near = Near(A=problem.A, rhs=problem.rhs, relative=1e-9, absolute=1e-6, base=B @ made.theta)
    found = row_error(problem.rows, problem.sigma, "gls", problem.feasible, near=near)
    rng = np.random.default_rng(1)
    with mp.workdps(DIGITS):
        for theta in (made.theta, rng.standard_normal(len(made.theta))):
            computed, true = costs(problem, theta)
            size = found.at(theta)
            assert abs(computed - true) <= size
            # The bound is worth something.
            assert size < 1e-6 * (1.0 + float(true))
            if np.all(np.abs(theta) <= found.box.theta):
                assert abs(computed - true) <= found.total + found.share * computed


@pytest.mark.parametrize("rank", [6, 3])
def test_forces_far_from_what_fits_are_told_by_the_cost(rank: int) -> None:
    rng = np.random.default_rng(rank)
    A = np.zeros((6, 6))
    A[:rank] = 1e3 * rng.standard_normal((rank, 6))
    limit = rng.uniform(0.5, 2.0, 6)
    # Forces depend on more than rows show, and hardly on that.
    F = 1e-9 * rng.standard_normal((40, rank)) @ A[:rank]
    F = np.column_stack([F + 1e-15 * rng.standard_normal((40, 6)), rng.standard_normal(40)])
    errors = ForceErrors.of(F)
    base = 0.1 * limit
    rhs = A @ base + 0.1 * rng.standard_normal(6)
    near = Near(A=A, rhs=rhs, relative=0.0, absolute=0.0, base=base)
    share, constant = errors.spread(near, limit)
    assert 0.0 < share < 1e-7
    assert constant < 1e-7
    for _ in range(20):
        beta = rng.uniform(-limit, limit)
        cost = float(np.linalg.norm(A @ beta - rhs))
        assert np.linalg.norm(F[:, :-1] @ (beta - base)) <= share * cost + constant
        assert np.linalg.norm(F @ np.append(beta, -1.0)) <= errors.at(beta, np.zeros(6))
        assert np.linalg.norm(F @ np.append(beta, -1.0)) <= errors.over(limit)


@pytest.mark.parametrize("known", ["depend", "apart"])
def test_errors_of_forces_that_depend_on_each_other_are_not_bounded(known: str) -> None:
    made = gait(4)
    covariance = np.diag([0.01, 0.01, np.inf, 0.0, 0.0, 0.0])
    if known == "depend":
        covariance[0, 1] = covariance[1, 0] = 0.004
    samples = made.measured(covariance)
    problem = sdpid.build_problem(
        quadruped(), samples, friction=(), weighting="gls", check_excitation=False
    )
    assert problem.rows is not None
    found = row_error(problem.rows, problem.sigma, "gls", problem.feasible)
    assert np.isfinite(found.total) == (known == "apart")
