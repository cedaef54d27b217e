"""`ExplainedLog`: what of efforts the description explains, on any base, and what must be changed.

On a fixed base each joint has an equation of its own, ``effort = gain·described + friction``. On a
floating base rows are projected onto what the contacts that are down leave free. A leg that stands
has no equation of its own then: its joints' efforts are seen through the weight of the robot. So
all joints are fitted at once, ``described = gain·effort − friction``, with no gain for the rows of
the base, which fix the scale.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations, permutations, product
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.experiment.inspection.block_fit import BlockFit, block_fit
from sdpid.experiment.inspection.delays import free_of_contacts
from sdpid.experiment.inspection.rows import FilteredRows, smooth_sign
from sdpid.experiment.processing.contact_samples import ContactSamples
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.recording.plausible import moving
from sdpid.robot.model.model import RobotModel

# A change counts where it lowers the misfit by this much: the unexplained share of a joint falls to
# a seventh. Of 22 good recordings of six arms no change lowers it by more than 0.9; the changes
# that mend a log lower it by 2.5 to 30, but for joints that carry next to nothing.
NEEDED = 2.0
# The search goes on from this many of the best changes, so that the first of two need not be best.
_KEPT = 4
# No more changes than this are tried in a row on a floating base, where each round takes a second.
_MOST_STEPS = 3
# Changes whose misfits are this close cannot be told apart: as much is gained by chance.
_ALIKE = 0.9
# One row in so many is compared on a fixed base: some eighty changes are tried on every log. On a
# floating one so many in all: with 4 feet down 6 equations each.
_THINNED, _ROWS = 2, 120
# Positions that never pass this (rad) are not tried as degrees: 3 degrees are no motion.
_LEAST_DEGREES = math.pi
# A joint's zero may be a quarter or half a turn away from the description's.
_QUARTERS = (0.5 * math.pi, -0.5 * math.pi, math.pi)
# Efforts of real arms are this many times those of the description's bodies, friction taken away:
# 0.7 to 2.3 for the joints that carry something, of 17 recordings of six arms with and without
# loads.
GAINS = (0.3, 3.0)
# A joint on a fixed base shows the scale of its efforts where the description's bodies make at
# least this share of the effort they make in the joint that carries most, and what friction does
# not explain follows them with this correlation; on a floating base where the standard error of its
# gain is below this share of it.
_CARRIES, _FOLLOWS, _KNOWN = 0.05, 0.7, 0.2
# This share of an effort stays unexplained by the description where all is well: with 0.01 the
# slightly eccentric last link of one simulated good log of 48 seemed turned by half a turn.
_FLOOR = 0.03
# On a floating base nothing is looked for with so little unexplained: 15 % off the description
# leave up to 0.06 of a joint, and what is wrong 0.2 or more.
_FINE = 0.1
# The base's force weighs in the fit by this share of the weight, its torque at this many meters.
_WEIGHT_SHARE, _ARM = 0.1, 0.1
# Rows of a base that is held are 0 but for rounding.
_HELD = 1e-6
# A joint whose bodies ask for less than this share of what they ask for at the strongest is not
# compared: noise of its torque is larger. Fingers are at 0.003, the least joint of a quadruped that
# stands at 0.017.
_ASKS = 0.005
# Orders of more legs are not tried. Of more joints only those that are not explained, or not
# compared, are exchanged in pairs: of forty there are 800 pairs, of positions and of efforts.
_MOST_LEGS, _MANY = 4, 20
# No gain and no friction is so many times what alone makes up all that is due.
_FREE = 1e3
# Columns of unit length that depend on others, and the weight of bounds beside such columns.
_RIDGE, _SURELY = 1e-12, 1e3
_DEGREE = math.pi / 180.0

_STATES = ("position", "velocity", "acceleration")
_MOVED = (*_STATES, "sign")
# The signals that a change concerns.
_CHANGED = {
    "effort_sign": ("effort",),
    "effort_order": ("effort",),
    "position_sign": _MOVED,
    "position_zero": ("position",),
    "position_in_degrees": _STATES,
    "axis_sign": (*_MOVED, "effort"),
    "joint_order": (*_MOVED, "effort"),
}


class Correction(NamedTuple):
    """One change of a log.

    Of the columns of a joint, or of all where that is None. `kind` is ``"effort_sign"``,
    ``"position_sign"`` (which turns velocities too), ``"axis_sign"`` (both), ``"position_zero"``,
    ``"position_in_degrees"``, ``"joint_order"``, ``"effort_order"``, ``"gravity_direction"``,
    ``"feet_exchanged"`` (of which foot each has the flags) or ``"flags_unlike_motion"`` (feet are
    down throughout). `value` is the angle to be added in rad, the direction of gravity, or the
    columns in their right order.
    """

    kind: str
    joint: int | None = None
    value: tuple[float, ...] = ()


class CorrectionStep(NamedTuple):
    """A change, what does as well, and shares (n,) that are unexplained without it, and with it."""

    change: Correction
    alike: tuple[Correction, ...]
    before: Array
    after: Array


class EffortGains(NamedTuple):
    """How many times the description's efforts the measured ones are, (n,) each.

    With the correlation by which they follow once friction is taken away, and whether the joint
    shows it.
    """

    gain: Array
    correlation: Array
    shows: Mask

    @property
    def common(self) -> float | None:
        """The median of the gains that are known, by size; None where there is none."""
        return float(np.median(np.abs(self.gain[self.shows]))) if self.shows.any() else None


def described(robot: RobotModel | None) -> bool:
    """Return whether a robot's description has masses to compare with."""
    return robot is not None and robot.n_base == 0 and bool(np.any(robot.prior[:, 0] > 0.0))


