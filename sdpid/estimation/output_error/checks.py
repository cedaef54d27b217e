"""Whether a controller is that of a recording, told before anything is solved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.estimation.output_error.followed import ClosedLoop

# Efforts of joints below this share of the largest hold nothing to compare.
_SILENT = 1e-3

# A ratio counts as off where it is off by this many of its standard errors.
_ERRORS = 3.0


@dataclass(frozen=True, kw_only=True, eq=False)
class ControllerCheck:
    """Measured efforts beside those that the controller gives on the measured motion.

    Attributes
    ----------
    ratio : ndarray, shape (n,)
        Least-squares factor from the controller's efforts to the measured ones; 1 where a joint
        has no effort.
    error : ndarray, shape (n,)
        Its standard error.
    misfit : ndarray, shape (n,)
        Root mean square of their difference over that of the measured efforts.
    names : tuple of str
        Of the joints.
    """

    ratio: Array
    error: Array
    misfit: Array
    names: tuple[str, ...]

    @classmethod
    def of(cls, loop: ClosedLoop) -> ControllerCheck:
        """Compare, sample by sample, what passes the filter.

        The measured motion answers the controller, so a wrong model of the robot has no say.
        """
        measured, told = loop.twin.measured, loop.told_samples()
        gains = getattr(loop.controller, "gains", None)
        integral = None
        if gains is not None and np.any(gains.integral):
            integral = _integral(told.position - measured.position, loop)
        given = loop.controller.effort(
            measured.position,
            measured.velocity,
            told.position,
            told.velocity,
            told.acceleration,
            integral,
        )
        effort, block = measured.effort, max(measured.block, 1)
        n = effort.shape[1]
        ratio, error, misfit = np.ones(n), np.full(n, np.inf), np.zeros(n)
        largest = float(np.sqrt(np.mean(effort**2, axis=0)).max())
        for j in range(n):
            u, y = given[:, j], effort[:, j]
            if integral is not None:
                # Where the integral began is not known.
                u, y = u - u.mean(), y - y.mean()
            power, size = float(u @ u), float(np.sqrt(np.mean(y**2)))
            if power == 0.0 or size <= _SILENT * largest:
                continue
            ratio[j] = float(u @ y) / power
            scores = u * (y - ratio[j] * u)
            sums = np.add.reduceat(scores, np.arange(0, len(scores), block))
            error[j] = float(np.sqrt(np.sum(sums**2))) / power
            misfit[j] = float(np.sqrt(np.mean((y - u) ** 2))) / size
        return cls(ratio=ratio, error=error, misfit=misfit, names=loop.twin.robot.joint_names)

    def require(self, tolerance: float) -> None:
        """Raise where a ratio is off by more than the tolerance, and by more than its errors.

        Raises
        ------
        DataError
            Naming the joint that is off most.
        """
        off = np.abs(self.ratio - 1.0)
        wrong = off > np.maximum(tolerance, _ERRORS * self.error)
        if not wrong.any():
            return
        j = int(np.argmax(np.where(wrong, off, 0.0)))
        raise DataError(
            f"output error: the controller is not that of this log: measured efforts of joint "
            f"{self.names[j]} are {self.ratio[j]:.3g} times those that it gives on the measured "
            f"motion (± {2.0 * self.error[j]:.1g}; {int(wrong.sum())} joints are off by more than "
            f"{100 * tolerance:g} %), and every parameter would be off as much. Give the gains "
            "that ran, controller='fit', method='didim' or sdpid.solve_instrumental, which hardly "
            "depend on them, or allow it (controller_tolerance)."
        )


def _integral(error: Array, loop: ClosedLoop) -> Array:
    """Return the integral of filtered tracking errors (K, n), piece by piece."""
    samples = loop.twin.measured
    out = np.zeros_like(error)
    for part in samples.parts:
        if samples.time is not None:
            steps = np.diff(samples.time[part], prepend=samples.time[part][0])
        else:
            steps = np.full(part.stop - part.start, loop.twin.logs[0].step)
        own = error[part]
        middle = 0.5 * (own + np.vstack([own[:1], own[:-1]]))
        out[part] = np.cumsum(steps[:, None] * middle, axis=0)
    return out
