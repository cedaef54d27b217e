"""The code of the page on exports runs, in a folder with a user's files."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sdpid
from tests.helpers.data import FRICTION, make_samples, random_theta

PAGE = Path(__file__).resolve().parents[2] / "docs" / "guides" / "exports.md"

_LINK = """<link name="{0}"><inertial><origin xyz="0 0 0.1"/><mass value="2"/>
  <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.01"/></inertial></link>"""
_JOINT = """<joint name="j{0}" type="continuous"><parent link="l{1}"/><child link="l{0}"/>
  <origin xyz="0 0.1 0.2" rpy="{2} 0.3 0"/><axis xyz="0 0 1"/></joint>"""
ARM = (
    '<robot name="arm"><link name="l0"/><link name="tool0"/>'
    + "".join(_LINK.format(f"l{i}") for i in (1, 2, 3))
    + "".join(_JOINT.format(i, i - 1, 1.2 * i) for i in (1, 2, 3))
    + '<joint name="flange" type="fixed"><parent link="l3"/><child link="tool0"/>'
    '<origin xyz="0 0 0.1"/></joint></robot>'
)


def test_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mujoco")
    monkeypatch.chdir(tmp_path)
    Path("arm.urdf").write_text(ARM)
    robot = sdpid.load_robot("arm.urdf")
    rng = np.random.default_rng(0)
    theta = random_theta(robot, rng)
    bare = make_samples(robot, theta, rng, count=200, noise=0.02, block=5)
    loaded = theta.copy()
    loaded[20:30] += [0.5, 0.0, 0.0, 0.1, 0.03, 0.0, 0.03, 0.0, 0.0, 0.01]
    estimate = sdpid.solve_sdp(
        sdpid.build_problem(robot, bare, friction=FRICTION, weighting="residual")
    )
    sdpid.write_mjcf(estimate, target="mine.xml")
    names: dict[str, Any] = {
        "sdpid": sdpid,
        "estimate": estimate,
        **dict(zip("qva", rng.normal(size=(3, robot.n)), strict=True)),
        "without_load": bare,
        "with_load": make_samples(robot, loaded, rng, count=200, noise=0.02, block=5),
    }
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), flags=re.M | re.S)
    exec(compile("\n".join(blocks), "docs/guides/exports.md", "exec"), names)
    state = names["q"], names["v"], names["a"]
    np.testing.assert_allclose(names["tau"], names["model"].inverse_dynamics(*state))
    assert names["theta"] == estimate.named_theta()
    assert names["payload"].mass == pytest.approx(0.5, abs=0.05)
    for file in ("identified.urdf", "identified.xml", "mine.xml", "parameters.json"):
        assert Path(file).is_file()
