"""Tests of the scripts that judge the tests: .ci/coverage and .ci/mutants."""

from __future__ import annotations

import importlib
import sys
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from types import ModuleType

SCRIPTS = Path(__file__).resolve().parents[2] / ".ci"


def imported(name: str) -> ModuleType:
    """Return a module beside the scripts, or a script as a module."""
    sys.path.insert(0, str(SCRIPTS))
    try:
        if (SCRIPTS / f"{name}.py").is_file():
            return importlib.import_module(name)
        loader = SourceFileLoader(f"script_{name}", str(SCRIPTS / name))
        spec = spec_from_loader(loader.name, loader)
        assert spec is not None
        module = module_from_spec(spec)
        # Dataclasses look for their module.
        sys.modules[loader.name] = module
        loader.exec_module(module)
        return module
    finally:
        sys.path.remove(str(SCRIPTS))
