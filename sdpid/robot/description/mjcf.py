"""MJCF files, compiled by MuJoCo in a child process and turned into a Pinocchio model.

MuJoCo's parser trusts its input: a file that includes itself crashes the process, and a large
``<replicate>`` never ends. Untrusted files are therefore parsed in a child process with limits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.extras import require
from sdpid._common.sandbox import run_in_sandbox
from sdpid.errors import ModelError
from sdpid.robot.description.loops import Closure
from sdpid.robot.description.urdf import Mimic
from sdpid.robot.inertia import theta_from_physical, transform

# A scene of a humanoid with meshes compiles in some seconds.
TIMEOUT = 60.0


def parsed(text: str, path: str | None, what: str) -> Any:
    """Return MuJoCo's ``MjSpec`` of a file, or of a text; only within a child process.

    Raises
    ------
    ModelError
        When MuJoCo cannot parse it.
    MissingExtraError
        When MuJoCo is not installed (extra ``sim``).
    """
    mujoco = require("mujoco", extra="sim")
    try:
        return mujoco.MjSpec.from_string(text) if path is None else mujoco.MjSpec.from_file(path)
    except (ValueError, RuntimeError) as cause:
        raise ModelError(f"{what}: MuJoCo cannot parse it ({_line(cause)}).") from None


def compiled(text: str, path: str | None, folder: str | None, what: str) -> Any:
    """Return MuJoCo's ``MjModel`` of a file, or of a text with files in a folder."""
    spec = parsed(text, path, what)
    if folder is not None:
        spec.modelfiledir = folder
    try:
        return spec.compile()
    except (ValueError, RuntimeError) as cause:
        raise ModelError(f"{what}: MuJoCo cannot compile it ({_line(cause)}).") from None


def _line(cause: Exception) -> str:
    return " ".join(str(cause).split())


def in_child(function: Callable[..., Any], *arguments: Any, what: str) -> Any:
    """Call a function that reads MJCF in a child process with limits, and return its result.

    Raises
    ------
    ModelError
        When MuJoCo refuses the file, crashes, or takes more than its time or memory.
    MissingExtraError
        When MuJoCo is not installed (extra ``sim``).
    """
    return run_in_sandbox(
        function, *arguments, what, subject=what, error=ModelError, timeout=TIMEOUT
    )


# What a fixed tendon adds to its joints.
_OF_TENDONS = ("armature", "damping", "frictionloss")


@dataclass(frozen=True, eq=False)
class MjcfBody:
    """A compiled body.

    Attributes
    ----------
    name : str
        Its name, which may be empty.
    carrier : int
        Pinocchio's joint that carries it, 0 for the world.
    placement : ndarray, shape (4, 4)
        Its frame in that joint's.
    theta : ndarray, shape (10,)
        Its parameters in its own frame; zero without mass.
    joints : tuple of int
        Pinocchio's joints that are its own.
    """

    name: str
    carrier: int
    placement: Array
    theta: Array
    joints: tuple[int, ...]


@dataclass(frozen=True)
class MjcfTendon:
    """A fixed tendon over two joints, of length ``factors[0]·q1 + factors[1]·q2``."""

    joints: tuple[str, str]
    factors: tuple[float, float]
    armature: float
    damping: float
    frictionloss: float


@dataclass(frozen=True, eq=False)
class MjcfModel:
    """A compiled MJCF.

    Attributes
    ----------
    pin_model : pinocchio.Model
        A joint for every hinge, slide and free joint.
    bodies : tuple of MjcfBody
        In MuJoCo's order, the world first.
    joint_values : dict
        ``armature``, ``damping`` and ``frictionloss`` by joint name.
    mimics : tuple of Mimic
        Joints that an active equality makes follow another.
    closures : tuple of Closure
        Loops that active equalities close.
    others : tuple of str
        Kinds of the other active equalities.
    passive : tuple of str
        Joints that no actuator moves; none where that is not plain.
    tendons : tuple of MjcfTendon
        Fixed tendons over two joints.
    forces : tuple of str
        Springs and compensated gravity, which no term of a robot stands for, in words.
    actuators : tuple of str
        Actuators that do not pass their control on as a joint's effort, in words.
    """

    pin_model: Any
    bodies: tuple[MjcfBody, ...]
    joint_values: dict[str, dict[str, float]]
    mimics: tuple[Mimic, ...]
    closures: tuple[Closure, ...]
    others: tuple[str, ...]
    passive: tuple[str, ...]
    tendons: tuple[MjcfTendon, ...] = ()
    forces: tuple[str, ...] = ()
    actuators: tuple[str, ...] = ()


