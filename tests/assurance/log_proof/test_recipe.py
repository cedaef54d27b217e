"""A recipe makes the same rows of the same log again."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sdpid
from sdpid.assurance.log_proof.inputs import recording_digest
from sdpid.assurance.log_proof.recipe import Recipe, RobotRecipe
from sdpid.assurance.log_proof.stated_problem import StatedProblem
from sdpid.errors import CertificateError
from sdpid.experiment.preparation.several import prepare_recordings
from sdpid.experiment.processing.settings import Processing
from sdpid.robot.friction.terms import Coulomb
from tests.helpers.arm_files import ARM_URDF
from tests.helpers.runs import arm, recorded
from tests.helpers.strategies import friction_terms_of, reals

ROBOT = RobotRecipe(
    name="arm",
    source="arm.urdf",
    catalog=False,
    root=None,
    xacro_args={},
    gravity=(0.0, 0.0, -9.81),
    kinematics="0" * 64,
)

PROCESSINGS = st.builds(
    Processing,
    cutoff_hz=reals(0.5, 50.0),
    order=st.integers(1, 6),
    decimation=st.none() | st.integers(1, 20),
    filter_alike=st.booleans(),
    reversal_speed=reals(0.0, 1.0),
    reversal_time=st.none() | reals(0.0, 1.0),
    kept_share=reals(0.0, 1.0),
    filter_friction=st.booleans(),
    covariance=st.sampled_from(["period", "pooled", None]),
    shrinkage=reals(0.0, 1.0),
    derivative=st.sampled_from(["central", "central4", "spectral", "savitzky_golay"]),
    velocity=st.sampled_from(["differentiated", "measured"]),
    trim_s=st.none() | reals(0.0, 9.0),
    timing=st.sampled_from(["auto", "nominal", "resample"]),
    filter=st.sampled_from(["butterworth", "bessel"]),
)


@given(PROCESSINGS, st.lists(friction_terms_of(3), max_size=4), st.integers(0, 2**32 - 1))
def test_a_recipe_that_was_json_is_the_same_recipe(
    processing: Processing, friction: list[Any], seed: int
) -> None:
    recipe = Recipe(
        robot=ROBOT,
        reading=({"units": {"position": "deg"}}, None),
        processing=processing,
        without_effort=("b",),
        friction=tuple(friction),
        weighting="residual",
        sigma=np.diag(np.random.default_rng(seed).uniform(1e-9, 1e9, 3)),
    )
    again = Recipe.from_dict(json.loads(json.dumps(recipe.to_dict(), allow_nan=False)))
    for name in ("robot", "reading", "processing", "without_effort", "friction", "weighting"):
        assert getattr(again, name) == getattr(recipe, name)
    assert again.sigma is not None
    assert recipe.sigma is not None
    assert np.array_equal(again.sigma, recipe.sigma)


@pytest.fixture(scope="module")
def robot() -> sdpid.RobotModel:
    return arm()


def test_the_rows_of_a_file_are_made_again(tmp_path: Path, robot: sdpid.RobotModel) -> None:
    log = recorded(1)
    table = np.column_stack([1e3 * log.time, np.degrees(log.position), log.effort / 50.0])
    header = "stamp,p1,p2,i1,i2"
    np.savetxt(tmp_path / "run.csv", table, delimiter=",", header=header, comments="")
    (tmp_path / "run.toml").write_text(
        'joint_names = ["a", "b"]\neffort_scale = [50.0, 50.0]\n'
        '[columns]\ntime = "stamp"\nposition = "p"\neffort = "i"\n'
        '[units]\ntime = "ms"\nposition = "deg"\neffort = "A"\n'
    )
    (tmp_path / "arm.urdf").write_text(ARM_URDF)
    result = sdpid.identify(
        tmp_path / "arm.urdf", tmp_path / "run.csv", effects="tilt,load", intervals=False
    )
    assert result.recipe is not None
    (tmp_path / "run.toml").unlink()
    recipe = Recipe.from_dict(json.loads(json.dumps(result.recipe.to_dict())))
    loaded = sdpid.load_robot(tmp_path / "arm.urdf", **recipe.robot.arguments)
    (reading,) = recipe.reading
    read = sdpid.read_recording(tmp_path / "run.csv", mapping=False, **(reading or {}))
    again = prepare_recordings(loaded, read, recipe.processing).samples
    samples = result.problem.samples
    for name in ("position", "velocity", "acceleration", "effort", "mask"):
        assert np.array_equal(getattr(again, name), getattr(samples, name))
    problem = sdpid.build_problem(
        loaded, again, friction=recipe.friction, weighting="residual", check_excitation=False
    )
    rows, first = problem.require_rows_here("test"), result.problem.require_rows_here("test")
    assert np.array_equal(rows.regressor(slice(None)), first.regressor(slice(None)))
    assert RobotRecipe.of(loaded) == recipe.robot
    kinds = [(each["role"], each["name"]) for each in result.inputs]
    assert kinds == [("log", "run.csv"), ("robot", "arm.urdf")]


def test_a_recording_in_memory_is_known_by_its_numbers(robot: sdpid.RobotModel) -> None:
    log = recorded(1)
    effort = np.array(log.effort)
    effort[7, 1] = np.nextafter(effort[7, 1], np.inf)
    assert recording_digest(log) == recording_digest(replace(log))
    assert recording_digest(log) != recording_digest(replace(log, effort=effort))
    assert recording_digest(log) != recording_digest(replace(log, joint_names=("b", "a")))
    result = sdpid.identify(robot, [log, recorded(2)], intervals=False, effects="none")
    assert [each["sha256"] for each in result.inputs[:2]] == [
        recording_digest(log),
        recording_digest(recorded(2)),
    ]
    assert result.recipe is not None
    assert result.recipe.reading == (None, None)


@dataclass(frozen=True)
class _Own(Coulomb):
    """A term that no file can hold."""


def test_a_term_of_ones_own_has_no_recipe_and_says_so(robot: sdpid.RobotModel) -> None:
    result = sdpid.identify(
        robot, recorded(1), friction=(_Own(), "viscous"), effects="none", intervals=False
    )
    assert result.recipe is None
    assert "_Own is a class of your own" in str(result.recipe_note)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("weighting", "none"),
        ("processing", {"cutoff_hz": 1.0}),
        ("friction", [{"term": "Own"}]),
        ("sigma", [[1.0, 2.0]]),
        ("robot", None),
        ("logs", [{"reading": None, "more": 1}]),
        ("more", 1),
    ],
)
def test_a_recipe_that_says_something_else_is_refused(key: str, value: Any) -> None:
    recipe = Recipe(
        robot=ROBOT,
        reading=(None,),
        processing=Processing(),
        without_effort=(),
        friction=(),
        weighting="gls",
        sigma=np.eye(2),
    )
    with pytest.raises(CertificateError, match="its recipe cannot be followed"):
        Recipe.from_dict({**recipe.to_dict(), key: value})


def test_recipes_from_before_friction_had_a_bound_of_its_own() -> None:
    stated = StatedProblem(
        consistency="pseudo_inertia", constraints=sdpid.Constraints(friction_max=1e4), prior=None
    )
    given = json.loads(json.dumps(stated.to_dict()))
    assert StatedProblem.from_dict(given) == stated
    del given["constraints"]["friction_max"]
    assert StatedProblem.from_dict(given).constraints == sdpid.Constraints()
