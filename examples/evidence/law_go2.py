"""A real Go2 that hangs, encoders alone: positions of a part of the log that was not fitted.

The robot is fitted to the first 60 % of the log that there is and rolled out by plain MuJoCo over
the rest, which is faster. With ``--kept`` the whole log is fitted, and that file is rolled out.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
from study import Study

import sdpid

KP, KD = 20.0, 1.5
# The delay between command and torque of the model as shipped is not known, s.
USUAL = 0.005
SHARE = 0.6


def rolled_out(xml: Path, delay: float, log: dict) -> np.ndarray:
    """Return the errors (N, n) of MuJoCo's positions, rad."""
    model = mujoco.MjModel.from_xml_path(str(xml))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    data, step, t = mujoco.MjData(model), model.opt.timestep, log["t"] - log["t"][0]
    slope, place = np.polyfit(t[:8], log["q"][:8], 1)
    data.qpos[:], data.qvel[:] = place, slope
    played = [data.qpos.copy()]
    for k in range(int(t[-1] / step)):
        row = max(int(np.searchsorted(t, k * step - delay + 1e-9, side="right")) - 1, 0)
        data.qfrc_applied[:] = KP * (log["commanded"][row] - data.qpos) - KD * data.qvel
        mujoco.mj_step(model, data)
        played.append(data.qpos.copy())
    grid = step * np.arange(len(played))
    at = np.stack([np.interp(t, grid, each) for each in np.array(played).T], axis=1)
    return at - log["q"]


def main() -> None:
    """Score the model as shipped, ours with constants and ours with friction over position."""
    study = Study(__doc__, data=True, kept=("", "file of the part kept back"))
    folder = study.data / "go2_hung"
    whole = dict(np.load(folder / "first_60_percent.npz"))
    end = len(whole["t"]) if study.kept else int(SHARE * len(whole["t"]))
    held = {key: values[end:] for key, values in whole.items()}
    if study.kept:
        held = dict(np.load(study.kept))
    shipped = folder / "go2.xml"
    robot = sdpid.load_robot(shipped)

    def rows_of(side: str) -> Iterator[tuple]:
        begun, xml, delay, ends = time.process_time(), shipped, USUAL, (None, None)
        with tempfile.TemporaryDirectory() as place:
            if side != "as shipped":
                log = sdpid.Recording(
                    time=whole["t"][:end],
                    position=whole["q"][:end],
                    reference=whole["commanded"][:end],
                    joint_names=robot.joint_names,
                )
                law = sdpid.controllers.PD(kp=KP, kd=KD)
                result = sdpid.identify(robot, log, law=law)
                result.save(place, tendons=side == "tendons")
                xml, delay = Path(place) / "identified.xml", result.drives.delay
                ends = result.drives.delay_interval
            seconds = time.process_time() - begun
            error = 1e3 * np.sqrt(np.mean(rolled_out(xml, delay, held) ** 2))
        yield side, error, 1e3 * delay, *(x and 1e3 * x for x in ends), seconds

    columns = ("side", "error_mrad", "delay_ms", "from_ms", "to_ms", "seconds")
    study.rows("go2.csv", columns, rows_of, ("as shipped", "constants", "tendons"), digits=3)


if __name__ == "__main__":
    main()
