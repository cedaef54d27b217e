"""A payload as a virtual link: a problem of its own, solved and given intervals as any other.

The arm's parameters theta and the payload's ten pi act together. With R and h what is known of the
arm (rows of a recording without load, or of a prior), A and r the compressed rows of the recording
with load, B the matrix of the base parameters,

    cost = ‖R·theta − h‖² + ‖A·(B·theta + S·delta + B_link·pi) − r‖²

with delta what differs between the recordings (offsets of sensors). Projected on the rows that
theta and delta cannot reach, it is the cost that the best theta and delta leave for each pi: that
of one link that floats alone, whose base parameters are what the recordings show of pi.

Intervals are profile intervals of that problem (see `sdpid.assurance.intervals.level`), with the
errors that the residuals of both recordings show. The center of mass h/m ≤ c means h − c·m ≤ 0:
Dinkelbach's iteration on c finds the global extreme [dinkelbach1967]_. The inertia about the center
of mass is linear to first order: it is that about the center of mass of the best payload.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sdpid._common.arrays import Array, Indices, frozen
from sdpid.assurance.intervals.profile_likelihood import ProfileLikelihood
from sdpid.assurance.payload.payload import DescribedLinks, least_second_moment, quantities
from sdpid.errors import DataError
from sdpid.estimation.constraints.condition import Condition, Layout, Row
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.error_source import ErrorSource
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.information import freedom_of
from sdpid.estimation.noise_spectrum import NoiseSpectrum
from sdpid.estimation.posterior import FitErrors, Posterior, gain_errors, rows_covariance
from sdpid.estimation.prior.cost_terms import SquaredTerm
from sdpid.estimation.prior.evidence import strength_by_evidence
from sdpid.estimation.prior.prior import Prior, prior_terms
from sdpid.estimation.problem import Origin, Problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.robot.consistent import raise_second_moments
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.inertia import margin, transform
from sdpid.robot.model.load import load_robot

# Relative standard deviation of the links that a description is granted: the one that makes the
# recording most probable, but never less than the first, since the last link and the payload look
# alike, nor more than the second. Against the descriptions of five real arms without load (UR10,
# Panda, LWR 4+, TX40, UR10e by published gains) the first alone holds "no payload" in five of eight
# recordings, the second in all; beyond it an interval says nothing.
_LEAST_TOLERANCE, _MOST_TOLERANCE = 0.1, 0.3

# Singular values of the arm's scaled columns below this share of the largest are rounding.
_RANK = 1e-11

# Directions in which a unit payload moves the cost by less than this share of the strongest one
# are invisible, but for rounding.
_INVISIBLE = 1e-9

# Where the data say nothing, bodies are taken that are as near as can be to a ball of 1 kg.
_BALL = """<robot name="payload"><link name="payload"><inertial><mass value="1"/>
<inertia ixx="4e-3" iyy="4e-3" izz="4e-3" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""

# The least mass that the problem has, and what is no payload, kg.
_MASS_MIN, _NOTHING = 1e-9, 1e-6

# Among the quantities.
_CENTER, _POSITIVE = [1, 2, 3], [0, 4, 6, 9]

# A center of mass that changes by less than this share has settled.
_CLOSE, _ROUNDS = 1e-5, 6


@dataclass(frozen=True)
class Extent(Condition):
    """The rms distance of a single link's mass from the origin is at most so many m."""

    distance: float

    def compile(self, layout: Layout) -> Iterator[Row]:
        """Return the second moment about the origin, tr(I) / 2, against that of the mass."""
        row = np.where(np.isin(layout.names, ("xx_1", "yy_1", "zz_1")), 0.5, 0.0)
        row[layout.parameter("m_1")] = -(self.distance**2)
        yield Row("rms distance of the mass from the origin", row, -np.inf, 0.0)


