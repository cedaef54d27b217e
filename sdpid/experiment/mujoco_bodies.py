"""The bodies of an MJCF file as they are written, through MuJoCo's own parser."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._arrays import frozen
from sdpid._extras import require
from sdpid.errors import ModelError
from sdpid.robot.described import DescribedBody

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
    mujoco = require("mujoco", extra="sim")
    try:
        if path is None:
            spec = mujoco.MjSpec.from_string(text)
        else:
            spec = mujoco.MjSpec.from_file(str(path))
    except (ValueError, RuntimeError) as cause:
        raise ModelError(f"{what}: MuJoCo cannot parse it ({cause}).") from None
    carriers: dict[str, _Place] = {}
    bodies = []
    for number, body in enumerate(spec.bodies):
        if number == 0:
            continue  # the world
        name = body.name or f"body {number}"
        carriers[name] = _carrier(body, name, carriers)
        bodies.append(_described(body, name, *carriers[name]))
    if not bodies:
        raise ModelError(f"{what}: has no bodies.")
    return tuple(bodies)


# Carrier, the joint that moves it, and what is on that joint's other side.
_Place = tuple[str, str | None, str | None]


def _carrier(body: Any, name: str, known: dict[str, _Place]) -> _Place:
    parent = body.parent.name
    if len(body.joints):
        return name, body.joints[0].name or f"joint of {name}", parent
    return known.get(parent, (name, None, None))


def _described(
    body: Any, name: str, carrier: str, joint: str | None, parent: str | None
) -> DescribedBody:
    place: dict[str, Any] = {
        "name": name,
        "moving": joint is not None,
        "carrier": carrier,
        "joint": joint,
        "parent": parent,
    }
    if not body.explicitinertial:
        return DescribedBody(described=False, inferred=len(body.geoms) > 0, **place)
    full = np.array(body.fullinertia, dtype=np.float64)
    if np.isnan(full[0]):
        moments = [float(x) for x in body.inertia]
        values = [moments[0], 0.0, moments[1], 0.0, 0.0, moments[2]]
    else:
        values = [float(full[k]) for k in _FULL]
    problems = []
    mass, com = float(body.mass), np.array(body.ipos, dtype=np.float64)
    if not np.isfinite(values).all():
        problems.append("the inertia is missing or no finite numbers")
    if not np.isfinite([mass, *com]).all():
        problems.append("mass or centre of mass are missing or no finite numbers")
    return DescribedBody(
        described=True,
        mass=mass if np.isfinite(mass) else None,
        com=frozen(com) if np.isfinite(com).all() else None,
        entries=None if problems else tuple(Fraction(x) for x in values),
        problems=tuple(problems),
        **place,
    )
