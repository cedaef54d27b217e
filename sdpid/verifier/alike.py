"""Beliefs that links are nearly mirror images of each other: the rows of a prior that say so.

A belief names two links, the ``reflection`` M that maps the first joint's frame to the second's,
the ``inverse`` C of a body's 4×4 matrix, and a share ``within``. It costs

    tr(C·D·C·D)/within²,  D = P_2 − M·P_1·M^T,

P_1 and P_2 being the matrices of the two links. The last ten rows of the prior for each belief, in
their order, have to be this: their Gram matrix is compared, number by number, and all else in them
has to be zero.
"""

from __future__ import annotations

from fractions import Fraction
from math import sqrt
from typing import Any

from .bodies import link_matrix
from .exact import factorize, inner, product, transposed
from .reading import MalformedError, index, items, numbers, require_keys

KEYS = ("first", "second", "reflection", "inverse", "within")
_ROWS = 10

# Rows come from a factorization of C in doubles, relative to the size of a number of the Gram
# matrix; that of thin bodies is not well conditioned.
_ROUNDED = 1e-6

# A reflection of a description is orthogonal to its digits.
_ORTHOGONAL = 1e-6


def wrong_beliefs(problem: dict[str, Any], links: int) -> list[str]:
    """Return which beliefs the rows of the prior do not have, in words.

    Parameters
    ----------
    problem : dict
        Of a certificate.
    links : int
        How many links there are.

    Raises
    ------
    MalformedError
        Where a belief makes no sense.
    """
    beliefs = items(problem.get("alike", []), "alike")
    if not beliefs:
        return []
    rows, rhs = problem["prior_matrix"], problem["prior_rhs"]
    if len(beliefs) * _ROWS > len(rows):
        raise MalformedError(f"{len(beliefs)} beliefs in {len(rows)} rows of a prior")
    first = len(rows) - len(beliefs) * _ROWS
    wrong = []
    for number, given in enumerate(beliefs):
        own = slice(first + number * _ROWS, first + (number + 1) * _ROWS)
        belief = require_keys(given, KEYS, f"belief {number + 1}")
        one, two = (index(belief[key], links) for key in ("first", "second"))
        if one == two:
            raise MalformedError(f"belief {number + 1} is about one link")
        wanted = _gram(belief, number + 1)
        if not _as_wanted(rows[own], rhs[own], (one, two), wanted):
            wrong.append(f"rows of the prior are not belief {number + 1} in links that are alike")
    return wrong


def in_words(problem: dict[str, Any], names: list[str]) -> str:
    """Return the beliefs in words: nothing where there are none."""
    beliefs = problem.get("alike", [])
    if not beliefs:
        return ""
    shares = sorted({100.0 * float(each["within"]) for each in beliefs})
    pairs = [f"{names[each['second']]} of {names[each['first']]}" for each in beliefs]
    sizes = " and ".join(f"{share:.6g}" for share in shares)
    return (
        f", the last {len(beliefs) * _ROWS} of which believe links to be mirror images within "
        f"{sizes} %: {', '.join(pairs)}"
    )


def _gram(belief: dict[str, Any], number: int) -> list[list[Fraction]]:
    """Return the 20×20 matrix of the cost in the parameters of both links."""
    M, C = numbers(belief["reflection"], 4, 4), numbers(belief["inverse"], 4, 4)
    if (within := Fraction(numbers(belief["within"]))) <= 0:
        raise MalformedError(f"the share of belief {number} is not positive")
    turned = [row[:3] for row in M[:3]]
    squares = product_of(transposed(turned), turned)
    off = max(abs(squares[i][j] - (i == j)) for i in range(3) for j in range(3))
    if off > _ORTHOGONAL or M[3] != [0.0, 0.0, 0.0, 1.0] or _determinant(turned) > 0:
        raise MalformedError(f"the reflection of belief {number} is none")
    if any(C[i][j] != C[j][i] for i in range(4) for j in range(i)) or factorize(C)[1] <= 0:
        raise MalformedError(f"the inverse of belief {number} is not symmetric and definite")
    units = [link_matrix([int(i == k) for i in range(10)], "pseudo_inertia") for k in range(10)]
    images = [product_of(product_of(M, unit), transposed(M)) for unit in units]
    D = [[[-x for x in row] for row in image] for image in images] + units
    left = [product_of(product_of(C, each), C) for each in D]
    return [[inner(a, b) / within**2 for b in D] for a in left]


def _as_wanted(
    rows: list[Any], rhs: list[Any], links: tuple[int, int], wanted: list[list[Fraction]]
) -> bool:
    """Return whether the rows cost what a belief costs, and nothing else."""
    own = [10 * link + k for link in links for k in range(10)]
    other = set(range(len(rows[0]))) - set(own)
    if any(rhs) or any(row[k] for row in rows for k in other):
        return False
    columns = [[Fraction(row[k]) for row in rows] for k in own]
    for i, one in enumerate(columns):
        for j, two in enumerate(columns[: i + 1]):
            found = sum((a * b for a, b in zip(one, two, strict=True)), Fraction(0))
            size = sqrt(wanted[i][i] * wanted[j][j])
            if abs(found - wanted[i][j]) > _ROUNDED * size:
                return False
    return True


def product_of(A: Any, B: Any) -> list[list[Fraction]]:
    """Return the product of two matrices."""
    columns = transposed(B)
    return transposed([product(A, column) for column in columns])


def _determinant(M: Any) -> Fraction:
    """Return the determinant of a 3×3 matrix."""
    (a, b, c), (d, e, f), (g, h, i) = ([Fraction(x) for x in row] for row in M)
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