def read_mjcf(
    text: str,
    what: str,
    *,
    path: Path | None = None,
    folder: Path | None = None,
    trusted: bool = False,
) -> MjcfModel:
    """Return a compiled MJCF.

    Every hinge and slide becomes a joint with the angle that MuJoCo gives it (``ref`` included);
    a body with several gets links without mass in between. Bodies without joints are part of what
    carries them.

    Parameters
    ----------
    text : str
        The file.
    what : str
        What it is called in messages.
    path : Path, optional
        Where it is, for what it includes.
    folder : Path, optional
        Where the names of its meshes start, for a text.
    trusted : bool, optional
        Compile it in this process: text of our own.

    Raises
    ------
    ModelError
        When MuJoCo cannot compile it, or it has ball joints.
    MissingExtraError
        When MuJoCo is not installed (extra ``sim``).
    """
    places = (
        None if path is None else str(path.resolve()),
        None if folder is None else str(folder),
    )
    if trusted:
        found = _numbers(text, *places, what)
    else:
        found = in_child(_numbers, text, *places, what=what)
    return _Build(found, what).result()


def pinocchio_from_mjcf(text: str, path: Path | None, what: str) -> MjcfModel:
    """Return the Pinocchio model of an MJCF file, joints that mimic others, and what loops close.

    Raises
    ------
    ModelError
        When MuJoCo cannot compile it, or it has ball joints or equalities of another kind.
    MissingExtraError
        When MuJoCo is not installed (extra ``sim``).
    """
    found = read_mjcf(text, what, path=path)
    if found.others:
        raise ModelError(
            f"{what}: has a {found.others[0]} equality, which is not supported; supported are "
            "linear equalities of two joints, and connect and weld of two bodies. Remove it, or "
            "set active='false'."
        )
    return found


