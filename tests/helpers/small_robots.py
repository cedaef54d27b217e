"""The smallest robots, each with a log: where arrays lose an axis, and limits are missing."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

import sdpid
from sdpid._common.arrays import Array
from sdpid.robot.inertia import theta_from_physical
from tests.helpers.motions import sines

RATE = 100.0
MASS = 1.5
LOAD = theta_from_physical(MASS, [0.0, 0.02, 0.1], 0.006 * np.eye(3))

_LINK = """<link name="{0}_link"><inertial><origin xyz="0.15 0.02 0.05" rpy="0.1 0.2 0"/>
<mass value="2"/><inertia ixx="0.02" iyy="0.03" izz="0.02" ixy="0.001" ixz="0" iyz="0"/>
</inertial></link>
<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{0}_link"/><axis xyz="{3}"/>
<origin xyz="{4} 0 0"/><limit effort="80" velocity="3"{5}/></joint>"""
_ENDS = ' lower="-2" upper="2"'


def _urdf(name: str, *joints: tuple[str, str, str, str]) -> str:
    """Return a chain of joints, each a name, a kind, an axis and its ends."""
    parents = ["base", *(f"{joint[0]}_link" for joint in joints)]
    links = [
        _LINK.format(joint, kind, parent, axis, 0.0 if parent == "base" else 0.3, ends)
        for (joint, kind, axis, ends), parent in zip(joints, parents, strict=False)
    ]
    return "\n".join([f'<robot name="{name}"><link name="base"/>', *links, "</robot>"])


@dataclass(frozen=True)
class SmallRobot:
    """A robot as URDF, and the joints whose effort its logs do not have."""

    urdf: str
    without_effort: tuple[str, ...] = ()

    @property
    def model(self) -> sdpid.RobotModel:
        """The robot as `load_robot` reads it."""
        return sdpid.load_robot(self.urdf)

    def log(
        self, seed: int = 0, *, load: Array | None = None, gain: float = 1.0
    ) -> sdpid.Recording:
        """Return a log of a motion that shows all; `load` hangs on the last link.

        With a gain, N·m/A, that of the motors' currents.
        """
        robot, rng = self.model, np.random.default_rng(seed)
        t = np.arange(0.0, 10.0, 1.0 / RATE)
        w, c = rng.uniform(0.8, 4.0, (3, robot.n)), rng.uniform(0.0, 6.0, (3, robot.n))
        q, v, a = sines(t, w, c, 0.4)
        bodies = np.array(robot.prior)
        bodies[-1] += 0.0 if load is None else load
        effort = robot.inverse_dynamics(bodies, q, v, a)
        effort += 0.5 * v + 0.3 * np.sign(v) + 0.01 * rng.standard_normal(effort.shape)
        effort[:, [robot.joint_names.index(name) for name in self.without_effort]] = 0.0
        log = sdpid.Recording(time=t, position=q, effort=effort, joint_names=robot.joint_names)
        return log if gain == 1.0 else replace(log, effort=effort / gain, currents=True)


_TWO = (("low", "revolute", "0 1 0"), ("high", "revolute", "0 1 0"))
SMALL = {
    "hinge": SmallRobot(_urdf("hinge", ("turn", "revolute", "0 1 0", _ENDS))),
    "slider": SmallRobot(_urdf("slider", ("lift", "prismatic", "0 0 1", _ENDS))),
    "wheel": SmallRobot(_urdf("wheel", ("roll", "continuous", "0 1 0", ""))),
    "without_limits": SmallRobot(_urdf("without_limits", *((*joint, "") for joint in _TWO))),
    "without_effort": SmallRobot(
        _urdf("without_effort", *((*joint, _ENDS) for joint in _TWO)), ("high",)
    ),
}

# For laws that hold of any description, by names that tests show.
URDFS = [pytest.param(small.urdf, id=name) for name, small in SMALL.items()]
MODELS = {name: small.model for name, small in SMALL.items()}
