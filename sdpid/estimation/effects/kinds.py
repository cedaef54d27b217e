"""The effects beside a robot's friction terms that the data may choose.

Each is a row of a table: its term, whose parameters are the tail of theta and hold its belief
(their deviation), its rule, and its words. `sdpid.estimation.selection` tries them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.robot.friction.posed import LoadFriction, PosedTerm, PositionFriction, Tilt
from sdpid.robot.friction.position import AtJoints, Hysteresis, way_of
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.friction.terms import Coulomb, Coupling, RotorInertia, SigmoidFriction, Stribeck
from sdpid.robot.model.model import RobotModel

# Effects beside the friction terms: by the data ("auto"), none ("none"), or by name, in one string
# too ("tilt,load").
Effects = str | Iterable[str]

# A base that stands askew by more than this is seen by eye, degrees.
_SEEN = 5.0


# A joint that moved less, rad (m), rests.
_LEAST_RANGE = 1e-3

# Elements of hysteresis slip after these shares of a joint's range.
_SLIPS = (0.01, 0.03, 0.1)

# Words about an effect, from its parameters by name.
Words = Callable[[Mapping[str, float]], str]


@dataclass(frozen=True, kw_only=True)
class Effect:
    """An effect that may be added to a model.

    Attributes
    ----------
    name : str
        What it is called in options and results.
    title : str
        What it is called in sentences.
    least_fall : float
        Share by which it must lower the cost of the training data to be chosen.
    meaning : str
        What it says of the robot where it is chosen.
    kind : type
        Of its term.
    made : callable
        From a robot, its other terms and its positions to the term, or None where it has no place
        among them.
    place : str
        What a robot must have for it to have a place.
    by_name : bool
        Whether it is only for who asks for it: no fall of the cost tells where it helps.
    beside : str or None
        Name of an effect that it is never without.
    of_joint : callable or None
        From a joint and the range in which it moves to its own term, where each joint has one:
        they are tried when nothing else is left to choose.
    joint : str or None
        The joint of one of these.
    bends_friction : bool
        Whether friction speeds that were chosen without it are chosen again with it.
    size : callable
        From its parameters by name to words how large it is; empty where that says little.
    doubt : callable
        From its parameters by name to words why that size is not believed; empty if it is.
    """

    name: str
    title: str
    least_fall: float
    meaning: str
    kind: type[FrictionTerm]
    made: Callable[[RobotModel, Sequence[FrictionTerm], Array], FrictionTerm | None]
    place: str = "joints"
    by_name: bool = False
    beside: str | None = None
    of_joint: Callable[[str, float], FrictionTerm] | None = None
    joint: str | None = None
    bends_friction: bool = False
    size: Words = lambda _: ""
    doubt: Words = lambda _: ""

    def held(self, terms: Sequence[FrictionTerm]) -> bool:
        """Whether terms hold it already."""
        own = (term for term in terms if isinstance(term, self.kind))
        return any(self.joint in (None, getattr(term, "joint", None)) for term in own)

    def term(
        self, robot: RobotModel, terms: Sequence[FrictionTerm], position: Array
    ) -> FrictionTerm | None:
        """Return the term to be added to others, or None where it has no place among them."""
        return None if self.held(terms) else self.made(robot, terms, position)

    def each(
        self, robot: RobotModel, terms: Sequence[FrictionTerm], position: Array
    ) -> tuple[Effect, ...]:
        """Return it, or those of the joints that move: where Coulomb friction acts."""
        if self.of_joint is None or robot.free_flyer:
            return (self,)
        joints, found = robot.joint_names, []
        for term in terms:
            if isinstance(term, AtJoints) and isinstance(term.friction, Coulomb):
                joints = tuple(joint for joint in term.joints if isinstance(joint, str)) or joints
        for joint in joints:
            way, _ = way_of(self.title, joint, robot, robot.joint_names)
            moved = float(np.ptp(position @ way))
            if moved >= _LEAST_RANGE:
                own = self.of_joint(joint, moved)
                title = f"{self.title} of {joint}"
                found.append(replace(self, title=title, joint=joint, made=lambda *_, own=own: own))
        return tuple(found)


@dataclass(frozen=True, kw_only=True)
class Tried:
    """One effect that was tried on the data, or asked for.

    Attributes
    ----------
    name : str
        Of the effect, such as ``"tilt"``.
    chosen : bool
        Whether the model holds it.
    words : str
        The outcome in a sentence.
    fall : float or None
        Share by which it lowers the cost of the training data; None where it was not tried.
    least_fall : float or None
        What the fall was measured against.
    probability : float or None
        Of a fall this large by chance, were the effect absent.
    parameters : int
        Number of its parameters.
    """

    name: str
    chosen: bool
    words: str
    fall: float | None = None
    least_fall: float | None = None
    probability: float | None = None
    parameters: int = 0


def _size_of_tilt(parameters: Mapping[str, float]) -> str:
    x, y = np.degrees([parameters["Gx"], parameters["Gy"]])
    return f"gravity is turned by {x:.2f}° about x and {y:.2f}° about y"


def _doubt_of_tilt(parameters: Mapping[str, float]) -> str:
    """Doubt angles that anybody would see."""
    angle = float(np.degrees(np.hypot(parameters["Gx"], parameters["Gy"])))
    if angle <= _SEEN:
        return ""
    return (
        f"at {angle:.1f}° it would be seen, so something else is wrong; if the base does stand "
        "like that, say so (load_robot(gravity=...))"
    )


def _size_of_load(parameters: Mapping[str, float]) -> str:
    shares = [100.0 * x for name, x in parameters.items() if name.startswith("Fl")]
    return f"{min(shares):.1f} to {max(shares):.1f} % of the load"


def _coupling(robot: RobotModel, terms: Sequence[FrictionTerm], _: Array) -> FrictionTerm | None:
    """Return the coupling of the last two joints."""
    names = robot.joint_names[robot.n_base :]
    rotors = any(isinstance(term, RotorInertia) for term in terms)
    # The last two joints of a robot on legs are no wrist.
    if len(names) < 2 or robot.free_flyer or not rotors:
        return None
    width = _width_of_sign(terms)
    # A motor that turns two joints has one width, not one a joint.
    return Coupling(names[-2], names[-1], width=width if isinstance(width, float) else 0.0)


def _over_position(
    robot: RobotModel, terms: Sequence[FrictionTerm], position: Array
) -> FrictionTerm:
    """Return friction over the positions of the samples; a joint that rests has any range."""
    own = position[:, -(robot.n - robot.n_base) :]
    low, high = own.min(axis=0), own.max(axis=0)
    high = np.maximum(high, low + _LEAST_RANGE)
    return PositionFriction(tuple(low), tuple(high), width=_width_of_sign(terms))


def _width_of_sign(terms: Sequence[FrictionTerm]) -> float | tuple[float, ...]:
    """Return the width of the sign of the Coulomb friction among terms, 0 where there is none."""
    widths = [term.width for term in terms if isinstance(term, Coulomb)]
    return widths[0] if widths and widths[0] is not None else 0.0


EFFECTS: tuple[Effect, ...] = (
    # Gravity that is not quite where the description says.
    Effect(
        name="tilt",
        title="a tilted base",
        # 17 and 33 % for a tilt of 1.2 degrees on one arm. Falls of 2 and 3 %, for 0.2 and 0.3
        # degrees in the first 60 % of two arms' records, are 1.3 and 3.1 % in the whole of these
        # records, with probabilities by chance of 0.020 and 0.015: more than is allowed.
        least_fall=0.04,
        meaning="the base does not stand as described",
        kind=Tilt,
        made=lambda robot, *_: None if robot.free_flyer or not np.any(robot.gravity) else Tilt(),
        place="gravity and a base that does not float",
        size=_size_of_tilt,
        doubt=_doubt_of_tilt,
    ),
    # Coulomb friction that grows with the load of the gears.
    Effect(
        name="load",
        title="friction of the load",
        # 7 to 33 % on arms whose effort is a current, where it lowers held-out errors by a tenth
        # to a third; at most 3 % on others.
        least_fall=0.04,
        meaning="gears rub more where they carry more",
        kind=LoadFriction,
        made=lambda robot, terms, _: (
            None if robot.free_flyer else LoadFriction(width=_width_of_sign(terms))
        ),
        place="a base that does not float",
        size=_size_of_load,
    ),
    # Inertia of the motors' rotors, felt where the effort is measured at the motor.
    Effect(
        name="rotor_inertia",
        title="rotor inertia",
        # 61 to 83 % on arms whose effort is a current, 25 % at most on others, where it can double
        # the held-out error: inertia that moves with a joint is what every description has wrong.
        least_fall=0.45,
        meaning="efforts are on the motor side",
        kind=RotorInertia,
        made=lambda *_: RotorInertia(),
    ),
    # One motor that turns the last two joints together.
    Effect(
        name="coupling",
        title="a coupled wrist",
        # 13 and 74 % on the one arm with a coupled wrist, 0.1 % on others.
        least_fall=0.05,
        meaning="one motor turns the last two joints together",
        kind=Coupling,
        made=_coupling,
        place="two joints or more",
        # What the motor adds to both joints cannot be told from what it adds to each without that.
        beside="rotor_inertia",
    ),
    # Friction that falls with speed before it rises (Stribeck); the data choose the speed.
    Effect(
        name="falling",
        title="falling friction",
        # 50 to 99 % on simulated arms with a peak of half the Coulomb friction; at most 6 % on
        # real arms, of which one predicts a tenth worse with it.
        least_fall=0.35,
        meaning="friction falls with speed at first",
        kind=Stribeck,
        made=lambda _, terms, __: Stribeck(width=_width_of_sign(terms)),
        bends_friction=True,
    ),
    # Coulomb friction that changes with the position. Nothing tells where it helps: with a fall
    # of 16 % on one arm the error on another record grows by a fifth, with one of 11 % on another
    # arm it falls by a tenth. Under a known law rollouts of a part of the log tell.
    Effect(
        name="position",
        title="friction over position",
        least_fall=0.2,
        by_name=True,
        meaning="gears and cables rub more in some positions",
        kind=PositionFriction,
        made=_over_position,
    ),
    # Dry friction that builds up over a way.
    Effect(
        name="hysteresis",
        title="hysteresis",
        # 27 % at a joint that tendons move, and as much on blocks of time that are left out. At
        # most 10 % on others: at the one of 10 % held-out errors fall by a tenth, in all by 3 %.
        least_fall=0.15,
        meaning="its friction builds up over a way",
        kind=Hysteresis,
        made=lambda *_: None,
        place="a base that does not float",
        of_joint=lambda joint, moved: Hysteresis(joint, tuple(s * moved for s in _SLIPS)),
    ),
)


def at_estimate(
    term: FrictionTerm,
    bodies: Array,
    friction: Mapping[str, float],
    terms: Sequence[FrictionTerm],
) -> FrictionTerm:
    """Return a term with its columns taken at an estimate, where they depend on it.

    Parameters
    ----------
    term : FrictionTerm
        Of an effect; others are returned as they are.
    bodies : ndarray, shape (links, 10)
        The estimate's links.
    friction : mapping of str to float
        Its parameters by name.
    terms : sequence of FrictionTerm
        Its terms, without open parameters.
    """
    if not isinstance(term, PosedTerm):
        return term
    moved = replace(term, bodies=tuple(tuple(float(x) for x in body) for body in bodies))
    sigmoids = [each for each in terms if isinstance(each, SigmoidFriction)]
    if not (isinstance(moved, LoadFriction) and sigmoids):
        return moved
    # Friction of the load bends where the joint's other friction does.
    n = sum(1 for name in friction if name.startswith("Fsg"))
    parts = np.array([[friction.get(f"{s}{j + 1}", 0.0) for j in range(n)] for s in ("Fs", "Fsg")])
    total = np.maximum(parts.sum(axis=0), np.finfo(float).tiny)
    share = np.clip(parts[1] / total, 0.0, 1.0)
    speeds = sigmoids[0].speed("velocity", n)
    return replace(moved, share=tuple(share.tolist()), velocity=tuple(speeds.tolist()))


def names_of_effects(effects: Effects) -> tuple[str, ...] | None:
    """Return the names of the effects that are asked for; None leaves the choice to the data.

    Raises
    ------
    DataError
        For an unknown name, and for what holds no names.
    """
    known = [effect.name for effect in EFFECTS]
    remedy = f"use 'auto', 'none' or some of {', '.join(known)}"
    try:
        given = effects.split(",") if isinstance(effects, str) else tuple(effects)
    except TypeError:
        raise DataError(f"effects: is {effects!r}; {remedy}.") from None
    names = tuple(name.strip() if isinstance(name, str) else name for name in given)
    if names in (("auto",), ("none",)):
        return None if names == ("auto",) else ()
    for name in names:
        if name not in known:
            raise DataError(f"effects: no effect is called {name!r}; {remedy}.")
    return names
