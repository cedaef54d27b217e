"""Runs of many steps, in closed and in open loop, and many states at once, for a compiler."""

from __future__ import annotations

from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.simulation.kernels import links as slot
from sdpid.experiment.simulation.kernels.links import add_along, bounds_at, dynamics_at, smooth_at
from sdpid.experiment.simulation.kernels.solve import (
    LOAD_ROUNDS,
    carry_load,
    change_over,
    has_diverged,
    is_settled,
    speed_at,
    step_of,
)

# A time (s) in which no velocity changes: accelerations are changes over it.
INSTANT = 1e-15

# Samples this near to a step's end, as a share of the step, belong to the next one.
NEAR = 1e-6


def law_at(law: Any, memory: Any, desired: Array, integral: Array) -> None:
    """Write a controller's effort but for its feedback of velocity, the gains of that, and errors.

    At the limit of the effort the error is zero: its integral rests.
    """
    has_model, gains, model = law
    vectors, M, S = memory.vectors, memory.matrices[slot.MASSES], memory.matrices[slot.SLOPES]
    q, v, u = vectors[slot.SIGHT], vectors[slot.SIGHT_SPEED], vectors[slot.TRIAL]
    F, carried = vectors[slot.SMOOTH], vectors[slot.CARRIED]
    effort, error, slope = vectors[slot.EFFORT], vectors[slot.ERROR], memory.matrices[slot.FEEDBACK]
    n = len(q)
    for i in range(n):
        carried[i] = 0.0
        error[i] = desired[0, i] - q[i]
        u[i] = gains[0, i] * error[i] + gains[1, i] * gains[3, i] * desired[1, i]
        u[i] += gains[2, i] * integral[i]
        for j in range(n):
            slope[i, j] = gains[1, i] if i == j else 0.0
        effort[i] = u[i]
    if has_model:
        dynamics_at(model, q, v, memory)
        smooth_at(model, carried, desired[1], F, S)
        for i in range(n):
            effort[i] = vectors[slot.BIAS, i] + F[i]
            for j in range(n):
                effort[i] += M[i, j] * (desired[2, j] + u[j])
                effort[i] += model.matrices[slot.VISCOUS, i, j] * desired[1, j]
                slope[i, j] = M[i, j] * gains[1, j]
        for k in range(len(model.contacts)):
            sign = np.sign(speed_at(model, k, desired[1]) - model.jumps[k, 0])
            force = 0.5 * (1.0 + sign) * model.jumps[k, 2] + 0.5 * (1.0 - sign) * model.jumps[k, 1]
            if model.bent and model.jumps[k, 3] > 0.0:
                force += sign * carried[model.contacts[k, 0]]
            add_along(model.contacts, 0, model.jumps, slot.OF_JUMP, k, force, effort)
    for i in range(n):
        total, limit = effort[i], gains[4, i]
        for j in range(n):
            total -= slope[i, j] * v[j]
        if abs(total) > limit:
            effort[i], error[i] = (limit if total > 0.0 else -limit), 0.0
            for j in range(n):
                slope[i, j] = 0.0


