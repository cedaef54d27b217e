"""What the package makes of public recordings with its defaults, in six parts.

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
* ``drawn``: a thousand draws of real seven-axis arms, written, audited and loaded. The table of
  files has the CPU seconds of drawing and writing, and what becomes of every file when it is
  checked as a stranger would: `audit_urdf` of every URDF, and MuJoCo's loading of every URDF and
  MJCF. The table of ranges says what is lost where numbers are drawn one by one: the share of the
  draws within all ranges, and how far the efforts on the recorded motion spread, over those of the
  draws.
* ``given``: how far parameters from elsewhere are from the best that a robot can have, proven.
  Table IV of the Denso paper against a short simulated log, whose truth is the nearest bodies to
  its constrained column; and the links of the TX40's description, with friction refitted, against
  its public record.

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
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from data_sets import EVERY, QUICK, SETS, Records, part, records_of, wrist
from held_out import Case, cases
from study import Rows, Study

import sdpid
from sdpid.estimation.problem import Problem
from sdpid.excitation.criterion.belief import ExpectedNoise, usual_effort
from sdpid.experiment.plant.simulate import true_parameters
from sdpid.workflow.certify_parameters import GivenParameters, certify_parameters, read_given
from sdpid.workflow.formulate import formulate

# Kernels that every x86 has, and no recent one takes.
OTHER = "Nehalem"
ELSEWHERE = (
    "import sys, sdpid; print(sdpid.verify(sys.argv[1], data=sys.argv[2], robot=sys.argv[3])"
    ".log.distance)"
)


DENSO = Path(__file__).resolve().parents[2] / "models" / "denso_vp6242"

# Arms that are drawn from.
ARMS = ("panda_unisa", "kinova_gen3_dynamapp", "kuka_lwr4plus")
PROBABILITIES = (0.95, 0.5, 0.05)
SEED = 0
FILES = (
    *("arm", "draws", "draw, CPU s", "write, CPU s", "URDFs audited", "not passed"),
    "loaded by MuJoCo",
)
RANGES = ("arm", "share in each", "share in all", "efforts widened")


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


def judged(title: str, problem: Problem, given: GivenParameters) -> tuple[object, ...]:
    """Return one row: feasible or not, cost beside the proven bound, and relative residuals."""
    found = certify_parameters(problem, given)
    bodies = "feasible" if found.feasible else "not feasible"
    if found.audit is not None:
        bodies = found.audit.verdict
    cost, bound = found.estimate.cost, found.certificate.lower_bound
    given_to = 100.0 * found.residuals["given"], 100.0 * found.residuals["optimum"]
    return title, problem.consistency, bodies, cost, bound, cost / bound, *given_to


def denso(periods: int, period: float) -> Rows:
    """Yield the paper's columns, and the truth."""
    robot = sdpid.load_robot("denso_vp6242")
    theta = true_parameters("denso_vp6242")
    motion = sdpid.paper_excitation("denso_vp6242", 0, periods=periods, period=period)
    log = sdpid.simulate(robot, motion, theta=theta, seed=0, progress=False)
    terms = ("coulomb", "viscous")
    for consistency in ("pseudo_inertia", "spatial_inertia"):
        problem = formulate(robot, log, friction=terms, effects="none", consistency=consistency)
        for column in ("cwls", "wls"):
            table = read_given(DENSO / "table_iv.csv", robot, value=column)
            yield judged(f"Denso, Table IV, {column.upper()}", problem, table)
        truth = dict(zip(problem.base.theta_names, map(float, theta), strict=True))
        yield judged("Denso, the truth", problem, GivenParameters(source="truth", values=truth))


def tx40(arm: Records) -> Rows:
    """Yield the links of the description, friction and drives refitted."""
    robot = arm.robot
    problem = formulate(
        robot,
        arm.logs()[0],
        friction=(sdpid.friction.Coulomb(0.05), "viscous", "offset", *wrist(0.05)),
        effects="none",
        prior=False,
    )
    links = dict(zip(robot.parameter_names, robot.prior.ravel().tolist(), strict=True))
    yield judged("TX40, links of its URDF", problem, GivenParameters(source="urdf", values=links))


def drawn(count: int, arm: Records) -> Rows:
    """Yield what becomes of the files of an arm, and its ranges."""
    run, *_ = arm.paths.values()
    result = sdpid.identify(arm.urdf, run, intervals=False)
    start = time.process_time()
    samples = sdpid.sample_parameters(result, count, SEED)
    made = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        samples.save(folder, ("urdf", "mjcf"))
        seconds = made - start, time.process_time() - made
        audits = [sdpid.audit_urdf(path) for path in sorted(Path(folder).glob("*.urdf"))]
        robots = [path for path in Path(folder).iterdir() if path.suffix in (".urdf", ".xml")]
        for path in robots:
            mujoco.MjModel.from_xml_path(str(path))
    wrong = sum(not audit.passed for audit in audits)
    found = ((share, samples.ranges(share)) for share in PROBABILITIES)
    ranges = [[share, each.inside, each.widened] for share, each in found]
    yield count, *seconds, len(audits), wrong, len(robots), ranges


# Of each part of all records the table, its header, and what a row is made of.
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
    "given": (
        "given_parameters.csv",
        (
            *("parameters", "consistency", "bodies", "cost", "bound", "over_the_bound"),
            *("residual_percent", "optimum_percent"),
        ),
        lambda arm, period: denso(8, period) if arm == "Denso" else tx40(arm),
    ),
}


def main() -> None:
    """Write the tables that are asked for."""
    study = Study(
        __doc__,
        data=True,
        quick={"sets": [*QUICK], "count": 10, "period": 19.0},
        parts=[*PARTS, "drawn"],
        sets=[*EVERY],
        count=(1000, "draws of an arm"),
        period=(76.0, "of the Denso's log, s"),
    )
    arms = records_of(study.data, (each for each in study.sets if each in SETS))
    for name in study.parts:
        if name == "drawn":
            own = [arm for arm in arms if arm.name in ARMS]
            found = study.rows("arms.csv", (*FILES, "ranges"), partial(drawn, study.count), own)
            study.write("files.csv", FILES, ([row[name] for name in FILES] for row in found))
            ranges = ((row["arm"], *each) for row in found for each in row["ranges"])
            study.write("ranges.csv", RANGES, ranges)
            continue
        axes: list[Any] = [arms]
        if name == "written":
            axes = [cases(study.data, study.sets)]
        if name == "given":
            axes = [["Denso", *records_of(study.data, ["staubli_tx40"])], [study.period]]
        file, header, rows_of = PARTS[name]
        study.rows(file, header, rows_of, *axes)


if __name__ == "__main__":
    main()
