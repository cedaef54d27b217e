"""The worst mass matrix: found by search, bounded by proof, and able to be bad."""

from __future__ import annotations

import csv
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sdpid
from sdpid.assurance.diagnostics.mass_matrix import proven_bound, smallest_eigenvalues
from sdpid.errors import DataError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import build_problem
from sdpid.robot.description.catalog import bundled_folder
from sdpid.robot.inertia import spatial_inertia
from sdpid.robot.model.jacobians import joint_rates, link_jacobians
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel
from tests.helpers.arm import ARM, BOTH, arm_problem
from tests.helpers.data import make_samples, random_links, random_theta
from tests.helpers.robots import TREE, TREE_MIMIC, small_arm
from tests.helpers.small_robots import SMALL
from tests.helpers.strategies import SEEDS

# Sums of a few hundred products of order one.
ROUNDING = 1e-11


@cache
def robot(source: str) -> RobotModel:
    """Return a robot by its description, or an arm by its number of joints."""
    return small_arm(int(source)) if source.isdigit() else load_robot(source)


URDFS = {name: small.urdf for name, small in SMALL.items()}
ROBOTS = (TREE, TREE_MIMIC, "2", "4", "denso_vp6242", *URDFS.values())
NAMES = ("tree", "mimic", "arm2", "arm4", "denso", *URDFS)


@pytest.mark.parametrize("source", ROBOTS, ids=NAMES)
def test_velocities_of_links_make_the_mass_matrix(source: str) -> None:
    arm, rng = robot(source), np.random.default_rng(0)
    q = rng.uniform(-1.0, 1.0, (3, arm.n))
    theta = rng.standard_normal((arm.n_links, 10))
    J = link_jacobians(arm, q)
    M = np.einsum("klai,lab,klbj->kij", J, spatial_inertia(theta), J)
    np.testing.assert_allclose(M, arm.mass_matrix(theta, q), atol=ROUNDING)


@pytest.mark.parametrize("source", ROBOTS, ids=NAMES)
def test_joint_velocities_are_read_off_the_links_at_every_position(source: str) -> None:
    arm, rng = robot(source), np.random.default_rng(1)
    q = rng.uniform(-3.0, 3.0, (4, arm.n))
    V = link_jacobians(arm, q).reshape(4, -1, arm.n)
    shown = np.broadcast_to(arm.expansion, (4, *arm.expansion.shape))
    np.testing.assert_allclose(joint_rates(arm) @ V, shown, atol=ROUNDING)


@pytest.mark.parametrize("source", ROBOTS, ids=NAMES)
@given(seed=SEEDS)
def test_no_position_goes_below_the_proven_bound(source: str, seed: int) -> None:
    arm, rng = robot(source), np.random.default_rng(seed)
    theta = random_links(rng, arm.n_links)
    least = proven_bound(arm, theta)
    assert least is not None
    assert least > 0.0
    M = arm.mass_matrix(theta, rng.uniform(-3.2, 3.2, (4, arm.n)))
    assert np.linalg.eigvalsh(M).min() >= least


def test_a_floating_base_counts_and_its_place_does_not() -> None:
    flying = load_robot(TREE, root="free_flyer")
    rng = np.random.default_rng(2)
    theta = random_links(rng, flying.n_links)
    least = proven_bound(flying, theta)
    J = link_jacobians(flying, rng.uniform(-1.0, 1.0, (20, flying.n - 6)))
    M = np.einsum("klai,lab,klbj->kij", J, spatial_inertia(theta), J)
    assert least is not None
    assert np.linalg.eigvalsh(M).min() >= least > 0.0


@cache
def estimate_of(consistency: str, margin: float) -> Estimate:
    """Return an estimate that its constraints press on."""
    problem = arm_problem(consistency=consistency, margin=margin)  # type: ignore[arg-type]
    return sdpid.solve_sdp(problem)


@pytest.mark.parametrize("consistency", BOTH)
@given(q=st.lists(st.floats(-10.0, 10.0), min_size=2, max_size=2))
def test_constrained_estimates_stay_positive_definite(consistency: str, q: list[float]) -> None:
    estimate = estimate_of(consistency, 1e-3)
    assert smallest_eigenvalues(estimate, [q])[0] > 0.0


@pytest.mark.parametrize("consistency", BOTH)
def test_the_search_finds_the_worst_and_the_bound_is_below(consistency: str) -> None:
    estimate = estimate_of(consistency, 1e-3)
    worst = sdpid.smallest_mass_eigenvalue(estimate)
    grid = np.stack(np.meshgrid(*[np.linspace(-np.pi, np.pi, 181)] * 2), axis=-1).reshape(-1, 2)
    assert worst.value <= smallest_eigenvalues(estimate, grid).min() + ROUNDING
    assert smallest_eigenvalues(estimate, worst.q[None])[0] == pytest.approx(worst.value)
    assert worst.lower_bound is not None
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
    with pytest.raises(DataError, match="bounds"):
        sdpid.smallest_mass_eigenvalue(estimate, bounds=[[0.0, 1.0]])


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
    grid = np.stack(
        np.meshgrid(*[np.linspace(low, high, 41) for low, high in worst.bounds]), axis=-1
    ).reshape(-1, 3)
    assert worst.value <= smallest_eigenvalues(estimate, grid).min() + ROUNDING
    # Where it is least is beyond half a turn.
    half = sdpid.smallest_mass_eigenvalue(estimate, bounds=np.clip(worst.bounds, -5.0, np.pi))
    assert worst.value < half.value


@pytest.mark.parametrize("ends", ['lower="-1e9" upper="1e9"', ""])
def test_without_limits_a_joint_turns_once_or_slides_a_meter(ends: str) -> None:
    slide = f'<limit {ends} velocity="1" effort="1"/>'
    estimate = estimate_from_description(LIMITED.format(upper=60.0, limit=slide))
    worst = sdpid.smallest_mass_eigenvalue(estimate)
    turn = [0.5, 0.5 + 2.0 * np.pi]
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
    with (bundled_folder("denso_vp6242") / "table_iv.csv").open(encoding="utf-8") as file:
        values = {row["parameter"]: float(row[column]) for row in csv.DictReader(file)}
    base = np.array([values[name] for name in problem.base.names])
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
