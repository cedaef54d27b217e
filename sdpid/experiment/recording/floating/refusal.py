"""Refuse recordings of floating bases where only fixed ones are known."""

from __future__ import annotations

from sdpid.errors import DataError
from sdpid.experiment.recording.recording import Recording


def require_fixed_base(log: Recording, what: str) -> None:
    """Refuse a recording of a robot with a floating base.

    Parameters
    ----------
    log : Recording
        What was measured.
    what : str
        What asks for it, as the beginning of the message.

    Raises
    ------
    DataError
        When the recording has a base.
    """
    if log.base is not None:
        raise DataError(
            f"{what}: this recording has a floating base (log.base), and only robots that are "
            "fixed to the ground are known here. Where the base stood still, read the log with "
            "columns={'base_orientation': None}, or drop it with dataclasses.replace(log, "
            "base=None, contacts=None)."
        )
