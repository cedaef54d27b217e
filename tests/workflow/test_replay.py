"""From the log to the files of a folder: what is made again, what is not, and what was forged.

Everybody who can write all files of a folder anew makes every digest right. Whatever checks one,
forgeries have to be told by `sdpid.verify` and the command.
"""

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sdpid
from sdpid import Processing, constraints
from sdpid.assurance.recipe.inputs import recording_digest
from sdpid.assurance.recipe.recipe import Recipe, RobotRecipe
from sdpid.assurance.recipe.stated import StatedProblem
from sdpid.errors import CertificateError, DataError, MissingExtraError, ModelError
from sdpid.output.robots import friction_files
from sdpid.output.robots.friction_files import WRITERS
from sdpid.robot.friction.terms import Coulomb
from sdpid.robot.model.base_parameters import kinematics_digest
from sdpid.workflow.replay import replay as module
from sdpid.workflow.replay.compare import distance, text_differences
from sdpid.workflow.replay.replay import Replay, replay
from sdpid.workflow.verify import Verification
from tests.helpers import world
from tests.helpers.arm_files import ARM_URDF
from tests.helpers.forged import edit, edit_json, reseal, set_to
from tests.helpers.logs import numbered, write_csv
from tests.helpers.refusals import refuses
from tests.helpers.runs import arm, recorded
from tests.helpers.strategies import friction_terms_of, reals

URDF, MJCF = "identified.urdf", "identified.xml"
FRICTION = ("identified_friction.py", "identified_friction.hpp")
MARK = "sdpid-friction: "
LINKS = ("log", "robot", "samples", "problem", "base parameters", "weights", "rows")
SAME, OTHER = "made again", "not made again"
BOX = constraints.CenterOfMassInBox("fore", (-np.inf, -0.2, -0.2), (0.5, 0.2, np.inf))
MASS = constraints.TotalMass(4.9, tolerance=0.5)
HULL = constraints.CenterOfMassInHull("fore", [*0.5 * np.eye(3), (-0.5, -0.5, -0.5)])

HEADER = "t,q_a,q_b,tau_a,tau_b"

Change = Callable[[Any], Any]


class OfYourOwn(constraints.Condition):
    """A condition of a class that no file can hold."""

    def compile(self, layout: constraints.Layout) -> list[constraints.Row]:
        """Return a row that says little."""
        return [constraints.Row("light", np.eye(layout.count)[0], 0.0, 99.0)]


def identified(folder: Path, name: str | Path, **options: Any) -> Path:
    """Write the results of a run, and return the folder that they are in."""
    return saved(sdpid.identify(folder / "arm.urdf", folder / "run.csv", **options), folder / name)


def saved(result: Any, folder: Path) -> Path:
    result.save(folder, figures=False)
    return folder


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


def write_log(path: Path, log: sdpid.Recording) -> Path:
    """Write a recording as text, every digit of it."""
    return write_csv(path, HEADER.split(","), log.time, log.position, log.effort)


@pytest.fixture
def results(run: Path, tmp_path: Path) -> Path:
    """A copy of the results of the run by default."""
    return Path(shutil.copytree(run / "results", tmp_path / "results"))


def verified(run: Path, results: Path) -> Verification:
    """Hold results against the true log and the true robot."""
    return sdpid.verify(results, data=run / "run.csv", robot=run / "arm.urdf")


def refused(run: Path, results: Path, *words: str) -> None:
    """Require that results are not proven once they are sealed again, for reasons in words."""
    reseal(results)
    found = verified(run, results)
    assert not found.passed
    for each in words:
        assert any(re.search(each, problem) for problem in found.problems), found.problems


def states(proof: Replay) -> dict[str, str]:
    """Return the state of each link; what is not made again wins."""
    order = (SAME, "not checked", OTHER)
    links = sorted(proof.links, key=lambda link: order.index(link.state))
    return {link.name: link.state for link in links}


def wrong(proof: Replay) -> list[str]:
    return [f"{each.name}: {each.text}" for each in proof.links if each.state == OTHER]


def text_of(proof: Replay, name: str) -> str:
    """Return what is said of the one link of a name."""
    (text,) = (link.text for link in proof.links if link.name == name)
    return text


# ---- Honest folders.


def test_everything_is_made_again(run: Path, results: Path) -> None:
    proof = replay(run / "results", [run / "run.csv"], robot=run / "arm.urdf")
    assert tuple(link.name for link in proof.links)[: len(LINKS)] == LINKS
    named = {name for link in proof.links for name in link.name.split(", ")}
    written = {path.name for path in (run / "results").iterdir()}
    assert written - named == {"certificate.json", "manifest.json", "report.html"}
    assert {*states(proof).values()} == {SAME}, wrong(proof)
    assert proof.distance <= 1e-12
    certificate = json.loads((run / "results" / "certificate.json").read_text())
    assert proof.gap == pytest.approx(certificate["claims"]["gap"], abs=1e-11)
    assert "number for number those of the run" in text_of(proof, "samples")
    assert "has the SHA-256 of the manifest" in text_of(proof, "robot")
    assert "the defaults for this robot" in text_of(proof, "problem")
    assert "towards the description's bodies" in text_of(proof, "problem")
    # Without it what is written from a file of the folder is compared with that file.
    proof = replay(run / "results", run / "run.csv")
    assert wrong(proof) == []
    assert states(proof)[URDF] == "not checked"
    # Sealed again, it is proven; what no run wrote is named.
    (results / "identified_v2.urdf").write_text("<robot/>")
    reseal(results)
    found = verified(run, results)
    assert found.passed, found.problems
    assert found.verdict.startswith("PROVEN, and what follows from the log MADE AGAIN")
    assert len([each for each in found.made_again if "of the logs are used" in each]) == 1
    assert any("identified_v2.urdf" in each for each in found.unchecked)


