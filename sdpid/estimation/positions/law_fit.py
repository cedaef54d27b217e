"""What a log of positions says of drives under a known law: numbers, intervals, what is open."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.tables import Shown, Table, plain_dict
from sdpid.errors import DataError, SolverError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.positions.choose import (
    CONSTANTS,
    RICHER,
    ROUGH,
    WHITE,
    ForwardChoice,
    choose_forward,
    judged,
)
from sdpid.estimation.positions.drives import LONGEST_DELAY, UNITS, DriveNumbers
from sdpid.estimation.positions.fit import (
    FALL,
    PositionFit,
    SolvedRollouts,
    conditional,
    fit_positions,
)
from sdpid.estimation.positions.links import (
    JointNormal,
    drives_with,
    links_of,
    theta_with,
    with_links,
)
from sdpid.estimation.positions.rollout import STEP, CommandedLog
from sdpid.estimation.problem import build_problem
from sdpid.experiment.processing.process import process
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.simulation.controllers import PD
from sdpid.experiment.simulation.law import with_efforts_of_law
from sdpid.robot.friction.posed import PositionFriction
from sdpid.robot.model.model import RobotModel

# Where a model is used: what its friction may be.
Target = Literal["mujoco", "isaac", "urdf"]

# Two-sided 95 % of a normal distribution.
_NORMAL = 1.959964

# A delay is known where its interval is no longer than this, s.
_SHARP = 2e-3

# The relative fall of the cost that a round must promise before the choice: links move after it.
_ROUGHER = 1e-3

# Delays (s) from which constants are fitted: the best of these starts counts.
_STARTS = (0.002, 0.01)

# Steps for the links before the choice: as long as one lowers the error by this share, or so many.
_FELL, _MOST_STEPS = 0.2, 4

# Steps for the links after the choice, where nothing is missing in the model.
_POLISHED = 2

# What JSON has of a fit under the same names.
_LISTED = (
    *("target", "kinds", "rms", "rms_reduced", "starts", "complete", "remaining", "proof"),
    *("along", "given_up", "notes", "warnings", "delay_found"),
)

# Delays over which numbers are shown.
_SHOWN = 11

# A given delay or kp is named as wrong where a fit that leaves it open has a smaller sum of squares
# by this share; kp, on which positions alone hardly depend, where the description's masses ask for
# one that is so many times as large or small.
_WRONG, _SCALE = 0.1, 1.3

# Whether it may be so is seen by a fit that ends where a round promises this fall of the cost: what
# is left to gain then is a small part of the share above.
_GLANCE = 0.01


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class FittedDrives(Shown):
    """Drives of a robot, fitted to positions of rollouts under a known law.

    The convex fit to the law's efforts gives a start, and its optimum is proven. From there on
    these numbers and the links of `convex`, which stay consistent, are moved to fit positions: the
    best of several starts of a Gauss-Newton search, not proven (`proof` has that in words).

    Attributes
    ----------
    law : PD
        The law, its delay filled in, and kp where that was to be found.
    target : {"mujoco", "isaac", "urdf"}
        Where the model will be used.
    joint_names : tuple of str
        The joints.
    rich : DriveNumbers
        Drives with the friction that the data ask for.
    reduced : DriveNumbers
        Drives with constants: what every simulator can hold.
    choice : ForwardChoice
        How kinds of friction and the delay were chosen.
    starts : tuple of float
        Errors (rad, rms) of constants, fitted from several delays with the first links.
    delay_found : bool
        Whether the delay was to be found.
    delay_interval : tuple of 2 float
        95 % interval of the delay, s.
    names : tuple of str
        Names of the fitted numbers, the delay's last where it was found.
    covariance : ndarray, shape (k, k)
        Of these numbers, the open delay counted.
    complete : bool
        Whether residuals are those of encoders, so that nothing is missing in the model.
    remaining : float or None
        Bound on the share of the cost that a convex step about the result could still take away;
        None where it was not solved.
    rms, rms_reduced : float
        Errors of position (rad) on the fitted logs with rich and with reduced drives.
    rms_joints : ndarray, shape (n,)
        Errors of every joint with rich drives, rad (m).
    speed : ndarray, shape (n,)
        Usual speed of every joint, rad/s (m/s), at which damping and dry friction are summed.
    along : dict
        Over ``delay`` (D,): ``error`` (D,) on the part that was judged, ``armature`` and
        ``damping`` (D, n) of the fits at that delay.
    convex : Estimate
        The links that are written, as positions show them, with all constraints and the prior: the
        last of several convex steps. No certificate is of them.
    validated : float or None
        Error of position (rad) on other logs, with rich drives; None without any.
    notes : tuple of str
        Choices in words.
    warnings : tuple of str
        What of the law the data contradict.
    """

    law: PD
    target: Target
    joint_names: tuple[str, ...]
    rich: DriveNumbers
    reduced: DriveNumbers
    choice: ForwardChoice
    starts: tuple[float, ...]
    delay_found: bool
    delay_interval: tuple[float, float]
    names: tuple[str, ...]
    covariance: Array
    complete: bool
    remaining: float | None
    rms: float
    rms_reduced: float
    rms_joints: Array
    speed: Array
    along: dict[str, Array]
    convex: Estimate
    notes: tuple[str, ...]
    warnings: tuple[str, ...] = ()
    validated: float | None = None

    @property
    def delay(self) -> float:
        """Time from a command to its effort, s."""
        return self.rich.delay

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of numbers that were fitted."""
        return self.choice.rows

    @property
    def values(self) -> Array:
        """The fitted numbers, as `names` lists them, (k,)."""
        rows = np.concatenate([self.rich[kind] for kind in self.kinds])
        return np.append(rows, self.delay) if self.delay_found else rows

    def intervals(self) -> dict[str, tuple[float, float, float]]:
        """Return every number's value and the ends of its 95 % interval, by name."""
        half = _NORMAL * np.sqrt(np.diag(self.covariance))
        found = {
            name: (float(x), float(x - h), float(x + h))
            for name, x, h in zip(self.names, self.values, half, strict=True)
        }
        if self.delay_found:
            found["delay"] = (self.delay, *self.delay_interval)
        return found

    def sharp(self) -> dict[str, tuple[float, ...]]:
        """Return per joint friction + (damping + kp·delay)·speed, its deviation, and damping's.

        In N·m (N): what the log shows best, at the joint's usual speed.
        """
        n, count = len(self.joint_names), len(self.names)
        damping, friction = (n * self.kinds.index(x) + np.arange(n) for x in CONSTANTS[1:])
        rows = np.zeros((n, count))
        rows[np.arange(n), friction], rows[np.arange(n), damping] = 1.0, self.speed
        if self.delay_found:
            rows[:, -1] = self.rich["kp"] * self.speed
        own = np.sqrt(np.einsum("ij,jk,ik->i", rows, self.covariance, rows))
        alone = np.sqrt(np.diag(self.covariance))[damping] * self.speed
        sums = np.stack([rows @ self.values, own, alone], axis=1).tolist()
        return dict(zip(self.joint_names, map(tuple, sums), strict=True))

    def sharp_table(self) -> Table:
        """Return `sharp` as a table, a row a joint."""
        rows = [(joint, *values) for joint, values in self.sharp().items()]
        names = ("joint", "value [N.m]", "deviation [N.m]", "deviation of damping alone [N.m]")
        return Table(names, tuple(rows))

    @property
    def summary(self) -> str:
        """The errors of positions in a sentence."""
        parts = [f"constants {1e3 * self.rms_reduced:.3g}"]
        if "slope" in self.kinds:
            parts.append(f"friction over position {1e3 * self.rms:.3g}")
        judged = 1e3 * self.choice.errors[self.kinds]
        parts.append(f"the fastest third, fitted without it, {judged:.3g}")
        if self.validated is not None:
            parts.append(f"other logs {1e3 * self.validated:.3g}")
        return f"{' | '.join(parts)} mrad rms of rollouts"

    @property
    def proof(self) -> str:
        """What stands for the links and drives, which no proof covers, in words."""
        text = f"not proven: the best of {len(self.starts)} starts of a local search"
        if len(self.starts) == 1:
            text = "not proven: found by a local search from one start"
        if self.remaining is None:
            return text
        # One digit, without a power of ten.
        percent = float(f"{100.0 * self.remaining:.1g}")
        return (
            f"{text}, about which no possible links lower the linearized cost by more than "
            f"{percent:g} % (a bound by duality)"
        )

    @property
    def worst(self) -> str:
        """The joint whose positions err most, in words."""
        j = int(np.argmax(self.rms_joints))
        share = float(self.rms_joints[j] ** 2 / max(np.sum(self.rms_joints**2), 1e-300))
        error = f"{1e3 * self.rms_joints[j]:.3g} mrad rms"
        return f"{self.joint_names[j]}, {error}: {100 * share:.0f} % of all squared errors"

    @property
    def step(self) -> str:
        """What to do next, in words."""
        low, high = self.delay_interval
        if self.delay_found and high - low > _SHARP:
            return (
                "record motion with fast changes of speed (chirps, steps), which tell the delay "
                "from armature and damping; until then randomize over all numbers together"
            )
        if not self.complete:
            return "record another motion and give it with --validation"
        return "none: use identified.xml with this delay"

    @property
    def delay_in_words(self) -> str:
        """The delay, and what stays open."""
        if not self.delay_found:
            return f"{1e3 * self.delay:.3g} ms as given"
        low, high = (1e3 * x for x in self.delay_interval)
        if high - low < 1.0:
            return f"{1e3 * self.delay:.2f} ms ({low:.2f} to {high:.2f})"
        return (
            f"{1e3 * self.delay:.1f} ms, but {low:.1f} to {high:.1f} ms stay open; "
            f"{self.trade_in_words}"
        )

    @property
    def trade_in_words(self) -> str:
        """How armature and damping change with the delay, and what does not."""
        delays, (low, high) = self.along["delay"], self.delay_interval
        width = delays[1] - delays[0]
        near = (delays >= low - width) & (delays <= high + width)
        slopes = [np.polyfit(delays[near], self.along[x][near], 1)[0] for x in CONSTANTS[:2]]
        armature, damping = (1e-3 * float(np.mean(x)) for x in slopes)
        # A number at its bound has no deviation.
        ratios = [part / own for _, own, part in self.sharp().values() if min(own, part) > 0.0]
        sharper = float(np.median(ratios or [1.0]))
        text = (
            f"with each ms armature changes by {armature:+.2g} kg.m2 and damping by {damping:+.2g} "
            "N.m.s/rad"
        )
        if sharper <= 1.0:
            return text
        return (
            f"{text}; friction + (damping + kp*delay)*v is known {sharper:.1f} times better than "
            "damping alone"
        )

    @property
    def given_up(self) -> str:
        """What constants give up, and what that costs."""
        if not {"slope", "curve"} & {*self.kinds}:
            return "nothing: friction shows no dependence on position"
        worst = int(np.argmax(np.ptp(self.levels, axis=0)))
        low, high = self.levels[:, worst].min(), self.levels[:, worst].max()
        return (
            "friction that changes with position (most at "
            f"{self.joint_names[worst]}: {low:.2g} to {high:.2g} N.m) is its mean: positions err "
            f"by {1e3 * self.rms_reduced:.2g} in place of {1e3 * self.rms:.2g} mrad rms"
        )

    def estimate(self, *, rich: bool = False) -> Estimate:
        """Return the robot with these drives: to use, to write and to compute with.

        Parameters
        ----------
        rich : bool, optional
            With friction over position (`PositionFriction`), where the data ask for it, in place
            of constants.
        """
        problem, links = self.convex.problem, 10 * self.convex.problem.robot.n_links
        theta = theta_with(problem, self.convex.some_theta, self.reduced)
        if rich and "slope" in self.kinds:
            low, high = (tuple(self.along[end].tolist()) for end in ("lower", "upper"))
            term = PositionFriction(low, high)
            problem = build_problem(
                problem.robot,
                problem.samples,
                friction=("viscous", "rotor_inertia", term),
                constraints=problem.constraints,
                check_excitation=False,
            )
            kinds = [
                self.rich["damping"],
                self.rich["armature"],
                *term.control_values(self.rich.dry),
            ]
            theta = np.concatenate([theta[:links], *kinds])
        return Estimate.of_theta(
            problem,
            theta,
            method="positions",
            status="given",
            message="fitted to positions under the law",
        )

    @property
    def levels(self) -> Array:
        """Dry friction (16, n) over each joint's range of positions, N·m (N)."""
        low, high = (self.along[end] for end in ("lower", "upper"))
        return self.rich.dry(np.linspace(low, high, 16))

    def _shown(self) -> dict[str, object]:
        return {
            "delay, s": self.delay,
            "delay interval, s": str([round(x, 5) for x in self.delay_interval]),
            "error, rad rms": self.rms,
            f"error with constants ({self.target}), rad rms": self.rms_reduced,
            "complete": self.complete,
        }

    def _tables(self) -> Iterator[Table]:
        yield self.as_table()

    def as_table(self) -> Table:
        """Return a row a joint: the numbers that simulators take, and friction over position."""
        kinds = ("armature", "damping", "friction")
        columns = {f"{x} [{UNITS[x]}]": self.reduced[x].tolist() for x in kinds}
        of_position = [x for x in self.kinds if x in ("slope", "curve")]
        own = {f"{x} of f(q) [{UNITS[x]}]": self.rich[x].tolist() for x in of_position}
        return Table.of_columns({"joint": list(self.joint_names), **columns, **own})

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        ends, parts = ("value", "low", "high"), ("value", "deviation", "deviation_of_damping")

        def by_joint(each: Iterable[Any]) -> dict[str, Any]:
            return dict(zip(self.joint_names, each, strict=True))

        return plain_dict(
            {
                **{name: getattr(self, name) for name in _LISTED},
                "delay_s": self.delay,
                "delay_interval_s": self.delay_interval,
                "delay_fitted_s": self.choice.fitted,
                "kp": self.rich["kp"],
                "kd": self.rich["kd"],
                "limit": self.law.limit,
                "units": UNITS,
                "middle": self.rich.middle,
                "drives": {
                    name: by_joint(dict(zip(UNITS, own, strict=True)) for own in each.values.T)
                    for name, each in (("rich", self.rich), ("reduced", self.reduced))
                },
                "intervals": {
                    name: dict(zip(ends, each, strict=True))
                    for name, each in self.intervals().items()
                },
                "covariance": {"names": self.names, "values": self.covariance},
                "sharp": by_joint(dict(zip(parts, x, strict=True)) for x in self.sharp().values()),
                "rms_joints": by_joint(self.rms_joints),
                "rms_validation": self.validated,
                "judged": {"+".join(k): x for k, x in self.choice.errors.items()},
            }
        )


