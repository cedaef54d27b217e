"""Certificates: how good an estimate is at worst, from numbers that anyone can recompute."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._arrays import Array
from sdpid._files import atomic_write_text
from sdpid.errors import CertificateError
from sdpid.estimation.bound import TINY_COST, Bound, evaluate, lower_bound, relative_gap
from sdpid.estimation.estimate import FEASIBLE, Estimate
from sdpid.estimation.problem import Problem
from sdpid.robot.inertia import margin, margin_shift, matrix_basis

SCHEMA = "sdpid-certificate"
VERSION = 1

# A certificate passes when the cost is proven to be within this share of the global optimum.
GAP = 1e-6

# Multipliers whose smallest eigenvalue is above minus this share of the largest count as
# positive semidefinite in floating point.
_PSD = 1e-12


@dataclass(frozen=True, kw_only=True, eq=False)
class Certificate:
    """A proof, in floating point, of how far an estimate can be from the global optimum.

    Attributes
    ----------
    estimate : Estimate
        What is certified.
    bound : Bound
        The lower bound and its multipliers.
    """

    estimate: Estimate
    bound: Bound

    @property
    def problem(self) -> Problem:
        """The problem."""
        return self.estimate.problem

    @property
    def cost(self) -> float:
        """Cost of the estimate."""
        return self.estimate.cost

    @property
    def lower_bound(self) -> float:
        """No feasible parameters cost less."""
        return self.bound.value

    @property
    def gap(self) -> float:
        """(cost − lower bound) relative to the cost (see `relative_gap`)."""
        return relative_gap(self.problem, self.cost, self.lower_bound)

    @property
    def margins(self) -> Array | None:
        """Margin of every link in kg·m², None without standard parameters."""
        return self.estimate.margins

    @cached_property
    def feasible(self) -> bool:
        """Whether the estimate satisfies every constraint, recomputed."""
        return self.estimate.feasible

    @property
    def passed(self) -> bool:
        """Whether the estimate is feasible and within `GAP` of the optimum."""
        return self.feasible and self.gap <= GAP

    def summary(self) -> str:
        """Return in words what is shown."""
        if not self.feasible:
            violation = self.estimate.violation
            how = (
                "it has no standard parameters"
                if violation is None
                else f"a constraint is violated by {violation:.2e}"
            )
            return f"not feasible: {how}; no feasible parameters cost less than {self.lower_bound}."
        worst = self.estimate.worst_margin
        # Without a consistency links may have no mass, and then no margin.
        how = "feasible" if worst is None else f"feasible with margin {worst:.6g} kg.m2"
        return (
            f"{how}; cost {self.cost:.10g}; no feasible "
            f"parameters cost less than {self.lower_bound:.10g}; at most "
            f"{100 * max(self.gap, 0.0):.2e} % above the global optimum."
        )

    def to_dict(self) -> dict[str, Any]:
        """Return everything that is needed to check the certificate, as plain values."""
        problem, estimate = self.problem, self.estimate
        feasible = problem.feasible
        return {
            "schema": SCHEMA,
            "version": VERSION,
            "robot": problem.robot.name,
            "method": estimate.method,
            "status": estimate.status,
            "weighting": problem.weighting,
            "consistency": problem.consistency,
            "margin": problem.constraints.margin,
            "links": feasible.n_links,
            "theta_names": list(problem.base.theta_names),
            "base_names": list(problem.base.names),
            "A": problem.A.tolist(),
            "rhs": problem.rhs.tolist(),
            "floor": problem.floor,
            "prior_matrix": None if problem.prior is None else problem.prior.matrix.tolist(),
            "prior_rhs": None if problem.prior is None else problem.prior.rhs.tolist(),
            "base_matrix": problem.base.matrix.tolist(),
            "lower": feasible.lower.tolist(),
            "upper": feasible.upper.tolist(),
            "theta": None if estimate.theta is None else estimate.theta.tolist(),
            "base": estimate.base.tolist(),
            "y": self.bound.y.tolist(),
            "Z": self.bound.Z.tolist(),
            "cost": self.cost,
            "lower_bound": self.lower_bound,
            "gap": self.gap,
            "passed": self.passed,
        }

    def to_json(self, path: str | os.PathLike[str]) -> None:
        """Write the certificate to a file, whole or not at all."""
        atomic_write_text(path, json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n")


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
    """
    if bound is None:
        if estimate.multipliers is None and estimate.problem.consistency != "none":
            from sdpid.estimation.sdp import solve_sdp

            bound = solve_sdp(estimate.problem)
        else:
            bound = estimate
    if isinstance(bound, Estimate):
        if bound.problem is not estimate.problem:
            raise CertificateError("certify: the bound's estimate is of another problem.")
        bound = lower_bound(bound)
    value = evaluate(estimate.problem, bound.y, bound.Z)
    if value != bound.value:
        raise CertificateError(
            f"certify: the multipliers give the bound {value}, not {bound.value}; they belong to "
            "another problem."
        )
    return Certificate(estimate=estimate, bound=bound)


