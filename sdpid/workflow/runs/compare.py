"""Two results folders against each other, from their files alone."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from sdpid._common.tables import Shown, Table, plain_dict
from sdpid.errors import DataError
from sdpid.robot.inertia import physical_parameters
from sdpid.workflow.result import Identification
from sdpid.workflow.runs.saved import OURS, SavedParameter, SavedRun, predictions

# Results, and folders of them.
Saved: TypeAlias = SavedRun | Identification | str | os.PathLike[str]

_NO_JOINT_TEST = (
    "Files hold no covariances, so parameters are tested one by one and never together; "
    "first.compare_to(other) of the estimates does both."
)


@dataclass(frozen=True, kw_only=True, repr=False)
class RunComparison(Shown):
    """Two runs against each other.

    Attributes
    ----------
    folders : (str, str)
        The first and the other, which are called so where they are in no folder.
    inputs, choices, held_out, proofs, parameters, links : Table
        What they were given; what was asked and chosen differently; errors on what was held out;
        costs and proofs; base parameters with their differences; masses, centers and inertias.
    same_log : bool or None
        Whether both were fitted to the same log; None where the files do not say.
    same_held_out : bool
        Whether the rows held out are the same, so that the errors on them can be compared.
    better : str or None
        The folder that predicts better what was held out from both.
    outside : tuple of str
        Base parameters that differ by more than their intervals together; none where the runs
        share data.
    headlines : tuple of dict
        The verdict of each in short.
    notes : tuple of str
        What to know, one sentence each.
    """

    folders: tuple[str, str]
    inputs: Table
    choices: Table
    held_out: Table
    proofs: Table
    parameters: Table
    links: Table
    same_log: bool | None
    same_held_out: bool
    better: str | None
    outside: tuple[str, ...]
    headlines: tuple[dict[str, Any], dict[str, Any]]
    notes: tuple[str, ...]

    def _shown(self) -> dict[str, object]:
        first, other = self.folders
        notes = " ".join(self.notes)
        return {"same log": self.same_log, "first": first, "other": other, "notes": notes}

    def _tables(self) -> Iterator[Table]:
        return (table for _, table in self._sections() if table.rows)

    def _sections(self) -> Iterator[tuple[str, Table]]:
        yield "inputs", self.inputs
        yield "asked and chosen differently", self.choices
        yield "held out, in motion: relative residual and NRMSE of each joint, %", self.held_out
        yield "cost and proof", self.proofs
        yield "base parameters", self.parameters
        yield (
            "links: mass in kg, distance of the centers in mm, principal inertias in kg.m2",
            (self.links),
        )

    def text(self, *, full: bool = True) -> str:
        """Return everything as text; not in full what differs and what it means."""
        parts = [f"first: {self.folders[0]}\nother: {self.folders[1]}"]
        if full:
            for which, headline in zip(("first", "other"), self.headlines, strict=True):
                lines = [f"{key}: {text}" for key, text in headline.items() if text]
                parts.append("\n  ".join([f"verdict of the {which}", *lines]))
        for title, table in self._sections() if full else self._short_sections():
            body = table.text() if table.rows else "nothing"
            parts.append(f"{title}\n  " + body.replace("\n", "\n  "))
        return "\n\n".join([*parts, "\n".join(self.notes)])

    def _short_sections(self) -> Iterator[tuple[str, Table]]:
        """Yield what tells the two apart: no baselines, and only parameters that differ."""
        ours = tuple(row for row in self.held_out.rows if row[0] == OURS)
        differ = tuple(row for row in self.parameters.rows if row[0] in self.outside)
        for title, table in self._sections():
            if table is self.held_out:
                yield title, replace(table, rows=ours)
            elif table is self.parameters:
                if differ:
                    yield "base parameters that differ", replace(table, rows=differ)
            elif table is not self.links:
                yield title, table

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON: tables as lists of rows by name."""
        tables = {
            name: [dict(zip(table.header, row, strict=True)) for row in table.rows]
            for name in ("inputs", "choices", "held_out", "proofs", "parameters", "links")
            for table in [getattr(self, name)]
        }
        rest = ("folders", "same_log", "same_held_out", "better", "outside", "headlines", "notes")
        return plain_dict({**{n: getattr(self, n) for n in rest}, **tables})


