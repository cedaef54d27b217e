"""Compare the files of parameters with the certificate: every number to the last digit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

from sdpid.verifier.bound import Proof
from sdpid.verifier.exact import product
from sdpid.verifier.reading import REFUSED, MalformedError, items, numbers, parse, read_bytes
from sdpid.workflow.replay.compare import Link, by_file, checked, differences, read_table

RESULT, PARAMETERS = "result.json", "parameters.json"
TABLES = {"parameters.csv": "standard", "base_parameters.csv": "base"}

# Costs are sums of squares, computed in floating point from numbers of up to some 1e6 times their
# size.
_ROUNDING = Fraction(1e-9)

# Robots, which result.json lists.
ROBOTS = URDF, MJCF = "identified.urdf", "identified.xml"


def check_numbers(
    folder: Path, files: Mapping[str, Any], data: Mapping[str, Any], holds: bool
) -> list[Link]:
    """Check the files that repeat numbers of a certificate.

    Parameters
    ----------
    folder : Path
        The folder.
    files : mapping
        The files that its manifest lists.
    data : mapping
        The certificate, which makes sense.
    holds : bool
        Whether it proves what it claims.
    """
    found, written, proof = list[Link](), list[str](), Proof(dict(data))
    try:
        exports = items(parse(read_bytes(folder / RESULT))["exports"], "exports")
        written = [each["file"] for each in exports]
    except (OSError, *REFUSED):
        # Told below, where the file is compared; no robot that is there is of it.
        pass
    parameters: dict[str, dict[str, float] | None] = {"standard": None, "base": None}
    if data["theta"] is not None:
        # Base parameters are the doubles nearest to B·theta.
        nearest = product(data["problem"]["base_matrix"], data["theta"])
        for kind, names, values in (
            ("standard", "theta_names", data["theta"]),
            ("base", "base_names", nearest),
        ):
            parameters[kind] = dict(zip(data["origin"][names], map(float, values), strict=True))
    said = "the numbers are the certificate's, to the last digit"
    for name in (RESULT, PARAMETERS, *TABLES, *ROBOTS):
        if name not in files:
            if name not in ROBOTS or name in written or (folder / name).exists():
                found.append(Link(name, "not made again", "it is a result, and not sealed"))
        elif name in TABLES:
            check = partial(_of_table, folder / name, parameters[TABLES[name]])
            found += checked(name, check, said)
        elif name not in ROBOTS:
            check = partial(_of_json, folder / name, data, proof, parameters, holds)
            found += checked(name, check, said)
        elif name not in written:
            text = f"{RESULT} does not name it among what was written"
            found.append(Link(name, "not made again", text))
    return by_file(found)


def _of_table(path: Path, wanted: Mapping[str, float] | None) -> Iterator[str]:
    """Yield which values of a table are not the certificate's, as they are written."""
    header, *rows = read_table(read_bytes(path))
    name, value = header.index("parameter"), header.index("value")
    found = {row[name]: row[value] for row in rows}
    blank = dict.fromkeys(found, "")
    texts = blank if wanted is None else {key: repr(x) for key, x in wanted.items()}
    yield from differences(found, texts)


def _of_json(
    path: Path,
    certificate: Mapping[str, Any],
    proof: Proof,
    parameters: Mapping[str, Any],
    holds: bool,
) -> Iterator[str]:
    """Yield what in a file is not as the certificate has it."""
    data, claims, origin = parse(read_bytes(path)), certificate["claims"], certificate["origin"]
    wanted = {"certificate": certificate["sha256"], "cost_at_most": claims["cost"]}
    if path.name == RESULT:
        wanted |= {key: claims[key] for key in ("lower_bound", "gap")}
        own = {key: data[f"{key}_parameters"] for key in parameters}
        if data["certified"] is not False and not holds:
            yield "it says 'certified', and the certificate does not hold"
    else:
        wanted |= {key: origin[key] for key in ("robot", "joints", "weighting")}
        wanted["consistency"] = certificate["problem"]["consistency"]
        wanted["links"] = {str(k): link for k, link in enumerate(origin["links"], 1)}
        own = {key: _values(data[key], key) for key in parameters}
    found = {key: data[key] for key in wanted} | own
    yield from differences(found, wanted | dict(parameters), within=0.0)
    if proof.theta is not None and not proof.broken:
        off = abs(Fraction(numbers(data["cost"])) - proof.cost)
        if off > _ROUNDING * max(proof.cost, proof.scale):
            cost = float(proof.cost)
            yield f"cost is {data['cost']!r}, that of the certified parameters {cost!r}"


def _values(given: Any, key: str) -> dict[str, Any] | None:
    """Return the values of parameters by name."""
    if given is None:
        return None
    if type(given) is not dict:
        raise MalformedError(f"{key} is no object")
    return {name: given[name]["value"] for name in given}
