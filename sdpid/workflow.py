"""The whole way with defaults: a robot and a recording in, certified parameters out."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._arrays import Array
from sdpid._files import atomic_write_text
from sdpid.assurance.certificate import Certificate, certify
from sdpid.assurance.validation import Validation, validate
from sdpid.errors import DataError
from sdpid.estimation.constraints import Constraints
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem, build_problem, describe
from sdpid.estimation.sdp import solve_sdp
from sdpid.estimation.weighting import Weighting
from sdpid.estimation.wls import solve_wls
from sdpid.experiment.processing import Processing, process
from sdpid.experiment.readers import read_recording
from sdpid.experiment.recording import Recording
from sdpid.experiment.samples import Samples
from sdpid.experiment.units import require_plausible_units
from sdpid.robot.friction import Coulomb, FrictionTerm
from sdpid.robot.inertia import Consistency
from sdpid.robot.model import RobotModel, load_robot

# Half-width of the smooth sign of real friction, rad/s: sensors' velocity noise makes the exact
# sign flicker near standstill.
SMOOTH = 0.02

# The cut-off for records without periods: this many times the frequency below which 95 % of the
# motion lies, and at most a sixth of the sampling rate.
_CUTOFF_OVER_MOTION = 40.0
_CUTOFF_OVER_RATE = 1.0 / 6.0


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
            "status": estimate.status,
            "cost": estimate.cost,
            "cost_unconstrained": self.wls.cost,
            "lower_bound": self.certificate.lower_bound,
            "gap": self.certificate.gap,
            "certified": self.certificate.passed,
            "worst_margin": estimate.worst_margin,
            "solve_time": estimate.solve_time,
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
        if self.validation is not None:
            lines.append(f"on the validation recording {100 * self.validation.relative:.2f} %")
        weak = self.problem.excitation.weak()
        if weak:
            lines.append(
                f"{len(weak)} directions are weakly excited, the weakest: "
                f"{', '.join(weak[-1][1]) or 'a mixture'} (singular value {weak[-1][0]:.1e})"
            )
        return "\n".join(lines)

    def save(self, folder: str | os.PathLike[str], *, figures: bool = True) -> tuple[Path, ...]:
        """Write tables, URDF, certificate and plots into a folder, each file whole or not at all.

        Parameters
        ----------
        folder : path
            Created when it is not there.
        figures : bool, optional
            Draw plots too (extra ``plot``).

        Returns
        -------
        tuple of Path
            The files.
        """
        from sdpid.output.tables import base_table, theta_table
        from sdpid.output.urdf import write_urdf

        out = Path(folder)
        out.mkdir(parents=True, exist_ok=True)
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
            write_urdf(self.estimate, target=files[-1])
        if figures:
            from sdpid.output.plots import plot_reconstruction, save_figure

            pairs = [("training", self.problem.samples, self.training)]
            if self.validation is not None and self.validation_samples is not None:
                pairs.append(("validation", self.validation_samples, self.validation))
            for name, samples, fit in pairs:
                time = np.arange(len(samples.effort)) if samples.time is None else samples.time
                figure = plot_reconstruction(
                    time,
                    samples.effort,
                    fit.effort_predicted,
                    self.problem.robot.joint_names,
                    fit.rmse,
                    mask=samples.mask,
                )
                files.append(out / f"{name}.png")
                save_figure(figure, files[-1])
        return tuple(files)


def default_processing(log: Recording) -> Processing:
    """Return how a recording is processed when nothing else is said.

    A record with periods is averaged over them, filtered at 10 Hz, as in the paper but with
    torque and regressor inputs filtered alike. A record without periods passes a filter of
    order 4 whose cut-off is 40 times the frequency below which 95 % of its motion lies, at most
    a sixth of the sampling rate; a recorded velocity is used where it was sampled below 100 Hz,
    where differences of the position lose too much.
    """
    if log.period is not None:
        return Processing()
    rate = log.rate_hz
    spectrum = np.abs(np.fft.rfft(log.position - log.position.mean(axis=0), axis=0)) ** 2
    total = spectrum.sum(axis=0)
    moving = total > 0.0
    if not np.any(moving):
        raise DataError("position: no joint moves; nothing can be identified.")
    share = np.cumsum(spectrum[:, moving] / total[moving], axis=0)
    frequency = np.fft.rfftfreq(len(log.position), 1.0 / rate)
    motion = float(np.median(frequency[(share < 0.95).sum(axis=0)]))
    slowest = rate / len(log.position)
    cutoff = min(_CUTOFF_OVER_MOTION * max(motion, slowest), _CUTOFF_OVER_RATE * rate)
    measured = log.velocity is not None and rate < 100.0
    return Processing(
        cutoff_hz=cutoff,
        order=4,
        decimation=None,
        reversal_time=None,
        velocity="measured" if measured else "differentiated",
        derivative="central4",
    )


def default_friction(log: Recording) -> tuple[str | FrictionTerm, ...]:
    """Return the friction terms used when nothing else is said.

    Records with periods are masked around reversals, where the exact sign is right. Others get
    a smooth sign and an offset for the sensors' zero errors.
    """
    if log.period is not None:
        return ("coulomb", "viscous")
    return (Coulomb(width=SMOOTH), "viscous", "offset")


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
        Margins and bounds.

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
    check = None
    if validation is not None:
        check = validation if isinstance(validation, Recording) else read_recording(validation)
    for each in (record, check):
        if each is not None:
            _require_fit(model, each)
    if processing is None:
        processing = default_processing(record)
    samples = process(_named(model, record), processing)
    problem = build_problem(
        model,
        samples,
        friction=default_friction(record) if friction is None else friction,
        weighting=weighting or ("residual" if samples.covariance is None else "gls"),
        consistency=consistency,
        constraints=constraints,
    )
    wls = solve_wls(problem)
    estimate = solve_sdp(problem)
    fresh = None if check is None else process(_named(model, check), processing)
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


def _require_fit(robot: RobotModel, log: Recording) -> None:
    if log.n != robot.n:
        raise DataError(
            f"the recording has {log.n} joints, the robot '{robot.name}' has {robot.n}: "
            f"{', '.join(robot.joint_names)}."
        )
    require_plausible_units(log, robot.position_limits)


def _named(robot: RobotModel, log: Recording) -> Recording:
    """Return the recording with its joints named and ordered as the robot's.

    Columns with the robot's names in another order are reordered. Names that share no joint with
    the robot (another prefix, say) are taken by position; a partial match is refused.
    """
    names = log.joint_names
    if names is None or tuple(names) == robot.joint_names:
        return replace(log, joint_names=robot.joint_names)
    if set(names) == set(robot.joint_names):
        order = [names.index(name) for name in robot.joint_names]
        velocity = None if log.velocity is None else log.velocity[:, order]
        scale = None if log.effort_scale is None else log.effort_scale[order]
        return replace(
            log,
            position=log.position[:, order],
            effort=log.effort[:, order],
            velocity=velocity,
            effort_scale=scale,
            joint_names=robot.joint_names,
        )
    common = set(names) & set(robot.joint_names)
    if common:
        missing = ", ".join(sorted(set(robot.joint_names) - common))
        raise DataError(
            f"joint names of the recording match the robot's only in part: it lacks {missing}; "
            "rename its columns."
        )
    endings = [name[-1:] for name in names]
    if endings != [name[-1:] for name in robot.joint_names]:
        raise DataError(
            f"joint names of the recording ({', '.join(names)}) are not the robot's "
            f"({', '.join(robot.joint_names)}); rename them, or leave names out to match by order."
        )
    return replace(log, joint_names=robot.joint_names)


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

