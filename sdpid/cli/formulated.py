"""The problem of a run, from the options that commands share."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import sdpid.cli.options as opt

if TYPE_CHECKING:
    from sdpid.estimation.problem import Problem
    from sdpid.experiment.preparation.several import Prepared
    from sdpid.robot.model.model import RobotModel


def formulated(
    robot: RobotModel | Path | str,
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
    from sdpid.experiment.preparation.several import columns_without, prepare_recordings
    from sdpid.experiment.recording.floating.robots import robot_of
    from sdpid.workflow.formulate import formulate

    model = robot_of(robot)
    absent = columns_without(model, estimation.arguments(model)["without_effort"])
    records = [reading.read(log, without_effort=absent, **periods.arguments()) for log in logs]
    model = robot_of(robot, records)
    formulation = estimation.arguments(model)
    prepared = prepare_recordings(
        model,
        records,
        processing.changes(),
        without_effort=formulation.pop("without_effort"),
        total_mass=known_mass(formulation["constraints"].others),
        **acceptance.arguments(),
    )
    return formulate(model, prepared, **formulation), prepared
