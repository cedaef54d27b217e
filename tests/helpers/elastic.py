"""A simulated arm with gears that give way, and encoders on both of their sides."""

from functools import cache

import numpy as np

import sdpid
from sdpid._common.arrays import Array
from sdpid.estimation.elasticity.result import Elasticity
from sdpid.workflow.result import Identification
from tests.helpers.data import random_links
from tests.helpers.robots import described_arm

RATE, SECONDS = 250.0, 24.0
ROTORS, DELAY = np.array([0.3, 0.2, 0.1]), 3e-3
STIFFNESS = np.array([2e4, 8e3, np.inf])


@cache
def arm() -> sdpid.RobotModel:
    return described_arm(random_links(np.random.default_rng(5), 3))


def log(
    seed: int,
    *,
    line: float = 0.0,
    curve: float = 0.0,
    noise: float = 2e-5,
    late: float = DELAY,
    stiffness: Array = STIFFNESS,
    reach: Array | float = 0.3,
) -> sdpid.Recording:
    """Return a recording of gears that give way by the links' torque, links read late.

    A line of 200 cycles a turn is an error of the second link's encoder, as is a curve over its
    position.
    """
    robot, rng = arm(), np.random.default_rng(seed)
    rates, phases = rng.uniform(1.0, 7.0, (3, 4)), rng.uniform(0.0, 6.0, (3, 4))

    def at(time: Array, order: int = 0) -> Array:
        angle = rates * time[:, None, None] + phases
        waves = (np.sin(angle), rates * np.cos(angle), -(rates**2) * np.sin(angle))[order]
        return np.asarray(reach * waves.sum(axis=2))

    time = np.arange(0.0, SECONDS, 1.0 / RATE)

    def deflection(when: Array) -> Array:
        states = at(when), at(when, 1), at(when, 2)
        return np.asarray(robot.inverse_dynamics(robot.prior, *states) / stiffness)

    motor = at(time) + rng.normal(0.0, noise, (len(time), 3))
    link = at(time - late) - deflection(time - late) + [0.01, 0.02, -0.01]
    link[:, 1] += line * np.sin(200.0 * link[:, 1])
    link[:, 1] += curve * link[:, 1] ** 2
    link += rng.normal(0.0, noise, link.shape)
    states = at(time), at(time, 1), at(time, 2)
    effort = robot.inverse_dynamics(robot.prior, *states) + ROTORS * states[2] + 0.4 * states[1]
    effort += 0.02 * rng.standard_normal(effort.shape)
    names = robot.joint_names
    return sdpid.Recording(
        time=time, position=motor, effort=effort, link_position=link, joint_names=names
    )


@cache
def rigid() -> Identification:
    terms = ("coulomb", "viscous", "rotor_inertia")
    return sdpid.identify(arm(), log(0), friction=terms, effects="none", intervals=False)


@cache
def found(*seeds: int, line: float = 0.0, curve: float = 0.0) -> Elasticity:
    logs = [log(seed, line=line, curve=curve) for seed in seeds]
    return sdpid.identify_elasticity(rigid(), logs, rotor_inertia=ROTORS)
