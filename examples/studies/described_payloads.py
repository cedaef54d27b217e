"""Which payload is found on arms without load, where only the description tells of the arm.

Every public recording goes through `sdpid.identify_payload` without a recording to compare with:
what the description has wrong ends up in the payload, and the intervals should allow for it.

    python examples/studies/described_payloads.py --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from data_sets import ROBOTS, SETS

import sdpid
from sdpid._common.tables import Table

HEADER = ("robot", "record", "mass_kg", "lower_kg", "upper_kg", "shown")
QUICK = ("panda_unisa",)


def main() -> int:
    """Find a payload in every record."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--data", type=Path, default=os.environ.get("SDPID_DATA"))
    parser.add_argument("--quick", action="store_true", help="one robot")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    done: list[tuple[object, ...]] = []
    for name in QUICK if options.quick else tuple(SETS):
        if options.data is None or not (Path(options.data) / name).is_dir():
            print(f"{name}: skipped; docs/evidence/data.md says where it comes from", flush=True)
            continue
        folder = Path(options.data) / name
        for run in SETS[name].records:
            found = sdpid.identify_payload(folder / SETS[name].urdf, folder / f"{run}.npz")
            ends = float(found.lower[0]), float(found.upper[0])
            done.append((ROBOTS[name], run, found.mass, *ends, "yes" if found.shown else "no"))
            print(*done[-1], sep="  ", flush=True)
    Table(HEADER, tuple(done)).write(options.out / "described_payloads.csv")
    return 0


if __name__ == "__main__":
    sys.exit(main())
