"""Design a motion that is safe at every instant and shows the parameters."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import generator
from sdpid.errors import DataError, InfeasibleError
from sdpid.estimation.information import UNDETERMINED, Excitation
from sdpid.estimation.prior.prior import Prior
from sdpid.excitation.criterion.belief import Given, Previous
from sdpid.excitation.criterion.criterion import WORDS, ObjectiveKind
from sdpid.excitation.criterion.rows import BaseRows
from sdpid.excitation.design.task import MOTIONS, Motion, Request, Task
from sdpid.excitation.expected.expect import expect
from sdpid.excitation.geometry.obstacles import Obstacle
from sdpid.excitation.limits.limits import Limits
from sdpid.excitation.plan.plan import Plan, settings_of
from sdpid.excitation.search.ipopt import INTERRUPTED
from sdpid.excitation.search.search import Candidate, designed, require_search
from sdpid.experiment.trajectory.trajectory import Trajectory
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.model.arms import require_open_chain
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel

# Friction terms of a plan, where none are named: those that every joint has.
FRICTION = ("coulomb", "viscous", "offset")
# Starts of the search.
STARTS = 4
# Of a time limit, what is kept for the check and for what the run will buy: times what it took to
# resolve the arguments on this machine, and at most this share.
_KEPT, _KEPT_SHARE = 2.0, 0.4
# States, times joints, that are enough for the compiled regressor to be worth its start.
_STATES = 600
# Of the trajectory's samples, every so many enter the condition number that is stated.
_SCORED = 5


def design_excitation(
    robot: RobotModel | str | os.PathLike[str],
    *,
    duration: float = 20.0,
    limits: Limits | None = None,
    obstacles: Iterable[Obstacle] = (),
    collisions: bool = True,
    friction: Iterable[str | FrictionTerm] | None = None,
    prior: Prior | bool | None = None,
    previous: Previous | None = None,
    noise: Given = None,
    purpose: str = "all",
    predict: Trajectory | None = None,
    objective: ObjectiveKind | None = None,
    motion: Motion = "spline",
    closed: bool = True,
    harmonics: int | None = None,
    start: ArrayLike | None = None,
    periods: int = 1,
    torque_spread: float = 0.0,
    package_dirs: Iterable[str | os.PathLike[str]] = (),
    starts: int = STARTS,
    time_limit: float | None = None,
    seed: int = 0,
    progress: bool | None = None,
) -> Plan:
    """Design a motion that is safe at every instant and shows the parameters.

    The motion is checked at every instant, not on a grid. Interrupted (Ctrl-C), the search
    returns the best motion so far, checked like any other. The same arguments give the same plan,
    except with a `time_limit`. See docs/guides/excitation.md.

    Parameters
    ----------
    robot : RobotModel, str or path
        The robot, on a fixed base: anything that `load_robot` takes.
    duration : float, optional
        Duration of the motion, or of one of its periods, s.
    limits : Limits, optional
        Limits that narrow the description's, of which 95 % are used.
    obstacles : iterable of Plane, Box, Mesh, optional
        What stands around the robot, in its base frame.
    collisions : bool, optional
        Whether the robot must not touch itself or obstacles; by default it keeps 30 mm.
    friction : iterable of str or FrictionTerm, optional
        Friction terms and other effects (``rotor_inertia``, ``tilt``, ``load``) of the model; by
        default Coulomb and viscous friction and offsets.
    prior : Prior or bool, optional
        What is known of the links before the run; by default that of `identify`.
    previous : Estimate, Identification, recordings or paths, optional
        Earlier runs: the plan asks for what they left open.
    noise : float, sequence, mapping or ExpectedNoise, optional
        Standard deviation of the efforts' white noise at 500 Hz, N·m; by default that of the
        earlier runs, else what is usual on real robots.
    purpose : {"all", "payload", "friction", "gravity", "torque"}, optional
        What the run is for; ``torque`` predicts the efforts of the motion `predict`.
    predict : Trajectory, optional
        The motion whose efforts are to be predicted.
    objective : {"mixed", "D", "A", "E", "V", "condition"}, optional
        What is made small; by default ``mixed`` for all parameters (log det and condition
        number), else what fits the purpose.
    motion : {"spline", "fourier", "postures", "one_by_one"}, optional
        Splines show most. Fourier series are for controllers that want them, postures for robots
        that are read out at rest, and one joint at a time for its friction.
    closed : bool, optional
        Whether a spline ends where it began, so that it can be repeated.
    harmonics : int, optional
        Harmonics of a Fourier series; by default up to 0.6 Hz.
    start : array_like, shape (n,), optional
        Where the motion begins and ends; by default the search chooses.
    periods : int, optional
        How often the motion is run.
    torque_spread : float, optional
        Standard deviations of the prior by which torques may be larger than nominal.
    package_dirs : iterable of paths, optional
        Folders in which the description's meshes are looked up.
    starts : int, optional
        Number of starts of the search; ignored with a `time_limit`.
    time_limit : float, optional
        Seconds that search and check may take; by default as long as the starts need. The first
        plan on a machine takes longer, for compiling.
    seed : int, optional
        Seed of everything that is random.
    progress : bool, optional
        Show a progress bar; by default on a terminal.

    Returns
    -------
    Plan
        The motion, the proof that it holds its limits, and the expected errors.

    Raises
    ------
    ModelError
        When the base floats, loops close, or the robot touches itself or an obstacle at rest.
    DataError
        When arguments contradict each other, or the duration is too short for the limits.
    InfeasibleError
        When no motion is found that moves and holds all limits: it says which stand in the way.
    MissingExtraError
        When CasADi is not installed (extra ``excite``).

    Notes
    -----
    A change of units changes the optimum of ``A`` and ``E``: they are in units of what moves the
    efforts of usual motions by 1 N·m.

    Examples
    --------
    >>> arm = sdpid.RobotModel.from_mdh([{"r": 0.3}, {"alpha": -np.pi / 2}], name="arm")
    >>> slow = sdpid.Limits(velocity=1.5, acceleration=5.0)
    >>> plan = sdpid.design_excitation(arm, duration=5.0, limits=slow, starts=1)
    >>> plan.limits.ok, plan.trajectory.duration
    (True, 5.0)
    >>> plan.names[:3], plan.standard_errors.shape
    (('zzr1', 'Fs1', 'Fsg1'), (16,))
    """
    # All arguments: this has to come first.
    given = dict(locals())
    require_search(time_limit, starts=starts)
    model = robot if isinstance(robot, RobotModel) else load_robot(robot)
    require_open_chain(model, "excitation")
    if not model.n_base:
        _compile(model)
    began = time.monotonic()
    terms = FRICTION if friction is None else tuple(friction)
    given |= {"obstacles": tuple(obstacles), "friction": terms, "package_dirs": tuple(package_dirs)}
    asked = Request(**given)
    task = Task.of(model, asked)
    search, rng = task.search, generator(seed)
    homes = task.held.homes(search.start, rng)
    kept = (_KEPT * (time.monotonic() - began), _KEPT_SHARE)
    (best, check), found, stopped = designed(search, homes, rng, asked, began, kept)
    kind = search.criterion.objective.kind
    notes = [*task.notes, f"motion '{motion}': {MOTIONS[motion]}."]
    notes += [f"objective '{kind}': {WORDS[kind]}.", *_notes(found, stopped, time_limit)]
    trajectory = task.held.trajectory(best.space.curve(best.x))
    scored = (part[::_SCORED] for part in trajectory.sample())
    W = task.rows.rows(*scored).reshape(-1, task.rows.count)
    excitation = Excitation.of(W / np.sqrt(len(W) / model.n), task.rows.base.names)
    lengths, values = excitation.column_norms, excitation.singular_values
    shown = bool(values[-1] >= UNDETERMINED)
    if not shown:
        notes.append(
            "the motion alone does not show every base parameter: its condition number is "
            "infinite. What stays open is named."
        )
    # Without earlier runs, which are about the plan's terms, the terms are those of `identify`.
    try:
        expected = expect(
            model,
            trajectory,
            friction=terms if friction is not None or task.earlier is not None else None,
            noise=task.noise,
            prior=prior,
            earlier=task.earlier,
            limits=search.limits,
            motions=None if predict is None else {"the motion to be predicted": predict.sample()},
        )
    except DataError as cause:
        raise InfeasibleError(
            f"excitation of '{model.name}': within these limits the best motion tells nothing that "
            f"can be identified ({cause}) Widen the limits that slow it, or give it more time."
        ) from cause
    return Plan(
        robot=model,
        trajectory=trajectory,
        limits=check,
        joint_limits=search.limits,
        collision=task.held.collision,
        names=expected.base.names,
        standard_errors=expected.standard_errors,
        condition_number=excitation.condition_number if shown else np.inf,
        log_det=2.0 * float(np.log(lengths * values).sum()) if shown else -np.inf,
        expected=expected,
        objective=kind,
        purpose=purpose,
        motion=motion,
        notes=tuple(notes),
        settings=settings_of(
            given,
            robot=model.name if isinstance(robot, RobotModel) else robot,
            previous=_named(previous),
            predict=None,
            progress=None,
        ),
        history=tuple(_row(candidate) for candidate in found),
    )


def _compile(robot: RobotModel) -> None:
    """Evaluate the regressor once, which compiles it on its first use on a machine."""
    rows = BaseRows.of(robot, ())
    still = np.zeros((max(1, _STATES // robot.n), robot.n))
    rows.gradient(rows.rows(still, still, still), still, still, still)


def _notes(found: list[Candidate], stopped: bool, time_limit: float | None) -> list[str]:
    """Return how the search went."""
    values = ", ".join(f"{each.value:.3f}" for each in found)
    starts = len({each.start for each in found})
    notes = [
        f"the search found its best motion from start {found[0].start + 1} of {starts} (objectives "
        f"of coarse and refined motions {values}): others may be better, and no bound says by how "
        "much."
    ]
    if stopped and (time_limit is None or any(each.status == INTERRUPTED for each in found)):
        notes.append("the search was interrupted: this is the best motion that it had found.")
    elif stopped:
        notes.append("the search ended at its time limit.")
    return notes


def _named(previous: Previous | None) -> Any:
    """Return the paths of earlier runs, or words for what has no path."""
    if previous is None or isinstance(previous, str | os.PathLike):
        return previous
    if isinstance(previous, list | tuple):
        return [_named(each) for each in previous]
    return type(previous).__name__


def _row(candidate: Candidate) -> dict[str, Any]:
    return {
        "start": candidate.start,
        "numbers": candidate.space.size,
        "objective": candidate.value,
        "steps": candidate.steps,
        "seconds": candidate.seconds,
        "status": candidate.status,
    }
