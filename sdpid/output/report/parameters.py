"""Parameters and the model they make: tables, pictures, links, mass matrix, simulations."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.tables import plain
from sdpid.assurance.diagnostics.held_out import OURS
from sdpid.assurance.diagnostics.mass_matrix import SmallestMassEigenvalue, smallest_mass_eigenvalue
from sdpid.assurance.intervals.delta_method import link_properties, properties
from sdpid.assurance.intervals.intervals import Intervals
from sdpid.errors import SdpidError
from sdpid.estimation.problem import Problem
from sdpid.output.charts.page import Charts
from sdpid.output.report.subject import VerdictSubject
from sdpid.output.tables.parameter_tables import base_table, ends_of, in_words, theta_table
from sdpid.plots.estimates import row_scales, told
from sdpid.plots.lines import TimeLine

# Values below this share of their standard error are what a solver leaves of zero, at a bound.
_NOTHING = 1e-6

# More than this share of what is known is the description's word.
_MOSTLY = 0.5

# Beyond this ratio between curves one axis shows the small ones as zero: it is linear up to the
# smallest and logarithmic beyond.
_RATIO = 30.0

# Joints of a robot whose box of positions is searched: a third of a second at seven.
_MOST = 12

# Of the size of this share of the mass matrix an eigenvalue is rounding.
_ROUNDING = 1e-9


def values(of: VerdictSubject, intervals: Intervals | None, charts: Charts) -> dict[str, Any]:
    """Return the values of the templates."""
    base, theta = base_rows(of, intervals), []
    if of.estimate.theta is not None:
        theta = plain(theta_table(of.estimate, intervals))
    return {
        "forest": list(_pictures(of, intervals)),
        "base": base,
        "theta": theta,
        "has_errors": any(row["standard_error"] is not None for row in base),
        "has_intervals": any(row.get("label") for row in (*base, *theta)),
        "intervals_in_words": in_words(intervals),
        **_links(of),
        "mass_matrix": _mass_matrix(of, charts),
        "rollouts": [
            {"of": each, "notes": notes, "chart": _chart(each, charts)}
            for each, notes in zip(of.result.rollouts, fresh_notes(of.result.rollouts), strict=True)
        ],
    }


def base_rows(of: VerdictSubject, intervals: Intervals | None) -> list[dict[str, Any]]:
    """Return the rows of the table of base parameters."""
    rows: list[dict[str, Any]] = plain(base_table(of.estimate, of.result.wls, intervals))
    for row in rows:
        error = row["standard_error"]
        if error is not None and abs(row["value"]) < _NOTHING * error:
            row["value"] = 0.0
    return rows


# In the order of importance; NaN is not drawn.
_MARKS = ("own", "free", "described", "low", "high")


def _pictures(of: VerdictSubject, intervals: Intervals | None) -> Iterator[dict[str, Any]]:
    """Yield a picture of the base parameters of every link and of the terms of every joint."""
    names, ends = of.problem.base.names, ends_of(intervals)
    own, described = of.estimate.base, _described(of.problem)
    found = np.array([ends.get(name, (None, None))[:2] for name in names], dtype=np.float64)
    low, high = np.where(np.isfinite(found).all(axis=1), found.T, np.nan)
    scale = row_scales(own, [described], [low, high])
    marks = np.stack([own, of.result.wls.base, described, low, high]) / scale
    for title, rows in _groups(of.problem).items():
        yield {
            "title": title,
            "rows": [
                {
                    "name": names[k],
                    "told": told(float(own[k]), (float(own[k] - low[k]), float(high[k] - own[k]))),
                    "marks": dict(zip(_MARKS, marks[:, k].tolist(), strict=True)),
                }
                for k in rows
            ],
        }


def _groups(problem: Problem) -> dict[str, list[int]]:
    """Return the base parameters of each link and of its joint, by their names."""
    robot, friction = problem.robot, problem.friction
    links, joints = 10 * robot.n_links, friction.joint_names
    # Links are those that joints move, one each, unless the base floats or joints follow others.
    alike = robot.n_links == len(joints) and friction.first == 0
    found: dict[str, list[int]] = {}
    for k, leading in enumerate(problem.base.kept):
        i = leading // 10 if leading < links else friction.parameters[leading - links].joint
        if alike:
            title = f"{robot.link_names[i]}, moved by {joints[i]}"
        else:
            title = robot.link_names[i] if leading < links else f"Friction of {joints[i]}"
        found.setdefault(title, []).append(k)
    return found


def _described(problem: Problem) -> Array:
    """Return the base parameters (b,) of the description's links, NaN where it says nothing."""
    prior, B = problem.robot.prior, problem.base.matrix
    theta = np.concatenate([prior.ravel(), np.zeros(problem.n_theta - prior.size)])
    known = np.zeros(len(theta), dtype=np.bool_)
    known[: prior.size] = np.repeat(prior[:, 0] > 0.0, 10)
    links_alone = ~np.any((B != 0.0) & ~known, axis=1)
    return np.where(links_alone, B @ theta, np.nan)


