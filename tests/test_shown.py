"""What the public names return shows itself in a line, and in a notebook as safe HTML."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import html5lib
import numpy as np
import pytest

import sdpid
from sdpid.constraints import TotalMass
from sdpid.estimation.duality.bound import Multipliers
from sdpid.experiment.trajectory.trajectory import Trajectory
from sdpid.workflow.runs import SavedRun
from tests.helpers.arm_files import ARM_URDF
from tests.helpers.motions import fourier_motion
from tests.helpers.plans import small_plan, standing_plan
from tests.helpers.runs import recorded
from tests.test_contract import BESIDE, CONTRACT

# Characters of a line that is still read.
LINE = 200

HOSTILE = "<img src=x onerror=alert(1)>"
NAMES = {
    'robot name="arm"': 'robot name="NAME"', '"upper"': '"NAME upper"', '"a"': '"NAME a"',
}  # fmt: skip

# Names that return a file, values by name, or programs of another library.
PLAIN = {"read_parameters", "to_cvxpy", "write_parameters", "write_plan", "write_report"}


@cache
def robot() -> sdpid.RobotModel:
    text = ARM_URDF
    for old, new in NAMES.items():
        text = text.replace(old, new.replace("NAME", HOSTILE.replace("<", "&lt;")))
    return sdpid.load_robot(text)


def log() -> sdpid.Recording:
    return recorded(1, joint_names=robot().joint_names)


def currents() -> sdpid.Recording:
    return replace(log(), effort=log().effort / 10.0, currents=True)


@cache
def result() -> Any:
    return sdpid.identify(robot(), log(), effects="none")


def base() -> sdpid.BaseMotion:
    still = np.zeros((4, 3))
    return sdpid.BaseMotion(
        orientation=np.tile([0.0, 0.0, 0.0, 1.0], (4, 1)),
        position=still,
        linear_velocity=still,
        angular_velocity=still,
        velocity_frame="base",
        imu=sdpid.Imu(gyroscope=still, accelerometer=still),
    )


def estimate() -> Any:
    return result().estimate


def problem() -> Any:
    return result().problem


def motion() -> Trajectory:
    return fourier_motion(robot().joint_names)


SHOWN: dict[str, Callable[[], Any]] = {
    "BaseMotion": base,
    "Constraints": lambda: sdpid.Constraints(others=TotalMass(1.0, links=(HOSTILE,))),
    "Contacts": lambda: sdpid.Contacts(
        frames=[f"{HOSTILE}{k}" for k in range(9)], down=np.ones((4, 9))
    ),
    "DhTable": lambda: sdpid.DhTable.of([{"name": f"{HOSTILE}{k}"} for k in range(7)]),
    "DriveGains": lambda: sdpid.DriveGains(
        joint_names=[f"{HOSTILE}{k}" for k in range(40)], gains=np.full(40, 1e4 / 3.0)
    ),
    "Imu": lambda: base().imu,
    "Limits": lambda: sdpid.Limits(velocity={f"{HOSTILE}{k}": 1.0 for k in range(99)}),
    "MotorSide": lambda: sdpid.MotorSide.from_gears(np.full(40, 100.0)),
    "Transmission": lambda: sdpid.Transmission(
        [[0.5, 0.5], [0.5, -0.5]], names=("a", HOSTILE), joints=(HOSTILE, "b")
    ),
    "Prior": lambda: sdpid.Prior(bodies=np.ones((40, 10))),
    "Processing": lambda: sdpid.Processing.paper(),
    "Recording": log,
    "RecursiveEstimator": lambda: sdpid.RecursiveEstimator(problem()),
    "RobotModel": robot,
    "Samples": lambda: problem().samples,
    "Trajectory": motion,
    "adapt": lambda: sdpid.adapt(estimate(), log()),
    "audit_base_parameters": lambda: sdpid.audit_base_parameters(robot(), {"Fv1": 1.0}, 0.1),
    "audit_urdf": lambda: sdpid.audit_urdf(ARM_URDF.replace('"upper"', '"&lt;i>upper"')),
    "build_problem": problem,
    "check_bias": lambda: sdpid.check_bias(problem(), instruments=problem().samples),
    "certify": lambda: result().certificate,
    "check_trajectory": lambda: sdpid.check_trajectory(robot(), motion()),
    "compare": lambda: sdpid.compare(problem(), starts=1, local=("slsqp",), max_iterations=2),
    "confidence_intervals": lambda: result().intervals,
    "cost_of_constraints": lambda: sdpid.cost_of_constraints(estimate()),
    "cross_validate": lambda: sdpid.cross_validate(robot(), log(), folds=2, effects="none"),
    "design_excitation": small_plan,
    "design_standing": standing_plan,
    "identify": result,
    "Load": lambda: sdpid.Load(mass=2.0, com=[0.0, 0.0, 0.1]),
    "identify_drive_gains": lambda: sdpid.identify_drive_gains(
        robot(), currents(), known={robot().joint_names[0]: 10.0}, effects="none"
    ),
    "load": lambda: SavedRun.of(result()),
    "identify_elasticity": lambda: sdpid.identify_elasticity(
        result(), replace(log(), link_position=log().position - 1e-4 * log().effort)
    ),
    "identify_payload": lambda: sdpid.identify_payload(robot(), *[problem().samples] * 2),
    "inspect_recording": lambda: sdpid.inspect_recording(log(), robot()),
    "load_robot": robot,
    "paper_excitation": lambda: sdpid.paper_excitation("denso_vp6242", 5, periods=2, period=20.0),
    "process": lambda: problem().samples,
    "read_recording": log,
    "rollout": lambda: sdpid.rollout(estimate(), log(), (0.1,), start_every=4.0),
    "sample_parameters": lambda: sdpid.sample_parameters(estimate(), 4, 0),
    "simulate": log,
    "simulate_closed_loop": lambda: sdpid.simulate_closed_loop(
        estimate().model(), motion(), sdpid.controllers.PD(*np.full((2, 2), 30.0))
    ),
    "simulate_legged": lambda: sdpid.simulate_legged(
        sdpid.load_robot("solo12", root="free_flyer"), duration=0.05
    ),
    "smallest_mass_eigenvalue": lambda: sdpid.smallest_mass_eigenvalue(estimate()),
    "solve_instrumental": lambda: sdpid.solve_instrumental(
        problem(), instruments=problem().samples
    ),
    "solve_log_cholesky": lambda: sdpid.solve_log_cholesky(problem(), max_iterations=2),
    "solve_output_error": lambda: sdpid.solve_output_error(
        problem(), log(), controller=sdpid.controllers.PD(*np.full((2, 2), 900.0)),
        reference=np.array(log().position), max_iterations=1,
    ),
    "solve_robust": lambda: sdpid.solve_robust(problem()),
    "solve_sdp": estimate,
    "solve_slsqp": lambda: sdpid.solve_slsqp(problem(), max_iterations=2),
    "solve_wls": lambda: result().wls,
    "validate": lambda: result().training,
}  # fmt: skip


def require_a_line(shown: Any) -> None:
    line = repr(shown)
    assert line.startswith(type(shown).__name__ + "(")
    assert "\n" not in line
    assert len(line) < LINE


def require_safe(shown: Any) -> None:
    """Check a line, and that a browser reads the HTML without anything that acts."""
    require_a_line(shown)
    tree = html5lib.parseFragment(shown._repr_html_(), namespaceHTMLElements=False)
    tags = {element.tag for element in tree.iter()} - {"DOCUMENT_FRAGMENT"}
    assert tags <= {"b", "table", "tbody", "tr", "td", "th"}
    assert tags >= {"b", "table", "td"}
    assert {name for element in tree.iter() for name in element.attrib} <= {"style"}


def test_every_public_name_is_looked_at() -> None:
    assert set(SHOWN) | PLAIN | {"verify", "write_mjcf", "write_urdf"} == CONTRACT | BESIDE


@pytest.mark.parametrize("name", SHOWN)
def test_results_show_themselves(name: str) -> None:
    shown = SHOWN[name]()
    require_safe(shown)
    if hasattr(shown, "to_dict"):
        json.dumps(shown.to_dict(), allow_nan=False)


def test_parts_are_shown_in_a_line() -> None:
    multipliers = Multipliers.of_cost(problem(), problem().rhs)
    for part in (problem().feasible, problem().excitation, multipliers, motion()):
        require_a_line(part)


def test_names_are_shown_as_text() -> None:
    for shown in (robot(), result()):
        assert "&lt;img src=x" in shown._repr_html_()


def test_files_and_their_proofs_show_themselves(tmp_path: Any) -> None:
    require_safe(sdpid.write_urdf(estimate(), target=tmp_path / "robot.urdf"))
    result().certificate.to_json(tmp_path / "certificate.json")
    require_safe(sdpid.verify(tmp_path / "certificate.json"))


def test_settings_show_what_is_not_the_default() -> None:
    for settings, shown in (
        (sdpid.Constraints(), "Constraints()"),
        (sdpid.Constraints(margin=0.1), "Constraints(margin=0.1)"),
        (sdpid.Prior(bodies=np.ones((2, 10))), "Prior(bodies=array (2, 10))"),
        (sdpid.Limits(jerk=5.0, share=0.5), "Limits(jerk=5.0, share=0.5)"),
    ):
        assert repr(settings) == shown
    assert "the defaults" in sdpid.Processing()._repr_html_()
