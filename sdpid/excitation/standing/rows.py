"""What a sample of a standing robot tells: rows that no force of the ground enters."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from sdpid._common.arrays import Array
from sdpid.excitation.criterion.rows import smoothed
from sdpid.excitation.standing.jets import Jets
from sdpid.excitation.standing.stance import Stance, StanceStates
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.term import FrictionTerm, SampledMotion
from sdpid.robot.model.base_parameters import BaseParameters, structural_base

# Bytes of regressors that are made at a time.
_BLOCK = 1 << 24


@dataclass(frozen=True, kw_only=True, eq=False)
class StandingRows:
    """Whitened rows of a stance: one for each coordinate.

    They are the equations of motion along the motions that the feet leave free: ``L^-1·N^T·Y``
    with N these motions, and ``L·L^T = N^T·S·N`` for errors of covariance S. Their products are
    those of the rows that an estimate uses, which are projected onto the null space of the
    contacts (docs/theory/model.md): the columns of N are a basis of it.

    Attributes
    ----------
    stance : Stance
        The robot on its feet.
    friction : FrictionModel
        Friction of its joints.
    base : BaseParameters
        The base parameters of both.
    spread : ndarray, shape (n,)
        Spectral density of the errors of each row of the equations of motion: of the base's in
        N²·s and (N·m)²·s, of the joints' in (N·m)²·s.
    """

    stance: Stance
    friction: FrictionModel
    base: BaseParameters
    spread: Array

    @classmethod
    def of(cls, stance: Stance, friction: Iterable[str | FrictionTerm]) -> StandingRows:
        """Build from friction terms, with errors of one in all rows."""
        robot = stance.robot
        model = FrictionModel.from_terms(friction, robot.joint_names, first=robot.n_base)
        base = structural_base(robot, model)
        return cls(stance=stance, friction=model, base=base, spread=np.ones(robot.n))

    @property
    def count(self) -> int:
        """Number b of base parameters."""
        return self.base.count

    def smooth(self) -> StandingRows:
        """Return the same rows with signs that are smooth enough for a search."""
        return replace(self, friction=smoothed(self.friction))

    def rows(self, q: Array, v: Array, a: Array) -> Array:
        """Return W (K, m, b) at coordinates (K, m) and their first and second derivatives."""
        return self.of_states(self.stance.states(self.stance.poses(q), v, a))

    def of_states(self, states: StanceStates) -> Array:
        """Return W (K, m, b)."""
        poses = states.poses
        N = poses.basis
        L = np.linalg.cholesky(np.einsum("kni,n,knj->kij", N, self.spread, N, optimize=True))
        return np.asarray(np.linalg.solve(L, np.swapaxes(N, 1, 2) @ self.regressor(states)))

    def regressor(self, states: StanceStates) -> Array:
        """Return the rows Y (K, n, b) of the base parameters with all forces in them."""
        robot, base = self.stance.robot, self.base
        q, v, a = states.poses.configuration, states.velocity, states.acceleration
        links = 10 * robot.n_links
        inertial = base.kept < links
        places = np.full(links, -1)
        places[base.kept[inertial]] = np.arange(np.count_nonzero(inertial))
        out = np.empty((len(q), robot.n, self.count))
        own = np.empty((len(q), robot.n, np.count_nonzero(inertial)))
        out[:, :, inertial] = robot.regressor_columns(q, v, a, places=places, out=own)
        first = self.friction.first
        motion = SampledMotion(
            position=q, velocity=v[:, first:], acceleration=a[:, first:], robot=robot
        )
        kept = base.kept[~inertial] - links
        out[:, :, ~inertial] = self.friction.columns_in(motion)[:, :, kept]
        return out

    def gradient(self, C: Array, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
        """Return the derivatives (K, m) of ``sum(C * rows(q, v, a))`` for constant C (K, m, b)."""
        jets = Jets.of(self.stance, q, v, a)
        here = np.einsum("kmb,kmb->k", C, self.of_states(jets.here))
        aside = np.empty(5 * self.stance.n * len(q))
        which = np.tile(np.arange(len(q)), 5 * self.stance.n)
        # In blocks: the regressors of all at once would take gigabytes of humanoids.
        count = max(1, _BLOCK // (8 * self.stance.robot.n * self.count))
        for k in range(0, len(aside), count):
            some = np.arange(k, min(k + count, len(aside)))
            states = jets.aside.take(some)
            aside[some] = np.einsum("kmb,kmb->k", C[which[some]], self.of_states(states))
        return Jets.slopes(here, aside)
