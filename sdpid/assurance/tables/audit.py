"""Audit published base parameters: decide whether links that can exist have them."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from decimal import Decimal
from fractions import Fraction
from operator import add
from typing import Any, Literal

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid._common.tables import Shown
from sdpid._common.threads import one_thread
from sdpid.assurance.tables.answers import (
    Number,
    StoredRealization,
    StoredRefutation,
    TableFile,
    exact,
    realization,
)
from sdpid.assurance.tables.coefficients import (
    coefficients,
    named_terms,
    regrouping,
    require_posed,
)
from sdpid.assurance.tables.search import FoundBodies, ScaledQuestion
from sdpid.errors import DataError
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.inertia import Consistency
from sdpid.robot.inertia import margin as margin_of
from sdpid.robot.model.base_parameters import BaseParameters, characteristic_length
from sdpid.robot.model.model import RobotModel
from sdpid.verifier import tables
from sdpid.verifier.decimals import decimal_text
from sdpid.verifier.realizable import Question

# Beside halfwidths next to zero a change may have more units than a double holds.
_LARGEST = Fraction(sys.float_info.max)

Verdict = Literal["realisable", "not realisable", "undecided"]

# Changes below this, in units of the halfwidths, are a solver's rounding.
_NO_CHANGE = 1e-4

# Digits of the weights of proofs that people can read.
_FEW_DIGITS = 6

# A margin this little below the one that is asked for, kg·m², may be the solver's rounding.
_NEAR = 1e-6

# By what share the smallest change is exceeded, for the changed table to have a witness.
_BEYOND = (1e-4, 1e-3, 1e-2, 1e-1)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class BaseAudit(Shown):
    """Result of the audit of a table of base parameters.

    Attributes
    ----------
    robot : str
        Name of the robot.
    question : Question
        The table and the constraints, in exact numbers.
    verdict : {"realisable", "not realisable", "undecided"}
        The answer; the first two are proven in exact arithmetic.
    margin : float or None
        Largest margin that was found (kg·m²; negative: by how much the least consistent link
        falls short). None where not even that can be had, such as with a negative friction.
    margin_bound : float or None
        No links whatever have a larger margin than this, proven under the bound on masses; None
        where no bound was found.
    certificate : StoredRealization, StoredRefutation or None
        The proof, which `to_json` writes for ``sdpid verify``: links that can exist and have the
        base parameters, or an inequality that says that there are none.
        None when undecided.
    change : float or None
        By what factor, less one, all halfwidths must grow for a witness: a witness was found
        there. 0 when realisable.
    change_bound : float or None
        Less than this is proven not to do, within the bounds on masses and on theta.
    changes : dict
        The smallest change of the table in sum: what is to be added to an entry beyond its
        halfwidth.
    units : dict
        The entries' units in which changes count: halfwidths where there are any.

    Examples
    --------
    >>> audit = sdpid.audit_base_parameters(robot, {"zzr1": "-0.10"}, "0.01")
    >>> audit.verdict, audit.holds(), audit.witness
    ('not realisable', True, None)
    >>> {name: round(change, 2) for name, change in audit.changes.items()}
    {'zzr1': 0.09}
    """

    robot: str
    question: Question
    verdict: Verdict
    margin: float | None
    margin_bound: float | None
    certificate: StoredRealization | StoredRefutation | None = None
    change: float | None = None
    change_bound: float | None = None
    changes: Mapping[str, float]
    units: Mapping[str, float]

    _facts = (
        "robot",
        "verdict",
        "margin, kg·m²",
        "margin_bound, kg·m²",
        "refutation.inequality",
        "change",
    )

    @property
    def refutation(self) -> StoredRefutation | None:
        """The proof that no links have the table; None unless *not realisable*."""
        return self.certificate if isinstance(self.certificate, StoredRefutation) else None

    @property
    def exact_witness(self) -> tuple[Fraction, ...] | None:
        """Standard parameters of links that can exist and have the table; None without."""
        return self.certificate.theta if isinstance(self.certificate, StoredRealization) else None

    @property
    def witness(self) -> Array | None:
        """The witness in floating point, shape (p,); None where there is none."""
        found = self.exact_witness
        return None if found is None else frozen([float(x) for x in found])

    def holds(self) -> bool:
        """Check the proof anew, in exact arithmetic; False when undecided."""
        return self.certificate is not None and self.certificate.holds

    @property
    def needs_mass_bound(self) -> bool | None:
        """Whether the refutation that was found needs the bound on masses; None without one."""
        return None if self.refutation is None else self.refutation.uses_mass_bound

    @property
    def needs_theta_max(self) -> bool | None:
        """Whether the refutation that was found needs `theta_max`; None without one."""
        return None if self.refutation is None else self.refutation.uses_theta_max

    @property
    def blamed(self) -> tuple[str, ...]:
        """Entries that the smallest change in sum touches, the most changed first."""
        share = {name: abs(x) / self.units[name] for name, x in self.changes.items()}
        return tuple(sorted(share, key=lambda name: -share[name]))

    def summary(self) -> str:
        """Return the findings in words."""
        q, proof = self.question, self.refutation
        what = "second-moment margin" if q.consistency == "pseudo_inertia" else "margin of I_g"
        least, light, heavy, most = (decimal_text(getattr(q, name)) for name in tables.LIMITS)
        lines = [
            f"{self.robot}: {self.verdict} ({len(q.names)} parameters; {q.consistency}, {what} "
            f"at least {least} kg.m2, masses {light} to {heavy} kg, theta_max {most})"
        ]
        if self.margin is not None:
            lines.append(f"largest margin found: {self.margin:.4g} kg.m2")
        if self.margin_bound is not None:
            lines.append(f"no links have a margin above {self.margin_bound:.4g} kg.m2 (proven)")
        if proof is not None:
            needs = ["the bound on masses"] if proof.uses_mass_bound else []
            needs += ["theta_max"] if proof.uses_theta_max else []
            lines.append(f"proof: {proof.inequality()}")
            lines.append(f"  needs {' and '.join(needs) or 'no bound on the masses'}")
        if self.change is not None and self.verdict != "realisable":
            bound = self.change_bound
            proven = "" if bound is None else f" (proven: at least {bound:.4g})"
            lines.append(
                f"realisable once every entry may move by {self.change:.4g} halfwidths beyond "
                f"its own{proven}"
            )
        if self.changes:
            moved = ", ".join(
                f"{name} by {self.changes[name]:+.4g} "
                f"({abs(self.changes[name]) / self.units[name]:.3g} halfwidths)"
                for name in self.blamed
            )
            lines.append(f"smallest change in sum, beyond the halfwidths: {moved}")
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Return the findings as plain values."""
        q, proof, witness = self.question, self.refutation, self.witness
        limits = {name: float(getattr(q, name)) for name in tables.LIMITS}
        return {
            "robot": self.robot,
            "verdict": self.verdict,
            "consistency": q.consistency,
            "required_margin": limits.pop("margin"),
            **limits,
            "margin": self.margin,
            "margin_bound": self.margin_bound,
            "witness": None
            if witness is None
            else dict(zip(q.theta_names, witness.tolist(), strict=True)),
            "inequality": None if proof is None else proof.inequality(),
            "needs_mass_bound": self.needs_mass_bound,
            "needs_theta_max": self.needs_theta_max,
            "change": self.change,
            "change_bound": self.change_bound,
            "changes": dict(self.changes),
            "blamed": list(self.blamed),
            "certificate": None if self.certificate is None else self.certificate.to_dict(),
        }


