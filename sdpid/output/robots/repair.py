"""Repair a URDF: replace impossible inertias by the nearest possible ones."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.files import atomic_path
from sdpid._common.tables import plain
from sdpid.assurance.descriptions.checks import carried, carried_theta, consistent, thin, thin_limit
from sdpid.assurance.descriptions.nearest_body import (
    NearestProof,
    aim,
    moment_floor,
    prove_nearest,
)
from sdpid.errors import ExportError
from sdpid.output.robots.written_bodies import write_inertial
from sdpid.robot.consistent import raise_eigenvalues
from sdpid.robot.description.bodies import (
    TENSOR_NAMES,
    DescribedBody,
    exact_decimal,
    read_urdf_bodies,
    second_moment,
)
from sdpid.robot.description.xml import encode_xml, is_mjcf, read_expanded, xml_text
from sdpid.robot.inertia import (
    complement,
    inertia_tensor,
    margin,
    second_moment_from_inertia,
    tensor_entries,
)

# Entries that differ by less, relative to the largest, differ by rounding: they are not rewritten.
_SAME = 1e-15
# Mass and radius of the ball that a moving link without mass gets; efforts change by 1e-5 N.
TOKEN_MASS, TOKEN_RADIUS = 1e-6, 0.01  # kg, m


@dataclass(frozen=True, kw_only=True)
class RepairedBody:
    """The repair of one body.

    Attributes
    ----------
    link : str
        The link.
    reason : {"impossible", "no thickness", "point", "no mass"}
        Why.
    moments, new_moments : tuple of float
        Principal moments before and after, kg·m².
    mass, new_mass : float
        kg; they differ for ``"no mass"`` only.
    proof : NearestProof or None
        That none is nearer, checked in exact arithmetic; None where a token body was written.
    """

    link: str
    reason: str
    moments: tuple[float, ...]
    new_moments: tuple[float, ...]
    mass: float
    new_mass: float
    proof: NearestProof | None


@dataclass(frozen=True, kw_only=True)
class RepairReport:
    """The repairs of a description, and the links that could not be repaired.

    Attributes
    ----------
    text : str
        The repaired description.
    path : Path or None
        The file, where one was written.
    bodies : tuple of RepairedBody
        What changed, in document order.
    left : tuple of str
        Links that are wrong and were left so: their mass is negative, or a number is none.
    expanded : bool
        Whether the source is xacro: the text is the URDF that it stands for, without macros.
    """

    text: str = field(repr=False)
    path: Path | None = None
    bodies: tuple[RepairedBody, ...]
    left: tuple[str, ...]
    expanded: bool = False

    def describe(self) -> str:
        """Return the report in words, one body a line."""
        where = " in the URDF that the xacro file stands for" if self.expanded else ""
        lines = [f"{len(self.bodies)} bodies repaired{where}"]
        for body in self.bodies:
            before, after = (
                " ".join(f"{x:.6g}" for x in m) for m in (body.moments, body.new_moments)
            )
            line = f"{body.link} ({body.reason}): principal moments {before} -> {after} kg·m²"
            if body.mass != body.new_mass:
                line += f", mass {body.mass:.6g} -> {body.new_mass:.6g} kg"
            if body.proof is not None:
                line += (
                    f"; second moments moved by {body.proof.distance:.3g} kg·m², proven that no "
                    f"body is nearer than {body.proof.lower_bound:.3g}"
                )
            lines.append(line)
        if self.left:
            lines.append(
                "not repaired, give the true numbers (mass negative or no number): "
                + ", ".join(self.left)
            )
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values, without the text."""
        return {key: value for key, value in plain(self).items() if key != "text"}


