"""The global optimum, as a semidefinite program."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sdpid._common.arrays import Array, Mask, frozen
from sdpid._common.threads import one_thread
from sdpid.errors import InfeasibleError, SolverError
from sdpid.estimation.conic.solve import ConicSolution, solve_conic
from sdpid.estimation.coordinates import Coordinates
from sdpid.estimation.duality.bound import PROVEN, Bound, cost_scale, relative_gap
from sdpid.estimation.duality.refine_multipliers import lower_bound
from sdpid.estimation.estimate import FEASIBLE, Estimate
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling
from sdpid.estimation.sdp.infeasibility import explained, require_consistent
from sdpid.estimation.sdp.nearest_to_prior import distance_to_reference, nearer_on_face
from sdpid.estimation.sdp.program import SdpProgram
from sdpid.estimation.sdp.repair import repair
from sdpid.estimation.wls import solve_wls

# Choosing among the optimal points may cost this share of the cost.
_FACE = 1e-7

# The nearest point is sought again from the last one as long as that is nearer by this share: far
# from the description the units of an attempt are not those of the nearest point (UR10 without a
# prior: 278 at first, then 244 and no less).
_GAINS = 0.01
_PASSES = 5

# Statuses that come without a point, and those of them that say that there is none. A numerical
# error leaves the last point: it is judged by what is recomputed, and the next attempt begins
# there.
_INFEASIBLE = ("PrimalInfeasible", "AlmostPrimalInfeasible")
_NO_POINT = (*_INFEASIBLE, "DualInfeasible", "AlmostDualInfeasible")


@dataclass(frozen=True)
class _Attempt:
    """How one attempt to solve the program is made.

    Attributes
    ----------
    reason : str
        Which problems need it.
    regularization : float
        What Clarabel adds to the diagonal of its linear systems.
    warm_started : bool
        Whether it is measured from what was found before, links in units of theirs; otherwise
        from the links of the robot's description.
    proximal_weight : float
        Weight of ‖x‖² beside a cost of order one. In warm-started attempts what it costs vanishes
        from one to the next.
    """

    reason: str
    regularization: float
    warm_started: bool = False
    proximal_weight: float = 0.0


# Tried in turn until the gap is proven small. Without the second or the last, small problems stay
# unproven (tests/estimation/test_sdp.py); without the third or the fourth, some robots of
# example-robot-data with weak data (examples/studies/every_robot.py: Baxter, Centauro, iCub).
_ATTEMPTS = (
    _Attempt("most problems", 1e-10),
    _Attempt(
        "an optimal face that only theta_max bounds: the weight keeps the path from running off",
        1e-10,
        warm_started=True,
        proximal_weight=1e-13,
    ),
    _Attempt("precise data of many links, whose cost is steep", 1e-12),
    _Attempt("a weight that costs more than the gap allows", 1e-10, warm_started=True),
    _Attempt(
        "6×6 inequalities, whose ten parameters spread over 21 entries, so that no less will do",
        1e-8,
        warm_started=True,
        proximal_weight=1e-13,
    ),
)

# Problems of many links come nearer from attempt to attempt, and heavier weights make steps shorter
# (the B1 of example-robot-data ends at 1.1e-6 without them).
_AGAIN = (
    *(attempt for attempt in _ATTEMPTS if attempt.warm_started),
    *(replace(_ATTEMPTS[1], proximal_weight=weight) for weight in (1e-12, 1e-10)),
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
    try:
        problem.feasible.require_feasible()
    except InfeasibleError as error:
        error.problem = problem
        raise
    scaling = Scaling.of(problem)
    start = scaling, _described(problem, scaling)
    search = Search(problem, verbose, (start, start), problem.feasible.bounded)
    for attempt in (*_ATTEMPTS, *_AGAIN):
        search.try_once(attempt)
        if search.proven:
            break
    found, bound = search.result()
    return settled(found, bound.value)


@dataclass(eq=False)
class Search:
    """What the attempts have found so far, and where the next one begins.

    Attributes
    ----------
    problem : Problem
        The problem.
    verbose : bool
        Whether the solver prints.
    starts : pair of (Scaling, ndarray)
        Units and where attempts are measured from: by the description's links, and by those found
        last.
    bounds_included : ndarray of bool, shape (p,)
        Parameters whose bounds the solver is given.
    seconds, iterations, status
        Of the solver, over all attempts; the status is the last one's.
    found : (Estimate, Bound) or None
        The cheapest feasible point, and the strongest proof, which may come from another attempt.
    """

    problem: Problem
    verbose: bool
    starts: tuple[tuple[Scaling, Array], tuple[Scaling, Array]]
    bounds_included: Mask
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
        if self.found is None:
            return False
        return self.gap <= PROVEN and (self.found[0].violation or 0.0) <= FEASIBLE

    def try_once(self, attempt: _Attempt) -> None:
        """Solve once, and keep what is better than before."""
        scaling, center = self.starts[attempt.warm_started]
        coordinates = Coordinates.of(self.problem, scaling.basis(), center)
        if coordinates is None:
            raise explained(self.problem)
        program = SdpProgram.build(
            self.problem,
            scaling,
            coordinates,
            self.bounds_included,
            proximal_weight=attempt.proximal_weight,
        )
        solution = solve_conic(
            program.conic, regularization=attempt.regularization, verbose=self.verbose
        )
        self.take(program, solution)

    def take(self, program: SdpProgram, solution: ConicSolution) -> None:
        """Keep what is better than before in a solution of a program of the problem."""
        problem = self.problem
        self.status = f"clarabel: {solution.status}"
        self.seconds += solution.seconds
        self.iterations += solution.iterations
        if solution.x is None or solution.status in _NO_POINT:
            if problem.constraints.others and solution.status in _INFEASIBLE:
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
        self._keep(
            Estimate.of_theta(
                problem,
                theta,
                method="sdp",
                status="optimal",
                message=self.status,
                iterations=self.iterations,
                solve_time=self.seconds,
                multipliers=program.multipliers(solution, theta),
            )
        )

    def _keep(self, estimate: Estimate) -> None:
        """Keep a point, its proof, or both, and begin from there next time."""
        bound = self._bound(estimate, exhaustive=PROVEN < self.gap < _NEARLY)
        best, proof = (estimate, bound) if self.found is None else self.found
        best = estimate if _better(estimate, best) else best
        self.found = best, max(proof, bound, key=lambda each: each.value)
        if self.proven:
            return
        # From now on count the cost in units of itself.
        scaling, center = self.starts[0]
        scaling = replace(scaling, cost=max(scaling.cost, best.cost))
        found = np.array(best.theta)
        self.starts = (scaling, center), (scaling.around(found), found)

    def _bound(self, estimate: Estimate, *, exhaustive: bool) -> Bound:
        """Return the bound that an estimate's multipliers prove."""
        theta, cost = np.array(estimate.theta), estimate.cost
        return lower_bound(self.problem, theta, estimate.proof, cost, exhaustive=exhaustive)

    def result(self) -> tuple[Estimate, Bound]:
        """Return the optimum and its proof.

        Raises
        ------
        SolverError
            When what was found is none; InfeasibleError when the constraints are to blame.
        """
        best, found = None, "nothing"
        if self.found is not None:
            best, bound = self.found
            if self.gap > PROVEN:
                refined = self._bound(best, exhaustive=True)
                bound = max(bound, refined, key=lambda each: each.value)
            multipliers, seconds = bound.multipliers, self.seconds
            best = replace(
                best, multipliers=multipliers, iterations=self.iterations, solve_time=seconds
            )
            self.found = best, bound
            if self.proven:
                return self.found
            found = f"a relative gap of {self.gap:.1e} and a violation of {best.violation:.1e}"
        if self.problem.constraints.others:
            require_consistent(self.problem)
        raise SolverError(
            f"SDP of '{self.problem.robot.name}': ended '{self.status}' with {found} "
            f"(limits {PROVEN:.0e} and {FEASIBLE:.0e}); check the excitation "
            "(problem.excitation) and the margin, or give a prior or tighter bounds, such as "
            "Constraints.of_size(robot).",
            problem=self.problem,
            found=best,
        )


