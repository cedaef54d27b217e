"""Write the files of a folder again, from the parameters and what was made of the log."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, get_args

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid._common.tables import json_text, plain_dict
from sdpid.assurance.diagnostics.held_out import LEAST_SQUARES, OURS, hold_out
from sdpid.assurance.diagnostics.validation import validate
from sdpid.assurance.intervals.intervals import Intervals, Method, confidence_intervals
from sdpid.assurance.recipe.recipe import Recipe
from sdpid.errors import CertificateError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem
from sdpid.estimation.wls import solve_wls
from sdpid.experiment.preparation.prepare import Prepared
from sdpid.output.robots.friction_files import NAMES, SCHEMA, VERSION, WRITERS, terms_data
from sdpid.output.robots.mjcf import write_mjcf
from sdpid.output.robots.urdf import write_urdf
from sdpid.output.tables.parameter_tables import base_table, intervals_dict, theta_table
from sdpid.output.tables.parameters_file import write_parameters
from sdpid.robot.description.xml import decode_xml
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.posed import LoadFriction, PositionFriction
from sdpid.robot.friction.term import smooth_sign
from sdpid.verifier import certificate, manifest
from sdpid.verifier.exact import product
from sdpid.verifier.folder import CERTIFICATE
from sdpid.verifier.reading import REFUSED, parse, read_bytes, text
from sdpid.workflow.identify import with_motion_bias_of
from sdpid.workflow.replay import compare
from sdpid.workflow.replay.compare import LIMIT, MJCF, PARAMETERS, RESULT, URDF, Link, checked

# Descriptions of robots may be larger than proofs.
_LARGEST = 64 * 2**20

# Extremes over feasible parameters, and quantiles of draws, are found to a solver's accuracy.
_SOLVED = 1e-2

# Friction by the package's own terms and by the code, relative to the size of the efforts.
_SAME = 1e-12

# Of parameters.json: who solved and with which words, which is of no number here.
_OF_THE_RUN = {"made_by", "method", "status", "cost_at_most", "certificate", "effects"}

# What solving took.
_OF_INTERVALS = {"seconds", "solves"}


@dataclass(frozen=True, eq=False)
class Sealed:
    """The parts of a results folder that say how it was made.

    Attributes
    ----------
    folder : Path
        The folder.
    manifest : dict
        Its files, and name, bytes and SHA-256 of what the run was given.
    recipe : Recipe
        How rows are made of the logs.
    data : dict
        The certificate.
    """

    folder: Path
    manifest: dict[str, Any]
    recipe: Recipe
    data: dict[str, Any]

    @classmethod
    def read(cls, folder: str | os.PathLike[str]) -> Sealed:
        """Read manifest.json and certificate.json.

        Raises
        ------
        CertificateError
            When a file is missing or damaged, or the manifest has no recipe.
        """
        whole = Path(folder)
        if not whole.is_dir():
            raise CertificateError(
                f"{folder}: is no folder; a log is checked against the whole folder that "
                "'sdpid identify' wrote."
            )
        contents = []
        for name, load in ((manifest.NAME, manifest.load), (CERTIFICATE, certificate.load)):
            path = whole / name
            try:
                contents.append(load(read_bytes(path)))
            except OSError as cause:
                raise CertificateError(f"cannot read {path}: {cause.strerror}.") from None
            except REFUSED as cause:
                raise CertificateError(f"{path}: {cause}.") from None
        listing, data = contents
        where = whole / manifest.NAME
        if listing["recipe"] is None:
            raise CertificateError(
                f"{where}: has no recipe, so that the rows cannot be made again from the log: the "
                "run was not one of 'identify', or had friction terms of a class of its own."
            )
        sealed = cls(whole, listing, Recipe.from_dict(listing["recipe"]), data)
        if (found := len(sealed.inputs("log"))) != len(sealed.recipe.reading):
            raise CertificateError(
                f"{where}: names {found} logs and how {len(sealed.recipe.reading)} are read."
            )
        return sealed

    def inputs(self, role: str) -> list[dict[str, Any]]:
        """Return name, bytes and SHA-256 of the logs in order, or of the robot's description."""
        return [entry for entry in self.manifest["inputs"] if entry["role"] == role]


