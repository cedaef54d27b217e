"""Random generators from seeds, checked in one place."""

from __future__ import annotations

from numbers import Integral
from typing import Any

import numpy as np

from sdpid.errors import DataError


def generator(seed: Any) -> np.random.Generator:
    """Return the random generator of a seed; a generator is returned as it is.

    Raises
    ------
    DataError
        When the seed is no whole number from 0 on.
    """
    if isinstance(seed, np.random.Generator):
        return seed
    if isinstance(seed, bool) or not isinstance(seed, Integral) or seed < 0:
        raise DataError(
            f"seed: is {seed!r}; give a whole number from 0 on, or a numpy.random.Generator."
        )
    return np.random.default_rng(int(seed))