def _numbers(text: str, path: str | None, folder: str | None, what: str) -> dict[str, Any]:
    """Return the numbers of a compiled model that make its kinematics and inertias."""
    mujoco = require("mujoco", extra="sim")
    model = compiled(text, path, folder, what)
    arrays = (
        *("body_parentid", "body_pos", "body_quat", "body_mass", "body_ipos", "body_iquat"),
        *("body_inertia", "body_jntadr", "body_jntnum", "jnt_type", "jnt_pos", "jnt_axis"),
        *("jnt_range", "jnt_limited", "jnt_actfrcrange", "jnt_actfrclimited", "eq_type"),
        *("eq_active0", "eq_obj1id", "eq_obj2id", "eq_data", "eq_objtype"),
        *("tendon_adr", "tendon_num", *(f"tendon_{key}" for key in _OF_TENDONS)),
        *("wrap_type", "wrap_objid", "wrap_prm", "jnt_stiffness", "tendon_stiffness"),
        *("body_gravcomp", "actuator_gainprm", "actuator_biasprm", "actuator_gear"),
    )
    for name in (*arrays, "qpos0", "qpos_spring", *(f"dof_{key}" for key in _OF_TENDONS)):
        if not np.isfinite(np.asarray(getattr(model, name), dtype=np.float64)).all():
            raise ModelError(f"{what}: {name} is not finite in MuJoCo's model; repair the file.")
    if not np.isfinite(model.opt.gravity).all():
        raise ModelError(f"{what}: gravity is {model.opt.gravity}; give finite numbers, m/s².")
    found: dict[str, Any] = {name: np.asarray(getattr(model, name)).tolist() for name in arrays}
    found["ref"] = [float(model.qpos0[at]) for at in model.jnt_qposadr]
    found["springref"] = [float(model.qpos_spring[at]) for at in model.jnt_qposadr]
    found["dof"] = {
        key: [float(getattr(model, f"dof_{key}")[at]) for at in model.jnt_dofadr]
        for key in ("armature", "damping", "frictionloss")
    }
    found["gravity"] = [float(x) for x in model.opt.gravity]
    found["name"] = str(model.names.split(b"\0")[0].decode("utf-8", "replace"))
    found["bodies"] = [str(model.body(i).name) for i in range(model.nbody)]
    found["joints"] = [str(model.joint(i).name) for i in range(model.njnt)]
    found["kinds"] = {
        kind: int(getattr(mujoco.mjtJoint, f"mjJNT_{kind.upper()}"))
        for kind in ("free", "ball", "slide", "hinge")
    }
    found["names_of_equalities"] = [str(model.equality(i).name) for i in range(model.neq)]
    found["actuators"] = [str(model.actuator(i).name) for i in range(model.nu)]
    found["bodies_of_sites"] = [
        [int(model.site_bodyid[i]), model.site_pos[i].tolist(), model.site_quat[i].tolist()]
        for i in range(model.nsite)
    ]
    found["site"] = int(mujoco.mjtObj.mjOBJ_SITE)
    # What moves joints alone; other actuators pull at tendons, bodies and sites.
    plain = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    found["actuated"] = None
    if model.nu and all(int(kind) in plain for kind in model.actuator_trntype):
        found["actuated"] = [int(i) for i in model.actuator_trnid[:, 0]]
    found["wrap_joint"] = int(mujoco.mjtWrap.mjWRAP_JOINT)
    found["equalities"] = {
        str(int(getattr(mujoco.mjtEq, f"mjEQ_{kind.upper()}"))): kind
        for kind in ("connect", "weld", "joint", "tendon", "flex")
    }
    return found


def _joint_names(found: dict[str, Any]) -> list[str]:
    """Return a name for every joint; MuJoCo's may be empty."""
    owners: dict[int, int] = {}
    for body, (first, count) in enumerate(
        zip(found["body_jntadr"], found["body_jntnum"], strict=True)
    ):
        owners |= dict.fromkeys(range(first, first + count), body)
    return [
        name or f"{found['bodies'][owners[i]] or f'body_{owners[i]}'}_joint_{i}"
        for i, name in enumerate(found["joints"])
    ]


def _equalities(
    found: dict[str, Any],
) -> tuple[tuple[Mimic, ...], tuple[Closure, ...], tuple[str, ...]]:
    """Return active equalities as mimics and as closures, and the kinds of the others."""
    names = _joint_names(found)
    mimics, closures, others = [], [], []
    keys = ("type", "active0", "obj1id", "obj2id", "data")
    columns = [found[f"eq_{key}"] for key in keys]
    for number, (kind, active, first, second, data) in enumerate(zip(*columns, strict=True)):
        name = found["equalities"].get(str(kind), "strange")
        if not active:
            continue
        if name in ("connect", "weld"):
            closures.append(_closure(found, number, name))
        elif name != "joint" or second < 0 or any(data[2:5]):
            others.append(name)
        else:
            # q1 − ref1 = c0 + c1·(q2 − ref2)
            offset = found["ref"][first] + data[0] - data[1] * found["ref"][second]
            mimics.append(Mimic(names[first], names[second], data[1], offset))
    return tuple(mimics), tuple(closures), tuple(others)


def _closure(found: dict[str, Any], number: int, kind: str) -> Closure:
    """Return an equality that keeps two bodies, or sites on them, together."""
    one, two = found["eq_obj1id"][number], found["eq_obj2id"][number]
    data = found["eq_data"][number]
    upright = [1.0, 0.0, 0.0, 0.0]
    if found["eq_objtype"][number] == found["site"]:
        sites = [found["bodies_of_sites"][site] for site in (one, two)]
        ends = [(body, _placement(*place)) for body, *place in sites]
    elif kind == "connect":
        ends = [(one, _placement(data[:3], upright)), (two, _placement(data[3:6], upright))]
    else:
        # The place on the second body, then that on the first, turned as the second is.
        ends = [(one, _placement(data[3:6], data[6:10])), (two, _placement(data[:3], upright))]
    (first, on_first), (second, on_second) = (
        (found["bodies"][body] or f"body_{body}" if body else "universe", place.homogeneous)
        for body, place in ends
    )
    return Closure(
        found["names_of_equalities"][number] or f"{kind}_{number + 1}",
        "point" if kind == "connect" else "plane",
        ((first, on_first), (second, on_second)),
    )


