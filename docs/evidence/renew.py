"""Make the tables of the evidence anew, and say what has changed.

    python docs/evidence/renew.py --list                # every table: age, command, minutes
    python docs/evidence/renew.py held_out truth        # run two studies, keep the new tables
    python docs/evidence/renew.py held_out --check      # the same, keep nothing; 1 if changed
    python docs/evidence/renew.py --older-than 90       # all with a table of more than 90 days
    python docs/evidence/renew.py held_out --quick      # does the command still run?
    python docs/evidence/renew.py held_out --from RUNS  # take what RUNS/held_out holds
    python docs/evidence/renew.py --numbers             # measured numbers that no table backs

Without a name and an age nothing is run. A study that fails leaves its tables as they are.
`SDPID_DATA` or --data names the folder of the public records.
"""

from __future__ import annotations

import argparse
import os
import platform
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from datetime import date, datetime
from pathlib import Path

from changes import changes
from studies import HERE, EvidenceError, Study, Table, load_studies, read_grid

# Most changed cells that are listed of one table.
SHOWN = 40
STAMP = "made.toml"
BY_COMMAND = "by the command"


def main(arguments: Sequence[str] | None = None, folder: Path = HERE) -> int:
    """Run what is asked for and return the exit status."""
    options = parse(arguments)
    if options.numbers:
        from prose import report

        return report(folder.parent.parent)
    studies = load_studies(folder)
    unknown = [name for name in options.study if name not in studies]
    if unknown:
        print(f"no study {', '.join(unknown)}; there are {', '.join(studies)}", file=sys.stderr)
        return 2
    chosen = [studies[name] for name in options.study]
    if options.older_than is not None:
        among = chosen or list(studies.values())
        chosen = [study for study in among if age(study) > options.older_than]
    if options.list or not chosen:
        print(listing(chosen or list(studies.values())))
        return 0
    results = []
    for study in chosen:
        results.append(renew(study, options, folder))
        if results[-1] is None and study.note:
            print(f"   note: {study.note}")
    failed, changed = sum(each is None for each in results), sum(map(bool, results))
    print(f"\n{len(results)} studies: {changed} changed, {failed} failed")
    return int(bool(failed or (options.check and changed)))


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return the options."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("study", nargs="*", help="names as in studies.toml")
    parser.add_argument("--check", action="store_true", help="keep nothing; 1 if changed")
    parser.add_argument("--list", action="store_true", help="age and command of every table")
    parser.add_argument("--older-than", type=float, metavar="DAYS", help="only older studies")
    parser.add_argument("--quick", action="store_true", help="small runs; nothing is compared")
    parser.add_argument("--numbers", action="store_true", help="numbers that no table backs")
    parser.add_argument("--data", type=Path, default=os.environ.get("SDPID_DATA") or None)
    parser.add_argument(
        "--from",
        dest="source",
        type=Path,
        metavar="RUNS",
        help=f"take RUNS/<study> in place of a run; {STAMP} in it has date, commit and machine",
    )
    return parser.parse_args(arguments)


def renew(study: Study, options: argparse.Namespace, folder: Path) -> int | None:
    """Run one study and keep its tables: the number of changes, or None where it failed."""
    print(f"\n== {study.name}: {study.title}", flush=True)
    with tempfile.TemporaryDirectory() as scratch:
        out = options.source / study.name if options.source else Path(scratch) / study.name
        if not options.source and not run(study, options, out, folder):
            return None
        try:
            fresh = {name: read_grid(out / table.file) for name, table in study.tables.items()}
        except EvidenceError as missing:
            print(f"   failed: {missing}")
            return None
        if not any(grid.rows for grid in fresh.values()):
            print("   failed: its tables have no rows; are all inputs of the study there?")
            return None
        if options.quick:
            print("   runs, and writes all its tables")
            return 0
        count = 0
        for name, table in study.tables.items():
            known = table.read() if table.path.is_file() else None
            found = changes(table, known, fresh[name]) if known else ["new"]
            count += len(found)
            print(f"   {table.file}: " + (f"{len(found)} changes" if found else "as before"))
            for change in found[:SHOWN]:
                print(f"      {change}")
        if not options.check:
            stamped = stamp(out if options.source else None, folder)
            for name, table in study.tables.items():
                fresh[name].write(table.path)
                write_stamp(folder / "studies.toml", table, stamped)
    return count


