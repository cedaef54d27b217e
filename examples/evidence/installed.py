"""What is installed with sdpid, package by package and extra by extra: sizes and purposes.

Run it where sdpid is installed with all extras: the records of pip tell what brings what.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cache
from importlib.metadata import PackageNotFoundError, files, requires
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from study import Study

# What each package is for, those of Python 3.10 included.
FOR = {
    "clarabel": "solves the semidefinite programs",
    "cvxpy": "the problem for more terms of your own (`to_cvxpy`)",
    "example-robot-data": "descriptions of robots, by name",
    "joblib": "several cores, or the workers of a cluster",
    "lazy-loader": "names are imported when they are used: a quick start of the command",
    "lxml": "URDF and MJCF, with the line of what is wrong and without foreign entities",
    "numpy": "arrays",
    "pandas": "text logs, to the last digit and with dates; tables of results",
    "pin": "Pinocchio: kinematics and dynamics",
    "rich": "the progress bar",
    "scipy": "linear algebra, filters, local solvers, statistics",
    "threadpoolctl": "linear algebra on one thread, which is faster here",
    "tomli": "reads TOML with Python 3.10",
    "tomli-w": "writes TOML",
    "typer": "the command",
}
# What each extra is for.
EXTRAS = {
    "sim": "MJCF, simulation with contacts",
    "plot": "figures",
    "io": "HDF5, MATLAB 7.3 and Parquet",
    "ros": "ROS bags",
    "yaml": "parameters as YAML",
    "report": "report.html, the page of a plan",
    "fast": "simulation of arms under their controller; rollouts in seconds, not minutes",
    "excite": "planned motions",
    "dask": "the workers of a cluster",
    "xacro": "xacro files",
    "descriptions": "more robots by name, downloaded",
    "all": "all of these",
}


@cache
def megabytes(package: str) -> float:
    """Return the size of a package's files, without what Python compiles of them."""
    found = (Path(str(file.locate())) for file in files(package) or [] if file.suffix != ".pyc")
    return sum(path.stat().st_size for path in found if path.is_file()) / 1e6


def brought(wanted: Iterable[Requirement]) -> set[str]:
    """Return the installed packages that requirements lead to, themselves included."""
    seen, left = set[tuple[str, str]](), list(wanted)
    while left:
        each = left.pop()
        name = canonicalize_name(each.name)
        for extra in ("", *sorted(each.extras)):
            if (name, extra) in seen:
                continue
            seen.add((name, extra))
            left += needs(name, extra)
    return {name for name, _ in seen if installed(name)}


@cache
def needs(package: str, extra: str) -> list[Requirement]:
    """Return what a package, or an extra of it, asks for on this machine."""
    if not installed(package):
        return []
    asked = [Requirement(line) for line in requires(package) or []]
    return [each for each in asked if each.marker is None or each.marker.evaluate({"extra": extra})]


@cache
def installed(package: str) -> bool:
    """Return whether a package is there."""
    try:
        files(package)
    except PackageNotFoundError:
        return False
    return True


def of_packages() -> Iterator[tuple[object, ...]]:
    """Yield the rows of what sdpid always needs, the largest first."""
    wanted = needs("sdpid", "")
    everything = brought(wanted)
    for each in sorted(wanted, key=lambda each: -megabytes(each.name)):
        others = brought(other for other in wanted if other is not each)
        gone = sum(map(megabytes, everything - others))
        yield each.name, FOR[each.name], megabytes(each.name), gone
    yield "all, with what they bring", "", sum(map(megabytes, everything)), None


def of_extra(extra: str) -> Iterator[tuple[object, ...]]:
    """Yield the row of an extra: what it adds to what is always there."""
    more = brought([Requirement(f"sdpid[{extra}]")]) - brought([Requirement("sdpid")])
    yield EXTRAS[extra], sum(map(megabytes, more))


def main() -> None:
    """Write both tables."""
    study = Study(__doc__)
    columns = ("package", "purpose", "mb", "gone_mb")
    study.rows("packages.csv", columns, of_packages, digits=3)
    study.rows("extras.csv", ("extra", "purpose", "mb"), of_extra, EXTRAS, digits=3)


if __name__ == "__main__":
    main()
