"""`BaseMotion`, `Imu` and `Contacts`: what was measured of a base that nothing holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Literal, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from sdpid._common.arrays import (
    Array,
    Mask,
    frozen,
    frozen_view,
    real_array,
    rotation_matrices,
)
from sdpid._common.files import printable
from sdpid._common.tables import Table, facts_html
from sdpid.errors import DataError

T = TypeVar("T", bound="Sampled")

# A rotation matrix typed with three digits is off by this much; a larger error is another matrix.
# So is the norm of a unit quaternion.
_OFF = 2e-3
# Matrices and quaternions this near to orthonormal and to norm 1 are kept to the bit, so that rows
# of a recording are its rows.
_EXACT_ROTATION, _EXACT_UNIT = 1e-14, 1e-15
_FRAMES = ("world", "base")
_VELOCITIES = ("linear_velocity", "angular_velocity")
# Without flags a contact counts as closed where its force is at least this share of what only one
# in a hundred exceeds, in any contact: well above what a sensor shows in the air, and a single
# wrong value does not lift all feet.
_CLOSED_SHARE, _STRONG = 0.03, 0.99

ContactKind = Literal["point", "line", "plane"]


def samples(tail: tuple[int | None, ...], what: str) -> dict[str, Any]:
    """Return the metadata of a field of samples (N, ...), checked by `Sampled`.

    Parameters
    ----------
    tail : tuple of (int or None)
        The shape of one sample; None is the number of frames. Without one, flags of each frame.
    what : str
        What the columns are, for the message.
    """
    return {"samples": (tail, what)}


class Sampled:
    """A frozen dataclass with channels of as many samples each, of which some may be missing."""

    _called: ClassVar[str]

    @property
    def channels(self) -> dict[str, Any]:
        """The channels that there are, by their names."""
        names = [each.name for each in fields(self) if "samples" in each.metadata]  # type: ignore[arg-type]
        given = {name: getattr(self, name) for name in names}
        return {name: table for name, table in given.items() if table is not None}

    @property
    def n_samples(self) -> int:
        """Number of samples, N."""
        return next(len(table) for table in self.channels.values())

    def rows(self: T, rows: slice | NDArray[Any]) -> T:
        """Return some samples."""
        taken: Any = {name: table[rows] for name, table in self.channels.items()}
        for name, part in vars(self).items():
            if isinstance(part, Sampled):
                taken[name] = part.rows(rows)
        return replace(self, **taken)  # type: ignore[type-var]

    def _keep_samples(self, frames: int = 0) -> None:
        """Check all channels, and put them back read-only."""
        for each in fields(self):  # type: ignore[arg-type]
            if "samples" not in each.metadata or (given := getattr(self, each.name)) is None:
                continue
            called = f"{self._called}.{each.name}"
            tail, what = each.metadata["samples"]
            if tail:
                tail = tuple(frames if size is None else size for size in tail)
                array = np.ascontiguousarray(real_array(given, called, ndim=1 + len(tail)))
            else:
                tail, array = (frames,), _flags(given, called)
            if array.shape[1:] != tail or not array.size:
                wanted = ", ".join(["N", *map(str, tail)])
                raise DataError(f"{called}: has shape {array.shape}, expected ({wanted}): {what}.")
            object.__setattr__(self, each.name, frozen_view(array))
        lengths = {name: len(table) for name, table in self.channels.items()}
        if len(set(lengths.values())) > 1:
            listed = ", ".join(f"{name} {length}" for name, length in lengths.items())
            raise DataError(
                f"{self._called}: its channels have different numbers of samples: {listed}."
            )

    def _words(self) -> list[str]:
        """Return the channels that are there, in words."""
        return [name.replace("_", " ") for name in self.channels]


def _flags(given: Any, called: str) -> NDArray[Any]:
    """Return flags that are True or False, or 1 and 0."""
    array = np.asarray(given)
    if array.dtype != np.bool_:
        numbers = real_array(given, called, ndim=2)
        if not np.isin(numbers, (0.0, 1.0)).all():
            other = numbers[~np.isin(numbers, (0.0, 1.0))][0]
            raise DataError(
                f"{called}: holds {other:.6g}, expected True or False (or 1 and 0); compare "
                "forces or probabilities with a threshold first."
            )
        array = numbers == 1.0
    return np.ascontiguousarray(array)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Imu(Sampled):
    """What an inertial measurement unit on the base measured, and where it sits.

    Parameters
    ----------
    gyroscope : (N, 3) array_like, optional
        Angular velocity in rad/s, in the sensor's axes.
    accelerometer : (N, 3) array_like, optional
        Specific force in m/s², in the sensor's axes: acceleration less gravity, so +9.81 along
        the upward axis at rest.
    translation : (3,) array_like, optional
        The sensor's place in the frame of the base link, m.
    rotation : (3, 3) array_like, optional
        The sensor's axes in the frame of the base link, as columns: a vector in the base is
        ``rotation @ vector_in_sensor``.

    Raises
    ------
    DataError
        When neither sensor is there, shapes do not agree, or `rotation` is no rotation.

    Examples
    --------
    >>> still = np.zeros((100, 3))
    >>> sdpid.Imu(gyroscope=still, accelerometer=still + [0.0, 0.0, 9.81])
    Imu(100 samples, gyroscope, accelerometer)
    """

    gyroscope: Array | None = field(default=None, metadata=samples((3,), "rad/s about x, y, z"))
    accelerometer: Array | None = field(default=None, metadata=samples((3,), "m/s² along x, y, z"))
    translation: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array = field(default_factory=lambda: np.eye(3))
    _called: ClassVar[str] = "imu"

    def __post_init__(self) -> None:
        self._keep_samples()
        if not self.channels:
            raise DataError("imu: has neither gyroscope nor accelerometer; leave it out.")
        translation = frozen(real_array(self.translation, "imu.translation", ndim=1))
        if translation.shape != (3,):
            raise DataError(
                f"imu.translation: has shape {translation.shape}, expected (3,): x, y, z in m."
            )
        object.__setattr__(self, "translation", translation)
        object.__setattr__(self, "rotation", _rotation_matrix(self.rotation, "imu.rotation"))

    def __repr__(self) -> str:
        return f"Imu({', '.join([f'{self.n_samples} samples', *self._words()])})"

    def _repr_html_(self) -> str:
        facts = {
            "samples": self.n_samples,
            "measured": ", ".join(self._words()),
            "translation, m": str(self.translation.tolist()),
        }
        return facts_html("Imu", facts)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class BaseMotion(Sampled):
    """Pose and velocity of a robot's base link over time: that of a quadruped or a humanoid.

    Parameters
    ----------
    orientation : (N, 4) array_like
        Unit quaternions x, y, z, w that turn vectors of the base link's frame into the world's.
        The world's z axis points up. They are normalized, and their signs made continuous.
    position : (N, 3) array_like, optional
        Origin of the base link's frame in the world, m.
    linear_velocity : (N, 3) array_like, optional
        Velocity of that origin, m/s. Identification never needs it.
    angular_velocity : (N, 3) array_like, optional
        rad/s.
    velocity_frame : {"world", "base"}, optional
        Axes of both velocities; required where there is one.
    imu : Imu, optional
        What a sensor on the base measured.

    Raises
    ------
    DataError
        When shapes do not agree, quaternions are not of norm 1 within 0.002, or the frame of
        velocities is not said.

    Examples
    --------
    >>> level = np.tile([0.0, 0.0, 0.0, 1.0], (100, 1))
    >>> sdpid.BaseMotion(orientation=level, position=np.zeros((100, 3)))
    BaseMotion(100 samples, orientation, position)
    """

    orientation: Array = field(metadata=samples((4,), "unit quaternions x, y, z, w"))
    position: Array | None = field(default=None, metadata=samples((3,), "x, y, z in m"))
    linear_velocity: Array | None = field(default=None, metadata=samples((3,), "x, y, z in m/s"))
    angular_velocity: Array | None = field(default=None, metadata=samples((3,), "x, y, z in rad/s"))
    velocity_frame: Literal["world", "base"] | None = None
    imu: Imu | None = None
    _called: ClassVar[str] = "base"

    def __post_init__(self) -> None:
        if self.orientation is None:
            raise DataError("base.orientation: is missing; give unit quaternions x, y, z, w.")
        self._keep_samples()
        turns = _continuous(_unit(self.orientation))
        object.__setattr__(self, "orientation", frozen_view(turns))
        moving = [name for name in _VELOCITIES if name in self.channels]
        if moving and self.velocity_frame not in _FRAMES:
            raise DataError(
                f"base.velocity_frame: is {self.velocity_frame!r}, expected 'world' or 'base': "
                f"the axes of {' and '.join(moving)}. Where that is not known, leave the "
                "velocities out."
            )
        if not moving and self.velocity_frame is not None:
            raise DataError("base.velocity_frame: is given without a velocity; leave it out.")
        if self.imu is not None:
            if not isinstance(self.imu, Imu):
                raise DataError(f"base.imu: is {type(self.imu).__name__}, expected sdpid.Imu.")
            if self.imu.n_samples != self.n_samples:
                raise DataError(
                    f"base.imu: has {self.imu.n_samples} samples, base.orientation "
                    f"{self.n_samples}; bring both to the same time stamps."
                )

    @property
    def rotations(self) -> Array:
        """Rotation matrices of the orientations, base to world, (N, 3, 3)."""
        return rotation_matrices(self.orientation)

    def sensed(self, sensor: str) -> Array | None:
        """Return what a sensor of the IMU shows in the axes of the base; None where there is none.

        Parameters
        ----------
        sensor : {"gyroscope", "accelerometer"}
            Which one.
        """
        if self.imu is None or sensor not in self.imu.channels:
            return None
        return np.asarray(self.imu.channels[sensor] @ self.imu.rotation.T)

    def __repr__(self) -> str:
        parts = [f"{self.n_samples} samples", *self._words()]
        if self.velocity_frame is not None:
            parts.append(f"velocities in {self.velocity_frame} axes")
        return f"BaseMotion({', '.join([*parts, *([] if self.imu is None else ['IMU'])])})"

    def _repr_html_(self) -> str:
        facts: dict[str, object] = {
            "samples": self.n_samples,
            "measured": ", ".join(self._words()),
            "axes of velocities": self.velocity_frame,
            "IMU": None if self.imu is None else ", ".join(self.imu._words()),
        }
        return facts_html("BaseMotion", facts)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Contacts(Sampled):
    """Which parts of a robot touched the ground, and with what forces.

    Parameters
    ----------
    frames : sequence of str
        Names of frames of the robot, c in all: one a foot.
    kind : {"point", "line", "plane"} or sequence of them
        What a contact transmits: a force; a force and two moments (an edge along the frame's y
        axis); a force and three moments (a flat foot). One for all, or one each; kept as one each.
    down : (N, c) array_like of bool, optional
        Whether the contact is closed.
    forces : (N, c, 3) array_like, optional
        Forces on the robot in the world's axes, N.
    wrenches : (N, c, 6) array_like, optional
        Forces and moments on the robot about the frame's origin in the world's axes, N and N·m,
        in place of `forces`.
    offset : (3,) or (c, 3) array_like, optional
        Contact point relative to the frame's origin in the world's axes, m:
        ``(0, 0, -radius)`` where the frame is the center of a sphere. Kept as (c, 3).

    Raises
    ------
    DataError
        When names are repeated, shapes do not agree, flags are no flags, or there is nothing
        but names.

    Examples
    --------
    >>> down = np.ones((100, 2), dtype=bool)
    >>> sdpid.Contacts(frames=["left_sole", "right_sole"], kind="plane", down=down)
    Contacts(100 samples, 2 planes, flags)
    """

    frames: tuple[str, ...]
    kind: tuple[ContactKind, ...] = ("point",)
    down: Mask | None = field(default=None, metadata=samples((), "one column for each frame"))
    forces: Array | None = field(
        default=None, metadata=samples((None, 3), "x, y, z in N for each frame")
    )
    wrenches: Array | None = field(
        default=None, metadata=samples((None, 6), "forces, then moments, for each frame")
    )
    offset: Array = field(default_factory=lambda: np.zeros(3))
    _called: ClassVar[str] = "contacts"

    def __post_init__(self) -> None:
        frames = distinct_names(self.frames, "contacts.frames", "frame names")
        c = len(frames)
        object.__setattr__(self, "frames", frames)
        object.__setattr__(self, "kind", _kinds(self.kind, c))
        self._keep_samples(c)
        if self.forces is not None and self.wrenches is not None:
            raise DataError("contacts: give forces or wrenches, not both.")
        if not self.channels:
            raise DataError(
                "contacts: give down, forces or wrenches; where nothing is known of contacts, "
                "leave them out."
            )
        object.__setattr__(self, "offset", offsets(self.offset, c, "contacts.offset"))

    @property
    def n(self) -> int:
        """Number of contacts, c."""
        return len(self.frames)

    @property
    def measured(self) -> Array | None:
        """Measured forces (N, c, 3), N, those of wrenches too; None where there are none."""
        return self.forces if self.wrenches is None else self.wrenches[..., :3]

    @property
    def closed(self) -> Mask:
        """Flags (N, c), or what forces tell where there are none."""
        if self.down is not None:
            return self.down
        measured = self.measured
        assert measured is not None  # one of the three is always there
        size = np.linalg.norm(measured, axis=-1)
        told: Mask = size > _CLOSED_SHARE * np.quantile(size, _STRONG)
        return told

    def __repr__(self) -> str:
        counts = {kind: self.kind.count(kind) for kind in get_args(ContactKind)}
        kinds = [f"{n} {kind}{'s' if n > 1 else ''}" for kind, n in counts.items() if n]
        parts = [f"{self.n_samples} samples", *kinds, *self._words()]
        return f"Contacts({', '.join(parts)})"

    def _repr_html_(self) -> str:
        columns: dict[str, Sequence[object]] = {"frame": self.frames, "kind": self.kind}
        if self.down is not None:
            columns["share down"] = self.down.mean(axis=0).tolist()
        facts: dict[str, object] = {
            "samples": self.n_samples,
            "measured": ", ".join(self._words()),
        }
        return facts_html("Contacts", facts, Table.of_columns(columns))

    def _words(self) -> list[str]:
        """Return what is there, in words."""
        return ["flags" if name == "down" else name for name in self.channels]


def offsets(given: Any, count: int, called: str) -> Array:
    """Return a place (3,), or one for each of several frames, as places (count, 3)."""
    places = real_array(given, called, ndim=np.ndim(given) or 1)
    if places.shape not in ((3,), (count, 3)):
        raise DataError(
            f"{called}: has shape {places.shape}, expected (3,) or {(count, 3)}: x, y, z in m, for "
            "all frames or for each."
        )
    return frozen(np.broadcast_to(places, (count, 3)))


def distinct_names(names: Any, called: str, expected: str) -> tuple[str, ...]:
    """Return distinct, non-empty names without what a terminal would obey."""
    if isinstance(names, str) or not isinstance(names, (Sequence, np.ndarray)) or not len(names):
        raise DataError(f"{called}: is {names!r:.80}, expected a sequence of {expected}.")
    if any(not isinstance(name, str) or not name for name in names):
        raise DataError(f"{called}: {tuple(names)!r:.80} holds something that is not a name.")
    result = tuple(printable(str(name)) for name in names)
    repeated = sorted({name for name in result if result.count(name) > 1})
    if repeated:
        raise DataError(f"{called}: {', '.join(repeated)} is there more than once.")
    return result


def _kinds(given: Any, count: int) -> tuple[Any, ...]:
    """Return one kind for each contact."""
    kinds = (given,) if isinstance(given, str) else tuple(given)
    unknown = [kind for kind in kinds if kind not in get_args(ContactKind)]
    if unknown:
        raise DataError(
            f"contacts.kind: {unknown[0]!r:.80} is not known; known are "
            f"{', '.join(get_args(ContactKind))}."
        )
    if len(kinds) not in (1, count):
        raise DataError(f"contacts.kind: {len(kinds)} kinds for {count} frames; give one or each.")
    return kinds * count if len(kinds) == 1 else kinds


def _rotation_matrix(given: Any, called: str) -> Array:
    """Return the rotation matrix that is nearest to a given one, which must be near to it."""
    matrix = real_array(given, called, ndim=2)
    if matrix.shape != (3, 3):
        raise DataError(f"{called}: has shape {matrix.shape}, expected (3, 3): a rotation matrix.")
    off = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
    if off > _OFF or np.linalg.det(matrix) < 0.0:
        raise DataError(
            f"{called}: is no rotation matrix: R·Rᵀ is off the unit matrix by {off:.3g}, limit "
            f"{_OFF:g}, and its determinant is {np.linalg.det(matrix):.4g}, expected 1. "
            "Its columns are the sensor's axes in the axes of the base."
        )
    if off > _EXACT_ROTATION:
        left, _, right = np.linalg.svd(matrix)
        matrix = left @ right
    return frozen(matrix)


def _unit(quaternions: Array) -> Array:
    """Return quaternions of norm 1, or say which are not nearly so."""
    norms = np.linalg.norm(quaternions, axis=1)
    off = np.abs(norms - 1.0)
    worst = int(off.argmax())
    if off[worst] > _OFF:
        raise DataError(
            f"base.orientation: the quaternion of sample {worst + 1} has the norm "
            f"{norms[worst]:.6g}, off 1 by {off[worst]:.3g}, limit {_OFF:g}; give unit "
            "quaternions x, y, z, w, not Euler angles."
        )
    if off[worst] <= _EXACT_UNIT:
        return quaternions
    unit: Array = quaternions / norms[:, None]
    return unit


def _continuous(quaternions: Array) -> Array:
    """Return quaternions without changes of sign, which mean nothing, between samples."""
    turned = np.einsum("ki,ki->k", quaternions[1:], quaternions[:-1]) < 0.0
    if not turned.any():
        return quaternions
    sign = np.where(np.cumsum(turned) % 2 == 1, -1.0, 1.0)
    result = np.array(quaternions)
    result[1:] *= sign[:, None]
    return result
