"""Problems with some of many terms, from rows that are compressed once with the columns of all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sdpid._common.arrays import Array, Indices, frozen
from sdpid.estimation.compression.factor import Factor
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.triangle import Triangle
from sdpid.estimation.constraints.condition import Layout
from sdpid.estimation.constraints.feasible_set import FeasibleSet
from sdpid.estimation.prior.cost_terms import SquaredTerm
from sdpid.estimation.prior.prior import Prior, prior_terms
from sdpid.estimation.problem import Problem
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.model.base_parameters import BaseParameters

# Samples looked at, evenly spread: filtered signals need no more.
_MOST_SAMPLES = 2048


@dataclass(frozen=True, eq=False)
class Trials:
    """The rows of a problem with the columns of further terms, ready to leave some out.

    Weights are one variance a joint, from the residuals of the largest model.

    Attributes
    ----------
    problem : Problem
        Whose robot, samples and constraints these are.
    rows : RowSource
        Rows of the largest model.
    triangle : ndarray, shape (b + 1, b + 1)
        Its weighted rows, compressed, efforts last.
    independent : float
        Number of rows that are worth independent ones, less the number of parameters.
    prior : SquaredTerm or None
        The prior on theta of the largest model.
    """

    problem: Problem
    rows: RowSource
    triangle: Array
    independent: float
    prior: SquaredTerm | None

    @classmethod
    def of(cls, problem: Problem, terms: Sequence[FrictionTerm], prior: Prior | None) -> Trials:
        """Compress the rows with the columns of these terms, the problem's among them."""
        friction = FrictionModel.from_terms(
            terms, problem.robot.joint_names, first=problem.robot.n_base
        )
        samples = problem.require_rows_here("choice of effects").samples.judged
        samples = samples.thinned(_MOST_SAMPLES)
        rows = RowSource(problem.robot, friction, problem.base, samples).with_every_column()
        found = Factor.of(rows, "residual")
        rows = rows.with_force_scale(found.force_scale)
        triangle = np.zeros((rows.base.count + 1, rows.base.count + 1))
        triangle[:-1] = np.column_stack([found.A, found.rhs])
        triangle[-1, -1] = np.sqrt(found.floor)
        belief = None
        if prior is not None:
            assert problem.prior is not None
            prior = replace(prior, kind="pullback", strength=problem.prior.strength)
            (term,) = prior_terms(prior, rows).terms
            assert isinstance(term, SquaredTerm)
            belief = term
        independent = found.used / found.time - np.linalg.matrix_rank(found.A)
        return cls(problem, rows, triangle, float(independent), belief)

    def with_terms(self, terms: Sequence[FrictionTerm]) -> Problem:
        """Return the problem with some of the terms."""
        robot, full = self.problem.robot, self.rows.base
        friction = FrictionModel.from_terms(terms, robot.joint_names, first=robot.n_base)
        layout = Layout(robot, friction)
        place = {name: i for i, name in enumerate(full.theta_names)}
        theta = np.array([place[name] for name in layout.names], dtype=np.intp)
        kept = np.flatnonzero(np.isin(full.kept, theta))
        base = _part(full, kept, theta)
        triangle = Triangle(len(kept) + 1)
        triangle.add(self.triangle[:, [*kept.tolist(), full.count]])
        A, rhs, floor = triangle.split()
        prior = self.problem.prior
        if prior is not None and self.prior is not None:
            term = SquaredTerm(frozen(self.prior.matrix[:, theta]), self.prior.rhs)
            prior = replace(prior, terms=(term,))
        return replace(
            self.problem,
            friction=friction,
            base=base,
            A=frozen(A),
            rhs=frozen(rhs),
            floor=floor,
            feasible=FeasibleSet.build(self.problem.constraints, self.problem.consistency, layout),
            prior=prior if self.prior is not None else None,
            rows=None,
        ).with_origin(weighting="residual")


def _part(base: BaseParameters, kept: Indices, theta: Indices) -> BaseParameters:
    """Return some base parameters of some standard ones."""
    place = {int(column): i for i, column in enumerate(theta)}
    return replace(
        base,
        names=tuple(base.names[i] for i in kept),
        units=tuple(base.units[i] for i in kept),
        matrix=frozen(base.matrix[np.ix_(kept, theta)]),
        kept=np.array([place[int(base.kept[i])] for i in kept], dtype=np.intp),
        theta_names=tuple(base.theta_names[i] for i in theta),
        theta_units=tuple(base.theta_units[i] for i in theta),
    )
