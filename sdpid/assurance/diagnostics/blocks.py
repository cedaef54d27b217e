"""Hold out blocks of one recording in turn, with every choice that was made on the whole kept.

The samples, the friction terms, the weights and the prior stay as they are; the parameters of each
fit come from the rows outside one block. As the cost is a sum over rows, the rows are compressed
once, and each fit takes one solve of the small problem.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid._common.kept import kept
from sdpid._common.threads import one_thread
from sdpid.errors import SdpidError
from sdpid.estimation.compression.covariance import PRINTED, pooled
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.triangle import Triangle
from sdpid.estimation.compression.whitening import compress, with_contact_forces
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.information import require_excitation
from sdpid.estimation.problem import Problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.experiment.processing.samples import Samples

# Blocks of a recording: a fifth is long enough to be a motion, and what is left holds most of it;
# of short recordings fewer, but with less than two thirds of it no fit is like that of the whole.
BLOCKS, FEWEST = 5, 3

# Rows up to which blocks are held out without being asked for: a few seconds of work.
MOST_ROWS = 3_000_000

# The share of `Samples.block` left out of training on both sides of a block. A block is 20 of the
# filter's time constants or more; after 5 the filter has forgotten all but a hundredth.
_GUARD = 0.25

# A block holds at least this many guards, or more is left out beside it than is predicted.
_LEAST_GUARDS = 2


def own(estimate: Estimate) -> Array:
    """Return the base parameters of a block's estimate itself."""
    return estimate.base


@dataclass(frozen=True, kw_only=True, eq=False)
class Block:
    """A stretch of the samples, and a fit that saw neither it nor what the filter mixed with it.

    Attributes
    ----------
    slices : tuple of slice
        The stretch, one slice for each recording.
    estimate : Estimate
        The fit to the other rows; its problem has no rows.
    """

    slices: tuple[slice, ...]
    estimate: Estimate


# A verdict and bands of efforts ask for the same.
@kept
@one_thread
def held_out_blocks(problem: Problem) -> tuple[Block, ...]:
    """Fit the problem without each block in turn.

    Parameters
    ----------
    problem : Problem
        With its rows. Every recording is cut into `BLOCKS`, or fewer, down to `FEWEST`, where all
        are too short for so many.

    Returns
    -------
    tuple of Block
        Empty where blocks cannot be held out: the rows are on a cluster or more than `MOST_ROWS`,
        the weighting's cost is no sum over rows, the record is too short, or the rest of it leaves
        base parameters undetermined.
    """
    rows = problem.rows
    if rows is None or rows.elsewhere is not None or problem.weighting in PRINTED:
        return ()
    guard = math.ceil(_GUARD * rows.samples.block)
    longest = max(p.stop - p.start for p in rows.samples.parts)
    count = min(BLOCKS, longest // (_LEAST_GUARDS * guard))
    if count < FEWEST or problem.n_rows > MOST_ROWS:
        return ()
    parts = [p for p in rows.samples.parts if p.stop - p.start >= count * _LEAST_GUARDS * guard]
    pieces = [_compressed(rows, problem.sigma, part, count, guard) for part in parts]
    short = [compress(rows, problem.sigma, p)[0] for p in rows.samples.parts if p not in parts]
    found = []
    for k in range(count):
        triangle = Triangle(problem.base.count + 1)
        for other in (*short, *(t for piece in pieces for t in piece.without(k))):
            triangle.merge(other)
        A, rhs, floor = triangle.split()
        reduced = replace(problem, A=A, rhs=rhs, floor=floor, rows=None)
        try:
            if problem.prior is None:
                require_excitation(reduced.excitation)
            estimate = solve_sdp(reduced)
        except SdpidError:
            return ()
        found.append(Block(slices=tuple(p.slices[k] for p in pieces), estimate=estimate))
    return tuple(found)


@one_thread
def predicted_by(
    blocks: Sequence[Block],
    problem: Problem,
    ways: Mapping[str, Callable[[Estimate], Array]],
    samples: Samples | None = None,
) -> dict[str, Array]:
    """Return the efforts (K, n) of samples, each predicted by a fit without it.

    Parameters
    ----------
    blocks : sequence of Block
        Of the problem. Samples in no block, of a recording too short to be cut, are predicted by
        the first fit.
    problem : Problem
        With its rows.
    ways : mapping of str to callable
        By name, functions that return the base parameters to predict with, of a block's estimate.
    samples : Samples, optional
        By default the problem's own.
    """
    own_samples = problem.require_rows_here("blocks").samples if samples is None else samples
    rows = problem.rows_of(own_samples)
    sigma = problem.sigma if samples is None else pooled(problem.sigma)
    values = {
        name: np.stack([way(block.estimate) for block in blocks], axis=1)
        for name, way in ways.items()
    }
    owner = np.maximum(_owners(blocks, rows.n_samples), 0)
    found = {name: np.empty(rows.samples.effort.shape) for name in ways}
    for part, W, _, _ in rows.chunks():
        for name, each in values.items():
            effort = np.take_along_axis(W @ each, owner[part][:, None, None], axis=2)
            found[name][part] = with_contact_forces(rows, part, sigma, effort[:, :, 0])
    return found


def in_blocks(blocks: Sequence[Block], count: int) -> Mask:
    """Return which of `count` samples are in a block."""
    return _owners(blocks, count) >= 0


def _owners(blocks: Sequence[Block], count: int) -> Indices:
    """Return the number of the block that each sample is in, -1 for none."""
    owner = np.full(count, -1, dtype=np.intp)
    for k, block in enumerate(blocks):
        for stretch in block.slices:
            owner[stretch] = k
    return owner


@dataclass(frozen=True)
class _Cut:
    """One recording cut into blocks; of each the triangles of its head, core and tail."""

    slices: tuple[slice, ...]
    triangles: tuple[tuple[Triangle, Triangle, Triangle], ...]

    def without(self, k: int) -> Iterator[Triangle]:
        """Yield the triangles of all rows but block k and the guards beside it."""
        for i, (head, core, tail) in enumerate(self.triangles):
            if i == k:
                continue
            if i != k + 1:
                yield head
            yield core
            if i != k - 1:
                yield tail


def _compressed(rows: RowSource, sigma: Array, part: slice, count: int, guard: int) -> _Cut:
    """Cut a recording into blocks and compress their rows."""
    edges = np.linspace(part.start, part.stop, count + 1).round().astype(int).tolist()
    slices = tuple(slice(a, b) for a, b in pairwise(edges))
    found = []
    for each in slices:
        ends = each.start, each.start + guard, each.stop - guard, each.stop
        head, core, tail = (compress(rows, sigma, slice(*pair))[0] for pair in pairwise(ends))
        found.append((head, core, tail))
    return _Cut(slices, tuple(found))