def misfit(shares: Array) -> float:
    """Return how badly all joints are explained: the sum of the logarithms of their shares.

    Halving the unexplained share of one joint lowers it by 0.7; shares far below 1 % count alike,
    since few descriptions are better.
    """
    return float(np.sum(np.log(shares + _FLOOR)))


@dataclass(frozen=True, kw_only=True, eq=False)
class ExplainedLog:
    """Rows of a log after some changes.

    Attributes
    ----------
    robot : RobotModel
    signals : dict of str to (K, n) ndarray
        ``"position"``, ``"velocity"``, ``"acceleration"``, ``"sign"`` (of the velocity, smooth) and
        ``"effort"`` of the n joints.
    usable : ndarray of bool, shape (n,)
        Which joints are compared.
    gravity : ndarray, shape (3,)
        After the changes, m/s².
    base : tuple of ndarray
        Pose, velocity and acceleration of a floating base, (K, 7), (K, 6), (K, 6); else empty.
    contacts : ContactSamples or None
        Of a floating base.
    scale : float
        How many times too large the efforts are taken to be.
    steps : tuple of CorrectionStep
        The changes.
    rigid : ndarray, shape (K, n) or (K, 6 + n)
        Efforts of the description's bodies, without contacts.
    free : ndarray, shape (K, 6 + n, 6 + n)
        Of a floating base, the way from efforts to rows in their units that contacts leave free.
    """

    robot: RobotModel
    signals: dict[str, Array]
    usable: Mask
    gravity: Array
    base: tuple[Array, ...] = ()
    contacts: ContactSamples | None = None
    scale: float = 1.0
    steps: tuple[CorrectionStep, ...] = ()
    rigid: Array = field(default_factory=lambda: np.zeros(0))
    free: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the n joints."""
        return self.robot.joint_names[self.robot.n_base :]

    def moved(self) -> ExplainedLog:
        """Return the log with what its motion needs, and what its contacts leave free."""
        states = [self.signals[name] for name in _STATES]
        if self.base:
            states = [np.hstack(each) for each in zip(self.base, states, strict=True)]
        rigid = self.robot.described_efforts(*states, gravity=self.gravity)
        if self.contacts is None:
            return replace(self, rigid=rigid)
        own = float(np.median(self.signals["effort"][:, self.usable].std(axis=0)))
        weight = self.robot.prior[:, 0].sum() * float(np.linalg.norm(self.gravity))
        # What errors of rows are measured in, N or N·m; of all joints alike.
        unit = np.full(rigid.shape[1], max(own, 1e-9) / self.scale)
        unit[:3] = _WEIGHT_SHARE * weight
        unit[3:6] = _ARM * unit[:3]
        free = free_of_contacts(self.robot, states[0], self.contacts, unit)
        return replace(self, rigid=rigid, free=free / unit)

    @cached_property
    def equations(self) -> tuple[tuple[list[int], Array, Array], ...]:
        """Joints that are fitted together, their columns (K, m, 4j), and what is due (K, m).

        The columns are those of gains, dry and viscous friction, and rotor inertias.
        """
        s = self.signals
        if self.contacts is not None:
            joints = self.free[:, :, self.robot.n_base :] * self.usable
            parts = (s["effort"], -s["sign"], -s["velocity"], -s["acceleration"])
            columns = np.concatenate([joints * part[:, None] for part in parts], axis=2)
            due = np.einsum("kij,kj->ki", self.free, self.rigid)
            return ((list(range(len(self.usable))), columns, due),)
        parts = (self.rigid, s["sign"], s["velocity"], s["acceleration"])
        columns = np.stack([part - part.mean(axis=0) for part in parts], axis=2)
        due = s["effort"] - s["effort"].mean(axis=0)
        compared = np.flatnonzero(self.usable).tolist()
        return tuple(([j], columns[:, [j]], due[:, [j]]) for j in compared)

    @cached_property
    def shares(self) -> Array:
        """Shares that a sensible model leaves of what is due, (n,).

        Sensible: gains of 0.3 to 3, times `scale`; friction that takes power; a rotor inertia that
        is not negative; on a fixed base an offset. They may pass 1, where the description is in
        the way. Joints that are not usable have 1.
        """
        shares = np.ones(len(self.usable))
        for joints, columns, due in self.equations:
            left = due - columns @ self._sensible(columns, due)
            shares[joints] = _share(left, due, self.usable[joints])
        return shares

    def _sensible(self, columns: Array, due: Array) -> Array:
        """Return the coefficients of a sensible model."""
        scale = self.scale if self.contacts is None else 1.0 / self.scale
        return _bounded_fit(columns, due, (GAINS[0] * scale, GAINS[1] * scale))

    @cached_property
    def freely(self) -> tuple[BlockFit, Array]:
        """Gains and friction of any size and sign on a floating base, and what they leave."""
        ((_, columns, due),) = self.equations
        fit = _fitted(columns, due)
        return fit, _share(due - columns @ fit.values, due, self.usable)

    @cached_property
    def left(self) -> Array:
        """Shares that are unexplained with any gains, or of the effort itself, (n,).

        What a joint on a floating base bears may be little against its friction.
        """
        if self.contacts is None:
            return self.shares
        ((joints, columns, due),) = self.equations
        fitted, n = self._sensible(columns, due), len(joints)
        of_effort = _share(due - columns @ fitted, columns[..., :n] @ fitted[:n], self.usable)
        return np.asarray(np.minimum(np.minimum(self.shares, self.freely[1]), of_effort))

    @cached_property
    def gains(self) -> EffortGains:
        """How many times the description's efforts the measured ones are."""
        n = len(self.usable)
        if self.contacts is not None:
            fit, left = self.freely
            gain = np.where(fit.values[:n] == 0.0, np.inf, fit.values[:n])
            shows = self.usable & (fit.errors[:n] < _KNOWN * np.abs(gain)) & np.isfinite(gain)
            follows = np.sqrt(np.clip(1.0 - left, 0.0, 1.0)) * np.sign(gain)
            return EffortGains(1.0 / gain, follows, shows)
        gain, correlation = np.zeros((2, n))
        for (j,), columns, due in self.equations:
            basis, _ = np.linalg.qr(columns[:, 0, 1:])
            x, y = (each - basis @ (basis.T @ each) for each in (columns[:, 0, 0], due[:, 0]))
            xx, yy, xy = float(x @ x), float(y @ y), float(x @ y)
            if xx * yy > 0.0:
                gain[j], correlation[j] = xy / xx, xy / np.sqrt(xx * yy)
        shows = (self.borne > _CARRIES * self.borne.max()) & (np.abs(correlation) > _FOLLOWS)
        return EffortGains(gain, correlation, shows)

    @property
    def borne(self) -> Array:
        """What each joint bears of the bodies, (n,), to be compared; on a floating base alike."""
        return self.usable * (self.rigid.std(axis=0) if self.contacts is None else 1.0)

    @property
    def explained(self) -> bool:
        """Whether no change has enough to gain.

        On a floating base joints of another scale are told by their gains.
        """
        usable = self.usable
        if self.contacts is None:
            return misfit(self.shares) - misfit(np.zeros(len(usable))) < NEEDED
        if np.max(self.shares[usable]) < _FINE:
            return True
        known = self.gains
        scaled = bool(known.shows[usable].all() and (known.gain[usable] > 0.0).all())
        return scaled and bool(np.max(self.freely[1][usable]) < _FINE)

    @property
    def bears_base(self) -> bool:
        """Whether rows show the base's weight: where something holds it, they do not."""
        ((_, _, due),) = self.equations
        return bool(np.sum(due[:, :6] ** 2) > _HELD * np.sum(due**2))

    def carried(self) -> tuple[float, float]:
        """Return the mass that the efforts carry, of the description's, and its standard error."""
        ((joints, columns, due),) = self.equations
        gain, others = np.split(columns, [len(joints)], axis=2)
        fit = _fitted(np.dstack([gain.sum(axis=2), others]), due)
        share = 1.0 / float(fit.values[0])
        return share, float(fit.errors[0]) * share**2

    def changed(self, change: Correction) -> ExplainedLog:
        """Return the log with one more change."""
        kind, joint, value = change
        if kind == "gravity_direction":
            return replace(self, gravity=np.array(value)).moved()
        order = np.array(value, dtype=np.intp)
        if kind not in _CHANGED:
            assert self.contacts is not None
            down = self.contacts.down
            ever = np.broadcast_to(down.any(axis=0), down.shape)
            down = down[:, order] if kind == "feet_exchanged" else ever
            return replace(self, contacts=replace(self.contacts, down=down)).moved()
        signals, columns = dict(self.signals), slice(None) if joint is None else joint
        for name in _CHANGED[kind]:
            values = signals[name] = signals[name].copy()
            if kind.endswith("_order"):
                values[:] = values[:, order]
            elif kind == "position_zero":
                values[:, columns] += value[0]
            else:
                values[:, columns] *= _DEGREE if kind == "position_in_degrees" else -1.0
        usable = self.usable[order] if kind == "joint_order" else self.usable
        log = replace(self, signals=signals, usable=usable)
        return log if _CHANGED[kind] == ("effort",) else log.moved()

    def changes(self) -> Iterator[Correction]:
        """Yield every change that is tried, the likeliest of those that do the same first."""
        n, usable = len(self.usable), np.flatnonzero(self.usable).tolist()
        for kind in ("effort_sign", "position_sign", "axis_sign"):
            if n > 1:
                yield Correction(kind)
            yield from (Correction(kind, j) for j in usable)
        if np.abs(self.signals["position"]).max() > _LEAST_DEGREES:
            yield Correction("position_in_degrees")
        if self.contacts is not None:
            down = self.contacts.down
            if 2 <= self.contacts.n <= _MOST_LEGS and (down != down[:, :1]).any():
                for order in [*permutations(range(self.contacts.n))][1:]:
                    yield Correction("feet_exchanged", value=order)
            if (down.any(axis=0) != down.all(axis=0)).any():
                yield Correction("flags_unlike_motion")
        orders = list(self._orders())
        yield from (Correction("joint_order", value=order) for order in orders)
        yield from (Correction("effort_order", value=order) for order in orders)
        for angle in _QUARTERS:
            yield from (Correction("position_zero", j, (angle,)) for j in range(n))
        # On a floating base the world's axes are those of the orientation, which is checked.
        for axis, sign in () if self.base else product(range(3), (1.0, -1.0)):
            gravity = np.zeros(3)
            gravity[axis] = sign * float(np.linalg.norm(self.gravity))
            if not np.allclose(gravity, self.gravity, atol=1e-3):
                yield Correction("gravity_direction", value=tuple(gravity.tolist()))

    def _orders(self) -> Iterator[tuple[int, ...]]:
        """Yield orders of all columns that are tried.

        Those of whole legs; two exchanged; backwards; one joint on; and back from the alphabet's
        order, in which ROS drivers publish joints.
        """
        n, legs = len(self.usable), [] if self.contacts is None else [*_leg_orders(self.robot)]
        same = list(range(n))
        by_alphabet = sorted(same, key=self.joint_names.__getitem__)
        orders = {tuple(np.argsort(by_alphabet).tolist()), tuple(reversed(same))}
        orders |= {tuple(np.roll(same, shift).tolist()) for shift in (1, -1)}
        # Of many joints those that are explained are not exchanged.
        poor = ~self.usable | (self.shares > _FINE) | (self.contacts is None) | (n <= _MANY)
        for i, j in combinations(np.flatnonzero(poor).tolist(), 2):
            order = list(same)
            order[i], order[j] = j, i
            orders.add(tuple(order))
        for each in (*legs, *sorted(orders - {*legs})):
            if each != tuple(same):
                yield each

    @property
    def price(self) -> float:
        """The misfit, and what changes and another scale have to gain."""
        return misfit(self.shares) + NEEDED * (len(self.steps) + (self.scale != 1.0))

    def searched(self) -> ExplainedLog:
        """Return the log changed as little as makes its efforts follow from its motion.

        Every change has to lower the misfit by `NEEDED`.
        """
        starts, common = [self], self.gains.common or 1.0
        if not GAINS[0] < common < GAINS[1]:
            starts.append(replace(self, scale=common).moved())
        # What is explained in another unit of all has this one change.
        explained = [log for log in starts if log.explained]
        return explained[0] if explained else min(map(_mended, starts), key=attrgetter("price"))

    def children(self) -> list[ExplainedLog]:
        """Return the logs that one more change makes, the best ones."""
        # Of forty joints a thousand logs are compared: all at once they would take all memory.
        listed = [(change, self.changed(change).shares) for change in self.changes()]
        misfits = np.array([misfit(shares) for _, shares in listed])
        # Of those that do as well as the best the likeliest counts.
        likeliest = int(np.argmax(misfits < misfits.min() + _ALIKE))
        ranked = np.argsort(misfits, kind="stable")
        ranked = np.r_[likeliest, ranked[ranked != likeliest]]
        children = []
        for i in ranked[:_KEPT]:
            change, shares = listed[i]
            near = ranked[(misfits[ranked] < misfits[i] + _ALIKE) & (ranked != i)]
            step = CorrectionStep(change, tuple(listed[k][0] for k in near), self.shares, shares)
            children.append(replace(self.changed(change), steps=(*self.steps, step)))
        return children


