"""Judge parameters that were found elsewhere against the proven optimum of a problem."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.tables import plain_dict
from sdpid._common.threads import one_thread
from sdpid.assurance.certificate.certificate import Certificate, certify
from sdpid.assurance.diagnostics.active_constraints import constraint_states
from sdpid.assurance.diagnostics.validation import validate, validate_robot
from sdpid.assurance.tables.audit import BaseAudit, audit_base_parameters
from sdpid.assurance.tables.csv_table import half_unit, read_base_table
from sdpid.errors import DataError, InfeasibleError, ModelError, SolverError
from sdpid.estimation.conic.solve import ConicProgram, solve_conic
from sdpid.estimation.estimate import FEASIBLE, Estimate
from sdpid.estimation.problem import Problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.estimation.wls import solve_wls
from sdpid.output.tables.parameters_file import read_parameters
from sdpid.robot.description.urdf import without_level
from sdpid.robot.description.xml import read_description
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel
from sdpid.verifier.reading import listed

# Violated constraints, and refitted parameters, that are named; of more, how many there are.
_NAMED = 6

# Joints of two descriptions that are this near to each other (m, rad) are the same.
_SAME_PLACE = 1e-6

# No parameter of a robot is larger or, unless it is zero, smaller: squares of them are doubles.
_LARGEST, _SMALLEST = 1e12, 1e-100

# Names of parameters that a message lists.
_LISTED = 8

# What `Judgment.to_dict` tells as it is.
_AS_THEY_ARE = ("feasible", "violations", "refitted", "cost", "gap", "audit")

_DESCRIPTIONS = (".urdf", ".xml", ".mjcf", ".xacro")


@dataclass(frozen=True, kw_only=True)
class GivenParameters:
    """Parameters by name.

    Attributes
    ----------
    source : str
        Where they come from.
    values : dict
        Values in SI units by the names of standard parameters (``m_1``, ``Fs1``) or of base
        parameters (``zzr1``).
    halfwidths : dict
        How far from these they may be: half a unit in the last printed place.
    """

    source: str
    values: Mapping[str, float]
    halfwidths: Mapping[str, Fraction] = field(default_factory=dict)

    def standard(self, problem: Problem) -> bool:
        """Return whether they hold all parameters of the links, else all base parameters.

        Raises
        ------
        DataError
            When neither is so, a name is not one of the problem's, or a number no robot's.
        """
        base = problem.base
        rigid = base.theta_names[: 10 * problem.robot.n_links]
        friction = base.theta_names[len(rigid) :]
        known = {*base.theta_names, *base.names}
        if unknown := [name for name in self.values if name not in known]:
            raise DataError(
                f"{self.source}: the problem has no parameters {listed(unknown, _LISTED)}; name "
                "the friction terms that have them with friction=(...) (--friction TERM), or leave "
                "them out."
            )
        for name, x in self.values.items():
            if x and not _SMALLEST <= abs(x) <= _LARGEST:
                raise DataError(
                    f"{self.source}: {name} is {x:g}; no robot has a parameter beyond "
                    f"{_LARGEST:g}, or that near to zero (give 0)."
                )
        lacking = [name for name in rigid if name not in self.values]
        if not lacking:
            return True
        wanted = [name for name in base.names if name not in friction]
        missing = [name for name in wanted if name not in self.values]
        if missing:
            raise DataError(
                f"{self.source}: holds neither all {len(rigid)} parameters of the links (without "
                f"{listed(lacking, _LISTED)}) nor all {len(wanted)} base parameters (without "
                f"{listed(missing, _LISTED)})."
            )
        return False


def read_given(
    path: str | os.PathLike[str], robot: RobotModel, *, value: str = "value"
) -> GivenParameters:
    """Read parameters from a file of another run, tool or publication.

    Parameters
    ----------
    path : str or path
        JSON or YAML that `write_parameters` wrote; CSV with a column ``name`` (or ``parameter``)
        and one of values; URDF or MJCF, whose joints must be the robot's.
    robot : RobotModel
        Whose parameters they are.
    value : str, optional
        Column of the values in a CSV.

    Raises
    ------
    DataError, ModelError
        When the file cannot be read, or is of another robot.
    """
    file = Path(path)
    suffix = file.suffix.lower()
    if suffix in _DESCRIPTIONS:
        # A base that a run found to be tilted is no matter of the links.
        text = read_description(path).text
        source = path if without_level(text) == text else without_level(text)
        given = load_robot(source)
        if robot.free_flyer and not given.free_flyer:
            given = load_robot(source, root="free_flyer")
        return GivenParameters(source=file.name, values=_described(given, robot, file))
    if suffix == ".csv":
        table = read_base_table(path, value=value)
        numbers = {name: float(x) for name, x in table.values.items()}
        return GivenParameters(source=file.name, values=numbers, halfwidths=table.halfwidths)
    numbers = read_parameters(path)
    halves = {name: half_unit(repr(x)) for name, x in numbers.items()}
    return GivenParameters(source=file.name, values=numbers, halfwidths=halves)


def _described(given: RobotModel, robot: RobotModel, file: Path) -> dict[str, float]:
    """Return the links, friction and armature of a description, by the robot's names."""
    if given.joint_names != robot.joint_names or given.link_names != robot.link_names:
        raise ModelError(
            f"{file}: has the joints {listed(given.joint_names, _LISTED)}, the robot "
            f"'{robot.name}' {listed(robot.joint_names, _LISTED)}; give a description of the same "
            "robot."
        )
    places = (each.pin_model.jointPlacements for each in (robot, given))
    for name, own, other in zip(robot.pin_model.names, *places, strict=True):
        if np.abs(own.homogeneous - other.homogeneous).max() > _SAME_PLACE:
            raise ModelError(
                f"{file}: joint {name} is elsewhere than in '{robot.name}', so that its links' "
                "parameters are about other frames; give a description with the same kinematics."
            )
    found = dict(zip(robot.parameter_names, given.prior.ravel().tolist(), strict=True))
    damping, dry = given.described_friction()
    for symbol, each in (("Fs", dry), ("Fv", damping), ("Ia", given.described_armature())):
        if np.any(each):
            joints = each[given.n_base :].tolist()
            found.update({f"{symbol}{j + 1}": x for j, x in enumerate(joints)})
    return found


