"""`prepare`: the way from files to samples: read, match, inspect, choose, process, join."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

from sdpid._common.progress import progress
from sdpid.errors import DataError
from sdpid.experiment.inspection.delays import is_significant, pooled_delays
from sdpid.experiment.inspection.inspect import (
    inspect_recordings,
    joints_left_out,
    kinds_accepted,
    require_accepted,
)
from sdpid.experiment.inspection.kinds import Finding
from sdpid.experiment.inspection.subject import Subject
from sdpid.experiment.processing.choose import with_changes
from sdpid.experiment.processing.process import CHANNELS
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.processing.settings import Processing, Reason
from sdpid.experiment.readers.mapping import as_gains
from sdpid.experiment.readers.read import is_frame, read_recording
from sdpid.experiment.readers.scaled import require_torques, scaled
from sdpid.experiment.recording.joints import require_its_base, robot_of
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.friction.terms import Coulomb, SigmoidFriction
from sdpid.robot.model.model import RobotModel

Log: TypeAlias = "Recording | str | os.PathLike[str]"
Logs: TypeAlias = "Log | Sequence[Log]"
# One piece of a problem, processed or not.
Piece: TypeAlias = "Samples | Recording | str | os.PathLike[str]"
# All settings, or those that differ from the default.
ProcessingOf: TypeAlias = "Processing | Mapping[str, Any] | None"
# Delays are kept to this many digits of a second: 10 µs.
_DIGITS = 5
_NOT_PREDICTED = "how well it is predicted in motion is not shown; record it moving"


@dataclass(frozen=True, kw_only=True, eq=False)
class Prepared:
    """Recordings made ready for one fit: joints matched, processed alike, joined.

    Attributes
    ----------
    robot : RobotModel
        Whose joints they have.
    logs : tuple of Recording
        As they were measured.
    samples : Samples
        Of all of them.
    processing : Processing
        How each was processed.
    notes : tuple of str
        How the processing was chosen, where there were several.
    without_effort : tuple of str
        Joints whose efforts are not used.
    findings : tuple of Finding
        What is wrong with the recordings (see `inspect_recording`), where they were inspected.
    """

    robot: RobotModel
    logs: tuple[Recording, ...]
    samples: Samples
    processing: Processing
    notes: tuple[str, ...] = ()
    without_effort: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()

    def __repr__(self) -> str:
        return f"Prepared({len(self.logs)} recordings of '{self.robot.name}', {self.samples!r})"

    def without(self, joint: str) -> Prepared:
        """Return these without the effort of one more joint."""
        return replace(self, samples=without_efforts(self.samples, self.robot, [joint]))

    def others(
        self,
        logs: Logs,
        processing: Processing | None = None,
        *,
        accept: Iterable[str] | None = None,
        gains: Any = None,
    ) -> Prepared:
        """Prepare other recordings in the same way, to be predicted.

        They have no covariance, which prediction does not need: any number of periods will do.

        Parameters
        ----------
        logs : Recording or path, or a sequence of these
            The others.
        processing : Processing, optional
            By default as these.
        accept : iterable of str, optional
            As for `prepare`.
        gains : DriveGains, path-like or (n,) array_like, optional
            As for `prepare`.
        """
        chosen = replace(processing or self.processing, covariance=None)
        if self.samples.judged is not self.samples:
            chosen = replace(chosen, contact_force_std=None)
        found = prepare(
            self.robot,
            logs,
            chosen,
            without_effort=self.without_effort,
            accept=accept,
            gains=gains,
            name="validation",
        )
        # The fit may know the joint well: only its prediction lacks motion here.
        told = (
            replace(each, remedy=_NOT_PREDICTED) if each.kind == "joint_at_rest" else each
            for each in found.findings
        )
        return replace(found, findings=tuple(told))


def prepare(
    robot: RobotModel | str | os.PathLike[str],
    logs: Logs,
    processing: ProcessingOf = None,
    *,
    without_effort: Iterable[str] = (),
    accept: Iterable[str] | None = None,
    gains: Any = None,
    name: str = "log",
    total_mass: float | None = None,
    terms: Iterable[Any] = (),
) -> Prepared:
    """Read, match, process and join recordings of a robot.

    Parameters
    ----------
    robot : RobotModel, name or path
        The robot; loaded with a floating base where a recording has one.
    logs : Recording or path, or a sequence of these
        What was measured.
    processing : Processing or mapping, optional
        By default one that is chosen for all of them, with the changes in a mapping, and with the
        delays that recordings with a base show.
    without_effort : iterable of str, optional
        Joints of the robot whose efforts were not measured, or are wrong: their rows are masked,
        their motion is used.
    accept : iterable of str, optional
        The recordings are inspected, and refused where a finding makes every result meaningless,
        but for findings of these kinds. By default they are not inspected.
    gains : DriveGains, path-like or (n,) array_like, optional
        Gains that make torques of efforts that are currents, as in `read_recording`.
    name : str, optional
        What messages call the argument that holds the recordings.
    total_mass : float, optional
        What a robot with a floating base weighs, kg, which inspection compares with its efforts.
    terms : iterable, optional
        Friction terms that are given: the description does not tell efforts of springs among them.

    Raises
    ------
    DataError
        When a recording cannot be read, matched or processed, or is refused, they cannot be fitted
        together, a joint does not exist, or no joint is left.
    """
    without = joints_without(without_effort)
    robot, read = read_logs(robot, logs, name, without_effort=without, gains=gains)
    require_joint_covariance(read)
    for log in read:
        require_torques(log)
        require_its_base(robot, log)
    sprung = moved_by_springs(robot, terms)
    subjects = [replace(Subject.of(log, robot), sprung=sprung) for log in read]
    findings: tuple[Finding, ...] = ()
    if accept is not None:
        kinds = kinds_accepted(accept)
        with progress(1, f"inspecting the {name}"):
            findings = inspect_recordings(
                subjects,
                name="" if name == "log" else f"{name} recording",
                without_effort=without,
                total_mass=total_mass,
            )
        require_accepted(findings, kinds)
        without = tuple(dict.fromkeys((*without, *joints_left_out(findings, kinds))))
    chosen, why = chosen_processing(subjects, processing)
    if not isinstance(processing, Processing):
        chosen = with_delays(subjects, chosen, processing, without)
    pieces = []
    for number, subject in enumerate(subjects, 1):
        try:
            pieces.append(subject.processed(chosen))
        except DataError as error:
            if len(subjects) == 1:
                raise
            raise DataError(f"recording {number} of {len(subjects)}: {error}") from None
    samples = Samples.join(pieces)
    if without:
        samples = without_efforts(samples, robot, without)
    return Prepared(
        robot=robot,
        logs=read,
        samples=samples,
        processing=chosen,
        notes=() if why is None else (why,),
        without_effort=without,
        findings=findings,
    )


def read_logs(
    robot: RobotModel | str | os.PathLike[str],
    logs: Logs,
    name: str = "log",
    *,
    without_effort: Iterable[str] = (),
    gains: Any = None,
) -> tuple[RobotModel, tuple[Recording, ...]]:
    """Return a robot, and recordings that are given as such, as data frames or by their files.

    Parameters
    ----------
    robot : RobotModel, name or path
        The robot; loaded with a floating base where a recording has one.
    logs : Recording, path or data frame, or a sequence of these
        What was measured.
    name : str, optional
        What messages call them.
    without_effort : iterable of str, optional
        Joints of the robot whose efforts may lack.
    gains : DriveGains, path-like or (n,) array_like, optional
        Gains that make torques of efforts that are currents.

    Raises
    ------
    DataError
        When there are none, or a file cannot be read.
    """
    given = _several(
        logs,
        (Recording, str, os.PathLike),
        f"{name}: is or holds",
        "a Recording, the path of a log, a data frame, or a list of these",
    )
    if not given:
        raise DataError(f"{name}: there are none; give at least one.")
    absent = columns_without(robot, without_effort)
    known = as_gains(gains)
    read = []
    for log in given:
        if not isinstance(log, Recording):
            log = read_recording(log, without_effort=absent, gains=known)
        elif known is not None:
            log = scaled(log, known)
        read.append(log)
    return robot_of(robot, read), tuple(read)


def columns_without(
    robot: RobotModel | str | os.PathLike[str], joints: Iterable[str]
) -> tuple[str, ...]:
    """Return names of joints without effort, and their numbers from 1 for logs without names.

    Raises
    ------
    DataError
        When they are no names.
    """
    joints = joints_without(joints)
    if not joints:
        return ()
    model = robot_of(robot)
    own = model.joint_names[model.n_base :]
    return (*joints, *(str(own.index(name) + 1) for name in joints if name in own))


def require_joint_covariance(logs: Sequence[Recording]) -> None:
    """Refuse several recordings of which one has periods.

    Raises
    ------
    DataError
        Averages of different motions have no common covariance.
    """
    periodic = [number for number, log in enumerate(logs, 1) if log.period is not None]
    if len(logs) > 1 and periodic:
        raise DataError(
            f"recording {periodic[0]} of {len(logs)} has a period, and averages over periods "
            "cannot be joined with other recordings: fit one periodic recording alone, or leave "
            "its period out (period=None) so that it counts sample by sample."
        )


def chosen_processing(
    logs: Sequence[Recording | Subject], given: ProcessingOf = None
) -> tuple[Processing, str | None]:
    """Return one processing for recordings that are fitted together, and where it comes from.

    Each recording has its own default, chosen from its rate and its motion
    (`default_processing`). All are processed by that of the recording with the median cut-off, of
    an even number the lower one of the middle two: one unusual recording then decides nothing, and
    the choice is one that was made for a whole recording. With a floating base it is the higher
    one: a cut-off made for standing filters a gait's own motion away, and what that does to rows
    beside contacts is an error that no interval counts.

    Returns
    -------
    Processing
        The given one, or the choice for all of them with the given changes.
    str or None
        The choice in words, where there was one.

    Raises
    ------
    DataError
        When a change names no setting, or its value is out of range.
    """
    if isinstance(given, Processing):
        return given, None
    subjects = [Subject.of(log) for log in logs]
    floating = any(subject.given.base is not None for subject in subjects)
    common, why = agreed([subject.choice(given) for subject in subjects], floating=floating)
    return with_changes(common, {} if given is None else given), why


def agreed(choices: Sequence[Processing], *, floating: bool) -> tuple[Processing, str | None]:
    """Return the one of the recordings' processings that `chosen_processing` takes for all."""
    if len(choices) == 1:
        return choices[0], None
    ranked = sorted(range(len(choices)), key=lambda i: (choices[i].cutoff_hz, i))
    chosen = ranked[len(ranked) // 2 if floating else (len(ranked) - 1) // 2]
    cutoffs = ", ".join(f"{each.cutoff_hz:.3g}" for each in choices)
    return choices[chosen], (
        f"the {len(choices)} recordings are processed alike, as suits recording {chosen + 1}, "
        f"which has the median of their cut-offs ({cutoffs} Hz)"
    )


def with_delays(
    subjects: Sequence[Subject],
    processing: Processing,
    given: Mapping[str, Any] | None = None,
    unused: Collection[str] = (),
) -> Processing:
    """Return a processing that takes late channels of recordings with a base on time.

    Parameters
    ----------
    subjects : sequence of Subject
        What is to be processed alike; their sensors are the same, and so are the delays.
    processing : Processing
        Chosen for them.
    given : mapping, optional
        Settings that stand as they are.
    unused : collection of str, optional
        Joints whose efforts say nothing.

    Returns
    -------
    Processing
        With a reason for each delay that was found.
    """
    each = [subject.delays(unused) for subject in subjects if subject.given.base is not None]
    reasons = []
    for channel, delay in pooled_delays(each).items():
        field = f"{channel}_delay_s"
        if field in (given or {}) or not is_significant(channel, delay):
            continue
        value, count = round(delay.value, _DIGITS), sum(channel in found for found in each)
        shown = f"{count} of {len(each)} recordings show"
        text = (
            f"{CHANNELS[channel]} late by {1e3 * value:.3g} ± {1e3 * delay.error:.2g} ms against "
            f"the joints, as {'the recording shows' if len(each) == 1 else shown}"
        )
        reasons.append(Reason(field=field, value=value, text=text))
    changes: dict[str, Any] = {reason.field: reason.value for reason in reasons}
    return replace(processing, **changes, reasons=(*processing.reasons, *reasons))


def joints_without(given: Any) -> tuple[str, ...]:
    """Return joints without effort as a tuple of names; a single name counts as one.

    Raises
    ------
    DataError
        When they are no names.
    """
    if isinstance(given, str):
        return (given,)
    names = tuple(given) if isinstance(given, Iterable) else (given,)
    if not all(isinstance(name, str) for name in names):
        raise DataError(f"without_effort: is {given!r:.80}; give names of joints.")
    return names


def without_efforts(samples: Samples, robot: RobotModel, joints: Sequence[str]) -> Samples:
    """Return samples in which no row of some joints is used.

    Raises
    ------
    DataError
        When the robot has no such joint, or none is left.
    """
    own = robot.joint_names[robot.n_base :]
    unknown = [name for name in joints if name not in own]
    if unknown:
        raise DataError(
            f"without_effort: the robot '{robot.name}' has no joint {', '.join(unknown)}; it has "
            f"{', '.join(own)}."
        )
    if set(joints) == set(own):
        if not robot.n_base:
            raise DataError(
                "without_effort: names every joint; no effort is left to identify from."
            )
        if samples.contacts is None or not samples.contacts.measured:
            raise DataError(
                "without_effort: names every joint, which leaves the six rows of the base; they "
                "need measured forces of contacts. Give contacts with forces or wrenches and "
                "processing contact_force_std (N), or use the efforts of some joints."
            )
    mask = samples.used.copy()
    mask[:, [robot.joint_names.index(name) for name in joints]] = False
    note = f"efforts of joint {', '.join(joints)} are not used"
    return replace(samples, mask=mask, notes=(*samples.notes, note))


def as_pieces(given: object) -> tuple[Piece, ...]:
    """Return one or several samples, recordings and files as a tuple.

    Raises
    ------
    DataError
        When it is, or holds, something else.
    """
    kinds = (Samples, Recording, str, os.PathLike)
    return _several(
        given, kinds, "samples: hold", "Samples (see sdpid.process), recordings or paths of logs"
    )


def _several(given: Any, kinds: tuple[type, ...], refused: str, wanted: str) -> tuple[Any, ...]:
    """Return one thing or several, of some kinds or data frames, as a tuple."""
    alone = isinstance(given, kinds) or is_frame(given) or not isinstance(given, Iterable)
    found = (given,) if alone else tuple(given)
    for each in found:
        if not (isinstance(each, kinds) or is_frame(each)):
            raise DataError(f"{refused} {type(each).__name__} {each!r:.80}; give {wanted}.")
    return found


def samples_of(robot: RobotModel, given: object, processing: Processing | None = None) -> Samples:
    """Return the samples of one or several pieces: read, matched, processed and joined.

    Parameters
    ----------
    robot : RobotModel
        Whose joints they have.
    given : Samples, Recording or path, or a sequence of these
        The pieces.
    processing : Processing, optional
        Of recordings and files; by default `chosen_processing`.

    Raises
    ------
    DataError
        When a piece is something else, cannot be read, or the pieces cannot be joined.
    """
    pieces: list[Samples | Subject] = []
    for piece in as_pieces(given):
        if isinstance(piece, Samples):
            pieces.append(piece)
        else:
            log = piece if isinstance(piece, Recording) else read_recording(piece)
            pieces.append(Subject.of(log, robot))
    subjects, why = [each for each in pieces if isinstance(each, Subject)], None
    if processing is None and subjects:
        processing, why = chosen_processing(subjects)
    samples = Samples.join(
        [each if isinstance(each, Samples) else each.processed(processing) for each in pieces]
    )
    return samples if why is None else replace(samples, notes=(*samples.notes, why))


# Among friction terms: those that are used by default.
DEFAULT = "default"

# Half-width of the smooth sign of real friction, rad/s. Its columns pass the filter of the efforts,
# so it need not be as wide as the filter smears; wider friction is the sigmoid's business.
SMOOTH = 0.005


def default_friction(log: Recording) -> tuple[str | FrictionTerm, ...]:
    """Return the friction terms that are used by default.

    Records with periods are masked around reversals, where the exact sign is right. Others get
    a smooth sign, a sigmoid whose speeds are fitted joint by joint, and an offset for the
    sensors' zero errors. The same terms serve torque sensors and motor currents: on five
    real robots none predicted worse for the sigmoid, and the others choose it whichever is left
    out (docs/evidence/real_robots.md). Rotor inertia and couplings are effects, which `identify`
    adds where the training data show them (docs/guides/effects.md). Legs are driven through small
    gears whose rotors weigh as much as their links: recordings with a base get rotor inertia, and
    one smooth sign whose width is fitted.
    """
    if log.period is not None:
        return ("coulomb", "viscous")
    if log.base is not None:
        return (SigmoidFriction(), "viscous", "rotor_inertia")
    return (Coulomb(width=SMOOTH), SigmoidFriction(), "viscous", "offset")


def friction_of(
    log: Recording, given: Iterable[str | FrictionTerm] | None
) -> tuple[str | FrictionTerm, ...]:
    """Return the friction terms to use: given ones, `DEFAULT` among them standing for its terms."""
    terms: list[str | FrictionTerm] = []
    for each in (DEFAULT,) if given is None else given:
        terms += default_friction(log) if isinstance(each, str) and each == DEFAULT else [each]
    return tuple(terms)


def moved_by_springs(robot: RobotModel, terms: Iterable[Any]) -> frozenset[str]:
    """Return the joints on which given terms of the position act."""
    rows = dict(zip(robot.tree_joints, robot.expansion, strict=True))
    names = {str(getattr(each, "joint", "")) for each in terms}
    found = names & {*robot.joint_names}
    for name in names & {*rows} - found:
        found |= {n for n, x in zip(robot.joint_names, rows[name], strict=True) if x}
    return frozenset(found)
