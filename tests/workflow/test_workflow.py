"""The whole way: a recording in, certified parameters and a URDF that others load out."""

import json
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio
import pytest

import sdpid
from sdpid.assurance.certificate.certificate import Certificate
from sdpid.assurance.diagnostics.validation import validate_robot
from sdpid.experiment.plant.simulate import true_parameters
from sdpid.experiment.preparation.for_robot import prepare
from sdpid.experiment.processing.choose import default_processing
from sdpid.experiment.recording.joints import match_joints
from sdpid.robot.model.model import RobotModel
from sdpid.workflow.formulate import formulate
from sdpid.workflow.result import Identification
from tests.common.test_progress import Terminal
from tests.helpers.arm_files import ARM_URDF
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
    files = result.save(tmp_path / "deep" / "out", report=notes.append)
    assert {path.name for path in files} == {
        "base_parameters.csv",
        "parameters.csv",
        "manifest.json",
        "result.json",
        "certificate.json",
        "identified.urdf",
        "identified.xml",
        "identified_friction.py",
        "identified_friction.hpp",
        "parameters.json",
        "training.png",
        "validation.png",
        "report.html",
    }
    assert {path.name for path in files[0].parent.iterdir()} == {path.name for path in files}
    folder = files[0].parent
    assert sdpid.verify(folder / "certificate.json").passed
    assert json.loads((folder / "result.json").read_text())["certified"] is True
    loads_elsewhere(folder / "identified.urdf", 6)
    assert notes == []
    assert "relative residual" in result.summary()


def test_the_written_urdf_predicts_as_the_estimate_does(
    result: Identification, log: sdpid.Recording, denso: RobotModel, tmp_path: Path
) -> None:
    sdpid.write_urdf(result.estimate, target=tmp_path / "identified.urdf")
    written = sdpid.load_robot(tmp_path / "identified.urdf", gravity=denso.gravity.tolist())
    samples = prepare(written, log)
    fit = validate_robot(written, samples)
    expected = sdpid.validate(result.estimate, samples)
    np.testing.assert_allclose(fit.effort_predicted, expected.effort_predicted, atol=1e-6)
    assert fit.relative == pytest.approx(expected.relative, rel=1e-6)