@dataclass(frozen=True, kw_only=True, eq=False)
class Judgment:
    """How far given parameters are from the best feasible ones.

    Attributes
    ----------
    given : GivenParameters
        What was judged.
    estimate : Estimate
        The given parameters, friction that they lack refitted. Without standard parameters
        ``estimate.theta`` is None, and a prior is left out of the problem.
    refitted : tuple of str
        Friction parameters that were not given: the best ones beside those that were.
    optimum : Estimate
        The best feasible parameters that were found.
    certificate : Certificate
        Of `estimate`, by the optimum's multipliers.
    violations : tuple of str
        Constraints that the given parameters break, number against limit.
    residuals : dict
        Relative residual on the rows in use: ``"given"``, ``"optimum"``, ``"unconstrained"`` and,
        where the robot's description has masses, ``"description"``.
    audit : BaseAudit or None
        Whether any bodies have the given base parameters; None for standard ones.
    """

    given: GivenParameters
    estimate: Estimate
    refitted: tuple[str, ...]
    optimum: Estimate
    certificate: Certificate
    violations: tuple[str, ...]
    residuals: Mapping[str, float]
    audit: BaseAudit | None = None

    @property
    def cost(self) -> float:
        """Cost of the given parameters; rounded up where they are standard ones."""
        return self.certificate.cost

    @property
    def gap(self) -> float:
        """(cost − lower bound) relative to the cost; negative below the bound."""
        return self.certificate.gap

    @property
    def feasible(self) -> bool | None:
        """Whether they satisfy every constraint; None for base parameters, which bodies may have.

        Of base parameters it is False where no bodies have them, or they cost less than any.
        """
        if self.estimate.theta is not None:
            return self.certificate.feasible
        refuted = self.audit is not None and self.audit.verdict == "not realisable"
        return False if refuted or self.gap < 0.0 else None

    def summary(self) -> str:
        """Return the judgment in words, line by line."""
        problem, cost, bound = self.estimate.problem, self.cost, self.certificate.lower_bound
        standard = self.estimate.theta is not None
        what = "standard" if standard else "base"
        lines = [f"{self.given.source}: {len(self.given.values)} {what} parameters given"]
        if self.refitted:
            held = "the links" if standard else "the other base parameters"
            lines.append(f"friction refitted with {held} held: {listed(self.refitted, _NAMED)}")
        lines.append(self._feasibility())
        of_it = ""
        if standard and problem.prior is not None:
            of_it = f" ({cost - problem.cost(self.estimate.base):.4g} of it for the prior)"
        lines.append(
            f"cost {cost:.10g}{of_it}; no feasible parameters cost less than {bound:.10g} (proven)"
        )
        lines.append(self._distance())
        residuals = (f"{name} {100 * x:.2f} %" for name, x in self.residuals.items())
        lines.append(f"relative residual: {', '.join(residuals)}")
        return "\n".join(lines)

    def _distance(self) -> str:
        """Return in words how far the cost is from the bound."""
        cost, bound = self.cost, self.certificate.lower_bound
        if self.gap < 0.0:
            return (
                f"{100 * -self.gap:.3g} % of its cost below the bound: no feasible parameters are "
                "there"
            )
        if not bound > 0.0:
            return f"at most {self.gap:.3g} times its cost above the optimum"
        share = 100.0 * (cost / bound - 1.0)
        return f"{cost / bound:.4g} times the bound: at most {share:.3g} % above the optimum"

    def _feasibility(self) -> str:
        """Return in words whether the parameters are feasible."""
        if self.estimate.theta is not None:
            if self.certificate.feasible:
                return "feasible: every constraint holds (proven)"
            broken = self.violations or (f"by less than {FEASIBLE:g}, where rounding ends",)
            more = [f"{len(broken) - _NAMED} more"] if len(broken) > _NAMED else []
            return f"not feasible: {'; '.join([*broken[:_NAMED], *more])}"
        if self.audit is None:
            return "base parameters only: not compared with the constraints of bodies"
        found = self.audit
        proof = found.refutation
        why = "" if proof is None else f": {proof.inequality()}"
        return f"bodies that have these base parameters: {found.verdict}{why}"

    def to_dict(self) -> dict[str, Any]:
        """Return the judgment as plain values."""
        content = {
            "source": self.given.source,
            "standard": self.estimate.theta is not None,
            **{name: getattr(self, name) for name in _AS_THEY_ARE},
            "lower_bound": self.certificate.lower_bound,
            "optimum": self.optimum.cost,
            "relative_residuals": self.residuals,
        }
        return plain_dict(content)


