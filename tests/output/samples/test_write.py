"""Every drawn robot is audited, loads, and is the draw; a folder holds all of them or none."""

import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import sdpid
from sdpid._common.arrays import Array
from sdpid.errors import ExportError
from sdpid.estimation.estimate import Estimate
from sdpid.output.robots.urdf_errors import PLACES as URDF_PLACES
from sdpid.output.samples import patterns
from sdpid.output.samples.write import SampleWriter, write_samples
from sdpid.robot.description import mjcf, mjcf_bodies
from sdpid.robot.model.base_parameters import generic_states
from tests.helpers.drawn import draws_about, estimate_of, tree
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE, small_arm

COUNT = 5

# Efforts of a written robot, relative to the largest one: rounding of its numbers.
CLOSE = 1e-9

ARGUMENTS: dict[str, Any] = {"probability": 0.9, "made": {}, "diagnostics": {}}


def written(estimate: Estimate, thetas: Array, folder: Path, *kinds: str) -> tuple[Path, ...]:
    return write_samples(SampleWriter(estimate, thetas, kinds=kinds), folder, **ARGUMENTS)


@pytest.fixture(scope="module")
def estimate() -> Estimate:
    return estimate_of(tree())


@pytest.fixture(scope="module")
def thetas(estimate: Estimate) -> Array:
    return draws_about(estimate, COUNT)


@pytest.fixture(scope="module")
def folder(estimate: Estimate, thetas: Array, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("robots")
    written(estimate, thetas, path, "urdf", "mjcf")
    return path


@pytest.mark.parametrize("suffix", [".urdf", ".xml"])
def test_every_robot_is_the_draw(
    estimate: Estimate,
    thetas: Array,
    folder: Path,
    suffix: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # A process for each file takes seconds, and is for files of others.
    for module in (mjcf, mjcf_bodies):
        monkeypatch.setattr(module, "in_child", lambda read, *given, what: read(*given, what))
    robot, problem = estimate.problem.robot, estimate.problem
    states = generic_states(robot, 8, 1)
    names = [*(f"robot_{k + 1:04d}" for k in range(COUNT)), "mean"]
    for name, theta in zip(names, [*thetas, thetas.mean(axis=0)], strict=True):
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
            fitted = SampleWriter(estimate, thetas, kinds=()).attributes(URDF_PLACES)
            assert np.array_equal(dry, fitted["friction"][names.index(name)])
            assert np.array_equal(damping, fitted["damping"][names.index(name)])


def test_what_is_fixed_counts_where_it_is_fixed(folder: Path) -> None:
    text = (folder / "robot_0001.urdf").read_text()
    bracket = text[text.index('<link name="bracket">') :]
    assert '<mass value="0.0"/>' in bracket[: bracket.index("</link>")]


def test_the_mean_of_the_robots_is_the_mean(folder: Path) -> None:
    robots = [sdpid.load_robot(path).prior for path in sorted(folder.glob("robot_*.urdf"))]
    mean = sdpid.load_robot(folder / "mean.urdf").prior
    assert np.allclose(np.mean(robots, axis=0), mean, rtol=1e-12, atol=1e-15)


def test_the_manifest_lists_every_file(folder: Path) -> None:
    manifest = json.loads((folder / "samples.json").read_text())
    names = {path.name for path in folder.iterdir()}
    assert set(manifest["files"]) | {"samples.json"} == names
    assert manifest["number"] == COUNT
    assert len(names) == 2 * (COUNT + 1) + 3
    table = (folder / "draws.csv").read_text().splitlines()
    assert len(table) == COUNT + 2


def test_a_later_run_replaces_and_removes(
    estimate: Estimate, thetas: Array, tmp_path: Path
) -> None:
    written(estimate, thetas, tmp_path, "urdf")
    notes: list[str] = []
    changed = tmp_path / "robot_0005.urdf"
    changed.write_text("mine now")
    writer = SampleWriter(estimate, thetas[:2], kinds=("urdf",))
    write_samples(writer, tmp_path, **ARGUMENTS, report=notes.append)
    left = sorted(path.name for path in tmp_path.glob("robot_*"))
    assert left == ["robot_0001.urdf", "robot_0002.urdf", "robot_0005.urdf"]
    assert changed.read_text() == "mine now"
    assert len(notes) == 1
    assert "robot_0005.urdf" in notes[0]


def test_files_of_others_are_not_replaced(
    estimate: Estimate, thetas: Array, tmp_path: Path
) -> None:
    (tmp_path / "robot_0002.urdf").write_text("precious")
    with pytest.raises(ExportError, match=r"robot_0002\.urdf, which no run like this wrote"):
        written(estimate, thetas, tmp_path, "urdf")
    assert [path.name for path in tmp_path.iterdir()] == ["robot_0002.urdf"]


def test_a_failure_leaves_nothing(
    estimate: Estimate, thetas: Array, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = patterns.compiled
    calls: list[str] = []

    def refusing(text: str, path: None, folder: None, what: str) -> object:
        calls.append(what)
        if len(calls) == 3:
            raise ExportError("no")
        return real(text, path, folder, what)

    monkeypatch.setattr(patterns, "compiled", refusing)
    refuses(ExportError, "no", written, estimate, thetas, tmp_path / "new", "urdf", "mjcf")
    assert not (tmp_path / "new").exists()


def test_impossible_draws_are_refused_by_name(
    estimate: Estimate, thetas: Array, tmp_path: Path
) -> None:
    wrong = thetas.copy()
    wrong[3, 4] = -1.0
    with pytest.raises(ExportError, match=r"link 'column' is not consistent"):
        written(estimate, wrong, tmp_path, "urdf")
    wrong = thetas.copy()
    wrong[2, -1] = -0.5
    refuses(ExportError, r"Ia\d of joint", written, estimate, wrong, tmp_path, "mjcf")
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
    estimate: Estimate, thetas: Array, kinds: Any, source: str | None, words: str
) -> None:
    refuses(ExportError, words, SampleWriter, estimate, thetas, kinds=kinds, source=source)


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


def test_draws_that_need_be_no_bodies_are_refused() -> None:
    estimate = estimate_of(small_arm(2), consistency="spatial_inertia")
    with pytest.raises(ExportError, match="solve with consistency='pseudo_inertia'"):
        SampleWriter(estimate, draws_about(estimate, 2), kinds=("mjcf",))
