"""Dry friction of a simulated leg's joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.robot.friction.terms import Coulomb, Stribeck

# The narrowest sign over its height at which steps of 1 ms integrate without chatter, rad/s: the
# slope of friction damps a rotor of the default size by 1/ms there, for a leg of 0.25 m; the
# method of Runge and Kutta bears 2.8/ms.
_NARROWEST = 0.015


@dataclass(frozen=True, kw_only=True)
class DryFriction:
    """Dry friction of joints, as a multiple of their Coulomb friction.

    The torque ``Fs·(1 + peak·exp(−(v/peak_speed)²))·tanh(v/width)``: Coulomb friction with a
    smooth sign, and a Stribeck peak [armstrong1994]_.

    Attributes
    ----------
    width : float
        Speed that makes the sign smooth, rad/s.
    peak : float
        Friction above Coulomb's at low speed, as a share of it.
    peak_speed : float
        Speed at which the peak has fallen to 1/e, rad/s.

    Raises
    ------
    DataError
        When a speed is not positive, the peak is negative, or friction is too steep to integrate.

    Examples
    --------
    >>> from sdpid.experiment.plant.legged.friction import DryFriction
    >>> law = DryFriction(width=0.05, peak=0.3, peak_speed=0.2)
    >>> law(np.array([-1.0, 0.0, 0.1, 1.0])).round(3)
    array([-1.   ,  0.   ,  1.189,  1.   ])
    >>> run = sdpid.simulate_legged("solo12", "hang", duration=0.1, friction=law)
    >>> run.friction
    DryFriction(width=0.05, peak=0.3, peak_speed=0.2)
    """

    width: float = 0.02
    peak: float = 0.0
    peak_speed: float = 0.1

    def __post_init__(self) -> None:
        for name in ("width", "peak_speed"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise DataError(f"{name}: {getattr(self, name)}; give a positive speed in rad/s.")
        if not 0.0 <= self.peak < np.inf:
            raise DataError(f"peak: {self.peak}; give a share of Coulomb friction, 0 or more.")
        if self.width < _NARROWEST * (1.0 + self.peak):
            raise DataError(
                f"width: {self.width:g} rad/s with a peak of {self.peak:g} is too steep to be "
                f"integrated; the limit is {_NARROWEST * (1.0 + self.peak):.3g} rad/s."
            )

    def __call__(self, velocity: Array) -> Array:
        """Return the friction of a joint over its Coulomb friction at velocities in rad/s."""
        peak = self.peak * np.exp(-((velocity / self.peak_speed) ** 2)) if self.peak else 0.0
        return np.asarray((1.0 + peak) * np.tanh(velocity / self.width))

    @property
    def terms(self) -> tuple[Coulomb, ...] | tuple[Coulomb, Stribeck]:
        """The friction terms of `sdpid.identify` with which an estimate can follow this law."""
        coulomb = Coulomb(width=self.width)
        if not self.peak:
            return (coulomb,)
        return coulomb, Stribeck(velocity=self.peak_speed, width=self.width)
