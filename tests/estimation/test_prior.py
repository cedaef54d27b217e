"""The prior: its definition and invariance, its strength, and what it does to a problem."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sdpid
from sdpid import Constraints, Prior, Samples, certify, solve_sdp, solve_wls
from sdpid._common.arrays import Array
from sdpid.constraints import MirrorPair
from sdpid.errors import DataError, IdentifiabilityError, ModelError
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.prior import evidence
from sdpid.estimation.prior.cost_terms import LogDetTerm
from sdpid.estimation.prior.prior import prior_terms, repaired
from sdpid.estimation.problem import Problem, build_problem
from sdpid.robot.inertia import from_pseudo_inertia, margin, point_masses, pseudo_inertia
from tests.helpers.arm import ARM, BODIES, FIRST, LAST, PAIR, REFLECTION, arm_problem
from tests.helpers.data import make_samples, random_links, row_source
from tests.helpers.refusals import refuses
from tests.helpers.robots import LIFT, described_arm
from tests.helpers.strategies import SEEDS, random_states

# Round-off of a few products of numbers of order one.
ROUNDING = 1e-9


def bodies_of(seed: int, links: int = 2) -> np.ndarray:
    rng = np.random.default_rng(seed)
    masses = rng.uniform(0.2, 1.0, (links, 8))
    return point_masses(masses, rng.normal(0.0, 0.1, (links, 8, 3)))


def rows_of(robot, count: int = 40) -> RowSource:
    rng = np.random.default_rng(0)
    q, v, a, effort = (rng.normal(size=(count, robot.n)) for _ in range(4))
    return row_source(robot, Samples(position=q, velocity=v, acceleration=a, effort=effort))


def samples_of(
    robot, truth: np.ndarray, seed: int = 0, *, count: int = 300, noise: float = 0.05, **fields
) -> Samples:
    rng = np.random.default_rng(seed)
    states = tuple(rng.normal(size=(count, robot.n)) for _ in range(3))
    given = {"states": states, "noise": noise, "friction": (), **fields}
    return make_samples(robot, truth.ravel(), rng, **given)


def penalty(robot, prior: Prior, bodies: np.ndarray) -> float:
    rows = rows_of(robot)
    found = prior_terms(prior, rows).terms[0]
    theta = np.concatenate([bodies.ravel(), np.zeros(len(rows.friction.parameters))])
    return found.value(theta)


def divergence(P: np.ndarray, P0: np.ndarray) -> float:
    """Log-det divergences of 4x4 matrices, by their definition: no factor of P0, no eigenvalue."""
    ratio = np.linalg.solve(P0, P)
    return float(np.sum(np.trace(ratio, axis1=1, axis2=2) - np.linalg.slogdet(ratio)[1] - 4.0))


@given(st.integers(0, 2**31), st.floats(0.1, 10.0))
def test_euclidean_kinds_are_squared_distances(seed: int, strength: float):
    robot, moved = described_arm(bodies_of(seed)), bodies_of(seed + 1)
    believed = repaired(robot.prior)[0]
    raw = penalty(robot, Prior(strength=strength, kind="euclidean"), moved)
    assert raw == pytest.approx(strength * np.sum((moved - believed) ** 2))
    scaled = 0.0
    for body, reference in zip(moved, believed, strict=True):
        mass = reference[0]
        # tr(I) is twice the second moment about the origin.
        length = np.sqrt(0.5 * (reference[4] + reference[6] + reference[9]) / mass)
        units = mass * length ** np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
        scaled += strength * np.sum(((body - reference) / units) ** 2)
    prior = Prior(strength=strength, kind="scaled_euclidean")
    assert penalty(robot, prior, moved) == pytest.approx(scaled)


@given(st.integers(0, 2**31), st.floats(0.1, 10.0))
def test_entropic_kind_is_the_divergence(seed: int, strength: float):
    bodies = bodies_of(seed)
    robot = described_arm(bodies)
    rows = rows_of(robot)
    found = prior_terms(Prior(strength=strength, kind="entropic"), rows)
    quadratic = prior_terms(Prior(strength=strength), rows)
    (squared, entropic), (quadratic_squared,) = found.terms, quadratic.terms
    # The rows are those of the friction terms.
    assert np.array_equal(squared.matrix, quadratic_squared.matrix[20:])
    assert np.array_equal(squared.rhs, quadratic_squared.rhs[20:])
    assert found.strength == quadratic.strength == strength
    theta = np.concatenate([bodies_of(seed + 1).ravel(), np.ones(4)])
    P, P0 = map(pseudo_inertia, (theta[:20].reshape(2, 10), repaired(bodies)[0]))
    exact = 2.0 * strength * divergence(P, P0)
    assert entropic.value(theta) == pytest.approx(exact, rel=1e-6)
    assert entropic.value(theta[:20].reshape(2, 10)) == entropic.value(theta)
    # The quadratic kind is its second-order expansion at the believed bodies.
    there = np.concatenate([repaired(bodies)[0].ravel(), np.ones(4)])
    assert np.allclose(entropic.curvature_rows(there), quadratic_squared.matrix[:20])
    alone = prior_terms(Prior(kind="entropic", friction=False), rows)
    assert alone.terms[0].matrix.shape == (0, 24)
    assert alone.terms[0].rhs.shape == (0,)


@pytest.mark.parametrize("kind", ["euclidean", "scaled_euclidean", "pullback", "entropic"])
def test_every_kind_repairs_first_and_hardly_believes_what_has_no_mass(kind):
    bodies = bodies_of(0, 3)
    bodies[1, 4:] = [1.0, 0.0, 0.1, 0.0, 0.0, 0.1]
    bodies[2] = 0.0
    prior = Prior(kind=kind, bodies=bodies, friction=False)
    found = prior_terms(prior, rows_of(described_arm(bodies_of(1, 3))))
    assert any("link_2 could not exist as described" in note for note in found.notes)
    assert any("next to no information about link_3" in note for note in found.notes)
    squared, *others = found.terms
    theta = np.concatenate([repaired(bodies)[0].ravel(), np.ones(6)])
    theta[20:30] = np.linalg.lstsq(squared.matrix[-10:, 20:30], squared.rhs[-10:], rcond=None)[0]
    assert theta[20] == pytest.approx(np.mean(bodies[:2, 0]))
    assert np.linalg.norm(squared.residual(theta)) < ROUNDING
    # Doubling it costs a hundredth of what doubling a described link costs.
    doubled = theta.copy()
    doubled[20:30] *= 2.0
    if kind == "pullback":
        assert squared.value(doubled) == pytest.approx(0.04)
    if kind == "entropic":
        (log_det,) = others
        assert log_det.value(theta) < ROUNDING
        assert log_det.links.tolist() == [0, 1]


@pytest.mark.parametrize("consistency", ["pseudo_inertia", "spatial_inertia"])
def test_data_that_do_not_excite_are_enough_with_a_prior(consistency):
    robot, rest = described_arm(bodies_of(3, 3)), np.zeros((60, 3))
    position = np.tile([0.1, 0.2, 0.3], (60, 1))
    states = {"position": position, "velocity": rest, "acceleration": rest}
    samples = Samples(**states, effort=rest)
    refuses(IdentifiabilityError, "do not excite", build_problem, robot, samples)
    problem = build_problem(robot, samples, prior=Prior(), consistency=consistency)
    certificate = certify(solve_sdp(problem))
    assert certificate.passed, certificate.summary()


def test_thin_bodies_are_widened_and_named():
    bodies = bodies_of(0)
    rod = point_masses(np.array([1.0, 1.0]), np.array([[0.0, 0.0, -0.3], [0.0, 0.0, 0.3]]))
    # A rod along z, 1 mm across.
    bodies[1] = rod + 2e-6 * np.array([0, 0, 0, 0, 1, 0, 1, 0, 0, 2])
    assert margin(bodies[1], "pseudo_inertia") > 0.0
    _, wrong, thin = repaired(bodies)
    assert (wrong, thin) == ((), (1,))
    notes = prior_terms(Prior(bodies=bodies), rows_of(described_arm(bodies_of(1)))).notes
    assert [note for note in notes if "widened" in note and "link_2" in note]
    # What was widened once is not thin.
    assert repaired(repaired(bodies)[0])[1:] == ((), ())


def test_a_likelihood_without_a_covariance_says_its_unit():
    robot = described_arm(bodies_of(0))
    samples = rows_of(robot, 200).samples
    known = replace(samples, covariance=np.eye(2))
    assert "unit" in " ".join(build_problem(robot, samples, prior=Prior()).prior.notes)
    assert build_problem(robot, known, prior=Prior()).prior.notes == ()
    assert build_problem(robot, samples, prior=Prior(), weighting="residual").prior.notes == ()


@given(st.integers(0, 2**31), st.floats(0.01, 100.0), st.booleans())
@settings(max_examples=20, deadline=None)
def test_least_squares_counts_a_log_det_prior(seed: int, strength: float, known: bool):
    """The unconstrained minimum has a body for every link, no slope, and costs no more."""
    belief, truth = bodies_of(seed), bodies_of(seed + 1)
    robot = described_arm(belief)
    samples = samples_of(robot, truth, seed, count=60, noise=0.1)
    if not known:
        belief[0] = 0.0
    prior = Prior(kind="entropic", strength=strength, bodies=belief)
    problem = build_problem(robot, samples, prior=prior, weighting="residual")
    estimate = solve_wls(problem)
    assert np.isfinite(estimate.cost)
    assert np.all(margin(estimate.theta[:20].reshape(2, 10), "pseudo_inertia")[~known:] > 0.0)
    slope = problem.gradient(estimate.theta)
    rows = np.vstack(
        [term.curvature_rows(estimate.theta) for term in (problem.squared, problem.log_det)]
    )
    # What a further Newton step would bring, beside the cost.
    scale = np.linalg.norm(rows, axis=0)
    step = np.linalg.lstsq((rows / scale).T @ (rows / scale), slope / scale, rcond=None)[0] / scale
    assert abs(slope @ step) < 1e-10 * max(estimate.cost, float(problem.rhs @ problem.rhs))
    assert estimate.cost <= solve_sdp(problem).cost * (1.0 + 1e-9)
    # The same optimum is proven where nothing but the prior keeps links bodies.
    proven = solve_sdp(problem.constrained(consistency="none"))
    assert proven.cost == pytest.approx(estimate.cost, rel=1e-5)


# ---- The strength by evidence: its formula, what it recovers, and that it is said.


# Of the largest number that differences are taken of: the plain formula solves with a covariance
# that weak beliefs make all but singular, which costs it some ten digits.
DIGITS = 1e-5
STRENGTHS = np.array([0.01, 0.3, 1.0, 7.0, 100.0])


def case(rng: np.random.Generator, count: int = 30, links: int = 8, others: int = 3):
    """Return whitened rows, believed rows and others, of theta with links and other entries."""
    p = links + others
    G, h = rng.normal(size=(count, p)), rng.normal(size=count)
    R, r = rng.normal(size=(links, links)), rng.normal(size=links)
    R = np.hstack([R, np.zeros((links, others))])
    F, f = np.hstack([np.zeros((others, links)), np.eye(others)]), rng.normal(size=others)
    return (G, h), (R, r), (F, f)


@given(SEEDS)
def test_it_is_the_density_of_the_data(seed: int):
    (G, h), (R, r), (F, f) = case(np.random.default_rng(seed))
    found = evidence.negative_log_evidence((G, h), (R, r), (F, f), STRENGTHS)
    expected = []
    for strength in STRENGTHS:
        # The data are normal: theta's belief seen through G, and noise.
        rows = np.vstack([np.sqrt(strength) * R, F])
        mean = np.linalg.solve(rows, np.concatenate([np.sqrt(strength) * r, f]))
        root = np.linalg.solve(rows.T, G.T)
        covariance = np.eye(len(h)) + root.T @ root
        error = h - G @ mean
        size = np.linalg.slogdet(covariance)[1]
        expected.append(0.5 * (error @ np.linalg.solve(covariance, error) + size))
    close = DIGITS * np.abs(expected).max()
    assert np.diff(found) == pytest.approx(np.diff(expected), abs=close)


@given(SEEDS)
def test_what_nobody_knows_does_not_matter(seed: int):
    rng = np.random.default_rng(seed)
    (G, h), (R, r), (F, f) = case(rng)
    turn = np.linalg.qr(rng.normal(size=(13, 13)))[0]
    plain = evidence.negative_log_evidence((G, h), (R, r), (F, f), STRENGTHS)
    wide = [(np.hstack([M, np.zeros((len(M), 2))]) @ turn, v) for M, v in ((G, h), (R, r), (F, f))]
    found = evidence.negative_log_evidence(*wide, STRENGTHS)
    close = DIGITS * np.abs(plain).max()
    assert np.diff(found) == pytest.approx(np.diff(plain), abs=close)


@pytest.mark.parametrize("strength", [0.05, 1.0, 20.0])
def test_the_strength_that_made_the_parameters_is_recovered(strength):
    rng = np.random.default_rng(3)
    links = 60
    theta = rng.normal(size=links) / np.sqrt(strength)
    G = 10.0 * rng.normal(size=(200, links))
    data = G, G @ theta + rng.normal(size=200)
    beliefs = (np.eye(links), np.zeros(links)), (np.zeros((0, links)), np.zeros(0))
    found = evidence.strength_by_evidence(data, *beliefs)
    # A variance from 60 draws is known to sqrt(2/60), 18 %; three times that.
    assert abs(np.log(found / strength)) < 0.55
    grid = np.geomspace(evidence.WEAKEST, evidence.STRONGEST, 400)
    values = evidence.negative_log_evidence(data, *beliefs, grid)
    assert found == pytest.approx(grid[np.argmin(values)], rel=0.03)


@pytest.mark.parametrize("kind", ["euclidean", "scaled_euclidean", "pullback", "entropic"])
def test_a_problem_resolves_it_and_says_so(kind):
    belief = bodies_of(0, 3)
    robot = described_arm(belief)
    samples = samples_of(robot, bodies_of(1, 3))
    prior = Prior(strength="evidence", kind=kind)
    problem = build_problem(robot, samples, prior=prior, weighting="residual")
    strength = problem.prior.strength
    assert evidence.WEAKEST <= strength <= evidence.STRONGEST
    assert f"prior: strength {strength:.2g} nats by evidence" in problem.prior.notes[-1]
    fixed = Prior(strength=strength, kind=kind)
    again = build_problem(robot, samples, prior=fixed, weighting="residual")
    assert np.array_equal(again.squared.matrix, problem.squared.matrix)
    assert np.array_equal(again.squared.rhs, problem.squared.rhs)
    assert len(again.log_det.links) == (3 if kind == "entropic" else 0)
    if kind == "entropic":
        assert again.log_det.strength == problem.log_det.strength == strength


def test_good_descriptions_are_believed_more_than_bad_ones():
    belief = bodies_of(0, 3)
    robot = described_arm(belief)
    found = []
    for size in (0.01, 0.7):
        rng = np.random.default_rng(1)
        L = np.linalg.cholesky(pseudo_inertia(belief))
        U = rng.normal(size=(3, 4, 4))
        U = np.eye(4) + 0.3 * size * (U + np.swapaxes(U, 1, 2))
        truth = from_pseudo_inertia(L @ U @ np.swapaxes(L, 1, 2))
        prior = Prior(strength="evidence")
        problem = build_problem(robot, samples_of(robot, truth), prior=prior, weighting="residual")
        found.append(problem.prior.strength)
    assert found[0] > 3.0 * found[1]
    assert found[0] > 0.9 * evidence.STRONGEST
    heavy = samples_of(robot, 50.0 * truth)
    bad = build_problem(robot, heavy, prior=prior, weighting="residual").prior
    assert "the least that is tried" in bad.notes[-1]


def test_costs_that_are_no_likelihood_take_no_prior():
    robot, prior = described_arm(bodies_of(0)), Prior(strength="evidence")
    samples = samples_of(robot, bodies_of(1))
    for weighting in ("eq9", "eq18"):
        for given_prior in (Prior(), prior):
            words, given = f"'{weighting}' is no likelihood.*no prior", {"prior": given_prior}
            refuses(DataError, words, build_problem, robot, samples, weighting=weighting, **given)
    refuses(DataError, "likelihood", build_problem, robot, samples, prior=prior, weighting="gls")
    known = samples_of(robot, bodies_of(1), covariance=0.05**2 * np.eye(2))
    by_covariance = build_problem(robot, known, prior=prior, weighting="gls")
    assert by_covariance.prior.strength > 0.0


# ---- Friction is believed and bounded by the size of the efforts, not by that of the robot.


ROBOT = sdpid.load_robot(LIFT)
LIMITS = Constraints.of_size(ROBOT)
TERMS = ("coulomb", "viscous", "offset")

# A lift of 10 kg with as much friction as lifts have: N·s/m and N.
VISCOUS, COULOMB = 300.0, 6.0


def lifted(weight: float = 1.0) -> Samples:
    """Return exact samples; of its weight the lift's motor carries a share."""
    t = np.arange(0.0, 30.0, 0.02)
    shape = ((0.08, 0.3), (1.2, 1.1))
    q, v, a = (
        np.stack([s * w**k * np.sin(w * t + k * np.pi / 2) for s, w in shape], axis=1)
        for k in range(3)
    )
    rigid = ROBOT.inverse_dynamics(ROBOT.prior, q, v, a)
    rigid[:, 0] -= (1.0 - weight) * rigid[:, 0].mean()
    friction = [VISCOUS, 0.3] * v + [COULOMB, 0.0] * np.sign(v)
    return Samples(position=q, velocity=v, acceleration=a, effort=rigid + friction)


