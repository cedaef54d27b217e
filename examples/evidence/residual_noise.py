"""What `identify` leaves of the efforts of real arms, and for how long it is alike.

A plan has to assume how large the noise of its run will be (`sdpid.design_excitation`): on real
arms residuals are what the model lacks rather than noise of sensors. Of the first record of every
set: the residual's standard deviation beside the joint's usual effort (the geometric mean of its
rms and the largest joint's), and its density at the motion's frequencies beside its variance.

    python examples/evidence/residual_noise.py --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from data_sets import QUICK, SETS, Records, records_of
from study import Study

import sdpid
from sdpid.excitation.criterion.noise import ExpectedNoise, usual_effort
from sdpid.workflow.formulate import formulate

HEADER = ("recording", "residual, % of the usual effort", "alike over, s")


def residual(arm: Records) -> Iterator[tuple[object, ...]]:
    """Yield the row of a set."""
    problem = formulate(arm.robot, arm.logs()[0])
    noise = ExpectedNoise.of_residuals(problem, sdpid.solve_sdp(problem).theta)
    samples = problem.require_rows("the residuals").samples
    efforts = np.where(samples.used, samples.effort, 0.0)
    rms = np.sqrt((efforts**2).sum(axis=0) / np.maximum(samples.used.sum(axis=0), 1))
    share = np.median(100.0 * noise.deviation / usual_effort(rms))
    yield str(arm), share, np.median(noise.density / noise.deviation**2)


def main() -> None:
    """Measure and write the table."""
    study = Study(__doc__, data=True, quick={"sets": [*QUICK]}, sets=[*SETS])
    study.rows("residual_noise.csv", HEADER, records_of(study.data, study.sets), residual)


if __name__ == "__main__":
    main()
