"""What `identify` leaves of the efforts of real arms, and for how long it is alike.

A plan has to assume how large the noise of its run will be (`sdpid.design_excitation`): on real
arms residuals are what the model lacks rather than noise of sensors. Of the first record of every
set: the residual's standard deviation beside the joint's usual effort (the geometric mean of its
rms and the largest joint's), and its density at the motion's frequencies beside its variance.

    python examples/evidence/residual_noise.py --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

import sys

import numpy as np
from data_sets import ROBOTS, SETS
from each_record import folders, parse

import sdpid
from sdpid._common.tables import Table
from sdpid.excitation.criterion.noise import ExpectedNoise, usual_effort
from sdpid.workflow.formulate import formulate

HEADER = ("recording", "residual, % of the usual effort", "alike over, s")


def main() -> int:
    """Measure and write the table."""
    options = parse(__doc__.splitlines()[0])
    rows: list[tuple[object, ...]] = []
    for name, folder in folders(options):
        robot = sdpid.load_robot(folder / SETS[name].urdf)
        problem = formulate(robot, sdpid.read_recording(folder / f"{SETS[name].records[0]}.npz"))
        noise = ExpectedNoise.of_residuals(problem, sdpid.solve_sdp(problem).theta)
        samples = problem.require_rows("the residuals").samples
        efforts = np.where(samples.used, samples.effort, 0.0)
        rms = np.sqrt((efforts**2).sum(axis=0) / np.maximum(samples.used.sum(axis=0), 1))
        share = np.median(100.0 * noise.deviation / usual_effort(rms))
        lasting = np.median(noise.density / noise.deviation**2)
        rows.append((ROBOTS[name], float(share), float(lasting)))
        print(*rows[-1], sep="  ", flush=True)
    Table(HEADER, tuple(rows)).write(options.out / "residual_noise.csv")
    return 0


if __name__ == "__main__":
    sys.exit(main())
