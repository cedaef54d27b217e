"""Mass matrix and bias of a tree of links at a state, written for a compiler."""

from __future__ import annotations

import math
from typing import Any

from sdpid._common.arrays import Array

PRISMATIC = 1


def links_at(
    tree: Any, bodies: Array, gravity: Array, q: Array, v: Array, space: Any, M: Array, h: Array
) -> None:
    """Write the mass matrix and the bias of the links: Coriolis, centrifugal, gravity."""
    kind, parent, column, factor, offset, turn, place, axis = tree
    R, r, w, u, b, f, t, C = space
    links = len(kind)
    M[:] = 0.0
    h[:] = 0.0
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
        if p >= 0:
            wx, wy, wz = w[p, 0], w[p, 1], w[p, 2]
            ux, uy, uz = u[p, 0], u[p, 1], u[p, 2]
            x, y, z = r[i, 0], r[i, 1], r[i, 2]
            # Acceleration of this origin: u x r + w x (w x r).
            kx, ky, kz = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x
            gx = b[p, 0] + uy * z - uz * y + wy * kz - wz * ky
            gy = b[p, 1] + uz * x - ux * z + wz * kx - wx * kz
            gz = b[p, 2] + ux * y - uy * x + wx * ky - wy * kx
        else:
            wx = wy = wz = ux = uy = uz = 0.0
            gx, gy, gz = -gravity[0], -gravity[1], -gravity[2]
        a0 = R[i, 0, 0] * wx + R[i, 1, 0] * wy + R[i, 2, 0] * wz
        a1 = R[i, 0, 1] * wx + R[i, 1, 1] * wy + R[i, 2, 1] * wz
        a2 = R[i, 0, 2] * wx + R[i, 1, 2] * wy + R[i, 2, 2] * wz
        e0 = R[i, 0, 0] * ux + R[i, 1, 0] * uy + R[i, 2, 0] * uz
        e1 = R[i, 0, 1] * ux + R[i, 1, 1] * uy + R[i, 2, 1] * uz
        e2 = R[i, 0, 2] * ux + R[i, 1, 2] * uy + R[i, 2, 2] * uz
        b0 = R[i, 0, 0] * gx + R[i, 1, 0] * gy + R[i, 2, 0] * gz
        b1 = R[i, 0, 1] * gx + R[i, 1, 1] * gy + R[i, 2, 1] * gz
        b2 = R[i, 0, 2] * gx + R[i, 1, 2] * gy + R[i, 2, 2] * gz
        sx, sy, sz = axis[i, 0] * rate, axis[i, 1] * rate, axis[i, 2] * rate
        cx, cy, cz = a1 * sz - a2 * sy, a2 * sx - a0 * sz, a0 * sy - a1 * sx
        if kind[i] == PRISMATIC:
            b0 += 2.0 * cx
            b1 += 2.0 * cy
            b2 += 2.0 * cz
        else:
            e0 += cx
            e1 += cy
            e2 += cz
            a0 += sx
            a1 += sy
            a2 += sz
        w[i, 0], w[i, 1], w[i, 2] = a0, a1, a2
        u[i, 0], u[i, 1], u[i, 2] = e0, e1, e2
        b[i, 0], b[i, 1], b[i, 2] = b0, b1, b2
        m, hx, hy, hz = bodies[i, 0], bodies[i, 1], bodies[i, 2], bodies[i, 3]
        xx, xy, yy = bodies[i, 4], bodies[i, 5], bodies[i, 6]
        xz, yz, zz = bodies[i, 7], bodies[i, 8], bodies[i, 9]
        kx, ky, kz = a1 * hz - a2 * hy, a2 * hx - a0 * hz, a0 * hy - a1 * hx
        f[i, 0] = m * b0 + e1 * hz - e2 * hy + a1 * kz - a2 * ky
        f[i, 1] = m * b1 + e2 * hx - e0 * hz + a2 * kx - a0 * kz
        f[i, 2] = m * b2 + e0 * hy - e1 * hx + a0 * ky - a1 * kx
        kx = xx * a0 + xy * a1 + xz * a2
        ky = xy * a0 + yy * a1 + yz * a2
        kz = xz * a0 + yz * a1 + zz * a2
        t[i, 0] = xx * e0 + xy * e1 + xz * e2 + a1 * kz - a2 * ky + hy * b2 - hz * b1
        t[i, 1] = xy * e0 + yy * e1 + yz * e2 + a2 * kx - a0 * kz + hz * b0 - hx * b2
        t[i, 2] = xz * e0 + yz * e1 + zz * e2 + a0 * ky - a1 * kx + hx * b1 - hy * b0
        for k in range(10):
            C[i, k] = bodies[i, k]
    for i in range(links - 1, -1, -1):
        p, c, s = parent[i], column[i], factor[i]
        sx, sy, sz = axis[i, 0], axis[i, 1], axis[i, 2]
        m, hx, hy, hz = C[i, 0], C[i, 1], C[i, 2], C[i, 3]
        xx, xy, yy, xz, yz, zz = C[i, 4], C[i, 5], C[i, 6], C[i, 7], C[i, 8], C[i, 9]
        # The links' effort, and the force and torque that accelerate all that hangs on this joint.
        if kind[i] == PRISMATIC:
            h[c] += s * (sx * f[i, 0] + sy * f[i, 1] + sz * f[i, 2])
            fx, fy, fz = m * sx, m * sy, m * sz
            tx, ty, tz = hy * sz - hz * sy, hz * sx - hx * sz, hx * sy - hy * sx
            M[c, c] += s * s * (sx * fx + sy * fy + sz * fz)
        else:
            h[c] += s * (sx * t[i, 0] + sy * t[i, 1] + sz * t[i, 2])
            fx, fy, fz = sy * hz - sz * hy, sz * hx - sx * hz, sx * hy - sy * hx
            tx = xx * sx + xy * sy + xz * sz
            ty = xy * sx + yy * sy + yz * sz
            tz = xz * sx + yz * sy + zz * sz
            M[c, c] += s * s * (sx * tx + sy * ty + sz * tz)
        j = i
        while parent[j] >= 0:
            gx = R[j, 0, 0] * fx + R[j, 0, 1] * fy + R[j, 0, 2] * fz
            gy = R[j, 1, 0] * fx + R[j, 1, 1] * fy + R[j, 1, 2] * fz
            gz = R[j, 2, 0] * fx + R[j, 2, 1] * fy + R[j, 2, 2] * fz
            x, y, z = r[j, 0], r[j, 1], r[j, 2]
            kx = R[j, 0, 0] * tx + R[j, 0, 1] * ty + R[j, 0, 2] * tz + y * gz - z * gy
            ky = R[j, 1, 0] * tx + R[j, 1, 1] * ty + R[j, 1, 2] * tz + z * gx - x * gz
            kz = R[j, 2, 0] * tx + R[j, 2, 1] * ty + R[j, 2, 2] * tz + x * gy - y * gx
            fx, fy, fz, tx, ty, tz = gx, gy, gz, kx, ky, kz
            j = parent[j]
            if kind[j] == PRISMATIC:
                value = axis[j, 0] * fx + axis[j, 1] * fy + axis[j, 2] * fz
            else:
                value = axis[j, 0] * tx + axis[j, 1] * ty + axis[j, 2] * tz
            value *= s * factor[j]
            M[c, column[j]] += value
            M[column[j], c] += value
        if p < 0:
            continue
        x, y, z = r[i, 0], r[i, 1], r[i, 2]
        gx = R[i, 0, 0] * f[i, 0] + R[i, 0, 1] * f[i, 1] + R[i, 0, 2] * f[i, 2]
        gy = R[i, 1, 0] * f[i, 0] + R[i, 1, 1] * f[i, 1] + R[i, 1, 2] * f[i, 2]
        gz = R[i, 2, 0] * f[i, 0] + R[i, 2, 1] * f[i, 1] + R[i, 2, 2] * f[i, 2]
        f[p, 0] += gx
        f[p, 1] += gy
        f[p, 2] += gz
        kx = R[i, 0, 0] * t[i, 0] + R[i, 0, 1] * t[i, 1] + R[i, 0, 2] * t[i, 2]
        ky = R[i, 1, 0] * t[i, 0] + R[i, 1, 1] * t[i, 1] + R[i, 1, 2] * t[i, 2]
        kz = R[i, 2, 0] * t[i, 0] + R[i, 2, 1] * t[i, 1] + R[i, 2, 2] * t[i, 2]
        t[p, 0] += kx + y * gz - z * gy
        t[p, 1] += ky + z * gx - x * gz
        t[p, 2] += kz + x * gy - y * gx
        # The same body about the parent's origin, in its axes.
        gx = R[i, 0, 0] * hx + R[i, 0, 1] * hy + R[i, 0, 2] * hz
        gy = R[i, 1, 0] * hx + R[i, 1, 1] * hy + R[i, 1, 2] * hz
        gz = R[i, 2, 0] * hx + R[i, 2, 1] * hy + R[i, 2, 2] * hz
        a0 = R[i, 0, 0] * xx + R[i, 0, 1] * xy + R[i, 0, 2] * xz
        a1 = R[i, 0, 0] * xy + R[i, 0, 1] * yy + R[i, 0, 2] * yz
        a2 = R[i, 0, 0] * xz + R[i, 0, 1] * yz + R[i, 0, 2] * zz
        b0 = R[i, 1, 0] * xx + R[i, 1, 1] * xy + R[i, 1, 2] * xz
        b1 = R[i, 1, 0] * xy + R[i, 1, 1] * yy + R[i, 1, 2] * yz
        b2 = R[i, 1, 0] * xz + R[i, 1, 1] * yz + R[i, 1, 2] * zz
        e0 = R[i, 2, 0] * xx + R[i, 2, 1] * xy + R[i, 2, 2] * xz
        e1 = R[i, 2, 0] * xy + R[i, 2, 1] * yy + R[i, 2, 2] * yz
        e2 = R[i, 2, 0] * xz + R[i, 2, 1] * yz + R[i, 2, 2] * zz
        # Twice the first moment along the offset, and the offset's own square.
        wx, wy, wz = 2.0 * x * gx + m * x * x, 2.0 * y * gy + m * y * y, 2.0 * z * gz + m * z * z
        C[p, 0] += m
        C[p, 1] += gx + m * x
        C[p, 2] += gy + m * y
        C[p, 3] += gz + m * z
        C[p, 4] += a0 * R[i, 0, 0] + a1 * R[i, 0, 1] + a2 * R[i, 0, 2] + wy + wz
        C[p, 5] += a0 * R[i, 1, 0] + a1 * R[i, 1, 1] + a2 * R[i, 1, 2] - x * gy - y * gx - m * x * y
        C[p, 6] += b0 * R[i, 1, 0] + b1 * R[i, 1, 1] + b2 * R[i, 1, 2] + wx + wz
        C[p, 7] += a0 * R[i, 2, 0] + a1 * R[i, 2, 1] + a2 * R[i, 2, 2] - x * gz - z * gx - m * x * z
        C[p, 8] += b0 * R[i, 2, 0] + b1 * R[i, 2, 1] + b2 * R[i, 2, 2] - y * gz - z * gy - m * y * z
        C[p, 9] += e0 * R[i, 2, 0] + e1 * R[i, 2, 1] + e2 * R[i, 2, 2] + wx + wy


def dynamics_at(
    arm: Any, q: Array, v: Array, space: Any, M: Array, h: Array, M2: Array, h2: Array
) -> None:
    """Write mass matrix and bias, drives and offsets included, and those of what carries load."""
    tree, bodies, drive, constant, load = arm[0], arm[1], arm[3], arm[4], arm[12]
    tilted = arm[10]
    n = len(q)
    links_at(tree, bodies, arm[2], q, v, space, M, h)
    if len(tilted):
        # What other bodies weigh more under a gravity that is tilted.
        for i in range(n):
            h2[i] = 0.0
        links_at(tree, tilted, arm[11], q, h2, space, M2, h2[n:])
        for i in range(n):
            h[i] += h2[n + i]
    for i in range(n):
        h[i] += constant[i]
        for j in range(n):
            M[i, j] += drive[i, j]
    if len(load):
        links_at(tree, load, arm[13], q, v, space, M2, h2[:n])
