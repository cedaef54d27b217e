"""The command: what it prints, what it writes, and how it ends."""

import hashlib
import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid.cli import commands, endings, values
from sdpid.experiment.plant.simulate import true_parameters
from sdpid.robot.friction.terms import BY_NAME
from sdpid.workflow.result import NAMES
from tests.helpers.arm_files import ARM_URDF, write_arm
from tests.helpers.bags import write_bag
from tests.helpers.commands import printed, python, ran, refused, run, told
from tests.helpers.logs import numbered, write_csv

ROBOT = "denso_vp6242"


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory, denso: sdpid.RobotModel) -> Path:
    """Return the file of a small simulated experiment."""
    path = tmp_path_factory.mktemp("log") / "run.parquet"
    trajectory = sdpid.paper_excitation(ROBOT, 5, periods=2, period=20.0)
    sdpid.simulate(denso, trajectory, theta=true_parameters(ROBOT), seed=5).to_parquet(path)
    return path


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory, log: Path) -> Path:
    """Return the folder that `sdpid identify -v` filled; what it printed is beside it."""
    out = tmp_path_factory.mktemp("identified") / "out"
    done = ran("identify", log, "--robot", ROBOT, "--out", out, "--no-figures", "-v")
    (out.parent / "told.txt").write_text(done.stdout, encoding="utf-8")
    return out


def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys\nfrom sdpid.cli import app\n"
        "try: app(['--help'])\nexcept SystemExit as end: assert end.code == 0\n"
        "print(sorted({m.split('.')[0] for m in sys.modules} & {'numpy', 'scipy', 'pinocchio', "
        "'mujoco', 'cvxpy', 'matplotlib', 'pyarrow', 'pandas'}))"
    )
    done = python("-c", code)
    assert done.stdout.splitlines()[-1] == "[]", done.stderr
    for command in ("identify", "compare", "simulate", "verify", "validate", "info"):
        assert command in done.stdout
    assert python("-m", "sdpid", "--version").stdout.strip() == sdpid.__version__


def test_help_names_every_friction_term() -> None:
    told = ran("identify", "--help").stdout
    assert [name for name in BY_NAME if name not in told] == []


def test_identify_prints_and_writes(results: Path, log: Path) -> None:
    others = ("drives", "elasticity", "identified_elastic")
    written = {name for name in NAMES if not name.startswith(others)}
    assert {path.name for path in results.iterdir()} == written - {
        "training.png",
        "validation.png",
    }
    page = (results / "report.html").read_text(encoding="utf-8")
    assert f"sdpid identify {log} --robot {ROBOT} --out {results} --no-figures" in page
    assert sdpid.load_robot(results / "identified.urdf").n == 6
    details = (results.parent / "told.txt").read_text(encoding="utf-8")
    for text in (
        *("relative residual", "joint_6", "NRMSE", "zero-phase", "notes:", "files:", "verdict:"),
        *("5 blocks, held out, in motion", "least squares", "held out RMSE"),
        "\n\ncertificate: feas",
    ):
        assert text in details
    out = results / "again"
    done = ran(*("identify", log, "--robot", ROBOT, "--out", out, "--validation", log, "--figures"))
    assert done.stderr == ""
    # The verdict in lines with their labels; those with nothing to say are absent.
    first, *lines = done.stdout.splitlines()
    assert first.startswith(f"{ROBOT}: 6 joints, ")
    assert first.endswith(" s fitted, another recording predicted")
    labels = [line[:14].strip() for line in lines[:4]]
    assert labels == ["missed effort", "worst joint", "proven", "next"]
    assert "no physically possible robot of this model fits better (gap " in done.stdout
    assert str(out) in done.stdout
    assert "NRMSE" not in done.stdout
    assert len(lines) < 15
    assert (out / "training.png").is_file()
    assert (out / "validation.png").is_file()


