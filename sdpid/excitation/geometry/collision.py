"""`CollisionModel`: distances of a robot's links to each other and to obstacles, with bounds."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, Indices, frozen, real_array, shaped
from sdpid.errors import DataError, ModelError
from sdpid.excitation.geometry.measure import Measure, pair_reaches
from sdpid.excitation.geometry.obstacles import Mesh, Obstacle, named_apart
from sdpid.excitation.geometry.pairs import Pair, PairChooser
from sdpid.excitation.geometry.solids import Solid, body_name, obstacle_solid, robot_solids
from sdpid.robot.model.model import RobotModel

# Slack beyond which the search need not know how far away everything is, m.
_HORIZON = 0.2

# Pairs that at most this many joints move are tried to be proven apart, by at most so many
# distances, and by at least this distance, m: most clearances are less.
_PROOF_JOINTS, _PROOF_MOST, _PROOF_LEAST = 3, 6000, 0.05

# Joints without limits are drawn this far to either side, rad or m; it proves nothing.
_FAR = np.pi


@dataclass(frozen=True, kw_only=True, eq=False)
class CollisionModel:
    """Pairs of bodies of a robot and its surroundings, and the distances between them.

    Attributes
    ----------
    robot : RobotModel
        The robot.
    obstacles : tuple of Plane, Box, Mesh
        Obstacles, with names that differ.
    solids : tuple of Solid
        Shapes of the links and obstacles.
    pairs : tuple of Pair
        The P pairs that are checked.
    left_out : tuple of (str, str, str)
        Pairs that are not, and why.
    assumed : tuple of str
        What stands for what the description lacks, and other assumptions: sentences.
    rest : ndarray, shape (n,)
        A position at which nothing touches.
    reach : ndarray, shape (P, n)
        Bounds on the rates of the distances: at every position within the limits of sliding
        joints, ``|d distance_p/dt| ≤ Σ_j reach[p, j]·|velocity_j|``, in m/rad or m/m.
    largest_clearance : float
        The most that may be asked, m: pairs that are proven to keep it are left out.
    accuracy : float
        How far a distance may be off, m.
    """

    robot: RobotModel
    obstacles: tuple[Obstacle, ...]
    solids: tuple[Solid, ...]
    pairs: tuple[Pair, ...]
    left_out: tuple[tuple[str, str, str], ...]
    assumed: tuple[str, ...]
    rest: Array
    reach: Array
    largest_clearance: float

    # Coal stops where a distance is known to 1e-6 m; ten times that covers what was measured.
    accuracy: ClassVar[float] = 1e-5

    @classmethod
    def of(
        cls,
        robot: RobotModel,
        obstacles: Iterable[Obstacle] = (),
        *,
        package_dirs: Iterable[str | os.PathLike[str]] = (),
        rest: ArrayLike | None = None,
        near: ArrayLike | None = None,
        lower: ArrayLike | None = None,
        upper: ArrayLike | None = None,
        free_rest: bool = True,
        clearance: float = 0.0,
        ignore: Iterable[tuple[str, str]] = (),
        radius: float | None = None,
        seed: int = 0,
    ) -> CollisionModel:
        """Choose what is checked, and say what is not.

        Parameters
        ----------
        robot : RobotModel
            The robot, on a fixed base.
        obstacles : iterable of Plane, Box, Mesh
            In the base frame. The base itself is not checked against them.
        package_dirs : iterable of paths, optional
            Folders in which the description's meshes are looked up.
        rest : array_like, shape (n,), optional
            Where motions begin; must be free. By default `near` if that is free, else a position
            that is, differing from it in few joints.
        near : array_like, shape (n,), optional
            By default zero where that is within the limits, else their middle.
        lower, upper : array_like, shape (n,), optional
            Limits of the joints, by default those of the description.
        free_rest : bool, optional
            Whether the rest position must be free: False takes `near` as it is, for motions that
            are there already.
        clearance : float, optional
            Distance that motions will keep, m: the rest position keeps it, too.
        ignore : iterable of (str, str), optional
            Names of bodies whose pairs are not checked.
        radius : float, optional
            Radius of links whose shape is not known, m.
        seed : int, optional
            Of the positions that are drawn to see which pairs come near each other.

        Raises
        ------
        ModelError
            When the base floats, an obstacle contains the base or the arm at rest, a mesh cannot
            be read, or the rest position is not free.
        DataError
            When an argument has another shape or is not understood.
        """
        if robot.free_flyer:
            raise ModelError(f"'{robot.name}': distances need a fixed base, this one floats.")
        solids, assumed = robot_solids(robot, package_dirs=package_dirs, radius=radius)
        placed = named_apart(obstacles, {solid.body for solid in solids})
        bounds = _bounds(robot, lower, upper)
        finite = np.where(np.isfinite(bounds), bounds, [[-_FAR], [_FAR]])
        usual = np.where((finite[0] < 0.0) & (finite[1] > 0.0), 0.0, finite.mean(axis=0))
        _check_base(robot, placed)
        around = [obstacle_solid(obstacle) for obstacle in placed]
        choice = PairChooser(robot, solids, around, ignore, clearance).choose(
            *finite,
            rest=None if rest is None else _numbers(robot, rest, "rest"),
            near=usual if near is None else _numbers(robot, near, "near"),
            free_rest=free_rest,
            seed=seed,
        )
        every = (*solids, *around)
        named = [(pair.first, pair.second) for pair in choice.pairs]
        found = cls(
            robot=robot,
            obstacles=placed,
            solids=every,
            pairs=choice.pairs,
            left_out=choice.left_out,
            assumed=(*assumed, *choice.notes),
            rest=frozen(choice.rest),
            reach=frozen(pair_reaches(robot, every, named, bounds)),
            largest_clearance=max(clearance, _PROOF_LEAST),
        )
        found._check_surrounded()
        return found._without_proven(*bounds)

    @cached_property
    def _measure(self) -> Measure:
        return Measure(self.robot, self.solids, [(pair.first, pair.second) for pair in self.pairs])

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without Coal's objects, which cannot be pickled."""
        made = ("_measure", "searched")
        return {key: value for key, value in vars(self).items() if key not in made}

    def distances(self, q: ArrayLike) -> Array:
        """Return the signed distance of each pair, m: negative by the depth where they overlap.

        Accurate to `accuracy`. Within a mesh that is no hull the distance is to its surface.

        Parameters
        ----------
        q : array_like, shape (K, n)
            Joint positions.

        Returns
        -------
        ndarray, shape (K, P)
        """
        return self._measure.distances(real_array(q, "q", ndim=2))

    def clearances(self, clearance: float, beyond: float = 0.0) -> Array:
        """Return the distance that is asked of each pair (P,) for a wanted clearance, m.

        Pairs that are built close to each other are asked for less than the clearance, and for as
        small a share of what is wanted `beyond` it.

        Raises
        ------
        DataError
            When it is larger than `largest_clearance`.
        """
        if clearance > self.largest_clearance:
            raise DataError(
                f"clearance: {clearance} m, the pairs were chosen for at most "
                f"{self.largest_clearance} m; make the model with clearance={clearance}."
            )
        asked = np.array([pair.clearance(clearance) for pair in self.pairs])
        return asked + beyond * (asked / clearance if clearance > 0.0 else 1.0)

    def closer(self, clearance: float) -> tuple[str, ...]:
        """Return a sentence a pair that is asked for less than a wanted clearance (m), and why."""
        return tuple(
            f"{pair.first} and {pair.second} are usually {1e3 * pair.usual:.0f} mm apart, at most "
            f"{1e3 * pair.farthest:.0f}: "
            f"{1e3 * asked:.0f} mm are asked of them, not {1e3 * clearance:.0f}."
            for pair, asked in zip(self.pairs, self.clearances(clearance), strict=True)
            if asked < clearance
        )

    def soft_minimum(
        self,
        q: ArrayLike,
        sharpness: float,
        *,
        clearance: float = 0.0,
        beyond: float = 0.0,
        horizon: float = _HORIZON,
    ) -> tuple[Array, Array]:
        """Return a smooth lower bound of the least slack of all pairs, and its gradient.

        ``−log(exp(−s·horizon) + Σ exp(−s·slack))/s`` over all pairs of solids, with s the sharpness
        and each pair's distance less its clearance. Below the least slack, or the horizon where
        that is less, by at most ``log(1 + number of pairs of solids)/s``. Pairs that are too far
        away to matter by 1e-6 are not measured.

        Parameters
        ----------
        q : array_like, shape (K, n)
            Joint positions.
        sharpness : float
            1/m.
        clearance, beyond : float, optional
            The wanted clearance and what is wanted beyond it, m; see `clearances`.
        horizon : float, optional
            Slack beyond which distances make no difference, m.

        Returns
        -------
        values : ndarray, shape (K,)
            m.
        gradients : ndarray, shape (K, n)
        """
        positions = real_array(q, "q", ndim=2)
        asked = self.clearances(clearance, beyond)
        return self._measure.soft_minimum(positions, sharpness, asked, self.reach, horizon)

    def only(self, which: Sequence[int] | Indices | Array) -> CollisionModel:
        """Return the same with only some pairs, by their indices or by P booleans."""
        kept = np.arange(len(self.pairs))[np.asarray(which, dtype=None if len(which) else int)]
        return replace(
            self, pairs=tuple(self.pairs[p] for p in kept), reach=frozen(self.reach[kept])
        )

    @cached_property
    def searched(self) -> CollisionModel:
        """The same with only the pairs that came near each other at a drawn position."""
        return self.only(np.array([pair.searched for pair in self.pairs], dtype=bool))

    def _without_proven(self, lower: Array, upper: Array) -> CollisionModel:
        """Return the same without the pairs that are never near within the limits."""
        # Whole turns repeat what one has shown; of what slides without an end nothing is proven.
        whole = np.count_nonzero(self.robot.expansion, axis=0) == 1
        turning = whole & ~self.robot.slides
        lower = np.where(turning & ~np.isfinite(lower), -np.pi, lower)
        upper = np.where(turning, np.minimum(upper, lower + 2.0 * np.pi), upper)
        kept, left_out = [], list(self.left_out)
        for p, pair in enumerate(self.pairs):
            asked = pair.clearance(self.largest_clearance)
            joints = np.count_nonzero((self.reach[p] > 0.0) & (upper > lower))
            count = None
            if joints <= _PROOF_JOINTS and pair.nearest > asked:
                distance, reach = self.only([p])._least, self.reach[p]
                count = proven_apart(distance, reach, lower, upper, asked, most=_PROOF_MOST)
            if count is None:
                kept.append(p)
            else:
                how = f"never nearer than {1e3 * asked:.0f} mm, proven by {count} distance"
                left_out.append((pair.first, pair.second, how + "s" * (count > 1)))
        return replace(self.only(kept), left_out=tuple(left_out))

    def _check_surrounded(self) -> None:
        """Refuse links at rest inside a mesh that is no hull: distances to its surface are > 0."""
        from sdpid.robot.model.geometry import link_placements

        placements = link_placements(self.robot, self.rest)
        moving = [solid for solid in self.solids if solid.joint]
        for surface in (solid.shape for solid in self.solids if isinstance(solid.shape, Mesh)):
            for solid in moving:
                place = placements[solid.joint - 1]
                middle = place[:3, :3] @ solid.core[0].mean(axis=0) + place[:3, 3]
                if surface.contains(middle[None])[0]:
                    raise ModelError(
                        f"obstacle '{surface.name}' surrounds '{solid.body}' at the rest "
                        "position; move it, or give another rest position."
                    )

    def _least(self, q: Array) -> Array:
        """Return the least distances (K,), less by their error."""
        return np.asarray(self.distances(q).min(axis=1) - self.accuracy)


