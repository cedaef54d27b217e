"""Linkages in MuJoCo, from a recording of their motors to a result that is proven."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid.errors import DataError, ModelError
from sdpid.robot.model.closure import close_loops
from sdpid.robot.model.jacobians import frame_gaps
from sdpid.workflow.result import Identification
from tests.helpers.closed_chains import mjcf as chain_mjcf
from tests.helpers.closed_chains import run as run_chain
from tests.helpers.linkages import mjcf, run, urdf

mujoco = pytest.importorskip("mujoco")

# What was found of which log, and the file of the robot.
Run = tuple[Identification, sdpid.Recording, Path]
STARTS = {"four_bar": (1.0, 0.0, 0.0), "five_bar": (2.0, 0.0, 1.14, 0.0)}
# Friction is none in the plant; the prior is that of the description, which is 15 % off.
SETTINGS: dict[str, Any] = {"friction": (), "effects": "none", "intervals": False}


@pytest.fixture(scope="module", params=["four_bar", "five_bar"])
def identified(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Run:
    name = request.param
    path = tmp_path_factory.mktemp("loop") / f"{name}.urdf"
    # A ball in a plane, and a pin, are the same.
    path.write_text(urdf(name, kind="spherical" if name == "four_bar" else "revolute"))
    robot = sdpid.load_robot(path)
    start = close_loops(robot, np.array([STARTS[name]]), robot.passive)[0]
    scale = np.random.default_rng(1).uniform(0.85, 1.15, robot.n)
    log, position = run(name, seconds=2.0, seed=0, scale=scale, start=start)
    other, _ = run(name, seconds=1.5, seed=1, scale=scale, start=start)
    # MuJoCo's joints without motors are where the loop closes.
    known = np.where(np.isin(robot.joint_names, robot.passive), 0.0, position)
    np.testing.assert_allclose(close_loops(robot, known, robot.passive), position, atol=2e-6)
    return sdpid.identify(path, log, validation=other, **SETTINGS), log, path


def test_motors_alone_identify_a_linkage(identified: Run) -> None:
    result, _, _ = identified
    assert result.certificate.passed
    assert result.certificate.gap < 1e-6
    # Nothing was measured at joints without motors, and nothing is to be said of them.
    assert result.validation.relative < 5e-4
    assert not any(finding.kind == "effort_constant" for finding in result.findings)
    assert not any("worse than a constant" in words for words in result.verdict)
    described = result.problem.base_of(result.problem.robot.prior.ravel())
    assert result.problem.cost(described) > 1e3 * result.problem.cost(result.estimate.base)
    assert any("are those that close the loops" in note for note in result.problem.samples.notes)


def test_a_loop_is_proven_from_the_log(identified: Run, tmp_path: Path) -> None:
    result, log, path = identified
    result.save(tmp_path / "run", figures=False)
    whole = sdpid.verify(tmp_path / "run", data=log)
    assert whole.passed, whole.problems
    assert {"robot", "contacts", "weights", "rows"} <= whole.log.complete
    assert whole.log.gap < 1e-6
    # The same with the loop a little farther out is another robot.
    ends = path.read_text()
    for length in ("0.25", "0.22"):
        ends = ends.replace(f'xyz="{length} 0 0"/><axis', f'xyz="{length}1 0 0"/><axis')
    assert ends != path.read_text()
    other = sdpid.verify(tmp_path / "run", data=log, robot=sdpid.load_robot(ends))
    assert not other.passed


def test_an_mjcf_of_the_result_closes(identified: Run, tmp_path: Path) -> None:
    result, _, path = identified
    sdpid.write_mjcf(result.estimate, target=tmp_path / "out.xml")
    described = sdpid.load_robot(path)
    # A pin is two balls on its axis.
    count = 2 if described.loops[0].kind == "line" else 1
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out.xml"))
    assert model.neq == count
    again = sdpid.load_robot(tmp_path / "out.xml")
    assert [loop.kind for loop in again.loops] == ["point"] * count
    # Where the description's loop is closed, so is the file's.
    start = np.array([STARTS[described.name]])
    closed = close_loops(described, start, described.passive)
    for loop in again.loops:
        assert frame_gaps(again, closed, [loop.frame], [loop.against]) < 1e-9


def test_recorded_positions_and_other_columns(tmp_path: Path) -> None:
    """Joints without motors may be recorded, and efforts of theirs do not count."""
    robot = sdpid.load_robot(mjcf("four_bar"))
    start = close_loops(sdpid.load_robot(urdf("four_bar")), np.array([[1.0, 0, 0]]), robot.passive)
    log, position = run("four_bar", seconds=1.0, seed=0, start=start[0])
    whole = sdpid.Recording(
        time=log.time,
        position=position,
        effort=np.column_stack([log.effort[:, 0], log.effort[:, 0], 0.0 * log.effort[:, 0]]),
        joint_names=robot.joint_names,
    )
    result = sdpid.identify(robot, whole, **SETTINGS)
    assert result.training.relative < 1e-3
    assert not np.any(result.problem.samples.effort[:, 1:])
    whole.to_csv(tmp_path / "run.csv")
    again = sdpid.identify(robot, tmp_path / "run.csv", **SETTINGS)
    np.testing.assert_allclose(again.estimate.base, result.estimate.base, rtol=1e-9, atol=1e-12)


def test_what_is_known_of_open_chains_only() -> None:
    robot = sdpid.load_robot(urdf("four_bar"))
    with pytest.raises(ModelError, match=r"has loops that close .pin.; this is known for open"):
        sdpid.design_excitation(robot, duration=5.0)
    alone = sdpid.load_robot(urdf("four_bar").split("<loop_joint")[0] + (
        '<passive_joint name="coupler_joint"/></robot>'
    ))  # fmt: skip
    log = sdpid.Recording(time=np.arange(9.0), position=np.zeros((9, 2)), effort=np.zeros((9, 2)))
    with pytest.raises(DataError, match="do not determine the positions of coupler_joint"):
        sdpid.identify(alone, log)


# Loops that are not in a plane, and loops of robots that hang, with MuJoCo as the judge.


CASES = (("ankle", False), ("ankle", True), ("leg", True))


@pytest.fixture(scope="module", params=CASES, ids=("fixed ankle", "hanging ankle", "hanging leg"))
def chained(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Run:
    name, floating = request.param
    path = tmp_path_factory.mktemp("chain") / f"{name}.xml"
    path.write_text(chain_mjcf(name, floating=floating))
    log = run_chain(name, floating=floating, seconds=2.0, seed=0)
    other = run_chain(name, floating=floating, seconds=1.5, seed=1)
    return sdpid.identify(path, log, validation=other, **SETTINGS), log, path


def test_motors_alone_identify_a_chain(chained: Run) -> None:
    result, log, _ = chained
    gap = result.certificate.gap
    assert result.certificate.passed
    assert gap < 1e-6
    # Torques have noise of a thousandth.
    assert result.validation.moving.relative < 3e-3
    held_out = result.held_out
    described = held_out.baselines["description as it is"]
    assert described.moving.relative > 10.0 * result.validation.moving.relative
    floating = result.validation.floating
    assert (floating is None) == (log.base is None)
    if floating is not None:
        assert floating.force < 1e-3
        assert floating.torque < 1e-3
    # Of joints without motors there is nothing to say.
    assert not any("wrong sign" in words or "unit or scale" in words for words in result.verdict)
    assert "at rest" not in result.headline.error
    assert not any(finding.kind == "joint_at_rest" for finding in result.findings)


def test_a_chain_is_proven_from_the_log(chained: Run, tmp_path: Path) -> None:
    result, log, path = chained
    result.save(tmp_path / "run_chain", figures=False)
    found = sdpid.verify(tmp_path / "run_chain", data=log, robot=sdpid.load_robot(path))
    assert found.passed, found.problems
    assert {"robot", "contacts", "weights", "rows"} <= found.log.complete


def test_an_mjcf_of_a_chain_closes(chained: Run, tmp_path: Path) -> None:
    result, log, path = chained
    sdpid.write_mjcf(result.estimate, target=tmp_path / "out.xml")
    described, again = sdpid.load_robot(path), sdpid.load_robot(tmp_path / "out.xml")
    assert len(again.loops) == len(described.loops)
    position = np.zeros((1, described.n - described.n_base))
    for at, name in enumerate(log.names):
        position[0, described.joint_names[described.n_base :].index(name)] = log.position[-1, at]
    closed = close_loops(described, position, described.passive)
    if described.free_flyer:
        closed = np.hstack([[[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]], closed])
    for loop in again.loops:
        assert frame_gaps(again, closed, [loop.frame], [loop.against]) < 1e-9
