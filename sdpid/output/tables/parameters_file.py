"""Parameters as JSON or YAML for other programs: values, units, errors, intervals, sources."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.extras import require
from sdpid._common.files import atomic_write_text, read_regular
from sdpid._common.tables import plain
from sdpid.assurance.certificate.certificate import Certificate
from sdpid.assurance.diagnostics.provenance import provenance
from sdpid.assurance.intervals.intervals import Intervals
from sdpid.errors import DataError, ExportError
from sdpid.estimation.estimate import Estimate
from sdpid.output.tables.parameter_tables import known_errors

FORMAT = "sdpid parameters"
VERSION = 1


def write_parameters(
    estimate: Estimate,
    path: str | os.PathLike[str],
    *,
    intervals: Intervals | None = None,
    certificate: Certificate | None = None,
) -> Path:
    """Write all parameters of an estimate as JSON or YAML, by the file's suffix.

    The file holds what was estimated and how, then ``standard`` and ``base`` parameters by name.
    Each has its ``value`` and ``unit``; standard ones the ``shares`` of data, physics and prior
    in them (`sdpid.assurance.diagnostics.provenance`); base ones their ``standard_error`` and what
    they stand for (``expression``); both an ``interval`` where one is given. What is not known is
    null.

    Parameters
    ----------
    estimate : Estimate
        From any solver; without standard parameters that part is null.
    path : str or path
        With the suffix ``.json``, ``.yaml`` or ``.yml`` (extra ``yaml``); written whole or not at
        all.
    intervals : Intervals, optional
        What has names, lower and upper ends (and, where it tells them apart, their kinds).
    certificate : Certificate, optional
        Of these parameters: the file then names its digest, and the cost that it proves.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ExportError
        For another suffix, or a folder that cannot be written to.
    MissingExtraError
        When YAML is asked and PyYAML is not installed.

    Examples
    --------
    >>> path = sdpid.write_parameters(estimate, "parameters.json")
    >>> path.name
    'parameters.json'
    >>> import json
    >>> content = json.loads(path.read_text(encoding="utf-8"))
    >>> content["standard"]["m_6"]["unit"], content["base"]["zzr1"]["unit"]
    ('kg', 'kg.m2')
    """
    target = Path(path)
    content = parameters_dict(estimate, intervals=intervals, certificate=certificate)
    if target.suffix.lower() == ".json":
        text = json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
    elif target.suffix.lower() in (".yaml", ".yml"):
        yaml = require("yaml", extra="yaml")
        text = yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=100)
    else:
        raise ExportError(
            f"{target}: parameters are written as .json, .yaml or .yml; choose such a name."
        )
    atomic_write_text(target, text)
    return target


def parameters_dict(
    estimate: Estimate,
    *,
    intervals: Intervals | None = None,
    certificate: Certificate | None = None,
) -> dict[str, Any]:
    """Return the content that `write_parameters` writes, as plain values."""
    from sdpid import __version__

    problem, base = estimate.problem, estimate.problem.base
    ends, robot = _ends(intervals), problem.robot
    standard: dict[str, Any] | None = None
    if estimate.theta is not None:
        shares = provenance(estimate).to_dict()
        rows = zip(base.theta_names, plain(estimate.theta), base.theta_units, strict=True)
        standard = {
            name: {"value": value, "unit": unit, "interval": ends.get((name, "standard"))}
            | {"shares": shares[name]}
            for name, value, unit in rows
        }
    errors = known_errors(estimate)
    of_base = zip(base.names, plain(estimate.base), base.units, errors, strict=True)
    return {
        "format": FORMAT,
        "version": VERSION,
        "made_by": f"sdpid {__version__}",
        "robot": robot.name,
        "joints": list(robot.joint_names),
        "links": {str(i): name for i, name in enumerate(robot.link_names, start=1)},
        "frames": "link parameters are about the origin and along the axes of the joint's frame",
        "method": estimate.method,
        "status": estimate.status,
        "consistency": problem.consistency,
        "weighting": problem.weighting,
        "cost": estimate.cost,
        "cost_at_most": None if certificate is None else certificate.cost,
        "certificate": None if certificate is None else certificate.to_dict()["sha256"],
        "friction_terms": problem.friction.described(),
        "effects": [asdict(each) for each in problem.origin.effects],
        "interval_method": getattr(intervals, "method", None),
        "interval_level": getattr(intervals, "level", None),
        "standard": standard,
        "base": {
            name: {"value": value, "unit": unit, "standard_error": error}
            | {"interval": ends.get((name, "base")), "expression": base.expression(name)}
            for name, value, unit, error in of_base
        },
    }


def _ends(intervals: Intervals | None) -> dict[tuple[str, str], list[float | None]]:
    """Return both ends of each interval by name and kind; one of no kind stands for both."""
    if intervals is None:
        return {}
    kinds: Sequence[str] = getattr(intervals, "kind", ("",) * len(intervals.names))
    out: dict[tuple[str, str], list[float | None]] = {}
    rows = zip(intervals.names, kinds, plain(intervals.lower), plain(intervals.upper), strict=True)
    for name, kind, *ends in rows:
        out[name, kind or "base"] = ends
        # A standard parameter that is a base parameter is listed once, as that.
        out.setdefault((name, "standard"), ends)
    return out


def read_parameters(path: str | os.PathLike[str]) -> dict[str, float]:
    """Read the standard parameters of a file that `write_parameters` wrote.

    Parameters
    ----------
    path : str or path
        JSON or YAML (extra ``yaml``), by its suffix.

    Returns
    -------
    dict of str to float
        Values in SI units by name, in the order of theta; base parameters where the file has no
        standard ones.

    Raises
    ------
    DataError
        When the file cannot be read, is none of ours, or a value is no finite number.
    MissingExtraError
        When it is YAML and PyYAML is not installed.

    Examples
    --------
    >>> path = sdpid.write_parameters(estimate, "parameters.json")
    >>> parameters = sdpid.read_parameters(path)
    >>> len(parameters), round(parameters["Fv1"])
    (72, 151)
    """
    source = Path(path)
    content = _content(source)
    if not isinstance(content, Mapping) or content.get("format") != FORMAT:
        raise DataError(f"{source}: is no file of parameters (it lacks 'format: {FORMAT}').")
    if content.get("version") != VERSION:
        raise DataError(
            f"{source}: has version {content.get('version')!r}, this release reads {VERSION}."
        )
    key = "base" if content.get("standard") is None else "standard"
    entries = content.get(key)
    if not isinstance(entries, Mapping) or not entries:
        raise DataError(f"{source}: '{key}' holds no parameters by name.")
    return {str(name): _value(entry, f"{source}: {key}, {name}") for name, entry in entries.items()}


def _content(source: Path) -> Any:
    try:
        text = read_regular(source).decode("utf-8-sig")
    except UnicodeDecodeError as cause:
        raise DataError(f"{source}: cannot be read ({cause}).") from None
    wrong: tuple[type[Exception], ...] = (ValueError, RecursionError)
    load, what = json.loads, "JSON"
    if source.suffix.lower() != ".json":
        yaml = require("yaml", extra="yaml")
        load, what, wrong = yaml.safe_load, "YAML", (*wrong, yaml.YAMLError)
    try:
        return load(text)
    except wrong as cause:
        reason = str(cause).replace("\n", " ")
        raise DataError(f"{source}: not {what} ({reason}).") from None


def _value(entry: Any, what: str) -> float:
    value: Any = entry.get("value") if isinstance(entry, Mapping) else entry
    try:
        # YAML takes numbers such as 1e-5, written by hand, for text.
        number = float("nan") if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = float("nan")
    if not np.isfinite(number):
        raise DataError(f"{what}: the value is {value!r}; give a finite number.")
    return number
