"""The whole way: a recording in, certified parameters and a URDF out, also of real robots."""

import json
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from unittest.mock import Mock

import mujoco
import numpy as np
import pinocchio
import pytest

import sdpid
from sdpid.assurance.diagnostics.held_out import hold_out
from sdpid.assurance.diagnostics.rest import moving_rows
from sdpid.assurance.diagnostics.validation import validate_robot
from sdpid.errors import CertificateError, DataError, IdentifiabilityError, ModelError
from sdpid.experiment.plant.simulate import true_parameters
from sdpid.experiment.processing import process
from sdpid.experiment.processing.choose import default_processing
from sdpid.experiment.recording import joints
from sdpid.output.report.recording import values
from sdpid.output.report.subject import graded, grades
from sdpid.robot.inertia import Consistency
from sdpid.robot.model.model import RobotModel
from sdpid.workflow.formulate import formulate
from sdpid.workflow.result import NAMES, Identification
from tests.common.test_common import Terminal
from tests.helpers.arm_files import ARM_URDF
from tests.helpers.commands import printed
from tests.helpers.crawl import crawl
from tests.helpers.forged import edit_json, reseal, set_to
from tests.helpers.refusals import refuses
from tests.helpers.runs import arm, recorded

# What the records' own descriptions report for an unconstrained fit with the same friction: with
# tanh(v/0.02) for the UR10, with the measured velocity for the Panda.
UR10_RESIDUAL, PANDA_RESIDUAL = 0.0543, 0.0150


@pytest.fixture(scope="module")
def log(denso: RobotModel) -> sdpid.Recording:
    """Return a small experiment with periods, more of them than joints."""
    trajectory = sdpid.paper_excitation("denso_vp6242", 3, periods=8, period=38.0)
    theta = true_parameters("denso_vp6242")
    return sdpid.simulate(denso, trajectory, theta=theta, seed=3)


@pytest.fixture(scope="module")
def result(denso: RobotModel, log: sdpid.Recording) -> Identification:
    return sdpid.identify(denso, log, validation=log)


def loads_elsewhere(path: Path, joints: int) -> None:
    assert pinocchio.buildModelFromUrdf(str(path)).nv == joints
    assert mujoco.MjModel.from_xml_path(str(path)).nv == joints


def test_a_periodic_experiment_is_certified(result: Identification) -> None:
    assert result.certificate.passed
    assert result.problem.weighting == "gls"
    assert result.estimate.worst_margin >= 0.0
    assert result.wls.cost <= result.estimate.cost * (1 + 1e-9)
    assert result.validation.relative == pytest.approx(result.training.relative, rel=1e-6)
    # The plant's friction, from a clean experiment: the parameters that anybody can check.
    truth = result.problem.base_of(true_parameters("denso_vp6242"))
    for name in ("Fs1", "Fv1"):
        i = result.problem.base.names.index(name)
        assert result.estimate.base[i] == pytest.approx(truth[i], rel=0.02)


def test_everything_is_saved_and_loads(result: Identification, tmp_path: Path) -> None:
    notes: list[str] = []
    folder = tmp_path / "deep" / "out"
    files = result.save(folder, figures=True, report=notes.append)
    others = ("drives", "elasticity", "identified_elastic")
    written = {name for name in NAMES if not name.startswith(others)}
    assert {path.name for path in files} == written - {"run.toml"}
    assert {*folder.iterdir()} == {*files}
    assert sdpid.verify(folder / "certificate.json").passed
    assert json.loads((folder / "result.json").read_text())["certified"] is True
    loads_elsewhere(folder / "identified.urdf", 6)
    assert notes == []
    assert "relative residual" in result.summary()


def test_it_says_what_it_is_doing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("JPY_PARENT_PID", raising=False)
    monkeypatch.setattr("sys.stderr", terminal := Terminal())
    sdpid.identify(arm(), recorded(1), intervals=False)
    stages = ("inspecting", "processing", "choosing the model", "estimating", "holding out")
    assert [words for words in stages if words not in terminal.getvalue()] == []


