"""Arrays and seeds as arguments: converted once, checked once, then read-only."""

from __future__ import annotations

from numbers import Integral, Real
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import NDArray

from sdpid.errors import DataError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]


def frozen(values: Any) -> Array:
    """Return a copy of `values` as a read-only float64 array."""
    array = np.array(values, dtype=np.float64, order="C")
    array.setflags(write=False)
    return array


def frozen_view(array: NDArray[Any]) -> Any:
    """Return a read-only view of an array that is too large to copy."""
    view = array.view()
    view.setflags(write=False)
    return view


def real_array(
    values: Any,
    name: str,
    *,
    ndim: int,
    error: type[Exception] = DataError,
    infinite: bool = False,
) -> Array:
    """Convert to float64, or say which argument is ragged, not numeric, or not finite.

    Parameters
    ----------
    values : array_like
        The values.
    name : str
        What it is called in the message.
    ndim : int
        The number of axes it must have.
    error : type of Exception, optional
        The class to raise.
    infinite : bool, optional
        Whether infinity is a value too.

    Returns
    -------
    ndarray of float64
        With `ndim` axes, every entry finite (with `infinite`, none NaN).

    Raises
    ------
    DataError
        Or `error`, when the values are ragged, not real numbers, of another dimension, or not
        finite; the first offending index is named.
    """
    try:
        array = np.asarray(values)
        if array.dtype.kind == "c":
            raise TypeError("complex values")
        array = array.astype(np.float64, copy=False)
    except (TypeError, ValueError, OverflowError) as cause:
        message = f"{name}: not a rectangular array of real numbers ({cause}); give numbers only."
        raise error(message) from None
    if array.ndim != ndim:
        raise error(f"{name}: has {array.ndim} axes (shape {array.shape}), expected {ndim}.")
    finite = ~np.isnan(array) if infinite else np.isfinite(array)
    if not finite.all():
        first = tuple(int(i) for i in np.argwhere(~finite)[0])
        count = int(array.size - np.count_nonzero(finite))
        raise error(
            f"{name}: {count} of {array.size} values are not finite, the first at index {first} "
            f"({array[first]}); remove or repair those samples."
        )
    return array


def shaped(
    values: Any, name: str, shape: tuple[int, ...], what: str = "", *, infinite: bool = False
) -> Array:
    """Return a read-only array of a shape, see `real_array`; `what` says what stands where."""
    array = real_array(values, name, ndim=len(shape), infinite=infinite)
    if array.shape != shape:
        raise DataError(f"{name}: has shape {array.shape}, expected {shape}{what}.")
    return frozen(array)


def is_number(value: object) -> TypeGuard[float]:
    """Whether a value is a real number, of any type but bool."""
    return isinstance(value, Real) and not isinstance(value, bool | np.bool_)


def require_probability(value: Any, what: str) -> None:
    """Raise DataError when a value is not a number between 0 and 1, ends excluded."""
    if not is_number(value) or not 0.0 < value < 1.0:
        raise DataError(f"{what} is {value!r:.80}; give a probability between 0 and 1.")


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
