"""One loop for all estimates from simulated motions: simulate, make rows, solve, settle.

What differs is what rows are made of: columns that the simulated motion instruments, its regressor
with the measured efforts, or the sensitivities of its positions.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from sdpid._common.arrays import Array, Mask, frozen
from sdpid.estimation.closed_loop.instruments import FirstStage, MotionSource, of_rows, weighed
from sdpid.estimation.closed_loop.loop import ClosedLoop
from sdpid.estimation.compression.covariance import JointRows, correlation_time
from sdpid.estimation.compression.factor import Factor
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.estimate import Estimate, Status, Step
from sdpid.estimation.information import require_excitation
from sdpid.estimation.problem import Problem
from sdpid.experiment.simulation.closed_loop import Motion
from sdpid.robot.model.dynamics import RobotDynamics

Solver = Callable[[Problem], Estimate]

_TINY = np.finfo(float).tiny

# Rounds of instruments that settle change a third as much each time, and less; where the change
# does not fall to this part of the last, the next model is half-way.
_FALLING = 0.7

# After so many rounds without a smaller change there is no use in going on.
_PATIENCE = 3

# Halvings of a step that does not lower the cost; what is left of it is then below 1 %.
_HALVINGS = 7

# A step that promises to lower the cost by less than this share of it is none.
_SETTLED = 1e-6

# The joints' variances have settled when none changes by more than this share: with others the
# cost is another, and iterations go on.
_REWEIGHTED = 0.2

# What the cost of output error is, for all that show it.
MEANING = "the last linearized problem, and no more"

# Least variance of a joint's positions, as a share of the largest: simulated logs without noise
# would otherwise weigh one joint by rounding.
_LEAST = 1e-6

# Rounds in which the joints' variances settle.
_ROUNDS = 5


@dataclass(frozen=True)
class SensitivityRows(RowSource):
    """Rows ``[S | S·β_0 + q − q_s(β_0)]`` of positions about parameters β_0.

    S is the derivative of the simulated positions q_s by the base parameters, and the last column
    takes the place of the efforts: its residual is that of the linearized simulation.

    Attributes
    ----------
    samples : Samples
        As measured; rows that efforts are masked at count all the same.
    slopes : ndarray, shape (K, n, b)
        S.
    target : ndarray, shape (K, n)
        The last column, rad (m).
    """

    slopes: Array
    target: Array

    def pieces(self) -> Iterator[SensitivityRows]:
        """Yield the rows of each piece of the samples."""
        for part, own in zip(self.samples.parts, self.samples.pieces, strict=True):
            yield replace(self, samples=own, slopes=self.slopes[part], target=self.target[part])

    def rows(self, part: slice) -> Array:
        """Return the derivative with the target as last column; as `RowSource.rows`."""
        return np.concatenate([self.slopes[part], self.target[part][:, :, None]], axis=2)

    def mask(self, part: slice) -> Mask:
        """Return which rows are used: all, for reversals spoil efforts, not positions."""
        return np.ones(self.target[part].shape, dtype=bool)

    @property
    def hashed(self) -> tuple[Array, ...]:
        """What the rows are made of beside the samples, for their digest."""
        return self.slopes, self.target


def position_covariance(rows: SensitivityRows) -> Array:
    """Estimate a diagonal covariance (n, n) of positions from residuals of the linear fit.

    As for efforts, one variance a joint, times the number of samples that make an independent one.
    """
    joints = JointRows.merged(rows.map(JointRows.of))
    variance = np.ones(rows.robot.n)
    base = np.zeros(rows.base.count)
    for _ in range(_ROUNDS):
        base, rank = joints.fit(variance)
        found = joints.residual_variance(base, rank)
        variance = np.maximum(found, max(_LEAST * float(found.max()), _TINY))
    return np.diag(variance * correlation_time(rows, base, joints))


def iterate(rounds: InstrumentRounds | DidimRounds, solver: Solver, max_iterations: int) -> Status:
    """Solve the problem of the motion simulated last, again and again until it has settled."""
    for _ in range(max_iterations):
        linear = rounds.linear()
        if linear.prior is None:
            require_excitation(linear.excitation)
        if (status := rounds.settle(linear, solver(linear))) is not None:
            return status
    return "iteration limit"


class InstrumentRounds:
    """Two-stage least squares with the motion simulated last as instrument.

    Attributes
    ----------
    first : FirstStage
        The last instruments.
    found : Estimate
        With them.
    iterations : int
        Of the solver, all in all.
    changes : list of float
        How much predicted efforts changed, as a share of the (whitened) residuals.
    """

    first: FirstStage
    found: Estimate

    def __init__(self, source: MotionSource, model: RobotDynamics | None, tolerance: float) -> None:
        self.source, self.model, self.tolerance, self.iterations = source, model, tolerance, 0
        self.changes: list[float] = []
        # Without a model there is but one round, and a model of other terms has other parameters.
        problem = source.problem
        self._base = np.zeros(problem.base.count)
        if model is not None and model.theta.size == problem.n_theta:
            self._base = problem.base_of(model.theta)

    def linear(self) -> Problem:
        """Return the second stage of the instruments that the model makes."""
        self.first = self.source.first_stage(self.model)
        meaning = f"the problem of the last instruments ({self.source.words}), no more"
        return self.first.second_stage(meaning)

    def settle(self, linear: Problem, found: Estimate) -> Status | None:
        """Look how much predicted efforts change, and choose the next model."""
        self.found, self.iterations = found, self.iterations + found.iterations
        moved, changes = linear.A @ (found.base - self._base), self.changes
        changes.append(float(np.sqrt(moved @ moved / max(linear.cost(found.base), _TINY))))
        if self.source.loop is None or changes[-1] <= self.tolerance:
            return "optimal"
        if len(changes) > _PATIENCE and min(changes[-_PATIENCE:]) > changes[-_PATIENCE - 1]:
            return "stalled"
        before, self.model, self._base = self.model, found.model(), found.base
        slow = len(changes) > 1 and changes[-1] > _FALLING * changes[-2]
        if slow and before is not None and before.theta.shape == self.model.theta.shape:
            # Consistent parameters are convex: between two models there are only models.
            self.model = replace(self.model, theta=0.5 * (before.theta + self.model.theta))
        return None


class DidimRounds:
    """Least squares for the measured efforts with the regressor of the motion simulated last.

    Feedback keeps the simulated motion near the commanded one whatever the parameters are. So its
    regressor hardly depends on them, and holds no noise of the encoders.

    Attributes
    ----------
    at : Estimate
        Where the next round begins.
    motions : list of Motion
        Simulated last.
    simulations : int
        How often all recordings were simulated.
    """

    method = "didim"

    def __init__(
        self,
        problem: Problem,
        loop: ClosedLoop,
        start: Estimate,
        motions: list[Motion],
        tolerance: float,
    ) -> None:
        self.problem, self.loop, self.tolerance = problem, loop, tolerance
        self.at, self.motions, self.simulations = start, motions, 1
        self.rows = problem.require_rows_here(loop.purpose)
        self._begin = time.perf_counter()
        # Each round, the variances of its own if it had any, and the squares that they weigh.
        self._steps: list[tuple[Step, Array, Array]] = []

    def linear(self) -> Problem:
        """Return the problem of the simulated motion and the measured efforts."""
        rows = replace(self.rows, samples=self.loop.samples(self.motions))
        if self.problem.weighting != "residual":
            return of_rows(self.problem, rows, Factor.of(rows, self.problem.weighting), MEANING)
        self._joints = JointRows.merged(rows.map(JointRows.of))
        return of_rows(self.problem, rows, Factor.of_joints(rows, self._joints), MEANING)

    def settle(self, linear: Problem, found: Estimate) -> Status | None:
        """Simulate what was found."""
        drop = _cost_in(linear, self.at) - found.cost
        self.at = found
        variances, squares = np.ones(1), np.zeros(1)
        if self.problem.weighting == "residual":
            variances = np.diag(linear.sigma)
            squares = self._joints.squared_residuals(found.base)
        self.record(found.cost, variances, squares)
        self.motions = self.loop.require(found.model(), f"iteration {len(self._steps)}")
        self.simulations += 1
        return "optimal" if drop <= self.tolerance * max(found.cost, _TINY) else None

    def record(self, cost: float, variances: Array, squares: Array) -> None:
        """Add a round to the history: its cost, and the squares (n,) that its variances weigh."""
        step = Step(time.perf_counter() - self._begin, cost, self.at.violation or 0.0)
        self._steps.append((step, variances, squares))

    @property
    def history(self) -> tuple[Step, ...]:
        """The rounds, all costs under the variances of the last one.

        Variances are estimated from the residuals of each round, so that its own cost is about the
        number of samples, whatever the residuals are.
        """
        last = self._steps[-1][1]
        return tuple(
            replace(step, cost=step.cost + float(np.sum(squares * (1.0 / last - 1.0 / own))))
            for step, own, squares in self._steps
        )


class SensitivityRounds(DidimRounds):
    """Gauss-Newton on the squares of the differences of measured and simulated positions.

    A step is the solution of the linearized problem under all constraints, and is halved until the
    simulated motion itself is nearer: with the same variances the cost never rises.
    """

    method = "closed_loop_output_error"
    _sigma: Array | None = None

    def linear(self) -> Problem:
        """Return the problem linearized where the round begins; variances are those settled on."""
        rows, at = self.rows, self.at
        slopes = self.loop.slopes(at.model(), rows.base, self.motions)
        target = self.loop.missed(self.motions) + slopes @ at.base
        source = SensitivityRows(
            rows.robot, rows.friction, rows.base, rows.samples, frozen(slopes), frozen(target)
        )
        self._fresh = position_covariance(source)
        if self._sigma is None:
            self._sigma = self._fresh
        return of_rows(self.problem, source, weighed(source, self._sigma), MEANING)

    def settle(self, linear: Problem, found: Estimate) -> Status | None:
        """Take the step that the linearized problem promises, as far as it holds."""
        # Until a step is taken, the parameters of before are those of the new problem too.
        start = self.at = replace(self.at, problem=linear, multipliers=None)
        before = now = self._cost(linear, start, self.motions)
        promised = before - found.cost
        halvings = range(_HALVINGS + 1)
        if promised <= _SETTLED * before:
            self.at, halvings = found, range(0)
            now = self._cost(linear, found, self.motions)
        for halving in halvings:
            candidate = found if not halving else _between(start, found, 0.5**halving)
            motions = self.loop.follow(candidate.model())
            self.simulations += 1
            if motions[-1].diverged is not None:
                continue
            cost = self._cost(linear, candidate, motions)
            if cost < before:
                self.at, self.motions, now = candidate, motions, cost
                break
        variances = np.diag(linear.sigma)
        self.record(now, variances, np.sum(self.loop.missed(self.motions) ** 2, axis=0))
        if before - now > self.tolerance * before:
            return None
        settled = promised <= self.tolerance * before
        changed = np.abs(np.diag(self._fresh) / variances - 1.0).max()
        if changed <= _REWEIGHTED or not settled:
            return "optimal" if settled else "stalled"
        self._sigma = self._fresh
        return None

    def _cost(self, linear: Problem, at: Estimate, motions: list[Motion]) -> float:
        """Return the true cost of an estimate with its motions."""
        data = float(np.sum(self.loop.missed(motions) ** 2 / np.diag(linear.sigma)))
        return data + _cost_in(linear, at) - linear.cost(at.base)


def _cost_in(problem: Problem, estimate: Estimate) -> float:
    """Return what an estimate costs in another problem, the prior's part included."""
    return replace(estimate, problem=problem).cost


def _between(estimate: Estimate, towards: Estimate, share: float) -> Estimate:
    """Return the parameters some way from one estimate to another; between two feasible ones."""
    base = estimate.base + share * (towards.base - estimate.base)
    theta = towards.theta
    if theta is not None:
        theta = estimate.some_theta + share * (theta - estimate.some_theta)
        base = towards.problem.base_of(theta)
    return replace(towards, theta=theta, base=base, multipliers=None)
