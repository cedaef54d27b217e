"""The verdict in lines: what is missed, the worst joint, what not to do, the next step."""

import ast
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sdpid
from sdpid.assurance.diagnostics.held_out import DESCRIPTION, hold_out
from sdpid.estimation.effects.tried import Tried
from sdpid.experiment.inspection.finding import Finding
from sdpid.output.report import verdict
from sdpid.output.report.headline import headline
from sdpid.output.report.verdict import findings
from sdpid.output.robots.urdf_errors import urdf_errors
from sdpid.workflow.result import Identification
from tests.helpers.identified import ARM, arm_theta, identified, moved
from tests.helpers.runs import arm, recorded

FIRST, LAST = ARM.joint_names


@pytest.fixture(scope="module")
def good() -> Identification:
    robot = replace(ARM, prior=1.1 * arm_theta()[:20].reshape(2, 10))
    return identified(moved(arm_theta(), 1), moved(arm_theta(), 2), robot=robot)


def test_other_motion_and_blocks_have_their_words(good: Identification) -> None:
    found = headline(good)
    assert "on recordings that were not fitted; the 95 % bands hold 9" in found.error
    assert found.step.startswith("none: use ")
    for words in ("your description", "friction fitted", "least squares", "this estimate"):
        assert words in found.baseline
    blocks = replace(good, validation=None, held_out=hold_out(good.estimate, good.wls, None))
    found = headline(blocks)
    assert "on 5 blocks held out in turn; other motion is not shown" in found.error
    assert "record another motion" in found.step
    nothing = headline(replace(blocks, held_out=None))
    assert "nothing could be held out" in nothing.error
    assert nothing.baseline is None
    assert nothing.lines[0].endswith("fitted, nothing else predicted")
    assert nothing.lines[1] == f"missed effort  {nothing.error}"


def test_an_estimate_that_costs_more_and_is_worse_is_not_to_be_used(good: Identification) -> None:
    held_out = good.held_out
    assert held_out.beaten_by is None
    swapped = {**held_out.baselines, "least squares": held_out.fit}
    worse = replace(held_out, fit=held_out.baselines["description as it is"], baselines=swapped)
    assert worse.beaten_by == "least squares"
    warnings = headline(replace(good, held_out=worse)).warnings
    assert "use it: least squares predicts better what was held out" in warnings


def test_a_file_that_misses_more_than_the_estimate_is_not_recommended(
    good: Identification,
) -> None:
    # Offsets of a fifth of the effort, for which a URDF has no place.
    found = headline(good)
    errors = urdf_errors(good.estimate, good.validation_samples)
    assert errors is not None
    assert f"in motion on the validation recordings it misses {errors}" in found.file
    assert any("do not use identified.urdf" in line for line in found.lines)
    assert (
        "the links of identified.urdf with identified_friction.py (.hpp) for its friction"
        in found.file
    )
    assert found.step.startswith("none: use estimate.model() or parameters.json")

    class Bias(sdpid.friction.Offset):
        """A term of one's own, whose code no file has."""

    friction = good.problem.friction
    kinds = tuple(
        Bias() if type(term) is sdpid.friction.Offset else term for term in friction.terms
    )
    own = replace(good.problem, friction=replace(friction, terms=kinds))
    advice = headline(replace(good, problem=own)).file
    assert "estimate.model()" in advice
    assert "identified_friction" not in advice
    theta = np.array(arm_theta())
    theta[[i for i, name in enumerate(good.estimate.named_theta()) if name.startswith("Fo")]] = 0.0
    without = headline(identified(moved(theta, 1), moved(theta, 2)))
    assert without.file is None
    assert without.step.startswith("none: use identified.urdf")


def test_the_worst_joint_its_cause_and_the_step(good: Identification) -> None:
    fresh = moved(arm_theta(), 2)
    effort = np.array(fresh.effort)
    a = fresh.acceleration[:, 1]
    effort[:, 1] += 0.5 * effort[:, 1].std() * a / a.std()
    held_out = hold_out(good.estimate, good.wls, replace(fresh, effort=effort))
    found = headline(replace(good, held_out=held_out))
    assert found.worst.startswith(f"{LAST}, error ")
    assert "goes with acceleration" in found.worst
    assert "rotor inertia" in found.step
    assert f"(for {LAST})" in found.step
    # What the choice of effects left out is not proposed again.
    tried = Tried(name="rotor_inertia", chosen=False, words="", fall=0.006, least_fall=0.05)
    problem = replace(good.problem, effects=(tried,))
    step = headline(replace(good, held_out=held_out, problem=problem)).step
    assert "--effects" not in step
    assert "rotor_inertia was tried and lowers the cost by 0.6 % alone" in step
    # What is wrong with the recording comes first.
    wrong = Finding(severity="refuse", kind="units", message="it is", remedy="mend the units")
    assert headline(replace(good, held_out=held_out, findings=(wrong,))).step == "mend the units"
    flipped = replace(wrong, kind="effort_sign", remedy="flip its sign", joint=LAST)
    step = headline(replace(good, held_out=held_out, findings=(flipped,))).step
    assert step == f"flip its sign (for {LAST})"


def test_a_cause_of_another_joint_than_the_worst_is_told_with_its_share(
    good: Identification,
) -> None:
    fresh = moved(arm_theta(), 2)
    effort, q = np.array(fresh.effort), fresh.position[:, 0]
    effort[:, 0] += 0.4 * effort[:, 0].std() * np.sin(q)
    noise = np.random.default_rng(0).standard_normal(len(effort))
    effort[:, 1] += 0.5 * effort[:, 1].std() * noise
    held_out = hold_out(good.estimate, good.wls, replace(fresh, effort=effort))
    found = headline(replace(good, held_out=held_out))
    assert found.worst.startswith(f"{LAST}, error ")
    assert "its shape shows no cause" in found.worst
    assert re.search(rf"\(for {FIRST}, [\d.]+ % of all joints' squared errors\)", found.step)