@pytest.mark.parametrize(
    ("options", "unchecked"),
    [
        ({"without_effort": ("a",)}, {URDF}),
        ({"prior": False}, {URDF, "choice"}),
        ({"accept": ("effort_scale",)}, {URDF, MJCF}),
    ],
    ids=("effort", "prior", "tool"),
)
def test_what_the_description_alone_can_show(
    options: dict[str, Any], unchecked: set[str], tmp_path: Path
) -> None:
    """Without it nothing is said to be wrong: of no prior, of a tool that a link took over."""
    robot, log = tmp_path / "arm.urdf", recorded(1)
    heavy = '<mass value="6.0"/>' if "accept" in options else '<mass value="0.4"/>'
    robot.write_text(ARM_URDF.replace('<mass value="0.4"/>', heavy))
    result = sdpid.identify(robot, log, intervals=False, effects="none", **options)
    proof = replay(saved(result, tmp_path / "results"), log)
    assert {name for name, state in states(proof).items() if state != SAME} == unchecked
    assert {*states(replay(tmp_path / "results", log, robot=robot)).values()} == {SAME}


def test_what_differs_from_the_defaults_is_told_in_full(run: Path, tmp_path: Path) -> None:
    more = {"effort_delay_s": 0.01, "shrinkage": 0.3, "trim_s": 8.0}
    free = sdpid.Constraints.of_size(sdpid.load_robot(ARM_URDF), friction_nonnegative=False)
    results = identified(
        run,
        tmp_path / "told",
        processing=Processing(cutoff_hz=8.0, decimation=None, covariance=None, **more),
        friction=(Coulomb(width=0.4), "viscous"),
        constraints=free,
        effects="none",
    )
    told = " ".join(verified(run, results).made_again)
    for words in (
        "shrinkage=0.3",
        "trim_s=8.0",
        "Coulomb(width=0.4",
        "0.95",
        "friction may be negative",
        "of the 1000 samples of the log",
        "gravity is taken to be (0, 0, -9.81) m/s²",
    ):
        assert words in told


def test_how_a_log_is_read_is_told_in_full(run: Path, tmp_path: Path) -> None:
    """What stands behind the first 200 characters could scale the rows."""
    header, rest = (run / "run.csv").read_text().split("\n", 1)
    names = [f"{name}_{'x' * 120}" for name in header.split(",")]
    (long := tmp_path / "long.csv").write_text(f"{','.join(names)}\n{rest}")
    columns = {"time": names[0], "position": names[1:3], "effort": names[3:5]}
    log = sdpid.read_recording(long, columns=columns)
    results = saved(sdpid.identify(run / "arm.urdf", log, intervals=False), tmp_path / "r")
    found = sdpid.verify(results, data=long, robot=run / "arm.urdf")
    assert any(names[4] in each for each in found.made_again)


def test_arguments_of_macros_are_said(run: Path, tmp_path: Path) -> None:
    pytest.importorskip("xacro")
    macro = tmp_path / "arm.urdf.xacro"
    argument = '<xacro:arg name="reach" default="0.1"/>'
    head = f'<robot name="arm" xmlns:xacro="http://ros.org/wiki/xacro">{argument}'
    text = ARM_URDF.replace('<robot name="arm">', head)
    macro.write_text(text.replace('xyz="0.4 0 0"', 'xyz="$(arg reach) 0 0"'))
    robot = sdpid.load_robot(macro, xacro_args={"reach": "0.4"})
    results = saved(sdpid.identify(robot, run / "run.csv", intervals=False), tmp_path / "results")
    found = sdpid.verify(results, data=run / "run.csv", robot=macro)
    assert found.passed, found.problems
    assert any("reach" in each and "0.4" in each for each in found.made_again)


def test_a_real_log(data_folder: Path, tmp_path: Path) -> None:
    robot, log = (data_folder / "ur10_unisa" / name for name in ("ur10.urdf", "ur10_exciting.npz"))
    result = sdpid.identify(robot, log, effects="none", intervals=False)
    proof = replay(saved(result, tmp_path / "results"), log, robot=robot)
    assert {*states(proof).values()} == {SAME}, wrong(proof)
    assert proof.gap < 1e-6


@pytest.mark.parametrize(
    ("options", "state"),
    [
        ({"prior": sdpid.Prior(kind="entropic", strength="evidence")}, SAME),
        ({"consistency": "spatial_inertia", "prior": False}, SAME),
        (
            {"constraints": sdpid.Constraints(others=constraints.TotalMass(4.9, tolerance=0.5))},
            SAME,
        ),
        ({"constraints": sdpid.Constraints(others=BOX)}, SAME),
        ({"constraints": sdpid.Constraints(others=HULL)}, SAME),
        ({"constraints": sdpid.Constraints(others=OfYourOwn())}, OTHER),
    ],
)
def test_what_was_asked_of_the_parameters(
    tmp_path: Path, options: dict[str, Any], state: str
) -> None:
    result = world.result(effects="none", **options)
    proof = replay(saved(result, tmp_path / "results"), recorded(1), robot=arm())
    assert (wrong(proof) == []) == (state == SAME), wrong(proof)
    assert states(proof)["problem"] == state


