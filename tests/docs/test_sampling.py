"""The code of the page on sampling runs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sdpid
from tests.helpers.identified import arm_theta, identified, moved

PAGE = Path(__file__).resolve().parents[2] / "docs" / "guides" / "sampling.md"
COUNT = 100


def test_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = identified(moved(arm_theta(), 1))
    names: dict[str, Any] = {
        "sdpid": sdpid, "result": result, **dict(zip("qva", np.ones((3, 2)), strict=True))
    }  # fmt: skip
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), flags=re.M | re.S)
    exec(compile("\n".join(blocks), "docs/guides/sampling.md", "exec"), names)
    worlds, theta = names["worlds"], names["samples"].theta
    # The world is MuJoCo's first body.
    assert np.allclose(worlds["body_mass"][:, 1:], theta[:, :20:10])
    assert worlds["dof_damping"].shape == (COUNT, 2)
    assert set(names["ranges"].bodies[0].mjlab()) >= {"alpha_range", "s12_range", "t3_range"}
