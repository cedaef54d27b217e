"""A controlled robot along recordings: what was commanded, what follows it, and how it moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, real_array
from sdpid.errors import DataError, SdpidError, SolverError
from sdpid.experiment.preparation.twin import Twin
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.simulation.arm import SimulatedArm
from sdpid.experiment.simulation.closed_loop import Motion, simulate_closed_loop
from sdpid.experiment.simulation.fit_controller import fit_controller
from sdpid.experiment.simulation.law import Controller
from sdpid.experiment.simulation.reference import DesiredMotion
from sdpid.experiment.simulation.sensitivities import Loop, sensitivities
from sdpid.experiment.trajectory.trajectory import Trajectory
from sdpid.robot.model.base_parameters import BaseParameters
from sdpid.robot.model.dynamics import RobotDynamics

# Laws that are tried, the most common first.
_FITTED = ("pd", "p", "pid")

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


def commanded(twin: Twin, reference: Any, purpose: str | None = None) -> tuple[Array, ...] | None:
    """Return commanded positions (N, n) of each recording; None where nobody says.

    Parameters
    ----------
    twin : Twin
        The recordings.
    reference : Trajectory, array_like of shape (N, n), or a sequence of these, optional
        One a recording; by default `Recording.reference`.
    purpose : str, optional
        Who needs them, for the message.

    Raises
    ------
    DataError
        When a given reference does not fit the recordings, or there is none that somebody needs.
    """
    logs = twin.logs
    if reference is None:
        known = [np.asarray(log.reference) for log in logs if log.reference is not None]
        if len(known) < len(logs) and purpose is not None:
            raise DataError(
                f"{purpose} needs what was commanded; read the log with its columns of commanded "
                "positions (Recording.reference), or give reference=, a Trajectory or an array "
                "(N, n)."
            )
        return tuple(known) if len(known) == len(logs) else None
    alone = isinstance(reference, (Trajectory, np.ndarray)) or not isinstance(reference, Sequence)
    given = [reference] if alone else list(reference)
    if len(given) != len(logs):
        raise DataError(
            f"reference: {len(given)} for {len(logs)} recordings; give one each, in their order: a "
            "Trajectory or an array (N, n)."
        )
    return tuple(_at_stamps(log, each) for log, each in zip(logs, given, strict=True))


def _at_stamps(log: Recording, reference: Any) -> Array:
    """Return commanded positions (N, n) at a recording's time stamps."""
    if not isinstance(reference, Trajectory):
        array = real_array(reference, "reference", ndim=2)
        if array.shape != log.position.shape:
            raise DataError(
                f"reference: has shape {array.shape}, expected {log.position.shape} as the "
                "positions have: one row a time stamp, one column a joint."
            )
        return array
    if reference.joint_names != log.joint_names:
        raise DataError(
            f"reference: moves {', '.join(reference.joint_names)}; the recording has "
            f"{', '.join(log.names)}."
        )
    planned = DesiredMotion.of(reference, log.n, None)
    time = np.asarray(log.time) - log.time[0]
    if time[-1] > planned.curve.duration + log.step:
        raise DataError(
            f"reference: the trajectory ends after {planned.curve.duration:.6g} s, the recording "
            f"after {time[-1]:.6g} s; cut the recording, or give the positions at its time stamps."
        )
    return np.asarray(planned.at(time)[:, 0])


