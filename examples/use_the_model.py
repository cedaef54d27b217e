"""Use what was identified: feedforward, gravity compensation, simulation, friction as code.

python examples/use_the_model.py --out results
"""

import argparse
import shutil
import subprocess
from pathlib import Path

import numpy as np

import sdpid

STEP = 1e-3  # s

# Prints the friction of all joints at 0.5 rad/s.
MAIN = """#include <cstdio>
#include "identified_friction.hpp"
namespace robot = identified_friction;
int main() {
  double velocity[robot::joints], effort[robot::joints];
  for (double& each : velocity) each = 0.5;
  robot::friction(velocity, effort);
  for (double each : effort) std::printf("%.17g\\n", each);
}
"""


def main() -> None:
    """Identify a simulated arm and use its model."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--quick", action="store_true", help="two joints, not six")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)

    robot = sdpid.load_robot("double_pendulum_simple" if options.quick else "ur10_robot")
    result = sdpid.identify(robot, sdpid.simulate(robot, seed=1), intervals=False)
    model = result.estimate.model()

    # Feedforward: the efforts of a motion that was not fitted, and those of the description.
    other = sdpid.process(sdpid.simulate(robot, seed=2))
    states = other.position, other.velocity, other.acceleration
    described = robot.inverse_dynamics(robot.prior, *states)
    for name, effort in (("model", model.inverse_dynamics(*states)), ("description", described)):
        missed = np.linalg.norm(effort - other.effort) / np.linalg.norm(other.effort)
        print(f"feedforward of the {name} misses {100.0 * missed:.1f} % of another motion's effort")

    # Gravity compensation: an arm that is held by these efforts stays where it is.
    q, rest = other.position[0], np.zeros(robot.n)
    held = model.forward_dynamics(q, rest, model.gravity(q) + model.friction(rest))
    print(f"held: accelerations of at most {np.abs(held).max():.1g} rad/s²")

    # Released: half a second without any effort, by a semi-implicit step.
    v, path = rest, [q]
    for _ in range(round(0.5 / STEP)):
        v = v + STEP * model.forward_dynamics(path[-1], v, rest)
        path.append(path[-1] + STEP * v)
    header = ", ".join(robot.joint_names)
    np.savetxt(options.out / "released.csv", path, delimiter=",", header=header)
    print(f"released: the joints move by up to {np.ptp(path, axis=0).max():.2f} rad in 0.5 s")

    # Friction of a joint, with its interval, and of all of them as code.
    curve = result.friction_curve(0)
    columns = curve.velocity, curve.effort, curve.lower, curve.upper
    np.savetxt(options.out / "friction.csv", np.column_stack(columns), delimiter=",")
    sdpid.plots.save_figure(curve.plot(), options.out / "friction.png")
    result.save(options.out / "identified")
    code = options.out / "identified" / "identified_friction.hpp"
    print(f"compiled header: {compiled(code, model.friction(rest + 0.5))}")


def compiled(header: Path, wanted: np.ndarray) -> str:
    """Compile the header, run it, and say how far it is from the model."""
    compiler = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        return "no C++ compiler here"
    source = header.with_name("main.cpp")
    source.write_text(MAIN, encoding="utf-8")
    program = header.with_name("main").resolve()
    subprocess.run([compiler, "-std=c++11", str(source), "-o", str(program)], check=True)
    said = subprocess.run([str(program)], capture_output=True, text=True, check=True).stdout
    found = np.array(said.split(), dtype=float)
    return f"within {np.abs(found - wanted).max():.1g} N·m of the model"


if __name__ == "__main__":
    main()
