"""From logs of a quadruped to a URDF that walks in MuJoCo. The logs are simulated here.

python examples/walking_robot.py --out results
"""

import argparse
from pathlib import Path

import sdpid
from sdpid.experiment.plant.legged.truth import changed_parameters


def main() -> None:
    """Identify a quadruped that is not as described, and let the result walk."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--quick", action="store_true", help="short logs")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    robot = sdpid.load_robot("solo12", root="free_flyer")
    theta = changed_parameters(robot, seed=1)
    motions, seconds = ("stand", "trot", "hang"), 3.0 if options.quick else 10.0
    runs = [sdpid.simulate_legged(robot, m, theta=theta, duration=seconds) for m in motions]
    friction = (sdpid.friction.Coulomb(width=0.02), "viscous", "rotor_inertia")
    logs = [run.recording for run in runs]
    result = sdpid.identify(robot, logs, friction=friction, effects="none", intervals=False)
    sdpid.write_urdf(result.estimate, target=options.out / "identified.urdf")
    found = sdpid.load_robot(options.out / "identified.urdf", root="free_flyer")
    masses = theta[:130:10].sum(), robot.prior[:, 0].sum(), found.prior[:, 0].sum()
    print("mass {:.4f} kg, described {:.4f}, identified {:.4f}".format(*masses))
    as_found = changed_parameters(found, change=0.0)
    for motion in ("trot", "walk"):
        run = sdpid.simulate_legged(found, motion, theta=as_found, duration=seconds)
        print(f"{motion}: base at {run.motion.position[-1, :3].round(2)} m")


if __name__ == "__main__":
    main()
