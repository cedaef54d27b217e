"""The descent of variable projection, one open parameter at a time."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from sdpid._arrays import Array, Indices
from sdpid.estimation.rows import RowSource
from sdpid.estimation.weighting import whitener
from sdpid.robot.friction import FrictionTerm, OpenParameter

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
_DEPENDENT = 1e-10

# Added to the unit diagonal of the columns' products, so that a column that others span takes
# part in nothing, and the products stay positive definite when rounded.
_RIDGE = 1e-9


@dataclass(eq=False)
class OpenTerm:
    """A term with open parameters, and their present values.

    Attributes
    ----------
    place : int
        Its place among the robot's terms.
    term : FrictionTerm
        The term as given.
    parameters : tuple of OpenParameter
        What is open.
    values : list of float
        Present values; at first the middles of the limits.
    flat : list of (float, float)
        For each the range of values that are as good.
    """

    place: int
    term: FrictionTerm
    parameters: tuple[OpenParameter, ...]
    values: list[float] = field(default_factory=list)
    flat: list[tuple[float, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.values = [float(np.sqrt(p.lower * p.upper)) for p in self.parameters]
        self.flat = [(p.lower, p.upper) for p in self.parameters]

    @property
    def closed(self) -> FrictionTerm:
        """The term with the present values."""
        return self.term.with_values(self.values)

    def changed(self, i: int, value: float) -> FrictionTerm:
        """Return the term with another value of parameter i."""
        return self.term.with_values([*self.values[:i], value, *self.values[i + 1 :]])


@dataclass(frozen=True, eq=False)
class _Columns:
    """The open terms' columns, the effort behind them, and their products.

    Attributes
    ----------
    whitened : ndarray, shape (n, K, c + 1)
    inside : ndarray, shape (f, c + 1)
        Coordinates in the span of the columns of fixed shape.
    products : ndarray, shape (c + 1, c + 1)
        Inner products of what is outside that span.
    """

    whitened: Array
    inside: Array
    products: Array


class ProfileSearch:
    """The least cost as a function of the open parameters, and its descent.

    Whitened columns are kept joint by joint, (n, K, columns): with independent joints a column
    is zero at all joints but those that its term acts on.

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
        mask = np.ones(s.effort.shape, dtype=bool) if s.mask is None else s.mask
        self.weight = whitener(sigma, mask, -0.5)
        count = [len(t.parameters(friction.joint_names)) for t in friction.terms]
        ends = np.cumsum([0, *count])
        places = [np.arange(ends[each.place], ends[each.place + 1]) for each in opened]
        columns = friction.columns(s.velocity, s.acceleration)
        fixed = np.delete(columns, np.concatenate(places), axis=2)
        # Friction comes last in the scan for base parameters: it does not change which of the
        # inertial columns are kept.
        inertial = rows.base.kept < 10 * rows.robot.n_links
        whole = [rows.regressor(slice(None))[:, :, inertial], fixed]
        self.basis = _orthonormal(self._whiten(np.concatenate(whole, axis=2)))
        loose = [columns[:, :, place] for place in places]
        whitened = self._whiten(np.concatenate([*loose, s.effort[:, :, None]], axis=2))
        inside = self._inside(whitened)
        products = np.tensordot(whitened, whitened, ((0, 1), (0, 1))) - inside.T @ inside
        self.columns = _Columns(whitened, inside, products)
        nonnegative = np.array([p.nonnegative for p in friction.parameters], dtype=bool)
        self.free = ~nonnegative[np.concatenate(places)]
        starts = np.cumsum([0, *(len(place) for place in places)])
        self.spans = [slice(a, b) for a, b in itertools.pairwise(starts)]
        self.cost = self._least(self.columns)

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
        moved = self._moved(each, i)
        index: Indices = np.arange(span.start, span.stop, dtype=np.intp)[moved]
        tried: dict[float, float] = {}

        def cost(log: float) -> float:
            tried[log] = self._least(self._with(each, index, moved, i, float(np.exp(log))))
            return tried[log]

        low, high = np.log(parameter.lower), np.log(parameter.upper)
        grid = np.linspace(low, high, _GRID) if high > low else np.array([low])
        costs = np.array([cost(float(x)) for x in grid])
        best = int(np.argmin(costs))
        chosen = float(grid[best])
        if costs.max() - costs.min() <= _NO_EFFECT * costs.min():
            chosen = 0.5 * float(low + high)
        elif len(grid) > 1:
            _refine(cost, grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)])
            chosen = min(tried, key=lambda x: (tried[x], x))
        value = float(np.clip(np.exp(chosen), parameter.lower, parameter.upper))
        self.columns = self._with(each, index, moved, i, value)
        self.cost = self._least(self.columns)
        each.values[i] = value
        each.flat[i] = _flat_range(tried, parameter)

    def _moved(self, each: OpenTerm, i: int) -> Indices:
        """Return which of a term's columns depend on its parameter i."""
        p = each.parameters[i]
        ends = [self._columns_of(each.changed(i, value)) for value in (p.lower, p.upper)]
        return np.flatnonzero(np.any(ends[0] != ends[1], axis=(0, 1)))

    def _columns_of(self, term: FrictionTerm) -> Array:
        return term.columns(self.velocity, self.acceleration, self.friction.joint_names)

    def _with(
        self, each: OpenTerm, index: Indices, moved: Indices, i: int, value: float
    ) -> _Columns:
        """Return the columns with another value of parameter i of a term."""
        found = self._columns_of(each.changed(i, value))[:, :, moved]
        old = self.columns
        whitened, inside, products = old.whitened.copy(), old.inside.copy(), old.products.copy()
        whitened[:, :, index] = self._whiten(found, self.friction.first)
        inside[:, index] = self._inside(whitened[:, :, index])
        cross = np.tensordot(whitened, whitened[:, :, index], ((0, 1), (0, 1)))
        products[:, index] = cross - inside.T @ inside[:, index]
        products[index] = products[:, index].T
        return _Columns(whitened, inside, products)

    def _whiten(self, columns: Array, first: int = 0) -> Array:
        """Return whitened columns (n, K, c) of those (K, n − first, c) of the last joints."""
        return np.ascontiguousarray(np.swapaxes(self.weight[:, :, first:] @ columns, 0, 1))

    def _inside(self, whitened: Array) -> Array:
        """Return the coordinates of columns in the span of those of fixed shape."""
        out = np.zeros((self.basis.shape[2], whitened.shape[2]))
        for q, c in zip(self.basis, whitened, strict=True):
            if c.any():
                out += q.T @ c
        return out

    def _least(self, columns: _Columns) -> float:
        """Return the least cost over all linear parameters, signs of the open terms obeyed."""
        from scipy.optimize import nnls

        G = columns.products
        size = np.sqrt(np.maximum(np.diag(G) + (columns.inside**2).sum(axis=0), 0.0))[:-1]
        size = np.where(size > 0.0, size, 1.0)
        root = np.linalg.cholesky(G[:-1, :-1] / np.outer(size, size) + _RIDGE * np.eye(len(size)))
        rhs = np.linalg.solve(root, G[:-1, -1] / size)
        _, left = nnls(np.hstack([root.T, -root.T[:, self.free]]), rhs)
        return float(max(G[-1, -1] - rhs @ rhs, 0.0) + left**2)


def _orthonormal(columns: Array) -> Array:
    """Return an orthonormal basis, (n, K, rank), of the span of columns (n, K, c)."""
    n, count, width = columns.shape
    flat = columns.reshape(n * count, width)
    size = np.linalg.norm(flat, axis=0)
    Q, R = np.linalg.qr(flat / np.where(size > 0.0, size, 1.0))
    U, s, _ = np.linalg.svd(R)
    Q = Q @ U[:, : np.count_nonzero(s > _DEPENDENT * s.max(initial=0.0))]
    return np.ascontiguousarray(Q.reshape(n, count, -1))


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
