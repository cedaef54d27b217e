"""What the tutorials need to run: this interpreter's command, this package, the public records."""

import os
import re
import sys
from pathlib import Path

_FRONT = re.compile(r"\A---\n(.*?)\n---\n", flags=re.S)
_NEEDS = re.compile(r"^\s*(?:sdpid:\s*\{\s*)?needs_data:\s*true\b", flags=re.M)
# What a tutorial of a folder that is not here prints cannot be shown, so it is not run.
_RECORDS = "SDPID_DATA"


def prepare(root: Path) -> Path | None:
    """Set the environment of tutorials; return the folder of the public records, if any."""
    os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    places = [str(root), os.environ.get("PYTHONPATH", "")]
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, places))
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Tables as wide as the page.
    os.environ.setdefault("COLUMNS", "100")
    folder = Path(os.environ.get(_RECORDS, root.parent / "shared" / "data"))
    if not folder.is_dir():
        return None
    os.environ[_RECORDS] = str(folder)
    return folder


def sources(root: Path) -> bytes:
    """Return what the outputs of tutorials depend on beside their own text."""
    files = sorted((root / "sdpid").rglob("*.py"))
    return b"\0".join(file.read_bytes() for file in files)


def that_need_records(docs: Path) -> list[str]:
    """Return the pages whose front matter says `needs_data: true`, as patterns."""
    return [
        page.relative_to(docs).as_posix()
        for page in sorted(docs.rglob("*.md"))
        if (front := _FRONT.match(page.read_text(encoding="utf-8"))) and _NEEDS.search(front[1])
    ]


def marked(text: str, why: str) -> str:
    """Return a page with a note below its title that its code was not run."""
    note = f":::{{note}}\nThis build of the site shows no outputs on this page: {why}\n:::\n"
    return re.sub(r"^# .*\n", lambda title: f"{title[0]}\n{note}", text, count=1, flags=re.M)
