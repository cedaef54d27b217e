"""Errors of estimates against dense formulas and against what simulated estimates scatter."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import t

import sdpid
from sdpid import Constraints, Prior, Samples, build_problem, solve_sdp, solve_wls
from sdpid._common.arrays import Array, generator
from sdpid.assurance.intervals.intervals import Intervals
from sdpid.errors import DataError, IdentifiabilityError
from sdpid.estimation import information, motion_noise, noise_spectrum
from sdpid.estimation.cluster_robust import ScoreBlocks
from sdpid.estimation.compression.covariance import WEIGHTINGS, Weighting
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.error_source import ErrorSource
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.information import UNDETERMINED, Excitation
from sdpid.estimation.motion_noise import friction_bias, landings_used, with_motion_bias
from sdpid.estimation.noise_spectrum import NoiseSpectrum
from sdpid.estimation.posterior import Groups, Posterior, gain_errors
from sdpid.estimation.problem import Problem
from sdpid.experiment.plant.legged.simulate import LeggedRun, Sensors
from sdpid.experiment.preparation.prepare import samples_of
from sdpid.experiment.recording.gaps import retimed, told_clock
from sdpid.robot.friction.terms import SigmoidFriction
from tests.experiment.test_clock import log as jittering
from tests.helpers import world
from tests.helpers.arm import ARM, BODIES, CONDITIONS, THETA, arm_problem
from tests.helpers.data import FRICTION, make_samples, random_covariance, random_theta, raw_rows
from tests.helpers.legged import quadruped
from tests.helpers.motions import sines, slow_motion
from tests.helpers.refusals import refuses
from tests.helpers.robots import small_arm
from tests.helpers.world import gauss_markov


def same_covariance(found: Array, expected: Array) -> None:
    """Compare covariances by the deviations of one."""
    size = np.sqrt(np.diag(expected))
    np.testing.assert_allclose((found - expected) / np.outer(size, size), 0.0, atol=1e-6)


class Known:
    """Errors of unit variance: the weights are right."""

    def __init__(self, root: Array) -> None:
        self.root, self.scores = root, np.eye(root.shape[1])

    def freedom(self, directions: Array) -> Array:
        return np.full(len(directions), 10.0)


@pytest.mark.parametrize("kind", ["pullback", "entropic"])
def test_with_right_weights_it_is_bayes(kind: str) -> None:
    samples = make_samples(ARM, THETA, np.random.default_rng(1), count=40, noise=0.1)
    problem = build_problem(ARM, samples, prior=Prior(bodies=BODIES, kind=kind))  # type: ignore[arg-type]
    estimate = solve_sdp(problem)
    rows = [term.curvature_rows(estimate.theta) for term in problem.prior.terms]
    G = problem.A @ problem.base.matrix
    expected = np.linalg.inv(G.T @ G + sum(R.T @ R for R in rows))
    right = Posterior(estimate, Known(np.linalg.inv(problem.A)))
    B = problem.base.matrix
    size = np.sqrt(np.diag(B @ expected @ B.T))
    same_covariance(right.covariance(B), B @ expected @ B.T)
    variance, share, freedom = right.spread(B)
    np.testing.assert_allclose(np.sqrt(variance), size, rtol=1e-6)
    # The prior's part of the variance is known, so that a function has the more freedom.
    np.testing.assert_allclose(freedom, 10.0 / (1.0 - share) ** 2)


def test_what_equations_fix_has_no_error() -> None:
    estimate = sdpid.solve_sdp(arm_problem(*CONDITIONS["fixed"]))
    names = estimate.problem.base.theta_names
    unit = np.eye(len(names))
    fixed, free = (Posterior.of(estimate).spread(unit[[names.index(n)]])[0] for n in ("Fv1", "Fv2"))
    assert fixed[0] <= 1e-12 * free[0]


def test_unseen_directions_are_open_up_to_limits() -> None:
    """Friction of a joint without effort: neither data nor prior say a thing."""
    samples, _ = world.samples(ARM, 3, count=30, noise=0.1)
    mask = np.tile([True, False], (30, 1))
    prior = sdpid.Prior(bodies=BODIES, friction=False)
    masked = replace(samples, mask=mask)
    problem = build_problem(ARM, masked, prior=prior, weighting="residual")
    found = sdpid.confidence_intervals(
        sdpid.solve_sdp(problem), method="gauss_markov", parameters=("Fv1", "Fv2", "xxr2", "zz2")
    )
    assert found.label[0] == "from data"
    assert found.label[1] == "from the prior"
    assert (found.lower[1], found.upper[1]) == (0.0, problem.constraints.friction_max)
    assert np.isfinite(found.upper).all()


# ---- Standard errors that hold what they promise, on white and on filtered noise.


BASE = world.problem(ARM).base
RUNS = 60

# Of RUNS × 12 parameters at 95 %, correlated within a run: the share that is covered spreads by
# some 0.02, and small-sample errors are a little short.
COVERED = (0.89, 0.99)


@pytest.mark.parametrize("weighting", ["gls", "eq9", "eq18", "residual"])
@pytest.mark.parametrize("size", [(1.0, 2.0), (5.0, 0.1)], ids=["right", "wrong"])
def test_white_noise_is_covered(weighting: Weighting, size: tuple[float, float]) -> None:
    """By a wrong weight, too: the sandwich needs no true covariance, only independent blocks."""

    rng, inside = np.random.default_rng(0), []
    for _ in range(RUNS):
        theta = random_theta(ARM, rng)
        noise, sigma = size * rng.standard_normal((300, 2)), np.diag([1.0, 4.0])
        samples = make_samples(ARM, theta, rng, count=300, noise=noise, covariance=sigma)
        fit = solve_wls(build_problem(ARM, samples, base=BASE, weighting=weighting))
        error = np.abs(fit.base - fit.problem.base_of(theta))
        inside.append(error <= 1.96 * fit.standard_errors)
    assert COVERED[0] <= np.mean(inside) <= COVERED[1]


def test_what_holds_an_estimate_back_is_not_noise() -> None:
    """Errors are those of the fit: pulling the estimate away from it adds none."""
    samples, theta = world.samples(ARM, 5, count=400, noise=0.1)
    held = Constraints(mass_max=0.1 * float(theta[:20:10].min()))
    problem = build_problem(ARM, samples, weighting="residual", base=BASE, constraints=held)
    free, estimate = solve_wls(problem), solve_sdp(problem)
    # It is held back by many times what noise moves it.
    assert np.max(np.abs(estimate.base - free.base) / free.standard_errors) > 30.0
    np.testing.assert_allclose(estimate.standard_errors, free.standard_errors, rtol=1e-6)
    error = np.abs(free.base - problem.base_of(theta))
    assert np.mean(error <= 1.96 * estimate.standard_errors) > 0.8


@pytest.mark.parametrize("weighting", WEIGHTINGS)
@pytest.mark.parametrize("block", [10, 150], ids=["blocks", "too short for blocks"])
def test_there_is_one_covariance(weighting: Weighting, block: int) -> None:
    sigma = np.diag([1.0, 4.0])
    samples, _ = world.samples(ARM, 6, count=200, noise=1.0, covariance=sigma, block=block)
    estimate = solve_wls(build_problem(ARM, samples, weighting=weighting, base=BASE))
    errors = NoiseSpectrum.of(estimate.problem)
    for level in (0.8, 0.95):
        found = gauss_markov(estimate, level=level)
        np.testing.assert_allclose(found.estimate, estimate.base, rtol=1e-12)
        quantiles = t.ppf(0.5 + 0.5 * level, errors.freedom(errors.root))
        half = 0.5 * (found.upper - found.lower)
        np.testing.assert_allclose(half, quantiles * estimate.standard_errors, rtol=1e-9)


# ---- Standard errors from the residuals' spectrum, against sums in time and simulated scatter.


DEVIATIONS = np.array([0.1, 0.3])
Noise = Callable[[np.random.Generator, int], Array]


def moving(count: int, noise: Array, **fields: object) -> sdpid.Samples:
    """Return samples of a slow motion that does not repeat itself."""
    states, rng = slow_motion(count, 40.0), np.random.default_rng(0)
    return make_samples(ARM, THETA, rng, states=states, noise=noise, **fields)


def white_noise(rng: np.random.Generator, count: int) -> Array:
    return DEVIATIONS * rng.standard_normal((count, 2))


def red(rng: np.random.Generator, count: int) -> Array:
    """Noise with a memory of ten samples, as long as the fastest motion."""
    long = rng.standard_normal((count + 100, 2))
    return np.asarray(DEVIATIONS * lfilter([np.sqrt(0.19)], [1.0, -0.9], long, axis=0)[100:])


@pytest.mark.parametrize("count", [60, 61])
@pytest.mark.parametrize("together", [1 << 26, 20_000])
def test_frequencies_hold_what_the_rows_hold(
    count: int, together: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(noise_spectrum, "_TOGETHER", together)
    rng = np.random.default_rng(1)
    mask = rng.uniform(size=(count, 2)) > 0.1
    samples = make_samples(ARM, THETA, rng, count=count, noise=0.1, mask=mask, starts=(0, 25))
    problem = build_problem(ARM, samples, base=BASE)
    found = NoiseSpectrum.of(problem)
    np.testing.assert_allclose(found.information(), problem.A.T @ problem.A, rtol=1e-9, atol=1e-9)
    W, effort, _ = raw_rows(problem)
    residual = (effort - W @ sdpid.solve_wls(problem).base)[mask]
    assert found.power.sum() == pytest.approx(residual @ residual)
    assert found.room.sum() == pytest.approx(mask.sum() - BASE.count, rel=0.05)


@pytest.mark.parametrize("noise", [white_noise, red], ids=["white", "red"])
@pytest.mark.parametrize("count", [200, 1200])
def test_errors_are_as_large_as_stated(noise: Noise, count: int) -> None:
    rng = np.random.default_rng(2)
    runs, held, squares = 40, [], []
    for _ in range(runs):
        problem = build_problem(ARM, moving(count, noise(rng, count)), base=BASE)
        fit = sdpid.solve_wls(problem)
        truth = problem.base_of(THETA)
        found = gauss_markov(fit)
        held.append(found.contains(truth).mean())
        squares.append(
            np.mean((fit.base - truth) ** 2 / np.diag(NoiseSpectrum.of(problem).covariance))
        )
    error = np.std(held) / np.sqrt(runs)
    assert 0.92 - 2.0 * error < np.mean(held) < 0.98 + 2.0 * error
    assert 0.7 < np.median(squares) < 1.5


def test_records_too_short_for_blocks_have_satterthwaites_freedom() -> None:
    noise = white_noise(np.random.default_rng(4), 60)
    problem = build_problem(ARM, moving(60, noise, block=20), base=BASE)
    refuses(DataError, "3 blocks of 20 samples, at least 8", ScoreBlocks.of, problem)
    found = NoiseSpectrum.of(problem)
    freedom = found.freedom(found.root)
    assert np.all((freedom > 2.0) & (freedom < problem.n_rows - BASE.count))
    moved = np.linalg.solve(found.information(), np.eye(BASE.count)[3])
    parts = np.array([np.sum((R[:, :-1] @ moved[own]) ** 2) for own, R in found.groups])
    parts *= found.density
    assert found.covariance[3, 3] == pytest.approx(parts.sum())
    assert freedom[3] == pytest.approx(parts.sum() ** 2 / np.sum(parts**2 / found.room))


@pytest.mark.parametrize("size", [1.0, 4.0])
def test_a_believed_spectrum_takes_the_place_of_the_residuals(size: float) -> None:
    samples = moving(200, white_noise(np.random.default_rng(1), 200))
    problem = build_problem(ARM, samples, friction=FRICTION)
    found = NoiseSpectrum.of(problem)
    believed = NoiseSpectrum.of(problem, believed=lambda at: np.full((2, len(at)), size))
    np.testing.assert_array_equal(believed.information(), found.information())
    np.testing.assert_allclose(believed.density, size)
    np.testing.assert_allclose(believed.densities, size)
    same_covariance(believed.covariance, size * np.linalg.inv(problem.A.T @ problem.A))


# ---- Errors of gains against finite differences, and against estimates by gains that are off.


# Correlated, and with a common part.
RELATIVE = np.array([[9.0, 4.0], [4.0, 25.0]]) * 1e-4
GAINS = sdpid.DriveGains(
    joint_names=ARM.joint_names,
    gains=[10.0, 4.0],
    covariance=RELATIVE * np.outer([10.0, 4.0], [10.0, 4.0]),
)


def scaled_samples(off: Array, *, noise: float = 0.1, seed: int = 1, count: int = 60) -> Samples:
    """Return samples whose efforts were made by gains that are off by shares."""
    samples = make_samples(ARM, THETA, np.random.default_rng(seed), count=count, noise=noise)
    return replace(samples, effort=samples.effort * (1.0 + off), gains=GAINS)


def gain_slopes(estimate: Estimate, functions: Array, groups: Groups = "frequencies") -> Array:
    """Return how functions of theta move with the logarithms of the gains."""
    posterior = Posterior.of(estimate, groups)
    return posterior.slopes(posterior.sources[0], functions)


def check_slopes(fitted: Callable[[Array], Estimate], close: float) -> None:
    """Hold slopes to the differences of fits by gains that are off."""
    estimate = fitted(np.zeros(2))
    slopes = gain_slopes(estimate, estimate.problem.base.matrix, "blocks")
    size = np.abs(estimate.base) + 1e-3
    for j in range(2):
        moved = fitted(1e-3 * np.eye(2)[j]).base - estimate.base
        np.testing.assert_allclose(slopes[:, j] / size, moved / 1e-3 / size, atol=close)
    # A common factor moves all parameters alike.
    np.testing.assert_allclose(slopes.sum(axis=1) / size, estimate.base / size, atol=close)


@pytest.mark.parametrize("weighting", ["gls", "gls_per_sample", "eq9", "eq18"])
def test_slopes_are_those_of_the_fit(weighting: Weighting) -> None:
    covariance = random_covariance(np.random.default_rng(2), 2, 40)
    mask = np.random.default_rng(3).random((40, 2)) < 0.9

    def fitted(off: Array) -> Estimate:
        samples = replace(scaled_samples(off, count=40), covariance=covariance, mask=mask)
        return sdpid.solve_wls(build_problem(ARM, samples, weighting=weighting))

    check_slopes(fitted, 1e-7)


def test_slopes_of_an_instrumental_estimate() -> None:
    def fitted(off: Array) -> Estimate:
        samples = scaled_samples(off, count=200)
        rng = np.random.default_rng(8)
        shaken = replace(samples, position=samples.position + 0.01 * rng.standard_normal((200, 2)))
        return sdpid.solve_instrumental(
            build_problem(ARM, samples), instruments=shaken, solver=sdpid.solve_wls
        )

    check_slopes(fitted, 1e-6)


def test_a_prior_holds_against_gains() -> None:
    """With a prior the parameters follow the gains as the estimate without inequalities does."""

    def fitted(off: Array) -> Estimate:
        prior = sdpid.Prior(bodies=BODIES, strength=5.0)
        samples = scaled_samples(off)
        return sdpid.solve_sdp(build_problem(ARM, samples, prior=prior, consistency="none"))

    estimate = fitted(np.zeros(2))
    slopes = gain_slopes(estimate, np.eye(estimate.problem.n_theta))
    moved = (fitted(np.array([1e-2, 0.0])).theta - fitted(np.array([-1e-2, 0.0])).theta) / 2e-2
    size = np.abs(estimate.theta).max()
    # What the prior says of friction follows the size of the efforts, which is not counted.
    np.testing.assert_allclose(slopes[:, 0] / size, moved / size, atol=5e-3)


def test_errors_of_gains_are_counted_by_their_slopes() -> None:
    exact = replace(GAINS, covariance=None)
    known, unsure = (
        sdpid.solve_wls(build_problem(ARM, replace(scaled_samples(np.zeros(2)), gains=gains)))
        for gains in (exact, GAINS)
    )
    assert gain_errors(known.problem) is None
    slopes = gain_slopes(unsure, unsure.problem.base.matrix)
    added, expected = unsure.covariance - known.covariance, slopes @ RELATIVE @ slopes.T
    np.testing.assert_allclose(added, expected, atol=1e-6 * expected.max())
    assert np.all(gauss_markov(unsure).width > gauss_markov(known).width)


# ---- What the data do not show is named before anything is solved.


ARM3 = small_arm(3)


def plain_samples(count: int = 60) -> Samples:
    return world.samples(ARM3, count=count)[0]


def still(samples: Samples, joint: int) -> Samples:
    """Return the samples with a joint that never moves."""
    moves, names = np.arange(3) != joint, ("position", "velocity", "acceleration")
    return replace(samples, **{name: moves * getattr(samples, name) for name in names})


STILL = still(plain_samples(), 2)
SPEEDS = np.abs(np.asarray(plain_samples().velocity))
MOVED_ONCE = np.tile([True, True, False], (60, 1)) | (np.arange(60) == 0)[:, None]


@pytest.mark.parametrize(
    ("samples", "friction", "words"),
    [
        (STILL, FRICTION, "do not excite.*limit 1e-10.*Fs3.*Fv3.*moves"),
        # Nor do masked rows excite.
        (replace(plain_samples(), mask=MOVED_ONCE), FRICTION, "do not excite"),
        (replace(plain_samples(), velocity=SPEEDS), ("coulomb", "offset"), "Fo1 with Fs1|Fs1 with"),
        (plain_samples(count=2), FRICTION, r"excite \d+ of \d+"),
    ],
    ids=["a joint that stands still", "masked", "without reversal", "too few"],
)
def test_what_is_not_excited_is_named(samples: Samples, friction: Any, words: str) -> None:
    refuses(IdentifiabilityError, words, build_problem, ARM3, samples, friction=friction)


def test_excitation_of_a_known_matrix() -> None:
    A = np.array([[2.0, 2.0, 0.0], [0.0, 1e-5, 0.0], [0.0, 0.0, 7.0]])
    excitation = Excitation.of(A, ("a", "b", "c"))
    np.testing.assert_allclose(excitation.column_norms, [2.0, 2.0, 7.0])
    assert excitation.singular_values[0] == pytest.approx(np.sqrt(2.0))
    ((value, names),) = excitation.weak()
    assert value == pytest.approx(5e-6 / np.sqrt(2.0), rel=1e-4)
    assert names == ("a", "b")
    assert excitation.condition_number == pytest.approx(np.sqrt(2.0) / value)


def test_columns_of_zeros_are_named_one_by_one() -> None:
    A = np.random.default_rng(3).standard_normal((5, 5))
    A[:, [1, 2, 4]] = 0.0
    excitation = Excitation.of(A, tuple("abcde"))
    assert excitation.weak() == ((0.0, ("b",)), (0.0, ("c",)), (0.0, ("e",)))
    assert excitation.condition_number == float("inf")
    np.testing.assert_allclose(np.linalg.norm(A @ excitation.root, axis=0), 1.0)
    np.testing.assert_allclose(A @ excitation.root @ excitation.inverse, A, atol=1e-12)


@pytest.mark.parametrize("speed", [1e-2, 3e-5])
def test_errors_of_what_is_hardly_seen_are_large(speed: float) -> None:
    """A slow joint's viscous and sigmoid friction are nearly one column."""
    samples = plain_samples(count=400)
    velocity = samples.velocity * [1.0, 1.0, speed]
    effort = np.random.default_rng(1).standard_normal(samples.effort.shape)
    samples = replace(samples, velocity=velocity, effort=effort)
    terms = ("viscous", SigmoidFriction(velocity=(0.3,) * 3))
    problem = build_problem(ARM3, samples, friction=terms)
    found = problem.excitation
    assert UNDETERMINED < found.singular_values[-1] < 50.0 * speed**2
    expected = np.linalg.norm(found.root, axis=1)
    np.testing.assert_allclose(solve_wls(problem).standard_errors, expected, rtol=0.2)
    blocks = np.sqrt(np.diag(ScoreBlocks.of(problem).covariance))
    np.testing.assert_allclose(blocks, expected, rtol=0.2)


