"""Compare efforts of a robot on legs with its description, whatever its contacts bear.

Rows ``Y @ theta = effort + J^T·f`` are projected onto what the contacts that are down leave free.
A leg that stands has no equation of its own then: its joints' efforts are seen through the weight
of the robot. So all joints are fitted at once, ``Y @ theta = gain·effort − friction`` with one gain
for each, and no gain for the rows of the base, which fix the scale.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import permutations
from typing import ClassVar

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.experiment.inspection.corrections import GAINS, CorrectedLog, Correction, Gains
from sdpid.experiment.inspection.delays.kinematic import block_error
from sdpid.experiment.inspection.rows import Rows
from sdpid.experiment.processing.contacts.contact_samples import TRANSMITS, ContactSamples
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.recording.rest import moving
from sdpid.robot.model.contacts.jacobians import contact_jacobians
from sdpid.robot.model.model import RobotModel

# The base's force weighs in the fit by this share of the weight, its torque at this many meters.
_WEIGHT_SHARE, _ARM = 0.1, 0.1
# A contact's direction below this share of the strongest is another one's repetition.
_RANK = 1e-6
# No more changes than this are tried in a row.
_MOST_STEPS = 3
# With so little unexplained nothing is looked for: 15 % off the description leave up to 0.06 of a
# joint, and what is wrong 0.2 or more.
_FINE = 0.1
# Of more joints only those that are not explained, or not compared, are exchanged in pairs: of
# forty there are 800 pairs, of positions and of efforts.
_MANY = 20
# Rows of a base that is held are 0 but for rounding.
_HELD = 1e-6
# A gain is known where its standard error is below this share of it.
_KNOWN = 0.2
# Rows that are compared: with 4 feet down 6 equations each.
_ROWS = 120
# A joint whose bodies ask for less than this share of what they ask for at the strongest is not
# compared: noise of its torque is larger. Fingers are at 0.003, the least joint of a quadruped that
# stands at 0.017.
_ASKS = 0.005
# Width of the smooth sign of the velocity, rad/s.
_WIDTH = 0.02
# Orders of more legs are not tried.
MOST_LEGS = 4


def exchanges(order: tuple[int, ...], poor: Mask) -> bool:
    """Return whether an order exchanges two joints of these, or moves more."""
    moved = [joint for joint, place in enumerate(order) if joint != place]
    return len(moved) > 2 or bool(poor[moved].all())


def leg_orders(robot: RobotModel) -> Iterator[tuple[int, ...]]:
    """Yield orders in which legs, or the joints of all legs, are exchanged."""
    legs = _legs_of(robot)
    n = sum(len(leg) for leg in legs)
    by_size: dict[int, list[list[int]]] = {}
    for leg in legs:
        by_size.setdefault(len(leg), []).append(leg)
    for size, alike in by_size.items():
        if not 1 < len(alike) <= MOST_LEGS:
            continue
        flat = [joint for leg in alike for joint in leg]
        turned = [alike[k // size][k % size] for k in range(len(flat))]
        ways = [[joint for leg in way for joint in leg] for way in permutations(alike)]
        # All first joints of legs, then all second ones; and the way back.
        by_joint = [leg[k] for k in range(size) for leg in alike]
        back = [flat[by_joint.index(joint)] for joint in flat]
        for way in (*ways, by_joint, back, [joint for leg in alike for joint in reversed(leg)]):
            order = list(range(n))
            for place, joint in zip(turned, way, strict=True):
                order[place] = joint
            if order != list(range(n)):
                yield tuple(order)


def _legs_of(robot: RobotModel) -> list[list[int]]:
    """Return the joints that hang on the base one after another, counted from 0 behind it."""
    parents = list(robot.pin_model.parents)
    legs: dict[int, list[int]] = {}
    first: dict[int, int] = {}
    for joint in range(2, len(parents)):
        first[joint] = joint if parents[joint] == 1 else first[parents[joint]]
        legs.setdefault(first[joint], []).append(joint - 2)
    return list(legs.values())


def fitted(columns: Array, due: Array) -> tuple[Array, Array]:
    """Return least squares of rows (K, m, p), and standard errors from blocks of samples."""
    A, b = columns.reshape(-1, columns.shape[2]), due.ravel()
    size = np.linalg.norm(A, axis=0)
    size[size == 0.0] = 1.0
    A = A / size
    inverse = np.linalg.pinv(A.T @ A, rcond=1e-12, hermitian=True)
    found = inverse @ (A.T @ b)
    scores = (A * (b - A @ found)[:, None]).reshape(*due.shape, -1).sum(axis=1)
    errors = np.array([block_error(each, 1.0) for each in (scores @ inverse).T])
    return found / size, errors / size


def sensible_fit(columns: Array, due: Array, scale: float) -> Array:
    """Return gains of 0.3 to 3, friction that takes power, rotors that have inertia."""
    from scipy.optimize import nnls

    n = columns.shape[2] // 4
    A, b = columns.reshape(-1, columns.shape[2]), due.ravel()
    # A root of the normal equations is exact enough for shares, and several times faster than QR.
    size = np.linalg.norm(A, axis=0)
    size[size == 0.0] = 1.0
    A = A / size
    values, vectors = np.linalg.eigh(A.T @ A)
    root = np.sqrt(np.maximum(values, 1e-12 * values[-1]))
    factor, rhs = (vectors * root).T, (vectors.T @ (A.T @ b)) / root
    low, high = np.zeros(4 * n), np.full(4 * n, np.inf)
    low[:n], high[:n] = (limit / scale * size[:n] for limit in GAINS)
    found = low.copy()
    open_ = np.ones(4 * n, dtype=np.bool_)
    for _ in range(n):
        fixed = factor[:, ~open_] @ found[~open_] + factor[:, open_] @ low[open_]
        found[open_] = low[open_] + nnls(factor[:, open_], rhs - fixed)[0]
        over = open_ & (found > high)
        if not over.any():
            break
        found[over] = high[over]
        open_ &= ~over
    return np.asarray(found / size)


@dataclass(frozen=True, kw_only=True, eq=False)
class FloatingLog(CorrectedLog):
    """Rows of a log with a floating base, after some changes.

    Attributes
    ----------
    base_position : ndarray, shape (K, 7)
    base_velocity, base_acceleration : ndarray, shape (K, 6)
        As in samples.
    contacts : ContactSamples
        Of these rows.
    """

    base_position: Array
    base_velocity: Array
    base_acceleration: Array
    contacts: ContactSamples
    _of_motion: ClassVar[tuple[str, ...]] = ("rigid", "unit", "free")

    @property
    def feet(self) -> tuple[str, ...]:
        """Names of the contacts' frames."""
        return self.contacts.frames

    @cached_property
    def rigid(self) -> Array:
        """Efforts of the description's bodies without contacts, (K, 6 + n)."""
        rows = self.rows
        return self.robot.described_efforts(
            self.configuration,
            np.hstack([self.base_velocity, rows.velocity]),
            np.hstack([self.base_acceleration, rows.acceleration]),
            gravity=self.gravity,
        )

    @property
    def configuration(self) -> Array:
        """Pinocchio's configurations, (K, 7 + n)."""
        return np.hstack([self.base_position, self.rows.position])

    @cached_property
    def unit(self) -> Array:
        """What errors of rows are measured in, N or N·m, (6 + n,); of all joints alike."""
        own = float(np.median(self.rows.effort[:, self.rows.usable].std(axis=0)))
        weight = self.robot.prior[:, 0].sum() * float(np.linalg.norm(self.gravity))
        force = np.full(3, _WEIGHT_SHARE * weight)
        joints = np.full(len(self.joint_names), max(own, 1e-9) / self.scale)
        return np.concatenate([force, _ARM * force, joints])

    @cached_property
    def free(self) -> Array:
        """Projectors of rows in their units onto what contacts leave free, (K, 6 + n, 6 + n)."""
        J = contact_jacobians(
            self.robot, self.configuration, self.contacts.frames, self.contacts.offset
        )
        parts = [
            J[:, i, : TRANSMITS[kind]] * self.contacts.down[:, i, None, None]
            for i, kind in enumerate(self.contacts.kind)
        ]
        A = np.swapaxes(np.concatenate(parts, axis=1) / self.unit, 1, 2)
        U, s, _ = np.linalg.svd(A, full_matrices=False)
        U = U * (s > _RANK * np.maximum(s[:, :1], 1e-300))[:, None, :]
        return np.asarray(np.eye(A.shape[1]) - U @ np.swapaxes(U, 1, 2))

    @cached_property
    def columns(self) -> Array:
        """Columns of gains, dry and viscous friction and rotor inertias, (K, 6 + n, 4n)."""
        rows, n = self.rows, len(self.joint_names)
        columns = np.zeros((len(rows.effort), 6 + n, 4 * n))
        parts = (rows.effort, -rows.sign, -rows.velocity, -rows.acceleration)
        for place, part in enumerate(parts):
            columns[:, 6 + np.arange(n), place * n + np.arange(n)] = part * rows.usable
        return columns

    @cached_property
    def equations(self) -> tuple[Array, Array]:
        """Columns projected, in units of `unit`, and what is due."""
        weighted = self.free @ (self.columns / self.unit[:, None])
        return weighted, np.einsum("kij,kj->ki", self.free, self.rigid / self.unit)

    @cached_property
    def sensible(self) -> tuple[Array, Array]:
        """What the efforts come to with sensible gains, and what a sensible model leaves."""
        columns, due = self.equations
        found = sensible_fit(columns, due, self.scale)
        n = len(self.joint_names)
        return columns[..., :n] @ found[:n], due - columns @ found

    @cached_property
    def shares(self) -> Array:
        """Shares that a sensible model leaves of what each joint's rows ask for, (n,)."""
        return self._shares(self.sensible[1])

    @cached_property
    def freely(self) -> tuple[Array, Array, Array]:
        """Gains and friction of any size and sign, their standard errors, and what they leave."""
        columns, due = self.equations
        found, errors = fitted(columns, due)
        return found, errors, self._shares(due - columns @ found)

    @property
    def left(self) -> Array:
        """Shares that are unexplained with any gains, or of the effort itself, (n,).

        What a joint bears may be little against its friction.
        """
        measured, left = self.sensible
        least = np.minimum(self.shares, self.freely[2])
        return np.minimum(least, self._shares(left, measured))

    @property
    def bears_base(self) -> bool:
        """Whether rows show the base's weight: where something holds it, they do not."""
        due = self.equations[1]
        return bool(np.sum(due[:, :6] ** 2) > _HELD * np.sum(due**2))

    def _shares(self, left: Array, of: Array | None = None) -> Array:
        """Return the shares of what is due, or of other values (K, 6 + n), by joint."""
        power = np.sum((self.equations[1] if of is None else of)[:, 6:] ** 2, axis=0)
        found = np.sum(left[:, 6:] ** 2, axis=0) / np.where(power > 0.0, power, 1.0)
        return np.where(self.rows.usable & (power > 0.0), found, 1.0)

    @cached_property
    def gains(self) -> Gains:
        """How many times the description's efforts the measured ones are."""
        found, errors, left = self.freely
        n = len(self.joint_names)
        gain = np.where(found[:n] == 0.0, np.inf, found[:n])
        shows = self.rows.usable & (errors[:n] < _KNOWN * np.abs(gain)) & np.isfinite(gain)
        follows = np.sqrt(np.clip(1.0 - left, 0.0, 1.0)) * np.sign(gain)
        return Gains(gain=1.0 / gain, correlation=follows, shows=shows)

    @property
    def borne(self) -> Array:
        """Joints count alike where they are compared, (n,)."""
        return self.rows.usable.astype(np.float64)

    @property
    def explained(self) -> bool:
        """Whether the description explains every joint so well that no channel is wrong.

        Joints of another scale are told by their gains.
        """
        usable = self.rows.usable
        if np.max(self.shares[usable]) < _FINE:
            return True
        known = self.gains
        scaled = bool(known.shows[usable].all() and (known.gain[usable] > 0.0).all())
        return scaled and bool(np.max(self.freely[2][usable]) < _FINE)

    def carried(self) -> tuple[float, float]:
        """Return the mass that the efforts carry, of the description's, and its standard error."""
        columns, due = self.equations
        n = len(self.joint_names)
        common = np.concatenate([columns[..., :n].sum(axis=2)[..., None], columns[..., n:]], axis=2)
        found, errors = fitted(common, due)
        return 1.0 / float(found[0]), float(errors[0] / found[0] ** 2)

    def orders(self) -> list[tuple[int, ...]]:
        """Return orders of all columns that are tried, those of whole legs first."""
        legs = list(leg_orders(self.robot))
        others = [order for order in super().orders() if order not in legs]
        if len(self.joint_names) > _MANY:
            poor = ~self.rows.usable | (self.shares > _FINE)
            others = [order for order in others if exchanges(order, poor)]
        return [*legs, *others]

    @property
    def most_steps(self) -> int:
        """How many changes are tried one after another: each round takes a second."""
        return _MOST_STEPS

    def changed(self, change: Correction) -> CorrectedLog:
        """Return the log with one more change."""
        down = self.contacts.down
        if change.kind == "feet_exchanged":
            down = down[:, np.array(change.value, dtype=np.intp)]
        elif change.kind == "flags_unlike_motion":
            down = np.broadcast_to(down.any(axis=0), down.shape)
        else:
            return super().changed(change)
        log = replace(self, contacts=replace(self.contacts, down=down))
        for name in ("rigid", "unit"):
            log.__dict__[name] = getattr(self, name)
        return log

    def flags(self) -> Iterator[Correction]:
        """Yield changes of contacts' flags that are tried: other feet's, and none that open."""
        down = self.contacts.down
        if 2 <= self.contacts.n <= MOST_LEGS and (down != down[:, :1]).any():
            for order in list(permutations(range(self.contacts.n)))[1:]:
                yield Correction(kind="feet_exchanged", value=order)
        if (down.any(axis=0) != down.all(axis=0)).any():
            yield Correction(kind="flags_unlike_motion")

    def effort_orders(self) -> Iterator[tuple[int, ...]]:
        """Yield orders of the efforts' columns that are tried."""
        yield from self.orders()

    def gravities(self) -> Iterator[tuple[float, ...]]:
        """Yield nothing: the world's axes are those of the orientation, which is checked."""
        yield from ()


