"""What options of the command choose: processing, friction terms, constraints."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sdpid.cli import options as opt
from sdpid.errors import ModelError

if TYPE_CHECKING:
    from sdpid.assurance.diagnostics.validation import Validation
    from sdpid.estimation.constraints.constraints import Constraints
    from sdpid.experiment.recording.recording import Recording
    from sdpid.robot.friction.model import FrictionTerm
    from sdpid.robot.model.model import RobotModel


def read(path: Path, **how: Any) -> Recording:
    """Read a log."""
    from sdpid.experiment.readers.read import read_recording

    return read_recording(path, **how)


def processing(
    cutoff: float | None,
    order: int | None,
    velocity: opt.Velocity | None,
    low_pass: str | None,
    derivative: str | None,
) -> dict[str, Any]:
    """Return what is to be other than by default."""
    changes: dict[str, Any] = {
        "cutoff_hz": cutoff,
        "order": order,
        "velocity": None if velocity is None else velocity.value,
        "filter": low_pass,
        "derivative": derivative,
    }
    return {name: value for name, value in changes.items() if value is not None}


def friction_terms(given: list[str] | None) -> list[str | FrictionTerm] | None:
    """Turn options into terms: names, or names with a speed or joints."""
    from sdpid.robot.friction.model import (
        AsymmetricCoulomb,
        Coulomb,
        Coupling,
        SigmoidFriction,
        Stribeck,
    )

    smooth: dict[str, Callable[[float | None], FrictionTerm]] = {
        "coulomb": lambda width: Coulomb(width=width),
        "asymmetric_coulomb": lambda width: AsymmetricCoulomb(width=width),
        "stribeck": lambda speed: Stribeck(velocity=speed),
        "sigmoid": lambda speed: SigmoidFriction(velocity=speed),
    }
    terms: list[str | FrictionTerm] = []
    for text in given or ():
        name, equals, value = text.partition("=")
        if not equals:
            terms.append(text)
        elif name in smooth:
            speeds = [None] if value == "fit" else opt.numbers(value, f"--friction {name}")
            if len(speeds) != 1:
                raise ModelError(
                    f"--friction {text}: has {len(speeds)} speeds; give one, which holds for every "
                    "joint, or fit, which chooses one for each."
                )
            terms.append(smooth[name](speeds[0]))
        elif name == "coupling" and value.count(",") == 1:
            first, second = opt.split_list(value)
            terms.append(Coupling(first, second))
        else:
            raise ModelError(
                f"--friction {text}: takes no value; with one there are coulomb=WIDTH, "
                "asymmetric_coulomb=WIDTH, stribeck=SPEED, sigmoid=SPEED (a speed in rad/s, or "
                "fit) and coupling=JOINT,JOINT."
            )
    return terms or None


def constraints_of(robot: RobotModel, margin: float, mass_max: float | None) -> Constraints:
    """Return bounds that follow the robot's size, with what was given."""
    from sdpid.estimation.constraints.constraints import Constraints

    given = {} if mass_max is None else {"mass_max": mass_max}
    return Constraints.of_size(robot, margin=margin, **given)


def errors_table(fits: dict[str, Validation]) -> str:
    """Return the errors of every joint, a pair of columns for each fit."""
    from sdpid._common.tables import Table

    names = next(iter(fits.values())).joint_names
    header = ["joint"]
    columns: list[list[Any]] = [list(names)]
    for label, fit in fits.items():
        header += [f"{label} RMSE [N.m]", "NRMSE [%]"]
        for values in (fit.rmse, 100.0 * fit.nrmse):
            pairs = zip(values.tolist(), fit.rows.tolist(), strict=True)
            columns.append([value if rows else None for value, rows in pairs])
    return Table(tuple(header), tuple(zip(*columns, strict=True))).text(4)
