"""Write the tutorials as notebooks: python docs/notebooks.py [--check]."""

import argparse
import json
import re
import sys
from pathlib import Path
from typing import Any

import jupytext

DOCS = Path(__file__).resolve().parent
TARGET = DOCS.parent / "examples" / "notebooks"
_LINK = re.compile(r"\]\((?!https?:|#)([\w./-]+)(#[\w-]+)?\)")


def sources() -> list[Path]:
    """Return the pages that are notebooks."""
    pages = [DOCS / "start.md", *sorted((DOCS / "tutorials").glob("*.md"))]
    return [page for page in pages if page.exists() and "kernelspec:" in page.read_text("utf-8")]


def notebook(page: Path) -> str:
    """Return a page as a notebook without outputs."""
    book: Any = jupytext.read(page, fmt="md:myst")
    book.metadata = {
        "kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}
    }
    for number, cell in enumerate(book.cells):
        cell["id"] = f"cell-{number}"
        cell["metadata"] = {}
        if cell.cell_type == "markdown":
            cell["source"] = _LINK.sub(lambda found: relinked(page, found), cell["source"])
    book.nbformat, book.nbformat_minor = 4, 5
    return json.dumps(book, indent=1, ensure_ascii=False) + "\n"


def relinked(page: Path, found: re.Match[str]) -> str:
    """Return a link as the notebook needs it, which lies in another folder."""
    target = (page.parent / found[1]).resolve().relative_to(DOCS.parent)
    return f"](../../{target.as_posix()}{found[2] or ''})"


def main() -> int:
    """Write the notebooks, or say which differ from their pages."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing")
    check = parser.parse_args().check
    texts = {TARGET / f"{page.stem}.ipynb": notebook(page) for page in sources()}
    there = set(TARGET.glob("*.ipynb"))
    old = [
        path.name
        for path in sorted(there | set(texts))
        if not path.exists() or path.read_text(encoding="utf-8") != texts.get(path)
    ]
    if check:
        if old:
            print(f"differ from their pages: {', '.join(old)}; run python docs/notebooks.py")
        return len(old) > 0
    TARGET.mkdir(exist_ok=True)
    for path in there - set(texts):
        path.unlink()
    for path, text in texts.items():
        path.write_text(text, encoding="utf-8")
    print(f"{len(texts)} notebooks in {TARGET}, {len(old)} changed")
    return 0


if __name__ == "__main__":
    sys.exit(main())
