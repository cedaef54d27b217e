"""Corrected multipliers: disturbed ones prove the optimum again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.constraints.mass import TotalMass
from sdpid.estimation.duality.bound import PROVEN, bound_of, clip_psd, relative_gap
from sdpid.estimation.duality.correct_multipliers import corrected_multipliers
from sdpid.estimation.duality.multipliers import Multipliers
from sdpid.estimation.duality.refine_multipliers import refine_multipliers
from sdpid.estimation.problem import Problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.robot.inertia import Consistency
from tests.estimation.sdp.test_solve import ROBOTS, noisy

# Relative errors of multipliers, as large as those that made bounds fall short on simulated logs.
DISTURBED = 1e-9


def disturbed(multipliers: Multipliers, seed: int) -> Multipliers:
    """Return multipliers with random errors in those of the matrices and of the residual."""
    rng = np.random.default_rng(seed)
    noise = DISTURBED * np.abs(multipliers.Z).max() * rng.standard_normal(multipliers.Z.shape)
    Z = clip_psd(multipliers.Z + noise + np.swapaxes(noise, 1, 2))
    y = multipliers.y * (1.0 + DISTURBED * rng.standard_normal(len(multipliers.y)))
    return replace(multipliers, Z=Z, y=y)


def gap(problem: Problem, cost: float, multipliers: Multipliers) -> float:
    return relative_gap(problem, cost, bound_of(problem, multipliers).value)


@pytest.mark.parametrize("consistency", ["pseudo_inertia", "spatial_inertia"])
# No constraint holds the slider back: its cost is the floor, a bound whatever multipliers say.
@pytest.mark.parametrize("name", sorted(ROBOTS.keys() - {"slider"}))
def test_disturbed_multipliers_are_corrected(name: str, consistency: Consistency) -> None:
    problem = noisy(ROBOTS[name], 1, consistency=consistency)
    estimate = solve_sdp(problem)
    broken = disturbed(estimate.proof, 1)
    before = gap(problem, estimate.cost, broken)
    assert before > 10.0 * PROVEN
    found = corrected_multipliers(problem, np.array(estimate.theta), broken)
    after = gap(problem, estimate.cost, found)
    # Of 6×6 inequalities more than one multiplier fits, and less is gained.
    assert after <= (PROVEN if consistency == "pseudo_inertia" else 0.03 * before)
    assert np.linalg.eigvalsh(found.Z).min() >= -1e-12 * np.abs(found.Z).max()


def test_corrections_go_where_linear_equations_do_not() -> None:
    # The first link of the planar arm may hold any mass on its axis: no Z of it is definite.
    problem = noisy(ROBOTS["planar"], 1)
    estimate = solve_sdp(problem)
    theta, broken = np.array(estimate.theta), disturbed(estimate.proof, 1)
    refined = refine_multipliers(problem, theta, broken, estimate.cost, exhaustive=True)
    corrected = bound_of(problem, corrected_multipliers(problem, theta, broken))
    assert relative_gap(problem, estimate.cost, refined.value) > PROVEN
    assert relative_gap(problem, estimate.cost, corrected.value) <= PROVEN


def test_multipliers_of_conditions_take_part() -> None:
    free = noisy(ROBOTS["arm2"], 1)
    mass = float(np.array(solve_sdp(free).theta)[:20:10].sum())
    total = TotalMass(0.5 * mass, tolerance=0.1 * mass)
    problem = free.constrained(constraints=Constraints(others=(total,)))
    estimate = solve_sdp(problem)
    broken = disturbed(estimate.proof, 2)
    found = corrected_multipliers(problem, np.array(estimate.theta), broken)
    assert gap(problem, estimate.cost, found) <= PROVEN < gap(problem, estimate.cost, broken)


def test_parameters_that_are_no_optimum_stay_unproven() -> None:
    problem = noisy(ROBOTS["arm2"], 1)
    estimate = solve_sdp(problem)
    worse = 1.01 * np.array(estimate.theta)
    found = corrected_multipliers(problem, worse, disturbed(estimate.proof, 3))
    assert bound_of(problem, found).value <= estimate.cost * (1.0 + 1e-9)
