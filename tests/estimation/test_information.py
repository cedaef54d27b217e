"""What the data do not show is named before anything is solved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sdpid._common.arrays import Array
from sdpid.errors import IdentifiabilityError
from sdpid.estimation.cluster_robust import ScoreBlocks
from sdpid.estimation.information import (
    UNDETERMINED,
    Excitation,
    information_root,
    information_rows,
)
from sdpid.estimation.posterior import Posterior
from sdpid.estimation.prior.prior import Prior
from sdpid.estimation.problem import build_problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.estimation.wls import solve_wls
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.friction.terms import SigmoidFriction
from sdpid.robot.model.model import RobotModel
from tests.helpers.data import make_samples, random_theta
from tests.helpers.robots import small_arm

ARM = small_arm(3)


def samples_of(robot: RobotModel = ARM, count: int = 60, seed: int = 0) -> Samples:
    rng = np.random.default_rng(seed)
    return make_samples(robot, random_theta(robot, rng), rng, count=count)


def still(samples: Samples, joint: int, **changes: Array) -> Samples:
    """Return the samples with a joint that never moves."""
    fields = {
        name: np.array(getattr(samples, name)) for name in ("position", "velocity", "acceleration")
    }
    for values in fields.values():
        values[:, joint] = 0.0
    return replace(samples, **fields, **changes)


def test_a_joint_that_stands_still_is_named() -> None:
    with pytest.raises(IdentifiabilityError) as info:
        build_problem(ARM, still(samples_of(), 2))
    message = str(info.value)
    assert "Fs3" in message
    assert "Fv3" in message
    assert "limit 1e-10" in message
    assert "moves" in message


def test_two_joints_that_move_as_one() -> None:
    """Equal speeds leave the frictions apart, since they act on different joints."""
    samples = samples_of()
    velocity = np.array(samples.velocity)
    velocity[:, 2] = velocity[:, 1]
    assert build_problem(ARM, replace(samples, velocity=velocity)).base.count > 0


def test_too_few_samples(denso: RobotModel) -> None:
    with pytest.raises(IdentifiabilityError, match=r"excite (\d+) of 48"):
        build_problem(denso, samples_of(denso, count=5))
    assert build_problem(denso, samples_of(denso, count=20)).excitation.weak() == ()


def test_a_coulomb_term_without_reversal_is_an_offset() -> None:
    samples = samples_of()
    forward = replace(samples, velocity=np.abs(np.asarray(samples.velocity)))
    with pytest.raises(IdentifiabilityError, match=r"Fo1 with Fs1|Fs1 with Fo1"):
        build_problem(ARM, forward, friction=("coulomb", "offset"))


def test_masked_rows_do_not_excite() -> None:
    samples = samples_of()
    mask = np.ones((60, 3), dtype=bool)
    mask[1:, 2] = False
    with pytest.raises(IdentifiabilityError):
        build_problem(ARM, replace(samples, mask=mask))


def test_weak_directions_are_listed_but_not_refused() -> None:
    samples = samples_of()
    slow = np.array(samples.velocity)
    slow[:, 2] *= 1e-6
    problem = build_problem(ARM, replace(samples, velocity=slow))
    # A column's length does not count, only its direction: Fv3 alone is still distinct.
    assert problem.excitation.condition_number < 1e4
    nearly = np.array(samples.velocity)
    nearly[:, 2] = 1.0 + 1e-6 * nearly[:, 2]
    problem = build_problem(ARM, replace(samples, velocity=nearly))
    (value, names), *rest = problem.excitation.weak()
    assert not rest
    assert 1e-10 < value < 1e-3
    assert set(names) == {"Fs3", "Fv3"}


def test_excitation_of_a_known_matrix() -> None:
    A = np.array([[2.0, 2.0, 0.0], [0.0, 1e-5, 0.0], [0.0, 0.0, 7.0]])
    excitation = Excitation.of(A, ("a", "b", "c"))
    np.testing.assert_allclose(excitation.column_norms, [2.0, 2.0, 7.0])
    assert excitation.singular_values[0] == pytest.approx(np.sqrt(2.0))
    ((value, names),) = excitation.weak()
    assert value == pytest.approx(5e-6 / np.sqrt(2.0), rel=1e-4)
    assert names == ("a", "b")
    assert excitation.condition_number == pytest.approx(np.sqrt(2.0) / value)


def test_a_column_of_zeros() -> None:
    excitation = Excitation.of(np.diag([1.0, 0.0]), ("a", "b"))
    assert excitation.condition_number == float("inf")
    assert excitation.weak() == ((0.0, ("b",)),)


@pytest.mark.parametrize("speed", [1e-2, 3e-5])
def test_errors_of_what_is_hardly_seen_are_large(speed: float) -> None:
    """A slow joint's viscous and sigmoid friction are nearly one column."""
    samples = samples_of(count=400)
    velocity = samples.velocity * [1.0, 1.0, speed]
    effort = np.random.default_rng(1).standard_normal(samples.effort.shape)
    samples = replace(samples, velocity=velocity, effort=effort)
    terms = ("viscous", SigmoidFriction(velocity=(0.3,) * 3))
    problem = build_problem(ARM, samples, friction=terms)
    found = problem.excitation
    assert UNDETERMINED < found.singular_values[-1] < 50.0 * speed**2
    expected = np.linalg.norm(found.root, axis=1)
    np.testing.assert_allclose(solve_wls(problem).standard_errors, expected, rtol=0.2)
    blocks = np.sqrt(np.diag(ScoreBlocks.of(problem).covariance))
    np.testing.assert_allclose(blocks, expected, rtol=0.2)


def test_what_nothing_shows_has_infinite_errors() -> None:
    samples = still(samples_of(), 2)
    prior = Prior(bodies=np.tile([1.0, *np.zeros(3), 0.1, 0.0, 0.1, 0.0, 0.0, 0.1], (3, 1)))
    problem = build_problem(ARM, samples, prior=prior)
    assert np.isfinite(solve_sdp(problem).standard_errors).all()
    estimate = solve_wls(replace(problem, prior=None))
    with pytest.raises(IdentifiabilityError, match="base parameter directions"):
        _ = estimate.standard_errors
    variance = Posterior.of(estimate).spread(problem.base.matrix)[0]
    np.testing.assert_array_equal(np.isinf(variance), problem.excitation.column_norms == 0.0)


def test_rows_of_an_information_have_no_column_where_it_has_none() -> None:
    X = np.random.default_rng(0).standard_normal((200, 40))
    X[:, [7, 23]], X[:, 30] = 0.0, X[:, 3]
    H = X.T @ X
    T = information_root(information_rows(H))
    assert T.shape[1] == 37
    np.testing.assert_allclose(T[[7, 23]], 0.0, atol=1e-12)
    np.testing.assert_allclose(T.T @ H @ T, np.eye(37), atol=1e-9)
