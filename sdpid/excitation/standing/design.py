"""Design a motion of a robot that stands, which shows its parameters."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, generator
from sdpid.errors import DataError, InfeasibleError
from sdpid.estimation.prior.prior import Prior
from sdpid.excitation.criterion.noise import Given
from sdpid.excitation.limits.check import LimitCheck
from sdpid.excitation.limits.limits import Limits
from sdpid.excitation.plan.settings import settings_of
from sdpid.excitation.search.inequalities import InstantRows
from sdpid.excitation.search.ipopt import require_solver
from sdpid.excitation.search.search import Candidate, Search
from sdpid.excitation.search.space import Space
from sdpid.excitation.search.starts import random_start
from sdpid.excitation.search.steps import counted_steps
from sdpid.excitation.standing.check import check_standing
from sdpid.excitation.standing.held import Held
from sdpid.excitation.standing.plan import StandingPlan
from sdpid.excitation.standing.task import StandingTask
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel

# Friction terms of a plan, where none are named.
FRICTION = ("coulomb", "viscous", "rotor_inertia")
# Starts of the search, steps of one, and as a share of them those of the best with twice the
# intervals, which four times would make finer than what the criterion looks at. Of 10 s of a Solo12
# the first ten steps bring a mean log of -15.62 to -15.92, the next twenty nothing, and 15 steps
# with twice the intervals -16.05.
STARTS, STEPS, _REFINING = 1, 30, 0.5
# Of a time limit, what is kept for the check, at most seconds and this share.
_KEPT_SECONDS, _KEPT_SHARE = 5.0, 0.2
# Share of limits that is used there; rounds of search and check, each with less of it, and steps.
_SHARE, _ROUNDS, _STEPS = 0.97, 4, 40
# How much less than what was missing, and by which share at least and at most: nothing bounds the
# friction that a foot would need which is pulled.
_BEYOND, _LEAST, _MOST = 1.3, 1e-3, 1.0
# Shares of a motion that are tried where no search mends it.
_SHRINKS = (0.97, 0.93, 0.85, 0.7, 0.5, 0.3, 0.1)


def design_standing(
    robot: RobotModel | str | os.PathLike[str],
    *,
    duration: float = 10.0,
    limits: Limits | None = None,
    sway: float | None = None,
    tilt: float = 0.35,
    grip: float = 0.5,
    load: float = 0.3,
    friction: Iterable[str | FrictionTerm] | None = None,
    prior: Prior | None = None,
    previous: StandingPlan | Sequence[StandingPlan] = (),
    noise: Given = None,
    standing: Sequence[float] | None = None,
    feet: Sequence[str] | None = None,
    starts: int = STARTS,
    steps: int = STEPS,
    time_limit: float | None = None,
    seed: int = 0,
    progress: bool | None = None,
) -> StandingPlan:
    """Design a motion of a robot on legs that stands, which shows its parameters.

    The base moves along splines of fifth degree, from rest to rest; the feet stay where they are,
    and joints beside the legs move as well. What is made large is the information that rows carry
    which no force of the ground enters, together with what a prior believes (log det). Forces
    stay in their friction cones, and every foot bears some weight; of all forces that carry a
    motion these are the centered ones.

    Parameters
    ----------
    robot : RobotModel, str or path
        A robot on legs, as `simulate_legged` takes it: anything that `load_robot` takes.
    duration : float, optional
        Duration of the motion, s.
    limits : Limits, optional
        Limits that narrow the description's, of which 95 % are used; of torques 20 % are kept for
        friction. Accelerations and jerks of joints are not limited.
    sway : float, optional
        The base moves by at most this much along each axis, m; by default a quarter of its height
        on balls, and a tenth on soles.
    tilt : float, optional
        It turns by at most this much about each axis, rad.
    grip : float, optional
        Coefficient of friction of the ground that may be used. The same robots used up to 0.19
        more than planned.
    load : float, optional
        Least normal force of a foot, as a share of what it bears when the robot stands. Of a
        Solo12 whose links are 15 % off, feet bore up to 0.17 less than planned (three seeds).
    friction : iterable of str or FrictionTerm, optional
        Friction terms of the model; by default Coulomb, viscous and rotor inertia.
    prior : Prior, optional
        What is known of the links before the run; by default that of `identify`.
    previous : StandingPlan or sequence of them, optional
        Plans that are run beside this one, such as those of other stances: this one asks for what
        they leave open. They need the same friction terms.
    noise : float, sequence, mapping or ExpectedNoise, optional
        Standard deviation of the efforts' white noise at 500 Hz, N·m; by default what is usual on
        real robots.
    standing : array_like, shape (joints,), optional
        Joint positions in which the robot stands, rad; by default knees are bent. They say where
        the feet are.
    feet : sequence of str, optional
        Frames at the feet; by default links with 'sole' or 'foot' in their names.
    starts : int, optional
        Number of random starts of the search; the best is refined.
    steps : int, optional
        Largest number of steps from one start; refining takes half of them at most.
    time_limit : float, optional
        Seconds that search and check may take; without, the same arguments give the same plan.
    seed : int, optional
        Seed of everything that is random.
    progress : bool, optional
        Show a progress bar; by default on a terminal.

    Returns
    -------
    StandingPlan

    Raises
    ------
    ModelError
        When the robot has no feet, other legs than are supported, or no masses.
    DataError
        When a number is out of range, or the robot cannot even stand within its limits.
    InfeasibleError
        When no motion is found that moves and holds all limits.
    MissingExtraError
        When CasADi is not installed (extra ``excite``).

    Examples
    --------
    >>> standing = sdpid.design_standing("solo12", duration=2.0, steps=2)
    >>> standing.limits.ok, standing.motion
    (True, WholeBodyMotion(12 joints, 4 feet, 2 s))
    """
    require_solver()
    if not isinstance(robot, RobotModel):
        robot = load_robot(robot, root="free_flyer")
    for name, number in (("starts", starts), ("steps", steps)):
        if number < 1:
            raise DataError(f"{name}: is {number}; give at least 1.")
    if time_limit is not None and not time_limit > 0.0:
        raise DataError(f"time_limit: is {time_limit}; give a positive time in s.")
    earlier = (previous,) if isinstance(previous, StandingPlan) else tuple(previous)
    began = time.monotonic()
    terms = FRICTION if friction is None else tuple(friction)
    asked: dict[str, Any] = {
        "duration": duration,
        "sway": sway,
        "tilt": tilt,
        "grip": grip,
        "load": load,
    }
    task = StandingTask.of(
        robot,
        **asked,
        limits=limits,
        friction=terms,
        prior=prior,
        earlier=[(plan.base.names, plan.information) for plan in earlier],
        noise=noise,
        standing=standing,
        feet=feet,
        seed=seed,
    )
    deadline = np.inf
    if time_limit is not None:
        deadline = began + time_limit - min(_KEPT_SECONDS, _KEPT_SHARE * time_limit)
    search = Search(
        space=task.space,
        criterion=task.criterion,
        limits=task.coordinates,
        start=np.zeros(task.space.n),
        deadline=deadline,
    )
    total = starts * steps + _refining(steps)
    with counted_steps(total, began, deadline, progress) as step:
        found, stopped = _searched(task, search, seed, starts, steps, step)
        best, check = _mended(task, search, found)
    notes = [*task.notes]
    if stopped:
        notes.append("the search was ended early: this is the best motion that it had found.")
    known = task.criterion.known
    information = _information(task, best)
    before, after = (_deviations(each) for each in (known, known + information))
    return StandingPlan(
        stance=task.stance,
        curve=best.space.curve(best.x),
        limits=check,
        held=task.held,
        base=task.rows.base,
        values=task.values,
        standard_errors=after,
        before=before,
        information=information,
        known=known,
        spread=task.rows.spread,
        notes=tuple(notes),
        settings=settings_of(
            robot=robot.name,
            **asked,
            limits=limits,
            friction=terms,
            noise=noise,
            standing=None if standing is None else list(standing),
            feet=None if feet is None else list(feet),
            starts=starts,
            steps=steps,
            time_limit=time_limit,
            seed=seed,
        ),
    )


def _refining(steps: int) -> int:
    """Return the steps of the best motion with twice the intervals."""
    return math.ceil(_REFINING * steps)


def _searched(
    task: StandingTask, search: Search, seed: int, starts: int, steps: int, step: Callable[[], None]
) -> tuple[Candidate, bool]:
    """Return the best motion from random starts, refined, and whether the search was stopped."""
    found: list[Candidate] = []
    rows, stopped = _rows(task.space, task.held, _SHARE), False
    for number, start in enumerate(_starts(task, search, rows, seed, starts)):
        candidate, stopped = search.improve(start, rows, number=number, most_steps=steps, step=step)
        found.append(candidate)
        if stopped:
            break
    best = min(found, key=lambda each: each.value)
    refined = None if stopped else best.space.refined(best.x)
    if refined is not None:
        space, x = refined
        rows = _rows(space, task.held, _SHARE)
        best, stopped = search.on(space).improve(
            _shrunk(rows, x), rows, number=best.start, most_steps=_refining(steps), step=step
        )
    return best, stopped


def _starts(
    task: StandingTask, search: Search, rows: InstantRows, seed: int, count: int
) -> Iterator[Array]:
    """Yield random motions within all limits."""
    rng, home = generator(seed), np.zeros(task.space.n)

    def holds(x: Array) -> bool:
        return bool(np.min(rows.values(x)) > 0.0)

    for _ in range(count):
        yield random_start(task.space, search.linear, home, rng, holds)


def _rows(space: Space, held: Held, share: float) -> InstantRows:
    """Return the limits at the instants at which the criterion looks.

    At others a leg might be stretched where only the criterion looks: its rows grow without bound
    there, and the search would find little else.
    """
    return InstantRows(space=space, parts=[(replace(held, share=share), space.grid())])


def _mended(
    task: StandingTask, search: Search, candidate: Candidate
) -> tuple[Candidate, LimitCheck]:
    """Return a motion that holds all limits at all checked instants, and the check.

    Raises
    ------
    InfeasibleError
        When none is found, or it stands still.
    """
    name, space, share = task.robot.name, candidate.space, _SHARE
    check = check_standing(task.held, space.curve(candidate.x))
    for _ in range(_ROUNDS):
        if check.ok:
            break
        share = _narrowed(share, check)
        rows = _rows(space, task.held, share)
        candidate, stopped = search.on(space).improve(
            _shrunk(rows, candidate.x), rows, number=candidate.start, most_steps=_STEPS
        )
        check = check_standing(task.held, space.curve(candidate.x))
        if stopped:
            break
    x = candidate.x
    for shrink in _SHRINKS:
        if check.ok:
            break
        # Standing still is zero: what is left of it is a smaller motion.
        candidate = replace(candidate, x=shrink * x)
        check = check_standing(task.held, space.curve(candidate.x))
    if not check.ok:
        raise InfeasibleError(
            f"excitation of '{name}': no motion was found that holds every limit; even a tenth of "
            f"the best: {' '.join(check.sentences()[:3])} Widen these limits, or change the stance."
        )
    if not np.abs(candidate.x).max() > 1e-6:
        raise InfeasibleError(
            f"excitation of '{name}': no motion was found, the robot stands still. Give the search "
            "more time, or wider limits."
        )
    return candidate, check


def _narrowed(share: float, check: LimitCheck) -> float:
    """Return the share of limits to be used next, from that in use and what was broken."""
    worst = max(-row.slack / (abs(row.limit) or 1.0) for row in check.broken)
    return share / (1.0 + _BEYOND * min(max(worst, _LEAST), _MOST))


def _shrunk(rows: InstantRows, x: Array) -> Array:
    """Return a motion as large as may be, on the way to standing still, that holds rows."""
    for share in 0.95 ** np.arange(60):
        if np.min(rows.values(share * x)) > 0.0:
            return np.asarray(share * x)
    return np.zeros_like(x)


def _information(task: StandingTask, candidate: Candidate) -> Array:
    """Return the information (b, b) of a motion, signs as they are."""
    space = candidate.space
    grid = space.grid(rate=50.0)
    c = space.coefficients(candidate.x)
    states = [space.basis(grid, order) @ c for order in range(3)]
    W = task.rows.rows(*states)
    flat = W.reshape(-1, W.shape[2])
    return np.asarray(space.duration / len(grid) * (flat.T @ flat))


def _deviations(information: Array) -> Array:
    """Return standard errors (b,) of an information that leaves nothing open."""
    size = np.sqrt(np.diag(information))
    inverse = np.linalg.inv(information / np.outer(size, size))
    return np.asarray(np.sqrt(np.diag(inverse)) / size)
