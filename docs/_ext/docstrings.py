"""Show docstrings: link names and guides, and leave out how classes are made that users never make.

In a docstring `name` in backquotes is a public name, one of the classes that come back, or else
code; ``docs/guides/logs.md`` is a link to that page.
"""

import functools
import re
from pathlib import Path
from typing import Any

from numpydoc.xref import DEFAULT_LINKS
from sphinx.application import Sphinx
from sphinx.config import Config

OBJECTS = re.compile(r"^\.\. auto(?:class|function|exception):: (\S+)$", re.M)
_NAME = re.compile(r"(?<![`:\w])`([\w.]+)`(?![`_])")
_PAGE = re.compile(r"\bdocs/([\w/]+)\.md\b")
# Classes are described with these; what others take is nobody's business.
_MADE_BY_USERS = re.compile(r"sdpid(\.(friction|constraints))?\.\w+$|.*\.(DhJoint|Plane|Box|Mesh)$")


@functools.cache
def objects(folder: Path) -> dict[str, str]:
    """Return the full names on the API pages by their last part, top-level names first."""
    pages = sorted((folder / "reference" / "api").glob("*.md"))
    found = [name for page in pages for name in OBJECTS.findall(page.read_text(encoding="utf-8"))]
    return {name.rpartition(".")[2]: name for name in sorted(found, key=len, reverse=True)}


def link_types(app: Sphinx, config: Config) -> None:
    """Let the types of parameters link to our classes."""
    config.numpydoc_xref_param_type = True
    config.numpydoc_xref_aliases = objects(Path(app.srcdir))
    config.numpydoc_xref_ignore = "all"
    # These lead to the documentation of Python and NumPy, which is not at hand offline.
    DEFAULT_LINKS.clear()


def link_names(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Make names in backquotes links or code, and pages links."""
    known = objects(Path(app.srcdir))

    def show(found: re.Match[str]) -> str:
        head, _, rest = found[1].removeprefix("sdpid.").partition(".")
        if found[1] in known.values():
            return f":py:obj:`{found[1]}`"
        if head in known:
            target = f"{known[head]}.{rest}" if rest else known[head]
            return f":py:obj:`{found[1]} <{target}>`"
        return f"``{found[1]}``"

    def page(found: re.Match[str]) -> str:
        there = (Path(app.srcdir) / f"{found[1]}.md").exists()
        return f":doc:`/{found[1]}`" if there else f"``{found[0]}``"

    code = False
    for number, line in enumerate(lines):
        code = line.lstrip().startswith((">>>", "...")) or (code and bool(line.strip()))
        if not code:
            lines[number] = _PAGE.sub(page, _NAME.sub(show, line))


def hide_signature(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, signature: str, returns: str
) -> tuple[str, str] | None:
    """Leave out the arguments of classes that users never make."""
    if not signature:
        return None
    if what == "exception" or (what == "class" and not _MADE_BY_USERS.match(name)):
        return "", ""
    return None


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect the extension."""
    app.connect("config-inited", link_types, priority=100)
    # After numpydoc, which writes the sections.
    app.connect("autodoc-process-docstring", link_names, priority=900)
    app.connect("autodoc-process-signature", hide_signature)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
