"""The links of the chain from a log to a bound, and what a check found of each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from sdpid.assurance.log_proof.chain.totals import Totals
from sdpid.estimation.problem import Problem
from sdpid.verifier.exact import above
from sdpid.verifier.result import Result

State = Literal["proven", "not proven", "not checked"]


@dataclass(frozen=True)
class Link:
    """One link of the chain.

    Attributes
    ----------
    name : str
        Which: log, robot, samples, base parameters, compression, rows or total.
    state : {"proven", "not proven", "not checked"}
        What was found.
    text : str
        Why, with the numbers.
    """

    name: str
    state: State
    text: str


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """What is proven of one cost, rounded outward.

    Attributes
    ----------
    cost : float or None
        The given parameters cost at most this; None where that is not shown.
    lower_bound : float
        No feasible parameters cost less.
    gap : float or None
        The one above the other, relative to the cost (see `Certificate.gap`).
    data, prior : float or None, float
        What of the cost is at most of the rows, and at most of the prior.
    """

    cost: float | None
    lower_bound: float
    gap: float | None
    data: float | None
    prior: float

    @classmethod
    def of(cls, totals: Totals) -> Bounds:
        """Round outward."""
        return cls(
            cost=None if totals.cost is None else above(totals.cost),
            lower_bound=-above(-totals.lower_bound),
            gap=None if totals.gap is None else above(totals.gap),
            data=None if totals.data is None else above(totals.data),
            prior=above(totals.prior),
        )

    def __str__(self) -> str:
        what = "rows and prior together cost" if self.prior else "the rows cost"
        bound = f"no less than {self.lower_bound!r} at any feasible ones"
        if self.cost is None:
            return f"{what} {bound}; at the given parameters no cost is shown"
        shares = f" (rows {self.data!r}, prior {self.prior!r})" if self.prior else ""
        gap = f": a gap of at most {self.gap!r}"
        return f"{what} at most {self.cost!r} at the given parameters{shares}, {bound}{gap}"


@dataclass(frozen=True, kw_only=True)
class LogProof:
    """What a log proves of a result, link by link.

    Attributes
    ----------
    links : tuple of Link
        From the file to the bound.
    relative, absolute : float or None
        The cost of the rows is within this share, plus this constant, of the compressed one.
    row_error : float or None
        By how much the root of the cost of the robot's equations differs from that of the rows.
    roles : tuple of str
        Inputs of the run that were compared: the log, and the robot's description where it was at
        hand.
    problem : Problem or None
        The problem, made of the logs as the recipe says; None where that could not be.
    rows, equations : Bounds or None
        On the rows of this log as computed, and on those of the robot's equations of motion.
    """

    links: tuple[Link, ...]
    roles: tuple[str, ...] = ("log",)
    relative: float | None = None
    absolute: float | None = None
    row_error: float | None = None
    problem: Problem | None = None
    rows: Bounds | None = None
    equations: Bounds | None = None

    @property
    def proven(self) -> set[str]:
        """Names of the links that are proven, but for what is named as not checked."""
        states: dict[str, set[str]] = {}
        for each in self.links:
            states.setdefault(each.name, set()).add(each.state)
        return {name for name, found in states.items() if found - {"not checked"} == {"proven"}}

    @property
    def result(self) -> Result:
        """The links as sentences."""
        texts = {
            state: tuple(f"{each.name}: {each.text}" for each in self.links if each.state == state)
            for state in ("proven", "not proven", "not checked")
        }
        return Result(texts["proven"], texts["not proven"], texts["not checked"])
