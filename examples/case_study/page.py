"""The page of the case study: its point in a sentence, tables and pictures of each plant."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

import pandas as pd

STYLE = """body{font:15px/1.5 system-ui,sans-serif;max-width:76rem;margin:2rem auto;padding:0 1rem}
table{border-collapse:collapse;font-size:13px;font-variant-numeric:tabular-nums}
td,th{padding:.15rem .6rem;text-align:right;border-bottom:1px solid #e5e7eb}
pre,div{overflow-x:auto}img{max-width:100%}"""


def point(facts: Mapping[str, Mapping[str, Any]], starts: int) -> str:
    """Return what the case study shows of local solvers, the program, and least squares."""
    each = [of for plant in facts.values() for of in plant.items()]
    optimal = sum(value for name, value in each if "_optimal_" in name)
    solves = sum(starts for name, _ in each if "_optimal_" in name)
    worst = max(value for name, value in each if "_worst_gap_" in name and value is not None)
    gap = max(value for name, value in each if name.startswith("gap_"))
    lines = [
        f"{optimal} of {solves} local solves end optimal, and the worst ends {100 * worst:.2g} % "
        f"above the bound; the semidefinite program is proven to {gap:.1g} each time."
    ]
    for plant, of in facts.items():
        least, greatest = of["wls_least_eigenvalue"], of["wls_greatest_least_eigenvalue"]
        no_robot = f"no robot on the whole motion (M(q) ≤ {greatest:.2g} kg·m²)"
        judged = "a robot on this motion" if least > 0.0 else "no robot on part of the motion"
        judged = no_robot if greatest < 0.0 else judged
        lines.append(
            f"{plant} plant: least squares is {judged}; the program's estimate is a robot in every "
            f"posture (M(q) ≥ {of['sdp_proven_eigenvalue']:.2g} kg·m², proven)."
        )
    return "\n".join(lines)


class Page:
    """Collects headings, tables, texts and pictures, and writes them as one HTML file."""

    def __init__(self, title: str) -> None:
        self.title = title
        self.parts: list[str] = []

    def heading(self, text: str) -> None:
        """Add a heading."""
        self.parts.append(f"<h2>{escape(text)}</h2>")

    def table(self, title: str, table: pd.DataFrame) -> None:
        """Add a table with its title."""
        shown = table.to_html(float_format="{:.4g}".format, border=0, na_rep="")
        self.parts.append(f"<h3>{escape(title)}</h3><div>{shown}</div>")

    def text(self, title: str, text: str) -> None:
        """Add lines of text as they are."""
        self.parts.append(f"<h3>{escape(title)}</h3><pre>{escape(text)}</pre>")

    def picture(self, path: Path, folder: Path) -> None:
        """Add a picture that stands below the page's folder."""
        name = path.relative_to(folder).as_posix()
        self.parts.append(f'<p><img src="{escape(name)}" alt="{escape(path.stem)}"></p>')

    def write(self, path: Path, point: str) -> None:
        """Write the page, its point first."""
        said = "".join(f"<p><strong>{escape(line)}</strong></p>" for line in point.splitlines())
        path.write_text(
            f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{escape(self.title)}'
            f"</title><style>{STYLE}</style><h1>{escape(self.title)}</h1>{said}"
            + "\n".join(self.parts),
            encoding="utf-8",
        )
