"""Arguments, mappings, arrays and lines of text that are refused, and what is said of them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sdpid.errors import DataError
from sdpid.experiment.readers.read import read_recording
from tests.helpers.refusals import refuses

N = 8
RNG = np.random.default_rng(7)
T = 0.5 * np.arange(N)
Q, DQ, TAU = (RNG.standard_normal((N, 3)) for _ in range(3))
GEARS = {"gear_ratios": [1, 2, 3]}
NAMES = ["up", "down", "side"]


def changed(values: np.ndarray, row: int, value: float) -> np.ndarray:
    values = values.copy()
    values[row] = value
    return values


ARGUMENTS: list[tuple[dict[str, Any], str]] = [
    ({"columns": {"effort": "x"}}, "'x' for effort is not there"),
    ({"columns": {"effort": ["x"]}}, "x for effort is not there"),
    ({"columns": {"time": "x"}}, "'x' for time is not there"),
    ({"columns": {"torque": "tau"}}, "columns: torque is not a quantity"),
    ({"units": {"position": "grad"}}, "'grad' is not known for position; known are rad, deg"),
    ({"units": {"effort": "A"}}, "currents in A, which need gains: let `sdpid gains`"),
    *(
        (given, r"units\.\w+ is .*, expected a text")
        for units in ({"time": ["s"]}, {"position": 3}, {"position": [["rad"]]})
        for given in ({"units": units}, {"mapping": {"units": units}})
    ),
    ({"missing": "guess"}, "missing: is 'guess', expected one of refuse, drop"),
    ({"misssing": "drop"}, "misssing is no argument"),
    ({"topic": "/states"}, "topic is for ROS bags"),
    ({"mapping": True}, "no mapping beside it"),
    ({"motors": GEARS, "effort_scale": [1, 1, 1]}, "effort_scale is of the joints' side"),
    ({"motors": {}}, "give either gear_ratios"),
    ({"motors": {**GEARS, "position_matrix": np.eye(3)}}, "give either gear_ratios"),
    ({"motors": {**GEARS, "signs": [1, 2, 1]}}, "expected 1 or -1"),
    ({"motors": {"gear_ratios": [1, 0, 3]}}, "cannot be inverted"),
    ({"motors": {"gear_ratios": [1, "x", 3]}}, "real numbers"),
    ({"motors": {"gear_ratios": [1, 2]}}, "motors is for 2 columns"),
    ({"motors": {**GEARS, "offsets": [1, 2]}}, r"offsets: has shape \(2,\)"),
    ({"motors": {**GEARS, "offset": [1, 2, 3]}}, "offset is not known"),
    ({"motors": {**GEARS, "applies_to": "effort"}}, "applies_to"),
    ({"motors": {"position_matrix": [[1, 2, 3]]}}, "position_matrix: has shape"),
    ({"motors": {"position_matrix": 3}}, "position_matrix: has 0 axes"),
]

ARRAYS: list[tuple[dict[str, Any], str]] = [
    ({"tau": None, "I": TAU}, r"effort is missing: none of effort, tau.*Found: t, q, I"),
    ({"t": None}, "time is missing"),
    ({"t": None, "fs": -2.0}, "sample rate"),
    ({"t": changed(T, 6, T[5])}, r"log\.npz: time repeats at row 7: 2\.5 s after 2\.5 s"),
    ({"dq": DQ.T, "joint_names": NAMES}, r"velocity: has shape \(3, 8\), expected \(8, 3\)"),
    ({"q": changed(Q, 3, np.inf)}, "row 4: position: .* is inf, not finite"),
]

MAPPINGS = [
    ("colums = 1", "colums is not known; known are columns"),
    ("columns = 1", r"expected a table \[columns\]"),
    ("[columns]\ntorque = 'x'", "torque is not a quantity"),
    ("[units]\nposition = 3", "units.position is 3"),
    ("[units]\nposition = ['deg', 'deg']", "2 units for position"),
    ("joint_names = 'a'", "joint_names is 'a'"),
    ("period = 'x'", "period is 'x'"),
    ("topic = 3", "topic is 3"),
    ("[units]\ntime = ['rad']", r"units.time is \['rad'\]"),
    ("[motors]\ngear = 3", "log.toml: motors: gear is not known"),
    ("x = ", "not a TOML file"),
]

TEXTS = [
    ("t,q,tau\n0,1,2\n1,oops,2\n", "line 3: 'q' holds 'oops', not a number"),
    ("0,1,2\n1,1,2\n", "first line must name the columns"),
    ("t,q1,tau1\n0,1,2\n1,,2\n", r"line 3: position: 'q1' has no value \(NaN\), as in 1 of 2 rows"),
    ("t;q1;tau1\n0;1.5;2\n1;1,5;2\n", "'q1' holds '1.5' where other decimals have commas"),
    ("t,q1,tau1\n0,1,2\n1,2\n", "line 3 has 2 values for 3 columns"),
    (
        "t,position_a,position_b,effort_a,effort_c\n0,1,2,1,2\n1,1,2,1,2\n",
        "effort are of joints a, c",
    ),
]


@pytest.mark.parametrize(("given", "words"), ARGUMENTS)
def test_arguments(tmp_path: Path, given: dict[str, Any], words: str):
    np.savez(tmp_path / "log.npz", t=T, q=Q, tau=TAU)
    refuses(DataError, words, read_recording, tmp_path / "log.npz", **given)


@pytest.mark.parametrize(("changes", "words"), ARRAYS)
def test_arrays(tmp_path: Path, changes: dict[str, Any], words: str):
    arrays = {"t": T, "q": Q, "tau": TAU} | changes
    np.savez(tmp_path / "log.npz", **{k: v for k, v in arrays.items() if v is not None})
    refuses(DataError, words, read_recording, tmp_path / "log.npz")


@pytest.mark.parametrize(("text", "words"), MAPPINGS)
def test_mappings(tmp_path: Path, text: str, words: str):
    np.savez(tmp_path / "log.npz", t=T, q=Q, tau=TAU)
    (tmp_path / "log.toml").write_text(text)
    refuses(DataError, words, read_recording, tmp_path / "log.npz")


@pytest.mark.parametrize(("text", "words"), TEXTS)
def test_texts(tmp_path: Path, text: str, words: str):
    (tmp_path / "log.csv").write_text(text)
    refuses(DataError, words, read_recording, tmp_path / "log.csv")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("log.xyz", r"supported are \.bag, \.csv, \.csv\.gz, \.db3"),
        ("absent.npz", "no such file"),
    ],
)
def test_files(tmp_path: Path, name: str, words: str):
    refuses(DataError, words, read_recording, tmp_path / name)
