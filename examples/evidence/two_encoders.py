"""Stiffness of gears and the delay between two encoders, on a run that was not trained on.

    python examples/evidence/two_encoders.py --train A --train B --test FILE --json

The robot is `kr300.urdf` beside the first recording: a KUKA KR300 with encoders at motors and links
of joints 1 to 3. Rotor inertias are nominal ones of its maker, behind the gears.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

import sdpid
from sdpid._common.tables import Table

# Behind the gears of joints 1 to 3, kg·m²: those of the wrist are identified.
ROTORS = (609.0, 844.0, 751.0)
MASS_MAX = 1500.0


def main() -> None:
    """Train, test and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--train", type=Path, action="append", required=True)
    parser.add_argument("--test", type=Path, required=True)
    parser.add_argument("--out", type=Path, help="folder for two_encoders.csv")
    parser.add_argument("--json", action="store_true", help="one JSON object only")
    asked = parser.parse_args()
    robot = sdpid.load_robot(asked.train[0].parent / "kr300.urdf")
    logs = [sdpid.read_recording(path) for path in asked.train]
    limits = sdpid.Constraints(mass_max=MASS_MAX)
    rotors = np.array([*ROTORS, *[np.nan] * (robot.n - len(ROTORS))])
    found = sdpid.identify(robot, logs, constraints=limits, rotor_inertia=rotors).elasticity
    assert found is not None
    missed = found.errors(sdpid.read_recording(asked.test))
    measured = np.flatnonzero(np.isfinite(found.compliance))
    plain = found.to_dict()
    result = {
        "deflection_mrad": (1e3 * missed.std(axis=0)[measured]).tolist(),
        "delay_ms": 1e3 * float(found.delay_s[measured[0]]),
        "stiffness": [plain["stiffness"][j] for j in measured],
        "interval": [
            None if plain["stiffness"][j] is None else plain["interval"][j] for j in measured
        ],
    }
    if asked.out is not None:
        ends = [end or (None, None) for end in result["interval"]]
        table = Table.of_columns(
            {
                "joint": [found.joint_names[j] for j in measured],
                "delay, ms": [result["delay_ms"]] * len(measured),
                "missed on the test run, mrad": result["deflection_mrad"],
                "stiffness, N·m/rad": result["stiffness"],
                "from": [low for low, _ in ends],
                "to": [high for _, high in ends],
            }
        )
        asked.out.mkdir(parents=True, exist_ok=True)
        table.write(asked.out / "two_encoders.csv")
    print(json.dumps(result) if asked.json else f"{found}\n{json.dumps(result, indent=2)}")


if __name__ == "__main__":
    main()
