"""Two pairs of recordings of a UR10e show the same gains, and weigh each other's load."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import sdpid

COLUMNS = {
    "time": 1,
    "position": list(range(2, 8)),
    "velocity": list(range(8, 14)),
    "effort": list(range(14, 20)),
}
MASS = 2.805
EFFECTS = ("rotor_inertia", "load")


def test_pairs_agree(data_folder: Path, tmp_path: Path) -> None:
    folder = data_folder / "ur10e_innopolis"
    robot = sdpid.load_robot(folder / "ur10e.urdf")

    def read(path: Path) -> sdpid.Recording:
        names = robot.joint_names
        return sdpid.read_recording(path, columns=COLUMNS, joint_names=names, currents=True)

    # Rubbish before, a broken line at the end.
    lines = (folder / "20_02_19_15harm50secLoad.csv").read_text().splitlines()
    loaded = tmp_path / "loaded.csv"
    loaded.write_text("\n".join(lines[10:-1]) + "\n")
    pairs = (
        (folder / "20_02_19_15harm50sec.csv", loaded),
        (folder / "20_01_31-unload.csv", folder / "20_01_31-load.csv"),
    )
    one, two = (
        sdpid.identify_drive_gains(
            robot, *map(read, pair), load=MASS, effects=EFFECTS, starts=2
        ).gains
        for pair in pairs
    )
    shift = np.log(one.gains / two.gains)
    assert np.all(np.abs(shift[1:]) < 0.03)
    assert one.intervals()[0, 1] > two.intervals()[0, 0]
    # All gains are in proportion to the mass of the load.
    for own, sign in ((one, -1.0), (two, 1.0)):
        weights = np.linalg.inv(own.relative_covariance).sum(axis=0)
        off = sign * float(weights @ shift) / float(weights.sum())
        assert abs(off) < 0.02
