"""The search for gains against SciPy's, and its derivatives against differences."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.optimize import least_squares

from sdpid._common.arrays import Array
from sdpid.assurance.drive_gains.checks import require_shown
from sdpid.assurance.drive_gains.consistent import ConsistentFit
from sdpid.assurance.drive_gains.errors import gain_errors, score_blocks
from sdpid.assurance.drive_gains.fit import GainFit
from sdpid.assurance.drive_gains.load import Load, Mounted
from sdpid.assurance.drive_gains.rows import GainModel, RunRows
from sdpid.errors import IdentifiabilityError
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.model.load import load_robot
from tests.helpers.arm_files import ARM_URDF

GAINS, MASS, NOISE = np.array([3.0, 2.0]), 1.5, 0.05
COM = (0.3, 0.05, 0.1)
FREE = np.ones(2, dtype=bool)


def samples(seed: int, *, loaded: bool) -> Samples:
    """Return states at random with the currents that they need."""
    robot, rng = load_robot(ARM_URDF), np.random.default_rng(seed)
    q, v, a = (rng.uniform(-2.0, 2.0, (400, 2)) for _ in range(3))
    bodies = robot.prior.copy()
    if loaded:
        bodies[1] += Load(mass=MASS, com=COM, inertia=0.01 * np.eye(3)).theta
    torque = robot.inverse_dynamics(bodies.ravel(), q, v, a)
    current = torque / GAINS + 0.2 * np.sign(v) + 0.1 * v
    current += NOISE * rng.standard_normal(q.shape)
    return Samples(position=q, velocity=v, acceleration=a, effort=current, block=10)


@cache
def fit(com: tuple[float, ...] | None = COM) -> GainFit:
    robot = load_robot(ARM_URDF)
    model = GainModel.of(robot, ("coulomb", "viscous"), ())
    runs = []
    for k in (0, 1):
        own = samples(k, loaded=bool(k))
        runs.append(RunRows.of(model, own, model.links(own), robot.prior, 0 if k else None))
    load = Mounted(Load(mass=MASS, com=com), model.base.matrix[:, 10:20], 1, np.eye(10))
    return GainFit(model, runs, [load], np.full(2, NOISE))


@pytest.mark.parametrize("start", [np.zeros(2), np.array([-2.0, 1.0])])
def test_the_search_ends_where_scipy_does(start: Array) -> None:
    found = fit().search(start, FREE)
    other = least_squares(lambda x: fit().at(x)[1], -np.log(GAINS), x_scale=0.1, xtol=1e-14)
    assert found.settled
    np.testing.assert_allclose(found.log_kappa, other.x, atol=1e-7)
    assert found.cost == pytest.approx(2.0 * other.cost, rel=1e-9)


def test_a_load_that_may_lie_along_the_axis_leaves_the_scale_open() -> None:
    """Moved along the last axis a mass is as if on the link before: the load's mass is not seen."""
    _, _, slopes = fit(None).at(-np.log(GAINS))
    _, singular, Vt = np.linalg.svd(slopes)
    assert singular[1] < 1e-9 * singular[0]
    np.testing.assert_allclose(Vt[1] / Vt[1, 0], 1.0, rtol=1e-6)
    with pytest.raises(IdentifiabilityError, match="only their ratios are shown"):
        require_shown(fit(None), -np.log(GAINS), FREE, anchored=True)
    require_shown(fit(), -np.log(GAINS), FREE, anchored=True)


def test_slopes_are_differences_at_the_optimum() -> None:
    """The slope of half the cost: what the projection leaves out is of second order in it."""
    at = fit().search(-np.log(GAINS), FREE).log_kappa + np.array([0.02, -0.03])
    _, residual, slopes = fit().at(at)
    step = 1e-6
    for j in range(2):
        ends = [fit().at(at + sign * step * np.eye(2)[j])[1] for sign in (1.0, -1.0)]
        costs = [0.5 * float(end @ end) for end in ends]
        assert float(slopes[:, j] @ residual) == pytest.approx(
            (costs[0] - costs[1]) / (2.0 * step), rel=1e-5
        )


def test_blocks_add_up_to_the_optimum() -> None:
    """One step of Gauss and Newton in all unknowns from the optimum ends there."""
    found = fit().search(np.zeros(2), FREE)
    blocks = score_blocks(fit(), found.log_kappa, found.z, FREE)
    fitted = blocks.root @ (blocks.root.T @ blocks.target.sum(axis=0))
    np.testing.assert_allclose(fitted[:2], -found.log_kappa, atol=1e-7)
    # White noise: the sandwich agrees with the variance that it makes.
    slopes = fit().at(found.log_kappa)[2]
    white = np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)))
    errors = gain_errors(fit(), found.log_kappa, found.z, FREE)
    np.testing.assert_allclose(np.sqrt(np.diag(errors.covariance)), white, rtol=0.25)


def test_bodies_that_can_exist_cost_no_less() -> None:
    found = fit().search(np.zeros(2), FREE)
    bound = ConsistentFit(fit()).solve(found.log_kappa, found.z, FREE)
    assert bound.settled
    assert bound.cost >= found.cost * (1.0 - 1e-9)
    # The truth can exist, so little is asked of the gains.
    errors = gain_errors(fit(), found.log_kappa, found.z, FREE)
    moved = np.abs(bound.log_kappa - found.log_kappa)
    assert np.all(moved < np.sqrt(np.diag(errors.covariance)))
