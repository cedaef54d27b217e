"""What a run will buy: laws of the expected errors, and what the words say."""

import json
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sdpid
from sdpid._common.arrays import Array
from sdpid.excitation.criterion.belief import EarlierInformation, ExpectedNoise
from sdpid.excitation.criterion.rows import BaseRows
from sdpid.excitation.expected.expect import _kept_above, _posterior, _sums, expect, rehearse
from sdpid.excitation.expected.expected import Expected
from sdpid.excitation.expected.open_directions import OpenDirection, open_directions
from sdpid.experiment.trajectory.drawn import default_motion
from tests.helpers.robots import TREE_MIMIC, small_arm

ARM = small_arm(2)
TERMS = ("coulomb", "viscous")
BODIES = np.tile([1.0, 0.1, 0.0, 0.0, 0.1, 0.0, 0.2, 0.0, 0.0, 0.2], (2, 1))
PRIOR = sdpid.Prior(bodies=BODIES)
# Few examples: each is a run.
FEW = settings(max_examples=8, deadline=None)
factors = st.floats(0.1, 10.0)


@cache
def motion(periods: int = 1) -> sdpid.Trajectory:
    return replace(default_motion(ARM, 1, period=8.0, periods=periods), rate_hz=100.0)


def expected(periods: int = 1, **given: Any) -> Expected:
    given = {"friction": TERMS, "noise": 0.1, "prior": PRIOR, "repetitions": (1,)} | given
    return expect(ARM, motion(periods), **given)


@cache
def plain() -> Expected:
    return expected(prior=False)


def earlier(size: float, seed: int = 0) -> EarlierInformation:
    b = len(plain().base.names)
    X = np.random.default_rng(seed).standard_normal((b, b))
    noise = ExpectedNoise.white(np.array([0.1, 0.1]), 100.0)
    theta = rehearse(ARM, motion(), friction=TERMS, noise=0.1).theta
    return EarlierInformation(information=size * X @ X.T, theta=theta, noise=noise)


@FEW
@given(factors)
def test_errors_scale_with_the_noise(factor: float) -> None:
    # With noise well above the least weight of a joint, whose size does not scale.
    few, many = (expected(prior=False, noise=size, reading="periods") for size in (1.0, factor))
    np.testing.assert_allclose(many.standard_errors, factor * few.standard_errors, rtol=1e-6)


@pytest.mark.parametrize("times", [2, 5])
def test_averaging_periods_divides_the_variance(times: int) -> None:
    one, many = (expected(n, prior=False, reading="periods") for n in (1, times))
    np.testing.assert_allclose(many.standard_errors**2, one.standard_errors**2 / times, rtol=0.05)


def test_sums_of_runs_add_up_and_what_they_hide_is_not_promised() -> None:
    run = rehearse(ARM, motion(), friction=TERMS, noise=0.1, prior=False)
    own, B = _sums(run.spectrum), run.rows.base.matrix
    once, twice = (_posterior(run, times * own)[0].covariance(B) for times in (1, 2))
    np.testing.assert_allclose(twice, once / 2.0, rtol=1e-6)
    alike = np.eye(own.shape[1])
    alike[:, 2] = alike[:, 1] + 1e-9 * alike[:, 2]
    variance = _posterior(run, alike.T @ own @ alike)[0].spread(B)[0]
    np.testing.assert_array_equal(np.flatnonzero(np.isinf(variance)), [1, 2])
    # Nothing at all is known of a run that is not made, without a prior.
    assert np.isinf(_posterior(run, 0.0 * own)[0].spread(B)[0]).all()


def test_repetitions_are_what_longer_runs_have() -> None:
    found = expected(prior=False, repetitions=(1, 2, 4, 8))
    long = expected(4, prior=False)
    # What is extrapolated is what the longer run itself has.
    np.testing.assert_allclose(found.durations[2].standard_errors, long.standard_errors, rtol=0.02)
    late = found.durations[3].standard_errors / found.durations[2].standard_errors
    np.testing.assert_allclose(late, np.sqrt(0.5), rtol=0.1)
    assert found.durations[2].seconds == pytest.approx(long.seconds)