def problem_of(samples: Samples, prior: Prior | None, limits: Constraints = LIMITS) -> Problem:
    return build_problem(
        ROBOT, samples, friction=TERMS, weighting="residual", constraints=limits, prior=prior
    )


def test_the_size_of_a_robot_does_not_bound_its_friction() -> None:
    problem = problem_of(lifted(), None)
    assert LIMITS.theta_max < VISCOUS < problem.constraints.friction_max <= 1e5
    found = solve_sdp(problem)
    assert found.named()["Fv1"] == pytest.approx(VISCOUS, rel=1e-3)
    assert found.theta[[0, 10]].sum() == pytest.approx(10.0, rel=1e-3)
    assert sdpid.certify(found).passed
    # Other constraints keep it, and a bound that was given is the bound.
    again = problem.constrained(constraints=LIMITS.replace(mass_max=20.0))
    assert again.constraints.friction_max == problem.constraints.friction_max
    tight = solve_sdp(problem_of(lifted(), None, LIMITS.replace(friction_max=VISCOUS / 2)))
    assert tight.named()["Fv1"] == pytest.approx(VISCOUS / 2)
    refuses(sdpid.errors.DataError, "friction_max is -1", LIMITS.replace, friction_max=-1.0)


def test_friction_of_a_joint_without_rows_is_believed_to_be_small() -> None:
    samples = lifted()
    mask = np.tile([False, True], (samples.n_samples, 1))
    found = solve_sdp(problem_of(replace(samples, mask=mask), Prior()))
    values = found.named()
    assert max(abs(values["Fs1"]), abs(values["Fo1"])) < 0.1
    errors = sdpid.confidence_intervals(found, parameters=("Fs1", "Fv1"), method="gauss_markov")
    # As large as the efforts of the described links, and no more.
    assert 100.0 < errors.upper[0] < 300.0
    assert errors.upper[1] < problem_of(samples, None).constraints.friction_max
    # To what is believed of it, a solver finds zero as nearly as it proves its optimum.
    assert abs(values["Fv1"]) < 1e-3 * errors.upper[1]


