"""From logs of a quadruped to a URDF, with which it walks better. The robot is simulated here.

python examples/walking_robot.py --out results
"""

import argparse
from pathlib import Path

import numpy as np

import sdpid


def main() -> None:
    """Identify a quadruped that is not as described, and let it move by both models."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--quick", action="store_true", help="short logs")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    described = sdpid.load_robot("solo12", root="free_flyer")
    seconds, moving = (2.0, 1.0) if options.quick else (10.0, 3.0)
    motions = ("stand", "trot", "hang")
    runs = [sdpid.simulate_legged(described, m, duration=seconds) for m in motions]
    logs, truth = [run.recording for run in runs], runs[0].theta
    friction = (sdpid.friction.Coulomb(width=0.02), "viscous", "rotor_inertia")
    result = sdpid.identify(described, logs, friction=friction, effects="none", intervals=False)
    print(result.headline.error)
    sdpid.write_urdf(result.estimate, target=options.out / "identified.urdf")
    found = sdpid.load_robot(options.out / "identified.urdf", root="free_flyer")
    # The true robot, whose controller carries the weight that one model or the other has.
    for name, model in {"described": described, "identified": found}.items():
        print(f"{name}: {model.prior[:, 0].sum():.4f} kg (true {truth[:130:10].sum():.4f})")
        for motion in ("stand", "trot", "walk"):
            run = sdpid.simulate_legged(model, motion, theta=truth, seed=1, duration=moving)
            log = run.recording
            off = 1e3 * np.sqrt(np.mean((log.position - log.reference) ** 2))
            print(f"  {motion}: joints off by {off:.1f} mrad")
    # The links of the URDF in MuJoCo, beside the true ones.
    friction_found = result.estimate.theta[found.prior.size :]
    as_found = np.concatenate([found.prior.ravel(), friction_found])
    for name, theta in {"true": truth, "identified": as_found}.items():
        walk = sdpid.simulate_legged(
            found, "walk", theta=theta, seed=1, duration=seconds / 2
        ).motion
        print(f"{name} robot walks to {walk.position[-1, :3].round(4)} m")


if __name__ == "__main__":
    main()
