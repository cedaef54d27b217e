"""Written MJCF is the identified robot in MuJoCo, and in a patched file nothing else changes."""

import difflib
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sdpid
from sdpid.assurance.diagnostics.validation import validate_robot
from sdpid.errors import ExportError, ModelError
from sdpid.estimation.problem import Problem
from sdpid.output.robots.joint_friction import LeftOut
from sdpid.output.robots.mjcf import write_mjcf
from sdpid.robot.description.level import without_level
from sdpid.robot.friction.terms import RotorInertia
from sdpid.robot.model.base_parameters import generic_states
from sdpid.workflow.given_parameters import read_given
from tests.helpers import world
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE, TREE_MIMIC
from tests.helpers.small_robots import URDFS
from tests.helpers.verified import differences
from tests.output.test_urdf import (
    ARM,
    CLOSE,
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


@pytest.mark.parametrize("points", [8, 3])
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
    links = bodies(np.random.default_rng(0), 3)
    report = write_mjcf(estimate_of(problem, links, NUMBER), target=tmp_path / "out.xml")
    assert report.lumped == ()
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out.xml"))
    assert model.body("tool").mass[0] == 0.2
    assert model.body("flange").mass[0] == 0.0
    assert model.body("slide").mass[0] + 0.2 == pytest.approx(links[1, 0], rel=1e-14)
    assert model.joint("j1").range.tolist() == [-2.0, 2.0]
    assert model.jnt_actfrcrange[model.joint("j1").id].tolist() == [-10.0, 10.0]


def test_lump_when_the_rest_is_no_body(tmp_path: Path) -> None:
    problem = problem_of(sdpid.load_robot(ARM), friction=FRICTION)
    links = bodies(np.random.default_rng(0), 3)
    links[1] *= 0.05
    report = write_mjcf(estimate_of(problem, links, NUMBER), target=tmp_path / "out.xml")
    assert report.lumped == ("slide",)
    assert "tool" in report.links_changed
    assert_identified(problem, links, tmp_path / "out.xml")
    assert differences(estimate_of(problem, links, NUMBER), tmp_path / "out.xml") == []


def test_a_child_that_is_no_body_is_counted_in(tmp_path: Path) -> None:
    text = ARM.replace('ixx="0.003" ixy="1e-4"', 'ixx="0.03" ixy="1e-4"')
    problem = problem_of(sdpid.load_robot(text), friction=FRICTION)
    links = bodies(np.random.default_rng(0), 3)
    report = write_mjcf(estimate_of(problem, links, NUMBER), target=tmp_path / "out.xml")
    assert "no body can have, now zero and counted in where they are fixed: tool" in (
        report.describe()
    )
    assert_identified(problem, links, tmp_path / "out.xml")


def test_a_floating_base(tmp_path: Path) -> None:
    problem = problem_of(sdpid.load_robot(ARM, root="free_flyer"))
    links = bodies(np.random.default_rng(2), 4)
    # Reading back compares with Pinocchio's floating base.
    report = write_mjcf(estimate_of(problem, links, NUMBER), target=tmp_path / "out.xml")
    assert report.links_changed[0] == "base"
    assert report.joints_changed == ("j1", "j2", "j3")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out.xml"))
    assert model.body("base").mass[0] == pytest.approx(links[0, 0], rel=1e-14)


def test_a_floating_base_called_world(tmp_path: Path) -> None:
    text = ARM.replace('"base"', '"world"')
    problem = problem_of(sdpid.load_robot(text, root="free_flyer"))
    links = bodies(np.random.default_rng(2), 4)
    report = write_mjcf(estimate_of(problem, links, NUMBER), target=tmp_path / "out.xml")
    assert report.links_changed[0] == "world_link"
    assert differences(estimate_of(problem, links, NUMBER), tmp_path / "out.xml") == []


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
    used, errors = samples.used, []
    write_mjcf(result.estimate, target=tmp_path / "arm.xml", offsets=True)
    for efforts in (
        _played(tmp_path / "arm.xml", motion),
        result.model().inverse_dynamics(*motion),
    ):
        # Efforts pass the filter of the log's.
        played = sdpid.process(replace(other, effort=efforts), recipe.processing)
        errors.append(float(np.linalg.norm((samples.effort - played.effort)[used])))
    assert errors[0] <= 1.05 * errors[1]
    # Readers of the URDF find the base tilted, and the same links and joints on it.
    report = sdpid.write_urdf(result.estimate, target=tmp_path / "arm.urdf")
    assert "tilted by 1.59°" in report.describe()
    assert "Tilt" not in [lost.term for lost in report.left_out]
    for name in ("arm.urdf", "arm.xml"):
        if name == "arm.xml":
            write_mjcf(result.estimate, target=tmp_path / name)
        assert differences(result.estimate, tmp_path / name) == []
    again = sdpid.load_robot(tmp_path / "arm.urdf")
    found = validate_robot(again, samples).relative
    assert found == pytest.approx(report.with_validation(samples).validation.file, rel=1e-6)
    # Written upon itself, it is the same; turned otherwise, it is told.
    sdpid.write_urdf(result.estimate, source=tmp_path / "arm.urdf", target=tmp_path / "two.urdf")
    assert (tmp_path / "two.urdf").read_bytes() == (tmp_path / "arm.urdf").read_bytes()
    text = (tmp_path / "arm.urdf").read_text(encoding="utf-8")
    (tmp_path / "two.urdf").write_text(without_level(text), encoding="utf-8")
    assert "another place" in differences(result.estimate, tmp_path / "two.urdf")[0]
    given = read_given(tmp_path / "arm.urdf", robot)
    assert given.values["m_1"] == pytest.approx(result.estimate.named_theta()["m_1"])
