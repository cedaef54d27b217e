"""The robot: its kinematics in Pinocchio, and everything that is linear in its parameters."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, Indices, Mask, frozen, real_array
from sdpid._common.files import Source
from sdpid._common.tables import Table, facts_html
from sdpid.errors import DataError, ModelError
from sdpid.robot.description.dh_table import DhTable
from sdpid.robot.description.urdf import Loop, pinocchio_from_urdf
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.inertia import PARAMETER_NAMES, PARAMETER_UNITS
from sdpid.robot.model import regressor_kernel as kernels

# Descriptions and our own URDFs write 'no limit' as a number at least this large.
_UNLIMITED = 1e9

# Links of at least this mass (kg) have a center of mass that is worth computing, so that
# Pinocchio's recursion, ten times faster than a regressor, gives their efforts.
_LEAST_MASS = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class RobotModel:
    """A tree of links with revolute, continuous or prismatic joints, on a fixed or floating base.

    Attributes
    ----------
    name : str
        The robot's name.
    pin_model : pinocchio.Model
        The kinematics; not to be changed.
    joint_names : tuple of str
        The n velocity coordinates: one name a joint or a motor, six for a floating base. Joints
        that follow others are not among them.
    link_names : tuple of str
        The moving links, named after their joints' bodies, in Pinocchio's order.
    prior : ndarray, shape (links, 10)
        Inertial parameters of the description; zero where it gives none.
    expansion : ndarray, shape (nv, n)
        Velocities of Pinocchio's joints from the n coordinates: the identity but for joints that
        follow others, or motors (see `sdpid.Transmission`).
    offset : ndarray, shape (nv,)
        Positions of Pinocchio's joints at zero coordinates.
    urdf : str or None
        Text of the description, where there is one.
    source : Source or None
        The description that `load_robot` read, and how; None for a robot from elsewhere.
    folder : Path or None
        The folder of the description's file, where the meshes that it names are looked up.
    loops : tuple of Loop
        Where loops close that the tree was cut at.
    passive : tuple of str
        Joints without motors, whose efforts are zero.
    assembled : tuple of float
        About where each of these is while those with motors are at zero, rad or m: which of the
        ways it is in which the loops can be closed.
    forces, actuators : tuple of str
        What an MJCF has and the model has not, in words: springs of tendons and compensated
        gravity, and actuators with gains or gears.
    springs : tuple of Spring
        Springs of the description, which `identify` takes as known unless it is given others.
    transmission : mapping or None
        How the joints follow the motors, as `load_robot` was given it.

    Examples
    --------
    >>> robot
    RobotModel('denso_vp6242', 6 coordinates, 6 links)
    >>> robot.joint_names[:2], robot.link_names[:2], robot.prior.shape
    (('joint_1', 'joint_2'), ('link_1', 'link_2'), (6, 10))
    >>> q = np.zeros((1, 6))
    >>> robot.regressor(q, q, q).shape
    (1, 6, 60)
    >>> bool(np.allclose(robot.mass_matrix(estimate.theta, q), estimate.mass_matrix(q)))
    True
    """

    name: str
    pin_model: Any
    joint_names: tuple[str, ...]
    link_names: tuple[str, ...]
    prior: Array
    expansion: Array
    offset: Array
    urdf: str | None = None
    source: Source | None = None
    folder: Path | None = None
    loops: tuple[Loop, ...] = ()
    passive: tuple[str, ...] = ()
    assembled: tuple[float, ...] = ()
    forces: tuple[str, ...] = ()
    actuators: tuple[str, ...] = ()
    springs: tuple[FrictionTerm, ...] = ()
    transmission: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        joints = self.joint_names[self.n_base :]
        if unknown := [name for name in self.passive if name not in joints]:
            raise ModelError(
                f"robot '{self.name}': {', '.join(unknown)} is said to have no motor, and is no "
                f"joint that moves by itself; these are {', '.join(joints)}."
            )
        if joints and set(joints) == set(self.passive):
            raise ModelError(f"robot '{self.name}': no joint has a motor; one at least has one.")

    @classmethod
    def from_mdh(
        cls,
        table: DhTable | str | os.PathLike[str] | Mapping[str, Any] | Iterable[Any],
        *,
        gravity: Sequence[float] | None = None,
        convention: Literal["modified", "standard"] | None = None,
        base_translation: Sequence[float] | None = None,
        base_rpy: Sequence[float] | None = None,
        inertias: ArrayLike | None = None,
        name: str | None = None,
    ) -> RobotModel:
        """Build from a Denavit-Hartenberg table.

        Parameters
        ----------
        table : DhTable, path of a TOML file, mapping, or iterable of DhJoint or mappings
            The table; modified (Khalil) unless it says otherwise.
        gravity : sequence of 3 floats, optional
            Gravity in the base link (m/s²); by default what the table says, else -z.
        convention : {"modified", "standard"}, optional
            Overrides the table's.
        base_translation, base_rpy : sequence of 3 floats, optional
            Placement of frame 0 in the base link (m, rad).
        inertias : array_like, shape (n, 10), optional
            Inertial parameters of the links.
        name : str, optional
            The robot's name.

        Raises
        ------
        ModelError
            When the table is not understood.
        """
        whole = DhTable.of(
            table,
            gravity=gravity,
            convention=convention,
            base_translation=base_translation,
            base_rpy=base_rpy,
            name=name,
        )
        text = whole.to_urdf(inertias)
        model, _, _ = pinocchio_from_urdf(text, "kinematic table")
        return cls.from_pinocchio(model, gravity=whole.gravity, urdf=text)

    @classmethod
    def from_pinocchio(
        cls,
        model: Any,
        *,
        gravity: Sequence[float] | None = None,
        urdf: str | None = None,
    ) -> RobotModel:
        """Build from a Pinocchio model, which is copied.

        Parameters
        ----------
        model : pinocchio.Model
            Revolute, continuous and prismatic joints, on a fixed or floating base.
        gravity : sequence of 3 floats, optional
            Gravity in the base link, m/s²; by default the model's.
        urdf : str, optional
            Text of the description.

        Raises
        ------
        ModelError
            When it is no Pinocchio model, a joint kind is not supported, a mass is negative, or
            nothing moves.
        """
        import pinocchio as pin

        if not isinstance(model, pin.Model):
            raise ModelError(
                f"robot: got {type(model).__name__}; give a name, a path, URDF text or a "
                "pinocchio.Model."
            )
        model = model.copy()
        if model.njoints < 2:
            raise ModelError(f"robot '{model.name}': no moving joint; nothing can be identified.")
        if gravity is not None:
            values = real_array(gravity, "gravity", ndim=1, error=ModelError)
            if values.shape != (3,):
                raise ModelError(f"gravity: {values.size} numbers, give 3 (m/s²).")
            model.gravity.linear = values
        names, links = coordinate_names(model), link_names(model)
        prior = [model.inertias[i].toDynamicParameters() for i in range(1, model.njoints)]
        for link, body in zip(links, prior, strict=True):
            if body[0] < 0.0:
                raise ModelError(
                    f"robot '{model.name}': link '{link}': the mass is {body[0]:g} kg, the least "
                    "is 0; give the true mass."
                )
        kernels.flatten(model, np.eye(len(names)))  # refuses joints of other kinds
        return cls(
            name=model.name,
            pin_model=model,
            joint_names=names,
            link_names=links,
            prior=frozen(prior),
            expansion=frozen(np.eye(len(names))),
            offset=frozen(np.zeros(len(names))),
            urdf=urdf,
        )

    def __repr__(self) -> str:
        base = ", free flyer" if self.free_flyer else ""
        closed = f", {len(self.loops)} loop{'s' * (len(self.loops) > 1)}" if self.loops else ""
        return (
            f"RobotModel({self.name!r:.80}, {self.n} coordinates, {self.n_links} links"
            f"{base}{closed})"
        )

    def _repr_html_(self) -> str:
        facts: dict[str, object] = {
            "coordinates": ", ".join(self.joint_names),
            "base": "floating" if self.free_flyer else "fixed",
            "loops": ", ".join(f"{loop.name} ({loop.kind})" for loop in self.loops) or None,
            "without motors": ", ".join(self.passive) or None,
            "joints": None if self.direct else ", ".join(self.tree_joints),
            "described mass, kg": float(np.maximum(self.prior[:, 0], 0.0).sum()),
        }
        links = {"link": list(self.link_names), "described mass, kg": self.prior[:, 0].tolist()}
        return facts_html(f"Robot {self.name}", facts, Table.of_columns(links))

    @property
    def n(self) -> int:
        """Number of velocity coordinates."""
        return len(self.joint_names)

    @property
    def n_links(self) -> int:
        """Number of moving links."""
        return len(self.link_names)

    @property
    def free_flyer(self) -> bool:
        """Whether the base floats."""
        return bool(self.pin_model.njoints > 1 and self.pin_model.joints[1].nv == 6)

    @property
    def n_base(self) -> int:
        """Number of velocity coordinates of a floating base: 6 or 0."""
        return 6 if self.free_flyer else 0

    @property
    def gravity(self) -> Array:
        """Gravity in the base link, m/s²."""
        return np.array(self.pin_model.gravity.linear)

    def with_gravity(self, gravity: ArrayLike) -> RobotModel:
        """Return the same robot under another gravity in the base link, m/s²."""
        model = self.pin_model.copy()
        model.gravity.linear = np.asarray(gravity, dtype=np.float64)
        return replace(self, pin_model=model)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the 10·links inertial parameters, such as ``xx_2``, counted from 1."""
        return tuple(f"{p}_{i + 1}" for i in range(self.n_links) for p in PARAMETER_NAMES)

    @property
    def parameter_units(self) -> tuple[str, ...]:
        """Units of the 10·links inertial parameters."""
        return PARAMETER_UNITS * self.n_links

    @property
    def tree_joints(self) -> tuple[str, ...]:
        """Names of Pinocchio's nv coordinates: joints that follow others are among them."""
        return coordinate_names(self.pin_model)

    def way(self, factors: Mapping[str, float]) -> tuple[Array, float]:
        """Return how a sum of joints' positions follows the coordinates: rates (n,), and an offset.

        Parameters
        ----------
        factors : mapping
            Factors in the sum by names of Pinocchio's joints.
        """
        rows = [*map(self.tree_joints.index, factors)]
        values = np.array([*factors.values()])
        return values @ self.expansion[rows], float(values @ self.offset[rows])

    def seats(self) -> dict[str, tuple[str, float]]:
        """Return by coordinate a joint that it alone moves, and by which factor, if there is one.

        A joint of the coordinate's own name comes first.
        """
        found: dict[str, tuple[str, float]] = {}
        for joint, row in zip(self.tree_joints, self.expansion, strict=True):
            moved = np.flatnonzero(row)
            if len(moved) == 1:
                name = self.joint_names[moved[0]]
                if name not in found or joint == name:
                    found[name] = joint, float(row[moved[0]])
        return found

    def seated_joints(self) -> Iterator[tuple[int, Any, float]]:
        """Yield column, Pinocchio joint and factor of coordinates that move a joint alone."""
        model, columns = self.pin_model, {name: j for j, name in enumerate(self.joint_names)}
        for name, (joint, factor) in self.seats().items():
            if columns[name] >= self.n_base:
                yield columns[name], model.joints[model.getJointId(joint)], factor

    def seat(self, name: str) -> tuple[str, float]:
        """Return `seats` of one coordinate, ``""`` for none; a joint behind others has its own."""
        return self.seats().get(name, ("" if name in self.joint_names else name, 1.0))

    def independent(self) -> list[int]:
        """Return n of Pinocchio's coordinates that the others, and the motors, follow from."""
        seats = self.seats()
        first = [
            self.tree_joints.index(seats[name][0]) for name in self.joint_names if name in seats
        ]
        return sorted(independent_rows(self.expansion, [*first, *range(len(self.expansion))]))

    @property
    def reach(self) -> float:
        """Length of the longest way from the base to a joint, m, from joint to joint."""
        way = np.zeros(self.pin_model.njoints)
        for i in range(1, self.pin_model.njoints):
            offset = float(np.linalg.norm(self.pin_model.jointPlacements[i].translation))
            way[i] = way[self.pin_model.parents[i]] + offset
        return float(way.max())

    @property
    def position_limits(self) -> Array:
        """Limits of the coordinates' positions, shape (n, 2), infinite where there are none.

        They are those of a joint that the coordinate moves alone, by its gear. A joint from 0 to 0
        has none: so a URDF is read that leaves them out.
        """
        limits, model = np.tile([-np.inf, np.inf], (self.n, 1)), self.pin_model
        for column, joint, factor in self.seated_joints():
            at = joint.idx_q
            own = np.array([model.lowerPositionLimit[at], model.upperPositionLimit[at]])
            if joint.nq == 1 and own.any() and max(-own[0], own[1]) < _UNLIMITED:
                ends = (own - self.offset[joint.idx_v]) / factor
                limits[column] = ends if factor > 0.0 else ends[::-1]
        return limits

    @property
    def gears(self) -> Array:
        """How far each coordinate moves for one of the joint it moves most, (n,), at least 1."""
        return np.asarray(1.0 / np.minimum(np.abs(self.expansion).max(axis=0), 1.0))

    def described_friction(self) -> tuple[Array, Array]:
        """Return viscous and Coulomb friction of each coordinate in the description, (n,) each."""
        damping, friction = np.array(self.pin_model.damping), np.array(self.pin_model.friction)
        # Friction of a joint acts on what moves it through the gear between them.
        ratio = np.abs(self.expansion)
        return np.asarray(damping @ ratio**2), np.asarray(friction @ ratio)

    def described_armature(self) -> Array:
        """Return the rotor inertia of each coordinate in the description, (n,); a URDF has none."""
        return np.asarray(self.pin_model.armature @ self.expansion**2)

    def _sizes(self, values: Array, power: int) -> Array:
        """Return limits (n,) from those of joints, by a power of the factors that move these."""
        limits = np.full(self.n, np.inf)
        for column, joint, factor in self.seated_joints():
            if 0.0 < values[joint.idx_v] < _UNLIMITED:
                limits[column] = values[joint.idx_v] * abs(factor) ** power
        return limits

    @property
    def velocity_limits(self) -> Array:
        """Largest speeds, shape (n,), infinite where there are none, or zero."""
        return self._sizes(self.pin_model.velocityLimit, -1)

    @property
    def effort_limits(self) -> Array:
        """Largest efforts, shape (n,), infinite where there are none, or zero."""
        return self._sizes(self.pin_model.effortLimit, 1)

    def configuration(self, position: ArrayLike) -> Array:
        """Return Pinocchio's configurations, (K, n) to (K, nq).

        Continuous joints become cosine and sine, joints that follow others their own angle. With a
        floating base positions are its seven numbers and one of each further coordinate, or
        configurations already, (K, nq).
        """
        position = real_array(position, "position", ndim=2)
        pose, n, nq = 7 * self.free_flyer, self.n - self.n_base, self.pin_model.nq
        if position.shape[1] == pose + n:
            if pose and pose + n == nq and self.direct:
                return position
            angles = np.pad(position[:, pose:], ((0, 0), (self.n_base, 0)))
            found = self.configuration_of(self._expand(angles) + self.offset)
            found[:, :pose] = position[:, :pose]
            return found
        if not pose or position.shape[1] != nq:
            raise DataError(
                f"position: {position.shape[1]} columns, the robot '{self.name}' has {pose + n}: "
                f"{', '.join(self.joint_names)}."
            )
        return position

    def configuration_of(self, angles: Array) -> Array:
        """Return Pinocchio's configurations (K, nq) of its joints' angles or ways (K, nv).

        A floating base is at rest in the origin.
        """
        import pinocchio as pin

        model = self.pin_model
        if model.nq == model.nv:
            return np.ascontiguousarray(angles)
        q = np.tile(pin.neutral(model), (len(angles), 1))
        for joint in list(model.joints)[1 + self.free_flyer :]:
            if joint.nq == 2:
                q[:, joint.idx_q] = np.cos(angles[:, joint.idx_v])
                q[:, joint.idx_q + 1] = np.sin(angles[:, joint.idx_v])
            else:
                q[:, joint.idx_q] = angles[:, joint.idx_v]
        return q

    def at_rest(self, joints: ArrayLike) -> Array:
        """Return Pinocchio's configurations (K, nq) of joints, a floating base in the origin.

        Parameters
        ----------
        joints : array_like, shape (K, n), or (K, n − 6) with a floating base
            Their positions.

        Raises
        ------
        DataError
            When the shape does not fit.
        """
        if not self.free_flyer:
            return self.configuration(joints)
        positions = real_array(joints, "q", ndim=2)
        n = self.n - self.n_base
        if positions.shape[1] != n:
            raise DataError(
                f"q: {positions.shape[1]} columns, the robot '{self.name}' has {n} joints beside "
                "its floating base."
            )
        return self.configuration(np.hstack([np.eye(1, 7, 6).repeat(len(positions), 0), positions]))

    @functools.cached_property
    def direct(self) -> bool:
        """Whether every joint is a coordinate: none follows others, or motors."""
        rows, columns = self.expansion.shape
        plain = rows == columns and np.array_equal(self.expansion, np.eye(rows))
        return plain and not self.offset.any()

    def of_joints(self) -> RobotModel:
        """Return the robot whose coordinates are its joints, whatever moves them."""
        names = self.tree_joints
        expansion, offset = frozen(np.eye(len(names))), frozen(np.zeros(len(names)))
        whole = replace(self, joint_names=names, passive=(), assembled=(), transmission=None)
        return replace(whole, expansion=expansion, offset=offset)

    def _expand(self, values: Array) -> Array:
        return values if self.direct else values @ self.expansion.T

    def _states(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> tuple[Array, Array, Array]:
        q = self.configuration(q)
        rates = []
        for values, name in ((v, "velocity"), (a, "acceleration")):
            array = real_array(values, name, ndim=2)
            if array.shape != (len(q), self.n):
                raise DataError(
                    f"{name}: shape {array.shape}, expected {(len(q), self.n)} "
                    f"for {len(q)} positions of '{self.name}'."
                )
            rates.append(np.ascontiguousarray(self._expand(array)))
        return q, rates[0], rates[1]

    def regressor(
        self, q: ArrayLike, v: ArrayLike, a: ArrayLike, *, out: Array | None = None
    ) -> Array:
        """Return Y with ``effort = Y @ theta`` for the links' inertial parameters.

        Parameters
        ----------
        q : array_like, shape (K, n)
            Joint positions in rad or m; (K, nq) configurations with a floating base.
        v, a : array_like, shape (K, n)
            Velocities and accelerations.
        out : ndarray, shape (K, n, 10·links), optional
            Where to write it, float64 and C-contiguous. Memory that was used before takes a third
            of the time of memory that comes new from the system, page by page.

        Returns
        -------
        ndarray, shape (K, n, 10·links)
            Columns link by link in Pinocchio's order of parameters [carpentier2019]_. Compiled
            where Numba is installed (the extra ``fast``) and there is at least a megabyte of it,
            else Pinocchio's own, sample by sample; they differ by rounding.

        Raises
        ------
        DataError
            When a shape does not fit or a value is not finite.
        """
        return self.regressor_columns(q, v, a, out=out)

    def regressor_columns(
        self,
        q: ArrayLike,
        v: ArrayLike,
        a: ArrayLike,
        *,
        places: Indices | None = None,
        out: Array | None = None,
        compiled: bool | None = None,
        entries: kernels.Entries | None = None,
    ) -> Array:
        """Write some columns of the regressor into a wider block, and zeros everywhere else.

        Parameters
        ----------
        q, v, a : array_like
            As for `regressor`.
        places : ndarray of int, shape (10·links,), optional
            The column of `out` that each parameter's goes to, -1 for none; by default its own.
        out : ndarray, shape (K, n, columns), optional
            Float64 and C-contiguous; by default new, with the columns of all parameters.
        compiled : bool, optional
            Whether to use the compiled loop: of a log's blocks all or none. By default the size
            decides.
        entries : tuple of ndarray, optional
            Further entries of `out`: values (K, m), rows (m,) and columns (m,) of a sample's block.

        Returns
        -------
        ndarray
            `out`.

        Raises
        ------
        DataError
            When a shape does not fit or a value is not finite.
        """
        q, v, a = self._states(q, v, a)
        count = 10 * self.n_links
        if out is not None:
            shape = len(q), self.n, count if places is None else out.shape[-1]
            if out.shape != shape or out.dtype != np.float64 or not out.flags.c_contiguous:
                raise DataError(
                    f"out: shape {out.shape} of {out.dtype}, expected {shape} of float64, "
                    "C-contiguous."
                )
            if places is not None and (
                len(places) != count or np.max(places, initial=-1) >= shape[2]
            ):
                raise DataError(
                    f"places: {len(places)} entries up to {np.max(places, initial=-1)}; expected "
                    f"one for each of {count} parameters, below {shape[2]} columns."
                )
        found = kernels.regressor(
            self.tree, q, v, a, out=out, places=places, worth=compiled, entries=entries
        )
        if found is not None:
            return found
        Y = self._pinocchio_regressor(q, v, a)
        if out is None:
            return Y
        if places is None:
            places = np.arange(count)
        out[:] = 0.0
        out[:, :, places[places >= 0]] = Y[:, :, places >= 0]
        if entries is not None:
            values, rows, columns = entries
            out[:, rows, columns] = values
        return out

    @functools.cached_property
    def tree(self) -> kernels.Tree:
        """The kinematics as plain arrays."""
        return kernels.flatten(self.pin_model, self.expansion)

    @functools.cached_property
    def slides(self) -> Mask:
        """Which joints slide, (n,); no coordinate of a floating base counts as one."""
        names, kinds = list(self.pin_model.names)[1:], self.tree.kind
        slide = {each for each, kind in zip(names, kinds, strict=True) if kind == kernels.PRISMATIC}
        return np.array([name in slide for name in self.joint_names], dtype=np.bool_)

    @functools.cached_property
    def frame_numbers(self) -> dict[str, int]:
        """Pinocchio's number of every frame; of frames with the same name the first."""
        model: Any = self.pin_model
        names = [frame.name for frame in model.frames]
        return {name: i for i, name in reversed(list(enumerate(names)))}

    def _pinocchio_regressor(self, q: Array, v: Array, a: Array) -> Array:
        """Return the same from Pinocchio, sample by sample."""
        import pinocchio as pin

        shape = self.pin_model.nv, 10 * self.n_links
        Y = each_state(pin.computeJointTorqueRegressor, self.pin_model, shape, q, v, a)
        return Y if self.direct else np.asarray(self.expansion.T @ Y)

    def inverse_dynamics(self, theta: ArrayLike, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
        """Return the efforts (K, n) of links with the given parameters, without friction."""
        links = np.asarray(theta, dtype=np.float64).reshape(-1)[: 10 * self.n_links]
        bodies = links.reshape(-1, 10)
        if np.all((bodies[:, 0] >= _LEAST_MASS) | ~bodies.any(axis=1)):
            return self.efforts_of_bodies(bodies, q, v, a)
        return self.regressor(q, v, a) @ links

    def efforts_of_bodies(
        self,
        bodies: Array,
        q: ArrayLike,
        v: ArrayLike,
        a: ArrayLike,
        *,
        gravity: ArrayLike | None = None,
    ) -> Array:
        """Return the efforts (K, n) of consistent bodies, as `inverse_dynamics` does, but sooner.

        Parameters
        ----------
        bodies : ndarray, shape (links, 10)
            Links with mass; rows of zeros are none.
        q, v, a : array_like
            As for `regressor`.
        gravity : array_like, shape (3,), optional
            In the base link, m/s²; by default the robot's.
        """
        import pinocchio as pin

        q, v, a = self._states(q, v, a)
        model = self.with_inertias(bodies)
        if gravity is not None:
            model.gravity.linear = np.asarray(gravity, dtype=np.float64)
        found = each_state(pin.rnea, model, (model.nv,), q, v, a)
        return found if self.direct else found @ self.expansion

    def described_efforts(
        self, q: ArrayLike, v: ArrayLike, a: ArrayLike, *, gravity: ArrayLike | None = None
    ) -> Array:
        """Return the efforts (K, n) of the description's bodies and rotors, without friction.

        Arguments are those of `efforts_of_bodies`.
        """
        # A body without mass has no center of mass.
        massive = np.where(self.prior[:, :1] > 0.0, self.prior, 0.0)
        links = self.efforts_of_bodies(massive, q, v, a, gravity=gravity)
        # Rotors of joints that several motors move are felt by all of these.
        rotors = self.expansion.T * np.array(self.pin_model.armature)
        return np.asarray(links + np.asarray(a) @ (rotors @ self.expansion))

    def with_inertias(self, theta: ArrayLike) -> Any:
        """Return a copy of the Pinocchio model, without armature, whose links have parameters."""
        import pinocchio as pin

        bodies = np.asarray(theta, dtype=np.float64).reshape(-1)[: 10 * self.n_links]
        model = self.pin_model.copy()
        for i, body in enumerate(bodies.reshape(self.n_links, 10)):
            model.inertias[i + 1] = (
                pin.Inertia.FromDynamicParameters(body) if np.any(body) else pin.Inertia.Zero()
            )
        model.armature = np.zeros(model.nv)
        return model

    def mass_matrix(self, theta: ArrayLike, q: ArrayLike) -> Array:
        """Return the joint-space mass matrices.

        Linear in theta, computed from the regressor at unit accelerations without gravity, so it
        holds for any parameters, consistent or not, massless links included.

        Parameters
        ----------
        theta : array_like, shape (10·links, …) flattened
            Inertial parameters; further entries (friction) are ignored.
        q : array_like, shape (K, n) or (n,)
            Joint positions.

        Returns
        -------
        ndarray, shape (K, n, n) or (n, n)
        """
        positions, weightless = np.asarray(q, dtype=np.float64), self.with_gravity(np.zeros(3))
        rows = np.atleast_2d(positions)
        rest, units = np.zeros((len(rows), self.n)), np.eye(self.n)
        columns = [weightless.inverse_dynamics(theta, rows, rest, rest + unit) for unit in units]
        out = np.stack(columns, axis=2)
        out = 0.5 * (out + out.transpose(0, 2, 1))
        return out[0] if positions.ndim == 1 else out


def independent_rows(matrix: Array, order: Iterable[int]) -> list[int]:
    """Return the rows of a matrix that do not depend on those before them in an order."""
    found: list[int] = []
    for row in order:
        if np.linalg.matrix_rank(matrix[[*found, row]]) > len(found):
            found.append(row)
    return found


def coordinate_names(model: Any) -> tuple[str, ...]:
    """Return the names of a model's nv velocity coordinates, joints that follow others included.

    Raises
    ------
    ModelError
        When a joint is of a kind that is not supported.
    """
    names: list[str] = []
    for i in range(1, model.njoints):
        joint, name = model.joints[i], str(model.names[i])
        if joint.nv == 1 and joint.nq in (1, 2) and joint.shortname() != "JointModelMimic":
            names.append(name)
        elif i == 1 and joint.nv == 6 and joint.nq == 7:
            names += [f"{name}/{axis}" for axis in ("vx", "vy", "vz", "wx", "wy", "wz")]
        else:
            raise ModelError(
                f"joint '{name}' is a {joint.shortname()}, which is not supported; "
                "supported are revolute, continuous and prismatic joints."
            )
    return tuple(names)


def link_names(model: Any) -> tuple[str, ...]:
    """Return the first body of each joint: the URDF link that the joint moves."""
    import pinocchio as pin

    bodies: dict[int, str] = {}
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY:
            bodies.setdefault(frame.parentJoint, frame.name)
    return tuple(bodies.get(i, model.names[i]) for i in range(1, model.njoints))


def each_state(
    algorithm: Callable[..., Any], model: Any, shape: tuple[int, ...], *states: Array
) -> Array:
    """Return the results (K, *shape) of an algorithm of Pinocchio, state by state."""
    data, out = model.createData(), np.empty((len(states[0]), *shape))
    for k, state in enumerate(zip(*states, strict=True)):
        found = algorithm(model, data, *state)
        # With a single joint the binding drops the axis of length one.
        out[k] = np.reshape(found, shape) if model.nv == 1 else found
    return out
