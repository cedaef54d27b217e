"""Friction terms of a model as plain arrays, which the compiled loops take."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.simulation.kernels.friction import LINE, PEAK_REST, ROOT, SMOOTH_PEAK, TANH
from sdpid.robot.friction.term import FrictionTerm, simulated_curves

_KINDS = {
    "tanh": TANH,
    "root": ROOT,
    "peak": PEAK_REST,
    "smooth_peak": SMOOTH_PEAK,
    "line": LINE,
}


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
        for curve in simulated_curves(term, values, joint_names):
            (i, j), numbers = curve.joints, curve.numbers
            if curve.kind == "slope":
                self.viscous[i, j] += curve.size
            elif curve.kind == "constant":
                self.constant[i] += curve.size
            elif curve.kind == "load":
                self.load[i] = (curve.size, *numbers)
            elif curve.kind == "jump":
                ends = self.jumps.setdefault((i, j, numbers[0]), [0.0, 0.0])
                ends[0] += numbers[1]
                ends[1] += curve.size
            else:
                self.curves.append((i, j, _KINDS[curve.kind], curve.side, curve.size, *numbers))

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
