"""Tables of the evidence: kept, compared, made anew, and shown."""

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.helpers.refusals import refuses

EVIDENCE = Path(__file__).resolve().parents[2] / "docs" / "evidence"

STUDIES = """
[first]
title = "A study that writes a table"
command = "python study.py {out}"

[first.tables.arms]
file = "found/arms.csv"
key = ["arm"]
tolerances = {gap = 9}
time = ["seconds"]
date = "2020-02-02"
made = "from the page of 2020-02-02"

[second]
title = "One that fails"
command = "python -c raise(SystemExit(3))"

[second.tables.none]
file = "page.md#2"
"""
STUDY = """
import re
import subprocess
import sys
from pathlib import Path
out = Path(sys.argv[1]) / "found"
out.mkdir()
(out / "arms.csv").write_text(Path("arms.csv").read_text())
"""
KEPT = "arm,error,gap,seconds\nUR10,4.70,1e-9,1.5\nPanda,1.72 of 3,2e-9,1.0\n"


@pytest.fixture(autouse=True)
def evidence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EVIDENCE))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return docs/evidence of a repository with two studies."""
    place = tmp_path / "docs" / "evidence"
    (place / "tables" / "first").mkdir(parents=True)
    (place / "studies.toml").write_text(STUDIES, encoding="utf-8")
    (place / "tables" / "first" / "arms.csv").write_text(KEPT, encoding="utf-8")
    (tmp_path / "study.py").write_text(STUDY, encoding="utf-8")
    return place


def made_anew(folder: Path, content: str, *arguments: str) -> int:
    import renew

    (folder.parents[1] / "arms.csv").write_text(content, encoding="utf-8")
    return renew.main(["first", *arguments], folder)


def kept(folder: Path) -> str:
    return (folder / "tables" / "first" / "arms.csv").read_text(encoding="utf-8")


@pytest.fixture
def told(capsys: pytest.CaptureFixture[str]) -> Callable[[], str]:
    """Return what returns the words that were printed since it was last asked."""
    return lambda: capsys.readouterr().out


def test_what_is_within_tolerance_is_no_change(folder: Path, told: Callable[[], str]) -> None:
    new = KEPT.replace("4.70", "4.75").replace("1e-9", "8e-9").replace("1.5", "99")
    assert made_anew(folder, new, "--check") == 0
    assert "as before" in told()
    assert kept(folder) == KEPT


def test_changes_are_told_and_kept(folder: Path, told: Callable[[], str]) -> None:
    assert made_anew(folder, KEPT.replace("gap", "hole"), "--check") == 1
    assert "columns: arm, error, gap, seconds → arm, error, hole" in told()
    new = KEPT.replace("4.70", "4.2").replace("1.72 of 3", "1.72 of 4") + "TX40,1,1,1\n"
    assert made_anew(folder, new, "--check") == 1
    words = told()
    for line in ("UR10, error: 4.70 → 4.2", "Panda, error: 1.72 of 3 → 1.72 of 4", "TX40:"):
        assert line in words
    assert kept(folder) == KEPT
    assert made_anew(folder, new) == 0
    assert kept(folder) == new
    text = (folder / "studies.toml").read_text(encoding="utf-8")
    assert 'made = "by the command"' in text
    assert "2020" not in text
    assert "[second]" in text
    assert made_anew(folder, new, "--check") == 0


def test_a_study_that_fails_leaves_its_tables(folder: Path, told: Callable[[], str]) -> None:
    import renew

    before = (folder / "studies.toml").read_text(encoding="utf-8")
    assert renew.main(["second"], folder) == 1
    assert "failed with status 3" in told()
    assert made_anew(folder, KEPT.splitlines()[0] + "\n") == 1
    assert "no rows" in told()
    (folder.parents[1] / "study.py").write_text("", encoding="utf-8")
    assert renew.main(["first"], folder) == 1
    assert "arms.csv is missing" in told()
    assert kept(folder) == KEPT
    assert (folder / "studies.toml").read_text(encoding="utf-8") == before
    assert renew.main(["third"], folder) == 2


@pytest.mark.parametrize("data", ["", "nowhere"])
def test_a_study_without_what_it_needs(
    folder: Path, data: str, monkeypatch: pytest.MonkeyPatch, told: Callable[[], str]
) -> None:
    import renew

    monkeypatch.setenv("SDPID_DATA", data)
    wants = STUDIES.replace("python study.py {out}", "python study.py {data} {out}")
    wants = wants.replace("python -c raise(SystemExit(3))", "no-such-command {out}")
    (folder / "studies.toml").write_text(wants, encoding="utf-8")
    assert renew.main(["first", "second"], folder) == 1
    words = told()
    assert "needs the public records; SDPID_DATA" in words
    assert "no-such-command" in words
    assert kept(folder) == KEPT


def test_results_of_a_run_elsewhere(folder: Path) -> None:
    import renew

    runs = folder.parents[1] / "runs"
    (runs / "first" / "found").mkdir(parents=True)
    (runs / "first" / "found" / "arms.csv").write_text(KEPT, encoding="utf-8")
    stamp = 'date = "2021-01-01"\ncommit = "abc"\nmachine = "a desk"\n'
    (runs / "first" / "made.toml").write_text(stamp, encoding="utf-8")
    assert renew.main(["first", "--from", str(runs)], folder) == 0
    text = (folder / "studies.toml").read_text(encoding="utf-8")
    assert 'date = "2021-01-01"' in text
    assert 'machine = "a desk"' in text


def test_the_list(folder: Path, told: Callable[[], str]) -> None:
    import renew

    assert renew.main(["--list"], folder) == 0
    words = told()
    for part in ("first: python study.py results  (? min)", "arms", "2020-02-02"):
        assert part in words
    assert renew.main(["--older-than", "1e9", "first"], folder) == 0


def test_numbers_of_a_table(folder: Path) -> None:
    from studies import EvidenceError, load_studies, measured

    studies = load_studies(folder)
    for reference, number in (
        ("first/arms arm=UR10 error .1f", "4.7"),
        ("first/arms arm=UR10 gap .0e", "1e-9"),
        ("first/arms max:gap .0%", "0 %"),
        ("first/arms count:seconds d", "2"),
        ("first/arms sum:seconds", "2.5"),
        ("first/arms arm!=UR10 seconds", "1.0"),
    ):
        assert measured(studies, reference) == number
    for reference, message in (
        ("third/arms error", "no study"),
        ("first/legs error", "has the tables arms"),
        ("first/arms arm=UR10 hole", "0 columns 'hole'"),
        ("first/arms arm=TX40 error", "0 rows"),
        ("first/arms error", "2 rows"),
        ("first/arms arm=TX40 max:error", "'max' of 0"),
        ("first/arms", "want study/table"),
    ):
        refuses(EvidenceError, message, measured, studies, reference)


def test_tables_of_markdown(tmp_path: Path) -> None:
    from studies import EvidenceError, read_grid

    page = tmp_path / "page.md"
    page.write_text("a\n\n| x | y |\n|---|---|\n| **−1** | |\n\n| z |\n|---|\n| 2 |\n")
    assert read_grid(tmp_path / "page.md#1").rows == (("-1", ""),)
    assert read_grid(tmp_path / "page.md#2").header == ("z",)
    refuses(EvidenceError, "2 tables", read_grid, tmp_path / "page.md#3")


def test_every_kept_table_is_named_once_and_is_there() -> None:
    from studies import load_studies

    tables = [table for study in load_studies().values() for table in study.tables.values()]
    for table in tables:
        grid = table.read()
        assert grid.rows, table.path
        assert all(len(row) == len(grid.header) for row in grid.rows), table.path
        assert table.date, table.path
        if table.made == "by the command":
            assert {*table.key, *table.time, *table.tolerances} <= {*grid.header}, table.path
        else:
            assert table.made.startswith("from the page of")
    assert {table.path for table in tables} == set((EVIDENCE / "tables").rglob("*.csv"))


PAGE = """# Page

