"""Delays that the equation of motion shows: efforts, and an IMU, against the joints.

A channel that is late by d makes residuals that are, to first order, d times their derivative by
the delay. Parameters of links and friction that fit best are taken off both (variable projection),
and what is left of one is compared with what is left of the other. Contacts are taken for closed
throughout: forces that flags deny look like delays, and rows without them need no flags.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.experiment.inspection.delays.free_rows import (
    FreeRows,
    first_scale,
    free_columns,
    orthonormal,
    regressor,
)
from sdpid.experiment.inspection.delays.lag import Delay, block_error
from sdpid.experiment.inspection.delays.standing import on_legs
from sdpid.experiment.processing.choose import default_processing
from sdpid.experiment.processing.contacts.contact_samples import TRANSMITS
from sdpid.experiment.processing.delays.on_time import on_time
from sdpid.experiment.processing.derivatives import BAND_OVER_RATE
from sdpid.experiment.processing.process import process
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.recording import Recording, rows_of
from sdpid.robot.model.model import RobotModel

# Cut-offs (Hz). Of simulated quadrupeds efforts were found within 0.2 ms at 20 to 30 Hz with an
# IMU; at 10 Hz the signs of speeds are smeared. Accelerations from poses need 10 Hz: at 20 Hz their
# noise in the regressor made 2 ms of 0.8 to 3.4.
_CUTOFF_HZ, _POSE_CUTOFF_HZ = 30.0, 10.0
# Flags may be late as well (s), where they are needed.
_MARGIN = 0.01
# Rows a sample that are left where every contact is closed. With the six of a quadruped on balls
# delays are found as well as with right flags, whatever flags say.
_LEAST_FREE = 6
# Samples that are looked at, spread evenly.
_ROWS = 600
# Half the distance of two delays whose difference is a derivative (s).
_HALF = 5e-4
_STEPS, _NEAR, _WEIGHTINGS = 4, 1e-4, 3
# Where the equation of motion leaves more than this share of the efforts' mean square, something
# else is wrong: simulated quadrupeds leave at most 0.002.
_UNLIKE = 0.05


def is_held(robot: RobotModel, log: Recording) -> bool:
    """Tell whether a base is held throughout, so that it does not matter how it moves."""
    contacts = log.contacts
    if contacts is None or contacts.down is None:
        return False
    planes = np.array([kind == "plane" for kind in contacts.kind])
    holding = planes & ~on_legs(robot, log)
    return bool(holding.any()) and bool(contacts.down[:, holding].any(axis=1).all())


def dynamic_delays(
    robot: RobotModel, log: Recording, unused: Collection[str] = ()
) -> dict[str, Delay]:
    """Return the delays of ``"effort"`` and ``"imu"`` that make the equation of motion hold best.

    Parameters
    ----------
    robot : RobotModel
        With a floating base.
    log : Recording
        Without gaps; its joints are the robot's.
    unused : collection of str, optional
        Joints whose efforts say nothing.

    Returns
    -------
    dict
        That of the IMU only where there is one on a base that moves.
    """
    base, held = log.base, is_held(robot, log)
    sensed = base is not None and base.imu is not None and base.imu.accelerometer is not None
    names = ("effort", "imu") if sensed and not held else ("effort",)
    processing = _processing(log, quiet=sensed or held)
    log = _all_closed(robot, log)
    delays, scale, found = np.zeros(len(names)), None, {}
    for _ in range(_STEPS):
        rows = _Linearized.of(robot, log, processing, dict(zip(names, delays, strict=True)))
        if scale is None:
            scale = first_scale(robot, rows.samples.effort, unused)
        for _ in range(_WEIGHTINGS):
            free = FreeRows.of(robot, rows.samples, rows.picked, scale)
            solved = rows.solve(free)
            if solved is None:
                return {}
            change, errors, left = solved
            unlike = float(np.sum(left**2) / np.sum(free.apply(rows.effort) ** 2))
            scale = free.rescaled(left)
        delays = delays + change
        found = {
            name: Delay(value=float(value), error=float(error))
            for name, value, error in zip(names, delays, errors, strict=True)
        }
        if unlike > _UNLIKE:
            return {}
        if np.abs(change).max() < _NEAR:
            break
    return found


def _all_closed(robot: RobotModel, log: Recording) -> Recording:
    """Return a recording whose contacts are closed throughout, those that ever are.

    As it is where that leaves too few rows.
    """
    contacts = log.contacts
    if contacts is None:
        return log
    down = np.array(np.broadcast_to(contacts.closed.any(axis=0), contacts.closed.shape))
    taken = sum(TRANSMITS[kind] for kind, any_ in zip(contacts.kind, down[0], strict=True) if any_)
    if robot.n - taken < _LEAST_FREE:
        return log
    return replace(log, contacts=replace(contacts, down=down))


def _processing(log: Recording, *, quiet: bool) -> Processing:
    """Return the processing in which delays are looked for."""
    cutoff = min(_CUTOFF_HZ if quiet else _POSE_CUTOFF_HZ, BAND_OVER_RATE * log.rate_hz)
    return replace(
        default_processing(log),
        cutoff_hz=cutoff,
        decimation=None,
        reversal_time=None,
        contact_margin_s=_MARGIN,
        impact_s=None,
        contact_force_std=None,
        contact_moment_std=None,
        reasons=(),
    )


def _at(log: Recording, delays: Mapping[str, float], margin: float) -> Recording:
    """Return a recording without delays, and without so many seconds at its ends."""
    fields: dict[str, Any] = {f"{name}_delay_s": float(delay) for name, delay in delays.items()}
    moved = on_time(log, replace(Processing(), **fields))
    inside = (moved.time > log.time[0] + margin) & (moved.time < log.time[-1] - margin)
    return rows_of(moved, np.asarray(inside))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Linearized:
    """Rows of a recording at some delays, and how they change with them.

    Attributes
    ----------
    samples : Samples
    picked : (K,) ndarray of int
        Samples that are looked at.
    columns : (K, n, p) ndarray
        Regressor of links and friction.
    effort : (K, n) ndarray
    effort_rates : tuple of (K, n) ndarray
        Derivatives of the efforts by each delay.
    regressor_rates : tuple of (K, n, links) ndarray or None
        Those of the regressor of the links; None where it does not depend on a delay.
    """

    samples: Samples
    picked: Indices
    columns: Array
    effort: Array
    effort_rates: tuple[Array, ...]
    regressor_rates: tuple[Array | None, ...]

    @classmethod
    def of(
        cls,
        robot: RobotModel,
        log: Recording,
        processing: Processing,
        delays: Mapping[str, float],
    ) -> _Linearized:
        """Process a recording at some delays and on either side of each."""
        gravity = robot.gravity.tolist()
        half = max(_HALF, 0.5 * log.step)
        # All have the same rows, whatever shifting loses at their ends.
        margin = max(abs(delay) for delay in delays.values()) + half + 1.5 * log.step
        samples = process(_at(log, delays, margin), processing, gravity=gravity)
        picked = np.unique(np.linspace(0, samples.n_samples - 1, _ROWS).astype(np.intp))
        effort_rates: list[Array] = []
        regressor_rates: list[Array | None] = []
        for name, delay in delays.items():
            ends = [
                process(
                    _at(log, {**delays, name: delay + side}, margin), processing, gravity=gravity
                )
                for side in (half, -half)
            ]
            late, early = (end.effort[picked] for end in ends)
            effort_rates.append((late - early) / (2.0 * half))
            regressor_rates.append(None)
            if name != "effort":
                late, early = (regressor(robot, end, picked) for end in ends)
                regressor_rates[-1] = (late - early) / (2.0 * half)
        return cls(
            samples=samples,
            picked=picked,
            columns=free_columns(robot, samples, picked),
            effort=samples.effort[picked],
            effort_rates=tuple(effort_rates),
            regressor_rates=tuple(regressor_rates),
        )

    def solve(self, free: FreeRows) -> tuple[Array, Array, Array] | None:
        """Return changes of the delays, their errors, and residuals; None where nothing shows."""
        columns, effort = free.apply(self.columns), free.apply(self.effort)
        if len(columns) <= columns.shape[1]:
            return None
        basis, back = orthonormal(columns)
        fitted = basis.T @ effort
        theta, left = back @ fitted, effort - basis @ fitted
        slopes = []
        for effort_rate, regressor_rate in zip(
            self.effort_rates, self.regressor_rates, strict=True
        ):
            rate = free.apply(effort_rate)
            if regressor_rate is not None:
                links = regressor_rate.shape[2]
                rate = rate - free.apply(regressor_rate @ theta[:links])
            slopes.append(rate - basis @ (basis.T @ rate))
        slope = np.column_stack(slopes)
        power = slope.T @ slope
        if not np.linalg.cond(power) < 1.0 / np.finfo(float).eps:
            return None
        change = -np.linalg.solve(power, slope.T @ left)
        left = left + slope @ change
        # By time, so that neighbors, whose errors are alike, are in one block.
        order = np.lexsort((free.sample,))
        influence = np.linalg.solve(power, (slope * left[:, None]).T)[:, order]
        errors = np.array([block_error(each, 1.0) for each in influence])
        return np.asarray(change), errors, np.asarray(left)
