"""Forged folders of results, held against the true log and the true robot: none is accepted.

Everybody who can write all files anew makes every digest right. Whatever checks a folder, these
have to be told by `sdpid.verify` and the command.
"""

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid.constraints import TotalMass
from sdpid.robot.model.digest import kinematics_digest
from sdpid.verifier.results.friction_code import WRITERS
from sdpid.verifier.results.friction_terms import Language
from sdpid.workflow.verify import Verification
from tests.helpers.arm_files import ARM_URDF
from tests.helpers.forged import edit, edit_json, reseal
from tests.helpers.runs import recorded

URDF, MJCF = "identified.urdf", "identified.xml"
FRICTION = ("identified_friction.py", "identified_friction.hpp")
MARK = "sdpid-friction: "


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a robot, a log, and the results of several runs."""
    folder = tmp_path_factory.mktemp("run")
    log = recorded(1)
    dry = 0.3 * np.sign(np.gradient(log.position, axis=0))
    replace(log, effort=log.effort + dry).to_csv(folder / "run.csv")
    (folder / "arm.urdf").write_text(ARM_URDF)
    identified(folder, "results")
    return folder


def identified(folder: Path, name: str, **options: Any) -> Path:
    """Write the results of a run, and return the folder that they are in."""
    robot, log = folder / "arm.urdf", folder / "run.csv"
    result = sdpid.identify(robot, log, intervals=False, **options)
    result.save(folder / name, figures=False)
    return folder / name


@pytest.fixture
def results(run: Path, tmp_path: Path) -> Path:
    """A copy of the results of the run by default."""
    return Path(shutil.copytree(run / "results", tmp_path / "results"))


def verified(run: Path, results: Path) -> Verification:
    """Hold results against the true log and the true robot."""
    return sdpid.verify(results, data=run / "run.csv", robot=run / "arm.urdf")


def refused(run: Path, results: Path, words: str) -> None:
    """Require that results are not proven once they are sealed again, for a reason in words."""
    reseal(results)
    found = verified(run, results)
    assert not found.passed
    assert any(re.search(words, each) for each in found.problems), found.problems


def recipe(results: Path, change: Callable[[Any], object]) -> None:
    """Change the recipe of a folder."""
    edit_json(results / "manifest.json", lambda data: change(data["recipe"]))


def test_what_is_sealed_again_unchanged_is_proven(run: Path, results: Path) -> None:
    reseal(results)
    found = verified(run, results)
    assert found.passed, found.problems
    assert found.lines[-1].startswith("PROVEN")


def other_axis(text: str) -> str:
    return text.replace('xyz="0 0 1"', 'xyz="0 0 -1"', 1)


def all_axes(text: str) -> str:
    return text.replace('xyz="0 0 1"', 'xyz="0 0 -1"')


def other_place(text: str) -> str:
    return text.replace('xyz="0.4 0 0"', 'xyz="0.9 0 0"')


def other_limit(text: str) -> str:
    return text.replace('effort="100"', 'effort="1000"')


@pytest.mark.parametrize("change", [other_axis, other_place, other_limit])
def test_another_kinematics_in_urdf_and_manifest(
    run: Path, results: Path, change: Callable[[str], str]
) -> None:
    edit(results / URDF, change)
    digest = kinematics_digest(sdpid.load_robot(results / URDF))
    recipe(results, lambda given: given["robot"].update(kinematics=digest))
    refused(run, results, URDF)


@pytest.mark.parametrize("change", [all_axes, str])
def test_a_recipe_without_kinematics(
    run: Path, results: Path, change: Callable[[str], str]
) -> None:
    path = results / URDF
    path.write_text(change(path.read_text()))
    recipe(results, lambda given: given["robot"].update(kinematics=None))
    refused(run, results, "kinematics" if change is str else URDF)


@pytest.mark.parametrize(
    "change",
    [
        lambda text: re.sub('gravity="0.0 0.0 -', 'gravity="0.0 0.0 ', text),
        lambda text: text.replace('axis="0.0 0.0 1.0"', 'axis="0.0 0.0 -1.0"'),
        lambda text: re.sub('(name="fore" pos=")[^ ]*', r"\g<1>7.4", text),
        lambda text: text.replace('type="hinge"', 'type="slide"', 1),
        lambda text: text.replace('range="-3.0 3.0"', 'range="-1.0 1.0"'),
        lambda text: re.sub('(name="tool" .*?mass=")[^"]*', r"\g<1>0.5", text, flags=re.S),
    ],
    ids=("gravity", "axis", "place", "type", "range", "mass"),
)
def test_another_mjcf(run: Path, results: Path, change: Callable[[str], str]) -> None:
    pytest.importorskip("mujoco")
    edit(results / MJCF, change)
    refused(run, results, MJCF)


def write_friction(results: Path, change: Callable[[Any], object]) -> None:
    """Change the numbers of both files of friction, and write their code anew."""
    for name in FRICTION:
        text = (results / name).read_text()
        (line,) = (each for each in text.splitlines() if MARK in each)
        data = json.loads(line.partition(MARK)[2])
        change(data)
        (results / name).write_text(WRITERS[Path(name).suffix](data))


@pytest.mark.parametrize("kind", ["width", "velocity"])
def test_friction_without_friction(run: Path, results: Path, kind: str) -> None:
    def change(data: Any) -> None:
        (term,) = (each for each in data["terms"] if kind in each)
        term[kind] = [1e9] * len(data["joints"])

    write_friction(results, change)
    refused(run, results, "identified_friction")


def test_friction_of_a_writer_that_is_wrong(
    run: Path, results: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The check is not the writer: it computes friction by the terms of the recipe."""
    sign = Language.sign
    monkeypatch.setattr(Language, "sign", lambda *args: f"-{sign(*args)}")
    write_friction(results, lambda data: None)
    refused(run, results, "identified_friction")
    assert not sdpid.verify(results).passed


