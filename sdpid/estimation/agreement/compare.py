"""Test whether two estimates differ by more than their errors.

With ``d`` the difference of the base parameters that both have and ``S`` its covariance, each
``d_i/sqrt(S_ii)`` is Student's t, and ``d^T·S^(-1)·d`` over its rank is F, if both are estimates of
one robot. The errors of the data are independent; those of a prior that both state are the same in
both and cancel where both lean on it alike: ``S = V_1 + V_2 + (P_1 − P_2)·(P_1 − P_2)^T`` with
``V_i`` the data's part and ``P_i`` how the estimate moves with the prior's rows (see
`sdpid.estimation.posterior`). The errors of gains that made efforts of currents are treated as a
prior's: those of the same gains cancel. Directions that rest on such a prior alone cannot differ
and are left out. Inequalities are not counted: projections onto one convex set only bring estimates
nearer to each other, all in all, so that the joint test errs on the quiet side.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask, require_probability
from sdpid._common.threads import one_thread
from sdpid.errors import DataError
from sdpid.estimation.agreement.agreement import Agreement, Difference, EffortDifference
from sdpid.estimation.agreement.shared import (
    SharedParameters,
    beliefs_in_common,
    require_one_robot,
    share_data,
)
from sdpid.estimation.error_source import ErrorSource
from sdpid.estimation.posterior import Estimated, Posterior, prior_rows

# Variance of a difference below this share of the sum of the variances: both estimates rest on one
# prior there, and what is left is rounding and its curvature.
_ON_PRIOR = 1e-4

# Directions of the summed covariance below this share of the largest, scaled, are rounding.
_ROUNDING = 1e-10

# Samples of a motion on which efforts are compared: a difference's rms is known to a per cent.
_SAMPLES = 20_000

_SHARED_DATA = (
    "Both were fitted to samples of the same recording, so that their errors are not independent: "
    "differences are shown beside the errors of each, and nothing is tested."
)
_DEPENDENT = (
    "Their errors are not independent, as was said: differences are shown beside the errors of "
    "each, and nothing is tested."
)
_TREATED = (
    "Both were fitted to samples of the same recording, and were taken as independent as asked: "
    "differences are then tested against errors that are too large or too small."
)
_GIVEN = "Parameters that were given are taken as exact: only the errors of the estimate count."


@one_thread
def compare_estimates(
    first: Estimated, other: Estimated, *, level: float, independent: bool | None
) -> Agreement:
    """Return whether two estimates agree; see `Estimate.compare_to`."""
    require_probability(level, "compare_to: level")
    require_one_robot(first.problem.robot, other.problem.robot)
    shared = SharedParameters.of(first.problem.base, other.problem.base)
    if not shared.names:
        raise DataError(
            f"compare_to: no base parameter of '{first.problem.robot.name}' is the same function "
            "of its links in both estimates; are their kinematics the same?"
        )
    given = [each.method == "given" for each in (first, other)]
    together = not any(given) and share_data(first.problem.samples, other.problem.samples)
    apart = not together if independent is None else independent
    errors = _Errors(first, other, shared)
    notes = [*shared.notes]
    if together or not apart:
        notes.append(_TREATED if apart else _SHARED_DATA if together else _DEPENDENT)
    if any(given):
        notes.append(_GIVEN)
    if errors.unlike_beliefs:
        notes.append("Their priors differ, and are taken as independent beliefs.")
    if _terms(first) != _terms(other):
        notes.append("Their friction terms differ: a name may stand for another part of friction.")
    statistic, rank, freedom = errors.distance() if apart else (None, 0, None)
    return Agreement(
        differences=tuple(errors.differences(level, tested=apart)),
        only_first=shared.only_first,
        only_other=shared.only_other,
        independent=apart,
        level=level,
        statistic=statistic,
        rank=rank,
        freedom=freedom,
        p=None if statistic is None or freedom is None else _upper_tail(statistic, rank, freedom),
        efforts=tuple(_efforts(first, other)),
        joint_names=first.problem.robot.joint_names,
        notes=tuple(notes),
    )


def _terms(estimate: Estimated) -> list[str]:
    return [str(term) for term in estimate.problem.friction.described()]


def _upper_tail(statistic: float, rank: int, freedom: float) -> float:
    """Return the probability that F exceeds a squared distance over its rank."""
    from scipy.special import fdtrc

    return float(fdtrc(rank, freedom, statistic / rank))


@dataclass(frozen=True, eq=False)
class _Part:
    """The errors of the shared parameters of one estimate: of its data, and of its prior."""

    data: Array
    covariance: Array
    prior: Array
    sources: tuple[tuple[ErrorSource, Array], ...]
    open: Mask
    posterior: Posterior | None

    @classmethod
    def of(cls, estimate: Estimated, chosen: Indices) -> _Part:
        if estimate.method == "given":
            k = len(chosen)
            nothing = np.zeros((k, 0))
            return cls(nothing, np.zeros((k, k)), nothing, (), np.zeros(k, dtype=bool), None)
        posterior = Posterior.of(estimate)
        functions = estimate.problem.base.matrix[chosen]
        data = functions @ posterior.from_errors
        return cls(
            data,
            data @ posterior.errors.scores @ data.T,
            functions @ posterior.from_prior,
            tuple((s, posterior.slopes(s, functions)) for s in posterior.sources),
            ~np.isfinite(posterior.spread(functions)[0]),
            posterior,
        )

    def freedom(self, directions: Array) -> tuple[Array, Array]:
        """Return the data's variances along directions (m, k), and their degrees of freedom."""
        variance = np.einsum("mi,ij,mj->m", directions, self.covariance, directions)
        if self.posterior is None:
            return variance, np.ones(len(directions))
        return variance, self.posterior.errors.freedom(directions @ self.data)

    @property
    def beside(self) -> Array:
        """Covariance (k, k) that errors make beside noise."""
        parts = (moved @ source.covariance @ moved.T for source, moved in self.sources)
        return np.asarray(sum(parts, np.zeros_like(self.covariance)))

    @property
    def errors(self) -> Array:
        """Standard errors (k,); infinite where nothing is known."""
        own = np.diag(self.covariance) + np.sum(self.prior**2, axis=1)
        own = own + np.diag(self.beside)
        return np.where(self.open, np.inf, np.sqrt(np.maximum(own, 0.0)))


