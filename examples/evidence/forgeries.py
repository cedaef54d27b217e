"""Try to have something false accepted: forged certificates, and a judge of what the verifier says.

Certificates of certificate_zoo.py are changed in the ways of certificate_mutations.py, one to three
at a time, and half of them then claim what the verifier itself would find, so that the claims fit.
All have a right digest: only what the numbers mean can give them away. Every sentence that
`sdpid.verifier` prints of what it accepts is compared with the file, and every claim is judged by
certificate_judge.py; so are the sentences on files that it does not accept as a whole.

    python examples/evidence/forgeries.py --out results --count 12000 --jobs 2

Ends with status 1 where something false was said, and writes such files to the folder.
"""

from __future__ import annotations

import contextlib
import copy
import json
import math
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

import mpmath as mp
from certificate_judge import Judge, costs, doubles
from certificate_mutations import MUTATIONS, Data
from certificate_zoo import made
from study import Rows, Study

from sdpid.verifier import certificate as checker
from sdpid.verifier.reading import REFUSED, digest

# How sentences that claim something begin, and what is judged of the file where one stands.
CLAIMS = {
    "No feasible parameters cost less than ": "lower bound",
    "The given parameters are feasible: ": "feasible",
    "They cost at most ": "cost",
    "They are optimal up to a gap of at most ": "gap",
}

# Of links with other bounds of their mass so many are named.
LISTED = 60

ANSWERS = ("refused", "not proven", "accepted")

# Each process judges so many forgeries at a time.
CHUNK = 50


@dataclass(frozen=True)
class Outcome:
    """What became of one forgery: refused, not proven or accepted, and what is false of it."""

    number: int
    kinds: tuple[str, ...]
    fitted: bool
    answer: str
    false: tuple[str, ...]
    undecided: tuple[str, ...]
    data: Data | None = None


def forged(
    rng: Random, zoo: dict[str, Data], of: Sequence[str]
) -> tuple[Data, tuple[str, ...], bool]:
    """Return a forgery with a right digest, its mutations, and whether its claims were fitted."""
    while True:
        data = copy.deepcopy(zoo[rng.choice(sorted(zoo))])
        kinds = rng.choices(of, k=rng.choice([1, 1, 1, 2, 3]))
        try:
            changed = [MUTATIONS[kind](rng, data, zoo) for kind in kinds]
        except (LookupError, TypeError, AttributeError, ValueError, OverflowError):
            continue  # a later mutation of what an earlier one has broken
        if any(changed):
            break
    fitted = rng.random() < 0.5 and fit(data)
    with contextlib.suppress(ValueError, OverflowError):
        data["sha256"] = digest(data)
    return data, tuple(kind for kind, done in zip(kinds, changed, strict=True) if done), fitted


def fit(data: Data) -> bool:
    """Claim what the verifier finds, where it can read the file."""
    try:
        proof, claims = checker.Proof(data), data["claims"]
        bound = rounded(proof.lower_bound, -math.inf)
        claims["lower_bound"] = bound
        if proof.theta is not None:
            claims["violation"] = rounded(proof.violation, math.inf)
            claims["cost"] = cost = rounded(proof.cost, math.inf)
            scale = max(Fraction(cost), proof.scale)
            share = (Fraction(cost) - Fraction(bound)) / scale if scale else Fraction(0)
            claims["gap"] = rounded(share, math.inf)
    except REFUSED:
        return False
    return True


def rounded(value: Fraction, toward: float) -> float:
    """Return the next double in a direction."""
    nearest = float(value)
    wrong = Fraction(nearest) > value if toward < 0 else Fraction(nearest) < value
    return math.nextafter(nearest, toward) if wrong else nearest


def judged(judge: Judge, data: Data) -> tuple[str, list[str], list[str]]:
    """Return what the verifier answers, and which of its sentences are false or undecided."""
    content = json.dumps(data).encode()
    try:
        read = checker.load(content)
        result = checker.check(read)
    except REFUSED:
        return "refused", [], []
    answer = "accepted" if result.passed else "not proven"
    said = [CLAIMS[start] for start in CLAIMS for s in result.statements if s.startswith(start)]
    false, undecided = [*wrong_words(result, read), *wrong_shares(result, read)], []
    for claim, (verdict, why) in judge.claims(read, said).items():
        if verdict != "true":
            (false if verdict == "false" else undecided).append(f"{claim}: {why}")
    return answer, false, undecided


