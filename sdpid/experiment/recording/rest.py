"""Tell joints that move from joints that rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sdpid._common.arrays import Array

# A joint whose position stays within this (rad, or m) does not move: that is a hand's width of
# encoder counts, and no motion that shows an inertia. Held joints of a UR10e whose other joints
# move stay within 5e-4 rad.
AT_REST = 1e-3
# A joint that moves by less than this share of the joint that moves most is dragged along by it.
_DRAGGED = 0.01


def moving(low: Array, high: Array) -> NDArray[np.bool_]:
    """Return which joints move on their own, (n,).

    Parameters
    ----------
    low, high : (n,) ndarray
        Least and largest position of each joint, rad (m).
    """
    reach = high - low
    return np.asarray(reach > max(AT_REST, _DRAGGED * float(reach.max(initial=0.0))))