@pytest.mark.parametrize("weighting", ["gls", "gls_per_sample", "eq18"])
def test_a_recording_in_memory_with_periods(tmp_path: Path, weighting: Any) -> None:
    log, other = (recorded(seed, seconds=40.0, period=5.0) for seed in (3, 4))
    options = {"prior": False, "intervals": False, "effects": "none"}
    folder = saved(sdpid.identify(arm(), log, weighting=weighting, **options), tmp_path / "results")
    proof = replay(folder, log)
    assert wrong(proof) == []
    assert "the recording in memory has the SHA-256 of the manifest" in proof.links[0].text
    assert states(replay(folder, other))["log"] == OTHER


# ---- Other logs and other robots.


def test_other_logs_are_named(run: Path, tmp_path: Path) -> None:
    lines = (run / "run.csv").read_text().splitlines()
    fields = lines[200].split(",")
    fields[3] = fields[3][:6] + ("1" if fields[3][6] != "1" else "2") + fields[3][7:]
    lines[200] = ",".join(fields)
    (tmp_path / "run.csv").write_text("\n".join(lines) + "\n")
    for log, least, most in (
        (tmp_path / "run.csv", 1e-6, 1e-2),
        (write_log(tmp_path / "other.csv", recorded(2)), 0.1, np.inf),
    ):
        proof = replay(run / "results", log)
        assert states(proof)["log"] == states(proof)["rows"] == OTHER
        assert f"'{log.name}' has the SHA-256" in proof.links[0].text
        # By one digit the rows are others, too, if only a little.
        assert least < proof.distance < most
        assert proof.gap is None


def test_several_logs_have_an_order(tmp_path: Path) -> None:
    logs = [write_log(tmp_path / f"{k}.csv", recorded(k, seconds=14.0)) for k in (1, 2)]
    (tmp_path / "arm.urdf").write_text(ARM_URDF)
    result = sdpid.identify(tmp_path / "arm.urdf", logs, intervals=False, effects="none")
    folder = saved(result, tmp_path / "results")
    assert wrong(replay(folder, logs)) == []
    proof = replay(folder, logs[::-1])
    assert [link.state for link in proof.links[:2]] == [OTHER, OTHER]
    assert "'2.csv' has the SHA-256" in proof.links[0].text
    assert "it is log 2 of the run, not log 1" in proof.links[0].text
    proof = replay(folder, logs[0])
    assert proof.links[0].text == "1 are given, the result is of 2: '1.csv', '2.csv'"


def test_other_robots_are_named(run: Path, tmp_path: Path) -> None:
    other = tmp_path / "arm.urdf"
    other.write_text(ARM_URDF.replace('xyz="0.4 0 0"', 'xyz="0.41 0 0"'))
    proof = replay(run / "results", run / "run.csv", robot=other)
    assert states(proof)["robot"] == states(proof)["rows"] == OTHER
    assert "is another robot: SHA-256" in proof.links[1].text
    # With other inertias it has the same rows.
    other.write_text(ARM_URDF.replace('<mass value="3.0"/>', '<mass value="4.0"/>'))
    proof = replay(run / "results", run / "run.csv", robot=other)
    assert not [each for each in wrong(proof) if "identified." not in each]
    assert "number for number" in proof.links[1].text


