"""The estimation problem written down a second time, straight in theta, with CVXPY.

Nothing here uses the rows, the matrices or the scaling of the library: conditions are written from
what they say, and the only numbers taken from a problem are A, B, rhs, floor, the names of theta
and the numbers of its constraints.
"""

from typing import Any

import cvxpy as cp
import numpy as np

from sdpid import constraints
from sdpid._common.arrays import Array
from sdpid.estimation.constraints.condition import Condition
from sdpid.estimation.prior.prior import Prior, repaired
from sdpid.estimation.problem import Problem


def pseudo_inertia(body: Any, margin: float = 0.0) -> Any:
    """Return the 4×4 matrix, the margin taken off the second moments."""
    m, hx, hy, hz, xx, xy, yy, xz, yz, zz = (body[k] for k in range(10))
    return cp.bmat(
        [
            [(yy + zz - xx) / 2 - margin, -xy, -xz, hx],
            [-xy, (xx + zz - yy) / 2 - margin, -yz, hy],
            [-xz, -yz, (xx + yy - zz) / 2 - margin, hz],
            [hx, hy, hz, m],
        ]
    )


def spatial_inertia(body: Any, margin: float = 0.0) -> Any:
    """Return the 6×6 matrix, the margin taken off the moments of inertia."""
    m, hx, hy, hz, xx, xy, yy, xz, yz, zz = (body[k] for k in range(10))
    return cp.bmat(
        [
            [xx - margin, xy, xz, 0, -hz, hy],
            [xy, yy - margin, yz, hz, 0, -hx],
            [xz, yz, zz - margin, -hy, hx, 0],
            [0, hz, -hy, m, 0, 0],
            [-hz, 0, hx, 0, m, 0],
            [hy, -hx, 0, 0, 0, m],
        ]
    )


