"""The regressor of many samples at once, compiled where Numba is installed.

Every link's motion is kept in the link's own frame, and so is the axis of every joint that moves
it, carried along from link to link. One row of a link's block is then that axis times the link's
6 x 10 body regressor: there are no world frames, and no forces that travel back along the tree.
"""

from __future__ import annotations

import functools
import itertools
import logging
import math
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Literal, NamedTuple

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.errors import ModelError

# Kinds of joints.
REVOLUTE, PRISMATIC, FLOATING = 0, 1, 2

# An axis is one of rotation or of translation when the other half is smaller than this: joints
# are given by unit vectors, whose rounding is far below.
_PURE = 1e-12

# Bytes that Pinocchio writes in 20 ms and the compiled loop in half of that; only to load Numba
# takes half a second. The size decides, not whether it is loaded, so that the same call gives the
# same bits every time.
SMALL = 1 << 24

# Bytes of the rows of a log, gone through two or three times, in which Numba makes up for its own
# loading: a tenth of a second of Pinocchio each time.
WORTH = 1 << 26

# Bytes from which the C library takes an array from the system, at the latest, as zeros, and from
# which threads are worth their start.
_LARGE = 1 << 25

# Parts of a large array for every thread: one whose core is busy elsewhere does fewer.
_SHARES = 4

# Other arrays, read-only ones among them, would be compiled for anew; they are copied.
_COMPILED_FOR: tuple[Literal["C", "A", "W"], ...] = ("C", "A", "W")

# Values (K, m) beside the regressor, and the row and the column of each in a sample's block.
Entries = tuple[Array, Indices, Indices]

# Compiling for longer than this is worth a line, s.
_PATIENCE = 1.0


class Tree(NamedTuple):
    """A robot's kinematics as plain arrays, which is what a compiled function takes.

    Attributes
    ----------
    kind : ndarray of int, shape (links,)
        REVOLUTE, PRISMATIC or FLOATING.
    parent : ndarray of int, shape (links,)
        The link that each one hangs on, -1 for the base.
    first_q, first_v : ndarray of int, shape (links,)
        Pinocchio's first position and velocity coordinate of each joint.
    unbounded : ndarray of bool, shape (links,)
        Whether a joint's position is a cosine and a sine.
    column : ndarray of int, shape (nv, w)
        The robot's coordinates that move each of Pinocchio's: one but behind a transmission.
    factor : ndarray, shape (nv, w)
        How fast: 1 but for mimic joints and transmissions; 0 for none.
    shared : ndarray of bool, shape (nv,)
        Whether a coordinate of Pinocchio's is not one of the robot's by itself.
    turn : ndarray, shape (links, 3, 3, 3)
        Rotation of a joint's frame in its parent's: ``turn[0] cos + turn[1] sin + turn[2]``.
    place : ndarray, shape (links, 2, 3)
        Origin of a joint's frame in its parent's, and what a meter of a prismatic joint adds.
    axis : ndarray, shape (links, 3)
        Axes in the joints' own frames.
    gravity : ndarray, shape (3,)
        Gravity in the base link, m/s².
    """

    kind: Indices
    parent: Indices
    first_q: Indices
    first_v: Indices
    unbounded: Any
    column: Indices
    factor: Array
    shared: Any
    turn: Array
    place: Array
    axis: Array
    gravity: Array


