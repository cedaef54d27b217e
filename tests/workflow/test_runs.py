"""What is done with runs and their results: refitted friction, draws, effects, and a comparison."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid.assurance.intervals.delta_method import joint_curve
from sdpid.errors import DataError
from sdpid.estimation.effects.kinds import names_of_effects
from sdpid.output.report.report import report_html
from sdpid.workflow.formulate import formulate
from sdpid.workflow.result import WRITTEN, Identification
from sdpid.workflow.runs import RunComparison, compare_runs
from sdpid.workflow.sample import ParameterSamples
from tests.helpers import world
from tests.helpers.arm_files import ARM_URDF
from tests.helpers.commands import printed
from tests.helpers.forged import edit_json, set_to
from tests.helpers.identified import ARM, arm_theta, identified, moved
from tests.helpers.refusals import refuses
from tests.helpers.robots import small_arm
from tests.helpers.runs import arm, recorded

LINKS = 20


def test_only_friction_moves_and_the_result_is_proven() -> None:
    result = world.result()
    first, warm = result.estimate, recorded(2, damping=0.8)
    adapted = sdpid.adapt(first, warm)
    np.testing.assert_array_equal(adapted.theta[:LINKS], first.theta[:LINKS])
    for estimate, damping in ((first, 0.4), (adapted, 0.8)):
        found = estimate.named_theta()
        assert [found["Fv1"], found["Fv2"]] == pytest.approx([damping] * 2, abs=0.05)
    assert sdpid.certify(adapted).passed
    samples = adapted.problem.samples
    before, after = (sdpid.validate(each, samples).relative for each in (first, adapted))
    assert after < 0.5 * before
    refuses(DataError, "no standard parameters", sdpid.adapt, result.wls, warm)


def test_rotors_and_gravity_stay_too() -> None:
    first = world.result(3, effects=("rotor_inertia", "tilt")).estimate
    old, new = first.named_theta(), sdpid.adapt(first, recorded(4)).named_theta()
    for name in ("Gx", "Gy", "Ia1", "Ia2"):
        assert new[name] == old[name]


# Draws of an estimate as a user has them.


COUNT = 20


@pytest.fixture(scope="module")
def result() -> Identification:
    return identified(moved(arm_theta(), 1))


@pytest.fixture(scope="module")
def samples(result: Identification) -> ParameterSamples:
    return sdpid.sample_parameters(result, COUNT, 0)


def test_draws_are_feasible_and_the_same_by_a_seed(
    result: Identification, samples: ParameterSamples
) -> None:
    problem = result.problem
    assert len(samples) == COUNT
    assert samples.theta.shape == (COUNT, problem.n_theta)
    assert all(problem.feasible.violation(theta) == 0.0 for theta in samples.theta)
    assert np.allclose(samples.base, samples.theta @ problem.base.matrix.T)
    assert not samples.theta.flags.writeable
    assert repr(samples).startswith("ParameterSamples(robot='arm2', draws=20, seed=0, ")
    shown = samples._repr_html_()
    assert "split R-hat" in shown
    assert "zzr1" in shown
    assert samples.to_frame().shape == (COUNT, 26)
    assert [*samples.to_frame().columns] == [*problem.base.theta_names]
    q, v, a = np.full((3, 2), 0.3)
    for model, theta in zip(samples.models(), samples.theta, strict=True):
        own = result.estimate.of_theta(problem, theta, method="given", status="given")
        assert np.allclose(model.inverse_dynamics(q, v, a), own.model().inverse_dynamics(q, v, a))
    for of, seed in ((result.estimate, 0), (result.certificate, 0), (result.estimate, 1)):
        again = sdpid.sample_parameters(of, COUNT, seed)
        assert np.array_equal(again.theta, samples.theta) == (seed == 0)


def test_ranges_and_files_say_what_they_are_of(samples: ParameterSamples, tmp_path: Path) -> None:
    ranges = samples.ranges(0.5)
    assert ranges.probability == 0.5
    made = ranges.to_dict()["made"]
    assert (made["robot"], made["seed"]) == ("arm2", 0)
    assert len(made["certificate"]) == len(made["parameters_sha256"]) == 64
    files = samples.save(tmp_path, ("mjcf",))
    assert len(files) == COUNT + 4
    assert all(path.is_file() for path in files)


@pytest.mark.parametrize(
    ("n", "seed", "words"),
    [
        (0, 0, "n: is 0; give a whole number from 1 to 1000000"),
        (10**9, 0, "give a whole number from 1 to 1000000"),
        (True, 0, "n: is True"),
        (2.5, 0, "n: is 2.5"),
        ("ten", 0, "n: is 'ten'"),
        (5, -1, "seed: is -1; give a whole number from 0 on"),
        (5, None, "seed: is None"),
    ],
)
def test_numbers_that_are_none(result: Identification, n: Any, seed: Any, words: str) -> None:
    refuses(DataError, words, sdpid.sample_parameters, result, n, seed)
    words = "estimate: is str; give what solve_sdp or identify"
    refuses(DataError, words, sdpid.sample_parameters, "arm", n, seed)


@pytest.mark.parametrize("probability", [0.0, 1.0, -1, 2, float("nan"), True, "half", None])
def test_shares_that_are_none(samples: ParameterSamples, probability: Any, tmp_path: Path) -> None:
    words = "give a probability between 0 and 1"
    refuses(DataError, words, samples.ranges, probability)
    refuses(DataError, words, samples.save, tmp_path, probability=probability)


def test_a_robot_without_friction(tmp_path: Path) -> None:
    samples = moved(arm_theta(), 1, seconds=4.0)
    estimate = sdpid.solve_sdp(sdpid.build_problem(ARM, samples, friction=(), weighting="residual"))
    sdpid.sample_parameters(estimate, 2).save(tmp_path)
    assert sdpid.audit_urdf(tmp_path / "robot_0002.urdf").passed
    curve = joint_curve(estimate, 0)
    assert not np.any([curve.effort, curve.lower, curve.upper])


# The option of effects, and where the choice is told.


def test_the_option_of_effects() -> None:
    for effects, names in (
        ("auto", None),
        ("none", ()),
        ("tilt", ("tilt",)),
        (["load", "falling"], ("load", "falling")),
        ("tilt, load", ("tilt", "load")),
    ):
        assert names_of_effects(effects) == names
    for effects in (["tilt", "wind"], "tilt,wind"):
        refuses(DataError, r"'wind'.*tilt, load, rotor_inertia", names_of_effects, effects)


@pytest.mark.parametrize("options", [{}, {"consistency": "none"}, {"prior": False}])
def test_an_arm_without_effects_gets_none(options: dict[str, Any]) -> None:
    problem = formulate(arm(), recorded(1), **options)
    assert problem.origin.effects
    assert not any(each.chosen for each in problem.origin.effects)
    # Costs that are no likelihood choose nothing.
    for others in ({"effects": "none"}, {"weighting": "eq9"}):
        plain = formulate(arm(), recorded(1), **{**options, **others})
        assert plain.origin.effects == ()
    plain = formulate(arm(), recorded(1), **{**options, "effects": "none"})
    assert plain.base.names == problem.base.names


def test_files_say_what_was_asked_and_what_was_left_out(tmp_path: Path) -> None:
    # Effects that the data do not show stand in the notes, with their numbers.
    result, free = world.result(effects="tilt,load"), world.result()
    page = report_html(result)
    assert "Tilt (Gx, Gy)" in page
    assert "LoadFriction (Fl1, Fl2; width 0.005" in page
    assert "bodies (" not in page
    assert [each["name"] for each in result.to_dict()["problem"]["effects"]] == ["tilt", "load"]
    file = sdpid.write_parameters(result.estimate, tmp_path / "parameters.json")
    told = {each["name"]: each for each in json.loads(file.read_text())["effects"]}
    assert told["tilt"]["chosen"]
    degrees = np.degrees(result.estimate.named_theta()["Gx"])
    assert f"{degrees:.2f}° about x" in told["tilt"]["words"]
    assert all("would lower the cost by" in each.words for each in free.effects)
    for found in (result, free):
        assert {each.words for each in found.effects} <= {*found.notes}


# Two results folders against each other, from their files alone.


BELIEF = sdpid.Prior(bodies=1.2 * arm_theta()[:20].reshape(2, 10))
PROCESSING = {"cutoff_hz": 10.0, "order": 2}
SEALED = ("result.json", "parameters.json", "manifest.json")


def saved(folder: Path, seed: int, *, log: str, heavier: float = 1.0, **options: Any) -> Path:
    """Save a run whose manifest names a log by a letter; one link may be heavier."""
    theta = arm_theta()
    theta[10:20] *= heavier
    result: Identification = identified(moved(theta, seed), **options)
    intervals = sdpid.confidence_intervals(result.estimate, method="gauss_markov")
    entry = {"role": "log", "name": f"{log}.csv", "bytes": 1, "sha256": log * 64}
    replace(result, intervals=intervals, inputs=(entry,)).save(folder, figures=False)
    edit_json(folder / "manifest.json", set_to({"processing": PROCESSING}, "recipe"))
    return folder


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    base = tmp_path_factory.mktemp("runs")
    return {
        "first": saved(base / "first", 1, log="a"),
        "again": saved(base / "again", 1, log="a", prior=BELIEF),
        "other": saved(base / "other", 2, log="b"),
        "heavier": saved(base / "heavier", 2, log="b", heavier=1.2),
    }


def changed(run: Path, target: Path, name: str, change: Any) -> Path:
    """Copy a run and change one of its files."""
    shutil.copytree(run, target, dirs_exist_ok=True)
    edit_json(target / name, change)
    return target


def test_a_robot_against_itself_and_against_a_heavier_one(runs: dict[str, Path]) -> None:
    found = compare_runs(runs["first"], runs["other"])
    assert found.same_log is False
    assert len(found.parameters.rows) > 10
    # Of 14 parameters 0.7 are expected outside.
    assert len(found.outside) <= 3
    apart = compare_runs(runs["first"], runs["heavier"])
    assert {"mx2", "my2"} <= set(apart.outside)
    assert "Fv1" not in apart.outside
    assert "about 0.7 would by chance" in apart.text()


def test_runs_of_one_log_are_told_by_what_differs(runs: dict[str, Path]) -> None:
    found = compare_runs(runs["first"], runs["again"])
    assert found.same_log is True
    held = json.loads((runs["first"] / "result.json").read_text())["held_out"]["this estimate"]
    error = 100.0 * held["moving"]["relative_residual"]
    assert ("error of this estimate, %", error) in [row[:2] for row in found.differences.rows]
    assert found.outside == ()
    assert "not independent" in found.text()
    assert ("prior", "False", "True") in found.differences.rows
    assert ("weighting", "residual", "residual") in found.facts.rows
    assert not compare_runs(runs["first"], runs["first"]).differences.rows


def test_options_of_what_is_written_are_no_difference(
    runs: dict[str, Path], tmp_path: Path
) -> None:
    folders = [tmp_path / name for name in ("here", "there")]
    for folder, value in zip(folders, ("false", "true"), strict=True):
        shutil.copytree(runs["first"], folder)
        lines = [f"{name} = {value}" for name in (*WRITTEN, "rollout")]
        (folder / "run.toml").write_text("\n".join(lines))
    rows = compare_runs(*folders).differences.rows
    assert rows == (("option rollout", "False", "True"),)


def test_a_result_is_loaded_from_its_folder_alone(tmp_path: Path) -> None:
    made = sdpid.identify(sdpid.load_robot(ARM_URDF), recorded(1), effects="tilt", intervals=True)
    made.save(tmp_path / "there", offsets=True)
    (tmp_path / "there").rename(tmp_path / "here")
    found = sdpid.load(tmp_path / "here")
    own, model = made.model(), found.model()
    assert model.terms.terms == own.terms.terms
    np.testing.assert_array_equal(model.theta, own.theta)
    states = np.random.default_rng(0).standard_normal((3, 5, 2))
    want = own.inverse_dynamics(*states)
    np.testing.assert_allclose(model.inverse_dynamics(*states), want, rtol=0, atol=1e-12)
    assert found.headline["error"] == made.headline.error
    frame, intervals = found.to_frame(), made.intervals
    assert intervals is not None
    assert list(frame.index) == list(made.problem.base.names)
    assert frame.loc["Fv1", "upper"] == intervals.upper[intervals.names.index("Fv1")]
    assert {"Gx", "m_1"} <= set(found.to_frame("standard").index)
    assert found.plot() is not None
    assert "certified=True" in repr(found)
    # Its tilted URDF has the robot's kinematics, and its MJCF is written again with offsets.
    assert (tmp_path / "here" / "identified.xml").read_text().count("<general ") == 2
    checked = sdpid.verify(tmp_path / "here", data=recorded(1))
    assert checked.passed, checked.problems
    assert any("identified.urdf, identified.xml: written again" in x for x in checked.made_again)
    # The file of MuJoCo has the same kinematics.
    (tmp_path / "here" / "identified.urdf").unlink()
    again = sdpid.load(tmp_path / "here").model()
    np.testing.assert_allclose(again.inverse_dynamics(*states), want, rtol=0, atol=1e-9)
    # In memory and in a folder it is one result.
    both = sdpid.compare(made, tmp_path / "here")
    assert both.folders == ("first", str(tmp_path / "here"))
    assert both.same_log is True
    assert not both.differences.rows
    np.testing.assert_array_equal([row[4] for row in both.parameters.rows], 0.0)
    (tmp_path / "here" / "identified.xml").unlink()
    with pytest.raises(DataError, match=r"has no identified\.urdf and no identified\.xml, so"):
        sdpid.load(tmp_path / "here").model()
    (tmp_path / "here" / "manifest.json").unlink()
    refuses(DataError, r"has no recipe in its manifest\.json", sdpid.load(tmp_path / "here").model)
    refuses(DataError, "a problem alone, or two results", sdpid.compare, made)
    refuses(DataError, "a problem alone, or two results", sdpid.compare, made.problem, made)


def test_a_folder_without_a_manifest_is_compared(runs: dict[str, Path], tmp_path: Path) -> None:
    bare = shutil.copytree(runs["first"], tmp_path / "bare")
    (bare / "manifest.json").unlink()
    unknown = compare_runs(bare, runs["other"])
    assert (unknown.same_log, unknown.outside) == (None, ())
    assert "no manifest" in unknown.text()


def test_what_is_called_the_same_must_be_the_same(runs: dict[str, Path], tmp_path: Path) -> None:
    def other(content: dict[str, Any]) -> None:
        content["base"]["my2"]["expression"] = "my_2 + 3*mx_2"
        del content["base"]["mx2"]

    def against(change: Any) -> RunComparison:
        path = changed(runs["other"], tmp_path / "x", "parameters.json", change)
        return compare_runs(runs["first"], path)

    found = against(other)
    assert not {"my2", "mx2"} & {row[0] for row in found.parameters.rows}
    assert "In the first alone, or regrouped: mx2, my2." in found.notes
    assert "In the other alone, or regrouped: my2." in found.notes
    level = against(lambda c: c.update(interval_level=0.5))
    assert "two kinds, or there are none (gauss_markov at 0.95 and gauss_markov" in level.text()
    without = against(lambda c: c.update(interval_method=None, interval_level=None))
    assert "(gauss_markov at 0.95 and none at None)" in without.text()


@pytest.mark.parametrize("name", SEALED)
def test_damaged_files_are_refused_in_words(
    name: str, runs: dict[str, Path], tmp_path: Path
) -> None:
    first = runs["first"]
    broken = shutil.copytree(first, tmp_path / "x")
    intact = (first / name).read_text()
    content = json.loads(intact)
    texts = ["", "[]", "{}", intact[: len(intact) // 2], intact.replace('"', '"\\u202e', 1)]
    for key in content:
        texts += [json.dumps({**content, key: value}) for value in (None, [1], "x", {"y": {}})]
    refused = []
    for text in texts:
        (broken / name).write_text(text)
        try:
            compare_runs(first, broken).text()
        except DataError as error:
            refused.append(str(error))
    assert len(refused) >= 5
    assert all(str(broken) in each for each in refused)


def test_folders_that_are_none(runs: dict[str, Path], tmp_path: Path) -> None:
    joints = list(small_arm(3).joint_names)
    change = set_to(joints, "problem", "joints")
    alien = changed(runs["first"], tmp_path / "x", "result.json", change)
    words = r"has no result\.json and no parameters\.json"
    refuses(DataError, "is no folder", compare_runs, tmp_path / "no", runs["first"])
    refuses(DataError, words, compare_runs, runs["first"], tmp_path)
    refuses(DataError, "3: is no folder", sdpid.compare, 3, 4)
    refuses(DataError, "compare runs of one robot", compare_runs, runs["first"], alien)


def test_the_command(runs: dict[str, Path], tmp_path: Path) -> None:
    pair = runs["first"], runs["heavier"]
    short, full = printed("compare-runs", *pair), printed("compare-runs", *pair, "-v")
    assert " mx2 " in short
    assert "by chance" in short
    for told in (" Fv1 ", "weighting"):
        assert told in full
        assert told not in short
    alike = printed("compare-runs", pair[0], runs["again"])
    assert "base parameters that differ\n  nothing" in alike
    assert "are not tested" in alike
    data = json.loads(printed("compare-runs", *pair, "--json"))
    assert data["same_log"] is False
    assert {row["parameter"] for row in data["parameters"]} >= {"mx2", "Fs1"}
    printed("compare-runs", pair[0], tmp_path, status=2)
    found = compare_runs(*pair)
    assert repr(found).startswith("RunComparison(same log=False, ")
    assert "<table>" in found._repr_html_()
