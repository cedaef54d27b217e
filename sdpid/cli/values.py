"""Values of options: what the words for them in the help mean, and lists, pairs and terms."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from sdpid.errors import DataError, ModelError

if TYPE_CHECKING:
    from sdpid.robot.friction.term import FrictionTerm


def pairs(values: Iterable[str], option: str) -> dict[str, str]:
    """Split ``key=value`` options.

    Raises
    ------
    DataError
        When one has no ``=``, or a key comes twice.
    """
    split: dict[str, str] = {}
    for text in values:
        key, equals, value = text.partition("=")
        key, value = key.strip(), value.strip()
        if not (equals and key and value):
            raise DataError(f"{option} {text}: expected a quantity, '=' and a value.")
        if key in split:
            raise DataError(f"{option}: {key} is given twice: {split[key]} and {value}.")
        split[key] = value
    return split


def names(text: str, _option: str = "") -> list[str]:
    """Split at commas."""
    return [part.strip() for part in text.split(",")]


def numbers(text: str, option: str, count: int | None = None) -> list[float]:
    """Split numbers at commas.

    Raises
    ------
    DataError
        When one is not a number, or there are not as many as expected.
    """
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        raise DataError(f"{option} {text}: expected numbers with commas between them.") from None
    if count not in (None, len(found)):
        raise DataError(f"{option} {text}: has {len(found)} numbers, expected {count}.")
    return found


def numbers_by_name(values: Iterable[str], option: str) -> dict[str, float]:
    """Split ``name=number`` options."""
    found = pairs(values, option)
    return {key: numbers(value, f"{option} {key}", 1)[0] for key, value in found.items()}


def share(text: str, option: str) -> float:
    """Return a share that is written as a number or in percent: 0.05, 5%.

    Raises
    ------
    DataError
        When it is neither, or negative.
    """
    given = text.strip()
    try:
        value = float(given.removesuffix("%")) / (100.0 if given.endswith("%") else 1.0)
    except ValueError:
        value = float("nan")
    if not 0.0 <= value < float("inf"):
        raise DataError(f"{option} {text}: expected a share such as 5% or 0.05.")
    return value


def friction_terms(
    texts: Sequence[str], option: str = "--friction"
) -> list[str | FrictionTerm] | None:
    """Return friction terms: names, or names with a speed or joints.

    Names that begin with + come after the default terms.

    Raises
    ------
    DataError
        When a speed is no number.
    ModelError
        When a term takes no value, or another number of them, or only some begin with +.
    """
    from sdpid.experiment.preparation.prepare import DEFAULT

    terms = [_term(text.removeprefix("+"), option) for text in texts]
    added = [text for text in texts if text.startswith("+")]
    if added and len(added) < len(terms):
        raise ModelError(
            f"{option} {added[0]}: + adds to the default terms, and others are given without +, "
            "which replace them; write all with + or none."
        )
    return [DEFAULT, *terms] if added else terms or None


def _term(text: str, option: str) -> str | FrictionTerm:
    """Return a friction term."""
    from sdpid.robot.friction.terms import BY_NAME, Coupling

    name, equals, value = text.partition("=")
    if not equals:
        return text
    if name == "coupling" and value.count(",") == 1:
        first, second = names(value)
        return Coupling(first, second)
    fields = {name: term.speed_fields[0] for name, term in BY_NAME.items() if term.speed_fields}
    if name not in fields:
        raise ModelError(
            f"{option} {text}: takes no value; with one there are "
            f"{', '.join(f'{each}=SPEED' for each in fields)} (a speed in rad/s, or fit) and "
            "coupling=JOINT,JOINT."
        )
    speeds = [None] if value == "fit" else numbers(value, f"{option} {name}")
    if len(speeds) != 1:
        raise ModelError(
            f"{option} {text}: has {len(speeds)} speeds; give one, which holds for every joint, or "
            "fit, which chooses one for each."
        )
    return BY_NAME[name](**{fields[name]: speeds[0]})


def _beginning(words: Iterable[str], incomplete: str) -> list[str]:
    """Return the words that begin with what is typed."""
    return [word for word in words if word.startswith(incomplete)]


def _complete_friction(incomplete: str) -> list[str]:
    """Complete the name of a friction term."""
    from sdpid.robot.friction.terms import BY_NAME

    return _beginning([plus + name for plus in ("", "+") for name in BY_NAME], incomplete)


def _complete_kind(incomplete: str) -> list[str]:
    """Complete the kind of a finding."""
    from sdpid.experiment.inspection.inspect import REFUSED

    return _beginning(REFUSED, incomplete)


def _complete_robot(incomplete: str) -> list[str]:
    """Complete the name of a robot; where none begins so, the shell completes files."""
    from sdpid.robot.description.catalog import robot_names

    return _beginning(robot_names(), incomplete)


class ValueKind(NamedTuple):
    """What may be given for an option.

    Attributes
    ----------
    type : type
        What typer makes of the text.
    parse : callable, optional
        What is made of that, with the option's name: a list, or terms.
    more : dict
        Further arguments of typer: a least value, or completions.
    may_be_file : bool
        Whether text may be the name of a file, or something else.
    """

    type: Any = str
    parse: Callable[..., Any] | None = None
    more: dict[str, Any] = {}  # noqa: RUF012 - of a NamedTuple
    may_be_file: bool = False

    @property
    def is_file(self) -> bool:
        """Whether the value names a file or folder, or may do so."""
        return self.type is Path or self.may_be_file


# By the word for a value in the help; text that has none of these is taken as it is.
KINDS = {
    **dict.fromkeys(("FILE", "FOLDER", "LOG", "LOG|FOLDER", "FILE|FOLDER"), ValueKind(Path)),
    **dict.fromkeys(("NAME|FILE", "FILE|none"), ValueKind(may_be_file=True)),
    "ROBOT": ValueKind(more={"autocompletion": _complete_robot}, may_be_file=True),
    **dict.fromkeys(("S", "HZ", "M", "RAD", "KG", "NATS", "X"), ValueKind(float)),
    "N": ValueKind(int),
    "COUNT": ValueKind(int, more={"min": 1}),
    "SEED": ValueKind(int, more={"min": 0}),
    "0,1,2,...": ValueKind(int, more={"min": 0}),
    "A,B,...": ValueKind(parse=names),
    "X,Y,...": ValueKind(parse=numbers),
    "X,Y,Z": ValueKind(parse=lambda text, option: numbers(text, option, 3)),
    "XX,XY,XZ,YY,YZ,ZZ": ValueKind(parse=lambda text, option: numbers(text, option, 6)),
    "KG[,TOL]": ValueKind(parse=numbers),
    "SHARE": ValueKind(parse=share),
    **dict.fromkeys(("QUANTITY=NAME", "QUANTITY=UNIT"), ValueKind(parse=pairs)),
    **dict.fromkeys(("JOINT=X", "DIRECTION=M"), ValueKind(parse=numbers_by_name)),
    "TERM": ValueKind(parse=friction_terms, more={"autocompletion": _complete_friction}),
    "KIND": ValueKind(more={"autocompletion": _complete_kind}),
    **dict.fromkeys(("auto|none|A,B,...", "X|COLUMN"), ValueKind()),
}
