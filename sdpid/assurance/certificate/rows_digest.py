"""Hash the samples that a problem was made of."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.problem import Problem
from sdpid.experiment.processing.contact_samples import ContactSamples
from sdpid.experiment.processing.samples import Samples

# What the rows are made of, in the order in which it is hashed.
_FIELDS = ("position", "velocity", "acceleration", "effort", "mask", "covariance")
_OF_CONTACTS = ("offset", "down", "forces", "force_covariance")


def rows_digest(problem: Problem) -> str | None:
    """Return the SHA-256 of the samples: shape and little-endian doubles of each array.

    Of several pieces it is that of their digests, one behind the other; None where the rows were
    not kept.
    """
    if problem.rows is None:
        return None
    digests: Sequence[str] = problem.rows.map(_of_rows)
    whole = "".join(digests)
    return whole if len(digests) == 1 else hashlib.sha256(whole.encode()).hexdigest()


def _of_rows(rows: RowSource) -> str:
    """Return the digest of samples and of further numbers that rows are made of."""
    digest = _of_piece(rows.samples)
    if not rows.hashed:
        return digest
    found = hashlib.sha256(digest.encode())
    for array in rows.hashed:
        found.update(np.ascontiguousarray(array, dtype="<f8").data)
    return found.hexdigest()


def _of_piece(samples: Samples) -> str:
    found = hashlib.sha256()
    _add(found, samples, _FIELDS)
    if (contacts := samples.contacts) is not None:
        # Which there are, when they are closed, and what is known of their forces.
        found.update(f"contacts: {contacts.frames} {contacts.kind}\n".encode())
        if any(contacts.against):
            found.update(f"against: {contacts.against}\n".encode())
        _add(found, contacts, _OF_CONTACTS)
    return found.hexdigest()


def _add(found: Any, of: Samples | ContactSamples, names: Sequence[str]) -> None:
    """Hash arrays, or that there are none."""
    for name in names:
        values: Any = getattr(of, name)
        if values is None:
            found.update(f"{name}: none\n".encode())
            continue
        array = np.ascontiguousarray(values, dtype="<f8")
        found.update(f"{name}: {array.shape}\n".encode())
        found.update(array.data)
