"""What is known of a robot before a run: its noise, what is believed, and what earlier runs tell.

What counts for an estimate is the noise's density at the frequencies of the motion: white noise of
standard deviation s, sampled at the rate f, has the density s²/f, and residuals of variance s² that
are alike over a time tau have s²·tau. On real robots residuals are what the model lacks rather than
noise of sensors, and they last: that is what is assumed where nothing is known.

After earlier runs the next one asks for what they left open. The information is that of the earlier
data alone, without a prior: the inverse of the covariance that `sdpid.identify` states for its
unconstrained fit. Residuals that last count as the few independent ones they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from sdpid._common.arrays import Array, Mask, frozen, real_array
from sdpid.errors import DataError
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.noise_spectrum import NoiseSpectrum
from sdpid.estimation.prior.prior import Prior, prior_terms, repaired
from sdpid.estimation.problem import Problem, build_problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.excitation.criterion.rows import BaseRows
from sdpid.experiment.preparation.prepare import Logs, prepare
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.consistent import raise_second_moments
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.inertia import from_pseudo_inertia
from sdpid.robot.model.base_parameters import BaseParameters, characteristic_length
from sdpid.robot.model.geometry import neutral
from sdpid.robot.model.model import RobotModel

# Residuals of real recordings, beside the geometric mean of a joint's rms effort and the largest
# one, and how long they are alike, s: medians over 31 joints of UR10, Panda, LWR 4+, TX40 and Gen3
# under the defaults of `sdpid.identify` (by robot 1.5 to 4.6 %, 0.07 to 0.7 s).
SHARE, LASTING = 0.025, 0.2

# A joint whose effort is all but zero gets this share of the loudest one's.
_SILENT = 1e-3

Given: TypeAlias = "ExpectedNoise | float | Sequence[float] | Mapping[str, float] | Array | None"


def usual_effort(rms: Array) -> Array:
    """Return the geometric mean of each joint's rms effort (n,) and the largest one, N·m.

    It is never zero: of joints without any effort it is one.
    """
    largest = float(np.max(rms, initial=0.0)) or 1.0
    # Two roots: products of tiny numbers would be zero.
    return np.asarray(np.sqrt(np.maximum(rms, _SILENT * largest)) * np.sqrt(largest))


@dataclass(frozen=True, kw_only=True, eq=False)
class ExpectedNoise:
    """The noise of every joint's effort.

    Attributes
    ----------
    density : ndarray, shape (n,)
        At the frequencies of the motion, (N·m)²·s.
    deviation : ndarray, shape (n,)
        Standard deviation of the residuals, N·m: of white noise that of a sample.
    notes : tuple of str
        Where the numbers are from.
    """

    density: Array
    deviation: Array
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("density", "deviation"):
            values = real_array(getattr(self, name), f"noise: {name}", ndim=1)
            if not np.all(values > 0.0):
                raise DataError(f"noise: {name} is {values.tolist()}; give positive numbers.")
            object.__setattr__(self, name, frozen(values))
        if len(self.density) != len(self.deviation):
            raise DataError(
                f"noise: {len(self.density)} densities and {len(self.deviation)} deviations; give "
                "one of each for every joint."
            )

    @classmethod
    def white(cls, deviation: Array, rate_hz: float) -> ExpectedNoise:
        """Return white noise of standard deviations (n,), N·m, at a rate in Hz."""
        values = np.asarray(deviation, dtype=np.float64)
        note = f"noise of the efforts: white, as given, at {rate_hz:g} Hz"
        return cls(density=values**2 / rate_hz, deviation=values, notes=(note,))

    @classmethod
    def assumed(cls, effort_rms: Array) -> ExpectedNoise:
        """Return what is usual on real robots, from the rms effort (n,) of the motion, N·m."""
        deviation = SHARE * usual_effort(effort_rms)
        note = (
            f"noise of the efforts: assumed, as on real robots: {100.0 * SHARE:g} % of each "
            "joint's usual effort (the geometric mean of its rms and the largest one), alike over "
            f"{LASTING:g} s"
        )
        return cls(density=LASTING * deviation**2, deviation=deviation, notes=(note,))

    @classmethod
    def of_residuals(cls, problem: Problem, theta: Array) -> ExpectedNoise:
        """Return that of an earlier run, from the spectrum of its residuals.

        Raises
        ------
        DataError
            When the problem has no rows.
        """
        rows = problem.require_rows("the noise of an earlier run")
        spectrum = NoiseSpectrum.of(problem, theta)
        sigma = problem.sigma if problem.sigma.ndim == 2 else problem.sigma.mean(axis=0)
        own = np.zeros(problem.robot.n)
        own[: len(spectrum.densities)] = spectrum.densities
        time = rows.samples.time
        if time is None:
            raise DataError("the noise of an earlier run: its samples have no time stamps.")
        step = float(np.median(np.diff(time)))
        variance = np.diag(sigma) * np.where(own > 0.0, own, 1.0)
        residual = rows.samples.effort - problem.predict(problem.base_of(theta))
        used = rows.samples.used
        squares = np.where(used, residual, 0.0) ** 2
        deviation = np.sqrt(squares.sum(axis=0) / np.maximum(used.sum(axis=0), 1))
        deviation = np.where(deviation > 0.0, deviation, np.sqrt(variance))
        note = "noise of the efforts: as the residuals of the earlier run"
        return cls(density=variance * step, deviation=deviation, notes=(note,))

    @classmethod
    def of(
        cls, joint_names: Sequence[str], given: Given, effort_rms: Array, rate_hz: float
    ) -> ExpectedNoise:
        """Return what is given, or what is assumed.

        Parameters
        ----------
        joint_names : sequence of str
            The n joints.
        given : ExpectedNoise, float, sequence or mapping, optional
            Numbers are standard deviations of white noise, N·m: one for all joints, one each, or
            by the joint's name. By default `assumed`.
        effort_rms : ndarray, shape (n,)
            Rms efforts of the motion, N·m.
        rate_hz : float
            Rate of the samples that numbers refer to, Hz.

        Raises
        ------
        DataError
            When numbers or names do not fit.
        """
        if isinstance(given, ExpectedNoise):
            return given
        if given is None:
            return cls.assumed(effort_rms)
        n = len(joint_names)
        if isinstance(given, Mapping):
            unknown = [str(name) for name in given if name not in joint_names]
            missing = [name for name in joint_names if name not in given]
            if unknown or missing:
                raise DataError(
                    f"noise: names {', '.join(unknown) or 'no joint'} wrongly and leaves out "
                    f"{', '.join(missing) or 'none'}; give one number for each of "
                    f"{', '.join(joint_names)}."
                )
            given = [float(given[name]) for name in joint_names]
        values = np.atleast_1d(np.asarray(given, dtype=np.float64))
        if values.shape not in ((1,), (n,)):
            raise DataError(f"noise: has shape {values.shape}; give one number or {n}, in N·m.")
        return cls.white(np.broadcast_to(values, (n,)), rate_hz)

    def filtered_variance(self, bandwidth_hz: float) -> Array:
        """Return the variance (n,) behind a filter, (N·m)².

        Parameters
        ----------
        bandwidth_hz : float
            Integral of its squared gain over negative and positive frequencies, Hz.
        """
        return np.minimum(self.deviation**2, self.density * bandwidth_hz)


# Coulomb friction is taken to be this share of a joint's usual effort, and viscous friction as
# large at its rms speed: as simulated robots have it. Descriptions often write next to none, where
# they mean that they do not know.
_FRICTION = 0.1

# A robot whose description has no masses is taken to weigh this much a link, kg, each a ball with
# this share of the robot's length for its radius of gyration.
_MASS, _BALL = 2.0, 0.3

# Below this rms speed a joint does not tell viscous friction, rad/s (m/s).
_STANDS = 1e-3

# Rms speed of a usual motion, as a share of the speed limit; without a limit, rad/s.
_SPEED_SHARE, _SPEED = 0.3, 0.5

# Samples of a sine at which friction terms are looked at.
_STATES = 64

# Directions whose information is this small, beside the largest, have none: rounding.
_OPEN = 1e-12


def nominal_bodies(robot: RobotModel) -> tuple[Array, tuple[str, ...]]:
    """Return the bodies (links, 10) of the description, made possible, and what was assumed."""
    given = np.array(robot.prior)
    known = given[:, 0] > 0.0
    bodies = repaired(given)[0]
    if known.all():
        return bodies, ()
    mass = float(np.mean(given[known, 0])) if known.any() else _MASS
    radius = (_BALL * characteristic_length(robot)) ** 2
    ball = from_pseudo_inertia(mass * np.diag([radius, radius, radius, 1.0]))
    if known.any():
        # Frames without mass, such as a tool's, stay next to nothing.
        bodies[~known, 0] = 1e-3
        return raise_second_moments(bodies, 1e-7), ()
    bodies[:] = ball
    return bodies, (f"the description has no masses: {mass:g} kg a link were assumed",)


def nominal_theta(
    robot: RobotModel, friction: FrictionModel, q: Array, v: Array, a: Array
) -> tuple[Array, tuple[str, ...]]:
    """Return theta (p,) before a run, and what was assumed.

    Links are as described; Coulomb and viscous friction as described, and at least of a usual size
    on the motion; other terms are zero.

    Parameters
    ----------
    robot, friction
        The robot and its friction terms.
    q, v, a : ndarray, shape (K, n)
        States of the motion.
    """
    bodies, notes = nominal_bodies(robot)
    rigid = robot.inverse_dynamics(bodies, q, v, a)
    usual = usual_effort(np.sqrt(np.mean(rigid**2, axis=0)))
    speed = np.maximum(np.sqrt(np.mean(v**2, axis=0)), _STANDS)
    viscous, coulomb = robot.described_friction()
    sizes = {
        "Fs": np.maximum(coulomb, _FRICTION * usual),
        "Fv": np.maximum(viscous, _FRICTION * usual / speed),
    }
    tail = [
        float(sizes[p.symbol][p.joint]) if p.symbol in sizes else 0.0 for p in friction.parameters
    ]
    return frozen(np.concatenate([bodies.ravel(), tail])), notes


def default_prior(robot: RobotModel, prior: Prior | bool | None) -> Prior | None:
    """Return the prior that `sdpid.identify` takes: by default one where links have masses."""
    if prior is None:
        prior = bool(np.any(robot.prior[:, 0] > 0.0))
    if isinstance(prior, Prior):
        return prior
    return Prior() if prior else None


def prior_information(rows: BaseRows, prior: Prior | bool | None, effort_rms: Array) -> Array:
    """Return the information (b, b) of a prior about the base parameters.

    It is the inverse of ``B·S·B^T`` with S the covariance of theta that the prior believes, zero
    where it believes nothing.

    Parameters
    ----------
    rows : BaseRows
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
    robot, base = rows.robot, rows.base
    found = default_prior(robot, prior)
    if found is None:
        return np.zeros((base.count, base.count))
    limit = robot.velocity_limits
    speed = np.where(np.isfinite(limit), _SPEED_SHARE * limit, _SPEED * robot.gears)
    phase = (np.arange(_STATES) + 0.5) * 2.0 * np.pi / _STATES
    wave = np.sqrt(2.0) * np.sin(phase)[:, None]
    samples = Samples(
        position=np.tile(neutral(robot), (_STATES, 1)),
        velocity=speed * wave,
        acceleration=speed * np.roll(wave, _STATES // 4, axis=0),
        effort=np.asarray(effort_rms) * wave,
    )
    terms = prior_terms(found, RowSource(robot, rows.friction, base, samples)).terms
    theta = np.zeros(len(base.theta_names))
    bodies = np.array(robot.prior if found.bodies is None else found.bodies)
    # The prior's curvature is taken at the bodies believed, made possible.
    theta[: robot.prior.size] = repaired(bodies)[0].ravel()
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


def marginal(information: Array, kept: Mask) -> Array:
    """Return the information (k, k) of some parameters where the others are unknown.

    Parameters
    ----------
    information : ndarray, shape (c, c)
        Of all, positive semidefinite.
    kept : ndarray of bool, shape (c,)
        Which k of them.
    """
    if kept.all():
        return information
    cross = information[np.ix_(kept, ~kept)]
    other = information[np.ix_(~kept, ~kept)]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(other), np.finfo(float).tiny))
    solved = (cross * scale) @ inverse(other * np.outer(scale, scale)) @ (cross * scale).T
    out = information[np.ix_(kept, kept)] - solved
    return np.asarray(0.5 * (out + out.T))


