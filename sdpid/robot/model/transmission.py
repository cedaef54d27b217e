"""Transmissions: how the joints of a tree follow the motors whose positions are recorded."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen, real_array
from sdpid._common.files import load_toml
from sdpid._common.tables import Shown, Table, plain_dict
from sdpid.errors import ModelError
from sdpid.robot.model.model import RobotModel

# Motors that are dependent by more than this share cannot be told apart by any motion.
_RANK = 1e-9
# Factors of joints below this are rounding.
_ROUNDED = 1e-12
# Factors of joints in the length of a tendon.
Lengths = Mapping[str, float]
# Of ROS: number of joints, and factors of motor 1 and 2 in joint 1, of motor 2 in joint 2.
_KINDS: dict[str, tuple[int, float, float, float]] = {
    "SimpleTransmission": (1, 1.0, 0.0, 0.0),
    "DifferentialTransmission": (2, 0.5, 0.5, -0.5),
    "FourBarLinkageTransmission": (2, 1.0, 0.0, 1.0),
}


@dataclass(frozen=True, eq=False, repr=False)
class Transmission(Shown):
    """Positions of joints as linear functions of those of motors, ``q = matrix @ m + offset``.

    Efforts follow by the principle of virtual work: those of the motors are ``matrix.T`` times
    those of the joints. A joint that mimics another, a coupled wrist, a differential, or the bars
    of a parallelogram, written as joints that depend on others, are all such matrices.

    Parameters
    ----------
    matrix : array_like, shape (joints, motors)
        One row a joint of the robot, in the order of `joints`; of full column rank.
    offset : array_like, shape (joints,), optional
        Positions of the joints while the motors are at zero, rad or m.
    names : sequence of str, optional
        Of the motors, as they are called in recordings; by default ``motor_1``, ``motor_2``, ...
    joints : sequence of str, optional
        What the rows are of; by default the robot's joints in its order. Joints that are not named
        are moved by a motor of their own name.

    Raises
    ------
    ModelError
        When shapes do not fit, numbers are not finite, names repeat, or motors move the joints
        alike.

    Examples
    --------
    >>> wrist = sdpid.Transmission([[1.0, 0.0], [1.0, 1.0]], joints=("joint_5", "joint_6"))
    >>> robot = sdpid.load_robot("denso_vp6242", transmission=wrist)
    >>> robot.joint_names[-2:], robot.tree_joints[-2:]
    (('motor_1', 'motor_2'), ('joint_5', 'joint_6'))
    """

    matrix: Array
    offset: Array | None = None
    names: tuple[str, ...] | None = None
    joints: tuple[str, ...] | None = None

    def __init__(
        self,
        matrix: ArrayLike,
        offset: ArrayLike | None = None,
        names: Sequence[str] | None = None,
        joints: Sequence[str] | None = None,
    ) -> None:
        table = real_array(matrix, "transmission: matrix", ndim=2, error=ModelError)
        rows, columns = table.shape
        shift = np.zeros(rows) if offset is None else offset
        shift = real_array(shift, "transmission: offset", ndim=1, error=ModelError)
        motors = [f"motor_{k + 1}" for k in range(columns)] if names is None else list(names)
        if len(shift) != rows:
            raise ModelError(
                f"transmission: offset has {len(shift)} numbers for {rows} rows; give one each."
            )
        for what, given, count in (("names", motors, columns), ("joints", joints, rows)):
            if given is not None and (len(given) != count or len(set(given)) != count):
                raise ModelError(
                    f"transmission: {what} are {', '.join(map(str, given))}; give {count} names, "
                    "all different."
                )
        singular = np.linalg.svd(table, compute_uv=False) if table.size else np.zeros(1)
        if columns > rows or not singular[-1] > _RANK * singular[0]:
            raise ModelError(
                f"transmission: {columns} motors move the {rows} joints in "
                f"{np.linalg.matrix_rank(table)} ways; leave dependent motors out, so that the "
                "matrix has full column rank."
            )
        for name, value in (
            ("matrix", frozen(table)),
            ("offset", frozen(shift)),
            ("names", tuple(motors)),
            ("joints", None if joints is None else tuple(joints)),
        ):
            object.__setattr__(self, name, value)

    def _shown(self) -> dict[str, object]:
        return {"motors": ", ".join(self.names or ()), "joints": len(self.matrix)}

    def _tables(self) -> list[Table]:
        count = range(1, len(self.matrix) + 1)
        columns: dict[str, Any] = {"joint": list(self.joints or count)}
        factors = zip(self.names or (), self.matrix.T.tolist(), strict=True)
        shift = np.zeros(len(self.matrix)) if self.offset is None else self.offset
        return [Table.of_columns({**columns, **dict(factors), "offset": shift.tolist()})]

    @classmethod
    def of(cls, given: Any) -> Transmission:
        """Return a transmission from itself, a TOML file or what such a file holds.

        A file has a table ``joints`` with the motors' factors and an ``offset`` for each joint::

            [joints.joint_6]
            motor_5 = 1.0
            motor_6 = -0.5
            offset = 0.1

        Or it has `matrix`, `offset`, `names` and `joints`, as `to_dict` gives them.

        Raises
        ------
        ModelError
            When it is none of these.
        """
        if isinstance(given, cls):
            return given
        what = "transmission"
        if isinstance(given, str | os.PathLike):
            what, given = str(given), load_toml(given, ModelError)
        if isinstance(given, Mapping) and "matrix" in given:
            if unknown := sorted(map(str, given.keys() - {each.name for each in fields(cls)})):
                raise ModelError(f"{what}: has {', '.join(unknown)}, which is not known.")
            return cls(**given)
        rows = given.get("joints") if isinstance(given, Mapping) else None
        if not isinstance(rows, Mapping) or not rows or set(given) - {"joints"}:
            raise ModelError(
                f"{what}: give a table 'joints' of tables, such as "
                "[joints.joint_6] with motor_5 = 1.0, motor_6 = -0.5."
            )
        for joint, row in rows.items():
            good = isinstance(row, Mapping) and all(
                isinstance(x, int | float) and not isinstance(x, bool) for x in row.values()
            )
            if not good:
                raise ModelError(f"{what}: joints.{joint} is {row!r:.80}; give numbers by motors.")
        names = list(dict.fromkeys(m for row in rows.values() for m in row if m != "offset"))
        matrix = [[row.get(name, 0.0) for name in names] for row in rows.values()]
        offset = [row.get("offset", 0.0) for row in rows.values()]
        return cls(matrix, offset, names, tuple(rows))

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, which `of` takes."""
        return plain_dict(vars(self))

    def applied(self, robot: RobotModel) -> RobotModel:
        """Return a robot whose coordinates are those of the motors.

        Joints that mimic another, and are named, follow the motors in place of it.

        Raises
        ------
        ModelError
            When the robot does not have these joints, or its base floats.
        """
        assert self.names is not None
        assert self.offset is not None
        own, tree = robot.joint_names, robot.tree_joints
        if robot.n_base or robot.loops or robot.transmission is not None:
            raise ModelError(
                f"transmission: '{robot.name}' has a floating base or loops, or a transmission "
                "already, which are not supported; describe its joints as a tree on a fixed base."
            )
        joints = own if self.joints is None else self.joints
        if unknown := [name for name in joints if name not in tree]:
            raise ModelError(
                f"transmission: '{robot.name}' has no joint {', '.join(unknown)}; it has "
                f"{', '.join(tree)}."
            )
        if len(joints) != len(self.matrix):
            raise ModelError(
                f"transmission: {len(self.matrix)} rows for the {len(own)} joints of "
                f"'{robot.name}': {', '.join(own)}; give one each, or name the joints."
            )
        others = [name for name in own if name not in joints]
        # A joint that no row names has a motor of its own, in the place of that joint.
        names, taken = [], False
        for name in own:
            if name in others:
                names.append(name)
            elif not taken:
                names += self.names
                taken = True
        if repeated := [name for name in self.names if name in others]:
            raise ModelError(
                f"transmission: {', '.join(repeated)} is a motor, and a joint that no row names."
            )
        if not taken:
            raise ModelError(
                f"transmission: {', '.join(joints)} mimic joints that no row names; name these too."
            )
        matrix, offset = np.zeros((len(own), len(names))), np.zeros(len(own))
        for name in others:
            matrix[own.index(name), names.index(name)] = 1.0
        columns = [names.index(name) for name in self.names]
        for name, row, shift in zip(joints, self.matrix, self.offset, strict=True):
            if name in own:
                matrix[own.index(name), columns], offset[own.index(name)] = row, shift
        expansion = robot.expansion @ matrix
        offset = robot.expansion @ offset + robot.offset
        for name, row, shift in zip(joints, self.matrix, self.offset, strict=True):
            expansion[tree.index(name)], offset[tree.index(name)] = 0.0, shift
            expansion[tree.index(name), columns] = row
        return replace(
            robot,
            joint_names=tuple(names),
            expansion=frozen(expansion),
            offset=frozen(offset),
            transmission=Transmission(self.matrix, self.offset, self.names, joints).to_dict(),
        )