@pytest.mark.parametrize("weight", [1.0, 0.0])
def test_an_offset_may_be_of_the_size_of_the_weight(weight: float) -> None:
    """A counterweight leaves little effort to measure, and masses are what they are."""
    samples = lifted(weight)
    noise = 0.01 * np.random.default_rng(0).standard_normal(samples.effort.shape)
    found = solve_sdp(problem_of(replace(samples, effort=samples.effort + noise), Prior()))
    assert found.theta[0] == pytest.approx(8.0, rel=0.3)
    assert found.named()["Fo1"] == pytest.approx(-98.1 * (1.0 - weight), abs=25.0)


# ---- Friction in both directions is believed to be alike: one direction must not ruin the other.


def moved(low: float, forwards: float, backwards: float) -> Estimate:
    """Return an estimate from a motion whose second joint moves at speeds of low to 2 rad/s."""
    rng = np.random.default_rng(1)
    q, v, a = random_states(rng, 2, 300)
    v[:, 1] = rng.uniform(low, 2.0, 300)
    effort = ARM.inverse_dynamics(BODIES.ravel(), q, v, a) + 0.5 * v
    effort += np.where(v > 0.0, forwards, -backwards) + 0.01 * rng.standard_normal(v.shape)
    samples = Samples(position=q, velocity=v, acceleration=a, effort=effort)
    terms = ("asymmetric_coulomb", "viscous")
    prior = Prior(bodies=BODIES)
    return solve_sdp(build_problem(ARM, samples, friction=terms, weighting="residual", prior=prior))


