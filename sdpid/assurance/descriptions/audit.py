"""Audit a robot description: find bodies that cannot exist, and implausible ones."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.tables import Shown, Table, plain
from sdpid.assurance.descriptions.body_checks import (
    check_numbers,
    check_shape,
    consistent,
    least_second_moment,
)
from sdpid.assurance.descriptions.findings import GEOMETRY, Finding
from sdpid.assurance.descriptions.link_shape import Shape, Shapes
from sdpid.assurance.descriptions.model_checks import check_copies, check_moving
from sdpid.errors import ModelError
from sdpid.robot.description.bodies import DescribedBody, read_urdf_bodies
from sdpid.robot.description.xacro import expand_xacro
from sdpid.robot.description.xml import is_mjcf, read_description
from sdpid.robot.model.geometry import link_points

_ORDER = {"error": 0, "warning": 1, "note": 2}


@dataclass(frozen=True, kw_only=True)
class BodyAudit:
    """The numbers of one body.

    Attributes
    ----------
    link : str
        The link.
    moving : bool
        Whether a joint moves it.
    consistent : bool or None
        Whether some body has these numbers, decided in exact arithmetic; None without numbers.
    mass : float or None
        kg.
    com : tuple of float or None
        Center of mass in the link's frame, m.
    moments : tuple of float or None
        Principal moments about the center of mass, rising, kg·m².
    second_moment : float or None
        Smallest eigenvalue of the second moments about the center of mass, kg·m²: the one of the
        pseudo-inertia once its frame is moved there.
    triangle_ratio : float or None
        Largest principal moment over the sum of the others, at most 1 for a body; None where that
        sum is not positive.
    gyration : float or None
        Radius of gyration about the center of mass, m; None where it is not real.
    com_outside : float or None
        Distance of the center of mass from the hull of the collision geometry (of the visual one
        where there is no other), m; negative inside.
    density : float or None
        Mass over the volume of the hull of all geometry, kg/m³: the least that it can be.
    """

    link: str
    moving: bool
    consistent: bool | None
    mass: float | None
    com: tuple[float, ...] | None
    moments: tuple[float, ...] | None
    second_moment: float | None
    triangle_ratio: float | None
    gyration: float | None
    com_outside: float | None
    density: float | None


@dataclass(frozen=True, kw_only=True, repr=False)
class UrdfAudit(Shown):
    """Result of the audit of a robot description.

    Attributes
    ----------
    name : str
        The description.
    bodies : tuple of BodyAudit
        One a link, in document order.
    findings : tuple of Finding
        Errors first.

    Examples
    --------
    >>> text = '''<robot name="one"><link name="base"/><link name="arm"><inertial><mass value="1"/>
    ... <inertia ixx="1" iyy="1" izz="3" ixy="0" ixz="0" iyz="0"/></inertial></link>
    ... <joint name="hip" type="continuous"><parent link="base"/><child link="arm"/></joint>
    ... </robot>'''
    >>> audit = sdpid.audit_urdf(text)
    >>> audit.passed
    False
    >>> print(audit.errors[0].message.split(":")[0])
    the principal moments 1, 1, 3 kg·m² violate the triangle inequality
    """

    name: str
    bodies: tuple[BodyAudit, ...]
    findings: tuple[Finding, ...]

    _facts = ("name", "bodies", "errors", "warnings")

    @property
    def errors(self) -> tuple[Finding, ...]:
        """Findings that no body can have."""
        return tuple(f for f in self.findings if f.severity == "error")

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """Findings that are implausible."""
        return tuple(f for f in self.findings if f.severity == "warning")

    @property
    def passed(self) -> bool:
        """Whether there are no errors."""
        return not self.errors

    def _tables(self) -> Iterator[Table]:
        yield self._table()
        rows = tuple((f.severity, f.link, f.message) for f in self.findings)
        yield Table(("severity", "link", "finding"), rows)

    def _table(self) -> Table:
        """Return one row a body; one that cannot exist is marked with an exclamation mark."""
        bodies = self.bodies
        return Table.of_columns(
            {
                "link": [b.link + (" !" if b.consistent is False else "") for b in bodies],
                "mass": [b.mass for b in bodies],
                "moments": [
                    None if b.moments is None else " ".join(f"{x:.3g}" for x in b.moments)
                    for b in bodies
                ],
                "second moment": [b.second_moment for b in bodies],
                "triangle": [b.triangle_ratio for b in bodies],
                "com outside": [b.com_outside for b in bodies],
                "density": [b.density for b in bodies],
            }
        )

    def table(self) -> str:
        """Return the bodies as aligned text; ``-`` where a number does not exist."""
        return self._table().text(3)

    def describe(self) -> str:
        """Return the findings, one a line, and the count."""
        lines = [
            f"{f.severity}: " + (f"link '{f.link}': " if f.link else "") + f.message
            for f in self.findings
        ]
        notes = len(self.findings) - len(self.errors) - len(self.warnings)
        lines.append(
            f"{self.name}: {len(self.bodies)} links, {len(self.errors)} errors, "
            f"{len(self.warnings)} warnings, {notes} notes"
        )
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain values."""
        found: dict[str, Any] = {"passed": self.passed, **plain(self)}
        return found


