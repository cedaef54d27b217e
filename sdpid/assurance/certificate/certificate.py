"""Certificates: proven bounds on how far an estimate is from the global optimum.

What a certificate claims is proven in exact arithmetic by `sdpid.verifier.certificate`,
which needs nothing of this package.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np

from sdpid import __version__
from sdpid._common.arrays import Array, frozen
from sdpid._common.files import atomic_write_text
from sdpid._common.tables import Shown
from sdpid._common.threads import one_thread
from sdpid.assurance.certificate.rounding import (
    downward,
    feasible_theta,
    proven_margins,
    semidefinite,
)
from sdpid.assurance.certificate.rows_digest import rows_digest
from sdpid.errors import CertificateError
from sdpid.estimation.duality.bound import Bound, evaluate, relative_gap
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem
from sdpid.verifier import certificate as checker
from sdpid.verifier.bound import CONE, ROW, Proof
from sdpid.verifier.exact import above, product
from sdpid.verifier.reading import digest
from sdpid.verifier.result import Result

GAP = checker.GAP


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Certificate(Shown):
    """A proof of how far an estimate can be from the global optimum.

    Everything it states is checked in exact arithmetic, when first asked for. What is certified is
    the estimate to rounding: parameters on the edge of a constraint are moved inside by the last
    digits, and multipliers that rounding left outside their cone likewise.

    Attributes
    ----------
    estimate : Estimate
        What is certified.
    bound : Bound
        The lower bound in floating point, and its multipliers.

    Examples
    --------
    >>> certificate = sdpid.certify(estimate)
    >>> certificate.passed, bool(certificate.gap < 1e-6), bool(min(certificate.margins) > 0.0)
    (True, True, True)
    >>> bool(certificate.lower_bound <= certificate.cost)
    True
    >>> certificate.to_json("certificate.json")
    """

    estimate: Estimate
    bound: Bound

    _facts = (
        "problem.robot.name",
        "estimate.method",
        "passed",
        "cost",
        "lower_bound",
        "gap",
        "estimate.worst_margin, kg·m²",
    )

    @property
    def problem(self) -> Problem:
        """The problem."""
        return self.estimate.problem

    @cached_property
    def theta(self) -> Array | None:
        """The parameters that are certified: the estimate's, inside every constraint exactly."""
        if self.estimate.theta is None:
            return None
        return frozen(feasible_theta(self.problem.feasible, self.estimate.theta))

    @cached_property
    def certified(self) -> Estimate:
        """The estimate with the parameters that are certified, to the last digit.

        Its base parameters are the doubles nearest to B·theta.
        """
        if self.theta is None:
            return self.estimate
        exact = product(self.problem.base.matrix.tolist(), self.theta.tolist())
        base = frozen([float(value) for value in exact])
        return replace(self.estimate, theta=self.theta, base=base)

    @cached_property
    def _stated(self) -> tuple[dict[str, Any], Proof]:
        """Everything that the certificate states, and its exact evaluation."""
        problem, estimate, dual = self.problem, self.estimate, self.bound.multipliers
        feasible, theta = problem.feasible, self.theta
        limits = np.where(dual.rows > 0.0, feasible.row_lower, feasible.row_upper)
        stated: dict[str, Any] = {
            "schema": checker.SCHEMA,
            "version": checker.VERSION,
            "metadata": {
                "software": f"sdpid {__version__}",
                **{name: getattr(estimate, name) for name in ("method", "status", "message")},
            },
            "origin": {
                "robot": problem.robot.name,
                "links": list(problem.robot.link_names),
                "joints": list(problem.robot.joint_names),
                "weighting": problem.weighting,
                "loss": _loss(problem),
                "theta_names": list(problem.base.theta_names),
                "base_names": list(problem.base.names),
                "samples": problem.n_samples,
                "rows": problem.n_rows,
                "rows_sha256": rows_digest(problem),
            },
            "problem": problem_dict(problem),
            "theta": None if theta is None else theta.tolist(),
            "multipliers": {
                "y": dual.y.tolist(),
                "Z": semidefinite(dual.Z).tolist(),
                "rows": np.where(np.isfinite(limits), dual.rows, 0.0).tolist(),
                "W": None if not len(dual.W) else semidefinite(dual.W).tolist(),
            },
        }
        proof = Proof(stated)
        claims: dict[str, Any] = dict.fromkeys(checker.CLAIMS)
        stated["claims"] = claims
        claims["lower_bound"] = downward(proof.lower_bound)
        if theta is not None:
            claims.update(margins=proven_margins(feasible, theta), violation=above(proof.violation))
            if not proof.broken:
                claims["cost"] = above(proof.cost)
                cost, bound = Fraction(claims["cost"]), Fraction(claims["lower_bound"])
                scale = max(cost, proof.scale)
                claims["gap"] = above((cost - bound) / scale) if scale else 0.0
        return stated, proof

    @cached_property
    def _proof(self) -> Result:
        """The result of the stand-alone check."""
        return checker.prove(*self._stated)

    @property
    def _claims(self) -> dict[str, Any]:
        return dict(self._stated[0]["claims"])

    @property
    def cost(self) -> float:
        """Cost of the certified parameters, rounded up; without parameters the estimate's."""
        cost = self._claims["cost"]
        return self.estimate.cost if cost is None else float(cost)

    @property
    def lower_bound(self) -> float:
        """Lower bound on the cost of all feasible parameters, rounded down."""
        return float(self._claims["lower_bound"])

    @property
    def gap(self) -> float:
        """(cost − lower bound) relative to the cost, rounded up."""
        gap = self._claims["gap"]
        if gap is None:
            return relative_gap(self.problem, self.cost, self.lower_bound)
        return float(gap)

    @property
    def margins(self) -> tuple[float | None, ...] | None:
        """Margin of every link in kg·m², rounded down; None for a link without a positive mass.

        None without standard parameters, or where no consistency is demanded.
        """
        margins = self._claims["margins"]
        return None if margins is None else tuple(margins)

    @property
    def feasible(self) -> bool:
        """Whether the certified parameters are proven to satisfy every constraint."""
        stated, proof = self._stated
        return proof.theta is not None and not checker.infeasible(proof, stated["claims"])

    @property
    def passed(self) -> bool:
        """Whether all that is claimed is proven, and the gap is no more than 1e-6 (`GAP`)."""
        return not self._proof.problems and self.gap <= GAP

    def summary(self) -> str:
        """Return what is proven, in words."""
        of = "" if self.problem.origin.meaning is None else f"of {self.problem.origin.meaning}: "
        if not self.feasible:
            reason = "; ".join(self._proof.problems)
            return (
                f"{of}not feasible: {reason}; no feasible parameters cost less than "
                f"{self.lower_bound:.10g}."
            )
        margins = [margin for margin in self.margins or () if margin is not None]
        how = f" with margin {min(margins):.6g} kg.m2" if margins else ""
        return (
            f"{of}feasible{how}; cost {self.cost:.10g}; no feasible parameters cost less than "
            f"{self.lower_bound:.10g}; {self._distance()}."
        )

    def _distance(self) -> str:
        """Return how far the cost is from the optimum, in words."""
        gap, scale = max(self.gap, 0.0), float(self._stated[1].scale)
        if self.cost >= scale:
            return f"at most {100 * gap:.2e} % above the global optimum"
        return f"at most {gap:.2e} times {scale:.3g} above the global optimum, the cost being tiny"

    def to_dict(self) -> dict[str, Any]:
        """Return everything that is needed to check the certificate, as plain values."""
        stated = self._stated[0]
        return {**stated, "sha256": digest(stated)}

    def to_json(self, path: str | os.PathLike[str]) -> None:
        """Write the certificate to a file, whole or not at all."""
        atomic_write_text(path, _text(self.to_dict()) + "\n")