def inverse(matrix: Array) -> Array:
    """Return the inverse of a symmetric matrix, its diagonal of order one, where it is not zero."""
    values, vectors = np.linalg.eigh(matrix)
    kept = values > _OPEN * max(float(values[-1]), 0.0)
    return np.asarray((vectors[:, kept] / values[kept]) @ vectors[:, kept].T)


# An estimate, an `Identification` (which holds one), or recordings.
Previous: TypeAlias = "Estimate | object | Logs"

# A parameter of the plan is one of the earlier model's where this much of it is not, relative.
_FOREIGN = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class EarlierInformation:
    """What earlier runs tell.

    Attributes
    ----------
    information : ndarray, shape (b, b)
        Inverse of the covariance of the base parameters; singular where they are open.
    theta : ndarray, shape (p,)
        The earlier estimate; zero for friction terms that it did not have.
    noise : ExpectedNoise
        That of its residuals.
    notes : tuple of str
        What was used, and what it did not tell.
    """

    information: Array
    theta: Array
    noise: ExpectedNoise
    notes: tuple[str, ...] = ()


def earlier_information(rows: BaseRows, previous: Previous) -> EarlierInformation:
    """Return what earlier runs tell of a plan's base parameters.

    Parameters
    ----------
    rows : BaseRows
        The plan's robot, friction terms and base parameters.
    previous : Estimate, Identification, Recording or path, or a sequence of recordings or paths
        Recordings are processed and fitted together, with the plan's friction terms.

    Raises
    ------
    DataError
        When it is of another robot, has no rows, or the recordings cannot be read.
    """
    given: Any = previous
    estimate = getattr(given, "estimate", given)
    if not isinstance(estimate, Estimate):
        estimate = _identified(rows, given)
    problem, robot, base = estimate.problem, rows.robot, rows.base
    if problem.robot.joint_names != robot.joint_names or problem.robot.n_links != robot.n_links:
        raise DataError(
            f"previous: is of robot '{problem.robot.name}' with joints "
            f"{', '.join(problem.robot.joint_names)}; the plan is for '{robot.name}' with "
            f"{', '.join(robot.joint_names)}."
        )
    spectrum = NoiseSpectrum.of(problem, estimate.theta)
    found, foreign = _in_coordinates(problem.base, base, _data_information(spectrum))
    notes = [
        f"earlier runs: {problem.n_samples} samples, counted as the few independent ones they are"
    ]
    if foreign:
        notes.append(f"earlier runs tell nothing of {', '.join(foreign)}: not in their model")
    known = dict(zip(problem.base.theta_names, estimate.some_theta.tolist(), strict=True))
    return EarlierInformation(
        information=frozen(found),
        theta=frozen([known.get(name, 0.0) for name in base.theta_names]),
        noise=ExpectedNoise.of_residuals(problem, estimate.some_theta),
        notes=tuple(notes),
    )