def test_a_side_that_never_moved_is_like_the_other_and_sides_that_moved_may_differ() -> None:
    theta = moved(0.1, 0.6, 0.6).named_theta()
    assert theta["Fsp2"] == pytest.approx(0.6, abs=0.03)
    # Believed to be small too, it stays a little below.
    assert 0.9 * theta["Fsp2"] < theta["Fsn2"] <= theta["Fsp2"]
    theta = moved(-2.0, 0.6, 0.3).named_theta()
    assert theta["Fsp2"] == pytest.approx(0.6, abs=0.03)
    assert theta["Fsn2"] == pytest.approx(0.3, abs=0.03)


# ---- The log-det divergence: its definition, derivatives, invariance and lower bounds.


# Friction terms behind the links, of which the divergence knows nothing.
EXTRA = 3

# Central differences with a relative step of 1e-6.
DIFFERENCE = 1e-5


def make(seed: int, *, strength: float = 1.0) -> tuple[LogDetTerm, np.ndarray, np.ndarray]:
    """Return the divergence of links 0 and 2 of three, its P0 and a theta."""
    rng = np.random.default_rng(seed)
    believed, bodies = random_links(rng, 2), random_links(rng, 3)
    theta = np.concatenate([bodies.ravel(), rng.normal(size=EXTRA)])
    return (
        LogDetTerm.around([0, 2], believed, strength, len(theta)),
        pseudo_inertia(believed),
        theta,
    )


