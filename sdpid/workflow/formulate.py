"""Build the problem that `identify` solves, with its defaults, and fit it again.

Again: friction alone to another log, and all of it without blocks of time that are held out.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen
from sdpid._common.progress import progress
from sdpid._common.tables import Shown, Table, plain_dict
from sdpid.assurance.diagnostics.rest import moving_rows
from sdpid.assurance.diagnostics.validation import Errors, validate
from sdpid.errors import DataError, IdentifiabilityError
from sdpid.estimation.compression.covariance import PRINTED, Weighting
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.constraints.equalities import Fixed
from sdpid.estimation.constraints.mass import known_mass
from sdpid.estimation.effects.kinds import Effects, names_of_effects
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.prior.prior import Prior
from sdpid.estimation.problem import Problem, build_problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.estimation.selection.choose import with_chosen_effects, with_effects
from sdpid.estimation.wls import solve_wls
from sdpid.experiment.drive_gains.gains import DriveGains
from sdpid.experiment.preparation.prepare import (
    Logs,
    Prepared,
    ProcessingOf,
    friction_of,
    joints_without,
    prepare,
    read_logs,
)
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.friction.position import Spring
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.inertia import Consistency
from sdpid.robot.model.model import RobotModel

By = Literal["time", "recording"]

# Units of parameters that belong to the rigid part beside the links: rotors and gravity's
# direction. Everything else of a joint changes with temperature, wear and zero errors.
_RIGID_UNITS = ("kg.m2", "rad")


@dataclass(frozen=True, kw_only=True)
class Formulation:
    """What is asked of the problem that `identify` solves, checked; arguments are those of it."""

    friction: Iterable[str | FrictionTerm] | None = None
    weighting: Weighting | None = None
    consistency: Consistency = "pseudo_inertia"
    constraints: Constraints | None = None
    prior: Prior | bool | None = None
    effects: Effects = "auto"

    def __post_init__(self) -> None:
        """Refuse what is of another kind; terms and effects become tuples."""
        constraints, prior, friction = self.constraints, self.prior, self.friction
        if constraints is not None and not isinstance(constraints, Constraints):
            raise DataError(f"constraints: is {constraints!r:.80}; give sdpid.Constraints(...).")
        if prior is not None and not isinstance(prior, (bool, np.bool_, Prior)):
            raise DataError(f"prior: is {prior!r:.80}; give True, False or a Prior.")
        if isinstance(friction, (str, FrictionTerm)):
            raise DataError(f"friction: is {friction!r}; give a tuple of terms, ({friction!r},).")
        if friction is not None and not isinstance(friction, Iterable):
            raise DataError(
                f"friction: is {friction!r}; give a tuple of terms, such as ('coulomb', 'viscous')."
            )
        asked = names_of_effects(self.effects)
        object.__setattr__(self, "friction", None if friction is None else tuple(friction))
        object.__setattr__(self, "effects", "auto" if asked is None else asked)

    def prepare(
        self, robot: RobotModel | str | os.PathLike[str], log: Logs, **how: Any
    ) -> Prepared:
        """Prepare recordings of a robot that weighs what the constraints say."""
        mass = None if self.constraints is None else known_mass(self.constraints.others)
        return prepare(robot, log, total_mass=mass, terms=self.friction or (), **how)

    def without_choices(self, problem: Problem) -> Formulation:
        """Return the same with the terms that were chosen for a problem, and no more."""
        return replace(self, friction=problem.friction.terms, effects="none")

    def problem(self, prepared: Prepared) -> Problem:
        """Build the problem of prepared recordings, with what follows from them."""
        robot, samples, prior = prepared.robot, prepared.samples, self.prior
        weighting = self.weighting or ("residual" if samples.covariance is None else "gls")
        if prior is None:
            # Friction of a joint without effort is known from a prior or not at all.
            lacks = weighting == "gls" and bool(prepared.without_effort)
            prior = (weighting == "residual" or lacks) and bool(np.any(robot.prior[:, 0] > 0.0))
        if isinstance(prior, (bool, np.bool_)):
            prior = Prior() if prior else None
        given = friction_of(prepared.logs[0], self.friction)
        anew = {each.joint for each in given if isinstance(each, Spring)}
        given += tuple(each for each in robot.springs if getattr(each, "joint", None) not in anew)

        def build(terms: tuple[str | FrictionTerm, ...]) -> Problem:
            return build_problem(
                robot,
                samples,
                friction=terms,
                weighting=weighting,
                consistency=self.consistency,
                constraints=self.constraints or Constraints.of_size(robot),
                prior=prior,
            )

        problem = build(given)
        if (asked := names_of_effects(self.effects)) is not None:
            return with_effects(problem, given, asked, build)
        if weighting in PRINTED:
            # No likelihood: a fall of it is no evidence.
            return problem
        return with_chosen_effects(problem, given, prior, build)


def formulate(
    robot: RobotModel | str | os.PathLike[str],
    log: Logs | Prepared,
    *,
    processing: ProcessingOf = None,
    without_effort: Iterable[str] = (),
    accept: str | Iterable[str] = (),
    gains: DriveGains | str | os.PathLike[str] | ArrayLike | None = None,
    **options: Any,
) -> Problem:
    """Build the problem that `identify` solves; arguments and errors are those of `identify`.

    `log` may also be recordings that are prepared already (see `prepare`), which know their robot;
    other options are those of `Formulation`.
    """
    formulation = Formulation(**options)
    if not isinstance(log, Prepared):
        how = {"without_effort": without_effort, "accept": accept, "gains": gains}
        log = formulation.prepare(robot, log, processing=processing, **how)
    return formulation.problem(log)


def adapt(
    estimate: Estimate,
    log: Logs,
    *,
    processing: ProcessingOf = None,
    without_effort: Iterable[str] = (),
    accept: str | Iterable[str] = (),
) -> Estimate:
    """Refit friction and offsets alone to a new recording.

    Friction changes with temperature, load and wear, and sensors' zeros drift, where links do not:
    on recorded robots friction fitted anew halves the error on another day's recording. The
    parameters of the links, rotor inertias and gravity's direction stay exactly as they are; so do
    the shapes of the friction terms. All others are fitted again, with the usual weak belief that
    friction is small.

    Parameters
    ----------
    estimate : Estimate
        With standard parameters, such as those of `solve_sdp`.
    log : Recording or path, or a sequence of these
        What was measured on the same robot.
    processing : Processing or mapping, optional
        As for `identify`.
    without_effort : iterable of str, optional
        As for `identify`; the friction of these joints is the believed one, which is none.
    accept : str or iterable of str, optional
        As for `identify`: kinds of findings that do not refuse a recording.

    Returns
    -------
    Estimate
        The optimum over friction and offsets, of a problem that can be certified.

    Raises
    ------
    DataError
        When the estimate has no standard parameters or breaks its own constraints, or the
        recording cannot be used.
    SolverError
        When the program ends without an optimum.

    Examples
    --------
    >>> warm = sdpid.adapt(estimate, log)  # log: a run on another day
    >>> warm.status
    'optimal'
    >>> bool(np.array_equal(warm.theta[:60], estimate.theta[:60]))  # the links are the same
    True
    """
    old = estimate.problem
    if estimate.theta is None:
        raise DataError(
            f"adapt: the estimate ({estimate.method}) has no standard parameters to keep; give one "
            "of solve_sdp."
        )
    if not estimate.feasible:
        raise DataError(
            f"adapt: the estimate ({estimate.method}) breaks its constraints by "
            f"{estimate.violation:.1e}; give one of solve_sdp."
        )
    links = 10 * old.robot.n_links
    units = np.array(old.base.theta_units)
    rigid = np.isin(units, _RIGID_UNITS)
    rigid[:links] = True
    kept = {old.base.theta_names[i]: float(estimate.theta[i]) for i in np.flatnonzero(rigid)}
    constraints = old.constraints.replace(others=(*old.constraints.others, Fixed(kept)))
    formulation = Formulation(
        friction=old.friction.terms,
        consistency=old.consistency,
        constraints=constraints,
        prior=Prior(bodies=estimate.theta[:links].reshape(-1, 10)),
        effects="none",
    )
    prepared = prepare(old.robot, log, processing, without_effort=without_effort, accept=accept)
    problem = formulation.problem(prepared)
    found = solve_sdp(problem)
    assert found.theta is not None
    # Equations hold up to rounding; what was not fitted again is the same number.
    theta = np.where(rigid, estimate.theta, found.theta)
    return replace(found, theta=frozen(theta), base=frozen(problem.base_of(theta)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Fold:
    """One fit, and its prediction of what was held out.

    Attributes
    ----------
    name : str
        What was held out, in words.
    processing : Processing
        Processing of all recordings of the fold; chosen from the training part alone.
    training : float
        Relative residual on the training rows in motion.
    held_out : Errors
        Errors of the estimate on what was held out, in motion; all, if nothing moves.
    unconstrained : Errors
        The same of the unconstrained fit.
    power : float
        Sum of the squared efforts of these rows, (N·m)².
    """

    name: str
    processing: Processing
    training: float
    held_out: Errors
    unconstrained: Errors
    power: float


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class CrossValidation(Shown):
    """The errors of several fits, each on what was held out from it.

    Attributes
    ----------
    by : {"time", "recording"}
        What is held out in each fold: a block of time, or a recording.
    folds : tuple of Fold
        The fits.
    joint_names : tuple of str
        The joints.
    rmse, rmse_unconstrained : ndarray, shape (n,)
        Root mean square errors over all held-out rows in motion, N·m, of the estimates and of the
        unconstrained fits.
    relative, relative_unconstrained : float
        Norm of all held-out errors in motion over the norm of the efforts.

    Examples
    --------
    >>> run = sdpid.Recording(time=log.time, position=log.position, effort=log.effort)
    >>> held_out = sdpid.cross_validate(robot, run, folds=2, effects="none")
    >>> held_out.relatives.round(3), held_out.rmse.round(1)
    (array([0.001, 0.002]), array([0.3, 0.3, 0.3, 0.1, 0.1, 0.1]))
    """

    by: By
    folds: tuple[Fold, ...]
    joint_names: tuple[str, ...]
    rmse: Array
    rmse_unconstrained: Array
    relative: float
    relative_unconstrained: float

    _facts = ("summary",)

    def _tables(self) -> Iterator[Table]:
        yield self.as_table()

    @property
    def count(self) -> int:
        """Number of folds."""
        return len(self.folds)

    @property
    def relatives(self) -> Array:
        """Relative residual on the held-out rows in motion of each fold, (folds,)."""
        return np.array([fold.held_out.relative for fold in self.folds])

    @property
    def spread(self) -> float:
        """Standard deviation of the folds' relative residuals."""
        return float(np.std(self.relatives, ddof=1))

    @property
    def training(self) -> float:
        """Mean of the folds' relative residuals on their training rows in motion."""
        return float(np.mean([fold.training for fold in self.folds]))

    def summary(self) -> str:
        """Return the result in a sentence."""
        what = "blocks of time" if self.by == "time" else "recordings"
        low, high = float(self.relatives.min()), float(self.relatives.max())
        return (
            f"{self.count} {what} held out in turn: relative residual in motion "
            f"{100 * self.relative:.2f} % ({100 * low:.2f} to {100 * high:.2f} %, unconstrained "
            f"{100 * self.relative_unconstrained:.2f} %)"
        )

    def table(self) -> str:
        """Return `as_table` as aligned text under a title."""
        title = "held out in turn, in motion: relative residuals in %, RMSE of every joint in N.m"
        return f"{title}\n{self.as_table().text(3)}"

    def as_table(self) -> Table:
        """Return a row a fold and one for all: relative residuals in %, RMSE of joints in N·m."""
        header = ("held out", "rows", "trained", "held out", "unconstrained", *self.joint_names)
        rows = [
            (
                fold.name,
                int(fold.held_out.rows.sum()),
                100.0 * fold.training,
                100.0 * fold.held_out.relative,
                100.0 * fold.unconstrained.relative,
                *fold.held_out.rmse[fold.held_out.n_base :].tolist(),
            )
            for fold in self.folds
        ]
        shares = (self.training, self.relative, self.relative_unconstrained)
        total = ("all", sum(row[1] for row in rows), *(100.0 * share for share in shares))
        return Table(header, (*rows, (*total, *self.rmse.tolist())))

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        content = {
            "by": self.by,
            "relative_residual": self.relative,
            "relative_residual_unconstrained": self.relative_unconstrained,
            "spread": self.spread,
            "training": self.training,
            "rmse": dict(zip(self.joint_names, self.rmse, strict=True)),
            "rmse_unconstrained": dict(zip(self.joint_names, self.rmse_unconstrained, strict=True)),
            "folds": [
                {
                    "held_out": fold.name,
                    "cutoff_hz": fold.processing.cutoff_hz,
                    "training": fold.training,
                    "unconstrained": fold.unconstrained.relative,
                    **fold.held_out.to_dict(),
                }
                for fold in self.folds
            ],
        }
        return plain_dict(content)