@dataclass(frozen=True, eq=False)
class Files:
    """The files of a folder, and what they are written again from.

    Attributes
    ----------
    sealed : Sealed
        The folder.
    problem : Problem
        Made again of the logs.
    prepared : Prepared
        The logs, which tell what moves the fit beside noise.
    described : bool
        Whether the robot has the bodies of the run's description, which stand for a prior where
        there is none.
    """

    sealed: Sealed
    problem: Problem
    prepared: Prepared
    described: bool

    @cached_property
    def estimate(self) -> Estimate:
        """The certified parameters."""
        theta, B = self.sealed.data["theta"], self.sealed.data["problem"]["base_matrix"]
        base = frozen([float(each) for each in product(B, theta)])
        problem = self.problem
        if self._method is not None:
            # Intervals count what is known to move the fit beside noise.
            problem, _ = with_motion_bias_of(problem, self.prepared)
        of_theta = Estimate.of_theta(problem, theta, method="sdp", status="optimal", message="")
        return replace(of_theta, base=base)

    @cached_property
    def wls(self) -> Estimate:
        """The unconstrained fit."""
        return solve_wls(replace(self.estimate.problem, prior=None))

    @cached_property
    def _parameters(self) -> dict[str, Any]:
        return parse(read_bytes(self.sealed.folder / PARAMETERS))

    @cached_property
    def _result(self) -> dict[str, Any]:
        return parse(read_bytes(self.sealed.folder / RESULT))

    @property
    def _method(self) -> Method | None:
        """How the intervals were made that the folder has."""
        method: Method | None = self._parameters["interval_method"]
        if method is not None and method not in get_args(Method):
            raise ValueError("interval_method is not known")
        return method

    @cached_property
    def intervals(self) -> Intervals | None:
        """The intervals, by the method and the level that the folder names."""
        if self._method is None:
            return None
        level = float(self._parameters["interval_level"])
        return confidence_intervals(self.estimate, method=self._method, level=level)

    @property
    def _of_width(self) -> float:
        """How near ends of intervals are to those that were made again, in widths."""
        return 0.0 if self._method in (None, "gauss_markov") else _SOLVED

    def check(self) -> list[Link]:
        """Return whether each file is as written again."""
        robot = (
            "written again from the description and the parameters, it is the same: numbers "
            f"to 1e-12, friction that is fitted to {LIMIT:g}, all else to the letter but for white "
            "space and quotes that writers choose"
        )
        near, method = f"{LIMIT:g} of the numbers of a row", "none"
        if self._of_width:
            near += f", ends of intervals to {self._of_width:g} of their width"
        if self._method is not None:
            chosen = ", ".join(each.name for each in self.problem.origin.profiled) or "nothing"
            level = self._parameters["interval_level"]
            method = f"{self._method} at {level!r}; of friction terms the data chose {chosen}"
        result = (
            "errors in training and on blocks held out, of the unconstrained fit too, and "
            f"intervals are those of these rows, to {near}"
        )
        other = (
            f"written again from parameters and rows, with intervals ({method}), "
            f"standard errors and shares, it is the same, to {near}"
        )
        said = {**dict.fromkeys((PARAMETERS, RESULT, *compare.TABLES), other), RESULT: result}
        said |= dict.fromkeys(compare.ROBOTS, robot)
        # Certificates of this version come with recipes that say it.
        old = self.sealed.data["version"] < certificate.VERSION
        found, unsaid = list[Link](), self.sealed.recipe.profiled is None and old
        for name, words in said.items():
            if name not in self.sealed.manifest["files"]:
                continue
            if unsaid and name not in (URDF, MJCF):
                why = "intervals: the recipe does not say which numbers of terms the data chose"
                found.append(Link(name, "not checked", why))
            elif (
                name == MJCF
                and not self.described
                and any(each["lumped"] for each in self._result["exports"])
            ):
                # Of the folder's URDF they have none any more.
                why = "what it holds: bodies fixed to links stand in the description (--robot)"
                found.append(Link(name, "not checked", why))
            else:
                found += checked(name, partial(self._differences, name), words)
        return compare.by_file(found)

    def _write(self, path: Path) -> Any:
        """Write a file again; return the report of a robot's."""
        estimate = self.estimate
        if path.name == URDF:
            return write_urdf(estimate, target=path)
        if path.name == MJCF:
            # As that of the folder was asked for: offsets are general actuators, and friction over
            # position is at spatial tendons; drives are motors and fixed tendons.
            text = read_bytes(self.sealed.folder / MJCF, _LARGEST)
            offsets, tendons = b"<general " in text, b"<spatial " in text
            return write_mjcf(estimate, target=path, offsets=offsets, tendons=tendons)
        if path.name == RESULT:
            return path.write_text(json_text(self._of_result()), encoding="utf-8")
        ends = self.intervals
        if path.name == PARAMETERS:
            return write_parameters(estimate, path, intervals=ends)
        standard = compare.TABLES[path.name] == "standard"
        table = theta_table(estimate, ends) if standard else base_table(estimate, self.wls, ends)
        return table.write(path)

    def _differences(self, name: str) -> Iterator[str]:
        """Yield what of a file is other than it is written again."""
        content = read_bytes(self.sealed.folder / name, _LARGEST)
        with tempfile.TemporaryDirectory() as folder:
            report = self._write(path := Path(folder) / name)
            again = path.read_bytes()
        if name not in compare.ROBOTS:
            read = compare.read_table if path.suffix == ".csv" else parse
            found, made = (_without(read(each), self._aside[name]) for each in (content, again))
            if name == RESULT:
                found = {key: _at(found, key) for key in made}
            yield from compare.differences(found, made, of_width=self._of_width)
            return
        yield from compare.text_differences(*(decode_xml(each, name) for each in (content, again)))
        # Of a recording that is not here; and of a description, which may not be.
        aside = {"validation"} if self.described else {"validation", "lumped"}
        entries = [each for each in self._result["exports"] if each["file"] == name]
        own, other = ([_without(e, aside) for e in each] for each in (entries, [report.to_dict()]))
        yield from compare.differences(own, other, where=f"its entry in {RESULT}")

    @property
    def _aside(self) -> dict[str, set[str]]:
        """What is not made again of each file: what is of the run, and words.

        Shares neither without a prior nor a description.
        """
        known = self.described or self.problem.prior is not None
        shares = set() if known else {"shares", "data", "physics", "prior"}
        tables = dict.fromkeys(compare.TABLES, shares)
        return {**tables, PARAMETERS: shares | _OF_THE_RUN, RESULT: _OF_INTERVALS}

    def _of_result(self) -> dict[str, Any]:
        """Return what of result.json follows from parameters and rows."""
        made = {
            "training": validate(self.estimate),
            "training_unconstrained": validate(self.wls),
            "cost_unconstrained": self.wls.cost,
            "worst_margin": self.estimate.worst_margin,
            "intervals": None if self.intervals is None else intervals_dict(self.intervals),
        }
        if (own := self._result["held_out"]) is not None and own["by"] == "blocks":
            blocks = hold_out(self.estimate, self.wls, None)
            again = {} if blocks is None else blocks.to_dict()
            # Links of the description may be others where it is not the run's.
            made |= {f"held_out {k}": again.get(k) for k in ("blocks", OURS, LEAST_SQUARES)}
        return plain_dict(made)


