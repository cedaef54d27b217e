"""Which contacts were closed when: a bar a contact over the time of each recording."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from sdpid._common.arrays import Mask
from sdpid.assurance.diagnostics.residuals import period
from sdpid.experiment.processing.samples import Samples
from sdpid.output.report.judged import Judged

# What is drawn of every piece, s, and of how many pieces: some strides tell the gait.
_SECONDS, _PIECES = 6.0, 8

# Of a picture, in its own units: its width, that of the names, and the height of a row.
_WIDTH, _NAMES, _ROW = 1000.0, 190.0, 22.0


def values(result: Judged) -> dict[str, Any]:
    """Return the values of the template."""
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