@one_thread
def certify_parameters(problem: Problem, given: GivenParameters) -> Judgment:
    """Say how far given parameters are from the best feasible ones of a problem, with a proof.

    The program is solved for a lower bound on the cost of all feasible parameters. Friction that
    is not given is refitted with everything else held, as it would be to use the parameters.

    Parameters
    ----------
    problem : Problem
        As `formulate` and `build_problem` make it.
    given : GivenParameters
        All standard parameters of the links, or all base parameters; friction as far as it is
        known. (See `read_given`.)

    Returns
    -------
    Judgment

    Raises
    ------
    DataError
        When names are not the problem's, or parameters are missing.
    SolverError, InfeasibleError
        When there is no optimum, or no friction that its own constraints allow.
    """
    standard = given.standard(problem)
    if not standard and problem.prior is not None:
        # What a prior on the links costs cannot be told of base parameters.
        problem = replace(problem, prior=None)
    estimate, refitted = _completed(problem, given, standard)
    optimum, robot = _optimum(problem), problem.robot
    wls = solve_wls(replace(problem, prior=None))
    residuals = {
        name: validate(each).told.relative
        for name, each in (("given", estimate), ("optimum", optimum), ("unconstrained", wls))
    }
    if not robot.free_flyer and np.any(robot.prior[:, 0] > 0.0):
        residuals["description"] = validate_robot(robot, problem.samples).told.relative
    return Judgment(
        given=given,
        estimate=estimate,
        refitted=refitted,
        optimum=optimum,
        certificate=certify(estimate, bound=optimum),
        violations=violations(estimate),
        residuals=residuals,
        audit=None if standard else _audit(problem, given),
    )


def _optimum(problem: Problem) -> Estimate:
    """Return the best feasible parameters; those that were found, where the last digits lack.

    Whatever multipliers came with them, what these prove is proven.
    """
    try:
        return solve_sdp(problem)
    except InfeasibleError:
        raise
    except SolverError as stopped:
        if isinstance(stopped.found, Estimate) and stopped.found.multipliers is not None:
            return stopped.found
        raise


