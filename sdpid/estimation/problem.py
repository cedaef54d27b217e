"""The estimation problem: one cost, one feasible set, for every solver."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen
from sdpid._common.files import printable
from sdpid._common.tables import Shown
from sdpid._common.threads import one_thread
from sdpid.errors import DataError
from sdpid.estimation.compression.covariance import PRINTED, WEIGHTINGS, Weighting, pooled
from sdpid.estimation.compression.factor import Factor
from sdpid.estimation.compression.rows import RowSource, SamplesElsewhere
from sdpid.estimation.compression.whitening import with_contact_forces
from sdpid.estimation.constraints.condition import Layout
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.constraints.feasible_set import FeasibleSet
from sdpid.estimation.effects.choose import Profiled, close_terms
from sdpid.estimation.effects.kinds import Tried
from sdpid.estimation.error_source import ErrorSource
from sdpid.estimation.information import Excitation, require_excitation
from sdpid.estimation.prior.cost_terms import LogDetTerm, SquaredTerm
from sdpid.estimation.prior.friction import with_friction_max
from sdpid.estimation.prior.prior import Prior, PriorTerms, prior_terms
from sdpid.experiment.preparation.prepare import Piece, as_pieces, samples_of
from sdpid.experiment.processing.robot_contacts import require_places
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.simulation.controllers import PD
from sdpid.experiment.simulation.law import USUAL_DELAY, under_law
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.inertia import CONSISTENCIES, Consistency
from sdpid.robot.model.base_parameters import BaseParameters, structural_base
from sdpid.robot.model.model import RobotModel


@dataclass(frozen=True, kw_only=True)
class Origin:
    """What a problem was made by, and what its cost is.

    Attributes
    ----------
    weighting : str
        How residuals are weighted (see `build_problem`).
    profiled : tuple of Profiled
        Numbers of friction terms that were chosen by the data (see
        `sdpid.estimation.effects.choose`).
    effects : tuple of Tried
        Effects that were chosen by the data, and those that were tried and left out (see
        `sdpid.estimation.selection.choose`).
    meaning : str or None
        What the cost is where it is not that of the measured motion's own rows, such as the last
        one that an iteration solved; None where it is.
    constant : float
        Part of the problem's `floor` that is of no row: what a robust loss adds to the weighted
        rows.
    """

    weighting: Weighting
    profiled: tuple[Profiled, ...] = ()
    effects: tuple[Tried, ...] = ()
    meaning: str | None = None
    constant: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Problem(Shown):
    """Weighted least squares over the physically possible parameters.

    The cost of base parameters is ``‖A @ base − rhs‖² + floor``, for every weighting. It is
    the weighted residual of all rows, compressed once. A prior adds its own terms, functions of
    theta. The whole cost is `squared` plus `log_det`.

    Attributes
    ----------
    robot : RobotModel
        The robot.
    friction : FrictionModel
        Friction and drive terms.
    base : BaseParameters
        Names, units and the matrix B.
    sigma : ndarray, shape (n, n) or (K, n, n)
        The covariance that was used; without rows its mean over the samples.
    A : ndarray, shape (b, b)
        Compressed regressor of the base parameters.
    rhs : ndarray, shape (b,)
        Compressed efforts.
    floor : float
        Cost that no parameters can take away.
    n_samples, n_rows : int
        Samples, and their rows that are not masked; independent ones where contacts tie rows
        together.
    feasible : FeasibleSet
        The constraints.
    prior : PriorTerms or None
        The prior, as further terms of the cost.
    rows : RowSource or None
        The rows that the cost is made of, here or on a cluster; None where they were not kept.
        Solvers do not need them, standard errors and residuals do.
    origin : Origin
        Weighting, what the data chose, and what the cost is.
    errors : tuple of ErrorSource
        By what the unconstrained fit is thought to be off beside its noise: none where nobody
        looked (see `sdpid.estimation.motion_noise`).

    Examples
    --------
    >>> problem.n_samples, problem.n_rows, problem.n_theta, problem.base.count
    (1000, 5222, 72, 48)
    >>> problem.A.shape, problem.predict(estimate.base).shape
    ((48, 48), (1000, 6))
    >>> bool(np.isclose(problem.cost_of(estimate.theta), estimate.cost))
    True
    >>> spatial = problem.constrained(consistency="spatial_inertia")
    >>> bool(sdpid.solve_sdp(spatial).cost <= estimate.cost * (1.0 + 1e-6))
    True
    """

    robot: RobotModel
    friction: FrictionModel
    base: BaseParameters
    sigma: Array
    A: Array
    rhs: Array
    floor: float
    n_samples: int
    n_rows: int
    feasible: FeasibleSet
    prior: PriorTerms | None = None
    rows: RowSource | None = None
    origin: Origin
    errors: tuple[ErrorSource, ...] = ()

    def _shown(self) -> dict[str, object]:
        terms = ", ".join(str(each["term"]) for each in self.friction.described())
        facts: dict[str, object] = {
            "robot": self.robot.name,
            "samples": self.n_samples,
            "rows": self.n_rows,
            "base parameters": self.base.count,
            "standard parameters": self.n_theta,
            "friction terms": terms or "none",
            "weighting": self.weighting,
            "consistency": self.consistency,
            "prior": "no" if self.prior is None else "yes",
            "condition number": self.excitation.condition_number,
        }
        if self.origin.meaning is not None:
            facts["cost"] = self.origin.meaning
        return facts

    @property
    def weighting(self) -> Weighting:
        """How residuals are weighted (see `build_problem`)."""
        return self.origin.weighting

    @property
    def consistency(self) -> Consistency:
        """The consistency that constrained estimates obey."""
        return self.feasible.consistency

    @property
    def constraints(self) -> Constraints:
        """The constraints' numbers."""
        return self.feasible.constraints

    @property
    def n_theta(self) -> int:
        """Number of standard parameters, friction included."""
        return len(self.base.theta_names)

    @cached_property
    def excitation(self) -> Excitation:
        """Which base parameters the data show, and how well."""
        return Excitation.of(self.A, self.base.names)

    @cached_property
    def squared(self) -> SquaredTerm:
        """The squared part of the cost: the data's rows, then a prior's; its constant the floor."""
        data = SquaredTerm(
            frozen(self.A @ self.base.matrix), self.rhs, self.floor, (self.A, self.base.matrix)
        )
        terms = () if self.prior is None else self.prior.terms
        return SquaredTerm.stacked(data, [t for t in terms if isinstance(t, SquaredTerm)])

    @cached_property
    def log_det(self) -> LogDetTerm:
        """The log-det part of the cost; over no links where the prior has none."""
        terms = () if self.prior is None else self.prior.terms
        found = [term for term in terms if isinstance(term, LogDetTerm)]
        return found[0] if found else LogDetTerm.none(self.n_theta)

    def cost(self, base: ArrayLike) -> float:
        """Return the cost of base parameters (b,), without the prior's."""
        residual = self.A @ np.asarray(base, dtype=np.float64) - self.rhs
        return float(residual @ residual) + self.floor

    def base_of(self, theta: ArrayLike) -> Array:
        """Return the base parameters of standard ones."""
        return np.asarray(self.base.matrix @ np.asarray(theta, dtype=np.float64))

    def cost_of(self, theta: ArrayLike) -> float:
        """Return the cost of standard parameters (p,), the prior's included."""
        return self.squared.value(theta) + self.log_det.value(theta)

    def gradient(self, theta: ArrayLike) -> Array:
        """Return the derivative of `cost_of`, shape (p,).

        Raises
        ------
        DataError
            Where the cost is infinite.
        """
        return self.squared.gradient(theta) + self.log_det.gradient(theta)

    def with_origin(self, **changes: Any) -> Problem:
        """Return the same problem with other fields of its `origin`."""
        return replace(self, origin=replace(self.origin, **changes))

    @property
    def samples(self) -> Samples:
        """The samples that are here: all, or of rows on a cluster a thinned selection.

        Raises
        ------
        DataError
            When the problem has no rows.
        """
        return self.require_rows("samples").samples

    def require_rows(self, purpose: str) -> RowSource:
        """Return the rows, or raise.

        Parameters
        ----------
        purpose : str
            What they are needed for, for the message.

        Raises
        ------
        DataError
            When the problem has none.
        """
        if self.rows is None:
            raise DataError(
                f"{purpose}: the rows of the {self.n_samples} samples of '{self.robot.name}' were "
                "not kept with this problem; build a problem of a recording (sdpid.build_problem)."
            )
        return self.rows

    def require_rows_here(self, purpose: str) -> RowSource:
        """Return the rows, or raise where they are elsewhere; as `require_rows`."""
        rows = self.require_rows(purpose)
        if rows.elsewhere is not None:
            raise DataError(
                f"{purpose}: needs every row here, and they are on the workers of a cluster; build "
                "the problem of samples or files."
            )
        return rows

    def require_plain(self, purpose: str) -> None:
        """Raise where the cost is not the sum of squares of the measured motion's own rows.

        Raises
        ------
        DataError
            Where it is of normal equations, of weights that a robust loss chose, or of rows that
            instruments or an iteration made.
        """
        if self.weighting in PRINTED:
            raise DataError(
                f"{purpose}: the cost of weighting {self.weighting!r} is that of normal equations, "
                "no sum over rows; build the problem with 'residual', 'gls' or 'gls_per_sample'."
            )
        if self.origin.meaning is not None or self.origin.constant:
            raise DataError(
                f"{purpose}: the problem is not that of the measured samples "
                f"({self.origin.meaning or 'its rows are weighted by a robust loss'}); give the "
                "one that was built of the recording."
            )

    def without_rows(self) -> Problem:
        """Return the same cost and constraints without the rows: what solvers need, to send."""
        return replace(self, rows=None, sigma=frozen(pooled(self.sigma)))

    def predict(self, base: ArrayLike, samples: Samples | None = None) -> Array:
        """Return the efforts (K, n) that base parameters give on samples, by default its own.

        Where samples have contacts, together with those contact forces, measured or not, that
        leave the least weighted error (see `Samples.judged`).
        """
        values = np.asarray(base, dtype=np.float64)
        chosen = self.samples if samples is None else samples
        rows, sigma = self.rows_of(chosen), pooled(self.sigma)
        found = [
            with_contact_forces(rows, part, sigma, W @ values) for part, W, _, _ in rows.chunks()
        ]
        return np.concatenate(found)

    def rows_of(self, samples: Samples) -> RowSource:
        """Return the rows of other samples, on which this problem's parameters are judged."""
        scale = 1.0 if self.rows is None else self.rows.force_scale
        rows = RowSource(self.robot, self.friction, self.base, samples.judged)
        return rows.with_force_scale(scale)

    @property
    def score_exponent(self) -> float:
        """Exponent e of Sigma in the estimating equations ``W^T Sigma^e (Y − W base) = 0``."""
        return -0.5 if self.weighting == "eq9" else -1.0

    def constrained(
        self,
        *,
        consistency: Consistency | None = None,
        constraints: Constraints | None = None,
    ) -> Problem:
        """Return the same cost under other constraints; nothing is compressed again."""
        if consistency is not None and consistency not in CONSISTENCIES:
            raise DataError(f"consistency is {consistency!r}: use one of {CONSISTENCIES}.")
        if constraints is not None and constraints.friction_max is None:
            known = self.constraints.friction_max or 0.0
            constraints = constraints.replace(friction_max=max(known, constraints.theta_max))
        feasible = FeasibleSet.build(
            constraints or self.constraints,
            consistency or self.consistency,
            Layout(self.robot, self.friction),
        )
        return replace(self, feasible=feasible)