def _without(values: Any, names: Container[str]) -> Any:
    """Return values by name, some left out wherever they stand in them."""
    if not isinstance(values, dict):
        return values
    return {name: _without(value, names) for name, value in values.items() if name not in names}


def _at(values: Any, key: str) -> Any:
    """Return a value, or of ``"held_out blocks"`` one that is in it."""
    first, _, second = key.partition(" ")
    return values[first][second] if second else values[first]


def check_friction(sealed: Sealed, first: int) -> list[Link]:
    """Return whether files of friction are what follows from recipe and parameters, to the byte.

    What the code computes is compared with the package's own terms: the writer is no check of
    itself. `first` is how many coordinates the base has.
    """
    said = (
        "the parameters are the certificate's, widths, speeds and exponents the recipe's, the code "
        "is what follows from these to the byte, and it computes what the package's own terms do"
    )
    names = [name for name in NAMES if name in sealed.manifest["files"]]
    return compare.by_file(
        link
        for name in names
        for link in checked(name, partial(_friction, sealed, first, name), said)
    )


def _friction(sealed: Sealed, first: int, name: str) -> Iterator[str]:
    """Yield what of a file of friction is not of the recipe's terms and the parameters."""
    data, origin = sealed.data, sealed.data["origin"]
    terms, links = sealed.recipe.friction, len(origin["links"])
    model = FrictionModel.from_terms(terms, origin["joints"], first=first)
    values = data["theta"][10 * links :]
    if [each.name for each in model.parameters] != origin["theta_names"][10 * links :]:
        yield "the recipe's terms have other parameters than the certificate"
        return
    numbers = {
        "schema": SCHEMA,
        "version": VERSION,
        "software": text(data["metadata"]["software"], "software"),
        "certificate": data["sha256"],
        "robot": origin["robot"],
        **terms_data(model, values),
    }
    found = read_bytes(sealed.folder / name)
    wanted = WRITERS[NAMES[name]](numbers).encode("ascii")
    if found != wanted:
        pairs = zip(found.split(b"\n"), wanted.split(b"\n"), strict=False)
        line = next((k for k, (one, two) in enumerate(pairs, 1) if one != two), None)
        where = "behind its end" if line is None else f"first in line {line}"
        yield f"it is not what follows from recipe and certificate, {where}"
    for what, own, computed in _computed(numbers, model, np.array(values)):
        size = max(1.0, float(np.abs(own).max(initial=0.0)))
        if not np.allclose(computed / size, own / size, rtol=_SAME, atol=_SAME):
            yield f"its {what} is not that of the recipe's terms"


