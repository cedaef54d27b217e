"""Estimates of the real arms (least squares, ridge regression, what `identify` returns), let go of.

A released arm is helped by no motor: gravity and friction act.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from data_sets import Records

import sdpid
from sdpid.assurance.diagnostics.bands import held_out_blocks, predicted_by
from sdpid.assurance.diagnostics.held_out import DESCRIPTION, FRICTION_FITTED, LEAST_SQUARES, OURS
from sdpid.assurance.diagnostics.validation import Validation
from sdpid.estimation.prior.prior import prior_terms

# The second differs from ours by the inequality alone.
METHODS = ("least squares", "ridge, our prior", "ridge, cross-validated", "this package")

# What users have before they identify, beside what they get, as `identify` compares them.
MODELS = {
    "URDF as it is": DESCRIPTION,
    "URDF, friction fitted": FRICTION_FITTED,
    "least squares": LEAST_SQUARES,
    "this package": OURS,
}

# Strengths of the ridge in nats; cross-validation takes one that is not at an end.
STRENGTHS = tuple(10.0 ** np.arange(-4.0, 3.1, 0.5))

# Speeds, rad/s, at which friction must take power, and the share of the largest that rounding is.
SPEEDS = np.concatenate([-np.geomspace(100.0, 1e-3, 200), np.geomspace(1e-3, 100.0, 200)])
POWER = 1e-12

# Positions of the recorded motion that mass matrices are looked at.
POSITIONS = 500


@dataclass(frozen=True)
class Arm:
    """A real arm and its estimates.

    Attributes
    ----------
    name : str
        The robot.
    log : Recording
        What was fitted.
    result : Identification
        What `sdpid.identify` returns with its defaults.
    ridges : tuple of Estimate
        Regression towards the description: with the prior of ours, and with units scaled link by
        link and the strength that predicts best.
    ridge_fits : tuple of Validation
        Their errors on what was held out.
    """

    name: str
    log: Any
    result: Any
    ridges: tuple[Any, Any]
    ridge_fits: tuple[Any, Any]

    @property
    def estimates(self) -> dict[str, Any]:
        """The estimates by method."""
        every = (self.result.wls, *self.ridges, self.result.estimate)
        return dict(zip(METHODS, every, strict=True))

    def model(self, method: str) -> Any:
        """Return the arm to simulate with: inertias, gravity and rotors of a method.

        Friction is that of ours for every method, so that inertias alone make the difference.
        """
        own, ours = self.estimates[method].model(), self.result.estimate.model()
        names = self.result.problem.base.theta_names
        friction = np.array([name.startswith("F") for name in names])
        return replace(own, theta=np.where(friction, ours.theta, own.theta))

    @property
    def time(self) -> np.ndarray:
        """Seconds since the start at which mass matrices are looked at."""
        return np.asarray(self.log.time[:: self._stride] - self.log.time[0])

    @property
    def _stride(self) -> int:
        return max(1, self.log.n_samples // POSITIONS)

    @cached_property
    def eigenvalues(self) -> dict[str, np.ndarray]:
        """Least eigenvalues of the mass matrix, rotors included, on the recorded motion."""
        q = self.log.position[:: self._stride]
        return {
            method: np.linalg.eigvalsh(estimate.model().mass_matrix(q))[:, 0]
            for method, estimate in self.estimates.items()
        }

    @cached_property
    def smallest(self) -> dict[str, Any]:
        """Least eigenvalues of the links' mass matrix over all postures: found, and proven.

        Rotors only add to them.
        """
        return {
            method: sdpid.smallest_mass_eigenvalue(estimate)
            for method, estimate in self.estimates.items()
        }

    @property
    def proven(self) -> float | None:
        """Number that is proven to be below every eigenvalue of our mass matrix."""
        return self.smallest[METHODS[-1]].lower_bound

    @cached_property
    def driving(self) -> dict[str, int]:
        """Number of joints whose friction drives them at some speed, by method."""
        still = np.zeros(self.log.position.shape[1])
        counts = {}
        for method, estimate in self.estimates.items():
            friction = estimate.model().friction
            speeds = SPEEDS[:, None] + still
            power = (friction(speeds) - friction(still)) * speeds
            counts[method] = int((power < -POWER * np.abs(power).max()).any(axis=0).sum())
        return counts

    @property
    def missed(self) -> dict[str, float]:
        """Relative errors of what users could take on what was held out, in motion."""
        every = self.result.held_out.every
        return {name: every[key].moving.relative for name, key in MODELS.items()}

    @property
    def held_out(self) -> dict[str, float]:
        """Relative errors on what was held out, in motion."""
        every = self.result.held_out.every
        fits = (every[LEAST_SQUARES], *self.ridge_fits, every[OURS])
        return {name: fit.moving.relative for name, fit in zip(METHODS, fits, strict=True)}


def read_arm(records: Records) -> Arm:
    """Return an arm with its estimates, from its records; of two the second is predicted."""
    log, *others = records.logs()
    other = others[0] if others else None
    result = sdpid.identify(records.robot, log, validation=other, intervals=False)
    return Arm(str(records), log, result, *_ridges(result))


def _ridges(result: Any) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
    """Return both ridge regressions, and their errors on held-out rows.

    They have the friction terms, weights and blocks of ours, and the belief about friction. Where
    the blocks are also what is predicted, they chose the strength, which favors it a little.
    """
    problem, fresh = result.problem, result.validation_samples
    priors: dict[float | None, Any] = {None: problem.prior}
    for strength in STRENGTHS:
        prior = sdpid.Prior(kind="scaled_euclidean", strength=float(strength))
        priors[strength] = prior_terms(prior, problem.rows)

    def solve(which: Any, prior: Any) -> Any:
        return sdpid.solve_wls(replace(which, prior=prior))

    predicted = predicted_by(
        held_out_blocks(problem),
        problem,
        {
            str(name): lambda block, prior=prior: solve(block.problem, prior).base
            for name, prior in priors.items()
        },
    )
    fits = {
        name: Validation.of_prediction(problem.robot, problem.samples, predicted[str(name)])
        for name in priors
    }
    best = min(STRENGTHS, key=lambda each: fits[each].moving.relative)
    ridges = solve(problem, priors[None]), solve(problem, priors[best])
    if fresh is None:
        return ridges, (fits[None], fits[best])
    return ridges, (sdpid.validate(ridges[0], fresh), sdpid.validate(ridges[1], fresh))


# A joint this fast, rad/s, is no robot's: 160 turns a second. Without stops the wrist of a falling
# arm does whip round at tens of rad/s, as the last link of a multiple pendulum does.
DIVERGED = 1000.0

# Relative and absolute tolerance of the integration; a tenth of both changes no time at which one
# of the five arms diverges by more than 0.1 %.
TOLERANCES = 1e-4, 1e-6

# Seconds between the postures that are kept.
GRID = 2e-3

# Of times, s.
ROUNDING = 1e-12


@dataclass(frozen=True)
class Fall:
    """Motion of a released arm.

    Attributes
    ----------
    time : ndarray, shape (K,)
        Seconds, up to where the arm diverges.
    position : ndarray, shape (K, n)
        Joint positions, rad.
    speed : ndarray, shape (K,)
        The fastest joint's speed, rad/s.
    diverged : float or None
        When a joint is faster than `DIVERGED`, or no acceleration is left; None where none is.
    """

    time: np.ndarray
    position: np.ndarray
    speed: np.ndarray
    diverged: float | None


def release(model: Any, q: np.ndarray, duration: float) -> Fall:
    """Simulate an arm that is let go of at rest in posture q (n,), rad, for some seconds.

    The effort is the identified offset, the zero error of the torque sensors, so that the motors
    do no work. Nothing else than the estimate's own equations acts: no stops, no contact.
    """
    from scipy.integrate import Radau

    n = len(q)
    effort = model.friction(np.zeros(n))

    def rates(_: float, state: np.ndarray) -> np.ndarray:
        rows = np.atleast_2d(state.T)
        position, velocity = rows[:, :n], rows[:, n:]
        tau = np.broadcast_to(effort, velocity.shape)
        rate = np.hstack([velocity, model.forward_dynamics(position, velocity, tau)])
        return np.asarray(rate.T.reshape(state.shape))

    relative, absolute = TOLERANCES
    start = np.concatenate([q, np.zeros(n)])
    # Implicit, for friction at rest is stiff.
    solver = Radau(rates, 0.0, start, duration, rtol=relative, atol=absolute, vectorized=True)
    states, diverged = [start], None
    while solver.status == "running" and diverged is None:
        try:
            solver.step()
        except (sdpid.errors.ModelError, ValueError):
            # No acceleration follows from the effort, or none that is finite.
            diverged = float(solver.t)
            break
        state = solver.dense_output()
        while len(states) * GRID <= solver.t + ROUNDING:
            states.append(state(len(states) * GRID))
        if solver.status == "failed" or not np.abs(solver.y[n:]).max() < DIVERGED:
            diverged = float(solver.t)
    found = np.array(states)
    speed = np.abs(found[:, n:]).max(axis=1)
    return Fall(GRID * np.arange(len(found)), found[:, :n], speed, diverged)


def skeleton(robot: sdpid.RobotModel, positions: np.ndarray) -> np.ndarray:
    """Return where the joints and the tool are, (K, points, 3), m, at positions (K, n)."""
    import pinocchio as pin

    model = robot.pin_model
    data = model.createData()
    shapes = []
    for q in positions:
        pin.framesForwardKinematics(model, data, q)
        joints = [data.oMi[i].translation for i in range(model.njoints)]
        shapes.append(np.array([*joints, data.oMf[model.nframes - 1].translation]))
    return np.array(shapes)
