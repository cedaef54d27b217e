"""Whether grades and bands that `identify` gives by default hold on another recording.

Each recording of six real robots is identified with defaults, without hints, and predicts another
recording, or the other part of the only one. A joint that is trusted on its own blocks keeps its
grade where the other recording gives it too. The table of margins shows what each margin between
blocks and other motion would have trusted and kept, room for other motion asked for as by default.
The table of bands shows the share of moving rows of the other recording within the 95 % bands.

    python examples/evidence/grades.py --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from data_sets import EVERY, Records, cut, records_of
from held_out import QUICK, ur10e_logs
from study import Rows, Study, grouped

import sdpid
from sdpid.assurance.diagnostics.held_out import hold_out
from sdpid.assurance.diagnostics.rest import moving_rows
from sdpid.experiment.preparation.prepare import prepare
from sdpid.output.report.subject import graded, grades, left_room, level_of

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

# Share of rows within 95 % bands.
BANDS = (0.90, 0.98)


# Of a joint: whether the default grade without other motion is "good", by r2 and nrmse of blocks
# held out; whether the parameters leave room for other motion, a "good" error on random motion
# within the recorded range; whether the other recording's grade is "good". Of its case: the share
# of moving rows within the bands, and their width: the median over joints of the mean half-width
# over the rms error there, 1.96 for normal errors that are known.
CELL = ("robot", "case", "joint", "trusted", "r2", "nrmse", "room", "kept", "inside", "width")

Joint = Mapping[str, Any]
Case = tuple[str, sdpid.RobotModel, sdpid.Recording, dict[str, sdpid.Recording]]


def cases(arm: Records) -> Iterator[Case]:
    """Yield cases: a title, the robot, a recording, and others by name."""
    if not arm.runs:
        # Each recording predicts all others.
        logs = dict(zip(UR10E, ur10e_logs(arm.folder, UR10E), strict=True))
        for run, log in logs.items():
            yield f"UR10e, {run[6:]}", arm.robot, log, {k: v for k, v in logs.items() if k != run}
        return
    for effort in arm.efforts:
        first, *more = arm.logs(effort)
        if more:
            pairs = {"run 1 → 2": (first, *more), "run 2 → 1": (*more, first)}
        else:
            pairs = {}
            for share in CUTS:
                begin, rest = cut(first, share)
                pairs[f"first {share:.0%} → rest"] = begin, rest
                pairs[f"rest → first {share:.0%}"] = rest, begin
        for title, (own, other) in pairs.items():
            label = "" if effort == "tau" else " currents"
            yield f"{arm}{label}, {title}", arm.robot, own, {"": other}


def measure(found: Mapping[str, tuple[str, Case]], title: str) -> Rows:
    """Yield what became of every joint's grade, and of the bands."""
    robot_name, (_, robot, log, others) = found[title]
    blind = sdpid.identify(robot, log, intervals=False)
    told = {each.joint: each for each in grades(blind.estimate, blind.training, blind.held_out)}
    room = left_room(blind.estimate)
    prepared = prepare(robot, log)
    for label, other in others.items():
        shown = hold_out(blind.estimate, blind.wls, prepared.others(other).samples)
        assert shown is not None
        fit, samples = shown.fit, shown.samples
        own = blind.training if blind.held_out is None else blind.held_out.fit
        moving, band = moving_rows(samples), fit.effort_band
        assert band is not None
        inside = np.abs(samples.effort - fit.effort_predicted) <= band
        width = np.where(moving, band, 0.0).sum(axis=0) / np.maximum(moving.sum(axis=0), 1)
        for each in graded(samples, fit):
            j = each.joint
            yield (
                robot_name,
                f"{title}{' → ' if label else ''}{label[6:]}",
                robot.joint_names[j],
                told[j].level == "good",
                own.moving.r2[j],
                own.moving.nrmse[j],
                room[j] == "good",
                each.level == "good",
                inside[moving].mean(),
                np.median(width / fit.moving.rmse),
            )


def trusted(joint: Joint, margin: float | None) -> bool:
    """Return whether a joint is trusted: by default, or with another margin.

    With a margin of 1 without room for other motion, too.
    """
    if margin is None:
        return bool(joint["trusted"])
    level = level_of(1.0 - margin**2 * (1.0 - joint["r2"]), margin * joint["nrmse"])
    return level == "good" and (joint["room"] or margin == 1.0)


def kept_rows(joints: Sequence[Joint], robots: Sequence[str]) -> Rows:
    """Yield how many of the trusted joints keep their grade, by the default and other margins."""
    labels = {"default": None, "by blocks alone": 1.0}
    labels |= {f"with a margin of {m:g}": m for m in MARGINS[1:]}
    for label, margin in labels.items():
        own = [each for each in joints if trusted(each, margin)]
        of_robots = [[each["kept"] for each in own if each["robot"] == name] for name in robots]
        yield label, *map(_share, (*of_robots, [each["kept"] for each in own]))


def band_rows(joints: Sequence[Joint]) -> Rows:
    """Yield the shares of moving rows within the bands."""
    of_cases = {(each["robot"], each["case"]): each for each in joints}.values()
    for (robot,), own in grouped(of_cases, "robot"):
        mean, width = own["inside"].mean(), np.median(own["width"])
        words = "" if BANDS[0] <= mean <= BANDS[1] else " (outside the limits)"
        ends = (f"{end:.1%}" for end in (own["inside"].min(), own["inside"].max()))
        yield robot, f"{mean:.1%}{words}", *ends, f"{width:.2f}"


def _share(kept: Sequence[bool]) -> str:
    """Return how many were kept of how many, in words."""
    words = f"{sum(kept)} of {len(kept)}"
    return f"{words} ({sum(kept) / len(kept):.0%})" if kept else words


def main() -> None:
    """Measure and write the tables."""
    study = Study(__doc__, data=True, quick={"sets": [*QUICK]}, sets=[*EVERY])
    found = {
        case[0]: (str(arm), case)
        for arm in records_of(study.data, study.sets)
        for case in cases(arm)
    }
    joints = study.rows("grades.csv", CELL, partial(measure, found), found)
    robots = [*dict.fromkeys(each["robot"] for each in joints)]
    study.write("kept.csv", ("trusted where", *robots, "all"), kept_rows(joints, robots))
    header = ("set", "moving rows within 95 % bands", "lowest", "highest", "width")
    study.write("bands.csv", header, band_rows(joints))


if __name__ == "__main__":
    main()
