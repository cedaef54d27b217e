"""Identified gains, and what they were found from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.tables import Shown, Table, plain, plain_dict
from sdpid.experiment.drive_gains.gains import DriveGains
from sdpid.experiment.inspection.finding import Finding
from sdpid.robot.inertia import physical_parameters


@dataclass(frozen=True, kw_only=True, eq=False)
class CarriedLoad:
    """A load of a recording, as it was estimated beside the gains.

    Attributes
    ----------
    mass : float
        As given, kg.
    com : ndarray, shape (3,)
        Center of mass in the frame, m.
    theta : ndarray, shape (10,)
        Ten parameters about the frame's origin.
    link, frame : str
        The link that carries it, and the frame.
    """

    mass: float
    com: Array
    theta: Array
    link: str
    frame: str

    @property
    def inertia(self) -> Array:
        """Inertia about the center of mass, (3, 3), kg·m²."""
        return np.asarray(physical_parameters(self.theta)[2])


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class IdentifiedGains(Shown):
    """Gains that recordings show, and what they were found from.

    Attributes
    ----------
    gains : DriveGains
        The gains and their errors.
    loads : tuple of CarriedLoad
        The loads, one a recording with load.
    rmse, share : ndarray, shape (n,)
        What the fit leaves of the currents: root mean square in A, and as a share of the currents'
        own deviation from their mean.
    unconstrained : ndarray, shape (n,)
        The gains without the demand that links and loads can exist, N·m/A.
    starts, agreed : int
        How many starts there were, and from how many the search came to the least cost.
    effects : tuple of str
        What the data say of effects beside friction, in words.
    status : str
        ``"optimal"``, or what went wrong.
    notes : tuple of str
        What was assumed, or is to be known.
    findings : tuple of Finding
        What is wrong with the recordings (see `sdpid.inspect_recording`).

    Examples
    --------
    >>> currents = sdpid.Recording(time=log.time, position=log.position, currents=True,
    ...                            effort=log.effort / 10.0, joint_names=robot.joint_names)
    >>> found = sdpid.identify_drive_gains(
    ...     robot, currents, known={"joint_2": 10.0}, effects="none"
    ... )
    >>> found.gains.basis, found.agreed == found.starts
    ('the known gain of joint_2 (10 N·m/A)', True)
    >>> bool(np.all(np.abs(found.gains.gains / 10.0 - 1.0) < 0.1))
    True
    """

    gains: DriveGains
    loads: tuple[CarriedLoad, ...]
    rmse: Array
    share: Array
    unconstrained: Array
    starts: int
    agreed: int
    effects: tuple[str, ...]
    status: str
    notes: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()

    _facts = ("gains.basis", "gains.common_factor", "status", "starts", "agreed")

    def _tables(self) -> Iterator[Table]:
        yield self.table()

    def table(self, level: float = 0.95) -> Table:
        """Return one row a joint: gain, error, interval, and what is left of the current.

        Parameters
        ----------
        level : float, optional
            Probability of each interval.
        """
        gains = self.gains.table(level)
        rows = tuple(
            (*row, float(rmse), 100.0 * float(share))
            for row, rmse, share in zip(gains.rows, self.rmse, self.share, strict=True)
        )
        header = (*gains.header, "rmse (A)", "left (%)")
        return Table(header, rows, {**gains.formats, "rmse (A)": ".2g", "left (%)": ".2g"})

    def describe(self, level: float = 0.95) -> str:
        """Return the gains in words and numbers, one joint a line.

        Parameters
        ----------
        level : float, optional
            Probability of each interval.
        """
        title = f"drive gains, by {self.gains.basis} ({100.0 * level:g} % intervals)"
        loads = [
            f"load on {load.link}: {load.mass:.4g} kg, center of mass "
            f"({', '.join(f'{x:.3f}' for x in load.com)}) m in the frame {load.frame}"
            for load in self.loads
        ]
        told = [*self.effects, *self.notes, *(each.line() for each in self.findings)]
        return "\n".join([title, self.table(level).text(4), *loads, *told])

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        content = {
            "gains": self.gains.to_dict(),
            "loads": [{**plain(load), "inertia": load.inertia} for load in self.loads],
            "rmse": self.rmse,
            "share": self.share,
            "unconstrained": self.unconstrained,
            "starts": self.starts,
            "agreed": self.agreed,
            "effects": self.effects,
            "status": self.status,
            "notes": self.notes,
            "findings": [finding.to_dict() for finding in self.findings],
        }
        return plain_dict(content)
