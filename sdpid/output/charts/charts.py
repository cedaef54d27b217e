"""`Charts` of a page: arrays as text, and what draws them there, uPlot, which is embedded."""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.extras import require
from sdpid.output.charts.packed import packed


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

    @property
    def data(self) -> Any:
        """What the page holds for `scripts`, as JSON that no "<" in a name can end."""
        charts = json.dumps(self._charts, separators=(",", ":"), allow_nan=False)
        text = f'{{"columns":[{",".join(self._columns)}],"charts":{charts}}}'
        return require("markupsafe", extra="report").Markup(text.replace("<", "\\u003c"))


def style() -> Any:
    """Return the style of charts."""
    return require("markupsafe", extra="report").Markup(
        _file("uplot/uPlot.min.css") + _file("charts.css")
    )


def scripts() -> tuple[str, str]:
    """Return the programs that draw charts; a page that holds them holds uPlot's licence, too."""
    return f"/*\n{_file('uplot/LICENSE')}*/\n{_file('uplot/uPlot.iife.min.js')}", _file("charts.js")


@cache
def _file(name: str) -> str:
    """Return the text of a file beside this one."""
    return files("sdpid.output.charts").joinpath(name).read_text(encoding="utf-8")
