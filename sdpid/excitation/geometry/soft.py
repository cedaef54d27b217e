"""A smooth lower bound of the least slack of all pairs, computed where it matters."""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array
from sdpid.excitation.geometry.measure import Measure, Witness, copied

# Pairs whose share of the sum is below exp(-this) are left out of it: at 300 per meter each changes
# it by 0.4 µm at most, less than a distance is accurate.
_NEGLIGIBLE = 9.0


class SoftMinimum:
    """Soft minima of slacks, over all pairs of solids.

    Parameters
    ----------
    measure : Measure
        Measures the distances.
    reach : ndarray, shape (P, n)
        Bounds on the rates of the distances of pairs of bodies, m/rad (m/m).
    """

    def __init__(self, measure: Measure, reach: Array) -> None:
        self._measure, self._reach = measure, reach
        self._last: tuple[Array, Array] | None = None

    def _bounds(self, q: Array) -> Array:
        """Return lower bounds (K, S) of the distances: of capsules, or the last ones less the way.

        What is found nearer replaces them until the next call.
        """
        bounds = self._measure.capsules.below(q)
        if self._last is not None and len(self._last[0]) == len(q):
            moved = np.abs(q - self._last[0]) @ self._reach.T
            bounds = np.maximum(bounds, self._last[1] - moved[:, self._measure.owners])
        self._last = q.copy(), bounds
        return bounds

    def evaluate(
        self, q: Array, sharpness: float, clearances: Array, horizon: float
    ) -> tuple[Array, Array]:
        """Return the soft minima (K,) and their derivatives (K, n).

        ``-log(exp(-s*horizon) + sum of exp(-s*slack))/s`` with s the sharpness.

        Parameters
        ----------
        q : ndarray, shape (K, n)
            Joint positions.
        sharpness : float
            1/m.
        clearances : ndarray, shape (P,)
            What is taken off the distances of each pair of bodies, m.
        horizon : float
            Slack beyond which it makes no difference how far away everything is, m.
        """
        measure, gaps = self._measure, clearances[self._measure.owners]
        configurations = measure.robot.configuration(q)
        bounds = self._bounds(q)
        below = bounds - gaps
        margin = _NEGLIGIBLE / sharpness
        found: list[Witness] = []
        samples, parts = [], []
        jacobians = np.zeros((len(q), 6, measure.robot.pin_model.nv))
        for k in np.flatnonzero((below < horizon + margin).any(axis=1)):
            jacobians[k] = measure.place(configurations[k])
            least, results = horizon, []
            for part in np.argsort(below[k], kind="stable").tolist():
                if below[k, part] >= least + margin:
                    break
                result = measure.part(part)
                bounds[k, part] = result.min_distance
                least = min(least, result.min_distance - gaps[part])
                results.append((part, result))
            for part, result in results:
                if result.min_distance - gaps[part] < least + margin:
                    found.append(copied(result))
                    samples.append(k)
                    parts.append(part)
        if not found:
            return np.full(len(q), horizon), np.zeros_like(q)
        at, which = np.array(samples), np.array(parts)
        distances, gradients = measure.derivatives(found, jacobians, at, measure.owners[which])
        slack = distances - gaps[which]
        lowest = np.full(len(q), horizon)
        np.minimum.at(lowest, at, slack)
        weights = np.exp(-sharpness * (slack - lowest[at]))
        total = np.exp(-sharpness * (horizon - lowest))
        np.add.at(total, at, weights)
        out = np.zeros_like(q)
        np.add.at(out, at, (weights / total[at])[:, None] * gradients)
        return lowest - np.log(total) / sharpness, out
