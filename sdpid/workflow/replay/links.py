"""The links from a log to the files of a folder, and what was found of each."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

State = Literal["made again", "not made again", "not checked"]


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


@dataclass(frozen=True, kw_only=True)
class Replay:
    """What a log and a robot show of a folder of results, link by link.

    Attributes
    ----------
    links : tuple of Link
        From the log to the files.
    distance : float or None
        The cost of the rows is within this share of the certificate's, for all parameters; None
        where there are no rows.
    gap : float or None
        The certificate's gap with this distance; None without either.
    roles : tuple of str
        Inputs of the run that were compared: the log, and the robot's description where it was at
        hand.
    """

    links: tuple[Link, ...]
    distance: float | None = None
    gap: float | None = None
    roles: tuple[str, ...] = ("log",)

    @property
    def unchecked(self) -> tuple[str, ...]:
        """What was not made again, for want of something, in words."""
        return told(self.links, "not checked")

    @property
    def complete(self) -> set[str]:
        """Names of the links that were made again, all that was said of them."""
        wrong = {each.name for each in self.links if each.state == "not made again"}
        return {each.name for each in self.links if each.state == "made again"} - wrong


def told(links: Iterable[Link], state: State) -> tuple[str, ...]:
    """Return the sentences of the links with a state."""
    return tuple(f"{each.name}: {each.text}" for each in links if each.state == state)


def by_file(found: Iterable[Link]) -> list[Link]:
    """Return links of which those that say the same have all their names in one."""
    names: dict[tuple[State, str], list[str]] = {}
    for each in found:
        names.setdefault((each.state, each.text), []).append(each.name)
    return [Link(", ".join(own), state, text) for (state, text), own in names.items()]
