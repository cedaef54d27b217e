"""A payload: mass, center of mass and inertia, with intervals, as robot controllers take them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.tables import Shown, Table, plain_dict
from sdpid.experiment.inspection.kinds import Finding
from sdpid.robot.inertia import physical_parameters, tensor_entries

# Of osmium, kg/m³: nothing is denser.
_DENSITY = 22_590.0

QUANTITIES = ("mass", "com_x", "com_y", "com_z", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
QUANTITY_UNITS = ("kg", *("m",) * 3, *("kg.m2",) * 6)


def least_second_moment(mass: float) -> float:
    """Return the second moment, kg·m², that no body of a mass in kg can have less of everywhere.

    That of a ball of the densest matter: a body may be thinner in one direction and wider in
    others, as a plate is, but tools and workpieces are not.
    """
    radius = float(np.cbrt(3.0 * mass / (4.0 * np.pi * _DENSITY)))
    return mass * radius**2 / 5.0


def quantities(theta: Array) -> Array:
    """Return mass, center of mass, and inertia about it (entries in theta's order), (10,)."""
    mass, com, inertia = physical_parameters(theta)
    return np.concatenate([[float(mass)], com, tensor_entries(inertia)])


@dataclass(frozen=True)
class DescribedLinks:
    """What is granted to a description that the arm's links are taken from.

    Attributes
    ----------
    tolerance : float
        Relative standard deviation of each link's inertial parameters about the described ones, in
        the metric of the prior ``"pullback"``.
    contradicted : bool
        Whether the recording shows the links to be further off.
    """

    tolerance: float
    contradicted: bool

    @property
    def share(self) -> str:
        """The tolerance in words."""
        return f"{100.0 * self.tolerance:.2g} %"

    def note(self) -> str:
        """Return in words what the intervals rest on, and what to do about it."""
        remedy = "a recording without load (--without) needs no such belief"
        if self.contradicted:
            return (
                "the payload rests on the described links, and the recording contradicts them: "
                "they, the scale of the efforts or the model of friction are off by more than the "
                f"{self.share} that the intervals allow for; take the payload for a hint; {remedy}"
            )
        return (
            f"the payload rests on the described links: the intervals hold if each is right to "
            f"{self.share} (one standard deviation); {remedy}"
        )


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Payload(Shown):
    """A payload and its intervals, in the form that robot controllers take.

    Attributes
    ----------
    mass : float
        kg.
    com : ndarray, shape (3,)
        Center of mass in the frame, m; not finite without a mass.
    inertia : ndarray, shape (3, 3)
        About the center of mass, along the axes of the frame, kg·m².
    theta : ndarray, shape (10,)
        The same as the ten parameters about the frame's origin.
    link, frame : str
        The link that carries it, and the frame that everything is given in.
    lower, upper : ndarray, shape (10,)
        Ends of the intervals of mass, center of mass, and inertia about it in the order of
        `names`; infinite where there is none.
    level : float
        Their probability.
    margin : float or None
        Smallest second moment about the center of mass, kg·m²; None without a mass.
    cost, cost_without : float
        Weighted cost with this payload, and with none.
    invisible : int
        How many of the ten directions the recordings say nothing about.
    shown : bool
        Whether the recordings tell it from no payload, with the intervals' probability.
    status : str
        Status of the solver.
    notes : tuple of str
        What was assumed, or is to be known.
    findings : tuple of Finding
        What is wrong with the recordings (see `sdpid.inspect_recording`).
    described : DescribedLinks or None
        What was granted to the description, where the arm's links are taken from it: the intervals
        then have their probability only if it deserves that. None where the arm is known from a
        recording, or believed in by a prior.
    gains_share : ndarray, shape (10,), or None
        Share of the errors of drive gains in the variance of each of `names`; None where efforts
        were not made of currents by gains with errors.

    Examples
    --------
    >>> payload = sdpid.identify_payload(robot, log, estimate)  # the same motion without a load
    >>> payload.shown, payload.com.shape, payload.inertia.shape
    (False, (3,), (3, 3))
    >>> bool(payload.lower[0] <= payload.mass <= payload.upper[0])
    True
    >>> payload.names[:4]
    ('mass', 'com_x', 'com_y', 'com_z')
    """

    mass: float
    com: Array
    inertia: Array
    theta: Array
    link: str
    frame: str
    lower: Array
    upper: Array
    level: float
    margin: float | None
    cost: float
    cost_without: float
    invisible: int
    shown: bool
    status: str
    notes: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    described: DescribedLinks | None = None
    gains_share: Array | None = None

    _facts = ("link", "frame", "mass, kg", "level", "shown")

    @property
    def names(self) -> tuple[str, ...]:
        """The quantities that have intervals."""
        return QUANTITIES

    @property
    def values(self) -> Array:
        """Mass, center of mass and inertia about it, (10,), in the order of `names`."""
        return quantities(self.theta)

    def _tables(self) -> Iterator[Table]:
        yield self._table()

    def _table(self) -> Table:
        """Return one row a quantity."""
        columns: dict[str, Sequence[object]] = {
            "quantity": QUANTITIES,
            "unit": QUANTITY_UNITS,
            "value": self.values.tolist(),
            "lower": self.lower.tolist(),
            "upper": self.upper.tolist(),
        }
        if self.gains_share is not None:
            columns["from gains, %"] = [round(100.0 * each) for each in self.gains_share.tolist()]
        return Table.of_columns(columns)

    def describe(self) -> str:
        """Return the payload in words and numbers, one quantity a line."""
        intervals = f"{100.0 * self.level:g} % intervals"
        if self.described is not None:
            intervals += f" if the described links are right to {self.described.share}"
        title = (
            f"payload of {self.link}, in the frame {self.frame}; inertia about the center of mass "
            f"({intervals})"
        )
        found = [each.line() for each in self.findings]
        return "\n".join([title, self._table().text(5), *self.notes, *found])

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        ends = np.stack([self.lower, self.upper], axis=1).tolist()
        content = {
            "link": self.link,
            "frame": self.frame,
            "mass": self.mass,
            "center_of_mass": self.com if self.mass > 0.0 else None,
            "inertia": self.inertia if self.mass > 0.0 else None,
            "level": self.level,
            "intervals": dict(zip(QUANTITIES, ends, strict=True)),
            "margin": self.margin,
            "cost": self.cost,
            "cost_without": self.cost_without,
            "invisible_directions": self.invisible,
            "shown": self.shown,
            "status": self.status,
            "described": self.described,
            "gains_share": (
                None
                if self.gains_share is None
                else dict(zip(QUANTITIES, self.gains_share.tolist(), strict=True))
            ),
            "notes": self.notes,
            "findings": self.findings,
        }
        return plain_dict(content)
