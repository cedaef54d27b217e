"""Forged folders of results, held against the true log and the true robot: none is accepted.

Everybody who can write all files anew makes every digest right. Whatever checks a folder, these
have to be told by `sdpid.verify` and the command.
"""

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid._common.arrays import Array
from sdpid.constraints import TotalMass
from sdpid.errors import DataError, ModelError
from sdpid.estimation.constraints.equalities import Fixed
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem
from sdpid.experiment.recording.recording import Recording
from sdpid.output.robots import friction_files
from sdpid.output.robots.friction_files import WRITERS
from sdpid.output.tables.parameter_tables import base_table, theta_table
from sdpid.robot.model.base_parameters import kinematics_digest
from sdpid.workflow.certify_parameters import GivenParameters, certify_parameters, read_given
from sdpid.workflow.replay.compare import text_differences
from sdpid.workflow.verify import Verification
from tests.helpers import commands, world
from tests.helpers.arm_files import ARM_URDF, arm_log
from tests.helpers.data import make_samples, random_theta
from tests.helpers.forged import edit, edit_json, reseal, written
from tests.helpers.refusals import refuses
from tests.helpers.robots import LIFTED, small_arm
from tests.helpers.runs import arm, recorded

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
    result = sdpid.identify(folder / "arm.urdf", folder / "run.csv", **options)
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
    assert found.verdict.startswith("PROVEN, and what follows from the log MADE AGAIN")
    assert len([each for each in found.made_again if "of the logs are used" in each]) == 1


def test_parameters_far_from_the_optimum_are_not_proven(run: Path, results: Path) -> None:
    edit_json(results / "certificate.json", lambda data: data["claims"].update(gap=0.5))
    reseal(results)
    assert "more than 1e-06" in str(sdpid.verify(results).problems)


def test_settings_of_a_run_are_told_in_full(run: Path) -> None:
    options = {"effort_delay_s": 0.01, "shrinkage": 0.3, "trim_s": 0.5}
    processing = sdpid.Processing(cutoff_hz=8.0, decimation=None, covariance=None, **options)
    terms = (sdpid.friction.Coulomb(width=0.4), "viscous")
    results = identified(run, "told", processing=processing, friction=terms)
    told = "; ".join(verified(run, results).made_again)
    for words in ("shrinkage=0.3", "trim_s=0.5", "Coulomb(width=0.4", "0.95"):
        assert words in told


def test_a_file_beside_those_of_the_run_is_named(run: Path, results: Path) -> None:
    (results / "identified_v2.urdf").write_text("<robot/>")
    reseal(results)
    found = verified(run, results)
    assert any("identified_v2.urdf" in each for each in found.unchecked)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('xyz="0 0 1"', 'xyz="0 0 -1"'),
        ('xyz="0.4 0 0"', 'xyz="0.9 0 0"'),
        ('effort="100"', 'effort="1000"'),
    ],
)
def test_another_kinematics_in_urdf_and_manifest(
    run: Path, results: Path, old: str, new: str
) -> None:
    edit(results / URDF, lambda text: text.replace(old, new, 1))
    digest = kinematics_digest(sdpid.load_robot(results / URDF))
    recipe(results, lambda given: given["robot"].update(kinematics=digest))
    refused(run, results, URDF)


@pytest.mark.parametrize("turned", [True, False])
def test_a_recipe_without_kinematics(run: Path, results: Path, turned: bool) -> None:
    if turned:
        edit(results / URDF, lambda text: text.replace('xyz="0 0 1"', 'xyz="0 0 -1"'))
    recipe(results, lambda given: given["robot"].update(kinematics=None))
    refused(run, results, URDF if turned else "kinematics")


def behind(pattern: str, new: str, count: int = 0) -> Callable[[str], str]:
    """Return what replaces all that follows the only group of a pattern in it."""
    return lambda text: re.sub(pattern, rf"\g<1>{new}", text, count=count, flags=re.S)


