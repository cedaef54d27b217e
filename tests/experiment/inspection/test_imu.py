"""The place, axes, biases and scales of an IMU are found to be wrong by the pose, and named."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sdpid
from sdpid import Recording
from sdpid.experiment.inspection.finding import Finding, Subject
from sdpid.experiment.inspection.places import imu_checks, imu_fit
from sdpid.experiment.plant.legged.friction import DryFriction
from sdpid.experiment.plant.legged.truth import changed_parameters

pytest.importorskip("mujoco")


@cache
def robot() -> sdpid.RobotModel:
    return sdpid.load_robot("go1", root="free_flyer")


@cache
def log(motion: str) -> Recording:
    return sdpid.simulate_legged(robot(), motion, seed=3, duration=2.0).recording


def with_imu(motion: str, **changes: Any) -> Recording:
    base = log(motion).base
    return replace(log(motion), base=replace(base, imu=replace(base.imu, **changes)))


def found(recording: Recording) -> list[Finding]:
    return list(imu_checks.imu(Subject(log=recording, robot=None, floating=robot())))


@pytest.mark.parametrize("motion", ["stand", "trot", "hang"])
def test_right_imus_are_left_alone(motion: str) -> None:
    assert not found(log(motion))
    late = np.maximum(np.arange(2000) - 10, 0)
    imu = log(motion).base.imu
    channels = {name: getattr(imu, name)[late] for name in ("gyroscope", "accelerometer")}
    assert not found(with_imu(motion, **channels))


@pytest.mark.parametrize("motion", ["stand", "trot"])
@pytest.mark.parametrize("gyroscope", [True, False])
def test_place_and_axes_are_found_together(motion: str, gyroscope: bool) -> None:
    changes = {} if gyroscope else {"gyroscope": None}
    imu = log(motion).base.imu
    moved = found(with_imu(motion, translation=np.zeros(3), **changes))
    assert [finding.kind for finding in moved] == ["imu_place"]
    distance = np.linalg.norm(imu.translation)
    assert abs(moved[0].numbers["distance"] - distance) < 5.0 * moved[0].numbers["error"]
    # A large turn about the vertical, which gravity does not show.
    turned = found(with_imu(motion, rotation=np.eye(3), translation=np.zeros(3), **changes))
    assert {finding.kind for finding in turned} == {"imu_axes", "imu_place"}
    axes = next(finding for finding in turned if finding.kind == "imu_axes")
    given = np.array(eval(axes.remedy.split("=")[1]))
    assert np.linalg.norm(Rotation.from_matrix(given.T @ imu.rotation).as_rotvec()) < 0.03


@pytest.mark.parametrize(
    ("channel", "factor", "bias", "kind"),
    [
        ("accelerometer", 1.0, [0.3, 0.0, 0.0], "imu_bias"),
        ("accelerometer", 0.96, [0.0, 0.0, 0.0], "imu_scale"),
        ("gyroscope", 1.0, [0.0, 0.1, 0.0], "imu_bias"),
        ("gyroscope", 1.05, [0.0, 0.0, 0.0], "imu_scale"),
    ],
)
def test_biases_and_scales_are_named(channel: str, factor: float, bias: list[float], kind: str):
    values = factor * np.array(getattr(log("stand").base.imu, channel)) + bias
    (finding,) = found(with_imu("stand", **{channel: values}))
    assert finding.kind == kind
    assert f"the {channel} shows" in finding.message
    true = factor if kind == "imu_scale" else np.linalg.norm(bias)
    told = finding.numbers[kind.removeprefix("imu_")]
    assert abs(told - true) < 5.0 * finding.numbers["error"] + 0.01 * true


def test_bias_of_a_base_at_rest_may_be_a_tilt() -> None:
    force = np.array([0.3, 0.0, 0.0]) + log("hang").base.imu.accelerometer
    (finding,) = found(with_imu("hang", accelerometer=force))
    assert finding.kind == "imu_bias"
    assert "axes that are tilted would show the same" in finding.message


def test_mirrored_gyroscope_is_told_from_a_turned_one() -> None:
    rates = np.array(log("trot").base.imu.gyroscope)
    fits = [
        imu_fit.gyroscope_fit(with_imu("trot", gyroscope=changed))
        for changed in (rates * [1.0, 1.0, -1.0], rates[:, [1, 0, 2]] * [1.0, -1.0, 1.0])
    ]
    assert [fit.mirrored for fit in fits] == [True, False]
    assert set(fits[1].found) == {"axes"}


def test_delays_are_not_told_of_an_imu_that_sits_elsewhere() -> None:
    """Accelerations of a wrong place are those of another time, for all channels."""
    run = sdpid.simulate_legged(
        robot(),
        "stand",
        theta=changed_parameters(robot(), seed=1),
        seed=10,
        duration=2.5,
        friction=DryFriction(width=0.042, peak=0.15, peak_speed=0.13),
    )
    base = run.recording.base
    moved = replace(run.recording, base=replace(base, imu=replace(base.imu, translation=(0, 0, 0))))
    told = sdpid.inspect_recording(moved, robot()).findings
    (place,) = [finding for finding in told if finding.severity != "note"]
    assert place.kind == "imu_place"
    assert place.message.endswith("delays are told once this is mended")