```{evidence} first/arms
:columns: arm, gap=Relative gap
:formats: gap=.0e
```

Of the UR10 {measured}`first/arms arm=UR10 error .1f`.

```{studies}
```
"""
WRONG = {
    "```{evidence} first/legs\n```": "has the tables arms",
    "```{evidence} first/arms\n:columns: leg=Leg\n```": "0 columns 'leg'",
    "```{evidence} first/arms\n:rows: arm=TX40\n```": "no rows",
    "{measured}`first/arms error`": "2 rows, not one",
}


def test_pages_show_tables_and_numbers_or_warn(folder: Path, tmp_path: Path) -> None:
    source, out = folder.parent, tmp_path / "out"
    (source / "index.md").write_text(PAGE, encoding="utf-8")
    (source / "wrong.md").write_text("# Wrong\n\n" + "\n\n".join(WRONG), encoding="utf-8")
    path = f"import sys\nsys.path.insert(0, {str(EVIDENCE.parent / '_ext')!r})\n"
    (source / "conf.py").write_text(f"{path}extensions = ['myst_parser', 'evidence']")
    # In a process of its own: what Sphinx registers stays.
    command = [sys.executable, "-m", "sphinx", "-q", str(source), str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    for message in WRONG.values():
        assert message in done.stderr
    assert "index.md" not in done.stderr
    html = (out / "index.html").read_text(encoding="utf-8")
    text = re.sub(r"<[^>]*>", "", html.partition("<h1>")[2])
    shown = ("python study.py", "Arm", "Relative gap", "2e-9", "not made anew since")
    for words in (*shown, "Of the UR10 4.7", "One that fails"):
        assert words in text
    assert "seconds" not in text


def test_titles_of_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EVIDENCE.parent / "_ext"))
    from evidence import titled

    names = ("held_out_percent", "sdp_4x4", "cpu_s", "s", "rows, %")
    assert [titled(name) for name in names] == ["Held out, %", "SDP 4×4", "CPU, s", "S", "Rows, %"]


def test_every_command_runs_something_that_is_there() -> None:
    from studies import load_studies

    root = EVIDENCE.parents[1]
    for study in load_studies().values():
        words = study.command.split()
        if words[:2] == ["python", "-m"]:
            path = root / words[2].replace(".", "/")
            assert path.with_suffix(".py").is_file() or (path / "__main__.py").is_file()
        elif words[0] == "python":
            path = root / words[1]
            assert path.is_file() or (path / "__main__.py").is_file()
        assert "{out}" in study.command or study.note
