"""Check answers to the question whether any bodies have the numbers of a table.

A file is a JSON object: schema ``sdpid-refutation`` (no bodies have them: an inequality that the
table contradicts) or ``sdpid-realization`` (these have them). Both hold the whole question: robot,
table, coefficients of every parameter in theta, values, halfwidths and constraints. Every number is
text, a decimal or a fraction, and nothing is rounded. What answers prove, and why, stands in
`sdpid.verifier.realizable`.
"""

from __future__ import annotations

import re
from typing import Any

from .bodies import MATRICES
from .decimals import Rationals, decimal_text, linear_text, parameter, rounded
from .reading import (
    REFUSED,
    MalformedError,
    digest,
    index,
    items,
    listed,
    names,
    parse,
    require_keys,
    require_schema,
    shown,
    text,
)
from .realizable import Question, Realization, Refutation, Vector
from .result import Result

REFUTATION, REALIZATION, VERSION = "sdpid-refutation", "sdpid-realization", 2
SCHEMAS = (REFUTATION, REALIZATION)

Answer = Refutation | Realization

_KEYS: tuple[str, ...] = ("schema", "version", "metadata", "sha256")
_KEYS += ("robot", "table", "constraints", "theta_names", "parameters")
LIMITS = ("margin", "mass_min", "mass_max", "theta_max")
PARAMETER = ("name", "coefficients", "value", "halfwidth")
PARTS = {REFUTATION: ("weights", "masses", "slack"), REALIZATION: ("theta", "margins")}

_INDEX = re.compile("0|[1-9][0-9]{0,8}")

# More links than any robot has.
_MOST_LINKS = 1000

# Terms, parameters, signs or faults that are printed; of more, how many there are.
_MOST_SHOWN = 12


def load(content: bytes) -> dict[str, Any]:
    """Parse a file; MalformedError where it is no answer of this version."""
    return require_form(parse(content))


def require_form(data: dict[str, Any]) -> dict[str, Any]:
    """Refuse another schema or version, and keys that are missing or not known."""
    schema = data.get("schema")
    if type(schema) is not str or schema not in SCHEMAS:
        raise MalformedError(f"its schema is none of {', '.join(SCHEMAS)}")
    require_schema(data, schema, VERSION)
    return require_keys(data, [*_KEYS, schema.removeprefix("sdpid-")], "the file")


def answer_of(data: dict[str, Any]) -> Answer:
    """Return what a file holds, not yet judged; MalformedError where it makes no sense."""
    try:
        read = Rationals().read
        question = _question(data, read)
        if data["schema"] == REFUTATION:
            return _refutation(data["refutation"], question, read)
        return _realization(data["realization"], question, read)
    except REFUSED as cause:
        raise MalformedError(str(cause) or repr(cause)) from cause


def _question(data: dict[str, Any], read: Any) -> Question:
    """Return the question of a file."""
    robot = require_keys(data["robot"], ("name", "links"), "robot")
    table = require_keys(data["table"], ("file", "sha256"), "table")
    keys = ("consistency", *LIMITS, "nonnegative")
    limits = require_keys(data["constraints"], keys, "constraints")
    links = items(robot["links"], "the links")
    if not 0 < len(links) <= _MOST_LINKS:
        raise MalformedError(f"it has {len(links)} links")
    entries = items(data["parameters"], "parameters")
    given = [require_keys(one, PARAMETER, "a parameter") for one in entries]
    count = len(theta_names := items(data["theta_names"], "theta_names"))
    if count < 10 * len(links) or not given:
        raise MalformedError("links and parameters do not fit")
    friction = items(limits["nonnegative"], "nonnegative")
    if any(index(j, count) < 10 * len(links) for j in friction):
        raise MalformedError("a sign that physics does not give")
    if limits["consistency"] not in MATRICES:
        raise MalformedError(f"consistency {limits['consistency']!r:.40} is not known")
    question = Question(
        robot=text(robot["name"], "the robot's name"),
        link_names=tuple(names(links, len(links), "the links")),
        table=_text_or_none(table["file"], "the table's file"),
        table_sha256=_text_or_none(table["sha256"], "the table's digest"),
        names=tuple(names([one["name"] for one in given], len(given), "the parameters")),
        rows=tuple(_vector(one["coefficients"], count, read, "a coefficient") for one in given),
        values=tuple(read(one["value"], "a value") for one in given),
        halfwidths=tuple(read(one["halfwidth"], "a halfwidth") for one in given),
        theta_names=tuple(names(theta_names, count, "theta_names")),
        nonnegative=frozenset(friction),
        consistency=limits["consistency"],
        **{key: read(limits[key], key) for key in LIMITS},
    )
    if min(question.margin, *question.halfwidths) < 0:
        raise MalformedError("a margin or a halfwidth is negative")
    if not 0 < question.mass_min <= question.mass_max <= question.theta_max:
        raise MalformedError("not 0 < mass_min <= mass_max <= theta_max")
    return question


def _text_or_none(value: Any, where: str) -> str | None:
    return None if value is None else text(value, where)


def _vector(data: Any, count: int, read: Any, where: str) -> Vector:
    """Return numbers by index, of which there may be none twice."""
    if type(data) is not dict:
        raise MalformedError(f"{where} is no object")
    found = {}
    for key, value in data.items():
        # One way to write an index, so that none stands for another.
        if not _INDEX.fullmatch(key) or int(key) >= count:
            raise MalformedError(f"{where} has an index that is no integer from 0 to {count - 1}")
        found[int(key)] = read(value, where)
    return found


