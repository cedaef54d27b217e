"""Results of `identify` read back from their folders, and two of them against each other."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np

from sdpid._common.arrays import frozen
from sdpid._common.files import load_toml
from sdpid._common.tables import Shown, Table, plain_dict
from sdpid.errors import DataError
from sdpid.output.tables.parameters_file import parameters_dict
from sdpid.robot.description.catalog import identified_robots, results_folder
from sdpid.robot.description.urdf import without_level
from sdpid.robot.description.xml import read_description
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.terms import term_from_dict
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.robot.model.load import load_robot
from sdpid.verifier.reading import REFUSED, listed, numbers, parse, read_bytes, text
from sdpid.workflow.replay.compare import PARAMETERS, RESULT, ROBOTS
from sdpid.workflow.result import WRITTEN, Identification

# Results, and folders of them.
Saved: TypeAlias = "SavedRun | Identification | str | os.PathLike[str]"

# Options that say where files go or what is printed, not what is computed; the logs and the robot
# are told apart by their hashes.
_NOT_COMPUTED = {*WRITTEN, "out", "verbose", "json", "quiet", "log", "validation"}

_LOG = "log, SHA-256"

# What was chosen, beside friction terms and processing, and what was found.
_CHOSEN = ("weighting", "consistency", "margin", "prior", "samples", "rows_used")
_FOUND = ("cost", "lower_bound", "gap", "certified", "worst_margin")

_NO_JOINT_TEST = (
    "Files hold no covariances, so parameters are tested one by one and never together; "
    "first.compare_to(other) of the estimates does both."
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


_COLUMNS = SavedParameter.__dataclass_fields__


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
    def of(cls, given: Saved) -> SavedRun:
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
        path = results_folder(given) if isinstance(given, (str, os.PathLike)) else None
        if path is None or not path.is_dir():
            known = ", ".join(identified_robots())
            raise DataError(
                f"{given}: is no folder; give one that sdpid identify --out wrote, or the name of "
                f"an identified robot ({known})."
            )
        if missing := [name for name in (RESULT, PARAMETERS) if not (path / name).exists()]:
            raise DataError(
                f"{path}: has no {' and no '.join(missing)}; give a folder that sdpid identify "
                "--out wrote, with all its files."
            )
        manifest, config = path / "manifest.json", path / "run.toml"
        contents = [
            _json(path / RESULT),
            _json(path / PARAMETERS),
            _json(manifest) if manifest.exists() else None,
            load_toml(config) if config.exists() else None,
        ]
        try:
            return cls._from(path, *contents)
        except REFUSED as cause:
            raise DataError(
                f"{path}: its files are not as sdpid identify writes them ({cause!r:.120}); "
                "`sdpid verify` names the file that was changed."
            ) from None

    @classmethod
    def _from(
        cls, folder: Path | None, result: Any, parameters: Any, manifest: Any, options: Any
    ) -> SavedRun:
        """Return a result with the contents of its files."""
        recipe = None if manifest is None else manifest["recipe"]
        inputs: dict[str, tuple[tuple[str, str], ...]] = {}
        for entry in () if manifest is None else manifest["inputs"]:
            role, file = str(entry["role"]), (str(entry["name"]), str(entry["sha256"]))
            inputs[role] = (*inputs.get(role, ()), file)
        base, standard = (
            {name: _parameter(entry) for name, entry in (parameters.get(kind) or {}).items()}
            for kind in ("base", "standard")
        )
        run = cls(
            folder=folder,
            result=result,
            inputs=None if manifest is None else inputs,
            recipe={**recipe, "processing": dict(recipe["processing"])} if recipe else None,
            options=options,
            intervals=(parameters["interval_method"], parameters["interval_level"]),
            base=base,
            standard=standard,
            links=tuple(map(str, parameters["links"].values())),
        )
        # What is looked at later is understood now, or refused.
        run.headline, run.facts  # noqa: B018
        return run

    @property
    def headline(self) -> dict[str, Any]:
        """The verdict in short, as `Headline` has it."""
        return dict(self.result["headline"])

    @cached_property
    def facts(self) -> dict[str, object]:
        """What was given, asked, chosen and found, by where it stands in the files."""
        result, problem = self.result, self.result["problem"]
        held, recipe = dict(result["held_out"] or {}), self.recipe or {"processing": {}}
        options = {k: v for k, v in (self.options or {}).items() if k not in _NOT_COMPUTED}
        return {
            **{
                f"{role}, SHA-256": ", ".join(digest for _, digest in files)
                for role, files in (self.inputs or {}).items()
            },
            **{f"option {name}": value for name, value in options.items()},
            **{name: problem.get(name) for name in _CHOSEN},
            "friction terms": [text(each["term"], "terms") for each in problem["friction_terms"]],
            **{f"processing {name}": value for name, value in recipe["processing"].items()},
            **{f"held out {name}": held.pop(name, None) for name in ("by", "blocks")},
            **{
                f"error of {model}, %": 100.0 * numbers(each["moving"]["relative_residual"])
                for model, each in held.items()
            },
            **{name: result[name] for name in _FOUND},
        }

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
            links = f"; sdpid.load_robot reads the links of {files[0]}" if files else ""
            raise DataError(f"{what}: has no {lacking}, so that no model can be made of it{links}.")
        given = self.recipe["robot"]
        text = without_level(read_description(files[0]).text)
        how = {name: given.get(name) for name in ("root", "gravity", "transmission")}
        robot = load_robot(text, **how)
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
        rows, columns = [vars(each) for each in entries.values()], [*_COLUMNS]
        return pandas.DataFrame(rows, index=[*entries], columns=columns)

    def plot(self, *, axes: Any = None) -> Any:
        """Draw base parameters with their intervals (extra ``plot``) and return the axes."""
        from sdpid.plots.estimates import plot_forest

        value, lower, upper = self.to_frame()[["value", "lower", "upper"]].to_numpy(float).T
        sets = {"this estimate": value}
        return plot_forest([*self.base], sets, lower=lower, upper=upper, axes=axes)


def _json(path: Path) -> dict[str, Any]:
    """Return the object in a JSON file."""
    try:
        return parse(read_bytes(path))
    except OSError as cause:
        raise DataError(f"{path}: cannot be read ({cause.strerror}).") from None
    except REFUSED as cause:
        raise DataError(f"{path}: cannot be understood ({cause}).") from None


def _parameter(entry: Mapping[str, Any]) -> SavedParameter:
    ends = entry.get("interval") or (None, None)
    lower, upper = (None if end is None else numbers(end) for end in ends)
    value, expression = numbers(entry["value"]), str(entry.get("expression", ""))
    return SavedParameter(value, str(entry["unit"]), lower, upper, expression)


def load(folder: str | os.PathLike[str]) -> SavedRun:
    """Load a result of `identify`: from the folder that it was saved in, or of the package's own.

    Nothing is computed anew, and nothing is proven: `verify` checks a folder.

    Parameters
    ----------
    folder : path or name
        Written by `Identification.save` or ``sdpid identify --out``; or the name of a robot that
        comes with the package identified, such as ``"panda"`` (``sdpid robots`` lists them).

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
    >>> sdpid.load("panda").model().mass_matrix(np.zeros(7)).shape
    (7, 7)
    """
    return SavedRun.of(folder)


@dataclass(frozen=True, kw_only=True, repr=False)
class RunComparison(Shown):
    """Two runs against each other.

    Attributes
    ----------
    folders : (str, str)
        The first and the other, which are called so where they are in no folder.
    facts : Table
        What each was given, asked and chosen, its errors on what was held out, in motion, and its
        cost and proof.
    differences : Table
        Those facts that differ.
    parameters : Table
        Base parameters with their differences, and what the intervals of both allow.
    same_log : bool or None
        Whether both were fitted to the same log; None where the files do not say.
    outside : tuple of str
        Base parameters that differ by more than their intervals together; none where the runs
        share data.
    notes : tuple of str
        What to know, one sentence each.
    """

    folders: tuple[str, str]
    facts: Table
    parameters: Table
    same_log: bool | None
    notes: tuple[str, ...]

    def _shown(self) -> dict[str, object]:
        first, other = self.folders
        notes = " ".join(self.notes)
        return {"same log": self.same_log, "first": first, "other": other, "notes": notes}

    def _tables(self) -> Iterator[Table]:
        return iter((self.differences, self.parameters))

    @property
    def differences(self) -> Table:
        """Those facts that differ."""
        return replace(self.facts, rows=tuple(row for row in self.facts.rows if row[1] != row[2]))

    @property
    def outside(self) -> tuple[str, ...]:
        """Base parameters that differ by more than their intervals; empty where data are shared."""
        return tuple(str(row[0]) for row in self.parameters.rows if row[-1])

    def text(self, *, full: bool = True) -> str:
        """Return everything as text; not in full what differs and what it means."""
        outside = tuple(row for row in self.parameters.rows if row[-1])
        tables = {
            "given, chosen and found differently": self.differences,
            "base parameters that differ": replace(self.parameters, rows=outside),
        }
        if full:
            tables = {"given, chosen and found": self.facts, "base parameters": self.parameters}
        parts = [f"first: {self.folders[0]}\nother: {self.folders[1]}"]
        for title, table in tables.items():
            body = table.text() if table.rows else "nothing"
            parts.append(f"{title}\n  " + body.replace("\n", "\n  "))
        return "\n\n".join([*parts, "\n".join(self.notes)])

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON: tables as lists of rows by name."""
        more = {"differences": self.differences, "outside": self.outside}
        return plain_dict({**vars(self), **more})


