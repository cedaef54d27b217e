"""Check that force sensors of feet that are down show anything."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdpid.experiment.inspection.finding import Finding, Subject, check

# A foot that is down more rarely may bear nothing while it is.
_OFTEN = 0.1


@check
def missing_forces(subject: Subject) -> Iterator[Finding]:
    """Find forces of feet that are down which never change, and components that do not."""
    contacts = subject.log.contacts
    if contacts is None or contacts.down is None:
        return
    measured = contacts.measured
    if measured is None:
        return
    still = np.ptp(measured, axis=0) == 0.0
    for foot in np.flatnonzero(still.any(axis=1)).tolist():
        down = float(contacts.down[:, foot].mean())
        if down < _OFTEN:
            continue
        dead = bool(still[foot].all())
        which = "" if dead else f" in {', '.join(np.array(list('xyz'))[still[foot]])}"
        shown = ", ".join(f"{value + 0.0:.4g}" for value in measured[0, foot, still[foot]])
        yield Finding(
            severity="refuse" if dead else "warning",
            kind="forces_missing",
            message=(
                f"contact forces of {contacts.frames[foot]}{which} never change: they are "
                f"({shown}) N in every row, while the foot is down in {100 * down:.3g} % of them, "
                f"limit {100 * _OFTEN:g} %"
            ),
            remedy="if they were not measured, leave all forces out, and keep the flags",
            numbers={"down": down, "limit": _OFTEN},
        )