def cross_validate(
    robot: RobotModel | str | os.PathLike[str],
    log: Logs,
    *,
    folds: int = 5,
    by: By = "time",
    processing: ProcessingOf = None,
    without_effort: Iterable[str] = (),
    scored: Processing | None = None,
    friction: Iterable[str | FrictionTerm] | None = None,
    weighting: Weighting | None = None,
    consistency: Consistency = "pseudo_inertia",
    constraints: Constraints | None = None,
    prior: Prior | bool | None = None,
    effects: Effects = "auto",
) -> CrossValidation:
    """Hold out blocks of time or recordings in turn, and predict each by a fit to the rest.

    Each fit starts from the raw recordings, as in `identify`, so no sample of a block influences
    the samples, the processing, the friction speeds, the weights or the prior of the fit that
    predicts it. Training and held-out rows lie twice the memory of the filter apart.

    Parameters
    ----------
    robot : RobotModel, name or path
        The robot.
    log : Recording or path, or a sequence of these
        The recordings, without periods: a record with periods repeats one motion, so that its
        blocks do not test each other.
    folds : int, optional
        Number of blocks. Every recording is cut into this number, and the blocks with the same
        index are held out together.
    by : {"time", "recording"}, optional
        ``"recording"`` holds out one recording at a time (`folds` is then not used).
    processing : Processing or mapping, optional
        By default it is chosen from the training part of each fold, as in `identify`; a mapping
        changes some of its settings.
    without_effort : iterable of str, optional
        As in `identify`.
    scored : Processing, optional
        Processing of what is held out; by default that of the training part.
    friction, weighting, consistency, constraints, prior, effects : optional
        As in `identify`; effects by the data are chosen anew for every fit.

    Returns
    -------
    CrossValidation
        Errors of every fit on what was held out from it.

    Raises
    ------
    SdpidError
        A child, as in `identify`, that names the fold; a `DataError` when parts are too short.

    Examples
    --------
    >>> run = sdpid.Recording(time=log.time, position=log.position, effort=log.effort)
    >>> held_out = sdpid.cross_validate(robot, run, folds=2, effects="none")
    >>> held_out.count, held_out.rmse.round(1)
    (2, array([0.3, 0.3, 0.3, 0.1, 0.1, 0.1]))
    >>> print(held_out.summary())
    2 blocks of time held out in turn: relative residual in motion 0.15 % (...)
    """
    formulation = Formulation(
        friction=friction,
        weighting=weighting,
        consistency=consistency,
        constraints=constraints,
        prior=prior,
        effects=effects,
    )
    without_effort = joints_without(without_effort)
    model, logs = read_logs(robot, log, without_effort=without_effort)
    parts = list(_parts(logs, folds, by))
    fits: list[Fold] = []
    with progress(len(parts), "cross-validation") as advance:
        for name, kept, out in parts:
            try:
                prepared = prepare(model, kept, processing, without_effort=without_effort)
                fresh = prepared.others(out, scored).samples
                problem = formulation.problem(prepared)
            except (DataError, IdentifiabilityError) as reason:
                advice = " Use fewer folds, or longer recordings." if by == "time" else ""
                raise type(reason)(f"cross-validation without {name}: {reason}{advice}") from None
            estimate = solve_sdp(problem)
            whole = validate(estimate, fresh)
            # The rows whose errors are told.
            moving = whole.told is whole.moving
            told = moving_rows(fresh, whole.slides) if moving else fresh.used
            fold = Fold(
                name=name,
                processing=prepared.processing,
                training=validate(estimate).told.relative,
                held_out=whole.told,
                unconstrained=validate(solve_wls(replace(problem, prior=None)), fresh).told,
                power=float(np.sum(np.where(told, fresh.effort, 0.0)[:, whole.n_base :] ** 2)),
            )
            fits.append(fold)
            advance(1)
    joints = slice(model.n_base, None)
    rows = np.maximum(np.sum([fold.held_out.rows for fold in fits], axis=0), 1)
    power = max(sum(fold.power for fold in fits), np.finfo(float).tiny)
    squares = [
        np.sum([each.rows * each.rmse**2 for each in errors], axis=0)
        for errors in zip(*((fold.held_out, fold.unconstrained) for fold in fits), strict=True)
    ]
    rmse, rmse_unconstrained = (frozen(np.sqrt(each / rows)[joints]) for each in squares)
    relative, relative_unconstrained = (float(np.sqrt(each.sum() / power)) for each in squares)
    return CrossValidation(
        by=by,
        folds=tuple(fits),
        joint_names=model.joint_names[joints],
        rmse=rmse,
        rmse_unconstrained=rmse_unconstrained,
        relative=relative,
        relative_unconstrained=relative_unconstrained,
    )


