"""Simulate stretches of a recording, and measure how far they leave it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.assurance.rollouts.result import MotionErrors
from sdpid.experiment.simulation.arm import SimulatedArm
from sdpid.experiment.simulation.open_loop import Track, simulate_stretches
from sdpid.experiment.simulation.tip import tip_positions
from sdpid.robot.model.model import RobotModel


@dataclass(frozen=True, kw_only=True, eq=False)
class Runs:
    """Which simulations there are: from where, with which joints free, seen when.

    Attributes
    ----------
    robot : RobotModel
        Whose joints they are.
    first : ndarray of int, shape (S,)
        Instants of the track at which simulations start.
    groups : tuple of tuple of int
        Joints that are free together: one group of all, or one joint a group.
    after : ndarray of int, shape (L,)
        Steps after which errors are taken.
    at : ndarray of int, shape (H,)
        Which of these are horizons.
    """

    robot: RobotModel
    first: Indices
    groups: tuple[tuple[int, ...], ...]
    after: Indices
    at: Indices

    def measured(self, track: Track) -> Array:
        """Return the measured positions (S, L, n)."""
        return np.asarray(track.position[self.first[:, None] + self.after])

    def simulated(self, arm: SimulatedArm, track: Track) -> Array:
        """Return simulated positions (G, S, L, n), not numbers from where one ran away."""
        S, G, n = len(self.first), len(self.groups), self.robot.n
        free = np.zeros((G, S, n), dtype=np.bool_)
        for g, group in enumerate(self.groups):
            free[g, :, list(group)] = True
        first = np.tile(self.first, G)
        found = simulate_stretches(arm, track, first, free.reshape(G * S, n), self.after)
        return found.reshape(G, S, len(self.after), n)

    def errors(self, simulated: Array, reference: Array) -> MotionErrors:
        """Return the errors of positions (G, S, L, n) against a reference that may be fewer."""
        off = np.abs(simulated - reference)
        gone = np.asarray(~np.isfinite(off).all(axis=3))
        # A simulation that ran away is wrong in all of its joints.
        joint = np.concatenate(
            [
                np.where(gone[g, :, :, None], np.inf, off[g][:, :, list(group)])
                for g, group in enumerate(self.groups)
            ],
            axis=2,
        )
        tips = self._tips(np.broadcast_to(reference, simulated.shape))
        squares = np.sum(np.square(self._tips(simulated) - tips), axis=-1)
        squares = np.where(np.isfinite(squares), squares, np.inf)
        return MotionErrors(joint=joint, tip=np.sqrt(squares.mean(axis=0)), at=self.at)

    def _tips(self, positions: Array) -> Array:
        """Return where the tip is at the horizons, (G, S, H, 3)."""
        seen = positions[:, :, self.at]
        return tip_positions(self.robot, seen.reshape(-1, seen.shape[-1])).reshape(
            *seen.shape[:-1], 3
        )

    def idle(self, track: Track) -> Mapping[str, Array]:
        """Return the positions (G, S, L, n) of what holds its velocity, and of what rests."""
        from sdpid.assurance.rollouts.models import CONSTANT_VELOCITY, STAND_STILL

        measured = self.measured(track)
        here, speed = track.position[self.first], track.velocity[self.first]
        moved = here[:, None] + speed[:, None] * (self.after * track.step)[:, None]
        ways = {CONSTANT_VELOCITY: moved, STAND_STILL: np.broadcast_to(here[:, None], moved.shape)}
        out = {}
        for name, positions in ways.items():
            own = np.repeat(measured[None], len(self.groups), axis=0)
            for g, group in enumerate(self.groups):
                own[g][:, :, list(group)] = positions[:, :, list(group)]
            out[name] = own
        return out
