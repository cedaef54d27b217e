"""The few arrays that the compiled loops take: a robot, and memory to work in.

Every array that a function is given costs time to compile and to call, so they are packed.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

# Bodies and their gravity: the robot's, those of a tilt, and those that carry load.
OWN, TILTED, LOADING = 0, 1, 2

# Matrices (n, n) of a robot: inertia of its drives, effort per velocity.
DRIVES, VISCOUS = 0, 1

# Matrices (n, n) of the memory: masses, those of a load, slopes of friction, damping and the
# controller's share of it.
MASSES, MASSES2, SLOPES, SLOPES1, DAMPING, FEEDBACK = range(6)

# Vectors (n,) of the memory: change of the velocities, friction, friction after it, velocities
# after it; biases; position and velocity amid a step, effort less bias, load.
CHANGE, SMOOTH, SMOOTH1, TRIAL, BIAS, BIAS2, MIDDLE, RATE, PUSH, CARRIED = range(10)

# Those of a run: state, acceleration, state after a step, state as seen and its noise, integral of
# the error, error, effort, what was seen before, and accelerations of joints that are not free.
NOW, SPEED, ACCELERATION, NEXT, NEXT_SPEED, SIGHT, SIGHT_SPEED, SEEN = range(10, 18)
INTEGRAL, ERROR, EFFORT, BEFORE, GIVEN = range(18, 23)
VECTORS, MATRICES = 23, 6


class Robot(NamedTuple):
    """A robot with L links, n joints and known parameters.

    Attributes
    ----------
    tree : ndarray of int, shape (3, L)
        Kind, parent and joint of each link.
    angles : ndarray, shape (2, L)
        Factor and offset between position and angle.
    turn : ndarray, shape (L, 3, 3, 3)
        What the rotation is made of: cosine, sine, constant.
    place : ndarray, shape (L, 3, 3)
        What the origin is made of, constant and along the joint, and the joint's axis.
    bodies : ndarray, shape (3, L, 10)
        Inertial parameters: the robot's, those of a tilt, and those that carry load.
    gravity : ndarray, shape (3, 3)
        Of each of these.
    matrices : ndarray, shape (2, n, n)
        Inertia of drives, and effort per velocity.
    constant : ndarray, shape (n,)
        Effort at rest.
    load : ndarray, shape (n, 4)
        Share of the load, share of the sigmoid in it, its speed, width of the sign.
    which : ndarray of int, shape (C, 4)
        Joints, kind and side of every smooth curve of friction.
    curves : ndarray, shape (C, 4)
        Its four numbers.
    contacts : ndarray of int, shape (J, 2)
        Joints of every jump of friction.
    jumps : ndarray, shape (J, 4)
        Its velocity, least and largest effort, and whether the load adds to them.
    tilted, loaded : bool
        Whether there are bodies of a tilt, and such that carry load.
    """

    tree: Any
    angles: Any
    turn: Any
    place: Any
    bodies: Any
    gravity: Any
    matrices: Any
    constant: Any
    load: Any
    which: Any
    curves: Any
    contacts: Any
    jumps: Any
    tilted: bool
    loaded: bool


class Memory(NamedTuple):
    """What the loops write while they work.

    Attributes
    ----------
    rotations, places : ndarray, shape (L + 1, 3, 3), (L + 1, 3)
        Axes and origins of the base and the links.
    links : ndarray, shape (4, L + 1, 6)
        Axes of joints, velocities, accelerations, forces.
    bodies : ndarray, shape (L + 1, 10)
        Links with all that hangs on them.
    scratch, force : ndarray, shape (4, 3), (6,)
    system : ndarray, shape (n + J, n + J + 1)
        Equations that are solved.
    vectors : ndarray, shape (23, n)
    matrices : ndarray, shape (6, n, n)
    fixed : ndarray of bool, shape (n,)
        Joints whose accelerations are given.
    states : ndarray of int, shape (2, J)
        Whether contacts slip, and where to, and whether they are at their jump.
    bounds : ndarray, shape (J, 2)
        What contacts can hold.
    """

    rotations: Any
    places: Any
    links: Any
    bodies: Any
    scratch: Any
    force: Any
    system: Any
    vectors: Any
    matrices: Any
    fixed: Any
    states: Any
    bounds: Any


def memory_for(robot: Robot, *others: Robot) -> Memory:
    """Return memory for a robot that no controller damps; others have as many joints."""
    L = max(each.tree.shape[1] for each in (robot, *others))
    J = max(len(each.contacts) for each in (robot, *others))
    n = len(robot.constant)
    memory = Memory(
        rotations=np.zeros((L + 1, 3, 3)),
        places=np.zeros((L + 1, 3)),
        links=np.zeros((4, L + 1, 6)),
        bodies=np.zeros((L + 1, 10)),
        scratch=np.zeros((4, 3)),
        force=np.zeros(6),
        system=np.zeros((n + J, n + J + 1)),
        vectors=np.zeros((VECTORS, n)),
        matrices=np.zeros((MATRICES, n, n)),
        fixed=np.zeros(n, dtype=np.bool_),
        states=np.zeros((2, J), dtype=np.int64),
        bounds=np.zeros((J, 2)),
    )
    memory.matrices[DAMPING] = robot.matrices[VISCOUS]
    return memory
