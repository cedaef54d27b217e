"""Mass matrix, bias and friction of a tree of links at a state, written for a compiler.

All is in the axes of the base and about its origin: bodies that hang together add, and nothing is
turned from link to link. Row 0 is the base, row i + 1 link i. Six numbers are an angular part and a
linear one. Friction is that between its jumps: curves of the velocity, and their slopes.

Every array that a function is given costs time to compile and to call, so arrays of a robot, and
memory to work in, are packed into few.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from sdpid._common.arrays import Array

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

PRISMATIC = 1

# Kinds of smooth curves, as terms name them, and of efforts by position; then the points of tables.
KINDS = ("tanh", "root", "peak", "smooth_peak", "line", "powers", "table", "play")
TANH, ROOT, PEAK_REST, SMOOTH_PEAK, LINE, POWERS, TABLE, PLAY, POINT = range(9)

# Where the coordinates that move a link, or that a curve of friction follows, begin among its whole
# numbers, -1 for none; and their factors among the others of links, curves and jumps.
COLUMN, OF_LINK, OF_CURVE, OF_JUMP = 2, 1, 4, 4

# Where a body's ten numbers have its inertia matrix.
PACKED = ((4, 5, 7), (5, 6, 8), (7, 8, 9))


class Robot(NamedTuple):
    """A robot with L links, n joints and known parameters.

    Attributes
    ----------
    tree : ndarray of int, shape (L, 2 + w)
        Kind and parent of each link, and the coordinates that move it, -1 for none.
    angles : ndarray, shape (L, 1 + w)
        Its joint's angle where these are zero, and their factors in it.
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
    parabolas : ndarray, shape (n, 5)
        Friction over position: lower and upper end, control values there and between them. They
        stand in place of a load, whose share is one.
    which : ndarray of int, shape (C, 2 + u)
        Kind and side of every smooth curve of friction, and the coordinates of its velocity; then
        those of efforts by position, in place of the side where a table begins, and its points.
    curves : ndarray, shape (C, 4 + u)
        Their four numbers, and factors. Of efforts by position what is added to it comes first,
        then the factors of three powers, size and points of a table, or size and slip.
    contacts : ndarray of int, shape (J, u)
        Coordinates of the velocity of every jump of friction.
    jumps : ndarray, shape (J, 4 + u)
        Its velocity, least and largest effort, and whether the load adds to them; factors.
    tilted, loaded, bent : bool
        Whether there are bodies of a tilt, such that carry load, and friction over position.
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
    parabolas: Any
    which: Any
    curves: Any
    contacts: Any
    jumps: Any
    tilted: bool
    loaded: bool
    bent: bool


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
    bounds : ndarray, shape (J or C, 3)
        What contacts can hold; what follows the positions of curves that are elements that slip.
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
    L = max(len(each.tree) for each in (robot, *others))
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
        bounds=np.zeros((max(J, *(len(each.which) for each in (robot, *others))), 3)),
    )
    memory.matrices[DAMPING] = robot.matrices[VISCOUS]
    return memory


def add_cross(out: Array, at: int, a: Array, i: int, b: Array, j: int) -> None:
    """Add the vector product of three numbers of `a` from i on and three of `b` from j on."""
    out[at] += a[i + 1] * b[j + 2] - a[i + 2] * b[j + 1]
    out[at + 1] += a[i + 2] * b[j] - a[i] * b[j + 2]
    out[at + 2] += a[i] * b[j + 1] - a[i + 1] * b[j]


def momentum_of(body: Array, x: Array, out: Array) -> None:
    """Write the momentum of a body with velocity x, or the force of an acceleration x."""
    for k in range(3):
        out[k], out[3 + k] = 0.0, body[0] * x[3 + k]
        for m in range(3):
            out[k] += body[PACKED[k][m]] * x[m]
    add_cross(out, 0, body, 1, x, 3)
    add_cross(out, 3, x, 0, body, 1)


