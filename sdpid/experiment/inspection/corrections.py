"""Compare efforts with the description's, and find what makes them follow from the motion."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sdpid._common.arrays import Array
from sdpid.experiment.inspection.rows import Rows
from sdpid.robot.model.model import RobotModel

# A change counts where it lowers the misfit by this much: the unexplained share of a joint falls to
# a seventh. Of 22 good recordings of six arms no change lowers it by more than 0.9; the changes
# that mend a log lower it by 2.5 to 30, but for joints that carry next to nothing.
NEEDED = 2.0
# The search goes on from this many of the best changes, so that the first of two need not be best.
_KEPT = 4
# One row in so many is compared: some eighty changes are tried on every log.
_THINNED = 2
# Positions that never pass this (rad) are not tried as degrees: 3 degrees are no motion.
_LEAST_DEGREES = math.pi
# Changes whose misfits are this close cannot be told apart: as much is gained by chance.
_ALIKE = 0.9
# A joint's zero may be a quarter or half a turn away from the description's.
_QUARTERS = (0.5 * math.pi, -0.5 * math.pi, math.pi)
_MOVED = ("position", "velocity", "acceleration", "sign")
_ALL = (*_MOVED, "effort", "effort_rate")
# Efforts of real arms are this many times those of the description's bodies, friction taken away:
# 0.7 to 2.3 for the joints that carry something, of 17 recordings of six arms with and without
# loads.
GAINS = (0.3, 3.0)
# A joint shows the scale of its efforts where the description's bodies make at least this share of
# the effort they make in the joint that carries most, ...
_CARRIES = 0.05
# ... and what friction does not explain follows them with this correlation.
_FOLLOWS = 0.7
# This share of an effort stays unexplained by the description where all is well: with 0.01 the
# slightly eccentric last link of one simulated good log of 48 seemed turned by half a turn.
_FLOOR = 0.03
# The misfit of a joint that the description explains fully.
LEAST_MISFIT = float(np.log(_FLOOR))


@dataclass(frozen=True, kw_only=True, eq=False)
class Gains:
    """How many times the description's efforts the measured ones are.

    Attributes
    ----------
    gain, correlation : ndarray, shape (n,)
        Of each joint, once friction, rotor inertia and offset are taken away.
    shows : ndarray of bool, shape (n,)
        Whether the joint carries enough of the bodies for that to be known.
    """

    gain: Array
    correlation: Array
    shows: NDArray[np.bool_]

    @property
    def common(self) -> float | None:
        """The median of the gains that are known, by size; None where there is none."""
        return float(np.median(np.abs(self.gain[self.shows]))) if self.shows.any() else None


def described(robot: RobotModel | None) -> bool:
    """Return whether a robot's description has masses to compare with."""
    return robot is not None and robot.n_base == 0 and bool(np.any(robot.prior[:, 0] > 0.0))


def placeholders(robot: RobotModel) -> bool:
    """Return whether most bodies of a description are alike: made up, not measured."""
    bodies = robot.prior[robot.prior[:, 0] > 0.0]
    _, counts = np.unique(bodies[:, [0, 4, 6, 9]].round(9), axis=0, return_counts=True)
    return len(bodies) > 2 and 2 * int(counts.max()) > len(bodies)


def gains(rows: Rows, rigid: Array) -> Gains:
    """Fit each effort by the description's, Coulomb and viscous friction, rotor inertia, offset.

    Parameters
    ----------
    rows : Rows
        What was measured.
    rigid : ndarray, shape (K, n)
        Efforts of the description's bodies there.
    """
    n = rigid.shape[1]
    gain, correlation = np.zeros(n), np.zeros(n)
    for j in np.flatnonzero(rows.usable).tolist():
        others = np.column_stack([*friction(rows, j), np.ones(len(rigid))])
        basis, _ = np.linalg.qr(others)
        x, y = (each - basis @ (basis.T @ each) for each in (rigid[:, j], rows.effort[:, j]))
        xx, yy, xy = float(x @ x), float(y @ y), float(x @ y)
        if xx * yy > 0.0:
            gain[j], correlation[j] = xy / xx, xy / np.sqrt(xx * yy)
    size = np.where(rows.usable, rigid.std(axis=0), 0.0)
    shows = (size > _CARRIES * size.max(initial=0.0)) & (np.abs(correlation) > _FOLLOWS)
    return Gains(gain=gain, correlation=correlation, shows=shows)


