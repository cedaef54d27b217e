"""Messages and kinds of findings on the page of troubleshooting are those of the package."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from sdpid.experiment.inspection.kinds import KINDS

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "troubleshooting.md").read_text("utf-8")
_CODE = re.compile(r"`([^`]+)`")


@cache
def texts() -> tuple[str, ...]:
    """Return every text in the package, a placeholder for what is filled in."""
    trees = (ast.parse(path.read_text("utf-8")) for path in (ROOT / "sdpid").rglob("*.py"))
    return tuple(filter(None, (text(node) for tree in trees for node in ast.walk(tree))))


def text(node: ast.AST) -> str:
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(text(part) or "\0" for part in node.values)
    return ""


def first_cells(header: str) -> Iterator[str]:
    """Yield the code in the first column of each table that begins with this heading."""
    inside = False
    for line in PAGE.splitlines():
        cell = line.strip().strip("|").split("|")[0].strip() if line.startswith("|") else ""
        inside = bool(cell) and (inside or cell == header)
        if inside:
            yield from _CODE.findall(cell)


def test_every_message_is_one_of_the_package() -> None:
    messages = list(first_cells("message"))
    assert len(messages) > 50
    wanted = [[part for part in message.split("…") if len(part) > 2] for message in messages]
    said = texts()
    gone = [
        message
        for message, parts in zip(messages, wanted, strict=True)
        if not any(all(part in words for part in parts) for words in said)
    ]
    assert not gone


def test_every_kind_of_finding_is_named() -> None:
    kinds = set(KINDS)
    named = set(first_cells("kind"))
    assert kinds - named == set()
    assert named - kinds == set()