@FEW
@given(factors, st.integers(0, 2**16))
def test_earlier_runs_never_widen(size: float, seed: int) -> None:
    with_it = expected(prior=False, earlier=earlier(size, seed))
    assert np.all(with_it.standard_errors <= plain().standard_errors * (1.0 + 1e-6))
    assert np.all(np.isfinite(with_it.before))
    assert np.all(with_it.standard_errors <= with_it.before * (1.0 + 1e-6))


def test_a_prior_alone_is_what_is_left_of_a_run_that_tells_nothing() -> None:
    blind = expected(noise=1e9)
    np.testing.assert_allclose(blind.standard_errors, blind.before, rtol=1e-3)
    assert np.all(blind.prior_share > 0.99)
    assert len(blind.open_directions)
    sharp = expected(noise=1e-3)
    assert np.all(sharp.standard_errors < blind.standard_errors)
    assert not sharp.open_directions


def test_intervals_are_cut_off_at_declared_limits() -> None:
    found = expected(noise=1e3)
    own = [name.startswith("Fs") for name in found.base.names]
    assert np.all(found.lower[own] == 0.0)
    assert np.all(found.lower <= found.values)
    assert np.all(found.upper >= found.values)


def test_words_and_plain_values() -> None:
    found = expected(noise=None, friction=None, repetitions=(1, 3))
    text = " ".join(found.sentences())
    assert f"after {found.seconds:.3g} s" in text
    assert "before the run" in text
    content = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert len(content["base_parameters"]) == len(found.base.names)
    assert content["bands"][0]["share"] == pytest.approx(found.bands[0].share)
    assert found.base.names[0] in found.table().text()
    assert any("assumed" in note for note in found.notes)


@pytest.mark.parametrize("terms", [(), None, ("coulomb", "viscous", "tilt", "load")])
def test_every_joint_and_term_will_do(terms: Any) -> None:
    tree = sdpid.load_robot(TREE_MIMIC)
    trajectory = replace(default_motion(tree, 0, period=8.0, periods=1), rate_hz=100.0)
    found = expect(tree, trajectory, friction=terms, noise=0.1, repetitions=())
    # The weights of identify are not the best for white noise: a little may be lost.
    assert np.all(found.standard_errors <= 1.1 * found.before)
    assert found.friction.shape == (len(found.speeds), tree.n)
    json.dumps(found.to_dict(), allow_nan=False)


def test_it_is_what_simulated_runs_of_noise_scatter() -> None:
    """The same rows with noise drawn again and again: errors as wide as expected."""
    run = rehearse(ARM, motion(), friction=TERMS, noise=0.5, prior=False)
    found = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        noisy = replace(
            run.log, effort=run.log.effort + 0.5 * rng.standard_normal(run.log.effort.shape)
        )
        samples = sdpid.process(noisy, run.processing, progress=False)
        problem = sdpid.build_problem(
            ARM, samples, friction=run.problem.friction.terms, weighting="residual"
        )
        found.append(sdpid.solve_wls(problem).base)
    scatter: Array = np.std(found, axis=0, ddof=1)
    ratio = scatter / np.sqrt(np.diag(run.spectrum.covariance))
    assert 0.85 < np.median(ratio) < 1.15
    assert np.all((ratio > 0.7) & (ratio < 1.35))


def test_sums_over_a_run_have_the_errors_of_its_spectrum() -> None:
    """What is known of open speeds counts as stated, although a rehearsal leaves no residual."""
    run = rehearse(ARM, motion(), noise=0.1)
    b, weights = run.problem.base.count, run.spectrum.known
    assert len(weights) > b
    assert np.all(weights[b:] > 1e-2 * run.spectrum.size)
    errors = _posterior(run, _sums(run.spectrum))[0].errors
    found = np.diag(errors.root @ errors.scores @ errors.root.T)
    np.testing.assert_allclose(found, np.diag(run.spectrum.covariance), rtol=1e-5)


