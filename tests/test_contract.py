"""The names that scripts outside the repository call, and no others, stand at the top level."""

from __future__ import annotations

import inspect

import pytest

import sdpid

# The flow: robot, log, problem, estimate, proof, files.
CONTRACT = {
    "Constraints",
    "Limits",
    "Processing",
    "Recording",
    "RobotModel",
    "Samples",
    "adapt",
    "audit_base_parameters",
    "audit_urdf",
    "build_problem",
    "certify",
    "check_trajectory",
    "design_excitation",
    "design_standing",
    "compare",
    "confidence_intervals",
    "identify",
    "identify_drive_gains",
    "identify_elasticity",
    "identify_payload",
    "inspect_recording",
    "load",
    "load_robot",
    "paper_excitation",
    "process",
    "read_recording",
    "sample_parameters",
    "simulate",
    "solve_log_cholesky",
    "solve_sdp",
    "solve_slsqp",
    "solve_wls",
    "to_cvxpy",
    "validate",
    "verify",
    "write_mjcf",
    "write_urdf",
}
NAMESPACES = {"constraints", "controllers", "errors", "friction", "plots"}
# What goes with them often enough to stand beside them.
BESIDE = {
    "BaseMotion",
    "Contacts",
    "DhTable",
    "DriveGains",
    "Imu",
    "Transmission",
    "Load",
    "MotorSide",
    "Prior",
    "RecursiveEstimator",
    "Trajectory",
    "check_bias",
    "cost_of_constraints",
    "cross_validate",
    "read_parameters",
    "simulate_closed_loop",
    "simulate_legged",
    "rollout",
    "smallest_mass_eigenvalue",
    "solve_instrumental",
    "solve_output_error",
    "solve_robust",
    "write_parameters",
    "write_plan",
    "write_report",
}


def test_the_top_level_holds_the_contract_and_little_else() -> None:
    assert set(sdpid.__all__) - {"__version__"} == CONTRACT | NAMESPACES | BESIDE


@pytest.mark.parametrize(
    ("name", "first"),
    [
        ("adapt", ["estimate", "log"]),
        ("build_problem", ["robot", "samples"]),
        ("identify", ["robot", "log"]),
        ("identify_drive_gains", ["robot", "without_load", "with_load"]),
        ("identify_payload", ["robot", "with_load", "without_load"]),
        ("inspect_recording", ["log", "robot"]),
        ("process", ["log", "processing"]),
        ("sample_parameters", ["estimate", "n", "seed"]),
        ("simulate", ["robot", "trajectory"]),
        ("validate", ["estimate", "samples"]),
        ("audit_base_parameters", ["robot", "values", "halfwidths"]),
    ],
)
def test_functions_take_what_the_contract_says(name: str, first: list[str]) -> None:
    assert list(inspect.signature(getattr(sdpid, name)).parameters)[: len(first)] == first