def of_lengths(
    robot: RobotModel, motors: Mapping[str, Lengths], kept: Iterable[tuple[Lengths, float]]
) -> Transmission | None:
    """Return the transmission of an MJCF's fixed tendons; None where joints are independent.

    Parameters
    ----------
    robot : RobotModel
        Whose joints they move; some may mimic others.
    motors : mapping
        Factors by joint of the tendons that motors pull, by the motors' names.
    kept : iterable
        Factors of tendons whose length stays what it is, and these lengths.

    Raises
    ------
    ModelError
        When motors are too few or too many, or what is kept holds joints still.
    """
    tree, E = robot.tree_joints, robot.expansion

    def row(factors: Lengths) -> Array:
        return np.array([factors.get(name, 0.0) for name in tree])

    # What joints follow already: those that mimic others.
    fixed = [(row(lengths), value) for lengths, value in kept]
    for k, name in enumerate(tree):
        if name not in robot.joint_names:
            sources = {robot.joint_names[j]: -E[k, j] for j in np.flatnonzero(E[k]).tolist()}
            fixed.append((row({name: 1.0} | sources), float(robot.offset[k])))
    pulled = {motor: row(lengths) for motor, lengths in motors.items()}
    if not pulled and len(fixed) == len(tree) - robot.n:
        return None
    rows, names = [each for each, _ in fixed] + list(pulled.values()), [*pulled]
    if rows and np.linalg.matrix_rank(rows) < len(rows):
        raise ModelError(
            f"transmission: tendons of '{robot.name}' ({', '.join(names) or 'kept'}) move its "
            "joints alike; leave out those that follow from others."
        )
    for name in robot.joint_names:
        # Joints of their own: what no tendon pulls, or moves only with a joint before it.
        if np.linalg.matrix_rank([*rows, row({name: 1.0})]) > len(rows):
            rows.append(row({name: 1.0}))
            names.append(name)
    inverse = np.linalg.inv(rows)
    matrix = np.where(np.abs(inverse) > _ROUNDED, inverse, 0.0)
    values = np.array([value for _, value in fixed])
    first = {
        name: min(np.flatnonzero(matrix[:, len(fixed) + k]).tolist())
        for k, name in enumerate(names)
    }
    order = sorted(range(len(names)), key=lambda k: first[names[k]])
    columns = [len(fixed) + k for k in order]
    offset = matrix[:, : len(fixed)] @ values
    return Transmission(matrix[:, columns], offset, [names[k] for k in order], tree)


