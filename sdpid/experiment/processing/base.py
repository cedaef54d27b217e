"""States of a floating base, from an IMU, a twist or a pose, and its contacts beside the joints'.

The base's own velocity is never needed: seen from a frame that moves along with it at one instant,
all accelerations are the same (Galilei). In that frame it is zero, and the spatial acceleration of
Pinocchio is the classical one. What is filtered is the specific force (acceleration less gravity,
which is what an accelerometer measures) and the angular velocity, both in body axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Mask, frozen_view
from sdpid.errors import DataError
from sdpid.experiment.processing.contact_samples import ContactSamples
from sdpid.experiment.processing.filters import reflected
from sdpid.experiment.processing.motion import white_noise
from sdpid.experiment.processing.pipeline import Pipeline, near
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.processing.settings import BaseSource, Processing
from sdpid.experiment.recording.floating import BaseMotion, Contacts
from sdpid.experiment.recording.gaps import Grid
from sdpid.experiment.recording.recording import Recording

# Velocity coordinates of a floating base, as Pinocchio and a loaded robot call them.
BASE_NAMES = tuple(f"root_joint/{axis}" for axis in ("vx", "vy", "vz", "wx", "wy", "wz"))
# Where no robot says another: that of `load_robot`, m/s².
GRAVITY = (0.0, 0.0, -9.81)


def require_finite(log: Recording, processing: Processing) -> None:
    """Refuse what is not known of recordings with a base.

    Raises
    ------
    DataError
        For a filter of unlimited memory, periods, and gains of drives.
    """
    if processing.filter != "finite":
        raise DataError(
            f"filter: is '{processing.filter}', whose memory has no end; a recording with a base "
            "needs 'finite': behind another filter a foot that is in the air still carries what it "
            "carried on the ground."
        )
    if log.period is not None:
        raise DataError(
            "period: a recording with a base has none: where a robot walks, no period repeats the "
            "one before; leave the period out."
        )
    if log.gains is not None:
        raise DataError(
            "gains: errors of drive gains are not known for recordings with a base; read them "
            "with torques (currents times gains)."
        )


def with_base(
    joints: Samples, log: Recording, pipeline: Pipeline, gravity: Sequence[float] = GRAVITY
) -> Samples:
    """Return samples of a floating robot, made of those of its joints.

    Parameters
    ----------
    joints : Samples
        Of the joints alone, (K, n).
    log : Recording
        A piece without gaps, with a base.
    pipeline : Pipeline
        What the joints passed; its settings say where accelerations are from, and what becomes of
        contacts.
    gravity : sequence of 3 floats
        In world axes, m/s².

    Returns
    -------
    Samples
        In Pinocchio's order: position (K, 7 + n), the rest (K, 6 + n). The base's rows are used:
        nothing drives it, so that its efforts are zero.
    """
    assert log.base is not None
    wanted = pipeline.processing.base_motion
    states, note = base_states(log.base, pipeline, np.array(gravity), wanted)
    states["effort"] = np.zeros((joints.n_samples, len(BASE_NAMES)))
    tables: dict[str, Any] = {
        name: np.hstack([table, getattr(joints, name)]) for name, table in states.items()
    }
    before = ((0, 0), (len(BASE_NAMES), 0))
    if joints.mask is not None:
        tables["mask"] = np.pad(joints.mask, before, constant_values=True)
    if joints.wide is not None:
        speeds = [frozen_view(np.pad(wide.velocity, before)) for wide in joints.wide]
        pairs = zip(joints.wide, speeds, strict=True)
        tables["wide"] = tuple(replace(wide, velocity=speed) for wide, speed in pairs)
    notes = [*joints.notes, note]
    if log.contacts is not None:
        tables["contacts"], clear, told = feet_of(log.contacts, pipeline)
        notes += told
        if not clear.any():
            raise DataError(
                f"impact_s: {pipeline.processing.impact_s:g} s around landings leave no sample; "
                "make it shorter, or leave it out (None)."
            )
        if not clear.all():
            every = np.ones(tables["effort"].shape, dtype=np.bool_)
            tables["mask"] = tables.get("mask", every) & clear[:, None]
    names = joints.joint_names and (*BASE_NAMES, *joints.joint_names)
    return replace(joints, **tables, joint_names=names, notes=tuple(notes))


def base_states(
    base: BaseMotion, pipeline: Pipeline, gravity: Array, wanted: BaseSource = "auto"
) -> tuple[dict[str, Array], str]:
    """Return the filtered states of a base at the kept samples, in body axes, and their source.

    Parameters
    ----------
    base : BaseMotion
        As it was recorded.
    pipeline : Pipeline
        Grid, filter and window.
    gravity : (3,) ndarray
        In world axes, m/s².
    wanted : {"auto", "imu", "twist", "pose"}
        What accelerations are from. ``"auto"`` takes the IMU where there is one, else what has the
        less noise of velocities and pose; the angular and the linear part each by itself.

    Returns
    -------
    dict of (K, ...) ndarray
        Position in m, zero where it was not recorded, and quaternion x, y, z, w, base to world;
        velocity, of which the linear part is zero, and acceleration, in m/s², rad/s and rad/s².
    str
        What they are from.

    Raises
    ------
    DataError
        When what is wanted was not recorded.
    """
    smooth = pipeline.low_pass.whole
    raw = unit(pipeline.whole(base.orientation))
    orientation = unit(smooth(raw))
    source, rate = _angular(base, pipeline, raw, wanted)
    linear_source, force = _specific_force(base, pipeline, orientation, rate, gravity, wanted)
    smooth_rate = smooth(rate)
    acceleration = smooth(force) + into_body(orientation, gravity)
    place = np.zeros((len(raw), 3))
    if base.position is not None:
        place = smooth(pipeline.whole(base.position))
    states = {
        "position": [place, orientation],
        "velocity": [np.zeros_like(smooth_rate), smooth_rate],
        "acceleration": [acceleration, _derivative(pipeline, smooth_rate)],
    }
    kept = {name: pipeline.kept(np.hstack(parts)) for name, parts in states.items()}
    return kept, f"accelerations of the base: linear from {linear_source}, angular from {source}"


def _angular(
    base: BaseMotion, pipeline: Pipeline, raw: Array, wanted: BaseSource
) -> tuple[str, Array]:
    """Return the source and the angular velocity (M, 3) in body axes, not filtered."""
    sensed = base.sensed("gyroscope")
    if wanted in ("auto", "imu") and sensed is not None:
        return "the gyroscope", pipeline.whole(sensed)
    told = ""
    if wanted != "pose" and base.angular_velocity is not None:
        rate, chosen = pipeline.whole(base.angular_velocity), True
        if wanted != "twist":
            chosen, told = quieter(pipeline, rate, angle_noise(raw), "rad/s²")
        if chosen:
            own = base.velocity_frame == "base"
            return f"the recorded angular velocity{told}", rate if own else into_body(raw, rate)
    if wanted == "twist":
        raise DataError(
            "base_motion: is 'twist', and the recording has no angular velocity of the base; use "
            "'pose' or 'auto'."
        )
    weights = pipeline.differences.first
    return f"the orientation{told}", body_rate(raw, weights, pipeline.grid.step)


def _specific_force(
    base: BaseMotion,
    pipeline: Pipeline,
    orientation: Array,
    rate: Array,
    gravity: Array,
    wanted: BaseSource,
) -> tuple[str, Array]:
    """Return the source and the specific force (M, 3) at the base's origin, not filtered."""
    sensed = base.sensed("accelerometer")
    if wanted in ("auto", "imu") and base.imu is not None and sensed is not None:
        lever = np.asarray(base.imu.translation)
        turning = np.cross(_derivative(pipeline, rate), lever)
        turning += np.cross(rate, np.cross(rate, lever))
        return "the accelerometer", pipeline.whole(sensed) - turning
    if wanted == "imu":
        raise DataError(
            "base_motion: is 'imu', and the recording has no accelerometer; give base.imu, or use "
            "'twist', 'pose' or 'auto'."
        )
    place = None if base.position is None else pipeline.whole(base.position)
    told = ""
    if wanted != "pose" and base.linear_velocity is not None:
        velocity, chosen = pipeline.whole(base.linear_velocity), True
        if wanted != "twist" and place is not None:
            chosen, told = quieter(pipeline, velocity, white_noise(place), "m/s²")
        if chosen:
            found = _derivative(pipeline, velocity)
            if base.velocity_frame == "base":
                found += np.cross(rate, velocity) - into_body(orientation, gravity)
            else:
                found = into_body(orientation, found - gravity)
            return f"the recorded linear velocity{told}", found
    if wanted == "twist" or place is None:
        lacks = "linear velocity" if wanted == "twist" else "accelerometer, velocity or position"
        raise DataError(
            f"base_motion: is '{wanted}', and the recording has no {lacks} of the base; its linear "
            "acceleration is not known. Record one of them."
        )
    found = _derivative(pipeline, place, 2)
    return f"the position{told}", into_body(orientation, found - gravity)


