"""The rooms of the package: arrows point one way, nothing heavy is imported at the door."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import sdpid
from tests.helpers.code_lines import code_lines, lines_by_part

PACKAGE = Path(sdpid.__file__).parent
MODULES = {
    ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__"): path
    for path in sorted(PACKAGE.rglob("*.py"))
}

# The flow of the package. Each room may import from itself and from those before it; so may each
# sub-package of a room. Helpers (errors, names that begin with an underscore) come before all.
ROOMS = {
    "verifier": [],
    # Draws arrays, and knows nothing of what the others make.
    "plots": [],
    "robot": ["inertia", "consistent", "friction", "description", "model", "legs"],
    "experiment": [
        "drive_gains",
        "recording",
        "readers",
        "processing",
        "inspection",
        "preparation",
        "trajectory",
        "simulation",
        "plant",
    ],
    "estimation": [
        "information",
        "constraints",
        "conic",
        "compression",
        "prior",
        "effects",
        "error_source",
        "problem",
        "scaling",
        "coordinates",
        "cluster_robust",
        "noise_spectrum",
        "motion_noise",
        "posterior",
        "agreement",
        "duality",
        "estimate",
        "wls",
        "sdp",
        "selection",
        "local",
        "robust",
        "closed_loop",
        "recursive",
        "positions",
        "elasticity",
    ],
    "excitation": [
        "geometry",
        "limits",
        "criterion",
        "search",
        "expected",
        "plan",
        "design",
        "standing",
    ],
    "assurance": [
        "certificate",
        "recipe",
        "intervals",
        "diagnostics",
        "tables",
        "descriptions",
        "payload",
        "drive_gains",
        "rollouts",
        "sampling",
    ],
    "output": ["tables", "robots", "samples", "charts", "scene", "report", "plans"],
    "workflow": [],
    "cli": [],
}

# What takes long to import, and is loaded by the function that needs it.
HEAVY = {
    "casadi",
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

# Runs without the package, as a folder that is copied anywhere, so its modules import each other
# relative to it, and nothing but the standard library otherwise.
ALONE = "sdpid.verifier"

# Who may use a library at all, as beginnings of module names.
ALLOWED = {
    "pinocchio": (
        "sdpid.robot.",
        "sdpid.excitation.",
        "sdpid.experiment.plant",
        "sdpid.experiment.simulation",
    ),
    "casadi": ("sdpid.excitation.search.ipopt",),
    "cvxpy": ("sdpid.estimation.sdp.", "sdpid.assurance."),
    "clarabel": ("sdpid.estimation.conic",),
    "mujoco": ("sdpid.experiment.plant", "sdpid.robot.description.mjcf"),
    "numba": ("sdpid.robot.model.regressor_kernel", "sdpid.experiment.simulation.kernels"),
    "dask": ("sdpid.estimation.compression.distributed_rows",),
    "distributed": ("sdpid.estimation.compression.distributed_rows",),
}

# Features that only some users need. Each can be deleted: nobody but the command line, the
# workflow and the package face imports it.
FEATURES = (
    "sdpid.estimation.compression.distributed_rows",
    "sdpid.estimation.recursive",
    "sdpid.estimation.robust",
    "sdpid.assurance.drive_gains",
    "sdpid.estimation.closed_loop",
    "sdpid.experiment.plant.legged",
    "sdpid.excitation.standing",
    "sdpid.assurance.payload",
    "sdpid.assurance.rollouts",
    "sdpid.assurance.sampling",
    "sdpid.assurance.tables",
    "sdpid.output.samples",
)
FACES = ("sdpid.cli", "sdpid.workflow")

# Code lines that each room and sub-package may have, lowered by `.ci/budgets`.
BUDGETS = Path(__file__).with_name("budgets.toml")


def imports(tree: ast.AST, *, executed_only: bool = False) -> Iterator[tuple[str, int]]:
    """Yield every imported module, wherever in the file, with the number of leading dots."""
    nodes = executed(tree) if executed_only else ast.walk(tree)
    for node in nodes:
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name, 0
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            yield base, node.level
            for alias in node.names:
                if f"{base}.{alias.name}" in MODULES:
                    yield f"{base}.{alias.name}", node.level


def resolved(name: str, imported: str, dots: int) -> str:
    """Return the full name of a module that another one imports."""
    if not dots:
        return imported
    package = name if MODULES[name].name == "__init__.py" else name.rpartition(".")[0]
    for _ in range(dots - 1):
        package = package.rpartition(".")[0]
    return f"{package}.{imported}" if imported else package


def executed(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the statements that run when a module is imported."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)):
            continue
        if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.dump(child.test):
            continue
        yield child
        yield from executed(child)


@cache
def trees() -> dict[str, ast.Module]:
    """Return the syntax tree of every module, read when a test first asks."""
    return {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in MODULES.items()}


@cache
def every_import(*, executed_only: bool = False) -> list[tuple[str, str, int]]:
    """Return each module with what it imports, and the number of leading dots."""
    return [
        (name, *each)
        for name, tree in trees().items()
        for each in imports(tree, executed_only=executed_only)
    ]


@cache
def arrows() -> dict[str, set[str]]:
    """Return who imports whom, imports inside functions and for type checkers counted.

    A package stands for its own __init__.py only: what is imported from a module is counted as
    that module.
    """
    found: dict[str, set[str]] = {name: set() for name in MODULES}
    for name, given, dots in every_import():
        found[name].add(resolved(name, given, dots))
    del found["sdpid"]
    return {name: targets & {*MODULES} - {"sdpid", name} for name, targets in found.items()}


def room(name: str) -> str | None:
    """Return the room of a module, None for the helpers that stand before all rooms."""
    first = name.split(".")[1]
    if first == "__main__":
        return "cli"
    if first == "errors" or first.startswith("_"):
        return None
    return first


def is_face(name: str) -> bool:
    """Whether a module stands beside the rooms and re-exports names: a public namespace."""
    return name.count(".") == 1 and room(name) not in ROOMS and room(name) is not None


def circle(graph: dict[str, set[str]]) -> list[str]:
    """Return a circle of arrows, empty where there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def at_level(level: int) -> dict[str, set[str]]:
    """Return the arrows between rooms (level 2) or between their sub-packages (level 3)."""
    found: dict[str, set[str]] = defaultdict(set)
    for name, targets in arrows().items():
        for target in targets:
            a, b = (".".join(each.split(".")[:level]) for each in (name, target))
            if a != b and len(a.split(".")) == len(b.split(".")) == level:
                found[a].add(b)
    return found


