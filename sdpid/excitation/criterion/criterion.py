"""How good a motion is: functions of the information that it brings, with their derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.excitation.criterion.rows import StateRows

ObjectiveKind = Literal["mixed", "D", "A", "E", "V", "condition"]

# What an objective is called, and what it depends on.
WORDS: dict[str, str] = {
    "mixed": "log det of what the data show, without the prior, and condition number of columns of "
    "unit length; in any units the same",
    "D": "volume of the uncertainty of all parameters, the prior's knowledge included (log det; in "
    "any units the same)",
    "A": "sum of the parameters' variances, each in units of what moves the efforts as much",
    "E": "largest variance of any combination of the parameters, in the same units",
    "V": "mean variance of the efforts, or of what the purpose asks for",
    "condition": "condition number of the regressor with columns of unit length; in any units the "
    "same",
}

# The extreme eigenvalues are replaced by power sums of this power: they differ by at most
# b^(1/power), a tenth for some 50 parameters of which few are near the extreme.
_POWER = 32
# Weight of log cond beside the mean log det. Alone, log det leaves cond above 100, and cond alone
# says little about estimates; from a half to one, both are near what each alone can have.
_CONDITION = 1.0
# Eigenvalues below this share of the largest are rounding: directions that no motion shows.
_ROUNDING = 1e-14


@dataclass(frozen=True, kw_only=True, eq=False)
class Objective:
    """What a search makes small.

    Attributes
    ----------
    kind : {"mixed", "D", "A", "E", "V", "condition"}
        Which function of the information.
    functionals : ndarray, shape (k, b), optional
        What is to be known, as linear functions of the base parameters; by default the base
        parameters themselves.
    scale : ndarray, shape (b,), optional
        Size of each base parameter for "A" and "E".
    shown : ndarray, shape (b, r), optional
        Directions of the columns of unit length that the condition number is about; by default all.

    Raises
    ------
    DataError
        When the kind is unknown, or "V" has no functionals.
    """

    kind: ObjectiveKind = "mixed"
    functionals: Array | None = None
    scale: Array | None = None
    shown: Array | None = None

    def __post_init__(self) -> None:
        if self.kind not in get_args(ObjectiveKind):
            raise DataError(
                f"objective: is {self.kind!r}; use one of {', '.join(get_args(ObjectiveKind))}."
            )
        if self.kind == "V" and self.functionals is None:
            raise DataError("objective: 'V' needs functionals: whose variance is to be small.")

    def value(self, total: Array, plain: Array) -> tuple[float, Array, Array]:
        """Return the objective and its derivatives by both matrices.

        Parameters
        ----------
        total : ndarray, shape (b, b)
            Information of the base parameters after the run, what is known before included.
        plain : ndarray, shape (b, b)
            Mean of W^T·W over the run, in SI units.

        Returns
        -------
        float
        ndarray, shape (b, b)
            Derivative by `total`, symmetric.
        ndarray, shape (b, b)
            Derivative by `plain`, symmetric.
        """
        none = np.zeros_like(total)
        if self.kind == "condition":
            value, by_plain = self._condition(plain)
            return value, none, by_plain
        value, by_total = self._uncertainty(total)
        if self.kind != "mixed":
            return value, by_total, none
        condition, by_plain = self._condition(plain)
        return value + _CONDITION * condition, by_total, _CONDITION * by_plain

    def _condition(self, plain: Array) -> tuple[float, Array]:
        """Return the log of the condition number of columns of unit length, and its derivative."""
        squares = np.diag(plain)
        length = np.sqrt(np.where(squares > 0.0, squares, 1.0))
        units = np.outer(length, length)
        unit = plain / units
        P = np.eye(len(plain)) if self.shown is None else self.shown
        value, inner = _log_condition(P.T @ unit @ P)
        by_unit = P @ inner @ P.T
        # What lengthens a column makes its entries smaller.
        lengthened = np.diag(np.sum(by_unit * unit, axis=1) / length**2)
        return value, by_unit / units - lengthened

    def _uncertainty(self, total: Array) -> tuple[float, Array]:
        """Return how uncertain the parameters are after the run, and its derivative."""
        if self.kind == "E":
            scale = np.ones(len(total)) if self.scale is None else self.scale
            w, U = _spectrum(total * np.outer(scale, scale))
            smallest, slope = _log_smallest(w)
            return -smallest, -((U * slope) @ U.T) * np.outer(scale, scale)
        w, U = _spectrum(total)
        L = self.functionals
        if self.kind in ("mixed", "D") and L is None:
            return float(-np.log(w).mean()), -((U / w) @ U.T) / len(w)
        if L is None:
            L = np.eye(len(total)) if self.scale is None else np.diag(1.0 / self.scale)
        inverse = (U / w) @ U.T
        C = L @ inverse @ L.T
        if self.kind in ("mixed", "D"):
            # Rows of L that say the same, and what no motion can tell, do not count.
            c, V = np.linalg.eigh(C)
            seen = c > _ROUNDING * c[-1]
            value = float(np.log(c[seen]).mean())
            back = (V[:, seen] / c[seen]) @ V[:, seen].T / np.count_nonzero(seen)
        else:
            value = float(np.log(np.trace(C)))
            back = np.eye(len(C)) / np.trace(C)
        half = L @ inverse
        return value, -(half.T @ back @ half)


def _spectrum(matrix: Array) -> tuple[Array, Array]:
    """Return eigenvalues, raised above rounding, and eigenvectors."""
    w, U = np.linalg.eigh(matrix)
    return np.maximum(w, _ROUNDING * max(float(w[-1]), 1e-300)), U


def _log_smallest(w: Array) -> tuple[float, Array]:
    """Return a smooth log of the least eigenvalue, from below, and its derivative."""
    shares = (w.min() / w) ** _POWER
    return float(np.log(w.min()) - np.log(shares.sum()) / _POWER), shares / shares.sum() / w


def _log_condition(plain: Array) -> tuple[float, Array]:
    """Return a smooth log of the regressor's condition number, from above, and its derivative."""
    w, U = _spectrum(plain)
    smallest, low = _log_smallest(w)
    largest, high = _log_smallest(1.0 / w)
    # The largest of w is one over the smallest of 1 / w.
    slope = 0.5 * (high / w**2 - low)
    return 0.5 * (-largest - smallest), (U * slope) @ U.T


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
