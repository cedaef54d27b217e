"""Options that the pages name are options that a command has."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import typer.main

from sdpid import cli

ROOT = Path(__file__).resolve().parents[2]
# Code within a line, and lines of a terminal.
_CODE = re.compile(r"(?<!`)`([^`\n]+)`(?!`)|^[$!] ?(sdpid .*)$", flags=re.M)
_OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*")
# Of scripts, studies and other tools.
_OTHERS = re.compile(r"python|pip|git|pytest|make|sphinx|ruff")


def known() -> set[str]:
    """Return the options of all commands."""
    group = typer.main.get_command(cli.app)
    commands = [group, *group.commands.values()]  # type: ignore[attr-defined]
    return {
        name
        for command in commands
        for each in command.params
        for name in (*each.opts, *each.secondary_opts)
    } | {"--help"}


@pytest.mark.parametrize("folder", ["guides", "tutorials", "."])
def test_options_of_the_pages(folder: str) -> None:
    options = known()
    for page in sorted((ROOT / "docs" / folder).glob("*.md")):
        if page.name == "contributing.md":
            continue
        for found in _CODE.finditer(page.read_text(encoding="utf-8")):
            code = found[1] or found[2]
            if _OTHERS.search(code):
                continue
            for option in _OPTION.findall(code):
                assert option in options, f"{page.name} names {option}: {code}"
