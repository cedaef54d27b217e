"""What the filter does to a fit: of exact sensors it is what the fit is off by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import sdpid
from sdpid.assurance.intervals.noise_in_motion import noise_in_words
from sdpid.experiment.plant.legged.sensors import Sensors
from tests.estimation.motion_noise.test_landings import PROCESSING, problem_of, with_and_without

# The base sways with up to 2 Hz.
SLOW = replace(PROCESSING, cutoff_hz=12.0)


@pytest.fixture(scope="module")
def stand() -> tuple[sdpid.RobotModel, sdpid.LeggedRun]:
    robot = sdpid.load_robot("solo12", root="free_flyer")
    return robot, sdpid.simulate_legged(
        robot, "stand", duration=2.0, seed=1, sensors=Sensors.exact()
    )


def test_intervals_of_a_stand_count_what_the_filter_does(
    stand: tuple[sdpid.RobotModel, sdpid.LeggedRun],
) -> None:
    robot, run = stand
    problem = problem_of(robot, run.recording, SLOW)
    bias, truth = problem.filter_bias, problem.base_of(run.theta)
    assert bias is not None
    assert problem.landing_bias is None
    wls = sdpid.solve_wls(problem)
    honest, short = with_and_without(wls, replace(problem, filter_bias=None), "filter_share")
    size = short.width
    assert np.corrcoef(bias / size, (wls.base - truth) / size)[0, 1] > 0.8
    assert honest.contains(truth).mean() > max(0.95, short.contains(truth).mean())
    assert np.median(honest.width / short.width) < 2.0
    assert "from the filter, %" in honest.table()
    words = noise_in_words(replace(honest, filter_share=np.full(len(honest), 0.9)))
    assert words is not None
    assert "what the filter takes away moves" in words


def test_what_no_other_filter_tells_is_not_counted(
    stand: tuple[sdpid.RobotModel, sdpid.LeggedRun],
) -> None:
    robot, run = stand
    # Between these and half the rate there is no room for a higher one.
    fast = replace(SLOW, cutoff_hz=0.4 / run.recording.step)
    assert problem_of(robot, run.recording, fast).filter_bias is None
