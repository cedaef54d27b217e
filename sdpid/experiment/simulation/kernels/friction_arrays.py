"""Friction terms of a model as plain arrays, which the compiled loops take."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import ModelError
from sdpid.experiment.simulation.kernels.friction import LINE, PEAK_REST, ROOT, SMOOTH_PEAK, TANH
from sdpid.robot.friction.posed import LoadFriction, Tilt
from sdpid.robot.friction.term import FrictionTerm, JointwiseTerm, joint_speeds
from sdpid.robot.friction.terms import (
    AsymmetricCoulomb,
    Coulomb,
    Coupling,
    Offset,
    RotorInertia,
    SigmoidFriction,
    SquareRootFriction,
    Stribeck,
    Viscous,
)

# A term of one's own is linear between these speeds, rad/s or m/s, in steps of 7 %, which miss a
# square by less than 0.15 %. Below the first it may jump, above the last it goes on as before.
_SPEEDS = np.geomspace(1e-4, 1e2, 200)

# Less of a term's largest effort is no jump.
_JUMP = 1e-4

# Joints of a curve: its own, and the other one of a coupled motor or -1.
_Where = tuple[int, int]


@dataclass
class FrictionArrays:
    """What terms and their parameters say, gathered joint by joint.

    Attributes
    ----------
    n : int
        Joints.
    viscous : ndarray, shape (n, n)
        Effort per velocity.
    constant : ndarray, shape (n,)
        Effort at rest.
    curves : list
        Joints, kind, side and the four numbers of every smooth curve.
    jumps : dict
        Joints and velocity of every jump to its least and its largest effort.
    load : ndarray, shape (n, 4)
        Share of the load, share of the sigmoid in it, its speed, width of the sign.
    """

    n: int
    viscous: Array = field(init=False)
    constant: Array = field(init=False)
    curves: list[tuple[int, int, int, int, float, float, float, float]] = field(init=False)
    jumps: dict[tuple[int, int, float], list[float]] = field(init=False)
    load: Array = field(init=False)

    def __post_init__(self) -> None:
        self.viscous, self.constant = np.zeros((self.n, self.n)), np.zeros(self.n)
        self.curves, self.jumps, self.load = [], {}, np.zeros((self.n, 4))

    def add(self, term: FrictionTerm, values: Array, joint_names: tuple[str, ...]) -> None:
        """Add a term with the values of its parameters.

        Raises
        ------
        ModelError
            For a class of terms that is not simulated.
        """
        n, kind = self.n, type(term)
        joints = range(n)
        if kind is RotorInertia or kind is Tilt:
            return  # mass and gravity: not friction
        if isinstance(term, Coulomb) and kind is Coulomb:
            for j, width in enumerate(term.speed("width", n)):
                self._sign((j, -1), values[j], width, term.dead_zone, 0)
        elif isinstance(term, AsymmetricCoulomb) and kind is AsymmetricCoulomb:
            for j, width in enumerate(joint_speeds(term, "width", n)):
                self._sign((j, -1), values[j], width, term.dead_zone, 1)
                self._sign((j, -1), values[n + j], width, term.dead_zone, -1)
        elif kind is Viscous:
            self.viscous[joints, joints] += values
        elif kind is Offset:
            self.constant += values
        elif kind is SquareRootFriction:
            self.curves += [(j, -1, ROOT, 0, values[j], 1.0, 1.0, 1.0) for j in joints]
        elif isinstance(term, SigmoidFriction) and kind is SigmoidFriction:
            speeds = term.speed("velocity", n)
            self.curves += [(j, -1, TANH, 0, values[j], 1.0, 0.0, speeds[j]) for j in joints]
        elif isinstance(term, Stribeck) and kind is Stribeck:
            speeds, power = term.speed("velocity", n), min(term.exponent, 50.0)
            for j, width in enumerate(term.speed("width", n)):
                if width > 0.0:
                    peak = (j, -1, SMOOTH_PEAK, 0, values[j], speeds[j], power, width)
                else:
                    self._jump((j, -1), 0.0, -values[j], values[j])
                    peak = (j, -1, PEAK_REST, 0, values[j], speeds[j], power, 1.0)
                self.curves.append(peak)
        elif isinstance(term, Coupling) and kind is Coupling:
            i, j = joint_names.index(term.first), joint_names.index(term.second)
            self.viscous[i, j] += values[1]
            self.viscous[j, i] += values[1]
            self._sign((min(i, j), max(i, j)), values[2], term.width or 0.0, 0.0, 0)
        elif isinstance(term, LoadFriction) and kind is LoadFriction:
            self.load[:, 0] = values
            self.load[:, 3] = joint_speeds(term, "width", n)
            if term.share:
                self.load[:, 1] = term.share
                self.load[:, 2] = joint_speeds(term, "velocity", n)
            for j in joints:
                if self.load[j, 3] == 0.0 and self.load[j, 1] < 1.0:
                    self._jump((j, -1), 0.0, 0.0, 0.0)
        elif isinstance(term, JointwiseTerm) and kind.columns is JointwiseTerm.columns:
            self._lines(term, values)
        else:
            raise ModelError(
                f"simulation: the friction term {kind.__name__} is neither one of sdpid's own nor "
                "a JointwiseTerm, so that its jumps and slopes are not known; identify with terms "
                "of sdpid.friction."
            )

    def arrays(self) -> tuple[Any, Array, Any, Array]:
        """Return joints, kinds and sides of curves, their numbers, and joints and efforts of jumps.

        The last column of jumps says where friction of the load adds to them.
        """
        which = np.array([curve[:4] for curve in self.curves], dtype=np.int64).reshape(-1, 4)
        numbers = np.array([curve[4:] for curve in self.curves], dtype=np.float64).reshape(-1, 4)
        joints = np.array([key[:2] for key in self.jumps], dtype=np.int64).reshape(-1, 2)
        exact = (self.load[:, 0] != 0.0) & (self.load[:, 3] == 0.0)
        efforts = [
            (shift, *ends, float(j < 0 and shift == 0.0 and exact[i]))
            for (i, j, shift), ends in self.jumps.items()
        ]
        return which, numbers, joints, np.array(efforts, dtype=np.float64).reshape(-1, 4)

    def _lines(self, term: JointwiseTerm, values: Array) -> None:
        """Add a term of one's own, as lines between speeds and a jump at rest.

        Raises
        ------
        ModelError
            When its effort depends on the acceleration.
        """
        v = np.array([-1.0, 1.0])[:, None, None] * np.tile(_SPEEDS[:, None], (1, self.n))
        still, fast = (
            np.stack([term.shape(x, np.full_like(x, a)) for x in v]) * values for a in (0.0, 1.0)
        )
        if not np.array_equal(still, fast):
            raise ModelError(
                f"simulation: the effort of {type(term).__name__} depends on the acceleration, "
                "which is not simulated; identify with terms of sdpid.friction."
            )
        slopes, ends = np.diff(still, axis=1) / np.diff(v, axis=1), [*_SPEEDS[:-1], np.inf]
        self.curves += [
            (int(j), -1, LINE, 2 * int(side) - 1, slopes[side, k, j], 1.0, ends[k], ends[k + 1])
            for side, k, j in np.argwhere(slopes != 0.0)
        ]
        for j, (low, high) in enumerate(still[:, 0].T):
            if abs(high - low) > _JUMP * np.abs(still[..., j]).max():
                self._jump((j, -1), 0.0, low, high)
            else:
                self.constant[j] += 0.5 * (low + high)

    def _sign(self, where: _Where, c: float, width: float, dead: float, side: int) -> None:
        """Add a sign, exact or smooth, beyond a dead zone, on one side or on both (0)."""
        at_edge = c * (math.tanh(dead / width) if width > 0.0 else 1.0)
        if width > 0.0:
            self.curves.append((*where, TANH, side, c, 1.0, dead, width))
        if width > 0.0 and not dead:
            return
        if side >= 0:
            self._jump(where, dead, 0.0, at_edge)
        if side <= 0:
            self._jump(where, -dead if dead else 0.0, -at_edge, 0.0)

    def _jump(self, where: _Where, at: float, low: float, high: float) -> None:
        """Add a jump of the effort at a velocity to those there."""
        ends = self.jumps.setdefault((*where, at), [0.0, 0.0])
        ends[0] += low
        ends[1] += high
