"""`ContactSamples`: where a robot touches its surroundings, sample by sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np

from sdpid._common.arrays import Array, Mask, frozen, frozen_view, real_array
from sdpid._common.tables import Table, facts_html
from sdpid.errors import DataError
from sdpid.experiment.recording.floating import ContactKind as Kind
from sdpid.experiment.recording.floating import offsets

# What a contact of each kind may transmit: the first so many rows of its Jacobian, in the world's
# axes. The moment that a line leaves free is about an axis that turns: all three are taken.
TRANSMITS: dict[Kind, int] = {"point": 3, "line": 6, "plane": 6}

# A covariance may be this far from symmetric, relative to its largest entry.
_ASYMMETRY = 1e-6

# Name, kind, offset and covariance of one contact.
_Contact: TypeAlias = tuple[str, Kind, Array, Array]


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
    landed : (K,) array_like of bool, optional
        Whether the filter sees a landing of a foot, or `Processing.impact_s` around it.

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
    landed: Mask | None = None

    def __post_init__(self) -> None:
        frames = _several(self.frames)
        if not frames or not all(isinstance(name, str) and name for name in frames):
            raise DataError(f"contacts: frames are {frames!r:.80}, expected names, at least one.")
        c = len(frames)
        others = _several(self.against or (None,) * c)
        if len(others) != c or any(
            other is not None and (not isinstance(other, str) or other in ("", own))
            for own, other in zip(frames, others, strict=False)
        ):
            raise DataError(
                f"contacts: against is {self.against!r:.80}, expected a frame other than its own, "
                f"or None, for each of {c} frames."
            )
        kinds = _several(self.kind)
        kinds = kinds * c if len(kinds) == 1 else kinds
        if len(kinds) != c or not set(kinds) <= TRANSMITS.keys():
            raise DataError(
                f"contacts: kind is {self.kind!r:.80}, expected one of {', '.join(TRANSMITS)} for "
                f"all, or for each of {c} frames."
            )
        down = np.ascontiguousarray(self.down)
        if down.dtype != np.bool_ or down.ndim != 2 or down.shape[1] != c:
            raise DataError(
                f"contacts: down has shape {down.shape} and type {down.dtype}, expected (K, {c}) "
                "and bool."
            )
        object.__setattr__(self, "frames", frames)
        object.__setattr__(self, "against", others)
        object.__setattr__(self, "kind", kinds)
        object.__setattr__(self, "offset", offsets(self.offset, c, "contacts: offset"))
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

    def picked(self, which: Any) -> ContactSamples:
        """Return some samples: a slice, or numbers."""
        forces, landed = (t if t is None else t[which] for t in (self.forces, self.landed))
        return replace(self, down=self.down[which], forces=forces, landed=landed)

    @staticmethod
    def join(
        pieces: Sequence[ContactSamples | None], counts: Sequence[int]
    ) -> ContactSamples | None:
        """Return the contacts of several pieces behind each other, each with those of all.

        A robot may stand on its feet in one recording and hang in another. What does not occur in
        a piece is open there.

        Parameters
        ----------
        pieces : sequence of ContactSamples or None
            Of each piece; None where nothing is touched.
        counts : sequence of int
            How many samples each piece has.

        Raises
        ------
        DataError
            When a contact is of another kind in another piece, or its forces are measured in one
            and not in another.
        """
        given = [(number, each) for number, each in enumerate(pieces, 1) if each is not None]
        if not given:
            return None
        known: dict[tuple[str, str | None], _Contact] = {}
        columns = []
        for number, contacts in given:
            own = contacts._each()
            for place, contact in own.items():
                _require_alike(known.setdefault(place, contact), contact, number)
            columns.append([list(known).index(place) for place in own])
        frames, against = zip(*known, strict=True)
        _, kinds, offsets, covariances = zip(*known.values(), strict=True)
        covariance = np.array(covariances)
        # A point has no moments, whose variance is zero whether forces are measured or not.
        measured = bool(np.isfinite(np.einsum("cii->ci", covariance)[:, :3]).any())
        down = np.zeros((sum(counts), len(known)), dtype=np.bool_)
        forces = np.zeros((*down.shape, 6)) if measured else None
        landed: Mask = np.zeros(len(down), dtype=np.bool_)
        starts = np.cumsum([0, *counts])
        for (number, contacts), at in zip(given, columns, strict=True):
            rows = slice(starts[number - 1], starts[number])
            down[rows, at] = contacts.down
            landed[rows] = False if contacts.landed is None else contacts.landed
            if forces is not None and contacts.forces is not None:
                forces[rows, at] = contacts.forces
        widened = [each.widened_s for _, each in given if each.widened_s is not None]
        return ContactSamples(
            frames=frames,
            against=against,
            kind=kinds,
            offset=np.array(offsets),
            down=down,
            forces=forces,
            force_covariance=covariance if measured else None,
            widened_s=max(widened, default=None),
            landed=landed,
        )

    def _each(self) -> dict[tuple[str, str | None], _Contact]:
        """Return name, kind, offset and covariance of each contact by its frames.

        The covariance is infinite where forces are eliminated.
        """
        covariance = self.force_covariance
        if covariance is None:
            moments = [0.0 if kind == "point" else np.inf for kind in self.kind]
            covariance = np.array([np.diag([np.inf] * 3 + [each] * 3) for each in moments])
        each = zip(self.names, self.kind, self.offset, covariance, strict=True)
        return dict(zip(zip(self.frames, self.against, strict=True), each, strict=True))

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


def _several(given: Any) -> tuple[Any, ...]:
    """Return one text, or several, as a tuple."""
    return (given,) if isinstance(given, str) else tuple(given)


def _require_alike(known: _Contact, contact: _Contact, number: int) -> None:
    """Refuse a contact of a recording that was another one before."""
    name, kind, offset, covariance = contact
    if known[1] != kind or not np.array_equal(known[2], offset):
        raise DataError(
            f"contacts: '{name}' is a {kind} at {offset.tolist()} m in recording {number}, and a "
            f"{known[1]} at {known[2].tolist()} m in one before it; give it the same kind and "
            "offset in all."
        )
    if not np.array_equal(known[3], covariance):
        raise DataError(
            f"contacts: forces of '{name}' are measured in one recording and not, or not as well, "
            f"in recording {number}; process all of them alike (Processing.contact_force_std)."
        )


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
