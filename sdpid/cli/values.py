"""Values of options that are written as text: lists, pairs, friction terms."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from sdpid.errors import DataError, ModelError

if TYPE_CHECKING:
    from sdpid.robot.friction.term import FrictionTerm


def pairs(values: Iterable[str] | None, option: str) -> dict[str, str]:
    """Split ``key=value`` options.

    Raises
    ------
    DataError
        When one has no ``=``, or a key comes twice.
    """
    split: dict[str, str] = {}
    for text in values or ():
        key, equals, value = text.partition("=")
        key, value = key.strip(), value.strip()
        if not (equals and key and value):
            raise DataError(f"{option} {text}: expected a quantity, '=' and a value.")
        if key in split:
            raise DataError(f"{option}: {key} is given twice: {split[key]} and {value}.")
        split[key] = value
    return split


def split_list(text: str) -> list[str]:
    """Split at commas."""
    return [part.strip() for part in text.split(",")]


def numbers(text: str, option: str) -> list[float]:
    """Split numbers at commas.

    Raises
    ------
    DataError
        When one is not a number.
    """
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise DataError(f"{option} {text}: expected numbers with commas between them.") from None


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


def friction_terms(texts: list[str] | None) -> list[str | FrictionTerm] | None:
    """Return the terms of ``--friction``: names, or names with a speed or joints.

    Names that begin with + come after the default terms.

    Raises
    ------
    DataError
        When a speed is no number.
    ModelError
        When a term takes no value, or another number of them, or only some begin with +.
    """
    from sdpid.experiment.preparation.default_friction import DEFAULT
    from sdpid.robot.friction.terms import (
        AsymmetricCoulomb,
        Coulomb,
        Coupling,
        SigmoidFriction,
        Stribeck,
    )

    with_speed: dict[str, Callable[[float | None], FrictionTerm]] = {
        "coulomb": lambda width: Coulomb(width=width),
        "asymmetric_coulomb": lambda width: AsymmetricCoulomb(width=width),
        "stribeck": lambda speed: Stribeck(velocity=speed),
        "sigmoid": lambda speed: SigmoidFriction(velocity=speed),
    }
    added = [text for text in texts or () if text.startswith("+")]
    if added and len(added) < len(texts or ()):
        raise ModelError(
            f"--friction {added[0]}: + adds to the default terms, and others are given without +, "
            "which replace them; write all with + or none."
        )
    terms: list[str | FrictionTerm] = [DEFAULT] if added else []
    for given in texts or ():
        text = given.removeprefix("+")
        name, equals, value = text.partition("=")
        if not equals:
            terms.append(text)
        elif name in with_speed:
            speeds = [None] if value == "fit" else numbers(value, f"--friction {name}")
            if len(speeds) != 1:
                raise ModelError(
                    f"--friction {text}: has {len(speeds)} speeds; give one, which holds for every "
                    "joint, or fit, which chooses one for each."
                )
            terms.append(with_speed[name](speeds[0]))
        elif name == "coupling" and value.count(",") == 1:
            first, second = split_list(value)
            terms.append(Coupling(first, second))
        else:
            raise ModelError(
                f"--friction {text}: takes no value; with one there are coulomb=WIDTH, "
                "asymmetric_coulomb=WIDTH, stribeck=SPEED, sigmoid=SPEED (a speed in rad/s, or "
                "fit) and coupling=JOINT,JOINT."
            )
    return terms or None
