"""Written URDFs and friction files are the identified robot, and what no body has is repaired."""

import ctypes
import difflib
import os
import re
import runpy
import shutil
import subprocess
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sdpid
from sdpid._common.arrays import Array
from sdpid.assurance.descriptions.nearest_body import NEAREST, prove_nearest
from sdpid.assurance.diagnostics.validation import validate_robot
from sdpid.errors import CertificateError, ExportError, ModelError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem, build_problem
from sdpid.experiment.preparation.for_robot import SMOOTH
from sdpid.friction import (
    AsymmetricCoulomb,
    Coulomb,
    Coupling,
    JointwiseTerm,
    LoadFriction,
    Offset,
    RotorInertia,
    SigmoidFriction,
    SquareRootFriction,
    Stribeck,
    Tilt,
    Viscous,
)
from sdpid.output.robots.export_report import Errors, ExportReport, file_errors, urdf_errors
from sdpid.output.robots.friction_files import cpp, friction_data, python, write_friction
from sdpid.output.robots.joint_friction import Kind, LeftOut, joint_attributes
from sdpid.output.robots.repair import TOKEN_MASS, repair_urdf
from sdpid.output.robots.urdf import write_urdf
from sdpid.robot.description.bodies import read_urdf_bodies
from sdpid.robot.description.xml import undeclared
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.inertia import margin, point_masses, second_moment_from_inertia
from sdpid.robot.model.base_parameters import generic_states
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.robot.model.model import RobotModel
from tests.helpers import legged
from tests.helpers.arm import ARM as FRICTION_ARM
from tests.helpers.data import friction_model, full_regressor, random_links, random_theta
from tests.helpers.descriptions import box, chain, diagonal, inertial, inertial_of
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE, TREE_MIMIC, small_arm
from tests.helpers.strategies import SEEDS, friction_terms_of, random_states, reals
from tests.helpers.strategies import bodies as broken_bodies
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


LINKS = bodies(np.random.default_rng(0), 3)


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


def written(problem: Problem, links: np.ndarray, path: Path, **options: Any) -> ExportReport:
    """Write a URDF that differs from the estimate in nothing and has the same efforts."""
    estimate = estimate_of(problem, links)
    report = write_urdf(estimate, target=path, **options)
    assert differences(estimate, path) == []
    assert_same_efforts(problem, links, path)
    return report


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


def test_only_inertials_and_dynamics_change(tmp_path: Path, arm: Problem) -> None:
    report = write_urdf(estimate_of(arm, LINKS), target=tmp_path / "out.urdf")
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
    theta = np.concatenate([LINKS.ravel(), [0.1, 0.2, 0.3, 1.1, 1.2, 1.3]])
    estimate = Estimate.of_theta(arm, theta, method="sdp", status="optimal")
    write_urdf(estimate, target=tmp_path / "out.urdf")
    model = sdpid.load_robot(tmp_path / "out.urdf").pin_model
    assert np.array_equal(model.friction, [0.1, 0.2, 0.3]) or np.array_equal(
        model.upperDryFrictionLimit, [0.1, 0.2, 0.3]
    )
    assert np.array_equal(model.damping, [1.1, 1.2, 1.3])


def test_friction_of_followers_counts_at_their_source(tmp_path: Path) -> None:
    problem = problem_of(sdpid.load_robot(MIMIC), friction=("viscous", "offset")).without_rows()
    report = write_urdf(estimate_of(problem, LINKS), target=tmp_path / "out.urdf")
    out = (tmp_path / "out.urdf").read_text()
    assert '<dynamics damping="0.0"/>' in out
    assert "damping='0.75' friction=\"0.25\"" in out  # no Coulomb term: friction stays
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
    found = {b.name: b.theta for b in read_urdf_bodies(target.read_text(), "written")[1]}
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
        found = sdpid.load_robot(tmp_path / "out.urdf")
        assert margin(found.prior, "pseudo_inertia").min() > -1e-15


