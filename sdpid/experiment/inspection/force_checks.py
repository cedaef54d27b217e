"""Check measured contact forces against the torques of the legs that bear them, and flags.

Forces are seen twice: by sensors, and by torques. Where both agree they are right up to a common
scale, for which the description's mass is asked. Legs are free bodies: the rows of a leg's joints
hold its own links, which move as they were measured to, its torques, its friction and the force at
its foot. Neither the rest of the robot nor flags of contacts enter them. The links may differ from
their description as far as is believed of them, so that errors of the description are not taken for
a scale of forces.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask, rotation_matrices
from sdpid.experiment.inspection.block_fit import BlockSums
from sdpid.experiment.inspection.explain import ExplainedLog
from sdpid.experiment.inspection.kinds import Finding, Severity, exchanged, found
from sdpid.experiment.inspection.subject import Subject, check, check_of_efforts
from sdpid.experiment.recording.floating.contacts import Contacts
from sdpid.robot.inertia import skew
from sdpid.robot.model.contacts.jacobians import contact_jacobians, frame_axes
from sdpid.robot.model.model import RobotModel

# Told from so many standard errors on, and beyond these: of 72 simulated logs of quadrupeds, links
# 15 % off their description, the common scale is up to 1.1 % off, that of a foot against all 2.7 %,
# an offset 0.9 % of the weight.
_SURE = 5.0
_APART, _ONE_APART, _OFFSET = 0.02, 0.04, 0.02
# Of moments six logs of a humanoid on soles are up to 3.6 % off, of their point 3 cm, 3 errors.
_MOMENTS_APART, _POINT = 0.1, 0.02
# With more than this no reading is right.
_UNLIKE = 0.1
# A foot that is up for fewer samples shows no offset in the air.
_LEAST_UP = 20
# What is measured in the air is the sensor's: within this share the offset that torques tell.
_SAME = 0.5
# Changes of flags of contacts, which leave efforts as they are.
_OF_FLAGS = ("feet_exchanged", "flags_unlike_motion")
# A mass that is this far off the description's is a scale of the torques, or a load; off what the
# robot weighs it is a scale. Of 72 simulated logs, links 15 % off, torques carry up to 2.5 % less
# or more than the robot weighs.
_MASS_APART, _WEIGHED_APART = 0.2, 0.04
# Beyond this factor efforts are in another unit, which is told as such.
_OTHER_UNIT = 5.0
# Flags contradict forces where this share of all force acts while its foot is said to be up: rows
# of landings are half a sample off, which makes 0.004 at most.
_UP_SHARE = 0.01
# What shows less is no force: three times what a sensor shows where nothing touches it, and at
# least this share of the largest force, and of the weight.
_NOISE = 0.03
# A foot bears something where it is down so often, or where the root mean square of its force is
# this share of the weight: below it there is nothing that checks would tell, such as the noise of
# sensors in the air.
_OFTEN, _BEARING = 0.1, 0.02
# Samples that are compared.
_ROWS = 600
# A link's mass may be off by this share of it, its first moments and moments of inertia by what
# this share makes at such a distance (m): twice the 15 % that simulated links are off, and more.
_BELIEF, _AT = 0.3, 0.1
# Width of the smooth sign of the velocity, rad/s.
_WIDTH = 0.02
# Friction and rotor inertia are free: in units of the largest effort no joint has as much.
_FREE = 100.0
# Of 72 simulated logs right forces leave at most 0.0005 of what the legs' torques need beside their
# own links, of humanoids on soles 0.015, and no other reading leaves less; what is read wrong
# leaves ten times as much.
_LIKE, _BETTER = 0.001, 3.0
# A sign is seen where its force explains so much.
_SHOWN = 0.5
# Forces and moments are at most this many times those that torques show; offsets are within this
# share of what was measured.
_LARGEST, _MOST_OFFSET = 10.0, 0.3
# A contact point may be off by this much (m), the radius of a foot; the point that moments of soles
# were said to be about by more.
_NEAR, _ABOUT = 0.02, 0.3


@check
def missing_forces(subject: Subject) -> Iterator[Finding]:
    """Find forces of feet that are down which never change, and components that do not."""
    contacts = subject.log.contacts
    measured = None if contacts is None else contacts.measured
    if contacts is None or contacts.down is None or measured is None:
        return
    still = np.ptp(measured, axis=0) == 0.0
    for foot in np.flatnonzero(still.any(axis=1)).tolist():
        down, dead = float(contacts.down[:, foot].mean()), bool(still[foot].all())
        if down < _OFTEN:
            continue
        axes = "" if dead else f" in {', '.join(np.array(list('xyz'))[still[foot]])}"
        shown = ", ".join(f"{value + 0.0:.4g}" for value in measured[0, foot, still[foot]])
        fields = {"foot": contacts.frames[foot], "axes": axes, "shown": shown}
        severity: Severity = "refuse" if dead else "warning"
        yield found("forces_missing", None, severity, down=down, limit=_OFTEN, **fields)


def explained_log(subject: Subject) -> ExplainedLog | None:
    """Return the rows of a recording whose efforts are N·m, and explained as they are.

    Wrong flags are no matter of efforts.
    """
    log = subject.corrected
    if log is None or log.contacts is None:
        return None
    if any(step.change.kind not in _OF_FLAGS for step in log.steps):
        return None
    common = log.gains.common
    return log if common is None or 1.0 / _OTHER_UNIT < common < _OTHER_UNIT else None


@check_of_efforts
def total_mass(subject: Subject) -> Iterator[Finding]:
    """Find torques that carry another mass than the description's, or than the robot's."""
    log = explained_log(subject)
    if log is None or log.steps or not log.explained or log.scale != 1.0 or not log.bears_base:
        return
    described = float(log.robot.prior[:, 0].sum())
    mass, said, means, limit = described, "of the description", "a load, or another", _MASS_APART
    if subject.total_mass is not None:
        mass, said, means, limit = subject.total_mass, "that it weighs", "another", _WEIGHED_APART
    share, error = (value * described / mass for value in log.carried())
    if abs(share - 1.0) < max(limit, _SURE * error):
        return
    weight = {"carried": share * mass, "kg_error": error * mass, "mass": mass, "said": said}
    limits = {"least": 1.0 - limit, "most": 1.0 + limit, "limit": limit}
    yield found("total_mass", means=means, share=share, error=error, **weight, **limits)


def _felt_up(contacts: Contacts | None, robot: RobotModel | None) -> float | None:
    """Return the share of all measured force that acts on feet that are said to be up."""
    measured = None if contacts is None else contacts.measured
    if contacts is None or contacts.down is None or measured is None:
        return None
    size = np.linalg.norm(measured, axis=-1)
    weight = 0.0 if robot is None else _weight(robot)
    least = _NOISE * max(float(size.max(initial=0.0)), weight)
    felt = size * (size > max(3.0 * float(np.percentile(size, 1.0)), least))
    return float(felt[~contacts.down].sum() / max(float(felt.sum()), 1e-300))


@check
def flags_and_forces(subject: Subject) -> Iterator[Finding]:
    """Find flags that say a foot is up while its force is measured."""
    up = _felt_up(subject.log.contacts, subject.floating)
    if up is not None and up >= _UP_SHARE:
        yield found("flags_unlike_forces", share=up, limit=_UP_SHARE)


def _weight(robot: RobotModel) -> float:
    """Return the weight of a description, N."""
    return float(robot.prior[:, 0].sum() * np.linalg.norm(robot.gravity))


@check_of_efforts
def forces(subject: Subject) -> Iterator[Finding]:
    """Find measured forces of the wrong foot, axes, sign, scale or with an offset."""
    legs = None if explained_log(subject) is None else free_legs(subject)
    if legs is None:
        return
    given, best = _readings(legs)
    if best.left > _UNLIKE:
        yield found("forces_unlike_motion", unexplained=best.left, limit=_UNLIKE)
        return
    yield from _misread(subject, legs, given, best)
    feet = np.arange(len(legs.legs))
    wrenches = legs.turned(best.axes)[:, feet, best.order] * best.signs[:, None]
    shown = [_shown(leg, wrenches[:, foot]) for foot, leg in enumerate(legs.legs)]
    scales = [of_forces for of_forces, _ in shown]
    yield from _scales(legs, scales, wrenches[..., :3], subject.total_mass)
    for foot, (leg, (of_forces, of_moments)) in enumerate(zip(legs.legs, shown, strict=True)):
        yield from _offset(leg, of_forces, wrenches[:, foot, :3], _OFFSET * _weight(legs.robot))
        if of_moments is not None:
            yield from _moments(leg, of_forces, of_moments)


@dataclass(frozen=True, kw_only=True, eq=False)
class Leg:
    """Rows of the j joints between the base and a contact.

    Attributes
    ----------
    frame : str
        Of the contact.
    flat : bool
        Whether it transmits moments too.
    down : ndarray of bool, shape (K,)
        Whether it is closed.
    linear, angular : ndarray, shape (K, j, 3)
        Torques that a unit force, or moment, at the contact takes off, along the world's axes.
    own : ndarray, shape (K, j, p)
        Columns of the leg's links, friction and rotor inertias.
    size : ndarray, shape (p,)
        How large their coefficients may be.
    due : ndarray, shape (K, j)
        Torques less those that the description's links need, N·m.
    """

    frame: str
    flat: bool
    down: Mask
    linear: Array
    angular: Array
    own: Array
    size: Array
    due: Array

    def sums(self, parts: list[tuple[Array, float]]) -> BlockSums:
        """Return normal equations of the own columns, and of others behind them with their size."""
        columns = np.concatenate([self.own, *(part for part, _ in parts)], axis=2)
        sizes = [np.full(part.shape[2], size) for part, size in parts]
        return BlockSums.of(columns, self.due, np.concatenate([self.size, *sizes]))


@dataclass(frozen=True, kw_only=True, eq=False)
class FreeLegs:
    """The legs of a robot whose contact forces were measured.

    Attributes
    ----------
    robot : RobotModel
    legs : tuple of Leg
        Of each of c contacts.
    position : ndarray, shape (K, 7 + n)
    wrenches : ndarray, shape (K, c, 6)
        Forces and moments as recorded.
    needed : ndarray, shape (K, 3)
        Force on the base that weight and inertia of the description need, in its axes, N.
    whole : bool
        Whether these are all contacts that bear something, and so together the robot.
    """

    robot: RobotModel
    legs: tuple[Leg, ...]
    position: Array
    wrenches: Array
    needed: Array
    whole: bool

    @property
    def frames(self) -> list[str]:
        """Names of the contacts' frames."""
        return [leg.frame for leg in self.legs]

    def turned(self, axes: str) -> Array:
        """Return wrenches (K, foot, column, 6) in the world's axes, if recorded in other ones."""
        K, c = self.wrenches.shape[:2]
        turns = np.broadcast_to(np.eye(3), (K, c, 3, 3))
        if axes == "foot":
            turns = frame_axes(self.robot, self.position, self.frames)
        elif axes == "base":
            turns = np.broadcast_to(rotation_matrices(self.position[:, 3:7])[:, None], turns.shape)
        halves = np.einsum("kfij,kchj->kfchi", turns, self.wrenches.reshape(K, c, 2, 3))
        return np.asarray(halves.reshape(K, c, c, 6))


