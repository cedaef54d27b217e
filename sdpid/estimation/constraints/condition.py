"""Further conditions on the parameters, beside consistency, masses and signs.

A condition is a small object that turns itself, for a robot, into linear rows and
second-order cones in theta. All conditions are convex, so the optimum stays global and provable.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import ModelError
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.model import RobotModel


@dataclass(frozen=True, eq=False)
class Row:
    """One linear condition ``lower ≤ coefficients @ theta ≤ upper``.

    Attributes
    ----------
    name : str
        In words, such as ``"total mass"``.
    coefficients : ndarray, shape (p,)
    lower, upper : float
        Equal for an equation, infinite where there is no limit.
    """

    name: str
    coefficients: Array
    lower: float
    upper: float


@dataclass(frozen=True, eq=False)
class Cone:
    """One second-order cone ``‖vectors @ body‖ ≤ axis @ body`` on the ten parameters of a link.

    Attributes
    ----------
    name : str
        In words.
    link : int
        Which link, from 0.
    axis : ndarray, shape (10,)
    vectors : ndarray, shape (3, 10)
    """

    name: str
    link: int
    axis: Array
    vectors: Array


@dataclass(frozen=True, eq=False)
class Layout:
    """Where the parameters of a robot with its friction terms are in theta.

    Attributes
    ----------
    robot : RobotModel
        The robot.
    friction : FrictionModel
        Its friction terms.
    """

    robot: RobotModel
    friction: FrictionModel

    @property
    def names(self) -> tuple[str, ...]:
        """Names of theta."""
        return (*self.robot.parameter_names, *(p.name for p in self.friction.parameters))

    @property
    def units(self) -> tuple[str, ...]:
        """Units of theta."""
        return (*self.robot.parameter_units, *(p.unit for p in self.friction.parameters))

    @property
    def count(self) -> int:
        """Size p of theta."""
        return 10 * self.robot.n_links + len(self.friction.parameters)

    def link(self, name: str) -> int:
        """Return the index of a link.

        Raises
        ------
        ModelError
            When the robot has no such link.
        """
        if name not in self.robot.link_names:
            raise ModelError(
                f"constraints: '{self.robot.name}' has no link '{name}'; its links are "
                f"{', '.join(self.robot.link_names)}."
            )
        return self.robot.link_names.index(name)

    def parameter(self, name: str) -> int:
        """Return the index of a standard parameter in theta.

        Raises
        ------
        ModelError
            When there is no such parameter.
        """
        if name not in self.names:
            raise ModelError(
                f"constraints: no standard parameter is called '{name}'; there are "
                f"{', '.join(self.names)}."
            )
        return self.names.index(name)

    def body(self, link: int, coefficients: Array) -> Array:
        """Return coefficients (..., 10) of one link as coefficients (..., p) of theta."""
        out = np.zeros((*coefficients.shape[:-1], self.count))
        out[..., 10 * link : 10 * link + 10] = coefficients
        return out


class Condition(ABC):
    """Base of every condition."""

    @abstractmethod
    def compile(self, layout: Layout) -> Iterable[Row | Cone]:
        """Return the condition as rows and cones in a robot's theta.

        Raises
        ------
        ModelError, DataError
            When it names what the robot does not have, or has numbers that make no sense.
        """
