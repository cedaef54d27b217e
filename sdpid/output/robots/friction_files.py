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
from dataclasses import asdict, is_dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.files import atomic_write_text
from sdpid.assurance.certificate.certificate import Certificate
from sdpid.errors import ExportError
from sdpid.estimation.estimate import Estimate
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.posed import LoadFriction, PositionFriction, Tilt
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.friction.terms import CLASSES, Coupling, term_to_dict
from sdpid.robot.model.dynamics import RobotDynamics

SCHEMA, VERSION = "sdpid-friction", 1


# Of settings, links and the names of joints stand in no formula (`FrictionTerm.efforts`).
_NOT_IN_FORMULAS = {"bodies", "first", "second"}

# Far out a power may overflow; the Stribeck peak is zero long before.
_STEEPEST = 50.0

# The functions of the files: arguments by their short names, and what is returned.
_FUNCTIONS: dict[str, tuple[dict[str, str], str]] = {
    "friction": ({"v": "velocity"}, "friction and offsets"),
    "drive_inertia": ({"a": "acceleration"}, "the efforts that accelerate the rotors"),
    "load_friction": ({"v": "velocity", "load": "load"}, "friction that grows with load"),
    # Only where there is such friction, and a helper of it.
    "position_friction": ({"v": "velocity", "q": "position"}, "friction over position"),
}

# The line that has the numbers as JSON, after the mark of a comment.
_MARK = "sdpid-friction: "

# Characters that stand for themselves in any literal.
_PLAIN = re.compile(r"[A-Za-z0-9_ .-]")

# Of each function and joint, summands and the parameters that they are of.
_Sums = dict[str, list[list[tuple[str, str]]]]

# A function's name, and a place in an array.
_NAME, _PLACE = re.compile(r"[a-z]+(?=\()"), re.compile(r"(?<=\[)\d+(?=\])")


def sign(v: str, width: float, dead_zone: float) -> str:
    """Return the sign of a velocity, smooth where it has a width, zero in the dead zone."""
    found = f"tanh({v} / {width!r})" if width else f"sign({v})"
    return f"outside({v}, {dead_zone!r}, {found})" if dead_zone else found


def _effort(formula: str, k: int, v: str, settings: Mapping[str, float]) -> str:
    """Return the effort of a formula at joint k, with the sign of a velocity."""
    chosen: dict[str, Any] = dict(settings)
    chosen["sign"] = sign(v, chosen.get("width", 0.0), chosen.get("dead_zone", 0.0))
    if share := chosen.get("share"):
        slow = f"tanh({v} / {chosen['velocity']!r})"
        chosen["sign"] = f"({1.0 - share!r} * {chosen['sign']} + {share!r} * {slow})"
    if "exponent" in chosen:
        chosen["exponent"] = min(chosen["exponent"], _STEEPEST)
    return formula.format(v=f"v[{k}]", a=f"a[{k}]", load=f"load[{k}]", q=f"q[{k}]", **chosen)


def _sums(data: Mapping[str, Any], name: str, place: str) -> _Sums:
    """Return what each parameter adds to which joint in which function.

    `name` is how a language writes the functions of formulas, `place` a place in an array.
    """
    n = len(data["joints"])
    sums: _Sums = {function: [[] for _ in range(n)] for function in _FUNCTIONS}
    for term in data["terms"]:
        efforts = term.get("efforts") or CLASSES[term["term"]].efforts
        of_all = {key: term[key] for key in term.keys() - {"term", "efforts", "joints", "values"}}
        # Where friction acts: its parameters' ending, the joints that feel and make it, its speed.
        places: list[Any] = [(f"{k + 1}", ((k, k),), f"v[{k}]") for k in range(n)]
        if "joints" in term:
            i, j = term["joints"]
            places = [(f"{i + 1}_{j + 1}", ((i, j), (j, i)), f"(v[{i}] + v[{j}])")]
        every = product(efforts.items(), enumerate(places))
        for ((symbol, formula), (at, (ending, joints, v))), value in zip(
            every, term["values"], strict=True
        ):
            settings = {key: each[at] for key, each in of_all.items()}
            # Parameters that are zero add nothing.
            for own, other in joints if value != 0.0 else ():
                effort = _PLACE.sub(place, _NAME.sub(name, _effort(formula, other, v, settings)))
                text = f"{value!r} * {effort}" if effort else repr(value)
                sums[_function(formula)][own].append((text, symbol + ending))
    if not any(sums["position_friction"]):
        del sums["position_friction"]
    return sums