def test_spatial_consistency_may_violate_the_triangle(tmp_path: Path, arm: Problem) -> None:
    problem = arm.constrained(consistency="spatial_inertia")
    links = LINKS.copy()
    links[0, 4:] = [5.0, 0.0, 1.0, 0.0, 0.0, 1.0]
    links[0, 1:4] = 0.0
    report = written(problem, links, tmp_path / "out.urdf")
    assert report.triangle_violations == ("upper",)
    words, target = "'upper' is not consistent", tmp_path / "no.urdf"
    refuses(ExportError, words, write_urdf, estimate_of(arm, links), target=target)
    assert not (tmp_path / "no.urdf").exists()


def test_source_file_keeps_line_endings(tmp_path: Path, arm: Problem) -> None:
    source = tmp_path / "windows.urdf"
    source.write_bytes(ARM.replace("\n", "\r\n").encode())
    written(arm, LINKS, source, source=source)  # in place
    data = source.read_bytes()
    assert data.count(b"\n") == data.count(b"\r\n") > 0


@pytest.mark.parametrize("encoding", ["utf-8-sig", "latin-1", "utf-16"])
def test_source_file_keeps_its_encoding(tmp_path: Path, arm: Problem, encoding: str) -> None:
    declared = {"latin-1": "ISO-8859-1"}.get(encoding, encoding[:6])
    text = f'<?xml version="1.0" encoding="{declared}"?>\n<!-- größe -->' + undeclared(ARM)
    source, target = tmp_path / "source.urdf", tmp_path / "out.urdf"
    source.write_bytes(text.encode(encoding))
    written(arm, LINKS, target, source=source)
    assert target.read_bytes().decode(encoding).startswith(text[:60])
    # The same from the robot's own text.
    own = problem_of(sdpid.load_robot(source))
    write_urdf(estimate_of(own, LINKS), target=tmp_path / "own.urdf")
    assert (tmp_path / "own.urdf").read_bytes() == target.read_bytes()


def test_macros_of_the_source_are_expanded(tmp_path: Path, arm: Problem) -> None:
    pytest.importorskip("xacrodoc", reason="needs the extra xacro")
    source, target = tmp_path / "arm.xacro", tmp_path / "out.urdf"
    macro = '<xacro:macro xmlns:xacro="http://ros.org/wiki/xacro" name="a" params=""/>'
    text = ARM.replace("package://a/b.stl", "b.stl")  # packages are looked up
    source.write_text(text.replace("</robot>", f"{macro}</robot>"))
    written(arm, LINKS, target, source=source)
    assert "xacro" not in target.read_text()


def test_refusals(tmp_path: Path, arm: Problem) -> None:
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
        refuses(ExportError, words, write_urdf, estimate, target=target)
    for error, source, words in (
        (ExportError, ARM.replace('name="j1"', 'name="k1"'), "no joint 'j1'"),
        (ExportError, ARM.replace("0 0.1 0", "0 0.2 0"), "placed differently"),
        (ExportError, tmp_path / "absent.urdf", r"cannot read .*absent"),
        (ExportError, ARM.replace("<!-- an", "<!DOCTYPE r><!-- an"), "document type"),
        (ModelError, ARM.replace('value="0.2"', 'value="heavy"'), "link 'tool': value of <mass>"),
    ):
        refuses(error, words, write_urdf, good, target=target, source=source)
    refuses(ExportError, "cannot write", write_urdf, good, target=tmp_path / "no" / "out.urdf")
    assert list(tmp_path.iterdir()) == []


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
    model.name = robot
    for k, name in enumerate(joints, start=1):
        model.names[k] = name
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
    for i in range(len(v)):
        for function, given_, wanted in (
            ("friction", (v,), friction),
            ("drives", (a,), drives),
            ("load", (v, load), held),
        ):
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


class Subclassed(Coulomb):
    """A term that looks like one of ours."""


@pytest.mark.parametrize("term", [Own(), Subclassed()])
def test_terms_of_your_own_are_refused_by_name(term: FrictionTerm, tmp_path: Path) -> None:
    with pytest.raises(ExportError, match=f"{type(term).__name__} is a term of your own"):
        write_friction(model_of(FRICTION_ARM, (term,)), tmp_path / "friction.py")
    assert not list(tmp_path.iterdir())


