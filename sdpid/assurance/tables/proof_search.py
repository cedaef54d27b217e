"""Refutations found by cone programs, made short, and made exact.

A proof with few numbers can be checked by hand. A reweighted sum of sizes makes most weights zero;
of the others, one after the other is left out as long as the rest still contradict the table. What
is left is rounded to as few digits as still prove it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from fractions import Fraction

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.tables.facial_reduction import Face, find_face
from sdpid.assurance.tables.refutation import Refutation
from sdpid.assurance.tables.weight_program import WeightProgram, Weights
from sdpid.assurance.tables.witness import Question
from sdpid.assurance.tables.witness_search import Search
from sdpid.verifier.exact import positive_semidefinite
from sdpid.verifier.realizable import coefficient_matrices

# A contradiction below this, with weights of size one, is a solver's rounding.
_CONTRADICTS = 1e-7

# Shares of the largest contradiction that weights must keep while they go inside the cone.
_SHARES = (0.5, 0.9, 0.1, 0.99, 0.999)

# Digits of a double.
_DIGITS = 15

# Rounds of reweighting, and where a weight counts as none, as shares of the largest.
_ROUNDS = 8
_NOTHING = 1e-4
_SOFT = 1e-2

# Up to this many free weights each of them is tried as the one that is made 1.
_SMALL_SUPPORT = 14

# Rounding of weights that are written with all digits, and of the matrices that follow.
_TINY = 1e-14

# A bound on the margin gives way by one of these shares of its scale, for the weights to be
# rounded.
_MARGIN_ROOM = (1e-6, 1e-4, 1e-2)

# Shares of the largest contradiction that the strongest refutation may keep.
_STRONG_SHARES = (0.9999, 0.99, 0.9)

# Digits of weights in proofs that are not meant to be read.
_MANY_DIGITS = (6, 9, 12, _DIGITS)


def refute(search: Search) -> Refutation | None:
    """Return a refutation that is short, None where none was found.

    Those that need no bound on the masses go first, then those that need no `theta_max`.
    """
    for mass_bound in (False, True):
        support = range(len(search.question.rows))
        found = _contradiction(search, support, mass_bound)
        if found is None:
            continue
        for candidate in (_few(search, found, mass_bound), tuple(support)):
            proof = _exact_proof(search, candidate, mass_bound)
            if proof is not None:
                return proof
    return _with_slack(search)


def strongest(search: Search) -> Refutation | None:
    """Return the refutation that asks for the largest change, in units of the halfwidths.

    It may use any of the bounds.
    """
    face = find_face(search.question, range(len(search.question.rows)), mass_bound=True)
    proofs = [
        _inside(
            WeightProgram(search, face, mass_bound=True, norm=search.give),
            search.question,
            lambda best: [share * best for share in _STRONG_SHARES],
            lambda proof: proof.holds,
        )
        if face.free
        else None
    ]
    whole = WeightProgram(search, _whole(search), mass_bound=True, norm=search.give)
    weights = whole.most_contradicting()
    if weights is not None:
        mended = _mended(search.question, weights)
        proofs.append(mended if mended.holds else None)
    found = [proof for proof in proofs if proof is not None]
    return max(found, key=lambda proof: proof.change_bound or 0, default=None)


def bound_margin(search: Search) -> Refutation | None:
    """Return a valid inequality that bounds the margin, as tight as was found."""

    def bounds(proof: Refutation) -> bool:
        return proof.valid and proof.margin_bound is not None

    face = find_face(search.question, range(len(search.question.rows)), mass_bound=True)
    if face.free:
        proof = _inside(
            WeightProgram(search, face, mass_bound=True),
            search.question,
            lambda best: [best - room * max(1.0, abs(best)) for room in _MARGIN_ROOM],
            bounds,
        )
        if proof is not None:
            return proof
    whole = WeightProgram(search, _whole(search), mass_bound=True).most_contradicting()
    if whole is None:
        return None
    proof = _mended(search.question, whole)
    return proof if bounds(proof) else None


def _inside(
    program: WeightProgram,
    question: Question,
    levels: Callable[[float], list[float]],
    accepted: Callable[[Refutation], bool],
) -> Refutation | None:
    """Return an accepted proof from weights well inside, at levels of the largest contradiction."""
    best = program.most_contradicting()
    if best is None:
        return None
    for least in levels(best.violation):
        inner = program.most_interior(least)
        if inner is None:
            continue
        for digits in _MANY_DIGITS:
            proof = _rounded(question, inner, digits, None)
            if proof is not None and accepted(proof):
                return proof
    return None


def _contradiction(search: Search, support: Iterable[int], mass_bound: bool) -> Weights | None:
    """Return the weights over a support that contradict most, None where none do."""
    face = find_face(search.question, support, mass_bound=mass_bound)
    if not face.free:
        return None
    program = WeightProgram(search, face, mass_bound=mass_bound, norm=_sizes(search, face))
    found = program.most_contradicting()
    return None if found is None or found.violation <= _CONTRADICTS else found


def _sizes(search: Search, face: Face) -> Array:
    """Return the size of each parameter of a face's support, in its unit."""
    return np.asarray(search.scaling.mass * search.unit[list(face.support)])


