"""The code in the documentation runs."""

import ast
import re
import runpy
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import typer

import sdpid
from sdpid import cli
from sdpid._common.files import load_toml
from sdpid.experiment.inspection import inspect as inspection
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.terms import BY_NAME
from tests.helpers.arm import arm_problem

BLOCK = r"^```python\n(.*?)^```"
ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
EVIDENCE = DOCS / "evidence"
RECIPE = ROOT / ".conda" / "recipe.yaml"


def blocks_of(page: str) -> list[str]:
    """Return the blocks of Python of a page."""
    text = (DOCS / page).read_text(encoding="utf-8")
    return re.findall(BLOCK, text, flags=re.M | re.S)


def code_of(page: str) -> str:
    return "\n".join(blocks_of(page))


def of_your_own(page: str, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Return what the last block of a page defines; the others speak of a robot of the reader's."""
    module = ModuleType("of_the_docs")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    names = module.__dict__
    names["sdpid"] = sdpid
    exec(compile(blocks_of(page)[-1], page, "exec"), names)
    return names


def test_terms_of_your_own(monkeypatch: pytest.MonkeyPatch) -> None:
    names = of_your_own("guides/friction.md", monkeypatch)
    robot = sdpid.load_robot("denso_vp6242")
    v = np.array([[0.25, -0.25, 0.0, 1.0, -1.0, 4.0]])
    for term, expected in (
        (names["Drag"](), v * np.abs(v)),
        (names["Bend"](velocity=0.5), v / (np.abs(v) + 0.5)),
    ):
        model = FrictionModel.from_terms((term,), robot.joint_names)
        assert np.allclose(np.diag(model.columns(v, v)[0]), expected)
    # Every named term stands in the table, with its parameters' symbol.
    page = (DOCS / "guides" / "friction.md").read_text(encoding="utf-8")
    for name in BY_NAME:
        assert f'| `"{name}"' in page
        symbols = {p.name.rstrip("1") for p in BY_NAME[name]().parameters(("joint",))}
        assert all(symbol in page for symbol in symbols)


def test_a_condition_of_your_own(monkeypatch: pytest.MonkeyPatch) -> None:
    names = of_your_own("guides/constraints.md", monkeypatch)
    problem = arm_problem(names["LighterTowardsTheTip"]())
    theta = sdpid.solve_sdp(problem).theta
    masses = theta[: 10 * problem.robot.n_links : 10]
    assert np.all(np.diff(masses) <= 1e-8)


def test_every_page_that_the_front_page_links_exists() -> None:
    # Links of the other pages are checked when the site is built.
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    targets = re.findall(r"\]\((?!https?:|#)([^)#]+)", readme)
    assert [target for target in targets if not (ROOT / target).exists()] == []


def test_every_guide_has_a_small_picture_and_its_command() -> None:
    script = (DOCS / "pictures.py").read_text(encoding="utf-8")
    for page in sorted((DOCS / "guides").glob("*.md")):
        if page.stem in ("limits", "robots", "report"):  # Tables alone; a picture of a report.
            continue
        assert f"`python docs/pictures.py {page.stem}`" in page.read_text(encoding="utf-8")
        assert f"def {page.stem}() -> Any:" in script
        assert (DOCS / "images" / "guides" / f"{page.stem}.png").stat().st_size < 60_000


def test_citations_resolve() -> None:
    references = (DOCS / "reference" / "references.md").read_text("utf-8")
    known = set(re.findall(r"\*\*\[(\w+)\]\*\*", references))
    for source in (ROOT / "sdpid").rglob("*.py"):
        cited = set(re.findall(r"\[(\w+)\]_", source.read_text(encoding="utf-8")))
        assert cited <= known, source


# Measured numbers stand in tables that a command makes, and pages take them from there.


@pytest.fixture(autouse=True)
def evidence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EVIDENCE))


def test_pages_have_no_measured_number_of_their_own() -> None:
    from prose import unregistered

    found = unregistered(ROOT)
    listed = "\n".join(map(str, found))
    assert not found, (
        f"{listed}\nTake a measured number from a table of docs/evidence ({{measured}} or a link), "
        "or list a definition (default, limit, option) in docs/evidence/definitions.toml."
    )


