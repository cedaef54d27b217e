"""The parameters that a robot is taken to have before a run, to say what the run will show."""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid.estimation.prior.prior import repaired
from sdpid.excitation.criterion.noise import usual_effort
from sdpid.robot.consistent import raise_second_moments
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.inertia import from_pseudo_inertia
from sdpid.robot.model.base_parameters import characteristic_length
from sdpid.robot.model.model import RobotModel

# Coulomb friction is taken to be this share of a joint's usual effort, and viscous friction as
# large at its rms speed: as simulated robots have it. Descriptions often write next to none, where
# they mean that they do not know.
_FRICTION = 0.1

# A robot whose description has no masses is taken to weigh this much a link, kg, each a ball with
# this share of the robot's length for its radius of gyration.
_MASS, _BALL = 2.0, 0.3

# Below this rms speed a joint does not tell viscous friction, rad/s (m/s).
_STANDS = 1e-3


def nominal_bodies(robot: RobotModel) -> tuple[Array, tuple[str, ...]]:
    """Return the bodies (links, 10) of the description, made possible, and what was assumed."""
    given = np.array(robot.prior)
    known = given[:, 0] > 0.0
    bodies = repaired(given)[0]
    if known.all():
        return bodies, ()
    mass = float(np.mean(given[known, 0])) if known.any() else _MASS
    radius = (_BALL * characteristic_length(robot)) ** 2
    ball = from_pseudo_inertia(mass * np.diag([radius, radius, radius, 1.0]))
    if known.any():
        # Frames without mass, such as a tool's, stay next to nothing.
        bodies[~known, 0] = 1e-3
        return raise_second_moments(bodies, 1e-7), ()
    bodies[:] = ball
    return bodies, (f"the description has no masses: {mass:g} kg a link were assumed",)


def nominal_theta(
    robot: RobotModel, friction: FrictionModel, q: Array, v: Array, a: Array
) -> tuple[Array, tuple[str, ...]]:
    """Return theta (p,) before a run, and what was assumed.

    Links are as described; Coulomb and viscous friction as described, and at least of a usual size
    on the motion; other terms are zero.

    Parameters
    ----------
    robot, friction
        The robot and its friction terms.
    q, v, a : ndarray, shape (K, n)
        States of the motion.
    """
    bodies, notes = nominal_bodies(robot)
    rigid = robot.inverse_dynamics(bodies, q, v, a)
    usual = usual_effort(np.sqrt(np.mean(rigid**2, axis=0)))
    speed = np.maximum(np.sqrt(np.mean(v**2, axis=0)), _STANDS)
    viscous, coulomb = robot.described_friction()
    sizes = {
        "Fs": np.maximum(coulomb, _FRICTION * usual),
        "Fv": np.maximum(viscous, _FRICTION * usual / speed),
    }
    tail = [
        float(sizes[symbol][p.joint]) if (symbol := p.name.rstrip("0123456789")) in sizes else 0.0
        for p in friction.parameters
    ]
    return frozen(np.concatenate([bodies.ravel(), tail])), notes
