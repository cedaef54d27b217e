"""Robots with loops, from a recording of their motors to a result that is proven.

Linkages in a plane, and chains that are not, some of which hang, with MuJoCo as the judge.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import sdpid
from sdpid._common.arrays import Array
from sdpid.errors import DataError, ModelError
from sdpid.robot.model.closure import close_loops
from sdpid.robot.model.jacobians import frame_gaps
from sdpid.workflow.result import Identification
from tests.helpers import closed_chains
from tests.helpers.linkages import mjcf, run, urdf
from tests.helpers.refusals import refuses

mujoco = pytest.importorskip("mujoco")

STARTS = {"four_bar": (1.0, 0.0, 0.0), "five_bar": (2.0, 0.0, 1.14, 0.0)}
CHAINS = {
    "fixed ankle": ("ankle", False),
    "hanging ankle": ("ankle", True),
    "hanging leg": ("leg", True),
}
# Friction is none in the plant; the prior is that of the description, which is 15 % off.
SETTINGS: dict[str, Any] = {"friction": (), "effects": "none", "intervals": False}


class Run(NamedTuple):
    """What was found of which log, the file of the robot, and joints where its loops close."""

    result: Identification
    log: sdpid.Recording
    path: Path
    start: Array


def linkage(name: str, folder: Path) -> Run:
    path = folder / f"{name}.urdf"
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
    result = sdpid.identify(path, log, validation=other, **SETTINGS)
    described = result.problem.base_of(result.problem.robot.prior.ravel())
    assert result.problem.cost(described) > 1e3 * result.problem.cost(result.estimate.base)
    assert any("are those that close the loops" in note for note in result.problem.samples.notes)
    return Run(result, log, path, start[None])


def chain(name: str, folder: Path) -> Run:
    kind, floating = CHAINS[name]
    path = folder / f"{kind}.xml"
    path.write_text(closed_chains.mjcf(kind, floating=floating))
    log, other = (
        closed_chains.run(kind, floating=floating, seconds=seconds, seed=seed)
        for seed, seconds in enumerate((2.0, 1.5))
    )
    robot = sdpid.load_robot(path)
    position = np.zeros((1, robot.n - robot.n_base))
    for at, joint in enumerate(log.names):
        position[0, robot.joint_names[robot.n_base :].index(joint)] = log.position[-1, at]
    closed = close_loops(robot, position, robot.passive)
    if robot.free_flyer:
        closed = np.hstack([[[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]], closed])
    return Run(sdpid.identify(path, log, validation=other, **SETTINGS), log, path, closed)


@pytest.fixture(scope="module", params=[*STARTS, *CHAINS])
def identified(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Run:
    make = linkage if request.param in STARTS else chain
    return make(request.param, tmp_path_factory.mktemp("loop"))


def test_motors_alone_identify_a_loop(identified: Run) -> None:
    result, log, path, _ = identified
    fit = result.validation
    assert result.certificate.passed
    assert result.certificate.gap < 1e-6
    # Torques of chains have noise of a thousandth.
    assert fit.moving.relative < (5e-4 if path.suffix == ".urdf" else 3e-3)
    described = result.held_out.baselines["description as it is"]
    assert described.moving.relative > 10.0 * fit.moving.relative
    assert (fit.floating is None) == (log.base is None)
    if fit.floating is not None:
        assert max(fit.floating.force, fit.floating.torque) < 1e-3
    # Nothing was measured at joints without motors, and nothing is to be said of them.
    verdict = " ".join(result.verdict)
    for words in ("wrong sign", "unit or scale", "worse than a constant"):
        assert words not in verdict
    assert "at rest" not in result.headline.error
    assert not {"joint_at_rest", "effort_constant"} & {each.kind for each in result.findings}


def test_a_loop_is_proven_from_the_log(identified: Run, tmp_path: Path) -> None:
    result, log, path, _ = identified
    result.save(tmp_path / "run", figures=False)
    given = None if path.suffix == ".urdf" else sdpid.load_robot(path)
    whole = sdpid.verify(tmp_path / "run", data=log, robot=given)
    assert whole.passed, whole.problems
    assert {"robot", "contacts", "weights", "rows"} <= whole.log.complete
    assert whole.log.gap < 1e-6
    if given is None:
        # The same with the loop a little farther out is another robot.
        ends = path.read_text()
        for length in ("0.25", "0.22"):
            ends = ends.replace(f'xyz="{length} 0 0"/><axis', f'xyz="{length}1 0 0"/><axis')
        assert ends != path.read_text()
        other = sdpid.verify(tmp_path / "run", data=log, robot=sdpid.load_robot(ends))
        assert not other.passed


def test_an_mjcf_of_the_result_closes(identified: Run, tmp_path: Path) -> None:
    result, _, path, start = identified
    sdpid.write_mjcf(result.estimate, target=tmp_path / "out.xml")
    described, again = sdpid.load_robot(path), sdpid.load_robot(tmp_path / "out.xml")
    # A pin is two balls on its axis.
    count = sum(2 if loop.kind == "line" else 1 for loop in described.loops)
    assert len(again.loops) == count
    if path.suffix == ".urdf":
        assert mujoco.MjModel.from_xml_path(str(tmp_path / "out.xml")).neq == count
        assert {loop.kind for loop in again.loops} == {"point"}
    # Where the description's loop is closed, so is the file's.
    for loop in again.loops:
        assert frame_gaps(again, start, [loop.frame], [loop.against]) < 1e-9


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
    words = r"has loops that close .pin.; this is known for open"
    refuses(ModelError, words, sdpid.design_excitation, robot, duration=5.0)
    passive = '<passive_joint name="coupler_joint"/></robot>'
    alone = sdpid.load_robot(urdf("four_bar").split("<loop_joint")[0] + passive)
    log = sdpid.Recording(time=np.arange(9.0), position=np.zeros((9, 2)), effort=np.zeros((9, 2)))
    refuses(DataError, "do not determine the positions of coupler", sdpid.identify, alone, log)