def _tendons(found: dict[str, Any]) -> Iterator[MjcfTendon]:
    """Yield the fixed tendons over two joints."""
    names = _joint_names(found)
    columns = [found[f"tendon_{key}"] for key in ("adr", "num", *_OF_TENDONS)]
    for first, count, *values in zip(*columns, strict=True):
        if count == 2 and found["wrap_type"][first] == found["wrap_joint"]:
            one, two = (names[found["wrap_objid"][k]] for k in (first, first + 1))
            factors = found["wrap_prm"][first], found["wrap_prm"][first + 1]
            yield MjcfTendon((one, two), factors, *values)


def _forces(found: dict[str, Any]) -> Iterator[str]:
    """Yield the forces that act on joints beside gravity, in words."""
    springs = zip(_joint_names(found), found["jnt_stiffness"], found["springref"], strict=True)
    for name, stiffness, rest in springs:
        if stiffness:
            yield f"spring at {name} (stiffness {stiffness:.4g}, springref {rest:.4g})"
    for number, stiffness in enumerate(found["tendon_stiffness"], 1):
        if stiffness:
            yield f"spring of tendon {number} (stiffness {stiffness:.4g})"
    for name, share in zip(found["bodies"], found["body_gravcomp"], strict=True):
        if share:
            yield f"gravcomp {share:.4g} of body {name}"


def _actuators(found: dict[str, Any]) -> Iterator[str]:
    """Yield the actuators whose effort is not their control, in words."""
    keys = ("actuators", "actuator_gainprm", "actuator_biasprm", "actuator_gear")
    for number, (name, gain, bias, gear) in enumerate(zip(*map(found.get, keys), strict=True), 1):
        if gain[0] != 1.0 or gear[0] != 1.0 or any(bias):
            yield f"{name or number} (gain {gain[0]:.4g}, gear {gear[0]:.4g})"