def _derivative(pipeline: Pipeline, values: Array, order: int = 1) -> Array:
    """Return the first or second derivative of channels (M, c), continued by point reflection."""
    weights, step = pipeline.differences, pipeline.grid.step
    extended = reflected(values, weights.margin, weights.margin)
    return (weights.velocity if order == 1 else weights.acceleration)(extended, step)


def quieter(pipeline: Pipeline, velocity: Array, pose_noise: float, unit: str) -> tuple[bool, str]:
    """Return whether the velocity tells accelerations with less noise, and both noises in words.

    White noise of a channel is seen in its fourth differences, which hardly pass motion. Its share
    of the acceleration is what differences and filter make of it: a position is differentiated
    twice, a velocity once, so that the worse sensor may still be the better source.

    Parameters
    ----------
    pipeline : Pipeline
        Differences and filter.
    velocity : (M, 3) ndarray
        As it was recorded.
    pose_noise : float
        Of a position in m, or of an angle in rad: rms in a sample (`white_noise`, `angle_noise`).
    unit : str
        Of the acceleration.
    """
    # As long as the filter sees at least, and its differences.
    around = 2 * pipeline.low_pass.reach + 2 * pipeline.differences.margin
    impulse = np.zeros((2 * around + 1, 1))
    impulse[around] = 1.0
    of_velocity, of_pose = (
        noise
        * float(np.linalg.norm(pipeline.low_pass.whole(_derivative(pipeline, impulse, order))))
        for noise, order in ((white_noise(velocity), 1), (pose_noise, 2))
    )
    chosen = of_velocity < of_pose
    less, more = sorted((of_velocity, of_pose))
    other = "the pose" if chosen else "the recorded velocity"
    return chosen, f" (noise of {less:.2g} {unit}, from {other} {more:.2g})"