def place_link(robot: Any, i: int, x: float, memory: Any, s: Array) -> None:
    """Write rotation and origin of a link whose joint is at x, and the joint's axis."""
    R, P, T = memory.rotations, memory.places, memory.scratch
    turn, place, p = robot.turn[i], robot.place[i], robot.tree[i, 1] + 1
    slides = robot.tree[i, 0] == PRISMATIC
    cosine, sine, shift = math.cos(x), math.sin(x), 0.0
    if slides:
        cosine, sine, shift = 0.0, 0.0, x
    for k in range(3):
        for m in range(3):
            T[k, m] = turn[0, k, m] * cosine + turn[1, k, m] * sine + turn[2, k, m]
        T[3, k] = place[0, k] + place[1, k] * shift
    for k in range(3):
        P[i + 1, k] = P[p, k]
        for m in range(3):
            P[i + 1, k] += R[p, k, m] * T[3, m]
            R[i + 1, k, m] = R[p, k, 0] * T[0, m] + R[p, k, 1] * T[1, m] + R[p, k, 2] * T[2, m]
    for k in range(3):
        axis = 0.0
        for m in range(3):
            axis += R[i + 1, k, m] * place[2, m]
        s[k] = 0.0 if slides else axis
        s[3 + k] = axis if slides else 0.0
    if not slides:
        add_cross(s, 3, P[i + 1], 0, s, 0)


def place_body(body: Array, R: Array, P: Array, T: Array, out: Array) -> None:
    """Write a body about the origin of the base, from its numbers about its link's."""
    mass, along = body[0], 0.0
    out[0], square = mass, mass * (P[0] * P[0] + P[1] * P[1] + P[2] * P[2])
    for k in range(3):
        out[1 + k] = R[k, 0] * body[1] + R[k, 1] * body[2] + R[k, 2] * body[3]
        along += 2.0 * out[1 + k] * P[k]
        for m in range(3):
            T[k, m] = 0.0
            for c in range(3):
                T[k, m] += R[k, c] * body[PACKED[c][m]]
    for k in range(3):
        for m in range(k, 3):
            total = along + square if k == m else 0.0
            total -= out[1 + k] * P[m] + out[1 + m] * P[k] + mass * P[k] * P[m]
            for c in range(3):
                total += T[k, c] * R[m, c]
            out[PACKED[k][m]] = total
    for k in range(3):
        out[1 + k] += mass * P[k]


def links_at(robot: Any, which: int, q: Array, v: Array, memory: Any, M: Array, h: Array) -> None:
    """Write the mass matrix and the bias of some bodies: Coriolis, centrifugal, gravity."""
    tree, angles = robot.tree, robot.angles
    R, P, C, force = memory.rotations, memory.places, memory.bodies, memory.force
    S, V, A, F = memory.links[0], memory.links[1], memory.links[2], memory.links[3]
    tilted = robot.tilted and which == OWN
    h[:], M[:] = 0.0, 0.0
    for k in range(3):
        R[0, k, k], A[0, 3 + k] = 1.0, -robot.gravity[which, k]
        # The base has no joint and no body: their rows have those of a tilt.
        S[0, 3 + k] = -robot.gravity[TILTED, k]
    for i in range(len(tree)):
        p, own = tree[i, 1] + 1, i + 1
        angle = angles[i, 0] + along(tree, COLUMN, angles, OF_LINK, i, q)
        speed = along(tree, COLUMN, angles, OF_LINK, i, v)
        place_link(robot, i, angle, memory, S[own])
        place_body(robot.bodies[which, i], R[own], P[own], memory.scratch, C[own])
        for k in range(6):
            V[own, k] = V[p, k] + S[own, k] * speed
            A[own, k] = 0.0
        add_cross(A[own], 0, V[own], 0, S[own], 0)
        add_cross(A[own], 3, V[own], 0, S[own], 3)
        add_cross(A[own], 3, V[own], 3, S[own], 0)
        for k in range(6):
            A[own, k] = A[p, k] + A[own, k] * speed
        # What accelerates the body, and what turns its momentum.
        momentum_of(C[own], A[own], F[own])
        momentum_of(C[own], V[own], force)
        add_cross(F[own], 0, V[own], 0, force, 0)
        add_cross(F[own], 0, V[own], 3, force, 3)
        add_cross(F[own], 3, V[own], 0, force, 3)
        if tilted:
            # What another body weighs more under a gravity that is tilted.
            place_body(robot.bodies[TILTED, i], R[own], P[own], memory.scratch, C[0])
            momentum_of(C[0], S[0], force)
            for k in range(6):
                F[own, k] += force[k]
    for own in range(len(tree), 0, -1):
        p, needed, mass = tree[own - 1, 1] + 1, 0.0, 0.0
        # What accelerates all that hangs on this joint.
        momentum_of(C[own], S[own], force)
        for k in range(6):
            needed += S[own, k] * F[own, k]
            mass += S[own, k] * force[k]
            F[p, k] += F[own, k]
        add_along(tree, COLUMN, angles, OF_LINK, own - 1, needed, h)
        add_masses(tree, angles, own - 1, own - 1, mass, M)
        for k in range(10):
            C[p, k] += C[own, k]
        while p > 0:
            mass = 0.0
            for k in range(6):
                mass += S[p, k] * force[k]
            add_masses(tree, angles, own - 1, p - 1, mass, M)
            add_masses(tree, angles, p - 1, own - 1, mass, M)
            p = tree[p - 1, 1] + 1


