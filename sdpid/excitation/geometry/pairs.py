"""Which pairs of bodies are checked, which are left out and why, and a rest position that is free.

Positions drawn within the limits show how near the bodies of a pair come to each other. What is
decided by them alone is said with their number.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations, compress
from typing import NamedTuple

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask, generator
from sdpid.errors import ModelError
from sdpid.excitation.geometry.measure import Measure, way
from sdpid.excitation.geometry.solids import Solid
from sdpid.robot.model.model import RobotModel

# Positions that are drawn: at most and at least, and in all this many distances.
_MOST, _LEAST, _DISTANCES = 500, 100, 400_000

# Bodies touch where they are nearer than this, m: far above the accuracy of distances.
_TOUCH = 1e-4

# A distance that varies by less over the drawn positions cannot be changed, m: of a link that turns
# on the spot above a table, and of links that no joint moves against each other.
_CONSTANT, _FIXED = 1e-3, 1e-5

# Bodies that overlap at this share of the drawn positions do so by the coarseness of their
# shapes; half of the positions are enough where at most two joints lie between them.
_ALWAYS, _OFTEN, _CLOSE_BY = 0.95, 0.5, 2

# Half of a usual distance beyond this is more than most clearances, m.
_CLOSE = 0.1

# Pairs that stay farther apart than this at all drawn positions are left to the final check: m,
# and a multiple of the clearance.
_NEAR, _NEAR_SHARE = 0.1, 3.0

# What a rest position that is looked for keeps from everything, at the least, m, unless a pair is
# always nearer, and its share beyond the clearance: the motion needs room to begin.
_REST_GAP, _REST_ROOM = 0.02, 1.5


# A clearance can be kept by bodies that come apart by this many times as much.
_HOLDABLE = 1.25


@dataclass(frozen=True, kw_only=True)
class Pair:
    """Two bodies that must not touch.

    Attributes
    ----------
    first, second : str
        Links, or the base, or an obstacle (always the second).
    searched : bool
        Whether they came near each other at any of the drawn positions: a search for a motion
        watches these, a check of a motion all.
    nearest, usual, farthest : float
        Least, middle and largest signed distance at the drawn positions, m; the latter two within
        the description's limits where the pair is often close.
    obstacle : bool
        Whether the second is an obstacle.
    """

    first: str
    second: str
    searched: bool = True
    nearest: float = 0.0
    usual: float = np.inf
    farthest: float = np.inf
    obstacle: bool = False

    def clearance(self, wanted: float) -> float:
        """Return the distance that is asked of the pair: less than wanted if never so far apart.

        Links that are built close to each other, or mounted close to an obstacle, could not move
        and keep a large clearance. Where the largest distance is little more than wanted, half of
        the usual one is asked of links, half of the largest of a link and an obstacle.
        """
        if self.farthest >= _HOLDABLE * wanted:
            return wanted
        return min(wanted, max(0.5 * (self.farthest if self.obstacle else self.usual), 0.0))


class Choice(NamedTuple):
    """Pairs that are checked, those left out with reasons, the rest position (n,), and notes."""

    pairs: tuple[Pair, ...]
    left_out: tuple[tuple[str, str, str], ...]
    rest: Array
    notes: tuple[str, ...]


class PairChooser:
    """Chooses the pairs to be checked.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    solids, obstacles : sequence of Solid
        Solids of the robot and of obstacles.
    ignore : iterable of (str, str)
        Names of bodies whose pairs are left out.
    clearance : float
        Least distance at rest, m.

    Raises
    ------
    ModelError
        When a name to ignore does not exist.
    """

    def __init__(
        self,
        robot: RobotModel,
        solids: Sequence[Solid],
        obstacles: Sequence[Solid],
        ignore: Iterable[tuple[str, str]],
        clearance: float,
    ) -> None:
        self._robot, self._clearance = robot, clearance
        self._gap = max(_REST_GAP, _REST_ROOM * clearance)
        self._joint = {solid.body: solid.joint for solid in solids}
        self._obstacles = dict.fromkeys(solid.body for solid in obstacles)
        self._left_out: list[tuple[str, str, str]] = []
        self._candidates: list[tuple[str, str]] = []
        ignored, bodies = {frozenset(pair) for pair in ignore}, (*self._joint, *self._obstacles)
        for name in sorted(frozenset().union(*ignored)):
            if name not in bodies:
                raise ModelError(
                    f"ignore: '{name}' is no body of '{robot.name}' with a shape and no obstacle; "
                    f"there are {', '.join(bodies)}."
                )
        among = combinations(self._joint, 2)
        for pair in (*among, *((link, each) for each in self._obstacles for link in self._joint)):
            reason = self._plain_reason(*pair)
            if frozenset(pair) in ignored:
                reason = "left out as asked for"
            if reason:
                self._left_out.append((*pair, reason))
            else:
                self._candidates.append(pair)
        self._solids = [*solids, *obstacles]
        self._measure = Measure(robot, self._solids, self._candidates)

    def _between(self, first: str, second: str) -> list[int]:
        """Return the joints between two bodies."""
        ends = self._joint[first], self._joint.get(second, 0)
        return [joint for part in way(self._robot.pin_model, *ends) for joint in part]

    def _plain_reason(self, first: str, second: str) -> str:
        """Return why a pair need not be measured, or nothing."""
        if second in self._obstacles:
            return "" if self._joint[first] else "the base stands still"
        ends = (self._joint[first], self._joint[second])
        shaped = set(self._joint.values())
        for joint, other in (ends, ends[::-1]):
            while joint:
                joint = self._robot.pin_model.parents[joint]
                if joint == other:
                    return "neighbors: joined by a joint"
                if joint in shaped:
                    break
        return ""

    def choose(
        self,
        lower: Array,
        upper: Array,
        *,
        rest: Array | None,
        near: Array,
        free_rest: bool,
        seed: int,
    ) -> Choice:
        """Choose by positions drawn within limits, and by a rest position.

        Parameters
        ----------
        lower, upper : ndarray, shape (n,)
            Finite limits within which positions are drawn.
        rest : ndarray, shape (n,), or None
            Where the motion begins; None looks for a position that is free.
        near : ndarray, shape (n,)
            The rest position if it is free, else the one that is found differs from it in few
            joints.
        free_rest : bool
            Whether the rest position must be free; if not, `near` is taken as it is.
        seed : int
            Of the drawn positions.

        Raises
        ------
        ModelError
            When a given rest position is not free, or none is found.
        """
        count = int(np.clip(_DISTANCES // max(len(self._candidates), 1), _LEAST, _MOST))
        drawn = generator(seed).uniform(lower, upper, (count, self._robot.n))
        start = near if rest is None else rest
        found = self._measure.distances(np.vstack([start, drawn]))
        judged = self._judged(found[1:], lower, upper, seed)
        pairs, kept = [], []
        for p, (first, second) in enumerate(self._candidates):
            reason = self._reason(first, second, found[0, p], judged[:, p], rest is not None)
            if reason:
                self._left_out.append((first, second, reason))
                continue
            kept.append(p)
            nearest = float(found[:, p].min())
            pairs.append(
                Pair(
                    first=first,
                    second=second,
                    searched=nearest < max(_NEAR, _NEAR_SHARE * self._clearance),
                    nearest=nearest,
                    usual=float(np.median(judged[:, p])),
                    farthest=float(judged[:, p].max()),
                    obstacle=second in self._obstacles,
                )
            )
        gaps = np.array([pair.clearance(self._gap) for pair in pairs])
        columns, notes = np.array(kept, dtype=int), []
        at_start = found[0, columns]
        if rest is not None:
            self._check_rest(pairs, at_start)
        elif free_rest and np.any(at_start < gaps):
            start = self._free(near, drawn, columns, gaps, pairs)
            notes.append(self._moved(near, start, pairs, at_start < gaps))
        return Choice(tuple(pairs), tuple(self._left_out), start, tuple(notes))

    def _judged(self, distances: Array, lower: Array, upper: Array, seed: int) -> Array:
        """Return the distances that tell which pairs are always close, (count, candidates).

        Within narrow limits bodies may be close all the time for they do collide there. So those
        that often are close are judged by positions within the limits of the description.
        """
        often = np.median(distances, axis=0) < max(_CLOSE, 2.0 * self._clearance)
        described = self._robot.position_limits.T
        bounds = np.where(np.isfinite(described), described, [[-np.pi], [np.pi]])
        low, high = np.minimum(bounds[0], lower), np.maximum(bounds[1], upper)
        if not often.any() or (np.array_equal(low, lower) and np.array_equal(high, upper)):
            return distances
        drawn = generator(seed).uniform(low, high, (len(distances), self._robot.n))
        which = np.flatnonzero(often)
        measure = Measure(self._robot, self._solids, [self._candidates[p] for p in which])
        judged = distances.copy()
        judged[:, which] = measure.distances(drawn)
        return judged

    def _reason(self, first: str, second: str, at_rest: float, drawn: Array, given: bool) -> str:
        """Return why a pair is left out, judged by its distances, or nothing."""
        count, touching = len(drawn), int(np.count_nonzero(drawn < _TOUCH))
        obstacle = second in self._obstacles
        if np.ptp(drawn) < (_CONSTANT if obstacle else _FIXED):
            how = f"overlap by {-1e3 * at_rest:.0f} mm"
            if at_rest > 0.0:
                how = f"are {1e3 * at_rest:.0f} mm apart"
            return f"they {how} at every one of {count} drawn positions: no motion changes it"
        joints = 0 if obstacle else len(self._between(first, second))
        close = 0 < joints <= _CLOSE_BY
        if joints and touching >= (_OFTEN if close else _ALWAYS) * count:
            return (
                f"their shapes overlap at {touching} of {count} drawn positions, with "
                f"{joints} joints between them"
            )
        if close and given and at_rest < _TOUCH:
            return (
                f"they touch at the given rest position ({-1e3 * at_rest:.1f} mm deep), with "
                f"{joints} joints between them"
            )
        return ""

    def _check_rest(self, pairs: Sequence[Pair], distances: Array) -> None:
        asked = [max(pair.clearance(self._clearance), _TOUCH) for pair in pairs]
        close = [
            f"{pair.first} and {pair.second} "
            + (
                f"overlap by {-1e3 * d:.1f}"
                if d < 0
                else f"are {1e3 * d:.1f} apart ({1e3 * a:.1f})"
            )
            for pair, d, a in zip(pairs, distances, asked, strict=True)
            if d < a
        ]
        if close:
            raise ModelError(
                f"'{self._robot.name}': bodies touch or are nearer than the clearance at the rest "
                f"position, in mm: {'; '.join(close)}. Give another rest position, or move "
                "the obstacle."
            )

    def _free(
        self, near: Array, drawn: Array, columns: Indices, gaps: Array, pairs: Sequence[Pair]
    ) -> Array:
        """Return a position without contact that differs from `near` in few joints.

        Joints between bodies that are too close take drawn values; of the positions that come
        closest to being free the search goes on.
        """
        joints = self._robot.pin_model.joints
        # The coordinates that move each pair's bodies against each other.
        ways = ([joints[i].idx_v for i in self._between(x.first, x.second)] for x in pairs)
        movers = np.array([self._robot.expansion[rows].any(axis=0) for rows in ways])
        span = np.maximum(np.ptp(drawn, axis=0), np.finfo(float).tiny)
        found, lack = near, np.inf
        while True:
            short = gaps - self._measure.distances(found[None])[0, columns]
            moved = movers[short > 0.0].any(axis=0)
            trials = np.where(moved, drawn, found)
            shorts = np.maximum(gaps - self._measure.distances(trials)[:, columns], 0.0).sum(axis=1)
            if shorts.min() == 0.0:
                break
            if shorts.min() >= lack:
                worst = pairs[int(np.argmax(short))]
                raise ModelError(
                    f"'{self._robot.name}': no position was found at which every pair is "
                    f"{1e3 * self._gap:.0f} mm apart; at the best {worst.first} and "
                    f"{worst.second} lack {1e3 * short.max():.1f} mm. Give a rest position, or "
                    "move the obstacles."
                )
            found, lack = trials[np.argmin(shorts)], shorts.min()
        free = trials[shorts == 0.0]
        found = free[np.argmin(np.abs((free - near) / span).sum(axis=1))]
        # Joint by joint, the largest change first, back to the usual position if that is free;
        # twice, for what was in the way of one joint may be gone by then.
        changed = [j for j in np.argsort(-np.abs((found - near) / span)) if found[j] != near[j]]
        for joint in 2 * changed:
            trial = np.where(np.arange(len(near)) == joint, near, found)
            if (self._measure.distances(trial[None])[0, columns] >= gaps).all():
                found = trial
        return np.asarray(found)

    def _moved(self, near: Array, rest: Array, pairs: Sequence[Pair], short: Mask) -> str:
        """Return a sentence about the pairs that are too near at `near`, and the rest position."""
        close = (f"{pair.first} and {pair.second}" for pair in compress(pairs, short))
        moved = ", ".join(
            f"{self._robot.joint_names[j]} to {rest[j]:.2f}" for j in np.flatnonzero(rest != near)
        )
        return (
            f"At the usual rest position these touch or are less than {1e3 * self._gap:.0f} mm "
            f"apart: {'; '.join(close)}. The rest position is moved: {moved} (rad or m)."
        )
