"""Where parameters come from: laws, limits, and a brute-force division of variances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sdpid._common.arrays import Array
from sdpid.assurance.diagnostics.provenance import Provenance, _active_normals, provenance
from sdpid.errors import DataError
from sdpid.estimation.constraints.condition import Condition, Layout, Row
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.prior.prior import Prior
from sdpid.estimation.problem import Problem, build_problem
from sdpid.estimation.scaling import Scaling
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.estimation.wls import solve_wls
from sdpid.output.tables.parameter_tables import theta_table
from sdpid.robot.description.dh_table import DhTable
from sdpid.robot.inertia import from_pseudo_inertia, point_masses
from sdpid.robot.model.load import load_robot
from tests.helpers.data import flat_links, make_samples, random_links, random_theta
from tests.helpers.strategies import SEEDS

KINDS = ("euclidean", "scaled_euclidean", "pullback", "entropic")

# Shares are ratios of variances, from factorizations that lose a few hundred roundings.
SHARE = 1e-6


@dataclass(frozen=True)
class Equals(Condition):
    """One standard parameter is a given number."""

    name: str
    value: float

    def compile(self, layout: Layout):
        """Return one equation."""
        row = np.zeros(layout.count)
        row[layout.parameter(self.name)] = 1.0
        return [Row(self.name, row, self.value, self.value)]


def described_arm(rng: np.random.Generator, joints: int = 3):
    rows = tuple({"alpha": 0.5 * np.pi * (i % 2), "d": 0.3 * i} for i in range(joints))
    table = DhTable.from_mapping({"joint": rows, "name": "arm"})
    return load_robot(table.to_urdf(random_links(rng, joints)))


def problem_of(seed: int, prior: Prior | None, *, noise: float = 0.3, **options) -> Problem:
    rng = np.random.default_rng(seed)
    robot = described_arm(rng)
    samples = make_samples(robot, random_theta(robot, rng), rng, noise=noise)
    return build_problem(robot, samples, prior=prior, **options)


def of(problem: Problem, theta: Array) -> Provenance:
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
    for share in (found.data, found.physics, found.prior):
        assert share.min() >= 0.0
        assert share.max() <= 1.0
    assert np.allclose(found.data + found.physics + found.prior, 1.0, atol=1e-12)
    # Friction at its sign constraint is physics, and nothing else in friction is.
    assert np.allclose(found.physics[30:], theta[30:] == 0.0, atol=SHARE)
    assert (found.physics[:30].max() > 0.5) == (flat and kind != "entropic")


@pytest.mark.parametrize("kind", [None, *KINDS])
def test_what_the_effort_does_not_show_is_not_data(kind):
    problem = problem_of(0, None if kind is None else Prior(kind=kind))
    found = of(problem, interior(problem))
    invisible = ~problem.base.matrix.any(axis=0)
    assert invisible.any()
    assert np.abs(found.data[invisible]).max() < SHARE
    assert found.prior[invisible] == pytest.approx(1.0)


@pytest.mark.parametrize("kind", [None, *KINDS])
def test_what_strong_data_determine_alone_is_data(kind):
    prior = None if kind is None else Prior(kind=kind, strength=1e-6, friction=False)
    problem = problem_of(0, prior)
    found = of(problem, interior(problem))
    # Parameters that the base parameters determine by themselves.
    B = problem.base.matrix
    alone = np.linalg.norm(np.eye(len(found.data)) - np.linalg.pinv(B) @ B, axis=0) < 1e-9
    assert alone.sum() > 6
    assert found.data[alone] == pytest.approx(1.0, abs=1e-3)


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


def test_an_active_mass_bound_is_physics():
    problem = problem_of(1, Prior())
    theta = interior(problem)
    free = of(problem, theta)
    theta[10:20] *= problem.constraints.mass_min / theta[10]
    held = of(problem, theta)
    assert free.physics[10] == pytest.approx(0.0, abs=SHARE)
    assert held.physics[10] == pytest.approx(1.0)
    assert np.delete(held.physics, 10) == pytest.approx(0.0, abs=SHARE)
    # The unconstrained fit does not look at bounds.
    unconstrained = Estimate.of_theta(problem, theta, method="wls", status="optimal")
    assert provenance(unconstrained).physics.max() < SHARE


def test_an_equation_is_physics():
    rng = np.random.default_rng(2)
    name = described_arm(rng).parameter_names[20]
    problem = problem_of(2, Prior(), constraints=Constraints(others=(Equals(name, 0.7),)))
    theta = interior(problem)
    theta[20:30] *= 0.7 / theta[20]
    found = of(problem, theta)
    assert found.names[20] == name
    assert found.physics[20] == pytest.approx(1.0)
    assert found.physics[10] == pytest.approx(0.0, abs=SHARE)


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
    normals = _active_normals(problem, theta)
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


@pytest.mark.parametrize("kind", KINDS)
def test_a_strong_prior_is_prior_and_shares_follow_its_strength(kind):
    shares = []
    for strength in (1e-3, 1.0, 1e3, 1e12):
        problem = problem_of(4, Prior(kind=kind, strength=strength))
        shares.append(of(problem, interior(problem)).prior[:30])
    assert shares[-1] == pytest.approx(1.0, abs=1e-3)
    assert np.all(np.diff(shares, axis=0) >= -SHARE)


def test_more_data_are_more_data():
    quiet, loud = (problem_of(5, Prior(), noise=1.0, weighting="gls") for _ in range(2))
    object.__setattr__(loud, "A", 10.0 * loud.A)
    theta = interior(quiet)
    assert np.all(of(loud, theta).data >= of(quiet, theta).data - SHARE)


def test_at_the_belief_the_entropic_and_its_quadratic_agree():
    pullback, entropic = (problem_of(6, Prior(kind=kind)) for kind in ("pullback", "entropic"))
    theta = interior(pullback)
    theta[:30] = pullback.robot.prior.ravel()
    # The believed bodies are above the least size, so that nothing was repaired.
    assert np.allclose(pullback.prior.terms[0].residual(theta)[:30], 0.0, atol=1e-9)
    for a, b in zip(
        of(pullback, theta).to_dict().values(), of(entropic, theta).to_dict().values(), strict=True
    ):
        assert a == pytest.approx(b, abs=SHARE)


def test_a_link_that_nothing_is_believed_of():
    rng = np.random.default_rng(7)
    bodies = random_links(rng, 3)
    bodies[1] = 0.0
    problem = problem_of(7, Prior(bodies=bodies))
    found = of(problem, interior(problem))
    assert np.all(np.isfinite(found.data))
    # Whatever the data show of it is data.
    assert found.data[10:20].max() > 0.9
    assert np.allclose(found.data + found.physics + found.prior, 1.0)


def test_of_a_solution_on_the_boundary():
    rng = np.random.default_rng(9)
    robot = described_arm(rng)
    theta = random_theta(robot, rng)
    # A link that is a point: noise presses its estimate against what can exist.
    theta[20:30] = flat_links(rng, 1)
    samples = make_samples(robot, theta, rng, noise=0.3)
    found = provenance(solve_sdp(build_problem(robot, samples)))
    assert found.physics[20:30].max() > 0.1
    problem = build_problem(robot, samples, prior=Prior(kind="entropic"))
    believed = provenance(solve_sdp(problem))
    # A barrier keeps the estimate away from the boundary: nothing of a link is held.
    assert believed.physics[:30].max() < SHARE


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
    with pytest.raises(DataError, match="no standard parameters"):
        provenance(bare)
