"""From the log to the files of a folder: every link is named, as made again or not."""

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

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
from sdpid.robot.friction.terms import Coulomb
from sdpid.workflow.replay import replay as module
from sdpid.workflow.replay.compare import distance
from sdpid.workflow.replay.replay import Replay, replay
from tests.helpers import world
from tests.helpers.arm_files import ARM_URDF
from tests.helpers.refusals import refuses
from tests.helpers.runs import arm, recorded
from tests.helpers.strategies import friction_terms_of, reals

LINKS = ("log", "robot", "samples", "problem", "base parameters", "weights", "rows")
BOX = constraints.CenterOfMassInBox("fore", (-np.inf, -0.2, -0.2), (0.5, 0.2, np.inf))
HULL = constraints.CenterOfMassInHull("fore", [*0.5 * np.eye(3), (-0.5, -0.5, -0.5)])


class OfYourOwn(constraints.Condition):
    """A condition of a class that no file can hold."""

    def compile(self, layout: constraints.Layout) -> list[constraints.Row]:
        """Return a row that says little."""
        return [constraints.Row("light", np.eye(layout.count)[0], 0.0, 99.0)]


Edit = Callable[[dict[str, Any], dict[str, Any]], None]


def write_log(path: Path, log: sdpid.Recording) -> Path:
    """Write a recording as text, every digit of it."""
    table = np.column_stack([log.time, log.position, log.effort])
    header = "t,q_a,q_b,tau_a,tau_b"
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.17g")
    return path


