"""Numbers with a measured unit in the prose of pages that no table backs: the reviewer's list.

Looked at are README.md and every page of docs: percent, times, bytes, "so many times" and powers
of ten. Left out are code, formulas, tables, directives and the role ``measured``; numbers of the
README that readme.toml takes from a table; and definitions (defaults, limits, sizes of a study),
which definitions.toml lists page by page.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from studies import HERE, Study, load_studies, measured

from sdpid._common.files import load_toml

_UNIT = (
    r"%|percent|seconds?|s|ms|µs|ns|minutes?|min|hours?|h|days|"
    r"GB|MB|kB|GiB|MiB|KiB|bytes|times|points|GB/s|MB/s"
)
_VALUE = r"\d[\d.,]*(?:e[-−+]?\d+)?"
_MEASURED = re.compile(
    rf"(?<![\w.])(?:{_VALUE}(?:\s(?:to|and|or|±)\s))*{_VALUE}\s?(?:{_UNIT})(?![\w/²³·])"
    r"|(?<![\w.])\d[\d.]*e[-−]\d+"
)
# What is no prose: comments, math, code in a line with a role before it, targets of links.
_LEFT_OUT = re.compile(
    r"<!--.*?-->|\{[\w-]+\}`[^`]*`|``.*?``|`[^`]*`|\$[^$]+\$|\]\([^)]*\)|https?://\S+", re.S
)
_FENCE = re.compile(r"^\s*(`{3,}|:{3,})")


@dataclass(frozen=True)
class Found:
    """A number in the prose of a page."""

    page: str
    line: int
    number: str

    def __str__(self) -> str:
        return f"{self.page}:{self.line}: {self.number}"


def numbers(text: str) -> Iterator[tuple[int, str]]:
    """Yield the line and the text of every number with a measured unit in the prose of a page."""
    prose = _LEFT_OUT.sub(_blank, "\n".join(_prose(text)))
    for found in _MEASURED.finditer(prose):
        yield prose.count("\n", 0, found.start()) + 1, " ".join(found[0].split())


def _prose(text: str) -> Iterator[str]:
    """Yield every line; those of code, tables and the front matter as empty ones.

    What stands in an admonition (``:::``) is prose.
    """
    fence = ""
    lines = text.splitlines()
    matter = lines[:1] == ["---"]
    for number, line in enumerate(lines):
        mark = _FENCE.match(line)
        keep = not (fence or matter or mark) and not line.lstrip().startswith("|")
        if matter and number and line == "---":
            matter = False
        elif mark and mark[1].startswith("`"):
            if not fence:
                fence = mark[1]
            elif mark[1].startswith(fence) and line.strip() == mark[1]:
                fence = ""
        yield line if keep else ""


def _blank(found: re.Match[str]) -> str:
    return "\n" * found[0].count("\n") + " "


def unregistered(root: Path, folder: Path = HERE) -> list[Found]:
    """Return every number that neither a table backs nor definitions.toml lists."""
    known = load_toml(folder / "definitions.toml")
    everywhere = set(known.get("everywhere", ()))
    readme = "\n".join(filled(entry, load_studies(folder)) for entry in readme_numbers(folder))
    backed = {number for _, number in numbers(readme)}
    found = []
    for path in pages(root):
        page = path.relative_to(root).as_posix()
        allowed = everywhere | set(known["pages"].get(page, ()))
        allowed |= backed if page == "README.md" else set()
        text = path.read_text(encoding="utf-8")
        found += [Found(page, n, number) for n, number in numbers(text) if number not in allowed]
    return found


def pages(root: Path) -> list[Path]:
    """Return README.md and the pages of docs."""
    docs = root / "docs"
    built = ("_site", "_cache")
    return [
        root / "README.md",
        *(p for p in sorted(docs.rglob("*.md")) if p.relative_to(docs).parts[0] not in built),
    ]


def readme_numbers(folder: Path = HERE) -> list[dict[str, Any]]:
    """Return the entries of readme.toml: a snippet with ``{}`` and what stands for each."""
    return list(load_toml(folder / "readme.toml")["number"])


def filled(entry: Mapping[str, Any], studies: Mapping[str, Study]) -> str:
    """Return a snippet with its numbers, each from its table."""
    return str(entry["snippet"]).format(*(measured(studies, each) for each in entry["values"]))


def report(root: Path) -> int:
    """Print the list and return 1 if there is anything in it."""
    found = unregistered(root)
    print(*found, sep="\n")
    print(f"{len(found)} numbers without a table, on {len({each.page for each in found})} pages")
    return int(bool(found))