@pytest.mark.parametrize("between", ["files", "rooms", "sub-packages"])
def test_no_circle_between(between: str) -> None:
    levels = {"rooms": 2, "sub-packages": 3}
    assert circle(at_level(levels[between]) if between in levels else arrows()) == []


def rank(name: str) -> tuple[int, int | None]:
    """Return the places of a module's room and, if it is ordered, its sub-package in the flow."""
    parts, own = name.split("."), room(name) or ""
    part = ROOMS[own].index(parts[2]) if ROOMS[own] and len(parts) > 2 else None
    return list(ROOMS).index(own), part


def points_back(name: str, target: str) -> bool:
    """Whether a module imports one that comes after it."""
    if room(target) is None:
        return False
    if room(name) is None or is_face(target):
        return True
    (one, part), (other, its) = rank(name), rank(target)
    return other > one or (other == one and None not in (part, its) and its > part)


def test_arrows_point_one_way() -> None:
    inside = {name: targets for name, targets in arrows().items() if not is_face(name)}
    assert {room(name) for name in inside} - {None} <= {*ROOMS}
    assert [(a, b) for a, targets in inside.items() for b in targets if points_back(a, b)] == []


def test_every_part_of_a_room_is_named_in_the_order() -> None:
    unnamed = [
        name
        for name in MODULES
        if len(name.split(".")) > 2
        and (order := ROOMS.get(name.split(".")[1]))
        and name.split(".")[2] not in order
    ]
    assert unnamed == []


def test_imports_are_absolute() -> None:
    relative = {name for name, _, dots in every_import() if dots}
    assert [name for name in relative if not name.startswith(ALONE)] == []


