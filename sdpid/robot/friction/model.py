"""The friction model of a robot: its terms, their parameters and their columns.

The interface of a term is in `sdpid.robot.friction.term`, the terms themselves are in
`sdpid.robot.friction.terms`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, is_dataclass
from functools import cached_property

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import ModelError
from sdpid.robot.friction.term import FrictionTerm, SampledMotion, TermParameter
from sdpid.robot.friction.terms import BY_NAME


@dataclass(frozen=True)
class FrictionModel:
    """The terms of a robot's joints, in order.

    Attributes
    ----------
    terms : tuple of FrictionTerm
        The terms.
    joint_names : tuple of str
        The joints that have friction: all but a floating base.
    parameters : tuple of TermParameter
        All parameters, term by term over the joints: the tail of theta.
    first : int
        Velocity coordinates before the first of these joints (6 with a floating base).
    """

    terms: tuple[FrictionTerm, ...]
    joint_names: tuple[str, ...]
    parameters: tuple[TermParameter, ...]
    first: int = 0

    @classmethod
    def from_terms(
        cls, terms: Iterable[str | FrictionTerm], joint_names: Sequence[str], *, first: int = 0
    ) -> FrictionModel:
        """Build from names and term objects.

        Parameters
        ----------
        terms : iterable of str or FrictionTerm
            Names are those of `BY_NAME`.
        joint_names : sequence of str
            The robot's velocity coordinates.
        first : int, optional
            How many of them belong to a floating base, which has no friction.

        Raises
        ------
        ModelError
            For an unknown name, a term given twice, or a joint that the robot does not have.
        """
        if isinstance(terms, str):
            raise ModelError(f"friction: give a tuple of terms, such as ('{terms}',).")
        objects = []
        for term in terms:
            if isinstance(term, FrictionTerm):
                objects.append(term)
            elif isinstance(term, str) and term in BY_NAME:
                objects.append(BY_NAME[term]())
            else:
                raise ModelError(
                    f"friction: no term is called {term!r}; there are {', '.join(BY_NAME)}, "
                    "or give a FrictionTerm object."
                )
        names = tuple(joint_names)[first:]
        parameters = tuple(p for term in objects for p in term.parameters(names))
        seen: set[str] = set()
        for parameter in parameters:
            if parameter.name in seen:
                raise ModelError(f"friction: the parameter {parameter.name} is defined twice.")
            seen.add(parameter.name)
        return cls(tuple(objects), names, parameters, first)

    def columns(self, velocity: Array, acceleration: Array) -> Array:
        """Return all columns at an instant, shape (K, n, number of parameters).

        Those of terms that depend on the position too are zero: `columns_in` has them.
        """
        v, a = velocity[:, self.first :], acceleration[:, self.first :]
        names = self.joint_names
        return self._side_by_side(
            len(v),
            (
                np.zeros((*v.shape, len(term.parameters(names))))
                if term.posed
                else term.columns(v, a, names)
                for term in self.terms
            ),
        )

    def columns_in(self, motion: SampledMotion) -> Array:
        """Return all columns as they stand in filtered efforts, (K, n, number of parameters)."""
        return self._side_by_side(
            len(motion.velocity),
            (term.columns_in(motion, self.joint_names) for term in self.terms),
        )

    def enclosed(
        self, velocity: tuple[Array, Array], acceleration: tuple[Array, Array]
    ) -> tuple[Array, Array]:
        """Return bounds of all columns, below and above, over ranges of motion (K, n) each.

        Those of terms that depend on the position too are zero.
        """
        v, a = ([each[:, self.first :] for each in pair] for pair in (velocity, acceleration))
        names = self.joint_names
        blocks = [
            (np.zeros((*v[0].shape, len(term.parameters(names)))),) * 2
            if term.posed
            else term.enclosed((v[0], v[1]), (a[0], a[1]), names)
            for term in self.terms
        ]
        low, high = (
            self._side_by_side(len(v[0]), [pair[side] for pair in blocks]) for side in (0, 1)
        )
        return low, high

    def _side_by_side(self, count: int, blocks: Iterable[Array]) -> Array:
        """Return the terms' columns in one array, zero for a floating base."""
        n = self.first + len(self.joint_names)
        columns = np.zeros((count, n, len(self.parameters)))
        start = 0
        for block in blocks:
            columns[:, self.first :, start : start + block.shape[2]] = block
            start += block.shape[2]
        return columns

    @property
    def alike(self) -> tuple[tuple[int, int], ...]:
        """Pairs of parameters, by index, that are believed to be alike."""
        return tuple(
            (own.start + i, own.start + j)
            for term, own in self.placed
            for i, j in term.alike(self.joint_names)
        )

    @cached_property
    def placed(self) -> tuple[tuple[FrictionTerm, slice], ...]:
        """Each term, and where its parameters are among all."""
        ends = np.cumsum([0, *(len(term.parameters(self.joint_names)) for term in self.terms)])
        return tuple(zip(self.terms, map(slice, ends[:-1], ends[1:]), strict=True))

    def characteristic_speeds(self) -> Array:
        """Return speeds (k, joints) at which the columns of each joint bend, such as widths."""
        n = len(self.joint_names)
        return np.concatenate([np.zeros((0, n)), *(t.characteristic_speeds(n) for t in self.terms)])

    def described(self) -> list[dict[str, object]]:
        """Return each term's kind, its settings, and its parameters' names, as plain values."""
        out: list[dict[str, object]] = []
        for term in self.terms:
            settings: dict[str, object] = asdict(term) if is_dataclass(term) else {}
            plain = {k: list(v) if isinstance(v, tuple) else v for k, v in settings.items()}
            names = [p.name for p in term.parameters(self.joint_names)]
            out.append({"term": type(term).__name__, **plain, "parameters": names})
        return out