def of_elements(root: Any, what: str) -> Transmission:
    """Return the transmission that elements ``<transmission>`` of a URDF say, as ROS reads them.

    Raises
    ------
    ModelError
        When there are none, or one is of a kind that is not known.
    """
    rows: dict[str, dict[str, float]] = {}
    for element in root.iter("transmission"):
        name = element.get("name", "?")
        kind = "".join(element.findtext(t) or "" for t in ("type", "plugin")) or element.get(
            "type", ""
        )
        joints, motors = (_ends(element, mark, f"{what}: {name}") for mark in ("joint", "actuator"))
        known = _KINDS.get(kind.strip().rpartition("/")[2])
        if known is None or (len(joints), len(motors)) != (known[0], known[0]):
            raise ModelError(
                f"{what}: transmission '{name}' is of the kind {kind.strip()!r:.80} with "
                f"{len(joints)} joints and {len(motors)} actuators; known are "
                f"{', '.join(_KINDS)} of one or two each."
            )
        (j, j_ratio, shift), (m, m_ratio, _) = joints[0], motors[0]
        if len(joints) == 1:
            rows[j] = {m: 1.0 / (m_ratio * j_ratio), "offset": shift}
            continue
        (j2, j2_ratio, shift2), (m2, m2_ratio, _) = joints[1], motors[1]
        half, both, other = known[1:]
        rows[j] = {m: half / (m_ratio * j_ratio), m2: both / (m2_ratio * j_ratio), "offset": shift}
        first = half / m_ratio if both else -half / (m_ratio * j_ratio)
        rows[j2] = {m: first / j2_ratio, m2: other / (m2_ratio * j2_ratio), "offset": shift2}
    if not rows:
        raise ModelError(f"{what}: has no <transmission>; give transmission= as numbers.")
    return Transmission.of({"joints": rows})


def _ends(element: Any, mark: str, what: str) -> list[tuple[str, float, float]]:
    """Return names, reductions and offsets of a transmission's joints or actuators by role."""
    found = []
    for number, each in enumerate(element.findall(mark), 1):
        role = each.findtext("role") or each.get("role") or f"{mark}{number}"
        texts = [each.findtext(tag) for tag in ("mechanicalReduction", "mechanical_reduction")]
        try:
            ratio = float(next((text for text in texts if text), "1"))
            shift = float(each.findtext("offset") or "0")
        except ValueError:
            ratio, shift = 0.0, 0.0
        if not ratio or not np.isfinite([ratio, shift]).all():
            raise ModelError(
                f"{what}: reduction or offset of {mark} '{each.get('name')}' is no finite number, "
                "or a reduction of zero."
            )
        found.append((role.strip(), (str(each.get("name")), ratio, shift)))
    return [end for _, end in sorted(found)]
