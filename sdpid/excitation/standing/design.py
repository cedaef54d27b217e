"""Design a motion of a robot that stands, which shows its parameters."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, generator
from sdpid.errors import DataError
from sdpid.estimation.prior.prior import Prior
from sdpid.excitation.criterion.noise import Given
from sdpid.excitation.design.loop import designed
from sdpid.excitation.limits.limits import Limits
from sdpid.excitation.plan.plan import settings_of
from sdpid.excitation.search.search import require_search
from sdpid.excitation.standing.plan import StandingPlan
from sdpid.excitation.standing.task import StandingRequest, StandingTask
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel

# Friction terms of a plan, where none are named.
FRICTION = ("coulomb", "viscous", "rotor_inertia")
# Starts of the search, and steps of one.
STARTS, STEPS = 1, 30
# Of a time limit, what is kept for the check, at most seconds and this share.
_KEPT_SECONDS, _KEPT_SHARE = 5.0, 0.2
# Samples a second at which the information of the motion that is found is summed.
_INFORMED_HZ = 50.0


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
    # All arguments: this has to come first.
    given = dict(locals())
    require_search(time_limit, starts=starts, steps=steps)
    if not isinstance(robot, RobotModel):
        robot = load_robot(robot, root="free_flyer")
    given |= {"robot": robot, "friction": FRICTION if friction is None else tuple(friction)}
    given["previous"] = _plans(previous)
    began, kept = time.monotonic(), 0.0
    task = StandingTask.of(StandingRequest(**given))
    search = task.search
    if time_limit is not None:
        kept = min(_KEPT_SECONDS, _KEPT_SHARE * time_limit)
        search = replace(search, deadline=began + time_limit - kept)
    (best, check), _, stopped = designed(
        search,
        [np.zeros(search.space.n)] * starts,
        generator(seed),
        starts=starts,
        began=began,
        kept=kept,
        progress=progress,
    )
    notes = [*task.notes]
    if stopped:
        notes.append("the search was ended early: this is the best motion that it had found.")
    known = search.criterion.known
    curve = best.space.curve(best.x)
    grid = best.space.grid(rate=_INFORMED_HZ)
    W = task.rows.rows(*(curve.evaluate(grid, derivative=order) for order in range(3)))
    flat = W.reshape(-1, W.shape[2])
    information = curve.duration / len(grid) * (flat.T @ flat)
    before, after = (_deviations(each) for each in (known, known + information))
    # Not the stance of the search, which keeps all states that it looked at last.
    held = replace(task.held, stance=replace(task.held.stance))
    return StandingPlan(
        stance=held.stance,
        curve=curve,
        limits=check,
        held=held,
        base=task.rows.regressor.base,
        values=task.values,
        standard_errors=after,
        before=before,
        information=information,
        known=known,
        spread=task.rows.spread,
        notes=tuple(notes),
        settings=settings_of(given, robot=robot.name, prior=None, previous=None, progress=None),
    )


def _plans(previous: Any) -> tuple[StandingPlan, ...]:
    """Return earlier plans as a tuple; None is none."""
    plans = previous if isinstance(previous, list | tuple) else (previous,)
    if previous is None:
        return ()
    for each in plans:
        if not isinstance(each, StandingPlan):
            raise DataError(
                f"previous: is or holds {each!r:.80}; give what design_standing returned, one "
                "plan or several."
            )
    return tuple(plans)


def _deviations(information: Array) -> Array:
    """Return standard errors (b,) of an information that leaves nothing open."""
    size = np.sqrt(np.diag(information))
    inverse = np.linalg.inv(information / np.outer(size, size))
    return np.asarray(np.sqrt(np.diag(inverse)) / size)