def angle_noise(quaternions: Array) -> float:
    """Return the white noise of unit quaternions (M, 4) as an angle about each axis, rad."""
    # A turn by a small angle moves a quaternion by half of it: four channels share three angles.
    return 2.0 * float(np.sqrt(4.0 / 3.0)) * white_noise(quaternions)


def base_limit(base: BaseMotion, rate_hz: float, share: float, wanted: str = "auto") -> float:
    """Return the frequency in Hz up to which noise in a base's acceleration is at most a share.

    White noise of s m in a sample of the position, differentiated twice, has the power
    3·(2π)⁴·s²·2·f⁵/(5·rate) below f, in m²/s⁴ of three axes; of s m/s of a velocity
    3·(2π)²·s²·2·f³/(3·rate). The share is that of gravity's power. The quietest of what
    accelerations may be from (`wanted`, see `base_states`) decides; infinite with an accelerometer,
    or without noise.
    """
    if wanted in ("auto", "imu") and base.sensed("accelerometer") is not None:
        return np.inf
    limits = []
    for source, table, order in (("twist", base.linear_velocity, 1), ("pose", base.position, 2)):
        if table is not None and wanted in ("auto", source):
            slope = 2 * order + 1
            power = 3.0 * (2.0 * np.pi) ** (2 * order) * white_noise(table) ** 2 * 2.0
            power /= slope * rate_hz
            limit = (share * GRAVITY[2] ** 2 / power) ** (1.0 / slope) if power > 0.0 else np.inf
            limits.append(float(limit))
    return max(limits, default=np.inf)


