"""Written MJCF is the identified robot in MuJoCo, and in a patched file nothing else changes."""

import difflib
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from scipy.spatial.transform import Rotation

import sdpid
from sdpid._common.arrays import Array
from sdpid.assurance.diagnostics.validation import validate_robot
from sdpid.errors import ExportError, ModelError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem
from sdpid.friction import Coulomb, Coupling, Offset, RotorInertia, SigmoidFriction, Viscous
from sdpid.output.robots.joint_friction import LeftOut, added, joint_attributes
from sdpid.output.robots.mjcf import PLACES, write_mjcf
from sdpid.output.robots.mjcf_skeleton import inertial_values
from sdpid.robot.description.inertials import central, exists, inside, rounded, tensor
from sdpid.robot.description.level import without_level
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.inertia import physical_parameters
from sdpid.robot.model.base_parameters import generic_states
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.workflow.given_parameters import read_given
from tests.helpers import strategies, world
from tests.helpers.data import friction_model, random_links
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE, TREE_MIMIC
from tests.helpers.small_robots import URDFS
from tests.helpers.verified import differences
from tests.output.test_urdf import (
    ARM,
    CLOSE,
    LINKS,
    MIMIC,
    assert_same_efforts,
    bodies,
    efforts_of,
    estimate_of,
    mujoco_efforts,
    problem_of,
)

mujoco = pytest.importorskip("mujoco")

FRICTION = ("coulomb", "viscous", "rotor_inertia")
NUMBER = 0.75  # of every friction parameter


def efforts(path: Path, robot: sdpid.RobotModel, states: tuple[np.ndarray, ...]) -> np.ndarray:
    """Return MuJoCo's own efforts, armature and damping included, on a fixed base."""
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
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


@pytest.mark.parametrize("points", [8, 3, 2])
@pytest.mark.parametrize(
    "source",
    [ARM, MIMIC, TREE, TREE_MIMIC, "denso_vp6242", "panda_description/panda", "ur5_robot", *URDFS],
)
def test_round_trip_in_both_libraries(tmp_path: Path, source: str, points: int) -> None:
    problem = problem_of(sdpid.load_robot(source), friction=FRICTION)
    links = bodies(np.random.default_rng(points), problem.robot.n_links, points)
    estimate = estimate_of(problem, links, NUMBER)
    report = write_mjcf(estimate, target=tmp_path / "out.xml")
    assert report.left_out == ()
    assert report.joints_changed == problem.robot.joint_names
    shaped = any(f"<{shape}" in str(problem.robot.urdf) for shape in ("visual", "collision"))
    assert ("shapes of the URDF" in report.describe()) == shaped
    assert_identified(problem, links, tmp_path / "out.xml")
    assert differences(estimate, tmp_path / "out.xml") == []
    # The URDF of the same estimate, in Pinocchio and in MuJoCo.
    urdf = sdpid.write_urdf(estimate, target=tmp_path / "out.urdf")
    assert urdf.lumped == report.lumped
    assert differences(estimate, tmp_path / "out.urdf") == []
    assert_same_efforts(problem, links, tmp_path / "out.urdf")
    states = generic_states(problem.robot, 20, 79)
    expected = problem.robot.inverse_dynamics(links, *states)
    found = mujoco_efforts(tmp_path / "out.urdf", problem.robot, states)
    assert np.abs(found - expected).max() <= CLOSE * np.abs(expected).max()


def test_every_link_is_a_body_with_its_own_share(tmp_path: Path) -> None:
    problem = problem_of(sdpid.load_robot(ARM), friction=FRICTION)
    report = write_mjcf(estimate_of(problem, LINKS, NUMBER), target=tmp_path / "out.xml")
    assert report.lumped == ()
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out.xml"))
    assert model.body("tool").mass[0] == 0.2
    assert model.body("flange").mass[0] == 0.0
    assert model.body("slide").mass[0] + 0.2 == pytest.approx(LINKS[1, 0], rel=1e-14)
    assert model.joint("j1").range.tolist() == [-2.0, 2.0]
    assert model.jnt_actfrcrange[model.joint("j1").id].tolist() == [-10.0, 10.0]


