"""Bounds on the sizes of a robot's motion and efforts, and of their rates, at every configuration.

Every vector of the recursive Newton-Euler algorithm is a sum of products of vectors that turn with
a link: lengths, axes, first moments, inertias. A *jet* bounds such a vector over a cell of time:
row k is at least the norm of its k-th derivative at every instant. Sums and products of vectors
obey ``|(x + y)^(k)| ≤ |x^(k)| + |y^(k)|`` and, by Leibniz, ``|(x·y)^(k)| ≤ Σ C(k, m)·|x^(m)|·
|y^(k−m)|``, cross products, scalar products and products with matrices alike. So the recursion,
carried out on jets, bounds efforts and their first two derivatives whatever the configuration; only
the sizes of the joints' speeds and their derivatives enter, over the same cell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.robot.inertia import inertia_tensor

# Derivatives of the joints' positions that enter: the second derivative of an effort has the
# fourth, snap.
ORDERS = 4


def product(x: Array, y: Array, count: int) -> Array:
    """Return the jet (count, …) of a product, from jets of at least that many rows."""
    return np.stack([sum(comb(k, m) * x[m] * y[k - m] for m in range(k + 1)) for k in range(count)])


def _turning(spin: Array) -> Array:
    """Return the jet (5, C) of a unit vector fixed to a link, from that of its spin (4, C)."""
    rows = [np.ones_like(spin[0])]
    for k in range(ORDERS):
        rows.append(sum(comb(k, m) * spin[k - m] * rows[m] for m in range(k + 1)))
    return np.stack(rows)


@dataclass(frozen=True, eq=False)
class LinkNorms:
    """Jets of the links' motion over C cells; link 0 is the base.

    Attributes
    ----------
    turning : list of ndarray (5, C)
        Of a unit vector fixed to the link.
    spin : list of ndarray (4, C)
        Of the angular velocity.
    offset : list of ndarray (5, C)
        Of the vector from the parent's origin to the link's.
    origin : list of ndarray (5, C)
        Of the link's origin.
    """

    turning: list[Array]
    spin: list[Array]
    offset: list[Array]
    origin: list[Array]


def link_norms(model: Any, joints: Array) -> LinkNorms:
    """Return the jets of the motion of a tree's links.

    Parameters
    ----------
    model : pinocchio.Model
        Of turning and sliding joints on a fixed base.
    joints : ndarray, shape (5, C, nv)
        Bounds on the sizes of the positions (of sliding joints) and their four derivatives.
    """
    lengths, slides, columns = _geometry(model)
    zero = np.zeros(joints.shape[:2])
    turning, spin, offset, origin = [_turning(zero[1:])], [zero[1:]], [zero], [zero]
    for i in range(1, model.njoints):
        before = model.parents[i]
        own = joints[:, :, columns[i]]
        step = lengths[i] * turning[before]
        if slides[i]:
            step = step + product(turning[before], own, ORDERS + 1)
            spin.append(spin[before])
        else:
            spin.append(spin[before] + product(turning[before], own[1:], ORDERS))
        turning.append(_turning(spin[i]))
        offset.append(step)
        origin.append(origin[before] + step)
    return LinkNorms(turning, spin, offset, origin)


def _geometry(model: Any) -> tuple[list[float], list[bool], list[int]]:
    """Return the length before each joint, whether it slides, and its velocity's index."""
    lengths = [float(np.linalg.norm(place.translation)) for place in model.jointPlacements]
    slides = [joint.shortname().startswith("JointModelP") for joint in model.joints]
    columns = [joint.idx_v for joint in model.joints]
    return lengths, slides, columns


def body_sizes(bodies: Array) -> Array:
    """Return mass, and norms of first moment and rotational inertia, (links, 10) to (links, 3)."""
    return np.column_stack(
        [
            np.abs(bodies[:, 0]),
            np.linalg.norm(bodies[:, 1:4], axis=1),
            np.linalg.norm(inertia_tensor(bodies), ord=2, axis=(1, 2)),
        ]
    )


def effort_norms(
    model: Any, norms: LinkNorms, link: int, sizes: Sequence[float], gravity: float
) -> Array:
    """Return the jets (3, C, nv) of what one body adds to the efforts.

    Parameters
    ----------
    model : pinocchio.Model
        The tree.
    norms : LinkNorms
        The motion of its links.
    link : int
        The body's link, from 1.
    sizes : sequence of 3 floats
        Its mass, and the norms of its first moment and rotational inertia about the link's origin.
    gravity : float
        Size of gravity, m/s².
    """
    mass, moment, inertia = sizes
    slides, columns = _geometry(model)[1:]
    turning = norms.turning[link]
    acceleration = norms.origin[link][2:].copy()
    acceleration[0] += gravity
    force = mass * acceleration + moment * turning[2:]
    spinning = product(product(turning, turning, ORDERS), norms.spin[link], ORDERS)
    torque = inertia * spinning[1:] + moment * product(turning, acceleration, 3)
    arm = np.zeros_like(torque)
    found = np.zeros((*torque.shape, model.nv))
    while link > 0:
        before = model.parents[link]
        axis = norms.turning[before]
        whole = force if slides[link] else torque + product(arm, force, 3)
        found[:, :, columns[link]] = product(axis, whole, 3)
        arm = arm + norms.offset[link][:3]
        link = before
    return found