def _function(formula: str) -> str:
    """Return the function of the files that a formula belongs to."""
    if "{a}" in formula:
        return "drive_inertia"
    if "{q}" in formula:
        return "position_friction"
    return "load_friction" if "{load}" in formula else "friction"


def _json(data: Mapping[str, Any]) -> str:
    """Return the numbers in one line of ASCII, which no language reads across."""
    return _MARK + json.dumps(data, allow_nan=False)


_ABOUT = """\
Joint friction as sdpid identified it; made by a program, not to be edited.

To be added to the efforts of the rigid links, such as those of the URDF beside it.
Velocities in rad/s, accelerations in rad/s^2, efforts in N.m; of sliding joints in m/s,
m/s^2 and N. A load is the effort that moves and carries the rigid links at the joint.
"""
_TILT = """
Not in it is the tilt of the base that was identified: turn gravity to have it.
"""


def _about(data: Mapping[str, Any], more: str) -> list[str]:
    """Return the lines of what a file is."""
    tilt = _TILT if Tilt.__name__ in data["left_out"] else ""
    others = _others(data)
    lacks = f"\nNot in it (of positions, or behind a transmission): {', '.join(others)}.\n"
    return f"{_ABOUT}{tilt}{lacks if others else ''}\n{more}".splitlines()


def _others(data: Mapping[str, Any]) -> list[str]:
    """Return the terms that a file lacks, but for a tilt."""
    return [each for each in dict.fromkeys(data["left_out"]) if each != Tilt.__name__]


def python(data: Mapping[str, Any]) -> str:
    """Return the file as Python, which needs NumPy."""
    more = "Arrays hold one state, (n,), or many, (K, n), in the order of JOINTS."
    about = "\n".join(_about(data, more))
    lines = [f'"""{about}\n"""', "", "import numpy as np", ""]
    lines += [f"ROBOT = {data['robot']!a}", f"CERTIFICATE = {data['certificate']!a}"]
    lines += ["JOINTS = (", *(f"    {name!a}," for name in data["joints"]), ")", ""]
    every = _sums(data, r"_\g<0>", r"..., \g<0>")
    for function, sums in every.items():
        arguments, returned = _FUNCTIONS[function]
        lines += ["", f"def {function}({', '.join(arguments.values())}):"]
        lines.append(f'    """Return {returned} of all joints."""')
        lines += [f"    {short} = _states({given})" for short, given in arguments.items()]
        lines.append(f"    effort = np.zeros({next(iter(arguments))}.shape)")
        for k, summed in enumerate(sums):
            if summed:
                added = "\n        + ".join(f"{text}  # {name}" for text, name in summed)
                lines += [f"    effort[..., {k}] = (", f"        {added}", "    )"]
        lines += ["    return effort", ""]
    rest = _PYTHON_REST + _PYTHON_BEND * ("position_friction" in every)
    return "\n".join([*lines, rest, f"# {_json(data)}", ""])


def cpp(data: Mapping[str, Any]) -> str:
    """Return the file as a C++11 header: no dependencies, no allocation."""
    numbers = _json(data)
    guard = f"SDPID_FRICTION_{hashlib.sha256(numbers.encode('ascii')).hexdigest()[:16].upper()}"
    lines = [f"// {line}".rstrip() for line in _about(data, _CPP_ARRAYS)]
    lines += [f"#ifndef {guard}", f"#define {guard}", "", _CPP_FIRST]
    lines += [f"constexpr int joints = {len(data['joints'])};"]
    lines += [f"constexpr const char* robot = {_literal(data['robot'])};"]
    lines += [f"constexpr const char* certificate = {_literal(data['certificate'] or '')};"]
    lines += ["constexpr const char* joint_names[joints] = {"]
    lines += [*(f"    {_literal(name)}," for name in data["joints"]), "};", "", _CPP_DETAIL]
    every = _sums(data, r"detail::\g<0>", r"\g<0>")
    lines += [_CPP_BEND] * ("position_friction" in every)
    for function, sums in every.items():
        arguments, returned = _FUNCTIONS[function]
        signature = ", ".join(f"const double* {each}" for each in arguments)
        lines += ["", f"// Writes {returned} of all joints."]
        lines.append(f"inline void {function}({signature}, double* effort) noexcept {{")
        body: list[str] = []
        for k, summed in enumerate(sums):
            body.append(f"  effort[{k}] = 0.0" + ("" if summed else ";"))
            body += [f"      + {text}  // {parameter}" for text, parameter in summed]
            body[-1] = body[-1].replace("  // ", ";  // ")
        unused = [each for each in arguments if not any(f"{each}[" in line for line in body)]
        lines += [*(f"  (void){each};" for each in unused), *body, "}"]
    return "\n".join([*lines, _CPP_LAST, f"// {numbers}", "", f"#endif  // {guard}", ""])