def _mended(log: ExplainedLog) -> ExplainedLog:
    """Return a log with the changes that lower its price."""
    best, kept = log, [log]
    for _ in range(_MOST_STEPS if log.base else 2 * len(log.usable)):
        if best.explained:
            break
        children = [child for each in kept for child in each.children()]
        kept = sorted(children, key=attrgetter("price"))[:_KEPT]
        if not kept[0].price < best.price:
            break
        best = kept[0]
    return best


def fixed_log(robot: RobotModel, rows: FilteredRows) -> ExplainedLog | None:
    """Return rows of a log with a fixed base; None where nothing can be compared."""
    if not described(robot) or not rows.usable.any():
        return None
    signals = {name: getattr(rows, name)[::_THINNED] for name in (*_MOVED, "effort")}
    log = ExplainedLog(robot=robot, signals=signals, usable=rows.usable, gravity=robot.gravity)
    return log.moved()


def floating_log(
    robot: RobotModel, samples: Samples, without: Collection[str] = ()
) -> ExplainedLog | None:
    """Return rows of samples with a floating base; None where nothing can be compared.

    Parameters
    ----------
    robot : RobotModel
        On a floating base.
    samples : Samples
        Of one recording.
    without : collection of str
        Joints whose effort says nothing.
    """
    contacts, n = samples.contacts, robot.n - robot.n_base
    if contacts is None or not robot.prior[:, 0].sum() > 0.0:
        return None
    some = np.unique(np.linspace(0, samples.n_samples - 1, _ROWS).astype(np.intp))
    signals = {name: getattr(samples, name)[some, -n:] for name in (*_STATES, "effort")}
    signals["sign"] = smooth_sign(signals["velocity"])
    position = samples.position[:, -n:]
    known = np.array([name not in without for name in robot.joint_names[-n:]])
    usable = moving(position.min(axis=0), position.max(axis=0)) & known
    usable &= np.ptp(signals["effort"], axis=0) > 0.0
    if not usable.any():
        return None
    log = ExplainedLog(
        robot=robot,
        signals=signals,
        usable=usable,
        gravity=robot.gravity,
        base=tuple(getattr(samples, name)[some, :-n] for name in _STATES),
        contacts=contacts.rows(some),
    ).moved()
    asked = np.sqrt(np.mean(log.equations[0][2][:, -n:] ** 2, axis=0))
    usable = usable & (asked > _ASKS * asked.max())
    return replace(log, usable=usable).moved() if usable.any() else None


