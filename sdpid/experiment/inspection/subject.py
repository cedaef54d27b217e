"""`Subject`: a recording and a robot as checks see them, and the list of checks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError, SdpidError
from sdpid.experiment.inspection.delays.kinematic import Standing
from sdpid.experiment.inspection.explain import ExplainedLog, corrected, floating_log, searched
from sdpid.experiment.inspection.kinds import Finding, Severity
from sdpid.experiment.inspection.rows import FilteredRows, low_passed
from sdpid.experiment.inspection.view import LogView
from sdpid.experiment.processing.choose import RATE_OF_DIFFERENCES
from sdpid.experiment.processing.process import process
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.recording.floating import BaseMotion
from sdpid.experiment.recording.recording import Recording, rows_of
from sdpid.experiment.recording.stored import extremes
from sdpid.robot.model.model import RobotModel


@dataclass(frozen=True, kw_only=True, eq=False)
class Subject:
    """A recording and a robot, with what several checks need of them.

    Attributes
    ----------
    view : LogView
        The recording, in the robot's order, and the robot.
    without : frozenset of str
        Joints whose effort is not used.
    total_mass : float or None
        What the robot weighs, kg, where that is known.
    left_out : tuple of slice
        Rows in which a channel is wrong, by a finding.
    """

    view: LogView
    without: frozenset[str] = frozenset()
    total_mass: float | None = None
    left_out: tuple[slice, ...] = ()

    @property
    def log(self) -> Recording:
        """The recording, with its joints named and ordered as the robot's, where there is one."""
        return self.view.log

    @property
    def robot(self) -> RobotModel | None:
        """The robot; None too where its joints could not be matched."""
        return self.view.robot

    @property
    def fixed(self) -> RobotModel | None:
        """The robot of a recording without a base."""
        # The dynamics of a robot that is fixed say nothing about one that is not.
        return self.robot if self.log.base is None else None

    @property
    def floating(self) -> RobotModel | None:
        """The robot of a recording with a base."""
        return None if self.log.base is None else self.robot

    @cached_property
    def pieces(self) -> tuple[tuple[int, Recording], ...]:
        """The parts between gaps and rows left out, angles continued, each with its first row.

        Empty if refused.
        """
        if isinstance(self.view.continued, DataError):
            return ()
        pieces, _ = self.view.continued
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
    def low_passed(self) -> FilteredRows | None:
        """Motion and efforts at a few times, filtered alike; None where nothing moves."""
        pieces = [piece for _, piece in self.pieces]
        return low_passed(pieces, self.without) if pieces else None

    @property
    def closed(self) -> bool:
        """Whether the robot has loops, whose forces nobody measured."""
        return self.robot is not None and bool(self.robot.loops)

    @property
    def passive(self) -> tuple[str, ...]:
        """Joints without motors."""
        return () if self.robot is None else self.robot.passive

    @cached_property
    def standing(self) -> Standing | None:
        """When and how feet stand in the longest piece; None where that is not known."""
        robot = self.floating
        if robot is None or not robot.free_flyer or not self.pieces:
            return None
        return Standing.of(robot, self.longest)

    @cached_property
    def samples(self) -> Samples | None:
        """Samples of the longest piece of a recording with a base, or None."""
        robot = self.floating
        if robot is None or not self.pieces or self.longest.n != robot.n - robot.n_base:
            return None
        contacts = self.longest.contacts
        measured = contacts is not None and contacts.measured is not None
        changes = {"contact_force_std": 1.0} if measured else {}
        try:
            if not (measured or self.closed or len(self.pieces) > 1 or self.left_out):
                return self.view.samples()
            return process(self.longest, changes, gravity=robot.gravity.tolist(), progress=False)
        except SdpidError:
            return None

    @cached_property
    def corrected(self) -> ExplainedLog | None:
        """The changes that make efforts follow from motion; None without masses to compare with."""
        if self.robot is None or self.closed:
            return None
        if self.samples is not None:
            log = floating_log(self.robot, self.samples, self.without)
            return None if log is None else searched(log)
        if self.fixed is None or self.low_passed is None:
            return None
        return corrected(self.fixed, self.low_passed)


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

# Every check, in the order in which findings are listed: those of efforts only where nothing was
# found that spoils them.
CHECKS: list[Check] = []
OF_EFFORTS: list[Check] = []


def check(function: Check) -> Check:
    """Add a function to the checks of `inspect_recording`."""
    CHECKS.append(function)
    return function


def check_of_efforts(function: Check) -> Check:
    """Add a function to the checks of efforts against the motion."""
    OF_EFFORTS.append(function)
    return function
