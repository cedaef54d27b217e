"""Ranges contain what they say, about the bodies that MuJoCo reads from the files."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from sdpid._common.arrays import Array
from sdpid.estimation.estimate import Estimate
from sdpid.output.samples.log_cholesky import NAMES, changed, changes
from sdpid.output.samples.ranges import Ranges
from sdpid.output.samples.write import SampleWriter, write_samples
from sdpid.robot.inertia import margin, theta_from_physical
from sdpid.robot.model.load import load_robot
from tests.helpers.drawn import draws_about, estimate_of, tree

COUNT = 40
PROBABILITY = 0.8

# The numbers of a file are doubles; a body's form loses what its condition number costs.
ROUNDING = 1e-8

ARM = """<robot name="arm"><link name="base"/>
<link name="upper"><inertial><origin xyz="0.1 0 0"/><mass value="2"/>
  <inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="tool"><inertial><origin xyz="0 0 0.1"/><mass value="0.5"/>
  <inertia ixx="0.002" iyy="0.002" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
  <origin xyz="0 0 0.3"/><axis xyz="0 0 1"/>
  <limit lower="-2" upper="2" effort="50" velocity="2"/></joint>
<joint name="wrist" type="revolute"><parent link="upper"/><child link="tool"/>
  <origin xyz="0.3 0 0"/><axis xyz="0 1 0"/>
  <limit lower="-2" upper="2" effort="50" velocity="2"/></joint>
</robot>"""

# The same arm, by other bodies: turned and shifted frames, and a cap fixed to the second.
TURNED = """<mujoco model="arm"><compiler angle="degree"/><worldbody>
<body name="first" pos="0.1 0 0.3" euler="0 90 0">
  <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
  <joint name="shoulder" pos="0 0 -0.1" axis="-1 0 0"/>
  <body name="second" pos="0 0.05 0.2" euler="0 0 30">
    <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
    <joint name="wrist" pos="-0.025 -0.0433012701892219323 0" axis="0.5 0.866025403784438647 0"/>
    <body name="cap" pos="0 0 0.1">
      <inertial pos="0 0 0" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/></body>
  </body>
