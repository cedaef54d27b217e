"""Positions of a robot that a known law drives, and how they change with the drives.

The equations of motion of all steps are one system of equations in the positions, banded because a
step knows the two before it. Newton's method solves it in a few rounds, from the measured positions
on, and its last factor gives the derivatives by every parameter: no loop over steps is interpreted
or compiled. Whether a joint sticks is an active set: the force that would hold it, as its row
of the equations says, is compared with the level of dry friction.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid.estimation.positions.drives import DriveNumbers
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.simulation.controllers import PD, inverse_dynamics_slopes
from sdpid.experiment.simulation.law import DriveCommands
from sdpid.robot.model.dynamics import RobotDynamics

# Newton's rounds end after a move of no position by more (rad or m): the next one is a hundredth of
# it and less. Without success they end after so many.
_SETTLED, _ROUNDS = 1e-5, 15

# The robot's slopes are taken along the measured motion below this frequency, Hz: they change with
# its position and velocity, not with its noise.
_SMOOTH_HZ = 20.0

# The step (s) of the targets' integrators: velocities are updated first, then positions by the new
# velocities.
STEP = 0.002

# Dry friction holds a joint as MuJoCo's does, up to its level, of its default `solreffriction` and
# `solimpfriction`: with the force ``stiffness·m·(a + rate·v)``. m is what the joint weighs: the
# inverse of its diagonal entry of the inverse mass matrix at the reference pose. The acceleration a
# is that before damping acts within the step.
_STIFFNESS, _RATE = 0.9 / (1.0 - 0.9), 2.0 / (0.95 * 0.02)


@dataclass(frozen=True, kw_only=True, eq=False)
class SolvedMotion:
    """A solved motion of K steps, and what derivatives need of it.

    Attributes
    ----------
    position : ndarray, shape (K + 1, n)
        Positions at the ends of the steps.
    converged : bool
        Whether Newton's method came to an end.
    """

    position: Array
    converged: bool
    velocity: Array
    acceleration: Array
    error: Array
    side: Array
    free: Mask
    z: Array
    before: tuple[tuple[Array, Array], ...]
    factors: tuple[BandFactor, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class CommandedLog:
    """A log of positions and commands, for rollouts over parts of it.

    Attributes
    ----------
    time : ndarray, shape (N,)
        Time stamps, s.
    position : ndarray, shape (N, n)
        Measured positions, rad (m).
    commands : DriveCommands
        Commands, added efforts and limits.
    """

    time: Array
    position: Array
    commands: DriveCommands

    @classmethod
    def of(cls, log: Recording, law: PD) -> CommandedLog:
        """Take the positions and commands of a recording.

        Raises
        ------
        DataError
            When it has no commands.
        """
        commands = DriveCommands.of(log, law)
        return cls(time=np.array(log.time), position=np.array(log.position), commands=commands)

    def rollout(self, links: RobotDynamics, part: slice = slice(None)) -> LawRollout:
        """Return a rollout over rows of the log."""
        command, added = self.commands.command[part], self.commands.feedforward[part]
        commands = replace(self.commands, command=command, feedforward=added)
        rows = replace(self, time=self.time[part], position=self.position[part], commands=commands)
        return LawRollout(links, rows)


class LawRollout:
    """A log, or a stretch of it, to be followed by a robot with known links.

    Parameters
    ----------
    links : RobotDynamics
        The robot and the inertia of its links; friction terms must be none.
    log : CommandedLog
        The log.
    """

    def __init__(self, links: RobotDynamics, log: CommandedLog) -> None:
        self.links, self.log, self.measured = links, log, log.position
        self._time = log.time - log.time[0]
        self.count = int(np.floor(self._time[-1] / STEP + 1e-9))
        self._grid = STEP * np.arange(self.count + 1)
        self._guess = np.stack(
            [np.interp(self._grid, self._time, column) for column in log.position.T], axis=1
        )
        self._commands, self._added = (
            _integral(self._time, values, held=log.commands.held)
            for values in (log.commands.command, log.commands.feedforward)
        )
        slopes = inverse_dynamics_slopes(links, *self._smooth())
        self.trees = _components(slopes[2])
        self._slopes = self._blocks(slopes)
        # The reference pose of an MJCF is that of zero positions.
        self._resting = links.mass_matrix(np.zeros(log.position.shape[1]))

    @np.errstate(over="ignore", invalid="ignore")
    def run(self, drives: DriveNumbers, start: Array, guess: Array | None = None) -> SolvedMotion:
        """Solve the motion from a start (2, n); `guess` are positions (K + 1, n) to begin at."""
        h, n = STEP, len(drives.middle)
        q = (self._guess if guess is None else guess).copy()
        command, feedforward = self.commands(drives.delay)
        armature, damping, kp, kd = (drives[k] for k in ("armature", "damping", "kp", "kd"))
        limit = self.log.commands.limit
        weight = 1.0 / np.diag(np.linalg.inv(self._resting + np.diag(armature)))
        stiff = _STIFFNESS * weight
        mobility = np.empty((self.count, n))
        trees, size, size_before = self._trees(self._slopes, drives, mobility), np.inf, np.inf
        for number in range(_ROUNDS):
            q[0] = start[0]
            v = np.diff(q, axis=0, prepend=(start[0] - h * start[1])[None]) / h
            a = np.diff(v, axis=0) / h
            here, speed = q[:-1], v[:-1]
            if size > size_before or number == _ROUNDS // 2:
                # Far from the measured motion its slopes lead astray: those of the motion itself.
                own = self._blocks(inverse_dynamics_slopes(self.links, here, speed, a))
                trees = self._trees(own, drives, mobility)
            error = command - here
            effort = kp * error - kd * speed + feedforward
            free = np.abs(effort) <= limit
            effort = np.clip(effort, -limit, limit)
            rest = self.links.inverse_dynamics(here, speed, a)
            rest += armature * a + damping * v[1:] + drives["offset"] - effort
            # The force that would hold a joint, were its row alone: it decides whether it sticks.
            sticking = _RATE * speed
            for joints, *_, undamped in trees:
                sticking[:, joints] += np.einsum("kij,kj->ki", undamped, a[:, joints])
            sticking *= stiff
            needed = (sticking - stiff * mobility * rest) / (1.0 + stiff * mobility)
            level = drives.dry(here)
            sticks = np.abs(needed) < level
            side = np.where(sticks, 0.0, np.sign(needed))
            wrong = -(rest + np.where(sticks, sticking, side * level))
            z = here - drives.middle
            hold = sticks * stiff
            leaning = side * (level > 0.0) * (drives["slope"] + 2.0 * z * drives["curve"])
            by_speed = (hold * _RATE + free * kd) / h
            by_place = leaning + free * kp + by_speed
            factors, earlier = [], []
            move = np.empty_like(rest)
            for joints, later, now, before, undamped in trees:
                held = hold[:, joints, None] / h**2 * undamped
                now, before = now - 2.0 * held, before + held
                diagonals(now)[...] += by_place[:, joints]
                diagonals(before)[...] -= by_speed[:, joints]
                factors.append(BandFactor.of(later + held, now, before))
                earlier.append((now[0], before[:2]))
                move[:, joints] = factors[-1].solve(wrong[:, joints])
            q[1:] += move
            size_before, size = size, float(np.abs(move).max())
            if size < _SETTLED or not np.isfinite(size):
                break
        return SolvedMotion(
            position=q,
            converged=size < _SETTLED,
            velocity=v,
            acceleration=a,
            error=error,
            side=side * (level > 0.0),
            free=free,
            z=z,
            before=tuple(earlier),
            factors=tuple(factors),
        )

    @np.errstate(over="ignore", invalid="ignore")
    def positions(self, motion: SolvedMotion) -> Array:
        """Return the motion's positions at the log's time stamps, (N, n)."""
        return self._at_stamps(motion.position)

    def columns(
        self,
        motion: SolvedMotion,
        drives: DriveNumbers,
        rows: Sequence[str],
        delay: bool,
        regressor: Array | None = None,
    ) -> Blocks:
        """Return the derivatives of `positions`, of each tree of joints on its own.

        Parameters
        ----------
        motion : SolvedMotion
            That of these drives.
        drives : DriveNumbers
            Where the derivatives are taken.
        rows : sequence of str
            Kinds of numbers, as `Unknowns.rows`.
        delay : bool
            Whether the delay is among the unknowns.
        regressor : ndarray, shape (K, n, 10·n), optional
            Of the links along the motion, where their parameters are among the unknowns.

        Returns
        -------
        list of tuple (joints, ndarray of shape (N, m, k))
            Of a tree with m joints: by its joints' numbers kind by kind, by the delay, then by
            their positions and velocities at the start, then by ten parameters of each link.
        """
        v, z, side = motion.velocity, motion.z, motion.side
        pushes = {
            "armature": motion.acceleration,
            "damping": v[1:],
            "friction": side,
            "slope": side * z,
            "curve": side * z * z,
            "offset": np.ones_like(z),
            "kp": -motion.error * motion.free,
            "kd": v[:-1] * motion.free,
        }
        lag = self._command_rate(drives.delay) * drives["kp"] * motion.free
        found = []
        for joints, factor, (now, before) in zip(
            self.trees, motion.factors, motion.before, strict=True
        ):
            m = len(joints)
            width = (len(rows) + 2) * m + delay
            push, first = np.zeros((len(z), m, width)), np.zeros((m, width))
            own = np.arange(m)
            for k, name in enumerate(rows):
                push[:, own, k * m + own] = pushes[name][:, joints]
            k = len(rows) * m
            if delay:
                push[:, :, k] = -lag[:, joints]
                k += 1
            push[0, :, k : k + m] = now + before[0]
            push[1, :, k : k + m] = before[1]
            push[0, :, k + m :] = -STEP * before[0]
            first[own, k + own] = 1.0
            if regressor is not None:
                places = (10 * joints[:, None] + np.arange(10)).ravel()
                push = np.concatenate([push, regressor[:, joints[:, None], places]], axis=2)
                first = np.concatenate([first, np.zeros((m, 10 * m))], axis=1)
            moved = np.concatenate([first[None], factor.solve(-push)])
            found.append((joints, self._at_stamps(moved)))
        return found

    def _trees(
        self, slopes: Sequence[tuple[Array, ...]], drives: DriveNumbers, mobility: Array
    ) -> list[tuple[Indices, Array, Array, Array, Array]]:
        """Return each tree's part of the equations, and write joints' mobility (K, n).

        Of each tree its joints, the blocks of steps k, k − 1 and k − 2 that no state of friction
        changes, and what acts within a step beside friction.
        """
        h, trees = STEP, []
        for joints, (by_position, by_velocity, masses) in zip(self.trees, slopes, strict=True):
            E, damping = np.eye(len(joints)), drives["damping"][joints]
            masses = masses + E * drives["armature"][joints]
            mobility[:, joints] = diagonals(np.linalg.inv(masses + h * damping * E))
            undamped = E + h * np.linalg.inv(masses) * damping
            later = masses / h**2 + E * damping / h
            before = masses / h**2 - by_velocity / h
            trees.append((joints, later, by_position - later - before, before, undamped))
        return trees

    def _blocks(self, slopes: tuple[Array, ...]) -> list[tuple[Array, ...]]:
        """Return slopes by position and by velocity, and masses, of each tree of joints."""
        # Block by block, for most of the whole is zero.
        return [
            tuple(np.array(each[:, joints[:, None], joints]) for each in slopes)
            for joints in self.trees
        ]

    def after(self, seconds: float) -> int:
        """Return the first row of the log that is so long after its start."""
        return int(np.searchsorted(self._time, seconds))

    def start(self) -> Array:
        """Return a position and a velocity (2, n) to start from, of the first samples."""
        few = min(len(self._time), 8)
        slope, value = np.polyfit(self._time[:few], self.measured[:few], 1)
        return np.stack([value, slope])

    def commands(self, delay: float) -> tuple[Array, Array]:
        """Return means of commands and of added efforts over each step."""
        edges = self._edges(delay)
        command, added = (np.diff(at(edges), axis=0) for at in (self._commands, self._added))
        return command / STEP, added / STEP

    def _command_rate(self, delay: float) -> Array:
        """Return how means of commands change, over as long as the steps: held ones jump."""
        edges, h = self._edges(delay), 0.25 * STEP
        parts = [np.diff(self._commands(edges + x), axis=0) / STEP for x in (-h, h)]
        return (parts[0] - parts[1]) / (2.0 * h)

    def _edges(self, delay: float) -> Array:
        # Simulators hold the command at the start of a step: the mean about that instant, since a
        # fit needs something smooth in the delay.
        return np.asarray(self._grid - delay - 0.5 * STEP)

    def _smooth(self) -> tuple[Array, Array, Array]:
        """Return smooth positions, velocities and accelerations, (K, n) each."""
        from scipy.ndimage import gaussian_filter1d

        width = 1.0 / (2.0 * np.pi * _SMOOTH_HZ * STEP)
        q, v, a = (
            gaussian_filter1d(self._guess, width, axis=0, order=k, mode="nearest") / STEP**k
            for k in range(3)
        )
        return q[:-1], v[:-1], a[:-1]

    def _at_stamps(self, values: Array) -> Array:
        """Interpolate values (K + 1, ...) on the grid at the log's time stamps."""
        place = np.clip(self._time / STEP, 0.0, self.count)
        row = np.minimum(place.astype(np.intp), self.count - 1)
        share = (place - row).reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray(values[row] * (1.0 - share) + values[row + 1] * share)


