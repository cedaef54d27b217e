"""A drive that turns two joints is a tendon in MuJoCo, with the same efforts as the model's."""

from pathlib import Path

import numpy as np
import pytest

import sdpid
from sdpid._common.arrays import Array
from sdpid.estimation.estimate import Estimate
from sdpid.friction import Coulomb, Coupling, Offset, RotorInertia, SigmoidFriction, Viscous
from sdpid.output.robots.joint_friction import joint_attributes
from sdpid.output.robots.mjcf import PLACES, write_mjcf
from sdpid.output.robots.tendons import added
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.model.base_parameters import generic_states
from sdpid.robot.model.dynamics import RobotDynamics
from tests.helpers.data import friction_model, random_links
from tests.helpers.robots import TREE
from tests.helpers.verified import differences
from tests.output.test_urdf import CLOSE, efforts_of, problem_of

mujoco = pytest.importorskip("mujoco")

ROBOT = sdpid.load_robot(TREE)
TERMS: tuple[FrictionTerm, ...] = (Coulomb(), Viscous(), RotorInertia())
DRIVE = Coupling("right", "finger")
LINKS = random_links(np.random.default_rng(0), ROBOT.n_links)


def estimate_of(drive: tuple[float, float, float], *more: FrictionTerm) -> Estimate:
    """Return an estimate with a drive, and 0.5 of every other parameter."""
    terms = (*TERMS, DRIVE, *more)
    problem = problem_of(ROBOT, friction=terms, check_excitation=False)
    others = np.full(sum(ROBOT.n for _ in TERMS), 0.5), np.full(ROBOT.n * len(more), 0.5)
    theta = np.concatenate([LINKS.ravel(), others[0], drive, others[1]])
    return Estimate.of_theta(problem, theta, method="sdp", status="optimal")


def mujocos(path: Path, states: tuple[Array, ...]) -> Array:
    """Return MuJoCo's own efforts, with dry friction, without limits."""
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    # Dry friction saturates at speeds of all joints above 0.1 rad/s.
    model.dof_solimp[:, :2] = model.tendon_solimp_fri[:, :2] = 0.9999
    model.dof_solref[:, 0] = model.tendon_solref_fri[:, 0] = 0.004
    return efforts_of(model, ROBOT, states)


# One tendon; two, as inertia and damping differ in sign; and one over the difference of the joints.
@pytest.mark.parametrize("drive", [(0.4, 0.2, 0.3), (0.3, -0.2, 0.1), (-0.3, -0.2, 0.0)])
def test_mujoco_has_the_efforts_of_the_model(
    drive: tuple[float, float, float], tmp_path: Path
) -> None:
    estimate = estimate_of(drive)
    report = write_mjcf(estimate, target=tmp_path / "out.xml")
    assert report.left_out == ()
    text = (tmp_path / "out.xml").read_text(encoding="utf-8")
    assert text.count("<fixed") == (2 if drive[1] * drive[0] < 0.0 else 1)
    q, v, a = generic_states(ROBOT, 40, 6)
    fast = np.abs(np.column_stack([v, v[:, 3] + v[:, 4], v[:, 3] - v[:, 4]])).min(axis=1) > 0.1
    states = q[fast], v[fast], a[fast]
    assert fast.sum() > 5
    expected = estimate.model().inverse_dynamics(*states)
    found = mujocos(tmp_path / "out.xml", states)
    assert np.abs(found - expected).max() <= CLOSE * np.abs(expected).max()
    assert report.training.file == pytest.approx(report.training.estimate, abs=1e-9)
    assert differences(estimate, tmp_path / "out.xml") == []


def test_joints_and_tendons_together_are_what_joints_alone_would_be(tmp_path: Path) -> None:
    """Beside curves, which are fitted anew: a drive takes no share of what the joints get."""
    drive, curve = np.array([0.4, -0.3, 0.2]), SigmoidFriction(velocity=0.5)
    q, v, a = generic_states(ROBOT, 200, 7)
    own = np.concatenate([LINKS.ravel(), np.full(4 * ROBOT.n, 0.5)])
    found = []
    for terms, theta in (
        ((*TERMS, curve), own),
        ((*TERMS, curve, DRIVE), np.concatenate([own, drive])),
    ):
        model = RobotDynamics(robot=ROBOT, terms=friction_model(ROBOT, terms), theta=theta)
        samples = sdpid.Samples(
            position=q,
            velocity=v,
            acceleration=a,
            effort=model.inverse_dynamics(q, v, a),
        )
        problem = sdpid.build_problem(ROBOT, samples, friction=terms, check_excitation=False)
        found.append(joint_attributes(problem, theta, PLACES, "file", tendons=True))
    plain, coupled = found
    assert coupled.left_out == ()
    assert "within" in coupled.notes[0]
    assert coupled.notes == plain.notes
    armature, damping = added(coupled.tendons, ROBOT.joint_names)
    assert damping.max() == 0.3
    for j, name in enumerate(ROBOT.joint_names):
        both = dict(coupled.values[name])
        both["armature"] += armature[j]
        both["damping"] += damping[j]
        assert both == pytest.approx(plain.values[name], abs=1e-9)


@pytest.mark.parametrize("drive", [(0.6, 0.1, 0.1), (-0.6, 0.1, 0.1)])
def test_a_drive_with_more_inertia_than_its_joints_is_left_out(
    drive: tuple[float, float, float], tmp_path: Path
) -> None:
    report = write_mjcf(estimate_of(drive, Offset()), target=tmp_path / "out.xml")
    assert [lost.term for lost in report.left_out] == ["Coupling", "Offset"]
    assert "<tendon" not in (tmp_path / "out.xml").read_text(encoding="utf-8")


def test_a_file_of_yours_gets_no_tendon(tmp_path: Path) -> None:
    estimate = estimate_of((0.4, 0.2, 0.3))
    write_mjcf(estimate, target=tmp_path / "mine.xml")
    text = (tmp_path / "mine.xml").read_text(encoding="utf-8")
    start, end = text.index("  <tendon>"), text.index("</tendon>") + len("</tendon>\n")
    (tmp_path / "mine.xml").write_text(text[:start] + text[end:], encoding="utf-8")
    report = write_mjcf(estimate, source=tmp_path / "mine.xml", target=tmp_path / "out.xml")
    assert [lost.term for lost in report.left_out] == ["Coupling"]
    assert "<tendon" not in (tmp_path / "out.xml").read_text(encoding="utf-8")
