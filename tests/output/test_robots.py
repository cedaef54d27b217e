"""Written robots and friction are the identified ones, and what no body has is repaired."""

import ctypes
import difflib
import math
import os
import re
import runpy
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import sdpid
from sdpid._common.arrays import Array
from sdpid.assurance.descriptions.nearest_body import NEAREST, prove_nearest
from sdpid.assurance.diagnostics.described import Resistances
from sdpid.assurance.diagnostics.validation import validate_robot
from sdpid.errors import CertificateError, ExportError, ModelError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem
from sdpid.experiment.preparation.prepare import SMOOTH
from sdpid.friction import (
    AsymmetricCoulomb,
    Coulomb,
    Coupling,
    JointwiseTerm,
    LoadFriction,
    Offset,
    PositionFriction,
    RotorInertia,
    SigmoidFriction,
    SquareRootFriction,
    Stribeck,
    Tilt,
    Viscous,
)
from sdpid.output.robots.export_report import PLACES as URDF
from sdpid.output.robots.export_report import ExportErrors, ExportReport, file_errors, urdf_errors
from sdpid.output.robots.friction_files import cpp, friction_data, python, write_friction
from sdpid.output.robots.joint_friction import Kind, LeftOut, joint_attributes
from sdpid.output.robots.mjcf import PLACES as MJCF
from sdpid.output.robots.mjcf_skeleton import inertial_values
from sdpid.output.robots.repair import TOKEN_MASS, repair_urdf
from sdpid.robot import inertia
from sdpid.robot.description import bodies as described
from sdpid.robot.description.urdf import without_level
from sdpid.robot.description.xml import parse_xml, undeclared, xml_text
from sdpid.robot.friction.term import FrictionTerm, smooth_sign
from sdpid.robot.model.base_parameters import generic_states
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.robot.model.model import RobotModel
from sdpid.workflow.certify_parameters import read_given
from tests.helpers import legged, strategies, world
from tests.helpers.arm import ARM as FRICTION_ARM
from tests.helpers.data import friction_model, full_regressor, random_links, random_theta
from tests.helpers.descriptions import box, chain, diagonal, inertial, inertial_of
from tests.helpers.motions import sines
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE, TREE_MIMIC, small_arm
from tests.helpers.small_robots import URDFS
from tests.helpers.strategies import SEEDS, friction_terms_of, random_states, reals
from tests.helpers.verified import differences

mujoco = pytest.importorskip("mujoco")

# Efforts of the written robot, relative to the largest one.
CLOSE = 1e-9

ARM = """<?xml version="1.0"?>
<!-- an arm with all that a URDF may have; > and </link> in a comment -->
<robot name='arm' xmlns:xacro="http://www.ros.org/wiki/xacro">
  <link name="base"><inertial><mass value="3"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <link   name="upper" >
    <visual><origin xyz="0 0 1"/><geometry><mesh filename="package://a/b.stl"/></geometry></visual>
    <inertial> <!-- from the drawing -->
      <origin rpy="0.1 0.2 0.3" xyz='0 0 0.1'/>
      <mass value="1.0" />
      <inertia ixx="1e-1" ixy="0" ixz="0" iyy="0.1"
               iyz="0" izz="0.1"/>
    </inertial>
  </link>
  <link name="slide"/>
  <link name="tool">
    <inertial>
      <origin xyz="0.02 0 0.01" rpy="0.3 0 0.1"/>
      <mass value="0.2"/>
      <inertia ixx="0.003" ixy="1e-4" ixz="0" iyy="0.002" iyz="0" izz="0.002"/>
    </inertial>
    <collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>
  </link>
  <link name="flange"/>
  <link name="finger">
    <inertial><mass value="0.1"/>
      <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>
  </link>
  <joint name="j1" type="revolute">
    <parent link="base"/><child link="upper"/>
    <origin xyz="0 0 0.3" rpy="0.4 0 0"/><axis xyz="0 0.6 0.8"/>
    <limit lower="-2" upper="2" effort="10" velocity="3"/>
    <dynamics damping='0.5' friction="0.25" extra="kept"/>
  </joint>
  <joint name="j2" type="prismatic">
    <parent link="upper"/><child link="slide"/>
    <origin xyz="0.1 0 0.2" rpy="0 0.3 0"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="1" effort="10" velocity="3"/>
  </joint>
  <joint name="j3" type="continuous">
    <parent link="slide"/><child link="finger"/>
    <origin xyz="0 0.1 0"/><axis xyz="0 1 0"/>
    <dynamics damping="9"/>
  </joint>
  <joint name="to_flange" type="fixed">
    <parent link="slide"/><child link="flange"/><origin xyz="0 0 0.1" rpy="0 0 0.5"/>
  </joint>
  <joint name="to_tool" type="fixed">
    <parent link="flange"/><child link="tool"/><origin xyz="0.05 0 0" rpy="0.2 -0.1 0.7"/>
  </joint>
  <gazebo reference="upper"><link name="upper"><inertial/></link></gazebo>
</robot>
"""

MIMIC = ARM.replace('<dynamics damping="9"/>', '<mimic joint="j1" multiplier="-2" offset="0.1"/>')
MIMIC = MIMIC.replace('type="continuous"', 'type="revolute"').replace(
    '<axis xyz="0 1 0"/>',
    '<axis xyz="0 1 0"/><limit lower="-9" upper="9" effort="1" velocity="9"/>'
    '<dynamics damping="9"/>',
)


def bodies(rng: np.random.Generator, count: int, points: int = 8) -> np.ndarray:
    """Random bodies of point masses: with three points or fewer, on the edge of the set."""
    return inertia.point_masses(
        rng.uniform(0.2, 1.0, (count, points)), rng.uniform(-0.3, 0.3, (count, points, 3))
    )


LINKS = bodies(np.random.default_rng(0), 3)


def problem_of(robot: RobotModel, **options: Any) -> Problem:
    """Return a problem whose efforts are those of random bodies, friction parameters all one."""
    options = {"friction": ("coulomb", "viscous"), **options}
    terms = friction_model(robot, options["friction"])
    q, v, a = generic_states(robot, 60, 5)
    links = bodies(np.random.default_rng(1), robot.n_links)
    effort = robot.inverse_dynamics(links, q, v, a) + terms.columns(v, a).sum(axis=-1)
    samples = sdpid.Samples(position=q, velocity=v, acceleration=a, effort=effort)
    return sdpid.build_problem(robot, samples, **options)


def stated(problem: Problem, theta: Array) -> Estimate:
    """Return standard parameters as an estimate."""
    return Estimate.of_theta(problem, theta, method="sdp", status="optimal")


def estimate_of(problem: Problem, links: Array, friction: Any = 0.75) -> Estimate:
    """Return links and friction parameters, all the same or one by one, as an estimate."""
    tail = np.broadcast_to(friction, len(problem.friction.parameters))
    return stated(problem, np.concatenate([links.ravel(), tail]))


@pytest.fixture(scope="module")
def arm() -> Problem:
    return problem_of(sdpid.load_robot(ARM))


def written(problem: Problem, links: np.ndarray, path: Path, **options: Any) -> ExportReport:
    """Write a URDF that differs from the estimate in nothing and has the same efforts."""
    estimate = estimate_of(problem, links)
    report = sdpid.write_urdf(estimate, target=path, **options)
    assert differences(estimate, path) == []
    return report


def efforts_of(model: Any, robot: RobotModel, states: tuple[np.ndarray, ...]) -> np.ndarray:
    """Return the efforts of drives at states of the robot, as MuJoCo has them, joint by joint."""
    data = mujoco.MjData(model)
    joints = [model.joint(name) for name in list(robot.pin_model.names)[1:]]
    dof = [j.dofadr[0] for j in joints]
    at = [j.qposadr[0] for j in joints]
    out = []
    for q, v, a in zip(*states, strict=True):
        data.qpos[at] = robot.expansion @ q + robot.offset
        data.qvel[dof] = robot.expansion @ v
        data.qacc[dof] = robot.expansion @ a
        mujoco.mj_inverse(model, data)
        mujoco.mj_fwdActuation(model, data)
        out.append(robot.expansion.T @ (data.qfrc_inverse - data.qfrc_actuator)[dof])
    return np.array(out)


def plainly(text: str) -> list[str]:
    """Return the lines of a text as it is written where nothing changes."""
    return xml_text(parse_xml(text, "it"), text).splitlines()


def changed_lines(before: str, after: str) -> list[str]:
    """Return the lines of two texts that are not the same."""
    lines = difflib.ndiff(plainly(before), after.splitlines())
    return [line[2:].strip() for line in lines if line[0] in "+-"]


