"""Read the inertials of an MJCF file as written, by MuJoCo's parser."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.arrays import frozen
from sdpid.errors import ModelError
from sdpid.robot.description.bodies import DescribedBody
from sdpid.robot.description.mjcf import in_child, parsed

# MuJoCo's order of a full tensor, in ours: xx, xy, yy, xz, yz, zz.
_FULL = (0, 3, 1, 4, 5, 2)


def read_mjcf_bodies(text: str, path: Path | None, what: str) -> tuple[DescribedBody, ...]:
    """Return the bodies of an MJCF file that have an explicit inertial.

    MuJoCo makes the others from their shapes when it compiles, which are then consistent by what
    they are made of; they come without numbers. Shapes are not looked at.

    Parameters
    ----------
    text : str
        The file.
    path : Path or None
        Where it is, for what it includes.
    what : str
        What it is called in messages.

    Raises
    ------
    ModelError
        When MuJoCo cannot parse it.
    MissingExtraError
        When MuJoCo is not installed (extra ``sim``).
    """
    found = in_child(_bodies, text, None if path is None else str(path.resolve()), what=what)
    if not found:
        raise ModelError(f"{what}: has no bodies.")
    return tuple(_described(body) for body in found)


def _bodies(text: str, path: str | None, what: str) -> list[dict[str, Any]]:
    """Return the bodies of a file as plain values, in a child process."""
    carriers: dict[str, _Place] = {}
    bodies = []
    # Bodies do not keep what owns them alive in MuJoCo 3.3.7.
    spec = parsed(text, path, what)
    for number, body in enumerate(spec.bodies):
        if number == 0:
            continue  # the world
        name = str(body.name or f"body {number}")
        carriers[name] = _carrier(body, name, carriers)
        full = [float(x) for x in np.ravel(body.fullinertia)]
        moments = [float(x) for x in np.ravel(body.inertia)]
        diagonal = [moments[0], 0.0, moments[1], 0.0, 0.0, moments[2]]
        bodies.append(
            {
                "name": name,
                "place": carriers[name],
                "explicit": bool(body.explicitinertial),
                "geoms": len(body.geoms),
                "mass": float(body.mass),
                "com": [float(x) for x in np.ravel(body.ipos)],
                "inertia": diagonal if np.isnan(full[0]) else [full[k] for k in _FULL],
            }
        )
    return bodies


# Carrier, the joint that moves it, and that joint's parent body.
_Place = tuple[str, str | None, str | None]


def _carrier(body: Any, name: str, known: dict[str, _Place]) -> _Place:
    parent = body.parent.name
    if len(body.joints):
        return name, body.joints[0].name or f"joint of {name}", parent
    return known.get(parent, (name, None, None))


def _described(body: Mapping[str, Any]) -> DescribedBody:
    carrier, joint, parent = body["place"]
    place: dict[str, Any] = {
        "name": body["name"],
        "moving": joint is not None,
        "carrier": carrier,
        "joint": joint,
        "parent": parent,
    }
    if not body["explicit"]:
        return DescribedBody(described=False, inferred=body["geoms"] > 0, **place)
    problems = []
    mass, com, values = body["mass"], np.array(body["com"]), body["inertia"]
    if not np.isfinite(values).all():
        problems.append("the inertia is missing or no finite numbers")
    if not np.isfinite([mass, *com]).all():
        problems.append("mass or center of mass are missing or no finite numbers")
    return DescribedBody(
        described=True,
        mass=mass if np.isfinite(mass) else None,
        com=frozen(com) if np.isfinite(com).all() else None,
        entries=None if problems else tuple(Fraction(x) for x in values),
        problems=tuple(problems),
        **place,
    )
