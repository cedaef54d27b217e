"""Rows of the equation of motion without unknown contact forces, and columns of all parameters."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import partial

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid.experiment.processing.contacts.contact_samples import TRANSMITS
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.model.contacts.jacobians import contact_jacobians
from sdpid.robot.model.model import RobotModel

# Widths of smooth signs (rad/s) that together imitate any dry friction.
_WIDTHS = (0.01, 0.02, 0.05, 0.2, 1.0)
# Directions of the regressor with less than this share of the largest singular value are noise.
_RANK = 1e-4


def regressor(robot: RobotModel, samples: Samples, rows: Indices) -> Array:
    """Return the columns of the links at some samples, (K, n, 10·links)."""
    return robot.regressor(
        samples.position[rows], samples.velocity[rows], samples.acceleration[rows]
    )


def free_columns(robot: RobotModel, samples: Samples, rows: Indices) -> Array:
    """Return columns of links, and of friction, rotors and offsets of every joint, (K, n, p)."""
    first, n = robot.n_base, robot.n
    wide = None if samples.wide is None else samples.wide[0]
    speed, rate = samples.velocity[rows], samples.acceleration[rows]
    signals = [speed, rate, np.ones_like(speed)]
    for width in _WIDTHS:
        if wide is None:
            signals.append(np.tanh(speed / width))
        else:
            signals.append(wide.filtered(partial(_smooth_sign, width))[rows])
    joints = np.arange(first, n)
    friction = np.zeros((len(rows), n, len(signals), n - first))
    for i, signal in enumerate(signals):
        friction[:, joints, i, joints - first] = signal[:, first:]
    return np.concatenate(
        [regressor(robot, samples, rows), friction.reshape(len(rows), n, -1)], axis=2
    )


def _smooth_sign(width: float, speed: Array, _rate: Array) -> Array:
    return np.asarray(np.tanh(speed / width))


def orthonormal(columns: Array, rank: float = _RANK) -> tuple[Array, Array]:
    """Return an orthonormal basis of columns, and the way from it to their weights.

    Directions with less than a share `rank` of the largest singular value are noise.
    """
    size = np.linalg.norm(columns, axis=0)
    inverse = np.where(size > 0.0, 1.0 / np.where(size > 0.0, size, 1.0), 0.0)
    scaled = columns * inverse
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    kept = values > rank**2 * values[-1]
    back = vectors[:, kept] / np.sqrt(values[kept])
    return np.asarray(scaled @ back), np.asarray(inverse[:, None] * back)


@dataclass(frozen=True, kw_only=True, eq=False)
class FreeRows:
    """Orthonormal combinations of scaled efforts that contacts leave free, sample by sample.

    Attributes
    ----------
    scale : (n,) ndarray
        Size of the error of each effort.
    groups : tuple of (indices, (k, r, n) ndarray)
        Samples with the same contacts closed, and the combinations of their efforts.
    """

    scale: Array
    groups: tuple[tuple[Indices, Array], ...]

    @classmethod
    def of(
        cls,
        robot: RobotModel,
        samples: Samples,
        rows: Indices,
        scale: Array,
        unknown: Mask | None = None,
    ) -> FreeRows:
        """Return the free rows of some samples.

        `unknown` (c, 6) says which forces and moments closed contacts may have that nobody knows;
        by default all that their kinds transmit.
        """
        contacts = samples.contacts
        if contacts is None:
            every = np.broadcast_to(np.diag(1.0 / scale), (len(rows), len(scale), len(scale)))
            return cls(scale=scale, groups=((np.arange(len(rows)), every),))
        J = contact_jacobians(robot, samples.position[rows], contacts.frames, contacts.offset)
        if unknown is None:
            wide = np.array([TRANSMITS[kind] for kind in contacts.kind])
            unknown = np.arange(6) < wide[:, None]
        patterns, which = np.unique(contacts.down[rows], axis=0, return_inverse=True)
        groups = []
        for number, down in enumerate(patterns):
            chosen = np.flatnonzero(which.reshape(-1) == number)
            parts = [J[chosen, i][:, own] for i, own in enumerate(unknown) if down[i] and own.any()]
            left = np.broadcast_to(np.eye(robot.n), (len(chosen), robot.n, robot.n))
            if parts:
                closed = np.concatenate(parts, axis=1) / scale
                if closed.shape[1] >= robot.n:
                    continue
                # A contact too many costs a row, and lets no force through.
                whole = np.linalg.qr(closed.transpose(0, 2, 1), mode="complete")[0]
                left = whole[:, :, closed.shape[1] :].transpose(0, 2, 1)
            groups.append((chosen, left / scale))
        return cls(scale=scale, groups=tuple(groups))

    def apply(self, values: Array) -> Array:
        """Return values (K, n, ...) of efforts in the free rows, (R, ...)."""
        width = values.shape[2:]
        if not self.groups:
            return np.zeros((0, *width))
        parts = []
        for rows, left in self.groups:
            own = left @ values[rows].reshape(len(rows), left.shape[2], -1)
            parts.append(own.reshape(-1, *width))
        return np.concatenate(parts)

    @property
    def sample(self) -> Indices:
        """The sample of each row, (R,)."""
        parts = [np.repeat(rows, left.shape[1]) for rows, left in self.groups]
        return np.concatenate(parts) if parts else np.zeros(0, dtype=np.intp)

    def rescaled(self, left: Array) -> Array:
        """Return the scale of which residuals (R,) are most likely, a step from the present one.

        The base's three forces share one, and so do its three torques.
        """
        top, bottom, first = np.zeros(len(self.scale)), np.zeros(len(self.scale)), 0
        for _, combined in self.groups:
            k, r, _ = combined.shape
            own = left[first : first + k * r].reshape(k, r)
            first += k * r
            top += np.sum(np.einsum("krn,kr->kn", combined, own) ** 2, axis=0)
            bottom += np.sum(combined**2, axis=(0, 1))
        for part in (slice(0, 3), slice(3, 6)):
            top[part], bottom[part] = top[part].sum(), bottom[part].sum()
        seen = (top > 0.0) & (bottom > 0.0)
        share = np.where(seen, top / np.where(seen, bottom, 1.0), 1.0)
        return np.asarray(self.scale * np.sqrt(share))


def first_scale(robot: RobotModel, effort: Array, unused: Collection[str] = ()) -> Array:
    """Return a scale of the efforts to begin with, of a robot with a floating base.

    Efforts of joints that are not used have an infinite one: their rows are zero.
    """
    joints = np.maximum(effort[:, robot.n_base :].std(axis=0), 1e-9)
    used = np.array([name not in unused for name in robot.joint_names[robot.n_base :]])
    base = np.full(robot.n_base, joints[used].mean() if used.any() else 1.0)
    base[:3] /= max(robot.reach, 1e-3)
    joints[~used] = np.inf
    return np.concatenate([base, joints])
