"""Which payload is found on arms without load, where only the description tells of the arm.

Every public recording goes through `sdpid.identify_payload` without a recording to compare with:
what the description has wrong ends up in the payload, and the intervals should allow for it.

    python examples/evidence/described_payloads.py --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

import sys

from data_sets import ROBOTS, SETS
from each_record import folders, parse

import sdpid
from sdpid._common.tables import Table

HEADER = ("robot", "record", "mass_kg", "lower_kg", "upper_kg", "shown")


def main() -> int:
    """Find a payload in every record."""
    options = parse(__doc__.splitlines()[0])
    done: list[tuple[object, ...]] = []
    for name, folder in folders(options):
        for run in SETS[name].records:
            found = sdpid.identify_payload(folder / SETS[name].urdf, folder / f"{run}.npz")
            ends = float(found.lower[0]), float(found.upper[0])
            done.append((ROBOTS[name], run, found.mass, *ends, "yes" if found.shown else "no"))
            print(*done[-1], sep="  ", flush=True)
    Table(HEADER, tuple(done)).write(options.out / "described_payloads.csv")
    return 0


if __name__ == "__main__":
    sys.exit(main())
