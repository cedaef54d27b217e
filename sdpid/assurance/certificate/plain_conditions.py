"""Rows and cones of a feasible set as plain values."""

from __future__ import annotations

from typing import Any

import numpy as np

from sdpid.estimation.constraints.feasible_set import FeasibleSet


def plain_conditions(feasible: FeasibleSet) -> dict[str, list[dict[str, Any]]]:
    """Return the further conditions as a certificate states them, ``rows`` and ``cones``."""
    own = feasible.n_own
    rows = zip(
        feasible.row_names, feasible.rows, feasible.row_lower, feasible.row_upper, strict=True
    )
    cones = zip(
        feasible.block_names[own:],
        feasible.block_links[own:].tolist(),
        feasible.block_basis[own:],
        strict=True,
    )
    return {
        "rows": [
            {
                "name": name,
                "lower": _finite(low),
                "upper": _finite(high),
                "coefficients": row.tolist(),
            }
            for name, row, low, high in rows
        ],
        "cones": [
            {
                "name": name,
                "link": link,
                "axis": basis[:, -1, -1].tolist(),
                "vectors": basis[:, :3, -1].T.tolist(),
            }
            for name, link, basis in cones
        ],
    }


def _finite(limit: float) -> float | None:
    """Return a limit for JSON, None where there is none."""
    return float(limit) if np.isfinite(limit) else None
