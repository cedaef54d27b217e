"""Rows as they were computed beside the enclosed ones, chunk by chunk."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.certificate.outward import SLACK as UP
from sdpid.assurance.certificate.outward import gamma
from sdpid.assurance.log_proof.box import Box
from sdpid.assurance.log_proof.enclosure import largest, root
from sdpid.assurance.log_proof.friction_columns import enclosed_columns, has_formula
from sdpid.assurance.log_proof.joints import Joint
from sdpid.assurance.log_proof.regressor import motion, regressor
from sdpid.assurance.log_proof.weights import diagonal_weights, lesser_weights
from sdpid.estimation.compression.rows import RowSource

# Samples of a chunk: its arrays stay in a second-level cache, and a call costs little beside them.
CHUNK = 1024

# Of a humanoid's rows so many make hundreds of megabytes: no more bytes than this, but at least so
# many samples that calls do not count.
_BYTES, _LEAST = 1 << 24, 64


@dataclass(frozen=True, eq=False)
class Piece:
    """What the rows of a piece are off by, all times the weights.

    Attributes
    ----------
    columns : ndarray, shape (p,)
        Norms of the columns' errors.
    links : ndarray, shape (links, 3)
        Norms of what is open of a link, over its m, |h| and ‖I‖.
    squares : ndarray, shape (2,)
        Squares of all base columns, and of the efforts; here and below of printed costs alone.
    gram : ndarray, shape (b, b)
        Gram matrix of the rows under lesser weights.
    rounding : float
        What its spectral norm is off by at most.
    score : float
        How far the worst chunk is off, to compare pieces.
    worst : tuple
        Joint, sample, column and error of the worst entry.
    count : int
        Samples of the piece.
    """

    columns: Array
    links: Array
    squares: Array
    gram: Array
    rounding: float
    score: float
    worst: tuple[int, int, int, float]
    count: int


def piece_of_one(source: RowSource, weights: tuple[Array, Array], box: Box, printed: bool) -> Piece:
    """Compare the rows of a piece, all with the same weights (n,)."""
    return _Comparison(source, box, printed).run(lambda part: weights)


def piece_of_many(
    source: RowSource, sigma: Array, exponent: float, box: Box, printed: bool
) -> Piece:
    """Compare the rows of a piece whose samples have covariances of their own."""
    return _Comparison(source, box, printed).run(
        lambda part: (
            diagonal_weights(sigma[part], exponent),
            lesser_weights(sigma[part], exponent),
        )
    )


class _Comparison:
    """The rows of a piece beside the equations, chunk by chunk."""

    def __init__(self, source: RowSource, box: Box, printed: bool) -> None:
        self.source, self.box, self.printed = source, box, printed
        self.tree = source.robot.tree
        self.joints = [Joint.of(self.tree, i) for i in range(len(self.tree.kind))]
        matrix = source.base.matrix
        unit = (np.count_nonzero(matrix, axis=0) == 1) & (matrix.max(axis=0, initial=0.0) == 1.0)
        # Columns that are one of the base regressor's, and those that are combinations.
        self.plain = np.flatnonzero(unit)
        self.leads = np.argmax(matrix[:, self.plain], axis=0)
        self.folded = np.flatnonzero(~unit)
        self.turn = np.ascontiguousarray(matrix[:, self.folded].T)
        self.rounding = np.array([gamma(int(np.count_nonzero(row))) for row in self.turn])
        filtered = source.samples.wide is not None
        names = source.friction.joint_names
        self.terms = []
        start = 10 * source.robot.n_links
        for term in source.friction.terms:
            stop = start + len(term.parameters(names))
            self.terms.append((term, slice(start, stop), has_formula(term, filtered=filtered)))
            start = stop

    def run(self, weights_of: Callable[[slice], tuple[Array, Array]]) -> Piece:
        """Return what the rows are off by."""
        source, found = self.source, _Sums(self.box, self.source.base.count)
        n, p = source.robot.n, len(self.box.theta)
        size = min(max(_BYTES // (8 * n * p), _LEAST), CHUNK)
        memory = np.zeros((n, p, size))
        again = np.zeros((size, n, source.base.count + 1))
        for part in source.parts(size):
            rows, error = source.rows(part, again), memory[:, :, : part.stop - part.start]
            # An overflow leaves a bound that is infinite or no number.
            with np.errstate(over="ignore", invalid="ignore"):
                rad, open_links = self._difference(part, rows, error)
                mask = source.mask(part)
                factor, lesser = (np.where(mask, w, 0.0).T for w in weights_of(part))
                found.add(part, error, rad, open_links, factor)
                if self.printed:
                    found.add_rows(rows, factor, lesser)
        return found.piece(source.n_samples)

    def _difference(self, part: slice, rows: Array, error: Array) -> tuple[Array, Array]:
        """Write the equations' rows less the computed ones (n, p, k).

        Returns what each entry (n, p) and each link (n, links, 3) leaves open, for all samples.
        """
        source, samples = self.source, self.source.samples
        n, links = source.robot.n, source.robot.n_links
        computed = np.ascontiguousarray(rows[:, :, :-1].transpose(1, 2, 0))
        rad, open_links = np.zeros(error.shape[:2]), np.zeros((n, links, 3))
        position, velocity = samples.position[part], samples.velocity[part]
        states = motion(
            self.tree, source.robot.offset, position, velocity, samples.acceleration[part]
        )
        error[:] = 0.0
        regressor(self.joints, states, error[:, : 10 * links], open_links)
        self._friction(part, error, rad)
        error[:, self.plain] -= computed[:, self.leads]
        error[:, self.folded] -= np.matmul(self.turn, computed)
        rad[:, self.folded] += self.rounding * (largest(computed) @ np.abs(self.turn).T)
        return rad * UP, open_links * UP

    def _friction(self, part: slice, error: Array, rad: Array) -> None:
        """Write the friction terms' columns; what has no formula is taken from the rows."""
        source = self.source
        to = source.friction.first
        names = source.friction.joint_names
        moving = source.motion(part)
        for term, columns, formula in self.terms:
            if formula:
                error[to:, columns], rad[to:, columns] = enclosed_columns(term, moving, names)
            elif columns.stop > columns.start:
                found = term.columns_in(moving, names)
                error[to:, columns] = found.transpose(1, 2, 0)


