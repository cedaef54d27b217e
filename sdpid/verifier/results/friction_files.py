"""Check files of friction: their numbers are the certificate's, and their code follows from these.

The file is written again from the certified parameters, and must be the same to the byte. Only
what no certificate states is taken from it: the widths and speeds of the terms.
"""

from __future__ import annotations

from typing import Any

from ..reading import MalformedError, parse, require_schema, shown
from ..result import Result
from .friction_code import MARK, WRITERS
from .friction_terms import GRAVITY, SCHEMA, VERSION, checked, parameters
from .parameters import Certified

NAMES = {f"identified_friction{suffix}": suffix for suffix in WRITERS}

_UNCHECKED = "kinds of sign and peak, widths, dead zones, exponents and speeds of the terms"


def check(content: bytes, certified: Certified, suffix: str) -> Result:
    """Check a file, of which the suffix says the language."""
    data = _described(content)
    joints = certified.stated["joints"]
    wanted = {
        "robot": certified.stated["robot"],
        "certificate": certified.digest,
        "joints": joints[len(joints) - len(data["joints"]) :],
    }
    problems = [
        f"{key} is not that of the certificate" for key, own in wanted.items() if data[key] != own
    ]
    values = dict(certified.theta or {})
    links = 10 * len(certified.stated["links"])
    missing = dict.fromkeys(list(values)[links:])
    for term in data["terms"]:
        own = parameters(term, len(data["joints"]))
        for name, value in zip(own, term["values"], strict=True):
            if missing.pop(name, 0) == 0:
                problems.append(f"parameter {shown(name)} is none of the certificate, or is twice")
            elif value != values[name]:
                problems.append(
                    f"parameter {shown(name)} is {value!r}, the certificate has {values[name]!r}"
                )
    left_out = {name for each in data["left_out"] for name in GRAVITY[each]}
    problems += [f"parameter {shown(name)} is not in it" for name in missing.keys() ^ left_out]
    if content != WRITERS[suffix](data).encode("ascii"):
        problems.append("its code is not what follows from its numbers")
    if problems:
        return Result((), tuple(problems), (_UNCHECKED,))
    said = "the numbers are the certificate's, to the last digit, and the code follows from them."
    return Result((said,), (), (_UNCHECKED,))


def _described(content: bytes) -> dict[str, Any]:
    """Return the numbers that stand in a line of a file as JSON."""
    mark = MARK.encode("ascii")
    marks = tuple(sign + mark for sign in (b"# ", b"// "))
    lines = [line for line in content.splitlines() if line.startswith(marks)]
    if len(lines) != 1:
        raise MalformedError(f"{len(lines)} of its lines have its numbers, expected one")
    data = parse(lines[0].partition(mark)[2])
    require_schema(data, SCHEMA, VERSION)
    return checked(data)