WRITERS: dict[str, Callable[[Mapping[str, Any]], str]] = {".py": python, ".hpp": cpp}
NAMES: dict[str, str] = {f"identified_friction{suffix}": suffix for suffix in WRITERS}


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
'''

_PYTHON_BEND = '''

def _bend(q, low, high, a, b, c):
    """Return a parabola over a range, held beyond its ends, from its control values."""
    x = np.clip((q - low) / (high - low), 0.0, 1.0)
    return a * (1.0 - x) ** 2 + b * 2.0 * x * (1.0 - x) + c * x**2
'''

_CPP_BEND = """
namespace detail {

inline double bend(double q, double low, double high, double a, double b, double c) {
  const double y = (q - low) / (high - low);
  const double x = y < 0.0 ? 0.0 : y > 1.0 ? 1.0 : y;
  return a * (1.0 - x) * (1.0 - x) + b * 2.0 * x * (1.0 - x) + c * x * x;
}

}  // namespace detail"""

_CPP_ARRAYS = """\
Arrays have one entry a joint, in the order of joint_names; `effort` must not
overlap the others. For C++11 and later."""

_CPP_FIRST = """#include <cmath>

// Define another name where the headers of several robots are included.
#ifndef SDPID_FRICTION_NAMESPACE
#define SDPID_FRICTION_NAMESPACE identified_friction
#endif

namespace SDPID_FRICTION_NAMESPACE {
"""

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

}  // namespace detail"""

_CPP_LAST = """
}  // namespace SDPID_FRICTION_NAMESPACE
#undef SDPID_FRICTION_NAMESPACE
"""


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
        What the file leaves out, in words: a tilt of the base, of which it says the tilted
        gravity, and terms that depend on positions.

    Raises
    ------
    ExportError
        For another suffix, a folder that cannot be written to, or a term of your own without
        formulas (`FrictionTerm.efforts`).
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
    missing: tuple[str, ...] = ()
    if Tilt.__name__ in data["left_out"]:
        gravity = ", ".join(f"{x:.5g}" for x in model.tilted_gravity)
        missing += (
            f"{path.stem}: the tilt of the base is not in it, since gravity is the links': take "
            f"({gravity}) m/s² as gravity in the base",
        )
    if others := _others(data):
        missing += (
            f"{path.stem}: terms of positions and of joints behind a transmission are not in it: "
            f"{', '.join(others)}; take estimate.model()",
        )
    return missing


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


def _no_friction(term: FrictionTerm) -> bool:
    """Return whether a term of ours depends on positions, which the files' functions lack."""
    written = isinstance(term, LoadFriction | PositionFriction)
    return term.posed and type(term) in CLASSES.values() and not written


def terms_data(model: FrictionModel, values: list[float]) -> dict[str, Any]:
    """Return joints, terms with their parameters, and terms that are left out, as plain values.

    Raises
    ------
    ExportError
        For a term that the files have no form of.
    """
    names, n, terms = model.joint_names, len(model.joint_names), []
    for term, own in model.placed:
        kind = type(term).__name__
        if _no_friction(term):
            continue
        found: dict[str, Any] = {"term": kind}
        if CLASSES.get(kind) is type(term):
            settings = term_to_dict(term)
        elif vars(type(term)).get("efforts"):
            settings = asdict(term) if is_dataclass(term) else {}
            found["efforts"] = dict(term.efforts)
            stated = {f"{symbol}{k + 1}" for symbol in term.efforts for k in range(n)}
            if not isinstance(term, Coupling) and stated != {
                p.name for p in term.parameters(names)
            }:
                raise ExportError(
                    f"friction: {kind} has formulas of {', '.join(term.efforts)}, not of its "
                    "parameters of each joint; give `efforts` by their symbols."
                )
        else:
            raise ExportError(
                f"friction: {kind} is a term of your own without formulas for written code; give "
                "its class `efforts`, leave it out, or use estimate.model().friction."
            )
        count = n
        if isinstance(term, Coupling):
            found["joints"], count = [names.index(term.first), names.index(term.second)], 1
        if isinstance(term, LoadFriction) and not term.share:
            settings |= {"share": 0.0, "velocity": 1.0}
        for key, value in settings.items():
            if key not in {"term", *_NOT_IN_FORMULAS}:
                found[key] = np.broadcast_to(np.asarray(value, float), (count,)).tolist()
        terms.append({**found, "values": values[own]})
    left_out = [type(term).__name__ for term in model.terms if _no_friction(term)]
    return {"joints": list(names), "terms": terms, "left_out": left_out}
