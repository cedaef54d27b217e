"""Kinematic tables, closed loops of descriptions, and robots from MJCF."""

import importlib.util
import math
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sdpid
from sdpid import load_robot
from sdpid._common.arrays import Array
from sdpid.errors import DataError, ModelError
from sdpid.robot.description.catalog import bundled_folder
from sdpid.robot.description.dh_table import DhJoint, DhTable
from sdpid.robot.description.xml import matrix_rpy, rpy_matrix
from sdpid.robot.model.base_parameters import generic_states
from sdpid.robot.model.jacobians import frame_axes, frame_gaps
from sdpid.robot.model.model import RobotModel
from tests.helpers.arm_files import ARM_URDF
from tests.helpers.linkages import mjcf, urdf
from tests.helpers.refusals import refuses
from tests.helpers.strategies import ANGLES, SEEDS, bodies, dh_tables, rotations
from tests.helpers.tolerances import KINEMATICS

DENSO = bundled_folder("denso_vp6242")


def rotation(axis: int, angle: float) -> Array:
    vector = np.zeros(3)
    vector[axis] = angle
    transform = np.eye(4)
    transform[:3, :3] = pin.exp3(vector)
    return transform


def translation(axis: int, length: float) -> Array:
    transform = np.eye(4)
    transform[axis, 3] = length
    return transform


def lengths(joint: DhJoint) -> tuple[float, float]:
    """Return the lengths along x and z."""
    return (joint.d, joint.r) if joint.a is None else (joint.a, joint.d)


def product(table: DhTable, q: Array) -> list[Array]:
    """Return the frames of a table, written down again from its definition."""
    transform = np.eye(4)
    transform[:3, :3] = pin.rpy.rpyToMatrix(*table.base_rpy)
    transform[:3, 3] = table.base_translation
    frames = []
    for joint, x in zip(table.joints, q, strict=True):
        theta = joint.theta + (x if joint.kind == "revolute" else 0.0)
        along_x, along_z = lengths(joint)
        along_z += x if joint.kind == "prismatic" else 0.0
        about_x = rotation(0, joint.alpha) @ translation(0, along_x)
        about_z = rotation(2, theta) @ translation(2, along_z)
        step = about_x @ about_z if table.convention == "modified" else about_z @ about_x
        transform = transform @ step
        frames.append(transform)
    return frames


def pinocchio_frames(robot: sdpid.RobotModel, table: DhTable, q: Array) -> list[Array]:
    """Return the table's frames from Pinocchio's forward kinematics."""
    model, data = robot.pin_model, robot.pin_model.createData()
    pin.framesForwardKinematics(model, data, robot.configuration(q[None])[0])
    frames = [np.asarray(data.oMi[i].homogeneous) for i in range(1, model.njoints)]
    if table.convention == "standard":
        tip = data.oMf[model.getFrameId("tip")].homogeneous
        np.testing.assert_allclose(tip, product(table, q)[-1], rtol=0, atol=KINEMATICS)
        # The joint frame stands before the fixed end of its row.
        frames = [
            frame @ translation(0, lengths(joint)[0]) @ rotation(0, joint.alpha)
            for frame, joint in zip(frames, table.joints, strict=True)
        ]
    return frames


@given(dh_tables(), SEEDS)
def test_pinocchio_agrees_with_the_product(table: DhTable, seed: int) -> None:
    robot = sdpid.RobotModel.from_mdh(table)
    q = np.random.default_rng(seed).uniform(-np.pi, np.pi, robot.n)
    expected = product(table, q)
    np.testing.assert_allclose(table.forward_kinematics(q), expected, rtol=0, atol=KINEMATICS)
    frames = pinocchio_frames(robot, table, q)
    np.testing.assert_allclose(frames, expected, rtol=0, atol=KINEMATICS)
    np.testing.assert_allclose(robot.gravity, table.gravity)


