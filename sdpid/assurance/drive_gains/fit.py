"""Gains that fit currents best, by variable projection.

For any gains the links, the loads' unknown parameters and the drives' friction are a linear
least-squares problem [golub2003]_. Friction does not depend on the gains and is projected away
once; what is left is a function of the n logarithms of kappa = 1 / gain alone.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.assurance.drive_gains.load import Load
from sdpid.assurance.drive_gains.rows import GainModel, RunRows
from sdpid.estimation.information import information_root, least_squares

# Steps of Gauss and Newton; from good starts 5 to 15 are needed.
_STEPS = 60
# No logarithm moves by more in a step: a factor of two.
_LONGEST = 0.7
# A step, as a share of the gains, that is none.
_SETTLED = 1e-9
# A column of which friction leaves less than this share is explained by friction: a link's inertia
# about the axis of a drive that has an inertia of its own.
_EXPLAINED = 1e-9
# A least standard deviation of a current's errors, as a share of the currents: rounding.
_LEAST_SIGMA = 1e-6
# Singular values below this share of the largest are rounding.
_RANK = 1e-11


@dataclass(frozen=True, eq=False)
class Found:
    """Where a search for gains ended.

    Attributes
    ----------
    log_kappa : ndarray, shape (n,)
    z : ndarray, shape (q,)
        Links as base parameters, then what is not known of the loads.
    cost : float
        Weighted sum of squared currents' errors.
    settled : bool
        Whether the last step was none.
    theta : ndarray, shape (p,), or None
        Links, and parameters that all joints share, where they were demanded to exist.
    """

    log_kappa: Array
    z: Array
    cost: float
    settled: bool
    theta: Array | None = None


class GainFit:
    """The least-squares problem of gains, for one choice of weights.

    Parameters
    ----------
    model : GainModel
        What currents are explained by.
    runs : sequence of RunRows
        Recordings.
    loads : sequence of Load
        What is known of the loads that recordings carry.
    columns : ndarray, shape (b, 10)
        What a load's ten parameters add to the base parameters.
    knowledge : tuple of ndarray, optional
        Rows and right-hand side of what is known of z, with errors of variance one.
    errors : ndarray, shape (n,), optional
        Mean squares of the currents' errors at each joint, A²: the weights. By default those of
        each recording explained alone.

    Attributes
    ----------
    sigma : ndarray, shape (n,)
        Standard deviations of the currents' errors.
    spread : ndarray, shape (n,)
        Those of the currents about their means.
    alone : ndarray, shape (n,)
        Mean squared errors of the currents, each recording explained alone, A². Such a fit knows no
        gains: the links at each joint are its own.
    loads_at : tuple of slice
        Where the unknowns of each load stand in z.
    """

    def __init__(
        self,
        model: GainModel,
        runs: Sequence[RunRows],
        loads: Sequence[Load],
        columns: Array,
        knowledge: tuple[Array, Array] | None = None,
        errors: Array | None = None,
    ) -> None:
        self.model, self.runs, self.loads, self.columns = model, tuple(runs), tuple(loads), columns
        self.knowledge, self.n = knowledge, model.robot.n
        self._used = np.maximum(np.sum([run.used for run in runs], axis=0), 1.0)
        self.spread = np.sqrt(np.sum([run.squares for run in runs], axis=0) / self._used)
        left = [[R[-1, -1] ** 2 for R in run.triangles] for run in runs]
        self.alone = np.sum(left, axis=0) / self._used
        least = np.maximum(_LEAST_SIGMA * self.spread, 1e-300)
        self.sigma = np.maximum(np.sqrt(self.alone if errors is None else errors), least)
        widths = [10 - load.first_unknown for load in self.loads]
        ends = np.cumsum([model.base.count, *widths])
        self.loads_at = tuple(slice(*pair) for pair in itertools.pairwise(ends.tolist()))
        self.q = int(ends[-1])

    def maps(self, j: int) -> tuple[list[Array], int]:
        """Return what takes the columns of joint j in each run to those of all runs.

        These are friction, z, what is known of the loads, and the current; and how many are of
        friction: of each run its own, but for those that are shared.
        """
        model, found = self.model, []
        separate, b = model.separate[model.of_joint(j)], model.base.count
        f, apart = len(separate), int(np.sum(separate))
        count = f - apart + apart * len(self.runs)
        for number, run in enumerate(self.runs):
            T = np.zeros((f + b + 1, count + self.q + 2))
            own = f - apart + number * apart + np.cumsum(separate) - 1
            T[np.arange(f), np.where(separate, own, np.cumsum(~separate) - 1)] = 1.0
            links, z = T[f:-1], T[f:-1, count:-2]
            z[:, :b] = np.diag(model.own_share)
            if run.load is not None:
                load = self.loads[run.load]
                z[:, self.loads_at[run.load]] = self.columns[:, load.first_unknown :]
                links[:, -2] = self.columns @ load.theta
            T[-1, -1] = 1.0
            found.append(T)
        return found, count

    @cached_property
    def stacked(self) -> tuple[tuple[Array, int], ...]:
        """The rows of each joint in these columns, and how many are of friction."""
        found = []
        for j in range(self.n):
            maps, count = self.maps(j)
            rows = [run.triangles[j] @ T for run, T in zip(self.runs, maps, strict=True)]
            found.append((np.vstack(rows), count))
        return tuple(found)

    def friction(self, j: int, log_kappa: Array, z: Array) -> Array:
        """Return the parameters of the drive of joint j, in A, of all runs."""
        rows, count = self.stacked[j]
        links = rows[:, count:-2] @ z + rows[:, -2]
        return least_squares(rows[:, :count], rows[:, -1] - np.exp(log_kappa[j]) * links)

    @cached_property
    def systems(self) -> tuple[tuple[Array, Array, Array], ...]:
        """Of each joint without friction: current ≈ kappa·(matrix·z + known), these three."""
        found = []
        for rows, count in self.stacked:
            R = np.asarray(np.linalg.qr(_projected(rows[:, :count], rows[:, count:]), mode="r"))
            found.append((R[:, :-2], R[:, -2], R[:, -1]))
        return tuple(found)

    def linear(self, log_kappa: Array) -> tuple[Array, Array]:
        """Return matrix and right-hand side of the least-squares problem in z."""
        matrices, rhs = [], []
        for kappa, s, (matrix, known, current) in zip(
            np.exp(log_kappa), self.sigma, self.systems, strict=True
        ):
            matrices.append(kappa / s * matrix)
            rhs.append((current - kappa * known) / s)
        if self.knowledge is not None:
            matrices.append(self.knowledge[0])
            rhs.append(self.knowledge[1])
        return np.vstack(matrices), np.concatenate(rhs)

    def at(self, log_kappa: Array) -> tuple[Array, Array, Array]:
        """Return best z, residual, and the residual's derivative by log kappa, z following."""
        matrix, rhs = self.linear(log_kappa)
        root = information_root(matrix)
        basis = matrix @ root
        z = root @ (basis.T @ rhs)
        slopes = self.slopes(log_kappa, z, len(rhs))
        return z, rhs - matrix @ z, slopes - basis @ (basis.T @ slopes)

    def slopes(self, log_kappa: Array, z: Array, rows: int) -> Array:
        """Return the residual's derivative by log kappa at fixed z, (rows, n)."""
        found, first = np.zeros((rows, self.n)), 0
        for j, (matrix, known, current) in enumerate(self.systems):
            stop = first + len(current)
            weight = np.exp(log_kappa[j]) / self.sigma[j]
            found[first:stop, j] = -weight * (matrix @ z + known)
            first = stop
        return found

    def errors(self, found: Found) -> Array:
        """Return the mean squared errors of each joint's current, (n,), A²."""
        left = [
            current - kappa * (matrix @ found.z + known)
            for kappa, (matrix, known, current) in zip(
                np.exp(found.log_kappa), self.systems, strict=True
            )
        ]
        return np.asarray([float(each @ each) for each in left] / self._used)

    def load_parameters(self, z: Array) -> list[Array]:
        """Return the ten parameters of each load about its frame's origin."""
        pairs = zip(self.loads, self.loads_at, strict=True)
        return [load.theta + np.eye(10)[:, load.first_unknown :] @ z[own] for load, own in pairs]

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
    basis = nuisance @ information_root(nuisance)
    left = others - basis @ (basis.T @ others)
    # What is nothing but rounding must not be scaled up later.
    gone = np.linalg.norm(left, axis=0) < _EXPLAINED * np.linalg.norm(others, axis=0)
    left[:, gone] = 0.0
    return np.asarray(left)
