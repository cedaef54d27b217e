"""The effects beside a robot's friction terms that the data may choose.

Each is a small object: its term, whose parameters are the tail of theta and hold its belief (their
deviation), its rule, and its words. `sdpid.estimation.selection` tries them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from sdpid._common.arrays import Array
from sdpid.robot.friction.posed import LoadFriction, PosedTerm, Tilt
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.friction.terms import Coulomb, Coupling, RotorInertia, SigmoidFriction, Stribeck
from sdpid.robot.model.model import RobotModel

# A base that stands askew by more than this is seen by eye, degrees.
_SEEN = 5.0


class Effect(ABC):
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
    place : str
        What a robot must have for it to have a place.
    beside : str or None
        Name of an effect that it is never without.
    bends_friction : bool
        Whether friction speeds that were chosen without it are chosen again with it.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    least_fall: ClassVar[float]
    meaning: ClassVar[str]
    kind: ClassVar[type[FrictionTerm]]
    place: ClassVar[str] = "joints"
    beside: ClassVar[str | None] = None
    bends_friction: ClassVar[bool] = False

    @abstractmethod
    def term(self, robot: RobotModel, terms: Sequence[FrictionTerm]) -> FrictionTerm | None:
        """Return the term to be added to others, or None where it has no place among them."""

    def held(self, terms: Sequence[FrictionTerm]) -> bool:
        """Whether terms hold it already."""
        return any(isinstance(term, self.kind) for term in terms)

    def size(self, parameters: Mapping[str, float]) -> str:
        """Return in words how large the estimated effect is; empty where that says little."""
        return ""

    def doubt(self, parameters: Mapping[str, float]) -> str:
        """Return in words why an effect of the estimated size is not believed, empty if it is."""
        return ""


@dataclass(frozen=True)
class TiltedBase(Effect):
    """Gravity that is not quite where the description says."""

    name: ClassVar[str] = "tilt"
    title: ClassVar[str] = "a tilted base"
    # 17 and 33 % for a tilt of 1.2 degrees on one arm. Falls of 2 and 3 %, for 0.2 and 0.3 degrees
    # in the first 60 % of two arms' records, are 1.3 and 3.1 % in the whole of these records, with
    # probabilities by chance of 0.020 and 0.015: more than is allowed.
    least_fall: ClassVar[float] = 0.04
    meaning: ClassVar[str] = "the base does not stand as described"
    kind: ClassVar[type[FrictionTerm]] = Tilt
    place: ClassVar[str] = "gravity and a base that does not float"

    def term(self, robot: RobotModel, terms: Sequence[FrictionTerm]) -> FrictionTerm | None:
        """Return the two angles of gravity."""
        if robot.free_flyer or not np.any(robot.gravity) or self.held(terms):
            return None
        return Tilt()

    def size(self, parameters: Mapping[str, float]) -> str:
        """Return both angles in degrees."""
        x, y = (np.degrees(parameters[name]) for name in ("Gx", "Gy"))
        return f"gravity is turned by {x:.2f}° about x and {y:.2f}° about y"

    def doubt(self, parameters: Mapping[str, float]) -> str:
        """Doubt angles that anybody would see."""
        angle = float(np.degrees(np.hypot(parameters["Gx"], parameters["Gy"])))
        if angle <= _SEEN:
            return ""
        return (
            f"at {angle:.1f}° it would be seen, so something else is wrong; if the base does stand "
            "like that, say so (load_robot(gravity=...))"
        )


@dataclass(frozen=True)
class FrictionOfLoad(Effect):
    """Coulomb friction that grows with the load of the gears."""

    name: ClassVar[str] = "load"
    title: ClassVar[str] = "friction of the load"
    # 7 to 33 % on arms whose effort is a current, where it lowers held-out errors by a tenth to a
    # third; at most 3 % on others.
    least_fall: ClassVar[float] = 0.04
    meaning: ClassVar[str] = "gears rub more where they carry more"
    kind: ClassVar[type[FrictionTerm]] = LoadFriction
    place: ClassVar[str] = "a base that does not float"

    def term(self, robot: RobotModel, terms: Sequence[FrictionTerm]) -> FrictionTerm | None:
        """Return friction in proportion to the links' efforts, with the Coulomb term's sign."""
        if robot.free_flyer or self.held(terms):
            return None
        return LoadFriction(width=_width_of_sign(terms))

    def size(self, parameters: Mapping[str, float]) -> str:
        """Return the range of the joints' shares."""
        shares = [100.0 * x for name, x in parameters.items() if name.startswith("Fl")]
        return f"{min(shares):.1f} to {max(shares):.1f} % of the load"


