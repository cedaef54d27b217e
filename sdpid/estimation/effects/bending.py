"""How friction moves with the speeds that the data chose, to first order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sdpid._common.arrays import Array
from sdpid.estimation.effects.choose import Profiled
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.term import FrictionTerm, SampledMotion

# Differences are taken this far to either side, relative: the shapes bend over factors of two.
_STEP = 0.02


@dataclass(frozen=True, eq=False)
class Bending:
    """Derivatives of the joints' efforts by the logarithms of the speeds that the data chose.

    Attributes
    ----------
    friction : FrictionModel
        The terms.
    moved : tuple of (FrictionTerm, FrictionTerm, ndarray, tuple of int)
        For each field of a term: the term with all speeds of that field a little lower and a little
        higher, its parameters' values, and their joints.
    deviations : ndarray, shape (d,)
        What is known of each logarithm beforehand, as a standard deviation: all values within the
        limits of the search are alike.
    """

    friction: FrictionModel
    moved: tuple[tuple[FrictionTerm, FrictionTerm, Array, tuple[int, ...]], ...]
    deviations: Array

    @classmethod
    def of(cls, friction: FrictionModel, profiled: Sequence[Profiled], values: Array) -> Bending:
        """Build from closed terms, what was chosen of them, and their parameters' values."""
        count, moved, deviations = len(friction.joint_names), [], []
        for term, place in friction.placed:
            joints = tuple(each.joint for each in friction.parameters[place])
            chosen = [each for each in profiled if each.term == type(term).__name__]
            limits = {each.name: np.log(each.upper / each.lower) for each in chosen}
            for field in dict.fromkeys(each.name.rstrip("0123456789") for each in chosen):
                if not hasattr(term, field):
                    continue
                speeds = np.broadcast_to(getattr(term, field), (count,))
                lower, upper = (
                    replace(term, **{field: tuple((speeds * np.exp(step)).tolist())})  # type: ignore[type-var]
                    for step in (-_STEP, _STEP)
                )
                moved.append((lower, upper, values[place], joints))
                deviations += [limits.get(f"{field}{j + 1}", 0.0) for j in range(count)]
        return cls(friction, tuple(moved), np.array(deviations) / np.sqrt(12.0))

    def columns(self, motion: SampledMotion) -> Array:
        """Return the derivatives, (K, n, d), of efforts at K states."""
        names, first = self.friction.joint_names, self.friction.first
        count = len(names)
        out = np.zeros((len(motion.velocity), first + count, len(self.deviations)))
        for i, (*ends, values, joints) in enumerate(self.moved):
            lower, upper = (each.columns_in(motion, names) for each in ends)
            slopes = (upper - lower) * (values / (2.0 * _STEP))
            for k, j in enumerate(joints):
                out[:, first:, count * i + j] += slopes[:, :, k]
        return out