def _leg_orders(robot: RobotModel) -> Iterator[tuple[int, ...]]:
    """Yield orders in which legs, or the joints of all legs, are exchanged."""
    model = robot.pin_model
    # Joints that hang on the base, counted from 0 behind it.
    first = (joint for joint in range(2, model.njoints) if model.parents[joint] == 1)
    legs = [[joint - 2 for joint in model.subtrees[each]] for each in first]
    for size in dict.fromkeys(map(len, legs)):
        alike = np.array([leg for leg in legs if len(leg) == size])
        if not 1 < len(alike) <= _MOST_LEGS:
            continue
        ways = [alike[list(each)] for each in permutations(range(len(alike)))]
        # All first joints of legs, then all second ones; the way back; and legs from their end.
        ways += [alike.T, alike.reshape(alike.shape[::-1]).T, alike[:, ::-1]]
        for way in ways:
            order = np.arange(model.njoints - 2)
            order[alike.ravel()] = way.ravel()
            yield tuple(order.tolist())


def _share(left: Array, of: Array, usable: Mask) -> Array:
    """Return the shares that are left of the squares of the last columns, those of joints."""
    n = len(usable)
    power = np.sum(of[:, -n:] ** 2, axis=0)
    share = np.sum(left[:, -n:] ** 2, axis=0) / np.where(power > 0.0, power, 1.0)
    return np.where(usable & (power > 0.0), share, 1.0)