def fit_law(
    estimate: Estimate,
    logs: Sequence[Recording],
    law: PD,
    *,
    target: Target = "mujoco",
    start: PD | None = None,
    validation: Sequence[Recording] = (),
) -> FittedDrives:
    """Fit drives and links to positions under a law, from an estimate on.

    Parameters
    ----------
    estimate : Estimate
        The convex fit, with terms Coulomb, viscous and rotor inertia: links, and where to begin.
    logs : sequence of Recording
        With commanded positions, their joints in the robot's order.
    law : PD
        With one number a joint.
    target : {"mujoco", "isaac", "urdf"}, optional
        Where the model will be used.
    start : PD, optional
        A law with numbers, to begin with where kp is to be found.
    validation : sequence of Recording, optional
        Other logs, whose positions are predicted only.

    Raises
    ------
    DataError
        When a log is too short or has no commands.
    SolverError
        When the robot does not follow its commands under this law.
    """
    problem = estimate.problem
    followed, others = (
        [CommandedLog.of(log, law) for log in several] for several in (logs, validation)
    )
    where = np.concatenate([each.position for each in followed])
    gains = (start or law).gains
    middle, n = 0.5 * (where.min(axis=0) + where.max(axis=0)), law.n
    drives = DriveNumbers(values=np.zeros((len(UNITS), n)), middle=middle, delay=0.0)
    drives = drives_with(problem, estimate.some_theta, drives)
    # Joints that are lighter shake under this damping, at steps of this length.
    armature = np.maximum(drives["armature"], STEP * gains.derivative)
    drives = drives.with_rows(armature=armature, kp=gains.proportional, kd=gains.derivative)
    rollouts = [each.rollout(links_of(problem, estimate.some_theta)) for each in followed]
    fixed, kinds = law.delay, CONSTANTS if law.kp is not None else (*CONSTANTS, "kp")

    def fitted(begin: SolvedRollouts, rows: Sequence[str], **how: Any) -> PositionFit:
        return fit_positions(begin, rows, **{"delay": fixed is None, "fall": _ROUGHER} | how)

    begun = [
        fitted(SolvedRollouts.of(rollouts, replace(drives, delay=d)), kinds)
        for d in (_STARTS if fixed is None else (fixed,))
    ]
    # With the richest friction, so that links need not make up for what it lacks.
    fit = fitted(min(begun, key=lambda each: each.cost), rich := (*kinds, *RICHER))
    for _ in range(_MOST_STEPS):
        before = fit.rms
        estimate, moved = with_links(estimate, fit)
        fit = fitted(moved, rich)
        if fit.rms > (1.0 - _FELL) * before:
            break
    links = links_of(problem, estimate.some_theta)
    begin = fit.drives.with_rows(slope=0.0, curve=0.0)
    choice, slow = choose_forward(followed, links, begin, rows=kinds, delay=fixed)
    complete = choice.correlation < WHITE
    held = fixed is None and not complete
    found = conditional(slow, choice.delay)[0] if held else slow.drives
    begin_whole = SolvedRollouts.of(fit.rollouts, found, near=fit)
    fit = fitted(begin_whole, choice.rows, held=held, fall=ROUGH if held else FALL)
    for _ in range(_POLISHED if complete else 0):
        estimate, moved = with_links(estimate, fit)
        fit = fitted(moved, choice.rows, fall=FALL)
    normal = JointNormal.of(problem, fit)
    covariance, interval = _delay_interval(normal, estimate, choice, held)
    reduced = fit.drives.with_rows(
        friction=fit.drives.dry(where).mean(axis=0), slope=0.0, curve=0.0
    )
    own = np.concatenate(fit.missed)
    constant = SolvedRollouts.of(fit.rollouts, reduced, fit.starts, fit).missed
    speed = np.sqrt(
        np.mean(np.concatenate([np.gradient(x.position, x.time, axis=0) for x in followed]) ** 2, 0)
    )
    fresh = [each.rollout(links_of(problem, estimate.some_theta)) for each in others]
    return FittedDrives(
        law=replace(law, delay=fit.drives.delay, effort_limit=None, kp=fit.drives["kp"]),
        target=target,
        joint_names=problem.robot.joint_names,
        rich=fit.drives,
        reduced=reduced,
        choice=choice,
        starts=tuple(each.rms for each in begun),
        delay_found=fixed is None,
        delay_interval=interval,
        names=fit.unknowns.names,
        covariance=covariance,
        complete=complete,
        remaining=normal.remaining(theta_with(problem, estimate.some_theta, fit.drives), held=held),
        rms=fit.rms,
        rms_reduced=float(np.sqrt(np.mean(np.concatenate(constant) ** 2))),
        rms_joints=np.sqrt(np.mean(own**2, axis=0)),
        speed=speed,
        along=_along(fit, fixed, where),
        convex=estimate,
        notes=tuple(dict.fromkeys(each.commands.note for each in followed)),
        warnings=(
            *_contradictions(fitted, fit, law, estimate),
            *_too_heavy(logs, law, problem.robot, fit.drives.delay),
        ),
        validated=judged(SolvedRollouts.of(fresh, fit.drives)) if fresh else None,
    )


