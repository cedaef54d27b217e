"""An effort that ruins the parameters of other joints is found by the fit without it."""

import numpy as np
import pytest

import sdpid
from sdpid.experiment.recording.recording import Recording
from tests.helpers.robots import LIFTED

ROBOT = sdpid.load_robot(LIFTED)
T = np.arange(0.0, 15.0, 0.02)
# Without an offset nothing but masses can make the effort of a lift small.
OPTIONS = {"friction": ("coulomb", "viscous"), "effects": "none", "intervals": False}


def recorded(seed: int, gain: float) -> Recording:
    """Return a recording whose lift has an effort in another unit, with a drive's own noise."""
    rng = np.random.default_rng(seed)
    rate, phase = rng.uniform(1.0, 4.0, (2, 3, ROBOT.n))
    size = np.array([0.02, 0.6, 0.6, 0.6])
    angle = rate * T[:, None, None] + phase
    q, v, a = ((size * rate**k * np.sin(angle + k * np.pi / 2.0)).sum(axis=1) for k in range(3))
    bodies = ROBOT.prior * rng.uniform(0.85, 1.15, (ROBOT.n_links, 1))
    effort = ROBOT.inverse_dynamics(bodies, q, v, a) + np.sign(v) * [5.0, 1.0, 0.5, 0.2] + 0.3 * v
    effort += rng.standard_normal(effort.shape) * [1.0, 0.1, 0.05, 0.02]
    effort[:, 0] = gain * effort[:, 0] + 0.2 * np.sin(0.7 * T)
    return Recording(time=T, position=q, velocity=v, effort=effort, joint_names=ROBOT.joint_names)


@pytest.mark.parametrize("seed", range(2))
def test_the_effort_that_spoils_the_others_is_left_out(seed: int) -> None:
    wrong, right = recorded(seed, 0.02), recorded(seed, 1.0)
    accepted = ("effort_scale", "effort_small")
    result = sdpid.identify(ROBOT, wrong, accept=accepted, **OPTIONS)
    finding = result.findings[0]
    assert (finding.kind, finding.joint) == ("effort_spoils", "lift")
    assert str(finding) in result.notes
    assert result.problem.samples.used.any(axis=0).tolist() == [False, True, True, True]
    used = sdpid.identify(ROBOT, wrong, accept=(*accepted, finding.kind), **OPTIONS)
    # The arm is predicted as it is where the lift is left out by hand, and many times better.
    byhand = sdpid.identify(ROBOT, right, without_effort=("lift",), **OPTIONS)
    assert np.allclose(result.training.rmse[1:], byhand.training.rmse[1:], rtol=1e-3)
    assert np.all(used.training.rmse[1:3] > 1.2 * result.training.rmse[1:3])
    assert "worse than least squares on what was held out, do not use it" in used.headline.baseline


def test_a_sound_recording_loses_nothing() -> None:
    result = sdpid.identify(ROBOT, recorded(0, 1.0), **OPTIONS)
    assert not [each for each in result.findings if each.kind == "effort_spoils"]
    assert result.problem.samples.used.any(axis=0).all()
