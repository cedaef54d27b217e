"""Priors: links near the inertias of the description, and friction of a likely size."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from sdpid._common.arrays import Array, Indices, frozen, is_number, real_array
from sdpid._common.tables import Settings
from sdpid.errors import DataError
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.constraints.condition import Layout
from sdpid.estimation.constraints.equalities import MirrorPair
from sdpid.estimation.prior.cost_terms import LogDetTerm, SquaredTerm, pullback_rows
from sdpid.estimation.prior.evidence import STRONGEST, WEAKEST, strength_by_evidence
from sdpid.estimation.prior.friction import friction_rows
from sdpid.robot.consistent import raise_second_moments
from sdpid.robot.inertia import from_pseudo_inertia, margin, pseudo_inertia
from sdpid.robot.model.base_parameters import characteristic_length
from sdpid.robot.model.model import RobotModel

PriorKind = Literal["euclidean", "scaled_euclidean", "pullback", "entropic"]

# Second moments about the center of mass of a believed body are at least those of a ball whose
# points are 2 cm from its center (rms, per axis): descriptions have links that are no bodies, and
# some that are points.
_RADIUS = 0.02

# A second moment short of the least by this share is short by rounding: no note names it.
_ROUNDED = 1e-6

# A link that the description gives no mass is believed to be a ball of the mean link's mass, its
# radius of gyration this share of the robot's length; with a standard deviation this many
# times larger than others. Enough to keep it from running off, and next to no information.
_BALL = 0.5
_VAGUE = 10.0

# A strength by evidence this close to an end of the range (relative) is at that end.
_AT_END = 0.02

# More pairs that are alike are not listed by name.
_MOST_NAMES = 4


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Prior(Settings):
    """Belief about the links and the friction before the data.

    Each link is believed to be near a body P0 = L·L^T (pseudo-inertia). Being elsewhere costs
    ``strength·d`` nats, with d by kind:

    * ``"pullback"``: ``½·‖L^(-1)·P·L^(-T) − E‖²``, a quadratic that is the same in every frame;
      the second-order expansion of the next.
    * ``"entropic"``: the log-det divergence ``−log det(P·P0^(-1)) + tr(P0^(-1)·P) − 4``, the same
      in every frame and infinite at the boundary of what can exist, so that estimates stay
      strictly inside [lee2020]_.
    * ``"scaled_euclidean"``: half the squared distance of the ten parameters, each in units of
      the believed body's: its mass, and its rms distance from the joint frame's origin.
    * ``"euclidean"``: the same in SI units. It depends on the frames and on the units, and is
      here for comparison.

    Friction terms are believed to be zero with a standard deviation that moves the effort by its
    rms, whatever the strength. Nats are units of a log-likelihood: they mean what they say with
    ``weighting="residual"``. With ``gls`` and ``gls_per_sample`` and samples without a covariance
    every row is taken to have a variance of one (N·m)², and a note of the problem's prior says so.
    ``eq9`` and ``eq18`` take no prior. See docs/guides/estimation.md.

    Legs that were built alike differ by little: the difference of a link and the mirror image of
    its partner costs ``½·‖L^(-1)·(P_2 − M·P_1·M^T)·L^(-T)‖²/within²`` nats, whatever strength and
    kind, with L·L^T the mean of the two believed bodies.

    Attributes
    ----------
    strength : float or "evidence"
        Factor on the links' penalty, nats. ``"evidence"`` takes the strength, between 0.01 and
        100, that makes the data most probable without constraints; it is for robots that are
        believed much more or much less than usual.
    kind : {"pullback", "entropic", "scaled_euclidean", "euclidean"}
        How far a body is from the believed one.
    friction : bool
        Whether friction terms are believed to be small too.
    bodies : ndarray, shape (links, 10), optional
        The bodies; by default those of the robot's description. A row of zeros is next to no
        belief: an average ball, ten times less certain than others. Bodies that could not exist
        are repaired first, and a note of the problem's prior says so.
    alike : tuple of MirrorPair
        Links that are believed to be nearly mirror images of each other, such as
        ``sdpid.constraints.mirror_pairs(robot)``; among constraints the same say that they are.
    within : float
        Standard deviation of such a difference, as a share of the body: with 0.05 a partner 5 %
        heavier all over is two standard deviations off, one for each axis and one for the mass.

    Examples
    --------
    >>> bodies = estimate.theta[: 10 * robot.n_links].reshape(-1, 10)  # of an earlier run
    >>> prior = sdpid.Prior(strength=2.0, bodies=bodies)
    >>> believed = sdpid.build_problem(robot, samples, prior=prior)
    >>> sdpid.solve_sdp(believed).status
    'optimal'

    Left and right legs that differ by some five per cent:

    >>> floating = sdpid.load_robot("solo12", root="free_flyer")
    >>> prior = sdpid.Prior(alike=sdpid.constraints.mirror_pairs(floating), within=0.05)
    """

    strength: float | Literal["evidence"] = 1.0
    kind: PriorKind = "pullback"
    friction: bool = True
    bodies: Array | None = None
    alike: tuple[MirrorPair, ...] = ()
    within: float = 0.05

    def __post_init__(self) -> None:
        object.__setattr__(self, "alike", _pairs(self.alike))
        if not (is_number(self.within) and 0.0 < self.within < np.inf):
            raise DataError(
                f"Prior: within is {self.within!r}; give a positive share. Links that are mirror "
                "images exactly go among the constraints: Constraints(others=...)."
            )
        if self.bodies is not None:
            bodies = frozen(real_array(self.bodies, "Prior: bodies", ndim=2))
            if bodies.shape[1] != 10:
                raise DataError(
                    f"Prior: bodies have shape {bodies.shape}; give (links, 10), one row a link in "
                    "the order of the robot's links."
                )
            object.__setattr__(self, "bodies", bodies)
        if self.kind not in get_args(PriorKind):
            raise DataError(f"Prior: kind is {self.kind!r}: use one of {get_args(PriorKind)}.")
        given = is_number(self.strength) and 0.0 < self.strength < np.inf
        if self.strength != "evidence" and not given:
            raise DataError(
                f"Prior: strength is {self.strength!r}; give a positive number of nats, or "
                "'evidence'."
            )

    def _key(self) -> tuple[object, ...]:
        bodies = None if self.bodies is None else (self.bodies.shape, self.bodies.tobytes())
        alike = [_keys(pair)[0] for pair in self.alike]
        return self.strength, self.kind, self.friction, bodies, *alike, self.within

    def __eq__(self, other: object) -> bool:
        return self._key() == other._key() if isinstance(other, Prior) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._key())


def _pairs(given: object) -> tuple[MirrorPair, ...]:
    """Return the pairs that are given, several or one; refuse anything else, and pairs twice."""
    pairs = (given,) if isinstance(given, MirrorPair) or not isinstance(given, Iterable) else given
    found: list[MirrorPair] = []
    for each in pairs:
        if not isinstance(each, MirrorPair):
            raise DataError(
                f"Prior: alike holds {each!r:.80}; give MirrorPair objects, such as "
                "sdpid.constraints.mirror_pairs(robot)."
            )
        if any(_keys(each)[0] in _keys(other) for other in found):
            raise DataError(
                f"Prior: alike holds '{each.first}' and '{each.second}' twice; give each pair once."
            )
        found.append(each)
    return tuple(found)


def _keys(pair: MirrorPair) -> list[str]:
    """Return what is equal for pairs that say the same, and that of the pair turned round.

    Of a plane's mirror either link may come first.
    """
    turned = pair if pair.normal is None else replace(pair, first=pair.second, second=pair.first)
    said = (vars(each).values() for each in (pair, turned))
    return [repr([x if x is None else np.asarray(x).tolist() for x in each]) for each in said]


@dataclass(frozen=True, eq=False)
class Alike:
    """A link that is believed to be nearly the mirror image of another, in numbers.

    Attributes
    ----------
    first, second : int
        The links.
    rows : ndarray, shape (10, p)
        Their squared norm is ``‖L^(-1)·(P_2 − M·P_1·M^T)·L^(-T)‖²/within²``, twice the nats: M maps
        the first link's joint frame to the second's, L·L^T is the mean believed pseudo-inertia
        there, within the standard deviation of the difference, as a share of the body.
    """

    first: int
    second: int
    rows: Array

    @classmethod
    def of(cls, pair: MirrorPair, within: float, bodies: Array, layout: Layout) -> Alike:
        """Return the belief in a pair.

        Parameters
        ----------
        pair : MirrorPair
            The links.
        within : float
            Standard deviation of a difference.
        bodies : ndarray, shape (links, 10)
            The believed bodies.
        layout : Layout
            Where parameters are in theta.

        Raises
        ------
        ModelError
            When the robot has no such link.
        """
        difference = np.stack([row.coefficients for row in pair.compile(layout)])
        two = layout.link(pair.second)
        theta = np.zeros(layout.count)
        theta[: bodies.size] = bodies.ravel()
        # The image of the first is the second less the difference: their mean is a body, too.
        mean = pseudo_inertia(bodies[two] - 0.5 * (difference @ theta))
        rows = frozen(pullback_rows(mean) / within @ difference)
        return cls(first=layout.link(pair.first), second=two, rows=rows)


@dataclass(frozen=True, eq=False)
class PriorTerms:
    """A prior as terms of a problem's cost, twice its nats.

    Attributes
    ----------
    terms : tuple of SquaredTerm and LogDetTerm
        One `SquaredTerm`, and with kind ``"entropic"`` a `LogDetTerm` of the described links.
    notes : tuple of str
        What was repaired, left out or chosen.
    strength : float
        The links' strength, nats.
    source : Prior or None
        What they were made of.
    alike : tuple of Alike
        Links that are believed to be nearly mirror images: the last ten rows each of the
        `SquaredTerm`.
    """

    terms: tuple[SquaredTerm | LogDetTerm, ...]
    notes: tuple[str, ...]
    strength: float
    source: Prior | None = None
    alike: tuple[Alike, ...] = ()


def repaired(bodies: Array) -> tuple[Array, tuple[int, ...], tuple[int, ...]]:
    """Return bodies with their second moments raised to the least.

    Links without a positive mass are returned as they are.

    Returns
    -------
    ndarray, shape (links, 10)
    tuple of int
        Links that could not exist.
    tuple of int
        Other links that were thinner than the least.
    """
    least = bodies[:, 0] * _RADIUS**2
    margins = margin(bodies, "pseudo_inertia")
    # Links without a positive mass have no margin: NaN, which is neither.
    wrong, thin = margins <= 0.0, (margins > 0.0) & (margins < (1.0 - _ROUNDED) * least)
    raised = raise_second_moments(bodies, least)
    return raised, tuple(np.flatnonzero(wrong).tolist()), tuple(np.flatnonzero(thin).tolist())


def prior_terms(
    prior: Prior, rows: RowSource, *, data: tuple[Array, Array] | None = None
) -> PriorTerms:
    """Turn a prior into terms of a problem's cost.

    Parameters
    ----------
    prior : Prior
        The belief.
    rows : RowSource
        The robot, its friction terms and the samples, whose sizes scale the friction's belief.
    data : tuple of ndarray, optional
        A (b, b) and rhs (b,), the compressed rows of the base parameters, whitened so that their
        cost is twice a negative log-likelihood; needed for a strength by evidence only.

    Raises
    ------
    DataError
        When no link has a body, or a strength by evidence has no data.
    """
    from scipy.linalg import block_diag

    bodies, known, notes = _bodies(prior, rows.robot)
    count = len(rows.friction.parameters)
    R = np.hstack([block_diag(*_blocks(prior, bodies, known)), np.zeros((bodies.size, count))])
    r = R[:, : bodies.size] @ bodies.ravel()
    layout = Layout(rows.robot, rows.friction)
    alike = tuple(Alike.of(pair, prior.within, bodies, layout) for pair in prior.alike)
    belief = friction_rows(rows) if prior.friction else np.zeros((0, count))
    F = np.hstack([np.zeros((len(belief), bodies.size)), belief])
    F = np.vstack([F, *(each.rows for each in alike)])
    f = np.zeros(len(F))
    if alike:
        notes.append(f"prior: {described_pairs(prior.alike, prior.within)}")
    if prior.strength == "evidence":
        if data is None:
            raise DataError(
                "Prior: a strength by evidence needs a likelihood of the data; use "
                "weighting='residual', or 'gls' with samples that have a covariance."
            )
        strength = strength_by_evidence((data[0] @ rows.base.matrix, data[1]), (R, r), (F, f))
        notes.append(f"prior: strength {strength:.2g} nats by evidence{_at_end(strength)}")
    else:
        strength = float(prior.strength)
    terms: list[LogDetTerm] = []
    if prior.kind == "entropic":
        terms.append(LogDetTerm.around(known, bodies[known], strength, R.shape[1]))
        vague = np.repeat(~np.isin(np.arange(len(bodies)), known), 10)
        R, r = R[vague], r[vague]
    root = np.sqrt(strength)
    squared = SquaredTerm(frozen(np.vstack([root * R, F])), frozen(np.concatenate([root * r, f])))
    return PriorTerms((squared, *terms), tuple(notes), strength, prior, alike)


def link_rows(prior: Prior, robot: RobotModel) -> Array:
    """Return the rows (links, 10, 10) whose squared norm is twice the nats of each link.

    Of a strength by evidence those of one nat.

    Raises
    ------
    DataError
        When no link has a body.
    """
    strength = 1.0 if prior.strength == "evidence" else float(prior.strength)
    bodies, known, _ = _bodies(prior, robot)
    return np.asarray(np.sqrt(strength) * _blocks(prior, bodies, known))


def _blocks(prior: Prior, bodies: Array, known: Indices) -> Array:
    """Return the same (links, 10, 10) at a strength of one nat."""
    vague = np.where(np.isin(np.arange(len(bodies)), known), 1.0, _VAGUE)
    return np.stack([_block(prior.kind, b) / v for b, v in zip(bodies, vague, strict=True)])


def _bodies(prior: Prior, robot: RobotModel) -> tuple[Array, Indices, list[str]]:
    """Return bodies that can exist, the links that are described, and what was done to them."""
    given = robot.prior if prior.bodies is None else prior.bodies
    if given.shape != (robot.n_links, 10):
        raise DataError(f"Prior: bodies have shape {given.shape}, expected {(robot.n_links, 10)}.")
    bodies, wrong, thin = repaired(given)
    known = np.flatnonzero(given[:, 0] > 0.0)
    if known.size == 0:
        raise DataError(
            f"Prior: the description of '{robot.name}' gives no link a mass; give bodies, or no "
            "prior."
        )

    def named(links: Iterable[int]) -> str:
        return ", ".join(robot.link_names[i] for i in links)

    notes = []
    if wrong:
        notes.append(f"prior: {named(wrong)} could not exist as described and were repaired first")
    if thin:
        notes.append(
            f"prior: thinner than {100.0 * _RADIUS:g} cm (rms about the center of mass) as "
            f"described, and widened to that: {named(thin)}"
        )
    unknown = np.setdiff1d(np.arange(robot.n_links), known)
    if unknown.size:
        size = (_BALL * characteristic_length(robot)) ** 2
        ball = np.diag([size, size, size, 1.0]) * float(np.mean(given[known, 0]))
        bodies[unknown] = from_pseudo_inertia(ball)
        notes.append(f"prior: next to no information about {named(unknown)}, which have no mass")
    return bodies, known, notes


def _block(kind: PriorKind, body: Array) -> Array:
    """Return the rows (10, 10) whose squared norm is twice the nats of one link at strength 1."""
    if kind == "euclidean":
        return np.eye(10)
    P = pseudo_inertia(body)
    if kind == "scaled_euclidean":
        length = float(np.sqrt(np.trace(P[:3, :3]) / body[0]))
        return np.diag(1.0 / (body[0] * np.array([1.0, *(length,) * 3, *(length**2,) * 6])))
    return pullback_rows(P)


def _at_end(strength: float) -> str:
    """Return a remark when a strength is at an end of the range that was searched."""
    if strength < WEAKEST * (1.0 + _AT_END):
        return " (the least that is tried: the data do not bear the description out)"
    if strength > STRONGEST * (1.0 - _AT_END):
        return " (the most that is tried)"
    return ""


def described_pairs(pairs: Sequence[MirrorPair], within: float) -> str:
    """Return the belief in words."""
    named = [f"{pair.first} and {pair.second}" for pair in pairs[:_MOST_NAMES]]
    rest = len(pairs) - len(named)
    listed = ", ".join(named) + (f" and {rest} more pairs" if rest else "")
    return f"mirror images of each other within {100.0 * within:g} %: {listed}"
