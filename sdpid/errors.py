"""The errors that sdpid raises, one root and a child for each kind of trouble."""

from __future__ import annotations

from typing import Any

__all__ = [
    "CertificateError",
    "DataError",
    "ExportError",
    "IdentifiabilityError",
    "InfeasibleError",
    "MissingExtraError",
    "ModelError",
    "SdpidError",
    "SolverError",
]


class SdpidError(Exception):
    """Root of every error that sdpid raises on purpose."""


class DataError(SdpidError):
    """A recording, a sample set or an argument is not usable as given."""


class ModelError(SdpidError):
    """A robot description or a kinematic table is not usable as given."""


class MissingExtraError(SdpidError, ImportError):
    """A feature needs an optional dependency that is not installed."""


class IdentifiabilityError(SdpidError):
    """The data do not excite what is to be estimated."""


class SolverError(SdpidError):
    """A solve did not end in a result that can be vouched for.

    Attributes
    ----------
    problem : object or None
        The problem that was being solved.
    found : object or None
        Best result when the solve ended.
    """

    def __init__(self, message: str, *, problem: Any = None, found: Any = None) -> None:
        super().__init__(message)
        self.problem = problem
        self.found = found


class InfeasibleError(SolverError):
    """The constraints cannot hold together.

    Attributes
    ----------
    conflict : tuple of str
        A small set of constraints that cannot hold together, empty where it is not known.
    """

    def __init__(
        self,
        message: str,
        *,
        problem: Any = None,
        found: Any = None,
        conflict: tuple[str, ...] = (),
    ) -> None:
        super().__init__(message, problem=problem, found=found)
        self.conflict = conflict


class ExportError(SdpidError):
    """A result cannot be written as asked."""


class CertificateError(SdpidError):
    """A certificate does not prove what it claims, or cannot be made."""
