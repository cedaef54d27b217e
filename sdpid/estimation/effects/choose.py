"""Choose by the data the numbers in which friction is not linear, by variable projection.

For any values of the open parameters the other parameters are a linear least-squares problem,
whose least cost is a function of the open parameters alone [golub2003]_. It is searched here, one
parameter at a time. The columns of fixed shape are projected out once. The cost of a value then
needs the products of the columns that it moves with all others, and a signed fit of the few open
columns.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.whitening import apply, are_diagonal, weights_of
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.term import FrictionTerm, JointwiseTerm
from sdpid.robot.friction.terms import Coulomb, SigmoidFriction, Stribeck
from sdpid.robot.model.base_parameters import structural_base
from sdpid.robot.model.model import RobotModel

# Samples looked at, evenly spread: speeds at which friction bends need no more.
_MOST_SAMPLES = 4096

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


@dataclass(frozen=True, kw_only=True)
class Profiled:
    """One number that was chosen by the data.

    Attributes
    ----------
    term, name, unit : str
        Which number of which term, such as ``width3`` of Coulomb.
    value : float
        Its value.
    lower, upper : float
        The limits of the search.
    flat_from, flat_to : float
        Values between which the cost is within 1 % of its least, the other open parameters
        held: how well the data determine it. Interpolated between the values tried.
    """

    term: str
    name: str
    unit: str
    value: float
    lower: float
    upper: float
    flat_from: float
    flat_to: float

    @property
    def determined(self) -> bool:
        """Whether some value within the limits is worse than the best by 1 % of the cost."""
        return self.flat_from > self.lower or self.flat_to < self.upper


@dataclass(frozen=True, eq=False)
class OpenTerm:
    """A term with open parameters, and what is chosen of them so far.

    Attributes
    ----------
    place : int
        Its place among the robot's terms.
    term : FrictionTerm
        The term as given.
    chosen : list of Profiled
        The open parameters, at first in the middle of their limits.
    """

    place: int
    term: FrictionTerm
    chosen: list[Profiled]

    def closed(self, i: int = 0, value: float | None = None) -> FrictionTerm:
        """Return the term with the present values, or another one of parameter i."""
        values = [each.value for each in self.chosen]
        if value is not None:
            values[i] = value
        return self.term.with_values(values)


def opened(friction: FrictionModel, speeds: Sequence[Array]) -> list[OpenTerm]:
    """Return the terms with open parameters, in the middle of the limits that speeds allow."""
    found = []
    for place, term in enumerate(friction.terms):
        chosen = [
            Profiled(
                term=type(term).__name__,
                name=each.name,
                unit=each.unit,
                value=float(np.sqrt(each.lower * each.upper)),
                lower=each.lower,
                upper=each.upper,
                flat_from=each.lower,
                flat_to=each.upper,
            )
            for each in term.open_parameters(speeds, friction.joint_names)
        ]
        if chosen:
            found.append(OpenTerm(place, term, chosen))
    return found


def closed(
    friction: FrictionModel, found: Sequence[OpenTerm]
) -> tuple[FrictionModel, tuple[Profiled, ...]]:
    """Return the terms with the present values of the open parameters, and these."""
    terms = list(friction.terms)
    for each in found:
        terms[each.place] = each.closed()
    return replace(friction, terms=tuple(terms)), tuple(p for each in found for p in each.chosen)


def close_terms(
    friction: FrictionModel,
    robot: RobotModel,
    samples: Samples,
    covariance: Callable[[RowSource], Array],
) -> tuple[FrictionModel, tuple[Profiled, ...]]:
    """Give values to the open parameters of friction terms: those of the least cost.

    The cost is the weighted sum of squared residuals, least in all linear parameters; those of
    open terms obey their signs, since a negative peak can imitate a smooth sign. Physical
    consistency of the links, priors and further constraints have no say. One parameter is
    searched at a time, on a logarithmic grid and then about its best point, in rounds; nothing
    is random. Only the terms' columns change: all others are factorized once.

    Joint-wise terms have one value a joint, not one for the robot: speeds at which friction
    bends are those of a motor and its gear, and joints of one arm differ in both by factors.
    It costs no more, since each value moves one column.

    Parameters
    ----------
    friction : FrictionModel
        Terms, some of them with open parameters.
    robot : RobotModel
        The robot.
    samples : Samples
        The measurements to fit.
    covariance : callable
        Returns the effort covariance, (n, n) or (K, n, n), of a `RowSource`. It is called once,
        with the open parameters in the middle of their limits.

    Returns
    -------
    FrictionModel
        Without open parameters.
    tuple of Profiled
        What was chosen.
    """
    thin = samples.judged.thinned(_MOST_SAMPLES)
    speed, used = np.abs(thin.velocity), thin.used
    found = opened(friction, [speed[used[:, j], j] for j in range(friction.first, thin.n)])
    if not found:
        return friction, ()
    middle, _ = closed(friction, found)
    rows = RowSource(robot, middle, structural_base(robot, middle), thin)
    VariableProjection(rows, covariance(rows), found).run()
    return closed(friction, found)


def closed_in_the_middle(
    friction: FrictionModel, speed: Array
) -> tuple[FrictionModel, tuple[Profiled, ...]]:
    """Give open parameters the middle of the limits that data of some speeds would search.

    For a run that is yet to be made, whose data cannot choose.

    Parameters
    ----------
    friction : FrictionModel
        Terms, some of them with open parameters.
    speed : ndarray, shape (K, n)
        Sizes of the velocities, rad/s or m/s.
    """
    return closed(friction, opened(friction, list(speed[:, friction.first :].T)))


@dataclass(frozen=True, eq=False)
class _TriedColumns:
    """Open columns at one value of a parameter, with the cost."""

    cost: float
    places: Indices
    joints: Indices
    columns: Array
    inside: Array
    products: Array
    squares: Array


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
    found : sequence of OpenTerm
        The terms to close: what is chosen of them is changed by `run`.

    Attributes
    ----------
    cost : float
        Least cost over all linear parameters at the present values; signs of open terms obeyed.
    """

    def __init__(self, rows: RowSource, sigma: Array, found: Sequence[OpenTerm]) -> None:
        self._opened, self._friction = found, rows.friction
        self._motion = rows.motion(slice(None))
        powers, which = weights_of(rows, slice(None), sigma)
        every, parameters = rows.with_every_column(), rows.friction.parameters
        number, placed = np.arange(len(parameters)), rows.friction.placed
        places = [number[placed[each.place][1]] for each in found]
        loose = np.concatenate(places)
        # The columns of links and friction of fixed shape; the c open ones, the effort as last.
        apart = [*(every.base.count - len(parameters) + loose), every.base.count]
        parts, independent = list(every.parts(_TOGETHER)), are_diagonal(powers)
        reached = np.any([every.rows(p).any(axis=0) for p in parts], axis=0) | (not independent)
        reached[:, apart] = False
        owns = [np.flatnonzero(each) for each in reached]
        fixed = [np.empty((rows.n_samples, len(own))) for own in owns]
        self._loose = np.empty((len(owns), rows.n_samples, len(apart)))
        for part in parts:
            whitened = apply(powers, which[part], every.rows(part))
            for j, own in enumerate(owns):
                fixed[j][part] = whitened[:, j, own]
                self._loose[j, part] = whitened[:, j, apart]
        self._basis = _orthonormal(fixed, owns, every.base.count)
        pairs = list(zip(self._basis, self._loose, strict=True))
        self._inside = np.sum([U.T @ (Q.T @ x) for (Q, U), x in pairs], axis=0)
        own = np.sum([each.T @ each for each in self._loose], axis=0)
        self._products: Array = own - self._inside.T @ self._inside
        self._squares: Array = np.diagonal(own).copy()
        again = np.swapaxes(powers, 1, 2)[which]
        self._gram = again @ powers[which]
        if independent:
            scale = np.diagonal(again, axis1=1, axis2=2).T[:, :, None]
            self._loose *= scale
            self._basis = [(s * Q, U) for s, (Q, U) in zip(scale, self._basis, strict=True)]
        else:
            self._loose = _mixed(again, self._loose)
            mixed = _mixed(again, np.stack([Q @ U for Q, U in self._basis]))
            self._basis = [(Q, np.eye(mixed.shape[2])) for Q in mixed]
        nonnegative = np.array([p.nonnegative for p in parameters], dtype=bool)[loose]
        self._free = np.flatnonzero(~nonnegative)
        self._lowest = np.where(nonnegative, 0.0, -np.inf)
        self._starts = np.cumsum([0, *(len(place) for place in places)])
        self._moved = [[self._moves(each, i) for i in range(len(each.chosen))] for each in found]
        self.cost = float(self._least(self._products[None], self._squares[None])[0])

    def run(self) -> None:
        """Search every open parameter in turn until the cost has settled."""
        for _ in range(_ROUNDS):
            before = self.cost
            for t, each in enumerate(self._opened):
                for i in range(len(each.chosen)):
                    self._search(t, i)
            if self.cost >= (1.0 - _SETTLED) * before:
                break

    def _search(self, t: int, i: int) -> None:
        """Put the best value of one parameter in its place."""
        from scipy.optimize import minimize_scalar

        own = self._opened[t].chosen[i]
        tried: dict[float, _TriedColumns] = {}

        def costs_at(logs: Array) -> Array:
            trials = self._try(t, i, np.clip(np.exp(logs), own.lower, own.upper))
            tried.update(zip(logs.tolist(), trials, strict=True))
            return np.array([trial.cost for trial in trials])

        low, high = np.log(own.lower), np.log(own.upper)
        grid = np.unique(np.linspace(low, high, _GRID))
        costs = costs_at(grid)
        if np.ptp(costs) <= _NO_EFFECT * costs.min():
            best = float(0.5 * (low + high))
            costs_at(np.array([best]))
        else:
            k, last = int(np.argmin(costs)), len(grid) - 1
            minimize_scalar(
                lambda log: float(costs_at(np.array([log]))[0]),
                bounds=(grid[max(k - 1, 0)], grid[min(k + 1, last)]),
                method="bounded",
                options={"xatol": _ACCURACY, "maxiter": _TRIES},
            )
            best = min(tried, key=lambda log: (tried[log].cost, log))
        self._keep(tried[best])
        value = float(np.clip(np.exp(best), own.lower, own.upper))
        low, high = _flat_range({log: one.cost for log, one in tried.items()}, own)
        self._opened[t].chosen[i] = replace(own, value=value, flat_from=low, flat_to=high)

    def _try(self, t: int, i: int, values: Array) -> list[_TriedColumns]:
        """Return the cost at other values (g,) of a parameter, and the columns that it moves."""
        moved = self._moved[t][i]
        terms = [self._opened[t].closed(i, float(value)) for value in values]
        joints, columns = self._shown(terms, moved)
        places = self._starts[t] + moved
        own = self._product(joints, columns)
        size = len(values), len(moved)
        flat = columns.reshape(*columns.shape[:2], size[0] * size[1])
        # Products with the basis of the columns of fixed shape, and with the other open ones.
        whole = np.zeros((len(self._inside), flat.shape[2]))
        beside = np.zeros((len(self._products), flat.shape[2]))
        for j, each in zip(joints, flat, strict=True):
            Q, U = self._basis[j]
            whole += U.T @ (Q.T @ each)
            beside += self._loose[j].T @ each
        beside -= self._inside.T @ whole
        inside, others = (np.moveaxis(x.reshape(len(x), *size), 1, 0) for x in (whole, beside))
        others[:, places] = own - np.swapaxes(inside, 1, 2) @ inside
        products = np.repeat(self._products[None], len(values), axis=0)
        products[:, :, places], products[:, places] = others, np.swapaxes(others, 1, 2)
        squares = np.repeat(self._squares[None], len(values), axis=0)
        squares[:, places] = np.diagonal(own, axis1=1, axis2=2)
        costs = self._least(products, squares)
        return [
            _TriedColumns(float(costs[k]), places, joints, columns[:, :, k], *own)
            for k, own in enumerate(zip(inside, products, squares, strict=True))
        ]

    def _keep(self, trial: _TriedColumns) -> None:
        """Make the columns of a trial the present ones."""
        mixed = np.moveaxis(self._gram[:, :, trial.joints], 1, 0)
        self._loose[:, :, trial.places] = np.einsum("nkw,wkc->nkc", mixed, trial.columns)
        self._inside[:, trial.places] = trial.inside
        self._squares, self._products, self.cost = trial.squares, trial.products, trial.cost

    def _moves(self, term: OpenTerm, i: int) -> Indices:
        """Return which of a term's columns depend on one of its parameters."""
        ends = [term.closed(i, value) for value in (term.chosen[i].lower, term.chosen[i].upper)]
        # Of these terms the speeds tell, and no column has to be looked at.
        alike = type(term.term) in _ALIKE
        low, high = (self._speeds(each)[None] if alike else self._columns(each) for each in ends)
        return np.flatnonzero(np.any(low != high, axis=(0, 1)))

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
        ridge = _RIDGE * np.eye(size.shape[1])
        H = products[:, :-1, :-1] / size[:, None, :] / size[:, :, None] + ridge
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


def _flat_range(tried: dict[float, float], own: Profiled) -> list[float]:
    """Return between which values the cost stays within 1 % of its least."""
    logs, costs = (np.array(each) for each in zip(*sorted(tried.items()), strict=True))
    limit, best = (1.0 + FLAT) * costs.min(), int(np.argmin(costs))
    ends = [own.lower, own.upper]
    for side, outward in enumerate((slice(best, None, -1), slice(best, None))):
        x, y = logs[outward], costs[outward]
        k = int(np.argmax(y > limit))
        # The best one itself is the first: none is above the limit.
        if k:
            ends[side] = float(np.exp(np.interp(limit, y[k - 1 : k + 1], x[k - 1 : k + 1])))
    return ends
