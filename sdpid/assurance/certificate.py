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
from sdpid.estimation.entropy import Entropy
from sdpid.estimation.estimate import FEASIBLE, Estimate
from sdpid.estimation.problem import Problem
from sdpid.robot.inertia import margin, margin_shift, matrix_basis

SCHEMA = "sdpid-certificate"
VERSION = 2

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
        feasible, dual = problem.feasible, self.bound.dual
        own = feasible.n_own
        cones = zip(
            feasible.block_names[own:],
            feasible.block_links[own:].tolist(),
            feasible.block_basis[own:],
            strict=True,
        )
        entropic = None if problem.prior is None else problem.prior.entropic
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
            "rows": [
                {"name": name, "coefficients": row.tolist(), "lower": low, "upper": high}
                for name, row, low, high in zip(
                    feasible.row_names,
                    feasible.rows,
                    map(_finite, feasible.row_lower),
                    map(_finite, feasible.row_upper),
                    strict=True,
                )
            ],
            "cones": [
                {
                    "name": name,
                    "link": link,
                    "axis": basis[:, -1, -1].tolist(),
                    "vectors": basis[:, :3, -1].T.tolist(),
                }
                for name, link, basis in cones
            ],
            "entropic_prior": None
            if entropic is None
            else {
                "links": entropic.links.tolist(),
                "inverses": entropic.inverses.tolist(),
                "strength": entropic.strength,
            },
            "theta": None if estimate.theta is None else estimate.theta.tolist(),
            "base": estimate.base.tolist(),
            "y": dual.y.tolist(),
            "Z": dual.Z.tolist(),
            "row_multipliers": dual.rows.tolist(),
            "W": None if dual.W is None else dual.W.tolist(),
            "cost": self.cost,
            "lower_bound": self.lower_bound,
            "gap": self.gap,
            "passed": self.passed,
        }

    def to_json(self, path: str | os.PathLike[str]) -> None:
        """Write the certificate to a file, whole or not at all."""
        atomic_write_text(path, json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n")


def _finite(limit: float) -> float | None:
    """Return a limit for JSON, None where there is none."""
    return float(limit) if np.isfinite(limit) else None


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
    value = evaluate(estimate.problem, bound.dual)
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
    rows = _Rows.of(data["rows"], array("row_multipliers"), B.shape[1])
    cones = [(int(c["link"]), np.array(c["axis"]), np.array(c["vectors"])) for c in data["cones"]]
    entropic = _entropic(data["entropic_prior"])
    worst = None
    if data["theta"] is None:
        problems.append("no standard parameters: nothing is feasible")
    else:
        theta = array("theta")
        bodies = theta[: 10 * links].reshape(links, 10)
        cost += float(np.sum((R @ theta - r) ** 2))
        if entropic is not None:
            cost += entropic.value(theta)
        if not np.allclose(B @ theta, base, rtol=1e-9, atol=1e-9):
            problems.append("base is not B·theta")
        outside = float(np.max(np.maximum(lower - theta, theta - upper)))
        if outside > FEASIBLE:
            problems.append(f"a bound is violated by {outside:.2e}")
        problems += rows.violated(theta)
        for (link, axis, vectors), cone in zip(cones, data["cones"], strict=True):
            short = float(np.linalg.norm(vectors @ bodies[link]) - axis @ bodies[link])
            if short > FEASIBLE:
                problems.append(f"{cone['name']} is violated by {short:.2e}")
        if consistency != "none":
            margins = margin(bodies, consistency)
            if np.all(np.isfinite(margins)):
                worst = float(margins.min())
            if worst is None or worst < float(data["margin"]) - FEASIBLE:
                problems.append(f"a link's margin is {worst}, below {data['margin']}")
    linear = 2.0 * (B.T @ (A.T @ y[:count]) + R.T @ y[count:]) - rows.linear
    constant = floor - float(y @ y) - 2.0 * float(y[:count] @ rhs + y[count:] @ r) + rows.constant
    if entropic is not None and data["W"] is not None:
        gained, slope = entropic.support(array("W"), len(linear))
        constant, linear = constant + gained, linear + slope
    if Z.size:
        smallest = float(np.linalg.eigvalsh(Z)[:, 0].min())
        if smallest < -_PSD * max(float(np.abs(Z).max()), np.finfo(float).tiny):
            problems.append(f"a multiplier has the eigenvalue {smallest:.2e}")
        own = 0 if consistency == "none" else links
        if own:
            terms = np.einsum("lij,kij->lk", Z[:own], matrix_basis(consistency))
            linear[: 10 * links] -= terms.ravel()
            shift = float(data["margin"]) * margin_shift(consistency)
            constant += float(np.einsum("lij,ij->", Z[:own], shift))
        for (link, axis, vectors), multiplier in zip(cones, Z[own:], strict=True):
            # ⟨Z, [[a·E, v], [v^T, a]]⟩ in the ten parameters of the link.
            terms = np.trace(multiplier) * axis + 2.0 * multiplier[-1, :3] @ vectors
            linear[10 * link : 10 * link + 10] -= terms
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


@dataclass(frozen=True, eq=False)
class _Rows:
    """The linear rows of a certificate with their multipliers."""

    data: list[dict[str, Any]]
    linear: Array
    constant: float

    @classmethod
    def of(cls, data: list[dict[str, Any]], multipliers: Array, n_theta: int) -> _Rows:
        if len(multipliers) != len(data):
            raise ValueError(f"{len(multipliers)} multipliers for {len(data)} rows")
        linear, constant = np.zeros(n_theta), 0.0
        for row, multiplier in zip(data, multipliers, strict=True):
            limit = row["lower"] if multiplier > 0.0 else row["upper"]
            if limit is not None:
                linear += multiplier * np.array(row["coefficients"])
                constant += float(multiplier) * float(limit)
        return cls(data, linear, constant)

    def violated(self, theta: Array) -> list[str]:
        """Return in words which rows theta violates."""
        out = []
        for row in self.data:
            value = float(np.array(row["coefficients"]) @ theta)
            low = -np.inf if row["lower"] is None else float(row["lower"])
            high = np.inf if row["upper"] is None else float(row["upper"])
            short = max(low - value, value - high)
            if not short <= FEASIBLE:
                out.append(f"{row['name']} is violated by {short:.2e}")
        return out


def _entropic(data: dict[str, Any] | None) -> Entropy | None:
    if data is None:
        return None
    return Entropy(np.array(data["links"]), np.array(data["inverses"]), float(data["strength"]))