class _Sums:
    """Weighted squares of columns, added up over the chunks of a piece."""

    def __init__(self, box: Box, base: int) -> None:
        self.box = box
        self.columns, self.links = np.zeros(len(box.theta)), np.zeros(box.bodies.shape)
        self.squares, self.gram, self.rounding = np.zeros(2), np.zeros((base, base)), 0.0
        self.score, self.worst = -1.0, (0, 0, 0, 0.0)
        self.chunks = 0

    def add(self, part: slice, error: Array, rad: Array, open_links: Array, factor: Array) -> None:
        """Add the errors (n, p, k) with radii (n, p) and (n, links, 3), times factors (n, k)."""
        error *= factor[:, None, :]
        share = root(np.sum(factor**2, axis=1))
        # Minkowski's inequality for what is computed and what is open.
        norms = root(np.einsum("jck,jck->jc", error, error)) + share[:, None] * rad
        added = np.sum(norms**2, axis=0)
        self.columns += added
        self.links += np.sum((share[:, None, None] * open_links) ** 2, axis=0)
        self.chunks += 1
        score = float(np.sqrt(added / factor.shape[1]) @ self.box.theta)
        if not score <= self.score:
            self.score, self.worst = score, self._worst(part, error, factor)

    def add_rows(self, rows: Array, factor: Array, lesser: Array) -> None:
        """Add squares of the rows (k, n, b + 1) and of their efforts, and a Gram matrix.

        That is of the rows times the lesser weights, so its entries round no more than the squares.
        """
        squares = np.einsum("knb,nk->b", rows**2, factor**2)
        self.squares += np.array([squares[:-1].sum(), squares[-1]])
        W = (rows[:, :, :-1] * lesser.T[:, :, None]).reshape(-1, len(self.gram))
        self.gram += W.T @ W
        # Four roundings of each entry's factors.
        self.rounding += gamma(len(W) + 4) * float(squares[:-1].sum())

    def piece(self, count: int) -> Piece:
        """Return the norms."""
        columns, links = root(self.columns), root(self.links)
        rounding = self.rounding + gamma(self.chunks) * float(self.squares[0])
        return Piece(
            columns, links, self.squares, self.gram, rounding, self.score, self.worst, count
        )

    def _worst(self, part: slice, error: Array, factor: Array) -> tuple[int, int, int, float]:
        """Return joint, sample and column of the largest error times its bound, and the error."""
        size = np.abs(error) * self.box.theta[:, None]
        j, column, k = (int(x) for x in np.unravel_index(int(np.argmax(size)), size.shape))
        scale = factor[j, k] if factor[j, k] > 0.0 else 1.0
        return j, part.start + k, column, float(error[j, column, k] / scale)
