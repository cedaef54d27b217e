"""Velocities after a time with one mass matrix and effort, friction solved for, for a compiler.

Contacts are what rubs with a jump: a joint, or the motor of two coupled ones. One that reaches its
jump within the time stops there, and sticks or goes on. Between jumps, slopes enter linearly
implicitly, with weights that are exact for one linear joint.
"""

from __future__ import annotations

import math
from typing import Any

from sdpid._common.arrays import Array
from sdpid.experiment.simulation.kernels.friction import bounds_at, smooth_at
from sdpid.experiment.simulation.kernels.layout import (
    CARRIED,
    CHANGE,
    MASSES,
    PUSH,
    SLOPES,
    SLOPES1,
    SMOOTH,
    SMOOTH1,
    TRIAL,
    VISCOUS,
)

# A joint this near (rad/s) to where its friction jumps is there: rounding of steps is far smaller.
AT_JUMP = 1e-9

# Parts of a step that friction may need: a joint that passes a smooth sign 1e-4 of the step's
# change of speed wide takes about fifty. After these the rest is done at once.
PARTS = 200

# Change of friction within a part that its slope may miss, as a share of the change of speed.
CURVED = 0.02

# Rounds in which contacts are found to stick or to slip; each changes one.
DECISIONS = 30

# Compliance of a stuck joint, as a share of its mobility: two contacts on one joint share a load.
COMPLIANCE = 1e-12


def solve_in_place(K: Array, size: int) -> None:
    """Solve K[:, :size] x = K[:, size] into that column: elimination with the largest pivots."""
    for c in range(size):
        best = c
        for i in range(c + 1, size):
            if abs(K[i, c]) > abs(K[best, c]):
                best = i
        if best != c:
            for j in range(c, size + 1):
                K[c, j], K[best, j] = K[best, j], K[c, j]
        for i in range(c + 1, size):
            if K[i, c] != 0.0:
                ratio = K[i, c] / K[c, c]
                for j in range(c + 1, size + 1):
                    K[i, j] -= ratio * K[c, j]
    for i in range(size - 1, -1, -1):
        total = K[i, size]
        for j in range(i + 1, size):
            total -= K[i, j] * K[j, size]
        K[i, size] = total / K[i, i]


def weight_of(z: float) -> float:
    """Return the weight of the end of a step that is exact for one joint with slope z."""
    if abs(z) < 0.1:
        return 0.5 + z / 12.0 - z**3 / 720.0
    if z > 40.0:
        return 1.0 - 1.0 / z
    z = max(z, -1.0)
    return 1.0 / (1.0 - math.exp(-z)) - 1.0 / z


def weight_of_feedback(z: float) -> float:
    """Return the weight of the end of a step for a controller whose damping has the slope z.

    One half takes its effort as the mean over the step: however stiff the loop is, the effort at
    the end then is that of the motion. A loop that settles within a step is damped to the end.
    """
    return 1.0 - 1.0 / z if z > 2.0 else 0.5


