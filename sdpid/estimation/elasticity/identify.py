"""Identify the elasticity of gears from encoders on both of their sides.

What a motor's encoder reads more than its link's is an offset of the recording, a delay between the
two times the velocity, and the compliance of the gear times the torque through it. That torque is
the rigid robot's without friction, which acts on the motor's side, and without the rotor's own.
All of it is linear in the unknowns but for the delay, whose velocity is taken half of it earlier.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, Indices
from sdpid.errors import DataError
from sdpid.estimation.elasticity.result import Elasticity, student
from sdpid.estimation.elasticity.signals import Run, runs_of
from sdpid.estimation.elasticity.terms import DeflectionTerm, candidates
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.posterior import Posterior
from sdpid.experiment.inspection.block_fit import block_error
from sdpid.experiment.recording.joints import FOLLOWS, match_joints, two_encoders
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.model.model import RobotModel

# A further term, or a delay for every joint, lowers the error on recordings that are left out by
# this share, on none of them raises it.
_WORTH = 0.02
# Rounds in which weights and delays settle.
_ROUNDS = 4
# Samples that a fit takes; of more, which are alike, some are left out.
_SAMPLES = 60_000


class _Model(NamedTuple):
    """What is fitted: terms of every joint, and whether the joints share a delay.

    The unknowns are the delays, then of every joint its compliance and the weights of its terms.
    """

    terms: tuple[tuple[DeflectionTerm, ...], ...]
    shared: bool = True

    @property
    def places(self) -> Indices:
        """Places of the compliances among the unknowns, and their number last, (m + 1,)."""
        delays = 1 if self.shared else len(self.terms)
        counts = [1 + sum(term.size for term in terms) for terms in self.terms]
        return np.cumsum([delays, *counts])

    def least(self) -> Array:
        """Return the least value of every unknown: 0 or none."""
        places = self.places
        low = np.full(places[-1], -np.inf)
        low[places[:-1]] = 0.0
        for place, terms in zip(places[:-1].tolist(), self.terms, strict=True):
            least = [term.least for term in terms for _ in range(term.size)]
            low[place + 1 : place + 1 + len(least)] = least
        return low

    def delays(self, x: Array) -> Array:
        """Return the delay of every joint, (m,), of the unknowns."""
        return np.broadcast_to(x[: self.places[0]], (len(self.terms),))

    def weights(self, x: Array) -> list[Array]:
        """Return each joint's compliance and weights."""
        return [x[a:b] for a, b in pairwise(self.places.tolist())]

    def weighted(self, x: Array) -> list[tuple[DeflectionTerm, ...]]:
        """Return the terms of every joint with their weights."""
        found = []
        for terms, values in zip(self.terms, self.weights(x), strict=True):
            parts = np.split(values[1:], np.cumsum([term.size for term in terms])[:-1])
            each = zip(terms, parts, strict=False)
            found.append(tuple(replace(term, weights=weights) for term, weights in each))
        return found


class _Fit(NamedTuple):
    """Unknowns (k,): the best, those of no bounds, and the standard errors of these."""

    best: Array
    free: Array
    errors: Array


