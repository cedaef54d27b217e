"""Options that pages name exist, and those of a command that is written out are its own."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer

from sdpid import cli

ROOT = Path(__file__).resolve().parents[2]
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


def test_commands_are_found() -> None:
    text = "`sdpid audit a.urdf --repair b`\n$ sdpid identify --config \\\n  run.toml -v # --no\n"
    assert list(commands(text)) == [("audit", {"--repair"}), ("identify", {"--config", "-v"})]


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
