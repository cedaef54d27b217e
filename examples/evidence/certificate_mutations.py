"""Ways to change a certificate: what forgeries.py is made of.

Half of them edit any certificate without a thought of what it means: numbers are changed by a
digit, a sign or a scale, lists lose their order, numbers become something else. The others change
its meaning. A mutation changes the data in place and returns whether it found something to change.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator
from random import Random
from typing import Any

import numpy as np
from certificate_optimum import UNITS

Data = dict[str, Any]
Mutation = Callable[[Random, Data, dict[str, Data]], bool]

# What proves something, or is proven; origin and metadata are described elsewhere.
SECTIONS = ("problem", "theta", "multipliers", "claims")
HUGE = (1e308, -1e308, 1e30, 5e-324, 1e-300, -0.0, 0.0, 2**53 + 1, 10**25)


def walk(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], Any]]:
    """Yield path and value of everything, what is outside first."""
    yield path, value
    if isinstance(value, (dict, list)):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            yield from walk(item, (*path, key))


def inside(value: Any, *kinds: type) -> list[Any]:
    """Return everything of some types, what is outside first."""
    return [item for _, item in walk(value) if type(item) in kinds]


def at(data: Any, path: tuple[Any, ...]) -> Any:
    """Return what is at a path."""
    for key in path:
        data = data[key]
    return data


def number(rng: Random, data: Data, nonzero: bool = True) -> tuple[Any, Any, float] | None:
    """Return a random number: its container, its key, and its value. Every field is as likely."""
    fields = [(section, key) for section in SECTIONS for key in _keys(data.get(section))]
    rng.shuffle(fields)
    for section, key in fields:
        field = data[section] if key is None else data[section][key]
        found = [
            path
            for path, value in walk(field)
            if type(value) in (int, float) and (value or not nonzero)
        ]
        if found:
            path = (section, *(() if key is None else (key,)), *rng.choice(found))
            where = at(data, path[:-1])
            return where, path[-1], where[path[-1]]
    return None


def _keys(section: Any) -> list[Any]:
    return list(section) if isinstance(section, dict) else [] if section is None else [None]


def numeric(change: Callable[[Random, float], float]) -> Mutation:
    """Return a mutation that changes one number."""

    def apply(rng: Random, data: Data, zoo: dict[str, Data]) -> bool:
        found = number(rng, data)
        if found is None:
            return False
        where, key, value = found
        new = change(rng, value)
        if key == "links" or key == "link" or type(value) is int:
            new = round(new) if math.isfinite(new) and abs(new) < 1e6 else value + 1
        where[key] = new
        return bool(new != value)

    return apply


def digit(rng: Random, value: float) -> float:
    """Return a number with another digit."""
    text = repr(value)
    k = rng.choice([k for k, c in enumerate(text) if c.isdigit()])
    changed = text[:k] + rng.choice([c for c in "0123456789" if c != text[k]]) + text[k + 1 :]
    try:
        new = float(changed)
    except ValueError:
        return value
    return new if math.isfinite(new) else value


def last_digits(rng: Random, value: float) -> float:
    """Return a neighbor among the doubles, or one some steps further."""
    for _ in range(rng.choice([1, 1, 1, 3, 10])):
        value = math.nextafter(value, rng.choice([-math.inf, math.inf]))
    return value


def swap(rng: Random, data: Data, zoo: dict[str, Data]) -> bool:
    """Swap two neighbors of a list: numbers, rows of a matrix, links."""
    found = number(rng, data, nonzero=False)
    lists = found and [each for each in inside(data[rng.choice(SECTIONS)], list) if len(each) > 1]
    if not lists:
        return False
    chosen = rng.choice(lists)
    i, j = rng.sample(range(len(chosen)), 2)
    same = chosen[i] == chosen[j]
    chosen[i], chosen[j] = chosen[j], chosen[i]
    return not same


def extreme(rng: Random, data: Data, zoo: dict[str, Data]) -> bool:
    """Put a number at the end of what doubles can be."""
    found = number(rng, data, nonzero=False)
    if found is None:
        return False
    where, key, _ = found
    where[key] = rng.choice(HUGE)
    return True


def odd_type(rng: Random, data: Data, zoo: dict[str, Data]) -> bool:
    """Put something that is no number where a number belongs, or another empty thing."""
    found = number(rng, data, nonzero=False)
    if found is None:
        return False
    if rng.random() < 0.3:
        data["problem"][rng.choice(["rows", "cones", "prior_matrix"])] = rng.choice(["", {}, None])
    else:
        where, key, _ = found
        where[key] = rng.choice([True, "1", None, [], {}, [1.0]])
    return True


def odd_key(rng: Random, data: Data, zoo: dict[str, Data]) -> bool:
    """Add a key that no format knows, somewhere."""
    rng.choice(inside(data, dict))["approved"] = rng.choice([True, "by all", {}])
    return True


CLAIMS = ("lower_bound", "cost", "gap", "violation")


def entry(rng: Random, size: float) -> float:
    """Return a number of any size up to one."""
    return rng.choice([-1.0, 1.0]) * size * 10.0 ** rng.uniform(-6.0, 0.0)


def drop(rng: Random, data: Data, zoo: dict[str, Data]) -> bool:
    """Drop a row, a cone, a link's prior, or an item of any list, with all that belongs to it."""
    problem, multipliers = data["problem"], data["multipliers"]
    own = problem["links"] * (problem["consistency"] != "none")
    kind = rng.choice(["row", "cone", "prior", "any"])
    if kind == "row" and problem["rows"]:
        k = rng.randrange(len(problem["rows"]))
        problem["rows"].pop(k)
        multipliers["rows"].pop(k)
    elif kind == "cone" and problem["cones"]:
        k = rng.randrange(len(problem["cones"]))
        problem["cones"].pop(k)
        multipliers["Z"].pop(own + k)
    elif kind == "prior" and problem["entropic_prior"]:
        k = rng.randrange(len(problem["entropic_prior"]["links"]))
        problem["entropic_prior"]["links"].pop(k)
        problem["entropic_prior"]["inverses"].pop(k)
        if multipliers["W"]:
            multipliers["W"].pop(k)
    else:
        lists = [each for each in inside(data[rng.choice(SECTIONS)], list) if each]
        if not lists:
            return False
        chosen = rng.choice(lists)
        chosen.pop(rng.randrange(len(chosen)))
    return True