def _identified(rows: BaseRows, logs: Logs) -> Estimate:
    """Return the estimate from recordings, with the plan's terms and the default prior."""
    robot = rows.robot
    samples = prepare(robot, logs, name="previous").samples
    with_periods = samples.covariance is not None
    problem = build_problem(
        robot,
        samples,
        friction=rows.friction.terms,
        weighting="gls" if with_periods else "residual",
        constraints=Constraints.of_size(robot),
        prior=None if with_periods else default_prior(robot, None),
        base=rows.base,
        check_excitation=False,
    )
    return solve_sdp(problem)


def _data_information(spectrum: NoiseSpectrum) -> Array:
    """Return J (b, b), the inverse of the covariance of a fit where the data determine it."""
    b = spectrum.base_count
    H = spectrum.information() + np.diag(spectrum.known)
    scores = spectrum.information(spectrum.density)
    scores += spectrum.size * np.diag(spectrum.known)
    # J = H·M^(-1)·H; then what is known of the speeds that the data chose is marginalized.
    scale = 1.0 / np.sqrt(np.maximum(np.diag(scores), np.finfo(float).tiny))
    whole = H * scale @ inverse(scores * np.outer(scale, scale)) @ (H * scale).T
    return marginal(whole, np.arange(len(whole)) < b)


