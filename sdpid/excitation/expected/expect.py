"""Say before a run how well it will show parameters, from rows as `sdpid.identify` makes them.

The motion is written down as a log at the trajectory's rate, with the efforts that a nominal robot
has, and goes through the processing that `sdpid.identify` would choose: the same filter, the same
rows masked near reversals, friction columns filtered alike. Its weights are made as those of
`identify` are, with the expected noise in place of the residuals. Then the errors of the fit are
those of `sdpid.estimation.noise_spectrum`, with the spectrum that the noise is believed to have.
Nothing is random, and no number is fitted to outcomes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np

from sdpid._common.arrays import Array, frozen, generator
from sdpid._common.threads import one_thread
from sdpid.estimation.compression.covariance import JointRows
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.effects.bending import Bending
from sdpid.estimation.effects.choose import closed_in_the_middle
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.information import information_root, information_rows
from sdpid.estimation.noise_spectrum import NoiseSpectrum
from sdpid.estimation.posterior import FitErrors, Posterior
from sdpid.estimation.prior.prior import Prior
from sdpid.estimation.problem import Problem, build_problem
from sdpid.excitation.criterion.belief import (
    EarlierInformation,
    ExpectedNoise,
    Given,
    default_prior,
    information_of_rows,
    nominal_theta,
)
from sdpid.excitation.criterion.rows import BaseRows
from sdpid.excitation.expected.expected import NORMAL, Band, Duration, Expected
from sdpid.excitation.expected.open_directions import States, open_directions
from sdpid.excitation.limits.joint_limits import JointLimits
from sdpid.experiment.preparation.prepare import friction_of
from sdpid.experiment.processing.choose import default_processing
from sdpid.experiment.processing.process import process
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.plausible import turning_limits
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.trajectory.curve import is_closed
from sdpid.experiment.trajectory.drawn import default_motion
from sdpid.experiment.trajectory.trajectory import Trajectory
from sdpid.robot.consistent import raise_eigenvalues
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.term import FrictionTerm, SampledMotion
from sdpid.robot.model.base_parameters import structural_base
from sdpid.robot.model.model import RobotModel

# How the log will be read: as one record, or as periods that are averaged first.
Reading = Literal["record", "periods"]

# Frequencies at which the filter's gain is summed up.
_FREQUENCIES = 4096


@dataclass(frozen=True, kw_only=True, eq=False)
class Rehearsal:
    """A run before it is made.

    Attributes
    ----------
    problem : Problem
        That `sdpid.identify` would solve, with nominal efforts.
    theta : ndarray, shape (p,)
        The nominal parameters.
    sizes : ndarray, shape (p,)
        The same, friction terms with speeds that the data choose as large as they will be found:
        errors of those speeds matter as much.
    spectrum : NoiseSpectrum
        Errors of its unconstrained fit.
    noise : ExpectedNoise
        What was expected of the efforts.
    processing : Processing
        How the log would be processed.
    log : Recording
        The log, without noise.
    notes : tuple of str
        What was assumed.
    """

    problem: Problem
    theta: Array
    sizes: Array
    spectrum: NoiseSpectrum
    noise: ExpectedNoise
    processing: Processing
    log: Recording
    notes: tuple[str, ...]

    @property
    def rows(self) -> BaseRows:
        """The regressor."""
        known = self.problem
        return BaseRows(robot=known.robot, friction=known.friction, base=known.base)


@one_thread
def rehearse(
    robot: RobotModel,
    trajectory: Trajectory,
    *,
    friction: Iterable[str | FrictionTerm] | None = None,
    noise: Given = None,
    prior: Prior | bool | None = None,
    theta: Array | None = None,
    reading: Reading = "record",
) -> Rehearsal:
    """Return a run before it is made.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    trajectory : Trajectory
        The motion: all of it is recorded, rests and connections too.
    friction : iterable, optional
        By default the terms that `sdpid.identify` would take.
    noise : ExpectedNoise, float, sequence or mapping, optional
        Of the efforts (see `ExpectedNoise.of`).
    prior : Prior or bool, optional
        By default as `sdpid.identify`: one for a record where the description has masses.
    theta : ndarray, shape (p,), optional
        The nominal parameters; by default `nominal_theta`.
    reading : {"record", "periods"}, optional
        Whether the log is fitted as it is, or averaged over its periods.
    """
    log = _log(robot, trajectory, reading)
    terms = friction_of(log, friction)
    model = FrictionModel.from_terms(terms, robot.joint_names, first=robot.n_base)
    q, v, a = trajectory.sample()
    model, profiled = closed_in_the_middle(model, np.abs(v))
    values, notes = nominal_theta(robot, model, q, v, a) if theta is None else (theta, ())
    effort = _efforts(robot, model, values, q, v, a)
    log = replace(log, effort=effort)
    usual = ExpectedNoise.of(
        robot.joint_names, noise, np.sqrt(np.mean(effort**2, axis=0)), trajectory.rate_hz
    )
    processing = replace(default_processing(log), covariance=None)
    samples = process(log, processing, position_limits=turning_limits(robot), progress=False)
    rows = RowSource(robot, model, structural_base(robot, model), samples)
    gain, bandwidth = _gain(processing, trajectory.rate_hz)
    assert samples.time is not None
    kept = 1.0 / float(np.median(np.diff(samples.time)))
    variance = usual.filtered_variance(bandwidth)
    density = usual.density * kept
    sigma = variance
    if reading == "record":
        sigma = _weights(rows, variance) * max(1.0, float(np.mean(density / variance)))
        prior = default_prior(robot, prior)
    else:
        density = density / trajectory.periods
        prior = prior if isinstance(prior, Prior) else None
    problem = build_problem(
        robot,
        replace(samples, covariance=np.diag(sigma)),
        friction=model.terms,
        weighting="gls",
        constraints=Constraints.of_size(robot),
        prior=prior or None,
        base=rows.base,
        check_excitation=False,
    )
    problem = problem.with_origin(profiled=profiled)

    def believed(frequency: Array) -> Array:
        return np.outer(density / sigma, gain(frequency * kept))

    spectrum = NoiseSpectrum.of(problem, values, believed=believed)
    sizes = values
    if profiled:
        sizes = _estimated_sizes(problem, values, spectrum.covariance)
        spectrum = NoiseSpectrum.of(problem, sizes, believed=believed)
    return Rehearsal(
        problem=problem,
        theta=frozen(values),
        sizes=frozen(sizes),
        spectrum=spectrum,
        noise=usual,
        processing=processing,
        log=log,
        notes=notes,
    )


def _log(robot: RobotModel, trajectory: Trajectory, reading: Reading) -> Recording:
    """Return the log of a trajectory, its efforts yet to be filled in."""
    position = trajectory.sample()[0]
    log = Recording(
        time=np.arange(len(position)) / trajectory.rate_hz,
        position=position,
        effort=np.zeros_like(position),
        joint_names=robot.joint_names,
    )
    if reading == "record":
        return log
    start = trajectory.lead_samples / trajectory.rate_hz
    return replace(log, period=trajectory.period, start=start, periods=trajectory.periods)


def _efforts(
    robot: RobotModel, friction: FrictionModel, theta: Array, q: Array, v: Array, a: Array
) -> Array:
    """Return the efforts (K, n) of nominal parameters."""
    links = 10 * robot.n_links
    rigid = robot.inverse_dynamics(theta[:links], q, v, a)
    motion = SampledMotion(position=q, velocity=v, acceleration=a, robot=robot)
    return np.asarray(rigid + friction.columns_in(motion) @ theta[links:])


def _estimated_sizes(problem: Problem, theta: Array, covariance: Array) -> Array:
    """Return rms estimates of theta (p,) whose errors have a covariance (b, b).

    Of friction terms alone. One that is zero and cannot be negative is estimated as zero half of
    the time.
    """
    out = np.array(theta)
    start = 10 * problem.robot.n_links
    places = {name: k for k, name in enumerate(problem.base.names)}
    for k, parameter in enumerate(problem.friction.parameters, start):
        place = places.get(parameter.name)
        if place is not None:
            cut = parameter.nonnegative and theta[k] == 0.0
            out[k] = np.sqrt(theta[k] ** 2 + covariance[place, place] * (0.5 if cut else 1.0))
    return out


def _gain(processing: Processing, rate_hz: float) -> tuple[Callable[[Array], Array], float]:
    """Return the filter's squared gain at frequencies in Hz, and its bandwidth in Hz."""
    low_pass = processing.low_pass(rate_hz)

    def squared(frequency: Array) -> Array:
        return low_pass.gain(np.minimum(frequency, 0.5 * rate_hz), rate_hz) ** 2

    middles = (np.arange(_FREQUENCIES) + 0.5) * 0.5 * rate_hz / _FREQUENCIES
    return squared, float(np.mean(squared(middles))) * rate_hz


