"""Fits of positions under a known law: against MuJoCo's rollouts, differences and the truth."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

import sdpid
from sdpid.errors import DataError, SolverError
from sdpid.estimation.positions.choose import CONSTANTS, choose_forward
from sdpid.estimation.positions.drives import UNITS, DriveNumbers
from sdpid.estimation.positions.fit import SolvedRollouts, fit_positions
from sdpid.estimation.positions.rollout import STEP, CommandedLog
from sdpid.experiment.simulation.law import DriveCommands
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.dynamics import RobotDynamics

LEGS = """<mujoco><option timestep="0.002"/><worldbody><body name="hung" pos="0 0 1">
<geom size=".1" mass="1" contype="0" conaffinity="0"/>
{legs}</body></worldbody></mujoco>"""
LEG = """<body name="{0}thigh" pos="0 {1} 0"><joint name="{0}hip" axis="0 1 0" {2}/>
<geom type="capsule" fromto="0 0 0 0 0 -.2" size=".03" mass="1" contype="0" conaffinity="0"/>
<body name="{0}calf" pos="0 0 -.2"><joint name="{0}knee" axis="0 1 0" {2}/>
<geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02" mass=".3" contype="0" conaffinity="0"/>
</body></body>"""
DRIVES = 'armature="0.01" damping="0.3" frictionloss="0.25"'
N, RATE = 4, 200.0
KP, KD = 20.0, 1.0


@pytest.fixture(scope="module")
def legs(tmp_path_factory):
    """Two legs of two joints, in MuJoCo and as links without drives."""
    text = LEGS.format(legs=LEG.format("l", 0.1, DRIVES) + LEG.format("r", -0.1, DRIVES))
    path = tmp_path_factory.mktemp("legs") / "legs.xml"
    path.write_text(text)
    links = links_of_legs(sdpid.load_robot(path))
    return mujoco.MjModel.from_xml_string(text), links


def links_of_legs(robot):
    """The described links without drives."""
    terms = FrictionModel.from_terms((), robot.joint_names)
    return RobotDynamics(robot=robot, terms=terms, theta=np.asarray(robot.prior).ravel())


def commanded(seconds):
    """Steps of 20 ms along a chirp, whose speed rises."""
    time = np.arange(int(seconds * RATE)) / RATE
    held = np.floor(time * 50.0) / 50.0
    phase = 3.0 * held + 0.25 * held**2
    angle = [0.5 * np.sin(phase + 0.9 * j) + 0.15 * np.sin(2.3 * phase + j) for j in range(N)]
    return time, np.stack(angle, axis=1)


def drives(**rows):
    """DriveNumbers of the legs."""
    made = DriveNumbers(values=np.zeros((8, N)), middle=np.zeros(N), delay=rows.pop("delay", 0.0))
    usual = {"armature": 0.01, "damping": 0.3, "friction": 0.25, "kp": KP, "kd": KD}
    return made.with_rows(**usual | rows)


def followed(time, position, command, limit=np.inf):
    """A log of positions under held commands."""
    commands = DriveCommands(
        command=command, feedforward=0.0 * command, limit=np.full(N, limit), held=True, note=""
    )
    return CommandedLog(time=time, position=position, commands=commands)


def simulated(model, told, start, limit=np.inf):
    """MuJoCo's positions under commands (K, n), one a step."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = start
    out = [data.qpos.copy()]
    for command in told:
        effort = KP * (command - data.qpos) - KD * data.qvel
        data.qfrc_applied[:] = np.clip(effort, -limit, limit)
        mujoco.mj_step(model, data)
        out.append(data.qpos.copy())
    return np.array(out)


@pytest.mark.parametrize("limit", [np.inf, 2.0])
def test_rollout_is_that_of_mujoco(legs, limit):
    model, links = legs
    time, command = commanded(4.0)
    rollout = followed(time, command, command, limit).rollout(links)
    start = np.stack([command[0], np.zeros(N)])
    reference = simulated(model, rollout.commands(0.006)[0], start, limit)
    noise = 1e-3 * np.random.default_rng(0).standard_normal(reference.shape)
    motion = rollout.run(drives(delay=0.006), start, (reference + noise)[: rollout.count + 1])
    assert motion.converged
    assert np.abs(motion.position - reference).max() < 1e-6
    assert 0.001 < np.mean(motion.side == 0.0) < 0.5
    assert np.mean(motion.free) < 0.999 or np.isinf(limit)


