"""Parameters by name, as linear functions of theta and of the base parameters."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.errors import DataError
from sdpid.estimation.information import UNDETERMINED
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling

# A standard parameter is determined by the data where the base parameters leave less than this
# of it open, in scaled units: rounding.
_OPEN = 1e-7


@dataclass(frozen=True, eq=False)
class ParameterFunctions:
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
        kept = [
            i
            for i, name in enumerate(names)
            if i < base.count
            or name not in base.names
            or not np.allclose(functions[i], base.matrix[base.names.index(name)])
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
        # Base parameters in units in which the rows of their matrix are of order one.
        size = np.linalg.norm(base.matrix * scale, axis=1)
        size = np.where(size > 0.0, size, 1.0)
        rows = base.matrix * scale / size[:, None]
        excitation = problem.excitation
        norms = np.where(excitation.column_norms > 0.0, excitation.column_norms * size, 1.0)
        lost = excitation.directions[excitation.singular_values < UNDETERMINED]
        goal = functions[kept] * scale
        found = np.linalg.lstsq(rows.T, goal.T, rcond=None)[0].T
        missing = np.linalg.norm(goal - found @ rows, axis=1) > _OPEN * np.linalg.norm(goal, axis=1)
        blind = np.linalg.norm(found / norms @ lost.T, axis=1)
        blind_limit = _OPEN * np.linalg.norm(found / norms, axis=1)
        return cls(
            names=tuple(names[i] for i in kept),
            kind=tuple(kind[i] for i in kept),
            units=tuple(units[i] for i in kept),
            functions=functions[kept],
            functionals=found / size,
            determined=~missing & (blind <= blind_limit),
        )

    def only(self, chosen: Mask) -> ParameterFunctions:
        """Return the functions that a mask or index selects."""
        index = np.flatnonzero(chosen)
        return ParameterFunctions(
            names=tuple(self.names[i] for i in index),
            kind=tuple(self.kind[i] for i in index),
            units=tuple(self.units[i] for i in index),
            functions=self.functions[index],
            functionals=self.functionals[index],
            determined=self.determined[index],
        )