def first_law(logs: Sequence[Recording], law: PD, robot: RobotModel, delay: float) -> PD:
    """Return a law with numbers to begin with.

    The described links need efforts, which are kp times the error of position less kd times the
    velocity, friction and the rotors' inertia: nonnegative least squares, joint by joint.

    Raises
    ------
    DataError
        When kp is to be found and the description has no masses.
    """
    from scipy.optimize import nnls

    if law.kp is not None:
        return law
    if not np.any(robot.prior[:, 0] > 0.0):
        raise DataError(
            f"law: kp is to be found, and nothing but masses tells its scale; '{robot.name}' has "
            "none described. Give kp, or a description with masses."
        )
    unit = replace(law, kp=np.ones(law.n), kd=np.zeros(law.n), limit=None, effort_limit=None)
    samples = Samples.join([process(with_efforts_of_law(log, unit, delay)) for log in logs])
    q, v, a = samples.position, samples.velocity, samples.acceleration
    needed = robot.inverse_dynamics(robot.prior, q, v, a) + np.asarray(law.kd) * v
    found = []
    for j in range(law.n):
        used = samples.used[:, j]
        columns = np.stack([samples.effort[:, j], -np.sign(v[:, j]), -v[:, j], -a[:, j]], axis=1)
        found.append(float(nnls(columns[used], needed[used, j])[0][0]))
    if not min(found) > 0.0:
        j = int(np.argmin(found))
        raise DataError(
            f"law: kp of {robot.joint_names[j]} cannot be found: the described links do not push "
            "against its error of position; give kp."
        )
    return replace(law, kp=np.array(found), effort_limit=None)


