"""Check proofs that were written to files."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sdpid._common.tables import Shown, Table
from sdpid.errors import CertificateError
from sdpid.output.robots.friction_files import NAMES as FRICTION_FILES
from sdpid.robot.description.catalog import identified_robots, results_folder
from sdpid.verifier import certificate, manifest, tables
from sdpid.verifier.command import check_path
from sdpid.verifier.folder import CERTIFICATE, ELSEWHERE
from sdpid.verifier.reading import REFUSED, listed, parse, read_bytes, shown
from sdpid.verifier.result import Result
from sdpid.workflow.replay import compare
from sdpid.workflow.replay.compare import RESULT, ROBOTS, check_numbers, told

if TYPE_CHECKING:
    from sdpid.experiment.preparation.prepare import Logs
    from sdpid.robot.model.model import RobotModel
    from sdpid.workflow.replay.replay import Replay

# Links that show a cost and a base matrix to be those of a robot and its log.
_OF_ROWS = {"log", "robot", "base parameters", "rows"}

# What of files is of other recordings or in words.
_OF_WORDS = {
    "result.json": "errors on other recordings and of the description, tests of bias, status, "
    "active constraints, grades, headline, findings and other words",
    "parameters.json": "what effects explain, and their words",
}


@dataclass(frozen=True, kw_only=True, repr=False)
class Verification(Shown):
    """Result of checking a proof, and of making again what lies beside it.

    What is proven is recomputed in exact arithmetic from the numbers of a certificate. What is made
    again was computed anew from the log, the robot and the recipe, as the run did it, and is the
    same but for rounding.

    Attributes
    ----------
    passed : bool
        Whether everything that is claimed is proven or, where logs were given, made again.
    statements : tuple of str
        What is proven, in words.
    made_again : tuple of str
        What is the same as what was made again.
    problems : tuple of str
        What is claimed and not proven, or other than what was made again.
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
    log : Replay or None
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
    made_again: tuple[str, ...]
    problems: tuple[str, ...]
    unchecked: tuple[str, ...]
    sha256: str
    cost: float | None = None
    lower_bound: float | None = None
    gap: float | None = None
    margin: float | None = None
    log: Replay | None = None

    _facts = ("passed", "statements", "made_again", "problems", "unchecked", "gap", "sha256")

    def _tables(self) -> Iterator[Table]:
        yield Table(("lines",), tuple((each,) for each in self.lines))

    @property
    def lines(self) -> tuple[str, ...]:
        """All sentences, and the verdict last."""
        lines = Result(self.statements, self.problems, self.unchecked).lines
        again = tuple(f"made again: {each}" for each in self.made_again)
        at = len(self.statements)
        return (*lines[:at], *again, *lines[at:-1], self.verdict)

    @property
    def verdict(self) -> str:
        """Whether everything that is claimed holds, and what of it is proven, in a word."""
        found = Result(problems=self.problems, unchecked=self.unchecked).verdict
        if self.log is None or not self.passed:
            return found
        return found.replace("PROVEN", "PROVEN, and what follows from the log MADE AGAIN", 1)