def saved(result: Any, folder: Path) -> Path:
    """Save a result."""
    result.save(folder, figures=False)
    return folder


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with log, robot and results."""
    return world.folder(tmp_path_factory.mktemp("run"))


def changed(run: Path, target: Path, edit: Edit) -> Path:
    """Return a copy of the results whose certificate and manifest were edited."""
    shutil.copytree(run / "results", target)
    files = [target / name for name in ("certificate.json", "manifest.json")]
    contents = [json.loads(file.read_text()) for file in files]
    edit(*contents)
    for file, content in zip(files, contents, strict=True):
        file.write_text(json.dumps(content))
    return target


def states(proof: Replay) -> dict[str, str]:
    """Return the state of each link; what is not made again wins."""
    order = ("made again", "not checked", "not made again")
    links = sorted(proof.links, key=lambda link: order.index(link.state))
    return {link.name: link.state for link in links}


def wrong(proof: Replay) -> list[str]:
    """Return what was not made again."""
    return [f"{each.name}: {each.text}" for each in proof.links if each.state == "not made again"]


def text_of(proof: Replay, name: str) -> str:
    """Return what is said of the one link of a name."""
    (text,) = (link.text for link in proof.links if link.name == name)
    return text


def test_everything_is_made_again(run: Path) -> None:
    proof = replay(run / "results", [run / "run.csv"], robot=run / "arm.urdf")
    assert tuple(link.name for link in proof.links)[: len(LINKS)] == LINKS
    named = {name for link in proof.links for name in link.name.split(", ")}
    written = {path.name for path in (run / "results").iterdir()}
    assert written - named == {"certificate.json", "manifest.json", "report.html"}
    assert {*states(proof).values()} == {"made again"}, wrong(proof)
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
    assert states(proof)["identified.urdf"] == "not checked"


@pytest.mark.parametrize(
    ("options", "unchecked"),
    [
        ({"without_effort": ("a",)}, {"identified.urdf"}),
        ({"prior": False}, {"identified.urdf", "choice"}),
        ({"accept": ("effort_scale",)}, {"identified.urdf", "identified.xml"}),
    ],
    ids=("effort", "prior", "tool"),
)
def test_what_the_description_alone_can_show(
    options: dict[str, Any], unchecked: set[str], tmp_path: Path
) -> None:
    """Without it nothing is said to be wrong: of no prior, of a tool that a link took over."""
    robot, log = tmp_path / "arm.urdf", recorded(1)
    robot.write_text(ARM_URDF.replace('<mass value="0.4"/>', '<mass value="6.0"/>'))
    if "accept" not in options:
        robot.write_text(ARM_URDF)
    result = sdpid.identify(robot, log, intervals=False, effects="none", **options)
    folder = saved(result, tmp_path / "results")
    proof = replay(folder, log)
    assert {name for name, state in states(proof).items() if state != "made again"} == unchecked
    assert {*states(replay(folder, log, robot=robot)).values()} == {"made again"}


def test_a_log_edited_by_one_digit_is_named(run: Path, tmp_path: Path) -> None:
    lines = (run / "run.csv").read_text().splitlines()
    fields = lines[200].split(",")
    digit = fields[3][6]
    fields[3] = fields[3][:6] + ("1" if digit != "1" else "2") + fields[3][7:]
    lines[200] = ",".join(fields)
    (tmp_path / "run.csv").write_text("\n".join(lines) + "\n")
    proof = replay(run / "results", tmp_path / "run.csv")
    assert states(proof)["log"] == "not made again"
    assert "'run.csv' has the SHA-256" in proof.links[0].text
    # The rows are others, too, if only a little.
    assert states(proof)["rows"] == "not made again"
    assert 1e-6 < proof.distance < 1e-2


def test_another_log_of_the_same_name_is_named(run: Path, tmp_path: Path) -> None:
    proof = replay(run / "results", write_log(tmp_path / "run.csv", recorded(2)))
    found = states(proof)
    assert found["log"] == found["rows"] == "not made again"
    assert proof.distance > 0.1
    assert proof.gap is None


def test_another_robot_is_named(run: Path, tmp_path: Path) -> None:
    other = tmp_path / "arm.urdf"
    other.write_text(ARM_URDF.replace('xyz="0.4 0 0"', 'xyz="0.41 0 0"'))
    proof = replay(run / "results", run / "run.csv", robot=other)
    found = states(proof)
    assert found["robot"] == found["rows"] == "not made again"
    assert "is another robot: SHA-256" in proof.links[1].text


def test_a_written_robot_that_is_mounted_otherwise_is_named(run: Path, tmp_path: Path) -> None:
    """Also where the robot of the run is given."""
    results = Path(shutil.copytree(run / "results", tmp_path / "results"))
    urdf, robot = results / "identified.urdf", run / "arm.urdf"
    assert states(replay(results, run / "run.csv", robot=robot))["robot"] == "made again"
    urdf.write_text(urdf.read_text().replace('rpy="0 0.3 0"', 'rpy="0 0.3000001 0"'))
    found = sdpid.verify(results, data=run / "run.csv", robot=robot)
    assert any("identified.urdf: line" in each and "rpy" in each for each in found.problems)


def test_macros_in_a_folder_are_not_run(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    results = Path(shutil.copytree(run / "results", tmp_path / "results"))
    urdf = results / "identified.urdf"
    macro = '<xacro:property xmlns:xacro="http://ros.org/wiki/xacro" name="a" value="${1 + 1}"/>'
    urdf.write_text(urdf.read_text().replace("</robot>", f"{macro}</robot>"))
    monkeypatch.setattr(
        "sdpid.robot.description.xacro.run_in_sandbox", lambda *_, **__: pytest.fail("was run")
    )
    assert states(replay(results, run / "run.csv"))["robot"] == "not made again"


def test_a_robot_with_other_inertias_has_the_same_rows(run: Path, tmp_path: Path) -> None:
    other = tmp_path / "arm.urdf"
    other.write_text(ARM_URDF.replace('<mass value="3.0"/>', '<mass value="4.0"/>'))
    proof = replay(run / "results", run / "run.csv", robot=other)
    assert wrong(proof) == []
    assert "number for number" in proof.links[1].text


def forge(certificate: dict[str, Any], manifest: dict[str, Any]) -> None:
    """Make bad parameters optimal: of other rows, with all hashes right."""
    problem, theta = certificate["problem"], np.array(certificate["theta"])
    A, B = np.array(problem["A"]), np.array(problem["base_matrix"])
    wrong = A @ (B @ (1.3 * theta))
    residual = wrong - np.array(problem["rhs"])
    problem["floor"] += float(residual @ residual)
    problem["rhs"], certificate["theta"] = wrong.tolist(), (1.3 * theta).tolist()
    dual = certificate["multipliers"]
    for name in ("y", "Z", "rows"):
        dual[name] = np.zeros_like(np.array(dual[name])).tolist()
    dual["W"] = None
    certificate["claims"].update(cost=1.1 * problem["floor"], lower_bound=0.9 * problem["floor"])


def edit_of(path: str, change: Callable[[Any], Any]) -> Edit:
    """Return an edit of one value, such as ``recipe.sigma.0.0``."""
    first, *keys = path.split(".")

    def edit(certificate: dict[str, Any], manifest: dict[str, Any]) -> None:
        place: Any = {"certificate": certificate, "manifest": manifest}[first]
        *way, last = (int(key) if key.lstrip("-").isdigit() else key for key in keys)
        for key in way:
            place = place[key]
        place[last] = change(place[last])

    return edit


def with_bodies(bodies: list[list[float]]) -> Callable[[Any], Any]:
    """Return a change of any term to a tilt of some bodies."""
    return lambda _: {"term": "Tilt", "bodies": bodies}


@pytest.mark.parametrize(
    ("link", "edit"),
    [
        pytest.param("rows", forge, id="rows of someone else"),
        ("rows", edit_of("certificate.problem.A.3.3", lambda x: x * (1 + 1e-5))),
        ("rows", edit_of("certificate.problem.rhs.2", lambda x: x + 1e-3)),
        ("rows", edit_of("certificate.problem.floor", lambda x: x * 1.01)),
        ("base parameters", edit_of("certificate.problem.base_matrix.0.1", lambda x: x + 1e-3)),
        ("base parameters", edit_of("certificate.origin.links.0", lambda x: x + "_2")),
        ("base parameters", edit_of("certificate.origin.weighting", lambda _: "gls")),
        ("rows", edit_of("manifest.recipe.processing.cutoff_hz", lambda x: 1.001 * x)),
        ("weights", edit_of("manifest.recipe.sigma.0.0", lambda x: 1.1 * x)),
        ("rows", edit_of("manifest.recipe.friction.1.velocity.0", lambda x: 1.01 * x)),
        ("samples", edit_of("manifest.recipe.without_effort", lambda _: ["a"])),
        ("samples", edit_of("manifest.recipe.without_effort", lambda _: ["\x1b[2K"])),
        # First moments without a mass have no center: their columns are no numbers.
        (
            "problem",
            edit_of("manifest.recipe.friction.1", with_bodies([[0.0, *[1.0] * 9]] * 2)),
        ),
        ("problem", edit_of("certificate.problem.prior_matrix.0.0", lambda _: 1e308)),
        ("robot", edit_of("manifest.recipe.robot.gravity.2", lambda x: x + 0.01)),
        ("problem", edit_of("certificate.problem.upper.0", lambda x: 2.0 * x)),
        ("problem", edit_of("certificate.problem.margin", lambda _: 1e-6)),
        ("problem", edit_of("certificate.problem.prior_rhs.0", lambda x: x + 1e-3)),
        ("problem", edit_of("manifest.recipe.problem.constraints.mass_max", lambda x: x + 1.0)),
        ("problem", edit_of("manifest.recipe.problem.prior.strength", lambda _: 1.1)),
        ("problem", edit_of("manifest.recipe.problem.prior", lambda _: None)),
        ("problem", edit_of("manifest.recipe.problem.consistency", lambda _: "none")),
        ("log", edit_of("manifest.inputs.0.bytes", lambda x: x + 1)),
        ("log", edit_of("manifest.inputs.0.sha256", lambda x: "0" + x[1:] if x[0] != "0" else x)),
    ],
)
def test_what_was_forged_is_named(run: Path, tmp_path: Path, link: str, edit: Edit) -> None:
    proof = replay(changed(run, tmp_path / "forged", edit), run / "run.csv")
    assert states(proof)[link] == "not made again"
    assert all(each.text.isprintable() for each in proof.links)


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (edit_of("manifest.recipe", lambda _: None), "has no recipe"),
        (edit_of("manifest.recipe.logs", lambda _: []), "names 1 logs and how 0 are read"),
        (edit_of("manifest.recipe.logs.0.reading", lambda _: {"path": "x"}), "'path'"),
        (edit_of("manifest.inputs", lambda _: 3), "inputs is no list"),
        (edit_of("manifest.recipe.robot.source", lambda _: 3), "source of the robot is 3"),
        (edit_of("manifest.recipe.logs.0.reading", lambda _: {"units": 3}), "units is 3"),
        (edit_of("manifest.recipe.problem.constraints", lambda _: {}), "constraints are {}"),
        (edit_of("manifest.recipe.problem.prior.kind", lambda _: "x"), "kind is 'x'"),
        (edit_of("manifest.recipe.robot.xacro_args", lambda _: [1]), "xacro_args of the robot"),
        (edit_of("manifest.recipe.robot.gravity.0", lambda _: 1e300), "gravity is"),
        (edit_of("manifest.recipe.sigma.0.1", lambda _: 1e-9), "sigma is not symmetric"),
        (edit_of("manifest.recipe.without_effort", lambda _: "a"), "expected a list of names"),
        (edit_of("manifest.recipe.friction.1", with_bodies([[1.0] * 9])), "a body is"),
        (edit_of("manifest.recipe.friction.1", with_bodies([[1e308] * 10])), "a body is"),
    ],
)
def test_a_folder_that_cannot_be_followed_is_refused(
    run: Path, tmp_path: Path, edit: Edit, message: str
) -> None:
    with pytest.raises((CertificateError, DataError), match=message):
        replay(changed(run, tmp_path / "forged", edit), run / "run.csv")


def test_a_log_that_is_not_there_is_bad_input(run: Path) -> None:
    refuses(DataError, "there is no such file", replay, run / "results", run / "missing.csv")
    refuses(DataError, "format", replay, run / "results", run / "arm.urdf")
    with pytest.raises(ModelError, match="no robot 'nobody'"):
        replay(run / "results", run / "run.csv", robot="nobody")
    refuses(CertificateError, "is no folder", replay, run / "run.csv", run / "run.csv")


def test_a_missing_package_is_no_finding(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise MissingExtraError("h5py is not installed")

    monkeypatch.setattr(module, "read_recording", refuse)
    with pytest.raises(MissingExtraError):
        replay(run / "results", run / "run.csv")


def test_a_real_log(data_folder: Path, tmp_path: Path) -> None:
    robot, log = (data_folder / "ur10_unisa" / name for name in ("ur10.urdf", "ur10_exciting.npz"))
    result = sdpid.identify(robot, log, effects="none", intervals=False)
    proof = replay(saved(result, tmp_path / "results"), log, robot=robot)
    assert {*states(proof).values()} == {"made again"}, wrong(proof)
    assert proof.gap < 1e-6


def test_several_logs_have_an_order(tmp_path: Path) -> None:
    logs = [write_log(tmp_path / f"{k}.csv", recorded(k, seconds=14.0)) for k in (1, 2)]
    (tmp_path / "arm.urdf").write_text(ARM_URDF)
    result = sdpid.identify(tmp_path / "arm.urdf", logs, intervals=False, effects="none")
    folder = saved(result, tmp_path / "results")
    assert wrong(replay(folder, logs)) == []
    proof = replay(folder, logs[::-1])
    assert [link.state for link in proof.links[:2]] == ["not made again", "not made again"]
    assert "'2.csv' has the SHA-256" in proof.links[0].text
    assert "it is log 2 of the run, not log 1" in proof.links[0].text
    proof = replay(folder, logs[0])
    assert proof.links[0].text == "1 are given, the result is of 2: '1.csv', '2.csv'"


@pytest.mark.parametrize(
    ("options", "state"),
    [
        ({"prior": sdpid.Prior(kind="entropic", strength="evidence")}, "made again"),
        ({"consistency": "spatial_inertia", "prior": False}, "made again"),
        (
            {"constraints": sdpid.Constraints(others=constraints.TotalMass(4.9, tolerance=0.5))},
            "made again",
        ),
        ({"constraints": sdpid.Constraints(others=BOX)}, "made again"),
        ({"constraints": sdpid.Constraints(others=HULL)}, "made again"),
        ({"constraints": sdpid.Constraints(others=OfYourOwn())}, "not made again"),
    ],
)
def test_what_was_asked_of_the_parameters(
    tmp_path: Path, options: dict[str, Any], state: str
) -> None:
    result = world.result(effects="none", **options)
    proof = replay(saved(result, tmp_path / "results"), recorded(1), robot=arm())
    assert (wrong(proof) == []) == (state == "made again"), wrong(proof)
    assert states(proof)["problem"] == state


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
    alike: Path, tmp_path: Path, path: str, change: Callable[[Any], Any]
) -> None:
    forged = changed(alike, tmp_path / "forged", edit_of(path, change))
    proof = replay(forged, recorded(1), robot=arm())
    assert states(proof)["problem"] == "not made again"


@pytest.fixture(scope="module")
def alike(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a result that believes in a mirror image and in friction that is alike."""
    folder = tmp_path_factory.mktemp("alike")
    pair = constraints.MirrorPair("upper", "fore", reflection=np.diag([1.0, -1.0, 1.0, 1.0]))
    prior = sdpid.Prior(alike=(pair,), within=0.5)
    limits = sdpid.Constraints(others=(constraints.EqualFriction("a", "b", within=0.3),))
    result = world.result(effects="none", prior=prior, constraints=limits)
    assert "mirror images of each other within 50 %: upper and fore" in result.summary()
    saved(result, folder / "results")
    proof = replay(folder / "results", recorded(1), robot=arm())
    assert wrong(proof) == []
    assert "within 50 %" in text_of(proof, "problem")
    assert "conditions: 1 EqualFriction" in text_of(proof, "problem")
    return folder


