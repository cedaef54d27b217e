"""What errors of contacts' Jacobians do to the cost of rows.

Of a sample with the residual r, the efforts A of forces that nobody measured and the covariance C,
the cost is the least ``‖r + A·f‖²`` over all forces f, in the norm of C^-1. With another A + D,
``‖D‖ ≤ p``, its root is at most p·‖f‖ larger, f being the best forces for A, and at most
``p/(1 − p·g)·‖f‖ + s·b`` smaller, ``s = (p·g)²/(1 − p·g)``, b being the root for A + D; g is
`ContactWhiteners.force`. Of parameters f is linear (`forces`). docs/theory ("Rows hold
for the robot's equations") has the proof.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.certificate.contact_whiteners import ContactWhiteners, contact_whiteners
from sdpid.assurance.certificate.outward import SLACK as UP
from sdpid.assurance.certificate.outward import UNIT as U
from sdpid.assurance.certificate.outward import below_one, gamma, quotient
from sdpid.assurance.log_proof.enclosure import root
from sdpid.assurance.log_proof.joints import Joint
from sdpid.assurance.log_proof.regressor import motion
from sdpid.assurance.log_proof.touching.forces import ForceErrors
from sdpid.assurance.log_proof.touching.jacobians import JacobianErrors
from sdpid.assurance.log_proof.weights import diagonal_weights
from sdpid.estimation.compression.rows import Rows, RowSource
from sdpid.robot.model.contacts.jacobians import relative_jacobians


@dataclass(frozen=True, kw_only=True, eq=False)
class ContactError:
    """How far Jacobians of contacts move the root of the cost of rows.

    Attributes
    ----------
    columns : ndarray, shape (b,)
        By at most this for each base parameter of size one.
    constant : float
        And by this for any.
    forces : ForceErrors
        And by what the best forces make of errors of Jacobians.
    share : float
        And by this share of the root itself.
    larger : float
        Rows count at most this times what the covariance of efforts alone gives them: rounding of
        that of measured forces may take something from it.
    """

    columns: Array
    constant: float
    forces: ForceErrors
    share: float
    larger: float


def contact_error(rows: Rows, sigma: Array) -> ContactError:
    """Return what errors of Jacobians do to the cost of rows with contacts.

    Infinite where components of a contact's force have errors that depend on each other.

    Parameters
    ----------
    rows : Rows
        The rows.
    sigma : ndarray, shape (n, n) or (K, n, n)
        Covariance of efforts.
    """
    pieces = rows.map(_piece, sigma=sigma)
    return ContactError(
        columns=root(np.sum([piece.columns**2 for piece in pieces], axis=0)),
        constant=float(root(sum(piece.constant**2 for piece in pieces))),
        forces=ForceErrors.sum([piece.forces for piece in pieces]),
        share=max(piece.share for piece in pieces),
        larger=max(piece.larger for piece in pieces),
    )


def _piece(source: RowSource, sigma: Array) -> ContactError:
    """Return what errors do to the rows of a piece."""
    contacts, tree = source.samples.contacts, source.robot.tree
    assert contacts is not None
    R = contacts.force_covariance
    correlated = R is not None and np.any(R[:, ~np.eye(6, dtype=bool)])
    count = source.base.count
    if correlated:
        return ContactError(
            columns=np.full(count, np.inf),
            constant=np.inf,
            forces=ForceErrors.none(count + 1),
            share=np.inf,
            larger=1.0,
        )
    joints = [Joint.of(tree, i) for i in range(len(tree.kind))]
    columns, constant, larger = np.zeros(count + 1), 0.0, 1.0
    found: list[ForceErrors] = [ForceErrors.none(count + 1)]
    most = 0.0
    for part in source.parts():
        own = sigma if sigma.ndim == 2 else sigma[part]
        mask, touching = source.mask(part), source.contacts(part)
        assert touching is not None
        samples = source.samples
        J = relative_jacobians(
            source.robot,
            samples.position[part],
            contacts.frames,
            contacts.against,
            contacts.offset,
            compiled=touching.compiled,
        )
        states = motion(
            tree,
            source.robot.offset,
            samples.position[part],
            samples.velocity[part],
            samples.acceleration[part],
        )
        # An overflow leaves a bound that is infinite or no number.
        with np.errstate(over="ignore", invalid="ignore"):
            errors = JacobianErrors(source.robot, joints, states, contacts, J)
            off = errors.of_columns
            w = diagonal_weights(own, -1.0)
            grown = _grown(J, R, source.force_scale, own, w)
            larger = max(larger, grown)
            factor = np.where(mask, w, 0.0) * grown * UP
            eliminated = errors.of_eliminated(samples.position[part], contacts.down[part])
            moved = root(np.einsum("kcdn,kn->k", eliminated**2, factor**2))
            block = source.rows(part)
            for each in contact_whiteners(touching, own, mask):
                if not each.rank:
                    continue
                p = moved[each.some]
                product = p * each.force * UP
                p = quotient(p, below_one(product))
                W = block[each.some]
                forces = p[:, None, None] * each.grown[:, None, None] * (each.G @ W)
                found.append(ForceErrors.of(forces.reshape(-1, count + 1)))
                left = p[:, None] * _left_open(each, W, factor[each.some])
                columns += np.sum(left**2, axis=0) * UP
                most = max(most, float((p * product * each.force).max()) * UP)
            if contacts.forces is not None and R is not None:
                wrong = _effort_errors(J, off, contacts.forces[part], R, samples.effort[part])
                constant += float(np.sum((factor * wrong) ** 2)) * UP
    *norms, efforts = root(columns) * (1.0 + most) * UP
    return ContactError(
        columns=np.array(norms),
        constant=float(efforts + root(constant)) * UP,
        forces=ForceErrors.sum(found).times((1.0 + most) * UP),
        share=most,
        larger=larger,
    )


def _left_open(each: ContactWhiteners, W: Array, factor: Array) -> Array:
    """Return bounds (g, c) of what G leaves open of the forces that explain columns best.

    That is its rounding, and what another left inverse would find.
    """
    # Rounding of the product, and of the factors before it.
    size = gamma(W.shape[1] + 4) * (np.abs(each.G) @ np.abs(W))
    norms = root(np.einsum("gnc,gn->gc", W**2, factor**2))
    found = each.grown[:, None] * root(np.sum(size**2, axis=1)) + each.lean[:, None] * norms
    return np.asarray(found * UP)


def _grown(J: Array, R: Array | None, scale: float, sigma: Array, w: Array) -> float:
    """Return a factor of weights of Sigma's inverse that makes them weights of C's.

    C as computed is ``Sigma + J^T·R·J`` but for its rounding. The norm of that is a share η of the
    least eigenvalue of Sigma, one over the largest square of a weight, so ``C ⪰ (1 − η)·Sigma``.
    """
    if R is None:
        return 1.0
    variance = np.diagonal(R, axis1=1, axis2=2) * scale
    deviation = np.sqrt(np.where(np.isinf(variance), 0.0, variance)) * UP
    B = (np.abs(J) * deviation[:, :, None]).reshape(len(J), -1, J.shape[3])
    product = np.swapaxes(B, 1, 2) @ B
    size = np.sqrt(np.einsum("knm,knm->k", product, product)).max(initial=0.0)
    rounding = gamma(36 * J.shape[1] + 4) * size
    rounding += 2.0 * U * np.sqrt(np.max(np.sum(sigma**2, axis=(-2, -1)), initial=0.0))
    left = below_one(float(rounding * np.max(w, initial=0.0) ** 2 * UP))
    return float(UP / np.sqrt(left)) if left > 0.0 else np.inf


def _effort_errors(J: Array, off: Array, forces: Array, R: Array, effort: Array) -> Array:
    """Return bounds (k, n) of what the efforts of measured forces are off by, added to efforts."""
    f = np.where(np.isinf(np.diagonal(R, axis1=1, axis2=2)), 0.0, forces)
    norms = np.sqrt(np.sum(f.reshape(*f.shape[:2], 2, 3) ** 2, axis=3)) * UP
    moved = np.einsum("kcdn,kcd->kn", off, norms)
    sizes = np.abs(effort) + np.einsum("kcin,kci->kn", np.abs(J), np.abs(f))
    return np.asarray((moved + gamma(6 * f.shape[1] + 3) * sizes) * UP)