def _delay_interval(
    normal: JointNormal, estimate: Estimate, choice: ForwardChoice, held: bool
) -> tuple[Array, tuple[float, float]]:
    """Return the covariance of the reported numbers and the delay's interval.

    Errors of links count, as data and prior leave them. Where the model is not complete, the
    delay's errors are what stays open, and move all others.
    """
    covariance, moves = normal.covariance(estimate, held)
    delay = normal.fit.drives.delay
    if not normal.unknowns.delay:
        return covariance, (delay, delay)
    if not held:
        half = _NORMAL * float(np.sqrt(covariance[-1, -1]))
        return covariance, (max(delay - half, 0.0), min(delay + half, LONGEST_DELAY))
    ends = min(choice.open[0], choice.fitted), max(choice.open[1], choice.fitted)
    spread = max(ends[1] - delay, delay - ends[0]) / _NORMAL
    return covariance + spread**2 * np.outer(moves, moves), ends


def _along(fit: PositionFit, fixed: float | None, where: Array) -> dict[str, Array]:
    """Return errors, armature and damping over the delay, and the ranges of positions."""
    delays = np.linspace(0.0, LONGEST_DELAY, _SHOWN) if fixed is None else np.array([fixed])
    best = [conditional(fit, d) if fixed is None else (fit.drives, fit.rms) for d in delays]
    found = {kind: np.stack([x[kind] for x, _ in best]) for kind in CONSTANTS[:2]}
    ends = {"lower": where.min(axis=0), "upper": where.max(axis=0)}
    return {"delay": delays, "error": np.array([e for _, e in best]), **found, **ends}