def diagonals(blocks: Any) -> Array:
    """Return the diagonals (K, m) of blocks (K, m, m), as a view."""
    return np.asarray(np.einsum("kii->ki", blocks))


# Derivatives of the positions of each tree of joints.
Blocks = list[tuple[Indices, Array]]


@dataclass(frozen=True, eq=False)
class BandFactor:
    """LU factor of the equations of one tree of m joints, in LAPACK's band storage."""

    lu: Array
    pivots: Array
    below: int
    above: int

    @classmethod
    def of(cls, later: Array, now: Array, before: Array) -> BandFactor:
        """Factor the blocks (K, m, m) on and below the diagonal: those of steps k, k − 1, k − 2."""
        from scipy.linalg.lapack import dgbtrf

        K, m, _ = now.shape
        below, above = 3 * m - 1, m - 1
        band = np.zeros((2 * below + above + 1, K * m))
        for shift, blocks in enumerate((later, now, before)):
            for i in range(m):
                for j in range(m):
                    row = below + above + i - j + shift * m
                    band[row, j : (K - shift) * m : m] = blocks[shift:, i, j]
        lu, pivots, _ = dgbtrf(band, below, above, overwrite_ab=1)
        return cls(lu, pivots, below, above)

    def solve(self, values: Array) -> Array:
        """Solve for right sides (K, m, ...)."""
        from scipy.linalg.lapack import dgbtrs

        flat = values.reshape(values.shape[0] * values.shape[1], -1)
        found, _ = dgbtrs(self.lu, self.below, self.above, flat, self.pivots)
        return np.asarray(found.reshape(values.shape))


