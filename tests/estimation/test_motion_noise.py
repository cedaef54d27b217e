"""What noise in motion, landings, the filter and a wrong law of friction do to a fit."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

import sdpid
from sdpid._common.arrays import Array
from sdpid.assurance.intervals.intervals import Intervals
from sdpid.errors import DataError
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.error_source import ErrorSource
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.motion_noise import (
    beyond_noise,
    friction_bias,
    landings_used,
    twins,
    with_motion_bias,
)
from sdpid.estimation.problem import Problem
from sdpid.experiment.plant.legged.sensors import Sensors
from sdpid.experiment.plant.legged.simulate import LeggedRun
from sdpid.experiment.preparation.for_robot import prepare
from tests.helpers.arm import ARM, BODIES
from tests.helpers.data import make_samples, random_theta
from tests.helpers.legged import quadruped
from tests.helpers.motions import sines
from tests.helpers.world import gauss_markov

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
    samples = prepare(ARM, log, PROCESSING)
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


def test_a_bias_as_one_more_error_is_held_at_least_as_often_as_stated() -> None:
    bias = np.linspace(0.0, 30.0, 3001)
    for level in (0.9, 0.95, 0.99):
        half = norm.ppf(0.5 * (1.0 + level)) * np.sqrt(1.0 + bias**2)
        assert np.all(norm.cdf(half - bias) - norm.cdf(-half - bias) >= level - 1e-4)


def test_twins_have_the_noise_of_the_recording_once_more() -> None:
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
    first, second = twins(log, np.random.default_rng(0))
    np.testing.assert_allclose(first.position + second.position, 2.0 * log.position, atol=1e-12)
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
FRICTION = (sdpid.friction.Coulomb(width=0.02), "viscous", "rotor_inertia")


def simulated(gait: str) -> LeggedRun:
    return sdpid.simulate_legged(quadruped(), gait, duration=2.0, seed=1, sensors=Sensors.exact())


def legged_problem(log: sdpid.Recording, processing: sdpid.Processing) -> Problem:
    given = {"processing": processing, "friction": FRICTION, "weighting": "residual"}
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


def counted_bias(problem: Problem, run: LeggedRun, name: str, alike: float) -> Intervals:
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
    honest = counted_bias(problem, run, "landing", 0.5)
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
    bias = beyond_noise(*problems, moved)
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
    honest = counted_bias(problem, stand, "filter", 0.8)
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
    assert "from friction's law, %" in honest.table()
    words = replace(honest, shares={"friction": np.full(len(honest), 0.9)}).noise_in_words()
    assert "a law of friction that is not the model's moves" in words


def test_motion_and_friction_are_asked_together() -> None:
    log = recorded(0.0)
    speed = np.gradient(log.position, log.time, axis=0)
    curve = 2.0 * (1.0 + np.exp(-((speed / 0.3) ** 2))) * np.tanh(speed / 0.1)
    log = replace(log, effort=log.effort + curve)
    samples = prepare(ARM, log, PROCESSING)
    problem = sdpid.build_problem(ARM, samples, friction=CHOSEN, weighting="residual")
    bias = bias_of(problem)
    assert bias.any()
    found = with_motion_bias(problem, [log], PROCESSING)
    np.testing.assert_array_equal(moved_by(found, "friction"), bias)
    assert [source.name for source in found.errors] == ["motion", "filter", "friction"]


def test_a_law_that_is_right_has_next_to_none() -> None:
    sizes = []
    for peak in (0.0, 0.8):
        problem, _ = peaked(peak)
        bias = bias_of(problem)
        sizes.append(np.linalg.norm(bias / sdpid.solve_wls(problem).standard_errors))
    assert sizes[0] < 0.3 * sizes[1]
    # Where the data chose no speed, no law is doubted.
    assert bias_of(peaked(0.8, ("coulomb", "viscous"))[0]) is None
