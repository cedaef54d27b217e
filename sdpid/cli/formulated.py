"""The problem of a run, from the options that commands share."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import sdpid.cli.options as opt

if TYPE_CHECKING:
    from sdpid.estimation.problem import Problem
    from sdpid.experiment.preparation.prepare import Prepared
    from sdpid.experiment.recording.recording import Recording
    from sdpid.robot.model.model import RobotModel


def robot_and_logs(
    robot: Path | str,
    logs: Sequence[Path],
    reading: opt.Reading,
    periods: opt.Periods,
    without_effort: Sequence[str],
) -> tuple[RobotModel, list[Recording]]:
    """Return the robot, with a floating base where a log has one, and the recordings."""
    from sdpid.experiment.preparation.prepare import columns_without
    from sdpid.experiment.recording.floating.robots import robot_of

    absent = columns_without(robot, without_effort)
    records = [reading.read(log, without_effort=absent, **periods.arguments()) for log in logs]
    return robot_of(robot, records), records


def formulated(
    robot: Path | str,
    logs: Sequence[Path],
    reading: opt.Reading,
    periods: opt.Periods,
    processing: opt.ProcessingOptions,
    estimation: opt.Estimation,
    acceptance: opt.Acceptance,
) -> tuple[Problem, Prepared]:
    """Return the problem that `sdpid identify` solves with these options, and its recordings.

    The problem's robot is `robot`, with a floating base where a log has one.
    """
    from sdpid.estimation.constraints.mass import known_mass
    from sdpid.experiment.preparation.prepare import prepare
    from sdpid.workflow.formulate import formulate

    absent = opt.joints(estimation.without_effort)
    model, records = robot_and_logs(robot, logs, reading, periods, absent)
    formulation = estimation.arguments(model)
    prepared = prepare(
        model,
        records,
        processing.changes(),
        without_effort=formulation.pop("without_effort"),
        total_mass=known_mass(formulation["constraints"].others),
        **acceptance.arguments(),
    )
    return formulate(model, prepared, **formulation), prepared
