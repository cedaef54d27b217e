"""Recompute a result's chain from its logs: files, samples, rows, compression, bound."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid._common.progress import progress
from sdpid._common.text import printable
from sdpid._common.threads import one_thread
from sdpid.assurance.certificate.certificate import GAP
from sdpid.assurance.certificate.compression import Compression, base_limit, enclose_compression
from sdpid.assurance.certificate.rows_digest import samples_digest
from sdpid.assurance.log_proof.chain.contacts import CONTACTS, touched
from sdpid.assurance.log_proof.chain.links import Bounds, Link, LogProof, State
from sdpid.assurance.log_proof.chain.robots import URDF, find_robot
from sdpid.assurance.log_proof.chain.sealed import Sealed
from sdpid.assurance.log_proof.chain.stated import feasible_set, stated_problem
from sdpid.assurance.log_proof.chain.totals import Totals, of_rows, of_true_rows
from sdpid.assurance.log_proof.inputs import log_entry, recording_digest
from sdpid.assurance.log_proof.row_error import row_error
from sdpid.assurance.log_proof.touching.forces import Near
from sdpid.errors import CertificateError, DataError, MissingExtraError, SdpidError
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.constraints.condition import Layout
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.constraints.feasible_set import FeasibleSet
from sdpid.estimation.prior.prior import prior_terms
from sdpid.estimation.problem import Problem
from sdpid.experiment.preparation.several import Logs, prepare_recordings
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.readers.read import is_frame, read_recording
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.friction.model import BY_NAME, FrictionModel
from sdpid.robot.model.base_parameters import structural_base
from sdpid.robot.model.model import RobotModel
from sdpid.verifier.reading import REFUSED, shown

# Terms whose columns depend on bodies.
_POSED = {each.__name__ for each in BY_NAME.values() if each.posed}

# The links, in the order in which they are checked.
_LINKS = (
    *("log", "robot", "samples", "base parameters", CONTACTS),
    *("problem", "compression", "rows", "total"),
)

# Links of what the caller gives: what cannot be read there is bad input, and no finding.
_GIVEN = ("log", "robot")

# Base parameters regroup columns to this accuracy, relative to the largest entry: rounding of a
# least-squares fit, with room for other processors.
_REGROUPED = 1e-9


@one_thread
def check_log(
    folder: str | os.PathLike[str],
    logs: Logs,
    *,
    robot: RobotModel | str | os.PathLike[str] | None = None,
) -> LogProof:
    """Recompute what a results folder says from the logs that it was made of.

    Parameters
    ----------
    folder : path
        Written by `identify`. What is in it is taken as it stands: `sdpid.verify` checks it.
    logs : Recording or path, or a sequence of these
        The logs of the run, in its order.
    robot : RobotModel, name or path, optional
        The robot of the run; by default identified.urdf of the folder where it has the robot's
        kinematics, or the robot of that name.

    Returns
    -------
    LogProof

    Raises
    ------
    CertificateError
        When the folder has no recipe, or a file of it cannot be read.
    DataError, ModelError
        When there is no such log or robot, or it cannot be read.
    MissingExtraError
        When a package is missing that the log's format needs.
    """
    check, given = _Check(Sealed.read(folder)), _several(logs)
    steps: tuple[Callable[[], None], ...] = (
        lambda: check.read(given),
        lambda: check.find(robot),
        check.process,
        check.regroup,
        check.touch,
        check.ask,
        check.compress,
        check.rows,
        check.add_up,
    )
    with progress(len(steps), "checking the log") as advance:
        for name, step in zip(_LINKS, steps, strict=True):
            if not check.broken:
                try:
                    step()
                except MissingExtraError:
                    raise
                except SdpidError as cause:
                    if name in _GIVEN:
                        raise
                    # What is wrong; what to record or to set otherwise is no help here.
                    text = str(cause).split(";")[0].rstrip(".")
                    check.say(name, "not proven", text, stop=True)
                except REFUSED as cause:
                    # Numbers of a manifest may be any: infinite, of other shapes, singular.
                    text = f"cannot be made again: {type(cause).__name__}, {str(cause)[:200]}"
                    check.say(name, "not proven", shown(text)[1:-1], stop=True)
            elif name != CONTACTS or check.sealed.data["origin"].get(CONTACTS) is not None:
                check.say(name, "not checked", f"needs the link '{check.broken}'")
            advance(1)
    return check.proof()


def _several(logs: Logs) -> list[Any]:
    """Return logs as a list."""
    alone = isinstance(logs, (Recording, str, os.PathLike)) or is_frame(logs)
    given = list(logs) if isinstance(logs, Iterable) and not alone else [logs]
    for log in given:
        if isinstance(log, (str, os.PathLike)) and not os.path.exists(log):  # noqa: PTH110
            raise DataError(f"{log}: there is no such file.")
    return given


@dataclass(eq=False)
class _Check:
    """The links so far, and what later ones need of earlier ones."""

    sealed: Sealed
    links: list[Link] = field(default_factory=list)
    roles: tuple[str, ...] = ("log",)
    broken: str = ""
    logs: list[Recording] = field(default_factory=list)
    robot: Any = None
    samples: Any = None
    source: Any = None
    sigma: Any = None
    A: Any = None
    rhs: Any = None
    compression: Compression | None = None
    row_error: float | None = None
    totals: Any = None
    equations: Totals | None = None
    bounds: Bounds | None = None
    of_equations: Bounds | None = None

    def say(self, name: str, state: State, text: str, *, stop: bool = False) -> None:
        """Add a link; `stop` where those that follow cannot be checked."""
        self.links.append(Link(name, state, printable(text)))
        if stop:
            self.broken = name

    def read(self, given: list[Any]) -> None:
        """Compare the logs' SHA-256, and read them as the recipe says."""
        entries, reading = self.sealed.logs, self.sealed.recipe.reading
        if len(given) != len(entries):
            names = ", ".join(shown(each["name"] or "in memory") for each in entries)
            text = f"{len(given)} are given, the result is of {len(entries)}: {names}"
            self.say("log", "not proven", text, stop=True)
            return
        for number, (log, how) in enumerate(zip(given, reading, strict=True)):
            self.logs.append(_read(log, how or {}))
            self._compare(number, self.logs[-1], entries[number])

    def _compare(self, number: int, log: Recording, entry: dict[str, Any]) -> None:
        """Compare the SHA-256 of one log with the manifest's."""
        found = log_entry(log, "log")
        if entry["bytes"] is None:
            found = {**found, "bytes": None, "sha256": recording_digest(log)}
        name = "the recording in memory" if found["name"] is None else shown(found["name"])
        if found["sha256"] == entry["sha256"]:
            how = self.sealed.recipe.reading[number]
            text = f"{name} has the SHA-256 of the manifest, {entry['sha256']}"
            text += f"; its columns are taken, scaled or left out by {_options(how)}" if how else ""
            if found["bytes"] != entry["bytes"]:
                text += f"; but {found['bytes']} bytes, where the manifest has {entry['bytes']}"
            state: State = "proven" if found["bytes"] == entry["bytes"] else "not proven"
            self.say("log", state, text)
            return
        order = [each["sha256"] for each in self.sealed.logs]
        text = (
            f"{name} has the SHA-256 {found['sha256']}, the manifest names "
            f"{shown(entry['name'] or 'a recording in memory')} with {entry['sha256']}"
        )
        if found["sha256"] in order:
            where = order.index(found["sha256"]) + 1
            text += f"; it is log {where} of the run, not log {number + 1}: give them in that order"
        self.say("log", "not proven", text)

    def find(self, robot: RobotModel | str | os.PathLike[str] | None) -> None:
        """Find the robot."""
        self.robot, link = find_robot(self.sealed, robot)
        source = None if self.robot is None else self.robot.source
        of_folder = robot is None and source is not None and source.name == URDF
        if source is not None and not of_folder:
            self.roles = ("log", "robot")
        self.say(link.name, link.state, link.text, stop=self.robot is None)

    def process(self) -> None:
        """Process the logs as the recipe says."""
        recipe, origin = self.sealed.recipe, self.sealed.data["origin"]
        samples: Samples = prepare_recordings(
            self.robot, self.logs, recipe.processing, without_effort=recipe.without_effort
        ).samples
        rows, logged = int(np.count_nonzero(samples.used)), sum(len(log.time) for log in self.logs)
        text = f"{samples.n_samples} of the {logged} samples of the logs are used, and of their "
        text += f"{samples.used.size} efforts {rows} (rows), by {recipe.processing!r}"
        if recipe.without_effort:
            text += f", without the efforts of {', '.join(map(shown, recipe.without_effort))}"
        if recipe.force_scale != 1.0:
            text += f", with covariances of measured forces times {recipe.force_scale!r}"
        # Contacts take rows away: how many there are is told with them.
        rows = rows if samples.contacts is None else origin["rows"]
        if (samples.n_samples, rows) != (origin["samples"], origin["rows"]):
            text += f"; the certificate is of {origin['samples']} samples and {origin['rows']} rows"
            self.say("samples", "not proven", text)
        else:
            scale = recipe.force_scale
            hashed = () if scale == 1.0 else (np.array([scale]),)
            same = samples_digest(samples, hashed) == origin["rows_sha256"]
            # Another processor may round the last digits of a filter otherwise.
            digits = "number for number those" if same else "not in every digit those"
            text += f"; {digits} of the run"
            self.say("samples", "proven", text)
        self.samples = samples

    def regroup(self) -> None:
        """Find the base parameters, and compare them with the certificate's."""
        sealed, recipe, robot = self.sealed, self.sealed.recipe, self.robot
        origin, given = sealed.data["origin"], sealed.data["problem"]["base_matrix"]
        friction = FrictionModel.from_terms(recipe.friction, robot.joint_names, first=robot.n_base)
        base = structural_base(robot, friction)
        found = {
            "links": robot.link_names,
            "joints": robot.joint_names,
            "theta_names": base.theta_names,
            "base_names": base.names,
            "weighting": recipe.weighting,
        }
        for name, value in found.items():
            wanted = origin[name]
            if (value if isinstance(value, str) else list(value)) != wanted:
                text = f"{name} of the certificate are others than those of robot and recipe"
                self.say("base parameters", "not proven", text, stop=True)
                return
        B = np.array(given, dtype=np.float64)
        self.source = RowSource(
            robot,
            friction,
            replace(base, matrix=frozen(B)),
            self.samples,
            force_scale=recipe.force_scale,
        )
        off = float(np.abs(B - base.matrix).max(initial=0.0))
        terms = ", ".join(type(term).__name__ for term in recipe.friction) or "none"
        text = (
            f"{base.count} base parameters of {len(base.theta_names)}, friction and effects "
            f"{terms}; the matrix is "
        )
        if off == 0.0:
            self.say("base parameters", "proven", text + "number for number the certificate's")
        elif off <= _REGROUPED * np.abs(B).max(initial=0.0):
            self.say("base parameters", "proven", text + f"the certificate's to within {off:.3g}")
        else:
            text += f"not the certificate's: entries differ by up to {off:.3g}"
            self.say("base parameters", "not proven", text)

    def touch(self) -> None:
        """Compare contacts with those that the certificate names; nothing where there are none."""
        self.sigma, given = self._sigma(), self.sealed.data["problem"]
        self.rhs = np.array(given["rhs"], dtype=np.float64)
        self.A = np.array(given["A"], dtype=np.float64).reshape(len(self.rhs), -1)
        for link in touched(self.sealed, self.source, self.sigma):
            self.say(link.name, link.state, link.text)

    def _sigma(self) -> Array:
        """Return the covariance of efforts."""
        stated = self.sealed.recipe.sigma
        sigma: Array | None = self.samples.covariance if stated is None else stated
        n = self.robot.n
        if sigma is None or sigma.shape[-2:] != (n, n):
            raise DataError("the recipe has no covariance of these joints' efforts")
        return sigma

    def ask(self) -> None:
        """Compare bounds and prior with those that the recipe states."""
        link = stated_problem(self.sealed, self.source)
        self.say(link.name, link.state, link.text)

    def compress(self) -> None:
        """Enclose the cost of the rows by the certificate's compressed cost."""
        sealed, problem, sigma = self.sealed, self.sealed.data["problem"], self.sigma
        bounds = (np.array(problem[end]) for end in ("lower", "upper"))
        found = enclose_compression(
            self.source,
            sigma,
            sealed.recipe.weighting,
            A=self.A,
            rhs=self.rhs,
            floor=float(problem["floor"]),
            base_limit=base_limit(self.source.base.matrix, *bounds),
        )
        if not found.proven:
            text = "A, rhs and floor of the certificate are not of the rows of this log"
            self.say("compression", "not proven", text, stop=True)
            return
        self.compression = found
        self.totals = of_rows(sealed.found, found.relative, found.absolute)
        text = (
            f"for every theta within the bounds the cost of the rows is within {found.relative!r} "
            f"of the compressed one, plus {found.absolute!r}; {_weights(sigma)}"
        )
        self.say("compression", "proven", text)

    def rows(self) -> None:
        """Bound how far the rows are from those of the robot's equations of motion."""
        sealed, problem, source = self.sealed, self.sealed.data["problem"], self.source
        layout = Layout(self.robot, source.friction)
        feasible = FeasibleSet.build(Constraints(), problem["consistency"], layout)
        lower, upper = (frozen(np.array(problem[end])) for end in ("lower", "upper"))
        found = row_error(
            source,
            self.sigma,
            sealed.recipe.weighting,
            replace(feasible, lower=lower, upper=upper),
            near=self._near(),
        )
        if not np.isfinite([found.total, found.share]).all():
            text = (
                "how far they are from the equations of motion is not bounded for measured forces "
                "whose errors depend on each other"
            )
            self.say("rows", "not checked", text)
            return
        worst, theta = found.worst, sealed.found.theta
        here = found.total if theta is None else found.at(np.array(theta))
        self.row_error = found.total
        self.equations = of_true_rows(self.totals, here, found.total, found.share)
        text = (
            "the roots of their cost and of that of the equations of motion differ by at most "
            f"{found.total!r}, at the given parameters by {here!r}; the worst entry is "
            f"{shown(worst.parameter)} of joint {shown(worst.joint)} at sample {worst.sample + 1}, "
            f"off by {abs(worst.error):.3g} at most"
        )
        reasons = {
            "have passed the filter of the efforts": set(found.taken_as_computed) - _POSED,
            "are of bodies that the recipe states": set(found.taken_as_computed) & _POSED,
        }
        for why, terms in reasons.items():
            if terms:
                text_of = f"columns of {', '.join(sorted(terms))} are taken as computed: they {why}"
                self.say("rows", "not checked", text_of)
        self.say("rows", "proven", text)

    def _near(self) -> Near | None:
        """Return the certificate's compressed cost, and base parameters that fit."""
        theta, found = self.sealed.found.theta, self.compression
        if found is None or found.relative is None or found.absolute is None:
            return None
        base = np.asarray(np.linalg.lstsq(self.A, self.rhs, rcond=None)[0], dtype=np.float64)
        if theta is not None:
            base = self.source.base.matrix @ np.array([float(each) for each in theta])
        return Near(
            A=self.A, rhs=self.rhs, relative=found.relative, absolute=found.absolute, base=base
        )

    def add_up(self) -> None:
        """Say what is proven of the rows of this log."""
        found, claimed = Bounds.of(self.totals), self.sealed.data["claims"]["gap"]
        self.bounds = found
        text = f"on the rows of this log, as computed, {found}"
        if found.gap is None or claimed is None:
            self.say("total", "not proven", text)
        elif found.gap > claimed + GAP:
            self.say("total", "not proven", f"{text}, where the certificate claims {claimed!r}")
        else:
            self.say("total", "proven", text)
        if self.equations is not None:
            self.of_equations = Bounds.of(self.equations)
            text = f"on the rows of the equations of motion {self.of_equations}"
            self.say("total", "proven", text)

    def _problem(self) -> Problem | None:
        """Return the problem with the certificate's cost and the recipe's feasible set."""
        stated, given, source = self.sealed.recipe.problem, self.sealed.data, self.source
        if self.compression is None or stated is None:
            return None
        return Problem(
            robot=source.robot,
            friction=source.friction,
            base=source.base,
            weighting=self.sealed.recipe.weighting,
            sigma=self.sigma,
            A=self.A,
            rhs=self.rhs,
            floor=float(given["problem"]["floor"]),
            n_samples=source.samples.n_samples,
            n_rows=given["origin"]["rows"],
            feasible=feasible_set(stated, source),
            prior=None if stated.prior is None else prior_terms(stated.prior, source),
            rows=source,
        )

    def proof(self) -> LogProof:
        """Return what was found."""
        found = self.compression
        return LogProof(
            problem=self._problem(),
            links=tuple(self.links),
            roles=self.roles,
            relative=None if found is None else found.relative,
            absolute=None if found is None else found.absolute,
            row_error=self.row_error,
            rows=self.bounds,
            equations=self.of_equations,
        )


