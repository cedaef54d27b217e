"""Identify a robot from recordings, with defaults for every choice."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any, get_args

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.progress import progress
from sdpid._common.threads import one_thread
from sdpid.assurance.certificate.certificate import certify
from sdpid.assurance.diagnostics.active_constraints import constraint_states
from sdpid.assurance.diagnostics.held_out import LEAST_SQUARES, Remedy, hold_out
from sdpid.assurance.diagnostics.provenance import collinear_friction, hidden_terms, in_words
from sdpid.assurance.diagnostics.validation import Errors, validate
from sdpid.assurance.intervals.intervals import Intervals, Method, confidence_intervals
from sdpid.assurance.recipe.inputs import input_files
from sdpid.assurance.recipe.recipe import recipe_or_reason
from sdpid.errors import DataError, IdentifiabilityError, SdpidError, SolverError
from sdpid.estimation.closed_loop.bias import BiasTest, check_bias
from sdpid.estimation.compression.covariance import PRINTED, Weighting
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.effects.kinds import Effects
from sdpid.estimation.elasticity.identify import identify_elasticity
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.motion_noise import landings_used, with_motion_bias
from sdpid.estimation.positions.law_fit import Target, first_law, fit_law
from sdpid.estimation.prior.prior import Prior
from sdpid.estimation.problem import Problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.estimation.wls import solve_wls
from sdpid.experiment.drive_gains.gains import DriveGains
from sdpid.experiment.inspection.inspect import kinds_accepted
from sdpid.experiment.inspection.kinds import Finding, found
from sdpid.experiment.preparation.prepare import Logs, Prepared, ProcessingOf, read_logs
from sdpid.experiment.readers.mapping import as_gains
from sdpid.experiment.recording.joints import match_joints
from sdpid.experiment.simulation.controllers import PD
from sdpid.experiment.simulation.law import USUAL_DELAY, require_law, with_efforts_of_law
from sdpid.output.report.kinds import listed
from sdpid.output.robots.export_report import given_up
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.inertia import Consistency
from sdpid.robot.model.model import RobotModel
from sdpid.workflow.formulate import Formulation, cross_validate
from sdpid.workflow.result import Identification

# What simulators know of drives: the terms of a convex fit to the efforts of a law.
MADE_OF_LAW = ("coulomb", "viscous", "rotor_inertia")

# A law gives efforts their sign. At another delay than the drives' they only seem to push.
_NOT_OF_LAW = ("effort_sign", "position_sign")
_MEASURED_TOO = (
    "the log has efforts as well: the law's take their place; leave the law out to fit those that "
    "were measured"
)

# Profile intervals respect the constraints, but take several hundred solves, 2 to 10 s for arms of
# six and seven joints; Gauss-Markov intervals take some 0.1 s.
DEFAULT_INTERVALS: Method = "gauss_markov"

# Unconstrained fit, estimate, certificate, intervals, test of bias.
_STEPS = 5

# Rows up to which bias is tested without being asked for: a few seconds of work.
_MOST_ROWS = 3_000_000

_NOT_APART = (
    "intervals do not count what landings do: the samples away from all landings are too few for "
    "a fit; record longer, or another motion beside this one"
)

# Of a link that is as heavy as it may be.
_HEAVIEST = ("mass", "most")

# Bounds are tried this many times as wide.
_WIDER = 10.0

# Links of good recordings keep at least 27 % of their described mass: below this share something
# pulls them away.
_LIGHT = 0.05
# Without the effort that spoils them the other joints are fitted with less than this share of their
# errors (geometric mean), 0.78 on a real arm whose lift has another unit, at least 0.93 on good
# recordings; and less than this share of what leaving out any other effort makes of them: two
# efforts that contradict each other do not tell which of them is wrong.
_BETTER, _CLEARLY = 0.85, 0.9
# With fewer joints there are no others to tell one from.
_LEAST_JOINTS = 3
# Errors in place of none, N·m.
_TINY = 1e-12
# Less of a column beside all others leaves its parameter ten times as uncertain as alone.
_HIDDEN = 0.1


@one_thread
def identify(
    robot: RobotModel | str | os.PathLike[str],
    log: Logs,
    *,
    validation: Logs | None = None,
    processing: ProcessingOf = None,
    without_effort: Iterable[str] = (),
    accept: str | Iterable[str] = (),
    gains: DriveGains | str | os.PathLike[str] | ArrayLike | None = None,
    friction: Iterable[str | FrictionTerm] | None = None,
    weighting: Weighting | None = None,
    consistency: Consistency = "pseudo_inertia",
    constraints: Constraints | None = None,
    prior: Prior | bool | None = None,
    effects: Effects = "auto",
    intervals: bool | Method = True,
    folds: int | None = None,
    rollout: bool = False,
    law: PD | None = None,
    target: Target | None = None,
    rotor_inertia: ArrayLike | None = None,
) -> Identification:
    """Identify the dynamics of a robot from one recording or several.

    The whole chain with its defaults, as the command ``sdpid identify`` runs it. Which options to
    change: docs/choose.md.

    Parameters
    ----------
    robot : RobotModel, name or path
        The robot (see `load_robot`). By name or path, its base floats where a recording has one.
    log : Recording or path, or a sequence of these
        What was measured (see `read_recording`). Several recordings are processed alike, each
        alone, and fitted together; none of them may have periods then.
    validation : Recording or path, or a sequence of these, optional
        Other recordings, whose efforts are predicted only.
    processing : Processing or mapping, optional
        By default it follows from the log (see docs/guides/processing.md); of several recordings
        that of the one with the median cut-off. A mapping changes some settings of the default,
        such as ``{"cutoff_hz": 10.0}``.
    without_effort : iterable of str, optional
        Joints whose effort was not measured, or is wrong. Only their motion is used; their
        friction comes from the prior, which is zero, and the verdict says that it is unknown.
        Those whose effort the inspection finds to say nothing are among them, unless accepted.
    accept : str or iterable of str, optional
        Kinds of findings that make a recording worthless in general, but are as they should be
        here, such as ``"effort_sign"`` (see `inspect_recording`).
    gains : DriveGains, path or (n,) array_like, optional
        Gains of the drives, where efforts are currents in A: of `identify_drive_gains`, its file,
        or numbers in N·m/A that are taken as exact. Errors of the gains count in every interval
        (see docs/guides/gains.md). Recordings that were read with gains need none.
    friction : iterable, optional
        Friction terms, by name or as objects. By default, for records with periods, Coulomb and
        viscous friction; else these with a smooth sign, a sigmoid and offsets (see
        docs/guides/friction.md). ``"default"`` among them stands for these default terms.
    weighting : str, optional
        By default ``gls`` for records with periods, else ``residual`` (see `build_problem`).
    consistency : str, optional
        Physical consistency that every link must have (see `build_problem`).
    constraints : Constraints, optional
        Margins and bounds; by default bounds that follow the robot's size
        (`Constraints.of_size`).
    prior : Prior or bool, optional
        Regularization towards the inertias in the robot's description. By default a `Prior` with
        a strength of one nat with the weighting ``residual``, which records without periods have,
        where the description has masses; none otherwise.
    effects : {"auto", "none"}, str or iterable of str, optional
        Effects beside the friction terms: by default those that the training data show, of
        ``"tilt"`` (gravity's direction), ``"load"`` (friction that grows with load),
        ``"rotor_inertia"``, ``"coupling"`` (of the last two joints) and ``"falling"`` (Stribeck).
        Names, as in ``("tilt", "load")`` or ``"tilt,load"``, put these into the model whatever
        the data say. See docs/guides/effects.md.
    intervals : bool or str, optional
        Method for the intervals of the parameters (see `confidence_intervals`): True is
        ``"gauss_markov"``, which takes a moment; ``"profile"`` respects the constraints and takes
        some seconds. Where the data do not allow intervals, `Identification.intervals_note` says
        why.
    folds : int, optional
        Number of blocks of the recordings to hold out in turn, with everything chosen anew without
        each (see `cross_validate`). By default the choices stay, and the parameters alone are
        found anew.
    rollout : bool, optional
        Simulate the first validation recording in open loop too, all joints free and one at a time
        (see `rollout`), which takes some seconds.
    law : sdpid.controllers.PD, optional
        The law that turned commanded positions into efforts, of a log in which no effort was
        measured: its delay is found where it is None, its kp too (see docs/guides/law.md). The
        convex fit to its efforts, which the certificate is of, is the start of a local search for
        drives and links in the positions of rollouts (`Identification.drives`).
    target : {"mujoco", "isaac", "urdf"}, optional
        Where the model will be used: the drives are reduced at the end to what that can hold. By
        default ``"mujoco"`` with a law. Of measured efforts the estimate stays what it is; a note
        says what the target's joints give up, and what that costs.
    rotor_inertia : float or (n,) array_like, optional
        For the elasticity of gears, where recordings have positions of links (see
        `identify_elasticity`).

    Returns
    -------
    Identification
        Estimate, certificate, errors, intervals and verdict; `Identification.save` writes them.

    Raises
    ------
    SdpidError
        A child that says what is wrong: `DataError`, `ModelError`, `IdentifiabilityError`,
        `InfeasibleError` or `SolverError`.

    Examples
    --------
    >>> result = sdpid.identify(robot, log)
    >>> result.certificate.passed
    True
    >>> result.training.rmse.round(2)
    array([0.23, 0.31, 0.15, 0.12, 0.12, 0.11])
    >>> print(result.headline.error)
    0.14... % in motion (share of the effort), on 5 blocks held out in turn; ...
    """
    if not isinstance(intervals, bool) and intervals not in get_args(Method):
        raise DataError(
            f"intervals: is {intervals!r}; use True, False or one of {', '.join(get_args(Method))}."
        )
    if rollout and validation is None:
        raise DataError(
            "rollout: simulates a recording that was not fitted, and there is none; give another "
            "recording as validation, or call sdpid.rollout."
        )
    if law is not None and (friction is not None or folds is not None or rollout):
        raise DataError(
            "law: friction, folds and rollout have no place beside it; friction is what simulators "
            "hold, and rollouts are what is fitted."
        )
    if target is not None and target not in get_args(Target):
        raise DataError(f"target: is {target!r}; use one of {', '.join(get_args(Target))}.")
    formulation = Formulation(
        friction=friction if law is None else MADE_OF_LAW,
        weighting=weighting,
        consistency=consistency,
        constraints=constraints,
        prior=prior,
        effects=effects if law is None else "none",
    )
    if law is not None:
        kinds = (*kinds_accepted(accept), *_NOT_OF_LAW)
        options = {"processing": processing, "accept": kinds}
        return _under_law(
            robot, log, validation, law, target or "mujoco", formulation, intervals, options
        )
    kinds, known = kinds_accepted(accept), as_gains(gains)
    how = {"without_effort": without_effort, "accept": kinds, "gains": known}
    prepared = formulation.prepare(robot, log, processing=processing, **how)
    fresh = None
    if validation is not None:
        fresh = prepared.others(validation, accept=kinds, gains=known)
    spoiled = list[Finding]()
    while True:
        with progress(1, "choosing the model and compressing its rows"):
            problem = formulation.problem(prepared)
        result = _solved(problem, prepared, fresh, intervals)
        spoils = None
        if "effort_spoils" not in kinds:
            spoils = _spoiling_effort(result, prepared, formulation)
        if spoils is None:
            break
        spoiled.append(spoils)
        prepared = _without(prepared, spoils)
        fresh = None if fresh is None else _without(fresh, spoils)
    result = replace(
        result,
        findings=(*spoiled, *result.findings),
        notes=(*map(str, spoiled), *result.notes),
        remedies=tuple(_remedies(result, prepared, formulation)),
    )
    if folds is not None:
        left_out = cross_validate(
            prepared.robot,
            prepared.logs,
            folds=folds,
            processing=processing,
            without_effort=prepared.without_effort,
            **vars(formulation),
        )
        result = replace(result, cross_validation=left_out)
    both = [log for log in prepared.logs if log.link_position is not None]
    if both:
        try:
            elasticity = identify_elasticity(result.estimate, both, rotor_inertia)
            result = replace(result, elasticity=elasticity)
        except DataError as reason:
            if rotor_inertia is not None:
                raise
            result = replace(result, notes=(*result.notes, f"no elasticity: {reason}"))
    elif rotor_inertia is not None:
        raise DataError(
            "rotor_inertia: is for the elasticity of gears, and no recording has positions of "
            "links (Recording.link_position, columns called link_position_<joint>)."
        )
    if rollout and fresh is not None:
        from sdpid.assurance.rollouts.rollout import rollouts

        moved = rollouts(result.estimate, fresh.logs[0], processing=prepared.processing)
        result = replace(result, rollouts=moved)
    if target is not None and result.estimate.theta is not None:
        result = replace(result, notes=(given_up(result.estimate, target), *result.notes))
    return result


def _under_law(
    robot: RobotModel | str | os.PathLike[str],
    log: Logs,
    validation: Logs | None,
    law: PD,
    target: Target,
    formulation: Formulation,
    intervals: bool | Method,
    options: dict[str, Any],
) -> Identification:
    """Return the convex fit to the law's efforts, and the drives that positions show."""
    model, logs = read_logs(robot, log)
    require_law(law)
    if model.free_flyer:
        raise DataError(
            f"law: the base of '{model.name}' floats in this log; rollouts need a base that is "
            "held: hang the robot up, and leave the base's columns out."
        )
    law = law.of_joints(model.n)
    others = () if validation is None else read_logs(model, validation, "validation")[1]
    matched, fresh = ([match_joints(model, x) for x in each] for each in (logs, others))
    delay = USUAL_DELAY if law.delay is None else law.delay
    first = first_law(matched, law, model, delay)
    notes = [_MEASURED_TOO] if any("effort" in each.channels for each in matched) else []
    made, seen = ([with_efforts_of_law(x, first, delay) for x in each] for each in (matched, fresh))
    prepared = formulation.prepare(model, made, **options)
    kept = tuple(each for each in prepared.findings if each.kind not in _NOT_OF_LAW)
    prepared = replace(prepared, findings=kept)
    result = _solved(
        formulation.problem(prepared),
        replace(prepared, logs=tuple(logs)),
        prepared.others(seen, accept=options["accept"]) if seen else None,
        intervals,
        measured=False,
    )
    with progress(1, "fitting the drives to positions"):
        drives = fit_law(
            result.estimate, matched, law, target=target, start=first, validation=fresh
        )
    return replace(
        result,
        drives=drives,
        notes=(*notes, *drives.notes, *result.notes),
        recipe=None,
        recipe_note="the rows cannot be made again from the log: their efforts are a law's",
    )


def _without(prepared: Prepared, spoils: Finding) -> Prepared:
    """Return recordings without the effort of a joint, and without what was found of it."""
    joint = str(spoils.joint)
    return replace(
        prepared.without(joint),
        without_effort=(*prepared.without_effort, joint),
        findings=tuple(each for each in prepared.findings if each.joint != joint),
    )


def _solved(
    problem: Problem,
    prepared: Prepared,
    fresh: Prepared | None,
    intervals: bool | Method,
    *,
    measured: bool = True,
) -> Identification:
    """Return the estimate with its proof, errors, intervals and tests.

    Of efforts that a law made nothing is held out, and no bias is looked for.
    """
    findings = prepared.findings + (() if fresh is None else fresh.findings)
    # Gaps and wrapped angles stand in the notes of the samples.
    notes = [str(finding) for finding in findings if finding.kind != "continued"]
    notes += prepared.notes
    if intervals is not False and measured:
        problem, unknown = with_motion_bias_of(problem, prepared)
        notes += unknown
    notes += _of_springs(problem)
    notes += [each.words for each in problem.origin.effects]
    if (alike := in_words(collinear_friction(problem))) is not None:
        notes.append(alike)
    with progress(_STEPS, "estimating") as advance:
        wls = solve_wls(replace(problem, prior=None))
        advance(1)
        estimate = solve_sdp(problem)
        advance(1)
        certificate = certify(estimate)
        estimate = certificate.certified
        advance(1)
        confidence, intervals_note = _intervals(estimate, intervals)
        advance(1)
        bias, bias_note = _bias(estimate, prepared) if measured else (None, None)
        advance(1)
    samples = None if fresh is None else fresh.samples
    with progress(1, "holding out blocks"):
        predicted = None if samples is None else validate(estimate, samples)
        held_out = hold_out(estimate, wls, samples, predicted) if measured else None
    recipe, no_recipe = recipe_or_reason(problem, prepared)
    logs = () if fresh is None else fresh.logs
    return Identification(
        problem=problem,
        wls=wls,
        estimate=estimate,
        certificate=certificate,
        training=validate(estimate),
        training_wls=validate(wls),
        validation=predicted,
        validation_samples=samples,
        held_out=held_out,
        intervals=confidence,
        intervals_note=intervals_note,
        bias=bias,
        bias_note=bias_note,
        notes=tuple(notes),
        findings=findings,
        inputs=tuple(input_files(prepared.robot, prepared.logs, logs)),
        recipe=recipe,
        recipe_note=no_recipe,
    )


def _of_springs(problem: Problem) -> list[str]:
    """Return which springs the motion hides, and that those of the description are held."""
    notes = [
        f"{name} of {joint} is hardly told from other parameters, such as gravity's, on this "
        f"motion: {100.0 * share:.2g} % of its column is not in theirs; move {joint} further, or "
        "in other poses"
        for name, joint, share in hidden_terms(problem)
        if share < _HIDDEN
    ]
    kept = [each for each in problem.robot.springs if each in problem.friction.terms]
    joints = [str(getattr(each, "joint", "")) for each in kept]
    if not joints:
        return notes
    return [
        *notes,
        f"springs of the description are held as they are there, at {listed(joints)}: give "
        f"friction.Spring('{joints[0]}') among the terms to identify one",
    ]


def _intervals(estimate: Estimate, wanted: bool | Method) -> tuple[Intervals | None, str | None]:
    """Return the intervals, or a note on why there are none."""
    if wanted is False:
        return None, None
    method: Method = DEFAULT_INTERVALS if wanted is True else wanted
    try:
        found = confidence_intervals(estimate, method=method)
        return found, found.noise_in_words()
    except (DataError, IdentifiabilityError, SolverError) as reason:
        return None, f"no intervals of the parameters ({method}): {reason}"


def with_motion_bias_of(problem: Problem, prepared: Prepared) -> tuple[Problem, list[str]]:
    """Return the problem with its biases (of a fixed robot by noise alone), or notes why not."""
    if problem.weighting in PRINTED or any(log.stored for log in prepared.logs):
        return problem, []
    try:
        alone = not problem.robot.free_flyer
        found = with_motion_bias(problem, prepared.logs, prepared.processing, noise_alone=alone)
    except SdpidError as reason:
        return problem, [f"intervals do not count what noise in the motion does: {reason}"]
    landed = landings_used(problem, prepared.logs, prepared.processing)
    unknown = landed and all(source.name != "landing" for source in found.errors)
    return found, [_NOT_APART] if unknown else []


def _bias(estimate: Estimate, prepared: Prepared) -> tuple[BiasTest | None, str | None]:
    """Return the test whether noise in the motion biases least squares, or why there is none."""
    untested = "bias by noise in the motion is not tested"
    if estimate.problem.robot.free_flyer:
        return None, f"{untested}: it is known for robots that are fixed to the ground only"
    if estimate.problem.n_rows > _MOST_ROWS or any(log.stored for log in prepared.logs):
        return None, f"{untested}: the log is long (sdpid.check_bias tests it all the same)"
    try:
        test = check_bias(estimate, prepared.logs, processing=prepared.processing)
    except SdpidError as reason:
        return None, f"{untested}: {reason}"
    if test.weak:
        more = "" if test.note is None else f" ({test.note})"
        return None, (
            f"{untested}: {test.instruments} is a weak instrument for {len(test.weak)} of "
            f"{estimate.problem.base.count} base parameters{more}; give sdpid.check_bias the "
            "robot's controller (controller=, one of sdpid.controllers)"
        )
    return test, None


def _remedies(
    result: Identification, prepared: Prepared, formulation: Formulation
) -> Iterator[Remedy]:
    """Yield what other choices make of the error, where what costs less predicts better.

    Friction terms and effects stay. Tried are no prior, wider bounds where bounds hold the fit
    back, and no effort of the joint whose error is the largest beside that of least squares.
    """
    held_out, fresh, names = result.held_out, result.validation_samples, prepared.robot.joint_names
    if held_out is None or held_out.beaten_by is None:
        return
    fixed = formulation.without_choices(result.problem)
    for cause, option, problem, left_out in _choices(result, prepared, fixed):
        try:
            estimate = solve_sdp(problem())
            again = None if fresh is not None else hold_out(estimate, result.wls, None)
        except SdpidError:
            continue
        fit = validate(estimate, fresh) if fresh is not None else again and again.fit
        if fit:
            before, error = (_share(each.told, left_out) for each in (held_out.fit, fit))
            others = "" if left_out is None else f" of the joints beside {names[left_out]}"
            yield Remedy(cause=cause, option=option, before=before, error=error, of=others)


def _choices(
    result: Identification, prepared: Prepared, fixed: Formulation
) -> Iterator[tuple[str, str, Any, int | None]]:
    """Yield a cause, the option against it, what makes the problem, and a joint left out."""
    problem, robot, held_out = result.problem, prepared.robot, result.held_out
    assert held_out is not None
    if problem.prior is not None:
        cause = "the belief in the description's inertias holds it back"
        yield cause, "--no-prior", lambda: replace(problem, prior=None), None
    active = [each for each in constraint_states(result.estimate) if each.active]
    bounds = [s.name for s in active if s.kind == "theta_max" or (s.kind, s.side) == _HEAVIEST]
    if bounds:
        given = problem.constraints
        mass, size = _WIDER * given.mass_max, _WIDER * given.theta_max
        wide = given.replace(mass_max=mass, theta_max=size)
        cause = f"bounds hold it back ({listed(bounds)})"
        yield cause, f"--mass-max {mass:g}", lambda: problem.constrained(constraints=wide), None
    # The joint that is farther off than by least squares, in squares of the whole error.
    own, free = held_out.fit.moving, held_out.baselines[LEAST_SQUARES].moving
    more = own.rows * (own.rmse**2 - free.rmse**2)
    worst = int(np.argmax(more))
    if not robot.n_base and more[worst] > 0.0 and np.count_nonzero(own.rows) > 1:
        name = robot.joint_names[worst]

        def without() -> Problem:
            return fixed.problem(prepared.without(name))

        cause = f"the effort of {name} or its links in the description contradict the others"
        yield cause, f"--without-effort {name}", without, worst


def _share(errors: Errors, left_out: int | None) -> float:
    """Return the relative residual, of all joints or without one."""
    if left_out is None:
        return errors.relative
    rows = np.array(errors.rows, dtype=float)
    rows[left_out] = 0.0
    told = np.isfinite(errors.nrmse) & (errors.nrmse > 0.0)
    effort = np.divide(errors.rmse, errors.nrmse, out=np.zeros(len(rows)), where=told)
    return float(np.sqrt(rows @ errors.rmse**2 / max(rows @ effort**2, np.finfo(float).tiny)))


def _spoiling_effort(
    result: Identification, prepared: Prepared, formulation: Formulation
) -> Finding | None:
    """Return the joint without whose effort all others are fitted better; None where all is well.

    Looked for, with a solve a joint, only where a link has lost its mass or the estimate is worse
    than cheaper ones on what was held out.
    """
    why, robot, samples = _suspicion(result), prepared.robot, prepared.samples
    joints = np.flatnonzero(samples.used.any(axis=0)).tolist()
    if why is None or robot.n_base or len(joints) < _LEAST_JOINTS:
        return None
    fixed = formulation.without_choices(result.problem)
    shares = {}
    for j in joints:
        less = prepared.without(robot.joint_names[j])
        try:
            estimate = solve_sdp(fixed.problem(less))
        except SdpidError:
            continue
        errors = np.array([result.training.rmse, validate(estimate, samples).rmse])
        logs = np.log(np.maximum(errors[:, [k for k in joints if k != j]], _TINY))
        shares[j] = float(np.exp(np.mean(logs[1] - logs[0])))
    j, second, *_ = sorted(joints, key=lambda each: shares.get(each, np.inf))
    share = shares.get(j, np.inf)
    if share > min(_BETTER, _CLEARLY * shares.get(second, np.inf)):
        return None
    return found("effort_spoils", robot.joint_names[j], why=why, share=share, limit=_BETTER)


def _suspicion(result: Identification) -> str | None:
    """Return what looks wrong with an estimate, in words."""
    problem, theta = result.problem, result.estimate.theta
    if theta is not None and problem.prior is not None:
        described = problem.robot.prior[:, 0]
        masses = theta[: 10 * len(described) : 10]
        light = np.flatnonzero(masses < _LIGHT * described)
        for i in light[:1]:
            link = problem.robot.link_names[i]
            return f"{link} has {masses[i]:.2g} kg of {described[i]:.3g} kg described"
    beaten = None if result.held_out is None else result.held_out.beaten_by
    return None if beaten is None else f"the estimate is worse than {beaten} on what was held out"
