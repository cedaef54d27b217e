"""Write a thousand draws of real seven-axis arms, audit every file, load every file in MuJoCo.

Each arm is identified with defaults from its recording. The table of files has the CPU seconds of
drawing, writing, and of checking every file as a stranger would: `audit_urdf` of every URDF, and
MuJoCo's loading of every URDF and MJCF. The table of ranges says what is lost where numbers are
drawn one by one: the share of the draws within all ranges, and how far the efforts on the recorded
motion spread, over those of the draws; and the widest range of a shear relative to the mean of the
draws and relative to the identified robot, which may lie on the boundary.

    python examples/evidence/drawn_robots.py --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
from data_sets import Records, records_of
from study import Study

import sdpid
from sdpid.output.samples.ranges import changes
from sdpid.workflow.sample import ParameterSamples

ARMS = ("panda_unisa", "kinova_gen3_dynamapp", "kuka_lwr4plus")
PROBABILITIES = (0.95, 0.5, 0.05)
SEED = 0

FILES = (
    "arm", "draws", "least ESS", "largest R-hat", "draw, CPU s", "write, CPU s", "URDFs audited",
    "not passed", "audit, CPU s", "loaded by MuJoCo", "load, CPU s",
)  # fmt: skip
RANGES = (
    *("arm", "share in each", "share in all", "efforts widened", "shear, mean"),
    "shear, identified",
)


def checked(folder: Path) -> tuple[object, ...]:
    """Return how many files pass the audit, do not, load, and the seconds of each."""
    start = time.process_time()
    audits = [sdpid.audit_urdf(path) for path in sorted(folder.glob("*.urdf"))]
    middle = time.process_time()
    robots = [path for path in folder.iterdir() if path.suffix in (".urdf", ".xml")]
    for path in robots:
        mujoco.MjModel.from_xml_path(str(path))
    end = time.process_time()
    wrong = sum(not audit.passed for audit in audits)
    return len(audits), wrong, middle - start, len(robots), end - middle


def widest(samples: ParameterSamples, reference: np.ndarray) -> float:
    """Return the widest 95 % range of a shear relative to bodies (links, 10)."""
    bodies = samples.theta[:, : reference.size].reshape(-1, *reference.shape)
    low, high = np.quantile(changes(bodies, reference)[..., 4:7], (0.025, 0.975), axis=0)
    return float(np.max(high - low))


def ranged(samples: ParameterSamples) -> Iterator[tuple[object, ...]]:
    """Yield the rows of the ranges."""
    problem = samples.estimate.problem
    own, mean = (
        problem.feasible.bodies(theta)
        for theta in (samples.estimate.theta, samples.theta.mean(axis=0))
    )
    try:
        identified: float | None = widest(samples, own)
    except np.linalg.LinAlgError:
        identified = None
    for probability in PROBABILITIES:
        found = samples.ranges(probability)
        shears = (widest(samples, mean), identified) if probability == 0.95 else (None, None)
        yield probability, found.inside, found.widened, *shears


def main() -> None:
    """Draw, write, check, and write two tables."""
    study = Study(
        __doc__, data=True, quick={"arms": [*ARMS[:1]], "count": 10}, count=1000, arms=[*ARMS]
    )

    def drawn(source: Records) -> Iterator[tuple[object, ...]]:
        run, *_ = source.paths.values()
        result = sdpid.identify(source.urdf, run, intervals=False)
        start = time.process_time()
        samples = sdpid.sample_parameters(result, study.count, SEED)
        made = time.process_time()
        with tempfile.TemporaryDirectory() as folder:
            samples.save(folder, ("urdf", "mjcf"))
            seconds = made - start, time.process_time() - made
            found = checked(Path(folder))
        mixed = samples.diagnostics
        cells = mixed["least_effective_size"], mixed["largest_r_hat"]
        ranges = [[*each] for each in ranged(samples)]
        yield str(source), study.count, *cells, *seconds, *found, ranges

    found = study.rows("arms.csv", (*FILES, "ranges"), records_of(study.data, study.arms), drawn)
    study.write("files.csv", FILES, ([row[name] for name in FILES] for row in found))
    ranges = ((row["arm"], *each) for row in found for each in row["ranges"])
    study.write("ranges.csv", RANGES, ranges)


if __name__ == "__main__":
    main()
