"""Where each standard parameter comes from: the data, the physics, or the prior.

What is divided is the uncertainty that the prior alone would leave. Each parameter is measured in
units of the standard deviation that the prior gives it, theta = D·z, and is then the direction e_k
with a variance of one. Three things account for all of it:

* **physics**: constraints that are active at the estimate hold directions still. With T an
  orthonormal basis of those that stay free, ``1 − ‖T^T·e_k‖²`` is gone. An inequality F ⪰ 0 with
  null vectors u_i leaves those dtheta free that keep ``u_i^T·F(dtheta)·u_j = 0``.
* **data**: of the rest a = T^T·e_k, the data take the variance from ``‖a‖²`` down to
  ``a^T·(E + H)^(-1)·a``, with H = T^T·D·G^T·G·D·T of the whitened rows G.
* **prior**: what remains is known no better than before.

These shares are between 0 and 1 and sum to one. It is a statement of first order about the
estimate at hand: of constraints that bend, the tangent is used, and a parameter that is sharp in
the data but held by a constraint counts as physics.

Correlations that the prior has between the parameters of a body are left out on purpose (D is
diagonal): with them, data on one moment of inertia would count as data on the others of the body,
of which the effort shows nothing. So a parameter without influence on the effort has no share of
data unless an active constraint ties it to one that has.

Where no prior was asked, or nothing is believed of a link, the rule that chooses among equally
good parameters the nearest to a reference stands for it, as the limit of a prior of vanishing
strength in that distance: whatever the data show at all is data, the invisible is prior. A
parameter that the data show only together with others has a part of both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid._common.tables import Table
from sdpid.errors import DataError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.posterior import prior_rows
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling, congruent
from sdpid.robot.friction.position import OneJoint

# A scaled matrix is singular where an eigenvalue is at most this share of its largest, and a bound
# or row is at its limit within this share of the parameters' size. Interior-point solutions come
# to within some 1e-8 of a constraint that the data press on, and the search for the nearest of
# equally good parameters to within some 1e-6; a body so thin, 0.3 % of its size, is flat.
ACTIVE = 1e-5

# Weight of the rule that stands for a missing prior, relative to the largest singular value of the
# data's rows in scaled coordinates: invisible directions are at rounding, 1e-15 or so.
_VANISHING = 1e-9

# Added to the correlations of what was believed, which rounding may leave singular.
_ROUNDING = 1e-12

# Cosine between two columns from which on they count as one. On recordings of six real arms a
# narrow sign and a sigmoid come to 0.997; a motion in one direction, whose Coulomb friction is an
# offset, to 0.9999.
ALIKE = 0.998

# Normals of active constraints, of unit length, are independent above this.
_INDEPENDENT = 1e-8

_SOURCES = ("data", "physics", "prior")


@dataclass(frozen=True, kw_only=True, eq=False)
class Provenance:
    """Shares of data, physics and prior in each standard parameter.

    The three arrays are between 0 and 1 and sum to one (see
    `sdpid.assurance.diagnostics.provenance` for what exactly is divided).

    Attributes
    ----------
    names : tuple of str
        The standard parameters.
    data, physics, prior : ndarray, shape (p,)
        Shares of the prior variance that the data take away, that active constraints take away
        (also those that the user set), and that is left.
    """

    names: tuple[str, ...]
    data: Array
    physics: Array
    prior: Array

    def to_dict(self) -> dict[str, dict[str, float]]:
        """Return the shares by parameter and source."""
        shares = np.stack([self.data, self.physics, self.prior], axis=1).tolist()
        rows = zip(self.names, shares, strict=True)
        return {name: dict(zip(_SOURCES, row, strict=True)) for name, row in rows}

    def table(self) -> str:
        """Return the shares as text, in percent, one line a parameter."""
        columns = {"parameter": self.names}
        columns |= {source: getattr(self, source) for source in _SOURCES}
        return Table.of_columns(columns, dict.fromkeys(_SOURCES, ".1%")).text()


def provenance(estimate: Estimate) -> Provenance:
    """Divide each standard parameter between data, physics and prior.

    Parameters
    ----------
    estimate : Estimate
        With standard parameters.

    Returns
    -------
    Provenance

    Raises
    ------
    DataError
        When the method has no standard parameters.
    """
    if estimate.theta is None:
        raise DataError(
            f"provenance: method '{estimate.method}' gives no standard parameters; ask an "
            "estimate of a constrained solver, or one with a prior."
        )
    problem, theta = estimate.problem, estimate.theta
    basis = Scaling.of(problem).basis()
    believed, rows = prior_rows(estimate) @ basis, problem.base.matrix
    # Without a prior every direction that the base parameters span is shown, however well.
    if problem.prior is not None:
        rows = problem.A @ rows
    vanishing = _VANISHING * float(np.linalg.norm(rows @ basis, 2)) or 1.0
    # The triangle of the prior's information, whose inverse has the standard deviations as norms.
    root = np.asarray(np.linalg.qr(np.vstack([believed, vanishing * np.eye(len(theta))]), mode="r"))
    deviation = np.linalg.norm(np.linalg.solve(root.T, basis.T), axis=0)
    # The closed form without constraints is the one method that does not look at them.
    free = estimate.method == "wls"
    normals = np.zeros((0, len(theta))) if free else _active_normals(problem, theta)
    tangent = _null_space(normals * deviation)
    _, singular, axes = np.linalg.svd((rows * deviation) @ tangent, full_matrices=False)
    # The variance left is 1/(1 + s²) along each singular direction, and one across all.
    gain = singular**2 / (1.0 + singular**2)
    taken = np.sum(gain * (tangent @ axes.T) ** 2, axis=1)
    held = np.clip(1.0 - np.sum(tangent**2, axis=1), 0.0, 1.0)
    taken = np.clip(taken, 0.0, 1.0 - held)
    return Provenance(
        names=problem.base.theta_names,
        data=frozen(taken),
        physics=frozen(held),
        prior=frozen(1.0 - held - taken),
    )


def _active_normals(problem: Problem, theta: Array) -> Array:
    """Return the normals (m, p) of all constraints that are active at theta."""
    feasible, scaling = problem.feasible, Scaling.of(problem).around(theta)
    at_bound = np.minimum(theta - feasible.lower, feasible.upper - theta) <= ACTIVE * scaling.theta
    values = feasible.rows @ theta
    room = np.minimum(values - feasible.row_lower, feasible.row_upper - values)
    at_limit = room <= ACTIVE * scaling.row_sizes(feasible)
    normals = [np.eye(len(theta))[at_bound], feasible.rows[at_limit]]
    inverses = scaling.inverses(feasible)
    values, vectors = np.linalg.eigh(congruent(inverses, feasible.matrices(theta)))
    for k, link in enumerate(feasible.block_links):
        active = values[k] <= ACTIVE * max(float(values[k, -1]), 0.0)
        null = inverses[k].T @ vectors[k][:, active]
        products = null.T @ feasible.block_basis[k] @ null
        i, j = np.triu_indices(null.shape[1])
        normal = np.zeros((len(i), len(theta)))
        normal[:, 10 * link : 10 * link + 10] = products[:, i, j].T
        normals.append(normal)
    return np.vstack(normals)


def _null_space(rows: Array) -> Array:
    """Return an orthonormal basis (p, q) of the directions that rows (m, p) do not see."""
    length = np.linalg.norm(rows, axis=1)
    seen = length > 0.0
    _, singular, vectors = np.linalg.svd(rows[seen] / length[seen, None])
    return np.asarray(vectors[int(np.count_nonzero(singular > _INDEPENDENT)) :].T)


def directions_told(estimate: Estimate) -> int | None:
    """Return of how many directions of the base parameters the data tell more than the prior.

    Directions are those that data and prior share: along each the variance that the data alone
    would leave is set beside that which the prior alone does.

    Parameters
    ----------
    estimate : Estimate
        Of a problem with the cost of its rows in nats, as ``weighting="residual"`` makes it.

    Returns
    -------
    int or None
        None without a prior, or where it says nothing of some parameter.
    """
    A, B = estimate.problem.A, estimate.problem.base.matrix
    root = np.asarray(np.linalg.qr(prior_rows(estimate), mode="r"))
    if root.shape[0] < root.shape[1] or not np.all(np.diagonal(root) != 0.0):
        return None
    believed = np.linalg.solve(root.T, B.T)
    covariance = believed.T @ believed
    scale = np.sqrt(np.diagonal(covariance))
    correlation = covariance / np.outer(scale, scale) + _ROUNDING * np.eye(len(B))
    told = np.linalg.svd((A * scale) @ np.linalg.cholesky(correlation), compute_uv=False)
    return int(np.count_nonzero(told > 1.0))


@dataclass(frozen=True)
class CollinearTerms:
    """Two friction parameters of a joint whose efforts are proportional in the recording.

    Attributes
    ----------
    joint : str
        The joint.
    first, second : str
        The parameters, such as ``"Fs3"`` and ``"Fv3"``.
    correlation : float
        Cosine between their columns, 1 or −1 where they are proportional.
    """

    joint: str
    first: str
    second: str
    correlation: float


def in_words(found: Sequence[CollinearTerms]) -> str | None:
    """Return pairs of terms in a sentence with the remedy, None where there are none."""
    if not found:
        return None
    pairs = ", ".join(
        f"{pair.first} and {pair.second} of {pair.joint} ({pair.correlation:.4f})" for pair in found
    )
    return (
        f"friction that this recording cannot tell apart (correlation): {pairs}; only one "
        "combination of each pair is known, and the prior shares it between them: record speeds "
        "that vary more, in both directions"
    )


def hidden_terms(problem: Problem) -> tuple[tuple[str, str, float], ...]:
    """Return parameters of terms of one joint's position, and how much of them the motion shows.

    That is the share of a column, weighted as in the fit, that is not in the span of all others;
    zero where the parameter is no base parameter of its own. What is known is left out.
    """
    friction, links = problem.friction, 10 * problem.robot.n_links
    terms = [(term, own) for term, own in friction.placed if isinstance(term, OneJoint)]
    if not terms:
        return ()
    size, found = np.linalg.norm(problem.A, axis=0), list[tuple[str, str, float]]()
    inverse = np.linalg.pinv(problem.A / np.where(size > 0.0, size, 1.0))
    for term, own in terms:
        for k, parameter in enumerate(friction.parameters[own], links + own.start):
            column = np.flatnonzero((problem.base.kept == k) & (size > 0.0))
            share = float(1.0 / np.linalg.norm(inverse[column[0]])) if len(column) else 0.0
            if parameter.value is None:
                found.append((parameter.name, term.joint, share))
    return tuple(found)


def collinear_friction(problem: Problem) -> tuple[CollinearTerms, ...]:
    """Find friction parameters of a joint that the recorded motion cannot tell apart.

    Parameters
    ----------
    problem : Problem
        With its rows here.

    Returns
    -------
    tuple of CollinearTerms
        Pairs of one joint.
    """
    rows = problem.require_rows_here("collinear friction")
    friction, first = rows.friction, rows.friction.first
    joints = np.array([parameter.joint for parameter in friction.parameters])
    owners = [np.flatnonzero(joints == j) for j in range(len(friction.joint_names))]
    products = [np.zeros((len(own), len(own))) for own in owners]
    for part in rows.parts():
        mask, columns = rows.mask(part), friction.columns_in(rows.motion(part))
        for j, own in enumerate(owners, first):
            used = columns[mask[:, j], j][:, own]
            products[j - first] += used.T @ used
    found = []
    for joint, own, gram in zip(friction.joint_names, owners, products, strict=True):
        names, size = [friction.parameters[i].name for i in own], np.sqrt(np.diag(gram))
        cosine = gram / np.maximum(np.outer(size, size), np.finfo(float).tiny)
        for a, b in combinations(range(len(own)), 2):
            if abs(cosine[a, b]) >= ALIKE:
                found.append(CollinearTerms(joint, names[a], names[b], float(cosine[a, b])))
    return tuple(found)
