"""A results folder, checked by what lies in it: its seal, its proof, and the numbers beside it."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import sdpid
from sdpid.verifier.command import check_path
from sdpid.verifier.manifest import sealed
from sdpid.verifier.reading import MalformedError
from sdpid.verifier.result import Result
from tests.helpers import world
from tests.helpers.commands import VERIFIER, alone
from tests.helpers.forged import reseal
from tests.helpers.refusals import refuses


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return world.folder(tmp_path_factory.mktemp("runs")) / "results"


@pytest.fixture
def copy(folder: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(folder, tmp_path / "copy"))


def verified(path: Path) -> Result:
    """Return what the stand-alone checker says."""
    return check_path(path).result


@pytest.mark.parametrize("sizes", [{"report.html": 2**29}, {"report.html": 2**28, "b": 2**28}])
def test_files_of_any_size_are_not_hashed(copy: Path, sizes: dict[str, int]) -> None:
    data = json.loads((copy / "manifest.json").read_text())
    for name, size in sizes.items():
        with (copy / name).open("wb") as file:
            file.truncate(size)
        data["files"][name] = {"bytes": size, "sha256": "0" * 64}
    del data["sha256"]
    (copy / "manifest.json").write_text(json.dumps(sealed(data)))
    refuses(MalformedError, r"bytes, and less than|not an integer from 0", verified, copy)


def test_what_was_written_holds(folder: Path) -> None:
    found = sdpid.verify(folder)
    assert found.passed
    assert found.verdict == "PROVEN, but for what was not checked."
    assert found.sha256 == json.loads((folder / "manifest.json").read_text())["sha256"]
    assert found.cost == json.loads((folder / "result.json").read_text())["cost_at_most"]
    files = "result.json, parameters.json, parameters.csv, base_parameters.csv"
    assert f"{files}: the numbers are the certificate's, to the last digit" in found.statements
    # What follows from the log is not called proven, and is told.
    assert found.made_again == ()
    for words in ("the log", "a digest is no signature", "'identified.urdf', 'identified.xml'"):
        assert any(words in said for said in found.unchecked)
    assert any("compared with nothing here" in said for said in verified(folder).unchecked)


def test_the_copied_checker_says_the_same(folder: Path, tmp_path: Path) -> None:
    """With the standard library alone, wherever it lies and whatever it is called."""
    there = tmp_path / "checker-1"
    shutil.copytree(VERIFIER, there, ignore=shutil.ignore_patterns("*.pyc"))
    done = alone(folder, there, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == list(verified(folder).lines)


@given(data=st.data())
@settings(max_examples=40, deadline=None)
def test_any_digit_of_any_file(folder: Path, tmp_path_factory: Any, data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(sorted(path.name for path in folder.iterdir())))
    text = (folder / name).read_bytes()
    # The name of the software, at the manifest's head, is not sealed.
    start = text.index(b"inputs") if name == "manifest.json" else 0
    digits = [m.start() for m in re.finditer(rb"\d", text) if m.start() > start]
    assume(digits)
    at = data.draw(st.sampled_from(digits))
    new = data.draw(st.sampled_from(sorted({*b"0123456789"} - {text[at]})))
    path = Path(shutil.copytree(folder, tmp_path_factory.mktemp("digit") / "copy"))
    (path / name).write_bytes(text[:at] + bytes([new]) + text[at + 1 :])
    try:
        problems = verified(path).problems
    except (MalformedError, json.JSONDecodeError):  # no JSON has numbers such as 02
        assert name in ("manifest.json", "certificate.json")
        return
    assert any(name in problem for problem in problems)


@pytest.mark.parametrize("name", ["identified.urdf", "parameters.csv", "report.html"])
def test_a_file_that_is_gone(copy: Path, name: str) -> None:
    (copy / name).unlink()
    assert any(f"'{name}' is missing" in problem for problem in verified(copy).problems)
    reseal(copy)
    problems = sdpid.verify(copy).problems
    # Of a robot and of tables it is known that they were written.
    assert any("and not sealed" in each for each in problems) == (name != "report.html")


def test_files_of_others_are_told(copy: Path) -> None:
    (copy / "notes\x1b[2J.txt").write_text("mine")
    result = verified(copy)
    assert result.passed
    assert any("'notes\\x1b[2J.txt': not of this run" in said for said in result.unchecked)


def test_a_certificate_that_does_not_hold(copy: Path) -> None:
    data = json.loads((copy / "certificate.json").read_text())
    data["claims"]["lower_bound"] = data["claims"]["cost"]
    (copy / "certificate.json").write_text(json.dumps(data))
    reseal(copy)
    problems = verified(copy).problems
    assert any(problem.startswith("certificate.json: ") for problem in problems)
    assert any("it says 'certified'" in problem for problem in sdpid.verify(copy).problems)


NO_FILES = ("../x", "../run.csv", "/etc/passwd", "a\\b", "", ".", "manifest.json")


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data.update(version=1.0),
        lambda data: data.update(version=True),
        lambda data: data.update(more=1),
        lambda data: data.pop("inputs"),
        *(
            lambda data, name=name: data["files"].update({name: {"bytes": 0, "sha256": "0" * 64}})
            for name in NO_FILES
        ),
        lambda data: data["files"].update({"x": {"bytes": -1, "sha256": "0" * 64}}),
        lambda data: data["files"].update({"x": {"bytes": 0, "sha256": "0" * 63}}),
        lambda data: data["files"].pop("certificate.json"),
        lambda data: data["inputs"].append({}),
        lambda data: data["inputs"][0].update(role="friend"),
        lambda data: data.update(recipe=1),
        lambda data: data.update(certificate=1),
    ],
)
def test_a_manifest_that_is_none(copy: Path, change: Callable[[Any], Any]) -> None:
    data = json.loads((copy / "manifest.json").read_text())
    change(data)
    (copy / "manifest.json").write_text(json.dumps(data))
    with pytest.raises(MalformedError):
        verified(copy)


def test_a_folder_without_a_manifest(tmp_path: Path) -> None:
    refuses(sdpid.errors.CertificateError, r"no manifest\.json", sdpid.verify, tmp_path)
