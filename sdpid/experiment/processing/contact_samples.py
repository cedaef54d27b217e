"""`ContactSamples`: where a robot touches its surroundings, sample by sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from sdpid._common.arrays import Array, Mask, frozen_view, shaped
from sdpid._common.tables import Table
from sdpid.errors import DataError
from sdpid.experiment.recording.floating import WRENCH, Sampled, offsets, one_kind_each, samples
from sdpid.experiment.recording.floating import ContactKind as Kind

# What a contact of each kind may transmit: the first so many rows of its Jacobian, in the world's
# axes. The moment that a line leaves free is about an axis that turns: all three are taken.
TRANSMITS: dict[Kind, int] = {"point": 3, "line": 6, "plane": 6}

# A covariance may be this far from symmetric, relative to its largest entry: rounding of a sum of
# products, with room for one that came through a text file.
ASYMMETRY = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ContactSamples(Sampled):
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
    down: Mask = samples(
        "down", "frames", what="one column for each frame", needed=True, flags=True
    )
    forces: Array | None = samples("forces", "frames", WRENCH, what="forces, then moments")
    force_covariance: Array | None = None
    widened_s: float | None = None
    landed: Mask | None = samples("landed", what="one for each sample", flags=True)
    _called: ClassVar[str] = "contacts."

    def __post_init__(self) -> None:
        frames = _several(self.frames)
        if not frames or not all(isinstance(name, str) and name for name in frames):
            raise DataError(f"contacts: frames are {frames!r:.80}, expected names, at least one.")
        c = len(frames)
        others = _several(self.against or (None,) * c)
        if len(others) != c or any(
            not isinstance(other, str | None) or other in ("", own)
            for own, other in zip(frames, others, strict=True)
        ):
            raise DataError(
                f"contacts: against is {self.against!r:.80}, expected a frame other than its own, "
                f"or None, for each of {c} frames."
            )
        object.__setattr__(self, "frames", frames)
        object.__setattr__(self, "against", others)
        object.__setattr__(self, "kind", one_kind_each(self.kind, c))
        object.__setattr__(self, "offset", offsets(self.offset, c, "contacts: offset"))
        self._keep_samples()
        if (self.forces is None) != (self.force_covariance is None):
            raise DataError(
                "contacts: give forces and force_covariance together (zeros trust the forces as "
                "they are), or neither, and forces are eliminated."
            )
        if self.forces is not None:
            self._keep_forces(self.forces, self.force_covariance)

    def _keep_forces(self, forces: Array, given: Any) -> None:
        """Check the covariance of measured forces, and clear what is not transmitted."""
        name, acts = "contacts: force_covariance", self._acts
        shape = (self.n, 6, 6) if np.ndim(given) == 3 else (6, 6)
        covariance = shaped(given, name, shape, ": for all contacts or for each", infinite=True)
        covariance = np.where(acts[:, :, None] & acts[:, None], covariance, 0.0)
        for frame, own in zip(self.frames, covariance, strict=True):
            _check_covariance(own, f"{name} of {frame}")
        object.__setattr__(self, "forces", frozen_view(np.where(acts, forces, 0.0)))
        object.__setattr__(self, "force_covariance", frozen_view(covariance))

    @property
    def _acts(self) -> Mask:
        """Which components of force and moment each contact transmits, (c, 6)."""
        return np.arange(6) < np.array([[TRANSMITS[kind]] for kind in self.kind])

    @property
    def _uncertain(self) -> Array:
        """Covariance of forces (c, 6, 6), infinite where they are eliminated."""
        eliminated = np.where(self._acts[:, :, None] & np.eye(6, dtype=np.bool_), np.inf, 0.0)
        return eliminated if self.force_covariance is None else self.force_covariance

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
    def measured(self) -> bool:
        """Whether forces are measured."""
        return self.forces is not None

    @staticmethod
    def join(
        pieces: Sequence[ContactSamples | None], rows: Sequence[slice]
    ) -> ContactSamples | None:
        """Return the contacts of several pieces together, each with those of all.

        A robot may stand on its feet in one recording and hang in another. What does not occur in
        a piece is open there.

        Parameters
        ----------
        pieces : sequence of ContactSamples or None
            Of each piece; None where nothing is touched.
        rows : sequence of slice
            Which samples of the whole each piece has; the last of them ends the whole.

        Raises
        ------
        DataError
            When a contact is of another kind in another piece, or its forces are measured in one
            and not in another.
        """
        given = [(i, contacts) for i, contacts in enumerate(pieces) if contacts is not None]
        known: dict[tuple[str, str | None], tuple[Kind, Array, Array]] = {}
        columns = []
        for i, contacts in given:
            places = list(zip(contacts.frames, contacts.against, strict=True))
            each = zip(contacts.kind, contacts.offset, contacts._uncertain, strict=True)
            for place, name, contact in zip(places, contacts.names, each, strict=True):
                _require_alike(known.setdefault(place, contact), contact, name, i + 1)
            columns.append([list(known).index(place) for place in places])
        if not given:
            return None
        down = np.zeros((rows[-1].stop, len(known)), dtype=np.bool_)
        forces, landed = np.zeros((*down.shape, 6)), np.zeros(len(down), dtype=np.bool_)
        for (i, contacts), at in zip(given, columns, strict=True):
            down[rows[i], at] = contacts.down
            if contacts.forces is not None:
                forces[rows[i], at] = contacts.forces
            if contacts.landed is not None:
                landed[rows[i]] = contacts.landed
        frames, against = zip(*known, strict=True)
        kinds, offsets, covariances = zip(*known.values(), strict=True)
        measured = any(contacts.measured for _, contacts in given)
        widened = [each.widened_s for _, each in given if each.widened_s is not None]
        return ContactSamples(
            frames=frames,
            against=against,
            kind=kinds,
            offset=np.array(offsets),
            down=down,
            forces=forces if measured else None,
            force_covariance=np.array(covariances) if measured else None,
            widened_s=max(widened, default=None),
            landed=landed,
        )

    def _words(self) -> list[str]:
        shares = [f"{100.0 * share:.0f} %" for share in self.down.mean(axis=0)]
        closed = [f"{name:.40} {share}" for name, share in zip(self.names, shares, strict=True)]
        said = closed[-1] if len(closed) == 1 else f"{', '.join(closed[:-1])} and {closed[-1]}"
        return [f"{said} closed", f"forces {'measured' if self.measured else 'eliminated'}"]

    def _shown(self) -> dict[str, object]:
        return {"samples": self.n_samples, "forces": "measured" if self.measured else "eliminated"}

    def _tables(self) -> tuple[Table, ...]:
        shares = self.down.mean(axis=0).tolist()
        columns = {"frame": self.names, "kind": self.kind, "share closed": shares}
        return (Table.of_columns(columns),)


def _several(given: Any) -> tuple[Any, ...]:
    """Return one text, or several, as a tuple."""
    return (given,) if isinstance(given, str) else tuple(given)


def _require_alike(
    known: tuple[Kind, Array, Array], contact: tuple[Kind, Array, Array], name: str, number: int
) -> None:
    """Refuse a contact of a recording that was another one before."""
    if known[0] != contact[0] or not np.array_equal(known[1], contact[1]):
        raise DataError(
            f"contacts: '{name}' is a {contact[0]} at {contact[1].tolist()} m in recording "
            f"{number}, and a {known[0]} at {known[1].tolist()} m in one before it; give it the "
            "same kind and offset in all."
        )
    if not np.array_equal(known[2], contact[2]):
        raise DataError(
            f"contacts: forces of '{name}' are measured in one recording and not, or not as well, "
            f"in recording {number}; process all of them alike (Processing.contact_force_std)."
        )


def _check_covariance(own: Array, called: str) -> None:
    """Refuse what is no covariance of the components that are measured."""
    variance = np.diagonal(own)
    known = np.isfinite(variance)
    finite = own[np.ix_(known, known)]
    size = float(np.abs(finite).max(initial=0.0))
    if np.any(own[known][:, ~known] != 0.0) or np.any(variance[~known] < 0.0):
        raise DataError(
            f"{called}: a component with an infinite variance is not measured; its other entries "
            "have to be zero."
        )
    if not np.isfinite(finite).all() or not np.allclose(finite, finite.T, 0.0, ASYMMETRY * size):
        raise DataError(f"{called} is not finite and symmetric.")
    least = float(np.linalg.eigvalsh(finite).min(initial=0.0))
    if least < -ASYMMETRY * size:
        raise DataError(
            f"{called} is no covariance: its least eigenvalue is {least:.3g}, the limit is 0."
        )
