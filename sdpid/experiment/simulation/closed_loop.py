"""Move a robot with known parameters in closed loop along a desired motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen, generator, real_array, shaped
from sdpid._common.tables import Shown, Table
from sdpid.errors import DataError
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.simulation.arm import SimulatedArm
from sdpid.experiment.simulation.controllers import Controller, JointLaw
from sdpid.experiment.simulation.kernels.linked import entries
from sdpid.experiment.simulation.kernels.links import memory_for
from sdpid.experiment.simulation.kernels.loops import NEAR
from sdpid.experiment.trajectory.curve import SampledCurve
from sdpid.experiment.trajectory.trajectory import Trajectory
from sdpid.robot.model.dynamics import RobotDynamics

# Longest step of the integrator (s) unless another is asked for: loops of industrial arms close
# below 30 Hz, where steps of this length err by 1e-4 of the tracking error.
LONGEST_STEP = 1e-3


# What `simulate_closed_loop` takes.
Reference = Any


@dataclass(frozen=True, kw_only=True, eq=False)
class DesiredMotion:
    """A desired motion and the times at which it was sampled.

    Attributes
    ----------
    time : ndarray, shape (K,)
        Times of the samples from zero on, s.
    curve : SampledCurve
        The motion between them.
    """

    time: Array
    curve: SampledCurve

    @classmethod
    def of(cls, reference: Reference, n: int, rate_hz: float | None) -> DesiredMotion:
        """Take a trajectory, a recording with a reference, positions, or all three derivatives.

        A desired motion stays what it is.

        Raises
        ------
        DataError
            When shapes or joints do not fit, or the rate is missing.
        """
        if isinstance(reference, DesiredMotion):
            found = reference
        elif isinstance(reference, Trajectory):
            rate = _positive(rate_hz or reference.rate_hz, "rate_hz", "rate in Hz")
            own = np.arange(reference.n_samples) / reference.rate_hz
            times = np.arange(int(np.floor(own[-1] * rate * (1.0 + 1e-12))) + 1) / rate
            found = cls(time=times, curve=_curve(own, *reference.sample()))
        elif isinstance(reference, Recording):
            if reference.reference is None:
                raise DataError(
                    "reference: the recording has no commanded positions; give the trajectory, or "
                    "read the log with its columns of commanded positions."
                )
            own = np.asarray(reference.time) - reference.time[0]
            found = cls(time=own, curve=_curve(own, reference.reference))
        else:
            states = reference if isinstance(reference, tuple) else (reference,)
            if rate_hz is None:
                raise DataError(
                    "rate_hz: missing; an array of positions needs the rate of its rows."
                )
            if len(states) not in (1, 3):
                raise DataError(
                    f"reference: {len(states)} arrays; give positions, or positions, velocities "
                    "and accelerations."
                )
            states = tuple(real_array(x, "reference", ndim=2) for x in states)
            own = np.arange(len(states[0])) / _positive(rate_hz, "rate_hz", "rate in Hz")
            found = cls(time=own, curve=_curve(own, *states))
        if found.curve.n != n:
            raise DataError(
                f"reference: {found.curve.n} joints, the robot has {n}; give one column a joint."
            )
        return found

    def at(self, time: Array) -> Array:
        """Return positions, velocities and accelerations (T, 3, n); held at the end."""
        from scipy.interpolate import BPoly

        inside = np.clip(time, 0.0, self.curve.duration)
        pieces = BPoly(self.curve.control_points, self.curve.breaks)
        found = np.stack([pieces(inside, order) for order in range(3)], axis=1)
        found[time > self.curve.duration, 1:] = 0.0
        return found


def _curve(time: Array, *states: Any) -> SampledCurve:
    """Return the curve through positions, or those with velocities and accelerations."""
    return SampledCurve(
        time=time, **dict(zip(("position", "velocity", "acceleration"), states, strict=False))
    )


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Motion(Shown):
    """A simulated motion at K sample times.

    Attributes
    ----------
    time : ndarray, shape (K,)
        Times from the start, s.
    position, velocity, acceleration : ndarray, shape (K, n)
        True states, in rad (m) and derivatives.
    effort : ndarray, shape (K, n)
        What the controller commands at these times, N·m (N).
    measured : ndarray, shape (K, n)
        Positions as the controller sees them: with the position noise that it feeds back.
    arm : SimulatedArm
        The robot that moved.
    diverged : float or None
        Time (s) at which the motion diverged and the samples end: a speed that is not finite or
        beyond 1000 rad/s (m/s). None where it did not.

    Examples
    --------
    >>> law = sdpid.controllers.PD(np.full(6, 4000.0), np.full(6, 200.0))
    >>> moved = sdpid.simulate_closed_loop(estimate.model(), motion, law, rate_hz=100.0)
    >>> moved
    Motion(samples=3800, joints=6, duration=37.99, diverged=None)
    >>> moved.diverged is None
    True
    """

    time: Array
    position: Array
    velocity: Array
    effort: Array
    measured: Array
    arm: SimulatedArm
    diverged: float | None = None

    def __post_init__(self) -> None:
        for name in ("time", "position", "velocity", "effort", "measured"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @cached_property
    def acceleration(self) -> Array:
        """Accelerations under these efforts, shape (K, n), in rad/s² (m/s²)."""
        return frozen(self.arm.dynamics(self.position, self.velocity, self.effort)[2])

    def _shown(self) -> dict[str, object]:
        return {
            "samples": len(self.time),
            "joints": self.position.shape[1],
            "duration, s": float(np.ptp(self.time)) if len(self.time) else 0.0,
            "diverged, s": self.diverged,
        }

    def _tables(self) -> Iterator[Table]:
        """Yield the range of every joint's motion."""
        n = self.position.shape[1]
        rows = self.position if len(self.time) else np.zeros((1, n))
        yield Table.of_columns(
            {
                "joint": list(range(1, n + 1)),
                "least position": rows.min(axis=0).tolist(),
                "greatest position": rows.max(axis=0).tolist(),
                "top speed": np.abs(self.velocity).max(axis=0, initial=0.0).tolist(),
                "top effort": np.abs(self.effort).max(axis=0, initial=0.0).tolist(),
            }
        )


