from .assurance.audit_base import BaseAudit, audit_base_parameters
from .assurance.audit_urdf import UrdfAudit, audit_urdf
from .assurance.certificate import Certificate, certify, verify
from .assurance.intervals import Intervals, intervals
from .assurance.payload import Payload, identify_payload
from .assurance.price import cost_of_constraints
from .assurance.validation import Validation, validate
from .assurance.verdict import verdict
from .assurance.worst_mass_matrix import worst_mass_matrix
from .errors import (
    CertificateError,
    DataError,
    ExportError,
    IdentifiabilityError,
    InfeasibleError,
    MissingExtraError,
    ModelError,
    SdpidError,
    SolverError,
)
from .estimation.activity import ConstraintState
from .estimation.condition_equations import (
    EqualLinks,
    Fixed,
    FixedLink,
    MirrorPair,
    MirrorSymmetry,
)
from .estimation.condition_kinds import (
    CenterOfMassInBox,
    CenterOfMassInEllipsoid,
    CenterOfMassInHull,
    MassInEllipsoid,
    TotalMass,
)
from .estimation.constraints import Constraints
from .estimation.estimate import Estimate
from .estimation.log_cholesky import solve_log_cholesky
from .estimation.modelled import as_cvxpy
from .estimation.prior import Prior
from .estimation.problem import Problem, build_problem
from .estimation.provenance import Provenance
from .estimation.robust import RobustEstimate, solve_robust
from .estimation.sdp import solve_sdp
from .estimation.slsqp import solve_slsqp
from .estimation.streaming import StreamingProblem
from .estimation.wls import solve_wls
from .experiment.choice import Choice, choose_processing
from .experiment.excitation import Trajectory, paper_excitation
from .experiment.inspection.inspect import Inspection, inspect_recording
from .experiment.motors import MotorSide
from .experiment.plant import simulate
from .experiment.processing import Processing, process
from .experiment.readers import read_recording
from .experiment.recording import Recording
from .experiment.samples import Samples
from .output.comparison import Comparison, compare
from .output.mjcf import write_mjcf
from .output.parameters_file import read_parameters, write_parameters
from .output.report import write_report
from .output.urdf import write_urdf
from .robot.base import BaseParameters
from .robot.friction import (
    AsymmetricCoulomb,
    Coulomb,
    Coupling,
    FrictionTerm,
    JointwiseTerm,
    Offset,
    OpenParameter,
    RotorInertia,
    SigmoidFriction,
    SquareRootFriction,
    Stribeck,
    TermParameter,
    Viscous,
)
from .robot.load import load_robot
from .robot.mdh import DhJoint, DhTable
from .robot.model import RobotModel
from .workflow.chain import identify, mass_matrix
from .workflow.cross_validation import CrossValidation, cross_validate
from .workflow.identification import Identification

__version__: str

__all__ = [
    "AsymmetricCoulomb",
    "BaseAudit",
    "BaseParameters",
    "CenterOfMassInBox",
    "CenterOfMassInEllipsoid",
    "CenterOfMassInHull",
    "Certificate",
    "CertificateError",
    "Choice",
    "Comparison",
    "ConstraintState",
    "Constraints",
    "Coulomb",
    "Coupling",
    "CrossValidation",
    "DataError",
    "DhJoint",
    "DhTable",
    "EqualLinks",
    "Estimate",
    "ExportError",
    "Fixed",
    "FixedLink",
    "FrictionTerm",
    "IdentifiabilityError",
    "Identification",
    "InfeasibleError",
    "Inspection",
    "Intervals",
    "JointwiseTerm",
    "MassInEllipsoid",
    "MirrorPair",
    "MirrorSymmetry",
    "MissingExtraError",
    "ModelError",
    "MotorSide",
    "Offset",
    "OpenParameter",
    "Payload",
    "Prior",
    "Problem",
    "Processing",
    "Provenance",
    "Recording",
    "RobotModel",
    "RobustEstimate",
    "RotorInertia",
    "Samples",
    "SdpidError",
    "SigmoidFriction",
    "SolverError",
    "SquareRootFriction",
    "StreamingProblem",
    "Stribeck",
    "TermParameter",
    "TotalMass",
    "Trajectory",
    "UrdfAudit",
    "Validation",
    "Viscous",
    "__version__",
    "as_cvxpy",
    "audit_base_parameters",
    "audit_urdf",
    "build_problem",
    "certify",
    "choose_processing",
    "compare",
    "cost_of_constraints",
    "cross_validate",
    "identify",
    "identify_payload",
    "inspect_recording",
    "intervals",
    "load_robot",
    "mass_matrix",
    "paper_excitation",
    "process",
    "read_parameters",
    "read_recording",
    "simulate",
    "solve_log_cholesky",
    "solve_robust",
    "solve_sdp",
    "solve_slsqp",
    "solve_wls",
    "validate",
    "verdict",
    "verify",
    "worst_mass_matrix",
    "write_mjcf",
    "write_parameters",
    "write_report",
    "write_urdf",
]
