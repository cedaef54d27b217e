"""What was recorded: samples, motion, contacts, excitation, processing, and the model."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from sdpid._common.arrays import Mask
from sdpid.assurance.diagnostics.causes import period
from sdpid.estimation.information import WEAK
from sdpid.experiment.processing.samples import Samples
from sdpid.output.report.kinds import percent
from sdpid.output.report.subject import VerdictSubject
from sdpid.robot.model.model import RobotModel

# Weakly excited directions that are listed one by one; more say no more.
_DIRECTIONS = 12

# What is drawn of contacts: seconds of every piece, and pieces; some strides tell the gait. Of a
# picture its width and that of the names, in its own units.
_SECONDS, _PIECES = 6.0, 8
_WIDTH, _NAMES = 1000.0, 190.0

# Of joints that turn, and of those that slide.
_UNITS = {
    "position": ("rad", "m"),
    "velocity": ("rad/s", "m/s"),
    "acceleration": ("rad/s²", "m/s²"),
    "effort": ("N·m", "N"),
}


def values(of: VerdictSubject) -> dict[str, Any]:
    """Return the values of the template."""
    result, problem = of.result, of.problem
    weak = problem.excitation.weak()
    parts = {"training": problem.samples}
    if result.validation_samples is not None:
        parts["validation"] = result.validation_samples
    gait = [each for title, samples in parts.items() for each in _pictures(title, samples)]
    # What the inspection found stands in a table of its own.
    found = {str(finding) for finding in result.findings}
    bias = result.bias_note if result.bias is None else result.bias.verdict
    notes = (*problem.samples.notes, *result.notes, *([] if bias is None else [bias]))
    return {
        "data": list(_data(of, list(parts.values()))),
        "driven": list(driven(of)),
        "units": units(of.robot),
        "excitation": problem.excitation,
        "weak": weak[::-1],
        "weak_shown": weak[::-1][:_DIRECTIONS],
        "gains": problem.samples.gains,
        "weak_limit": WEAK,
        "processed": [note for note in dict.fromkeys(notes) if note not in found],
        "friction": [_term(term) for term in problem.friction.described()],
        # Over 1 where rows are on a cluster: how many samples each one here stands for.
        "thinned": max(round(problem.n_samples / max(problem.samples.n_samples, 1)), 1),
        "gait": gait[:_PIECES],
        "gait_more": max(len(gait) - _PIECES, 0),
    }


def driven(of: VerdictSubject) -> Iterator[dict[str, Any]]:
    """Yield range, peak speed, peak acceleration and RMS effort of every joint, and its limits."""
    samples, robot = of.problem.samples, of.robot
    shift = samples.position.shape[1] - robot.n
    for j, name in enumerate(robot.joint_names):
        effort, allowed = samples.effort[samples.used[:, j], j], float(robot.velocity_limits[j])
        q = samples.position[:, j + shift] if j >= robot.n_base else None
        yield {
            "name": name,
            "low": None if q is None else float(q.min()),
            "high": None if q is None else float(q.max()),
            "speed": float(np.abs(samples.velocity[:, j]).max()),
            "allowed": allowed if np.isfinite(allowed) else None,
            "acceleration": float(np.abs(samples.acceleration[:, j]).max()),
            "effort": float(np.sqrt(np.mean(effort**2))) if len(effort) else None,
        }


def _data(of: VerdictSubject, parts: list[Samples]) -> Iterator[tuple[str, list[str]]]:
    """Yield facts about the recordings: a label, and a value for each recording."""
    counts = [(of.problem.n_samples, of.problem.n_rows)]
    counts += [(fresh.n_samples, fresh.n_rows) for fresh in parts[1:]]
    yield "samples", [f"{samples:,}" for samples, _ in counts]
    yield "rows used", [f"{rows:,} of {samples * of.robot.n:,}" for samples, rows in counts]
    yield "rate", [_rate(s, count) for s, (count, _) in zip(parts, counts, strict=True)]
    yield "duration", ["–" if s.time is None else f"{_seconds(s):.5g} s" for s in parts]
    if any(len(s.starts) > 1 for s in parts):
        yield "pieces, recorded apart", [str(len(s.starts)) for s in parts]
    if any(s.periods is not None for s in parts):
        yield "periods averaged", ["–" if s.periods is None else str(s.periods) for s in parts]
    # How long each contact is closed, and how many are at once.
    touching = [
        {} if c is None else dict(zip(c.frames, c.down.T, strict=True))
        for c in (s.contacts for s in parts)
    ]
    for frame in dict.fromkeys(name for down in touching for name in down):
        shares = [percent(down[frame].mean()) if frame in down else "–" for down in touching]
        yield f"{frame} closed, with the filter's memory", shares
    if any(s.contacts is not None for s in parts):
        yield "contacts closed at once", [_at_once(s) for s in parts]


def _at_once(samples: Samples) -> str:
    """Return the share of time in which each number of contacts is closed, in words."""
    if samples.contacts is None:
        return "–"
    shares = np.bincount(samples.contacts.down.sum(axis=1)) / samples.n_samples
    return ", ".join(f"{k}: {percent(share)}" for k, share in enumerate(shares) if share > 0.0)


def _rate(samples: Samples, count: int) -> str:
    """Return the sample rate in words; of `count` samples these are all, or evenly spread."""
    if samples.time is None:
        return "–"
    if count == samples.n_samples:
        return f"{1.0 / period(samples):.5g} Hz"
    return f"{count / _seconds(samples):.4g} Hz"


def _seconds(samples: Samples) -> float:
    """Return how long samples are; the last of a piece lasts as long as the others."""
    assert samples.time is not None
    pieces = [samples.time[part] for part in samples.parts]
    return sum(float(piece[-1] - piece[0]) + period(samples) for piece in pieces)


def _term(described: dict[str, Any]) -> str:
    """Return a friction term, its parameters and its numbers in words."""
    names = described["parameters"]
    numbers = [", ".join(names) if len(names) < 4 else f"{names[0]} to {names[-1]}"]
    for key, value in described.items():
        # Bodies that columns were taken at are those of the estimate, which stand in a table.
        if key in ("term", "parameters", "bodies") or value in (None, 0.0, [], ()):
            continue
        many = value if isinstance(value, (list, tuple)) else [value]
        shown = (f"{v:.3g}" if isinstance(v, float) else str(v) for v in many)
        numbers.append(f"{key.replace('_', ' ')} {', '.join(shown)}")
    return f"{described['term']} ({'; '.join(numbers)})"


def units(robot: RobotModel) -> dict[str, str]:
    """Return the units of the joints' motion and efforts, several where some joints slide."""
    kinds = dict.fromkeys(robot.slides[robot.n_base :].tolist())
    return {what: ", ".join(both[slides] for slides in kinds) for what, both in _UNITS.items()}