def test_what_nothing_shows_has_infinite_errors() -> None:
    samples = still(plain_samples(), 2)
    prior = Prior(bodies=np.tile([1.0, *np.zeros(3), 0.1, 0.0, 0.1, 0.0, 0.0, 0.1], (3, 1)))
    problem = build_problem(ARM3, samples, prior=prior)
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
    T = information.information_root(information.information_rows(H))
    assert T.shape[1] == 37
    np.testing.assert_allclose(T[[7, 23]], 0.0, atol=1e-12)
    np.testing.assert_allclose(T.T @ H @ T, np.eye(37), atol=1e-9)


# ---- What noise in motion, landings, the filter and a wrong law of friction do to a fit.


PROCESSING = sdpid.Processing(
    cutoff_hz=25.0, filter="finite", decimation=None, reversal_time=None, derivative="central4"
)
NOISE = 3e-4


def recorded(noise: float, seed: int = 0) -> sdpid.Recording:
    """Return 20 s at 500 Hz of a motion below 2 Hz, its efforts exact but for white noise."""
    time = np.arange(10_000) / 500.0
    rng = np.random.default_rng(7)
    omega = 2.0 * np.pi * rng.uniform(0.3, 2.0, (5, ARM.n))
    q, v, a = sines(time, omega, rng.uniform(0.0, 2.0 * np.pi, omega.shape), 1.0 / omega)
    effort = ARM.inverse_dynamics(BODIES, q, v, a)
    rng = np.random.default_rng(seed)
    effort += 0.01 * np.std(effort, axis=0) * rng.standard_normal(effort.shape)
    return sdpid.Recording(
        time=time, position=q + noise * rng.standard_normal(q.shape), effort=effort
    )


