"""Variable projection: the least cost as a function of parameters that do not enter linearly.

For any values of the open parameters the other parameters are a linear least-squares problem
[golub2003]_. The columns of fixed shape are projected out once. The cost of a value then needs the
products of the columns that it moves with all others, and a signed fit of the few open columns.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.whitening import apply, are_diagonal, weights_of
from sdpid.robot.friction.term import FrictionTerm, JointwiseTerm, OpenParameter
from sdpid.robot.friction.terms import Coulomb, SigmoidFriction, Stribeck

# Values tried between the limits, evenly spaced by their logarithm: with limits a factor of 500
# apart each is twice the one before, and the cost bends no faster than the shape does.
_GRID = 9

# Then the best one's neighborhood is searched to 0.2 %, with at most this many values: clean
# records determine a speed to a percent.
_ACCURACY = 0.002
_TRIES = 20

# Rounds over all open parameters; they stop when one brings less than this share of the cost.
_ROUNDS = 8
_SETTLED = 1e-5

# Samples whose columns are made at a time.
_TOGETHER = 512

# Values whose cost exceeds the least by less than this share are as good: the range reported.
FLAT = 0.01

# Where all values tried agree to this share of the cost, none is better: the middle is kept.
_NO_EFFECT = 1e-6

# Directions of the columns of fixed shape that are this small beside the largest are none.
_DEPENDENT = 1e-8

# Added to the unit diagonal of the open columns' products, so that a column that others span takes
# part in nothing, and the products stay positive definite when rounded.
_RIDGE = 1e-9


# Terms whose shape at a joint depends on that joint's motion and speeds alone. A subclass may know
# which joint is which.
_ALIKE: tuple[type[JointwiseTerm], ...] = (Coulomb, SigmoidFriction, Stribeck)


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
        The open parameters.
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
class _Trial:
    """Open columns at one value of a parameter, with the cost."""

    cost: float
    places: Indices
    joints: Indices
    columns: Array
    inside: Array
    products: Array


class VariableProjection:
    """The least cost as a function of the open parameters, searched one at a time.

    Columns that are tried stay as they are, and those that are kept are whitened twice, which makes
    the products of whitened ones: a column that is tried is zero at all joints but those that its
    term acts on, whitened it may be zero nowhere.

    Parameters
    ----------
    rows : RowSource
        Rows with the open parameters in the middle of their limits.
    sigma : ndarray, shape (n, n) or (K, n, n)
        Covariance of the effort.
    opened : sequence of OpenTerm
        The terms to close: their values are changed by `run`.

    Attributes
    ----------
    cost : float
        Least cost over all linear parameters at the present values; signs of open terms obeyed.
    """

    def __init__(self, rows: RowSource, sigma: Array, opened: list[OpenTerm]) -> None:
        self._opened, self._friction = opened, rows.friction
        self._motion = rows.motion(slice(None))
        powers, which = weights_of(rows, slice(None), sigma)
        every, count = rows.with_every_column(), rows.n_samples
        placed, number = rows.friction.placed, len(rows.friction.parameters)
        places = [np.arange(number)[placed[each.place][1]] for each in opened]
        loose = np.concatenate(places)
        # The links' columns, those of friction and the effort.
        apart = [*(every.base.count - number + loose), every.base.count]
        independent = are_diagonal(powers)
        reached = every.reached | (not independent)
        reached[:, apart] = False
        # Columns of fixed shape, those that a joint has, (K, own); then the c open columns, and the
        # effort as the last one.
        owns = [np.flatnonzero(each) for each in reached]
        fixed = [np.empty((count, len(own))) for own in owns]
        self._loose = np.empty((len(reached), count, len(apart)))
        for part in every.parts(_TOGETHER):
            whitened = apply(powers, which[part], every.rows(part))
            for j, own in enumerate(owns):
                fixed[j][part] = whitened[:, j, own]
                self._loose[j, part] = whitened[:, j, apart]
        self._basis = _orthonormal(fixed, owns, every.base.count)
        self._inside = np.sum(
            [U.T @ (Q.T @ x) for (Q, U), x in zip(self._basis, self._loose, strict=True)], axis=0
        )
        own = np.sum([each.T @ each for each in self._loose], axis=0)
        self._products: Array = own - self._inside.T @ self._inside
        self._squares: Array = np.diagonal(own).copy()
        again = np.swapaxes(powers, 1, 2)
        self._gram = (again @ powers)[which]
        if independent:
            scale = np.diagonal(powers, axis1=1, axis2=2)[which].T[:, :, None]
            self._loose *= scale
            self._basis = [(s * Q, U) for s, (Q, U) in zip(scale, self._basis, strict=True)]
        else:
            self._loose = _mixed(again[which], self._loose)
            mixed = _mixed(again[which], np.stack([Q @ U for Q, U in self._basis]))
            self._basis = [(Q, np.eye(mixed.shape[2])) for Q in mixed]
        nonnegative = np.array([p.nonnegative for p in rows.friction.parameters], dtype=bool)
        self._free = np.flatnonzero(~nonnegative[loose])
        self._lowest = np.where(nonnegative[loose], 0.0, -np.inf)
        self._ridge = _RIDGE * np.eye(len(loose))
        self._starts = np.cumsum([0, *(len(place) for place in places)])
        self._moved: dict[tuple[int, int], Indices] = {}
        self.cost = float(self._least(self._products[None], self._squares[None])[0])

    def run(self) -> None:
        """Search every open parameter in turn until the cost has settled."""
        for _ in range(_ROUNDS):
            before = self.cost
            for t, each in enumerate(self._opened):
                for i in range(len(each.parameters)):
                    self._search(t, i)
            if self.cost >= (1.0 - _SETTLED) * before:
                break

    def _search(self, t: int, i: int) -> None:
        """Put the best value of one parameter in its place."""
        from scipy.optimize import minimize_scalar

        parameter = self._opened[t].parameters[i]
        low, high = np.log(parameter.lower), np.log(parameter.upper)
        tried: dict[float, _Trial] = {}

        def costs_at(logs: Array) -> Array:
            values = np.clip(np.exp(logs), parameter.lower, parameter.upper)
            trials = self._try(t, i, values)
            tried.update(zip(logs.tolist(), trials, strict=True))
            return np.array([trial.cost for trial in trials])

        def cost(log: float) -> float:
            return float(costs_at(np.array([log]))[0])

        grid = np.linspace(low, high, _GRID) if high > low else np.array([low])
        costs = costs_at(grid)
        best = int(np.argmin(costs))
        chosen = float(grid[best])
        if np.ptp(costs) <= _NO_EFFECT * costs.min():
            chosen = float(0.5 * (low + high))
            cost(chosen)
        elif len(grid) > 1:
            near = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
            options = {"xatol": _ACCURACY, "maxiter": _TRIES}
            minimize_scalar(cost, bounds=near, method="bounded", options=options)
            chosen = min(tried, key=lambda log: (tried[log].cost, log))
        self._keep(tried[chosen])
        each = self._opened[t]
        each.values[i] = float(np.clip(np.exp(chosen), parameter.lower, parameter.upper))
        each.flat[i] = _flat_range({log: one.cost for log, one in tried.items()}, parameter)

    def _try(self, t: int, i: int, values: Array) -> list[_Trial]:
        """Return the cost at other values (g,) of a parameter, and the columns that it moves."""
        moved = self._moving(t, i)
        terms = [self._opened[t].changed(i, float(value)) for value in values]
        joints, columns = self._shown(terms, moved)
        places = self._starts[t] + moved
        w, count, g, m = columns.shape
        inside, others = (np.zeros((len(x), g * m)) for x in (self._inside, self._products))
        for j, each in zip(joints, columns.reshape(w, count, g * m), strict=True):
            Q, U = self._basis[j]
            inside += U.T @ (Q.T @ each)
            others += self._loose[j].T @ each
        others = np.moveaxis((others - self._inside.T @ inside).reshape(len(others), g, m), 1, 0)
        inside = np.moveaxis(inside.reshape(len(inside), g, m), 1, 0)
        own = self._product(joints, columns)
        others[:, places] = own - np.swapaxes(inside, 1, 2) @ inside
        products = np.repeat(self._products[None], g, axis=0)
        products[:, :, places], products[:, places] = others, np.swapaxes(others, 1, 2)
        squares = np.repeat(self._squares[None], g, axis=0)
        squares[:, places] = np.diagonal(own, axis1=1, axis2=2)
        return [
            _Trial(float(cost), places, joints, columns[:, :, k], inside[k], products[k])
            for k, cost in enumerate(self._least(products, squares))
        ]

    def _keep(self, trial: _Trial) -> None:
        """Make the columns of a trial the present ones."""
        mixed = np.moveaxis(self._gram[:, :, trial.joints], 1, 0)
        self._loose[:, :, trial.places] = np.einsum("nkw,wkc->nkc", mixed, trial.columns)
        squares = np.diagonal(self._product(trial.joints, trial.columns[:, :, None])[0])
        self._inside[:, trial.places] = trial.inside
        self._squares[trial.places] = squares
        self._products, self.cost = trial.products, trial.cost

    def _moving(self, t: int, i: int) -> Indices:
        """Return which of a term's columns depend on one of its parameters."""
        if (t, i) not in self._moved:
            each, p = self._opened[t], self._opened[t].parameters[i]
            ends = [each.changed(i, value) for value in (p.lower, p.upper)]
            # Of these terms the speeds tell, and no column has to be looked at.
            alike = type(each.term) in _ALIKE
            low, high = (self._speeds(e)[None] if alike else self._columns(e) for e in ends)
            self._moved[t, i] = np.flatnonzero(np.any(low != high, axis=(0, 1)))
        return self._moved[t, i]

    def _speeds(self, term: FrictionTerm) -> Array:
        """Return the speeds (fields, joints) of a term with one shape for all joints."""
        assert isinstance(term, JointwiseTerm)
        return np.array(
            [term.speed(name, len(self._friction.joint_names)) for name in term.speed_fields]
        )

    def _columns(self, term: FrictionTerm) -> Array:
        """Return a term's columns (K, joints, m)."""
        return term.columns_in(self._motion, self._friction.joint_names)

    def _shown(self, terms: list[FrictionTerm], moved: Indices) -> tuple[Indices, Array]:
        """Return at which joints some columns of g terms are not zero, and these (w, K, g, m)."""
        first = terms[0]
        if isinstance(first, JointwiseTerm) and type(first) in _ALIKE and len(moved) == 1:
            joints, columns = moved, self._shapes(terms, int(moved[0]))[None, :, :, None]
        else:
            found = np.stack([self._columns(term)[:, :, moved] for term in terms], axis=2)
            joints = np.flatnonzero(found.any(axis=(0, 2, 3)))
            columns = np.swapaxes(found[:, joints], 0, 1)
        return joints + self._friction.first, columns

    def _product(self, joints: Indices, columns: Array) -> Array:
        """Return the products (g, m, m), once whitened, of columns as `_shown` returns them."""
        weighted = np.einsum("kwv,vkga->wkga", self._gram[:, joints[:, None], joints], columns)
        return np.asarray(np.einsum("wkga,wkgb->gab", columns, weighted))

    def _shapes(self, terms: list[FrictionTerm], joint: int) -> Array:
        """Return the columns (K, g) of one joint, as if each term were that of another joint."""
        (term, *_), same = terms, [joint] * len(terms)
        assert isinstance(term, JointwiseTerm)
        own = np.stack([self._speeds(each)[:, joint] for each in terms], axis=1)
        many = replace(term, **dict(zip(term.speed_fields, map(tuple, own.tolist()), strict=True)))
        return self._motion.filtered(lambda v, a: many.shape(v[:, same], a[:, same]))

    def _least(self, products: Array, squares: Array) -> Array:
        """Return the least costs (g,) over all linear parameters, from the open columns' products.

        Products are (g, c + 1, c + 1), and the columns' squared lengths (g, c + 1).
        """
        from scipy.optimize import nnls

        size = np.sqrt(np.where(squares[:, :-1] > 0.0, squares[:, :-1], 1.0))
        H = products[:, :-1, :-1] / size[:, None, :] / size[:, :, None] + self._ridge
        b = (products[:, :-1, -1] / size)[:, :, None]
        u = np.linalg.solve(H, b)
        gain = np.einsum("gci,gci->g", b, u)
        wrong = np.flatnonzero((u[:, :, 0] < self._lowest).any(axis=1))
        # A column of any sign is two that are not negative, one the negative of the other.
        root = np.linalg.cholesky(H[wrong])
        rhs = np.linalg.solve(root, b[wrong])[:, :, 0]
        upper = np.swapaxes(root, 1, 2)
        both = np.concatenate([upper, -upper[:, :, self._free]], axis=2)
        for k, columns, target in zip(wrong, both, rhs, strict=True):
            gain[k] = target @ target - nnls(columns, target)[1] ** 2
        return np.asarray(np.maximum(products[:, -1, -1] - gain, 0.0))


