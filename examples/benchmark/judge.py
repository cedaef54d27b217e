"""Judge an answer: from predicted efforts, and from the bodies where a tool returns any."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from records import Record

# Shares of the largest value that are rounding: of a mass matrix, a pseudo-inertia, a power.
ROUNDING = 1e-9
# Least eigenvalue of a pseudo-inertia that still passes: what FIGAROH accepts of its own.
BODY = 1e-8


@dataclass(frozen=True)
class Verdict:
    """What is found of an answer.

    Attributes
    ----------
    held_out, moving : float
        Error of predicted efforts over the measured ones, %, on all held-out rows and on those of
        joints that move.
    trained : float
        The same on the common rows that were trained on.
    cost : float
        Sum of the squared errors on those rows, (N·m)².
    least_eigenvalue : float
        Of the mass matrices on the held-out motion, kg·m².
    driving : int
        Joints that friction drives at some speed.
    bodies, positive, links : int or None
        Links that can be bodies (a distribution of mass, the 4×4 inequality), links of positive
        mass and inertia (6×6), and all that the tool returns; None where it returns none.
    """

    held_out: float
    moving: float
    trained: float
    cost: float
    least_eigenvalue: float
    driving: int
    bodies: int | None = None
    positive: int | None = None
    links: int | None = None


def judge(record: Record, predicted: np.ndarray, bodies: np.ndarray | None) -> Verdict:
    """Return the verdict on efforts predicted at the asked rows."""
    wanted = record.task.asked.position.shape
    if predicted.shape != wanted:
        raise ValueError(f"predicted efforts have the shape {predicted.shape}, asked was {wanted}")
    if not np.all(np.isfinite(predicted)):
        raise ValueError("predicted efforts are not finite")
    trained, held, masses, friction = (
        predicted[record.parts[k]] for k in ("trained", "held_out", "masses", "friction")
    )
    effort = record.task.common.effort
    assert effort is not None
    missed = effort - trained
    found = np.empty((0, 10)) if bodies is None else bodies
    return Verdict(
        held_out=_percent(record.truth, held),
        moving=_percent(record.truth[record.moving], held[record.moving]),
        trained=_percent(effort, trained),
        cost=float(np.sum(missed**2)),
        least_eigenvalue=least_eigenvalue(masses),
        driving=driving_joints(friction, record.speeds),
        bodies=None if bodies is None else sum(map(can_be_body, found)),
        positive=None if bodies is None else sum(map(is_positive, found)),
        links=None if bodies is None else len(found),
    )


def _percent(measured: np.ndarray, predicted: np.ndarray) -> float:
    return 100.0 * float(np.linalg.norm(measured - predicted) / np.linalg.norm(measured))


def least_eigenvalue(efforts: np.ndarray) -> float:
    """Return the least eigenvalue of the mass matrices that efforts of `_masses` tell."""
    n = efforts.shape[1]
    blocks = efforts.reshape(-1, n + 1, n)
    matrices = blocks[:, 1:] - blocks[:, :1]
    symmetric = 0.5 * (matrices + matrices.transpose(0, 2, 1))
    return float(np.linalg.eigvalsh(symmetric).min())


def driving_joints(efforts: np.ndarray, speeds: np.ndarray) -> int:
    """Return how many joints are driven by their friction at some speed."""
    n = efforts.shape[1]
    at_rest, turning = efforts[0], efforts[1:].reshape(-1, n, n)
    curves = np.einsum("kjj->kj", turning) - at_rest
    power = curves * speeds
    return int(np.any(power < -ROUNDING * np.abs(power).max(axis=0), axis=0).sum())


def _parts(body: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    xx, xy, yy, xz, yz, zz = body[4:]
    return float(body[0]), body[1:4], np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def can_be_body(body: np.ndarray) -> bool:
    """Return whether ten parameters can be those of a body, at the boundary or inside."""
    m, h, inertia = _parts(body)
    second = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    pseudo = np.block([[second, h[:, None]], [h[None], np.array([[m]])]])
    return bool(m > 0.0 and np.linalg.eigvalsh(pseudo)[0] >= -BODY)


def is_positive(body: np.ndarray) -> bool:
    """Return whether mass and rotational inertia about the center of mass are positive."""
    m, h, inertia = _parts(body)
    if m <= 0.0:
        return False
    central = inertia - (h @ h * np.eye(3) - np.outer(h, h)) / m
    return bool(np.linalg.eigvalsh(central)[0] >= -BODY)