def audit_urdf(
    source: str | os.PathLike[str],
    *,
    package_dirs: Sequence[str | os.PathLike[str]] = (),
    xacro_args: Mapping[str, str] | None = None,
) -> UrdfAudit:
    """Audit the inertias of a URDF, or of an MJCF file, link by link as written.

    Of a xacro file the URDF is audited that it stands for.

    Errors are what no body can have, decided in exact arithmetic on the decimals of the file:
    tensors that violate the triangle inequality or are not positive, negative masses, inertia
    without mass, asymmetric tensors, numbers that are none, joints that move nothing. Warnings
    are what is implausible: tensors without thickness, placeholders, copies, centers of mass,
    densities and radii of gyration that do not fit the geometry, units, the wrong point.

    Parameters
    ----------
    source : str or path
        The file, or its text. MJCF is read by MuJoCo (extra ``sim``), without its shapes.
    package_dirs : sequence of paths, optional
        Folders for ``package://`` names, besides the file's own and those above it.
    xacro_args : mapping, optional
        Values of the arguments of a xacro file.

    Returns
    -------
    UrdfAudit

    Raises
    ------
    ModelError
        When it cannot be read.

    Examples
    --------
    >>> report = sdpid.write_urdf(estimate, target="identified.urdf")
    >>> audit = sdpid.audit_urdf("identified.urdf")
    >>> audit.passed
    True
    >>> print(audit.describe())
    identified.urdf: 7 links, 0 errors, 0 warnings, 0 notes
    """
    found = expand_xacro(read_description(source), xacro_args)
    text, path, what = found.text, found.path, found.what
    if is_mjcf(text, what):
        from sdpid.robot.description.mjcf_bodies import read_mjcf_bodies

        bodies = read_mjcf_bodies(text, path, what)
        shapes: dict[str, Shapes] = {}
        findings: list[Finding] = []
    else:
        root, bodies = read_urdf_bodies(text, what)
        folders = [Path(folder) for folder in package_dirs]
        if path is not None:
            folders.append(path.parent)
        shapes, findings = _shapes(root, what, folders)
    for body in bodies:
        findings += check_numbers(body)
        findings += check_shape(body, shapes.get(body.name))
    findings += check_copies(bodies, shapes)
    findings += check_moving(bodies)
    findings.sort(key=lambda finding: _ORDER[finding.severity])
    return UrdfAudit(
        name=what,
        bodies=tuple(_numbers(body, shapes.get(body.name)) for body in bodies),
        findings=tuple(findings),
    )


def _shapes(
    root: Any, what: str, folders: Sequence[Path]
) -> tuple[dict[str, Shapes], list[Finding]]:
    """Return the hulls of the geometry by link, and what could not be read."""
    shapes: dict[str, Shapes] = {}
    failed: list[str] = []
    for link in root.findall("link"):
        points = {}
        for kind in ("collision", "visual"):
            try:
                points[kind] = link_points(link, kind, what, folders)
            except ModelError as cause:
                points[kind] = np.empty((0, 3))
                failed.append(str(cause))
        whole = Shape.around(np.concatenate([points["collision"], points["visual"]]))
        if whole is not None:
            collision = Shape.around(points["collision"]) or whole
            shapes[link.get("name", "")] = Shapes(collision, whole)
    if not failed:
        return shapes, []
    return shapes, [GEOMETRY.found("", count=len(failed), first=failed[0])]


def _numbers(body: DescribedBody, shapes: Shapes | None) -> BodyAudit:
    """Return the numbers of a body, as far as they exist."""
    tensor, mass = body.tensor, body.mass
    moments = second = ratio = gyration = outside = density = None
    if tensor is not None:
        values = np.linalg.eigvalsh(tensor)
        moments = tuple(float(x) for x in values)
        second = least_second_moment(tensor)
        if values[0] + values[1] > 0.0:
            ratio = float(values[2] / (values[0] + values[1]))
        trace = float(np.trace(tensor))
        if mass is not None and mass > 0.0 and trace >= 0.0:
            gyration = float(np.sqrt(0.5 * trace / mass))
    if shapes is not None and mass is not None and mass > 0.0:
        density = mass / shapes.whole.volume
        if body.com is not None:
            outside = shapes.collision.distance(body.com)
    return BodyAudit(
        link=body.name,
        moving=body.moving,
        consistent=consistent(body) if body.described else None,
        mass=mass,
        com=None if body.com is None else tuple(float(x) for x in body.com),
        moments=moments,
        second_moment=second,
        triangle_ratio=ratio,
        gyration=gyration,
        com_outside=outside,
        density=density,
    )
