"""What a run is for: the functions of the base parameters that are to be known well."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid.errors import DataError
from sdpid.excitation.criterion.belief import nominal_bodies, usual_effort
from sdpid.excitation.criterion.rows import BaseRows
from sdpid.robot.model.model import independent_rows

PURPOSES = ("all", "payload", "friction", "gravity", "torque")

# Postures at which gravity's efforts are to be known, drawn within the position limits.
_POSTURES, _SEED = 400, 20210621

# Directions that matter less than this, beside the one that matters most, do not count.
_NEGLIGIBLE = 1e-9

# States whose rows are made at a time.
_TOGETHER = 1000


@dataclass(frozen=True, kw_only=True, eq=False)
class Purpose:
    """What a run is for.

    Base parameters are ``known + directions @ x`` with x unknown; what counts are the functions
    ``functionals @ x``.

    Attributes
    ----------
    name : str
        One of `PURPOSES`.
    directions : ndarray, shape (b, r)
        How the unknown numbers move the base parameters; E where all are unknown.
    functionals : ndarray, shape (k, r)
        What is to be known, in units in which all are worth alike where they have a common unit.
    kind : {"volume", "sum"}
        Whether the logarithm of the volume of their errors counts (units do not matter), or the
        sum of their variances.
    """

    name: str
    directions: Array
    functionals: Array
    kind: Literal["volume", "sum"]


def purpose_of(
    name: str, rows: BaseRows, *, motion: tuple[Array, Array, Array] | None = None
) -> Purpose:
    """Return what counts for a purpose.

    Parameters
    ----------
    name : {"all", "payload", "friction", "gravity", "torque"}
        ``all``: every base parameter. ``payload``: the ten parameters of the last link, the other
        links and friction known. ``friction``: the friction terms. ``gravity``: the efforts that
        hold the robot still, over its range. ``torque``: the efforts of a motion.
    rows : BaseRows
        The robot, its friction terms and base parameters.
    motion : (position, velocity, acceleration), optional
        States (K, n) for ``torque``.

    Raises
    ------
    DataError
        When there is no such purpose, or ``torque`` has no motion, or nothing counts.
    """
    if name not in PURPOSES:
        raise DataError(f"purpose: is {name!r}; use one of {', '.join(PURPOSES)}.")
    robot, base = rows.robot, rows.base
    every, links = np.eye(base.count), 10 * robot.n_links
    if name == "all":
        return _made(name, every, every, "volume")
    if name == "payload":
        body = base.matrix[:, links - 10 : links]
        held = body[:, independent_rows(body.T, range(10))]
        return _made(name, held, np.eye(held.shape[1]), "volume")
    if name == "friction":
        own = np.flatnonzero(base.kept >= links)
        if not own.size:
            raise DataError("purpose: is 'friction', but there are no friction terms; name some.")
        return _made(name, every, every[own], "volume")
    if name == "gravity":
        low, high = robot.position_limits.T
        low, high = (
            np.where(np.isfinite(low), low, -np.pi * robot.gears),
            np.where(np.isfinite(high), high, np.pi * robot.gears),
        )
        q = np.random.default_rng(_SEED).uniform(low, high, (_POSTURES, robot.n))
        still = np.zeros_like(q)
        # At rest friction is what it was: it tells nothing, and nothing is asked of it.
        functionals = effort_functionals(rows, q, still, still)
        functionals[:, base.kept >= links] = 0.0
        return _made(name, every, functionals, "sum")
    if motion is None:
        raise DataError(
            "purpose: is 'torque'; give the motion whose efforts are to be predicted (predict=, or "
            "--predict)."
        )
    return _made(name, every, effort_functionals(rows, *motion), "sum")


def effort_functionals(
    rows: BaseRows, q: Array, v: Array, a: Array, scale: Array | None = None
) -> Array:
    """Return L (b, b) such that ``tr(L·C·L^T)`` is the mean variance of efforts, over the joints.

    Parameters
    ----------
    rows : BaseRows
        What the efforts are those of.
    q, v, a : ndarray, shape (K, n)
        The states.
    scale : ndarray, shape (n,), optional
        Efforts are counted in units of these, N·m; by default each joint's usual effort on these
        states: the geometric mean of its rms and the largest one, by the robot's description.
    """
    if scale is None:
        effort = rows.robot.inverse_dynamics(nominal_bodies(rows.robot)[0], q, v, a)
        scale = usual_effort(np.sqrt(np.mean(effort**2, axis=0)))
    mean = np.zeros((rows.count, rows.count))
    for k in range(0, len(q), _TOGETHER):
        W = rows.rows(*(each[k : k + _TOGETHER] for each in (q, v, a))) / scale[:, None]
        flat = W.reshape(-1, rows.count)
        mean += flat.T @ flat / (len(q) * len(scale))
    values, vectors = np.linalg.eigh(mean)
    return np.asarray(np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T)


def _made(
    name: str, directions: Array, functionals: Array, kind: Literal["volume", "sum"]
) -> Purpose:
    size = np.linalg.norm(functionals, axis=1)
    kept = functionals[size > _NEGLIGIBLE * size.max(initial=0.0)]
    if not len(kept):
        raise DataError(
            f"purpose: is '{name}', and none of the robot's {len(directions)} base parameters "
            "counts for it; choose another, or all."
        )
    return Purpose(name=name, directions=frozen(directions), functionals=frozen(kept), kind=kind)
