"""Tables of the Denso case study: the paper's IV and V, and the errors of reconstruction."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

import sdpid
from case_study.estimates import Estimates
from case_study.experiments import AXES, FOLDER, ROBOT, true_theta
from sdpid.robot.inertia import physical_parameters, second_moment_from_inertia


def table_iv(found: Estimates) -> pd.DataFrame:
    """Return the base parameters of every estimate beside the paper's."""
    base = found.problems["6x6"].base
    columns = {
        "unit": base.units,
        "true": found.base_true,
        "wls": found.wls.base,
        "sigma": found.wls.standard_errors,
        "cwls": found.cwls.base,
        "sdp_6x6": found.sdp("6x6").base,
        "sdp_4x4": found.sdp("4x4").base,
        "wls_iii_c": found.wls_literal.base,
        "sigma_iii_c": found.wls_literal.standard_errors,
    }
    paper = pd.read_csv(FOLDER / "table_iv.csv", index_col="parameter")[["cwls", "wls", "sigma"]]
    ours = pd.DataFrame(columns, index=base.names)
    return ours.join(paper.add_prefix("paper_")).rename_axis("parameter")


def table_v(found: Estimates) -> pd.DataFrame:
    """Return both margins and the mass of every link beside the paper's."""
    paper = pd.read_csv(FOLDER / "table_v.csv", index_col="link")
    paper.columns = pd.Index(["lambda_min_Ig", "mass"])
    thetas = {
        "true": true_theta(),
        "cwls": found.cwls.theta,
        "sdp_6x6": found.sdp("6x6").theta,
        "sdp_4x4": found.sdp("4x4").theta,
    }
    columns: dict[str, Any] = {}
    for name, theta in thetas.items():
        inertias, moments = _center_margins(theta)
        columns[f"{name}_lambda_min_Ig"] = inertias
        columns[f"{name}_second_moment"] = moments
        columns[f"{name}_mass"] = theta[0 : 10 * AXES : 10]
    table = pd.DataFrame(columns, index=paper.index).join(paper.add_prefix("paper_")).T
    return table.rename_axis("estimate")


def reconstruction(found: Estimates) -> pd.DataFrame:
    """Return the errors of each joint on the second experiment, N·m."""
    experiment = found.experiment
    errors = {
        "noise_floor": experiment.floor,
        "rmse_wls": sdpid.validate(found.wls, experiment.check).rmse,
        "rmse_sdp_4x4": sdpid.validate(found.sdp("4x4"), experiment.check).rmse,
        "rmse_wls_iii_c": sdpid.validate(found.wls_literal, experiment.check_literal).rmse,
    }
    return pd.DataFrame(errors, pd.Index(sdpid.load_robot(ROBOT).joint_names, name="joint"))


def comparison(found: Estimates) -> pd.DataFrame:
    """Return a row a solver and start, under either inequality."""
    rows = {name: each.to_frame() for name, each in found.comparisons.items()}
    return pd.concat(rows, names=["inequality"]).droplevel(1)


def solvers(comparisons: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Return a row a plant, inequality and solver: how many starts ended optimal, how far off.

    The worst is how far above the proven bound a start ended, relative to the cost.
    """
    every = pd.concat(comparisons, names=["plant"]).reset_index()
    every = every[every["solver"] != "wls"]
    every["optimal"] = every["status"] == "optimal"
    groups = every.groupby(["plant", "inequality", "solver"], sort=False)
    return groups.agg(
        starts=("start", "size"),
        optimal=("optimal", "sum"),
        worst_gap=("gap", "max"),
        least_iterations=("iterations", "min"),
        most_iterations=("iterations", "max"),
        seconds=("seconds", "median"),
    )


def _center_margins(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the least eigenvalues of each link's I_g and of its second moments about there."""
    _, _, inertia = physical_parameters(theta[: 10 * AXES].reshape(AXES, 10))
    matrices = inertia, np.array([second_moment_from_inertia(each) for each in inertia])
    inertias, moments = (np.linalg.eigvalsh(each)[:, 0] for each in matrices)
    return inertias, moments
