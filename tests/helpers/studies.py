"""Modules of the studies, as tests use them."""

import importlib
import sys
from pathlib import Path
from types import ModuleType

_STUDIES = Path(__file__).parents[2] / "examples" / "evidence"


def study(name: str) -> ModuleType:
    """Return a module of the studies, such as ``"certificate_judge"`` or ``"dense_check"``."""
    sys.path.append(str(_STUDIES))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(str(_STUDIES))
