"""The house has rooms, arrows point one way, and nothing heavy is carried in at the door."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import sdpid

PACKAGE = Path(sdpid.__file__).parent
MODULES = sorted(PACKAGE.rglob("*.py"))

# Each may import from those before it.
ROOMS = ("helpers", "robot", "experiment", "estimation", "assurance", "output", "workflow")

# What takes long to import, and is loaded by the function that needs it.
HEAVY = {
    "clarabel",
    "cvxpy",
    "dask",
    "h5py",
    "joblib",
    "matplotlib",
    "mujoco",
    "numba",
    "pandas",
    "pinocchio",
    "pyarrow",
    "rosbags",
    "scipy",
}

# Who may use a library at all, as beginnings of module names.
ALLOWED = {
    "pinocchio": ("sdpid.robot.", "sdpid.experiment.plant"),
    "cvxpy": ("sdpid.estimation.modelled", "sdpid.assurance."),
    "clarabel": ("sdpid.estimation.conic",),
    "scs": ("sdpid.estimation.conic",),
    "mujoco": ("sdpid.experiment.plant", "sdpid.experiment.mujoco"),
    "numba": ("sdpid.robot.kernels",),
}


def module_name(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def room(name: str) -> str:
    """Return the room of a module: helpers stand at the top level and belong to everyone."""
    parts = name.split(".")
    if len(parts) > 1 and parts[1] in ("workflow", "cli", "__main__"):
        return "workflow"
    helper = len(parts) == 1 or parts[1] == "errors" or parts[1].startswith("_")
    return "helpers" if helper else parts[1]


def imports(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """Yield every imported module, wherever in the file, with how many dots it starts with."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name, 0
        elif isinstance(node, ast.ImportFrom):
            yield node.module or "", node.level
            if node.module == "sdpid":
                for alias in node.names:
                    yield f"sdpid.{alias.name}", 0


def type_checking(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)


def executed(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the statements that run when a module is imported."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)):
            continue
        if type_checking(child):
            continue
        yield child
        yield from executed(child)


def parse(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("path", MODULES, ids=module_name)
def test_arrows_point_one_way(path: Path) -> None:
    name = module_name(path)
    assert room(name) in ROOMS, f"{name} stands in no room; put it in one of {ROOMS}"
    for imported, level in imports(parse(path)):
        assert level == 0, f"{name} imports relatively"
        if imported.split(".")[0] != "sdpid" or name == "sdpid":
            continue
        assert ROOMS.index(room(imported)) <= ROOMS.index(room(name)), f"{name} imports {imported}"


@pytest.mark.parametrize("path", MODULES, ids=module_name)
def test_libraries_stay_in_their_rooms(path: Path) -> None:
    name = module_name(path)
    for imported, _ in imports(parse(path)):
        beginnings = ALLOWED.get(imported.split(".")[0])
        if beginnings is not None:
            assert name.startswith(beginnings), f"{name} imports {imported}"


@pytest.mark.parametrize("path", MODULES, ids=module_name)
def test_heavy_libraries_are_imported_where_they_are_used(path: Path) -> None:
    for node in executed(parse(path)):
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            found = {imported.split(".")[0] for imported, _ in imports(node)}
            assert not found & HEAVY, f"{module_name(path)}, line {node.lineno}"


def loaded_after(code: str) -> set[str]:
    """Return the modules that a fresh interpreter holds after some code."""
    code += "; import sys, json; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    )
    return set(json.loads(done.stdout.splitlines()[-1]))


def test_importing_the_package_loads_nothing_heavy() -> None:
    loaded = loaded_after("import sdpid")
    assert not {name.split(".")[0] for name in loaded} & HEAVY


def test_importing_every_module_loads_nothing_heavy() -> None:
    names = [module_name(path) for path in MODULES if path.stem != "__main__"]
    loaded = loaded_after(f"import importlib; [importlib.import_module(n) for n in {names!r}]")
    assert not {name.split(".")[0] for name in loaded} & HEAVY


def test_every_public_name_is_there() -> None:
    assert sdpid.__all__
    missing = [name for name in sdpid.__all__ if not hasattr(sdpid, name)]
    assert not missing


def test_the_package_says_that_it_is_typed() -> None:
    assert (PACKAGE / "py.typed").is_file()
