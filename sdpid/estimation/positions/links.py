"""Links from positions: a convex step with all constraints, and what is known of all numbers.

Positions of rollouts change with the base parameters of links and drives, with the delay, with
friction over position and with where each motion starts. About a fit these changes are linear, so
that the sum of squares is a quadratic in all of them; what is no base parameter is eliminated. With
the prior and the constraints of the torque problem that is a semidefinite program again, whose
optimum is consistent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sdpid._common.arrays import Array, Mask, frozen
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.information import information_rows
from sdpid.estimation.positions.drives import LONGEST_DELAY, DriveNumbers
from sdpid.estimation.positions.fit import PositionFit, block_starts
from sdpid.estimation.positions.rollout import LawRollout
from sdpid.estimation.posterior import prior_rows
from sdpid.estimation.problem import Problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.dynamics import RobotDynamics

# Kinds of drives by the symbols of the problem's friction terms.
SYMBOLS = {"Ia": "armature", "Fv": "damping", "Fs": "friction"}

# Of its step the shares that are tried until the cost falls.
_SHARES = (1.0, 0.5, 0.25)


def links_of(problem: Problem, theta: Array) -> RobotDynamics:
    """Return the robot's links without friction."""
    terms = FrictionModel.from_terms((), problem.robot.joint_names)
    return RobotDynamics(
        robot=problem.robot, terms=terms, theta=theta[: 10 * problem.robot.n_links]
    )


@dataclass(frozen=True, eq=False)
class JointNormal:
    """Normal equations of base parameters and of all else about a fit.

    Attributes
    ----------
    problem : Problem
        Whose base parameters come first.
    names : tuple of str
        Of what comes behind them: kinds with the joint's number, and ``delay``; starts have none.
    H, g, scores : ndarray
        JᵀJ, Jᵀe and sums of Jᵀe over blocks of rows.
    variance : float
        Of one row, as few independent ones as residuals show.
    """

    problem: Problem
    names: tuple[str, ...]
    H: Array
    g: Array
    scores: Array
    variance: float

    @classmethod
    def of(cls, problem: Problem, rollouts: Sequence[LawRollout], fit: PositionFit) -> JointNormal:
        """Gather them at a fit."""
        base, unknowns, n = problem.base, fit.unknowns, problem.robot.n
        b = base.count
        place = {int(k): i for i, k in enumerate(base.kept)}
        more = [kind for kind in unknowns.rows if kind not in SYMBOLS.values()]
        names = [f"{kind}{j + 1}" for kind in more for j in range(n)]
        names += ["delay"] * unknowns.delay
        size = b + len(names) + 2 * n * len(rollouts)
        H, g, scores = np.zeros((size, size)), np.zeros(size), []
        own = {name: k for k, name in enumerate(base.theta_names)}
        for r, (rollout, start) in enumerate(zip(rollouts, fit.starts, strict=True)):
            motion = rollout.run(fit.drives, start)
            e = rollout.measured - rollout.positions(motion)
            starts = block_starts(rollout)
            score = np.zeros((len(starts), size))
            Y = problem.robot.regressor(
                motion.position[:-1], motion.velocity[:-1], motion.acceleration
            )
            kinds = (*SYMBOLS.values(), *more)
            blocks = rollout.columns(motion, fit.drives, kinds, unknowns.delay, Y)
            for joints, J in blocks:
                m = len(joints)
                # Where the columns of the tree go; −1 for those that are no base parameters.
                links = np.concatenate([np.arange(10 * j, 10 * j + 10) for j in joints])
                at = [place.get(int(own[f"{s}{j + 1}"]), -1) for s in SYMBOLS for j in joints]
                at += [b + k * n + j for k in range(len(more)) for j in joints]
                at += [b + len(names) - 1] * unknowns.delay
                first = b + len(names) + 2 * n * r
                at += [first + s * n + j for s in range(2) for j in joints]
                at += [place.get(int(k), -1) for k in links]
                index = np.array(at)
                used = np.flatnonzero(index >= 0)
                flat, index = J[:, :, used].reshape(-1, len(used)), index[used]
                H[np.ix_(index, index)] += flat.T @ flat
                moved = np.einsum("tik,ti->tk", J[:, :, used], e[:, joints])
                score[:, index] += np.add.reduceat(moved, starts, axis=0)
                assert len(links) == 10 * m
            g += score.sum(axis=0)
            scores.append(score)
        every = np.concatenate(scores)
        white = fit.cost / sum(each.measured.size for each in rollouts)
        seen = np.diag(H) > 1e-12 * np.diag(H).max()
        spread = np.sum((every - every.mean(axis=0)) ** 2, axis=0)[seen] / np.diag(H)[seen]
        variance = max(float(np.median(spread)), white)
        return cls(problem, tuple(names), H, g, every, variance)

    def step(self, theta: Array) -> tuple[Estimate, Array]:
        """Return the optimum of the convex program about theta, and how all else moves with it."""
        b = self.problem.base.count
        H, g = self.H, self.g
        others = np.linalg.pinv(_scaled(H[b:, b:])[0], hermitian=True)
        scale = _scaled(H[b:, b:])[1]
        inverse = others * scale * scale[:, None]
        S = H[:b, :b] - H[:b, b:] @ inverse @ H[b:, :b]
        pull = g[:b] - H[:b, b:] @ inverse @ g[b:]
        A = information_rows(S / self.variance)
        at = self.problem.base_of(theta)
        rhs = A @ at + np.linalg.pinv(A).T @ pull / self.variance
        program = replace(self.problem, A=frozen(A), rhs=frozen(rhs), floor=0.0)
        found = solve_sdp(program)
        moved = found.base - at
        return found, inverse @ (g[b:] - H[b:, :b] @ moved)

    def moved(self, fit: PositionFit, step: Array) -> tuple[DriveNumbers, list[Array]]:
        """Return the drives and starts of a fit after a step of all that is no base parameter."""
        n, drives, k = self.problem.robot.n, fit.drives, 0
        for kind in fit.unknowns.rows:
            if kind not in SYMBOLS.values():
                drives = drives.with_rows(**{kind: drives[kind] + step[k : k + n]})
                k += n
        if fit.unknowns.delay:
            delay = float(np.clip(drives.delay + step[k], 0.0, LONGEST_DELAY))
            drives, k = replace(drives, delay=delay), k + 1
        starts = [
            each + step[k + 2 * n * r : k + 2 * n * (r + 1)].reshape(2, n)
            for r, each in enumerate(fit.starts)
        ]
        return drives, starts

    def covariance(self, estimate: Estimate, closed: Mask, held: bool) -> tuple[Array, Array]:
        """Return the covariance of theta and all else, and how these move with the delay.

        Parameters
        ----------
        estimate : Estimate
            Where the prior is taken.
        closed : ndarray of bool, shape (p,)
            Parameters that are at a bound, and stay.
        held : bool
            Whether the delay stays too.
        """
        p, b = self.problem.n_theta, self.problem.base.count
        size, q = p + len(self.H) - b, len(self.names)
        T = np.zeros((len(self.H), size))
        T[:b, :p], T[b:, p:] = self.problem.base.matrix, np.eye(len(self.H) - b)
        R = np.zeros((0, size))
        if (prior := prior_rows(estimate)).size:
            R = np.hstack([prior, np.zeros((len(prior), size - p))])
        free = np.append(~closed, np.ones(size - p, dtype=bool))
        delay = p + q - 1
        if held:
            free[delay] = False
        M = T.T @ self.H @ T / self.variance + R.T @ R
        scaled, scale = _scaled(M[np.ix_(free, free)])
        inverse = np.zeros((size, size))
        inverse[np.ix_(free, free)] = (
            np.linalg.pinv(scaled, hermitian=True) * scale * scale[:, None]
        )
        # Blocks of the residuals' scores, and the prior's rows with a variance of one.
        blocks = len(self.scores)
        centered = self.scores - self.scores.mean(axis=0)
        shown = (centered.T @ centered) * blocks / max(blocks - 1, 1) / self.variance**2
        found = inverse @ (T.T @ shown @ T + R.T @ R) @ inverse
        moves = -inverse @ M[:, delay] if held else np.zeros(size)
        if held:
            moves[delay] = 1.0
        return found[: p + q, : p + q], moves[: p + q]


