"""The recipe: how rows are made of logs, as plain values that make the same rows again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid._common.tables import plain
from sdpid.assurance.recipe.stated import StatedProblem
from sdpid.errors import CertificateError, ModelError, SdpidError
from sdpid.estimation.compression.covariance import WEIGHTINGS, Weighting
from sdpid.estimation.effects.choose import Profiled
from sdpid.estimation.problem import Problem
from sdpid.experiment.preparation.prepare import Prepared
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.readers.mapping import Arguments
from sdpid.robot.friction.posed import PosedTerm
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.friction.terms import term_from_dict, term_to_dict
from sdpid.robot.model.base_parameters import kinematics_digest
from sdpid.robot.model.model import RobotModel
from sdpid.robot.model.transmission import Transmission

# Weightings with a covariance for each sample: it comes from the log's periods, as do the rows.
PER_SAMPLE: tuple[Weighting, ...] = ("gls_per_sample", "eq9", "eq18")

_TEXT = (str, type(None))
_OF_ROBOT: dict[str, Any] = {
    "name": str,
    "catalog": bool,
    **dict.fromkeys(("source", "root", "kinematics"), _TEXT),
}
# More than on any planet, m/s².
_MOST_GRAVITY = 100.0


@dataclass(frozen=True, kw_only=True)
class RobotRecipe:
    """How the robot's description was loaded.

    Attributes
    ----------
    name : str
        The robot's name.
    source : str or None
        The file, or the name in a catalog; None for a model from elsewhere.
    catalog : bool
        Whether `source` is a name that `load_robot` knows.
    root : str or None
        ``"free_flyer"`` where the base floats.
    xacro_args : dict of str to str
        Arguments of a xacro file.
    gravity : tuple of 3 floats
        In the base link, m/s².
    kinematics : str or None
        SHA-256 of the kinematics (see `kinematics_digest`).
    transmission : mapping or None
        How the joints follow the motors, as `load_robot` takes it; None where they are those.
    """

    name: str
    source: str | None
    catalog: bool
    root: Literal["free_flyer"] | None
    xacro_args: dict[str, str]
    gravity: tuple[float, ...]
    kinematics: str | None
    transmission: Mapping[str, Any] | None = None

    @classmethod
    def of(cls, robot: RobotModel) -> RobotRecipe:
        """Return how a robot was loaded."""
        source = robot.source
        options = {} if source is None else source.options
        return cls(
            name=robot.name,
            source=None if source is None else source.name or None,
            catalog=bool(options.get("catalog", False)),
            root=options.get("root"),
            xacro_args=dict(options.get("xacro_args", {})),
            gravity=tuple(robot.gravity.tolist()),
            kinematics=kinematics_digest(robot),
            transmission=robot.transmission,
        )

    @classmethod
    def from_dict(cls, given: Any) -> RobotRecipe:
        """Return the recipe of `plain` values; TypeError or ValueError where it is none."""
        if isinstance(given, Mapping):
            # Recipes of runs before there were transmissions.
            given = {"transmission": None, **given}
        _require_keys(given, _names(cls))
        if given["transmission"] is not None:
            given["transmission"] = Transmission.of(given["transmission"]).to_dict()
        for name, kind in _OF_ROBOT.items():
            if not isinstance(given[name], kind):
                raise TypeError(f"{name} of the robot is {given[name]!r:.80}")
        arguments = given["xacro_args"]
        if not (isinstance(arguments, dict) and all(type(x) is str for x in arguments.values())):
            raise TypeError(f"xacro_args of the robot are {arguments!r:.80}")
        gravity = tuple(float(each) for each in given["gravity"])
        if len(gravity) != 3 or not all(abs(each) <= _MOST_GRAVITY for each in gravity):
            raise ValueError(f"gravity is {given['gravity']!r:.80}")
        return cls(**{**given, "gravity": gravity})

    @property
    def arguments(self) -> dict[str, Any]:
        """The arguments of `load_robot` that load it again."""
        given: dict[str, Any] = {"gravity": self.gravity, "root": self.root}
        for name in ("xacro_args", "transmission"):
            given |= {name: value} if (value := getattr(self, name)) else {}
        return given


@dataclass(frozen=True, kw_only=True, eq=False)
class Recipe:
    """How the rows of a problem were made.

    Attributes
    ----------
    robot : RobotRecipe
        The robot.
    reading : tuple of dict or None
        For each log the arguments of `read_recording` beside its path; None for a recording that
        was made in memory.
    processing : Processing
        Of all logs.
    without_effort : tuple of str
        Joints whose efforts are not used.
    friction : tuple of FrictionTerm
        The terms, with every number that the data chose.
    weighting : str
        How rows are weighted.
    sigma : ndarray, shape (n, n), or None
        Their covariance; None where it is that of each sample, from the spread of the periods.
    problem : StatedProblem or None
        What was asked of the parameters; None where that is no plain value.
    force_scale : float
        What covariances of measured contact forces are multiplied by.
    profiled : tuple of Profiled, or None
        Numbers of terms that the data chose, whose errors count in intervals; None in recipes that
        do not say.
    """

    robot: RobotRecipe
    reading: tuple[dict[str, Any] | None, ...]
    processing: Processing
    without_effort: tuple[str, ...]
    friction: tuple[FrictionTerm, ...]
    weighting: Weighting
    sigma: Array | None
    problem: StatedProblem | None = None
    force_scale: float = 1.0
    profiled: tuple[Profiled, ...] | None = None

    @classmethod
    def of(cls, problem: Problem, prepared: Prepared) -> Recipe:
        """Return the recipe of a problem that was built of prepared recordings.

        Raises
        ------
        ModelError
            When a friction term is of a class that no file can hold.
        """
        each = problem.weighting in PER_SAMPLE and problem.sigma.ndim == 3
        recipe = cls(
            robot=RobotRecipe.of(problem.robot),
            reading=tuple(
                None if log.source is None else dict(log.source.options) for log in prepared.logs
            ),
            processing=replace(prepared.processing, reasons=()),
            without_effort=prepared.without_effort,
            friction=tuple(_explicit(term, problem.robot) for term in problem.friction.terms),
            weighting=problem.weighting,
            sigma=None if each else _symmetric(problem.sigma),
            problem=StatedProblem.of(problem),
            force_scale=1.0 if problem.rows is None else problem.rows.force_scale,
            profiled=problem.origin.profiled,
        )
        recipe.to_dict()
        return recipe

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "robot": plain(self.robot),
            "logs": [{"reading": reading} for reading in self.reading],
            "processing": {
                name: value for name, value in plain(self.processing).items() if name in _SETTINGS
            },
            "without_effort": list(self.without_effort),
            "friction": [term_to_dict(term) for term in self.friction],
            "weighting": self.weighting,
            "sigma": plain(self.sigma),
            "problem": None if self.problem is None else self.problem.to_dict(),
            "force_scale": self.force_scale,
            "profiled": plain(self.profiled),
        }

    @classmethod
    def from_dict(cls, given: Any) -> Recipe:
        """Return the recipe of `to_dict`.

        Raises
        ------
        CertificateError
            When something is missing, not known, or of another kind.
        """
        try:
            return cls._from(given)
        except (SdpidError, TypeError, ValueError, KeyError, AttributeError) as cause:
            raise CertificateError(
                f"manifest.json: its recipe cannot be followed: {str(cause).rstrip('.')}."
            ) from None

    @classmethod
    def _from(cls, given: Any) -> Recipe:
        if isinstance(given, Mapping):
            # Recipes of runs before there were contacts, and before this was said.
            given = {"force_scale": 1.0, "profiled": None, **given}
        _require_keys(given, _names(cls) - {"reading"} | {"logs"})
        _require_keys(given["processing"], _SETTINGS)
        if (stated := given["problem"]) is not None:
            _require_keys(stated, _names(StatedProblem))
        for log in given["logs"]:
            _require_keys(log, {"reading"})
            if log["reading"] is not None and (wrong := set(log["reading"]) - _names(Arguments)):
                raise ValueError(f"reading has {', '.join(sorted(map(repr, wrong)))[:200]}")
        if given["weighting"] not in WEIGHTINGS:
            raise ValueError(f"weighting is {given['weighting']!r:.80}")
        scale, effortless = given["force_scale"], given["without_effort"]
        if type(scale) not in (int, float) or not 0.0 < scale < np.inf:
            raise ValueError(f"force_scale is {scale!r:.80}, expected a positive number")
        if not isinstance(effortless, list) or not all(type(each) is str for each in effortless):
            raise TypeError(f"without_effort is {effortless!r:.80}, expected a list of names")
        profiled, sigma = given["profiled"], given["sigma"]
        return cls(
            robot=RobotRecipe.from_dict(given["robot"]),
            reading=tuple(log["reading"] for log in given["logs"]),
            processing=Processing(**given["processing"]),
            without_effort=tuple(effortless),
            friction=tuple(map(term_from_dict, given["friction"])),
            weighting=given["weighting"],
            sigma=None if sigma is None else _covariance(sigma),
            problem=None if stated is None else StatedProblem.from_dict(stated),
            force_scale=float(scale),
            profiled=None if profiled is None else tuple(map(_profiled, profiled)),
        )


def recipe_or_reason(problem: Problem, prepared: Prepared) -> tuple[Recipe | None, str | None]:
    """Return the recipe of a problem, or why there can be none."""
    try:
        return Recipe.of(problem, prepared), None
    except ModelError as reason:
        return None, f"the rows cannot be made again from the log: {reason}"


def _explicit(term: FrictionTerm, robot: RobotModel) -> FrictionTerm:
    """Return a term that holds the bodies that it took from the robot's description."""
    if isinstance(term, PosedTerm) and term.bodies is None:
        return replace(term, bodies=tuple(map(tuple, robot.prior.tolist())))
    return term


