"""Which payload is found on arms without load, where only the description tells of the arm.

Every public recording goes through `sdpid.identify_payload` without a recording to compare with:
what the description has wrong ends up in the payload, and the intervals should allow for it.

    python examples/evidence/described_payloads.py --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

from collections.abc import Iterator

from data_sets import QUICK, SETS, Records, records_of
from study import Study

import sdpid

HEADER = ("robot", "record", "mass_kg", "lower_kg", "upper_kg", "shown")


def payloads(arm: Records) -> Iterator[tuple[object, ...]]:
    """Yield the payload that is found in each record of a set."""
    for run, path in arm.paths.items():
        found = sdpid.identify_payload(arm.urdf, path)
        shown = "yes" if found.shown else "no"
        yield str(arm), run, found.mass, found.lower[0], found.upper[0], shown


def main() -> None:
    """Find a payload in every record."""
    study = Study(__doc__, data=True, quick={"sets": [*QUICK]}, sets=[*SETS])
    study.rows("described_payloads.csv", HEADER, records_of(study.data, study.sets), payloads)


if __name__ == "__main__":
    main()
