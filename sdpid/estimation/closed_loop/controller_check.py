"""Whether a controller, and what was commanded, are those of a recording: told before a solve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.estimation.closed_loop.loop import ClosedLoop
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.simulation.closed_loop import Motion

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


@dataclass(frozen=True, kw_only=True, eq=False)
class ControllerCheck:
    """Measured efforts beside those that the controller gives on the measured motion.

    Attributes
    ----------
    ratio : ndarray, shape (n,)
        Factor from the controller's efforts to the measured ones; 1 where a joint has no effort.
    error : ndarray, shape (n,)
        Its standard error, from blocks of samples; infinite where a joint has no effort.
    misfit : ndarray, shape (n,)
        Root mean square of their difference over that of the measured efforts.
    names : tuple of str
        Of the joints.
    """

    ratio: Array
    error: Array
    misfit: Array
    names: tuple[str, ...]

    @classmethod
    def of(cls, loop: ClosedLoop) -> ControllerCheck:
        """Compare, sample by sample, what passes the filter.

        The measured motion answers the controller, so a wrong model of the robot has no say. Noise
        of the encoders is in the controller's efforts, and in the measured ones where the loop
        feeds it back; least squares would find too small or too large ratios (0.6 to 2.7 on BIRDy's
        RV2SQ). The commanded motion, as instrument, has no noise.
        """
        measured, told = loop.twin.measured, loop.twin.samples(loop.references)
        integral = None
        if loop.integral_gain is not None:
            integral = _integral(told.position - measured.position, loop)
        states = measured.position, measured.velocity, told.position, told.velocity
        given = loop.controller.effort(*states, told.acceleration, integral)
        effort, instruments = measured.effort, _instruments(told)
        if integral is not None:
            # Where the integral of each piece began is not known.
            given, effort, instruments = (
                np.concatenate([each[part] - each[part].mean(axis=0) for part in measured.parts])
                for each in (given, effort, instruments)
            )
        basis = np.linalg.qr(instruments)[0]
        seen = basis @ (basis.T @ given)
        power, size = np.sum(seen * given, axis=0), np.sqrt(np.mean(effort**2, axis=0))
        known = (power > 0.0) & (size > _SILENT * size.max())
        power, size = np.where(known, power, 1.0), np.where(known, size, 1.0)
        ratio = np.where(known, np.sum(seen * effort, axis=0) / power, 1.0)
        starts = np.arange(0, len(effort), max(measured.block, 1))
        sums = np.add.reduceat(seen * (effort - ratio * given), starts, axis=0)
        error = np.where(known, np.sqrt(np.sum(sums**2, axis=0)) / power, np.inf)
        misfit = np.where(known, np.sqrt(np.mean((effort - given) ** 2, axis=0)) / size, 0.0)
        return cls(ratio=ratio, error=error, misfit=misfit, names=loop.twin.robot.joint_names)

    def require(self, tolerance: float) -> None:
        """Raise where a ratio is off by more than the tolerance, its errors allowed for.

        Raises
        ------
        DataError
            Naming the joint that is off most.
        """
        off = np.abs(self.ratio - 1.0)
        beyond = off - tolerance - _ERRORS * np.where(np.isfinite(self.error), self.error, 0.0)
        wrong = (beyond > 0.0) & np.isfinite(self.error)
        if not wrong.any():
            return
        j = int(np.argmax(np.where(wrong, beyond, -np.inf)))
        off_by = f"by surely more than {100 * tolerance:g} %: {int(wrong.sum())} of {len(wrong)}"
        raise DataError(
            f"output error: the controller, or what was commanded, is not that of this log: "
            f"measured efforts of joint {self.names[j]} are {self.ratio[j]:.3g} times those that "
            f"the controller gives on the measured motion (standard error {self.error[j]:.1g}; "
            f"joints that are off {off_by}), and every parameter would be off as much. "
            "Give the gains that ran (N.m/rad, N.m.s/rad), controller='fit', method='didim' or "
            "sdpid.solve_instrumental, which hardly depend on them, or allow it "
            "(controller_tolerance). Where factors are negative or near 0, look whether the "
            "commanded positions are those of this log, in rad, and at its time."
        )

    def fault(self, loop: ClosedLoop, motions: Sequence[Motion], share: float) -> str | None:
        """Return that a simulated motion is not the measured one, and what is to blame.

        None where no joint misses the measured motion by more than a share of it.
        """
        missed = loop.missed(motions)
        size = np.sqrt(np.mean(missed**2, axis=0))
        measured = loop.twin.measured.position
        motion = np.std(measured, axis=0)
        least = np.maximum(motion, max(_LEAST_MOTION * float(motion.max()), np.finfo(float).tiny))
        j = int(np.argmax(size / least))
        if size[j] <= share * least[j]:
            return None
        error = loop.twin.positions(loop.references)[:, j] - measured[:, j]
        own, simulated = (float(np.sqrt(np.mean(e**2))) for e in (error, error + missed[:, j]))
        return (
            f"output error: joint {self.names[j]} does not follow what was commanded as it did in "
            f"the recording: it misses the commands by {simulated:.3g} (rms) in the simulation and "
            f"by {own:.3g} as measured, and the measured motion, which is of {motion[j]:.3g}, by "
            f"{size[j]:.3g} (limit {100 * share:g} %): {self._blame(own, simulated)}. "
            "sdpid.solve_instrumental needs no controller: by the commanded motion or periods."
        )

    def _blame(self, own: float, simulated: float) -> str:
        """Return what to mend, by the tracking errors as measured and simulated."""
        off = np.where(np.isfinite(self.error), self.ratio, 1.0)
        j = int(np.argmax(off))
        if simulated > _OTHER * own and off[j] > _OTHER:
            return (
                "the controller's gains are too low, or of another unit (N.m/rad, N.m.s/rad): "
                f"measured efforts of {self.names[j]} are {off[j]:.3g} times those that it gives "
                "on the measured motion"
            )
        if own > _OTHER * simulated:
            return (
                "the commanded positions are not those of this recording, in its joints, time and "
                "units (rad), or the gains are too high"
            )
        return (
            "check the controller, the commanded positions, and the parameters that are simulated "
            "first (start=)"
        )


def _instruments(told: Samples) -> Array:
    """Return what the commanded motion says of efforts, and a constant, (K, 4n + 1)."""
    v = told.velocity
    parts = [told.position, v, told.acceleration, np.tanh(v / _WIDTH), np.ones((len(v), 1))]
    table = np.column_stack(parts)
    size = np.sqrt(np.mean(table**2, axis=0))
    return np.asarray(table / np.where(size > 0.0, size, 1.0))


def _integral(error: Array, loop: ClosedLoop) -> Array:
    """Return the integral of filtered tracking errors (K, n), piece by piece."""
    from scipy.integrate import cumulative_trapezoid

    samples, seconds = loop.twin.measured, sum(log.duration for log in loop.twin.logs)
    time = np.linspace(0.0, seconds, len(error)) if samples.time is None else samples.time
    pieces = [(error[part], time[part]) for part in samples.parts]
    return np.concatenate([cumulative_trapezoid(e, t, axis=0, initial=0.0) for e, t in pieces])
