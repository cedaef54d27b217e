"""What the verdict judges: an identification, and what it predicts of what was held out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sdpid._common.kept import kept
from sdpid.assurance.certificate.certificate import Certificate
from sdpid.assurance.diagnostics.causes import Cause, JointErrors, find_causes, joint_errors
from sdpid.assurance.diagnostics.held_out import LEAST_SQUARES, HeldOut, Remedy
from sdpid.assurance.diagnostics.validation import Validation
from sdpid.assurance.intervals.intervals import Intervals
from sdpid.assurance.recipe.recipe import Recipe
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem
from sdpid.experiment.inspection.finding import Finding
from sdpid.experiment.processing.samples import Samples
from sdpid.output.report.grades import Grade, grades
from sdpid.output.robots.export_report import Errors, urdf_errors
from sdpid.robot.friction.model import BY_NAME

# Classes of terms that describe what every joint has.
_FRICTION = {
    "Coulomb": {"Coulomb", "AsymmetricCoulomb", "SigmoidFriction"},
    "viscous": {"Viscous"},
}


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Judged(ABC):
    """What an `Identification` holds, where each field is told.

    The classes of cross-validations, rollouts and bias tests are of features that nobody here may
    import.
    """

    problem: Problem
    wls: Estimate
    estimate: Estimate
    certificate: Certificate
    training: Validation
    training_wls: Validation
    validation: Validation | None = None
    validation_samples: Samples | None = None
    held_out: HeldOut | None = None
    remedies: tuple[Remedy, ...] = ()
    intervals: Intervals | None = None
    cross_validation: Any | None = None
    rollouts: Sequence[Any] = ()
    intervals_note: str | None = None
    bias: Any | None = None
    bias_note: str | None = None
    notes: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    inputs: tuple[dict[str, Any], ...] = ()
    recipe: Recipe | None = None
    recipe_note: str | None = None

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""


# A report and its verdict look at the same errors.
@kept
def errors_of(identification: Judged) -> tuple[JointErrors, ...]:
    """Return the error analysis of the judged prediction; computed once per identification."""
    return joint_errors(*judged(identification))


@kept
def errors_of_urdf(identification: Judged) -> Errors | None:
    """Return what identified.urdf misses, on the validation recording or the training's.

    None where none is written, or there are no rows.
    """
    return urdf_errors(identification.estimate, identification.validation_samples)


def judged(identification: Judged) -> tuple[Samples, Validation]:
    """Return the samples and the prediction to judge: of what was held out, else of training."""
    if identification.held_out is not None:
        return identification.held_out.samples, identification.held_out.fit
    return identification.problem.samples, identification.training


def grades_of(identification: Judged) -> tuple[Grade, ...]:
    """Return the grade of every joint whose effort was measured."""
    return grades(identification.estimate, identification.training, identification.held_out)


@kept
def causes_of(identification: Judged) -> dict[str, Cause]:
    """Return what the error of each joint goes with, on the judged prediction."""
    robot = identification.problem.robot
    bodies = identification.estimate.some_theta[: 10 * robot.n_links]
    return find_causes(
        robot,
        bodies,
        *judged(identification),
        errors_of(identification),
        least_squares_of(identification),
    )


def least_squares_of(identification: Judged) -> Validation:
    """Return the prediction by least squares of what is judged."""
    if identification.held_out is not None:
        return identification.held_out.baselines[LEAST_SQUARES]
    return identification.training_wls


def terms_of(identification: Judged) -> frozenset[str]:
    """Return the names of the classes of the model's terms."""
    return frozenset(type(term).__name__ for term in identification.problem.friction.terms)


def missing_friction(result: Judged) -> tuple[str, ...]:
    """Return which of Coulomb and viscous friction no term describes; none with unknown terms."""
    terms = terms_of(result)
    if terms - {each.__name__ for each in BY_NAME.values()} - {"Coupling"}:
        return ()
    return tuple(kind for kind, classes in _FRICTION.items() if not terms & classes)


def seen_on(result: Judged) -> str:
    """Return in words which data the judged prediction is on."""
    if result.held_out is None:
        return "its own training data"
    if result.held_out.by == "recording":
        return "motion that was not used for the fit"
    return f"{result.held_out.blocks} blocks of the same motion, held out in turn"
