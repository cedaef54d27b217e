"""Robots from MJCF: the same efforts as MuJoCo's, and hostile files that harm nobody."""

from pathlib import Path

import numpy as np
import pytest

import sdpid
from sdpid.errors import ModelError
from sdpid.robot.description import mjcf
from sdpid.robot.model.base_parameters import generic_states
from sdpid.robot.model.model import RobotModel
from tests.helpers.refusals import refuses

mujoco = pytest.importorskip("mujoco")

T = np.linspace(0.0, 5.0, 500)
ARM = """<?xml version="1.0"?>
<mujoco model="odd arm">
  <compiler angle="radian"/>
  <option gravity="1 -2 -9"/>
  <default><joint armature="0.5" damping="3" frictionloss="1"/><geom density="700"/></default>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="base" pos="0.1 0.2 0.3" euler="0.3 -0.2 0.5">
      <geom type="box" size="0.1 0.1 0.1"/>
      <body name="upper" pos="0 0 0.2" quat="0.9 0.1 -0.3 0.2">
        <joint name="j1" axis="0.3 0.2 1" pos="0.05 -0.02 0.1" ref="0.4" range="-1 2"
               limited="true"/>
        <inertial pos="0.1 0.2 0.05" mass="2" fullinertia="0.2 0.3 0.25 0.01 0.02 -0.03"/>
        <body pos="0.3 0 0"><geom type="sphere" size="0.08"/></body>
        <body name="wrist" pos="0 0.4 0" euler="0.1 0.2 0.3">
          <joint name="j2" type="slide" axis="1 0 1" ref="0.2"/>
          <joint axis="0 1 0" pos="0 0 0.3" actuatorfrcrange="-5 4" actuatorfrclimited="true"/>
          <geom type="capsule" size="0.03" fromto="0 0 0 0.1 0.2 0.5"/>
        </body>
      </body>
      <body name="second" pos="0 -0.4 0">
        <joint name="j4" axis="0 0 -1" ref="0.1"/>
        <geom type="cylinder" size="0.05 0.2" pos="0.1 0 0"/>
      </body>
    </body>
  </worldbody>
</mujoco>"""
FOLLOWER = ARM.replace(
    "</mujoco>",
    '<equality><joint joint1="j4" joint2="j1" polycoef="0.3 -2 0 0 0"/></equality></mujoco>',
)
FLOATING = ARM.replace('<geom type="box"', '<freejoint/><geom type="box"')


def mujoco_efforts(text: str, robot: RobotModel, states: tuple[np.ndarray, ...]) -> np.ndarray:
    """Return MuJoCo's efforts of the rigid bodies alone."""
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    model.dof_damping[:] = model.dof_armature[:] = 0.0
    data = mujoco.MjData(model)
    out = []
    for q, v, a in zip(*states, strict=True):
        data.qpos[:] = robot.expansion @ q + robot.offset
        data.qvel[:], data.qacc[:] = robot.expansion @ v, robot.expansion @ a
        mujoco.mj_inverse(model, data)
        out.append(robot.expansion.T @ data.qfrc_inverse)
    return np.array(out)


@pytest.mark.parametrize("text", [ARM, FOLLOWER], ids=["tree", "equality"])
def test_efforts_are_those_of_mujoco(text: str, tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(text)
    robot = sdpid.load_robot(path)
    assert robot.name == "odd arm"
    np.testing.assert_array_equal(robot.gravity, [1, -2, -9])
    states = generic_states(robot, 20, 1)
    expected = mujoco_efforts(text, robot, states)
    found = robot.inverse_dynamics(robot.prior, *states)
    # Products and sums of a dozen numbers of order 1 to 100.
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-11)
    assert sdpid.load_robot(text).joint_names == robot.joint_names


def test_names_limits_and_bodies() -> None:
    robot = sdpid.load_robot(ARM)
    assert robot.joint_names == ("j1", "j2", "wrist_joint_2", "j4")
    assert robot.link_names == ("upper", "j2", "wrist", "second")
    np.testing.assert_array_equal(robot.position_limits[0], [-1, 2])
    assert np.isinf(robot.position_limits[1:]).all()
    np.testing.assert_array_equal(robot.effort_limits, [np.inf, np.inf, 5, np.inf])
    assert sdpid.load_robot(FOLLOWER).joint_names == ("j1", "j2", "wrist_joint_2")
    viscous, coulomb = sdpid.load_robot(FOLLOWER).described_friction()
    # Joint 4 turns twice as fast as joint 1 and hangs on it.
    np.testing.assert_array_equal(viscous, [3 + 4 * 3, 3, 3])
    np.testing.assert_array_equal(coulomb, [1 + 2 * 1, 1, 1])


