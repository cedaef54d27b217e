"""Mass matrix and bias of a tree of links at a state, written for a compiler."""

from __future__ import annotations

import math
from typing import Any

from sdpid._common.arrays import Array
from sdpid.experiment.simulation.kernels.layout import (
    BIAS,
    BIAS2,
    BIAS3,
    DRIVES,
    LOADING,
    MASSES,
    MASSES2,
    OWN,
    TILTED,
)

PRISMATIC = 1


def cross(ax: float, ay: float, az: float, bx: float, by: float, bz: float) -> Any:
    """Return the vector product."""
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


def turned(R: Array, i: int, x: float, y: float, z: float) -> Any:
    """Return a vector in the parent's axes."""
    return (
        R[i, 0, 0] * x + R[i, 0, 1] * y + R[i, 0, 2] * z,
        R[i, 1, 0] * x + R[i, 1, 1] * y + R[i, 1, 2] * z,
        R[i, 2, 0] * x + R[i, 2, 1] * y + R[i, 2, 2] * z,
    )


def turned_back(R: Array, i: int, x: float, y: float, z: float) -> Any:
    """Return a vector of the parent's axes in the link's own."""
    return (
        R[i, 0, 0] * x + R[i, 1, 0] * y + R[i, 2, 0] * z,
        R[i, 0, 1] * x + R[i, 1, 1] * y + R[i, 2, 1] * z,
        R[i, 0, 2] * x + R[i, 1, 2] * y + R[i, 2, 2] * z,
    )


def inertia_times(C: Array, i: int, x: float, y: float, z: float) -> Any:
    """Return the product of a body's inertia matrix and a vector."""
    return (
        C[i, 4] * x + C[i, 5] * y + C[i, 7] * z,
        C[i, 5] * x + C[i, 6] * y + C[i, 8] * z,
        C[i, 7] * x + C[i, 8] * y + C[i, 9] * z,
    )


