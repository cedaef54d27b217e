"""Say what errors go with, what the model may lack, and what to do about it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from sdpid.assurance.diagnostics.causes import Cause
from sdpid.assurance.diagnostics.validation import Validation
from sdpid.estimation.effects.kinds import Tried
from sdpid.output.report.finding import Finding, listed, percent

# Below this share of its effort an error does not matter, whatever its shape: torque sensors and
# torque constants are hardly known to 2 %.
NEGLIGIBLE = 0.02


@dataclass(frozen=True)
class _Words:
    """Words about a kind of cause.

    Attributes
    ----------
    goes : str
        After "The error goes".
    step : str
        What to do next, where the model has no such term.
    otherwise : str
        What to do next where it has; as `step` where empty.
    term : str
        Name of the class of the term that the model may lack.
    effect : str
        Name of the effect that adds it.
    """

    goes: str
    step: str
    otherwise: str = ""
    term: str = ""
    effect: str = ""


_WARM = "record at the temperature at which the model will be used, and let the robot warm up first"
_WORDS: dict[str, _Words] = {
    "sign": _Words(
        "with the effort itself, and against its sign: the measured effort has the wrong sign",
        "check the sign of the measured effort",
    ),
    "scale": _Words(
        "in proportion to the effort: the measured effort has another unit or scale (torque "
        "constant, gear ratio), or the masses are off by one factor",
        "check the unit, the torque constant and the gear ratio of the measured effort",
    ),
    "direction": _Words(
        "with the direction of motion: Coulomb friction has another level here, or is not in the "
        "model",
        _WARM,
    ),
    "velocity": _Words(
        "in proportion to velocity: viscous friction has changed, as with temperature, or is not "
        "in the model",
        _WARM,
    ),
    "speed": _Words(
        "with speed along a curve, neither a constant nor a line: friction has another shape",
        "try friction of another shape (--friction), and keep it where the held-out error falls",
    ),
    "acceleration": _Words(
        "with acceleration: the inertia of rotors, which efforts from motor currents need, is not "
        "in the model or is off, or efforts come late against the motion",
        "let rotor inertia in (--effects rotor_inertia) if efforts come from motor currents, else "
        "check the delay between effort and position",
        "check the delay between effort and position, and record faster accelerations",
        "RotorInertia",
        "rotor_inertia",
    ),
    "load": _Words(
        "with the load of the gear and the direction of motion: friction grows with load",
        "let friction grow with load (--effects load)",
        "record slow motion under large and small loads, which shows how friction grows",
        "LoadFriction",
        "load",
    ),
    "gravity": _Words(
        "as gravity of another direction would: the base stands tilted, or a link's center of mass "
        "is off",
        "let gravity's direction be found (--effects tilt), or check the base with a level",
        "check what is mounted on the robot",
        "Tilt",
        "tilt",
    ),
    "position": _Words(
        "with the joint's position: an eccentric gear, a spring, a cable, or a wrong zero of the "
        "joint",
        "check the joint's zero and its cables",
    ),
    "frequency": _Words(
        "at one frequency above the motion's: a vibration, or a ripple of the gear",
        "set the filter's cut-off (--cutoff) below that frequency, or move more smoothly",
    ),
}


def goes_with(cause: Cause) -> str:
    """Return what an error goes with, in a clause after "goes"."""
    return _WORDS[cause.kind].goes


def next_step(cause: Cause, terms: frozenset[str], tried: tuple[Tried, ...] = ()) -> str:
    """Return what to do about a cause, which is no effect that was tried and left out.

    Parameters
    ----------
    cause : Cause
        What the error goes with.
    terms : frozenset of str
        Names of the model's classes of terms.
    tried : tuple of Tried, optional
        Effects that were tried on the training data.
    """
    words = _WORDS[cause.kind]
    rejected = [each for each in tried if each.name == words.effect and not each.chosen]
    step = words.otherwise if words.otherwise and (words.term in terms or rejected) else words.step
    if cause.frequency is not None:
        step = step.replace("that frequency", f"{cause.frequency:.3g} Hz")
    for each in rejected:
        fall = "" if each.fall is None else f" and lowers the cost by {percent(each.fall)} alone"
        step += f"; {each.name} was tried{fall}"
    return step


def cause_findings(
    fit: Validation,
    causes: Mapping[str, Cause],
    terms: frozenset[str] | None = None,
    tried: tuple[Tried, ...] = (),
) -> Iterator[Finding]:
    """Yield the joints whose errors go with something, by what they go with.

    Parameters
    ----------
    fit : Validation
        The prediction.
    causes : mapping of str to Cause
        By joint.
    terms : frozenset of str, optional
        Names of the model's classes of terms; without, no step is named.
    tried : tuple of Tried, optional
        Effects that were tried on the training data: those left out are not proposed.
    """
    kinds: dict[str, list[Cause]] = {}
    for cause in causes.values():
        if fit.moving.nrmse[fit.joint_names.index(cause.joint)] >= NEGLIGIBLE:
            kinds.setdefault(cause.kind, []).append(cause)
    for own in kinds.values():
        named = [
            f"{each.joint} ({percent(each.share)}"
            + ("" if each.frequency is None else f" at {each.frequency:.3g} Hz")
            + ")"
            for each in own
        ]
        step = "" if terms is None else f" Next: {next_step(own[0], terms, tried)}."
        yield Finding(
            "caution",
            f"The error goes {goes_with(own[0])}. Share of the error's variance: "
            f"{listed(named, 99)}.{step}",
        )
