"""DriveNumbers from positions under a known law, on simulated robots whose truth is known.

An arm of four joints, a leg of three and a quadruped that hangs (the Go2 of the public records).
Their links differ from the description by some percent. Delay, friction, encoder and rate vary.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d
from study import Study

import sdpid
from sdpid.estimation.positions.drives import DriveNumbers
from sdpid.estimation.positions.rollout import CommandedLog
from sdpid.experiment.simulation.law import DriveCommands
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.dynamics import RobotDynamics

BODY = """<body name="link{k}" pos="{pos}"><joint name="joint{k}" axis="{axis}"/>
<inertial pos="{com}" mass="{mass}" diaginertia="{inertia}"/>{rest}</body>"""
LINKS = {
    "leg": [
        ("0 0 0", "1 0 0", "0 .05 0", 0.7, "9e-4 6e-4 6e-4"),
        ("0 .1 0", "0 1 0", "0 0 -.06", 1.2, "6e-3 6e-3 1e-3"),
        ("0 0 -.21", "0 1 0", "0 0 -.14", 0.24, "1.5e-3 1.5e-3 8e-5"),
    ],
    "arm": [
        ("0 0 .1", "0 0 1", "0 .02 .05", 2.5, "1e-2 1e-2 6e-3"),
        ("0 0 .1", "0 1 0", ".01 0 .15", 2.0, "2e-2 2e-2 3e-3"),
        ("0 0 .3", "0 1 0", "0 .01 .12", 1.2, "8e-3 8e-3 1e-3"),
        ("0 0 .25", "0 1 0", "0 0 .06", 0.5, "1e-3 1e-3 4e-4"),
    ],
}
GAINS = {"leg": (20.0, 1.5), "arm": (400.0, 20.0), "quadruped": (20.0, 1.5)}
KINDS = ("armature", "damping", "friction")
DELAYS = (12.0 * np.arange(20) / 19.0).round(2).tolist()  # ms
COLUMNS = (
    *("robot", "delay_ms", "rate_hz", "noise", "position_friction", "seed", "complete", "found"),
    *(
        "delay_error_ms",
        "delay_width_ms",
        "delay_held",
        "held",
        "of",
        "sharp_held",
        "slope",
        "ended",
    ),
)


def robot_of(name: str, data: Path) -> sdpid.RobotModel:
    """Return a robot whose base is held."""
    if name == "quadruped":
        return sdpid.load_robot(data / "go2_hung" / "go2.xml")
    text = ""
    for k, (pos, axis, com, mass, inertia) in reversed([*enumerate(LINKS[name], 1)]):
        fields = {"pos": pos, "axis": axis, "com": com, "mass": mass, "inertia": inertia}
        text = BODY.format(k=k, rest=text, **fields)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}.xml"
        path.write_text(f"<mujoco><worldbody>{text}</worldbody></mujoco>", encoding="utf-8")
        return sdpid.load_robot(path)


def commanded(n: int, seconds: float, rate: float, middle: np.ndarray) -> tuple:
    """Return times and commands in steps of 20 ms along chirps."""
    time = np.arange(int(seconds * rate)) / rate
    held = np.floor(time * 50.0 + 1e-9) / 50.0
    phase = 2.0 * held + 0.35 * held**2
    angle = [0.3 * np.sin(phase + 0.9 * j) + 0.15 * np.sin(2.3 * phase + j) for j in range(n)]
    return time, middle + np.stack(angle, axis=1)


def simulated(case: tuple, data: Path) -> tuple[sdpid.RobotModel, sdpid.Recording, DriveNumbers]:
    """Return a robot, its log and the true drives."""
    name, delay, rate, noise, bent, seed = case
    robot, rng = robot_of(name, data), np.random.default_rng(seed)
    n = robot.n
    middle = np.tile([0.2, 0.8, -1.7], 4) if name == "quadruped" else np.full(n, 0.3)
    time, command = commanded(n, 14.0, rate, middle)
    bodies = np.array(robot.prior) * (1.0 + 0.05 * rng.standard_normal((robot.n_links, 1)))
    terms = FrictionModel.from_terms((), robot.joint_names)
    links = RobotDynamics(robot=robot, terms=terms, theta=bodies.ravel())
    kp, kd = GAINS[name]
    drives = DriveNumbers(values=np.zeros((8, n)), middle=middle, delay=1e-3 * delay).with_rows(
        armature=rng.uniform(0.008, 0.03, n) * (6.0 if name == "arm" else 1.0),
        damping=rng.uniform(0.1, 0.5, n),
        friction=rng.uniform(0.2, 0.6, n),
        slope=rng.uniform(-0.6, 0.6, n) if bent else 0.0,
        kp=kp,
        kd=kd,
    )
    limit = np.full(n, np.inf)
    commands = DriveCommands(
        command=command, feedforward=0.0 * command, limit=limit, held=True, note=""
    )
    start = np.stack([command[0], np.zeros(n)])
    followed = CommandedLog(
        time=time,
        position=gaussian_filter1d(command, 0.02 * rate, axis=0),
        commands=commands,
    )
    rollout = followed.rollout(links)
    # Links move along the commands at first, then along the motion itself.
    for _ in range(2):
        position = rollout.positions(rollout.run(drives, start))
        rollout = replace(followed, position=position).rollout(links)
    position = rollout.positions(rollout.run(drives, start))
    position = position + noise * rng.standard_normal(position.shape)
    counts = 2.0 * np.pi / 2**16
    position = counts * np.round(position / counts)
    names = robot.joint_names
    log = sdpid.Recording(time=time, position=position, reference=command, joint_names=names)
    return robot, log, drives


def rows_of(case: tuple, data: Path) -> Iterator[tuple]:
    """Yield what is found of one log, beside the truth."""
    robot, log, truth = simulated(case, data)
    kp, kd = GAINS[case[0]]
    law = sdpid.controllers.PD(kp=kp, kd=kd)
    try:
        found = sdpid.identify(robot, log, law=law, intervals=False).drives
    except sdpid.errors.SdpidError as error:
        yield (*case, *[None] * (len(COLUMNS) - len(case) - 1), str(error)[:80])
        return
    intervals, held = found.intervals(), []
    known = {kind: truth[kind] for kind in KINDS} | {"slope": truth["slope"]}
    # Levels are about the middle of the fit's range.
    known["friction"] = truth["friction"] + truth["slope"] * (found.rich.middle - truth.middle)
    for kind in found.kinds:
        for j in range(robot.n):
            _, low, high = intervals[f"{kind}{j + 1}"]
            if high > low and kind in known:
                held.append(bool(low <= known[kind][j] <= high))
    low, high = found.delay_interval
    sharp = []
    for j, (value, deviation, _) in enumerate(found.sharp().values()):
        damping = truth["damping"][j] + kp * truth.delay
        own = known["friction"][j] + damping * found.speed[j]
        sharp.append(bool(abs(own - value) <= 1.96 * deviation))
    yield (
        *case,
        *(found.complete, "+".join(found.kinds[3:]) or "constants"),
        *(1e3 * (found.delay - truth.delay), 1e3 * (high - low), low <= truth.delay <= high),
        *(sum(held), len(held), float(np.mean(sharp))),
        float(np.abs(found.rich["slope"] - truth["slope"]).max()),
        "",
    )


def case_of(robot: str, seed: int) -> tuple:
    """Return one of the logs of a robot: each has other conditions."""
    rate = (100.0, 200.0, 500.0, 1000.0)[seed // 2 % 4]
    noise = (1e-5, 1e-4, 5e-4)[seed % 3]
    return robot, DELAYS[7 * seed % len(DELAYS)], rate, noise, seed % 2 == 1, seed


def main() -> None:
    """Run the cases."""
    study = Study(
        __doc__,
        quick={"logs": 2, "robots": ["leg"]},
        data=True,
        logs=(20, "of each robot"),
        robots=["arm", "leg", "quadruped"],
    )
    cases = [case_of(robot, seed) for seed in range(study.logs) for robot in study.robots]
    rows = study.rows("logs.csv", COLUMNS, lambda *case: rows_of(case, study.data), cases, digits=4)
    totals = []
    for robot in study.robots:
        own = [row for row in rows if row["robot"] == robot and not row["ended"]]
        held = sum(row["held"] for row in own) / max(sum(row["of"] for row in own), 1)
        errors = [abs(row["delay_error_ms"]) for row in own]
        right = [(row["found"] != "constants") == row["position_friction"] for row in own]
        delays = np.mean([row["delay_held"] for row in own])
        sharp = np.mean([row["sharp_held"] for row in own])
        totals.append((robot, len(own), held, delays, sharp, max(errors), np.mean(right)))
    names = (
        "robot",
        "logs",
        "held",
        "delay_held",
        "sharp_held",
        "delay_error_ms",
        "friction_right",
    )
    study.write("totals.csv", names, totals, digits=4)


if __name__ == "__main__":
    main()