def payload_problem(
    loaded: Problem,
    arm: Problem | None,
    columns: Array,
    separate: Indices,
    links: Array | None,
    *,
    mass_max: float,
    extent: float,
) -> tuple[Problem, FitErrors, DescribedLinks | None]:
    """Return the problem of a payload, the errors of its fit, and what a description is granted.

    Parameters
    ----------
    loaded : Problem
        The recording with load; its prior counts where there is no other problem.
    arm : Problem or None
        The one without load, of the same base parameters.
    columns : ndarray, shape (b, 10)
        What the payload adds to the base parameters.
    separate : ndarray of int
        Entries of theta that differ between the two.
    links : ndarray, shape (links, 10), or None
        Described links, where the arm is taken from them and only its friction is estimated.
    mass_max, extent : float
        Largest mass, kg, and rms distance of it from the frame's origin, m.
    """
    known, count = loaded if arm is None else arm, loaded.base.count
    if len(known.log_det.links):
        raise DataError(
            "payload: an arm with a log-det prior is no sum of squares; give or estimate it with "
            "Prior(kind='pullback')."
        )
    # Where there is one problem, its own rows come last.
    of_arm = 0 if arm is None else count
    G, h = known.squared.matrix[count - of_arm :], known.squared.rhs[count - of_arm :]
    own, first = loaded.A @ loaded.base.matrix, 0 if links is None else links.size
    given = loaded.rhs if links is None else loaded.rhs - own[:, :first] @ links.ravel()
    beside = np.zeros((len(G), len(separate)))
    nuisance = np.block([[G[:, first:], beside], [own[:, first:], own[:, separate]]])
    size = np.linalg.norm(nuisance, axis=0)
    U, singular, _ = np.linalg.svd(nuisance[:, size > 0.0] / size[size > 0.0])
    rank = int(np.count_nonzero(singular > _RANK * singular.max(initial=0.0)))
    free = U[:, rank:].T
    left = free @ np.concatenate([h, given])
    U, singular, V = np.linalg.svd(free[:, len(G) :] @ loaded.A @ columns)
    if not singular[0] > 0.0:
        raise DataError("payload: the recordings do not show it at all; move more joints.")
    shown = int(np.count_nonzero(singular > _INVISIBLE * singular[0]))
    U, singular, V = U[:, :shown].T, singular[:shown], V[:shown]
    # How the fit moves with all rows.
    moves = (U / singular[:, None]) @ free
    parts = [(loaded, moves[:, len(G) :])]
    if arm is not None:
        parts.append((arm, moves[:, :count]))
    errors = [_known(moves[:, of_arm : len(G)])]
    for problem, moved in parts:
        noise = NoiseSpectrum.of(problem)
        errors.append(FitErrors(moved @ problem.A @ noise.root, noise.scores, noise.freedom))
    granted = None
    if links is not None:
        granted, spread = _granted(loaded, columns, links)
        errors.append(_known(parts[0][1] @ own[:, :first] @ spread))
    robot = load_robot(_BALL, root="free_flyer")
    problem = replace(
        loaded,
        robot=robot,
        friction=FrictionModel.from_terms((), robot.joint_names, first=robot.n_base),
        base=replace(
            loaded.base,
            names=tuple(f"payload {i + 1}" for i in range(shown)),
            units=("",) * shown,
            matrix=frozen(V),
            kept=np.arange(shown),
            theta_names=robot.parameter_names,
            theta_units=robot.parameter_units,
        ),
        A=frozen(np.diag(singular)),
        rhs=frozen(U @ left),
        floor=max(float(left @ left - np.sum((U @ left) ** 2)), 0.0)
        + sum(each.floor for each, _ in parts),
        prior=None,
        rows=None,
        origin=Origin(weighting=loaded.weighting),
        errors=_of_gains(parts),
    )
    constraints = Constraints(
        mass_min=_MASS_MIN,
        mass_max=mass_max,
        theta_max=mass_max * max(1.0, 2.0 * extent**2),
        others=(Extent(extent),),
    )
    problem = problem.constrained(consistency="pseudo_inertia", constraints=constraints)
    return problem, _joined(errors), granted


def _granted(loaded: Problem, columns: Array, links: Array) -> tuple[DescribedLinks, Array]:
    """Return what described links are granted, and how they then scatter, (10·links, k)."""
    (term,) = prior_terms(Prior(), loaded.require_rows("payload")).terms
    assert isinstance(term, SquaredTerm)
    each, others = slice(0, links.size), slice(links.size, None)
    U, singular, _ = np.linalg.svd(loaded.A @ columns)
    beside = U[:, int(np.count_nonzero(singular > _RANK * singular[0])) :].T
    strength = strength_by_evidence(
        (beside @ loaded.A @ loaded.base.matrix, beside @ loaded.rhs),
        (term.matrix[each], term.rhs[each]),
        (term.matrix[others], term.rhs[others]),
    )
    likely = float(strength**-0.5)
    tolerance = float(np.clip(likely, _LEAST_TOLERANCE, _MOST_TOLERANCE))
    spread = tolerance * np.linalg.inv(term.matrix[each, each])
    return DescribedLinks(tolerance, likely > _MOST_TOLERANCE), np.asarray(spread)


def _known(moves: Array) -> FitErrors:
    """Return errors of variance one, by which the fit moves (b, k)."""
    return FitErrors(moves, np.eye(moves.shape[1]), lambda moved: np.full(len(moved), np.inf))


