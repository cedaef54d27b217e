"""How far the rows that were compressed are from those of the robot's equations of motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sdpid._common.arrays import Array, Indices, frozen
from sdpid.assurance.certificate.outward import SLACK as UP
from sdpid.assurance.certificate.outward import UNIT as U
from sdpid.assurance.certificate.outward import gamma
from sdpid.assurance.log_proof.box import Box
from sdpid.assurance.log_proof.enclosure import TINY, largest, root
from sdpid.assurance.log_proof.friction_columns import enclosed_columns, has_formula
from sdpid.assurance.log_proof.joints import Joint
from sdpid.assurance.log_proof.regressor import motion, regressor
from sdpid.assurance.log_proof.weights import diagonal_weights, lesser_weights
from sdpid.estimation.compression.covariance import Weighting
from sdpid.estimation.compression.rows import Rows, RowSource
from sdpid.estimation.constraints.feasible_set import FeasibleSet
from sdpid.robot.model.regressor_kernel import Tree, flatten

# Samples of a chunk: its arrays stay in a second-level cache, and a call costs little beside them.
CHUNK = 1024

# Of a humanoid's rows so many make hundreds of megabytes: no more bytes than this, but at least so
# many samples that calls do not count.
_BYTES, _LEAST = 1 << 24, 64


@dataclass(frozen=True)
class WorstEntry:
    """The entry of the rows that is farthest from the equations, times its parameter's bound.

    Attributes
    ----------
    joint : str
        Whose effort.
    sample : int
        Which sample, counted from 0.
    parameter : str
        Which parameter.
    error : float
        What the entry of the rows is off by, in the unit of effort over parameter.
    """

    joint: str
    sample: int
    parameter: str
    error: float


@dataclass(frozen=True, kw_only=True, eq=False)
class RowError:
    """A bound of the distance between rows as computed and rows of the equations of motion.

    For every feasible theta ``|√f_true − √f_rows| ≤ share·√f_rows + at(theta)``, all at theta, and
    ``at(theta) ≤ total``.

    Attributes
    ----------
    columns : ndarray, shape (p,)
        Bound of the weighted norm, over all rows, of what each parameter's column is off by.
    links : ndarray, shape (links, 3)
        The same of what the enclosure leaves open of each link, over its m, |h| and ‖I‖.
    constant, share : float
        What does not depend on theta, and what grows with the cost: zero but for eq9 and eq18.
    box : Box
        Bounds of everything feasible.
    taken_as_computed : tuple of str
        Friction terms whose columns are results of processing: these are not compared.
    worst : WorstEntry
        Where the rows are farthest off.
    """

    columns: Array
    links: Array
    constant: float
    share: float
    box: Box
    taken_as_computed: tuple[str, ...]
    worst: WorstEntry

    @cached_property
    def total(self) -> float:
        """The bound rho for every theta in the box."""
        return self._over(self.box)

    def at(self, theta: Array) -> float:
        """Return the bound at some parameters (p,)."""
        return self._over(Box.around(theta, len(self.links)))

    def _over(self, box: Box) -> float:
        terms = np.concatenate([box.theta * self.columns, (box.bodies * self.links).ravel()])
        found = float((np.sum(terms) + self.constant) * UP + TINY)
        return found if np.isfinite(found) else np.inf


def row_error(
    rows: Rows, sigma: Array, weighting: Weighting, feasible: FeasibleSet
) -> RowError | None:
    """Return how far rows are from those of the robot's equations, None for other joints.

    The regressor is enclosed at the samples' own positions, velocities and accelerations, from the
    placements, axes and gravity as stored (`sdpid.robot.model.regressor_kernel.Tree`), and compared
    with the base regressor as it is computed, times B: what is found covers rounding and mistakes
    of the regressor, the sine and cosine, and B. See docs/theory.md, "Rows hold for the robot's
    equations".

    Parameters
    ----------
    rows : Rows
        The rows that are compressed.
    sigma : ndarray, shape (n, n) or (K, n, n)
        Effort covariance.
    weighting : str
        As for `sdpid.build_problem`.
    feasible : FeasibleSet
        The box, and the links' consistency.

    Returns
    -------
    RowError or None
        None where joints are neither revolute, prismatic nor a floating base.
    """
    tree = flatten(rows.robot.pin_model, rows.robot.expansion)
    if tree is None:
        return None
    box = Box.of(feasible)
    exponent = -0.5 if weighting == "eq9" else -1.0
    printed = weighting in ("eq9", "eq18")
    if sigma.ndim == 2:
        weights = diagonal_weights(sigma, exponent), lesser_weights(sigma, exponent)
        pieces = rows.map(_piece_of_one, weights, box, printed)
    else:
        pieces = rows.map(_piece_of_many, exponent, box, printed, sigma=sigma)
    columns = root(np.sum([piece.columns**2 for piece in pieces], axis=0))
    links = root(np.sum([piece.links**2 for piece in pieces], axis=0))
    constant = share = 0.0
    if printed:
        whole = _Rows.of(pieces)
        columns, links, constant, share = whole.printed(rows.base.kept, columns, links)
        if not np.array_equal(rows.base.matrix[:, rows.base.kept], np.eye(rows.base.count)):
            share = np.inf  # the columns of W are not what B says
    first, best = 0, pieces[0]
    start = 0
    for piece in pieces:
        if piece.score > best.score:
            first, best = start, piece
        start += piece.count
    joint, sample, column, error = best.worst
    return RowError(
        columns=frozen(columns),
        links=frozen(links),
        constant=constant,
        share=share,
        box=box,
        taken_as_computed=_as_computed(rows),
        worst=WorstEntry(
            rows.robot.joint_names[joint], first + sample, rows.base.theta_names[column], error
        ),
    )


@dataclass(frozen=True, eq=False)
class _Piece:
    """What the rows of a piece are off by: weighted norms of columns, and the worst entry."""

    columns: Array
    links: Array
    squares: Array
    gram: Array
    rounding: float
    score: float
    worst: tuple[int, int, int, float]
    count: int


def _piece_of_one(
    source: RowSource, weights: tuple[Array, Array], box: Box, printed: bool
) -> _Piece:
    """Compare the rows of a piece, all with the same weights (n,)."""
    return _Comparison(source, box, printed).run(lambda part: weights)


def _piece_of_many(
    source: RowSource, sigma: Array, exponent: float, box: Box, printed: bool
) -> _Piece:
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
        tree = flatten(source.robot.pin_model, source.robot.expansion)
        assert tree is not None  # `row_error` has looked
        self.tree: Tree = tree
        self.joints = [Joint.of(tree, i) for i in range(len(tree.kind))]
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

    def run(self, weights_of: Callable[[slice], tuple[Array, Array]]) -> _Piece:
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

    def piece(self, count: int) -> _Piece:
        """Return the norms."""
        columns, links = root(self.columns), root(self.links)
        rounding = self.rounding + gamma(self.chunks) * float(self.squares[0])
        return _Piece(
            columns, links, self.squares, self.gram, rounding, self.score, self.worst, count
        )

    def _worst(self, part: slice, error: Array, factor: Array) -> tuple[int, int, int, float]:
        """Return joint, sample and column of the largest error times its bound, and the error."""
        size = np.abs(error) * self.box.theta[:, None]
        j, column, k = (int(x) for x in np.unravel_index(int(np.argmax(size)), size.shape))
        scale = factor[j, k] if factor[j, k] > 0.0 else 1.0
        return j, part.start + k, column, float(error[j, column, k] / scale)


@dataclass(frozen=True, eq=False)
class _Rows:
    """The weighted rows of all pieces: what the costs of the paper need beside their errors.

    With P² = Sigma^e, Ŵ what was computed, W the truth and E theta what the efforts are off by, the
    residual of the normal equations n = Ŵ^T P² r changes by ``−Ŵ^T P² E theta + (W − Ŵ)^T P² (r −
    E theta)``; and ``‖P r‖² ≤ ‖P y‖² + n^T H^(−1) n``, H = Ŵ^T P² Ŵ, since the least ‖P r‖ is no
    larger than that of no parameters.
    """

    norm: float
    efforts: float
    least: float

    @classmethod
    def of(cls, pieces: Sequence[_Piece]) -> _Rows:
        """Add the pieces up.

        Their Gram matrix is that of weights w with ``diag(w²) ⪯ P²``, so below H.
        """
        squares = np.sum([piece.squares for piece in pieces], axis=0) * UP
        gram = np.sum([piece.gram for piece in pieces], axis=0)
        rounding = sum(piece.rounding for piece in pieces) + gamma(len(pieces)) * squares[0]
        norm, efforts = map(float, root(squares))
        return cls(norm, efforts, _least_eigenvalue(gram, rounding * UP))

    def printed(
        self, kept: Indices, columns: Array, links: Array
    ) -> tuple[Array, Array, float, float]:
        """Return columns, links, constant and share of the normal equations' residual."""
        # One parameter's column, with its share of what is open of its link.
        whole = columns.copy()
        whole[: 10 * len(links)] += np.repeat(links, (1, 3, 6), axis=1).ravel()
        wrong = float(root(np.sum(whole[kept] ** 2)))
        share = wrong / np.sqrt(self.least) * UP if self.least > 0.0 else np.inf
        both = (self.norm + wrong) * UP
        return both * columns * UP, both * links * UP, wrong * self.efforts * UP, float(share)


def _least_eigenvalue(gram: Array, error: float) -> float:
    """Return a lower bound of the eigenvalues of matrices this near, zero without proof.

    Cholesky's method ends for what is positive semidefinite but for its rounding [rump2006]_.
    """
    m, trace = len(gram), float(np.trace(gram))
    if not np.isfinite(gram).all():
        return 0.0
    least = 0.5 * float(np.linalg.eigvalsh(gram)[0])
    try:
        np.linalg.cholesky(gram - least * np.eye(m))
    except np.linalg.LinAlgError:
        return 0.0
    return max((least - error - 4.0 * m * (m + 2.0) * U * trace) / UP, 0.0)


def _as_computed(rows: Rows) -> tuple[str, ...]:
    """Return the friction terms that are results of processing."""
    filtered = rows.samples.wide is not None
    return tuple(
        type(t).__name__ for t in rows.friction.terms if not has_formula(t, filtered=filtered)
    )
