"""A motion as a program for arms of Universal Robots."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from sdpid import __version__
from sdpid._common.arrays import Array
from sdpid._common.files import atomic_write_text
from sdpid.errors import ExportError
from sdpid.experiment.trajectory.trajectory import Trajectory
from sdpid.output.plans.pieces import pieces

# Their arms all have that many joints.
JOINTS = 6

# Of the way to the start: slow, so that a hand reaches the button. rad/s and rad/s².
_SPEED, _ACCELERATION = 0.25, 0.5

# Deceleration at the end, where the arm stands anyway, rad/s².
_STOP = 1.0

# Arguments of servoj, its own defaults (script manual): smoothing time in s, gain.
_LOOK_AHEAD, _GAIN = 0.1, 300

# Rad: a ten-thousandth of what the encoders of these arms resolve.
_DECIMALS = 10

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
    atomic_write_text(Path(path), "\n".join(_lines(trajectory)) + "\n")


def _lines(trajectory: Trajectory) -> Iterator[str]:
    """Yield the lines of the program."""
    parts = pieces(trajectory)
    origin = parts[0].begin
    yield _HEAD.format(version=__version__, seconds=parts[-1].end - origin)
    yield f"# Joints: {', '.join(ascii(name) for name in trajectory.joint_names)}"
    yield "def sdpid_excitation():"
    yield _PLAY.format(look_ahead=_LOOK_AHEAD, gain=_GAIN)
    yield f"  movej({_listed(parts[0].coefficients[0])}, a={_ACCELERATION}, v={_SPEED})"
    yield "  sleep(1.0)"
    for piece in parts:
        lists = ", ".join(map(_listed, piece.coefficients))
        times = f"{piece.end - origin:.9f}, {piece.end - piece.begin:.9f}"
        yield f"  sdpid_play({times}, {lists})"
    yield f"  stopj({_STOP})"
    yield "end"


def _listed(values: Array) -> str:
    """Return numbers as a list, without exponents."""
    return "[" + ", ".join(f"{value:.{_DECIMALS}f}" for value in values.tolist()) + "]"