def test_only_inertials_and_dynamics_change(tmp_path: Path, arm: Problem) -> None:
    friction = [0.1, 0.2, 0.3, 1.1, 1.2, 1.3]
    report = sdpid.write_urdf(estimate_of(arm, LINKS, friction), target=tmp_path / "out.urdf")
    assert report.links_changed == ("upper", "slide", "finger")
    assert report.joints_changed == ("j1", "j2", "j3")
    assert report.lumped == ()
    # Also where there was none.
    found = sdpid.load_robot(tmp_path / "out.urdf").described_friction()
    np.testing.assert_array_equal(np.ravel(found[::-1]), friction)
    out = (tmp_path / "out.urdf").read_text()
    allowed = re.compile(
        r"</?inertial>|<(origin (rpy|xyz)=|(mass|inertia|dynamics) )|iyz=|izz="
        r'|<link name="slide"/?>|</link>|<inertial><mass'
    )
    assert [line for line in changed_lines(ARM, out) if not allowed.match(line)] == []
    for kept in (
        "<!-- from the drawing -->",
        'damping="1.1" friction="0.1" extra="kept"',
        # The inertial within <gazebo> is not the link's, and the child's own stands as it was.
        '<gazebo reference="upper"><link name="upper"><inertial/></link></gazebo>',
        '<origin xyz="0.02 0 0.01" rpy="0.3 0 0.1"/>\n      <mass value="0.2"/>',
    ):
        assert kept in out


def test_friction_of_followers_counts_at_their_source(tmp_path: Path) -> None:
    problem = problem_of(sdpid.load_robot(MIMIC), friction=("viscous", "offset")).without_rows()
    report = sdpid.write_urdf(estimate_of(problem, LINKS), target=tmp_path / "out.urdf")
    out = (tmp_path / "out.urdf").read_text()
    assert '<dynamics damping="0.0"/>' in out
    assert 'damping="0.75" friction="0.25"' in out  # no Coulomb term: friction stays
    assert report.left_out == (LeftOut("Offset", ("Fo1", "Fo2")),)
    assert "no place in a URDF: Offset Fo1, Fo2" in report.describe()
    assert report.friction_fitted
    found = differences(estimate_of(problem, LINKS), tmp_path / "out.urdf")
    assert found == []


def test_a_body_is_split_as_asked(tmp_path: Path, arm: Problem) -> None:
    target = tmp_path / "out.urdf"
    assert written(arm, LINKS, target, fixed="merge").lumped == ("slide",)
    tool = bodies(np.random.default_rng(5), 1)[0] * 0.02
    split = written(arm, LINKS, target, fixed={"tool": tool})
    assert split.lumped == ()
    assert "tool" in split.links_changed
    found = {b.name: b.theta for b in described.read_urdf_bodies(target.read_text(), "written")[1]}
    np.testing.assert_allclose(found["tool"], tool, atol=1e-12)
    kept = target.read_bytes()
    for asked, said in (
        ({"tool": 1e3 * tool}, "cannot be split as asked"),
        ({"tool": -tool}, "cannot be split as asked"),
        ({"upper": tool}, "no link that is fixed"),
        ({"tool": tool[:9]}, "shape"),
        ("share", "use 'keep'"),
    ):
        refuses(ExportError, said, written, arm, LINKS, target, fixed=asked)
    assert target.read_bytes() == kept


def test_spatial_consistency_may_violate_the_triangle(tmp_path: Path, arm: Problem) -> None:
    problem = arm.constrained(consistency="spatial_inertia")
    links = LINKS.copy()
    links[0, 4:] = [5.0, 0.0, 1.0, 0.0, 0.0, 1.0]
    links[0, 1:4] = 0.0
    report = written(problem, links, tmp_path / "out.urdf")
    assert report.triangle_violations == ("upper",)
    words, target = "'upper' is not consistent", tmp_path / "no.urdf"
    refuses(ExportError, words, sdpid.write_urdf, estimate_of(arm, links), target=target)
    assert not (tmp_path / "no.urdf").exists()


@pytest.mark.parametrize("encoding", ["utf-8-sig", "latin-1", "utf-16"])
def test_a_source_keeps_its_encoding_and_line_ends(
    tmp_path: Path, arm: Problem, encoding: str
) -> None:
    declared = {"latin-1": "ISO-8859-1"}.get(encoding, encoding[:6])
    text = f'<?xml version="1.0" encoding="{declared}"?>\n<!-- größe -->' + undeclared(ARM)
    source, own = tmp_path / "source.urdf", tmp_path / "own.urdf"
    source.write_bytes(text.replace("\n", "\r\n").encode(encoding))
    # From the robot's own text, and in place.
    problem = problem_of(sdpid.load_robot(source))
    sdpid.write_urdf(estimate_of(problem, LINKS), target=own)
    written(arm, LINKS, source, source=source)
    assert own.read_bytes() == source.read_bytes()
    found = source.read_bytes().decode(encoding)
    assert found.startswith(text.partition("-->")[0].replace("\n", "\r\n"))
    assert found.count("\n") == found.count("\r\n") > 0


def test_macros_of_the_source_are_expanded(tmp_path: Path, arm: Problem) -> None:
    pytest.importorskip("xacrodoc", reason="needs the extra xacro")
    source, target = tmp_path / "arm.xacro", tmp_path / "out.urdf"
    macro = '<xacro:macro xmlns:xacro="http://ros.org/wiki/xacro" name="a" params=""/>'
    text = ARM.replace("package://a/b.stl", "b.stl")  # packages are looked up
    source.write_text(text.replace("</robot>", f"{macro}</robot>"))
    written(arm, LINKS, target, source=source)
    assert "xacro" not in target.read_text()


def test_urdf_refusals(tmp_path: Path, arm: Problem) -> None:
    good = estimate_of(arm, LINKS)
    target = tmp_path / "out.urdf"
    massless = LINKS.copy()
    massless[2, 0] = -0.1
    nameless = replace(arm, robot=replace(arm.robot, urdf=None))
    for estimate, words in (
        (replace(good, theta=None, method="wls"), "base parameters only"),
        (estimate_of(arm, massless), r"'finger' has a mass of -0\.1 kg"),
        (estimate_of(arm, LINKS, friction=-1.0), "Fs1 of joint 'j1' is -1 N"),
        (estimate_of(nameless, LINKS), "as source"),
    ):
        refuses(ExportError, words, sdpid.write_urdf, estimate, target=target)
    for error, source, words in (
        (ExportError, ARM.replace('name="j1"', 'name="k1"'), "no joint 'j1'"),
        (ExportError, ARM.replace("0 0.1 0", "0 0.2 0"), "placed differently"),
        (ExportError, tmp_path / "absent.urdf", r"cannot read .*absent"),
        (ExportError, ARM.replace("<!-- an", "<!DOCTYPE r><!-- an"), "document type"),
        (ModelError, ARM.replace('value="0.2"', 'value="heavy"'), "link 'tool': value of <mass>"),
        # Readers may take it differently.
        (
            ExportError,
            ARM.replace('<origin xyz="0.02', '<origin/><origin xyz="0.02'),
            "several <origin>",
        ),
    ):
        refuses(error, words, sdpid.write_urdf, good, target=target, source=source)
    refuses(
        ExportError, "cannot write", sdpid.write_urdf, good, target=tmp_path / "no" / "out.urdf"
    )
    assert list(tmp_path.iterdir()) == []


# ---- MJCF.

FRICTION = ("coulomb", "viscous", "rotor_inertia")
NUMBER = 0.75  # of every friction parameter


def efforts(
    path: Path, robot: RobotModel, states: tuple[Array, ...], *, dry: bool = False
) -> Array:
    """Return MuJoCo's own efforts, of an MJCF with armature and damping, or dry friction too."""
    text = path.read_text()
    if path.suffix == ".urdf":
        # MuJoCo looks for mesh files, which a description without its package does not have.
        text = re.sub(r"<(visual|collision|gazebo)\b.*?</\1>", "", text, flags=re.DOTALL)
    model = mujoco.MjModel.from_xml_string(text)
    if path.suffix == ".urdf":
        model.opt.gravity, model.dof_damping[:] = robot.gravity, 0.0
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    if not dry:
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    # Dry friction saturates at speeds of all joints above 0.1 rad/s.
    model.dof_solimp[:, :2] = model.tendon_solimp_fri[:, :2] = 0.9999
    model.dof_solref[:, 0] = model.tendon_solref_fri[:, 0] = 0.004
    return efforts_of(model, robot, states)


def assert_identified(problem: Problem, links: np.ndarray, path: Path) -> None:
    robot = problem.robot
    q, v, a = generic_states(robot, 20, 78)
    present = {type(term) for term in problem.friction.terms}
    expected = robot.inverse_dynamics(links, q, v, a) + NUMBER * v
    expected += NUMBER * a if RotorInertia in present else 0.0
    found = efforts(path, robot, (q, v, a))
    assert np.abs(found - expected).max() <= CLOSE * np.abs(expected).max()
    model = mujoco.MjModel.from_xml_path(str(path))
    for name in robot.joint_names:
        assert model.dof_frictionloss[model.joint(name).dofadr[0]] == NUMBER


