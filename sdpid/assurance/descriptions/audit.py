"""Audit a robot description: find bodies that cannot exist, and implausible ones."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.tables import Shown, Table, plain
from sdpid.assurance.descriptions.checks import BodyAudit, Shapes, checked, numbers_of
from sdpid.assurance.descriptions.findings import DescriptionFinding, found
from sdpid.errors import DataError, ModelError
from sdpid.estimation.constraints.hull import Hull
from sdpid.robot.description.bodies import read_urdf_bodies
from sdpid.robot.description.xml import is_mjcf, read_expanded
from sdpid.robot.model.shapes import link_shapes

_ORDER = {"error": 0, "warning": 1, "note": 2}


@dataclass(frozen=True, kw_only=True, repr=False)
class UrdfAudit(Shown):
    """Result of the audit of a robot description.

    Attributes
    ----------
    name : str
        The description.
    bodies : tuple of BodyAudit
        One a link, in document order.
    findings : tuple of DescriptionFinding
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
    findings: tuple[DescriptionFinding, ...]

    _facts = ("name", "bodies", "errors", "warnings")

    @property
    def errors(self) -> tuple[DescriptionFinding, ...]:
        """Findings that no body can have."""
        return tuple(f for f in self.findings if f.severity == "error")

    @property
    def warnings(self) -> tuple[DescriptionFinding, ...]:
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
                "moments": [b.moments and " ".join(f"{x:.3g}" for x in b.moments) for b in bodies],
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
    read = read_expanded(source, xacro_args)
    text, path, what = read.text, read.path, read.what
    shapes: dict[str, Shapes] = {}
    findings: list[DescriptionFinding] = []
    if is_mjcf(text, what):
        from sdpid.robot.description.mjcf import read_mjcf_bodies

        bodies = read_mjcf_bodies(text, path, what)
    else:
        root, bodies = read_urdf_bodies(text, what)
        folders = [*map(Path, package_dirs), *([] if path is None else [path.parent])]
        failed: list[str] = []
        shapes = dict(_shapes(root, what, folders, failed))
        if failed:
            findings.append(found("geometry", "", count=len(failed), first=failed[0]))
    numbers = [numbers_of(body, shapes.get(body.name)) for body in bodies]
    findings += checked(bodies, numbers, shapes)
    findings.sort(key=lambda finding: _ORDER[finding.severity])
    return UrdfAudit(name=what, bodies=tuple(numbers), findings=tuple(findings))


def _shapes(
    root: Any, what: str, folders: Sequence[Path], failed: list[str]
) -> Iterator[tuple[str, Shapes]]:
    """Yield the hulls of each link's geometry that has a volume; list what cannot be read."""
    for link in root.findall("link"):
        points = {}
        for kind in ("collision", "visual"):
            try:
                shapes = link_shapes(link, kind, what, folders)
            except ModelError as cause:
                shapes = []
                failed.append(str(cause))
            points[kind] = np.concatenate([np.empty((0, 3)), *(each.points() for each in shapes)])
        whole = _hull(np.concatenate([points["collision"], points["visual"]]))
        if whole is not None:
            yield link.get("name", ""), Shapes(_hull(points["collision"]) or whole, whole)


def _hull(points: Array) -> Hull | None:
    try:
        return Hull.of(points, "geometry")
    except DataError:
        return None