def floating_log(
    robot: RobotModel, samples: Samples, without: Collection[str] = ()
) -> FloatingLog | None:
    """Return rows of samples; None where nothing can be compared.

    Parameters
    ----------
    robot : RobotModel
        On a floating base.
    samples : Samples
        Of one recording.
    without : collection of str
        Joints whose effort says nothing.
    """
    contacts = samples.contacts
    if contacts is None or not robot.prior[:, 0].sum() > 0.0:
        return None
    some = np.unique(np.linspace(0, samples.n_samples - 1, _ROWS).astype(np.intp))
    base = robot.n_base
    position, effort = samples.position[some, base + 1 :], samples.effort[some, base:]
    velocity = samples.velocity[some, base:]
    known = np.array([name not in without for name in robot.joint_names[base:]])
    moves = moving(samples.position[:, base + 1 :].min(0), samples.position[:, base + 1 :].max(0))
    usable = moves & known & (np.ptp(effort, axis=0) > 0.0)
    if not usable.any():
        return None
    rows = Rows(
        position=position,
        velocity=velocity,
        acceleration=samples.acceleration[some, base:],
        sign=np.tanh(velocity / _WIDTH),
        effort=effort,
        effort_rate=np.zeros_like(effort),
        usable=usable,
        motion_hz=0.0,
        step=0.0,
    )
    log = FloatingLog(
        robot=robot,
        rows=rows,
        gravity=robot.gravity,
        base_position=samples.position[some, : base + 1],
        base_velocity=samples.velocity[some, :base],
        base_acceleration=samples.acceleration[some, :base],
        contacts=contacts.picked(some),
    )
    asked = np.sqrt(np.mean(log.equations[1][:, base:] ** 2, axis=0))
    usable = usable & (asked > _ASKS * asked.max())
    return replace(log, rows=replace(rows, usable=usable)) if usable.any() else None