def compare_runs(first: Saved, other: Saved) -> RunComparison:
    """Compare two results of `identify`, as their files say them.

    Parameters
    ----------
    first, other : Identification, SavedRun or path
        Results, or the folders that they were saved in, of one robot.

    Returns
    -------
    RunComparison
        ``.text()``, ``.to_dict()``.

    Raises
    ------
    DataError
        When a folder is none, or they are of different robots.
    """
    runs = {"first": SavedRun.of(first), "other": SavedRun.of(other)}
    a, b = runs.values()
    names = (str(a.folder or "first"), str(b.folder or "other"))
    joints = [", ".join(run.result["problem"]["joints"]) for run in (a, b)]
    if joints[0] != joints[1]:
        raise DataError(
            f"compare: the joints of {names[0]} are {joints[0]}, those of {names[1]} {joints[1]}; "
            "compare runs of one robot."
        )
    logs = [{digest for _, digest in (run.inputs or {}).get("log", ())} for run in (a, b)]
    known = a.inputs is not None and b.inputs is not None
    untested = None
    if not known:
        untested = "a folder has no manifest, so that whether the logs are the same is not known"
    elif logs[0] & logs[1]:
        untested = (
            "both were fitted to the same data, at least in part, and their errors are not "
            "independent"
        )
    elif a.intervals != b.intervals or None in a.intervals:
        kinds = (f"{method or 'none'} at {level}" for method, level in (a.intervals, b.intervals))
        untested = f"their intervals are of two kinds, or there are none ({' and '.join(kinds)})"
    facts = tuple(
        (name, *(_cell(run.facts.get(name)) for run in (a, b))) for name in a.facts | b.facts
    )
    parameters, notes = _parameters(runs, untested)
    return RunComparison(
        folders=names,
        facts=Table(("what", *runs), facts),
        parameters=parameters,
        same_log=a.facts.get(_LOG) == b.facts.get(_LOG) if known else None,
        notes=tuple(notes),
    )