def add_row(rng: Random, data: Data, zoo: dict[str, Data]) -> bool:
    """Add a row of any scale, obeyed or not, with a multiplier of any size."""
    problem = data["problem"]
    p, scale = len(problem["lower"]), 10.0 ** rng.uniform(-20.0, 20.0)
    coefficients = [0.0] * p
    for k in rng.sample(range(p), rng.choice([1, 1, 2, 5])):
        coefficients[k] = scale * rng.choice([1.0, -1.0, rng.uniform(-1.0, 1.0)])
    theta = data["theta"] or [0.0] * p
    value = sum(a * x for a, x in zip(coefficients, theta, strict=True))
    room = scale * rng.choice([0.0, 1e-12, 1e-9, 1e-6, 1e-3, 1.0, 500.0]) * rng.choice([-1.0, 1.0])
    lower = value + room if rng.random() < 0.8 else None
    upper = rng.choice([None, lower, None if lower is None else lower + abs(room)])
    row = {"name": "forged", "lower": lower, "upper": upper, "coefficients": coefficients}
    problem["rows"].append(row)
    multiplier = rng.choice([0.0, 1.0, -1.0]) * 10.0 ** rng.uniform(-3.0, 6.0) / scale
    data["multipliers"]["rows"].append(multiplier)
    return True


def add_cone(rng: Random, data: Data, zoo: dict[str, Data]) -> bool:
    """Add a cone of any scale on some link, with a multiplier of rank one."""
    problem, multipliers = data["problem"], data["multipliers"]
    if not problem["links"]:
        return False
    scale = 10.0 ** rng.uniform(-20.0, 20.0)
    link = rng.randrange(problem["links"])
    axis = [scale * rng.choice([0.0, 1.0, entry(rng, 1.0)]) for _ in range(10)]
    vectors = [[scale * entry(rng, 0.1) for _ in range(10)] for _ in range(3)]
    problem["cones"].append({"name": "forged", "link": link, "axis": axis, "vectors": vectors})
    size = 6 if problem["consistency"] == "spatial_inertia" else 4
    multipliers["Z"].append(rank_one(rng, size, rng.choice([0.0, 1.0, 1e3]) / scale))
    return True


def rank_one(rng: Random, size: int, factor: float) -> list[list[float]]:
    """Return factor·v·v^T for integers v, exactly symmetric and positive semidefinite."""
    v = [rng.randint(-3, 3) for _ in range(size)]
    factor = 2.0 ** round(math.log2(factor)) if factor > 0.0 else 0.0
    return [[factor * a * b for b in v] for a in v]