def free_legs(subject: Subject) -> FreeLegs | None:
    """Return the legs that bear measured forces, None where there are none.

    Contacts that bear nothing, that share joints with others, or have joints whose effort says
    nothing, are left out.
    """
    robot, samples = subject.floating, subject.samples
    contacts = None if samples is None else samples.contacts
    if robot is None or samples is None or contacts is None or contacts.forces is None:
        return None
    if not robot.prior[:, 0].sum() > 0.0:
        return None
    some = np.unique(np.linspace(0, samples.n_samples - 1, _ROWS).astype(np.intp))
    q, v, a, effort = (
        each[some]
        for each in (samples.position, samples.velocity, samples.acceleration, samples.effort)
    )
    contacts = contacts.picked(some)
    assert contacts.forces is not None
    J = contact_jacobians(robot, q, contacts.frames, contacts.offset)
    moved: Mask = np.abs(J[..., robot.n_base :]).max(axis=(0, 2)) > 0.0
    unknown = [name in subject.without for name in robot.joint_names[robot.n_base :]]
    shared = moved & (moved.sum(axis=0) > 1)
    felt = np.sqrt(np.mean(np.sum(contacts.forces[..., :3] ** 2, axis=2), axis=0))
    bearing = (contacts.down.mean(axis=0) >= _OFTEN) | (felt >= _BEARING * _weight(robot))
    taken = bearing & moved.any(axis=1) & ~shared.any(axis=1) & ~(moved & unknown).any(axis=1)
    if not np.any(taken):
        return None
    feet = np.flatnonzero(taken).tolist()
    Y, described = robot.regressor(q, v, a), robot.described_efforts(q, v, a)
    masses = np.maximum(robot.prior[:, :1], 1e-3 * robot.prior[:, 0].sum())
    believed = (_BELIEF * masses * np.array([1.0, *3 * (_AT,), *6 * (_AT**2,)])).ravel()
    legs = []
    for contact in feet:
        joints = robot.n_base + np.flatnonzero(moved[contact])
        count, rows = len(joints), Y[:, joints]
        links = np.flatnonzero(np.any(rows != 0.0, axis=(0, 1)))
        signals = (np.tanh(v[:, joints] / _WIDTH), v[:, joints], a[:, joints])
        friction = [signal[:, :, None] * np.eye(count) for signal in signals]
        largest = max(float(np.abs(effort[:, joints]).max()), 1e-9)
        legs.append(
            Leg(
                frame=contacts.frames[contact],
                flat=contacts.kind[contact] != "point",
                down=contacts.down[:, contact],
                linear=-J[:, contact, :3, joints].transpose(1, 0, 2),
                angular=-J[:, contact, 3:, joints].transpose(1, 0, 2),
                own=np.concatenate([rows[:, :, links], *friction], axis=2),
                size=np.append(believed[links], np.full(3 * count, _FREE * largest)),
                due=effort[:, joints] - described[:, joints],
            )
        )
    return FreeLegs(
        robot=robot,
        legs=tuple(legs),
        position=q,
        wrenches=contacts.forces[:, feet],
        needed=described[:, :3],
        whole=bool(taken[bearing].all()),
    )


