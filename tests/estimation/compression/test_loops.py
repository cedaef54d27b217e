"""A loop that closes is a contact of two links: a four-bar linkage beside MuJoCo."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid import RobotModel, Samples
from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.experiment.processing.contacts.contact_samples import ContactSamples

mujoco = pytest.importorskip("mujoco")

# Crank, coupler and rocker: length, mass, center of mass along the link and beside it, inertia.
LINKS = {
    "crank": (0.1, 0.5, 0.04, 0.01, 1e-3),
    "coupler": (0.3, 0.8, 0.16, -0.02, 8e-3),
    "rocker": (0.25, 0.6, 0.12, 0.015, 4e-3),
}
GROUND = 0.28


def description() -> str:
    """Return the URDF, cut where coupler and rocker meet; axes of all joints are -y."""
    parts = ['<robot name="four_bar"><link name="ground"/>']
    parents = {"crank": ("ground", 0.0), "coupler": ("crank", 0.1), "rocker": ("ground", GROUND)}
    for name, (length, mass, x, z, inertia) in LINKS.items():
        parent, at = parents[name]
        parts.append(
            f'<link name="{name}"><inertial><origin xyz="{x} 0 {z}"/><mass value="{mass}"/>'
            f'<inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/>'
            f'</inertial></link><link name="{name}_end"/><joint name="{name}_fixed" type="fixed">'
            f'<parent link="{name}"/><child link="{name}_end"/><origin xyz="{length} 0 0"/></joint>'
            f'<joint name="{name}_joint" type="continuous"><parent link="{parent}"/>'
            f'<child link="{name}"/><origin xyz="{at} 0 0"/><axis xyz="0 -1 0"/></joint>'
        )
    return "".join(parts) + "</robot>"


def plant() -> Any:
    """Return the same as MuJoCo has it, closed."""

    def body(name: str, at: float, inside: str = "") -> str:
        length, mass, x, z, inertia = LINKS[name]
        return (
            f'<body name="{name}" pos="{at} 0 0"><joint name="{name}" axis="0 -1 0"/>'
            f'<inertial pos="{x} 0 {z}" mass="{mass}" diaginertia="{inertia} {inertia} {inertia}"/>'
            f'<site name="{name}_end" pos="{length} 0 0"/>{inside}</body>'
        )

    return mujoco.MjModel.from_xml_string(
        '<mujoco><option timestep="0.001" tolerance="1e-20"><flag contact="disable"/></option>'
        f"<worldbody>{body('crank', 0.0, body('coupler', 0.1))}{body('rocker', GROUND)}</worldbody>"
        '<equality><connect site1="coupler_end" site2="rocker_end" solref="0.005 1"/></equality>'
        "</mujoco>"
    )


def closed() -> Array:
    """Return joint positions where the loop is closed: by the cosine rule."""
    crank = 1.0
    tip = 0.1 * np.array([np.cos(crank), np.sin(crank)])
    way = tip - [GROUND, 0.0]
    size, turn = np.linalg.norm(way), np.arctan2(way[1], way[0])
    rocker = turn - np.arccos((size**2 + 0.25**2 - 0.3**2) / (2.0 * size * 0.25))
    end = [GROUND + 0.25 * np.cos(rocker), 0.25 * np.sin(rocker)]
    return np.array([crank, np.arctan2(*(end - tip)[::-1]) - crank, rocker])


def turning(K: int = 300) -> Samples:
    """Return a run in which a motor drives the crank, and the other joints have none."""
    model = plant()
    data, states = mujoco.MjData(model), np.zeros((4, K, 3))
    data.qpos[:] = closed()
    for k in range(10 * K):
        data.qfrc_applied[0] = 0.6 * np.sin(2e-3 * k) + 0.5 * np.sin(7e-3 * k) - 0.05 * data.qvel[0]
        mujoco.mj_forward(model, data)
        if k % 10 == 0:
            states[:, k // 10] = data.qpos, data.qvel, data.qacc, data.qfrc_applied
        mujoco.mj_step(model, data)
    loop = ContactSamples(
        frames=["coupler_end"], against=["rocker_end"], down=np.ones((K, 1), dtype=bool)
    )
    names = ("position", "velocity", "acceleration", "effort")
    return Samples(**dict(zip(names, states, strict=True)), contacts=loop)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def linkage(tmp_path_factory: pytest.TempPathFactory) -> tuple[RobotModel, Samples]:
    path = Path(tmp_path_factory.mktemp("loop")) / "four_bar.urdf"
    path.write_text(description())
    return sdpid.load_robot(path), turning()


def test_truth_leaves_nothing_where_the_loop_is_told(linkage: tuple[RobotModel, Samples]) -> None:
    robot, samples = linkage
    settings: dict[str, Any] = {"friction": (), "weighting": "gls", "check_excitation": False}
    found = sdpid.build_problem(robot, samples, **settings)
    # The pin bears two forces in the plane; across it no joint can move.
    assert found.n_rows == len(samples.effort)
    base = found.base_of(robot.prior.ravel())
    size = float(np.sum(samples.effort**2))
    assert found.cost(base) < 1e-16 * size
    open_chain = sdpid.build_problem(robot, replace(samples, contacts=None), **settings)
    assert open_chain.cost(base) > 0.1 * size
    np.testing.assert_allclose(found.predict(base), samples.effort, atol=1e-7)


def test_a_linkage_is_identified(linkage: tuple[RobotModel, Samples]) -> None:
    robot, samples = linkage
    rng = np.random.default_rng(0)
    noisy = replace(samples, effort=samples.effort + 1e-3 * rng.normal(size=samples.effort.shape))
    found = sdpid.build_problem(robot, noisy, friction=(), prior=sdpid.Prior())
    estimate = sdpid.solve_sdp(found)
    assert sdpid.certify(estimate).passed
    errors = sdpid.validate(estimate, samples)
    assert errors.floating is None
    assert errors.relative < 1e-2


def test_refuses_a_loop_that_is_open(linkage: tuple[RobotModel, Samples]) -> None:
    robot, samples = linkage
    moved = samples.position + np.array([0.0, 0.0, 0.2])
    with pytest.raises(DataError, match=r"coupler_end and rocker_end are up to .* mm apart"):
        sdpid.build_problem(robot, replace(samples, position=moved), friction=())
    with pytest.raises(DataError, match="expected a frame other than its own"):
        ContactSamples(frames=["a"], against=["a"], down=np.ones((1, 1), dtype=bool))
