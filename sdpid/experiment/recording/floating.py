"""`BaseMotion`, `Imu` and `Contacts`: what was measured of a base that nothing holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import cache
from itertools import product
from typing import Any, ClassVar, Literal, NamedTuple, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from sdpid._common.arrays import (
    Array,
    Mask,
    frozen,
    frozen_view,
    real_array,
    shaped,
)
from sdpid._common.files import printable, require_known
from sdpid._common.tables import Shown, Table, plain
from sdpid.errors import DataError
from sdpid.experiment.recording.stored import StoredArray

T = TypeVar("T", bound="Sampled")

XYZ, WRENCH = ("x", "y", "z"), ("fx", "fy", "fz", "mx", "my", "mz")
XYZW = (*XYZ, "w")
EACH_JOINT = "one column for each joint"
# Beyond any measured value in SI units, stamps since 1970 included; squares are far from overflow.
LARGEST = 1e12

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


# Names along each axis, or the attribute that has them.
_Axes = tuple[str | tuple[str, ...], ...]


class _Channel(NamedTuple):
    """What `samples` declares of a field."""

    column: str
    axes: _Axes
    what: str
    flags: bool


def samples(
    column: str, *axes: str | tuple[str, ...], what: str, needed: bool = False, flags: bool = False
) -> Any:
    """Return a field of samples (N, ...), by which they are checked, taken, written and counted.

    Parameters
    ----------
    column : str
        What the names of its columns begin with, formatted with the object as ``self``.
    *axes : str or tuple of str
        Names along each axis behind the first, or the attribute that has them. Joined by
        underscores, they end the names of the columns.
    what : str
        What the columns are, for the message.
    needed : bool
        Whether it has no default, which is None else.
    flags : bool
        Whether samples are true or false.
    """
    default: Any = MISSING if needed else None
    return field(default=default, metadata={"samples": _Channel(column, axes, what, flags)})


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Sampled(Shown):
    """A base of dataclasses with channels of as many samples each, of which some may be missing."""

    # What it is called in messages, what files say of it beside its columns, and the largest
    # magnitude of its numbers.
    _called: ClassVar[str] = ""
    _settings: ClassVar[tuple[str, ...]] = ()
    _most: ClassVar[float] = LARGEST

    @property
    def channels(self) -> dict[str, Any]:
        """The channels that there are, by their names."""
        given = {name: getattr(self, name) for name in self._fields()}
        return {name: table for name, table in given.items() if table is not None}

    @property
    def n_samples(self) -> int:
        """Number of samples, N."""
        return next(len(table) for table in self.channels.values())

    def rows(self: T, rows: slice | NDArray[Any]) -> T:
        """Return some samples."""
        taken: Any = {name: table[rows] for name, table in self.channels.items()}
        taken |= {name: part.rows(rows) for name, part in self._parts}
        return replace(self, **taken)

    def columns(self) -> dict[str, Array]:
        """Return all samples by the names that readers find columns by."""
        found: dict[str, Array] = {}
        for name, names in self.layout(self).items():
            if (table := getattr(self, name)) is not None:
                columns = np.asarray(table, dtype=np.float64).reshape(len(table), -1).T
                found |= dict(zip(names, columns, strict=True))
        for _, part in self._parts:
            found |= part.columns()
        return found

    @classmethod
    def layout(cls, known: Any) -> dict[str, list[str]]:
        """Return the names of the columns of each channel, of an object with the names on axes."""
        return {
            name: [
                "_".join(ends)
                for ends in product([channel.column.format(self=known)], *_on(channel.axes, known))
            ]
            for name, channel in cls._fields().items()
        }

    @classmethod
    @cache
    def _fields(cls) -> dict[str, _Channel]:
        """Return what `samples` says of each channel."""
        found = {each.name: each.metadata.get("samples") for each in fields(cls)}
        return {name: said for name, said in found.items() if said is not None}

    def settings(self) -> dict[str, dict[str, Any]]:
        """Return what a file says beside the columns, by table and name."""
        own = {key: plain(getattr(self, key)) for key in self._settings}
        found = {self._called.rstrip("."): own} if own else {}
        for _, part in self._parts:
            found |= part.settings()
        return found

    @property
    def _parts(self) -> list[tuple[str, Any]]:
        """The fields that have channels of their own."""
        return [(name, part) for name, part in vars(self).items() if isinstance(part, Sampled)]

    def _keep_samples(self, **parts: type[Sampled]) -> None:
        """Check all channels and the parts of a class, and put channels back read-only."""
        needed = {each.name for each in fields(self) if each.default is MISSING}
        for name, channel in self._fields().items():
            if name in needed and getattr(self, name) is None:
                raise DataError(f"{self._called}{name}: is missing; give {channel.what}.")
        first = count = None
        for name, given in self.channels.items():
            called, (_, axes, what, flags) = f"{self._called}{name}", self._fields()[name]
            if flags:
                array = _flags(given, called, len(axes))
            else:
                array = _numbers(given, called, len(axes), self._most)
            object.__setattr__(self, name, array)
            tail = tuple(max(len(names), 1) for names in _on(axes, self))
            if array.shape != (count or len(array), *tail) or not len(array):
                like = f", as many rows as {first}" if first else ", at least one row"
                wanted = ", ".join(map(str, [count or "N", *tail])) + "," * (not tail)
                raise DataError(
                    f"{called}: has shape {array.shape}, expected ({wanted}): {what}{like}."
                )
            first, count = first or name, len(array)
        for name, kind in parts.items():
            part, called = getattr(self, name), f"{self._called}{name}"
            if part is not None and not isinstance(part, kind):
                raise DataError(
                    f"{called}: is {type(part).__name__}, expected sdpid.{kind.__name__}."
                )
            if part is not None and part.n_samples != count:
                raise DataError(
                    f"{called}: has {part.n_samples} samples, expected {count}, as many as "
                    f"{first}; bring all channels to the same time stamps."
                )

    def _words(self) -> list[str]:
        """Return what is there, in words."""
        return [name.replace("_", " ") for name in self.channels]

    def __repr__(self) -> str:
        words = [f"{self.n_samples} samples", *self._words()]
        return f"{type(self).__name__}({', '.join(words)})"

    def _shown(self) -> dict[str, object]:
        """Return what a notebook shows."""
        return {"samples": self.n_samples, "measured": ", ".join(self._words())}


def _on(axes: _Axes, known: Any) -> list[Sequence[str]]:
    """Return the names along each axis."""
    return [getattr(known, axis) if isinstance(axis, str) else axis for axis in axes]


def _numbers(given: Any, called: str, axes: int, most: float) -> Any:
    """Return samples of numbers that a robot can have, read-only."""
    if isinstance(given, StoredArray) and given.mapped and given.ndim == 1 + axes:
        # Its columns stay one after the other. Its values were checked when it was read.
        return given
    array = np.ascontiguousarray(real_array(given, called, ndim=1 + axes))
    if most < np.inf and array.size and max(array.max(), -array.min()) > most:
        first = tuple(int(i) for i in np.argwhere(np.abs(array) > most)[0])
        raise DataError(
            f"{called}: is {array[first]:.3g} at index {first}, more than {most:g}, which no "
            "robot has; repair that sample, or say its unit."
        )
    return frozen_view(array)


def _flags(given: Any, called: str, axes: int) -> Any:
    """Return flags that are True or False, or 1 and 0, read-only."""
    array = np.asarray(given)
    if array.dtype != np.bool_:
        numbers = real_array(given, called, ndim=1 + axes)
        array = numbers == 1.0
        if (others := numbers[~array & (numbers != 0.0)]).size:
            raise DataError(
                f"{called}: holds {others[0]:.6g}, expected True or False (or 1 and 0); compare "
                "forces or probabilities with a threshold first."
            )
    return frozen_view(np.ascontiguousarray(array))


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

    gyroscope: Array | None = samples("gyroscope", XYZ, what="rad/s about x, y, z")
    accelerometer: Array | None = samples("accelerometer", XYZ, what="m/s² along x, y, z")
    translation: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array = field(default_factory=lambda: np.eye(3))
    _called: ClassVar[str] = "imu."
    _settings: ClassVar[tuple[str, ...]] = ("translation", "rotation")

    def __post_init__(self) -> None:
        self._keep_samples()
        if not self.channels:
            raise DataError("imu: has neither gyroscope nor accelerometer; leave it out.")
        place = shaped(self.translation, "imu.translation", (3,), ": x, y, z in m")
        object.__setattr__(self, "translation", place)
        object.__setattr__(self, "rotation", _rotation_matrix(self.rotation, "imu.rotation"))

    def _shown(self) -> dict[str, object]:
        return super()._shown() | {"translation, m": str(self.translation.tolist())}


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class BaseMotion(Sampled):
    """Pose and velocity of a robot's base link over time: that of a quadruped or a humanoid.

    Parameters
    ----------
    position : (N, 3) array_like, optional
        Origin of the base link's frame in the world, m.
    orientation : (N, 4) array_like
        Unit quaternions x, y, z, w that turn vectors of the base link's frame into the world's.
        The world's z axis points up. They are normalized, and their signs made continuous.
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
    BaseMotion(100 samples, position, orientation)
    """

    position: Array | None = samples("base_position", XYZ, what="x, y, z in m")
    orientation: Array = samples(
        "base_orientation", XYZW, what="unit quaternions x, y, z, w", needed=True
    )
    linear_velocity: Array | None = samples(
        "base_linear_velocity_{self.velocity_frame}", XYZ, what="x, y, z in m/s"
    )
    angular_velocity: Array | None = samples(
        "base_angular_velocity_{self.velocity_frame}", XYZ, what="x, y, z in rad/s"
    )
    velocity_frame: Literal["world", "base"] | None = None
    imu: Imu | None = None
    _called: ClassVar[str] = "base."

    def __post_init__(self) -> None:
        self._keep_samples(imu=Imu)
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

    @property
    def rotations(self) -> Array:
        """Rotation matrices of the orientations, base to world, (N, 3, 3)."""
        from scipy.spatial.transform import Rotation

        return np.asarray(Rotation.from_quat(self.orientation).as_matrix())

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

    def _words(self) -> list[str]:
        frame = self.velocity_frame
        axes = [] if frame is None else [f"velocities in {frame} axes"]
        return [*super()._words(), *axes, *([] if self.imu is None else ["IMU"])]


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
    down: Mask | None = samples("contact", "frames", what="one column for each frame", flags=True)
    forces: Array | None = samples(
        "contact_force", "frames", XYZ, what="x, y, z in N for each frame"
    )
    wrenches: Array | None = samples(
        "contact_wrench", "frames", WRENCH, what="forces, then moments, for each frame"
    )
    offset: Array = field(default_factory=lambda: np.zeros(3))
    _called: ClassVar[str] = "contacts."
    _settings: ClassVar[tuple[str, ...]] = ("frames", "kind", "offset")

    def __post_init__(self) -> None:
        frames = distinct_names(self.frames, "contacts.frames", "frame names")
        object.__setattr__(self, "frames", frames)
        object.__setattr__(self, "kind", one_kind_each(self.kind, self.n))
        self._keep_samples()
        if self.forces is not None and self.wrenches is not None:
            raise DataError("contacts: give forces or wrenches, not both.")
        if not self.channels:
            raise DataError(
                "contacts: give down, forces or wrenches; where nothing is known of contacts, "
                "leave them out."
            )
        object.__setattr__(self, "offset", offsets(self.offset, self.n, "contacts.offset"))

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
        return np.asarray(size > _CLOSED_SHARE * np.quantile(size, _STRONG))

    def _words(self) -> list[str]:
        counts = {kind: self.kind.count(kind) for kind in get_args(ContactKind)}
        kinds = [f"{n} {kind}{'s' if n > 1 else ''}" for kind, n in counts.items() if n]
        return [*kinds, *("flags" if name == "down" else name for name in self.channels)]

    def _tables(self) -> list[Table]:
        columns: dict[str, Sequence[object]] = {"frame": self.frames, "kind": self.kind}
        if self.down is not None:
            columns["share down"] = self.down.mean(axis=0).tolist()
        return [Table.of_columns(columns)]


def one_kind_each(given: Any, count: int) -> tuple[ContactKind, ...]:
    """Return the kind of each of several contacts; one that is given is that of all."""
    kinds, known = (given,) if isinstance(given, str) else tuple(given), get_args(ContactKind)
    require_known(kinds, known, "contacts.kind")
    if len(kinds) not in (1, count):
        raise DataError(f"contacts.kind: {len(kinds)} kinds for {count} frames; give one or each.")
    return kinds * count if len(kinds) == 1 else kinds


def offsets(given: Any, count: int, called: str) -> Array:
    """Return a place (3,), or one for each of several frames, as places (count, 3)."""
    shape = (count, 3) if np.ndim(given) == 2 else (3,)
    places = shaped(given, called, shape, ": x, y, z in m, for all frames or for each")
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


def _rotation_matrix(given: Any, called: str) -> Array:
    """Return the rotation matrix that is nearest to a given one, which must be near to it."""
    matrix = shaped(given, called, (3, 3), ": a rotation matrix")
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
    return np.asarray(quaternions if off[worst] <= _EXACT_UNIT else quaternions / norms[:, None])


def _continuous(quaternions: Array) -> Array:
    """Return quaternions without changes of sign, which mean nothing, between samples."""
    turned = np.einsum("ki,ki->k", quaternions[1:], quaternions[:-1]) < 0.0
    signs = np.cumprod(np.where(turned, -1.0, 1.0))
    return np.concatenate([quaternions[:1], quaternions[1:] * signs[:, None]])
