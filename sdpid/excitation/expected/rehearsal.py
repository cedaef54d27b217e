"""A run before it is made: the rows that `sdpid.identify` would make of its log, and their errors.

The motion is written down as a log at the trajectory's rate, with the efforts that a nominal robot
has, and goes through the processing that `sdpid.identify` would choose: the same filter, the same
rows masked near reversals, friction columns filtered alike. Its weights are made as those of
`identify` are, with the expected noise in place of the residuals. Then the errors of the fit are
those of `sdpid.estimation.noise_spectrum`, with the spectrum that the noise is believed to have.
Nothing is random, and no number is fitted to outcomes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid._common.threads import one_thread
from sdpid.estimation.compression.covariance import JointRows
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.effects.choose import closed_in_the_middle
from sdpid.estimation.noise_spectrum import NoiseSpectrum
from sdpid.estimation.prior.prior import Prior
from sdpid.estimation.problem import Problem, build_problem
from sdpid.excitation.criterion.belief import default_prior, nominal_theta
from sdpid.excitation.criterion.noise import ExpectedNoise, Given
from sdpid.excitation.criterion.rows import BaseRows
from sdpid.experiment.preparation.prepare import friction_of
from sdpid.experiment.processing.choose import default_processing
from sdpid.experiment.processing.process import process
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.trajectory.trajectory import Trajectory
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
    samples = process(log, processing, progress=False)
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
