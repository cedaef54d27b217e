"""Friction between its jumps: curves of the velocity and their slopes, written for a compiler."""

from __future__ import annotations

import math
from typing import Any

from sdpid._common.arrays import Array

# Kinds of smooth curves, as terms name them.
KINDS = ("tanh", "root", "peak", "smooth_peak", "line")
TANH, ROOT, PEAK_REST, SMOOTH_PEAK, LINE = range(5)


def sign_of(x: float) -> float:
    """Return -1, 0 or 1."""
    if x > 0.0:
        return 1.0
    if x < 0.0:
        return -1.0
    return 0.0


def curve_at(kind: int, side: int, c: float, a: float, b: float, w: float, x: float) -> Any:
    """Return value and slope of a curve of friction, without its jumps."""
    sign, speed = sign_of(x), abs(x)
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
    n = len(v)
    for i in range(n):
        F[i] = 0.0
        for j in range(n):
            S[i, j] = 0.0
    for p in range(len(which)):
        j, k = which[p, 0], which[p, 1]
        x = v[j] + (v[k] if k >= 0 else 0.0)
        value, slope = curve_at(
            which[p, 2], which[p, 3], curves[p, 0], curves[p, 1], curves[p, 2], curves[p, 3], x
        )
        F[j] += value
        S[j, j] += slope
        if k >= 0:
            F[k] += value
            S[k, k] += slope
            S[j, k] += slope
            S[k, j] += slope
    if robot.loaded:
        for j in range(n):
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
