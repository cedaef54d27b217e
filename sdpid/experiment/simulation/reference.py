"""The desired motion of a closed loop, at any time."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, real_array
from sdpid.errors import DataError
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.trajectory.sampled import SampledCurve
from sdpid.experiment.trajectory.trajectory import Trajectory

# Answers that a motion keeps: those of a simulation are at the start, the instants of the
# controller, and the samples.
_KEPT = 3

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
            rate = _rate(rate_hz or reference.rate_hz)
            q, v, a = reference.sample()
            own = np.arange(len(q)) / reference.rate_hz
            curve = SampledCurve(time=own, position=q, velocity=v, acceleration=a)
            time = np.arange(int(np.floor(own[-1] * rate * (1.0 + 1e-12))) + 1) / rate
            found = cls(time=time, curve=curve)
        elif isinstance(reference, Recording):
            position = getattr(reference, "reference", None)
            if position is None:
                raise DataError(
                    "reference: the recording has no commanded positions; give the trajectory, or "
                    "read the log with its columns of commanded positions."
                )
            own = np.asarray(reference.time) - reference.time[0]
            found = cls(time=own, curve=SampledCurve(time=own, position=np.asarray(position)))
        else:
            found = cls._of_arrays(reference, rate_hz)
        if found.curve.n != n:
            raise DataError(
                f"reference: {found.curve.n} joints, the robot has {n}; give one column a joint."
            )
        return found

    @classmethod
    def _of_arrays(cls, reference: Any, rate_hz: float | None) -> DesiredMotion:
        if rate_hz is None:
            raise DataError("rate_hz: missing; an array of positions needs the rate of its rows.")
        parts = reference if isinstance(reference, tuple) else (reference,)
        if len(parts) not in (1, 3):
            raise DataError(
                f"reference: {len(parts)} arrays; give positions, or positions, velocities and "
                "accelerations."
            )
        names = ("position", "velocity", "acceleration")
        arrays = {
            name: real_array(values, f"reference {name}", ndim=2)
            for name, values in zip(names, parts, strict=False)
        }
        time = np.arange(len(arrays["position"])) / _rate(rate_hz)
        return cls(time=time, curve=SampledCurve(time=time, **arrays))

    def at(self, time: Array) -> Array:
        """Return positions, velocities and accelerations (T, 3, n); held at the end.

        The last answers are kept, since many models are simulated along one motion.
        """
        for times, found in self._kept:
            if np.array_equal(times, time):
                return found
        found = self._evaluated(time)
        self._kept.append((np.array(time), found))
        return found

    @cached_property
    def _kept(self) -> deque[tuple[Array, Array]]:
        """Times of the last calls of `at`, and the answers."""
        return deque(maxlen=_KEPT)

    def _evaluated(self, time: Array) -> Array:
        """Return positions, velocities and accelerations (T, 3, n)."""
        breaks, inside = self.curve.breaks, np.clip(time, 0.0, self.curve.duration)
        piece = np.clip(np.searchsorted(breaks, inside, side="right") - 1, 0, len(breaks) - 2)
        x = (inside - breaks[piece])[:, None]
        found = np.zeros((len(time), 3, self.curve.n))
        q, v, a = found.swapaxes(0, 1)
        # Horner's rule for the value and two derivatives at once.
        for coefficients in self._powers[::-1]:
            a *= x
            a += 2.0 * v
            v *= x
            v += q
            q *= x
            q += coefficients[piece]
        found[time > self.curve.duration, 1:] = 0.0
        return found

    @cached_property
    def _powers(self) -> Array:
        """Coefficients of the powers of time since each piece began, (q + 1, K - 1, n)."""
        points = self.curve.control_points
        degree = len(points) - 1
        h = np.diff(self.curve.breaks)[:, None]
        # Forward differences of Bernstein coefficients, times binomials.
        return np.stack(
            [
                math.comb(degree, k) * np.diff(points, n=k, axis=0)[0] / h**k
                for k in range(degree + 1)
            ]
        )


def _rate(rate_hz: Any) -> float:
    try:
        rate = float(rate_hz)
    except (TypeError, ValueError):
        rate = float("nan")
    if not (np.isfinite(rate) and rate > 0.0):
        raise DataError(f"rate_hz is {rate_hz!r:.80}; give a positive rate in Hz.")
    return rate
