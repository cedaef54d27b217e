"""Run a recipe again from its logs and its robot, and compare a folder of results with it."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid._common.progress import progress
from sdpid._common.tables import changed
from sdpid._common.text import printable
from sdpid._common.threads import one_thread
from sdpid.assurance.certificate.rows_digest import rows_digest
from sdpid.errors import DataError, MissingExtraError, SdpidError
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.duality.bound import cost_scale
from sdpid.estimation.problem import Problem, build_problem
from sdpid.estimation.sdp.nearest_to_prior import distance_to_reference
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.experiment.preparation.prepare import Logs, Prepared, prepare
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.model.model import RobotModel
from sdpid.verifier.reading import REFUSED, shown
from sdpid.workflow.identify import with_motion_bias_of
from sdpid.workflow.replay.compare import LIMIT, differences
from sdpid.workflow.replay.contacts import places
from sdpid.workflow.replay.cost import distance
from sdpid.workflow.replay.folder import Sealed
from sdpid.workflow.replay.given import find_robot, log_links, read_log, several
from sdpid.workflow.replay.links import Link, Replay, State
from sdpid.workflow.replay.numbers import URDF
from sdpid.workflow.replay.stated import other_demands, told
from sdpid.workflow.replay.written import Files, check_friction

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
    run, given = _Replaying(Sealed.read(folder)), several(logs)
    steps: dict[str, Callable[[], None]] = {
        "log": lambda: run.read(given),
        "robot": lambda: run.find(robot),
        "samples": run.prepare,
        "problem": run.build,
        "base parameters": run.compare_base,
        "weights": run.compare_weights,
        "rows": run.compare_rows,
        "choice": run.compare_choice,
        "files": run.write,
    }
    with progress(len(steps), "running the recipe again") as advance:
        for name, step in steps.items():
            if run.broken:
                run.say(name, "not checked", f"needs the link '{run.broken}'")
            else:
                run.take(name, step)
            advance(1)
    return Replay(links=tuple(run.links), distance=run.distance, gap=run.gap, roles=run.roles)


@dataclass(eq=False)
class _Replaying:
    """The links so far, and what later ones need of earlier ones."""

    sealed: Sealed
    links: list[Link] = field(default_factory=list)
    roles: tuple[str, ...] = ("log",)
    broken: str = ""
    logs: list[Recording] = field(default_factory=list)
    robot: RobotModel | None = None
    prepared: Prepared | None = None
    problem: Problem | None = None
    of_folder: bool = False
    stated: bool = True
    distance: float | None = None
    gap: float | None = None

    def say(self, name: str, state: State, text: str, *, stop: bool = False) -> None:
        """Add a link; `stop` where those that follow cannot be checked."""
        self.links.append(Link(name, state, printable(text)))
        if stop:
            self.broken = name

    def judge(self, name: str, wrong: list[str], text: str, *, stop: bool = False) -> None:
        """Add a link that was made again unless something is wrong."""
        state: State = "not made again" if wrong else "made again"
        self.say(name, state, "; ".join(wrong) or text, stop=stop and bool(wrong))

    def take(self, name: str, step: Callable[[], None]) -> None:
        """Take a step; what cannot be done is a finding, but of what was given."""
        try:
            step()
        except MissingExtraError:
            raise
        except SdpidError as cause:
            if name in _GIVEN:
                raise
            # What is wrong; what to record or to set otherwise is no help here.
            self.say(name, "not made again", str(cause).split(";")[0].rstrip("."), stop=True)
        except REFUSED as cause:
            # Numbers of a manifest may be any: infinite, of other shapes, singular.
            text = f"cannot be made again: {type(cause).__name__}, {str(cause)[:200]}"
            self.say(name, "not made again", shown(text)[1:-1], stop=True)

    def read(self, given: list[Any]) -> None:
        """Read the logs as the recipe says, and compare their SHA-256."""
        entries, reading = self.sealed.logs, self.sealed.recipe.reading
        if len(given) != len(entries):
            names = ", ".join(shown(each["name"] or "in memory") for each in entries)
            text = f"{len(given)} are given, the result is of {len(entries)}: {names}"
            self.say("log", "not made again", text, stop=True)
            return
        self.logs = [read_log(log, how) for log, how in zip(given, reading, strict=True)]
        for link in log_links(self.sealed, self.logs):
            self.say(link.name, link.state, link.text)

    def find(self, robot: RobotModel | str | os.PathLike[str] | None) -> None:
        """Find the robot."""
        self.robot, link, self.of_folder = find_robot(self.sealed, robot)
        if self.robot is not None and self.robot.source is not None and not self.of_folder:
            self.roles = ("log", "robot")
        asked = self.sealed.recipe.problem
        bodies = None if asked is None or asked.prior is None else asked.prior.bodies
        if self.robot is not None and self.of_folder and bodies is not None:
            # Those that the run's description had, unless others were given.
            self.robot = replace(self.robot, prior=frozen(bodies))
        self.say(link.name, link.state, link.text, stop=self.robot is None)

    def prepare(self) -> None:
        """Process the logs as the recipe says."""
        recipe, robot = self.sealed.recipe, self.robot
        assert robot is not None
        self.prepared = prepare(
            robot, self.logs, recipe.processing, without_effort=recipe.without_effort
        )

    def build(self) -> None:
        """Build the problem as the recipe says, and compare samples and demands."""
        recipe, prepared, robot = self.sealed.recipe, self.prepared, self.robot
        assert prepared is not None
        assert robot is not None
        asked = recipe.problem
        problem = build_problem(
            robot,
            prepared.samples,
            friction=recipe.friction,
            weighting=recipe.weighting,
            consistency="pseudo_inertia" if asked is None else asked.consistency,
            constraints=Constraints() if asked is None else asked.constraints,
            prior=None if asked is None else asked.prior,
            check_excitation=False,
        )
        self.problem, self.stated = problem, asked is not None
        self.judge("samples", list(self._other_samples(problem)), self._used(problem))
        if problem.samples.contacts is not None:
            self.say("contacts", "made again", "; ".join(places(problem)))
        if asked is None:
            text = (
                "the recipe does not state what was asked of the parameters, so that bounds, "
                "margin, rows, cones and prior may be any: conditions of a class of your own stand "
                "in no file"
            )
            self.say("problem", "not made again", text)
            return
        names = self.sealed.data["origin"]["theta_names"]
        if list(problem.base.theta_names) != names:
            # The next link names them.
            return
        wrong = list(other_demands(self.sealed.data["problem"], problem))
        text = f"bounds, margin and prior are those of {told(self.sealed, asked, problem)}"
        self.judge("problem", wrong, text)

    def _other_samples(self, problem: Problem) -> Iterator[str]:
        """Yield that there are other samples or rows than the certificate says."""
        origin, own = self.sealed.data["origin"], (problem.n_samples, problem.n_rows)
        if own != (stated := (origin["samples"], origin["rows"])):
            yield (
                f"{own[0]} samples and {own[1]} rows come out of the log, the certificate is of "
                f"{stated[0]} and {stated[1]}"
            )

    def _used(self, problem: Problem) -> str:
        """Return how much of the logs is used, and how, in words."""
        recipe, samples = self.sealed.recipe, problem.samples
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
        same = rows_digest(problem) == self.sealed.data["origin"]["rows_sha256"]
        digits = "number for number those" if same else "not in every digit those"
        return f"{text}; {digits} of the run"

    def compare_base(self) -> None:
        """Compare base parameters with the certificate's."""
        problem, recipe, data = self.problem, self.sealed.recipe, self.sealed.data
        assert problem is not None
        base, robot = problem.base, problem.robot
        found: dict[str, Any] = {
            "links": robot.link_names,
            "joints": robot.joint_names,
            "theta_names": base.theta_names,
            "base_names": base.names,
            "weighting": recipe.weighting,
        }
        if not problem.origin.constant:
            found["loss"] = problem.origin.meaning
        for name, value in found.items():
            if (list(value) if isinstance(value, tuple) else value) != data["origin"][name]:
                text = f"{name} of the certificate are others than those of robot and recipe"
                self.say("base parameters", "not made again", text, stop=True)
                return
        B = np.array(data["problem"]["base_matrix"], dtype=np.float64)
        off = float(np.abs(B - base.matrix).max(initial=0.0))
        terms = ", ".join(self._terms()) or "none"
        text = (
            f"{base.count} base parameters of {len(base.theta_names)}, friction and effects "
            f"{terms}; the matrix is the certificate's to within {off:.3g}"
        )
        wrong = []
        if not off <= _REGROUPED * np.abs(base.matrix).max(initial=0.0):
            wrong = [f"the matrix is not the certificate's: entries differ by up to {off:.3g}"]
        self.judge("base parameters", wrong, text)

    def _terms(self) -> Iterator[str]:
        """Yield the terms with their settings, and whether bodies in them are the description's."""
        assert self.robot is not None
        for term in self.sealed.recipe.friction:
            bodies = getattr(term, "bodies", None)
            if bodies is None:
                yield repr(term)
            elif np.array_equal(bodies, self.robot.prior):
                yield f"{type(term).__name__} of the description's bodies"
            else:
                yield f"{type(term).__name__} of bodies that the recipe states"

    def compare_weights(self) -> None:
        """Compare the covariance of efforts with the one that the recipe names."""
        problem, recipe = self.problem, self.sealed.recipe
        assert problem is not None
        sigma, wrong = problem.sigma, []
        if recipe.sigma is not None and sigma.shape == recipe.sigma.shape:
            size = np.sqrt(np.diagonal(sigma))
            off = float(np.abs((recipe.sigma - sigma) / np.outer(size, size)).max(initial=0.0))
            if not off <= LIMIT:
                wrong.append(f"the recipe's covariance of efforts is off by {off:.3g} of its size")
        elif recipe.sigma is not None:
            wrong.append("the recipe's covariance of efforts is of other joints")
        scale = getattr(problem.rows, "force_scale", 1.0)
        wrong += differences(recipe.force_scale, scale, where="the scale of measured forces")
        text = f"by the weighting '{recipe.weighting}' {_weights(sigma)}"
        self.judge("weights", wrong, text)

    def compare_rows(self) -> None:
        """Compare the cost of the rows with the certificate's, for all parameters."""
        problem, data = self.problem, self.sealed.data
        assert problem is not None
        given, claims = data["problem"], data["claims"]
        rhs = np.array(given["rhs"], dtype=np.float64)
        A = np.array(given["A"], dtype=np.float64).reshape(len(rhs), -1)
        off = distance((A, rhs, float(given["floor"])), (problem.A, problem.rhs, problem.floor))
        self.distance = off
        if not off <= LIMIT:
            text = (
                "A, rhs and floor of the certificate are not of the rows of this log: the costs "
                f"differ by up to {off:.3g} of themselves (limit {LIMIT:g})"
            )
            self.say("rows", "not made again", text, stop=True)
            return
        text = (
            "for all parameters, the cost of the rows is the certificate's to within "
            f"{off:.3g} of itself (limit {LIMIT:g})"
        )
        if claims["gap"] is not None:
            # Cost and bound are off by this share, each its own way.
            self.gap = claims["gap"] + 2.0 * off
            text += f"; with it the gap is at most {self.gap:.10g}"
        self.say("rows", "made again", text)

    def compare_choice(self) -> None:
        """Compare the parameters with those that are chosen: cheapest, or of these the nearest."""
        problem, data = self.problem, self.sealed.data
        assert problem is not None
        if not self.stated:
            return
        which = "which of the parameters that cost the same were chosen"
        if problem.prior is None and problem.consistency == "none":
            self.say("choice", "not checked", f"{which}: links may be any")
            return
        if problem.prior is None and self.of_folder:
            self.say("choice", "not checked", f"{which}: give --robot")
            return
        theta, best = np.array(data["theta"], dtype=np.float64), solve_sdp(problem)
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
        self.judge("choice", wrong, f"solved for again, the parameters are those {wanted}")

    def write(self) -> None:
        """Write the files again and compare them."""
        problem, sealed, prepared = self.problem, self.sealed, self.prepared
        assert problem is not None
        assert prepared is not None
        if sealed.data["theta"] is None:
            raise DataError("the certificate has no parameters")
        found = check_friction(sealed, problem.robot.n_base)
        if self.stated:
            # Words for base parameters have digits of the matrix, which has been compared.
            B = frozen(np.array(sealed.data["problem"]["base_matrix"]))
            base = replace(problem.base, matrix=B)
            whole = replace(problem, base=base).with_origin(profiled=sealed.recipe.profiled or ())
            found += Files(
                sealed,
                whole,
                lambda each: with_motion_bias_of(each, prepared)[0],
                described=not self.of_folder,
            ).check()
        for link in found:
            self.say(link.name, link.state, link.text)
        if self.of_folder and URDF in sealed.files:
            text = (
                "joints, places, limits and shapes, and what the description had in place of a "
                "prior: none is given (--robot)"
            )
            self.say(URDF, "not checked", text)


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
