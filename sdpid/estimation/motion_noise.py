"""By how much noise in the motion, landings, the filter, and friction's law move the fit.

**Noise** in positions enters the columns of the regression: least squares makes what multiplies
accelerations too small, by the share of noise in their power, and friction near reversals, too.
Noise of the same strength once more moves the fit as much again [cook1994]_. It is added to a copy
of each recording, which is processed like the first; processing is linear, so that samples with the
noise taken off are the first ones' reflection. Both are fitted: what is proportional to the noise
cancels in their mean, and what is left beside the fit is its bias, but for terms of fourth order.

**Landings.** There joint speeds jump within a sample: differences of positions give another
acceleration than that of the sampled effort, and within the filter's memory the robot moves on. The
errors repeat with every step, so that no residual shows them as noise, and no longer log averages
them out. The same log without the samples near landings is fitted, too: its fit knows less and has
none of these errors. The two, each without its bias by noise, differ by what landings do, and by
noise, whose variance is the difference of theirs [hausman1978]_. What noise would make of the
difference is taken off its mean square.

**The filter** takes away what it does not let pass, and Jacobians of contacts and signs of speeds
turn within its memory. Where no sample near a landing is used, the fit by another filter tells.

**Friction's law.** The data choose the speeds at which friction bends, not its law. What the
robot's law has and the model lacks, such as a Stribeck peak, repeats with the motion as well. A
model with further curves of the same kind, slower and faster ones, is fitted, too: it knows less,
and bends as the data ask.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Mask, generator
from sdpid.errors import DataError
from sdpid.estimation.compression.factor import compressed
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.triangle import Triangle
from sdpid.estimation.compression.whitening import apply, weights_of
from sdpid.estimation.error_source import ErrorSource
from sdpid.estimation.information import Excitation, least_squares
from sdpid.estimation.noise_spectrum import NoiseSpectrum
from sdpid.estimation.problem import Problem
from sdpid.experiment.preparation.prepare import prepare
from sdpid.experiment.processing.base import landing_share, unit
from sdpid.experiment.processing.motion import fourth_differences, noise_of
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.gaps import retimed, told_clock
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.friction.term import JointwiseTerm
from sdpid.robot.friction.terms import RotorInertia

# A cut-off this many times higher tells what the filter does: of nine logs of quadrupeds (stand,
# trot and hang of 10 s) intervals then held 97 % of the truth on average, 93 before; twice as high
# a cut-off lets so much more noise pass that one difference of seven was hardly seen.
_FASTER = 1.5

# Speeds of the further curves, in those that the data chose: they moved the total mass of a trot of
# a simulated A1 to where the true law has it, a third and three times alone half as far, and
# further ones, to an eighth or 16 times, no farther.
_SPEEDS = (0.25, 0.5, 2.0, 4.0)

# A parameter of which more than this share lies where no row is has an infinite variance.
_LOST = 1e-7

# Median of the size of a normal variable, in standard deviations.
_MEDIAN = 0.6745

# What has noise of a recording, of its base, and of the base's IMU.
_NOISY = (
    ("position", "velocity"),
    ("orientation", "position", "linear_velocity", "angular_velocity"),
    ("gyroscope", "accelerometer"),
)


def with_motion_bias(
    problem: Problem,
    logs: Sequence[Recording],
    processing: Processing,
    *,
    noise_alone: bool = False,
    seed: int | np.random.Generator = 0,
) -> Problem:
    """Return a problem that knows how far noise, landings, the filter and friction move its fit.

    The estimate stays as it is; intervals and standard errors count the biases as errors.

    Parameters
    ----------
    problem : Problem
        Of recordings without periods.
    logs : sequence of Recording
        What its samples were made of.
    processing : Processing
        How. Landings are looked for where any of them was used, what the filter does elsewhere.
    noise_alone : bool, optional
        Look for noise, and for nothing else.
    seed : int or numpy.random.Generator, optional
        Of the noise.

    Raises
    ------
    DataError
        When the samples are not those of these recordings, or the problem has no rows here.
    """
    rows = problem.require_rows_here("bias by noise in the motion")
    rng = generator(seed)
    noisier = [with_noise(log, rng) for log in logs]
    samples = _processed(problem, noisier, processing)
    if not np.array_equal(samples.effort, problem.samples.effort):
        raise DataError(
            "bias by noise in the motion: the problem's samples are not those of the "
            f"recordings ({problem.n_samples} and {samples.n_samples} samples, or other "
            "efforts); give what it was built of, and how it was processed."
        )
    noisy = _with_and_without(problem.samples, samples)
    fit, bias = _fits(problem, [_of(problem, rows, each) for each in noisy])
    found: dict[str, Array | None] = {"motion": bias}
    if not noise_alone:
        name, others = _others(problem, logs, noisier, noisy, processing)
        if others:
            apart, *moved = (_of(problem, rows, each) for each in others)
            fit_apart, bias_apart = _fits(apart, moved)
            found[name] = beyond_noise(problem, apart, fit - bias - (fit_apart - bias_apart))
        found["friction"] = friction_bias(problem, rows)
    sources = (ErrorSource.bias(n, each) for n, each in found.items() if each is not None)
    return replace(problem, errors=tuple(sources))


def _others(
    problem: Problem,
    logs: Sequence[Recording],
    noisier: Sequence[Recording],
    noisy: Sequence[Samples],
    processing: Processing,
) -> tuple[str, list[Samples]]:
    """Return what to look for, and samples without it: of the logs, then of those with noise."""
    if (clear := _away_from_landings(problem, logs, processing)) is not None:
        return "landing", [replace(each, mask=clear) for each in (problem.samples, *noisy)]
    # Covariances of samples of their own are not those of another filter's samples.
    if problem.sigma.ndim > 2 or landings_used(problem, logs, processing):
        return "filter", []
    faster = replace(processing, cutoff_hz=_FASTER * processing.cutoff_hz)
    try:
        plain, more = (_processed(problem, each, faster) for each in (logs, noisier))
    except DataError:
        # The rate of a recording allows no such cut-off.
        return "filter", []
    return "filter", [plain, *_with_and_without(plain, more)]


def _processed(problem: Problem, logs: Sequence[Recording], processing: Processing) -> Samples:
    """Return the samples of all recordings."""
    return prepare(problem.robot, logs, processing).samples


def _with_and_without(samples: Samples, noisier: Samples) -> list[Samples]:
    """Return samples with noise in their motion, and with the same noise taken off."""
    reflected: dict[str, Any] = {
        name: 2.0 * getattr(samples, name) - getattr(noisier, name)
        for name in ("position", "velocity", "acceleration")
    }
    if samples.position.shape[1] > samples.n:
        reflected["position"][:, 3:7] = unit(reflected["position"][:, 3:7])
    if samples.wide is not None and noisier.wide is not None:
        reflected["wide"] = tuple(
            replace(mine, velocity=2.0 * mine.velocity - more.velocity)
            for mine, more in zip(samples.wide, noisier.wide, strict=True)
        )
    return [replace(noisier, mask=samples.mask), replace(samples, **reflected)]


def _fits(problem: Problem, noisy: Sequence[Problem]) -> tuple[Array, Array]:
    """Return the fit (b,) of a problem, and its bias by noise, from those with noise once more."""
    fit, *others = (least_squares(each.A, each.rhs) for each in (problem, *noisy))
    return fit, np.mean(others, axis=0) - fit


def _of(problem: Problem, rows: RowSource, samples: Samples) -> Problem:
    """Return a problem of other samples, with the same weights."""
    own = rows.on(samples)
    A, rhs, _ = compressed(own, problem.sigma)[0].split()
    return replace(problem, A=A, rhs=rhs, rows=own)


def with_noise(log: Recording, rng: np.random.Generator) -> Recording:
    """Return a recording with white noise added to its motion.

    It is as strong as the recording's own, of two estimates the lower one: landings fill the whole
    spectrum of an accelerometer, but little of the time; encoders of coarse steps do not change for
    most of the time. Times that its speeds tell are those of the copy, too.
    """
    if (clock := told_clock(log)) is not None:
        log = retimed(log, clock)

    def like(signals: Array) -> Array:
        top = noise_of(signals, log.rate_hz)
        quiet = np.median(np.abs(fourth_differences(signals)), axis=0) / _MEDIAN
        level = np.where(quiet > 0.0, np.minimum(top, quiet), top)
        return np.asarray(level * rng.standard_normal(signals.shape))

    base, imu = log.base, None if log.base is None else log.base.imu
    drawn: list[dict[str, Any]] = [
        {
            name: np.asarray(value) + like(np.asarray(value))
            for name in names
            if (value := getattr(owner, name, None)) is not None
        }
        for owner, names in zip((log, base, imu), _NOISY, strict=True)
    ]
    moved, of_base, of_imu = drawn
    if base is not None:
        of_base["orientation"] = unit(of_base["orientation"])
        sensed = None if imu is None else replace(imu, **of_imu)
        moved["base"] = replace(base, imu=sensed, **of_base)
    return replace(log, **moved)


def landings_used(problem: Problem, logs: Sequence[Recording], processing: Processing) -> bool:
    """Return whether samples near a landing were used: by choice, or as too few others would stay.

    Parameters
    ----------
    problem : Problem
        Of these recordings.
    logs : sequence of Recording
        What its samples were made of.
    processing : Processing
        How.
    """
    contacts, around = problem.samples.contacts, processing.impact_s
    if contacts is None:
        return False
    # As far as the filter sees; flags' own margin is not told apart from it, and widens this.
    seen = (contacts.widened_s or 0.0) + (around or 0.0)
    most = 0.0 if around is None else 1.0 - processing.kept_share
    return any(
        landing_share(log.contacts, round(seen / log.step)) > most
        for log in logs
        if log.contacts is not None
    )


def _away_from_landings(
    problem: Problem, logs: Sequence[Recording], processing: Processing
) -> Mask | None:
    """Return which rows (K, n) of a problem's samples see no landing, None where all are used."""
    contacts, used = problem.samples.contacts, problem.samples.used
    if not landings_used(problem, logs, processing) or contacts is None or contacts.landed is None:
        return None
    clear = ~contacts.landed
    for part in problem.samples.parts:
        if not clear[part].any():
            return None
        # Where nobody asked to leave samples out, none are where next to none would stay.
        if processing.impact_s is None and clear[part].mean() < processing.kept_share:
            clear[part] = True
    apart: Mask = used & clear[:, None]
    return None if np.array_equal(apart, used) else apart