@one_thread
def build_problem(
    robot: RobotModel,
    samples: Piece | Sequence[Piece] | SamplesElsewhere,
    *,
    friction: Iterable[str | FrictionTerm] = ("coulomb", "viscous"),
    weighting: Weighting = "gls",
    consistency: Consistency = "pseudo_inertia",
    constraints: Constraints | None = None,
    prior: Prior | None = None,
    base: BaseParameters | None = None,
    processing: Processing | None = None,
    check_excitation: bool = True,
    law: PD | None = None,
) -> Problem:
    """Build the problem of estimating a robot's parameters from samples.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    samples : Samples, Recording or path, or a sequence of these
        The measurements, n as the robot's; those of several recordings are joined. Recordings and
        files are processed first (see `processing`). Or samples on the workers of a cluster
        (``DistributedSamples``), with the same result; see docs/guides/fleet.md.
    friction : iterable of str or FrictionTerm
        Terms beside the links' inertia; docs/guides/friction.md lists them. Numbers of theirs
        that are None are chosen by the data.
    weighting : {"gls", "gls_per_sample", "eq9", "eq18", "residual"}
        ``gls`` whitens with one covariance pooled over the samples; ``gls_per_sample`` with the
        covariance of each; ``eq9`` and ``eq18`` minimize the norm of the normal equations'
        residual with Sigma^(-1/2) and Sigma^(-1), as printed in the paper; ``residual``
        estimates a variance for each joint from the residuals of the fit.
    consistency : {"pseudo_inertia", "spatial_inertia", "none"}
        What constrained solvers demand of every link: the 4×4 inequality, the weaker 6×6 one of
        the paper, or nothing.
    constraints : Constraints, optional
        Margins and bounds.
    prior : Prior, optional
        Prior knowledge beside the data; none by default. With one the data may leave base
        parameters undetermined.
    base : BaseParameters, optional
        Base parameters found before for the same robot and terms, to save time.
    processing : Processing, optional
        Processing of recordings and files among `samples`; by default one for all, that of the
        recording with the median cut-off.
    check_excitation : bool, optional
        Whether data that leave a base parameter undetermined are refused where there is no prior.
    law : sdpid.controllers.PD, optional
        The law that made the efforts of commanded positions in recordings and files, in which none
        were measured; its delay is 4 ms where it is None, which the samples' notes say.

    Returns
    -------
    Problem
        What solvers take.

    Raises
    ------
    DataError
        When shapes, names or options do not fit.
    IdentifiabilityError
        When the data leave a base parameter undetermined.

    Examples
    --------
    >>> problem = sdpid.build_problem(robot, samples, friction=("coulomb", "viscous", "offset"))
    >>> problem.n_samples, problem.n_theta, problem.base.count
    (1000, 78, 54)
    >>> problem.base.names[:4]
    ('zzr1', 'Fs1', 'Fv1', 'Fo1')
    >>> problem.base.expression("xxr2")
    'xx_2 - yy_2 - 0.0441*m_3 - 0.0441*m_4 - 0.0441*m_5 - 0.0441*m_6'
    """
    if weighting not in WEIGHTINGS:
        raise DataError(f"weighting is {weighting!r}: use one of {', '.join(WEIGHTINGS)}.")
    if consistency not in CONSISTENCIES:
        raise DataError(f"consistency is {consistency!r}: use one of {', '.join(CONSISTENCIES)}.")
    if prior is not None and weighting in PRINTED:
        raise DataError(
            f"prior: the cost of weighting {weighting!r} is no likelihood, so a strength in nats "
            "has no meaning beside it; use 'residual', 'gls' or 'gls_per_sample', or no prior."
        )
    if not isinstance(robot, RobotModel):
        raise DataError(
            f"build_problem: robot is {type(robot).__name__} {robot!r:.80}; give a RobotModel, "
            "such as sdpid.load_robot(name)."
        )
    elsewhere = samples if isinstance(samples, SamplesElsewhere) else None
    if law is not None:
        samples, note = _under_law(robot, samples, law)
    here = elsewhere.samples if elsewhere else samples_of(robot, samples, processing)
    if law is not None:
        here = replace(here, notes=(*here.notes, note))
    check_samples(robot, here)
    if here.contacts is not None and weighting in PRINTED:
        raise DataError(
            f"weighting: {weighting!r} takes powers of covariances, and samples with contacts have "
            "directions without one; use 'residual', 'gls' or 'gls_per_sample'."
        )
    model = FrictionModel.from_terms(friction, robot.joint_names, first=robot.n_base)
    model, profiled = close_terms(model, robot, here, lambda rows: Factor.of(rows, weighting).sigma)
    if base is None:
        base = structural_base(robot, model)
    rows = RowSource(robot, model, base, here, elsewhere=elsewhere)
    found = Factor.of(rows, weighting)
    if found.force_scale != 1.0:
        rows = rows.with_force_scale(found.force_scale)
    A, rhs = found.A, found.rhs
    known = weighting in ("gls", "gls_per_sample") and here.covariance is not None
    likelihood = (A, rhs) if weighting == "residual" or known else None
    terms = None
    if prior is not None:
        terms = prior_terms(prior, rows, data=likelihood)
        if likelihood is None:
            note = "prior: the samples have no covariance, so errors count in units of 1 N.m"
            terms = replace(terms, notes=(*terms.notes, note))
    bounds = with_friction_max(constraints or Constraints(), rows)
    problem = Problem(
        robot=robot,
        friction=model,
        base=base,
        sigma=frozen(found.sigma),
        A=frozen(A),
        rhs=frozen(rhs),
        floor=found.floor,
        n_samples=rows.n_samples,
        n_rows=found.used,
        feasible=FeasibleSet.build(bounds, consistency, Layout(robot, model)),
        prior=terms,
        rows=rows,
        origin=Origin(weighting=weighting, profiled=profiled),
    )
    if prior is None and check_excitation:
        require_excitation(problem.excitation)
    return problem


