"""Parameters: tables with intervals and sources, pictures of each on its own scale, links."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.diagnostics.provenance import provenance
from sdpid.assurance.intervals.delta_method import LinkProperties, link_properties, properties
from sdpid.assurance.intervals.intervals import Intervals
from sdpid.errors import SdpidError
from sdpid.estimation.problem import Problem
from sdpid.output.report.judged import Judged
from sdpid.output.tables.parameter_tables import Ends, base_table, ends_of, in_words
from sdpid.plots.estimates import row_scales, told

# Values below this share of their standard error are what a solver leaves of zero, at a bound.
_NOTHING = 1e-6


def values(result: Judged, intervals: Intervals | None) -> dict[str, Any]:
    """Return the values of the template."""
    ends = ends_of(intervals)
    base, theta = list(base_rows(result, ends)), list(_theta(result, ends))
    return {
        "forest": list(pictures(result, ends)),
        "base": base,
        "theta": theta,
        "has_errors": any(row["error"] is not None for row in base),
        "has_intervals": any(row["interval"] for row in (*base, *theta)),
        "intervals_in_words": in_words(intervals),
        **_links(result),
    }


def base_rows(result: Judged, ends: dict[str, Ends]) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table of base parameters."""
    for row in base_table(result.estimate, result.wls).rows:
        name, unit, value, error, free, regrouping = row
        if isinstance(error, float) and isinstance(value, float) and abs(value) < _NOTHING * error:
            value = 0.0
        yield {
            "name": name,
            "unit": unit,
            "value": value,
            "free": free,
            "error": error,
            "regrouping": regrouping,
            "interval": ends.get(str(name)),
        }


def _theta(result: Judged, ends: dict[str, Ends]) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table of standard parameters, with shares of their sources."""
    estimate, base = result.estimate, result.problem.base
    if estimate.theta is None:
        return
    sources = provenance(estimate)
    for k, name in enumerate(base.theta_names):
        shares = [float(sources.data[k]), float(sources.physics[k]), float(sources.prior[k])]
        yield {
            "name": name,
            "unit": base.theta_units[k],
            "value": float(estimate.theta[k]),
            "shares": shares,
            "interval": ends.get(name),
        }


# In the order of importance; NaN is not drawn.
_MARKS = ("own", "free", "described", "low", "high")


def pictures(result: Judged, ends: dict[str, Ends]) -> Iterator[dict[str, Any]]:
    """Yield a picture of the base parameters of every link and of the terms of every joint."""
    problem, names = result.problem, result.problem.base.names
    own, described = result.estimate.base, _described(problem)
    found = np.array([ends.get(name, (None, None))[:2] for name in names], dtype=np.float64)
    low, high = np.where(np.isfinite(found).all(axis=1), found.T, np.nan)
    scale = row_scales(own, [described], [low, high])
    marks = np.stack([own, result.wls.base, described, low, high]) / scale
    for title, rows in _groups(problem).items():
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
    links = 10 * robot.n_links
    # Links are those that joints move, one each, unless the base floats or joints follow others.
    alike = robot.n_links == len(friction.joint_names) and friction.first == 0
    titles = [
        f"{name}, moved by {friction.joint_names[i]}" if alike else name
        for i, name in enumerate(robot.link_names)
    ]
    found: dict[str, list[int]] = {}
    for k, leading in enumerate(problem.base.kept):
        if leading < links:
            title = titles[leading // 10]
        else:
            joint = friction.parameters[leading - links].joint
            title = titles[joint] if alike else f"Friction of {friction.joint_names[joint]}"
        found.setdefault(title, []).append(k)
    return found


def _described(problem: Problem) -> Array:
    """Return the base parameters (b,) of the description's links, NaN where it says nothing."""
    prior, B = problem.robot.prior, problem.base.matrix
    theta = np.concatenate([prior.ravel(), np.zeros(problem.n_theta - prior.size)])
    told = np.zeros(len(theta), dtype=np.bool_)
    told[: prior.size] = np.repeat(prior[:, 0] > 0.0, 10)
    links_alone = ~np.any((B != 0.0) & ~told, axis=1)
    return np.where(links_alone, B @ theta, np.nan)


# More than this share of what is known is the description's word.
_MOSTLY = 0.5


def _links(result: Judged) -> dict[str, Any]:
    """Return the values of the links; none where an estimate has no standard parameters."""
    estimate, robot = result.estimate, result.problem.robot
    if estimate.theta is None:
        return {"links": None}
    bodies = np.array(estimate.theta[: 10 * robot.n_links]).reshape(-1, 10)
    try:
        found = link_properties(estimate)
    except SdpidError:  # no covariance; the values are known all the same
        found = None
    described = properties(np.array(robot.prior))
    described[robot.prior[:, 0] <= 0.0] = np.nan
    own = properties(bodies)
    return {
        "links": [
            {
                "name": name,
                "cells": list(_cells(own[i], found, i)),
                "described": described[i].tolist(),
            }
            for i, name in enumerate(robot.link_names)
        ],
        "has_link_intervals": found is not None,
        "has_described": bool(np.isfinite(described).any()),
        "has_mostly": found is not None and bool((found.prior_share > _MOSTLY).any()),
    }


def _cells(own: Array, found: LinkProperties | None, link: int) -> Iterator[dict[str, Any]]:
    """Yield each quantity of a link: value, ends of its interval, and whose word it mostly is."""
    for k, value in enumerate(own.tolist()):
        cell: dict[str, Any] = {"value": value, "ends": None, "mostly": False}
        if found is not None and np.isfinite(found.upper[link, k]):
            cell["ends"] = (float(found.lower[link, k]), float(found.upper[link, k]))
            cell["mostly"] = float(found.prior_share[link, k]) > _MOSTLY
        yield cell
