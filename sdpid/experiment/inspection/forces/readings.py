"""Which feet, axes and sign measured forces are of, by the torques of the legs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Indices, rotation_matrices
from sdpid.experiment.inspection.forces.free_legs import FreeLegs
from sdpid.robot.inertia import skew
from sdpid.robot.model.contacts.jacobians import frame_axes

# In whose axes forces may have been recorded.
_AXES = ("world", "base", "foot")
# Of 72 simulated logs right forces leave at most 0.0005 of what the legs' torques need beside their
# own links, of humanoids on soles 0.015, and no other reading leaves less; what is read wrong
# leaves ten times as much.
_LIKE, BETTER = 0.001, 3.0
# A sign is seen where its force explains so much.
_SHOWN = 0.5
# Forces are at most this many times those that torques show.
_LARGEST = 10.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Reading:
    """One way to read measured forces.

    Attributes
    ----------
    axes : str
        One of `_AXES`.
    order : tuple of int
        The column of each foot's force.
    signs : tuple of int
        1, or -1 where a foot's force is that on the ground.
    left : float
        Share that is unexplained of what the torques of all legs need beside their own links.
    """

    axes: str
    order: tuple[int, ...]
    signs: tuple[int, ...]
    left: float

    def apply(self, legs: FreeLegs) -> Array:
        """Return the legs' wrenches (K, c, 6) on the robot, in the world's axes."""
        wrenches = legs.wrenches[:, list(self.order)] * np.array(self.signs)[:, None]
        turns = _turns(legs)[self.axes]
        halves = [turns @ wrenches[..., part, None] for part in (slice(0, 3), slice(3, 6))]
        return np.concatenate(halves, axis=2)[..., 0]


def readings(legs: FreeLegs) -> tuple[Reading, Reading]:
    """Return the reading as given, but for the sign, and that which fits best.

    Another order, and then other axes, count where they leave a third of what is left without.
    """
    from scipy.optimize import linear_sum_assignment

    compared = {axes: _compared(legs, turns) for axes, turns in _turns(legs).items()}
    feet = np.arange(len(legs.legs))
    given = _reading("world", feet, *compared["world"])
    ordered, *turned = (
        _reading(axes, linear_sum_assignment(needs[:, None] * left)[1], left, gains, needs)
        for axes, (left, gains, needs) in compared.items()
    )
    best = given
    for other in (ordered, min(turned, key=lambda reading: reading.left)):
        if best.left > _LIKE and best.left > BETTER * other.left:
            best = other
    return given, best


def _reading(axes: str, order: Indices, left: Array, gains: Array, needs: Array) -> Reading:
    feet = np.arange(len(order))
    return Reading(
        axes=axes,
        order=tuple(int(i) for i in order),
        signs=tuple(np.where((gains < 0.0) & (left < _SHOWN), -1, 1)[feet, order].tolist()),
        # A leg that needs no force, as of a foot that never lands, says nothing.
        left=float(np.average(left[feet, order], weights=needs)),
    )


def _turns(legs: FreeLegs) -> dict[str, Array]:
    """Return the rotations (K, c, 3, 3) that bring forces into the world's axes."""
    feet = frame_axes(legs.robot, legs.position, legs.frames)
    base = rotation_matrices(legs.position[:, 3:7])[:, None]
    each = (np.eye(3), base, feet)
    return {name: np.broadcast_to(turn, feet.shape) for name, turn in zip(_AXES, each, strict=True)}


def _compared(legs: FreeLegs, turns: Array) -> tuple[Array, Array, Array]:
    """Return what each foot's torques leave with each column's force, and its scale, (c, c).

    What they leave is a share of what they need without any, the last, (c,).
    """
    c = len(legs.legs)
    left, gains, needs = np.ones((c, c)), np.ones((c, c)), np.ones(c)
    for foot, leg in enumerate(legs.legs):
        forces, moments = (
            turns[:, foot] @ np.swapaxes(legs.wrenches[:, :, part], 1, 2)
            for part in (slice(0, 3), slice(3, 6))
        )
        columns = [leg.by_forces(forces)]
        if legs.flat[foot]:
            # Moments may be of another scale, or about another point: that is asked later.
            columns += [leg.by_moments(moments)]
            columns += [leg.by_moments(turn @ forces) for turn in skew(np.eye(3))]
        sums = leg.sums(np.concatenate(columns, axis=2), np.full(c * len(columns), _LARGEST))
        own = range(leg.own.shape[2])
        needs[foot] = max(sums.fit(own).left ** 2, 1e-300)
        for column in range(c):
            fit = sums.fit([*own, *range(len(own) + column, len(sums.scale), c)])
            left[foot, column] = fit.left**2 / needs[foot]
            gains[foot, column] = fit.values[len(own)]
    return left, gains, needs
