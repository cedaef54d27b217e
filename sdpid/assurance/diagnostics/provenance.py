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

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid.errors import DataError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling

# A scaled matrix is singular where an eigenvalue is at most this share of its largest, and a bound
# or row is at its limit within this share of the parameters' size. Interior-point solutions come
# to within some 1e-8 of a constraint that the data press on, and the search for the nearest of
# equally good parameters to within some 1e-6; a body so thin, 0.3 % of its size, is flat.
ACTIVE = 1e-5

# Weight of the rule that stands for a missing prior, relative to the largest singular value of the
# data's rows in scaled coordinates: invisible directions are at rounding, 1e-15 or so.
_VANISHING = 1e-9

# Normals of active constraints, of unit length, are independent above this.
_INDEPENDENT = 1e-8


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
        return {
            name: {"data": data, "physics": physics, "prior": prior}
            for name, data, physics, prior in zip(
                self.names,
                self.data.tolist(),
                self.physics.tolist(),
                self.prior.tolist(),
                strict=True,
            )
        }

    def table(self) -> str:
        """Return the shares as text, in percent, one line a parameter."""
        width = max(map(len, ("parameter", *self.names)))
        lines = [f"{'parameter':<{width}}  {'data':>6}  {'physics':>7}  {'prior':>6}"]
        for name, shares in self.to_dict().items():
            data, physics, prior = (100.0 * share for share in shares.values())
            lines.append(f"{name:<{width}}  {data:>5.1f}%  {physics:>6.1f}%  {prior:>5.1f}%")
        return "\n".join(lines)


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
    rows, believed = _information(problem, theta)
    believed = believed @ basis
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


def _information(problem: Problem, theta: Array) -> tuple[Array, Array]:
    """Return rows of the data's and of the prior's information on theta."""
    if problem.prior is None:
        # Every direction that the base parameters span is shown; how well does not matter.
        return problem.base.matrix, np.zeros((0, len(theta)))
    rows = [term.curvature_rows(theta) for term in problem.prior.terms]
    return problem.A @ problem.base.matrix, np.vstack(rows)


def _active_normals(problem: Problem, theta: Array) -> Array:
    """Return the normals (m, p) of all constraints that are active at theta."""
    feasible = problem.feasible
    scaling = Scaling.of(problem).around(theta)
    size = scaling.theta
    identity = np.eye(len(theta))
    at_bound = np.minimum(theta - feasible.lower, feasible.upper - theta) <= ACTIVE * size
    normals = [identity[at_bound]]
    values = feasible.rows @ theta
    room = np.minimum(values - feasible.row_lower, feasible.row_upper - values)
    normals.append(feasible.rows[room <= ACTIVE * scaling.row_sizes(feasible)])
    roots = scaling.block_roots(feasible)
    for link, F, basis, D in zip(
        feasible.block_links,
        feasible.matrices(theta),
        feasible.block_basis,
        roots,
        strict=True,
    ):
        inverse = np.linalg.inv(D)
        eigenvalues, vectors = np.linalg.eigh(inverse @ F @ inverse.T)
        null = inverse.T @ vectors[:, eigenvalues <= ACTIVE * max(float(eigenvalues[-1]), 0.0)]
        products = null.T @ basis @ null
        i, j = np.triu_indices(null.shape[1])
        normal = np.zeros((len(i), len(theta)))
        normal[:, 10 * link : 10 * link + 10] = products[:, i, j].T
        normals.append(normal)
    return np.vstack(normals)


def _null_space(rows: Array) -> Array:
    """Return an orthonormal basis (p, q) of the directions that rows (m, p) do not see."""
    length = np.linalg.norm(rows, axis=1)
    rows = rows[length > 0.0] / length[length > 0.0, None]
    if not len(rows):
        return np.eye(rows.shape[1])
    _, singular, vectors = np.linalg.svd(rows)
    return np.asarray(vectors[int(np.count_nonzero(singular > _INDEPENDENT)) :].T)
