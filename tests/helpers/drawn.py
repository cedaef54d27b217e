"""Draws made by hand: robots about an estimate, without a sampler."""

import numpy as np

import sdpid
from sdpid._common.arrays import Array
from sdpid.estimation.estimate import Estimate
from sdpid.experiment.processing.samples import Samples
from sdpid.output.samples.ranges import changed
from sdpid.robot.model.base_parameters import generic_states
from sdpid.robot.model.model import RobotModel
from tests.helpers.data import full_regressor, random_theta
from tests.helpers.robots import TREE_MIMIC

# Spread of each number of the log-Cholesky form, and of the logarithm of each friction.
SPREAD = 0.1

TERMS = ("coulomb", "viscous", "rotor_inertia")


def tree() -> RobotModel:
    """Return a tree of every kind of joint, with a link fixed to a moving one, and a mimic."""
    return sdpid.load_robot(TREE_MIMIC)


def estimate_of(robot: RobotModel, terms: tuple[str, ...] = TERMS, **options: str) -> Estimate:
    """Return an estimate whose parameters are the truth of its samples."""
    theta = random_theta(robot, np.random.default_rng(3), terms)
    states = generic_states(robot, 60, 5)
    effort = full_regressor(robot, states, terms) @ theta
    samples = Samples(position=states[0], velocity=states[1], acceleration=states[2], effort=effort)
    problem = sdpid.build_problem(robot, samples, friction=terms, check_excitation=False, **options)  # type: ignore[arg-type]
    return Estimate.of_theta(problem, theta, method="sdp", status="optimal")


def draws_about(estimate: Estimate, count: int, seed: int = 0) -> Array:
    """Return parameters (count, p) spread about those of an estimate, all consistent."""
    rng = np.random.default_rng(seed)
    links = 10 * estimate.problem.robot.n_links
    bodies = estimate.problem.feasible.bodies(estimate.theta)
    changes = SPREAD * rng.standard_normal((count, *bodies.shape))
    friction = estimate.theta[links:]
    factors = np.exp(SPREAD * rng.standard_normal((count, len(friction))))
    return np.hstack([changed(bodies, changes).reshape(count, links), friction * factors])
