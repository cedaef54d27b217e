"""Lines that commands refuse: one sentence, a status, and nothing is written."""

from pathlib import Path

import numpy as np
import pytest

from tests.cli.test_cli import csv_log, wave
from tests.helpers.commands import alone, refused, run, with_results

# A log in degrees and ms of a robot with six joints, and one of an arm with two.
DENSO = "identify degrees.csv --unit time=ms --column effort=i1,i2,i3,i4,i5,i6 --robot"
SIX = f"{DENSO} denso_vp6242"
ARM = "identify log.npz --robot arm.urdf"
EXCITE = "excite arm.urdf --out plan"
TROT = "simulate solo12 --out x.csv --motion trot --duration 0.1"

LINES = (
    ("verify nowhere.json", "cannot read nowhere.json"),
    ("verify endless.json", "no regular file"),
    ("audit endless.csv --robot arm.urdf", "no regular file"),
    ("audit endless.urdf", "endless.urdf: it is no regular file"),
    ("audit table.csv", "say whose parameters"),
    ("audit table.csv --robot arm.urdf --repair x.urdf", "has no bodies to repair"),
    ("audit arm.urdf --robot arm.urdf", "--robot: is for tables, and arm.urdf is no .csv"),
    ("audit arm.urdf --template", "--template: is for tables"),
    ("audit arm.urdf --repair arm.urdf", "which this run reads"),
    ("simulate nowhere --out run.parquet", "no robot 'nowhere'"),
    ("simulate arm.urdf --out run.xlsx", ".csv or .parquet"),
    ("simulate arm.urdf --out nofolder/run.parquet", "no folder"),
    (
        "simulate arm.urdf --out run.csv --trajectory m.toml --period 2",
        "--period: the traj",
    ),
    ("simulate solo12 --out x.csv --change 0.15", "--change: goes with --motion"),
    ("simulate arm.urdf --out x.csv --no-noise --duration 1", "--duration: goes with --motion"),
    (f"{TROT} --exact", "--exact: is for robots on a fixed base"),
    (f"{TROT} --change 2", "--change: is 2"),
    ("info missing.npz", "no such file"),
    ("info log.xlsx", "format '.xlsx'"),
    ("info bad.npz", "bad.npz"),
    ("info log.npz --topic /x", "topic is for ROS bags"),
    ("validate log.npz --robot arm.urdf --order 99", "sdpid: order: is 99"),
    ("validate log.npz --robot arm.urdf --figure log.npz", "which this run reads"),
    ("compare log.npz --robot arm.urdf --out arm.urdf", "which this run reads"),
    (SIX, "look like degrees"),
    (SIX, "--unit QUANTITY=UNIT"),
    (f"{DENSO} panda", "has 8"),
    (f"{DENSO} nobody", "no robot 'nobody'"),
    (f"{SIX} --unit position", "--unit position: expected a quantity, '='"),
    (f"{SIX} --unit time=s", "time is given twice"),
    (f"{SIX} --unit position=grad", "grad"),
    (f"{SIX} --column efort=i", "efort"),
    (f"{SIX} --column velocity=v", "'v'"),
    (f"{SIX} --effort-scale 1,x", "--effort-scale 1,x"),
    (f"{SIX} --joint-names a,b", "joint"),
    (f"{SIX} --velocity measured --unit position=deg", "velocity"),
    (f"{SIX} --cutoff 80 --unit position=deg", "80"),
    (f"{SIX} --friction glue --unit position=deg", "glue"),
    (f"{SIX} --friction viscous=1", "viscous=1"),
    (f"{SIX} --margin -1", "margin"),
    (f"{SIX} --no-mask --mask-time 0.1", "mask-time is given; leave one out"),
    (f"{SIX} --period 0.77", "does not divide"),
    (f"{ARM} --out taken", "is a file"),
    (f"{ARM} --cutoff 1e-308", "cutoff_hz: is 1e-308"),
    (f"{ARM} --order 500", "order: is 500"),
    (f"{ARM} --order 100000000000000000000", "order"),
    (f"{ARM} --folds 1", "folds is 1"),
    (f"{ARM} --folds 99999999999999999999", "too short for 99999999999999999999 blocks"),
    (f"{ARM} --friction stribeck=1e308", "between 1e-09 and 1e+09"),
    (f"{ARM} --friction coulomb=1e-308", "between 1e-09 and 1e+09"),
    (f"{ARM} --friction stribeck=0.1,0.2", "stribeck=0.1,0.2: has 2 speeds"),
    (f"{ARM} --friction coupling=a,b,c", "coupling=a,b,c"),
    (f"{ARM} --friction viscous --friction +load", "write all with + or none"),
    ("gains --robot arm.urdf --without log.npz --load-error 1", "--load-error: of a load without"),
    (f"{EXCITE} --limits crossed.toml", "lower"),
    (f"{EXCITE} --limits other.toml", "c"),
    (f"{EXCITE} --limits misspelt.toml", "velocity"),
    (f"{EXCITE} --limits negative.toml", "-1"),
    (f"{EXCITE} --limits none.toml", "none.toml"),
    (f"{EXCITE} --duration 0.01", "0.01"),
    (f"{EXCITE} --duration nan", "nan"),
    (f"{EXCITE} --wall up=1", "up"),
    (f"{EXCITE} --wall -x", "--wall"),
    (f"{EXCITE} --wall -x=near", "--wall -x near"),
    (f"{EXCITE} --noise x", "--noise"),
    (f"{EXCITE} --previous .", "run.toml"),
    (f"{EXCITE} --check none.csv", "none.csv"),
    (f"{EXCITE} --grip 0.4", "--grip: is for robots that stand; give --stand"),
    (f"{EXCITE} --stand --periods 2", "--periods: is for robots on a fixed base"),
    (f"{EXCITE} --stand --open", "--open: is for robots on a fixed base"),
    (f"{EXCITE} --stand --limits table.toml", "--limits: a table of obstacles is for robots on"),
    ("excite arm.urdf --out arm.urdf", "it is a file"),
    ("sample results -n 1000000000", "give a whole number from 1 to 1000000"),
    ("sample results --probability 1", "probability is 1.0; give a probability between"),
    ("sample results --config results/run.toml", "not both"),
    ("sample nowhere", "has no run.toml; give the folder that `sdpid identify` wrote"),
    ("sample results --no-urdf --no-mjcf", "nothing to write"),
    ("sample results --out other", "ranges.json, which no run like this wrote"),
    ("sample results --out arm.urdf", "it is a file"),
    ("sample results --consistency spatial_inertia", "solve with consistency="),
    ("sample results --source none.xml --mjcf", "none.xml"),
)