class Reading(NamedTuple):
    """One way to read measured forces: their axes, the column and sign of each foot's.

    And what it leaves of what the torques of all legs need beside their own links, a share.
    """

    axes: str
    order: Indices
    signs: Array
    left: float


def _readings(legs: FreeLegs) -> tuple[Reading, Reading]:
    """Return the reading as given, but for the sign, and that which fits best.

    Another order, and then other axes, count where they leave a third of what is left without.
    """
    from scipy.optimize import linear_sum_assignment

    compared = {axes: _compared(legs, axes) for axes in ("world", "base", "foot")}
    feet = np.arange(len(legs.legs))
    best = given = _reading("world", feet, *compared["world"])
    ordered, *turned = (
        _reading(axes, linear_sum_assignment(needs[:, None] * left)[1], left, gains, needs)
        for axes, (left, gains, needs) in compared.items()
    )
    for other in (ordered, min(turned, key=lambda reading: reading.left)):
        if best.left > _LIKE and best.left > _BETTER * other.left:
            best = other
    return given, best


def _reading(axes: str, order: Indices, left: Array, gains: Array, needs: Array) -> Reading:
    feet = np.arange(len(order))
    signs = np.where((gains < 0.0) & (left < _SHOWN), -1.0, 1.0)[feet, order]
    # A leg that needs no force, as of a foot that never lands, says nothing.
    return Reading(axes, order, signs, float(np.average(left[feet, order], weights=needs)))