@dataclass(frozen=True)
class RotorsInertia(Effect):
    """Inertia of the motors' rotors, felt where the effort is measured at the motor."""

    name: ClassVar[str] = "rotor_inertia"
    title: ClassVar[str] = "rotor inertia"
    # 61 to 83 % on arms whose effort is a current, 25 % at most on others, where it can double the
    # held-out error: inertia that moves with a joint is what every description has wrong.
    least_fall: ClassVar[float] = 0.45
    meaning: ClassVar[str] = "efforts are on the motor side"
    kind: ClassVar[type[FrictionTerm]] = RotorInertia

    def term(self, robot: RobotModel, terms: Sequence[FrictionTerm]) -> FrictionTerm | None:
        """Return an inertia a joint."""
        return None if self.held(terms) else RotorInertia()


@dataclass(frozen=True)
class CoupledWrist(Effect):
    """One motor that turns the last two joints together."""

    name: ClassVar[str] = "coupling"
    title: ClassVar[str] = "a coupled wrist"
    # 13 and 74 % on the one arm with a coupled wrist, 0.1 % on others.
    least_fall: ClassVar[float] = 0.05
    meaning: ClassVar[str] = "one motor turns the last two joints together"
    kind: ClassVar[type[FrictionTerm]] = Coupling
    place: ClassVar[str] = "two joints or more"
    # What the motor adds to both joints cannot be told from what it adds to each without that.
    beside: ClassVar[str | None] = RotorsInertia.name

    def term(self, robot: RobotModel, terms: Sequence[FrictionTerm]) -> FrictionTerm | None:
        """Return the coupling of the last two joints."""
        names = robot.joint_names[robot.n_base :]
        rotors = any(isinstance(term, RotorInertia) for term in terms)
        # The last two joints of a robot on legs are no wrist.
        if len(names) < 2 or robot.free_flyer or self.held(terms) or not rotors:
            return None
        width = _width_of_sign(terms)
        # A motor that turns two joints has one width, not one a joint.
        one = width if isinstance(width, float) else 0.0
        return Coupling(names[-2], names[-1], width=one)


@dataclass(frozen=True)
class FallingFriction(Effect):
    """Friction that falls with speed before it rises (Stribeck)."""

    name: ClassVar[str] = "falling"
    title: ClassVar[str] = "falling friction"
    # 50 to 99 % on simulated arms with a peak of half the Coulomb friction; at most 6 % on real
    # arms, of which one predicts a tenth worse with it.
    least_fall: ClassVar[float] = 0.35
    meaning: ClassVar[str] = "friction falls with speed at first"
    kind: ClassVar[type[FrictionTerm]] = Stribeck
    bends_friction: ClassVar[bool] = True

    def term(self, robot: RobotModel, terms: Sequence[FrictionTerm]) -> FrictionTerm | None:
        """Return a peak of friction about standstill, whose speed the data choose."""
        if self.held(terms):
            return None
        return Stribeck(width=_width_of_sign(terms))


def _width_of_sign(terms: Sequence[FrictionTerm]) -> float | tuple[float, ...]:
    """Return the width of the sign of the Coulomb friction among terms, 0 where there is none."""
    widths = [term.width for term in terms if isinstance(term, Coulomb)]
    return widths[0] if widths and widths[0] is not None else 0.0


EFFECTS: tuple[Effect, ...] = (
    TiltedBase(),
    FrictionOfLoad(),
    RotorsInertia(),
    CoupledWrist(),
    FallingFriction(),
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
