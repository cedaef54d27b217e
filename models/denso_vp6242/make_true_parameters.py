"""Make ``true_parameters.csv``: what the simulated plant of the case study is made of.

The published base parameters (Table IV, column CWLS) are not those of any real set of bodies, so
the plant takes the nearest ones that are. Two convex problems, solved by Clarabel:

1. **Base parameters.** Minimize ``Σ ((B·theta − cwls) / s)²`` over the 36 inertial base
   parameters, where s is the table's own sigma column, but at least 0.005/√3 (the standard
   deviation of rounding to 0.01, which is what the printed CWLS values carry). Subject to full
   physical consistency of every link: its second moments about the center of mass are at least
   `MARGIN` (4×4 pseudo-inertia minus MARGIN on its 3×3 block positive semidefinite), and its mass
   lies between `MASS_MIN` and `MASS_MAX`. The minimizer is unique in the base parameters.
2. **Standard parameters.** 24 directions do not show in the effort. Of all sets with those base
   parameters take the nearest, in log-determinant divergence between pseudo-inertias, to a
   reference in which every link is a uniform ball of `BALL_MASS` and `BALL_RADIUS` about the
   origin of its frame. It is unique, and in the interior wherever the first problem leaves room.

Friction is Table IV's CWLS column as it stands.

Run ``python make_true_parameters.py`` in a checkout; it needs sdpid and nothing else.
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.files import atomic_write_text
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.inertia import margin, matrix_basis
from sdpid.robot.model.base_parameters import BaseParameters, structural_base
from sdpid.robot.model.model import RobotModel

FOLDER = Path(__file__).resolve().parent

# kg·m², of the second moments about the center of mass. It implies 0.01 kg·m² on the inertia
# about the center of mass: the margin at which the authors ran (Table V).
MARGIN = 0.005
# kg. The largest virtual mass of Table V is 38.45 kg.
MASS_MIN, MASS_MAX = 0.5, 40.0
# kg·m² and kg·m: the standard deviation of a number rounded to 0.01.
ROUNDING = 0.005 / np.sqrt(3.0)
# A ball of this size has the masses and moments that the table's numbers suggest.
BALL_MASS, BALL_RADIUS = 10.0, 0.15
# The second problem keeps the first one's base parameters, which touch the constraints. It may
# give way by this fraction of them, so that a strictly feasible point is left.
SLACK = 1e-4
# Written numbers: far below anything the plant can show, and free of a solver's last digits.
DECIMALS = 9


def published(base: BaseParameters) -> tuple[Array, Array]:
    """Return CWLS values and scales of Table IV in the order of the base parameters."""
    with (FOLDER / "table_iv.csv").open(encoding="utf-8", newline="") as file:
        rows = {row["parameter"]: row for row in csv.DictReader(file)}
    values = np.array([float(rows[name]["cwls"]) for name in base.names])
    sigma = np.array([float(rows[name]["sigma"]) for name in base.names])
    return values, np.maximum(sigma, ROUNDING)


def _matrices(theta: Any, links: int) -> list[Any]:
    basis = matrix_basis("pseudo_inertia")
    return [sum(theta[10 * i + k] * basis[k] for k in range(10)) for i in range(links)]


def _constraints(theta: Any, links: int, slack: float) -> list[Any]:
    shift = (1.0 - slack) * MARGIN * np.diag([1.0, 1.0, 1.0, 0.0])
    masses = theta[0 : 10 * links : 10]
    return [matrix >> shift for matrix in _matrices(theta, links)] + [
        masses >= (1.0 - slack) * MASS_MIN,
        masses <= (1.0 + slack) * MASS_MAX,
    ]


def nearest_base(B: Array, values: Array, scales: Array) -> Array:
    """Return the base parameters of problem 1."""
    import cvxpy as cp

    theta = cp.Variable(B.shape[1])
    distance = cp.sum_squares(cp.multiply(1.0 / scales, B @ theta - values))
    problem = cp.Problem(cp.Minimize(distance), _constraints(theta, B.shape[1] // 10, 0.0))
    problem.solve(solver=cp.CLARABEL)
    if problem.status != cp.OPTIMAL:
        raise RuntimeError(f"problem 1 ended {problem.status}")
    return np.asarray(B @ theta.value)


def nearest_links(B: Array, base: Array) -> Array:
    """Return the standard parameters of problem 2, shape (links, 10)."""
    import cvxpy as cp

    links = B.shape[1] // 10
    reference = np.diag([BALL_MASS * BALL_RADIUS**2 / 5.0] * 3 + [BALL_MASS])
    # In coordinates in which the reference is the unit matrix the divergence is tr(X) − ln det X.
    scale = np.linalg.cholesky(reference)
    theta = cp.Variable(B.shape[1])
    divergence = 0.0
    inverse = np.linalg.inv(scale)
    for matrix in _matrices(theta, links):
        relative = inverse @ matrix @ inverse.T
        divergence += cp.trace(relative) - cp.log_det(relative)
    constraints = [B @ theta == base, *_constraints(theta, links, SLACK)]
    problem = cp.Problem(cp.Minimize(divergence), constraints)
    problem.solve(solver=cp.CLARABEL)
    if problem.status != cp.OPTIMAL:
        raise RuntimeError(f"problem 2 ended {problem.status}")
    return np.asarray(theta.value).reshape(links, 10)


def true_parameters() -> tuple[BaseParameters, Array]:
    """Return the base parameters' structure and the plant's theta, shape (72,)."""
    robot = RobotModel.from_mdh(FOLDER / "kinematics.toml")
    friction = FrictionModel.from_terms(("coulomb", "viscous"), robot.joint_names)
    base = structural_base(robot, friction)
    values, scales = published(base)
    count = 10 * robot.n_links
    inertial = base.kept < count
    B = base.matrix[inertial][:, :count]
    links = nearest_links(B, nearest_base(B, values[inertial], scales[inertial]))
    losses = dict(zip(base.names, values, strict=True))
    theta = [*links.ravel(), *(losses[parameter.name] for parameter in friction.parameters)]
    return base, np.round(theta, DECIMALS)


def main() -> None:
    """Write the file and print how far the result is from the table."""
    base, theta = true_parameters()
    lines = ["parameter,unit,value"]
    for name, unit, value in zip(base.theta_names, base.theta_units, theta, strict=True):
        lines.append(f"{name},{unit},{float(value)!r}")
    atomic_write_text(FOLDER / "true_parameters.csv", "\n".join(lines) + "\n")
    values, scales = published(base)
    print(f"{'parameter':10s} {'true':>10s} {'CWLS':>10s} {'distance/s':>10s}")
    for name, mine, theirs, s in zip(base.names, base.matrix @ theta, values, scales, strict=True):
        print(f"{name:10s} {mine:10.4f} {theirs:10.4f} {(mine - theirs) / s:10.1f}")
    links = theta[:60].reshape(6, 10)
    print("masses (kg):", links[:, 0].round(3))
    print("margins (kg·m²):", margin(links, "pseudo_inertia").round(6))


if __name__ == "__main__":
    main()
