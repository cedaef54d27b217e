"""Draw robots that a recording cannot tell apart, load them in MuJoCo, and let each arm fall.

The recording is simulated here; with a robot of your own, only these lines are needed:

    result = sdpid.identify("arm.urdf", "run.csv")
    sdpid.sample_parameters(result, 100).save("robots", ("urdf", "mjcf"))

    python examples/sample_robots.py --out results
"""

import argparse
import json
from pathlib import Path

import mujoco
import numpy as np

import sdpid

# Three joints, as example-robot-data and others have seven: any URDF, MJCF or name will do.
LINK = """<link name="{0}"><inertial><origin xyz="{1} 0 0.02"/><mass value="{2}"/>
  <inertia ixx="0.01" iyy="{3}" izz="{3}" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
JOINT = """<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/>
  <origin xyz="{3} 0 0.1"/><axis xyz="{4}"/>
  <limit lower="-2" upper="2" effort="80" velocity="2"/>
  <dynamics damping="0.6" friction="1.2"/></joint>"""
ARM = "".join(
    ['<robot name="arm"><link name="base"/>']
    + [LINK.format(*link) for link in
       (("turret", 0, 4, 0.02), ("upper", 0.2, 3, 0.06), ("fore", 0.15, 1.5, 0.02))]
    + [JOINT.format(*joint) for joint in
       (("waist", "base", "turret", 0, "0 0 1"), ("shoulder", "turret", "upper", 0, "0 1 0"),
        ("elbow", "upper", "fore", 0.4, "0 1 0"))]
    + ["</robot>"]
)  # fmt: skip

# The arm is let go where gravity pulls, and watched for so long, s.
SECONDS = 0.5


def fallen(path: Path) -> np.ndarray:
    """Return the joint positions of an arm some time after it was let go, rad."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    while data.time < SECONDS:
        mujoco.mj_step(model, data)
    return np.array(data.qpos)


def main() -> None:
    """Identify an arm, draw robots, and simulate each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--quick", action="store_true", help="few robots")
    options = parser.parse_args()
    robot = sdpid.load_robot(ARM)
    log = sdpid.simulate(robot, seed=0)
    result = sdpid.identify(robot, log, intervals=False)
    samples = sdpid.sample_parameters(result, 10 if options.quick else 100, seed=0)
    print(samples, *samples.notes, sep="\n")
    samples.save(options.out / "robots", ("mjcf",))

    ends = np.array([fallen(p) for p in sorted((options.out / "robots").glob("robot_*.xml"))])
    middle, spread = np.degrees(ends.mean(axis=0)), np.degrees(ends.std(axis=0))
    print(f"{SECONDS} s after the arm was let go, joints are at")
    for joint, where, width in zip(robot.joint_names, middle, spread, strict=True):
        print(f"  {joint}: {where:.1f} ± {width:.2f} degrees")
    rollout = {"mean_degrees": middle.tolist(), "standard_deviation_degrees": spread.tolist()}
    (options.out / "rollout.json").write_text(json.dumps(rollout, indent=1) + "\n")


if __name__ == "__main__":
    main()