@pytest.mark.parametrize("write", [sdpid.write_urdf, write_mjcf])
def test_lump_when_the_rest_is_no_body(tmp_path: Path, write: Any) -> None:
    problem = problem_of(sdpid.load_robot(ARM), friction=("coulomb", "viscous"))
    links, path = LINKS.copy(), tmp_path / f"out.{'xml' if write is write_mjcf else 'urdf'}"
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
    report = write_mjcf(estimate, target=tmp_path / "out.xml")
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
    report = write_mjcf(estimate, target=tmp_path / "out.xml")
    assert report.links_changed[0] == body
    assert report.joints_changed == ("j1", "j2", "j3")
    assert differences(estimate, tmp_path / "out.xml") == []
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out.xml"))
    assert model.body(body).mass[0] == pytest.approx(links[0, 0], rel=1e-14)
    report = sdpid.write_urdf(estimate, target=tmp_path / "out.urdf")
    assert (report.links_changed[0], report.joints_changed) == (name, ("j1", "j2", "j3"))
    assert differences(estimate, tmp_path / "out.urdf") == []
    assert_same_efforts(problem, links, tmp_path / "out.urdf")


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
    report = write_mjcf(estimate_of(problem, links, NUMBER), source=source, target=source)
    assert report.links_changed == ("first", "second")
    assert report.lumped == ()
    out = source.read_bytes().decode()
    assert out.count("\n") == out.count("\r\n")
    changed = [
        line[2:].strip()
        for line in difflib.ndiff(USERS.splitlines(), out.splitlines())
        if line[0] in "+-"
    ]
    allowed = re.compile(r"<inertial pos|<joint name=")
    assert [line for line in changed if not allowed.match(line)] == []
    assert "<!-- a guess -->" in out
    assert 'stiffness="5" frictionloss="0.75" damping="0.75" armature="0.75" solref' in out
    # The base's turn about the vertical leaves gravity as it is; the spring is not identified.
    source.write_text(out.replace('stiffness="5"', ""))
    assert_identified(problem, links, source)


def test_a_source_with_armature_that_the_links_hold(tmp_path: Path) -> None:
    problem = problem_of(sdpid.load_robot(users_urdf()), friction=("coulomb",))
    links = 30.0 * bodies(np.random.default_rng(5), 2)
    target = tmp_path / "out.xml"
    report = write_mjcf(estimate_of(problem, links, NUMBER), source=USERS, target=target)
    assert "armature of the source that the identified links hold already" in report.describe()
    model = mujoco.MjModel.from_xml_path(str(target))
    assert model.dof_armature.tolist() == [0.0, 0.0]
    assert model.dof_damping.tolist() == [3.0, 3.0]  # no viscous term: damping stays


def test_a_robot_without_a_description(tmp_path: Path) -> None:
    robot = sdpid.load_robot(sdpid.load_robot(TREE).pin_model)
    problem = problem_of(robot, friction=(*FRICTION, "offset")).without_rows()
    links = bodies(np.random.default_rng(1), robot.n_links)
    report = write_mjcf(estimate_of(problem, links, NUMBER), target=tmp_path / "out.xml")
    assert report.left_out == (LeftOut("Offset", tuple(f"Fo{i + 1}" for i in range(robot.n))),)
    assert "no place in an MJCF: Offset Fo1 … Fo" in report.describe()
    assert_identified(problem, links, tmp_path / "out.xml")


def test_refusals(tmp_path: Path) -> None:
    problem = problem_of(sdpid.load_robot(users_urdf()), friction=FRICTION)
    links = 30.0 * bodies(np.random.default_rng(5), 2)
    good = estimate_of(problem, links, NUMBER)
    target = tmp_path / "out.xml"

    def refused(source: str, match: str, kind: type[Exception] = ExportError) -> None:
        refuses(kind, match, write_mjcf, good, source=source, target=target)

    refused(USERS.replace('name="two"', 'name="three"'), "no joint 'two'")
    refused(USERS.replace('pos="0 0.1 0">', 'pos="0 0.1 0"><joint name="pan"/>'), "lacks: pan")
    refused(USERS.replace('axis="1 0 0"', 'axis="-1 0 0"'), "turned or counted differently")
    refused(USERS.replace("degree", "radian"), "turned or counted differently")
    refused(USERS.replace('degree"', 'degree" inertiafromgeom="true"'), "overrides inertials")
    refused(USERS.replace("</body>", "</bodi>", 1), "not well-formed", ModelError)
    refused(USERS.replace("<geom type=", "<geon type=", 1), "MuJoCo cannot parse")
    replicated = USERS.replace('<body name="camera"', '<replicate count="2"><body name="camera"')
    refused(replicated.replace('02"/></body>', '02"/></body></replicate>'), "as one file")
    with pytest.raises(ExportError, match=r"MJCF of 'mine': link 'l1' has a mass of -"):
        write_mjcf(estimate_of(problem, -links), source=USERS, target=target)
    thin = links.copy()
    thin[1, 4] *= 50.0
    loose = problem.constrained(consistency="spatial_inertia")
    with pytest.raises(ExportError, match="'l2' is not consistent"):
        write_mjcf(estimate_of(loose, thin), source=USERS, target=target)
    with pytest.raises(ExportError, match="Fs1 of joint 'one' is -1"):
        write_mjcf(estimate_of(problem, links, -1.0), target=target)
    assert not target.exists()