def repair_urdf(
    source: str | os.PathLike[str],
    *,
    target: str | os.PathLike[str] | None = None,
    xacro_args: Mapping[str, str] | None = None,
) -> RepairReport:
    """Replace every impossible inertia of a URDF by the nearest possible one.

    Nearest is meant in the Frobenius distance of second moments about the center of mass, with
    mass and center kept, and every repair is proven nearest in exact arithmetic
    (`sdpid.assurance.descriptions.nearest_body`). So that loaders accept the result in spite of
    rounding, repaired bodies have second moments of at least a millionth of the largest, those of a
    ball of 0.1 mm, and 1e-12 kg·m². What changes:

    * tensors that no body can have, and those on the edge (without thickness) that loaders
      refuse: entries of ``<inertia>``;
    * points that are moved by a joint with nothing else fixed to them: the same;
    * inertia without mass, and moving links with no mass at all: a token mass of 1e-6 kg.

    All else stays as it is, but for white space and quotes within tags; of a xacro file, the URDF
    that it stands for.
    Negative masses and numbers that are none are left; they can be had from nothing else in the
    file.

    Parameters
    ----------
    source : str or path
        The URDF, or its text.
    target : str or path, optional
        File to write, whole or not at all.
    xacro_args : mapping, optional
        Values of the arguments of a xacro file.

    Returns
    -------
    RepairReport

    Raises
    ------
    ModelError
        When the source cannot be read.
    ExportError
        When it is MJCF, or the target cannot be written.
    CertificateError
        When a repair cannot be proven nearest.
    """
    found = read_expanded(source, xacro_args)
    text, what = found.text, found.what
    if is_mjcf(text, what):
        raise ExportError(f"{what}: only URDF is repaired; correct the MJCF by hand.")
    repair = _Repair(*read_urdf_bodies(text, what))
    result = xml_text(repair.root, text) if repair.done else text
    if target is not None:
        with atomic_path(target) as temporary:
            temporary.write_bytes(encode_xml(result))
    return RepairReport(
        text=result,
        bodies=tuple(repair.done[name] for name in repair.bodies if name in repair.done),
        left=tuple(repair.left),
        path=None if target is None else Path(target),
        expanded=found.expanded,
    )


class _Repair:
    """A document's root, its bodies with the repairs so far, and these repairs."""

    def __init__(self, root: Any, bodies: tuple[DescribedBody, ...]) -> None:
        self.root = root
        self.bodies = {body.name: body for body in bodies}
        self.done: dict[str, RepairedBody] = {}
        self.left = [b.name for b in bodies if b.problems or (b.mass is not None and b.mass < 0.0)]
        for body in bodies:
            if body.name not in self.left:
                self._alone(body)
        for carrier in carried(bodies):
            self._together(carrier)

    def _alone(self, body: DescribedBody) -> None:
        """Repair a body that is impossible or thin by itself."""
        if consistent(body) is False:
            self._write(body, "no mass" if body.mass == 0.0 else "impossible")
        elif thin(body):
            self._write(body, "no thickness")

    def _together(self, carrier: str) -> None:
        """Repair bodies that are fixed together and have no mass or extent in sum."""
        group = carried(list(self.bodies.values()))[carrier]
        if any(body.name in self.left for body in group):
            return
        total = carried_theta(group)
        if total[0] == 0.0:
            self._write(self.bodies[carrier], "no mass")
        elif not margin(total, "pseudo_inertia") >= thin_limit(inertia_tensor(total)):
            self._write(max(group, key=lambda body: body.mass or 0.0), "point")

    def _write(self, body: DescribedBody, reason: str) -> None:
        """Write the nearest possible body, or a token one."""
        old = np.zeros((3, 3)) if body.tensor is None else body.tensor
        token = reason == "no mass"
        mass = TOKEN_MASS if token else (body.mass or 0.0)
        given = second_moment_from_inertia(old)
        floor, nearest = 0.0, 2.0 * mass * TOKEN_RADIUS**2 * np.eye(3)
        if old.any() or not token:
            floor = moment_floor(given, mass)
            nearest = complement(raise_eigenvalues(given, aim(floor)))
        values: dict[str, dict[str, str]] = {"mass": {"value": repr(mass)}} if token else {}
        tensor, entries = values.setdefault("inertia", {}), []
        before = body.entries or (None,) * len(TENSOR_NAMES)
        for key, was, number in zip(TENSOR_NAMES, before, tensor_entries(nearest), strict=True):
            text = repr(float(number) + 0.0)
            entries.append(exact_decimal(text))
            if was is None or abs(float(entries[-1] - was)) > _SAME * float(np.abs(old).max()):
                tensor[key] = text
            else:
                entries[-1] = was
        proof = None
        if floor:
            exact = body.entries or (Fraction(0),) * len(TENSOR_NAMES)
            proof = prove_nearest(second_moment(exact), second_moment(entries), Fraction(floor))
        links = self.root.findall("link")
        link = next(each for each in links if each.get("name", "") == body.name)
        write_inertial(link, {tag: each for tag, each in values.items() if each})
        self.bodies[body.name] = replace(
            body,
            described=True,
            mass=mass,
            com=np.zeros(3) if body.com is None else body.com,
            entries=tuple(entries),
            half_digit=0.0,
        )
        self.done[body.name] = RepairedBody(
            link=body.name,
            reason=reason,
            moments=tuple(np.linalg.eigvalsh(old).tolist()),
            new_moments=tuple(np.linalg.eigvalsh(nearest).tolist()),
            mass=body.mass or 0.0,
            new_mass=mass,
            proof=proof,
        )