def beyond_noise(problem: Problem, apart: Problem, moved: Array) -> Array | None:
    """Return the difference of two fits, as large as it is beyond its noise.

    Parameters
    ----------
    problem : Problem
        Of all samples.
    apart : Problem
        Of those away from landings, or of samples of another filter.
    moved : ndarray, shape (b,)
        By how much the first's fit is above the second's.

    Returns
    -------
    ndarray, shape (b,), or None
        None where the other samples leave directions open.
    """
    if len(apart.excitation.weak()) > len(problem.excitation.weak()):
        return None
    own, others = (np.diag(NoiseSpectrum.of(each).covariance) for each in (problem, apart))
    return _beyond(moved, own, others)


def _beyond(moved: Array, own: Array, others: Array) -> Array:
    """Return an efficient fit less another (b,), beyond noise, from their variances (b,)."""
    seen = own > 0.0
    noise = float(np.sum(np.maximum(others[seen] / own[seen] - 1.0, 0.0)))
    found = float(np.sum(moved[seen] ** 2 / own[seen]))
    return np.asarray(np.sqrt(max(1.0 - noise / found, 0.0) if found else 0.0) * moved)


def friction_bias(problem: Problem, rows: RowSource) -> Array | None:
    """Return by how much the law of friction moves the fit (b,), beyond noise.

    Coefficients of friction, which mean another curve in another law, are left as they are. None
    where the data chose no speeds.

    Parameters
    ----------
    problem : Problem
        The problem.
    rows : RowSource
        Its rows.
    """
    chosen = {each.term for each in problem.origin.profiled}
    names = rows.friction.joint_names
    curves = [
        replace(term, **{f: tuple(share * term.speed(f, len(names))) for f in term.speed_fields})
        for term in rows.friction.terms
        if isinstance(term, JointwiseTerm) and type(term).__name__ in chosen
        for share in _SPEEDS
    ]
    if not curves:
        return None
    joints, first, b = np.arange(len(names)), rows.friction.first, rows.base.count
    triangle = Triangle(b + len(joints) * len(curves) + 1)
    for part in rows.parts():
        block, motion = rows.rows(part), rows.motion(part)
        more = np.zeros((*block.shape[:2], len(curves), len(joints)))
        for i, curve in enumerate(curves):
            more[:, first + joints, i, joints] = curve.shape_in(motion)
        more = more.reshape(*block.shape[:2], -1)
        stacked = np.concatenate([block[:, :, :-1], more, block[:, :, -1:]], axis=2)
        weighted = apply(*weights_of(rows, part, problem.sigma), stacked)
        triangle.add(weighted.reshape(-1, triangle.columns))
    R = triangle.R
    plain, own = _fit(R[:, :b], R[:, -1])
    rich, others = _fit(R[:, :-1], R[:, -1])
    compared = np.ones(problem.n_theta, dtype=bool)
    for term, place in rows.friction.placed:
        compared[10 * rows.robot.n_links :][place] = isinstance(term, RotorInertia)
    compared = compared[rows.base.kept]
    moved = np.where(compared, plain - rich[:b], 0.0)
    return _beyond(moved, np.where(compared, own, 0.0), others[:b])


def _fit(A: Array, rhs: Array) -> tuple[Array, Array]:
    """Return the least-squares solution, and its variances where those of the rows are one."""
    found = Excitation.of(A, ())
    root, lost = found.root, 1.0 - np.sum(found.root * found.inverse.T, axis=1) > _LOST
    return root @ ((A @ root).T @ rhs), np.where(lost, np.inf, np.sum(root**2, axis=1))
