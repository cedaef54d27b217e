"""Steps of motion, friction solved for, written for a compiler.

A step is of second order in its length: positions go half a step on, mass matrix and bias are
taken there once (leapfrog), and the step's velocities bring the positions to its end.

Contacts are what rubs with a jump: a joint, or the motor of two coupled ones. One that reaches its
jump within the time stops there, and sticks or goes on. Between jumps, slopes enter linearly
implicitly, with weights that are exact for one linear joint.
"""

from __future__ import annotations

import math
from typing import Any

from sdpid._common.arrays import Array
from sdpid.experiment.simulation.kernels import links as slot
from sdpid.experiment.simulation.kernels.links import (
    add_plays,
    along,
    bounds_at,
    dynamics_at,
    smooth_at,
)

# No joint of a working robot moves this fast (rad/s or m/s): what does has diverged.
RUNAWAY = 1e3

# Rounds for friction that grows with the load, each shrinking the error by the share that it takes.
LOAD_ROUNDS = 100
SETTLED = 1e-10

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
    z = max(z, -1.0)
    return 1.0 / (1.0 - math.exp(-z)) - 1.0 / z


def weight_of_feedback(z: float) -> float:
    """Return the weight of the end of a step for a controller whose damping has the slope z.

    One half takes its effort as the mean over the step: however stiff the loop is, the effort at
    the end then is that of the motion. A loop that settles within a step is damped to the end.
    """
    return 1.0 - 1.0 / z if z > 2.0 else 0.5


def is_settled(change: Array, dt: float, a: Array) -> bool:
    """Write accelerations that change velocities over a time; tell whether they were so before."""
    moved, size = 0.0, 0.0
    for i in range(len(a)):
        found = change[i] / dt
        moved, size = max(moved, abs(found - a[i])), max(size, abs(found))
        a[i] = found
    return moved <= SETTLED * size


def carry_load(robot: Any, memory: Any, a: Array) -> None:
    """Write the load that joints carry at some accelerations."""
    vectors, M = memory.vectors, memory.matrices[slot.MASSES2]
    h, carried = vectors[slot.BIAS2], vectors[slot.CARRIED]
    if robot.loaded:
        for i in range(len(a)):
            total = h[i]
            for j in range(len(a)):
                total += M[i, j] * a[j]
            carried[i] = abs(total)


def speed_at(robot: Any, k: int, v: Array) -> Any:
    """Return the velocity of a contact, from its joints' own."""
    return along(robot.contacts, 0, robot.jumps, slot.OF_JUMP, k, v)


def change_over(robot: Any, v: Array, dt: float, memory: Any) -> None:
    """Write the change of velocities over a time in which nothing reaches a jump of friction.

    Masses, effort less bias, friction and its slopes are read from the memory, and the change is
    written there. Contacts at their jump are stuck, or slip where what holds them is not enough.
    Each contact has a row of the system, in which its impulse is found.
    """
    vectors, matrices, V = memory.vectors, memory.matrices, robot.matrices[slot.VISCOUS]
    K, M, S, D = memory.system, matrices[slot.MASSES], matrices[slot.SLOPES], matrices[slot.DAMPING]
    dv, F, g = vectors[slot.CHANGE], vectors[slot.SMOOTH], vectors[slot.PUSH]
    mode, at, bounds = memory.states[0], memory.states[1], memory.bounds
    contacts, values, fixed = robot.contacts, robot.jumps, memory.fixed
    n, count = len(v), len(contacts)
    size, moves = n + count, dt > AT_JUMP
    for k in range(count):
        apart, held = speed_at(robot, k, v) - values[k, 0], True
        for joint in contacts[k]:
            held = held and (joint < 0 or fixed[joint])
        near = abs(apart) <= AT_JUMP
        at[k] = 1 if near and bounds[k, 0] < bounds[k, 1] and not held else 0
        mode[k] = 0 if near else (1 if apart > 0.0 else -1)
    for _ in range(DECISIONS):
        K[:size] = 0.0
        for i in range(n):
            if fixed[i]:
                K[i, i], K[i, size] = 1.0, dt * vectors[slot.GIVEN, i]
                continue
            weight = dt * weight_of(dt * (V[i, i] + S[i, i]) / M[i, i])
            gain = dt * weight_of_feedback(dt * (D[i, i] - V[i, i]) / M[i, i])
            total = g[i] - F[i]
            for j in range(n):
                total -= D[i, j] * v[j]
                K[i, j] = M[i, j] + weight * (V[i, j] + S[i, j]) + gain * (D[i, j] - V[i, j])
            K[i, size] = dt * total
        for k in range(count):
            row, sticks = n + k, at[k] and mode[k] == 0
            force = 0.5 * (bounds[k, 0] + bounds[k, 1])
            if mode[k] != 0:
                force = bounds[k, 1] if mode[k] > 0 else bounds[k, 0]
            K[row, row], K[row, size] = 1.0, dt * force
            if sticks:
                i = contacts[k, 0]
                K[row, row] = -COMPLIANCE / abs(M[i, i])
                K[row, size] = values[k, 0] - speed_at(robot, k, v) if moves else 0.0
            for w in range(contacts.shape[1]):
                joint, factor = contacts[k, w], values[k, slot.OF_JUMP + w]
                if joint < 0:
                    break
                if sticks:
                    K[row, joint] = factor
                if not fixed[joint]:
                    K[joint, row] = factor if sticks else 0.0
                    K[joint, size] -= 0.0 if sticks else dt * force * factor
        solve_in_place(K, size)
        for i in range(n):
            dv[i] = K[i, size]
        # The stuck contact that is held worst lets go; one that let go to the wrong side sticks.
        worst, changed, side = 0.0, -1, 0
        for k in range(count):
            over, under = K[n + k, size] / dt - bounds[k, 1], bounds[k, 0] - K[n + k, size] / dt
            far = max(over, under)
            least = max(worst, 1e-12 * (bounds[k, 1] - bounds[k, 0]))
            if at[k] and mode[k] == 0 and far > least:
                worst, changed, side = far, k, 1 if over > 0.0 else -1
        for k in range(count if changed < 0 else 0):
            if at[k] and speed_at(robot, k, dv) * mode[k] < 0.0:
                changed = k
        if changed < 0:
            break
        mode[changed] = side
    for k in range(count):
        i = contacts[k, 0]
        if at[k] and mode[k] == 0 and contacts[k, 1] < 0:
            # Exactly: what sticks does not creep.
            dv[i] = values[k, 0] / values[k, slot.OF_JUMP] - v[i] if moves else 0.0