def flatten(model: Any, expansion: Array) -> Tree:
    """Return the plain arrays of a Pinocchio model.

    Parameters
    ----------
    model : pinocchio.Model
        The kinematics.
    expansion : ndarray, shape (nv, n)
        Velocities of Pinocchio's joints from the robot's coordinates.

    Raises
    ------
    ModelError
        When a joint neither turns nor slides, as a screw does, or gravity turns.
    """
    import pinocchio as pin

    if model.gravity.angular.any():
        raise ModelError(f"robot '{model.name}': gravity has an angular part; give a linear one.")
    links = model.njoints - 1
    kind = np.zeros(links, dtype=np.intp)
    turn, place, axis = np.zeros((links, 3, 3, 3)), np.zeros((links, 2, 3)), np.zeros((links, 3))
    neutral = pin.neutral(model)
    for i in range(links):
        joint, placement = model.joints[i + 1], model.jointPlacements[i + 1]
        R = np.array(placement.rotation)
        place[i, 0] = placement.translation
        if i == 0 and joint.nv == 6 and joint.nq == 7:
            kind[i], turn[i, 2] = FLOATING, R
            continue
        data = joint.createData()
        joint.calc(data, neutral)
        linear, angular = np.split(np.array(data.S).ravel(), 2)
        if np.abs(linear).max() < _PURE:
            kind[i], axis[i] = REVOLUTE, angular
            x, y, z = angular
            about = np.outer(angular, angular)
            turn[i, 2] = R @ about
            turn[i, 0] = R - turn[i, 2]
            turn[i, 1] = R @ np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        elif np.abs(angular).max() < _PURE:
            kind[i], axis[i], turn[i, 2], place[i, 1] = PRISMATIC, linear, R, R @ linear
        else:
            raise ModelError(
                f"joint '{model.names[i + 1]}' is a {joint.shortname()}, which is not supported; "
                "supported are revolute, continuous and prismatic joints."
            )
    joints = list(model.joints)[1:]
    moved = expansion != 0.0
    width = max(1, int(moved.sum(axis=1).max(initial=0)))
    column = np.argsort(~moved, axis=1, kind="stable")[:, :width]
    factor = np.take_along_axis(expansion, column, axis=1)
    plain = (moved.sum(axis=1) == 1) & (factor[:, 0] == 1.0)
    return Tree(
        kind=kind,
        parent=np.array([model.parents[i + 1] - 1 for i in range(links)], dtype=np.intp),
        first_q=np.array([joint.idx_q for joint in joints], dtype=np.intp),
        first_v=np.array([joint.idx_v for joint in joints], dtype=np.intp),
        unbounded=np.array([joint.nq == 2 for joint in joints]),
        column=np.ascontiguousarray(column, dtype=np.intp),
        factor=np.ascontiguousarray(factor),
        shared=~(plain & (moved.sum(axis=0)[column[:, 0]] == 1)),
        turn=turn,
        place=place,
        axis=axis,
        gravity=np.array(model.gravity.linear),
    )


def regressor(
    tree: Tree,
    q: Array,
    v: Array,
    a: Array,
    *,
    out: Array | None = None,
    places: Indices | None = None,
    worth: bool | None = None,
    entries: Entries | None = None,
) -> Array | None:
    """Return the regressor of samples, None without Numba or when there are few.

    Parameters
    ----------
    tree : Tree
        The robot.
    q : ndarray, shape (K, nq)
        Pinocchio's configurations.
    v, a : ndarray, shape (K, nv)
        Velocities and accelerations of Pinocchio's joints.
    out : ndarray, shape (K, n, columns), optional
        Where to write, C-contiguous. All of it is written: columns that are no parameter's become
        zero.
    places : ndarray of int, shape (10·links,), optional
        The column that each parameter's goes to, -1 for none; by default its own.
    worth : bool, optional
        Whether to use the compiled loop: of a log's blocks all or none. By default the size
        decides.
    entries : tuple, optional
        Further entries of each sample's block, while it is in the cache.

    Returns
    -------
    ndarray of shape (K, n, 10·links) or that of `out`, or None
    """
    count = 10 * len(tree.kind)
    shape = (len(q), int(tree.column.max()) + 1, count) if out is None else out.shape
    size = 8 * math.prod(shape)
    fill = compiled() if (size >= SMALL if worth is None else worth) else None
    if fill is None:
        return None
    extra, *at = entries or (np.zeros((len(q), 0)), *(np.zeros(0, dtype=np.intp),) * 2)
    states = [np.require(x, np.float64, _COMPILED_FOR) for x in (q, v, a, extra)]
    places_of = [np.require(x, np.intp, _COMPILED_FOR) for x in at]
    whole = places is None
    route = np.arange(count) if places is None else np.require(places, np.intp, _COMPILED_FOR)
    # Most of a sample is zero. A large new array comes as zeros from the system, which clears pages
    # no faster for two threads than for one; any other is cleared sample by sample in the cache.
    clear = size < _LARGE or out is not None
    cores = threads() if size >= _LARGE and out is not None else 1
    rows = out if out is not None else np.empty(shape) if clear else np.zeros(shape)

    def work(part: slice) -> None:
        parts = (x[part] for x in states)
        fill(tree, route, whole, clear, *places_of, *parts, rows[part])

    if cores == 1:
        work(slice(None))
    else:
        from concurrent.futures import ThreadPoolExecutor

        ends = np.linspace(0, len(q), _SHARES * cores + 1).astype(int)
        with ThreadPoolExecutor(cores) as pool:
            list(pool.map(work, itertools.starmap(slice, itertools.pairwise(ends))))
    return rows


