"""Closed chains in MuJoCo on a base that is fixed or hangs: a leg with a four-bar, an ankle."""

from typing import Any

import numpy as np

from sdpid import BaseMotion, Contacts, Recording
from tests.helpers.linkages import pulled

# Rods hang on balls at their lower ends, and on two hinges at their upper ones; a base hangs on its
# hook.
_START = """<mujoco model="{name}"><option timestep="0.0005" tolerance="1e-20"/>
<default><equality solref="0.001 1" solimp="0.9999 0.9999 0.001"/></default>
<worldbody><body name="trunk">{root}
 <inertial pos="0.01 -0.02 0.1" mass="2" diaginertia="0.02 0.018 0.012"/>
 <body name="hook" pos="0.02 0.01 0.3"/>
"""
# A crank and a rocker carry the shank.
_LEG = """
 <body name="crank" pos="0.03 0.04 0"><joint name="thigh" axis="0 -1 0"/>
  <inertial pos="0.01 0.02 -0.08" mass="0.5" diaginertia="0.002 0.003 0.001"/>
  <body name="shank" pos="0 0 -0.2"><joint name="knee" axis="0 -1 0"/>
   <inertial pos="-0.01 0.01 -0.12" mass="0.6" diaginertia="0.004 0.003 0.002"/></body></body>
 <body name="rocker" pos="-0.05 0.04 0.02"><joint name="rock" axis="0 -1 0"/>
  <inertial pos="0.01 -0.01 -0.1" mass="0.3" diaginertia="0.001 0.002 0.001"/></body>
</body></worldbody>
<equality><connect name="pin" body1="shank" body2="rocker" anchor="-0.06 0 0.03"/>{hang}</equality>
<actuator><motor joint="thigh"/></actuator></mujoco>
"""
# Two cranks pitch and roll a foot.
_ANKLE = """
 <body name="foot"><joint name="pitch" axis="0 1 0"/><joint name="roll" axis="1 0 0"/>
  <inertial pos="0.03 0.01 -0.04" mass="0.9" diaginertia="0.002 0.004 0.005"/></body>
 <body name="left_crank" pos="-0.05 0.06 0.25"><joint name="left" axis="0 1 0"/>
  <inertial pos="-0.02 0.01 0" mass="0.3" diaginertia="0.0002 0.0004 0.0004"/>
  <body name="left_rod" pos="-0.05 0 0"><joint name="left_a" axis="1 0 0"/>
   <joint name="left_b" axis="0 1 0"/>
   <inertial pos="0 0.01 -0.11" mass="0.2" diaginertia="0.001 0.0012 0.0004"/></body></body>
 <body name="right_crank" pos="-0.05 -0.06 0.2"><joint name="right" axis="0 1 0"/>
  <inertial pos="-0.02 -0.01 0" mass="0.3" diaginertia="0.0002 0.0004 0.0004"/>
  <body name="right_rod" pos="-0.05 0 0"><joint name="right_a" axis="1 0 0"/>
   <joint name="right_b" axis="0 1 0"/>
   <inertial pos="0.01 0 -0.09" mass="0.2" diaginertia="0.001 0.0012 0.0004"/></body></body>
</body></worldbody>
<equality><connect name="left_ball" body1="left_rod" body2="foot" anchor="0 0 -0.25"/>
<connect name="right_ball" body1="right_rod" body2="foot" anchor="0 0 -0.2"/>{hang}</equality>
<actuator><motor joint="left"/><motor joint="right"/></actuator></mujoco>
"""
CHAINS = {"leg": _LEG, "ankle": _ANKLE}
_HANG = '<connect body1="hook" anchor="0 0 0"/>'


# Of torques, N·m: a thousandth of them.
NOISE = 1e-3


def mjcf(name: str, *, floating: bool, hung: bool = False) -> str:
    """Return a chain's description, or that of what MuJoCo runs: with its base hung by the hook."""
    root = '<freejoint name="root"/>' if floating else ""
    text = _START + CHAINS[name]
    return text.format(name=name, root=root, hang=_HANG if floating and hung else "")


def run(name: str, *, floating: bool, seconds: float, seed: int) -> Recording:
    """Return what the motors of a chain record, 1 kHz, and the pose of a base that hangs.

    The motors pull the joints along sines. Bodies are up to 15 % off the description; nothing has
    friction, and torques alone are noisy.
    """
    import mujoco

    model: Any = mujoco.MjModel.from_xml_string(mjcf(name, floating=floating, hung=True))
    data = mujoco.MjData(model)
    change = np.random.default_rng(1).uniform(0.85, 1.15, model.nbody)
    model.body_mass[:] *= change
    model.body_inertia[:] *= change[:, None]
    mujoco.mj_setConst(model, data)
    mujoco.mj_resetData(model, data)
    rng = np.random.default_rng(seed)
    log, states = pulled(model, data, seconds, rng)
    log["effort"] += NOISE * rng.normal(size=log["effort"].shape)
    if floating:
        turned = np.roll(states[:, 3:7], -1, axis=1)
        log["base"] = BaseMotion(position=states[:, :3], orientation=turned)
        log["contacts"] = Contacts(frames=["hook"], down=np.ones((len(states), 1), dtype=bool))
    return Recording(**log)
