"""`vector`: three numbers as one writes them in Python."""

from __future__ import annotations

from sdpid._common.arrays import Array


def vector(values: Array) -> str:
    """Return a vector with three digits, what is below 0.0005 as 0."""
    rounded = [float(f"{value:.3g}") if abs(value) >= 5e-4 else 0.0 for value in values]
    return f"({', '.join(f'{value:g}' for value in rounded)})"