URDF_FORGERIES = {
    "mass": behind(r'(name="upper".*?<mass value=")[^"]*', "1.5"),
    "turned": lambda text: text.replace('rpy="0 0 0"', 'rpy="0 0 1e-6"', 1),
    "last digits": behind(r'(<mass value="\d\.\d{8})\d', "", 1),
    "axes by a quaternion": lambda text: text.replace(
        'rpy="0 0 0"', 'rpy="0 0 0" quat_xyzw="1 0 0 0"'
    ),
    "a unit": lambda text: text.replace("<mass ", '<mass unit="g" '),
    "a shape in a body": lambda text: text.replace("</inertial>", "<density/></inertial>"),
    "a lower triangle": lambda text: text.replace("<inertia ", '<inertia iyx="1" '),
    "a version": lambda text: text.replace("<robot ", '<robot version="9" '),
    "two bodies": lambda text: text.replace("</inertial>", "</inertial><inertial/>"),
    "two axes": lambda text: text.replace("<axis ", '<axis xyz="0 1 0"/><axis ', 1),
    "two links of a name": lambda text: text.replace("</robot>", '<link name="upper"/></robot>'),
    "a link of another name": lambda text: text.replace('"upper"', '"upper_01"'),
    "a load": lambda text: text.replace("</robot>", f"{LOAD}</robot>"),
    "an entity": lambda text: '<!DOCTYPE robot [<!ENTITY m "1">]>' + text,
    "a macro": lambda text: text.replace("</robot>", "<xacro:x/></robot>"),
    "swapped": lambda text: swapped(text, "<inertial>.*?</inertial>"),
    "a comment": lambda text: text + "<!-- checked by hand -->",
    "another end of line": lambda text: text.replace("\n", "\r\n"),
    "nothing": lambda text: "",
}
LOAD = (
    '<link name="load"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" '
    'izz="1"/></inertial></link><joint name="f" type="fixed"><parent link="fore"/>'
    '<child link="load"/></joint>'
)
MJCF_FORGERIES = {
    "gravity": lambda text: re.sub('gravity="0.0 0.0 -', 'gravity="0.0 0.0 ', text),
    "axis": lambda text: text.replace('axis="0.0 0.0 1.0"', 'axis="0.0 0.0 -1.0"'),
    "place": behind('(name="fore" pos=")[^ ]*', "7.4"),
    "type": lambda text: text.replace('type="hinge"', 'type="slide"', 1),
    "range": lambda text: text.replace('range="-3.0 3.0"', 'range="-1.0 1.0"'),
    "mass of what is fixed": behind('(name="tool" .*?mass=")[^"]*', "0.5"),
    "mass": lambda text: re.sub(' mass="[^"]*', ' mass="1.5', text, count=1),
    "turned": behind(r'(<inertial [^>]*quat=")[^"]*', "1.0 0.0 0.0 0.0"),
    "a little turned": lambda text: turned(text),
    "a huge quaternion": behind(r'(<inertial [^>]*quat=")[^"]*', "1e12 0.0 0.0 0.0"),
    "an option": lambda text: text.replace("<compiler ", '<compiler settotalmass="9" '),
    "a shape": lambda text: text.replace("</body>", '<geom size="1"/></body>', 1),
    "swapped": lambda text: swapped(text, "<inertial.*?/>"),
}


def swapped(text: str, tag: str) -> str:
    """Return a text whose first two matches have changed places."""
    first, second = re.findall(tag, text, re.DOTALL)[:2]
    return text.replace(first, "@").replace(second, first).replace("@", second)


def turned(text: str) -> str:
    """Return a text with the axes of a body turned by 1e-4, behind a quaternion of 1e12."""
    found = re.search('<inertial [^>]*quat="([^"]*)"', text)
    w, x, y, z = map(float, found[1].split())
    half = 0.5e-4
    axes = np.array([w - half * x, x + half * w, y + half * z, z - half * y])
    long = " ".join(map(repr, (9e11 * axes / np.linalg.norm(axes)).tolist()))
    return text.replace(found[1], long, 1)


def test_the_same_axes_by_another_quaternion(run: Path, results: Path) -> None:
    """Another processor may find them in another order: that is no forgery."""
    pytest.importorskip("mujoco")

    def other(match: re.Match[str]) -> str:
        w, x, y, z = (float(each) for each in match[2].split())
        # Turned by half a turn about its first axis.
        return f"{match[1]}{-x!r} {w!r} {z!r} {-y!r}"

    edit(results / MJCF, lambda text: re.sub('(<inertial [^>]*quat=")([^"]*)', other, text))
    reseal(results)
    assert verified(run, results).passed


