"""The box of the parameters, made tighter by the consistency of every link."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.certificate.outward import SLACK as UP
from sdpid.assurance.log_proof.enclosure import root
from sdpid.estimation.constraints.feasible_set import FeasibleSet

# A link's first moments beside the two inertias about the other axes, its products of inertia
# beside the two inertias about their own axes and the third; in Pinocchio's order.
_MOMENTS = ((1, 6, 9), (2, 4, 9), (3, 4, 6))
_PRODUCTS = ((5, 4, 6, 9), (7, 4, 9, 6), (8, 6, 9, 4))


@dataclass(frozen=True, eq=False)
class Box:
    """Bounds of absolute values of parameters.

    Attributes
    ----------
    theta : ndarray, shape (p,)
        Of every parameter.
    bodies : ndarray, shape (links, 3)
        Of every link's m, |h| and ‖I‖, the spectral norm.
    """

    theta: Array
    bodies: Array

    @classmethod
    def around(cls, theta: Array, links: int) -> Box:
        """Return the bounds of some parameters (p,) of any bodies."""
        theta = np.abs(np.asarray(theta, dtype=np.float64))
        bodies = theta[: 10 * links].reshape(links, 10)
        squares = bodies**2
        norms = [squares[:, 1:4].sum(axis=1), squares[:, 4:] @ np.array([1, 2, 1, 2, 2, 1])]
        return cls(theta, np.stack([bodies[:, 0], *map(root, norms)], axis=1))

    @classmethod
    def of(cls, feasible: FeasibleSet) -> Box:
        """Return the bounds of all feasible parameters.

        Of a positive semidefinite matrix every 2×2 minor is. The 6×6 matrix gives ``h_x² ≤ m
        I_yy``, ``h_x² ≤ m I_zz``, ``I_xy² ≤ I_xx I_yy``, and I − S(h)S(h)^T/m ⪰ 0, so that
        ``2|h|² ≤ m tr I``. With the 4×4 matrix, whose block Σ is ``tr(I)/2·E − I``, also
        ``|I_xy| = |Σ_xy| ≤ √(Σ_xx Σ_yy) ≤ I_zz/2`` and ``‖I‖ ≤ tr(I)/2``.

        Parameters
        ----------
        feasible : FeasibleSet
            Bounds and consistency.
        """
        theta = np.maximum(np.abs(feasible.lower), np.abs(feasible.upper))
        full = feasible.consistency == "pseudo_inertia"
        box = cls.around(theta, feasible.n_links)
        if feasible.consistency == "none":
            return box
        for i in np.flatnonzero(feasible.required):
            body = box.theta[10 * i : 10 * i + 10]
            trace = (body[4] + body[6] + body[9]) * UP
            for own, first, second in _MOMENTS:
                inertia = min(body[first], body[second])
                body[own] = min(body[own], root(body[0]) * root(inertia) * UP)
            for own, first, second, third in _PRODUCTS:
                size = root(body[first]) * root(body[second]) * UP
                body[own] = min(body[own], size, body[third] / 2.0 if full else np.inf)
            box.bodies[i, 1] = min(box.bodies[i, 1], root(body[0] * trace / 2.0))
            box.bodies[i, 2] = min(box.bodies[i, 2], trace / 2.0 if full else trace)
        return box
