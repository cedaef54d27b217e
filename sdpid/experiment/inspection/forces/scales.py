"""Scale and offset of measured forces, and what moments refer to, by the torques of their leg."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.inspection.forces.free_legs import FreeLeg, FreeLegs
from sdpid.robot.inertia import skew

# A contact point may be off by this much (m), the radius of a foot; the point that moments of soles
# were said to be about by more.
_POINT, _ABOUT = 0.02, 0.3
# Scales are free within this, offsets within this share of what was measured at most.
_SCALE, _OFFSET = 10.0, 0.3


@dataclass(frozen=True, kw_only=True, eq=False)
class Scale:
    """What the torques of a leg say of the forces at its foot, or of the moments at its sole.

    Attributes
    ----------
    ratio, error : float
        Measured values over those that the torques show, and the standard error.
    shift, shift_errors : ndarray, shape (3,)
        Of forces what is measured where there are none, N; of moments the point that they are
        about, from that which they are said to be about, in the world's axes, m. And standard
        errors.
    """

    ratio: float
    error: float
    shift: Array
    shift_errors: Array


def foot_scales(legs: FreeLegs, wrenches: Array) -> tuple[list[Scale], list[Scale | None]]:
    """Return the scales of forces, and of moments at soles, of wrenches (K, c, 6) on the robot.

    All are in the world's axes.
    """
    each = zip(legs.legs, legs.flat, strict=True)
    found = [_scales(leg, wrenches[:, foot], flat) for foot, (leg, flat) in enumerate(each)]
    return [forces for forces, _ in found], [moments for _, moments in found]


def _scales(leg: FreeLeg, wrenches: Array, flat: bool) -> tuple[Scale, Scale | None]:
    """Return the scale of a foot's forces, and of its moments where there are any."""
    forces, moments = wrenches[:, :3], wrenches[:, 3:]
    ones = np.broadcast_to(np.eye(3), (len(forces), 3, 3))
    # Less the cross product with the way there, a moment is about another point.
    turned = -skew(forces)
    parts = [
        (leg.by_forces(forces[:, :, None]), _SCALE),
        (leg.by_forces(ones), _OFFSET * float(np.abs(forces).max())),
        (leg.by_moments(turned), _ABOUT if flat else _POINT),
    ]
    if flat:
        parts.append((leg.by_moments(moments[:, :, None]), _SCALE))
        parts.append((leg.by_moments(ones), _OFFSET * float(np.abs(moments).max())))
    size = np.concatenate([np.full(part.shape[2], scale) for part, scale in parts])
    fit = leg.fit(np.concatenate([part for part, _ in parts], axis=2), size)
    values, errors = (each[leg.own.shape[2] :] for each in (fit.values, fit.errors))
    # Torques show what was measured, less its offset, over its scale.
    gain = float(values[0])
    of_forces = _over(gain, errors[0], -values[1:4] / gain, errors[1:4] / abs(gain))
    if not flat:
        return of_forces, None
    point = values[4:7] / gain, errors[4:7] / abs(gain)
    return of_forces, _over(float(values[7]), errors[7], *point)


def _over(gain: float, error: float, shift: Array, shift_errors: Array) -> Scale:
    """Return the scale of what torques show so many times."""
    ratio, error = 1.0 / gain, float(error) / gain**2
    return Scale(ratio=ratio, error=error, shift=shift, shift_errors=shift_errors)


def common_scale(scales: list[Scale]) -> tuple[float, float]:
    """Return the weighted mean of the feet's ratios, and its standard error.

    It is no smaller than the ratios' spread says.
    """
    ratios = np.array([each.ratio for each in scales])
    weights = np.array([each.error for each in scales]) ** -2.0
    mean = float(weights @ ratios / weights.sum())
    spread = float(weights @ (ratios - mean) ** 2) / max(len(scales) - 1, 1)
    return mean, float(np.sqrt(max(spread, 1.0) / weights.sum()))
