"""The global optimum, as a semidefinite program."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid._common.threads import one_thread
from sdpid.errors import InfeasibleError, SolverError
from sdpid.estimation.conic.solve import ConicSolution, solve_conic
from sdpid.estimation.coordinates import Coordinates
from sdpid.estimation.duality.bound import PROVEN, Bound, best_of, relative_gap
from sdpid.estimation.estimate import FEASIBLE, Estimate
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling
from sdpid.estimation.sdp.infeasibility import explained, require_consistent
from sdpid.estimation.sdp.nearest_to_prior import repair, settled
from sdpid.estimation.sdp.program import SdpProgram
from sdpid.estimation.wls import solve_wls

# How the program is solved, tried in turn until the gap is proven small: Clarabel's regularization;
# whether it is measured from what was found before, links in units of theirs, or else from the
# links of the robot's description; and a weight of ‖x‖² beside a cost of order one (measured from
# what was found, what it costs vanishes from one attempt to the next). Without the second or the
# last, small problems stay unproven (tests/estimation/test_sdp.py); without the third or the
# fourth, some robots of example-robot-data with weak data (examples/evidence/every_robot.py:
# Baxter, Centauro, iCub).
_ATTEMPTS = (
    # Most problems.
    (1e-10, False, 0.0),
    # An optimal face that only theta_max bounds: the weight keeps the path from running off.
    (1e-10, True, 1e-13),
    # Precise data of many links, whose cost is steep.
    (1e-12, False, 0.0),
    # A weight that costs more than the gap allows.
    (1e-10, True, 0.0),
    # 6×6 inequalities, whose ten parameters spread over 21 entries, so that no less will do.
    (1e-8, True, 1e-13),
    # Problems of many links come nearer from attempt to attempt, and heavier weights make steps
    # shorter (the B1 of example-robot-data ends at 1.1e-6 without them).
    (1e-10, True, 1e-13),
    (1e-10, True, 0.0),
    (1e-8, True, 1e-13),
    (1e-10, True, 1e-12),
    (1e-10, True, 1e-10),
)

# Where the gap is no larger, further multipliers are refined as far as they go: that takes less
# time than another attempt, and attempts may end in the same point again and again (the TX40
# without a prior, at 1.1e-6, as some processors round).
_NEARLY = 1e-5


@one_thread
def solve_sdp(problem: Problem, *, verbose: bool = False) -> Estimate:
    """Minimize the cost over all consistent parameters: the global optimum.

    The parameters are measured from the robot's description, in units in which they are of order
    one, and what a solver makes of them is recomputed: it is moved inside every constraint, and
    its multipliers are turned into a bound, which is kept for `sdpid.certify`. Attempts go on
    until bound and cost are within 1e-6 of each other (docs/theory, section 9). Of all optimal
    parameters, which differ in directions that the effort does not show, those nearest to the
    robot's description are returned (see `sdpid.estimation.sdp.nearest_to_prior`).

    Parameters
    ----------
    problem : Problem
        The problem.
    verbose : bool, optional
        Let the solver print.

    Returns
    -------
    Estimate
        With status ``"optimal"``.

    Raises
    ------
    InfeasibleError
        When no parameters satisfy the constraints.
    SolverError
        When the solver ends without an optimum; the last point found is attached.

    Examples
    --------
    >>> estimate = sdpid.solve_sdp(problem)
    >>> estimate.status, estimate.feasible
    ('optimal', True)
    >>> estimate.theta.shape, estimate.base.shape
    ((72,), (48,))
    >>> round(estimate.named()["Fv1"])
    151
    """
    found, bound = proven_optimum(problem, verbose=verbose)
    return settled(found, bound.value)


def proven_optimum(problem: Problem, *, verbose: bool = False) -> tuple[Estimate, Bound]:
    """Return an optimum, any point of the optimal face, and its proof; see `solve_sdp`."""
    try:
        problem.feasible.require_feasible()
    except InfeasibleError as error:
        error.problem = problem
        raise
    scaling = Scaling.of(problem)
    start = scaling, _described(problem, scaling)
    search = Attempts(problem, start, problem.feasible.bounded, verbose)
    for regularization, warm_started, weight in _ATTEMPTS:
        search.try_once(regularization, warm_started, weight)
        if search.proven:
            break
    return search.result()


def solved_or_found(
    problem: Problem, solver: Callable[[Problem], Estimate] = solve_sdp
) -> Estimate:
    """Return a solver's estimate, or the feasible one that it found where it proves no optimum."""
    try:
        return solver(problem)
    except SolverError as error:
        if not isinstance(error.found, Estimate) or not error.found.feasible:
            raise
        return error.found


