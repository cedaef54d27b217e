"""Priors: links near the inertias of the description, and friction of a likely size."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from sdpid._common.arrays import Array, Indices, frozen, is_number, real_array
from sdpid._common.tables import Settings
from sdpid.errors import DataError
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.constraints.condition import Layout
from sdpid.estimation.constraints.equalities import MirrorPair
from sdpid.estimation.prior.alike import Alike, described_pairs, key_of_pairs, pairs_of
from sdpid.estimation.prior.cost_terms import SquaredTerm, pullback_rows
from sdpid.estimation.prior.evidence import STRONGEST, WEAKEST, strength_by_evidence
from sdpid.estimation.prior.friction import friction_rows
from sdpid.estimation.prior.log_det import LogDetTerm
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
        object.__setattr__(self, "alike", pairs_of(self.alike))
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
        if self.strength == "evidence":
            return
        if not (is_number(self.strength) and 0.0 < self.strength < np.inf):
            raise DataError(
                f"Prior: strength is {self.strength!r}; give a positive number of nats, or "
                "'evidence'."
            )

    def _key(self) -> tuple[object, ...]:
        bodies = None if self.bodies is None else (self.bodies.shape, self.bodies.tobytes())
        alike = key_of_pairs(self.alike)
        return self.strength, self.kind, self.friction, bodies, alike, self.within

    def __eq__(self, other: object) -> bool:
        return self._key() == other._key() if isinstance(other, Prior) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._key())


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
    wrong = np.flatnonzero(margins <= 0.0)
    thin = np.flatnonzero((margins > 0.0) & (margins < (1.0 - _ROUNDED) * least))
    raised = raise_second_moments(bodies, least)
    return raised, tuple(int(i) for i in wrong), tuple(int(i) for i in thin)


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
    bodies, known, notes = _bodies(prior, rows.robot)
    theta_size = 10 * rows.robot.n_links + len(rows.friction.parameters)
    R = np.zeros((bodies.size, theta_size))
    for i, block in enumerate(_blocks(prior, bodies, known)):
        own = slice(10 * i, 10 * i + 10)
        R[own, own] = block
    r = R[:, : bodies.size] @ bodies.ravel()
    belief = friction_rows(rows) if prior.friction else np.zeros((0, 0))
    F = np.zeros((len(belief), theta_size))
    F[:, theta_size - len(belief) :] = belief
    layout = Layout(rows.robot, rows.friction)
    alike = tuple(Alike.of(pair, prior.within, bodies, layout) for pair in prior.alike)
    if alike:
        F = np.vstack([F, *(each.rows for each in alike)])
        notes.append(f"prior: {described_pairs(prior.alike, prior.within)}")
    f = np.zeros(len(F))
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
        terms.append(LogDetTerm.around(known, bodies[known], strength, theta_size))
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
    notes = []
    if wrong:
        names = ", ".join(robot.link_names[i] for i in wrong)
        notes.append(f"prior: {names} could not exist as described and were repaired first")
    if thin:
        names = ", ".join(robot.link_names[i] for i in thin)
        notes.append(
            f"prior: thinner than {100.0 * _RADIUS:g} cm (rms about the center of mass) as "
            f"described, and widened to that: {names}"
        )
    unknown = np.setdiff1d(np.arange(robot.n_links), known)
    if unknown.size:
        size = (_BALL * characteristic_length(robot)) ** 2
        ball = np.diag([size, size, size, 1.0]) * float(np.mean(given[known, 0]))
        bodies[unknown] = from_pseudo_inertia(ball)
        names = ", ".join(robot.link_names[i] for i in unknown)
        notes.append(f"prior: next to no information about {names}, which have no mass")
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
