"""Tables and numbers of the evidence in pages: a directive and a role.

A directive shows a kept table with the command and the date that made it::

    ```{evidence} truth/logs
    :caption: Error of the friction curve
    :columns: arm=Arm, error=Error in %
    :rows: arm=UR10
    :formats: error=.2f
    ```

The role ``{measured}`truth/logs arm=UR10 error .2f` `` shows one number of a table. Lists are
separated by commas, or by semicolons where one is in them. Without ``:columns:`` all are shown,
and a column without a title has its name as one: ``held_out_percent`` is *Held out, %*. What does
not exist, or is not the only one, is a warning, which ends the build.
"""

from __future__ import annotations

import functools
import os
import sys
from pathlib import Path
from typing import Any, ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective, SphinxRole

sys.path.append(str(Path(__file__).resolve().parent.parent / "evidence"))

from studies import EvidenceError, Study, Table, find_table, load_studies, measured, shown

FOLDED = 20
UNITS = {
    "percent": "%", "kg": "kg", "mm": "mm", "s": "s", "ms": "ms", "nm": "N·m", "n": "N", "hz": "Hz"
}  # fmt: skip
SPELLED = {"4x4": "4×4", "6x6": "6×6"} | {
    word.lower(): word for word in ("CPU", "CWLS", "MJCF", "SDP", "URDF", "WLS")
}
logger = logging.getLogger(__name__)


class Evidence(SphinxDirective):
    """Show a kept table."""

    required_arguments = 1
    option_spec: ClassVar[Any] = {
        "caption": directives.unchanged,
        "columns": directives.unchanged,
        "rows": directives.unchanged,
        "formats": directives.unchanged,
    }

    def run(self) -> list[nodes.Node]:
        """Return the table, and below it where it comes from."""
        studies = _studies(self.env)
        try:
            table = find_table(studies, self.arguments[0])
            header, rows = self.content_of(table)
        except (EvidenceError, ValueError) as error:
            logger.warning("evidence: %s", error, location=self.get_location())
            return []
        self.env.note_dependency(os.fspath(table.path))
        box = nodes.container(classes=["evidence", *(["long"] * (len(rows) > FOLDED))])
        box += _table(header, rows, self.options.get("caption", ""))
        box += _source(studies[table.study], table)
        return [box]

    def content_of(self, table: Table) -> tuple[list[str], list[list[str]]]:
        """Return header and cells as they are shown."""
        grid = table.read()
        titles = _pairs(self.options.get("columns", "")) or dict.fromkeys(grid.header, "")
        formats = _pairs(self.options.get("formats", ""))
        for name in formats:
            grid.column(name)
        columns = {grid.column(name): title or titled(name) for name, title in titles.items()}
        rows = grid.where(_pairs(self.options.get("rows", "")))
        if not rows:
            raise EvidenceError(f"{self.arguments[0]}: no rows.")
        specs = [formats.get(grid.header[column], "") for column in columns]
        cells = [
            [shown(row[c], spec if row[c] else "") for c, spec in zip(columns, specs, strict=True)]
            for row in rows
        ]
        return list(columns.values()), cells


class Studies(SphinxDirective):
    """List every study: its question, page, command, duration, and when its tables were made."""

    def run(self) -> list[nodes.Node]:
        """Return the list as a table."""
        rows = []
        for study in _studies(self.env).values():
            dates = sorted({table.date for table in study.tables.values()})
            anew = all(table.made == "by the command" for table in study.tables.values())
            minutes = "" if study.minutes is None else f"{study.minutes:g}"
            made = " to ".join(dict.fromkeys((dates[0], dates[-1])))
            words = study.title + (f" ({study.note})" if study.note else "")
            command = f"`{study.shown_command()}`"
            rows.append([study.name, words, command, minutes, made if anew else f"{made}, page"])
        header = ["Study", "What it asks", "Command", "Minutes", "Made"]
        return [_table(header, rows, "")]


class Measured(SphinxRole):
    """Show one number of a kept table."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        """Return the number, its reference as a title."""
        try:
            studies = _studies(self.env)
            text = measured(studies, self.text)
            table = find_table(studies, self.text.split()[0])
        except (EvidenceError, ValueError) as error:
            logger.warning("measured: %s", error, location=self.get_location())
            return [nodes.problematic("", self.text)], []
        self.env.note_dependency(os.fspath(table.path))
        return [nodes.inline("", text, classes=["measured"])], []


def _table(header: list[str], rows: list[list[str]], caption: str) -> nodes.table:
    """Return a table, columns of numbers on the right."""
    table = nodes.table(classes=["evidence-table"])
    if caption:
        table += nodes.title("", "", *_inline(caption))
    group = nodes.tgroup(cols=len(header))
    right = [all(_numeric(row[k]) for row in rows) for k in range(len(header))]
    group += [nodes.colspec(colwidth=1) for _ in header]
    group += nodes.thead("", _row(header, right))
    group += nodes.tbody("", *(_row(row, right) for row in rows))
    table += group
    return table


def _row(cells: list[str], right: list[bool]) -> nodes.row:
    row = nodes.row()
    for cell, to_right in zip(cells, right, strict=True):
        entry = nodes.entry("", nodes.paragraph("", "", *_inline(cell)))
        entry["classes"] = ["text-right"] if to_right else []
        row += entry
    return row


def _inline(text: str) -> list[nodes.Node]:
    """Return a text with what stands between backticks as code."""
    parts = enumerate(text.split("`"))
    return [nodes.literal("", part) if n % 2 else nodes.Text(part) for n, part in parts if part]


def _source(study: Study, table: Table) -> nodes.paragraph:
    """Return the line with command, date, commit and machine."""
    when = [table.date, f"commit {table.commit}" if table.commit else "", table.machine]
    made = "" if table.made == "by the command" else f"; {table.made}, not made anew since"
    line = nodes.paragraph(classes=["evidence-source"])
    line += nodes.literal("", study.shown_command())
    line += nodes.Text(f" ({', '.join(filter(None, when))}{made})")
    return line


def _numeric(cell: str) -> bool:
    """Return whether a cell is a number, or a number with a sign of percent, or nothing."""
    text = cell.replace("−", "-").removesuffix(" %")
    try:
        float(text or "0")
    except ValueError:
        return text in {"–", "-"}
    return True


def titled(name: str) -> str:
    """Return the name of a column as a title, a unit at its end behind a comma."""
    words = [SPELLED.get(word, word) for word in name.split("_")]
    if len(words) > 1 and words[-1] in UNITS:
        words[-2:] = [f"{words[-2]}, {UNITS[words[-1]]}"]
    title = " ".join(words)
    return title[:1].upper() + title[1:]


def _pairs(text: str) -> dict[str, str]:
    """Return ``a=A, b=B`` as a dictionary; a name alone has an empty title."""
    parts = text.split(";" if ";" in text else ",")
    pairs = (part.strip().partition("=") for part in parts if part.strip())
    return {name.strip(): title.strip() for name, _, title in pairs}


def _studies(env: Any) -> dict[str, Study]:
    """Return the studies; every page that asks depends on their file."""
    folder = Path(env.srcdir) / "evidence"
    env.note_dependency(os.fspath(folder / "studies.toml"))
    return _loaded(folder, (folder / "studies.toml").stat().st_mtime_ns)


@functools.lru_cache(maxsize=2)
def _loaded(folder: Path, _changed: int) -> dict[str, Study]:
    return load_studies(folder)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register directive and role."""
    app.add_directive("evidence", Evidence)
    app.add_directive("studies", Studies)
    app.add_role("measured", Measured())
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
