"""Compare contacts, their flags and their weights with those that a certificate names."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.certificate.contact_record import contact_record
from sdpid.assurance.log_proof.chain.links import Link
from sdpid.assurance.log_proof.chain.sealed import Sealed
from sdpid.estimation.compression.rows import RowSource
from sdpid.verifier.reading import shown

CONTACTS = "contacts"


def touched(sealed: Sealed, source: RowSource, sigma: Array) -> Iterator[Link]:
    """Yield whether contacts are those of the certificate; nothing where neither has any.

    Where they are on their links, which the kinematics do not say, is told.
    """
    origin = sealed.data["origin"]
    found, stated = contact_record(source, sigma), origin.get(CONTACTS)
    if found is None and stated is None:
        return
    if found is None:
        yield Link(CONTACTS, "not proven", "the certificate names some, the log has none")
        return
    if stated is None:
        if CONTACTS in origin:
            yield Link(CONTACTS, "not proven", "the log has some, the certificate names none")
        else:
            yield Link(CONTACTS, "not checked", "the certificate is of a version that names none")
        return
    if wrong := [name for name, value in found.items() if stated.get(name) != value]:
        text = f"{', '.join(wrong)} of the certificate are not those of the log"
        yield Link(CONTACTS, "not proven", text)
        return
    lost = sum(rank * count for rank, count in found["ranks"])
    used = int(np.count_nonzero(source.samples.used))
    text = f"{'; '.join(_places(source, found))}; of {used} rows {used - lost} are independent"
    if used - lost != origin["rows"]:
        yield Link(CONTACTS, "not proven", f"{text}, the certificate has {origin['rows']}")
        return
    yield Link(CONTACTS, "proven", text)


def _places(source: RowSource, found: dict[str, Any]) -> Iterator[str]:
    """Yield where contacts are on their links, in words."""
    model: Any = source.robot.pin_model
    contacts = source.samples.contacts
    assert contacts is not None
    listed = zip(contacts.names, contacts.frames, contacts.kind, contacts.offset, strict=True)
    pairs = zip(listed, contacts.against, found["closed"], strict=True)
    for (name, own, kind, offset), against, closed in pairs:
        if against is not None:
            places = " and ".join(_place(model, each) for each in (own, against))
            yield f"{kind} {shown(name)} at {places}, closed in {closed} samples"
            continue
        beside = ", ".join(f"{each:.6g}" for each in offset)
        yield (
            f"{kind} {shown(name)} at {_place(model, own)}, and ({beside}) m from there in the "
            f"world's axes, closed in {closed} samples"
        )


def _place(model: Any, name: str) -> str:
    """Return where a frame is, in words."""
    frame = model.frames[model.getFrameId(name)]
    place = ", ".join(f"{each:.6g}" for each in frame.placement.translation)
    return f"({place}) m of joint {shown(model.names[frame.parentJoint])}"
