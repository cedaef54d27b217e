"""What a law of friction that is not the robot's does to a fit whose speeds the data chose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import sdpid
from sdpid._common.arrays import Array
from sdpid.assurance.intervals.noise_in_motion import noise_in_words
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.motion_noise.bias import with_motion_bias
from sdpid.estimation.motion_noise.friction import friction_bias
from sdpid.experiment.preparation.for_robot import prepare
from tests.estimation.motion_noise.test_bias import PROCESSING, recorded
from tests.estimation.motion_noise.test_landings import with_and_without
from tests.helpers.arm import ARM
from tests.helpers.data import full_regressor, random_theta

CHOSEN = (sdpid.friction.SigmoidFriction(), "viscous")


def problem_of(peak: float, friction: tuple[object, ...] = CHOSEN) -> tuple[sdpid.Problem, Array]:
    """Return the problem of a robot whose friction has a peak, and its links' parameters."""
    rng = np.random.default_rng(7)
    # Slow enough to see where friction bends; a motion that repeats as efforts do.
    q, v, a = (size * rng.standard_normal((1500, ARM.n)) for size in (1.0, 0.5, 1.0))
    a += 0.5 * np.tanh(v / 0.3)
    theta = random_theta(ARM, np.random.default_rng(0), ())
    effort = full_regressor(ARM, (q, v, a), ()) @ theta + 0.3 * v
    effort += 2.0 * (1.0 + peak * np.exp(-((v / 0.3) ** 2))) * np.tanh(v / 0.1)
    effort += 0.05 * rng.standard_normal(effort.shape)
    samples = sdpid.Samples(position=q, velocity=v, acceleration=a, effort=effort)
    problem = sdpid.build_problem(ARM, samples, friction=friction, weighting="residual")  # type: ignore[arg-type]
    return problem, theta


def bias_of(problem: sdpid.Problem) -> Array | None:
    assert isinstance(problem.rows, RowSource)
    return friction_bias(problem, problem.rows)


def test_the_bias_is_what_the_fit_is_off_by() -> None:
    problem, theta = problem_of(0.8)
    bias, wls = bias_of(problem), sdpid.solve_wls(problem)
    assert bias is not None
    links = np.array([not name.startswith("F") for name in problem.base.names])
    off = (wls.base - problem.base.matrix[:, : len(theta)] @ theta)[links]
    size = wls.standard_errors[links]
    assert np.corrcoef(bias[links] / size, off / size)[0, 1] > 0.8
    left = (off - bias[links]) / size
    assert np.linalg.norm(left) < 0.7 * np.linalg.norm(off / size)
    assert not bias[~links].any()
    # Intervals count it, say so, and name what it moves.
    counted = replace(wls, problem=replace(problem, friction_bias=bias))
    honest, _ = with_and_without(counted, wls.problem, "friction_share")
    assert "from friction's law, %" in honest.table()
    words = noise_in_words(replace(honest, friction_share=np.full(len(honest), 0.9)))
    assert words is not None
    assert "a law of friction that is not the model's moves" in words


def test_motion_and_friction_are_asked_together() -> None:
    log = recorded(0.0)
    speed = np.gradient(log.position, log.time, axis=0)
    curve = 2.0 * (1.0 + np.exp(-((speed / 0.3) ** 2))) * np.tanh(speed / 0.1)
    log = replace(log, effort=log.effort + curve)
    samples = prepare(ARM, log, PROCESSING)
    problem = sdpid.build_problem(ARM, samples, friction=CHOSEN, weighting="residual")
    bias = bias_of(problem)
    assert bias is not None
    assert bias.any()
    found = with_motion_bias(problem, [log], PROCESSING)
    np.testing.assert_array_equal(found.friction_bias, bias)
    # Noise in motion, the filter, and the law.
    assert len(found.biases) == 3


def test_a_law_that_is_right_has_next_to_none() -> None:
    sizes = []
    for peak in (0.0, 0.8):
        problem, _ = problem_of(peak)
        bias = bias_of(problem)
        assert bias is not None
        sizes.append(np.linalg.norm(bias / sdpid.solve_wls(problem).standard_errors))
    assert sizes[0] < 0.3 * sizes[1]
    # Where the data chose no speed, no law is doubted.
    assert bias_of(problem_of(0.8, ("coulomb", "viscous"))[0]) is None