def controller_of(given: Any, log: Recording, purpose: str, *, exact: bool) -> Controller:
    """Return a given controller, or one that explains a log's efforts.

    Parameters
    ----------
    given : Controller, "fit" or None
        What the user gave.
    log : Recording
        With commanded positions.
    purpose : str
        For messages.
    exact : bool
        Whether a fitted one must be known well.

    Raises
    ------
    DataError
        When it is no controller, or the log does not show one.
    """
    if isinstance(given, Controller):
        return given
    if given not in (None, "fit"):
        raise DataError(
            f"{purpose}: controller is {given!r:.80}: give one of sdpid.controllers (P, PD, PID, "
            "ComputedTorque), or 'fit'."
        )
    fits = []
    for kind in _FITTED:
        fits.append(fit_controller(log, kind))
        if fits[-1].usable:
            return fits[-1].require()
    if fits[0].controller is not None and not exact:
        return fits[0].controller
    hardly = "method='didim' of sdpid.solve_output_error, or " if exact else ""
    raise DataError(
        f"{purpose}: the controller is not known well enough from this log: "
        f"{'; '.join(fits[0].reasons)}. Give it, as one of sdpid.controllers (controller=), look "
        f"whether the commanded positions are those of this log, in rad, or use {hardly}"
        "sdpid.solve_instrumental with instruments='reference' or 'periods', which needs none."
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Path:
    """What the robot was told to do in one recording, and where it was when that began.

    Attributes
    ----------
    desired : DesiredMotion
        The commanded motion, at stamps that are close enough for what is simulated.
    every : int
        How many of these lie between stamps of the recording.
    start : tuple of 2 ndarrays, shape (n,), or None
        Position and velocity at the first stamp; None for the commanded ones.
    """

    desired: DesiredMotion
    every: int
    start: tuple[Array, Array] | None


@dataclass(frozen=True, kw_only=True, eq=False)
class ClosedLoop:
    """The controlled robot along recordings, whatever its parameters.

    Attributes
    ----------
    twin : Twin
        The recordings and their processing.
    references : tuple of ndarray, shape (N, n)
        What was commanded in each.
    paths : tuple of Path
        The same, for simulations.
    controller : Controller
        What closes the loop.
    control_hz : float or None
        Rate at which it runs; None for a continuous one.
    purpose : str
        For messages.
    """

    twin: Twin
    references: tuple[Array, ...]
    paths: tuple[Path, ...]
    controller: Controller
    control_hz: float | None
    purpose: str

    @classmethod
    def of(
        cls,
        twin: Twin,
        controller: Any = "fit",
        reference: Any = None,
        *,
        control_hz: float | None = None,
        purpose: str = "output error",
        exact: bool = True,
        as_measured: bool = True,
    ) -> ClosedLoop:
        """Take commanded positions from the recordings or as given, and a controller likewise.

        Parameters
        ----------
        twin : Twin
            The recordings.
        controller, reference, control_hz : optional
            As for `solve_output_error`.
        purpose, exact
            As for `controller_of`.
        as_measured : bool, optional
            Whether motions begin as measured, and are simulated at instants close enough for
            `slopes`. Otherwise they begin as commanded: no noise of the encoders is in them.

        Raises
        ------
        DataError
            When one is missing, or joints or lengths do not fit.
        """
        told = commanded(twin, reference, f"{purpose}:")
        assert told is not None
        logs = [replace(log, reference=each) for log, each in zip(twin.logs, told, strict=True)]
        law = controller_of(controller, logs[0], purpose, exact=exact)
        if law.n != twin.robot.n:
            raise DataError(
                f"controller: has gains of {law.n} joints, the robot '{twin.robot.name}' "
                f"has {twin.robot.n}; give one number a joint."
            )
        return cls(
            twin=twin,
            references=told,
            paths=tuple(_path(log, as_measured=as_measured) for log in logs),
            controller=law,
            control_hz=control_hz,
            purpose=purpose,
        )

    @property
    def integral_gain(self) -> Array | None:
        """Gains (n,) of the integrated tracking errors; None where there are none."""
        gains = getattr(self.controller, "gains", None)
        return None if gains is None or not np.any(gains.integral) else gains.integral

    def follow(self, model: RobotDynamics) -> list[Motion]:
        """Simulate the recordings, up to the first that diverges."""
        arm, motions = SimulatedArm.of(model), list[Motion]()
        for path in self.paths:
            motions.append(
                simulate_closed_loop(
                    arm, path.desired, self.controller, control_hz=self.control_hz, start=path.start
                )
            )
            if motions[-1].diverged is not None:
                break
        return motions

    def require(
        self, model: RobotDynamics, what: str, error: type[SdpidError] = SolverError
    ) -> list[Motion]:
        """Simulate all recordings; raise where a motion diverges."""
        motions = self.follow(model)
        if (end := motions[-1].diverged) is not None:
            raise error(
                f"{self.purpose}: the controller cannot make the model follow the reference: the "
                f"simulated motion of {what} diverges under {self.controller!r} at {end:.4g} s of "
                f"{self.twin.logs[len(motions) - 1].duration:.4g} s; check the gains' units "
                "(N.m/rad, N.m.s/rad) and signs, give the rate that the controller runs at "
                "(control_hz) if it is below 1 kHz, start from consistent parameters nearer to the "
                "robot (start=), or take the reference itself (sdpid.solve_instrumental, "
                "instruments='reference')."
            )
        return motions

    def positions(self, motions: Sequence[Motion]) -> list[Array]:
        """Return simulated positions (N, n) at the recordings' stamps."""
        return [m.position[:: p.every] for m, p in zip(motions, self.paths, strict=True)]

    def samples(self, motions: Sequence[Motion]) -> Samples:
        """Process simulated motions as the measured ones, with the measured efforts."""
        velocity = [m.velocity[:: p.every] for m, p in zip(motions, self.paths, strict=True)]
        return self.twin.samples(self.positions(motions), velocity=velocity)

    def missed(self, motions: Sequence[Motion]) -> Array:
        """Return measured less simulated positions, filtered alike, (K, n)."""
        return self.twin.measured.position - self.twin.positions(self.positions(motions))

    def slopes(
        self, model: RobotDynamics, base: BaseParameters, motions: Sequence[Motion]
    ) -> Array:
        """Return the derivative of the filtered positions by base parameters, (K, n, b).

        `motions` are those of the model.
        """
        from scipy.integrate import cumulative_trapezoid
        from scipy.interpolate import make_interp_spline

        found = []
        for log, path, moved in zip(self.twin.logs, self.paths, motions, strict=True):
            count, stride = len(moved.time), max(1, int(_LINEARIZED / log.step + 1e-6))
            few = np.unique(np.append(np.arange(0, count, stride), count - 1))
            told = path.desired.at(moved.time)
            error = told[:, 0] - moved.position
            integral = cumulative_trapezoid(error, moved.time, axis=0, initial=0.0)
            states = (moved.position, moved.velocity, *told.swapaxes(0, 1), integral)
            given = [each[few] for each in states]
            stiffness, damping = self.controller.slopes(*given)
            loop = Loop(
                time=moved.time[few],
                position=given[0],
                velocity=given[1],
                # The effort of these states: a held one is that of the last period.
                effort=self.controller.effort(*given),
                stiffness=stiffness,
                damping=damping,
                integral=self.integral_gain,
            )
            if stride == 1:
                values = sensitivities(model, base, loop, at=np.arange(0, count, path.every))
            else:
                some = sensitivities(model, base, loop)
                values = make_interp_spline(loop.time, some)(moved.time)
            # Columns in a piece: filtering goes through each on its own.
            found.append(np.ascontiguousarray(np.moveaxis(values, 2, 0)))
        columns = [self.twin.positions([each[k] for each in found]) for k in range(base.count)]
        return np.ascontiguousarray(np.moveaxis(np.array(columns), 0, 2))


def _path(log: Recording, *, as_measured: bool) -> Path:
    """Return what was commanded in a recording, as its reference says."""
    desired = DesiredMotion.of(log, log.n, None)
    if not as_measured:
        return Path(desired=desired, every=1, start=None)
    time = desired.time
    every = max(1, int(np.ceil(log.step / _LINEARIZED - 1e-6)))
    rows = np.arange((len(time) - 1) * every + 1) / every
    fine = replace(desired, time=np.interp(rows, np.arange(len(time)), time))
    return Path(desired=fine, every=every, start=_start(log, time, desired.at(time)))


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