def compare_runs(first: Saved, other: Saved) -> RunComparison:
    """Compare two results of `identify`, as their files say them.

    Parameters
    ----------
    first, other : Identification, SavedRun or path
        Results, or the folders that they were saved in, of one robot.

    Returns
    -------
    RunComparison
        ``.text()``, ``.to_dict()``.

    Raises
    ------
    DataError
        When a folder is none, or they are of different robots.
    """
    a, b = SavedRun.of(first), SavedRun.of(other)
    names = (str(a.folder or "first"), str(b.folder or "other"))
    joints = [list(run.problem["joints"]) for run in (a, b)]
    if joints[0] != joints[1]:
        raise DataError(
            f"compare: the joints of {names[0]} are {', '.join(joints[0])}, those of "
            f"{names[1]} {', '.join(joints[1])}; compare runs of one robot."
        )
    same_log = _same(a, b, "log")
    shared = bool(set(a.files("log")) & set(b.files("log")))
    same_rows, why = _same_held_out(a, b, same_log)
    alike = a.intervals == b.intervals
    tested = same_log is False and not shared and alike
    parameters, outside, regrouped = _parameters(a, b, tested=tested)
    better, sentence = _better(a, b, names) if same_rows else (None, why)
    notes = [sentence]
    if tested:
        notes.append(_counted(parameters, outside, a.intervals[1]))
        notes.append(_NO_JOINT_TEST)
    elif shared:
        notes.append(
            "Both were fitted to the same data, at least in part: their errors are not "
            "independent, and differences of parameters are not tested."
        )
    elif same_log is None:
        notes.append("A folder has no manifest: whether the logs are the same is not known.")
    elif None in (a.intervals[0], b.intervals[0]):
        which = "first" if a.intervals[0] is None else "other"
        notes.append(f"The {which} has no intervals, and differences of parameters are not tested.")
    else:
        notes.append(
            "Their intervals are of two kinds, and differences of parameters are not tested: "
            f"{a.intervals[0]} at {a.intervals[1]}, {b.intervals[0]} at {b.intervals[1]}."
        )
    for which, one, two in (("first", a, b), ("other", b, a)):
        if alone := [name for name in one.base if name not in two.base]:
            notes.append(f"In the {which} alone: {', '.join(alone)}.")
    if regrouped:
        notes.append(f"Regrouped differently, and not compared: {', '.join(regrouped)}.")
    return RunComparison(
        folders=names,
        inputs=_inputs(a, b),
        choices=_choices(a, b),
        held_out=_held_out(a, b),
        proofs=_proofs(a, b),
        parameters=parameters,
        links=_links(a, b),
        same_log=same_log,
        same_held_out=same_rows,
        better=better,
        outside=outside,
        headlines=(a.headline, b.headline),
        notes=tuple(notes),
    )


def _same(a: SavedRun, b: SavedRun, role: str) -> bool | None:
    """Return whether both were given the same files in a role; None where it is not known."""
    if a.inputs is None or b.inputs is None:
        return None
    return a.files(role) == b.files(role)


def _inputs(a: SavedRun, b: SavedRun) -> Table:
    """Return the files of each role, and whether they are the same."""
    rows = []
    for role in ("robot", "log", "validation", "gains", "config"):
        names = [", ".join(n for n, _ in (run.inputs or {}).get(role, ())) for run in (a, b)]
        if any(names):
            same = {True: "same", False: "differ", None: "not known"}[_same(a, b, role)]
            rows.append((role, *(name or None for name in names), same))
    return Table(("role", "first", "other", "by SHA-256"), tuple(rows))


def _choices(a: SavedRun, b: SavedRun) -> Table:
    """Return options, choices and settings of the processing that differ."""
    rows = []
    chosen = ("weighting", "consistency", "margin", "prior", "samples", "rows_used")
    sides: tuple[tuple[str, dict[str, Any], dict[str, Any]], ...] = (
        ("option", a.settings, b.settings),
        ("chosen", {k: a.problem.get(k) for k in chosen}, {k: b.problem.get(k) for k in chosen}),
        ("chosen", {"friction terms": a.terms}, {"friction terms": b.terms}),
        ("processing", a.processing, b.processing),
    )
    for what, one, two in sides:
        for name in dict.fromkeys([*one, *two]):
            if one.get(name) != two.get(name):
                rows.append((what, name, _shown(one.get(name)), _shown(two.get(name))))
    return Table(("what", "name", "first", "other"), tuple(rows))


def _shown(value: Any) -> object:
    """Return a value as a cell."""
    if isinstance(value, list | tuple):
        return ", ".join(map(str, value))
    return value if value is None or isinstance(value, float) else str(value)


def _predictions(run: SavedRun) -> dict[str, Any]:
    return predictions(run.result["held_out"] or {})


def _held_out(a: SavedRun, b: SavedRun) -> Table:
    """Return errors in motion on what was held out, of the baselines and of the estimates."""
    joints = list(a.problem["joints"])
    found = [_predictions(run) for run in (a, b)]
    rows = []
    for name in dict.fromkeys([*found[0], *found[1]]):
        for which, each in zip(("first", "other"), found, strict=True):
            if name in each:
                values = [each[name]["relative_residual"]]
                values += [each[name]["joints"].get(j, {}).get("nrmse") for j in joints]
                shares = (None if v is None else 100.0 * v for v in values)
                rows.append((name, which, *shares))
    return Table(("model", "run", "all", *joints), tuple(rows))