def test_other_languages_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match=r"written as \.py or \.hpp"):
        write_friction(CASES[0], tmp_path / "friction.rs")


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

    mujoco = pytest.importorskip("mujoco")
    mujoco.MjModel.from_xml_string(text)
    return pin.buildModelFromXML(text)


def tensors(text: str) -> dict[str, np.ndarray]:
    _, described = read_urdf_bodies(text, "test")
    return {body.name: body.tensor for body in described if body.tensor is not None}


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
    P = second_moment_from_inertia(tensor)
    negative = np.minimum(np.linalg.eigvalsh(P), 0.0)
    assert body.proof.distance >= np.linalg.norm(negative) * (1.0 - 1e-9)
    assert body.proof.lower_bound <= body.proof.distance
    assert body.proof.distance <= (1.0 + NEAREST) * body.proof.lower_bound
    found = tensors(report.text)["link2"]
    moved = np.linalg.norm(second_moment_from_inertia(found) - P)
    assert moved == pytest.approx(body.proof.distance, rel=1e-9)
    assert sdpid.audit_urdf(report.text).passed
    again = repair_urdf(report.text)
    assert again.text == report.text
    assert not again.bodies
    load_everywhere(report.text)


@given(st.lists(broken_bodies(), min_size=1, max_size=3))
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
    before, after = text.split('"'), written.split('"')
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


def test_mjcf_is_refused() -> None:
    refuses(ExportError, "MJCF", repair_urdf, "<mujoco/>")


def exact(matrix: np.ndarray) -> list[list[Fraction]]:
    return [[Fraction(float(x)) for x in row] for row in matrix]


def test_proofs_refuse_what_is_not_nearest() -> None:
    P, floor = np.diag([-1.0, 2.0, 3.0]), Fraction(1, 1000)
    right = np.diag([1.1e-3, 2.0, 3.0])
    assert prove_nearest(exact(P), exact(np.diag([1.0000001e-3, 2.0, 3.0])), floor).distance > 1.0
    refuses(CertificateError, "proven", prove_nearest, exact(P), exact(right), floor)
    low, turned = np.diag([0.9e-3, 2.0, 3.0]), right + 1e-3 * (np.ones((3, 3)) - np.eye(3))
    refuses(CertificateError, "below", prove_nearest, exact(P), exact(low), floor)
    refuses(CertificateError, "proven", prove_nearest, exact(P), exact(turned), floor)


def test_a_robot_of_others() -> None:
    from sdpid.robot.description.catalog import find_robot

    path = find_robot("finger_edu_description/finger_edu")
    report = repair_urdf(path)
    assert [body.link for body in report.bodies] == ["finger_lower_link"]


# Friction in written files predicts the recordings as well as its form allows.


TWO_JOINTS = small_arm(2)
URDF: dict[Kind, str] = {Coulomb: "friction", Viscous: "damping"}
MJCF: dict[Kind, str] = {Coulomb: "frictionloss", Viscous: "damping", RotorInertia: "armature"}
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
    problem = build_problem(TWO_JOINTS, samples, friction=terms, check_excitation=False)
    return Estimate.of_theta(problem, theta, method="sdp", status="optimal"), theta.copy()


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
    pytest.importorskip("mujoco")
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
    assert warning in Errors(file=0.051, estimate=0.025).warning
    assert not Errors(file=0.049, estimate=0.025).warning
    assert not Errors(file=0.019, estimate=0.001).warning
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
    problem = build_problem(
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
    estimate = Estimate.of_theta(problem, theta, method="sdp", status="optimal")
    numbers = [found.values[joint] for joint in made.robot.joint_names[6:]]
    written = [np.r_[np.zeros(6), [each[key] for each in numbers]] for key in URDF.values()]
    attributes = written[0], written[1], np.zeros(18)
    errors = file_errors(estimate, None, robot=problem.robot, attributes=attributes)
    assert errors.estimate < 0.01
    assert errors.file < 0.05