def _contradictions(
    fitted: Callable[..., PositionFit], fit: PositionFit, law: PD, estimate: Estimate
) -> Iterator[str]:
    """Yield a warning where the data contradict the delay or the kp that was given.

    One can make up for the other: the one is named that explains more.
    """
    given, rows = fit.drives, fit.unknowns.rows
    joint_names = estimate.problem.robot.joint_names
    named: list[tuple[float, str]] = []
    for what, kinds in (("delay", rows), ("kp", (*rows, "kp"))):
        if getattr(law, what) is None:
            continue
        delay = what == "delay" or law.delay is None
        try:
            free = fitted(fit, kinds, delay=delay, fall=_GLANCE)
            # Links, which took up what is wrong with it, give it back.
            moved = with_links(estimate, free)[1]
            free = fitted(moved, kinds, delay=delay, fall=_GLANCE)
            if free.cost > (1.0 - 0.5 * _WRONG) * fit.cost:
                continue
            free = fitted(free, kinds, delay=delay, fall=FALL)
        except SolverError:
            continue
        names, deviations = free.unknowns.names, np.sqrt(np.diag(free.covariance))
        own = deviations[[k for k, x in enumerate(names) if x.rstrip("0123456789") == what]]
        if what == "delay":
            off = np.array([free.drives.delay - given.delay])
            stated, better = f"{1e3 * given.delay:.3g} ms", f"{1e3 * free.drives.delay:.3g} ms"
        else:
            # A common factor of a tree hardly shows: the joint is named that is unlike the others.
            times, alike = free.drives["kp"] / given["kp"], np.ones(law.n)
            for joints in fit.rollouts[0].trees:
                alike[joints] = np.median(times[joints])
            common = float(np.median(times))
            off = given["kp"] * (times / alike - 1.0)
            # Two joints differ equally from their mean, but for rounding: the first is named.
            j = int(np.argmax(np.round(np.abs(times / alike - 1.0), 9)))
            stated = f"{given['kp'][j]:.3g} at {joint_names[j]}"
            better = f"about {given['kp'][j] + off[j]:.3g}"
            if abs(common - 1.0) > abs(times[j] / alike[j] - 1.0):
                off = given["kp"] * (common - 1.0)
                stated, better = "of all joints", f"about {common:.3g} times as much"
        if free.cost > (1.0 - _WRONG) * fit.cost or np.all(np.abs(off) <= _NORMAL * own):
            continue
        words = (
            f"the {what} given, {stated}, does not suit the log: {better} leaves "
            f"{1e3 * free.rms:.3g} in place of {1e3 * fit.rms:.3g} mrad rms; leave --{what} out to "
            "have it found"
        )
        named.append((free.cost, words))
    yield from (words for _, words in sorted(named)[:1])


def _too_heavy(
    logs: Sequence[Recording], law: PD, robot: RobotModel, delay: float
) -> Iterator[str]:
    """Yield a warning where described masses ask for a kp that is far from the one given."""
    if law.kp is None:
        return
    try:
        found = first_law(logs, replace(law, kp=None), robot, delay).gains.proportional
    except DataError:
        return
    times = float(np.median(law.gains.proportional / found))
    if not 1.0 / _SCALE < times < _SCALE:
        yield (
            f"the kp given is {times:.2g} times what the described masses ask for (median of the "
            f"joints: {float(np.median(found)):.3g}), and links, friction and armature go with it; "
            "check kp, or the description"
        )