def _compared(legs: FreeLegs, axes: str) -> tuple[Array, Array, Array]:
    """Return what each foot's torques leave with each column's force, and its scale, (c, c).

    What they leave is a share of what they need without any, the last, (c,).
    """
    c = len(legs.legs)
    left, gains, needs = np.ones((c, c)), np.ones((c, c)), np.ones(c)
    turned = legs.turned(axes).swapaxes(2, 3)
    for foot, leg in enumerate(legs.legs):
        force, moment = turned[:, foot, :3], turned[:, foot, 3:]
        parts = [leg.linear @ force]
        if leg.flat:
            # Moments may be of another scale, or about another point: that is asked later.
            parts += [leg.angular @ moment]
            parts += [leg.angular @ (turn @ force) for turn in skew(np.eye(3))]
        sums = leg.sums([(part, _LARGEST) for part in parts])
        own = range(leg.own.shape[2])
        needs[foot] = max(sums.fit(own).left ** 2, 1e-300)
        for column in range(c):
            fit = sums.fit([*own, *range(len(own) + column, len(sums.scale), c)])
            left[foot, column] = fit.left**2 / needs[foot]
            gains[foot, column] = fit.values[len(own)]
    return left, gains, needs


def _misread(subject: Subject, legs: FreeLegs, given: Reading, best: Reading) -> Iterator[Finding]:
    """Tell of which feet and axes, and of which sign, forces are."""
    better = (
        f"so read they leave {100 * best.left:.2g} % of what the legs' torques need beside their "
        f"own links, as given {100 * given.left:.3g} %, limit a factor of {_BETTER:g}"
    )
    numbers = {"unexplained": given.left, "unexplained_mended": best.left, "limit": _BETTER}
    if not np.array_equal(best.order, given.order):
        contacts, up = subject.log.contacts, _felt_up(subject.log.contacts, subject.floating)
        down = None if contacts is None else contacts.down
        differ = down is not None and bool((down != down[:, :1]).any())
        # Flags that differ from foot to foot, and are those of the forces, are exchanged as well.
        both = differ and up is not None and up < _UP_SHARE
        also = ", and flags with them," if both else ""
        remedy = "put the columns of the forces in the order of the contacts' frames"
        if both:
            remedy = "give the contacts' frames in the order of their columns"
        words = {
            "also": also,
            "feet": exchanged(legs.frames, best.order.tolist()),
            "better": better,
        }
        yield found("forces_exchanged", remedy=remedy, flags=float(both), **words, **numbers)
    if best.axes != given.axes:
        own = "the base" if best.axes == "base" else "each foot's frame"
        what = f" are in the axes of {own}, not in the world's: {better}"
        remedy = "turn them into the world's axes: R @ force, R the rotation from those axes"
        yield found("forces_axes", what=what, remedy=remedy, **numbers)
    wrong = [legs.frames[j] for j, sign in zip(best.order, best.signs, strict=True) if sign < 0]
    if wrong:
        of = "" if len(wrong) == len(legs.legs) else f" of {', '.join(wrong)}"
        what = f"{of} have the wrong sign: they are those on the ground"
        remedy = "flip their signs: forces are those on the robot"
        yield found("forces_axes", what=what, remedy=remedy, feet=float(len(wrong)))