@given(dh_tables(), st.data())
def test_link_inertias_survive_the_urdf(table: DhTable, data: st.DataObject) -> None:
    given_links = np.stack([data.draw(bodies()) for _ in table.joints])
    robot = sdpid.RobotModel.from_mdh(table, inertias=given_links)
    np.testing.assert_allclose(robot.prior, given_links, rtol=0, atol=1e-13)


def test_denso_urdf_is_what_its_script_writes(monkeypatch: pytest.MonkeyPatch) -> None:
    text = (DENSO / "denso_vp6242.urdf").read_text(encoding="utf-8")
    assert DhTable.from_toml(DENSO / "kinematics.toml").to_urdf() == text
    spec = importlib.util.spec_from_file_location("make_urdf", DENSO / "make_urdf.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    written: dict[Path, str] = {}
    monkeypatch.setattr(script, "atomic_write_text", written.__setitem__)
    script.main()
    assert written == {DENSO / "denso_vp6242.urdf": text}


def test_denso_limits_are_those_of_the_table(denso: sdpid.RobotModel) -> None:
    table = DhTable.from_toml(DENSO / "kinematics.toml")
    assert denso.joint_names == tuple(f"joint_{i}" for i in range(1, 7))
    np.testing.assert_array_equal(denso.position_limits, [(j.lower, j.upper) for j in table.joints])
    np.testing.assert_array_equal(denso.velocity_limits, [j.velocity for j in table.joints])
    assert np.all(np.isinf(denso.effort_limits))
    # Joints of which none are told have none.
    robot = sdpid.RobotModel.from_mdh([DhJoint(), DhJoint(kind="prismatic")])
    np.testing.assert_array_equal(robot.position_limits, [[-np.inf, np.inf]] * 2)
    assert np.all(np.isinf(robot.velocity_limits))


@given(rotations(), ANGLES, st.sampled_from([math.pi / 2, -math.pi / 2]), ANGLES)
def test_rpy_round_trip(R: Array, roll: float, pitch: float, yaw: float) -> None:
    # Also where roll and yaw turn about the same axis.
    for turned in (R, rpy_matrix((roll, pitch, yaw))):
        rpy = matrix_rpy(turned)
        np.testing.assert_allclose(rpy_matrix(rpy), turned, rtol=0, atol=KINEMATICS)
        np.testing.assert_allclose(rpy_matrix(rpy), pin.rpy.rpyToMatrix(*rpy), rtol=0, atol=1e-14)


ROW = {"alpha": 0.0, "d": 0.1, "theta": 0.0, "r": 0.2}


def test_sources_of_a_table_agree() -> None:
    table = DhTable.from_toml(DENSO / "kinematics.toml")
    rows = [{"alpha": j.alpha, "d": j.d, "theta": j.theta, "r": j.r} for j in table.joints]
    options: dict[str, Any] = {"base_translation": (0.0, 0.0, 0.28), "gravity": (0.0, 0.0, -9.81)}
    q = np.linspace(-1.0, 1.0, 6)[None]
    v, a = 2.0 * q, -3.0 * q
    expected = sdpid.RobotModel.from_mdh(table).regressor(q, v, a)
    for robot in (
        sdpid.RobotModel.from_mdh(DENSO / "kinematics.toml"),
        sdpid.RobotModel.from_mdh(rows, **options),
        sdpid.RobotModel.from_mdh([DhJoint(**row) for row in rows], **options),
        sdpid.RobotModel.from_mdh({"joint": rows, "base": {"translation": [0, 0, 0.28]}}),
        sdpid.load_robot("denso_vp6242"),
    ):
        np.testing.assert_allclose(robot.regressor(q, v, a), expected, rtol=0, atol=1e-12)


def one(**changes: Any) -> list[dict[str, Any]]:
    return [ROW | changes]


# What is no table, or goes with none, by what is said of it.
NO_TABLES: dict[str, tuple[Any, dict[str, Any]]] = {
    "no joints": ([], {}),
    r"no \[\[joint\]\]": ({}, {}),
    r"no \[\[joint\]\].*": ({"joint": "revolute"}, {}),
    "helical": (one(kind="helical"), {}),
    "beta": (one(beta=1.0), {}),
    "row 1: d is nan": (one(d=math.nan), {}),
    "row 2: alpha": ([ROW, *one(alpha=math.inf)], {}),
    "r is '0.2'": (one(r="0.2"), {}),
    "both limits": (one(lower=-1.0), {}),
    "above the upper": (one(lower=1.0, upper=-1.0), {}),
    "lower is nan": (one(lower=math.nan, upper=1.0), {}),
    "lower is '-1'": (one(lower="-1", upper=1.0), {}),
    "velocity": (one(velocity=math.nan), {}),
    "repeat": (one(name="a") * 2, {}),
    "a row is 3.0": ([3.0], {}),
    "row is 3.0": ({"joint": [3.0]}, {}),
    "denavit": ({"joint": [ROW], "convention": "denavit"}, {}),
    "row 2: r is 0.1 in a table with lengths a": ({"joint": [{"a": 0.1}, {"r": 0.1}]}, {}),
    "row 2: d is 0.1.*along z or x": ({"joint": [{}, {"d": 0.1}], "convention": "standard"}, {}),
    "gravity": ({"joint": [ROW], "gravity": [0.0, 0.0, math.nan]}, {}),
    "gravity: has 0 axes": ({"joint": [ROW], "gravity": 9.81}, {}),
    "base_translation": ({"joint": [ROW], "base": {"translation": [0.0, 1.0]}}, {}),
    "base_rpy": ({"joint": [ROW], "base": {"rpy": [0.0, 1.0, math.inf]}}, {}),
    "base_rpy: not a rectangular array": ({"joint": [ROW], "base": {"rpy": "none"}}, {}),
    "base is 3.0": ({"joint": [ROW], "base": 3.0}, {}),
    "name 3": ({"joint": [ROW], "name": 3}, {}),
    "name 3 ": (one(name=3), {}),
    "got int": (5, {}),
    "gravity has 2 numbers": ([ROW], {"gravity": (0.0, -9.81)}),
    "inertias": ([ROW], {"inertias": np.ones((2, 10))}),
    "mass": ([ROW], {"inertias": np.zeros((1, 10))}),
    r"nothing\.toml": (Path("nothing.toml"), {}),
}


@pytest.mark.parametrize("words", NO_TABLES)
def test_bad_tables_are_model_errors(words: str) -> None:
    table, options = NO_TABLES[words]
    refuses((ModelError, DataError), words, sdpid.RobotModel.from_mdh, table, **options)


def test_a_broken_file(tmp_path: Path) -> None:
    broken = tmp_path / "broken.toml"
    broken.write_text("joint = [[")
    refuses((ModelError, DataError), "not a TOML file", sdpid.RobotModel.from_mdh, broken)


@pytest.mark.parametrize("convention", ["modified", "standard"])
def test_lengths_a_and_d_are_khalils_d_and_r(convention: Any) -> None:
    khalil = [{"alpha": 1.0, "d": 0.3}, {"theta": 0.5, "d": 0.2, "r": 0.1}, {"r": -0.2}]
    others = [{"alpha": 1.0, "a": 0.3}, {"theta": 0.5, "a": 0.2, "d": 0.1}, {"d": -0.2}]
    one, other = (DhTable.of(rows, convention=convention) for rows in (khalil, others))
    assert other.to_urdf() == one.to_urdf()
    np.testing.assert_array_equal(*(t.forward_kinematics([0.1, 0.2, 0.3]) for t in (one, other)))


# Loops as descriptions tell them.


URDF = urdf("four_bar", kind="continuous")


def test_a_urdf_tells_loops_and_joints_without_motors() -> None:
    robot = load_robot(URDF)
    (pin,) = robot.loops
    assert (pin.name, pin.frame, pin.against, pin.kind) == (
        "pin", "pin/coupler", "pin/rocker", "line",
    )  # fmt: skip
    assert robot.passive == ("coupler_joint", "rocker_joint")
    assert repr(robot) == "RobotModel('four_bar', 3 coordinates, 3 links, 1 loop)"
    axes = frame_axes(robot, np.zeros((1, 3)), [pin.frame, pin.against])
    np.testing.assert_allclose(axes[0, :, :, 1], [[0.0, -1.0, 0.0]] * 2, atol=1e-15)


@pytest.mark.parametrize("kind", ["connect", "weld"])
def test_equalities_of_an_mjcf_close_loops(kind: str) -> None:
    pytest.importorskip("mujoco")
    bodies = mjcf("four_bar")
    sites = bodies[bodies.index("<connect") : bodies.index("</equality>")]
    of_sites = load_robot(bodies)
    assert [loop.kind for loop in of_sites.loops] == ["point"]
    assert of_sites.passive == ("coupler_joint", "rocker_joint")
    robot = load_robot(
        bodies.replace(sites, f'<{kind} body1="coupler" body2="rocker" anchor="0.3 0.1 0"/>')
    )
    (loop,) = robot.loops
    # MuJoCo joins what is at one place when joints are at zero.
    assert frame_gaps(robot, np.zeros((1, 3)), [loop.frame], [loop.against]) < 1e-15
    assert loop.kind == ("point" if kind == "connect" else "plane")


def test_what_only_the_parser_refuses(capfd: pytest.CaptureFixture[str]) -> None:
    bad = ARM_URDF.replace('effort="100"', 'effort="many"')
    refuses(ModelError, "Pinocchio cannot read it", sdpid.load_robot, bad)
    assert "effort value (many)" in capfd.readouterr().err


# Robots from MJCF: the same efforts as MuJoCo's, and hostile files that harm nobody.


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
    assert (robot.free_flyer, robot.n, robot.n_links) == (True, 10, 5)
    assert robot.link_names[0] == "base"
    assert sdpid.load_robot(FLOATING, root="free_flyer").free_flyer
    words = "an MJCF says itself whether its base floats"
    refuses(ModelError, words, sdpid.load_robot, ARM, root="free_flyer")


def spoilt(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new, 1)


# Descriptions of loops and of MuJoCo that cannot be read, by what is said of them.
REFUSED = {
    "of kind 'planar'; supported are": spoilt(
        URDF, 'type="continuous"><link1', 'type="planar"><link1'
    ),
    "there is no link 'nobody'": spoilt(URDF, 'link="coupler" xyz', 'link="nobody" xyz'),
    "do not move against each other": spoilt(URDF, '<link2 link="rocker"', '<link2 link="coupler"'),
    "has no <link2 link=...>": spoilt(URDF, "<link2 ", "<link_2 "),
    "expected 3 finite numbers": spoilt(URDF, 'xyz="0.3 0 0"/><link2', 'xyz="0.3 0"/><link2'),
    "the axis is zero": spoilt(URDF, '"0 -1 0"/></loop', '"0 0 0"/></loop'),
    "has no name": spoilt(URDF, 'passive_joint name="coupler_joint"', "passive_joint"),
    "position is 'left', expected 1": spoilt(URDF, 'position="1.9"', 'position="left"'),
    "x is said to have no": spoilt(URDF, 'coupler_joint" position', 'x" position'),
    "no joint has a motor": spoilt(URDF, "<passive", '<passive_joint name="crank_joint"/><passive'),
    "'j4' is a ball": spoilt(ARM, 'name="j4" axis="0 0 -1" ref="0.1"', 'name="j4" type="ball"'),
    "joint equality, which is not supported": spoilt(FOLLOWER, "-2 0 0 0", "-2 1 0 0"),
    "MuJoCo cannot parse it": "<mujoco><worldbody><nonsense/></worldbody></mujoco>",
    "no moving joint": "<mujoco><worldbody><body/></worldbody></mujoco>",
    "MuJoCo cannot compile it": "<mujoco><worldbody><body><joint/></body></worldbody></mujoco>",
    "Fr": spoilt(FLOATING, "<worldbody>", "<worldbody><body><freejoint/><geom size='1'/></body>"),
    "gravity is": spoilt(ARM, 'gravity="1 -2 -9"', 'gravity="1 -2 inf"'),
    "body_quat is not finite": spoilt(ARM, 'quat="0.9 ', 'quat="inf '),
    "qpos0 is not finite": spoilt(ARM, 'ref="0.4"', 'ref="nan"'),
}


@pytest.mark.parametrize("words", REFUSED)
def test_what_is_no_robot_is_refused(words: str) -> None:
    refuses(ModelError, words, load_robot, REFUSED[words])


SPRING = """<mujoco><worldbody><body name="a" gravcomp="1"><joint name="j" stiffness="3"
  springref="90"/><joint name="k" axis="1 0 0"/><geom size="1"/></body></worldbody>
  <actuator><motor joint="k"/><position name="p" joint="j" kp="5"/><motor joint="k" gear="9"/>
  </actuator></mujoco>"""


def test_what_the_model_lacks_is_told() -> None:
    robot = sdpid.load_robot(SPRING)
    log = sdpid.Recording(time=T, position=np.sin([T, 2.0 * T]).T, effort=np.cos([T, 2.0 * T]).T)
    told = {each.kind: each for each in sdpid.inspect_recording(log, robot).findings}
    assert "model: gravcomp 1 of body a; they are" in told["forces_ignored"].message
    assert robot.springs == (sdpid.friction.Spring("j", 3.0, np.pi / 2.0),)
    assert told["forces_ignored"].severity == "warning"
    assert "p (gain 5, gear 1), 3 (gain 1, gear 9); efforts" in told["actuators_ignored"].message
    assert not sdpid.load_robot(ARM).forces + sdpid.load_robot(ARM).actuators


def test_a_file_that_includes_itself_is_refused(tmp_path: Path) -> None:
    path, other = tmp_path / "self.xml", tmp_path / "other.xml"
    for name in ("self.xml", "other.xml"):
        path.write_text(f'<mujoco><include file="{name}"/></mujoco>')
        other.write_text('<mujoco><asset><model file="self.xml"/></asset></mujoco>')
        for read in (sdpid.load_robot, sdpid.audit_urdf):
            refuses(ModelError, r"'self\.xml' includes itself", read, path)


BODY = '<body><joint/><geom size="1"/></body>'
SEVERAL = f'<replicate count="200" offset="1 0 0">{BODY * 50}</replicate>'


@pytest.mark.parametrize(
    "content",
    [
        f"<worldbody>{SEVERAL}</worldbody>",
        '<worldbody><replicate count="9" offset="1 0 0"><replicate count="9999" offset="1 0 0">'
        f"{BODY}</replicate></replicate></worldbody>",
        '<asset><hfield name="h" nrow="99999" ncol="99999" size="1 1 1 1"/></asset>',
        '<asset><model name="m" file="many.xml"/></asset><worldbody><replicate count="9999" '
        'offset="1 0 0"><attach model="m" prefix="a"/></replicate></worldbody>',
    ],
)
def test_what_stands_for_too_much_is_refused(content: str, tmp_path: Path) -> None:
    (tmp_path / "many.xml").write_text(f"<mujoco><worldbody>{BODY}</worldbody></mujoco>")
    path = tmp_path / "large.xml"
    path.write_text(f"<mujoco>{content}</mujoco>")
    refuses(ModelError, "makes it larger than what is read", sdpid.load_robot, path)
