"""Friction of draws is that of single robots, at the cost of one."""

import numpy as np
import pytest

import sdpid
from sdpid._common.arrays import Array
from sdpid.estimation.estimate import Estimate
from sdpid.friction import Coulomb, SigmoidFriction, Viscous
from sdpid.output.robots.joint_friction import joint_attributes
from sdpid.output.robots.mjcf import PLACES
from sdpid.output.samples.drawn_friction import drawn_attributes
from sdpid.robot.friction.term import FrictionTerm
from tests.helpers.data import full_regressor, random_theta
from tests.helpers.robots import small_arm

ARM = small_arm(2)
ROUNDING = 1e-9

Terms = tuple[str | FrictionTerm, ...]
TERMS: dict[str, Terms] = {
    "places for all": ("coulomb", "viscous", "rotor_inertia"),
    "curves": (Coulomb(width=0.1), SigmoidFriction(velocity=0.5), Viscous()),
    "offsets": ("coulomb", "viscous", "offset"),
}


def made(terms: Terms, friction: Array, links: Array, noise: float) -> Estimate:
    """Return an estimate with its own samples, of the same motion whatever the friction."""
    rng = np.random.default_rng(2)
    q, v, a = rng.uniform(-2.0, 2.0, (3, 300, 2))
    theta = np.concatenate([links, friction])
    effort = full_regressor(ARM, (q, v, a), terms) @ theta
    effort = effort + noise * rng.standard_normal(effort.shape)
    samples = sdpid.Samples(position=q, velocity=v, acceleration=a, effort=effort)
    problem = sdpid.build_problem(ARM, samples, friction=terms, check_excitation=False)
    return Estimate.of_theta(problem, theta, method="sdp", status="optimal")


@pytest.mark.parametrize("terms", TERMS.values(), ids=TERMS)
def test_a_draw_has_the_attributes_of_a_robot_of_its_own(terms: Terms) -> None:
    """Of exact data: what the estimate leaves unexplained is nothing for either."""
    rng = np.random.default_rng(5)
    theta = random_theta(ARM, rng, terms)
    links, friction = theta[:20], theta[20:]
    estimate = made(terms, friction, links, 0.0)
    draws = [friction * rng.uniform(0.5, 1.5, len(friction)) for _ in range(4)]
    thetas = np.array([np.concatenate([links, each]) for each in draws])
    found = drawn_attributes(estimate.problem, estimate.theta, thetas, PLACES, "robots")
    for k, draw in enumerate(draws):
        own = made(terms, draw, links, 0.0)
        expected = joint_attributes(own.problem, own.theta, PLACES, "robot").values
        for kind, values in found.items():
            for j, joint in enumerate(ARM.joint_names):
                assert abs(values[k, j] - expected[joint][PLACES[kind]]) <= ROUNDING


@pytest.mark.parametrize("terms", TERMS.values(), ids=TERMS)
def test_the_estimate_itself_is_among_them(terms: Terms) -> None:
    rng = np.random.default_rng(6)
    theta = random_theta(ARM, rng, terms)
    estimate = made(terms, theta[20:], theta[:20], 0.05)
    found = drawn_attributes(estimate.problem, theta, theta[None], PLACES, "robots")
    expected = joint_attributes(estimate.problem, theta, PLACES, "robot").values
    assert {PLACES[kind] for kind in found} == set(expected["joint_1"])
    for kind, values in found.items():
        for j, joint in enumerate(ARM.joint_names):
            assert abs(values[0, j] - expected[joint][PLACES[kind]]) <= ROUNDING