@pytest.mark.parametrize("weighting", ["gls", "gls_per_sample", "eq18"])
def test_a_recording_in_memory_with_periods(tmp_path: Path, weighting: Any) -> None:
    log = recorded(3, seconds=40.0, period=5.0)
    result = sdpid.identify(
        arm(), log, weighting=weighting, prior=False, intervals=False, effects="none"
    )
    folder = saved(result, tmp_path / "results")
    proof = replay(folder, log)
    assert wrong(proof) == []
    assert "the recording in memory has the SHA-256 of the manifest" in proof.links[0].text
    assert states(replay(folder, recorded(4, seconds=40.0, period=5.0)))["log"] == "not made again"


# ---- Costs of all parameters at once.


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
def test_numbers_that_are_no_rows_are_far_from_all(factor: float) -> None:
    A, rhs, floor = cost_of(1, -1.0)
    with np.errstate(all="ignore"):
        costs = ((factor * A, rhs, floor), (A, factor * rhs, floor), (A, rhs, factor * floor))
        for cost in costs:
            assert not distance(cost, (A, rhs, floor)) <= 1e-6


# ---- A recipe makes the same rows of the same log again.


ROBOT = RobotRecipe(
    name="arm",
    source="arm.urdf",
    catalog=False,
    root=None,
    xacro_args={},
    gravity=(0.0, 0.0, -9.81),
    kinematics="0" * 64,
)
RECIPE = Recipe(
    robot=ROBOT,
    reading=({"units": {"position": "deg"}}, None),
    processing=Processing(),
    without_effort=("b",),
    friction=(),
    weighting="residual",
    sigma=np.eye(2),
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
    derivative=st.sampled_from(["central", "central4", "central6"]),
    velocity=st.sampled_from(["differentiated", "measured"]),
    trim_s=st.none() | reals(0.0, 9.0),
    timing=st.sampled_from(["auto", "nominal", "resample"]),
    filter=st.sampled_from(["butterworth", "finite"]),
)