def test_the_checker_stands_alone() -> None:
    wrong = [
        (name, imported)
        for name, imported, dots in every_import()
        if name.startswith(f"{ALONE}.")
        and not dots
        and imported.split(".")[0] not in sys.stdlib_module_names
        # As a module of the package it imports itself by its full name.
        and not (name == f"{ALONE}.__main__" and imported.startswith(ALONE))
    ]
    assert wrong == []


def test_libraries_stay_in_their_rooms() -> None:
    wrong = [
        (name, imported)
        for name, imported, _ in every_import()
        if not name.startswith(ALLOWED.get(imported.split(".")[0], ("",)))
    ]
    assert wrong == []


def test_heavy_libraries_are_imported_where_they_are_used() -> None:
    at_the_door = every_import(executed_only=True)
    assert [each for each in at_the_door if each[1].split(".")[0] in HEAVY] == []


def of_feature(name: str) -> str | None:
    """Return the feature that a module belongs to."""
    return next((each for each in FEATURES if f"{name}.".startswith(f"{each}.")), None)


def test_features_can_be_deleted_alone() -> None:
    wrong = [
        (name, target)
        for name, targets in arrows().items()
        for target in targets
        if of_feature(target) not in (None, of_feature(name))
        and not name.startswith(FACES)
        and not is_face(name)
    ]
    assert wrong == []


def test_no_two_classes_have_the_same_name() -> None:
    found: dict[str, list[str]] = defaultdict(list)
    for name, tree in trees().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                found[node.name.lstrip("_")].append(name)
    twice = {name: modules for name, modules in found.items() if len(modules) > 1}
    assert twice == {}, "rename one, or join"


@pytest.mark.skipif(sys.version_info < (3, 11), reason="tomllib came with Python 3.11")
def test_no_room_has_more_lines_than_its_budget() -> None:
    import tomllib

    budgets = tomllib.loads(BUDGETS.read_text(encoding="utf-8"))["lines"]
    found = lines_by_part(BUDGETS.parent.parent)
    assert sorted(found) == sorted(budgets), "parts came or went: .ci/budgets renews the table"
    over = {part: (count, budgets[part]) for part, count in found.items() if count > budgets[part]}
    assert over == {}, "code lines beside the budget: cut, or .ci/budgets --raise PART REASON"


def test_docstrings_comments_and_blank_lines_are_no_code() -> None:
    text = (
        '"""One."""\n\n# Two.\n'
        'def f() -> str:\n    """Three,\n\n    four."""\n'
        '    # Five.\n    return """six\n# six"""  # six\n'
    )
    assert code_lines(text) == 3


def run(code: str) -> str:
    """Return what a fresh interpreter prints."""
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("names", [["sdpid"], [each for each in MODULES if "__main__" not in each]])
def test_importing_loads_nothing_heavy(names: list[str]) -> None:
    code = f"import importlib, sys; [importlib.import_module(name) for name in {names!r}]; "
    loaded = run(code + "print(*{name.split('.')[0] for name in sys.modules})").split()
    assert {*loaded} & HEAVY == set()


WITHOUT_FEATURES = """
import sys, importlib.abc
class Refuse(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if any((name + ".").startswith(each + ".") for each in {features!r}):
            raise ModuleNotFoundError(name)
sys.meta_path.insert(0, Refuse())
import numpy as np, sdpid
robot = sdpid.load_robot("denso_vp6242")
rng = np.random.default_rng(0)
q, v, a, effort = rng.normal(size=(4, 200, 6))
samples = sdpid.Samples(position=q, velocity=v, acceleration=a, effort=effort)
problem = sdpid.build_problem(robot, samples)
estimate = sdpid.solve_sdp(problem)
certificate = sdpid.certify(estimate)
print(estimate.status, certificate.passed, sdpid.validate(estimate).relative > 0.0)
"""


def test_the_core_works_without_the_features() -> None:
    assert run(WITHOUT_FEATURES.format(features=FEATURES)) == "optimal True True\n"


def test_every_public_name_is_there_and_typed() -> None:
    assert sdpid.__all__
    assert [name for name in sdpid.__all__ if not hasattr(sdpid, name)] == []
    assert (PACKAGE / "py.typed").is_file()


def test_every_slow_test_is_there(unknown_slow_tests: list[str]) -> None:
    assert unknown_slow_tests == [], "tests/slow.txt names what is no test"