def _completed(
    problem: Problem, given: GivenParameters, standard: bool
) -> tuple[Estimate, tuple[str, ...]]:
    """Return the estimate with given parameters, and the names of those refitted beside them."""
    base, feasible = problem.base, problem.feasible
    names = base.theta_names if standard else base.names
    values = np.array([given.values.get(name, 0.0) for name in names])
    free = np.array([k for k, name in enumerate(names) if name not in given.values], dtype=np.intp)
    if len(free):
        matrix, rhs, own = problem.A, problem.rhs, free
        rows, limits, held = np.zeros((0, len(free))), np.zeros((2, 0)), np.zeros(0)
        if standard:
            matrix, rhs = problem.squared.matrix, problem.squared.rhs
            touched = np.flatnonzero(np.any(feasible.rows[:, free] != 0.0, axis=1))
            rows, held = feasible.rows[np.ix_(touched, free)], feasible.rows[touched] @ values
            limits = np.stack([feasible.row_lower[touched], feasible.row_upper[touched]])
        else:
            # Friction that is a base parameter by itself, with its bounds.
            own = np.array([base.theta_names.index(names[k]) for k in free])
        ends = zip((feasible.lower[own], feasible.upper[own]), limits, strict=True)
        lower, upper = (np.concatenate([bound, limit - held]) for bound, limit in ends)
        C = np.vstack([np.eye(len(free)), rows])
        values[free] = _least(matrix[:, free], rhs - matrix @ values, C, lower, upper)
    refitted = tuple(names[k] for k in free)
    origin: dict[str, Any] = {"method": "given", "status": "given"}
    if not standard:
        message = given.source
        estimate = Estimate(problem=problem, base=values, theta=None, message=message, **origin)
        return estimate, refitted
    status = "optimal" if feasible.violation(values) <= FEASIBLE else "infeasible"
    message = f"{given.source}: {status}"
    return Estimate.of_theta(problem, values, message=message, **origin), refitted


def _least(matrix: Array, rhs: Array, C: Array, lower: Array, upper: Array) -> Array:
    """Return x of least ``‖matrix·x − rhs‖`` with ``lower ≤ C·x ≤ upper``."""
    whole = max(float(np.linalg.norm(rhs)), np.finfo(float).tiny)
    program = ConicProgram(M=matrix / whole, m=-rhs / whole, C=C, lower=lower, upper=upper)
    solution = solve_conic(program)
    if solution.x is None or "Infeasible" in solution.status:
        raise InfeasibleError(
            f"certify: no friction beside the given parameters satisfies its own constraints "
            f"({solution.status}); give all friction parameters, or fewer conditions."
        )
    # Bounds hold to rounding only; what is a bound itself is made exact.
    own = len(solution.x)
    return np.asarray(np.clip(solution.x, lower[:own], upper[:own]))


def violations(estimate: Estimate) -> tuple[str, ...]:
    """Return the constraints that an estimate breaks beyond rounding, number against limit."""
    found = []
    for each in constraint_states(estimate):
        limit, slack = each.limit or 0.0, -np.inf if each.slack is None else each.slack
        unit = "" if each.unit is None else f" {each.unit}"
        if slack >= -FEASIBLE:
            continue
        if each.slack is None:
            what = f"the mass {np.array(estimate.theta)[10 * each.index]:.6g} kg has no margin"
        elif each.kind == "consistency":
            what = f"margin {limit + slack:.6g}{unit}, at least {limit:g}"
        elif each.kind == "cone":
            what = f"slack {slack:.6g}{unit}, at least 0"
        elif each.side is None:
            value = estimate.problem.feasible.rows[each.index] @ np.array(estimate.theta)
            what = f"is {value:.6g}{unit}, not {limit:g}"
        else:
            what = f"is {limit + each.sign * slack:.6g}{unit}"
        found.append((slack, f"{each.name}: {what}"))
    return tuple(text for _, text in sorted(found, key=lambda pair: pair[0]))


def _audit(problem: Problem, given: GivenParameters) -> BaseAudit | None:
    """Return whether any bodies have given base parameters; None where that cannot be asked."""
    if problem.consistency == "none":
        return None
    names = [name for name in given.values if name in problem.base.names]
    limits = problem.constraints
    try:
        return audit_base_parameters(
            problem.robot,
            {name: given.values[name] for name in names},
            {name: given.halfwidths.get(name, 0) for name in names},
            consistency=problem.consistency,
            margin=limits.margin,
            mass_min=limits.mass_min,
            mass_max=limits.mass_max,
            theta_max=float(problem.feasible.widest.max()),
            friction=problem.friction.terms,
            friction_nonnegative=limits.friction_nonnegative,
            base=problem.base,
        )
    except DataError:
        # Effects that were taken at links which a table does not hold.
        return None
