"""``sdpid sample``: robots from the folder of a run, or one line and a status."""

import json
import shutil
from pathlib import Path

import pytest

import sdpid
from tests.helpers.arm_files import write_arm
from tests.helpers.commands import ran, refused, run


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a robot, its log, and the results of a run."""
    folder = tmp_path_factory.mktemp("arm")
    write_arm(folder, joint_names=["a", "b"])
    arguments = (folder / "log.npz", "--robot", folder / "arm.urdf", "--out", folder / "results")
    ran("identify", *arguments, "--no-figures", "--no-intervals", "--effects", "none")
    return folder


def test_robots_of_a_results_folder(folder: Path, tmp_path: Path) -> None:
    results, out = folder / "results", tmp_path / "robots"
    before = {path.name: path.read_bytes() for path in results.iterdir()}
    arguments = ("sample", results, "-n", 3, "--out", out, "--urdf", "--mjcf")
    done = ran(*arguments, "--json")
    content = json.loads(done.stdout)
    names = {Path(file).name for file in content["files"]}
    assert names == {path.name for path in out.iterdir()}
    assert {"robot_0003.urdf", "robot_0003.xml", "mean.xml", "ranges.json"} < names
    assert all(sdpid.audit_urdf(path).passed for path in out.glob("*.urdf"))
    assert set(content["ranges"]["bodies"]) == {"upper", "fore"}
    assert content["number"] == 3
    # The file of the run names the folder of results; nothing is written there.
    assert {path.name: path.read_bytes() for path in results.iterdir()} == before
    again = tmp_path / "again"
    done = run("sample", "--config", results / "run.toml", "-n", 3, "--out", again, "-q")
    assert (done.exit_code, done.output) == (0, "")
    for path in out.glob("robot_*.urdf"):
        assert (again / path.name).read_bytes() == path.read_bytes()
    # A single robot has no ranges to speak of.
    other = ran("sample", results, "-n", 1, "--out", again, "--seed", 1)
    assert "1 robots drawn with seed 1" in other.stdout
    assert "ranges of one robot have no width" in other.stdout
    assert "draw 40 or more" in " ".join(other.stdout.split())
    assert (again / "robot_0001.urdf").read_bytes() != (out / "robot_0001.urdf").read_bytes()


def test_a_run_that_gives_other_parameters_now(folder: Path, tmp_path: Path) -> None:
    results = tmp_path / "results"
    shutil.copytree(folder / "results", results)
    for name in ("arm.urdf", "log.npz"):
        shutil.copy(folder / name, tmp_path / name)
    content = json.loads((results / "parameters.json").read_text())
    for entry in content["standard"].values():
        entry["value"] *= 1.2
    (results / "parameters.json").write_text(json.dumps(content))
    done = run("sample", results, "--out", tmp_path / "robots")
    words = "the run, made again, predicts efforts that differ by", "at most 1e-05 is rounding"
    refused(done, 2, *words)
    assert not (tmp_path / "robots").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("results", "-n", "0"), "--number"),
        (("results", "-n", "1000000000"), "give a whole number from 1 to 1000000"),
        (("results", "--seed", "-1"), "--seed"),
        (("results", "--probability", "1"), "probability is 1.0; give a probability between"),
        (("results", "--config", "results/run.toml"), "not both"),
        (("nowhere",), "has no run.toml; give the folder that `sdpid identify` wrote"),
        (("results", "--no-urdf", "--no-mjcf"), "nothing to write"),
        (("results", "--out", "taken"), "ranges.json, which no run like this wrote"),
        (("results", "--out", "arm.urdf"), "it is a file"),
        (("results", "--consistency", "spatial_inertia"), "solve with consistency="),
        (("results", "--source", "none.xml", "--mjcf"), "none.xml"),
    ],
)
def test_what_is_refused(
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    words: str,
) -> None:
    monkeypatch.chdir(folder)
    Path("taken").mkdir(exist_ok=True)
    Path("taken/ranges.json").write_text("{}")
    out = () if "--out" in arguments else ("--out", tmp_path / "robots")
    done = run("sample", *arguments, *out)
    assert done.exit_code == 2, done.output
    assert words in done.stderr.replace("\n", " ")
    assert "Traceback" not in done.output
    assert not (tmp_path / "robots").exists()
