"""Cone programs that look for weights of base parameters which contradict a table.

Everything here is in floating point and only proposes; `sdpid.assurance.tables.refutation` decides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.tables.facial_reduction import Face
from sdpid.assurance.tables.witness_search import Search
from sdpid.estimation.conic.solve import ConicProgram, Matrix, solve_conic
from sdpid.robot.inertia import TENSOR_INDEX


@dataclass(frozen=True, eq=False)
class Weights:
    """Weights that a program found.

    Attributes
    ----------
    face : Face
        Where they lie.
    free : ndarray
        The free ones.
    masses : ndarray, shape (links,) or (0,)
        Multipliers of the bound on masses.
    violation : float
        By how much the table contradicts what they say.
    interior : float
        How far inside the cone they are, in scaled units.
    """

    face: Face
    free: Array
    masses: Array
    violation: float
    interior: float

    def support(self) -> Array:
        """Return the weights over the support."""
        return np.asarray(self.face.matrix() @ self.free)


def weigh(
    search: Search,
    face: Face,
    *,
    mass_bound: bool,
    norm: Array | None = None,
    cost: Array | None = None,
    least: float | None = None,
    interior: bool = False,
    of_margin: bool = False,
) -> Weights | None:
    """Look for weights of the base parameters that contradict the table.

    Parameters
    ----------
    search : Search
        The question.
    face : Face
        Which weights there may be.
    mass_bound : bool
        Whether the bound on masses may be used.
    norm : ndarray, optional
        Bounds ``Σ norm·|weight| ≤ 1``, over the support.
    cost : ndarray, optional
        Minimises ``Σ cost·|weight|``.
    least : float, optional
        By how much to contradict at least.
    interior : bool, optional
        Go as far inside the cone as possible; without it and without `cost`, contradict as
        much as possible.
    of_margin : bool, optional
        Scale the weights such that what they say is a bound on the margin, instead of `norm`.
    """
    q, M, L = search.question, search.scaling.mass, search.scaling.length
    support = list(face.support)
    R, unit = search.R[support], M * search.unit[support]
    # Free weights in units of their own row's size.
    own = np.array([M * search.unit[k] for k in face.free])
    N = face.matrix() / own[None, :]
    free, links = len(face.free), q.n_links if mass_bound else 0
    width = free + len(support) + links + 1
    at_a, at_n, at_s = free, free + len(support), width - 1
    coefficients = R.T @ N
    violation = np.zeros(width)
    violation[:free] = -search.value[support] @ N
    violation[at_a:at_n] = -search.half[support] / unit
    # Multipliers of masses in units of one over the mass of a scale.
    violation[at_n:at_s] = -float(q.mass_max) / M
    traces = coefficients[: 10 * q.n_links].reshape(-1, 10, free)[:, [4, 6, 9]].sum(axis=(0, 1))
    spread = np.zeros(width)
    spread[:free] = (2.0 if q.consistency == "pseudo_inertia" else 1.0) * traces
    violation = violation + float(q.margin) * spread
    C, low, high = [], [], []

    def add(rows: Array, below: float = -np.inf, above: float = np.inf) -> None:
        rows = np.atleast_2d(rows)
        C.append(rows)
        low.append(np.full(len(rows), below))
        high.append(np.full(len(rows), above))

    for sign in (1.0, -1.0):
        rows = np.zeros((len(support), width))
        rows[:, :free] = sign * unit[:, None] * N
        rows[:, at_a:at_n] = np.eye(len(support))
        add(rows, below=0.0)
    if links:
        rows = np.zeros((links, width))
        rows[:, at_n:at_s] = np.eye(links)
        add(rows, below=0.0)
    signed = [j for j in sorted(q.nonnegative) if np.any(coefficients[j] != 0.0)]
    if signed:
        rows = np.zeros((len(signed), width))
        size = search.scaling.theta[signed]
        rows[:, :free] = size[:, None] * coefficients[signed]
        rows[:, at_s] = -1.0
        add(rows, below=0.0)
    if norm is not None:
        row = np.zeros(width)
        row[at_a:at_n] = norm / unit
        add(row, above=1.0)
    if least is not None:
        add(violation, below=least)
    body = M * L**2
    if of_margin:
        add(spread * body, below=1.0, above=1.0)
    row = np.zeros(width)
    row[at_s] = 1.0
    add(row, below=0.0, above=1.0 if interior else 0.0)
    blocks = _weight_blocks(search, face, coefficients, at_n if links else None, at_s)
    objective = np.zeros(width)
    if cost is not None:
        objective[at_a:at_n] = cost / unit
    elif interior:
        objective[at_s] = -1.0
    else:
        objective = -violation
    solution = solve_conic(
        ConicProgram(
            M=np.zeros((0, width)),
            m=np.zeros(0),
            cost=objective,
            C=np.vstack(C),
            lower=np.concatenate(low),
            upper=np.concatenate(high),
            blocks=tuple(blocks),
        )
    )
    if solution.x is None or "Infeasible" in solution.status:
        return None
    x = solution.x
    return Weights(
        face,
        x[:free] / own,
        x[at_n:at_s] / M if links else np.zeros(0),
        float(violation @ x),
        float(x[at_s]),
    )


def _weight_blocks(
    search: Search, face: Face, coefficients: Array, masses: int | None, at_s: int
) -> list[Matrix]:
    """Return Q, and C where it counts, of every link on its face, in scaled units."""
    M, L = search.scaling.mass, search.scaling.length
    free = coefficients.shape[1]
    out = []
    tensor = np.eye(3)
    for link, (rows_C, rows_Q) in enumerate(face.alive):
        c = coefficients[10 * link : 10 * link + 10]
        # Of the symmetric map: C from coefficients, off-diagonal ones are counted twice.
        C = np.zeros((free, 3, 3))
        for k, (i, j) in enumerate(TENSOR_INDEX):
            C[:, i, j] = C[:, j, i] = c[4 + k] * (1.0 if i == j else 0.5)
        Q = np.zeros((free, 4, 4))
        Q[:, :3, :3] = np.trace(C, axis1=1, axis2=2)[:, None, None] * tensor - C
        Q[:, :3, 3] = Q[:, 3, :3] = 0.5 * c[1:4].T
        Q[:, 3, 3] = c[0]
        scale = np.sqrt(M) * np.array([L, L, L, 1.0])
        for matrix, rows, bounded in ((C, rows_C, False), (Q, rows_Q, masses is not None)):
            if not rows:
                continue
            part = np.ix_(range(free), rows, rows)
            d = scale[rows]
            linear = [*(matrix[part] * d[:, None] * d[None, :])]
            index = list(range(free))
            if bounded and masses is not None:
                corner = np.zeros((len(rows), len(rows)))
                corner[-1, -1] = 1.0
                linear.append(corner)
                index.append(masses + link)
            linear.append(-np.eye(len(rows)))
            index.append(at_s)
            out.append(
                Matrix(
                    np.array(index, dtype=np.intp),
                    np.array(linear),
                    np.zeros((len(rows), len(rows))),
                )
            )
    return out