RESULT_FORGERIES = {
    "a cost": behind(r'("cost": )[^,]*', "300.0"),
    "a gap": lambda t: re.sub(r'"gap": [^,]*', '"gap": 0.0', t),
    "another certificate": behind(r'("certificate": ")[0-9a-f]{8}', "00000000"),
    "no errors": behind(r'("relative_residual": )[^,]*', "0.0"),
}
PARAMETERS_FORGERIES = {
    "a proven cost": behind(r'("cost_at_most": \d+\.\d{4})\d', "0"),
    "a base parameter": behind(r'("base": \{\s*"\w+": \{\s*"value": )[^,]*', "1.25"),
    "another robot": lambda t: t.replace('"robot": "arm"', '"robot": "leg"'),
    "another order": lambda t: json.dumps(
        {**json.loads(t), "standard": dict(reversed(json.loads(t)["standard"].items()))}
    ),
    "an interval": behind(r'("interval": \[\s*)[^,]*', "-9.0", 1),
    "a share": behind('("data": )[^,]*', "1.0", 1),
}
TABLE_FORGERIES = {
    "a cell": behind("(m_2,kg,)[^,]*", "0.5"),
    "a unit": lambda t: t.replace("m_2,kg,", "m_2,g,"),
    "another spelling": behind("(m_2,kg,[^,]*)", "_0"),
    "a space": lambda t: t.replace("m_2,kg,", "m_2,kg, "),
    **{
        f"odd cell {k}": lambda t, cell=cell: t.replace("\n", f"\n{cell},", 1)
        for k, cell in enumerate(('"', "\0", "1_0.5", "\u0661", "nan", "x" * 200_000))
    },
}
BASE_FORGERIES = {
    "a standard error": behind("(zzr1,[^,]*,[^,]*,)[^,]*", "0.0"),
    "a missing row": lambda t: "\n".join(t.splitlines()[:-1]) + "\n",
}
CODE_FORGERIES = {
    "number": lambda t: re.sub(r"(\d)( \* )", lambda m: str(9 - int(m[1])) + m[2], t, count=1),
    "comment": lambda t: t.replace("made by a program", "checked by hand"),
    "end": lambda t: f"{t} ",
    "twice": lambda t: t + t,
    "lines": lambda t: t.replace("\n", "\r\n"),
}
# Each file is held against what follows from the log by itself, so one forgery of each file is
# told in one reading of the log.
FORGERIES: dict[str, dict[str, Callable[[str], str]]] = {
    URDF: URDF_FORGERIES,
    **({MJCF: MJCF_FORGERIES} if find_spec("mujoco") else {}),
    "result.json": RESULT_FORGERIES,
    "parameters.json": PARAMETERS_FORGERIES,
    "parameters.csv": TABLE_FORGERIES,
    "base_parameters.csv": BASE_FORGERIES,
    **dict.fromkeys(FRICTION, CODE_FORGERIES),
}


@pytest.mark.parametrize("number", range(max(map(len, FORGERIES.values()))))
def test_every_forged_file_is_told(run: Path, results: Path, number: int) -> None:
    forged = {name: list(kinds)[number] for name, kinds in FORGERIES.items() if number < len(kinds)}
    for name, kind in forged.items():
        edit(results / name, FORGERIES[name][kind])
    reseal(results)
    told = [each.partition(": ")[0] for each in verified(run, results).problems]
    missed = {name: kind for name, kind in forged.items() if not any(name in t for t in told)}
    assert not missed, told


def earlier(data: Any) -> None:
    """Make a certificate one of version 5."""
    data.update(version=5, compression={"relative": 1e-9, "absolute": 1e-9})
    data["origin"]["contacts"] = None


def test_a_folder_of_before_is_made_again_but_for_intervals(run: Path, results: Path) -> None:
    """Its recipe does not say which numbers the data chose; one of this version has to."""
    recipe(results, lambda given: given.pop("profiled"))
    edit(results / "parameters.csv", behind("(m_2,kg,[^,]*,)[^,]*", "-9.0"))
    refused(run, results, "parameters.csv")
    edit_json(results / "certificate.json", earlier)
    digest = reseal(results)
    for name in ("parameters.json", "result.json", *FRICTION):
        edit(results / name, behind(r"(certificate\W+)[0-9a-f]{64}", digest))
    reseal(results)
    found = verified(run, results)
    assert all("identified_friction" in each for each in found.problems), found.problems
    said = "intervals: the recipe does not say which numbers of terms the data chose"
    assert any(said in each for each in found.log.unchecked)


@pytest.mark.parametrize(
    "names",
    [(URDF, MJCF, "parameters.json", "parameters.csv", "result.json"), ("certificate.json",)],
)
def test_files_of_another_run(run: Path, results: Path, names: tuple[str, ...]) -> None:
    for name in names:
        shutil.copy(sharp(run) / name, results / name)
    reseal(results)
    problems = verified(run, results).problems
    for name in names:
        assert any(Path(name).stem in each for each in problems), problems


@pytest.mark.parametrize("name", [URDF, MJCF, "parameters.csv"])
def test_a_file_that_is_not_sealed_is_none_of_the_run(run: Path, results: Path, name: str) -> None:
    """A swapped file that neither manifest nor result.json names any more is not passed over."""

    def forget(data: Any) -> None:
        data["exports"] = [each for each in data["exports"] if each["file"] != name]

    edit_json(results / "result.json", forget)
    edit(results / name, lambda text: re.sub("([1-9])", lambda m: str(10 - int(m[1])), text))
    reseal(results, without=name)
    assert any(name in each for each in sdpid.verify(results).problems)


