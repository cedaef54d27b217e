"""What a rollout says, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, Protocol

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.diagnostics.held_out import (
    DESCRIPTION,
    FRICTION_FITTED,
    LEAST_SQUARES,
)
from sdpid.assurance.diagnostics.motion.light_joints import LightJoint
from sdpid.assurance.rollouts.models import CLOSED_LOOP, CONSTANT_VELOCITY, FLOOR, STAND_STILL

# The verdict is on the first horizon from here on, s: before, a motion is mostly its own start, and
# what holds its velocity beats the models of most arms (docs/evidence/rollouts.md).
_JUDGED = 0.3


# Another model does better where its error is below this share of the estimate's: medians over some
# 40 starts differ by a tenth between models that are equally good.
_BETTER = 0.9

# A floor below this, rad, is none: encoders of arms have at most some 24 bits a turn, and noise
# that a simulation does not magnify. The recording was smoothed before it was logged.
SMOOTHED = 1e-6


class Off(Protocol):
    """How far a model is off."""

    def quantile(self, share: float) -> Array:
        """Return a quantile of its errors at the horizons."""


class Told(Protocol):
    """What is put into words of a `Rollout`."""

    @property
    def free(self) -> str:
        """Which joints are free, or that a controller moves them."""

    @property
    def own(self) -> str:
        """Name of the model that is judged."""

    @property
    def horizons(self) -> tuple[float, ...]:
        """Horizons, s."""

    @property
    def models(self) -> Mapping[str, Off]:
        """All models by name."""

    @property
    def diverged(self) -> Array:
        """Share that ran away before each horizon."""

    @property
    def light(self) -> Sequence[LightJoint]:
        """Joints that are too light."""


def judged_horizon(horizons: tuple[float, ...]) -> int:
    """Return which horizon the verdict is on."""
    return next((k for k, each in enumerate(horizons) if each >= _JUDGED), len(horizons) - 1)


def verdict_on(rollout: Told) -> str:
    """Return a sentence: how far it is off, and what does better or worse."""
    k = judged_horizon(rollout.horizons)
    medians = {name: float(each.quantile(0.5)[k]) for name, each in rollout.models.items()}
    own = medians.pop(rollout.own)
    horizon = f"{rollout.horizons[k]:g} s"
    loop = CLOSED_LOOP if rollout.free == CLOSED_LOOP else "open loop"
    beside = [
        f"{name} {_angle(medians[name])}"
        for name in (FRICTION_FITTED, LEAST_SQUARES, CONSTANT_VELOCITY, STAND_STILL, FLOOR)
        if name in medians and not (name == FLOOR and medians[name] < SMOOTHED)
    ]
    numbers = f"; {', '.join(beside)}" if beside else ""
    if not np.isfinite(own):
        return (
            f"Simulated in {loop} it runs away: within {horizon} from "
            f"{rollout.diverged[k]:.0%} of the starts{numbers}."
        )
    idle = min(medians.get(name, np.inf) for name in (CONSTANT_VELOCITY, STAND_STILL))
    better = [
        name
        for name in (DESCRIPTION, FRICTION_FITTED, LEAST_SQUARES)
        if medians.get(name, np.inf) < _BETTER * own
    ]
    if own >= idle:
        head = "It does not move as the robot does"
    elif better:
        head = f"It moves less like the robot than {' and '.join(better)}"
    else:
        head = "It moves as the robot does"
    return f"{head}: after {horizon} in {loop} it is off by {_angle(own)}{numbers}."


def level_of(rollout: Told) -> Literal["good", "caution", "bad"]:
    """Return what the verdict means: bad where it runs away or does no better than no model."""
    k = judged_horizon(rollout.horizons)
    medians = {name: float(each.quantile(0.5)[k]) for name, each in rollout.models.items()}
    own = medians.pop(rollout.own)
    if own >= min(medians.get(name, np.inf) for name in (CONSTANT_VELOCITY, STAND_STILL)):
        return "bad"
    better = any(value < _BETTER * own for name, value in medians.items() if name != FLOOR)
    return "caution" if better else "good"


def _angle(value: float) -> str:
    return f"{1e3 * value:.3g} mrad" if np.isfinite(value) else "runs away"


def _off(value: float) -> str:
    return f"is off by {_angle(value)}" if np.isfinite(value) else "runs away"


def notes_on(rollout: Told) -> list[str]:
    """Return what to know about the numbers."""
    notes = []
    first = rollout.horizons[0]
    still = rollout.models.get(CONSTANT_VELOCITY)
    if first < _JUDGED and still is not None:
        own, held = (float(each.quantile(0.5)[0]) for each in (rollout.models[rollout.own], still))
        notes.append(
            f"never judge at {first:g} s alone: holding the starting velocity, without any model, "
            f"{_off(held)} there, {rollout.own} {_off(own)}"
        )
    floor = rollout.models.get(FLOOR)
    if floor is not None and float(floor.quantile(0.5)[-1]) < SMOOTHED:
        notes.append(
            "the floor of noise is not known: nothing is left of it at high frequencies, as in a "
            "recording that was smoothed before it was logged"
        )
    if rollout.diverged[-1] > 0.0:
        notes.append(
            f"{rollout.diverged[-1]:.0%} of the starts ran away before {rollout.horizons[-1]:g} s: "
            "an arm under given efforts has nothing that brings it back, so that errors grow with "
            "time even for a good model"
        )
    notes += [each.words for each in rollout.light]
    if rollout.light:
        worst = max(rollout.light, key=lambda each: each.ratio)
        notes.append(
            f"{worst.remedy} ({len(rollout.light)} joints, this one the worst)"
            if len(rollout.light) > 1
            else worst.remedy
        )
    return notes
