"""Compare measured efforts with those of the description's bodies, joint by joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sdpid._common.arrays import Array
from sdpid.experiment.inspection.rows import Rows
from sdpid.robot.model.model import RobotModel

# Efforts of real arms are this many times those of the description's bodies, friction taken away:
# 0.7 to 2.3 for the joints that carry something, of 17 recordings of six arms with and without
# loads.
GAINS = (0.3, 3.0)
# A joint shows the scale of its efforts where the description's bodies make at least this share of
# the effort they make in the joint that carries most, ...
_CARRIES = 0.05
# ... and what friction does not explain follows them with this correlation.
_FOLLOWS = 0.7
# This share of an effort stays unexplained by the description where all is well: with 0.01 the
# slightly eccentric last link of one simulated good log of 48 seemed turned by half a turn.
_FLOOR = 0.03
# The misfit of a joint that the description explains fully.
LEAST_MISFIT = float(np.log(_FLOOR))


@dataclass(frozen=True, kw_only=True, eq=False)
class Gains:
    """How many times the description's efforts the measured ones are.

    Attributes
    ----------
    gain, correlation : ndarray, shape (n,)
        Of each joint, once friction, rotor inertia and offset are taken away.
    shows : ndarray of bool, shape (n,)
        Whether the joint carries enough of the bodies for that to be known.
    """

    gain: Array
    correlation: Array
    shows: NDArray[np.bool_]

    @property
    def common(self) -> float | None:
        """The median of the gains that are known, by size; None where there is none."""
        return float(np.median(np.abs(self.gain[self.shows]))) if self.shows.any() else None


def described(robot: RobotModel | None) -> bool:
    """Return whether a robot's description has masses to compare with."""
    return robot is not None and robot.n_base == 0 and bool(np.any(robot.prior[:, 0] > 0.0))


def placeholders(robot: RobotModel) -> bool:
    """Return whether most bodies of a description are alike: made up, not measured."""
    bodies = robot.prior[robot.prior[:, 0] > 0.0]
    _, counts = np.unique(bodies[:, [0, 4, 6, 9]].round(9), axis=0, return_counts=True)
    return len(bodies) > 2 and 2 * int(counts.max()) > len(bodies)


def gains(rows: Rows, rigid: Array) -> Gains:
    """Fit each effort by the description's, Coulomb and viscous friction, rotor inertia, offset.

    Parameters
    ----------
    rows : Rows
        What was measured.
    rigid : ndarray, shape (K, n)
        Efforts of the description's bodies there.
    """
    n = rigid.shape[1]
    gain, correlation = np.zeros(n), np.zeros(n)
    for j in np.flatnonzero(rows.usable).tolist():
        others = np.column_stack([*friction(rows, j), np.ones(len(rigid))])
        basis, _ = np.linalg.qr(others)
        x, y = (each - basis @ (basis.T @ each) for each in (rigid[:, j], rows.effort[:, j]))
        xx, yy, xy = float(x @ x), float(y @ y), float(x @ y)
        if xx * yy > 0.0:
            gain[j], correlation[j] = xy / xx, xy / np.sqrt(xx * yy)
    size = np.where(rows.usable, rigid.std(axis=0), 0.0)
    shows = (size > _CARRIES * size.max(initial=0.0)) & (np.abs(correlation) > _FOLLOWS)
    return Gains(gain=gain, correlation=correlation, shows=shows)


def unexplained(rows: Rows, rigid: Array, scale: float = 1.0) -> Array:
    """Return the share of each effort's variance that a sensible model leaves, (n,).

    Sensible: the description's efforts times 0.3 to 3, times `scale`; friction that takes power; a
    rotor inertia that is not negative; an offset. It may pass 1, where the description's efforts
    are in the way. Joints that are not usable have 1.
    """
    from scipy.optimize import nnls

    shares = np.ones(rigid.shape[1])
    for j in np.flatnonzero(rows.usable).tolist():
        effort = rows.effort[:, j] - rows.effort[:, j].mean()
        power = float(effort @ effort)
        if power == 0.0:
            continue
        columns = np.column_stack([rigid[:, j], *friction(rows, j)])
        columns -= columns.mean(axis=0)
        size = np.linalg.norm(columns, axis=0)
        size[size == 0.0] = 1.0
        R = np.asarray(np.linalg.qr(np.column_stack([columns / size, effort]), mode="r"))
        factors, rhs = R[:, :-1], R[:, -1]
        fitted, left = nnls(factors, rhs)
        gain = fitted[0] / size[0] / scale
        if not GAINS[0] <= gain <= GAINS[1]:
            fixed = size[0] * scale * min(max(gain, GAINS[0]), GAINS[1])
            _, left = nnls(factors[:, 1:], rhs - fixed * factors[:, 0])
        shares[j] = left**2 / power
    return shares


def misfit(shares: Array) -> float:
    """Return how badly all joints are explained: the sum of the logarithms of their shares.

    Halving the unexplained share of one joint lowers it by 0.7; shares far below 1 % count alike,
    since few descriptions are better.
    """
    return float(np.sum(np.log(shares + _FLOOR)))


def friction(rows: Rows, j: int) -> tuple[Array, Array, Array]:
    """Return the columns of Coulomb and viscous friction and of a rotor's inertia of a joint."""
    return rows.sign[:, j], rows.velocity[:, j], rows.acceleration[:, j]
