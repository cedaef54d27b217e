"""A recording made ready for a robot: joints matched, units checked, defaults chosen."""

from __future__ import annotations

from dataclasses import replace

from sdpid.errors import DataError
from sdpid.experiment.choice import default_processing
from sdpid.experiment.processing import Processing, process
from sdpid.experiment.recording import Recording
from sdpid.experiment.samples import Samples
from sdpid.experiment.units import require_plausible_units
from sdpid.robot.friction import Coulomb, FrictionTerm, SigmoidFriction
from sdpid.robot.model import RobotModel

__all__ = ["default_friction", "default_processing", "match_joints", "prepare"]

# Half-width of the smooth sign of real friction, rad/s: sensors' velocity noise makes the exact
# sign flicker near standstill.
SMOOTH = 0.02


def default_friction(log: Recording) -> tuple[str | FrictionTerm, ...]:
    """Return the friction terms used when nothing else is said.

    Records with periods are masked around reversals, where the exact sign is right. Others get
    a smooth sign, beside it a sigmoid whose speeds the data choose, joint by joint, and an offset
    for the sensors' zero errors. The same terms serve torque sensors and motor currents: on five
    real robots none predicted worse for the sigmoid, and the others choose it whichever is left
    out (docs/real_robots.md). Rotor inertia and couplings are knowledge of the drives that
    a log does not hold; on torque sensors, which do not feel it, rotor inertia did harm.
    """
    if log.period is not None:
        return ("coulomb", "viscous")
    return (Coulomb(width=SMOOTH), SigmoidFriction(), "viscous", "offset")


def prepare(robot: RobotModel, log: Recording, processing: Processing | None = None) -> Samples:
    """Process a recording for a robot: joints matched, units checked.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    log : Recording
        What was measured. Joints with the robot's names are put in its order; names that share
        none with it are taken by position.
    processing : Processing, optional
        By default `default_processing`.

    Returns
    -------
    Samples

    Raises
    ------
    DataError
        When the joints are not the robot's, positions look like degrees, or the recording cannot
        be processed.
    """
    if log.n != robot.n:
        raise DataError(
            f"the recording has {log.n} joints, the robot '{robot.name}' has {robot.n}: "
            f"{', '.join(robot.joint_names)}."
        )
    named = match_joints(robot, log)
    require_plausible_units(named, robot.position_limits)
    return process(named, default_processing(named) if processing is None else processing)


def match_joints(robot: RobotModel, log: Recording) -> Recording:
    """Return a recording with its joints named and ordered as the robot's.

    Columns with the robot's names in another order are reordered. Names that share no joint with
    the robot (another prefix, say) are taken by position; a partial match is refused.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    log : Recording
        With as many joints.

    Returns
    -------
    Recording

    Raises
    ------
    DataError
        When the names match in part, or end differently.
    """
    names = log.joint_names
    if names is None or tuple(names) == robot.joint_names:
        return replace(log, joint_names=robot.joint_names)
    if set(names) == set(robot.joint_names):
        order = [names.index(name) for name in robot.joint_names]
        velocity = None if log.velocity is None else log.velocity[:, order]
        scale = None if log.effort_scale is None else log.effort_scale[order]
        return replace(
            log,
            position=log.position[:, order],
            effort=log.effort[:, order],
            velocity=velocity,
            effort_scale=scale,
            joint_names=robot.joint_names,
        )
    common = set(names) & set(robot.joint_names)
    if common:
        missing = ", ".join(sorted(set(robot.joint_names) - common))
        raise DataError(
            f"joint names of the recording match the robot's only in part: it lacks {missing}; "
            "rename its columns."
        )
    endings = [name[-1:] for name in names]
    if endings != [name[-1:] for name in robot.joint_names]:
        raise DataError(
            f"joint names of the recording ({', '.join(names)}) are not the robot's "
            f"({', '.join(robot.joint_names)}); rename them, or leave names out to match by order."
        )
    return replace(log, joint_names=robot.joint_names)
