"""Base parameters as forest plots, a picture for each link and for the friction of its joint.

The template draws the marks, each row on its own scale.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.estimation.problem import Problem
from sdpid.output.report.judged import Judged
from sdpid.output.tables.intervals_shown import Ends
from sdpid.plots.estimates import row_scales, told

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
