"""Parameters by name, as linear functions of theta and of the base parameters."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import compress
from typing import Any, NamedTuple

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.errors import DataError
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling

# What bounds a parameter.
FROM_DATA, FROM_PHYSICS, FROM_PRIOR = "from data", "from physics", "from the prior"

# A parameter is determined by the data where what they show leaves less than this of it open, in
# scaled units: rounding.
_OPEN = 1e-7


class ParameterFunctions(NamedTuple):
    """Parameters as linear functions of theta and of the base parameters.

    Attributes
    ----------
    names, kind, units : tuple of str
        Kinds are ``"base"`` and ``"standard"``.
    functions : ndarray, shape (k, p)
        Of theta.
    functionals : ndarray, shape (k, b)
        Of the base parameters; meaningful where `determined`.
    determined : ndarray of bool, shape (k,)
        Whether the data bound them.
    """

    names: tuple[str, ...]
    kind: tuple[str, ...]
    units: tuple[str, ...]
    functions: Array
    functionals: Array
    determined: Mask

    @classmethod
    def of(cls, problem: Problem, parameters: Iterable[str] | None) -> ParameterFunctions:
        """Build for parameters by name, or for all.

        Raises
        ------
        DataError
            When there is no such parameter.
        """
        base = problem.base
        functions = np.vstack([base.matrix, np.eye(problem.n_theta)])
        names = (*base.names, *base.theta_names)
        kind = ("base",) * base.count + ("standard",) * problem.n_theta
        units = (*base.units, *base.theta_units)
        # A standard parameter that is a base parameter, name and all, is not listed twice.
        own = dict(zip(base.names, base.matrix, strict=True))
        kept = [
            i
            for i, name in enumerate(names)
            if i < base.count or name not in own or not np.allclose(functions[i], own[name])
        ]
        if parameters is not None:
            requested = [parameters] if isinstance(parameters, str) else list(parameters)
            unknown = [name for name in requested if name not in names]
            if unknown:
                raise DataError(
                    f"intervals: no parameter is called {', '.join(map(repr, unknown))}; there "
                    f"are {', '.join(names[i] for i in kept)}."
                )
            kept = [i for name in requested for i in kept if names[i] == name]
        scale = Scaling.of(problem).theta
        # What the data show, in units in which rows are of order one.
        shown = problem.excitation.inverse @ base.matrix * scale
        size = np.linalg.norm(shown, axis=1, keepdims=True)
        goal = functions[kept] * scale
        found = np.linalg.lstsq((shown / size).T, goal.T, rcond=None)[0]
        left = np.linalg.norm(goal - found.T @ (shown / size), axis=1)
        return cls(
            names=tuple(names[i] for i in kept),
            kind=tuple(kind[i] for i in kept),
            units=tuple(units[i] for i in kept),
            functions=functions[kept],
            functionals=(found / size).T @ problem.excitation.inverse,
            determined=left <= _OPEN * np.linalg.norm(goal, axis=1),
        )

    def only(self, chosen: Mask) -> ParameterFunctions:
        """Return the functions that a mask selects."""
        kept: list[Any] = [
            tuple(compress(each, chosen)) if isinstance(each, tuple) else each[chosen]
            for each in self
        ]
        return ParameterFunctions(*kept)

    def answered(self, chosen: Mask, requested: bool) -> ParameterFunctions:
        """Return the chosen parameters; raise where others were asked for by name.

        Raises
        ------
        DataError
            Where `requested` are others.
        """
        others = ", ".join(compress(self.names, ~chosen))
        if requested and others:
            raise DataError(
                f"intervals: the data alone do not determine {others}; use method='profile', which "
                "says what physics leaves of them."
            )
        return self.only(chosen)