def _same_held_out(a: SavedRun, b: SavedRun, same_log: bool | None) -> tuple[bool, str]:
    """Return whether the rows held out are the same, and why not."""
    held = [run.result["held_out"] for run in (a, b)]
    said = "Which predicts better is not said: "
    if not all(held):
        return False, said + "one of them held nothing out."
    if held[0]["by"] != held[1]["by"] or held[0]["blocks"] != held[1]["blocks"]:
        return False, said + "they held out different things."
    role, same = "log", same_log
    if held[0]["by"] == "recording":
        role, same = "validation", _same(a, b, "validation")
    if not same:
        known = "are not the same" if same is False else "may not be the same"
        return False, said + f"the recordings that were held out ({role}) {known}."
    if not a.processing or a.processing != b.processing:
        return False, said + "the recordings held out were processed differently."
    rows = [
        [joint["rows"] for joint in _predictions(run)[OURS]["joints"].values()] for run in (a, b)
    ]
    if rows[0] != rows[1]:
        return False, said + "other rows of the recordings were held out."
    return True, ""


def _better(a: SavedRun, b: SavedRun, names: tuple[str, str]) -> tuple[str | None, str]:
    """Return the folder that predicts better what was held out from both, and a sentence."""
    errors = [_predictions(run)[OURS]["relative_residual"] for run in (a, b)]
    numbers = f"{100.0 * errors[0]:.3g} % (first) and {100.0 * errors[1]:.3g} % (other)"
    if errors[0] == errors[1]:
        return None, f"On the same rows held out both predict alike: {numbers} in motion."
    k = int(errors[1] < errors[0])
    which = ("first", "other")[k]
    return names[k], f"On the same rows held out the {which} predicts better: {numbers} in motion."


def _proofs(a: SavedRun, b: SavedRun) -> Table:
    """Return cost, bound and proof of each."""
    rows = []
    for which, run in (("first", a), ("other", b)):
        r = run.result
        proven = "yes" if r["certified"] else "NO"
        rows.append((which, r["cost"], r["lower_bound"], r["gap"], proven, r["worst_margin"]))
    header = ("run", "cost", "lower bound", "gap", "proven", "worst margin, kg.m2")
    return Table(header, tuple(rows), {"cost": ".8g", "lower bound": ".8g", "gap": ".1e"})


def _parameters(
    a: SavedRun, b: SavedRun, *, tested: bool
) -> tuple[Table, tuple[str, ...], list[str]]:
    """Return the base parameters of both; which differ; and which are regrouped differently."""
    rows, outside, regrouped = [], [], []
    for name, one in a.base.items():
        if (two := b.base.get(name)) is None:
            continue
        if one.expression != two.expression:
            regrouped.append(name)
            continue
        difference = two.value - one.value
        allowed = _allowed(one, two, difference)
        differs = tested and allowed is not None and abs(difference) > allowed
        if differs:
            outside.append(name)
        mark = "differs" if differs else ""
        rows.append((name, one.unit, one.value, two.value, difference, allowed, mark))
    header = ("parameter", "unit", "first", "other", "difference", "allowed", "verdict")
    return Table(header, tuple(rows)), tuple(outside), regrouped


def _allowed(one: SavedParameter, two: SavedParameter, difference: float) -> float | None:
    """Return the half width of the interval of a difference: those that face each other.

    Their squares add up, as those of independent errors do.
    """
    ends = (one.upper, two.lower) if difference > 0.0 else (one.lower, two.upper)
    if ends[0] is None or ends[1] is None:
        return None
    return float(np.hypot(ends[0] - one.value, ends[1] - two.value))


def _counted(parameters: Table, outside: tuple[str, ...], level: Any) -> str:
    """Return how many parameters differ, and how many would by chance."""
    tested = sum(row[5] is not None for row in parameters.rows)
    if not tested:
        return "The runs have no intervals, and differences of parameters are not tested."
    names = f" ({', '.join(outside[:6])}{' and more' if len(outside) > 6 else ''})" * bool(outside)
    return (
        f"Of {tested} base parameters with intervals in both, {len(outside)}{names} differ by more "
        f"than these allow; about {(1.0 - float(level)) * tested:.2g} would by chance."
    )


def _links(a: SavedRun, b: SavedRun) -> Table:
    """Return mass, distance of the centers of mass, and principal inertias of each link."""
    rows = []
    for link, body in a.bodies.items():
        if link not in b.bodies:
            continue
        mass, center, inertia = physical_parameters(np.stack([body, b.bodies[link]]))
        principal = [
            ", ".join(f"{value:.3g}" for value in np.linalg.eigvalsh(each)) for each in inertia
        ]
        apart = 1e3 * float(np.linalg.norm(center[1] - center[0]))
        rows.append((link, float(mass[0]), float(mass[1]), apart, *principal))
    header = ("link", "mass, first", "mass, other", "centers apart", "inertias, first")
    return Table((*header, "inertias, other"), tuple(rows))