def write_friction(results: Path, change: Callable[[Any], object]) -> None:
    """Change the numbers of both files of friction, and write their code anew."""
    for name in FRICTION:
        text = (results / name).read_text()
        (line,) = (each for each in text.splitlines() if MARK in each)
        data = json.loads(line.partition(MARK)[2])
        change(data)
        (results / name).write_text(WRITERS[Path(name).suffix](data))


def without_friction(kind: str) -> Callable[[Any], None]:
    """Return a change of the term with such numbers: they are huge."""

    def change(data: Any) -> None:
        (term,) = (each for each in data["terms"] if kind in each)
        term[kind] = [1e9] * len(data["joints"])

    return change


def better(data: Any) -> None:
    assert data["held_out"]["by"] == "blocks"
    data["held_out"]["this estimate"]["moving"]["relative_residual"] *= 0.9


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("certificate.json", lambda d: d["origin"].update(loss="huber"), "loss of the certificate"),
        ("result.json", better, "result.json: 'held_out this estimate'"),
        ("friction", lambda data: data["terms"].pop(), "identified_friction"),
        ("friction", lambda data: data["terms"].append(data["terms"][0]), "identified_friction"),
        ("friction", lambda data: data.update(robot="another"), "identified_friction"),
        ("friction", lambda data: data.update(certificate="0" * 64), "identified_friction"),
        ("friction", lambda data: data["joints"].reverse(), "identified_friction"),
        ("friction", lambda data: data["left_out"].append("Tilt"), "identified_friction"),
        ("friction", without_friction("width"), "identified_friction"),
        ("friction", without_friction("velocity"), "identified_friction"),
    ],
)
def test_other_numbers(
    run: Path, results: Path, name: str, change: Callable[[Any], object], words: str
) -> None:
    if name == "friction":
        write_friction(results, change)
    else:
        edit_json(results / name, change)
    refused(run, results, words)


