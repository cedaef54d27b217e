"""Identify an arm that logs motor currents: gains of its drives first, from a load of known mass.

With an arm of your own, only these lines are needed:

    found = sdpid.identify_drive_gains("arm.urdf", "bare.csv", "loaded.csv", load=2.0)
    result = sdpid.identify("arm.urdf", "bare.csv", gains=found.gains)

    python examples/currents_to_torques.py --out results
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

import sdpid

# Torque per ampere of the simulated drives, N·m/A, which nobody knows; and the load on the scale.
GAINS = np.array([13.0, 12.2, 10.1, 2.4, 2.5, 2.2])
MASS = 2.0
LOAD = f"""<link name="load"><inertial><origin xyz="0.05 0 0.1"/><mass value="{MASS}"/>
  <inertia ixx="0.006" iyy="0.006" izz="0.003" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="flange" type="fixed"><parent link="tool0"/><child link="load"/></joint></robot>"""


def logged(robot: sdpid.RobotModel, seed: int) -> sdpid.Recording:
    """Return a recording of currents."""
    log = sdpid.simulate(robot, seed=seed)
    # As one long recording, not as periods that are averaged.
    whole = replace(log, period=None, start=None, periods=None)
    return replace(whole, effort=log.effort / GAINS, currents=True)


def main() -> None:
    """Find the gains, and identify the arm with them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--quick", action="store_true", help="from one start")
    options = parser.parse_args()

    arm = sdpid.load_robot("ur5_robot")
    carrying = sdpid.load_robot(arm.urdf.replace("</robot>", LOAD))
    bare, loaded = logged(arm, 1), logged(carrying, 2)
    starts = {"starts": 0} if options.quick else {}
    found = sdpid.identify_drive_gains(arm, bare, loaded, load=MASS, effects="none", **starts)
    print(found.describe())

    result = sdpid.identify(arm, bare, gains=found.gains)
    print(*result.headline.lines, sep="\n")
    result.save(options.out / "identified")
    found.gains.to_toml(options.out / "gains.toml")


if __name__ == "__main__":
    main()
