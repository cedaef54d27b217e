"""Limits that are no linear functions of a motion's coefficients, held on a grid of instants.

Between the instants they may be broken by a little: the check that follows the search is exact,
and says where; then the search goes on with those instants too, or with a wider margin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.kept import last_kept
from sdpid.excitation.geometry.collision import CollisionModel
from sdpid.excitation.search.space import Space

# Entries of the matrices of a motion below this share of the largest are zero.
_ZERO = 1e-12


class StateInequality(Protocol):
    """Functions of a state that are to be at least zero."""

    def evaluate(self, q: Array, v: Array, a: Array) -> Array:
        """Return their values (K, r) at states (K, n), in shares of their limits."""

    def derivatives(self, q: Array, v: Array, a: Array) -> tuple[Array | None, ...]:
        """Return derivatives (K, r, n) by position, velocity and acceleration; None for zero."""


@dataclass(frozen=True, kw_only=True, eq=False)
class InstantRows:
    """Inequalities at the instants at which each is to hold, as functions of free numbers.

    Attributes
    ----------
    space : Space
        The motions.
    parts : sequence of (StateInequality, ndarray (K,))
        Each inequality and its instants in s.
    """

    space: Space
    parts: Sequence[tuple[StateInequality, Array]]

    @cached_property
    def _matrices(self) -> list[list[Array]]:
        return [[self.space.basis(time, order) for order in range(3)] for _, time in self.parts]

    @cached_property
    def _by_free(self) -> list[list[list[Array]]]:
        """Matrices from the free numbers of each joint, part by part and order by order."""
        return [
            [[matrix @ E for E in self.space.expansions] for matrix in matrices]
            for matrices in self._matrices
        ]

    def _states(self, part: int, x: Array) -> list[Array]:
        c = self.space.coefficients(x)
        return [matrix @ c for matrix in self._matrices[part]]

    @cached_property
    def pattern(self) -> Any:
        """Where the derivative may differ from zero, a boolean array (R, N)."""
        blocks = []
        for i, (inequality, _) in enumerate(self.parts):
            one = (state[:1] for state in self._states(i, np.zeros(self.space.size)))
            count = inequality.evaluate(*one).shape[1]
            used = sum(np.abs(m) > _ZERO * np.abs(m).max() for m in self._matrices[i])
            own = np.hstack([used @ (E != 0.0) > 0 for E in self.space.expansions])
            blocks.append(np.repeat(own, count, axis=0))
        return np.vstack(blocks)

    def values(self, x: Array) -> Array:
        """Return all functions (R,), instant by instant."""
        found = (each.evaluate(*self._states(i, x)) for i, (each, _) in enumerate(self.parts))
        return np.concatenate([values.ravel() for values in found])

    def hold(self, x: Array) -> bool:
        """Return whether a motion (N,) is within all of them."""
        return bool(np.min(self.values(x)) > 0.0)

    def derivative(self, x: Array) -> Array:
        """Return the derivative (R, N)."""
        blocks = []
        for i, (inequality, _) in enumerate(self.parts):
            by_state = inequality.derivatives(*self._states(i, x))
            parts = [
                (m, s) for m, s in zip(self._by_free[i], by_state, strict=True) if s is not None
            ]
            out = np.zeros((*parts[0][1].shape[:2], self.space.size))
            for matrices, slopes in parts:
                for j, matrix in enumerate(matrices):
                    own = slice(self.space.splits[j], self.space.splits[j + 1])
                    out[:, :, own] += slopes[:, :, j, None] * matrix[:, None, :]
            blocks.append(out.reshape(-1, self.space.size))
        return np.vstack(blocks)


# Slacks of distances are counted in this length, m, and the soft minimum over pairs is below the
# least one by at most log(P) over this, 1/m: a centimeter for twenty pairs that are alike near.
_LENGTH = 0.1
_SHARPNESS = 300.0


@dataclass(frozen=True, kw_only=True, eq=False)
class KeptDistance:
    """Distances of all pairs are at least their clearance.

    Attributes
    ----------
    collision : CollisionModel
        The pairs.
    clearance : float
        The wanted clearance, m.
    margin : float
        What is kept beyond it, m, for what happens between the instants.
    """

    collision: CollisionModel
    clearance: float
    margin: float = 0.0

    def evaluate(self, q: Array, v: Array, a: Array) -> Array:
        """Return the soft least slack (K, 1), in shares of 0.1 m."""
        return self._least(q)[0]

    def derivatives(self, q: Array, v: Array, a: Array) -> tuple[Array | None, ...]:
        """Return its derivative by position (K, 1, n)."""
        return self._least(q)[1], None, None

    @last_kept
    def _least(self, q: Array) -> tuple[Array, Array]:
        slack, slope = self.collision.soft_minimum(
            q, _SHARPNESS, clearance=self.clearance, beyond=self.margin
        )
        return slack[:, None] / _LENGTH, slope[:, None, :] / _LENGTH
