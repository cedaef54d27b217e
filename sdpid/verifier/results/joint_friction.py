"""Compare the friction of joints in a robot's file with certified parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ..reading import shown
from ..result import Result

# What a file of a robot has room for: dry friction, damping, armature.
_SYMBOLS = ("Fs", "Fv", "Ia")


@dataclass(frozen=True)
class Friction:
    """Certified parameters of joints, and whether a file claims to hold them.

    Attributes
    ----------
    joints : sequence of str
        The joints that parameters are of: parameter ``Fs2`` is of the second.
    parameters : mapping of str to float
        All certified parameters by name.
    fitted : bool
        Whether the file says that its friction was fitted to efforts anew, because it has no
        place for some of the parameters.
    """

    joints: Sequence[str]
    parameters: Mapping[str, float]
    fitted: bool

    @classmethod
    def of(cls, joints: Sequence[str], parameters: Mapping[str, float], fitted: bool) -> Friction:
        """Return the friction of a robot; a floating base's coordinates come first, without any."""
        numbers = range(1, len(joints) + 1)
        count = max(sum(f"{symbol}{k}" in parameters for k in numbers) for symbol in _SYMBOLS)
        return cls(joints[len(joints) - count :], parameters, fitted)


def compared(
    found: Mapping[str, Mapping[str, float]], friction: Friction, places: Mapping[str, str]
) -> Result:
    """Compare the attributes of joints with the parameters that belong there, by their symbols."""
    if friction.fitted:
        return Result(
            unchecked=(
                "friction of the joints: result.json says that it was fitted to the efforts anew, "
                "since not all parameters have a place there; the certificate does not tell it",
            )
        )
    problems, equal = [], set()
    for number, joint in enumerate(friction.joints, 1):
        for attribute, symbol in places.items():
            if (value := friction.parameters.get(f"{symbol}{number}")) is None:
                continue
            # What a solver left below zero is written as zero.
            wanted, given = max(value, 0.0), found.get(joint, {}).get(attribute)
            equal.add(attribute)
            if given != wanted:
                problems.append(
                    f"joint {shown(joint)}: {attribute} is {given!r}, the certified parameter "
                    f"{symbol}{number} is {wanted!r}"
                )
    for joint in found.keys() - set(friction.joints):
        for attribute in equal:
            if value := found[joint].get(attribute, 0.0):
                problems.append(
                    f"joint {shown(joint)}: {attribute} is {value!r}, and its friction counts at "
                    "the joint that it follows"
                )
    others = [attribute for attribute in places if attribute not in equal]
    unchecked = (f"{', '.join(others)} of the joints: no certified parameter",) if others else ()
    if problems or not equal:
        return Result(problems=tuple(problems), unchecked=unchecked)
    symbols = " and ".join(places[attribute] for attribute in places if attribute in equal)
    said = f"the joints have the certified friction, {symbols}."
    return Result((said,), unchecked=unchecked)
