"""Run a recipe again from its logs and its robot, and compare a folder of results with it."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid._common.files import printable
from sdpid._common.progress import progress
from sdpid._common.tables import changed
from sdpid._common.threads import one_thread
from sdpid.assurance.certificate.certificate import problem_dict
from sdpid.assurance.certificate.rows_digest import rows_digest
from sdpid.assurance.recipe.inputs import log_entry, recording_digest
from sdpid.assurance.recipe.stated import StatedProblem, in_words
from sdpid.errors import CertificateError, DataError, MissingExtraError, ModelError, SdpidError
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.duality.bound import cost_scale
from sdpid.estimation.prior.friction import with_friction_max
from sdpid.estimation.prior.prior import described_pairs
from sdpid.estimation.problem import Problem, build_problem
from sdpid.estimation.sdp.nearest_to_prior import distance_to_reference
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.experiment.preparation.prepare import Logs, Prepared, prepare
from sdpid.experiment.readers.read import is_frame, read_recording
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.description.catalog import (
    bundled_robots,
    example_robots,
    identified_robots,
)
from sdpid.robot.description.urdf import without_level
from sdpid.robot.description.xml import is_xacro, read_description
from sdpid.robot.model.base_parameters import kinematics_digest
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel
from sdpid.verifier.reading import REFUSED, shown
from sdpid.workflow.replay.compare import LIMIT, URDF, Link, State, differences, distance, told
from sdpid.workflow.replay.written import Files, Sealed, check_friction

# Links of what the caller gives: what cannot be read there is bad input, and no finding.
_GIVEN = ("log", "robot")

# Base parameters regroup columns to this accuracy, relative to the largest entry: rounding of a
# least-squares fit, with room for other processors.
_REGROUPED = 1e-9

# The nearest parameters are found to a solver's accuracy: of eight honest runs on public records
# the farthest was 2.4 % beyond the nearest known, where the optimal face is thin.
_NEAREST = 0.05

# With a prior one optimum is cheapest: parameters are as near to it as a solver finds it, in the
# root of what the distance costs, as a share of the whole. Honest runs of five arms on four core
# types were at 2e-8 at most, with entropic priors at 4e-7; a gap of 1e-6 alone allows 1e-3, 0.2 kg
# at a UR10's first link.
_CHEAPEST = 1e-5

# What is compared as a cost, and by its effect on it.
_COST = ("A", "rhs", "floor", "base_matrix")


@dataclass(frozen=True, kw_only=True)
class Replay:
    """What a log and a robot show of a folder of results, link by link.

    Attributes
    ----------
    links : tuple of Link
        From the log to the files.
    distance : float or None
        The cost of the rows is within this share of the certificate's, for all parameters; None
        where there are no rows.
    gap : float or None
        The certificate's gap with this distance; None without either.
    roles : tuple of str
        Inputs of the run that were compared: the log, and the robot's description where it was at
        hand.
    """

    links: tuple[Link, ...]
    distance: float | None = None
    gap: float | None = None
    roles: tuple[str, ...] = ("log",)

    @property
    def unchecked(self) -> tuple[str, ...]:
        """What was not made again, for want of something, in words."""
        return told(self.links, "not checked")

    @property
    def complete(self) -> set[str]:
        """Names of the links that were made again, all that was said of them."""
        wrong = {each.name for each in self.links if each.state == "not made again"}
        return {each.name for each in self.links if each.state == "made again"} - wrong


@one_thread
def replay(
    folder: str | os.PathLike[str],
    logs: Logs,
    *,
    robot: RobotModel | str | os.PathLike[str] | None = None,
) -> Replay:
    """Make again what a results folder holds, of the logs that it was made of, and compare it.

    Parameters
    ----------
    folder : path
        Written by `identify`, and read by the stand-alone verifier, which judges its certificate.
    logs : Recording or path, or a sequence of these
        The logs of the run, in its order.
    robot : RobotModel, name or path, optional
        The robot of the run; by default identified.urdf of the folder where it has the robot's
        kinematics, or the robot of that name.

    Returns
    -------
    Replay

    Raises
    ------
    CertificateError
        When the folder has no recipe, or a file of it cannot be read.
    DataError, ModelError
        When there is no such log or robot, or it cannot be read.
    MissingExtraError
        When a package is missing that the log's format needs.
    """
    run = _Rerun(Sealed.read(folder), logs, robot)
    steps: dict[str, Callable[[], Iterable[Link]]] = {
        "log": run.read,
        "robot": run.find,
        "samples": run.prepare,
        "problem": run.build,
        "base parameters": run.compare_base,
        "weights": run.compare_weights,
        "rows": run.compare_rows,
        "choice": run.compare_choice,
        "files": run.write,
    }
    links, broken = list[Link](), ""
    with progress(len(steps), "running the recipe again") as advance:
        for name, step in steps.items():
            if broken:
                links.append(Link(name, "not checked", f"needs the link '{broken}'"))
            elif wrong := _failure(name, step, links):
                links.append(Link(name, "not made again", wrong))
                broken = name
            advance(1)
    shown_links = tuple(replace(link, text=printable(link.text)) for link in links)
    return Replay(links=shown_links, distance=run.distance, gap=run.gap, roles=run.roles)


class _BrokenError(Exception):
    """A link without which those that follow cannot be checked."""


def _failure(name: str, step: Callable[[], Iterable[Link]], links: list[Link]) -> str | None:
    """Add the links of a step; return why it cannot be taken, unless what was given is at fault."""
    try:
        for link in step():
            links.append(link)
    except MissingExtraError:
        raise
    except _BrokenError as cause:
        return str(cause)
    except SdpidError as cause:
        if name in _GIVEN:
            raise
        # What is wrong; what to record or to set otherwise is no help here.
        return str(cause).split(";")[0].rstrip(".")
    except REFUSED as cause:
        # Numbers of a manifest may be any: infinite, of other shapes, singular.
        text = f"cannot be made again: {type(cause).__name__}, {str(cause)[:200]}"
        return shown(text)[1:-1]
    return None


def _judged(name: str, wrong: Iterable[str], text: str) -> Link:
    """Return a link that was made again unless something is wrong."""
    found = "; ".join(wrong)
    return Link(name, _state(not found), found or text)


def _state(same: bool) -> State:
    return "made again" if same else "not made again"


class _Rerun:
    """The run of a folder, made again step by step: each yields links, and needs those before."""

    logs: list[Recording]
    robot: RobotModel
    prepared: Prepared
    problem: Problem
    # Whether the robot is that of identified.urdf.
    of_folder = False
    roles: tuple[str, ...] = ("log",)
    distance: float | None = None
    gap: float | None = None

    def __init__(self, sealed: Sealed, logs: Logs, robot: Any) -> None:
        self.sealed, self.recipe, self.data = sealed, sealed.recipe, sealed.data
        self.asked, self.given = sealed.recipe.problem, robot
        one = isinstance(logs, (Recording, str, os.PathLike)) or is_frame(logs)
        several: Any = [logs] if one or not isinstance(logs, Iterable) else logs
        self.given_logs: list[Any] = [*several]
        for log in self.given_logs:
            # os.path's, because it does not raise for a name that is too long to be one.
            if isinstance(log, (str, os.PathLike)) and not os.path.exists(log):  # noqa: PTH110
                raise DataError(f"{log}: there is no such file.")

    def read(self) -> Iterator[Link]:
        """Read the logs as the recipe says, and compare their SHA-256, each in its place."""
        entries, reading = self.sealed.inputs("log"), self.recipe.reading
        if len(self.given_logs) != len(entries):
            names = ", ".join(shown(each["name"] or "in memory") for each in entries)
            raise _BrokenError(
                f"{len(self.given_logs)} are given, the result is of {len(entries)}: {names}"
            )
        self.logs = [_read(*each) for each in zip(self.given_logs, reading, strict=True)]
        order = [each["sha256"] for each in entries]
        entries_of_logs = zip(self.logs, entries, reading, strict=True)
        for number, (log, entry, how) in enumerate(entries_of_logs, 1):
            found, sealed = log_entry(log, "log"), entry["sha256"]
            if entry["bytes"] is None:
                found = {**found, "bytes": None, "sha256": recording_digest(log)}
            name = "the recording in memory" if found["name"] is None else shown(found["name"])
            text, state = f"{name} has the SHA-256 of the manifest, {sealed}", _state(True)
            if how:
                text += f"; its columns are taken, scaled or left out by {_options(how)}"
            if found["bytes"] != entry["bytes"]:
                text += f"; but {found['bytes']} bytes, where the manifest has {entry['bytes']}"
                state = _state(False)
            if found["sha256"] != sealed:
                was, state = shown(entry["name"] or "a recording in memory"), _state(False)
                text = f"{name} has the SHA-256 {found['sha256']}, the manifest names {was} with "
                text += sealed
                if found["sha256"] in order:
                    where = order.index(found["sha256"]) + 1
                    text += f"; it is log {where} of the run, not log {number}: give them in that "
                    text += "order"
            yield Link("log", state, text)

    def find(self) -> Iterator[Link]:
        """Find the robot, and compare its text and kinematics with those of the manifest.

        Rows depend on the kinematics alone. Without a given robot, identified.urdf has them if they
        are, number for number, those that the manifest names; so has a robot that a catalog names.
        """
        recipe, given = self.recipe.robot, self.given
        robot = given if isinstance(given, RobotModel) else None
        name = "the given robot"
        if given is None:
            robot, name = self._of_folder(), f"{URDF} in the folder"
            self.of_folder = robot is not None
            if robot is None and recipe.catalog and recipe.source and _installed(recipe.source):
                given = recipe.source
        if robot is None and given is not None:
            robot, name = load_robot(given, **recipe.arguments), shown(str(given))
        if robot is None:
            named = "" if recipe.source is None else f" {shown(recipe.source)}"
            how = f"{named.strip()} (--robot)" if named else "the model in Python (robot=)"
            raise _BrokenError(f"the robot's description{named} is not in the folder: give {how}")
        if robot.source is not None and not self.of_folder:
            self.roles = ("log", "robot")
        bodies = None if self.asked is None or self.asked.prior is None else self.asked.prior.bodies
        # Those that the run's description had, unless others were given.
        own = self.of_folder and bodies is not None
        self.robot = replace(robot, prior=frozen(bodies)) if own else robot
        yield self._known(robot, name)

    def _of_folder(self) -> RobotModel | None:
        """Return the robot of identified.urdf, None where its kinematics are not the manifest's."""
        recipe, path = self.recipe.robot, self.sealed.folder / URDF
        if recipe.kinematics is None or not path.is_file():
            return None
        try:
            # No run writes xacro, and its expressions are run; the folder may be anybody's.
            description = read_description(path)
            if is_xacro(description):
                return None
            text = without_level(description.text)
            given = {k: v for k, v in recipe.arguments.items() if k != "xacro_args"}
            robot = load_robot(text, **given)
        except ModelError:
            return None
        return robot if kinematics_digest(robot) == recipe.kinematics else None

    def _known(self, robot: RobotModel, name: str) -> Link:
        """Return whether a robot has the text or the kinematics of the manifest."""
        recipe, entries = self.recipe.robot, self.sealed.inputs("robot")
        text = None if robot.source is None else robot.source.sha256
        sealed = entries[0]["sha256"] if entries and recipe.source is not None else None
        kinematics, same = kinematics_digest(robot), text is not None and text == sealed
        gravity = "({:g}, {:g}, {:g})".format(*recipe.gravity)
        taken = f"; gravity is taken to be {gravity} m/s² in the base"
        if recipe.xacro_args:
            pairs = (f"{shown(k)}={shown(v)}" for k, v in sorted(recipe.xacro_args.items()))
            taken += f"; its macros are given {', '.join(pairs)}"
        if recipe.kinematics is None:
            same = False
            said = f"the recipe names no kinematics, and {name} has some: SHA-256 {kinematics}"
        elif same:
            said = f"{name} has the SHA-256 of the manifest, {text}{taken}"
            if kinematics != recipe.kinematics:
                said += (
                    "; its kinematics have another SHA-256 than the manifest names, as they have "
                    "where a processor rounds otherwise: rows and robots are compared with those "
                    "read here"
                )
        elif same := kinematics == recipe.kinematics:
            said = (
                f"the kinematics of {name} are, number for number, those that the manifest names "
                f"(SHA-256 {kinematics}){taken}"
            )
        else:
            said = (
                f"{name} is another robot: SHA-256 {text or kinematics}, the manifest names "
                f"{shown(recipe.source or recipe.name)} with {sealed or recipe.kinematics}"
            )
        return Link("robot", _state(same), said)

    def prepare(self) -> Iterator[Link]:
        """Process the logs as the recipe says."""
        self.prepared = prepare(
            self.robot, self.logs, self.recipe.processing, without_effort=self.recipe.without_effort
        )
        yield from ()

    def build(self) -> Iterator[Link]:
        """Build the problem as the recipe says, and compare samples and demands."""
        recipe, asked, origin = self.recipe, self.asked, self.data["origin"]
        problem = self.problem = build_problem(
            self.robot,
            self.prepared.samples,
            friction=recipe.friction,
            weighting=recipe.weighting,
            consistency="pseudo_inertia" if asked is None else asked.consistency,
            constraints=Constraints() if asked is None else asked.constraints,
            prior=None if asked is None else asked.prior,
            check_excitation=False,
        )
        wrong, own = [], (problem.n_samples, problem.n_rows)
        if own != (stated := (origin["samples"], origin["rows"])):
            wrong.append(
                f"{own[0]} samples and {own[1]} rows come out of the log, the certificate is of "
                f"{stated[0]} and {stated[1]}"
            )
        yield _judged("samples", wrong, self._used())
        if problem.samples.contacts is not None:
            yield Link("contacts", "made again", "; ".join(_places(problem)))
        if asked is None:
            text = (
                "the recipe does not state what was asked of the parameters, so that bounds, "
                "margin, rows, cones and prior may be any: conditions of a class of your own stand "
                "in no file"
            )
            yield Link("problem", "not made again", text)
        elif list(problem.base.theta_names) == origin["theta_names"]:
            # Other names are told by the next link.
            text = f"bounds, margin and prior are those of {_demanded(self.sealed, asked, problem)}"
            yield _judged("problem", _other_demands(self.data["problem"], problem), text)

    def _used(self) -> str:
        """Return how much of the logs is used, and how, in words."""
        recipe, problem, samples = self.recipe, self.problem, self.problem.samples
        logged = sum(len(log.time) for log in self.logs)
        rows = int(np.count_nonzero(samples.used))
        text = (
            f"{samples.n_samples} of the {logged} samples of the logs are used, and of their "
            f"{samples.used.size} efforts {rows} (rows)"
        )
        if rows != problem.n_rows:
            text += f", {problem.n_rows} of them independent"
        settings = changed(recipe.processing).items()
        text += f", by Processing({', '.join(f'{name}={value!r}' for name, value in settings)})"
        if recipe.without_effort:
            text += f", without the efforts of {', '.join(map(shown, recipe.without_effort))}"
        if recipe.force_scale != 1.0:
            text += f", with covariances of measured forces times {recipe.force_scale!r}"
        # Another processor may round the last digits of a filter otherwise.
        same = rows_digest(problem) == self.data["origin"]["rows_sha256"]
        digits = "number for number those" if same else "not in every digit those"
        return f"{text}; {digits} of the run"

    def compare_base(self) -> Iterator[Link]:
        """Compare base parameters with the certificate's."""
        problem, base, origin = self.problem, self.problem.base, self.data["origin"]
        own: dict[str, Any] = {
            "links": problem.robot.link_names,
            "joints": problem.robot.joint_names,
            "theta_names": base.theta_names,
            "base_names": base.names,
            "weighting": self.recipe.weighting,
        }
        if not problem.origin.constant:
            own["loss"] = problem.origin.meaning
        for name, value in own.items():
            if (list(value) if isinstance(value, tuple) else value) != origin[name]:
                raise _BrokenError(
                    f"{name} of the certificate are others than those of robot and recipe"
                )
        terms = []
        for term in self.recipe.friction:
            if (bodies := getattr(term, "bodies", None)) is None:
                terms.append(repr(term))
            else:
                same = np.array_equal(bodies, self.robot.prior)
                whose = "the description's bodies" if same else "bodies that the recipe states"
                terms.append(f"{type(term).__name__} of {whose}")
        B = np.array(self.data["problem"]["base_matrix"], dtype=np.float64)
        off = float(np.abs(B - base.matrix).max(initial=0.0))
        wrong = []
        if not off <= _REGROUPED * np.abs(base.matrix).max(initial=0.0):
            wrong = [f"the matrix is not the certificate's: entries differ by up to {off:.3g}"]
        text = (
            f"{base.count} base parameters of {len(base.theta_names)}, friction and effects "
            f"{', '.join(terms) or 'none'}; the matrix is the certificate's to within {off:.3g}"
        )
        yield _judged("base parameters", wrong, text)

    def compare_weights(self) -> Iterator[Link]:
        """Compare the covariance of efforts with the one that the recipe names."""
        recipe, sigma, wrong = self.recipe, self.problem.sigma, []
        if recipe.sigma is not None and sigma.shape == recipe.sigma.shape:
            size = np.sqrt(np.diagonal(sigma))
            off = float(np.abs((recipe.sigma - sigma) / np.outer(size, size)).max(initial=0.0))
            if not off <= LIMIT:
                wrong.append(f"the recipe's covariance of efforts is off by {off:.3g} of its size")
        elif recipe.sigma is not None:
            wrong.append("the recipe's covariance of efforts is of other joints")
        scale = getattr(self.problem.rows, "force_scale", 1.0)
        wrong += differences(recipe.force_scale, scale, where="the scale of measured forces")
        yield _judged("weights", wrong, f"by the weighting '{recipe.weighting}' {_weights(sigma)}")

    def compare_rows(self) -> Iterator[Link]:
        """Compare the cost of the rows with the certificate's, for all parameters."""
        problem, given, claimed = self.problem, self.data["problem"], self.data["claims"]["gap"]
        rhs = np.array(given["rhs"], dtype=np.float64)
        A = np.array(given["A"], dtype=np.float64).reshape(len(rhs), -1)
        off = distance((A, rhs, float(given["floor"])), (problem.A, problem.rhs, problem.floor))
        self.distance = off
        if not off <= LIMIT:
            raise _BrokenError(
                "A, rhs and floor of the certificate are not of the rows of this log: the costs "
                f"differ by up to {off:.3g} of themselves (limit {LIMIT:g})"
            )
        text = (
            "for all parameters, the cost of the rows is the certificate's to within "
            f"{off:.3g} of itself (limit {LIMIT:g})"
        )
        if claimed is not None:
            # Cost and bound are off by this share, each its own way.
            self.gap = claimed + 2.0 * off
            text += f"; with it the gap is at most {self.gap:.10g}"
        yield Link("rows", "made again", text)

    def compare_choice(self) -> Iterator[Link]:
        """Compare the parameters with those that are chosen: cheapest, or of these the nearest."""
        problem = self.problem
        if self.asked is None:
            return
        which = "which of the parameters that cost the same were chosen"
        if problem.prior is None and (problem.consistency == "none" or self.of_folder):
            why = "links may be any" if problem.consistency == "none" else "give --robot"
            yield Link("choice", "not checked", f"{which}: {why}")
            return
        theta, best = np.array(self.data["theta"], dtype=np.float64), solve_sdp(problem)
        there = np.array(best.theta)
        if problem.prior is not None:
            terms = (term.curvature_rows(there) for term in problem.prior.terms)
            step = np.vstack([problem.A @ problem.base.matrix, *terms]) @ (theta - there)
            off = float(np.linalg.norm(step) / np.sqrt(max(best.cost, cost_scale(problem))))
            wanted = f"of least cost: off by {off:.3g} of its root (limit {_CHEAPEST:g})"
            same = off <= _CHEAPEST
        else:
            own, least = (distance_to_reference(problem, each) for each in (theta, there))
            wanted = (
                f"nearest to the description: {own:.6g} from it, and those found are {least:.6g}"
            )
            same = own <= (1.0 + _NEAREST) * least
        wrong = [] if same else [f"the parameters are not those {wanted}"]
        yield _judged("choice", wrong, f"solved for again, the parameters are those {wanted}")

    def write(self) -> Iterator[Link]:
        """Write the files again and compare them."""
        problem, sealed, prepared = self.problem, self.sealed, self.prepared
        if self.data["theta"] is None:
            raise DataError("the certificate has no parameters")
        yield from check_friction(sealed, problem.robot.n_base)
        if self.asked is not None:
            # Words for base parameters have digits of the matrix, which has been compared.
            B = frozen(np.array(self.data["problem"]["base_matrix"]))
            base = replace(problem.base, matrix=B)
            whole = replace(problem, base=base).with_origin(profiled=self.recipe.profiled or ())
            yield from Files(
                sealed=sealed, problem=whole, prepared=prepared, described=not self.of_folder
            ).check()
        if self.of_folder and URDF in sealed.manifest["files"]:
            text = (
                "joints, places, limits and shapes, and what the description had in place of a "
                "prior: none is given (--robot)"
            )
            yield Link(URDF, "not checked", text)


