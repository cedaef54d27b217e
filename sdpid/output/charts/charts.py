"""`Charts` of a page: arrays as text, and what draws them there, uPlot, which is embedded.

Arrays are quantized, little-endian, in base64; the page's scripts read them.
"""

from __future__ import annotations

import base64
import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._common.arrays import Array, Indices
from sdpid._common.extras import require
from sdpid.output.charts.page import beside, page

# Steps between the least and the largest value of a column: 15 µm of a meter. One more number of 16
# bits stands for what is missing.
_STEPS = 65534

_HERE = "sdpid.output.charts"


class Charts:
    """What the charts of one page show. How they look stands in its templates."""

    def __init__(self) -> None:
        self._charts: list[dict[str, Any]] = []
        self._columns: dict[str, int] = {}

    def add(self, *, shaded: Array | None = None, **values: Any) -> int:
        """Hold what a chart shows and return its number.

        Parameters
        ----------
        shaded : ndarray, shape (k, 2), optional
            Stretches of the horizontal axis.
        **values
            Arrays (K,) over ``x`` by their names, NaN where there is nothing; of dots as many as
            there are. Where several charts show an array the page holds it once. Or numbers; what
            is None is left out.
        """
        held = {
            name: self._column(each) if isinstance(each, np.ndarray) else each
            for name, each in values.items()
            if each is not None
        }
        spans = np.zeros((0, 2)) if shaded is None else shaded
        held["shaded"] = [[float(f"{end:.6g}") for end in span] for span in spans]
        self._charts.append(held)
        return len(self._charts) - 1

    def _column(self, values: Array) -> int:
        """Hold an array and return its number."""
        text = json.dumps(packed(values[:, None]), separators=(",", ":"), allow_nan=False)
        return self._columns.setdefault(text, len(self._columns))

    def page(self, package: str, template: str, *, scene: Any, **values: Any) -> str:
        """Return the page that a template makes of values, of these charts and of a scene.

        Arguments and errors are otherwise those of `sdpid.output.charts.page.page`.
        """
        own = {"charts": self, "chart_style": style(), "scene": scene}
        return page(package, template, scripts=(scene.script, *scripts()), **own, **values)

    @property
    def data(self) -> Any:
        """What the page holds for `scripts`, as JSON that no "<" in a name can end."""
        charts = json.dumps(self._charts, separators=(",", ":"), allow_nan=False)
        text = f'{{"columns":[{",".join(self._columns)}],"charts":{charts}}}'
        return require("markupsafe", extra="report").Markup(text.replace("<", "\\u003c"))


def style() -> Any:
    """Return the style of charts."""
    text = beside(_HERE, "uplot/uPlot.min.css") + beside(_HERE, "charts.css")
    return require("markupsafe", extra="report").Markup(text)


def scripts() -> tuple[str, str]:
    """Return the programs that draw charts; a page that holds them holds uPlot's licence, too."""
    uplot = f"/*\n{beside(_HERE, 'uplot/LICENSE')}*/\n{beside(_HERE, 'uplot/uPlot.iife.min.js')}"
    return uplot, beside(_HERE, "charts.js")


def packed(values: Array) -> dict[str, Any]:
    """Return an array (N, C) as numbers of 16 bits between the ends of its columns.

    What is not finite is missing.
    """
    known = np.ma.masked_invalid(values)
    low = np.ma.filled(known.min(axis=0), 0.0)
    spans = np.ma.filled(known.max(axis=0) - low, 0.0)
    spans = np.where(spans > 0.0, spans, 1.0)
    steps = np.ma.filled(np.rint((known - low) / spans * _STEPS), _STEPS + 1).astype("<u2")
    return {"low": low.tolist(), "high": (low + spans).tolist(), "data": text_of(steps)}


def packed_indices(values: Indices) -> str:
    """Return indices as text, numbers of 32 bits."""
    return text_of(values.astype("<u4"))


def text_of(values: NDArray[Any]) -> str:
    """Return the bytes of an array in base64."""
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")