def problem_of(log: sdpid.Recording) -> Problem:
    samples = samples_of(ARM, log, PROCESSING)
    return sdpid.build_problem(ARM, samples, friction=(), weighting="residual")


def moved_by(problem: Problem, name: str) -> Array | None:
    """Return the bias of a name, None where there is none."""
    return next((each.moves[:, 0] for each in problem.errors if each.name == name), None)


def without_error(problem: Problem, name: str) -> Problem:
    """Return a problem that does not know one bias."""
    return replace(problem, errors=tuple(each for each in problem.errors if each.name != name))


def test_the_bias_is_what_noise_does_and_intervals_count_it() -> None:
    log = recorded(NOISE)
    problem = with_motion_bias(problem_of(log), [log], PROCESSING)
    bias, truth = moved_by(problem, "motion"), problem.base_of(BODIES.ravel())
    # Three seeds of noise, against the fit of the same motion without.
    fits = [sdpid.solve_wls(problem_of(recorded(NOISE, seed))).base for seed in range(3)]
    moved = np.mean(fits, axis=0) - sdpid.solve_wls(problem_of(recorded(0.0))).base
    size = np.abs(moved) > 0.2 * np.abs(moved).max()
    np.testing.assert_allclose(bias[size], moved[size], rtol=0.4)
    wls = sdpid.solve_wls(problem)
    without = replace(wls, problem=without_error(problem, "motion"))
    short, honest = gauss_markov(without), gauss_markov(wls)
    assert not short.contains(truth).all()
    assert honest.contains(truth).all()
    assert "motion" not in short.shares
    # The bootstrap draws the bias too.
    options = {"parameters": problem.base.names, "resamples": 200, "n_jobs": 1}
    drawn, shorter = (
        sdpid.confidence_intervals(each, method="bootstrap", **options) for each in (wls, without)
    )
    assert "motion" in drawn.shares
    most_moved = honest.shares["motion"] > 0.8
    assert most_moved.any()
    np.testing.assert_allclose(drawn.width[most_moved], honest.width[most_moved], rtol=0.3)
    assert np.all(shorter.width[most_moved] < 0.7 * drawn.width[most_moved])
    most = problem.base.names[int(np.argmax(honest.shares["motion"]))]
    words = honest.noise_in_words()
    assert most in words
    assert short.noise_in_words() is None
    with pytest.raises(DataError, match="not those of the"):
        with_motion_bias(problem, [recorded(NOISE, 1)], PROCESSING)