def test_friction_without_coulomb_or_viscous_terms_is_told(good: Identification) -> None:
    samples = moved(arm_theta(), 1)
    problem = sdpid.build_problem(ARM, samples, friction=("stribeck",), weighting="residual")
    result = identified(problem, moved(arm_theta(), 2))
    words = "No term describes Coulomb or viscous friction (terms: Stribeck)"
    assert any(text.startswith(words) for text in result.verdict)
    assert headline(result).step.startswith("let Coulomb and viscous friction in")
    assert not any("No term describes" in text for text in good.verdict)


def test_the_error_at_rest_stands_apart(good: Identification) -> None:
    fresh = moved(arm_theta(), 2)
    v = np.array(fresh.velocity)
    v[:200, 0] = 0.0
    effort = np.array(fresh.effort)
    effort[:200, 0] += 5.0
    held_out = hold_out(good.estimate, good.wls, replace(fresh, velocity=v, effort=effort))
    found = headline(replace(good, held_out=held_out))
    assert "% at rest (10 % of the rows)" in found.error
    words = [text for text in replace(good, held_out=held_out).verdict if "At rest" in text]
    assert len(words) == 1
    assert "stiction" in words[0]


def test_bands_that_hold_too_little_are_called_too_narrow(good: Identification) -> None:
    assert "too narrow" not in headline(good).error
    louder = hold_out(good.estimate, good.wls, moved(arm_theta(), 2, noise=0.06))
    assert "less than 90 %: they are too narrow" in headline(replace(good, held_out=louder)).error


def test_a_validation_at_rest_says_nothing_of_motion(good: Identification) -> None:
    fresh = moved(arm_theta(), 2)
    still = replace(fresh, velocity=0.0 * fresh.velocity)
    result = replace(good, held_out=hold_out(good.estimate, good.wls, still))
    found = headline(result)
    assert "in motion" not in found.error
    assert "% at rest" in found.error
    assert found.baseline is None
    assert "did not move" in found.worst
    assert f"record {FIRST} moving" in found.step
    words = " ".join(result.verdict)
    assert "Nothing moves on what was held out" in words
    assert "carries over" not in words


def test_every_red_box_of_the_report_is_a_line(good: Identification) -> None:
    wrong = Finding(severity="refuse", kind="units", message="it is in degrees", remedy="say so")
    flat = Finding(severity="warning", kind="frozen", message="it never changes", joint=LAST)
    resting = moved(arm_theta(), 2)
    held_out = replace(good.held_out, samples=resting, fit=good.held_out.baselines[DESCRIPTION])
    result = replace(good, held_out=held_out, findings=(wrong, flat))
    bad = [finding for finding in findings(result) if finding.level == "bad"]
    assert len(bad) >= 3
    said = headline(result)
    assert all(each.warning in said.warnings for each in bad)
    lines = [line for line in said.lines if line[15:] in said.warnings]
    assert len(lines) == len(said.warnings)
    assert [line.startswith("do not  ") for line in lines] == [True] + [False] * (len(lines) - 1)
    assert said.log == (wrong.line(), flat.line())
    assert not any(line.startswith("log") for line in headline(good).lines)


def test_bad_findings_say_what_not_to_do() -> None:
    """Every call that makes a bad finding gives a warning, read from the code."""
    made = 0
    for path in Path(verdict.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            call = isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Finding"
            if call and isinstance(node.args[0], ast.Constant) and node.args[0].value == "bad":
                made += 1
                assert len(node.args) == 3, f"{path.name}, line {node.lineno}: no warning"
    assert made >= 10


def test_least_squares_that_is_no_robot_is_told(good: Identification) -> None:
    assert "no robot" not in headline(good).baseline
    theta = good.wls.some_theta.copy()
    theta[:20] *= -1.0
    turned = replace(good, wls=replace(good.wls, base=good.problem.base_of(theta)))
    assert "no robot (M < 0 all along)" in headline(turned).baseline


def test_what_the_data_showed_is_told_with_how_to_leave_it_out(good: Identification) -> None:
    assert headline(good).found is None
    tilt = Tried(name="tilt", chosen=True, words="a tilted base lowers the cost by 17 %", fall=0.17)
    asked = Tried(name="load", chosen=True, words="friction of the load: asked for")
    problem = replace(good.problem, effects=(tilt, asked))
    found = headline(replace(good, problem=problem)).found
    assert found == "a tilted base lowers the cost by 17 % (--effects none leaves it out)"


def test_what_was_changed_about_the_log_is_told() -> None:
    pandas = pytest.importorskip("pandas")
    log = recorded(1)
    columns = {"time": np.rint(1e3 * log.time)}
    for j in (1, 0):
        columns[f"position_{arm().joint_names[j]}"] = np.degrees(log.position[:, j])
        columns[f"effort_{arm().joint_names[j]}"] = log.effort[:, j]
    read = sdpid.read_recording(pandas.DataFrame(columns), units={"position": "deg"})
    found = sdpid.identify(
        arm(), read, processing={"effort_delay_s": 0.004}, intervals=False, effects="none"
    )
    assert [line for line in found.headline.log if line.startswith("changed: ")] == [
        "changed: joints are taken in the robot's order, the columns are of b, a",
        "changed: time: time, taken for ms by the steps of its numbers",
        "changed: units: position in deg, converted",
        "changed: efforts recorded 4 ms too late: taken on time",
    ]
