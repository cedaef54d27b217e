"""What a known law makes of a log: commands to the drives, and the efforts that follow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.files import load_toml, read_regular, require_known
from sdpid.errors import DataError
from sdpid.experiment.preparation.prepare import Logs, read_logs
from sdpid.experiment.recording.joints import match_joints
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.simulation.closed_loop import DesiredMotion
from sdpid.experiment.simulation.controllers import PD
from sdpid.experiment.trajectory.curve import SampledCurve
from sdpid.robot.description.mjcf import compiled
from sdpid.robot.description.xml import MAX_BYTES
from sdpid.robot.model.model import RobotModel

# Commands are steps that are held where this share of the rows in motion repeat the one before.
_HELD = 0.3

# A delay (s) at which a law's efforts are taken where none is known: torques hardly tell one.
USUAL_DELAY = 0.004


@dataclass(frozen=True, kw_only=True, eq=False)
class DriveCommands:
    """Commands to the drives of n joints at N time stamps.

    Attributes
    ----------
    command : ndarray, shape (N, n)
        Commanded positions, rad (m).
    feedforward : ndarray, shape (N, n)
        Efforts that are added to those of the law, N·m (N).
    limit : ndarray, shape (n,)
        Largest effort, N·m (N); infinite without any.
    held : bool
        Whether commands are held until the next, or joined by lines.
    note : str
        How commands were understood, in words.
    """

    command: Array
    feedforward: Array
    limit: Array
    held: bool
    note: str

    @classmethod
    def of(cls, log: Recording, law: PD) -> DriveCommands:
        """Take the commands of a recording.

        Raises
        ------
        DataError
            When it has no commanded positions.
        """
        if log.reference is None:
            raise DataError(
                "law: the log has no commanded positions; name them with "
                "columns={'reference': ...} (--column reference=NAME)."
            )
        command = np.array(log.reference)
        moves = np.any(np.diff(command, axis=0) != 0.0, axis=1)
        at = np.flatnonzero(moves)
        held, note = True, "commands are constant"
        if len(at):
            inside = moves[at[0] : at[-1] + 1]
            held = 1.0 - float(inside.mean()) > _HELD
            every = float(np.median(np.diff(np.array(log.time)[1:][at]))) if len(at) > 1 else 0.0
            note = (
                f"commands are taken as steps that are held, one in {1e3 * every:.3g} ms"
                if held
                else f"commands change at every row ({1e3 * every:.3g} ms) and are joined by lines"
            )
        added = np.zeros_like(command) if log.feedforward is None else np.array(log.feedforward)
        if log.feedforward is not None:
            note += "; the log's feed-forward efforts are added to the law's"
        limit = np.full(log.n, np.inf if law.limit is None else law.limit)
        return cls(command=command, feedforward=added, limit=limit, held=held, note=note)

    def curve(self, time: Array) -> Any:
        """Return commands and added efforts (…, 2·n) as polynomials between stamps (N,)."""
        from scipy.interpolate import PPoly

        values = np.hstack([self.command, self.feedforward])
        rise = np.diff(values, axis=0) / np.diff(time)[:, None] * (not self.held)
        # Constant before the first stamp and after the last.
        pieces = np.stack([np.pad(rise, ((1, 1), (0, 0))), np.vstack([values[:1], values])])
        return PPoly(pieces, np.concatenate([time[:1] - 1.0, time, time[-1:] + 1.0]))

    def at(self, time: Array, delay: float, asked: Array | None = None) -> tuple[Array, Array]:
        """Return commands and added efforts that act at the time stamps, or when it is asked."""
        when = (time if asked is None else asked) - delay + 1e-9 * self.held
        command, added = np.split(self.curve(time)(when), 2, axis=1)
        return command, added


def with_efforts_of_law(log: Recording, law: PD, delay: float) -> Recording:
    """Return a recording whose efforts are those of a law, at commands of a delay before.

    Parameters
    ----------
    log : Recording
        With commanded positions.
    law : PD
        With one number a joint.
    delay : float
        Time from a command to its effort, s.

    Raises
    ------
    DataError
        When it has no commanded positions.
    """
    commands = DriveCommands.of(log, law)
    command, added = commands.at(np.array(log.time), delay)
    position = np.array(log.position)
    rates = np.gradient(position, np.array(log.time), axis=0)
    gains, velocity = law.gains, rates if log.velocity is None else log.velocity
    effort = gains.proportional * (command - position) - gains.derivative * velocity + added
    effort = np.clip(effort, -commands.limit, commands.limit)
    return replace(log, effort=effort, currents=False, gains=None)


@dataclass(frozen=True, kw_only=True, eq=False)
class CommandedMotion(DesiredMotion):
    """Commands to drives under a law, as steps or lines, when they act.

    Attributes
    ----------
    commands : DriveCommands
        Commands; added efforts are in them, over kp.
    stamps : ndarray, shape (N,)
        When these were given, s.
    begin : float
        Which time of the recording is zero, s.
    delay : float
        Time from a command to its effort, s.
    """

    commands: DriveCommands
    stamps: Array
    begin: float
    delay: float

    @classmethod
    def under(cls, log: Recording, law: PD) -> CommandedMotion:
        """Take the commands of a recording, under a law with its numbers."""
        stamps, commands = np.array(log.time), DriveCommands.of(log, law)
        command = commands.command + commands.feedforward / law.gains.proportional
        time = stamps - stamps[0]
        return cls(
            time=time,
            curve=SampledCurve(time=time, position=command),
            commands=replace(commands, command=command, feedforward=np.zeros_like(command)),
            stamps=stamps,
            begin=float(stamps[0]),
            delay=float(law.delay or 0.0),
        )

    def at(self, time: Array) -> Array:
        """Return commands that act (T, 3, n); their rates are not in the law, and zero."""
        found = np.zeros((len(time), 3, self.curve.n))
        found[:, 0] = self.commands.at(self.stamps, self.delay, self.begin + time)[0]
        return found


def require_law(law: Any) -> PD:
    """Return a law that is one.

    Raises
    ------
    DataError
        When it is none.
    """
    if not isinstance(law, PD):
        raise DataError(f"law: is {law!r:.80}; give sdpid.controllers.PD(kp=..., kd=...).")
    return law


def under_law(
    robot: RobotModel, given: Logs, law: Any, purpose: str, delay: float | None = None
) -> tuple[PD, tuple[Recording, ...]]:
    """Return a law with all its numbers, and recordings with the efforts of it.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    given : Recording or path, or a sequence of these
        With commanded positions.
    law : PD
        The law; the one returned has one number a joint, and no commanded speed.
    purpose : str
        For messages.
    delay : float, optional
        Its delay (s) where it has none; without, that is refused.

    Raises
    ------
    DataError
        When it is no law, a number is missing, or a recording has no commanded positions.
    """
    law = require_law(law)
    acts = delay if law.delay is None else float(law.delay)
    if law.kp is None or acts is None:
        raise DataError(
            f"law: its {'kp' if law.kp is None else 'delay'} is None, to be found; {purpose} needs "
            "a number: yours, or that of identify(..., law=...).drives."
        )
    known = replace(law.of_joints(robot.n), feedforward=False, delay=acts)
    _, logs = read_logs(robot, given)
    return known, tuple(with_efforts_of_law(match_joints(robot, x), known, acts) for x in logs)


def law_of(kind: str, robot: RobotModel, given: Mapping[str, Any]) -> PD:
    """Return the law of options, of a TOML file or of the actuators of an MJCF.

    Parameters
    ----------
    kind : str
        ``pd``, or a file: TOML with kp, kd, delay and limit, each a number, a list or a table by
        joint, or an MJCF.
    robot : RobotModel
        Whose joints there are.
    given : mapping
        Options, which win.

    Raises
    ------
    DataError
        When the file says no law, or kd is missing.
    """
    stated: dict[str, Any] = {}
    if kind != "pd":
        path = Path(kind)
        if not path.is_file():
            raise DataError(f"law: {kind!r} is no file, and no law but pd is known.")
        stated = _of_actuators(path) if path.suffix.lower() == ".xml" else load_toml(path)
    require_known(stated, ("kp", "kd", "delay", "limit"), kind)
    found = {name: _by_joint(kind, name, x, robot) for name, x in stated.items()} | dict(given)
    # One number is that of every joint, beside lists of the others too.
    found = {name: np.ravel(x)[0].item() if np.size(x) == 1 else x for name, x in found.items()}
    if "kd" not in found:
        raise DataError("law: kd is missing; give --kd, in N.m.s/rad (0 where there is none).")
    return PD(**{"kp": None, **found})


def _by_joint(file: str, name: str, stated: Any, robot: RobotModel) -> Any:
    """Return a number or a list, in the order of the joints where it is a table by joint."""
    if not isinstance(stated, Mapping):
        return stated
    joints = robot.joint_names
    if {*stated} != {*joints}:
        off = sorted({*stated} ^ {*joints})
        raise DataError(
            f"{file}: {name} has not the joints of '{robot.name}' ({', '.join(off[:4])}); give "
            "each joint one number."
        )
    return [stated[joint] for joint in joints]


def _of_actuators(path: Path) -> dict[str, Any]:
    """Return what position servos of an MJCF are: gains and limits by joint."""
    model = compiled(read_regular(path, MAX_BYTES).decode("utf-8", "replace"), path, str(path))
    found: dict[str, dict[str, float]] = {"kp": {}, "kd": {}, "limit": {}}
    for k in range(model.nu):
        gain, bias = model.actuator_gainprm[k], model.actuator_biasprm[k]
        # Zero: at a joint, without a filter.
        plain = model.actuator_trntype[k] == 0 and model.actuator_dyntype[k] == 0
        if not plain or gain[0] <= 0.0 or bias[1] != -gain[0]:
            raise DataError(
                f"{path}: actuator {k + 1} is no position servo at a joint, or filters its "
                "command; give --law pd."
            )
        number = model.actuator_trnid[k, 0]
        joint, gear = model.joint(number).name, model.actuator_gear[k, 0]
        found["kp"][joint], found["kd"][joint] = gear**2 * gain[0], -(gear**2) * bias[2]
        limits = []
        if model.actuator_forcelimited[k]:
            limits.append(abs(gear) * model.actuator_forcerange[k, 1])
        if model.jnt_actfrclimited[number]:
            limits.append(model.jnt_actfrcrange[number, 1])
        if limits:
            found["limit"][joint] = min(limits)
    if not found["kp"]:
        raise DataError(f"{path}: has no actuators; give --law pd --kp ... --kd ...")
    return {name: values for name, values in found.items() if values}
