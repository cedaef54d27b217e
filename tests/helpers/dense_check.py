"""The dense check of the studies, which knows nothing of `sdpid.excitation`."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

_PATH = Path(__file__).parents[2] / "examples" / "studies" / "dense_check.py"


def dense_check() -> ModuleType:
    """Return the module: `states_of`, `joints_reached`, `efforts`, `point_speed`, `Geometry`."""
    name = "sdpid_dense_check"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, _PATH)
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
    return sys.modules[name]
