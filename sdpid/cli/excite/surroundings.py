"""Options of ``sdpid excite`` for what the motion must obey."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sdpid.cli.values import numbers, pairs
from sdpid.errors import DataError

if TYPE_CHECKING:
    from sdpid.excitation.geometry.obstacles import Obstacle
    from sdpid.excitation.limits.limits import Limits

_limits = functools.partial(typer.Option, rich_help_panel="Limits and surroundings")


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """What the motion must obey."""

    limits: Annotated[
        Path | None,
        _limits(
            metavar="FILE",
            help="TOML file with a table a joint (lower, upper, velocity, acceleration, jerk, "
            "torque), one named arm (tool_speed, clearance), and obstacles as in --obstacles. The "
            "tighter of it and the description holds.",
        ),
    ] = None
    table: Annotated[
        bool, _limits("--table", help="A table under the arm, at the height of its base.")
    ] = False
    table_height: Annotated[
        float | None, _limits(metavar="M", help="A table whose top is at this height, m.")
    ] = None
    wall: Annotated[
        list[str] | None,
        _limits(
            metavar="DIRECTION=M",
            help="A wall at a distance from the base, such as -x=0.3. May be repeated.",
        ),
    ] = None
    obstacles: Annotated[
        Path | None,
        _limits(metavar="FILE", help="TOML file of planes, boxes, meshes, tables and walls."),
    ] = None
    clearance: Annotated[
        float | None,
        _limits(metavar="M", help="Least distance between parts, and to obstacles, m."),
    ] = None
    collisions: Annotated[
        bool,
        _limits(
            "--collisions/--no-collisions",
            help="Keep the robot from touching itself and obstacles.",
        ),
    ] = True
    torque_spread: Annotated[
        float,
        _limits(
            metavar="X",
            min=0.0,
            help="Standard deviations of the description's inertias by which torques may be larger "
            "than nominal.",
        ),
    ] = 0.0
    package_dir: Annotated[
        list[Path] | None,
        _limits(metavar="FOLDER", help="Where package:// names of meshes are. May be repeated."),
    ] = None

    def arguments(self) -> dict[str, Any]:
        """Return the arguments that `design_excitation` and `check_trajectory` share."""
        return {
            "limits": self.given_limits(),
            "obstacles": self.obstacles_around(),
            "package_dirs": tuple(self.package_dir or ()),
        }

    def given_limits(self) -> Limits | None:
        """Return the limits that narrow the description's, None where none are given."""
        from dataclasses import replace

        from sdpid.excitation.limits.limits import Limits

        if self.limits is None and self.clearance is None:
            return None
        given = Limits() if self.limits is None else Limits.from_toml(self.limits)
        return given if self.clearance is None else replace(given, clearance=self.clearance)

    def obstacles_around(self) -> tuple[Obstacle, ...]:
        """Return the obstacles that options and files name.

        Raises
        ------
        DataError
            When the table stands twice, or a wall or file is not understood.
        """
        from sdpid.excitation.geometry.obstacles import obstacles_from_toml, table, wall

        found: list[Obstacle] = []
        if self.table or self.table_height is not None:
            found.append(table(self.table_height or 0.0))
        for direction, distance in pairs(self.wall, "--wall").items():
            if len(distances := numbers(distance, f"--wall {direction}")) != 1:
                raise DataError(f"--wall {direction}={distance}: give one distance, m.")
            found.append(wall(distances[0], direction))
        if self.obstacles is not None:
            found += obstacles_from_toml(self.obstacles)
        if self.limits is not None:
            from sdpid._common.files import load_toml
            from sdpid.excitation.limits.limits import OBSTACLES

            own = {k: v for k, v in load_toml(self.limits).items() if k in OBSTACLES}
            found += obstacles_from_toml(own, self.limits.parent)
        return tuple(found)
