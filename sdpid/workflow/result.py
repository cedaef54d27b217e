"""The result of an identification: in words, as plain values, and saved to files: all or none."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from sdpid import __version__
from sdpid._common.extras import installation
from sdpid._common.progress import progress
from sdpid._common.staging import RunFolder, Unwritten
from sdpid._common.tables import Shown, Table, json_text, plain_dict
from sdpid.assurance.diagnostics.active_constraints import constraint_states
from sdpid.assurance.intervals.delta_method import joint_curve
from sdpid.assurance.intervals.intervals import Intervals
from sdpid.errors import ExportError, MissingExtraError, SdpidError
from sdpid.estimation.closed_loop.bias import BiasTest
from sdpid.estimation.effects.kinds import Tried
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import describe
from sdpid.output.report.headline import Headline, headline
from sdpid.output.report.subject import Judged
from sdpid.output.report.verdict import verdict as verdict_on
from sdpid.output.robots.drive_files import NAMES as DRIVE_FILES
from sdpid.output.robots.drive_files import write_drives
from sdpid.output.robots.export_report import ExportReport
from sdpid.output.robots.friction_files import NAMES as FRICTION_FILES
from sdpid.output.robots.friction_files import write_friction
from sdpid.output.robots.mjcf import write_mjcf
from sdpid.output.robots.urdf import write_urdf
from sdpid.output.samples.drive_draws import NAME as DRIVE_SAMPLES
from sdpid.output.samples.drive_draws import write_drive_draws
from sdpid.output.tables.parameter_tables import base_table, in_words, intervals_dict, theta_table
from sdpid.output.tables.parameters_file import write_parameters
from sdpid.robot.friction.model import JointCurve
from sdpid.robot.friction.posed import PositionFriction
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.verifier.manifest import NAME as MANIFEST
from sdpid.verifier.manifest import SCHEMA, VERSION, sealed

if TYPE_CHECKING:
    from sdpid.assurance.rollouts.result import Rollout
    from sdpid.workflow.formulate import CrossValidation

# What `Identification.to_dict` tells as it is.
_AS_THEY_ARE = (
    *("findings", "verdict", "headline", "training", "validation", "held_out", "remedies"),
    *("cross_validation", "rollouts", "bias", "bias_note", "elasticity"),
)

# Stands for the kind of a file while statements are compared.
_KIND = "\0"

# Of the figures: a screen's width, and 170 dots an inch on a printed page.
_DPI = 110.0

# Options of `save` that say what is written, and change nothing that is computed.
WRITTEN: tuple[str, ...] = ("figures", "offsets", "tendons", "elastic", "bare")

# The options of the run.
_CONFIG = "run.toml"

# Every file that a run may write.
NAMES = (
    "base_parameters.csv",
    "parameters.csv",
    "parameters.json",
    "certificate.json",
    "identified.urdf",
    "identified.xml",
    "identified_elastic.xml",
    "elasticity.json",
    "elasticity.csv",
    *FRICTION_FILES,
    *DRIVE_FILES,
    DRIVE_SAMPLES,
    "training.png",
    "validation.png",
    "report.html",
    _CONFIG,
    "result.json",
    # Written last: it seals the other files.
    MANIFEST,
)


_FOLDER = RunFolder(NAMES, MANIFEST, _CONFIG, seal=sealed)

require_writable = _FOLDER.require_writable


def save(
    result: Judged,
    folder: str | os.PathLike[str],
    *,
    figures: bool = False,
    offsets: bool = False,
    tendons: bool = False,
    elastic: bool = False,
    bare: bool = False,
    report: Callable[[str], None] | None = None,
    command: str | None = None,
    config: str | None = None,
    intervals: Intervals | None = None,
    exported: Callable[[ExportReport], None] | None = None,
) -> tuple[Path, ...]:
    """Write tables, robots, certificate and a report into a folder: all, or none.

    The robot is written as identified.urdf where it came from one, and as identified.xml
    (MJCF) where MuJoCo is installed and can hold it; drives that were fitted under a law also as
    drives.csv, blocks for Isaac Lab, mjlab and BAM, and as draws.

    Parameters
    ----------
    result : Identification
        What is written.
    folder : path
        Created when it is not there.
    figures : bool, optional
        Write training.png and validation.png too (extra ``plot``).
    offsets : bool, optional
        Write offsets into identified.xml, as actuators with a constant force.
    tendons : bool, optional
        Write friction over position into identified.xml, as tendons with dry friction.
    elastic : bool, optional
        Write identified_elastic.xml too, with springs between motors and links where a stiffness
        was found.
    bare : bool, optional
        Leave out report.html and drives_samples.npz, of which most of the folder's size is.
    report : callable, optional
        Called with a sentence for all that the files leave out of the estimate (see
        `ExportReport`), and for every file that is not written.
    command : str, optional
        The command line, for report.html.
    config : str, optional
        The options of the command in TOML, for run.toml.
    intervals : Intervals, optional
        Shown in place of the result's own.
    exported : callable, optional
        Called with the `ExportReport` of each robot that was written.

    Returns
    -------
    tuple of Path
        The files.

    Raises
    ------
    ExportError
        When the folder cannot be written to, or the estimate cannot be exported.
    """
    note = report or (lambda _: None)
    require_writable(Path(folder), writes_config=config is not None)
    if intervals is not None:
        result = replace(result, intervals=intervals)
    estimate, certificate, drives = result.estimate, result.certificate, result.drives
    ends = result.intervals
    exports: list[ExportReport] = []

    def fill(stage: Path) -> dict[str, Any]:
        with progress(1, "writing results"):
            base_table(estimate, result.wls, ends).write(stage / "base_parameters.csv")
            theta_table(estimate, ends).write(stage / "parameters.csv")
            path = stage / "parameters.json"
            write_parameters(estimate, path, intervals=ends, certificate=certificate)
            certificate.to_json(stage / "certificate.json")
            used = estimate if drives is None else drives.estimate(rich=tendons)
            how = {"offsets": offsets, "tendons": tendons, "steep": drives is None}
            exports.extend(_robots(result, used, stage, note, elastic, **how))
            if result.elasticity is not None:
                result.elasticity.save(stage / "elasticity.json")
                result.elasticity.table().write(stage / "elasticity.csv")
            _friction(result, stage, note)
            if drives is not None:
                note(write_drives(drives, stage))
            if drives is not None and not bare:
                write_drive_draws(drives, stage / DRIVE_SAMPLES, stage / "identified.xml")
            if figures:
                _figures(result, stage)
            if not bare:
                _report(result, stage, note, command, exports)
            if config is not None:
                (stage / _CONFIG).write_text(config, encoding="utf-8")
            content = json_text({**result.to_dict(), "exports": exports})
            (stage / "result.json").write_text(content + "\n", encoding="utf-8")
        if result.recipe_note is not None:
            note(result.recipe_note)
        return {
            "schema": SCHEMA,
            "version": VERSION,
            "metadata": {"software": f"sdpid {__version__}"},
            "inputs": list(result.inputs),
            "recipe": None if result.recipe is None else result.recipe.to_dict(),
            "certificate": certificate.to_dict()["sha256"],
        }

    files = _FOLDER.write(Path(folder), fill, note)
    if exported is not None:
        for export in exports:
            exported(export)
    return files


def _robots(
    result: Judged,
    estimate: Estimate,
    folder: Path,
    note: Callable[[str], None],
    elastic: bool,
    **how: Any,
) -> list[ExportReport]:
    """Write the robot as URDF and MJCF where that can be, and note what they leave out."""
    problem = result.problem
    if problem.consistency == "none":
        why = "without consistency links need be no bodies"
        note(Unwritten(f"no identified.urdf, no identified.xml: {why}"))
        return []
    exports = []
    if problem.robot.urdf is not None:
        exports.append(write_urdf(estimate, target=folder / "identified.urdf"))
    mjcf, missing = folder / "identified.xml", None
    try:
        exports.append(write_mjcf(estimate, target=mjcf, **how))
        bent = any(isinstance(term, PositionFriction) for term in problem.friction.terms)
        if how["tendons"] and not bent:
            why = "nothing was found of friction over position"
            how_to = "" if result.drives else "; --effects position identifies it"
            note(Unwritten(f"no tendons in {mjcf.name}: {why}{how_to}"))
        if elastic and result.elasticity is None:
            why = "nothing was found of the elasticity of gears"
            note(Unwritten(f"no identified_elastic.xml: {why}"))
        elif elastic:
            mjcf = folder / "identified_elastic.xml"
            exports.append(write_mjcf(estimate, target=mjcf, elasticity=result.elasticity, **how))
    except MissingExtraError:
        missing = f"mujoco is not installed ({installation('sim')})"
    except Exception as reason:
        # It is optional, so nothing that MuJoCo does may cost the run, but a full disk does.
        if isinstance(reason.__cause__ or reason, OSError):
            raise
        known = isinstance(reason, SdpidError)
        missing = str(reason) if known else f"MuJoCo failed: {type(reason).__name__}: {reason}"
    if (fresh := result.validation_samples) is not None:
        exports = [export.with_validation(fresh) for export in exports]
    exports = [replace(each, _of_law=result.drives is not None) for each in exports]
    for statement in _statements(exports):
        note(statement)
    if missing is not None:
        note(Unwritten(f"no {mjcf.name} (MJCF): {missing}"))
    return exports


def _friction(result: Judged, folder: Path, note: Callable[[str], None]) -> None:
    """Write friction as code, which has room for every term of ours."""
    drives = result.drives
    estimate = result.estimate if drives is None else drives.estimate()
    # Under a law it is of other numbers.
    certificate = result.certificate if drives is None else None
    left_out: dict[str, None] = {}
    for name in FRICTION_FILES if estimate.problem.friction.terms else ():
        try:
            missing = write_friction(estimate, folder / name, certificate=certificate)
        except ExportError as reason:
            # A full disk, that is; else it is a term that no file can hold.
            if isinstance(reason.__cause__, OSError):
                raise
            note(Unwritten(f"no {' and no '.join(FRICTION_FILES)}: {reason}"))
            return
        left_out |= dict.fromkeys(missing)
    for each in left_out:
        note(each)


def _figures(result: Judged, folder: Path) -> None:
    """Draw measured and predicted efforts."""
    from sdpid.plots.figures import save_figure

    for name, fit in (("training", result.training), ("validation", result.validation)):
        if fit is not None:
            save_figure(fit.plot(), folder / f"{name}.png", dpi=_DPI)


def _report(
    result: Judged,
    folder: Path,
    note: Callable[[str], None],
    command: str | None,
    exports: Sequence[ExportReport],
) -> None:
    if importlib.util.find_spec("jinja2") is None:
        note(Unwritten(f"no report.html: jinja2 is not installed ({installation('report')})"))
        return
    from sdpid.output.report.report import write_report

    write_report(
        result,
        folder / "report.html",
        command=command,
        intervals=result.intervals,
        exports=exports,
        sha256=result.certificate.to_dict()["sha256"],
    )


def _statements(exports: Sequence[ExportReport]) -> Iterator[str]:
    """Yield what files leave out of the estimate; what holds for several is yielded once."""
    concerned: dict[str, list[ExportReport]] = {}
    for export in exports:
        for statement in export.describe().splitlines()[1:]:
            concerned.setdefault(statement.replace(export.kind, _KIND), []).append(export)
    for statement, several in concerned.items():
        files = ", ".join(export.path.name for export in several)
        kinds = " or ".join(export.kind for export in several)
        yield f"{files}: {statement.replace(_KIND, kinds)}"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Identification(Judged, Shown):
    """The result of `identify`.

    Attributes
    ----------
    problem : Problem
        The problem that was solved.
    wls : Estimate
        The unconstrained fit.
    estimate : Estimate
        The global optimum under the constraints.
    certificate : Certificate
        Of `estimate`: the proof that it is the optimum.
    training : Validation
        Errors of `estimate` on the recordings that it was fitted to.
    training_wls : Validation
        Errors of the unconstrained fit on the same recordings.
    validation : Validation or None
        Errors of `estimate` on the validation recording.
    validation_samples : Samples or None
        That recording, processed the same way.
    held_out : HeldOut or None
        Errors on what was not trained on, beside baselines: on the validation recording, else on
        blocks of the training recording held out in turn. None where neither can be.
    remedies : tuple of Remedy
        Other choices that were tried where something that costs less predicts better what was held
        out, and the errors with them.
    intervals : Intervals or None
        Confidence intervals of the parameters; None where they were not asked for, or the data do
        not allow them (see `intervals_note`).
    cross_validation : CrossValidation or None
        Blocks of the training recordings held out in turn (see `sdpid.cross_validate`).
    elasticity : Elasticity or None
        What encoders of motors and links tell of the gears, where recordings have both (see
        `sdpid.identify_elasticity`).
    rollouts : tuple of Rollout
        The validation recording simulated in open loop, all joints free and one at a time, where
        that was asked for (see `sdpid.rollout`).
    intervals_note : str or None
        Why there are no intervals, or how far to trust them.
    bias : BiasTest or None
        Whether noise in the measured motion biases least squares (see `sdpid.check_bias`); None
        where nothing is known of the motion but the measurement.
    bias_note : str or None
        Why there is no such test.
    notes : tuple of str
        The choices that were made, and the findings, in words.
    findings : tuple of Finding
        Findings of the inspection of the recordings (see `sdpid.inspect_recording`).
    inputs : tuple of dict
        Role, name, bytes and SHA-256 of the robot's description and of every recording.
    recipe : Recipe or None
        How the rows are made of the recordings, for who checks the result from the log.
    recipe_note : str or None
        Why there is no recipe.
    drives : FittedDrives or None
        Drives and links fitted to positions under a known law, where that was given: the best of
        several starts, not proven. `estimate`, `intervals` and `certificate` are of the convex fit
        to the law's efforts, which is their start.

    Examples
    --------
    >>> result.certificate.passed, result.estimate.status, result.validation
    (True, 'optimal', None)
    >>> result.verdict[-1].split(":")[0]
    'Every link is physically possible, and no possible parameters fit better'
    >>> model = result.model()
    >>> sorted(path.name for path in result.save("results"))[:3]
    ['base_parameters.csv', 'certificate.json', 'identified.urdf']
    """

    cross_validation: CrossValidation | None = None
    rollouts: tuple[Rollout, ...] = ()
    bias: BiasTest | None = None

    def _shown(self) -> dict[str, object]:
        """Return the main facts."""
        facts: dict[str, object] = {
            "robot": self.problem.robot.name,
            "certified": self.certificate.passed,
            "relative residual": self.training.told.relative,
            "relative residual, unconstrained": self.training_wls.told.relative,
            "cost": self.estimate.cost,
            "proven lower bound": self.certificate.lower_bound,
            "base parameters": self.problem.base.count,
            "rows": self.problem.n_rows,
        }
        if self.held_out is not None:
            what = "validation" if self.held_out.by == "recording" else "blocks held out"
            facts[f"relative residual in motion, {what}"] = self.held_out.fit.told.relative
        return facts

    def _tables(self) -> Iterator[Table]:
        """Yield the errors of every joint, and the verdict."""
        joints = slice(self.training.n_base, None)
        yield Table.of_columns(
            {
                "joint": list(self.training.joint_names[joints]),
                "RMSE [N·m]": self.training.told.rmse[joints].tolist(),
                "NRMSE": self.training.told.nrmse[joints].tolist(),
            }
        )
        yield Table(("verdict",), tuple((text,) for text in self.verdict))

    save = save

    @property
    def effects(self) -> tuple[Tried, ...]:
        """Effects that were chosen by the data, and those that were tried and left out."""
        return self.problem.origin.effects

    @property
    def verdict(self) -> tuple[str, ...]:
        """What the model can be trusted for, and what not: sentences, the most important first."""
        return verdict_on(self)

    @property
    def headline(self) -> Headline:
        """The verdict in short: the error, the worst joint, the next step, and the baseline."""
        return headline(self)

    def model(self) -> RobotDynamics:
        """Return the identified robot, to compute with; see `Estimate.model`.

        Under a law that has the links and drives that were fitted to positions.
        """
        return (self.estimate if self.drives is None else self.drives.estimate()).model()

    def friction_curve(
        self, joint: str | int, velocity: ArrayLike | None = None, *, level: float = 0.95
    ) -> JointCurve:
        """Return the friction of one joint over its velocity, with its interval.

        Parameters
        ----------
        joint, velocity
            As for `sdpid.robot.model.dynamics.RobotDynamics.friction_curve`.
        level : float, optional
            Probability with which each interval should hold the truth.

        Raises
        ------
        DataError
            When there is no such joint, or a velocity is not finite.
        """
        return joint_curve(self.estimate, joint, velocity, level=level)

    def plot(self, *, title: str | None = None, axes: Any = None) -> Any:
        """Show effort, error and friction of every joint, with bands (extra ``plot``).

        On what was held out, where there is something. `sdpid.plots` has the single figures.

        Parameters
        ----------
        title : str, optional
            Heading of the figure.
        axes : array of matplotlib.axes.Axes, shape (n, 3), optional
            Where to draw; by default in a figure of its own.

        Returns
        -------
        ndarray of matplotlib.axes.Axes, shape (n, 3)
            One row a joint: effort and error over time, friction over velocity.
        """
        from sdpid.output.report.joints import plot_overview

        return plot_overview(self, title=title, axes=axes)

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain values for JSON: None where a number is not finite."""
        estimate = self.estimate
        weak = self.problem.excitation.weak()
        notes = self.notes if self.intervals_note is None else (*self.notes, self.intervals_note)
        of_law = {}
        if self.drives is not None:
            of_law = {
                "delay_s": self.drives.delay,
                "certified_is": "the convex fit to the law's efforts (parameters.json), not the "
                "links and drives that were fitted to positions",
                "law": self.drives.to_dict(),
            }
        content = {
            **of_law,
            "problem": describe(self.problem),
            "processing": self.problem.samples.notes,
            "notes": notes,
            "grades": {
                self.training.joint_names[each.joint]: {"level": each.level, "shown": each.shown}
                for each in self._subject.grades
            },
            "status": estimate.status,
            "cost": estimate.cost,
            "cost_at_most": self.certificate.cost,
            "cost_unconstrained": self.wls.cost,
            "lower_bound": self.certificate.lower_bound,
            "gap": self.certificate.gap,
            "certified": self.certificate.passed,
            "certificate": self.certificate.to_dict()["sha256"],
            "worst_margin": estimate.worst_margin,
            "constraints": [each for each in constraint_states(estimate) if each.active],
            "solve_time": estimate.solve_time,
            "prior": None if self.problem.prior is None else self.problem.prior.notes,
            "weakly_excited": [{"singular_value": v, "parameters": n} for v, n in weak],
            "base_parameters": estimate.named(),
            "standard_parameters": estimate.named_theta(),
            "training_unconstrained": self.training_wls,
            "intervals": None if self.intervals is None else intervals_dict(self.intervals),
            **{name: getattr(self, name) for name in _AS_THEY_ARE},
        }
        return plain_dict(content)

    def summary(self) -> str:
        """Return the result in words."""
        fit = "" if self.drives is None else "convex fit to the law's efforts, the start: "
        lines = [
            f"{self.problem.robot.name}: {self.problem.base.count} base parameters from "
            f"{self.problem.n_rows} rows; {fit}{self.certificate.summary()}",
            f"relative residual in motion {100 * self.training.told.relative:.2f} % "
            "(unconstrained "
            f"{100 * self.training_wls.told.relative:.2f} %)",
        ]
        if self.problem.prior is not None:
            lines.append("regularized towards the inertias in the description")
            lines += self.problem.prior.notes
        if self.validation is not None:
            share = 100.0 * self.validation.told.relative
            lines.append(f"on the validation recording {share:.2f} %")
        if self.cross_validation is not None:
            lines.append(self.cross_validation.summary())
        if self.bias is not None:
            lines.append(self.bias.verdict)
        lines += [each.verdict for each in self.rollouts]
        if self.elasticity is not None:
            lines.append(self.elasticity.in_words())
        if (meaning := in_words(self.intervals)) is not None:
            lines.append(meaning)
        weak = self.problem.excitation.weak()
        if weak:
            lines.append(
                f"{len(weak)} directions are weakly excited, the weakest: "
                f"{', '.join(weak[-1][1]) or 'a mixture'} (singular value {weak[-1][0]:.1e})"
            )
        return "\n".join(lines)
