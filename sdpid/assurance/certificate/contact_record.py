"""What a certificate says of the contacts in the samples that it is of."""

from __future__ import annotations

from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.estimation.compression.rows import Rows, RowSource
from sdpid.estimation.compression.whitening import weights_and_shares


def contact_record(rows: Rows | None, sigma: Array) -> dict[str, Any] | None:
    """Return which contacts rows have, how they were weighted, and what they took, for JSON.

    Parameters
    ----------
    rows : Rows or None
        The rows of a problem.
    sigma : ndarray, shape (n, n) or (K, n, n)
        Their covariance.

    Returns
    -------
    dict or None
        As ``contacts`` in docs/guides/certificate.md; None without contacts or rows.
    """
    contacts = None if rows is None else rows.samples.contacts
    if rows is None or contacts is None:
        return None
    pieces = rows.map(_counts, sigma=sigma)
    closed = sum(each for each, _ in pieces)
    ranks = sum(each for _, each in pieces)
    forces = None
    if contacts.force_covariance is not None:
        scale = rows.force_scale if isinstance(rows, RowSource) else 1.0
        variances = scale * np.diagonal(contacts.force_covariance, axis1=1, axis2=2)
        forces = [[_finite(each) for each in own] for own in np.sqrt(variances)]
    own = None if sigma.ndim == 3 else np.sqrt(np.diagonal(sigma)).tolist()
    return {
        "frames": list(contacts.names),
        "kinds": list(contacts.kind),
        "offsets": contacts.offset.tolist(),
        "widened_s": contacts.widened_s,
        "closed": np.asarray(closed).tolist(),
        "ranks": [[rank, count] for rank, count in enumerate(np.asarray(ranks).tolist()) if count],
        "force_deviations": forces,
        "base_rows": rows.robot.n_base,
        "effort_deviations": own,
    }


def _counts(rows: RowSource, sigma: Array) -> tuple[Indices, Indices]:
    """Return how many samples of a piece each contact is closed in, and how many lose each rank."""
    contacts = rows.samples.contacts
    assert contacts is not None
    ranks = np.zeros(rows.robot.n + 1, dtype=np.intp)
    for part in rows.parts():
        used = np.count_nonzero(rows.mask(part), axis=1)
        left = np.rint(weights_and_shares(rows, part, sigma)[2].sum(axis=1)).astype(np.intp)
        ranks += np.bincount(used - left, minlength=len(ranks))
    return np.count_nonzero(contacts.down, axis=0), ranks


def _finite(value: float) -> float | None:
    """Return a deviation for JSON, None where a component is not measured."""
    return float(value) if np.isfinite(value) else None
