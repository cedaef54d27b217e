"""`Plan`: a motion to run on the robot, its limits, and what it will buy."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from sdpid._common.arrays import Array, frozen
from sdpid._common.tables import Shown, Table
from sdpid.excitation.expected.expected import Expected
from sdpid.excitation.geometry.collision import CollisionModel
from sdpid.excitation.limits.check import LimitCheck
from sdpid.excitation.limits.joint_limits import JointLimits
from sdpid.experiment.trajectory.trajectory import Trajectory, played
from sdpid.robot.model.model import RobotModel

# Samples a second of pictures.
_RATE_HZ = 200.0


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
        from sdpid.excitation.plan.limited import limited_quantities
        from sdpid.plots.motion import plot_motion

        motion = played(self.trajectory, _RATE_HZ)
        joints = limited_quantities(self.robot, self.joint_limits, motion)
        return plot_motion(motion.time, dict(joints), axes=axes)
