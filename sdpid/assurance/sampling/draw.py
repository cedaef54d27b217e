"""Draw consistent robots from what data, prior and constraints say together."""

from __future__ import annotations

import functools
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Indices, frozen, generator
from sdpid._common.tables import Shown
from sdpid._common.threads import one_thread
from sdpid.assurance.sampling.density import Density
from sdpid.assurance.sampling.mixing import effective_sizes, split_r_hat
from sdpid.assurance.sampling.walk import hit_and_run
from sdpid.errors import DataError, SolverError
from sdpid.estimation.estimate import FEASIBLE, Estimate
from sdpid.estimation.posterior import Groups

# Chains side by side: enough for NumPy's overhead to be shared.
_CHAINS = 32

# Sweeps from points about the center to the first that count.
_WARM_UP = 16

# Each chain makes at least as many draws as show how chains mix, however few are asked for.
_LEAST = 32

# The smallest effective sample size that is passed without a note, as a share of the draws, and
# the largest R-hat: of 32 chains of 32 draws that is 1.03 to 1.04 by chance alone.
_EFFECTIVE, _AGREE = 0.4, 1.05

# Where these are missed draws are twice as many sweeps apart, this often.
_DOUBLED = 5

# Chains that differ more than this have not found the same density: no draws are returned.
_DISAGREE = 1.2

# A parameter of which more than this share of the draws lies in the last tenth below its largest
# size is held by that; so many are named. Where there is no limit below, none is met.
_AT_LIMIT, _NEAR, _NAMED, _TINY = 0.02, 0.9, 4, 1e-300


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Draws(Shown):
    """Robots drawn at random, each of which obeys every constraint.

    Attributes
    ----------
    names, base_names : tuple of str
        Of the standard and of the base parameters.
    theta : ndarray, shape (count, p)
        Standard parameters.
    base : ndarray, shape (count, b)
        Their base parameters.
    chain : ndarray of int, shape (count,)
        Which chain each is from.
    effective_sizes : ndarray, shape (p,)
        Independent draws that all of them are worth, for each standard parameter.
    r_hat : ndarray, shape (p,)
        Rank-normalized split R-hat of each standard parameter: near 1 where chains agree.
    notes : tuple of str
        What to know of these draws.
    seconds : float
        It took, warm-up included.
    """

    names: tuple[str, ...]
    base_names: tuple[str, ...]
    theta: Array
    base: Array
    chain: Indices
    effective_sizes: Array
    r_hat: Array
    notes: tuple[str, ...] = ()
    seconds: float = field(default=0.0)

    _facts = ("thetas", "names", "effective_sizes.min", "r_hat.max")

    def __len__(self) -> int:
        return len(self.theta)