def test_ur10(data_folder: Path, tmp_path: Path) -> None:
    folder = data_folder / "ur10_unisa"
    found = sdpid.identify(folder / "ur10.urdf", folder / "ur10_exciting.npz")
    assert found.training_wls.relative <= UR10_RESIDUAL
    # Consistency alone costs next to nothing on the data it was fitted to.
    plain = sdpid.identify(folder / "ur10.urdf", folder / "ur10_exciting.npz", prior=False)
    assert plain.training_wls.relative <= plain.training.relative <= UR10_RESIDUAL
    # The default believes in the description too, which costs a little there and pays elsewhere.
    assert found.training.relative <= 1.05 * UR10_RESIDUAL
    assert found.certificate.passed
    notes: list[str] = []
    found.save(tmp_path, figures=False, report=notes.append)
    assert any("no place in a URDF or an MJCF: Offset Fo1 … Fo6: " in note for note in notes)
    loads_elsewhere(tmp_path / "identified.urdf", 6)
    # What is told of the files' errors is what `sdpid validate` finds.
    told = json.loads((tmp_path / "result.json").read_text())["exports"]
    for export in told:
        written = sdpid.load_robot(tmp_path / export["file"], gravity=(0.0, 0.0, -9.81))
        fit = validate_robot(written, found.problem.samples)
        assert export["training"]["file"] == pytest.approx(fit.told.relative, rel=1e-6)
        assert export["training"]["estimate"] == pytest.approx(found.training.told.relative)
        assert any(f"efforts by {100.0 * fit.told.relative:.2f} %" in note for note in notes)


def test_panda_with_other_joint_names(data_folder: Path) -> None:
    folder = data_folder / "panda_unisa"
    record = sdpid.read_recording(folder / "panda_exciting.npz")
    robot = sdpid.load_robot(folder / "panda.urdf")
    assert not set(record.joint_names) & set(robot.joint_names)
    assert default_processing(record).velocity == "measured"
    found = sdpid.identify(robot, record)
    assert found.problem.samples.joint_names == robot.joint_names
    assert found.training_wls.relative <= PANDA_RESIDUAL
    # Consistency costs a little, on the data it was fitted to.
    assert found.training.relative <= 1.1 * PANDA_RESIDUAL
    assert found.certificate.passed


def test_a_motion_that_shows_too_little_is_refused(log: sdpid.Recording, denso: RobotModel) -> None:
    still = replace(log, position=log.position * ([0.0] + [1.0] * 5))
    chosen = replace(default_processing(log), reversal_time=None)
    words = r"Fs1|Fv1"
    refuses(IdentifiabilityError, words, sdpid.identify, denso, still, processing=chosen)


NO_EFFECTS = "effects: is .*'auto', 'none' or some of tilt"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"friction": "coulomb"}, r"\('coulomb',\)"),
        ({"friction": 3}, "friction: is 3"),
        ({"processing": {"cutoff_hz": "10"}}, "cutoff_hz: is '10'"),
        ({"processing": {"order": "2"}}, "order: is '2'"),
        ({"processing": {"cutoff": 10.0, "order": 2}}, "cutoff is no setting;.*cutoff_hz"),
        ({"processing": "fast"}, "processing: is 'fast'"),
        *(({"effects": effects}, NO_EFFECTS) for effects in (True, None, 3)),
        *(({name: 3}, f"^{name}: is ") for name in ("constraints", "validation", "without_effort")),
        ({"prior": "yes"}, "^prior: is "),
        *(({"log": log}, "^log: is ") for log in (3, None)),
    ],
)
def test_arguments_of_a_wrong_kind(arguments: dict[str, object], words: str) -> None:
    refuses(DataError, words, sdpid.identify, arm(), **{"log": recorded(1), **arguments})


def test_formulate_takes_what_identify_takes(tmp_path: Path) -> None:
    log, (urdf, path) = recorded(1), (tmp_path / "arm.urdf", tmp_path / "run.parquet")
    log.to_parquet(path)
    urdf.write_text(ARM_URDF)
    np.testing.assert_array_equal(formulate(urdf, path).rhs, formulate(arm(), log).rhs)
    refuses(DataError, r"no\.csv", formulate, arm(), tmp_path / "no.csv")


