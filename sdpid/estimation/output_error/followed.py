"""The closed loop along recordings: what a robot with given parameters would have done there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError, SolverError
from sdpid.estimation.commanded import commanded
from sdpid.experiment.preparation.twin import Twin
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.simulation.arm import SimulatedArm
from sdpid.experiment.simulation.closed_loop import Motion, simulate_closed_loop
from sdpid.experiment.simulation.law import Controller
from sdpid.experiment.simulation.reference import DesiredMotion
from sdpid.experiment.simulation.sensitivities import Loop, sensitivities
from sdpid.robot.model.base_parameters import BaseParameters
from sdpid.robot.model.dynamics import RobotDynamics

# The state that a simulation starts from is that of a parabola through the first tracking errors:
# through as many samples as noise alone explains, each time more by this factor, from the fewest to
# those of as many seconds. Fewer leave noise in the velocity, more lose what a loop does at first.
_FEWEST, _MORE, _BEGINNING = 6, 1.4, 0.2

# Noise alone explains residuals whose variance is above its own by this many standard deviations.
_EXPLAINED = 2.0

# Median of the square of a standard normal variable.
_MEDIAN_OF_SQUARES = 0.4549

# Longest step (s) of the linearized loop: that of the simulation itself, times two. It only gives
# the direction of a step, and loops of arms close below 30 Hz.
_LINEARIZED = 2e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class Path:
    """What the robot was told to do in one recording.

    Attributes
    ----------
    log : Recording
        Its stamps, and as `reference` the commanded positions at them.
    told : ndarray, shape (N, 3, n)
        Commanded positions, velocities and accelerations.
    start : tuple of 2 ndarrays, shape (n,)
        Measured position and velocity at the first stamp.
    fine : DesiredMotion
        The commanded motion at stamps that are close enough for the linearized loop.
    every, stride : int
        Of these, how many lie between stamps of the recording, and between instants of the loop.
    """

    log: Recording
    told: Array
    start: tuple[Array, Array]
    fine: DesiredMotion
    every: int
    stride: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Followed:
    """Simulated motions of recordings, processed as the measured ones.

    Attributes
    ----------
    positions, velocities, efforts : tuple of ndarray, shape (N, n)
        One a recording, at its stamps.
    motions : tuple of Motion
        The same at the stamps of the linearized loop, which may lie closer.
    """

    positions: tuple[Array, ...]
    velocities: tuple[Array, ...]
    efforts: tuple[Array, ...]
    motions: tuple[Motion, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class ClosedLoop:
    """The controlled robot along recordings, whatever its parameters.

    Attributes
    ----------
    twin : Twin
        The recordings and their processing.
    paths : tuple of Path
        What was commanded.
    controller : Controller
        What closes the loop.
    control_hz : float or None
        Rate at which it runs; None for a continuous one.
    """

    twin: Twin
    paths: tuple[Path, ...]
    controller: Controller
    control_hz: float | None

    @classmethod
    def of(
        cls, twin: Twin, controller: Controller, reference: Any, control_hz: float | None
    ) -> ClosedLoop:
        """Take commanded positions from the recordings, or as given.

        Raises
        ------
        DataError
            When there are none, or joints or lengths do not fit.
        """
        logs, n = twin.logs, twin.robot.n
        if controller.n != n:
            raise DataError(
                f"controller: has gains of {controller.n} joints, the robot '{twin.robot.name}' "
                f"has {n}; give one number a joint."
            )
        told = commanded(logs, reference)
        if told is None:
            raise DataError(
                "output error: the recording has no commanded positions (Recording.reference), "
                "along which the loop is simulated; read the log with its columns of commanded "
                "positions, or give reference=, a Trajectory or an array (N, n)."
            )
        paths = tuple(_path(log, each) for log, each in zip(logs, told, strict=True))
        return cls(twin=twin, paths=paths, controller=controller, control_hz=control_hz)

    def follow(self, model: RobotDynamics) -> Followed | None:
        """Simulate all recordings; None where a motion diverges."""
        arm = SimulatedArm.of(model)
        motions = []
        for path in self.paths:
            found = simulate_closed_loop(
                arm, path.fine, self.controller, control_hz=self.control_hz, start=path.start
            )
            if found.diverged is not None:
                return None
            motions.append(found)
        every = [path.every for path in self.paths]
        return Followed(
            positions=tuple(m.position[::k] for m, k in zip(motions, every, strict=True)),
            velocities=tuple(m.velocity[::k] for m, k in zip(motions, every, strict=True)),
            efforts=tuple(m.effort[::k] for m, k in zip(motions, every, strict=True)),
            motions=tuple(motions),
        )

    def require(self, model: RobotDynamics, what: str) -> Followed:
        """Simulate all recordings; raise where a motion diverges."""
        found = self.follow(model)
        if found is None:
            raise SolverError(
                f"output error: the simulated motion of {what} diverges under {self.controller!r}: "
                "check the gains' units (N.m/rad, N.m.s/rad) and signs, give the rate that the "
                "controller runs at (control_hz) if it is below 1 kHz, or start from consistent "
                "parameters nearer to the robot (start=...)."
            )
        return found

    def samples(self, followed: Followed) -> Samples:
        """Process simulated motions as the measured ones, with the measured efforts."""
        return self.twin.samples(list(followed.positions), velocity=list(followed.velocities))

    def missed(self, followed: Followed) -> Array:
        """Return measured less simulated positions, filtered alike, (K, n)."""
        return self.twin.measured.position - self.twin.positions(list(followed.positions))

    def told_samples(self) -> Samples:
        """Process the commanded motion as the measured one."""
        return self.twin.samples(
            [path.told[:, 0] for path in self.paths], velocity=[p.told[:, 1] for p in self.paths]
        )

    def efforts(self, followed: Followed) -> Array:
        """Return simulated efforts, filtered as the measured ones, (K, n)."""
        found = self.twin.samples(
            list(followed.positions),
            velocity=list(followed.velocities),
            effort=list(followed.efforts),
        )
        return found.effort

    def slopes(self, model: RobotDynamics, base: BaseParameters, followed: Followed) -> Array:
        """Return the derivative of the filtered positions by base parameters, (K, n, b).

        `followed` are the motions of the model.
        """
        found = []
        for path, moved in zip(self.paths, followed.motions, strict=True):
            told = path.fine.at(moved.time)
            error = told[:, 0] - moved.position
            means = 0.5 * np.diff(moved.time)[:, None] * (error[1:] + error[:-1])
            integral = np.concatenate([np.zeros((1, self.twin.robot.n)), np.cumsum(means, axis=0)])
            # Instants of the linearized loop: every so many, and what is left at the end.
            last = (len(error) - 1) // path.stride * path.stride
            few = np.append(np.arange(0, last, path.stride), np.arange(last, len(error)))
            states = (moved.position, moved.velocity, *told.swapaxes(0, 1), integral)
            given = [each[few] for each in states]
            stiffness, damping = self.controller.slopes(*given)
            gains = getattr(self.controller, "gains", None)
            ki = None if gains is None or not np.any(gains.integral) else gains.integral
            loop = Loop(
                time=moved.time[few],
                position=given[0],
                velocity=given[1],
                # The effort of these states: a held one is that of the last period.
                effort=self.controller.effort(*given),
                stiffness=stiffness,
                damping=damping,
                integral=ki,
            )
            rows = np.arange(0, len(moved.time), path.every)
            at = rows if path.stride == 1 else None
            values = _between(sensitivities(model, base, loop, at=at), path.stride, len(error))
            # Columns in a piece: filtering goes through each on its own.
            found.append(np.ascontiguousarray(np.moveaxis(values, 2, 0)))
        columns = [self.twin.positions([each[k] for each in found]) for k in range(base.count)]
        return np.ascontiguousarray(np.moveaxis(np.array(columns), 0, 2))


def _between(values: Array, stride: int, count: int) -> Array:
    """Return values at all of some instants, given every so many of them and the last ones.

    In between they lie on the cubic through the nearest four.
    """
    if stride == 1:
        return values
    even = (count - 1) // stride + 1
    out = np.empty((count, *values.shape[1:]))
    out[: even * stride : stride] = values[:even]
    out[(even - 1) * stride :] = values[even - 1 :]
    before, after = 2.0 * values[0] - values[1], 2.0 * values[even - 1] - values[even - 2]
    near = np.concatenate([before[None], values[:even], after[None]])
    for step in range(1, stride):
        x = step / stride
        weights = (
            -x * (x - 1.0) * (x - 2.0) / 6.0,
            (x + 1.0) * (x - 1.0) * (x - 2.0) / 2.0,
            -(x + 1.0) * x * (x - 2.0) / 2.0,
            (x + 1.0) * x * (x - 1.0) / 6.0,
        )
        total = weights[0] * near[:-3]
        for k in range(1, 4):
            total += weights[k] * near[k : even - 1 + k]
        out[step : (even - 1) * stride : stride] = total
    return out


def _path(log: Recording, position: Array) -> Path:
    """Return what was commanded in a recording, at its stamps."""
    time = np.asarray(log.time) - log.time[0]
    told = replace(log, reference=position)
    desired = DesiredMotion.of(told, log.n, None)
    motion = desired.at(time)
    every = max(1, int(np.ceil(log.step / _LINEARIZED - 1e-6)))
    rows = np.arange((len(time) - 1) * every + 1) / every
    return Path(
        log=told,
        told=motion,
        start=_start(log, time, motion),
        fine=replace(desired, time=np.interp(rows, np.arange(len(time)), time)),
        every=every,
        stride=max(1, int(_LINEARIZED / log.step + 1e-6)),
    )


def _start(log: Recording, time: Array, told: Array) -> tuple[Array, Array]:
    """Return the measured state at the first stamp: as told, less a parabola of the errors."""
    error = told[:, 0] - np.asarray(log.position)
    # Third differences of what is smooth are small; of white noise they have 20 times its variance.
    rough = np.diff(error, n=3, axis=0)
    noise = np.median(rough**2, axis=0) / (_MEDIAN_OF_SQUARES * 20.0)
    q, v = np.array(told[0, 0]), np.array(told[0, 1])
    for j in range(log.n):
        count = min(_FEWEST, len(time))
        found = _parabola(time[:count], error[:count, j])
        while (count := int(_MORE * count)) < len(time) and time[count - 1] <= _BEGINNING:
            longer = _parabola(time[:count], error[:count, j])
            if longer[2] > noise[j] * (1.0 + _EXPLAINED * np.sqrt(2.0 / (count - 3))):
                break
            found = longer
        q[j], v[j] = q[j] - found[0], v[j] - found[1]
    return q, v


def _parabola(time: Array, values: Array) -> tuple[float, float, float]:
    """Return value and slope at zero of the best parabola, and the variance that it leaves."""
    powers = time[:, None] ** np.arange(min(3, len(time)))
    fitted = np.linalg.lstsq(powers, values, rcond=None)[0]
    left = float(np.sum((values - powers @ fitted) ** 2))
    return float(fitted[0]), float(fitted[1]), left / max(len(time) - 3, 1)
