"""Refuse recordings of currents from which no gains would follow."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.drive_gains.fit import FoundGains, GainFit
from sdpid.assurance.drive_gains.load import Load
from sdpid.errors import DataError, IdentifiabilityError
from sdpid.estimation.information import least_squares
from sdpid.experiment.inspection.inspect import inspect_recordings, require_accepted
from sdpid.experiment.inspection.kinds import Finding
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.recording.joints import require_fixed_base
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.recording.stored import extremes
from sdpid.robot.model.model import RobotModel

# Efforts that are this near to what the description's bodies need, at every joint that shows it,
# are torques: of 17 recordings of six arms with torque sensors the scales lie between 0.7 and 2.3.
_LIKE_TORQUES = 0.5, 2.0
# A description's efforts are followed where they explain this much of a current beside friction.
_FOLLOWS = 0.5

# Errors of filtered currents are so alike from sample to sample that the errors of gains are up to
# this many times those that white noise would make (2 to 4 on a UR10e).
_ALIKE = 3.0
# A gain that is known no better than to this share is not shown by the recordings, and from an
# error of this many times the gain on numbers say nothing more.
NOT_SHOWN, _NOT_AT_ALL = 0.25, 10.0
# Explained together, recordings leave at most this many times what each leaves alone, or at most
# this share of the currents (rms about their mean): 1 to 4 % and, of short ones which explain
# themselves too well, up to 5 times, on two pairs of a UR10e.
_ONE_ARM, _LEFT = 3.0, 0.1
# Where not even the scale of all gains together is shown.
_NO_LOAD_SEEN = "If a load gives the scale, check that it was mounted, and in which recordings."
# Null directions of the derivative: a singular value below this share of the largest.
_INVISIBLE = 1e-6
# An entry of such a direction that is nothing.
_NO_PART = 0.05


def require_currents(bare: Sequence[Recording], loaded: Sequence[Recording]) -> None:
    """Refuse recordings whose efforts are torques, and one given both without and with load.

    Raises
    ------
    DataError
        Naming the recordings.
    """
    for name, logs in (("without_load", bare), ("with_load", loaded)):
        for number, log in enumerate(logs, 1):
            require_fixed_base(log, f"gains, {name} recording {number}")
            if not log.currents:
                turned = "its currents were turned into torques by gains already"
                why = "its efforts are torques in N·m" if log.gains is None else turned
                raise DataError(
                    f"{name} recording {number}: {why}; give currents in A (read_recording(..., "
                    "currents=True), Recording(..., currents=True))."
                )
    for (k, first), (m, second) in itertools.product(enumerate(bare, 1), enumerate(loaded, 1)):
        if np.array_equal(first.effort, second.effort):
            raise DataError(
                f"gains: recording {k} without load and recording {m} with load are the same: "
                "all their efforts are equal. Give the log of the run with the load "
                "(with_load=, --with)."
            )


def require_every_current(logs: Sequence[Recording]) -> None:
    """Refuse recordings in all of which the current of a joint is zero.

    Raises
    ------
    DataError
        Naming the joints.
    """
    largest = np.max([np.fmax(*np.abs(extremes(log.effort))) for log in logs], axis=0)
    if not largest.all():
        silent = ", ".join(n for n, a in zip(logs[0].names, largest, strict=True) if not a)
        raise DataError(
            f"gains: the current of {silent} is zero in every recording, which tells no gain; log "
            "it, or hold the joint still and describe it as fixed."
        )


def rough_gains(robot: RobotModel, samples: Samples, accept: Iterable[str] = ()) -> Array:
    """Return rough gains (n,) by the described links.

    Of joints that do not show it the median of the others; 10 N·m/A where there is no description.

    Raises
    ------
    DataError
        When the efforts are what the described bodies need, so torques, unless ``effort_scale`` is
        accepted.
    """
    gains, shown = np.full(robot.n, 10.0), np.zeros(robot.n, dtype=bool)
    if not np.any(robot.prior[:, 0] > 0.0):
        return gains
    states = samples.position, samples.velocity, samples.acceleration
    rigid = robot.efforts_of_bodies(robot.prior, *states)
    for j, rows in enumerate(samples.used.T):
        v, a = states[1][rows, j], states[2][rows, j]
        friction = np.column_stack([np.sign(v), v, a, np.ones(len(v))])
        x, left = (
            each - friction @ least_squares(friction, each)
            for each in (rigid[rows, j], samples.effort[rows, j])
        )
        if np.linalg.norm(x) <= _INVISIBLE * np.linalg.norm(rigid[rows, j]):
            continue
        along = float(x @ left)
        shown[j] = along > _FOLLOWS * np.linalg.norm(x) * np.linalg.norm(left)
        if along > 0.0:
            gains[j] = float(x @ x) / along
    if not shown.any():
        return gains
    gains[~shown] = float(np.median(gains[shown]))
    least, most = gains[shown].min(), gains[shown].max()
    low, high = _LIKE_TORQUES
    if low < least and most < high and "effort_scale" not in accept:
        raise DataError(
            "gains: the efforts are torques, not currents: the described links need "
            f"{least:.2g} to {most:.2g} times as much at every joint "
            f"that shows it, limits {low:g} and {high:g}. Give the columns of currents, or accept "
            "'effort_scale' for drives of about 1 N·m/A."
        )
    return gains


def looked_at(
    robot: RobotModel,
    bare: Sequence[Recording],
    loaded: Sequence[Recording],
    gains: Array,
    accept: Sequence[str],
) -> tuple[Finding, ...]:
    """Return what is wrong with recordings of currents, but for their scale.

    They are compared with the description by rough gains (n,): those without load together, for
    they carry the same, and each with load by itself.

    Raises
    ------
    DataError
        When a finding refuses one, and its kind is not accepted.
    """
    findings: list[Finding] = []
    for name, logs in [("without_load", bare), *(("with_load", [log]) for log in loaded)]:
        scaled = [
            replace(log, effort=np.asarray(log.effort) * gains, currents=False) for log in logs
        ]
        findings += [
            each
            for each in inspect_recordings(scaled, robot, name=name)
            if each.kind not in ("effort_scale", "effort_unlike_description")
        ]
        require_accepted(findings, accept)
    return tuple(findings)


def require_bearable(robot: RobotModel, load: Load, samples: Samples, placed: Array) -> None:
    """Refuse a load whose weight alone is more than the arm's drives can hold.

    Parameters
    ----------
    robot : RobotModel
        The arm.
    load : Load
        The load.
    samples : Samples
        Of the recording that carries it.
    placed : ndarray, shape (10·links, 10)
        What its parameters add to the links'.

    Raises
    ------
    DataError
        Naming the joint.
    """
    bodies, still = placed[:, 0].reshape(-1, 10), np.zeros_like(samples.velocity)
    per_kg = np.abs(robot.efforts_of_bodies(bodies, samples.position, still, still))
    weight, limits = load.mass * per_kg.max(axis=0), robot.effort_limits
    worst = int(np.argmax(weight / limits))
    if weight[worst] > limits[worst]:
        raise DataError(
            f"load: {load.mass:g} kg is heavier than the arm can tell: its weight alone needs "
            f"{weight[worst]:.3g} N·m of {robot.joint_names[worst]}, whose limit is "
            f"{limits[worst]:.3g} N·m. Check the mass (kg) and the frame of the load."
        )


def require_one_arm(fit: GainFit, found: FoundGains) -> None:
    """Refuse recordings that no one arm explains together.

    Raises
    ------
    DataError
        Naming the joints.
    """
    errors, names = fit.mean_squares(found), fit.model.robot.joint_names
    ratio = np.sqrt(errors / np.maximum(fit.alone, 1e-300))
    left = np.sqrt(errors) / np.maximum(fit.model.spread, 1e-150)
    bad = ", ".join(
        f"{100.0 * share:.2g} % of the currents of {name}, {times:.2g} times as much as each alone"
        for name, share, times in zip(names, left, ratio, strict=True)
        if times > _ONE_ARM and share > _LEFT
    )
    if bad:
        raise DataError(
            "gains: the recordings are not of one arm with one load: explained together they leave "
            f"(rms) {bad}; limits {100.0 * _LEFT:g} % and {_ONE_ARM:g} times. Leave out recordings "
            "of another arm, tool or mounting, and check which carry the load, and whether the "
            "robot's description is of this arm."
        )


def require_shown(fit: GainFit, logs: Array) -> None:
    """Refuse recordings that do not show a gain, naming what they do show.

    Parameters
    ----------
    fit : GainFit
        The fit; its weights are those of every joint alone.
    logs : ndarray, shape (n,)
        Logarithms of rough gains.

    Raises
    ------
    IdentifiabilityError
        With the joints.
    """
    model, free = fit.model, fit.model.free
    anchored = bool(model.loads) or not free.all() or model.description_error is not None
    names = [name for name, each in zip(model.robot.joint_names, free, strict=True) if each]
    unknown, _, slopes = fit.at(logs)
    own = slopes[:, free]
    whole = np.linalg.norm(fit.slopes(logs, model.bodies(unknown))[:, free], axis=0)
    scale = np.where(whole > 0.0, whole, 1.0)
    _, singular, Vt = np.linalg.svd(own / scale, full_matrices=True)
    singular = np.concatenate([singular, np.zeros(len(names) - len(singular))])
    invisible = Vt[singular <= _INVISIBLE] / scale
    if len(invisible):
        raise IdentifiabilityError(_invisible_words(invisible, names, anchored))
    errors = _ALIKE * np.sqrt(np.diag(np.linalg.inv(own.T @ own)))
    bad = ", ".join(
        f"{name} {f'to {100.0 * error:.0f} %' if error < _NOT_AT_ALL else 'not at all'}"
        for name, error in zip(names, errors, strict=True)
        if error > NOT_SHOWN
    )
    if bad:
        known = [n for n, e in zip(names, errors, strict=True) if e <= NOT_SHOWN]
        rest = f"; those of {', '.join(known)} are" if known else ""
        load = f" {_NO_LOAD_SEEN}" if anchored and not known else ""
        raise IdentifiabilityError(
            f"gains: the recordings do not show the gains of all joints: {bad}, limit "
            f"{100.0 * NOT_SHOWN:.0f} %{rest}. A heavier load, further from the axes, or a longer "
            "and faster motion shows more; or give the gain of such a joint (known=, --known)."
            f"{load}"
        )


def _invisible_words(directions: Array, names: Sequence[str], anchored: bool) -> str:
    """Return in words which gains are open, and which combinations are not."""
    size = np.abs(directions).max(axis=1, keepdims=True)
    parts = np.abs(directions / size) > _NO_PART
    concerned = [name for name, part in zip(names, parts.any(axis=0), strict=True) if part]
    others = [name for name in names if name not in concerned]
    if len(directions) == 1 and len(concerned) > 1:
        shown = f"only their ratios are shown ({' : '.join(concerned)})"
    elif len(directions) < len(concerned):
        shown = f"only {len(concerned) - len(directions)} combinations of them are shown"
    else:
        shown = "what they move and how strong they are cannot be told apart"
    rest = f" Those of {', '.join(others)} are shown." if others else ""
    remedy = (
        "give one of them (known=, --known), or the center of mass and inertia of the load too "
        "(load=, --load-com, --load-inertia)"
        if anchored
        else "give a run with a load of known mass (with_load=, load=; --with, --load), a known "
        "gain (known=, --known), or what error the described links may have "
        "(description_error=, --description-error)"
    )
    opened = ", ".join(concerned)
    load = f" {_NO_LOAD_SEEN}" if anchored and not others else ""
    return f"gains: those of {opened} are open: {shown}.{rest} To close them, {remedy}.{load}"
