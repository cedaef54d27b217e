"""A plan in words: what to run, how safe it is, what it will buy."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from sdpid.excitation.limits.check import LimitCheck, LimitRow
from sdpid.excitation.plan.plan import Plan
from sdpid.output.charts.page import number


@dataclass(frozen=True)
class Tile:
    """A number at the head of the page.

    Attributes
    ----------
    name, value : str
        What it is, and the number.
    level : str
        ``"good"``, ``"bad"`` or empty.
    """

    name: str
    value: str
    level: str = ""


def tiles(plan: Plan) -> Iterator[Tile]:
    """Yield the numbers at the head of the page."""
    yield Tile("to run", f"{plan.trajectory.duration:.4g} s")
    verdict = "held" if plan.limits.ok else "not held"
    yield Tile("every limit, at every instant", verdict, "good" if plan.limits.ok else "bad")
    yield Tile("condition number", number(plan.condition_number))
    yield Tile("log det of the information", number(plan.log_det))
    yield Tile("base parameters", str(len(plan.names)))


def sentences(plan: Plan) -> Iterator[tuple[str, str, str]]:
    """Yield the plan in short: a level, a title and a sentence each."""
    yield "good", "Run", run_sentence(plan)
    yield "good" if plan.limits.ok else "bad", "Safe", safe_sentence(plan.limits)
    told = plan.expected.sentences()
    # One band of efforts stands for all; then parameters, friction, and what stays open.
    for text in (*told[:1], *told[len(plan.expected.bands) :]):
        yield "good", "What it will buy", text
    if assumed := len(plan.limits.notes):
        yield (
            "caution",
            "Careful",
            f"{assumed} thing{' was' if assumed == 1 else 's were'} assumed about limits, torques "
            "and shapes: read them before the run.",
        )


def run_sentence(plan: Plan) -> str:
    """Return what to run, and for how long."""
    motion = plan.trajectory
    lasts = f"{motion.duration:.4g} s at {motion.rate_hz:g} samples a second"
    if motion.periods > 1:
        lasts += f", {motion.periods} times the same {motion.period:.4g} s"
    repeat = (
        "it ends where it starts, at rest, so that it can be repeated and averaged"
        if motion.closed
        else "it ends at rest in another position than it starts from"
    )
    return f"trajectory.csv, {lasts}, from rest; {repeat}. Log positions and efforts meanwhile."


def safe_sentence(check: LimitCheck) -> str:
    """Return whether the limits hold, with the least slack of each kind."""
    if not check.ok:
        return f"Not every limit is proven to hold: {' '.join(check.sentences()[:_FEW])}"
    # Distances are checked last, and told first.
    kinds = dict.fromkeys(row.kind for row in reversed(check.rows))
    least = [row for kind in kinds if (row := check.least(kind)) is not None]
    return f"Every limit holds at every instant: {'; '.join(map(_slack, least))}.{_closer(check)}"


def _slack(row: LimitRow) -> str:
    """Return who comes nearest to a limit, and what is left to it."""
    if row.kind != "distance":
        limit = "the end of its range" if row.kind == "position" else f"its {row.kind} limit"
        return f"{row.subject} stays {row.slack:.3g} {row.unit} from {limit}"
    first, _, second = row.subject.partition(" – ")
    the = "the " * second.startswith(("table", "wall"))
    return (
        f"{1e3 * row.worst:.3g} mm kept everywhere, nearest {first} to {the}{second}, "
        f"{1e3 * row.limit:.3g} mm asked for"
    )


def _closer(check: LimitCheck) -> str:
    """Return how many pairs were asked for less than the clearance, as words to add."""
    asked = [row.limit for row in check.rows if row.kind == "distance"]
    less = sum(limit < max(asked) for limit in asked)
    if not less:
        return ""
    pairs = "1 pair is" if less == 1 else f"{less} pairs are"
    return f" {pairs} built too close for {1e3 * max(asked):.3g} mm and asked for less."


# Limits that are not held, of which a sentence tells.
_FEW = 4
