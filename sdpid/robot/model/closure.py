"""Positions of joints that loops close: found from those of the others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.errors import DataError
from sdpid.robot.model.jacobians import frame_axes, frame_offsets, relative_jacobians
from sdpid.robot.model.model import RobotModel

# Joints move by at most this from one solve to the next that starts there, rad or m: near enough
# for Newton's method, and for the loop to stay assembled as it is.
_STEP = 0.15
# Newton's method ends at this share of the robot's reach (and this angle, rad): rounding leaves
# 1e-16, an encoder's last digit is 1e-6.
_CLOSED = 1e-12
_OPEN = 1e-9
_ITERATIONS = 30
# How far from where it is said to be a loop is sought, rad or m, one after another.
_BESIDE = (0.0, 0.1, 0.3, 1.0, 1.0, 1.0)
# Added to the diagonal of the normal equations, as a share of its sum: links in one line leave a
# direction without a slope.
_DAMPING = 1e-12
# No step of the method is longer, rad or m.
_LONGEST = 0.5
# Directions of the Jacobian below this share of its largest one move nothing: where links are in
# one line a loop does not determine its joints.
_RANK = 1e-7


def close_loops(robot: RobotModel, position: Array, unknown: Sequence[str]) -> Array:
    """Return joint positions of which some close the robot's loops.

    Of the ways to assemble a loop the one is taken that is nearest to `RobotModel.assembled`, and
    followed from there.

    Parameters
    ----------
    robot : RobotModel
        With `loops`.
    position : ndarray, shape (N, joints)
        A motion; columns of joints that are not known may hold anything.
    unknown : sequence of str
        Joints whose positions are to be found.

    Returns
    -------
    ndarray, shape (N, joints)

    Raises
    ------
    DataError
        When the loops do not determine these joints, or cannot be closed.

    Examples
    --------
    >>> q = close_loops(robot, position, ["coupler_joint", "rocker_joint"])
    """
    names = robot.joint_names[robot.n_base :]
    free = np.array([names.index(name) for name in unknown], dtype=np.intp)
    known = np.setdiff1d(np.arange(len(names)), free)
    listed = ", ".join(unknown)
    at = _assembled(robot)[0] if robot.loops else np.zeros(0)
    if not robot.loops or _rank(robot, at[None], free) < len(free):
        raise DataError(
            f"loops: those of '{robot.name}' do not determine the positions of {listed} from those "
            "of the other joints; record them, or state the loops that close them."
        )
    # To the first sample in small steps, then from knot to knot.
    first = position[0, known] - at[known]
    count = max(1, int(np.ceil(np.abs(first).max(initial=0.0) / _STEP)))
    approach = at[known] + np.linspace(0.0, 1.0, count + 1)[1:, None] * first
    knots = _knots(position[:, known])
    driven = np.vstack([approach, position[knots][:, known]])
    found = np.empty((len(driven), len(names)))
    for k, row in enumerate(driven):
        guess = at.copy()
        guess[known] = row
        (at,), off = _newton(robot, guess[None], free)
        if off[0] > _OPEN:
            number = 0 if k < len(approach) else int(knots[k - len(approach)])
            raise _open(robot, listed, number, float(off[0]))
        found[k] = at
    found = found[len(approach) :]
    guess = np.array(position, dtype=np.float64)
    for j in free:
        guess[:, j] = np.interp(np.arange(len(position)), knots, found[:, j])
    closed, off = _newton(robot, guess, free)
    moved = np.abs(closed - guess).max(axis=1, initial=0.0)
    wrong = np.flatnonzero((off > _OPEN) | (moved > _LONGEST))
    if len(wrong):
        raise _open(robot, listed, int(wrong[0]), float(off[wrong[0]]))
    closed[:, known] = position[:, known]
    return closed


def _assembled(robot: RobotModel) -> Array:
    """Return positions in which the loops are closed, (1, joints)."""
    names = robot.joint_names[robot.n_base :]
    rough = np.zeros((1, len(names)))
    passive = np.array([names.index(name) for name in robot.passive], dtype=np.intp)
    rough[0, passive] = robot.assembled
    rng, least = np.random.default_rng(0), np.inf
    # Links in one line give Newton's method no direction: then it starts beside them.
    for away in _BESIDE:
        for free in (passive, np.arange(len(names))):
            guess = rough.copy()
            guess[:, free] += away * rng.uniform(-1.0, 1.0, len(free))
            found, off = _newton(robot, guess, free)
            if off[0] < _OPEN:
                return found
            least = min(least, float(off[0]))
    raise DataError(
        f"loops: those of '{robot.name}' cannot be closed: the least gap is {least:.3g} of the "
        "robot's reach; check the ends of the loops in the description, and say about where joints "
        "without motors are (<passive_joint name=... position=...>)."
    )


def _open(robot: RobotModel, joints: str, sample: int, off: float) -> DataError:
    return DataError(
        f"loops: those of '{robot.name}' cannot be closed by {joints} at sample {sample + 1}: the "
        f"least gap is {off:.3g} of the robot's reach; check the other joints' zeros, signs and "
        "units, or record all positions."
    )


def _knots(position: Array) -> Indices:
    """Return samples between which no joint moves farther than a step, the first and the last."""
    moved = np.abs(np.diff(position, axis=0)).max(axis=1, initial=0.0)
    stage = np.floor(np.concatenate([[0.0], np.cumsum(moved)]) / _STEP)
    marks = np.flatnonzero(np.diff(stage)) + 1
    return np.unique(np.concatenate([[0], marks, [len(position) - 1]])).astype(np.intp)


def _newton(robot: RobotModel, position: Array, free: Indices) -> tuple[Array, Array]:
    """Return positions whose free joints close the loops, and how far open they are then."""
    position = position.copy()
    off = np.full(len(position), np.inf)
    left = np.arange(len(position))
    for _ in range(_ITERATIONS):
        gap, J = _gaps(robot, position[left], free)
        off[left] = np.sqrt(np.sum(gap**2, axis=1))
        turned = np.swapaxes(J, 1, 2)
        square = turned @ J
        trace = np.einsum("kii->k", square)
        square += (_DAMPING * trace + np.finfo(float).tiny)[:, None, None] * np.eye(len(free))
        step = np.linalg.solve(square, -(turned @ gap[:, :, None]))[:, :, 0]
        longest = np.abs(step).max(axis=1, initial=0.0)
        step *= np.minimum(1.0, _LONGEST / np.maximum(longest, _LONGEST))[:, None]
        # What is closed but for rounding takes its last step.
        moving = off[left] > _CLOSED
        position[np.ix_(left[moving], free)] += step[moving]
        left = left[moving & (longest > _CLOSED)]
        if not len(left):
            break
    return position, off


def _rank(robot: RobotModel, position: Array, free: Indices) -> int:
    size = np.linalg.svd(_gaps(robot, position, free)[1][0], compute_uv=False)
    return int(np.count_nonzero(size > _RANK * size.max(initial=0.0)))


def _gaps(robot: RobotModel, position: Array, free: Indices) -> tuple[Array, Array]:
    """Return how far loops are open (K, g), as shares of the reach, and the derivatives (K, g, f).

    Angles are cross products of axes that are to be parallel.
    """
    q = robot.at_rest(position) if robot.free_flyer else position
    own = [loop.frame for loop in robot.loops]
    other = [loop.against for loop in robot.loops]
    J = relative_jacobians(robot, q, own, other)[..., robot.n_base + free]
    gaps = frame_offsets(robot, q, own, other)
    axes, against = frame_axes(robot, q, own), frame_axes(robot, q, other)
    values, slopes = [], []
    for i, loop in enumerate(robot.loops):
        values.append(gaps[:, i] / robot.reach)
        slopes.append(J[:, i, :3] / robot.reach)
        parallel = {"point": (), "line": (1,), "plane": (0, 1, 2)}[loop.kind]
        for a in parallel:
            y, z = axes[:, i, :, a], against[:, i, :, a]
            values.append(np.cross(y, z))
            # (w × y) × z = y (w·z) − w (y·z) for the rate w between the two.
            along = np.einsum("kif,ki->kf", J[:, i, 3:], z)
            both = np.einsum("ki,ki->k", y, z)
            slopes.append(y[:, :, None] * along[:, None] - J[:, i, 3:] * both[:, None, None])
    return np.concatenate(values, axis=1), np.concatenate(slopes, axis=1)
