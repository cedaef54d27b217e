"""The verdict in three sentences, and the estimate beside what costs less."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from sdpid.output.report.finding import Finding
from sdpid.output.report.grades import LEVELS, Level
from sdpid.output.report.headline import headline
from sdpid.output.report.judged import Judged
from sdpid.output.report.verdict import findings


def values(result: Judged) -> dict[str, Any]:
    """Return the values of the template."""
    every = findings(result)
    return {
        "headline": headline(result),
        "findings": every,
        "level": _worst(every),
        "held": result.held_out,
        "other_motion": result.held_out is not None and result.held_out.by == "recording",
        "beside": list(_beside(result)),
    }


def _worst(every: tuple[Finding, ...]) -> Level:
    """Return the worst level of some findings."""
    return min((each.level for each in every), key=LEVELS.index, default="caution")


def _beside(result: Judged) -> Iterator[dict[str, Any]]:
    """Yield the errors on what was held out of the baselines and of the estimate.

    Bars are logarithmic, from 0.1 % to 100 %.
    """
    if result.held_out is None:
        return
    every = result.held_out.every
    for name, fit in every.items():
        joints = zip(fit.moving.rmse.tolist(), fit.moving.rows.tolist(), strict=True)
        yield {
            "name": name,
            "ours": fit is result.held_out.fit,
            "moving": fit.told.relative,
            "length": float(np.clip(1.0 + np.log10(max(fit.told.relative, 1e-9)) / 3.0, 0.0, 1.0)),
            "resting": None if fit.resting is None else fit.resting.relative,
            "rmse": [value if rows else None for value, rows in joints][fit.n_base :],
        }
