"""A results folder of `sdpid identify`, read from its files alone."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid._common.files import load_toml
from sdpid._common.tables import Shown, Table
from sdpid.errors import DataError
from sdpid.output.tables.parameters_file import parameters_dict
from sdpid.robot.description.level import without_level
from sdpid.robot.description.xml import read_description
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.stored import term_from_dict
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.robot.model.load import load_robot
from sdpid.verifier.reading import REFUSED, numbers, parse, read_bytes, text
from sdpid.workflow.replay.numbers import ROBOTS
from sdpid.workflow.result import Identification

# Bytes of a file that is read: result.json of an arm has 0.1 MB.
_LIMIT = 32 * 2**20

# The prediction of the run itself among those of what was held out.
OURS = "this estimate"

# Options that say where files go or what is printed, not what is computed; the logs and the robot
# are told apart by their hashes.
_NOT_COMPUTED = frozenset(
    {"out", "figures", "offsets", "verbose", "json", "quiet", "log", "validation"}
)


@dataclass(frozen=True)
class SavedParameter:
    """A parameter of a run.

    Attributes
    ----------
    value : float
        Its value.
    unit : str
        Its unit.
    lower, upper : float or None
        Its interval; None where the run has none.
    expression : str
        What standard parameters a base parameter is made of.
    """

    value: float
    unit: str
    lower: float | None
    upper: float | None
    expression: str = ""


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class SavedRun(Shown):
    """A result of `identify`, read from the files that it was saved in.

    Attributes
    ----------
    folder : Path or None
        The folder; None of a result that is not saved.
    result : dict
        Content of result.json.
    inputs : dict of str to tuple of (str, str), or None
        Names and SHA-256 of the files of each role; None without a manifest.
    recipe : dict or None
        How rows were made of the logs; None without one in the manifest.
    options : dict or None
        Options of the command; None without run.toml.
    intervals : (str or None, float or None)
        Method and level of the intervals.
    base, standard : dict of str to SavedParameter
        Base parameters and, where the method has some, standard ones.
    links : tuple of str
        Moving links, in the order of their standard parameters.

    Examples
    --------
    >>> files = result.save("results")
    >>> saved = sdpid.load("results")
    >>> saved.base["Fv1"].unit, saved.headline["worst"][:5]
    ('N.m.s/rad', 'joint')
    >>> q = np.zeros(6)
    >>> bool(np.allclose(saved.model().mass_matrix(q), result.model().mass_matrix(q)))
    True
    """

    folder: Path | None
    result: dict[str, Any]
    inputs: dict[str, tuple[tuple[str, str], ...]] | None
    recipe: dict[str, Any] | None
    options: dict[str, Any] | None
    intervals: tuple[Any, Any]
    base: dict[str, SavedParameter]
    standard: dict[str, SavedParameter]
    links: tuple[str, ...]

    def _shown(self) -> dict[str, object]:
        names = ("status", "certified", "cost", "lower_bound", "gap")
        return {"folder": self.folder, **{name: self.result[name] for name in names}}

    def _tables(self) -> Iterator[Table]:
        lines = [(what, text) for what, text in self.headline.items() if isinstance(text, str)]
        yield Table(("verdict", ""), tuple(lines))

    @classmethod
    def of(cls, given: SavedRun | Identification | str | os.PathLike[str]) -> SavedRun:
        """Return a result as its files say it: of `identify`, or of a folder.

        Raises
        ------
        DataError
            When it is none, or a file of it cannot be understood.
        """
        if isinstance(given, SavedRun):
            return given
        if isinstance(given, Identification):
            parameters = parameters_dict(given.estimate, intervals=given.intervals)
            recipe = None if given.recipe is None else given.recipe.to_dict()
            sealed = {"inputs": given.inputs, "recipe": recipe}
            return cls._from(None, given.to_dict(), parameters, sealed, None)
        path = Path(given) if isinstance(given, (str, os.PathLike)) else None
        if path is None or not path.is_dir():
            raise DataError(f"{given}: is no folder; give one that sdpid identify --out wrote.")
        missing = [n for n in ("result.json", "parameters.json") if not (path / n).exists()]
        if missing:
            raise DataError(
                f"{path}: has no {' and no '.join(missing)}; give a folder that sdpid identify "
                "--out wrote, with all its files."
            )
        result, parameters = (_json(path / n) for n in ("result.json", "parameters.json"))
        manifest = _json(path / "manifest.json") if (path / "manifest.json").exists() else None
        options = load_toml(path / "run.toml") if (path / "run.toml").exists() else None
        try:
            return cls._from(path, result, parameters, manifest, options)
        except REFUSED as cause:
            raise DataError(
                f"{path}: its files are not as sdpid identify writes them ({cause!r:.120}); "
                "`sdpid verify` names the file that was changed."
            ) from None

    @classmethod
    def _from(
        cls,
        folder: Path | None,
        result: dict[str, Any],
        parameters: Mapping[str, Any],
        manifest: Mapping[str, Any] | None,
        options: dict[str, Any] | None,
    ) -> SavedRun:
        recipe = manifest and manifest["recipe"]
        standard = parameters.get("standard") or {}
        return cls(
            folder=folder,
            result=_checked(result),
            inputs=None if manifest is None else _inputs(manifest),
            recipe={**recipe, "processing": dict(recipe["processing"])} if recipe else None,
            options=options,
            intervals=(parameters["interval_method"], parameters["interval_level"]),
            base={name: _parameter(entry) for name, entry in parameters["base"].items()},
            standard={name: _parameter(entry) for name, entry in standard.items()},
            links=tuple(map(str, parameters["links"].values())),
        )

    @property
    def headline(self) -> dict[str, Any]:
        """The verdict in short, as `Headline` has it."""
        return dict(self.result["headline"])

    @property
    def bodies(self) -> dict[str, Array]:
        """Standard parameters (10,) of each link; none where the method has none."""
        if not self.standard:
            return {}
        values = np.array([each.value for each in self.standard.values()])[: 10 * len(self.links)]
        return dict(zip(self.links, values.reshape(-1, 10), strict=True))

    def model(self) -> RobotDynamics:
        """Return the identified robot, to compute with; see `Estimate.model`.

        Its kinematics are those of the robot in the folder, its terms those of the recipe.

        Raises
        ------
        DataError
            When the folder has no robot, or terms whose code no file can hold.
        """
        what = self.folder or "a result that is not saved"
        files = [each for name in ROBOTS if self.folder and (each := self.folder / name).exists()]
        if not files or self.recipe is None:
            lacking = " and no ".join(ROBOTS) if self.recipe else "recipe in its manifest.json"
            raise DataError(f"{what}: has no {lacking}, so that no model can be made of it.")
        given = self.recipe["robot"]
        text = without_level(read_description(files[0]).text)
        robot = load_robot(text, root=given["root"], gravity=given["gravity"])
        terms = [term_from_dict(each) for each in self.recipe["friction"]]
        friction = FrictionModel.from_terms(terms, robot.joint_names, first=robot.n_base)
        if [*robot.parameter_names, *(p.name for p in friction.parameters)] != [*self.standard]:
            raise DataError(f"{what}: {files[0].name} is of another robot than parameters.json.")
        theta = frozen(np.array([each.value for each in self.standard.values()]))
        return RobotDynamics(robot=robot, terms=friction, theta=theta)

    def to_frame(self, parameters: Literal["base", "standard"] = "base") -> Any:
        """Return base or standard parameters as a pandas DataFrame: unit, value and interval."""
        import pandas

        entries = self.base if parameters == "base" else self.standard
        return pandas.DataFrame.from_dict({k: vars(e) for k, e in entries.items()}, orient="index")

    def plot(self, *, axes: Any = None) -> Any:
        """Draw base parameters with their intervals (extra ``plot``) and return the axes."""
        from sdpid.plots.estimates import plot_forest

        columns = np.array([(e.value, e.lower, e.upper) for e in self.base.values()], dtype=float)
        value, lower, upper = columns.T
        sets = {"this estimate": value}
        return plot_forest([*self.base], sets, lower=lower, upper=upper, axes=axes)

    def files(self, role: str) -> tuple[str, ...]:
        """Return the SHA-256 of the files of a role, in their order."""
        return tuple(digest for _, digest in (self.inputs or {}).get(role, ()))

    @property
    def processing(self) -> dict[str, Any]:
        """Settings of the processing; none without a recipe."""
        return dict((self.recipe or {}).get("processing", {}))

    @property
    def problem(self) -> dict[str, Any]:
        """Sizes and choices of the problem."""
        return dict(self.result["problem"])

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the friction terms."""
        return tuple(str(term["term"]) for term in self.problem["friction_terms"])

    @property
    def settings(self) -> dict[str, Any]:
        """Options of the command that say what is computed."""
        return {k: v for k, v in (self.options or {}).items() if k not in _NOT_COMPUTED}


