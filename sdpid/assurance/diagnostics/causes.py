"""Statistics of prediction errors, and what a joint's error goes with.

Errors of a model that lacks nothing are noise: a flat spectrum below the filter's cut-off, an
autocorrelation that falls at once, and a mean of zero at every velocity. Where they are not, their
shape says what is missing: an effect that the model lacks leaves its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from sdpid._common.arrays import Array, Mask, frozen
from sdpid.assurance.diagnostics.rest import moving_rows
from sdpid.assurance.diagnostics.validation import Validation
from sdpid.estimation.compression.covariance import LaggedSums, integrated_time
from sdpid.experiment.processing.motion import power_density
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

# Velocities are sorted into this many bins of equally many rows: enough for the two sides of a
# friction curve with a bend in each, few enough for a steady mean in every one.
BINS = 16

# Samples a piece of the spectrum (Welch's): a few hundred frequencies are what a plot shows.
_PIECE = 1024

# Lags of the autocorrelation that are kept: a tenth of the record, at most this many seconds.
_LAG_SHARE, _LAG_SECONDS = 0.1, 2.0


# A share of the error, what it goes with, and the frequency of a line.
Candidate = tuple[float, Kind, float | None]


@dataclass(frozen=True, kw_only=True, eq=False)
class JointErrors:
    """The errors of one joint.

    Attributes
    ----------
    joint : str
        The joint.
    frequency : ndarray, shape (f,)
        In Hz; per sample where the samples have no time.
    effort_density, error_density : ndarray, shape (f,)
        Amplitude densities of measured effort and of its error, N·m/√Hz.
    lag : ndarray, shape (l,)
        In s; in samples where they have no time.
    autocorrelation : ndarray, shape (l,)
        Of the errors; 1 at lag 0.
    independent : float
        About how many independent ones the rows are worth.
    velocity, mean, low, high : ndarray, shape (bins,)
        Mean velocity of each bin (rad/s), mean of its errors, and the tenth and the ninetieth of
        a hundred of them, N·m. Empty where the joint does not move.
    share : float
        Share of the errors' variance that goes with the velocity's bin, less what chance gives.
    with_sign, with_velocity : float
        Squared correlations of the errors with the velocity's sign and with the velocity.
    """

    joint: str
    frequency: Array
    effort_density: Array
    error_density: Array
    lag: Array
    autocorrelation: Array
    independent: float
    velocity: Array
    mean: Array
    low: Array
    high: Array
    share: float
    with_sign: float
    with_velocity: float


def joint_errors(samples: Samples, fit: Validation) -> tuple[JointErrors, ...]:
    """Return the error statistics of every joint.

    Parameters
    ----------
    samples : Samples
        The measurements that were predicted.
    fit : Validation
        Their prediction.

    Returns
    -------
    tuple of JointErrors
        One for every joint with rows that are not masked.
    """
    return tuple(
        _of_joint(name, samples, j, fit.effort_predicted[:, j])
        for j, name in enumerate(fit.joint_names)
        if np.count_nonzero(samples.used[:, j]) >= 2 and j >= fit.n_base
    )


def period(samples: Samples) -> float:
    """Return the seconds between samples, by their median; 1 where they have no time."""
    if samples.time is None or len(samples.time) < 2:
        return 1.0
    step = float(np.median(np.diff(samples.time)))
    return step if step > 0.0 else 1.0


def _of_joint(name: str, samples: Samples, j: int, predicted: Array) -> JointErrors:
    effort, kept, step = samples.effort[:, j], samples.used[:, j], period(samples)
    # Rows that are not used are zero; the others carry all of the power.
    signals = [np.where(kept, x - x[kept].mean(), 0.0) for x in (effort, effort - predicted)]
    densities = [_density(x, samples)[1] * len(kept) / kept.sum() for x in signals]
    lags = int(max(min(_LAG_SHARE * len(kept), _LAG_SECONDS / step), 1)) + 1
    paired = LaggedSums.of(signals[1][:, None], kept[:, None], samples.parts).correlation[0]
    independent = max(float(kept.sum()) / integrated_time(paired), 1.0)
    v, e = samples.velocity[kept, j], signals[1][kept]
    binned, share = _over_velocity(v, (effort - predicted)[kept], independent)
    velocity, mean, low, high = map(frozen, binned)
    return JointErrors(
        joint=name,
        frequency=frozen(_density(signals[1], samples)[0]),
        effort_density=frozen(np.sqrt(densities[0])),
        error_density=frozen(np.sqrt(densities[1])),
        lag=frozen(np.arange(len(paired[:lags])) * step),
        autocorrelation=frozen(paired[:lags]),
        independent=independent,
        velocity=velocity,
        mean=mean,
        low=low,
        high=high,
        share=share,
        with_sign=_squared_correlation(np.sign(v), e),
        with_velocity=_squared_correlation(v, e),
    )


def _density(signal: Array, samples: Samples) -> tuple[Array, Array]:
    """Return frequencies and the power density of a signal (K,): no piece lies across a break."""
    lengths = [part.stop - part.start for part in samples.parts]
    rate, size = 1.0 / period(samples), min(_PIECE, *lengths)
    found = [power_density(signal[part], rate, size) for part in samples.parts]
    shares = np.array(lengths) / len(signal)
    return found[0][0], np.asarray(shares @ [power for _, power in found])


def _over_velocity(v: Array, e: Array, independent: float) -> tuple[Array, float]:
    """Return velocity, mean, low and high (4, bins), and the share that goes with them."""
    edges = np.unique(np.quantile(v, np.linspace(0.0, 1.0, BINS + 1)))
    if len(edges) < 3:
        return np.zeros((4, 0)), 0.0
    index = np.clip(np.searchsorted(edges, v, side="right") - 1, 0, len(edges) - 2)
    rows, between = [], 0.0
    for k in np.unique(index):
        part = e[index == k]
        rows.append((v[index == k].mean(), part.mean(), *np.quantile(part, (0.1, 0.9))))
        between += len(part) * (rows[-1][1] - e.mean()) ** 2
    total = float(np.sum((e - e.mean()) ** 2))
    if total <= 0.0:
        return np.asarray(rows).T, 0.0
    chance = (len(rows) - 1) / max(independent - 1.0, 1.0)
    return np.asarray(rows).T, float(np.clip(between / total - chance, 0.0, 1.0))


def _squared_correlation(x: Array, e: Array) -> float:
    x, e = x - x.mean(), e - e.mean()
    size = float((x @ x) * (e @ e))
    return float(x @ e) ** 2 / size if size > 0.0 else 0.0


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
    turned, error = _turned_gravity(robot, bodies, samples), samples.effort - fit.effort_predicted
    moving = moving_rows(samples, robot.slides) & samples.used
    shift = samples.position.shape[1] - robot.n
    found = {}
    for each in errors:
        j = fit.joint_names.index(each.joint)
        kept = moving[:, j]
        # Without a motor there is no measured effort to explain.
        if np.count_nonzero(kept) < 2 or each.joint in robot.passive:
            continue
        explained = partial(_explained, error[kept, j], independent=each.independent)
        candidates = _of_channel(explained, error[kept, j], fit.effort_predicted[kept, j])
        if fit.moving.r2[j] > 0.0 and each.joint not in held:
            q, sign = samples.position[kept, j + shift], np.sign(samples.velocity[kept, j])
            shapes: dict[Kind, Array] = {
                "acceleration": samples.acceleration[kept, j],
                "gravity": turned[kept, j],
                "position": np.column_stack([np.sin(q), np.cos(q)]),
            }
            loaded = load[kept, j] * sign
            # A load that hardly varies makes the shape of the sign, which is the simpler cause.
            if explained(loaded, beside=sign) > 0.0:
                shapes["load"] = loaded
            candidates += [(explained(shape), kind, None) for kind, shape in shapes.items()]
            candidates += _of_velocity(each)
            candidates += _of_frequency(each, _density(samples.acceleration[:, j], samples)[1])
        share, kind, line = max(candidates, key=lambda each: each[0], default=(0.0, "sign", None))
        if share >= SHARE:
            found[each.joint] = Cause(joint=each.joint, kind=kind, share=share, frequency=line)
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


def _of_channel(explained: Callable[..., float], e: Array, predicted: Array) -> list[Candidate]:
    """Return whether the measured effort is a multiple of the predicted one, and of which sign."""
    share = explained(predicted)
    if share < _OPPOSITE:
        return []
    # Measured are 1 + slope times the predicted efforts.
    slope = float(np.cov(e, predicted)[0, 1] / np.var(predicted, ddof=1))
    if slope < -1.0:
        return [(share, "sign", None)]
    return [(share, "scale", None)] if share >= _PROPORTIONAL else []


def _explained(e: Array, shape: Array, *, independent: float, beside: Array | None = None) -> float:
    """Return the share of errors (K,) that a shape (K, ...) explains beside a constant, and others.

    Less what chance gives, and 0 where chance could give it.
    """
    ones = np.ones(len(e))
    given = np.column_stack([ones] if beside is None else [ones, beside])
    columns = np.column_stack([e, shape])
    residual = columns - given @ np.linalg.lstsq(given, columns, rcond=None)[0]
    size, before = (np.linalg.norm(each, axis=0) for each in (residual, columns))
    # A shape that the others have already is none of its own.
    own = size > 1e-6 * np.maximum(before, np.finfo(float).tiny)
    error, own_shape = residual[:, 0], residual[:, 1:][:, own[1:]]
    total, count = float(np.sum((e - e.mean()) ** 2)), own_shape.shape[1]
    if total <= 0.0 or not count:
        return 0.0
    left = error - own_shape @ np.linalg.lstsq(own_shape, error, rcond=None)[0]
    share, chance = float(error @ error - left @ left) / total, count / independent
    if share < chance + _BEYOND_CHANCE * np.sqrt(2.0 * count) / independent:
        return 0.0
    return float(share - chance)


def _of_velocity(errors: JointErrors) -> list[Candidate]:
    """Return the shape of the dependence on velocity."""
    if max(errors.with_sign, errors.with_velocity) < _SHAPE * errors.share:
        return [(errors.share, "speed", None)]
    stronger = errors.with_sign >= errors.with_velocity
    return [(errors.share, "direction" if stronger else "velocity", None)]


def _of_frequency(errors: JointErrors, motion: Array) -> list[Candidate]:
    """Return the highest peak of the error's spectrum above the motion's frequencies."""
    power = errors.error_density**2
    highest = int(np.searchsorted(np.cumsum(motion), _MOTION * motion.sum()))
    first = _HARMONICS * highest + _SMEARED + 1
    if not power.sum() > 0.0 or first >= len(power):
        return []
    peak = first + int(np.argmax(power[first:]))
    band: Mask = np.abs(np.arange(len(power)) - peak) <= _SMEARED
    share = float(power[band].sum() / power.sum())
    return [(share, "frequency", float(errors.frequency[peak]))] if share >= _PEAK else []


def _turned_gravity(robot: RobotModel, bodies: Array, samples: Samples) -> Array:
    """Return how efforts (K, n, 2) change as gravity turns about two axes across it, per rad."""
    still = np.zeros_like(samples.velocity)
    turned = [
        robot.with_gravity(np.cross(axis, robot.gravity))
        for axis in np.linalg.svd(robot.gravity[None])[2][1:]
    ]
    efforts = [each.inverse_dynamics(bodies, samples.position, still, still) for each in turned]
    return np.stack(efforts, axis=2)
