"""Compare the files of parameters with the certificate: every number to the last digit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

from sdpid.verifier.bound import Proof
from sdpid.verifier.exact import product
from sdpid.verifier.reading import REFUSED, MalformedError, items, numbers, parse, read_bytes, shown
from sdpid.workflow.replay.compare import MOST, differences, read_table
from sdpid.workflow.replay.links import Link, State, by_file

RESULT, PARAMETERS = "result.json", "parameters.json"
TABLES = {"parameters.csv": "standard", "base_parameters.csv": "base"}

# Costs are sums of squares, computed in floating point from numbers of up to some 1e6 times their
# size.
_ROUNDING = Fraction(1e-9)

# Robots, which result.json lists.
ROBOTS = URDF, MJCF = "identified.urdf", "identified.xml"


class Certified:
    """What a certificate that was checked states, in the form in which other files repeat it.

    Attributes
    ----------
    standard, base : mapping of str to float, or None
        The parameters by name. Base parameters are the doubles nearest to B·theta.
    """

    def __init__(self, data: Mapping[str, Any], holds: bool) -> None:
        self.data, self.proof, self.holds = data, Proof(dict(data)), holds
        origin, theta = data["origin"], data["theta"]
        self.standard = self.base = None
        if theta is not None:
            nearest = map(float, product(data["problem"]["base_matrix"], theta))
            self.standard = dict(zip(origin["theta_names"], map(float, theta), strict=True))
            self.base = dict(zip(origin["base_names"], nearest, strict=True))

    def check(self, name: str, content: bytes) -> Iterator[str]:
        """Yield what in a file is not as the certificate has it."""
        if name in TABLES:
            yield from self._table(content, getattr(self, TABLES[name]))
            return
        data, claims, origin = parse(content), self.data["claims"], self.data["origin"]
        wanted = {"certificate": self.data["sha256"], "cost_at_most": claims["cost"]}
        if name == RESULT:
            wanted |= {key: claims[key] for key in ("lower_bound", "gap")}
            found = {key: data[f"{key}_parameters"] for key in ("standard", "base")}
            if data["certified"] is not False and not self.holds:
                yield "it says 'certified', and the certificate does not hold"
        else:
            wanted |= {key: origin[key] for key in ("robot", "joints", "weighting")}
            wanted["consistency"] = self.data["problem"]["consistency"]
            wanted["links"] = {str(k): link for k, link in enumerate(origin["links"], 1)}
            found = {key: _values(data[key], key) for key in ("standard", "base")}
        wanted |= {"standard": self.standard, "base": self.base}
        yield from differences(
            {**{key: data[key] for key in wanted if key not in found}, **found}, wanted, within=0.0
        )
        if (cost := self._cost()) is not None:
            off = abs(Fraction(numbers(data["cost"])) - cost)
            if off > _ROUNDING * max(cost, self.proof.scale):
                yield f"cost is {data['cost']!r}, that of the certified parameters {float(cost)!r}"

    def _cost(self) -> Fraction | None:
        """Return the compressed cost of theta."""
        return None if self.proof.theta is None or self.proof.broken else self.proof.cost

    def _table(self, content: bytes, wanted: Mapping[str, float] | None) -> Iterator[str]:
        """Yield which values of a table are not the certificate's, as they are written."""
        header, *rows = read_table(content)
        name, value = header.index("parameter"), header.index("value")
        found = {row[name]: row[value] for row in rows}
        texts = (
            dict.fromkeys(found, "") if wanted is None else {k: repr(x) for k, x in wanted.items()}
        )
        yield from differences(found, texts)


def _values(given: Any, key: str) -> dict[str, Any] | None:
    """Return the values of parameters by name."""
    if given is None:
        return None
    if type(given) is not dict:
        raise MalformedError(f"{key} is no object")
    return {name: given[name]["value"] for name in given}


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
    certified, found = Certified(data, holds), list[Link]()

    def add(name: str, state: State, *texts: str) -> None:
        found.extend(Link(name, state, each) for each in texts)

    try:
        written = [
            e["file"] for e in items(parse(read_bytes(folder / RESULT))["exports"], "exports")
        ]
    except (OSError, *REFUSED) as cause:
        written = []
        add(RESULT, "not made again", f"the robots it names cannot be read: {reason(cause)}")
    for name in (RESULT, PARAMETERS, *TABLES, *ROBOTS):
        if name not in files:
            if name not in ROBOTS or name in written or (folder / name).exists():
                add(name, "not made again", "it is a result, and not sealed")
        elif name in ROBOTS:
            if name not in written:
                add(name, "not made again", f"{RESULT} does not name it among what was written")
        else:
            try:
                wrong = list(certified.check(name, read_bytes(folder / name)))
            except (OSError, *REFUSED) as cause:
                wrong = [f"cannot be read: {reason(cause)}"]
            add(name, "not made again", *wrong[:MOST])
            if len(wrong) > MOST:
                add(name, "not made again", f"{len(wrong) - MOST} other differences")
            if not wrong:
                add(name, "made again", "the numbers are the certificate's, to the last digit")
    return by_file(found)


def reason(cause: BaseException) -> str:
    """Return why something cannot be read; what is no message of ours is shown as a name."""
    if isinstance(cause, MalformedError):
        return str(cause)
    return f"{type(cause).__name__} {shown(str(cause))}"
