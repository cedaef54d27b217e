"""Friction as Python and C++, run against the model that it was written from."""

import ctypes
import os
import runpy
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sdpid
from sdpid._common.arrays import Array
from sdpid.errors import ExportError
from sdpid.friction import (
    AsymmetricCoulomb,
    Coulomb,
    Coupling,
    JointwiseTerm,
    LoadFriction,
    Offset,
    RotorInertia,
    SigmoidFriction,
    SquareRootFriction,
    Stribeck,
    Tilt,
    Viscous,
)
from sdpid.output.robots.friction_files import friction_data, write_friction
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.robot.model.model import RobotModel
from sdpid.verifier.results.friction_code import cpp, python
from tests.helpers.arm import ARM
from tests.helpers.data import friction_model, random_links
from tests.helpers.robots import TREE, TREE_MIMIC, small_arm
from tests.helpers.strategies import SEEDS, friction_terms_of, random_states

# The same formulas; the libraries' tanh, exp and pow differ by some last bits, and sums by their
# order. Relative to the largest effort.
SAME = 1e-12

COMPILER = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
WARNINGS = ("-std=c++11", "-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wconversion", "-Werror")

# Ends of strings and comments, line ends, trigraphs, a brace and a letter from right to left.
HOSTILE = (
    'a"; import os #',
    "*/ \\",
    "b\n#define double int",
    "??/",
    "\u202e\U0001f916'''",
    "%s{}",
)


def all_terms(n: int) -> tuple[tuple[FrictionTerm, ...], ...]:
    """Return every kind of term that a joint may have, those of the same parameters apart."""
    widths, speeds = tuple(0.1 * (k + 1) for k in range(n)), tuple(0.5 + k for k in range(n))
    return (
        (
            Coulomb(width=widths, dead_zone=0.05),
            Viscous(),
            Offset(),
            RotorInertia(),
            SquareRootFriction(),
            Stribeck(velocity=speeds, exponent=1.5, width=0.02),
            SigmoidFriction(velocity=speeds),
            LoadFriction(share=(0.3,) * n, velocity=speeds, width=widths),
        ),
        (AsymmetricCoulomb(), Stribeck(velocity=0.3), LoadFriction()),
        (AsymmetricCoulomb(width=0.2), Tilt()),
    )


def model_of(robot: RobotModel, terms: tuple[FrictionTerm, ...], seed: int = 0) -> RobotDynamics:
    rng = np.random.default_rng(seed)
    own = friction_model(robot, terms)
    values = rng.uniform(-1.0, 2.0, len(own.parameters))
    theta = np.concatenate([random_links(rng, robot.n_links).ravel(), values])
    return RobotDynamics(robot=robot, terms=own, theta=theta)


def named(joints: tuple[str, ...], robot: str) -> RobotModel:
    """Return an arm whose joints and itself have other names."""
    model = small_arm(len(joints)).pin_model.copy()
    model.name = robot
    for k, name in enumerate(joints, start=1):
        model.names[k] = name
    return RobotModel.from_pinocchio(model)


def cases() -> list[RobotDynamics]:
    tree = sdpid.load_robot(TREE)
    coupled = (Coulomb(), Coupling("slide", "right", 0.3), Coupling("right", "finger"))
    found = [model_of(ARM, terms, k) for k, terms in enumerate(all_terms(ARM.n))]
    floating = sdpid.load_robot(TREE, root="free_flyer")
    found += [model_of(tree, coupled), model_of(floating, (Coulomb(), RotorInertia()))]
    found += [model_of(sdpid.load_robot(TREE_MIMIC), (Viscous(), *coupled))]
    return [*found, model_of(named(HOSTILE, HOSTILE[0]), all_terms(len(HOSTILE))[0])]


CASES = cases()


def expected(model: RobotDynamics, v: Array, a: Array, load: Array) -> tuple[Array, ...]:
    """Return friction, drives and friction of the load of the joints that have friction."""
    first = model.terms.first
    rest = np.zeros_like(v)
    drives = model.terms.columns(rest, a) - model.terms.columns(rest, rest)
    values = model.theta[10 * model.robot.n_links :]
    held = np.zeros_like(v)
    at = 0
    for term in model.terms.terms:
        count = len(term.parameters(model.terms.joint_names))
        if isinstance(term, LoadFriction):
            sign = term.sign(v[:, first:], a[:, first:])
            held[:, first:] = values[at : at + count] * np.abs(load[:, first:]) * sign
        at += count
    return tuple(each[:, first:] for each in (model.friction(v), drives @ values, held))


def states_of(model: RobotDynamics, seed: int) -> tuple[Array, Array, Array]:
    """Return velocities, accelerations and loads (K, n); among them standstill and dead zones."""
    v, a, load = random_states(np.random.default_rng(seed), model.robot.n, 12)
    v[0], v[1], v[2] = 0.0, 0.01 * v[1], 1e4 * v[2]
    return v, a, load


def same(actual: Array, wanted: Array) -> None:
    scale = max(1.0, float(np.abs(wanted).max()))
    np.testing.assert_allclose(actual, wanted, rtol=0, atol=SAME * scale)


def run(path: Path) -> dict[str, Any]:
    return runpy.run_path(str(path))


