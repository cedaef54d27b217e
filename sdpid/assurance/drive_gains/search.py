"""Search for gains: weights, friction of the load, and many starts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.assurance.drive_gains.checks import require_one_arm, require_shown
from sdpid.assurance.drive_gains.consistent import ConsistentFit
from sdpid.assurance.drive_gains.fit import Found, GainFit
from sdpid.assurance.drive_gains.load import Load
from sdpid.assurance.drive_gains.rows import GainModel, RunRows
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.prior.cost_terms import SquaredTerm
from sdpid.estimation.prior.prior import Prior, prior_terms
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.friction.posed import LoadFriction

# Rounds in which weights and friction of the load follow the fit: after four the gains of a UR10e
# move by less than 0.1 %.
ROUNDS = 4
# The spread of the logarithms of random starts.
_SPREAD = 0.7
# Costs of one minimum, relative.
_SAME = 1e-6
# By how much a mass is moved to see how gains follow it, relative.
_NUDGE = 1e-3


@dataclass(frozen=True, eq=False)
class Search:
    """Where the search among all links ended.

    Attributes
    ----------
    fit : GainFit
        With the last weights.
    found : Found
        Its least cost.
    starts, agreed : int
        How many starts there were, and how many ended there.
    """

    fit: GainFit
    found: Found
    starts: int
    agreed: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Task:
    """What gains are searched for with.

    Attributes
    ----------
    model : GainModel
        What currents are explained by.
    samples : tuple of Samples
        Of all recordings, efforts in A.
    carries : tuple of int or None
        Number of the load of each.
    loads : tuple of Load
        What is known of the loads.
    link : int
        The link that carries them.
    placed : ndarray, shape (10, 10)
        From the frame of the load to the joint frame.
    free : ndarray of bool, shape (n,)
        Which gains are not known.
    description_error : float or None
        What error the described links are granted.
    """

    model: GainModel
    samples: tuple[Samples, ...]
    carries: tuple[int | None, ...]
    loads: tuple[Load, ...]
    link: int
    placed: Array
    free: Mask
    description_error: float | None

    def run(self, start: Array, starts: int, rounds: int = ROUNDS) -> Search:
        """Search from log kappa and from random ones about it.

        Parameters
        ----------
        start : ndarray, shape (n,)
            Log kappa.
        starts : int
            How many random ones.
        rounds : int, optional
            How often weights and friction of the load follow the fit.

        Raises
        ------
        IdentifiabilityError
            When the recordings do not show a gain.
        DataError
            When they are not of one arm.
        """
        fit = self._fit(self._rows([self.model.robot.prior] * len(self.samples)))
        anchored = bool(self.loads) or not self.free.all() or self.description_error is not None
        require_shown(fit, start, self.free, anchored=anchored)
        found = fit.search(start, self.free)
        follows = any(isinstance(term, LoadFriction) for term in self.model.own.terms)
        for _ in range(rounds):
            rows = self._rows(self._bodies(fit, found)) if follows else fit.runs
            fit = self._fit(rows, fit.errors(found))
            found = fit.search(found.log_kappa, self.free)
        require_one_arm(fit, found)
        rng = np.random.default_rng(0)
        others = []
        for _ in range(starts):
            other = start + self.free * rng.normal(0.0, _SPREAD, len(start))
            others.append(fit.search(other, self.free))
        best = min([found, *others], key=lambda each: each.cost)
        agreed = sum(each.cost <= best.cost * (1.0 + _SAME) for each in others)
        first = found.cost <= best.cost * (1.0 + _SAME)
        return Search(fit, found if first else best, starts + 1, agreed + int(first))

    def constrained(self, search: Search) -> Found:
        """Return the gains among links and loads that can exist."""
        return ConsistentFit(search.fit).solve(search.found.log_kappa, search.found.z, self.free)

    def from_masses(self, search: Search) -> Array:
        """Return the covariance of log gains that errors of the loads' masses make, (n, n)."""
        n = len(self.free)
        covariance = np.zeros((n, n))
        for load in {id(each): each for each in self.loads}.values():
            if not load.mass_error > 0.0:
                continue
            ends = []
            for sign in (-1.0, 1.0):
                moved = replace(load, mass=load.mass * (1.0 + sign * _NUDGE), mass_error=0.0)
                loads = tuple(moved if each is load else each for each in self.loads)
                fit = replace(self, loads=loads)._fit(search.fit.runs, search.fit.sigma**2)
                ends.append(fit.search(search.found.log_kappa, self.free).log_kappa)
            slope = (ends[0] - ends[1]) / (2.0 * _NUDGE)
            covariance += (load.mass_error / load.mass) ** 2 * np.outer(slope, slope)
        return covariance

    @cached_property
    def _regressors(self) -> tuple[Array, ...]:
        return tuple(self.model.links(samples) for samples in self.samples)

    def _rows(self, bodies: list[Array]) -> tuple[RunRows, ...]:
        return tuple(
            RunRows.of(self.model, samples, L, own, load)
            for samples, L, own, load in zip(
                self.samples, self._regressors, bodies, self.carries, strict=True
            )
        )

    def _fit(self, rows: tuple[RunRows, ...], errors: Array | None = None) -> GainFit:
        columns = self.model.base.matrix[:, 10 * self.link :][:, :10] @ self.placed
        return GainFit(self.model, rows, self.loads, columns, self._knowledge, errors)

    @property
    def _knowledge(self) -> tuple[Array, Array] | None:
        """Rows of the described links, with errors of variance one."""
        if self.description_error is None:
            return None
        model = self.model
        rows = RowSource(model.robot, model.shared, model.base, self.samples[0])
        (term,) = prior_terms(Prior(), rows).terms
        assert isinstance(term, SquaredTerm)
        links = 10 * model.robot.n_links
        spread = self.description_error * np.linalg.inv(term.matrix[:links, :links])
        B = model.base.matrix[:, :links]
        shown = np.flatnonzero(model.own_share * np.any(B != 0.0, axis=1))
        root = B[shown] @ spread
        whitened = np.linalg.inv(np.linalg.cholesky(root @ root.T))
        widths = sum(10 - load.first_unknown for load in self.loads)
        matrix = np.zeros((len(shown), model.base.count + widths))
        matrix[:, shown] = whitened
        return matrix, whitened @ B[shown] @ model.robot.prior.ravel()

    def _bodies(self, fit: GainFit, found: Found) -> list[Array]:
        """Return links (links, 10) that can exist of each run, by what the fit found."""
        held = np.zeros(len(self.free), dtype=bool)
        near = ConsistentFit(fit).solve(found.log_kappa, found.z, held)
        assert near.theta is not None
        links = near.theta[: 10 * self.model.robot.n_links].reshape(-1, 10)
        loads, bodies = fit.load_parameters(near.z), []
        for load in self.carries:
            own = links.copy()
            if load is not None:
                own[self.link] += self.placed @ loads[load]
            bodies.append(own)
        return bodies
