"""Identify a payload: mass, center of mass and inertia of what a link carries, with intervals."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Indices, frozen, require_probability
from sdpid._common.threads import one_thread
from sdpid.assurance.payload.payload import Payload
from sdpid.assurance.payload.program import NOTHING, PayloadProgram, least_second_moment
from sdpid.assurance.payload.rows import (
    Description,
    PayloadRows,
    rows_beside,
    rows_beside_description,
)
from sdpid.errors import DataError, ModelError
from sdpid.estimation.compression.covariance import PRINTED, Weighting
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.prior.prior import Prior
from sdpid.estimation.problem import Problem, build_problem
from sdpid.experiment.drive_gains.gains import DriveGains
from sdpid.experiment.inspection.finding import Finding
from sdpid.experiment.preparation.for_robot import friction_of, prepare
from sdpid.experiment.preparation.several import (
    columns_without,
    inspected,
    joints_without,
    without_efforts,
)
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.readers.mapping import as_gains
from sdpid.experiment.readers.read import read_recording
from sdpid.experiment.readers.scaled import require_torques, scaled
from sdpid.experiment.recording.floating.robots import require_fixed_base
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.consistent import raise_second_moments
from sdpid.robot.friction.model import BY_NAME
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.inertia import margin, physical_parameters, transform
from sdpid.robot.model.contacts.open_chain import require_fixed_robot, require_open_chain
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel
from sdpid.robot.model.mounting import carrying_link, frame_on_link

Log = Recording | Samples | str | os.PathLike[str]

_AT_THE_EDGE = (
    "the recordings ask for a body smaller than matter can be: it has the least second moments, "
    "those of a ball of the densest matter, and its inertia is no measurement"
)

# Directions in which a unit payload moves the cost by less than this share of the strongest one
# are invisible, but for rounding.
_INVISIBLE = 1e-9

# Friction changes from run to run. To let it differ hardly widens intervals where
# it does not change; to take it as common puts the center of mass off by centimeters where it
# does (docs/evidence/exports.md).
SEPARATE = (
    *("coulomb", "viscous", "offset", "asymmetric_coulomb", "stribeck", "sigmoid", "square_root"),
)


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
    with_load : Recording, Samples or path
        What was measured with the payload.
    without_load : Recording, Samples, path or Estimate, optional
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
    given = without_load if isinstance(without_load, Estimate) else None
    model = _robot(robot, given)
    findings: tuple[Finding, ...] = ()
    require_fixed_robot(model, "payload")
    require_open_chain(model, "payload")
    absent = joints_without(without_effort)
    known, columns_absent = as_gains(gains), columns_without(model, absent)
    with_load, without_load = (
        _read(log, columns_absent, known, name)
        for log, name in ((with_load, "log"), (without_load, "without_load"))
    )
    for log, name in ((with_load, "log"), (without_load, "without_load")):
        if isinstance(log, Recording):
            findings += inspected(model, [log], accept, absent, name=name)
    number = carrying_link(model, link, what="payload")
    rotation, translation, name = frame_on_link(model, number, frame, what="payload")
    read = functools.partial(_samples, model, processing=processing, absent=absent)
    loaded, arm = _problems(model, with_load, without_load, prior, friction, read, weighting)
    placed = transform(np.eye(10), rotation, translation).T
    columns = loaded.base.matrix[:, 10 * number : 10 * number + 10] @ placed
    notes: tuple[str, ...] = ()
    described: Description | None = None
    if arm is not None or prior is not None:
        rows = rows_beside(loaded, arm, columns, _separate(arm, separate))
    else:
        rows, described = rows_beside_description(loaded, columns, model.prior)
        notes = (described.note(),)
    if rows.short:
        notes += (
            f"a recording is too short for blocks of {loaded.samples.block} samples: the intervals "
            "trust the weighting",
        )
    notes += tuple(
        f"gains: {each.gains.gains.in_words}"
        for each in rows.errors
        if each.gains is not None and each.gains.gains is not None
    )
    found = _solved(rows, model.link_names[number], name, mass_max, extent, level, notes)
    return replace(found, described=described, findings=findings)


def _solved(
    rows: PayloadRows,
    link: str,
    frame: str,
    mass_max: float,
    extent: float,
    level: float,
    notes: tuple[str, ...],
) -> Payload:
    """Return the payload of the rows, with its intervals."""
    program = PayloadProgram(rows, mass_max, extent)
    singular = np.linalg.svd(rows.matrix * program.units, compute_uv=False)
    invisible = int(np.count_nonzero(singular <= _INVISIBLE * max(singular[0], 1e-300)))
    if singular[0] == 0.0:
        raise DataError("payload: the recordings do not show it at all; move more joints.")
    if invisible:
        notes += (
            f"{invisible} of ten directions are invisible in the recordings: intervals there rest "
            "on what matter can be",
        )
    theta, status = program.solve()
    if theta[0] > NOTHING:
        if margin(theta, "pseudo_inertia") < least_second_moment(theta[0]):
            theta, status = program.solve(least_second_moment(theta[0]))
            notes += (_AT_THE_EDGE,)
        # Solvers stop a little short of the least.
        theta = raise_second_moments(theta, least_second_moment(theta[0]))
    else:
        theta = np.zeros(10)
    ends, unsolved = program.intervals(theta, level)
    if unsolved:
        names = ", ".join(unsolved)
        notes += (f"the solver stopped short of its tolerance at the intervals of {names}",)
    shown = program.shown(theta, level)
    if not shown:
        ends[0, 0] = 0.0
        notes += ("not shown: without any payload the errors explain the recordings, too",)
    mass, com, inertia = physical_parameters(theta)
    value = float(margin(theta, "pseudo_inertia"))
    return Payload(
        mass=float(mass),
        com=frozen(com),
        inertia=frozen(inertia),
        theta=frozen(theta),
        link=link,
        frame=frame,
        lower=frozen(ends[:, 0]),
        upper=frozen(ends[:, 1]),
        level=level,
        margin=value if np.isfinite(value) else None,
        cost=program.cost(theta),
        cost_without=program.cost(np.zeros(10)),
        invisible=invisible,
        shown=shown,
        status=status,
        notes=notes,
        gains_share=frozen(program.gains_share(theta)) if rows.gains else None,
    )


def _read(log: Any, absent: Sequence[str], gains: Any, name: str) -> Any:
    """Return the recording of a path, some efforts of which may lack, and others as they are."""
    if isinstance(log, (str, os.PathLike)):
        log = read_recording(log, without_effort=absent, gains=gains)
    elif isinstance(log, Recording) and gains is not None:
        log = scaled(log, gains)
    if isinstance(log, Recording):
        require_torques(log, f"payload, {name}")
        require_fixed_base(log, f"payload, {name}")
    return log


def _robot(robot: RobotModel | str | os.PathLike[str], given: Estimate | None) -> RobotModel:
    """Return the model of the robot: that of a given estimate, if both are described alike."""
    model = robot if isinstance(robot, RobotModel) else load_robot(robot)
    if given is None:
        return model
    own = given.problem.robot
    alike = (own.joint_names, own.link_names) == (model.joint_names, model.link_names)
    if own is not model and not (alike and own.pin_model == model.pin_model):
        raise DataError(
            f"payload: the estimate is of another robot than '{model.name}', or of another "
            "description of it; give estimate.problem.robot as the robot."
        )
    return own


def _samples(
    robot: RobotModel, log: Any, *, processing: Processing | None, absent: Sequence[str]
) -> Samples:
    """Return the processed samples of a log, with no row in use of joints without effort."""
    if isinstance(log, Recording):
        log = prepare(robot, log, processing)
    if not isinstance(log, Samples):
        raise DataError(f"payload: got {type(log).__name__}; give a recording, samples or a path.")
    return without_efforts(log, robot, absent) if absent else log


def _problems(
    robot: RobotModel,
    with_load: Log,
    without_load: Log | Estimate | None,
    prior: Prior | None,
    friction: Iterable[str | FrictionTerm] | None,
    read: Callable[[Any], Samples],
    weighting: Weighting | None,
) -> tuple[Problem, Problem | None]:
    """Return the problems with and without load, compressed with the same base parameters."""
    samples = read(with_load)
    if isinstance(with_load, Recording):
        terms = friction_of(with_load, friction)
    else:
        terms = ("coulomb", "viscous", "offset") if friction is None else tuple(friction)
    if without_load is None and prior is None and not np.all(robot.prior[:, 0] > 0.0):
        raise ModelError(
            f"payload: the description of '{robot.name}' gives links no mass; give a recording "
            "without load."
        )
    if without_load is None and prior is not None and prior.strength == "evidence":
        raise DataError("payload: evidence would weigh the load as an error; give a strength.")

    def built(samples: Samples, **known: Any) -> Problem:
        usual: Weighting = "residual" if samples.covariance is None else "gls"
        # The arm may move in ways that show the payload and not all of the arm.
        return build_problem(
            robot, samples, weighting=weighting or usual, check_excitation=False, **known
        )

    if isinstance(without_load, Estimate):
        arm: Problem | None = without_load.problem
    else:
        bare = None if without_load is None else read(without_load)
        arm = None if bare is None else built(bare, friction=terms, prior=prior)
    if arm is None:
        loaded = built(samples, friction=terms, prior=prior)
    else:
        loaded = built(samples, friction=arm.friction.terms, base=arm.base)
    for problem in (loaded, arm):
        if problem is not None and problem.weighting in PRINTED:
            raise DataError(f"payload: weighting '{problem.weighting}' is no likelihood; use gls.")
    return loaded, arm


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