def _cell(value: Any) -> object:
    """Return a value as a cell."""
    if isinstance(value, list):
        return ", ".join(map(str, value))
    return value if value is None or isinstance(value, float) else str(value)


def _parameters(runs: Mapping[str, SavedRun], untested: str | None) -> tuple[Table, list[str]]:
    """Return the base parameters of both runs with their differences, and sentences on them."""
    frames = {which: run.to_frame().reset_index(names="parameter") for which, run in runs.items()}
    # What is regrouped has the same name and is another parameter.
    keys = ["parameter", "unit", "expression"]
    both = frames["first"].merge(frames["other"], on=keys, suffixes=("", " of other"))
    ends = ["value", "lower", "upper"]
    one, two = (both[[f"{end}{of}" for end in ends]].to_numpy(float).T for of in ("", " of other"))
    difference = two[0] - one[0]
    # The ends that face each other; squares of half widths add up, as of independent errors.
    facing = np.where(difference > 0.0, (one[2], two[1]), (one[1], two[2]))
    allowed = np.hypot(*(facing - (one[0], two[0])))
    differ = (np.abs(difference) > allowed) & (untested is None)
    columns = {
        "parameter": both["parameter"],
        "unit": both["unit"],
        "first": one[0],
        "other": two[0],
        "difference": difference,
        "allowed": allowed,
        "verdict": np.where(differ, "differs", ""),
    }
    sentences = [f"Differences of parameters are not tested: {untested}."]
    if not untested:
        tested = int(np.count_nonzero(np.isfinite(allowed)))
        told = f" ({listed(map(str, both['parameter'][differ]), 6)})" if differ.any() else ""
        chance = (1.0 - float(runs["first"].intervals[1])) * tested
        sentences = [
            f"Of {tested} base parameters with intervals in both, {differ.sum()}{told} differ "
            f"by more than these allow; about {chance:.2g} would by chance.",
            _NO_JOINT_TEST,
        ]
    for which, run in runs.items():
        alone = ", ".join(name for name in run.base if name not in {*both["parameter"]})
        if alone:
            sentences.append(f"In the {which} alone, or regrouped: {alone}.")
    return Table.of_columns(columns), sentences
