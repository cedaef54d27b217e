"""Compare files of parameters with a certificate: every number to the last digit."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from ..certificate import Proof
from ..exact import product
from ..reading import MalformedError, items, numbers, parse, require_keys, shown
from ..result import Result
from .markup import number

# Differences of one file that are told one by one; more say no more.
_MOST = 20

# Costs are sums of squares, computed in floating point from numbers of up to some 1e6 times their
# size.
_ROUNDING = Fraction(1e-9)

_KEYS = (
    *("format", "version", "made_by", "robot", "joints", "links", "frames", "method", "status"),
    *("consistency", "weighting", "cost", "cost_at_most", "certificate", "friction_terms"),
    *("effects", "interval_method", "interval_level", "standard", "base"),
)


@dataclass(frozen=True)
class Certified:
    """What a certificate states, in the form in which other files repeat it.

    Attributes
    ----------
    digest : str
        The certificate's.
    stated : mapping
        Robot, joints, links, consistency and weighting.
    claims : mapping
        Cost, lower bound and gap.
    theta, base : mapping of str to float, or None
        The parameters by name. Base parameters are the doubles nearest to B·theta.
    cost, scale : Fraction
        The compressed cost of theta, and the least that differences of it are relative to.
    """

    digest: str
    stated: Mapping[str, Any]
    claims: Mapping[str, Any]
    theta: Mapping[str, float] | None
    base: Mapping[str, float] | None
    cost: Fraction | None
    scale: Fraction

    @classmethod
    def of(cls, data: Mapping[str, Any], proof: Proof) -> Certified:
        """Return what a certificate that was checked states."""
        origin, problem = data["origin"], data["problem"]
        stated = {key: origin[key] for key in ("robot", "joints", "links", "weighting")}
        theta = base = None
        if data["theta"] is not None:
            values = [float(value) for value in data["theta"]]
            nearest = map(float, product(problem["base_matrix"], values))
            theta = dict(zip(origin["theta_names"], values, strict=True))
            base = dict(zip(origin["base_names"], nearest, strict=True))
        claims = {key: data["claims"][key] for key in ("cost", "lower_bound", "gap")}
        return cls(
            digest=data["sha256"],
            stated={**stated, "consistency": problem["consistency"]},
            claims=claims,
            theta=theta,
            base=base,
            cost=None if theta is None or proof.broken else proof.compressed_cost,
            scale=proof.scale,
        )


def check_parameters(content: bytes, certified: Certified) -> Result:
    """Check parameters.json."""
    data = require_keys(parse(content), _KEYS, "it")
    links = {str(k): link for k, link in enumerate(certified.stated["links"], 1)}
    wanted = {
        **certified.stated,
        "links": links,
        "certificate": certified.digest,
        "cost_at_most": certified.claims["cost"],
    }
    problems = [*_unlike(data, wanted), *_other_cost(data["cost"], certified)]
    for key, values in (("standard", certified.theta), ("base", certified.base)):
        given = data[key]
        if given is not None and type(given) is not dict:
            raise MalformedError(f"{key} is no object")
        found = None if given is None else {name: given[name]["value"] for name in given}
        problems += _other_values(found, values, f"{key} parameter")
    return _result(problems, "intervals, standard errors, shares, units and expressions")


def check_result(content: bytes, certified: Certified, holds: bool) -> Result:
    """Check result.json, which may say `certified` where the certificate's proof holds."""
    data = parse(content)
    claims = {key: certified.claims[key] for key in ("lower_bound", "gap")}
    wanted = {**claims, "cost_at_most": certified.claims["cost"], "certificate": certified.digest}
    problems = [*_unlike(data, wanted), *_other_cost(data["cost"], certified)]
    if data["certified"] is not False and not holds:
        problems.append("it says 'certified', and the certificate does not hold")
    for key, values in (
        ("standard_parameters", certified.theta),
        ("base_parameters", certified.base),
    ):
        problems += _other_values(data[key], values, key.replace("_", " ")[:-1])
    return _result(problems, "errors of prediction, intervals, findings and words")


def exports(content: bytes) -> list[str]:
    """Return the robots that result.json says were written."""
    return [entry["file"] for entry in items(parse(content)["exports"], "exports")]


def check_table(content: bytes, values: Mapping[str, float] | None) -> Result:
    """Check the columns `parameter` and `value` of a CSV table."""
    try:
        rows = list(csv.reader(io.StringIO(content.decode("utf-8"), newline=""), strict=True))
    except csv.Error as cause:
        raise MalformedError(f"it is no CSV ({shown(str(cause))})") from None
    header = rows[0]
    if len(set(header)) != len(header):
        raise MalformedError("two of its columns have the same name")
    name, value = header.index("parameter"), header.index("value")
    if any(len(row) != len(header) for row in rows):
        raise MalformedError("its rows have not as many fields as its header")
    if len({row[name] for row in rows[1:]}) != len(rows) - 1:
        raise MalformedError("two of its rows have the same name")
    found = {row[name]: number(row[value]) if row[value] else None for row in rows[1:]}
    if values is None:
        found_or_none = None if not any(v is not None for v in found.values()) else found
        return _result(_other_values(found_or_none, None, "parameter"), "the other columns")
    return _result(_other_values(found, values, "parameter"), "the other columns")


def _unlike(data: Mapping[str, Any], wanted: Mapping[str, Any]) -> list[str]:
    """Return the entries that are not those of the certificate."""
    return [
        f"{key} is {_short(data[key])}, the certificate has {_short(value)}"
        for key, value in wanted.items()
        if type(data[key]) is not type(value) or data[key] != value
    ]


def _other_values(found: Any, wanted: Mapping[str, float] | None, what: str) -> list[str]:
    """Return the parameters, in order, that are not those of the certificate."""
    if found is None or wanted is None:
        same = found is None and wanted is None
        return [] if same else [f"it has other {what}s than the certificate: one has none"]
    if list(found) != list(wanted):
        names = sorted(found.keys() ^ wanted.keys())
        which = ", ".join(map(shown, names[:_MOST])) or "their order"
        return [f"its {what}s are not those of the certificate: {which}"]
    return [
        f"{what} {shown(name)} is {_short(found[name])}, the certificate has {value!r}"
        for name, value in wanted.items()
        if type(found[name]) not in (int, float) or found[name] != value
    ]


def _other_cost(found: Any, certified: Certified) -> list[str]:
    """Return that a compressed cost, computed in floating point, is not the exact one."""
    if certified.cost is None:
        return []
    cost = Fraction(numbers(found))
    if abs(cost - certified.cost) <= _ROUNDING * max(certified.cost, certified.scale):
        return []
    return [f"cost is {found!r}, that of the certified parameters {float(certified.cost)!r}"]


def _short(value: Any) -> str:
    """Return a value for a sentence."""
    if type(value) in (int, float, bool) or value is None:
        return f"{value!r:.40}"
    return shown(value if type(value) is str else repr(value))


def _result(problems: Sequence[str], others: str) -> Result:
    if not problems:
        return Result(("the numbers are the certificate's, to the last digit.",), (), (others,))
    more = [f"{len(problems) - _MOST} other differences"] if len(problems) > _MOST else []
    return Result((), (*problems[:_MOST], *more), (others,))
