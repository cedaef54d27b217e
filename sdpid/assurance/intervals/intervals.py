"""Confidence intervals of base and standard parameters.

Three kinds, each with its own question (see docs/guides/intervals.md):

* ``profile``: what feasible parameters have a cost that the data do not rule out? Extremes over
  all of them, proven from multipliers (see `sdpid.assurance.intervals.profile_likelihood`). It is
  the only one that says something of parameters that the data leave open and physics bounds.
* ``gauss_markov``: how far is the estimate from the truth? Standard errors from the spectrum of the
  residuals and from the prior, about the estimate (see `sdpid.estimation.posterior`).
* ``bootstrap``: how would the constrained estimate scatter? Blocks of samples are drawn again,
  and the constrained problem is solved every time (see `sdpid.assurance.intervals.bootstrap`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import compress
from typing import Any, Literal

import numpy as np

from sdpid._common.arrays import Array, Mask, frozen, require_probability
from sdpid._common.tables import Shown, Table, plain_dict
from sdpid._common.threads import one_thread
from sdpid.assurance.intervals.bootstrap import Kind, resample
from sdpid.assurance.intervals.delta_method import half_widths
from sdpid.assurance.intervals.parameters import ParameterFunctions
from sdpid.assurance.intervals.profile_likelihood import End, ProfileLikelihood
from sdpid.errors import DataError
from sdpid.estimation.cluster_robust import Groups as DrawnGroups
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.gain_errors import error_sources
from sdpid.estimation.information import require_excitation
from sdpid.estimation.posterior import Groups, Posterior, fit_errors

Method = Literal["profile", "gauss_markov", "bootstrap"]

FROM_DATA = "from data"
FROM_PHYSICS = "from physics"
FROM_PRIOR = "from the prior"

# Sources of errors that residuals do not show: their name, what biases do, and what makes intervals
# shorter.
_SOURCES = {
    "gains": ("gains", "", ""),
    "motion": (
        "noise in motion",
        "noise in the measured motion moves",
        "a lower cutoff_hz, or less noise in joint positions, makes them shorter",
    ),
    "landing": (
        "landings",
        "landings, where joint speeds jump, move",
        "a motion with fewer of them beside this one, or impact_s = 0, leaves them out",
    ),
    "filter": (
        "the filter",
        "what the filter takes away moves",
        "a higher cut-off (cutoff_hz), or efforts with less noise, makes them shorter",
    ),
    "friction": (
        "friction's law",
        "a law of friction that is not the model's moves",
        "friction terms that bend as the robot's do make them shorter",
    ),
}

# Above this share of the variance a bias is larger than all other errors together.
_MOST = 0.5


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Intervals(Shown):
    """Confidence intervals of parameters.

    Attributes
    ----------
    names : tuple of str
        The parameters.
    kind : tuple of str
        ``"base"`` or ``"standard"``, one each.
    units : tuple of str
        Their units.
    lower, upper : ndarray, shape (k,)
        The ends.
    estimate : ndarray, shape (k,)
        What they are about. No interval excludes it.
    label : tuple of str
        What bounds each: ``"from data"``, bounded by the data with the physics switched off;
        ``"from physics"``, bounded only with consistency, signs and masses; ``"from the prior"``,
        bounded only by theta_max, or mostly by a prior.
    by_mass : ndarray of bool, shape (k, 2)
        Ends that rest on the largest mass allowed (Constraints.mass_max).
    level : float
        Stated probability.
    method : str
        How they were made.
    groups : str
        What was taken as independent: ``"frequencies"``, ``"blocks"`` or ``"periods"``.
    slack : ndarray, shape (k, 2), or None
        Of profile intervals: how far each end, which is proven, is outside of what is attained.
    shares : dict of ndarray, shape (k,)
        Shares of errors that residuals do not show in the variance of each parameter, all
        inequalities aside: of drive gains (``"gains"``), noise in the measured motion
        (``"motion"``), landings (``"landing"``) or else the filter (``"filter"``), and a law of
        friction that is not the robot's (``"friction"``). Those that were looked for and found.
    seconds : float
        In the solver.
    solves : int
        Programs solved.

    Examples
    --------
    >>> intervals = sdpid.confidence_intervals(estimate, method="gauss_markov", parameters=["Fv1"])
    >>> intervals.names, intervals.units, intervals.label
    (('Fv1',), ('N.m.s/rad',), ('from data',))
    >>> bool(intervals.lower[0] < intervals.estimate[0] < intervals.upper[0])
    True
    >>> intervals.contains([0.0])
    array([False])
    """

    names: tuple[str, ...]
    kind: tuple[str, ...]
    units: tuple[str, ...]
    lower: Array
    upper: Array
    estimate: Array
    label: tuple[str, ...]
    by_mass: Mask
    level: float
    method: str
    groups: str
    slack: Array | None = None
    shares: Mapping[str, Array] = field(default_factory=dict)
    seconds: float = 0.0
    solves: int = field(default=0)

    _facts = ("names", "method", "level", "groups")

    def __len__(self) -> int:
        return len(self.names)

    @property
    def width(self) -> Array:
        """Upper less lower, shape (k,)."""
        return np.asarray(self.upper - self.lower)

    def contains(self, values: Any) -> Mask:
        """Return which intervals hold the given values (k,)."""
        values = np.asarray(values, dtype=np.float64)
        return np.asarray((self.lower <= values) & (values <= self.upper))

    def _tables(self) -> Iterator[Table]:
        yield self._table()

    def _table(self) -> Table:
        """Return one row a parameter; the last column is left out where no end rests on a mass."""
        columns: dict[str, Sequence[object]] = {
            "parameter": self.names,
            "unit": self.units,
            "lower": self.lower.tolist(),
            "estimate": self.estimate.tolist(),
            "upper": self.upper.tolist(),
            "label": self.label,
        }
        for source, share in self.shares.items():
            shown = [round(100.0 * each) for each in share.tolist()]
            columns[f"from {_SOURCES[source][0]}, %"] = shown
        if self.by_mass.any():
            columns["at mass_max"] = [
                " and ".join(compress(("lower", "upper"), pair)) for pair in self.by_mass.tolist()
            ]
        return Table.of_columns(columns)

    def table(self) -> str:
        """Return aligned text, one line a parameter."""
        return self._table().text(5)

    def noise_in_words(self) -> str | None:
        """Return which base parameters biases move most; None where they move little."""
        base = np.array([kind == "base" for kind in self.kind])
        found = []
        for name, share in self.shares.items():
            _, what, remedy = _SOURCES[name]
            much = np.flatnonzero(base & (share > _MOST))
            if not (what and len(much)):
                continue
            most = int(much[np.argmax(share[much])])
            found.append(
                f"{what} {len(much)} of {np.count_nonzero(base)} base "
                f"parameters by more than all other errors (limit {100.0 * _MOST:.0f} % of the "
                f"variance), {self.names[most]} by {100.0 * share[most]:.0f} %: their intervals "
                f"are wider by that; {remedy}"
            )
        return "; ".join(found) or None

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        columns: dict[str, Sequence[object]] = {
            "name": self.names,
            "kind": self.kind,
            "unit": self.units,
            "lower": self.lower.tolist(),
            "estimate": self.estimate.tolist(),
            "upper": self.upper.tolist(),
            "label": self.label,
            "ends_at_largest_mass": self.by_mass.tolist(),
        }
        columns |= {f"{name}_share": share.tolist() for name, share in self.shares.items()}
        rows = zip(*columns.values(), strict=True)
        content = {
            "method": self.method,
            "level": self.level,
            "groups": self.groups,
            "seconds": self.seconds,
            "solves": self.solves,
            "parameters": [dict(zip(columns, row, strict=True)) for row in rows],
        }
        return plain_dict(content)


@one_thread
def confidence_intervals(
    estimate: Estimate,
    *,
    level: float = 0.95,
    parameters: Iterable[str] | None = None,
    method: Method = "profile",
    groups: Groups | None = None,
    resamples: int = 400,
    kind: Kind = "percentile",
    seed: int | np.random.Generator = 0,
    n_jobs: int | None = None,
) -> Intervals:
    """Return confidence intervals of base and standard parameters.

    Which method to take: docs/guides/intervals.md.

    Parameters
    ----------
    estimate : Estimate
        The estimate, from any solver. Profile intervals need standard parameters.
    level : float, optional
        Probability with which each should hold the truth.
    parameters : iterable of str, optional
        Names of base or standard parameters; by default all. Only profile intervals can say
        something of standard parameters that the data leave open: the others leave them out, or
        raise where they are asked for by name. Of base parameters that the data leave open
        Gauss-Markov intervals say what a prior does.
    method : {"profile", "gauss_markov", "bootstrap"}, optional
        ``profile``: all values that feasible parameters take at a cost which the data do not rule
        out; it takes some seconds. ``gauss_markov``: standard errors about the estimate, in a
        moment. ``bootstrap``: the scatter of the constrained estimate over samples drawn again.
    groups : {"frequencies", "blocks", "periods"}, optional
        What is independent: the Fourier coefficients of the residuals, which need no long record;
        blocks of `samples.block` samples; or whole periods, where the samples keep them, which
        only vary by what does not repeat. By default frequencies, with the bootstrap blocks.
    resamples : int, optional
        Number of resamples of the bootstrap.
    kind : {"percentile", "basic"}, optional
        Kind of bootstrap interval: quantiles of the resampled estimates, or mirrored about the
        estimate.
    seed : int or numpy.random.Generator, optional
        Seed of the bootstrap.
    n_jobs : int, optional
        Programs solved at a time (joblib), by default one a core: in threads, or wherever the
        backend of a surrounding ``joblib.parallel_config`` is. The result does not depend on it.

    Returns
    -------
    Intervals
        One interval a parameter, with what bounds it.

    Raises
    ------
    DataError
        When a name or number makes no sense, or the record is too short.
    IdentifiabilityError
        When data without a prior leave base parameters undetermined and Gauss-Markov intervals are
        asked for, or with any prior bootstrap intervals.
    SolverError
        When a program cannot be solved.

    Examples
    --------
    >>> intervals = sdpid.confidence_intervals(estimate, parameters=["Fv1", "m_6"], n_jobs=1)
    >>> intervals.units, intervals.label
    (('N.m.s/rad', 'kg'), ('from data', 'from physics'))
    >>> bool(intervals.lower[0] < estimate.named()["Fv1"] < intervals.upper[0])
    True
    """
    require_probability(level, "intervals: level")
    if method not in ("profile", "gauss_markov", "bootstrap"):
        raise DataError(
            f"intervals: method is {method!r}; use 'profile', 'gauss_markov' or 'bootstrap'."
        )
    problem = estimate.problem
    requested = (
        None
        if parameters is None
        else tuple([parameters] if isinstance(parameters, str) else parameters)
    )
    if method == "gauss_markov":
        return _gauss_markov(estimate, requested, level, groups or "frequencies")
    wanted = ParameterFunctions.of(problem, requested)
    if method == "profile":
        return _profile(estimate, wanted, level, groups or "frequencies", n_jobs)
    if groups == "frequencies":
        raise DataError("intervals: the bootstrap draws groups='blocks' or 'periods'.")
    require_excitation(problem.excitation)
    wanted = _answered(wanted, wanted.determined, requested)
    return _bootstrap(estimate, wanted, level, groups or "blocks", resamples, kind, seed, n_jobs)


def _gauss_markov(
    estimate: Estimate, names: tuple[str, ...] | None, level: float, groups: Groups
) -> Intervals:
    """Return the estimate and quantiles of its errors either way, cut off at declared limits."""
    problem = estimate.problem
    with_prior = estimate.theta is not None and problem.prior is not None
    if not with_prior:
        require_excitation(problem.excitation)
    wanted = ParameterFunctions.of(problem, names)
    base = np.array([kind == "base" for kind in wanted.kind])
    wanted = _answered(wanted, wanted.determined | (base & with_prior), names)
    value = (
        wanted.functionals @ estimate.base
        if estimate.theta is None
        else wanted.functions @ estimate.theta
    )
    posterior = Posterior.of(estimate, groups)
    half, prior_share = half_widths(posterior, wanted.functions, level)
    lower, upper = value - half, value + half
    if estimate.method != "wls":
        least, most = problem.feasible.limits_of(wanted.functions)
        # The estimate itself may be outside of a limit, by rounding.
        lower = np.minimum(np.maximum(lower, least), value)
        upper = np.maximum(np.minimum(upper, most), value)
    labels = tuple(FROM_PRIOR if share > 0.5 else FROM_DATA for share in prior_share)
    return _made(
        wanted,
        lower,
        upper,
        estimate=frozen(value),
        label=labels,
        level=level,
        method="gauss_markov",
        groups=groups,
        shares=_shares(estimate, wanted, posterior),
    )


def _answered(
    wanted: ParameterFunctions, chosen: Mask, requested: tuple[str, ...] | None
) -> ParameterFunctions:
    """Return the chosen parameters; raise where others were asked for by name."""
    others = tuple(compress(wanted.names, ~chosen))
    if requested is not None and others:
        raise DataError(
            f"intervals: the data alone do not determine {', '.join(others)}; use "
            "method='profile', which says what physics leaves of them."
        )
    return wanted.only(chosen)


def _bootstrap(
    estimate: Estimate,
    wanted: ParameterFunctions,
    level: float,
    groups: DrawnGroups,
    resamples: int,
    kind: Kind,
    seed: int | np.random.Generator,
    n_jobs: int | None,
) -> Intervals:
    drawn = resample(estimate, resamples=resamples, groups=groups, seed=seed, n_jobs=n_jobs)
    value = wanted.functionals @ estimate.base
    lower, upper = drawn.quantiles(wanted.functionals, level, kind, estimate.base)
    return _made(
        wanted,
        lower,
        upper,
        estimate=frozen(value),
        level=level,
        method="bootstrap",
        groups=groups,
        shares=_shares(estimate, wanted),
        seconds=drawn.seconds,
        solves=len(drawn.base),
    )


def _profile(
    estimate: Estimate,
    wanted: ParameterFunctions,
    level: float,
    groups: Groups,
    n_jobs: int | None,
) -> Intervals:
    """Return the extremes over all feasible parameters within the level."""
    if estimate.theta is None:
        raise DataError(
            f"intervals: method '{estimate.method}' gives no standard parameters; use "
            "method='gauss_markov', or an estimate of a constrained solver."
        )
    problem, theta = estimate.problem, np.array(estimate.theta)
    bounds = ProfileLikelihood(problem, theta, fit_errors(estimate, groups), level)
    functions: list[tuple[Array, Array | None]] = []
    for function, functional, determined in zip(
        wanted.functions, wanted.functionals, wanted.determined, strict=True
    ):
        moved = bounds.expected(functional) if determined else None
        functions += [(function, moved), (-function, moved)]
    found = bounds.minima(functions, n_jobs)
    ends: list[tuple[End, End]] = list(zip(found[::2], found[1::2], strict=True))
    box = _box(bounds, wanted, ends)
    proven = np.array(
        [
            (bounds.proven(c, low, box), -bounds.proven(-c, high, box))
            for c, (low, high) in zip(wanted.functions, ends, strict=True)
        ]
    ).reshape(-1, 2)
    slack = np.array(
        [
            [
                end.found - bounds.proven(sign * c, end, box, end.solved)
                for sign, end in zip((1.0, -1.0), pair, strict=True)
            ]
            for c, pair in zip(wanted.functions, ends, strict=True)
        ]
    ).reshape(-1, 2)
    labels = tuple(
        FROM_DATA if seen else _label(pair)
        for seen, pair in zip(wanted.determined.tolist(), ends, strict=True)
    )
    return _made(
        wanted,
        proven[:, 0],
        proven[:, 1],
        estimate=frozen(wanted.functions @ theta),
        level=level,
        method="profile",
        groups=groups,
        shares=_shares(estimate, wanted),
        label=labels,
        by_mass=np.array([(low.rests[1], high.rests[1]) for low, high in ends]).reshape(-1, 2),
        slack=frozen(slack),
        seconds=sum(end.seconds for end in found),
        solves=sum(end.solves for end in found),
    )


def _label(ends: tuple[End, End]) -> str:
    """Return what bounds a parameter that the data leave open."""
    if any(end.rests[0] or end.prior_share > 0.5 for end in ends):
        return FROM_PRIOR
    return FROM_PHYSICS


def _box(
    bounds: ProfileLikelihood, wanted: ParameterFunctions, ends: list[tuple[End, End]]
) -> tuple[Array, Array]:
    """Return bounds of theta that hold at every level used, from the multipliers found."""
    feasible = bounds.problem.feasible
    lower, upper = feasible.lower.copy(), feasible.upper.copy()
    declared = feasible.lower, feasible.upper
    highest = max((max(end.rise, end.solved) for pair in ends for end in pair), default=0.0)
    for c, (low, high) in zip(wanted.functions, ends, strict=True):
        index = np.flatnonzero(c)
        if len(index) != 1 or c[index[0]] != 1.0:
            continue
        k = int(index[0])
        lower[k] = max(lower[k], bounds.proven(c, low, declared, highest))
        upper[k] = min(upper[k], -bounds.proven(-c, high, declared, highest))
    return lower, upper


def _made(wanted: ParameterFunctions, lower: Array, upper: Array, **facts: Any) -> Intervals:
    """Return the intervals of some parameters; all are from data unless that is said."""
    count = len(wanted.names)
    facts.setdefault("label", (FROM_DATA,) * count)
    marks = facts.setdefault("by_mass", np.zeros((count, 2), dtype=bool))
    marks.setflags(write=False)
    return Intervals(
        names=wanted.names,
        kind=wanted.kind,
        units=wanted.units,
        lower=frozen(lower),
        upper=frozen(upper),
        **facts,
    )


def _shares(
    estimate: Estimate, wanted: ParameterFunctions, posterior: Posterior | None = None
) -> dict[str, Array]:
    """Return shares (k,) of what residuals do not show in the variances."""
    sources = error_sources(estimate.problem)
    if not sources:
        return {}
    found = posterior or Posterior.of(estimate)
    return {each.name: frozen(found.share(each, wanted.functions)) for each in sources}
