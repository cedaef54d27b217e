"""Parameters that were found elsewhere, read from a file, by name."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

import numpy as np

from sdpid.assurance.tables.csv_table import half_unit, read_base_table
from sdpid.errors import DataError, ModelError
from sdpid.estimation.problem import Problem
from sdpid.output.tables.parameters_file import read_parameters
from sdpid.robot.description.level import without_level
from sdpid.robot.description.xml import read_description
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel
from sdpid.verifier.reading import listed

# Joints of two descriptions that are this near to each other (m, rad) are the same.
_SAME_PLACE = 1e-6

# No parameter of a robot is larger or, unless it is zero, smaller: squares of them are doubles.
_LARGEST, _SMALLEST = 1e12, 1e-100

# Names of parameters that a message lists.
_LISTED = 8

_DESCRIPTIONS = (".urdf", ".xml", ".mjcf", ".xacro")


@dataclass(frozen=True, kw_only=True)
class GivenParameters:
    """Parameters by name.

    Attributes
    ----------
    source : str
        Where they come from.
    values : dict
        Values in SI units by the names of standard parameters (``m_1``, ``Fs1``) or of base
        parameters (``zzr1``).
    halfwidths : dict
        How far from these they may be: half a unit in the last printed place.
    """

    source: str
    values: Mapping[str, float]
    halfwidths: Mapping[str, Fraction] = field(default_factory=dict)

    def standard(self, problem: Problem) -> bool:
        """Return whether they hold all parameters of the links, else all base parameters.

        Raises
        ------
        DataError
            When neither is so, a name is not one of the problem's, or a number no robot's.
        """
        base = problem.base
        rigid = base.theta_names[: 10 * problem.robot.n_links]
        friction = base.theta_names[len(rigid) :]
        known = {*base.theta_names, *base.names}
        if unknown := [name for name in self.values if name not in known]:
            raise DataError(
                f"{self.source}: the problem has no parameters {listed(unknown, _LISTED)}; name "
                "the friction terms that have them with friction=(...) (--friction TERM), or leave "
                "them out."
            )
        for name, x in self.values.items():
            if x and not _SMALLEST <= abs(x) <= _LARGEST:
                raise DataError(
                    f"{self.source}: {name} is {x:g}; no robot has a parameter beyond "
                    f"{_LARGEST:g}, or that near to zero (give 0)."
                )
        lacking = [name for name in rigid if name not in self.values]
        if not lacking:
            return True
        wanted = [name for name in base.names if name not in friction]
        missing = [name for name in wanted if name not in self.values]
        if missing:
            raise DataError(
                f"{self.source}: holds neither all {len(rigid)} parameters of the links (without "
                f"{listed(lacking, _LISTED)}) nor all {len(wanted)} base parameters (without "
                f"{listed(missing, _LISTED)})."
            )
        return False


def read_given(
    path: str | os.PathLike[str], robot: RobotModel, *, value: str = "value"
) -> GivenParameters:
    """Read parameters from a file of another run, tool or publication.

    Parameters
    ----------
    path : str or path
        JSON or YAML that `write_parameters` wrote; CSV with a column ``name`` (or ``parameter``)
        and one of values; URDF or MJCF, whose joints must be the robot's.
    robot : RobotModel
        Whose parameters they are.
    value : str, optional
        Column of the values in a CSV.

    Raises
    ------
    DataError, ModelError
        When the file cannot be read, or is of another robot.
    """
    file = Path(path)
    suffix = file.suffix.lower()
    if suffix in _DESCRIPTIONS:
        # A base that a run found to be tilted is no matter of the links.
        text = read_description(path).text
        source = path if without_level(text) == text else without_level(text)
        given = load_robot(source)
        if robot.free_flyer and not given.free_flyer:
            given = load_robot(source, root="free_flyer")
        return GivenParameters(source=file.name, values=_described(given, robot, file))
    if suffix == ".csv":
        table = read_base_table(path, value=value)
        numbers = {name: float(x) for name, x in table.values.items()}
        return GivenParameters(source=file.name, values=numbers, halfwidths=table.halfwidths)
    numbers = read_parameters(path)
    halves = {name: half_unit(repr(x)) for name, x in numbers.items()}
    return GivenParameters(source=file.name, values=numbers, halfwidths=halves)


def _described(given: RobotModel, robot: RobotModel, file: Path) -> dict[str, float]:
    """Return the links, friction and armature of a description, by the robot's names."""
    if given.joint_names != robot.joint_names or given.link_names != robot.link_names:
        raise ModelError(
            f"{file}: has the joints {listed(given.joint_names, _LISTED)}, the robot "
            f"'{robot.name}' {listed(robot.joint_names, _LISTED)}; give a description of the same "
            "robot."
        )
    for name, own, other in zip(
        robot.pin_model.names,
        robot.pin_model.jointPlacements,
        given.pin_model.jointPlacements,
        strict=True,
    ):
        if np.abs(own.homogeneous - other.homogeneous).max() > _SAME_PLACE:
            raise ModelError(
                f"{file}: joint {name} is elsewhere than in '{robot.name}', so that its links' "
                "parameters are about other frames; give a description with the same kinematics."
            )
    found = dict(zip(robot.parameter_names, given.prior.ravel().tolist(), strict=True))
    damping, dry = given.described_friction()
    for symbol, each in (("Fs", dry), ("Fv", damping), ("Ia", given.described_armature())):
        if np.any(each):
            joints = each[given.n_base :].tolist()
            found.update({f"{symbol}{j + 1}": x for j, x in enumerate(joints)})
    return found
