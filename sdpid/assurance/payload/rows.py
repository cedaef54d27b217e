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

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.errors import DataError
from sdpid.estimation.cluster_robust import ScoreBlocks
from sdpid.estimation.error_source import ErrorSource
from sdpid.estimation.gain_errors import gain_errors
from sdpid.estimation.information import information_root
from sdpid.estimation.prior.cost_terms import SquaredTerm
from sdpid.estimation.prior.evidence import strength_by_evidence
from sdpid.estimation.prior.prior import Prior, prior_terms
from sdpid.estimation.problem import Problem

# Relative standard deviation of the links that a description is granted: the one that makes the
# recording most probable, but never less than the first, since the last link and the payload look
# alike, nor more than the second. Against the descriptions of five real arms without load (UR10,
# Panda, LWR 4+, TX40, UR10e by published gains) the first alone holds "no payload" in five of eight
# recordings, the second in all; beyond it an interval says nothing.
_LEAST_TOLERANCE, _MOST_TOLERANCE = 0.1, 0.3

# Singular values of the arm's scaled columns below this share of the largest are rounding.
_RANK = 1e-11


class RowErrors(NamedTuple):
    """Errors of one source: how rhs moves with them (10, k), their covariance, its freedom."""

    moves: Array
    covariance: Array
    freedom: Callable[[Array], Array]
    gains: ErrorSource | None = None


@dataclass(frozen=True, eq=False)
class PayloadRows:
    """The cost ``‖matrix·pi − rhs‖² + floor`` of a payload, and where its errors come from.

    Attributes
    ----------
    matrix, rhs : ndarray, shapes (10, 10) and (10,)
    floor : float
    errors : tuple of RowErrors
        Of the fits, of priors and descriptions, and of the gains that made efforts of currents.
    short : bool
        Whether a record was too short for blocks: the weighting is trusted.
    """

    matrix: Array
    rhs: Array
    floor: float
    errors: tuple[RowErrors, ...]
    short: bool = False

    @property
    def gains(self) -> tuple[RowErrors, ...]:
        """The errors of gains."""
        return tuple(each for each in self.errors if each.gains is not None)

    def error(
        self, direction: Array, among: tuple[RowErrors, ...] | None = None
    ) -> tuple[float, float]:
        """Return variance and degrees of freedom of ``direction @ rhs``, by Welch's formula."""
        variance, spread = 0.0, 0.0
        for each in self.errors if among is None else among:
            moved = (direction @ each.moves)[None]
            own = float(moved[0] @ each.covariance @ moved[0])
            variance += own
            spread += own**2 / float(each.freedom(moved)[0]) if own > 0.0 else 0.0
        return variance, variance**2 / spread if spread > 0.0 else np.inf


@dataclass(frozen=True)
class Description:
    """What is granted to a description that the arm's links are taken from.

    Attributes
    ----------
    tolerance : float
        Relative standard deviation of each link's inertial parameters about the described ones, in
        the metric of the prior ``"pullback"``.
    contradicted : bool
        Whether the recording shows the links to be further off.
    """

    tolerance: float
    contradicted: bool

    def note(self) -> str:
        """Return in words what the intervals rest on, and what to do about it."""
        share = f"{100.0 * self.tolerance:.2g} %"
        remedy = "a recording without load (--without) needs no such belief"
        if self.contradicted:
            return (
                "the payload rests on the described links, and the recording contradicts them: "
                "they, the scale of the efforts or the model of friction are off by more than the "
                f"{share} that the intervals allow for; take the payload for a hint; {remedy}"
            )
        return (
            f"the payload rests on the described links: the intervals hold if each is right to "
            f"{share} (one standard deviation); {remedy}"
        )


def rows_beside(
    loaded: Problem, arm: Problem | None, columns: Array, separate: Indices
) -> PayloadRows:
    """Return the rows of a payload when the arm is known from a problem without load, or a prior.

    Parameters
    ----------
    loaded : Problem
        The recording with load; its prior counts where there is no other problem.
    arm : Problem or None
        The one without load, of the same base parameters.
    columns : ndarray, shape (b, 10)
        What the payload adds to the base parameters.
    separate : ndarray of int
        Entries of theta that differ between the two.
    """
    known, count = loaded if arm is None else arm, loaded.base.count
    if len(known.log_det.links):
        raise DataError(
            "payload: an arm with a log-det prior is no sum of squares; give or estimate it with "
            "Prior(kind='pullback')."
        )
    # Where there is one problem, its own rows come last.
    first = count if arm is None else 0
    G, h = known.squared.matrix[first:], known.squared.rhs[first:]
    own = loaded.A @ loaded.base.matrix
    nuisance = np.vstack(
        [np.hstack([G, np.zeros((len(G), len(separate)))]), np.hstack([own, own[:, separate]])]
    )
    payload = np.vstack([np.zeros((len(G), 10)), loaded.A @ columns])
    T, s, floor, W = _eliminated(nuisance, payload, np.concatenate([h, loaded.rhs]))
    of_arm = 0 if arm is None else count
    parts = [(loaded, W[:, len(G) :])]
    if arm is not None:
        parts.append((arm, W[:, :count]))
        floor += arm.floor
    return _with_errors(T, s, floor + loaded.floor, parts, W[:, of_arm : len(G)])


