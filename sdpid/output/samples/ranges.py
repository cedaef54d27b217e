"""Ranges for domain randomization: how far each number of a robot varies over draws.

Bodies vary in the log-Cholesky form of the pseudo-inertia [rucker2022]_. A change moves every point
x of a body to ``A·x + t``, A upper triangular, and scales its density:

    J' = U·J·U^T,   U = exp(alpha)·[[exp(d1), s12, s13, t1],
                                    [0, exp(d2), s23, t2],
                                    [0, 0, exp(d3), t3],
                                    [0, 0, 0, 1]].

The mass is scaled by exp(2·alpha), and where A is the identity the center of mass moves by t. Any
ten numbers make a consistent body of a consistent one, and between two bodies of positive
definite pseudo-inertia there is one change. mjlab's ``dr.pseudo_inertia`` randomizes these numbers.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, Mask, generator
from sdpid._common.files import atomic_write_text
from sdpid._common.tables import Shown, Table, json_text, plain_dict
from sdpid.errors import ExportError
from sdpid.estimation.estimate import FEASIBLE
from sdpid.estimation.problem import Problem
from sdpid.robot.inertia import from_pseudo_inertia, physical_parameters, pseudo_inertia

# In the order of every array here; t in m, the others without unit.
NAMES = ("alpha", "d1", "d2", "d3", "s12", "s13", "s23", "t1", "t2", "t3")

# Places in U of all but alpha, in that order.
_ROWS, _COLUMNS = np.array([0, 1, 2, 0, 0, 1, 0, 1, 2]), np.array([0, 1, 2, 1, 2, 2, 3, 3, 3])


def changes(bodies: ArrayLike, reference: ArrayLike) -> Array:
    """Return the change from a reference to each body, (..., 10) in the order of `NAMES`.

    Parameters
    ----------
    bodies, reference : array_like, shape (..., 10)
        Parameters about the same frame, which the change is relative to.

    Raises
    ------
    numpy.linalg.LinAlgError
        When one of them has no positive definite pseudo-inertia.
    """
    U = _upper(pseudo_inertia(bodies)) @ np.linalg.inv(_upper(pseudo_inertia(reference)))
    scale = U[..., 3, 3]
    entries = U[..., _ROWS, _COLUMNS] / scale[..., None]
    diagonal = np.log(np.concatenate([scale[..., None], entries[..., :3]], axis=-1))
    return np.concatenate([diagonal, entries[..., 3:]], axis=-1)


def changed(reference: ArrayLike, change: ArrayLike) -> Array:
    """Return the body that a change (..., 10) makes of a reference (..., 10)."""
    change = np.asarray(change, dtype=np.float64)
    U = np.zeros((*change.shape[:-1], 4, 4))
    U[..., _ROWS, _COLUMNS] = np.concatenate([np.exp(change[..., 1:4]), change[..., 4:]], axis=-1)
    U[..., 3, 3] = 1.0
    U *= np.exp(change[..., 0])[..., None, None]
    return from_pseudo_inertia(U @ pseudo_inertia(reference) @ np.swapaxes(U, -1, -2))


def _upper(matrix: Array) -> Array:
    """Return the upper triangular V, its diagonal positive, with V·V^T = matrix."""
    # The lower factor seen from the other corner.
    flipped = np.linalg.cholesky(matrix[..., ::-1, ::-1])
    return np.asarray(flipped[..., ::-1, ::-1])


# Lower and upper end.
Range: TypeAlias = tuple[float, float]

_FORM = (
    "J' = U·J·U^T of the pseudo-inertia J about the body's frame, U = exp(alpha)·[[exp(d1), s12, "
    "s13, t1], [0, exp(d2), s23, t2], [0, 0, exp(d3), t3], [0, 0, 0, 1]]; t in m"
)
_REFERENCE = "the mean of the draws: mean.urdf, mean.xml"
PREFER = (
    "Prefer the robots of the draws to these ranges: drawn independently from ranges, parameters "
    "lose their correlation, and robots vary in what the recordings show well."
)

# Ranges of fewer draws than leave this many outside on average end at the outermost draws.
_OUTSIDE = 2.0

# At most so many robots are drawn from the ranges to tell what independence costs.
_TRIALS = 200


@dataclass(frozen=True, kw_only=True)
class BodyRanges:
    """Ranges of what moves with a joint, relative to the reference robot.

    Attributes
    ----------
    name : str
        The body in the written robots.
    mass, com : float, tuple of float
        The reference's mass, kg, and center of mass, m.
    changes : dict of str to (float, float)
        Ranges of ``alpha``, ``d1`` … ``t3`` (see `sdpid.output.samples.ranges`).
    mass_scale : (float, float)
        Mass over the reference's.
    com_shift : tuple of (float, float)
        Center of mass less the reference's, m, along x, y, z.
    inside : float
        Share of the draws that lie within all ten ranges at once.
    """

    name: str
    mass: float
    com: tuple[float, ...]
    changes: dict[str, Range]
    mass_scale: Range
    com_shift: tuple[Range, ...]
    inside: float

    def mjlab(self) -> dict[str, Range]:
        """Return the arguments of mjlab's ``dr.pseudo_inertia``: ``alpha_range`` and so on."""
        return {f"{name}_range": ends for name, ends in self.changes.items()}