class _Build:
    """Builds a Pinocchio model body by body."""

    def __init__(self, found: dict[str, Any], what: str) -> None:
        import pinocchio as pin

        self.found, self.what = found, what
        self.names = _joint_names(found)
        self.model = pin.Model()
        self.model.name = found["name"] or "robot"
        self.model.gravity.linear = np.array(found["gravity"])
        # For each body, the joint that carries it and its placement in that joint's frame.
        self.carriers: list[tuple[int, Any]] = [(0, pin.SE3.Identity())]
        self.bodies = [MjcfBody("world", 0, np.eye(4), np.zeros(10), ())]
        for body in range(1, len(found["bodies"])):
            self._add(body)

    def result(self) -> MjcfModel:
        """Return the model."""
        values = {
            name: {key: numbers[i] for key, numbers in self.found["dof"].items()}
            for i, name in enumerate(self.names)
        }
        mimics, closures, others = _equalities(self.found)
        moved = self.found["actuated"]
        passive = [] if moved is None else [n for i, n in enumerate(self.names) if i not in moved]
        return MjcfModel(
            pin_model=self.model,
            bodies=tuple(self.bodies),
            joint_values=values,
            mimics=mimics,
            closures=closures,
            others=others,
            passive=tuple(passive),
            tendons=tuple(_tendons(self.found)),
            forces=tuple(_forces(self.found)),
            actuators=tuple(_actuators(self.found)),
        )

    def _add(self, body: int) -> None:
        import pinocchio as pin

        found = self.found
        joint, place = self.carriers[found["body_parentid"][body]]
        place = place * _placement(found["body_pos"][body], found["body_quat"][body])
        first, own_joints = found["body_jntadr"][body], []
        for number in range(first, first + found["body_jntnum"][body]):
            joint, place = self._add_joint(number, joint, place)
            own_joints.append(joint)
        self.carriers.append((joint, place))
        theta, mass = np.zeros(10), found["body_mass"][body]
        if mass > 0.0:
            R = _placement(np.zeros(3), found["body_iquat"][body]).rotation
            inertia = R @ np.diag(found["body_inertia"][body]) @ R.T
            theta = theta_from_physical(mass, found["body_ipos"][body], inertia)
            if joint:
                here = transform(theta, place.rotation, place.translation)
                moved = pin.Inertia.FromDynamicParameters(here)
                self.model.appendBodyToJoint(joint, moved, pin.SE3.Identity())
        name = found["bodies"][body]
        self.bodies.append(MjcfBody(name, joint, place.homogeneous, theta, tuple(own_joints)))
        if not self.model.existBodyName(name or f"body_{body}"):
            self.model.addBodyFrame(name or f"body_{body}", joint, place, 0)

    def _add_joint(self, number: int, parent: int, place: Any) -> tuple[int, Any]:
        """Add a joint that moves a body at `place`; return it and the body's place in it."""
        import pinocchio as pin

        found = self.found
        kinds = {value: kind for kind, value in found["kinds"].items()}
        kind = kinds[found["jnt_type"][number]]
        name, axis = self.names[number], np.array(found["jnt_axis"][number])
        if kind == "free":
            return self.model.addJoint(
                parent, pin.JointModelFreeFlyer(), pin.SE3.Identity(), name
            ), pin.SE3.Identity()
        if kind == "ball":
            raise ModelError(
                f"{self.what}: joint '{name}' is a ball joint, which is not supported; supported "
                "are hinge, slide and a free joint at the root."
            )
        anchor = pin.SE3(np.eye(3), np.array(found["jnt_pos"][number]))
        ref = found["ref"][number]
        if kind == "hinge":
            back = pin.SE3(pin.AngleAxis(-ref, axis).matrix(), np.zeros(3))
        else:
            back = pin.SE3(np.eye(3), -ref * axis)
        limit = [[np.inf], [np.inf], [-np.inf], [np.inf]]
        if found["jnt_actfrclimited"][number]:
            limit[0] = [max(np.abs(found["jnt_actfrcrange"][number]))]
        if found["jnt_limited"][number]:
            limit[2], limit[3] = ([value] for value in found["jnt_range"][number])
        joint = self.model.addJoint(
            parent, _joint_model(kind, axis), place * anchor * back, name, *map(np.array, limit)
        )
        at = self.model.joints[joint].idx_v
        self.model.damping[at] = found["dof"]["damping"][number]
        self.model.friction[at] = found["dof"]["frictionloss"][number]
        self.model.armature[at] = found["dof"]["armature"][number]
        return joint, anchor.inverse()


def _joint_model(kind: str, axis: Array) -> Any:
    """Return Pinocchio's joint about or along an axis, aligned with x, y or z where it is."""
    import pinocchio as pin

    prefix, unaligned = (
        ("JointModelR", pin.JointModelRevoluteUnaligned)
        if kind == "hinge"
        else ("JointModelP", pin.JointModelPrismaticUnaligned)
    )
    for letter, unit in zip("XYZ", np.eye(3), strict=True):
        if np.array_equal(axis, unit):
            return getattr(pin, prefix + letter)()
    return unaligned(axis)


def _placement(position: Any, quaternion: Any) -> Any:
    """Return Pinocchio's placement of MuJoCo's position and quaternion, scalar first."""
    import pinocchio as pin

    w, x, y, z = quaternion
    return pin.SE3(pin.Quaternion(w, x, y, z).normalized().matrix(), np.array(position))


def quaternion_of(rotation: Array) -> Array:
    """Return a rotation matrix as MuJoCo's quaternion, scalar first."""
    import pinocchio as pin

    x, y, z, w = pin.Quaternion(np.asarray(rotation)).normalized().coeffs()
    return np.array([w, x, y, z])