def _weights(rows: RowSource, variance: Array) -> Array:
    """Return the variances (n,) by which `identify` weights joints whose noise has `variance`."""
    joints = JointRows.merged(rows.map(JointRows.of))
    weights = variance + joints.least_variance
    return np.asarray(weights * joints.share_of_noise(variance, weights))


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
    limits: JointLimits | None = None,
    motions: Mapping[str, States] | None = None,
    reading: Reading = "record",
    repetitions: Iterable[int] = REPETITIONS,
) -> Expected:
    """Say before a run what it will buy: expected intervals, bands, what stays open, and why.

    The run goes through the processing, the weights and the prior that `sdpid.identify` would
    choose for its log (see `sdpid.excitation.expected.expect`). It is taken to follow the
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
    rehearsed = partial(
        rehearse,
        robot,
        friction=friction,
        noise=given,
        prior=prior,
        theta=None if earlier is None else earlier.theta,
        reading=reading,
    )
    run = rehearsed(trajectory)
    base, values, rows = run.problem.base, run.theta, run.rows
    own = _sums(run.spectrum)
    again = _again(own, trajectory, rehearsed, reading)
    told = np.zeros_like(own)
    if earlier is not None:
        told[:, : base.count, : base.count] = earlier.information
    before, _ = _posterior(run, told)
    known, root = _posterior(run, own + told)
    states = trajectory.sample()
    random = default_motion(robot, _RANDOM, periods=1).sample()
    asked = {**(motions or {}), "the motion of the run": states, "random motion": random}
    looked = {name: _rows(rows, each) for name, each in asked.items()}
    variance, share, _ = known.spread(base.matrix)
    theta_variance, theta_share, _ = known.spread(np.eye(run.problem.n_theta))
    freedom = run.spectrum.freedom(base.matrix @ known.from_fit @ run.spectrum.root)
    freedom /= np.maximum(1.0 - share, np.finfo(float).eps) ** 2
    speeds, functions, slopes = _friction_functions(run)
    shape = len(speeds), robot.n
    moves = functions @ known.from_errors + slopes @ root[base.count :]
    friction_variance, _, _ = known.spread(functions, moves)
    covariance = known.covariance(base.matrix)
    value, half = base.matrix @ values, _quantile(freedom) * np.sqrt(variance)
    least, most = run.problem.feasible.limits_of(base.matrix)
    kept = partial(_kept_above, least - value)
    notes = [*run.notes, *run.noise.notes, *(() if earlier is None else earlier.notes)]
    notes += [*(() if run.problem.prior is None else run.problem.prior.notes), *_ALWAYS]
    return Expected(
        robot=robot,
        base=base,
        values=frozen(value),
        standard_errors=frozen(np.sqrt(variance)),
        half_widths=frozen(half),
        lower=frozen(np.minimum(np.maximum(value - half, least), value)),
        upper=frozen(np.maximum(np.minimum(value + half, most), value)),
        before=frozen(np.sqrt(before.spread(base.matrix)[0])),
        prior_share=frozen(share),
        theta=values,
        theta_half_widths=frozen(NORMAL * np.sqrt(theta_variance)),
        theta_prior_share=frozen(theta_share),
        speeds=speeds,
        friction=frozen((functions @ values).reshape(shape)),
        friction_half_widths=frozen(NORMAL * np.sqrt(friction_variance).reshape(shape)),
        bands=tuple(
            Band(
                motion=name,
                effort=frozen(np.sqrt(np.mean((W @ value) ** 2, axis=0))),
                half_width=frozen(_half_width(W, kept(covariance))),
                before=frozen(_half_width_before(W, before, base.matrix)),
            )
            for name, W in looked.items()
        ),
        durations=tuple(
            _duration(
                run,
                own + (times - trajectory.periods) * again + told,
                kept,
                times,
                trajectory.duration + (times - trajectory.periods) * trajectory.period,
                looked.values(),
            )
            for times in repetitions
        ),
        open_directions=open_directions(
            rows,
            states,
            density=run.noise.density,
            information=(own + told)[0, : base.count, : base.count],
            believed=_believed(run),
            limits=limits,
        ),
        covariance=frozen(covariance),
        noise=run.noise,
        seconds=trajectory.duration,
        notes=tuple(notes),
    )


def _sums(spectrum: NoiseSpectrum) -> Array:
    """Return ``Σ H_g`` and ``Σ S_g·H_g`` over the rows of a run, (2, c, c).

    The information of the base parameters and of speeds that the data would choose, and the
    covariance of the scores: what the errors of a fit are made of. Those of runs add up.
    """
    return np.stack([spectrum.information(), spectrum.information(spectrum.density)])


def _again(
    own: Array,
    trajectory: Trajectory,
    rehearsed: Callable[[Trajectory], Rehearsal],
    reading: Reading,
) -> Array:
    """Return the sums over the rows that one more repetition of the motion adds."""
    leads = trajectory.lead_samples > 0 and is_closed(trajectory.series)
    if reading == "record" and leads:
        longer = rehearsed(trajectory.with_periods(trajectory.periods + 1))
        return np.stack([_positive(each) for each in _sums(longer.spectrum) - own])
    return own / trajectory.periods


def _positive(matrix: Array) -> Array:
    """Return the nearest positive semidefinite matrix, in units of its diagonal."""
    size = np.sqrt(np.maximum(np.abs(np.diag(matrix)), np.finfo(float).tiny))
    units = np.outer(size, size)
    return np.asarray(raise_eigenvalues(matrix / units, 0.0) * units)


def _posterior(run: Rehearsal, sums: Array) -> tuple[Posterior, Array]:
    """Return the errors of the estimate that `identify` would make, and how the fit is off.

    Of the latter T (c, r), for the base parameters and the logarithms of speeds: what rounding of
    the sums hides has no column.
    """
    spectrum, b = run.spectrum, run.problem.base.count
    # What is known of speeds beforehand is as uncertain as stated.
    known = np.diag(spectrum.known)
    root = information_root(information_rows(sums[0] + known))
    scores = root.T @ (sums[1] + spectrum.size * known) @ root
    A = information_rows(sums[0, :b, :b])
    base = run.problem.base_of(run.theta)
    problem = replace(run.problem, A=frozen(A), rhs=frozen(A @ base), floor=0.0)
    about: dict[str, Any] = {"method": "expected", "status": "expected", "iterations": 0}
    about |= {"solve_time": 0.0}
    if problem.prior is None:
        estimate = Estimate(problem=problem, base=frozen(base), theta=None, **about)
    else:
        estimate = Estimate.of_theta(problem, run.theta, **about)
    # The noise is believed, not estimated.
    errors = FitErrors(root[:b], scores, lambda directions: np.full(len(directions), np.inf))
    return Posterior(estimate, errors), root


def _believed(run: Rehearsal) -> Array:
    """Return what the prior tells of the base parameters, (b, b)."""
    base, prior = run.problem.base, run.problem.prior
    if prior is None:
        return np.zeros((base.count, base.count))
    theta = np.array(run.theta)
    R = np.vstack([term.curvature_rows(theta) for term in prior.terms])
    return information_of_rows(R, base.matrix)


def _rows(rows: BaseRows, states: States) -> Array:
    """Return the regressor (K, n, b) at some states of a motion."""
    step = max(1, len(states[0]) // _STATES)
    return rows.rows(*(each[::step] for each in states))


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


def _half_width_before(W: Array, before: Posterior, matrix: Array) -> Array:
    """Return the same before the run; infinite where it is open."""
    variance, _, _ = before.spread(W.reshape(-1, W.shape[2]) @ matrix)
    return np.asarray(NORMAL * np.sqrt(variance.reshape(W.shape[:2]).mean(axis=0)))


def _duration(
    run: Rehearsal,
    sums: Array,
    kept: Callable[[Array], Array],
    times: int,
    seconds: float,
    rows: Iterable[Array],
) -> Duration:
    """Return what is known after `times` repetitions."""
    known, _ = _posterior(run, sums)
    base, links = run.problem.base, run.problem.robot.n_links
    covariance, values = kept(known.covariance(base.matrix)), base.matrix @ run.theta
    masses = np.eye(run.problem.n_theta)[: 10 * links : 10]
    shares = []
    for W in rows:
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
    rest = problem.n_theta - len(friction.parameters)
    bending = Bending.of(friction, problem.origin.profiled, run.sizes[rest:])
    top = np.abs(problem.samples.velocity).max()
    asked = _SPEEDS if friction.parameters else ()
    speeds = [speed for speed in asked if speed <= top or speed == _SPEEDS[0]]
    v = np.array([(speed, -speed) for speed in speeds]).reshape(-1, 1) * np.ones(problem.robot.n)
    motion = SampledMotion(
        position=v, velocity=v, acceleration=np.zeros_like(v), robot=problem.robot
    )
    columns, bends = (
        0.5 * (each[::2] - each[1::2])
        for each in (friction.columns_in(motion), bending.columns(motion))
    )
    functions = np.pad(columns, ((0, 0), (0, 0), (rest, 0)))
    count = len(speeds) * problem.robot.n
    flat = functions.reshape(count, problem.n_theta), bends.reshape(count, bends.shape[2])
    return frozen(speeds), *flat


def _quantile(freedom: Array) -> Array:
    from scipy.special import stdtrit

    return np.asarray(stdtrit(np.minimum(freedom, _ENDLESS), 0.5 * (1.0 + LEVEL)))
