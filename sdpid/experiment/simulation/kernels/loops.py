"""Runs of many steps, in closed and in open loop, and many states at once, for a compiler."""

from __future__ import annotations

from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.simulation.kernels.friction import bounds_at, sign_of, smooth_at
from sdpid.experiment.simulation.kernels.links import dynamics_at
from sdpid.experiment.simulation.kernels.solve import change_over
from sdpid.experiment.simulation.kernels.step import (
    LOAD_ROUNDS,
    SETTLED,
    has_diverged,
    memory_of,
    step_of,
)

# A time (s) in which no velocity changes: accelerations are changes over it.
INSTANT = 1e-15

# Laws of control.
JOINT_GAINS, INVERSE_DYNAMICS = 0, 1

# Samples this near to a step's end, as a share of the step, belong to the next one.
NEAR = 1e-6


def law_at(
    law: Any,
    inverse: Any,
    q: Array,
    v: Array,
    desired: Array,
    integral: Array,
    memory: Any,
    effort: Array,
    slope: Array,
) -> None:
    """Write the effort of a controller but for its feedback of velocity, and the gains of that."""
    kind, gains, limit = law[0], law[1], law[2]
    first, second, third = memory
    M, h, M2, h2, u, carried = third[0], third[1], third[2], third[3], third[4], third[7]
    F, S = second[3], second[2]
    n = len(q)
    slope[:] = 0.0
    for i in range(n):
        u[i] = (
            gains[0, i] * (desired[0, i] - q[i])
            + gains[1, i] * gains[3, i] * desired[1, i]
            + gains[2, i] * integral[i]
        )
    if kind == JOINT_GAINS:
        for i in range(n):
            effort[i] = u[i]
            slope[i, i] = gains[1, i]
    else:
        viscous, contacts, values = inverse[5], inverse[8], inverse[9]
        dynamics_at(inverse, q, v, first, M, h, M2, h2)
        carried[:] = 0.0
        smooth_at(inverse, carried, desired[1], F, S)
        for i in range(n):
            effort[i] = h[i] + F[i]
            for j in range(n):
                effort[i] += M[i, j] * (desired[2, j] + u[j]) + viscous[i, j] * desired[1, j]
                slope[i, j] = M[i, j] * gains[1, j]
        for k in range(len(contacts)):
            i, j = contacts[k, 0], contacts[k, 1]
            sign = sign_of(desired[1, i] + (desired[1, j] if j >= 0 else 0.0) - values[k, 0])
            force = 0.5 * (1.0 + sign) * values[k, 2] + 0.5 * (1.0 - sign) * values[k, 1]
            effort[i] += force
            if j >= 0:
                effort[j] += force
    for i in range(n):
        total = effort[i]
        for j in range(n):
            total -= slope[i, j] * v[j]
        if abs(total) > limit[i]:
            effort[i] = limit[i] if total > 0.0 else -limit[i]
            for j in range(n):
                slope[i, j] = 0.0


def closed_loop(
    arm: Any,
    law: Any,
    inverse: Any,
    desired: Array,
    noise: Array,
    times: Array,
    steps: int,
    every: int,
    dt: float,
    differenced: bool,
    start: Array,
    out: Array,
) -> int:
    """Write positions, velocities, held efforts, measured positions and integrals at sample times.

    With `every` steps of effort held, `desired` has one row for each time of control; without, one
    for each middle of a step. Return how many samples were written before the motion diverged.
    """
    tree = arm[0]
    n = len(arm[4])
    memory = memory_of(len(tree[0]), n, len(arm[8]))
    ideal = memory_of(len(inverse[0][0]), n, len(inverse[8]))
    q, v, a, q1, v1 = start[0].copy(), start[1].copy(), np.zeros(n), np.zeros(n), np.zeros(n)
    qm, vm, integral, seen, effort = q.copy(), v.copy(), np.zeros(n), np.zeros(n), np.zeros(n)
    before, error = np.zeros(n), np.zeros(n)
    slope, D, nothing = np.zeros((n, n)), arm[5].copy(), np.zeros(n)
    fixed = np.zeros(n, dtype=np.bool_)
    known, sample = False, 0
    for step in range(steps):
        if every > 0:
            if step % every == 0:
                period = dt * every
                row = step // every
                for i in range(n):
                    seen[i] = noise[row % len(noise), i]
                    qm[i] = q[i] + seen[i]
                    vm[i] = v[i]
                    if differenced and row > 0:
                        vm[i] = (qm[i] - before[i]) / period
                    before[i] = qm[i]
                    error[i] = desired[row, 0, i] - qm[i]
                law_at(law, inverse, qm, vm, desired[row], integral, ideal, effort, slope)
                for i in range(n):
                    free = False
                    for j in range(n):
                        free = free or slope[i, j] != 0.0
                        effort[i] -= slope[i, j] * vm[j]
                    if free or law[1][1, i] == 0.0:
                        integral[i] += period * error[i]
        else:
            for i in range(n):
                qm[i] = q[i] + 0.5 * dt * v[i]
                vm[i] = v[i] + 0.5 * dt * a[i]
                error[i] = desired[step, 0, i] - qm[i]
                before[i] = integral[i] + 0.5 * dt * error[i]
            law_at(law, inverse, qm, vm, desired[step], before, ideal, effort, slope)
            for i in range(n):
                free = False
                for j in range(n):
                    free = free or slope[i, j] != 0.0
                    D[i, j] = arm[5][i, j] + slope[i, j]
                if free or law[1][1, i] == 0.0:
                    integral[i] += dt * error[i]
        step_of(arm, q, v, a, known, effort, D, dt, fixed, nothing, memory, q1, v1)
        known = True
        if has_diverged(v1):
            return sample
        while sample < len(times) and times[sample] < (step + 1 - NEAR) * dt:
            x = times[sample] / dt - step
            for i in range(n):
                rise = q1[i] - q[i]
                # Cubic between the ends of the step, which have their velocities.
                out[0, sample, i] = q[i] + x * (
                    dt * v[i]
                    + x * (3.0 * rise - dt * (2.0 * v[i] + v1[i]))
                    + x * x * (dt * (v[i] + v1[i]) - 2.0 * rise)
                )
                out[1, sample, i] = v[i] + x * (v1[i] - v[i])
                out[2, sample, i] = effort[i]
                out[3, sample, i] = out[0, sample, i] + seen[i]
                out[4, sample, i] = integral[i]
            sample += 1
        for i in range(n):
            q[i], v[i] = q1[i], v1[i]
    return sample


