"""`Criterion`: how good a motion is, from its states."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.excitation.criterion.objectives import Objective
from sdpid.excitation.criterion.rows import StateRows


@dataclass(frozen=True, kw_only=True, eq=False)
class Criterion:
    """An objective of motions, small where they show much.

    Attributes
    ----------
    rows : StateRows
        The regressor; smooth where derivatives are wanted.
    objective : Objective
        What is made small.
    rates : ndarray, shape (n,)
        Information per second and squared effort of each joint: one over the spectral density of
        its errors, 1/((N·m)²·s).
    known : ndarray, shape (b, b)
        Information before the run: the prior's, and that of earlier runs.
    directions : ndarray, shape (b, r), optional
        How unknown numbers move the base parameters, where not all are unknown: the objective is
        of the information about these.
    """

    rows: StateRows
    objective: Objective
    rates: Array
    known: Array
    directions: Array | None = None

    def value(self, q: Array, v: Array, a: Array, duration: float) -> float:
        """Return the objective of states (K, n), evenly spread over the duration in s."""
        W = self.rows.rows(q, v, a)
        return self._value(*self._matrices(W, duration))[0]

    def gradient(
        self, q: Array, v: Array, a: Array, duration: float
    ) -> tuple[float, tuple[Array, Array, Array]]:
        """Return the objective and its derivatives by the states, (K, n) each."""
        W = self.rows.rows(q, v, a)
        K = len(W)
        value, by_total, by_plain = self._value(*self._matrices(W, duration))
        flat = W.reshape(-1, W.shape[2])
        C = (2.0 * duration / K) * (flat @ by_total).reshape(W.shape) * self.rates[:, None]
        if by_plain.any():
            C += (2.0 / K) * (flat @ by_plain).reshape(W.shape)
        return value, self.rows.gradient(C, q, v, a)

    def _value(self, total: Array, plain: Array) -> tuple[float, Array, Array]:
        D = self.directions
        if D is None:
            return self.objective.value(total, plain)
        value, by_total, by_plain = self.objective.value(D.T @ total @ D, D.T @ plain @ D)
        return value, D @ by_total @ D.T, D @ by_plain @ D.T

    def _matrices(self, W: Array, duration: float) -> tuple[Array, Array]:
        flat = W.reshape(-1, W.shape[2])
        weighted = (W * np.sqrt(self.rates)[:, None]).reshape(flat.shape)
        return (
            self.known + duration / len(W) * (weighted.T @ weighted),
            flat.T @ flat / len(W),
        )
