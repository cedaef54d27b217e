"""Pages of one file: what all reports share, their style and the words for numbers."""

from __future__ import annotations

from importlib.resources import files
from typing import Any

import numpy as np

from sdpid import __version__
from sdpid._common.extras import require


def page(package: str, template: str, **values: Any) -> str:
    """Return the page that a template of a package makes of values.

    Texts are escaped; ``style`` and ``version`` are values of every page.

    Raises
    ------
    MissingExtraError
        When jinja2 is not installed (extra ``report``).
    """
    jinja2 = require("jinja2", extra="report")
    markup = require("markupsafe", extra="report").Markup
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters.update(number=number, percent=percent, fixed=fixed)
    environment.filters["capitalized"] = capitalized
    text = files(package).joinpath(template).read_text(encoding="utf-8")
    style = files("sdpid.output.report").joinpath("page.css").read_text(encoding="utf-8")
    values.update(style=markup(style), version=__version__)
    return str(environment.from_string(text).render(**values))


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