def rows_beside_description(
    loaded: Problem, columns: Array, links: Array
) -> tuple[PayloadRows, Description]:
    """Return the rows of a payload when the links of the arm are taken from a description.

    Their friction is not. The errors are those of the fit in which only friction and payload are
    free, so that what the links leave unexplained counts as error, block by block; and those of
    the description.

    Parameters
    ----------
    loaded : Problem
        The recording with load.
    columns : ndarray, shape (b, 10)
        What the payload adds to the base parameters.
    links : ndarray, shape (links, 10)
        The described links.

    Returns
    -------
    PayloadRows
    Description
        What the description is granted.
    """
    B = loaded.base.matrix
    known = B[:, : links.size] @ links.ravel()
    friction = B[:, links.size :]
    T, s, floor, W = _eliminated(
        loaded.A @ friction, loaded.A @ columns, loaded.rhs - loaded.A @ known
    )
    floor += loaded.floor
    (term,) = prior_terms(Prior(), loaded.require_rows("payload")).terms
    assert isinstance(term, SquaredTerm)
    each, others = slice(0, links.size), slice(links.size, None)
    U, singular, _ = np.linalg.svd(loaded.A @ columns)
    beside = U[:, int(np.count_nonzero(singular > _RANK * singular[0])) :].T
    strength = strength_by_evidence(
        (beside @ loaded.A @ B, beside @ loaded.rhs),
        (term.matrix[each], term.rhs[each]),
        (term.matrix[others], term.rhs[others]),
    )
    likely = float(strength**-0.5)
    tolerance = float(np.clip(likely, _LEAST_TOLERANCE, _MOST_TOLERANCE))
    granted = Description(tolerance, likely > _MOST_TOLERANCE)
    spread = tolerance * np.linalg.inv(term.matrix[each, : links.size])
    described = W @ loaded.A @ B[:, : links.size] @ spread
    beside_fit = (_known(described), *_of_gains([(loaded, W)]))
    try:
        blocks = ScoreBlocks.of(loaded)
    except DataError:
        # The rows are whitened by the residuals of a fit in which the links are free too.
        worse = floor / loaded.floor if loaded.floor > 0.0 else 1.0
        unsure = _known(W * np.sqrt(max(worse, 1.0)))
        return PayloadRows(T, s, floor, (unsure, *beside_fit), True), granted
    K = np.hstack([friction, columns])
    root, shown = information_root(loaded.A @ K), loaded.excitation.inverse
    turned = shown @ K @ root
    reduced = ScoreBlocks(
        blocks.groups,
        turned.T @ blocks.information @ turned,
        (blocks.target - blocks.information @ (shown @ known)) @ turned,
        root,
    )
    takes = T @ reduced.root[friction.shape[1] :]
    own = RowErrors(takes, reduced.scores, reduced.freedom)
    return PayloadRows(T, s, floor, (own, *beside_fit)), granted


def _known(moves: Array) -> RowErrors:
    """Return errors of variance one."""
    return RowErrors(moves, np.eye(moves.shape[1]), lambda moved: np.full(len(moved), np.inf))


def _with_errors(
    T: Array, s: Array, floor: float, parts: list[tuple[Problem, Array]], unit: Array
) -> PayloadRows:
    """Return the rows with errors of some problems' rows, and of others of variance one."""
    errors, short = [_known(unit), *_of_gains(parts)], False
    for problem, W in parts:
        try:
            blocks = ScoreBlocks.of(problem)
            moves = W @ (problem.A @ blocks.root)
            errors.append(RowErrors(moves, blocks.scores, blocks.freedom))
        except DataError:
            # Too short for blocks: the rows are whitened, their variance is one.
            errors.append(_known(W))
            short = True
    return PayloadRows(T, s, floor, tuple(errors), short)


def _of_gains(parts: list[tuple[Problem, Array]]) -> tuple[RowErrors, ...]:
    """Return the errors of gains and how rhs moves with them; those of the same gains are one."""
    found: list[tuple[ErrorSource, Array]] = []
    for problem, W in parts:
        errors = gain_errors(problem)
        if errors is None:
            continue
        moves = W @ problem.A @ errors.moves
        for i, (other, others_moves) in enumerate(found):
            if other.same(errors):
                found[i] = other, others_moves + moves
                break
        else:
            found.append((errors, moves))
    return tuple(RowErrors(moves, each.covariance, each.degrees, each) for each, moves in found)


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