def _parts(
    logs: Sequence[Recording], folds: int, by: By
) -> Iterator[tuple[str, list[Recording], list[Recording]]]:
    """Yield the name, the training part and the held-out part of every fold."""
    if by == "recording":
        if len(logs) < 2:
            raise DataError("cross-validation by='recording': needs at least two recordings.")
        for i, log in enumerate(logs):
            yield f"recording {i + 1}", [*logs[:i], *logs[i + 1 :]], [log]
        return
    if by != "time":
        raise DataError(f"cross-validation: by is {by!r}; use 'time' or 'recording'.")
    if isinstance(folds, bool) or int(folds) != folds or folds < 2:
        raise DataError(f"cross-validation: folds is {folds}; use a whole number of at least 2.")
    if any(log.period is not None for log in logs):
        raise DataError(
            "cross-validation: a record with periods repeats one motion, and its blocks are not "
            "fresh to each other; give several recordings with by='recording', or leave the "
            "period out (period=None)."
        )
    folds = int(folds)
    shortest = min(log.n_samples for log in logs)
    if folds > shortest // 2:
        raise DataError(
            f"cross-validation: a recording of {shortest} samples is too short for {folds} blocks; "
            "use fewer folds."
        )
    for k in range(folds):
        kept: list[Recording] = []
        out: list[Recording] = []
        for log in logs:
            first, last = (round(log.n_samples * i / folds) for i in (k, k + 1))
            for part, a, b in ((kept, 0, first), (out, first, last), (kept, last, log.n_samples)):
                if b > a:
                    part.append(log.rows(slice(a, b)))
        yield f"block {k + 1} of {folds}", kept, out