def _fitted(columns: Array, due: Array) -> BlockFit:
    """Return least squares of rows (K, m, p), with errors from blocks of samples."""
    sizes = np.linalg.norm(columns, axis=(0, 1))
    largest = _FREE * float(np.linalg.norm(due)) / np.where(sizes > 0.0, sizes, 1.0)
    return block_fit(columns, due, largest)


def _bounded_fit(columns: Array, due: Array, gains: tuple[float, float]) -> Array:
    """Return least squares with gains in bounds, and friction and inertia that are not negative."""
    from scipy.optimize import nnls

    n = columns.shape[2] // 4
    A = columns.reshape(-1, 4 * n)
    size = np.linalg.norm(A, axis=0)
    size[size == 0.0] = 1.0
    A = A / size
    # A root of the normal equations is exact enough for shares, and several times faster than QR.
    root = np.linalg.cholesky(A.T @ A + _RIDGE * np.eye(4 * n))
    low, span = np.zeros(4 * n), (gains[1] - gains[0]) * size[:n]
    low[:n] = gains[0] * size[:n]
    rest = np.linalg.solve(root, A.T @ (due.ravel() - A @ low))
    # What a gain has beyond its least, and what it lacks to its largest, are its span.
    both = _SURELY * np.hstack([np.eye(4 * n)[:n], np.eye(n)])
    bounded = np.vstack([np.hstack([root.T, np.zeros((4 * n, n))]), both])
    fitted = low + nnls(bounded, np.concatenate([rest, _SURELY * span]))[0][: 4 * n]
    return np.asarray(fitted / size)