def _refutation(data: Any, question: Question, read: Any) -> Refutation:
    require_keys(data, PARTS[REFUTATION], "the refutation")
    weights = data["weights"]
    if type(weights) is not dict or not weights.keys() <= set(question.names):
        raise MalformedError("a weight belongs to no parameter")
    return Refutation(
        question=question,
        weights={name: read(w, "a weight") for name, w in weights.items()},
        masses=_vector(data["masses"], question.n_links, read, "a multiplier of a mass"),
        slack=_vector(data["slack"], question.n_links, read, "a slack"),
    )


def _realization(data: Any, question: Question, read: Any) -> Realization:
    require_keys(data, PARTS[REALIZATION], "the realization")
    theta, margins = (items(data[key], key) for key in PARTS[REALIZATION])
    if len(theta) != len(question.theta_names) or len(margins) != question.n_links:
        raise MalformedError("theta or margins have another length than their names")
    return Realization(
        question=question,
        theta=tuple(read(x, "theta") for x in theta),
        margins=tuple(read(x, "a margin") for x in margins),
    )


def inequality(proof: Refutation) -> str:
    """Return the inequality of a refutation, and what the table makes of it, in one line."""
    least, most = proof.least, proof.most
    for digits in range(6, 18):
        # Rounded apart, the claims stay true; digits are added until they contradict.
        below, above = rounded(least, digits, up=False), rounded(most, digits, up=True)
        if above < below:
            least, most = below, above
            break
    terms, more = dict(list(proof.weights.items())[:_MOST_SHOWN]), len(proof.weights) - _MOST_SHOWN
    left = linear_text(terms) + (f" and {more} more terms" if more > 0 else "")
    return (
        f"{left} >= {decimal_text(least)} for links that can exist, but "
        f"at most {decimal_text(most)} in the table"
    )


def check(data: dict[str, Any]) -> Result:
    """Check the digest and every claim; MalformedError where the data make no sense."""
    answer = answer_of(data)
    result = _refuted(answer) if isinstance(answer, Refutation) else _realized(answer)
    if digest(data) != data["sha256"]:
        result += Result(problems=("the digest is another: something was changed",))
    return result


def _about(q: Question) -> str:
    """Return the table and the robot in words."""
    file = "given without a file" if q.table is None else shown(q.table)
    sealed = "" if q.table_sha256 is None else f", SHA-256 {shown(q.table_sha256)}"
    return (
        f"Table {file}{sealed}: {len(q.names)} parameters with halfwidths, of robot "
        f"{shown(q.robot)} ({q.n_links} links, {len(q.theta_names)} standard parameters)."
    )


def _constraints(q: Question) -> str:
    """Return what bodies must obey in words."""
    signs = listed((parameter(q.theta_names[j]) for j in sorted(q.nonnegative)), _MOST_SHOWN)
    friction = f"; not negative: {signs}" if signs else ""
    limit = decimal_text(q.theta_max)
    return (
        f"Constraints: every link's {MATRICES[q.consistency]} with a margin of at least "
        f"{decimal_text(q.margin)} kg.m2, its mass from {decimal_text(q.mass_min)} to "
        f"{decimal_text(q.mass_max)} kg, every parameter within {limit}{friction}."
    )


def unchecked(q: Question) -> tuple[str, ...]:
    """Return what these numbers say nothing of; the first is what the robot's kinematics say."""
    where = "what was published" if q.table is None else f"what {shown(q.table)} says"
    return (
        f"that the coefficients are those of robot {shown(q.robot)}: sdpid verify FILE --robot "
        "ROBOT computes them anew",
        f"that values and halfwidths are {where}: compare them",
    )


def _refuted(proof: Refutation) -> Result:
    """Return what a refutation proves."""
    q = proof.question
    said = [_about(q), _constraints(q)]
    problems = []
    if not proof.valid:
        problems.append("the inequality does not follow from the constraints")
    if not proof.most < proof.least:
        problems.append(
            f"the table does not contradict the inequality: at most {decimal_text(proof.most)}, at "
            f"least {decimal_text(proof.least)}"
        )
    if not problems:
        used = (
            ("the bound on masses", proof.uses_mass_bound),
            ("the bound on all parameters", proof.uses_theta_max),
            ("the margin", q.margin > 0 and proof.spread != 0),
        )
        needed = [name for name, is_used in used if is_used] or ["nothing else"]
        said += [
            "No links that obey the constraints have these numbers.",
            f"{inequality(proof)}.",
            f"In the table: {_numbers(q, proof.weights)}.",
            f"The inequality needs the links' consistency and {', '.join(needed)}.",
        ]
    return Result(tuple(said), tuple(problems), unchecked(q))


def _numbers(q: Question, used: Any) -> str:
    """Return the numbers of some parameters in words."""
    given = ((name, *map(decimal_text, q.given[name][1:])) for name in used)
    words = (f"{parameter(name)} = {value} +- {half}" for name, value, half in given)
    return listed(words, _MOST_SHOWN)


def _realized(answer: Realization) -> Result:
    """Return what a realization proves."""
    q = answer.question
    said = [_about(q), _constraints(q)]
    if not answer.faults:
        least = rounded(min(answer.margins), 6, up=False)
        said.append(
            f"The given links obey the constraints and have all {len(q.names)} numbers to within "
            f"their halfwidths; the smallest margin of a link is {decimal_text(least)} kg.m2."
        )
    faults, more = answer.faults[:_MOST_SHOWN], len(answer.faults) - _MOST_SHOWN
    if more > 0:
        faults = [*faults, f"and {more} more"]
    return Result(tuple(said), tuple(faults), unchecked(q))
