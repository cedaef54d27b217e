"""Mass, center of mass and principal inertias of every link, beside the description's."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.intervals.delta_method import LinkProperties, link_properties, properties
from sdpid.errors import SdpidError
from sdpid.output.report.judged import Judged

# More than this share of what is known is the description's word.
_MOSTLY = 0.5


def values(result: Judged) -> dict[str, Any]:
    """Return the values of the template; no links where an estimate has no standard parameters."""
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
