"""Tell what noise in the motion, landings, filter and friction's law do to intervals, in words."""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.intervals.intervals import Intervals

# Above this share of the variance a bias is larger than all other errors together.
_MOST = 0.5


def noise_in_words(intervals: Intervals) -> str | None:
    """Return which base parameters biases move most; None where they move little."""
    found = [
        _moved(
            intervals,
            intervals.motion_share,
            "noise in the measured motion moves",
            "a lower cutoff_hz, or less noise in joint positions, makes them shorter",
        ),
        _moved(
            intervals,
            intervals.landing_share,
            "landings, where joint speeds jump, move",
            "a motion with fewer of them beside this one, or impact_s = 0, leaves them out",
        ),
        _moved(
            intervals,
            intervals.filter_share,
            "what the filter takes away moves",
            "a higher cut-off (cutoff_hz), or efforts with less noise, makes them shorter",
        ),
        _moved(
            intervals,
            intervals.friction_share,
            "a law of friction that is not the model's moves",
            "friction terms that bend as the robot's do make them shorter",
        ),
    ]
    return "; ".join(each for each in found if each) or None


def _moved(intervals: Intervals, share: Array | None, what: str, remedy: str) -> str | None:
    """Return what a bias moves by more than all other errors."""
    if share is None:
        return None
    base = np.array([kind == "base" for kind in intervals.kind])
    much = np.flatnonzero(base & (share > _MOST))
    if not len(much):
        return None
    most = int(much[np.argmax(share[much])])
    return (
        f"{what} {len(much)} of {np.count_nonzero(base)} base "
        f"parameters by more than all other errors (limit {100.0 * _MOST:.0f} % of the variance), "
        f"{intervals.names[most]} by {100.0 * share[most]:.0f} %: their intervals "
        f"are wider by that; {remedy}"
    )
