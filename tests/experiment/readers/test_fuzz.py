"""Damaged logs of every format: read, or refused with an error of ours, nothing else.

Longer runs: ``SDPID_FUZZ=5000 pytest tests/experiment/readers/test_fuzz.py``.
"""

from __future__ import annotations

import os
import shutil
import warnings
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from sdpid.errors import SdpidError
from sdpid.experiment.readers.formats.loaders import SANDBOXED
from sdpid.experiment.readers.read import read_recording
from sdpid.experiment.recording.recording import Recording
from tests.helpers.bags import write_bag
from tests.helpers.damage import damaged

# Damaged files of each kind.
COUNT = int(os.environ.get("SDPID_FUZZ", "40"))
# Of formats that are read in a child process, which takes a moment to start.
COUNT_IN_SANDBOX = 1 + COUNT // 6
N = 30
RNG = np.random.default_rng(11)
T = 0.25 * np.arange(N)
Q, TAU, DQ = (RNG.standard_normal((N, 2)) for _ in range(3))
TOML = b"""joint_names = ["a", "b"]
period = 2.5
start = 0.0
periods = 3
[columns]
velocity = "none"
position = "q"
[units]
position = "deg"
effort = ["A", "mA"]
[motors]
position_matrix = [[32, 0], [1.5, -48]]
offsets = [0.0, 1.0]
torque_constants = [0.1, 0.2]
"""


def write_csv(folder: Path) -> Path:
    frame = pd.DataFrame({"t": T, "q1": Q[:, 0], "q2": Q[:, 1], "tau1": TAU[:, 0]})
    frame.assign(tau2=TAU[:, 1]).to_csv(folder / "log.csv", index=False)
    return folder / "log.csv"


def write_toml(folder: Path) -> Path:
    np.savez(folder / "log.npz", t=T, q=Q, tau=TAU)
    (folder / "log.toml").write_bytes(TOML)
    return folder / "log.toml"


def write_npz(folder: Path, packed: bool = True) -> Path:
    save = np.savez_compressed if packed else np.savez
    save(folder / "log.npz", t=T, q=Q, tau=TAU, joint_names=["a", "b"], period=2.5)
    return folder / "log.npz"


def write_mat(folder: Path, version: str) -> Path:
    content = {"t": T, "tau": TAU, "joint_names": np.array(["up", "down"], dtype=object)}
    file = folder / "log.mat"
    if version == "4":
        savemat(file, {"t": T, "q": Q, "tau": TAU}, format="4")
    else:
        inside = {"log": {"q": Q, "dq": DQ}}
        savemat(file, content | inside, do_compression=version == "7")
    return file


def write_h5(folder: Path) -> Path:
    with h5py.File(folder / "log.h5", "w") as out:
        out.create_dataset("arm/q", data=Q, compression="gzip", chunks=(8, 2))
        out["arm/tau"], out["t"] = TAU, T
        out["arm"].attrs["joint_names"] = ["a", "b"]
    return folder / "log.h5"


def write_table(folder: Path, own: bool) -> Path:
    file = folder / "log.parquet"
    if own:
        Recording(time=T, position=Q, effort=TAU, velocity=DQ, joint_names=("a", "b")).to_parquet(
            file
        )
    else:
        pd.DataFrame({"t": T, "q": Q.tolist(), "tau": TAU.tolist()}).to_parquet(file)
    return file


WRITERS = {
    "csv": write_csv,
    "toml": write_toml,
    "npz": write_npz,
    "npz plain": lambda folder: write_npz(folder, packed=False),
    "mat 4": lambda folder: write_mat(folder, "4"),
    "mat 5": lambda folder: write_mat(folder, "5"),
    "mat 7": lambda folder: write_mat(folder, "7"),
    "hdf5": write_h5,
    "parquet": lambda folder: write_table(folder, own=False),
    "own parquet": lambda folder: write_table(folder, own=True),
    "db3": lambda folder: write_bag(folder / "bag", "db3", T, Q, DQ, TAU),
    "mcap": lambda folder: write_bag(folder / "bag", "mcap", T, Q, DQ, TAU),
    "ros1": lambda folder: write_bag(folder / "bag", "ros1", T, Q, DQ, TAU),
}


@pytest.mark.parametrize("kind", WRITERS)
def test_damaged_logs_are_read_or_refused(tmp_path: Path, kind: str):
    file = WRITERS[kind](tmp_path)
    log = tmp_path / "log.npz" if kind == "toml" else file
    content = file.read_bytes()
    count = COUNT_IN_SANDBOX if log.suffix in SANDBOXED else COUNT
    rng = np.random.default_rng([COUNT, *kind.encode()])
    with warnings.catch_warnings():
        # Libraries may warn of what they find in a damaged file; that is not ours.
        warnings.simplefilter("ignore")
        assert read_recording(log).n == 2
        refused = 0
        for _ in range(count):
            file.write_bytes(damaged(content, rng, kind in ("csv", "toml")))
            try:
                read_recording(log)
            except SdpidError:
                refused += 1
    assert 0 < refused <= count
    shutil.rmtree(tmp_path)
    print(f"{kind}: {refused} of {count} damaged files refused, the others read")
