"""What the verdict judges: a prediction of efforts, its grades, and the identification it is of.

Every limit is a constant here, with its reason.
"""

from __future__ import annotations

import weakref
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid._common.kept import kept
from sdpid.assurance.certificate.certificate import Certificate
from sdpid.assurance.diagnostics.active_constraints import cost_of_constraints
from sdpid.assurance.diagnostics.bands import effort_band, random_motion
from sdpid.assurance.diagnostics.causes import (
    Cause,
    JointErrors,
    find_causes,
    held_back,
    joint_errors,
)
from sdpid.assurance.diagnostics.described import described_dynamics
from sdpid.assurance.diagnostics.held_out import (
    DESCRIPTION,
    LEAST_SQUARES,
    OURS,
    HeldOut,
    Remedy,
)
from sdpid.assurance.diagnostics.rest import moving_rows, rest_speeds
from sdpid.assurance.diagnostics.validation import Validation
from sdpid.assurance.intervals.intervals import Intervals
from sdpid.assurance.recipe.recipe import Recipe
from sdpid.errors import SdpidError
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.elasticity.result import Elasticity
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.positions.law_fit import FittedDrives
from sdpid.estimation.problem import Problem
from sdpid.experiment.inspection.kinds import Finding
from sdpid.experiment.processing.samples import Samples
from sdpid.output.report.kinds import DESCRIBED, STEPS, Level, listed, percent
from sdpid.output.robots.export_report import ExportErrors, urdf_errors
from sdpid.robot.friction.terms import BY_NAME, Coupling
from sdpid.robot.model.model import RobotModel

# Share of a joint's effort that is explained (R²). At 0.95 the error is 22 % of the effort's
# spread, and a feedback loop is left with less than a quarter of the work; at 0.8 it is 45 %, and
# what the model gets wrong is about as large as friction or gravity alone usually are.
EXPLAINED, HARDLY = 0.95, 0.8

# A joint whose effort hardly varies has a low R² however small its error is. An error of a tenth of
# the effort itself is small all the same: payloads and temperature change it by as much. It lifts a
# joint by one level and no more, since R² alone tells a model from a constant.
SMALL = 0.1

# Held-out blocks repeat the motion that was trained on. A joint is trusted on other motion where
# twice their error would still be good: then all of 229 joints of six real robots kept the grade on
# another recording. By blocks alone the shortest recordings (Gen3) kept 4 of 10; with a margin of
# 1.5 they keep 2 of 3, with 2 none is trusted there (examples/evidence/grades.py).
MARGIN = 2.0


@dataclass(frozen=True)
class Grade:
    """How far a joint's predicted effort can be trusted.

    Attributes
    ----------
    joint : int
        Its index.
    level : {"good", "caution", "bad"}
        Trusted, roughly right, or not trusted.
    shown : bool
        Whether other motion has shown it, or leaves room for it. A joint that is predicted well on
        the motion that was trained on, and no more, is not: its level is "caution".
    moved : bool
        Whether the joint moved at all.
    """

    joint: int
    level: Level
    shown: bool = True
    moved: bool = True


def grades(estimate: Estimate, training: Validation, held_out: HeldOut | None) -> tuple[Grade, ...]:
    """Return the grade of every joint whose effort was measured.

    Parameters
    ----------
    estimate : Estimate
        The estimate.
    training : Validation
        Its errors on the training rows.
    held_out : HeldOut or None
        Its errors on what was held out.
    """
    if held_out is None:
        every = graded(estimate.problem.samples, training)
        return tuple(_unshown(each) if each.level == "good" else each for each in every)
    every = graded(held_out.samples, held_out.fit)
    if held_out.by == "recording":
        return tuple(every)
    errors, room = held_out.fit.moving, left_room(estimate)
    found = []
    for each in every:
        r2, nrmse = float(errors.r2[each.joint]), float(errors.nrmse[each.joint])
        wide = level_of(1.0 - MARGIN**2 * (1.0 - r2), MARGIN * nrmse)
        doubtful = each.level == "good" and not wide == room[each.joint] == "good"
        found.append(_unshown(each) if doubtful else each)
    return tuple(found)


def _unshown(grade: Grade) -> Grade:
    """Return the grade of a joint that is predicted well on the motion of the training alone."""
    return replace(grade, level="caution", shown=False)


def graded(samples: Samples, fit: Validation) -> Iterator[Grade]:
    """Yield the grade of every joint whose effort was measured, by one prediction alone.

    A joint that stood still is at most "caution": a constant would have predicted its effort too.
    Of one without a motor there is nothing to predict.
    """
    for j in range(len(fit.joint_names)):
        if not fit.rows[j] or not np.any(samples.effort[:, j]):
            continue
        if not moved(samples, fit, j):
            yield Grade(j, "caution" if fit.nrmse[j] <= SMALL else "bad", moved=False)
            continue
        errors = fit.moving if fit.moving.rows[j] else fit
        yield Grade(j, level_of(float(errors.r2[j]), float(errors.nrmse[j])))


