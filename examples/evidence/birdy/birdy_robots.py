"""The robots of the benchmark: true parameters, controllers, limits and levels of noise."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

import sdpid
from sdpid._common.arrays import Array
from sdpid._common.files import load_toml
from sdpid.experiment.simulation.controllers import PD
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.inertia import margin, theta_from_physical
from sdpid.robot.model.base_parameters import BaseParameters, structural_base
from sdpid.robot.model.dynamics import RobotDynamics

HERE = Path(__file__).resolve().parent

# Width of the source's sign, rad/s.
SMOOTH = 0.01

# Standard deviations of encoders (degrees) and of measured torques (N·m); "old" is in the files.
NOISE: dict[str, tuple[float, float] | None] = {
    "lowPosition": (1e-4, 0.05),
    "standard": (1e-3, 0.05),
    "highPosition": (1e-2, 0.05),
    "highTorque": (1e-3, 0.1),
    "highPositionTorque": (1e-2, 0.1),
    "old": None,
}

# Standard deviation of a start, as a share of the truth, and how many there are.
SPREAD, STARTS = 0.15, 25


class Benchmark:
    """A robot of the benchmark; arrays are (6,) or (6, …).

    Parameters
    ----------
    name : str
        One of `birdy.LEVELS`.

    Attributes
    ----------
    robot : RobotModel
        Kinematics, with the true inertias as its description.
    friction : tuple
        The terms that the robot has, which are the terms that are identified.
    theta : ndarray, shape (p,)
        The truth.
    controller : Controller
        Proportional and derivative, with limits of the effort where the robot has them.
    torque : ndarray or None
        These limits, N·m.
    position : ndarray, shape (2, 6)
        Lower and upper limits, rad.
    velocity, acceleration : ndarray, float
        Limits, rad/s and rad/s².
    old : tuple of ndarray
        Standard deviations of the level "old", of encoders (rad) and of torques (N·m).
    rate_hz, sample_hz : float
        Of the controller, and samples of the log a second.
    """

    def __init__(self, name: str) -> None:
        data: dict[str, Any] = load_toml(HERE / f"{name.partition('_')[0]}.toml")
        table, links, control = data["kinematics"], data["links"], data["control"]
        limits, noise, own = data["limits"], data["noise"], data["friction"]
        self.position = np.radians([limits["position_deg"][k] for k in ("lower", "upper")])
        columns = {
            "alpha": np.radians(table["alpha_deg"]),
            "d": np.array(table["a"]),
            "theta": np.radians(table["theta_offset_deg"]),
            "r": np.array(table["d"]),
            "lower": self.position[0],
            "upper": self.position[1],
        }
        joints = [{key: float(column[j]) for key, column in columns.items()} for j in range(6)]
        bodies, base = _bodies(links), [0.0, 0.0, table["base_height"]]
        self.robot = sdpid.RobotModel.from_mdh(
            joints, base_translation=base, inertias=bodies, name=name
        )
        sign = sdpid.friction.Coulomb(width=SMOOTH if name.endswith("smooth") else 0.0)
        self.friction: tuple[Any, ...] = (sign, "viscous", "rotor_inertia")
        values = [bodies.ravel(), own["coulomb"], own["viscous"], links["rotor_inertia"]]
        if name == "tx40":
            coupled = (self.robot.joint_names[j - 1] for j in own["coupling"]["joints"])
            self.friction += (sdpid.friction.Coupling(*coupled),)
            # Rotor inertia, viscous and Coulomb friction across; the source has no inertia there.
            values.append([0.0, own["coupling"]["viscous"], own["coupling"]["coulomb"]])
        self.theta = np.concatenate([np.asarray(value, dtype=np.float64) for value in values])
        gain = np.array(control["drive_gain"])
        self.torque = np.array(limits["torque"]) if "torque" in limits else None
        gains = gain * control["kp"], gain * control["kd"]
        self.controller = PD(*gains, effort_limit=self.torque)
        self.velocity = np.radians(limits["velocity_deg_s"])
        self.acceleration = limits["acceleration_rad_s2"]
        self.old = np.radians(noise["position_sd_deg"]), np.array(noise["torque_sd"])
        self.rate_hz = control["rate_hz"]
        # The nearest whole number of periods: logs at 1000 Hz, and at 138.9 for 140.
        every = round(control["rate_hz"] / control["sample_hz"]) * (1 + name.endswith("slow"))
        self.sample_hz = self.rate_hz / every

    @cached_property
    def terms(self) -> FrictionModel:
        """The terms that the robot has."""
        return FrictionModel.from_terms(self.friction, self.robot.joint_names)

    @cached_property
    def base(self) -> BaseParameters:
        """The base parameters."""
        return structural_base(self.robot, self.terms)

    @cached_property
    def truth(self) -> Array:
        """The true base parameters (b,)."""
        return np.asarray(self.base.matrix @ self.theta)

    def noise(self, level: str) -> tuple[Array, Array]:
        """Return standard deviations of encoders (rad) and of measured torques (N·m), (6,)."""
        given = NOISE[level]
        return (np.full(6, np.radians(given[0])), np.full(6, given[1])) if given else self.old

    def model(self, theta: Array) -> RobotDynamics:
        """Return the robot with other parameters, to simulate with."""
        return RobotDynamics(robot=self.robot, terms=self.terms, theta=theta)

    def start(self, number: int) -> Array:
        """Return a start: all of theta off by 15 %, drawn again until the link is consistent.

        As the benchmark does; that draws all links again where one is not.
        """
        rng = np.random.default_rng([number % STARTS, 17])
        theta = self.theta * (1.0 + SPREAD * rng.standard_normal(len(self.theta)))
        for i in range(self.robot.n_links):
            own = slice(10 * i, 10 * i + 10)
            while not margin(theta[own], "pseudo_inertia") > 0.0:
                theta[own] = self.theta[own] * (1.0 + SPREAD * rng.standard_normal(10))
        return theta

    def described(self, theta: Array) -> sdpid.RobotModel:
        """Return the robot with a description of other inertias."""
        model = self.robot.pin_model.copy()
        for i, body in enumerate(theta[: 10 * self.robot.n_links].reshape(-1, 10), 1):
            model.inertias[i] = type(model.inertias[i]).FromDynamicParameters(body)
        return sdpid.RobotModel.from_pinocchio(model)


def _bodies(links: dict[str, Any]) -> Array:
    """Return inertial parameters about the joints' frames, (6, 10)."""
    mass = np.array(links["mass"])
    # Files have xx xy xz yy yz zz, theta has xx xy yy xz yz zz.
    order = [0, 1, 3, 2, 4, 5]
    if "inertia" in links:
        return np.column_stack([mass, links["first_moment"], np.array(links["inertia"])[:, order]])
    xx, xy, xz, yy, yz, zz = np.array(links["inertia_com"]).T
    tensors = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=-1).reshape(-1, 3, 3)
    return theta_from_physical(mass, np.array(links["center_of_mass"]), tensors)