def test_macros_in_a_folder_are_not_run(
    run: Path, results: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    macro = '<xacro:property xmlns:xacro="http://ros.org/wiki/xacro" name="a" value="${1 + 1}"/>'
    edit(results / URDF, lambda text: text.replace("</robot>", f"{macro}</robot>"))
    name = "sdpid.robot.description.xml.run_in_sandbox"
    monkeypatch.setattr(name, lambda *_, **__: pytest.fail("was run"))
    assert states(replay(results, run / "run.csv"))["robot"] == OTHER


def test_bad_input_is_no_finding(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    results, log = run / "results", run / "run.csv"
    refuses(DataError, "there is no such file", replay, results, run / "missing.csv")
    refuses(DataError, "format", replay, results, run / "arm.urdf")
    refuses(DataError, "is given int, expected the path", replay, results, 3)
    refuses(ModelError, "no robot 'nobody'", replay, results, log, robot="nobody")
    refuses(CertificateError, "is no folder", replay, log, log)
    lacking = Mock(side_effect=MissingExtraError("h5py is not installed"))
    monkeypatch.setattr(module, "read_recording", lacking)
    refuses(MissingExtraError, "h5py", replay, results, log)


# ---- Certificates and recipes that were edited.


def edit_of(results: Path, path: str, change: Change) -> Path:
    """Edit one value of certificate or manifest, such as ``manifest.recipe.sigma.0.0``."""
    first, *keys = path.split(".")

    def apply(place: Any) -> None:
        *way, last = (int(key) if key.lstrip("-").isdigit() else key for key in keys)
        for key in way:
            place = place[key]
        place[last] = change(place[last] if isinstance(place, list) else place.get(last))

    edit_json(results / f"{first}.json", apply)
    return results


def test_rows_of_someone_else(run: Path, results: Path) -> None:
    """Bad parameters are made optimal, of other rows, with all hashes right."""

    def forge(certificate: Any) -> None:
        problem, theta = certificate["problem"], np.array(certificate["theta"])
        A, B = np.array(problem["A"]), np.array(problem["base_matrix"])
        moved = A @ (B @ (1.3 * theta))
        residual = moved - np.array(problem["rhs"])
        problem["floor"] += float(residual @ residual)
        problem["rhs"], certificate["theta"] = moved.tolist(), (1.3 * theta).tolist()
        dual, floor = certificate["multipliers"], problem["floor"]
        for name in ("y", "Z", "rows"):
            dual[name] = np.zeros_like(np.array(dual[name])).tolist()
        dual["W"] = None
        certificate["claims"].update(cost=1.1 * floor, lower_bound=0.9 * floor)

    edit_json(results / "certificate.json", forge)
    assert states(replay(results, run / "run.csv"))["rows"] == OTHER


def with_bodies(bodies: list[list[float]]) -> Change:
    """Return a change of any term to a tilt of some bodies."""
    return lambda _: {"term": "Tilt", "bodies": bodies}


@pytest.mark.parametrize(
    ("link", "path", "change"),
    [
        ("rows", "certificate.problem.A.3.3", lambda x: x * (1 + 1e-5)),
        ("rows", "certificate.problem.rhs.2", lambda x: x + 1e-3),
        ("rows", "certificate.problem.floor", lambda x: x * 1.01),
        ("base parameters", "certificate.problem.base_matrix.0.1", lambda x: x + 1e-3),
        ("base parameters", "certificate.origin.links.0", lambda x: x + "_2"),
        ("base parameters", "certificate.origin.weighting", lambda _: "gls"),
        ("rows", "manifest.recipe.processing.cutoff_hz", lambda x: 1.001 * x),
        ("weights", "manifest.recipe.sigma.0.0", lambda x: 1.1 * x),
        ("rows", "manifest.recipe.friction.1.velocity.0", lambda x: 1.01 * x),
        ("samples", "manifest.recipe.without_effort", lambda _: ["a"]),
        ("samples", "manifest.recipe.without_effort", lambda _: ["\x1b[2K"]),
        # First moments without a mass have no center: their columns are no numbers.
        ("problem", "manifest.recipe.friction.1", with_bodies([[0.0, *[1.0] * 9]] * 2)),
        ("problem", "certificate.problem.prior_matrix.0.0", lambda _: 1e308),
        ("robot", "manifest.recipe.robot.gravity.2", lambda x: x + 0.01),
        ("problem", "certificate.problem.upper.0", lambda x: 2.0 * x),
        ("problem", "certificate.problem.margin", lambda _: 1e-6),
        ("problem", "certificate.problem.prior_rhs.0", lambda x: x + 1e-3),
        ("problem", "manifest.recipe.problem.constraints.mass_max", lambda x: x + 1.0),
        ("problem", "manifest.recipe.problem.prior.strength", lambda _: 1.1),
        ("problem", "manifest.recipe.problem.prior", lambda _: None),
        ("problem", "manifest.recipe.problem.consistency", lambda _: "none"),
        ("log", "manifest.inputs.0.bytes", lambda x: x + 1),
        ("log", "manifest.inputs.0.sha256", lambda x: ("1" if x[0] == "0" else "0") + x[1:]),
    ],
)
def test_what_was_forged_is_named(
    run: Path, results: Path, link: str, path: str, change: Change
) -> None:
    proof = replay(edit_of(results, path, change), run / "run.csv")
    assert states(proof)[link] == OTHER
    assert all(each.text.isprintable() for each in proof.links)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("", None, "has no recipe"),
        (".logs", [], "names 1 logs and how 0 are read"),
        (".logs.0.reading", {"path": "x"}, "'path'"),
        (".robot.source", 3, "source of the robot is 3"),
        (".logs.0.reading", {"units": 3}, "units is 3"),
        (".problem.constraints", {}, "constraints are {}"),
        (".problem.prior.kind", "x", "kind is 'x'"),
        (".robot.xacro_args", [1], "xacro_args of the robot"),
        (".robot.gravity.0", 1e300, "gravity is"),
        (".sigma.0.1", 1e-9, "sigma is not symmetric"),
        (".without_effort", "a", "expected a list of names"),
        (".friction.1", with_bodies([[1.0] * 9])(0), "a body is"),
        (".friction.1", with_bodies([[1e308] * 10])(0), "a body is"),
    ],
)
def test_a_folder_that_cannot_be_followed_is_refused(
    run: Path, results: Path, path: str, value: Any, message: str
) -> None:
    edit_of(results, f"manifest.recipe{path}", lambda _: value)
    refuses((CertificateError, DataError), message, replay, results, run / "run.csv")
    edit_of(results, "manifest.inputs", lambda _: 3)
    refuses(CertificateError, "inputs is no list", replay, results, run / "run.csv")