def test_a_real_robots_description(data_folder: Path, tmp_path: Path) -> None:
    robot = sdpid.load_robot(data_folder / "ur10_unisa" / "ur10.urdf")
    problem = problem_of(robot, friction=FRICTION)
    links = bodies(np.random.default_rng(10), robot.n_links)
    write_mjcf(estimate_of(problem, links, NUMBER), target=tmp_path / "out.xml")
    assert_identified(problem, links, tmp_path / "out.xml")


def test_fixed_bodies_without_names_are_lumped_one_by_one(tmp_path: Path) -> None:
    problem = problem_of(sdpid.load_robot(ARM), friction=FRICTION)
    links = bodies(np.random.default_rng(5), 3)
    write_mjcf(estimate_of(problem, links), target=tmp_path / "first.xml")
    heavy = '<body><inertial pos="0 0 0" mass="900" diaginertia="1 1 1"/></body>'
    text = (tmp_path / "first.xml").read_text()
    carrier = text.index("</body>")
    text = text[:carrier] + 2 * heavy + text[carrier:]
    report = write_mjcf(estimate_of(problem, links), target=tmp_path / "o.xml", source=text)
    assert report.lumped
    assert (tmp_path / "o.xml").read_text().count('mass="900"') == 0
    assert_identified(problem, links, tmp_path / "o.xml")


def test_a_source_that_mujoco_crashes_on_is_refused(tmp_path: Path) -> None:
    problem = problem_of(sdpid.load_robot(ARM), friction=FRICTION)
    links = bodies(np.random.default_rng(5), 3)
    source = tmp_path / "self.xml"
    source.write_text(f'<mujoco><include file="{source}"/></mujoco>')
    with pytest.raises(ExportError, match="MJCF of 'arm'"):
        write_mjcf(estimate_of(problem, links), target=tmp_path / "o.xml", source=source)


def test_a_file_that_the_robot_was_loaded_from_is_patched(tmp_path: Path) -> None:
    source = tmp_path / "mine.xml"
    source.write_text(USERS.replace('name="two" ', ""))  # joints need no names
    problem = problem_of(sdpid.load_robot(source), friction=FRICTION)
    links = 30.0 * bodies(np.random.default_rng(5), 2)
    write_mjcf(estimate_of(problem, links, NUMBER), source=source, target=tmp_path / "out.xml")
    again = sdpid.load_robot(tmp_path / "out.xml")
    states = generic_states(again, 10, 3)
    expected = problem.robot.inverse_dynamics(links, *states)
    found = again.inverse_dynamics(again.prior, *states)
    np.testing.assert_allclose(found, expected, rtol=0, atol=CLOSE * np.abs(expected).max())
    np.testing.assert_array_equal(again.described_friction(), np.full((2, 2), NUMBER))


def test_a_body_with_several_joints_is_refused(tmp_path: Path) -> None:
    source = tmp_path / "mine.xml"
    source.write_text(USERS.replace('<joint name="two"', '<joint name="mid"/><joint name="two"'))
    problem = problem_of(sdpid.load_robot(source), friction=FRICTION)
    estimate = estimate_of(problem, 30.0 * bodies(np.random.default_rng(5), 3), NUMBER)
    with pytest.raises(ExportError, match="body 'second' has several joints"):
        write_mjcf(estimate, source=source, target=tmp_path / "out.xml")
    assert write_mjcf(estimate, target=tmp_path / "out.xml").lumped == ()