def unexplained(rows: Rows, rigid: Array, scale: float = 1.0) -> Array:
    """Return the share of each effort's variance that a sensible model leaves, (n,).

    Sensible: the description's efforts times 0.3 to 3, times `scale`; friction that takes power; a
    rotor inertia that is not negative; an offset. It may pass 1, where the description's efforts
    are in the way. Joints that are not usable have 1.
    """
    from scipy.optimize import nnls

    shares = np.ones(rigid.shape[1])
    for j in np.flatnonzero(rows.usable).tolist():
        effort = rows.effort[:, j] - rows.effort[:, j].mean()
        power = float(effort @ effort)
        if power == 0.0:
            continue
        columns = np.column_stack([rigid[:, j], *friction(rows, j)])
        columns -= columns.mean(axis=0)
        size = np.linalg.norm(columns, axis=0)
        size[size == 0.0] = 1.0
        R = np.asarray(np.linalg.qr(np.column_stack([columns / size, effort]), mode="r"))
        factors, rhs = R[:, :-1], R[:, -1]
        fitted, left = nnls(factors, rhs)
        gain = fitted[0] / size[0] / scale
        if not GAINS[0] <= gain <= GAINS[1]:
            fixed = size[0] * scale * min(max(gain, GAINS[0]), GAINS[1])
            _, left = nnls(factors[:, 1:], rhs - fixed * factors[:, 0])
        shares[j] = left**2 / power
    return shares


def misfit(shares: Array) -> float:
    """Return how badly all joints are explained: the sum of the logarithms of their shares.

    Halving the unexplained share of one joint lowers it by 0.7; shares far below 1 % count alike,
    since few descriptions are better.
    """
    return float(np.sum(np.log(shares + _FLOOR)))


def friction(rows: Rows, j: int) -> tuple[Array, Array, Array]:
    """Return the columns of Coulomb and viscous friction and of a rotor's inertia of a joint."""
    return rows.sign[:, j], rows.velocity[:, j], rows.acceleration[:, j]


@dataclass(frozen=True, kw_only=True)
class Correction:
    """One change of a log.

    Attributes
    ----------
    kind : str
        ``"effort_sign"``, ``"position_sign"`` (which turns velocities too), ``"axis_sign"`` (both),
        ``"position_zero"``, ``"position_in_degrees"``, ``"joint_order"``, ``"effort_order"``,
        ``"gravity_direction"``, ``"feet_exchanged"`` (of which foot each has the flags) or
        ``"flags_unlike_motion"`` (feet are down throughout).
    joint : int or None
        Of one joint, or of all.
    value : tuple of float
        The angle to be added in rad; the direction of gravity; or the columns in their right
        order.
    """

    kind: str
    joint: int | None = None
    value: tuple[float, ...] = ()

    def apply(self, rows: Rows) -> Rows:
        """Return the rows of the changed log."""
        if self.kind in ("joint_order", "effort_order"):
            order = np.array(self.value, dtype=np.intp)
            names = _ALL if self.kind == "joint_order" else ("effort", "effort_rate")
            moved = {name: getattr(rows, name)[:, order] for name in names}
            usable = rows.usable[order] if self.kind == "joint_order" else rows.usable
            return replace(rows, **moved, usable=usable)
        columns = slice(None) if self.joint is None else self.joint
        if self.kind == "position_zero":
            position = rows.position.copy()
            position[:, columns] += self.value[0]
            return replace(rows, position=position)
        if self.kind == "position_in_degrees":
            factor = math.pi / 180.0
            return replace(rows, **{name: factor * getattr(rows, name) for name in _MOVED[:3]})
        flipped = {
            "effort_sign": _ALL[4:],
            "position_sign": _MOVED,
            "axis_sign": _ALL,
        }.get(self.kind, ())
        changed = {name: getattr(rows, name).copy() for name in flipped}
        for values in changed.values():
            values[:, columns] *= -1.0
        return replace(rows, **changed)


