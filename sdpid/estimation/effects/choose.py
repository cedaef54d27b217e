"""Choose by the data the numbers in which friction is not linear, by variable projection.

For any values of the open parameters the other parameters are a linear least-squares problem,
whose least cost is a function of the open parameters alone [golub2003]_. It is searched here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sdpid._common.arrays import Array
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.effects.variable_projection import OpenTerm, VariableProjection
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.base_parameters import structural_base
from sdpid.robot.model.model import RobotModel

# Samples looked at, evenly spread: speeds at which friction bends need no more.
_MOST_SAMPLES = 4096


@dataclass(frozen=True, kw_only=True)
class Profiled:
    """One number that was chosen by the data.

    Attributes
    ----------
    term, name, unit : str
        Which number of which term, such as ``width3`` of Coulomb.
    value : float
        Its value.
    lower, upper : float
        The limits of the search.
    flat_from, flat_to : float
        Values between which the cost is within 1 % of its least, the other open parameters
        held: how well the data determine it. Interpolated between the values tried.
    """

    term: str
    name: str
    unit: str
    value: float
    lower: float
    upper: float
    flat_from: float
    flat_to: float

    @property
    def determined(self) -> bool:
        """Whether some value within the limits is worse than the best by 1 % of the cost."""
        return self.flat_from > self.lower or self.flat_to < self.upper


def close_terms(
    friction: FrictionModel,
    robot: RobotModel,
    samples: Samples,
    covariance: Callable[[RowSource], Array],
) -> tuple[FrictionModel, tuple[Profiled, ...]]:
    """Give values to the open parameters of friction terms: those of the least cost.

    The cost is the weighted sum of squared residuals, least in all linear parameters; those of
    open terms obey their signs, since a negative peak can imitate a smooth sign. Physical
    consistency of the links, priors and further constraints have no say. One parameter is
    searched at a time, on a logarithmic grid and then about its best point, in rounds; nothing
    is random. Only the terms' columns change: all others are factorized once.

    Joint-wise terms have one value a joint, not one for the robot: speeds at which friction
    bends are those of a motor and its gear, and joints of one arm differ in both by factors.
    It costs no more, since each value moves one column.

    Parameters
    ----------
    friction : FrictionModel
        Terms, some of them with open parameters.
    robot : RobotModel
        The robot.
    samples : Samples
        The measurements to fit.
    covariance : callable
        Returns the effort covariance, (n, n) or (K, n, n), of a `RowSource`. It is called once,
        with the open parameters in the middle of their limits.

    Returns
    -------
    FrictionModel
        Without open parameters.
    tuple of Profiled
        What was chosen.
    """
    thin = samples.judged.thinned(_MOST_SAMPLES)
    opened = _opened(friction, _speeds(thin, friction.first))
    if not opened:
        return friction, ()
    middle = _closed(friction, opened)
    rows = RowSource(robot, middle, structural_base(robot, middle), thin)
    VariableProjection(rows, covariance(rows), opened).run()
    return _closed(friction, opened), _profiled(opened)


def closed_in_the_middle(
    friction: FrictionModel, speed: Array
) -> tuple[FrictionModel, tuple[Profiled, ...]]:
    """Give open parameters the middle of the limits that data of some speeds would search.

    For a run that is yet to be made, whose data cannot choose.

    Parameters
    ----------
    friction : FrictionModel
        Terms, some of them with open parameters.
    speed : ndarray, shape (K, n)
        Sizes of the velocities, rad/s or m/s.
    """
    opened = _opened(friction, list(speed[:, friction.first :].T))
    return _closed(friction, opened), _profiled(opened)


def _opened(friction: FrictionModel, speeds: Sequence[Array]) -> list[OpenTerm]:
    """Return the terms with open parameters, in the middle of the limits that speeds allow."""
    return [
        OpenTerm(place, term, parameters)
        for place, term in enumerate(friction.terms)
        if (parameters := term.open_parameters(speeds, friction.joint_names))
    ]


def _profiled(opened: Sequence[OpenTerm]) -> tuple[Profiled, ...]:
    """Return the values of open parameters, and the ranges in which others are as good."""
    return tuple(
        Profiled(
            term=type(each.term).__name__,
            name=parameter.name,
            unit=parameter.unit,
            value=value,
            lower=parameter.lower,
            upper=parameter.upper,
            flat_from=flat[0],
            flat_to=flat[1],
        )
        for each in opened
        for parameter, value, flat in zip(each.parameters, each.values, each.flat, strict=True)
    )


def _speeds(samples: Samples, first: int) -> list[Array]:
    """Return the speeds of each joint at the samples whose row is used."""
    speed = np.abs(samples.velocity[:, first:])
    if samples.mask is None:
        return list(speed.T)
    return [s[m] for s, m in zip(speed.T, samples.mask[:, first:].T, strict=True)]


def _closed(friction: FrictionModel, opened: Sequence[OpenTerm]) -> FrictionModel:
    """Return the terms with the present values of the open parameters."""
    terms = list(friction.terms)
    for each in opened:
        terms[each.place] = each.closed
    return replace(friction, terms=tuple(terms))
