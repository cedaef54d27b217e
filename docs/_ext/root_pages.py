"""Let pages link to files above docs/ as on GitHub: those with a page here lead to it."""

import posixpath
import re
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.util import logging

# Files of the repository, and the pages that include them.
PAGES = {"CHANGELOG.md": "project/changelog.md", "SECURITY.md": "project/security.md"}
_LINK = re.compile(r"\]\(((?:\.\./)+[\w./-]+)(#[\w-]+)?\)")
_log = logging.getLogger(__name__)


def point_inside(app: Sphinx, name: str, source: list[str]) -> None:
    """Replace links to files that are included as pages; check that others exist."""
    folder = posixpath.dirname(name)

    def replace(found: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join("docs", folder, found[1]))
        if target.startswith("docs/"):
            return found[0]
        if target in PAGES:
            return f"]({posixpath.relpath(PAGES[target], folder or '.')}{found[2] or ''})"
        path = Path(app.srcdir).parent / target
        if path.is_dir():
            _log.warning("%s is a folder; link to a file in it", found[1], location=name)
        return found[0]

    source[0] = _LINK.sub(replace, source[0])


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect the extension."""
    app.connect("source-read", point_inside)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
