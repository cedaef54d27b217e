"""Drawn robots: their friction, ranges and files."""

import itertools
import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis.extra import numpy as hnp

import sdpid
from sdpid._common.arrays import Array
from sdpid.errors import ExportError
from sdpid.estimation.estimate import Estimate
from sdpid.friction import Coulomb, SigmoidFriction, Viscous
from sdpid.output.robots.export_report import PLACES as URDF_PLACES
from sdpid.output.robots.joint_friction import joint_attributes
from sdpid.output.robots.mjcf import PLACES
from sdpid.output.samples import write
from sdpid.output.samples.ranges import NAMES, Ranges, changed, changes
from sdpid.output.samples.write import SampleWriter, drawn_attributes, write_samples
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.inertia import margin, physical_parameters, theta_from_physical, transform
from sdpid.robot.model.base_parameters import generic_states
from sdpid.robot.model.load import load_robot
from tests.helpers.data import full_regressor, random_theta
from tests.helpers.drawn import draws_about, estimate_of, tree
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE, small_arm
from tests.helpers.strategies import bodies, reals, rotations

ARM = small_arm(2)
ROUNDING = 1e-9

Terms = tuple[str | FrictionTerm, ...]
TERMS: dict[str, Terms] = {
    "places for all": ("coulomb", "viscous", "rotor_inertia"),
    "curves": (Coulomb(width=0.1), SigmoidFriction(velocity=0.5), Viscous()),
    "offsets": ("coulomb", "viscous", "offset"),
}


def made(terms: Terms, friction: Array, links: Array, noise: float) -> Estimate:
    """Return an estimate with its own samples, of the same motion whatever the friction."""
    rng = np.random.default_rng(2)
    q, v, a = rng.uniform(-2.0, 2.0, (3, 300, 2))
    theta = np.concatenate([links, friction])
    effort = full_regressor(ARM, (q, v, a), terms) @ theta
    effort = effort + noise * rng.standard_normal(effort.shape)
    samples = sdpid.Samples(position=q, velocity=v, acceleration=a, effort=effort)
    problem = sdpid.build_problem(ARM, samples, friction=terms, check_excitation=False)
    return Estimate.of_theta(problem, theta, method="sdp", status="optimal")


def attributes_of(estimate: Estimate) -> dict[str, list[float]]:
    """Return the attributes of the joints of an estimate's robot, kind by kind."""
    found = joint_attributes(estimate.problem, estimate.theta, PLACES, "robot").values
    known = [(kind, name) for kind, name in PLACES.items() if name in found["joint_1"]]
    return {kind: [found[joint][name] for joint in ARM.joint_names] for kind, name in known}


@pytest.mark.parametrize("terms", TERMS.values(), ids=TERMS)
def test_a_draw_has_the_attributes_of_a_robot_of_its_own(terms: Terms) -> None:
    """Of exact data: what the estimate leaves unexplained is nothing for either."""
    rng = np.random.default_rng(5)
    theta = random_theta(ARM, rng, terms)
    links, friction = theta[:20], theta[20:]
    draws = friction * rng.uniform(0.5, 1.5, (4, len(friction)))
    estimate = made(terms, friction, links, 0.0)
    thetas = np.array([np.concatenate([links, each]) for each in draws])
    found = drawn_attributes(estimate.problem, estimate.theta, thetas, PLACES, "robots")
    for k, draw in enumerate(draws):
        for kind, expected in attributes_of(made(terms, draw, links, 0.0)).items():
            np.testing.assert_allclose(found[kind][k], expected, rtol=0, atol=ROUNDING)
    # Among them, with noise, the estimate itself.
    noisy = made(terms, friction, links, 0.05)
    found = drawn_attributes(noisy.problem, theta, theta[None], PLACES, "robots")
    expected = attributes_of(noisy)
    assert found.keys() == expected.keys()
    for kind, values in found.items():
        np.testing.assert_allclose(values[0], expected[kind], rtol=0, atol=ROUNDING)


# The log-Cholesky form of a change: round trips, and what each of its numbers does.


# Bodies of the strategies have condition numbers up to some 1e5.
FLOAT_ROUNDING = 1e-8

CHANGES = hnp.arrays(float, 10, elements=reals(-1.0, 1.0))