def _read(log: Any, how: dict[str, Any] | None) -> Recording:
    """Return a log as the recipe says that it is read; refuse what are no options."""
    if isinstance(log, Recording):
        return log
    try:
        recording: Recording = read_recording(log, mapping=False, **(how or {}))
    except REFUSED as cause:
        raise CertificateError(
            f"manifest.json: its recipe cannot be followed: {log} is not read with "
            f"{_options(how or {})} ({cause})."
        ) from None
    return recording


def _options(how: dict[str, Any]) -> str:
    """Return how a log is read, in words."""
    said = []
    for name, value in how.items():
        if name == "gains" and isinstance(value, dict):
            # Their errors stand in the recipe, and change no row.
            value = {key: value.get(key) for key in ("file", "joint_names", "gains")}
        # In full: what is cut off could take other columns, or scale them.
        said.append(f"{name}={json.dumps(value)}")
    return ", ".join(said)


def _installed(name: str) -> bool:
    """Return whether a name is that of a robot on this machine: a manifest may name any file."""
    known = (*bundled_robots(), *identified_robots(), *example_robots())
    return name in known or name in {each.split("/")[-1] for each in known}


def _places(problem: Problem) -> Iterator[str]:
    """Yield where contacts are on their links, and how often they are closed, in words."""
    model: Any = problem.robot.pin_model
    contacts = problem.samples.contacts
    assert contacts is not None

    def place(name: str) -> str:
        frame = model.frames[model.getFrameId(name)]
        where = ", ".join(f"{each:.6g}" for each in frame.placement.translation)
        return f"({where}) m of joint {shown(model.names[frame.parentJoint])}"

    for k, (name, own, against) in enumerate(
        zip(contacts.names, contacts.frames, contacts.against, strict=True)
    ):
        count = int(np.count_nonzero(contacts.down[:, k]))
        where = f"{contacts.kind[k]} {shown(name)} at {place(own)}"
        if against is None:
            beside = ", ".join(f"{each:.6g}" for each in contacts.offset[k])
            where += f", and ({beside}) m from there in the world's axes"
        else:
            where += f" and {place(against)}"
        yield f"{where}, closed in {count} samples"
    if contacts.widened_s is not None:
        yield f"flags are widened by {contacts.widened_s:.6g} s on either side"
    measured = "no forces are" if contacts.force_covariance is None else "forces are"
    yield f"{measured} measured"


