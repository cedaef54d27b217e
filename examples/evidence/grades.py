"""Whether grades and bands that `identify` gives by default hold on another recording.

Each recording of six real robots is identified with defaults, without hints, and predicts another
recording, or the other part of the only one. A joint that is trusted on its own blocks keeps its
grade where the other recording gives it too. The table of margins shows what each margin between
blocks and other motion would have trusted and kept, room for other motion asked for as by default,
and which margin the other robots choose for each robot: the smallest for which every one of them
keeps nine of ten grades. The table of bands shows the share of moving rows of the other recording
within the 95 % bands.

    python examples/evidence/grades.py --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from data_sets import SETS, part
from held_out import GAINS, KINDS, TITLES

import sdpid
from sdpid._common.files import atomic_write_text
from sdpid._common.tables import Table
from sdpid.assurance.diagnostics.held_out import hold_out
from sdpid.assurance.diagnostics.rest import moving_rows
from sdpid.experiment.preparation.prepare import prepare
from sdpid.output.report.grades import MARGIN, graded, grades, left_room, level_of

# Recordings of the UR10e without a load, each of another motion.
UR10E = (
    "20_01_31-unload",
    "20_02_05-20sec_8harm",
    "20_02_05-20sec_12harm",
    "20_02_06-20sec_5harm",
    "20_02_10-30sec_12harm",
    "20_02_19_15harm50sec",
)

# One record, cut at this share of it; each side predicts the other.
CUTS = (0.5, 0.6)

MARGINS = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0)

# Share of grades that must be kept, and of rows within 95 % bands.
KEPT, BANDS = 0.9, (0.90, 0.98)

QUICK = ("panda_unisa", "ur10_unisa")


@dataclass(frozen=True)
class Joint:
    """What blocks said of a joint, and what another recording says.

    Attributes
    ----------
    robot, case : str
        Whose joint, and the two recordings.
    trusted : bool
        The default grade without other motion is "good".
    r2, nrmse : float
        On blocks held out.
    room : bool
        The parameters leave a "good" error on random motion within the recorded range.
    kept : bool
        The other recording's grade is "good".
    """

    robot: str
    case: str
    name: str
    trusted: bool
    r2: float
    nrmse: float
    room: bool
    kept: bool


Case = tuple[str, sdpid.RobotModel, sdpid.Recording, dict[str, sdpid.Recording]]


def cases(folder: Path, names: Iterable[str]) -> Iterator[tuple[str, Case]]:
    """Yield robots and their cases: a title, the robot, a recording, and others by name."""
    for name in names:
        if name == "ur10e_innopolis":
            yield from ((TITLES[name], each) for each in _ur10e(folder / name))
            continue
        data = SETS[name]
        robot = sdpid.load_robot(folder / name / data.urdf)
        for effort in data.efforts:
            logs = [
                sdpid.read_recording(folder / name / f"{run}.npz", columns={"effort": effort})
                for run in data.records
            ]
            label = "" if effort == "tau" else " currents"
            for title, own, other in _pairs(logs):
                yield TITLES[name], (f"{TITLES[name]}{label}, {title}", robot, own, {"": other})


def _pairs(
    logs: Sequence[sdpid.Recording],
) -> Iterator[tuple[str, sdpid.Recording, sdpid.Recording]]:
    """Yield pairs of recordings with a title: two runs, or parts of one."""
    if len(logs) == 2:
        yield "run 1 → 2", logs[0], logs[1]
        yield "run 2 → 1", logs[1], logs[0]
        return
    (log,) = logs
    for cut in CUTS:
        at = round(cut * log.n_samples)
        first, rest = part(log, 0, at), part(log, at, log.n_samples)
        yield f"first {cut:.0%} → rest", first, rest
        yield f"rest → first {cut:.0%}", rest, first


def _ur10e(folder: Path) -> Iterator[Case]:
    """Yield the UR10e's recordings, each of which predicts all others."""
    columns = {"time": 1, **{k: list(range(2 + 6 * i, 8 + 6 * i)) for i, k in enumerate(KINDS)}}
    logs = {
        run: sdpid.read_recording(folder / f"{run}.csv", columns=columns, effort_scale=GAINS)
        for run in UR10E
    }
    robot = sdpid.load_robot(folder / "ur10e.urdf")
    for run, log in logs.items():
        yield f"UR10e, {run[6:]}", robot, log, {k: v for k, v in logs.items() if k != run}


def measure(robot_name: str, case: Case) -> tuple[list[Joint], list[tuple[str, str, float, float]]]:
    """Return what became of every joint's grade, and (robot, case, share, width) of the bands.

    The share is that of moving rows within the bands; the width is the median over joints of the
    mean half-width over the rms error there, 1.96 for normal errors that are known.
    """
    title, robot, log, others = case
    joints, bands = [], []
    blind = sdpid.identify(robot, log, intervals=False)
    told = {each.joint: each for each in grades(blind.estimate, blind.training, blind.held_out)}
    room = left_room(blind.estimate)
    prepared = prepare(robot, log)
    for label, other in others.items():
        shown = hold_out(blind.estimate, blind.wls, prepared.others(other).samples)
        assert shown is not None
        fit, samples = shown.fit, shown.samples
        own = blind.training if blind.held_out is None else blind.held_out.fit
        where = f"{title}{' → ' if label else ''}{label[6:]}"
        for each in graded(samples, fit):
            j = each.joint
            joints.append(
                Joint(
                    robot_name,
                    where,
                    robot.joint_names[j],
                    told[j].level == "good",
                    float(own.moving.r2[j]),
                    float(own.moving.nrmse[j]),
                    room[j] == "good",
                    each.level == "good",
                )
            )
        moving = moving_rows(samples)
        band = fit.effort_band
        assert band is not None
        inside = np.abs(samples.effort - fit.effort_predicted) <= band
        width = np.where(moving, band, 0.0).sum(axis=0) / np.maximum(moving.sum(axis=0), 1)
        bands.append(
            (
                robot_name,
                where,
                float(inside[moving].mean()),
                float(np.median(width / fit.moving.rmse)),
            )
        )
    return joints, bands


