"""`LogView`: a recording and its robot, with each step on the way to samples made once."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from sdpid.errors import DataError
from sdpid.experiment.inspection.delays.find import channel_delays
from sdpid.experiment.inspection.delays.kinematic import Delay
from sdpid.experiment.processing.choose import default_processing
from sdpid.experiment.processing.feet import carried
from sdpid.experiment.processing.process import process
from sdpid.experiment.processing.robot_contacts import with_loops
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.gaps import continuous
from sdpid.experiment.recording.joints import lacking, match_joints, require_its_base
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.model.model import RobotModel


@dataclass(frozen=True, kw_only=True, eq=False)
class LogView:
    """A recording and its robot; inspection, delays and processing share what was made of them.

    Attributes
    ----------
    given : Recording
        As it was measured.
    asked : RobotModel or None
        Whose joints these are.
    """

    given: Recording
    asked: RobotModel | None = None
    _made: dict[Any, Any] = field(default_factory=dict, init=False)

    @cached_property
    def _matched(self) -> Recording | DataError:
        """The recording with the robot's joints, or why they are not those of the robot."""
        if self.asked is None:
            return self.given
        try:
            return match_joints(self.asked, self.given)
        except DataError as refused:
            return refused

    @property
    def mismatch(self) -> DataError | None:
        """Why the joints are not those of the robot."""
        return self._matched if isinstance(self._matched, DataError) else None

    @property
    def matched(self) -> Recording:
        """The recording in the robot's order.

        Raises
        ------
        DataError
            When its joints are not those of the robot.
        """
        if isinstance(self._matched, DataError):
            raise self._matched
        return self._matched

    @property
    def log(self) -> Recording:
        """The recording in the robot's order, as it is where that cannot be."""
        return self.given if isinstance(self._matched, DataError) else self._matched

    @property
    def robot(self) -> RobotModel | None:
        """The robot, None where its joints could not be matched."""
        return None if self.mismatch else self.asked

    @cached_property
    def continued(self) -> tuple[tuple[Recording, ...], list[str]] | DataError:
        """The parts between gaps, angles continued, and notes on them; or why it is refused."""
        try:
            return continuous(self.log)
        except DataError as refused:
            return refused

    def _once(self, key: Any, make: Any) -> Any:
        if key not in self._made:
            self._made[key] = make()
        return self._made[key]

    def delays(self, unused: Collection[str] = ()) -> dict[str, Delay]:
        """Return how late each channel is (see `channel_delays`)."""
        robot = self.robot
        if robot is None or not robot.free_flyer or robot.loops:
            return {}
        key = ("delays", frozenset(unused))
        found: dict[str, Delay] = self._once(key, lambda: channel_delays(robot, self.log, unused))
        return found

    def choice(self, changes: Processing | Mapping[str, Any] | None = None) -> Processing:
        """Return the processing that is chosen for it (see `default_processing`)."""
        source = changes.get("base_motion") if isinstance(changes, Mapping) else None
        chosen: Processing = self._once(
            ("choice", repr(source)), lambda: default_processing(self.given, changes)
        )
        return chosen

    def samples(self, processing: Processing | None = None) -> Samples:
        """Return its samples, joints matched with the robot's and loops closed.

        Raises
        ------
        DataError
            When a joint of the robot is not in it, positions look like degrees, it cannot be
            processed, or only one of the two has a floating base.
        """
        chosen = processing or self.choice()
        found: Samples = self._once(chosen, lambda: self._processed(chosen))
        return found

    def _processed(self, processing: Processing) -> Samples:
        robot = self.asked
        assert robot is not None
        require_its_base(robot, self.given)
        named = self.matched
        if processing.contact_force_std is not None and named.contacts:
            reach = round(processing.contact_margin_s / named.step)
            named = replace(named, contacts=carried(named.contacts, reach))
        limits = robot.position_limits[robot.n_base :]
        samples = process(named, processing, position_limits=limits, gravity=robot.gravity.tolist())
        if robot.n_base:
            samples = replace(samples, joint_names=robot.joint_names)
        if missing := lacking(robot, self.given):
            note = f"positions of {', '.join(missing)} are those that close the loops"
            samples = replace(samples, notes=(*samples.notes, note))
        return with_loops(robot, samples)


def view_of(log: Recording | LogView, robot: RobotModel | None = None) -> LogView:
    """Return a recording with its robot as a view; what is one already knows its robot."""
    return log if isinstance(log, LogView) else LogView(given=log, asked=robot)