def _scaled(H: Array) -> tuple[Array, Array]:
    """Return a matrix with a diagonal of ones, and what it was scaled by."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(H), 1e-12 * max(float(np.diag(H).max()), 1e-300)))
    return H * scale * scale[:, None], scale


def with_links(
    problem: Problem, theta: Array, rollouts: Sequence[LawRollout], fit: PositionFit
) -> tuple[Estimate, list[LawRollout], DriveNumbers, list[Array]] | None:
    """Return better links, rollouts with them, and drives and starts to go on from, if there are.

    Parameters
    ----------
    problem : Problem
        With constraints and prior.
    theta : ndarray, shape (p,)
        Where the fit has its links.
    rollouts : sequence of LawRollout
        With these links.
    fit : PositionFit
        Their fit.
    """
    links = 10 * problem.robot.n_links
    here = np.array(theta)
    for k, parameter in enumerate(problem.friction.parameters):
        kind = SYMBOLS[parameter.name.rstrip("0123456789")]
        here[links + k] = fit.drives[kind][parameter.joint]
    normal = JointNormal.of(problem, rollouts, fit)
    found, others = normal.step(here)
    if found.theta is None or found.status != "optimal":
        return None
    before = fit.cost / normal.variance + _belief(problem, here)
    for share in _SHARES:
        there = here + share * (found.theta - here)
        own = [each.with_links(links_of(problem, there)) for each in rollouts]
        drives, starts = normal.moved(fit, share * others)
        for k, parameter in enumerate(problem.friction.parameters):
            kind = SYMBOLS[parameter.name.rstrip("0123456789")]
            row = drives[kind].copy()
            row[parameter.joint] = max(there[links + k], 0.0)
            drives = drives.with_rows(**{kind: row})
        cost = 0.0
        for each, start in zip(own, starts, strict=True):
            motion = each.run(drives, start)
            missed = each.measured - each.positions(motion)
            cost += float(np.sum(missed**2)) if motion.converged else np.inf
        if cost / normal.variance + _belief(problem, there) < before:
            found = Estimate.of_theta(problem, there, method="positions", status="given")
            return found, own, drives, starts
    return None


def _belief(problem: Problem, theta: Array) -> float:
    """Return what a prior says of parameters."""
    return 0.0 if problem.prior is None else sum(t.value(theta) for t in problem.prior.terms)
