"""Every example runs from start to end, small, in a folder of its own."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import sdpid

REPOSITORY = Path(__file__).resolve().parent.parent
FOLDER = REPOSITORY / "examples"
# Where tests find real recordings (tests/conftest.py); without them examples leave those out.
DATA = Path(os.environ.get("SDPID_DATA", REPOSITORY.parent / "shared" / "data"))
# What users run stands in the folder itself, the studies of docs/evidence below it. Tools of the
# benchmark are run by its script, in environments of their own; speed is measured, not tested.
EXAMPLES = sorted(FOLDER.glob("*.py"))
STUDIES = sorted(
    p
    for p in FOLDER.glob("*/**/*.py")
    if "__main__" in p.read_text(encoding="utf-8")
    and not {"adapters", "speed"} & {*p.relative_to(FOLDER).parts}
)


def test_there_are_examples_and_studies() -> None:
    assert EXAMPLES
    assert STUDIES


@pytest.mark.parametrize(
    "path",
    [
        *(pytest.param(path, marks=pytest.mark.examples, id=path.stem) for path in EXAMPLES),
        *(pytest.param(path, marks=pytest.mark.studies, id=path.stem) for path in STUDIES),
    ],
)
def test_example_runs(path: Path, tmp_path: Path) -> None:
    # The package under test, installed or not.
    places = [str(Path(sdpid.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, places))}
    if DATA.is_dir():
        environment["SDPID_DATA"] = str(DATA)
    done = subprocess.run(
        [sys.executable, str(path), "--quick", "--out", "results"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    written = [file for file in (tmp_path / "results").rglob("*") if file.is_file()]
    assert written
    assert all(file.stat().st_size > 0 for file in written)
    check = CHECKS.get(path.stem)
    if check is not None:
        check(tmp_path / "results")


def check_case_study(results: Path) -> None:
    """Check what docs/evidence/case_study.md claims, on the small experiment."""
    with (results / "plants.csv").open(encoding="utf-8") as file:
        facts = {row["fact"]: row for row in csv.DictReader(file)}
    for plant in ("ideal", "unmodeled"):
        for inequality in ("6x6", "4x4"):
            assert facts[f"certified_{inequality}"][plant] == "True"
        assert float(facts["sdp_proven_eigenvalue"][plant]) > 0.0
        shown = {"table_iv.csv": "paper_cwls", "table_v.csv": "paper_mass", "comparison.csv": "gap"}
        for name, words in shown.items():
            assert words in (results / plant / name).read_text(encoding="utf-8"), name
    # Least squares finds what bodies can have, unless the plant has what the model has not.
    for inequality in ("6x6", "4x4"):
        verdicts = facts[f"wls_{inequality}"]
        assert (verdicts["ideal"], verdicts["unmodeled"]) == ("realisable", "not realisable")
    assert float(facts["wls_least_eigenvalue"]["ideal"]) > 0.0
    # Indefinite on the whole motion.
    assert float(facts["wls_greatest_least_eigenvalue"]["unmodeled"]) < 0.0


def check_real_arms(results: Path) -> None:
    """Check that our arms are robots; there are none where the records are not at hand."""
    with (results / "real_arms.csv").open(encoding="utf-8") as file:
        ours = [row for row in csv.DictReader(file) if row["method"] == "this package"]
    for row in ours:
        assert float(row["proven_bound"]) > 0.0
        assert float(row["eigenvalue_min"]) >= float(row["proven_bound"])
        assert row["driving_joints"] == "0"
        assert row["diverged_s"] == ""


def check_ready_models(results: Path) -> None:
    """Check that what is identified beats its description; there is none without the records."""
    with (results / "models.csv").open(encoding="utf-8") as file:
        found = {row["model"]: row for row in csv.DictReader(file)}
    if found:
        for column in ("missed_percent", "tracking_deg"):
            assert float(found["identified"][column]) < float(found["URDF"][column])


CHECKS: dict[str, Callable[[Path], None]] = {
    "denso_vp6242": check_case_study,
    "real_arms": check_real_arms,
    "ready_models": check_ready_models,
}