</body></worldbody></mujoco>"""


def read_bodies(path: Path, names: list[str]) -> Array:
    """Return the bodies that MuJoCo finds in a file, in their own frames: what mjlab works on."""
    model = mujoco.MjModel.from_xml_path(str(path))
    out = []
    for name in names:
        body = model.body(name)
        R = np.empty(9)
        mujoco.mju_quat2Mat(R, body.iquat)
        R = R.reshape(3, 3)
        out.append(theta_from_physical(body.mass[0], body.ipos, R @ np.diag(body.inertia) @ R.T))
    return np.array(out)


@pytest.fixture(scope="module")
def estimate() -> Estimate:
    return estimate_of(tree())


@pytest.fixture(scope="module")
def thetas(estimate: Estimate) -> Array:
    return draws_about(estimate, COUNT)


@pytest.fixture(scope="module")
def ranges(estimate: Estimate, thetas: Array) -> Ranges:
    return SampleWriter(estimate, thetas, kinds=()).ranges(PROBABILITY, {"seed": 0})


@pytest.mark.parametrize("kind", ["urdf", "mjcf", "turned"])
def test_ranges_hold_for_the_bodies_that_mujoco_reads(tmp_path: Path, kind: str) -> None:
    estimate = estimate_of(load_robot(ARM))
    thetas = draws_about(estimate, COUNT)
    kinds, source = ((kind,), None) if kind != "turned" else (("mjcf",), TURNED)
    writer = SampleWriter(estimate, thetas, kinds=kinds, source=source)
    write_samples(writer, tmp_path, probability=PROBABILITY, made={}, diagnostics={})
    stated = json.loads((tmp_path / "ranges.json").read_text())["bodies"]
    assert list(stated) == (["first", "second"] if kind == "turned" else ["upper", "tool"])
    suffix = "urdf" if kind == "urdf" else "xml"
    paths = sorted(tmp_path.glob(f"robot_*.{suffix}"))
    robots = np.array([read_bodies(path, list(stated)) for path in paths])
    found = changes(robots, read_bodies(tmp_path / f"mean.{suffix}", list(stated)))
    assert len(found) == COUNT
    for k, body in enumerate(stated.values()):
        ends = np.array([body["pseudo_inertia"][f"{name}_range"] for name in NAMES])
        tail = 0.5 * (1.0 - PROBABILITY)
        assert np.allclose(np.quantile(found[:, k], [tail, 1.0 - tail], axis=0).T, ends, ROUNDING)
        within = np.all((ends[:, 0] <= found[:, k]) & (found[:, k] <= ends[:, 1]), axis=1)
        assert abs(within.mean() - body["inside"]) <= 1.0 / COUNT


def test_each_range_holds_its_share(estimate: Estimate, thetas: Array, ranges: Ranges) -> None:
    links = estimate.problem.robot.n_links
    bodies = thetas[:, : 10 * links].reshape(COUNT, links, 10)
    found = changes(bodies, bodies.mean(axis=0))
    for k, body in enumerate(ranges.bodies):
        for i, (low, high) in enumerate(body.changes.values()):
            inside = np.mean((low <= found[:, k, i]) & (found[:, k, i] <= high))
            assert inside == PROBABILITY
        masses = bodies[:, k, 0] / body.mass
        assert np.mean((masses >= body.mass_scale[0]) & (masses <= body.mass_scale[1])) == inside
    assert ranges.inside <= min(body.inside for body in ranges.bodies) <= PROBABILITY


def test_joints_have_ranges_of_what_the_problem_has(estimate: Estimate, ranges: Ranges) -> None:
    robot = estimate.problem.robot
    assert len(ranges.joints) == 3 * robot.n
    for each in ranges.joints:
        low, high = each.absolute
        assert 0.0 < low < each.reference < high
        assert each.scale is not None
        assert np.allclose(np.array(each.scale) * each.reference, [low, high])


def test_any_robot_within_the_ranges_is_a_body(ranges: Ranges, thetas: Array) -> None:
    rng = np.random.default_rng(0)
    ends = np.array([list(body.changes.values()) for body in ranges.bodies])
    mean = thetas.mean(axis=0)[: 10 * len(ends)].reshape(-1, 10)
    robots = changed(mean, rng.uniform(ends[..., 0], ends[..., 1], (100, *ends.shape[:2])))
    assert np.all(margin(robots, "pseudo_inertia") > 0.0)


def test_a_larger_share_has_wider_ranges(estimate: Estimate, thetas: Array) -> None:
    writer = SampleWriter(estimate, thetas, kinds=())
    narrow, wide = (writer.ranges(probability, {}) for probability in (0.5, 0.95))
    for a, b in zip(narrow.bodies, wide.bodies, strict=True):
        assert all(
            b.changes[n][0] <= a.changes[n][0] <= a.changes[n][1] <= b.changes[n][1] for n in NAMES
        )
    assert narrow.inside <= wide.inside


def test_independence_is_told_to_widen(estimate: Estimate, thetas: Array) -> None:
    """Draws that move along what the efforts hardly show; ranges forget that they do."""
    problem = estimate.problem
    _, _, V = np.linalg.svd(problem.A @ problem.base.matrix)
    unseen = V[problem.base.count :]
    along = thetas.mean(axis=0) + 0.1 * (thetas - thetas.mean(axis=0)) @ unseen.T @ unseen
    along += 1e-6 * (thetas - thetas.mean(axis=0))
    found = SampleWriter(estimate, along, kinds=()).ranges(PROBABILITY, {})
    usual = SampleWriter(estimate, thetas, kinds=()).ranges(PROBABILITY, {})
    assert found.widened > 100.0 > usual.widened > 0.0


def test_draws_that_are_too_few_are_told(estimate: Estimate, thetas: Array) -> None:
    enough = SampleWriter(estimate, thetas, kinds=()).ranges(0.95, {})
    assert enough.number == 40
    assert enough.notes == ()
    few = SampleWriter(estimate, thetas[:39], kinds=()).ranges(0.95, {})
    assert "draw 40 or more" in few.notes[0]
    one = SampleWriter(estimate, thetas[:1], kinds=()).ranges(0.95, {})
    assert one.widened is None
    assert one.to_dict()["independent"]["efforts_widened"] is None
    assert one.to_dict()["notes"] == list(one.notes) != []


def test_the_file_says_how_it_was_made(ranges: Ranges) -> None:
    content = ranges.to_dict()
    assert content["made"] == {"seed": 0, "number": COUNT, "probability": PROBABILITY}
    assert content["note"].startswith("Prefer the robots of the draws")
    assert content["independent"]["consistent"] == 1.0
    assert set(content["bodies"]["column"]["pseudo_inertia"]) == {f"{n}_range" for n in NAMES}
    assert "column" in ranges.table()
    assert "Ranges(" in repr(ranges)
