"""Gains that fit currents best among links and loads that can exist.

Steps of Gauss and Newton, with the semidefinite program inside each: about the present gains and
links the product kappa · z is linear, and every link and every load is a body that matter can have.
"""

from __future__ import annotations

import functools

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.assurance.drive_gains.fit import Found, GainFit
from sdpid.estimation.conic.solve import ConicProgram, Matrix, solve_conic, solve_with_retries
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
        basis, body = matrix_basis("pseudo_inertia"), _LENGTH ** np.array([0, 1, 1, 1, *[2] * 6])
        known = robot.prior[:, :1] > 0.0
        mass = np.where(known, robot.prior[:, :1], _MASS)
        unknown = _MASS * np.array([1.0, 0, 0, 0, *(_GYRATION**2 * np.array([1, 0, 1, 0, 0, 1]))])
        described = np.where(known, robot.prior, unknown)
        shared = len(model.shared.parameters)
        # Of links and what joints share, then of loads.
        units = [*(mass * body).ravel(), *np.ones(shared)]
        self.reference = [*described.ravel(), *np.zeros(shared)]
        blocks = [
            Matrix(np.arange(10 * k, 10 * k + 10), basis, np.zeros((4, 4)))
            for k in range(robot.n_links)
        ]
        for each in fit.loads:
            own, first = each.mass * body, each.first_unknown
            places = np.arange(len(units), len(units) + 10 - first)
            if len(places):
                constant = np.einsum("k,kij->ij", each.theta / own, basis)
                blocks.append(Matrix(places, basis[first:], constant))
            units += own[first:].tolist()
            self.reference += [0.0] * len(places)
        self.units, self.blocks = np.array(units), tuple(blocks)
        # From theta and the loads to z of the fit.
        b, p = model.base.matrix.shape
        self.to_z = np.zeros((fit.q, len(units)))
        self.to_z[:b, :p] = model.base.matrix
        self.to_z[b:, p:] = np.eye(fit.q - b)

    def solve(self, start: Array, z: Array, free: Mask) -> Found:
        """Return where steps from gains and links end, some gains held."""
        log_kappa, fit = np.array(start), self.fit
        count, moving = len(self.units), np.flatnonzero(free)
        width = count + len(moving)
        pull = _FAINT * np.eye(count, width)
        settled, x = False, np.zeros(count)
        for _ in range(_STEPS):
            matrix, rhs = fit.linear(log_kappa)
            slopes = fit.slopes(log_kappa, z, len(rhs))[:, moving]
            full = np.column_stack([matrix @ self.to_z * self.units, -slopes, rhs])
            R = np.asarray(np.linalg.qr(full, mode="r"))
            program = ConicProgram(
                M=np.vstack([R[:, :-1], pull]),
                m=-np.concatenate([R[:, -1], _FAINT * np.array(self.reference) / self.units]),
                C=np.zeros((0, width)),
                lower=np.zeros(0),
                upper=np.zeros(0),
                blocks=self.blocks,
            )
            # The point of least cost, or the nearest to it that the solver came to.
            found = solve_with_retries(
                functools.partial(solve_conic, program),
                _REGULARIZATIONS,
                lambda point, solution: (point, 0.0 if solution.solved else solution.error),
            ).value
            if found is None:
                break
            x, step = found[:count] * self.units, found[count:]
            z = self.to_z @ x
            log_kappa[moving] += np.clip(step, -0.5, 0.5)
            if float(np.abs(step).max(initial=0.0)) < _SETTLED:
                settled = True
                break
        matrix, rhs = fit.linear(log_kappa)
        residual = rhs - matrix @ z
        theta = x[: fit.model.base.matrix.shape[1]]
        return Found(log_kappa, z, float(residual @ residual), settled, theta)
