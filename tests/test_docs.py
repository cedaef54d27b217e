"""The code in the documentation runs."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import sdpid
from sdpid.robot.friction import FrictionModel
from sdpid.robot.friction_terms import BY_NAME

DOCS = Path(__file__).resolve().parent.parent / "docs"


def code_of(page: str) -> str:
    text = (DOCS / page).read_text(encoding="utf-8")
    return "\n".join(re.findall(r"^```python\n(.*?)^```", text, flags=re.M | re.S))


def test_a_term_of_your_own(monkeypatch: pytest.MonkeyPatch) -> None:
    # Dataclasses look up the module that they are defined in.
    module = ModuleType("terms_of_the_docs")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    names = module.__dict__
    exec(compile(code_of("terms.md"), "docs/terms.md", "exec"), names)
    robot = sdpid.load_robot("denso_vp6242")
    model = FrictionModel.from_terms(names["friction"], robot.joint_names)
    v = np.array([[0.25, -0.25, 0.0, 1.0, -1.0, 4.0]])
    columns = model.columns(v, np.zeros_like(v))[0]
    assert [p.name for p in model.parameters][-6:] == [f"Fr{j}" for j in range(1, 7)]
    assert np.allclose(np.diag(columns[:, -6:]), [0.5, -0.5, 0.0, 1.0, -1.0, 2.0])


def test_the_friction_page(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("friction_of_the_docs")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    names = module.__dict__
    exec(compile(code_of("friction.md"), "docs/friction.md", "exec"), names)
    robot = sdpid.load_robot("denso_vp6242")
    v = np.array([[0.25, -0.25, 0.0, 1.0, -1.0, 4.0]])
    drag = FrictionModel.from_terms((names["Drag"](),), robot.joint_names)
    assert np.allclose(np.diag(drag.columns(v, v)[0]), v * np.abs(v))
    bend = FrictionModel.from_terms((names["Bend"](velocity=0.5),), robot.joint_names)
    assert np.allclose(np.diag(bend.columns(v, v)[0]), v / (np.abs(v) + 0.5))
    # Every named term stands in the table, with its parameters' symbol.
    page = (DOCS / "friction.md").read_text(encoding="utf-8")
    for name in BY_NAME:
        assert f'| `"{name}"' in page
        symbols = {p.name.rstrip("1") for p in BY_NAME[name]().parameters(("joint",))}
        assert all(symbol in page for symbol in symbols)


def test_every_page_that_is_linked_exists() -> None:
    for page in (*DOCS.glob("*.md"), DOCS.parent / "README.md"):
        for target in re.findall(r"\]\((?!https?:|#)([^)#]+)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


def test_citations_resolve() -> None:
    known = set(re.findall(r"\*\*\[(\w+)\]\*\*", (DOCS / "references.md").read_text("utf-8")))
    package = DOCS.parent / "sdpid"
    for source in package.rglob("*.py"):
        for key in re.findall(r"\[(\w+)\]_", source.read_text(encoding="utf-8")):
            assert key in known, f"{source.relative_to(package)} cites [{key}]"
