"""Pages of one file: what all reports share, and `Charts` that they draw themselves.

Arrays are quantized, little-endian, in base64; the page's scripts read them.
"""

from __future__ import annotations

import base64
import hashlib
import json
import os
import sys
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid import __version__
from sdpid._common.arrays import Array, Indices
from sdpid._common.extras import require

# Where the style and the parts are that several pages have.
_SHARED = "sdpid.output.report"

# A table with more rows is folded: its summary says what it holds.
LONG = 16

# A page loads nothing; its styles and its pictures stand in it.
_POLICY = (
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; base-uri 'none'; "
    "form-action 'none'"
)


def page(package: str, template: str, *, scripts: Sequence[str] = (), **values: Any) -> str:
    """Return the page that a template of a package makes of values.

    Texts are escaped. Values of every page are ``style``, ``version``, ``policy`` (its
    Content-Security-Policy), ``scripts`` and ``long`` (rows beyond which tables are folded). Of
    scripts those given run, by their digests, and no others; data in the page needs none.

    Parameters
    ----------
    package, template : str
        Where the template is; it may include and import others of its package, or of reports.
    scripts : sequence of str
        Programs to be run.
    **values
        What the template shows.

    Raises
    ------
    MissingExtraError
        When jinja2 is not installed (extra ``report``).
    """
    markup = require("markupsafe", extra="report").Markup
    values["policy"] = markup(policy(scripts))
    values["scripts"] = [markup(script) for script in scripts]
    return str(rendered(package, template, **values))


def rendered(package: str, template: str, **values: Any) -> Any:
    """Return the part of a page that a template of a package makes of values, marked as safe."""
    markup = require("markupsafe", extra="report").Markup
    return markup(_templates(package).get_template(template).render(**values))


@cache
def _templates(package: str) -> Any:
    """Return the templates of a package, and those that all pages share."""
    jinja2 = require("jinja2", extra="report")
    markup = require("markupsafe", extra="report").Markup

    def text(name: str) -> str | None:
        for room in (package, _SHARED):
            if files(room).joinpath(name).is_file():
                return beside(room, name)
        return None

    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(text),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        bytecode_cache=_compiled(),
    )
    environment.filters.update(number=number, percent=percent, fixed=fixed)
    environment.filters["capitalized"] = capitalized
    style = markup(beside(_SHARED, "page.css"))
    environment.globals.update(style=style, version=__version__, long=LONG)
    return environment


def _compiled() -> Any:
    """Return where compiled templates are kept, beside Python's own: compiling is half a report."""
    folder = Path(__file__).with_name("__pycache__")
    if sys.dont_write_bytecode or not os.access(folder, os.W_OK):
        return None
    cache = require("jinja2", extra="report").FileSystemBytecodeCache
    return cache(str(folder), f"%s.{__version__}.jinja")


@cache
def beside(package: str, name: str) -> str:
    """Return the text of a file of a package."""
    return files(package).joinpath(name).read_text(encoding="utf-8")


def policy(scripts: Sequence[str] = ()) -> str:
    """Return the Content-Security-Policy of a page in which these scripts run, by SHA-256."""
    if not scripts:
        return _POLICY
    digests = (hashlib.sha256(script.encode()).digest() for script in scripts)
    allowed = " ".join(f"'sha256-{base64.b64encode(each).decode('ascii')}'" for each in digests)
    return f"{_POLICY}; script-src {allowed}"


def number(value: float | None, digits: int = 4) -> str:
    """Return a number with `digits` significant digits; a dash where it is missing."""
    if value is None or not np.isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    text = f"{value:#.{digits}g}" if 1e-4 <= abs(value) < 10.0**digits else f"{value:.{digits}g}"
    return text.rstrip(".").replace("-", "−")


def capitalized(text: str) -> str:
    """Return a note with a capital first letter and without its full stop."""
    return (text[:1].upper() + text[1:]).removesuffix(".")


def percent(share: float | None, digits: int = 3) -> str:
    """Return a share in percent."""
    return "–" if share is None else f"{number(100.0 * share, digits)} %"


def fixed(value: float) -> str:
    """Return a number with four decimals, as R² is given."""
    return f"{value:.4f}".replace("-", "−")


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