def reached_at(robot: Any, v: Array, dv: Array) -> Any:
    """Return the share of a change of velocities at which a contact reaches its jump, and which."""
    share, reached = 1.0, -1
    for k in range(len(robot.contacts)):
        before = speed_at(robot, k, v) - robot.jumps[k, 0]
        after = before + speed_at(robot, k, dv)
        if abs(before) > AT_JUMP and before * after < 0.0 and before / (before - after) < share:
            share, reached = before / (before - after), k
    return share, reached


def is_curved(robot: Any, v: Array, share: float, part: float, memory: Any) -> bool:
    """Return whether friction leaves its slopes within a share of the change over a part."""
    vectors, matrices = memory.vectors, memory.matrices
    M, S, S1 = matrices[slot.MASSES], matrices[slot.SLOPES], matrices[slot.SLOPES1]
    dv, F, F1 = vectors[slot.CHANGE], vectors[slot.SMOOTH], vectors[slot.SMOOTH1]
    trial, n = vectors[slot.TRIAL], len(v)
    largest, missed = 0.0, 0.0
    for i in range(n):
        trial[i] = v[i] + share * dv[i]
        largest = max(largest, abs(dv[i]))
    smooth_at(robot, vectors[slot.CARRIED], trial, F1, S1)
    for i in range(n):
        line = F[i]
        for j in range(n):
            line += S[i, j] * share * dv[j]
        missed = max(missed, abs((F1[i] - line) * part / M[i, i]))
    return missed > CURVED * largest + AT_JUMP


def advance(robot: Any, dt: float, memory: Any) -> None:
    """Write the velocities after a time with the memory's mass matrix and effort."""
    vectors = memory.vectors
    v, end, dv = vectors[slot.SPEED], vectors[slot.NEXT_SPEED], vectors[slot.CHANGE]
    F, carried = vectors[slot.SMOOTH], vectors[slot.CARRIED]
    bounds_at(robot, carried, memory.bounds)
    for i in range(len(v)):
        end[i] = v[i]
    left, part = dt, dt
    for count in range(PARTS):
        last = count == PARTS - 1
        part = left if last else min(part, left)
        smooth_at(robot, carried, end, F, memory.matrices[slot.SLOPES])
        change_over(robot, end, part, memory)
        share, reached = 1.0, -1
        if not last:
            share, reached = reached_at(robot, end, dv)
            smooth = len(robot.which) == 0 and not (robot.loaded or robot.bent)
            if not smooth and is_curved(robot, end, share, part, memory):
                part *= 0.5
                continue
        for i in range(len(v)):
            end[i] += share * dv[i]
        if reached >= 0 and robot.contacts[reached, 1] < 0:
            jump = robot.jumps[reached, 0] / robot.jumps[reached, slot.OF_JUMP]
            end[robot.contacts[reached, 0]] = jump
        left -= share * part
        if left <= 1e-12 * dt:
            break
        part *= 2.0


def step_of(robot: Any, known: bool, dt: float, memory: Any) -> None:
    """Write the next positions and velocities, and the mean accelerations until then.

    State, effort, damping and what is given of joints that are not free stand in the memory. The
    accelerations there are those of the step before where they are `known`.
    """
    vectors, fixed, given = memory.vectors, memory.fixed, memory.vectors[slot.GIVEN]
    q, v, a = vectors[slot.NOW], vectors[slot.SPEED], vectors[slot.ACCELERATION]
    q1, v1, dv = vectors[slot.NEXT], vectors[slot.NEXT_SPEED], vectors[slot.CHANGE]
    qm, vm, g = vectors[slot.MIDDLE], vectors[slot.RATE], vectors[slot.PUSH]
    n = len(q)
    if not known:
        add_plays(robot, q, memory, True, True, g)
    for i in range(n):
        qm[i] = q[i] + 0.5 * dt * v[i]
        a[i] = a[i] if known else 0.0
    for _ in range(1 if known else 2):
        for i in range(n):
            vm[i] = v[i] + 0.5 * dt * (given[i] if fixed[i] else a[i])
        dynamics_at(robot, qm, vm, memory)
        for i in range(n):
            g[i] = vectors[slot.EFFORT, i] - vectors[slot.BIAS, i]
        add_plays(robot, qm, memory, False, False, g)
        for _ in range(LOAD_ROUNDS if robot.loaded else 1):
            carry_load(robot, memory, a)
            advance(robot, dt, memory)
            for i in range(n):
                dv[i] = v1[i] - v[i]
            if is_settled(dv, dt, a):
                break
    for i in range(n):
        q1[i] = qm[i] + 0.5 * dt * v1[i]
    add_plays(robot, q1, memory, True, False, g)


def has_diverged(v: Array) -> bool:
    """Return whether a velocity is no number, or beyond what any robot has."""
    slow = True
    for speed in v:
        slow = slow and abs(speed) < RUNAWAY
    return not slow
