"""Rows of recordings in amperes, compressed joint by joint.

A joint's current is what its links need over its gain, and what its own drive loses:

    current_j = kappa_j · (L_j · z) + F_j · phi_j,      kappa_j = 1 / gain_j

with L the regressor of the links' base parameters (and of gravity's direction, where that is
open), and F friction, offset and rotor inertia of the drive of joint j. As phi_j is of joint j
alone it is estimated in amperes, whatever the gain is. The errors are the currents'.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid.errors import DataError
from sdpid.estimation.compression.rows import RowSource
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.friction.model import BY_NAME, FrictionModel
from sdpid.robot.friction.posed import LoadFriction, Tilt
from sdpid.robot.friction.term import FrictionTerm, JointwiseTerm
from sdpid.robot.model.base_parameters import BaseParameters, structural_base
from sdpid.robot.model.model import RobotModel


@dataclass(frozen=True, eq=False)
class GainModel:
    """What currents are explained by.

    Attributes
    ----------
    robot : RobotModel
        The arm.
    shared : FrictionModel
        Terms whose parameters are of the whole arm: gravity's direction.
    base : BaseParameters
        Of the links and the shared terms.
    own : FrictionModel
        Terms of the drives.
    acts : ndarray of bool, shape (f, n)
        On which joints each parameter of `own` acts. Where on several, each has its own value.
    separate : ndarray of bool, shape (f,)
        Which parameters of `own` every recording has of its own.
    """

    robot: RobotModel
    shared: FrictionModel
    base: BaseParameters
    own: FrictionModel
    acts: Mask
    separate: Mask

    @classmethod
    def of(
        cls,
        robot: RobotModel,
        terms: Sequence[str | FrictionTerm],
        alike: Iterable[str],
    ) -> GainModel:
        """Return the model with friction terms, those of some names alike in all recordings.

        Raises
        ------
        DataError
            For a name of no friction term.
        """
        if unknown := [name for name in alike if name not in BY_NAME]:
            raise DataError(
                f"shared: names {unknown[0]!r}, which is no friction term; there are "
                f"{', '.join(BY_NAME)}."
            )
        together = tuple(BY_NAME[name] for name in alike)
        closed = FrictionModel.from_terms(terms, robot.joint_names).terms
        names = robot.joint_names
        shared = FrictionModel.from_terms([t for t in closed if isinstance(t, Tilt)], names)
        own = FrictionModel.from_terms([t for t in closed if not isinstance(t, Tilt)], names)
        acts, apart = [], []
        for term in own.terms:
            for parameter in term.parameters(names):
                alone = isinstance(term, JointwiseTerm | LoadFriction)
                acts.append(np.arange(robot.n) == parameter.joint if alone else np.ones(robot.n))
                apart.append(not isinstance(term, together))
        count = len(own.parameters)
        return cls(
            robot,
            shared,
            structural_base(robot, shared),
            own,
            np.array(acts, dtype=bool).reshape(count, robot.n),
            np.array(apart, dtype=bool),
        )

    @cached_property
    def own_share(self) -> Array:
        """1 for base parameters of the links, (b,); 0 where a drive's parameter does the same.

        As the inertia of all links about the first axis beside a rotor's inertia there: it is then
        estimated in amperes.
        """
        terms = (*self.shared.terms, *self.own.terms)
        both = structural_base(self.robot, FrictionModel.from_terms(terms, self.robot.joint_names))
        first = 10 * self.robot.n_links + len(self.shared.parameters)
        share = np.ones(self.base.count)
        for column in both.matrix[:, first:].T:
            same = np.flatnonzero(column)
            if len(same) == 1 and both.kept[same[0]] in self.base.kept:
                share[list(self.base.kept).index(both.kept[same[0]])] = 0.0
        return share

    def links(self, samples: Samples) -> Array:
        """Return the regressor of links and shared terms, (K, n, b)."""
        rows = RowSource(self.robot, self.shared, self.base, samples)
        return rows.regressor(slice(0, samples.n_samples))

    def of_joint(self, j: int) -> Indices:
        """Return which parameters of `own` act on joint j."""
        return np.flatnonzero(self.acts[:, j])

    def own_with_load(self, bodies: Array) -> FrictionModel:
        """Return the drives' terms with friction of the load of given links (links, 10)."""
        given = tuple(tuple(map(float, body)) for body in bodies)
        terms = [
            replace(term, bodies=given) if isinstance(term, LoadFriction) else term
            for term in self.own.terms
        ]
        return FrictionModel.from_terms(terms, self.robot.joint_names)


@dataclass(frozen=True, eq=False)
class RunRows:
    """Compressed rows of one recording: of each joint the columns F, L and the current.

    Attributes
    ----------
    load : int or None
        Number of the load that it carries.
    triangles : tuple of ndarray
        Of each joint the triangular factor of its rows, friction first, the current last.
    products : tuple of ndarray
        Of each joint and each block of samples the products of those columns, (G, c, c).
    used : ndarray, shape (n,)
        Rows of each joint.
    squares : ndarray, shape (n,)
        Sum of the squared currents about their mean, A².
    """

    load: int | None
    triangles: tuple[Array, ...]
    products: tuple[Array, ...]
    used: Array
    squares: Array

    @classmethod
    def of(
        cls, model: GainModel, samples: Samples, L: Array, bodies: Array, load: int | None = None
    ) -> RunRows:
        """Compress the rows of samples whose effort is in A.

        Parameters
        ----------
        model : GainModel
            What they are explained by.
        samples : Samples
            The samples.
        L : ndarray, shape (K, n, b)
            Their regressor of the links (see `GainModel.links`).
        bodies : ndarray, shape (links, 10)
            What loads the gears.
        load : int, optional
            Number of the load that they carry.
        """
        every, mask = slice(0, samples.n_samples), samples.used
        own = RowSource(model.robot, model.own_with_load(bodies), model.base, samples)
        F = own.friction.columns_in(own.motion(every))
        triangles, products = [], []
        used, squares = np.zeros(samples.n), np.zeros(samples.n)
        for j in range(samples.n):
            columns = np.column_stack(
                [F[:, j][:, model.of_joint(j)], L[:, j], samples.effort[:, j]]
            )
            columns = np.where(mask[:, [j]], columns, 0.0)
            triangles.append(np.asarray(np.linalg.qr(columns, mode="r")))
            products.append(_block_products(columns, samples))
            current = samples.effort[mask[:, j], j]
            used[j] = len(current)
            squares[j] = float(np.sum((current - current.mean()) ** 2)) if len(current) else 0.0
        return cls(load, tuple(triangles), tuple(products), used, squares)


def _block_products(columns: Array, samples: Samples) -> Array:
    """Return the products of columns over each block of samples, no block over a break."""
    found = []
    for part in samples.parts:
        rows = columns[part]
        for start in range(0, len(rows), samples.block):
            block = rows[start : start + samples.block]
            found.append(block.T @ block)
    return np.asarray(found)
