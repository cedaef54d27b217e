"""Joint friction in a robot's file: as identified, or fitted anew where terms have no place.

A file has room for dry friction, damping and, in MJCF, armature. Identified terms that are no more
than that are written as they are. Else those attributes are written that fit the recorded efforts
best with the identified links held.

A fixed tendon of MuJoCo is as long as a sum of joints' positions times factors: what moves no joint
alone, such as motors of a transmission, or the one of a `Coupling`, becomes a tendon.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.polynomial import Polynomial

from sdpid._common.arrays import Array
from sdpid.assurance.diagnostics.described import (
    described_coulomb,
    efforts_of_terms,
    rigid_efforts,
)
from sdpid.errors import ExportError
from sdpid.estimation.compression.rows import motion_of
from sdpid.estimation.problem import Problem
from sdpid.experiment.preparation.prepare import SMOOTH
from sdpid.output.robots.position_tendons import BentFriction, bent_friction
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.posed import PositionFriction, Tilt
from sdpid.robot.friction.position import AtJoints, Spring
from sdpid.robot.friction.term import FrictionTerm, JointwiseTerm
from sdpid.robot.friction.terms import Coulomb, Coupling, Offset, RotorInertia, Viscous
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.robot.model.model import RobotModel

Kind = type[JointwiseTerm]

# What attributes are called in notes, whatever the format calls them.
_WORDS: dict[Kind, str] = {Coulomb: "dry friction", Viscous: "damping", RotorInertia: "armature"}

# Friction negative by no more than this (N·m, N·m·s/rad) is zero with a solver's rounding.
_FRICTION_ZERO = 1e-9

# Springs are at rest where their effort is this share of its largest factor: a solver of roots is
# far nearer.
_AT_REST = 1e-9

# Speeds, rad/s or m/s, up to which a curve is fitted where no recording says otherwise.
_NOMINAL = 1.0

# A joint that was never faster than this, rad/s or m/s, shows friction only within the width of its
# smooth sign: damping fitted there could be anything.
_SLOW = 10.0 * SMOOTH

# What dry friction is called: at a position that moves faster by a factor it is less by that, all
# else by its square.
_DRY = ("friction", "frictionloss")

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


class Tendon(NamedTuple):
    """A position that moves no joint alone: factors (joints,) of coordinates, and attributes."""

    way: Array
    attributes: dict[str, Any]


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
    tendons : dict
        What motors have that move no joint alone, by their names.
    offsets : dict
        Constant efforts by joint name.
    bent : dict
        Friction over position by joint name, as tendons.
    """

    values: dict[str, dict[str, Any]]
    left_out: tuple[LeftOut, ...] = ()
    notes: tuple[str, ...] = ()
    fitted: bool = False
    tendons: Mapping[str, Tendon] = field(default_factory=dict)
    offsets: Mapping[str, float] = field(default_factory=dict)
    bent: Mapping[str, BentFriction] = field(default_factory=dict)


