"""Check proofs that were written to files."""

from __future__ import annotations

import os
from dataclasses import dataclass

from sdpid.errors import CertificateError
from sdpid.verifier.command import check_path
from sdpid.verifier.reading import REFUSED
from sdpid.verifier.result import Result


@dataclass(frozen=True, kw_only=True)
class Verification:
    """Result of checking a proof, recomputed from the numbers in its files.

    Attributes
    ----------
    passed : bool
        Whether everything that is claimed is proven.
    statements : tuple of str
        What is proven, in words.
    problems : tuple of str
        What is claimed and not proven.
    unchecked : tuple of str
        What a reader may take for proven and was not checked.
    sha256 : str
        SHA-256 of the file; of a folder the digest in its manifest.
    cost : float or None
        Claimed, and proven where `passed`, as the next three: the cost of the certified parameters
        is at most this.
    lower_bound : float or None
        No feasible parameters cost less.
    gap : float or None
        The one above the other, relative to the cost (see `Certificate.gap`).
    margin : float or None
        The worst link's margin.
    """

    passed: bool
    statements: tuple[str, ...]
    problems: tuple[str, ...]
    unchecked: tuple[str, ...]
    sha256: str
    cost: float | None = None
    lower_bound: float | None = None
    gap: float | None = None
    margin: float | None = None

    @property
    def lines(self) -> tuple[str, ...]:
        """All sentences, and the verdict last."""
        return Result(self.statements, self.problems, self.unchecked).lines


def verify(path: str | os.PathLike[str]) -> Verification:
    """Check a proof in exact arithmetic, from the numbers in its files alone.

    The same as ``python sdpid/verifier FILE_OR_FOLDER`` with the stand-alone checker.

    Parameters
    ----------
    path : path
        A file written by `Certificate.to_json`, or a folder written by `Identification.save`.

    Returns
    -------
    Verification

    Raises
    ------
    CertificateError
        When it is no proof of this version.
    """
    try:
        checked = check_path(path)
    except OSError as cause:
        raise CertificateError(f"cannot read {path}: {cause.strerror}.") from None
    except REFUSED as cause:
        raise CertificateError(f"{path}: not a proof ({cause}).") from None
    result = checked.result
    return Verification(
        passed=result.passed,
        statements=result.statements,
        problems=result.problems,
        unchecked=result.unchecked,
        sha256=checked.sha256,
        **checked.claims,
    )
