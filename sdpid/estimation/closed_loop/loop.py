"""A controlled robot along recordings: what was commanded, what follows it, and how it moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, real_array
from sdpid.errors import DataError, SdpidError, SolverError
from sdpid.experiment.preparation.twin import Twin
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.simulation.arm import SimulatedArm
from sdpid.experiment.simulation.closed_loop import DesiredMotion, Motion, simulate_closed_loop
from sdpid.experiment.simulation.controllers import Controller
from sdpid.experiment.simulation.fit_controller import fit_controller
from sdpid.experiment.simulation.law import CommandedMotion
from sdpid.experiment.simulation.sensitivities import sensitivities
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

# Efforts of joints below this share of the largest hold nothing to compare: they are rounding.
_SILENT = 1e-6

# A ratio counts as off where it is off by this many of its standard errors more than allowed. With
# exact gains and encoder noise that the loop feeds back, BIRDy's RV2SQ has ratios of 1.00 with
# errors of 0.005 to 0.018 (standard noise, logs of 139 Hz, controller at 5 kHz).
_ERRORS = 3.0

# Width of the smooth sign of commanded velocities, rad/s (m/s).
_WIDTH = 0.02

# Share of a joint's motion by which a simulated motion may miss the measured one: that of the
# start, which may be far from the robot, and that of the result. Beyond, the regressor of the
# simulated motion is that of another motion: with half the gains, and 7 % of the motion missed,
# DIDIM errs by twice as much as with the right ones (docs/evidence/instruments.md).
START, FOLLOWS = 0.5, 0.2

# Least motion of a joint that counts, as a share of the largest one.
_LEAST_MOTION = 0.1

# A tracking error, or an effort, that is this many times another is of another controller.
_OTHER = 1.5


def commanded(twin: Twin, reference: Any) -> Twin:
    """Return recordings with commanded positions (N, n), where somebody gives them.

    Parameters
    ----------
    twin : Twin
        The recordings.
    reference : Trajectory, array_like of shape (N, n), or a sequence of these, optional
        One a recording; by default `Recording.reference`.

    Raises
    ------
    DataError
        When a given reference does not fit the recordings.
    """
    if reference is None:
        return twin
    alone = isinstance(reference, (Trajectory, np.ndarray)) or not isinstance(reference, Sequence)
    given = [reference] if alone else list(reference)
    if len(given) != len(twin.logs):
        raise DataError(
            f"reference: {len(given)} for {len(twin.logs)} recordings; give one each, in their "
            "order: a Trajectory or an array (N, n)."
        )
    pairs = zip(twin.logs, given, strict=True)
    return replace(twin, logs=tuple(replace(log, reference=_at_stamps(log, r)) for log, r in pairs))


def is_commanded(twin: Twin) -> bool:
    """Whether all recordings have commanded positions."""
    return all(log.reference is not None for log in twin.logs)


def references(twin: Twin, purpose: str) -> list[Array]:
    """Return the commanded positions (N, n) of each recording; raise where there are none."""
    if not is_commanded(twin):
        raise DataError(
            f"{purpose} needs what was commanded; read the log with its columns of commanded "
            "positions (Recording.reference), or give reference=, a Trajectory or an array "
            "(N, n)."
        )
    return [np.asarray(log.reference) for log in twin.logs]


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


def _controller(given: Any, log: Recording, purpose: str, *, exact: bool) -> Controller:
    """Return a given controller, or one that explains a log's efforts, `exact`: knows it well."""
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