@dataclass(frozen=True, kw_only=True)
class JointRange:
    """Range of an attribute of a joint.

    Attributes
    ----------
    joint, attribute : str
        ``damping``, ``frictionloss`` or ``armature``, in the units of MJCF.
    reference : float
        The reference robot's.
    absolute : (float, float)
        Of the attribute itself.
    scale : (float, float) or None
        Over the reference's; None where that is zero.
    """

    joint: str
    attribute: str
    reference: float
    absolute: Range
    scale: Range | None


@dataclass(frozen=True, kw_only=True, repr=False)
class Ranges(Shown):
    """Ranges of every body and joint that contain a share of the draws, each by itself.

    Attributes
    ----------
    bodies : tuple of BodyRanges
        In the order of the links.
    joints : tuple of JointRange
        Of the friction terms and rotor inertias that the problem has.
    probability : float
        Share of the draws within each range: as much lies below it as above.
    number : int
        Draws.
    made : dict
        What they were made of: robot, seed, digests.
    inside : float
        Share of the draws within the ranges of all bodies at once.
    widened : float or None
        Spread (rms) of the efforts on the recorded motion, in the weights of the fit, of robots
        whose links are drawn independently from the ranges, over that of the draws; None where
        the draws have no spread, as a single one.
    feasible : float
        Share of those robots that meet all constraints of the problem. Their bodies are all
        consistent.
    """

    bodies: tuple[BodyRanges, ...]
    joints: tuple[JointRange, ...]
    probability: float
    number: int
    made: dict[str, Any]
    inside: float
    widened: float | None
    feasible: float

    _facts = ("bodies", "joints", "probability", "number")

    @property
    def notes(self) -> tuple[str, ...]:
        """What to know of these ranges: whether their draws are too few for them."""
        # Rounded, since 1 - 0.95 is not 0.05.
        needed = math.ceil(round(_OUTSIDE / (1.0 - self.probability), 6))
        if self.number >= needed:
            return ()
        return (
            f"ranges of {100.0 * self.probability:g} % end at the outermost of {self.number} "
            f"draws, which are too few to tell how far they reach; draw {needed} or more",
        )

    def table(self) -> str:
        """Return the ranges of the bodies as aligned text."""
        columns: dict[str, Sequence[object]] = {"body": [body.name for body in self.bodies]}
        for name in NAMES:
            ends = [body.changes[name] for body in self.bodies]
            columns[name] = [f"{low:.2g} … {high:.2g}" for low, high in ends]
        return Table.of_columns(columns).text()

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; ``pseudo_inertia`` holds mjlab's arguments as they are."""
        joints: dict[str, dict[str, Any]] = {}
        for each in self.joints:
            numbers = {"reference": each.reference, "absolute": each.absolute, "scale": each.scale}
            joints.setdefault(each.joint, {})[each.attribute] = numbers
        content = {
            "schema": "sdpid-ranges",
            "version": 1,
            "note": PREFER,
            "notes": self.notes,
            "made": {**self.made, "number": self.number, "probability": self.probability},
            "form": _FORM,
            "relative_to": _REFERENCE,
            "bodies": {
                body.name: {
                    **{key: getattr(body, key) for key in ("mass", "com")},
                    "pseudo_inertia": body.mjlab(),
                    **{key: getattr(body, key) for key in ("mass_scale", "com_shift", "inside")},
                }
                for body in self.bodies
            },
            "joints": joints,
            "independent": {
                "draws_inside_all": self.inside,
                "efforts_widened": self.widened,
                "consistent": 1.0,
                "feasible": self.feasible,
            },
        }
        return plain_dict(content)

    def to_json(self, path: str | os.PathLike[str]) -> Path:
        """Write the ranges as JSON, whole or not at all."""
        atomic_write_text(path, json_text(self.to_dict()) + "\n")
        return Path(path)


