"""Motion under given efforts, of many short stretches of a recording at once.

Each stretch starts in the measured state. Joints that are not free follow the recording: their
accelerations are prescribed, and the free ones are solved for. Many stretches are simulated in one
call.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.simulation.arm import SimulatedArm
from sdpid.robot.model.model import RobotModel

# Longest step, s. Linearly implicit in friction, halving it moves no median by more than
# docs/evidence/rollouts.md says.
STEP = 0.005

# Bytes of efforts and states of stretches that are simulated together.
_BYTES = 1 << 26

# A joint this many times faster than any joint of the recording has run away: on the way there it
# has left the recorded motion by turns.
_RUNAWAY = 20.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """A processed recording on the grid of the simulation.

    Attributes
    ----------
    step : float
        Of the grid, s.
    time : ndarray, shape (T,)
        s; pieces of the recording stand one after the other.
    position, velocity : ndarray, shape (T, n)
        Measured states.
    effort : ndarray, shape (T, n)
        Measured efforts halfway to the next instant.
    piece : ndarray of int, shape (T,)
        Number of the piece that each instant belongs to.
    """

    step: float
    time: Array
    position: Array
    velocity: Array
    effort: Array
    piece: Indices

    @classmethod
    def of(cls, samples: Samples, *, step: float = STEP) -> Track:
        """Interpolate samples by cubic splines; `step` is the longest that the grid may have."""
        from scipy.interpolate import CubicSpline

        assert samples.time is not None
        spacing = float(np.median(np.diff(samples.time)))
        # Whole numbers of steps between samples, so that samples stay what they are.
        h = spacing / math.ceil(spacing / step - 1e-9)
        parts: list[tuple[Array, ...]] = []
        for number, part in enumerate(samples.parts):
            own = samples.time[part]
            if len(own) < 2:
                continue
            count = math.floor((own[-1] - own[0]) / h + 1e-6)
            time = own[0] + h * np.arange(count + 1)
            states = [CubicSpline(own, x[part])(time) for x in (samples.position, samples.velocity)]
            effort = CubicSpline(own, samples.effort[part])(time + 0.5 * h)
            parts.append((time, *states, effort, np.full(len(time), number)))
        names = ("time", "position", "velocity", "effort", "piece")
        joined = map(np.concatenate, zip(*parts, strict=True))
        return cls(step=h, **dict(zip(names, joined, strict=True)))

    def starts(self, length: float, every: float) -> Indices:
        """Return instants `every` s apart that have `length` s of their piece before them."""
        steps, stride = self.steps(length), max(1, round(every / self.step))
        found = []
        for number in np.unique(self.piece):
            own = np.flatnonzero(self.piece == number)
            found.append(own[: max(0, len(own) - steps) : stride])
        return np.concatenate(found)

    def steps(self, seconds: float) -> int:
        """Return how many steps there are in a time."""
        return max(1, round(seconds / self.step))


def simulate_stretches(
    arm: SimulatedArm, track: Track, first: Indices, free: Mask, after: Sequence[int] | Indices
) -> Array:
    """Simulate stretches of a track under its efforts.

    Parameters
    ----------
    arm : SimulatedArm
        What moves.
    track : Track
        Efforts, states to start from, and the motion of joints that are not free.
    first : ndarray of int, shape (S,)
        Instants at which stretches start.
    free : ndarray of bool, shape (S, n)
        Joints that are free; the others follow the track.
    after : sequence of int
        Steps after which positions are kept, rising.

    Returns
    -------
    ndarray, shape (S, L, n)
        Simulated positions. Divergence is no error: what ran away is NaN from then on.
    """
    wanted = np.asarray(after, dtype=np.intp)
    steps, n = int(wanted[-1]), track.position.shape[1]
    limit = _RUNAWAY * float(np.abs(track.velocity).max())
    out = np.empty((len(first), len(wanted), n))
    size = max(1, _BYTES // (40 * n * steps))
    for begin in range(0, len(first), size):
        own = slice(begin, begin + size)
        rows = first[own, None] + np.arange(steps + 1)
        loose = None if free[own].all() else free[own]
        states = np.stack([track.position[rows], track.velocity[rows]])
        states = states[:, :, :1] if loose is None else states
        position, velocity = arm.run(states, track.effort[rows[:, :-1]], track.step, free=loose)
        with np.errstate(invalid="ignore"):
            # Not a number is not below the limit either.
            lost = ~(np.abs(velocity).max(axis=2) < limit)
        lost = np.logical_or.accumulate(lost, axis=1)
        out[own] = np.where(lost[:, :, None], np.nan, position)[:, wanted]
    return out


def tip_positions(robot: RobotModel, q: Array) -> Array:
    """Return where the tip is (K, 3), m, at positions (K, n); not a number where they are not.

    The last joint has the most joints before it; of the frames that it carries the farthest is
    the tip, or else its own origin.
    """
    import pinocchio as pin

    model, data = robot.pin_model, robot.pin_model.createData()
    last = max(range(model.njoints), key=lambda i: len(model.supports[i]))
    places = [np.array(f.placement.translation) for f in model.frames if f.parentJoint == last]
    place = max([np.zeros(3), *places], key=lambda each: float(np.linalg.norm(each)))
    sound = np.asarray(np.isfinite(q).all(axis=1))
    out = np.full((len(q), 3), np.nan)
    configurations = robot.configuration(np.where(sound[:, None], q, 0.0))
    for k in np.flatnonzero(sound):
        pin.forwardKinematics(model, data, configurations[k])
        out[k] = data.oMi[last].act(place)
    return out