def test_the_readme_says_what_the_tables_say() -> None:
    from prose import filled, readme_numbers
    from studies import load_studies

    studies = load_studies()
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").replace("*", "").split())
    for entry in readme_numbers():
        assert filled(entry, studies) in readme, "readme.toml and README.md say different things"
        assert entry["page"] in readme, f"README.md has no link to {entry['page']}"
        page = (ROOT / entry["page"]).read_text(encoding="utf-8")
        for value in entry["values"]:
            assert f"```{{evidence}} {value.split()[0]}\n" in page


def test_what_counts_as_a_measured_number() -> None:
    from prose import numbers

    text = "\n".join(
        (
            "---\ntitle: 5 %\n---\n# It takes 3 s\n",
            "from 0.04 to 0.26 s, `7 %`, $9 %$, 2.4e-8, 12\n%, 1.5 rad/s.",
            "| 4 % |\n\n```text\n8 %\n```\n:::{note}\nsome 6.5 times\n:::",
            "[1 %](x_2%.md) {measured}`a/b c .1%`",
        )
    )
    assert [number for _, number in numbers(text)] == [
        "3 s", "0.04 to 0.26 s", "2.4e-8", "12 %", "6.5 times", "1 %"
    ]  # fmt: skip
    assert [line for line, _ in numbers(text)] == [4, 6, 6, 6, 14, 16]


def test_every_page_of_evidence_shows_its_tables() -> None:
    from studies import load_studies

    studies = load_studies()
    shown = {
        reference
        for page in {*EVIDENCE.glob("*.md"), *(EVIDENCE / each.page for each in studies.values())}
        for reference in re.findall(r"^```\{evidence\} (\S+)", page.read_text("utf-8"), flags=re.M)
    }
    assert shown == {f"{s}/{t}" for s, study in studies.items() for t in study.tables}
    for study in studies.values():
        page = (EVIDENCE / study.page).read_text(encoding="utf-8")
        assert f"{{evidence}} {study.name}/" in page


# What else says the version and the requirements says those of the package.


def test_every_file_has_the_version_of_the_package() -> None:
    version, changes = sdpid.__version__, (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    first = re.search(r"^## \[(.*?)\] - (unreleased|\d{4}-\d\d-\d\d)$", changes, flags=re.M)
    assert first is not None
    assert first[1] == version
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f'\n  version: "{version}"\n' in RECIPE.read_text(encoding="utf-8")


def test_the_recipe_of_conda_asks_for_what_the_package_does() -> None:
    yaml = pytest.importorskip("yaml")
    project = load_toml(ROOT / "pyproject.toml")["project"]
    needs = [line.partition(";")[0].replace(">=", " >=") for line in project["dependencies"]]
    python, *others = yaml.safe_load(RECIPE.read_text(encoding="utf-8"))["requirements"]["run"]
    assert python == "python >=${{ python_min }}"
    # Pinocchio has another name there.
    assert others == [line.replace("pin ", "pinocchio ") for line in needs]


def test_tests_that_scripts_name_exist() -> None:
    named = re.compile(r"\btests/[\w/]+(?:\.py)?")
    scripts = [ROOT / ".ci" / name for name in ("run", "nightly", "lowest", "package")]
    paths = {path for script in scripts for path in named.findall(script.read_text("utf-8"))}
    assert paths
    assert [path for path in sorted(paths) if not (ROOT / path).exists()] == []


# Options that pages name exist, and those of a command that is written out are its own.


# Within a code block or between backticks; to the end of the line, lines that go on included.
_COMMAND = re.compile(r"(?:^|`|[$!] ?)sdpid ([a-z][a-z-]*)\b((?:\\\n|[^\n`#|&;])*)", flags=re.M)
_OWN = re.compile(r"(?<=\s)(--[a-z][a-z-]*|-[a-z])(?=[\s=`]|$)")
# Code within a line, and an option in it.
_CODE = re.compile(r"(?<!`)`([^`\n]+)`(?!`)")
_OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*")
# Of scripts, studies and other tools.
_OTHERS = re.compile(r"python|pip|git|pytest|make|sphinx|ruff")


def commands(text: str) -> Iterator[tuple[str, set[str]]]:
    """Yield each command of a page, with its options."""
    for found in _COMMAND.finditer(text):
        yield found[1], set(_OWN.findall(found[2]))


def known() -> dict[str, set[str]]:
    """Return the options of each command; those of none under an empty name."""
    group = typer.main.get_command(cli.app)
    every = {"": group, **group.commands}  # type: ignore[attr-defined]
    return {
        name: {"--help"}.union(*((*each.opts, *each.secondary_opts) for each in command.params))
        for name, command in every.items()
    }


def test_commands_have_their_options() -> None:
    options, count = known(), 0
    for page in (ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))):
        for name, own in commands(page.read_text(encoding="utf-8")):
            assert name in options, f"{page.name} names sdpid {name}"
            assert own <= options[name], f"{page.name}: sdpid {name} {own - options[name]}"
            count += 1
    assert count > 50


