"""Purposes: which functions of the base parameters count."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sdpid.errors import DataError
from sdpid.excitation.criterion.purpose import PURPOSES, effort_functionals, purpose_of
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.base_parameters import structural_base
from tests.helpers.refusals import refuses
from tests.helpers.robots import small_arm
from tests.helpers.small_robots import SMALL

ARM = small_arm(3)
FRICTION = FrictionModel.from_terms(("coulomb", "viscous"), ARM.joint_names)
BASE = structural_base(ARM, FRICTION)
RNG = np.random.default_rng(0)
STATES = tuple(RNG.standard_normal((40, 3)) for _ in range(3))
X = RNG.standard_normal((200, BASE.count))
INFORMATION = X.T @ X


@pytest.mark.parametrize("name", PURPOSES)
def test_more_information_never_widens(name: str) -> None:
    purpose = purpose_of(name, ARM, FRICTION, BASE, motion=STATES)
    before = purpose.covariance(INFORMATION)
    after = purpose.covariance(INFORMATION + np.outer(X[0], X[0]))
    assert np.linalg.eigvalsh(before - after).min() > -1e-12 * np.trace(before)


@given(st.floats(0.01, 100.0))
def test_covariances_scale(factor: float) -> None:
    purpose = purpose_of("torque", ARM, FRICTION, BASE, motion=STATES)
    np.testing.assert_allclose(
        purpose.covariance(factor * INFORMATION), purpose.covariance(INFORMATION) / factor
    )


def test_all_and_friction_are_blocks_of_the_covariance() -> None:
    C = np.linalg.inv(INFORMATION)
    np.testing.assert_allclose(
        purpose_of("all", ARM, FRICTION, BASE).covariance(INFORMATION), C, atol=1e-12
    )
    own = BASE.kept >= 10 * ARM.n_links
    friction = purpose_of("friction", ARM, FRICTION, BASE)
    np.testing.assert_allclose(friction.covariance(INFORMATION), C[np.ix_(own, own)], atol=1e-12)


def test_a_payload_is_the_last_link_with_all_else_known() -> None:
    purpose = purpose_of("payload", ARM, FRICTION, BASE)
    columns = BASE.matrix[:, 10 * ARM.n_links - 10 : 10 * ARM.n_links]
    assert purpose.directions.shape[1] == np.linalg.matrix_rank(columns)
    # Knowing all else is knowing more.
    others = np.linalg.inv(INFORMATION)
    D = purpose.directions
    marginal = np.linalg.pinv(D) @ others @ np.linalg.pinv(D).T
    assert np.linalg.eigvalsh(marginal - purpose.covariance(INFORMATION)).min() > -1e-12


def test_torque_is_the_mean_variance_of_efforts() -> None:
    scale = np.array([1.0, 2.0, 3.0])
    L = effort_functionals(ARM, FRICTION, BASE, *STATES, scale=scale)
    C = np.linalg.inv(INFORMATION)
    W = ARM.regressor(*STATES)
    W = np.concatenate([W, FRICTION.columns(STATES[1], STATES[2])], axis=2)[:, :, BASE.kept]
    variance = np.einsum("kjb,bc,kjc->kj", W, C, W) / scale**2
    np.testing.assert_allclose(np.trace(L @ C @ L.T), variance.mean())


def test_gravity_asks_nothing_of_friction() -> None:
    purpose = purpose_of("gravity", ARM, FRICTION, BASE)
    assert purpose.kind == "sum"
    assert not purpose.functionals[:, BASE.kept >= 10 * ARM.n_links].any()


def test_gravity_counts_all_around_where_the_description_has_no_limits() -> None:
    robot = SMALL["without_limits"].model
    base = structural_base(robot, none := FrictionModel.from_terms((), robot.joint_names))
    variances = purpose_of("gravity", robot, none, base).covariance(np.eye(base.count))
    assert np.linalg.matrix_rank(variances, tol=1e-6) == 4  # mx and mz of two links


def test_wrong_purposes_are_refused() -> None:
    refuses(DataError, "use one of", purpose_of, "speed", ARM, FRICTION, BASE)
    refuses(DataError, "give the motion", purpose_of, "torque", ARM, FRICTION, BASE)
    none = FrictionModel.from_terms((), ARM.joint_names)
    with pytest.raises(DataError, match="no friction terms"):
        purpose_of("friction", ARM, none, structural_base(ARM, none))
    upright = small_arm(1)
    terms = FrictionModel.from_terms(("viscous",), upright.joint_names)
    with pytest.raises(DataError, match="'gravity', and none of the robot's 2 base parameters"):
        purpose_of("gravity", upright, terms, structural_base(upright, terms))