def links_at(
    robot: Any,
    bodies: Array,
    gravity: Array,
    q: Array,
    v: Array,
    memory: Any,
    M: Array,
    h: Array,
) -> None:
    """Write the mass matrix and the bias of some bodies: Coriolis, centrifugal, gravity."""
    kind, parent, column = robot.tree[0], robot.tree[1], robot.tree[2]
    factor, offset = robot.angles[0], robot.angles[1]
    turn, place = robot.turn, robot.place
    R, C, found = memory.rotations, memory.bodies, memory.links
    r, w, u, b, f, t = found[0], found[1], found[2], found[3], found[4], found[5]
    links, n = len(kind), len(q)
    for i in range(n):
        h[i] = 0.0
        for j in range(n):
            M[i, j] = 0.0
    for i in range(links):
        p, c = parent[i], column[i]
        x, rate = factor[i] * q[c] + offset[i], factor[i] * v[c]
        cosine, sine, d = 0.0, 0.0, 0.0
        if kind[i] == PRISMATIC:
            d = x
        else:
            cosine, sine = math.cos(x), math.sin(x)
        for k in range(3):
            for m in range(3):
                R[i, k, m] = turn[i, 0, k, m] * cosine + turn[i, 1, k, m] * sine + turn[i, 2, k, m]
            r[i, k] = place[i, 0, k] + place[i, 1, k] * d
        wx = wy = wz = ux = uy = uz = 0.0
        gx, gy, gz = -gravity[0], -gravity[1], -gravity[2]
        if p >= 0:
            wx, wy, wz = w[p, 0], w[p, 1], w[p, 2]
            ux, uy, uz = u[p, 0], u[p, 1], u[p, 2]
            # Acceleration of this origin: u x r + w x (w x r).
            kx, ky, kz = cross(wx, wy, wz, r[i, 0], r[i, 1], r[i, 2])
            kx, ky, kz = cross(wx, wy, wz, kx, ky, kz)
            gx, gy, gz = cross(ux, uy, uz, r[i, 0], r[i, 1], r[i, 2])
            gx, gy, gz = gx + kx + b[p, 0], gy + ky + b[p, 1], gz + kz + b[p, 2]
        wx, wy, wz = turned_back(R, i, wx, wy, wz)
        ux, uy, uz = turned_back(R, i, ux, uy, uz)
        gx, gy, gz = turned_back(R, i, gx, gy, gz)
        sx, sy, sz = place[i, 2, 0] * rate, place[i, 2, 1] * rate, place[i, 2, 2] * rate
        kx, ky, kz = cross(wx, wy, wz, sx, sy, sz)
        if kind[i] == PRISMATIC:
            gx, gy, gz = gx + 2.0 * kx, gy + 2.0 * ky, gz + 2.0 * kz
        else:
            ux, uy, uz = ux + kx, uy + ky, uz + kz
            wx, wy, wz = wx + sx, wy + sy, wz + sz
        w[i, 0], w[i, 1], w[i, 2] = wx, wy, wz
        u[i, 0], u[i, 1], u[i, 2] = ux, uy, uz
        b[i, 0], b[i, 1], b[i, 2] = gx, gy, gz
        for k in range(10):
            C[i, k] = bodies[i, k]
        m, hx, hy, hz = C[i, 0], C[i, 1], C[i, 2], C[i, 3]
        # Force: m·b + u x h + w x (w x h).
        kx, ky, kz = cross(wx, wy, wz, hx, hy, hz)
        kx, ky, kz = cross(wx, wy, wz, kx, ky, kz)
        sx, sy, sz = cross(ux, uy, uz, hx, hy, hz)
        f[i, 0], f[i, 1], f[i, 2] = m * gx + sx + kx, m * gy + sy + ky, m * gz + sz + kz
        # Torque: I·u + w x (I·w) + h x b.
        kx, ky, kz = inertia_times(C, i, wx, wy, wz)
        kx, ky, kz = cross(wx, wy, wz, kx, ky, kz)
        sx, sy, sz = cross(hx, hy, hz, gx, gy, gz)
        ux, uy, uz = inertia_times(C, i, ux, uy, uz)
        t[i, 0], t[i, 1], t[i, 2] = ux + kx + sx, uy + ky + sy, uz + kz + sz
    for i in range(links - 1, -1, -1):
        p, c = parent[i], column[i]
        sx, sy, sz = (
            factor[i] * place[i, 2, 0],
            factor[i] * place[i, 2, 1],
            factor[i] * place[i, 2, 2],
        )
        m, hx, hy, hz = C[i, 0], C[i, 1], C[i, 2], C[i, 3]
        # The links' effort, and the force and torque that accelerate all that hangs on this joint.
        if kind[i] == PRISMATIC:
            h[c] += sx * f[i, 0] + sy * f[i, 1] + sz * f[i, 2]
            fx, fy, fz = m * sx, m * sy, m * sz
            tx, ty, tz = cross(hx, hy, hz, sx, sy, sz)
            M[c, c] += sx * fx + sy * fy + sz * fz
        else:
            h[c] += sx * t[i, 0] + sy * t[i, 1] + sz * t[i, 2]
            fx, fy, fz = cross(sx, sy, sz, hx, hy, hz)
            tx, ty, tz = inertia_times(C, i, sx, sy, sz)
            M[c, c] += sx * tx + sy * ty + sz * tz
        j = i
        while parent[j] >= 0:
            fx, fy, fz = turned(R, j, fx, fy, fz)
            tx, ty, tz = turned(R, j, tx, ty, tz)
            kx, ky, kz = cross(r[j, 0], r[j, 1], r[j, 2], fx, fy, fz)
            tx, ty, tz = tx + kx, ty + ky, tz + kz
            j = parent[j]
            if kind[j] == PRISMATIC:
                value = place[j, 2, 0] * fx + place[j, 2, 1] * fy + place[j, 2, 2] * fz
            else:
                value = place[j, 2, 0] * tx + place[j, 2, 1] * ty + place[j, 2, 2] * tz
            value *= factor[j]
            M[c, column[j]] += value
            M[column[j], c] += value
        if p < 0:
            continue
        x, y, z = r[i, 0], r[i, 1], r[i, 2]
        gx, gy, gz = turned(R, i, f[i, 0], f[i, 1], f[i, 2])
        kx, ky, kz = turned(R, i, t[i, 0], t[i, 1], t[i, 2])
        sx, sy, sz = cross(x, y, z, gx, gy, gz)
        f[p, 0], f[p, 1], f[p, 2] = f[p, 0] + gx, f[p, 1] + gy, f[p, 2] + gz
        t[p, 0], t[p, 1], t[p, 2] = t[p, 0] + kx + sx, t[p, 1] + ky + sy, t[p, 2] + kz + sz
        # The same body about the parent's origin, in its axes: columns of R·I first.
        gx, gy, gz = turned(R, i, hx, hy, hz)
        ax, ay, az = turned(R, i, C[i, 4], C[i, 5], C[i, 7])
        bx, by, bz = turned(R, i, C[i, 5], C[i, 6], C[i, 8])
        ex, ey, ez = turned(R, i, C[i, 7], C[i, 8], C[i, 9])
        xx, xy, xz = turned(R, i, ax, bx, ex)
        _, yy, yz = turned(R, i, ay, by, ey)
        _, _, zz = turned(R, i, az, bz, ez)
        # Twice the first moment along the offset, and the offset's own square.
        wx, wy, wz = 2.0 * x * gx + m * x * x, 2.0 * y * gy + m * y * y, 2.0 * z * gz + m * z * z
        C[p, 0] += m
        C[p, 1] += gx + m * x
        C[p, 2] += gy + m * y
        C[p, 3] += gz + m * z
        C[p, 4] += xx + wy + wz
        C[p, 5] += xy - x * gy - y * gx - m * x * y
        C[p, 6] += yy + wx + wz
        C[p, 7] += xz - x * gz - z * gx - m * x * z
        C[p, 8] += yz - y * gz - z * gy - m * y * z
        C[p, 9] += zz + wx + wy


def dynamics_at(robot: Any, q: Array, v: Array, memory: Any) -> None:
    """Write mass matrix and bias, drives and offsets included, and those of what carries load."""
    M, M2 = memory.matrices[MASSES], memory.matrices[MASSES2]
    h, h2, h3 = memory.vectors[BIAS], memory.vectors[BIAS2], memory.vectors[BIAS3]
    n = len(q)
    links_at(robot, robot.bodies[OWN], robot.gravity[OWN], q, v, memory, M, h)
    if robot.tilted:
        # What other bodies weigh more under a gravity that is tilted.
        for i in range(n):
            h2[i] = 0.0
        links_at(robot, robot.bodies[TILTED], robot.gravity[TILTED], q, h2, memory, M2, h3)
        for i in range(n):
            h[i] += h3[i]
    for i in range(n):
        h[i] += robot.constant[i]
        for j in range(n):
            M[i, j] += robot.matrices[DRIVES, i, j]
    if robot.loaded:
        links_at(robot, robot.bodies[LOADING], robot.gravity[LOADING], q, v, memory, M2, h2)
