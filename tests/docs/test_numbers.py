"""Measured numbers stand in tables that a command makes, and pages take them from there."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
EVIDENCE = ROOT / "docs" / "evidence"


@pytest.fixture(autouse=True)
def evidence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EVIDENCE))


def test_pages_have_no_measured_number_of_their_own() -> None:
    from prose import unregistered

    found = unregistered(ROOT)
    listed = "\n".join(map(str, found))
    assert not found, (
        f"{listed}\nTake a measured number from a table of docs/evidence ({{measured}} or a link), "
        "or list a definition (default, limit, option) in docs/evidence/definitions.toml."
    )


def test_the_readme_says_what_the_tables_say() -> None:
    from prose import filled, readme_numbers
    from studies import load_studies

    studies = load_studies()
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").replace("*", "").split())
    for entry in readme_numbers():
        assert filled(entry, studies) in readme, "readme.toml and README.md say different things"
        assert entry["page"] in readme, f"README.md has no link to {entry['page']}"
        page = (ROOT / entry["page"]).read_text(encoding="utf-8")
        for value in entry["values"]:
            assert f"```{{evidence}} {value.split()[0]}\n" in page


def test_what_counts_as_a_measured_number() -> None:
    from prose import numbers

    text = "\n".join(
        (
            "---\ntitle: 5 %\n---\n# It takes 3 s\n",
            "from 0.04 to 0.26 s, `7 %`, $9 %$, 2.4e-8, 12\n%, 1.5 rad/s.",
            "| 4 % |\n\n```text\n8 %\n```\n:::{note}\nsome 6.5 times\n:::",
            "[1 %](x_2%.md) {measured}`a/b c .1%`",
        )
    )
    assert [number for _, number in numbers(text)] == [
        "3 s", "0.04 to 0.26 s", "2.4e-8", "12 %", "6.5 times", "1 %"
    ]  # fmt: skip
    assert [line for line, _ in numbers(text)] == [4, 6, 6, 6, 14, 16]


def test_every_page_of_evidence_shows_its_tables() -> None:
    from studies import load_studies

    shown = {
        reference
        for page in EVIDENCE.glob("*.md")
        for reference in re.findall(r"^```\{evidence\} (\S+)", page.read_text("utf-8"), flags=re.M)
    }
    studies = load_studies()
    assert shown == {f"{s}/{t}" for s, study in studies.items() for t in study.tables}
    for study in studies.values():
        page = (EVIDENCE / study.page).read_text(encoding="utf-8")
        assert f"{{evidence}} {study.name}/" in page