@dataclass(frozen=True, kw_only=True)
class Verification:
    """What checking a certificate file found, recomputed from its numbers.

    Attributes
    ----------
    passed : bool
        Whether every claim holds.
    cost, lower_bound, gap : float
        Recomputed.
    margin : float or None
        The worst link's margin.
    problems : tuple of str
        What does not hold.
    """

    passed: bool
    cost: float
    lower_bound: float
    gap: float
    margin: float | None
    problems: tuple[str, ...]


def verify(path: str | os.PathLike[str]) -> Verification:
    """Check a certificate file in floating point, from its own numbers alone.

    Parameters
    ----------
    path : path
        A file written by `Certificate.to_json`.

    Returns
    -------
    Verification

    Raises
    ------
    CertificateError
        When the file is not a certificate of this version.
    """
    try:
        data = json.loads(Path(path).read_text(encoding="utf-8"))
        if data["schema"] != SCHEMA or data["version"] != VERSION:
            raise CertificateError(
                f"{path}: schema {data['schema']} version {data['version']}, expected {SCHEMA} "
                f"version {VERSION}."
            )
        return _recompute(data)
    except OSError as cause:
        raise CertificateError(f"cannot read {path}: {cause.strerror}.") from None
    except (KeyError, TypeError, ValueError, IndexError) as cause:
        raise CertificateError(f"{path}: not a certificate ({cause!r}).") from None


def _recompute(data: dict[str, Any]) -> Verification:
    def array(key: str) -> Array:
        values = np.asarray(data[key], dtype=np.float64)
        if not np.all(np.isfinite(values)):
            raise ValueError(f"{key} is not finite")
        return values

    A, rhs, B, y = (array(key) for key in ("A", "rhs", "base_matrix", "y"))
    Z, lower, upper, base = (array(key) for key in ("Z", "lower", "upper", "base"))
    floor, links, consistency = float(data["floor"]), int(data["links"]), data["consistency"]
    problems = []
    residual = A @ base - rhs
    cost = float(residual @ residual) + floor
    count = len(rhs)
    believed = data["prior_matrix"] is not None
    R = array("prior_matrix") if believed else np.zeros((0, B.shape[1]))
    r = array("prior_rhs") if believed else np.zeros(0)
    worst = None
    if data["theta"] is None:
        problems.append("no standard parameters: nothing is feasible")
    else:
        theta = array("theta")
        cost += float(np.sum((R @ theta - r) ** 2))
        if not np.allclose(B @ theta, base, rtol=1e-9, atol=1e-9):
            problems.append("base is not B·theta")
        outside = float(np.max(np.maximum(lower - theta, theta - upper)))
        if outside > FEASIBLE:
            problems.append(f"a bound is violated by {outside:.2e}")
        if consistency != "none":
            margins = margin(theta[: 10 * links].reshape(links, 10), consistency)
            if np.all(np.isfinite(margins)):
                worst = float(margins.min())
            if worst is None or worst < float(data["margin"]) - FEASIBLE:
                problems.append(f"a link's margin is {worst}, below {data['margin']}")
    linear = 2.0 * (B.T @ (A.T @ y[:count]) + R.T @ y[count:])
    constant = floor - float(y @ y) - 2.0 * float(y[:count] @ rhs + y[count:] @ r)
    if Z.size:
        smallest = float(np.linalg.eigvalsh(Z)[:, 0].min())
        if smallest < -_PSD * max(float(np.abs(Z).max()), np.finfo(float).tiny):
            problems.append(f"a multiplier has the eigenvalue {smallest:.2e}")
        linear[: 10 * links] -= np.einsum("lij,kij->lk", Z, matrix_basis(consistency)).ravel()
        shift = float(data["margin"]) * margin_shift(consistency)
        constant += float(np.einsum("lij,ij->", Z, shift))
    bound = constant + float(linear @ np.where(linear > 0.0, lower, upper))
    scale = max(cost, TINY_COST * (float(rhs @ rhs + r @ r) + floor))
    gap = (cost - bound) / scale
    for name, value in (("cost", cost), ("lower_bound", bound)):
        if abs(float(data[name]) - value) > 1e-9 * scale:
            problems.append(f"{name} is {value:.12g}, the file says {data[name]:.12g}")
    if gap > GAP:
        problems.append(f"the gap is {gap:.2e}, above {GAP:.0e}")
    return Verification(
        passed=not problems,
        cost=cost,
        lower_bound=bound,
        gap=gap,
        margin=worst,
        problems=tuple(problems),
    )