def close(found: Array, expected: Array) -> bool:
    return bool(np.abs(found - expected).max() <= FLOAT_ROUNDING * max(1.0, np.abs(expected).max()))


@given(bodies(), bodies(), CHANGES)
def test_a_change_leaves_a_body_and_is_found_again(
    body: Array, reference: Array, change: Array
) -> None:
    after = changed(body, change)
    assert margin(after, "pseudo_inertia") > 0.0
    assert close(changes(after, body), change)
    assert close(changed(reference, changes(body, reference)), body)


@given(bodies(), reals(-1.0, 1.0), hnp.arrays(float, 3, elements=reals(-0.3, 0.3)))
def test_density_and_shift_do_what_they_say(body: Array, alpha: float, shift: Array) -> None:
    change = np.zeros(10)
    change[0], change[7:] = alpha, shift
    mass, com, inertia = physical_parameters(body)
    new_mass, new_com, new_inertia = physical_parameters(changed(body, change))
    assert np.isclose(new_mass, mass * np.exp(2.0 * alpha))
    assert close(new_com, com + shift)
    assert close(new_inertia, inertia * np.exp(2.0 * alpha))


@given(bodies(), CHANGES, rotations())
def test_the_numbers_belong_to_a_frame(body: Array, change: Array, rotation: Array) -> None:
    """In a turned frame the same change of shape has other numbers, alpha apart."""
    after = changed(body, change)
    turned = [transform(each, rotation, np.zeros(3)) for each in (after, body)]
    there = changes(*turned)
    assert close(changed(turned[1], there), turned[0])
    assert np.isclose(there[0], change[0], atol=FLOAT_ROUNDING)


def test_names_are_those_of_the_form() -> None:
    """Each number alone moves one entry of the factor of a unit body about its center."""
    body = np.array([1.0, 0, 0, 0, 2.0, 0, 2.0, 0, 0, 2.0])
    for k, name in enumerate(NAMES):
        change = np.zeros(10)
        change[k] = 0.1
        found = changed(body, change)
        if name.startswith("t"):
            assert np.isclose(found[int(name[1])], 0.1)
        if name.startswith("d"):
            axis = int(name[1]) - 1
            # The second moment along the axis, ½·tr(I) − I_ii.
            diagonal = found[[4, 6, 9]]
            assert np.isclose(0.5 * diagonal.sum() - diagonal[axis], np.exp(0.2))
        if name.startswith("s"):
            i, j = int(name[1]), int(name[2])
            entry = {(1, 2): 5, (1, 3): 7, (2, 3): 8}[i, j]
            assert np.isclose(found[entry], -0.1)


# Ranges contain what they say, about the bodies that MuJoCo reads from the files.


COUNT = 40
PROBABILITY = 0.8

# The numbers of a file are doubles; a body's form loses what its condition number costs.
ROUNDED = 1e-8

