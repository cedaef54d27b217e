"""`Contacts`: which parts of a robot touched the ground, and with what forces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, get_args

import numpy as np

from sdpid._common.arrays import Array, Mask, frozen, real_array
from sdpid._common.tables import Table, facts_html
from sdpid._common.text import printable
from sdpid.errors import DataError
from sdpid.experiment.recording.floating.arrays import Sampled, keep_flags, keep_samples

# Without flags a contact counts as closed where its force is at least this share of what only one
# in a hundred exceeds, in any contact: well above what a sensor shows in the air, and a single
# wrong value does not lift all feet.
_CLOSED_SHARE, _STRONG = 0.03, 0.99

ContactKind = Literal["point", "line", "plane"]


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
    down: Mask | None = None
    forces: Array | None = None
    wrenches: Array | None = None
    offset: Array = field(default_factory=lambda: np.zeros(3))
    _sampled: ClassVar[tuple[str, ...]] = ("down", "forces", "wrenches")

    def __post_init__(self) -> None:
        frames = _frame_names(self.frames)
        object.__setattr__(self, "frames", frames)
        c = len(frames)
        object.__setattr__(self, "kind", _kinds(self.kind, c))
        keep_flags(self, "down", c, called="contacts.down")
        keep_samples(
            self, "forces", (c, 3), "x, y, z in N for each frame", called="contacts.forces"
        )
        keep_samples(
            self, "wrenches", (c, 6), "forces, then moments, for each frame",
            called="contacts.wrenches",
        )  # fmt: skip
        if self.forces is not None and self.wrenches is not None:
            raise DataError("contacts: give forces or wrenches, not both.")
        if not self.channels:
            raise DataError(
                "contacts: give down, forces or wrenches; where nothing is known of contacts, "
                "leave them out."
            )
        self._require_equal_lengths("contacts")
        offset = real_array(self.offset, "contacts.offset", ndim=np.ndim(self.offset) or 1)
        if offset.shape not in ((3,), (c, 3)):
            raise DataError(
                f"contacts.offset: has shape {offset.shape}, expected (3,) or {(c, 3)}: x, y, z "
                "in m, for all frames or for each."
            )
        object.__setattr__(self, "offset", frozen(np.broadcast_to(offset, (c, 3))))

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
        parts = [f"{self.n_samples} samples", *kinds, *self._given()]
        return f"Contacts({', '.join(parts)})"

    def _repr_html_(self) -> str:
        columns: dict[str, Sequence[object]] = {"frame": self.frames, "kind": self.kind}
        if self.down is not None:
            columns["share down"] = self.down.mean(axis=0).tolist()
        facts: dict[str, object] = {
            "samples": self.n_samples,
            "measured": ", ".join(self._given()),
        }
        return facts_html("Contacts", facts, Table.of_columns(columns))

    def _given(self) -> list[str]:
        """Return what is there, in words."""
        names = {"down": "flags", "forces": "forces", "wrenches": "wrenches"}
        return [names[name] for name in self.channels]


def _frame_names(names: Any) -> tuple[str, ...]:
    """Return distinct, non-empty names."""
    if isinstance(names, str) or not isinstance(names, (Sequence, np.ndarray)) or not len(names):
        raise DataError(f"contacts.frames: is {names!r:.80}, expected a sequence of frame names.")
    if any(not isinstance(name, str) or not name for name in names):
        raise DataError(f"contacts.frames: {names!r:.80} holds something that is not a name.")
    result = tuple(printable(str(name)) for name in names)
    repeated = sorted({name for name in result if result.count(name) > 1})
    if repeated:
        raise DataError(f"contacts.frames: {', '.join(repeated)} is there more than once.")
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
