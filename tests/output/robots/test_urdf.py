"""Written URDFs are the identified robot, and nothing else in them has changed."""

import difflib
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid.errors import ExportError, ModelError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem, build_problem
from sdpid.output.robots.joint_friction import LeftOut
from sdpid.output.robots.urdf import write_urdf
from sdpid.robot.description.bodies import read_urdf_bodies
from sdpid.robot.description.xml import undeclared
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.inertia import margin, point_masses
from sdpid.robot.model.base_parameters import generic_states
from sdpid.robot.model.model import RobotModel
from tests.helpers.refusals import refuses
from tests.helpers.small_robots import URDFS
from tests.helpers.verified import differences

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
    return point_masses(
        rng.uniform(0.2, 1.0, (count, points)), rng.uniform(-0.3, 0.3, (count, points, 3))
    )


def problem_of(robot: RobotModel, **options: object) -> Problem:
    q, v, a = generic_states(robot, 60, 5)
    friction = options.setdefault("friction", ("coulomb", "viscous"))
    terms = FrictionModel.from_terms(friction, robot.joint_names, first=robot.n_base)  # type: ignore[arg-type]
    tail = np.ones(len(terms.parameters))
    links = bodies(np.random.default_rng(1), robot.n_links)
    effort = robot.inverse_dynamics(links, q, v, a) + terms.columns(v, a) @ tail
    samples = sdpid.Samples(position=q, velocity=v, acceleration=a, effort=effort)
    return build_problem(robot, samples, **options)  # type: ignore[arg-type]


def estimate_of(problem: Problem, links: np.ndarray, friction: float = 0.75) -> Estimate:
    tail = np.full(len(problem.friction.parameters), friction)
    theta = np.concatenate([links.ravel(), tail])
    return Estimate.of_theta(problem, theta, method="sdp", status="optimal")


@pytest.fixture(scope="module")
def arm() -> Problem:
    return problem_of(sdpid.load_robot(ARM))


def assert_same_efforts(problem: Problem, links: np.ndarray, path: Path) -> RobotModel:
    robot = problem.robot
    root = "free_flyer" if robot.free_flyer else None
    written = sdpid.load_robot(path, root=root, gravity=robot.gravity)  # type: ignore[arg-type]
    q, v, a = generic_states(robot, 20, 77)
    expected = robot.inverse_dynamics(links, q, v, a)
    found = (written.regressor(q, v, a) @ written.prior.ravel()) - expected
    assert np.abs(found).max() <= CLOSE * np.abs(expected).max()
    return written


def efforts_of(model: Any, robot: RobotModel, states: tuple[np.ndarray, ...]) -> np.ndarray:
    """Return MuJoCo's own efforts at states of the robot, joint by joint."""
    import mujoco

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
        out.append(robot.expansion.T @ data.qfrc_inverse[dof])
    return np.array(out)


def mujoco_efforts(path: Path, robot: RobotModel, states: tuple[np.ndarray, ...]) -> np.ndarray:
    mujoco = pytest.importorskip("mujoco")
    # MuJoCo looks for mesh files, which a description without its package does not have.
    text = re.sub(r"<(visual|collision)\b.*?</\1>", "", path.read_text(), flags=re.DOTALL)
    text = re.sub(r"<gazebo.*?</gazebo>", "", text, flags=re.DOTALL)
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.gravity = robot.gravity
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    model.dof_damping[:] = 0.0
    return efforts_of(model, robot, states)


@pytest.mark.parametrize("points", [8, 3, 2])
@pytest.mark.parametrize("text", [ARM, MIMIC, *URDFS])
def test_round_trip_in_both_libraries(tmp_path: Path, text: str, points: int) -> None:
    problem = problem_of(sdpid.load_robot(text))
    links = bodies(np.random.default_rng(points), problem.robot.n_links, points)
    target = tmp_path / "out.urdf"
    estimate = estimate_of(problem, links)
    report = write_urdf(estimate, target=target)
    assert differences(estimate, target) == []
    assert report.path == target
    assert report.triangle_violations == ()
    assert_same_efforts(problem, links, target)
    states = generic_states(problem.robot, 20, 78)
    expected = problem.robot.inverse_dynamics(links, *states)
    found = mujoco_efforts(target, problem.robot, states)
    assert np.abs(found - expected).max() <= CLOSE * np.abs(expected).max()