@pytest.mark.parametrize("model", CASES)
def test_python_computes_what_the_model_does(model: RobotDynamics, tmp_path: Path) -> None:
    notes = write_friction(model, tmp_path / "friction.py")
    assert bool(notes) == any(isinstance(term, Tilt) for term in model.terms.terms)
    if notes:
        found = [float(x) for x in notes[0].partition("take (")[2].partition(")")[0].split(", ")]
        tilted = model.to_pinocchio().gravity.linear
        np.testing.assert_allclose(found, tilted, atol=1e-3)
        assert np.abs(tilted - model.robot.gravity).max() > 0.01
    file, first = run(tmp_path / "friction.py"), model.terms.first
    assert file["JOINTS"] == model.terms.joint_names
    assert file["ROBOT"] == model.robot.name
    v, a, load = states_of(model, 1)
    friction, drives, held = expected(model, v, a, load)
    v, a, load = v[:, first:], a[:, first:], load[:, first:]
    same(file["friction"](v), friction)
    same(file["friction"](v[3]), friction[3])
    same(file["drive_inertia"](a), drives)
    same(file["load_friction"](v, load), held)
    with pytest.raises(ValueError, match="states have shape"):
        file["friction"](v[:, :-1])


@given(st.data(), SEEDS)
def test_any_term_in_python(data: st.DataObject, seed: int) -> None:
    robot = named(("a", "b", "c"), "r")
    term = data.draw(friction_terms_of(3))
    if isinstance(term, (LoadFriction, Tilt)) and term.bodies is not None:
        term = type(term)()
    model = model_of(robot, (term,), seed)
    file: dict[str, Any] = {}
    exec(python(friction_data(model)), file)
    v, a, load = states_of(model, seed)
    friction, drives, held = expected(model, v, a, load)
    same(file["friction"](v), friction)
    same(file["drive_inertia"](a), drives)
    same(file["load_friction"](v, load), held)


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """Return all headers in one library, compiled with every warning an error."""
    if COMPILER is None:
        reason = "no C++ compiler (c++, g++ or clang++)"
        if os.environ.get("CI", "").lower() == "true":
            pytest.fail(reason)
        pytest.skip(reason)
    folder = tmp_path_factory.mktemp("cpp")
    write_friction(model_of(ARM, (Viscous(),)), folder / "unnamed.hpp")
    lines = ['#include "unnamed.hpp"', 'static_assert(identified_friction::joints > 0, "");']
    for k, model in enumerate(CASES):
        write_friction(model, folder / f"case{k}.hpp")
        space = f"case{k}"
        lines += [
            f"#define SDPID_FRICTION_NAMESPACE {space}",
            f'#include "case{k}.hpp"',
            f'#include "case{k}.hpp"',
            'extern "C" {',
            f"int joints{k}() {{ return {space}::joints; }}",
            f"const char* name{k}(int j) {{ return {space}::joint_names[j]; }}",
            f"void friction{k}(const double* v, double* e) {{ {space}::friction(v, e); }}",
            f"void drives{k}(const double* a, double* e) {{ {space}::drive_inertia(a, e); }}",
            f"void load{k}(const double* v, const double* l, double* e) "
            f"{{ {space}::load_friction(v, l, e); }}",
            "}",
        ]
    (folder / "all.cpp").write_text("\n".join([*lines, ""]), encoding="utf-8")
    library = folder / "all.so"
    command = [COMPILER, *WARNINGS, "-O1", "-shared", "-fPIC", "all.cpp", "-o", library.name]
    subprocess.run(command, cwd=folder, check=True)
    return ctypes.CDLL(str(library))


@pytest.mark.parametrize("k", range(len(CASES)))
def test_the_compiled_header_computes_what_the_model_does(compiled: ctypes.CDLL, k: int) -> None:
    model, first = CASES[k], CASES[k].terms.first
    n = getattr(compiled, f"joints{k}")()
    name = getattr(compiled, f"name{k}")
    name.restype = ctypes.c_char_p
    assert [name(j).decode("utf-8") for j in range(n)] == list(model.terms.joint_names)
    v, a, load = states_of(model, 2)
    friction, drives, held = expected(model, v, a, load)
    for i in range(len(v)):
        for function, given_, wanted in (
            ("friction", (v,), friction),
            ("drives", (a,), drives),
            ("load", (v, load), held),
        ):
            effort = np.full(n, np.nan)
            arrays = [np.ascontiguousarray(x[i, first:]) for x in given_]
            pointers = [x.ctypes.data_as(ctypes.c_void_p) for x in (*arrays, effort)]
            getattr(compiled, f"{function}{k}")(*pointers)
            same(effort, wanted[i])


def test_names_of_others_stand_in_ascii_literals_only() -> None:
    for write in (python, cpp):
        text = write(friction_data(CASES[-1]))
        assert text.isascii()
        assert not any(
            line.lstrip().startswith(("import os", "#define d")) for line in text.splitlines()
        )


class Own(JointwiseTerm):
    """A term of a user's own."""

    symbol, unit, nonnegative = "Mine", "N.m", True

    def shape(self, velocity: Array, acceleration: Array) -> Array:
        return velocity**3


class Subclassed(Coulomb):
    """A term that looks like one of ours."""


@pytest.mark.parametrize("term", [Own(), Subclassed()])
def test_terms_of_your_own_are_refused_by_name(term: FrictionTerm, tmp_path: Path) -> None:
    with pytest.raises(ExportError, match=f"{type(term).__name__} is a term of your own"):
        write_friction(model_of(ARM, (term,)), tmp_path / "friction.py")
    assert not list(tmp_path.iterdir())


def test_other_languages_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match=r"written as \.py or \.hpp"):
        write_friction(CASES[0], tmp_path / "friction.rs")