@one_thread
def draw(
    estimate: Estimate,
    count: int,
    *,
    seed: Any = 0,
    groups: Groups = "frequencies",
) -> Draws:
    """Draw standard parameters from their posterior under the constraints.

    Parameters
    ----------
    estimate : Estimate
        With standard parameters, whose problem has rows.
    count : int
        How many.
    seed : int or numpy.random.Generator, optional
        The same seed gives the same draws on the same machine.
    groups : {"frequencies", "blocks", "periods"}, optional
        What of the residuals is independent (see `sdpid.confidence_intervals`).

    Returns
    -------
    Draws
        In an order in which any part is as good as the whole: chains take turns.

    Raises
    ------
    DataError
        When a number makes no sense, the problem has no rows, or nothing bounds the draws.
    InfeasibleError
        When the constraints leave no room.
    SolverError
        When the chains do not agree.
    """
    begin = time.perf_counter()
    if isinstance(count, bool) or not isinstance(count, int | np.integer) or count < 1:
        raise DataError(f"draw: count is {count!r}; give a whole number from 1 on.")
    rng = generator(seed)
    density = Density.of(estimate, groups)
    each = max(_LEAST, -(-int(count) // _CHAINS))
    values, sizes, r_hat = _mixed(density, rng, each)
    names = estimate.problem.base.theta_names
    notes = _mixing_notes(names, sizes, r_hat, each * _CHAINS)
    theta = values.reshape(-1, values.shape[2])[:count]
    _require_feasible(estimate, theta)
    notes += _open_notes(estimate, density, theta)
    return Draws(
        names=names,
        base_names=estimate.problem.base.names,
        theta=frozen(theta),
        base=frozen(theta @ estimate.problem.base.matrix.T),
        chain=np.tile(np.arange(_CHAINS), each)[:count],
        effective_sizes=frozen(np.minimum(sizes * min(1.0, count / (each * _CHAINS)), count)),
        r_hat=frozen(r_hat),
        notes=tuple(notes),
        seconds=time.perf_counter() - begin,
    )


def _mixed(density: Density, rng: np.random.Generator, each: int) -> tuple[Array, Array, Array]:
    """Return draws (each, chains, p) with sizes and R-hat, sweeps enough apart to mix."""
    center = density.center()
    covariance = density.covariance_at(center)
    # Anywhere in the ellipsoid that is inside of every wall.
    start = rng.standard_normal((_CHAINS, density.n))
    size = 0.9 * rng.random(_CHAINS) ** (1.0 / density.n) / np.linalg.norm(start, axis=1)
    x = center + size[:, None] * start @ np.linalg.cholesky(covariance).T
    walked = functools.partial(hit_and_run, density, covariance=covariance, rng=rng)
    points = walked(walked(x, count=1, sweeps=_WARM_UP)[-1], count=each)
    for doubled in range(_DOUBLED + 1):
        values = density.theta(points)
        sizes, r_hat = effective_sizes(values), split_r_hat(values)
        if sizes.min() >= _EFFECTIVE * each * _CHAINS and r_hat.max() <= _AGREE:
            break
        if doubled < _DOUBLED:
            # Every second of twice as many.
            more = walked(points[-1], count=each, sweeps=2**doubled)
            points = np.concatenate([points, more])[1::2]
    return values, sizes, r_hat


def _mixing_notes(names: tuple[str, ...], sizes: Array, r_hat: Array, total: int) -> list[str]:
    """Return what the chains miss, or raise where they disagree."""
    worst, least = int(np.argmax(r_hat)), int(np.argmin(sizes))
    if r_hat[worst] > _DISAGREE:
        raise SolverError(
            f"draw: chains disagree about {names[worst]}: R-hat {r_hat[worst]:.2f}, at most "
            f"{_DISAGREE} is accepted; the constraints leave too narrow a space, or the data say "
            "next to nothing: give a prior, or narrower bounds (Constraints.of_size)."
        )
    notes = []
    if r_hat[worst] > _AGREE:
        notes.append(
            f"chains differ about {names[worst]}: R-hat {r_hat[worst]:.3f}, {_AGREE} is good; "
            "draw more"
        )
    if sizes[least] < _EFFECTIVE * total:
        notes.append(
            f"{total} draws are worth {sizes[least]:.0f} independent ones of {names[least]}, "
            f"{_EFFECTIVE * total:.0f} are good; draw more"
        )
    return notes


def _require_feasible(estimate: Estimate, theta: Array) -> None:
    """Raise when a draw violates a constraint, recomputed."""
    feasible = estimate.problem.feasible
    allowed = FEASIBLE if np.any(feasible.equations) else 0.0
    worst = max(feasible.violation(each) for each in theta)
    if worst > allowed:
        raise SolverError(
            f"draw: a draw violates a constraint by {worst:.1e} (limit {allowed:.0e}): rounding "
            "of numbers of very different size; give narrower bounds (Constraints.of_size).",
            problem=estimate.problem,
        )


def _open_notes(estimate: Estimate, density: Density, theta: Array) -> list[str]:
    """Return a note where nothing but the constraints bounds the draws."""
    if not density.unseen:
        return []
    feasible = estimate.problem.feasible
    share = np.mean(theta > _NEAR * feasible.upper, axis=0)
    share += np.mean(theta < _NEAR * np.minimum(feasible.lower, -_TINY), axis=0)
    share[feasible.lower == feasible.upper] = 0.0
    found = [k for k in np.argsort(-share)[:_NAMED] if share[k] > _AT_LIMIT]
    listed = ", ".join(f"{feasible.theta_names[k]} in {100.0 * share[k]:.0f} %" for k in found)
    near = f"; within a tenth of mass_max or theta_max are {listed} of the draws" if found else ""
    return [
        f"neither data nor prior see {density.unseen} of {density.n} directions: there draws fill "
        f"what the constraints allow, most of which is large{near}; give a prior (sdpid.Prior) "
        "if the robot's own bodies shall be among them"
    ]
