"""Controllers of joints: P, PD, PID and computed torque."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator
from dataclasses import dataclass, fields, replace
from functools import cached_property
from inspect import signature
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen, is_number, real_array
from sdpid._common.tables import Shown, Table
from sdpid.errors import DataError
from sdpid.experiment.simulation.arm import SimulatedArm
from sdpid.robot.model.dynamics import RobotDynamics

# The longest delay (s) that is believed of a drive: no robot is stable with a longer one.
_LONGEST_DELAY = 0.1


def keep_per_joint(
    owner: Any,
    what: str,
    names: Collection[str],
    *,
    signed: Collection[str] = (),
    not_negative: Collection[str] = (),
) -> None:
    """Check fields of a frozen dataclass, one number a joint, positive by default, and keep them.

    Those that are None are left alone.
    """
    sizes = {}
    for name in names:
        if (values := getattr(owner, name)) is None:
            continue
        array = real_array(values, f"{what}.{name}", ndim=1)
        zero = name not in not_negative and (array == 0.0).any()
        if name not in signed and (zero or (array < 0.0).any()):
            raise DataError(
                f"{what}: {name} is {array.tolist()}; give positive numbers, one a joint."
            )
        object.__setattr__(owner, name, frozen(array))
        sizes[name] = len(array)
    if len(set(sizes.values())) > 1:
        raise DataError(f"{what}: lengths differ: {sizes}; give one number a joint in each.")


class Controller(ABC):
    """What turns positions and velocities, measured and desired, into efforts.

    Those of `sdpid.controllers` run in the compiled loop; a class of your own that derives from
    this one works too, at the speed of Python.

    Examples
    --------
    >>> law = sdpid.controllers.PD(np.full(6, 400.0), np.full(6, 40.0))
    >>> isinstance(law, sdpid.controllers.Controller)
    True
    """

    @property
    @abstractmethod
    def n(self) -> int:
        """Number of joints."""

    @abstractmethod
    def effort(
        self,
        position: ArrayLike,
        velocity: ArrayLike,
        reference: ArrayLike,
        reference_velocity: ArrayLike,
        reference_acceleration: ArrayLike | None = None,
        integral: ArrayLike | None = None,
    ) -> Array:
        """Return the efforts (K, n) at K samples, in N·m or N.

        Parameters
        ----------
        position, velocity : array_like, shape (K, n)
            What the controller sees.
        reference, reference_velocity : array_like, shape (K, n)
            Commanded positions and velocities.
        reference_acceleration : array_like, shape (K, n), optional
            For computed torque.
        integral : array_like, shape (K, n), optional
            Integral of the position error, rad·s; needed where there is an integral gain.
        """

    @abstractmethod
    def slopes(
        self,
        position: ArrayLike,
        velocity: ArrayLike,
        reference: ArrayLike,
        reference_velocity: ArrayLike,
        reference_acceleration: ArrayLike | None = None,
        integral: ArrayLike | None = None,
    ) -> tuple[Array, Array]:
        """Return d effort / d position and d effort / d velocity, (K, n, n) each.

        They are zero where the effort is at its limit. Parameters are those of `effort`.
        """


# What the effort of a controller depends on, in the order of its arguments.
_STATES = tuple(signature(Controller.effort).parameters)[1:]


class LoopGains(NamedTuple):
    """Gains (n,) of ``kp·(q_d − q) + kd·(feedforward·v_d − v) + ki·∫(q_d − q)``, and limits."""

    proportional: Array
    derivative: Array
    integral: Array
    feedforward: Array
    limit: Array


@dataclass(frozen=True, eq=False, repr=False)
class JointLaw(Shown, Controller):
    """What the controllers of `sdpid.controllers` are: linear in the tracking error, and limited.

    Without a model the law gives efforts; with one it corrects the acceleration of the model.
    """

    # Names of gains that are positive, and of those that may be zero.
    _positive: ClassVar[tuple[str, ...]] = ("kp",)
    _not_negative: ClassVar[tuple[str, ...]] = ("kd",)

    def __post_init__(self) -> None:
        names = (*self._positive, *self._not_negative, "effort_limit")
        keep_per_joint(self, type(self).__name__, names, not_negative=self._not_negative)

    @cached_property
    def _settings(self) -> dict[str, Any]:
        # The second name of the limit says nothing new.
        return {
            each.name: getattr(self, each.name) for each in fields(self) if each.name != "limit"
        }

    @cached_property
    def gains(self) -> LoopGains:
        """Gains of the law, before a model turns accelerations into efforts."""
        own = self._settings
        kd = own["velocity_gain"] if "velocity_gain" in own else own["kd"]
        kp = kd * own["proportional_gain"] if "velocity_gain" in own else own["kp"]
        zero, limit = np.zeros(len(kp)), own["effort_limit"]
        return LoopGains(
            proportional=kp,
            derivative=kd,
            integral=own.get("ki", zero),
            feedforward=zero + own.get("feedforward", True),
            limit=zero + np.inf if limit is None else limit,
        )

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.gains.proportional)

    @property
    def arm(self) -> SimulatedArm | None:
        """The model of the controller as the compiled loop takes it; None without one."""
        return None

    def effort(
        self,
        position: ArrayLike,
        velocity: ArrayLike,
        reference: ArrayLike,
        reference_velocity: ArrayLike,
        reference_acceleration: ArrayLike | None = None,
        integral: ArrayLike | None = None,
    ) -> Array:
        """Return the efforts (K, n) at K samples, as `Controller.effort` says."""
        given = (position, velocity, reference, reference_velocity)
        states = self._checked(*given, reference_acceleration, integral)
        return np.clip(self._unlimited(*states), -self.gains.limit, self.gains.limit)

    def slopes(
        self,
        position: ArrayLike,
        velocity: ArrayLike,
        reference: ArrayLike,
        reference_velocity: ArrayLike,
        reference_acceleration: ArrayLike | None = None,
        integral: ArrayLike | None = None,
    ) -> tuple[Array, Array]:
        """Return the slopes of the efforts, as `Controller.slopes` says."""
        given = (position, velocity, reference, reference_velocity)
        states = self._checked(*given, reference_acceleration, integral)
        free = (np.abs(self._unlimited(*states)) < self.gains.limit)[..., None]
        by_position, by_velocity = self._slopes(*states)
        return by_position * free, by_velocity * free

    def _checked(self, *arrays: ArrayLike | None) -> list[Array]:
        """Return the arguments as arrays (K, n); what is missing and not needed is zero."""
        found: list[Array] = []
        for name, values in zip(_STATES, arrays, strict=True):
            if values is None and name == "integral" and self.gains.integral.any():
                raise DataError(
                    f"{type(self).__name__}: integral is missing; give the integral of the "
                    "position error, (K, n) in rad·s."
                )
            array = np.zeros_like(found[0]) if values is None else real_array(values, name, ndim=2)
            rows = len(found[0]) if found else len(array)
            if array.shape != (rows, self.n):
                raise DataError(
                    f"{name}: shape {array.shape}, expected {(rows, self.n)}: one row a sample, "
                    "one column a joint of the controller."
                )
            found.append(array)
        return found

    def _unlimited(
        self, q: Array, v: Array, qd: Array, vd: Array, ad: Array, integral: Array
    ) -> Array:
        """Return the law before limits: efforts, or corrections of an acceleration."""
        g = self.gains
        error, rate = qd - q, g.feedforward * vd - v
        return np.asarray(g.proportional * error + g.derivative * rate + g.integral * integral)

    def _slopes(self, q: Array, *states: Array) -> tuple[Array, Array]:
        """Return the slopes before limits."""
        shape, g = (len(q), self.n, self.n), self.gains
        return (
            np.broadcast_to(np.diag(-g.proportional), shape),
            np.broadcast_to(np.diag(-g.derivative), shape),
        )

    def __repr__(self) -> str:
        parts = [f"{self.n} joints"]
        for name, value in self._settings.items():
            if isinstance(value, np.ndarray):
                low, high = float(value.min()), float(value.max())
                span = f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
                parts.append(f"{name} {span}")
        return f"{type(self).__name__}({', '.join(parts)})"

    def _shown(self) -> dict[str, object]:
        own = self._settings.items()
        return {k: v for k, v in own if not isinstance(v, np.ndarray) and v is not None}

    def _tables(self) -> Iterator[Table]:
        own = {k: v.tolist() for k, v in self._settings.items() if isinstance(v, np.ndarray)}
        yield Table.of_columns({"joint": list(range(1, self.n + 1)), **own})


@dataclass(frozen=True, eq=False, repr=False)
class P(JointLaw):
    """A proportional position loop around a velocity loop, as industrial drives have it.

    ``effort = velocity_gain·(proportional_gain·(q_d − q) − v)``, with v_d added to the commanded
    velocity where there is feedforward. `sdpid.simulate` has this controller.

    Attributes
    ----------
    proportional_gain : ndarray, shape (n,)
        Velocity command per position error, 1/s.
    velocity_gain : ndarray, shape (n,)
        Effort per velocity error, N·m·s/rad (N·s/m).
    feedforward : bool
        Whether the reference's velocity is added to the command.
    effort_limit : ndarray, shape (n,), optional
        Largest efforts, N·m (N).

    Raises
    ------
    DataError
        When a gain or a limit is not positive, or lengths differ.

    Examples
    --------
    >>> law = sdpid.controllers.P(np.full(2, 10.0), np.full(2, 40.0))
    >>> law
    P(2 joints, proportional_gain 10, velocity_gain 40)
    >>> zero = np.zeros((1, 2))
    >>> law.effort(zero, zero, zero + 0.1, zero)
    array([[40., 40.]])
    """

    proportional_gain: Array
    velocity_gain: Array
    feedforward: bool = False
    effort_limit: Array | None = None

    _positive: ClassVar[tuple[str, ...]] = ("proportional_gain", "velocity_gain")
    _not_negative: ClassVar[tuple[str, ...]] = ()


@dataclass(frozen=True, eq=False, repr=False)
class PD(JointLaw):
    """Proportional-derivative control of each joint, ``kp·(q_d − q) + kd·(v_d − v)``.

    As the law of a log whose efforts were not measured (``identify(..., law=...)``) the effort is
    ``kp·(q_d − q) − kd·v``, at the command of `delay` seconds before; see docs/guides/law.md.

    Attributes
    ----------
    kp : ndarray, shape (n,)
        Effort per position error, N·m/rad (N/m); one number for all joints has the shape (1,) until
        the robot is known. As the law of a log None where it is to be found.
    kd : ndarray, shape (n,)
        Effort per velocity error, N·m·s/rad (N·s/m).
    feedforward : bool
        Whether v_d is in the law; without, kd damps the velocity itself. Logs have no v_d.
    effort_limit : ndarray, shape (n,), optional
        Largest efforts, N·m (N).
    delay : float, optional
        Time (s) from a command to its effort, in a log that this law moved; None where it is to be
        found. Simulations in closed loop know it where this is their ``law``.
    limit : ndarray, shape (n,), optional
        The same as `effort_limit`.

    Raises
    ------
    DataError
        When a gain is negative, kp is zero, a limit is not positive, a delay is negative or longer
        than 0.1 s, or lengths differ.

    Examples
    --------
    >>> law = sdpid.controllers.PD(np.full(2, 400.0), np.full(2, 40.0), effort_limit=np.ones(2))
    >>> zero = np.zeros((1, 2))
    >>> law.effort(zero, zero, zero + 0.001, zero)
    array([[0.4, 0.4]])
    >>> law.effort(zero, zero, zero + 1.0, zero)
    array([[1., 1.]])
    """

    kp: Array | float | None
    kd: Array | float
    feedforward: bool = True
    effort_limit: Array | None = None
    delay: float | None = None
    limit: Array | float | None = None

    def __post_init__(self) -> None:
        limit = self.effort_limit if self.limit is None else self.limit
        named = {"kp": self.kp, "kd": self.kd, "effort_limit": limit}
        numbers = {name: x for name, x in named.items() if x is not None}
        count = max((np.size(x) for x in numbers.values()), default=1)
        for name, x in numbers.items():
            # A number is that of every joint.
            object.__setattr__(self, name, np.full(count, x) if np.ndim(x) == 0 else x)
        super().__post_init__()
        object.__setattr__(self, "limit", self.effort_limit)
        delay: Any = 0.0 if self.delay is None else self.delay
        if not (is_number(delay) and 0.0 <= delay <= _LONGEST_DELAY):
            raise DataError(
                f"PD: delay is {self.delay!r}; give seconds from 0 to {_LONGEST_DELAY:g}, or None "
                "where it is to be found."
            )

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(np.atleast_1d(self.kd))

    @cached_property
    def gains(self) -> LoopGains:
        """Gains of the law; refused where kp is to be found."""
        if self.kp is None:
            raise DataError("PD: kp is None, to be found in a log; a simulation needs a number.")
        return super().gains

    def of_joints(self, n: int) -> PD:
        """Return the law with one number a joint.

        Raises
        ------
        DataError
            When it has those of another number of joints.
        """
        kd = np.asarray(self.kd)
        if len(kd) not in (1, n):
            raise DataError(
                f"law: PD has gains of {len(kd)} joints, the robot has {n}; give one number for "
                "all, or one a joint."
            )
        kp, limit = (
            None if x is None else np.broadcast_to(np.asarray(x), n) for x in (self.kp, self.limit)
        )
        return replace(self, kp=kp, kd=np.broadcast_to(kd, n), limit=limit, effort_limit=None)


@dataclass(frozen=True, eq=False, repr=False)
class PID(JointLaw):
    """Proportional, integral and derivative control of each joint.

    ``kp·(q_d − q) + ki·∫(q_d − q) dt + kd·(v_d − v)``. The integral starts at zero, and rests while
    the effort is at its limit.

    Attributes
    ----------
    kp : ndarray, shape (n,)
        Effort per position error, N·m/rad (N/m).
    ki : ndarray, shape (n,)
        Effort per integral of the position error, N·m/(rad·s).
    kd : ndarray, shape (n,)
        Effort per velocity error, N·m·s/rad (N·s/m).
    feedforward : bool
        Whether v_d is in the law; without, kd damps the velocity itself.
    effort_limit : ndarray, shape (n,), optional
        Largest efforts, N·m (N).

    Raises
    ------
    DataError
        When a gain is negative, kp is zero, a limit is not positive, or lengths differ.

    Examples
    --------
    >>> sdpid.controllers.PID(np.full(2, 400.0), np.full(2, 50.0), np.full(2, 40.0))
    PID(2 joints, kp 400, ki 50, kd 40)
    """

    kp: Array
    ki: Array
    kd: Array
    feedforward: bool = True
    effort_limit: Array | None = None

    _not_negative: ClassVar[tuple[str, ...]] = ("ki", "kd")


@dataclass(frozen=True, eq=False, repr=False)
class ComputedTorque(JointLaw):
    """Inverse dynamics of a model at an acceleration corrected by the tracking error.

    The model's links and drives move at the measured state and at the acceleration
    ``a_d + kp·(q_d − q) + kd·(v_d − v)``; the model's friction is added at the reference's
    velocity, where no measured noise makes its sign jump. Friction that grows with load is left
    out.

    Attributes
    ----------
    model : RobotDynamics
        The model of the controller, which need not be that of the robot.
    kp : ndarray, shape (n,)
        Acceleration per position error, 1/s².
    kd : ndarray, shape (n,)
        Acceleration per velocity error, 1/s.
    effort_limit : ndarray, shape (n,), optional
        Largest efforts, N·m (N).

    Raises
    ------
    DataError
        When kp is not positive, kd negative, a limit not positive, or lengths differ.
    ModelError
        When the model cannot be simulated, see `simulate_closed_loop`.

    Examples
    --------
    >>> law = sdpid.controllers.ComputedTorque(
    ...     estimate.model(), kp=np.full(6, 100.0), kd=np.full(6, 20.0)
    ... )
    >>> q, v, a = motion.sample(5000, 5001)
    >>> bool(np.allclose(law.effort(q, v, q, v, a), estimate.model().inverse_dynamics(q, v, a)))
    True
    """

    model: RobotDynamics
    kp: Array
    kd: Array
    effort_limit: Array | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.model.robot.n != self.n:
            raise DataError(
                f"ComputedTorque: gains of {self.n} joints, the model '{self.model.robot.name}' "
                f"has {self.model.robot.n}; give one number a joint."
            )
        # What cannot be simulated is told now.
        _ = self.arm

    @cached_property
    def arm(self) -> SimulatedArm:
        """The model as the compiled loop takes it."""
        return SimulatedArm.of(self.model)

    def _unlimited(
        self, q: Array, v: Array, qd: Array, vd: Array, ad: Array, integral: Array
    ) -> Array:
        M, h, _ = self.arm.dynamics(q, v, np.zeros_like(q))
        a = ad + super()._unlimited(q, v, qd, vd, ad, integral)
        # The constants of friction are in the bias.
        friction = self.model.friction(vd) - self.model.friction(np.zeros_like(vd))
        return np.asarray(np.einsum("kij,kj->ki", M, a) + h + friction)

    def _slopes(self, q: Array, *states: Array) -> tuple[Array, Array]:
        v, _, _, ad, _ = states
        M, _, _ = self.arm.dynamics(q, v, np.zeros_like(q))
        a = ad + super()._unlimited(q, *states)
        by_position, by_velocity, _ = inverse_dynamics_slopes(self.model, q, v, a)
        return by_position - M * self.kp, by_velocity - M * self.kd


def inverse_dynamics_slopes(
    model: RobotDynamics, q: Array, v: Array, a: Array
) -> tuple[Array, Array, Array]:
    """Return the derivatives (K, n, n) of the links' efforts by q, v and a."""
    import pinocchio as pin

    robot, links = model.robot, model.to_pinocchio()
    data, E = links.createData(), robot.expansion
    slopes = np.empty((3, len(q), robot.n, robot.n))
    found, below = np.empty((3, links.nv, links.nv)), np.tril_indices(links.nv, -1)
    for k, state in enumerate(zip(robot.configuration(q), v @ E.T, a @ E.T, strict=True)):
        pin.computeRNEADerivatives(links, data, *state)
        # Of the mass matrix the upper triangle is there.
        found[0], found[1], found[2] = data.dtau_dq, data.dtau_dv, data.M
        found[2][below] = found[2].T[below]
        slopes[:, k] = E.T @ found @ E
    slopes[0] += model.stiffness(q)
    return slopes[0], slopes[1], slopes[2]
