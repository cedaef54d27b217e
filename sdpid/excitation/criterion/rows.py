"""The regressor of the base parameters along a motion, and its derivative by the motion."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from typing import Protocol

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.term import FrictionTerm, JointwiseTerm, SampledMotion
from sdpid.robot.model.base_parameters import BaseParameters, structural_base
from sdpid.robot.model.model import RobotModel

# Signs of the velocity are this wide while a motion is searched, rad/s (m/s): a step has no
# derivative that could tell a search where to go. Those of joints that are slower than most, such
# as fingers, are a share of their usual speed wide: wider ones would look like viscous friction.
SMOOTH_WIDTH, _SMOOTH_SHARE, _SMOOTH_LEAST = 0.05, 0.2, 1e-3

# Steps of differences. Efforts of rigid bodies are quadratic in velocities and linear in
# accelerations, so that differences over a step of any size are exact; those of positions and of
# friction are central, and err by the square of their step.
_POSITION_STEP = 1e-5
_FRICTION_STEP = 1e-5


# Bytes of rows that are written at a time.
_BLOCK = 1 << 26


class StateRows(Protocol):
    """Rows of the base parameters, state by state, with their derivatives."""

    @property
    def count(self) -> int:
        """Number b of base parameters."""

    def rows(self, q: Array, v: Array, a: Array) -> Array:
        """Return W (K, r, b) at states (K, n)."""

    def gradient(self, C: Array, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
        """Return the derivatives (K, n) of ``sum(C * rows(q, v, a))`` for constant C."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BaseRows:
    """The regressor of a robot's base parameters, state by state.

    Attributes
    ----------
    robot : RobotModel
        The robot; derivatives are those of one on a fixed base.
    friction : FrictionModel
        Its friction terms; signs are smooth where the rows serve a search.
    base : BaseParameters
        The base parameters of both.
    """

    robot: RobotModel
    friction: FrictionModel
    base: BaseParameters

    @classmethod
    def of(cls, robot: RobotModel, friction: Iterable[str | FrictionTerm]) -> BaseRows:
        """Build from a robot and friction terms.

        Raises
        ------
        ModelError
            When a friction term is unknown, or does not fit the robot.
        IdentifiabilityError
            When no rank can be decided.
        """
        model = FrictionModel.from_terms(friction, robot.joint_names, first=robot.n_base)
        return cls(robot=robot, friction=model, base=structural_base(robot, model))

    @property
    def count(self) -> int:
        """Number b of base parameters."""
        return self.base.count

    def smooth(self, velocity: Array | None = None) -> BaseRows:
        """Return the same rows with signs that are smooth enough for a search.

        Parameters
        ----------
        velocity : ndarray, shape (K, n), optional
            Velocities of usual motions, where joints may be slow.
        """
        widths: Array | float = SMOOTH_WIDTH
        if velocity is not None:
            usual = np.sqrt(np.mean(velocity**2, axis=0))
            widths = np.clip(_SMOOTH_SHARE * usual, _SMOOTH_LEAST, SMOOTH_WIDTH)
        terms = tuple(_smooth(term, widths) for term in self.friction.terms)
        return replace(self, friction=replace(self.friction, terms=terms))

    def rows(self, q: Array, v: Array, a: Array) -> Array:
        """Return W (K, n, b) at states (K, ·), with ``effort = W @ base``."""
        out = np.empty((len(q), self.robot.n, self.count))
        out[:, :, self._inertial] = self._links(q, v, a)
        out[:, :, ~self._inertial] = self._friction(q, v, a)
        return out

    def gradient(self, C: Array, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
        """Return the derivatives of ``sum(C * rows(q, v, a))`` for constant C (K, n, b).

        Returns
        -------
        by_position, by_velocity, by_acceleration : ndarray, shape (K, n)
        """
        inertial = C[:, :, self._inertial]
        # Bytes of a state's shifted rows; robots of a hundred joints go state by state.
        size = 8 * (5 * self.robot.n + 1) * inertial[0].size
        count = max(1, _BLOCK // max(size, 1))
        parts = [
            self._links_gradient(*(each[k : k + count] for each in (inertial, q, v, a)))
            for k in range(0, len(q), count)
        ]
        on_links = tuple(np.concatenate(part) for part in zip(*parts, strict=True))
        if not self.friction.parameters:
            return on_links[0], on_links[1], on_links[2]
        on_friction = self._friction_gradient(C[:, :, ~self._inertial], q, v, a)
        by_position, by_velocity, by_acceleration = (
            links + friction for links, friction in zip(on_links, on_friction, strict=True)
        )
        return by_position, by_velocity, by_acceleration

    @property
    def _inertial(self) -> Mask:
        """Which base parameters lead with a link's."""
        return np.asarray(self.base.kept < 10 * self.robot.n_links)

    def _links(self, q: Array, v: Array, a: Array) -> Array:
        """Return the columns (K, n, ·) of the links' base parameters."""
        places = np.full(10 * self.robot.n_links, -1)
        kept = self.base.kept[self._inertial]
        places[kept] = np.arange(len(kept))
        out = np.empty((len(q), self.robot.n, len(kept)))
        return self.robot.regressor_columns(q, v, a, places=places, out=out)

    def _friction(self, q: Array, v: Array, a: Array) -> Array:
        """Return the columns (K, n, ·) of the friction's base parameters."""
        kept = self.base.kept[~self._inertial] - 10 * self.robot.n_links
        first = self.friction.first
        motion = SampledMotion(
            position=q, velocity=v[:, first:], acceleration=a[:, first:], robot=self.robot
        )
        return np.asarray(self.friction.columns_in(motion)[:, :, kept])

    def _links_gradient(self, C: Array, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
        K, n = q.shape
        steps = np.eye(n)[:, None, :]
        ahead = _POSITION_STEP * steps
        # All states in one call: the compiled loop is worth its start only on many.
        moved = [q + ahead, q - ahead, q, q, q, q]
        speeds = [v, v, v + steps, v - steps, v, v]
        rates = [a, a, a, a, a + steps, a]
        shape = [(n, K, n)] * 5 + [(1, K, n)]
        stacked = [
            np.concatenate([np.broadcast_to(part, s) for part, s in zip(parts, shape, strict=True)])
            for parts in (moved, speeds, rates)
        ]
        W = self._links(*(part.reshape(-1, n) for part in stacked)).reshape(-1, K, C[0].size)
        # Per state and per shift the sum of C times the rows.
        sums = np.matmul(W.transpose(1, 0, 2), C.reshape(K, -1, 1))[:, :, 0]
        up, down, faster, slower, pushed, here = np.split(sums, n * np.arange(1, 6), axis=1)
        return (up - down) / (2.0 * _POSITION_STEP), (faster - slower) / 2.0, pushed - here

    def _friction_gradient(
        self, C: Array, q: Array, v: Array, a: Array
    ) -> tuple[Array, Array, Array]:
        n = q.shape[1]
        posed = any(term.posed for term in self.friction.terms)
        # Of terms whose joints have nothing to do with each other, all joints are moved at once.
        apart = all(isinstance(term, JointwiseTerm) for term in self.friction.terms)
        out = [np.zeros_like(q) for _ in range(3)]
        for order in range(0 if posed else 1, 3):
            for j in [slice(None)] if apart else range(n):
                sums = []
                for sign in (1.0, -1.0):
                    state = [q, v, a]
                    state[order] = state[order].copy()
                    state[order][:, j] += sign * _FRICTION_STEP
                    sums.append(np.einsum("kjb,kjb->kj", C, self._friction(*state)))
                slope = (sums[0] - sums[1]) / (2.0 * _FRICTION_STEP)
                out[order][:, j] = slope if apart else slope.sum(axis=1)
        return out[0], out[1], out[2]


def _smooth(term: FrictionTerm, widths: Array | float) -> FrictionTerm:
    """Return a term whose signs are at least as wide as a search needs; open widths become that."""
    if "width" not in {field.name for field in fields(term)}:  # type: ignore[arg-type]
        return term
    wide = np.maximum(term.width or 0.0, widths)  # type: ignore[attr-defined]
    return replace(term, width=tuple(wide) if wide.ndim else float(wide))  # type: ignore[type-var]
