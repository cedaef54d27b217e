"""Links from positions: a convex step with all constraints, and what is known of all numbers.

Positions of rollouts change with the base parameters of links and drives, with the delay, with
friction over position and with where each motion starts. About a fit these changes are linear, so
that the sum of squares is a quadratic in all of them; what is no base parameter is eliminated. With
the prior and the constraints of the torque problem that is a semidefinite program again, whose
optimum is consistent. Its dual bounds what any such step could still gain.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from sdpid._common.arrays import Array, Indices, frozen
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.information import information_rows
from sdpid.estimation.positions.drives import ROW, DriveNumbers, Unknowns
from sdpid.estimation.positions.fit import (
    UNSEEN,
    PositionFit,
    SolvedRollouts,
    normal_equations,
    scaled_inverse,
)
from sdpid.estimation.positions.rollout import SolvedMotion
from sdpid.estimation.posterior import prior_rows
from sdpid.estimation.problem import Problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.dynamics import RobotDynamics

# Kinds of drives by the symbols of the problem's friction terms.
SYMBOLS = {"Ia": "armature", "Fv": "damping", "Fs": "friction"}

# Bytes of a regressor, written a few times, in which Numba makes up for its loading: half a second.
# Where it compiles for the first time, it takes several.
_LARGE = 1 << 28

# Of its step the shares that are tried until the cost falls, and then steps that are damped: where
# a joint hardly rubs, its friction over position is not seen, and would go anywhere.
_SHARES, _DAMPINGS = (1.0, 0.5, 0.25), (0.0, 1e-3, 1e-1)

# A step that promises to lower the cost by less, in variances, is none.
_NOTHING = 1e-2


def links_of(problem: Problem, theta: Array) -> RobotDynamics:
    """Return the robot's links without friction."""
    terms = FrictionModel.from_terms((), problem.robot.joint_names)
    return RobotDynamics(
        robot=problem.robot, terms=terms, theta=theta[: 10 * problem.robot.n_links]
    )


def drives_with(problem: Problem, theta: Array, drives: DriveNumbers) -> DriveNumbers:
    """Return drives with the friction of parameters, none of it negative."""
    values = drives.values.copy()
    for k, each in enumerate(problem.friction.parameters, 10 * problem.robot.n_links):
        values[ROW[SYMBOLS[each.symbol]], each.joint] = max(theta[k], 0.0)
    return replace(drives, values=values)


def theta_with(problem: Problem, theta: Array, drives: DriveNumbers) -> Array:
    """Return parameters with the friction of drives."""
    found = np.array(theta)
    for k, each in enumerate(problem.friction.parameters, 10 * problem.robot.n_links):
        found[k] = drives[SYMBOLS[each.symbol]][each.joint]
    return found


