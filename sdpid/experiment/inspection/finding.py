"""`Finding`: one defect of a recording, as data, and the list of checks that find them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, Literal, TypeAlias

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError, SdpidError
from sdpid.experiment.inspection.corrections import CorrectedLog, corrected, searched
from sdpid.experiment.inspection.floating.floating_log import FloatingLog
from sdpid.experiment.inspection.rows import Rows, low_passed
from sdpid.experiment.processing.choose import RATE_OF_DIFFERENCES
from sdpid.experiment.processing.process import process
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.recording.floating.base import BaseMotion
from sdpid.experiment.recording.gaps import continuous
from sdpid.experiment.recording.recording import Recording, rows_of
from sdpid.experiment.recording.rest import moving
from sdpid.experiment.recording.stored import extremes
from sdpid.robot.model.model import RobotModel

Severity = Literal["refuse", "warning", "note"]
# Rows that are compared: with 4 feet down 6 equations each.
_ROWS = 120
# A joint whose bodies ask for less than this share of what they ask for at the strongest is not
# compared: noise of its torque is larger. Fingers are at 0.003, the least joint of a quadruped that
# stands at 0.017.
_ASKS = 0.005
# Width of the smooth sign of the velocity, rad/s.
_WIDTH = 0.02


def floating_samples(robot: RobotModel, pieces: Sequence[Recording]) -> Samples | None:
    """Return samples of the longest piece by the default processing; None where it has none."""
    log = max(pieces, key=lambda piece: piece.n_samples, default=None)
    if log is None or log.n != robot.n - robot.n_base:
        return None
    contacts = log.contacts
    forces = contacts is not None and (contacts.forces is not None or contacts.wrenches is not None)
    changes = {"contact_force_std": 1.0} if forces else {}
    try:
        return process(log, changes, gravity=robot.gravity.tolist(), progress=False)
    except SdpidError:
        return None


def floating_log(
    robot: RobotModel, samples: Samples, without: Collection[str] = ()
) -> FloatingLog | None:
    """Return rows of samples; None where nothing can be compared.

    Parameters
    ----------
    robot : RobotModel
        On a floating base.
    samples : Samples
        Of one recording.
    without : collection of str
        Joints whose effort says nothing.
    """
    contacts = samples.contacts
    if contacts is None or not robot.prior[:, 0].sum() > 0.0:
        return None
    some = np.unique(np.linspace(0, samples.n_samples - 1, _ROWS).astype(np.intp))
    base = robot.n_base
    position, effort = samples.position[some, base + 1 :], samples.effort[some, base:]
    velocity = samples.velocity[some, base:]
    known = np.array([name not in without for name in robot.joint_names[base:]])
    moves = moving(samples.position[:, base + 1 :].min(0), samples.position[:, base + 1 :].max(0))
    usable = moves & known & (np.ptp(effort, axis=0) > 0.0)
    if not usable.any():
        return None
    rows = Rows(
        position=position,
        velocity=velocity,
        acceleration=samples.acceleration[some, base:],
        sign=np.tanh(velocity / _WIDTH),
        effort=effort,
        effort_rate=np.zeros_like(effort),
        recorded_velocity=None,
        usable=usable,
        motion_hz=0.0,
        step=0.0,
    )
    log = FloatingLog(
        robot=robot,
        rows=rows,
        gravity=robot.gravity,
        base_position=samples.position[some, : base + 1],
        base_velocity=samples.velocity[some, :base],
        base_acceleration=samples.acceleration[some, :base],
        contacts=contacts.picked(some),
    )
    asked = np.sqrt(np.mean(log.equations[1][:, base:] ** 2, axis=0))
    usable = usable & (asked > _ASKS * asked.max())
    return replace(log, rows=replace(rows, usable=usable)) if usable.any() else None


def exchanged(names: Sequence[str], order: Sequence[float]) -> str:
    """Return of which other feet columns are, where `order` has the column of each foot."""
    pairs = ((int(j), i) for i, j in enumerate(order) if i != j)
    return ", ".join(f"those of {names[j]} are of {names[i]}" for j, i in pairs)


def vector(values: Array) -> str:
    """Return a vector with three digits, what is below 0.0005 as 0."""
    rounded = [float(f"{value:.3g}") if abs(value) >= 5e-4 else 0.0 for value in values]
    return f"({', '.join(f'{value:g}' for value in rounded)})"


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One defect of a recording, or a remark about it.

    Attributes
    ----------
    kind : str
        Name of the kind of defect, such as ``"effort_sign"``.
    message : str
        The defect, its place, and its number against a limit.
    severity : {"refuse", "warning", "note"}
        What is to be refused makes a result meaningless; a warning may make it wrong; a note does
        not.
    remedy : str
        What to do next; may be empty.
    joint : str or None
        The joint; None where it is the whole recording.
    numbers : mapping of str to float
        The numbers of the message.

    Examples
    --------
    >>> still = sdpid.Recording(time=log.time, position=0.0 * log.position, effort=log.effort)
    >>> finding = sdpid.inspect_recording(still, robot).findings[0]
    >>> finding.severity, finding.kind, finding.joint
    ('warning', 'joint_at_rest', 'joint_1')
    >>> dict(finding.numbers)
    {'range': 0.0, 'limit': 0.001}
    """

    kind: str
    message: str
    severity: Severity = "warning"
    remedy: str = ""
    joint: str | None = None
    numbers: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        numbers = {name: float(value) for name, value in self.numbers.items()}
        object.__setattr__(self, "numbers", MappingProxyType(numbers))

    def __str__(self) -> str:
        return f"{self.message}; {self.remedy}" if self.remedy else self.message

    def line(self, *, used: bool = True) -> str:
        """Return the finding in a line, headed by its severity and its kind.

        What is to be refused is headed ``accepted`` where its recording is used all the same.
        """
        head = "accepted" if used and self.severity == "refuse" else self.severity
        return f"{head} {self.kind}: {self}"

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {**vars(self), "numbers": dict(self.numbers), "text": str(self)}


