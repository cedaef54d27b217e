"""Rehearse a whole identification: design a motion, run it on a simulated robot, identify.

python examples/excite_simulate_identify.py --out results
"""

import argparse
from pathlib import Path

import sdpid


def main() -> None:
    """Excite, simulate, identify."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--quick", action="store_true", help="ten seconds, searched briefly")
    options = parser.parse_args()

    robot = sdpid.load_robot("ur10_robot")
    limits = sdpid.Limits(acceleration=3.0, jerk=60.0, clearance=0.03)
    duration, starts, seconds = (10.0, 1, 2.0) if options.quick else (20.0, 4, None)
    plan = sdpid.design_excitation(
        robot, duration=duration, limits=limits, starts=starts, time_limit=seconds
    )
    sdpid.write_plan(plan, options.out / "plan")
    print(plan, *plan.expected.sentences(), sep="\n")

    log = sdpid.simulate(robot, plan.trajectory, seed=1)
    result = sdpid.identify(robot, log)
    print(*result.headline.lines, sep="\n")
    result.save(options.out / "identified")


if __name__ == "__main__":
    main()
