"""Rows of samples in contact beside MuJoCo: its own contact forces, and forces that it applies."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sdpid
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.whitening import weights_of
from sdpid.experiment.plant.legged.model import build_legged
from sdpid.experiment.processing.contacts.contact_samples import ContactSamples, Kind
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.legs.find import find_legs
from sdpid.robot.model.base_parameters import structural_base
from sdpid.robot.model.contacts.jacobians import frame_axes
from tests.helpers.legged import FEET, RADIUS, quadruped

mujoco = pytest.importorskip("mujoco")

STUDIES = str(Path(__file__).parents[3] / "examples" / "studies")

# What true parameters may leave of the rows; rounding leaves 1e-12.
EXACT = 1e-8


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(STUDIES)
    yield __import__("legged_rows")
    sys.modules.pop("legged_rows")


def test_the_simulators_contact_forces_leave_nothing(study: Any) -> None:
    made = study.Beside("solo12", "trot", 0.3, turning=False)
    assert 0.3 < made.down.mean() < 0.9
    assert made.left("plane", known=True) < EXACT
    assert made.left("plane") < EXACT
    assert made.left("point", offset="touched") < EXACT
    # Balls sink in by tenths of a millimeter, so that their lowest point is not what is pushed.
    assert EXACT < made.left("point", offset=(0.0, 0.0, -made.legs.radius)) < 2e-3


def test_feet_that_resist_turning_are_planes(study: Any) -> None:
    made = study.Beside("solo12", "trot", 0.3, turning=True)
    assert made.left("plane", known=True) < EXACT
    assert made.left("plane") < EXACT
    assert made.left("point", offset="touched") > 1e-3


@pytest.mark.parametrize(
    ("kind", "moments"), [("point", []), ("line", [0, 2]), ("plane", [0, 1, 2])]
)
def test_what_a_kind_transmits_leaves_nothing_and_more_does(kind: Kind, moments: list[int]) -> None:
    """Two feet of MuJoCo's robot in the air, which are pushed and twisted."""
    robot, rng, K = quadruped(), np.random.default_rng(0), 8
    legs = find_legs(robot)
    theta = np.concatenate([robot.prior.ravel(), np.zeros(36)])
    built = build_legged(legs, theta, held=False, timestep=1e-3, start=np.zeros(6))
    data, q, v, a = (
        mujoco.MjData(built.model),
        np.zeros((K, 19)),
        np.zeros((K, 18)),
        np.zeros((K, 18)),
    )
    for k in range(K):
        turn = Rotation.random(random_state=k)
        q[k, 2], q[k, 3:7], q[k, 7:] = 1.0, turn.as_quat(), rng.normal(size=12)
        v[k] = rng.normal(size=18)
        data.qpos[:3], data.qpos[3:7], data.qpos[built.qpos] = (
            q[k, :3],
            np.roll(q[k, 3:7], 1),
            q[k, 7:],
        )
        data.qvel[:3], data.qvel[3:6], data.qvel[built.dof] = (
            turn.apply(v[k, :3]),
            v[k, 3:6],
            v[k, 6:],
        )
        data.qfrc_applied[:] = 0.0
        mujoco.mj_forward(built.model, data)
        axes = frame_axes(robot, q[k : k + 1], FEET)[0]
        for foot in range(2):
            geom = built.feet[foot]
            twist = axes[foot][:, moments] @ rng.normal(size=len(moments))
            mujoco.mj_applyFT(
                built.model, data, 10.0 * rng.normal(size=3), twist,
                data.geom_xpos[geom] + RADIUS, built.model.geom_bodyid[geom], data.qfrc_applied,
            )  # fmt: skip
        mujoco.mj_forward(built.model, data)
        a[k, :3] = turn.inv().apply(data.qacc[:3]) - np.cross(v[k, 3:6], v[k, :3])
        a[k, 3:6], a[k, 6:] = data.qacc[3:6], data.qacc[built.dof]
    friction = FrictionModel.from_terms((), robot.joint_names, first=6)
    base = structural_base(robot, friction)
    for said in get_args(Kind):
        contacts = ContactSamples(
            frames=FEET[:2], kind=said, offset=RADIUS, down=np.ones((K, 2), dtype=bool)
        )
        states = {"position": q, "velocity": v, "acceleration": a, "effort": np.zeros((K, 18))}
        samples = sdpid.Samples(**states, contacts=contacts)
        rows = RowSource(robot, friction, base, samples)
        T, index = weights_of(rows, slice(None), np.eye(18))
        needed = rows.regressor(slice(None)) @ (base.matrix @ theta[:130])
        left, size = (
            np.linalg.norm(T[index] @ each[..., None]) for each in (needed, np.ones((K, 18)))
        )
        carries = {"point": 0, "line": 2, "plane": 3}[said]
        assert (left < EXACT * size) == (carries >= len(moments))
