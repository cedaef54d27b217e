"""Rounding on the safe side: floating-point results moved until exact arithmetic accepts them."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.estimation.constraints.feasible_set import FeasibleSet
from sdpid.estimation.estimate import FEASIBLE
from sdpid.robot.consistent import raise_second_moments
from sdpid.verifier.bodies import has_margin
from sdpid.verifier.exact import above, positive_semidefinite

_EPS = float(np.finfo(np.float64).eps)

# Shifts are quadrupled so often at most: up to 2e-13 of each entry of the diagonal, and up to 1e-6
# of the largest, beyond which it is not rounding.
_TRIES_OF_ENTRIES, _TRIES = 6, 17


def downward(value: Fraction) -> float:
    """Return the largest double that is not above a rational."""
    return -above(-value)


def semidefinite(Z: Array) -> Array:
    """Return matrices (N, s, s) that are exactly symmetric and, but for rounding, the same.

    Where an exact factorization finds one that is not positive semidefinite, its diagonal is
    raised: by a share of itself, so that small entries beside large ones stay small, or else by a
    share of the largest entry. What is indefinite by more than rounding is left as it is.
    """
    Z = np.asarray(0.5 * (Z + np.swapaxes(Z, 1, 2)))
    return np.array([_shifted(block) for block in Z]).reshape(Z.shape)


def _shifted(block: Array) -> Array:
    if positive_semidefinite(block.tolist()):
        return block
    diagonal = np.diag(np.diagonal(block))
    identity = float(np.max(np.abs(block), initial=0.0)) * np.eye(len(block))
    for shift, tries in ((diagonal, _TRIES_OF_ENTRIES), (identity, _TRIES)):
        share = _EPS
        for _ in range(tries):
            trial = np.asarray(block + share * shift)
            if positive_semidefinite(trial.tolist()):
                return trial
            share *= 4.0
    return block


def feasible_theta(feasible: FeasibleSet, theta: Array) -> Array:
    """Return parameters whose bounds and margins hold exactly, where they do but for rounding.

    Bodies that are short of the margin by no more than `FEASIBLE` get the missing moments about
    their center of mass.
    """
    theta = np.array(theta, dtype=np.float64)
    inside = np.clip(theta, feasible.lower, feasible.upper)
    theta = np.where(np.abs(inside - theta) <= FEASIBLE, inside, theta)
    consistency, required = feasible.consistency, feasible.constraints.margin
    if consistency == "none":
        return theta

    def holds(body: Array) -> bool:
        return has_margin(body.tolist(), required, consistency)

    bodies = feasible.bodies(theta)
    near = feasible.margins(theta) >= required - FEASIBLE
    bodies[near] = raise_second_moments(
        bodies[near], required, consistency=consistency, holds=holds
    )
    return theta


def proven_margins(feasible: FeasibleSet, theta: Array) -> list[float | None] | None:
    """Return the largest margins that exact arithmetic confirms, to rounding.

    None for a body without a positive mass, and altogether where no consistency is demanded.
    """
    consistency, required = feasible.consistency, feasible.constraints.margin
    if consistency == "none":
        return None
    out: list[float | None] = []
    for body, found in zip(feasible.bodies(theta), feasible.margins(theta), strict=True):
        known = np.isfinite(found)
        out.append(proven_margin(body.tolist(), found, required, consistency) if known else None)
    return out


def proven_margin(body: Sequence[Any], found: float, required: float, consistency: str) -> float:
    """Return the largest margin of a body that exact arithmetic confirms, to rounding."""
    margin, step = float(found), _EPS * max(abs(float(each)) for each in body)
    while not has_margin(body, margin, consistency):
        margin, step = margin - step, 2.0 * step
    return required if margin < required and has_margin(body, required, consistency) else margin
