"""MJCF files, compiled by MuJoCo and turned into a Pinocchio model, or read as they are written.

MuJoCo's parser trusts its input: a large ``<replicate>`` never ends. What a file stands for is
counted first, with all that it includes and repeats, and has a limit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sdpid._common.arrays import Array, Mask, frozen
from sdpid._common.extras import require
from sdpid._common.files import read_regular
from sdpid.errors import ModelError
from sdpid.robot.description.bodies import DescribedBody
from sdpid.robot.description.urdf import Closure, Kept
from sdpid.robot.description.xml import MAX_BYTES, parse_xml
from sdpid.robot.friction.position import Spring
from sdpid.robot.inertia import theta_from_physical

# Elements with all that is included and repeated: a scene of a humanoid has some thousands, and
# MuJoCo takes about a minute for this many bodies.
MOST_ELEMENTS = 20_000
# Cells of a height field, pixels of a texture: MuJoCo takes memory for them before any is read.
_MOST_CELLS = 10**8
_CELLS = ("nrow", "ncol", "width", "height")
_REPEATED = ("replicate", "composite", "flexcomp")

# What a fixed tendon adds to its joints.
_OF_TENDONS = ("frictionloss", "damping", "armature")
# Of MuJoCo's model, what is read of it.
_ARRAYS = (
    *("body_pos", "body_quat", "body_mass", "body_ipos", "body_iquat", "body_inertia"),
    *("body_gravcomp", "jnt_pos", "jnt_axis", "jnt_range", "jnt_actfrcrange", "jnt_stiffness"),
    *("eq_data", "wrap_prm", "tendon_stiffness", "actuator_gainprm", "actuator_biasprm"),
    *("actuator_gear", "qpos0", "qpos_spring"),
    *(f"{kind}_{key}" for kind in ("tendon", "dof") for key in _OF_TENDONS),
)

# MuJoCo's order of a full tensor, in ours: xx, xy, yy, xz, yz, zz.
_FULL = (0, 3, 1, 4, 5, 2)


def parsed(text: str, path: Path | None, what: str, *, folder: Path | None = None) -> Any:
    """Return MuJoCo's ``MjSpec`` of a file, or of a text with files in a folder.

    Raises
    ------
    ModelError
        When it stands for too much, or MuJoCo cannot parse it.
    MissingExtraError
        When MuJoCo is not installed (extra ``sim``).
    """
    mujoco = require("mujoco", extra="sim")
    _require_small(text, path, folder, what)
    try:
        if path is not None:
            return mujoco.MjSpec.from_file(str(path.resolve()))
        spec = mujoco.MjSpec.from_string(text)
    except (ValueError, RuntimeError) as cause:
        raise ModelError(f"{what}: MuJoCo cannot parse it ({_line(cause)}).") from None
    if folder is not None:
        spec.modelfiledir = str(folder)
    return spec


def compiled(text: str, path: Path | None, what: str, *, folder: Path | None = None) -> Any:
    """Return MuJoCo's ``MjModel`` of a file, or of a text with files in a folder."""
    spec = parsed(text, path, what, folder=folder)
    try:
        return spec.compile()
    except (ValueError, RuntimeError) as cause:
        raise ModelError(f"{what}: MuJoCo cannot compile it ({_line(cause)}).") from None


def _line(cause: Exception) -> str:
    return " ".join(str(cause).split())


def _require_small(text: str, path: Path | None, folder: Path | None, what: str) -> None:
    """Refuse a file that stands for more elements than are read, or includes itself."""
    first = path or (folder or Path()) / "text"
    count = 0

    def add(element: Any, times: int, files: tuple[Path, ...]) -> None:
        nonlocal count
        count += times
        if count > MOST_ELEMENTS or _product(element, _CELLS) > _MOST_CELLS:
            raise ModelError(
                f"{what}: its <{element.tag}> makes it larger than what is read: {MOST_ELEMENTS} "
                f"elements with all that is included and repeated, {_MOST_CELLS:.0e} cells of a "
                "height field or a texture."
            )
        if element.tag in _REPEATED:
            times *= _product(element, ("count",))
        for child in element.iterchildren("*"):
            add(child, times, files)
        for place in _files(element, files):
            if place in files:
                raise ModelError(f"{what}: '{place.name}' includes itself.")
            data = read_regular(place, MAX_BYTES, ModelError)
            add(parse_xml(data, place.name), times, (*files, place))

    add(parse_xml(text, what), 1, (first.resolve(),))