def _under_law(robot: RobotModel, given: Any, law: PD) -> tuple[tuple[Recording, ...], str]:
    """Return recordings with the efforts of a law, and a note that says so."""
    if isinstance(given, SamplesElsewhere) or any(isinstance(x, Samples) for x in as_pieces(given)):
        raise DataError(
            "law: turns commands of recordings into efforts, and samples hold none; give the "
            "recordings, or leave the law out where the samples have efforts."
        )
    known, logs = under_law(robot, given, law, "build_problem", USUAL_DELAY)
    usual = ", the usual delay as none is given" if law.delay is None else ""
    after = 1e3 * float(known.delay or 0.0)
    return logs, f"efforts are those of the law, {after:.3g} ms after commands{usual}"


def check_samples(robot: RobotModel, samples: Samples) -> None:
    """Refuse samples of other joints than a robot's, or of contacts that it lacks."""
    n = samples.effort.shape[1]
    if n != robot.n:
        raise DataError(
            f"samples have {n} joints, the robot '{robot.name}' has {robot.n}: "
            f"{', '.join(robot.joint_names)}."
        )
    if samples.contacts is not None:
        require_places(robot, samples.position, samples.contacts)
    # Samples' names are without what a terminal would obey.
    names = tuple(map(printable, robot.joint_names))
    if samples.joint_names is not None and tuple(map(printable, samples.joint_names)) != names:
        raise DataError(
            f"samples name the joints {', '.join(samples.joint_names)}, the robot has "
            f"{', '.join(names)}; rename or reorder the columns."
        )


def describe(problem: Problem) -> dict[str, Any]:
    """Return the problem's sizes and choices as plain values."""
    gains = None if problem.rows is None else problem.rows.samples.gains
    return {
        "robot": problem.robot.name,
        "joints": list(problem.robot.joint_names),
        "gains": None if gains is None else gains.to_dict(),
        "samples": problem.n_samples,
        "rows_used": problem.n_rows,
        "standard_parameters": problem.n_theta,
        "base_parameters": problem.base.count,
        "weighting": problem.weighting,
        "consistency": problem.consistency,
        "margin": problem.constraints.margin,
        "prior": problem.prior is not None,
        "friction_terms": problem.friction.described(),
        "profiled": [asdict(each) for each in problem.origin.profiled],
        "effects": [asdict(each) for each in problem.origin.effects],
        "cost_of": problem.origin.meaning,
        "condition_number": problem.excitation.condition_number,
    }
