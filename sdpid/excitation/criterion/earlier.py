"""What earlier runs tell of the base parameters: an information matrix in a plan's coordinates.

The next run then asks for what the earlier ones left open. The information is that of the earlier
data alone, without a prior: the inverse of the covariance that `sdpid.identify` states for its
unconstrained fit. Residuals that last count as the few independent ones they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid.errors import DataError
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.noise_spectrum import NoiseSpectrum
from sdpid.estimation.problem import build_problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.excitation.criterion.belief import default_prior, inverse, marginal
from sdpid.excitation.criterion.noise import ExpectedNoise
from sdpid.excitation.criterion.rows import BaseRows
from sdpid.experiment.preparation.prepare import Logs, prepare
from sdpid.robot.model.base_parameters import BaseParameters

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
