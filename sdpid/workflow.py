"""The whole way with defaults: a robot and a recording in, certified parameters out."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._arrays import Array
from sdpid._files import atomic_write_text, move_into
from sdpid.assurance.certificate import Certificate, certify
from sdpid.assurance.validation import Validation, validate
from sdpid.assurance.verdict import verdict
from sdpid.errors import ExportError
from sdpid.estimation.constraints import Constraints
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.prior import Prior
from sdpid.estimation.problem import Problem, build_problem, describe
from sdpid.estimation.sdp import solve_sdp
from sdpid.estimation.weighting import Weighting
from sdpid.estimation.wls import solve_wls
from sdpid.experiment.preparation import default_friction, default_processing, prepare
from sdpid.experiment.processing import Processing
from sdpid.experiment.readers import read_recording
from sdpid.experiment.recording import Recording
from sdpid.experiment.samples import Samples
from sdpid.robot.friction import FrictionTerm
from sdpid.robot.inertia import Consistency
from sdpid.robot.load import load_robot
from sdpid.robot.model import RobotModel

if TYPE_CHECKING:
    from sdpid.output.report import GivenIntervals


@dataclass(frozen=True, kw_only=True, eq=False)
class Identification:
    """What `identify` found.

    Attributes
    ----------
    problem : Problem
        What was solved.
    wls : Estimate
        The unconstrained fit.
    estimate : Estimate
        The global optimum under the constraints.
    certificate : Certificate
        Of `estimate`.
    training : Validation
        `estimate` on the rows it was made from.
    training_wls : Validation
        The unconstrained fit on the same rows.
    validation : Validation or None
        `estimate` on the validation recording.
    validation_samples : Samples or None
        That recording, processed the same way.
    """

    problem: Problem
    wls: Estimate
    estimate: Estimate
    certificate: Certificate
    training: Validation
    training_wls: Validation
    validation: Validation | None = None
    validation_samples: Samples | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain values for JSON."""
        estimate = self.estimate
        weak = self.problem.excitation.weak()
        return {
            "problem": describe(self.problem),
            "processing": list(self.problem.samples.notes),
            "verdict": list(verdict(self)),
            "status": estimate.status,
            "cost": estimate.cost,
            "cost_unconstrained": self.wls.cost,
            "lower_bound": self.certificate.lower_bound,
            "gap": self.certificate.gap,
            "certified": self.certificate.passed,
            "worst_margin": estimate.worst_margin,
            "constraints": [s.to_dict() for s in estimate.constraint_states if s.active],
            "solve_time": estimate.solve_time,
            "prior": None if self.problem.prior is None else list(self.problem.prior.notes),
            "weakly_excited": [{"singular_value": v, "parameters": list(n)} for v, n in weak],
            "base_parameters": estimate.named(),
            "standard_parameters": estimate.named_theta(),
            "training": self.training.to_dict(),
            "training_unconstrained": self.training_wls.to_dict(),
            "validation": None if self.validation is None else self.validation.to_dict(),
        }

    def summary(self) -> str:
        """Return the result in words."""
        lines = [
            f"{self.problem.robot.name}: {self.problem.base.count} base parameters from "
            f"{self.problem.n_rows} rows; {self.certificate.summary()}",
            f"relative residual {100 * self.training.relative:.2f} % (unconstrained "
            f"{100 * self.training_wls.relative:.2f} %)",
        ]
        if self.problem.prior is not None:
            lines.append("the description's own inertias count as a weak belief beside the data")
            lines += self.problem.prior.notes
        if self.validation is not None:
            lines.append(f"on the validation recording {100 * self.validation.relative:.2f} %")
        weak = self.problem.excitation.weak()
        if weak:
            lines.append(
                f"{len(weak)} directions are weakly excited, the weakest: "
                f"{', '.join(weak[-1][1]) or 'a mixture'} (singular value {weak[-1][0]:.1e})"
            )
        return "\n".join(lines)

    def save(
        self,
        folder: str | os.PathLike[str],
        *,
        figures: bool = True,
        report: Callable[[str], None] | None = None,
        command: str | None = None,
        intervals: GivenIntervals | None = None,
    ) -> tuple[Path, ...]:
        """Write tables, URDF, certificate, plots and a report into a folder: all, or none.

        Parameters
        ----------
        folder : path
            Created when it is not there.
        figures : bool, optional
            Draw plots too (extra ``plot``).
        report : callable, optional
            Told in words what could not be written as identified (see `ExportReport`), and when
            there is no report.html for want of the extra ``report``.
        command : str, optional
            The command line, for report.html.
        intervals : Intervals, optional
            For report.html (see `sdpid.intervals`).

        Returns
        -------
        tuple of Path
            The files.

        Raises
        ------
        ExportError
            When the folder cannot be written to, or the estimate cannot be exported.
        """
        target = Path(folder)
        with _staging(target) as stage:
            tell = report or (lambda _: None)
            files = self._write(stage, figures, tell)
            if importlib.util.find_spec("jinja2") is None:
                tell("no report.html: jinja2 is not installed (pip install 'sdpid[report]')")
            else:
                from sdpid.output.report import certificate_digest, write_report

                page = write_report(
                    self,
                    stage / "report.html",
                    command=command,
                    intervals=intervals,
                    figures=figures,
                    sha256=certificate_digest(stage / "certificate.json"),
                )
                files.append(page)
            move_into(target, files)
        return tuple(target / file.name for file in files)

    def _write(self, out: Path, figures: bool, report: Callable[[str], None]) -> list[Path]:
        """Write the files into an empty folder."""
        from sdpid.output.tables import base_table, theta_table
        from sdpid.output.urdf import write_urdf

        files = [out / name for name in ("base_parameters.csv", "parameters.csv")]
        base_table(self.estimate, self.wls).write(files[0])
        theta_table(self.estimate).write(files[1])
        files.append(out / "result.json")
        text = json.dumps(self.to_dict(), indent=1, allow_nan=False)
        atomic_write_text(files[-1], text + "\n")
        files.append(out / "certificate.json")
        self.certificate.to_json(files[-1])
        if self.problem.robot.urdf is not None and self.problem.consistency != "none":
            files.append(out / "identified.urdf")
            export = write_urdf(self.estimate, target=files[-1])
            for statement in export.describe().splitlines()[1:]:
                report(f"identified.urdf: {statement}")
        if figures:
            from sdpid.output.plots import save_figure

            pairs = [("training", self.problem.samples, self.training)]
            if self.validation is not None and self.validation_samples is not None:
                pairs.append(("validation", self.validation_samples, self.validation))
            for name, samples, fit in pairs:
                files.append(out / f"{name}.png")
                save_figure(plot_fit(samples, fit), files[-1])
        return files


