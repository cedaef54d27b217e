"""Identified gains, and what they were found from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.tables import Shown, Table, plain, plain_dict
from sdpid.assurance.drive_gains.load import Load
from sdpid.assurance.drive_gains.model import GainModel
from sdpid.experiment.drive_gains.gains import DriveGains
from sdpid.experiment.inspection.kinds import Finding
from sdpid.robot.inertia import physical_parameters

# A gain whose error is more than this many times the joints' median, and this share, is weak.
_WEAK, _WEAK_SHARE = 1.5, 0.01
# The demand that bodies can exist moves gains by less than this many standard errors, or the
# currents contradict it.
_MOVED = 2.0
# Gains that are all between these, N·m/A, are told: torques that were made of a UR10e's currents
# came out at 0.93 to 1.03.
_LIKE_TORQUES = 0.8, 1.25
# Fewer blocks than this make intervals uncertain.
_FEW = 20


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
            **vars(self),
            "loads": [{**plain(load), "inertia": load.inertia} for load in self.loads],
        }
        return plain_dict(content)


def basis_in_words(
    loads: Sequence[Load], known: Mapping[str, float] | None, description_error: float | None
) -> str:
    """Return what gives the scale of the gains."""
    found = []
    if loads:
        masses = dict.fromkeys(f"{load.mass:.4g} kg" for load in loads)
        found.append(f"a load of {' and '.join(masses)}")
    if known:
        found.append(
            "the known gain of "
            + ", ".join(f"{name} ({value:.4g} N·m/A)" for name, value in known.items())
        )
    if description_error is not None:
        found.append(f"the described links, each right to {100.0 * description_error:.3g} %")
    return " and ".join(found)


def notes_on(
    model: GainModel, gains: Array, unconstrained: Array, covariance: Array, blocks: int
) -> Iterator[str]:
    """Yield notes on weak joints, gains near 1, what consistency changes, and errors in common.

    Parameters
    ----------
    model : GainModel
        What currents were explained by.
    gains, unconstrained : ndarray, shape (n,)
        N·m/A, with and without the demand that bodies can exist.
    covariance : ndarray, shape (n, n)
        Of their logarithms.
    blocks : int
        How many independent groups of samples the errors rest on.
    """
    free, error = model.free, np.sqrt(np.diag(covariance))
    named = list(zip(model.robot.joint_names, free, error, strict=True))
    median = float(np.median(error[free])) if free.any() else 0.0
    for name, loose, own in named:
        if loose and own > max(_WEAK * median, _WEAK_SHARE):
            yield (
                f"the gain of {name} is weak: its error is {100.0 * own:.2g} %, the joints' "
                f"median {100.0 * median:.2g} %; what is known changes its current least"
            )
    low, high = _LIKE_TORQUES
    if free.any() and np.all((gains[free] > low) & (gains[free] < high)):
        yield (
            f"all gains are near 1 N·m/A ({gains[free].min():.2g} to {gains[free].max():.2g}), as "
            "if the efforts were torques in N·m already: check the columns and their unit; "
            "torques need no gains"
        )
    for (name, loose, own), shift in zip(named, np.abs(np.log(gains / unconstrained)), strict=True):
        if loose and shift > max(_MOVED * own, 1e-6):
            yield (
                f"links and loads that can exist move the gain of {name} by "
                f"{100.0 * shift:.2g} %, {shift / own:.2g} standard errors: the model, the "
                "load or a recording contradicts it"
            )
    for mass, error_of_mass in {x.mass: x.mass_error for x in model.loads if x.mass_error}.items():
        share = 100.0 * error_of_mass / mass
        yield f"the mass of the load is known to {share:.2g} %: so are all gains together"
    if blocks < _FEW:
        yield (
            f"the errors rest on {blocks} independent blocks of samples: record longer for "
            "narrower intervals"
        )
