"""What a run is for: the functions of the base parameters that are to be known well."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid.errors import DataError
from sdpid.estimation.compression.rows import RowSource
from sdpid.excitation.criterion.belief import nominal_bodies
from sdpid.excitation.criterion.noise import usual_effort
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.base_parameters import BaseParameters
from sdpid.robot.model.model import RobotModel

PURPOSES = ("all", "payload", "friction", "gravity", "torque")

# Postures at which gravity's efforts are to be known, drawn within the position limits.
_POSTURES, _SEED = 400, 20210621

# Directions that matter less than this, beside the one that matters most, do not count.
_NEGLIGIBLE = 1e-9


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
    words : str
        What is wanted, to follow 'this plan is for'.
    """

    name: str
    directions: Array
    functionals: Array
    kind: Literal["volume", "sum"]
    words: str

    def information(self, information: Array) -> Array:
        """Return the information (r, r) of the unknown numbers, from that of all (b, b)."""
        return np.asarray(self.directions.T @ information @ self.directions)

    def covariance(self, information: Array) -> Array:
        """Return the covariance (k, k) of what counts, from the information (b, b) of all.

        Raises
        ------
        numpy.linalg.LinAlgError
            When the information leaves an unknown number open.
        """
        own = self.information(information)
        scale = 1.0 / np.sqrt(np.diag(own))
        root = np.linalg.cholesky(own * np.outer(scale, scale))
        half = np.linalg.solve(root, (self.functionals * scale).T)
        return np.asarray(half.T @ half)


def purpose_of(
    name: str,
    robot: RobotModel,
    friction: FrictionModel,
    base: BaseParameters,
    *,
    motion: tuple[Array, Array, Array] | None = None,
) -> Purpose:
    """Return what counts for a purpose.

    Parameters
    ----------
    name : {"all", "payload", "friction", "gravity", "torque"}
        ``all``: every base parameter. ``payload``: the ten parameters of the last link, the other
        links and friction known. ``friction``: the friction terms. ``gravity``: the efforts that
        hold the robot still, over its range. ``torque``: the efforts of a motion.
    robot, friction, base
        The robot, its terms and base parameters.
    motion : (position, velocity, acceleration), optional
        States (K, n) for ``torque``.

    Raises
    ------
    DataError
        When there is no such purpose, or ``torque`` has no motion, or nothing counts.
    """
    if name not in PURPOSES:
        raise DataError(f"purpose: is {name!r}; use one of {', '.join(PURPOSES)}.")
    every = np.eye(base.count)
    links = 10 * robot.n_links
    if name == "all":
        return _made(name, every, every, "volume", "all parameters")
    if name == "payload":
        held = _independent(base.matrix[:, links - 10 : links])
        words = f"the payload: the inertial parameters of '{robot.link_names[-1]}', others known"
        return _made(name, held, np.eye(held.shape[1]), "volume", words)
    if name == "friction":
        own = np.flatnonzero(base.kept >= links)
        if not own.size:
            raise DataError("purpose: is 'friction', but there are no friction terms; name some.")
        return _made(name, every, every[own], "volume", "friction")
    if name == "gravity":
        rng = np.random.default_rng(_SEED)
        low, high = robot.position_limits.T
        low, high = (
            np.where(np.isfinite(low), low, -np.pi),
            np.where(np.isfinite(high), high, np.pi),
        )
        q = rng.uniform(low, high, (_POSTURES, robot.n))
        still = np.zeros_like(q)
        # At rest friction is what it was: it tells nothing, and nothing is asked of it.
        functionals = effort_functionals(robot, friction, base, q, still, still)
        functionals[:, base.kept >= links] = 0.0
        words = "gravity: the efforts that hold the robot still, over its range"
        return _made(name, every, functionals, "sum", words)
    if motion is None:
        raise DataError(
            "purpose: is 'torque'; give the motion whose efforts are to be predicted (predict=, or "
            "--predict)."
        )
    functionals = effort_functionals(robot, friction, base, *motion)
    return _made(name, every, functionals, "sum", "the efforts of the motion given")


def effort_functionals(
    robot: RobotModel,
    friction: FrictionModel,
    base: BaseParameters,
    position: Array,
    velocity: Array,
    acceleration: Array,
    scale: Array | None = None,
) -> Array:
    """Return L (b, b) such that ``tr(L·C·L^T)`` is the mean variance of efforts, over the joints.

    Parameters
    ----------
    robot, friction, base
        What the efforts are those of.
    position, velocity, acceleration : ndarray, shape (K, n)
        The states.
    scale : ndarray, shape (n,), optional
        Efforts are counted in units of these, N·m; by default each joint's usual effort on these
        states: the geometric mean of its rms and the largest one, by the robot's description.
    """
    zeros = np.zeros_like(velocity)
    samples = Samples(position=position, velocity=velocity, acceleration=acceleration, effort=zeros)
    rows = RowSource(robot, friction, base, samples)
    products = np.zeros((robot.n, base.count, base.count))
    for _, W, _, _ in rows.chunks():
        for j in range(robot.n):
            products[j] += W[:, j].T @ W[:, j]
    products /= len(zeros)
    if scale is None:
        effort = robot.inverse_dynamics(nominal_bodies(robot)[0], position, velocity, acceleration)
        scale = usual_effort(np.sqrt(np.mean(effort**2, axis=0)))
    mean = np.einsum("jab,j->ab", products, 1.0 / scale**2) / robot.n
    values, vectors = np.linalg.eigh(mean)
    return np.asarray(np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T)


def _independent(columns: Array) -> Array:
    """Return the columns of a matrix that are independent, scanned from the first on."""
    kept: list[int] = []
    for k in range(columns.shape[1]):
        if np.linalg.matrix_rank(columns[:, [*kept, k]], tol=1e-9) > len(kept):
            kept.append(k)
    return columns[:, kept]


def _made(
    name: str,
    directions: Array,
    functionals: Array,
    kind: Literal["volume", "sum"],
    words: str,
) -> Purpose:
    size = np.linalg.norm(functionals, axis=1)
    kept = functionals[size > _NEGLIGIBLE * size.max(initial=0.0)]
    if not len(kept):
        raise DataError(
            f"purpose: is '{name}', and none of the robot's {len(directions)} base parameters "
            "counts for it; choose another, or all."
        )
    return Purpose(
        name=name,
        directions=frozen(directions),
        functionals=frozen(kept),
        kind=kind,
        words=words,
    )
