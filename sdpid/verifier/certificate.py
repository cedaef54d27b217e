"""Check a certificate: how far given parameters are from the best ones, at most.

What its numbers prove is in `sdpid.verifier.bound`; here claims are compared with that, and put
into words. The file is a JSON object with the keys of `KEYS`, described in
docs/guides/certificate.md.

Cost and bound are of the cost that the file states. Whether that is the cost of some log cannot be
seen without the log. Files of versions 4 and 5 also state how near the two are (``compression``),
what the samples touch (``contacts``) and what the prior believes of pairs (``alike``): they are
read, and this is not used.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

from .bodies import MATRICES, has_margin
from .bound import Proof
from .exact import above
from .reading import (
    REFUSED,
    MalformedError,
    digest,
    index,
    listed,
    names,
    numbers,
    parse,
    require_keys,
    require_schema,
    shown,
    text,
)
from .result import Result

SCHEMA, VERSION, WITH_CONTACTS, WITH_COMPRESSION = "sdpid-certificate", 6, 5, 4
KEYS = (
    *("schema", "version", "metadata", "origin", "problem"),
    *("theta", "multipliers", "claims", "sha256"),
)
_METADATA = ("software", "method", "status", "message")
_ORIGIN = (
    *("robot", "links", "joints", "weighting", "loss", "theta_names", "base_names"),
    *("samples", "rows", "rows_sha256"),
)
# Parameters pass when their cost is proven to be within this share of the global optimum.
GAP = 1e-6

CLAIMS = ("lower_bound", "margins", "violation", "cost", "gap")

# Violations of rows and cones, relative to their size, that are a solver's rounding: some 1e-9 in
# the unit of a row (N·m, kg·m), whose terms may be hundredths. The bound allows for them.
TOLERANCE = Fraction(1e-7)

# More links or conditions are not listed by name.
_MOST_NAMES = 60

# More rows than any log has.
_MOST = 10**15


def load(content: bytes) -> dict[str, Any]:
    """Parse a certificate; MalformedError where it is none of this version."""
    data = parse(content)
    require_schema(data, SCHEMA, VERSION, WITH_CONTACTS, WITH_COMPRESSION)
    more = () if data["version"] == VERSION else ("compression",)
    require_keys(data, (*KEYS, *more), "the certificate")
    return data


def check(data: dict[str, Any]) -> Result:
    """Check the digest and every claim; MalformedError where the data make no sense."""
    try:
        known = (*_ORIGIN, "contacts") if data["version"] == WITH_CONTACTS else _ORIGIN
        require_keys(data["origin"], known, "origin")
        result = prove(data, Proof(data))
        sealed = digest(data) == text(data["sha256"], "sha256")
    except REFUSED as cause:
        raise MalformedError(str(cause) or repr(cause)) from cause
    if sealed:
        return result
    return Result(problems=("the digest is another: something was changed",)) + result


def claimed(data: dict[str, Any]) -> dict[str, float | None]:
    """Return the numbers that a certificate which was checked claims."""
    found = {key: data["claims"][key] for key in ("cost", "lower_bound", "gap")}
    return {**found, "margin": _least(data["claims"])}


def _least(claims: dict[str, Any]) -> float | None:
    """Return the least margin of a link that is claimed."""
    return min((each for each in claims["margins"] or [] if each is not None), default=None)


def prove(data: dict[str, Any], proof: Proof) -> Result:
    """Compare every claim with what was recomputed."""
    claims = require_keys(data["claims"], CLAIMS, "claims")
    require_keys(data["metadata"], _METADATA, "metadata")
    described = _described(data, proof)
    problems, said = list(proof.broken), []
    bound = numbers(claims["lower_bound"])
    if bound > proof.lower_bound:
        problems.append(f"the lower bound {bound!r} is more than is proven")
    elif not proof.broken:
        said.append(f"No feasible parameters cost less than {bound!r}.")
    if proof.theta is None:
        if any(claims[key] is not None for key in CLAIMS[1:]):
            raise MalformedError("claims on parameters that are not given")
        problems.append("no parameters are given: none are shown to be feasible")
        return Result(described + tuple(said), tuple(problems), unchecked(data))
    wrong = infeasible(proof, claims)
    if not wrong:
        said.append(f"The given parameters are feasible: {_feasible(proof, claims)}.")
    said_of_cost, wrong_of_cost = _cost(proof, claims, not (problems or wrong))
    statements = (*described, *said, *said_of_cost)
    return Result(statements, (*problems, *wrong_of_cost, *wrong), unchecked(data))


def _cost(proof: Proof, claims: dict[str, Any], feasible: bool) -> tuple[list[str], list[str]]:
    """Return what is proven of cost and gap, and what is not."""
    if claims["cost"] is None or claims["gap"] is None:
        return [], ["no cost and gap are claimed"]
    bound, cost, gap = (numbers(claims[key]) for key in ("lower_bound", "cost", "gap"))
    said, problems = [], []
    if cost < proof.cost:
        problems.append(f"the cost is {float(proof.cost)!r}, above {cost!r}")
    elif not proof.broken:
        said += [f"They cost at most {cost!r}.", _shares(proof)]
    # Without a division, so that data without errors (cost 0) are no exception.
    unit = "the cost" if cost >= proof.scale else f"{above(proof.scale)!r}, the cost being tiny"
    if Fraction(cost) - Fraction(bound) > Fraction(gap) * max(Fraction(cost), proof.scale):
        problems.append(f"the gap is above {gap!r}")
    elif cost < bound:
        # Of feasible parameters this cannot be.
        problems.append(f"the cost {cost!r} is below the lower bound {bound!r}")
    elif feasible and not problems:
        said.append(f"They are optimal up to a gap of at most {gap!r} times {unit}.")
    return said, problems


def _shares(proof: Proof) -> str:
    """Return what of the cost is of the data, beside what any numbers cost there, in words."""
    prior = f" and {above(proof.prior_cost)!r} for the prior" if proof.prior_cost else ""
    return (
        f"Of it at most {above(proof.data_cost)!r} is on the data{prior}; no numbers at all, "
        f"feasible or not, cost less than {-above(-proof.floor)!r} on the data."
    )


def infeasible(proof: Proof, claims: dict[str, Any]) -> list[str]:
    """Return why theta, which there is, is not shown to obey the constraints."""
    found = []
    ends = zip(proof.lower, proof.theta or [], proof.upper, strict=True)
    for k, (low, value, high) in enumerate(ends):
        if not low <= value <= high:
            found.append(f"parameter {proof.names[k]} is {value!r}, outside [{low!r}, {high!r}]")
    if proof.consistency == "none":
        if claims["margins"] is not None:
            raise MalformedError("margins, and no consistency that they are of")
    else:
        found += _wrong_margins(proof, claims["margins"])
    violation = numbers(claims["violation"])
    if not proof.violation <= violation <= TOLERANCE:
        found.append(
            f"{proof.worst or 'no row or cone'} is violated by {above(proof.violation)!r} of its "
            f"size, {violation!r} is claimed, and at most {float(TOLERANCE):g} is rounding"
        )
    return found


def _wrong_margins(proof: Proof, margins: Any) -> list[str]:
    """Return which links do not have the margins that are claimed, or asked for."""
    found = []
    if type(margins) is not list or len(margins) != proof.links:
        raise MalformedError(f"expected the margins of {proof.links} links")
    for link, (name, margin) in enumerate(zip(proof.link_names, margins, strict=True)):
        body = proof.body(link) or []
        if not has_margin(body, proof.margin, proof.consistency):
            found.append(f"link {name} does not have the margin {float(proof.margin)!r}")
        # A body without a positive mass has no margin.
        elif (margin is None) == (body[0] > 0.0):
            found.append(f"link {name} has a mass of {body[0]!r} and a margin of {margin!r}")
        elif margin is not None and not has_margin(body, numbers(margin), proof.consistency):
            found.append(f"link {name} does not have the margin {margin!r}")
    return found


def _feasible(proof: Proof, claims: dict[str, Any]) -> str:
    """Return what feasible parameters obey, in words."""
    demands = ["bounds"]
    if proof.consistency != "none":
        margin = _least(claims)
        least = "" if margin is None else f", the least margin {margin!r} kg.m2"
        demands.append(f"{proof.consistency} of {proof.links} links{least}")
    if count := len(proof.problem["rows"]) + len(proof.problem["cones"]):
        demands.append(f"{count} rows and cones to within {claims['violation']!r} of their size")
    return "they obey " + ", ".join(demands)


def _described(data: dict[str, Any], proof: Proof) -> tuple[str, ...]:
    """Return what the certificate is of, in words."""
    origin = data["origin"]
    p, b, links = len(proof.c), len(proof.problem["rhs"]), proof.links
    names(origin["base_names"], b, "base_names")
    joints = names(origin["joints"], len(origin["joints"]), "joints")
    loss = "" if origin["loss"] is None else f", loss {shown(text(origin['loss'], 'loss'))}"
    first = (
        f"Robot {shown(text(origin['robot'], 'robot'))}: {links} links "
        f"({listed(proof.link_names, _MOST_NAMES)}), {len(joints)} joints, {p} parameters, "
        f"{p - 10 * links} of them friction and drives, {b} base parameters; "
        f"weighting {shown(text(origin['weighting'], 'weighting'))}{loss}."
    )
    open_ = (
        f"The rows show {b} combinations of the {p} parameters, the base parameters, and no single "
        "masses: these are what prior and constraints leave, and of equals those of a rule, which "
        "only --data with --robot compares.",
    )
    feasible = f"Feasible are parameters with {_constraints(proof)}."
    return first, feasible, *(open_ if b < p else ())


def _constraints(proof: Proof) -> str:
    """Return the constraints of the problem, in words."""
    links, problem = proof.links, proof.problem
    demands = []
    ends = list(zip(proof.lower, proof.upper, proof.names, strict=True))
    if masses := ends[: 10 * links : 10]:
        pairs = [each[:2] for each in masses]
        least, most = usual = max(pairs, key=pairs.count)
        others = [
            f"{n} from {low!r} to {high!r}" for low, high, n in masses if (low, high) != usual
        ]
        but = f", but {listed(others, _MOST_NAMES)}" if others else ""
        demands.append(f"masses from {least!r} to {most!r} kg{but}")
    demands.append(_bounds(proof))
    free = [name for low, _, name in ends[10 * links :] if low < 0.0]
    if of := len(ends) - 10 * links:
        demands.append(f"{len(free)} of {of} of friction and drives may be negative")
    if proof.consistency != "none":
        matrix = MATRICES[proof.consistency]
        demands.append(f"a {matrix} with margin {float(proof.margin)!r} kg.m2 of each link")
    else:
        demands.append("no consistency of the links")
    if further := [shown(each["name"]) for kind in ("rows", "cones") for each in problem[kind]]:
        count = f"{len(problem['rows'])} rows and {len(problem['cones'])} cones"
        demands.append(f"{count}, {listed(further, _MOST_NAMES)}")
    prior = []
    if problem["prior_rhs"]:
        prior.append(f"a prior of {len(problem['prior_rhs'])} rows")
    if problem["entropic_prior"] is not None:
        of = len(problem["entropic_prior"]["links"])
        prior.append(f"a log-det prior of {of} links")
    return "; ".join(demands) + "; the cost has " + (" and ".join(prior) or "no prior")


def _bounds(proof: Proof) -> str:
    """Return how far the bounds leave each parameter free, in words."""
    ends = list(zip(proof.lower, proof.upper, strict=True))
    largest = max((max(-low, high) for low, high in ends), default=0.0)
    fixed = sum(low == high for low, high in ends)
    widths = [(high - low, name) for (low, high), name in zip(ends, proof.names, strict=True)]
    free = [each for each in widths if each[0] > 0.0]
    narrowest = f", the narrowest {min(free)[0]!r} wide ({min(free)[1]})" if free else ""
    return (
        f"every parameter within its bounds, {largest!r} at most in size, {fixed} fixed by them"
        f"{narrowest}"
    )


def unchecked(data: dict[str, Any]) -> tuple[str, ...]:
    """Return what the certificate says of the log and cannot prove."""
    origin = data["origin"]
    samples, rows = (index(origin[key], _MOST) for key in ("samples", "rows"))
    given = origin["rows_sha256"]
    sealed = "" if given is None else f", SHA-256 {shown(text(given, 'rows_sha256'))}"
    return (
        f"that A, rhs, floor and base matrix stand for the {rows} rows of {samples} samples of "
        f"this robot and its log{sealed}: that needs the log",
        "that bounds, margin, rows, cones and prior are what you would ask for",
    )
