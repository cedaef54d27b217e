"""What a prior says of the base parameters before any data: an information matrix."""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.prior.prior import Prior, prior_terms, repaired
from sdpid.excitation.criterion.marginal import marginal
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.base_parameters import BaseParameters
from sdpid.robot.model.geometry import neutral
from sdpid.robot.model.model import RobotModel

# Rms speed of a usual motion, as a share of the speed limit; without a limit, rad/s.
_SPEED_SHARE, _SPEED = 0.3, 0.5

# Samples of a sine at which friction terms are looked at.
_STATES = 64


def default_prior(robot: RobotModel, prior: Prior | bool | None) -> Prior | None:
    """Return the prior that `sdpid.identify` takes: by default one where links have masses."""
    if prior is None:
        prior = bool(np.any(robot.prior[:, 0] > 0.0))
    if isinstance(prior, Prior):
        return prior
    return Prior() if prior else None


def prior_information(
    robot: RobotModel,
    friction: FrictionModel,
    base: BaseParameters,
    prior: Prior | bool | None,
    effort_rms: Array,
) -> Array:
    """Return the information (b, b) of a prior about the base parameters.

    It is the inverse of ``B·S·B^T`` with S the covariance of theta that the prior believes, zero
    where it believes nothing.

    Parameters
    ----------
    robot, friction, base
        The robot, its friction terms and base parameters.
    prior : Prior or bool, optional
        By default that of `sdpid.identify`; False for none.
    effort_rms : ndarray, shape (n,)
        Rms efforts of a usual motion, N·m: friction is believed to be of their size.

    Raises
    ------
    DataError
        When no link has a body.
    """
    found = default_prior(robot, prior)
    if found is None:
        return np.zeros((base.count, base.count))
    limit = robot.velocity_limits
    speed = np.where(np.isfinite(limit), _SPEED_SHARE * limit, _SPEED)
    phase = (np.arange(_STATES) + 0.5) * 2.0 * np.pi / _STATES
    wave = np.sqrt(2.0) * np.sin(phase)[:, None]
    samples = Samples(
        position=np.tile(neutral(robot), (_STATES, 1)),
        velocity=speed * wave,
        acceleration=speed * np.roll(wave, _STATES // 4, axis=0),
        effort=np.asarray(effort_rms) * wave,
    )
    terms = prior_terms(found, RowSource(robot, friction, base, samples)).terms
    theta = np.zeros(len(base.theta_names))
    theta[: robot.prior.size] = _bodies(found, robot).ravel()
    R = np.vstack([term.curvature_rows(theta) for term in terms])
    return information_of_rows(R, base.matrix)


def information_of_rows(R: Array, B: Array) -> Array:
    """Return the information (b, b) about ``B·theta`` of rows R (k, p) of unit variance."""
    size = 1.0 / np.sqrt(np.maximum((R**2).sum(axis=0), np.finfo(float).tiny))
    size = np.where(np.any(R != 0.0, axis=0), size, 1.0)
    rows = np.linalg.norm(B * size, axis=1)
    scaled = B * size / rows[:, None]
    null = np.linalg.svd(scaled)[2][len(scaled) :]
    change = np.hstack([np.linalg.pinv(scaled), null.T])
    whole = (R * size) @ change
    own = marginal(whole.T @ whole, np.arange(len(change)) < len(B))
    return np.asarray(own / np.outer(rows, rows))


def _bodies(prior: Prior, robot: RobotModel) -> Array:
    """Return the bodies at which the prior's curvature is taken: those believed, made possible."""
    given = robot.prior if prior.bodies is None else prior.bodies
    return repaired(np.array(given))[0]