# `identify` of a robot with a floating base, end to end, from motion with chosen forces.


TERMS = ("viscous",)


def noisy(log: sdpid.Recording) -> sdpid.Recording:
    rng = np.random.default_rng(0)
    return replace(log, effort=log.effort + 0.005 * rng.normal(size=log.effort.shape))


@lru_cache(maxsize=1)
def identified() -> Identification:
    walk = crawl()
    log = noisy(walk.log())
    return sdpid.identify(
        "solo12",
        log.rows(slice(0, 1500)),
        validation=log.rows(slice(1500, 2000)),
        processing={"cutoff_hz": 20.0},
        friction=TERMS,
        effects="none",
    )


def test_a_log_with_a_base_gives_a_floating_robot_with_its_mass() -> None:
    result = identified()
    robot, theta = result.problem.robot, result.estimate.theta
    assert robot.free_flyer
    assert result.certificate.passed
    assert result.intervals is not None
    mass = theta[: 10 * robot.n_links : 10].sum()
    assert mass == pytest.approx(robot.prior[:, 0].sum(), rel=2e-3)
    # Errors of joints and of the base stand apart.
    fit, held_out = result.validation, result.held_out
    # Of 25 N of weight, and efforts with 1 % of noise before the filter.
    assert fit.floating.force < 0.1
    assert fit.floating.torque < 0.02
    assert not fit.rows[:6].any()
    assert fit.moving.relative < 0.02
    described = held_out.baselines["description as it is"]
    assert described.floating is not None
    assert described.moving.relative < 0.05


def test_a_log_is_processed_at_most_four_times_and_its_robot_loaded_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """By inspection, for delays, and with noise once more."""
    pytest.importorskip("mujoco")
    # Every call of `process` asks for the pieces of its log.
    pieces = Mock(side_effect=process.continuous)
    loaded = Mock(side_effect=joints.load_robot)
    monkeypatch.setattr(process, "continuous", pieces)
    monkeypatch.setattr(joints, "load_robot", loaded)
    log = sdpid.simulate_legged("solo12", "trot", duration=2.0, seed=3).recording
    sdpid.identify("solo12", log)
    assert 1 <= pieces.call_count <= 4
    assert loaded.call_count == 1


def test_motors_of_a_floating_robot_are_identified_and_made_again(tmp_path: Path) -> None:
    """They move joints of a leg together; friction and rotor inertia are theirs."""
    pytest.importorskip("mujoco")
    rows = {
        "FL_HFE": {"left": 0.5, "right": 0.5, "offset": 0.1},
        "FL_KFE": {"left": 0.5, "right": -0.5},
    }
    robot = sdpid.load_robot("solo12", root="free_flyer", transmission={"joints": rows})
    run = sdpid.simulate_legged(robot, "trot", duration=1.0, seed=1)
    terms = (*run.friction.terms, "viscous", "rotor_inertia")
    result = sdpid.identify(robot, run.recording, friction=terms, effects="none", intervals=False)
    assert result.certificate.passed
    assert result.training.relative < 0.02
    true = result.problem.base_of(run.theta[: result.problem.n_theta])
    assert result.problem.cost(result.estimate.base) < result.problem.cost(true)
    result.save(tmp_path / "results")
    found = sdpid.verify(tmp_path / "results", data=run.recording)
    assert found.passed, found.problems


def test_a_base_that_is_held_all_the_time_is_proven() -> None:
    """No row has the base's parameters: what is least of the cost may be in no floor."""
    pytest.importorskip("mujoco")
    log = sdpid.simulate_legged("solo12", "hang", duration=2.0, seed=0).recording
    log = replace(log, base=None, contacts=None, velocity=None)
    friction = ("coulomb", "viscous", "rotor_inertia")
    held = log.with_held_base("base_link")
    result = sdpid.identify("solo12", held, friction=friction, effects="none", intervals=False)
    assert result.certificate.passed
    assert result.certificate.gap < 1e-6
    assert result.training.floating is None
    assert "at the base" not in result.headline.error