@dataclass(frozen=True, kw_only=True, eq=False)
class CorrectionStep:
    """One change of a log that makes its efforts follow from its motion.

    Attributes
    ----------
    change : Correction
        The change.
    alike : tuple of Correction
        What does as well.
    before, after : ndarray, shape (n,)
        Shares of the efforts' variance that are unexplained without it, and with it.
    """

    change: Correction
    alike: tuple[Correction, ...]
    before: Array
    after: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class CorrectedLog:
    """A log's rows after some changes.

    Attributes
    ----------
    robot : RobotModel
    rows : Rows
        After the changes.
    gravity : ndarray, shape (3,)
        Gravity after the changes, m/s².
    scale : float
        How many times too large the efforts are taken to be.
    steps : tuple of CorrectionStep
        The changes.
    """

    robot: RobotModel
    rows: Rows
    gravity: Array
    scale: float = 1.0
    steps: tuple[CorrectionStep, ...] = ()
    # What changes of the efforts alone do not touch.
    _of_motion: ClassVar[tuple[str, ...]] = ("rigid",)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the n joints."""
        return self.robot.joint_names[self.robot.n_base :]

    @property
    def feet(self) -> tuple[str, ...]:
        """Names of the contacts' frames."""
        return ()

    @cached_property
    def rigid(self) -> Array:
        """Efforts of the description's bodies, (K, n)."""
        rows = self.rows
        return self.robot.described_efforts(
            rows.position, rows.velocity, rows.acceleration, gravity=self.gravity
        )

    @cached_property
    def shares(self) -> Array:
        """Shares of the efforts' variance that are unexplained, (n,)."""
        return unexplained(self.rows, self.rigid, self.scale)

    @cached_property
    def gains(self) -> Gains:
        """How many times the description's efforts the measured ones are."""
        return gains(self.rows, self.rigid)

    @property
    def borne(self) -> Array:
        """What each joint bears of the bodies, (n,), for comparison with each other."""
        return np.where(self.rows.usable, self.rigid.std(axis=0), 0.0)

    @property
    def left(self) -> Array:
        """Shares of the efforts' variance that are unexplained at any scale, (n,)."""
        return self.shares

    @property
    def misfit(self) -> float:
        """How badly the efforts are explained."""
        return misfit(self.shares)

    @property
    def most_steps(self) -> int:
        """How many changes are tried one after another."""
        return 2 * len(self.joint_names)

    @property
    def explained(self) -> bool:
        """Whether no change has enough to gain."""
        return self.misfit - len(self.joint_names) * LEAST_MISFIT < NEEDED

    def orders(self) -> list[tuple[int, ...]]:
        """Return orders of all columns that are tried."""
        return _orders(self.joint_names)

    def effort_orders(self) -> Iterator[tuple[int, ...]]:
        """Yield orders of the efforts' columns that are tried."""
        order = _efforts_assigned(self)
        if order != tuple(range(len(order))):
            yield order

    def flags(self) -> Iterator[Correction]:
        """Yield changes of contacts' flags that are tried."""
        yield from ()

    def gravities(self) -> Iterator[tuple[float, ...]]:
        """Yield directions of gravity that are tried."""
        size = float(np.linalg.norm(self.gravity))
        for axis in range(3):
            for sign in (1.0, -1.0):
                gravity = tuple(sign * size if k == axis else 0.0 for k in range(3))
                if not np.allclose(gravity, self.gravity, atol=1e-3):
                    yield gravity

    def changed(self, change: Correction) -> CorrectedLog:
        """Return the log with one more change."""
        gravity = np.array(change.value) if change.kind == "gravity_direction" else self.gravity
        log = replace(self, rows=change.apply(self.rows), gravity=gravity)
        if change.kind in ("effort_sign", "effort_order"):
            for name in self._of_motion:
                log.__dict__[name] = getattr(self, name)
        return log


def corrected(robot: RobotModel, rows: Rows) -> CorrectedLog | None:
    """Change a log as little as makes its efforts follow from its motion.

    Every change has to lower the misfit by `NEEDED`.

    Returns
    -------
    CorrectedLog or None
        None where the description has no masses, or no joint can be compared.
    """
    if not described(robot) or not rows.usable.any():
        return None
    thinned = {name: getattr(rows, name)[::_THINNED] for name in _ALL}
    return searched(CorrectedLog(robot=robot, rows=replace(rows, **thinned), gravity=robot.gravity))


