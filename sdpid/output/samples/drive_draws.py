"""Draws of drives that a fit of positions leaves possible, as arrays for simulators."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._common.arrays import Array
from sdpid.estimation.positions.drives import Unknowns
from sdpid.estimation.positions.law_fit import FittedDrives
from sdpid.output.robots.drive_files import OVER_POSITION

NAME = "drives_samples.npz"

# Draws that are written, and positions over which friction is averaged.
_DRAWS, _POSITIONS = 500, 200

# Rounds over all directions. Where no bound is near, the first one draws independently.
_ROUNDS = 15


def truncated_normal(
    mean: Array, covariance: Array, low: Array, high: Array, start: Array, *, seed: int = 0
) -> Array:
    """Return draws (K, k) of normal distributions within bounds, by Gibbs sampling.

    Every draw is the end of a chain of its own. A step is along one principal direction of the
    correlations, so that chains mix at once where no bound is near.

    Parameters
    ----------
    mean : ndarray, shape (K, k)
        Means without the bounds.
    covariance : ndarray, shape (k, k)
        Numbers without variance stay at their means.
    low, high : ndarray, shape (k,)
        Bounds; infinite where there is none.
    start : ndarray, shape (k,)
        Where chains begin, within the bounds.
    seed : int, optional
        Of the random numbers.
    """
    from scipy.special import log_ndtr, ndtri_exp

    rng, scale = np.random.default_rng(seed), np.sqrt(np.maximum(np.diag(covariance), 0.0))
    some = scale > 0.0
    center, scale = mean[:, some], scale[some]
    values, vectors = np.linalg.eigh(covariance[np.ix_(some, some)] / np.outer(scale, scale))
    deviations = np.sqrt(np.maximum(values, np.finfo(float).eps))
    ends = [(end[some] - center) / scale for end in (low, high)]
    x = (start[some] - center) / scale
    z = x @ vectors / deviations
    for _ in range(_ROUNDS):
        for i, direction in enumerate((vectors * deviations).T):
            rest = x - z[:, i, None] * direction
            moved = direction != 0.0
            one, other = ((end - rest)[:, moved] / direction[moved] for end in ends)
            # A number at its bound may be beyond it by rounding.
            first = np.minimum(np.minimum(one, other).max(axis=1), z[:, i])
            last = np.maximum(np.maximum(one, other).min(axis=1), z[:, i])
            # Probabilities far out on the right are rounded to 1, on the left their logarithms
            # are exact.
            turned = np.where(first > 0.0, -1.0, 1.0)
            least = log_ndtr(np.where(first > 0.0, -last, first))
            most = log_ndtr(np.where(first > 0.0, -first, last))
            share, ratio = 1.0 - rng.random(len(x)), np.exp(least - most)
            drawn = turned * ndtri_exp(most + np.log(ratio + share * (1.0 - ratio)))
            z[:, i] = np.clip(drawn, first, last)
            x = rest + z[:, i, None] * direction
    found = mean.copy()
    found[:, some] += x * scale
    return np.asarray(np.clip(found, low, high))


def draw_drives(
    fit: FittedDrives, draws: int = _DRAWS, *, joints: Sequence[str] | None = None, seed: int = 0
) -> dict[str, NDArray[np.generic]]:
    """Return draws of drives from the covariance of a fit, none where physics forbids it.

    The delay is drawn first, so that its bounds alone shape it; the rest is drawn given the delay.

    Parameters
    ----------
    fit : FittedDrives
        The fit.
    draws : int, optional
        How many, K.
    joints : sequence of str, optional
        Order of the joints, by default that of the fit.
    seed : int, optional
        Of the random numbers.

    Returns
    -------
    dict
        ``joint_names`` (n,), ``delay`` (K,) in s, and (K, n) ``armature``, ``damping``,
        ``friction`` (its mean over the recorded positions), ``kp`` and ``kd``. Where friction
        depends on the position also ``f0``, ``f1`` and ``f2`` (K, n) about ``middle`` (n,).
    """
    n = len(fit.joint_names)
    unknowns = Unknowns(rows=fit.kinds, delay=fit.delay_found, motions=0, n=n)
    (low, high), own, rest = unknowns.bounds(), slice(-1, None), slice(len(fit.values))
    start, mean, covariance = fit.values, np.tile(fit.values, (draws, 1)), fit.covariance
    if fit.delay_found and covariance[-1, -1] > 0.0:
        rest, along = slice(-1), covariance[:, -1] / covariance[-1, -1]
        late = truncated_normal(
            mean[:, own], covariance[own, own], low[own], high[own], start[own], seed=seed
        )
        mean = mean + (late - start[own]) * along
        covariance = covariance - np.outer(along, covariance[-1])
    vectors = mean.copy()
    vectors[:, rest] = truncated_normal(
        mean[:, rest], covariance[rest, rest], low[rest], high[rest], start[rest], seed=seed + 1
    )
    drawn = [unknowns.unpack(x, fit.rich)[0] for x in vectors]
    where = np.asarray(fit.convex.problem.samples.position)
    where = where[:: max(1, len(where) // _POSITIONS)]
    found = {name: np.stack([x[name] for x in drawn]) for name in ("armature", "damping")}
    found["friction"] = np.stack([x.dry(where).mean(axis=0) for x in drawn])
    found |= {name: np.stack([x[name] for x in drawn]) for name in ("kp", "kd")}
    if "slope" in fit.kinds:
        found |= {f: np.stack([x[kind] for x in drawn]) for f, kind in OVER_POSITION.items()}
        found["middle"] = np.asarray(fit.rich.middle)
    order = [fit.joint_names.index(name) for name in joints or fit.joint_names]
    return {
        "joint_names": np.asarray(fit.joint_names)[order],
        "delay": np.array([x.delay for x in drawn]),
        **{name: each[..., order] for name, each in found.items()},
    }


def write_drive_draws(fit: FittedDrives, path: Path, mjcf: Path) -> None:
    """Write draws as a NumPy archive, joints in the order of an MJCF where that was written."""
    joints = None
    if mjcf.is_file():
        from lxml import etree

        found = [each.get("name") for each in etree.parse(mjcf).iterfind("worldbody//joint")]
        joints = [name for name in found if name in fit.joint_names]
    arrays: dict[str, Any] = {**draw_drives(fit, joints=joints)}
    np.savez(path, **arrays)