def test_example_robot_with_fixed_hand(tmp_path: Path) -> None:
    problem = problem_of(sdpid.load_robot("panda_description/panda"), friction=("viscous",))
    rng = np.random.default_rng(4)
    for points in (8, 2):
        links = bodies(rng, problem.robot.n_links, points)
        estimate = estimate_of(problem, links)
        report = write_urdf(estimate, target=tmp_path / "panda.urdf")
        assert differences(estimate, tmp_path / "panda.urdf") == []
        assert_same_efforts(problem, links, tmp_path / "panda.urdf")
        assert len(report.lumped) == (1 if points == 2 else 0)


def test_only_inertials_and_dynamics_change(tmp_path: Path, arm: Problem) -> None:
    links = bodies(np.random.default_rng(0), 3)
    report = write_urdf(estimate_of(arm, links), target=tmp_path / "out.urdf")
    assert report.links_changed == ("upper", "slide", "finger")
    assert report.joints_changed == ("j1", "j2", "j3")
    assert report.lumped == ()
    out = (tmp_path / "out.urdf").read_text()
    changed = [
        line[2:].strip() for line in difflib.ndiff(ARM.splitlines(), out.splitlines())
        if line[0] in "+-"
    ]  # fmt: skip
    allowed = re.compile(
        r"</?inertial>|<(origin (rpy|xyz)=|(mass|inertia|dynamics) )|iyz=|izz="
        r'|<link name="slide"/?>|</link>|<inertial><mass'
    )
    assert [line for line in changed if not allowed.match(line)] == []
    assert "<!-- from the drawing -->" in out
    assert 'extra="kept"' in out
    assert "damping='0.75' friction=\"0.75\" extra" in out
    assert '<link   name="upper" >' in out
    # The inertial within <gazebo> is not the link's.
    assert '<gazebo reference="upper"><link name="upper"><inertial/></link></gazebo>' in out
    # The children's own inertial stands to the last byte.
    assert '<origin xyz="0.02 0 0.01" rpy="0.3 0 0.1"/>\n      <mass value="0.2"/>' in out


def test_friction_appears_where_there_was_none(tmp_path: Path, arm: Problem) -> None:
    links = bodies(np.random.default_rng(0), 3)
    theta = np.concatenate([links.ravel(), [0.1, 0.2, 0.3, 1.1, 1.2, 1.3]])
    estimate = Estimate.of_theta(arm, theta, method="sdp", status="optimal")
    write_urdf(estimate, target=tmp_path / "out.urdf")
    model = sdpid.load_robot(tmp_path / "out.urdf").pin_model
    assert np.array_equal(model.friction, [0.1, 0.2, 0.3]) or np.array_equal(
        model.upperDryFrictionLimit, [0.1, 0.2, 0.3]
    )
    assert np.array_equal(model.damping, [1.1, 1.2, 1.3])


def test_friction_of_followers_counts_at_their_source(tmp_path: Path) -> None:
    problem = problem_of(sdpid.load_robot(MIMIC), friction=("viscous", "offset")).without_rows()
    links = bodies(np.random.default_rng(0), 3)
    report = write_urdf(estimate_of(problem, links), target=tmp_path / "out.urdf")
    out = (tmp_path / "out.urdf").read_text()
    assert '<dynamics damping="0.0"/>' in out
    assert "damping='0.75' friction=\"0.25\"" in out  # no Coulomb term: friction stays
    assert report.left_out == (LeftOut("Offset", ("Fo1", "Fo2")),)
    assert "no place in a URDF: Offset Fo1, Fo2" in report.describe()
    assert report.friction_fitted
    found = differences(estimate_of(problem, links), tmp_path / "out.urdf")
    assert found == []


def test_lump_when_the_rest_is_no_body(tmp_path: Path, arm: Problem) -> None:
    links = bodies(np.random.default_rng(0), 3)
    links[1] *= 0.05  # lighter than the tool that is fixed to it
    estimate = estimate_of(arm, links)
    report = write_urdf(estimate, target=tmp_path / "out.urdf")
    assert differences(estimate, tmp_path / "out.urdf") == []
    assert report.lumped == ("slide",)
    assert "tool" in report.links_changed
    assert "slide" in report.describe()
    assert_same_efforts(arm, links, tmp_path / "out.urdf")
    # Zero, not removed: MuJoCo would take a mass from the collision box.
    tool = (tmp_path / "out.urdf").read_text().split('<link name="tool">')[1]
    assert '<mass value="0.0"/>' in tool.split("</link>")[0]


