"""Tell what noise in the measured motion does to intervals, in words."""

from __future__ import annotations

import numpy as np

from sdpid.assurance.intervals.intervals import Intervals

# Above this share of the variance the bias is larger than all other errors together.
_MOST = 0.5


def noise_in_words(intervals: Intervals) -> str | None:
    """Return which base parameters noise in the motion moves most; None where it moves little."""
    if intervals.motion_share is None:
        return None
    base = np.array([kind == "base" for kind in intervals.kind])
    much = np.flatnonzero(base & (intervals.motion_share > _MOST))
    if not len(much):
        return None
    most = int(much[np.argmax(intervals.motion_share[much])])
    return (
        f"noise in the measured motion moves {len(much)} of {np.count_nonzero(base)} base "
        f"parameters by more than all other errors (limit {100.0 * _MOST:.0f} % of the variance), "
        f"{intervals.names[most]} by {100.0 * intervals.motion_share[most]:.0f} %: their intervals "
        "are wider by that; a lower cutoff_hz, or less noise in joint positions, makes them shorter"
    )
