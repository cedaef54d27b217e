"""Compare what a folder holds with what was made again, value by value, and tell it in links."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import MissingExtraError, SdpidError
from sdpid.verifier.bound import Proof
from sdpid.verifier.exact import product
from sdpid.verifier.reading import REFUSED, MalformedError, items, numbers, parse, read_bytes, shown

RESULT, PARAMETERS = "result.json", "parameters.json"
TABLES = {"parameters.csv": "standard", "base_parameters.csv": "base"}

# Robots, which result.json lists.
ROBOTS = URDF, MJCF = "identified.urdf", "identified.xml"

# What is made again on another processor is rounded otherwise: of honest runs costs differ by 1e-13
# of their size, by 6e-9 where the motion excites badly. One changed sample of 15,000 makes 6e-5.
LIMIT = 1e-6

# Differences of one file that are told one by one; more say no more.
_MOST = 5

# Directions that the rows show less than this, in columns of size one, count as if they were shown
# that well: rounding alone would be larger than they are.
_WEAK = 1e-7

# No weighted row is larger, and squares of what is are no doubles.
_HUGE = 1e100

# Bodies follow from the parameters without a sum over rows.
_DIGITS = 1e-12

# Costs are sums of squares, computed in floating point from numbers of up to some 1e6 times their
# size.
_ROUNDING = Fraction(1e-9)

# Ends of an interval.
_ENDS = ("interval", "lower", "upper")

# Numbers as all readers of robots and tables understand them.
_NUMBER = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,4})?)", re.ASCII)

# Attributes that are small where a robot is, no lengths and no angles: those of joints, which are
# fitted to the rows where not all terms have a place, masses, and tensors.
_SIZED = re.compile(
    r"(?:(?P<fitted>damping|\w*friction\w*|armature|coef)|(?P<mass><mass value|\bmass)"
    r'|(?P<tensor>\bi[xyz]{2}|tensor))="[^"]*$'
)

# What is smaller, in SI units, is rounding of something larger.
_LEAST = 1e-9

# The last name before a difference, and the attribute that it is in.
_NAMED, _OPEN = re.compile(r'name="([^"]*)"'), re.compile(r'([\w:]+)="[^"]*$')

_BODY = re.compile("<inertial [^>]*>")

# Tags; and of these what is quoted, and white space beside it.
_TAG, _QUOTED, _BLANK = (
    re.compile("(<[^>]*>)"),
    re.compile("(\"[^\"]*\"|'[^']*')"),
    re.compile("[ \t\n]+"),
)
_ATTRIBUTE = re.compile(r'([a-z]+)="([^"]*)"')

State = Literal["made again", "not made again", "not checked"]

# A, rhs and floor of a cost ‖A·base − rhs‖² + floor.
Cost: TypeAlias = tuple[Array, Array, float]


@dataclass(frozen=True)
class Link:
    """One link from a log to a file.

    Attributes
    ----------
    name : str
        Log, robot, samples, base parameters, contacts, problem, weights, rows, choice, intervals,
        or the names of files.
    state : {"made again", "not made again", "not checked"}
        What was found.
    text : str
        Why, with the numbers.
    """

    name: str
    state: State
    text: str


def told(links: Iterable[Link], state: State) -> tuple[str, ...]:
    """Return the sentences of the links with a state."""
    return tuple(f"{each.name}: {each.text}" for each in links if each.state == state)


def by_file(found: Iterable[Link]) -> list[Link]:
    """Return links of which those that say the same have all their names in one."""
    names: dict[tuple[State, str], list[str]] = {}
    for each in found:
        names.setdefault((each.state, each.text), []).append(each.name)
    return [Link(", ".join(own), state, text) for (state, text), own in names.items()]


def checked(name: str, check: Callable[[], Iterable[str]], said: str) -> list[Link]:
    """Return the links of a file: what is wrong, or what is said where nothing is."""
    try:
        wrong = list(check())
    except MissingExtraError as missing:
        return [Link(name, "not checked", f"what it holds ({missing})")]
    except SdpidError as cause:
        wrong = [f"cannot be written again: {cause}"]
    except (OSError, *REFUSED) as cause:
        known = isinstance(cause, MalformedError)
        what = str(cause) if known else f"{type(cause).__name__} {shown(str(cause))}"
        wrong = [f"cannot be compared: {what}"]
    if not wrong:
        return [Link(name, "made again", said)]
    if len(wrong) > _MOST:
        wrong[_MOST:] = [f"{len(wrong) - _MOST} other differences"]
    return [Link(name, "not made again", each) for each in wrong]


def differences(
    found: Any,
    wanted: Any,
    *,
    within: float = LIMIT,
    of_width: float = 0.0,
    where: str = "",
    size: float = 0.0,
    room: float = 0.0,
) -> Iterator[str]:
    """Yield where a plain value is not the one that was made again.

    Parameters
    ----------
    found, wanted : plain values
        What a file holds, and what was made again. Keys have an order.
    within : float, optional
        Share by which numbers may differ: of the largest of their object, or of their list and the
        object that it is in.
    of_width : float, optional
        Share of an interval's width by which its ends may differ, if that is more.
    where, size, room : str and floats, optional
        Where the values stand, the largest number beside them, and by how much they may differ.
    """
    if isinstance(wanted, (Mapping, list, tuple)):
        named = isinstance(wanted, Mapping)
        if type(found) is not (dict if named else list):
            yield f"{where} is {_short(found)}"
            return
        one, two = (dict(each if named else enumerate(each)) for each in (found, wanted))
        if list(one) != list(two):
            odd = ", ".join(shown(str(each)) for each in one.keys() ^ two.keys())
            yield f"{where} has other entries than were made again ({odd or 'their order'})"
            return
        own = max((abs(each) for each in two.values() if _is_number(each)), default=0.0)
        beside = own if named else max(own, size)
        wide = of_width * _width(two) if named else room
        for key, value in two.items():
            yield from differences(
                one[key],
                value,
                within=within,
                of_width=of_width,
                where=f"{where} {shown(str(key)) if named else key + 1}".lstrip(),
                size=beside,
                room=wide if not named or key in _ENDS else 0.0,
            )
    elif _is_number(wanted) and _is_number(found):
        if not abs(found - wanted) <= max(within * max(abs(wanted), size), room):
            yield f"{where} is {_short(found)}, made again it is {_short(wanted)}"
    elif type(found) is not type(wanted) or found != wanted:
        yield f"{where} is {_short(found)}, made again it is {_short(wanted)}"


def _width(entries: dict[Any, Any]) -> float:
    """Return the width of the interval among some entries; of a half-line, from what is in it."""
    near = [entries.get(key) for key in ("value", "estimate", "lower", "upper")]
    numbers = [each for each in (*near, *(entries.get("interval") or ())) if _is_number(each)]
    return max(numbers, default=0.0) - min(numbers, default=0.0)


def read_table(content: bytes) -> dict[str, dict[str, Any]]:
    """Return the cells of a CSV table by row and column, numbers as such; no name occurs twice.

    Raises
    ------
    MalformedError, UnicodeDecodeError
        When it is none.
    """
    try:
        rows = list(csv.reader(io.StringIO(content.decode("utf-8"), newline=""), strict=True))
    except csv.Error as cause:
        raise MalformedError(f"it is no CSV ({shown(str(cause))})") from None
    if not rows or any(len(row) != len(rows[0]) for row in rows):
        raise MalformedError("its rows have not as many fields as its header")
    for names in (rows[0], [row[0] for row in rows]):
        if len(set(names)) != len(names):
            raise MalformedError("two of its rows or columns have the same name")
    header, *others = rows
    return {
        row[0]: {
            name: float(cell) if _NUMBER.fullmatch(cell) else cell
            for name, cell in zip(header, row, strict=True)
        }
        for row in others
    }


def text_differences(found: str, wanted: str) -> Iterator[str]:
    """Yield where a robot's file is not the one that was written again: one place a line.

    Everything between numbers is the same but for white space between and within tags and their
    quotes, which writers choose; and so are numbers: those that are fitted to rows to `LIMIT`,
    others to 1e-12, of the largest in their element; lengths and angles of at least one.
    """
    if found == wanted:
        return
    own, again = _pieces(found), _pieces(wanted)
    largest: dict[tuple[int, str], float] = {}
    for part, _, of, number in again:
        if number:
            least = largest.get(of, _LEAST if of[1] else 1.0)
            largest[of] = max(least, abs(float(part)))
    last = 0
    for k, ((one, line, *_), (two, _, of, number)) in enumerate(zip(own, again, strict=False)):
        room = (LIMIT if of[1] == "fitted" else _DIGITS) * largest.get(of, 1.0)
        if one == two or (number and own[k][3] and _near(one, two, room)) or line == last:
            continue
        last, before = line, "".join(each for each, *_ in again[:k])
        named = _NAMED.findall(before)[-1:] + _OPEN.findall(before)
        where = f" ({', '.join(shown(each) for each in named)})" if named else ""
        yield (f"line {last}{where} has {_short(one.strip())}, written again {_short(two.strip())}")
        if not number:
            # What follows is shifted.
            return
    if len(own) != len(again):
        yield "it ends elsewhere than the file that was written again"


def _pieces(text: str) -> list[tuple[str, int, tuple[int, str], bool]]:
    """Return text and numbers with the line and the element and kind of each."""
    line, element, kind, pieces = 1, 0, "", []
    for token in _TAG.split(_BODY.sub(_as_tensor, text)):
        for k, part in enumerate(_NUMBER.split(_tidy(token))):
            if not k % 2:
                element += part.count("<")
                if '="' in part:
                    sized = _SIZED.search(part)
                    kind = "" if sized is None else str(sized.lastgroup)
            pieces.append((part, line, (element, kind), bool(k % 2)))
        line += token.count("\n")
    return pieces


def _tidy(token: str) -> str:
    """Return a tag or a text without the white space and the quotes that writers choose."""
    if not token.startswith("<"):
        return token if token.strip(" \t\n") else ""
    if token.startswith("<!"):
        return token
    parts = _QUOTED.split(token)
    parts[::2] = (re.sub(r" ?(=|/?>) ?", r"\1", _BLANK.sub(" ", part)) for part in parts[::2])
    parts[1::2] = (part if '"' in part else f'"{part[1:-1]}"' for part in parts[1::2])
    return "".join(parts)


def _as_tensor(match: re.Match[str]) -> str:
    """Return the element of a body with its tensor: axes may come in any order and sign."""
    from scipy.spatial.transform import Rotation

    pairs = _ATTRIBUTE.findall(match[0])
    given = dict(pairs)
    quaternion, moments = (given.get(key, "").split() for key in ("quat", "diaginertia"))
    # Python's numbers may have underscores, which MuJoCo refuses.
    known = all(map(_NUMBER.fullmatch, (*quaternion, *moments)))
    if len(given) != len(pairs) or (len(quaternion), len(moments)) != (4, 3) or not known:
        return match[0]
    w, x, y, z = map(float, quaternion)
    if not 0.0 < math.hypot(w, x, y, z) < math.inf:
        return match[0]
    turn = Rotation.from_quat([x, y, z, w]).as_matrix()
    tensor = (turn * np.array(moments, dtype=np.float64)) @ turn.T
    given |= {"tensor": " ".join(map(repr, tensor[np.triu_indices(3)].tolist()))}
    others = (f'{k}="{v}"' for k, v in given.items() if k not in ("quat", "diaginertia"))
    return " ".join((*_ATTRIBUTE.sub("", match[0]).split(), *others))


def _near(found: str, wanted: str, room: float) -> bool:
    """Return whether two numbers are the same; whole ones may be parts of names."""
    if wanted.isdigit() or found.isdigit():
        return False
    return abs(float(found) - float(wanted)) <= room


def _is_number(value: Any) -> bool:
    return type(value) in (int, float)


def _short(value: Any) -> str:
    """Return a value for a sentence."""
    if _is_number(value) or type(value) is bool or value is None:
        return f"{value!r:.40}"
    return shown(value if type(value) is str else repr(value))[:80]


def distance(given: Cost, made: Cost) -> float:
    """Return by which share a cost differs from one that was made again, for all parameters.

    Both are quadratic in (base, 1). The one that was made again is the squared length of some
    coordinates of these; in the same coordinates the difference is a symmetric matrix, whose
    spectral norm this is. It is scaled by what was made again: a forged cost has no say in it.

    Returns
    -------
    float
        Infinite where a number of the given cost is none, or no row's.
    """
    # The rows whose product with (base, −1) has the cost as its square.
    own, R = (
        np.block([[A, rhs[:, None]], [np.zeros(A.shape[1]), np.sqrt(floor)]])
        for A, rhs, floor in (given, made)
    )
    if own.shape != R.shape or not np.all(np.abs(own) < _HUGE):
        return np.inf
    size = np.linalg.norm(R, axis=0)
    size[size == 0.0] = 1.0
    _, values, axes = np.linalg.svd(R / size)
    values = np.maximum(values, max(_WEAK * values[0], np.finfo(float).tiny))
    coordinates = axes.T / values / size[:, None]
    one, two = own @ coordinates, R @ coordinates
    return float(np.linalg.norm(one.T @ one - two.T @ two, 2))


def check_numbers(
    folder: Path, files: Container[str], data: Mapping[str, Any], holds: bool
) -> list[Link]:
    """Check the files that repeat numbers of a certificate: each to the last digit.

    Parameters
    ----------
    folder : Path
        The folder.
    files : container of str
        The files that its manifest lists.
    data : mapping
        The certificate, which makes sense.
    holds : bool
        Whether it proves what it claims.
    """
    written = list[str]()
    with suppress(OSError, *REFUSED):
        # What is wrong is told where the file is compared; no robot that is there is of it.
        exports = items(parse(read_bytes(folder / RESULT))["exports"], "exports")
        written = [each["file"] for each in exports]
    parameters: dict[str, dict[str, float] | None] = {"standard": None, "base": None}
    if data["theta"] is not None:
        # Base parameters are the doubles nearest to B·theta.
        nearest = product(data["problem"]["base_matrix"], data["theta"])
        for kind, names, values in (
            ("standard", "theta_names", data["theta"]),
            ("base", "base_names", nearest),
        ):
            parameters[kind] = dict(zip(data["origin"][names], map(float, values), strict=True))

    def of_table(name: str) -> Iterator[str]:
        found = {key: row["value"] for key, row in read_table(read_bytes(folder / name)).items()}
        wanted = parameters[TABLES[name]]
        return differences(
            found, dict.fromkeys(found, "") if wanted is None else wanted, within=0.0
        )

    def of_json(name: str) -> Iterator[str]:
        return _of_json(folder / name, data, parameters, holds)

    links = list[Link]()
    for name in (RESULT, PARAMETERS, *TABLES, *ROBOTS):
        if name not in files:
            if name not in ROBOTS or name in written or (folder / name).exists():
                links.append(Link(name, "not made again", "it is a result, and not sealed"))
        elif name not in ROBOTS:
            check = partial(of_table if name in TABLES else of_json, name)
            links += checked(name, check, "the numbers are the certificate's, to the last digit")
        elif name not in written:
            text = f"{RESULT} does not name it among what was written"
            links.append(Link(name, "not made again", text))
    return by_file(links)


def _of_json(
    path: Path, certificate: Mapping[str, Any], parameters: Mapping[str, Any], holds: bool
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
    proof = Proof(dict(certificate))
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
