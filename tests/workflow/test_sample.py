"""Draws of an estimate as a user has them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid.assurance.intervals.friction_curve import joint_curve
from sdpid.errors import DataError
from sdpid.workflow.result import Identification
from sdpid.workflow.sample import ParameterSamples
from tests.helpers.identified import ARM, arm_theta, identified, moved
from tests.helpers.refusals import refuses

COUNT = 20


@pytest.fixture(scope="module")
def result() -> Identification:
    return identified(moved(arm_theta(), 1))


@pytest.fixture(scope="module")
def samples(result: Identification) -> ParameterSamples:
    return sdpid.sample_parameters(result, COUNT, 0)


def test_every_draw_is_feasible(result: Identification, samples: ParameterSamples) -> None:
    problem = result.problem
    assert len(samples) == COUNT
    assert samples.theta.shape == (COUNT, problem.n_theta)
    assert all(problem.feasible.violation(theta) == 0.0 for theta in samples.theta)
    assert np.allclose(samples.base, samples.theta @ problem.base.matrix.T)
    assert not samples.theta.flags.writeable


def test_seeds(result: Identification, samples: ParameterSamples) -> None:
    again = sdpid.sample_parameters(result.estimate, COUNT, seed=0)
    assert np.array_equal(again.theta, samples.theta)
    other = sdpid.sample_parameters(result.estimate, COUNT, 1)
    assert not np.array_equal(other.theta, samples.theta)


def test_models_compute_with_the_draws(result: Identification, samples: ParameterSamples) -> None:
    q, v, a = np.full((3, 2), 0.3)
    models = list(samples.models())
    assert len(models) == COUNT
    for model, theta in zip(models, samples.theta, strict=True):
        own = result.estimate.of_theta(result.problem, theta, method="given", status="given")
        assert np.allclose(model.inverse_dynamics(q, v, a), own.model().inverse_dynamics(q, v, a))


def test_what_is_shown(samples: ParameterSamples) -> None:
    assert repr(samples).startswith("ParameterSamples(robot='arm2', draws=20, seed=0, ")
    shown = samples._repr_html_()
    assert "split R-hat" in shown
    assert "zzr1" in shown
    frame = samples.to_frame()
    assert frame.shape == (COUNT, 26)
    assert list(frame.columns) == list(samples.estimate.problem.base.theta_names)


def test_ranges_and_files_say_what_they_are_of(samples: ParameterSamples, tmp_path: Path) -> None:
    ranges = samples.ranges(0.5)
    assert ranges.probability == 0.5
    made = ranges.to_dict()["made"]
    assert made["robot"] == "arm2"
    assert made["seed"] == 0
    assert len(made["certificate"]) == len(made["parameters_sha256"]) == 64
    files = samples.save(tmp_path, ("mjcf",))
    assert len(files) == COUNT + 4
    assert all(path.is_file() for path in files)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((0, 0), "n: is 0; give a whole number from 1 to 1000000"),
        ((10**9, 0), "give a whole number from 1 to 1000000"),
        ((True, 0), "n: is True"),
        ((2.5, 0), "n: is 2.5"),
        (("ten", 0), "n: is 'ten'"),
        ((5, -1), "seed: is -1; give a whole number from 0 on"),
        ((5, None), "seed: is None"),
    ],
)
def test_numbers_that_are_none(result: Identification, arguments: Any, words: str) -> None:
    refuses(DataError, words, sdpid.sample_parameters, result, *arguments)


@pytest.mark.parametrize("probability", [0.0, 1.0, -1, 2, float("nan"), True, "half", None])
def test_shares_that_are_none(samples: ParameterSamples, probability: Any, tmp_path: Path) -> None:
    refuses(DataError, "give a probability between 0 and 1", samples.ranges, probability)
    with pytest.raises(DataError, match="give a probability between 0 and 1"):
        samples.save(tmp_path, probability=probability)


def test_a_robot_without_friction(tmp_path: Path) -> None:
    samples = moved(arm_theta(), 1, seconds=4.0)
    estimate = sdpid.solve_sdp(sdpid.build_problem(ARM, samples, friction=(), weighting="residual"))
    sdpid.sample_parameters(estimate, 2).save(tmp_path)
    assert sdpid.audit_urdf(tmp_path / "robot_0002.urdf").passed
    curve = joint_curve(estimate, 0)
    assert not np.any([curve.effort, curve.lower, curve.upper])


def test_what_is_no_estimate() -> None:
    with pytest.raises(DataError, match="estimate: is str; give what solve_sdp or identify"):
        sdpid.sample_parameters("arm", 3, 0)