def plot_fit(samples: Samples, fit: Validation) -> Any:
    """Return a figure of measured against predicted effort (extra ``plot``).

    Parameters
    ----------
    samples : Samples
        The measurements.
    fit : Validation
        Their prediction.

    Returns
    -------
    matplotlib.figure.Figure
    """
    from sdpid.output.plots import plot_reconstruction

    return plot_reconstruction(
        samples.time,
        samples.effort,
        fit.effort_predicted,
        fit.joint_names,
        fit.rmse,
        mask=samples.mask,
    )


@contextlib.contextmanager
def _staging(folder: Path) -> Iterator[Path]:
    """Yield an empty folder within one that is made for it, and remove both if they end empty."""
    made = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder, prefix=".sdpid-") as stage:
            yield Path(stage)
    except OSError as cause:
        raise ExportError(
            f"cannot write into {folder}: {cause.strerror}; choose another folder."
        ) from None
    finally:
        # A folder that something was written into stays.
        if made:
            with contextlib.suppress(OSError):
                folder.rmdir()


def formulate(
    robot: RobotModel,
    log: Recording,
    *,
    processing: Processing | None = None,
    friction: Iterable[str | FrictionTerm] | None = None,
    weighting: Weighting | None = None,
    consistency: Consistency = "pseudo_inertia",
    constraints: Constraints | None = None,
    prior: Prior | bool | None = None,
) -> Problem:
    """Build the problem that `identify` solves; arguments and errors are those of `identify`."""
    samples = prepare(robot, log, processing)
    chosen: Weighting = weighting or ("residual" if samples.covariance is None else "gls")
    if prior is None:
        prior = chosen == "residual" and bool(np.any(robot.prior[:, 0] > 0.0))
    if isinstance(prior, bool):
        prior = Prior() if prior else None
    return build_problem(
        robot,
        samples,
        friction=default_friction(log) if friction is None else friction,
        weighting=chosen,
        consistency=consistency,
        constraints=Constraints.of_size(robot) if constraints is None else constraints,
        prior=prior,
    )


