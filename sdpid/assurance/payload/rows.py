"""Cost of a payload's ten parameters with the arm eliminated, and the errors in it.

The arm's parameters theta and the payload's ten pi act together. With R and h what is known of the
arm (rows of a recording without load, or of a prior), A and r the compressed rows of the recording
with load, B the matrix of the base parameters,

    cost = ‖R·theta − h‖² + ‖A·(B·theta + S·delta + B_link·pi) − r‖²

with delta what differs between the recordings (offsets of sensors). Projected on the rows that
theta and delta cannot reach, it is ``‖T·pi − s‖² + floor`` with T (10, 10): exactly the cost that
the best theta and delta leave for each pi.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.errors import DataError
from sdpid.estimation.cluster_robust import ScoreBlocks
from sdpid.estimation.problem import Problem

# Singular values of the arm's scaled columns below this share of the largest are rounding.
_RANK = 1e-11


@dataclass(frozen=True, eq=False)
class PayloadRows:
    """The cost ``‖matrix·pi − rhs‖² + floor`` of a payload, and where its errors come from.

    Attributes
    ----------
    matrix, rhs : ndarray, shapes (10, 10) and (10,)
    floor : float
    sources : tuple of (ScoreBlocks, ndarray)
        Errors of fits (k,) and the matrices (10, k) that take them to rhs.
    unit : ndarray, shape (10, j)
        What takes errors of variance one to rhs: of priors, and of records too short for blocks.
    short : bool
        Whether a record was too short.
    """

    matrix: Array
    rhs: Array
    floor: float
    sources: tuple[tuple[ScoreBlocks, Array], ...]
    unit: Array
    short: bool

    def error(self, direction: Array) -> tuple[float, float]:
        """Return variance and degrees of freedom of ``direction @ rhs``, by Welch's formula."""
        known = float(np.sum((direction @ self.unit) ** 2))
        variance, spread = known, 0.0
        for blocks, matrix in self.sources:
            functional = direction @ matrix
            own = float(functional @ blocks.covariance @ functional)
            variance += own
            spread += own**2 / float(blocks.freedom(functional[None])[0])
        return variance, variance**2 / spread if spread > 0.0 else np.inf


def rows_beside_recording(
    loaded: Problem, arm: Problem, columns: Array, separate: Indices
) -> PayloadRows:
    """Return the rows of a payload when the arm is known from a problem without load.

    Parameters
    ----------
    loaded : Problem
        The recording with load; its prior is not looked at.
    arm : Problem
        The one without load, of the same base parameters.
    columns : ndarray, shape (b, 10)
        What the payload adds to the base parameters.
    separate : ndarray of int
        Entries of theta that differ between the two.
    """
    if len(arm.log_det.links):
        raise DataError(
            "payload: an arm with a log-det prior is no sum of squares; estimate it with "
            "Prior(kind='pullback')."
        )
    G, h = arm.squared.matrix, arm.squared.rhs
    own = loaded.A @ loaded.base.matrix
    nuisance = np.vstack(
        [
            np.hstack([G, np.zeros((len(G), len(separate)))]),
            np.hstack([own, own[:, separate]]),
        ]
    )
    payload = np.vstack([np.zeros((len(G), 10)), loaded.A @ columns])
    T, s, floor, W = _eliminated(nuisance, payload, np.concatenate([h, loaded.rhs]))
    count = arm.base.count
    parts = [(arm, W[:, :count]), (loaded, W[:, len(G) :])]
    return _with_errors(T, s, floor + arm.floor + loaded.floor, parts, W[:, count : len(G)])


def rows_beside_prior(loaded: Problem, columns: Array) -> PayloadRows:
    """Return the rows of a payload when the arm is regularized by the problem's prior."""
    if len(loaded.log_det.links):
        raise DataError("payload: the prior of the arm must be a sum of squares, as 'pullback'.")
    squared, count = loaded.squared, loaded.base.count
    payload = np.zeros((len(squared.rhs), 10))
    payload[:count] = loaded.A @ columns
    T, s, floor, W = _eliminated(squared.matrix, payload, squared.rhs)
    return _with_errors(T, s, floor + loaded.floor, [(loaded, W[:, :count])], W[:, count:])


def rows_beside_known(loaded: Problem, columns: Array, links: Array) -> PayloadRows:
    """Return the rows of a payload when the links of the arm are known.

    Their friction is not. The errors are those of the fit in which only friction and payload are
    free, so that what the links leave unexplained counts as error, block by block.
    """
    B = loaded.base.matrix
    known = B[:, : links.size] @ links.ravel()
    friction = B[:, links.size :]
    T, s, floor, W = _eliminated(
        loaded.A @ friction, loaded.A @ columns, loaded.rhs - loaded.A @ known
    )
    floor += loaded.floor
    try:
        blocks = ScoreBlocks.of(loaded)
    except DataError:
        # The rows are whitened by the residuals of a fit in which the links are free too.
        worse = floor / loaded.floor if loaded.floor > 0.0 else 1.0
        return PayloadRows(T, s, floor, (), W * np.sqrt(max(worse, 1.0)), True)
    K = np.hstack([friction, columns])
    reduced = ScoreBlocks(
        blocks.groups,
        K.T @ blocks.information @ K,
        (blocks.target - blocks.information @ known) @ K,
    )
    takes = np.hstack([np.zeros((len(T), friction.shape[1])), T])
    return PayloadRows(T, s, floor, ((reduced, takes),), np.zeros((len(T), 0)), False)


def _with_errors(
    T: Array, s: Array, floor: float, parts: list[tuple[Problem, Array]], unit: Array
) -> PayloadRows:
    sources, short = [], False
    for problem, W in parts:
        try:
            sources.append((ScoreBlocks.of(problem), W @ problem.A))
        except DataError:
            # Too short for blocks: the rows are whitened, their variance is one.
            unit, short = np.hstack([unit, W]), True
    return PayloadRows(T, s, floor, tuple(sources), unit, short)


def _eliminated(nuisance: Array, payload: Array, rhs: Array) -> tuple[Array, Array, float, Array]:
    """Return T, s, the floor that is left, and W (10, rows) with ``s = W @ rhs``."""
    size = np.linalg.norm(nuisance, axis=0)
    scaled = nuisance[:, size > 0.0] / size[size > 0.0]
    U, singular, _ = np.linalg.svd(scaled)
    rank = int(np.count_nonzero(singular > _RANK * singular.max(initial=0.0)))
    free = U[:, rank:].T
    Q, T = np.linalg.qr(free @ payload)
    W = np.zeros((10, len(rhs)))
    W[: Q.shape[1]] = Q.T @ free
    square = np.zeros((10, 10))
    square[: len(T)] = T
    s = W @ rhs
    left = free @ rhs
    return square, s, max(float(left @ left - s @ s), 0.0), W