def _played(path: Path, motion: tuple[np.ndarray, ...]) -> np.ndarray:
    """Return the efforts of drives of a motion by MuJoCo's inverse dynamics, dry friction too."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data, found = mujoco.MjData(model), []
    for data.qpos[:], data.qvel[:], data.qacc[:] in zip(*motion, strict=True):
        mujoco.mj_inverse(model, data)
        mujoco.mj_fwdActuation(model, data)
        found.append(data.qfrc_inverse - data.qfrc_actuator)
    return np.array(found)


def _tilted_log(seed: int, times: np.ndarray) -> tuple[tuple[np.ndarray, ...], sdpid.Recording]:
    """Return the motion, and the log, of the arm of `world` that stands tilted by 1.6 degrees."""
    down = np.array([0.6 * np.sin(0.028), 0.8 * np.sin(0.028), np.cos(0.028)])
    robot = sdpid.load_robot(world.arm_urdf(np.ones(6)), gravity=(-9.81 * down).tolist())
    rng = np.random.default_rng(seed)
    w = 2.0 * np.pi * rng.uniform(0.05, 0.45, (5, 1, robot.n))
    size, phase = rng.uniform(0.15, 0.4, w.shape), rng.uniform(0.0, 2.0 * np.pi, w.shape)
    waves = (size * np.sin(w * times[:, None] + phase), size * np.cos(w * times[:, None] + phase))
    motion = (waves[0].sum(0), (w * waves[1]).sum(0), -(w**2 * waves[0]).sum(0))
    friction = 0.5 + 0.5 * np.arange(robot.n)[::-1]
    effort = robot.inverse_dynamics(robot.prior, *motion)
    effort += friction * (np.tanh(motion[1] / 0.01) + motion[1]) + 0.2
    effort += 0.2 * rng.standard_normal(effort.shape)
    position = motion[0] + 2e-5 * rng.standard_normal(effort.shape)
    return motion, sdpid.Recording(
        time=times, position=position, effort=effort, joint_names=robot.joint_names
    )


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

    own = missed(result.model().inverse_dynamics(*motion))
    write_mjcf(result.estimate, target=tmp_path / "arm.xml", offsets=True)
    assert missed(_played(tmp_path / "arm.xml", motion)) <= 1.05 * own
    # By default offsets, and nothing else, are left out.
    report = write_mjcf(result.estimate, target=tmp_path / "default.xml")
    assert "offsets have a place where they are asked for" in report.describe()
    default = _played(tmp_path / "default.xml", motion)
    assert missed(default + offsets) <= 1.05 * own < missed(default)
    # Readers of the URDF find the base tilted, and the same links and joints on it.
    report = sdpid.write_urdf(result.estimate, target=tmp_path / "arm.urdf")
    assert "tilted by 1.59°" in report.describe()
    assert "Tilt" not in [lost.term for lost in report.left_out]
    for name in ("arm.urdf", "arm.xml"):
        if name == "arm.xml":
            write_mjcf(result.estimate, target=tmp_path / name)
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
def test_about_the_center_and_back(body: np.ndarray) -> None:
    exact = exactly(body)
    assert about_origin(*central(exact)) == exact
    mass, com, inertia = physical_parameters(body)
    written = rounded(exact)
    assert written.mass == mass
    assert written.com == tuple(com)
    found = np.array(written.moments) - inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    assert np.abs(found).max() <= 1e-14 * np.abs(body[4:]).max()


@given(strategies.bodies())
def test_each_written_number_is_the_nearest(body: np.ndarray) -> None:
    exact, found = central(exactly(body)), rounded(exactly(body))
    numbers = zip(
        (found.mass, *found.com, *found.moments), (exact[0], *exact[1], *exact[2]), strict=True
    )
    for number, value in numbers:
        assert abs(Fraction(number) - value) <= Fraction(math.ulp(number)) / 2


@pytest.mark.parametrize("consistency", ["pseudo_inertia", "spatial_inertia"])
def test_the_edge(consistency: str) -> None:
    """A point, a rod and a plate are raised, a ball is not, and what is no body stays none."""
    m = Fraction(1)
    point = about_origin(m, [m / 2, m, m], [Fraction(0)] * 6)
    rod = about_origin(m, [m / 2, m, m], [m, m * 0, m, m * 0, m * 0, m * 0])
    plate = about_origin(m, [m / 2, m, m], [m, m * 0, m, m * 0, m * 0, 2 * m])
    ball = about_origin(m, [m / 2, m, m], [m, m * 0, m, m * 0, m * 0, m])
    for body in (point, rod):
        found = inside(body, consistency)
        assert 0 < found[4] - body[4] < Fraction(1e-12)
        written = rounded(found)
        assert exists(written.mass, written.moments, consistency)
    raised = inside(plate, consistency)
    assert raised is not None
    assert (raised != plate) == (consistency == "pseudo_inertia")
    assert inside(ball, consistency) == ball
    assert inside(about_origin(m, [m, m, m], [-m, m * 0, m, m * 0, m * 0, m]), consistency) is None
    assert inside([Fraction(0)] * 10, consistency) is None


@given(strategies.bodies())
def test_principal_axes(body: np.ndarray) -> None:
    """Moments and quaternion give the tensor back to its rounding, and obey the inequality."""
    written = rounded(exactly(body))
    found = inertial_values(written)
    moments = np.array(found["diaginertia"].split(), dtype=float)
    R = Rotation.from_quat(np.roll(np.array(found["quat"].split(), dtype=float), -1)).as_matrix()
    wanted = np.array(tensor(written.moments))
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
    terms = (*TERMS, DRIVE, *more)
    problem = problem_of(ROBOT, friction=terms, check_excitation=False)
    others = np.full(sum(ROBOT.n for _ in TERMS), 0.5), np.full(ROBOT.n * len(more), 0.5)
    theta = np.concatenate([BODIES.ravel(), others[0], drive, others[1]])
    return Estimate.of_theta(problem, theta, method="sdp", status="optimal")


def mujocos(path: Path, states: tuple[Array, ...]) -> Array:
    """Return MuJoCo's own efforts, with dry friction, without limits."""
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    # Dry friction saturates at speeds of all joints above 0.1 rad/s.
    model.dof_solimp[:, :2] = model.tendon_solimp_fri[:, :2] = 0.9999
    model.dof_solref[:, 0] = model.tendon_solref_fri[:, 0] = 0.004
    return efforts_of(model, ROBOT, states)