def test_identify_counts_it_for_a_fixed_arm_where_there_is_any() -> None:
    options = {"processing": PROCESSING, "friction": (), "effects": "none", "prior": False}
    noisy, exact = (sdpid.identify(ARM, recorded(each), **options) for each in (NOISE, 0.0))
    found, problem = noisy.intervals, noisy.problem
    assert found is not None
    assert [each.name for each in problem.errors] == ["motion"]
    assert found.shares["motion"].max() > 0.8
    assert "noise in the measured motion" in noisy.intervals_note
    truth = dict(zip(problem.base.names, problem.base_of(BODIES.ravel()), strict=True))
    told = [name in truth for name in found.names]
    assert sum(told) == len(truth)
    held = found.contains([truth.get(name, 0.0) for name in found.names])
    assert held[told].all()
    # What lengthens no interval is not shown.
    assert exact.intervals is not None
    assert not exact.intervals.shares
    assert exact.intervals_note is None


def test_powers_of_covariances_have_no_such_bias() -> None:
    found = sdpid.identify(ARM, recorded(NOISE), friction=(), effects="none", weighting="eq18")
    assert not found.problem.errors


def test_a_copy_has_the_times_that_speeds_tell() -> None:
    recorded, _ = jittering(3)
    clock = told_clock(recorded)
    assert clock is not None
    regular, copy = retimed(recorded, clock), motion_noise.with_noise(recorded, generator(0))
    np.testing.assert_array_equal(copy.time, regular.time)
    np.testing.assert_array_equal(copy.effort, regular.effort)
    assert np.std(copy.position - regular.position) > 0.0