def test_nothing_is_left_behind_when_saving_fails(
    result: Identification, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise sdpid.errors.ExportError("no")

    monkeypatch.setattr(Certificate, "to_json", fail)
    with pytest.raises(sdpid.errors.ExportError):
        result.save(tmp_path / "new", figures=False)
    assert not (tmp_path / "new").exists()
    (tmp_path / "old").mkdir()
    with pytest.raises(sdpid.errors.ExportError):
        result.save(tmp_path / "old", figures=False)
    assert list((tmp_path / "old").iterdir()) == []
    (tmp_path / "file").write_text("")
    with pytest.raises(sdpid.errors.ExportError, match="name a folder"):
        result.save(tmp_path / "file", figures=False)


def test_it_says_what_it_is_doing(
    denso: RobotModel, log: sdpid.Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("JPY_PARENT_PID", raising=False)
    monkeypatch.setattr("sys.stderr", terminal := Terminal())
    sdpid.identify(denso, log, intervals=False)
    told = terminal.getvalue()
    stages = ("inspecting", "processing", "choosing the model", "estimating", "holding out")
    assert [words for words in stages if words not in told] == []


def test_few_periods_get_a_pooled_covariance(log: sdpid.Recording) -> None:
    assert default_processing(log).covariance == "period"
    assert default_processing(replace(log, periods=6)).covariance == "pooled"
    assert default_processing(replace(log, periods=1)).covariance is None


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
        assert export["training"]["file"] == pytest.approx(fit.relative, rel=1e-6)
        assert export["training"]["estimate"] == pytest.approx(found.training.relative)
        assert any(f"efforts by {100.0 * fit.relative:.2f} %" in note for note in notes)


def test_panda_with_other_joint_names(data_folder: Path, tmp_path: Path) -> None:
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
    found.save(tmp_path, figures=False)
    loads_elsewhere(tmp_path / "identified.urdf", 7)


def test_joints_in_another_order_are_put_right(log: sdpid.Recording, denso: RobotModel) -> None:
    order = [2, 0, 1, 5, 4, 3]
    names = denso.joint_names
    mixed = replace(
        log,
        position=log.position[:, order],
        effort=log.effort[:, order],
        joint_names=tuple(names[j] for j in order),
    )
    back = match_joints(denso, mixed)
    assert back.joint_names == names
    np.testing.assert_array_equal(back.position, log.position)
    np.testing.assert_array_equal(back.effort, log.effort)


def short(log: sdpid.Recording, **changes: object) -> sdpid.Recording:
    """Return the beginning of a recording, without its periods."""
    fields = {name: getattr(log, name)[:4000] for name in ("time", "position", "effort")}
    cut = sdpid.Recording(**fields, joint_names=log.joint_names)
    return replace(cut, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (("joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "wrist"), "lack joint_6"),
        (("a", "b", "c", "d", "e", "f"), r"joint_names=\[\.\.\.\]"),
    ],
)
def test_names_that_do_not_match_are_refused(
    log: sdpid.Recording, denso: RobotModel, names: tuple[str, ...], message: str
) -> None:
    refuses(sdpid.errors.DataError, message, sdpid.identify, denso, short(log, joint_names=names))


def test_degrees_are_refused(log: sdpid.Recording, denso: RobotModel) -> None:
    with pytest.raises(sdpid.errors.DataError, match="degrees"):
        sdpid.identify(denso, replace(log, position=np.degrees(log.position)))


def test_another_number_of_joints_is_refused(log: sdpid.Recording) -> None:
    refuses(sdpid.errors.DataError, r"6 joints.*has 8", sdpid.identify, "panda", short(log))


def test_a_motion_that_shows_too_little_is_refused(log: sdpid.Recording, denso: RobotModel) -> None:
    still = np.array(log.position)
    still[:, 0] = 0.0
    with pytest.raises(sdpid.errors.IdentifiabilityError, match=r"Fs1|Fv1"):
        sdpid.identify(
            denso,
            replace(log, position=still),
            processing=replace(default_processing(log), reversal_time=None),
        )


@pytest.mark.parametrize("name", ["missing.npz", "log.xlsx"])
def test_files_that_cannot_be_read(denso: RobotModel, tmp_path: Path, name: str) -> None:
    if name != "missing.npz":
        (tmp_path / name).write_text("")
    refuses(sdpid.errors.DataError, name, sdpid.identify, denso, tmp_path / name)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"friction": "coulomb"}, r"\('coulomb',\)"),
        ({"friction": 3}, "friction: is 3"),
        ({"processing": {"cutoff_hz": "10"}}, "cutoff_hz: is '10'"),
        ({"processing": {"order": "2"}}, "order: is '2'"),
        ({"processing": {"cutoff": 10.0, "order": 2}}, "has no setting cutoff;.*cutoff_hz"),
        ({"processing": "fast"}, "processing: is 'fast'"),
    ],
)
def test_arguments_of_a_wrong_kind(arguments: dict[str, object], words: str) -> None:
    with pytest.raises(sdpid.errors.SdpidError, match=words):
        sdpid.identify(arm(), recorded(1), **arguments)  # type: ignore[arg-type]


def test_formulate_takes_what_identify_takes(tmp_path: Path) -> None:
    log = recorded(1)
    log.to_parquet(tmp_path / "run.parquet")
    (tmp_path / "arm.urdf").write_text(ARM_URDF)
    problem = formulate(tmp_path / "arm.urdf", tmp_path / "run.parquet")
    same = formulate(arm(), log)
    np.testing.assert_array_equal(problem.rhs, same.rhs)
    refuses(sdpid.errors.DataError, r"no\.csv", formulate, arm(), tmp_path / "no.csv")