def test_friction_of_a_writer_that_is_wrong(
    run: Path, results: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The check is not the writer: it computes friction by the terms of the recipe."""
    sign = friction_files.sign
    monkeypatch.setattr(friction_files, "sign", lambda *args: f"-{sign(*args)}")
    write_friction(results, lambda data: None)
    refused(run, results, "identified_friction")


@pytest.mark.parametrize("friction", ["default", ("coulomb", "viscous")])
def test_damping_whatever_result_json_says(run: Path, results: Path, friction: Any) -> None:
    if friction != "default":
        shutil.rmtree(results)
        shutil.copytree(sharp(run), results)

    def fitted(data: Any) -> None:
        for export in data["exports"]:
            export["friction_fitted"] = True

    edit_json(results / "result.json", fitted)
    names = [name for name in (URDF, MJCF) if (results / name).exists()]
    for name in names:
        edit(results / name, lambda text: re.sub('damping="[^"]*"', 'damping="1e9"', text, count=1))
    reseal(results)
    problems = verified(run, results).problems
    for name in names:
        assert any(re.search(f"{name}.*damping", each) for each in problems), problems


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
    assert any("single masses" in each for each in honest.lines)
    estimate = result.estimate
    theta = np.array(estimate.theta)
    # Mass of the first link on its own axis moves nothing.
    theta[0] += 3.0
    moved = replace(estimate, theta=theta)
    assert np.allclose(result.problem.base_of(theta), estimate.base, atol=1e-9)
    forged = replace(result, estimate=moved, certificate=sdpid.certify(moved))
    forged.save(tmp_path / "forged", figures=False)
    refused(run, tmp_path / "forged", "nearest to the description")


def test_masses_within_the_gap(run: Path, tmp_path: Path) -> None:
    """With a prior, too: a gap of 1e-6 leaves single masses some room, which nobody needs."""
    result = sdpid.identify(run / "arm.urdf", run / "run.csv", intervals=False)
    estimate, step = result.estimate, 0.02
    while True:
        theta = np.array(estimate.theta)
        theta[0] += step
        certificate = sdpid.certify(moved := replace(estimate, theta=theta))
        if certificate.gap <= 1e-6:
            break
        step *= 0.7
    assert step > 1e-3
    forged = replace(result, estimate=moved, certificate=certificate)
    forged.save(tmp_path / "forged", figures=False)
    refused(run, tmp_path / "forged", "not those of least cost")


def test_a_profile_interval_is_compared_with_its_width(run: Path, tmp_path: Path) -> None:
    results = identified(run, str(tmp_path / "profile"), intervals="profile", effects="none")
    assert verified(run, results).passed

    def narrower(data: Any) -> None:
        ends = data["standard"]["m_2"]["interval"]
        ends[0] += 0.03 * (ends[1] - ends[0])

    edit_json(results / "parameters.json", narrower)
    refused(run, results, "parameters.json: .*interval.* made again")


def test_how_a_log_is_read_is_told_in_full(run: Path, tmp_path: Path) -> None:
    """What stands behind the first 200 characters could scale the rows."""
    header, rest = (run / "run.csv").read_text().split("\n", 1)
    names = [f"{name}_{'x' * 120}" for name in header.split(",")]
    (tmp_path / "long.csv").write_text(f"{','.join(names)}\n{rest}")
    columns = {"time": names[0], "position": names[1:3], "effort": names[3:5]}
    log = sdpid.read_recording(tmp_path / "long.csv", columns=columns)
    sdpid.identify(run / "arm.urdf", log, intervals=False).save(tmp_path / "r", figures=False)
    found = sdpid.verify(tmp_path / "r", data=tmp_path / "long.csv", robot=run / "arm.urdf")
    assert any(names[4] in each for each in found.made_again)


@pytest.mark.parametrize(
    ("written", "other"),
    [
        ('<mass value="2.5e-06"/>', '<mass value="2.5001e-06"/>'),
        ('<inertia ixx="2.5e-10" ixy="1e-25"/>', '<inertia ixx="2.5001e-10" ixy="1e-25"/>'),
        ('<dynamics damping="2.5e-07"/>', '<dynamics damping="2.6e-07"/>'),
    ],
)
def test_small_bodies_are_compared_in_their_own_size(written: str, other: str) -> None:
    assert list(text_differences(other, written))
    # Rounding of what is nothing beside the rest of a tensor is no difference.
    assert not list(text_differences(written.replace("1e-25", "-2e-25"), written))


def test_white_space_and_quotes_of_tags_are_those_of_a_writer() -> None:
    """Folders of an earlier version are proven: what wrote their robots kept these as they were."""
    written = '<?xml version="1.0"?><a b="1.5 x" c="y"><d e="2"/></a><!-- "f" -->'
    same = "<?xml version='1.0'?>\n<a  b = '1.5 x'\n c=\"y\" >\n\t<d e='2' /></a><!-- \"f\" -->"
    assert not list(text_differences(same, written))
    for one, other in (
        ('"1.5 x"', '"1.5  x"'),
        ("<d ", "\r\n<d "),
        ('"f"', "'f'"),
        ("><d", ">g<d"),
    ):
        assert list(text_differences(written.replace(one, other), written))
    (told,) = text_differences(same.replace("'2'", "'3.5'"), same.replace("'2'", "'2.5'"))
    assert told == "line 4 ('e') has '3.5', written again '2.5'"


def test_two_results_must_be_results() -> None:
    refuses(DataError, "3: is no folder", sdpid.compare, 3, 4)


def test_bounds_of_ones_own(run: Path, tmp_path: Path) -> None:
    """A certificate of other bounds, whose recipe does not state what was asked."""
    heavy = sdpid.Constraints(mass_min=20.0, mass_max=40.0, others=(TotalMass(50.0),))
    results = identified(run, str(tmp_path / "heavy"), constraints=heavy, prior=False)
    found = verified(run, results)
    assert found.passed, found.problems
    said = " ".join(found.lines)
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
    options = {"constraints": free, "processing": {"trim_s": 8.0}, "effects": "none"}
    results = identified(run, str(tmp_path / "free"), **options)
    said = " ".join(verified(run, results).made_again)
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
    found = sdpid.identify(robot, run / "run.csv", intervals=False)
    found.save(tmp_path / "results", figures=False)
    found = sdpid.verify(tmp_path / "results", data=run / "run.csv", robot=macro)
    assert found.passed, found.problems
    assert any("reach" in each and "0.4" in each for each in found.made_again)


# An effort that ruins the parameters of other joints is found by the fit without it.


ROBOT = sdpid.load_robot(LIFTED)
T = np.arange(0.0, 15.0, 0.02)
# Without an offset nothing but masses can make the effort of a lift small.
OPTIONS = {"friction": ("coulomb", "viscous"), "effects": "none", "intervals": False}


def recorded_with_gain(seed: int, gain: float) -> Recording:
    """Return a recording whose lift has an effort in another unit, with a drive's own noise."""
    rng = np.random.default_rng(seed)
    rate, phase = rng.uniform(1.0, 4.0, (2, 3, ROBOT.n))
    size = np.array([0.02, 0.6, 0.6, 0.6])
    angle = rate * T[:, None, None] + phase
    q, v, a = ((size * rate**k * np.sin(angle + k * np.pi / 2.0)).sum(axis=1) for k in range(3))
    bodies = ROBOT.prior * rng.uniform(0.85, 1.15, (ROBOT.n_links, 1))
    effort = ROBOT.inverse_dynamics(bodies, q, v, a) + np.sign(v) * [5.0, 1.0, 0.5, 0.2] + 0.3 * v
    effort += rng.standard_normal(effort.shape) * [1.0, 0.1, 0.05, 0.02]
    effort[:, 0] = gain * effort[:, 0] + 0.2 * np.sin(0.7 * T)
    return Recording(time=T, position=q, velocity=v, effort=effort, joint_names=ROBOT.joint_names)


@pytest.mark.parametrize("seed", range(2))
def test_the_effort_that_spoils_the_others_is_left_out(seed: int) -> None:
    wrong, right = recorded_with_gain(seed, 0.02), recorded_with_gain(seed, 1.0)
    accepted = ("effort_scale", "effort_small")
    result = sdpid.identify(ROBOT, wrong, accept=accepted, **OPTIONS)
    finding = result.findings[0]
    assert (finding.kind, finding.joint) == ("effort_spoils", "lift")
    assert str(finding) in result.notes
    assert result.problem.samples.used.any(axis=0).tolist() == [False, True, True, True]
    used = sdpid.identify(ROBOT, wrong, accept=(*accepted, finding.kind), **OPTIONS)
    # The arm is predicted as it is where the lift is left out by hand, and many times better.
    byhand = sdpid.identify(ROBOT, right, without_effort=("lift",), **OPTIONS)
    assert np.allclose(result.training.rmse[1:], byhand.training.rmse[1:], rtol=1e-3)
    assert np.all(used.training.rmse[1:3] > 1.2 * result.training.rmse[1:3])
    better = "use it: least squares predicts better what was held out"
    assert better in used.headline.warnings
    assert any("--without-effort lift" in line for line in used.headline.lines)


def test_a_sound_recording_loses_nothing() -> None:
    result = sdpid.identify(ROBOT, recorded_with_gain(0, 1.0), **OPTIONS)
    assert not [each for each in result.findings if each.kind == "effort_spoils"]
    assert result.problem.samples.used.any(axis=0).all()


# The default estimate finds the friction that a clean log was simulated with.


COULOMB, VISCOUS = np.array([3.0, 2.0]), np.array([2.5, 2.0])


def simulated(width: float) -> sdpid.Recording:
    """Return a log whose friction has a sign of this width (rad/s)."""
    rng = np.random.default_rng(1)
    robot = arm()
    time = np.arange(3000) / 100.0
    omega = 2.0 * np.pi * rng.uniform(0.04, 0.5, (6, robot.n))
    waves = np.exp(1j * (time[:, None, None] * omega + rng.uniform(0.0, 6.0, omega.shape)))
    q, v, a = (np.real(0.25 * waves * (1j * omega) ** k).sum(axis=1) for k in range(3))
    sign = np.tanh(v / width) if width else np.sign(v)
    effort = robot.inverse_dynamics(robot.prior, q, v, a) + COULOMB * sign + VISCOUS * v
    noise = 0.02 * rng.standard_normal(q.shape)
    return sdpid.Recording(time=time, position=q, effort=effort + noise)


@pytest.mark.parametrize("width", [0.0, 0.01, 0.05])
def test_friction_curves_are_right_whatever_the_width_of_the_sign(width: float) -> None:
    estimate = sdpid.identify(arm(), simulated(width), intervals=False).estimate
    friction = estimate.problem.friction
    for speed in (0.1, 0.3, 1.0):
        v = np.full((1, 2), speed)
        curve = [friction.columns(s * v, 0.0 * v)[0] for s in (1.0, -1.0)]
        tail = estimate.theta[-len(friction.parameters) :]
        found = 0.5 * (curve[0] - curve[1]) @ tail
        sign = np.tanh(speed / width) if width else 1.0
        np.testing.assert_allclose(found, COULOMB * sign + VISCOUS * speed, rtol=0.005)


# Parameters that were found elsewhere, judged against the proven optimum.


# Costs of two programs with the same optimum agree to this.
SAME = 1e-6


@cache
def solved_arm() -> tuple[Problem, Array, Estimate]:
    """Return a problem, the parameters that made its data, and its optimum."""
    robot = small_arm(2)
    samples, theta = world.samples(robot, 7, noise=0.1)
    constraints = sdpid.Constraints(margin=1e-4)
    problem = sdpid.build_problem(robot, samples, constraints=constraints)
    return problem, theta, sdpid.solve_sdp(problem)


def named(problem: Problem, theta: Array) -> dict[str, float]:
    return dict(zip(problem.base.theta_names, theta.tolist(), strict=True))


def given(values: dict[str, float], **more: Any) -> GivenParameters:
    return GivenParameters(source="other.csv", values=values, **more)


def test_the_optimum_itself_is_certified(tmp_path: Path) -> None:
    problem, _, best = solved_arm()
    assert best.theta is not None
    found = certify_parameters(problem, given(named(problem, best.theta)))
    assert found.feasible is True
    assert found.violations == ()
    assert found.certificate.passed
    assert 0.0 <= found.gap <= 1e-6
    assert "feasible: every constraint holds" in found.summary()
    found.certificate.to_json(tmp_path / "proof.json")
    assert sdpid.verify(tmp_path / "proof.json").passed


def test_worse_parameters_state_their_own_gap(tmp_path: Path) -> None:
    problem, theta, best = solved_arm()
    found = certify_parameters(problem, given(named(problem, 1.2 * theta)))
    assert found.feasible is True
    assert found.cost == pytest.approx(problem.cost_of(1.2 * theta), rel=1e-9)
    assert found.gap == pytest.approx(1.0 - best.cost / found.cost, rel=SAME)
    assert found.residuals["given"] > found.residuals["optimum"]
    checked = sdpid.verify(written(found.certificate.to_dict(), tmp_path))
    assert checked.passed
    assert checked.gap == found.gap


def test_broken_constraints_are_named_with_number_and_limit(tmp_path: Path) -> None:
    problem, theta, _ = solved_arm()
    broken = named(problem, theta)
    broken["m_1"] = -2.0
    broken["zz_2"] = -3.0
    broken["Fs1"] = -0.5
    found = certify_parameters(problem, given(broken))
    assert found.feasible is False
    words = " ".join(found.violations)
    first, second = problem.robot.link_names
    assert f"mass of {first} at least" in words
    assert "is -2 kg" in words
    assert f"consistency of {second}: margin" in words
    assert "at least 0.0001" in words
    assert "Fs1 at least 0: is -0.5" in words
    assert found.summary().splitlines()[1].startswith("not feasible: ")
    # The bound is proven all the same, and the file says what is not.
    checked = sdpid.verify(written(found.certificate.to_dict(), tmp_path))
    assert not checked.passed
    assert any(f"cost less than {found.certificate.lower_bound!r}" in s for s in checked.statements)


def test_parameters_below_the_bound_are_infeasible_and_said_to_be() -> None:
    problem = solved_arm()[0]
    wide = problem.constraints.replace(margin=0.5)
    problem = sdpid.build_problem(problem.robot, problem.samples, constraints=wide)
    wls = sdpid.solve_wls(problem)
    found = certify_parameters(problem, given(named(problem, wls.some_theta)))
    assert found.feasible is False
    assert found.gap < 0.0
    assert "below the bound" in found.summary()


def test_friction_that_is_not_given_is_the_best_beside_the_links() -> None:
    problem, theta, _ = solved_arm()
    links = 10 * problem.robot.n_links
    rigid = dict(list(named(problem, 1.3 * theta).items())[:links])
    found = certify_parameters(problem, given({**rigid, "Fv2": 0.7}))
    assert found.refitted == ("Fs1", "Fs2", "Fv1")
    assert found.estimate.theta is not None
    values = named(problem, found.estimate.theta)
    assert values["Fv2"] == 0.7
    assert {name: values[name] for name in rigid} == rigid
    fixed = problem.constraints.replace(others=(Fixed({**rigid, "Fv2": 0.7}),))
    same = sdpid.build_problem(problem.robot, problem.samples, constraints=fixed)
    assert found.cost == pytest.approx(sdpid.solve_sdp(same).cost, rel=SAME)
    assert "friction refitted with the links held: Fs1, Fs2, Fv1" in found.summary()


def test_refitted_friction_obeys_its_signs() -> None:
    problem, theta, _ = solved_arm()
    reversed_ = replace(problem.samples, effort=-problem.samples.effort)
    against = sdpid.build_problem(problem.robot, reversed_, constraints=problem.constraints)
    rigid = dict(list(named(problem, theta).items())[: 10 * problem.robot.n_links])
    found = certify_parameters(against, given(rigid))
    assert found.feasible is True
    friction = found.estimate.theta[10 * problem.robot.n_links :]
    assert (friction >= 0.0).all()
    assert friction.max() < 1e-9


@pytest.mark.parametrize("lacks", [(), ("Fs1", "Fv2")])
def test_base_parameters_are_compared_and_audited(lacks: tuple[str, ...]) -> None:
    problem, _, best = solved_arm()
    own = {name: x for name, x in best.named().items() if name not in lacks}
    found = certify_parameters(problem, given(own))
    assert found.refitted == lacks
    assert found.feasible is not False
    assert abs(found.gap) <= SAME
    assert found.audit is not None
    assert found.certificate.theta is None
    impossible = {**own, "zz2": -1.0} if "zz2" in own else {**own, "zzr2": -1.0}
    found = certify_parameters(problem, given(impossible))
    assert found.feasible is False
    assert "bodies that have these base parameters: not realisable: " in found.summary()


def test_base_parameters_are_compared_without_a_prior() -> None:
    rng = np.random.default_rng(3)
    robot = replace(small_arm(2), prior=random_theta(small_arm(2), rng)[:20].reshape(2, 10))
    samples = make_samples(robot, random_theta(robot, rng), rng, noise=0.1)
    problem = sdpid.build_problem(robot, samples, prior=sdpid.Prior())
    best = sdpid.solve_sdp(problem)
    found = certify_parameters(problem, given(best.named()))
    assert found.estimate.problem.prior is None
    assert found.cost == pytest.approx(problem.cost(best.base), rel=1e-9)
    whole = certify_parameters(problem, given(named(problem, np.array(best.theta))))
    assert whole.estimate.problem.prior is not None
    assert "of it for the prior" in whole.summary()
    assert {"given", "optimum", "unconstrained", "description"} == set(whole.residuals)


def test_names_must_be_the_problems_and_complete() -> None:
    problem, theta, _ = solved_arm()
    values = named(problem, theta)
    with pytest.raises(DataError, match=r"no parameters Ia1; .*--friction"):
        certify_parameters(problem, given({**values, "Ia1": 0.1}))
    del values["xy_2"]
    with pytest.raises(DataError, match=r"without xy_2\) nor all \d+ base parameters \(without"):
        certify_parameters(problem, given(values))


@pytest.mark.parametrize("wrong", [1e13, -1e300, 5e-324, float("inf"), float("nan")])
def test_numbers_that_no_robot_has_are_refused(wrong: float) -> None:
    problem, theta, _ = solved_arm()
    with pytest.raises(DataError, match=r"other.csv: zz_2 is .*no robot has"):
        certify_parameters(problem, given({**named(problem, theta), "zz_2": wrong}))


# -------------------------------------------------------------------- files


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "arm.urdf").write_text(ARM_URDF)
    t, q, tau = arm_log(tmp_path / "arm.urdf")
    np.savez(tmp_path / "log.npz", t=t, q=q, tau=tau)
    return tmp_path


