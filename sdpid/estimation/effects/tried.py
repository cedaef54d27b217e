"""What became of an effect that was tried on the data."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Tried:
    """One effect that was tried on the data, or asked for.

    Attributes
    ----------
    name : str
        Of the effect, such as ``"tilt"``.
    chosen : bool
        Whether the model holds it.
    words : str
        The outcome in a sentence.
    fall : float or None
        Share by which it lowers the cost of the training data; None where it was not tried.
    least_fall : float or None
        What the fall was measured against.
    probability : float or None
        Of a fall this large by chance, were the effect absent.
    parameters : int
        Number of its parameters.
    """

    name: str
    chosen: bool
    words: str
    fall: float | None = None
    least_fall: float | None = None
    probability: float | None = None
    parameters: int = 0