@pytest.fixture(scope="module")
def alike(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a result that believes in a mirror image and in friction that is alike."""
    pair = constraints.MirrorPair("upper", "fore", reflection=np.diag([1.0, -1.0, 1.0, 1.0]))
    prior = sdpid.Prior(alike=(pair,), within=0.5)
    limits = sdpid.Constraints(others=(constraints.EqualFriction("a", "b", within=0.3),))
    result = world.result(effects="none", prior=prior, constraints=limits)
    assert "mirror images of each other within 50 %: upper and fore" in result.summary()
    folder = saved(result, tmp_path_factory.mktemp("alike") / "results")
    proof = replay(folder, recorded(1), robot=arm())
    assert wrong(proof) == []
    assert "within 50 %" in text_of(proof, "problem")
    assert "conditions: 1 EqualFriction" in text_of(proof, "problem")
    return folder


@pytest.mark.parametrize(
    ("path", "change"),
    [
        ("certificate.problem.prior_matrix.-1.0", lambda x: x + 1e-3),
        ("manifest.recipe.problem.prior.within", lambda _: 0.06),
        ("manifest.recipe.problem.prior.alike.0.reflection.0.3", lambda x: x + 1e-3),
        ("manifest.recipe.problem.constraints.others.0.within", lambda _: 0.4),
        ("manifest.recipe.problem.constraints.friction_max", lambda x: 10.0 * x),
        ("certificate.problem.rows.0.coefficients.0", lambda _: 1e-3),
    ],
)
def test_what_is_alike_is_stated_and_compared(
    alike: Path, tmp_path: Path, path: str, change: Change
) -> None:
    forged = edit_of(Path(shutil.copytree(alike, tmp_path / "forged")), path, change)
    assert states(replay(forged, recorded(1), robot=arm()))["problem"] == OTHER


# ---- Files that were forged and sealed again.


def behind(pattern: str, new: str, count: int = 0) -> Callable[[str], str]:
    """Return what replaces all that follows the only group of a pattern in it."""
    return lambda text: re.sub(pattern, rf"\g<1>{new}", text, count=count, flags=re.S)


def swap(old: str, new: str, count: int = -1) -> Callable[[str], str]:
    """Return what replaces one text by another."""
    return lambda text: text.replace(old, new, count)


def swapped(tag: str) -> Callable[[str], str]:
    """Return what makes the first two matches of a tag change places."""

    def change(text: str) -> str:
        first, second = re.findall(tag, text, re.DOTALL)[:2]
        return text.replace(first, "@").replace(second, first).replace("@", second)

    return change


def turned(text: str) -> str:
    """Return a text with the axes of a body turned by 1e-4, behind a quaternion of 1e12."""
    found = re.search('<inertial [^>]*quat="([^"]*)"', text)
    w, x, y, z = map(float, found[1].split())
    half = 0.5e-4
    axes = np.array([w - half * x, x + half * w, y + half * z, z - half * y])
    long = " ".join(map(repr, (9e11 * axes / np.linalg.norm(axes)).tolist()))
    return text.replace(found[1], long, 1)


LOAD = (
    '<link name="load"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" '
    'izz="1"/></inertial></link><joint name="f" type="fixed"><parent link="fore"/>'
    '<child link="load"/></joint>'
)
QUATERNION = r'(<inertial [^>]*quat=")[^"]*'
CODE_FORGERIES: list[Callable[[str], str]] = [
    lambda t: re.sub(r"(\d)( \* )", lambda m: str(9 - int(m[1])) + m[2], t, count=1),
    swap("made by a program", "checked by hand"),
    lambda t: f"{t} ",
    lambda t: t + t,
    swap("\n", "\r\n"),
]
# Each file is held against what follows from the log by itself, so one forgery of each file is
# told in one reading of the log.
FORGERIES: dict[str, list[Callable[[str], str]]] = {
    URDF: [
        # Last digits.
        behind(r'(<mass value="\d\.\d{8})\d', "", 1),
        swap('rpy="0 0 0"', 'rpy="0 0 0" quat_xyzw="1 0 0 0"'),
        swap("</inertial>", "<density/></inertial>"),
        # A lower triangle.
        swap("<inertia ", '<inertia iyx="1" '),
        # Two bodies, a link of another name, and a load.
        swap("</inertial>", "</inertial><inertial/>"),
        swap('"upper"', '"upper_01"'),
        swap("</robot>", f"{LOAD}</robot>"),
        lambda text: '<!DOCTYPE robot [<!ENTITY m "1">]>' + text,
        swap("</robot>", "<xacro:x/></robot>"),
        swapped("<inertial>.*?</inertial>"),
        lambda text: text + "<!-- checked by hand -->",
        swap("\n", "\r\n"),
        # It is mounted otherwise.
        swap('rpy="0 0.3 0"', 'rpy="0 0.3000001 0"'),
        lambda text: "",
    ],
    MJCF: [
        swap('gravity="0.0 0.0 -', 'gravity="0.0 0.0 '),
        swap('range="-3.0 3.0"', 'range="-1.0 1.0"'),
        # The mass of what is fixed, and of a link.
        behind('(name="tool" .*?mass=")[^"]*', "0.5"),
        behind('( mass=")[^"]*', "1.5", 1),
        # Turned, a little too, and behind a huge quaternion.
        turned,
        behind(QUATERNION, "1e12 0.0 0.0 0.0"),
        swap("<compiler ", '<compiler settotalmass="9" '),
        swap("</body>", '<geom size="1"/></body>', 1),
        swapped("<inertial.*?/>"),
    ],
    "result.json": [
        behind(r'("cost": )[^,]*', "300.0"),
        behind(r'("gap": )[^,]*', "0.0"),
        behind(r'("certificate": ")[0-9a-f]{8}', "00000000"),
        behind(r'("relative_residual": )[^,]*', "0.0"),
    ],
    "parameters.json": [
        # A proven cost, a base parameter, another robot, another order, an interval, a share.
        behind(r'("cost_at_most": \d+\.\d{4})\d', "0"),
        behind(r'("base": \{\s*"\w+": \{\s*"value": )[^,]*', "1.25"),
        swap('"robot": "arm"', '"robot": "leg"'),
        lambda t: json.dumps(
            {**json.loads(t), "standard": dict(reversed(json.loads(t)["standard"].items()))}
        ),
        behind(r'("interval": \[\s*)[^,]*', "-9.0", 1),
        behind('("data": )[^,]*', "1.0", 1),
    ],
    "parameters.csv": [
        # A cell, a unit, another spelling, a space, and odd cells.
        behind("(m_2,kg,)[^,]*", "0.5"),
        swap("m_2,kg,", "m_2,g,"),
        behind("(m_2,kg,[^,]*)", "_0"),
        swap("m_2,kg,", "m_2,kg, "),
        *(
            swap("\n", f"\n{cell},", 1)
            for cell in ('"', "\0", "1_0.5", "\u0661", "nan", "x" * 200_000)
        ),
    ],
    "base_parameters.csv": [
        behind("(zzr1,[^,]*,[^,]*,)[^,]*", "0.0"),
        lambda t: "\n".join(t.splitlines()[:-1]) + "\n",
    ],
    **dict.fromkeys(FRICTION, CODE_FORGERIES),
}
if not find_spec("mujoco"):
    del FORGERIES[MJCF]


@pytest.mark.parametrize("number", range(max(map(len, FORGERIES.values()))))
def test_every_forged_file_is_told(run: Path, results: Path, number: int) -> None:
    forged = [name for name, kinds in FORGERIES.items() if number < len(kinds)]
    for name in forged:
        edit(results / name, FORGERIES[name][number])
    reseal(results)
    told = [each.partition(": ")[0] for each in verified(run, results).problems]
    assert not [name for name in forged if not any(name in each for each in told)], told


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


@pytest.mark.parametrize(
    ("old", "new", "stated"),
    [
        ('xyz="0 0 1"', 'xyz="0 0 -1"', True),
        ('xyz="0.4 0 0"', 'xyz="0.9 0 0"', True),
        ('effort="100"', 'effort="1000"', True),
        ('xyz="0 0 1"', 'xyz="0 0 -1"', False),
        # A recipe that does not state it is no proof of what was not changed.
        ("", "", False),
    ],
)
def test_another_kinematics_in_urdf_and_manifest(
    run: Path, results: Path, old: str, new: str, stated: bool
) -> None:
    if old:
        edit(results / URDF, swap(old, new, 1))
    digest = kinematics_digest(sdpid.load_robot(results / URDF)) if stated else None
    edit_of(results, "manifest.recipe.robot.kinematics", lambda _: digest)
    refused(run, results, URDF if old else "kinematics")


def test_a_folder_of_before_is_made_again_but_for_intervals(run: Path, results: Path) -> None:
    """Its recipe does not say which numbers the data chose; one of this version has to."""
    edit_json(results / "manifest.json", lambda data: data["recipe"].pop("profiled"))
    edit(results / "parameters.csv", behind("(m_2,kg,[^,]*,)[^,]*", "-9.0"))
    refused(run, results, "parameters.csv")
    earlier = {"version": 5, "compression": {"relative": 1e-9, "absolute": 1e-9}}
    edit_json(results / "certificate.json", lambda data: data.update(earlier))
    edit_of(results, "certificate.origin.contacts", lambda _: None)
    digest = reseal(results)
    for name in ("parameters.json", "result.json", *FRICTION):
        edit(results / name, behind(r"(certificate\W+)[0-9a-f]{64}", digest))
    reseal(results)
    found = verified(run, results)
    assert all("identified_friction" in each for each in found.problems), found.problems
    said = "intervals: the recipe does not say which numbers of terms the data chose"
    assert any(said in each for each in found.log.unchecked)


def sharp(run: Path) -> Path:
    """Return results whose friction has a place in every file."""
    folder = run / "sharp"
    return folder if folder.exists() else identified(run, "sharp", friction=("coulomb", "viscous"))


@pytest.mark.parametrize(
    "names",
    [(URDF, MJCF, "parameters.json", "parameters.csv", "result.json"), ("certificate.json",)],
)
def test_files_of_another_run(run: Path, results: Path, names: tuple[str, ...]) -> None:
    for name in names:
        shutil.copy(sharp(run) / name, results / name)
    refused(run, results, *(Path(name).stem for name in names))


@pytest.mark.parametrize("name", [URDF, MJCF, "parameters.csv"])
def test_a_file_that_is_not_sealed_is_none_of_the_run(results: Path, name: str) -> None:
    """A swapped file that neither manifest nor result.json names any more is not passed over."""
    edit_of(results, "result.exports", lambda given: [e for e in given if e["file"] != name])
    edit(results / name, lambda text: re.sub("([1-9])", lambda m: str(10 - int(m[1])), text))
    reseal(results, without=name)
    assert any(name in each for each in sdpid.verify(results).problems)


def write_friction(results: Path, change: Change) -> None:
    """Change the numbers of both files of friction, and write their code anew."""
    for name in FRICTION:
        text = (results / name).read_text()
        (line,) = (each for each in text.splitlines() if MARK in each)
        data = json.loads(line.partition(MARK)[2])
        change(data)
        (results / name).write_text(WRITERS[Path(name).suffix](data))


def without_friction(kind: str) -> Change:
    """Return a change of the term with such numbers: they are huge."""

    def change(data: Any) -> None:
        (term,) = (each for each in data["terms"] if kind in each)
        term[kind] = [1e9] * len(data["joints"])

    return change


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("certificate.claims.gap", 0.5, "more than 1e-06"),
        ("certificate.origin.loss", "huber", "loss of the certificate"),
        ("certificate.problem.lower.10", 0.5, "the lower bound of 'm_2'"),
        ("certificate.problem.upper.10", 2.0, "the upper bound of 'm_2'"),
        (
            "result.held_out.this estimate.moving.relative_residual",
            0.01,
            "result.json: 'held_out this estimate'",
        ),
    ],
)
def test_other_numbers(run: Path, results: Path, path: str, value: Any, words: str) -> None:
    edit_of(results, path, lambda _: value)
    refused(run, results, words)
    if "m_2" in words:
        assert any("'m_2'" in each for each in verified(run, results).statements)


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data["terms"].pop(),
        lambda data: data["terms"].append(data["terms"][0]),
        set_to("another", "robot"),
        set_to("0" * 64, "certificate"),
        lambda data: data["joints"].reverse(),
        lambda data: data["left_out"].append("Tilt"),
        without_friction("width"),
        without_friction("velocity"),
    ],
)
def test_other_friction(run: Path, results: Path, change: Change) -> None:
    write_friction(results, change)
    refused(run, results, "identified_friction")


def test_friction_of_a_writer_that_is_wrong(
    run: Path, results: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The check is not the writer: it computes friction by the terms of the recipe."""
    sign = friction_files.sign
    monkeypatch.setattr(friction_files, "sign", lambda *args: f"-{sign(*args)}")
    write_friction(results, lambda data: None)
    refused(run, results, "identified_friction")


@pytest.mark.parametrize("friction", ["default", "sharp"])
def test_damping_whatever_result_json_says(run: Path, results: Path, friction: str) -> None:
    if friction == "sharp":
        shutil.rmtree(results)
        shutil.copytree(sharp(run), results)

    def fitted(data: Any) -> None:
        for export in data["exports"]:
            export["friction_fitted"] = True

    edit_json(results / "result.json", fitted)
    names = [name for name in (URDF, MJCF) if (results / name).exists()]
    for name in names:
        edit(results / name, behind('(damping=")[^"]*', "1e9", 1))
    refused(run, results, *(f"{name}.*damping" for name in names))


def test_masses_that_the_log_does_not_show(run: Path, tmp_path: Path) -> None:
    """The base parameters are the same, and the bodies are not those of the rule."""
    robot, log = run / "arm.urdf", run / "run.csv"
    result = sdpid.identify(robot, log, intervals=False, prior=False, effects="none")
    honest = verified(run, saved(result, tmp_path / "honest"))
    assert honest.passed, honest.problems
    assert any("single masses" in each for each in honest.lines)
    theta = np.array(result.estimate.theta)
    # Mass of the first link on its own axis moves nothing.
    theta[0] += 3.0
    moved = replace(result.estimate, theta=theta)
    assert np.allclose(result.problem.base_of(theta), result.estimate.base, atol=1e-9)
    forged = replace(result, estimate=moved, certificate=sdpid.certify(moved))
    refused(run, saved(forged, tmp_path / "forged"), "nearest to the description")


def test_masses_within_the_gap(run: Path, tmp_path: Path) -> None:
    """With a prior, too: a gap of 1e-6 leaves single masses some room, which nobody needs."""
    result = sdpid.identify(run / "arm.urdf", run / "run.csv", intervals=False)
    step, gap = 0.02, 1.0
    while gap > 1e-6:
        theta = np.array(result.estimate.theta)
        theta[0] += step
        certificate = sdpid.certify(moved := replace(result.estimate, theta=theta))
        gap, step = certificate.gap, 0.7 * step
    assert step > 7e-4
    forged = replace(result, estimate=moved, certificate=certificate)
    refused(run, saved(forged, tmp_path / "forged"), "not those of least cost")


def test_a_profile_interval_is_compared_with_its_width(run: Path, tmp_path: Path) -> None:
    results = identified(run, tmp_path / "profile", intervals="profile", effects="none")
    assert verified(run, results).passed
    low, high = json.loads((results / "parameters.json").read_text())["standard"]["m_2"]["interval"]
    narrower = low + 0.03 * (high - low)
    edit_of(results, "parameters.standard.m_2.interval.0", lambda _: narrower)
    refused(run, results, "parameters.json: .*interval.* made again")


def test_bounds_of_ones_own(run: Path, tmp_path: Path) -> None:
    """A certificate of other bounds, whose recipe does not state what was asked."""
    mass = constraints.TotalMass(50.0)
    heavy = sdpid.Constraints(mass_min=20.0, mass_max=40.0, others=(mass,))
    results = identified(run, tmp_path / "heavy", constraints=heavy, prior=False)
    found = verified(run, results)
    assert found.passed, found.problems
    said = " ".join(found.lines)
    assert "total mass" in said
    assert "the defaults for this robot" not in said
    edit_of(results, "manifest.recipe.problem", lambda _: None)
    refused(run, results, "problem")


# ---- Comparing texts and costs.


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


def cost_of(seed: int, exponent: float) -> tuple[Any, Any, float]:
    """Return a cost of five columns, of which the last is shown 10^exponent as well."""
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((40, 6)) * 10.0 ** rng.uniform(-3.0, 3.0, 6)
    rows[:, 4] = rows[:, 3] + 10.0**exponent * rows[:, 4]
    R = np.linalg.qr(rows)[1]
    return R[:-1, :-1], R[:-1, -1], float(R[-1, -1] ** 2)


@given(st.integers(0, 2**32 - 1), st.floats(-9.0, 0.0), st.floats(1e-7, 0.5))
def test_a_cost_of_other_parameters_is_as_far_as_it_is(
    seed: int, exponent: float, share: float
) -> None:
    A, rhs, floor = cost_of(seed, exponent)
    turned = np.linalg.qr(np.random.default_rng(seed).standard_normal((5, 5)))[0]
    assert distance((turned @ A, turned @ rhs, floor), (A, rhs, floor)) < 1e-7
    # All of the cost larger by a share, in whichever unit.
    more = np.sqrt(1.0 + share)
    for unit in (1.0, 1e-6, 1e6):
        larger = (more * unit * A, more * unit * rhs, (1.0 + share) * unit**2 * floor)
        made = (unit * A, unit * rhs, unit**2 * floor)
        assert distance(larger, made) == pytest.approx(share, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("factor", [1e200, np.inf, np.nan, 1e100, 0.0, -1.0])
@pytest.mark.parametrize("k", range(3))
def test_numbers_that_are_no_rows_are_far_from_all(factor: float, k: int) -> None:
    made = cost_of(1, -1.0)
    with np.errstate(all="ignore"):
        cost: Any = (*made[:k], factor * made[k], *made[k + 1 :])
        assert not distance(cost, made) <= 1e-6


# ---- A recipe makes the same rows of the same log again.


def recipe(**changes: Any) -> Recipe:
    """Return the recipe of a run, some of it otherwise."""
    return replace(world.result(effects="none").recipe, **changes)


PROCESSINGS = st.builds(
    Processing,
    cutoff_hz=reals(0.5, 50.0),
    order=st.integers(1, 6),
    decimation=st.none() | st.integers(1, 20),
    filter_alike=st.booleans(),
    covariance=st.sampled_from(["period", "pooled", None]),
    trim_s=st.none() | reals(0.0, 9.0),
)


@given(PROCESSINGS, st.lists(friction_terms_of(3), max_size=4), st.integers(0, 2**32 - 1))
def test_a_recipe_that_was_json_is_the_same_recipe(
    processing: Processing, friction: list[Any], seed: int
) -> None:
    sigma = np.diag(np.random.default_rng(seed).uniform(1e-9, 1e9, 3))
    reading = ({"units": {"position": "deg"}}, None)
    more = {"reading": reading, "without_effort": ("b",), "sigma": sigma}
    made = recipe(processing=processing, friction=tuple(friction), **more)
    again = Recipe.from_dict(json.loads(json.dumps(made.to_dict(), allow_nan=False)))
    assert np.array_equal(again.sigma, made.sigma)
    for name in ("robot", "reading", "processing", "without_effort", "friction", "weighting"):
        assert getattr(again, name) == getattr(made, name)


def test_the_rows_of_a_file_are_made_again(tmp_path: Path) -> None:
    log, robot, file = recorded(1), tmp_path / "arm.urdf", tmp_path / "run.csv"
    tables = (1e3 * log.time, np.degrees(log.position), log.effort / 50.0)
    write_csv(file, ["stamp", *numbered("p{}", "i{}")], *tables)
    (mapping := tmp_path / "run.toml").write_text(
        'joint_names = ["a", "b"]\neffort_scale = [50.0, 50.0]\n'
        '[columns]\ntime = "stamp"\nposition = "p"\neffort = "i"\n'
        '[units]\ntime = "ms"\nposition = "deg"\neffort = "A"\n'
    )
    robot.write_text(ARM_URDF)
    result = sdpid.identify(robot, file, effects="tilt,load", intervals=False)
    mapping.unlink()
    proof = replay(saved(result, tmp_path / "results"), file, robot=robot)
    assert {*states(proof).values()} == {SAME}, wrong(proof)
    assert "number for number those of the run" in text_of(proof, "samples")
    assert RobotRecipe.of(result.problem.robot) == result.recipe.robot
    kinds = [(each["role"], each["name"]) for each in result.inputs]
    assert kinds == [("log", "run.csv"), ("robot", "arm.urdf")]


def test_a_recording_in_memory_is_known_by_its_numbers() -> None:
    log, other = recorded(1), recorded(2)
    effort = np.array(log.effort)
    effort[7, 1] = np.nextafter(effort[7, 1], np.inf)
    assert recording_digest(log) == recording_digest(replace(log))
    for changes in ({"effort": effort}, {"joint_names": ("b", "a")}):
        assert recording_digest(log) != recording_digest(replace(log, **changes))
    result = sdpid.identify(arm(), [log, other], intervals=False, effects="none")
    digests = [recording_digest(each) for each in (log, other)]
    assert [each["sha256"] for each in result.inputs[:2]] == digests
    assert result.recipe.reading == (None, None)


@dataclass(frozen=True)
class _Own(Coulomb):
    """A term that no file can hold."""


def test_a_term_of_ones_own_has_no_recipe_and_says_so() -> None:
    result = world.result(friction=(_Own(), "viscous"), effects="none")
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
    words = r"its recipe cannot be followed: .*[^.]\.$"
    refuses(CertificateError, words, Recipe.from_dict, {**recipe().to_dict(), key: value})


def test_recipes_from_before_friction_had_a_bound_of_its_own() -> None:
    stated = StatedProblem(
        consistency="pseudo_inertia", constraints=sdpid.Constraints(friction_max=1e4), prior=None
    )
    given = json.loads(json.dumps(stated.to_dict()))
    assert StatedProblem.from_dict(given) == stated
    del given["constraints"]["friction_max"]
    assert StatedProblem.from_dict(given).constraints == sdpid.Constraints()