def test_report_and_words_know_the_base_and_its_contacts(tmp_path: Path) -> None:
    result = identified()
    assert "N.m at the base" in result.headline.error
    assert not [line for line in result.verdict if "root_joint" in line]
    result.save(tmp_path, figures=False)
    report = (tmp_path / "report.html").read_text(encoding="utf-8")
    for words, count in (
        ("FL_FOOT closed, with the filter", 1),
        ("contacts closed at once", 1),
        ("contacts over time", 2),
        ("base, force in N", 1),
    ):
        assert report.count(words) >= count
    back = sdpid.load_robot(tmp_path / "identified.urdf", root="free_flyer")
    masses = result.estimate.theta[: 10 * back.n_links : 10]
    np.testing.assert_allclose(back.prior[:, 0], masses, rtol=1e-6)
    # What the base misses, and what a gait shows.
    (force,) = (line for line in result.verdict if "the force on the base" in line)
    assert force.startswith("Trust it for the force on the base")
    (shown,) = (line for line in result.verdict if "than was believed before them" in line)
    told = int(shown.split(" directions")[0].split()[-3])
    assert 0 < told < result.problem.base.count
    assert "hang it by its base" in shown
    assert result.verdict[0].count("every joint") == 1
    # Which feet were down is drawn.
    gaits = values(result._subject)["gait"]
    assert [each["title"] for each in gaits] == ["training", "validation"]
    downs = result.problem.samples.contacts.down.T
    for (_, bars), down in zip(gaits[0]["rows"], downs, strict=True):
        # Beside the names, which take 190 of 1000.
        assert sum(width for _, width in bars) / 810.0 == pytest.approx(down.mean())


def test_a_robot_that_is_fixed_is_refused() -> None:
    robot, words = sdpid.load_robot("solo12"), "fixed to the ground, and the recording has a float"
    refuses(DataError, words, sdpid.identify, robot, crawl().log())


FIXED: dict[str, Callable[[Identification], object]] = {
    "check_bias": lambda result: sdpid.check_bias(result.estimate),
    "solve_instrumental": lambda result: sdpid.solve_instrumental(result.problem),
    "simulation": lambda result: sdpid.rollout(result.estimate, data()),
    "output error": lambda result: sdpid.solve_output_error(result.problem, data()),
    "payload": lambda result: sdpid.identify_payload(result.problem.robot, data()),
    "gains": lambda result: sdpid.identify_drive_gains(result.problem.robot, data()),
    "excitation": lambda result: sdpid.design_excitation(result.problem.robot, duration=5.0),
    "motion": lambda result: sdpid.simulate(result.problem.robot),
}


@pytest.mark.parametrize("what", FIXED)
def test_what_knows_fixed_robots_only_says_how_to_load_one(what: str) -> None:
    told = f"^{what}: 'solo' has a floating base.*load its URDF without root='free_flyer'"
    refuses(ModelError, told, FIXED[what], identified())


def test_a_robot_that_hangs_is_a_fixed_one(tmp_path: Path) -> None:
    """What refuses a floating base takes the result's URDF, and a recording without a base."""
    sdpid.write_urdf(identified().estimate, target=tmp_path / "identified.urdf")
    hung = sdpid.simulate_legged("solo12", "hang", duration=1.0, seed=1).recording
    path, floating = tmp_path / "hanging.csv", tmp_path / "floating.csv"
    replace(hung, base=None, contacts=None).to_csv(path)
    robot = ["--robot", tmp_path / "identified.urdf"]
    assert json.loads(printed("validate", path, *robot, "--rollout", "--json"))["rollouts"]
    hung.to_csv(floating)
    for command in (["validate", floating, *robot, "--rollout"], ["payload", floating, *robot]):
        assert "floating base" in printed(*command, status=2)


def data() -> sdpid.Recording:
    return noisy(crawl().log()).rows(slice(0, 1500))


