"""The folder of a plan: what to run in every form, its page, and what it was made of.

All files appear together, or none.
"""

from __future__ import annotations

import importlib.util
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from sdpid import __version__
from sdpid._common.arrays import Array
from sdpid._common.extras import installation
from sdpid._common.files import atomic_write_text
from sdpid._common.progress import progress
from sdpid._common.staging import RunFolder, Unwritten
from sdpid._common.tables import Table, plain, plain_dict
from sdpid.errors import ExportError
from sdpid.excitation.geometry.obstacles import obstacles_to_dict
from sdpid.excitation.plan.plan import Plan
from sdpid.excitation.search.ipopt import INTERRUPTED
from sdpid.experiment.trajectory.trajectory import Trajectory
from sdpid.robot.description.catalog import robot_names

# Largest distance between curve and polynomials, rad: below the resolution of any encoder. Curves
# that are polynomials of fifth degree themselves are met exactly.
TOLERANCE = 1e-7

# Points within a piece at which that distance is measured, as shares of its length.
_BETWEEN = np.linspace(0.0, 1.0, 9)[1:-1]

# Halvings after which a piece is taken as it is: by then it is a thousandth of what it was.
_HALVINGS = 10

# Rows: coefficients of s^0 to s^5 of the polynomials with, at s = 0 and s = 1, one of position,
# velocity, acceleration equal to one and the others zero.
_HERMITE = np.array(
    [
        [1.0, 0.0, 0.0, -10.0, 15.0, -6.0],
        [0.0, 1.0, 0.0, -6.0, 8.0, -3.0],
        [0.0, 0.0, 0.5, -1.5, 1.5, -0.5],
        [0.0, 0.0, 0.0, 10.0, -15.0, 6.0],
        [0.0, 0.0, 0.0, -4.0, 7.0, -3.0],
        [0.0, 0.0, 0.0, 0.5, -1.0, 0.5],
    ]
)


@dataclass(frozen=True)
class Piece:
    """A polynomial of fifth degree in s, which runs from 0 to 1.

    Attributes
    ----------
    begin, end : float
        Time in the trajectory, s.
    coefficients : ndarray, shape (6, n)
        Of s^0 to s^5, rad.
    """

    begin: float
    end: float
    coefficients: Array


def pieces(trajectory: Trajectory) -> tuple[Piece, ...]:
    """Return polynomials that follow a trajectory from the end of its first rest to the last.

    Each has position, velocity and acceleration of the trajectory at both ends.

    Parameters
    ----------
    trajectory : Trajectory
        All its periods are among the pieces.

    Returns
    -------
    tuple of Piece
        One begins where the one before it ends.
    """
    made: list[Piece] = []
    for start, curve in trajectory.curves():
        own = [
            piece
            for a, b in pairwise(curve.breaks.tolist())
            for piece in _split(curve, a, b, _HALVINGS)
        ]
        # Only the periodic part is there several times, and what follows it comes later.
        for turn in range(trajectory.periods if curve is trajectory.series else 1):
            shift = start + turn * curve.duration
            made += [Piece(p.begin + shift, p.end + shift, p.coefficients) for p in own]
    return tuple(made)


def _split(curve: Any, begin: float, end: float, halvings: int) -> Iterator[Piece]:
    """Yield pieces of a curve between two times, halved until they follow it."""
    width = end - begin
    ends = np.array([begin, end])
    scaled = np.stack([curve.evaluate(ends, derivative=d) * width**d for d in range(3)])
    coefficients = _HERMITE.T @ scaled.transpose(1, 0, 2).reshape(6, -1)
    inside = curve.evaluate(begin + width * _BETWEEN)
    error = np.abs(np.vander(_BETWEEN, 6, increasing=True) @ coefficients - inside).max()
    if error <= TOLERANCE or halvings == 0:
        yield Piece(begin, end, coefficients)
        return
    middle = 0.5 * (begin + end)
    yield from _split(curve, begin, middle, halvings - 1)
    yield from _split(curve, middle, end, halvings - 1)