@given(PROCESSINGS, st.lists(friction_terms_of(3), max_size=4), st.integers(0, 2**32 - 1))
def test_a_recipe_that_was_json_is_the_same_recipe(
    processing: Processing, friction: list[Any], seed: int
) -> None:
    sigma = np.diag(np.random.default_rng(seed).uniform(1e-9, 1e9, 3))
    recipe = replace(RECIPE, processing=processing, friction=tuple(friction), sigma=sigma)
    again = Recipe.from_dict(json.loads(json.dumps(recipe.to_dict(), allow_nan=False)))
    for name in ("robot", "reading", "processing", "without_effort", "friction", "weighting"):
        assert getattr(again, name) == getattr(recipe, name)
    assert again.sigma is not None
    assert recipe.sigma is not None
    assert np.array_equal(again.sigma, recipe.sigma)


def test_the_rows_of_a_file_are_made_again(tmp_path: Path) -> None:
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
    (tmp_path / "run.toml").unlink()
    folder = saved(result, tmp_path / "results")
    proof = replay(folder, tmp_path / "run.csv", robot=tmp_path / "arm.urdf")
    assert {*states(proof).values()} == {"made again"}, wrong(proof)
    assert "number for number those of the run" in text_of(proof, "samples")
    assert RobotRecipe.of(result.problem.robot) == result.recipe.robot
    kinds = [(each["role"], each["name"]) for each in result.inputs]
    assert kinds == [("log", "run.csv"), ("robot", "arm.urdf")]


