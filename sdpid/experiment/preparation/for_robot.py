"""Prepare a recording for a robot: match joints, check units, choose defaults."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from sdpid.experiment.processing.contacts.loops import with_loops
from sdpid.experiment.processing.floating.feet import carried
from sdpid.experiment.processing.process import process
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.floating.robots import require_its_base
from sdpid.experiment.recording.joints import match_joints
from sdpid.experiment.recording.loops.passive_joints import lacking
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.friction.terms import Coulomb, SigmoidFriction
from sdpid.robot.model.model import RobotModel

# Among friction terms: those that are used by default.
DEFAULT = "default"

# Half-width of the smooth sign of real friction, rad/s. Its columns pass the filter of the efforts,
# so it need not be as wide as the filter smears; wider friction is the sigmoid's business.
SMOOTH = 0.005


def default_friction(log: Recording) -> tuple[str | FrictionTerm, ...]:
    """Return the friction terms that are used by default.

    Records with periods are masked around reversals, where the exact sign is right. Others get
    a smooth sign, a sigmoid whose speeds are fitted joint by joint, and an offset for the
    sensors' zero errors. The same terms serve torque sensors and motor currents: on five
    real robots none predicted worse for the sigmoid, and the others choose it whichever is left
    out (docs/evidence/real_robots.md). Rotor inertia and couplings are effects, which `identify`
    adds where the training data show them (docs/guides/effects.md). Legs are driven through small
    gears whose rotors weigh as much as their links: recordings with a base get rotor inertia, and
    one smooth sign whose width is fitted.
    """
    if log.period is not None:
        return ("coulomb", "viscous")
    if log.base is not None:
        return (SigmoidFriction(), "viscous", "rotor_inertia")
    return (Coulomb(width=SMOOTH), SigmoidFriction(), "viscous", "offset")


def friction_of(
    log: Recording, given: Iterable[str | FrictionTerm] | None
) -> tuple[str | FrictionTerm, ...]:
    """Return the friction terms to use: given ones, `DEFAULT` among them standing for its terms."""
    terms: list[str | FrictionTerm] = []
    for each in (DEFAULT,) if given is None else given:
        terms += default_friction(log) if isinstance(each, str) and each == DEFAULT else [each]
    return tuple(terms)


def prepare(robot: RobotModel, log: Recording, processing: Processing | None = None) -> Samples:
    """Match a recording's joints with a robot's, check its units, and process it.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    log : Recording
        What was measured; its columns are found by name (see `match_joints`).
    processing : Processing, optional
        By default `default_processing`.

    Returns
    -------
    Samples

    Raises
    ------
    DataError
        When a joint of the robot is not in it, positions look like degrees, it cannot be
        processed, or only one of the two has a floating base.
    """
    require_its_base(robot, log)
    named = match_joints(robot, log)
    if processing is not None and processing.contact_force_std is not None and named.contacts:
        reach = round(processing.contact_margin_s / named.step)
        named = replace(named, contacts=carried(named.contacts, reach))
    limits = robot.position_limits[robot.n_base :]
    samples = process(named, processing, position_limits=limits, gravity=robot.gravity.tolist())
    if robot.n_base:
        samples = replace(samples, joint_names=robot.joint_names)
    if missing := lacking(robot, log):
        note = f"positions of {', '.join(missing)} are those that close the loops"
        samples = replace(samples, notes=(*samples.notes, note))
    return with_loops(robot, samples)
