"""Estimators side by side on one problem, measured against the proven bound."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, overload

import numpy as np

from sdpid._common.arrays import generator
from sdpid._common.progress import progress
from sdpid._common.tables import Shown, Table
from sdpid._common.threads import parallel
from sdpid.assurance.certificate.certificate import Certificate, certify
from sdpid.errors import DataError, SdpidError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.local.log_cholesky import solve_log_cholesky, unsupported
from sdpid.estimation.local.run import FEASIBLE_LOCAL, random_start
from sdpid.estimation.local.slsqp import solve_slsqp
from sdpid.estimation.problem import Problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.estimation.wls import solve_wls
from sdpid.workflow.runs import RunComparison, Saved, compare_runs


@dataclass(frozen=True, kw_only=True)
class SolverRun:
    """One solver run.

    Attributes
    ----------
    solver, start : str
        Name of the solver, and of the starting point.
    status, message : str
        How the run ended.
    cost : float or None
        Cost that was reached; None when the run failed.
    gap : float or None
        (cost − proven lower bound) over the cost; negative below the bound, which only an
        infeasible point can be.
    worst_margin : float or None
        Smallest margin of a link, kg·m².
    violation : float or None
        Largest violation of a constraint.
    iterations : int or None
        Iterations.
    seconds : float or None
        Time in the solver.
    """

    solver: str
    start: str
    status: str
    cost: float | None = None
    gap: float | None = None
    worst_margin: float | None = None
    violation: float | None = None
    iterations: int | None = None
    seconds: float | None = None
    message: str = ""


# Local solvers by name.
_LOCAL = {"slsqp": solve_slsqp, "log_cholesky": solve_log_cholesky}

_LABELS = {"slsqp": "SLSQP", "log_cholesky": "log-Cholesky"}

_COLUMNS = tuple(SolverRun.__dataclass_fields__)

# Columns that are an estimate's own.
_OF_ESTIMATE = ("status", "cost", "worst_margin", "violation", "iterations", "message")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Comparison(Shown):
    """Solver runs on one problem.

    Attributes
    ----------
    rows : tuple of SolverRun
        One for each solver and start.
    estimates : tuple of Estimate or None
        Result of each run; None where it failed.
    certificate : Certificate
        Certificate of the global optimum; its lower bound is the reference of the gaps.

    Examples
    --------
    >>> comparison = sdpid.compare(problem, starts=1, local=(), n_jobs=1)
    >>> [(row.solver, row.status) for row in comparison.rows]
    [('wls', 'optimal'), ('sdp', 'optimal')]
    >>> comparison.certificate.passed
    True
    """

    rows: tuple[SolverRun, ...]
    estimates: tuple[Estimate | None, ...]
    certificate: Certificate

    _facts = ("rows", "certificate.lower_bound")

    def _tables(self) -> Iterator[Table]:
        yield self._table()

    def table(self) -> str:
        """Return the rows as aligned text."""
        return self._table().text()

    def _table(self) -> Table:
        """Return the rows without messages, under short names."""
        names = [name for name in _COLUMNS if name not in ("violation", "message")]
        rows = tuple(tuple(getattr(row, name) for name in names) for row in self.rows)
        formats = {"cost": ".8g", "gap": ".1e", "margin": ".2e", "seconds": ".3g"}
        return Table(tuple(name.removeprefix("worst_") for name in names), rows, formats)

    def to_frame(self) -> Any:
        """Return the rows as a pandas DataFrame."""
        import pandas

        return pandas.DataFrame([vars(row) for row in self.rows], columns=list(_COLUMNS))

    def plot(
        self,
        solver: str = "slsqp",
        *,
        against: Literal["seconds", "iterations"] = "iterations",
        axes: Any = None,
    ) -> Any:
        """Draw the costs of a local solver's starts above the proven bound (extra ``plot``).

        Parameters
        ----------
        solver : str, optional
            Which local solver.
        against : {"iterations", "seconds"}, optional
            Quantity on the horizontal axis.
        axes : matplotlib.axes.Axes, optional
            Where to draw; by default in a figure of its own.

        Returns
        -------
        matplotlib.axes.Axes

        Raises
        ------
        DataError
            When no start of the solver has a history.
        """
        from sdpid.plots.estimates import plot_convergence

        runs = [e for r, e in zip(self.rows, self.estimates, strict=True) if r.solver == solver]
        histories = [e.history for e in runs if e is not None and e.history]
        if not histories:
            raise DataError(f"plot: no start of {solver!r} has a history; compare it first.")
        best = self.certificate.estimate
        return plot_convergence(
            histories,
            self.certificate.lower_bound,
            {"SDP": (best.solve_time, best.cost)},
            against=against,
            failed=len(runs) - len(histories),
            label=_LABELS.get(solver, solver),
            feasible=FEASIBLE_LOCAL,
            title=f"{_LABELS.get(solver, solver)}: cost above the proven bound",
            axes=axes,
        )

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the rows, a missing value being an empty field."""
        Table(_COLUMNS, tuple(tuple(vars(row).values()) for row in self.rows)).write(path)


@overload
def compare(problem: Saved, other: Saved) -> RunComparison: ...


