"""A group of things in a scene that are shown and hidden together."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Group:
    """What is shown and hidden together.

    Attributes
    ----------
    key : str
        Short name of letters.
    name : str
        What it is called beside the picture; groups without a name have no switch.
    color : str
        ``#rrggbb``.
    opacity : float
        Of surfaces; below one, what lies within is seen through them.
    filled : float
        Opacity of ellipsoids but for their rims, which are dashed in the picture without a player
        where this is zero.
    """

    key: str
    name: str
    color: str
    opacity: float = 1.0
    filled: float = 0.3