def closed_loop(
    robot: Any,
    law: Any,
    memory: Any,
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

    With `every` steps of effort held, `desired` has one row for each time of control; without, the
    mean of both ends of each step. Return how many samples were written before the motion diverged.
    """
    vectors, V = memory.vectors, robot.matrices[slot.VISCOUS]
    q, v, a = vectors[slot.NOW], vectors[slot.SPEED], vectors[slot.ACCELERATION]
    q1, v1, effort = vectors[slot.NEXT], vectors[slot.NEXT_SPEED], vectors[slot.EFFORT]
    qm, vm, seen = vectors[slot.SIGHT], vectors[slot.SIGHT_SPEED], vectors[slot.SEEN]
    integral, error, before = vectors[slot.INTEGRAL], vectors[slot.ERROR], vectors[slot.BEFORE]
    D, slope = memory.matrices[slot.DAMPING], memory.matrices[slot.FEEDBACK]
    n, sample = len(q), 0
    for i in range(n):
        q[i], v[i] = start[0, i], start[1, i]
    for step in range(steps):
        if every == 0:
            for i in range(n):
                # The mean of both ends, as that of the desired positions.
                qm[i] = q[i] + 0.5 * dt * (v[i] + 0.5 * dt * a[i])
                vm[i] = v[i] + 0.5 * dt * a[i]
                before[i] = integral[i] + 0.5 * dt * (desired[step, 0, i] - qm[i])
            law_at(law, memory, desired[step], before)
            for i in range(n):
                for j in range(n):
                    D[i, j] = V[i, j] + slope[i, j]
        elif step % every == 0:
            row = step // every
            for i in range(n):
                seen[i] = noise[row % len(noise), i]
                qm[i], vm[i] = q[i] + seen[i], v[i]
                if differenced and row > 0:
                    vm[i] = (qm[i] - before[i]) / (dt * every)
                before[i] = qm[i]
            law_at(law, memory, desired[row], integral)
            for i in range(n):
                for j in range(n):
                    effort[i] -= slope[i, j] * vm[j]
        step_of(robot, step > 0, dt, memory)
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
                out[4, sample, i] = integral[i] + x * dt * error[i]
            sample += 1
        for i in range(n):
            q[i], v[i] = q1[i], v1[i]
            integral[i] += dt * error[i]
    return sample


def open_loop(
    robot: Any, memory: Any, states: Array, effort: Array, dt: float, fixed: Any, out: Array
) -> None:
    """Write positions and velocities (2, S, T + 1, n) of S segments under efforts (S, T, n).

    Segments start in the first of the states (2, S, 1 or T + 1, n), and joints that are `fixed`,
    (S, n), follow them.
    """
    vectors, held, given = memory.vectors, memory.fixed, memory.vectors[slot.GIVEN]
    q, v = vectors[slot.NOW], vectors[slot.SPEED]
    q1, v1 = vectors[slot.NEXT], vectors[slot.NEXT_SPEED]
    n = len(q)
    for s in range(len(effort)):
        for i in range(n):
            held[i], q1[i], v1[i] = fixed[s, i], states[0, s, 0, i], states[1, s, 0, i]
        for k in range(effort.shape[1] + 1):
            if has_diverged(v1):
                break
            for i in range(n):
                q[i], v[i] = q1[i], v1[i]
                out[0, s, k, i], out[1, s, k, i] = q1[i], v1[i]
            if k == effort.shape[1]:
                break
            for i in range(n):
                vectors[slot.EFFORT, i] = effort[s, k, i]
                if held[i]:
                    v[i] = states[1, s, k, i]
                    given[i] = (states[1, s, k + 1, i] - v[i]) / dt
                    q[i] = 0.5 * (states[0, s, k, i] + states[0, s, k + 1, i] - dt * v[i])
            step_of(robot, k > 0, dt, memory)
            for i in range(n):
                if held[i]:
                    q1[i], v1[i] = states[0, s, k + 1, i], states[1, s, k + 1, i]


def dynamics(
    robot: Any, memory: Any, q: Array, v: Array, effort: Array, M: Array, h: Array, a: Array
) -> None:
    """Write mass matrices, biases and accelerations of many states.

    Joints at rest stay there where friction holds them.
    """
    vectors, S = memory.vectors, memory.matrices[slot.SLOPES]
    carried, F, n = vectors[slot.CARRIED], vectors[slot.SMOOTH], q.shape[1]
    for k in range(len(q)):
        dynamics_at(robot, q[k], v[k], memory)
        for i in range(n):
            h[k, i], a[k, i] = vectors[slot.BIAS, i], 0.0
            vectors[slot.PUSH, i] = effort[k, i] - h[k, i]
            for j in range(n):
                M[k, i, j] = memory.matrices[slot.MASSES, i, j]
        for _ in range(LOAD_ROUNDS if robot.loaded else 1):
            carry_load(robot, memory, a[k])
            bounds_at(robot, carried, memory.bounds)
            smooth_at(robot, carried, v[k], F, S)
            change_over(robot, v[k], INSTANT, memory)
            if is_settled(vectors[slot.CHANGE], INSTANT, a[k]):
                break
