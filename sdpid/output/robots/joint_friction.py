"""Joint friction in a robot's file: as identified, or fitted anew where terms have no place.

A file has room for dry friction, damping and, in MJCF, armature. Identified terms that are no more
than that are written as they are. Else those attributes are written that fit the recorded efforts
best with the identified links held.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.diagnostics.described import described_coulomb, efforts_of_terms, rigid_efforts
from sdpid.estimation.compression.rows import motion_of
from sdpid.estimation.problem import Problem
from sdpid.experiment.preparation.for_robot import SMOOTH
from sdpid.output.robots.places import Kind, Part, Places, Tendon
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.terms import Coulomb, RotorInertia, Viscous

# A joint that was never faster than this, rad/s or m/s, shows friction only within the width of its
# smooth sign: damping fitted there could be anything.
_SLOW = 10.0 * SMOOTH

# What attributes are called in notes, whatever the format calls them.
_WORDS: dict[Kind, str] = {Coulomb: "dry friction", Viscous: "damping", RotorInertia: "armature"}

# In place of efforts that are all zero, N·m.
_TINY = 1e-300


@dataclass(frozen=True)
class LeftOut:
    """A term for which a file has no place.

    Attributes
    ----------
    term : str
        Its kind.
    parameters : tuple of str
        Its parameters.
    share : float or None
        Norm of its efforts over the norm of all measured efforts; None without rows.
    worst : float or None
        Its rms effort at the joint where that is largest, N·m.
    joint : str or None
        That joint.
    """

    term: str
    parameters: tuple[str, ...]
    share: float | None = None
    worst: float | None = None
    joint: str | None = None

    def __str__(self) -> str:
        ends = self.parameters[:1] + self.parameters[1:][-1:]
        names = f"{self.term} {(' … ' if len(self.parameters) > 2 else ', ').join(ends)}"
        if self.share is None:
            return names
        return (
            f"{names}: {100.0 * self.share:.2g} % of the effort, up to {self.worst:.2g} N·m rms at "
            f"joint '{self.joint}'"
        )


@dataclass(frozen=True)
class JointAttributes:
    """Friction as attributes of joints.

    Attributes
    ----------
    values : dict
        Attributes and their numbers by joint name.
    left_out : tuple of LeftOut
        Terms for which there is no attribute.
    notes : tuple of str
        How the numbers differ from the identified ones.
    fitted : bool
        Whether they are not the identified numbers.
    tendons : tuple of Tendon
        Drives of two joints.
    offsets : dict
        Constant efforts by joint name.
    """

    values: dict[str, dict[str, float]]
    left_out: tuple[LeftOut, ...] = ()
    notes: tuple[str, ...] = ()
    fitted: bool = False
    tendons: tuple[Tendon, ...] = ()
    offsets: Mapping[str, float] = field(default_factory=dict)


def joint_attributes(
    problem: Problem,
    theta: Array,
    attributes: Mapping[Kind, str],
    what: str,
    *,
    tendons: bool = False,
    offsets: bool = False,
) -> JointAttributes:
    """Return identified friction as attributes of joints.

    Where every term has an attribute, these are the identified numbers. Else they are fitted
    anew, none negative, joint by joint to the rows of the problem, with its weights and the links
    held. A term without an attribute is taken out of the efforts first, but for the share of it
    that the motion cannot tell from those that have one: an offset is friction where a joint moved
    one way only.

    Parameters
    ----------
    problem : Problem
        Terms and samples. Without rows, curves are fitted at nominal speeds.
    theta : ndarray, shape (p,)
        Standard parameters.
    attributes : mapping
        The attribute for the parameter of a term, with Coulomb and Viscous among them.
    what : str
        Name of the written robot in messages.
    tendons, offsets : bool, optional
        Whether the drive of two joints has a place as a tendon, a constant effort one as an
        actuator.

    Raises
    ------
    ExportError
        When an identified number that is to be written is negative.
    """
    places = Places(problem, theta, attributes, tendons=tendons, offsets=offsets)
    found = _attributes(problem, theta, places, what)
    values = [part.values.tolist() for part in places.offsets]
    return replace(found, offsets=dict(zip(places.joints, *values, strict=True)) if values else {})


def _attributes(problem: Problem, theta: Array, places: Places, what: str) -> JointAttributes:
    """Return what is written of friction: as identified, or else as it fits the rows."""
    values, coupled = places.at_nominal_speeds(), places.tendons
    if not places.curves and not places.lost and places.holds_tendons:
        places.require_nonnegative(what)
        # What a joint has beside a tendon is not its parameter.
        return JointAttributes(places.by_joint(values), fitted=bool(coupled), tendons=coupled)
    if problem.rows is None:
        places.require_nonnegative(what)
        left_out = tuple(LeftOut(type(part.term).__name__, part.names) for part in places.lost)
        return JointAttributes(places.by_joint(values), left_out, fitted=True, tendons=coupled)
    rows = Rows(problem, theta, places)
    for j in np.flatnonzero(rows.shown) if places.kinds else ():
        for kind, value in zip(places.kinds, rows.fitted(int(j)), strict=True):
            values[kind][j] = value
    return JointAttributes(
        places.by_joint(values),
        tuple(rows.left_out(part, lost) for part, lost in zip(places.lost, rows.lost, strict=True)),
        (rows.note(values),) if places.kinds else (),
        fitted=True,
        tendons=coupled,
    )


@dataclass(frozen=True, eq=False)
class System:
    """Weighted equations of a joint's attributes: ``columns @ values = target``.

    Attributes
    ----------
    columns : ndarray, shape (rows, attributes)
        Effort of each attribute's unit.
    target : ndarray, shape (rows,)
        Friction without what has no attribute.
    weight : ndarray, shape (rows,)
        What both were multiplied by.
    taken_out : tuple of float
        Share of each term without a place that was taken out of the friction.
    """

    columns: Array
    target: Array
    weight: Array
    taken_out: tuple[float, ...]


def nonnegative_fit(columns: Array, target: Array) -> Array:
    """Return the values, none negative, that fit ``columns @ values`` to a target best."""
    from scipy.optimize import nnls

    scale = np.linalg.norm(columns, axis=0)
    scale[scale == 0.0] = 1.0
    return np.asarray(nnls(columns / scale, target)[0] / scale)


class Rows:
    """The measured rows of all joints, and what the parts of the model make of them, (K, n)."""

    def __init__(self, problem: Problem, theta: Array, places: Places) -> None:
        self.problem, self.places = problem, places
        samples, first = problem.samples, problem.friction.first
        motion = motion_of(problem.robot, samples, slice(0, samples.n_samples), first=first)
        sharp = described_coulomb(samples)
        terms = [sharp if kind is Coulomb else kind() for kind in places.kinds]
        self.shapes = [term.shape_in(motion) for term in terms]
        self.used = np.ones(motion.velocity.shape, dtype=bool)
        if samples.mask is not None:
            self.used = np.array(samples.mask[:, first:])
        speed = np.where(self.used, np.abs(motion.velocity), 0.0)
        self.shown = speed.max(axis=0) > _SLOW
        self.effort = samples.effort[:, first:]
        self.friction = self._measured_friction(theta)
        self.lost = [self.of_part(part) for part in places.lost]
        # Of tendons: what they add at the joints themselves, and all.
        more = zip(places.kinds, self.shapes, strict=True)
        self.added = sum(
            (shape * places.added()[kind] for kind, shape in more if kind in places.added()),
            np.zeros_like(self.effort),
        )
        held = (*places.coupled, *places.offsets)
        self.held = sum((self.of_part(part) for part in held), self.added)

    def _measured_friction(self, theta: Array) -> Array:
        """Return what the efforts have beside those of the links, and of contacts."""
        problem, samples, first = self.problem, self.problem.samples, self.problem.friction.first
        if samples.contacts is None:
            return self.effort - rigid_efforts(self.places.robot, theta, samples)[:, first:]
        # Forces are those that suit the estimate best: what is left is its friction and errors.
        error = samples.effort - problem.predict(problem.base_of(theta))
        values = theta[10 * problem.robot.n_links :]
        own = efforts_of_terms(problem.robot, problem.friction, values, samples, first=first)
        return error[:, first:] + own

    def of_part(self, part: Part) -> Array:
        """Return the efforts of an identified term."""
        own = self.problem.friction
        terms = FrictionModel.from_terms((part.term,), own.joint_names)
        samples, robot = self.problem.samples, self.problem.robot
        return efforts_of_terms(robot, terms, part.values, samples, first=own.first)

    def fitted(self, j: int) -> Array:
        """Return the values of a joint's attributes that fit its friction best, none negative."""
        system = self.system(j)
        return nonnegative_fit(system.columns, system.target)

    def system(self, j: int) -> System:
        """Return the weighted equations of a joint's attributes."""
        used = self.used[:, j]
        variance = np.diagonal(self.problem.sigma, axis1=-2, axis2=-1)[..., self._first + j]
        weight = 1.0 / np.sqrt(np.broadcast_to(variance, used.shape)[used])
        columns = np.column_stack([shape[used, j] * weight for shape in self.shapes])
        target = (self.friction - self.held)[used, j] * weight
        taken_out = []
        for lost in self.lost:
            effort = lost[used, j] * weight
            size, share = float(effort @ effort), 0.0
            if size > 0.0:
                apart = effort - columns @ np.linalg.lstsq(columns, effort, rcond=None)[0]
                share = float(apart @ apart) / size
                target = target - share * effort
            taken_out.append(share)
        return System(columns, target, weight, tuple(taken_out))

    @property
    def _first(self) -> int:
        return self.problem.friction.first

    def left_out(self, part: Part, efforts: Array) -> LeftOut:
        """Return a term without a place, with the size of its efforts."""
        rms, worst = self._rms(efforts)
        total = float(np.linalg.norm(self.effort[self.used]))
        share = float(np.linalg.norm(efforts[self.used])) / max(total, _TINY)
        joint = self.places.joints[worst]
        return LeftOut(type(part.term).__name__, part.names, share, rms, joint)

    def note(self, values: Mapping[Kind, Array]) -> str:
        """Return how far the friction of the attributes is from the identified one."""
        places, shapes = self.places, zip(self.places.kinds, self.shapes, strict=True)
        difference = np.array(self.added)
        for kind, shape in shapes:
            difference += shape * (values[kind] - places.exact.get(kind, 0.0))
        for part in places.curves:
            difference -= self.of_part(part)
        rms, worst = self._rms(difference)
        names = " and ".join(_WORDS[kind] for kind in places.kinds)
        return (
            f"{names} fitted to the recordings with the identified links held: within {rms:.2g} "
            f"N·m rms of the identified friction (joint '{places.joints[worst]}')"
        )

    def _rms(self, efforts: Array) -> tuple[float, int]:
        """Return the largest rms effort of a joint on the rows, and that joint."""
        squares = np.sum(np.where(self.used, efforts, 0.0) ** 2, axis=0)
        rms = np.sqrt(squares / np.maximum(self.used.sum(axis=0), 1))
        worst = int(np.argmax(rms))
        return float(rms[worst]), worst
