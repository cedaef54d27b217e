"""Motion of the model: the least eigenvalue of its mass matrix, and simulations of a recording."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid._common.kept import kept
from sdpid.assurance.diagnostics.described import described_dynamics
from sdpid.assurance.diagnostics.held_out import DESCRIPTION, LEAST_SQUARES, OURS
from sdpid.assurance.diagnostics.mass_matrix import SmallestMassEigenvalue, smallest_mass_eigenvalue
from sdpid.output.charts.charts import Charts
from sdpid.output.report.judged import Judged
from sdpid.plots.lines import TimeLine

# Instants along the motion: more than a picture shows.
_INSTANTS = 300

# Beyond this ratio between curves one axis shows the small ones as zero: it is linear up to the
# smallest and logarithmic beyond.
_RATIO = 30.0

# Joints of a robot whose box of positions is searched: a third of a second at seven.
_MOST = 12

# Of the size of this share of the mass matrix an eigenvalue is rounding.
_ROUNDING = 1e-9


def values(result: Judged, charts: Charts) -> dict[str, Any]:
    """Return the values of the template."""
    samples = result.problem.samples
    some, along = least_eigenvalues(result)
    box = _over_the_box(result)
    bound = None if box is None or not box.positive_definite else box.lower_bound
    time = None if samples.time is None else samples.time[some]
    line = TimeLine.of(time, len(some), np.searchsorted(some, samples.starts).tolist())
    columns = {name: line.broken(each) for name, each in along.items()}
    if bound is not None:
        columns["proven bound"] = np.full(len(line.time), bound)
    sizes = [float(np.nanmax(np.abs(each))) for each in columns.values()]
    return {
        "mass_matrix": {
            "rows": [
                {
                    "name": name,
                    "ours": name == OURS,
                    "least": float(each.min()),
                    "most": float(each.max()),
                    "indefinite": float(np.mean(each <= 0.0)),
                }
                for name, each in along.items()
            ],
            "instants": len(some),
            "box": box,
            "bound": bound,
            "chart": charts.add(x=line.time, linear_to=_linear_to(sizes), **columns),
            "time_label": line.label,
        },
        **_simulated(result, charts),
    }


def _linear_to(sizes: list[float]) -> float | None:
    """Return the smallest size that is not nothing, where others are many times larger."""
    small = min((size for size in sizes if size > 0.0), default=0.0)
    return small if small and max(sizes) >= _RATIO * small else None


@kept
def least_eigenvalues(result: Judged) -> tuple[Indices, dict[str, Array]]:
    """Return samples (K,), and the mass matrix's least eigenvalue (K,) there, model by model."""
    robot, samples = result.problem.robot, result.problem.samples
    some = np.unique(np.linspace(0, samples.n_samples - 1, _INSTANTS).astype(np.intp))
    models = {LEAST_SQUARES: result.wls.model(), OURS: result.estimate.model()}
    if np.any(robot.prior[:, 0] > 0.0):
        models = {DESCRIPTION: described_dynamics(robot, samples), **models}
    position = samples.position[some]
    return some, {
        name: np.asarray(np.linalg.eigvalsh(model.mass_matrix(position))[:, 0], dtype=float)
        for name, model in models.items()
    }


def _over_the_box(result: Judged) -> SmallestMassEigenvalue | None:
    """Return the least over all positions, of the links alone, where drives only add to it."""
    estimate = result.estimate
    if result.problem.robot.n > _MOST or estimate.theta is None:
        return None
    q = result.problem.samples.position[0]
    links = estimate.mass_matrix(q)
    drives = estimate.model().mass_matrix(q) - links
    if np.linalg.eigvalsh(drives)[0] < -_ROUNDING * np.abs(links).max():
        return None
    return smallest_mass_eigenvalue(estimate)


def _simulated(result: Judged, charts: Charts) -> dict[str, Any]:
    """Return one entry a rollout."""
    return {
        "rollouts": [
            {
                "title": "All joints free" if each.free == "all" else "One joint free at a time",
                "starts": len(each.start),
                "verdict": each.verdict,
                "notes": told,
                "models": each.as_table(),
                "joints": each.joint_table(),
                "chart": _chart(each, charts),
                "own": each.own,
                "names": list(each.medians),
            }
            for each, told in zip(result.rollouts, fresh_notes(result.rollouts), strict=True)
        ]
    }


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