def unit(quaternions: Array) -> Array:
    """Return quaternions (M, 4) scaled to length one."""
    return np.asarray(quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True))


def into_body(quaternions: Array, vectors: Array) -> Array:
    """Return vectors (M, 3) or (3,) in body axes, given in world axes."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat(quaternions).apply(vectors, inverse=True))


def body_rate(quaternions: Array, weights: Array, step: float) -> Array:
    """Return the angular velocity (M, 3) in body axes, rad/s.

    A central difference whose terms are the logarithms of the rotations between the two samples of
    each pair, so that no component of a quaternion is differentiated. The ends repeat the outermost
    value.

    Parameters
    ----------
    quaternions : (M, 4) ndarray
        Orientations, body to world.
    weights : (2 m + 1,) ndarray
        Of a first derivative at unit step, odd.
    step : float
        Distance of two samples, s.
    """
    from scipy.spatial.transform import Rotation

    margin = weights.size // 2
    inner = len(quaternions) - 2 * margin
    turns = Rotation.from_quat(quaternions)
    rate = np.zeros((inner, 3))
    for lag in range(1, margin + 1):
        before, after = (turns[margin + each : margin + each + inner] for each in (-lag, lag))
        rate += weights[margin + lag] * (before.inv() * after).as_rotvec()
    return np.pad(rate / step, ((margin, margin), (0, 0)), mode="edge")


def feet_of(contacts: Contacts, pipeline: Pipeline) -> tuple[ContactSamples, Mask, list[str]]:
    """Return the contacts at the kept samples.

    A filtered effort holds the contact forces of all samples that the filter sees. A foot that was
    down at one of them counts as down.

    Parameters
    ----------
    contacts : Contacts
        As they were recorded.
    pipeline : Pipeline
        Grid, filter and window; its settings say by how much flags may be late or early, whether
        samples around landings are clear, and whether recorded forces are measurements.

    Returns
    -------
    ContactSamples
        For the rows.
    (K,) ndarray of bool
        Samples away from landings.
    list of str
        What was done, in words.

    Raises
    ------
    DataError
        When forces are to be measurements, and none were recorded.
    """
    processing, step, reach = pipeline.processing, pipeline.grid.step, pipeline.low_pass.reach
    margin_s, impact_s = processing.contact_margin_s, processing.impact_s
    wrench = _wrenches(contacts)
    on_ground = contacts.closed
    down = _on_grid(on_ground, pipeline.grid)
    wide = near(down, reach + round(margin_s / step))
    kept_down = pipeline.kept(wide)
    filtered = covariance = None
    # What holds a base without a sensor is eliminated beside forces that are measured.
    held = contacts.kind == ("plane",) and bool(on_ground.all())
    if processing.contact_force_std is not None and (wrench is not None or not held):
        if wrench is None:
            raise DataError(
                "contact_force_std: the recording has no contact forces; leave it out, and they "
                "are eliminated, or give contacts.forces or contacts.wrenches."
            )
        filtered = pipeline.kept(pipeline.low_pass.whole(pipeline.whole(wrench)))
        covariance = _covariance(contacts, processing)
    clear: Mask = np.ones(len(kept_down), dtype=np.bool_)
    notes = [_share_note(contacts, pipeline.kept(down), kept_down, reach * step + margin_s)]
    landing = _landings(down)
    beside: Mask = pipeline.kept(near(landing, reach + round((impact_s or 0.0) / step)))[:, 0]
    if impact_s is not None:
        share, count = 100.0 * float(beside.mean()), int(landing.sum())
        of_them = f"within {1e3 * impact_s:.3g} ms and the filter's memory of {count} landings"
        if beside.mean() > 1.0 - processing.kept_share:
            notes.append(
                f"samples {of_them} are not left out: they are {share:.3g} % of all, and less than "
                f"{100.0 * processing.kept_share:.3g} % would stay"
            )
        else:
            clear = ~beside
            if count:
                notes.append(f"{share:.3g} % of the samples left out, {of_them}")
    if wrench is not None:
        said = "used as measurements"
        if filtered is None:
            said = "not used: those of closed contacts are eliminated (contact_force_std)"
        notes.append(f"recorded contact forces are {said}")
    samples = ContactSamples(
        frames=contacts.frames,
        kind=contacts.kind,
        offset=contacts.offset,
        down=kept_down,
        forces=filtered,
        force_covariance=covariance,
        widened_s=reach * step + margin_s,
        landed=beside,
    )
    return samples, clear, notes


def carried(contacts: Contacts, reach: int) -> Contacts:
    """Return contacts that carry nothing while they are open, but for `reach` samples.

    The sensor of a foot in the air shows its offset, which a filter would take to the ground.
    """
    acting = near(contacts.closed, reach)[:, :, None]
    felt: dict[str, Any] = {k: v * acting for k, v in contacts.channels.items() if k != "down"}
    return replace(contacts, **felt)


def landing_share(contacts: Contacts, reach: int) -> float:
    """Return the share of a recording's samples that are at most `reach` ones from a landing."""
    return float(near(_landings(contacts.closed), reach).mean())


