"""The descent of variable projection, one open parameter at a time.

What of a column lies in the span of the columns of fixed shape makes no difference to the cost.
That span is found once; then the cost of a value needs the products of the columns that it moves
with all others, and a fit in the few open columns. All values of a grid are tried at once.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.triangle import Triangle
from sdpid.estimation.compression.whitening import weights
from sdpid.estimation.effects.nonnegative_least_squares import least_squares_gain
from sdpid.estimation.effects.open_terms import MovedColumns, OpenTerm
from sdpid.robot.friction.term import OpenParameter

# Values tried between the limits, evenly spaced by their logarithm: with limits a factor of 500
# apart each is twice the one before, and a profile bends no faster than the shape does.
_GRID = 9

# Then the best one's neighbourhood is searched to 2 %, with at most so many tries.
_ACCURACY = 0.02
_TRIES = 8

# Rounds over all open parameters; they stop when one brings less than this share of the cost.
_ROUNDS = 8
_SETTLED = 1e-3

# Values whose cost exceeds the least by less than this share are as good: the range reported.
FLAT = 0.01

# Where all values tried agree to this share of the cost, none is better: the middle is kept.
_NO_EFFECT = 1e-6

# Directions of the columns of fixed shape that are this small beside the largest are none.
# Coordinates along the others are rounded to 1e-16 over this.
_DEPENDENT = 1e-8

# Added to the unit diagonal of the columns' products, so that a column that others span takes
# part in nothing, and the products stay positive definite when rounded.
_RIDGE = 1e-9

# The first rows folded are spread over the record, this many times as many as columns, so that
# those after them bring little new.
_FIRST = 4


class _Tried(NamedTuple):
    """The open columns at g values of a parameter, and what the cost needs of them.

    Attributes
    ----------
    places : slice or ndarray of int, shape (m,)
        The open columns that move.
    joints : ndarray of int, shape (w,)
        The joints at which these are not zero.
    columns : ndarray, shape (w, K, g, m)
        They themselves there, whitened, of unit length.
    inside : ndarray, shape (rank, g, m)
        Their coordinates in the span of the columns of fixed shape.
    products : ndarray, shape (g, c + 1, c + 1)
        Inner products of what of all open columns and the effort is outside that span.
    """

    places: Indices | slice
    joints: Indices
    columns: Array
    inside: Array
    products: Array


class ProfileSearch:
    """The least cost as a function of the open parameters, and its descent.

    Whitened columns are kept joint by joint, (n, K, columns): with independent joints a column
    is zero at all joints but those that its term acts on. The f columns of fixed shape come
    first, then the c open ones, then the effort.

    Parameters
    ----------
    rows : RowSource
        Rows with the open parameters in the middle of their limits.
    sigma : ndarray, shape (n, n) or (K, n, n)
        Covariance of the effort.
    opened : sequence of OpenTerm
        The terms to close: their values are changed by `run`.
    """

    def __init__(self, rows: RowSource, sigma: Array, opened: Sequence[OpenTerm]) -> None:
        self.opened = opened
        self.friction = friction = rows.friction
        s = rows.samples
        self.velocity = s.velocity[:, friction.first :]
        self.acceleration = s.acceleration[:, friction.first :]
        powers, which = weights(sigma, rows.mask(slice(None)))
        scale = np.diagonal(powers, axis1=1, axis2=2)
        self.independent = np.array_equal(powers, scale[:, :, None] * np.eye(rows.robot.n))
        self.weight = np.ascontiguousarray(scale[which].T) if self.independent else powers[which]
        count = [len(t.parameters(friction.joint_names)) for t in friction.terms]
        ends = np.cumsum([0, *count])
        places = [np.arange(ends[each.place], ends[each.place + 1]) for each in opened]
        loose = np.concatenate(places)
        columns = friction.columns(s.velocity, s.acceleration)
        # Friction comes last in the scan for base parameters: it does not change which of the
        # inertial columns are kept.
        inertial = rows.base.kept < 10 * rows.robot.n_links
        regressor = rows.regressor(slice(None))[:, :, inertial]
        fixed = np.delete(columns, loose, axis=2)
        self.fixed = regressor.shape[2] + fixed.shape[2]
        whole = [regressor, fixed, columns[:, :, loose], s.effort[:, :, None]]
        self.stacked = self._whiten(whole)
        # Open columns have unit length, so that rounding and dependence are judged alike.
        self.moving = self.stacked[:, :, self.fixed :]
        squares = np.einsum("jkc,jkc->c", self.moving, self.moving)
        self.moving[:, :, :-1] *= _inverse_root(squares[:-1])
        self.span, self.inside, moving = _parted(self.stacked, self.fixed)
        self.products: Array = moving.T @ moving - self.inside.T @ self.inside
        self.ridge = _RIDGE * np.eye(len(loose))
        self.products[:-1, :-1] += self.ridge
        nonnegative = np.array([p.nonnegative for p in friction.parameters], dtype=bool)
        self.free = ~nonnegative[loose]
        starts = np.cumsum([0, *(len(place) for place in places)])
        self.spans = [slice(a, b) for a, b in itertools.pairwise(starts)]
        # Open columns that take part in the best fit: a guess for the next one.
        self.used: Mask = np.ones(len(loose), dtype=bool)
        costs, used = self._least(self.products[None])
        self.cost, self.used = float(costs[0]), used[0]

    def run(self) -> None:
        """Search every open parameter in turn until the cost has settled."""
        for _ in range(_ROUNDS):
            before = self.cost
            for each, span in zip(self.opened, self.spans, strict=True):
                for i in range(len(each.parameters)):
                    self._search(each, span, i)
            if self.cost >= (1.0 - _SETTLED) * before:
                break

    def _search(self, each: OpenTerm, span: slice, i: int) -> None:
        """Put the best value of one parameter in its place."""
        parameter = each.parameters[i]
        names = self.friction.joint_names
        columns = MovedColumns(each, i, self.velocity, self.acceleration, names)
        index = _as_slice(np.arange(span.start, span.stop, dtype=np.intp)[columns.moved])
        low, high = np.log(parameter.lower), np.log(parameter.upper)
        grid = np.linspace(low, high, _GRID) if high > low else np.array([low])
        found = self._try(columns, index, np.exp(grid))
        costs, used = self._least(found.products)
        tried: dict[float, float] = dict(zip(grid.tolist(), costs.tolist(), strict=True))
        single: dict[float, _Tried] = {}
        best = int(np.argmin(costs))
        self.used = used[best]

        def cost(log: float) -> float:
            one = single[log] = self._try(columns, index, np.exp(np.array([log])))
            tried[log] = float(self._least(one.products)[0][0])
            return tried[log]

        chosen = float(grid[best])
        if costs.max() - costs.min() <= _NO_EFFECT * costs.min():
            chosen = 0.5 * float(low + high)
        elif len(grid) > 1:
            _refine(cost, grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)])
            chosen = min(tried, key=lambda x: (tried[x], x))
        value = float(np.clip(np.exp(chosen), parameter.lower, parameter.upper))
        self._put(single.get(chosen) or self._try(columns, index, np.array([value])))
        each.values[i] = value
        each.flat[i] = _flat_range(tried, parameter)

    def _try(self, moved: MovedColumns, index: Indices | slice, values: Array) -> _Tried:
        """Return what the cost needs of the open columns at values of a parameter."""
        joints, columns = self._whiten_at(*moved.at(values))
        own = np.einsum("wkga,wkgb->gab", columns, columns)
        scale = _inverse_root(own.diagonal(axis1=1, axis2=2))
        columns *= scale
        own *= scale[:, :, None]
        own *= scale[:, None, :]
        w, count, g, m = columns.shape
        with_all = np.zeros((self.stacked.shape[2], g * m))
        for joint, each in zip(joints, columns.reshape(w, count, g * m), strict=True):
            with_all += self.stacked[joint].T @ each
        inside = self.span.T @ with_all[: self.fixed]
        border = with_all[self.fixed :] - self.inside.T @ inside
        inside = inside.reshape(len(inside), g, m)
        border = border.reshape(len(border), g, m).transpose(1, 0, 2)
        own += self.ridge[:m, :m]
        border[:, index] = own - np.einsum("rga,rgb->gab", inside, inside)
        products = self.products[None].repeat(g, axis=0)
        products[:, :, index] = border
        products[:, index] = border.transpose(0, 2, 1)
        return _Tried(index, joints, columns, inside, products)

    def _put(self, tried: _Tried) -> None:
        """Make columns at a single value the present ones."""
        self.moving[:, :, tried.places] = 0.0
        for joint, columns in zip(tried.joints, tried.columns, strict=True):
            self.moving[joint][:, tried.places] = columns[:, 0]
        self.inside[:, tried.places] = tried.inside[:, 0]
        self.products = tried.products[0]
        costs, used = self._least(tried.products)
        self.cost, self.used = float(costs[0]), used[0]

    def _whiten(self, pieces: Sequence[Array]) -> Array:
        """Return whitened columns (n, K, c) of all joints, from pieces (K, n, c') of them."""
        count, n = pieces[0].shape[:2]
        out = np.empty((n, count, sum(each.shape[2] for each in pieces)))
        np.concatenate([np.swapaxes(each, 0, 1) for each in pieces], axis=2, out=out)
        if self.independent:
            out *= self.weight[:, :, None]
            return out
        return np.ascontiguousarray(np.swapaxes(self.weight @ np.swapaxes(out, 0, 1), 0, 1))

    def _whiten_at(self, joints: Indices, columns: Array) -> tuple[Indices, Array]:
        """Return the joints at which columns (w, K, g, m) are not zero if whitened, and these."""
        joints = self.friction.first + joints
        if self.independent:
            return joints, columns * self.weight[joints][:, :, None, None]
        w, count, g, m = columns.shape
        flat = np.swapaxes(columns.reshape(w, count, g * m), 0, 1)
        whitened = np.swapaxes(self.weight[:, :, joints] @ flat, 0, 1)
        return np.arange(len(whitened)), whitened.reshape(len(whitened), count, g, m)

    def _least(self, products: Array) -> tuple[Array, Mask]:
        """Return least costs (g,) over all linear parameters, signs of the open terms obeyed.

        And which open columns take part, (g, c).
        """
        H, b = products[:, :-1, :-1], products[:, :-1, -1]
        gain, used = least_squares_gain(H, b, self.free, self.used)
        return np.maximum(products[:, -1, -1] - gain, 0.0), used


def _inverse_root(squares: Array) -> Array:
    """Return what makes columns with these squared lengths unit ones, 1 for zeros."""
    return np.asarray(1.0 / np.sqrt(np.where(squares > 0.0, squares, 1.0)))


def _as_slice(index: Indices) -> Indices | slice:
    """Return neighbouring places as a slice, which is read and written faster."""
    if len(index) and np.array_equal(index, np.arange(index[0], index[0] + len(index))):
        return slice(int(index[0]), int(index[0]) + len(index))
    return index


def _parted(stacked: Array, fixed: int) -> tuple[Array, Array, Array]:
    """Part columns by the span of the first ones.

    Parameters
    ----------
    stacked : ndarray, shape (n, K, c)
    fixed : int
        How many columns have that span.

    Returns
    -------
    ndarray, shape (fixed, rank)
        T such that the first columns times T are an orthonormal basis of the span.
    ndarray, shape (rank, c - fixed)
        Coordinates of the other columns in that basis.
    ndarray, shape (c, c - fixed)
        Columns with the same inner products with each other as these.
    """
    n, count, width = stacked.shape
    step = max(1, count * n // (_FIRST * width))
    first = stacked[:, ::step].copy()
    triangle = Triangle(width)
    triangle.add(first.reshape(-1, width))
    # Their order makes no difference but to the speed.
    stacked[:, ::step] = 0.0
    triangle.add(stacked.reshape(-1, width))
    stacked[:, ::step] = first
    R = np.zeros((width, width))
    R[: len(triangle.R)] = triangle.R
    own, others = R[:fixed, :fixed], R[:, fixed:]
    size = np.linalg.norm(own, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    U, s, Vt = np.linalg.svd(own / size)
    rank = np.count_nonzero(s > _DEPENDENT * s.max(initial=0.0))
    return (Vt[:rank].T / s[:rank]) / size[:, None], U[:, :rank].T @ others[:fixed], others


def _refine(cost: Callable[[float], float], low: float, high: float) -> None:
    """Try values between two logarithms, closing in on the least cost."""
    from scipy.optimize import minimize_scalar

    options = {"xatol": _ACCURACY, "maxiter": _TRIES}
    minimize_scalar(cost, bounds=(low, high), method="bounded", options=options)


def _flat_range(tried: dict[float, float], parameter: OpenParameter) -> tuple[float, float]:
    """Return between which values the cost stays within 1 % of its least."""
    logs = np.array(sorted(tried))
    costs = np.array([tried[x] for x in logs])
    limit = (1.0 + FLAT) * costs.min()
    best = int(np.argmin(costs))

    def crossing(steps: range, end: float) -> float:
        inner = best
        for k in steps:
            if costs[k] > limit:
                share = (limit - costs[inner]) / (costs[k] - costs[inner])
                return float(np.exp(logs[inner] + share * (logs[k] - logs[inner])))
            inner = k
        return end

    return (
        crossing(range(best - 1, -1, -1), parameter.lower),
        crossing(range(best + 1, len(logs)), parameter.upper),
    )
