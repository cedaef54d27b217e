"""Denavit-Hartenberg tables, modified and standard, and their conversion to URDF."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, real_array
from sdpid._common.files import load_toml
from sdpid._common.tables import Settings
from sdpid.errors import ModelError
from sdpid.robot.description.bodies import inertial_element
from sdpid.robot.description.xml import axis_rotation, matrix_rpy, numbers, rpy_matrix

_OPTIONAL = ("a", "lower", "upper", "velocity", "effort")
_KINDS = ("revolute", "prismatic")


@dataclass(frozen=True, kw_only=True)
class DhJoint:
    """One row of a table; the joint variable is added to `theta` or to the length along z.

    Lengths have Khalil's letters, `d` along x and `r` along z, unless a row of the table has an
    `a`: then they are `a` along x and `d` along z, in all of its rows.

    Attributes
    ----------
    alpha, theta : float
        Angles about x and z in rad.
    d, r : float
        Lengths along x and z in m.
    a : float, optional
        Length along x in m, in tables that call the length along z `d`.
    kind : {"revolute", "prismatic"}
        The joint.
    name : str, optional
        By default ``joint_1``, ``joint_2``, … in the table's order.
    lower, upper : float, optional
        Range of the joint variable; without them the joint is unlimited.
    velocity, effort : float, optional
        Largest speed and effort.

    Examples
    --------
    >>> from sdpid.robot.description.dh_table import DhJoint
    >>> rows = (DhJoint(r=0.3), DhJoint(alpha=-1.57, lower=-2.0, upper=2.0))
    >>> sdpid.RobotModel.from_mdh(sdpid.DhTable(joints=rows)).position_limits
    array([[-inf,  inf],
           [ -2.,   2.]])
    """

    alpha: float = 0.0
    d: float = 0.0
    theta: float = 0.0
    r: float = 0.0
    a: float | None = None
    kind: Literal["revolute", "prismatic"] = "revolute"
    name: str | None = None
    lower: float | None = None
    upper: float | None = None
    velocity: float | None = None
    effort: float | None = None

    @classmethod
    def of(cls, row: Any, what: str) -> DhJoint:
        """Return a row of a table from itself or a mapping.

        Raises
        ------
        ModelError
            When it is neither; `what` names its table.
        """
        if isinstance(row, DhJoint):
            return row
        if not isinstance(row, Mapping):
            raise ModelError(
                f"{what}: a row is {row!r}; give a mapping with alpha, theta, d and r or a."
            )
        try:
            return cls(**row)
        except TypeError as cause:
            raise ModelError(f"{what}: a row is not understood ({cause}).") from None

    def faults(self) -> Iterator[str]:
        """Yield what is wrong with the row by itself, in words."""
        if self.kind not in _KINDS:
            yield f"joint kind {self.kind!r} is not supported; use 'revolute' or 'prismatic'"
        for key in ("alpha", "d", "theta", "r", *_OPTIONAL):
            value = getattr(self, key)
            number = isinstance(value, (int, float)) and math.isfinite(value)
            if not (number or (value is None and key in _OPTIONAL)):
                yield f"{key} is {value!r}; give a finite number"
        if (self.lower is None) != (self.upper is None):
            yield "give both limits or neither"
        elif self.lower is not None and self.upper is not None and self.lower > self.upper:
            yield f"lower limit {self.lower} is above the upper limit {self.upper}"


def _screw(axis: int, angle: float, length: float) -> Array:
    """Return the transform (4, 4) that turns about an axis and moves along it."""
    transform = axis_rotation(axis, angle)
    transform[axis, 3] = length
    return transform


@dataclass(frozen=True, kw_only=True, repr=False)
class DhTable(Settings):
    """A Denavit-Hartenberg table.

    With ``convention="modified"`` [khalil2002]_ frame i follows frame i-1 by
    ``Rot(x, alpha) Trans(x, d) Rot(z, theta) Trans(z, r)``; with ``"standard"`` by
    ``Rot(z, theta) Trans(z, r) Trans(x, d) Rot(x, alpha)``. Where rows have an `a`, it stands for
    this d, and their d for this r.

    Attributes
    ----------
    joints : tuple of DhJoint
        From the base to the tip.
    name : str
        The robot's name.
    convention : {"modified", "standard"}
        The convention.
    base_translation, base_rpy : tuple of float
        Placement of frame 0 in the base link, in m and rad.
    gravity : tuple of float
        Gravity in the base link, m/s².

    Examples
    --------
    >>> rows = [{"r": 0.3}, {"alpha": -np.pi / 2}, {"d": 0.4}]
    >>> table = sdpid.DhTable.of(rows, name="arm")
    >>> table.joint_names
    ('joint_1', 'joint_2', 'joint_3')
    >>> table.forward_kinematics([0.0, 0.0, 0.0])[-1, :3, 3].round(3)
    array([0.4, 0. , 0.3])
    >>> sdpid.RobotModel.from_mdh(table)
    RobotModel('arm', 3 coordinates, 3 links)
    """

    joints: tuple[DhJoint, ...]
    name: str = "robot"
    convention: Literal["modified", "standard"] = "modified"
    base_translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    base_rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)

    def __post_init__(self) -> None:
        if not self.joints:
            raise ModelError("kinematic table: it has no joints; give at least one row.")
        if self.convention not in ("modified", "standard"):
            raise ModelError(
                f"kinematic table: convention {self.convention!r}; use 'modified' or 'standard'."
            )
        for i, joint in enumerate(self.joints, 1):
            for words in itertools.chain(joint.faults(), self._doubtful_letters(joint)):
                raise ModelError(f"kinematic table, row {i}: {words}.")
        for key in ("base_translation", "base_rpy", "gravity"):
            what = f"kinematic table: {key}"
            vector = real_array(getattr(self, key), what, ndim=1, error=ModelError)
            if vector.shape != (3,):
                raise ModelError(f"{what} has {vector.size} numbers, give 3.")
            object.__setattr__(self, key, tuple(vector.tolist()))
        names = self.joint_names
        for value in (self.name, *names):
            if not isinstance(value, str):
                raise ModelError(f"kinematic table: the name {value!r} is not text.")
        if len(set(names)) != len(names):
            raise ModelError(f"kinematic table: joint names repeat: {', '.join(names)}.")

    def _doubtful_letters(self, joint: DhJoint) -> Iterator[str]:
        """Yield whether letters of lengths do not tell if they are along x or z."""
        if self._has_a and joint.r:
            yield (
                f"r is {joint.r!r} in a table with lengths a; lengths along x and z are called a "
                "and d, or d and r"
            )
        known = self._has_a or any(each.r for each in self.joints)
        if self.convention == "standard" and joint.d and not known:
            yield (
                f"d is {joint.d!r}, and no row has a or r, so that it is not known whether d is "
                "along z or x; give a beside it where d is along z (a = 0 where there is none), or "
                "a in place of it"
            )

    @property
    def _has_a(self) -> bool:
        """Whether lengths along x and z are called a and d in place of d and r."""
        return any(joint.a is not None for joint in self.joints)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return tuple(joint.name or f"joint_{i + 1}" for i, joint in enumerate(self.joints))

    @classmethod
    def of(
        cls,
        table: DhTable | str | os.PathLike[str] | Mapping[str, Any] | Iterable[Any],
        **changes: Any,
    ) -> DhTable:
        """Return a table from a table, a TOML file, its content, or rows.

        Parameters
        ----------
        table : DhTable, path of a TOML file, mapping, or iterable of DhJoint or mappings
            The table.
        **changes
            Attributes that replace the table's own; None keeps one.

        Raises
        ------
        ModelError
            When it is not understood.
        """
        if isinstance(table, (str, os.PathLike)):
            table = cls.from_toml(table)
        elif isinstance(table, Mapping):
            table = cls.from_mapping(table)
        elif not isinstance(table, DhTable):
            if not isinstance(table, Iterable):
                raise ModelError(f"kinematic table: got {type(table).__name__}; give rows.")
            table = cls(joints=tuple(DhJoint.of(row, "kinematic table") for row in table))
        return replace(table, **{key: value for key, value in changes.items() if value is not None})

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any], *, what: str = "kinematic table") -> DhTable:
        """Build from the content of a TOML file (see ``models/denso_vp6242/kinematics.toml``).

        Raises
        ------
        ModelError
            When a key is missing or unknown.
        """
        rows = data.get("joint")
        if not isinstance(rows, Sequence) or isinstance(rows, (str, bytes)):
            raise ModelError(f"{what}: no [[joint]] rows.")
        base = data.get("base", {})
        if not isinstance(base, Mapping):
            raise ModelError(f"{what}: base is {base!r}; give translation and rpy.")
        return cls(
            joints=tuple(DhJoint.of(row, what) for row in rows),
            name=data.get("name", "robot"),
            convention=data.get("convention", "modified"),
            base_translation=base.get("translation", (0.0, 0.0, 0.0)),
            base_rpy=base.get("rpy", (0.0, 0.0, 0.0)),
            gravity=data.get("gravity", (0.0, 0.0, -9.81)),
        )

    @classmethod
    def from_toml(cls, path: str | os.PathLike[str]) -> DhTable:
        """Read a table from a TOML file."""
        return cls.from_mapping(load_toml(path), what=str(Path(path).name))

    def base_transform(self) -> Array:
        """Return the placement of frame 0 in the base link, shape (4, 4)."""
        transform = np.eye(4)
        transform[:3, :3] = rpy_matrix(self.base_rpy)
        transform[:3, 3] = self.base_translation
        return transform

    def _steps(self, joint: DhJoint, variable: float = 0.0) -> tuple[Array, Array]:
        """Return the transforms of a row up to its joint's motion, that included, and behind it."""
        along_x, along_z = (joint.a or 0.0, joint.d) if self._has_a else (joint.d, joint.r)
        turned, moved = (variable * (joint.kind == kind) for kind in _KINDS)
        about_z = _screw(2, joint.theta + turned, along_z + moved)
        about_x = _screw(0, joint.alpha, along_x)
        if self.convention == "modified":
            return about_x @ about_z, np.eye(4)
        return about_z, about_x

    def forward_kinematics(self, q: ArrayLike) -> Array:
        """Return the placements of frames 1 … n in the base link, shape (n, 4, 4)."""
        transform = self.base_transform()
        frames = []
        for i, variable in enumerate(np.asarray(q, dtype=np.float64)):
            before, behind = self._steps(self.joints[i], float(variable))
            transform = transform @ (before @ behind)
            frames.append(transform)
        return np.stack(frames)

    def joint_placements(self) -> tuple[list[Array], Array]:
        """Return each joint's placement in the link before it, and the tip in the last link.

        A joint frame has the joint's axis along z and moves with the joint. For a modified table
        it is the table's own frame. For a standard one the fixed part after the joint belongs to
        the next placement, and the last of them places the tip.
        """
        last = self.base_transform()
        placements = []
        for joint in self.joints:
            before, behind = self._steps(joint)
            placements.append(last @ before)
            last = behind
        return placements, last

    def to_urdf(self, inertias: ArrayLike | None = None) -> str:
        """Return the URDF of the table.

        Parameters
        ----------
        inertias : array_like, shape (n, 10), optional
            Standard parameters of the links in their joint frames; without them the links have
            no inertial element.

        Returns
        -------
        str
            The URDF. A standard table gets a fixed frame ``tip`` at its last frame.
        """
        from lxml import etree

        robot, n = etree.Element("robot", name=self.name), len(self.joints)
        robot.append(etree.Comment(" Generated from the kinematic table; edit the table. "))
        links = ["base_link", *(f"link_{i + 1}" for i in range(n))]
        elements = [etree.SubElement(robot, "link", name=name) for name in links]
        if inertias is not None:
            bodies = real_array(inertias, "inertias", ndim=2, error=ModelError)
            if bodies.shape != (n, 10):
                raise ModelError(
                    f"inertias: shape {bodies.shape}, expected {(n, 10)}: ten parameters for each "
                    "joint's link."
                )
            for link, body in zip(elements[1:], bodies, strict=True):
                link.append(inertial_element(body))
        placements, tip = self.joint_placements()
        for i, (joint, name) in enumerate(zip(self.joints, self.joint_names, strict=True)):
            limited = joint.lower is not None or joint.kind == "prismatic"
            kind = joint.kind if limited else "continuous"
            element = _joint(robot, name, kind, placements[i], links[i], links[i + 1])
            etree.SubElement(element, "axis", xyz="0 0 1")
            etree.SubElement(element, "limit", _limits(joint))
        if self.convention == "standard":
            etree.SubElement(robot, "link", name="tip")
            _joint(robot, "tip_joint", "fixed", tip, links[-1], "tip")
        etree.indent(robot)
        return str(etree.tostring(robot, xml_declaration=True, encoding="UTF-8"), "utf-8") + "\n"


def _joint(robot: Any, name: str, kind: str, placement: Array, parent: str, child: str) -> Any:
    """Add a joint to a ``<robot>`` and return it."""
    from lxml import etree

    element, rpy = etree.SubElement(robot, "joint", name=name, type=kind), placement[:3, :3]
    etree.SubElement(element, "origin", xyz=numbers(placement[:3, 3]), rpy=numbers(matrix_rpy(rpy)))
    etree.SubElement(element, "parent", link=parent)
    etree.SubElement(element, "child", link=child)
    return element


def _limits(joint: DhJoint) -> dict[str, str]:
    # URDF demands effort and velocity; where the table has none, 1e9 means 'no limit'.
    limits = {"effort": joint.effort or 1e9, "velocity": joint.velocity or 1e9}
    if joint.lower is not None and joint.upper is not None:
        limits |= {"lower": joint.lower, "upper": joint.upper}
    elif joint.kind == "prismatic":
        limits |= {"lower": -1e9, "upper": 1e9}
    return {key: repr(float(value)) for key, value in limits.items()}