def test_a_copy_has_the_noise_of_the_recording_once_more() -> None:
    log = recorded(NOISE)
    turn = np.tile([0.0, 0.0, 0.0, 1.0], (log.n_samples, 1))
    rng = np.random.default_rng(1)
    imu = sdpid.Imu(
        gyroscope=2e-3 * rng.standard_normal((log.n_samples, 3)),
        # Landings: strong, and short.
        accelerometer=0.03 * rng.standard_normal((log.n_samples, 3))
        + 30.0 * (rng.random((log.n_samples, 1)) < 0.01),
    )
    base = sdpid.BaseMotion(orientation=turn, position=np.zeros((log.n_samples, 3)), imu=imu)
    log = replace(log, base=base)
    first = motion_noise.with_noise(log, np.random.default_rng(0))
    assert np.std(first.position - log.position) == pytest.approx(NOISE, rel=0.1)
    added = first.base.imu.accelerometer - imu.accelerometer
    assert np.std(added) == pytest.approx(0.03, rel=0.15)
    assert np.std(first.base.imu.gyroscope - imu.gyroscope) == pytest.approx(2e-3, rel=0.1)
    np.testing.assert_array_equal(first.base.orientation, turn)
    np.testing.assert_array_equal(first.effort, log.effort)


# ---- What landings do to a fit: without any noise, it is what the fit is off by.


