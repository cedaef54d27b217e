"""Write friction as Python and as C++: small files that need nothing of sdpid.

A URDF has no place for most of it. The text follows from the numbers alone, so that whoever holds
these can write it again and compare. Names of robots and joints are of others: they stand in
literals and in JSON, as ASCII, and nowhere else.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.files import atomic_write_text
from sdpid.assurance.certificate.certificate import Certificate
from sdpid.errors import ExportError, ModelError
from sdpid.estimation.estimate import Estimate
from sdpid.output.robots.friction_terms import KINDS, PARTS, SCHEMA, VERSION, Language, summands
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.posed import LoadFriction, Tilt
from sdpid.robot.friction.stored import term_to_dict
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.friction.terms import Coupling
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.verifier.reading import MalformedError, parse, require_schema

_PYTHON = Language("_", "..., ")
_CPP = Language("detail::", "")

# The line that has the numbers as JSON, after the mark of a comment.
MARK = "sdpid-friction: "

# Characters that stand for themselves in any literal.
_PLAIN = re.compile(r"[A-Za-z0-9_ .-]")

# What the functions of the files return.
_RETURNED = {
    "friction": "friction and offsets",
    "drives": "the efforts that accelerate the rotors",
    "load": "friction that grows with load",
}

_ABOUT = (
    "Joint friction as sdpid identified it; made by a program, not to be edited.",
    "",
    "To be added to the efforts of the rigid links, such as those of the URDF beside it.",
    "Velocities in rad/s, accelerations in rad/s^2, efforts in N.m; of sliding joints in m/s,",
    "m/s^2 and N. A load is the effort that moves and carries the rigid links at the joint.",
)
_TILT = (
    "",
    "Not in it is the tilt of the base that was identified: turn gravity to have it.",
)


def _about(data: Mapping[str, Any]) -> tuple[str, ...]:
    return (*_ABOUT, *(_TILT if "Tilt" in data["left_out"] else ()))


def _json(data: Mapping[str, Any]) -> str:
    """Return the numbers in one line of ASCII, which no language reads across."""
    return MARK + json.dumps(data, allow_nan=False)


def _sums(data: Mapping[str, Any], language: Language) -> dict[tuple[str, int], list[list[str]]]:
    """Return of every part and joint the summands and the parameters that they are of."""
    found: dict[tuple[str, int], list[list[str]]] = {}
    for part, joint, parameter, expression in summands(data, language):
        found.setdefault((part, joint), []).append([expression, parameter])
    return found


def python(data: Mapping[str, Any]) -> str:
    """Return the file as Python, which needs NumPy."""
    sums, n = _sums(data, _PYTHON), len(data["joints"])
    lines = [f'"""{_ABOUT[0]}', *_about(data)[1:]]
    lines += ["", "Arrays hold one state, (n,), or many, (K, n), in the order of JOINTS.", '"""']
    lines += ["", "import numpy as np", ""]
    lines += [f"ROBOT = {data['robot']!a}", f"CERTIFICATE = {data['certificate']!a}"]
    lines += ["JOINTS = (", *(f"    {name!a}," for name in data["joints"]), ")", ""]

    def of(part: str, arguments: str, first: str) -> None:
        lines.extend(["", f"def {_NAMES[part]}({arguments}):"])
        lines.append(f'    """Return {_RETURNED[part]} of all joints."""')
        for argument in arguments.split(", "):
            lines.append(f"    {_SHORT[argument]} = _states({argument})")
        lines.append(f"    effort = np.zeros({first}.shape)")
        for k in range(n):
            if (summed := sums.get((part, k))) is not None:
                lines.append(f"    effort[..., {k}] = (")
                lines.extend(f"        {_plus(i)}{x}  # {p}" for i, (x, p) in enumerate(summed))
                lines.append("    )")
        lines.extend(["    return effort", ""])

    of("friction", "velocity", "v")
    of("drives", "acceleration", "a")
    of("load", "velocity, load", "v")
    return "\n".join([*lines, *_PYTHON_REST, "", f"# {_json(data)}", ""])