def along(columns: Array, at: int, factors: Array, of: int, k: int, x: Array) -> Any:
    """Return the sum of some coordinates of x times factors."""
    total = 0.0
    for w in range(columns.shape[1] - at):
        if columns[k, at + w] < 0:
            break
        total += factors[k, of + w] * x[columns[k, at + w]]
    return total


def add_along(
    columns: Array, at: int, factors: Array, of: int, k: int, value: float, out: Array
) -> None:
    """Add an effort along such a sum to those of its coordinates."""
    for w in range(columns.shape[1] - at):
        if columns[k, at + w] < 0:
            break
        out[columns[k, at + w]] += factors[k, of + w] * value


def add_masses(tree: Array, angles: Array, i: int, j: int, mass: float, M: Array) -> None:
    """Add the mass by which the joint of link j feels that of link i accelerate."""
    for w in range(tree.shape[1] - COLUMN):
        if tree[i, COLUMN + w] < 0:
            break
        own = angles[i, OF_LINK + w] * mass
        add_along(tree, COLUMN, angles, OF_LINK, j, own, M[tree[i, COLUMN + w]])


def pulled_at(robot: Any, p: int, q: Array) -> Any:
    """Return the position that an effort depends on, from where it is zero or at rest."""
    return robot.curves[p, 0] + along(robot.which, COLUMN, robot.curves, OF_CURVE, p, q)


def add_pull(robot: Any, p: int, effort: float, out: Array) -> None:
    """Add an effort of a curve to those of the coordinates."""
    add_along(robot.which, COLUMN, robot.curves, OF_CURVE, p, effort, out)


def pull_at(robot: Any, p: int, x: float) -> Any:
    """Return an effort by position: powers of it, or a table's, which stands in rows of its own."""
    curves = robot.curves
    if robot.which[p, 0] == POWERS:
        return x * (curves[p, 1] + x * (curves[p, 2] + x * curves[p, 3]))
    low, size = robot.which[p, 1], curves[p, 1]
    high = low + int(curves[p, 2]) - 1
    if x <= curves[low, 0]:
        return size * curves[low, 1]
    if x >= curves[high, 0]:
        return size * curves[high, 1]
    while high - low > 1:
        middle = (low + high) // 2
        if curves[middle, 0] <= x:
            low = middle
        else:
            high = middle
    share = (x - curves[low, 0]) / (curves[high, 0] - curves[low, 0])
    return size * (curves[low, 1] + share * (curves[high, 1] - curves[low, 1]))


def add_plays(robot: Any, q: Array, memory: Any, kept: bool, begins: bool, out: Array) -> None:
    """Take off the efforts of elements that slip; where `kept`, what follows them goes on."""
    for p in range(len(robot.which) - 1, -1, -1):
        if robot.which[p, 0] < POWERS:
            break
        if robot.which[p, 0] == PLAY:
            x, slip = pulled_at(robot, p, q), robot.curves[p, 2]
            z = x if begins else min(max(memory.bounds[p, 2], x - slip), x + slip)
            if kept:
                memory.bounds[p, 2] = z
            else:
                add_pull(robot, p, -robot.curves[p, 1] * (x - z) / slip, out)