def _joined(parts: Sequence[FitErrors]) -> FitErrors:
    """Return independent errors together; their degrees of freedom are by Welch's formula."""

    def freedom(directions: Array) -> Array:
        own = [directions @ each.root for each in parts]
        pairs = list(zip(parts, own, strict=True))
        variances = [np.einsum("ki,ij,kj->k", x, each.scores, x) for each, x in pairs]
        freedoms = [each.freedom(x) for each, x in pairs]
        return freedom_of(np.transpose(variances), np.transpose(freedoms))

    scores = np.sum([each.root @ each.scores @ each.root.T for each in parts], axis=0)
    return FitErrors(np.eye(len(scores)), scores, freedom)


def _of_gains(parts: Sequence[tuple[Problem, Array]]) -> tuple[ErrorSource, ...]:
    """Return the errors of gains by which the fit moves; those of the same gains are one."""
    found: list[ErrorSource] = []
    for problem, moves in parts:
        errors = gain_errors(problem)
        if errors is None:
            continue
        errors = replace(errors, moves=moves @ problem.A @ errors.moves)
        if found and found[0].same(errors):
            errors = replace(errors, moves=found.pop().moves + errors.moves)
        found.append(errors)
    return tuple(found)


def best_payload(problem: Problem) -> tuple[Estimate, bool]:
    """Return the payload of least cost, and whether it is held by the densest matter there is."""
    found = solve_sdp(problem)
    theta = np.array(found.theta)
    if theta[0] <= _NOTHING:
        return replace(found, theta=frozen(np.zeros(10))), False
    least = least_second_moment(theta[0])
    held = bool(margin(theta, "pseudo_inertia") < least)
    if held:
        limits = problem.constraints.replace(margin=least)
        found = solve_sdp(problem.constrained(constraints=limits))
        theta = np.array(found.theta)
    # The mass may have changed.
    theta = raise_second_moments(theta, least_second_moment(theta[0]))
    return replace(found, theta=frozen(theta)), held


def payload_intervals(problem: Problem, best: Array, errors: FitErrors, level: float) -> Array:
    """Return the ends (10, 2) of the intervals of all quantities, infinite where there is none."""
    profile = ProfileLikelihood(problem, best, errors, level)
    ends = np.tile([-np.inf, np.inf], (10, 1))
    for side, sign in enumerate((1.0, -1.0)):
        values = quantities(best)
        left = list(range(count := len(_functions(best, values))))
        for _ in range(_ROUNDS):
            before, chosen = values.copy(), sign * _functions(best, values)[left]
            for k, c, end in zip(left, chosen, profile.minima(chosen, n_jobs=1), strict=True):
                if k not in _CENTER:
                    values[k] = sign * profile.proven(c, end)
                    if k in _POSITIVE:
                        values[k] = max(values[k], 0.0)
                elif end.theta[0] > _NOTHING:
                    values[k] = end.theta[k] / end.theta[0]
                else:
                    values[k] = -sign * np.inf
            moved = np.abs(values - before) > _CLOSE * np.abs(values)
            left = [k for k in left if k in _CENTER and moved[k]]
            if not left:
                break
        ends[:count, side] = values[:count]
    return ends


def _functions(best: Array, values: Array) -> Array:
    """Return linear functions (k, 10) of pi whose extremes are those of the quantities.

    Those of the center of mass are zero where it has the given values; the inertia is about the
    best center of mass. Nothing has only a mass.
    """
    if not best[0]:
        return np.eye(1, 10)
    inertia = transform(np.eye(10), np.eye(3), -best[1:4] / best[0])[:, 4:].T
    found = np.vstack([np.eye(4, 10), inertia])
    found[_CENTER, 0] = -values[_CENTER]
    return found


def is_shown(problem: Problem, theta: Array, errors: FitErrors, level: float) -> bool:
    """Return whether the recordings distinguish a payload from none.

    No payload at all is the tip of the cone of what matter can be; the cost that it has more
    than the best one is, without any, at most distributed as chi-square of ten degrees.
    """
    from scipy.stats import chi2

    moved = problem.A @ problem.base_of(theta)
    size = float(moved @ moved)
    if not size > 0.0:
        return False
    variance = float(moved @ rows_covariance(problem, errors) @ moved) / size
    gain = problem.cost_of(np.zeros(10)) - problem.cost_of(theta)
    return bool(gain > variance * float(chi2.ppf(level, 10)))


def gains_share(estimate: Estimate, errors: FitErrors) -> Array | None:
    """Return the share (10,) of the gains' errors in each variance; None where there are none."""
    if not estimate.problem.errors:
        return None
    best = np.array(estimate.theta)
    functions, posterior = _functions(best, quantities(best)), Posterior(estimate, errors)
    shares = [posterior.share(source, functions) for source in estimate.problem.errors]
    return frozen(np.pad(np.sum(shares, axis=0), (0, 10 - len(functions))))
