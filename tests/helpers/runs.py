"""Recordings of a small arm, as a log holds them: positions and efforts with noise."""

from functools import cache
from typing import Any

import numpy as np

import sdpid
from tests.helpers.arm_files import ARM_URDF
from tests.helpers.motions import sines

RATE = 50.0


@cache
def arm() -> sdpid.RobotModel:
    """Return the arm of `ARM_URDF`."""
    return sdpid.load_robot(ARM_URDF)


@cache
def recorded(
    seed: int, *, seconds: float = 20.0, speed: float = 1.0, damping: float = 0.4, **fields: Any
) -> sdpid.Recording:
    """Return a recording of a motion that excites the arm; the seed decides on the motion."""
    robot, rng = arm(), np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE)) / RATE
    w, c = speed * rng.uniform(0.5, 4.0, (3, 2)), rng.uniform(0.0, 6.0, (3, 2))
    if "period" in fields:
        turn = 2.0 * np.pi / fields["period"]
        w = turn * np.maximum(np.round(w / turn), 1.0)
    q, v, a = sines(t, w, c)
    effort = robot.inverse_dynamics(robot.prior, q, v, a) + damping * v
    effort = effort + 0.02 * rng.standard_normal(effort.shape)
    fields.setdefault("joint_names", robot.joint_names)
    return sdpid.Recording(time=t, position=q, effort=effort, **fields)
