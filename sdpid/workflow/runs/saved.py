"""A results folder of `sdpid identify`, read from its files alone."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.files import load_toml
from sdpid.errors import DataError
from sdpid.robot.inertia import PARAMETER_NAMES
from sdpid.verifier.reading import REFUSED, numbers, parse, read_bytes, text

# Bytes of a file that is read: result.json of an arm has 0.1 MB.
_LIMIT = 32 * 2**20

# The prediction of the run itself among those of what was held out.
OURS = "this estimate"

# Options that say where files go or what is printed, not what is computed; the logs and the robot
# are told apart by their hashes.
_NOT_COMPUTED = frozenset({"out", "figures", "verbose", "json", "quiet", "log", "validation"})


@dataclass(frozen=True)
class BaseParameter:
    """A base parameter of a run.

    Attributes
    ----------
    value : float
        Its value.
    unit, expression : str
        Its unit, and what standard parameters it is made of.
    lower, upper : float or None
        Its interval; None where the run has none.
    """

    value: float
    unit: str
    expression: str
    lower: float | None
    upper: float | None


@dataclass(frozen=True, eq=False)
class SavedRun:
    """What the files of a run say.

    Attributes
    ----------
    folder : Path
        The folder.
    result : dict
        Content of result.json.
    inputs : dict of str to tuple of (str, str), or None
        Names and SHA-256 of the files of each role; None without a manifest.
    processing : dict or None
        Settings of the processing; None without a recipe.
    options : dict or None
        Options of the command; None without run.toml.
    intervals : (str or None, float or None)
        Method and level of the intervals.
    base : dict of str to BaseParameter
        Base parameters.
    bodies : dict of str to ndarray, shape (10,)
        Standard parameters of each link.
    """

    folder: Path
    result: dict[str, Any]
    inputs: dict[str, tuple[tuple[str, str], ...]] | None
    processing: dict[str, Any] | None
    options: dict[str, Any] | None
    intervals: tuple[Any, Any]
    base: dict[str, BaseParameter]
    bodies: dict[str, Array]

    @classmethod
    def read(cls, folder: str | os.PathLike[str]) -> SavedRun:
        """Read a folder that `Identification.save` wrote.

        Raises
        ------
        DataError
            When it is none, or a file of it cannot be understood.
        """
        path = Path(folder)
        if not path.is_dir():
            raise DataError(f"{path}: is no folder; give one that sdpid identify --out wrote.")
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
            recipe = manifest and manifest["recipe"]
            return cls(
                folder=path,
                result=_checked(result),
                inputs=None if manifest is None else _inputs(manifest),
                processing=dict(recipe["processing"]) if recipe else None,
                options=options,
                intervals=(parameters["interval_method"], parameters["interval_level"]),
                base={name: _base(entry) for name, entry in parameters["base"].items()},
                bodies=_bodies(parameters),
            )
        except REFUSED as cause:
            raise DataError(
                f"{path}: its files are not as sdpid identify writes them ({cause!r:.120}); "
                "`sdpid verify` names the file that was changed."
            ) from None

    def files(self, role: str) -> tuple[str, ...]:
        """Return the SHA-256 of the files of a role, in their order."""
        return tuple(digest for _, digest in (self.inputs or {}).get(role, ()))

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


def _base(entry: Mapping[str, Any]) -> BaseParameter:
    ends = entry.get("interval") or (None, None)
    lower, upper = (None if end is None else numbers(end) for end in ends)
    return BaseParameter(
        numbers(entry["value"]), str(entry["unit"]), str(entry["expression"]), lower, upper
    )


def _bodies(parameters: Mapping[str, Any]) -> dict[str, Array]:
    """Return the ten parameters of each link; none where the method has no standard parameters."""
    standard = parameters.get("standard") or {}
    found = {}
    for number, link in parameters["links"].items():
        names = [f"{name}_{number}" for name in PARAMETER_NAMES]
        if all(name in standard for name in names):
            found[str(link)] = np.array([numbers(standard[name]["value"]) for name in names])
    return found
