"""`Plan`: a motion to run on the robot, its limits, and what it will buy."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid._common.tables import Shown, Table, plain
from sdpid.excitation.expected.expected import Expected
from sdpid.excitation.geometry.collision import CollisionModel
from sdpid.excitation.limits.check import LimitCheck
from sdpid.excitation.limits.joint_limits import UNITS, JointLimits
from sdpid.excitation.limits.limits import Limits
from sdpid.excitation.limits.torque import TorqueModel
from sdpid.experiment.trajectory.trajectory import Played, Trajectory, played
from sdpid.robot.model.model import RobotModel

# Samples a second of pictures.
_RATE_HZ = 200.0

# Label with unit, values (K,), and lower and upper limit, None where there is none.
Quantity: TypeAlias = tuple[str, Array, float | None, float | None]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Plan(Shown):
    """A motion that holds its limits at every instant, and shows the parameters.

    Attributes
    ----------
    robot : RobotModel
        The robot.
    trajectory : Trajectory
        The motion.
    limits : LimitCheck
        The proof that it holds its limits, with the slack of each.
    joint_limits : JointLimits
        The limits, and what was assumed of them.
    collision : CollisionModel or None
        The pairs whose distances were checked; None where collisions were left out.
    names : tuple of str
        The b base parameters of `standard_errors`.
    standard_errors : ndarray, shape (b,)
        Expected after the run, prior and earlier runs included.
    condition_number : float
        Of the stacked regressor of the base parameters, its columns scaled to unit length.
    log_det : float
        ``log det(W^T·W/K)`` of it.
    expected : Expected
        Intervals, bands, open directions, and how they shrink with time.
    objective, purpose, motion : str
        What was made small, what for, and which kind of motion.
    notes : tuple of str
        What was assumed, chosen or found, one sentence each.
    settings : dict
        Arguments of `design_excitation` from which the plan can be made again.
    history : tuple of dict
        One row a start: its value, steps, seconds and how it ended.

    Examples
    --------
    >>> plan.limits.ok, plan.trajectory.duration
    (True, 5.0)
    >>> plan.names[:2], plan.standard_errors.shape
    (('zzr1', 'Fs1'), (16,))
    >>> axes = plan.plot()
    """

    robot: RobotModel
    trajectory: Trajectory
    limits: LimitCheck
    joint_limits: JointLimits
    collision: CollisionModel | None
    names: tuple[str, ...]
    standard_errors: Array
    condition_number: float
    log_det: float
    expected: Expected
    objective: str
    purpose: str
    motion: str
    notes: tuple[str, ...] = ()
    settings: dict[str, Any] = field(default_factory=dict)
    history: tuple[dict[str, Any], ...] = ()

    _facts = (
        "robot.name",
        "trajectory.period, s",
        "limits.ok",
        "objective",
        "purpose",
        "condition_number",
        "log_det",
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "standard_errors", frozen(self.standard_errors))

    def _tables(self) -> Iterator[Table]:
        yield Table(("notes",), tuple((each,) for each in self.notes))

    def plot(self, *, axes: Any = None) -> Any:
        """Show each joint's motion against its limits, which are dashed (extra ``plot``).

        Parameters
        ----------
        axes : array of matplotlib.axes.Axes, shape (5, n), optional
            Where to draw; by default in a figure of its own.

        Returns
        -------
        ndarray of matplotlib.axes.Axes, shape (5, n)
            One column a joint: position, velocity, acceleration, jerk and torque over time.
        """
        from sdpid.plots.motion import plot_motion

        motion = played(self.trajectory, _RATE_HZ)
        joints = limited_quantities(self.robot, self.joint_limits, motion)
        return plot_motion(motion.time, dict(joints), axes=axes)


def limited_quantities(
    robot: RobotModel, limits: JointLimits, motion: Played
) -> Iterator[tuple[str, list[Quantity]]]:
    """Yield each joint's position, velocity, acceleration, jerk and torque, with their limits.

    Parameters
    ----------
    robot : RobotModel
        The robot; its description says the torques.
    limits : JointLimits
        The limits.
    motion : Played
        The motion.

    Yields
    ------
    str
        The joint.
    list of (str, ndarray of shape (K,), float or None, float or None)
        Label with unit, values, lower and upper limit, for `sdpid.plots.plot_against_limits`.
    """
    model = TorqueModel.of(robot)
    torque = model.torque(motion.position, motion.velocity, motion.acceleration)
    limited = {"lower": (motion.position, limits.lower, limits.upper)}
    for kind, values, most in (
        ("velocity", motion.velocity, limits.velocity),
        ("acceleration", motion.acceleration, limits.acceleration),
        ("jerk", motion.jerk, limits.jerk),
        ("torque", torque, model.allowed(limits.torque)),
    ):
        limited[kind] = values, -most, most
    for j, name in enumerate(robot.joint_names):
        yield (
            name,
            [
                (UNITS[kind][int(robot.slides[j])], values[:, j], *_ends(least[j], most[j]))
                for kind, (values, least, most) in limited.items()
            ],
        )


def _ends(least: float, most: float) -> tuple[float | None, float | None]:
    """Return limits, None where there are none."""
    lower, upper = (float(end) if np.isfinite(end) else None for end in (least, most))
    return lower, upper


def settings_of(arguments: dict[str, Any], **instead: Any) -> dict[str, Any]:
    """Return arguments as what JSON can hold; those that are None or empty are left out.

    What has no plain form, such as a recording, becomes the words that name it.
    """
    settings = {}
    for name, value in {**arguments, **instead}.items():
        if value is None or (isinstance(value, tuple | list) and not value):
            continue
        try:
            settings[name] = value.to_dict() if isinstance(value, Limits) else plain(value)
        except TypeError:
            settings[name] = repr(value)
    return settings