LEGGED = sdpid.Processing(
    cutoff_hz=46.0,
    filter="finite",
    order=2,
    decimation=None,
    derivative="central4",
    reversal_time=None,
)
LEG_FRICTION = (sdpid.friction.Coulomb(width=0.02), "viscous", "rotor_inertia")


def simulated(gait: str) -> LeggedRun:
    return sdpid.simulate_legged(quadruped(), gait, duration=2.0, seed=1, sensors=Sensors.exact())


def legged_problem(log: sdpid.Recording, processing: sdpid.Processing) -> Problem:
    given = {"processing": processing, "friction": LEG_FRICTION, "weighting": "residual"}
    problem = sdpid.build_problem(quadruped(), [log], **given)
    return with_motion_bias(problem, [log], processing)


def with_and_without(
    estimate: Estimate, without: Problem, name: str
) -> tuple[Intervals, Intervals]:
    """Return intervals that count a bias, and those that do not; its share is the difference."""
    honest, short = gauss_markov(estimate), gauss_markov(replace(estimate, problem=without))
    # Shares say how much of the variance it is.
    share = honest.shares[name]
    assert name not in short.shares
    np.testing.assert_allclose(honest.width**2 * (1.0 - share), short.width**2, rtol=0.05)
    return honest, short


def counts_a_bias(problem: Problem, run: LeggedRun, name: str, alike: float) -> Intervals:
    """Return intervals that hold the truth as they count a bias, which is alike the fit's error."""
    bias, truth = moved_by(problem, name), problem.base_of(run.theta)
    wls, without = sdpid.solve_wls(problem), without_error(problem, name)
    honest, short = with_and_without(wls, without, name)
    size = short.width
    assert np.corrcoef(bias / size, (wls.base - truth) / size)[0, 1] > alike
    assert honest.contains(truth).mean() > max(0.95, short.contains(truth).mean())
    assert np.median(honest.width / short.width) < 2.0
    return honest


