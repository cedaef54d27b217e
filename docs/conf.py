"""How Sphinx builds the site: `python -m sphinx -W --keep-going docs docs/_site`, offline.

`SDPID_DOCS=draft` leaves the tutorials unexecuted, which takes a fraction of the time.
"""

import hashlib
import os
import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
sys.path.insert(0, str(DOCS / "_ext"))
sys.path.insert(0, str(ROOT))

import tutorials  # noqa: E402  (in _ext)

import sdpid  # noqa: E402

project = "sdpid"
author = "the sdpid developers"
version = release = sdpid.__version__
project_copyright = author

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "numpydoc",
    "myst_nb",
    "sphinx_copybutton",
    "sphinx_design",
    "citations",
    "command_line",
    "evidence",
    "docstrings",
    "findings",
    "offline_math",
    "root_pages",
    "summaries",
]
exclude_patterns = ["_site", "_cache", "_ext", "jupyter_execute", "evidence/tables"]

# Pages
myst_enable_extensions = ["attrs_inline", "colon_fence", "deflist", "dollarmath"]
myst_fence_as_directive = ["math"]
myst_heading_anchors = 4
myst_dmath_double_inline = True

# Python
autodoc_typehints = "none"
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
maximum_signature_line_length = 90
toc_object_entries_show_parents = "hide"
nitpicky = False

# Tutorials run in a folder of their own, with this interpreter and this package. What they gave is
# kept until the package or the tutorial changes.
records = tutorials.prepare(ROOT)
nb_execution_mode = "off" if os.environ.get("SDPID_DOCS") == "draft" else "cache"
nb_execution_cache_path = str(
    DOCS / "_cache" / hashlib.sha256(tutorials.sources(ROOT)).hexdigest()[:16]
)
# What is not executed has no language that myst-nb knows of.
suppress_warnings = [] if nb_execution_mode == "cache" and records else ["myst-nb.lexer"]
nb_execution_in_temp = True
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_execution_excludepatterns = [] if records else tutorials.that_need_records(DOCS)
nb_execution_show_tb = True
nb_merge_streams = True

# The site
html_theme = "furo"
html_title = "sdpid"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
html_show_sphinx = False
html_theme_options = {"navigation_with_keys": True}
templates_path: list[str] = []
copybutton_prompt_text = r"\$ |>>> |\.\.\. "
copybutton_prompt_is_regexp = True

# External links: `python -m sphinx -b linkcheck docs docs/_site/links`, with a network.
linkcheck_timeout = 20
linkcheck_retries = 2
linkcheck_anchors = False


def _mark(app, name, source):
    """Say on a tutorial that was not executed why it shows no outputs."""
    if "kernelspec:" not in source[0][:400]:
        return
    if nb_execution_mode == "off":
        source[0] = tutorials.marked(source[0], "it is a draft.")
    elif f"{name}.md" in nb_execution_excludepatterns:
        level = "../" * name.count("/")
        why = f"the [public records]({level}evidence/data.md) were not at hand."
        source[0] = tutorials.marked(source[0], why)


def setup(app):
    """Mark tutorials that are not executed."""
    app.connect("source-read", _mark)
