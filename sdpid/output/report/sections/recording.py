"""What was recorded: samples, motion, contacts, excitation, processing, findings, and the model."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from sdpid._common.arrays import Mask
from sdpid.assurance.diagnostics.causes import period
from sdpid.estimation.information import WEAK
from sdpid.experiment.processing.samples import Samples
from sdpid.output.report.judged import Judged
from sdpid.robot.model.coordinates import sliding
from sdpid.robot.model.model import RobotModel

# Weakly excited directions that are listed one by one; more say no more.
_DIRECTIONS = 12


def values(result: Judged) -> dict[str, Any]:
    """Return the values of the template."""
    problem = result.problem
    # What the inspection found stands in a table of its own.
    found = {str(finding) for finding in result.findings}
    bias = result.bias_note if result.bias is None else result.bias.verdict
    notes = (*problem.samples.notes, *result.notes, *([] if bias is None else [bias]))
    return {
        "data": list(_data(result)),
        "driven": list(driven(result)),
        "units": units(result.problem.robot),
        "excitation": _excitation(result),
        "gains": _gains(result),
        "weak_limit": WEAK,
        "processed": [note for note in dict.fromkeys(notes) if note not in found],
        "friction": [_term(term) for term in problem.friction.described()],
        **_gait(result),
    }


def _gains(result: Judged) -> dict[str, Any] | None:
    """Return the gains that made efforts of currents, joint by joint."""
    gains = result.problem.samples.gains
    if gains is None:
        return None
    ends = gains.intervals()
    return {
        "words": gains.in_words,
        "joints": [
            {"name": name, "gain": gain, "share": 100.0 * error / gain, "ends": own}
            for name, gain, error, own in zip(
                gains.joint_names,
                gains.gains.tolist(),
                gains.standard_errors.tolist(),
                ends.tolist(),
                strict=True,
            )
        ],
    }


def thinned(result: Judged) -> int:
    """Return how many samples each one here stands for: over 1 if rows are on a cluster."""
    problem = result.problem
    return max(round(problem.n_samples / max(problem.samples.n_samples, 1)), 1)


def driven(result: Judged) -> Iterator[dict[str, Any]]:
    """Yield range, peak speed, peak acceleration and RMS effort of every joint, and its limits."""
    samples, robot = result.problem.samples, result.problem.robot
    shift = samples.position.shape[1] - robot.n
    for j in range(robot.n):
        kept = samples.used[:, j]
        own = j >= robot.n_base
        q = samples.position[:, j + shift] if own else None
        speed = float(np.abs(samples.velocity[:, j]).max())
        allowed = float(robot.velocity_limits[j])
        yield {
            "name": robot.joint_names[j],
            "low": None if q is None else float(q.min()),
            "high": None if q is None else float(q.max()),
            "speed": speed,
            "speeds": (float(samples.velocity[:, j].min()), float(samples.velocity[:, j].max())),
            "allowed": allowed if np.isfinite(allowed) else None,
            "acceleration": float(np.abs(samples.acceleration[:, j]).max()),
            "effort": float(np.sqrt(np.mean(samples.effort[kept, j] ** 2))) if kept.any() else None,
        }


def _data(result: Judged) -> Iterator[tuple[str, list[str]]]:
    """Yield facts about the recordings: a label, and a value for each recording."""
    problem = result.problem
    parts = [problem.samples]
    counts = [(problem.n_samples, problem.n_rows)]
    rates = [_rate(problem.samples, problem.n_samples)]
    if (fresh := result.validation_samples) is not None:
        parts.append(fresh)
        counts.append((fresh.n_samples, fresh.n_rows))
        rates.append(_rate(fresh, fresh.n_samples))
    yield "samples", [f"{samples:,}" for samples, _ in counts]
    yield "rows used", [f"{rows:,} of {samples * problem.robot.n:,}" for samples, rows in counts]
    yield "rate", rates
    yield "duration", [_duration(s) for s in parts]
    if any(len(s.starts) > 1 for s in parts):
        yield "pieces, recorded apart", [str(len(s.starts)) for s in parts]
    if any(s.periods is not None for s in parts):
        yield "periods averaged", ["–" if s.periods is None else str(s.periods) for s in parts]
    yield from _contacts(parts)


def _contacts(parts: list[Samples]) -> Iterator[tuple[str, list[str]]]:
    """Yield how long each contact is closed, and how many are at once, in each recording."""
    given = [samples.contacts for samples in parts]
    for frame in dict.fromkeys(name for c in given if c is not None for name in c.frames):
        shares = [
            "–"
            if c is None or frame not in c.frames
            else f"{100.0 * float(c.down[:, c.frames.index(frame)].mean()):.3g} %"
            for c in given
        ]
        yield f"{frame} closed, with the filter's memory", shares
    if any(c is not None for c in given):
        yield "contacts closed at once", ["–" if c is None else _at_once(c.down) for c in given]


def _at_once(down: Mask) -> str:
    """Return the share of time in which each number of contacts is closed, in words."""
    shares = np.bincount(down.sum(axis=1)) / len(down)
    return ", ".join(f"{k}: {100.0 * share:.3g} %" for k, share in enumerate(shares) if share > 0.0)


def _rate(samples: Samples, count: int) -> str:
    """Return the sample rate in words; of `count` samples these are all, or evenly spread."""
    if samples.time is None:
        return "–"
    if count == samples.n_samples:
        return f"{1.0 / period(samples):.5g} Hz"
    return f"{count / _seconds(samples):.4g} Hz"


def _duration(samples: Samples) -> str:
    return "–" if samples.time is None else f"{_seconds(samples):.5g} s"


def _seconds(samples: Samples) -> float:
    # The last sample of a piece lasts as long as the others.
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
    joints = robot.joint_names[robot.n_base :]
    kinds = dict.fromkeys(sliding(robot.pin_model, joints).tolist())

    def joined(turning: str, length: str) -> str:
        return ", ".join(length if slides else turning for slides in kinds)

    return {
        "position": joined("rad", "m"),
        "velocity": joined("rad/s", "m/s"),
        "acceleration": joined("rad/s²", "m/s²"),
        "effort": joined("N·m", "N"),
    }


def _excitation(result: Judged) -> dict[str, Any]:
    """Return condition number and weakly excited directions."""
    excitation = result.problem.excitation
    weak = excitation.weak()
    return {
        "condition": excitation.condition_number,
        "count": len(excitation.names),
        "weak": weak[::-1][:_DIRECTIONS],
        "weak_count": len(weak),
    }


# What is drawn of every piece, s, and of how many pieces: some strides tell the gait.
_SECONDS, _PIECES = 6.0, 8

# Of a picture, in its own units: its width, that of the names, and the height of a row.
_WIDTH, _NAMES, _ROW = 1000.0, 190.0, 22.0


def _gait(result: Judged) -> dict[str, Any]:
    """Return the pictures of contacts."""
    pictures = list(_pictures("training", result.problem.samples))
    if result.validation_samples is not None:
        pictures += _pictures("validation", result.validation_samples)
    return {"gait": pictures[:_PIECES], "gait_more": max(len(pictures) - _PIECES, 0)}


def _pictures(title: str, samples: Samples) -> Iterator[dict[str, Any]]:
    """Yield a picture for each piece in which something is touched."""
    if samples.contacts is None or samples.time is None:
        return
    step, many = period(samples), len(samples.parts) > 1
    for number, part in enumerate(samples.parts, start=1):
        count = min(part.stop - part.start, max(int(_SECONDS / step), 1))
        down = samples.contacts.down[part.start : part.start + count]
        # The joints of a loop are always together.
        feet = [
            (name, down[:, i])
            for i, (name, other) in enumerate(
                zip(samples.contacts.frames, samples.contacts.against, strict=True)
            )
            if other is None and down[:, i].any()
        ]
        if not feet:
            continue
        rows = [
            {"name": name, "middle": (i + 0.5) * _ROW, "bars": list(_bars(own, i))}
            for i, (name, own) in enumerate(feet)
        ]
        yield {
            "title": f"{title}, recording {number}" if many else title,
            "seconds": count * step,
            "whole": count == part.stop - part.start,
            "height": len(rows) * _ROW,
            "width": _WIDTH,
            "left": _NAMES,
            "rows": rows,
        }


def _bars(down: Mask, row: int) -> Iterator[dict[str, float]]:
    """Yield the rectangles of the stretches in which a contact is closed."""
    steps = np.diff(down.astype(np.int8), prepend=0, append=0)
    first, behind = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)
    scale = (_WIDTH - _NAMES) / len(down)
    for a, b in zip(first.tolist(), behind.tolist(), strict=True):
        yield {
            "x": _NAMES + scale * a,
            "width": scale * (b - a),
            "y": (row + 0.15) * _ROW,
            "height": 0.7 * _ROW,
        }