@given(SEEDS)
def test_infinite_outside_the_cone(seed: int):
    entropy, _, theta = make(seed)
    outside = theta.copy()
    outside[20] = -1.0
    assert entropy.value(outside) == np.inf
    refuses(DataError, "can exist", entropy.gradient, outside)
    # A link that nothing is believed of may be anything.
    unbelieved = theta.copy()
    unbelieved[10:20] = -1.0
    assert entropy.value(unbelieved) == entropy.value(theta)


@given(SEEDS)
def test_gradient_and_second_derivative(seed: int):
    entropy, P0, theta = make(seed, strength=0.7)
    # In coordinates where the bodies have size one differences of all entries are as good.
    L = np.linalg.cholesky(P0)
    rng = np.random.default_rng(seed)
    step = np.zeros_like(theta)
    for block, root in zip((slice(0, 10), slice(20, 30)), L, strict=True):
        change = rng.normal(size=(4, 4))
        P = pseudo_inertia(theta[block])
        size = np.linalg.eigvalsh(np.linalg.solve(root, np.linalg.solve(root, P).T))[0]
        step[block] = size * from_pseudo_inertia(root @ (change + change.T) @ root.T)
    step[10:20], step[30:] = rng.normal(size=10), rng.normal(size=EXTRA)
    small = 1e-5
    up, down = entropy.value(theta + small * step), entropy.value(theta - small * step)
    slope = float(entropy.gradient(theta) @ step)
    scale = float(np.linalg.norm(entropy.curvature_rows(theta) @ step))
    assert abs((up - down) / (2.0 * small) - slope) <= DIFFERENCE * (abs(slope) + scale)
    change = entropy.gradient(theta + small * step) - entropy.gradient(theta - small * step)
    assert change @ step / (2.0 * small) == pytest.approx(2.0 * scale**2, rel=1e-4)
    assert not entropy.gradient(theta)[10:20].any()
    assert not entropy.gradient(theta)[30:].any()