def cpp(data: Mapping[str, Any]) -> str:
    """Return the file as a C++11 header: no dependencies, no allocation."""
    sums, n = _sums(data, _CPP), len(data["joints"])
    numbers = _json(data)
    guard = f"SDPID_FRICTION_{hashlib.sha256(numbers.encode('ascii')).hexdigest()[:16].upper()}"
    lines = [f"// {line}".rstrip() for line in _about(data)]
    lines += [
        "//",
        "// Arrays have one entry a joint, in the order of joint_names; `effort` must not",
    ]
    lines += ["// overlap the others. For C++11 and later."]
    lines += [f"#ifndef {guard}", f"#define {guard}", "", *_CPP_FIRST]
    lines += ["", f"constexpr int joints = {n};"]
    lines += [f"constexpr const char* robot = {_literal(data['robot'])};"]
    lines += [f"constexpr const char* certificate = {_literal(data['certificate'] or '')};"]
    lines += ["constexpr const char* joint_names[joints] = {"]
    lines += [f"    {_literal(name)}," for name in data["joints"]]
    lines += ["};", "", *_CPP_DETAIL]

    def of(part: str, arguments: str) -> None:
        given = [_SHORT[each] for each in arguments.split(", ")]
        signature = ", ".join(f"const double* {each}" for each in given)
        lines.extend(["", f"// Writes {_RETURNED[part]} of all joints."])
        lines.append(f"inline void {_NAMES[part]}({signature}, double* effort) noexcept {{")
        body: list[str] = []
        for k in range(n):
            summed = sums.get((part, k))
            if summed is None:
                body.append(f"  effort[{k}] = 0.0;")
                continue
            body.append(f"  effort[{k}] = 0.0")
            body.extend(f"      + {x}  // {p}" for x, p in summed)
            body[-1] = body[-1].replace("  // ", ";  // ")
        unused = [each for each in given if not any(f"{each}[" in line for line in body)]
        lines.extend([*(f"  (void){each};" for each in unused), *body, "}"])

    of("friction", "velocity")
    of("drives", "acceleration")
    of("load", "velocity, load")
    lines += _CPP_LAST
    lines += ["", f"// {numbers}", "", f"#endif  // {guard}"]
    return "\n".join([*lines, ""])


# The functions of the files by part of the effort, and their arguments in short.
_NAMES = dict(zip(PARTS, ("friction", "drive_inertia", "load_friction"), strict=True))
_SHORT = {"velocity": "v", "acceleration": "a", "load": "load"}

WRITERS: dict[str, Callable[[Mapping[str, Any]], str]] = {".py": python, ".hpp": cpp}
NAMES: dict[str, str] = {f"identified_friction{suffix}": suffix for suffix in WRITERS}


def described(content: bytes) -> dict[str, Any]:
    """Return the object that stands in a line of a file as JSON, of which nothing is known."""
    mark = MARK.encode("ascii")
    marks = tuple(sign + mark for sign in (b"# ", b"// "))
    lines = [line for line in content.splitlines() if line.startswith(marks)]
    if len(lines) != 1:
        raise MalformedError(f"{len(lines)} of its lines have its numbers, expected one")
    data = parse(lines[0].partition(mark)[2])
    require_schema(data, SCHEMA, VERSION)
    return data


def _plus(place: int) -> str:
    return "+ " if place else ""


def _literal(name: str) -> str:
    """Return a C++ string literal of the UTF-8 of a name; no escape runs into what follows."""
    content = name.encode("utf-8", "surrogatepass")
    return '"' + "".join(c if _PLAIN.match(c := chr(x)) else f"\\{x:03o}" for x in content) + '"'


_PYTHON_REST = '''
def _states(values):
    """Return states (n,) or (K, n) as an array."""
    array = np.asarray(values, dtype=float)
    if array.ndim not in (1, 2) or array.shape[-1] != len(JOINTS):
        raise ValueError(f"states have shape {array.shape}, expected (..., {len(JOINTS)})")
    return array


_sign = np.sign
_tanh = np.tanh
_size = np.abs


def _outside(v, dead_zone, value):
    """Return a value, zero within the dead zone."""
    return np.where(np.abs(v) < dead_zone, 0.0, value)


def _ahead(x):
    """Return what is positive, else zero."""
    return np.maximum(x, 0.0)


def _back(x):
    """Return what is negative, else zero."""
    return np.minimum(x, 0.0)


def _root(v):
    """Return the signed square root of the speed."""
    return np.sign(v) * np.sqrt(np.abs(v))


def _peak(ratio, exponent):
    """Return the Stribeck peak about standstill."""
    return np.exp(-(np.minimum(np.abs(ratio), 1e3) ** exponent))
'''.splitlines()

_CPP_FIRST = """#include <cmath>

// Define another name where the headers of several robots are included.
#ifndef SDPID_FRICTION_NAMESPACE
#define SDPID_FRICTION_NAMESPACE identified_friction
#endif

namespace SDPID_FRICTION_NAMESPACE {
""".splitlines()