@pytest.mark.parametrize("points", [8, 3, 2, 1])
@pytest.mark.parametrize(
    "source",
    [ARM, MIMIC, TREE, TREE_MIMIC, "denso_vp6242", "panda_description/panda", "ur5_robot", *URDFS],
)
def test_round_trip_in_both_libraries(tmp_path: Path, source: str, points: int) -> None:
    problem = problem_of(sdpid.load_robot(source), friction=FRICTION)
    links = bodies(np.random.default_rng(points), problem.robot.n_links, points)
    estimate = estimate_of(problem, links, NUMBER)
    report = sdpid.write_mjcf(estimate, target=tmp_path / "out.xml")
    assert report.left_out == ()
    assert report.joints_changed == problem.robot.joint_names
    shaped = any(f"<{shape}" in str(problem.robot.urdf) for shape in ("visual", "collision"))
    assert ("shapes of the URDF" in report.describe()) == shaped
    assert_identified(problem, links, tmp_path / "out.xml")
    assert differences(estimate, tmp_path / "out.xml") == []
    # The URDF of the same estimate, in Pinocchio and in MuJoCo; its bodies exist.
    urdf = sdpid.write_urdf(estimate, target=tmp_path / "out.urdf")
    assert urdf.lumped == report.lumped
    assert differences(estimate, tmp_path / "out.urdf") == []
    prior = sdpid.load_robot(tmp_path / "out.urdf").prior
    assert inertia.margin(prior, "pseudo_inertia").min() > -1e-15
    states = generic_states(problem.robot, 20, 79)
    expected = problem.robot.inverse_dynamics(links, *states)
    found = efforts(tmp_path / "out.urdf", problem.robot, states)
    assert np.abs(found - expected).max() <= CLOSE * np.abs(expected).max()


def test_every_link_is_a_body_with_its_own_share(tmp_path: Path) -> None:
    problem = problem_of(sdpid.load_robot(ARM), friction=FRICTION)
    report = sdpid.write_mjcf(estimate_of(problem, LINKS, NUMBER), target=tmp_path / "out.xml")
    assert report.lumped == ()
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out.xml"))
    assert model.body("tool").mass[0] == 0.2
    assert model.body("flange").mass[0] == 0.0
    assert model.body("slide").mass[0] + 0.2 == pytest.approx(LINKS[1, 0], rel=1e-14)
    assert model.joint("j1").range.tolist() == [-2.0, 2.0]
    assert model.jnt_actfrcrange[model.joint("j1").id].tolist() == [-10.0, 10.0]


@pytest.mark.parametrize("write", [sdpid.write_urdf, sdpid.write_mjcf])
def test_lump_when_the_rest_is_no_body(tmp_path: Path, write: Any) -> None:
    problem = problem_of(sdpid.load_robot(ARM), friction=("coulomb", "viscous"))
    links, path = LINKS.copy(), tmp_path / f"out.{'xml' if write is sdpid.write_mjcf else 'urdf'}"
    links[1] *= 0.05  # lighter than the tool that is fixed to it
    report = write(estimate_of(problem, links, NUMBER), target=path)
    assert report.lumped == ("slide",)
    assert "tool" in report.links_changed
    assert "slide" in report.describe()
    # Zero, not removed: MuJoCo would take a mass from the collision box.
    tool = path.read_text().split('name="tool"')[1]
    assert re.search(r'<mass value="0\.0"/>|mass="0"', tool.split("</")[0])
    assert differences(estimate_of(problem, links, NUMBER), path) == []


def test_a_child_that_is_no_body_is_counted_in(tmp_path: Path) -> None:
    text = ARM.replace('ixx="0.003" ixy="1e-4"', 'ixx="0.03" ixy="1e-4"')
    problem = problem_of(sdpid.load_robot(text), friction=FRICTION)
    estimate = estimate_of(problem, LINKS, NUMBER)
    report = sdpid.write_mjcf(estimate, target=tmp_path / "out.xml")
    assert "no body can have, now zero and counted in where they are fixed: tool" in (
        report.describe()
    )
    assert_identified(problem, LINKS, tmp_path / "out.xml")
    assert sdpid.write_urdf(estimate, target=tmp_path / "out.urdf").lumped == ("slide",)


# MuJoCo keeps the name of its world for itself.
@pytest.mark.parametrize(("name", "body"), [("base", "base"), ("world", "world_link")])
def test_a_floating_base(tmp_path: Path, name: str, body: str) -> None:
    text = ARM.replace('"base"', f'"{name}"')
    problem = problem_of(sdpid.load_robot(text, root="free_flyer"))
    links = bodies(np.random.default_rng(2), 4)
    estimate = estimate_of(problem, links, NUMBER)
    # Reading back compares with Pinocchio's floating base.
    report = sdpid.write_mjcf(estimate, target=tmp_path / "out.xml")
    assert report.links_changed[0] == body
    assert report.joints_changed == ("j1", "j2", "j3")
    assert differences(estimate, tmp_path / "out.xml") == []
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out.xml"))
    assert model.body(body).mass[0] == pytest.approx(links[0, 0], rel=1e-14)
    report = sdpid.write_urdf(estimate, target=tmp_path / "out.urdf")
    assert (report.links_changed[0], report.joints_changed) == (name, ("j1", "j2", "j3"))
    assert differences(estimate, tmp_path / "out.urdf") == []


# The arm as a user may have it: on a table, with other frames, a shape, defaults and comments.
USERS = """<!-- ours -->
<mujoco model="mine">
  <compiler angle="degree"/>
  <default><joint damping="3" armature="0.4"/></default>
  <option gravity="0 0 -9.81"/>
  <worldbody>
    <geom type="plane" size="1 1 .1"/>
    <body name="base" pos="0.5 0 1" euler="0 0 30">
      <body name="first" pos="0.1 0 0.3" euler="0 20 0">
        <inertial pos="0 0 0" mass="1" fullinertia="1 1 1 0.1 0 0"/> <!-- a guess -->
        <joint name="one" axis="0 1 0" pos="0 0 0.1"/>
        <geom type="sphere" size="0.1" pos="0 0 0.2"/>
        <frame pos="0 0 0.1">
          <body name="second" pos="0 0 0.4">
            <joint name="two" type="slide" axis="1 0 0" stiffness="5"/>
            <geom type="box" size=".1 .1 .1"/>
            <body name="camera" pos="0 0.1 0"><geom type="sphere" size="0.02"/></body>
          </body>
        </frame>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="one"/></actuator>
</mujoco>
"""


def users_urdf() -> str:
    """Return the same arm as a URDF, its frames where MuJoCo finds the joints."""
    angle = math.radians(20.0)
    x, z = 0.1 + 0.1 * math.sin(angle), 0.3 + 0.1 * math.cos(angle)
    return f"""<robot name="mine"><link name="base"/><link name="l1"/><link name="l2"/>
      <joint name="one" type="continuous"><parent link="base"/><child link="l1"/>
        <origin xyz="{x!r} 0 {z!r}" rpy="0 {angle!r} 0"/><axis xyz="0 1 0"/>
      </joint>
      <joint name="two" type="prismatic"><parent link="l1"/><child link="l2"/>
        <origin xyz="0 0 0.4" rpy="0 0 0.7"/>
        <axis xyz="{math.cos(0.7)!r} {-math.sin(0.7)!r} 0"/>
        <limit lower="-1" upper="1" effort="9" velocity="9"/></joint></robot>"""


def test_a_users_file_is_patched(tmp_path: Path) -> None:
    problem = problem_of(sdpid.load_robot(users_urdf()), friction=FRICTION)
    links = bodies(np.random.default_rng(5), 2)
    links[1] *= 20.0  # heavier than the camera
    source = tmp_path / "mine.xml"
    source.write_bytes(USERS.replace("\n", "\r\n").encode())
    report = sdpid.write_mjcf(estimate_of(problem, links, NUMBER), source=source, target=source)
    assert report.links_changed == ("first", "second")
    assert report.lumped == ()
    out = source.read_bytes().decode()
    assert out.count("\n") == out.count("\r\n")
    allowed = ("<inertial pos", "<joint name=")
    assert [line for line in changed_lines(USERS, out) if not line.startswith(allowed)] == []
    assert "<!-- a guess -->" in out
    assert 'stiffness="5" frictionloss="0.75" damping="0.75" armature="0.75" solref' in out
    # The base's turn about the vertical leaves gravity as it is; the spring is not identified.
    source.write_text(out.replace('stiffness="5"', ""))
    assert_identified(problem, links, source)


def test_a_source_with_armature_that_the_links_hold(tmp_path: Path) -> None:
    problem = problem_of(sdpid.load_robot(users_urdf()), friction=("coulomb",))
    links = 30.0 * bodies(np.random.default_rng(5), 2)
    target = tmp_path / "out.xml"
    report = sdpid.write_mjcf(estimate_of(problem, links, NUMBER), source=USERS, target=target)
    assert "armature of the source that the identified links hold already" in report.describe()
    model = mujoco.MjModel.from_xml_path(str(target))
    assert model.dof_armature.tolist() == [0.0, 0.0]
    assert model.dof_damping.tolist() == [3.0, 3.0]  # no viscous term: damping stays


def test_a_robot_without_a_description(tmp_path: Path) -> None:
    robot = sdpid.load_robot(sdpid.load_robot(TREE).pin_model)
    problem = problem_of(robot, friction=(*FRICTION, "offset")).without_rows()
    links = bodies(np.random.default_rng(1), robot.n_links)
    report = sdpid.write_mjcf(estimate_of(problem, links, NUMBER), target=tmp_path / "out.xml")
    assert report.left_out == (LeftOut("Offset", tuple(f"Fo{i + 1}" for i in range(robot.n))),)
    assert "no place in an MJCF: Offset Fo1 … Fo" in report.describe()
    assert_identified(problem, links, tmp_path / "out.xml")