def test_rollout_is_solved_far_from_the_measured_motion(legs):
    _, links = legs
    time, command = commanded(2.0)
    # Joints turn far, and the log says that nothing moved.
    rollout = followed(time, 0.0 * command, 3.0 * command).rollout(links)
    start = np.stack([3.0 * command[0], np.zeros(N)])
    motion = rollout.run(drives(kp=100.0, kd=0.5, damping=0.05, friction=0.05), start)
    assert motion.converged
    assert np.ptp(motion.position) > 3.0


def test_columns_are_the_differences_of_rollouts(legs):
    _, links = legs
    time, command = commanded(2.0)
    rollout = followed(time, command, command).rollout(links)
    start, rows = np.stack([command[0], np.zeros(N)]), tuple(UNITS)
    at = drives(delay=0.005, slope=0.05, curve=0.1, offset=0.02)
    motion = rollout.run(at, start)
    blocks = rollout.columns(motion, at, rows, True)
    assert [joints.tolist() for joints, _ in blocks] == [[0, 1], [2, 3]]
    for k, row in enumerate((*rows, "delay")):
        nudge = 1e-5 if row == "delay" else 1e-4 * max(1.0, abs(at[row][1]))
        sides = []
        for sign in (1.0, -1.0):
            moved = at[row].copy() if row != "delay" else None
            if moved is None:
                near = replace(at, delay=at.delay + sign * nudge)
            else:
                moved[1] += sign * nudge
                near = at.with_rows(**{row: moved})
            sides.append(rollout.positions(rollout.run(near, start, motion.position)))
        expected = (sides[0] - sides[1])[:, :2] / (2.0 * nudge)
        found = blocks[0][1][:, :, 2 * k + (row != "delay")]
        assert np.abs(found - expected).max() < 0.03 * np.abs(expected).max(), row


def test_fit_finds_drives_and_delay(legs):
    model, links = legs
    time, command = commanded(6.0)
    rollout = followed(time, command, command).rollout(links)
    start = np.stack([command[0], np.zeros(N)])
    truth = simulated(model, rollout.commands(0.007)[0], start)
    grid = STEP * np.arange(len(truth))
    position = np.stack([np.interp(time, grid, truth[:, j]) for j in range(N)], axis=1)
    position += 1e-4 * np.random.default_rng(0).standard_normal(position.shape)
    begin = drives(armature=0.02, damping=0.1, friction=0.1)
    fit = fit_positions(
        SolvedRollouts.of([followed(time, position, command).rollout(links)], begin), CONSTANTS
    )
    assert fit.rms < 1.05e-4
    assert abs(fit.drives.delay - 0.007) < 1e-4
    assert np.abs(fit.drives["armature"] - 0.01).max() < 5e-4
    assert np.abs(fit.drives["damping"] - 0.3).max() < 0.01
    assert np.abs(fit.drives["friction"] - 0.25).max() < 0.005
    errors = [fit.drives[row] - drives()[row] for row in CONSTANTS]
    deviations = np.sqrt(np.diag(fit.covariance))[: 3 * N]
    assert np.all(np.abs(np.concatenate(errors)) < 5.0 * deviations)


@pytest.mark.parametrize("slope", [0.0, 0.2])
def test_friction_over_position_is_chosen_where_it_is(legs, slope):
    _, links = legs
    time, command = commanded(8.0)
    rollout = followed(time, command, command).rollout(links)
    start = np.stack([command[0], np.zeros(N)])
    truth = drives(delay=0.004, slope=slope)
    position = rollout.positions(rollout.run(truth, start))
    position += 1e-4 * np.random.default_rng(1).standard_normal(position.shape)
    choice, fit = choose_forward([followed(time, position, command)], links, drives(armature=0.02))
    assert choice.rows == (CONSTANTS if slope == 0.0 else (*CONSTANTS, "slope"))
    assert choice.open[0] <= 0.004 <= choice.open[1]
    assert abs(choice.delay - 0.004) < 5e-4
    assert np.abs(fit.drives["slope"] - slope).max() < 0.01


def test_refusals(legs):
    _, links = legs
    time, command = commanded(3.0)
    with pytest.raises(DataError, match=r"has 3 s; .* needs 4\.3 s"):
        choose_forward([followed(time, command, command)], links, drives())
    with pytest.raises(SolverError, match="does not follow its commands"):
        fit_positions(
            SolvedRollouts.of([followed(time, command, command).rollout(links)], drives(kp=-2e3)),
            CONSTANTS,
        )
