"""Arguments of a design as numbers, words, lists and tables."""

from __future__ import annotations

from typing import Any

from sdpid._common.tables import plain
from sdpid.excitation.limits.limits import Limits


def settings_of(**arguments: Any) -> dict[str, Any]:
    """Return arguments as what JSON can hold; those that are None or empty are left out.

    What has no plain form, such as a recording, becomes the words that name it.
    """
    settings = {}
    for name, value in arguments.items():
        if value is None or (isinstance(value, tuple | list) and not value):
            continue
        try:
            settings[name] = value.to_dict() if isinstance(value, Limits) else plain(value)
        except TypeError:
            settings[name] = repr(value)
    return settings
