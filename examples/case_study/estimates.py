"""Estimate the Denso's parameters on one plant with every solver, and prove the optimum."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

import sdpid
from case_study.experiments import ROBOT, Experiment, true_theta

# The paper ran with 0.01 kg·m² on the inertias about the centers of mass (Table V). A margin of
# 0.005 on the second moments implies that, and is what the plant's true parameters have.
MARGINS = {"6x6": ("spatial_inertia", 0.01), "4x4": ("pseudo_inertia", 0.005)}

# Every so many samples of the motion the mass matrix is looked at.
STRIDE = 97

# Of a 95 % interval, in standard errors.
TWO_SIDED = 1.96


@dataclass(frozen=True)
class Estimates:
    """All estimates on one plant.

    Attributes
    ----------
    experiment : Experiment
        What they are made from.
    problems : dict of str to Problem
        By inequality, ``"6x6"`` and ``"4x4"``.
    wls, wls_literal : Estimate
        Weighted least squares, processed by default and by section III-C to the letter.
    comparisons : dict of str to Comparison
        By inequality: the semidefinite program and the local solvers from many starts.
    """

    experiment: Experiment
    problems: dict[str, Any]
    wls: Any
    wls_literal: Any
    comparisons: dict[str, Any]

    @cached_property
    def cwls(self) -> Any:
        """The cheapest feasible result of SLSQP: what the paper's procedure would report."""
        rows = zip(self.comparisons["6x6"].rows, self.comparisons["6x6"].estimates, strict=True)
        local = [(row.status, found) for row, found in rows if row.solver == "slsqp" and found]
        feasible = [found for status, found in local if status != "infeasible"]
        if not feasible:
            print("no start of SLSQP ended feasible; the cheapest infeasible one is shown")
        return min(feasible or [found for _, found in local], key=lambda each: each.cost)

    def sdp(self, inequality: str) -> Any:
        """Return the proven optimum under an inequality."""
        return self.comparisons[inequality].certificate.estimate

    @cached_property
    def eigenvalues(self) -> dict[str, np.ndarray]:
        """Least eigenvalues of the mass matrix on the motion, of each estimate and of the truth."""
        q = self.experiment.samples.position[::STRIDE]
        matrices = {
            "WLS": self.wls.mass_matrix(q),
            "CWLS": self.cwls.mass_matrix(q),
            "SDP": self.sdp("4x4").mass_matrix(q),
            "true": sdpid.load_robot(ROBOT).mass_matrix(true_theta(), q),
        }
        return {name: np.linalg.eigvalsh(M)[:, 0] for name, M in matrices.items()}

    @property
    def base_true(self) -> np.ndarray:
        """The plant's base parameters."""
        return np.asarray(self.problems["6x6"].base.matrix @ true_theta())

    def facts(self) -> dict[str, Any]:
        """Return what the case study claims of this plant, each with its number."""
        inside = np.abs(self.wls.base - self.base_true) <= TWO_SIDED * self.wls.standard_errors
        facts: dict[str, Any] = {
            "wls_least_eigenvalue": float(self.eigenvalues["WLS"].min()),
            "wls_greatest_least_eigenvalue": float(self.eigenvalues["WLS"].max()),
            "sdp_least_eigenvalue": float(self.eigenvalues["SDP"].min()),
            "sdp_proven_eigenvalue": sdpid.smallest_mass_eigenvalue(self.sdp("4x4")).lower_bound,
            "true_inside_95": int(inside.sum()),
        }
        for name, (consistency, _) in MARGINS.items():
            # Without a margin: can links of any shape have what least squares found?
            audit = sdpid.audit_base_parameters(
                sdpid.load_robot(ROBOT), self.wls.named(), 0, consistency=consistency
            )
            comparison = self.comparisons[name]
            facts[f"wls_{name}"] = audit.verdict
            facts[f"cost_of_constraints_{name}"] = self.sdp(name).cost / self.wls.cost - 1.0
            facts[f"gap_{name}"] = comparison.certificate.gap
            facts[f"certified_{name}"] = comparison.certificate.passed
            for solver in ("slsqp", "log_cholesky"):
                runs = [row for row in comparison.rows if row.solver == solver]
                facts[f"{solver}_optimal_{name}"] = sum(row.status == "optimal" for row in runs)
                feasible = [r.gap for r in runs if r.gap is not None and r.status != "infeasible"]
                facts[f"{solver}_infeasible_{name}"] = len(runs) - len(feasible)
                facts[f"{solver}_worst_gap_{name}"] = max(feasible, default=None)
        return facts


def estimate_all(experiment: Experiment, **local: Any) -> Estimates:
    """Estimate with every solver; `local` are arguments of `sdpid.compare` for the local ones."""
    robot = sdpid.load_robot(ROBOT)
    problems = {
        name: sdpid.build_problem(
            robot,
            experiment.samples,
            consistency=kind,
            constraints=sdpid.Constraints(margin=margin),
        )
        for name, (kind, margin) in MARGINS.items()
    }
    spatial = problems["6x6"]
    literal = sdpid.build_problem(robot, experiment.literal, base=spatial.base)
    return Estimates(
        experiment=experiment,
        problems=problems,
        wls=sdpid.solve_wls(spatial),
        wls_literal=sdpid.solve_wls(literal),
        comparisons={name: sdpid.compare(problem, **local) for name, problem in problems.items()},
    )