def _product(element: Any, keys: tuple[str, ...]) -> int:
    """Return the product of the whole numbers in some attributes."""
    words = " ".join(element.get(key, "") for key in keys).split()
    return math.prod(int(word[:20]) for word in words if word.isdecimal())


def _files(element: Any, files: tuple[Path, ...]) -> Iterator[Path]:
    """Yield the files that an element puts in its place, and those of the model it attaches."""
    names = []
    if element.tag in ("include", "model"):
        names = [element.get("file")]
    elif element.tag == "attach":
        models = element.getroottree().iter("model")
        wanted = (None, element.get("model"))
        names = [each.get("file") for each in models if each.get("name") in wanted]
    for name in filter(None, names):
        places = [(file.parent / name).resolve() for file in (files[-1], files[0])]
        yield from [place for place in places if place.is_file()][:1]


class MjcfBody(NamedTuple):
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
    joints : list of int
        Pinocchio's joints that are its own.
    """

    name: str
    carrier: int
    placement: Array
    theta: Array
    joints: list[int]


def read_mjcf(
    text: str, what: str, *, path: Path | None = None, folder: Path | None = None
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

    Raises
    ------
    ModelError
        When it stands for too much, MuJoCo cannot compile it, or it has ball joints.
    MissingExtraError
        When MuJoCo is not installed (extra ``sim``).
    """
    model = compiled(text, path, what, folder=folder)
    for name in _ARRAYS:
        if not np.isfinite(getattr(model, name)).all():
            raise ModelError(f"{what}: {name} is not finite in MuJoCo's model; repair the file.")
    if not np.isfinite(model.opt.gravity).all():
        raise ModelError(f"{what}: gravity is {model.opt.gravity}; give finite numbers, m/s².")
    return MjcfModel(model, what)


