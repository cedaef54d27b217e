"""What the motion of a standing robot comes to, beside its limits."""

from __future__ import annotations

import numpy as np

from sdpid.excitation.limits.check import LimitCheck, LimitRow
from sdpid.excitation.standing.held import Held, Quantity
from sdpid.excitation.standing.plan import RATE_HZ, sampled
from sdpid.experiment.trajectory.curve import Curve

# Feet miss their places by no more, m and rad.
_MISS = 1e-9


def check_standing(held: Held, curve: Curve) -> LimitCheck:
    """Return what a motion comes to, 500 times a second.

    Parameters
    ----------
    held : Held
        The limits.
    curve : Curve
        Motion of the coordinates.
    """
    time, states = sampled(held.stance, curve)
    quantities: list[Quantity] = [*held.quantities(states)]
    quantities.append(("miss", "feet", "m", states.poses.miss, -np.inf, _MISS))
    rows = []
    for kind, subject, unit, values, low, high in quantities:
        for side, limit, k in (
            ("lower", low, int(np.argmin(values))),
            ("upper", high, int(np.argmax(values))),
        ):
            if not np.isfinite(limit):
                continue
            reached = float(values[k])
            slack = reached - limit if side == "lower" else limit - reached
            rows.append(
                LimitRow(
                    kind=kind,
                    subject=subject,
                    side="lower" if side == "lower" else "upper",
                    limit=float(limit),
                    worst=reached,
                    reached=reached,
                    time=float(time[k]),
                    slack=slack,
                    unit=unit,
                    verdict="held" if slack >= 0.0 else "broken",
                )
            )
    notes = (
        *held.joints.assumed,
        f"limits were checked {RATE_HZ:g} times a second, not between.",
        "whether legs touch each other or the body was not checked.",
    )
    return LimitCheck(rows=tuple(rows), notes=notes)