def _json(path: Path) -> dict[str, Any]:
    try:
        return parse(read_bytes(path, _LIMIT))
    except OSError as cause:
        raise DataError(f"{path}: cannot be read ({cause.strerror}).") from None
    except REFUSED as cause:
        raise DataError(f"{path}: cannot be understood ({cause}).") from None


def _checked(result: dict[str, Any]) -> dict[str, Any]:
    """Return the content of result.json, once what is looked at later is what it should be."""
    problem = result["problem"]
    [text(each, "joints") for each in problem["joints"]]
    [text(each["term"], "friction terms") for each in problem["friction_terms"]]
    for name in ("cost", "lower_bound", "gap"):
        numbers(result[name])
    result["certified"], result["worst_margin"]
    dict(result["headline"])
    if (held := result["held_out"]) is not None:
        held["by"], held["blocks"], held[OURS]
        for each in predictions(held).values():
            numbers(each["relative_residual"])
            for joint in each["joints"].values():
                numbers(0.0 if joint["nrmse"] is None else joint["nrmse"])
                numbers(joint["rows"])
    return result


def predictions(held: Mapping[str, Any]) -> dict[str, Any]:
    """Return the errors in motion of each model on what was held out."""
    return {name: each["moving"] for name, each in held.items() if name not in ("by", "blocks")}