def joint_attributes(
    problem: Problem,
    theta: Array,
    attributes: Mapping[Kind, str],
    what: str,
    also: Collection[Role] = (),
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
    also : collection of str, optional
        What has a place too: drives of two joints as tendons (``"coupled"``), constant efforts as
        actuators (``"offset"``), friction over position as tendons (``"bent"``), and springs and
        what motors have that move no joint alone (``"spring"``).

    Raises
    ------
    ExportError
        When an identified number that is to be written is negative.
    """
    places = Places(problem, theta, attributes, also)
    values, notes = places.at_nominal_speeds(), tuple[str, ...]()
    left_out = [LeftOut(type(part.term).__name__, part.names) for part in places.of("lost")]
    exact = not places.of("curve") and not places.of("lost") and places.holds_tendons
    if exact or problem.rows is None:
        places.require_nonnegative(what)
    else:
        rows = MeasuredRows(problem, theta, places)
        for j in np.flatnonzero(rows.shown) if places.kinds else ():
            system = rows.system(int(j))
            fit = nonnegative_fit(system.columns, system.target)
            for kind, value in zip(places.kinds, fit, strict=True):
                values[kind][j] = value
        left_out = list(map(rows.left_out, places.of("lost"), rows.lost))
        notes = (rows.note(values),) if places.kinds else ()
    bends = dict[str, BentFriction]()
    for part in places.of("bent"):
        bends |= zip(places.joints, bent_friction(part.term, part.values), strict=True)
    if bends:
        constant = np.array([bends[joint].own for joint in places.joints])
        values[Coulomb] = values.get(Coulomb, 0.0) + constant
        worst = max(bends, key=lambda joint: bends[joint].error)
        notes += (
            f"friction over position is {sum(len(x.tendons) for x in bends.values())} tendons, "
            f"within {bends[worst].error:.2g} N·m of the identified one (joint '{worst}')",
        )
    seats = Seats(problem.robot, places.joints)
    rows_of = [(kind, places.joints, numbers) for kind, numbers in values.items()]
    for part in places.of("behind"):
        own = part.term.friction
        rows_of.append((type(own), part.term.names, part.values))
        if isinstance(own, Coulomb) and not _sharp(own):
            notes += ("dry friction of joints behind the transmission lacks its smooth sign",)
    for kind, names, numbers in rows_of:
        for name, value in zip(names, numbers.tolist(), strict=True):
            seats.add(name, attributes[kind], value)
    for part in places.of("spring"):
        seats.add_spring(part)
    motors = seats.tendons()
    if "spring" not in also:
        if left := ", ".join(name for name, each in motors.items() if each.attributes):
            notes += (f"no place for friction of motors that move joints together: {left}",)
        motors = {}
    return JointAttributes(
        seats.values(),
        tuple(left_out),
        notes + seats.notes,
        # What a joint has beside a tendon is not its parameter.
        fitted=not exact or bool(places.tendons),
        tendons=motors | places.tendons,
        offsets={name: x for part in places.of("offset") for name, x in places.named(part)},
        bent=bends,
    )


class Seats:
    """Attributes of motors and joints, each about its own position, and where they are written."""

    def __init__(self, robot: RobotModel, joints: Sequence[str]) -> None:
        self._robot, self._joints = robot, joints
        self._held: dict[str, dict[str, Any]] = {}
        self.notes: tuple[str, ...] = ()

    def add(self, name: str, attribute: str, value: float) -> None:
        """Add a number of a motor, or of a joint behind the transmission."""
        held = self._held.setdefault(name, {})
        held[attribute] = held.get(attribute, 0.0) + value

    def add_spring(self, part: Part) -> None:
        """Add a spring, whose effort is a polynomial of the position less its rest."""
        term, (stiffness, *others) = part.term, part.values.tolist()
        rest = term.rest if term.rest is not None else others[0] / (stiffness or 1.0)
        if stiffness <= _FRICTION_ZERO:
            self.notes += (f"no place for the spring of {term.joint}: its stiffness is zero",)
            return
        powers = [stiffness, *others] if term.polynomial else stiffness
        self._held.setdefault(term.joint, {}).update(stiffness=powers, springref=rest)

    def values(self) -> dict[str, dict[str, Any]]:
        """Return what joints have: their own, and that of motors that move them alone."""
        found: dict[str, dict[str, Any]] = {}
        for name, attributes in self._held.items():
            joint, factor = self._robot.seat(name)
            shift = self._robot.way({joint: 1.0})[1] if joint and name in self._joints else 0.0
            place = found.setdefault(joint, {}) if joint else {}
            own = of_position(attributes, factor, shift)
            springs = one_spring([each for each in (place, own) if "stiffness" in each], joint)
            for key, value in own.items():
                place[key] = springs[key] if key in springs else value + place.get(key, 0.0)
        return found

    def tendons(self) -> dict[str, Tendon]:
        """Return the motors that move no joint alone, and what they have."""
        units = zip(self._joints, np.eye(len(self._joints)), strict=True)
        alone = {name: unit for name, unit in units if not self._robot.seat(name)[0]}
        return {name: Tendon(unit, self._held.get(name, {})) for name, unit in alone.items()}


def one_spring(springs: Sequence[Mapping[str, Any]], joint: str) -> dict[str, Any]:
    """Return stiffness and rest of the springs at a joint together.

    Raises
    ------
    ExportError
        When no position is one of rest: quadratic efforts may be of one sign.
    """
    if len(springs) < 2:
        return {key: each[key] for each in springs for key in ("stiffness", "springref")}
    effort = Polynomial([0.0])
    for each in springs:
        way = Polynomial([-each["springref"], 1.0])
        effort = effort + way * Polynomial(np.atleast_1d(each["stiffness"]))(way)
    # A cubic effort may be zero at several positions: all springs do the same about any.
    roots = effort.roots()
    rest = float(roots[np.argmin(np.abs(roots.imag))].real)
    if abs(effort(rest)) > _AT_REST * np.abs(effort.coef).max():
        raise ExportError(
            f"joint '{joint}': its spring and that of its motor are nowhere at rest together, as "
            "springs of MuJoCo are; give one of them without a polynomial."
        )
    powers = effort(Polynomial([rest, 1.0])).coef[1:].tolist()
    return {"stiffness": powers if len(powers) > 1 else powers[0], "springref": rest}


def of_position(attributes: Mapping[str, Any], factor: float, shift: float) -> dict[str, Any]:
    """Return the attributes of ``factor·x + shift``, given those of a position x."""
    found = dict(attributes)
    for key, value in attributes.items():
        if key == "springref":
            found[key] = factor * value + shift
            continue
        powers = np.atleast_1d(value)
        scaled = powers / np.abs(factor) ** (1 if key in _DRY else 2)
        scaled = scaled / factor ** np.arange(len(powers))
        found[key] = scaled.tolist() if len(powers) > 1 else float(scaled[0])
    return found


# What a term is in a file: an attribute of a joint's own, one of a joint behind a transmission, and
# so on; none, but a note elsewhere, as a tilt.
Role = Literal["held", "curve", "lost", "coupled", "offset", "bent", "behind", "spring", "noted"]
_ROLES: dict[type[FrictionTerm], Role] = {
    PositionFriction: "bent",
    Coupling: "coupled",
    Spring: "spring",
    Tilt: "noted",
}
# Those that not every file has a place for, and those that have one beside the attributes.
_ASKED = ("coupled", "offset", "bent", "spring")
_PLACED: tuple[Role, ...] = ("coupled", "offset", "behind", "spring")


class Part(NamedTuple):
    """A term, the names of its parameters, and their values."""

    # Its class depends on its role.
    term: Any
    names: tuple[str, ...]
    values: Array


class Places:
    """The terms of a problem by what a file can hold of them.

    Attributes
    ----------
    exact : dict of term to ndarray, shape (n,)
        Terms that have an attribute, and their values, negative ones as zero.
    tendons : dict
        Drives of two joints, by name.
    added : dict of term to ndarray, shape (n,)
        Armature and damping that they add at the joints themselves.
    holds_tendons : bool
        Whether the joints have all of that.
    kinds : list
        The terms whose attributes are written.
    robot : RobotModel
        The robot, under gravity as a tilt of the base turns it.

    Parameters
    ----------
    problem : Problem
        Terms and samples.
    theta : ndarray, shape (p,)
        Standard parameters.
    attributes : mapping
        The attribute for the parameter of a term, with Coulomb and Viscous among them.
    also : collection of str, optional
        What has a place too (see `joint_attributes`).
    """

    def __init__(
        self,
        problem: Problem,
        theta: Array,
        attributes: Mapping[Kind, str],
        also: Collection[Role] = (),
    ) -> None:
        model = RobotDynamics(robot=problem.robot, terms=problem.friction, theta=theta)
        # Every file has room for the direction of gravity.
        self.robot = problem.robot.with_gravity(model.tilted_gravity)
        self.joints, self._attributes = problem.friction.joint_names, attributes
        self._parts: dict[Role, list[Part]] = {}
        for term, own in problem.friction.placed:
            role = _role(term, attributes)
            if role in _ASKED and role not in also:
                role = "curve" if role == "bent" else "lost"
            names = tuple(p.name for p in problem.friction.parameters[own])
            part = Part(term, names, theta[10 * problem.robot.n_links :][own])
            self._parts.setdefault(role, []).append(part)
        self.exact: dict[Kind, Array] = {
            type(part.term): np.maximum(part.values, 0.0) for part in self.of("held")
        }
        self._couple()
        if np.any(self.added[RotorInertia] > self.exact.get(RotorInertia, 0.0)):
            # Tendons that add more armature than the joints have: what is left is none.
            self._parts["lost"] = [*self._parts.pop("coupled"), *self.of("lost")]
            self._couple()
        self.holds_tendons = all(
            bool(np.all(more <= self.exact.get(kind, 0.0))) for kind, more in self.added.items()
        )
        stand_in = {Coulomb, Viscous} if self.of("curve") or self.of("coupled") else set()
        self.kinds = [kind for kind in attributes if kind in self.exact or kind in stand_in]

    def of(self, role: Role) -> list[Part]:
        """Return the terms of a role."""
        return self._parts.get(role, [])

    def named(self, part: Part) -> Iterator[tuple[str, float]]:
        """Yield the joints of a term and their values."""
        yield from zip(getattr(part.term, "joints", self.joints), part.values.tolist(), strict=True)

    def _couple(self) -> None:
        """Note the tendons of drives of two joints, and what they add at the joints."""
        self.tendons: dict[str, Tendon] = {}
        self.added: dict[Kind, Array] = {
            kind: np.zeros(len(self.joints)) for kind in (RotorInertia, Viscous)
        }
        every = (x for p in self.of("coupled") for x in p.term.acting(p.values, self.joints))
        for term, places, values in every:
            kind = type(term)
            for place, value in zip(places, values.tolist(), strict=True):
                way = np.array(place)
                if np.count_nonzero(way) == 1:
                    # What the joint has of its own beside the motor.
                    self.added[kind] -= value * way
                elif value > 0.0:
                    numbers = "_".join(str(j + 1) for j in np.flatnonzero(way))
                    name = f"coupling_{numbers}" + ("_difference" if np.any(way < 0.0) else "")
                    held = self.tendons.setdefault(name, Tendon(way, {})).attributes
                    held[self._attributes[kind]] = value

    def require_nonnegative(self, what: str) -> None:
        """Refuse identified values that have an attribute and are negative.

        Raises
        ------
        ExportError
            With the parameter, its joint and its value.
        """
        for part in self.of("held"):
            parameters = part.term.parameters(self.joints)
            for joint, parameter, value in zip(self.joints, parameters, part.values, strict=True):
                if value < -_FRICTION_ZERO:
                    raise ExportError(
                        f"{what}: {parameter.name} of joint '{joint}' is {value:.3g} "
                        f"{parameter.unit}, the least is 0; solve with "
                        "Constraints(friction_nonnegative=True)."
                    )

    def at_nominal_speeds(self) -> dict[Kind, Array]:
        """Return values (n,) for the attributes, without a look at recorded efforts.

        Curves become the dry friction and damping, none negative, that fit them best at speeds up
        to a nominal one. What tendons add at the joints is taken off, down to zero.
        """
        from scipy.optimize import nnls

        found = {kind: np.zeros(len(self.joints)) for kind in self.kinds} | self.exact
        if self.of("curve"):
            speeds = np.linspace(-_NOMINAL, _NOMINAL, 101)
            v = np.tile(speeds[:, None], (1, len(self.joints)))
            effort = np.zeros_like(v)
            for part in self.of("curve"):
                if isinstance(part.term, PositionFriction):
                    effort += np.sign(v) * part.values.reshape(3, -1).mean(axis=0)
                    continue
                effort += part.term.columns(v, np.zeros_like(v), self.joints) @ part.values
            columns = np.column_stack([np.sign(speeds), speeds])
            fits = np.array([nnls(columns, each)[0] for each in effort.T])
            found[Coulomb] = found[Coulomb] + fits[:, 0]
            found[Viscous] = found[Viscous] + fits[:, 1]
        return {kind: np.maximum(x - self.added.get(kind, 0.0), 0.0) for kind, x in found.items()}


def _role(term: FrictionTerm, attributes: Mapping[Kind, str]) -> Role:
    """Return what a term is in a file that has room for everything but curves of the speed."""
    acting = term.friction if isinstance(term, AtJoints) else term
    if isinstance(term, AtJoints) and not all(isinstance(x, str) for x in term.joints):
        return "lost"
    if isinstance(acting, Offset):
        return "offset"
    if acting is not term and type(acting) in attributes:
        return "behind"
    for kind, role in _ROLES.items():
        if isinstance(term, kind):
            return role
    if term.curve or (isinstance(term, Coulomb) and not _sharp(term)):
        return "curve"
    return "held" if isinstance(term, JointwiseTerm) and type(term) in attributes else "lost"


def _sharp(term: Coulomb) -> bool:
    """Return whether Coulomb friction is as sharp as that of a description."""
    widths = np.atleast_1d(np.asarray(term.width, dtype=np.float64))
    return term.dead_zone == 0.0 and bool(np.all(widths <= SMOOTH))


class System(NamedTuple):
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


class MeasuredRows:
    """The measured rows of all joints, and what the parts of the model make of them, (K, n)."""

    def __init__(self, problem: Problem, theta: Array, places: Places) -> None:
        self.problem, self.places = problem, places
        samples, self._first = problem.samples, problem.friction.first
        motion = motion_of(problem.robot, samples, slice(0, samples.n_samples), first=self._first)
        terms = [described_coulomb(samples) if k is Coulomb else k() for k in places.kinds]
        self._shapes = dict(zip(places.kinds, (t.shape_in(motion) for t in terms), strict=True))
        self.used = np.ones(motion.velocity.shape, dtype=bool)
        if samples.mask is not None:
            self.used = np.array(samples.mask[:, self._first :])
        speed = np.where(self.used, np.abs(motion.velocity), 0.0)
        self.shown = speed.max(axis=0) > _SLOW
        self._effort = samples.effort[:, self._first :]
        self.lost = [self._of_part(part) for part in places.of("lost")]
        # What tendons add at the joints themselves, and all that has a place of its own.
        self._added = self._of_attributes(places.added)
        held = (part for role in _PLACED for part in places.of(role))
        self._held = sum(map(self._of_part, held), self._added)
        self._friction = self._measured_friction(theta)

    def _measured_friction(self, theta: Array) -> Array:
        """Return what the efforts have beside those of the links, and of contacts."""
        problem, samples, first = self.problem, self.problem.samples, self._first
        if samples.contacts is None:
            return self._effort - rigid_efforts(self.places.robot, theta, samples)[:, first:]
        # Forces are those that suit the estimate best: what is left is its friction and errors.
        error = samples.effort - problem.predict(problem.base_of(theta))
        values = theta[10 * problem.robot.n_links :]
        own = efforts_of_terms(problem.robot, problem.friction, values, samples, first=first)
        return error[:, first:] + own

    def _of_part(self, part: Part) -> Array:
        """Return the efforts of an identified term."""
        own = self.problem.friction
        terms = FrictionModel.from_terms((part.term,), own.joint_names)
        samples, robot = self.problem.samples, self.problem.robot
        return efforts_of_terms(robot, terms, part.values, samples, first=own.first)

    def _of_attributes(self, values: Mapping[Kind, Array]) -> Array:
        """Return the efforts of values (n,) of the attributes that are written."""
        return sum(
            (shape * values.get(kind, 0.0) for kind, shape in self._shapes.items()),
            np.zeros_like(self._effort),
        )

    def system(self, j: int) -> System:
        """Return the weighted equations of a joint's attributes."""
        used = self.used[:, j]
        variance = np.diagonal(self.problem.sigma, axis1=-2, axis2=-1)[..., self._first + j]
        weight = 1.0 / np.sqrt(np.broadcast_to(variance, used.shape)[used])
        columns = np.column_stack([x[used, j] * weight for x in self._shapes.values()])
        target = (self._friction - self._held)[used, j] * weight
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

    def left_out(self, part: Part, efforts: Array) -> LeftOut:
        """Return a term without a place, with the size of its efforts."""
        rms, joint = self._largest(efforts)
        total = float(np.linalg.norm(self._effort[self.used]))
        share = float(np.linalg.norm(efforts[self.used])) / max(total, _TINY)
        return LeftOut(type(part.term).__name__, part.names, share, rms, joint)

    def note(self, values: Mapping[Kind, Array]) -> str:
        """Return how far the friction of the attributes is from the identified one."""
        exact = self.places.exact
        changes = {kind: value - exact.get(kind, 0.0) for kind, value in values.items()}
        difference = self._added + self._of_attributes(changes)
        rms, joint = self._largest(difference - sum(map(self._of_part, self.places.of("curve"))))
        names = " and ".join(_WORDS[kind] for kind in self.places.kinds)
        return (
            f"{names} fitted to the recordings with the identified links held: within {rms:.2g} "
            f"N·m rms of the identified friction (joint '{joint}')"
        )

    def _largest(self, efforts: Array) -> tuple[float, str]:
        """Return the largest rms effort of a joint on the rows, and that joint."""
        squares = np.sum(np.where(self.used, efforts, 0.0) ** 2, axis=0)
        rms = np.sqrt(squares / np.maximum(self.used.sum(axis=0), 1))
        worst = int(np.argmax(rms))
        return float(rms[worst]), self.places.joints[worst]