def _few(search: Search, dense: Weights, mass_bound: bool) -> tuple[int, ...]:
    """Return a small set of parameters that contradict each other."""
    alone = []
    for k in range(len(search.question.rows)):
        found = _contradiction(search, (k,), mass_bound)
        if found is not None:
            alone.append(
                (found.violation * float(_sizes(search, found.face)[0] / search.give[k]), k)
            )
    if alone:
        return (max(alone)[1],)
    # Greedy: the parameters of least weight are left out first.
    kept = _reweighted(search, dense, mass_bound)
    for k in tuple(kept):
        rest = [j for j in kept if j != k]
        if k in kept and rest and _contradiction(search, rest, mass_bound) is not None:
            kept = rest
    return tuple(sorted(kept))


def _reweighted(search: Search, dense: Weights, mass_bound: bool) -> list[int]:
    """Return few parameters that contradict each other, those of least weight first."""
    face, sizes = dense.face, _sizes(search, dense.face)
    program = WeightProgram(search, face, mass_bound=mass_bound, norm=sizes)
    start = search.give[list(face.support)]
    cost = start
    weights = np.abs(dense.support()) * sizes
    for _ in range(_ROUNDS):
        found = program.cheapest(cost, dense.violation)
        if found is None:
            break
        weights = np.abs(found.support()) * sizes
        cost = start / (weights / weights.max() + _SOFT)
    order = np.argsort(weights)
    for share in (_NOTHING, _NOTHING**2):
        kept = [face.support[i] for i in order if weights[i] > share * weights.max()]
        if _contradiction(search, kept, mass_bound) is not None:
            return kept
    return [face.support[i] for i in order]


def _exact_proof(search: Search, support: Iterable[int], mass_bound: bool) -> Refutation | None:
    """Return a proof over a support, its weights of as few digits as there may be."""
    face = find_face(search.question, support, mass_bound=mass_bound)
    if not face.free:
        return None
    program = WeightProgram(search, face, mass_bound=mass_bound, norm=_sizes(search, face))
    best = program.most_contradicting()
    if best is None or best.violation <= 0.0:
        return None
    inner = [program.most_interior(share * best.violation) for share in _SHARES]
    inside = [best, *(weights for weights in inner if weights is not None)]
    few = len(face.free) <= _SMALL_SUPPORT
    for digits in range(1, _DIGITS + 1):
        for weights in inside:
            large = np.flatnonzero(np.abs(weights.free) > _NOTHING**2 * np.abs(weights.free).max())
            for leader in large if few else [int(np.argmax(np.abs(weights.free)))]:
                proof = _rounded(search.question, weights, digits, int(leader))
                if proof is not None and proof.most < proof.least and proof.holds:
                    return proof
    return None


