"""Tell what noise in the motion, landings, filter and friction's law do to intervals, in words."""

from __future__ import annotations

import numpy as np

from sdpid.assurance.intervals.intervals import Intervals

# Above this share of the variance a bias is larger than all other errors together.
_MOST = 0.5

# What each bias does, and what makes intervals shorter.
_WORDS = {
    "motion": (
        "noise in the measured motion moves",
        "a lower cutoff_hz, or less noise in joint positions, makes them shorter",
    ),
    "landing": (
        "landings, where joint speeds jump, move",
        "a motion with fewer of them beside this one, or impact_s = 0, leaves them out",
    ),
    "filter": (
        "what the filter takes away moves",
        "a higher cut-off (cutoff_hz), or efforts with less noise, makes them shorter",
    ),
    "friction": (
        "a law of friction that is not the model's moves",
        "friction terms that bend as the robot's do make them shorter",
    ),
}


def noise_in_words(intervals: Intervals) -> str | None:
    """Return which base parameters biases move most; None where they move little."""
    base = np.array([kind == "base" for kind in intervals.kind])
    found = []
    for name, (what, remedy) in _WORDS.items():
        share = intervals.shares.get(name, np.zeros(len(base)))
        much = np.flatnonzero(base & (share > _MOST))
        if not len(much):
            continue
        most = int(much[np.argmax(share[much])])
        found.append(
            f"{what} {len(much)} of {np.count_nonzero(base)} base "
            f"parameters by more than all other errors (limit {100.0 * _MOST:.0f} % of the "
            f"variance), {intervals.names[most]} by {100.0 * share[most]:.0f} %: their intervals "
            f"are wider by that; {remedy}"
        )
    return "; ".join(found) or None