class Second:
    """A problem in plain theta.

    Attributes
    ----------
    problem : Problem
        The problem.
    theta : cvxpy.Variable
        Standard parameters.
    cost : cvxpy expression
        Data, and a prior when one is given.
    """

    def __init__(self, problem: Problem, prior: Prior | None = None) -> None:
        self.problem = problem
        self.theta = cp.Variable(problem.n_theta)
        G = problem.A @ problem.base.matrix
        # Squares in units of the floor, so that the solver sees numbers of order one.
        self.unit = max(problem.floor, 1e-6 * float(problem.rhs @ problem.rhs), 1e-12)
        root = np.sqrt(self.unit)
        cost = cp.sum_squares(G / root @ self.theta - problem.rhs / root)
        if prior is not None:
            cost = cost + self._believed(prior) / self.unit
        self.cost = cost

    def body(self, link: int | str) -> Any:
        """Return the ten parameters of a link."""
        if isinstance(link, str):
            link = self.problem.robot.link_names.index(link)
        return self.theta[10 * link : 10 * link + 10]

    def _believed(self, prior: Prior) -> Any:
        # What is left of the rows when the links are taken off: those of the friction terms.
        links = 10 * self.problem.robot.n_links
        count = self.problem.base.count
        rows, rhs = self.problem.squared.matrix[count:], self.problem.squared.rhs[count:]
        friction = ~np.any(rows[:, :links], axis=1)
        F, f = rows[friction], rhs[friction]
        nats: Any = cp.sum_squares(F @ self.theta - f) / 2 if len(F) else 0.0
        given = self.problem.robot.prior if prior.bodies is None else prior.bodies
        strength = self.problem.prior.strength
        for pair in prior.alike:
            H = np.asarray(pair.reflection)
            one, two = (
                np.array(pseudo_inertia(given[self.problem.robot.link_names.index(name)]).value)
                for name in (pair.first, pair.second)
            )
            inverse = np.linalg.inv(np.linalg.cholesky((H @ one @ H.T + two) / 2))
            off = (
                pseudo_inertia(self.body(pair.second))
                - H @ pseudo_inertia(self.body(pair.first)) @ H.T
            )
            nats = nats + cp.sum_squares(inverse @ off @ inverse.T) / prior.within**2 / 2
        for link, body in enumerate(repaired(np.array(given))[0]):
            if not body[0] > 0.0:
                continue
            P0 = np.array(pseudo_inertia(body).value)
            inverse = np.linalg.inv(np.linalg.cholesky(P0))
            ratio = inverse @ pseudo_inertia(self.body(link)) @ inverse.T
            if prior.kind == "pullback":
                nats = nats + strength * cp.sum_squares(ratio - np.eye(4)) / 2
            else:
                nats = nats + strength * (cp.trace(ratio) - cp.log_det(ratio) - 4)
        return 2 * nats

    def numbers(self) -> list[cp.Constraint]:
        """Return margin, masses, signs and theta_max."""
        problem, c = self.problem, self.problem.constraints
        out: list[cp.Constraint] = [cp.abs(self.theta) <= problem.feasible.widest]
        if problem.consistency == "none":
            return out
        matrix = pseudo_inertia if problem.consistency == "pseudo_inertia" else spatial_inertia
        links = problem.robot.n_links
        for i in range(links):
            body = self.body(i)
            out += [matrix(body, c.margin) >> 0, body[0] >= c.mass_min, body[0] <= c.mass_max]
        for k, parameter in enumerate(problem.friction.parameters):
            if parameter.nonnegative and c.friction_nonnegative:
                out.append(self.theta[10 * links + k] >= 0)
        return out

    def condition(self, other: Condition) -> list[cp.Constraint]:
        """Return what a condition says."""
        theta, names = self.theta, list(self.problem.base.theta_names)
        links = self.problem.robot.link_names
        match other:
            case constraints.TotalMass():
                mass = sum(self.body(link)[0] for link in other.links or links)
                return [cp.abs(mass - other.mass) <= other.tolerance]
            case constraints.CenterOfMassInBox():
                body = self.body(other.link)
                return [
                    sign * (body[1 + k] - ends[k] * body[0]) >= 0
                    for sign, ends in ((1, other.lower), (-1, other.upper))
                    for k in np.flatnonzero(np.isfinite(ends))
                ]
            case constraints.CenterOfMassInEllipsoid() | constraints.MassInEllipsoid():
                body = self.body(other.link)
                R = np.eye(3) if other.rotation is None else np.asarray(other.rotation)
                if isinstance(other, constraints.CenterOfMassInEllipsoid):
                    inside = R.T @ (body[1:4] - body[0] * other.center)
                    return [cp.norm(cp.multiply(1.0 / other.semi_axes, inside)) <= body[0]]
                J, c = pseudo_inertia(body), np.asarray(other.center)
                S = R @ np.diag(np.asarray(other.semi_axes) ** -2.0) @ R.T
                # ∫ (x − c)^T·S·(x − c) dm ≤ m.
                moment = cp.trace(S @ J[:3, :3]) - 2 * (S @ c) @ J[:3, 3] + (c @ S @ c) * J[3, 3]
                return [moment <= J[3, 3]]
            case constraints.CenterOfMassInHull():
                # A combination of the points.
                points, body = np.asarray(other.points), self.body(other.link)
                weights = cp.Variable(len(points), nonneg=True)
                return [points.T @ weights == body[1:4], cp.sum(weights) == body[0]]
            case constraints.Fixed():
                return [theta[names.index(name)] == v for name, v in other.values.items()]
            case constraints.FixedLink():
                return [self.body(other.link) == np.asarray(other.body)]
            case constraints.EqualFriction():
                joints = self.problem.robot.joint_names
                one, two = (joints.index(name) + 1 for name in (other.first, other.second))
                pairs = [
                    (theta[names.index(f"{symbol}{one}")], theta[names.index(f"{symbol}{two}")])
                    for symbol in ("Fs", "Fv")
                ]
                return [cp.abs(a - b) <= other.within * (a + b) / 2 for a, b in pairs]
            case constraints.EqualLinks():
                return [self.body(other.first) == self.body(other.second)]
            case constraints.MirrorSymmetry():
                J = pseudo_inertia(self.body(other.link))
                H = reflection(np.asarray(other.normal), np.asarray(other.point))
                return [H @ J @ H.T == J]
            case constraints.MirrorPair() if other.reflection is not None:
                J = pseudo_inertia(self.body(other.first))
                H = np.asarray(other.reflection)
                return [pseudo_inertia(self.body(other.second)) == H @ J @ H.T]
        raise NotImplementedError(type(other).__name__)

    def constraints(self) -> list[cp.Constraint]:
        """Return all that the problem asks."""
        others = self.problem.constraints.others
        return self.numbers() + [part for other in others for part in self.condition(other)]

    def solve(self, solver: str, **settings: Any) -> float:
        """Return the optimal cost, as the solver found it."""
        program = cp.Problem(cp.Minimize(self.cost), self.constraints())
        program.solve(solver=solver, **settings)
        assert program.status == "optimal", program.status
        return float(program.value) * self.unit + self.problem.floor


def reflection(normal: Array, point: Array) -> Array:
    """Return the mirror in a plane as a 4×4 matrix."""
    n = normal / np.linalg.norm(normal)
    out = np.eye(4)
    out[:3, :3] -= 2.0 * np.outer(n, n)
    out[:3, 3] = 2.0 * n * float(n @ point)
    return out
