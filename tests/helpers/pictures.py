"""Pictures as text."""

import io
from typing import Any

from sdpid.plots.figures import figure_of


def svg_text(drawn: Any) -> str:
    """Return the figure of axes as SVG."""
    import matplotlib

    out = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none"}):
        figure_of(drawn).savefig(out, format="svg", facecolor="none")
    return out.getvalue()
