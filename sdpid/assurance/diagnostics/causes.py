"""Name what a joint's error goes with: an effect that the model lacks leaves its own shape."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.assurance.diagnostics.residuals import JointErrors, density
from sdpid.assurance.diagnostics.rest import moving_rows
from sdpid.assurance.diagnostics.validation import Validation
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.model.model import RobotModel

Kind = Literal[
    "sign",
    "scale",
    "direction",
    "velocity",
    "speed",
    "acceleration",
    "load",
    "gravity",
    "position",
    "frequency",
]

# Share of the errors' variance that goes with a shape: a tenth of it is 5 % of the RMSE, less
# than the choice of a filter makes.
SHARE = 0.1

# A share must also exceed what chance gives by this many of its standard deviations.
_BEYOND_CHANCE = 3.0

# Of the share that goes with velocity a line or a sign explains this much, or else the shape is
# another one.
_SHAPE = 0.5

# Shares of the error that go with the prediction, from which on a channel has another sign or
# scale: no missing effect turns the sign of all that is predicted, but missing friction goes with
# the prediction too where there is hardly anything else, up to 0.8 of it on simulated arms.
_OPPOSITE, _PROPORTIONAL = 0.5, 0.9

# A joint whose error is this many times that of least squares is held back by constraints or the
# prior, and the shape of its error is that of what holds it, not of a missing effect.
HELD_BACK = 1.5

# A peak of the error's spectrum has at least this share of the error's power, and lies this many
# times above the frequencies that hold this share of the acceleration's power: friction answers a
# motion with its third and fifth harmonics, which are no vibration.
_PEAK, _MOTION, _HARMONICS = 0.25, 0.95, 6

# A peak is as wide as the window of the spectrum smears a line, in frequencies to either side.
_SMEARED = 2


@dataclass(frozen=True, kw_only=True)
class Cause:
    """What most of a joint's explainable error goes with.

    Attributes
    ----------
    joint : str
        The joint.
    kind : str
        ``"sign"`` and ``"scale"`` are of the measured effort. ``"direction"``,
        ``"velocity"`` and ``"speed"`` are the sign, the velocity and a curve of
        it; ``"load"`` is the effort of the links times the sign; ``"gravity"`` is a tilt;
        ``"position"`` goes once around with the joint; ``"frequency"`` is a line of the spectrum.
    share : float
        Share of the errors' variance, less what chance gives.
    frequency : float or None
        Of a line, Hz.
    """

    joint: str
    kind: Kind
    share: float
    frequency: float | None = None


def find_causes(
    robot: RobotModel,
    bodies: Array,
    samples: Samples,
    fit: Validation,
    errors: tuple[JointErrors, ...],
    free: Validation | None = None,
) -> dict[str, Cause]:
    """Return for every joint what its error goes with most; joints whose error shows nothing miss.

    Where the mean effort predicts better, or least squares much better (`HELD_BACK`), the shape of
    the error says nothing of a missing effect; a wrong sign or scale of the effort is named only.
    Shapes that a motion makes alike cannot be told apart: on a single sine position and
    acceleration are one.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    bodies : ndarray, shape (links, 10) flattened or not
        Inertial parameters of the links.
    samples : Samples
        What was predicted.
    fit : Validation
        The prediction.
    errors : tuple of JointErrors
        Statistics of its errors.
    free : Validation, optional
        The prediction by least squares, without constraints.
    """
    held = held_back(fit, free)
    states = samples.position, samples.velocity, samples.acceleration
    load = np.abs(robot.inverse_dynamics(bodies, *states))
    turned = _turned_gravity(robot, bodies, samples)
    moving = moving_rows(samples, robot.slides) & samples.used
    shift = samples.position.shape[1] - robot.n
    found = {}
    for each in errors:
        j = fit.joint_names.index(each.joint)
        kept = moving[:, j]
        # Without a motor there is no measured effort to explain.
        if np.count_nonzero(kept) < 2 or each.joint in robot.passive:
            continue
        v, a = samples.velocity[kept, j], samples.acceleration[kept, j]
        q = samples.position[kept, j + shift]
        e = (samples.effort - fit.effort_predicted)[kept, j]
        candidates: list[tuple[float, Kind, float | None]]
        candidates = list(_of_channel(e, fit.effort_predicted[kept, j], each.independent))
        if fit.moving.r2[j] > 0.0 and each.joint not in held:
            sign = np.sign(v)[:, None]
            shapes: dict[Kind, Array] = {
                "acceleration": a[:, None],
                "gravity": turned[kept, j],
                "position": np.column_stack([np.sin(q), np.cos(q)]),
            }
            loaded = load[kept, j, None] * sign
            # A load that hardly varies makes the shape of the sign, which is the simpler cause.
            if _explained(e, loaded, each.independent, beside=sign) > 0.0:
                shapes["load"] = loaded
            candidates += [
                (_explained(e, columns, each.independent), kind, None)
                for kind, columns in shapes.items()
            ]
            candidates += _of_velocity(each)
            candidates += _of_frequency(each, density(samples.acceleration[:, j], samples))
        if not candidates:
            continue
        share, kind, frequency = max(candidates, key=lambda candidate: candidate[0])
        if share >= SHARE:
            found[each.joint] = Cause(joint=each.joint, kind=kind, share=share, frequency=frequency)
    return found


def held_back(fit: Validation, free: Validation | None) -> tuple[str, ...]:
    """Return the joints that least squares predicts much better in motion (`HELD_BACK`).

    Parameters
    ----------
    fit : Validation
        The prediction of the constrained estimate.
    free : Validation or None
        That of least squares, on the same rows.
    """
    if free is None:
        return ()
    own, other = fit.moving, free.moving
    return tuple(
        name
        for j, name in enumerate(fit.joint_names)
        if own.rows[j] and own.rmse[j] > HELD_BACK * other.rmse[j]
    )


def _of_channel(
    e: Array, predicted: Array, independent: float
) -> Iterator[tuple[float, Kind, None]]:
    """Yield whether the measured effort is a multiple of the predicted one, and of which sign."""
    share = _explained(e, predicted[:, None], independent)
    if share < _OPPOSITE:
        return
    # Measured are 1 + slope times the predicted efforts.
    slope = float(np.cov(e, predicted)[0, 1] / np.var(predicted, ddof=1))
    if slope < -1.0:
        yield share, "sign", None
    elif share >= _PROPORTIONAL:
        yield share, "scale", None


def _explained(
    e: Array, columns: Array, independent: float, *, beside: Array | None = None
) -> float:
    """Return the share of errors (K,) that columns explain beside a constant, and other columns.

    Less what chance gives, and 0 where chance could give it.
    """
    given = np.ones((len(e), 1)) if beside is None else np.column_stack([np.ones(len(e)), beside])
    residual = np.column_stack([e, columns])
    residual = residual - given @ np.linalg.lstsq(given, residual, rcond=None)[0]
    error, shape = residual[:, 0], residual[:, 1:]
    size = np.linalg.norm(shape, axis=0)
    before = np.linalg.norm(columns, axis=0)
    # A shape that the others have already is none of its own.
    shape = shape[:, size > 1e-6 * np.maximum(before, np.finfo(float).tiny)]
    total = float(np.sum((e - e.mean()) ** 2))
    if total <= 0.0 or not shape.shape[1]:
        return 0.0
    left = error - shape @ np.linalg.lstsq(shape, error, rcond=None)[0]
    share = float(error @ error - left @ left) / total
    count = shape.shape[1]
    chance = count / independent
    if share < chance + _BEYOND_CHANCE * np.sqrt(2.0 * count) / independent:
        return 0.0
    return float(share - chance)


def _of_velocity(errors: JointErrors) -> Iterator[tuple[float, Kind, None]]:
    """Yield the shape of the dependence on velocity."""
    if max(errors.with_sign, errors.with_velocity) < _SHAPE * errors.share:
        yield errors.share, "speed", None
    elif errors.with_sign >= errors.with_velocity:
        yield errors.share, "direction", None
    else:
        yield errors.share, "velocity", None


def _of_frequency(errors: JointErrors, motion: Array) -> Iterator[tuple[float, Kind, float]]:
    """Yield the highest peak of the error's spectrum above the motion's frequencies."""
    power = errors.error_density**2
    if not power.sum() > 0.0 or len(motion) != len(power):
        return
    highest = int(np.searchsorted(np.cumsum(motion), _MOTION * motion.sum()))
    first = _HARMONICS * highest + _SMEARED + 1
    if first >= len(power):
        return
    peak = first + int(np.argmax(power[first:]))
    band: Mask = np.abs(np.arange(len(power)) - peak) <= _SMEARED
    share = float(power[band].sum() / power.sum())
    if share >= _PEAK:
        yield share, "frequency", float(errors.frequency[peak])


def _turned_gravity(robot: RobotModel, bodies: Array, samples: Samples) -> Array:
    """Return how efforts (K, n, 2) change as gravity turns about two axes across it, per rad."""
    gravity = robot.gravity
    size = float(np.linalg.norm(gravity))
    if not size > 0.0:
        return np.zeros((*samples.effort.shape, 2))
    axes = np.linalg.svd(gravity[None] / size)[2][1:]
    still = np.zeros_like(samples.velocity)
    columns = []
    for axis in axes:
        turned = robot.with_gravity(np.cross(axis, gravity))
        columns.append(turned.inverse_dynamics(bodies, samples.position, still, still))
    return np.stack(columns, axis=2)