def identify(
    robot: RobotModel | str | os.PathLike[str],
    log: Recording | str | os.PathLike[str],
    *,
    validation: Recording | str | os.PathLike[str] | None = None,
    processing: Processing | None = None,
    friction: Iterable[str | FrictionTerm] | None = None,
    weighting: Weighting | None = None,
    consistency: Consistency = "pseudo_inertia",
    constraints: Constraints | None = None,
    prior: Prior | bool | None = None,
) -> Identification:
    """Identify a robot from a recording, with defaults for everything.

    Parameters
    ----------
    robot : RobotModel, name or path
        The robot (see `load_robot`).
    log : Recording or path
        What was measured (see `read_recording`).
    validation : Recording or path, optional
        Another recording to predict; nothing is chosen by it.
    processing : Processing, optional
        By default `default_processing`.
    friction : iterable, optional
        By default `default_friction`.
    weighting : str, optional
        By default ``gls`` for records with periods, else ``residual``.
    consistency : str, optional
        What every link must obey.
    constraints : Constraints, optional
        Margins and bounds; by default bounds that follow the robot's size
        (`Constraints.of_size`).
    prior : Prior or bool, optional
        What is believed beside the data. By default the description's own inertias, with a
        strength of one nat, for records without periods of a robot whose description has masses;
        none otherwise.

    Returns
    -------
    Identification

    Raises
    ------
    SdpidError
        A child that says what is wrong: `DataError`, `ModelError`, `IdentifiabilityError`,
        `InfeasibleError` or `SolverError`.
    """
    model = robot if isinstance(robot, RobotModel) else load_robot(robot)
    record = log if isinstance(log, Recording) else read_recording(log)
    if processing is None:
        processing = default_processing(record)
    fresh = None
    if validation is not None:
        check = validation if isinstance(validation, Recording) else read_recording(validation)
        # Prediction needs no covariance, so any number of periods will do.
        fresh = prepare(model, check, replace(processing, covariance=None))
    problem = formulate(
        model,
        record,
        processing=processing,
        friction=friction,
        weighting=weighting,
        consistency=consistency,
        constraints=constraints,
        prior=prior,
    )
    wls = solve_wls(replace(problem, prior=None))
    estimate = solve_sdp(problem)
    return Identification(
        problem=problem,
        wls=wls,
        estimate=estimate,
        certificate=certify(estimate),
        training=validate(estimate),
        training_wls=validate(wls),
        validation=None if fresh is None else validate(estimate, fresh),
        validation_samples=fresh,
    )


def mass_matrix(estimate: Estimate, q: ArrayLike) -> Array:
    """Return the mass matrix of an estimate.

    Parameters
    ----------
    estimate : Estimate
        With or without standard parameters: base parameters determine the mass matrix, so any
        standard ones that have them will do.
    q : array_like, shape (n,) or (K, n)
        Joint positions.

    Returns
    -------
    ndarray, shape (n, n) or (K, n, n)
    """
    problem = estimate.problem
    if estimate.theta is not None:
        return problem.robot.mass_matrix(estimate.theta, q)
    return problem.robot.mass_matrix(np.linalg.pinv(problem.base.matrix) @ estimate.base, q)
