"""Linkages in MuJoCo: a crank that drives a rocker, and two arms that carry a point."""

from typing import Any

import numpy as np

from sdpid import Recording
from sdpid._common.arrays import Array

# Crank, coupler and rocker: parent, place on it, length, mass, center of mass along and beside the
# link, moment of inertia about it.
_FOUR = {
    "crank": ("ground", 0.0, 0.1, 0.5, 0.04, 0.01, 1e-3),
    "coupler": ("crank", 0.1, 0.3, 0.8, 0.16, -0.02, 8e-3),
    "rocker": ("ground", 0.28, 0.25, 0.6, 0.12, 0.015, 4e-3),
}
_FIVE = {
    "left_arm": ("ground", -0.06, 0.16, 0.4, 0.07, 0.01, 1.2e-3),
    "left_rod": ("left_arm", 0.16, 0.22, 0.25, 0.1, 0.0, 1.1e-3),
    "right_arm": ("ground", 0.06, 0.16, 0.4, 0.08, -0.01, 1.3e-3),
    "right_rod": ("right_arm", 0.16, 0.22, 0.3, 0.12, 0.01, 1.2e-3),
}
# Where the four-bar closes with its crank at zero, and the five-bar about so.
_STARTS = {"four_bar": (0.0, 1.9, 2.3), "five_bar": (2.0, -1.0, 1.14, 1.0)}
LINKAGES = {"four_bar": (_FOUR, ("crank",)), "five_bar": (_FIVE, ("left_arm", "right_arm"))}


def ends_of(name: str) -> tuple[str, str]:
    """Return the two links whose ends meet."""
    return ("coupler", "rocker") if name == "four_bar" else ("left_rod", "right_rod")


def urdf(name: str, *, kind: str = "spherical") -> str:
    """Return the description of a linkage, cut where two links meet; axes are -y."""
    links, driven = LINKAGES[name]
    parts = [f'<robot name="{name}"><link name="ground"/>']
    for link, (parent, at, _, mass, x, z, inertia) in links.items():
        parts.append(
            f'<link name="{link}"><inertial><origin xyz="{x} 0 {z}"/><mass value="{mass}"/>'
            f'<inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/>'
            f'</inertial></link><joint name="{link}_joint" type="continuous">'
            f'<parent link="{parent}"/><child link="{link}"/><origin xyz="{at} 0 0"/>'
            '<axis xyz="0 -1 0"/></joint>'
        )
    one, two = (f'link="{link}" xyz="{links[link][2]} 0 0"' for link in ends_of(name))
    parts.append(
        f'<loop_joint name="pin" type="{kind}"><link1 {one}/><link2 {two}/>'
        '<axis xyz="0 -1 0"/></loop_joint>'
    )
    for link, start in zip(links, _STARTS[name], strict=True):
        if link not in driven:
            parts.append(f'<passive_joint name="{link}_joint" position="{start}"/>')
    return "".join(parts) + "</robot>"


def mjcf(name: str, scale: Array | None = None) -> str:
    """Return the same as MuJoCo has it, every link's mass, and inertia, scaled."""
    links, driven = LINKAGES[name]
    scale = np.ones(len(links)) if scale is None else scale
    children: dict[str, list[str]] = {}
    for link, (parent, *_) in links.items():
        children.setdefault(parent, []).append(link)

    def body(link: str) -> str:
        _, at, length, mass, x, z, inertia = links[link]
        own = scale[list(links).index(link)]
        inside = "".join(body(child) for child in children.get(link, ()))
        return (
            f'<body name="{link}" pos="{at} 0 0"><joint name="{link}_joint" axis="0 -1 0"/>'
            f'<inertial pos="{x} 0 {z}" mass="{own * mass}" '
            f'diaginertia="{own * inertia} {own * inertia} {own * inertia}"/>'
            f'<site name="{link}_end" pos="{length} 0 0"/>{inside}</body>'
        )

    one, two = ends_of(name)
    motors = "".join(f'<motor joint="{link}_joint"/>' for link in driven)
    return (
        f'<mujoco model="{name}"><option timestep="0.0005" tolerance="1e-20">'
        '<flag contact="disable"/></option>'
        f"<worldbody>{''.join(body(link) for link in children['ground'])}</worldbody>"
        f'<equality><connect name="pin" site1="{one}_end" site2="{two}_end" solref="0.001 1" '
        f'solimp="0.9999 0.9999 0.001"/></equality><actuator>{motors}</actuator></mujoco>'
    )


def pulled(
    model: Any, data: Any, seconds: float, rng: np.random.Generator
) -> tuple[dict[str, Any], Array]:
    """Return what motors that pull their joints along sines record, 1 kHz, and all positions."""
    import mujoco

    joints = model.actuator_trnid[:, 0]
    at, dof = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    middle, count = data.qpos[at].copy(), int(1000 * seconds)
    rates = np.array([3.0, 7.0, 11.0])[:, None] * rng.uniform(0.8, 1.2, (3, len(at)))
    size = np.array([0.25, 0.12, 0.05])[:, None] * rng.uniform(0.8, 1.2, (3, len(at)))
    position, effort = np.zeros((count, model.nq)), np.zeros((count, len(at)))
    for k in range(2 * count):
        t = 5e-4 * k
        rise = 1.0 - np.exp(-2.0 * t) * (1.0 + 2.0 * t)
        wanted = middle + rise * np.sum(size * np.sin(rates * t), axis=0)
        data.ctrl[:] = 40.0 * (wanted - data.qpos[at]) - 2.0 * data.qvel[dof]
        mujoco.mj_forward(model, data)
        if k % 2 == 0:
            position[k // 2], effort[k // 2] = data.qpos, data.ctrl
        mujoco.mj_step(model, data)
    names = [model.joint(int(joint)).name for joint in joints]
    log = {"time": 1e-3 * np.arange(count), "position": position[:, at], "joint_names": names}
    return {**log, "effort": effort}, position


def run(
    name: str, *, seconds: float, seed: int, scale: Array | None = None, start: Array
) -> tuple[Recording, Array]:
    """Return what the motors of a linkage in MuJoCo record, 1 kHz, and positions of all joints.

    The motors pull the joints along sines; nothing has friction, and nothing is noisy.

    Parameters
    ----------
    start : ndarray, shape (joints,)
        Joint positions in which the loop is closed.
    """
    import mujoco

    model: Any = mujoco.MjModel.from_xml_string(mjcf(name, scale))
    data = mujoco.MjData(model)
    data.qpos[:] = start
    log, position = pulled(model, data, seconds, np.random.default_rng(seed))
    return Recording(**log), position