class MjcfModel:
    """MuJoCo's model of a file, and the Pinocchio model that is built of it body by body.

    Attributes
    ----------
    pin_model : pinocchio.Model
        A joint for every hinge, slide and free joint.
    names : list of str
        Names of MuJoCo's joints, which may have none of their own.
    bodies : list of MjcfBody
        In MuJoCo's order, the world first.
    closures : list of Closure
        Loops that active equalities close.
    kept : list of Kept
        Joints that active equalities make follow another, or keep in a fixed tendon of a length.
    others : list of str
        Kinds of the other active equalities.
    """

    def __init__(self, model: Any, what: str) -> None:
        import mujoco
        import pinocchio as pin

        self.model, self.what, self.kinds = model, what, mujoco
        self.names = [
            model.joint(i).name or f"{model.body(owner).name or f'body_{owner}'}_joint_{i}"
            for i, owner in enumerate(model.jnt_bodyid.tolist())
        ]
        self.pin_model: Any = pin.Model()
        name = model.names.split(b"\0")[0].decode("utf-8", "replace")
        self.pin_model.name = name or "robot"
        self.pin_model.gravity.linear = np.array(model.opt.gravity)
        self.bodies = [MjcfBody("world", 0, np.eye(4), np.zeros(10), [])]
        for body in range(1, model.nbody):
            self._add(body)
        self.closures: list[Closure] = []
        self.kept: list[Kept] = []
        self.others: list[str] = []
        for number in np.flatnonzero(model.eq_active0).tolist():
            self._add_equality(number)

    def _add(self, body: int) -> None:
        import pinocchio as pin

        model, built = self.model, self.pin_model
        before, joints = self.bodies[model.body_parentid[body]], []
        joint, place = before.carrier, pin.SE3(before.placement)
        place = place * _placement(model.body_pos[body], model.body_quat[body])
        first = int(model.body_jntadr[body])
        for number in range(first, first + int(model.body_jntnum[body])):
            joint, place = self._add_joint(number, joint, place)
            joints.append(joint)
        theta, mass = np.zeros(10), float(model.body_mass[body])
        if mass > 0.0:
            R = _placement(np.zeros(3), model.body_iquat[body]).rotation
            inertia = R @ np.diag(model.body_inertia[body]) @ R.T
            theta = theta_from_physical(mass, model.body_ipos[body], inertia)
            if joint:
                own = pin.Inertia.FromDynamicParameters(theta)
                built.appendBodyToJoint(joint, own, place)
        name = model.body(body).name
        self.bodies.append(MjcfBody(name, joint, place.homogeneous, theta, joints))
        if not built.existBodyName(name or f"body_{body}"):
            built.addBodyFrame(name or f"body_{body}", joint, place, 0)

    def _add_joint(self, number: int, parent: int, place: Any) -> tuple[int, Any]:
        """Add a joint that moves a body at `place`; return it and the body's place in it."""
        import pinocchio as pin

        model, built, kinds = self.model, self.pin_model, self.kinds.mjtJoint
        kind, name = model.jnt_type[number], self.names[number]
        axis, identity = np.array(model.jnt_axis[number]), pin.SE3.Identity()
        if kind == kinds.mjJNT_FREE:
            return built.addJoint(parent, pin.JointModelFreeFlyer(), identity, name), identity
        if kind == kinds.mjJNT_BALL:
            raise ModelError(
                f"{self.what}: joint '{name}' is a ball joint, which is not supported; supported "
                "are hinge, slide and a free joint at the root."
            )
        anchor = pin.SE3(np.eye(3), np.array(model.jnt_pos[number]))
        ref = self._at_joint(model.qpos0, number)
        if kind == kinds.mjJNT_HINGE:
            moving: Any = pin.JointModelRevoluteUnaligned(axis)
            back = pin.SE3(pin.AngleAxis(-ref, axis).matrix(), np.zeros(3))
        else:
            moving = pin.JointModelPrismaticUnaligned(axis)
            back = pin.SE3(np.eye(3), -ref * axis)
        effort, lower, upper = np.inf, -np.inf, np.inf
        if model.jnt_actfrclimited[number]:
            effort = np.abs(model.jnt_actfrcrange[number]).max()
        if model.jnt_limited[number]:
            lower, upper = model.jnt_range[number]
        limits = (np.array([limit]) for limit in (effort, np.inf, lower, upper))
        joint = built.addJoint(parent, moving, place * anchor * back, name, *limits)
        at, dof = built.joints[joint].idx_v, model.jnt_dofadr[number]
        built.damping[at] = model.dof_damping[dof]
        built.friction[at] = model.dof_frictionloss[dof]
        built.armature[at] = model.dof_armature[dof]
        return joint, anchor.inverse()

    def _at_joint(self, positions: Array, number: int) -> float:
        return float(positions[self.model.jnt_qposadr[number]])

    def _add_equality(self, number: int) -> None:
        """Add an active equality to what is kept, to the closures, or to the others."""
        model = self.model
        kind = self.kinds.mjtEq(int(model.eq_type[number])).name.removeprefix("mjEQ_").lower()
        first, second = int(model.eq_obj1id[number]), int(model.eq_obj2id[number])
        data = model.eq_data[number].tolist()
        if kind in ("connect", "weld"):
            self.closures.append(self._closure(number, kind, (first, second), data))
        elif kind == "tendon" and second < 0 and self._of_joints(first):
            value = float(model.tendon_length0[first]) + data[0]
            self.kept.append(Kept(self._factors(first), value))
        elif kind != "joint" or second < 0 or any(data[2:5]):
            self.others.append(kind)
        else:
            # q1 − ref1 = c0 + c1·(q2 − ref2)
            one, two = (self._at_joint(model.qpos0, joint) for joint in (first, second))
            offset = one + data[0] - data[1] * two
            self.kept.append(Kept.mimic(self.names[first], self.names[second], data[1], offset))

    def _closure(
        self, number: int, kind: str, objects: tuple[int, int], data: list[float]
    ) -> Closure:
        """Return an equality that keeps two bodies, or sites on them, together."""
        model, upright = self.model, [1.0, 0.0, 0.0, 0.0]
        if model.eq_objtype[number] == self.kinds.mjtObj.mjOBJ_SITE:
            places = [_placement(model.site_pos[k], model.site_quat[k]) for k in objects]
            objects = (int(model.site_bodyid[objects[0]]), int(model.site_bodyid[objects[1]]))
        elif kind == "connect":
            places = [_placement(data[:3], upright), _placement(data[3:6], upright)]
        else:
            # The place on the second body, then that on the first, turned as the second is.
            places = [_placement(data[3:6], data[6:10]), _placement(data[:3], upright)]
        one, two = (
            (model.body(body).name or f"body_{body}" if body else "universe", place.homogeneous)
            for body, place in zip(objects, places, strict=True)
        )
        name = model.equality(number).name or f"{kind}_{number + 1}"
        return Closure(name, "point" if kind == "connect" else "plane", (one, two))

    def joint_values(self) -> dict[str, dict[str, float]]:
        """Return ``armature``, ``damping`` and ``frictionloss`` by joint name."""
        return {
            name: {key: float(getattr(self.model, f"dof_{key}")[at]) for key in _OF_TENDONS}
            for name, at in zip(self.names, self.model.jnt_dofadr, strict=True)
        }

    def passive(self) -> list[str]:
        """Return the joints that no actuator moves; none where one pulls at anything else."""
        model, kinds = self.model, self.kinds.mjtTrn
        plain = np.isin(
            model.actuator_trntype, [int(kinds.mjTRN_JOINT), int(kinds.mjTRN_JOINTINPARENT)]
        )
        if not model.nu or not plain.all():
            return []
        moved = set(model.actuator_trnid[:, 0].tolist())
        return [name for i, name in enumerate(self.names) if i not in moved]

    def motors(self) -> dict[str, dict[str, float]]:
        """Return factors by joint of the fixed tendons that actuators pull, by these, gears in.

        Raises
        ------
        ModelError
            When there are none.
        """
        model, found = self.model, dict[str, dict[str, float]]()
        of_tendons = model.actuator_trntype == int(self.kinds.mjtTrn.mjTRN_TENDON)
        for i in np.flatnonzero(of_tendons & (model.actuator_gainprm[:, 0] != 0.0)).tolist():
            tendon, gear = int(model.actuator_trnid[i, 0]), float(model.actuator_gear[i, 0])
            if self._of_joints(tendon):
                name = model.actuator(i).name or f"motor_{i + 1}"
                found[name] = {joint: gear * x for joint, x in self._factors(tendon).items()}
        if not found:
            raise ModelError(
                f"{self.what}: no motor pulls at a fixed tendon; give transmission= as numbers."
            )
        return found

    def _of_joints(self, tendon: int) -> bool:
        """Return whether a tendon is a sum of joints' positions."""
        first = self.model.wrap_type[self.model.tendon_adr[tendon]]
        return bool(first == self.kinds.mjtWrap.mjWRAP_JOINT)

    def _factors(self, tendon: int) -> dict[str, float]:
        model, first = self.model, int(self.model.tendon_adr[tendon])
        own = range(first, first + int(model.tendon_num[tendon]))
        return {self.names[model.wrap_objid[k]]: float(model.wrap_prm[k]) for k in own}

    def springs(self, robot: Any) -> Iterator[Spring]:
        """Yield the springs of joints, and of fixed tendons that one coordinate of a robot moves.

        `robot` is the `RobotModel` with these joints, and perhaps a transmission.
        """
        model = self.model
        for i in np.flatnonzero(self._ordinary()).tolist():
            rest = self._at_joint(model.qpos_spring, i)
            bent = _bent(model, "jnt", i)
            yield Spring(self.names[i], float(model.jnt_stiffness[i]), rest, bent)
        for i, (j, gear, shift) in self._sprung(robot).items():
            rest = (float(model.tendon_lengthspring[i, 0]) - shift) / gear
            powers = [float(model.tendon_stiffness[i]), *_bent(model, "tendon", i)]
            first, *more = (x * gear ** (k + 2) for k, x in enumerate(powers))
            yield Spring(robot.joint_names[j], first, rest, tuple(more))

    def _sprung(self, robot: Any) -> dict[int, tuple[int, float, float]]:
        """Return what moves the tendons whose springs rest at one length."""
        model = self.model
        even = (model.tendon_stiffness > 0.0) & (np.ptp(model.tendon_lengthspring, axis=1) == 0.0)
        return {i: each for i, each in self.moved(robot).items() if even[i]}

    def moved(self, robot: Any) -> dict[int, tuple[int, float, float]]:
        """Return by tendon the one coordinate that moves it, its factor, and the length at zero.

        Those that none moves, or several, are not among them.
        """
        found = dict[int, tuple[int, float, float]]()
        for i in filter(self._of_joints, range(self.model.ntendon)):
            gears, shift = robot.way(self._factors(i))
            moved = np.flatnonzero(np.abs(gears) > 1e-12)
            if len(moved) == 1 and moved[0] >= robot.n_base:
                found[i] = int(moved[0]), float(gears[moved[0]]), shift
        return found

    def _ordinary(self) -> Mask:
        """Return which joints have a spring that pulls one angle or way back."""
        free = self.model.jnt_type == int(self.kinds.mjtJoint.mjJNT_FREE)
        return np.asarray((self.model.jnt_stiffness > 0.0) & ~free)

    def tendons(self) -> Iterator[tuple[dict[str, float], tuple[float, ...]]]:
        """Yield factors by joint of the fixed tendons, dry friction, damping and armature."""
        for i in filter(self._of_joints, range(self.model.ntendon)):
            own = (float(getattr(self.model, f"tendon_{key}")[i]) for key in _OF_TENDONS)
            yield self._factors(i), tuple(own)

    def forces(self, robot: Any) -> Iterator[str]:
        """Yield what no term of a robot stands for, in words.

        These are springs of tendons over several coordinates and of free joints, springs that push
        away, and compensated gravity.
        """
        model = self.model
        for i in np.flatnonzero((model.jnt_stiffness != 0.0) & ~self._ordinary()):
            yield f"spring at {self.names[i]} (stiffness {model.jnt_stiffness[i]:.4g})"
        sprung = self._sprung(robot)
        for i in (k for k in np.flatnonzero(model.tendon_stiffness) if k not in sprung):
            yield f"spring of tendon {i + 1} (stiffness {model.tendon_stiffness[i]:.4g})"
        for i in np.flatnonzero(model.body_gravcomp):
            yield f"gravcomp {model.body_gravcomp[i]:.4g} of body {model.body(i).name}"

    def actuators(self) -> Iterator[str]:
        """Yield the actuators that do not pass their control on as a joint's effort, in words."""
        model = self.model
        for i in range(model.nu):
            gain, gear = model.actuator_gainprm[i, 0], model.actuator_gear[i, 0]
            if gain != 1.0 or gear != 1.0 or model.actuator_biasprm[i].any():
                name = model.actuator(i).name or i + 1
                yield f"{name} (gain {gain:.4g}, gear {gear:.4g})"


