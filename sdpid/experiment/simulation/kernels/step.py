"""One step of motion, second order in its length, written for a compiler.

Positions go half a step on, mass matrix and bias are taken there once (leapfrog), and the step's
velocities bring the positions to its end.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.simulation.kernels.links import dynamics_at
from sdpid.experiment.simulation.kernels.solve import advance

# No joint of a working robot moves this fast (rad/s or m/s): what does has diverged.
RUNAWAY = 1e3

# Rounds for friction that grows with the load, each shrinking the error by the share that it takes.
LOAD_ROUNDS = 100
SETTLED = 1e-10


def step_of(
    arm: Any,
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
    first, second, third = memory
    M, h, M2, h2, qm, vm, g, carried, guess = third
    n = len(q)
    for i in range(n):
        qm[i] = q[i] + 0.5 * dt * v[i]
    for pass_ in range(1 if known else 2):
        for i in range(n):
            vm[i] = v[i] + (0.5 * dt * a[i] if known or pass_ else 0.0)
            if fixed[i]:
                vm[i] = v[i] + 0.5 * dt * given[i]
        dynamics_at(arm, qm, vm, first, M, h, M2, h2)
        for i in range(n):
            g[i] = effort[i] - h[i]
            if not known and not pass_:
                a[i] = 0.0
        for _ in range(LOAD_ROUNDS if len(arm[12]) else 1):
            if len(arm[12]):
                for i in range(n):
                    total = h2[i]
                    for j in range(n):
                        total += M2[i, j] * a[j]
                    carried[i] = abs(total)
            advance(arm, M, D, g, carried, v, dt, fixed, given, second, v1)
            moved, size = 0.0, 0.0
            for i in range(n):
                guess[i] = (v1[i] - v[i]) / dt
                moved = max(moved, abs(guess[i] - a[i]))
                size = max(size, abs(guess[i]))
                a[i] = guess[i]
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


def space_of(links: int, n: int, contacts: int) -> Any:
    """Return memory for the functions below."""
    return (
        np.zeros((links, 3, 3)),
        np.zeros((links, 3)),
        np.zeros((links, 3)),
        np.zeros((links, 3)),
        np.zeros((links, 3)),
        np.zeros((links, 3)),
        np.zeros((links, 3)),
        np.zeros((links, 10)),
    ), (
        np.zeros((n + contacts, n + contacts + 1)),
        np.zeros(n),
        np.zeros((n, n)),
        np.zeros(n),
        np.zeros((n, n)),
        np.zeros(n),
        np.zeros(n),
        np.zeros(contacts, dtype=np.int64),
        np.zeros(contacts, dtype=np.int64),
        np.zeros((contacts, 2)),
    )


def memory_of(links: int, n: int, contacts: int) -> Any:
    """Return memory for a step."""
    first, second = space_of(links, n, contacts)
    third = (
        np.zeros((n, n)),
        np.zeros(n),
        np.zeros((n, n)),
        np.zeros(2 * n),
        np.zeros(n),
        np.zeros(n),
        np.zeros(n),
        np.zeros(n),
        np.zeros(n),
    )
    return first, second, third
