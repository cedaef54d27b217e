"""Gains that fit currents best, by variable projection.

For any gains the links, the loads' unknown parameters and the drives' friction are a linear
least-squares problem [golub2003]_. Friction does not depend on the gains and is projected away
once; what is left is a function of the n logarithms of kappa = 1 / gain alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.assurance.drive_gains.load import Mounted
from sdpid.assurance.drive_gains.rows import GainModel, RunRows

# Steps of Gauss and Newton; from good starts 5 to 15 are needed.
_STEPS = 60
# No logarithm moves by more in a step: a factor of two.
_LONGEST = 0.7
# A step, as a share of the gains, that is none.
_SETTLED = 1e-9
# A column of which friction leaves less than this share is explained by friction: a link's inertia
# about the axis of a drive that has an inertia of its own.
_EXPLAINED = 1e-9
# Singular values below this share of the largest are rounding.
_RANK = 1e-11


@dataclass(frozen=True, eq=False)
class JointSystem:
    """What is left of the rows of one joint once friction is projected away.

    ``current ≈ kappa · (matrix · z + known)``, z of the links and of the loads.

    Attributes
    ----------
    matrix : ndarray, shape (r, q)
    known : ndarray, shape (r,)
        Of what is known of the loads.
    current : ndarray, shape (r,)
    """

    matrix: Array
    known: Array
    current: Array


@dataclass(frozen=True, eq=False)
class Found:
    """Where a search for gains ended.

    Attributes
    ----------
    log_kappa : ndarray, shape (n,)
    z : ndarray, shape (q,)
        Links and loads.
    cost : float
        Weighted sum of squared currents' errors.
    settled : bool
        Whether the last step was none.
    """

    log_kappa: Array
    z: Array
    cost: float
    settled: bool


class GainFit:
    """The least-squares problem of gains, for one choice of weights.

    Parameters
    ----------
    model : GainModel
        What currents are explained by.
    runs : sequence of RunRows
        Recordings.
    loads : sequence of Mounted
        Loads that recordings carry.
    sigma : ndarray, shape (n,)
        Standard deviation of the currents' errors at each joint, A.
    knowledge : tuple of ndarray, optional
        Rows and right-hand side of what is known of z, with errors of variance one.
    """

    def __init__(
        self,
        model: GainModel,
        runs: Sequence[RunRows],
        loads: Sequence[Mounted],
        sigma: Array,
        knowledge: tuple[Array, Array] | None = None,
    ) -> None:
        self.model, self.runs, self.loads, self.sigma = model, tuple(runs), tuple(loads), sigma
        self.knowledge = knowledge

    @cached_property
    def maps(self) -> tuple[tuple[Array, Array], ...]:
        """Of each run the matrix (b, q) and the vector (b,) that make base parameters of z."""
        b = self.model.base.count
        widths = [load.free.shape[1] for load in self.loads]
        starts = b + np.concatenate([[0], np.cumsum(widths)]).astype(int)
        found = []
        for run in self.runs:
            matrix, known = np.zeros((b, starts[-1])), np.zeros(b)
            matrix[:, :b] = np.diag(self.model.own_share)
            if run.load is not None:
                load = self.loads[run.load]
                matrix[:, starts[run.load] : starts[run.load + 1]] = load.columns @ load.free
                known = load.columns @ load.known
            found.append((matrix, known))
        return tuple(found)

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.model.robot.n

    def friction_columns(self, j: int) -> tuple[tuple[int, ...], ...]:
        """Return where friction columns of each run stand among those of all runs of joint j."""
        separate = self.model.separate[self.model.of_joint(j)]
        shared, apart = int(np.sum(~separate)), int(np.sum(separate))
        found = []
        for number in range(len(self.runs)):
            first = shared + number * apart
            places = np.where(separate, first + np.cumsum(separate) - 1, np.cumsum(~separate) - 1)
            found.append(tuple(places.tolist()))
        return tuple(found)

    def _stacked(self, j: int) -> tuple[Array, int]:
        """Return the rows of joint j of all runs: friction, z, what is known, the current."""
        f = len(self.model.of_joint(j))
        places = self.friction_columns(j)
        count = max((max(each, default=-1) for each in places), default=-1) + 1
        stacked = []
        for run, (matrix, known), own in zip(self.runs, self.maps, places, strict=True):
            R = run.triangles[j]
            friction = np.zeros((len(R), count))
            friction[:, list(own)] = R[:, :f]
            links = R[:, f:-1]
            stacked.append(np.column_stack([friction, links @ matrix, links @ known, R[:, -1]]))
        return np.vstack(stacked), count

    def friction(self, j: int, log_kappa: Array, z: Array) -> Array:
        """Return the parameters of the drive of joint j, in A, of all runs."""
        rows, count = self._stacked(j)
        links = rows[:, count:-2] @ z + rows[:, -2]
        return _solved(rows[:, :count], rows[:, -1] - np.exp(log_kappa[j]) * links)[1]

    @cached_property
    def systems(self) -> tuple[JointSystem, ...]:
        """The rows of each joint without friction."""
        found = []
        for j in range(self.n):
            rows, count = self._stacked(j)
            left = _projected(rows[:, :count], rows[:, count:])
            R = np.asarray(np.linalg.qr(left, mode="r"))
            found.append(JointSystem(R[:, :-2], R[:, -2], R[:, -1]))
        return tuple(found)

    def linear(self, log_kappa: Array) -> tuple[Array, Array]:
        """Return matrix and right-hand side of the least-squares problem in z."""
        weights = np.exp(log_kappa) / self.sigma
        matrix = [w * each.matrix for w, each in zip(weights, self.systems, strict=True)]
        rhs = [
            each.current / s - w * each.known
            for w, s, each in zip(weights, self.sigma, self.systems, strict=True)
        ]
        if self.knowledge is not None:
            matrix.append(self.knowledge[0])
            rhs.append(self.knowledge[1])
        return np.vstack(matrix), np.concatenate(rhs)

    def at(self, log_kappa: Array) -> tuple[Array, Array, Array]:
        """Return best z, residual, and the residual's derivative by log kappa, z following."""
        matrix, rhs = self.linear(log_kappa)
        basis, z = _solved(matrix, rhs)
        slopes = self.slopes(log_kappa, z, len(rhs))
        return z, rhs - matrix @ z, slopes - basis @ (basis.T @ slopes)

    def slopes(self, log_kappa: Array, z: Array, rows: int) -> Array:
        """Return the residual's derivative by log kappa at fixed z, (rows, n)."""
        found, first = np.zeros((rows, self.n)), 0
        for j, each in enumerate(self.systems):
            stop = first + len(each.current)
            weight = np.exp(log_kappa[j]) / self.sigma[j]
            found[first:stop, j] = -weight * (each.matrix @ z + each.known)
            first = stop
        return found

    def search(self, start: Array, free: Mask) -> Found:
        """Return where Gauss-Newton steps with halving end, some gains held."""
        log_kappa = np.array(start, dtype=np.float64)
        z, residual, slopes = self.at(log_kappa)
        cost = float(residual @ residual)
        settled = not free.any()
        for _ in range(_STEPS):
            if settled:
                break
            step = np.zeros(self.n)
            step[free] = -np.linalg.lstsq(slopes[:, free], residual, rcond=_RANK)[0]
            step *= min(1.0, _LONGEST / max(float(np.abs(step).max()), 1e-300))
            size = 1.0
            while size > 1e-6:
                trial = log_kappa + size * step
                new = self.at(trial)
                value = float(new[1] @ new[1])
                if value <= cost:
                    break
                size *= 0.5
            else:
                settled = True
                break
            settled = float(np.abs(size * step).max()) < _SETTLED or cost - value <= 1e-14 * cost
            log_kappa, (z, residual, slopes), cost = trial, new, value
        return Found(log_kappa, z, cost, settled)


def _projected(nuisance: Array, others: Array) -> Array:
    """Return columns less what others explain of them."""
    size = np.linalg.norm(nuisance, axis=0)
    kept = nuisance[:, size > 0.0] / size[size > 0.0]
    if not kept.shape[1]:
        return others
    U, singular, _ = np.linalg.svd(kept, full_matrices=False)
    U = U[:, singular > _RANK * singular[0]]
    left = others - U @ (U.T @ others)
    # What is nothing but rounding must not be scaled up later.
    gone = np.linalg.norm(left, axis=0) < _EXPLAINED * np.linalg.norm(others, axis=0)
    left[:, gone] = 0.0
    return np.asarray(left)


def _solved(matrix: Array, rhs: Array) -> tuple[Array, Array]:
    """Return an orthonormal basis of the columns, and the least-squares solution."""
    size = np.linalg.norm(matrix, axis=0)
    size[size == 0.0] = 1.0
    U, singular, Vt = np.linalg.svd(matrix / size, full_matrices=False)
    keep = singular > _RANK * singular[0]
    U = U[:, keep]
    z = (Vt[keep].T / singular[keep]) @ (U.T @ rhs) / size
    return U, z
