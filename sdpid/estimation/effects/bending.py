"""How friction moves with the speeds that the data chose, to first order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sdpid._common.arrays import Array
from sdpid.estimation.effects.choose import Profiled
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.motion import Motion
from sdpid.robot.friction.term import FrictionTerm

# Differences are taken this far to either side, relative: the shapes bend over factors of two.
_STEP = 0.02


@dataclass(frozen=True, eq=False)
class _Moved:
    """A term with all speeds of a field a little lower and higher, and its parameters' values."""

    lower: FrictionTerm
    upper: FrictionTerm
    values: Array
    joints: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Bending:
    """Derivatives of the joints' efforts by the logarithms of the speeds that the data chose.

    Attributes
    ----------
    friction : FrictionModel
        The terms.
    moved : tuple
        One entry for each field of a term.
    deviations : ndarray, shape (d,)
        What is known of each logarithm beforehand, as a standard deviation: all values within the
        limits of the search are alike.
    """

    friction: FrictionModel
    moved: tuple[_Moved, ...]
    deviations: Array

    @classmethod
    def of(cls, friction: FrictionModel, profiled: Sequence[Profiled], values: Array) -> Bending:
        """Build from closed terms, what was chosen of them, and their parameters' values."""
        names, moved, deviations = friction.joint_names, [], []
        for term, place in friction.placed:
            parameters, own = friction.parameters[place], values[place]
            chosen = [each for each in profiled if each.term == type(term).__name__]
            fields = dict.fromkeys(each.name.rstrip("0123456789") for each in chosen)
            for field in (each for each in fields if hasattr(term, each)):
                speeds = np.broadcast_to(getattr(term, field), (len(names),))
                lower, upper = (
                    replace(term, **{field: tuple((speeds * np.exp(step)).tolist())})  # type: ignore[type-var]
                    for step in (-_STEP, _STEP)
                )
                moved.append(_Moved(lower, upper, own, tuple(p.joint for p in parameters)))
                limits = {each.name: (each.lower, each.upper) for each in chosen}
                for j in range(len(names)):
                    low, high = limits.get(f"{field}{j + 1}", (1.0, 1.0))
                    deviations.append(np.log(high / low) / np.sqrt(12.0))
        return cls(friction, tuple(moved), np.array(deviations))

    def columns(self, motion: Motion) -> Array:
        """Return the derivatives, (K, n, d), of efforts at K states."""
        names, first = self.friction.joint_names, self.friction.first
        count = len(names)
        out = np.zeros((len(motion.velocity), first + count, len(self.deviations)))
        for i, each in enumerate(self.moved):
            upper, lower = (t.columns_in(motion, names) for t in (each.upper, each.lower))
            slopes = (upper - lower) * (each.values / (2.0 * _STEP))
            for k, j in enumerate(each.joints):
                out[:, first:, count * i + j] += slopes[:, :, k]
        return out