@one_thread
def audit_base_parameters(
    robot: RobotModel,
    values: Mapping[str, Number | Decimal | str],
    halfwidths: Mapping[str, Number | Decimal | str] | Number,
    *,
    consistency: Consistency = "pseudo_inertia",
    margin: Number = 0.0,
    mass_min: Number = 1e-3,
    mass_max: Number = 100.0,
    theta_max: Number = 1e4,
    friction: Iterable[str | FrictionTerm] | None = None,
    friction_nonnegative: bool = True,
    base: BaseParameters | None = None,
    table: TableFile | None = None,
) -> BaseAudit:
    """Decide whether links that can exist have given base parameters.

    Parameters
    ----------
    robot : RobotModel
        The robot; its inertias do not matter.
    values : mapping
        Base parameters by name (see `BaseParameters.names`), and standard ones such as ``m_3``
        where they are known too. Those that are missing are free. Floats are read as the decimals
        that print them; strings, decimals and fractions are exact.
    halfwidths : mapping or number
        How far from the value the truth may lie: half a unit in the last printed place, or a
        confidence limit. One number serves for all.
    consistency : {"pseudo_inertia", "spatial_inertia"}, optional
        What each link must obey.
    margin : number, optional
        The least margin of every link, kg·m² (see `sdpid.robot.inertia.margin`).
    mass_min, mass_max : number, optional
        Bounds on each link's mass, kg. A witness respects both; a refutation uses the upper one
        only where it has to, and says so.
    theta_max : number, optional
        Bound on the size of every standard parameter, likewise.
    friction : iterable of str or FrictionTerm, optional
        Friction terms of the table. By default those of `sdpid.friction` that have a parameter
        among `values`, such as Coulomb friction for ``Fs1``.
    friction_nonnegative : bool, optional
        Whether Coulomb, viscous and rotor terms are not negative.
    base : BaseParameters, optional
        Of the robot with these terms, where they are known already.
    table : TableFile, optional
        The file that the values come from, for the proof to name.

    Returns
    -------
    BaseAudit

    Raises
    ------
    DataError
        For a name that the robot does not have, a number that is none, a negative halfwidth, a
        consistency that says nothing, or no values at all.

    Notes
    -----
    What is proven holds for the regrouping matrix in `BaseAudit.question`: the stored one, each
    coefficient read as a decimal of at most 9 digits where it is one to 1e-13, else as the
    rational number that the double is.

    Examples
    --------
    >>> audit = sdpid.audit_base_parameters(robot, {"zzr1": "-0.10"}, "0.01")
    >>> audit.verdict
    'not realisable'
    >>> print(audit.summary().splitlines()[3])
    proof: zzr1 >= 0 for links that can exist, but at most -0.09 in the table

    A table that links can have is proven by such links, the witness:

    >>> table = {name: round(value, 2) for name, value in estimate.named().items()}
    >>> audit = sdpid.audit_base_parameters(robot, table, 0.005)
    >>> audit.verdict, audit.witness.shape
    ('realisable', (72,))
    """
    if consistency not in ("pseudo_inertia", "spatial_inertia"):
        raise DataError(
            f"audit: consistency is {consistency!r}; give 'pseudo_inertia' or 'spatial_inertia'."
        )
    given = dict(zip(tables.LIMITS, (margin, mass_min, mass_max, theta_max), strict=True))
    limits = {name: exact(number) for name, number in given.items()}
    for name, number in limits.items():
        if number < 0 or (number == 0 and name != "margin"):
            least = "at least 0" if name == "margin" else "positive"
            raise DataError(f"audit: {name} is {given[name]}; it must be {least}.")
    if not limits["mass_min"] <= limits["mass_max"] <= limits["theta_max"]:
        raise DataError(
            "audit: expected mass_min <= mass_max <= theta_max, have "
            f"{mass_min}, {mass_max} and {theta_max}."
        )
    if not values:
        raise DataError("audit: no values are given; name at least one base parameter.")
    if not isinstance(halfwidths, Mapping):
        halfwidths = dict.fromkeys(values, halfwidths)
    if stray := [name for name in halfwidths if name not in values]:
        raise DataError(f"audit: halfwidths without a value: {', '.join(stray)}.")
    terms = named_terms(robot, values) if friction is None else friction
    model, base = regrouping(robot, terms, base)
    require_posed(model, base)
    positive = [friction_nonnegative and p.nonnegative for p in model.parameters]
    question = Question(
        robot=robot.name,
        link_names=tuple(robot.link_names),
        table=None if table is None else table.name,
        table_sha256=None if table is None else table.sha256,
        names=tuple(values),
        rows=tuple(coefficients(robot, base, name) for name in values),
        values=tuple(map(exact, values.values())),
        halfwidths=tuple(_halfwidth(halfwidths.get(name), name) for name in values),
        theta_names=base.theta_names,
        nonnegative=frozenset((np.flatnonzero(positive) + 10 * robot.n_links).tolist()),
        consistency=consistency,
        **limits,
    )
    return _audited(question, characteristic_length(robot))