def test_a_recording_in_memory_is_known_by_its_numbers() -> None:
    log = recorded(1)
    effort = np.array(log.effort)
    effort[7, 1] = np.nextafter(effort[7, 1], np.inf)
    assert recording_digest(log) == recording_digest(replace(log))
    assert recording_digest(log) != recording_digest(replace(log, effort=effort))
    assert recording_digest(log) != recording_digest(replace(log, joint_names=("b", "a")))
    result = sdpid.identify(arm(), [log, recorded(2)], intervals=False, effects="none")
    assert [each["sha256"] for each in result.inputs[:2]] == [
        recording_digest(log),
        recording_digest(recorded(2)),
    ]
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
    recipe = replace(RECIPE, weighting="gls")
    with pytest.raises(CertificateError, match=r"its recipe cannot be followed: .*[^.]\.$"):
        Recipe.from_dict({**recipe.to_dict(), key: value})


def test_recipes_from_before_friction_had_a_bound_of_its_own() -> None:
    stated = StatedProblem(
        consistency="pseudo_inertia", constraints=sdpid.Constraints(friction_max=1e4), prior=None
    )
    given = json.loads(json.dumps(stated.to_dict()))
    assert StatedProblem.from_dict(given) == stated
    del given["constraints"]["friction_max"]
    assert StatedProblem.from_dict(given).constraints == sdpid.Constraints()
