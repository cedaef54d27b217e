"""One step of motion, second order in its length, written for a compiler.

Positions go half a step on, mass matrix and bias are taken there once (leapfrog), and the step's
velocities bring the positions to its end.
"""

from __future__ import annotations

from typing import Any

from sdpid._common.arrays import Array
from sdpid.experiment.simulation.kernels.layout import (
    BIAS,
    BIAS2,
    CARRIED,
    MASSES2,
    MIDDLE,
    PUSH,
    RATE,
)
from sdpid.experiment.simulation.kernels.links import dynamics_at
from sdpid.experiment.simulation.kernels.solve import advance

# No joint of a working robot moves this fast (rad/s or m/s): what does has diverged.
RUNAWAY = 1e3

# Rounds for friction that grows with the load, each shrinking the error by the share that it takes.
LOAD_ROUNDS = 100
SETTLED = 1e-10


def step_of(
    robot: Any,
    q: Array,
    v: Array,
    a: Array,
    known: bool,
    effort: Array,
    D: Array,
    dt: float,
    fixed: Any,
    given: Array,
    memory: Any,
    q1: Array,
    v1: Array,
) -> None:
    """Write positions and velocities after a step, and into `a` its mean accelerations.

    `a` holds those of the step before where they are `known`.
    """
    M2, h, h2 = memory.matrices[MASSES2], memory.vectors[BIAS], memory.vectors[BIAS2]
    qm, vm, g = memory.vectors[MIDDLE], memory.vectors[RATE], memory.vectors[PUSH]
    carried = memory.vectors[CARRIED]
    n = len(q)
    for i in range(n):
        qm[i] = q[i] + 0.5 * dt * v[i]
    for pass_ in range(1 if known else 2):
        for i in range(n):
            vm[i] = v[i] + (0.5 * dt * a[i] if known or pass_ else 0.0)
            if fixed[i]:
                vm[i] = v[i] + 0.5 * dt * given[i]
        dynamics_at(robot, qm, vm, memory)
        for i in range(n):
            g[i] = effort[i] - h[i]
            if not known and not pass_:
                a[i] = 0.0
        for _ in range(LOAD_ROUNDS if robot.loaded else 1):
            if robot.loaded:
                for i in range(n):
                    total = h2[i]
                    for j in range(n):
                        total += M2[i, j] * a[j]
                    carried[i] = abs(total)
            advance(robot, D, v, dt, fixed, given, memory, v1)
            moved, size = 0.0, 0.0
            for i in range(n):
                guess = (v1[i] - v[i]) / dt
                moved = max(moved, abs(guess - a[i]))
                size = max(size, abs(guess))
                a[i] = guess
            if moved <= SETTLED * size:
                break
    for i in range(n):
        q1[i] = qm[i] + 0.5 * dt * v1[i]


def has_diverged(v: Array) -> bool:
    """Return whether a velocity is no number, or beyond what any robot has."""
    slow = True
    for i in range(len(v)):
        slow = slow and abs(v[i]) < RUNAWAY
    return not slow