class Scale(NamedTuple):
    """What the torques of a leg say of the forces at its foot, or of the moments at its sole.

    Measured values over those that the torques show, and the standard error; and with standard
    errors, of forces what is measured where there are none, N, of moments the point that they are
    about, from that which they are said to be about, in the world's axes, m.
    """

    ratio: float
    error: float
    shift: Array
    shift_errors: Array


def _shown(leg: Leg, wrench: Array) -> tuple[Scale, Scale | None]:
    """Return the scale of a foot's forces, and of its moments where there are any, (K, 6)."""
    force, moment = wrench[:, :3], wrench[:, 3:]
    parts = [
        (leg.linear @ force[:, :, None], _LARGEST),
        (leg.linear, _MOST_OFFSET * float(np.abs(force).max())),
        # Less the cross product with the way there, a moment is about another point.
        (leg.angular @ -skew(force), _ABOUT if leg.flat else _NEAR),
    ]
    if leg.flat:
        parts.append((leg.angular @ moment[:, :, None], _LARGEST))
        parts.append((leg.angular, _MOST_OFFSET * float(np.abs(moment).max())))
    sums = leg.sums(parts)
    fit = sums.fit(range(len(sums.scale)))
    values, errors = (each[len(leg.size) :] for each in (fit.values, fit.errors))
    # Torques show what was measured, less its offset, over its scale.
    gain = float(values[0])

    def over(at: int, shift: Array, first: int) -> Scale:
        shift_errors = errors[first : first + 3] / abs(gain)
        return Scale(
            1.0 / float(values[at]), float(errors[at] / values[at] ** 2), shift, shift_errors
        )

    forces = over(0, -values[1:4] / gain, 1)
    return forces, over(7, values[4:7] / gain, 4) if leg.flat else None


def _common(scales: list[Scale]) -> tuple[float, float]:
    """Return the weighted mean of the feet's ratios, and its standard error.

    It is no smaller than the ratios' spread says.
    """
    ratios = np.array([each.ratio for each in scales])
    weights = np.array([each.error for each in scales]) ** -2.0
    mean = float(weights @ ratios / weights.sum())
    spread = float(weights @ (ratios - mean) ** 2) / max(len(scales) - 1, 1)
    return mean, float(np.sqrt(max(spread, 1.0) / weights.sum()))


