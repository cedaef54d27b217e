"""Weigh what an arm carries: mass, center of mass and inertia, as controllers ask for them.

With an arm of your own, only this line is needed:

    payload = sdpid.identify_payload("arm.urdf", "loaded.csv", "bare.csv", frame="tool0")

    python examples/weigh_a_payload.py --out results
"""

import argparse
import json
from pathlib import Path

import sdpid

# What the simulated arm carries at its tool.
LOAD = """<link name="load"><inertial><origin xyz="0.02 0 0.08"/><mass value="1.5"/>
  <inertia ixx="0.004" iyy="0.004" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="flange" type="fixed"><parent link="tool0"/><child link="load"/></joint></robot>"""


def main() -> None:
    """Simulate an arm without and with a load, and find the load."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--quick", action="store_true", help="shorter recordings")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)

    arm = sdpid.load_robot("ur5_robot")
    carrying = sdpid.load_robot(arm.urdf.replace("</robot>", LOAD))
    bare, loaded = (sdpid.simulate(robot, seed=k) for k, robot in enumerate((arm, carrying)))
    payload = sdpid.identify_payload(arm, loaded, bare, frame="tool0")
    print(payload.describe())
    (options.out / "payload.json").write_text(json.dumps(payload.to_dict(), indent=1) + "\n")


if __name__ == "__main__":
    main()
