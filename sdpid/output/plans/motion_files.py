"""A motion as files of robots: CSV, a ROS JointTrajectory, URScript, in pieces where it is long."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from sdpid import __version__
from sdpid._common.arrays import Array
from sdpid._common.files import atomic_write_text
from sdpid._common.tables import Table
from sdpid.errors import ExportError
from sdpid.experiment.trajectory.trajectory import Trajectory

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
