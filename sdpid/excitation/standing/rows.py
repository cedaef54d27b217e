"""What a sample of a standing robot tells: rows that no force of the ground enters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.excitation.criterion.rows import BaseRows
from sdpid.excitation.standing.stance import Stance, StanceStates, slopes

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
    regressor : BaseRows
        The equations of motion with all forces in them, and friction of the joints.
    spread : ndarray, shape (n,)
        Spectral density of the errors of each of these: of the base's in N²·s and (N·m)²·s, of the
        joints' in (N·m)²·s.
    """

    stance: Stance
    regressor: BaseRows
    spread: Array

    @property
    def count(self) -> int:
        """Number b of base parameters."""
        return self.regressor.count

    def rows(self, q: Array, v: Array, a: Array) -> Array:
        """Return W (K, m, b) at coordinates (K, m) and their first and second derivatives."""
        return self.of_states(self.stance.at(q, v, a))

    def of_states(self, states: StanceStates) -> Array:
        """Return W (K, m, b)."""
        poses = states.poses
        N = poses.basis
        L = np.linalg.cholesky(np.einsum("kni,n,knj->kij", N, self.spread, N, optimize=True))
        Y = self.regressor.rows(poses.configuration, states.velocity, states.acceleration)
        return np.asarray(np.linalg.solve(L, np.swapaxes(N, 1, 2) @ Y))

    def gradient(self, C: Array, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
        """Return the derivatives (K, m) of ``sum(C * rows(q, v, a))`` for constant C (K, m, b)."""
        stance = self.stance
        beside = stance.beside(q, v, a)
        here = np.einsum("kmb,kmb->k", C, self.rows(q, v, a))
        which = np.tile(np.arange(len(q)), 5 * stance.n)
        # In blocks: the regressors of all at once would take gigabytes of humanoids.
        count = max(1, _BLOCK // (8 * stance.robot.n * self.count))
        aside = [
            np.einsum("kmb,kmb->k", C[which[some]], self.of_states(beside.take(some)))
            for some in np.split(np.arange(len(which)), range(count, len(which), count))
        ]
        return slopes(here, np.concatenate(aside))
