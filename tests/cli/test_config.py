"""Options in a file: what is given there counts, what a run writes repeats it."""

import json
import os
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from sdpid._common.files import load_toml
from sdpid.assurance.intervals.intervals import Method
from sdpid.cli.commands import TABLES
from sdpid.cli.endings import message
from sdpid.cli.logs import ESTIMATION, PROCESSING, formulation, processing
from sdpid.constraints import MirrorPair, TotalMass
from sdpid.errors import DataError
from sdpid.estimation.compression.covariance import Weighting
from sdpid.estimation.effects.kinds import EFFECTS
from sdpid.robot.inertia import Consistency
from tests.helpers.arm_files import write_arm
from tests.helpers.commands import given, python, ran, refused, run, told
from tests.helpers.legged import quadruped
from tests.helpers.refusals import refuses


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with a robot and two logs; one has other names, in degrees."""
    t, q, tau = write_arm(tmp_path)
    np.savez(tmp_path / "raw.npz", t=t, enc=np.degrees(q), i1=tau[:, 0], i2=tau[:, 1])
    return tmp_path


CONFIG = """
log = ["logs/raw.npz"]
robot = "arm.urdf"
out = "results"
cutoff = 6
prior = false
intervals = false
friction = ["coulomb=0.05", "viscous"]
effort-scale = [1.0, 1]
unit = { position = "deg" }
[column]
position = "enc"
effort = ["i1", "i2"]
"""


def test_a_run_from_a_file_is_that_of_the_options(folder: Path) -> None:
    """From another folder: files are named relative to that of the configuration."""
    (folder / "logs").mkdir()
    (folder / "raw.npz").rename(folder / "logs" / "raw.npz")
    (folder / "my.toml").write_text(CONFIG)
    done = ran("identify", "--config", folder / "my.toml", "--no-figures", "--json")
    inputs = json.loads((folder / "results" / "manifest.json").read_text())["inputs"]
    assert [each["name"] for each in inputs if each["role"] == "config"] == ["my.toml"]
    options = ("--cutoff", 6, "--no-prior", "--friction", "coulomb=0.05", "--friction", "viscous")
    reading = ("--unit", "position=deg", "--column", "position=enc", "--column", "effort=i1,i2")
    ran(
        *("identify", folder / "logs" / "raw.npz", "--robot", folder / "arm.urdf", *options),
        *(*reading, "--effort-scale", "1,1", "--out", folder / "typed", "--no-intervals"),
        *("--no-figures", "--json"),
    )
    assert same(folder / "results", folder / "typed")
    assert json.loads(done.stdout)["intervals"] is None


def same(one: Path, other: Path) -> bool:
    """Return whether two runs found the same."""
    found = [json.loads((path / "result.json").read_text()) for path in (one, other)]
    return {**found[0], "solve_time": 0} == {**found[1], "solve_time": 0}


def test_the_written_file_repeats_the_run(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    done = ran(
        *("identify", "log.npz", "--robot", "arm.urdf", "--out", "deep/out", "--no-figures"),
        *("--validation", "log.npz", "--order", 3, "--friction", "viscous", "--no-prior"),
        *("--friction", "coulomb", "--margin", 1e-4, "--folds", 2, "-q"),
    )
    assert done.output == ""
    written = load_toml("deep/out/run.toml")
    assert written["log"] == ["../../log.npz"]
    assert written["out"] == "."
    assert written["friction"] == ["viscous", "coulomb"]
    assert written["margin"] == 1e-4
    assert written["prior"] is False
    assert "cutoff" not in written
    assert not {"json", "quiet", "config", "help"} & set(written)
    before = (folder / "deep/out/run.toml").read_bytes()
    (folder / "deep/out/manifest.json").rename(folder / "first.json")
    monkeypatch.chdir("/")
    # Without the list of files it is not known who wrote the configuration: it is not replaced.
    again = ("identify", "--config", folder / "deep/out/run.toml")
    refused(run(*again), 2, "run.toml, which this run reads")
    (folder / "first.json").rename(folder / "deep/out/manifest.json")
    ran(*again, "--out", folder / "second")
    assert same(folder / "deep/out", folder / "second")
    # The configuration of an earlier run may be replaced, and is the same after that.
    ran(*again)
    assert (folder / "deep/out/run.toml").read_bytes() == before


def test_the_command_line_wins(folder: Path) -> None:
    config = ("--config", folder / "run.toml")
    refused(run("info", folder / "log.npz", *config), 2, f"sdpid: cannot read {config[1]}")
    config[1].write_text('log = "nowhere.npz"\nrobot = "arm.urdf"\n')
    assert told("info", folder / "log.npz", *config)["samples"] == 400
    refused(run("info", *config), 2, f"{folder / 'nowhere.npz'}")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("cutof = 3", "'cutof' is no option of 'sdpid identify'; there is cutoff"),
        ("zzz = 3", "there is accept, bare, column"),
        ("config = 'x'", "'config' is no option"),
        ("prior = 'yes'", "prior: is 'yes'; give true or false"),
        ("cutoff = true", "cutoff: is True; give text or a number"),
        ("friction = [['a'], 2026-01-01]", "is datetime.date(2026, 1, 1)"),
        ("cutoff = 'ten'", "--cutoff"),
        ("order = 2.5", "--order"),
        ("weighting = 'best'", "--weighting"),
        ("cutoff = ", "not a TOML file"),
        ("[reading]\nlog = 1", "'reading' is no option"),
    ],
)
def test_files_that_are_refused(folder: Path, text: str, words: str) -> None:
    (folder / "my.toml").write_text(text)
    arguments = (folder / "log.npz", "--robot", folder / "arm.urdf", "--out", folder / "out")
    done = run("identify", *arguments, "--config", folder / "my.toml")
    assert done.exit_code == 2
    assert words in done.stderr
    assert "Traceback" not in done.output
    assert not (folder / "out").exists()


@pytest.mark.parametrize("command", TABLES)
def test_the_help_names_every_option_whole(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also on a narrow terminal; and the key in a file is the option's name."""
    monkeypatch.setenv("COLUMNS", "80")
    shown = ran(command.replace("_", "-"), "--help").stdout
    assert "…" not in shown
    keys = [row.key for row in TABLES[command] if row.flags]
    assert {"config", "json", "quiet"} <= {*keys}
    assert [key for key in keys if f"--{key.replace('_', '-')} " not in shown] == []