def _landings(down: Mask) -> Mask:
    """Return at which samples a contact closes, (N, 1)."""
    found = np.zeros((len(down), 1), dtype=np.bool_)
    found[1:, 0] = (down[1:] & ~down[:-1]).any(axis=1)
    return found


def _on_grid(flags: Mask, grid: Grid) -> Mask:
    """Return flags (N, c) at all grid points: set where that of either neighbor is set."""
    if grid.stamps is None:
        return flags[: grid.count]
    wanted = grid.origin + grid.step * np.arange(grid.count)
    after = np.clip(np.searchsorted(grid.stamps, wanted), 1, len(grid.stamps) - 1)
    return np.asarray(flags[after - 1] | flags[after])


def _wrenches(contacts: Contacts) -> Array | None:
    """Return forces and moments at the contact points (N, c, 6), in the world's axes."""
    if contacts.wrenches is not None:
        wrench = np.array(contacts.wrenches)
        wrench[..., 3:] -= np.cross(np.asarray(contacts.offset), wrench[..., :3])
        points = np.array([kind == "point" for kind in contacts.kind])
        wrench[:, points, 3:] = 0.0
        return wrench
    if contacts.forces is None:
        return None
    return np.concatenate([contacts.forces, np.zeros_like(contacts.forces)], axis=-1)


def _covariance(contacts: Contacts, processing: Processing) -> Array:
    """Return the covariance (6, 6) of recorded forces and moments, infinite where there is none."""
    moment = processing.contact_moment_std if contacts.wrenches is not None else None
    variance = np.full(6, np.inf if moment is None else moment**2)
    variance[:3] = (processing.contact_force_std or 0.0) ** 2
    return np.diag(variance)


def _share_note(contacts: Contacts, raw: Mask, wide: Mask, memory_s: float) -> str:
    shares = ", ".join(
        f"{name} {100.0 * a:.3g} → {100.0 * b:.3g} %"
        for name, a, b in zip(contacts.frames, raw.mean(axis=0), wide.mean(axis=0), strict=True)
    )
    return (
        f"a contact counts as closed within {1e3 * memory_s:.3g} ms of a closed one, which is as "
        f"far as the filter sees; share of time: {shares}"
    )
