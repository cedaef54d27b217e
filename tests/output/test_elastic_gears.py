"""MJCF files with springs between motors and links."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np

import sdpid
from sdpid.errors import ExportError
from sdpid.output.robots.export_report import ExportReport
from tests.helpers.elastic import arm, found, log, rigid
from tests.helpers.refusals import refuses

# Until an arm that motors hold is at rest, s, and how these hold it.
REST_S, HOLD, BRAKE = 3.0, 5e4, 5e2


def written(tmp_path: Path, **options: object) -> tuple[str, ExportReport]:
    path = tmp_path / "arm.xml"
    report = sdpid.write_mjcf(rigid().estimate, target=path, elasticity=found(1), **options)  # type: ignore[arg-type]
    return path.read_text(encoding="utf-8"), report


def test_at_rest_gears_give_way_by_torque_over_stiffness(tmp_path: Path):
    text, report = written(tmp_path)
    assert "elastic gears of joint_1, joint_2:" in report.describe()
    # Springs ring, as the file says, so that they are damped here.
    model = mujoco.MjModel.from_xml_string(text)
    gears = [model.joint(f"{name}_gear") for name in arm().joint_names[:2]]
    motors = [model.joint(name) for name in arm().joint_names]
    for gear, stiffness in zip(gears, found(1).stiffness, strict=False):
        assert gear.stiffness[0] == stiffness
        model.dof_damping[gear.dofadr[0]] = 20.0
        assert gear.armature[0] == 0.0
    theta = rigid().estimate.named_theta()
    assert theta is not None
    armature = [model.dof_armature[each.dofadr[0]] for each in motors]
    np.testing.assert_allclose(armature, [theta[f"Ia{j + 1}"] for j in range(3)])
    model.opt.timestep = 5e-4
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    data = mujoco.MjData(model)
    held = np.array([0.3, -0.7, 0.9])
    places = [each.qposadr[0] for each in motors]
    speeds = [each.dofadr[0] for each in motors]
    data.qpos[places] = held
    model.dof_damping[speeds] += BRAKE
    # Beside the weight, of which the first joint carries none.
    extra = np.array([5.0, -3.0])
    data.qfrc_applied[[each.dofadr[0] for each in gears]] = extra
    for _ in range(round(REST_S / model.opt.timestep)):
        data.qfrc_applied[speeds] = HOLD * (held - data.qpos[places])
        mujoco.mj_step(model, data)
    deflection = np.array([data.qpos[each.qposadr[0]] for each in gears])
    link = data.qpos[places].copy()
    link[:2] += deflection
    bodies = rigid().estimate.problem.feasible.bodies(rigid().estimate.theta)
    load = arm().inverse_dynamics(bodies, link[None], np.zeros((1, 3)), np.zeros((1, 3)))[0]
    torque = load[:2] - extra
    assert np.abs(torque).min() > 4.0
    np.testing.assert_allclose(-deflection, torque / found(1).stiffness[:2], rtol=1e-3)


def test_a_stiff_spring_makes_the_rigid_robot(tmp_path: Path):
    """Motors and links together need the efforts of the rigid file."""
    text, _ = written(tmp_path)
    path = tmp_path / "rigid.xml"
    sdpid.write_mjcf(rigid().estimate, target=path)
    elastic, stiff = mujoco.MjModel.from_xml_string(text), mujoco.MjModel.from_xml_path(str(path))
    rng = np.random.default_rng(0)
    for _ in range(5):
        state = rng.uniform(-1.0, 1.0, (3, 3))
        efforts = []
        for model in (elastic, stiff):
            model.dof_frictionloss[:] = 0.0
            data = mujoco.MjData(model)
            for name, values in zip(arm().joint_names, state, strict=True):
                joint = model.joint(name)
                data.qpos[joint.qposadr[0]] = values[0]
                data.qvel[joint.dofadr[0]], data.qacc[joint.dofadr[0]] = values[1:]
            mujoco.mj_inverse(model, data)
            efforts.append([data.qfrc_inverse[model.joint(n).dofadr[0]] for n in arm().joint_names])
        np.testing.assert_allclose(efforts[0], efforts[1], rtol=1e-7, atol=1e-7)


USERS = (
    '<default><joint armature="3" damping="4" stiffness="5" limited="true" range="-9 9"/></default>'
)


def test_defaults_of_a_source_do_not_reach_the_springs(tmp_path: Path):
    path = tmp_path / "mine.xml"
    sdpid.write_mjcf(rigid().estimate, target=path)
    text = path.read_text(encoding="utf-8")
    text = text.replace("<worldbody>", f"{USERS}<worldbody>", 1)
    text = text.replace("</mujoco>", '<keyframe><key qpos="0 0 0"/></keyframe></mujoco>')
    text = text.replace("<inertial ", '<geom size="0.05" mass="0"/><inertial ')
    found_text, report = written(tmp_path, source=text)
    assert "keyframes left out" in report.describe()
    model = mujoco.MjModel.from_xml_string(found_text)
    for name, stiffness in zip(arm().joint_names[:2], found(1).stiffness, strict=False):
        gear = model.joint(f"{name}_gear")
        assert gear.stiffness[0] == stiffness
        assert (gear.armature[0], gear.damping[0], gear.limited[0]) == (0.0, 0.0, 0)
    # A link and the one that carries it do not touch.
    assert model.nexclude == 1


def test_what_is_said_and_refused(tmp_path: Path):
    none = replace(found(1), stiffness=np.full(3, np.nan))
    report = sdpid.write_mjcf(rigid().estimate, target=tmp_path / "a.xml", elasticity=none)
    assert "no joint of it is elastic" in report.describe()
    stated = sdpid.identify_elasticity(rigid(), log(1), rotor_inertia=2.0)
    report = sdpid.write_mjcf(rigid().estimate, target=tmp_path / "b.xml", elasticity=stated)
    assert "not 2 as stated" in report.describe()
    assert "constraints.Fixed({'Ia1': 2})" in report.describe()
    other: Any = SimpleNamespace(joint_names=("other",), stiffness=np.ones(1))
    refuses(
        ExportError,
        "the elasticity is that of another robot",
        lambda: sdpid.write_mjcf(rigid().estimate, target=tmp_path / "c.xml", elasticity=other),
    )
