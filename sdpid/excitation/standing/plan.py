"""`StandingPlan`: a motion of a standing robot, its limits and what it will buy."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid._common.tables import Shown, Table
from sdpid.excitation.limits.check import LimitCheck
from sdpid.excitation.standing.held import Held
from sdpid.excitation.standing.stance import Stance
from sdpid.experiment.trajectory.curve import Curve
from sdpid.experiment.trajectory.whole_body import WholeBodyMotion
from sdpid.robot.model.base_parameters import BaseParameters
from sdpid.robot.model.model import RobotModel

# A parameter is known well where its standard error is this share of what it was before.
_KNOWN = 0.1


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class StandingPlan(Shown):
    """A motion of a robot whose feet stay where they are.

    Attributes
    ----------
    stance : Stance
        The robot on its feet.
    curve : Curve
        Displacement of the base from its standing pose, m, and roll, pitch and yaw, rad; then the
        joints beside the legs, rad.
    limits : LimitCheck
        What the motion comes to, beside its limits.
    held : Held
        The limits themselves.
    base : BaseParameters
        The base parameters of robot and friction.
    values : ndarray, shape (b,)
        What they were assumed to be.
    standard_errors, before : ndarray, shape (b,)
        Expected after the run and before it, prior and earlier plans included.
    information : ndarray, shape (b, b)
        What the run tells of the base parameters.
    known : ndarray, shape (b, b)
        What is known before it, by the prior and earlier plans.
    spread : ndarray, shape (n,)
        Spectral density that errors of the base's rows and of torques were taken to have.
    notes : tuple of str
        What was assumed, chosen or found.
    settings : dict
        Arguments of `design_standing`.
    motion : WholeBodyMotion
        Joints, torques, base, flags and planned forces at 500 Hz.

    Examples
    --------
    >>> standing = sdpid.design_standing("solo12", duration=2.0, steps=2)
    >>> standing.limits.ok, standing.motion.duration
    (True, 2.0)
    >>> standing.table().header[:3]
    ('parameter', 'unit', 'assumed')
    """

    stance: Stance
    curve: Curve
    limits: LimitCheck
    held: Held
    base: BaseParameters
    values: Array
    standard_errors: Array
    before: Array
    information: Array
    known: Array
    spread: Array
    notes: tuple[str, ...] = ()
    settings: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("values", "standard_errors", "before", "information", "known", "spread"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        object.__setattr__(self, "motion", self._sampled())

    # Made once: inverse kinematics takes a second.
    motion: WholeBodyMotion = field(init=False)

    _facts = ("robot.name", "curve.duration, s", "limits.ok", "_known")

    @property
    def robot(self) -> RobotModel:
        """The robot, on a floating base."""
        return self.stance.robot

    def _tables(self) -> Iterator[Table]:
        yield Table(("notes",), tuple((each,) for each in self.notes))

    def _known(self) -> str:
        sharp = int(np.sum(self.standard_errors < _KNOWN * self.before))
        return f"{sharp} of {self.base.count} base parameters known ten times as well as before"

    def sentences(self) -> tuple[str, ...]:
        """Return what the run will buy, and which limit is nearest, in words."""
        bought = np.log(self.before / self.standard_errors)
        best = [self.base.names[i] for i in np.argsort(-bought)[:5]]
        nearest = [
            row
            for kind in dict.fromkeys(row.kind for row in self.limits.rows)
            if (row := self.limits.least(kind)) is not None
        ]
        return (
            f"after {self.curve.duration:g} s {self._known()}",
            f"most is gained of {', '.join(best)}",
            *(
                f"nearest limit of {row.kind}: {row.subject} comes to {row.reached:.4g} {row.unit},"
                f" the {'least' if row.side == 'lower' else 'most'} is {row.limit:.4g}"
                for row in nearest
            ),
        )

    def table(self) -> Table:
        """Return one row a base parameter: assumed value, standard error, and that before."""
        return Table.of_columns(
            {
                "parameter": self.base.names,
                "unit": self.base.units,
                "assumed": self.values.tolist(),
                "standard error": self.standard_errors.tolist(),
                "before": self.before.tolist(),
            }
        )

    def _sampled(self) -> WholeBodyMotion:
        """Return the motion at 500 Hz, its last instant included."""
        time, states = self.stance.sampled(self.curve)
        torque, wrenches = self.held.loads(states)
        q = states.poses.configuration
        return WholeBodyMotion(
            joint_names=self.robot.joint_names[6:],
            time=time,
            position=q[:, 7:],
            velocity=states.velocity[:, 6:],
            acceleration=states.acceleration[:, 6:],
            effort=torque,
            base_position=q[:, :3],
            base_orientation=q[:, 3:7],
            frames=self.stance.legs.frames,
            down=np.ones((len(time), len(self.stance.legs.frames)), dtype=bool),
            forces=wrenches[:, :, :3],
        )

    def plot(self, *, axes: Any = None) -> Any:
        """Show the base's motion, and what joints and feet use of their limits (extra ``plot``).

        Parameters
        ----------
        axes : array of matplotlib.axes.Axes, shape (4,), optional
            Where to draw; by default in a figure of its own.

        Returns
        -------
        ndarray of matplotlib.axes.Axes, shape (4,)
            Displacement of the base, its angles, normal forces of the feet, and the share of
            friction that they use.
        """
        from sdpid.plots.motion import plot_standing

        motion = self.motion
        time, force = motion.time, motion.forces
        x = self.curve.evaluate(time)
        used = np.linalg.norm(force[:, :, :2], axis=2) / force[:, :, 2] / self.held.grip
        return plot_standing(
            time, x[:, :3], x[:, 3:6], self.stance.legs.frames, force[:, :, 2], used,
            load=self.held.load, axes=axes,
        )  # fmt: skip
