"""Another motion of the same recordings, processed exactly as the measured one was."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, real_array
from sdpid._common.threads import one_thread
from sdpid.errors import DataError
from sdpid.experiment.inspection.subject import Subject
from sdpid.experiment.preparation.prepare import (
    ProcessingOf,
    chosen_processing,
    read_logs,
    require_joint_covariance,
)
from sdpid.experiment.processing.pipeline import Pipeline, states_of
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.gaps import continuous
from sdpid.experiment.recording.joints import require_fixed_base
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.model.model import RobotModel

# Processed positions of the same recording agree to rounding; those of another cut-off, or of other
# sample times, differ by far more (rad).
_SAME = 1e-9

# Positions of one recording, or of each of several.
Motions = ArrayLike | Sequence[ArrayLike]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Twin:
    """Recordings whose measured positions can be replaced by others, simulated ones say.

    The other motion passes the same filter, window and decimation, is averaged over the same
    periods and keeps the same rows as the measured one, whatever it is itself: time stamps, gaps,
    masks, covariance and blocks are those of the measurement. So row k of the one belongs to row k
    of the other.

    Attributes
    ----------
    robot : RobotModel
        The robot.
    logs : tuple of Recording
        As measured, joints in the robot's order.
    processing : Processing
        Of all of them.
    measured : Samples
        Of the measured motion.
    """

    robot: RobotModel
    logs: tuple[Recording, ...]
    processing: Processing
    measured: Samples
    # Of each piece, in order: how it is processed, or why it is too short.
    _pipelines: tuple[Pipeline | str, ...]

    @classmethod
    def of(
        cls,
        robot: RobotModel,
        log: Any,
        processing: ProcessingOf = None,
        *,
        measured: Samples | None = None,
    ) -> Twin:
        """Prepare recordings for another motion.

        Parameters
        ----------
        robot : RobotModel
            The robot.
        log : Recording or path, or a sequence of these
            What was measured.
        processing : Processing or mapping, optional
            As `measured` were made; by default as `prepare` chooses.
        measured : Samples, optional
            Made of these recordings, with masks of one's own, say. By default they are processed
            here.

        Raises
        ------
        DataError
            When a recording cannot be processed, or `measured` were made otherwise.
        """
        _, read = read_logs(robot, log, "recordings")
        require_joint_covariance(read)
        for each in read:
            require_fixed_base(each, "simulated motion and instruments")
        subjects = [Subject.of(each, robot) for each in read]
        chosen, _ = chosen_processing(subjects, processing)
        logs = tuple(subject.matched for subject in subjects)
        pieces = [piece for each in logs for piece in continuous(each)[0]]
        twin = cls(
            robot=robot,
            logs=logs,
            processing=chosen,
            measured=measured or Samples.join([each.processed(chosen) for each in subjects]),
            _pipelines=tuple(Pipeline.of(piece, chosen) for piece in pieces),
        )
        if measured is not None:
            _require_same(twin, measured)
        return twin

    def __repr__(self) -> str:
        return f"Twin({len(self.logs)} recordings of '{self.robot.name}', {self.measured!r})"

    @one_thread
    def samples(
        self, position: Motions, *, velocity: Motions | None = None, effort: Motions | None = None
    ) -> Samples:
        """Process another motion.

        Parameters
        ----------
        position : (N, n) array_like, or a sequence of these
            Joint positions at the recording's time stamps, in rad; one array a recording.
        velocity : (N, n) array_like, or a sequence of these, optional
            Velocities in rad/s, where the processing takes measured ones; by default the
            derivative of a cubic spline through the positions. Otherwise they are not used.
        effort : (N, n) array_like, or a sequence of these, optional
            Efforts in N·m to be filtered; by default those that were measured.

        Returns
        -------
        Samples
            Row by row beside `measured`, which share all but position, velocity, acceleration and,
            where given, effort.

        Raises
        ------
        DataError
            When arrays are not finite or do not have the recordings' shapes.
        """
        given = {"position": position, "velocity": velocity, "effort": effort}
        arrays = {name: self._arrays(x, name) for name, x in given.items() if x is not None}
        if velocity is None and self.processing.velocity == "measured":
            pairs = zip(self.logs, arrays["position"], strict=True)
            arrays["velocity"] = [_spline_velocity(log.time, q) for log, q in pairs]
        moved = self._moved(arrays)
        states = [states_of(*each, repeats=False) for each in moved]
        changed: dict[str, Any] = {
            name: np.concatenate([each[name] for each in states])
            for name in ("position", "velocity", "acceleration")
        }
        if effort is not None:
            efforts = [pipeline.means(piece.effort) for piece, pipeline in moved]
            changed |= {"effort": np.concatenate(efforts), "effort_periods": None}
        wide = tuple(own for each in states for own in each["wide"] or ())
        return replace(self.measured, wide=wide or None, **changed)

    @one_thread
    def positions(self, position: Motions) -> Array:
        """Filter the positions of another motion, (K, n): as in `samples`, but nothing else.

        Parameters
        ----------
        position : (N, n) array_like, or a sequence of these
            As for `samples`. Filtering is linear, so derivatives of positions by parameters pass
            like positions.
        """
        moved = self._moved({"position": self._arrays(position, "position")})
        return np.concatenate([pipeline.means(piece.position) for piece, pipeline in moved])

    def _moved(self, arrays: dict[str, list[Array]]) -> list[tuple[Recording, Pipeline]]:
        """Return the pieces of the recordings with other channels, and how each is processed."""
        pieces: list[Recording] = []
        for i, log in enumerate(self.logs):
            own: dict[str, Any] = {"velocity": None} | {name: x[i] for name, x in arrays.items()}
            pieces += continuous(replace(log, **own))[0]
        pairs = zip(pieces, self._pipelines, strict=True)
        return [(piece, each) for piece, each in pairs if isinstance(each, Pipeline)]

    def _arrays(self, given: Any, name: str) -> list[Array]:
        """Return one checked array (N, n) a recording."""
        alone = len(self.logs) == 1 and np.ndim(given[0] if len(given) else given) < 2
        arrays = [given] if alone else list(given)
        if len(arrays) != len(self.logs):
            raise DataError(
                f"{name}: has {len(arrays)} arrays for {len(self.logs)} recordings; give one each."
            )
        found = [real_array(each, name, ndim=2) for each in arrays]
        for number, (array, log) in enumerate(zip(found, self.logs, strict=True), 1):
            if array.shape != log.position.shape:
                where = f" of recording {number}" if len(self.logs) > 1 else ""
                raise DataError(
                    f"{name}: has shape {array.shape}, expected {log.position.shape} as the "
                    f"positions{where} have: one row a time stamp, one column a joint."
                )
        return found


def _spline_velocity(time: Array, position: Array) -> Array:
    """Return the derivative of the cubic splines through positions (N, n)."""
    from scipy.interpolate import CubicSpline

    # Stamps since 1970 lose digits in the cubes.
    relative = np.asarray(time) - time[0]
    return np.asarray(CubicSpline(relative, position)(relative, 1))


def _require_same(twin: Twin, measured: Samples) -> None:
    """Raise unless samples were made of the twin's recordings in the twin's way."""
    if measured.n != twin.robot.n:
        raise DataError(
            f"recording: the samples have {measured.n} joints, the robot '{twin.robot.name}' has "
            f"{twin.robot.n}."
        )
    kept = [each.count for each in twin._pipelines if isinstance(each, Pipeline)]
    remedy = (
        "give the recordings that the problem was built of, and the same processing "
        "(processing=sdpid.Processing(...))."
    )
    sizes = [part.stop - part.start for part in measured.parts]
    if kept != sizes:
        raise DataError(
            f"recording: is processed to {_listed(kept)} samples, the problem's pieces have "
            f"{_listed(sizes)}; {remedy}"
        )
    velocities: Any = [log.velocity for log in twin.logs]
    own = twin.samples(
        [log.position for log in twin.logs],
        velocity=None if any(each is None for each in velocities) else velocities,
    )
    for name in ("position", "velocity", "acceleration"):
        mine, theirs = getattr(own, name), getattr(measured, name)
        off = float(np.abs(mine - theirs).max()) if mine.shape == theirs.shape else np.inf
        if off > _SAME * max(float(np.abs(theirs).max()), 1.0):
            raise DataError(
                f"recording: its {name}, processed, is up to {off:.3g} away from that of the "
                f"problem's samples; {remedy}"
            )


def _listed(counts: Sequence[int]) -> str:
    """Return counts in words, the first few of many."""
    shown = ", ".join(str(count) for count in counts[:4])
    return shown + (", …" if len(counts) > 4 else "")
