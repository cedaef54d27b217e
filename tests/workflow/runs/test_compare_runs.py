"""Two results folders against each other, from their files alone."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

import sdpid
from sdpid.cli import app
from sdpid.errors import DataError
from sdpid.workflow.result import Identification
from sdpid.workflow.runs.compare import RunComparison, compare_runs
from tests.helpers.identified import arm_theta, identified, moved
from tests.helpers.refusals import refuses
from tests.helpers.robots import small_arm

BELIEF = sdpid.Prior(bodies=1.2 * arm_theta()[:20].reshape(2, 10))
PROCESSING = {"cutoff_hz": 10.0, "order": 2}
SEALED = ("result.json", "parameters.json", "manifest.json")


def saved(folder: Path, seed: int, *, log: str, heavier: float = 1.0, **options: Any) -> Path:
    """Save a run whose manifest names a log by a letter; one link may be heavier."""
    theta = arm_theta()
    theta[10:20] *= heavier
    result: Identification = identified(moved(theta, seed), **options)
    intervals = sdpid.confidence_intervals(result.estimate, method="gauss_markov")
    entry = {"role": "log", "name": f"{log}.csv", "bytes": 1, "sha256": log * 64}
    replace(result, intervals=intervals, inputs=(entry,)).save(folder, figures=False)
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["recipe"] = {"processing": PROCESSING}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return folder


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    base = tmp_path_factory.mktemp("runs")
    return {
        "first": saved(base / "first", 1, log="a"),
        "again": saved(base / "again", 1, log="a", prior=BELIEF),
        "other": saved(base / "other", 2, log="b"),
        "heavier": saved(base / "heavier", 2, log="b", heavier=1.2),
    }


def changed(run: Path, target: Path, name: str, change: Any) -> Path:
    """Copy a run and change one of its files."""
    shutil.copytree(run, target, dirs_exist_ok=True)
    content = json.loads((target / name).read_text())
    change(content)
    (target / name).write_text(json.dumps(content))
    return target


def test_a_robot_against_itself_and_against_a_heavier_one(runs: dict[str, Path]) -> None:
    found = compare_runs(runs["first"], runs["other"])
    assert found.same_log is False
    assert len(found.parameters.rows) > 10
    # Of 14 parameters 0.7 are expected outside.
    assert len(found.outside) <= 3
    apart = compare_runs(runs["first"], runs["heavier"])
    assert {"mx2", "my2"} <= set(apart.outside)
    assert "Fv1" not in apart.outside
    last = apart.links.rows[-1]
    assert len(last) == len(apart.links.header)
    assert apart.better is None
    assert "(log) are not the same" in apart.notes[0]
    assert "by chance" in apart.text()


def test_runs_of_one_log_are_judged_by_what_they_held_out(runs: dict[str, Path]) -> None:
    found = compare_runs(runs["first"], runs["again"])
    assert found.same_log is True
    assert found.same_held_out
    held = [
        json.loads((runs[name] / "result.json").read_text())["held_out"]["this estimate"]["moving"]
        for name in ("first", "again")
    ]
    errors = [each["relative_residual"] for each in held]
    assert found.better == str(runs[("first", "again")[errors[1] < errors[0]]])
    assert found.outside == ()
    assert "not independent" in found.text()
    assert ("chosen", "prior", "False", "True") in found.choices.rows
    same = compare_runs(runs["first"], runs["first"])
    assert same.better is None
    assert "predict alike" in same.notes[0]
    assert not same.choices.rows


def one_less(content: dict[str, Any]) -> None:
    content["held_out"]["this estimate"]["moving"]["joints"]["joint_1"]["rows"] -= 1


def test_other_rows_held_out_are_not_compared(runs: dict[str, Path], tmp_path: Path) -> None:
    first, again = runs["first"], runs["again"]

    def said(name: str, change: Any) -> RunComparison:
        found = compare_runs(first, changed(again, tmp_path / "x", name, change))
        assert found.better is None
        assert not found.same_held_out
        return found

    slower = said("manifest.json", lambda c: c["recipe"]["processing"].update(cutoff_hz=5.0))
    assert "processed differently" in slower.notes[0]
    assert ("processing", "cutoff_hz", 10.0, 5.0) in slower.choices.rows
    assert "other rows" in said("result.json", one_less).notes[0]
    assert (
        "different things" in said("result.json", lambda c: c["held_out"].update(blocks=9)).notes[0]
    )
    assert "held nothing" in said("result.json", lambda c: c.update(held_out=None)).notes[0]
    bare = shutil.copytree(first, tmp_path / "bare")
    (bare / "manifest.json").unlink()
    unknown = compare_runs(bare, runs["other"])
    assert unknown.same_log is None
    assert "no manifest" in unknown.text()
    assert unknown.outside == ()


def test_what_is_called_the_same_must_be_the_same(runs: dict[str, Path], tmp_path: Path) -> None:
    def other(content: dict[str, Any]) -> None:
        content["base"]["my2"]["expression"] = "my_2 + 3*mx_2"
        del content["base"]["mx2"]

    found = compare_runs(
        runs["first"], changed(runs["other"], tmp_path / "x", "parameters.json", other)
    )
    names = [row[0] for row in found.parameters.rows]
    assert not {"my2", "mx2"} & set(names)
    assert "Regrouped differently, and not compared: my2." in found.notes
    assert "In the first alone: mx2." in found.notes
    level = changed(
        runs["other"], tmp_path / "x", "parameters.json", lambda c: c.update(interval_level=0.5)
    )
    assert "intervals are of two kinds" in compare_runs(runs["first"], level).text()
    without = changed(
        runs["other"],
        tmp_path / "x",
        "parameters.json",
        lambda c: c.update(interval_method=None, interval_level=None),
    )
    told = "The other has no intervals, and differences of parameters are not tested."
    assert told in compare_runs(runs["first"], without).notes


@pytest.mark.parametrize("name", SEALED)
def test_damaged_files_are_refused_in_words(
    name: str, runs: dict[str, Path], tmp_path: Path
) -> None:
    first = runs["first"]
    broken = shutil.copytree(first, tmp_path / "x")
    intact = (first / name).read_text()
    content = json.loads(intact)
    texts = ["", "[]", "{}", intact[: len(intact) // 2], intact.replace('"', '"\\u202e', 1)]
    for key in content:
        texts += [json.dumps({**content, key: value}) for value in (None, [1], "x", {"y": {}})]
    refused = []
    for text in texts:
        (broken / name).write_text(text)
        try:
            compare_runs(first, broken).text()
        except DataError as error:
            refused.append(str(error))
    assert len(refused) >= 5
    assert all(str(broken) in each for each in refused)


def test_folders_that_are_none(runs: dict[str, Path], tmp_path: Path) -> None:
    refuses(DataError, "is no folder", compare_runs, tmp_path / "no", runs["first"])
    with pytest.raises(DataError, match=r"has no result\.json and no parameters\.json"):
        compare_runs(runs["first"], tmp_path)

    def three(content: dict[str, Any]) -> None:
        content["problem"]["joints"] = list(small_arm(3).joint_names)

    alien = changed(runs["first"], tmp_path / "x", "result.json", three)
    refuses(DataError, "compare runs of one robot", compare_runs, runs["first"], alien)


def test_the_command(runs: dict[str, Path], tmp_path: Path) -> None:
    pair = [str(runs["first"]), str(runs["heavier"])]
    done = CliRunner().invoke(app, ["compare-runs", *pair])
    assert done.exit_code == 0
    assert "base parameters that differ" in done.stdout
    assert " mx2 " in done.stdout
    assert " Fv1 " not in done.stdout
    assert "by chance" in done.stdout
    alike = CliRunner().invoke(app, ["compare-runs", pair[0], str(runs["again"])]).stdout
    assert "that differ" not in alike
    assert "are not tested" in alike
    full = CliRunner().invoke(app, ["compare-runs", *pair, "-v"]).stdout
    for told in ("verdict of the first", " Fv1 ", "least squares", "principal inertias"):
        assert told in full
        assert told not in done.stdout
    data = json.loads(CliRunner().invoke(app, ["compare-runs", *pair, "--json"]).stdout)
    assert data["same_log"] is False
    assert {row["parameter"] for row in data["parameters"]} >= {"mx2", "Fs1"}
    assert CliRunner().invoke(app, ["compare-runs", pair[0], str(tmp_path)]).exit_code == 2
    found = compare_runs(*pair)
    assert repr(found).startswith("RunComparison(same log=False, ")
    assert "<table>" in found._repr_html_()
