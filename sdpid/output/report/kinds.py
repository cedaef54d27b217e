"""Kinds of findings of the verdict, one row each: what they mean for the model, in what words.

A check yields ``found("held_back", joint=..., words=...)``: the row has the sentence. Boxes of the
report, `Identification.verdict`, lines of the terminal and JSON are drawn from the same findings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from string import Formatter
from typing import Any, Literal

from sdpid.verifier import reading

Level = Literal["good", "caution", "bad"]
LEVELS: tuple[Level, ...] = ("bad", "caution", "good")

# Names with commas between them; of more than four how many more there are.
listed = partial(reading.listed, most=4)


@dataclass(frozen=True)
class VerdictFinding:
    """A finding of the verdict.

    Attributes
    ----------
    kind : str
        Its row in `KINDS`.
    level : {"good", "caution", "bad"}
        What it means for the model.
    text : str
        A sentence or two.
    warning : str
        What not to do with the result, in words that follow "do not"; every bad finding has some.
    """

    kind: str
    level: Level
    text: str
    warning: str = ""


# Sentences by level and kind, with fields in braces. Beside Python's formats shares have ``%``, and
# of lists of names four are told, or with ``all`` all.
KINDS: dict[Level, dict[str, str]] = {
    "bad": {
        "recording": "The recording is not what it says: {finding}.",
        "effort_bad": "Do not trust it for the effort of {names:all}: too little of the variance "
        "is explained. Contact cannot be told from model error there.",
        "effort_still": "Joints that did not move on {where}: {names:all}. How well their effort "
        "is predicted in motion is not known. Record them moving.",
        "nothing_moves": "Nothing moves on what was held out: how well it predicts motion is not "
        "known. Give a recording of motion with --validation.",
        "motion_bad": "It does not carry over to other motion: {numbers}, {ratio:.1f} times as "
        "much. The motion was too poor for the model, or the robot changed in between (load, "
        "temperature).",
        "not_seen": "It does not predict what it has not seen: {numbers}, {ratio:.1f} times as "
        "much. Parts of the recording show what the others do not: record more of it.",
        "beaten": "What costs less predicts better what was held out: {better} misses {other:%}, "
        "this estimate {own:%}.{tried}",
        "simulated_badly": "{how}{words}",
        "bias": "{words}",
        "limit_contradicts": "A numerical limit contradicts the data: {names}. The robot may well "
        "have more: widen theta_max (of links) or friction_max of the constraints.",
        "limit_alone": "Nothing but a numerical limit holds {names}: the data do not determine "
        "these parameters. Use a prior, or a richer motion.",
        "unproven": "It is not proven to be the best fit: {why}",
        "law_contradicted": "The law does not suit the log: {words}.",
        "kp_found": "kp is found, {low:.3g} to {high:.3g}, and with it every effort, friction and "
        "inertia, only as well as the description's masses are: they alone fix the scale. Give kp "
        "where it is known.",
    },
    "caution": {
        "effort_unshown": "Not shown on other motion: {names:all}. In brackets: share of the "
        "effort's variance explained on {where}. That is the same motion, and errors on another "
        "are up to {margin:g} times as large and more: too large there to be sure. Record another "
        "motion and give it with --validation.",
        "effort_caution": "Expect it to be roughly right, not exact, for {names:all}; feedback "
        "has to make up for the rest. In brackets: share of the effort's variance explained on "
        "{where}.",
        "effort_flat": "Do not rely on it for how the effort varies of {names:all}: on {where} "
        "the effort is nearly constant. The error is small beside it (limit {small:%}), but its "
        "mean predicts better. Validate on a motion in which the effort varies.",
        "rest": "At rest ({share:%} of the rows) the error is {rest.relative:%} of the effort, in "
        "motion {motion.relative:%}: stiction holds there, which no function of the velocity "
        "tells. Errors here are those in motion.",
        "nothing_held_out": "Nothing was held out, so every error here is on the data that were "
        "fitted: how well it predicts other motion is not known. Give a second recording "
        "(--validation).",
        "blocks": "Other motion is not shown: on blocks of the same motion, held out in turn, "
        "{numbers}. Give another motion with --validation.",
        "motion_caution": "It is somewhat worse on other motion: {numbers}.",
        "bands_narrow": "The 95 % bands of predicted efforts hold {share:%} of the rows in "
        "motion: other motion is worse than the training recording lets expect; do not rely on "
        "the bands.",
        "crossed_blocks": "It predicts blocks of the same motion: {numbers}.",
        "crossed_caution": "It is somewhat worse on what it has not seen: {numbers}.",
        "cause": "The error goes {goes}. Share of the error's variance: {names:all}.{step}",
        "missing_friction": "No term describes {missing} friction (terms: {terms}), which every "
        "joint has: its effort goes into the other parameters or into the error. --friction +TERM "
        "adds a term to the default ones, --friction TERM replaces them.",
        "light": "Do not simulate {names} under efforts with it. {words}. {remedy}.",
        "held_back": "{joint} is held back: {words}. Next: {step}.",
        "gains_exact": "Efforts were made of currents by gains that are taken as exact: no "
        "interval counts their errors, and a common factor of the gains is one of every mass. "
        "'sdpid gains' estimates gains with errors.",
        "speeds": "Beyond the recorded speeds it extrapolates; these joints stayed below half of "
        "what the description allows: {names}.",
        "beyond": "The validation motion goes beyond the training motion: {names}. Its errors "
        "include extrapolation.",
        "one_way": "Joints that moved in one direction only: {names:all}. Their friction in the "
        "other direction is an extrapolation: in one direction Coulomb friction and an offset "
        "cannot be told apart. Record them moving both ways.",
        "without_rows": "Friction of {names} is unknown: no effort of theirs was used. In "
        "parameters and files stands what was believed before, next to none; give it from "
        "elsewhere.",
        "weak": "{weak} of {count} directions of the base parameters are weakly excited; {held}. "
        "The weakest: {shown}. Do not read these parameters one by one.",
        "sources": "{prior} of {count} standard parameters are the description's or the choice "
        "nearest to it, not measured: many do not act on the effort at all. The effort is "
        "predicted all the same; do not quote them as masses or inertias of the robot.{which}",
        "price": "{why}: the relative residual in motion on the fitted rows is {own:%}, without "
        "them {free:%}. {end} Active constraints: {names} (cost_of_constraints tells what each "
        "costs).",
        "positions": "Positions of rollouts under the law: {error}. Delay: {delay}. Given up for "
        "{target}: {lost}. The links of identified.xml and identified.urdf, and the drives, are "
        "{proof}.",
        "heavy": "Masses are as large as is allowed: {names}. The data hardly tell them from "
        "those of their neighbors; lower --mass-max to what the link can weigh, or use a prior.",
        "unlike": "The recordings tell links apart that are believed to be mirror images, by more "
        "than the standard deviation of the belief: {names}. Give a larger one (--mirror-within), "
        "and no --mirror.",
    },
    "good": {
        "effort_good": "Trust it for the effort of {which} in motion like the recorded, as "
        "feed-forward and simulation need; share of the effort's variance explained on {where}: "
        "{names:all}.",
        "base_force": "{trust} the force on the base: {errors.force:.3g} N rms are missed, "
        "{share:%} of the weight of {mass:.4g} kg (limit {limit:%}), and {errors.torque:.3g} N.m. "
        "Forces of contacts that were not measured are those that suit it best.",
        "contact_forces": "Measured contact forces are off by {found:.2g} N as the residuals "
        "show, {stated:.2g} N are stated (contact_force_std). {counts}",
        "told": "The recordings tell more than was believed before them of {told} of {base.count} "
        "directions of the base parameters, friction and drives ({friction}) included."
        "{dark}{more}",
        "motion_good": "It carries over to other motion: {numbers}.",
        "bands_hold": "The 95 % bands of predicted efforts hold {share:%} of the rows in motion.",
        "crossed_good": "It predicts what it has not seen as well: {numbers}.",
        "simulated": "{how}{words}",
        "gains_known": "Efforts were made of currents by gains that are known to {ends} (one "
        "standard error), {common:.2g} % of it in common, which moves every mass and inertia "
        "alike. {what}",
        "proven": "Every link is physically possible, and no possible parameters fit better: "
        "proven in exact arithmetic. That says nothing about what the model leaves out.",
        "proven_start": "The convex fit to the law's efforts, whose parameters stand in "
        "parameters.json, is proven in exact arithmetic: no possible parameters fit them better. "
        "It is where the fit of positions starts, and no proof of its end.",
    },
}

# What not to do, in words that follow "do not": of every kind that is bad.
WARNINGS = {
    "recording": "trust this recording: {finding.message}",
    "effort_bad": "trust the effort of {names:all}; in brackets: variance explained",
    "effort_still": "trust the effort of {names:all} in motion",
    "nothing_moves": "judge it by what was held out: nothing moves there",
    "motion_bad": "trust it on other motion: {ratio:.1f} times the error on recordings not fitted",
    "not_seen": "trust it on other motion: {ratio:.1f} times the error on {what} not fitted",
    "beaten": "use it: {better} predicts better what was held out",
    "simulated_badly": "simulate it without feedback: {words}",
    "light": "simulate {names} under efforts: too light for the error of their efforts",
    "bias": "trust the standard errors: {words}",
    "limit_contradicts": "keep the numerical limit of {names}: it contradicts the data",
    "limit_alone": "read {names}: nothing but a numerical limit holds them",
    "law_contradicted": "trust the drives: {words}",
    "kp_found": "trust the drives beyond the description's masses: they alone fix the scale of kp "
    "({low:.3g} to {high:.3g} found) and of every effort, friction and inertia",
    "unproven": "call it the best fit: that is not proven",
}

# After "The error goes", by the causes of `sdpid.assurance.diagnostics.causes`.
GOES = {
    "sign": "with the effort itself, and against its sign: the measured effort has the wrong sign",
    "scale": "in proportion to the effort: the measured effort has another unit or scale (torque "
    "constant, gear ratio), or the masses are off by one factor",
    "direction": "with the direction of motion: Coulomb friction has another level here, or is not "
    "in the model",
    "velocity": "in proportion to velocity: viscous friction has changed, as with temperature, or "
    "is not in the model",
    "speed": "with speed along a curve, neither a constant nor a line: friction has another shape",
    "acceleration": "with acceleration: the inertia of rotors, which efforts from motor currents "
    "need, is not in the model or is off, or efforts come late against the motion",
    "load": "with the load of the gear and the direction of motion: friction grows with load",
    "gravity": "as gravity of another direction would: the base stands tilted, or a link's center "
    "of mass is off",
    "position": "with the joint's position: an eccentric gear, a spring, a cable, or a wrong zero "
    "of the joint",
    "frequency": "at one frequency above the motion's: a vibration, or a ripple of the gear",
}

# What to do about them.
_WARM = "record at the temperature at which the model will be used, and let the robot warm up first"
STEPS = {
    "sign": "check the sign of the measured effort",
    "scale": "check the unit, the torque constant and the gear ratio of the measured effort",
    "direction": _WARM,
    "velocity": _WARM,
    "speed": "try friction of another shape (--friction), and keep it where the held-out error "
    "falls",
    "acceleration": "let rotor inertia in (--effects rotor_inertia) if efforts come from motor "
    "currents, else check the delay between effort and position",
    "load": "let friction grow with load (--effects load)",
    "gravity": "let gravity's direction be found (--effects tilt), or check the base with a level",
    "position": "check the joint's zero and its cables",
    "frequency": "set the filter's cut-off (--cutoff) below that frequency, or move more smoothly",
}

# Of those that a term describes: the term, the effect that adds it, and what to do where it is in
# the model or was tried.
DESCRIBED = {
    "acceleration": (
        "RotorInertia",
        "rotor_inertia",
        "check the delay between effort and position, and record faster accelerations",
    ),
    "load": (
        "LoadFriction",
        "load",
        "record slow motion under large and small loads, which shows how friction grows",
    ),
    "gravity": ("Tilt", "tilt", "check what is mounted on the robot"),
}


class _VerdictWords(Formatter):
    """Formats of shares and of lists of names."""

    def format_field(self, value: Any, format_spec: str) -> Any:
        if format_spec == "%":
            return percent(value)
        if isinstance(value, list | tuple):
            return ", ".join(value) if format_spec == "all" else listed(value)
        return super().format_field(value, format_spec)


def found(kind: str, /, *, careful: bool = False, **fields: Any) -> VerdictFinding:
    """Return a finding of a kind; where it calls for care, it is a caution in any case."""
    level, words = next((each, rows[kind]) for each, rows in KINDS.items() if kind in rows)
    both = (_VerdictWords().vformat(each, (), fields) for each in (words, WARNINGS.get(kind, "")))
    return VerdictFinding(kind, "caution" if careful else level, *both)


def named(kind: str, names: Sequence[str], **fields: Any) -> tuple[VerdictFinding, ...]:
    """Return a finding of a kind about what has these names; none where there are none."""
    return (found(kind, names=names, **fields),) if names else ()


def percent(share: float) -> str:
    """Return a share in percent."""
    return f"{100.0 * share:.3g} %"
