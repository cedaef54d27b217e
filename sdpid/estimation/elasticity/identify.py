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

from sdpid._common.arrays import Array, Indices, Mask
from sdpid.errors import DataError
from sdpid.estimation.elasticity.result import Elasticity, student
from sdpid.estimation.elasticity.signals import Run, pieces_of, runs_of
from sdpid.estimation.elasticity.terms import DeflectionTerm, candidates
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.posterior import Posterior
from sdpid.experiment.inspection.block_fit import BLOCKS
from sdpid.experiment.preparation.prepare import Logs, read_logs
from sdpid.experiment.recording.joints import FOLLOWS, two_encoders
from sdpid.experiment.recording.plausible import moving
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.model.model import RobotModel

# A further term, or a delay for every joint, lowers the error on recordings that are left out by
# this share, on none of them raises it.
_WORTH = 0.02
# An error that is higher by less is no higher: joints that keep their delay have another fit of it.
_CHANCE = 0.002
# Rounds in which weights and delays settle.
_ROUNDS = 4
# Samples that a fit takes; of more, which are alike, some are left out.
_SAMPLES = 60_000
# Samples that every recording has at least: ten a block of time.
_LEAST_ROWS = 10 * BLOCKS
# A joint whose differences are explained better than by this share is not more exact.
_EXACT = 1e-4


class _Model(NamedTuple):
    """What is fitted: terms of every joint, whether they share a delay, and a gear taken as rigid.

    The unknowns are the delays, then of every joint its compliance and the weights of its terms.
    """

    terms: tuple[tuple[DeflectionTerm, ...], ...]
    shared: bool = True
    stiff: int | None = None

    @property
    def places(self) -> Indices:
        """Places of the compliances among the unknowns, and their number last, (m + 1,)."""
        delays = 1 if self.shared else len(self.terms)
        counts = [1 + sum(term.size for term in terms) for terms in self.terms]
        return np.cumsum([delays, *counts])

    def least(self) -> Array:
        """Return the least value of every unknown: 0 or none."""
        own = [[0.0, *(t.least for t in terms for _ in range(t.size))] for terms in self.terms]
        return np.concatenate([np.full(self.places[0], -np.inf), *own])

    def delays(self, x: Array) -> Array:
        """Return the delay of every joint, (m,), of the unknowns."""
        return np.broadcast_to(x[: self.places[0]], (len(self.terms),))

    def split(self, x: Array) -> list[Array]:
        """Return each joint's delay, compliance and weights."""
        delays = self.delays(x).tolist()
        return [
            np.r_[delay, x[a:b]]
            for delay, (a, b) in zip(delays, pairwise(self.places), strict=True)
        ]

    def within(self, groups: list[list[Run]]) -> _Model:
        """Return the model with terms of the position on the range of these recordings."""
        links = [run.link for runs in groups for run in runs]
        each = enumerate(self.terms)
        terms = [tuple(term.within([q[:, j] for q in links]) for term in own) for j, own in each]
        return self._replace(terms=tuple(terms))

    def weighted(self, x: Array) -> list[tuple[DeflectionTerm, ...]]:
        """Return the terms of every joint with their weights."""
        found = []
        for terms, values in zip(self.terms, self.split(x), strict=True):
            parts = np.split(values[2:], np.cumsum([term.size for term in terms])[:-1])
            each = zip(terms, parts, strict=False)
            found.append(tuple(replace(term, weights=weights) for term, weights in each))
        return found


