"""Transmissions: how the joints of a tree follow the motors whose positions are recorded."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen, real_array
from sdpid._common.files import load_toml
from sdpid._common.tables import Shown, Table, plain_dict
from sdpid.errors import ModelError
from sdpid.robot.description.urdf import Kept
from sdpid.robot.model.model import RobotModel, independent_rows

# Motors that are dependent by more than this share cannot be told apart by any motion.
_RANK = 1e-9
# Factors of joints below this are rounding.
_ROUNDED = 1e-12
# Factors of joints in the length of a tendon.
Lengths = Mapping[str, float]
# Of ROS: factors of the actuators, less their reductions, in the joints, less theirs.
_KINDS: dict[str, list[list[float]]] = {
    "SimpleTransmission": [[1.0]],
    "DifferentialTransmission": [[0.5, 0.5], [0.5, -0.5]],
    "FourBarLinkageTransmission": [[1.0, 0.0], [-1.0, 1.0]],
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
    offset: Array
    names: tuple[str, ...]
    joints: tuple[str, ...] | None

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
            if given is None:
                continue
            strings = all(isinstance(each, str) for each in given)
            if not strings or len(given) != count or len(set(given)) != count:
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
        return {"motors": ", ".join(self.names), "joints": len(self.matrix)}

    def _tables(self) -> list[Table]:
        columns: dict[str, Any] = {"joint": self.joints or range(1, len(self.matrix) + 1)}
        columns |= zip(self.names, self.matrix.T.tolist(), strict=True)
        return [Table.of_columns({**columns, "offset": self.offset.tolist()})]

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
        """Return a robot whose coordinates are those of the motors, and which says so.

        Joints that follow another, and are named, follow the motors in place of it.

        Raises
        ------
        ModelError
            When the robot does not have these joints.
        """
        if robot.transmission is not None:
            raise ModelError(
                f"transmission: '{robot.name}' has one already; load it without, and say both at "
                "once."
            )
        joints = robot.joint_names[robot.n_base :] if self.joints is None else self.joints
        if len(joints) != len(self.matrix):
            raise ModelError(
                f"transmission: {len(self.matrix)} rows for the {len(joints)} joints of "
                f"'{robot.name}': {', '.join(joints)}; give one each, or name the joints."
            )
        said = Transmission(self.matrix, self.offset, self.names, joints)
        return replace(said._moving(robot, joints), transmission=said.to_dict())

    def _moving(self, robot: RobotModel, joints: Sequence[str]) -> RobotModel:
        """Return a robot whose joints follow the motors."""
        own, tree, base = robot.joint_names, robot.tree_joints, robot.n_base
        if unknown := [name for name in joints if name not in tree[base:]]:
            raise ModelError(
                f"transmission: '{robot.name}' has no joint {', '.join(unknown)}; it has "
                f"{', '.join(tree[base:])}."
            )
        # A joint that no row names has a motor of its own; those of others are in the place of the
        # first that is named.
        names = [name for name in own if name not in joints]
        if repeated := [name for name in self.names if name in names]:
            raise ModelError(
                f"transmission: {', '.join(repeated)} is a motor, and a joint that no row names."
            )
        place = next((k for k, name in enumerate(own) if name in joints), None)
        if place is None:
            raise ModelError(
                f"transmission: {', '.join(joints)} follow joints that no row names; name these "
                "too."
            )
        names[place:place] = self.names
        rows = np.zeros((len(joints), len(names)))
        rows[:, place : place + len(self.names)] = self.matrix
        given = dict(zip(joints, zip(rows, self.offset, strict=True), strict=True))
        unit = dict(zip(names, np.eye(len(names)), strict=True))
        # What the coordinates before are of those now; joints that follow them go along.
        before = [given.get(name) or (unit[name], 0.0) for name in own]
        expansion = robot.expansion @ np.array([row for row, _ in before])
        offset = robot.offset + robot.expansion @ np.array([shift for _, shift in before])
        for name, (row, shift) in given.items():
            expansion[tree.index(name)], offset[tree.index(name)] = row, shift
        return replace(
            robot, joint_names=tuple(names), expansion=frozen(expansion), offset=frozen(offset)
        )


def of_lengths(
    robot: RobotModel, kept: Sequence[Kept], motors: Mapping[str, Lengths]
) -> Transmission:
    """Return the transmission of joints that hold each other, and of an MJCF's fixed tendons.

    Parameters
    ----------
    robot : RobotModel
        Whose joints they are, each still a coordinate.
    kept : sequence of Kept
        What stays as it is: joints that mimic others, and tendons of a length.
    motors : mapping
        Factors by joint of the tendons that motors pull, by the motors' names.

    Raises
    ------
    ModelError
        When joints follow none or themselves, motors are too few or too many, or what is kept
        holds joints still.
    """
    tree = robot.tree_joints[robot.n_base :]

    rows = [
        np.array([lengths.get(name, 0.0) for name in tree])
        for lengths in (*(each.factors for each in kept), *motors.values())
    ]
    for number, (factors, _, follower) in enumerate(kept, 1):
        if follower is None:
            continue
        if unknown := [name for name in factors if name not in tree]:
            raise ModelError(f"joint '{follower}' mimics '{unknown[0]}', which is no moving joint.")
        if np.linalg.matrix_rank(rows[:number]) < number:
            raise ModelError(f"mimic joints repeat each other in a circle at '{follower}'.")
    if np.linalg.matrix_rank(rows) < len(rows):
        raise ModelError(
            f"transmission: tendons of '{robot.name}' ({', '.join(motors) or 'kept'}) move its "
            "joints alike; leave out those that follow from others."
        )
    # Joints of their own: what nothing holds or pulls, or only with a joint before it.
    followers, count = {each.follower for each in kept}, len(rows)
    order = sorted(range(len(tree)), key=lambda k: tree[k] in followers)
    whole = np.vstack([*rows, np.eye(len(tree))])
    system = whole[(own := independent_rows(whole, [*range(count), *(count + k for k in order)]))]
    free = [k - count for k in own[count:]]
    rest = [k for k in range(len(tree)) if k not in free]
    inverse = np.linalg.inv(system[: len(rows), rest])
    # Columns of what is kept, of the motors, and of the joints of their own.
    whole = np.zeros((len(tree), len(rows) + len(free)))
    whole[rest] = np.hstack([inverse, -inverse @ system[: len(rows), free]])
    whole[free, len(rows) + np.arange(len(free))] = 1.0
    whole = np.where(np.abs(whole) > _ROUNDED, whole, 0.0)
    names = [*motors, *(tree[k] for k in free)]
    matrix = whole[:, len(kept) :]
    places = [*np.argmax(matrix[:, : len(motors)] != 0.0, axis=0).tolist(), *free]
    listed = np.argsort(places, kind="stable")
    offset = whole[:, : len(kept)] @ np.array([each.value for each in kept])
    return Transmission(matrix[:, listed], offset, [names[k] for k in listed], tree)


def factors_of(robot: RobotModel, way: Array) -> dict[str, float]:
    """Return the factors of `RobotModel.independent` joints in a sum of coordinates (joints,).

    Those of a floating base are not among the coordinates.
    """
    own = [k for k in robot.independent() if k >= robot.n_base]
    found = np.linalg.solve(robot.expansion[own][:, robot.n_base :].T, way)
    names = (robot.tree_joints[k] for k in own)
    return {name: float(x) for name, x in zip(names, found, strict=True) if abs(x) > _ROUNDED}


def followers(robot: RobotModel) -> Iterator[tuple[str, dict[str, float], float]]:
    """Yield each joint that follows `RobotModel.independent` ones, their factors, its offset."""
    own = robot.independent()
    for row in (k for k in range(len(robot.expansion)) if k not in own):
        sources = factors_of(robot, robot.expansion[row, robot.n_base :])
        offset = float(robot.offset[row]) - robot.way(sources)[1]
        yield robot.tree_joints[row], sources, offset


def following(robot: RobotModel, kept: Sequence[Kept]) -> RobotModel:
    """Return a robot whose joints hold each other as its description says."""
    joints = robot.tree_joints[robot.n_base :]
    return of_lengths(robot, kept, {})._moving(robot, joints) if kept else robot


def of_elements(root: Any, what: str) -> Transmission:
    """Return the transmission that elements ``<transmission>`` of a URDF say, as ROS reads them.

    Raises
    ------
    ModelError
        When there are none, one is of a kind that is not known, or two move a joint in different
        ways.
    """
    rows: dict[str, dict[str, float]] = {}
    owners: dict[str, str] = {}
    for element in root.iter("transmission"):
        name = element.get("name", "?")
        kind = "".join(element.findtext(t) or "" for t in ("type", "plugin")) or element.get(
            "type", ""
        )
        joints, motors = (_ends(element, mark, f"{what}: {name}") for mark in ("joint", "actuator"))
        short = kind.strip().rpartition("/")[2]
        gears = np.array(_KINDS.get(short, np.zeros((0, 0))))
        if not len(gears) or gears.shape != (len(joints), len(motors)):
            raise ModelError(
                f"{what}: transmission '{name}' is of the kind {kind.strip()!r:.80} with "
                f"{len(joints)} joints and {len(motors)} actuators; known are "
                f"{', '.join(_KINDS)} of one or two each."
            )
        gears = gears / [ratio for _, ratio, _ in motors]
        if short.startswith("FourBar"):
            # Its second joint turns against the first.
            gears[1, 0] /= joints[0][1]
        names = [name for name, _, _ in motors]
        for (joint, ratio, shift), row in zip(joints, gears.tolist(), strict=True):
            own = {name: x / ratio for name, x in zip(names, row, strict=True)} | {"offset": shift}
            if rows.setdefault(joint, own) != own:
                raise ModelError(
                    f"{what}: transmissions '{owners[joint]}' and '{name}' move joint '{joint}', "
                    "each in its own way; leave one of them out, or give transmission= as numbers."
                )
            owners[joint] = name
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
