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
    """Root of every error that sdpid raises on purpose.

    Examples
    --------
    >>> try:
    ...     sdpid.load_robot("no_such_robot")
    ... except sdpid.errors.SdpidError as error:
    ...     print(f"{type(error).__name__}: {error}")
    ModelError: no robot 'no_such_robot': not a file, and not a known name; ...
    """


class DataError(SdpidError):
    """A recording, a sample set or an argument is not usable as given.

    Examples
    --------
    >>> sdpid.process(log, {"cutoff_hz": 600.0})
    Traceback (most recent call last):
        ...
    sdpid.errors.DataError: cutoff_hz: 600 Hz is not below half the sample rate of 1000 Hz; ...
    """


class ModelError(SdpidError):
    """A robot description or a kinematic table is not usable as given.

    Examples
    --------
    >>> sdpid.load_robot("no_such_robot")
    Traceback (most recent call last):
        ...
    sdpid.errors.ModelError: no robot 'no_such_robot': not a file, and not a known name; ...
    """


class MissingExtraError(SdpidError, ImportError):
    """A feature needs an optional dependency that is not installed.

    Examples
    --------
    >>> issubclass(sdpid.errors.MissingExtraError, ImportError)
    True
    """


class IdentifiabilityError(SdpidError):
    """The data do not excite what is to be estimated.

    Examples
    --------
    >>> sdpid.build_problem(robot, samples.between(0, 20))
    Traceback (most recent call last):
        ...
    sdpid.errors.IdentifiabilityError: the data do not excite ... of 48 base parameter ...
    """


class SolverError(SdpidError):
    """A solve did not end in a result that can be vouched for.

    Attributes
    ----------
    problem : object or None
        The problem that was being solved.
    found : object or None
        Best result when the solve ended.

    Examples
    --------
    >>> try:
    ...     sdpid.solve_robust(problem, threshold=1e-9, max_rounds=1)
    ... except sdpid.errors.SolverError as error:
    ...     error.found.status, error.problem is problem
    ('optimal', True)
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

    Examples
    --------
    >>> heavy = sdpid.Constraints(others=(sdpid.constraints.TotalMass(1000.0),))
    >>> try:
    ...     sdpid.solve_sdp(problem.constrained(constraints=heavy))
    ... except sdpid.errors.InfeasibleError as error:
    ...     print(error.conflict)
    ('masses at most 100 kg', 'total mass')
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
    """A result cannot be written as asked.

    Examples
    --------
    >>> sdpid.write_urdf(sdpid.solve_wls(problem), target="identified.urdf")
    Traceback (most recent call last):
        ...
    sdpid.errors.ExportError: URDF of 'denso_vp6242': the estimate by wls has base ...
    """


class CertificateError(SdpidError):
    """A certificate does not prove what it claims, or cannot be made.

    Examples
    --------
    >>> with open("certificate.json", "w") as file:
    ...     _ = file.write("{}")
    >>> sdpid.verify("certificate.json")
    Traceback (most recent call last):
        ...
    sdpid.errors.CertificateError: certificate.json: not a proof (...).
    """