def _computed(
    data: Mapping[str, Any], model: FrictionModel, values: Array
) -> Iterator[tuple[str, Array, Array]]:
    """Yield efforts by the package's own terms, and by the code that follows from numbers."""
    rng, n = np.random.default_rng(0), len(model.joint_names)
    speeds = 10.0 ** rng.uniform(-4.0, 1.0, (90, n)) * rng.choice([-1.0, 1.0], (90, n))
    bends = model.characteristic_speeds()
    v = np.vstack([np.zeros(n), speeds, bends, -2.0 * bends])
    a, load = rng.standard_normal((2, *v.shape))
    # No code needs the names of others: what is run here is made of numbers alone.
    plain = {"robot": "", "software": "", "certificate": None, "joints": list(map(str, range(n)))}
    code: dict[str, Any] = {}
    exec(WRITERS[".py"]({**data, **plain}), code)
    every, none, held = replace(model, first=0), np.zeros_like(v), np.zeros_like(v)
    for term, own in model.placed:
        if isinstance(term, LoadFriction):
            held += values[own] * np.abs(load) * term.sign(v, a)
        if isinstance(term, PositionFriction):
            level = np.einsum("cj,ckj->kj", values[own].reshape(3, -1), term.shapes(load))
            bent = level * smooth_sign(v, term.speed("width", n), 0.0)
            yield "friction over position", bent, code["position_friction"](v, load)
    rest = every.columns(none, none) @ values
    yield "friction", every.columns(v, none) @ values, code["friction"](v)
    yield "effort of drives", every.columns(none, a) @ values - rest, code["drive_inertia"](a)
    yield "friction of the load", held, code["load_friction"](v, load)