class ClosedLoop:
    """The controlled robot along recordings, whatever its parameters.

    Parameters
    ----------
    twin : Twin
        The recordings.
    controller, reference, control_hz : optional
        As for `solve_output_error`.
    purpose : str, optional
        For messages.
    exact : bool, optional
        Whether a fitted controller must be known well.
    as_measured : bool, optional
        Whether motions begin as measured, and are simulated at instants close enough for `slopes`.
        Otherwise they begin as commanded: no noise of the encoders is in them.
    law : bool, optional
        Whether the controller is the law of the recordings, whose commands act after its delay.

    Raises
    ------
    DataError
        When something is missing, or joints or lengths do not fit.

    Attributes
    ----------
    twin : Twin
        The recordings, with what was commanded in each, and their processing.
    controller : Controller
        What closes the loop.
    control_hz : float or None
        Rate at which it runs; None for a continuous one.
    """

    def __init__(
        self,
        twin: Twin,
        controller: Any = "fit",
        reference: Any = None,
        *,
        control_hz: float | None = None,
        purpose: str = "output error",
        exact: bool = True,
        as_measured: bool = True,
        law: bool = False,
    ) -> None:
        commands = [CommandedMotion.under(x, controller) for x in twin.logs] if law else []
        if law:
            # What acts, at the stamps.
            reference = [each.at(each.time)[:, 0] for each in commands]
        self.twin, self.control_hz, self.purpose = commanded(twin, reference), control_hz, purpose
        self.references = references(self.twin, f"{purpose}:")
        self.controller = _controller(controller, self.twin.logs[0], purpose, exact=exact)
        if self.controller.n != twin.robot.n:
            raise DataError(
                f"controller: has gains of {self.controller.n} joints, the robot "
                f"'{twin.robot.name}' has {twin.robot.n}; give one number a joint."
            )
        # Of each recording: what was commanded at stamps that are close enough for what is
        # simulated, how many of these lie between its own, and where the robot was at the first.
        self._paths: list[tuple[DesiredMotion, int, tuple[Array, Array] | None]] = []
        for number, log in enumerate(self.twin.logs):
            given: Any = commands[number] if law else log
            desired, every, start = DesiredMotion.of(given, log.n, None), 1, None
            if as_measured:
                # Steps are no smooth motion about which the measured one could be.
                states = desired.at(desired.time) * (not law)
                start = _start(log, desired.time, states)
                every = max(1, int(np.ceil(log.step / _LINEARIZED - 1e-6)))
                count = len(desired.time)
                rows = np.arange((count - 1) * every + 1) / every
                time = np.interp(rows, np.arange(count), desired.time)
                desired = replace(desired, time=time)
            self._paths.append((desired, every, start))

    @property
    def integral_gain(self) -> Array | None:
        """Gains (n,) of the integrated tracking errors; None where there are none."""
        gains = getattr(self.controller, "gains", None)
        return None if gains is None or not np.any(gains.integral) else gains.integral

    def follow(self, model: RobotDynamics) -> list[Motion]:
        """Simulate the recordings, up to the first that diverges."""
        arm, motions = SimulatedArm.of(model), list[Motion]()
        for desired, _, start in self._paths:
            motions.append(
                simulate_closed_loop(
                    arm, desired, self.controller, control_hz=self.control_hz, start=start
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

    def _at_stamps(self, motions: Sequence[Motion], state: str) -> list[Array]:
        """Return a simulated state (N, n) at the recordings' stamps."""
        pairs = zip(motions, self._paths, strict=True)
        return [getattr(motion, state)[::every] for motion, (_, every, _) in pairs]

    def samples(self, motions: Sequence[Motion]) -> Samples:
        """Process simulated motions as the measured ones, with the measured efforts."""
        velocity = self._at_stamps(motions, "velocity")
        return self.twin.samples(self._at_stamps(motions, "position"), velocity=velocity)

    def missed(self, motions: Sequence[Motion]) -> Array:
        """Return measured less simulated positions, filtered alike, (K, n)."""
        simulated = self.twin.positions(self._at_stamps(motions, "position"))
        return self.twin.measured.position - simulated

    def slopes(
        self, model: RobotDynamics, base: BaseParameters, motions: Sequence[Motion]
    ) -> Array:
        """Return the derivative of the filtered positions by base parameters, (K, n, b).

        `motions` are those of the model.
        """
        from scipy.integrate import cumulative_trapezoid
        from scipy.interpolate import make_interp_spline

        found = []
        for log, path, moved in zip(self.twin.logs, self._paths, motions, strict=True):
            count, stride = len(moved.time), max(1, int(_LINEARIZED / log.step + 1e-6))
            few = np.unique(np.append(np.arange(0, count, stride), count - 1))
            told = path[0].at(moved.time)
            error = told[:, 0] - moved.position
            integral = cumulative_trapezoid(error, moved.time, axis=0, initial=0.0)
            states = (moved.position, moved.velocity, *told.swapaxes(0, 1), integral)
            given = [each[few] for each in states]
            every = path[1] if stride == 1 else 1
            time = moved.time[few]
            values = sensitivities(model, base, self.controller, time, given, every=every)
            if stride > 1:
                values = make_interp_spline(time, values)(moved.time)
            # Columns in a piece: filtering goes through each on its own.
            found.append(np.ascontiguousarray(np.moveaxis(values, 2, 0)))
        columns = [self.twin.positions([each[k] for each in found]) for k in range(base.count)]
        return np.ascontiguousarray(np.moveaxis(np.array(columns), 0, 2))


def _start(log: Recording, time: Array, told: Array) -> tuple[Array, Array]:
    """Return the measured state at the first stamp: as told, less a parabola of the errors."""
    error = told[:, 0] - np.asarray(log.position)
    # Third differences of what is smooth are small; of white noise they have 20 times its variance.
    rough = np.diff(error, n=3, axis=0)
    noise = np.median(rough**2, axis=0) / (_MEDIAN_OF_SQUARES * 20.0)
    counts = [min(_FEWEST, len(time))]
    while (more := int(_MORE * counts[-1])) < len(time) and time[more - 1] <= _BEGINNING:
        counts.append(more)
    state, explained = np.zeros((2, log.n)), np.ones(log.n, dtype=bool)
    for count in counts:
        powers = time[:count, None] ** np.arange(3)
        fitted = np.linalg.lstsq(powers, error[:count], rcond=None)[0]
        variance = np.sum((error[:count] - powers @ fitted) ** 2, axis=0) / max(count - 3, 1)
        if count > counts[0]:
            explained &= variance <= noise * (1.0 + _EXPLAINED * np.sqrt(2.0 / (count - 3)))
        state = np.where(explained, fitted[:2], state)
    return told[0, 0] - state[0], told[0, 1] - state[1]


class ControllerCheck:
    """Measured efforts beside those that the controller gives on the measured motion.

    They are compared sample by sample, after the filter. The measured motion answers the
    controller, so a wrong model of the robot has no say. Noise of the encoders is in the
    controller's efforts, and in the measured ones where the loop feeds it back; least squares would
    find too small or too large ratios (0.6 to 2.7 on BIRDy's RV2SQ). The commanded motion, as
    instrument, has no noise.

    Parameters
    ----------
    loop : ClosedLoop
        The controller and the recordings.

    Attributes
    ----------
    ratio : ndarray, shape (n,)
        Factor from the controller's efforts to the measured ones; 1 where a joint has no effort.
    error : ndarray, shape (n,)
        Its standard error, from blocks of samples; infinite where a joint has no effort.
    misfit : ndarray, shape (n,)
        Root mean square of their difference over that of the measured efforts.
    """

    def __init__(self, loop: ClosedLoop) -> None:
        self.loop, self._names = loop, loop.twin.robot.joint_names
        twin = loop.twin
        measured, told = twin.measured, twin.samples(loop.references)
        integral = None
        if loop.integral_gain is not None:
            integral = _integral(told.position - measured.position, twin)
        states = measured.position, measured.velocity, told.position, told.velocity
        given = loop.controller.effort(*states, told.acceleration, integral)
        # What the commanded motion says of efforts, and a constant.
        sign, one = np.tanh(told.velocity / _WIDTH), np.ones((len(given), 1))
        seen = np.column_stack([told.position, told.velocity, told.acceleration, sign, one])
        effort = measured.effort
        if integral is not None:
            # Where the integral of each piece began is not known.
            given, effort, seen = (
                np.concatenate([each[part] - each[part].mean(axis=0) for part in measured.parts])
                for each in (given, effort, seen)
            )
        basis = np.linalg.qr(seen)[0]
        instruments = basis @ (basis.T @ given)
        power, size = np.sum(instruments * given, axis=0), np.sqrt(np.mean(effort**2, axis=0))
        known = (power > 0.0) & (size > _SILENT * size.max())
        power, size = np.where(known, power, 1.0), np.where(known, size, 1.0)
        self.ratio = np.where(known, np.sum(instruments * effort, axis=0) / power, 1.0)
        starts = np.arange(0, len(effort), max(measured.block, 1))
        sums = np.add.reduceat(instruments * (effort - self.ratio * given), starts, axis=0)
        self.error = np.where(known, np.sqrt(np.sum(sums**2, axis=0)) / power, np.inf)
        off = np.sqrt(np.mean((effort - given) ** 2, axis=0))
        self.misfit = np.where(known, off / size, 0.0)

    def require(self, tolerance: float) -> None:
        """Raise where a ratio is off by more than the tolerance, its errors allowed for.

        Raises
        ------
        DataError
            Naming the joint that is off most.
        """
        # An infinite error allows for any ratio.
        beyond = np.abs(self.ratio - 1.0) - tolerance - _ERRORS * self.error
        j = int(np.argmax(beyond))
        if beyond[j] <= 0.0:
            return
        off = int(np.count_nonzero(beyond > 0.0))
        raise DataError(
            f"output error: the controller, or what was commanded, is not that of this log: "
            f"measured efforts of joint {self._names[j]} are {self.ratio[j]:.3g} times those that "
            f"the controller gives on the measured motion (standard error {self.error[j]:.1g}; "
            f"joints that are off by surely more than {100 * tolerance:g} %: {off} of "
            f"{len(beyond)}), and every parameter would be off as much. "
            "Give the gains that ran (N.m/rad, N.m.s/rad), controller='fit', method='didim' or "
            "sdpid.solve_instrumental, which hardly depend on them, or allow it "
            "(controller_tolerance). Where factors are negative or near 0, look whether the "
            "commanded positions are those of this log, in rad, and at its time."
        )

    def fault(self, motions: Sequence[Motion], share: float) -> str | None:
        """Return that a simulated motion is not the measured one, and what is to blame.

        None where no joint misses the measured motion by more than a share of it.
        """
        twin, missed = self.loop.twin, self.loop.missed(motions)
        size = np.sqrt(np.mean(missed**2, axis=0))
        motion = np.std(twin.measured.position, axis=0)
        least = np.maximum(motion, max(_LEAST_MOTION * float(motion.max()), np.finfo(float).tiny))
        j = int(np.argmax(size / least))
        if size[j] <= share * least[j]:
            return None
        error = (twin.positions(self.loop.references) - twin.measured.position)[:, j]
        own, simulated = (float(np.sqrt(np.mean(e**2))) for e in (error, error + missed[:, j]))
        off = np.where(np.isfinite(self.error), self.ratio, 1.0)
        worst = int(np.argmax(off))
        if simulated > _OTHER * own and off[worst] > _OTHER:
            blame = (
                "the controller's gains are too low, or of another unit (N.m/rad, N.m.s/rad): "
                f"measured efforts of {self._names[worst]} are {off[worst]:.3g} times those that "
                "it gives on the measured motion"
            )
        elif own > _OTHER * simulated:
            blame = (
                "the commanded positions are not those of this recording, in its joints, time and "
                "units (rad), or the gains are too high"
            )
        else:
            blame = (
                "check the controller, the commanded positions, and the parameters that are "
                "simulated first (start=)"
            )
        return (
            f"output error: joint {self._names[j]} does not follow what was commanded as it did in "
            f"the recording: it misses the commands by {simulated:.3g} (rms) in the simulation and "
            f"by {own:.3g} as measured, and the measured motion, which is of {motion[j]:.3g}, by "
            f"{size[j]:.3g} (limit {100 * share:g} %): {blame}. "
            "sdpid.solve_instrumental needs no controller: by the commanded motion or periods."
        )


def _integral(error: Array, twin: Twin) -> Array:
    """Return the integral of filtered tracking errors (K, n), piece by piece."""
    from scipy.integrate import cumulative_trapezoid

    samples, seconds = twin.measured, sum(log.duration for log in twin.logs)
    time = np.linspace(0.0, seconds, len(error)) if samples.time is None else samples.time
    pieces = [(error[part], time[part]) for part in samples.parts]
    return np.concatenate([cumulative_trapezoid(e, t, axis=0, initial=0.0) for e, t in pieces])
