"""Refutations found by cone programs, made exact, and made short.

A proof with few numbers can be checked by hand. Weights are pushed towards few by a reweighted
sum of their sizes, then left out one at a time as long as the rest still contradict the table.
Then they are rounded to as few digits as still prove it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from fractions import Fraction

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.certificate.verify import positive_semidefinite
from sdpid.assurance.tables.facial_reduction import Face, find_face
from sdpid.assurance.tables.refutation import Refutation
from sdpid.assurance.tables.weight_program import Weights, weigh
from sdpid.assurance.tables.witness import Question, coefficient_matrices
from sdpid.assurance.tables.witness_search import Search

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

# Random orders in which to leave parameters out, for supports up to this size.
_ORDERS = 12
_SMALL_SUPPORT = 14
_SEED = 20210621

# Rounding of weights that are written with all digits, and of the matrices that follow.
_TINY = 1e-14

# A bound on the margin gives way by one of these shares of its scale, for the weights to be
# rounded.
_MARGIN_ROOM = (1e-6, 1e-4, 1e-2)

# Digits of weights that nobody is to read.
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
        for candidate in sorted(_supports(search, found, mass_bound), key=len):
            proof = _exact_proof(search, candidate, mass_bound)
            if proof is not None:
                return proof
        proof = _exact_proof(search, support, mass_bound)
        if proof is not None:
            return proof
    return _with_slack(search)


def strongest(search: Search) -> Refutation | None:
    """Return the refutation that asks for the largest change, in units of the halfwidths.

    It may use any of the bounds.
    """
    norm = search.give
    face = find_face(search.question, range(len(search.question.rows)), mass_bound=True)
    best = weigh(search, face, mass_bound=True, norm=norm) if face.free else None
    proofs = []
    if best is not None:
        levels = [share * best.violation for share in (0.9999, 0.99, 0.9)]
        proof = _inside(search, face, levels, lambda proof: proof.holds, norm=norm)
        if proof is not None:
            proofs.append(proof)
    whole = weigh(search, _whole(search), mass_bound=True, norm=norm)
    if whole is not None:
        proof = _mended(search.question, whole)
        if proof.holds:
            proofs.append(proof)
    return max(proofs, key=lambda proof: proof.change_bound or 0, default=None)


def bound_margin(search: Search) -> Refutation | None:
    """Return a valid inequality that bounds the margin, as tight as was found."""

    def bounds(proof: Refutation) -> bool:
        return proof.valid and proof.margin_bound is not None

    face = find_face(search.question, range(len(search.question.rows)), mass_bound=True)
    best = weigh(search, face, mass_bound=True, of_margin=True) if face.free else None
    if best is not None:
        size = max(1.0, abs(best.violation))
        levels = [best.violation - room * size for room in _MARGIN_ROOM]
        proof = _inside(search, face, levels, bounds, of_margin=True)
        if proof is not None:
            return proof
    whole = weigh(search, _whole(search), mass_bound=True, of_margin=True)
    if whole is None:
        return None
    proof = _mended(search.question, whole)
    return proof if bounds(proof) else None


def _inside(
    search: Search,
    face: Face,
    levels: Iterable[float],
    accepted: Callable[[Refutation], bool],
    *,
    norm: Array | None = None,
    of_margin: bool = False,
) -> Refutation | None:
    """Return an accepted proof from weights that contradict so much and lie well inside."""
    for least in levels:
        inner = weigh(
            search,
            face,
            mass_bound=True,
            norm=norm,
            of_margin=of_margin,
            least=least,
            interior=True,
        )
        if inner is None:
            continue
        for digits in _MANY_DIGITS:
            proof = _rounded(search.question, inner, digits, None)
            if proof is not None and accepted(proof):
                return proof
    return None


def _contradiction(search: Search, support: Iterable[int], mass_bound: bool) -> Weights | None:
    """Return the weights over a support that contradict most, None where none do."""
    face = find_face(search.question, support, mass_bound=mass_bound)
    if not face.free:
        return None
    found = weigh(search, face, mass_bound=mass_bound, norm=_sizes(search, face))
    return None if found is None or found.violation <= _CONTRADICTS else found


def _size_in_changes(search: Search, k: int) -> float:
    """Return the size of a parameter in units in which its changes count."""
    return float(search.scaling.mass * search.unit[k] / search.give[k])


def _sizes(search: Search, face: Face) -> Array:
    return np.asarray(search.scaling.mass * search.unit[list(face.support)])


def _supports(search: Search, dense: Weights, mass_bound: bool) -> Iterator[tuple[int, ...]]:
    """Yield small sets of parameters that contradict each other."""
    alone = []
    for k in range(len(search.question.rows)):
        found = _contradiction(search, (k,), mass_bound)
        if found is not None:
            alone.append((found.violation * _size_in_changes(search, k), k))
    if alone:
        yield (max(alone)[1],)
        return
    face, sizes = dense.face, _sizes(search, dense.face)
    size_of = dict(zip(face.support, sizes, strict=True))
    rng = np.random.default_rng(_SEED)
    seen: set[tuple[int, ...]] = set()
    give = search.give[list(face.support)]
    for start in (sizes, give * np.median(sizes / give), sizes * give / np.median(give)):
        support = _reweighted(search, dense, start, mass_bound)
        if support is None:
            continue
        orders: list[Sequence[int]] = [support]
        if len(support) <= _SMALL_SUPPORT:
            orders += [tuple(rng.permutation(support).tolist()) for _ in range(_ORDERS)]
        for order in orders:
            small = _pruned(search, order, mass_bound, size_of)
            if small not in seen:
                seen.add(small)
                yield small


def _reweighted(
    search: Search, dense: Weights, start: Array, mass_bound: bool
) -> tuple[int, ...] | None:
    """Return few parameters, those of least weight first."""
    face, sizes = dense.face, _sizes(search, dense.face)
    cost = start
    weights = None
    for _ in range(_ROUNDS):
        found = weigh(search, face, mass_bound=mass_bound, cost=cost, least=dense.violation)
        if found is None:
            break
        weights = np.abs(found.support()) * sizes
        cost = start / (weights + _SOFT * weights.max()) * weights.max()
    if weights is None:
        return None
    order = np.argsort(weights)
    kept = [face.support[i] for i in order if weights[i] > _NOTHING * weights.max()]
    if _contradiction(search, kept, mass_bound) is None:
        kept = [face.support[i] for i in order if weights[i] > _NOTHING**2 * weights.max()]
        if _contradiction(search, kept, mass_bound) is None:
            return None
    return tuple(kept)


def _pruned(
    search: Search, order: Sequence[int], mass_bound: bool, sizes: dict[int, float]
) -> tuple[int, ...]:
    """Leave out one parameter after the other as long as the rest contradict each other."""
    kept = list(order)
    for k in order:
        rest = [j for j in kept if j != k]
        if k not in kept or not rest:
            continue
        found = _contradiction(search, rest, mass_bound)
        if found is not None:
            weights = np.abs(found.support()) * np.array([sizes[j] for j in rest])
            used = [j for j, w in zip(rest, weights, strict=True) if w > _NOTHING * weights.max()]
            fewer = used if len(used) < len(rest) else rest
            if fewer is rest or _contradiction(search, fewer, mass_bound) is not None:
                kept = fewer
            else:
                kept = rest
    return tuple(sorted(kept))


def _exact_proof(search: Search, support: Iterable[int], mass_bound: bool) -> Refutation | None:
    """Return a proof over a support, its weights of as few digits as there may be."""
    face = find_face(search.question, support, mass_bound=mass_bound)
    if not face.free:
        return None
    sizes = _sizes(search, face)
    best = weigh(search, face, mass_bound=mass_bound, norm=sizes)
    if best is None or best.violation <= 0.0:
        return None
    inside = [best]
    for share in _SHARES:
        found = weigh(
            search,
            face,
            mass_bound=mass_bound,
            norm=sizes,
            least=share * best.violation,
            interior=True,
        )
        if found is not None:
            inside.append(found)
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
    """Return weights rounded to so many digits, one of them made 1 if there is a leader."""
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
    """Return a decimal of so many significant digits, rounded away from zero if wanted."""
    if value == 0.0:
        return Fraction(0)
    power = digits - 1 - int(np.floor(np.log10(abs(value))))
    scaled = Fraction(value) * Fraction(10) ** power
    whole = (-(-scaled // 1) if scaled > 0 else scaled // 1) if up else Fraction(round(scaled))
    return Fraction(whole) / Fraction(10) ** power


def _with_slack(search: Search) -> Refutation | None:
    """Return a refutation whose matrices are mended by what theta_max pays for."""
    face = _whole(search)
    found = weigh(search, face, mass_bound=True, norm=_sizes(search, face))
    if found is None or found.violation <= _CONTRADICTS:
        return None
    proof = _mended(search.question, found)
    return proof if proof.holds else None


def _whole(search: Search) -> Face:
    """Return all weights, whatever must vanish: rounding then leaves something of it."""
    question = search.question
    every = tuple(range(len(question.rows)))
    rows_C = [0, 1, 2] if question.consistency == "spatial_inertia" else []
    return Face(every, {}, every, ((rows_C, [0, 1, 2, 3]),) * question.n_links)


def _mended(question: Question, found: Weights) -> Refutation:
    """Return weights with enough added to the diagonals that the matrices are definite."""
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