def _bounds(robot: RobotModel, lower: ArrayLike | None, upper: ArrayLike | None) -> Array:
    """Return the lower and upper limits, (2, n), infinite where there are none."""
    bounds = robot.position_limits.T.copy()
    for row, values in enumerate((lower, upper)):
        if values is not None:
            bounds[row] = _numbers(robot, values, "limits of positions", infinite=True)
    return bounds


def _numbers(robot: RobotModel, values: ArrayLike, name: str, *, infinite: bool = False) -> Array:
    """Return one number a joint (n,)."""
    what = f": one number a joint of '{robot.name}'"
    return shaped(values, name, (robot.n,), what, infinite=infinite)


def _check_base(robot: RobotModel, obstacles: Iterable[Obstacle]) -> None:
    """Refuse obstacles that contain the origin of the base and those of its first joints."""
    model = robot.pin_model
    origins = [np.zeros(3)] + [
        np.array(model.jointPlacements[i].translation)
        for i in range(1, model.njoints)
        if model.parents[i] == 0
    ]
    for obstacle in obstacles:
        if obstacle.contains(np.array(origins)).all():
            raise ModelError(
                f"obstacle '{obstacle.name}' contains the base '{body_name(robot, 0)}': the origin "
                "of its frame and the first joint lie inside; move the obstacle."
            )