class _Solution(NamedTuple):
    """Unknowns (k,) within their bounds and without bounds, their scale, and joints' weighted rows.

    `places` are those of a joint's unknowns among all.
    """

    best: Array
    free: Array
    scale: Array
    rows: list[Array]
    places: list[Indices]

    def errors(self) -> tuple[Array, Array]:
        """Return standard errors of the unknowns without bounds, and degrees of freedom, (k,) each.

        Degrees of freedom count the blocks of time, less one, by Satterthwaite's formula: some
        blocks tell more than others.
        """
        # How far the unknowns move without each block of time, in which errors may be alike.
        size = len(self.scale)
        power, scores = np.zeros((BLOCKS, size, size)), np.zeros((BLOCKS, size))
        for unknowns, table in zip(self.places, self.rows, strict=True):
            missed = table[:, -1] - table[:, :-1] @ self.free[unknowns]
            columns = np.array_split(table[:, :-1] / self.scale[unknowns], BLOCKS)
            blocks = zip(columns, np.array_split(missed, BLOCKS), strict=True)
            for k, (own, left) in enumerate(blocks):
                power[k][np.ix_(unknowns, unknowns)] += own.T @ own
                scores[k, unknowns] += own.T @ left
        whole = power.sum(axis=0)
        inverse = np.linalg.pinv(whole, hermitian=True)
        told = np.einsum("ki,bij,jk->bk", inverse, power, inverse)
        freedom = np.maximum(told.sum(axis=0) ** 2 / np.sum(told**2, axis=0) - 1.0, 1.0)
        rest = whole - power
        moved = np.einsum("bij,bj->bi", np.linalg.pinv(rest, hermitian=True), scores)
        errors = np.sqrt((1.0 - 1.0 / BLOCKS) * np.sum(moved**2, axis=0)) / self.scale
        # Few blocks may tell too little by chance: less than errors that have nothing in common.
        return np.maximum(errors, np.sqrt(np.diag(inverse)) / self.scale), freedom


def identify_elasticity(
    estimate: Any,
    log: Logs,
    rotor_inertia: ArrayLike | None = None,
) -> Elasticity:
    """Identify how far the gears of a robot give way under load, from encoders on both sides.

    Parameters
    ----------
    estimate : Estimate or Identification
        The rigid robot, identified from the motors' encoders. Its links tell the torques through
        the gears.
    log : Recording, path or data frame, or a sequence of these
        With positions of motors and links (`Recording.link_position`). Joints whose two positions
        are the same in any recording in which they move have one encoder.
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
    none is given, nor where recordings that are left out are explained as well without it.
    Hysteresis, polynomials of the position and a periodic line of the link's encoder are kept only
    where they lower the error on whole recordings that are left out, so that a single recording has
    none. Outside of the positions that it was fitted to, a polynomial stays as at their end.

    Examples
    --------
    >>> from dataclasses import replace
    >>> links = log.position - 1e-6 * log.effort  # as if gears gave way
    >>> found = sdpid.identify_elasticity(result, replace(log, link_position=links))
    >>> print(f"{found.stiffness[1]:.0e}")
    1e+06
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
    _, logs = read_logs(robot, log)
    joints = _measured(robot, logs)
    rotors, shown, identified = _rotors(estimate, rotor_inertia)
    stride = -(-sum(each.n_samples for each in logs) // _SAMPLES)
    groups = [runs_of(estimate, each, joints, rotors, stride) for each in logs]
    least = min(sum(len(run.link) for run in runs) for runs in groups)
    if least < _LEAST_ROWS:
        raise DataError(
            f"elasticity: a recording has {least} samples, in stretches without gaps; at least "
            f"{_LEAST_ROWS} are needed to tell errors from elasticity."
        )
    model = _chosen(groups)
    fit, m = _fit(groups, model), model.places[:-1]
    spread, freedom = fit.errors()
    errors = np.hypot(spread[m], _of_links(estimate, groups, fit.free[m], joints, identified))
    low, high = fit.free[m] - (reach := student(freedom[m]) * errors), fit.free[m] + reach
    firm = (low > 0.0) & _confirmed(groups, model, model.delays(fit.best))

    def of_all(values: Array) -> Array:
        """Return values of all joints, NaN where there is one encoder only."""
        found = np.full((robot.n, *np.shape(values)[1:]), np.nan)
        found[joints] = values
        return found

    with np.errstate(divide="ignore"):
        inverse = 1.0 / np.stack([fit.best[m], high, low], axis=1)
    stiffness = np.where(firm[:, None], inverse, np.nan)
    terms = dict(zip(joints.tolist(), model.weighted(fit.best), strict=True))
    found = Elasticity(
        estimate=estimate,
        delay_s=of_all(model.delays(fit.best)),
        delay_error_s=of_all(model.delays(spread)),
        compliance=of_all(fit.best[m]),
        compliance_error=of_all(errors),
        stiffness=of_all(stiffness[:, 0]),
        interval=of_all(stiffness[:, 1:]),
        rotor_inertia=rotors,
        conditional=tuple(robot.joint_names[j] for j in joints.tolist() if not shown[j]),
        terms=tuple(terms.get(j, ()) for j in range(robot.n)),
        rms=np.zeros((len(logs), robot.n)),
        curves={},
    )
    rms = np.array([found.errors(each).std(axis=0) for each in logs])
    rms[:, np.isnan(found.compliance)] = np.nan
    return replace(found.with_curves(logs[0]), rms=rms)


def _measured(robot: RobotModel, logs: Sequence[Recording]) -> Indices:
    """Return the joints that have two encoders in all recordings in which they move."""
    told, lost = np.zeros(robot.n, dtype=bool), np.zeros(robot.n, dtype=bool)
    for number, log in enumerate(logs, start=1):
        if log.link_position is None:
            raise DataError(
                f"elasticity: recording {number} has no positions of links; give "
                "Recording(link_position=...), or columns called link_position_<joint>."
            )
        longest = max(pieces_of(robot, log), key=lambda piece: piece.n_samples)
        both = two_encoders(longest)
        told |= both
        lost |= ~both & moving(*longest.position_range)
    found = told & ~lost
    if not found.any():
        raise DataError(
            "elasticity: no joint has a second encoder: positions of links repeat those of motors, "
            f"or do not follow them (off by {FOLLOWS:g} of the motion or more)."
        )
    return np.flatnonzero(found)


def _rotors(estimate: Estimate, given: ArrayLike | None) -> tuple[Array, Mask, Mask]:
    """Return every joint's rotor inertia, where the motion shows it, and where that is taken."""
    robot, base, theta = estimate.problem.robot, estimate.problem.base, estimate.some_theta
    values = np.full(robot.n, np.nan)
    if given is not None:
        try:
            array = np.asarray(given, dtype=np.float64)
        except (TypeError, ValueError):
            array = np.full(0, np.nan)
        if array.shape not in ((), (robot.n,)) or (array < 0.0).any() or np.isinf(array).any():
            raise DataError(
                f"rotor_inertia: is {given!r:.80}; give a number that is not negative, or one for "
                f"each of the {robot.n} joints, NaN where it is unknown."
            )
        values = np.broadcast_to(array, (robot.n,)).copy()
    shown = np.array([f"Ia{j + 1}" in base.names for j in range(robot.n)])
    unknown = np.isnan(values)
    for j in np.flatnonzero(unknown).tolist():
        values[j] = theta[base.theta_names.index(f"Ia{j + 1}")] if shown[j] else 0.0
    return values, shown, shown & unknown