def _links(of: VerdictSubject) -> dict[str, Any]:
    """Return the values of the links; none where an estimate has no standard parameters."""
    robot, theta = of.robot, of.estimate.theta
    if theta is None:
        return {"links": None}
    own = properties(np.array(theta[: 10 * robot.n_links]).reshape(-1, 10))
    described = properties(np.array(robot.prior))
    described[robot.prior[:, 0] <= 0.0] = np.nan
    low = high = np.full(own.shape, np.inf)
    mostly, known = np.zeros(own.shape, dtype=bool), True
    try:
        found = link_properties(of.estimate)
        low, high, mostly = found.lower, found.upper, found.prior_share > _MOSTLY
    except SdpidError:  # no covariance; the values are known all the same
        known = False
    cells = (each.tolist() for each in (own, low, high, np.isfinite(high), mostly))
    return {
        "links": [
            {"name": name, "described": row, "cells": list(zip(*each, strict=True))}
            for name, row, *each in zip(robot.link_names, described.tolist(), *cells, strict=True)
        ],
        "has_link_intervals": known,
        "has_described": bool(np.isfinite(described).any()),
        "has_mostly": bool(mostly.any()),
    }


def _mass_matrix(of: VerdictSubject, charts: Charts) -> dict[str, Any]:
    """Return the mass matrix's least eigenvalue along the motion, and over all positions."""
    samples, some, box = of.problem.samples, of.instants, _over_the_box(of)
    bound = None if box is None or not box.positive_definite else box.lower_bound
    time = None if samples.time is None else samples.time[some]
    line = TimeLine.of(time, len(some), np.searchsorted(some, samples.starts).tolist())
    columns = {name: line.broken(each) for name, each in of.least_eigenvalues.items()}
    if bound is not None:
        columns["proven bound"] = np.full(len(line.time), bound)
    sizes = [float(np.nanmax(np.abs(each))) for each in columns.values()]
    small = min((size for size in sizes if size > 0.0), default=np.inf)
    linear_to = small if max(sizes) >= _RATIO * small else None
    return {
        "rows": [
            {
                "name": name,
                "ours": name == OURS,
                "least": float(each.min()),
                "most": float(each.max()),
                "indefinite": float(np.mean(each <= 0.0)),
            }
            for name, each in of.least_eigenvalues.items()
        ],
        "instants": len(some),
        "box": box,
        "bound": bound,
        "chart": charts.add(x=line.time, linear_to=linear_to, **columns),
        "time_label": line.label,
    }


def _over_the_box(of: VerdictSubject) -> SmallestMassEigenvalue | None:
    """Return the least over all positions, of the links alone, where drives only add to it."""
    if of.robot.n > _MOST or of.estimate.theta is None:
        return None
    q = of.problem.samples.position[0]
    links = of.estimate.mass_matrix(q)
    drives = of.estimate.model().mass_matrix(q) - links
    if np.linalg.eigvalsh(drives)[0] < -_ROUNDING * np.abs(links).max():
        return None
    return smallest_mass_eigenvalue(of.estimate)


def _chart(rolled: Any, charts: Charts) -> int:
    """Return the median errors over time, exponents of ten of mrad; what ran away is missing."""
    with np.errstate(divide="ignore"):
        powers = {name: np.log10(1e3 * median) for name, median in rolled.medians.items()}
    return charts.add(x=rolled.time, **powers)


def fresh_notes(rollouts: Sequence[Any]) -> list[list[str]]:
    """Return the notes of each rollout that those before it have not said."""
    said: set[str] = set()
    fresh = []
    for each in rollouts:
        fresh.append([note for note in each.notes if note not in said])
        said.update(each.notes)
    return fresh