def _read(log: Any, how: dict[str, Any]) -> Recording:
    """Read a log as the recipe says.

    Raises
    ------
    DataError
        When it cannot be read so.
    CertificateError
        When these are no options.
    """
    if isinstance(log, Recording):
        return log
    try:
        recording: Recording = read_recording(log, mapping=False, **how)
    except REFUSED as cause:
        raise CertificateError(
            f"manifest.json: its recipe cannot be followed: {log} is not read with "
            f"{_options(how)} ({cause})."
        ) from None
    return recording


def _options(how: dict[str, Any]) -> str:
    """Return how a log is read, in words."""
    said = []
    for name, value in how.items():
        if name == "gains" and isinstance(value, dict):
            # Their errors stand in the recipe, and change no row.
            file = value.get("file")
            called = file.get("name") if isinstance(file, dict) else "in memory"
            pairs = zip(value.get("joint_names", ()), value.get("gains", ()), strict=False)
            value = f"{called}: {', '.join(f'{joint} {gain}' for joint, gain in pairs)} N.m/A"
        said.append(f"{name}={shown(json.dumps(value))}")
    return ", ".join(said)


def _weights(sigma: Any) -> str:
    """Return the weights of the rows in words: what counts as an error of one."""
    variance = np.diagonal(sigma, axis1=-2, axis2=-1).reshape(-1, sigma.shape[-1])
    deviations = np.sqrt(np.maximum(variance.mean(axis=0), 0.0))
    shown_numbers = ", ".join(f"{each:.3g}" for each in deviations)
    values = np.linalg.eigvalsh(sigma)
    least, most = (float(np.sqrt(max(pick(values), 0.0))) for pick in (np.min, np.max))
    condition = float((values[..., -1] / values[..., 0]).max())
    return (
        f"errors count in units of {shown_numbers} N·m (N) at joints 1 to {len(deviations)}, and "
        f"of {least:.3g} to {most:.3g} in any direction (condition {condition:.3g})"
    )