def test_intervals_of_a_trot_count_what_its_landings_do() -> None:
    run = simulated("trot")
    problem = legged_problem(run.recording, LEGGED)
    honest = counts_a_bias(problem, run, "landing", 0.5)
    assert "from landings, %" in honest.table()
    words = honest.noise_in_words()
    assert honest.names[int(np.argmax(honest.shares["landing"]))] in words
    # Where landings are left out there is nothing to count.
    apart = legged_problem(run.recording, replace(LEGGED, impact_s=0.0))
    assert moved_by(apart, "landing") is None
    assert not landings_used(apart, [run.recording], replace(LEGGED, impact_s=0.0))
    # Where too few samples would stay they are used after all, and counted as much.
    kept = replace(LEGGED, impact_s=0.0, kept_share=0.9)
    again = legged_problem(run.recording, kept)
    assert landings_used(again, [run.recording], kept)
    assert moved_by(again, "filter") is None
    moved = [moved_by(each, "landing") for each in (again, problem)]
    np.testing.assert_allclose(*moved, rtol=1e-9)
    # No sample is two seconds away from a landing: what they do is not known.
    wide = replace(LEGGED, impact_s=2.0, kept_share=0.1)
    unknown = legged_problem(run.recording, wide)
    assert moved_by(unknown, "landing") is None
    assert landings_used(unknown, [run.recording], wide)


def counted(rng: np.random.Generator, wrong: float) -> float:
    """Return the share of two fits' difference that is counted; some samples have wrong efforts."""
    motion = tuple(rng.standard_normal((600, ARM.n)) for _ in range(3))
    noise, near = 0.1 * rng.standard_normal((600, ARM.n)), np.arange(600) % 6 < 2
    noise[near] += wrong * motion[2][near]
    theta = random_theta(ARM, np.random.default_rng(0), ())
    samples = make_samples(ARM, theta, rng, states=motion, noise=noise, friction=())
    away = replace(samples, mask=np.tile(~near[:, None], ARM.n))
    problems = [
        sdpid.build_problem(ARM, each, friction=(), weighting="residual")
        for each in (samples, away)
    ]
    fits = [sdpid.solve_wls(each).base for each in problems]
    moved = fits[0] - fits[1]
    bias = motion_noise.beyond_noise(*problems, moved)
    return float(np.linalg.norm(bias) / np.linalg.norm(moved))


def test_noise_between_two_fits_is_hardly_counted_and_a_bias_is() -> None:
    rng = np.random.default_rng(5)
    noise = [counted(rng, 0.0) for _ in range(12)]
    assert np.median(noise) < 0.4
    assert counted(rng, 0.2) > 0.9


