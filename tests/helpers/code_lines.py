"""How many lines of code there are in each room and sub-package, and in the tests."""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path

_DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


def code_lines(text: str) -> int:
    """Return how many lines of a module are neither blank, nor comment, nor docstring."""
    skipped: set[int] = set()
    # Lines that begin within a text: a "#" there begins no comment.
    within: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, _DOCUMENTED) and ast.get_docstring(node, clean=False) is not None:
            first = node.body[0]
            skipped.update(range(first.lineno, (first.end_lineno or first.lineno) + 1))
        elif isinstance(node, (ast.Constant, ast.JoinedStr)):
            within.update(range(node.lineno + 1, (node.end_lineno or node.lineno) + 1))
    count = 0
    for row, line in enumerate(text.splitlines(), 1):
        comment = line.lstrip().startswith("#") and row not in within
        count += bool(line.strip()) and row not in skipped and not comment
    return count


def lines_by_part(repository: Path) -> dict[str, int]:
    """Return the code lines of ``sdpid``, of its rooms and their sub-packages, and of ``tests``."""
    found: Counter[str] = Counter()
    for path in sorted((repository / "sdpid").rglob("*.py")):
        count, folders = code_lines(path.read_text(encoding="utf-8")), path.parent
        parts = folders.relative_to(repository).parts[:3]
        for depth in range(1, len(parts) + 1):
            found["/".join(parts[:depth])] += count
    for path in sorted((repository / "tests").rglob("*.py")):
        found["tests"] += code_lines(path.read_text(encoding="utf-8"))
    return dict(sorted(found.items()))
