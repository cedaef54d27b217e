"""Base parameters as forest plots, a picture for each link and for the friction of its joint."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.estimation.problem import Problem
from sdpid.output.report.judged import Judged
from sdpid.output.tables.intervals_shown import Ends
from sdpid.plots.forest import plot_forest
from sdpid.plots.in_pages import image_source


def pictures(result: Judged, ends: dict[str, Ends]) -> Iterator[dict[str, Any]]:
    """Yield a picture of the base parameters of every link and of the terms of every joint."""
    problem = result.problem
    names = problem.base.names
    described = _described(problem)
    lower, upper = np.full((2, len(names)), np.nan)
    for k, name in enumerate(names):
        low, high, _ = ends.get(name, (None, None, ""))
        if low is not None and high is not None:
            lower[k], upper[k] = low, high
    for title, rows in _groups(problem).items():
        values = {
            "least squares": result.wls.base[rows],
            "this estimate": result.estimate.base[rows],
        }
        if np.isfinite(described[rows]).any():
            values = {"description": described[rows], **values}
        shown = [names[k] for k in rows]
        axes = plot_forest(shown, values, lower=lower[rows], upper=upper[rows])
        yield {"title": title, "source": image_source(axes), "names": shown}


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