@dataclass(frozen=True, kw_only=True, eq=False)
class Subject:
    """A recording and a robot, with what several checks need of them.

    Attributes
    ----------
    log : Recording
        With its joints named and ordered as the robot's, where there is one.
    robot : RobotModel or None
        None too where its joints could not be matched.
    without : frozenset of str
        Joints whose effort is not used.
    floating : RobotModel or None
        The robot in place of `robot`, where the recording has a floating base.
    total_mass : float or None
        What the robot weighs, kg, where that is known.
    left_out : tuple of slice
        Rows in which a channel is wrong, as was told.
    """

    log: Recording
    robot: RobotModel | None
    without: frozenset[str] = frozenset()
    floating: RobotModel | None = None
    total_mass: float | None = None
    left_out: tuple[slice, ...] = ()

    @cached_property
    def continued(self) -> tuple[tuple[Recording, ...], list[str]] | DataError:
        """The parts between gaps, angles continued, and notes on them; or why it is refused."""
        try:
            return continuous(self.log)
        except DataError as refused:
            return refused

    @cached_property
    def pieces(self) -> tuple[tuple[int, Recording], ...]:
        """The parts between gaps and rows left out, angles continued, each with its first row.

        Empty if refused.
        """
        if isinstance(self.continued, DataError):
            return ()
        pieces, _ = self.continued
        found: tuple[tuple[int, Recording], ...] = ((0, self.log),)
        if pieces != (self.log,):
            time = np.asarray(self.log.time)
            found = tuple((int(np.searchsorted(time, piece.time[0])), piece) for piece in pieces)
        for rows in self.left_out:
            found = tuple(part for first, piece in found for part in _beside(first, piece, rows))
        return found

    @cached_property
    def longest(self) -> Recording:
        """The longest of the pieces, of which there must be one."""
        return max((piece for _, piece in self.pieces), key=lambda piece: piece.n_samples)

    @property
    def based(self) -> tuple[Recording, BaseMotion] | None:
        """The longest piece of a recording with a base, and its base; None where there is none."""
        if self.log.base is None or not self.pieces:
            return None
        assert self.longest.base is not None
        return self.longest, self.longest.base

    @cached_property
    def position_range(self) -> tuple[Array, Array]:
        """Least and largest position of each joint, (n,) each, in rows that are not left out."""
        position = self.log.position
        if self.left_out:
            position = np.delete(position, np.r_[self.left_out], axis=0)
        return extremes(position)

    @property
    def about_velocity(self) -> Severity:
        """Severity of what is wrong with a velocity: a note where by default it is not used."""
        return "note" if self.log.rate_hz >= RATE_OF_DIFFERENCES else "warning"

    @cached_property
    def low_passed(self) -> Rows | None:
        """Motion and efforts at a few times, filtered alike; None where nothing moves."""
        pieces = [piece for _, piece in self.pieces]
        return low_passed(pieces, self.without) if pieces else None

    @property
    def closed(self) -> bool:
        """Whether the robot has loops, whose forces nobody measured."""
        robot = self.robot or self.floating
        return robot is not None and bool(robot.loops)

    @property
    def passive(self) -> tuple[str, ...]:
        """Joints without motors."""
        robot = self.robot or self.floating
        return () if robot is None else robot.passive

    @cached_property
    def samples(self) -> Samples | None:
        """Samples of the longest piece of a recording with a base; None where it has none."""
        if self.floating is None:
            return None
        return floating_samples(self.floating, [piece for _, piece in self.pieces])

    @cached_property
    def corrected(self) -> CorrectedLog | None:
        """The changes that make efforts follow from motion; None without masses to compare with."""
        if self.floating is not None and self.samples is not None and not self.closed:
            log = floating_log(self.floating, self.samples, self.without)
            return None if log is None else searched(log)
        if self.robot is None or self.low_passed is None or self.closed:
            return None
        return corrected(self.robot, self.low_passed)


def _beside(first: int, piece: Recording, rows: slice) -> Iterator[tuple[int, Recording]]:
    """Yield what of a piece lies before and after some rows of the recording."""
    start, stop = np.clip(np.array([rows.start, rows.stop]) - first, 0, piece.n_samples).tolist()
    if start == stop:
        yield first, piece
        return
    piece = replace(piece, period=None, start=None, periods=None)
    for begin, end in ((0, start), (stop, piece.n_samples)):
        if end - begin > 1:
            yield first + begin, rows_of(piece, slice(begin, end))


Check: TypeAlias = Callable[[Subject], Iterator[Finding]]

# Every check, in the order in which findings are listed.
CHECKS: list[Check] = []


def check(function: Check) -> Check:
    """Add a function to the checks of `inspect_recording`."""
    CHECKS.append(function)
    return function