_CPP_LAST = """
}  // namespace SDPID_FRICTION_NAMESPACE
#undef SDPID_FRICTION_NAMESPACE""".splitlines()

_CPP_DETAIL = """namespace detail {

inline double sign(double x) { return x > 0.0 ? 1.0 : x < 0.0 ? -1.0 : x; }
inline double tanh(double x) { return std::tanh(x); }
inline double size(double x) { return std::fabs(x); }
inline double outside(double v, double dead_zone, double value) {
  return std::fabs(v) < dead_zone ? 0.0 : value;
}
inline double ahead(double x) { return x < 0.0 ? 0.0 : x; }
inline double back(double x) { return x > 0.0 ? 0.0 : x; }
inline double root(double v) { return sign(v) * std::sqrt(std::fabs(v)); }
inline double peak(double ratio, double exponent) {
  const double speed = std::fabs(ratio);
  return std::exp(-std::pow(speed > 1e3 ? 1e3 : speed, exponent));
}

}  // namespace detail""".splitlines()


def write_friction(
    estimate: Estimate | RobotDynamics,
    target: str | os.PathLike[str],
    *,
    certificate: Certificate | None = None,
) -> tuple[str, ...]:
    """Write friction, offsets, couplings and rotor inertias as Python or as a C++ header.

    The file needs nothing of sdpid: Python needs NumPy, the header C++11. Its ``friction`` is that
    of ``estimate.model()``; rotor inertias and friction of the load have functions of their own.

    Parameters
    ----------
    estimate : Estimate or RobotDynamics
        From any solver, or its model.
    target : str or path
        File to write, whole or not at all; the suffix, ``.py`` or ``.hpp``, is the language.
    certificate : Certificate, optional
        Of the estimate: its digest then stands in the file.

    Returns
    -------
    tuple of str
        What the file leaves out, in words: a tilt of the base. It says the tilted gravity.

    Raises
    ------
    ExportError
        For another suffix, a folder that cannot be written to, or a term of your own, whose code
        no file can hold.
    """
    path = Path(target)
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        raise ExportError(
            f"{target}: friction is written as {' or '.join(WRITERS)}; choose such a name."
        )
    model = estimate if isinstance(estimate, RobotDynamics) else estimate.model()
    data = friction_data(model, certificate=certificate)
    atomic_write_text(path, writer(data))
    if not data["left_out"]:
        return ()
    gravity = ", ".join(f"{x:.5g}" for x in model.tilted_gravity)
    return (
        f"{path.stem}: the tilt of the base is not in it, since gravity is the links': take "
        f"({gravity}) m/s² as gravity in the base",
    )


def friction_data(
    model: RobotDynamics, *, certificate: Certificate | None = None
) -> dict[str, Any]:
    """Return terms and parameters as plain values, the content of `write_friction`.

    Raises
    ------
    ExportError
        For a term that the files have no form of.
    """
    from sdpid import __version__

    return {
        "schema": SCHEMA,
        "version": VERSION,
        "software": f"sdpid {__version__}",
        "certificate": None if certificate is None else certificate.to_dict()["sha256"],
        "robot": model.robot.name,
        **terms_data(model.terms, model.theta[10 * model.robot.n_links :].tolist()),
    }


def terms_data(model: FrictionModel, values: list[float]) -> dict[str, Any]:
    """Return joints, terms with their parameters, and terms that are left out, as plain values.

    Raises
    ------
    ExportError
        For a term that the files have no form of.
    """
    names, terms, left_out = model.joint_names, [], []
    for term, own in model.placed:
        if type(term) is Tilt:
            left_out.append(type(term).__name__)
        else:
            terms.append(_plain(term, names, values[own]))
    return {"joints": list(names), "terms": terms, "left_out": left_out}


def _plain(term: FrictionTerm, names: tuple[str, ...], values: list[float]) -> dict[str, Any]:
    """Return a term with one of each setting a joint."""
    kind = type(term).__name__
    try:
        settings = term_to_dict(term)
    except ModelError as cause:
        raise ExportError(
            f"friction: {kind} is a term of your own, and no file has its code; leave it out, or "
            "use estimate.model().friction."
        ) from cause
    found: dict[str, Any] = {"term": kind}
    count = len(names)
    if isinstance(term, Coupling):
        found["joints"], count = [names.index(term.first), names.index(term.second)], 1
    if isinstance(term, LoadFriction) and not term.share:
        settings |= {"share": 0.0, "velocity": 1.0}
    for key in KINDS[kind].settings:
        found[key] = np.broadcast_to(np.asarray(settings[key], float), (count,)).tolist()
    return {**found, "values": values}