def searched(log: CorrectedLog) -> CorrectedLog:
    """Return a log with the changes that make its efforts follow from its motion."""
    if log.explained:
        return log
    common = log.gains.common or 1.0
    if GAINS[0] < common < GAINS[1]:
        return _searched(log)
    rescaled = replace(log, scale=common)
    if rescaled.explained:
        return rescaled  # one change of the unit of all
    return min((_searched(each) for each in (log, rescaled)), key=_price)


def _searched(best: CorrectedLog) -> CorrectedLog:
    """Return the log with the changes that lower its price."""
    kept = [best]
    for _ in range(best.most_steps):
        kept = sorted((child for log in kept for child in _children(log)), key=_price)[:_KEPT]
        if not _price(kept[0]) < _price(best):
            break
        best = kept[0]
        if best.explained:
            break
    return best


def _price(log: CorrectedLog) -> float:
    """Return the misfit, and what changes and another scale have to gain."""
    return log.misfit + NEEDED * (len(log.steps) + (log.scale != 1.0))


def _children(log: CorrectedLog) -> list[CorrectedLog]:
    """Return the logs that one more change makes, the best ones."""
    # Of forty joints a thousand logs are compared: all at once they would take all memory.
    listed = [(change, log.changed(change).shares) for change in _changes(log)]
    misfits = {change: misfit(shares) for change, shares in listed}
    tried = sorted(listed, key=lambda each: misfits[each[0]])
    # Of those that do as well as the best the likeliest counts.
    near = misfits[tried[0][0]] + _ALIKE
    likeliest = next(each for each in listed if misfits[each[0]] < near)
    tried = [likeliest, *(each for each in tried if each is not likeliest)]
    children = []
    for change, shares in tried[:_KEPT]:
        near = misfits[change] + _ALIKE
        alike = tuple(each for each, _ in tried if each is not change and misfits[each] < near)
        step = CorrectionStep(change=change, alike=alike, before=log.shares, after=shares)
        children.append(replace(log.changed(change), steps=(*log.steps, step)))
    return children


def _changes(log: CorrectedLog) -> Iterator[Correction]:
    """Yield every change that is tried, the likeliest of those that do the same first."""
    n, usable = len(log.joint_names), np.flatnonzero(log.rows.usable).tolist()
    for kind in ("effort_sign", "position_sign", "axis_sign"):
        if n > 1:
            yield Correction(kind=kind)
        yield from (Correction(kind=kind, joint=j) for j in usable)
    if np.abs(log.rows.position).max() > _LEAST_DEGREES:
        yield Correction(kind="position_in_degrees")
    yield from log.flags()
    for order in log.orders():
        yield Correction(kind="joint_order", value=order)
    for order in log.effort_orders():
        yield Correction(kind="effort_order", value=order)
    for angle in _QUARTERS:
        yield from (Correction(kind="position_zero", joint=j, value=(angle,)) for j in range(n))
    for gravity in log.gravities():
        yield Correction(kind="gravity_direction", value=gravity)


def _orders(names: tuple[str, ...]) -> list[tuple[int, ...]]:
    """Return orders of all columns that are tried.

    Two exchanged; backwards; one joint on; and back from the alphabet's order, in which ROS drivers
    publish joints.
    """
    n = len(names)
    by_alphabet = sorted(range(n), key=names.__getitem__)
    turned = [tuple((i + shift) % n for i in range(n)) for shift in (1, -1)]
    orders = {tuple(np.argsort(by_alphabet).tolist()), tuple(reversed(range(n))), *turned}
    for i in range(n):
        for j in range(i):
            order = list(range(n))
            order[i], order[j] = j, i
            orders.add(tuple(order))
    return sorted(orders - {tuple(range(n))})


def _efforts_assigned(log: CorrectedLog) -> tuple[int, ...]:
    """Return the effort columns that explain the joints' motion best, one each."""
    from scipy.optimize import linear_sum_assignment

    rows, n = log.rows, log.robot.n
    cost = np.zeros((n, n))
    for shift in range(n):
        order = (np.arange(n) + shift) % n
        moved = replace(rows, effort=rows.effort[:, order])
        shares = unexplained(moved, log.rigid, log.scale)
        cost[np.arange(n), order] = np.log(shares + 0.01)
    cost[~rows.usable] = 0.0
    cost[~rows.usable, np.flatnonzero(~rows.usable)] = -100.0
    return tuple(int(j) for j in linear_sum_assignment(cost)[1])
