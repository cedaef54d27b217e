"""The code in the documentation runs."""

import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import sdpid
from sdpid.robot.friction.model import BY_NAME, FrictionModel
from tests.helpers.arm import arm_problem

BLOCK = r"^```python\n(.*?)^```"
DOCS = Path(__file__).resolve().parent.parent.parent / "docs"


def code_of(page: str) -> str:
    text = (DOCS / page).read_text(encoding="utf-8")
    return "\n".join(re.findall(BLOCK, text, flags=re.M | re.S))


def test_terms_of_your_own(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("friction_of_the_docs")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    names = module.__dict__
    names["sdpid"] = sdpid
    # The other blocks speak of a robot of the reader's.
    page = (DOCS / "guides" / "friction.md").read_text(encoding="utf-8")
    code = re.findall(BLOCK, page, flags=re.M | re.S)
    exec(compile(code[-1], "docs/guides/friction.md", "exec"), names)
    robot = sdpid.load_robot("denso_vp6242")
    v = np.array([[0.25, -0.25, 0.0, 1.0, -1.0, 4.0]])
    drag = FrictionModel.from_terms((names["Drag"](),), robot.joint_names)
    assert np.allclose(np.diag(drag.columns(v, v)[0]), v * np.abs(v))
    bend = FrictionModel.from_terms((names["Bend"](velocity=0.5),), robot.joint_names)
    assert np.allclose(np.diag(bend.columns(v, v)[0]), v / (np.abs(v) + 0.5))
    # Every named term stands in the table, with its parameters' symbol.
    for name in BY_NAME:
        assert f'| `"{name}"' in page
        symbols = {p.name.rstrip("1") for p in BY_NAME[name]().parameters(("joint",))}
        assert all(symbol in page for symbol in symbols)


def test_a_condition_of_your_own(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("condition_of_the_docs")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    names = module.__dict__
    # The other blocks speak of a robot of the reader's.
    text = (DOCS / "guides" / "constraints.md").read_text(encoding="utf-8")
    code = re.findall(BLOCK, text, flags=re.M | re.S)
    exec(compile(code[-1], "docs/guides/constraints.md", "exec"), names)
    problem = arm_problem(names["LighterTowardsTheTip"]())
    theta = sdpid.solve_sdp(problem).theta
    masses = theta[: 10 * problem.robot.n_links : 10]
    assert np.all(np.diff(masses) <= 1e-8)


def test_every_page_that_the_front_page_links_exists() -> None:
    # Links of the other pages are checked when the site is built.
    readme = DOCS.parent / "README.md"
    for target in re.findall(r"\]\((?!https?:|#)([^)#]+)", readme.read_text(encoding="utf-8")):
        assert (DOCS.parent / target).exists(), f"README.md links to {target}"


def test_citations_resolve() -> None:
    known = set(
        re.findall(r"\*\*\[(\w+)\]\*\*", (DOCS / "reference" / "references.md").read_text("utf-8"))
    )
    package = DOCS.parent / "sdpid"
    for source in package.rglob("*.py"):
        for key in re.findall(r"\[(\w+)\]_", source.read_text(encoding="utf-8")):
            assert key in known, f"{source.relative_to(package)} cites [{key}]"
