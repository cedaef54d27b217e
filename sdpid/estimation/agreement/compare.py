"""Test whether two estimates differ by more than their errors.

With ``d`` the difference of the base parameters that both have and ``S`` its covariance, each
``d_i/sqrt(S_ii)`` is Student's t, and ``d^T·S^(-1)·d`` over its rank is F, if both are estimates of
one robot. The errors of the data are independent; those of a prior that both state, or of gains by
which both made efforts of currents, are the same in both and cancel where both move with them
alike: ``S = V_1 + V_2 − C − C^T`` with ``V_i`` the covariance of either (see
`sdpid.estimation.posterior`) and C that of the errors in common. Directions that rest on those
alone cannot differ and are left out. Inequalities are not counted: projections onto one convex set
only bring estimates nearer to each other, all in all, so that the joint test errs on the quiet
side.
"""

from __future__ import annotations

from dataclasses import fields
from itertools import product

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask, require_probability
from sdpid._common.threads import one_thread
from sdpid.errors import DataError
from sdpid.estimation.agreement.agreement import Agreement, Difference, EffortDifference
from sdpid.estimation.posterior import Estimated, Posterior, prior_rows
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.model.base_parameters import BaseParameters

# Variance of a difference below this share of the sum of the variances: both estimates rest on one
# prior there, and what is left is rounding and its curvature.
_ON_PRIOR = 1e-4

# Directions of the summed covariance below this share of the largest, scaled, are rounding.
_ROUNDING = 1e-10

# Samples of a motion on which efforts are compared: a difference's rms is known to a per cent.
_SAMPLES = 20_000

# Regroupings of one robot, read from two files or found beside other friction terms, are equal
# within this share of their largest coefficient.
_SAME = 1e-6

# Rows of two priors are one belief when they are this nearly parallel: the friction's are in units
# of the efforts of each log, the log-determinants' curvature is that at each estimate.
_PARALLEL = 0.99

# Logs that have this share of their samples in common, to the last bit, share data. Below are
# poses at rest, which simulated or coarsely measured logs may repeat.
_SHARED = 0.01

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
_PRIORS = "Their priors differ, and are taken as independent beliefs."
_FRICTION = "Their friction terms differ: a name may stand for another part of friction."
_GIVEN = "Parameters that were given are taken as exact: only the errors of the estimate count."


@one_thread
def compare_estimates(
    first: Estimated, other: Estimated, *, level: float, independent: bool | None
) -> Agreement:
    """Return whether two estimates agree; see `Estimate.compare_to`."""
    require_probability(level, "compare_to: level")
    robot, bases = first.problem.robot, (first.problem.base, other.problem.base)
    for what in ("joint", "link"):
        a, b = (getattr(each.problem.robot, f"{what}_names") for each in (first, other))
        if a != b:
            raise DataError(
                f"compare_to: the {what}s of '{robot.name}' are {', '.join(a)}, those of "
                f"'{other.problem.robot.name}' {', '.join(b)}; compare estimates of one robot."
            )
    pairs, notes = shared_parameters(*bases)
    if not len(pairs):
        raise DataError(
            f"compare_to: no base parameter of '{robot.name}' is the same function of its links in "
            "both estimates; are their kinematics the same?"
        )
    given = any(each.method == "given" for each in (first, other))
    together = not given and _share_data(first.problem.samples, other.problem.samples)
    apart = not together if independent is None else independent
    errors = _ParameterDifference(first, other, pairs)
    terms = [[str(t) for t in e.problem.friction.described()] for e in (first, other)]
    told = {
        _SHARED_DATA: together and not apart,
        _DEPENDENT: not (together or apart),
        _TREATED: together and apart,
        _GIVEN: given,
        _PRIORS: errors.unlike_beliefs,
        _FRICTION: terms[0] != terms[1],
    }
    statistic, rank, freedom, p = errors.distance() if apart else (None, 0, None, None)
    alone = [np.delete(base.names, own) for base, own in zip(bases, pairs.T, strict=True)]
    return Agreement(
        differences=errors.differences(bases[0], pairs[:, 0], level, tested=apart),
        only_first=tuple(alone[0].tolist()),
        only_other=tuple(alone[1].tolist()),
        independent=apart,
        level=level,
        statistic=statistic,
        rank=rank,
        freedom=freedom,
        p=p,
        efforts=tuple(_efforts(first, other)),
        joint_names=robot.joint_names,
        notes=(*notes, *(words for words, holds in told.items() if holds)),
    )