def verify(
    path: str | os.PathLike[str],
    *,
    data: Logs | None = None,
    robot: RobotModel | str | os.PathLike[str] | None = None,
) -> Verification:
    """Check a proof in exact arithmetic, and with `data` all that lies beside it.

    Proofs are checked as by ``python sdpid/verifier FILE_OR_FOLDER``, the stand-alone checker; the
    files of parameters in a folder are compared with the certificate. With `data` the folder's
    recipe is run again from the logs, and everything that follows from it (rows and their cost,
    bounds and prior, the choice of parameters, intervals, tables, robots and friction code) is
    compared with what the folder holds.

    Parameters
    ----------
    path : path
        A file written by `Certificate.to_json`, a folder written by `Identification.save`, or the
        name of a robot that comes with the package identified.
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
    >>> print(verification.verdict)
    PROVEN, but for what was not checked.
    """
    path = results_folder(path)
    try:
        result, sha256, claims = check_path(path)
    except OSError as cause:
        words = "" if path.exists() else f"; identified robots: {', '.join(identified_robots())}"
        raise CertificateError(
            f"cannot read {cause.filename or path}: {cause.strerror}{words}."
        ) from None
    except REFUSED as cause:
        raise CertificateError(f"{path}: not a proof ({cause}).") from None
    log, folder = None, path
    if robot is not None and data is None:
        result = _of_robot(result, folder, robot)
    if data is not None:
        # Files alone are checked without waiting for the libraries that rows need.
        from sdpid.workflow.replay.replay import replay

        log = replay(path, data, robot=robot)
    links = () if log is None else log.links
    if folder.is_dir():
        sealed = manifest.load(read_bytes(folder / manifest.NAME))
        proof = certificate.load(read_bytes(folder / CERTIFICATE))
        if (gap := claims["gap"]) is not None and not gap <= certificate.GAP:
            far = (
                f"{CERTIFICATE}: the gap is {gap:.3g}, more than {certificate.GAP:g}: other "
                "parameters may fit better"
            )
            result += Result(problems=(far,))
        holds = not any(each.startswith(CERTIFICATE) for each in result.problems)
        numbers = check_numbers(folder, sealed["files"], proof, holds)
        result += Result(told(numbers, "made again"), told(numbers, "not made again"))
        known = set() if log is None else set(_covered(sealed, proof, log))
        left = [each for each in result.unchecked if each not in known]
        left += _left(sealed["files"], with_log=log is not None)
        others = tuple(each for each in left if not each.endswith(ELSEWHERE))
        result = Result(
            result.statements,
            result.problems + told(links, "not made again"),
            others + told(links, "not checked"),
        )
    return Verification(
        passed=result.passed,
        statements=result.statements,
        made_again=told(links, "made again"),
        problems=result.problems,
        unchecked=result.unchecked,
        sha256=sha256,
        log=log,
        **claims,
    )


def _of_robot(result: Result, path: Path, robot: RobotModel | str | os.PathLike[str]) -> Result:
    """Return the result of a table with its coefficients compared with those of the robot."""
    from sdpid.assurance.tables.coefficients import check_coefficients
    from sdpid.robot.model.load import load_robot
    from sdpid.robot.model.model import RobotModel

    if path.is_dir() or (data := parse(read_bytes(path))).get("schema") not in tables.SCHEMAS:
        raise CertificateError(
            f"{path}: is no proof about a table, and no log is given; give data (--data) beside "
            "robot."
        )
    question = tables.answer_of(data).question
    model = robot if isinstance(robot, RobotModel) else load_robot(robot)
    left = tuple(each for each in result.unchecked if each != tables.unchecked(question)[0])
    found = check_coefficients(question, model)
    return Result(result.statements, result.problems, left) + found


def _covered(sealed: Mapping[str, Any], proof: Mapping[str, Any], log: Replay) -> Iterator[str]:
    """Yield what a folder alone cannot show, and its logs have shown."""
    made = log.complete
    inputs = [e for e in sealed["inputs"] if e["role"] in log.roles and e["role"] in made]
    yield from manifest.given({"inputs": inputs})
    of_rows, of_demands = certificate.unchecked(dict(proof))
    if made >= _OF_ROWS:
        yield f"{CERTIFICATE}: {of_rows}"
    if "problem" in made:
        yield f"{CERTIFICATE}: {of_demands}"


def _left(files: Mapping[str, Any], *, with_log: bool) -> Iterator[str]:
    """Yield what of the files is compared with nothing."""
    robots = [name for name in files if name in (*ROBOTS, *FRICTION_FILES)]
    if robots and not with_log:
        yield f"{listed(map(shown, robots))}: what they hold (--data LOG writes them again)"
    tables = [name for name in (compare.PARAMETERS, *compare.TABLES) if name in files]
    if tables and not with_log:
        yield (
            f"{', '.join(tables)}: intervals, standard errors and shares (--data LOG makes them "
            "again)"
        )
    for name, what in _OF_WORDS.items():
        if name in files:
            yield f"{name}: {what}"
    compared = {CERTIFICATE, RESULT, *tables, *robots}
    if others := sorted(files.keys() - compared):
        yield f"{listed(map(shown, others))}: sealed, and not derivable"
