"""Recursive estimates against those of all samples, weighted by their age."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid import RecursiveEstimator, build_problem
from sdpid._common.arrays import Array
from sdpid.errors import DataError, IdentifiabilityError
from sdpid.estimation import recursive as streaming
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem, describe
from tests.helpers.arm import ARM, LIGHT, arm_problem
from tests.helpers.data import make_samples, random_covariance, random_theta
from tests.helpers.refusals import refuses
from tests.helpers.robots import small_arm

RNG = np.random.default_rng(11)
THETA = random_theta(ARM, RNG)
SIGMA = random_covariance(RNG, 2)
START = build_problem(ARM, make_samples(ARM, THETA, RNG, count=90, noise=0.05))
STATE = RNG.bit_generator.state

# Sums of products in another order.
ROUNDING = 1e-9


@pytest.fixture(autouse=True)
def _same_numbers_in_every_test() -> None:
    RNG.bit_generator.state = STATE


def measured(theta: Array = THETA, count: int = 90, **fields: Any) -> sdpid.Samples:
    return make_samples(ARM, theta, RNG, count=count, noise=0.05, **fields)


def pieces(samples: sdpid.Samples, *cuts: int) -> list[sdpid.Samples]:
    return [samples.between(*ends) for ends in pairwise((0, *cuts, samples.n_samples))]


def streamed(start: Problem, others: list[sdpid.Samples], **options: Any) -> RecursiveEstimator:
    """Return a stream that has taken pieces."""
    stream = RecursiveEstimator(start, **options)
    for piece in others:
        stream.update(piece)
    return stream


def same_cost(found: Problem, expected: Problem) -> None:
    """Assert that two compressed costs are one function."""
    scale = np.sqrt(np.diagonal(expected.A.T @ expected.A))
    for mine, theirs in (
        (found.A.T @ found.A / scale, expected.A.T @ expected.A / scale),
        (found.A.T @ found.rhs / scale, expected.A.T @ expected.rhs / scale),
    ):
        np.testing.assert_allclose(mine, theirs, atol=ROUNDING * np.abs(theirs).max())
    assert found.floor == pytest.approx(expected.floor, rel=ROUNDING)


@pytest.mark.parametrize("weighting", ["gls", "gls_per_sample"])
def test_pieces_give_the_problem_of_all_samples(weighting: Any) -> None:
    mask = RNG.random((90, 2)) < 0.8
    covariance = SIGMA if weighting == "gls" else random_covariance(RNG, 2, 90)
    samples = measured(covariance=covariance, mask=mask)
    whole = build_problem(ARM, samples, weighting=weighting)
    first, *others = pieces(samples, 40, 43, 80)
    stream = streamed(build_problem(ARM, first, weighting=weighting), others)
    same_cost(stream.problem, whole)
    assert stream.problem.n_rows == whole.n_rows
    found, expected = stream.solve(), sdpid.solve_sdp(whole)
    assert found.cost == pytest.approx(expected.cost, rel=1e-6)
    scale = np.abs(expected.base).max()
    np.testing.assert_allclose(found.base, expected.base, atol=1e-5 * scale)


def test_what_is_forgotten_no_longer_determines_anything() -> None:
    stream = RecursiveEstimator(START, memory=0.01)
    stream.update(measured(count=20, time=np.arange(20.0)))
    refuses(IdentifiabilityError, "do not excite", stream.solve)


def test_weights_are_powers_of_the_forgetting_factor() -> None:
    samples = measured(covariance=SIGMA)
    factor = 0.97
    ages = np.arange(89, -1, -1.0)
    # The start's samples all count as the newest.
    ages[:35] = 55.0
    # A weight is a covariance divided by it.
    aged = SIGMA / factor ** ages[:, None, None]
    whole = build_problem(ARM, replace(samples, covariance=aged), weighting="gls_per_sample")
    first, *others = pieces(samples, 35, 36, 77)
    same_cost(streamed(build_problem(ARM, first), others, forgetting=factor).problem, whole)


def test_memory_is_forgetting_in_time() -> None:
    samples = measured(covariance=SIGMA, time=np.arange(90) * 0.02 + 5.0)
    first, *others = pieces(samples, 35, 36, 77)
    start, factor = build_problem(ARM, first), float(np.exp(-0.02 / 0.5))
    by_number = streamed(start, others, forgetting=factor)
    # By number the start ended one sample before the first that comes in, by time at that one.
    root = np.sqrt(factor)
    faded = replace(start, A=root * start.A, rhs=root * start.rhs, floor=factor * start.floor)
    by_time = streamed(faded, others, memory=0.5)
    same_cost(by_time.problem, by_number.problem)


@pytest.mark.parametrize("consistency", ["pseudo_inertia", "spatial_inertia"])
def test_every_solve_is_proven_and_quick_ones_are_not_full(
    consistency: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    full: list[Problem] = []

    def counted(problem: Problem) -> Estimate:
        full.append(problem)
        return sdpid.solve_sdp(problem)

    monkeypatch.setattr(streaming, "solve_sdp", counted)
    # Constraints are active, so that the proof is no triviality.
    problem, rng = arm_problem(LIGHT, consistency=consistency), np.random.default_rng(11)
    stream = RecursiveEstimator(problem, forgetting=0.99)
    for number in range(8):
        stream.update(make_samples(ARM, THETA, rng, count=15, noise=1.0))
        found = stream.solve()
        assert found.status == "optimal"
        assert sdpid.certify(found).passed
        assert ("any point" in found.message) == (number > 0)
        assert found.cost == pytest.approx(sdpid.solve_sdp(stream.problem).cost, rel=1e-6)
    assert len(full) == 1
    # The first solves go without the bounds of moments, and later ones overstep them.
    if consistency == "pseudo_inertia":
        assert np.any(stream._bounds_included & ~problem.feasible.bounded)


def test_what_is_not_proven_is_solved_in_full(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = RecursiveEstimator(arm_problem(LIGHT))
    stream.solve()
    lost = type("Lost", (streaming.Attempts,), {"proven": False})
    monkeypatch.setattr(streaming, "Attempts", lost)
    found = stream.solve()
    assert "any point" not in found.message
    assert sdpid.certify(found).passed


@pytest.mark.parametrize("prior", [sdpid.Prior(kind="euclidean"), sdpid.Prior()])
def test_a_prior_stays(prior: sdpid.Prior) -> None:
    samples = measured(count=40, covariance=SIGMA)
    robot = replace(ARM, prior=THETA[:20].reshape(2, 10))
    first, second, third = pieces(samples, 10, 25)
    stream = RecursiveEstimator(build_problem(robot, first, prior=prior))
    for piece in (second, third):
        stream.update(piece)
        assert sdpid.certify(stream.solve()).passed
    assert stream.problem.prior is not None


def test_the_rows_of_a_stream_are_gone(tmp_path: Path) -> None:
    stream = RecursiveEstimator(build_problem(ARM, measured(covariance=SIGMA)))
    stream.update(measured(count=30))
    estimate = stream.solve()
    with pytest.raises(DataError, match="not kept"):
        _ = estimate.standard_errors
    refuses(DataError, "not kept", sdpid.confidence_intervals, estimate)
    certificate = sdpid.certify(estimate)
    stated = certificate.to_dict()
    assert stated["origin"]["rows_sha256"] is None
    certificate.to_json(tmp_path / "c.json")
    assert sdpid.verify(tmp_path / "c.json").passed
    # What is predicted for other samples is.
    other = measured(count=20)
    assert sdpid.validate(estimate, other).rows.sum() == 40
    assert estimate.problem.predict(estimate.base, other).shape == (20, 2)
    assert describe(estimate.problem)["samples"] == 120
    assert describe(estimate.problem)["rows_used"] == 240


def test_forgetting_is_a_factor_and_memory_a_time() -> None:
    for forgetting in (0.0, -0.5, 1.0001, float("nan")):
        refuses(DataError, "forgetting", RecursiveEstimator, START, forgetting=forgetting)
    for memory in (0.0, -1.0, float("nan"), float("inf")):
        refuses(DataError, "memory", RecursiveEstimator, START, memory=memory)
    refuses(DataError, "one of them", RecursiveEstimator, START, memory=1.0, forgetting=0.9)


def test_what_does_not_fit_is_refused_and_changes_nothing() -> None:
    samples = measured(covariance=SIGMA)
    start = build_problem(ARM, samples)
    stream = RecursiveEstimator(start, memory=1.0)
    other = small_arm(3)
    wrong = make_samples(other, random_theta(other, RNG), RNG)
    refuses(DataError, r"have 3 joints, the robot .* has 2", stream.update, wrong)
    names = tuple(reversed(ARM.joint_names))
    refuses(DataError, "rename or reorder", stream.update, measured(joint_names=names))
    refuses(DataError, "no time", stream.update, measured())
    with pytest.raises(DataError, match=r"goes back by 0\.01"):
        stream.update(measured(count=2, time=np.array([0.0, -0.01])))
    same_cost(stream.problem, start)
    stream.update(measured(count=2, time=np.array([3.0, 3.01])))
    refuses(DataError, "goes back", stream.update, measured(count=2, time=np.array([3.0, 3.02])))
    with pytest.raises(DataError, match="no sum over rows"):
        RecursiveEstimator(build_problem(ARM, samples, weighting="eq9"))
    per_sample = build_problem(ARM, samples, weighting="gls_per_sample")
    refuses(DataError, "no covariance", RecursiveEstimator(per_sample).update, measured())


def test_a_covariance_that_fails_halfway_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    # A few samples a chunk.
    monkeypatch.setattr("sdpid.estimation.compression.rows.CHUNK_BYTES", 1 << 12)
    start = build_problem(ARM, measured(covariance=SIGMA)).with_origin(weighting="gls_per_sample")
    stream, other = (RecursiveEstimator(start, memory=1.0) for _ in range(2))
    piece = measured(covariance=random_covariance(RNG, 2, 90), time=0.01 * np.arange(90))
    # The last sample's has no inverse.
    singular = np.concatenate([piece.covariance[:-1], np.zeros((1, 2, 2))])
    refuses(DataError, "covariance", stream.update, replace(piece, covariance=singular))
    for each in (stream, other):
        each.update(piece)
    same_cost(stream.problem, other.problem)
    assert stream.problem.n_rows == other.problem.n_rows