def test_identify_as_json(log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    found = told(
        *("identify", log, "--robot", ROBOT, "--no-figures"),
        *("--margin", "0.001", "--mass-max", "60", "--cutoff", "12", "--order", "1"),
        *("--consistency", "spatial_inertia", "--friction", "coulomb=0.01"),
        *("--friction", "viscous", "--friction", "coupling=joint_5,joint_6"),
    )
    assert found["certified"] is True
    assert found["problem"]["consistency"] == "spatial_inertia"
    assert found["worst_margin"] >= 0.001 - 1e-9
    assert "Fs5_6" in found["standard_parameters"]
    for words in ("order 1 at 12 Hz", "no place in a URDF"):
        assert any(words in note for note in found["notes"])
    assert found["exports"][0]["left_out"][0]["term"] == "Coupling"
    # Without --out there is a folder of its own.
    assert all((tmp_path / file).is_file() for file in found["files"])
    assert [path.name for path in tmp_path.iterdir()] == ["sdpid-results"]


def test_friction_options() -> None:
    from sdpid.robot.friction.terms import AsymmetricCoulomb, Coulomb, Coupling, Stribeck

    texts = ["coulomb=fit", "stribeck=0.2", "stribeck=fit", "asymmetric_coulomb=0.1"]
    assert values.friction_terms([*texts, "sigmoid", "coupling=a,b"]) == [
        *(Coulomb(width=None), Stribeck(0.2), Stribeck(), AsymmetricCoulomb(width=0.1)),
        *("sigmoid", Coupling("a", "b")),
    ]
    assert values.friction_terms(["+stribeck=0.2", "+load"]) == ["default", Stribeck(0.2), "load"]


def test_terms_with_chosen_speeds(log: Path, tmp_path: Path) -> None:
    problem = told(
        *("identify", log, "--robot", ROBOT, "--no-figures", "--out", tmp_path / "x"),
        *("--friction", "coulomb=fit", "--friction", "viscous", "--friction", "square_root"),
        *("--friction", "stribeck"),
    )["problem"]
    terms = [term["term"] for term in problem["friction_terms"]]
    assert terms == ["Coulomb", "Viscous", "SquareRootFriction", "Stribeck"]
    assert len(problem["profiled"]) == 12
    assert "friction" in (tmp_path / "x" / "identified.urdf").read_text(encoding="utf-8")


def test_simulate_then_info(tmp_path: Path) -> None:
    path = tmp_path / "run.parquet"
    done = ran("simulate", ROBOT, "--out", path, "--periods", 1, "--period", 10, "--seed", 2)
    assert "peak velocity" in done.stdout
    record = sdpid.read_recording(path)
    assert (record.period, record.periods) == (10.0, 1)
    shown = printed("info", path, "--robot", ROBOT)
    assert "cutoff hz 15, order 2" in shown
    # The robot's description has no masses, which is all that there is to say.
    (said,) = shown.split("findings:\n")[1].splitlines()
    assert said.startswith("  note effort_not_compared: efforts are not compared with the motion")
    # What there is nothing to say of is not shown.
    assert not any(line.endswith("  -") for line in shown.partition("read from")[0].split("\n"))
    facts = told("info", path)
    assert facts["rate_hz"] == pytest.approx(1000.0)
    expected = {"samples": record.n_samples, "periods": 1, "lost_samples": 0, "velocity": None}
    assert {key: facts[key] for key in expected} == expected
    assert [joint["joint"] for joint in facts["joints"]] == list(record.names)


def test_simulate_any_robot_with_a_trajectory_file(tmp_path: Path) -> None:
    first, second, motion = (tmp_path / name for name in ("a.parquet", "b.csv", "m.toml"))
    options = ("--period", 8, "--periods", 1, "--seed", 4)
    ran("simulate", "ur5_robot", "--out", first, "--write-trajectory", motion, *options)
    again = ran("simulate", "ur5_robot", "--out", second, "--trajectory", motion, "--seed", 4)
    assert "no place for the period" not in again.stdout  # of one period there is none to tell
    assert printed("info", second, "--robot", "ur5_robot").endswith("findings: none\n")
    one, other = sdpid.read_recording(first), sdpid.read_recording(second)
    for name in ("position", "effort"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    motion.write_text("period = 1.0")
    refused(run("simulate", "ur5_robot", "--out", second, "--trajectory", motion), 2, "m.toml")


def test_simulate_says_that_the_base_of_a_robot_on_legs_was_held(tmp_path: Path) -> None:
    """And its mapping says so, word for word."""
    out, options = tmp_path / "hung.csv", ("--periods", 1, "--period", 6.5)
    made = ran("simulate", "solo12", "--out", out, *options)
    assert "the base was held; --motion walk" in made.stdout
    said = '[base] held = "base_link"'
    assert f"{said} in hung.toml" in made.stdout
    (tmp_path / "hung.toml").write_text(said.replace("] ", "]\n") + "\n")
    log = sdpid.read_recording(out)
    assert log.base is not None
    assert (log.contacts.frames, log.contacts.kind) == (("base_link",), ("plane",))
    arm = run("simulate", "ur5_robot", "--out", out, *options)
    assert "held" not in arm.stdout


def test_simulate_along_samples(tmp_path: Path) -> None:
    motion, written = tmp_path / "motion.csv", tmp_path / "motion.toml"
    out, again = tmp_path / "run.parquet", tmp_path / "again.parquet"
    time = np.linspace(0.0, 2.0, 101)
    names = sdpid.load_robot("ur5_robot").joint_names
    swing = np.outer(1.0 - np.cos(np.pi * time), np.full(6, 0.1))
    write_csv(motion, ["time", *(f"position_{name}" for name in names)], time, swing)
    options = ("--trajectory", motion, "--write-trajectory", written)
    made = ran("simulate", "ur5_robot", "--out", out, *options)
    assert "within the limit of 180.48 deg/s" in made.stdout
    assert "no limit" not in made.stdout
    record = sdpid.read_recording(out)
    assert record.names == names
    assert record.duration == pytest.approx(8.0, abs=0.01)
    ran("simulate", "ur5_robot", "--out", again, "--trajectory", written)
    np.testing.assert_array_equal(sdpid.read_recording(again).position, record.position)


def test_simulate_a_robot_on_legs(tmp_path: Path) -> None:
    """A CSV file with the mapping beside it, and a Parquet file, are read as the same log."""
    first, second = tmp_path / "trot.csv", tmp_path / "trot.parquet"
    options = ("--motion", "trot", "--duration", 0.1, "--seed", 3)
    made = ran("simulate", "solo12", "--out", first, *options)
    assert "true total mass 2.48" in made.stdout
    ran("simulate", "solo12", "--out", second, *options)
    one, other = sdpid.read_recording(first), sdpid.read_recording(second)
    for log in (one, other):
        np.testing.assert_array_equal(log.effort, one.effort)
        # The mapping has decimals in place of what all but is one.
        np.testing.assert_allclose(log.base.imu.rotation, one.base.imu.rotation, atol=1e-10)
        np.testing.assert_allclose(log.contacts.offset, one.contacts.offset, atol=1e-10)
        assert log.contacts.kind == ("point",) * 4
    assert "offset = [[0.0, 0.0, -0.016]" in first.with_suffix(".toml").read_text()


def test_compare(log: Path, tmp_path: Path) -> None:
    limits = ("--starts", 1, "--jobs", 1, "--max-iterations", 20)
    arguments = ("compare", log, "--robot", ROBOT, *limits)
    done = ran(*arguments, "--out", tmp_path / "c.csv")
    assert "random 1" in done.stdout
    assert (tmp_path / "c.csv").read_text().startswith("solver,")
    found = told(*arguments, "--starts", 0)
    assert found["certified"] is True
    assert [row["solver"] for row in found["rows"]] == ["wls", "sdp"]
    title, said, _, *table = done.stdout.splitlines()
    assert title == "findings:"
    assert said.startswith("  note effort_not_compared: ")
    header = table[0].split()
    assert header == ["solver", "start", "status", "cost", "gap", "margin", "iterations", "seconds"]


def test_verify(results: Path, tmp_path: Path) -> None:
    certificate = results / "certificate.json"
    done = ran("verify", certificate)
    assert done.stdout.splitlines()[-1].startswith("PROVEN")
    assert "No feasible parameters cost less than" in done.stdout
    assert told("verify", certificate)["passed"] is True
    forged = json.loads(certificate.read_text())
    forged["claims"]["lower_bound"] = forged["claims"]["cost"]
    forged["theta"][0] = -1.0
    (tmp_path / "forged.json").write_text(json.dumps(forged))
    done = run("verify", tmp_path / "forged.json")
    refused(done, 1, "forged.json: NOT PROVEN: ", "not hold (above).")
    assert "NOT PROVEN: the lower bound" in done.stdout
    refused(run("verify", tmp_path / "forged.json", "--quiet"), 1, "the lower bound")
    done = run("verify", tmp_path / "forged.json", "--json")
    assert done.exit_code == 1
    assert json.loads(done.stdout)["passed"] is False
    refused(run("verify", results / "result.json"), 2, "not a proof")


def test_verify_a_folder(results: Path, log: Path, tmp_path: Path) -> None:
    inputs = json.loads((results / "manifest.json").read_text())["inputs"]
    described, recorded = ({e["role"]: e for e in inputs}[role] for role in ("robot", "log"))
    assert described["name"] == ROBOT
    assert recorded["name"] == log.name
    assert recorded["sha256"] == hashlib.sha256(log.read_bytes()).hexdigest()
    assert recorded["bytes"] == log.stat().st_size
    short, full = (run("verify", results, *more).stdout.splitlines() for more in ((), ("-v",)))
    assert short[-1] == full[-1] == "PROVEN, but for what was not checked."
    assert "(-v lists them); --data LOG" in short[-2]
    assert sum(line.startswith("not checked") for line in full) > 3
    copy = shutil.copytree(results, tmp_path / "copy")
    urdf = copy / "identified.urdf"
    urdf.write_text(urdf.read_text().replace('<mass value="', '<mass value="1'))
    done = run("verify", copy)
    refused(done, 1, "1 claim does not hold (above)")
    assert "NOT PROVEN: 'identified.urdf' was changed" in done.stdout
    assert done.stdout.splitlines()[-1] == "NOT PROVEN."
    refused(run("verify", results / "parameters.json"), 2, "give the folder")
    refused(run("verify", results / "nowhere"), 2, "No such file or directory")
    (copy / "manifest.json").unlink()
    refused(run("verify", copy), 2, "it has no manifest.json")


def test_verify_from_the_log(results: Path, log: Path, tmp_path: Path) -> None:
    assert "the log 'run.parquet', SHA-256 " in printed("verify", results, "-v")
    content = told("verify", results, "--data", log, "--robot", ROBOT)
    assert content["passed"] is True
    assert {each["name"] for each in content["log"]["links"]} >= {"log", "rows", "weights"}
    assert not any("it is not here" in each for each in content["unchecked"])
    assert content["log"]["gap"] < 1e-6
    other = sdpid.read_recording(log)
    effort = np.array(other.effort)
    effort[100, 2] += 1e-3
    replace(other, effort=effort).to_parquet(tmp_path / "run.parquet")
    done = run("verify", results, "--data", tmp_path / "run.parquet")
    assert "NOT PROVEN: log: 'run.parquet' has the SHA-256" in done.stdout
    refused(done, 1, "not hold (above)")
    refused(run("verify", results, "--data", tmp_path / "none.csv"), 2, "there is no such file")
    refused(run("verify", results, "--robot", ROBOT), 2, "give data (--data)")
    refused(run("verify", results / "certificate.json", "--data", log), 2, "is no folder")


def test_validate(results: Path, log: Path, tmp_path: Path) -> None:
    urdf, figure = results / "identified.urdf", tmp_path / "f.png"
    done = ran("validate", log, "--robot", urdf, "--figure", figure)
    assert "relative residual" in done.stdout
    assert figure.read_bytes().startswith(b"\x89PNG")
    found = told("validate", log, "--robot", urdf)
    trained = json.loads((results / "result.json").read_text())["training"]
    assert found["relative_residual"] == pytest.approx(trained["relative_residual"], rel=1e-6)
    # The bundled description has no dynamics of its own: it predicts worse.
    other = told("validate", log, "--robot", ROBOT)
    assert other["relative_residual"] > 2.0 * found["relative_residual"]
    assert "verdict:\n  Trust it for the effort of " in done.stdout
    assert "on this recording" in done.stdout
    assert any(text.startswith("Do not trust it for the effort of") for text in other["verdict"])


def test_validate_leaves_joints_without_effort_out(
    results: Path, log: Path, tmp_path: Path
) -> None:
    record = sdpid.read_recording(log)
    effort = np.array(record.effort)
    effort[:, 1] = 1e4
    wrong, robot = tmp_path / "wrong.parquet", ("--robot", results / "identified.urdf")
    replace(record, effort=effort).to_parquet(wrong)
    found = told("validate", wrong, *robot, "--without-effort", "joint_2")
    assert found["joints"]["joint_2"]["rmse"] is None
    assert found["joints"]["joint_3"] == told("validate", log, *robot)["joints"]["joint_3"]
    assert "joint_2 (" not in " ".join(found["verdict"])
    assert "joint_3" in printed("validate", wrong, *robot, "--without-effort", "joint_2")


def csv_log(path: Path, position: np.ndarray, names: list[str] | None = None) -> Path:
    """Write a log with columns q1, ... and i1, ..."""
    K, n = position.shape
    labels = ["stamp", *(names or numbered("q{}", n=n)), *numbered("i{}", n=n)]
    return write_csv(path, labels, 10.0 * np.arange(K), position, np.cos(position))


def wave() -> np.ndarray:
    """Return motions within the arm's limits."""
    limits = sdpid.load_robot(ROBOT).position_limits
    angle = np.outer(0.02 * np.pi * np.arange(2000), 0.3 + 0.1 * np.arange(len(limits)))
    return limits.mean(axis=1) + 0.4 * np.ptp(limits, axis=1) * np.sin(angle)


READ = ("--unit", "time=ms", "--column", "effort=i1,i2,i3,i4,i5,i6")


def test_columns_and_units(tmp_path: Path) -> None:
    motion = wave()
    read = ("info", csv_log(tmp_path / "log.csv", np.degrees(motion)), *READ)
    facts = told(*read, "--robot", ROBOT, "--unit", "position=deg")
    assert facts["rate_hz"] == pytest.approx(100.0)
    # Efforts that are not the robot's swing faster than its motion.
    told_of = {each["kind"]: each["message"] for each in facts["findings"]}
    assert told_of.keys() == {"effort_noisy", "units", "effort_not_compared"}
    assert told_of["units"] == "units: position in deg, converted"
    assert facts["joints"][0]["position_max"] == pytest.approx(motion[:, 0].max())
    assert "look like degrees" in run(*read, "--robot", ROBOT).stdout
    scaled = told(*read, "--effort-scale", "2,2,2,2,2,2")
    assert scaled["joints"][0]["effort_max"] == pytest.approx(2.0)


def test_a_mapping_elsewhere(tmp_path: Path) -> None:
    path, beside = csv_log(tmp_path / "log.csv", np.degrees(wave())), tmp_path / "log.toml"
    mapping = tmp_path / "elsewhere" / "map.toml"
    mapping.parent.mkdir()
    mapping.write_text('[columns]\neffort = "i"\n[units]\ntime = "ms"\nposition = "deg"\n')
    facts = told("info", path, "--mapping", mapping)
    assert facts["mapping"] == str(mapping)
    assert facts["rate_hz"] == pytest.approx(100.0)
    # Options win over it; what it says of the other quantities stays.
    facts = told("info", path, "--mapping", mapping, "--unit", "time=s")
    assert facts["rate_hz"] == pytest.approx(0.1)
    told("validate", path, "--robot", ROBOT, "--mapping", mapping)
    # The one beside the log is followed without asking, and ignored when asked.
    mapping.replace(beside)
    assert told("info", path)["mapping"] == str(beside)
    refused(run("info", path, "--mapping", "none"), 2, "effort", "--column QUANTITY=NAME")
    refused(run("info", path, "--mapping", tmp_path / "no.toml"), 2, "no.toml")
    beside.write_text("title = 'not a mapping'\n")
    refused(run("info", path), 2, "title", "--mapping FILE")


def test_samples_without_a_value(tmp_path: Path) -> None:
    path = csv_log(tmp_path / "log.csv", wave())
    lines = path.read_text().splitlines()
    first = lines[1].rpartition(",")
    path.write_text("\n".join([lines[0], f"{first[0]},", *lines[2:]]))
    refused(run("info", path, *READ), 2, "line 2", "has no value", "--missing drop|interpolate")
    refused(run("info", path, *READ, "--missing", "refuse"), 2, "line 2", "has no value")
    facts = told("info", path, *READ, "--missing", "drop")
    assert facts["read_from"]["missing values"] == f"1 of {len(lines) - 1} samples dropped"


def test_info_of_logs_without_efforts(tmp_path: Path) -> None:
    rows = [f"{0.01 * k},{np.sin(0.02 * k)},{np.cos(0.03 * k)}" for k in range(500)]
    log = tmp_path / "encoders.csv"
    log.write_text("\n".join(["time,position_a,position_b", *rows]))
    found = told("info", log, "--without-effort", "a,b")
    assert [(joint["joint"], joint["effort_rms"]) for joint in found["joints"]] == [
        ("a", None),
        ("b", None),
    ]
    assert not [each for each in found["findings"] if "effort" in each["kind"]]


def test_a_topic_of_a_bag(tmp_path: Path) -> None:
    t = 0.01 * np.arange(50)
    table = np.random.default_rng(1).standard_normal((50, 2))
    bag = write_bag(tmp_path / "bag", "db3", t, table, table, table)
    facts = told("info", bag, "--topic", "/joint_states")
    assert [joint["joint"] for joint in facts["joints"]] == ["up", "down"]
    refused(run("info", bag, "--topic", "/other"), 2, "no topic /other", "/joint_states")


def test_names_that_do_not_match(tmp_path: Path, denso: sdpid.RobotModel) -> None:
    names = [f"position_{name}" for name in (*denso.joint_names[:5], "wrist")]
    given = (csv_log(tmp_path / "log.csv", wave(), names), *READ, "--robot", ROBOT)
    refused(run("identify", *given, "--out", tmp_path / "out"), 2, "joint_6")
    assert "joint_6" in printed("info", *given)


def test_the_infeasible_and_the_unidentifiable_end_with_3(log: Path, tmp_path: Path) -> None:
    motion = wave()
    motion[:, 0] = 0.0
    path, out = csv_log(tmp_path / "log.csv", motion), tmp_path / "out"
    for arguments, words in (
        ((log, "--margin", "1e6"), "the margin of 1000000"),
        ((log, "--mass-max", "1e-6"), "mass_max 1e-06"),
        ((path, *READ), "do not excite"),
    ):
        done = run("identify", *arguments, "--robot", ROBOT, "--out", out, "--no-figures")
        refused(done, 3, words)
        assert not out.exists()


@pytest.mark.parametrize(
    ("names", "status"),
    [
        ("DataError ModelError ExportError CertificateError MissingExtraError", 2),
        ("InfeasibleError IdentifiabilityError", 3),
        ("SolverError", 1),
    ],
)
def test_every_error_has_its_status(names: str, status: int) -> None:
    for name in names.split():
        assert endings.exit_status(getattr(sdpid.errors, name)("x")) == status
    assert endings.exit_status(PermissionError(13, "Permission denied", "x")) == 2
    assert endings.exit_status(RuntimeError("x")) == 1


READER = "sdpid.experiment.readers.read.read_described"


def raising(error: BaseException) -> Any:
    def fail(*_: object, **__: object) -> None:
        raise error

    return fail


def test_what_nobody_expected(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("SDPID_DEBUG", raising=False)
    monkeypatch.setattr(READER, raising(KeyError("q")))
    refused(run("info", tmp_path), 1, "unexpected KeyError", "report", "--debug")
    assert "Traceback" in run("--debug", "info", tmp_path).stderr
    monkeypatch.setenv("SDPID_DEBUG", "1")
    assert "Traceback" in run("info", tmp_path).stderr
    # An interrupt is quiet.
    monkeypatch.setattr(READER, raising(KeyboardInterrupt()))
    assert printed("info", tmp_path, status=130) == ""


def test_a_missing_extra_is_named_before_any_work(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    missing = sdpid.errors.MissingExtraError("pip install 'matplotlib>=3.9'")
    monkeypatch.setattr(sys.modules["sdpid.cli.identify"], "require", raising(missing))
    done = run("identify", tmp_path / "x.npz", "--robot", ROBOT, "--figures")
    refused(done, 2, "matplotlib>=3.9")


def test_real_recordings(data_folder: Path, tmp_path: Path) -> None:
    folder = data_folder / "panda_unisa"
    given = (folder / "panda_exciting.npz", "--robot", folder / "panda.urdf")
    assert "fer_joint1 is panda_joint1" in printed("info", *given)
    options = ("--cutoff", 4, "--velocity", "measured", "--no-figures", "--out", tmp_path)
    found = told("identify", *given, *options)
    assert found["certified"] is True
    assert list(found["training"]["joints"]) == [f"panda_joint{j}" for j in range(1, 8)]
    assert found["training_unconstrained"]["relative_residual"] <= 0.015


HOSTILE = "a\x1b[2K\u202e\x9b31m\nPROVEN."


def test_what_a_terminal_would_obey_is_not_printed(
    results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Names from files: escapes, a reversed line, and a line of its own that claims a proof."""
    from sdpid.workflow import verify as module

    forged = replace(
        module.verify(results / "certificate.json"),
        passed=False,
        statements=(f"Robot {HOSTILE}",),
        problems=(HOSTILE,),
    )
    monkeypatch.setattr(module, "verify", lambda *_, **__: forged)
    done = run("verify", results / "certificate.json")
    assert done.exit_code == 1
    assert done.stdout.splitlines()[-1] == "NOT PROVEN."
    assert not any(line.startswith("PROVEN") for line in done.stdout.splitlines())
    assert len(done.stderr.splitlines()) == 1
    assert not set(done.output) & set("\x1b\u202e\x9b")
    text = commands.listed("notes", [HOSTILE])
    assert len(text.splitlines()) == 2
    assert not set(text) & set("\x1b\u202e\x9b")


@pytest.fixture(scope="module")
def folder_of_arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a small robot and a log."""
    folder = tmp_path_factory.mktemp("arm")
    write_arm(folder)
    return folder


@pytest.mark.parametrize(
    ("log", "robot", "more"),
    [
        ("log.npz", "out/identified.urdf", ()),
        ("parameters.csv", "arm.urdf", ()),
        ("log.npz", "arm.urdf", ("--validation", "out/base_parameters.csv")),
        ("log.npz", "arm.urdf", ("--mapping", "hard_link.toml")),
        ("sidecar.npz", "arm.urdf", ()),
    ],
)
def test_a_run_does_not_overwrite_what_it_reads(
    folder_of_arm: Path, tmp_path: Path, log: str, robot: str, more: tuple[str, ...]
) -> None:
    """Also where the input is the mapping beside the log, or has another name."""
    for name in ("arm.urdf", "log.npz"):
        (tmp_path / name).write_bytes((folder_of_arm / name).read_bytes())
    out = tmp_path / "out"
    out.mkdir()
    (out / "identified.urdf").write_text(ARM_URDF)
    for name in ("parameters.csv", "base_parameters.csv", "report.html"):
        (out / name).write_text("mine")
    (tmp_path / "hard_link.toml").hardlink_to(out / "report.html")
    (tmp_path / "parameters.csv").symlink_to(out / "parameters.csv")
    (tmp_path / "sidecar.toml").symlink_to(out / "parameters.csv")
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    more = tuple(str(tmp_path / text) if "." in text else text for text in more)
    done = run("identify", tmp_path / log, "--robot", tmp_path / robot, "--out", out, *more)
    refused(done, 2, "which this run reads")
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before


def test_names_of_a_description_forge_no_line(folder_of_arm: Path, tmp_path: Path) -> None:
    """Line ends are refused; what only hides or reverses text is not printed as it is."""
    log, urdf = folder_of_arm / "log.npz", tmp_path / "arm.urdf"
    for kind, old in (("robot", 'name="arm"'), ("joint", 'joint name="a"')):
        urdf.write_text(ARM_URDF.replace(old, f'{old[:-1]}&#10;PROVEN."'))
        for arguments in (("info", log, "--robot", urdf), ("audit", urdf)):
            refused(run(*arguments), 2, f"of a <{kind}> has a line end")
    urdf.write_text(ARM_URDF.replace('joint name="a"', 'joint name="a&#x202e;b"'))
    named = tmp_path / "named.npz"
    np.savez(named, **np.load(log), joint_names=["a\u202eb", "b"])
    for recorded in (log, named):
        found = sdpid.identify(str(urdf), str(recorded), intervals=False, effects="none")
        assert found.training.relative < 0.05
    done = ran("validate", log, "--robot", urdf)
    assert "a\ufffdb" in done.stdout
    assert "\u202e" not in done.output


def test_names_of_robots_are_listed() -> None:
    every = printed("robots")
    for name in (
        "bundled:\n  denso_vp6242\n",
        "example-robot-data:\n",
        "  solo_description/solo12\n",
    ):
        assert name in every
    some = printed("robots", "UR10_")
    assert "ur_description/ur10_robot" in some
    assert "denso" not in some
    assert told("robots", "denso")["bundled"] == ["denso_vp6242"]
    assert "gen3_identified: 8.49 % in motion" in printed("robots", "gen3_ident")
    assert set(told("robots", "panda_id")["identified"]) == {"panda_identified"}
    assert printed("robots", "no such word") == "no name holds 'no such word'\n"