def ranges_of(
    problem: Problem,
    thetas: Array,
    frames: Array,
    names: Sequence[str],
    attributes: Mapping[str, Array],
    *,
    probability: float,
    made: Mapping[str, Any],
) -> Ranges:
    """Return the ranges of draws, relative to their mean.

    The mean is consistent, and inside where the estimate itself lies on the boundary: a body on
    the boundary has no log-Cholesky form, and what is near it has ranges without end.

    Parameters
    ----------
    problem : Problem
        What the draws obey.
    thetas : ndarray, shape (draws, p)
        The draws.
    frames : ndarray, shape (links, 4, 4)
        The joints' frames in those of the written robots' bodies.
    names : sequence of str
        Names of the bodies.
    attributes : mapping of str to ndarray, shape (draws + 1, n)
        Attributes of the joints by name, those of the mean last.
    probability : float
        Share of the draws within each range.
    made : mapping
        What the draws were made of.

    Raises
    ------
    ExportError
        When a drawn body has no log-Cholesky form.
    """
    links = problem.robot.n_links
    bodies = in_frames(thetas[:, : 10 * links].reshape(-1, links, 10), frames)
    mean = bodies.mean(axis=0)
    try:
        found = changes(bodies, mean)
    except np.linalg.LinAlgError:
        raise ExportError(
            f"ranges of '{problem.robot.name}': a drawn body has no positive definite "
            "pseudo-inertia; solve with consistency='pseudo_inertia'."
        ) from None
    ends, within = _ends(found, probability)
    mass, com, _ = physical_parameters(bodies)
    reference, center, _ = physical_parameters(mean)
    scales, _ = _ends(mass / reference, probability)
    shifts, _ = _ends(com - center, probability)
    widened, feasible = _independent(problem, thetas, frames, bodies, ends)
    inside = np.all(within, axis=2)
    rows = zip(
        *(names, reference.tolist(), center.tolist(), ends.tolist(), scales.tolist()),
        *(shifts.tolist(), inside.mean(axis=0).tolist()),
        strict=True,
    )
    return Ranges(
        bodies=tuple(
            BodyRanges(
                name=name,
                mass=kilograms,
                com=tuple(place),
                changes={key: _pair(each) for key, each in zip(NAMES, change, strict=True)},
                mass_scale=_pair(scale),
                com_shift=tuple(map(_pair, shift)),
                inside=share,
            )
            for name, kilograms, place, change, scale, shift, share in rows
        ),
        joints=tuple(_joint_ranges(problem, attributes, probability)),
        probability=probability,
        number=len(thetas),
        made=dict(made),
        inside=float(np.all(inside, axis=1).mean()),
        widened=widened,
        feasible=feasible,
    )


def in_frames(bodies: Array, frames: Array) -> Array:
    """Return bodies (..., links, 10) in other frames, given by the placements of theirs."""
    if np.array_equal(frames, np.broadcast_to(np.eye(4), frames.shape)):
        return bodies
    return from_pseudo_inertia(frames @ pseudo_inertia(bodies) @ np.swapaxes(frames, -1, -2))


def _ends(values: Array, probability: float) -> tuple[Array, Mask]:
    """Return the ends of the central range of each value over the draws, (..., 2), and who is in.

    The latter for every draw, (draws, ...).
    """
    tail = 0.5 * (1.0 - probability)
    low, high = np.quantile(values, [tail, 1.0 - tail], axis=0)
    inside = np.asarray((low <= values) & (values <= high))
    return np.stack([low, high], axis=-1), inside


def _pair(ends: Sequence[float] | Array) -> Range:
    return float(ends[0]), float(ends[1])


def _joint_ranges(
    problem: Problem, attributes: Mapping[str, Array], probability: float
) -> Iterator[JointRange]:
    """Yield the ranges of the joints' attributes, joint by joint."""
    for j, joint in enumerate(problem.friction.joint_names):
        for attribute, values in attributes.items():
            reference, (ends, _) = float(values[-1, j]), _ends(values[:-1, j], probability)
            numbers: dict[str, Any] = {"reference": reference, "absolute": _pair(ends)}
            numbers["scale"] = _pair(ends / reference) if reference > 0.0 else None
            yield JointRange(joint=joint, attribute=attribute, **numbers)


def _independent(
    problem: Problem, thetas: Array, frames: Array, bodies: Array, ends: Array
) -> tuple[float | None, float]:
    """Return how much wider efforts spread, and how many constraints hold, without correlation."""
    count, links = min(_TRIALS, len(thetas)), 10 * problem.robot.n_links
    mean = thetas.mean(axis=0)
    drawn = generator(0).uniform(ends[..., 0], ends[..., 1], (count, *bodies.shape[1:]))
    there = changed(bodies.mean(axis=0), drawn)
    boxed = np.tile(mean, (count, 1))
    boxed[:, :links] = in_frames(there, np.asarray(np.linalg.inv(frames))).reshape(count, links)
    feasible = np.mean([problem.feasible.violation(theta) <= FEASIBLE for theta in boxed])
    spreads = [
        np.linalg.norm((each - mean) @ problem.base.matrix.T @ problem.A.T) / np.sqrt(len(each))
        for each in (boxed, thetas)
    ]
    return float(spreads[0] / spreads[1]) if spreads[1] > 0.0 else None, float(feasible)
