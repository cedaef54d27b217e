"""Findings about a prediction: what is explained, what errors go with, what holds joints back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from sdpid._common.kept import kept
from sdpid.assurance.diagnostics.active_constraints import cost_of_constraints
from sdpid.assurance.diagnostics.causes import Cause, find_causes, held_back, joint_errors
from sdpid.assurance.diagnostics.held_out import LEAST_SQUARES
from sdpid.assurance.diagnostics.rest import rest_speeds
from sdpid.assurance.diagnostics.validation import Validation
from sdpid.errors import SdpidError
from sdpid.estimation.effects.kinds import Tried
from sdpid.experiment.processing.samples import Samples
from sdpid.output.report.grades import MARGIN, SMALL, Finding, Grade, graded, listed, percent
from sdpid.output.report.judged import Judged
from sdpid.robot.model.model import RobotModel

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


def prediction_findings(
    robot: RobotModel, samples: Samples, fit: Validation
) -> tuple[Finding, ...]:
    """Return the findings about a prediction of one recording by a robot's description.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    samples : Samples
        The measurements that were predicted.
    fit : Validation
        Their prediction.

    Returns
    -------
    tuple of Finding
        The most important first.
    """
    return (
        *effort_findings(samples, fit, "this recording"),
        *cause_findings(
            fit, find_causes(robot, robot.prior, samples, fit, joint_errors(samples, fit))
        ),
    )


def effort_findings(
    samples: Samples, fit: Validation, where: str, given: tuple[Grade, ...] | None = None
) -> Iterator[Finding]:
    """Yield which joints' efforts are predicted well, roughly or badly; `where` names the data.

    By the given grades, or else by those of this prediction alone.
    """
    given = tuple(graded(samples, fit)) if given is None else given
    named: dict[str, list[str]] = {
        key: [] for key in ("good", "caution", "bad", "still", "flat", "unshown")
    }
    for each in given:
        name, words = fit.joint_names[each.joint], _explained(fit, each.joint)
        if not each.moved:
            limit = f"{rest_speeds(fit.slides)[each.joint]:g}"
            unit = "m/s" if fit.slides[each.joint] else "rad/s"
            named["still"].append(f"{name} (never faster than {limit} {unit})")
        elif not each.shown:
            named["unshown"].append(f"{name} ({words})")
        elif each.level == "caution" and float(fit.moving.r2[each.joint]) < 0.0:
            named["flat"].append(f"{name} ({words})")
        else:
            named[each.level].append(f"{name} ({words})")
    if named["good"]:
        every = len(named["good"]) == len(fit.joint_names) - fit.n_base
        which = "every joint" if every else "the joints"
        yield Finding(
            "good",
            f"Trust it for the effort of {which} in motion like the recorded, as feed-forward and "
            f"simulation need; share of the effort's variance explained on {where}: "
            f"{listed(named['good'], 99)}.",
        )
    if named["unshown"]:
        yield Finding(
            "caution",
            f"Not shown on other motion: {listed(named['unshown'], 99)}. In brackets: share of the "
            f"effort's variance explained on {where}. That is the same motion, and errors on "
            f"another are up to {MARGIN:g} times as large and more: too large there to be sure. "
            "Record another motion and give it with --validation.",
        )
    if named["caution"]:
        yield Finding(
            "caution",
            f"Expect it to be roughly right, not exact, for {listed(named['caution'], 99)}; "
            "feedback has to make up for the rest. In brackets: share of the effort's variance "
            f"explained on {where}.",
        )
    if named["flat"]:
        yield Finding(
            "caution",
            f"Do not rely on it for how the effort varies of {listed(named['flat'], 99)}: on "
            f"{where} the effort is nearly constant. The error is small beside it (limit "
            f"{percent(SMALL)}), but its mean predicts better. Validate on a motion in which the "
            "effort varies.",
        )
    if named["bad"]:
        yield Finding(
            "bad",
            f"Do not trust it for the effort of {listed(named['bad'], 99)}: too little of the "
            "variance is explained. Contact cannot be told from model error there.",
            f"trust the effort of {listed(named['bad'], 99)}; in brackets: variance explained",
        )
    if named["still"]:
        yield Finding(
            "bad",
            f"Joints that did not move on {where}: {listed(named['still'], 99)}. How well "
            "their effort is predicted in motion is not known. Record them moving.",
            f"trust the effort of {listed(named['still'], 99)} in motion",
        )
    yield from _rest(fit)


def _rest(fit: Validation) -> Iterator[Finding]:
    """Yield by how much the effort is missed at rest, where it is missed by more than in motion."""
    rest = fit.resting
    if rest is None or not fit.moving.rows.any() or rest.relative <= fit.moving.relative:
        return
    yield Finding(
        "caution",
        f"At rest ({percent(resting_share(fit))} of the rows) the error is "
        f"{percent(rest.relative)} of the effort, in motion {percent(fit.moving.relative)}: "
        "stiction holds there, which no function of the velocity tells. Errors here are "
        "those in motion.",
    )


def resting_share(fit: Validation) -> float:
    """Return the share of the rows in motion and at rest that are at rest."""
    if fit.resting is None:
        return 0.0
    rest = int(fit.resting.rows.sum())
    return rest / max(rest + int(fit.moving.rows.sum()), 1)


def _explained(fit: Validation, joint: int) -> str:
    """Return R² in words: below zero the mean effort predicts better."""
    errors = fit.moving
    if not errors.rows[joint]:
        errors = fit
    r2, nrmse = float(errors.r2[joint]), float(errors.nrmse[joint])
    if r2 < 0.0:
        error = f", error {percent(nrmse)} of the effort" if nrmse <= SMALL else ""
        return f"worse than a constant{error}"
    return "over 99.9 %" if r2 > 0.999 else percent(r2)


# Constraints are named that add this share of the training error that least squares leaves.
_ADDS = 0.01


@dataclass(frozen=True)
class Held:
    """A joint that is held back.

    Attributes
    ----------
    joint : str
        The joint.
    rmse, free : float
        Errors in motion on what was held out, of the estimate and of least squares, N·m or N.
    constraints : tuple of str
        Constraints that add error at the joint on the training data, the largest share first;
        empty where none does, and the prior holds it.
    """

    joint: str
    rmse: float
    free: float
    constraints: tuple[str, ...]

    @property
    def words(self) -> str:
        """What holds it, with the numbers."""
        return (
            f"held-out error {self.rmse:.3g}, of least squares {self.free:.3g} in the joint's "
            f"unit: held by {listed(self.by)}"
        )

    @property
    def by(self) -> tuple[str, ...]:
        """What holds it."""
        return self.constraints or ("the prior",)

    @property
    def step(self) -> str:
        """What to do about it."""
        end = (
            "or leave these constraints out (cost_of_constraints tells what each costs)"
            if self.constraints
            else "or weaken the prior (--no-prior leaves it out)"
        )
        return (
            f"find why {self.joint} does not agree with {listed(self.by)}: check the sign "
            f"and the unit of its effort, its zero, its links in the description and its "
            f"friction terms, {end}"
        )


@kept
def held_of(result: Judged) -> dict[str, Held]:
    """Return the joints that are held back, by name; none where nothing was held out."""
    return {each.joint: each for each in _held(result)}


def _held(result: Judged) -> Iterator[Held]:
    if result.held_out is None:
        return
    fit, free = result.held_out.fit, result.held_out.baselines[LEAST_SQUARES]
    names = [
        name
        for name in held_back(fit, free)
        if fit.moving.nrmse[fit.joint_names.index(name)] >= NEGLIGIBLE
    ]
    if not names:
        return
    try:
        cost = cost_of_constraints(result.estimate)
    except SdpidError:  # no standard parameters, or no optimum; a verdict must not cost the run
        return
    for name in names:
        j = fit.joint_names.index(name)
        adds = cost.increase[:, j]
        order = [k for k in adds.argsort()[::-1] if adds[k] > _ADDS * cost.rmse_free[j]]
        yield Held(
            joint=name,
            rmse=float(fit.moving.rmse[j]),
            free=float(free.moving.rmse[j]),
            constraints=tuple(cost.constraints[k] for k in order),
        )


def held_back_findings(result: Judged) -> Iterator[Finding]:
    """Yield the joints that are held back, and by what."""
    for each in held_of(result).values():
        yield Finding("caution", f"{each.joint} is held back: {each.words}. Next: {each.step}.")
