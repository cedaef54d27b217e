"""Show kinds of findings about a log: how serious each is, when it is found, and what to do.

A line of the directive names a kind and says when it is found; severity and remedy are those of
`sdpid.experiment.inspection`. A remedy that depends on the log stands behind a bar::

    ```{findings}
    effort_spike: a single wrong value
    time_unit: a rate below 2 Hz or above 25 kHz | say the unit: `--unit time=ms`
    ```
"""

import re
from collections.abc import Iterable, Iterator
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from sdpid.experiment.inspection.inspect import KINDS

_LINE = re.compile(r"(\w+): ([^|]*?)(?: \| (.*))?$")
# Lists, tables and options, whose quotes and hyphens must stay.
_CODE = re.compile(r"(\w+ ?= ?[\[{][^\]}]*[\]}]|--[\w-]+(?: \w+_\w+)?)")
_FIELD = re.compile(r"\{(\w+)[^{}]*\}")


def rows(content: Iterable[str]) -> Iterator[str]:
    """Yield the lines as a table in Markdown."""
    yield "| kind | severity | found when | what to do |"
    yield "|---|---|---|---|"
    for line in content:
        found = _LINE.match(line)
        if found is None or found[1] not in KINDS:
            raise ValueError(f"no kind of finding: {line}")
        kind, when, own = found.groups()
        remedy = own or _literal(remedy_of(kind))
        yield f"| `{kind}` | {KINDS[kind].severity} | {when} | {remedy} |"


def remedy_of(kind: str) -> str:
    """Return what a finding says to do, an ellipsis for what is filled in."""
    text = _FIELD.sub(lambda field: kind if field[1] == "kind" else "…", KINDS[kind].remedy)
    return text.replace("{{", "{").replace("}}", "}")


def _literal(text: str) -> str:
    """Return a text that stands in Markdown as it is, code in it as code."""
    pieces = _CODE.split(text)
    pieces[::2] = [re.sub(r"([|*_<>\[\]$`\\])", r"\\\1", piece) for piece in pieces[::2]]
    pieces[1::2] = [f"`{piece}`" for piece in pieces[1::2]]
    return "".join(pieces)


class Findings(SphinxDirective):
    """Show kinds of findings."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        return self.parse_text_to_nodes("\n".join(rows(self.content)))


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("findings", Findings)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