# ---- What the filter does to a fit: of exact sensors it is what the fit is off by.


# The base sways with up to 2 Hz.
SLOW = replace(LEGGED, cutoff_hz=12.0)


@pytest.fixture(scope="module")
def stand() -> LeggedRun:
    return simulated("stand")


def test_intervals_of_a_stand_count_what_the_filter_does(stand: LeggedRun) -> None:
    problem = legged_problem(stand.recording, SLOW)
    assert moved_by(problem, "landing") is None
    honest = counts_a_bias(problem, stand, "filter", 0.8)
    assert "from the filter, %" in honest.table()
    words = replace(honest, shares={"filter": np.full(len(honest), 0.9)}).noise_in_words()
    assert "what the filter takes away moves" in words


def test_what_no_other_filter_tells_is_not_counted(stand: LeggedRun) -> None:
    # Between these and half the rate there is no room for a higher one.
    fast = replace(SLOW, cutoff_hz=0.4 / stand.recording.step)
    assert moved_by(legged_problem(stand.recording, fast), "filter") is None


# ---- What a law of friction that is not the robot's does to a fit whose speeds the data chose.


CHOSEN = (sdpid.friction.SigmoidFriction(), "viscous")


def peaked(peak: float, friction: tuple[object, ...] = CHOSEN) -> tuple[Problem, Array]:
    """Return the problem of a robot whose friction has a peak, and its links' parameters."""
    rng = np.random.default_rng(7)
    # Slow enough to see where friction bends; a motion that repeats as efforts do.
    q, v, a = (size * rng.standard_normal((1500, ARM.n)) for size in (1.0, 0.5, 1.0))
    a += 0.5 * np.tanh(v / 0.3)
    theta = random_theta(ARM, np.random.default_rng(0), ())
    rest = 2.0 * (1.0 + peak * np.exp(-((v / 0.3) ** 2))) * np.tanh(v / 0.1) + 0.3 * v
    rest += 0.05 * rng.standard_normal(v.shape)
    samples = make_samples(ARM, theta, rng, states=(q, v, a), noise=rest, friction=())
    problem = sdpid.build_problem(ARM, samples, friction=friction, weighting="residual")  # type: ignore[arg-type]
    return problem, theta


def bias_of(problem: Problem) -> Array | None:
    assert isinstance(problem.rows, RowSource)
    return friction_bias(problem, problem.rows)


def test_the_bias_is_what_the_fit_is_off_by() -> None:
    problem, theta = peaked(0.8)
    bias, wls = bias_of(problem), sdpid.solve_wls(problem)
    links = np.array([not name.startswith("F") for name in problem.base.names])
    off = (wls.base - problem.base.matrix[:, : len(theta)] @ theta)[links]
    size = wls.standard_errors[links]
    assert np.corrcoef(bias[links] / size, off / size)[0, 1] > 0.8
    left = (off - bias[links]) / size
    assert np.linalg.norm(left) < 0.7 * np.linalg.norm(off / size)
    assert not bias[~links].any()
    # Intervals count it, say so, and name what it moves.
    counted = replace(wls, problem=replace(problem, errors=(ErrorSource.bias("friction", bias),)))
    honest, _ = with_and_without(counted, wls.problem, "friction")
    # A law that is right has next to none, and where the data chose no speed, none is doubted.
    right = peaked(0.0)[0]
    sizes = [
        np.linalg.norm(bias_of(each) / solve_wls(each).standard_errors) for each in (right, problem)
    ]
    assert sizes[0] < 0.3 * sizes[1]
    assert bias_of(peaked(0.8, ("coulomb", "viscous"))[0]) is None
    assert "from friction's law, %" in honest.table()
    words = replace(honest, shares={"friction": np.full(len(honest), 0.9)}).noise_in_words()
    assert "a law of friction that is not the model's moves" in words


def test_motion_and_friction_are_asked_together() -> None:
    log = recorded(0.0)
    speed = np.gradient(log.position, log.time, axis=0)
    curve = 2.0 * (1.0 + np.exp(-((speed / 0.3) ** 2))) * np.tanh(speed / 0.1)
    log = replace(log, effort=log.effort + curve)
    samples = samples_of(ARM, log, PROCESSING)
    problem = sdpid.build_problem(ARM, samples, friction=CHOSEN, weighting="residual")
    bias = bias_of(problem)
    assert bias.any()
    found = with_motion_bias(problem, [log], PROCESSING)
    np.testing.assert_array_equal(moved_by(found, "friction"), bias)
    assert [source.name for source in found.errors] == ["motion", "filter", "friction"]
