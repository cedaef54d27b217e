"""`ContactSamples`: where a robot touches its surroundings, sample by sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

import numpy as np

from sdpid._common.arrays import Array, Mask, frozen, frozen_view, real_array
from sdpid._common.tables import Table, facts_html
from sdpid.errors import DataError

Kind = Literal["point", "line", "plane"]
KINDS: tuple[Kind, ...] = get_args(Kind)
# What a contact of each kind may transmit: the first so many rows of its Jacobian, in the world's
# axes. The moment that a line leaves free is about an axis that turns: all three are taken.
TRANSMITS: dict[Kind, int] = {"point": 3, "line": 6, "plane": 6}

# A covariance may be this far from symmetric, relative to its largest entry.
_ASYMMETRY = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ContactSamples:
    """Contacts of K samples: which are closed, and what is known of their forces.

    What a contact transmits and no sensor measures is eliminated from the equations of motion while
    it is closed. What is measured is added to the efforts with its covariance while the contact is
    closed; an open one has no force, whatever its sensor shows.

    Parameters
    ----------
    frames : sequence of str
        Names of frames of the robot, c in all.
    against : sequence of (str or None), optional
        The robot's other frame at each contact, which takes the opposite force, as where a loop
        closes; None, as by default, for the surroundings. Both frames have their origins there.
    kind : {"point", "line", "plane"} or sequence of them
        What a contact transmits: a force; a force and the two moments across an edge, which lies
        along the frame's y axis; a force and three moments.
    offset : (3,) or (c, 3) array_like, optional
        Contact point relative to the frame's origin in the world's axes, m.
    down : (K, c) array_like of bool
        Whether the contact may transmit something; the filter's memory is included.
    forces : (K, c, 6) array_like, optional
        Measured forces in N and moments in N·m, on the robot, about the contact point, in the
        world's axes, filtered as the efforts are. Zero where a kind transmits nothing.
    force_covariance : (6, 6) or (c, 6, 6) array_like, optional
        Of `forces`, for all contacts or each; needed with them. Zeros trust the forces as they
        are, an infinite variance says that this component is not measured. Moments of points have
        none.
    widened_s : float, optional
        By how much flags were widened on either side, for the filter's memory and for flags that
        are late or early, s; None where that is not known.

    Raises
    ------
    DataError
        When shapes disagree, a kind is not known, or forces and their covariance are not given
        together.

    Examples
    --------
    >>> from sdpid.experiment.processing.contact_samples import ContactSamples
    >>> feet = ContactSamples(frames=["left_foot", "right_foot"], kind="point",
    ...                       offset=(0.0, 0.0, -0.02), down=np.ones((100, 2), dtype=bool))
    >>> feet
    ContactSamples(100 samples, left_foot 100 % and right_foot 100 % closed, forces eliminated)
    """

    frames: tuple[str, ...]
    against: tuple[str | None, ...] = ()
    kind: tuple[Kind, ...] = ("point",)
    offset: Array = field(default_factory=lambda: np.zeros(3))
    down: Mask
    forces: Array | None = None
    force_covariance: Array | None = None
    widened_s: float | None = None

    def __post_init__(self) -> None:
        given: Any = self.frames
        frames = (given,) if isinstance(given, str) else tuple(given)
        if not frames or not all(isinstance(name, str) and name for name in frames):
            raise DataError(f"contacts: frames are {frames!r:.80}, expected names, at least one.")
        object.__setattr__(self, "frames", frames)
        c = len(frames)
        given = self.against
        others = (given,) if isinstance(given, str) else tuple(given or (None,) * c)
        if len(others) != c or any(
            other is not None and (not isinstance(other, str) or other in ("", own))
            for own, other in zip(frames, others, strict=False)
        ):
            raise DataError(
                f"contacts: against is {self.against!r:.80}, expected a frame other than its own, "
                f"or None, for each of {c} frames."
            )
        object.__setattr__(self, "against", others)
        given = self.kind
        kinds = (given,) if isinstance(given, str) else tuple(given)
        kinds = kinds * c if len(kinds) == 1 else kinds
        if len(kinds) != c or not set(kinds) <= set(KINDS):
            raise DataError(
                f"contacts: kind is {self.kind!r:.80}, expected one of {', '.join(KINDS)} for all, "
                f"or for each of {c} frames."
            )
        object.__setattr__(self, "kind", kinds)
        offset = real_array(self.offset, "contacts: offset", ndim=np.ndim(self.offset) or 1)
        if offset.shape not in ((3,), (c, 3)):
            raise DataError(
                f"contacts: offset has shape {offset.shape}, expected (3,) or {(c, 3)}: x, y, z in "
                "m, for all frames or each."
            )
        object.__setattr__(self, "offset", frozen(np.broadcast_to(offset, (c, 3))))
        down = np.ascontiguousarray(self.down)
        if down.dtype != np.bool_ or down.ndim != 2 or down.shape[1] != c:
            raise DataError(
                f"contacts: down has shape {down.shape} and type {down.dtype}, expected (K, {c}) "
                "and bool."
            )
        object.__setattr__(self, "down", frozen_view(down))
        self._check_forces(c)

    def _check_forces(self, c: int) -> None:
        """Check measured forces and their covariance, and clear what is not transmitted."""
        if (self.forces is None) != (self.force_covariance is None):
            raise DataError(
                "contacts: give forces and force_covariance together (zeros trust the forces as "
                "they are), or neither, and forces are eliminated."
            )
        if self.forces is None or self.force_covariance is None:
            return
        forces = np.ascontiguousarray(real_array(self.forces, "contacts: forces", ndim=3))
        if forces.shape != (len(self.down), c, 6):
            raise DataError(
                f"contacts: forces have shape {forces.shape}, expected {(len(self.down), c, 6)}."
            )
        given = real_array(
            self.force_covariance,
            "contacts: force_covariance",
            ndim=np.ndim(self.force_covariance),
            infinite=True,
        )
        if given.shape not in ((6, 6), (c, 6, 6)):
            raise DataError(
                f"contacts: force_covariance has shape {given.shape}, expected (6, 6) or "
                f"{(c, 6, 6)}."
            )
        covariance = np.array(np.broadcast_to(given, (c, 6, 6)))
        points = [i for i, kind in enumerate(self.kind) if kind == "point"]
        covariance[points, 3:] = 0.0
        covariance[points, :, 3:] = 0.0
        if np.any(forces[:, points, 3:]):
            forces = forces.copy()
            forces[:, points, 3:] = 0.0
        _check_covariance(covariance, self.frames)
        object.__setattr__(self, "forces", frozen_view(forces))
        object.__setattr__(self, "force_covariance", frozen(covariance))

    @property
    def n(self) -> int:
        """Number of contacts, c."""
        return len(self.frames)

    @property
    def names(self) -> tuple[str, ...]:
        """What contacts are called: their frames, both of them where a loop closes."""
        pairs = zip(self.frames, self.against, strict=True)
        return tuple(own if other is None else f"{own} at {other}" for own, other in pairs)

    @property
    def n_samples(self) -> int:
        """Number of samples, K."""
        return len(self.down)

    @property
    def measured(self) -> bool:
        """Whether forces are measured."""
        return self.forces is not None

    def same_contacts(self, other: ContactSamples | None) -> bool:
        """Return whether other samples are of the same contacts, known equally well."""
        if other is None or (self.frames, self.against, self.kind) != (
            other.frames,
            other.against,
            other.kind,
        ):
            return False
        if not np.array_equal(self.offset, other.offset) or self.measured != other.measured:
            return False
        if self.force_covariance is None or other.force_covariance is None:
            return True
        return np.array_equal(self.force_covariance, other.force_covariance)

    def picked(self, which: Any) -> ContactSamples:
        """Return some samples: a slice, or numbers."""
        forces = None if self.forces is None else self.forces[which]
        return replace(self, down=self.down[which], forces=forces)

    @staticmethod
    def join(pieces: Sequence[ContactSamples | None]) -> ContactSamples | None:
        """Return the contacts of several pieces behind each other.

        Raises
        ------
        DataError
            When they are not those of the same frames, known equally well.
        """
        first = pieces[0]
        if all(piece is None for piece in pieces):
            return None
        given = [piece for piece in pieces if piece is not None]
        for number, piece in enumerate(pieces[1:], 2):
            if first is None or not first.same_contacts(piece):
                raise DataError(
                    f"contacts: those of piece {number} ({piece}) are others than those of the "
                    f"first ({first}); give all pieces the same frames, kinds, offsets and force "
                    "covariance, with flags that are all False where nothing is touched."
                )
        forces = [piece.forces for piece in given if piece.forces is not None]
        return replace(
            given[0],
            widened_s=most_widened(given),
            down=np.concatenate([piece.down for piece in given]),
            forces=np.concatenate(forces) if forces else None,
        )

    def __repr__(self) -> str:
        shares = [f"{100.0 * share:.0f} %" for share in self.down.mean(axis=0)]
        closed = [f"{name:.40} {share}" for name, share in zip(self.names, shares, strict=True)]
        said = closed[-1] if len(closed) == 1 else f"{', '.join(closed[:-1])} and {closed[-1]}"
        forces = "measured" if self.measured else "eliminated"
        return f"ContactSamples({self.n_samples} samples, {said} closed, forces {forces})"

    def _repr_html_(self) -> str:
        columns: dict[str, Sequence[object]] = {
            "frame": self.names,
            "kind": self.kind,
            "share closed": self.down.mean(axis=0).tolist(),
        }
        facts = {
            "samples": self.n_samples,
            "forces": "measured" if self.measured else "eliminated",
        }
        return facts_html("Contacts", facts, Table.of_columns(columns))


def most_widened(pieces: Sequence[ContactSamples]) -> float | None:
    """Return by how much flags of several pieces were widened at most, None where not known."""
    known = [piece.widened_s for piece in pieces]
    return max((each for each in known if each is not None), default=None)


def _check_covariance(covariance: Array, frames: Sequence[str]) -> None:
    """Refuse what is no covariance of the components that are measured."""
    for name, own in zip(frames, covariance, strict=True):
        known = np.isfinite(np.diagonal(own))
        finite = own[np.ix_(known, known)]
        others = own[known][:, ~known]
        size = float(np.abs(finite).max(initial=0.0))
        if np.any(others != 0.0) or np.any(np.diagonal(own)[~known] < 0.0):
            raise DataError(
                f"contacts: force_covariance of {name}: a component with an infinite variance is "
                "not measured; its other entries have to be zero."
            )
        if not np.isfinite(finite).all() or np.abs(finite - finite.T).max(initial=0.0) > (
            _ASYMMETRY * size
        ):
            raise DataError(f"contacts: force_covariance of {name} is not finite and symmetric.")
        least = float(np.linalg.eigvalsh(finite).min(initial=0.0))
        if least < -_ASYMMETRY * size:
            raise DataError(
                f"contacts: force_covariance of {name} is no covariance: its least eigenvalue is "
                f"{least:.3g}, the limit is 0."
            )
