"""Friction terms of a joint that the recorded motion cannot tell apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.estimation.compression.rows import CHUNK, RowSource
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
    products = np.sum(rows.map(_products), axis=0)
    found = []
    parameters, first = rows.friction.parameters, rows.friction.first
    for j, name in enumerate(rows.friction.joint_names):
        own = [i for i, parameter in enumerate(parameters) if parameter.joint == j]
        gram = products[first + j][np.ix_(own, own)]
        size = np.sqrt(np.diag(gram))
        if not len(own):
            continue
        cosine = gram / np.maximum(np.outer(size, size), np.finfo(float).tiny)
        for a in range(len(own)):
            for b in range(a + 1, len(own)):
                if abs(cosine[a, b]) >= ALIKE:
                    names = (parameters[own[a]].name, parameters[own[b]].name)
                    found.append(CollinearTerms(name, *names, float(cosine[a, b])))
    return tuple(found)


def _products(rows: RowSource) -> Array:
    """Return the products of all friction columns at every joint's used rows, (n, f, f)."""
    n, count = rows.robot.n, len(rows.friction.parameters)
    out = np.zeros((n, count, count))
    for start in range(0, rows.n_samples, CHUNK):
        part = slice(start, start + CHUNK)
        columns = np.where(
            rows.mask(part)[:, :, None], rows.friction.columns_in(rows.motion(part)), 0.0
        )
        out += np.einsum("kja,kjb->jab", columns, columns, optimize=True)
    return out
