"""Damaged files of every kind through the command line: an answer or one line, and whole results.

Longer runs: ``SDPID_FUZZ=1000 pytest -s tests/cli/test_cli_fuzz.py``.
"""

import faulthandler
import os
import shutil
import signal
import warnings
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lxml import etree

from tests.helpers.arm_files import ARM_URDF, arm_log
from tests.helpers.commands import ran, run
from tests.helpers.damage import damaged, misspelt, spoiled
from tests.helpers.logs import write_csv

# Damaged files of each kind.
COUNT = int(os.environ.get("SDPID_FUZZ", "12"))
# Seconds of computing that one of them may take; an honest one takes below one.
PATIENCE = 20
# Every so many logs and descriptions go the whole way.
WHOLE_WAY = 4

MAPPING = """joint_names = ["a", "b"]
period = 4.0
start = 0.0
periods = 2
rate_hz = 50.0
[columns]
position = "enc"
effort = ["i1", "i2"]
velocity = "none"
[units]
position = ["deg", "rad"]
effort = "A"
time = "s"
[motors]
position_matrix = [[32, 0], [1.5, -48]]
offsets = [0.0, 1.0]
torque_constants = [0.1, 0.2]
"""


class TooLong(BaseException):
    """A case that hangs."""


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a sound file of every kind."""
    folder = tmp_path_factory.mktemp("sound")
    (folder / "arm.urdf").write_text(ARM_URDF)
    t, q, tau = arm_log(folder / "arm.urdf")
    table = np.column_stack([t, q, tau])
    np.savetxt(folder / "log.csv", table, delimiter=",", header="t,q1,q2,tau1,tau2", comments="")
    np.savez(folder / "log.npz", t=t, q=q, tau=tau, joint_names=["a", "b"])
    np.savez(folder / "raw.npz", t=t, enc=q, i1=tau[:, 0], i2=tau[:, 1])
    (folder / "map.toml").write_text(MAPPING)
    ran(
        *("identify", folder / "log.csv", "--robot", folder / "arm.urdf", "--no-figures"),
        *("--friction", "coulomb", "--friction", "viscous", "--out", folder / "out"),
    )
    shutil.copy(folder / "out" / "certificate.json", folder)
    shutil.copy(folder / "out" / "base_parameters.csv", folder / "table.csv")
    return folder


@contextmanager
def patience(seconds: int) -> Iterator[None]:
    """Raise when the block computes for longer; where a library does not listen, end the process.

    Processor time, as other work on the machine slows this down.
    """

    def stop(*_: object) -> None:
        raise TooLong

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    faulthandler.dump_traceback_later(30 * seconds, exit=True)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        faulthandler.cancel_dump_traceback_later()
        signal.signal(signal.SIGPROF, before)


def command_of(kind: str, case: int, folder: Path) -> tuple[Any, ...]:
    """Return what is done with a damaged file."""
    file, robot = folder / kind, ("--robot", folder / "arm.urdf")
    out, way = ("--out", folder / "out", "--no-figures"), case % WHOLE_WAY
    if kind == "log.csv":
        return ("info", file, *robot) if way else ("identify", file, *robot, *out)
    if kind == "arm.urdf":
        log = folder / "log.npz"
        ways = [("identify", log, *robot, *out), ("validate", log, *robot)]
        return [*ways, *2 * [("audit", file, "--repair", folder / "repaired.urdf")]][way]
    if kind == "map.toml":
        return ("info", folder / "raw.npz", "--mapping", file)
    return ("verify", file) if kind == "certificate.json" else ("audit", file, *robot)


# Logs of other formats are damaged in tests/experiment/test_formats.py.
KINDS = ("log.csv", "arm.urdf", "map.toml", "certificate.json", "table.csv")


def end_well(folder: Path, made: Callable[[int, Path], tuple[Any, ...]]) -> None:
    """Run the commands that are made for so many cases, each in a folder of its own."""
    wrong = []
    for case in range(COUNT):
        (own := folder / f"case {case}").mkdir()
        command = made(case, own)
        with warnings.catch_warnings():
            # What libraries warn of in a damaged file is not ours.
            warnings.simplefilter("ignore")
            try:
                with patience(PATIENCE):
                    problem = complaint(run(*command), own)
            except TooLong:
                problem = f"took more than {PATIENCE} s"
        if problem:
            wrong.append(f"{own}, {command[0]}: {problem}")
    assert wrong == []


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_end_well(kind: str, sound: Path, tmp_path: Path) -> None:
    content = (sound / kind).read_bytes()
    rng = np.random.default_rng([COUNT, *kind.encode()])
    status = run(*command_of(kind, 0, sound)).exit_code
    assert status == 0 or (kind, status) == ("table.csv", 3)

    def made(case: int, folder: Path) -> tuple[Any, ...]:
        for name in ("arm.urdf", "log.npz", "raw.npz"):
            shutil.copy(sound / name, folder)
        broken = damaged(content, rng, True) if rng.random() < 0.4 else misspelt(content, rng)
        (folder / kind).write_bytes(broken)
        return command_of(kind, case, folder)

    end_well(tmp_path, made)


@pytest.mark.parametrize(
    ("kind", "old", "new", "words"),
    [
        ("log.csv", "tau2\n", "tau2\n-1,0,0,0,1e300\n", "line 2: effort: 'tau2' is 1e+300"),
        ("log.csv", "tau2\n", "tau2\n1e\x1c0,0,0,0,0\n", "no line of column names"),
        ("map.toml", "4.0", "9" * 5000, "map.toml: not a TOML file"),
        ("map.toml", "4.0", "[" * 5000, "map.toml: not a TOML file"),
        ("map.toml", "4.0", "1e308", "period: is 1e+308"),
        ("map.toml", "-48", "9" * 400, "motors.position_matrix"),
        ("arm.urdf", 'iyz="0"', 'iyz="-1e308"', "link 'upper': iyz of <inertia> is '-1e308'"),
        ("arm.urdf", '<mass value="3.0"', '<mass value="nan"', "link 'upper': value of <mass>"),
        ("arm.urdf", 'ixx="0.02"', "", "link 'upper': ixx of <inertia> is missing"),
        ("arm.urdf", '<mass value="3.0"/>', "", "link 'upper': its <inertial> has no <mass>"),
        ("arm.urdf", 'xyz="0.1 0 0.02"', 'xyz="0.1 0"', "xyz of <origin> is '0.1 0'"),
        ("arm.urdf", "two", "two -- ", "Double hyphen"),
        ("arm.urdf", "two", "two \x00", "Invalid character"),
        ("table.csv", "value\n", "value\nzz2,9e999999999\n", "more than 12 digits before"),
        ("table.csv", "value\n", "value\nzz2,9e-999999999\n", "400 after it"),
        ("table.csv", "value\n", "value\nzz2,0e-999999999\n", "400 after it"),
        ("table.csv", "zz1", "z" * 200_000, "line 1: is no CSV (field larger"),
        ("log.csv", "q1", "q" * 200_000, "has no header"),
        ("log.csv", "q1", "q1" + "[" * 2_000_000, "no line of column names"),
    ],
)
def test_what_longer_runs_found(
    kind: str, old: str, new: str, words: str, sound: Path, tmp_path: Path
) -> None:
    for name in ("arm.urdf", "log.npz", "raw.npz", kind):
        shutil.copy(sound / name, tmp_path)
    text = "name,value\nzz1,0.4\n" if kind == "table.csv" else (sound / kind).read_text()
    assert old in text
    (tmp_path / kind).write_text(text.replace(old, new, 1))
    with patience(PATIENCE):
        done = run(*command_of(kind, 0, tmp_path))
    assert complaint(done, tmp_path) is None
    assert done.exit_code == 2
    assert words in done.stderr


def test_a_damaged_header_of_an_array(sound: Path, tmp_path: Path) -> None:
    (tmp_path / "x.npy").write_bytes(b"\x93NUMPY\x01\x00\x08\x00{'a': (\n")
    with zipfile.ZipFile(tmp_path / "log.npz", "w") as archive:
        for name in ("t", "q", "tau"):
            archive.write(tmp_path / "x.npy", f"{name}.npy")
    done = run("info", tmp_path / "log.npz")
    assert done.exit_code == 2
    assert "is damaged" in done.stderr


ONE_JOINT = ARM_URDF.replace('name="b" type="continuous"', 'name="b" type="fixed"')


def written(channels: dict[str, np.ndarray], path: Path) -> None:
    """Write a log; a table of columns where they are of one length."""
    if path.suffix == ".npz":
        np.savez(path, **channels)
        return
    rows = min(len(each) for each in channels.values())
    columns = {name: each[:rows].reshape(rows, -1) for name, each in channels.items()}
    names = [f"{name}{j}" for name, each in columns.items() for j in range(each.shape[1])]
    write_csv(path, [name.replace("t0", "t") for name in names], *columns.values())


@pytest.mark.parametrize("joints", [1, 2])
@pytest.mark.parametrize("suffix", ["csv", "npz"])
def test_logs_that_sensors_spoil_end_well(joints: int, suffix: str, tmp_path: Path) -> None:
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(ARM_URDF)
    t, q, tau = (each[..., :joints] for each in arm_log(urdf))
    urdf.write_text(ONE_JOINT if joints == 1 else ARM_URDF)
    t = np.arange(len(q)) / 50.0
    channels = {"t": t, "q": q, "dq": np.gradient(q, t, axis=0), "tau": tau}
    rng = np.random.default_rng([COUNT, joints, *suffix.encode()])

    def made(case: int, folder: Path) -> tuple[Any, ...]:
        log, whole_way = folder / f"log.{suffix}", case % WHOLE_WAY == 0
        written(spoiled(channels, rng), log)
        out = ("--out", folder / "out", "--no-figures") if whole_way else ()
        return ("identify" if whole_way else "info", log, "--robot", urdf, *out)

    end_well(tmp_path, made)


@pytest.mark.parametrize("kind", ["motion.toml", "arm.xml"])
def test_motions_and_mjcf_of_wrong_numbers_end_well(kind: str, sound: Path, tmp_path: Path) -> None:
    if kind == "arm.xml":
        pytest.importorskip("mujoco")
        content = (sound / "out" / "identified.xml").read_bytes()
    else:
        motion, drawn = tmp_path / kind, ("--seed", "0", "--period", "8", "--periods", "1")
        out = ("--out", tmp_path / "run.csv", "--write-trajectory", motion)
        ran("simulate", sound / "arm.urdf", *drawn, *out)
        content = motion.read_bytes()
    rng = np.random.default_rng([COUNT, *kind.encode()])

    def made(case: int, folder: Path) -> tuple[Any, ...]:
        (file := folder / kind).write_bytes(misspelt(content, rng))
        if kind == "motion.toml":
            out = ("--out", folder / "run.csv")
            return ("simulate", sound / "arm.urdf", *out, "--trajectory", file)
        return ("info", sound / "log.npz", "--robot", file) if case % 2 else ("audit", file)

    end_well(tmp_path, made)


def complaint(done: Any, folder: Path) -> str | None:
    """Say what is wrong with how a damaged file ended."""
    stderr = done.stderr
    if done.exit_code == 1 and "not hold" in stderr:
        return None
    if done.exit_code not in (0, 2, 3):
        return f"exit status {done.exit_code}: {stderr[:600]} {done.exception!r}"
    if "Traceback" in done.output or "unexpected" in stderr:
        return stderr[-600:]
    quiet = done.exit_code == 0 or (done.exit_code == 3 and done.stdout)
    if not quiet and (not stderr.startswith("sdpid: ") or len(stderr.splitlines()) != 1):
        return f"message is {stderr[:600]!r}"
    out = folder / "out"
    if out.exists() and (
        done.exit_code != 0 or not {p.name for p in out.iterdir()} >= {"report.html", "result.json"}
    ):
        return f"exit status {done.exit_code}, with {sorted(p.name for p in out.iterdir())}"
    repaired = folder / "repaired.urdf"
    if repaired.exists():
        etree.parse(repaired)
    hidden = [p.name for p in (*folder.iterdir(), *(out.iterdir() if out.exists() else ()))]
    left = [name for name in hidden if name.startswith(".")]
    return f"left {left}" if left else None
