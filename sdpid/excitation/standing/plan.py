"""`StandingPlan`: a motion of a standing robot, its limits, expected errors, and its folder."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sdpid import __version__
from sdpid._common.arrays import Array, frozen
from sdpid._common.staging import RunFolder
from sdpid._common.tables import Shown, Table, plain_dict
from sdpid.excitation.limits.check import LimitCheck
from sdpid.excitation.standing.held import Held
from sdpid.excitation.standing.stance import Stance
from sdpid.experiment.trajectory.curve import Curve
from sdpid.experiment.trajectory.whole_body import WholeBodyMotion
from sdpid.plots.figures import save_figure
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
        return (
            f"after {self.curve.duration:g} s {self._known()}",
            f"most is gained of {', '.join(best)}",
            *(
                f"nearest limit of {row.kind}: {row.subject} comes to {row.reached:.4g} {row.unit},"
                f" the {'least' if row.side == 'lower' else 'most'} is {row.limit:.4g}"
                for row in self.limits.nearest
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


_TRAJECTORY, _PLOT, _CONFIG, _RESULT = "trajectory.csv", "plot.png", "plan.toml", "plan.json"
_FOLDER = RunFolder((_TRAJECTORY, _PLOT, _CONFIG, _RESULT), _RESULT, _CONFIG, careful=True)

require_writable = _FOLDER.require_writable


def write_standing(
    plan: StandingPlan,
    folder: str | os.PathLike[str],
    *,
    figures: bool | None = None,
    config: str | None = None,
) -> tuple[Path, ...]:
    """Write a plan into a folder, all files or none.

    ``trajectory.csv`` holds joints, torques, base, contacts and planned forces at 500 Hz,
    ``plot.png`` shows the base and what the feet bear, ``plan.toml`` the options of the command,
    and ``plan.json`` limits, expected errors and everything that was assumed.

    Parameters
    ----------
    plan : StandingPlan
        From `design_standing`.
    folder : str or path
        Made where it does not exist; the files of an earlier plan in it are replaced.
    figures : bool, optional
        Draw the plot; by default where matplotlib is installed.
    config : str, optional
        Text of ``plan.toml``, which is not written without; settings stand in ``plan.json``.

    Returns
    -------
    tuple of Path
        The files.

    Raises
    ------
    ExportError
        When the folder cannot be written to, or holds files of these names that no plan wrote.
    MissingExtraError
        When figures are asked for and matplotlib is not installed (extra ``plot``).

    Examples
    --------
    >>> from sdpid.excitation.standing.plan import write_standing
    >>> standing = sdpid.design_standing("solo12", duration=2.0, steps=2)
    >>> [path.name for path in write_standing(standing, "standing", figures=False)]
    ['trajectory.csv', 'plan.json']
    """
    target = Path(folder)
    require_writable(target, writes_config=config is not None)
    draw = importlib.util.find_spec("matplotlib") is not None if figures is None else figures

    def fill(stage: Path) -> dict[str, Any]:
        plan.motion.to_csv(stage / _TRAJECTORY)
        if draw:
            save_figure(plan.plot()[0], stage / _PLOT)
        if config is not None:
            (stage / _CONFIG).write_text(config, encoding="utf-8")
        return plan_content(plan)

    return _FOLDER.write(target, fill)


def plan_content(plan: StandingPlan) -> dict[str, Any]:
    """Return a plan's results as plain values: limits, expected errors, notes."""
    content = {
        "sdpid": __version__,
        "robot": plan.robot.name,
        "joint_names": plan.motion.joint_names,
        "feet": plan.motion.frames,
        "duration_s": plan.motion.duration,
        "base_parameters": plan.table(),
        "limits": plan.limits.to_dict(),
        "sentences": plan.sentences(),
        "notes": plan.notes,
        "settings": plan.settings,
    }
    return plain_dict(content)
