from . import constraints, controllers, errors, friction, plots
from .assurance.certificate.certificate import certify
from .assurance.descriptions.audit import audit_urdf
from .assurance.diagnostics.active_constraints import cost_of_constraints
from .assurance.diagnostics.mass_matrix import smallest_mass_eigenvalue
from .assurance.diagnostics.validation import validate
from .assurance.drive_gains.identify import identify_drive_gains
from .assurance.drive_gains.load import Load
from .assurance.intervals.intervals import confidence_intervals
from .assurance.payload.identify import identify_payload
from .assurance.rollouts.rollout import rollout
from .assurance.tables.audit import audit_base_parameters
from .estimation.closed_loop.bias import check_bias
from .estimation.closed_loop.solve import solve_instrumental, solve_output_error
from .estimation.constraints.constraints import Constraints
from .estimation.elasticity.identify import identify_elasticity
from .estimation.local.log_cholesky import solve_log_cholesky
from .estimation.local.slsqp import solve_slsqp
from .estimation.prior.prior import Prior
from .estimation.problem import build_problem
from .estimation.recursive import RecursiveEstimator
from .estimation.robust.solve import solve_robust
from .estimation.sdp.cvxpy_form import to_cvxpy
from .estimation.sdp.solve import solve_sdp
from .estimation.wls import solve_wls
from .excitation.design.design import design_excitation
from .excitation.limits.check import check_trajectory
from .excitation.limits.limits import Limits
from .excitation.standing.design import design_standing
from .experiment.drive_gains.gains import DriveGains
from .experiment.inspection.inspect import inspect_recording
from .experiment.plant.legged.simulate import simulate_legged
from .experiment.plant.simulate import simulate
from .experiment.processing.process import process
from .experiment.processing.samples import Samples
from .experiment.processing.settings import Processing
from .experiment.readers.read import read_recording
from .experiment.recording.floating import BaseMotion, Contacts, Imu
from .experiment.recording.motor_side import MotorSide
from .experiment.recording.recording import Recording
from .experiment.simulation.closed_loop import simulate_closed_loop
from .experiment.trajectory.drawn import paper_excitation
from .experiment.trajectory.trajectory import Trajectory
from .output.plans.write import write_plan
from .output.report.report import write_report
from .output.robots.mjcf import write_mjcf
from .output.robots.urdf import write_urdf
from .output.tables.parameters_file import read_parameters, write_parameters
from .robot.description.dh_table import DhTable
from .robot.model.load import load_robot
from .robot.model.model import RobotModel
from .robot.model.transmission import Transmission
from .workflow.comparison import compare
from .workflow.formulate import adapt, cross_validate
from .workflow.identify import identify
from .workflow.runs import load
from .workflow.sample import sample_parameters
from .workflow.verify import verify

__version__: str

__all__ = [
    "BaseMotion",
    "Constraints",
    "Contacts",
    "DhTable",
    "DriveGains",
    "Imu",
    "Limits",
    "Load",
    "MotorSide",
    "Prior",
    "Processing",
    "Recording",
    "RecursiveEstimator",
    "RobotModel",
    "Samples",
    "Trajectory",
    "Transmission",
    "__version__",
    "adapt",
    "audit_base_parameters",
    "audit_urdf",
    "build_problem",
    "certify",
    "check_bias",
    "check_trajectory",
    "compare",
    "confidence_intervals",
    "constraints",
    "controllers",
    "cost_of_constraints",
    "cross_validate",
    "design_excitation",
    "design_standing",
    "errors",
    "friction",
    "identify",
    "identify_drive_gains",
    "identify_elasticity",
    "identify_payload",
    "inspect_recording",
    "load",
    "load_robot",
    "paper_excitation",
    "plots",
    "process",
    "read_parameters",
    "read_recording",
    "rollout",
    "sample_parameters",
    "simulate",
    "simulate_closed_loop",
    "simulate_legged",
    "smallest_mass_eigenvalue",
    "solve_instrumental",
    "solve_log_cholesky",
    "solve_output_error",
    "solve_robust",
    "solve_sdp",
    "solve_slsqp",
    "solve_wls",
    "to_cvxpy",
    "validate",
    "verify",
    "write_mjcf",
    "write_parameters",
    "write_plan",
    "write_report",
    "write_urdf",
]