def test_mjcf_refusals(tmp_path: Path) -> None:
    problem = problem_of(sdpid.load_robot(users_urdf()), friction=FRICTION)
    links, target = 30.0 * bodies(np.random.default_rng(5), 2), tmp_path / "out.xml"
    replicated = USERS.replace('<body name="camera"', '<replicate count="2"><body name="camera"')
    replicated = replicated.replace('02"/></body>', '02"/></body></replicate>')
    crashing = tmp_path / "self.xml"
    crashing.write_text(f'<mujoco><include file="{crashing}"/></mujoco>')
    for error, source, words in (
        (ExportError, USERS.replace('name="two"', 'name="three"'), "no joint 'two'"),
        (ExportError, USERS.replace('0.1 0">', '0.1 0"><joint name="pan"/>'), "lacks: pan"),
        (ExportError, USERS.replace('axis="1', 'axis="-1'), "turned or counted differently"),
        (ExportError, USERS.replace("degree", "radian"), "turned or counted differently"),
        (ExportError, USERS.replace('degree"', 'degree" inertiafromgeom="true"'), "overrides"),
        (ModelError, USERS.replace("</body>", "</bodi>", 1), "not well-formed"),
        (ExportError, USERS.replace("<geom type=", "<geon type=", 1), "MuJoCo cannot parse"),
        (ExportError, replicated, "as one file"),
        (ExportError, crashing, "MJCF of 'mine'"),
    ):
        estimate = estimate_of(problem, links)
        refuses(error, words, sdpid.write_mjcf, estimate, source=source, target=target)
    thin = links.copy()
    thin[1, 4] *= 50.0
    loose = problem.constrained(consistency="spatial_inertia")
    for estimate, words in (
        (estimate_of(problem, -links), r"MJCF of 'mine': link 'l1' has a mass of -"),
        (estimate_of(loose, thin), "'l2' is not consistent"),
        (estimate_of(problem, links, -1.0), "Fs1 of joint 'one' is -1"),
    ):
        refuses(ExportError, words, sdpid.write_mjcf, estimate, target=target)
    assert not target.exists()


def test_fixed_bodies_without_names_are_lumped_one_by_one(tmp_path: Path) -> None:
    problem = problem_of(sdpid.load_robot(ARM), friction=FRICTION)
    links = bodies(np.random.default_rng(5), 3)
    sdpid.write_mjcf(estimate_of(problem, links), target=tmp_path / "first.xml")
    heavy = '<body><inertial pos="0 0 0" mass="900" diaginertia="1 1 1"/></body>'
    text = (tmp_path / "first.xml").read_text()
    carrier = text.index("</body>")
    text = text[:carrier] + 2 * heavy + text[carrier:]
    report = sdpid.write_mjcf(estimate_of(problem, links), target=tmp_path / "o.xml", source=text)
    assert report.lumped
    assert (tmp_path / "o.xml").read_text().count('mass="900"') == 0
    assert_identified(problem, links, tmp_path / "o.xml")


def test_a_file_that_the_robot_was_loaded_from_is_patched(tmp_path: Path) -> None:
    source, target = tmp_path / "mine.xml", tmp_path / "out.xml"
    source.write_text(USERS.replace('name="two" ', ""))  # joints need no names
    problem = problem_of(sdpid.load_robot(source), friction=FRICTION)
    estimate = estimate_of(problem, 30.0 * bodies(np.random.default_rng(5), 2), NUMBER)
    sdpid.write_mjcf(estimate, source=source, target=target)
    assert differences(estimate, target) == []
    found = sdpid.load_robot(target).described_friction()
    np.testing.assert_array_equal(found, np.full((2, 2), NUMBER))
    # Not so a body with several joints.
    source.write_text(USERS.replace('<joint name="two"', '<joint name="mid"/><joint name="two"'))
    problem = problem_of(sdpid.load_robot(source), friction=FRICTION)
    estimate = estimate_of(problem, 30.0 * bodies(np.random.default_rng(5), 3), NUMBER)
    words = "body 'second' has several joints"
    refuses(ExportError, words, sdpid.write_mjcf, estimate, source=source, target=target)
    assert sdpid.write_mjcf(estimate, target=target).lumped == ()


def _tilted_log(seed: int, times: np.ndarray) -> tuple[tuple[np.ndarray, ...], sdpid.Recording]:
    """Return the motion, and the log, of the arm of `world` that stands tilted by 1.6 degrees."""
    down = np.array([0.6 * np.sin(0.028), 0.8 * np.sin(0.028), np.cos(0.028)])
    robot = sdpid.load_robot(world.arm_urdf(np.ones(6)), gravity=(-9.81 * down).tolist())
    rng = np.random.default_rng(seed)
    w = 2.0 * np.pi * rng.uniform(0.05, 0.45, (5, robot.n))
    size, phase = rng.uniform(0.15, 0.4, w.shape), rng.uniform(0.0, 2.0 * np.pi, w.shape)
    motion = sines(times, w, phase, size)
    friction = 0.5 + 0.5 * np.arange(robot.n)[::-1]
    effort = robot.inverse_dynamics(robot.prior, *motion)
    effort += friction * (np.tanh(motion[1] / 0.01) + motion[1]) + 0.2
    effort += 0.2 * rng.standard_normal(effort.shape)
    position, names = motion[0] + 2e-5 * rng.standard_normal(effort.shape), robot.joint_names
    log = sdpid.Recording(time=times, position=position, effort=effort, joint_names=names)
    return motion, log


def test_mujoco_plays_the_log_of_a_tilted_arm_as_the_estimate_does(tmp_path: Path) -> None:
    times = np.arange(2000) / 100.0
    logs = [_tilted_log(seed, times) for seed in (1, 2)]
    (motion, other), off = logs[1], np.array([1.1, 0.9, 1.1, 0.9, 1.1, 0.9])
    robot = sdpid.load_robot(world.arm_urdf(off))
    result = sdpid.identify(robot, logs[0][1], validation=other, intervals=False)
    assert result.headline.tilt is not None
    assert "under gravity (-0.1" in result.headline.tilt
    samples, recipe = result.validation_samples, result.recipe
    assert samples is not None
    assert recipe is not None
    used, theta = samples.used, result.estimate.named_theta()
    offsets = np.array([theta[f"Fo{k + 1}"] for k in range(robot.n)])

    def missed(efforts: np.ndarray) -> float:
        # Efforts pass the filter of the log's.
        played = sdpid.process(replace(other, effort=efforts), recipe.processing)
        return float(np.linalg.norm((samples.effort - played.effort)[used]))

    def played(path: Path) -> np.ndarray:
        return efforts_of(mujoco.MjModel.from_xml_path(str(path)), robot, motion)

    own = missed(result.model().inverse_dynamics(*motion))
    sdpid.write_mjcf(result.estimate, target=tmp_path / "arm.xml", offsets=True)
    assert missed(played(tmp_path / "arm.xml")) <= 1.05 * own
    # By default offsets, and nothing else, are left out.
    report = sdpid.write_mjcf(result.estimate, target=tmp_path / "default.xml")
    assert "offsets have a place where they are asked for" in report.describe()
    default = played(tmp_path / "default.xml")
    assert missed(default + offsets) <= 1.05 * own < missed(default)
    # Readers of the URDF find the base tilted, and the same links and joints on it.
    report = sdpid.write_urdf(result.estimate, target=tmp_path / "arm.urdf")
    assert "tilted by 1.59°" in report.describe()
    assert "Tilt" not in [lost.term for lost in report.left_out]
    for name in ("arm.urdf", "default.xml"):
        assert differences(result.estimate, tmp_path / name) == []
    again = sdpid.load_robot(tmp_path / "arm.urdf")
    found = validate_robot(again, samples).told.relative
    assert found == pytest.approx(report.with_validation(samples).validation.file, rel=1e-6)
    # Written upon itself, it is the same; turned otherwise, it is told.
    sdpid.write_urdf(result.estimate, source=tmp_path / "arm.urdf", target=tmp_path / "two.urdf")
    assert (tmp_path / "two.urdf").read_bytes() == (tmp_path / "arm.urdf").read_bytes()
    text = (tmp_path / "arm.urdf").read_text(encoding="utf-8")
    (tmp_path / "two.urdf").write_text(without_level(text), encoding="utf-8")
    assert differences(result.estimate, tmp_path / "two.urdf") == ["efforts"]
    given = read_given(tmp_path / "arm.urdf", robot)
    assert given.values["m_1"] == pytest.approx(result.estimate.named_theta()["m_1"])


# ---- Bodies as files have them: exact laws, and libraries in floating point.


def about_origin(
    mass: Fraction, com: Sequence[Fraction], moments: Sequence[Fraction]
) -> list[Fraction]:
    """Return the ten parameters of a mass, a center of mass and moments about it, exactly."""
    square = sum(c * c for c in com)
    places = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
    return [mass, *(mass * c for c in com)] + [
        value + mass * ((square if i == j else 0) - com[i] * com[j])
        for value, (i, j) in zip(moments, places, strict=True)
    ]


