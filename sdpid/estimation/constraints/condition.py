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

    Examples
    --------
    >>> coefficients = np.zeros(problem.n_theta)
    >>> coefficients[[40, 50]] = 1.0
    >>> row = sdpid.constraints.Row("mass of the wrist", coefficients, 0.0, 4.0)
    >>> row.upper
    4.0
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

    Examples
    --------
    >>> parameters = np.eye(10)
    >>> cone = sdpid.constraints.Cone("near the origin", 5, 0.1 * parameters[0], parameters[1:4])
    >>> cone.link
    5
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

    Examples
    --------
    >>> layout = sdpid.constraints.Layout(robot, problem.friction)
    >>> layout.count, layout.link("link_2"), layout.parameter("m_2")
    (72, 1, 10)
    >>> layout.names[:3], layout.units[:3]
    (('m_1', 'mx_1', 'my_1'), ('kg', 'kg.m', 'kg.m'))
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
        names = self.robot.link_names
        return _place(name, names, f"'{self.robot.name}' has no link '{name}'; its links are")

    def parameter(self, name: str) -> int:
        """Return the index of a standard parameter in theta.

        Raises
        ------
        ModelError
            When there is no such parameter.
        """
        return _place(name, self.names, f"no standard parameter is called '{name}'; there are")

    def body(self, link: int, coefficients: Array) -> Array:
        """Return coefficients (..., 10) of one link as coefficients (..., p) of theta."""
        out = np.zeros((*coefficients.shape[:-1], self.count))
        out[..., 10 * link : 10 * link + 10] = coefficients
        return out


def _place(name: str, names: tuple[str, ...], otherwise: str) -> int:
    """Return where a name is among others, or raise."""
    if name not in names:
        raise ModelError(f"constraints: {otherwise} {', '.join(names)}.")
    return names.index(name)


class Condition(ABC):
    """Base of every condition.

    Examples
    --------
    >>> class Lighter(sdpid.constraints.Condition):
    ...     def compile(self, layout):
    ...         row = np.zeros(layout.count)
    ...         row[layout.parameter("m_6")], row[layout.parameter("m_5")] = 1.0, -1.0
    ...         yield sdpid.constraints.Row("link_6 lighter than link_5", row, -np.inf, 0.0)
    >>> limits = sdpid.Constraints(others=(Lighter(),))
    >>> found = sdpid.solve_sdp(problem.constrained(constraints=limits)).named_theta()
    >>> bool(found["m_6"] <= found["m_5"])
    True
    """

    @abstractmethod
    def compile(self, layout: Layout) -> Iterable[Row | Cone]:
        """Return the condition as rows and cones in a robot's theta.

        Raises
        ------
        ModelError, DataError
            When it names what the robot does not have, or has numbers that make no sense.
        """