def test_every_format_is_read_alike(folder: Path) -> None:
    problem, _, best = solved_arm()
    sdpid.write_parameters(best, folder / "p.json")
    sdpid.write_parameters(best, folder / "p.yaml")
    theta_table(best).write(folder / "p.csv")
    expected = best.named_theta()
    assert expected is not None
    for name in ("p.json", "p.yaml", "p.csv"):
        read = read_given(folder / name, problem.robot)
        assert read.values == pytest.approx(expected, rel=1e-12)
        assert read.standard(problem)
    base_table(best).write(folder / "base.csv")
    read = read_given(folder / "base.csv", problem.robot)
    assert read.values == pytest.approx(best.named(), rel=1e-12)
    assert not read.standard(problem)


def test_descriptions_must_have_the_same_joints(folder: Path) -> None:
    robot = sdpid.load_robot(folder / "arm.urdf")
    read = read_given(folder / "arm.urdf", robot)
    links = [read.values[name] for name in robot.parameter_names]
    assert np.array_equal(links, robot.prior.ravel())
    (folder / "moved.urdf").write_text(ARM_URDF.replace('xyz="0.4 0 0"', 'xyz="0.5 0 0"'))
    refuses(ModelError, "joint b is elsewhere", read_given, folder / "moved.urdf", robot)
    refuses(ModelError, "same robot", read_given, folder / "arm.urdf", small_arm(3))


