"""Positions of a robot that a known law drives, and how they change with the drives.

The equations of motion of all steps are one system of equations in the positions, banded because a
step knows the two before it. Newton's method solves it in a few rounds, from the measured positions
on, and its last factor gives the derivatives by every parameter: no loop over steps is interpreted
or compiled. Whether a joint sticks is an active set: the force that would hold it, as its row
of the equations says, is compared with the level of dry friction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid.estimation.positions.drives import DriveNumbers
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.simulation.controllers import PD, inverse_dynamics_slopes
from sdpid.experiment.simulation.law import DriveCommands
from sdpid.robot.model.dynamics import RobotDynamics

# Newton's rounds end after a move of no position by more (rad or m): the next one is a hundredth of
# it and less. Without success they end after so many, or at a move beyond `_LOST`.
_SETTLED, _ROUNDS, _LOST = 1e-5, 15, 1e12

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
    factors : tuple of Factor
        Those of the equations of each tree of joints.
    """

    position: Array
    converged: bool
    velocity: Array
    acceleration: Array
    error: Array
    side: Array
    free: Mask
    z: Array
    factors: tuple[Factor, ...]


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
        self._grid = STEP * np.arange(self.count + 1.0)
        self._stamps = np.minimum(self._time, self._grid[-1])
        self._guess = _line(self._time, log.position, self._grid)
        self._commands = log.commands.curve(self._time).antiderivative()
        slopes = inverse_dynamics_slopes(links, *self._smooth())
        self.trees = _components(slopes[2])
        self._slopes = self._blocks(slopes)
        # The reference pose of an MJCF is that of zero positions.
        self._resting = links.mass_matrix(np.zeros(log.position.shape[1]))

    @np.errstate(over="ignore", invalid="ignore")
    def run(self, drives: DriveNumbers, start: Array, guess: Array | None = None) -> SolvedMotion:
        """Solve the motion from a start (2, n); `guess` are positions (K + 1, n) to begin at."""
        h = STEP
        # The two positions before the first step are unknowns, too, whose equations hold.
        place = start[0] - h * start[1]
        q = np.vstack([place, start[0], (self._guess if guess is None else guess)[1:]])
        command, feedforward = self.commands(drives.delay)
        armature, damping, kp, kd = (drives[k] for k in ("armature", "damping", "kp", "kd"))
        limit = self.log.commands.limit
        stiff = _STIFFNESS / np.diag(np.linalg.inv(self._resting + np.diag(armature)))
        size = size_before = np.inf
        trees, mobility = self._trees(self._slopes, drives)
        for number in range(_ROUNDS):
            v = np.diff(q, axis=0) / h
            a = np.diff(v, axis=0) / h
            here, speed = q[1:-1], v[:-1]
            if size > size_before or number == _ROUNDS // 2:
                # Far from the measured motion its slopes lead astray: those of the motion itself.
                slopes = inverse_dynamics_slopes(self.links, here, speed, a)
                trees, mobility = self._trees(self._blocks(slopes), drives)
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
            factors, move = [], np.zeros_like(q)
            for joints, blocks, undamped in trees:
                held, own = hold[:, joints, None] / h**2 * undamped, blocks.copy()
                own[:, 2:] += held * np.array([1.0, -2.0, 1.0])[:, None, None, None]
                now, before = np.einsum("bkii->bki", own[1:, 2:])
                now += by_place[:, joints]
                before -= by_speed[:, joints]
                factors.append(factored(own))
                move[:, joints] = solve_steps(
                    factors[-1], np.pad(wrong[:, joints], ((2, 0), (0, 0)))
                )
            q += move
            size_before, size = size, float(np.abs(move).max())
            if size < _SETTLED or not size < _LOST:
                break
        return SolvedMotion(
            position=q[1:],
            converged=size < _SETTLED,
            velocity=v,
            acceleration=a,
            error=error,
            side=side * (level > 0.0),
            free=free,
            z=z,
            factors=tuple(factors),
        )

    @np.errstate(over="ignore", invalid="ignore")
    def positions(self, motion: SolvedMotion) -> Array:
        """Return the motion's positions at the log's time stamps, (N, n)."""
        return _line(self._grid, motion.position, self._stamps)

    def columns(
        self,
        motion: SolvedMotion,
        drives: DriveNumbers,
        rows: Sequence[str],
        delay: bool,
        regressor: Array | None = None,
    ) -> list[tuple[Indices, Array]]:
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
        found, count = [], len(rows)
        for joints, factor in zip(self.trees, motion.factors, strict=True):
            m, more = len(joints), 0 if regressor is None else 10 * len(joints)
            own, k = np.arange(m), count * m + delay
            push = np.zeros((len(z) + 2, m, k + 2 * m + more))
            # First the equations of the two positions before the first step.
            push[:2, own, k + own] = -1.0
            push[0, own, k + m + own] = STEP
            for i, name in enumerate(rows):
                push[2:, own, i * m + own] = pushes[name][:, joints]
            if delay:
                push[2:, :, k - 1] = -lag[:, joints]
            if regressor is not None:
                places = (10 * joints[:, None] + np.arange(10)).ravel()
                push[2:, :, k + 2 * m :] = regressor[:, joints[:, None], places]
            found.append((joints, _line(self._grid, solve_steps(factor, -push)[1:], self._stamps)))
        return found

    def _trees(
        self, slopes: Sequence[tuple[Array, ...]], drives: DriveNumbers
    ) -> tuple[list[tuple[Indices, Array, Array]], Array]:
        """Return each tree's part of the equations, and joints' mobility (K, n).

        Of each tree its joints, the blocks (3, K + 2, m, m) that multiply positions after a step,
        before it and one earlier without friction, and what acts within a step beside friction.
        """
        h, trees, mobility = STEP, [], np.empty((self.count, len(drives.middle)))
        for joints, (by_position, by_velocity, masses) in zip(self.trees, slopes, strict=True):
            E, damping = np.eye(len(joints)), drives["damping"][joints]
            masses = masses + E * drives["armature"][joints]
            mobility[:, joints] = np.einsum("kii->ki", np.linalg.inv(masses + h * damping * E))
            undamped = E + h * np.linalg.inv(masses) * damping
            blocks = np.zeros((3, self.count + 2, *E.shape))
            blocks[0], blocks[2, 2:] = E, masses / h**2 - by_velocity / h
            blocks[0, 2:] = masses / h**2 + E * damping / h
            blocks[1, 2:] = by_position - blocks[0, 2:] - blocks[2, 2:]
            trees.append((joints, blocks, undamped))
        return trees, mobility

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
        # Simulators hold the command at the start of a step: the mean about that instant, since a
        # fit needs something smooth in the delay.
        ends = self._commands(self._grid - delay - 0.5 * STEP)
        command, added = np.split(np.diff(ends, axis=0) / STEP, 2, axis=1)
        return command, added

    def _command_rate(self, delay: float) -> Array:
        """Return how means of commands change with the delay, over half a step: held ones jump."""
        h = 0.25 * STEP
        return (self.commands(delay + h)[0] - self.commands(delay - h)[0]) / (2.0 * h)

    def _smooth(self) -> tuple[Array, Array, Array]:
        """Return smooth positions, velocities and accelerations, (K, n) each."""
        from scipy.ndimage import gaussian_filter1d

        width = 1.0 / (2.0 * np.pi * _SMOOTH_HZ * STEP)
        q, v, a = (
            gaussian_filter1d(self._guess, width, axis=0, order=k, mode="nearest") / STEP**k
            for k in range(3)
        )
        return q[:-1], v[:-1], a[:-1]