RANGED = """<robot name="arm"><link name="base"/>
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
    return ranges_of(estimate, thetas, made={"seed": 0})


def ranges_of(
    estimate: Estimate, thetas: Array, probability: float = PROBABILITY, made: Any = None
) -> Ranges:
    return SampleWriter(estimate, thetas, kinds=()).ranges(probability, made or {})


@pytest.mark.parametrize("kind", ["urdf", "mjcf", "turned"])
def test_ranges_hold_for_the_bodies_that_mujoco_reads(tmp_path: Path, kind: str) -> None:
    estimate = estimate_of(load_robot(RANGED))
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
        assert np.allclose(np.quantile(found[:, k], [tail, 1.0 - tail], axis=0).T, ends, ROUNDED)
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
    narrow, wide = (ranges_of(estimate, thetas, share) for share in (0.5, 0.95))
    for a, b in zip(narrow.bodies, wide.bodies, strict=True):
        for name in NAMES:
            (low, high), (least, most) = a.changes[name], b.changes[name]
            assert least <= low <= high <= most
    assert narrow.inside <= wide.inside


def test_independence_is_told_to_widen(estimate: Estimate, thetas: Array) -> None:
    """Draws that move along what the efforts hardly show; ranges forget that they do."""
    problem = estimate.problem
    _, _, V = np.linalg.svd(problem.A @ problem.base.matrix)
    unseen = V[problem.base.count :]
    apart = thetas - thetas.mean(axis=0)
    along = thetas.mean(axis=0) + 0.1 * apart @ unseen.T @ unseen + 1e-6 * apart
    found, usual = ranges_of(estimate, along), ranges_of(estimate, thetas)
    assert found.widened > 100.0 > usual.widened > 0.0


def test_draws_that_are_too_few_are_told(estimate: Estimate, thetas: Array) -> None:
    enough, few, one = (ranges_of(estimate, thetas[:count], 0.95) for count in (40, 39, 1))
    assert (enough.number, enough.notes) == (40, ())
    assert "draw 40 or more" in few.notes[0]
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


# Every drawn robot is audited, loads, and is the draw; a folder holds all of them or none.


WRITTEN = 5

# Efforts of a written robot, relative to the largest one: rounding of its numbers.
CLOSE = 1e-9

ARGUMENTS: dict[str, Any] = {"probability": 0.9, "made": {}, "diagnostics": {}}


def written(estimate: Estimate, thetas: Array, folder: Path, *kinds: str) -> tuple[Path, ...]:
    return write_samples(SampleWriter(estimate, thetas, kinds=kinds), folder, **ARGUMENTS)


@pytest.fixture(scope="module")
def draws(estimate: Estimate) -> Array:
    return draws_about(estimate, WRITTEN)


@pytest.fixture(scope="module")
def folder(estimate: Estimate, draws: Array, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("robots")
    written(estimate, draws, path, "urdf", "mjcf")
    return path


@pytest.mark.parametrize("suffix", [".urdf", ".xml"])
def test_every_robot_is_the_draw(
    estimate: Estimate, draws: Array, folder: Path, suffix: str
) -> None:
    robot, problem = estimate.problem.robot, estimate.problem
    states = generic_states(robot, 8, 1)
    names = [*(f"robot_{k + 1:04d}" for k in range(WRITTEN)), "mean"]
    for name, theta in zip(names, [*draws, draws.mean(axis=0)], strict=True):
        path = folder / f"{name}{suffix}"
        assert sdpid.audit_urdf(path).passed
        mujoco.MjModel.from_xml_path(str(path))
        found = sdpid.load_robot(path)
        order = [found.joint_names.index(joint) for joint in robot.joint_names]
        inverse = np.argsort(order)
        efforts = found.inverse_dynamics(found.prior, *(each[:, inverse] for each in states))
        expected = robot.inverse_dynamics(problem.feasible.bodies(theta), *states)
        assert np.abs(efforts[:, order] - expected).max() <= CLOSE * np.abs(expected).max()
        damping, dry = (each[order] for each in found.described_friction())
        if suffix == ".xml":
            friction = np.array([dry, damping, found.described_armature()[order]])
            assert np.array_equal(friction.ravel(), theta[10 * robot.n_links :])
        else:  # without a place for rotor inertia
            fitted = SampleWriter(estimate, draws, kinds=()).attributes(URDF_PLACES)
            assert np.array_equal(dry, fitted["friction"][names.index(name)])
            assert np.array_equal(damping, fitted["damping"][names.index(name)])


def test_a_folder_holds_robots_their_mean_and_a_list_of_all(folder: Path) -> None:
    # What is fixed counts where it is fixed.
    text = (folder / "robot_0001.urdf").read_text()
    bracket = text[text.index('<link name="bracket">') :]
    assert '<mass value="0.0"/>' in bracket[: bracket.index("</link>")]
    robots = [sdpid.load_robot(path).prior for path in sorted(folder.glob("robot_*.urdf"))]
    mean = sdpid.load_robot(folder / "mean.urdf").prior
    assert np.allclose(np.mean(robots, axis=0), mean, rtol=1e-12, atol=1e-15)
    manifest = json.loads((folder / "samples.json").read_text())
    names = {path.name for path in folder.iterdir()}
    assert set(manifest["files"]) | {"samples.json"} == names
    assert manifest["number"] == WRITTEN
    assert len(names) == 2 * (WRITTEN + 1) + 3
    table = (folder / "draws.csv").read_text().splitlines()
    assert len(table) == WRITTEN + 2


def test_a_later_run_replaces_and_removes(estimate: Estimate, draws: Array, tmp_path: Path) -> None:
    written(estimate, draws, tmp_path, "urdf")
    notes: list[str] = []
    changed = tmp_path / "robot_0005.urdf"
    changed.write_text("mine now")
    writer = SampleWriter(estimate, draws[:2], kinds=("urdf",))
    write_samples(writer, tmp_path, **ARGUMENTS, report=notes.append)
    left = sorted(path.name for path in tmp_path.glob("robot_*"))
    assert left == ["robot_0001.urdf", "robot_0002.urdf", "robot_0005.urdf"]
    assert changed.read_text() == "mine now"
    assert len(notes) == 1
    assert "robot_0005.urdf" in notes[0]


def test_files_of_others_are_not_replaced(estimate: Estimate, draws: Array, tmp_path: Path) -> None:
    (tmp_path / "robot_0002.urdf").write_text("precious")
    words = r"robot_0002\.urdf, which no run like this wrote"
    refuses(ExportError, words, written, estimate, draws, tmp_path, "urdf")
    assert [path.name for path in tmp_path.iterdir()] == ["robot_0002.urdf"]


def test_a_failure_leaves_nothing(
    estimate: Estimate, draws: Array, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, calls = write.compiled, itertools.count(1)

    def refusing(*given: Any) -> object:
        if next(calls) == 3:
            raise ExportError("no")
        return real(*given)

    monkeypatch.setattr(write, "compiled", refusing)
    refuses(ExportError, "no", written, estimate, draws, tmp_path / "new", "urdf", "mjcf")
    assert not (tmp_path / "new").exists()


def test_impossible_draws_are_refused_by_name(
    estimate: Estimate, draws: Array, tmp_path: Path
) -> None:
    for place, value, kind, words in (
        ((3, 4), -1.0, "urdf", "link 'column' is not consistent"),
        ((2, -1), -0.5, "mjcf", r"Ia\d of joint"),
    ):
        wrong = draws.copy()
        wrong[place] = value
        refuses(ExportError, words, written, estimate, wrong, tmp_path, kind)
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("kinds", "source", "words"),
    [
        (("sdf",), None, "give some of 'urdf', 'mjcf'"),
        ("urdf", None, "give some of 'urdf', 'mjcf'"),
        (("urdf",), "<mujoco/>", "no URDF can be made of it"),
    ],
)
def test_what_cannot_be_written(
    estimate: Estimate, draws: Array, kinds: Any, source: str | None, words: str
) -> None:
    refuses(ExportError, words, SampleWriter, estimate, draws, kinds=kinds, source=source)
    loose = estimate_of(small_arm(2), consistency="spatial_inertia")
    words = "solve with consistency='pseudo_inertia'"
    refuses(ExportError, words, SampleWriter, loose, draws_about(loose, 2), kinds=("mjcf",))


def test_a_robot_without_a_urdf_has_an_mjcf(tmp_path: Path) -> None:
    estimate = estimate_of(sdpid.RobotModel.from_pinocchio(small_arm(2).pin_model))
    thetas = draws_about(estimate, 2)
    refuses(ExportError, "not loaded from a URDF", written, estimate, thetas, tmp_path, "urdf")
    written(estimate, thetas, tmp_path, "mjcf")
    assert sdpid.load_robot(tmp_path / "robot_0002.xml").n == 2


def test_a_base_that_cannot_exist_is_nothing(tmp_path: Path) -> None:
    inertia = '<inertia ixx="1" iyy="1" izz="9" ixy="0" ixz="0" iyz="0"/>'
    base = f'<link name="base"><inertial><mass value="3"/>{inertia}</inertial></link>'
    estimate = estimate_of(sdpid.load_robot(TREE.replace('<link name="base"/>', base)))
    writer = SampleWriter(estimate, draws_about(estimate, 1), kinds=("urdf",))
    notes: list[str] = []
    write_samples(writer, tmp_path, **ARGUMENTS, report=notes.append)
    assert "no body can have, now zero: base" in notes[0]
    assert sdpid.audit_urdf(tmp_path / "robot_0001.urdf").passed
    mujoco.MjModel.from_xml_path(str(tmp_path / "robot_0001.urdf"))


def test_a_floating_base_has_a_body_too(tmp_path: Path) -> None:
    estimate = estimate_of(sdpid.load_robot(TREE, root="free_flyer"), ("coulomb", "viscous"))
    written(estimate, draws_about(estimate, 2), tmp_path, "urdf", "mjcf")
    assert sdpid.audit_urdf(tmp_path / "robot_0002.urdf").passed
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "robot_0002.xml")).nv == 6 + 6