def _better(first: Estimate, second: Estimate) -> bool:
    """Whether the first is feasible and the second not, or cheaper where both or none are."""
    return (not first.feasible, first.cost) < (not second.feasible, second.cost)


def _described(problem: Problem, scaling: Scaling) -> Array:
    """Return the links that the scaling is about, with the friction that fits best."""
    basis, matrix, target = scaling.basis(), problem.squared.matrix, problem.squared.rhs
    if problem.prior is None:
        matrix, target = problem.base.matrix, solve_wls(problem).base
    fit = basis @ np.linalg.lstsq(matrix @ basis, target, rcond=None)[0]
    return np.concatenate([scaling.bodies.ravel(), fit[scaling.bodies.size :]])


def settled(estimate: Estimate, bound: float) -> Estimate:
    """Move along the directions that cost nothing, to the point nearest to the description.

    What is found is kept only where it costs no more than the solver's own accuracy, and where
    the bound proves it too.
    """
    problem = estimate.problem
    if problem.consistency == "none" or problem.prior is not None or estimate.theta is None:
        # Without matrix inequalities nothing says what is near; with a prior nothing is free.
        return estimate
    allowed = estimate.cost + _FACE * max(estimate.cost, cost_scale(problem))
    nearest, far, seconds = estimate, np.inf, estimate.solve_time
    message = f"{estimate.message}; any point of the optimal face"
    for _ in range(_PASSES):
        found = None
        for point, spent in nearer_on_face(problem, np.array(nearest.theta)):
            seconds += spent
            if point is None:
                continue
            theta = repair(problem, point)
            moved = replace(estimate, theta=frozen(theta), base=frozen(problem.base_of(theta)))
            proven = relative_gap(problem, moved.cost, bound) <= PROVEN
            if moved.feasible and moved.cost <= allowed and proven:
                found, distance = moved, distance_to_reference(problem, theta)
                break
        if found is None or distance > (1.0 - _GAINS) * far:
            break
        nearest, far = found, distance
        message = f"{estimate.message}; nearest to the description on the optimal face"
    return replace(nearest, message=message, solve_time=seconds)
