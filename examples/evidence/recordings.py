"""What the package makes of every public recording with its defaults, in four parts.

* ``payloads``: which payload is found on arms without load, where only the description tells of the
  arm (`sdpid.identify_payload` without a recording to compare with): what the description has wrong
  ends up in the payload, and the intervals should allow for it.
* ``residuals``: what `identify` leaves of the efforts, and for how long it is alike. A plan has to
  assume how large the noise of its run will be (`sdpid.design_excitation`): on real arms residuals
  are what the model lacks rather than noise of sensors. Of the first record of every set: the
  residual's standard deviation beside the joint's usual effort (the geometric mean of its rms and
  the largest joint's), and its density at the motion's frequencies beside its variance.
* ``replay``: how far the costs of rows that are made again are from the first, and how long that
  takes: on the same processor, by the kernels of another one, and of a log of which one effort is
  changed by 0.1 %.
* ``written``: what a URDF and an MJCF lose, on recordings that were not fitted (cases of
  held_out.py). A file has room for damping and dry friction alone; what its fitted friction cannot
  say shows in the error of the efforts that it predicts.

    python examples/evidence/recordings.py --parts replay --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from data_sets import EVERY, QUICK, SETS, Records, part, records_of
from held_out import Case, cases
from study import Rows, Study

import sdpid
from sdpid.excitation.criterion.noise import ExpectedNoise, usual_effort
from sdpid.workflow.formulate import formulate

# Kernels that every x86 has, and no recent one takes.
OTHER = "Nehalem"
ELSEWHERE = (
    "import sys, sdpid; print(sdpid.verify(sys.argv[1], data=sys.argv[2], robot=sys.argv[3])"
    ".log.distance)"
)


def payloads(arm: Records) -> Rows:
    """Yield the payload that is found in each record of a set."""
    for run, path in arm.paths.items():
        found = sdpid.identify_payload(arm.urdf, path)
        yield run, found.mass, found.lower[0], found.upper[0], "yes" if found.shown else "no"


def residuals(arm: Records) -> Rows:
    """Yield the size and the length of the residual of a set."""
    problem = formulate(arm.robot, arm.logs()[0])
    noise = ExpectedNoise.of_residuals(problem, sdpid.solve_sdp(problem).theta)
    samples = problem.require_rows("the residuals").samples
    efforts = np.where(samples.used, samples.effort, 0.0)
    rms = np.sqrt((efforts**2).sum(axis=0) / np.maximum(samples.used.sum(axis=0), 1))
    share = np.median(100.0 * noise.deviation / usual_effort(rms))
    yield share, np.median(noise.density / noise.deviation**2)


def replay(arm: Records) -> Rows:
    """Yield the distances of each record of a set, and how long verifying takes."""
    robot = arm.urdf
    for run, path in arm.paths.items():
        # Libraries and compiled kernels are loaded before times are taken.
        sdpid.identify(robot, path, effects="none")
        start = time.process_time()
        result = sdpid.identify(robot, path)
        identified = time.process_time() - start
        with tempfile.TemporaryDirectory() as folder:
            result.save(folder, figures=False)
            start = time.process_time()
            found = sdpid.verify(folder, data=path, robot=robot)
            times = (time.process_time() - start) / identified
            for problem in found.problems:
                print(problem, flush=True)
            command = [sys.executable, "-c", ELSEWHERE, folder, str(path), str(robot)]
            other = subprocess.check_output(
                command, env={**os.environ, "OPENBLAS_CORETYPE": OTHER}, text=True
            )
            log = sdpid.read_recording(path)
            effort = np.array(log.effort)
            effort[np.unravel_index(np.argmax(np.abs(effort)), effort.shape)] *= 1.001
            changed = sdpid.verify(folder, data=replace(log, effort=effort), robot=robot)
        distances = found.log.distance, float(other), changed.log.distance
        yield f"{arm}, {run}", result.problem.n_rows, *distances, times


def written(case: Case) -> Rows:
    """Yield the errors of estimate, URDF and MJCF on what was not trained on, %."""
    label, other = next(iter(case.others.items()))
    if case.after is not None:
        other = part(other, int((other.time <= case.after).sum()), other.n_samples)
    result = case.identify(validation=other)
    reports: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        result.save(
            folder, figures=False, exported=lambda each: reports.update({each.path.suffix: each})
        )
    errors = [reports[suffix].validation for suffix in (".urdf", ".xml")]
    own = next(each for each in errors if each is not None)
    missed = [None if each is None else 100.0 * each.file for each in errors]
    lost = ", ".join(
        each.term if each.share is None else f"{each.term} {each.share:.1%}"
        for each in reports[".xml"].left_out
    )
    yield label, 100.0 * own.estimate, *missed, lost


# Of each part the table, its header, and what a row is made of.
PARTS: dict[str, tuple[str, tuple[str, ...], Callable[..., Rows]]] = {
    "payloads": (
        "described_payloads.csv",
        ("robot", "record", "mass_kg", "lower_kg", "upper_kg", "shown"),
        payloads,
    ),
    "residuals": (
        "residual_noise.csv",
        ("recording", "residual, % of the usual effort", "alike over, s"),
        residuals,
    ),
    "replay": ("replay.csv", ("log", "rows", "same", "other", "changed", "times"), replay),
    "written": (
        "written_files.csv",
        (
            *("trained_on", "predicted", "estimate_percent", "urdf_percent", "mjcf_percent"),
            "left_out_of_the_mjcf",
        ),
        written,
    ),
}


def main() -> None:
    """Write the tables that are asked for."""
    study = Study(__doc__, data=True, quick={"sets": [*QUICK]}, parts=[*PARTS], sets=[*EVERY])
    for name in study.parts:
        file, header, rows_of = PARTS[name]
        wanted = (
            cases(study.data, study.sets)
            if name == "written"
            else records_of(study.data, (each for each in study.sets if each in SETS))
        )
        study.rows(file, header, rows_of, wanted)


if __name__ == "__main__":
    main()
