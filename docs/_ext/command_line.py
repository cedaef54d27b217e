"""Write the reference of the command line from the command itself."""

import re
from collections.abc import Iterator
from typing import Any

import typer.main
from sphinx.application import Sphinx

PAGE = "reference/command_line"
_MARK = "<!-- the commands -->"


def cell(text: str) -> str:
    """Return text that stands in a table as it is."""
    return re.sub(r"([|*_<>\[\]$])", r"\\\1", " ".join(text.split()))


def rows(given: Any, context: Any) -> dict[str, list[str]]:
    """Return the arguments and options of a command as rows of tables, by panel."""
    panels: dict[str, list[str]] = {}
    for each in given.get_params(context):
        record = each.get_help_record(context)
        if record is None:
            continue
        name = record[0].replace("|", r"\|")
        usual = "Argument" if each.param_type_name == "argument" else "Option"
        panel = getattr(each, "rich_help_panel", None) or usual
        panels.setdefault(panel, []).append(f"| `{name}` | {cell(record[1])} |")
    return panels


def command(name: str, given: Any, parent: Any) -> Iterator[str]:
    """Yield the section of a command."""
    context = given.make_context(name, [], parent=parent, resilient_parsing=True)
    yield f"## sdpid {name}\n"
    pieces = " ".join(given.collect_usage_pieces(context))
    yield f"```text\nsdpid {name} {pieces}\n```\n"
    yield (given.help or "").replace("\b", "") + "\n"
    for panel, lines in rows(given, context).items():
        yield f"| {panel} | |\n|---|---|"
        yield "\n".join(lines) + "\n"


def write(app: Sphinx, name: str, source: list[str]) -> None:
    """Put the commands where the page has its mark."""
    if name != PAGE:
        return
    from sdpid.cli import app as face

    group: Any = typer.main.get_command(face)
    context = group.make_context("sdpid", [], resilient_parsing=True)
    lines = [
        line
        for each in group.list_commands(context)
        for line in command(each, group.get_command(context, each), context)
    ]
    source[0] = source[0].replace(_MARK, "\n".join(lines))


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect the extension."""
    app.connect("source-read", write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