def _in_coordinates(
    old: BaseParameters, new: BaseParameters, information: Array
) -> tuple[Array, list[str]]:
    """Return an information in other base parameters, and the names of those it does not know."""
    place = {name: k for k, name in enumerate(old.theta_names)}
    known = np.array([name in place for name in new.theta_names])
    columns = [
        place[name] for name, is_known in zip(new.theta_names, known, strict=True) if is_known
    ]
    wanted = np.zeros((new.count, len(old.theta_names)))
    wanted[:, columns] = new.matrix[:, known]
    size = np.linalg.norm(old.matrix, axis=1)
    rows = old.matrix / size[:, None]
    found = np.linalg.lstsq(rows.T, wanted.T, rcond=None)[0].T
    missing = np.linalg.norm(wanted - found @ rows, axis=1)
    missing += np.linalg.norm(new.matrix[:, ~known], axis=1)
    own = missing <= _FOREIGN * np.linalg.norm(new.matrix, axis=1)
    L = found[own] / size
    # The rest of the old coordinates: orthogonal to these, and marginalized.
    rest = np.linalg.svd(L * (1.0 / np.linalg.norm(L, axis=1))[:, None])[2][len(L) :]
    change = np.linalg.inv(np.vstack([L, rest]))
    moved = change.T @ information @ change
    out = np.zeros((new.count, new.count))
    out[np.ix_(own, own)] = marginal(moved, np.arange(len(moved)) < len(L))
    names = [name for name, is_own in zip(new.names, own, strict=True) if not is_own]
    return out, names
