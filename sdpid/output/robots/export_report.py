"""What writing a robot file says: links and joints written, terms left out, what that costs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from sdpid._common.tables import Shown, Table, plain
from sdpid.assurance.diagnostics.described import Resistances, described_dynamics
from sdpid.assurance.diagnostics.validation import validate, validate_dynamics
from sdpid.errors import ExportError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.positions.law_fit import Target
from sdpid.experiment.processing.samples import Samples
from sdpid.output.robots.joint_friction import (
    JointAttributes,
    Kind,
    LeftOut,
    Role,
    joint_attributes,
)
from sdpid.robot.friction.position import Spring
from sdpid.robot.friction.terms import Coulomb, RotorInertia, Viscous
from sdpid.robot.model.model import RobotModel

# Relative difference of two errors that are the same but for rounding and a solver's tolerance.
_SAME = 1e-3

# A file that misses more than twice what the estimate does, and more than 2 % of the efforts, has
# lost what was identified (LWR 4+: 5.0 % and 2.0 %; docs/evidence/exports.md).
_LOST, _NEGLIGIBLE = 2.0, 0.02


@dataclass(frozen=True)
class ExportErrors:
    """Norm of the errors of predicted efforts over the norm of the efforts, in motion.

    Attributes
    ----------
    file : float
        As the written file predicts them.
    estimate : float
        As the estimate predicts them.
    """

    file: float
    estimate: float

    def __str__(self) -> str:
        return f"{100.0 * self.file:.2f} %, the estimate by {100.0 * self.estimate:.2f} %"

    @property
    def differ(self) -> bool:
        """Whether the file predicts otherwise than the estimate, beyond rounding."""
        return abs(self.file - self.estimate) > _SAME * self.estimate

    @property
    def warning(self) -> str:
        """What to do where the file misses too much; empty where it does not."""
        if self.file <= max(_LOST * self.estimate, _NEGLIGIBLE):
            return ""
        return f": more than {_LOST:g} times as much, predict efforts with estimate.model() instead"


# The errors of a file on samples, or on those of its problem.
FileErrors = Callable[[Samples | None], ExportErrors | None]


@dataclass(frozen=True, kw_only=True, repr=False)
class ExportReport(Shown):
    """The links and joints that were written, the parameters that were not, and what that costs.

    Attributes
    ----------
    path : Path
        The file.
    links_changed : tuple of str
        Links whose inertial was written, those whose inertial was set to zero included.
    joints_changed : tuple of str
        Joints whose damping, friction or armature was written.
    kind : str
        What was written.
    training : ExportErrors or None
        Errors on the rows that the estimate was fitted to; None where they were not kept.
    validation : ExportErrors or None
        Errors on other rows (see `with_validation`).
    left_out : tuple of LeftOut
        Terms for which the file has no place, such as offsets.
    friction_fitted : bool
        Whether friction and damping were fitted to the efforts anew, because some terms have no
        place; else they are the identified numbers.
    lumped : tuple of str
        Moving links that took over the inertia of the links fixed to them, because what was left
        of the identified body without these, or one of these, could not exist.
    triangle_violations : tuple of str
        Moving links whose principal moments violate the triangle inequality. Readers that ask for
        it (MuJoCo) reject them; estimates under ``consistency="pseudo_inertia"`` have none.
    notes : tuple of str
        What else there is to say.

    Examples
    --------
    >>> report = sdpid.write_urdf(estimate, target="identified.urdf")
    >>> report.path.name, len(report.links_changed), report.left_out
    ('identified.urdf', 6, ())
    >>> print(report.describe())
    identified.urdf: wrote the inertia of 6 links and the friction of 6 joints
    """

    path: Path
    links_changed: tuple[str, ...]
    joints_changed: tuple[str, ...] = ()
    kind: str = "a URDF"
    # In the order in which results list them.
    training: ExportErrors | None = None
    validation: ExportErrors | None = None
    left_out: tuple[LeftOut, ...] = ()
    friction_fitted: bool = False
    lumped: tuple[str, ...] = ()
    triangle_violations: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    _errors: FileErrors | None = field(default=None, repr=False)
    # Whether efforts are a law's, and none was measured.
    _of_law: bool = field(default=False, repr=False)

    _facts = ("path.name", "kind", "links_changed", "left_out")

    def _tables(self) -> Iterator[Table]:
        yield Table(("report",), tuple((line,) for line in self.describe().splitlines()))

    def with_validation(self, samples: Samples) -> ExportReport:
        """Return the report with the errors on other samples."""
        assert self._errors is not None
        return replace(self, validation=self._errors(samples))

    def describe(self) -> str:
        """Return the report in words, one statement a line."""
        lines = [f"{self.path}: wrote the inertia of {len(self.links_changed)} links"]
        if self.joints_changed:
            lines[0] += f" and the friction of {len(self.joints_changed)} joints"
        for rows, errors in (
            ("law's efforts" if self._of_law else "recorded efforts", self.training),
            ("efforts of the validation recording", self.validation),
        ):
            if errors is not None and errors.differ:
                lines.append(f"misses the {rows} by {errors}{errors.warning}")
        lines += [f"no place in {self.kind}: {lost}" for lost in self.left_out]
        counted = "with the links fixed to them counted in, whose own inertials are now zero: "
        violated = "triangle inequality violated (MuJoCo will not load it): "
        for words, links in ((counted, self.lumped), (violated, self.triangle_violations)):
            if links:
                lines.append(words + ", ".join(links))
        return "\n".join([*lines, *self.notes])

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        others = ("path", "links_changed", "joints_changed", "kind")
        rest = {key: value for key, value in plain(self).items() if key not in others}
        return {"file": self.path.name, **rest}


def file_errors(
    estimate: Estimate,
    samples: Samples | None,
    *,
    robot: RobotModel,
    held: Resistances,
    springs: Sequence[Spring] = (),
    **more: Any,
) -> ExportErrors | None:
    """Return the errors of a file that was written from an estimate, given the numbers in it.

    Parameters
    ----------
    estimate : Estimate
        What was written.
    samples : Samples or None
        Where efforts are predicted; None for the problem's own, if there are any.
    robot : RobotModel
        Under gravity as a reader of the file has it.
    held : Resistances
        Of the joints and tendons in the file.
    springs : sequence of Spring, optional
        Those of the file.
    **more
        What else `described_dynamics` takes.
    """
    problem, theta = estimate.problem, estimate.theta
    assert theta is not None
    if samples is None and problem.rows is None:
        return None
    samples = problem.samples if samples is None else samples
    bodies = problem.feasible.bodies(theta)
    model = described_dynamics(robot, samples, bodies=bodies, held=held, springs=springs, **more)
    return ExportErrors(
        validate_dynamics(model, samples, problem).told.relative,
        validate(estimate, samples).told.relative,
    )


# The attributes that a URDF has for friction, and what others have for rotors.
PLACES: dict[Kind, str] = {Coulomb: "friction", Viscous: "damping"}
_OF_ROTORS = "armature"
_ATTRIBUTES = (*PLACES.values(), _OF_ROTORS)


def urdf_errors(estimate: Estimate, samples: Samples | None = None) -> ExportErrors | None:
    """Return the errors of an estimate's URDF beside the estimate's own.

    Parameters
    ----------
    estimate : Estimate
        The estimate.
    samples : Samples, optional
        Where efforts are predicted; by default the problem's own.

    Returns
    -------
    ExportErrors or None
        None where no URDF can be written, or there are no rows.
    """
    problem, theta = estimate.problem, estimate.theta
    if theta is None or problem.robot.urdf is None or problem.consistency == "none":
        return None
    try:
        return _errors_with(estimate, joint_attributes(problem, theta, PLACES, "URDF"), samples)
    except ExportError:  # negative friction
        return None


def _errors_with(
    estimate: Estimate, friction: JointAttributes, samples: Samples | None = None
) -> ExportErrors | None:
    """Return the errors of an estimate with attributes in place of its friction."""
    robot = estimate.problem.robot
    held = Resistances.of_joints(robot)
    held.armature[:] = 0.0
    for numbers, attribute in zip(held[1:], _ATTRIBUTES, strict=True):
        if any(attribute in own for own in friction.values.values()):
            # Joints that follow others have what these have not.
            joints = robot.tree_joints[robot.n_base :]
            numbers[:] = [friction.values.get(joint, {}).get(attribute, 0.0) for joint in joints]
    tendons = friction.tendons.values()
    held = held.beside((x.way, *(x.attributes.get(a, 0.0) for a in _ATTRIBUTES)) for x in tendons)
    return file_errors(
        estimate,
        samples,
        robot=robot.with_gravity(estimate.model().tilted_gravity),
        held=held,
    )


def given_up(estimate: Estimate, target: Target) -> str:
    """Return what a simulator's joints cannot hold of an estimate, and what that costs.

    Parameters
    ----------
    estimate : Estimate
        With standard parameters.
    target : {"mujoco", "isaac", "urdf"}
        Where it will be used.
    """
    places = PLACES if target == "urdf" else PLACES | {RotorInertia: _OF_ROTORS}
    assert estimate.theta is not None
    try:
        also: tuple[Role, ...] = ("coupled",) if target == "mujoco" else ()
        friction = joint_attributes(estimate.problem, estimate.theta, places, target, also)
    except ExportError as reason:
        return f"for {target}: {reason}"
    errors = _errors_with(estimate, friction)
    if errors is None or not (friction.left_out or friction.notes):
        return f"for {target}: nothing is given up"
    lost = [f"without {each}" for each in friction.left_out]
    cost = f"recorded efforts are missed by {errors}{errors.warning}"
    return f"for {target}: {'; '.join([*lost, *friction.notes, cost])}"
