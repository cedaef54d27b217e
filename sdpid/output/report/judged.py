"""What the verdict judges: an identification, and what it predicts of what was held out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol
from weakref import WeakKeyDictionary

from sdpid._common.arrays import Array
from sdpid._common.tables import Table
from sdpid.assurance.certificate.certificate import Certificate
from sdpid.assurance.diagnostics.causes import Cause, find_causes
from sdpid.assurance.diagnostics.held_out import LEAST_SQUARES, HeldOut
from sdpid.assurance.diagnostics.residuals import JointErrors, joint_errors
from sdpid.assurance.diagnostics.validation import Validation
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem
from sdpid.experiment.inspection import finding as inspection
from sdpid.experiment.processing.samples import Samples
from sdpid.output.report.grades import Grade, Level, grades
from sdpid.output.robots.export_report import Errors
from sdpid.output.robots.urdf_errors import urdf_errors
from sdpid.robot.friction.model import BY_NAME

# Classes of terms that describe what every joint has.
_FRICTION = {
    "Coulomb": {"Coulomb", "AsymmetricCoulomb", "SigmoidFriction"},
    "viscous": {"Viscous"},
}


class Crossed(Protocol):
    """What the verdict needs of a `CrossValidation`."""

    @property
    def by(self) -> str:
        """What was held out: ``"time"`` or ``"recording"``."""

    @property
    def relative(self) -> float:
        """Relative residual of all held-out rows."""

    @property
    def relative_unconstrained(self) -> float:
        """Relative residual of the unconstrained fits on all held-out rows."""

    @property
    def relatives(self) -> Array:
        """Relative residual of each fold on its held-out rows, shape (folds,)."""

    @property
    def training(self) -> float:
        """Mean relative residual of the folds on their training rows."""


class Bias(Protocol):
    """What the verdict needs of a `BiasTest`."""

    @property
    def biased(self) -> bool:
        """Whether least squares is biased, and by how much matters."""

    @property
    def verdict(self) -> str:
        """That in words."""


class Rolled(Protocol):
    """What the report needs of a `Rollout`."""

    @property
    def free(self) -> str:
        """Which joints were simulated together."""

    @property
    def horizons(self) -> tuple[float, ...]:
        """Times after the start at which errors are told, s."""

    @property
    def start(self) -> Array:
        """Times at which the simulations start, s."""

    @property
    def verdict(self) -> str:
        """What it says, in a sentence."""

    @property
    def level(self) -> Level:
        """What that means for the model."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done, and what to know about the numbers."""

    def as_table(self) -> Table:
        """Return a row a model."""

    def joint_table(self) -> Table:
        """Return a row a joint."""

    def plot(self, *, title: str | None = None, axes: Any = None) -> Any:
        """Draw the errors over time."""


class Judged(Protocol):
    """What the verdict needs of an `Identification`."""

    @property
    def problem(self) -> Problem:
        """The problem."""

    @property
    def wls(self) -> Estimate:
        """The unconstrained fit."""

    @property
    def estimate(self) -> Estimate:
        """The constrained estimate."""

    @property
    def certificate(self) -> Certificate:
        """The certificate of `estimate`."""

    @property
    def training(self) -> Validation:
        """Errors of `estimate` on the training rows."""

    @property
    def training_wls(self) -> Validation:
        """Errors of `wls` on the training rows."""

    @property
    def validation(self) -> Validation | None:
        """Errors of `estimate` on the validation recording."""

    @property
    def validation_samples(self) -> Samples | None:
        """The processed validation recording."""

    @property
    def held_out(self) -> HeldOut | None:
        """Errors on what was not trained on, beside baselines."""

    @property
    def cross_validation(self) -> Crossed | None:
        """Cross-validation on the training recordings."""

    @property
    def bias(self) -> Bias | None:
        """Whether noise in the measured motion biases least squares."""

    @property
    def bias_note(self) -> str | None:
        """Why that is not known."""

    @property
    def rollouts(self) -> Sequence[Rolled]:
        """Simulations of the validation recording in open loop, if any."""

    @property
    def findings(self) -> tuple[inspection.Finding, ...]:
        """What is wrong with the recordings."""

    @property
    def notes(self) -> tuple[str, ...]:
        """The choices that were made, in words."""


# Of identifications that are still in use: a report and its verdict look at the same errors.
_ERRORS: WeakKeyDictionary[Judged, tuple[JointErrors, ...]] = WeakKeyDictionary()
_URDF: WeakKeyDictionary[Judged, Errors | None] = WeakKeyDictionary()


def errors_of(identification: Judged) -> tuple[JointErrors, ...]:
    """Return the error analysis of the judged prediction; computed once per identification."""
    found = _ERRORS.get(identification)
    if found is None:
        found = _ERRORS[identification] = joint_errors(*judged(identification))
    return found


def errors_of_urdf(identification: Judged) -> Errors | None:
    """Return what identified.urdf misses, on the validation recording or the training's.

    None where none is written, or there are no rows.
    """
    if identification not in _URDF:
        _URDF[identification] = urdf_errors(
            identification.estimate, identification.validation_samples
        )
    return _URDF[identification]


def judged(identification: Judged) -> tuple[Samples, Validation]:
    """Return the samples and the prediction to judge: of what was held out, else of training."""
    if identification.held_out is not None:
        return identification.held_out.samples, identification.held_out.fit
    return identification.problem.samples, identification.training


def grades_of(identification: Judged) -> tuple[Grade, ...]:
    """Return the grade of every joint whose effort was measured."""
    return grades(identification.estimate, identification.training, identification.held_out)


def causes_of(
    identification: Judged, errors: tuple[JointErrors, ...] | None = None
) -> dict[str, Cause]:
    """Return what the error of each joint goes with, on the judged prediction."""
    robot = identification.problem.robot
    bodies = identification.estimate.some_theta[: 10 * robot.n_links]
    found = errors_of(identification) if errors is None else errors
    return find_causes(
        robot, bodies, *judged(identification), found, least_squares_of(identification)
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