def _placement(position: Any, quaternion: Any) -> Any:
    """Return Pinocchio's placement of MuJoCo's position and quaternion, scalar first."""
    import pinocchio as pin

    w, x, y, z = quaternion
    return pin.SE3(pin.Quaternion(w, x, y, z).normalized().matrix(), np.array(position))


def _bent(model: Any, kind: str, number: int) -> tuple[float, ...]:
    """Return the square's and the cube's share in a spring; older MuJoCo has none."""
    found = getattr(model, f"{kind}_stiffnesspoly", None)
    values = [] if found is None else found[number].tolist()
    return tuple(values) if any(values) else ()


def quaternion_of(rotation: Array) -> Array:
    """Return a rotation matrix as MuJoCo's quaternion, scalar first."""
    import pinocchio as pin

    x, y, z, w = pin.Quaternion(np.asarray(rotation)).normalized().coeffs()
    return np.array([w, x, y, z])


def read_mjcf_bodies(text: str, path: Path | None, what: str) -> tuple[DescribedBody, ...]:
    """Return the bodies of an MJCF file that have an explicit inertial, as written.

    MuJoCo makes the others from their shapes when it compiles, which are then consistent by what
    they are made of; they come without numbers. Shapes are not looked at.

    Parameters
    ----------
    text : str
        The file.
    path : Path or None
        Where it is, for what it includes.
    what : str
        What it is called in messages.

    Raises
    ------
    ModelError
        When it stands for too much, MuJoCo cannot parse it, or it has no bodies.
    MissingExtraError
        When MuJoCo is not installed (extra ``sim``).
    """
    places: dict[str, dict[str, Any]] = {}
    found = []
    # Bodies do not keep what owns them alive in MuJoCo 3.3.7.
    spec = parsed(text, path, what)
    for number, body in enumerate(spec.bodies):
        if number == 0:
            continue  # the world
        name, parent = str(body.name or f"body {number}"), body.parent.name
        places[name] = places.get(parent, {"carrier": name})
        if len(body.joints):
            joint = body.joints[0].name or f"joint of {name}"
            places[name] = {"carrier": name, "moving": True, "joint": joint, "parent": parent}
        found.append(_described(body, name=name, **places[name]))
    if not found:
        raise ModelError(f"{what}: has no bodies.")
    return tuple(found)


def _described(body: Any, **place: Any) -> DescribedBody:
    """Return a body of MuJoCo's ``MjSpec``."""
    if not body.explicitinertial:
        return DescribedBody(described=False, inferred=len(body.geoms) > 0, **place)
    values = np.ravel(body.fullinertia)[list(_FULL)]
    if np.isnan(body.fullinertia[0]):
        xx, yy, zz = body.inertia
        values = np.array([xx, 0.0, yy, 0.0, 0.0, zz])
    mass, com, problems = float(body.mass), np.array(body.ipos), []
    if not np.isfinite(values).all():
        problems.append("the inertia is missing or no finite numbers")
    if not np.isfinite([mass, *com]).all():
        problems.append("mass or center of mass are missing or no finite numbers")
    return DescribedBody(
        described=True,
        mass=mass if np.isfinite(mass) else None,
        com=frozen(com) if np.isfinite(com).all() else None,
        entries=None if problems else tuple(map(Fraction, values.tolist())),
        problems=tuple(problems),
        **place,
    )