@pytest.mark.parametrize("name", [URDF, MJCF])
@pytest.mark.parametrize("friction", ["default", ("coulomb", "viscous")])
def test_damping_whatever_result_json_says(
    run: Path, tmp_path: Path, results: Path, name: str, friction: Any
) -> None:
    if name == MJCF:
        pytest.importorskip("mujoco")
    if friction != "default":
        shutil.rmtree(results)
        shutil.copytree(sharp(run), results)

    def fitted(data: Any) -> None:
        for export in data["exports"]:
            export["friction_fitted"] = True

    edit(results / name, lambda text: re.sub('damping="[^"]*"', 'damping="1e9"', text, count=1))
    edit_json(results / "result.json", fitted)
    refused(run, results, f"{name}.*damping")


def sharp(run: Path) -> Path:
    """Return results whose friction has a place in every file."""
    folder = run / "sharp"
    return folder if folder.exists() else identified(run, "sharp", friction=("coulomb", "viscous"))


def test_masses_that_the_log_does_not_show(run: Path, tmp_path: Path) -> None:
    """The base parameters are the same, and the bodies are not those of the rule."""
    robot, log = run / "arm.urdf", run / "run.csv"
    result = sdpid.identify(robot, log, intervals=False, prior=False, effects="none")
    result.save(tmp_path / "honest", figures=False)
    honest = verified(run, tmp_path / "honest")
    assert honest.passed, honest.problems
    assert any("single masses" in each for each in (*honest.statements, *honest.unchecked))
    estimate = result.estimate
    theta = np.array(estimate.theta)
    # Mass of the first link on its own axis moves nothing.
    theta[0] += 3.0
    moved = replace(estimate, theta=theta)
    assert np.allclose(result.problem.base_of(theta), estimate.base, atol=1e-9)
    forged = replace(result, estimate=moved, certificate=sdpid.certify(moved))
    forged.save(tmp_path / "forged", figures=False)
    refused(run, tmp_path / "forged", "nearest to the description")


def test_bounds_of_ones_own(run: Path, tmp_path: Path) -> None:
    """A certificate of other bounds, whose recipe does not state what was asked."""
    heavy = sdpid.Constraints(mass_min=20.0, mass_max=40.0, others=(TotalMass(50.0),))
    results = identified(run, str(tmp_path / "heavy"), constraints=heavy, prior=False)
    found = verified(run, results)
    assert found.passed, found.problems
    said = " ".join(found.statements)
    assert "total mass" in said
    assert "the defaults for this robot" not in said
    recipe(results, lambda given: given.update(problem=None))
    refused(run, results, "problem")


@pytest.mark.parametrize("end", ["lower", "upper"])
def test_a_bound_of_a_mass_is_named(run: Path, results: Path, end: str) -> None:
    def change(data: Any) -> None:
        data["problem"][end][10] = 2.0 if end == "upper" else 0.5

    edit_json(results / "certificate.json", change)
    refused(run, results, f"the {end} bound of 'm_2'")
    assert any("'m_2'" in each for each in verified(run, results).statements)


def test_what_differs_from_the_defaults_is_said_in_words(run: Path, tmp_path: Path) -> None:
    free = sdpid.Constraints.of_size(sdpid.load_robot(ARM_URDF), friction_nonnegative=False)
    results = identified(
        run, str(tmp_path / "free"), constraints=free, processing={"trim_s": 8.0}, effects="none"
    )
    said = " ".join(verified(run, results).statements)
    assert "friction may be negative" in said
    assert re.search(r"of the 1000 samples of the log", said)
    assert "gravity is taken to be (0, 0, -9.81) m/s²" in said


def test_arguments_of_macros_are_said(run: Path, tmp_path: Path) -> None:
    pytest.importorskip("xacro")
    macro = tmp_path / "arm.urdf.xacro"
    text = ARM_URDF.replace(
        '<robot name="arm">',
        '<robot name="arm" xmlns:xacro="http://ros.org/wiki/xacro">'
        '<xacro:arg name="reach" default="0.1"/>',
    )
    macro.write_text(text.replace('xyz="0.4 0 0"', 'xyz="$(arg reach) 0 0"'))
    robot = sdpid.load_robot(macro, xacro_args={"reach": "0.4"})
    sdpid.identify(robot, run / "run.csv", intervals=False).save(
        tmp_path / "results", figures=False
    )
    found = sdpid.verify(tmp_path / "results", data=run / "run.csv", robot=macro)
    assert found.passed, found.problems
    assert any("reach" in each and "0.4" in each for each in found.statements)
