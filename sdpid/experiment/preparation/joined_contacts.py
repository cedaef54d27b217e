"""Put recordings with other contacts together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.experiment.processing.contact_samples import ContactSamples, Kind
from sdpid.experiment.processing.samples import Samples

# The frames of a contact: of the robot, and of the robot again where a loop closes.
Place: TypeAlias = "tuple[str, str | None]"


def join_samples(pieces: Sequence[Samples]) -> Samples:
    """Return samples of several recordings behind each other, each with the contacts of all.

    A robot may stand on its feet in one recording and hang in another. What does not occur in a
    recording is open there.

    Raises
    ------
    DataError
        When a contact is of another kind in another recording, or its forces are measured in one
        and not in another.
    """
    return Samples.join(_alike(tuple(pieces)))


def _alike(pieces: tuple[Samples, ...]) -> tuple[Samples, ...]:
    """Return samples that all name the same contacts."""
    given = [piece.contacts for piece in pieces]
    first = next((contacts for contacts in given if contacts is not None), None)
    if first is None or all(first.same_contacts(contacts) for contacts in given):
        return pieces
    frames: dict[Place, tuple[Kind, Array]] = {}
    covariances: dict[Place, Array] = {}
    for number, contacts in enumerate(given, 1):
        if contacts is None:
            continue
        for i, place in enumerate(zip(contacts.frames, contacts.against, strict=True)):
            name = contacts.names[i]
            what = contacts.kind[i], contacts.offset[i]
            known = frames.setdefault(place, what)
            if known[0] != what[0] or not np.array_equal(known[1], what[1]):
                raise DataError(
                    f"contacts: '{name}' is a {what[0]} at {what[1].tolist()} m in recording "
                    f"{number}, and a {known[0]} at {known[1].tolist()} m in one before it; give "
                    "it the same kind and offset in all."
                )
            own = _covariance(contacts, i)
            if not np.array_equal(covariances.setdefault(place, own), own):
                raise DataError(
                    f"contacts: forces of '{name}' are measured in one recording and not, or not "
                    f"as well, in recording {number}; process all of them alike "
                    "(Processing.contact_force_std)."
                )
    covariance = np.array([covariances[place] for place in frames])
    # A point has no moments, whose variance is zero whether forces are measured or not.
    measured = bool(np.isfinite(np.einsum("cii->ci", covariance)[:, :3]).any())
    return tuple(
        replace(piece, contacts=_widened(piece, frames, covariance if measured else None))
        for piece in pieces
    )


def _covariance(contacts: ContactSamples, i: int) -> Array:
    """Return the covariance of a contact's forces, infinite where they are eliminated."""
    if contacts.force_covariance is not None:
        return np.asarray(contacts.force_covariance[i])
    return np.diag([np.inf] * 3 + [0.0 if contacts.kind[i] == "point" else np.inf] * 3)


def _widened(
    piece: Samples, frames: dict[Place, tuple[Kind, Array]], covariance: Array | None
) -> ContactSamples:
    """Return the contacts of one piece among those of all."""
    K, own = piece.n_samples, piece.contacts
    down = np.zeros((K, len(frames)), dtype=np.bool_)
    forces = np.zeros((K, len(frames), 6))
    if own is not None:
        places = list(frames)
        columns = [places.index(place) for place in zip(own.frames, own.against, strict=True)]
        down[:, columns] = own.down
        if own.forces is not None:
            forces[:, columns] = own.forces
    return ContactSamples(
        frames=tuple(frame for frame, _ in frames),
        against=tuple(other for _, other in frames),
        kind=tuple(kind for kind, _ in frames.values()),
        offset=np.array([offset for _, offset in frames.values()]),
        down=down,
        forces=None if covariance is None else forces,
        force_covariance=covariance,
        widened_s=None if own is None else own.widened_s,
    )