def _components(masses: Array) -> tuple[Indices, ...]:
    """Return the joints of each tree on the base: those that share masses (K, n, n)."""
    from scipy.sparse.csgraph import connected_components

    count, label = connected_components(np.abs(masses).max(axis=0) > 0.0, directed=False)
    return tuple(np.flatnonzero(label == k) for k in range(count))


def _integral(time: Array, values: Array, *, held: bool) -> Callable[[Array], Array]:
    """Return the integral of a held or piecewise linear signal (N, n) as a function of time."""
    mean = values[:-1] if held else 0.5 * (values[:-1] + values[1:])
    total = np.concatenate(
        [np.zeros((1, values.shape[1])), np.cumsum(mean * np.diff(time)[:, None], 0)]
    )

    def at(when: Array) -> Array:
        row = np.clip(np.searchsorted(time, when, side="right") - 1, 0, len(time) - 2)
        inside = np.clip(when, time[0], time[-1])
        x = (inside - time[row])[:, None]
        rise = 0.0 if held else (values[row + 1] - values[row]) / np.diff(time)[row, None]
        outside = np.where(when < time[0], values[:1].T, values[-1:].T).T * (when - inside)[:, None]
        return np.asarray(total[row] + x * (values[row] + 0.5 * x * rise) + outside)

    return at