def test_a_log_with_contacts_is_made_again(tmp_path: Path) -> None:
    identified().save(tmp_path, figures=False)
    found = sdpid.verify(tmp_path, data=data())
    assert found.passed, found.problems
    assert {"contacts", "weights", "rows"} <= found.log.complete
    assert found.log.gap < 1e-6  # type: ignore[operator]
    assert any("flags are widened by" in each for each in found.made_again)
    # Other flags make other rows, and a scale of forces is positive.
    recipe = tmp_path / "manifest.json"
    kept = recipe.read_text(encoding="utf-8")
    for words, path, value in (
        ("rows: A, rhs and floor", ("processing", "contact_margin_s"), 0.01),
        ("weights: the scale of measured forces is 2.0", ("force_scale",), 2.0),
        ("force_scale", ("force_scale",), -1.0),
    ):
        recipe.write_text(kept, encoding="utf-8")
        edit_json(recipe, set_to(value, "recipe", *path))
        reseal(tmp_path)
        if value == -1.0:
            refuses(CertificateError, words, sdpid.verify, tmp_path, data=data())
            continue
        problems = sdpid.verify(tmp_path, data=data()).problems
        assert any(each.startswith(words) for each in problems), problems


# What the estimators owe to real recordings: the Stäubli TX40, and the second run of an LWR 4+.


WRIST = sdpid.friction.Coupling("joint_5", "joint_6", width=0.05)
TX40_TERMS = (sdpid.friction.Coulomb(width=0.05), "viscous", "offset", "rotor_inertia", WRIST)
FAINT = sdpid.Prior(kind="entropic", strength=1e-3, friction=False)


# What the default prior costs on the data it was trained on, relative to the optimum without one,
# is measured, not promised: 4.4 and 4.8 % of the cost, 2.3 and 2.5 % of the residual. A prior so
# faint that it only chooses where the data hardly do costs next to nothing.
@pytest.mark.parametrize(
    ("consistency", "prior", "cost", "residual"),
    [
        ("pseudo_inertia", sdpid.Prior(), 0.06, 0.03),
        ("spatial_inertia", sdpid.Prior(), 0.06, 0.03),
        ("pseudo_inertia", FAINT, 1e-3, 1e-3),
    ],
)
def test_what_a_prior_costs(
    data_folder: Path, consistency: Consistency, prior: sdpid.Prior, cost: float, residual: float
) -> None:
    folder = data_folder / "staubli_tx40"
    robot = sdpid.load_robot(folder / "tx40.urdf")
    log = sdpid.read_recording(folder / "tx40_rows_0_24750.npz")
    weak, strong = (
        formulate(
            *(robot, log), consistency=consistency, prior=each, friction=TX40_TERMS, effects="none"
        )
        for each in (False, prior)
    )
    best, believing = sdpid.solve_sdp(weak), sdpid.solve_sdp(strong)
    assert weak.cost(believing.base) <= (1.0 + cost) * best.cost
    masses = np.asarray(believing.theta[: 10 * robot.n_links : 10])
    assert masses.max() < robot.prior[:, 0].sum()
    error = sdpid.validate(best).relative
    assert sdpid.validate(believing).relative <= (1.0 + residual) * error


def test_bands_and_grades_hold_on_another_run(data_folder: Path) -> None:
    folder = data_folder / "kuka_lwr4plus"
    robot = sdpid.load_robot(folder / "kuka_lwr4.urdf")
    first, second = (sdpid.read_recording(folder / f"measurements_{run}.npz") for run in (1, 2))
    found = sdpid.identify(robot, first, validation=second, intervals=False)
    fit, samples = found.held_out.fit, found.held_out.samples
    inside = np.abs(samples.effort - fit.effort_predicted) <= fit.effort_band
    assert 0.9 <= inside[moving_rows(samples)].mean() <= 0.99
    blind = grades(found.estimate, found.training, hold_out(found.estimate, found.wls, None))
    trusted = {each.joint for each in blind if each.level == "good"}
    kept = {each.joint for each in graded(samples, fit) if each.level == "good"}
    assert len(trusted) >= 3
    assert trusted <= kept
