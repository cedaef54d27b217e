"""Say before a run what it will buy."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, frozen, generator
from sdpid._common.threads import one_thread
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.effects.bending import Bending
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.information import information_rows
from sdpid.estimation.posterior import FitErrors, Posterior
from sdpid.estimation.prior.prior import Prior
from sdpid.excitation.criterion.belief import information_of_rows
from sdpid.excitation.criterion.earlier import EarlierInformation
from sdpid.excitation.criterion.noise import Given
from sdpid.excitation.expected.expected import NORMAL, Band, Duration, Expected
from sdpid.excitation.expected.open_directions import Asked, Bounds, open_directions
from sdpid.excitation.expected.rehearsal import Reading, Rehearsal, rehearse
from sdpid.excitation.expected.run_errors import RunErrors
from sdpid.experiment.plant.default_motion import default_motion
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.trajectory.curve import is_closed
from sdpid.experiment.trajectory.trajectory import Trajectory
from sdpid.robot.friction.term import FrictionTerm, SampledMotion
from sdpid.robot.model.model import RobotModel

# States (position, velocity, acceleration), (K, n) each.
States = tuple[Array, Array, Array]

# Probability of the intervals.
LEVEL = 0.95

# How often the motion is run, for the curve over the duration.
REPETITIONS = (1, 2, 3, 5, 10)

# Speeds of friction curves, rad/s, as far as a joint reaches them.
_SPEEDS = (0.1, 0.3, 1.0)

# States of a motion at which efforts are predicted, and the seed of the random one.
_STATES, _RANDOM = 300, 0

# Degrees of freedom beyond which Student's t is normal.
_ENDLESS = 1e9

# Errors that are drawn to see what limits take off, and how many deviations away limits take off
# nothing; what is added to their correlations, which come near one.
_DRAWN, _FAR, _RIDGE = 200, 4.0, 1e-9

# Directions whose information is below this, beside the largest, are open, and functions with more
# than this share in them.
_OPEN, _LOST = 1e-13, 1e-9

# What is always assumed.
_ALWAYS = (
    "the run is taken to follow the plan: a controller that lags or a joint that sticks buys less",
    "repeating averages what is noise; what the model lacks repeats itself, and stays",
)


@one_thread
def expect(
    robot: RobotModel,
    trajectory: Trajectory,
    *,
    friction: Iterable[str | FrictionTerm] | None = None,
    noise: Given = None,
    prior: Prior | bool | None = None,
    earlier: EarlierInformation | None = None,
    limits: Bounds | None = None,
    motions: Mapping[str, States] | None = None,
    reading: Reading = "record",
    repetitions: Iterable[int] = REPETITIONS,
) -> Expected:
    """Say before a run what it will buy: expected intervals, bands, what stays open, and why.

    The run goes through the processing, the weights and the prior that `sdpid.identify` would
    choose for its log (see `sdpid.excitation.expected.rehearsal`). It is taken to follow the
    trajectory.

    Parameters
    ----------
    robot : RobotModel
        The robot, on a fixed base.
    trajectory : Trajectory
        The motion, with rests and connections.
    friction : iterable, optional
        Friction terms; by default those that `sdpid.identify` would take.
    noise : ExpectedNoise, float, sequence or mapping, optional
        Of the efforts: numbers are standard deviations of white noise, N·m, at the trajectory's
        rate. By default that of the earlier runs, else what is usual on real robots.
    prior : Prior or bool, optional
        By default as `sdpid.identify`.
    earlier : EarlierInformation, optional
        What earlier runs tell of the same base parameters.
    limits : JointLimits, optional
        Named where they are why something stays open.
    motions : mapping of str to states, optional
        Motions on which efforts are to be predicted, by what they are called; beside the run and
        a random motion within the description's limits.
    reading : {"record", "periods"}, optional
        Whether the log is fitted as one record, or averaged over its periods.
    repetitions : iterable of int, optional
        How often the motion is run, for the curve over the duration.

    Returns
    -------
    Expected

    Raises
    ------
    DataError
        When the motion cannot be processed, or numbers do not fit.
    """
    given = earlier.noise if noise is None and earlier is not None else noise
    theta = None if earlier is None else earlier.theta
    rehearsed = partial(
        rehearse,
        robot,
        friction=friction,
        noise=given,
        prior=prior,
        theta=theta,
        reading=reading,
    )
    run = rehearsed(trajectory)
    own = RunErrors.of(run.spectrum)
    again = _again(own, trajectory, rehearsed, reading)
    believed = _believed(run)
    told = np.zeros_like(believed) if earlier is None else earlier.information
    before = Known(believed + told)
    states = trajectory.sample()
    random = default_motion(robot, _RANDOM, periods=1).sample()
    asked = {**(motions or {}), "the motion of the run": states, "random motion": random}
    rows = {name: _rows(run, each) for name, each in asked.items()}
    base, values = run.problem.base, run.theta
    errors = own.with_earlier(told)
    known = _posterior(run, errors)
    variance, share, _ = known.spread(base.matrix)
    theta_variance, theta_share, _ = known.spread(np.eye(run.problem.n_theta))
    freedom = run.spectrum.freedom(base.matrix @ known.from_fit @ run.spectrum.root)
    freedom /= np.maximum(1.0 - share, np.finfo(float).eps) ** 2
    speeds, functions, slopes = _friction_functions(run)
    shape = len(speeds), len(run.problem.friction.joint_names)
    moves = functions @ known.from_errors + slopes @ errors.whole_root[base.count :]
    friction_variance, _, _ = known.spread(functions, moves)
    covariance = known.covariance(base.matrix)
    value, half = base.matrix @ values, _quantile(freedom) * np.sqrt(variance)
    least, most = run.problem.feasible.limits_of(base.matrix)
    kept = partial(_kept_above, least - value)
    return Expected(
        names=base.names,
        units=base.units,
        values=frozen(value),
        standard_errors=frozen(np.sqrt(variance)),
        half_widths=frozen(half),
        lower=frozen(np.minimum(np.maximum(value - half, least), value)),
        upper=frozen(np.maximum(np.minimum(value + half, most), value)),
        before=frozen(np.sqrt(before.variance(np.eye(base.count)))),
        prior_share=frozen(share),
        theta_names=base.theta_names,
        theta_units=base.theta_units,
        theta=values,
        theta_half_widths=frozen(NORMAL * np.sqrt(theta_variance)),
        theta_prior_share=frozen(theta_share),
        joint_names=robot.joint_names,
        link_names=robot.link_names,
        speeds=speeds,
        friction=frozen((functions @ values).reshape(shape)),
        friction_half_widths=frozen(NORMAL * np.sqrt(friction_variance).reshape(shape)),
        bands=tuple(
            Band(
                motion=name,
                effort=frozen(np.sqrt(np.mean((W @ value) ** 2, axis=0))),
                half_width=frozen(_half_width(W, kept(covariance))),
                before=frozen(_half_width_before(W, before)),
            )
            for name, W in rows.items()
        ),
        durations=tuple(
            _duration(
                run,
                own.plus(again, times - trajectory.periods).with_earlier(told),
                kept,
                times,
                trajectory.duration + (times - trajectory.periods) * trajectory.period,
                rows,
            )
            for times in repetitions
        ),
        open_directions=open_directions(
            Asked(
                robot=robot,
                friction=run.problem.friction,
                base=base,
                motion=states,
                density=run.noise.density,
                information=own.base_information + told,
                believed=believed,
                limits=limits,
            )
        ),
        structure=base.eliminated,
        covariance=frozen(covariance),
        noise=run.noise,
        seconds=trajectory.duration,
        notes=_notes(run, earlier),
    )


@dataclass(frozen=True, eq=False)
class Known:
    """What an information (b, b) says of functions of the base parameters."""

    information: Array

    def variance(self, functionals: Array) -> Array:
        """Return the variances (k,) of functionals (k, b); infinite where they are open."""
        size = np.sqrt(np.maximum(np.diag(self.information), np.finfo(float).tiny))
        size = np.where(np.diag(self.information) > 0.0, size, 1.0)
        values, vectors = np.linalg.eigh(self.information / np.outer(size, size))
        parts = (functionals / size) @ vectors
        kept = values > _OPEN * max(float(values[-1]), np.finfo(float).tiny)
        found = np.sum(parts[:, kept] ** 2 / values[kept], axis=1)
        lost = np.sum(parts[:, ~kept] ** 2, axis=1) > _LOST * np.sum(parts**2, axis=1)
        return np.where(lost, np.inf, found)


def _again(
    own: RunErrors,
    trajectory: Trajectory,
    rehearsed: Callable[[Trajectory], Rehearsal],
    reading: Reading,
) -> RunErrors:
    """Return the sums over the rows that one more repetition of the motion adds."""
    leads = trajectory.lead_samples > 0 and is_closed(trajectory.series)
    if reading == "record" and leads:
        longer = rehearsed(trajectory.with_periods(trajectory.periods + 1))
        return RunErrors.of(longer.spectrum).beyond(own)
    return own.plus(own, 1.0 / trajectory.periods - 1.0)


def _posterior(run: Rehearsal, errors: RunErrors) -> Posterior:
    """Return the errors of the estimate that `identify` would make."""
    A = information_rows(errors.base_information)
    base = run.problem.base_of(run.theta)
    problem = replace(run.problem, A=frozen(A), rhs=frozen(A @ base), floor=0.0)
    about: dict[str, Any] = {"method": "expected", "status": "expected", "iterations": 0}
    about |= {"solve_time": 0.0}
    if problem.prior is None:
        estimate = Estimate(problem=problem, base=frozen(base), theta=None, **about)
    else:
        estimate = Estimate.of_theta(problem, run.theta, **about)
    return Posterior(estimate, FitErrors(errors.root, errors.scores, errors.freedom))


def _believed(run: Rehearsal) -> Array:
    """Return what the prior tells of the base parameters, (b, b)."""
    base, prior = run.problem.base, run.problem.prior
    if prior is None:
        return np.zeros((base.count, base.count))
    theta = np.array(run.theta)
    R = np.vstack([term.curvature_rows(theta) for term in prior.terms])
    return information_of_rows(R, base.matrix)


def _rows(run: Rehearsal, states: States) -> Array:
    """Return the regressor (K, n, b) at some states of a motion."""
    step = max(1, len(states[0]) // _STATES)
    q, v, a = (each[::step] for each in states)
    samples = Samples(position=q, velocity=v, acceleration=a, effort=np.zeros_like(v))
    rows = RowSource(run.problem.robot, run.problem.friction, run.problem.base, samples)
    return np.concatenate([W for _, W, _, _ in rows.chunks()])


def _kept_above(least: Array, covariance: Array) -> Array:
    """Return the covariance (b, b) of estimates whose errors are kept above limits (b,).

    Columns of friction that tell only their sum leave each part uncertain by many times the sum,
    but none can be negative. Drawn errors are moved to the nearest ones within the limits, and
    those of the other parameters with them, as a fit with limits does.
    """
    from scipy.optimize import nnls

    size = np.sqrt(np.diag(covariance))
    near = np.flatnonzero(np.isfinite(size) & (least > -_FAR * size))
    if not near.size:
        return covariance
    size, limit = size[near], least[near] / size[near]
    own = covariance[np.ix_(near, near)] / np.outer(size, size)
    # Where a short search shows next to nothing, rounding alone makes eigenvalues negative.
    ridge = _RIDGE - 2.0 * min(0.0, np.linalg.eigvalsh(own)[0])
    root = np.linalg.cholesky(own + ridge * np.eye(len(near)))
    whiten = np.linalg.inv(root)
    drawn = generator(_RANDOM).standard_normal((_DRAWN, len(near)))
    moved = np.array([nnls(whiten, each - whiten @ limit)[0] for each in drawn]) + limit
    gain = (covariance[:, near] / size) @ whiten.T @ whiten
    return np.asarray(covariance + gain @ (moved.T @ moved / _DRAWN - own) @ gain.T)


def _half_width(W: Array, covariance: Array) -> Array:
    """Return the rms half width (n,) of the band of predicted efforts."""
    variance = np.einsum("kjb,bc,kjc->j", W, covariance, W, optimize=True) / len(W)
    return np.asarray(NORMAL * np.sqrt(np.maximum(variance, 0.0)))


def _half_width_before(W: Array, before: Known) -> Array:
    """Return the same before the run; infinite where it is open."""
    variance = before.variance(W.reshape(-1, W.shape[2])).reshape(W.shape[:2])
    return np.asarray(NORMAL * np.sqrt(variance.mean(axis=0)))


def _duration(
    run: Rehearsal,
    errors: RunErrors,
    kept: Callable[[Array], Array],
    times: int,
    seconds: float,
    rows: Mapping[str, Array],
) -> Duration:
    """Return what is known after `times` repetitions."""
    known = _posterior(run, errors)
    base, links = run.problem.base, run.problem.robot.n_links
    covariance, values = kept(known.covariance(base.matrix)), base.matrix @ run.theta
    masses = np.eye(run.problem.n_theta)[: 10 * links : 10]
    shares = []
    for W in rows.values():
        effort = float(np.linalg.norm(W @ values)) / np.sqrt(len(W))
        half = float(np.linalg.norm(_half_width(W, covariance)))
        shares.append(half / max(effort, np.finfo(float).tiny))
    return Duration(
        repetitions=times,
        seconds=seconds,
        standard_errors=frozen(np.sqrt(known.spread(base.matrix)[0])),
        masses=frozen(np.sqrt(known.spread(masses)[0])),
        bands=tuple(shares),
    )


def _friction_functions(run: Rehearsal) -> tuple[Array, Array, Array]:
    """Return speeds, and friction there by joint: as functions of theta, and by open speeds.

    Returns
    -------
    ndarray, shape (s,)
    ndarray, shape (s·joints, p)
    ndarray, shape (s·joints, d)
        Derivatives by the logarithms of the speeds that the data choose.
    """
    problem, friction = run.problem, run.problem.friction
    tail = len(friction.parameters)
    bending = Bending.of(friction, problem.origin.profiled, run.sizes[problem.n_theta - tail :])
    top = np.abs(problem.samples.velocity).max()
    speeds = [speed for speed in _SPEEDS if speed <= top or speed == _SPEEDS[0]] if tail else []
    functions, slopes = [], []
    for speed in speeds:
        v = np.array([[speed], [-speed]]) * np.ones(problem.robot.n)
        columns = friction.columns(v, np.zeros_like(v))[:, friction.first :]
        own = v[:, friction.first :]
        motion = SampledMotion(
            position=own, velocity=own, acceleration=np.zeros_like(own), robot=problem.robot
        )
        bends = bending.columns(motion)[:, friction.first :]
        columns, bends = (0.5 * (each[0] - each[1]) for each in (columns, bends))
        functions.append(np.pad(columns, ((0, 0), (problem.n_theta - tail, 0))))
        slopes.append(bends)
    if not speeds:
        return frozen([]), np.zeros((0, problem.n_theta)), np.zeros((0, len(bending.deviations)))
    return frozen(speeds), np.concatenate(functions), np.concatenate(slopes)


def _quantile(freedom: Array) -> Array:
    from scipy.special import stdtrit

    return np.asarray(stdtrit(np.minimum(freedom, _ENDLESS), 0.5 * (1.0 + LEVEL)))


def _notes(run: Rehearsal, earlier: EarlierInformation | None) -> tuple[str, ...]:
    """Return what all of it rests on, in words."""
    notes = [*run.notes, *run.noise.notes, *(() if earlier is None else earlier.notes)]
    notes += [*(() if run.problem.prior is None else run.problem.prior.notes), *_ALWAYS]
    return tuple(notes)
