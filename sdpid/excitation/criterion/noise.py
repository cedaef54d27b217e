"""How far the efforts of a run will be from the model: the noise of every joint.

What counts for an estimate is the noise's density at the frequencies of the motion: white noise of
standard deviation s, sampled at the rate f, has the density s²/f, and residuals of variance s² that
are alike over a time tau have s²·tau. On real robots residuals are what the model lacks rather than
noise of sensors, and they last: that is what is assumed where nothing is known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from sdpid._common.arrays import Array, frozen, real_array
from sdpid.errors import DataError
from sdpid.estimation.noise_spectrum import NoiseSpectrum
from sdpid.estimation.problem import Problem

# Residuals of real recordings, beside the geometric mean of a joint's rms effort and the largest
# one, and how long they are alike, s: medians over 31 joints of UR10, Panda, LWR 4+, TX40 and Gen3
# under the defaults of `sdpid.identify` (by robot 1.5 to 4.6 %, 0.07 to 0.7 s).
SHARE, LASTING = 0.025, 0.2

# A joint whose effort is all but zero gets this share of the loudest one's.
_SILENT = 1e-3

Given: TypeAlias = "ExpectedNoise | float | Sequence[float] | Mapping[str, float] | Array | None"


def usual_effort(rms: Array) -> Array:
    """Return the geometric mean of each joint's rms effort (n,) and the largest one, N·m.

    It is never zero: of joints without any effort it is one.
    """
    largest = float(np.max(rms, initial=0.0)) or 1.0
    # Two roots: products of tiny numbers would be zero.
    return np.asarray(np.sqrt(np.maximum(rms, _SILENT * largest)) * np.sqrt(largest))


@dataclass(frozen=True, kw_only=True, eq=False)
class ExpectedNoise:
    """The noise of every joint's effort.

    Attributes
    ----------
    density : ndarray, shape (n,)
        At the frequencies of the motion, (N·m)²·s.
    deviation : ndarray, shape (n,)
        Standard deviation of the residuals, N·m: of white noise that of a sample.
    notes : tuple of str
        Where the numbers are from.
    """

    density: Array
    deviation: Array
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("density", "deviation"):
            values = real_array(getattr(self, name), f"noise: {name}", ndim=1)
            if not np.all(values > 0.0):
                raise DataError(f"noise: {name} is {values.tolist()}; give positive numbers.")
            object.__setattr__(self, name, frozen(values))
        if len(self.density) != len(self.deviation):
            raise DataError(
                f"noise: {len(self.density)} densities and {len(self.deviation)} deviations; give "
                "one of each for every joint."
            )

    @classmethod
    def white(cls, deviation: Array, rate_hz: float) -> ExpectedNoise:
        """Return white noise of standard deviations (n,), N·m, at a rate in Hz."""
        values = np.asarray(deviation, dtype=np.float64)
        note = f"noise of the efforts: white, as given, at {rate_hz:g} Hz"
        return cls(density=values**2 / rate_hz, deviation=values, notes=(note,))

    @classmethod
    def assumed(cls, effort_rms: Array) -> ExpectedNoise:
        """Return what is usual on real robots, from the rms effort (n,) of the motion, N·m."""
        deviation = SHARE * usual_effort(effort_rms)
        note = (
            f"noise of the efforts: assumed, as on real robots: {100.0 * SHARE:g} % of each "
            "joint's usual effort (the geometric mean of its rms and the largest one), alike over "
            f"{LASTING:g} s"
        )
        return cls(density=LASTING * deviation**2, deviation=deviation, notes=(note,))

    @classmethod
    def of_residuals(cls, problem: Problem, theta: Array) -> ExpectedNoise:
        """Return that of an earlier run, from the spectrum of its residuals.

        Raises
        ------
        DataError
            When the problem has no rows.
        """
        rows = problem.require_rows("the noise of an earlier run")
        spectrum = NoiseSpectrum.of(problem, theta)
        sigma = problem.sigma if problem.sigma.ndim == 2 else problem.sigma.mean(axis=0)
        own = np.zeros(problem.robot.n)
        own[: len(spectrum.densities)] = spectrum.densities
        time = rows.samples.time
        if time is None:
            raise DataError("the noise of an earlier run: its samples have no time stamps.")
        step = float(np.median(np.diff(time)))
        variance = np.diag(sigma) * np.where(own > 0.0, own, 1.0)
        residual = rows.samples.effort - problem.predict(problem.base_of(theta))
        used = rows.samples.used
        squares = np.where(used, residual, 0.0) ** 2
        deviation = np.sqrt(squares.sum(axis=0) / np.maximum(used.sum(axis=0), 1))
        deviation = np.where(deviation > 0.0, deviation, np.sqrt(variance))
        note = "noise of the efforts: as the residuals of the earlier run"
        return cls(density=variance * step, deviation=deviation, notes=(note,))

    @classmethod
    def of(
        cls, joint_names: Sequence[str], given: Given, effort_rms: Array, rate_hz: float
    ) -> ExpectedNoise:
        """Return what is given, or what is assumed.

        Parameters
        ----------
        joint_names : sequence of str
            The n joints.
        given : ExpectedNoise, float, sequence or mapping, optional
            Numbers are standard deviations of white noise, N·m: one for all joints, one each, or
            by the joint's name. By default `assumed`.
        effort_rms : ndarray, shape (n,)
            Rms efforts of the motion, N·m.
        rate_hz : float
            Rate of the samples that numbers refer to, Hz.

        Raises
        ------
        DataError
            When numbers or names do not fit.
        """
        if isinstance(given, ExpectedNoise):
            return given
        if given is None:
            return cls.assumed(effort_rms)
        n = len(joint_names)
        if isinstance(given, Mapping):
            unknown = [str(name) for name in given if name not in joint_names]
            missing = [name for name in joint_names if name not in given]
            if unknown or missing:
                raise DataError(
                    f"noise: names {', '.join(unknown) or 'no joint'} wrongly and leaves out "
                    f"{', '.join(missing) or 'none'}; give one number for each of "
                    f"{', '.join(joint_names)}."
                )
            given = [float(given[name]) for name in joint_names]
        values = np.atleast_1d(np.asarray(given, dtype=np.float64))
        if values.shape not in ((1,), (n,)):
            raise DataError(f"noise: has shape {values.shape}; give one number or {n}, in N·m.")
        return cls.white(np.broadcast_to(values, (n,)), rate_hz)

    def filtered_variance(self, bandwidth_hz: float) -> Array:
        """Return the variance (n,) behind a filter, (N·m)².

        Parameters
        ----------
        bandwidth_hz : float
            Integral of its squared gain over negative and positive frequencies, Hz.
        """
        return np.minimum(self.deviation**2, self.density * bandwidth_hz)
