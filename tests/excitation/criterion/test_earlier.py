"""What earlier runs tell, in a plan's coordinates."""

from dataclasses import replace

import numpy as np
import pytest

import sdpid
from sdpid.errors import DataError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.noise_spectrum import NoiseSpectrum
from sdpid.excitation.criterion.earlier import earlier_information
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.base_parameters import structural_base
from tests.helpers.arm import ARM
from tests.helpers.data import make_samples, random_theta
from tests.helpers.robots import small_arm

TERMS = ("coulomb", "viscous")
FRICTION = FrictionModel.from_terms(TERMS, ARM.joint_names)
BASE = structural_base(ARM, FRICTION)
THETA = random_theta(ARM, np.random.default_rng(0))


def estimated(count: int = 300, terms: tuple[str, ...] = TERMS) -> Estimate:
    samples = make_samples(ARM, THETA, np.random.default_rng(1), count=count, noise=0.1)
    samples = replace(samples, time=np.arange(count) / 50.0)
    return sdpid.solve_wls(sdpid.build_problem(ARM, samples, friction=terms))


def scaled(J: np.ndarray, by: np.ndarray) -> np.ndarray:
    size = np.sqrt(np.diag(by))
    return J / np.outer(size, size)


def test_it_is_the_inverse_of_the_covariance() -> None:
    estimate = estimated()
    found = earlier_information(ARM, FRICTION, BASE, estimate)
    dense = np.linalg.inv(NoiseSpectrum.of(estimate.problem, estimate.theta).covariance)
    np.testing.assert_allclose(scaled(found.information, dense), scaled(dense, dense), atol=1e-6)
    np.testing.assert_allclose(BASE.matrix @ found.theta, estimate.base, atol=1e-9)
    np.testing.assert_allclose(found.noise.deviation, 0.1, rtol=0.15)


def test_terms_of_the_earlier_model_alone_are_marginalized() -> None:
    estimate = estimated(terms=(*TERMS, "offset"))
    found = earlier_information(ARM, FRICTION, BASE, estimate)
    C = NoiseSpectrum.of(estimate.problem, estimate.theta).covariance
    own = [estimate.problem.base.names.index(name) for name in BASE.names]
    dense = np.linalg.inv(C[np.ix_(own, own)])
    np.testing.assert_allclose(scaled(found.information, dense), scaled(dense, dense), atol=1e-6)


def test_of_terms_that_it_did_not_have_it_tells_nothing() -> None:
    model = FrictionModel.from_terms((*TERMS, "offset"), ARM.joint_names)
    base = structural_base(ARM, model)
    found = earlier_information(ARM, model, base, estimated())
    offsets = [base.names.index(name) for name in ("Fo1", "Fo2")]
    assert not found.information[offsets].any()
    assert any("Fo1" in note for note in found.notes)


def test_what_holds_an_estimate_and_recordings_do_too() -> None:
    class Result:
        estimate = estimated()

    whole = earlier_information(ARM, FRICTION, BASE, Result())
    np.testing.assert_array_equal(
        whole.information, earlier_information(ARM, FRICTION, BASE, Result.estimate).information
    )


def test_another_robot_is_refused() -> None:
    other = small_arm(3)
    model = FrictionModel.from_terms(TERMS, other.joint_names)
    with pytest.raises(DataError, match="the plan is for"):
        earlier_information(other, model, structural_base(other, model), estimated())