def _chosen(groups: list[list[Run]]) -> _Model:
    """Return the terms, and delays, that recordings which are left out keep."""
    m = groups[0][0].link.shape[1]
    model = _Model(((),) * m)
    if len(groups) == 1:
        return model
    own = model._replace(shared=False)
    if _is_better(_left_out(groups, own), _left_out(groups, model)):
        model = own
    x = _fit(groups, model).best
    delays, plain = model.delays(x), model.split(x)
    tables = [_tables([runs], model, delays) for runs in groups]
    error = _left_out(groups, model, delays)
    for j in range(m):
        for term in candidates(
            [np.concatenate([run.link[:, j] for run in runs]) for runs in groups],
            [np.concatenate([run.torque[:, j] for run in runs]) for runs in groups],
            [each[j][:, -1] - each[j][:, :-1] @ plain[j] for each in tables],
        ):
            terms = (*model.terms[:j], (*model.terms[j], term), *model.terms[j + 1 :])
            other = _left_out(groups, richer := model._replace(terms=terms), delays)
            if _is_better(other[:, j], error[:, j]):
                model, error = richer, other
    return model


def _confirmed(groups: list[list[Run]], model: _Model, delays: Array) -> Mask:
    """Return which joints' compliances (m,) recordings that are left out confirm."""
    joints = range(len(model.terms))
    if len(groups) == 1:
        return np.ones(len(joints), dtype=bool)
    error = _left_out(groups, model, delays)
    stiff = [_left_out(groups, model._replace(stiff=j), delays) for j in joints]
    return np.array([_is_better(error[:, j], stiff[j][:, j]) for j in joints])


def _is_better(other: Array, error: Array) -> bool:
    """Tell whether errors (R, ...) of recordings that are left out fall in all, and enough."""
    enough = np.sum(other**2) <= (1.0 - _WORTH) ** 2 * np.sum(error**2)
    return bool((other <= (1.0 + _CHANCE) * error).all() and enough)


