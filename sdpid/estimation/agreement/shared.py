"""What two estimates have in common: parameters, prior beliefs, and data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.errors import DataError
from sdpid.estimation.posterior import Estimated
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.model.base_parameters import BaseParameters
from sdpid.robot.model.model import RobotModel

# Regroupings of one robot, read from two files or found beside other friction terms, are equal
# within this share of their largest coefficient.
_SAME = 1e-6

# Rows of two priors are one belief when they are this nearly parallel: the friction's are in units
# of the efforts of each log, the log-determinants' curvature is that at each estimate.
_PARALLEL = 0.99

# Logs that have this share of their samples in common, to the last bit, share data. Below are
# poses at rest, which simulated or coarsely measured logs may repeat.
_SHARED = 0.01


@dataclass(frozen=True, eq=False)
class SharedParameters:
    """Base parameters that two estimates have as the same functions of standard parameters.

    Attributes
    ----------
    names, units : tuple of str
        The k parameters.
    first, other : ndarray of int, shape (k,)
        Their places in either list.
    only_first, only_other : tuple of str
        The rest.
    notes : tuple of str
        Which parameters of the same name are different ones, and which hold more in one.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    first: Indices
    other: Indices
    only_first: tuple[str, ...]
    only_other: tuple[str, ...]
    notes: tuple[str, ...]

    @classmethod
    def of(cls, first: BaseParameters, other: BaseParameters) -> SharedParameters:
        """Find them by name and regrouping; they are called as in the first."""
        common = [name for name in first.theta_names if name in other.theta_names]
        in_first = [first.theta_names.index(name) for name in common]
        in_other = [other.theta_names.index(name) for name in common]
        # By the standard parameter that leads each: a name gets another suffix where more folds in.
        leads = [[base.theta_names[j] for j in base.kept] for base in (first, other)]
        pairs, regrouped, notes = [], [], []
        for i, lead in enumerate(leads[0]):
            if lead not in leads[1]:
                continue
            k, name = leads[1].index(lead), first.names[i]
            rows = first.matrix[i], other.matrix[k]
            gap = np.abs(rows[0][in_first] - rows[1][in_other]).max(initial=0.0)
            if gap > _SAME * max(np.abs(rows[0]).max(), np.abs(rows[1]).max()):
                regrouped.append(name)
                continue
            pairs.append((i, k))
            for base, row, which in ((first, rows[0], "first"), (other, rows[1], "other")):
                more = [base.theta_names[j] for j in np.flatnonzero(row)]
                if more := [each for each in more if each not in common]:
                    notes.append(f"{name} holds {' and '.join(more)} too in the {which} alone.")
        if regrouped:
            notes.append(f"Regrouped differently, and not compared: {', '.join(regrouped)}.")
        found = np.array(pairs, dtype=np.intp).reshape(-1, 2)
        return cls(
            names=tuple(first.names[i] for i in found[:, 0]),
            units=tuple(first.units[i] for i in found[:, 0]),
            first=found[:, 0],
            other=found[:, 1],
            only_first=_without(first.names, found[:, 0]),
            only_other=_without(other.names, found[:, 1]),
            notes=tuple(notes),
        )


def _without(names: tuple[str, ...], places: Indices) -> tuple[str, ...]:
    return tuple(name for i, name in enumerate(names) if i not in places)


def require_one_robot(first: RobotModel, other: RobotModel) -> None:
    """Raise when two estimates are not of one robot.

    Raises
    ------
    DataError
        Naming the joints or links that differ.
    """
    for what, a, b in (
        ("joints", first.joint_names, other.joint_names),
        ("links", first.link_names, other.link_names),
    ):
        if a != b:
            raise DataError(
                f"compare_to: the {what} of '{first.name}' are {', '.join(a)}, those of "
                f"'{other.name}' {', '.join(b)}; compare estimates of one robot."
            )


def beliefs_in_common(
    first: Estimated, other: Estimated, rows: tuple[Array, Array]
) -> tuple[Indices, Indices]:
    """Return the numbers (k,) and (k,) of prior rows of two estimates that state the same belief.

    Parameters
    ----------
    first, other : Estimate
        The estimates.
    rows : (ndarray, ndarray)
        The rows of their priors, (r, p) each.
    """
    names = (first.problem.base.theta_names, other.problem.base.theta_names)
    union = list(dict.fromkeys([*names[0], *names[1]]))
    placed = []
    for own, each in zip(names, rows, strict=True):
        wide = np.zeros((len(each), len(union)))
        wide[:, [union.index(name) for name in own]] = each
        size = np.linalg.norm(wide, axis=1, keepdims=True)
        placed.append(wide / np.where(size > 0.0, size, 1.0))
    if not len(placed[0]) or not len(placed[1]):
        return np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp)
    cosine = placed[0] @ placed[1].T
    best, back = cosine.argmax(axis=1), cosine.argmax(axis=0)
    i = np.arange(len(cosine))
    kept = (cosine[i, best] > _PARALLEL) & (back[best] == i)
    return i[kept], best[kept]


def share_data(first: Samples, other: Samples) -> bool:
    """Return whether two estimates used samples of one recording, processed alike."""
    if first is other:
        return True
    if first.effort.shape[1] != other.effort.shape[1]:
        return False
    seen = [
        {row.tobytes() for row in np.hstack([each.position, each.effort])}
        for each in (first, other)
    ]
    return len(seen[0] & seen[1]) > _SHARED * min(map(len, seen))
