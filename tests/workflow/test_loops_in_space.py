"""Loops that are not in a plane, and loops of robots that hang, with MuJoCo as the judge."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid.robot.model.contacts.closure import close_loops
from sdpid.robot.model.contacts.jacobians import frame_gaps
from sdpid.workflow.result import Identification
from tests.helpers.closed_chains import mjcf, run

pytest.importorskip("mujoco")

# Friction is none in the plant; the prior is that of the description, which is 15 % off.
SETTINGS: dict[str, Any] = {"friction": (), "effects": "none", "intervals": False}
CASES = (("ankle", False), ("ankle", True), ("leg", True))


@pytest.fixture(scope="module", params=CASES, ids=("fixed ankle", "hanging ankle", "hanging leg"))
def identified(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Identification, sdpid.Recording, Path]:
    name, floating = request.param
    path = tmp_path_factory.mktemp("chain") / f"{name}.xml"
    path.write_text(mjcf(name, floating=floating))
    log = run(name, floating=floating, seconds=2.0, seed=0)
    other = run(name, floating=floating, seconds=1.5, seed=1)
    return sdpid.identify(path, log, validation=other, **SETTINGS), log, path


def test_motors_alone_identify_a_chain(
    identified: tuple[Identification, sdpid.Recording, Path],
) -> None:
    result, log, _ = identified
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


def test_a_chain_is_proven_from_the_log(
    identified: tuple[Identification, sdpid.Recording, Path], tmp_path: Path
) -> None:
    result, log, path = identified
    result.save(tmp_path / "run", figures=False)
    found = sdpid.verify(tmp_path / "run", data=log, robot=sdpid.load_robot(path))
    assert found.passed, found.problems
    assert {"robot", "contacts", "weights", "rows"} <= found.log.complete


def test_an_mjcf_of_the_result_closes(
    identified: tuple[Identification, sdpid.Recording, Path], tmp_path: Path
) -> None:
    result, log, path = identified
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
