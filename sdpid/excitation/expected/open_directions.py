"""Which directions of the base parameters a run leaves open, and why.

A direction is open where the run tells less of it than was believed before, or where nothing was
believed, less than a thousandth of what it tells of the best one. Why is found by trial: the same
motion with one joint moving half as far again, faster in all joints, or longer. What sharpens the
direction most is what is missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from sdpid._common.arrays import Array
from sdpid.estimation.information import WEAK
from sdpid.excitation.criterion.rows import BaseRows
from sdpid.excitation.limits.joint_limits import JointLimits

# At most so many directions are told apart.
_MOST = 12

# A parameter belongs to a direction when its share of the unit vector is at least this.
_SHARE = 0.3

# What is tried: one joint's range, the speed of all, or the duration, by this factor.
_FACTOR = 1.5

# States looked at.
_STATES = 400

# A motion uses a limit that it reaches to this share.
_REACHED = 0.9

# More than this many times what a longer run would bring, and another cause is named; within this
# factor of more speed, more range is.
_CLEAR = 1.15


# States (position, velocity, acceleration), (K, n) each.
States: TypeAlias = tuple[Array, Array, Array]

# What is changed about a motion, and of which joint.
Change: TypeAlias = tuple[str, "str | None"]


@dataclass(frozen=True, kw_only=True)
class OpenDirection:
    """A direction of the base parameters that a run leaves open.

    Attributes
    ----------
    parameters : tuple of str
        What it is made of, the largest share first.
    shares : tuple of float
        Their shares of the direction.
    told : float
        Standard deviation left, of that before the run; of directions of which nothing was
        believed, what the run tells beside the best one (a singular value).
    cause : {"range", "speed", "time"}
        What is missing.
    joint : str or None
        Whose range.
    reason : str
        What is missing, in words.
    words : str
        All of this in a sentence.
    """

    parameters: tuple[str, ...]
    shares: tuple[float, ...]
    told: float
    cause: str
    joint: str | None
    reason: str
    words: str


def open_directions(
    rows: BaseRows,
    motion: States,
    *,
    density: Array,
    information: Array,
    believed: Array,
    limits: JointLimits | None = None,
) -> tuple[OpenDirection, ...]:
    """Return the directions that a run leaves open, the worst first.

    Parameters
    ----------
    rows : BaseRows
        The regressor.
    motion : (position, velocity, acceleration)
        States (K, n) of the run.
    density : ndarray, shape (n,)
        Of the noise.
    information, believed : ndarray, shape (b, b)
        What run and earlier runs tell, and what a prior does.
    limits : JointLimits, optional
        Those of the motion.
    """
    from scipy.linalg import eigh

    told, known = np.diag(information), np.diag(believed)
    # Units: what is believed of each parameter; where nothing is, what the run tells of it.
    weak = np.maximum(told, WEAK**2 * told.max(initial=0.0))
    unit = 1.0 / np.sqrt(known + np.where(known > 0.0, 0.0, weak))
    data, prior = (each * np.outer(unit, unit) for each in (information, believed))
    free = np.diag(np.where(known > 0.0, 0.0, WEAK**2))
    # Information of the run per information before it: below one the run tells less.
    values, vectors = eigh(data, prior + free + 1e-12 * np.eye(len(data)))
    found = np.flatnonzero(values < 1.0)[:_MOST]
    gains = _gains(rows, motion, density) if found.size else {}
    out = []
    for k in found:
        shares = vectors[:, k] / np.linalg.norm(vectors[:, k])
        largest = np.argsort(-np.abs(shares))[:3]
        order = [i for n, i in enumerate(largest) if n == 0 or abs(shares[i]) >= _SHARE]
        cause, joint = _cause(gains, unit * vectors[:, k])
        left = float(1.0 / np.sqrt(1.0 + max(values[k], 0.0)))
        names = tuple(rows.base.names[i] for i in order)
        reason = _reason(rows.robot.joint_names, motion, limits, cause, joint)
        out.append(
            OpenDirection(
                parameters=names,
                shares=tuple(float(shares[i]) for i in order),
                told=left,
                cause=cause,
                joint=joint,
                reason=reason,
                words=_words(names, left, bool(np.all(known[order] > 0.0)), reason),
            )
        )
    return tuple(out)


def _gains(rows: BaseRows, motion: States, density: Array) -> dict[Change, Array]:
    """Return the information (b, b) of the motion and of others, by what they change."""

    def information(q: Array, v: Array, a: Array) -> Array:
        W = (rows.rows(q, v, a) / np.sqrt(density)[:, None]).reshape(-1, rows.count)
        return np.asarray(W.T @ W / len(q))

    step = max(1, len(motion[0]) // _STATES)
    q, v, a = (each[::step] for each in motion)
    middle = q.mean(axis=0)
    gains: dict[Change, Array] = {}
    gains["time", None] = _FACTOR * information(q, v, a)
    gains["speed", None] = information(q, _FACTOR * v, _FACTOR**2 * a)
    for j, name in enumerate(rows.robot.joint_names):
        factor = np.ones(q.shape[1])
        factor[j] = _FACTOR
        gains["range", name] = information(middle + factor * (q - middle), factor * v, factor * a)
    return gains


def _cause(gains: dict[Change, Array], direction: Array) -> Change:
    """Return what sharpens a direction most: more range of a joint, more speed, or more time."""
    told = {key: float(direction @ value @ direction) for key, value in gains.items()}
    longer, faster = told.pop(("time", None)), told.pop(("speed", None))
    best = max(told, key=lambda key: told[key])
    gain = told[best]
    if faster >= _CLEAR * gain:
        best, gain = ("speed", None), faster
    return best if longer > 0.0 and gain > _CLEAR * longer else ("time", None)


def _words(names: Sequence[str], left: float, believed: bool, reason: str) -> str:
    """Return an open direction in a sentence."""
    what = names[0] if len(names) == 1 else f"a mixture of {', '.join(names)}"
    known = (
        f"{100.0 * left:.0f} % of what was uncertain before the run stays so"
        if believed
        else "the run tells next to nothing of it, and nothing was known before"
    )
    return f"{what}: {known}; {reason}"


def _reason(
    names: Sequence[str],
    motion: States,
    limits: JointLimits | None,
    cause: str,
    joint: str | None,
) -> str:
    """Return what is missing, and which limit stands in the way."""
    if cause == "time":
        return "a longer run, or less noise, is what helps"
    q, v, a = motion
    if joint is None:
        if limits is None:
            return "faster motion is what helps"
        reached = []
        for kind, used, limit in (
            ("speed", v, limits.velocity),
            ("acceleration", a, limits.acceleration),
        ):
            at = np.abs(used).max(axis=0) >= _REACHED * limit
            which = [name for name, is_there in zip(names, at, strict=True) if is_there]
            if which:
                reached.append(f"{kind} of {'all joints' if at.all() else ', '.join(which)}")
        full = f"the limits on {' and '.join(reached)} are" if reached else "no limit on either is"
        return f"faster motion is what helps, and {full} reached"
    j = names.index(joint)
    span = float(np.ptp(q[:, j]))
    if limits is None:
        return f"a wider motion of {joint} (now {span:.3g} rad) is what helps"
    allowed = float(limits.upper[j] - limits.lower[j])
    if span >= _REACHED * allowed:
        return (
            f"a wider motion of {joint} is what helps, and its position limits "
            f"({limits.lower[j]:.3g} to {limits.upper[j]:.3g} rad) are reached"
        )
    return (
        f"a wider motion of {joint} is what helps, which uses {span:.3g} of {allowed:.3g} rad: "
        "other limits, or other parameters, stand in the way"
    )
