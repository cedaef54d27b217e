"""Identified robots: proven, loaded by name, in agreement with their pages, and without records."""

import csv
import importlib.util
import json
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import sdpid
from sdpid import verifier
from sdpid.robot.description.catalog import identified_robots, models_folder
from sdpid.workflow.result import NAMES

ROBOTS = identified_robots()
# Links and drives are fitted to positions, and parameters.json is of the start.
OF_LAW = {"go2_identified"}
DATA = Path(os.environ.get("SDPID_DATA", "/nowhere"))
# Of one robot, together compressed.
MOST_BYTES = 150_000


def script() -> Any:
    spec = importlib.util.spec_from_file_location("make", models_folder() / "make.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


MAKE = script()


def short(name: str) -> str:
    return name.removesuffix("_identified")


@pytest.mark.parametrize("name", ROBOTS)
def test_the_bare_verifier_proves_it(name: str) -> None:
    bare = [sys.executable, "-I", "-S", str(Path(verifier.__file__).parent), str(ROBOTS[name])]
    found = subprocess.run(bare, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stdout + found.stderr
    assert "PROVEN" in found.stdout.splitlines()[-1]


@pytest.mark.parametrize("name", ROBOTS)
def test_tables_and_result_are_the_certificates(name: str) -> None:
    verification = sdpid.verify(short(name))
    assert verification.passed, verification.problems
    assert verification.gap is not None
    assert verification.gap < 1e-6


@pytest.mark.parametrize("name", ROBOTS)
def test_the_robot_has_the_parameters(name: str) -> None:
    robot, saved = sdpid.load_robot(name), sdpid.load(short(name))
    values = [each.value for each in saved.standard.values()]
    assert robot.joint_names == tuple(saved.result["problem"]["joints"])
    mjcf = sdpid.load_robot(ROBOTS[name] / "identified.xml")
    np.testing.assert_allclose(robot.prior, mjcf.prior, atol=1e-12)
    if name in OF_LAW:
        with (ROBOTS[name] / "drives.csv").open() as file:
            drives = {row["joint"]: float(row["armature [kg.m2]"]) for row in csv.DictReader(file)}
        joints = ElementTree.parse(ROBOTS[name] / "identified.xml").iter("joint")
        written = {j.get("name"): float(j.get("armature", 0.0)) for j in joints if j.get("name")}
        assert {joint: written[joint] for joint in drives} == pytest.approx(drives, abs=1e-9)
        with pytest.raises(sdpid.errors.DataError, match="load_robot reads the links"):
            saved.model()
        return
    np.testing.assert_allclose(robot.prior.ravel(), values[: robot.prior.size], atol=1e-9)
    model, q = saved.model(), np.zeros(robot.n)
    np.testing.assert_allclose(model.theta, values)
    assert np.linalg.eigvalsh(model.mass_matrix(q)).min() > 0.0


@pytest.mark.parametrize("name", ROBOTS)
def test_no_record_and_no_path_is_in_it(name: str, tmp_path: Path) -> None:
    # Python keeps what it compiled of the friction code beside it.
    files = [path for path in ROBOTS[name].iterdir() if path.name != "__pycache__"]
    assert {file.name for file in files} <= {*NAMES, "README.md", MAKE.HELD_OUT}
    text = "".join(file.read_text(encoding="utf-8") for file in files)
    assert not re.findall(r"(?<![\w<.:/*)])/\w[\w.-]*/[\w./-]*", text)
    assert "mesh" not in (ROBOTS[name] / "identified.xml").read_text(encoding="utf-8")
    with zipfile.ZipFile(tmp_path / "all.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for file in files:
            archive.write(file, file.name)
    assert (tmp_path / "all.zip").stat().st_size < MOST_BYTES


def test_pages_say_what_the_files_say() -> None:
    rows = MAKE.recipes()
    assert {short(name) for name in ROBOTS} == {n for n, row in rows.items() if "alone" not in row}
    for name, row in rows.items():
        file = models_folder() / name / ("" if "alone" in row else "identified") / "README.md"
        assert file.read_text(encoding="utf-8") == MAKE.page(name, row)
    assert (models_folder() / "README.md").read_text(encoding="utf-8") == MAKE.listing()


def test_names_are_told_where_there_is_none() -> None:
    with pytest.raises(sdpid.errors.DataError, match="panda_identified"):
        sdpid.load("nobody")
    with pytest.raises(sdpid.errors.CertificateError, match=r"nobody: No such .*panda_identified"):
        sdpid.verify("nobody")


@pytest.mark.parametrize("name", sorted(ROBOTS.keys() - OF_LAW))
def test_what_follows_from_the_records_is_made_again(name: str) -> None:
    row = MAKE.recipes()[short(name)]
    logs = [DATA / log for log in row["logs"]]
    if not all(log.exists() for log in logs):
        pytest.skip("needs the public records in SDPID_DATA")
    verification = sdpid.verify(short(name), data=logs, robot=DATA / row["robot"])
    assert verification.passed, verification.problems
    manifest = json.loads((ROBOTS[name] / "manifest.json").read_text())
    assert {each["name"] for each in manifest["inputs"]} >= {log.name for log in logs}
