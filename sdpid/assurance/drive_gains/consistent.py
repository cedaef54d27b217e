"""Gains that fit currents best among links and loads that can exist.

Steps of Gauss and Newton, with the semidefinite program inside each: about the present gains and
links the product kappa · z is linear, and every link and every load is a body that matter can have.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.assurance.drive_gains.fit import GainFit
from sdpid.estimation.conic.retry import solve_with_retries
from sdpid.estimation.conic.solve import ConicProgram, Matrix, solve_conic
from sdpid.robot.inertia import matrix_basis

# What the currents do not show of the bodies: this pull, beside rows of variance one, chooses it.
_FAINT = 0.03
# Lengths in which bodies are measured, m, and the mass of one of which nothing is known, kg.
_LENGTH, _MASS = 0.1, 1.0
# A radius of gyration of links that are described without mass, m.
_GYRATION = 0.1

_REGULARIZATIONS = (1e-10, 1e-8)
# Steps, and the step of a logarithm that is none: a thousandth of what intervals are wide.
_STEPS, _SETTLED = 20, 1e-5


@dataclass(frozen=True, eq=False)
class Consistent:
    """Gains, links and loads of least cost.

    Attributes
    ----------
    log_kappa : ndarray, shape (n,)
    theta : ndarray, shape (p,)
        Links, and parameters that all joints share.
    loads : tuple of ndarray
        Ten parameters of each load about its frame's origin.
    z : ndarray, shape (q,)
        The same as base parameters and unknowns of the loads.
    cost : float
        As that of the fit without constraints.
    settled : bool
        Whether the last step was none.
    """

    log_kappa: Array
    theta: Array
    loads: tuple[Array, ...]
    z: Array
    cost: float
    settled: bool


class ConsistentFit:
    """The steps of a fit among bodies that can exist.

    Parameters
    ----------
    fit : GainFit
        The same without constraints.
    """

    def __init__(self, fit: GainFit) -> None:
        self.fit = fit
        model, robot = fit.model, fit.model.robot
        self.links = robot.n_links
        mass = np.where(robot.prior[:, 0] > 0.0, robot.prior[:, 0], _MASS)
        body = np.array([1.0, *(_LENGTH,) * 3, *(_LENGTH**2,) * 6])
        units = [*(mass[:, None] * body).ravel(), *np.ones(len(model.shared.parameters))]
        self.loads_at = []
        for load in fit.loads:
            width = load.free.shape[1]
            self.loads_at.append(slice(len(units), len(units) + width))
            units += list(load.load.mass * body[10 - width :])
        self.units = np.array(units)
        described = np.where(robot.prior[:, :1] > 0.0, robot.prior, 0.0)
        bare = np.array([1.0, 0, 0, 0, 1, 0, 1, 0, 0, 1]) * _GYRATION**2
        bare[0] = 1.0
        described[robot.prior[:, 0] <= 0.0] = _MASS * bare
        self.reference = np.zeros(len(units))
        self.reference[: described.size] = described.ravel()
        # From theta and the loads to z of the fit.
        b, p = model.base.matrix.shape
        q = fit.maps[0][0].shape[1]
        self.to_z = np.zeros((q, len(units)))
        self.to_z[:b, :p] = model.base.matrix
        self.to_z[b:, p:] = np.eye(q - b)

    def _blocks(self) -> tuple[Matrix, ...]:
        """Return the second-moment matrices of links and loads, scaled to the units."""
        basis = matrix_basis("pseudo_inertia")
        links = [
            Matrix(np.arange(10 * k, 10 * k + 10), basis, np.zeros((4, 4)))
            for k in range(self.links)
        ]
        found = []
        for load, where in zip(self.fit.loads, self.loads_at, strict=True):
            if where.stop == where.start:
                continue
            body = load.load.mass * np.array([1.0, *(_LENGTH,) * 3, *(_LENGTH**2,) * 6])
            constant = np.einsum("k,kij->ij", load.known / body, basis)
            found.append(
                Matrix(
                    np.arange(where.start, where.stop), basis[load.load.first_unknown :], constant
                )
            )
        return (*links, *found)

    def solve(self, start: Array, z: Array, free: Mask) -> Consistent:
        """Return where steps from gains and links end, some gains held."""
        log_kappa, fit = np.array(start), self.fit
        count, blocks = len(self.units), self._blocks()
        held = np.flatnonzero(free)
        settled, x = False, np.zeros(count)
        for _ in range(_STEPS):
            matrix, rhs = fit.linear(log_kappa)
            slopes = fit.slopes(log_kappa, z, len(rhs))[:, held]
            full = np.hstack([matrix @ self.to_z * self.units, -slopes])
            R = np.asarray(np.linalg.qr(np.column_stack([full, rhs]), mode="r"))
            pull = np.hstack([_FAINT * np.eye(count), np.zeros((count, len(held)))])
            reference = self.reference / self.units
            program = ConicProgram(
                M=np.vstack([R[:, :-1], pull]),
                m=-np.concatenate([R[:, -1], _FAINT * reference]),
                C=np.zeros((0, count + len(held))),
                lower=np.zeros(0),
                upper=np.zeros(0),
                blocks=blocks,
            )
            found = _solved(program)
            if found is None:
                break
            x, step = found[:count] * self.units, found[count:]
            z = self.to_z @ x
            log_kappa[held] += np.clip(step, -0.5, 0.5)
            if float(np.abs(step).max(initial=0.0)) < _SETTLED:
                settled = True
                break
        matrix, rhs = fit.linear(log_kappa)
        residual = rhs - matrix @ z
        loads = tuple(
            load.known + load.free @ x[where]
            for load, where in zip(fit.loads, self.loads_at, strict=True)
        )
        p = fit.model.base.matrix.shape[1]
        return Consistent(log_kappa, x[:p], loads, z, float(residual @ residual), settled)


def _solved(program: ConicProgram) -> Array | None:
    """Return the point of least cost, or the nearest to it that a solver came to."""
    return solve_with_retries(
        lambda regularization: solve_conic(program, regularization=regularization),
        _REGULARIZATIONS,
        lambda point, solution: (point, 0.0 if solution.solved else solution.error),
    ).value
