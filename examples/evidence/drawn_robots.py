"""Write a thousand draws of real seven-axis arms, audit every file, load every file in MuJoCo.

Each arm is identified with defaults from its recording. The table of files has the CPU seconds of
drawing and writing, and what becomes of every file when it is checked as a stranger would:
`audit_urdf` of every URDF, and MuJoCo's loading of every URDF and MJCF. The table of ranges says
what is lost where numbers are drawn one by one: the share of the draws within all ranges, and how
far the efforts on the recorded motion spread, over those of the draws.

    python examples/evidence/drawn_robots.py --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

import tempfile
import time
from functools import partial
from pathlib import Path

import mujoco
from data_sets import Records, records_of
from study import Rows, Study

import sdpid

ARMS = ("panda_unisa", "kinova_gen3_dynamapp", "kuka_lwr4plus")
PROBABILITIES = (0.95, 0.5, 0.05)
SEED = 0
FILES = ("arm", "draws", "draw, CPU s", "write, CPU s", "URDFs audited", "not passed")
FILES = (*FILES, "loaded by MuJoCo")
RANGES = ("arm", "share in each", "share in all", "efforts widened")


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


def main() -> None:
    """Draw, write, check, and write two tables."""
    quick = {"arms": [*ARMS[:1]], "count": 10}
    study = Study(__doc__, data=True, quick=quick, count=1000, arms=[*ARMS])
    arms = records_of(study.data, study.arms)
    found = study.rows("arms.csv", (*FILES, "ranges"), partial(drawn, study.count), arms)
    study.write("files.csv", FILES, ([row[name] for name in FILES] for row in found))
    ranges = ((row["arm"], *each) for row in found for each in row["ranges"])
    study.write("ranges.csv", RANGES, ranges)


if __name__ == "__main__":
    main()
