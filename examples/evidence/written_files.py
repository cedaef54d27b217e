"""What a URDF and an MJCF lose of what was identified, on recordings that were not fitted.

Every case of held_out.py goes through `sdpid.identify` with the rest of the record, or with the
other run, as validation. A file has room for damping and dry friction alone; what its fitted
friction cannot say shows in the error of the efforts that it predicts.

    python examples/evidence/written_files.py --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

import tempfile

from data_sets import TITLES, part
from held_out import QUICK, Case, cases
from study import Study

import sdpid
from sdpid.output.robots.export_report import ExportReport

HEADER = (
    *("trained_on", "predicted", "estimate_percent", "urdf_percent", "mjcf_percent"),
    "left_out_of_the_mjcf",
)


def row(case: Case) -> tuple[object, ...]:
    """Return errors of estimate, URDF and MJCF on what was not trained on, %."""
    label, other = next(iter(case.others.items()))
    if case.after is not None:
        other = part(other, int((other.time <= case.after).sum()), other.n_samples)
    result = sdpid.identify(
        case.robot, case.log, validation=other, intervals=False, **case.arguments({})
    )
    reports: dict[str, ExportReport] = {}
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
    return case.name, label, 100.0 * own.estimate, *missed, lost


def main() -> None:
    """Identify, write, predict."""
    study = Study(__doc__, data=True, quick={"sets": [*QUICK]}, sets=[*TITLES])
    wanted = cases(study.data, study.sets)
    study.rows("written_files.csv", HEADER, wanted, lambda case: [row(case)])


if __name__ == "__main__":
    main()