def threads() -> int:
    """Return how many threads Numba was given: the cores, or NUMBA_NUM_THREADS; one without it."""
    if compiled() is None:
        return 1
    import numba

    return max(1, int(numba.config.NUMBA_NUM_THREADS))


@functools.cache
def compiled() -> Callable[..., None] | None:
    """Return the compiled loop, None where Numba is missing or cannot be imported."""
    index, table = np.zeros(0, dtype=np.intp), np.zeros((0, 0))
    nothing = (index, True, True, index, index, *(table,) * 4, np.zeros((0, 0, 0)))
    return compiled_loop(_fill, NOTHING, *nothing)


def compiled_loop(function: Any, *nothing: Any) -> Callable[..., None] | None:
    """Return a compiled function, None where Numba is missing or cannot be imported.

    It is compiled for the types of `nothing`, the only ones there are, and kept on the disk where
    that is possible, with a line to the user when compiling takes long.
    """
    try:
        import numba
    except ImportError:  # missing, or it refuses this NumPy
        return None
    options = {"fastmath": {"contract", "nsz", "reassoc"}, "error_model": "numpy"}
    for helper in (four, joints_at):
        numba.extending.register_jitable(forceinline=True, **options)(helper)
    quick: Callable[..., None]
    with announced("a loop"):
        try:
            # Beside the module or, where that is not writable, in the user's cache folder.
            quick = numba.njit(cache=True, nogil=True, **options)(function)
            quick(*nothing)
        except (OSError, RuntimeError):  # neither is writable, or the disk is full
            quick = numba.njit(nogil=True, **options)(function)
            quick(*nothing)
    return quick


@contextmanager
def announced(what: str) -> Iterator[None]:
    """Tell the user that something is being compiled where that takes long."""
    timer = threading.Timer(_PATIENCE, _say, [what])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def _say(what: str) -> None:
    note = f"compiling {what} for this machine; this takes seconds, once"
    logging.getLogger(__name__).info(note)
    if sys.stderr.isatty():
        print(f"sdpid: {note}", file=sys.stderr)


# A tree of no links, for the first call of a function that is compiled.
NOTHING = Tree(
    *(np.zeros(0, dtype=np.intp),) * 4,
    unbounded=np.zeros(0, dtype=np.bool_),
    column=np.zeros((0, 0), dtype=np.intp),
    factor=np.zeros((0, 0)),
    shared=np.zeros(0, dtype=np.bool_),
    turn=np.zeros((0, 3, 3, 3)),
    place=np.zeros((0, 2, 3)),
    axis=np.zeros((0, 3)),
    gravity=np.zeros(3),
)


def joints_at(tree: Any, q: Array, k: int, R: Array, r: Array) -> None:
    """Write rotations and origins of the joints' frames in their parents', at sample k.

    A floating base is in the origin: where it is makes no difference. One call a sample: arrays
    that are passed take time of their own.
    """
    turn, place = tree.turn, tree.place
    for i in range(len(turn)):
        x, y, d, at = 0.0, 0.0, 0.0, tree.first_q[i]
        if tree.kind[i] == PRISMATIC:
            d = q[k, at]
        elif tree.unbounded[i]:
            x, y = q[k, at], q[k, at + 1]
        elif tree.kind[i] == REVOLUTE:
            x, y = math.cos(q[k, at]), math.sin(q[k, at])
        for c in range(3):
            for e in range(3):
                R[i, c, e] = turn[i, 0, c, e] * x + turn[i, 1, c, e] * y + turn[i, 2, c, e]
            r[i, c] = place[i, 0, c] + place[i, 1, c] * d
    if len(turn) and tree.kind[0] == FLOATING:
        qx, qy, qz, qw = q[k, 3], q[k, 4], q[k, 5], q[k, 6]
        xx, yy, zz, xw = qx * qx, qy * qy, qz * qz, qx * qw
        xy, xz, yz, yw, zw = qx * qy, qx * qz, qy * qz, qy * qw, qz * qw
        for c in range(3):
            x, y, z = R[0, c, 0], R[0, c, 1], R[0, c, 2]
            R[0, c, 0] = x + 2.0 * (y * (xy + zw) + z * (xz - yw) - x * (yy + zz))
            R[0, c, 1] = y + 2.0 * (x * (xy - zw) + z * (yz + xw) - y * (xx + zz))
            R[0, c, 2] = z + 2.0 * (x * (xz + yw) + y * (yz - xw) - z * (xx + yy))
            r[0, c] = 0.0


