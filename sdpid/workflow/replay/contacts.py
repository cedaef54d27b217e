"""Where the contacts of samples are on their links, and how often they are closed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from sdpid.estimation.problem import Problem
from sdpid.verifier.reading import shown


def places(problem: Problem) -> Iterator[str]:
    """Yield where contacts are on their links, in words."""
    model: Any = problem.robot.pin_model
    contacts = problem.samples.contacts
    assert contacts is not None
    listed = zip(contacts.names, contacts.frames, contacts.kind, contacts.offset, strict=True)
    closed = np.count_nonzero(contacts.down, axis=0).tolist()
    for (name, own, kind, offset), against, count in zip(
        listed, contacts.against, closed, strict=True
    ):
        if against is not None:
            both = " and ".join(_place(model, each) for each in (own, against))
            yield f"{kind} {shown(name)} at {both}, closed in {count} samples"
            continue
        beside = ", ".join(f"{each:.6g}" for each in offset)
        yield (
            f"{kind} {shown(name)} at {_place(model, own)}, and ({beside}) m from there in the "
            f"world's axes, closed in {count} samples"
        )
    if contacts.widened_s is not None:
        yield f"flags are widened by {contacts.widened_s:.6g} s on either side"
    measured = "no forces are" if contacts.force_covariance is None else "forces are"
    yield f"{measured} measured"


def _place(model: Any, name: str) -> str:
    """Return where a frame is, in words."""
    frame = model.frames[model.getFrameId(name)]
    place = ", ".join(f"{each:.6g}" for each in frame.placement.translation)
    return f"({place}) m of joint {shown(model.names[frame.parentJoint])}"