LIMITS = {
    "crossed": "[a]\nlower = 1.0\nupper = 0.5\n",
    "other": "[c]\nvelocity = 1.0\n",
    "misspelt": "[a]\nspeed = 1.0\n",
    "negative": "[a]\nvelocity = -1.0\n",
    "table": "[[table]]\nheight = -0.5\n",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a robot, logs, results, and files that are not what they are called."""
    folder = with_results(tmp_path_factory.mktemp("refused"))
    csv_log(folder / "degrees.csv", np.degrees(wave()))
    for name in ("log.xlsx", "bad.npz", "taken", "table.csv", "m.toml"):
        (folder / name).write_text("nonsense")
    for name, text in LIMITS.items():
        (folder / f"{name}.toml").write_text(text)
    for suffix in ("json", "csv", "urdf"):
        (folder / f"endless.{suffix}").symlink_to("/dev/zero")
    (folder / "other").mkdir()
    (folder / "other" / "ranges.json").write_text("{}")
    return folder


@pytest.mark.parametrize(("line", "words"), LINES)
def test_a_line_is_refused(
    folder: Path, monkeypatch: pytest.MonkeyPatch, line: str, words: str
) -> None:
    monkeypatch.chdir(folder)
    before = {path.name for path in folder.rglob("*")}
    refused(run(*line.split()), 2, words)
    assert {path.name for path in folder.rglob("*")} == before


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("identify", "Missing argument"),
        ("identify x --nope", "--nope"),
        ("frobnicate", "frobnicate"),
        ("sample results -n 0", "--number"),
        ("sample results --seed -1", "--seed"),
        ("info log.npz --missing guess", "--missing"),
    ],
)
def test_usage_errors_are_typers(
    folder: Path, monkeypatch: pytest.MonkeyPatch, line: str, words: str
) -> None:
    monkeypatch.chdir(folder)
    done = run(*line.split())
    assert done.exit_code == 2
    assert "Usage" in done.stderr
    assert words in done.stderr


def test_the_verifier_reads_no_device(folder: Path) -> None:
    done = alone(folder / "endless.json")
    assert done.returncode == 2
    assert "no regular file" in done.stderr
