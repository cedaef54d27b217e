"""Friction terms of a joint that the recorded motion cannot tell apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.problem import Problem

# Cosine between two columns from which on they count as one. On recordings of six real arms a
# narrow sign and a sigmoid come to 0.997; a motion in one direction, whose Coulomb friction is an
# offset, to 0.9999.
ALIKE = 0.998


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
    pieces = rows.map(_products)
    found = []
    parameters = rows.friction.parameters
    for j, (name, own) in enumerate(zip(rows.friction.joint_names, _own(rows), strict=True)):
        gram = np.sum([piece[j] for piece in pieces], axis=0)
        size = np.sqrt(np.diag(gram))
        cosine = gram / np.maximum(np.outer(size, size), np.finfo(float).tiny)
        for a in range(len(own)):
            for b in range(a + 1, len(own)):
                if abs(cosine[a, b]) >= ALIKE:
                    names = (parameters[own[a]].name, parameters[own[b]].name)
                    found.append(CollinearTerms(name, *names, float(cosine[a, b])))
    return tuple(found)


def _own(rows: RowSource) -> list[Indices]:
    """Return the places of the friction parameters of each joint."""
    joints = np.array([parameter.joint for parameter in rows.friction.parameters])
    return [np.flatnonzero(joints == j) for j in range(len(rows.friction.joint_names))]


def _products(rows: RowSource) -> list[Array]:
    """Return the products of each joint's friction columns at its used rows, (f, f)."""
    first, owners = rows.friction.first, _own(rows)
    out = [np.zeros((len(own), len(own))) for own in owners]
    for part in rows.parts():
        mask, columns = rows.mask(part), rows.friction.columns_in(rows.motion(part))
        for j, own in enumerate(owners):
            used = columns[mask[:, first + j], first + j][:, own]
            out[j] += used.T @ used
    return out