def test_a_free_joint_floats_the_base() -> None:
    robot = sdpid.load_robot(FLOATING)
    assert robot.free_flyer
    assert (robot.n, robot.n_links) == (10, 5)
    assert robot.link_names[0] == "base"


def test_what_is_read_survives_being_written(tmp_path: Path) -> None:
    """A robot from MJCF can be written as MJCF from its kinematics and read again."""
    from sdpid.output.robots.mjcf import write_mjcf
    from tests.output.test_urdf import bodies, estimate_of, problem_of

    problem = problem_of(sdpid.load_robot(FOLLOWER))
    links = bodies(np.random.default_rng(0), 4)
    write_mjcf(estimate_of(problem, links), target=tmp_path / "out.xml")
    again = sdpid.load_robot(tmp_path / "out.xml")
    states = generic_states(again, 10, 2)
    expected = problem.robot.inverse_dynamics(links, *states)
    found = again.inverse_dynamics(again.prior, *states)
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-9 * np.abs(expected).max())


REFUSED = [
    (ARM.replace('name="j4" axis="0 0 -1" ref="0.1"', 'name="j4" type="ball"'), "'j4' is a ball"),
    (FOLLOWER.replace("-2 0 0 0", "-2 1 0 0"), "joint equality, which is not supported"),
    ("<mujoco><worldbody><nonsense/></worldbody></mujoco>", "MuJoCo cannot parse it"),
    ("<mujoco><worldbody><body/></worldbody></mujoco>", "no moving joint"),
    ("<mujoco><worldbody><body><joint/></body></worldbody></mujoco>", "MuJoCo cannot compile it"),
    (FLOATING.replace("<worldbody>", "<worldbody><body><freejoint/><geom size='1'/></body>"), "Fr"),
]


@pytest.mark.parametrize(("text", "says"), REFUSED)
def test_refusals(text: str, says: str) -> None:
    refuses(ModelError, says, sdpid.load_robot, text)


SPRING = """<mujoco><worldbody><body name="a" gravcomp="1"><joint name="j" stiffness="3"
  springref="90"/><joint name="k" axis="1 0 0"/><geom size="1"/></body></worldbody>
  <actuator><motor joint="k"/><position name="p" joint="j" kp="5"/><motor joint="k" gear="9"/>
  </actuator></mujoco>"""


def test_what_the_model_lacks_is_told() -> None:
    robot = sdpid.load_robot(SPRING)
    log = sdpid.Recording(time=T, position=np.sin([T, 2.0 * T]).T, effort=np.cos([T, 2.0 * T]).T)
    told = {each.kind: each for each in sdpid.inspect_recording(log, robot).findings}
    spring = "spring at j (stiffness 3, springref 1.571), gravcomp 1 of body a; they are taken for"
    assert spring in told["forces_ignored"].message
    assert told["forces_ignored"].severity == "warning"
    assert "p (gain 5, gear 1), 3 (gain 1, gear 9); efforts" in told["actuators_ignored"].message
    assert not sdpid.load_robot(ARM).forces + sdpid.load_robot(ARM).actuators


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('gravity="1 -2 -9"', 'gravity="1 -2 inf"'), "gravity is"),
        (('quat="0.9 ', 'quat="inf '), "body_quat is not finite"),
        (('ref="0.4"', 'ref="nan"'), "qpos0 is not finite"),
    ],
)
def test_numbers_that_are_none(change: tuple[str, str], words: str) -> None:
    refuses(ModelError, words, sdpid.load_robot, ARM.replace(*change))


def test_a_root_is_refused() -> None:
    with pytest.raises(ModelError, match="an MJCF says itself whether its base floats"):
        sdpid.load_robot(ARM, root="free_flyer")


def test_a_file_that_includes_itself_ends_nothing_but_a_child(tmp_path: Path) -> None:
    path = tmp_path / "self.xml"
    path.write_text('<mujoco><include file="self.xml"/></mujoco>')
    from sdpid.assurance.descriptions.audit import audit_urdf

    for read in (sdpid.load_robot, audit_urdf):
        refuses(ModelError, r"self\.xml", read, path)


def test_endless_replication_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mjcf, "TIMEOUT", 2.0)
    body = '<body><joint/><geom size="1"/></body>'
    for _ in range(3):
        body = f'<replicate count="100000" offset="1 0 0">{body}</replicate>'
    with pytest.raises(ModelError, match=r"took more than 2 s|memory|crashed"):
        sdpid.load_robot(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
