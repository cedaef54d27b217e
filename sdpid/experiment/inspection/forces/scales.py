"""Scale and offset of measured forces, and what moments refer to, by the torques of their leg."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.experiment.inspection.forces.free_legs import FreeLeg, FreeLegs
from sdpid.robot.inertia import skew

# A contact point may be off by this much (m), the radius of a foot; the point that moments of soles
# were said to be about by more.
_POINT, _ABOUT = 0.02, 0.3
# Scales are free within this, offsets within this share of what was measured at most.
_SCALE, _OFFSET = 10.0, 0.3
# A foot that is up for fewer samples shows no offset in the air.
_LEAST_UP = 20


@dataclass(frozen=True, kw_only=True, eq=False)
class MomentScale:
    """What the torques of a leg say of the moments at its sole.

    Attributes
    ----------
    ratio, error : float
        Measured moments over those that the torques show, and the standard error.
    point, point_errors : ndarray, shape (3,)
        The point that moments are about, from that which they are said to be about, in the
        world's axes, and standard errors, m.
    """

    ratio: float
    error: float
    point: Array
    point_errors: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class FootScale:
    """What the torques of a leg say of the forces, or the wrench, at its foot.

    Attributes
    ----------
    ratio, error : float
        Measured forces over those that the torques show, and the standard error.
    offset, offset_errors : ndarray, shape (3,)
        Forces that are measured where there are none, and standard errors, N.
    in_air : ndarray, shape (3,), or None
        The mean of what is measured while the foot is up; None where it is hardly ever.
    moments : MomentScale or None
        None of points.
    """

    ratio: float
    error: float
    offset: Array
    offset_errors: Array
    in_air: Array | None
    moments: MomentScale | None


def foot_scales(legs: FreeLegs, wrenches: Array) -> list[FootScale]:
    """Return the scales of wrenches (K, c, 6) on the robot, in the world's axes."""
    found = []
    for foot, leg in enumerate(legs.legs):
        flat = legs.contacts.kind[foot] != "point"
        up = ~legs.contacts.down[:, foot]
        found.append(_scale(leg, wrenches[:, foot], up, flat=flat))
    return found


def _scale(leg: FreeLeg, wrenches: Array, up: Mask, *, flat: bool) -> FootScale:
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
    about = None
    if flat:
        of_moments = float(values[7])
        about = MomentScale(
            ratio=1.0 / of_moments,
            error=float(errors[7]) / of_moments**2,
            point=values[4:7] / gain,
            point_errors=errors[4:7] / abs(gain),
        )
    return FootScale(
        ratio=1.0 / gain,
        error=float(errors[0]) / gain**2,
        offset=-values[1:4] / gain,
        offset_errors=errors[1:4] / abs(gain),
        in_air=forces[up].mean(axis=0) if np.count_nonzero(up) >= _LEAST_UP else None,
        moments=about,
    )


def common_scale(scales: list[FootScale]) -> tuple[float, float]:
    """Return the weighted mean of the feet's ratios, and its standard error.

    It is no smaller than the ratios' spread says.
    """
    ratios = np.array([each.ratio for each in scales])
    weights = np.array([each.error for each in scales]) ** -2.0
    mean = float(weights @ ratios / weights.sum())
    spread = float(weights @ (ratios - mean) ** 2) / max(len(scales) - 1, 1)
    return mean, float(np.sqrt(max(spread, 1.0) / weights.sum()))
