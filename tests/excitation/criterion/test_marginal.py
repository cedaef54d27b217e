"""Information of some parameters, and of a prior, against dense inverses."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sdpid
from sdpid.excitation.criterion.belief import (
    default_prior,
    information_of_rows,
    prior_information,
)
from sdpid.excitation.criterion.marginal import marginal
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.base_parameters import structural_base
from tests.helpers.arm import ARM
from tests.helpers.small_robots import URDFS

seeds = st.integers(0, 2**32 - 1)


@given(seeds, st.integers(1, 4), st.integers(0, 4))
def test_marginal_information_is_the_inverse_of_a_block(seed: int, k: int, rest: int) -> None:
    X = np.random.default_rng(seed).standard_normal((20, k + rest))
    J = X.T @ X
    kept = np.arange(k + rest) < k
    np.testing.assert_allclose(
        marginal(J, kept), np.linalg.inv(np.linalg.inv(J)[:k, :k]), rtol=1e-6, atol=1e-9
    )


def test_what_is_open_takes_nothing_with_it() -> None:
    J = np.diag([4.0, 0.0, 1.0])
    np.testing.assert_allclose(marginal(J, np.array([True, False, True])), np.diag([4.0, 1.0]))


@given(seeds)
def test_information_of_rows_is_the_inverse_of_a_covariance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    R = rng.standard_normal((12, 9)) * 10.0 ** rng.uniform(-2, 2, 9)
    B = rng.standard_normal((4, 9))
    dense = np.linalg.inv(B @ np.linalg.inv(R.T @ R) @ B.T)
    size = np.sqrt(np.diag(dense))
    found = information_of_rows(R, B)
    np.testing.assert_allclose(
        found / np.outer(size, size), dense / np.outer(size, size), atol=1e-5
    )


def test_a_prior_says_nothing_of_what_it_does_not_believe() -> None:
    friction = FrictionModel.from_terms(("coulomb", "viscous"), ARM.joint_names)
    base = structural_base(ARM, friction)
    bodies = np.tile([1.0, 0.1, 0.0, 0.0, 0.1, 0.0, 0.2, 0.0, 0.0, 0.2], (ARM.n_links, 1))
    rms = np.array([1.0, 2.0])
    of_links = base.kept < 10 * ARM.n_links
    without = prior_information(
        ARM, friction, base, sdpid.Prior(bodies=bodies, friction=False), rms
    )
    size = np.sqrt(np.diag(without)[of_links].max())
    assert np.all(np.abs(without[~of_links]) < 1e-9 * size)
    whole = prior_information(ARM, friction, base, sdpid.Prior(bodies=bodies), rms)
    assert np.all(np.linalg.eigvalsh(whole) > 0.0)
    doubled = prior_information(ARM, friction, base, sdpid.Prior(strength=2.0, bodies=bodies), rms)
    own = np.ix_(of_links, of_links)
    np.testing.assert_allclose(doubled[own], 2.0 * whole[own], rtol=1e-6, atol=1e-9)
    assert not prior_information(ARM, friction, base, False, rms).any()


@pytest.mark.parametrize("name", ["ur10_robot", "denso_vp6242", *URDFS])
def test_the_default_is_that_of_identify(name: str) -> None:
    robot = sdpid.load_robot(name)
    described = bool(np.any(robot.prior[:, 0] > 0.0))
    assert (default_prior(robot, None) is not None) == described
    assert default_prior(robot, False) is None
    assert default_prior(robot, True) == sdpid.Prior()