def proven_apart(
    distance: Callable[[Array], Array],
    reach: Array,
    lower: Array,
    upper: Array,
    wanted: float,
    *,
    most: int,
) -> int | None:
    """Return how many distances prove that two bodies' distance is never below a wanted one.

    The box of positions is cut in half, where the joint moves the bodies most, until the distance
    in the middle of every part exceeds the wanted one by what the reach allows within the part.

    Parameters
    ----------
    distance : callable
        Distances (K,) at positions (K, n), m; less than they are by their error.
    reach : ndarray, shape (n,)
        Bounds on the derivatives of the distance, m/rad or m/m.
    lower, upper : ndarray, shape (n,)
        Limits of the positions.
    wanted : float
        m.
    most : int
        Give up after this many distances.

    Returns
    -------
    int or None
        None where it is not so, or not found to be so.
    """
    moved = (reach > 0.0) & (upper > lower)
    if not np.isfinite([reach[moved], lower[moved], upper[moved]]).all():
        return None
    still = np.where(np.isfinite(lower), lower, 0.0)
    lower, upper = (np.where(moved, bound, still) for bound in (lower, upper))
    middle, half = 0.5 * (lower + upper)[None], 0.5 * (upper - lower)[None]
    count = 0
    while len(middle):
        count += len(middle)
        if count > most:
            return None
        slack = distance(middle) - wanted
        if (slack < 0.0).any():
            return None
        open_ = slack < half @ np.where(moved, reach, 0.0)
        middle, half = middle[open_], half[open_].copy()
        if not len(middle):
            break
        rows, joint = np.arange(len(middle)), np.argmax(half * reach, axis=1)
        half[rows, joint] *= 0.5
        step = np.zeros_like(half)
        step[rows, joint] = half[rows, joint]
        middle, half = np.concatenate([middle - step, middle + step]), np.tile(half, (2, 1))
    return count