def wrong_words(result: Any, data: Data) -> Iterator[str]:
    """Yield what the sentences say that is not so in the file."""
    data = doubles(data)
    claims, problem, origin = data["claims"], data["problem"], data["origin"]
    if not all(
        each.isprintable() for each in (*result.statements, *result.problems, *result.unchecked)
    ):
        yield "a character that a terminal may obey"
    if result.passed and len(said_claims(result)) != 4:
        yield "accepted without a word on bound, parameters, cost and gap"
    for start, claim in CLAIMS.items():
        for each in result.statements if claim != "feasible" else ():
            stated, key = each.removeprefix(start), claim.replace(" ", "_")
            if stated != each and float(stated.split()[0].rstrip(".,:")) != claims[key]:
                yield f"{each} It is {claims[key]!r} in the file"
    links, p = problem["links"], len(problem["lower"])
    masses = range(0, 10 * links, 10)
    rest = "\n".join(result.statements)
    counts = {
        f"{links} links": "links",
        f"{p} parameters": "parameters",
        f"{p - 10 * links} of them friction": "friction terms",
        f"{len(problem['rhs'])} base parameters": "base parameters",
        f"{len(origin['joints'])} joints": "joints",
    }
    if links:
        # Most links have the bounds that are said first; others are named with theirs.
        pairs = [(float(problem["lower"][k]), float(problem["upper"][k])) for k in masses]
        usual = max(pairs, key=pairs.count)
        counts["masses from {!r} to {!r} kg".format(*usual)] = "masses"
        others = [pair for pair in pairs if pair != usual]
        for least, most in others[:LISTED]:
            counts[f" from {least!r} to {most!r}"] = "bounds of one mass"
        if len(others) > LISTED:
            counts[f" and {len(others) - LISTED} more"] = "further bounds of masses"
    if problem["rows"] or problem["cones"]:
        counts[f"{len(problem['rows'])} rows and {len(problem['cones'])} cones"] = "conditions"
    fixed = sum(a == b for a, b in zip(problem["lower"], problem["upper"], strict=True))
    counts[f"{fixed} fixed by them"] = "parameters that their bounds fix"
    if problem["consistency"] != "none":
        counts[f"margin {0.0 + problem['margin']!r} kg.m2 of each link"] = "the margin"
    for words, what in counts.items():
        if words not in rest:
            yield f"nothing said of {what} ({words})"
    if (found := re.search(r"rows and cones to within (\S+) of their size", rest)) and (
        float(found.group(1)) < claims["violation"]
    ):
        yield f"to within {found.group(1)}, but the file claims {claims['violation']!r}"


def wrong_shares(result: Any, data: Data) -> Iterator[str]:
    """Yield what the sentence on the cost says of data and prior that is not so."""
    said = next((s for s in result.statements if s.startswith("Of it at most ")), None)
    if said is None:
        if "cost" in said_claims(result):
            yield "nothing said of the cost on the data"
        return
    data = doubles(data)
    own, beside = costs(data, data["theta"])
    least = mp.mpf(data["problem"]["floor"])
    wanted = re.fullmatch(
        r"Of it at most (\S+) is on the data(?: and (\S+) for the prior)?; no numbers at all, "
        r"feasible or not, cost less than (\S+) on the data.",
        said,
    )
    if wanted is None:
        yield f"words that are not known: {said}"
        return
    # Decimals stand for doubles in the text, too.
    stated = [mp.mpf(float(number or 0)) for number in wanted.groups()]
    true = [own, beside, -least]
    for given, share in zip([*stated[:2], -stated[2]], true, strict=True):
        if given < share:
            yield f"{said} But there are {mp.nstr(share, 17)} for {mp.nstr(given, 17)}"


def said_claims(result: Any) -> set[str]:
    """Return which claims a result states."""
    return {CLAIMS[start] for start in CLAIMS for s in result.statements if s.startswith(start)}


def some(
    numbers: range, seed: int, zoo: dict[str, Data], of: Sequence[str] = tuple(sorted(MUTATIONS))
) -> list[Outcome]:
    """Make and judge forgeries by number, of some kinds of mutation."""
    judge, out = Judge(), []
    for number in numbers:
        data, kinds, fitted = forged(Random(f"{seed} {number}"), zoo, of)
        answer, false, undecided = judged(judge, data)
        kept = data if false or undecided else None
        out.append(Outcome(number, kinds, fitted, answer, tuple(false), tuple(undecided), kept))
    return out


def rows_of(first: int, count: int, zoo: dict[str, Data], out: Path) -> Rows:
    """Yield the rows of forgeries, of several kinds one each, and write what is wrong of them."""
    for each in some(range(first, min(first + CHUNK, count)), 0, zoo):
        if each.data is not None:
            kind, words = ("false", each.false) if each.false else ("undecided", each.undecided)
            print(f"{kind} {each.number} ({', '.join(each.kinds)}): {'; '.join(words)}", flush=True)
            path = out / f"{kind}_{each.number}.json"
            path.write_text(json.dumps(each.data), encoding="utf-8")
        for kind in {*each.kinds, "all"}:
            answers = (each.answer == answer for answer in ANSWERS)
            yield kind, *answers, bool(each.undecided), bool(each.false)


def main() -> int:
    """Make forgeries, and judge what is said of them."""
    study = Study(__doc__, quick={"count": 200}, count=12_000, jobs=1)
    work = partial(rows_of, count=study.count, zoo=made(study.quick), out=study.out)
    columns = ("mutation", *ANSWERS, "undecided", "false")
    chunks = range(0, study.count, CHUNK)
    found = study.rows("each.csv", columns, work, chunks, jobs=study.jobs)
    found.sort(key=lambda row: str(row["mutation"]))
    counts = {"forgeries": "count accepted"} | {each: f"sum {each}" for each in columns[1:]}
    study.summary("forgeries.csv", found, columns[:1], counts)
    return int(any(row["false"] for row in found))


if __name__ == "__main__":
    sys.exit(main())