@dataclass(eq=False)
class Attempts:
    """What the attempts have found so far, and where the next one begins.

    Attributes
    ----------
    problem : Problem
        The problem.
    start : (Scaling, ndarray)
        Units and where attempts are measured from that do not begin where the last one ended.
    bounds_included : ndarray of bool, shape (p,)
        Parameters whose bounds the solver is given.
    verbose : bool
        Whether the solver prints.
    seconds, iterations, status
        Of the solver, over all attempts; the status is the last one's.
    found : (Estimate, Bound) or None
        The cheapest feasible point, and the strongest proof, which may come from another attempt.
    """

    problem: Problem
    start: tuple[Scaling, Array]
    bounds_included: Mask
    verbose: bool = False
    seconds: float = 0.0
    iterations: int = 0
    status: str = ""
    found: tuple[Estimate, Bound] | None = None

    @property
    def gap(self) -> float:
        """Gap between the point and the proof."""
        if self.found is None:
            return np.inf
        return relative_gap(self.problem, self.found[0].cost, self.found[1].value)

    @property
    def proven(self) -> bool:
        """Whether what was found is an optimum."""
        return self.found is not None and self.gap <= PROVEN and self.found[0].feasible

    def try_once(self, regularization: float, warm_started: bool, weight: float) -> None:
        """Solve once, and keep what is better than before."""
        scaling, center = self.start
        if warm_started and self.found is not None:
            center = np.array(self.found[0].theta)
            scaling = scaling.around(center)
        coordinates = Coordinates.of(self.problem, scaling.basis(), center)
        if coordinates is None:
            raise explained(self.problem)
        program = SdpProgram.build(
            self.problem, scaling, coordinates, self.bounds_included, proximal_weight=weight
        )
        solution = solve_conic(program.conic, regularization=regularization, verbose=self.verbose)
        self.take(program, solution)

    def take(self, program: SdpProgram, solution: ConicSolution) -> None:
        """Keep what is better than before in a solution of a program of the problem."""
        problem = self.problem
        self.status = f"clarabel: {solution.status}"
        self.seconds += solution.seconds
        self.iterations += solution.iterations
        # Primal or dual; a numerical error leaves the last point: it is judged by what is
        # recomputed, and the next attempt begins there.
        if solution.x is None or "Infeasible" in solution.status:
            if problem.constraints.others and "PrimalInfeasible" in solution.status:
                require_consistent(problem)
            # Where constraints hold together, Clarabel is wrong that they do not.
            return
        theta = program.theta(solution)
        outside = (theta < problem.feasible.lower) | (theta > problem.feasible.upper)
        if np.any(outside & ~self.bounds_included):
            # theta_max matters after all: give the solver the bounds that it overstepped.
            self.bounds_included = self.bounds_included | outside
            return
        theta = repair(problem, theta)
        if not np.isfinite(problem.cost_of(theta)):
            # Outside of what a log-det prior is defined for: where solvers end that find nothing.
            return
        estimate = Estimate.of_theta(
            problem,
            theta,
            method="sdp",
            status="optimal",
            message=self.status,
            multipliers=program.multipliers(solution, theta),
        )
        bound = estimate.bound(exhaustive=PROVEN < self.gap < _NEARLY)
        best, proof = (estimate, bound) if self.found is None else self.found
        # Feasible where the other is not, or cheaper where both or none are.
        best = min(best, estimate, key=lambda each: (not each.feasible, each.cost))
        self.found = best, best_of(proof, bound)
        if not self.proven:
            # From now on count the cost in units of itself.
            scaling, center = self.start
            self.start = replace(scaling, cost=max(scaling.cost, best.cost)), center

    def result(self) -> tuple[Estimate, Bound]:
        """Return the optimum and its proof.

        Raises
        ------
        SolverError
            When what was found is none; InfeasibleError when the constraints are to blame.
        """
        best, said = None, "nothing"
        if self.found is not None:
            best, bound = self.found
            if self.gap > PROVEN:
                bound = best_of(bound, best.bound(exhaustive=True))
            best = replace(
                best,
                multipliers=bound.multipliers,
                iterations=self.iterations,
                solve_time=self.seconds,
            )
            self.found = best, bound
            if self.proven:
                return self.found
            said = f"a relative gap of {self.gap:.1e} and a violation of {best.violation:.1e}"
        if self.problem.constraints.others:
            require_consistent(self.problem)
        raise SolverError(
            f"SDP of '{self.problem.robot.name}': ended '{self.status}' with {said} "
            f"(limits {PROVEN:.0e} and {FEASIBLE:.0e}); check the excitation "
            "(problem.excitation) and the margin, or give a prior or tighter bounds, such as "
            "Constraints.of_size(robot).",
            problem=self.problem,
            found=best,
        )


def _described(problem: Problem, scaling: Scaling) -> Array:
    """Return the links that the scaling is about, with the friction that fits best."""
    basis, matrix, target = scaling.basis(), problem.squared.matrix, problem.squared.rhs
    if problem.prior is None:
        matrix, target = problem.base.matrix, solve_wls(problem).base
    fit = basis @ np.linalg.lstsq(matrix @ basis, target, rcond=None)[0]
    return np.concatenate([scaling.bodies.ravel(), fit[scaling.bodies.size :]])