@dataclass(frozen=True, eq=False)
class JointNormal:
    """Normal equations of the robot's parameters and of all else about a fit.

    Attributes
    ----------
    problem : Problem
        Whose standard parameters come first.
    fit : PositionFit
        The fit.
    unknowns : Unknowns
        What comes behind them.
    H, g, scores : ndarray
        JᵀJ, Jᵀe and sums of Jᵀe over blocks of rows.
    variance : float
        Of one row, as few independent ones as residuals show.
    """

    problem: Problem
    fit: PositionFit
    unknowns: Unknowns
    H: Array
    g: Array
    scores: Array
    variance: float

    @classmethod
    def of(cls, problem: Problem, fit: PositionFit) -> JointNormal:
        """Gather them at a fit."""
        more = tuple(kind for kind in fit.unknowns.rows if kind not in SYMBOLS.values())
        unknowns, p = replace(fit.unknowns, rows=more), problem.n_theta
        own = {name: k for k, name in enumerate(problem.base.theta_names)}

        def at(k: int, joints: Indices) -> Indices:
            friction = [own[f"{s}{j + 1}"] for s in SYMBOLS for j in joints]
            links = (10 * joints[:, None] + np.arange(10)).ravel()
            return np.concatenate([friction, p + unknowns.at(k, joints), links])

        def regressor(motion: SolvedMotion) -> Array:
            states = motion.position[:-1], motion.velocity[:-1], motion.acceleration
            size = len(motion.acceleration) * problem.robot.n * 10 * problem.robot.n_links
            return problem.robot.regressor_columns(*states, compiled=8 * size >= _LARGE)

        kinds, size = (*SYMBOLS.values(), *more), p + unknowns.count
        H, g, scores = normal_equations(fit, kinds, unknowns.delay, size, at, regressor)
        found = cls(problem, fit, unknowns, H, g, scores, fit.cost / fit.size)
        information, spread = np.diag(H), np.sum((scores - scores.mean(axis=0)) ** 2, axis=0)
        seen = found.independent[information[found.independent] > 1e-12 * information.max()]
        variance = max(float(np.median(spread[seen] / information[seen])), found.variance)
        return replace(found, variance=variance)

    @property
    def independent(self) -> Indices:
        """Places of the base parameters, and of all that follows the standard parameters."""
        return np.append(self.problem.base.kept, np.arange(self.problem.n_theta, len(self.H)))

    def step(
        self, theta: Array, *, held: bool = False, damping: float = 0.0
    ) -> tuple[Estimate, Array]:
        """Return the optimum of the convex program about theta, and how all else moves with it.

        Parameters
        ----------
        theta : ndarray, shape (p,)
            Parameters of the fit.
        held : bool, optional
            Whether the delay stays.
        damping : float, optional
            Of all that is no base parameter, relative to how the log shows it.
        """
        base, free = self.problem.base.kept, np.ones(self.unknowns.count, dtype=bool)
        if held:
            free[len(self.unknowns.names) - 1] = False
        rest = self.problem.n_theta + np.flatnonzero(free)
        own, cross = self.H[np.ix_(rest, rest)], self.H[np.ix_(base, rest)]
        inverse = scaled_inverse(own + damping * np.diag(np.maximum(np.diag(own), UNSEEN)))
        S = self.H[np.ix_(base, base)] - cross @ inverse @ cross.T
        pull = self.g[base] - cross @ inverse @ self.g[rest]
        A = information_rows(S / self.variance)
        at = self.problem.base_of(theta)
        rhs = A @ at + np.linalg.pinv(A).T @ pull / self.variance
        program = replace(self.problem, A=frozen(A), rhs=frozen(rhs), floor=0.0)
        found, others = solve_sdp(program), np.zeros(len(free))
        others[free] = inverse @ (self.g[rest] - cross.T @ (found.base - at))
        return found, others

    def cost(self, theta: Array, squares: float) -> float:
        """Return a sum of squared errors in units of the variance, and what the prior adds."""
        prior = self.problem.prior
        return squares / self.variance + (
            0.0 if prior is None else sum(each.value(theta) for each in prior.terms)
        )

    def remaining(self, theta: Array, *, held: bool) -> float | None:
        """Return a bound on the share of the cost that any convex step could still take away.

        No links that satisfy the constraints, with any friction, delay and starts beside them,
        lower the quadratic about the fit by more: the dual of its semidefinite program says so.
        None where that was not solved.
        """
        found, _ = self.step(theta, held=held)
        if found.theta is None:
            return None
        gained = found.problem.cost_of(theta) - found.bound().value
        return max(gained / self.cost(theta, self.fit.cost), 0.0)

    def covariance(self, estimate: Estimate, held: bool) -> tuple[Array, Array]:
        """Return the covariance of the fit's numbers, and how they move with the delay.

        Parameters
        ----------
        estimate : Estimate
            Where the prior is taken.
        held : bool
            Whether the delay stays too.
        """
        problem, names = self.problem, list(self.unknowns.names)
        p, size = problem.n_theta, len(self.H)
        prior = prior_rows(estimate)
        R = np.hstack([prior, np.zeros((len(prior), size - p))])
        # What is at a bound stays.
        friction, links = problem.friction.parameters, 10 * problem.robot.n_links
        free = np.ones(size, dtype=bool)
        free[links:p] = theta_with(problem, estimate.some_theta, self.fit.drives)[links:] > 0.0
        delay = p + len(names) - 1
        if held:
            free[delay] = False
        M = self.H / self.variance + R.T @ R
        inverse = np.zeros((size, size))
        inverse[np.ix_(free, free)] = scaled_inverse(M[np.ix_(free, free)])
        # Blocks of the residuals' scores, and the prior's rows with a variance of one.
        blocks = len(self.scores)
        centered = self.scores - self.scores.mean(axis=0)
        shown = (centered.T @ centered) * blocks / max(blocks - 1, 1) / self.variance**2
        found = inverse @ (shown + R.T @ R) @ inverse
        moves = np.zeros(size)
        if held:
            moves = -inverse @ M[:, delay]
            moves[delay] = 1.0
        kinds = [f"{SYMBOLS[each.symbol]}{each.joint + 1}" for each in friction]
        places = {name: k for k, name in enumerate([*kinds, *names], links)}
        at = [places[name] for name in self.fit.unknowns.names]
        return found[np.ix_(at, at)], moves[at]


def with_links(estimate: Estimate, fit: PositionFit) -> tuple[Estimate, SolvedRollouts]:
    """Return better links, and rollouts with them to go on from, with drives and starts as suit.

    Where a convex step finds none, all is returned as it is.

    Parameters
    ----------
    estimate : Estimate
        The links, their constraints and prior.
    fit : PositionFit
        Of rollouts with these links.
    """
    problem = estimate.problem
    here = theta_with(problem, estimate.some_theta, fit.drives)
    normal = JointNormal.of(problem, fit)
    x, (low, high) = normal.unknowns.pack(fit.drives, fit.starts), normal.unknowns.bounds()
    for damping, share in product(_DAMPINGS, _SHARES):
        if share == _SHARES[0]:
            found, others = normal.step(here, damping=damping)
            if found.status == "optimal" and found.problem.cost_of(here) - found.cost < _NOTHING:
                break
        if found.status != "optimal":
            continue
        there = here + share * (found.some_theta - here)
        own = [each.log.rollout(links_of(problem, there)) for each in fit.rollouts]
        moved = np.clip(x + share * others, low, high)
        drives, starts = normal.unknowns.unpack(moved, fit.drives)
        trial = SolvedRollouts.of(own, drives_with(problem, there, drives), starts, fit)
        if normal.cost(there, trial.cost) < normal.cost(here, fit.cost):
            return Estimate.of_theta(problem, there, method="positions", status="given"), trial
    return estimate, fit