def forget_links(rng: Random, data: Data, zoo: dict[str, Data]) -> bool:
    """Drop the inequalities of the last links: their entries of theta pass as friction."""
    problem, multipliers = data["problem"], data["multipliers"]
    if problem["links"] < 2:
        return False
    kept = rng.randrange(problem["links"])
    cut = problem["links"] - kept
    if problem["consistency"] != "none":
        del multipliers["Z"][kept : kept + cut]
        if data["claims"]["margins"]:
            del data["claims"]["margins"][kept:]
    problem["links"] = kept
    if "links" in data["origin"]:
        del data["origin"]["links"][kept:]
    return True


def massless(rng: Random, data: Data, zoo: dict[str, Data]) -> bool:
    """Make a link massless, and claim a margin of it, or none."""
    problem, theta = data["problem"], data["theta"]
    if not (theta and problem["links"]):
        return False
    first = 10 * rng.randrange(problem["links"])
    if rng.random() < 0.7:
        for k in range(first, first + 10):
            problem["lower"][k] = min(problem["lower"][k], 0.0)
    for k in range(first, first + (10 if rng.random() < 0.5 else 4)):
        theta[k] = 0.0
    if data["claims"]["margins"]:
        data["claims"]["margins"][first // 10] = rng.choice([None, 0.0, 0.1, 1.0])
    if rng.random() < 0.5:
        problem["margin"] = 0.0
    return True


def repeat_link(rng: Random, data: Data, zoo: dict[str, Data]) -> bool:
    """Count the prior of one link twice, or let it be another's."""
    prior = data["problem"]["entropic_prior"]
    if not (prior and prior["links"]):
        return False
    k = rng.randrange(len(prior["links"]))
    if rng.random() < 0.5:
        prior["links"][k] = rng.randrange(data["problem"]["links"])
        return True
    prior["links"].append(prior["links"][k])
    prior["inverses"].append(prior["inverses"][k])
    if data["multipliers"]["W"]:
        data["multipliers"]["W"].append(data["multipliers"]["W"][k])
    return True


def prior(rng: Random, data: Data, zoo: dict[str, Data]) -> bool:
    """Change how much a prior counts, or what it believes; or take it away."""
    problem = data["problem"]
    factor = rng.choice([0.0, -1.0, 0.5, 2.0, 1e-9, 1e9, 1.0 + 1e-9])
    if problem["entropic_prior"] and rng.random() < 0.5:
        if rng.random() < 0.5:
            problem["entropic_prior"]["strength"] *= factor
        else:
            for matrix in problem["entropic_prior"]["inverses"]:
                matrix[:] = [[factor * x for x in row] for row in matrix]
        return True
    if problem["prior_rhs"]:
        part = rng.choice(["rhs", "row"])
        k = rng.randrange(len(problem["prior_rhs"]))
        if part == "rhs":
            problem["prior_rhs"][k] *= factor
        else:
            problem["prior_matrix"][k] = [factor * x for x in problem["prior_matrix"][k]]
        return True
    return False


def claim(rng: Random, data: Data, zoo: dict[str, Data]) -> bool:
    """Claim a little more, or a lot."""
    claims = data["claims"]
    key = rng.choice([*CLAIMS, "margins"])
    if key == "margins":
        margins = claims["margins"] or []
        if not margins:
            return False
        k = rng.randrange(len(margins))
        margins[k] = rng.choice(
            [None, 0.0, -1.0, (margins[k] or 0.0) + 10.0 ** rng.uniform(-18, 0)]
        )
        return True
    value = claims[key]
    if value is None:
        claims[key] = rng.choice([0.0, 1.0, data["claims"]["lower_bound"]])
        return True
    toward = math.inf if key == "lower_bound" else -math.inf
    better = value + math.copysign(max(abs(value), 1e-12) * 10.0 ** rng.uniform(-16, 1), toward)
    claims[key] = rng.choice([math.nextafter(value, toward), better, better, None, 0.0, 1e300])
    return True


def rewrite_cost(rng: Random, data: Data, zoo: dict[str, Data]) -> bool:
    """Give the cost another optimum: the parameters' own, or that of other efforts."""
    problem, theta = data["problem"], data["theta"]
    if not theta or not problem["rhs"]:
        return False
    kind = rng.choice(["optimal", "nothing", "scaled", "floor", "less"])
    if kind == "optimal":
        base = [sum(map(float.__mul__, map(float, row), theta)) for row in problem["base_matrix"]]
        rhs = [sum(map(float.__mul__, row, base)) for row in problem["A"]]
        problem["rhs"], problem["prior_rhs"] = rhs, problem["prior_rhs"]
    elif kind == "nothing":
        problem["A"] = [[0.0] * len(row) for row in problem["A"]]
    elif kind == "scaled":
        factor = 10.0 ** rng.uniform(-3, 3)
        problem["A"] = [[factor * x for x in row] for row in problem["A"]]
    elif kind == "floor":
        problem["floor"] *= rng.choice([0.0, 0.5, 2.0, 1e6])
    else:
        k = rng.randrange(len(problem["rhs"]))
        problem["A"][k], problem["rhs"][k] = [0.0] * len(problem["A"]), 0.0
    return True


def box(rng: Random, data: Data, zoo: dict[str, Data]) -> bool:
    """Widen, narrow, move or turn around the bounds of a parameter, or of all."""
    problem = data["problem"]
    lower, upper = problem["lower"], problem["upper"]
    count = rng.choice([1, 1, len(lower)])
    how = rng.choice(["wide", "narrow", "point", "turn", "zero"])
    for k in rng.sample(range(len(lower)), count):
        if how == "wide":
            lower[k], upper[k] = 10.0 * min(lower[k], -1.0), 10.0 * max(upper[k], 1.0)
        elif how == "narrow":
            lower[k], upper[k] = 0.5 * lower[k], 0.5 * upper[k]
        elif how == "point" and data["theta"]:
            lower[k] = upper[k] = data["theta"][k]
        elif how == "turn":
            lower[k], upper[k] = upper[k], lower[k]
        else:
            lower[k] = 0.0
    return True


def consistency(rng: Random, data: Data, zoo: dict[str, Data]) -> bool:
    """Ask for another consistency or margin, as far as shapes allow."""
    problem = data["problem"]
    if rng.random() < 0.5:
        problem["margin"] = rng.choice([0.0, -1.0, 1e-300, 2.0 * problem["margin"], 1.0, -1e-9])
        return True
    old = problem["consistency"]
    if old == "pseudo_inertia":
        problem["consistency"] = "none"
        del data["multipliers"]["Z"][: problem["links"]]
        data["claims"]["margins"] = None
    else:
        problem["consistency"] = "pseudo_inertia"
        data["multipliers"]["Z"] = [
            rank_one(rng, 4, rng.choice([0.0, 1.0]))
            for _ in range(problem["links"] + len(problem["cones"]))
        ]
        data["claims"]["margins"] = [problem["margin"]] * problem["links"]
    return True


def made_up(rng: Random, data: Data, zoo: dict[str, Data]) -> bool:
    """Give multipliers that no solver found, some of them not positive semidefinite."""
    multipliers, size = data["multipliers"], 10.0 ** rng.uniform(-8, 3)
    for kind in rng.sample(["y", "rows", "Z", "W", "triangle"], 2):
        if kind in ("y", "rows"):
            multipliers[kind] = [x + entry(rng, size) for x in multipliers[kind]]
        elif kind == "triangle" and multipliers["Z"]:
            rng.choice(multipliers["Z"])[0][1] += entry(rng, size)
        elif kind in ("Z", "W") and multipliers[kind]:
            k = rng.randrange(len(multipliers[kind]))
            count = len(multipliers[kind][k])
            other = rank_one(rng, count, size)
            if rng.random() < 0.3:
                other = [[-x for x in row] for row in other]
            both = zip(multipliers[kind][k], other, strict=True)
            multipliers[kind][k] = [[a + b for a, b in zip(x, y, strict=True)] for x, y in both]
    return True


def bent(rng: Random, data: Data, zoo: dict[str, Data]) -> bool:
    """Give multipliers that fit all equations and bound the cost too high, were they ⪰ 0.

    They are those of bodies without mass, as if each matrix inequality were an equation; mixed with
    the file's own by a share from next to nothing to all.
    """
    problem, multipliers = data["problem"], data["multipliers"]
    kind, links = problem["consistency"], problem["links"]
    if kind == "none" or not links:
        return False
    A, B, R = (np.array(problem[key], dtype=float) for key in ("A", "base_matrix", "prior_matrix"))
    G = np.vstack([A @ B, R.reshape(-1, B.shape[1])])
    point = np.array(data["theta"] or [0.0] * B.shape[1])
    point[: 10 * links] = 0.0
    y = G @ point - np.array([*problem["rhs"], *problem["prior_rhs"]])
    slopes = 2.0 * G.T @ y
    share = rng.choice([1.0, 1e-2, 1e-4, 1e-6])
    units = UNITS[kind]
    size = units.shape[1]
    for i in range(links):
        flat, *_ = np.linalg.lstsq(units.reshape(10, -1), slopes[10 * i : 10 * i + 10])
        Z = flat.reshape(size, size)
        mixed = (1.0 - share) * np.array(multipliers["Z"][i]) + 0.5 * share * (Z + Z.T)
        multipliers["Z"][i] = (0.5 * (mixed + mixed.T)).tolist()
    multipliers["y"] = ((1.0 - share) * np.array(multipliers["y"]) + share * y).tolist()
    return True


def move(rng: Random, data: Data, zoo: dict[str, Data]) -> bool:
    """Move the parameters, by rounding or by much, or give others."""
    theta = data["theta"]
    if not theta:
        return False
    size = 10.0 ** rng.uniform(-14, 0)
    kind = rng.choice(["one", "all", "zero", "scale", "none", "negative"])
    if kind == "one":
        theta[rng.randrange(len(theta))] += entry(rng, size)
    elif kind == "all":
        data["theta"] = [x + entry(rng, size) * max(abs(x), 1e-3) for x in theta]
    elif kind == "zero":
        data["theta"] = [0.0] * len(theta)
    elif kind == "scale":
        factor = 1.0 + entry(rng, size)
        data["theta"] = [factor * x for x in theta]
    elif kind == "negative":
        theta[10 * rng.randrange(max(data["problem"]["links"], 1))] *= -1.0
    else:
        data["theta"] = None
        data["claims"].update(margins=None, violation=None, cost=None, gap=None)
    return True


def transplant(rng: Random, data: Data, zoo: dict[str, Data]) -> bool:
    """Take a part from another certificate, of the same shape where there is one."""
    section = rng.choice(["problem", "multipliers", "claims", "theta", "whole"])
    fits = [
        each
        for each in zoo.values()
        if each["theta"] is not None
        and len(each["problem"]["lower"]) == len(data["problem"]["lower"])
    ]
    other = copy.deepcopy(rng.choice(fits or list(zoo.values())))
    if section in ("theta", "whole"):
        key = section if section == "theta" else rng.choice(["problem", "multipliers", "claims"])
        same = data[key] == other[key]
        data[key] = other[key]
    else:
        key = rng.choice(sorted(data[section]))
        same = data[section][key] == other[section][key]
        data[section][key] = other[section][key]
    return not same


def rename(rng: Random, data: Data, zoo: dict[str, Data]) -> bool:
    """Give a name that a terminal would obey, or that reads like a sentence of the verifier."""
    bad = ("\x1b[2K\x1b[1A", "a\nPROVEN.\n", "x'. They cost at most 0.0.", "\u202ed", "n" * 10**4)
    objects = [*data["problem"]["rows"], *data["problem"]["cones"], data["origin"]]
    chosen = rng.choice(objects)
    key = "name" if "name" in chosen else rng.choice(["robot", "weighting", "links", "joints"])
    new = rng.choice(bad)
    if isinstance(chosen.get(key), list) and chosen[key]:
        chosen[key][rng.randrange(len(chosen[key]))] = new
    else:
        chosen[key] = new
    return True


MUTATIONS: dict[str, Mutation] = {
    "digit": numeric(digit),
    "last digits": numeric(last_digits),
    "sign": numeric(lambda rng, value: -value),
    "scale": numeric(
        lambda rng, value: value * rng.choice([2.0, 0.5, 10.0, 1e-3, 1e6, 1.0 + 1e-9])
    ),
    "swap": swap,
    "extreme number": extreme,
    "odd type": odd_type,
    "odd key": odd_key,
    "drop": drop,
    "added row": add_row,
    "added cone": add_cone,
    "forgotten links": forget_links,
    "massless body": massless,
    "repeated link": repeat_link,
    "prior": prior,
    "claim": claim,
    "rewritten cost": rewrite_cost,
    "bounds": box,
    "consistency": consistency,
    "multipliers": made_up,
    "bent multipliers": bent,
    "parameters": move,
    "another robot's part": transplant,
    "name": rename,
}