def _other_demands(given: Mapping[str, Any], problem: Problem) -> Iterator[str]:
    """Yield what of the certificate's problem is not as stated: its cost aside."""
    for key, wanted in problem_dict(problem).items():
        found, within, where = given.get(key), LIMIT, ""
        if key in _COST:
            continue
        if key in ("lower", "upper"):
            # The same in all digits.
            names, within, where = problem.base.theta_names, 0.0, f"the {key} bound of"
            found, wanted = (dict(zip(names, each, strict=True)) for each in (given[key], wanted))
        else:
            found, wanted = {key: found}, {key: wanted}
        wrong = list(differences(found, wanted, within=within, where=where))
        more = f" (and {len(wrong) - 1} more)" if len(wrong) > 1 else ""
        for each in wrong[:1]:
            yield each.replace(", made again it is", ", stated is") + more


def _demanded(sealed: Sealed, stated: StatedProblem, problem: Problem) -> str:
    """Return what is asked, and what of it is not what `sdpid identify` asks of this robot."""
    robot, constraints, prior = problem.robot, stated.constraints, stated.prior
    own = None if robot.source is None else robot.source.sha256
    described = own in [entry["sha256"] for entry in sealed.inputs("robot")]
    said = (
        f"the recipe ({stated.consistency}, margin {constraints.margin!r} kg.m2, masses from "
        f"{constraints.mass_min!r} to {constraints.mass_max!r} kg, parameters to "
        f"{constraints.theta_max!r}, of friction to {constraints.friction_max!r}"
    )
    if not constraints.friction_nonnegative:
        said += ", friction may be negative"
    if described:
        default = with_friction_max(Constraints.of_size(robot), problem.require_rows("bounds"))
        others = ", ".join(
            f"{each.name} {getattr(default, each.name)!r}"
            for each in fields(Constraints)
            if each.name != "others"
            and getattr(constraints, each.name) != getattr(default, each.name)
        )
        said += f"; by default {others}" if others else ", the defaults for this robot"
    if constraints.others:
        said += f"; conditions: {in_words(constraints.others)}"
    if prior is None:
        return said + "; no prior)"
    same = described and prior.bodies is not None and np.array_equal(prior.bodies, robot.prior)
    towards = "the description's bodies" if same else "bodies that the recipe states"
    said += f"; prior {prior.kind} of {prior.strength!r} nats towards {towards}"
    if not prior.friction:
        said += ", none about friction"
    if prior.alike:
        said += f"; {described_pairs(prior.alike, prior.within)}"
    return said + ")"


def _weights(sigma: Array) -> str:
    """Return the weights of the rows in words: what counts as an error of one."""
    variance = np.diagonal(sigma, axis1=-2, axis2=-1).reshape(-1, sigma.shape[-1])
    deviations = np.sqrt(np.maximum(variance.mean(axis=0), 0.0))
    numbers = ", ".join(f"{each:.3g}" for each in deviations)
    values = np.linalg.eigvalsh(sigma)
    least, most = (float(np.sqrt(max(pick(values), 0.0))) for pick in (np.min, np.max))
    condition = float((values[..., -1] / values[..., 0]).max())
    return (
        f"errors count in units of {numbers} N·m (N) at joints 1 to {len(deviations)}, and "
        f"of {least:.3g} to {most:.3g} in any direction (condition {condition:.3g})"
    )