# One tendon; two, as inertia and damping differ in sign; and one over the difference of the joints.
@pytest.mark.parametrize("drive", [(0.4, 0.2, 0.3), (0.3, -0.2, 0.1), (-0.3, -0.2, 0.0)])
def test_mujoco_has_the_efforts_of_the_model(
    drive: tuple[float, float, float], tmp_path: Path
) -> None:
    estimate = estimate_with(drive)
    report = write_mjcf(estimate, target=tmp_path / "out.xml")
    assert report.left_out == ()
    text = (tmp_path / "out.xml").read_text(encoding="utf-8")
    assert text.count("<fixed") == (2 if drive[1] * drive[0] < 0.0 else 1)
    q, v, a = generic_states(ROBOT, 40, 6)
    fast = np.abs(np.column_stack([v, v[:, 3] + v[:, 4], v[:, 3] - v[:, 4]])).min(axis=1) > 0.1
    states = q[fast], v[fast], a[fast]
    assert fast.sum() > 5
    expected = estimate.model().inverse_dynamics(*states)
    found = mujocos(tmp_path / "out.xml", states)
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
        found.append(joint_attributes(problem, theta, PLACES, "file", tendons=True))
    plain, coupled = found
    assert coupled.left_out == ()
    assert "within" in coupled.notes[0]
    assert coupled.notes == plain.notes
    armature, damping = added(coupled.tendons, ROBOT.joint_names)
    assert damping.max() == 0.3
    for j, name in enumerate(ROBOT.joint_names):
        both = dict(coupled.values[name])
        both["armature"] += armature[j]
        both["damping"] += damping[j]
        assert both == pytest.approx(plain.values[name], abs=1e-9)


@pytest.mark.parametrize("drive", [(0.6, 0.1, 0.1), (-0.6, 0.1, 0.1)])
def test_a_drive_with_more_inertia_than_its_joints_is_left_out(
    drive: tuple[float, float, float], tmp_path: Path
) -> None:
    report = write_mjcf(estimate_with(drive, Offset()), target=tmp_path / "out.xml")
    assert [lost.term for lost in report.left_out] == ["Coupling", "Offset"]
    assert "<tendon" not in (tmp_path / "out.xml").read_text(encoding="utf-8")


def test_a_file_of_yours_gets_no_tendon(tmp_path: Path) -> None:
    estimate = estimate_with((0.4, 0.2, 0.3))
    write_mjcf(estimate, target=tmp_path / "mine.xml")
    text = (tmp_path / "mine.xml").read_text(encoding="utf-8")
    start, end = text.index("  <tendon>"), text.index("</tendon>") + len("</tendon>\n")
    (tmp_path / "mine.xml").write_text(text[:start] + text[end:], encoding="utf-8")
    report = write_mjcf(estimate, source=tmp_path / "mine.xml", target=tmp_path / "out.xml")
    assert [lost.term for lost in report.left_out] == ["Coupling"]
    assert "<tendon" not in (tmp_path / "out.xml").read_text(encoding="utf-8")
