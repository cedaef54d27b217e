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
from sdpid.assurance.intervals.bootstrap import Kind, bootstrap_intervals
from sdpid.assurance.intervals.delta_method import half_widths
from sdpid.assurance.intervals.parameters import FROM_DATA, FROM_PRIOR, ParameterFunctions
from sdpid.assurance.intervals.profile_likelihood import profile_intervals
from sdpid.errors import DataError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.information import require_excitation
from sdpid.estimation.posterior import Groups, Posterior, error_sources

Method = Literal["profile", "gauss_markov", "bootstrap"]

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
# Below this share of every variance a source lengthens no interval by more than 0.3 %.
_LEAST = 5e-3


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
        friction that is not the robot's (``"friction"``). Those that were looked for and found,
        but for what is less than half a percent of every variance.
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

    def _columns(self) -> dict[str, Sequence[object]]:
        """Return what both the table and plain values say of each parameter."""
        return {
            "unit": self.units,
            "lower": self.lower.tolist(),
            "estimate": self.estimate.tolist(),
            "upper": self.upper.tolist(),
            "label": self.label,
        }

    def _tables(self) -> Iterator[Table]:
        yield self._table()

    def _table(self) -> Table:
        """Return one row a parameter; the last column is left out where no end rests on a mass."""
        columns = {"parameter": self.names, **self._columns()}
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
        base = np.array([kind == "base" for kind in self.kind], dtype=bool)
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
        columns = {"name": self.names, "kind": self.kind, **self._columns()}
        columns["ends_at_largest_mass"] = self.by_mass.tolist()
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
    if groups not in (None, "frequencies", "blocks", "periods"):
        raise DataError(
            f"intervals: groups is {groups!r}; use 'frequencies', 'blocks' or 'periods'."
        )
    problem, chosen = estimate.problem, groups or "frequencies"
    wanted, named = ParameterFunctions.of(problem, parameters), parameters is not None
    posterior = None
    if method == "profile":
        found = profile_intervals(estimate, wanted, level, chosen, n_jobs)
    elif method == "gauss_markov":
        believed = estimate.theta is not None and problem.prior is not None
        if not believed:
            require_excitation(problem.excitation)
        base = np.array([kind == "base" for kind in wanted.kind], dtype=bool)
        wanted = wanted.answered(wanted.determined | (base & believed), named)
        posterior = Posterior.of(estimate, chosen)
        found = _gauss_markov(estimate, wanted, level, posterior)
    else:
        if groups == "frequencies":
            raise DataError("intervals: the bootstrap draws groups='blocks' or 'periods'.")
        require_excitation(problem.excitation)
        chosen = groups or "blocks"
        wanted = wanted.answered(wanted.determined, named)
        found = bootstrap_intervals(
            estimate,
            wanted.functionals,
            level,
            kind,
            resamples=resamples,
            groups=chosen,
            seed=seed,
            n_jobs=n_jobs,
        )
    facts: dict[str, Any] = {
        "label": (FROM_DATA,) * len(wanted.names),
        "by_mass": np.zeros((len(wanted.names), 2), dtype=bool),
        **found,
    }
    facts["by_mass"].setflags(write=False)
    if error_sources(problem):
        posterior = posterior or Posterior.of(estimate)
        of_all = {each.name: posterior.share(each, wanted.functions) for each in posterior.sources}
        facts["shares"] = {
            name: frozen(share)
            for name, share in of_all.items()
            if share.max(initial=0.0) >= _LEAST
        }
    return Intervals(
        names=wanted.names,
        kind=wanted.kind,
        units=wanted.units,
        estimate=frozen(_values(estimate, wanted)),
        level=level,
        method=method,
        groups=chosen,
        **facts,
    )


def _values(estimate: Estimate, wanted: ParameterFunctions) -> Array:
    """Return the estimates (k,) of parameters."""
    if estimate.theta is None:
        return np.asarray(wanted.functionals @ estimate.base)
    return np.asarray(wanted.functions @ estimate.theta)


def _gauss_markov(
    estimate: Estimate, wanted: ParameterFunctions, level: float, posterior: Posterior
) -> dict[str, Any]:
    """Return the estimate and quantiles of its errors either way, cut off at declared limits."""
    value = _values(estimate, wanted)
    half, prior_share = half_widths(posterior, wanted.functions, level)
    lower, upper = value - half, value + half
    if estimate.method != "wls":
        least, most = estimate.problem.feasible.limits_of(wanted.functions)
        # The estimate itself may be outside of a limit, by rounding.
        lower = np.minimum(np.maximum(lower, least), value)
        upper = np.maximum(np.minimum(upper, most), value)
    labels = tuple(FROM_PRIOR if share > 0.5 else FROM_DATA for share in prior_share)
    return {"lower": frozen(lower), "upper": frozen(upper), "label": labels}
