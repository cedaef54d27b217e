"""`Subject`: a recording and its robot, as checks and preparation see them; the list of checks."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial, wraps
from typing import Any, TypeAlias, TypeVar, cast

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError, SdpidError
from sdpid.experiment.inspection.delays import Delay, channel_delays
from sdpid.experiment.inspection.explain import ExplainedLog, fixed_log, floating_log
from sdpid.experiment.inspection.kinds import KINDS, Finding, Severity, found, note, refuse
from sdpid.experiment.inspection.rows import FilteredRows, Standing, low_passed
from sdpid.experiment.processing.base import carried
from sdpid.experiment.processing.choose import RATE_OF_DIFFERENCES, default_processing
from sdpid.experiment.processing.process import process
from sdpid.experiment.processing.robot_contacts import with_loops
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.readers.scaled import require_measured
from sdpid.experiment.recording.floating import BaseMotion, Imu
from sdpid.experiment.recording.gaps import RETIMED, continuous
from sdpid.experiment.recording.joints import lacking, match_joints, require_its_base
from sdpid.experiment.recording.plausible import turning_limits
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.model.dynamics import spring_efforts
from sdpid.robot.model.model import RobotModel

_Made = TypeVar("_Made")

# A step of time over which efforts of springs are straight lines, s.
_SOON = 1e-4

KINDS.update(time_stamps=refuse("{why}", final=True), continued=note("{note}"))


@dataclass(frozen=True, kw_only=True, eq=False)
class Subject:
    """A recording and a robot, with what several checks, delays and processing need of them.

    Attributes
    ----------
    given : Recording
        As it was measured.
    robot : RobotModel or None
        Whose joints these are; None too where they could not be matched.
    log : Recording
        The recording with its joints named and ordered as the robot's, where they are known, and
        without rows in which a channel is wrong.
    mismatch : DataError or None
        Why the joints are not those of the robot.
    without : frozenset of str
        Joints whose effort is not used.
    sprung : frozenset of str
        Joints with springs that are not known, whose efforts no description explains.
    total_mass : float or None
        What the robot weighs, kg, where that is known.
    """

    given: Recording
    robot: RobotModel | None
    log: Recording
    mismatch: DataError | None = None
    without: frozenset[str] = frozenset()
    sprung: frozenset[str] = frozenset()
    total_mass: float | None = None
    # What was made of `log`, also for subjects of which other efforts are not used.
    _made: dict[Any, Any] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, log: Recording | Subject, robot: RobotModel | None = None) -> Subject:
        """Return a recording with its robot; what is a subject already knows its robot."""
        if isinstance(log, Subject):
            return log
        require_measured(log)
        try:
            matched = log if robot is None else match_joints(robot, log)
        except DataError as refused:
            return cls(given=log, robot=None, log=log, mismatch=refused)
        return cls(given=log, robot=robot, log=matched)

    def _once(self, key: Any, make: Callable[[], _Made]) -> _Made:
        if key not in self._made:
            self._made[key] = make()
        return cast(_Made, self._made[key])

    @property
    def matched(self) -> Recording:
        """The recording in the robot's order.

        Raises
        ------
        DataError
            When its joints are not those of the robot.
        """
        if self.mismatch is not None:
            raise self.mismatch
        return self.log

    @property
    def fixed(self) -> RobotModel | None:
        """The robot of a recording without a base."""
        # The dynamics of a robot that is fixed say nothing about one that is not.
        return self.robot if self.log.base is None else None

    @property
    def floating(self) -> RobotModel | None:
        """The robot of a recording with a base."""
        return None if self.log.base is None else self.robot

    @property
    def closed(self) -> bool:
        """Whether the robot has loops, whose forces nobody measured."""
        return self.robot is not None and bool(self.robot.loops)

    @property
    def passive(self) -> tuple[str, ...]:
        """Joints without motors."""
        return () if self.robot is None else self.robot.passive

    @property
    def about_velocity(self) -> Severity:
        """Severity of what is wrong with a velocity: a note where by default it is not used."""
        return "note" if self.log.rate_hz >= RATE_OF_DIFFERENCES else "warning"

    @cached_property
    def continued(self) -> tuple[tuple[Recording, ...], list[Finding]]:
        """The parts between gaps, angles continued, none if refused, and what is said of them."""
        try:
            pieces, notes = continuous(self.log)
        except DataError as refused:
            return (), [found("time_stamps", why=str(refused))]
        # Times that speeds tell have a finding of their own.
        told = [text for text in notes if not text.startswith(RETIMED)]
        return pieces, [found("continued", note=text) for text in told]

    @property
    def pieces(self) -> tuple[Recording, ...]:
        """The parts between gaps, angles continued; none if refused."""
        return self.continued[0]

    @property
    def longest(self) -> Recording | None:
        """The longest of the pieces; None if refused."""
        return max(self.pieces, key=lambda piece: piece.n_samples, default=None)

    @property
    def base(self) -> BaseMotion | None:
        """The motion of the base in the longest piece."""
        return None if self.longest is None else self.longest.base

    @property
    def imu(self) -> Imu | None:
        """What an IMU on the base measured in the longest piece."""
        return None if self.base is None else self.base.imu

    def less(self, times: Array) -> Subject:
        """Return the subject without the rows at some times."""
        log = replace(self.log, period=None, start=None, periods=None)
        kept = np.ones(log.n_samples, dtype=np.bool_)
        kept[np.searchsorted(np.asarray(log.time), times)] = False
        return replace(self, log=log.rows(kept), _made={})

    def row(self, time: float) -> int:
        """Return the row of a sample as it was measured, from 1."""
        return int(np.searchsorted(np.asarray(self.given.time), time)) + 1

    @cached_property
    def low_passed(self) -> FilteredRows | None:
        """Motion and efforts at a few times, filtered alike; None where nothing moves.

        Efforts are those beside the description's springs.
        """
        rows = low_passed(self.pieces, self.without | self.sprung) if self.pieces else None
        if rows is None or self.fixed is None or not self.fixed.springs:
            return rows
        before, now, after = (
            spring_efforts(self.fixed, rows.position + step * rows.velocity)
            for step in (-_SOON, 0.0, _SOON)
        )
        rate = (after - before) / (2.0 * _SOON)
        return replace(rows, effort=rows.effort - now, effort_rate=rows.effort_rate - rate)

    @cached_property
    def standing(self) -> Standing | None:
        """When and how feet stand in the longest piece; None where that is not known."""
        robot = self.floating
        if robot is None or not robot.free_flyer or self.longest is None:
            return None
        return Standing.of(robot, self.longest)

    @cached_property
    def samples(self) -> Samples | None:
        """Samples of the longest piece of a recording with a base, or None."""
        robot, piece = self.floating, self.longest
        if robot is None or piece is None or self.log.n != robot.n - robot.n_base:
            return None
        contacts = piece.contacts
        measured = contacts is not None and contacts.measured is not None
        changes = {"contact_force_std": 1.0} if measured else {}
        try:
            if not (measured or self.closed or len(self.pieces) > 1):
                return self.processed()
            return process(piece, changes, gravity=robot.gravity.tolist(), progress=False)
        except SdpidError:
            return None

    @cached_property
    def corrected(self) -> ExplainedLog | None:
        """The changes that make efforts follow from motion; None without masses to compare with."""
        if self.robot is None or self.closed:
            return None
        if self.fixed is not None:
            log = None if self.low_passed is None else fixed_log(self.fixed, self.low_passed)
        else:
            samples = self.samples
            log = (
                None
                if samples is None
                else floating_log(self.robot, samples, self.without | self.sprung)
            )
        return None if log is None else log.searched()

    def delays(self, unused: Collection[str] = ()) -> dict[str, Delay]:
        """Return how late each channel is (see `channel_delays`)."""
        robot = self.robot
        if robot is None or not robot.free_flyer or robot.loops:
            return {}
        key = ("delays", frozenset(unused))
        return self._once(key, lambda: channel_delays(robot, self.log, unused))

    def choice(self, changes: Processing | Mapping[str, Any] | None = None) -> Processing:
        """Return the processing that is chosen for it (see `default_processing`)."""
        source = changes.get("base_motion") if isinstance(changes, Mapping) else None
        return self._once(("choice", repr(source)), lambda: default_processing(self.given, changes))

    def processed(self, processing: Processing | None = None) -> Samples:
        """Return its samples, joints matched with the robot's and loops closed.

        Raises
        ------
        DataError
            When a joint of the robot is not in it, positions look like degrees, it cannot be
            processed, or only one of the two has a floating base.
        """
        chosen = processing or self.choice()
        return self._once(chosen, lambda: self._processed(chosen))

    def _processed(self, processing: Processing) -> Samples:
        robot, named = self.robot, self.matched
        assert robot is not None
        require_its_base(robot, named)
        if processing.contact_force_std is not None and named.contacts:
            reach = round(processing.contact_margin_s / named.step)
            named = replace(named, contacts=carried(named.contacts, reach))
        limits = turning_limits(robot)
        samples = process(named, processing, position_limits=limits, gravity=robot.gravity.tolist())
        if robot.n_base:
            samples = replace(samples, joint_names=robot.joint_names)
        if missing := lacking(robot, self.given):
            closing = f"positions of {', '.join(missing)} are those that close the loops"
            samples = replace(samples, notes=(*samples.notes, closing))
        return with_loops(robot, samples)


Check: TypeAlias = Callable[[Subject], Iterator[Finding]]

# Every check, in the order in which findings are listed: those of efforts only where nothing was
# found that spoils them.
CHECKS: list[Check] = []
OF_EFFORTS: list[Check] = []


def check(
    *needs: str, checks: list[Check] = CHECKS
) -> Callable[[Callable[..., Iterator[Finding]]], Check]:
    """Return what adds a function to the checks of `inspect_recording`.

    It is called with the subject, and with those of its attributes that it needs, unless one of
    them is None.
    """

    def added(function: Callable[..., Iterator[Finding]]) -> Check:
        @wraps(function)
        def run(subject: Subject) -> Iterator[Finding]:
            needed: list[Any] = []
            for name in needs:
                if (value := getattr(subject, name)) is None:
                    return
                needed.append(value)
            yield from function(subject, *needed)

        checks.append(run)
        return run

    return added


# Of efforts against the motion.
check_of_efforts = partial(check, checks=OF_EFFORTS)