def test_a_body_is_split_as_asked(tmp_path: Path, arm: Problem) -> None:
    links = bodies(np.random.default_rng(0), 3)
    target = tmp_path / "out.urdf"
    merged = write_urdf(estimate_of(arm, links), target=target, fixed="merge")
    assert merged.lumped == ("slide",)
    assert_same_efforts(arm, links, target)
    tool = bodies(np.random.default_rng(5), 1)[0] * 0.02
    split = write_urdf(estimate_of(arm, links), target=target, fixed={"tool": tool})
    assert split.lumped == ()
    assert "tool" in split.links_changed
    assert_same_efforts(arm, links, target)
    written = {b.name: b.theta for b in read_urdf_bodies(target.read_text(), "written")[1]}
    np.testing.assert_allclose(written["tool"], tool, atol=1e-12)
    kept = target.read_bytes()
    for asked, said in (
        ({"tool": 1e3 * tool}, "cannot be split as asked"),
        ({"tool": -tool}, "cannot be split as asked"),
        ({"upper": tool}, "no link that is fixed"),
        ({"tool": tool[:9]}, "shape"),
        ("share", "use 'keep'"),
    ):
        with pytest.raises(ExportError, match=said):
            write_urdf(estimate_of(arm, links), target=target, fixed=asked)  # type: ignore[arg-type]
    assert target.read_bytes() == kept


def test_lump_when_a_child_is_no_body(tmp_path: Path) -> None:
    text = ARM.replace('ixx="0.003" ixy="1e-4"', 'ixx="0.03" ixy="1e-4"')
    problem = problem_of(sdpid.load_robot(text))
    links = bodies(np.random.default_rng(0), 3)
    assert write_urdf(estimate_of(problem, links), target=tmp_path / "o.urdf").lumped == ("slide",)


def test_what_readers_may_take_differently_is_refused(tmp_path: Path) -> None:
    text = ARM.replace('<origin xyz="0.02 0 0.01" rpy="0.3 0 0.1"/>', "<origin/><origin/>")
    problem = problem_of(sdpid.load_robot(text))
    estimate = estimate_of(problem, bodies(np.random.default_rng(0), 3))
    with pytest.raises(ExportError, match=r"may differ on the source: .* several <origin>"):
        write_urdf(estimate, target=tmp_path / "o.urdf")


def test_written_bodies_are_consistent(tmp_path: Path, arm: Problem) -> None:
    rng = np.random.default_rng(8)
    for points in (1, 2, 3, 4, 8):
        links = bodies(rng, 3, points)
        write_urdf(estimate_of(arm, links), target=tmp_path / "out.urdf")
        written = sdpid.load_robot(tmp_path / "out.urdf")
        assert margin(written.prior, "pseudo_inertia").min() > -1e-15


def test_spatial_consistency_may_violate_the_triangle(tmp_path: Path, arm: Problem) -> None:
    problem = arm.constrained(consistency="spatial_inertia")
    links = bodies(np.random.default_rng(0), 3)
    links[0, 4:] = [5.0, 0.0, 1.0, 0.0, 0.0, 1.0]
    links[0, 1:4] = 0.0
    report = write_urdf(estimate_of(problem, links), target=tmp_path / "out.urdf")
    assert report.triangle_violations == ("upper",)
    assert differences(estimate_of(problem, links), tmp_path / "out.urdf") == []
    assert_same_efforts(problem, links, tmp_path / "out.urdf")
    with pytest.raises(ExportError, match="'upper' is not consistent"):
        write_urdf(estimate_of(arm, links), target=tmp_path / "no.urdf")
    assert not (tmp_path / "no.urdf").exists()


def test_free_flyer_writes_its_root(tmp_path: Path) -> None:
    problem = problem_of(sdpid.load_robot(ARM, root="free_flyer"))
    links = bodies(np.random.default_rng(2), 4)
    report = write_urdf(estimate_of(problem, links), target=tmp_path / "out.urdf")
    assert report.links_changed[0] == "base"
    assert differences(estimate_of(problem, links), tmp_path / "out.urdf") == []
    assert report.joints_changed == ("j1", "j2", "j3")
    assert_same_efforts(problem, links, tmp_path / "out.urdf")