def shared_parameters(first: BaseParameters, other: BaseParameters) -> tuple[Indices, list[str]]:
    """Return which parameters (k, 2) are the same functions of standard ones, and notes.

    Notes name those of the same name that are different ones, or hold more in one.
    """
    common = [name for name in first.theta_names if name in other.theta_names]
    places = [[base.theta_names.index(name) for name in common] for base in (first, other)]
    # By the standard parameter that leads each: a name gets another suffix where more folds in.
    leads = [[base.theta_names[j] for j in base.kept] for base in (first, other)]
    pairs, regrouped, notes = [], [], []
    for i, lead in enumerate(leads[0]):
        if lead not in leads[1]:
            continue
        k, name = leads[1].index(lead), first.names[i]
        rows = first.matrix[i], other.matrix[k]
        gap = np.abs(rows[0][places[0]] - rows[1][places[1]]).max(initial=0.0)
        if gap > _SAME * max(np.abs(rows[0]).max(), np.abs(rows[1]).max()):
            regrouped.append(name)
            continue
        pairs.append((i, k))
        for base, row, which in ((first, rows[0], "first"), (other, rows[1], "other")):
            more = [base.theta_names[j] for j in np.flatnonzero(row)]
            if more := [each for each in more if each not in common]:
                notes.append(f"{name} holds {' and '.join(more)} too in the {which} alone.")
    if regrouped:
        notes.append(f"Regrouped differently, and not compared: {', '.join(regrouped)}.")
    return np.array(pairs, dtype=np.intp).reshape(-1, 2), notes


def _share_data(first: Samples, other: Samples) -> bool:
    """Return whether two estimates used samples of one recording, processed alike."""
    if first is other:
        return True
    if first.effort.shape[1] != other.effort.shape[1]:
        return False
    seen = [{row.tobytes() for row in np.hstack([s.position, s.effort])} for s in (first, other)]
    return len(seen[0] & seen[1]) > _SHARED * min(map(len, seen))


def beliefs_in_common(first: Estimated, other: Estimated) -> tuple[Indices, Indices]:
    """Return the numbers (k,) and (k,) of prior rows of two estimates that state the same belief.

    Priors speak of standard parameters, which are matched by name.
    """
    names = (first.problem.base.theta_names, other.problem.base.theta_names)
    union = list(dict.fromkeys([*names[0], *names[1]]))
    placed = []
    for own, rows in zip(names, (prior_rows(first), prior_rows(other)), strict=True):
        wide = np.zeros((len(rows), len(union)))
        wide[:, [union.index(name) for name in own]] = rows
        size = np.linalg.norm(wide, axis=1, keepdims=True)
        placed.append(wide / np.where(size > 0.0, size, 1.0))
    cosine = placed[0] @ placed[1].T
    if not cosine.size:
        return np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp)
    best, back, i = cosine.argmax(axis=1), cosine.argmax(axis=0), np.arange(len(cosine))
    kept = (cosine[i, best] > _PARALLEL) & (back[best] == i)
    return i[kept], best[kept]


