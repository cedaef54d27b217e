"""The efforts that a robot with known parameters predicts, and a description's parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid.estimation.compression.rows import motion_of
from sdpid.experiment.preparation.prepare import SMOOTH
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.position import AtJoints
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.friction.terms import Coulomb, Offset, RotorInertia, Viscous
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.robot.model.model import RobotModel

# Samples a piece: the regressor of a piece stays below some 100 MB for an arm.
_CHUNK = 20_000


class Resistances(NamedTuple):
    """What a description has at m joints and tendons.

    Attributes
    ----------
    ways : ndarray, shape (m, joints)
        How their positions follow the robot's coordinates, but those of a floating base.
    dry, damping, armature : ndarray, shape (m,)
        Dry friction, damping and rotor inertia.
    """

    ways: Array
    dry: Array
    damping: Array
    armature: Array

    @classmethod
    def of_joints(cls, robot: RobotModel) -> Resistances:
        """Return those of the joints of a robot's own description."""
        tree, first = robot.pin_model, robot.n_base
        found = (np.array(x)[first:] for x in (tree.friction, tree.damping, tree.armature))
        return cls(robot.expansion[first:, first:], *found)

    def beside(self, others: Iterable[tuple[Any, ...]]) -> Resistances:
        """Return these, then others given as way, dry friction, damping and armature each."""
        return Resistances(*map(np.array, zip(*zip(*self, strict=True), *others, strict=True)))


def described_coulomb(samples: Samples) -> Coulomb:
    """Return the Coulomb friction that a description means, as samples show it.

    The exact sign where periods are averaged; else a smooth one, as velocities are noisy.
    """
    return Coulomb(width=SMOOTH if samples.periods is None else 0.0)


def described_dynamics(
    robot: RobotModel,
    samples: Samples,
    *,
    bodies: Array | None = None,
    held: Resistances | None = None,
    offsets: Array | None = None,
    springs: Sequence[FrictionTerm] | None = None,
) -> RobotDynamics:
    """Return the dynamics that a description holds: links, dry friction, damping, armature.

    Parameters
    ----------
    robot : RobotModel
        On a fixed base or a floating one.
    samples : Samples
        What is to be predicted, which decides how sharp the sign of dry friction is.
    bodies : ndarray, shape (links, 10), optional
        By default those of the robot's own description.
    held : Resistances, optional
        By default those of the description.
    offsets : ndarray, shape (joints,), optional
        Constant efforts of the coordinates.
    springs : sequence of Spring, optional
        Springs of known stiffness and rest; by default the description's.

    Returns
    -------
    RobotDynamics
    """
    held = Resistances.of_joints(robot) if held is None else held
    links = np.asarray(robot.prior if bodies is None else bodies).ravel()
    terms: tuple[FrictionTerm, ...] = (described_coulomb(samples), Viscous(), RotorInertia())
    if not np.array_equal(held.ways, np.eye(robot.n - robot.n_base)):
        places = tuple(map(tuple, held.ways.tolist()))
        terms = tuple(AtJoints(term, places) for term in terms)
    values = [held.dry, held.damping, held.armature]
    if offsets is not None:
        terms, values = (*terms, Offset()), [*values, offsets]
    terms += robot.springs if springs is None else tuple(springs)
    model = FrictionModel.from_terms(terms, robot.joint_names, first=robot.n_base)
    known = [each.value for each in model.parameters if each.value is not None]
    theta = np.concatenate([links, *values, known])
    return RobotDynamics(robot=robot, terms=model, theta=frozen(theta))


def described_friction(robot: RobotModel, samples: Samples) -> Array:
    """Return the efforts (K, n) of the friction and armature in a robot's description."""
    return predicted_efforts(described_dynamics(robot, samples), samples, links=False)


def predicted_efforts(model: RobotDynamics, samples: Samples, *, links: bool = True) -> Array:
    """Return the efforts (K, n) of samples, friction as it stands in filtered efforts."""
    robot, terms, found = model.robot, model.terms, np.zeros(samples.effort.shape)
    if links:
        found = rigid_efforts(robot, model.theta, samples)
    values = model.theta[10 * robot.n_links :]
    found[:, terms.first :] += efforts_of_terms(robot, terms, values, samples, first=terms.first)
    return found


def rigid_efforts(robot: RobotModel, bodies: Array, samples: Samples) -> Array:
    """Return the efforts (K, n) of links (the first of `bodies`), without friction."""
    states = samples.position, samples.velocity, samples.acceleration
    return _in_parts(
        samples, lambda part: robot.inverse_dynamics(bodies, *(each[part] for each in states))
    )


def efforts_of_terms(
    robot: RobotModel, terms: FrictionModel, values: Array, samples: Samples, *, first: int
) -> Array:
    """Return the efforts (K, joints) of friction terms, as they stand in filtered efforts."""

    def efforts(part: slice) -> Array:
        columns = terms.columns_in(motion_of(robot, samples, part, first=first))
        return np.asarray(columns[:, terms.first :] @ values)

    return _in_parts(samples, efforts)


def _in_parts(samples: Samples, efforts: Callable[[slice], Array]) -> Array:
    """Return efforts (K, ...) that are computed of a piece of the samples at a time."""
    starts = range(0, samples.n_samples, _CHUNK)
    return np.concatenate([efforts(slice(k, min(k + _CHUNK, samples.n_samples))) for k in starts])
