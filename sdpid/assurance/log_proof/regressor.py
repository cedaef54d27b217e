"""The regressor of a tree of rigid bodies, enclosed, written from the equations of motion.

Link by link, everything in the link's own frame, R the rotation of that frame in the parent's, r
its origin there and z the joint's axis:

    omega = R^T omega_p + z v,   alpha = R^T alpha_p + z a + (R^T omega_p) × z v,
    b = R^T (b_p + alpha_p × r + omega_p × (omega_p × r)),

from b = −gravity at the base; a prismatic joint adds ``z a + 2 omega × z v`` to b in place of the
terms in z. With u and l the angular and the linear velocity that a coordinate gives a link at unit
speed, ``u = R^T u_p`` and ``l = R^T (l_p + u_p × r)``, its effort is the power of all bodies'
inertial forces (Kane):

    effort = Σ l·(m b + alpha × h + omega × (omega × h)) + u·(h × b + I alpha + omega × I omega).

Of a body m, h and I the error is bounded as a whole, by ``rad·(m, |h|, ‖I‖)`` with the spectral
norm of I: the sum over the entries of I would be four times as much.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.certificate.outward import SLACK as UP
from sdpid.assurance.certificate.outward import UNIT as U
from sdpid.assurance.log_proof.enclosure import TINY, Enclosed, largest, root
from sdpid.assurance.log_proof.joints import Joint, constant_vector
from sdpid.robot.model.regressor_kernel import FLOATING, REVOLUTE, Tree

# An entry of what multiplies I is a sum of at most four products, and the norm of absolute values
# is at most √3 times the spectral norm.
_ENTRY = 4.0 * 1.7320508075688774 * U


@dataclass(frozen=True, eq=False)
class Motion:
    """States of K samples: positions, velocities and accelerations of Pinocchio's coordinates.

    Attributes
    ----------
    q : tuple of Enclosed
        Of each joint its position: an angle or a length (1, K), the cosine and sine of an angle
        (2, K), or the seven numbers of a floating base (7, K).
    v, a : Enclosed
        Of shape (nv, K).
    gravity : ndarray, shape (3,)
        In the base link.
    """

    q: tuple[Enclosed, ...]
    v: Enclosed
    a: Enclosed
    gravity: Array


def motion(tree: Tree, offset: Array, q: Array, v: Array, a: Array) -> Motion:
    """Return the states of samples in the robot's coordinates.

    Parameters
    ----------
    tree : Tree
        The robot.
    offset : ndarray, shape (nv,)
        Positions of Pinocchio's joints at zero coordinates.
    q : ndarray, shape (K, n) or (K, nq)
        Positions; with a floating base Pinocchio's configurations.
    v, a : ndarray, shape (K, n)
        Velocities and accelerations.
    """
    factor = Enclosed.constant(tree.factor)
    q, v, a = (np.ascontiguousarray(x.T) for x in (q, v, a))
    stored = FLOATING in tree.kind
    positions = []
    for kind, at, to, unbounded in zip(
        tree.kind, tree.first_q, tree.first_v, tree.unbounded, strict=True
    ):
        if stored:
            width = 7 if kind == FLOATING else 1 + int(unbounded)
            positions.append(Enclosed.exact(q[at : at + width]))
            continue
        angle = Enclosed.exact(q[[tree.column[to]]])
        if tree.factor[to] != 1.0:
            angle = angle * factor.at([to])
        if offset[to] != 0.0:
            angle = angle + Enclosed.constant(offset[[to]])
        positions.append(angle)
    rates = []
    for values in (v, a):
        rate = Enclosed.exact(values[tree.column])
        scaled = rate * factor
        # Times one is exact.
        rad = np.where(tree.factor == 1.0, 0.0, scaled.rad)
        rates.append(Enclosed(scaled.mid, rad, scaled.size))
    return Motion(tuple(positions), rates[0], rates[1], tree.gravity)


def regressor(joints: Sequence[Joint], states: Motion, mid: Array, rad: Array) -> None:
    """Write the enclosed regressor of samples where there are zeros.

    Parameters
    ----------
    joints : sequence of Joint
        The robot.
    states : Motion
        From `motion`.
    mid : ndarray, shape (n, 10·links, K)
        Where to write the midpoints.
    rad : ndarray, shape (n, links, 3)
        Where to write, for all samples, the error's bound over a link's m, |h| and ‖I‖.
    """
    for i, link in enumerate(moving_links(joints, states)):
        entries, bounds = _rows(link)
        for k, entry in enumerate(entries):
            mid[link.coordinates, 10 * i + k] = entry
        rad[link.coordinates, i] = np.stack(np.broadcast_arrays(*bounds), axis=-1)


@dataclass(frozen=True, eq=False)
class Link:
    """Motion of a link in its own frame, and what the coordinates that move it give it.

    Attributes
    ----------
    omega, alpha, b : Enclosed
        Angular velocity and acceleration (3, K), and acceleration of its origin less gravity.
    coordinates : list of int
        Of the robot, m in all.
    u, l : Enclosed
        Angular velocity and that of the origin (m, 3, K) for unit speed of each.
    """

    omega: Enclosed
    alpha: Enclosed
    b: Enclosed
    coordinates: list[int]
    u: Enclosed
    l: Enclosed  # noqa: E741


_ZERO = constant_vector(np.zeros(3))


def moving_links(joints: Sequence[Joint], states: Motion) -> list[Link]:
    """Return the links of a robot, each with the joint that moves it."""
    links: list[Link] = []
    for i, joint in enumerate(joints):
        parent = links[joint.parent] if joint.parent >= 0 else _base(states.gravity)
        links.append(_next(joint, states, states.q[i], parent))
    return links


def _base(gravity: Array) -> Link:
    """Return the base, which stands still and feels gravity as if it were pushed up."""
    return Link(_ZERO, _ZERO, constant_vector(-gravity), [], _ZERO, _ZERO)


def _next(joint: Joint, states: Motion, q: Enclosed, parent: Link) -> Link:
    """Return the motion of a link from that of its parent."""
    R, r = joint.rotation(q), joint.origin(q)
    omega, alpha = R.back(parent.omega), R.back(parent.alpha)
    swing = parent.omega.cross(parent.omega.cross(r))
    b = R.back(parent.b + parent.alpha.cross(r) + swing)
    rates, gains = ([x.at(axis.first_v) for axis in joint.axes] for x in (states.v, states.a))
    if joint.kind == FLOATING:
        # Its rates are given in its own frame.
        omega, alpha = _as_vector(rates[3:]), _as_vector(gains[3:])
        b = b + _as_vector(gains[:3]) + omega.cross(_as_vector(rates[:3]))
    else:
        speed, gain = joint.axes[0].times(rates[0]), joint.axes[0].times(gains[0])
        carried = omega.cross(speed)
        if joint.kind == REVOLUTE:
            omega, alpha = omega + speed, alpha + gain + carried
        else:
            b = b + gain + carried + carried
    velocities = _velocities(joint, parent, R, r)
    return Link(omega.measured(), alpha.measured(), b.measured(), *velocities)


def _velocities(
    joint: Joint, parent: Link, R: Enclosed, r: Enclosed
) -> tuple[list[int], Enclosed, Enclosed]:
    """Return the coordinates that move a link, and the velocities that each gives it."""
    moves = {}
    if parent.coordinates:
        u, l = R.back(parent.u), R.back(parent.l + parent.u.cross(r))  # noqa: E741
        moves = {h: (u.at(k), l.at(k)) for k, h in enumerate(parent.coordinates)}
    for axis in joint.axes:
        own, h = axis.times(Enclosed.constant(axis.factor)), axis.coordinate
        pair = (own, _ZERO) if axis.turns else (_ZERO, own)
        # A joint that mimics another moves with it.
        moves[h] = (moves[h][0] + pair[0], moves[h][1] + pair[1]) if h in moves else pair
    sides = [_stacked([pair[side] for pair in moves.values()]) for side in (0, 1)]
    return list(moves), sides[0], sides[1].measured()


def _rows(link: Link) -> tuple[list[Array], tuple[Array, Array, Array]]:
    """Return what multiplies the ten parameters, for all coordinates, and bounds of the errors.

    Of h it is ``l × alpha + omega × (omega × l) + b × u``, since a cross product is skew; of I the
    symmetric part of ``u alpha^T + t omega^T`` with t = u × omega, matrices of rank one.
    """
    omega, alpha, u = link.omega, link.alpha, link.u
    first = link.l.dot(link.b)
    second = link.l.cross(alpha) + omega.cross(omega.cross(link.l)) + link.b.cross(u)
    t = u.cross(omega)
    pairs = (u, alpha), (t, omega)
    entries = [first.mid, *(second.mid[:, k] for k in range(3))]
    for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)):
        entry = u.mid[:, i] * alpha.mid[j]
        entry += t.mid[:, i] * omega.mid[j]
        if i != j:
            entry += u.mid[:, j] * alpha.mid[i]
            entry += t.mid[:, j] * omega.mid[i]
        entries.append(entry)
    third = sum(
        x.rad * (y.size + y.rad) + x.size * y.rad + _ENTRY * (x.size * y.size) for x, y in pairs
    )
    return entries, (first.rad, second.rad, np.asarray(third * UP + TINY))


def _as_vector(numbers: Sequence[Enclosed]) -> Enclosed:
    """Return three numbers (K,) as one vector."""
    rad = root(np.sum([x.rad**2 for x in numbers]))
    mid = np.stack([x.mid for x in numbers])
    return Enclosed(mid, np.asarray(rad), np.asarray(largest(mid).max())).measured()


def _stacked(vectors: Sequence[Enclosed]) -> Enclosed:
    """Return vectors (3, K) as one array (m, 3, K)."""
    return Enclosed(
        np.stack(np.broadcast_arrays(*(x.mid for x in vectors))),
        np.array([x.rad for x in vectors]),
        np.array([x.size for x in vectors]),
    )
