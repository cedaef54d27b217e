"""Commands in the documentation have options that exist, also where no test runs them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import typer

from sdpid import cli

ROOT = Path(__file__).resolve().parents[2]
# Within a code block or between backticks; to the end of the line, lines that go on included.
_COMMAND = re.compile(r"(?:^|`|\$ )sdpid ([a-z][a-z-]*)\b((?:\\\n|[^\n`#|&;])*)", flags=re.M)
_OPTION = re.compile(r"(?<=\s)(--[a-z][a-z-]*|-[a-z])(?=[\s=`]|$)")


def commands(text: str) -> Iterator[tuple[str, list[str]]]:
    """Yield each command of a page, with its options."""
    for found in _COMMAND.finditer(text):
        yield found[1], _OPTION.findall(found[2])


def test_commands_are_found() -> None:
    text = "`sdpid audit a.urdf --repair b`\n$ sdpid identify --config \\\n  run.toml -v # --no\n"
    assert list(commands(text)) == [("audit", ["--repair"]), ("identify", ["--config", "-v"])]


def test_options_exist() -> None:
    known = {
        name: {each for option in command.params for each in (*option.opts, *option.secondary_opts)}
        for name, command in vars(typer.main.get_command(cli.app))["commands"].items()
    }
    wrong, count = [], 0
    for page in (ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))):
        text = page.read_text(encoding="utf-8")
        for name, options in commands(text):
            count += name in known
            unknown = [name] if name not in known else [o for o in options if o not in known[name]]
            if unknown:
                wrong.append((str(page.relative_to(ROOT)), name, unknown))
    assert not wrong
    assert count > 50
