"""Check proofs that were written to files."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from sdpid._common.tables import Shown, Table
from sdpid.errors import CertificateError
from sdpid.verifier import certificate, tables
from sdpid.verifier.command import check_path
from sdpid.verifier.reading import REFUSED, parse, read_bytes
from sdpid.verifier.realizable import Question
from sdpid.verifier.result import Result
from sdpid.verifier.results import manifest
from sdpid.verifier.results.folder import CERTIFICATE, ELSEWHERE

if TYPE_CHECKING:
    from sdpid.assurance.log_proof.chain.links import LogProof
    from sdpid.experiment.preparation.several import Logs
    from sdpid.robot.model.model import RobotModel


# Links that show rows and base matrix to be those of a robot and its log.
_OF_ROWS = {"log", "robot", "base parameters", "compression", "rows"}


@dataclass(frozen=True, kw_only=True, repr=False)
class Verification(Shown):
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
    log : LogProof or None
        What the logs show, link by link, where they were given.

    Examples
    --------
    >>> sdpid.certify(estimate).to_json("certificate.json")
    >>> verification = sdpid.verify("certificate.json")
    >>> verification.passed, verification.problems
    (True, ())
    >>> bool(verification.lower_bound <= verification.cost)
    True
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
    log: LogProof | None = None

    _facts = ("passed", "statements", "problems", "unchecked", "gap", "sha256")

    def _tables(self) -> Iterator[Table]:
        yield Table(("lines",), tuple((each,) for each in self.lines))

    @property
    def lines(self) -> tuple[str, ...]:
        """All sentences, and the verdict last."""
        return Result(self.statements, self.problems, self.unchecked).lines


def verify(
    path: str | os.PathLike[str],
    *,
    data: Logs | None = None,
    robot: RobotModel | str | os.PathLike[str] | None = None,
) -> Verification:
    """Check a proof in exact arithmetic, from the numbers in its files, or from the log on.

    Proofs and tables are checked as by ``python sdpid/verifier FILE_OR_FOLDER``, the stand-alone
    checker; robots and friction of a folder are read and compared with the certified parameters.
    With `data` samples, rows and their compression are made of the logs again, as the folder's
    recipe says, every link from file to bound is proven or named, and robots are compared with the
    one that was loaded.

    Parameters
    ----------
    path : path
        A file written by `Certificate.to_json`, or a folder written by `Identification.save`.
    data : Recording or path, or a sequence of these, optional
        The logs that the folder's result was made of, in their order.
    robot : RobotModel, name or path, optional
        The robot's description, beside `data`; by default identified.urdf of the folder where its
        kinematics are those of the run. Without `data`, of a proof about a table: the
        coefficients in it are compared with the robot's.

    Returns
    -------
    Verification

    Raises
    ------
    CertificateError
        When it is no proof of this version, or has no recipe to make rows of `data`.
    DataError
        When there is no such log.
    MissingExtraError
        When a package is missing that the log's format needs.

    Examples
    --------
    >>> sdpid.certify(estimate).to_json("certificate.json")
    >>> verification = sdpid.verify("certificate.json")
    >>> verification.passed, verification.problems
    (True, ())
    >>> print(verification.lines[-1])
    PROVEN, but for what was not checked.
    """
    try:
        checked = check_path(path)
        question = _question(Path(path)) if robot is not None and data is None else None
    except OSError as cause:
        raise CertificateError(f"cannot read {path}: {cause.strerror}.") from None
    except REFUSED as cause:
        raise CertificateError(f"{path}: not a proof ({cause}).") from None
    result, log = checked.result, None
    if robot is not None and question is not None:
        result = _of_robot(result, question, robot)
    if data is not None:
        # Files alone are checked without waiting for the libraries that rows need.
        from sdpid.assurance.log_proof.chain.check import check_log

        log = check_log(path, data, robot=robot)
        known = set(_covered(Path(path), log))
        left = tuple(each for each in result.unchecked if each not in known)
        result = Result(result.statements, result.problems, left) + log.result
    if Path(path).is_dir():
        from sdpid.workflow.written_files import check_files

        given = log is not None and "robot" in log.roles
        found = check_files(Path(path), None if log is None else log.problem, described=given)
        left = tuple(each for each in result.unchecked if not each.endswith(ELSEWHERE))
        result = Result(result.statements, result.problems, left) + found
    return Verification(
        passed=result.passed,
        statements=result.statements,
        problems=result.problems,
        unchecked=result.unchecked,
        sha256=checked.sha256,
        # The problem served to check files; JSON has no words for a model.
        log=None if log is None else replace(log, problem=None),
        **checked.claims,
    )


def _question(path: Path) -> Question:
    """Return the question of a proof about a table; CertificateError where it is none."""
    if not path.is_dir() and (data := parse(read_bytes(path))).get("schema") in tables.SCHEMAS:
        return tables.answer_of(data).question
    raise CertificateError(
        f"{path}: is no proof about a table, and no log is given; give data (--data) beside robot."
    )


def _of_robot(
    result: Result, question: Question, robot: RobotModel | str | os.PathLike[str]
) -> Result:
    """Return a result with the coefficients compared with those of the robot."""
    from sdpid.assurance.tables.robot_check import check_coefficients
    from sdpid.robot.model.load import load_robot
    from sdpid.robot.model.model import RobotModel

    model = robot if isinstance(robot, RobotModel) else load_robot(robot)
    found = check_coefficients(question, model)
    left = tuple(each for each in result.unchecked if each != tables.unchecked(question)[0])
    return Result(result.statements, result.problems, left) + found


def _covered(folder: Path, log: LogProof) -> Iterator[str]:
    """Yield what a folder alone cannot show, and its logs have shown."""
    sealed = manifest.load(read_bytes(folder / manifest.NAME))
    data = certificate.load(read_bytes(folder / CERTIFICATE))
    shown = log.proven
    inputs = [e for e in sealed["inputs"] if e["role"] in log.roles and e["role"] in shown]
    yield from manifest.given({"inputs": inputs})
    # The sentences need no more of a proof than what it claims of its compression.
    claimed: Any = SimpleNamespace(**(data["compression"] or {"relative": 0.0, "absolute": 0.0}))
    of_rows, *others = certificate.unchecked(data, claimed)
    if "compression" in shown:
        yield f"{CERTIFICATE}: {of_rows}"
    for needed, sentence in zip((_OF_ROWS, {"problem"}), others, strict=False):
        if needed <= shown:
            yield f"{CERTIFICATE}: {sentence}"