def open_loop(
    arm: Any,
    q: Array,
    v: Array,
    a: Array,
    known: bool,
    effort: Array,
    dt: float,
    fixed: Any,
    record: Array,
    out: Array,
    count: Any,
) -> None:
    """Write positions and velocities (2, S, T + 1, n) of S segments under efforts (S, T, n).

    Joints that are `fixed`, (S, n), follow the record (2, S, T + 1, n). `count` gets the states of
    each segment before it diverged.
    """
    n = len(arm[4])
    memory = memory_of(len(arm[0][0]), n, len(arm[8]))
    given = np.zeros(n)
    q0, v0, q1, v1 = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    for s in range(len(q)):
        q0[:] = q[s]
        v0[:] = v[s]
        going = known
        count[s] = 0
        if has_diverged(v0):
            continue
        out[0, s, 0] = q0
        out[1, s, 0] = v0
        count[s] = 1
        for k in range(effort.shape[1]):
            for i in range(n):
                if fixed[s, i]:
                    q0[i] = 0.5 * (record[0, s, k, i] + record[0, s, k + 1, i])
                    given[i] = (record[1, s, k + 1, i] - record[1, s, k, i]) / dt
                    v0[i] = record[1, s, k, i]
                    q0[i] -= 0.5 * dt * v0[i]
            step_of(
                arm, q0, v0, a[s], going, effort[s, k], arm[5], dt, fixed[s], given, memory, q1, v1
            )
            going = True
            for i in range(n):
                if fixed[s, i]:
                    q1[i], v1[i] = record[0, s, k + 1, i], record[1, s, k + 1, i]
            if has_diverged(v1):
                break
            q0[:] = q1
            v0[:] = v1
            out[0, s, k + 1] = q1
            out[1, s, k + 1] = v1
            count[s] = k + 2


def many_dynamics(arm: Any, q: Array, v: Array, M: Array, h: Array) -> None:
    """Write mass matrices and biases of many states."""
    n = len(arm[4])
    first, _, third = memory_of(len(arm[0][0]), n, len(arm[8]))
    for k in range(len(q)):
        dynamics_at(arm, q[k], v[k], first, M[k], h[k], third[2], third[3])


def many_accelerations(arm: Any, q: Array, v: Array, effort: Array, out: Array) -> None:
    """Write accelerations of many states; joints at rest stay there where friction holds them."""
    n = len(arm[4])
    first, second, third = memory_of(len(arm[0][0]), n, len(arm[8]))
    M, h, M2, h2, _, _, g, carried, _ = third
    dv, S, F = second[1], second[2], second[3]
    fixed, given = np.zeros(n, dtype=np.bool_), np.zeros(n)
    for k in range(len(q)):
        dynamics_at(arm, q[k], v[k], first, M, h, M2, h2)
        for i in range(n):
            g[i] = effort[k, i] - h[i]
            out[k, i] = 0.0
        for _ in range(LOAD_ROUNDS if len(arm[12]) else 1):
            if len(arm[12]):
                for i in range(n):
                    total = h2[i]
                    for j in range(n):
                        total += M2[i, j] * out[k, j]
                    carried[i] = abs(total)
            bounds_at(arm, carried, second[9])
            smooth_at(arm, carried, v[k], F, S)
            change_over(arm, M, arm[5], g, v[k], INSTANT, fixed, given, second)
            moved, size = 0.0, 0.0
            for i in range(n):
                found = dv[i] / INSTANT
                moved = max(moved, abs(found - out[k, i]))
                size = max(size, abs(found))
                out[k, i] = found
            if moved <= SETTLED * size:
                break