# Points per second, at most: controllers interpolate between them with polynomials of fifth degree
# where positions, velocities and accelerations are given.
RATE_HZ = 100.0

# Decimals of a message, without exponents: YAML 1.1 takes these for text where no decimal point is
# before them. And of a program, rad: a ten-thousandth of what the encoders of its arms resolve.
_MESSAGE, _PROGRAM = 12, 10


def write_joint_trajectory(trajectory: Trajectory, path: str | os.PathLike[str]) -> None:
    """Write a whole trajectory as a JointTrajectory message in YAML.

    Times are whole nanoseconds from the first point, at which the robot must stand already.
    """
    atomic_write_text(Path(path), "\n".join(_message(trajectory)) + "\n")


def _message(trajectory: Trajectory) -> Iterator[str]:
    """Yield the lines of the file."""
    step = max(int(trajectory.rate_hz // RATE_HZ), 1)
    time, states = _whole_motion(trajectory)
    last = len(time) - 1
    index = np.append(np.arange(0, last, step), last)
    yield f"# trajectory_msgs/JointTrajectory by sdpid {__version__}; rad or m, and s."
    yield "# The robot must stand at the first point when it starts."
    yield "header:"
    yield "  stamp: {sec: 0, nanosec: 0}"
    yield "  frame_id: ''"
    yield f"joint_names: {json.dumps(list(trajectory.joint_names))}"
    yield "points:"
    nanoseconds = np.rint(1e9 * time[index]).astype(np.int64)
    for when, state in zip(nanoseconds.tolist(), states[:, index].swapaxes(0, 1), strict=True):
        position, velocity, acceleration = (_listed(each, _MESSAGE) for each in state)
        yield f"- positions: {position}"
        yield f"  velocities: {velocity}"
        yield f"  accelerations: {acceleration}"
        yield f"  time_from_start: {{sec: {when // 10**9}, nanosec: {when % 10**9}}}"


def _listed(values: Array, decimals: int) -> str:
    """Return numbers as a list, without exponents."""
    return "[" + ", ".join(f"{value:.{decimals}f}" for value in values.tolist()) + "]"


# Their arms all have that many joints.
JOINTS = 6

# Of the way to the start: slow, so that a hand reaches the button. rad/s and rad/s².
_SPEED, _ACCELERATION = 0.25, 0.5

# Deceleration at the end, where the arm stands anyway, rad/s².
_STOP = 1.0

# Arguments of servoj, its own defaults (script manual): smoothing time in s, gain.
_LOOK_AHEAD, _GAIN = 0.1, 300

_HEAD = """\
# Excitation by sdpid {version}: {seconds:.6g} s, joint positions in rad; for that arm of Universal
# Robots only whose description and surroundings it was made for.
# Needs PolyScope 3.14, 5.9 or newer. Before it runs: set the speed slider to 100 %, payload and
# center of gravity as they are, and clear the way to the first position, which movej below takes
# straight in joint space and nobody has checked for collisions. Let a first run be supervised.
# The arm lags behind by about the look-ahead time: log what it does, not what it was told."""

_PLAY = """\
  global sdpid_time = 0.0
  # Positions c0 + s*c1 + ... + s^5*c5, s from 0 to 1, until the given time.
  def sdpid_play(end_time, width, c0, c1, c2, c3, c4, c5):
    while sdpid_time < end_time:
      local s = 1.0 - (end_time - sdpid_time) / width
      local q = c0 + s * (c1 + s * (c2 + s * (c3 + s * (c4 + s * c5))))
      servoj(q, t=get_steptime(), lookahead_time={look_ahead}, gain={gain})
      sdpid_time = sdpid_time + get_steptime()
    end
  end"""


def write_urscript(trajectory: Trajectory, path: str | os.PathLike[str]) -> None:
    """Write a trajectory as a URScript program.

    The program moves slowly to the first position, waits, follows the motion in every step of the
    controller with ``servoj``, and stops. The motion is written as polynomials of fifth degree,
    so that the program fits every rate of the controller.

    Raises
    ------
    ExportError
        When the robot has not six joints, or the file cannot be written.
    """
    if trajectory.n != JOINTS:
        raise ExportError(
            f"URScript: the motion has {trajectory.n} joints, arms of Universal Robots have "
            f"{JOINTS}; use trajectory.csv or joint_trajectory.yaml."
        )
    atomic_write_text(Path(path), "\n".join(_program(trajectory)) + "\n")


def _program(trajectory: Trajectory) -> Iterator[str]:
    """Yield the lines of the program."""
    parts = pieces(trajectory)
    origin = parts[0].begin
    yield _HEAD.format(version=__version__, seconds=parts[-1].end - origin)
    yield f"# Joints: {', '.join(ascii(name) for name in trajectory.joint_names)}"
    yield "def sdpid_excitation():"
    yield _PLAY.format(look_ahead=_LOOK_AHEAD, gain=_GAIN)
    yield f"  movej({_listed(parts[0].coefficients[0], _PROGRAM)}, a={_ACCELERATION}, v={_SPEED})"
    yield "  sleep(1.0)"
    for piece in parts:
        lists = ", ".join(_listed(each, _PROGRAM) for each in piece.coefficients)
        times = f"{piece.end - origin:.9f}, {piece.end - piece.begin:.9f}"
        yield f"  sdpid_play({times}, {lists})"
    yield f"  stopj({_STOP})"
    yield "end"


def _whole_motion(trajectory: Trajectory) -> tuple[Array, Array]:
    """Return times (K,), and positions, velocities, accelerations (3, K, n), at its own rate.

    From zero to the end, the last instant included.
    """
    _, last = trajectory.curves()[-1]
    end = np.array([last.duration])
    ends = np.stack([last.evaluate(end, derivative=order) for order in range(3)])
    states = np.concatenate([np.stack(trajectory.sample()), ends], axis=1)
    return np.arange(trajectory.n_samples + 1) / trajectory.rate_hz, states


def write_motion_csv(trajectory: Trajectory, path: str | os.PathLike[str]) -> None:
    """Write a whole trajectory as CSV with all digits, its last instant included.

    The columns are ``time`` in s from zero, and ``position_<joint>``, ``velocity_<joint>`` and
    ``acceleration_<joint>`` in rad (m where a joint slides) and s, quantity by quantity.
    """
    time, states = _whole_motion(trajectory)
    quantities = ("position", "velocity", "acceleration")
    names = [f"{quantity}_{name}" for quantity in quantities for name in trajectory.joint_names]
    columns = {"time": time.tolist()}
    columns |= dict(zip(names, np.hstack(list(states)).T.tolist(), strict=True))
    Table.of_columns(columns).write(path)


# What the plan can be made again from, and the files that it names.
PLAN, LIMITS, OBSTACLES = "plan.toml", "limits.toml", "obstacles.toml"

# Written last: it lists the other files.
_RESULT = "plan.json"

# Every file that a plan may have.
NAMES = (
    "trajectory.csv",
    "trajectory.toml",
    "joint_trajectory.yaml",
    "excitation.script",
    "report.html",
    LIMITS,
    OBSTACLES,
    PLAN,
    _RESULT,
)

_FOLDER = RunFolder(NAMES, _RESULT, PLAN, careful=True)

require_writable = _FOLDER.require_writable


def write_plan(
    plan: Plan,
    folder: str | os.PathLike[str],
    *,
    report: Callable[[str], None] | None = None,
    command: str | None = None,
    config: str | None = None,
) -> tuple[Path, ...]:
    """Write a plan into a folder, all files or none.

    ``trajectory.csv`` holds the motion sample by sample, ``trajectory.toml`` what it is made of and
    `simulate` takes, ``joint_trajectory.yaml`` the ROS message trajectory_msgs/JointTrajectory,
    ``excitation.script`` a program for arms of Universal Robots (six turning joints),
    ``report.html`` a page that explains the plan and
    plays the arm, ``plan.toml`` the options that make the plan again, and ``plan.json`` limits,
    expected errors and everything that was assumed.

    Parameters
    ----------
    plan : Plan
        From `design_excitation`.
    folder : str or path
        Made where it does not exist; the files of an earlier plan in it are replaced.
    report : callable, optional
        Called with a sentence for each file that is left out, and why.
    command : str, optional
        The command line that made the plan, for the report.
    config : str, optional
        Text of ``plan.toml``; by default it is made of `Plan.settings`, with ``limits.toml`` and
        ``obstacles.toml`` beside it.

    Returns
    -------
    tuple of Path
        The files.

    Raises
    ------
    ExportError
        When the folder cannot be written to, or holds files of these names that no plan wrote.

    Examples
    --------
    >>> files = sdpid.write_plan(plan, "plan")
    >>> sorted(path.name for path in files)[:3]
    ['joint_trajectory.yaml', 'limits.toml', 'plan.json']
    >>> sdpid.Trajectory.from_toml("plan/trajectory.toml").duration
    5.0
    """
    target = Path(folder)
    note = report or (lambda _: None)
    require_writable(target, writes_config=True)

    def fill(stage: Path) -> dict[str, Any]:
        texts = settings_files(plan, target) if config is None else {PLAN: config}
        if (reason := ended_early(plan)) is not None:
            texts[PLAN] = f"# {reason}\n{texts[PLAN]}"
        for name, text in texts.items():
            (stage / name).write_text(text, encoding="utf-8")
        with progress(2, "writing the plan") as advance:
            _write_motion(plan, stage, note)
            advance(1)
            _write_page(plan, stage, command, note)
            advance(1)
        return plan_content(plan)

    return _FOLDER.write(target, fill, note)


def plan_content(plan: Plan) -> dict[str, Any]:
    """Return a plan's results as plain values: limits, expected errors, notes, assumptions."""
    collision = plan.collision
    told = ("objective", "purpose", "condition_number", "log_det")
    made = ("notes", "motion", "settings")
    content = {
        "sdpid": __version__,
        "robot": plan.robot.name,
        "joint_names": plan.trajectory.joint_names,
        "duration_s": plan.trajectory.duration,
        "rate_hz": plan.trajectory.rate_hz,
        "periods": plan.trajectory.periods,
        **{name: getattr(plan, name) for name in told},
        "standard_errors": dict(zip(plan.names, plan.standard_errors.tolist(), strict=True)),
        "expected": plan.expected.to_dict(),
        "limits": plan.limits.to_dict(),
        "joint_limits": plan.joint_limits,
        "pairs": None if collision is None else collision.pairs,
        "left_out": None if collision is None else collision.left_out,
        "history": plan.history,
        "assumed": plan.limits.notes,
        **{name: getattr(plan, name) for name in made},
    }
    return plain_dict(content)


def ended_early(plan: Plan) -> str | None:
    """Return why the options alone do not make a plan again, None where they do."""
    if plan.settings.get("time_limit") is not None:
        cause = "The search had a time limit"
    elif any(row.get("status") == INTERRUPTED for row in plan.history):
        cause = "The search was interrupted"
    else:
        return None
    return (
        f"{cause}: another run may end elsewhere. trajectory.toml holds this motion without loss."
    )


def _write_motion(plan: Plan, folder: Path, note: Callable[[str], None]) -> None:
    """Write the motion in every form that the robot can take."""
    motion = plan.trajectory
    write_motion_csv(motion, folder / "trajectory.csv")
    motion.to_toml(folder / "trajectory.toml")
    write_joint_trajectory(motion, folder / "joint_trajectory.yaml")
    if motion.n == JOINTS and not np.any(plan.joint_limits.sliding):
        write_urscript(motion, folder / "excitation.script")
    else:
        why = f"arms of Universal Robots have {JOINTS} turning joints, this robot has others"
        note(Unwritten(f"no excitation.script: {why}"))


def _write_page(plan: Plan, folder: Path, command: str | None, note: Callable[[str], None]) -> None:
    """Write the page, where jinja2 is installed."""
    if importlib.util.find_spec("jinja2") is None:
        note(Unwritten(f"no report.html: jinja2 is not installed ({installation('report')})"))
        return
    from sdpid.output.plans.page import plan_html

    there = [name for name in NAMES if (folder / name).exists()]
    text = plan_html(plan, command=command, names=[*there, _RESULT])
    (folder / "report.html").write_text(text, encoding="utf-8")


# Arguments of `design_excitation` that are options, and their names.
_OPTIONS = {
    name: name
    for name in (
        *("robot", "duration", "collisions", "friction", "previous", "noise", "objective"),
        *("motion", "closed", "harmonics", "start", "periods", "torque_spread", "starts"),
        *("time_limit", "seed"),
    )
} | {"purpose": "for", "package_dirs": "package_dir"}

# Those that name files, perhaps among others.
_FILES = ("robot", "previous", "package_dirs")

# Limits of joints; the others are of the whole arm.
_OF_JOINTS = ("lower", "upper", "velocity", "acceleration", "jerk", "torque")


def settings_files(plan: Plan, folder: Path) -> dict[str, str]:
    """Return texts of ``plan.toml`` and the files that it names, from a plan's settings.

    What no option can say, such as a robot or a recording in memory, stands in comments.

    Parameters
    ----------
    plan : Plan
        Its settings.
    folder : Path
        Where the files will be; others are named relative to it.
    """
    import tomli_w

    settings = dict(plan.settings)
    texts: dict[str, str] = {}
    values: dict[str, Any] = {}
    if limits := settings.pop("limits", None):
        table = _limits_table(limits, plan.trajectory.joint_names)
        texts[LIMITS], values["limits"] = tomli_w.dumps(table), LIMITS
    if settings.pop("obstacles", None) and plan.collision is not None:
        table = obstacles_to_dict(plan.collision.obstacles)
        texts[OBSTACLES], values["obstacles"] = tomli_w.dumps(plain(table)), OBSTACLES
    comments = [f"# sdpid {__version__}: sdpid excite --config FILE makes this plan again."]
    for name, value in settings.items():
        several = isinstance(value, Sequence) and not isinstance(value, str)
        each = [_written(name, v, folder) for v in (value if several else [value])]
        if name not in _OPTIONS or None in each:
            comments.append(f"# no option says this: {name} = {json.dumps(plain(value))}")
        else:
            values[_OPTIONS[name]] = each if several else each[0]
    return {PLAN: "\n".join(comments) + "\n" + tomli_w.dumps(values), **texts}


def _written(name: str, value: Any, folder: Path) -> Any:
    """Return a value for TOML, None where there is none."""
    if name in _FILES and isinstance(value, str) and Path(value).exists():
        return os.path.relpath(Path(value).resolve(), folder.resolve())
    if isinstance(value, Mapping) or (name == "robot" and value not in robot_names()):
        return None
    return value


def _limits_table(limits: Mapping[str, Any], joints: Sequence[str]) -> dict[str, Any]:
    """Return the fields of `Limits` as the tables of its file."""
    table: dict[str, Any] = {"arm": {}}
    for key, value in limits.items():
        if value is None:
            continue
        if key not in _OF_JOINTS or isinstance(value, int | float | str):
            table["arm"][key] = value
            continue
        named = value if isinstance(value, Mapping) else dict(zip(joints, value, strict=True))
        for joint, each in named.items():
            if each is not None:
                table.setdefault("arm" if joint == "*" else joint, {})[key] = each
    return table