def level_of(r2: float, nrmse: float) -> Level:
    """Return the level of an error: R², and RMSE over rms effort."""
    small = nrmse <= SMALL
    if r2 >= (HARDLY if small else EXPLAINED):
        return "good"
    return "caution" if small or r2 >= HARDLY else "bad"


def moved(samples: Samples, fit: Validation, joint: int) -> bool:
    """Return whether a joint was ever faster, on the rows in use, than one that rests."""
    speeds = np.abs(samples.velocity[samples.used[:, joint], joint])
    return bool(np.any(speeds > rest_speeds(fit.slides)[joint]))


@kept
def left_room(estimate: Estimate) -> tuple[Level, ...]:
    """Return the level, joint by joint, of the error that parameters leave on random motion."""
    try:
        deviation, effort = random_motion(estimate)
    except SdpidError:  # no covariance: nothing tells how much is left open
        unknown: Level = "caution"
        return (unknown,) * estimate.problem.robot.n
    tiny = np.finfo(float).tiny
    r2 = 1.0 - deviation**2 / np.maximum(effort.var(axis=0), tiny)
    nrmse = deviation / np.sqrt(np.maximum(np.mean(effort**2, axis=0), tiny))
    return tuple(map(level_of, r2.tolist(), nrmse.tolist()))


# Below this share of its effort an error does not matter, whatever its shape: torque sensors and
# torque constants are hardly known to 2 %.
NEGLIGIBLE = 0.02

# Constraints are named that add this share of the training error that least squares leaves.
_ADDS = 0.01

# Instants along the motion at which mass matrices are looked at: more than a picture shows.
_INSTANTS = 300


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
    elasticity: Elasticity | None = None
    intervals_note: str | None = None
    bias: Any | None = None
    bias_note: str | None = None
    notes: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    inputs: tuple[dict[str, Any], ...] = ()
    recipe: Recipe | None = None
    recipe_note: str | None = None
    drives: FittedDrives | None = None

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""

    @property
    def _subject(self) -> VerdictSubject:
        """What verdict, lines and report are drawn from, so that they say the same."""
        return _subject_of(self)


class Prediction:
    """A prediction of efforts as it is judged, such as that of a robot's description."""

    where = "this recording"

    def __init__(self, robot: RobotModel, samples: Samples, fit: Validation) -> None:
        self.robot, self.samples, self.fit = robot, samples, fit

    @cached_property
    def grades(self) -> tuple[Grade, ...]:
        """The grade of every joint whose effort was measured."""
        return tuple(graded(self.samples, self.fit))

    @cached_property
    def errors(self) -> tuple[JointErrors, ...]:
        """The error analysis of every joint."""
        return joint_errors(self.samples, self.fit)

    @cached_property
    def causes(self) -> dict[str, Cause]:
        """What the error of each joint goes with."""
        robot = self.robot
        return find_causes(robot, robot.prior, self.samples, self.fit, self.errors)

    def step(self, _: Cause) -> str:
        """Return what to do about a cause, where that is known."""
        return ""

    def negligible(self, joint: str) -> bool:
        """Return whether a joint's error does not matter, whatever its shape."""
        return bool(self.fit.moving.nrmse[self.fit.joint_names.index(joint)] < NEGLIGIBLE)

    @property
    def resting_share(self) -> float:
        """The share of the rows in motion and at rest that are at rest."""
        if self.fit.resting is None:
            return 0.0
        rest = int(self.fit.resting.rows.sum())
        return rest / max(rest + int(self.fit.moving.rows.sum()), 1)