def run(study: Study, options: argparse.Namespace, out: Path, folder: Path) -> bool:
    """Run a study's command into a folder, and return whether it ended well."""
    if study.needs_data and (options.data is None or not options.data.is_dir()):
        found = "is not set" if options.data is None else f"is {options.data}, which is no folder"
        print(f"   failed: needs the public records; SDPID_DATA or --data {found}")
        return False
    out.mkdir(parents=True)
    words = shlex.split(study.command)
    command = [word.format(out=out, data=options.data) for word in words]
    if command[0] == "python":
        command[0] = sys.executable
    command += [study.quick] if options.quick and study.quick else []
    root = folder.parent.parent
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(root), *_pythonpath()])}
    try:
        done = subprocess.run(
            command, cwd=root, env=environment, text=True, capture_output=True, check=False
        )
    except FileNotFoundError as missing:
        print(f"   failed: {missing}")
        return False
    (out / "stdout.txt").write_text(done.stdout, encoding="utf-8")
    if done.returncode:
        last = (done.stderr or done.stdout).strip().splitlines()[-5:]
        print(f"   failed with status {done.returncode}:", *last, sep="\n      ")
    return done.returncode == 0


def stamp(source: Path | None, folder: Path) -> dict[str, str]:
    """Return date, commit and machine of a run: of today, or as a folder of results says."""
    if source is not None and (source / STAMP).is_file():
        text = (source / STAMP).read_text(encoding="utf-8")
        return {**dict(re.findall(r'^(\w+) = "(.*)"$', text, flags=re.M)), "made": BY_COMMAND}
    commit = subprocess.run(
        ["git", "rev-parse", "--short=7", "HEAD"],
        cwd=folder,
        text=True,
        capture_output=True,
        check=False,
    ).stdout.strip()
    cores = f"{os.cpu_count()} cores"
    machine = f"{_processor()}, {cores}, Python {platform.python_version()}"
    today = date.today().isoformat()
    return {"date": today, "commit": commit, "machine": machine, "made": BY_COMMAND}


def write_stamp(path: Path, table: Table, stamped: dict[str, str]) -> None:
    """Put date, commit, machine and origin of a table into studies.toml."""
    text = path.read_text(encoding="utf-8")
    heading = f"[{table.study}.tables.{table.name}]\n"
    before, found, after = text.partition(heading)
    if not found:
        raise EvidenceError(f"{path.name} has no line {heading.strip()}.")
    body, bracket, rest = re.match(r"(.*?)(^\[|\Z)(.*)", after, flags=re.M | re.S).groups()  # type: ignore[union-attr]
    kept = [line for line in body.rstrip().splitlines() if line.split(" =")[0] not in stamped]
    kept += [f'{key} = "{value}"' for key, value in stamped.items()]
    end = f"\n\n{bracket}{rest}" if bracket else "\n"
    path.write_text(before + found + "\n".join(kept) + end, encoding="utf-8")


def age(study: Study) -> float:
    """Return the days since the oldest table of a study was made."""
    return max(
        (datetime.now() - datetime.fromisoformat(table.date)).days if table.date else float("inf")
        for table in study.tables.values()
    )


def listing(studies: Sequence[Study]) -> str:
    """Return age, origin, minutes and command of every table as text."""
    lines = []
    for study in studies:
        minutes = "?" if study.minutes is None else f"{study.minutes:g}"
        lines.append(f"{study.name}: {study.shown_command()}  ({minutes} min)")
        for name, table in study.tables.items():
            lines.append(f"   {name:<18} {table.date:<11} {table.commit:<8} {table.made}")
    return "\n".join(lines)


def _processor() -> str:
    """Return the processor's name where the system tells it."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return platform.processor() or platform.machine()
    name = re.search(r"model name\s*: (.*)", text)
    return name[1].strip() if name else platform.machine()


def _pythonpath() -> list[str]:
    return [folder for folder in os.environ.get("PYTHONPATH", "").split(os.pathsep) if folder]


if __name__ == "__main__":
    sys.exit(main())
