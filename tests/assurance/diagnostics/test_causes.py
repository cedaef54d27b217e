"""What an error goes with is named, where it is put in; noise has no cause."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from sdpid._common.arrays import Array
from sdpid.assurance.diagnostics.causes import Cause, find_causes, held_back
from sdpid.assurance.diagnostics.residuals import joint_errors
from sdpid.assurance.diagnostics.validation import Validation
from sdpid.experiment.processing.samples import Samples
from tests.helpers.data import random_links
from tests.helpers.identified import RATE
from tests.helpers.robots import small_arm

ROBOT = small_arm(3)
BODIES = random_links(np.random.default_rng(5), 3)


def moved(seconds: float = 120.0) -> Samples:
    """Return samples of a slow random motion of a tilted-axis arm, predicted but for noise."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, seconds, 1.0 / RATE)
    w = rng.uniform(0.3, 4.0, (6, ROBOT.n))
    angle = w * t[:, None, None] + rng.uniform(0.0, 6.0, (6, ROBOT.n))
    q = np.sin(angle).sum(axis=1)
    v = (w * np.cos(angle)).sum(axis=1)
    a = -(w**2 * np.sin(angle)).sum(axis=1)
    effort = ROBOT.inverse_dynamics(BODIES, q, v, a)
    return Samples(position=q, velocity=v, acceleration=a, effort=effort, time=t)


SAMPLES = moved()


def causes(error: Array) -> dict[str, Cause]:
    """Return the causes that are found of an error (K,) of the second joint, beside noise."""
    rng = np.random.default_rng(8)
    size = 0.1 * SAMPLES.effort.std(axis=0)
    effort = SAMPLES.effort + 0.5 * size * rng.standard_normal(SAMPLES.effort.shape)
    effort[:, 1] += size[1] * error / np.sqrt(np.mean(error**2))
    samples = replace(SAMPLES, effort=effort)
    fit = Validation.of_prediction(ROBOT.joint_names, samples, SAMPLES.effort)
    return find_causes(ROBOT, BODIES, samples, fit, joint_errors(samples, fit))


def tilted(samples: Samples) -> Array:
    """Return how the second joint's effort differs on a base that stands tilted by 1.5 degrees."""
    states = samples.position, samples.velocity, samples.acceleration
    axis = np.array([0.6, 0.8, 0.0])
    axis -= ROBOT.gravity * (axis @ ROBOT.gravity) / (ROBOT.gravity @ ROBOT.gravity)
    gravity = ROBOT.gravity + 0.026 * np.cross(axis, ROBOT.gravity)
    leaning = ROBOT.with_gravity(gravity).inverse_dynamics(BODIES, *states)
    return (leaning - samples.effort)[:, 1]


def of_channel(factor: float) -> dict[str, Cause]:
    """Return the causes where the second joint's effort is measured with another factor."""
    rng = np.random.default_rng(8)
    effort = SAMPLES.effort + 0.05 * SAMPLES.effort.std(axis=0) * rng.standard_normal(
        SAMPLES.effort.shape
    )
    effort[:, 1] *= factor
    samples = replace(SAMPLES, effort=effort)
    fit = Validation.of_prediction(ROBOT.joint_names, samples, SAMPLES.effort)
    return find_causes(ROBOT, BODIES, samples, fit, joint_errors(samples, fit))


@pytest.mark.parametrize(("factor", "kind"), [(-1.0, "sign"), (0.1, "scale"), (1.7, "scale")])
def test_a_wrong_sign_or_scale_of_the_effort_is_no_missing_effect(factor: float, kind: str) -> None:
    found = of_channel(factor)
    assert {name: each.kind for name, each in found.items()} == {ROBOT.joint_names[1]: kind}
    assert found[ROBOT.joint_names[1]].share > 0.9


def test_what_constraints_hold_back_has_no_shape_of_an_effect() -> None:
    shape = SHAPES["acceleration"](SAMPLES)
    second = ROBOT.joint_names[1]
    size = 0.5 * SAMPLES.effort[:, 1].std()
    effort = np.array(SAMPLES.effort)
    effort[:, 1] += size * shape / shape.std()
    samples = replace(SAMPLES, effort=effort)
    fit = Validation.of_prediction(ROBOT.joint_names, samples, SAMPLES.effort)
    for left, expected in ((0.9, ("acceleration",)), (0.3, ())):
        less = effort + left * (SAMPLES.effort - effort)
        free = Validation.of_prediction(ROBOT.joint_names, samples, less)
        found = find_causes(ROBOT, BODIES, samples, fit, joint_errors(samples, fit), free)
        assert tuple(each.kind for each in found.values()) == expected
        assert held_back(fit, free) == (() if expected else (second,))
    # Nor has an error beside which the mean predicts better.
    effort[:, 1] += 20.0 * SAMPLES.effort[:, 1].std()
    samples = replace(SAMPLES, effort=effort)
    fit = Validation.of_prediction(ROBOT.joint_names, samples, SAMPLES.effort)
    assert find_causes(ROBOT, BODIES, samples, fit, joint_errors(samples, fit)) == {}


SHAPES: dict[str, Callable[[Samples], Array]] = {
    "direction": lambda s: np.sign(s.velocity[:, 1]),
    "velocity": lambda s: s.velocity[:, 1],
    "speed": lambda s: np.cos(0.6 * s.velocity[:, 1]),
    "acceleration": lambda s: s.acceleration[:, 1],
    "load": lambda s: np.abs(s.effort[:, 1]) * np.sign(s.velocity[:, 1]),
    "gravity": tilted,
    "position": lambda s: np.sin(s.position[:, 1] + 1.0),
    "frequency": lambda s: np.sin(2.0 * np.pi * 15.0 * np.asarray(s.time)),
}


@pytest.mark.parametrize("kind", SHAPES)
def test_the_cause_of_an_error_is_named(kind: str) -> None:
    found = causes(SHAPES[kind](SAMPLES))
    second = ROBOT.joint_names[1]
    # The others have noise alone.
    assert list(found) == [second]
    assert found[second].kind == kind
    assert found[second].share > 0.5
    if kind == "frequency":
        assert found[second].frequency == pytest.approx(15.0, abs=0.1)


def test_noise_has_no_cause() -> None:
    rng = np.random.default_rng(1)
    assert causes(rng.standard_normal(SAMPLES.n_samples)) == {}
    # Neither has noise that is alike for a second, however well it fits some shape by chance.
    smooth = np.convolve(rng.standard_normal(SAMPLES.n_samples), np.ones(50), "same")
    assert causes(smooth) == {}


def test_a_robot_without_gravity_or_motion_has_no_cause() -> None:
    floating = ROBOT.with_gravity([0.0, 0.0, 0.0])
    still = {name: np.zeros_like(SAMPLES.velocity) for name in ("velocity", "acceleration")}
    samples = replace(SAMPLES, **still)
    fit = Validation.of_prediction(ROBOT.joint_names, samples, SAMPLES.effort)
    assert find_causes(floating, BODIES, samples, fit, joint_errors(samples, fit)) == {}
