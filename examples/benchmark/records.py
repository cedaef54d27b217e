"""The records of the benchmark: what is trained on, and what is asked of every tool."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE / "adapters"), str(HERE.parent / "evidence")]

from data_sets import EVERY  # noqa: E402
from held_out import STILL, Case, cases  # noqa: E402
from protocol import Rows, Task  # noqa: E402

import sdpid  # noqa: E402

# One case a robot; the TX40 twice, without the terms of its drives and with them.
TRAINED = {
    "UR10, first 60 %": "UR10",
    "Panda, first 60 %": "Panda",
    "LWR 4+, run 1": "LWR 4+",
    "TX40, first 60 %": "TX40",
    "TX40 with its terms, first 60 %": "TX40, wrist",
    "Gen3, run 1": "Gen3",
    "UR10e, 30 s": "UR10e",
}
SET = {
    "UR10": "ur10_unisa",
    "Panda": "panda_unisa",
    "LWR 4+": "kuka_lwr4plus",
    "TX40": "staubli_tx40",
    "TX40, wrist": "staubli_tx40",
    "Gen3": "kinova_gen3_dynamapp",
    "UR10e": "ur10e_innopolis",
}
WRIST = ("joint_5", "joint_6")

# Postures of the held-out motion at which the mass matrix is asked for, and speeds a direction at
# which friction is, from a share of the fastest that was trained on up to it.
POSTURES, SPEEDS, SLOWEST = 40, 8, 0.02
# No more rows are trained on and predicted than these; every so many is taken.
MOST_TRAINED, MOST_PREDICTED = 1000, 3000


@dataclass(frozen=True)
class Record:
    """A task, and what it is judged by.

    Attributes
    ----------
    arm : str
        Its name.
    task : Task
        What a tool is given.
    truth : ndarray, shape (K, n)
        Measured efforts of the held-out rows.
    moving : ndarray, shape (K, n)
        Which of them are of joints that move.
    parts : dict
        Slices of the asked rows: `trained`, `held_out`, `masses`, `friction`.
    speeds : ndarray, shape (speeds, n)
        Of the rows of friction, joint by joint.
    split : dict
        What is trained on and held out, in words, and a fingerprint of what was recorded: whoever
        has another one has other rows.
    """

    arm: str
    task: Task
    truth: np.ndarray
    moving: np.ndarray
    parts: dict[str, slice]
    speeds: np.ndarray
    split: dict[str, object]

    def __str__(self) -> str:
        return self.arm


def records(data: Path, arms: list[str]) -> list[Record]:
    """Return the records that are there; `cases` says which are not."""
    wanted = [case for case, arm in TRAINED.items() if arm in arms]
    names = list(dict.fromkeys(SET[arm] for arm in arms))
    found = {case.name: case for case in cases(data, names)}
    return [_record(TRAINED[name], found[name], data) for name in wanted if name in found]


def _rows(samples: Any) -> Rows:
    return Rows(samples.position, samples.velocity, samples.acceleration, samples.effort)


def _predicted(case: Case) -> dict[str, sdpid.Recording]:
    """Return the recordings that are predicted: not those where one joint of six moves."""
    return {label: other for label, other in case.others.items() if "alone" not in label}


def _fingerprint(logs: Iterable[sdpid.Recording]) -> str:
    """Return digits that tell recorded positions and efforts from others."""
    digest = hashlib.sha256()
    for log in logs:
        for values in (log.time, log.position, log.effort):
            digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()[:12]


def _held_out(case: Case) -> Rows:
    """Return the common rows behind the training part, or of the other recordings."""
    rows = [_rows(case.held_out(case.common, other)) for other in _predicted(case).values()]
    joined = [np.concatenate([getattr(r, k) for r in rows]) for k in vars(rows[0])]
    return _thinned(Rows(*joined), MOST_PREDICTED)


def _thinned(rows: Rows, most: int) -> Rows:
    every = -(-len(rows.position) // most)
    return Rows(*(getattr(rows, k)[::every] for k in vars(rows)))


def _record(arm: str, case: Case, data: Path) -> Record:
    log = {"time": case.log.time, "position": case.log.position, "effort": case.log.effort}
    if case.log.velocity is not None:
        log["velocity"] = case.log.velocity
    name = SET[arm]
    urdf = (data / name / EVERY[name].description).read_text(encoding="utf-8")
    common = _thinned(_rows(case.trained(case.common)), MOST_TRAINED)
    wrist = WRIST if "wrist" in arm else ()
    made = _assembled(arm, case.robot, urdf, log, case.scored_hz, common, _held_out(case), wrist)
    others = _predicted(case)
    words = {
        "set": name,
        "trained": case.name.partition(", ")[2],
        "predicted": ", ".join(others),
        "fingerprint": _fingerprint([case.log, *others.values()]),
    }
    return replace(made, split=words | made.split)


def _without_meshes(urdf: str) -> str:
    """Return a description without shapes, which some tools would look for."""
    root = ElementTree.fromstring(urdf)
    for link in root.iter("link"):
        for kind in ("visual", "collision"):
            for shape in link.findall(kind):
                link.remove(shape)
    return ElementTree.tostring(root, encoding="unicode")


def _assembled(
    arm: str,
    robot: Any,
    urdf: str,
    log: dict[str, np.ndarray],
    cutoff_hz: float,
    common: Rows,
    held: Rows,
    wrist: tuple[str, ...] = (),
) -> Record:
    masses, (friction, speeds) = _masses(held), _friction(common)
    pieces = {"trained": common, "held_out": held, "masses": masses, "friction": friction}
    motion = ("position", "velocity", "acceleration")
    asked = Rows(*(np.concatenate([getattr(r, k) for r in pieces.values()]) for k in motion))
    ends = np.cumsum([0, *(len(rows.position) for rows in pieces.values())])
    time = log["time"]
    task = Task(
        name=arm,
        urdf=_without_meshes(urdf),
        joints=tuple(robot.joint_names),
        rate_hz=float((len(time) - 1) / (time[-1] - time[0])),
        cutoff_hz=cutoff_hz,
        log=log,
        common=common,
        asked=asked,
        wrist=wrist,
    )
    assert held.effort is not None
    parts = {k: slice(int(a), int(b)) for k, a, b in zip(pieces, ends, ends[1:], strict=False)}
    counts = {"trained_rows": len(common.position), "held_out_rows": len(held.position)}
    moving = np.abs(held.velocity) > STILL
    split = {"cutoff_hz": cutoff_hz, **counts}
    return Record(arm, task, held.effort, moving, parts, speeds, split)


def _masses(held: Rows) -> Rows:
    """Return rows whose efforts tell the mass matrix: at rest, and with one joint accelerated."""
    picked = np.linspace(0, len(held.position) - 1, POSTURES).astype(int)
    n = held.position.shape[1]
    q = np.repeat(held.position[picked], n + 1, axis=0)
    a = np.tile(np.vstack([np.zeros(n), np.eye(n)]), (POSTURES, 1))
    return Rows(q, np.zeros_like(q), a)


def _friction(common: Rows) -> tuple[Rows, np.ndarray]:
    """Return rows whose efforts tell friction: at rest, then each joint alone at each speed.

    On a serial chain the effort of a joint that turns alone at a constant speed differs from that
    at rest by its friction: its own inertia does not depend on its own position.
    """
    n = common.position.shape[1]
    steps = np.geomspace(SLOWEST, 1.0, SPEEDS)
    fastest = np.abs(common.velocity).max(axis=0)
    speeds = np.concatenate([-steps[::-1], steps])[:, None] * fastest
    v = np.vstack([np.zeros((1, n)), *(np.diag(speed) for speed in speeds)])
    q = np.tile(common.position[0], (len(v), 1))
    return Rows(q, v, np.zeros_like(q)), speeds


def simulated_bodies(number: int) -> np.ndarray:
    """Return bodies (links, 10) of eight point masses each, which get lighter along the chain."""
    rng = np.random.default_rng(1)
    found = []
    for k in range(number):
        m = rng.uniform(0.2, 0.8, 8) / (1.0 + k)
        p = rng.uniform(-0.15, 0.15, (8, 3))
        second = (m[:, None, None] * p[:, :, None] * p[:, None, :]).sum(axis=0)
        about = np.trace(second) * np.eye(3) - second
        upper = about[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
        found.append([m.sum(), *(m @ p), *upper])
    return np.array(found)


def without_data() -> Record:
    """Return a small simulated record, for a quick run without data."""
    robot = sdpid.load_robot("denso_vp6242")
    rng = np.random.default_rng(0)
    time = np.arange(1200) / 100.0
    swing = rng.uniform(0.2, 0.6, (len(robot.joint_names), 3))
    speed = 2.0 * np.pi * np.array([0.1, 0.25, 0.4])
    angle = time[:, None, None] * speed + rng.uniform(0.0, 6.0, (len(robot.joint_names), 3))
    q = (swing / speed * np.sin(angle)).sum(axis=2)
    v, a = (swing * np.cos(angle)).sum(axis=2), -(swing * speed * np.sin(angle)).sum(axis=2)
    theta = simulated_bodies(robot.n_links).ravel()
    tau = robot.inverse_dynamics(theta, q, v, a) + np.sign(v) + 0.5 * v
    tau = tau + 0.05 * rng.standard_normal(tau.shape)
    trained, rest = slice(0, 800, 2), slice(800, None)
    log = {"time": time[:800], "position": q[:800], "effort": tau[:800]}
    common, held = (Rows(q[k], v[k], a[k], tau[k]) for k in (trained, rest))
    return _assembled("simulated", robot, robot.urdf, log, 10.0, common, held)
