"""What landings do to a fit: without any noise, it is what the fit is off by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import sdpid
from sdpid.assurance.intervals.noise_in_motion import noise_in_words
from sdpid.estimation.motion_noise.bias import with_motion_bias
from sdpid.estimation.motion_noise.landings import beyond_noise, landings_used
from sdpid.experiment.plant.legged.sensors import Sensors
from tests.helpers.arm import ARM
from tests.helpers.data import full_regressor, random_theta

PROCESSING = sdpid.Processing(
    cutoff_hz=46.0,
    filter="finite",
    order=2,
    decimation=None,
    derivative="central4",
    reversal_time=None,
)
FRICTION = (sdpid.friction.Coulomb(width=0.02), "viscous", "rotor_inertia")


def problem_of(
    robot: sdpid.RobotModel, log: sdpid.Recording, processing: sdpid.Processing
) -> sdpid.Problem:
    problem = sdpid.build_problem(
        robot, [log], processing=processing, friction=FRICTION, weighting="residual"
    )
    return with_motion_bias(problem, [log], processing)


def with_and_without(
    estimate: sdpid.Estimate, without: sdpid.Problem, name: str
) -> tuple[sdpid.Intervals, sdpid.Intervals]:
    """Return intervals that count a bias, and those that do not; its share is the difference."""
    honest, short = (
        sdpid.confidence_intervals(each, method="gauss_markov", parameters=without.base.names)
        for each in (estimate, replace(estimate, problem=without))
    )
    # Shares say how much of the variance it is.
    share = getattr(honest, name)
    assert share is not None
    assert getattr(short, name) is None
    np.testing.assert_allclose(honest.width**2 * (1.0 - share), short.width**2, rtol=0.05)
    return honest, short


def test_intervals_of_a_trot_count_what_its_landings_do() -> None:
    robot = sdpid.load_robot("solo12", root="free_flyer")
    run = sdpid.simulate_legged(robot, "trot", duration=2.0, seed=1, sensors=Sensors.exact())
    problem = problem_of(robot, run.recording, PROCESSING)
    bias, truth = problem.landing_bias, problem.base_of(run.theta)
    assert bias is not None
    wls = sdpid.solve_wls(problem)
    honest, short = with_and_without(wls, replace(problem, landing_bias=None), "landing_share")
    size = short.width
    assert np.corrcoef(bias / size, (wls.base - truth) / size)[0, 1] > 0.5
    assert honest.contains(truth).mean() > max(0.95, short.contains(truth).mean())
    assert np.median(honest.width / short.width) < 2.0
    assert honest.landing_share is not None
    assert "from landings, %" in honest.table()
    words = noise_in_words(honest)
    assert words is not None
    assert honest.names[int(np.argmax(honest.landing_share))] in words
    # Where landings are left out there is nothing to count.
    apart = problem_of(robot, run.recording, replace(PROCESSING, impact_s=0.0))
    assert apart.landing_bias is None
    assert not landings_used(apart, [run.recording], replace(PROCESSING, impact_s=0.0))
    # Where too few samples would stay they are used after all, and counted as much.
    kept = replace(PROCESSING, impact_s=0.0, kept_share=0.9)
    again = problem_of(robot, run.recording, kept)
    assert landings_used(again, [run.recording], kept)
    assert again.landing_bias is not None
    assert again.filter_bias is None
    np.testing.assert_allclose(again.landing_bias, bias, rtol=1e-9)
    # No sample is two seconds away from a landing: what they do is not known.
    wide = replace(PROCESSING, impact_s=2.0, kept_share=0.1)
    unknown = problem_of(robot, run.recording, wide)
    assert unknown.landing_bias is None
    assert landings_used(unknown, [run.recording], wide)


def counted(rng: np.random.Generator, wrong: float) -> float:
    """Return the share of two fits' difference that is counted; some samples have wrong efforts."""
    motion = tuple(rng.standard_normal((600, ARM.n)) for _ in range(3))
    effort = full_regressor(ARM, motion, ()) @ random_theta(ARM, np.random.default_rng(0), ())
    effort += 0.1 * rng.standard_normal(effort.shape)
    near = np.arange(600) % 6 < 2
    effort[near] += wrong * motion[2][near]
    samples = sdpid.Samples(
        position=motion[0], velocity=motion[1], acceleration=motion[2], effort=effort
    )
    away = replace(samples, mask=np.tile(~near[:, None], ARM.n))
    problems = [
        sdpid.build_problem(ARM, each, friction=(), weighting="residual")
        for each in (samples, away)
    ]
    fits = [sdpid.solve_wls(each).base for each in problems]
    moved = fits[0] - fits[1]
    bias = beyond_noise(*problems, moved)
    assert bias is not None
    return float(np.linalg.norm(bias) / np.linalg.norm(moved))


def test_noise_between_two_fits_is_hardly_counted_and_a_bias_is() -> None:
    rng = np.random.default_rng(5)
    noise = [counted(rng, 0.0) for _ in range(12)]
    assert np.median(noise) < 0.4
    assert counted(rng, 0.2) > 0.9