def _loss(problem: Problem) -> str | None:
    """Return what the rows are where they are not the log's own, None where they are."""
    if not problem.origin.constant:
        return problem.origin.meaning
    return f"robust: rows are weighted by it, and it adds {problem.origin.constant!r} to the floor"


def problem_dict(problem: Problem) -> dict[str, Any]:
    """Return the problem as a certificate states it, as plain values."""
    feasible, squared, log_det = problem.feasible, problem.squared, problem.log_det
    prior_rows, own = slice(problem.base.count, None), slice(feasible.n_own, None)
    arrows = feasible.block_basis[own]
    limits = (
        [limit if np.isfinite(limit) else None for limit in each.tolist()]
        for each in (feasible.row_lower, feasible.row_upper)
    )
    rows = zip(feasible.row_names, *limits, feasible.rows.tolist(), strict=True)
    cones = zip(
        feasible.block_names[own],
        feasible.block_links[own].tolist(),
        arrows[:, :, -1, -1].tolist(),
        np.swapaxes(arrows[:, :, :3, -1], 1, 2).tolist(),
        strict=True,
    )
    return {
        "consistency": problem.consistency,
        "margin": float(problem.constraints.margin),
        "links": feasible.n_links,
        "A": problem.A.tolist(),
        "base_matrix": problem.base.matrix.tolist(),
        "rhs": problem.rhs.tolist(),
        "floor": float(problem.floor),
        "prior_matrix": squared.matrix[prior_rows].tolist(),
        "prior_rhs": squared.rhs[prior_rows].tolist(),
        "lower": feasible.lower.tolist(),
        "upper": feasible.upper.tolist(),
        "rows": [dict(zip(ROW, each, strict=True)) for each in rows],
        "cones": [dict(zip(CONE, each, strict=True)) for each in cones],
        "entropic_prior": None
        if not len(log_det.links)
        else {
            "links": log_det.links.tolist(),
            "inverses": semidefinite(log_det.inverses).tolist(),
            "strength": float(log_det.strength),
        },
    }