def _profiled(given: Any) -> Profiled:
    """Return a number that the data chose."""
    _require_keys(given, _names(Profiled))
    for name, value in given.items():
        kind = str if name in ("term", "name", "unit") else float
        if type(value) is not kind or value in (np.inf, -np.inf):
            raise ValueError(f"{name} of a number that the data chose is {value!r:.80}")
    return Profiled(**given)


def _covariance(given: Any) -> Array:
    """Return a covariance (n, n)."""
    values = np.array(given, dtype=np.float64)
    if values.ndim != 2 or values.shape[0] != values.shape[1] or not np.isfinite(values).all():
        raise ValueError(f"sigma has the shape {values.shape}, expected a square matrix")
    if not np.array_equal(values, values.T):
        raise ValueError("sigma is not symmetric")
    return frozen(values)


def _symmetric(covariance: Array) -> Array:
    """Return a covariance (n, n) without rounding beside its diagonal: the lower half counts."""
    return frozen(np.tril(covariance) + np.tril(covariance, -1).T)


def _names(kind: Any) -> set[str]:
    """Return the names of the fields of a class."""
    return {each.name for each in fields(kind)}


def _require_keys(given: Any, expected: set[str]) -> None:
    """Refuse what is no mapping with exactly these keys."""
    if not isinstance(given, Mapping):
        raise TypeError(f"{given!r:.80} is no table of {', '.join(sorted(expected))}")
    if wrong := sorted(map(str, given.keys() ^ expected)):
        raise ValueError(f"missing or not known: {', '.join(wrong)[:200]}")


_SETTINGS = _names(Processing) - {"reasons"}
