"""The whole chain in one call: recordings and a robot in, certified parameters and files out."""

from sdpid.workflow.identify import formulate, identify, mass_matrix
from sdpid.workflow.result import Identification

__all__ = ["Identification", "formulate", "identify", "mass_matrix"]
