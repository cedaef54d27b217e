"""Small identifications, made in a moment."""

from dataclasses import replace
from typing import Any

import numpy as np

import sdpid
from sdpid._common.arrays import Array
from sdpid.assurance.diagnostics.held_out import hold_out
from sdpid.estimation.problem import Problem, build_problem
from sdpid.workflow.result import Identification
from tests.helpers.data import full_regressor, make_samples, random_theta
from tests.helpers.motions import sines, slow_motion
from tests.helpers.robots import small_arm

ARM = small_arm(2)
FRICTION = ("coulomb", "viscous", "offset")
RATE = 50.0


# Friction that saturates, and an arm with it.
SPEEDS = (0.3, 0.6)
SATURATING = (sdpid.friction.SigmoidFriction(velocity=SPEEDS), "viscous", "offset")
SATURATED = random_theta(ARM, np.random.default_rng(0), SATURATING)


def saturating(rng: np.random.Generator, speed: float | None = None) -> Problem:
    """Return the arm's problem with friction of a given speed, or one that the data choose."""
    moved: dict[str, Any] = {"states": slow_motion(400), "noise": 0.05, "friction": SATURATING}
    samples = make_samples(ARM, SATURATED, rng, **moved)
    terms = (sdpid.friction.SigmoidFriction(velocity=speed), *SATURATING[1:])
    return build_problem(ARM, samples, friction=terms)


def arm_theta() -> Array:
    """Return consistent parameters of the arm."""
    return random_theta(ARM, np.random.default_rng(7), FRICTION)


def moved(
    theta: Array,
    seed: int,
    *,
    seconds: float = 20.0,
    noise: float = 0.02,
    speed: float = 1.0,
    amplitude: float = 1.0,
    robot: sdpid.RobotModel = ARM,
    noise_seed: int | None = None,
    **fields: Any,
) -> sdpid.Samples:
    """Return samples of a smooth motion; `noise_seed` changes the noise alone."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1.0 / RATE)
    w = speed * rng.uniform(0.5, 4.0, (3, robot.n))
    q, v, a = sines(t, w, rng.uniform(0.0, 6.0, w.shape), amplitude)
    effort = full_regressor(robot, (q, v, a), FRICTION) @ theta
    if noise_seed is not None:
        rng = np.random.default_rng((seed, noise_seed))
    effort = effort + noise * rng.standard_normal(effort.shape)
    return sdpid.Samples(position=q, velocity=v, acceleration=a, effort=effort, time=t, **fields)


def identified(
    samples: sdpid.Samples | Problem, validation: sdpid.Samples | None = None, **options: Any
) -> Identification:
    """Identify the arm."""
    problem = samples
    if isinstance(problem, sdpid.Samples):
        problem = build_problem(
            options.pop("robot", ARM), problem, friction=FRICTION, weighting="residual", **options
        )
    wls, estimate = sdpid.solve_wls(replace(problem, prior=None)), sdpid.solve_sdp(problem)
    return Identification(
        problem=problem,
        wls=wls,
        estimate=estimate,
        certificate=sdpid.certify(estimate),
        training=sdpid.validate(estimate),
        training_wls=sdpid.validate(wls),
        validation=None if validation is None else sdpid.validate(estimate, validation),
        validation_samples=validation,
        held_out=hold_out(estimate, wls, validation),
    )