@given(SEEDS, st.floats(0.1, 10.0), st.floats(-3.0, 3.0))
def test_the_support_is_below_everywhere_and_tight_at_its_point(
    seed: int, strength: float, exponent: float
):
    entropy, _, theta = make(seed, strength=strength)
    rng = np.random.default_rng(seed)
    root = 10.0**exponent * rng.normal(size=(2, 4, 4))
    W = root @ np.swapaxes(root, 1, 2) + 10.0 ** (2.0 * exponent) * 1e-3 * np.eye(4)
    points = [theta, make(seed + 1)[2], make(seed + 2)[2]]
    constant, linear = entropy.support(W)
    for point in points:
        size = abs(constant) + float(np.abs(linear) @ np.abs(point))
        assert entropy.value(point) >= constant + linear @ point - 1e-12 * size
    constant, linear = entropy.support(entropy.multiplier(theta))
    size = abs(constant) + float(np.abs(linear) @ np.abs(theta))
    value = entropy.value(theta)
    assert constant + linear @ theta == pytest.approx(value, rel=1e-9, abs=1e-9 * size)
    assert np.allclose(linear, entropy.gradient(theta), rtol=1e-9, atol=1e-9 * np.abs(linear).max())


# ---- The belief that links are nearly mirror images of each other.