def test_quiet_prints_errors_only(folder: Path) -> None:
    arguments = ("validate", folder / "log.npz", "--robot", folder / "arm.urdf", "-q")
    assert ran(*arguments).output == ""
    done = run(*arguments, "--order", "99")
    refused(done, 2, "sdpid: order: is 99")
    assert done.stdout == ""


def completed(words: str) -> list[str]:
    """Return what the shell offers for the last word."""
    given = {"COMP_WORDS": words, "COMP_CWORD": str(len(words.split(" ")) - 1)}
    environment = {**os.environ, **given, "_SDPID_COMPLETE": "complete_bash"}
    return python("-m", "sdpid", env=environment).stdout.split()


def test_the_shell_completes() -> None:
    for words, offered in (
        ("sdpid id", ["identify"]),
        ("sdpid identify --robot den", ["denso_vp6242"]),
        ("sdpid identify --weighting eq", ["eq9", "eq18"]),
        ("sdpid identify --friction str", ["stribeck"]),
        # No robot begins so: the shell offers files.
        ("sdpid identify --robot ./", []),
    ):
        assert completed(words) == offered
    assert any("ur5" in name for name in completed("sdpid identify --robot ur"))


def test_options_offer_what_the_library_knows() -> None:
    rows = {row.name: row for row in TABLES["identify"]}
    known = {"weighting": Weighting, "consistency": Consistency, "interval_method": Method}
    for name, values in known.items():
        assert {each.value for each in rows[name].kind.type} == set(get_args(values))
    assert [each.name for each in EFFECTS if each.name not in rows["effects"].help] == []


def test_a_file_of_another_that_is_called_run_toml_stays(folder: Path) -> None:
    """Such as the mapping of a log run.csv that this run does not read."""
    (folder / "run.toml").write_text("[columns]\n")
    done = run("identify", folder / "log.npz", "--robot", folder / "arm.urdf", "--out", folder)
    refused(done, 2, "run.toml, which no run like this wrote")
    assert (folder / "run.toml").read_text() == "[columns]\n"


# ---- What options of the command line become.


@pytest.mark.parametrize(
    ("chosen", "expected"),
    [
        ({}, {}),
        ({"mask": True}, {}),
        ({"mask": False}, {"reversal_time": None}),
        ({"mask_speed": 0.05, "mask_time": 0.0}, {"reversal_speed": 0.05, "reversal_time": 0.0}),
        ({"cutoff": 8.0, "filter_friction": False}, {"cutoff_hz": 8.0, "filter_friction": False}),
    ],
)
def test_the_processing(chosen: dict[str, Any], expected: dict[str, Any]) -> None:
    assert processing(given(PROCESSING, **chosen)) == expected
    off = given(PROCESSING, mask=False, mask_speed=0.1)
    refuses(DataError, "mask-speed", processing, off)


@pytest.mark.parametrize(
    ("text", "end"),
    [
        ("accept=['a'] (--accept a) overrules it.", "overrules it."),
        ("give units={}.", "--unit QUANTITY=UNIT."),
        ("give units={} (--unit time=ms).", "time=ms)."),
    ],
)
def test_a_message_that_gives_the_option_needs_no_hint(text: str, end: str) -> None:
    assert message(DataError(text)).endswith(end)


def formulated(**options: Any) -> dict[str, Any]:
    return formulation(given(ESTIMATION, **options), quadruped())


def test_a_weighed_robot_with_legs_that_are_alike() -> None:
    mass, *pairs = formulated(total_mass="2.5, 0.01", mirror=True)["constraints"].others
    assert isinstance(mass, TotalMass)
    assert (mass.mass, mass.tolerance) == (2.5, 0.01)
    assert [type(pair) for pair in pairs] == 6 * [MirrorPair]
    assert formulated()["constraints"].others == ()
    nearly = formulated(mirror_within="5%", mirror_friction="0.2")
    assert (len(nearly["prior"].alike), nearly["prior"].within) == (6, 0.05)
    drives = nearly["constraints"].others
    assert [(type(each).__name__, each.within) for each in drives] == 6 * [("EqualFriction", 0.2)]
    for wrong, text in (
        ({"total_mass": "2.5,0.1,0.2"}, "expected a mass in kg, or a mass and by how much"),
        ({"mirror_within": "5", "mirror": True}, "beside --mirror it says nothing"),
        ({"mirror_within": "5%", "prior": False}, "beside --no-prior it says nothing"),
        ({"mirror_within": "0%"}, "have --mirror"),
        ({"mirror_within": "much"}, "expected a share such as 5% or 0.05"),
        ({"mirror_friction": "-1%"}, "--mirror-friction -1%: expected a share"),
    ):
        refuses(DataError, text, formulated, **wrong)