def _inputs(manifest: Mapping[str, Any]) -> dict[str, tuple[tuple[str, str], ...]]:
    found: dict[str, tuple[tuple[str, str], ...]] = {}
    for entry in manifest["inputs"]:
        role = str(entry["role"])
        found[role] = (*found.get(role, ()), (str(entry["name"]), str(entry["sha256"])))
    return found


def _parameter(entry: Mapping[str, Any]) -> SavedParameter:
    ends = entry.get("interval") or (None, None)
    lower, upper = (None if end is None else numbers(end) for end in ends)
    value, expression = numbers(entry["value"]), str(entry.get("expression", ""))
    return SavedParameter(value, str(entry["unit"]), lower, upper, expression)


def load(folder: str | os.PathLike[str]) -> SavedRun:
    """Load a result of `identify` from the folder that it was saved in.

    Nothing is computed anew, and nothing is proven: `verify` checks a folder.

    Parameters
    ----------
    folder : path
        Written by `Identification.save` or ``sdpid identify --out``.

    Returns
    -------
    SavedRun
        ``.model()``, ``.base`` and ``.standard`` with intervals, ``.to_frame()``, ``.plot()``.

    Raises
    ------
    DataError
        When it is no such folder, or a file of it cannot be understood.

    Examples
    --------
    >>> files = result.save("results")
    >>> round(sdpid.load("results").base["Fv1"].value)
    151
    """
    return SavedRun.of(folder)
