"""Every code block of the documentation runs, page by page, in a folder with a user's files."""

import re
import shlex
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.helpers import commands
from tests.helpers.world import write_world

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[2]
_BLOCK = re.compile(r"^( *)```(python|console|toml)\n(.*?)^\1```", flags=re.M | re.S)
_COMMAND = re.compile(r"^\$ (sdpid .*?(?<!\\))$", flags=re.M | re.S)

# Tutorials, which run when the site is built.
ELSEWHERE = re.compile(r"\A---\n.*?\bkernelspec\b", flags=re.S)


class Block(NamedTuple):
    """A block of code."""

    language: str
    text: str
    line: int


def blocks(page: Path) -> list[Block]:
    """Return the blocks of a page, in order."""
    text = page.read_text(encoding="utf-8")
    found = []
    for match in _BLOCK.finditer(text):
        indent = len(match[1])
        lines = "\n".join(line[indent:] for line in match[3].split("\n"))
        found.append(Block(match[2], lines, text.count("\n", 0, match.start()) + 1))
    return found


def pages() -> Iterator[str]:
    """Yield the pages that have code to run, as their paths in the repository."""
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))):
        name = page.relative_to(ROOT).as_posix()
        hidden = any(part.startswith("_") for part in page.relative_to(ROOT).parts)
        if hidden or ELSEWHERE.match(page.read_text(encoding="utf-8")):
            continue
        if any(each.language != "console" or "$ sdpid" in each.text for each in blocks(page)):
            yield name


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with an arm's description, logs of it, and a result."""
    folder = tmp_path_factory.mktemp("world")
    write_world(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        run("sdpid identify run.csv --robot arm.urdf --out results", refused=False)
    return folder


def run(command: str, *, refused: bool) -> None:
    """Run a line of a terminal and look at its exit status."""
    done = commands.run(*shlex.split(command.replace("\\\n", " "), comments=True)[1:])
    shown = f"{command}\n{done.output[-3000:]}"
    assert done.exception is None or isinstance(done.exception, SystemExit), shown
    assert (done.exit_code != 0) == refused, f"status {done.exit_code}: {shown}"


def run_console(text: str) -> None:
    """Run the commands of a block; one whose shown output is our error is refused."""
    for command in _COMMAND.finditer(text):
        output = text[command.end() :].lstrip("\n")
        run(command[1], refused=output.startswith("sdpid: "))


@pytest.mark.parametrize("page", list(pages()))
def test_code_of(page: str, world: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "world"
    shutil.copytree(world, folder)
    monkeypatch.chdir(folder)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    # As typed at a prompt; workers of a cluster get what is defined there by value.
    names: dict[str, Any] = {"__name__": "__main__"}
    exec("import sdpid", names)
    for block in blocks(ROOT / page):
        if block.language == "toml":
            tomllib.loads(block.text)
        elif block.language == "console":
            run_console(block.text)
        else:
            # Errors name the line of the page.
            code = "\n" * block.line + block.text
            exec(compile(code, str(ROOT / page), "exec"), names)