def _halfwidth(given: Number | Decimal | str | None, name: str) -> Fraction:
    if given is None:
        raise DataError(f"audit: {name} has no halfwidth; give one, 0 if it is exact.")
    width = exact(given)
    if width < 0:
        raise DataError(f"audit: the halfwidth of {name} is {float(width)}; the least is 0.")
    return width


def _audited(question: Question, length: float) -> BaseAudit:
    """Return the answer to a question about a robot of some length (m)."""
    search, limit, theta = ScaledQuestion(question, length), None, None
    best: float | None = None
    inner = search.solve()
    if inner is not None:
        theta = search.made_exact(inner.theta)
        bodies = np.array(theta[: 10 * question.n_links], dtype=float).reshape(-1, 10)
        found = float(margin_of(bodies, question.consistency).min())
        best = found if np.isfinite(found) else None
        bound = search.refutation(inner)
        limit = bound.margin_bound if bound is not None and bound.valid else None
    common: dict[str, Any] = {
        "robot": question.robot,
        "question": question,
        "margin": best,
        "margin_bound": None if limit is None else float(limit),
        "units": dict(zip(question.names, search.give.tolist(), strict=True)),
    }
    if theta is not None and (best is None or best >= float(question.margin) - _NEAR):
        witness = realization(question, theta)
        if witness is not None:
            return BaseAudit(
                **common, verdict="realisable", certificate=witness, change=0.0, changes={}
            )
    least = search.solve(search.give[:, None])
    strongest = _holding(search.refutation(least), question)
    most = None if strongest is None else strongest.change_bound
    # A proof without the bound on masses says more, and people can read one of few digits.
    heavy = ScaledQuestion(replace(question, mass_max=question.theta_max), length)
    free = heavy.solve(heavy.give[:, None])
    proof = (
        _holding(heavy.refutation(free, _FEW_DIGITS, mass_bound=False), question)
        or _holding(heavy.refutation(free, mass_bound=False), question)
        or strongest
    )
    changes = search.solve(np.diag(search.give))
    beyond = 0.0 * search.give if changes is None else search.beyond(changes.theta)
    moved = np.flatnonzero(np.abs(beyond) > _NO_CHANGE * search.give)
    return BaseAudit(
        **common,
        verdict="undecided" if proof is None else "not realisable",
        certificate=proof,
        change=None if least is None else _factor(search, length, least),
        change_bound=None if most is None else float(min(most, _LARGEST)),
        changes={question.names[k]: float(beyond[k]) for k in moved},
    )


def _holding(proof: StoredRefutation | None, question: Question) -> StoredRefutation | None:
    """Return a proof of the question that was asked, if it is one."""
    if proof is None:
        return None
    asked = replace(proof, question=question)
    return asked if asked.holds else None


def _factor(search: ScaledQuestion, length: float, least: FoundBodies) -> float | None:
    """Return by what factor, less one, halfwidths grow until there is a witness."""
    question = search.question
    smallest = float(np.max(np.abs(search.beyond(least.theta)) / search.give))
    for beyond in _BEYOND:
        trial = smallest * (1.0 + beyond) + beyond
        more = [exact(trial * x) for x in search.give.tolist()]
        halves = tuple(map(add, question.halfwidths, more))
        wider = ScaledQuestion(replace(question, halfwidths=halves), length)
        found = wider.solve()
        if found is not None and wider.question.is_witness(wider.made_exact(found.theta)):
            return trial
    return None