def test_command(folder: Path) -> None:
    log, robot, out = folder / "log.npz", folder / "arm.urdf", folder / "results"
    commands.ran("identify", log, "--robot", robot, "--out", out, "--no-figures")
    proof = folder / "proof.json"
    config = ("--config", out / "run.toml")
    told = commands.printed("certify", out / "parameters.json", *config, "--certificate", proof)
    assert "feasible: every constraint holds (proven)" in told
    commands.ran("verify", proof)
    told = commands.printed("certify", robot, "--log", log, "--robot", robot, "--json")
    assert '"feasible": true' in told
    rows = [line.split(",")[:3] for line in (out / "parameters.csv").read_text().splitlines()]
    broken = [[*row[:2], "-1"] if row[0] == "m_2" else row for row in rows]
    (folder / "broken.csv").write_text("\n".join(map(",".join, broken)) + "\n")
    assert "not feasible: " in commands.printed("certify", folder / "broken.csv", *config, status=3)
    for wrong in (
        ("certify", out / "run.toml", *config),
        ("certify", folder / "missing.json", *config),
        ("certify", out / "parameters.json", *config, "--certificate", out / "parameters.json"),
        ("certify", out / "parameters.json", *config, "--certificate", folder / "no" / "p.json"),
    ):
        commands.refused(commands.run(*wrong), 2)
    (folder / "odd.toml").write_text("colour = 3\n")
    done = commands.run("certify", out / "parameters.json", "--config", folder / "odd.toml")
    commands.refused(done, 2, "no option of 'sdpid certify'")
