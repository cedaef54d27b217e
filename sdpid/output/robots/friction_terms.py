"""Friction as plain numbers, and each joint's effort as an expression that many languages read.

An expression has the joint's place in ``v[k]``, ``a[k]`` and ``load[k]``, numbers as the shortest
decimals that are read as the same doubles, and the functions sign, tanh, outside, ahead, back,
root, peak and size, which a `Language` defines.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

SCHEMA, VERSION = "sdpid-friction", 1

# Parts of the effort: friction of the velocity, drives of the acceleration, friction of the load.
PARTS = ("friction", "drives", "load")


class Kind(NamedTuple):
    """The symbols of a term's parameters and the settings of which it has one a joint."""

    symbols: tuple[str, ...]
    settings: tuple[str, ...] = ()


COUPLING = "Coupling"
KINDS = {
    "Coulomb": Kind(("Fs",), ("width", "dead_zone")),
    "AsymmetricCoulomb": Kind(("Fsp", "Fsn"), ("width", "dead_zone")),
    "Viscous": Kind(("Fv",)),
    "Offset": Kind(("Fo",)),
    "RotorInertia": Kind(("Ia",)),
    "SquareRootFriction": Kind(("Fq",)),
    "Stribeck": Kind(("Fst",), ("velocity", "exponent", "width")),
    "SigmoidFriction": Kind(("Fsg",), ("velocity",)),
    "LoadFriction": Kind(("Fl",), ("width", "share", "velocity")),
    COUPLING: Kind(("Ia", "Fv", "Fs"), ("width",)),
}

# Far out a power may overflow; the Stribeck peak is zero long before.
STEEPEST = 50.0


@dataclass(frozen=True)
class Language:
    """What stands before the functions of a language, and before a place in an array."""

    function: str
    place: str

    def at(self, array: str, k: int) -> str:
        """Return the entry of joint k."""
        return f"{array}[{self.place}{k}]"

    def call(self, function: str, *arguments: str | float) -> str:
        """Return a call of one of the functions."""
        given = ", ".join(x if isinstance(x, str) else repr(x) for x in arguments)
        return f"{self.function}{function}({given})"

    def sign(self, v: str, width: float, dead_zone: float = 0.0) -> str:
        """Return the sign of a velocity, smooth where it has a width, zero in the dead zone."""
        found = self.call("tanh", f"{v} / {width!r}") if width else self.call("sign", v)
        return self.call("outside", v, dead_zone, found) if dead_zone else found


class Summand(NamedTuple):
    """One parameter's share in the effort of a joint."""

    part: str
    joint: int
    parameter: str
    expression: str


def parameters(term: Mapping[str, Any], n: int) -> list[str]:
    """Return the names of a term's parameters, in order."""
    symbols = KINDS[term["term"]].symbols
    if term["term"] == COUPLING:
        i, j = term["joints"]
        return [f"{symbol}{i + 1}_{j + 1}" for symbol in symbols]
    return [f"{symbol}{k + 1}" for symbol in symbols for k in range(n)]


def summands(data: Mapping[str, Any], language: Language) -> Iterator[Summand]:
    """Yield what each parameter adds to which joint; parameters that are zero add nothing."""
    n = len(data["joints"])
    for term in data["terms"]:
        for at, (name, value) in enumerate(zip(parameters(term, n), term["values"], strict=True)):
            if value == 0.0:
                continue
            for part, joint, shape in _shapes(term, at, n, language):
                yield Summand(part, joint, name, f"{value!r} * {shape}" if shape else repr(value))


def _shapes(
    term: Mapping[str, Any], at: int, n: int, language: Language
) -> Iterator[tuple[str, int, str]]:
    """Yield part, joint and effort of a unit parameter, given its place among the term's."""
    if term["term"] == COUPLING:
        i, j = term["joints"]
        motor = f"({language.at('v', i)} + {language.at('v', j)})"
        for own, other in ((i, j), (j, i)):
            shapes = (
                ("drives", language.at("a", other)),
                ("friction", language.at("v", other)),
                ("friction", language.sign(motor, term["width"][0])),
            )
            yield shapes[at][0], own, shapes[at][1]
        return
    k = at % n
    v = language.at("v", k)
    chosen = {key: term[key][k] for key in KINDS[term["term"]].settings}
    yield (*_jointwise(term["term"], at // n, k, v, chosen, language),)


def _jointwise(
    kind: str, side: int, k: int, v: str, chosen: Mapping[str, float], language: Language
) -> tuple[str, int, str]:
    """Return part, joint and effort of a unit parameter that acts on its own joint."""
    if kind == "RotorInertia":
        return "drives", k, language.at("a", k)
    if kind == "Viscous":
        return "friction", k, v
    if kind == "Offset":
        return "friction", k, ""
    if kind == "SquareRootFriction":
        return "friction", k, language.call("root", v)
    if kind == "SigmoidFriction":
        return "friction", k, language.call("tanh", f"{v} / {chosen['velocity']!r}")
    sign = language.sign(v, chosen["width"], chosen.get("dead_zone", 0.0))
    if kind == "Stribeck":
        ratio, exponent = f"{v} / {chosen['velocity']!r}", min(chosen["exponent"], STEEPEST)
        return "friction", k, f"{language.call('peak', ratio, exponent)} * {sign}"
    if kind == "AsymmetricCoulomb":
        return "friction", k, language.call(("ahead", "back")[side], sign)
    if kind == "LoadFriction":
        if share := chosen["share"]:
            slow = language.call("tanh", f"{v} / {chosen['velocity']!r}")
            sign = f"({1.0 - share!r} * {sign} + {share!r} * {slow})"
        return "load", k, f"{language.call('size', language.at('load', k))} * {sign}"
    return "friction", k, sign