@overload
def compare(
    problem: Problem,
    other: None = None,
    *,
    starts: int = 20,
    seed: int = 0,
    extra_starts: Sequence[tuple[str, np.ndarray]] = (),
    local: Sequence[str] = ("slsqp", "log_cholesky"),
    max_iterations: int | None = None,
    n_jobs: int | None = None,
    show_progress: bool | None = None,
) -> Comparison: ...


def compare(
    problem: Problem | Saved,
    other: Saved | None = None,
    *,
    starts: int = 20,
    seed: int = 0,
    extra_starts: Sequence[tuple[str, np.ndarray]] = (),
    local: Sequence[str] = ("slsqp", "log_cholesky"),
    max_iterations: int | None = None,
    n_jobs: int | None = None,
    show_progress: bool | None = None,
) -> Comparison | RunComparison:
    """Run every solver on a problem, the local ones from many starts; or compare two results.

    Parameters
    ----------
    problem : Problem, or Identification, SavedRun or path
        The problem, with a consistency; or a result of `identify`, or its folder.
    other : Identification, SavedRun or path, optional
        The result to compare with, of the same robot. The other arguments are those of solvers.
    starts : int, optional
        Number of random starts; every local solver gets the same.
    seed : int, optional
        Random seed of the starts.
    extra_starts : sequence of (label, theta), optional
        Further starts.
    local : sequence of str, optional
        Local solvers, of ``"slsqp"`` and ``"log_cholesky"``.
    max_iterations : int, optional
        Limit of the local solvers; by default each has its own.
    n_jobs : int, optional
        Jobs (joblib), by default one a core: processes, or the backend of a surrounding
        ``joblib.parallel_config``, such as Dask's.
    show_progress : bool, optional
        Show a progress bar; by default on a terminal.

    Returns
    -------
    Comparison, or RunComparison of two results
        A local run that raises is a row with status ``"error"`` and its message. A local solver
        that cannot handle the problem's conditions or prior is left out, and one row says why.

    Raises
    ------
    SolverError
        When the global optimum cannot be found: then there is nothing to compare with.
    DataError
        When the problem has no consistency, a local solver is not known, or one of two results is
        none.

    Examples
    --------
    >>> comparison = sdpid.compare(problem, starts=1, local=("log_cholesky",), n_jobs=1)
    >>> [(row.solver, row.start) for row in comparison.rows]
    [('wls', '-'), ('sdp', '-'), ('log_cholesky', 'random 1')]
    >>> all(row.cost >= comparison.certificate.lower_bound for row in comparison.rows[1:])
    True
    >>> comparison.to_csv("comparison.csv")
    >>> sdpid.compare(result, result).same_log
    True
    """
    if other is not None or not isinstance(problem, Problem):
        if other is None or isinstance(problem, Problem):
            raise DataError("compare: give a problem alone, or two results of identify.")
        return compare_runs(problem, other)
    unknown = [name for name in local if name not in _LOCAL]
    if unknown:
        raise DataError(
            f"compare: local solver {unknown[0]!r} is not known: use {', '.join(_LOCAL)}."
        )
    if problem.consistency == "none":
        raise DataError("compare: the problem's consistency is 'none'; choose one first.")
    from joblib import delayed

    best = solve_sdp(problem)
    certificate = certify(best)
    wls = solve_wls(problem)
    rng = generator(seed)
    points = [(f"random {i + 1}", random_start(problem, rng)) for i in range(starts)]
    points += [(label, np.asarray(theta)) for label, theta in extra_starts]
    jobs = parallel(n_jobs, return_as="generator")
    left_out = {"log_cholesky": unsupported(problem)}
    able = [solver for solver in local if left_out.get(solver) is None]
    runs = [(solver, label, start) for solver in able for label, start in points]
    entries: list[tuple[str, str, Estimate | str]] = [("wls", "-", wls), ("sdp", "-", best)]
    sent = problem.without_rows()
    tasks = (delayed(_run)(solver, sent, start, max_iterations) for solver, _, start in runs)
    with progress(len(runs), "local solvers", enabled=show_progress) as advance:
        for (solver, label, _), result in zip(runs, jobs(tasks), strict=True):
            # A worker's estimate has a copy of the problem; give it this one.
            own = result if isinstance(result, str) else replace(result, problem=problem)
            entries.append((solver, label, own))
            advance(1)
    entries += [(solver, "-", f"{left_out[solver]}") for solver in local if solver not in able]
    return Comparison(
        rows=tuple(_row(solver, label, result, certificate) for solver, label, result in entries),
        estimates=tuple(None if isinstance(each, str) else each for _, _, each in entries),
        certificate=certificate,
    )


def _run(
    solver: str, problem: Problem, start: np.ndarray, max_iterations: int | None
) -> Estimate | str:
    limit = {} if max_iterations is None else {"max_iterations": max_iterations}
    try:
        return _LOCAL[solver](problem, start=start, **limit)
    except SdpidError as error:
        return f"{type(error).__name__}: {error}"


def _row(solver: str, start: str, result: Estimate | str, certificate: Certificate) -> SolverRun:
    """Return the row of a run: of its estimate, or of the message of its error."""
    if isinstance(result, str):
        return SolverRun(solver=solver, start=start, status="error", message=result)
    return SolverRun(
        solver=solver,
        start=start,
        gap=certify(result, bound=certificate.bound).gap,
        seconds=result.solve_time,
        **{name: getattr(result, name) for name in _OF_ESTIMATE},
    )