def _pictures(title: str, samples: Samples) -> Iterator[dict[str, Any]]:
    """Yield a picture of contacts over time for each piece in which something is touched."""
    contacts, step, several = samples.contacts, period(samples), len(samples.parts) > 1
    if contacts is None or samples.time is None:
        return
    for number, part in enumerate(samples.parts, start=1):
        count = min(part.stop - part.start, max(int(_SECONDS / step), 1))
        down = contacts.down[part.start : part.start + count].T
        # The joints of a loop are always together.
        rows = [
            (name, list(_bars(closed)))
            for name, other, closed in zip(contacts.frames, contacts.against, down, strict=True)
            if other is None and closed.any()
        ]
        if rows:
            yield {
                "title": f"{title}, recording {number}" if several else title,
                "seconds": count * step,
                "whole": count == part.stop - part.start,
                "width": _WIDTH,
                "rows": rows,
            }


def _bars(closed: Mask) -> Iterator[tuple[float, float]]:
    """Yield where the stretches in which a contact is closed begin in a picture, and how wide."""
    steps = np.diff(closed.astype(np.int8), prepend=0, append=0)
    scale = (_WIDTH - _NAMES) / len(closed)
    first, behind = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)
    for a, b in zip(first.tolist(), behind.tolist(), strict=True):
        yield _NAMES + scale * a, scale * (b - a)
