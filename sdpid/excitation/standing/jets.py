"""States of a stance about which something is differentiated by coordinates and their rates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.excitation.standing.stance import Poses, Stance, StanceStates

# Step of central differences by coordinates and their rates, m and rad (and s): far below the width
# of a smooth sign. Efforts are linear in accelerations: a step of any size is exact.
_STEP = 1e-5


@dataclass(frozen=True, eq=False)
class Jets:
    """States of a stance, and those beside them.

    Attributes
    ----------
    here : StanceStates
        K states.
    aside : StanceStates
        5·m·K states: coordinates ahead and behind, rates ahead and behind, accelerations ahead;
        of each the m coordinates one after the other, K states each.
    """

    here: StanceStates
    aside: StanceStates

    @classmethod
    def of(cls, stance: Stance, x: Array, rate: Array, second: Array) -> Jets:
        """Return the states of coordinates and their derivatives (K, m), and those beside them."""
        k, m = x.shape
        poses = stance.poses(x)
        steps = np.eye(m)[:, None, :]
        moved = np.concatenate([x + _STEP * steps, x - _STEP * steps]).reshape(-1, m)
        beside = stance.poses(moved, _predicted(stance, poses, moved - np.tile(x, (2 * m, 1))))
        still = poses.take(np.tile(np.arange(k), 3 * m))
        every = Poses(
            **{
                name: np.concatenate([value, getattr(still, name)])
                for name, value in vars(beside).items()
            }
        )
        rates, seconds = (np.broadcast_to(each, (m, k, m)) for each in (rate, second))
        all_rates = [rates, rates, rates + _STEP * steps, rates - _STEP * steps, rates]
        all_seconds = [seconds, seconds, seconds, seconds, seconds + steps]
        return cls(
            stance.states(poses, rate, second),
            stance.states(
                every,
                np.concatenate(all_rates).reshape(-1, m),
                np.concatenate(all_seconds).reshape(-1, m),
            ),
        )

    @staticmethod
    def slopes(here: Array, aside: Array) -> tuple[Array, Array, Array]:
        """Return derivatives (K, ..., m) of what is `here` (K, ...) by the three.

        Parameters
        ----------
        here : ndarray, shape (K, ...)
            A function of the states.
        aside : ndarray, shape (5·m·K, ...)
            The same of those beside them.
        """
        parts = aside.reshape(5, -1, *here.shape)
        ahead, behind, faster, slower, pushed = parts
        by_x, by_rate = (ahead - behind) / (2.0 * _STEP), (faster - slower) / (2.0 * _STEP)
        return (
            np.moveaxis(by_x, 0, -1),
            np.moveaxis(by_rate, 0, -1),
            np.moveaxis(pushed - here, 0, -1),
        )


def _predicted(stance: Stance, poses: Poses, moves: Array) -> Array:
    """Return configurations (s·K, nq) after small moves (s·K, m): to first order."""
    still = poses.take(np.tile(np.arange(len(poses.miss)), len(moves) // len(poses.miss)))
    change = stance.states(still, moves, np.zeros_like(moves)).velocity
    near = still.configuration.copy()
    near[:, 7:] += change[:, 6:]
    return near