def change_over(
    robot: Any,
    D: Array,
    v: Array,
    dt: float,
    fixed: Any,
    given: Array,
    memory: Any,
) -> None:
    """Write the change of velocities over a time in which nothing reaches a jump of friction.

    Masses, effort less bias, friction and its slopes are read from the memory, and the change is
    written there. Contacts at their jump are stuck, or slip where what holds them is not enough.
    """
    K, M, S = memory.system, memory.matrices[MASSES], memory.matrices[SLOPES]
    V = robot.matrices[VISCOUS]
    dv, F, g = memory.vectors[CHANGE], memory.vectors[SMOOTH], memory.vectors[PUSH]
    mode, at, bounds = memory.states[0], memory.states[1], memory.bounds
    contacts, values = robot.contacts, robot.jumps
    n, count = len(v), len(contacts)
    moves = dt > AT_JUMP
    for k in range(count):
        i, j = contacts[k, 0], contacts[k, 1]
        apart = v[i] + (v[j] if j >= 0 else 0.0) - values[k, 0]
        held = fixed[i] and (j < 0 or fixed[j])
        at[k] = 1 if abs(apart) <= AT_JUMP and bounds[k, 0] < bounds[k, 1] and not held else 0
        mode[k] = 0 if abs(apart) <= AT_JUMP else (1 if apart > 0.0 else -1)
    for _ in range(DECISIONS):
        size = n
        for k in range(count):
            if at[k] and mode[k] == 0:
                size += 1
        for i in range(size):
            for j in range(size + 1):
                K[i, j] = 0.0
        for i in range(n):
            if fixed[i]:
                K[i, i], K[i, size] = 1.0, dt * given[i]
                continue
            weight = dt * weight_of(dt * (V[i, i] + S[i, i]) / M[i, i])
            gain = dt * weight_of_feedback(dt * (D[i, i] - V[i, i]) / M[i, i])
            total = g[i] - F[i]
            for j in range(n):
                total -= D[i, j] * v[j]
                K[i, j] = M[i, j] + weight * (V[i, j] + S[i, j]) + gain * (D[i, j] - V[i, j])
            K[i, size] = dt * total
        row = n
        for k in range(count):
            i, j = contacts[k, 0], contacts[k, 1]
            if at[k] and mode[k] == 0:
                apart = v[i] + (v[j] if j >= 0 else 0.0) - values[k, 0]
                K[row, row] = -COMPLIANCE / abs(M[i, i])
                K[row, size] = -apart if moves else 0.0
                K[row, i] = 1.0
                if not fixed[i]:
                    K[i, row] = 1.0
                if j >= 0:
                    K[row, j] = 1.0
                    if not fixed[j]:
                        K[j, row] = 1.0
                row += 1
                continue
            force = 0.5 * (bounds[k, 0] + bounds[k, 1])
            if mode[k] > 0:
                force = bounds[k, 1]
            elif mode[k] < 0:
                force = bounds[k, 0]
            if not fixed[i]:
                K[i, size] -= dt * force
            if j >= 0 and not fixed[j]:
                K[j, size] -= dt * force
        solve_in_place(K, size)
        # The stuck contact that is held worst lets go; one that let go to the wrong side sticks.
        worst, changed, row = 0.0, -1, n
        for k in range(count):
            if not at[k]:
                continue
            if mode[k] == 0:
                force = K[row, size] / dt
                row += 1
                over = max(force - bounds[k, 1], bounds[k, 0] - force)
                if over > worst and over > 1e-12 * (bounds[k, 1] - bounds[k, 0]):
                    worst, changed = over, k
        if changed < 0:
            for k in range(count):
                if at[k] and mode[k] != 0:
                    i, j = contacts[k, 0], contacts[k, 1]
                    moved = K[i, size] + (K[j, size] if j >= 0 else 0.0)
                    if moved * mode[k] < 0.0:
                        changed = k
            if changed < 0:
                break
            mode[changed] = 0
            continue
        row = n
        for k in range(changed):
            if at[k] and mode[k] == 0:
                row += 1
        mode[changed] = 1 if K[row, size] / dt > bounds[changed, 1] else -1
    for i in range(n):
        dv[i] = K[i, size]
    for k in range(count):
        i = contacts[k, 0]
        if at[k] and mode[k] == 0 and contacts[k, 1] < 0:
            # Exactly: what sticks does not creep.
            dv[i] = values[k, 0] - v[i] if moves else 0.0


def advance(
    robot: Any,
    D: Array,
    v: Array,
    dt: float,
    fixed: Any,
    given: Array,
    memory: Any,
    end: Array,
) -> None:
    """Write the velocities after a time with the memory's mass matrix and effort."""
    M, S, S1 = memory.matrices[MASSES], memory.matrices[SLOPES], memory.matrices[SLOPES1]
    dv, F, F1 = memory.vectors[CHANGE], memory.vectors[SMOOTH], memory.vectors[SMOOTH1]
    trial, carried = memory.vectors[TRIAL], memory.vectors[CARRIED]
    contacts, values = robot.contacts, robot.jumps
    n = len(v)
    curved = len(robot.which) > 0 or robot.loaded
    bounds_at(robot, carried, memory.bounds)
    for i in range(n):
        end[i] = v[i]
    left, part = dt, dt
    for count in range(PARTS):
        last = count == PARTS - 1
        part = left if last else min(part, left)
        smooth_at(robot, carried, end, F, S)
        change_over(robot, D, end, part, fixed, given, memory)
        share, reached = 1.0, -1
        if not last:
            for k in range(len(contacts)):
                i, j = contacts[k, 0], contacts[k, 1]
                before = end[i] + (end[j] if j >= 0 else 0.0) - values[k, 0]
                if abs(before) <= AT_JUMP:
                    continue
                after = before + dv[i] + (dv[j] if j >= 0 else 0.0)
                if before * after < 0.0 and before / (before - after) < share:
                    share, reached = before / (before - after), k
            if curved:
                largest = 0.0
                for i in range(n):
                    trial[i] = end[i] + share * dv[i]
                    largest = max(largest, abs(dv[i]))
                smooth_at(robot, carried, trial, F1, S1)
                missed = 0.0
                for i in range(n):
                    line = F[i]
                    for j in range(n):
                        line += S[i, j] * share * dv[j]
                    missed = max(missed, abs((F1[i] - line) * part / M[i, i]))
                if missed > CURVED * largest + AT_JUMP:
                    part *= 0.5
                    continue
        for i in range(n):
            end[i] += share * dv[i]
        if reached >= 0:
            i, j = contacts[reached, 0], contacts[reached, 1]
            if j < 0:
                end[i] = values[reached, 0]
        left -= share * part
        if left <= 1e-12 * dt:
            break
        part *= 2.0
