"""Terms that depend on where the robot stands: a tilt of gravity, friction that grows with load.

Their efforts are products of two unknowns: an angle or a coefficient, and the inertia of the links.
The columns take the links from given bodies, so that the effort is linear in the first alone.
`sdpid.estimation.effects` takes the bodies from an estimate, and from the next one again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import ModelError
from sdpid.robot.friction.term import (
    EffortCurve,
    OfPosition,
    SampledMotion,
    TermParameter,
    check_speeds,
    diagonal,
    of_each_joint,
    smooth_sign,
)
from sdpid.robot.inertia import least_turn

# Inertial parameters of every link, ten each about its joint's frame.
Bodies = tuple[tuple[float, ...], ...]

# Robots are set up by spirit level and by eye: most stand upright within some degrees.
_UPRIGHT = 0.03  # rad

# No mass, moment or inertia of a link is larger, in SI units; squares are far from overflow.
LARGEST = 1e12

# Gears lose some percent of the load that they carry.
_LOSS = 0.1


@dataclass(frozen=True)
class PosedTerm(OfPosition):
    """A term whose columns depend on the position and on the links' inertia.

    Attributes
    ----------
    bodies : tuple of tuple of float, optional
        Inertial parameters of the links at which the columns are taken; by default those of the
        robot's description.
    """

    bodies: Bodies | None = None

    def __post_init__(self) -> None:
        for body in self.bodies or ():
            numbers = body if isinstance(body, tuple) else ()
            if len(numbers) != 10 or not all(
                isinstance(x, (int, float)) and abs(x) <= LARGEST for x in numbers
            ):
                raise ModelError(
                    f"{type(self).__name__}: a body is {body!r:.80}; give ten numbers of at most "
                    f"{LARGEST:g} for each link."
                )

    def _efforts(self, motion: SampledMotion, *rates: Array, gravity: Array | None = None) -> Array:
        """Return the efforts (K, n) of the links at the motion's positions and some rates."""
        robot = motion.robot
        bodies = np.asarray(robot.prior if self.bodies is None else self.bodies)
        if bodies.shape != robot.prior.shape:
            raise ModelError(
                f"{type(self).__name__}: bodies have shape {bodies.shape}, the robot "
                f"'{robot.name}' needs {robot.prior.shape}."
            )
        if robot.free_flyer:
            raise ModelError(
                f"{type(self).__name__}: the base of '{robot.name}' floats; leave this term out."
            )
        found = robot.efforts_of_bodies(bodies, motion.position, *rates, gravity=gravity)
        return np.asarray(found)


@dataclass(frozen=True)
class Tilt(PosedTerm):
    """Gravity's direction in the base, as two small angles Gx and Gy in rad.

    Gravity is turned by Gx about the first and by Gy about the second of two horizontal axes:
    those of the base where gravity is along its z axis. The base stands tilted the other way.

    `identify` chooses this term by the data (``effects="tilt"`` puts it in), and takes the bodies
    from a first fit. In `build_problem` the description's must have masses: without, there is no
    column and no parameter.

    Attributes
    ----------
    bodies : tuple of tuple of float, optional
        Ten inertial parameters of each link, whose weight the angles turn; by default those of
        the robot's description.

    Examples
    --------
    >>> bodies = tuple(map(tuple, estimate.theta[:60].reshape(-1, 10)))
    >>> terms = ("coulomb", "viscous", sdpid.friction.Tilt(bodies))
    >>> problem = sdpid.build_problem(robot, samples, friction=terms)
    >>> angles = sdpid.solve_sdp(problem).named()
    >>> bool(abs(angles["Gx"]) < 0.01), bool(abs(angles["Gy"]) < 0.01)
    (True, True)
    """

    def parameters(self, joint_names: Sequence[str]) -> tuple[TermParameter, ...]:
        """Return the two angles."""
        return tuple(
            TermParameter(name, "rad", False, 0, deviation=_UPRIGHT) for name in ("Gx", "Gy")
        )

    def columns_in(self, motion: SampledMotion, joint_names: Sequence[str]) -> Array:
        """Return how the gravitational efforts of the bodies change with the angles."""
        rest, changes = np.zeros_like(motion.velocity), self.change(motion.robot.gravity)
        return np.stack([self._efforts(motion, rest, rest, gravity=g) for g in changes], axis=2)

    def simulated(self, values: Array, joint_names: Sequence[str]) -> Iterator[EffortCurve]:
        """Yield nothing: gravity is no friction."""
        yield from ()

    @staticmethod
    def change(gravity: Array) -> Array:
        """Return the change of gravity (2, 3) with each angle, m/s² per rad."""
        return np.cross(horizontal_axes(gravity), gravity)