class VerdictSubject(Prediction):
    """An identification, by its prediction of what was held out, or else of what was fitted."""

    def __init__(self, result: Judged) -> None:
        # Weakly: it is kept with the result, which must go when its user drops it.
        self._result = weakref.ref(result)
        self.problem, self.estimate = result.problem, result.estimate
        held_out = self.held_out = result.held_out
        self.other_motion = held_out is not None and held_out.by == "recording"
        if held_out is None:
            super().__init__(self.problem.robot, self.problem.samples, result.training)
            self.free, self.where = result.training_wls, "its own training data"
        else:
            super().__init__(self.problem.robot, held_out.samples, held_out.fit)
            self.free = held_out.baselines[LEAST_SQUARES]
            self.where = f"{held_out.blocks} blocks of the same motion, held out in turn"
        if self.other_motion:
            self.where = "motion that was not used for the fit"
        self.terms = frozenset(type(term).__name__ for term in self.problem.friction.terms)

    @property
    def result(self) -> Judged:
        """The identification."""
        result = self._result()
        assert result is not None
        return result

    @cached_property
    def grades(self) -> tuple[Grade, ...]:
        """The grade of every joint whose effort was measured."""
        return grades(self.estimate, self.result.training, self.held_out)

    @cached_property
    def causes(self) -> dict[str, Cause]:
        """What the error of each joint goes with."""
        bodies = self.estimate.some_theta[: 10 * self.robot.n_links]
        judged = self.samples, self.fit, self.errors, self.free
        return find_causes(self.robot, bodies, *judged)

    def step(self, cause: Cause) -> str:
        """Return what to do about a cause, which is no effect that was tried and left out."""
        term, effect, otherwise = DESCRIBED.get(cause.kind, ("", "", ""))
        tried = self.problem.origin.effects
        rejected = [each for each in tried if each.name == effect and not each.chosen]
        known = term in self.terms or rejected
        step = otherwise if known else STEPS[cause.kind]
        if cause.frequency is not None:
            step = step.replace("that frequency", f"{cause.frequency:.3g} Hz")
        for each in rejected:
            fall = (
                "" if each.fall is None else f" and lowers the cost by {percent(each.fall)} alone"
            )
            step += f"; {each.name} was tried{fall}"
        return step

    @cached_property
    def held(self) -> dict[str, tuple[str, str]]:
        """What holds a joint back, in words, and what to do about it, by joint."""
        if self.held_out is None:
            return {}
        names = [name for name in held_back(self.fit, self.free) if not self.negligible(name)]
        try:
            cost = cost_of_constraints(self.estimate) if names else None
        except SdpidError:  # no standard parameters, or no optimum; a verdict must not cost the run
            return {}
        found = {}
        for name in names:
            assert cost is not None
            j = self.fit.joint_names.index(name)
            adds = cost.increase[:, j]
            order = [k for k in adds.argsort()[::-1] if adds[k] > _ADDS * cost.rmse_free[j]]
            # Where no constraint does, the prior holds it.
            by = listed(cost.constraints[k] for k in order) or "the prior"
            end = "or weaken the prior (--no-prior leaves it out)"
            if order:
                end = "or leave these constraints out (cost_of_constraints tells what each costs)"
            own, free = (each.moving.rmse[j] for each in (self.fit, self.free))
            found[name] = (
                f"held-out error {own:.3g}, of least squares {free:.3g} in the joint's unit: held "
                f"by {by}",
                f"find why {name} does not agree with {by}: check the sign and the unit of its "
                f"effort, its zero, its links in the description and its friction terms, {end}",
            )
        return found

    @cached_property
    def missing_friction(self) -> tuple[str, ...]:
        """Which of Coulomb and viscous friction no term describes; none with unknown terms."""
        terms = self.problem.friction.terms
        if any(type(term) not in (*BY_NAME.values(), Coupling) for term in terms):
            return ()
        described = {term.describes for term in terms}
        return tuple(kind for kind in ("Coulomb", "viscous") if kind not in described)

    @cached_property
    def speeds(self) -> Array:
        """The lowest and the highest velocity (2, n) of each joint on the fitted rows in use."""
        found = np.array(self.problem.require_rows("verdict").map(_speeds_of))
        return np.stack([found[:, 0].min(axis=0), found[:, 1].max(axis=0)])

    @cached_property
    def band(self) -> Array | None:
        """The half-width (K, n) of the 95 % band about the prediction, if it is known."""
        try:
            own = self.fit.effort_band
            return effort_band(self.estimate, self.samples) if own is None else own
        except SdpidError:  # no covariance; a verdict, or a picture, must not cost the run
            return None

    @cached_property
    def inside_bands(self) -> float | None:
        """The share of moving rows of other recordings within the 95 % bands, if any."""
        if not self.other_motion or self.band is None:
            return None
        moving = moving_rows(self.samples, self.fit.slides)
        inside = np.abs(self.samples.effort - self.fit.effort_predicted) <= self.band
        return float(inside[moving].mean()) if moving.any() else None

    @cached_property
    def instants(self) -> Indices:
        """Samples of the training (K,) along which the mass matrix is looked at."""
        last = self.problem.samples.n_samples - 1
        return np.unique(np.linspace(0, last, _INSTANTS).astype(np.intp))

    @cached_property
    def least_eigenvalues(self) -> dict[str, Array]:
        """The mass matrix's least eigenvalue (K,) at the instants, model by model."""
        samples, result = self.problem.samples, self.result
        models = {LEAST_SQUARES: result.wls.model(), OURS: result.estimate.model()}
        if np.any(self.robot.prior[:, 0] > 0.0):
            models = {DESCRIPTION: described_dynamics(self.robot, samples), **models}
        position = samples.position[self.instants]
        return {
            name: np.asarray(np.linalg.eigvalsh(model.mass_matrix(position))[:, 0], dtype=float)
            for name, model in models.items()
        }

    @cached_property
    def urdf_errors(self) -> ExportErrors | None:
        """What identified.urdf misses, on the validation recording or the training's.

        None where none is written, or there are no rows.
        """
        return urdf_errors(self.estimate, self.result.validation_samples)


# Beside the result, not in it: no copy or pickle of it takes along what was drawn from it.
@kept
def _subject_of(result: Judged) -> VerdictSubject:
    return VerdictSubject(result)


def _speeds_of(rows: RowSource) -> Array:
    """Return lowest and highest velocities (2, n) of one recording; 0 for a joint without rows."""
    v = np.ma.masked_array(rows.samples.velocity, ~rows.samples.used)
    return np.stack([np.ma.filled(each, 0.0) for each in (v.min(axis=0), v.max(axis=0))])
