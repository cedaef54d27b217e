"""What a robot is taken to be before a run."""

import numpy as np

import sdpid
from sdpid.excitation.criterion.nominal import nominal_bodies, nominal_theta
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.inertia import margin
from tests.helpers.robots import small_arm

ARM = small_arm(3)
RNG = np.random.default_rng(0)
STATES = tuple(RNG.standard_normal((50, 3)) for _ in range(3))


def test_described_bodies_are_made_possible() -> None:
    robot = sdpid.load_robot("ur10_robot")
    bodies, notes = nominal_bodies(robot)
    assert notes == ()
    known = robot.prior[:, 0] > 0.0
    np.testing.assert_allclose(bodies[known, 0], robot.prior[known, 0])
    assert np.all(margin(bodies, "pseudo_inertia") > 0.0)


def test_without_masses_some_are_assumed_and_told() -> None:
    bodies, notes = nominal_bodies(ARM)
    assert not ARM.prior.any()
    assert np.all(bodies[:, 0] > 0.0)
    assert "no masses" in notes[0]
    assert np.all(margin(bodies, "pseudo_inertia") > 0.0)


def test_friction_is_of_a_usual_size_and_other_terms_are_zero() -> None:
    friction = FrictionModel.from_terms(("coulomb", "viscous", "offset"), ARM.joint_names)
    theta, _ = nominal_theta(ARM, friction, *STATES)
    coulomb, viscous, offset = theta[-9:].reshape(3, 3)
    assert np.all(coulomb > 0.0)
    assert np.all(viscous > 0.0)
    assert not offset.any()
    faster, _ = nominal_theta(ARM, friction, STATES[0], 2.0 * STATES[1], STATES[2])
    assert np.all(faster[-6:-3] / faster[-9:-6] < viscous / coulomb)