def kept(joints: Iterable[Joint], margin: float | None = None) -> dict[str, tuple[int, int]]:
    """Return for each robot how many joints were trusted, and how many of them kept it.

    With the default grade, or with another margin; with 1 without room for other motion too.
    """
    found: dict[str, list[int]] = defaultdict(lambda: [0, 0])
    for each in joints:
        trusted = each.trusted
        if margin is not None:
            level = level_of(1.0 - margin**2 * (1.0 - each.r2), margin * each.nrmse)
            trusted = level == "good" and (each.room or margin == 1.0)
        found[each.robot][0] += trusted
        found[each.robot][1] += trusted and each.kept
    return {robot: (trusted, held) for robot, (trusted, held) in found.items()}


def tables(joints: list[Joint], bands: list[tuple[str, str, float, float]]) -> str:
    """Return the results as Markdown."""
    robots = list(dict.fromkeys(each.robot for each in joints))
    lines = [
        "| trusted where | " + " | ".join(robots) + " | all |",
        "|---|" + "---|" * (len(robots) + 1),
    ]
    rows = {"default": kept(joints)}
    rows["by blocks alone"] = kept(joints, 1.0)
    rows |= {f"with a margin of {m:g}": kept(joints, m) for m in MARGINS[1:]}
    for label, found in rows.items():
        every = tuple(sum(pair[k] for pair in found.values()) for k in (0, 1))
        cells = [_share(*found[robot]) for robot in robots]
        lines.append(f"| {label} | " + " | ".join((*cells, _share(*every))) + " |")
    lines += ["", "| left out | margin that the others choose | it then keeps |", "|---|---|---|"]
    for robot in robots:
        chosen = _chosen(each for each in joints if each.robot != robot)
        lines.append(f"| {robot} | {chosen:g} | {_share(*kept(joints, chosen)[robot])} |")
    lines += [
        "",
        "| set | moving rows within 95 % bands | lowest | highest | width |",
        "|---|" + "---|" * 4,
    ]
    for robot in robots:
        own = [(share, width) for name, _, share, width in bands if name == robot]
        shares = [share for share, _ in own]
        inside = BANDS[0] <= float(np.mean(shares)) <= BANDS[1]
        lines.append(
            f"| {robot} | {np.mean(shares):.1%}{'' if inside else ' (outside the limits)'} | "
            f"{min(shares):.1%} | {max(shares):.1%} | {np.median([w for _, w in own]):.2f} |"
        )
    lost = [each for each in joints if each.trusted and not each.kept]
    lines += [
        "",
        "Trusted and not kept: " + ("; ".join(f"{e.case}: {e.name}" for e in lost) or "none"),
    ]
    return "\n".join(lines) + "\n"


def _chosen(joints: Iterable[Joint]) -> float:
    """Return the smallest margin with which every robot keeps its share of grades."""
    joints = list(joints)
    for margin in MARGINS:
        pairs = kept(joints, margin).values()
        if all(held >= KEPT * trusted for trusted, held in pairs):
            return margin
    return MARGINS[-1]


def _share(trusted: int, held: int) -> str:
    """Return how many were kept of how many, in words."""
    return f"{held} of {trusted}" + (f" ({held / trusted:.0%})" if trusted else "")


def main() -> int:
    """Measure and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--data", type=Path, default=os.environ.get("SDPID_DATA"))
    parser.add_argument("--set", action="append", choices=tuple(TITLES), help="a set (default all)")
    parser.add_argument("--quick", action="store_true", help="two robots")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    names = [
        name
        for name in options.set or (QUICK if options.quick else TITLES)
        if options.data is not None and (options.data / name).is_dir()
    ]
    text = "Nothing to show: no data.\n"
    joints: list[Joint] = []
    bands: list[tuple[str, str, float, float]] = []
    for robot, case in cases(options.data, names) if names else ():
        found = measure(robot, case)
        joints += found[0]
        bands += found[1]
        for _, where, share, width in found[1]:
            print(f"{where}: {share:.1%} within the bands, width {width:.2f}", flush=True)
    if joints:
        text = f"Margin in use: {MARGIN:g}.\n\n{tables(joints, bands)}"
        header = tuple(Joint.__dataclass_fields__)
        rows = tuple(tuple(vars(each).values()) for each in joints)
        Table(header, rows).write(options.out / "grades.csv")
    atomic_write_text(options.out / "grades.md", text)
    print(f"\n{text}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