def simulate_closed_loop(
    model: RobotDynamics | SimulatedArm,
    reference: Reference,
    controller: Controller,
    *,
    rate_hz: float | None = None,
    control_hz: float | None = None,
    step: float | None = None,
    position_noise: ArrayLike | None = None,
    differenced: bool | None = None,
    seed: int | np.random.Generator = 0,
    start: tuple[ArrayLike, ArrayLike] | None = None,
) -> Motion:
    """Simulate a robot with known parameters that a controller moves along a reference.

    Steps are of second order and linearly implicit in friction and in the feedback of velocity.
    Where friction jumps, joints stick and slip as they should: nothing is smoothed.

    Parameters
    ----------
    model : RobotDynamics or SimulatedArm
        The robot, such as ``estimate.model()``.
    reference : Trajectory, Recording, ndarray, or tuple of 3 ndarrays
        The desired motion: a trajectory, a recording with commanded positions, positions (K, n)
        that a cubic spline joins, or positions, velocities and accelerations.
    controller : Controller
        Such as `sdpid.controllers.PD`.
    rate_hz : float, optional
        Samples a second of the result. Arrays are sampled at this rate, and need it; a trajectory
        has its own rate by default, a recording its own times always.
    control_hz : float, optional
        Rate at which the controller runs; its effort is held in between. By default it is
        continuous.
    step : float, optional
        Longest step of the integrator, s; by default 1 ms.
    position_noise : array_like, shape (n,), optional
        Standard deviation of white noise on the positions that the controller sees, rad (m);
        needs `control_hz`.
    differenced : bool, optional
        Whether the controller takes velocities from differences of the positions that it sees, as
        drives with encoders do; by default with position noise. Needs `control_hz`.
    seed : int or numpy.random.Generator, optional
        The only source of randomness: the position noise.
    start : tuple of 2 array_like, shape (n,), optional
        Position and velocity at the start; by default those of the reference.

    Returns
    -------
    Motion
        A motion that diverges ends there, and says so: no error is raised.

    Raises
    ------
    DataError
        When joints do not match, a rate is missing, or noise is asked for without `control_hz`.
    ModelError
        When the base floats, or a friction term is not one of `sdpid.friction`.

    Examples
    --------
    >>> law = sdpid.controllers.PD(np.full(6, 4000.0), np.full(6, 200.0))
    >>> moved = sdpid.simulate_closed_loop(estimate.model(), motion, law, rate_hz=100.0)
    >>> moved.position.shape
    (3800, 6)
    >>> bool(np.abs(moved.position - motion.sample()[0][::10]).max() < 0.2)
    True
    """
    arm = model if isinstance(model, SimulatedArm) else SimulatedArm.of(model)
    n = arm.n
    if not isinstance(controller, Controller):
        raise DataError(
            f"controller: {type(controller).__name__} is none; give one of sdpid.controllers, or "
            "derive from sdpid.controllers.Controller."
        )
    if controller.n != n:
        raise DataError(
            f"controller: gains of {controller.n} joints, the robot '{arm.model.robot.name}' has "
            f"{n}; give one number a joint."
        )
    desired = DesiredMotion.of(reference, n, rate_hz)
    times = np.ascontiguousarray(desired.time)
    dt, every, steps = _steps(times, control_hz, step)
    noise = _noise(position_noise, n, control_hz, generator(seed), steps, every)
    if differenced is None:
        differenced = position_noise is not None
    if differenced and control_hz is None:
        raise DataError("differenced: a continuous controller has no differences; set control_hz.")
    if start is None:
        states = desired.at(np.zeros(1))[0, :2]
    else:
        states = np.array(shaped(start, "start", (2, n), ": positions, then velocities"))
    grid = np.asarray(dt * np.arange(0.0, steps + 1.0, max(every, 1)))
    ends = told = desired.at(grid)
    if not every:
        told = 0.5 * (ends[:-1] + ends[1:])
    out = np.zeros((5, len(times), n))
    run = told, noise, times, steps, every, dt, differenced, np.ascontiguousarray(states), out
    if isinstance(controller, JointLaw):
        own = (controller.arm or arm).arrays
        law = controller.arm is not None, np.array(controller.gains), own
        count = entries().closed_loop(arm.arrays, law, memory_for(arm.arrays, own), *run)
    else:
        count = _python(arm, controller, *run)
    q, v, held, measured, integral = (x[:count] for x in out)
    effort = held
    if not every:
        # Mostly every end of a step is a sample, and this need not be evaluated again.
        same = len(grid) >= len(times) and np.allclose(grid[: len(times)], times, 0.0, NEAR * dt)
        then = ends[:count] if same else desired.at(times[:count])
        effort = controller.effort(q, v, then[:, 0], then[:, 1], then[:, 2], integral)
    return Motion(
        time=times[:count],
        position=q,
        velocity=v,
        effort=effort,
        measured=measured,
        arm=arm,
        diverged=float(times[count]) if count < len(times) else None,
    )