def _rounded(
    question: Question, weights: Weights, digits: int, leader: int | None
) -> Refutation | None:
    """Return weights rounded to `digits`, scaled so that the leader is 1 if there is one."""
    free = weights.free
    unit = float(np.abs(free).max()) if leader is None else abs(float(free[leader]))
    if not unit > 0.0:
        return None
    exact = {
        k: _round(float(x) / unit, digits) for k, x in zip(weights.face.free, free, strict=True)
    }
    full = weights.face.weights(exact)
    named = {question.names[k]: w for k, w in full.items() if w}
    masses = {
        link: _round(float(x) / unit, digits + 1, up=True)
        for link, x in enumerate(weights.masses)
        if x > 0.0
    }
    return _with_masses(Refutation(question=question, weights=named), masses) if named else None


def _with_masses(proof: Refutation, masses: dict[int, Fraction]) -> Refutation:
    """Add the multipliers of masses where the matrix is not positive semidefinite without."""
    needed = {}
    for link, value in masses.items():
        if not _definite(proof, link):
            needed[link] = value
    if not needed:
        return proof
    return Refutation(question=proof.question, weights=proof.weights, masses=needed)


def _definite(proof: Refutation, link: int) -> bool:
    return positive_semidefinite(coefficient_matrices(proof.link(link))[1])


def _round(value: float, digits: int, *, up: bool = False) -> Fraction:
    """Return a value rounded to `digits` significant digits, away from zero if `up`."""
    if value == 0.0:
        return Fraction(0)
    power = digits - 1 - int(np.floor(np.log10(abs(value))))
    scaled = Fraction(value) * Fraction(10) ** power
    whole = (-(-scaled // 1) if scaled > 0 else scaled // 1) if up else Fraction(round(scaled))
    return Fraction(whole) / Fraction(10) ** power


def _with_slack(search: Search) -> Refutation | None:
    """Return a refutation that uses theta_max to make its matrices definite."""
    face = _whole(search)
    program = WeightProgram(search, face, mass_bound=True, norm=_sizes(search, face))
    found = program.most_contradicting()
    if found is None or found.violation <= _CONTRADICTS:
        return None
    proof = _mended(search.question, found)
    return proof if proof.holds else None


def _whole(search: Search) -> Face:
    """Return the face of all weights, without any reduction."""
    question = search.question
    every = tuple(range(len(question.rows)))
    rows_C = [0, 1, 2] if question.consistency == "spatial_inertia" else []
    return Face(every, {}, every, ((rows_C, [0, 1, 2, 3]),) * question.n_links)


def _mended(question: Question, found: Weights) -> Refutation:
    """Return a refutation with slack on the diagonals that makes its matrices definite."""
    unit = float(np.abs(found.free).max())
    named = {
        question.names[k]: _round(float(x) / unit, _DIGITS)
        for k, x in zip(found.face.free, found.free, strict=True)
        if abs(x) > _TINY * unit
    }
    masses = {
        i: _round(float(x) / unit, _DIGITS, up=True) for i, x in enumerate(found.masses) if x > 0.0
    }
    proof = Refutation(question=question, weights=named, masses=masses)
    slack = {}
    for link in range(question.n_links):
        C, Q = (np.array(m, dtype=float) for m in coefficient_matrices(proof.link(link)))
        lowest = float(np.linalg.eigvalsh(Q)[0])
        if question.consistency == "spatial_inertia":
            lowest = min(lowest, float(np.linalg.eigvalsh(C)[0]))
        rounding = _TINY * float(np.abs(Q).max(initial=0.0))
        if lowest < rounding:
            slack[link] = _round(max(-lowest, 0.0) + 2.0 * rounding, 3, up=True)
    return Refutation(question=question, weights=named, masses=masses, slack=slack)