def identify_elasticity(
    estimate: Any,
    log: Recording | Sequence[Recording],
    rotor_inertia: ArrayLike | None = None,
) -> Elasticity:
    """Identify how far the gears of a robot give way under load, from encoders on both sides.

    Parameters
    ----------
    estimate : Estimate or Identification
        The rigid robot, identified from the motors' encoders. Its links tell the torques through
        the gears.
    log : Recording or sequence of Recording
        With positions of motors and links (`Recording.link_position`). Joints whose two positions
        are the same have one encoder.
    rotor_inertia : float or (n,) array_like, optional
        Inertia of the rotors seen from behind the gears, kg·m² (kg of sliding joints); NaN where it
        is unknown. By default those that were identified; where the motion cannot tell a rotor
        from its link, none, and stiffness is then conditional on that.

    Returns
    -------
    Elasticity
        Stiffness with intervals, the delay between the encoders, and what else was found; it
        predicts positions of links.

    Raises
    ------
    DataError
        When a recording has no positions of links, the robot's base floats, or numbers do not fit.

    Notes
    -----
    Intervals have a level of 95 %, from blocks of time, in which errors may be alike, and from the
    errors of the rigid robot. Where one holds a compliance of zero the stiffness may be infinite:
    none is given. Hysteresis, polynomials of the position and a periodic line of the link's encoder
    are kept only where they lower the error on whole recordings that are left out, so that a
    single recording has none.
    """
    estimate = getattr(estimate, "estimate", estimate)
    if not isinstance(estimate, Estimate):
        raise DataError(
            f"estimate: is {type(estimate).__name__}; give what sdpid.identify or a solver returns."
        )
    robot = estimate.problem.robot
    if robot.n_base:
        raise DataError(
            f"elasticity: the base of '{robot.name}' floats; identify the robot "
            "on a fixed base (Recording.with_held_base)."
        )
    logs = [log] if isinstance(log, Recording) else list(log)
    joints = _measured(robot, logs)
    rotors, conditional = _rotors(estimate, joints, rotor_inertia)
    groups = [runs_of(estimate, each, joints, rotors) for each in logs]
    count = sum(len(run.link) for runs in groups for run in runs)
    fitted = [[_thinned(run, -(-count // _SAMPLES)) for run in runs] for runs in groups]
    model = _chosen(fitted)
    fit, m = _fit(fitted, model), model.places[:-1]
    errors = np.hypot(fit.errors[m], _of_links(estimate, groups, fit.free[m]))
    low, high = fit.free[m] - (reach := student() * errors), fit.free[m] + reach

    def of_all(values: Array) -> Array:
        """Return values of all joints, NaN where there is one encoder only."""
        found = np.full((robot.n, *np.shape(values)[1:]), np.nan)
        found[joints] = values
        return found

    with np.errstate(divide="ignore"):
        inverse = 1.0 / np.stack([fit.best[m], high, low], axis=1)
    stiffness = np.where(low[:, None] > 0.0, inverse, np.nan)
    terms = dict(zip(joints.tolist(), model.weighted(fit.best), strict=True))
    found = Elasticity(
        estimate=estimate,
        delay_s=of_all(model.delays(fit.best)),
        delay_error_s=of_all(model.delays(fit.errors)),
        compliance=of_all(fit.best[m]),
        compliance_error=of_all(errors),
        stiffness=of_all(stiffness[:, 0]),
        interval=of_all(stiffness[:, 1:]),
        rotor_inertia=rotors,
        conditional=conditional,
        terms=tuple(terms.get(j, ()) for j in range(robot.n)),
        rms=np.zeros((len(logs), robot.n)),
    )
    return replace(found, rms=np.array([found.errors(each).std(axis=0) for each in logs]))


def _measured(robot: RobotModel, logs: Sequence[Recording]) -> Indices:
    """Return the joints that have two encoders in all recordings."""
    if not logs:
        raise DataError("elasticity: no recording is given.")
    found = np.ones(robot.n, dtype=bool)
    for number, log in enumerate(logs, start=1):
        matched = match_joints(robot, log)
        if matched.link_position is None:
            raise DataError(
                f"elasticity: recording {number} has no positions of links; give "
                "Recording(link_position=...), or columns called link_position_<joint>."
            )
        found &= two_encoders(matched)
    if not found.any():
        raise DataError(
            "elasticity: no joint has a second encoder: positions of links repeat those of motors, "
            f"or do not follow them (off by {FOLLOWS:g} of the motion or more)."
        )
    return np.flatnonzero(found)


def _rotors(
    estimate: Estimate, joints: Indices, given: ArrayLike | None
) -> tuple[Array, tuple[str, ...]]:
    """Return the rotor inertia of every joint, and the joints whose stiffness depends on it."""
    robot, base, theta = estimate.problem.robot, estimate.problem.base, estimate.some_theta
    values = np.full(robot.n, np.nan)
    if given is not None:
        array = np.asarray(given, dtype=np.float64)
        if array.shape not in ((), (robot.n,)) or (array < 0.0).any() or np.isinf(array).any():
            raise DataError(
                f"rotor_inertia: is {given!r:.80}; give a number that is not negative, or one for "
                f"each of the {robot.n} joints, NaN where it is unknown."
            )
        values = np.broadcast_to(array, (robot.n,)).copy()
    shown = [f"Ia{j + 1}" in base.names for j in range(robot.n)]
    for j in np.flatnonzero(np.isnan(values)).tolist():
        name = f"Ia{j + 1}"
        values[j] = theta[base.theta_names.index(name)] if shown[j] else 0.0
    return values, tuple(robot.joint_names[j] for j in joints.tolist() if not shown[j])


def _thinned(run: Run, stride: int) -> Run:
    """Return every so many samples of a stretch."""
    if stride == 1:
        return run
    late = run.late
    tables: dict[str, Any] = {
        k: getattr(run, k)[::stride] for k in ("link", "difference", "torque")
    }

    def thinned(delay: float) -> tuple[Array, Array]:
        velocity, torque = late(delay)
        return velocity[::stride], torque[::stride]

    return run._replace(**tables, late=thinned)


def _chosen(groups: list[list[Run]]) -> _Model:
    """Return the terms, and delays, that recordings which are left out keep."""
    m = groups[0][0].link.shape[1]
    model = _Model(((),) * m)
    if len(groups) == 1:
        return model
    error = _left_out(groups, model)
    own = model._replace(shared=False)
    if _is_better(other := _left_out(groups, own), error, slice(None)):
        model, error = own, other
    plain, x = model, _fit(groups, model).best
    parts = [_columns(runs, plain, plain.delays(x)) for runs in groups]
    for j in range(m):
        weights = np.r_[plain.delays(x)[j], x[plain.places[j]]]
        left = [signal[:, j] - columns[j] @ weights for columns, signal in parts]
        links = [np.concatenate([run.link[:, j] for run in runs]) for runs in groups]
        torques = [np.concatenate([run.torque[:, j] for run in runs]) for runs in groups]
        for term in candidates(links, torques, left):
            terms = [*model.terms]
            terms[j] = (*terms[j], term)
            richer = model._replace(terms=tuple(terms))
            if _is_better(other := _left_out(groups, richer), error, slice(j, j + 1)):
                model, error = richer, other
    return model


def _is_better(other: Array, error: Array, joints: slice) -> bool:
    """Tell whether errors (R, m) of recordings that are left out fall in all, and enough."""
    a, b = other[:, joints], error[:, joints]
    return bool((a <= b).all() and np.sum(a**2) <= (1.0 - _WORTH) ** 2 * np.sum(b**2))


def _left_out(groups: list[list[Run]], model: _Model) -> Array:
    """Return the error (R, m) on each recording of what was fitted to the others."""
    errors = []
    for k, runs in enumerate(groups):
        x = _fit([*groups[:k], *groups[k + 1 :]], model).best
        columns, signal = _columns(runs, model, model.delays(x))
        parts = zip(columns, model.delays(x), model.weights(x), strict=True)
        known = [each @ np.r_[delay, weights] for each, delay, weights in parts]
        errors.append((signal - np.stack(known, axis=1)).std(axis=0))
    return np.array(errors)


def _columns(runs: list[Run], model: _Model, delays: Array) -> tuple[list[Array], Array]:
    """Return each joint's columns (N, 2 + k) in a recording and the differences (N, m).

    The columns are velocity, torque and those of its terms. Means are taken off: the offset.
    """
    velocity, torque = np.zeros((2, sum(len(run.link) for run in runs), len(delays)))
    for delay in np.unique(delays).tolist():
        own, parts = delays == delay, [run.late(delay) for run in runs]
        velocity[:, own] = np.concatenate([rates for rates, _ in parts])[:, own]
        torque[:, own] = np.concatenate([loads for _, loads in parts])[:, own]
    columns = []
    for j, terms in enumerate(model.terms):
        more = [
            np.concatenate([term.columns(run.link[:, j], run.torque[:, j]) for run in runs])
            for term in terms
        ]
        columns.append(np.column_stack([velocity[:, j], torque[:, j], *more]))
    difference = np.concatenate([run.difference for run in runs])
    return [each - each.mean(axis=0) for each in columns], difference - difference.mean(axis=0)


def _fit(groups: list[list[Run]], model: _Model) -> _Fit:
    """Fit delays, compliances that are not negative, and weights, to recordings."""
    from scipy.optimize import lsq_linear

    m, low, places = len(model.terms), model.least(), model.places
    best, weight = np.zeros(places[-1]), np.ones(m)
    for _ in range(_ROUNDS):
        parts = [_columns(runs, model, model.delays(best)) for runs in groups]
        signal = np.concatenate([each for _, each in parts])
        table = np.zeros((len(signal), m, places[-1]))
        for j, (first, stop) in enumerate(pairwise(places.tolist())):
            columns = np.concatenate([each[j] for each, _ in parts])
            table[:, j, 0 if model.shared else j] = columns[:, 0]
            table[:, j, first:stop] = columns[:, 1:]
        scale = np.sqrt(np.sum(table**2, axis=(0, 1)))
        scale[scale == 0.0] = 1.0
        scaled = (table * weight[:, None] / scale).reshape(-1, places[-1])
        target = (signal * weight).ravel()
        free = np.linalg.lstsq(scaled, target)[0]
        best = free if (free >= low).all() else lsq_linear(scaled, target, (low, np.inf)).x
        missed = (target - scaled @ free).reshape(-1, m)
        best = best / scale
        weight = 1.0 / np.maximum((signal - table @ best).std(axis=0), np.finfo(float).tiny)
    scores = np.einsum("nmk,nm->nk", scaled.reshape(-1, m, places[-1]), missed)
    errors = block_error(scores @ np.linalg.pinv(scaled.T @ scaled))
    return _Fit(best=best, free=free / scale, errors=errors / scale)


def _of_links(estimate: Estimate, groups: list[list[Run]], compliance: Array) -> Array:
    """Return the standard errors (m,) that compliances have from those of the rigid robot."""
    runs = [run for each in groups for run in each]
    power = np.sum([np.sum((r.torque - r.torque.mean(axis=0)) ** 2, axis=0) for r in runs], axis=0)
    moved = -compliance[:, None] * np.sum([run.slopes for run in runs], axis=0) / power[:, None]
    return np.sqrt(np.diag(Posterior.of(estimate).covariance(moved)))