@dataclass(frozen=True)
class LoadFriction(PosedTerm):
    """Coulomb friction that grows with the load of the gear, ``Fl·abs(load)·sign(v)``.

    The load is the effort that moves and carries the links; Fl has no unit. `identify` chooses
    this term by the data (``effects="load"`` puts it in), and takes the bodies from a first fit.
    In `build_problem` the description's must have masses: without, there is no column and no
    parameter.

    Attributes
    ----------
    bodies : tuple of tuple of float, optional
        Ten inertial parameters of each link, from which the load is computed; by default those of
        the robot's description.
    width : float or tuple of float
        Width (rad/s) of the sign, as for `Coulomb`: one for all joints, or one per joint.
    share : tuple of float
        Of each joint the share of the sign that a sigmoid has in place of it, with the friction
        that does not depend on the load; empty for none.
    velocity : tuple of float
        Speeds (rad/s) of that sigmoid, as for `SigmoidFriction`.

    Examples
    --------
    >>> bodies = tuple(map(tuple, estimate.theta[:60].reshape(-1, 10)))
    >>> terms = ("coulomb", "viscous", sdpid.friction.LoadFriction(bodies))
    >>> problem = sdpid.build_problem(robot, samples, friction=terms)
    >>> problem.base.names[-3:]
    ('Fs6', 'Fv6', 'Fl6')
    >>> sdpid.solve_sdp(problem).status
    'optimal'
    """

    width: float | tuple[float, ...] = 0.0
    share: tuple[float, ...] = ()
    velocity: tuple[float, ...] = ()
    efforts: ClassVar[Mapping[str, str]] = {"Fl": "size({load}) * {sign}"}

    def __post_init__(self) -> None:
        super().__post_init__()
        check_speeds(self, ("width", "velocity"))
        if not all(isinstance(x, (int, float)) and 0.0 <= x <= 1.0 for x in self.share):
            raise ModelError(f"LoadFriction: share is {self.share!r:.80}; give numbers in [0, 1].")
        if len(self.share) != len(self.velocity):
            raise ModelError(
                f"LoadFriction: share has {len(self.share)} values, velocity {len(self.velocity)}; "
                "give one a joint of each."
            )

    def parameters(self, joint_names: Sequence[str]) -> tuple[TermParameter, ...]:
        """Return one share of the load a joint."""
        return of_each_joint(joint_names, self.efforts, "1", True, deviation=_LOSS)

    def columns_in(self, motion: SampledMotion, joint_names: Sequence[str]) -> Array:
        """Return the bodies' efforts times the filtered sign: they vary slowly beside it."""
        load = np.abs(self._efforts(motion, motion.velocity, motion.acceleration))
        sign = motion.filtered(self.sign, ("load", self.width, self.share, self.velocity))
        return diagonal(load * sign)

    def simulated(self, values: Array, joint_names: Sequence[str]) -> Iterator[EffortCurve]:
        """Yield the shares of the load, and where their signs jump."""
        n = len(values)
        widths, none = self.speed("width", n).tolist(), (0.0,) * n
        speeds = self.speed("velocity", n).tolist() if self.share else none
        for j, numbers in enumerate(zip(self.share or none, speeds, widths, strict=True)):
            yield EffortCurve("load", j, float(values[j]), numbers)
            if widths[j] == 0.0 and numbers[0] < 1.0:
                yield EffortCurve("jump", j, 0.0, (0.0, 0.0, 0.0))

    def sign(self, velocity: Array, acceleration: Array) -> Array:
        """Return what the size of the load is multiplied by, (K, n)."""
        n = velocity.shape[1]
        sign = smooth_sign(velocity, self.speed("width", n), 0.0)
        if self.share:
            slow = np.tanh(velocity / self.speed("velocity", n))
            share = np.asarray(self.share)
            sign = (1.0 - share) * sign + share * slow
        return np.asarray(sign)


