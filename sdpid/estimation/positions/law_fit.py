"""What a log of positions says of drives under a known law: numbers, intervals, what is open."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

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
    Followed,
    ForwardChoice,
    choose_forward,
    judged,
)
from sdpid.estimation.positions.drives import LONGEST_DELAY, ROW, UNITS, DriveNumbers
from sdpid.estimation.positions.fit import FALL, PositionFit, conditional, fit_positions
from sdpid.estimation.positions.links import SYMBOLS, JointNormal, links_of, with_links
from sdpid.estimation.positions.rollout import LawRollout, Stiction
from sdpid.estimation.problem import build_problem
from sdpid.experiment.processing.process import process
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.simulation.controllers import PD
from sdpid.experiment.simulation.law import Told, with_efforts_of_law
from sdpid.robot.friction.posed import PositionFriction
from sdpid.robot.model.model import RobotModel

# Where a model is used: what its friction may be, and its integrator's step, s.
Target = Literal["mujoco", "isaac", "urdf"]
STEPS: dict[Target, float] = {"mujoco": 0.002, "isaac": 0.002, "urdf": 0.002}

# Two-sided 95 % of a normal distribution.
_NORMAL = 1.959964

# A delay is told where its interval is no longer than this, s.
_SHARP = 2e-3

# The relative fall of the cost that a round must promise before the choice: links move after it.
_ROUGHER = 1e-3

# Delays (s) from which constants are fitted: the best of these starts counts.
_STARTS = (0.002, 0.01)

# Steps for the links before the choice: as long as one lowers the error by this share, or so many.
_FELL, _MOST_STEPS = 0.2, 4

# Steps for the links after the choice, where nothing is missing in the model.
_POLISHED = 2

# Delays over which numbers are shown.
_SHOWN = 11

# A given delay or kp is named as wrong where a fit that leaves it open has a smaller sum of squares
# by this share, and errors on the faster part as well.
_WRONG = 0.1


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class FittedDrives(Shown):
    """Drives of a robot, fitted to positions of rollouts under a known law.

    The convex fit to the law's efforts gives links and a start, and its optimum is proven. From it
    on these numbers and the links, which stay consistent, are the best of several starts of a
    Gauss-Newton search: no proof, but what rollouts and intervals show.

    Attributes
    ----------
    law : PD
        The law, its delay filled in, and kp where that was to be found.
    target : {"mujoco", "isaac", "urdf"}
        Where the model will be used.
    joint_names : tuple of str
        The joints.
    rich : DriveNumbers
        DriveNumbers with the friction that the data ask for.
    reduced : DriveNumbers
        DriveNumbers with constants: what every simulator can hold.
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
        The links, as positions show them, with all constraints and the prior.
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

    def sharp(self) -> dict[str, tuple[float, float, float]]:
        """Return per joint friction + (damping + kp·delay)·speed, its deviation, and damping's.

        In N·m (N): what the log shows best, at the joint's usual speed.
        """
        n, found = len(self.joint_names), {}
        index = {kind: k * n for k, kind in enumerate(self.kinds)}
        for j, joint in enumerate(self.joint_names):
            row = np.zeros(len(self.names))
            row[index["friction"] + j] = 1.0
            row[index["damping"] + j] = self.speed[j]
            if self.delay_found:
                row[-1] = self.rich["kp"][j] * self.speed[j]
            own = float(row @ self.values)
            alone = index["damping"] + j
            parts = float(np.sqrt(self.covariance[alone, alone])) * self.speed[j]
            found[joint] = (own, float(np.sqrt(row @ self.covariance @ row)), parts)
        return found

    def sharp_table(self) -> Table:
        """Return `sharp` as a table, a row a joint."""
        rows = [(joint, *values) for joint, values in self.sharp().items()]
        names = ("joint", "value [N.m]", "deviation [N.m]", "deviation of damping alone [N.m]")
        return Table(names, tuple(rows))

    @property
    def summary(self) -> str:
        """The errors of positions in a sentence."""
        told = [f"constants {1e3 * self.rms_reduced:.3g}"]
        if "slope" in self.kinds:
            told.append(f"friction over position {1e3 * self.rms:.3g}")
        judged = 1e3 * self.choice.errors[self.kinds]
        told.append(f"the fastest third, fitted without it, {judged:.3g}")
        if self.validated is not None:
            told.append(f"other logs {1e3 * self.validated:.3g}")
        return f"{' | '.join(told)} mrad rms of rollouts"

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
        told = [x for x in self.sharp().values() if x[1] > 0.0 and x[2] > 0.0]
        ratios = [parts / own for _, own, parts in told] or [1.0]
        return (
            f"with each ms armature changes by {armature:+.2g} kg.m2 and damping by {damping:+.2g} "
            "N.m.s/rad; friction + (damping + kp*delay)*v is known "
            f"{float(np.median(ratios)):.1f} times better than damping alone"
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
        values = {"Ia": self.rich["armature"], "Fv": self.rich["damping"]}
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
            levels = term.control_values(self.rich.dry)
            values |= dict(zip(("Fpa", "Fpb", "Fpc"), levels, strict=True))
        else:
            values["Fs"] = self.reduced["friction"]
        names = problem.friction.parameters
        found = [values[x.name.rstrip("0123456789")][x.joint] for x in names]
        theta = np.concatenate([self.convex.some_theta[:links], found])
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
        tables = {"rich": self.rich, "reduced": self.reduced}
        found = {
            name: {
                joint: {kind: float(drives[kind][j]) for kind in UNITS}
                for j, joint in enumerate(self.joint_names)
            }
            for name, drives in tables.items()
        }
        return plain_dict(
            {
                "delay_s": self.delay,
                "delay_interval_s": self.delay_interval,
                "delay_found": self.delay_found,
                "delay_fitted_s": self.choice.fitted,
                "kp": self.rich["kp"],
                "kd": self.rich["kd"],
                "limit": None if self.law.limit is None else self.law.limit,
                "target": self.target,
                "units": UNITS,
                "middle": self.rich.middle,
                "drives": found,
                "intervals": {
                    name: dict(zip(("value", "low", "high"), each, strict=True))
                    for name, each in self.intervals().items()
                },
                "covariance": {"names": self.names, "values": self.covariance},
                "sharp": {
                    joint: {"value": value, "deviation": own, "deviation_of_damping": parts}
                    for joint, (value, own, parts) in self.sharp().items()
                },
                "rms": self.rms,
                "rms_joints": dict(zip(self.joint_names, self.rms_joints, strict=True)),
                "rms_validation": self.validated,
                "rms_reduced": self.rms_reduced,
                "judged": {"+".join(k): x for k, x in self.choice.errors.items()},
                "starts": self.starts,
                "complete": self.complete,
                "along": self.along,
                "given_up": self.given_up,
                "notes": self.notes,
                "warnings": self.warnings,
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
    """Fit drives to positions under a law, with the links of an estimate held.

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
        When the target is not known, or a log is too short or has no commands.
    SolverError
        When the robot does not follow its commands under this law.
    """
    if target not in get_args(Target):
        raise DataError(f"target: is {target!r}; use one of {', '.join(get_args(Target))}.")
    assert estimate.theta is not None
    robot, problem = estimate.problem.robot, estimate.problem
    followed, others = (
        [
            Followed(
                time=np.array(log.time),
                position=np.array(log.position),
                told=Told.of(log, law),
                step=STEPS[target],
                stiction=Stiction.mujoco(),
            )
            for log in several
        ]
        for several in (logs, validation)
    )
    where = np.concatenate([each.position for each in followed])
    drives = _begin(estimate, start or law, 0.5 * (where.min(axis=0) + where.max(axis=0)))
    fixed, kinds = law.delay, CONSTANTS if law.kp is not None else (*CONSTANTS, "kp")
    # With the richest friction, so that links need not make up for what it lacks.
    rollouts = [each.rollout(links_of(problem, estimate.theta)) for each in followed]
    begun = [
        fit_positions(rollouts, replace(drives, delay=d), kinds, delay=fixed is None, fall=_ROUGHER)
        for d in (_STARTS if fixed is None else (fixed,))
    ]
    best, rich = min(begun, key=lambda each: each.cost), (*kinds, *RICHER)
    fit = fit_positions(
        rollouts, best.drives, rich, delay=fixed is None, starts=best.starts, fall=_ROUGHER
    )
    for _ in range(_MOST_STEPS):
        before = fit.rms
        estimate, rollouts, drives, starts = _with_links(estimate, rollouts, fit)
        fit = fit_positions(
            rollouts, drives, rich, delay=fixed is None, starts=starts, fall=_ROUGHER
        )
        if fit.rms > (1.0 - _FELL) * before:
            break
    links = links_of(problem, estimate.some_theta)
    begin = fit.drives.with_rows(slope=0.0, curve=0.0)
    choice, slow = choose_forward(followed, links, begin, rows=kinds, delay=fixed)
    complete = choice.correlation < WHITE
    held = fixed is None and not complete
    found = conditional(slow, choice.delay)[0] if held else slow.drives
    how: dict[str, Any] = {"delay": fixed is None, "held": held}
    fit = fit_positions(rollouts, found, choice.rows, **how, fall=ROUGH if held else FALL)
    for _ in range(_POLISHED if complete else 0):
        estimate, rollouts, found, starts = _with_links(estimate, rollouts, fit)
        fit = fit_positions(rollouts, found, choice.rows, **how, starts=starts)
    normal = JointNormal.of(problem, rollouts, fit)
    covariance, interval = _spread(normal, estimate, fit, choice, held)
    reduced = fit.drives.with_rows(
        friction=fit.drives.dry(where).mean(axis=0), slope=0.0, curve=0.0
    )
    own, missed = (
        np.concatenate(
            [
                each.measured - each.positions(each.run(numbers, start))
                for each, start in zip(rollouts, fit.starts, strict=True)
            ]
        )
        for numbers in (fit.drives, reduced)
    )
    speed = np.sqrt(
        np.mean(np.concatenate([np.gradient(x.position, x.time, axis=0) for x in followed]) ** 2, 0)
    )
    fresh = [each.rollout(links_of(problem, estimate.some_theta)) for each in others]
    return FittedDrives(
        law=replace(law, delay=fit.drives.delay, effort_limit=None, kp=fit.drives["kp"]),
        target=target,
        joint_names=robot.joint_names,
        rich=fit.drives,
        reduced=reduced,
        choice=choice,
        starts=tuple(each.rms for each in begun),
        delay_found=fixed is None,
        delay_interval=interval,
        names=fit.unknowns.names,
        covariance=covariance,
        complete=complete,
        rms=fit.rms,
        rms_reduced=float(np.sqrt(np.mean(missed**2))),
        rms_joints=np.sqrt(np.mean(own**2, axis=0)),
        speed=speed,
        along=_along(fit, fixed, where),
        convex=estimate,
        notes=(
            *dict.fromkeys(each.told.note for each in followed),
            f"drives are the best of {len(begun)} starts of a local search",
        ),
        warnings=() if fixed is None else tuple(_named_delay(rollouts, fit)),
        validated=judged(fresh, fit.drives) if fresh else None,
    )


def _with_links(
    estimate: Estimate, rollouts: list[LawRollout], fit: PositionFit
) -> tuple[Estimate, list[LawRollout], DriveNumbers, Sequence[Array]]:
    """Return what a convex step for the links finds, or all as it is."""
    found = with_links(estimate.problem, estimate.some_theta, rollouts, fit)
    return (estimate, rollouts, fit.drives, fit.starts) if found is None else found


def first_law(
    logs: Sequence[Recording], law: PD, robot: RobotModel, delay: float
) -> tuple[PD, tuple[str, ...]]:
    """Return a law with numbers to begin with, and a warning where kp is to be found.

    The described links need efforts, which are kp times the error of position less kd times the
    velocity, friction and the rotors' inertia: nonnegative least squares, joint by joint.

    Raises
    ------
    DataError
        When kp is to be found and the description has no masses.
    """
    from scipy.optimize import nnls

    if law.kp is not None:
        return law, ()
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
    return replace(law, kp=np.array(found), effort_limit=None), (
        "kp is found, and with it every effort, friction and inertia, only as well as the "
        "description's masses are: they alone fix the scale. Give kp where it is known",
    )


def _begin(estimate: Estimate, law: PD, middle: Array) -> DriveNumbers:
    """Return drives as the convex fit has them."""
    names = estimate.named_theta() or {}
    values = np.zeros((len(UNITS), law.n))
    for symbol, kind in (("Ia", "armature"), ("Fv", "damping"), ("Fs", "friction")):
        values[ROW[kind]] = [max(names.get(f"{symbol}{j + 1}", 0.0), 0.0) for j in range(law.n)]
    gains = {"kp": law.gains.proportional, "kd": law.gains.derivative}
    return DriveNumbers(values=values, middle=middle, delay=0.0).with_rows(**gains)


def _spread(
    normal: JointNormal, estimate: Estimate, fit: PositionFit, choice: ForwardChoice, held: bool
) -> tuple[Array, tuple[float, float]]:
    """Return the covariance of the reported numbers and the delay's interval.

    Errors of links count, as data and prior leave them. Where the model is not complete, the
    delay's errors are what stays open, and move all others.
    """
    problem, drives = normal.problem, fit.drives
    p, links = problem.n_theta, 10 * problem.robot.n_links
    closed, places = np.zeros(p, dtype=bool), {}
    for k, parameter in enumerate(problem.friction.parameters):
        kind = SYMBOLS[parameter.name.rstrip("0123456789")]
        places[f"{kind}{parameter.joint + 1}"] = links + k
        closed[links + k] = drives[kind][parameter.joint] <= 0.0
    whole, moves = normal.covariance(estimate, closed, held)
    places |= {name: p + k for k, name in enumerate(normal.names)}
    at = [places[name] for name in fit.unknowns.names]
    covariance, delay = whole[np.ix_(at, at)], drives.delay
    if not fit.unknowns.delay:
        return covariance, (delay, delay)
    if not held:
        half = _NORMAL * float(np.sqrt(covariance[-1, -1]))
        return covariance, (max(delay - half, 0.0), min(delay + half, LONGEST_DELAY))
    ends = min(choice.open[0], choice.fitted), max(choice.open[1], choice.fitted)
    spread = max(ends[1] - delay, delay - ends[0]) / _NORMAL
    return covariance + spread**2 * np.outer(moves[at], moves[at]), ends


def _along(fit: PositionFit, fixed: float | None, where: Array) -> dict[str, Array]:
    """Return errors, armature and damping over the delay, and the ranges of positions."""
    delays = np.linspace(0.0, LONGEST_DELAY, _SHOWN) if fixed is None else np.array([fixed])
    best = [conditional(fit, d) if fixed is None else (fit.drives, fit.rms) for d in delays]
    found = {kind: np.stack([x[kind] for x, _ in best]) for kind in CONSTANTS[:2]}
    ends = {"lower": where.min(axis=0), "upper": where.max(axis=0)}
    return {"delay": delays, "error": np.array([e for _, e in best]), **found, **ends}


def _named_delay(rollouts: Any, fit: PositionFit) -> Iterator[str]:
    """Yield a warning where the data contradict the delay that was given."""
    try:
        free = fit_positions(rollouts, fit.drives, fit.unknowns.rows, delay=True, starts=fit.starts)
    except SolverError:
        return
    k = len(free.unknowns.names) - 1
    deviation = float(np.sqrt(free.covariance[k, k]))
    off = free.drives.delay - fit.drives.delay
    if free.cost < (1.0 - _WRONG) * fit.cost and abs(off) > _NORMAL * deviation:
        yield (
            f"the delay given, {1e3 * fit.drives.delay:.3g} ms, does not suit the log: "
            f"{1e3 * free.drives.delay:.3g} ms leaves {1e3 * free.rms:.3g} in place of "
            f"{1e3 * fit.rms:.3g} mrad rms; leave --delay out to have it found"
        )
