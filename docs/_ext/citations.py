"""Resolve citation keys, `[gautier1990, bell2002]` in pages and `[gautier1990]_` in docstrings."""

import re
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment

PAGE = "reference/references"
_ENTRY = re.compile(r"\*\*\[(\w+)\]\*\*")
# Code, formulas and comments are left as they are.
_VERBATIM = re.compile(
    r"(^(`{3,}|:{3,}\{code).*?^\2[`:]*\s*?$|`[^`\n]*`|\$[^$]+\$|<!--.*?-->)", re.M | re.S
)
_CITED = re.compile(r"(?<![\w\]\[!*])\[(\w+(?:,\s\w+)*)\](?![\[(:{])")


def keys(docs: Path) -> set[str]:
    """Return the keys of the page of references."""
    return set(_ENTRY.findall((docs / f"{PAGE}.md").read_text(encoding="utf-8")))


def link_citations(app: Sphinx, name: str, source: list[str]) -> None:
    """Make entries targets and citations links."""
    if name == PAGE:
        source[0] = _ENTRY.sub(r"[]{#ref-\1}**[\1]**", source[0])
        return
    known = keys(Path(app.srcdir))
    up = "../" * name.count("/")

    def link(found: re.Match[str]) -> str:
        cited = re.split(r",\s", found[1])
        if not known.issuperset(cited):
            return found[0]
        links = [f"[{key}]({up}{PAGE}.md#ref-{key})" for key in cited]
        return f"\\[{', '.join(links)}\\]"

    pieces = _VERBATIM.split(source[0])
    # The pattern has two groups: text, verbatim, fence, text, ...
    text = [_CITED.sub(link, piece) for piece in pieces[::3]]
    verbatim = [*pieces[1::3], ""]
    source[0] = "".join(a + b for a, b in zip(text, verbatim, strict=True))


def resolve(
    app: Sphinx, env: BuildEnvironment, node: Any, content: nodes.Node
) -> nodes.reference | None:
    """Resolve a docstring's citation."""
    if node.get("refdomain") != "citation" or node["reftarget"] not in keys(Path(app.srcdir)):
        return None
    page = app.builder.get_relative_uri(node["refdoc"], PAGE)
    key = node["reftarget"]
    return nodes.reference("", f"[{key}]", refuri=f"{page}#ref-{key}", internal=True)


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect the extension."""
    app.connect("source-read", link_citations)
    app.connect("missing-reference", resolve)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