def exactly(body: np.ndarray) -> list[Fraction]:
    return [Fraction(x) for x in body.tolist()]


@given(strategies.bodies())
def test_each_written_number_is_the_nearest(body: np.ndarray) -> None:
    exact, found = described.central(exactly(body)), described.rounded(exactly(body))
    assert about_origin(*exact) == exactly(body)
    written = (found.mass, *found.com, *found.moments)
    for number, value in zip(written, (exact[0], *exact[1], *exact[2]), strict=True):
        assert abs(Fraction(number) - value) <= Fraction(math.ulp(number)) / 2
    mass, com, tensor = inertia.physical_parameters(body)
    assert (found.mass, found.com) == (mass, tuple(com))
    apart = np.array(found.moments) - tensor[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    assert np.abs(apart).max() <= 1e-14 * np.abs(body[4:]).max()


@pytest.mark.parametrize("consistency", ["pseudo_inertia", "spatial_inertia"])
def test_the_edge(consistency: str) -> None:
    """A point, a rod and a plate are raised, a ball is not, and what is no body stays none."""
    m = Fraction(1)
    point = about_origin(m, [m / 2, m, m], [Fraction(0)] * 6)
    rod = about_origin(m, [m / 2, m, m], [m, m * 0, m, m * 0, m * 0, m * 0])
    plate = about_origin(m, [m / 2, m, m], [m, m * 0, m, m * 0, m * 0, 2 * m])
    ball = about_origin(m, [m / 2, m, m], [m, m * 0, m, m * 0, m * 0, m])
    for body in (point, rod):
        found = described.inside(body, consistency)
        assert 0 < found[4] - body[4] < Fraction(1e-12)
        written = described.rounded(found)
        assert described.exists(written.mass, written.moments, consistency)
    raised = described.inside(plate, consistency)
    assert raised is not None
    assert (raised != plate) == (consistency == "pseudo_inertia")
    assert described.inside(ball, consistency) == ball
    assert (
        described.inside(about_origin(m, [m, m, m], [-m, m * 0, m, m * 0, m * 0, m]), consistency)
        is None
    )
    assert described.inside([Fraction(0)] * 10, consistency) is None


@given(strategies.bodies())
def test_principal_axes(body: np.ndarray) -> None:
    """Moments and quaternion give the tensor back to its rounding, and obey the inequality."""
    written = described.rounded(exactly(body))
    found = inertial_values(written)
    moments = np.array(found["diaginertia"].split(), dtype=float)
    R = Rotation.from_quat(np.roll(np.array(found["quat"].split(), dtype=float), -1)).as_matrix()
    wanted = np.array(described.tensor_rows(written.moments))
    assert np.abs(R @ np.diag(moments) @ R.T - wanted).max() <= 1e-14 * np.abs(wanted).max()
    assert moments.min() >= 0.0
    assert moments[0] + moments[1] >= moments[2]


# ---- A drive that turns two joints is a tendon in MuJoCo, with the same efforts as the model's.


ROBOT = sdpid.load_robot(TREE)
TERMS: tuple[FrictionTerm, ...] = (Coulomb(), Viscous(), RotorInertia())
DRIVE = Coupling("right", "finger")
BODIES = random_links(np.random.default_rng(0), ROBOT.n_links)


def estimate_with(drive: tuple[float, float, float], *more: FrictionTerm) -> Estimate:
    """Return an estimate with a drive, and 0.5 of every other parameter."""
    problem = problem_of(ROBOT, friction=(*TERMS, DRIVE, *more), check_excitation=False)
    friction = np.full(len(problem.friction.parameters), 0.5)
    friction[3 * ROBOT.n : 3 * ROBOT.n + 3] = drive
    return estimate_of(problem, BODIES, friction)


# One tendon; two, as inertia and damping differ in sign; and one over the difference of the joints.
@pytest.mark.parametrize("drive", [(0.4, 0.2, 0.3), (0.3, -0.2, 0.1), (-0.3, -0.2, 0.0)])
def test_mujoco_has_the_efforts_of_the_model(
    drive: tuple[float, float, float], tmp_path: Path
) -> None:
    estimate = estimate_with(drive)
    report = sdpid.write_mjcf(estimate, target=tmp_path / "out.xml")
    assert report.left_out == ()
    text = (tmp_path / "out.xml").read_text(encoding="utf-8")
    assert text.count("<fixed") == (2 if drive[1] * drive[0] < 0.0 else 1)
    q, v, a = generic_states(ROBOT, 40, 6)
    fast = np.abs(np.column_stack([v, v[:, 3] + v[:, 4], v[:, 3] - v[:, 4]])).min(axis=1) > 0.1
    states = q[fast], v[fast], a[fast]
    assert fast.sum() > 5
    expected = estimate.model().inverse_dynamics(*states)
    found = efforts(tmp_path / "out.xml", ROBOT, states, dry=True)
    assert np.abs(found - expected).max() <= CLOSE * np.abs(expected).max()
    assert report.training.file == pytest.approx(report.training.estimate, abs=1e-9)
    assert differences(estimate, tmp_path / "out.xml") == []


def test_joints_and_tendons_together_are_what_joints_alone_would_be(tmp_path: Path) -> None:
    """Beside curves, which are fitted anew: a drive takes no share of what the joints get."""
    drive, curve = np.array([0.4, -0.3, 0.2]), SigmoidFriction(velocity=0.5)
    q, v, a = generic_states(ROBOT, 200, 7)
    own = np.concatenate([BODIES.ravel(), np.full(4 * ROBOT.n, 0.5)])
    found = []
    for terms, theta in (
        ((*TERMS, curve), own),
        ((*TERMS, curve, DRIVE), np.concatenate([own, drive])),
    ):
        model = RobotDynamics(robot=ROBOT, terms=friction_model(ROBOT, terms), theta=theta)
        effort = model.inverse_dynamics(q, v, a)
        samples = sdpid.Samples(position=q, velocity=v, acceleration=a, effort=effort)
        problem = sdpid.build_problem(ROBOT, samples, friction=terms, check_excitation=False)
        found.append(joint_attributes(problem, theta, MJCF, "file", ["coupled"]))
    plain, coupled = found
    assert coupled.left_out == ()
    assert "within" in coupled.notes[0]
    assert coupled.notes == plain.notes
    tendons = coupled.tendons.values()
    assert max(each.attributes.get("damping", 0.0) for each in tendons) == 0.3
    for j, name in enumerate(ROBOT.joint_names):
        both = dict(coupled.values[name])
        for attribute in ("armature", "damping"):
            both[attribute] += sum(
                x.way[j] ** 2 * x.attributes.get(attribute, 0.0) for x in tendons
            )
        assert both == pytest.approx(plain.values[name], abs=1e-9)


@pytest.mark.parametrize("drive", [(0.6, 0.1, 0.1), (-0.6, 0.1, 0.1)])
def test_a_drive_with_more_inertia_than_its_joints_is_left_out(
    drive: tuple[float, float, float], tmp_path: Path
) -> None:
    report = sdpid.write_mjcf(estimate_with(drive, Offset()), target=tmp_path / "out.xml")
    assert [lost.term for lost in report.left_out] == ["Coupling", "Offset"]
    assert "<tendon" not in (tmp_path / "out.xml").read_text(encoding="utf-8")


def test_a_file_of_yours_gets_no_tendon(tmp_path: Path) -> None:
    estimate, mine, out = (
        estimate_with((0.4, 0.2, 0.3)),
        tmp_path / "mine.xml",
        tmp_path / "out.xml",
    )
    sdpid.write_mjcf(estimate, target=mine)
    mine.write_text(re.sub("  <tendon>.*</tendon>\n", "", mine.read_text(), flags=re.DOTALL))
    report = sdpid.write_mjcf(estimate, source=mine, target=out)
    assert [lost.term for lost in report.left_out] == ["Coupling"]
    assert "<tendon" not in out.read_text()


# Friction as Python and C++, run against the model that it was written from.


# The same formulas; the libraries' tanh, exp and pow differ by some last bits, and sums by their
# order. Relative to the largest effort.
SAME = 1e-12

COMPILER = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
WARNINGS = ("-std=c++11", "-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wconversion", "-Werror")

# Ends of strings and comments, line ends, trigraphs, a brace and a letter from right to left.
HOSTILE = (
    'a"; import os #',
    "*/ \\",
    "b\n#define double int",
    "??/",
    "\u202e\U0001f916'''",
    "%s{}",
)


def all_terms(n: int) -> tuple[tuple[FrictionTerm, ...], ...]:
    """Return every kind of term that a joint may have, those of the same parameters apart."""
    widths, speeds = tuple(0.1 * (k + 1) for k in range(n)), tuple(0.5 + k for k in range(n))
    return (
        (
            Coulomb(width=widths, dead_zone=0.05),
            Viscous(),
            Offset(),
            RotorInertia(),
            SquareRootFriction(),
            Stribeck(velocity=speeds, exponent=1.5, width=0.02),
            SigmoidFriction(velocity=speeds),
            LoadFriction(share=(0.3,) * n, velocity=speeds, width=widths),
        ),
        (AsymmetricCoulomb(), Stribeck(velocity=0.3), LoadFriction()),
        (AsymmetricCoulomb(width=0.2), Tilt()),
        (PositionFriction((-1.0,) * n, widths, width=widths), Viscous()),
    )


def model_of(robot: RobotModel, terms: tuple[FrictionTerm, ...], seed: int = 0) -> RobotDynamics:
    rng = np.random.default_rng(seed)
    own = friction_model(robot, terms)
    values = rng.uniform(-1.0, 2.0, len(own.parameters))
    theta = np.concatenate([random_links(rng, robot.n_links).ravel(), values])
    return RobotDynamics(robot=robot, terms=own, theta=theta)


def named(joints: tuple[str, ...], robot: str) -> RobotModel:
    """Return an arm whose joints and itself have other names."""
    model = small_arm(len(joints)).pin_model.copy()
    model.name, model.names[1:] = robot, list(joints)
    return RobotModel.from_pinocchio(model)


def cases() -> list[RobotDynamics]:
    tree = sdpid.load_robot(TREE)
    coupled = (Coulomb(), Coupling("slide", "right", 0.3), Coupling("right", "finger"))
    found = [model_of(FRICTION_ARM, terms, k) for k, terms in enumerate(all_terms(FRICTION_ARM.n))]
    floating = sdpid.load_robot(TREE, root="free_flyer")
    found += [model_of(tree, coupled), model_of(floating, (Coulomb(), RotorInertia()))]
    found += [model_of(sdpid.load_robot(TREE_MIMIC), (Viscous(), *coupled))]
    return [*found, model_of(named(HOSTILE, HOSTILE[0]), all_terms(len(HOSTILE))[0])]


CASES = cases()


def expected(model: RobotDynamics, v: Array, a: Array, load: Array) -> tuple[Array, ...]:
    """Return friction, drives and friction of the load of the joints that have friction."""
    first = model.terms.first
    rest = np.zeros_like(v)
    drives = model.terms.columns(rest, a) - model.terms.columns(rest, rest)
    values = model.theta[10 * model.robot.n_links :]
    held = np.zeros_like(v)
    at = 0
    for term in model.terms.terms:
        count = len(term.parameters(model.terms.joint_names))
        if isinstance(term, LoadFriction):
            sign = term.sign(v[:, first:], a[:, first:])
            held[:, first:] = values[at : at + count] * np.abs(load[:, first:]) * sign
        at += count
    return tuple(each[:, first:] for each in (model.friction(v), drives @ values, held))


def over_position(model: RobotDynamics, v: Array, q: Array) -> Array | None:
    """Return friction over position, of a model whose first term it is."""
    if not isinstance(term := model.terms.terms[0], PositionFriction):
        return None
    values = model.theta[10 * model.robot.n_links :][: 3 * v.shape[1]].reshape(3, -1)
    sign = smooth_sign(v, np.asarray(term.width), 0.0)
    return np.asarray(np.einsum("cj,ckj->kj", values, term.shapes(q)) * sign)


def states_of(model: RobotDynamics, seed: int) -> tuple[Array, Array, Array]:
    """Return velocities, accelerations and loads (K, n); among them standstill and dead zones."""
    v, a, load = random_states(np.random.default_rng(seed), model.robot.n, 12)
    v[0], v[1], v[2] = 0.0, 0.01 * v[1], 1e4 * v[2]
    return v, a, load


def same(actual: Array, wanted: Array) -> None:
    scale = max(1.0, float(np.abs(wanted).max()))
    np.testing.assert_allclose(actual, wanted, rtol=0, atol=SAME * scale)


def check_python(file: dict[str, Any], model: RobotDynamics, seed: int) -> None:
    """Compare the functions of a file in Python with the model's."""
    v, a, load = states_of(model, seed)
    friction, drives, held = expected(model, v, a, load)
    v, a, load = (each[:, model.terms.first :] for each in (v, a, load))
    same(file["friction"](v), friction)
    same(file["friction"](v[3]), friction[3])
    same(file["drive_inertia"](a), drives)
    same(file["load_friction"](v, load), held)
    if (bent := over_position(model, v, load)) is None:
        assert "position_friction" not in file
    else:
        same(file["position_friction"](v, load), bent)
    refuses(ValueError, "states have shape", file["friction"], v[:, :-1])


@pytest.mark.parametrize("model", CASES)
def test_python_computes_what_the_model_does(model: RobotDynamics, tmp_path: Path) -> None:
    notes = write_friction(model, tmp_path / "friction.py")
    assert bool(notes) == any(isinstance(term, Tilt) for term in model.terms.terms)
    if notes:
        found = [float(x) for x in notes[0].partition("take (")[2].partition(")")[0].split(", ")]
        tilted = model.to_pinocchio().gravity.linear
        np.testing.assert_allclose(found, tilted, atol=1e-3)
        assert np.abs(tilted - model.robot.gravity).max() > 0.01
    file = runpy.run_path(str(tmp_path / "friction.py"))
    assert file["JOINTS"] == model.terms.joint_names
    assert file["ROBOT"] == model.robot.name
    check_python(file, model, 1)


@given(st.data(), SEEDS)
def test_any_term_in_python(data: st.DataObject, seed: int) -> None:
    term = data.draw(friction_terms_of(3))
    if isinstance(term, (LoadFriction, Tilt)) and term.bodies is not None:
        term = type(term)()
    model = model_of(named(("a", "b", "c"), "r"), (term,), seed)
    file: dict[str, Any] = {}
    exec(python(friction_data(model)), file)
    check_python(file, model, seed)


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """Return all headers in one library, compiled with every warning an error."""
    if COMPILER is None:
        reason = "no C++ compiler (c++, g++ or clang++)"
        if os.environ.get("CI", "").lower() == "true":
            pytest.fail(reason)
        pytest.skip(reason)
    folder = tmp_path_factory.mktemp("cpp")
    write_friction(model_of(FRICTION_ARM, (Viscous(),)), folder / "unnamed.hpp")
    lines = ['#include "unnamed.hpp"', 'static_assert(identified_friction::joints > 0, "");']
    for k, model in enumerate(CASES):
        write_friction(model, folder / f"case{k}.hpp")
        space = f"case{k}"
        lines += [
            f"#define SDPID_FRICTION_NAMESPACE {space}",
            f'#include "case{k}.hpp"',
            f'#include "case{k}.hpp"',
            'extern "C" {',
            f"int joints{k}() {{ return {space}::joints; }}",
            f"const char* name{k}(int j) {{ return {space}::joint_names[j]; }}",
            f"void friction{k}(const double* v, double* e) {{ {space}::friction(v, e); }}",
            f"void drives{k}(const double* a, double* e) {{ {space}::drive_inertia(a, e); }}",
            f"void load{k}(const double* v, const double* l, double* e) "
            f"{{ {space}::load_friction(v, l, e); }}",
            *(
                [
                    f"void bent{k}(const double* v, const double* q, double* e) "
                    f"{{ {space}::position_friction(v, q, e); }}"
                ]
                if isinstance(model.terms.terms[0], PositionFriction)
                else []
            ),
            "}",
        ]
    (folder / "all.cpp").write_text("\n".join([*lines, ""]), encoding="utf-8")
    library = folder / "all.so"
    command = [COMPILER, *WARNINGS, "-O1", "-shared", "-fPIC", "all.cpp", "-o", library.name]
    subprocess.run(command, cwd=folder, check=True)
    return ctypes.CDLL(str(library))


@pytest.mark.parametrize("k", range(len(CASES)))
def test_the_compiled_header_computes_what_the_model_does(compiled: ctypes.CDLL, k: int) -> None:
    model, first = CASES[k], CASES[k].terms.first
    n = getattr(compiled, f"joints{k}")()
    name = getattr(compiled, f"name{k}")
    name.restype = ctypes.c_char_p
    assert [name(j).decode("utf-8") for j in range(n)] == list(model.terms.joint_names)
    v, a, load = states_of(model, 2)
    friction, drives, held = expected(model, v, a, load)
    told = [("friction", (v,), friction), ("drives", (a,), drives), ("load", (v, load), held)]
    if (bent := over_position(model, v, load)) is not None:
        told.append(("bent", (v, load), bent))
    for i in range(len(v)):
        for function, given_, wanted in told:
            effort = np.full(n, np.nan)
            arrays = [np.ascontiguousarray(x[i, first:]) for x in given_]
            pointers = [x.ctypes.data_as(ctypes.c_void_p) for x in (*arrays, effort)]
            getattr(compiled, f"{function}{k}")(*pointers)
            same(effort, wanted[i])


def test_names_of_others_stand_in_ascii_literals_only() -> None:
    for write in (python, cpp):
        text = write(friction_data(CASES[-1]))
        assert text.isascii()
        assert not any(
            line.lstrip().startswith(("import os", "#define d")) for line in text.splitlines()
        )


class Own(JointwiseTerm):
    """A term of a user's own."""

    symbol, unit, nonnegative = "Mine", "N.m", True

    def shape(self, velocity: Array, acceleration: Array) -> Array:
        return velocity**3


def saying(**efforts: str) -> FrictionTerm:
    """Return one that says how its parameters are written."""
    made: FrictionTerm = type("Own", (Own,), {"efforts": efforts})()
    return made


class Subclassed(Coulomb):
    """A term that looks like one of ours."""


def test_a_term_of_your_own_is_written_by_its_formula(tmp_path: Path) -> None:
    model = model_of(FRICTION_ARM, (saying(Mine="{v} * {v} * {v}"), "viscous"))
    write_friction(model, tmp_path / "friction.py")
    file = runpy.run_path(str(tmp_path / "friction.py"))
    v = np.random.default_rng(0).standard_normal((5, model.robot.n))
    np.testing.assert_allclose(file["friction"](v), model.friction(v), rtol=1e-14)


@pytest.mark.parametrize(
    ("term", "words"),
    [
        (Own(), "Own is a term of your own"),
        (Subclassed(), "Subclassed is a term of your own"),
        (saying(), "Own is a term of your own"),
        (saying(Other="{v}"), "Own has formulas of Other"),
        (Coulomb(), r"written as \.py or \.hpp"),
    ],
)
def test_terms_and_languages_that_cannot_be_written(
    term: FrictionTerm, words: str, tmp_path: Path
) -> None:
    target = tmp_path / ("friction.rs" if type(term) is Coulomb else "friction.py")
    refuses(ExportError, words, write_friction, model_of(FRICTION_ARM, (term,)), target)
    assert not list(tmp_path.iterdir())


# Repaired descriptions: nearest, nothing else changed, and every loader takes them.


GOOD = diagonal(1.0, 0.01, 0.01, 0.012)
BAD = diagonal(1.0, 0.01, 0.01, 0.03)


@st.composite
def wrong(draw: st.DrawFn) -> tuple[float, np.ndarray]:
    """A mass, and a symmetric tensor of any signature whose second moments are not positive."""
    rng = np.random.default_rng(draw(SEEDS))
    Q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    values = rng.uniform(-1.0, 1.0, 3) * 10.0 ** rng.uniform(-6.0, 0.0)
    values[0] = -abs(values[0])
    tensor = Q @ (values.sum() * np.eye(3) - np.diag(values)) @ Q.T
    return draw(reals(0.01, 10.0)), 0.5 * (tensor + tensor.T)


def load_everywhere(text: str) -> Any:
    """Load with Pinocchio and with MuJoCo, without geometry."""
    import pinocchio as pin

    mujoco.MjModel.from_xml_string(text)
    return pin.buildModelFromXML(text)


def tensors(text: str) -> dict[str, np.ndarray]:
    _, found = described.read_urdf_bodies(text, "test")
    return {body.name: body.tensor for body in found if body.tensor is not None}


@given(wrong())
def test_repaired_is_nearest_loads_and_stays(case: tuple[float, np.ndarray]) -> None:
    mass, tensor = case
    com = np.array([0.1, -0.02, 0.3])
    text = chain(GOOD, inertial(mass, com, tensor, rpy="0.3 -1 0.2"), GOOD)
    assert not sdpid.audit_urdf(text).passed
    report = repair_urdf(text)
    (body,) = report.bodies
    assert body.link == "link2"
    assert body.mass == body.new_mass == mass
    # Weyl: nothing that is positive can be nearer than the most negative eigenvalues.
    P = inertia.second_moment_from_inertia(tensor)
    negative = np.minimum(np.linalg.eigvalsh(P), 0.0)
    assert body.proof.distance >= np.linalg.norm(negative) * (1.0 - 1e-9)
    assert body.proof.lower_bound <= body.proof.distance
    assert body.proof.distance <= (1.0 + NEAREST) * body.proof.lower_bound
    found = tensors(report.text)["link2"]
    moved = np.linalg.norm(inertia.second_moment_from_inertia(found) - P)
    assert moved == pytest.approx(body.proof.distance, rel=1e-9)
    assert sdpid.audit_urdf(report.text).passed
    again = repair_urdf(report.text)
    assert again.text == report.text
    assert not again.bodies
    load_everywhere(report.text)


@given(st.lists(strategies.bodies(), min_size=1, max_size=3))
def test_consistent_descriptions_keep_every_byte(several: list[np.ndarray]) -> None:
    text = chain(*(inertial_of(body) for body in several))
    report = repair_urdf(text)
    assert report.text == text
    assert not report.bodies


def test_only_the_numbers_change(tmp_path: Path) -> None:
    text = chain(GOOD + box(0.2), BAD + box(0.3, "visual"), GOOD).replace("\n", "\r\n")
    text = "\ufeff" + text.replace("</robot>", "<!-- kept --><gazebo a='1'  b=\"2\" /></robot>")
    source, target = tmp_path / "in.urdf", tmp_path / "out.urdf"
    source.write_bytes(text.encode("utf-8"))
    report = repair_urdf(source, target=target)
    written = target.read_bytes().decode("utf-8")
    assert written == report.text
    before, after = ("\n".join(each).split('"') for each in (plainly(text), written.splitlines()))
    changed = [k for k, (a, b) in enumerate(zip(before, after, strict=True)) if a != b]
    # Second moments 0.015, 0.015, -0.005: the last is raised to the floor, which leaves izz.
    assert [before[k - 1].split()[-1] for k in changed] == ["ixx=", "iyy="]
    assert "link2 (impossible)" in report.describe()
    assert report.to_dict()["path"] == str(target)


def test_edges_and_points_and_nothing() -> None:
    text = chain(
        diagonal(1.0, 0.0, 0.1, 0.1),
        diagonal(2.0, 0.0, 0.0, 0.0),
        "",
        diagonal(0.0, 0.0, 0.0, 0.0),
        diagonal(0.0, 0.01, 0.01, 0.01),
        GOOD,
        diagonal(0.1, 0.0, 0.0, 0.0),
        joints=("continuous",) * 6 + ("fixed",),
    )
    report = repair_urdf(text)
    reasons = ["no thickness", "point", "no mass", "no mass", "no mass"]
    assert [body.reason for body in report.bodies] == reasons
    assert [body.new_mass for body in report.bodies] == [1.0, 2.0, *[TOKEN_MASS] * 3]
    model = load_everywhere(report.text)
    # What had inertia without mass keeps the inertia.
    assert np.allclose(model.inertias[5].inertia, 0.01 * np.eye(3), rtol=1e-6)
    assert sdpid.audit_urdf(report.text).passed
    assert repair_urdf(report.text).text == report.text


def test_what_cannot_be_known_is_left() -> None:
    text = chain(BAD, diagonal(-1.0, 0.01, 0.01, 0.01), GOOD.replace('ixx="0.01"', 'ixx="?"'))
    report = repair_urdf(text)
    assert report.left == ("link2", "link3")
    assert [body.link for body in report.bodies] == ["link1"]
    assert "link2" in report.describe()
    refuses(ExportError, "MJCF", repair_urdf, "<mujoco/>")


def exact(matrix: np.ndarray) -> list[list[Fraction]]:
    return [[Fraction(float(x)) for x in row] for row in matrix]


def test_proofs_refuse_what_is_not_nearest() -> None:
    P, right = np.diag([-1.0, 2.0, 3.0]), np.diag([1.1e-3, 2.0, 3.0])

    def proof(near: Array) -> Any:
        return prove_nearest(exact(P), exact(near), Fraction(1, 1000))

    assert proof(np.diag([1.0000001e-3, 2.0, 3.0])).distance > 1.0
    refuses(CertificateError, "proven", proof, right)
    refuses(CertificateError, "below", proof, np.diag([0.9e-3, 2.0, 3.0]))
    refuses(CertificateError, "proven", proof, right + 1e-3 * (np.ones((3, 3)) - np.eye(3)))


# Friction in written files predicts the recordings as well as its form allows.


TWO_JOINTS = small_arm(2)
Terms = tuple[str | FrictionTerm, ...]
SIGN = Coulomb(width=SMOOTH)


def rubbed(
    seed: int,
    terms: Terms,
    *friction: Any,
    count: int = 200,
    high: Any = 1.0,
    low: Any = None,
    **fields: Any,
) -> tuple[Estimate, Array]:
    """Return an estimate whose parameters are the truth of its samples, and a copy of them.

    Friction is given for both joints or one by one, speeds by their limits.
    """  # fmt: skip
    rng = np.random.default_rng(seed)
    theta = random_theta(TWO_JOINTS, rng, terms)
    theta[20:] = np.ravel([np.broadcast_to(each, 2) for each in friction])
    velocity = rng.uniform(-high if low is None else low, high, (count, 2))
    q, a = rng.uniform(-2.0, 2.0, (2, *velocity.shape))
    effort = full_regressor(TWO_JOINTS, (q, velocity, a), terms) @ theta
    effort = effort + 0.1 * rng.standard_normal(effort.shape)
    samples = sdpid.Samples(position=q, velocity=velocity, acceleration=a, effort=effort, **fields)
    problem = sdpid.build_problem(TWO_JOINTS, samples, friction=terms, check_excitation=False)
    return stated(problem, theta), theta.copy()


def attributes_of(problem: Problem, theta: Array, places: dict[Kind, str]) -> Array:
    """Return the attributes (kinds, n)."""
    found = joint_attributes(problem, theta, places, "file").values
    return np.array(
        [[found[name][key] for name in TWO_JOINTS.joint_names] for key in places.values()]
    )


@given(SEEDS, st.sampled_from([URDF, MJCF]))
def test_no_other_coefficients_predict_the_recordings_better(
    seed: int, places: dict[Kind, str]
) -> None:
    every = (SIGN, SigmoidFriction(velocity=0.5), Viscous(), RotorInertia())
    terms: Terms = every[: 1 + len(places)]
    friction = np.random.default_rng(seed).uniform(0.1, 2.0, len(terms))
    estimate, theta = rubbed(seed, terms, *friction, count=400, high=2.0)
    samples = estimate.problem.samples
    best = attributes_of(estimate.problem, theta, places)
    assert np.all(best >= 0.0)
    rigid = TWO_JOINTS.inverse_dynamics(
        theta, samples.position, samples.velocity, samples.acceleration
    )
    shapes = [np.tanh(samples.velocity / SMOOTH), samples.velocity, samples.acceleration]

    def cost(values: Array, j: int) -> float:
        friction = sum(value * shape[:, j] for value, shape in zip(values, shapes, strict=False))
        return float(np.sum((samples.effort[:, j] - rigid[:, j] - friction) ** 2))

    for j in range(2):
        least = cost(best[:, j], j)
        for step in (1e-3, 0.1):
            for k in range(len(best)):
                for sign in (-1.0, 1.0):
                    other = best[:, j].copy()
                    other[k] = max(other[k] + sign * step, 0.0)
                    assert cost(other, j) >= least * (1.0 - 1e-12)


def test_terms_with_a_place_are_written_as_they_were_identified(tmp_path: Path) -> None:
    estimate, theta = rubbed(0, (SIGN, Viscous()), 3.0, 4.0, count=50)
    # Other values than the data's: none is fitted.
    theta[20:] = [5.0, 6.0, 7.0, 8.0]
    np.testing.assert_array_equal(
        attributes_of(estimate.problem, theta, URDF), [[5.0, 6.0], [7.0, 8.0]]
    )
    report = sdpid.write_urdf(estimate, target=tmp_path / "arm.urdf")
    assert "misses" not in report.describe()


def test_only_what_is_written_must_not_be_negative() -> None:
    estimate, theta = rubbed(6, (SIGN, Viscous(), "offset"), 3.0, 1.0, 1.0)
    theta[20] = -0.1
    assert attributes_of(estimate.problem, theta, URDF).min() > 0.9
    with pytest.raises(ExportError, match="Fs1 of joint 'joint_1' is -0"):
        attributes_of(estimate.problem.without_rows(), theta, URDF)


def test_an_offset_is_friction_only_where_the_motion_cannot_tell() -> None:
    terms: Terms = (SIGN, Viscous(), "offset")
    estimate, theta = rubbed(1, terms, 3.0, 0.0, 1.0, count=400, low=[0.3, -1.0])
    found = attributes_of(estimate.problem, theta, URDF)
    np.testing.assert_allclose(found[0], [4.0, 3.0], atol=0.15)
    (lost,) = joint_attributes(estimate.problem, theta, URDF, "file").left_out
    assert (lost.term, lost.parameters) == ("Offset", ("Fo1", "Fo2"))
    assert lost.worst == pytest.approx(1.0)
    effort = estimate.problem.samples.effort
    assert lost.share == pytest.approx(np.sqrt(effort.size) / np.linalg.norm(effort))


def test_curves_become_what_fits_them_best() -> None:
    """A sigmoid that saturates at once is dry friction; a wide one is damping."""
    terms: Terms = (Viscous(), SigmoidFriction(velocity=(1e-9, 1e3)))
    estimate, theta = rubbed(2, terms, 0.5, [3.0, 4e3], count=800, high=2.0)
    wanted = [[3.0, 0.0], [0.5, 4.5]]
    np.testing.assert_allclose(attributes_of(estimate.problem, theta, URDF), wanted, atol=0.05)
    # Without rows the curves themselves are fitted.
    bare = estimate.problem.without_rows()
    np.testing.assert_allclose(attributes_of(bare, theta, URDF), wanted, atol=0.01)
    assert joint_attributes(bare, theta, URDF, "file").notes == ()


def test_joints_that_show_no_friction_get_that_at_nominal_speeds() -> None:
    """A joint that hardly moves, and one without efforts."""
    terms: Terms = (AsymmetricCoulomb(), Viscous(), "offset")
    estimate, theta = rubbed(3, terms, 2.0, 2.0, 0.5, 3.0, high=np.array([1.0, 1e-4]))
    found = attributes_of(estimate.problem, theta, URDF)
    np.testing.assert_allclose(found[:, 1], [2.0, 0.5], atol=1e-6)
    np.testing.assert_allclose(found[:, 0], [2.0, 0.5], atol=0.2)
    mask = np.array([[True, False]] * 200)
    estimate, theta = rubbed(4, (SIGN, Viscous(), "offset"), 2.0, 0.5, 1.0, mask=mask)
    found = attributes_of(estimate.problem, theta, URDF)
    np.testing.assert_array_equal(found[:, 1], [2.0, 0.5])


def test_the_told_errors_are_those_of_the_file(tmp_path: Path) -> None:
    terms: Terms = (SIGN, SigmoidFriction(velocity=0.3), Viscous(), "offset", RotorInertia())
    estimate, _ = rubbed(5, terms, 2.0, 1.0, 0.5, 1.0, 0.3, count=300)
    samples = estimate.problem.samples
    urdf = sdpid.write_urdf(estimate, target=tmp_path / "arm.urdf")
    mjcf = sdpid.write_mjcf(estimate, target=tmp_path / "arm.xml")
    for report in (urdf, mjcf):
        robot = sdpid.load_robot(report.path, gravity=TWO_JOINTS.gravity.tolist())
        assert report.training.file == pytest.approx(validate_robot(robot, samples).relative)
        assert report.training.estimate == pytest.approx(sdpid.validate(estimate).relative)
        assert f"misses the recorded efforts by {report.training}" in report.describe()
        again = report.with_validation(samples)
        assert "misses the efforts of the validation recording" in again.describe()
        assert again.validation == report.training
        assert again.to_dict()["validation"]["file"] == report.training.file
    # The estimate explains these efforts, neither file does: both warn.
    warning = "more than 2 times as much, predict efforts with estimate.model()"
    for report in (urdf, mjcf):
        assert warning in report.describe()
        assert warning in report.with_validation(samples).describe().splitlines()[2]
    assert warning in ExportErrors(file=0.051, estimate=0.025).warning
    assert not ExportErrors(file=0.049, estimate=0.025).warning
    assert not ExportErrors(file=0.019, estimate=0.001).warning
    # They are known before the file is written.
    assert urdf_errors(estimate) == urdf.training
    assert urdf_errors(estimate, samples) == urdf.training
    # The rotor's inertia has a place in one of them.
    assert [lost.term for lost in urdf.left_out] == ["Offset", "RotorInertia"]
    assert [lost.term for lost in mjcf.left_out] == ["Offset"]
    assert mjcf.training.file < urdf.training.file  # type: ignore[union-attr]
    assert "dry friction and damping fitted to the recordings" in urdf.describe()


def test_forces_of_contacts_are_no_friction() -> None:
    """What feet push against must not be taken for friction of the joints."""
    rng = np.random.default_rng(7)
    made = legged.gait(400)
    v = made.samples.velocity[:, 6:]
    effort = np.array(made.samples.effort)
    # Wider than what a file means by dry friction, so that it is fitted anew.
    effort[:, 6:] += 0.3 * np.tanh(v / (3.0 * SMOOTH)) + 0.2 * v
    effort[:, 6:] += 1e-3 * rng.standard_normal(v.shape)
    problem = sdpid.build_problem(
        made.robot,
        replace(made.samples, effort=effort),
        friction=(Coulomb(width=3.0 * SMOOTH), Viscous()),
        weighting="residual",
        check_excitation=False,
    )
    theta = np.concatenate([made.theta, np.full(12, 0.3), np.full(12, 0.2)])
    found = joint_attributes(problem, theta, URDF, "file")
    assert found.fitted
    for joint in made.robot.joint_names[6:]:
        assert found.values[joint]["friction"] == pytest.approx(0.3, abs=0.03)
        assert found.values[joint]["damping"] == pytest.approx(0.2, abs=0.03)
    estimate = stated(problem, theta)
    numbers = [found.values[joint] for joint in made.robot.joint_names[6:]]
    written = [np.r_[np.zeros(6), [each[key] for each in numbers]] for key in URDF.values()]
    held = Resistances(np.eye(12), written[0][6:], written[1][6:], np.zeros(12))
    errors = file_errors(estimate, None, robot=problem.robot, held=held)
    assert errors.estimate < 0.01
    assert errors.file < 0.05
