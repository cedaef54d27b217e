"""Identify a payload: mass, center of mass and inertia of what a link carries, with intervals."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Indices, frozen, require_probability
from sdpid._common.threads import one_thread
from sdpid.assurance.payload.payload import Payload
from sdpid.assurance.payload.virtual_link import (
    best_payload,
    gains_share,
    is_shown,
    payload_intervals,
    payload_problem,
)
from sdpid.errors import DataError, ModelError
from sdpid.estimation.compression.covariance import PRINTED, Weighting
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.prior.prior import Prior
from sdpid.estimation.problem import Problem, build_problem
from sdpid.experiment.drive_gains.gains import DriveGains
from sdpid.experiment.inspection.inspect import kinds_accepted
from sdpid.experiment.inspection.kinds import Finding
from sdpid.experiment.preparation.prepare import (
    friction_of,
    joints_without,
    prepare,
    read_logs,
    without_efforts,
)
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.readers.mapping import as_gains
from sdpid.experiment.readers.scaled import require_torques
from sdpid.experiment.recording.joints import require_fixed_base
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.friction.posed import PosedTerm
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.friction.terms import BY_NAME, RotorInertia
from sdpid.robot.inertia import margin, physical_parameters, transform
from sdpid.robot.model.arms import require_fixed_robot, require_open_chain
from sdpid.robot.model.geometry import carrying_frame
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel

_Recorded = Recording | str | os.PathLike[str]
Log = Samples | _Recorded | Sequence[_Recorded]

# Friction changes from run to run. To let it differ hardly widens intervals where
# it does not change; to take it as common puts the center of mass off by centimeters where it
# does (docs/evidence/exports.md).
SEPARATE = tuple(
    name for name, term in BY_NAME.items() if not issubclass(term, RotorInertia | PosedTerm)
)

# Friction of samples, of which nothing is known.
_OF_SAMPLES = ("coulomb", "viscous", "offset")


@one_thread
def identify_payload(
    robot: RobotModel | str | os.PathLike[str],
    with_load: Log,
    without_load: Log | Estimate | None = None,
    *,
    link: str | None = None,
    frame: str | None = None,
    prior: Prior | None = None,
    friction: Iterable[str | FrictionTerm] | None = None,
    separate: Iterable[str] = SEPARATE,
    processing: Processing | None = None,
    weighting: Weighting | None = None,
    mass_max: float = 100.0,
    extent: float = 1.0,
    level: float = 0.95,
    accept: str | Iterable[str] = (),
    without_effort: Iterable[str] = (),
    gains: DriveGains | str | os.PathLike[str] | ArrayLike | None = None,
) -> Payload:
    """Identify the payload that a link carries.

    The payload is the body, of all that matter can have, with which the recordings together fit
    best. The arm's own parameters take, for every payload, the values that fit best. What is known
    of the arm is

    * a recording without load, or an estimate made from one (of which the data are used, not the
      result, so that its uncertainty counts);
    * or nothing but the robot's description: with a `prior` the prior regularizes towards it,
      without one its links are taken as they are and only friction is estimated. The intervals
      then allow for links that are off by 10 to 30 %, as much as the recording suggests.

    See docs/guides/payload.md.

    Parameters
    ----------
    robot : RobotModel, name or path
        The arm without payload; beside an estimate, the estimate's own robot.
    with_load : Samples, Recording or path, or a sequence of the latter two
        What was measured with the payload.
    without_load : Samples, Recording or path, a sequence of the latter two, or Estimate, optional
        What was measured without it.
    link : str, optional
        Which link carries it; by default the last one.
    frame : str, optional
        A frame fixed to that link, such as the flange's link in the URDF; by default the joint
        frame of the link.
    prior : Prior, optional
        Prior of the arm's parameters; of a quadratic kind.
    friction : iterable, optional
        Friction terms; by default those of the estimate, or as `identify` chooses them.
    separate : iterable of str, optional
        Names of friction terms that may differ between the recordings, as friction does when
        motors warm up and sensors' zeros drift. By default friction of every kind but that which
        grows with load.
    processing : Processing, optional
        Processing of the recordings; by default as `identify` chooses it.
    weighting : str, optional
        By default that of the estimate, or ``gls`` for samples with a covariance, else
        ``residual``.
    mass_max : float, optional
        Largest mass, kg.
    extent : float, optional
        Largest rms distance of the payload's mass from the frame's origin, m: it bounds what the
        recordings leave open.
    level : float, optional
        Probability of the intervals.
    accept : str or iterable of str, optional
        As for `identify`: kinds of findings that do not refuse a recording.
    without_effort : iterable of str, optional
        As for `identify`: joints whose effort was not measured, or is wrong, in either recording.
    gains : DriveGains, path or (n,) array_like, optional
        As for `identify`: gains of the drives, where efforts are currents, in both recordings.

    Returns
    -------
    Payload
        Mass, center of mass and inertia with intervals.

    Raises
    ------
    DataError
        When the recordings, or a number, make no sense.
    ModelError
        When the robot has no such link or frame, or has several last ones.
    SolverError
        When the program cannot be solved.

    Examples
    --------
    >>> theta = estimate.theta.copy()
    >>> theta[50:60] += [2.0, 0.0, 0.0, 0.2, 0.03, 0.0, 0.03, 0.0, 0.0, 0.01]  # 2 kg at link_6
    >>> loaded = sdpid.simulate(robot, motion, theta=theta, exact=True, seed=1)
    >>> payload = sdpid.identify_payload(robot, loaded, estimate)
    >>> payload.shown, round(payload.mass, 1), round(payload.com[2], 2)
    (True, 2.0, np.float64(0.1))
    >>> bool(payload.lower[0] < 2.0 < payload.upper[0])
    True
    """
    for value, name in ((mass_max, "mass_max"), (extent, "extent")):
        if not (np.isfinite(value) and value > 0.0):
            raise DataError(f"payload: {name} is {value}; give a positive number.")
    require_probability(level, "payload: level")
    model = _robot(robot, without_load)
    require_fixed_robot(model, "payload")
    require_open_chain(model, "payload")
    absent, known = joints_without(without_effort), as_gains(gains)
    with_load, without_load = (
        _read(model, log, name, absent, known)
        for log, name in ((with_load, "log"), (without_load, "without_load"))
    )
    number, rotation, translation, name = carrying_frame(model, link, frame, what="payload")
    how = {
        "processing": processing,
        "without_effort": absent,
        "accept": kinds_accepted(accept),
    }
    samples, findings = _samples(model, with_load, "log", how)
    if isinstance(with_load, tuple):
        terms = friction_of(with_load[0], friction)
    else:
        terms = _OF_SAMPLES if friction is None else tuple(friction)
    arm = None
    if isinstance(without_load, Estimate):
        arm = without_load.problem
    elif without_load is not None:
        bare, more = _samples(model, without_load, "without_load", how)
        findings += more
        arm = _built(model, bare, weighting, friction=terms, prior=prior)
    elif prior is None and not np.all(model.prior[:, 0] > 0.0):
        raise ModelError(
            f"payload: the description of '{model.name}' gives links no mass; give a recording "
            "without load."
        )
    elif prior is not None and prior.strength == "evidence":
        raise DataError("payload: evidence would weigh the load as an error; give a strength.")
    if arm is None:
        loaded = _built(model, samples, weighting, friction=terms, prior=prior)
    else:
        loaded = _built(model, samples, weighting, friction=arm.friction.terms, base=arm.base)
    for each in (loaded, arm or loaded):
        if each.weighting in PRINTED:
            raise DataError(f"payload: weighting '{each.weighting}' is no likelihood; use gls.")
    placed = transform(np.eye(10), rotation, translation).T
    columns = loaded.base.matrix[:, 10 * number : 10 * number + 10] @ placed
    problem, errors, described = payload_problem(
        loaded,
        arm,
        columns,
        _separate(arm, separate),
        model.prior if arm is None and prior is None else None,
        mass_max=mass_max,
        extent=extent,
    )
    notes = [] if described is None else [described.note()]
    notes += [f"gains: {each.gains.in_words}" for each in problem.errors if each.gains is not None]
    if invisible := 10 - problem.base.count:
        notes.append(
            f"{invisible} of ten directions are invisible in the recordings: intervals there rest "
            "on what matter can be"
        )
    best, held = best_payload(problem)
    if held:
        notes.append(
            "the recordings ask for a body smaller than matter can be: it has the least second "
            "moments, those of a ball of the densest matter, and its inertia is no measurement"
        )
    theta = np.array(best.theta)
    ends = payload_intervals(problem, theta, errors, level)
    shown = is_shown(problem, theta, errors, level)
    if not shown:
        ends[0, 0] = 0.0
        notes.append("not shown: without any payload the errors explain the recordings, too")
    mass, com, inertia = physical_parameters(theta)
    value = float(margin(theta, "pseudo_inertia"))
    return Payload(
        mass=float(mass),
        com=frozen(com),
        inertia=frozen(inertia),
        theta=frozen(theta),
        link=model.link_names[number],
        frame=name,
        lower=frozen(ends[:, 0]),
        upper=frozen(ends[:, 1]),
        level=level,
        margin=value if np.isfinite(value) else None,
        cost=problem.cost_of(theta),
        cost_without=problem.cost_of(np.zeros(10)),
        invisible=invisible,
        shown=shown,
        status=best.status,
        notes=tuple(notes),
        findings=findings,
        described=described,
        gains_share=gains_share(best, errors),
    )


def _read(robot: RobotModel, log: Any, name: str, absent: tuple[str, ...], gains: Any) -> Any:
    """Return the recordings of a log, some efforts of which may lack, and others as they are."""
    if log is None or isinstance(log, Samples | Estimate):
        return log
    _, logs = read_logs(robot, log, name, without_effort=absent, gains=gains)
    for each in logs:
        require_torques(each, f"payload, {name}")
        require_fixed_base(each, f"payload, {name}")
    return logs


def _samples(
    robot: RobotModel, log: Any, name: str, how: dict[str, Any]
) -> tuple[Samples, tuple[Finding, ...]]:
    """Return the samples of recordings, and what is wrong with these."""
    if isinstance(log, Samples):
        absent = how["without_effort"]
        return without_efforts(log, robot, absent) if absent else log, ()
    found = prepare(robot, log, name=name, **how)
    return found.samples, found.findings


def _built(
    robot: RobotModel, samples: Samples, weighting: Weighting | None, **known: Any
) -> Problem:
    """Return the problem of samples, which may show the payload and not all of the arm."""
    usual: Weighting = "residual" if samples.covariance is None else "gls"
    return build_problem(
        robot, samples, weighting=weighting or usual, check_excitation=False, **known
    )


def _robot(robot: RobotModel | str | os.PathLike[str], given: Any) -> RobotModel:
    """Return the model of the robot: that of a given estimate, if both are described alike."""
    model = robot if isinstance(robot, RobotModel) else load_robot(robot)
    if not isinstance(given, Estimate):
        return model
    own = given.problem.robot
    alike = (own.joint_names, own.link_names) == (model.joint_names, model.link_names)
    if own is not model and not (alike and own.pin_model == model.pin_model):
        raise DataError(
            f"payload: the estimate is of another robot than '{model.name}', or of another "
            "description of it; give estimate.problem.robot as the robot."
        )
    return own


def _separate(problem: Problem | None, names: Iterable[str]) -> Indices:
    """Return the entries of theta of the friction terms that differ between the recordings."""
    if problem is None:
        return np.zeros(0, dtype=np.intp)
    names = tuple(names)
    if unknown := [name for name in names if name not in BY_NAME]:
        raise DataError(
            f"payload: separate names '{unknown[0]}', which is no friction term; there are "
            f"{', '.join(BY_NAME)}."
        )
    kinds = tuple(BY_NAME[name] for name in names)
    places = np.arange(problem.n_theta)[10 * problem.robot.n_links :]
    out = [places[own] for term, own in problem.friction.placed if isinstance(term, kinds)]
    return np.concatenate([places[:0], *out])
