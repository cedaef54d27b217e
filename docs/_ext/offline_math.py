"""Show formulas with the MathJax of a wheel: no page asks the network for anything."""

import shutil
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform

# One file, which needs no fonts.
_SCRIPT = "tex-svg-full.js"


class AsWritten(SphinxTransform):
    r"""Hand formulas to MathJax as they are; Sphinx would wrap them, which forbids `\tag`."""

    default_priority = 700

    def apply(self, **kwargs: Any) -> None:
        """Change every formula that has no label of Sphinx's own."""
        for node in self.document.findall(nodes.math_block):
            if not node.get("label") and not node.get("no-wrap", node.get("nowrap")):
                text = rf"\[{node.astext()}\]"
                node.children = [nodes.Text(text)]
                node["no-wrap"] = node["nowrap"] = True


def copy_script(app: Sphinx, exception: Exception | None) -> None:
    """Put MathJax beside the pages."""
    if exception is not None or app.builder.format != "html":
        return
    found = find_spec("sphinx-mathjax-offline")
    if found is None or found.origin is None:
        raise RuntimeError("MathJax is not installed: pip install sphinx-mathjax-offline")
    folder = Path(app.outdir) / "_static" / "mathjax"
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copy(Path(found.origin).parent / "static" / "mathjax" / _SCRIPT, folder)


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect the extension."""
    app.config.mathjax_path = f"mathjax/{_SCRIPT}"  # type: ignore[attr-defined]
    app.add_transform(AsWritten)
    app.connect("build-finished", copy_script)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