def _line(time: Array, values: Array, when: Array) -> Array:
    """Interpolate values (N, …) linearly at other times."""
    from scipy.interpolate import make_interp_spline

    return np.asarray(make_interp_spline(time, values, k=1, check_finite=False)(when))


# An LU factor in LAPACK's storage, and its pivots.
Factor = tuple[Array, Indices]


def factored(blocks: Array) -> Factor:
    """Factor the equations of blocks (3, K, m, m) on and below the diagonal, nearest first."""
    from scipy.linalg.lapack import dgbtrf

    # In LAPACK's band storage: 3·m − 1 diagonals below, m − 1 above, and room to exchange rows.
    K, m = blocks.shape[1:3]
    band = np.zeros((7 * m - 2, K * m))
    for shift, own in enumerate(blocks):
        for i in range(m):
            for j in range(m):
                row = 4 * m - 2 + i - j + shift * m
                band[row, j : (K - shift) * m : m] = own[shift:, i, j]
    lu, pivots, _ = dgbtrf(band, 3 * m - 1, m - 1, overwrite_ab=1)
    return lu, pivots


def solve_steps(factor: Factor, values: Array) -> Array:
    """Solve the equations of m joints for right sides (K, m, …)."""
    from scipy.linalg.lapack import dgbtrs

    m = values.shape[1]
    flat = values.reshape(len(values) * m, -1)
    found = dgbtrs(factor[0], 3 * m - 1, m - 1, flat, factor[1])[0]
    return np.asarray(found.reshape(values.shape))


def _components(masses: Array) -> tuple[Indices, ...]:
    """Return the joints of each tree on the base: those that share masses (K, n, n)."""
    from scipy.sparse.csgraph import connected_components

    count, label = connected_components(np.abs(masses).max(axis=0) > 0.0, directed=False)
    return tuple(np.flatnonzero(label == k) for k in range(count))
