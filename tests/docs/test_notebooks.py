"""The notebooks are the tutorials."""

import runpy
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "docs" / "notebooks.py"


def test_notebooks_are_those_of_the_pages() -> None:
    pytest.importorskip("jupytext")
    command = [sys.executable, str(SCRIPT), "--check"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_page_that_was_not_run_says_so_below_its_title() -> None:
    marked = runpy.run_path(str(SCRIPT.parent / "_ext" / "tutorials.py"))["marked"]
    lines = marked("---\na: b\n---\n\n# Title\n\ntext\n\n# not a title\n", "why.").splitlines()
    assert lines[4:7] == ["# Title", "", ":::{note}"]
    assert sum("why." in line for line in lines) == 1