def _python(arm: SimulatedArm, controller: Controller, *run: Any) -> int:
    """Run a controller of the user's, whose effort is held from step to step.

    The others are what the compiled loop takes.
    """
    desired, noise, times, steps, every, dt, differenced, start, out = run
    every = max(every, 1)
    q, v = start[:, None]
    integral, before = np.zeros_like(q), q
    sample = 0
    for step in range(steps):
        if step % every == 0:
            row = step // every
            told, seen = desired[row][None], noise[row % len(noise)][None]
            measured = q + seen
            speed = (measured - before) / (every * dt) if differenced and row else v
            before, error = measured, told[:, 0] - measured
            states = (measured, speed, *told.swapaxes(0, 1), integral)
            effort = controller.effort(*states)
        q1, v1 = arm.run([q[:, None], v[:, None]], effort[:, None], dt)[:, :, 1]
        if not np.isfinite(v1).all():
            return sample
        while sample < len(times) and times[sample] < (step + 1 - NEAR) * dt:
            x = times[sample] / dt - step
            rise = q1 - q
            curve, cubic = 3.0 * rise - dt * (2.0 * v + v1), dt * (v + v1) - 2.0 * rise
            now = q + x * (dt * v + x * curve + x * x * cubic)
            found = (now, v + x * (v1 - v), effort, now + seen, integral + x * dt * error)
            out[:, sample] = np.concatenate(found)
            sample += 1
        q, v, integral = q1, v1, integral + dt * error
    return sample


def _steps(times: Array, control_hz: Any, step: Any) -> tuple[float, int, int]:
    """Return the length of a step, the steps of a held effort (0: continuous), and how many."""
    longest = _positive(LONGEST_STEP if step is None else step, "step", "length in s")
    if control_hz is not None:
        rate = _positive(control_hz, "control_hz", "rate in Hz")
        every = max(1, int(np.ceil(1.0 / (rate * longest) - 1e-9)))
        dt = 1.0 / (rate * every)
    else:
        # Whole numbers of steps between samples, where these are even.
        between = float(times[-1]) / max(len(times) - 1, 1)
        every = 0
        dt = between / max(1, int(np.ceil(between / longest - 1e-9)))
    # One step past the last sample, which is the start of a step.
    return dt, every, int(np.floor(float(times[-1]) / dt + 1e-6)) + 1


def _noise(
    deviation: Any, n: int, control_hz: Any, rng: np.random.Generator, steps: int, every: int
) -> Array:
    """Return the noise at every time of control, (C, n); one row of zeros without any."""
    if deviation is None:
        return np.zeros((1, n))
    if control_hz is None:
        raise DataError(
            "position_noise: white noise has no meaning for a continuous controller; set "
            "control_hz, the rate at which it runs."
        )
    sizes = np.asarray(deviation, dtype=np.float64)
    sizes = real_array(np.full(n, sizes) if sizes.ndim == 0 else sizes, "position_noise", ndim=1)
    if sizes.shape != (n,) or (sizes < 0.0).any():
        raise DataError(
            f"position_noise is {sizes.tolist()}; give {n} deviations that are not negative."
        )
    return np.asarray(rng.standard_normal((-(-steps // every), n)) * sizes)


def _positive(value: Any, name: str, what: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = float("nan")
    if not 0.0 < number < np.inf:
        raise DataError(f"{name} is {value!r:.80}; give a positive {what}.")
    return number