def dynamics_at(robot: Any, q: Array, v: Array, memory: Any) -> None:
    """Write mass matrix and bias, drives and offsets included, and those of what carries load."""
    M, h = memory.matrices[MASSES], memory.vectors[BIAS]
    M2, h2 = memory.matrices[MASSES2], memory.vectors[BIAS2]
    links_at(robot, OWN, q, v, memory, M, h)
    for i in range(len(q)):
        h[i] += robot.constant[i]
        for j in range(len(q)):
            M[i, j] += robot.matrices[DRIVES, i, j]
    # Efforts by position stand behind those of velocities.
    for p in range(len(robot.which) - 1, -1, -1):
        if robot.which[p, 0] < POWERS:
            break
        if robot.which[p, 0] < PLAY:
            add_pull(robot, p, pull_at(robot, p, pulled_at(robot, p, q)), h)
    if robot.loaded:
        links_at(robot, LOADING, q, v, memory, M2, h2)
    if robot.bent:
        for i in range(len(q)):
            low, high = robot.parabolas[i, 0], robot.parabolas[i, 1]
            x = min(max((q[i] - low) / (high - low), 0.0), 1.0)
            ends = (1.0 - x) ** 2 * robot.parabolas[i, 2] + x * x * robot.parabolas[i, 4]
            memory.vectors[CARRIED, i] = ends + 2.0 * x * (1.0 - x) * robot.parabolas[i, 3]


def curve_at(kind: int, side: int, c: float, a: float, b: float, w: float, x: float) -> Any:
    """Return value and slope of a curve of friction, without its jumps."""
    sign, speed = np.sign(x), abs(x)
    if side * sign < 0.0:
        return 0.0, 0.0
    if kind == TANH:
        if speed < b:
            return 0.0, 0.0
        y = math.tanh(speed / w)
        return c * sign * (y - math.tanh(b / w)), c * (1.0 - y * y) / w
    if kind == ROOT:
        root = math.sqrt(speed)
        return c * sign * root, 0.5 * c / max(root, 1e-3)
    if kind == LINE:
        # A slope between the speeds b and w, constant beyond.
        if speed < b:
            return 0.0, 0.0
        return c * sign * (min(speed, w) - b), c if speed < w else 0.0
    ratio = min(speed / a, 1e3)
    power = math.exp(b * math.log(ratio)) if ratio > 0.0 else 0.0
    peak = math.exp(-min(power, 700.0))
    slope = -b / a * peak * power / max(ratio, 1e-3)
    if kind == PEAK_REST:
        return c * sign * (peak - 1.0), c * slope
    y = math.tanh(speed / w)
    return c * sign * peak * y, c * (slope * y + peak * (1.0 - y * y) / w)


def smooth_at(robot: Any, carried: Array, v: Array, F: Array, S: Array) -> None:
    """Write the smooth part of friction and its slopes; viscous friction is not in it."""
    which, curves, load = robot.which, robot.curves, robot.load
    F[:], S[:] = 0.0, 0.0
    for p in range(len(which)):
        if which[p, 0] >= POWERS:
            break
        x = along(which, COLUMN, curves, OF_CURVE, p, v)
        value, slope = curve_at(
            which[p, 0], which[p, 1], curves[p, 0], curves[p, 1], curves[p, 2], curves[p, 3], x
        )
        add_pull(robot, p, value, F)
        for w in range(which.shape[1] - COLUMN):
            if which[p, COLUMN + w] < 0:
                break
            add_pull(robot, p, curves[p, OF_CURVE + w] * slope, S[which[p, COLUMN + w]])
    if robot.loaded or robot.bent:
        for j in range(len(v)):
            size, share = load[j, 0] * carried[j], load[j, 1]
            if share > 0.0:
                y = math.tanh(v[j] / load[j, 2])
                F[j] += size * share * y
                S[j, j] += size * share * (1.0 - y * y) / load[j, 2]
            if load[j, 3] > 0.0:
                y = math.tanh(v[j] / load[j, 3])
                F[j] += size * (1.0 - share) * y
                S[j, j] += size * (1.0 - share) * (1.0 - y * y) / load[j, 3]


def bounds_at(robot: Any, carried: Array, bounds: Array) -> None:
    """Write the least and the largest effort of each jump of friction."""
    contacts, values, load = robot.contacts, robot.jumps, robot.load
    for k in range(len(contacts)):
        extra = 0.0
        if values[k, 3] > 0.0:
            j = contacts[k, 0]
            extra = load[j, 0] * (1.0 - load[j, 1]) * carried[j]
        bounds[k, 0], bounds[k, 1] = values[k, 1] - extra, values[k, 2] + extra
