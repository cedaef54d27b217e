"""What is to be known of identified gains, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.assurance.drive_gains.load import Load

# A gain whose error is more than this many times the joints' median, and this share, is weak.
_WEAK, _WEAK_SHARE = 1.5, 0.01
# The demand that bodies can exist moves gains by less than this many standard errors, or the
# currents contradict it.
_MOVED = 2.0
# Gains that are all between these, N·m/A, are told: torques that were made of a UR10e's currents
# came out at 0.93 to 1.03.
_LIKE_TORQUES = 0.8, 1.25
# Fewer blocks than this make intervals uncertain.
_FEW = 20


def basis_in_words(
    loads: Sequence[Load], known: Mapping[str, float] | None, description_error: float | None
) -> str:
    """Return what gives the scale of the gains."""
    found = []
    if loads:
        masses = dict.fromkeys(f"{load.mass:.4g} kg" for load in loads)
        found.append(f"a load of {' and '.join(masses)}")
    if known:
        found.append(
            "the known gain of "
            + ", ".join(f"{name} ({value:.4g} N·m/A)" for name, value in known.items())
        )
    if description_error is not None:
        found.append(f"the described links, each right to {100.0 * description_error:.3g} %")
    return " and ".join(found)


def notes_on(
    names: Sequence[str],
    gains: Array,
    unconstrained: Array,
    covariance: Array,
    free: Mask,
    loads: Sequence[Load],
    blocks: int,
) -> tuple[str, ...]:
    """Return notes on gains near 1, weak joints, errors in common, and what consistency changes.

    Parameters
    ----------
    names : sequence of str
        Of the joints.
    gains, unconstrained : ndarray, shape (n,)
        N·m/A.
    covariance : ndarray, shape (n, n)
        Of their logarithms.
    free : ndarray of bool, shape (n,)
        Which were not known.
    loads : sequence of Load
        The loads.
    blocks : int
        How many independent groups of samples the errors rest on.
    """
    found = []
    error = np.sqrt(np.diag(covariance))
    median = float(np.median(error[free])) if free.any() else 0.0
    for j in np.flatnonzero(free & (error > max(_WEAK * median, _WEAK_SHARE))).tolist():
        found.append(
            f"the gain of {names[j]} is weak: its error is {100.0 * error[j]:.2g} %, the joints' "
            f"median {100.0 * median:.2g} %; what is known changes its current least"
        )
    low, high = _LIKE_TORQUES
    if free.any() and np.all((gains[free] > low) & (gains[free] < high)):
        found.append(
            f"all gains are near 1 N·m/A ({gains[free].min():.2g} to {gains[free].max():.2g}), as "
            "if the efforts were torques in N·m already: check the columns and their unit; "
            "torques need no gains"
        )
    shift = np.abs(np.log(gains / unconstrained))
    moved = free & (shift > _MOVED * np.maximum(error, 1e-12)) & (shift > 1e-6)
    for j in np.flatnonzero(moved).tolist():
        found.append(
            f"links and loads that can exist move the gain of {names[j]} by "
            f"{100.0 * shift[j]:.2g} %, {shift[j] / error[j]:.2g} standard errors: the model, the "
            "load or a recording contradicts it"
        )
    told = {load.mass: load for load in loads if load.mass_error > 0.0}
    for load in told.values():
        share = 100.0 * load.mass_error / load.mass
        found.append(f"the mass of the load is known to {share:.2g} %: so are all gains together")
    if blocks < _FEW:
        found.append(
            f"the errors rest on {blocks} independent blocks of samples: record longer for "
            "narrower intervals"
        )
    return tuple(found)