def test_robot_from_a_table(tmp_path: Path) -> None:
    rows = [
        {"alpha": 0.0, "d": 0.0, "theta": 0.0, "r": 0.0},
        {"alpha": np.pi / 2, "d": 0.1, "theta": 0.0, "r": 0.2},
    ]
    problem = problem_of(RobotModel.from_mdh(rows, gravity=(0.0, 9.81, 0.0)))
    links = bodies(np.random.default_rng(3), 2)
    write_urdf(estimate_of(problem, links), target=tmp_path / "out.urdf")
    assert_same_efforts(problem, links, tmp_path / "out.urdf")


def test_source_file_keeps_line_endings(tmp_path: Path, arm: Problem) -> None:
    source = tmp_path / "windows.urdf"
    source.write_bytes(ARM.replace("\n", "\r\n").encode())
    links = bodies(np.random.default_rng(0), 3)
    write_urdf(estimate_of(arm, links), target=source, source=source)  # in place
    data = source.read_bytes()
    assert data.count(b"\n") == data.count(b"\r\n") > 0
    assert_same_efforts(arm, links, source)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "latin-1", "utf-16"])
def test_source_file_keeps_its_encoding(tmp_path: Path, arm: Problem, encoding: str) -> None:
    declared = {"latin-1": "ISO-8859-1"}.get(encoding, encoding[:6])
    text = f'<?xml version="1.0" encoding="{declared}"?>\n<!-- größe -->' + undeclared(ARM)
    source, target = tmp_path / "source.urdf", tmp_path / "out.urdf"
    source.write_bytes(text.encode(encoding))
    links = bodies(np.random.default_rng(0), 3)
    write_urdf(estimate_of(arm, links), target=target, source=source)
    assert target.read_bytes().decode(encoding).startswith(text[:60])
    assert_same_efforts(arm, links, target)
    # The same from the robot's own text.
    own = problem_of(sdpid.load_robot(source))
    write_urdf(estimate_of(own, links), target=tmp_path / "own.urdf")
    assert (tmp_path / "own.urdf").read_bytes() == target.read_bytes()


def test_macros_of_the_source_are_expanded(tmp_path: Path, arm: Problem) -> None:
    pytest.importorskip("xacrodoc", reason="needs the extra xacro")
    source, target = tmp_path / "arm.xacro", tmp_path / "out.urdf"
    macro = '<xacro:macro xmlns:xacro="http://ros.org/wiki/xacro" name="a" params=""/>'
    text = ARM.replace("package://a/b.stl", "b.stl")  # packages are looked up
    source.write_text(text.replace("</robot>", f"{macro}</robot>"))
    links = bodies(np.random.default_rng(0), 3)
    write_urdf(estimate_of(arm, links), target=target, source=source)
    assert "xacro" not in target.read_text()
    assert_same_efforts(arm, links, target)


def test_refusals(tmp_path: Path, arm: Problem) -> None:
    links = bodies(np.random.default_rng(0), 3)
    good = estimate_of(arm, links)
    target = tmp_path / "out.urdf"
    with pytest.raises(ExportError, match="base parameters only"):
        write_urdf(replace(good, theta=None, method="wls"), target=target)
    massless = links.copy()
    massless[2, 0] = -0.1
    with pytest.raises(ExportError, match=r"'finger' has a mass of -0\.1 kg"):
        write_urdf(estimate_of(arm, massless), target=target)
    with pytest.raises(ExportError, match="Fs1 of joint 'j1' is -1 N"):
        write_urdf(estimate_of(arm, links, friction=-1.0), target=target)
    with pytest.raises(ExportError, match="no joint 'j1'"):
        write_urdf(good, target=target, source=ARM.replace('name="j1"', 'name="k1"'))
    with pytest.raises(ExportError, match="placed differently"):
        write_urdf(good, target=target, source=ARM.replace("0 0.1 0", "0 0.2 0"))
    with pytest.raises(ExportError, match=r"cannot read .*absent"):
        write_urdf(good, target=target, source=tmp_path / "absent.urdf")
    with pytest.raises(ExportError, match="document type"):
        write_urdf(good, target=target, source=ARM.replace("<!-- an", "<!DOCTYPE r><!-- an"))
    with pytest.raises(ModelError, match="link 'tool': value of <mass>"):
        write_urdf(good, target=target, source=ARM.replace('value="0.2"', 'value="heavy"'))
    refuses(ExportError, "cannot write", write_urdf, good, target=tmp_path / "no" / "out.urdf")
    nameless = replace(arm, robot=replace(arm.robot, urdf=None))
    refuses(ExportError, "as source", write_urdf, estimate_of(nameless, links), target=target)
    assert list(tmp_path.iterdir()) == []
