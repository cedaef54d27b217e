"""Which directions of the base parameters a run leaves open, and why.

A direction is open where the run tells less of it than was believed before, or where nothing was
believed, less than a thousandth of what it tells of the best one. Why is found by trial: the same
motion with one joint moving half as far again, faster in all joints, or longer. What sharpens the
direction most is what is missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np

from sdpid._common.arrays import Array
from sdpid.estimation.compression.covariance import JointRows
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.information import WEAK
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.base_parameters import BaseParameters
from sdpid.robot.model.model import RobotModel

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


# What is changed about a motion, and of which joint.
Change: TypeAlias = tuple[str, "str | None"]


class Bounds(Protocol):
    """The part of `JointLimits` that is looked at."""

    @property
    def lower(self) -> Array:
        """Least positions (n,)."""

    @property
    def upper(self) -> Array:
        """Largest positions (n,)."""

    @property
    def velocity(self) -> Array:
        """Largest speeds (n,)."""

    @property
    def acceleration(self) -> Array:
        """Largest accelerations (n,)."""


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


@dataclass(frozen=True, kw_only=True, eq=False)
class Asked:
    """What open directions are looked for in.

    Attributes
    ----------
    robot, friction, base
        The robot, its friction terms and base parameters.
    motion : (position, velocity, acceleration)
        States (K, n) of the run.
    density : ndarray, shape (n,)
        Of the noise.
    information, believed : ndarray, shape (b, b)
        What run and earlier runs tell, and what a prior does.
    limits : JointLimits or None
        Those of the motion.
    """

    robot: RobotModel
    friction: FrictionModel
    base: BaseParameters
    motion: tuple[Array, Array, Array]
    density: Array
    information: Array
    believed: Array
    limits: Bounds | None = None


def open_directions(asked: Asked) -> tuple[OpenDirection, ...]:
    """Return the directions that a run leaves open, the worst first."""
    base = asked.base
    told = np.diag(asked.information)
    best = told.max(initial=0.0)
    believed = np.diag(asked.believed)
    # Units: what is believed of each parameter; where nothing is, what the run tells of it.
    total = believed + np.where(believed > 0.0, 0.0, np.maximum(told, WEAK**2 * best))
    unit = 1.0 / np.sqrt(total)
    data = asked.information * np.outer(unit, unit)
    prior = asked.believed * np.outer(unit, unit)
    from scipy.linalg import eigh

    free = np.diag(np.where(believed > 0.0, 0.0, WEAK**2))
    # Information of the run per information before it: below one the run tells less.
    values, vectors = eigh(data, prior + free + 1e-12 * np.eye(len(data)))
    found = np.flatnonzero(values < 1.0)[:_MOST]
    if not found.size:
        return ()
    gains = _gains(asked)
    out = []
    for k in found:
        direction = unit * vectors[:, k]
        shares = vectors[:, k] / np.linalg.norm(vectors[:, k])
        order = [i for i in np.argsort(-np.abs(shares)) if abs(shares[i]) >= _SHARE][:3]
        order = order or [int(np.argmax(np.abs(shares)))]
        cause, joint = _cause(gains, direction)
        left = float(1.0 / np.sqrt(1.0 + max(values[k], 0.0)))
        names = tuple(base.names[i] for i in order)
        out.append(
            OpenDirection(
                parameters=names,
                shares=tuple(float(shares[i]) for i in order),
                told=left,
                cause=cause,
                joint=joint,
                reason=(why := _reason(asked, cause, joint)),
                words=_words(names, left, bool(np.all(believed[order] > 0.0)), why),
            )
        )
    return tuple(out)


def _gains(asked: Asked) -> dict[Change, Array]:
    """Return the information (b, b) of the motion and of others, by what they change."""
    q, v, a = asked.motion
    step = max(1, len(q) // _STATES)
    q, v, a = q[::step], v[::step], a[::step]
    middle = q.mean(axis=0)
    gains: dict[Change, Array] = {("as is", None): _information(asked, q, v, a)}
    gains["time", None] = _FACTOR * gains["as is", None]
    gains["speed", None] = _information(asked, q, _FACTOR * v, _FACTOR**2 * a)
    for j, name in enumerate(asked.robot.joint_names):
        factor = np.ones(q.shape[1])
        factor[j] = _FACTOR
        gains["range", name] = _information(
            asked, middle + factor * (q - middle), factor * v, factor * a
        )
    return gains


def _information(asked: Asked, q: Array, v: Array, a: Array) -> Array:
    """Return the information (b, b) of states, per sample."""
    samples = Samples(position=q, velocity=v, acceleration=a, effort=np.zeros_like(v))
    rows = JointRows.of(RowSource(asked.robot, asked.friction, asked.base, samples))
    R = rows.joined(asked.density).R[:, :-1]
    return np.asarray(R.T @ R / len(q))


def _cause(gains: dict[Change, Array], direction: Array) -> Change:
    """Return what sharpens a direction most: more range of a joint, more speed, or more time."""
    told = {key: float(direction @ value @ direction) for key, value in gains.items()}
    longer = told["time", None]
    del told["as is", None], told["time", None]
    faster = told["speed", None]
    best = max(told, key=lambda key: told[key])
    if best == ("speed", None):
        wider = max((key for key in told if key != best), key=lambda key: told[key])
        best = wider if faster < _CLEAR * told[wider] else best
    if longer <= 0.0 or told[best] <= _CLEAR * longer:
        return "time", None
    return best


def _words(names: Sequence[str], left: float, believed: bool, reason: str) -> str:
    """Return an open direction in a sentence."""
    what = names[0] if len(names) == 1 else f"a mixture of {', '.join(names)}"
    known = (
        f"{100.0 * left:.0f} % of what was uncertain before the run stays so"
        if believed
        else "the run tells next to nothing of it, and nothing was known before"
    )
    return f"{what}: {known}; {reason}"


def _reason(asked: Asked, cause: str, joint: str | None) -> str:
    """Return what is missing, and which limit stands in the way."""
    if cause == "time":
        return "a longer run, or less noise, is what helps"
    q, v, a = asked.motion
    limits = asked.limits
    if cause == "speed" or joint is None:
        if limits is None:
            return "faster motion is what helps"
        kinds = (("speed", v, limits.velocity), ("acceleration", a, limits.acceleration))
        reached = [
            f"{kind} of {', '.join(which)}"
            for kind, used, limit in kinds
            if (which := _at_limit(asked, np.abs(used).max(axis=0), limit))
        ]
        full = f"the limits on {' and '.join(reached)} are" if reached else "no limit on either is"
        return f"faster motion is what helps, and {full} reached"
    j = asked.robot.joint_names.index(joint)
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


def _at_limit(asked: Asked, used: Array, limit: Array) -> list[str]:
    """Return the joints that reach a limit; all of them in two words."""
    reached = used >= _REACHED * limit
    names = asked.robot.joint_names
    if reached.all():
        return ["all joints"]
    return [name for name, is_there in zip(names, reached, strict=True) if is_there]
