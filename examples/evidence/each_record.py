"""The options and record folders of small studies that go through the records of each arm."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from pathlib import Path

from data_sets import SETS

QUICK = ("panda_unisa",)


def parse(description: str) -> argparse.Namespace:
    """Return the options, and make the folder of the results."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--data", type=Path, default=os.environ.get("SDPID_DATA") or None)
    parser.add_argument("--quick", action="store_true", help="one robot")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    return options


def folders(options: argparse.Namespace) -> Iterator[tuple[str, Path]]:
    """Yield name and folder of every set that is there, and say which are not."""
    for name in QUICK if options.quick else tuple(SETS):
        if options.data is None or not (options.data / name).is_dir():
            print(f"{name}: skipped; docs/evidence/data.md says where it comes from", flush=True)
            continue
        yield name, options.data / name