@pytest.mark.parametrize("folder", ["guides", "tutorials", "."])
def test_options_of_the_pages(folder: str) -> None:
    options = set().union(*known().values())
    for page in sorted((ROOT / "docs" / folder).glob("*.md")):
        if page.name == "contributing.md":
            continue
        for found in _CODE.finditer(page.read_text(encoding="utf-8")):
            if _OTHERS.search(found[1]):
                continue
            for option in _OPTION.findall(found[1]):
                assert option in options, f"{page.name} names {option}: {found[1]}"


# The notebooks are the tutorials.


def test_notebooks_are_those_of_the_pages() -> None:
    pytest.importorskip("jupytext")
    command = [sys.executable, str(DOCS / "notebooks.py"), "--check"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_page_that_was_not_run_says_so_below_its_title() -> None:
    marked = runpy.run_path(str(DOCS / "_ext" / "tutorials.py"))["marked"]
    lines = marked("---\na: b\n---\n\n# Title\n\ntext\n\n# not a title\n", "why.").splitlines()
    assert lines[4:7] == ["# Title", "", ":::{note}"]
    assert sum("why." in line for line in lines) == 1


# Messages on the page of troubleshooting, and kinds of findings on the page of inspection, are
# those of the package.


_WORDS = re.compile(r"`([^`]+)`")


@cache
def texts() -> tuple[str, ...]:
    """Return every text in the package, a placeholder for what is filled in."""
    trees = (ast.parse(path.read_text("utf-8")) for path in (ROOT / "sdpid").rglob("*.py"))
    return tuple(filter(None, (text(node) for tree in trees for node in ast.walk(tree))))


def text(node: ast.AST) -> str:
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(text(part) or "\0" for part in node.values)
    return ""


def first_cells(page: str, header: str) -> Iterator[str]:
    """Yield the code in the first column of each table of a page that begins with this heading."""
    inside = False
    for line in (ROOT / "docs" / page).read_text("utf-8").splitlines():
        cell = line.strip().strip("|").split("|")[0].strip() if line.startswith("|") else ""
        inside = bool(cell) and (inside or cell == header)
        if inside:
            yield from _WORDS.findall(cell)


def test_every_message_is_one_of_the_package() -> None:
    messages = list(first_cells("troubleshooting.md", "message"))
    assert len(messages) > 50

    def is_said(message: str) -> bool:
        parts = [part for part in message.split("…") if len(part) > 2]
        return any(all(part in words for part in parts) for words in texts())

    assert [message for message in messages if not is_said(message)] == []


def test_every_kind_of_finding_is_named() -> None:
    page = (ROOT / "docs" / "guides" / "inspection.md").read_text("utf-8")
    tables = re.findall(r"^```\{findings\}\n(.*?)^```", page, flags=re.M | re.S)
    rows = [line.partition(":") for table in tables for line in table.splitlines()]
    assert {kind for kind, _, _ in rows} == set(inspection.KINDS)
    # What to do stands in the finding, or here.
    without = {kind for kind, row in inspection.KINDS.items() if row.remedy in ("", "{remedy}")}
    assert all(" | " in row for kind, _, row in rows if kind in without)