def _left_out(groups: list[list[Run]], model: _Model, delays: Array | None = None) -> Array:
    """Return the error (R, m) on each recording of what was fitted to the others."""
    errors = []
    for k, runs in enumerate(groups):
        kept = [*groups[:k], *groups[k + 1 :]]
        fitted = model.within(kept)
        x = _fit(kept, fitted, delays).best
        tables = _tables([runs], fitted, fitted.delays(x))
        errors.append(_missed(tables, fitted.split(x)).std(axis=0))
    return np.array(errors)


def _tables(groups: list[list[Run]], model: _Model, delays: Array) -> list[Array]:
    """Return every joint's velocity, torque, columns of terms and differences, (N, 3 + k).

    The means of each recording are taken off: the offsets.
    """
    found: list[list[Array]] = [[] for _ in model.terms]
    for runs in groups:
        late = [(run, *run.late(delays)) for run in runs]
        for j, terms in enumerate(model.terms):
            parts = []
            for run, velocity, torque in late:
                more = [term.columns(run.link[:, j], torque[:, j]) for term in terms]
                load = np.zeros_like(torque[:, j]) if j == model.stiff else torque[:, j]
                columns = (velocity[:, j], load, *more, run.difference[:, j])
                parts.append(np.column_stack(columns))
            table = np.concatenate(parts)
            found[j].append(table - table.mean(axis=0))
    return [np.concatenate(own) for own in found]


def _missed(tables: list[Array], weights: list[Array]) -> Array:
    """Return what weights of the columns leave of the differences, (N, m)."""
    each = zip(tables, weights, strict=True)
    return np.stack([table[:, -1] - table[:, :-1] @ x for table, x in each], axis=1)


def _least(A: Array, y: Array, low: Array) -> tuple[Array, Array, Array]:
    """Return the best weights of columns that are not below others, the best of all, and sizes."""
    from scipy.optimize import lsq_linear

    scale = np.linalg.norm(A, axis=0)
    scale[scale == 0.0] = 1.0
    free = np.linalg.lstsq(A / scale, y)[0]
    best = free
    if (free < low).any():
        best = lsq_linear(A / scale, y, (low, np.inf)).x
    return best / scale, free / scale, scale


def _fit(groups: list[list[Run]], model: _Model, delays: Array | None = None) -> _Solution:
    """Fit delays, compliances that are not negative, and weights, to recordings.

    Delays that are nearly right take fewer rounds.
    """
    m, low, places = len(model.terms), model.least(), model.places
    rounds, delays = (_ROUNDS, np.zeros(m)) if delays is None else (_ROUNDS // 2, delays)
    weight = np.ones(m)
    of = [np.r_[0 if model.shared else j, range(*ends)] for j, ends in enumerate(pairwise(places))]
    for _ in range(rounds):
        tables, parts, used = _tables(groups, model, delays), [], weight
        # As good as the rows, of which a joint's touch its own unknowns only.
        for unknowns, table, w in zip(of, tables, weight.tolist(), strict=True):
            small = w * np.asarray(np.linalg.qr(table, mode="r"))
            parts.append(np.zeros((len(small), places[-1] + 1)))
            parts[-1][:, [*unknowns, -1]] = small
        system = np.concatenate(parts)
        best, free, scale = _least(system[:, :-1], system[:, -1], low)
        delays = model.delays(best)
        sizes = np.array([table[:, -1].std() for table in tables])
        left = _missed(tables, model.split(best)).std(axis=0)
        weight = 1.0 / np.maximum(left, _EXACT * sizes)
    rows = [w * table for w, table in zip(used.tolist(), tables, strict=True)]
    return _Solution(best=best, free=free, scale=scale, rows=rows, places=of)


def _of_links(
    estimate: Estimate,
    groups: list[list[Run]],
    compliance: Array,
    joints: Indices,
    identified: Mask,
) -> Array:
    """Return the standard errors (m,) that compliances have from those of the rigid robot.

    Torques do not depend on rotor inertias that were identified, and are then taken off.
    """
    runs, names = [run for each in groups for run in each], estimate.problem.base.theta_names
    power = np.sum([np.sum((r.torque - r.torque.mean(axis=0)) ** 2, axis=0) for r in runs], axis=0)
    moved = -compliance[:, None] * np.sum([run.slopes for run in runs], axis=0) / power[:, None]
    for k, j in enumerate(joints.tolist()):
        if identified[j]:
            moved[k, names.index(f"Ia{j + 1}")] = 0.0
    return np.sqrt(np.diag(Posterior.of(estimate).covariance(moved)))