class _ParameterDifference:
    """The difference (k,) of two estimates, its covariance, and which parameters are tested."""

    def __init__(self, first: Estimated, other: Estimated, pairs: Indices) -> None:
        k, both = len(pairs), (first, other)
        self.values = np.array([each.base[own] for each, own in zip(both, pairs.T, strict=True)])
        self.singles, self.summed, common = np.zeros((2, k)), np.zeros((k, k)), np.zeros((k, k))
        # Of each estimate that was not given, its parameters as functions of theta, and its errors.
        self.known: list[tuple[Array, Posterior]] = []
        for estimate, own, single in zip(both, pairs.T, self.singles, strict=True):
            if estimate.method != "given":
                functions, posterior = estimate.problem.base.matrix[own], Posterior.of(estimate)
                self.known.append((functions, posterior))
                self.summed += posterior.covariance(functions)
                single[:] = np.sqrt(posterior.spread(functions)[0])
        self.unlike_beliefs = False
        if len(self.known) == len(both):
            (f, p), (g, q) = self.known
            a, b = f @ p.from_prior, g @ q.from_prior
            i, j = beliefs_in_common(first, other)
            common += a[:, i] @ b[:, j].T
            for one, two in product(p.sources, q.sources):
                if one.same(two):
                    common += p.slopes(one, f) @ one.covariance @ q.slopes(two, g).T
            alone = np.delete(a, i, axis=1).any() or np.delete(b, j, axis=1).any()
            self.unlike_beliefs = bool(a.size and b.size and alone)
        self.common = common + common.T
        self.covariance = self.summed - self.common
        # What can differ at all, and is known in both.
        able = np.diag(self.covariance) > _ON_PRIOR * np.diag(self.summed)
        self.tested: Mask = able & np.isfinite(self.singles).all(axis=0)

    def freedom(self, directions: Array) -> Array:
        """Return the degrees of freedom of the variance along directions (m, k): Satterthwaite's.

        What a prior states of its errors is known.
        """
        total = np.einsum("mi,ij,mj->m", directions, self.covariance, directions)
        spread = np.full(len(directions), np.finfo(float).tiny)
        for functions, posterior in self.known:
            errors, data = posterior.errors, directions @ functions @ posterior.from_errors
            variance = np.einsum("mi,ij,mj->m", data, errors.scores, data)
            spread += variance**2 / errors.freedom(data)
        return np.asarray(np.maximum(total**2 / spread, 1.0))

    def differences(
        self, base: BaseParameters, chosen: Indices, level: float, *, tested: bool
    ) -> tuple[Difference, ...]:
        """Return the parameters one by one, as they are called in a base."""
        from scipy.special import stdtr

        difference = np.diff(self.values, axis=0)[0]
        sizes = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        freedom = self.freedom(np.eye(len(sizes)))
        t = difference / np.where(self.tested, sizes, 1.0)
        p = 2.0 * stdtr(freedom, -np.abs(t))
        tests = np.where(self.tested & tested, [sizes, freedom, t, p], np.nan)
        errors = np.where(np.isfinite(self.singles), self.singles, np.nan)
        out = []
        for i, row in zip(
            chosen, np.vstack([self.values, difference, errors, tests]).T, strict=True
        ):
            numbers = [None if np.isnan(number) else float(number) for number in row]
            agree = None if numbers[-1] is None else numbers[-1] >= 1.0 - level
            values = base.names[i], base.units[i], *numbers, agree
            names = [each.name for each in fields(Difference)]
            out.append(Difference(**dict(zip(names, values, strict=True))))
        return tuple(out)

    def distance(self) -> tuple[float | None, int, float | None, float | None]:
        """Return the squared Mahalanobis distance, its rank, its degrees of freedom, and p."""
        from scipy.special import fdtrc

        kept = np.flatnonzero(self.tested)
        if not len(kept):
            return None, 0, None, None
        place = np.ix_(kept, kept)
        scale = np.sqrt(np.diag(self.summed)[kept])
        values, vectors = np.linalg.eigh(self.summed[place] / np.outer(scale, scale))
        sound = values > _ROUNDING * values[-1]
        white = vectors[:, sound] / np.sqrt(values[sound]) / scale[:, None]
        # Of what is in common, so that rounding chooses no axes where nothing is.
        lost, axes = np.linalg.eigh(white.T @ self.common[place] @ white)
        shares = 1.0 - lost
        free = shares > _ON_PRIOR
        rank = int(free.sum())
        directions = np.zeros((rank, len(self.tested)))
        directions[:, kept] = (white @ axes[:, free]).T
        moved = directions @ np.diff(self.values, axis=0)[0]
        distance = float(np.sum(moved**2 / shares[free]))
        # Of directions with few degrees of freedom the most is left to chance.
        freedom = float(rank / np.sum(1.0 / self.freedom(directions)))
        return distance, rank, freedom, float(fdtrc(rank, freedom, distance / rank))


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
