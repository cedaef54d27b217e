"""Measured wrenches of soles that are wrong are named, and right ones are left alone."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import sdpid
from sdpid import Recording
from sdpid._common.arrays import Array
from sdpid.experiment.inspection.finding import Finding, Subject
from sdpid.experiment.inspection.forces import force_checks
from sdpid.experiment.plant.legged.sensors import Sensors

pytest.importorskip("mujoco")


@cache
def robot() -> sdpid.RobotModel:
    return sdpid.load_robot("talos_reduced", root="free_flyer")


@cache
def log(motion: str) -> Recording:
    sensors = Sensors(forces=True)
    return sdpid.simulate_legged(robot(), motion, seed=1, duration=2.0, sensors=sensors).recording


def wrenches(motion: str) -> Array:
    return np.array(log(motion).contacts.wrenches)


def found(motion: str, changed: Array) -> list[Finding]:
    contacts = replace(log(motion).contacts, wrenches=changed)
    recording = replace(log(motion), contacts=contacts)
    return list(force_checks.forces(Subject(log=recording, robot=None, floating=robot())))


@pytest.mark.parametrize("motion", ["stand", "step"])
def test_right_wrenches_are_left_alone(motion: str) -> None:
    assert not found(motion, wrenches(motion))


def test_hand_that_never_lands_is_not_compared() -> None:
    stand = log("stand").contacts
    n = stand.n_samples
    noisy = np.zeros((n, 1, 6))
    noisy[..., :3] = np.random.default_rng(0).normal(size=(n, 1, 3))
    contacts = sdpid.Contacts(
        frames=(*stand.frames, "gripper_left_joint"),
        kind=(*stand.kind, "point"),
        down=np.hstack([stand.closed, np.zeros((n, 1), dtype=bool)]),
        wrenches=np.concatenate([stand.wrenches, noisy], axis=1),
    )
    told = sdpid.inspect_recording(replace(log("stand"), contacts=contacts), robot()).findings
    assert not [each for each in told if each.severity != "note"]


@pytest.mark.parametrize("motion", ["stand", "step"])
@pytest.mark.parametrize(("factor", "words"), [(-1.0, "wrong sign"), (0.7, "are 0.")])
def test_moments_of_another_scale(motion: str, factor: float, words: str) -> None:
    changed = wrenches(motion)
    changed[..., 3:] *= factor
    told = found(motion, changed)
    assert [finding.kind for finding in told] == 2 * ["wrenches_moments"]
    assert all(words in finding.message for finding in told)
    assert all(abs(finding.numbers["ratio"] - factor) < 0.1 for finding in told)


@pytest.mark.parametrize("motion", ["stand", "step"])
def test_moments_about_another_point(motion: str) -> None:
    point = np.array([0.05, 0.0, 0.1])
    changed = wrenches(motion)
    changed[..., 3:] -= np.cross(point, changed[..., :3])
    told = found(motion, changed)
    assert [finding.kind for finding in told] == 2 * ["wrenches_point"]
    for finding in told:
        about = np.array([finding.numbers[f"point_{key}"] for key in "xyz"])
        assert np.abs(about - point)[:2].max() < 0.01
        assert abs(about - point)[2] < 0.05


def test_wrenches_of_other_feet_and_sign() -> None:
    (finding,) = found("step", wrenches("step")[:, [1, 0]])
    assert finding.kind == "forces_exchanged"
    (finding,) = found("step", -wrenches("step"))
    assert finding.kind == "forces_axes"
    assert "wrong sign" in finding.message


def test_wrenches_of_another_scale_are_told_once() -> None:
    (finding,) = found("step", 0.85 * wrenches("step"))
    assert finding.kind == "forces_scale"
    assert abs(finding.numbers["ratio"] - 0.85) < 5.0 * finding.numbers["error"]