def four(A: Array, c: int, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return four sums of a matrix's first three rows: each product is one instruction."""
    return (
        A[0, c] * x + A[1, c] * y + A[2, c] * z,
        A[0, c + 1] * x + A[1, c + 1] * y + A[2, c + 1] * z,
        A[0, c + 2] * x + A[1, c + 2] * y + A[2, c + 2] * z,
        A[0, c + 3] * x + A[1, c + 3] * y + A[2, c + 3] * z,
    )


def _fill(
    tree: Any,
    route: Indices,
    whole: bool,
    clear: bool,
    extra_row: Indices,
    extra_column: Indices,
    q: Array,
    v: Array,
    a: Array,
    extra: Array,
    out: Array,
) -> None:
    """Write the regressor's blocks, link by link along each sample's tree.

    `out` holds zeros, or is to be cleared. Written for a compiler: scalars, and nothing allocated
    for a sample.
    """
    kind, parent, first_v, axis = tree.kind, tree.parent, tree.first_v, tree.axis
    column, factor, shared, gravity = tree.column, tree.factor, tree.shared, tree.gravity
    links, nv = len(kind), len(column)
    # A vector has a fourth entry, which is zero, and a row two at its end: fours are fast.
    R, origins, row = np.zeros((links, 3, 4)), np.empty((links, 3)), np.empty(10)
    spin, turning = np.empty((links, 3)), np.empty((links, 3))
    # Body regressors. The first four columns give the acceleration of a point at r, too.
    M = np.zeros((links, 6, 12))
    # Axes of the coordinates that move a link, in its frame, translation first; how many, which.
    S = np.zeros((links, nv, 8))
    moves, count = np.empty((links, nv), dtype=np.intp), np.zeros(links, dtype=np.intp)
    for i in range(links):
        p, n = parent[i], 0
        if p >= 0:
            n = count[p]
            # Assigning slices takes a sixth of the time to compile all of this.
            for j in range(n):
                moves[i, j] = moves[p, j]
        # The joint's own axes, at rest in its frame.
        if kind[i] == FLOATING:
            for j in range(6):
                moves[i, n + j] = first_v[i] + j
                S[i, n + j, j + j // 3] = 1.0
            n += 6
        else:
            moves[i, n] = first_v[i]
            start = 4 if kind[i] == REVOLUTE else 0
            for c in range(3):
                S[i, n, start + c] = axis[i, c]
            n += 1
        count[i] = n
    # Which of a link's parameters have a place: wanted[first[i] : first[i + 1]].
    first, wanted = np.zeros(links + 1, dtype=np.intp), np.zeros(10 * links, dtype=np.intp)
    total = 0
    for c in range(10 * links):
        if route[c] >= 0:
            wanted[total] = c
            total += 1
        first[c // 10 + 1] = total
    for k in range(len(out)):
        if clear:
            for t in range(out.shape[1]):
                for c in range(out.shape[2]):
                    out[k, t, c] = 0.0
        joints_at(tree, q, k, R, origins)
        for i in range(links):
            p, to, r, T = parent[i], first_v[i], origins[i], R[i]
            # The parent's motion at this origin, turned into this frame.
            gx, gy, gz = -gravity[0], -gravity[1], -gravity[2]
            wx = wy = wz = ax = ay = az = 0.0
            if p >= 0:
                gx = M[p, 0, 0] + M[p, 0, 1] * r[0] + M[p, 0, 2] * r[1] + M[p, 0, 3] * r[2]
                gy = M[p, 1, 0] + M[p, 1, 1] * r[0] + M[p, 1, 2] * r[1] + M[p, 1, 3] * r[2]
                gz = M[p, 2, 0] + M[p, 2, 1] * r[0] + M[p, 2, 2] * r[1] + M[p, 2, 3] * r[2]
                wx, wy, wz, _ = four(T, 0, spin[p, 0], spin[p, 1], spin[p, 2])
                ax, ay, az, _ = four(T, 0, turning[p, 0], turning[p, 1], turning[p, 2])
                # The axes that move the parent, seen from here.
                for j in range(count[p]):
                    ux, uy, uz = S[p, j, 4], S[p, j, 5], S[p, j, 6]
                    lx = S[p, j, 0] + uy * r[2] - uz * r[1]
                    ly = S[p, j, 1] + uz * r[0] - ux * r[2]
                    lz = S[p, j, 2] + ux * r[1] - uy * r[0]
                    S[i, j, 0], S[i, j, 1], S[i, j, 2], _ = four(T, 0, lx, ly, lz)
                    S[i, j, 4], S[i, j, 5], S[i, j, 6], _ = four(T, 0, ux, uy, uz)
            bx, by, bz, _ = four(T, 0, gx, gy, gz)
            # The joint's own.
            sx, sy, sz = axis[i, 0], axis[i, 1], axis[i, 2]
            dq, ddq = v[k, to], a[k, to]
            if kind[i] == REVOLUTE:
                ax += sx * ddq + (wy * sz - wz * sy) * dq
                ay += sy * ddq + (wz * sx - wx * sz) * dq
                az += sz * ddq + (wx * sy - wy * sx) * dq
                wx, wy, wz = wx + sx * dq, wy + sy * dq, wz + sz * dq
            elif kind[i] == PRISMATIC:
                bx += sx * ddq + 2.0 * (wy * sz - wz * sy) * dq
                by += sy * ddq + 2.0 * (wz * sx - wx * sz) * dq
                bz += sz * ddq + 2.0 * (wx * sy - wy * sx) * dq
            else:
                # Only a first joint floats: there is no motion of a parent to add to.
                wx, wy, wz = v[k, to + 3], v[k, to + 4], v[k, to + 5]
                ax, ay, az = a[k, to + 3], a[k, to + 4], a[k, to + 5]
                bx += a[k, to] + wy * v[k, to + 2] - wz * v[k, to + 1]
                by += a[k, to + 1] + wz * v[k, to] - wx * v[k, to + 2]
                bz += a[k, to + 2] + wx * v[k, to + 1] - wy * v[k, to]
            spin[i, 0], spin[i, 1], spin[i, 2] = wx, wy, wz
            turning[i, 0], turning[i, 1], turning[i, 2] = ax, ay, az
            xx, yy, zz = wx * wx, wy * wy, wz * wz
            xy, xz, yz = wx * wy, wx * wz, wy * wz
            M[i, 0, 0], M[i, 0, 1], M[i, 0, 2], M[i, 0, 3] = bx, -yy - zz, xy - az, xz + ay
            M[i, 1, 0], M[i, 1, 1], M[i, 1, 2], M[i, 1, 3] = by, xy + az, -xx - zz, yz - ax
            M[i, 2, 0], M[i, 2, 1], M[i, 2, 2], M[i, 2, 3] = bz, xz - ay, yz + ax, -xx - yy
            M[i, 3, 2], M[i, 3, 3] = bz, -by
            M[i, 4, 1], M[i, 4, 3] = -bz, bx
            M[i, 5, 1], M[i, 5, 2] = by, -bx
            M[i, 3, 4], M[i, 3, 5], M[i, 3, 6] = ax, ay - xz, -yz
            M[i, 3, 7], M[i, 3, 8], M[i, 3, 9] = az + xy, yy - zz, yz
            M[i, 4, 4], M[i, 4, 5], M[i, 4, 6] = xz, ax + yz, ay
            M[i, 4, 7], M[i, 4, 8], M[i, 4, 9] = zz - xx, az - xy, -xz
            M[i, 5, 4], M[i, 5, 5], M[i, 5, 6] = -xy, xx - yy, xy
            M[i, 5, 7], M[i, 5, 8], M[i, 5, 9] = ax - yz, ay + xz, az
            for j in range(count[i]):
                lx, ly, lz = S[i, j, 0], S[i, j, 1], S[i, j, 2]
                ux, uy, uz = S[i, j, 4], S[i, j, 5], S[i, j, 6]
                m, to = moves[i, j], 10 * i
                f0, f1, f2, f3 = four(M[i], 0, lx, ly, lz)
                m0, m1, m2, m3 = four(M[i, 3:], 0, ux, uy, uz)
                m4, m5, m6, m7 = four(M[i, 3:], 4, ux, uy, uz)
                m8, m9, _, _ = four(M[i, 3:], 8, ux, uy, uz)
                direct = whole and not shared[m]
                # Straight into the block: a row in between takes an eighth of the time.
                own = out[k, column[m, 0], to : to + 10] if direct else row
                own[0], own[1], own[2], own[3] = f0 + m0, f1 + m1, f2 + m2, f3 + m3
                own[4], own[5], own[6], own[7], own[8], own[9] = m4, m5, m6, m7, m8, m9
                if direct:
                    continue
                for t in range(first[i], first[i + 1]):
                    value = row[wanted[t] - to]
                    for w in range(column.shape[1]):
                        out[k, column[m, w], route[wanted[t]]] += factor[m, w] * value
        for e in range(len(extra_row)):
            out[k, extra_row[e], extra_column[e]] = extra[k, e]