def _scales(
    legs: FreeLegs, scales: list[Scale], forces: Array, weighed: float | None
) -> Iterator[Finding]:
    """Tell the scale of forces (K, c, 3) against torques, in common and foot by foot."""
    ratio, error = _common(scales)
    limit = max(_APART, _SURE * error)
    if abs(ratio - 1.0) > limit:
        what = (
            f" are {ratio:.4g} times (standard error {error:.2g}) those that the legs' torques "
            f"show, limit {1 - limit:.3g} to {1 + limit:.3g}"
        )
        if legs.whole:
            described = float(legs.robot.prior[:, 0].sum())
            mass = described if weighed is None else weighed
            who = "the description has" if weighed is None else "the robot weighs"
            J = contact_jacobians(legs.robot, legs.position, legs.frames)[..., :3, :3]
            felt = np.einsum("kcij,kci->kj", J, forces)
            by_forces = described * float(np.sum(legs.needed * felt) / np.sum(legs.needed**2))
            by_torques = by_forces / ratio
            # The nearer to what is known is the likelier.
            off = [abs(np.log(max(each / mass, 1e-3))) for each in (by_forces, by_torques)]
            likely = "forces" if off[0] > off[1] else "torques"
            what += (
                f"; forces carry {by_forces:.4g} kg, torques {by_torques:.4g} kg, {who} "
                f"{mass:.4g} kg, so that the {likely} are likelier wrong"
            )
        remedy = "do not fuse these forces; weigh the robot, and give its mass (TotalMass)"
        yield found("forces_scale", what=what, remedy=remedy, ratio=ratio, error=error, limit=limit)
    for foot, scale in enumerate(scales if len(scales) > 1 else ()):
        others, uncertain = _common([each for i, each in enumerate(scales) if i != foot])
        against = scale.ratio / others
        limit = max(_ONE_APART, _SURE * float(np.hypot(scale.error, uncertain)))
        if abs(against - 1.0) > limit:
            what = (
                f" of {legs.frames[foot]} are {against:.3g} times those of the other feet, by "
                f"their legs' torques, limit {1 - limit:.3g} to {1 + limit:.3g}"
            )
            remedy = "calibrate this sensor and the torques of its leg, or leave its forces out"
            yield found("forces_scale", what=what, remedy=remedy, ratio=against, limit=limit)


def _offset(leg: Leg, scale: Scale, force: Array, least: float) -> Iterator[Finding]:
    """Tell forces (K, 3) that are measured where there are none."""
    offset, limits = scale.shift, np.maximum(least, _SURE * scale.shift_errors)
    told = np.abs(offset) > limits
    if not told.any():
        return
    seen = "while it is down; it is never up, so that torques with an offset would show the same"
    if np.count_nonzero(~leg.down) >= _LEAST_UP:
        in_air = force[~leg.down].mean(axis=0)
        if np.linalg.norm(in_air - offset) > _SAME * np.linalg.norm(offset):
            return  # Torques have it, not the sensor.
        seen = "up as down"
    axis = int(np.argmax(np.where(told, np.abs(offset), 0.0)))
    fields = {"offset": offset, "errors": scale.shift_errors, "limit": limits[axis]}
    yield found("forces_offset", foot=leg.frame, axis="xyz"[axis], seen=seen, **fields)


def _moments(leg: Leg, scale: Scale, moments: Scale) -> Iterator[Finding]:
    """Tell moments of soles of another scale than the forces, or about another point."""
    # Of a sensor that is wrong as a whole the forces tell.
    ratio = moments.ratio / scale.ratio
    limit = max(_MOMENTS_APART, _SURE * float(np.hypot(moments.error, scale.error)))
    if abs(ratio - 1.0) > limit:
        sign = ": they have the wrong sign" if abs(ratio + 1.0) < limit else ""
        numbers = {"ratio": ratio, "error": moments.error, "limit": limit}
        limits = {"least": 1.0 - limit, "most": 1.0 + limit}
        yield found("wrenches_moments", foot=leg.frame, sign=sign, **numbers, **limits)
    most = np.maximum(_POINT, _SURE * moments.shift_errors)
    if np.any(np.abs(moments.shift) > most):
        fields = {"point": moments.shift, "errors": moments.shift_errors, "limits": most}
        yield found("wrenches_point", foot=leg.frame, limit=_POINT, **fields)