def test_bands_are_as_wide_as_those_of_simulated_identifications() -> None:
    """Also where two columns of friction tell only their sum, which limits keep from drifting."""
    terms = (sdpid.friction.Coulomb(), sdpid.friction.SigmoidFriction(velocity=0.01), "viscous")
    given = {"friction": terms, "noise": 0.5, "prior": PRIOR}
    run, found = rehearse(ARM, motion(), **given), expected(**given)
    W = run.rows.rows(*motion().sample())
    value = run.problem.base_of(run.theta)
    errors = []
    for seed in range(20):
        drawn = 0.5 * np.random.default_rng(seed).standard_normal(run.log.effort.shape)
        noisy = replace(run.log, effort=run.log.effort + drawn)
        samples = sdpid.process(noisy, run.processing, progress=False)
        covariance = run.problem.samples.covariance
        problem = sdpid.build_problem(
            ARM, replace(samples, covariance=covariance), friction=terms, prior=PRIOR
        )
        errors.append(W @ (sdpid.solve_sdp(problem).base - value))
    simulated = 1.96 * np.sqrt(np.mean(np.square(errors), axis=(0, 1)))
    ratio = found.bands[0].half_width / simulated
    assert np.all((ratio > 0.8) & (ratio < 1.5)), ratio


# What stays open, and why: by trial of other motions.


SMALL_ARM = small_arm(3)
ROWS = BaseRows.of(SMALL_ARM, TERMS)
TIME = np.arange(0.0, 20.0, 0.05)[:, None]
OMEGA = np.array([0.9, 1.3, 2.1])


def states(size: Array) -> tuple[Array, Array, Array]:
    angle = TIME * OMEGA
    return size * np.sin(angle), size * OMEGA * np.cos(angle), -size * OMEGA**2 * np.sin(angle)


def found(
    size: Array, *, density: float = 0.01, believed: float = 1.0, limits: Any = None
) -> tuple[OpenDirection, ...]:
    W = ROWS.rows(*states(size))
    return open_directions(
        ROWS,
        states(size),
        density=np.full(3, density),
        information=np.einsum("kjb,kjc->bc", W, W) / density,
        believed=believed * np.eye(ROWS.count),
        limits=limits,
    )


def test_a_rich_motion_leaves_nothing_open() -> None:
    assert found(np.array([1.5, 1.5, 1.5]), density=1e-6) == ()


def test_a_joint_that_hardly_moves_is_named() -> None:
    size = np.array([1.5, 1.5, 1e-3])
    directions = found(size)
    assert all(0.7 < each.told <= 1.0 for each in directions)
    assert any("Fv3" in each.parameters for each in directions)
    own = next(each for each in directions if each.parameters[0] == "Fv3")
    assert own.cause == "range"
    assert own.joint == SMALL_ARM.joint_names[2]


@pytest.mark.parametrize(("width", "says"), [(2e-3, "are reached"), (3.0, "stand in the way")])
def test_limits_are_named_where_they_are_reached(width: float, says: str) -> None:
    ends = {"lower": np.full(3, -width / 2.0), "upper": np.full(3, width / 2.0)}
    limits = SimpleNamespace(**ends, velocity=np.ones(3), acceleration=np.ones(3))
    directions = found(np.array([1.5, 1.5, 1e-3]), limits=limits)
    own = [each for each in directions if each.joint == SMALL_ARM.joint_names[2]]
    assert any(says in each.words for each in own)


def test_without_beliefs_weak_directions_are_open() -> None:
    directions = found(np.array([1.5, 1.5, 1e-5]), believed=0.0)
    assert directions
    assert all("nothing was known before" in each.words for each in directions)


def test_rounding_of_what_is_hardly_shown_is_no_error() -> None:
    # Nearly one direction, and by rounding a negative eigenvalue of -1e-8.
    covariance = np.array([[1.0, -1.0 - 1e-8], [-1.0 - 1e-8, 1.0]])
    kept = _kept_above(np.array([-1.0, -1.0]), covariance)
    assert np.all(np.diag(kept) < 1.0)