def _orthonormal(fixed: list[Array], owns: list[Indices], width: int) -> list[tuple[Array, Array]]:
    """Return Q (K, own) and U (own, r) of joints with own columns: Q·U are an orthonormal basis."""
    pairs = [np.linalg.qr(each) for each in fixed]
    rows = [np.zeros((len(R), width)) for _, R in pairs]
    for each, own, (_, R) in zip(rows, owns, pairs, strict=True):
        each[:, own] = R
    stacked = np.concatenate(rows)
    size = np.linalg.norm(stacked, axis=0)
    V, R = np.linalg.qr(stacked / np.where(size > 0.0, size, 1.0))
    U, s, _ = np.linalg.svd(R)
    rank = np.count_nonzero(s > _DEPENDENT * s.max(initial=0.0))
    parts = np.split(V @ U[:, :rank], np.cumsum([len(each) for each in rows])[:-1])
    return [(Q, part) for (Q, _), part in zip(pairs, parts, strict=True)]


def _mixed(weights: Array, columns: Array) -> Array:
    """Return columns (n, K, c) times the weights (K, n, n) of their samples."""
    return np.ascontiguousarray(np.swapaxes(weights @ np.swapaxes(columns, 0, 1), 0, 1))


def _flat_range(tried: dict[float, float], parameter: OpenParameter) -> tuple[float, float]:
    """Return between which values the cost stays within 1 % of its least."""
    logs = np.array(sorted(tried))
    costs = np.array([tried[x] for x in logs])
    limit = (1.0 + FLAT) * costs.min()
    best = int(np.argmin(costs))

    def crossing(outward: slice, end: float) -> float:
        x, y = logs[outward], costs[outward]
        k = int(np.argmax(y > limit))
        # The best one itself is the first: none is above the limit.
        return float(np.exp(np.interp(limit, y[k - 1 : k + 1], x[k - 1 : k + 1]))) if k else end

    return (
        crossing(slice(best, None, -1), parameter.lower),
        crossing(slice(best, None), parameter.upper),
    )
