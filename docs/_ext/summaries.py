"""List the names of a page of the API, each with the first line of its docstring.

The directive names the page; classes that are no public names stand below the table::

    ```{summaries} robots
    ```
"""

import importlib
import inspect
import os
import re
from pathlib import Path
from typing import Any

from docstrings import OBJECTS
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

_PUBLIC = re.compile(r"sdpid(\.(constraints|controllers|errors|friction|plots))?\.\w+")


def lines(page: Path) -> list[str]:
    """Return a page's names as a table in Markdown, and the other classes in a line below it."""
    names = OBJECTS.findall(page.read_text(encoding="utf-8"))
    public = [name for name in names if _PUBLIC.fullmatch(name)]
    rows = [f"| {{py:obj}}`{name}` | {_summary(name)} |" for name in public]
    others = ", ".join(f"{{py:obj}}`~{name}`" for name in names if name not in public)
    below = ["", f"Beside them: {others}."] if others else []
    return ["| name | what it does |", "|---|---|", *rows, *below]


def _summary(name: str) -> str:
    """Return the first line of a docstring as it stands in a table in Markdown."""
    module, _, attribute = name.rpartition(".")
    found = getattr(importlib.import_module(module), attribute)
    first = (inspect.getdoc(found) or "").split("\n")[0]
    return re.sub(r"\s*\[\w+\]_", "", first).replace("``", "`").replace("|", r"\|")


class Summaries(SphinxDirective):
    """Show the names of a page and what they do."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        page = Path(self.env.srcdir) / "reference" / "api" / f"{self.arguments[0]}.md"
        self.env.note_dependency(os.fspath(page))
        return self.parse_text_to_nodes("\n".join(lines(page)))


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("summaries", Summaries)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