def test_a_prior_is_a_value_and_says_whom_it_believes_alike() -> None:
    pairs, own = (PAIR, MirrorPair(LAST, FIRST, reflection=REFLECTION)), bodies_of(0)
    prior = Prior(bodies=own, alike=pairs, within=0.1)
    same = Prior(bodies=own.tolist(), alike=list(pairs), within=0.1)
    others = [{"bodies": bodies_of(1)}, {"alike": pairs[:1]}, {"within": 0.2}]
    for changed in ({}, *others):
        assert (prior == replace(same, **changed)) == (not changed)
    assert hash(prior) == hash(same)
    assert prior != "prior"
    own[0, 0] = 7.0
    assert prior == same
    with pytest.raises(ValueError, match="read-only"):
        prior.bodies[0, 0] = 7.0
    problem = arm_problem(prior=Prior(bodies=BODIES, alike=pairs))
    words = "prior: mirror images of each other within 5 %: link_1 and link_2"
    assert any(note.startswith(words) for note in problem.prior.notes)
    tailed = Prior(bodies=BODIES, alike=MirrorPair(FIRST, "tail", reflection=REFLECTION))
    refuses(ModelError, "no link 'tail'", arm_problem, prior=tailed)
    rows, nothing = rows_of(described_arm(bodies_of(0))), Prior(bodies=np.zeros((2, 10)))
    refuses(DataError, "no link a mass", prior_terms, nothing, rows)


PLANES = [MirrorPair(*names, normal=(0, 1, 0)) for names in (("a", "b"), ("b", "a"))]
NO_PRIORS: list[tuple[dict[str, Any], str]] = [
    *(({"strength": strength}, "strength") for strength in (0.0, -1.0, np.inf, np.nan, "x", True)),
    ({"kind": "flat"}, "kind"),
    ({"bodies": np.full((2, 10), np.nan)}, "20 of 20 values are not finite"),
    ({"bodies": np.ones((2, 9))}, r"shape \(2, 9\)"),
    ({"bodies": np.ones(10)}, "1 axes"),
    ({"bodies": [["heavy"] * 10]}, "not a rectangular array of real numbers"),
    ({"alike": PAIR, "within": 0.0}, r"within is 0\.0; give a positive share"),
    ({"alike": PAIR, "within": True}, "within is True; give a positive share"),
    ({"alike": (PAIR, PAIR)}, "alike holds 'link_1' and 'link_2' twice"),
    ({"alike": PLANES}, "alike holds 'b' and 'a' twice"),
    ({"alike": ("link_1",)}, "alike holds 'link_1'"),
]
NO_TERMS: list[tuple[list[int], Array, float, str]] = [
    ([0], np.eye(4)[None], 0.0, "strength"),
    ([0, 1], np.eye(4)[None], 1.0, "shape"),
    ([0], -np.eye(4)[None], 1.0, "positive definite"),
]


def test_what_makes_no_sense_is_refused() -> None:
    for given_, words in NO_PRIORS:
        refuses(DataError, words, Prior, **given_)
    for links, inverses, strength, words in NO_TERMS:
        refuses(DataError, words, LogDetTerm, np.array(links), inverses, strength, 20)
    entropy, _, _ = make(0)
    refuses(DataError, "W number 1", entropy.support, np.array([np.eye(4), -np.eye(4)]))
    refuses(DataError, "shape", entropy.support, np.eye(4))
