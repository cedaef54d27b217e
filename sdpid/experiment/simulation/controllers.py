"""Controllers of joints: P, PD, PID and computed torque."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.experiment.simulation.arm import SimulatedArm
from sdpid.experiment.simulation.law import Gains, Law
from sdpid.robot.model.dynamics import RobotDynamics


@dataclass(frozen=True, eq=False, repr=False)
class P(Law):
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

    @property
    def gains(self) -> Gains:
        """Gains of the position error and of the velocity, and limits."""
        stiffness = self.velocity_gain * self.proportional_gain
        return PD(stiffness, self.velocity_gain, self.feedforward, self.effort_limit).gains


@dataclass(frozen=True, eq=False, repr=False)
class PD(Law):
    """Proportional-derivative control of each joint, ``kp·(q_d − q) + kd·(v_d − v)``.

    Attributes
    ----------
    kp : ndarray, shape (n,)
        Effort per position error, N·m/rad (N/m).
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
    >>> law = sdpid.controllers.PD(np.full(2, 400.0), np.full(2, 40.0), effort_limit=np.ones(2))
    >>> zero = np.zeros((1, 2))
    >>> law.effort(zero, zero, zero + 0.001, zero)
    array([[0.4, 0.4]])
    >>> law.effort(zero, zero, zero + 1.0, zero)
    array([[1., 1.]])
    """

    kp: Array
    kd: Array
    feedforward: bool = True
    effort_limit: Array | None = None


@dataclass(frozen=True, eq=False, repr=False)
class PID(Law):
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
class ComputedTorque(Law):
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
        object.__setattr__(self, "_arm", SimulatedArm.of(self.model))

    @property
    def arm(self) -> SimulatedArm:
        """The model as the compiled loop takes it."""
        found: SimulatedArm = self._arm  # type: ignore[attr-defined]
        return found

    def _law(self, q: Array, v: Array, qd: Array, vd: Array, ad: Array, integral: Array) -> Array:
        M, h = self.arm.mass_and_bias(q, v)
        a = ad + self._command(q, qd, vd, integral) - self.kd * v
        return np.asarray(np.einsum("kij,kj->ki", M, a) + h + self._friction(vd))

    def _friction(self, v: Array) -> Array:
        """Return the model's friction without its constants, which are in the bias."""
        return self.model.friction(v) - self.model.friction(np.zeros_like(v))

    def _slopes(
        self, q: Array, v: Array, qd: Array, vd: Array, ad: Array, integral: Array
    ) -> tuple[Array, Array]:
        import pinocchio as pin

        M, _ = self.arm.mass_and_bias(q, v)
        a = ad + self._command(q, qd, vd, integral) - self.kd * v
        robot = self.model.robot
        links, E = self.model.to_pinocchio(), robot.expansion
        links.armature[:] = 0.0
        data = links.createData()
        by_position, by_velocity = -M * self.kp, -M * self.kd
        for k, state in enumerate(zip(robot.configuration(q), v @ E.T, a @ E.T, strict=True)):
            pin.computeRNEADerivatives(links, data, *state)
            by_position[k] += E.T @ data.dtau_dq @ E
            by_velocity[k] += E.T @ data.dtau_dv @ E
        return by_position, by_velocity
