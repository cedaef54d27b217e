"""Stretches of a recording move as SciPy integrates them."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import sdpid
from sdpid.experiment.simulation.arm import SimulatedArm
from sdpid.experiment.simulation.open_loop import Track, simulate_stretches
from sdpid.experiment.simulation.tip import tip_positions
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.terms import Coulomb
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.robot.model.geometry import link_placements
from tests.helpers.data import random_theta
from tests.helpers.robots import TREE, small_arm

TERMS = (Coulomb(width=0.05), "viscous", "offset")
EFFORT = np.array([1.3, -0.7])


def test_stretches_agree_with_scipy() -> None:
    robot = small_arm(2)
    theta = random_theta(robot, np.random.default_rng(3), TERMS)
    terms = FrictionModel.from_terms(TERMS, robot.joint_names)
    model = RobotDynamics(robot=robot, terms=terms, theta=theta)

    def effort(t: np.ndarray | float) -> np.ndarray:
        return EFFORT * np.sin(2.0 * np.asarray(t)[..., None] + [0.0, 1.0])

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        return np.concatenate([x[2:], model.forward_dynamics(x[:2], x[2:], effort(t))])

    start = np.array([0.3, -0.5, 0.2, 0.4])
    time = np.arange(0.0, 1.001, 0.02)
    exact = solve_ivp(rate, (0.0, 1.0), start, t_eval=time, rtol=1e-9, atol=1e-10).y.T
    samples = sdpid.Samples(
        position=exact[:, :2],
        velocity=exact[:, 2:],
        acceleration=np.zeros((len(time), 2)),
        effort=effort(time),
        time=time,
    )
    errors = []
    for step in (0.005, 0.0025):
        track = Track.of(samples, step=step)
        assert track.step == pytest.approx(step)
        every = np.array([0, round(0.3 / step)])
        free = np.array([[True, True], [True, True]])
        after = [track.steps(0.1), track.steps(0.5)]
        found = simulate_stretches(SimulatedArm.of(model), track, every, free, after)
        measured = track.position[every[:, None] + after]
        errors.append(np.abs(found - measured).max())
        assert np.isfinite(found).all()
    assert errors[0] < 2e-3
    assert errors[1] < 0.6 * errors[0] + 1e-5
    # A joint that is not free is on the record.
    free[:, 0] = False
    found = simulate_stretches(SimulatedArm.of(model), track, every, free, after)
    assert np.array_equal(found[:, :, 0], measured[:, :, 0])
    assert np.abs(found - measured).max() < 2e-3


def test_starts_stay_within_pieces() -> None:
    time = np.concatenate([np.arange(50), 80 + np.arange(30)]) / 50.0
    zero = np.zeros((80, 1))
    samples = sdpid.Samples(
        position=time[:, None],
        velocity=zero + 1.0,
        acceleration=zero,
        effort=zero,
        time=time,
        starts=(0, 50),
    )
    track = Track.of(samples)
    first = track.starts(0.5, 0.1)
    ends = first + track.steps(0.5)
    assert np.array_equal(track.piece[first], track.piece[ends])
    assert set(track.piece[first]) == {0, 1}
    assert track.time[ends] - track.time[first] == pytest.approx(0.5)
    assert track.position[:, 0] == pytest.approx(track.time)


def test_the_tip_is_where_the_last_link_ends() -> None:
    robot = sdpid.load_robot(TREE)
    q = np.random.default_rng(0).uniform(-0.5, 0.5, (4, robot.n))
    q[2, 0] = np.nan
    found = tip_positions(robot, q)
    assert np.isnan(found[2]).all()
    last = robot.link_names.index("left_slide")
    for k in (0, 1, 3):
        assert found[k] == pytest.approx(link_placements(robot, q[k])[last][:3, 3], abs=1e-12)
