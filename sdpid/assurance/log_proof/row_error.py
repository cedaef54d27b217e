"""How far the rows that were compressed are from those of the robot's equations of motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sdpid._common.arrays import Array, Indices, frozen
from sdpid.assurance.certificate.outward import SLACK as UP
from sdpid.assurance.certificate.outward import UNIT as U
from sdpid.assurance.certificate.outward import gamma
from sdpid.assurance.log_proof.box import Box
from sdpid.assurance.log_proof.comparison import Piece, piece_of_many, piece_of_one
from sdpid.assurance.log_proof.enclosure import TINY, root
from sdpid.assurance.log_proof.friction_columns import has_formula
from sdpid.assurance.log_proof.touching.error import contact_error
from sdpid.assurance.log_proof.touching.forces import ForceErrors, Near
from sdpid.assurance.log_proof.weights import diagonal_weights, lesser_weights
from sdpid.estimation.compression.covariance import Weighting
from sdpid.estimation.compression.rows import Rows
from sdpid.estimation.constraints.feasible_set import FeasibleSet


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
        What does not depend on theta, and what grows with the cost: zero but for eq9, eq18
        and samples in contact.
    forces : ForceErrors or None
        What forces that nobody measured make of errors of contacts' Jacobians.
    anywhere : float
        What they make of them over the box, beside `share`.
    matrix : ndarray, shape (b, p)
        Base parameters of parameters.
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
    forces: ForceErrors | None
    anywhere: float
    matrix: Array
    box: Box
    taken_as_computed: tuple[str, ...]
    worst: WorstEntry

    @cached_property
    def total(self) -> float:
        """The bound rho for every theta in the box."""
        return self._over(self.box, self.anywhere)

    def at(self, theta: Array) -> float:
        """Return the bound at some parameters (p,)."""
        theta = np.asarray(theta, dtype=np.float64)
        forces = 0.0 if self.forces is None else self.forces.at(*_rounded(self.matrix, theta))
        return self._over(Box.around(theta, len(self.links)), forces)

    def _over(self, box: Box, forces: float) -> float:
        terms = np.concatenate([box.theta * self.columns, (box.bodies * self.links).ravel()])
        found = float((np.sum(terms) + self.constant + forces) * UP + TINY)
        return found if np.isfinite(found) else np.inf


def row_error(
    rows: Rows,
    sigma: Array,
    weighting: Weighting,
    feasible: FeasibleSet,
    *,
    near: Near | None = None,
) -> RowError:
    """Return how far rows are from those of the robot's equations.

    The regressor is enclosed at the samples' own positions, velocities and accelerations, from the
    placements, axes and gravity as stored (`sdpid.robot.model.regressor_kernel.Tree`), and compared
    with the base regressor as it is computed, times B: what is found covers rounding and mistakes
    of the regressor, the sine and cosine, and B, and of the Jacobians of contacts. See docs/theory,
    "Rows hold for the robot's equations".

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
    near : Near, optional
        What the rows were compressed to: of samples in contact the bound is then that of
        parameters that fit, and what is more grows with the cost.

    Returns
    -------
    RowError
    """
    box = Box.of(feasible)
    exponent = -0.5 if weighting == "eq9" else -1.0
    printed = weighting in ("eq9", "eq18")
    if sigma.ndim == 2:
        weights = diagonal_weights(sigma, exponent), lesser_weights(sigma, exponent)
        pieces = rows.map(piece_of_one, weights, box, printed)
    else:
        pieces = rows.map(piece_of_many, exponent, box, printed, sigma=sigma)
    columns = root(np.sum([piece.columns**2 for piece in pieces], axis=0))
    links = root(np.sum([piece.links**2 for piece in pieces], axis=0))
    constant = share = anywhere = 0.0
    forces = None
    if printed:
        whole = _Rows.of(pieces)
        columns, links, constant, share = whole.printed(rows.base.kept, columns, links)
        if not np.array_equal(rows.base.matrix[:, rows.base.kept], np.eye(rows.base.count)):
            share = np.inf  # the columns of W are not what B says
    if rows.samples.contacts is not None:
        touching = contact_error(rows, sigma)
        # What is not bounded is infinite, and so are all parameters.
        moved = np.full(len(columns), np.inf)
        if np.isfinite(touching.columns).all():
            moved = touching.columns @ np.abs(rows.base.matrix)
        columns = (columns * touching.larger + moved) * UP
        links = links * touching.larger * UP
        constant, share, forces = touching.constant, touching.share, touching.forces
        limit = np.abs(rows.base.matrix) @ box.theta * UP
        anywhere = forces.over(limit)
        if near is not None:
            grows, beside = forces.spread(near, limit)
            beside += forces.at(near.base, np.zeros(len(limit)))
            if np.isfinite([grows, beside]).all():
                share, anywhere = share + grows, beside * UP
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
        forces=forces,
        anywhere=anywhere,
        matrix=rows.base.matrix,
        box=box,
        taken_as_computed=_as_computed(rows),
        worst=WorstEntry(
            rows.robot.joint_names[joint], first + sample, rows.base.theta_names[column], error
        ),
    )


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
    def of(cls, pieces: Sequence[Piece]) -> _Rows:
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


def _rounded(matrix: Array, theta: Array) -> tuple[Array, Array]:
    """Return base parameters of parameters, and bounds of their rounding."""
    off = gamma(matrix.shape[1]) * (np.abs(matrix) @ np.abs(theta))
    return matrix @ theta, off * UP + TINY


def _as_computed(rows: Rows) -> tuple[str, ...]:
    """Return the friction terms that are results of processing."""
    filtered = rows.samples.wide is not None
    return tuple(
        type(t).__name__ for t in rows.friction.terms if not has_formula(t, filtered=filtered)
    )