@dataclass(frozen=True)
class PositionFriction(OfPosition):
    """Coulomb friction that changes with the position, ``f(q)·sign(v)``, in place of `Coulomb`.

    f is a parabola over a range of positions, held beyond its ends. Its three numbers are the
    values of f at the lower end and at the upper end, Fpa and Fpc, and Fpb between them, through
    which its two end tangents pass: where none is negative, f is not either, so that friction never
    drives the joint. They are in N·m, of sliding joints in N.

    Attributes
    ----------
    lower, upper : tuple of float
        Ends of each joint's range, rad (m); those of the positions that were recorded, say.
    width : float or tuple of float
        Width (rad/s) of the sign, as for `Coulomb`: one for all joints, or one per joint.

    Raises
    ------
    ModelError
        When a range is empty or not finite, or lengths differ.

    Examples
    --------
    >>> low, high = samples.position.min(axis=0), samples.position.max(axis=0)
    >>> drag = sdpid.friction.PositionFriction(tuple(low.tolist()), tuple(high.tolist()))
    >>> problem = sdpid.build_problem(robot, samples, friction=("viscous", drag))
    >>> problem.base.names[-2:]
    ('Fpb6', 'Fpc6')
    """

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    width: float | tuple[float, ...] = 0.0
    efforts: ClassVar[Mapping[str, str]] = {
        symbol: f"bend({{q}}, {{lower!r}}, {{upper!r}}, {own}) * {{sign}}"
        for symbol, own in (("Fpa", "1, 0, 0"), ("Fpb", "0, 1, 0"), ("Fpc", "0, 0, 1"))
    }

    def __post_init__(self) -> None:
        check_speeds(self, ("width",))
        for name in ("lower", "upper"):
            object.__setattr__(self, name, tuple(float(x) for x in getattr(self, name)))
        ends = (self.lower, self.upper)
        if len(self.lower) != len(self.upper) or not np.isfinite(ends).all():
            raise ModelError(
                f"PositionFriction: the range is from {self.lower!r:.80} to {self.upper!r:.80}; "
                "give two finite numbers a joint."
            )
        for j, (low, high) in enumerate(zip(*ends, strict=True)):
            if not high > low:
                raise ModelError(
                    f"PositionFriction: the range of joint {j + 1} is from {low} to {high}; "
                    "give a lower and a larger upper end."
                )

    def parameters(self, joint_names: Sequence[str]) -> tuple[TermParameter, ...]:
        """Return the three numbers of every joint, kind by kind."""
        return of_each_joint(joint_names, self.efforts, "N.m", True)

    def simulated(self, values: Array, joint_names: Sequence[str]) -> Iterator[EffortCurve]:
        """Yield the parabolas and their ranges, and where their signs jump."""
        widths, three = self.speed("width", len(joint_names)), np.reshape(values, (3, -1)).T
        for j, (a, b, c) in enumerate(three.tolist()):
            numbers = (self.lower[j], self.upper[j], a, b, c)
            yield EffortCurve("position", j, float(widths[j]), numbers)
            if widths[j] == 0.0:
                yield EffortCurve("jump", j, 0.0, (0.0, 0.0, 0.0))

    def columns_in(self, motion: SampledMotion, joint_names: Sequence[str]) -> Array:
        """Return the shapes times the filtered sign: they vary slowly beside it."""
        n = len(joint_names)
        if len(self.lower) != n:
            raise ModelError(
                f"PositionFriction: ranges of {len(self.lower)} joints, the robot has {n}; give "
                "one a joint."
            )
        width = self.speed("width", n)
        sign = motion.filtered(lambda v, _: smooth_sign(v, width, 0.0), ("position", self.width))
        return diagonal(*self.shapes(motion.position[:, -n:]) * sign)

    def control_values(self, level: Callable[[Array], Array]) -> Array:
        """Return the three numbers (3, n) of a parabola, none negative.

        Parameters
        ----------
        level : callable
            Returns the parabola's values (K, n) at positions (K, n).
        """
        low, high = np.asarray(self.lower), np.asarray(self.upper)
        ends = level(np.stack([low, 0.5 * (low + high), high]))
        middle = 2.0 * ends[1] - 0.5 * (ends[0] + ends[2])
        return np.asarray(np.maximum([ends[0], middle, ends[2]], 0.0))

    def shapes(self, position: Array) -> Array:
        """Return what the three numbers are multiplied by at positions (K, n), (3, K, n)."""
        low, high = np.asarray(self.lower), np.asarray(self.upper)
        x = np.clip((position - low) / (high - low), 0.0, 1.0)
        return np.stack([(1.0 - x) ** 2, 2.0 * x * (1.0 - x), x**2])


def horizontal_axes(gravity: Array) -> Array:
    """Return two unit vectors (2, 3) across gravity: x and y turned as z is turned to point up.

    Raises
    ------
    ModelError
        Without gravity.
    """
    size = float(np.linalg.norm(gravity))
    if not size > 0.0:
        raise ModelError("Tilt: the robot has no gravity whose direction could be found.")
    up = -np.asarray(gravity) / size
    z = np.array([0.0, 0.0, 1.0])
    if up[2] < 0.0:
        # The least turn of z is not continuous about a robot that hangs: start from below.
        z, up = -z, up
    return least_turn(z, up).T[:2]