def _beside(first: _Part, other: _Part) -> Array:
    """Return the covariance (k, k) of the difference that errors make beside noise.

    Those of the same gains are the same in both, and cancel where both move with them alike.
    """
    found = first.beside + other.beside
    for own, moved in first.sources:
        for theirs, others in other.sources:
            if own.same(theirs):
                both = moved @ own.covariance @ others.T
                found = found - both - both.T
    return np.asarray(found)


class _Errors:
    """The difference of two estimates, and its covariance."""

    def __init__(self, first: Estimated, other: Estimated, shared: SharedParameters) -> None:
        self.shared = shared
        self.values = first.base[shared.first], other.base[shared.other]
        self.parts = _Part.of(first, shared.first), _Part.of(other, shared.other)
        a, b = (part.prior for part in self.parts)
        rows = tuple(prior_rows(e)[: len(p.T)] for e, p in ((first, a), (other, b)))
        i, j = beliefs_in_common(first, other, (rows[0], rows[1]))
        same = a[:, i] - b[:, j]
        alone = [np.delete(a, i, axis=1), np.delete(b, j, axis=1)]
        self.unlike_beliefs = bool(a.size and b.size and (alone[0].any() or alone[1].any()))
        self.known = sum((x @ x.T for x in (same, *alone)), np.zeros((len(a), len(a))))
        self.known += _beside(*self.parts)
        parts = [p.covariance + p.prior @ p.prior.T + p.beside for p in self.parts]
        self.summed = parts[0] + parts[1]

    @cached_property
    def difference(self) -> Array:
        return np.asarray(self.values[1] - self.values[0])

    @cached_property
    def covariance(self) -> Array:
        return np.asarray(self.parts[0].covariance + self.parts[1].covariance + self.known)

    @cached_property
    def tested(self) -> Mask:
        """Which parameters can differ at all, and are known in both, (k,)."""
        own, most = np.diag(self.covariance), np.diag(self.summed)
        return np.asarray((own > _ON_PRIOR * most) & ~self.parts[0].open & ~self.parts[1].open)

    def freedom(self, directions: Array) -> Array:
        """Return the degrees of freedom of the variance along directions (m, k): Satterthwaite's.

        What a prior states of its errors is known.
        """
        total = np.einsum("mi,ij,mj->m", directions, self.covariance, directions)
        spread = np.full(len(directions), np.finfo(float).tiny)
        for part in self.parts:
            variance, freedom = part.freedom(directions)
            spread += variance**2 / freedom
        return np.asarray(np.maximum(total**2 / spread, 1.0))

    def differences(self, level: float, *, tested: bool) -> list[Difference]:
        """Return the parameters one by one."""
        from scipy.special import stdtr

        sizes = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        freedom = self.freedom(np.eye(len(sizes)))
        singles = [part.errors for part in self.parts]
        out = []
        for k, (name, unit) in enumerate(zip(self.shared.names, self.shared.units, strict=True)):
            found: dict[str, float | bool] = {}
            if tested and self.tested[k]:
                t = float(self.difference[k] / sizes[k])
                p = 2.0 * float(stdtr(freedom[k], -abs(t)))
                found = {
                    "standard_error": float(sizes[k]),
                    "freedom": float(freedom[k]),
                    "t": t,
                    "p": p,
                    "agree": p >= 1.0 - level,
                }
            either = [float(each[k]) if np.isfinite(each[k]) else None for each in singles]
            out.append(
                Difference(
                    name=name,
                    unit=unit,
                    first=float(self.values[0][k]),
                    other=float(self.values[1][k]),
                    difference=float(self.difference[k]),
                    first_error=either[0],
                    other_error=either[1],
                    **found,  # type: ignore[arg-type]
                )
            )
        return out

    def distance(self) -> tuple[float | None, int, float | None]:
        """Return the squared Mahalanobis distance, its rank, and its degrees of freedom."""
        kept = np.flatnonzero(self.tested)
        if not len(kept):
            return None, 0, None
        place = np.ix_(kept, kept)
        scale = np.sqrt(np.diag(self.summed)[kept])
        values, vectors = np.linalg.eigh(self.summed[place] / np.outer(scale, scale))
        sound = values > _ROUNDING * values[-1]
        white = vectors[:, sound] / np.sqrt(values[sound]) / scale[:, None]
        shares, axes = np.linalg.eigh(white.T @ self.covariance[place] @ white)
        free = shares > _ON_PRIOR
        directions = np.zeros((int(free.sum()), len(self.difference)))
        directions[:, kept] = (white @ axes[:, free]).T
        distance = float(np.sum((directions @ self.difference) ** 2 / shares[free]))
        # Of directions with few degrees of freedom the most is left to chance.
        freedom = float(len(directions) / np.sum(1.0 / self.freedom(directions)))
        return distance, len(directions), freedom


def _efforts(first: Estimated, other: Estimated) -> list[EffortDifference]:
    """Return what the estimates predict differently on the motion of each."""
    motions = [("first", first), ("other", other)]
    if first.problem.samples is other.problem.samples:
        motions = motions[:1]
    out = []
    for motion, owner in motions:
        samples = owner.problem.samples
        samples = samples.every(-(-samples.n_samples // _SAMPLES))
        a, b = (each.problem.predict(each.base, samples) for each in (first, other))
        used = samples.used
        square = np.where(used, (a - b) ** 2, 0.0).sum(axis=0)
        power = float(np.where(used, samples.effort**2, 0.0).sum())
        rms = np.sqrt(square / np.maximum(used.sum(axis=0), 1))
        relative = float(np.sqrt(square.sum() / max(power, np.finfo(float).tiny)))
        out.append(EffortDifference(motion=motion, relative=relative, rms=tuple(rms.tolist())))
    return out