def _text(value: Any, indent: str = "") -> str:
    """Return JSON with one line a key, and a line for each row of numbers."""
    deeper = indent + " "
    if isinstance(value, dict) and value:
        items = [f"{json.dumps(key)}: {_text(item, deeper)}" for key, item in value.items()]
        opened, closed = "{", "}"
    elif isinstance(value, list) and any(isinstance(item, (dict, list)) for item in value):
        items = [_text(item, deeper) for item in value]
        opened, closed = "[", "]"
    else:
        return json.dumps(value, allow_nan=False, separators=(",", ":"))
    lines = f",\n{deeper}".join(items)
    return f"{opened}\n{deeper}{lines}\n{indent}{closed}"


@one_thread
def certify(estimate: Estimate, *, bound: Bound | Estimate | None = None) -> Certificate:
    """Certify an estimate: a lower bound on the cost of all feasible parameters.

    Parameters
    ----------
    estimate : Estimate
        From any solver.
    bound : Bound or Estimate, optional
        A bound of the same problem, or an SDP estimate whose multipliers give one. By default
        the estimate's own multipliers, and where it has none, those of an SDP solved here.

    Returns
    -------
    Certificate

    Raises
    ------
    CertificateError
        When the bound belongs to another problem.

    Examples
    --------
    >>> certificate = sdpid.certify(estimate)
    >>> certificate.passed
    True
    >>> bool(certificate.gap < 1e-6)
    True
    >>> print(certificate.summary())
    feasible with margin ... kg.m2; cost 2472.6...; no feasible parameters cost less than 2472.6...;
    at most ... % above the global optimum.
    """
    if bound is None:
        if estimate.multipliers is None and estimate.problem.consistency != "none":
            from sdpid.estimation.sdp.solve import solve_sdp

            bound = solve_sdp(estimate.problem)
        else:
            bound = estimate
    if isinstance(bound, Estimate):
        if bound.problem is not estimate.problem:
            raise CertificateError("certify: the bound's estimate is of another problem.")
        bound = bound.bound()
    value = evaluate(estimate.problem, bound.multipliers)
    if value != bound.value:
        raise CertificateError(
            f"certify: the multipliers give the bound {value}, not {bound.value}; they belong to "
            "another problem."
        )
    return Certificate(estimate=estimate, bound=bound)
