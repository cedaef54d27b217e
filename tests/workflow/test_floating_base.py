"""`identify` of a robot with a floating base, end to end, from motion with chosen forces."""

import json
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import sdpid
from sdpid.assurance.log_proof.chain.check import check_log
from sdpid.cli import app
from sdpid.errors import CertificateError, DataError, ModelError
from sdpid.experiment.recording.recording import rows_of
from sdpid.output.report.sections.gait import values
from sdpid.verifier.reading import digest
from sdpid.workflow.result import Identification
from tests.experiment.processing.floating.crawl import crawl
from tests.helpers.refusals import refuses

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
        rows_of(log, slice(0, 1500)),
        validation=rows_of(log, slice(1500, 2000)),
        processing={"cutoff_hz": 20.0},
        friction=TERMS,
        effects="none",
    )


def test_a_log_with_a_base_gives_a_floating_robot_with_its_mass() -> None:
    result = identified()
    robot = result.problem.robot
    assert robot.free_flyer
    assert result.certificate.passed
    assert result.intervals is not None
    theta = result.estimate.theta
    mass = theta[: 10 * robot.n_links : 10].sum()
    assert mass == pytest.approx(robot.prior[:, 0].sum(), rel=2e-3)


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


def test_errors_of_joints_and_of_the_base_stand_apart() -> None:
    fit = identified().validation
    # Of 25 N of weight, and efforts with 1 % of noise before the filter.
    assert fit.floating.force < 0.1
    assert fit.floating.torque < 0.02
    assert not fit.rows[:6].any()
    assert fit.moving.relative < 0.02
    held_out = identified().held_out
    described = held_out.baselines["description as it is"]
    assert described.floating is not None
    assert described.moving.relative < 0.05


def test_report_and_words_know_the_base_and_its_contacts(tmp_path) -> None:  # type: ignore[no-untyped-def]
    result = identified()
    assert "N.m at the base" in result.headline.error
    assert not [line for line in result.verdict if "root_joint" in line]
    result.save(tmp_path, figures=False)
    report = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "FL_FOOT closed, with the filter" in report
    assert "contacts closed at once" in report
    assert report.count("contacts over time") == 2
    assert "base, force in N" in report
    back = sdpid.load_robot(tmp_path / "identified.urdf", root="free_flyer")
    np.testing.assert_allclose(
        back.prior[:, 0], result.estimate.theta[: 10 * back.n_links : 10], rtol=1e-6
    )


def test_the_verdict_says_what_the_base_misses_and_what_a_gait_shows() -> None:
    result = identified()
    (force,) = (line for line in result.verdict if "the force on the base" in line)
    assert force.startswith("Trust it for the force on the base")
    (shown,) = (line for line in result.verdict if "than was believed before them" in line)
    told = int(shown.split(" directions")[0].split()[-3])
    assert 0 < told < result.problem.base.count
    assert "hang it by its base" in shown
    assert result.verdict[0].count("every joint") == 1


def test_the_report_draws_which_feet_were_down() -> None:
    result = identified()
    shown = values(result)["gait"]
    assert [each["title"] for each in shown] == ["training", "validation"]
    samples = result.problem.samples
    for row, down in zip(shown[0]["rows"], samples.contacts.down.T, strict=True):
        drawn = sum(bar["width"] for bar in row["bars"]) / (shown[0]["width"] - shown[0]["left"])
        assert drawn == pytest.approx(down.mean())


def test_a_robot_that_is_fixed_is_refused() -> None:
    with pytest.raises(DataError, match="fixed to the ground, and the recording has a floating"):
        sdpid.identify(sdpid.load_robot("solo12"), crawl().log())


@pytest.mark.parametrize(
    ("call", "what"),
    [
        (lambda result, _: sdpid.check_bias(result.estimate), "check_bias"),
        (lambda result, _: sdpid.solve_instrumental(result.problem), "solve_instrumental"),
        (lambda result, log: sdpid.rollout(result.estimate, log), "simulation"),
        (lambda result, log: sdpid.solve_output_error(result.problem, log), "output error"),
        (lambda result, log: sdpid.identify_payload(result.problem.robot, log), "payload"),
        (lambda result, log: sdpid.identify_drive_gains(result.problem.robot, log), "gains"),
        (
            lambda result, _: sdpid.design_excitation(result.problem.robot, duration=5.0),
            "excitation",
        ),
        (lambda result, _: sdpid.simulate(result.problem.robot), "motion"),
    ],
)
def test_what_knows_fixed_robots_only_says_how_to_load_one(call: Any, what: str) -> None:
    told = f"^{what}: 'solo' has a floating base.*load its URDF without root='free_flyer'"
    refuses(ModelError, told, call, identified(), data())


def test_a_robot_that_hangs_is_a_fixed_one(tmp_path: Path) -> None:
    """What refuses a floating base takes the result's URDF, and a recording without a base."""
    sdpid.write_urdf(identified().estimate, target=tmp_path / "identified.urdf")
    hung = sdpid.simulate_legged("solo12", "hang", duration=1.0, seed=1).recording
    path = str(tmp_path / "hanging.csv")
    replace(hung, base=None, contacts=None).to_csv(path)
    robot = ["--robot", str(tmp_path / "identified.urdf")]
    rolled = CliRunner().invoke(app, ["validate", path, *robot, "--rollout", "--json"])
    assert rolled.exit_code == 0, rolled.output
    assert json.loads(rolled.stdout)["rollouts"]
    floating = str(tmp_path / "floating.csv")
    hung.to_csv(floating)
    for command in (["validate", floating, *robot, "--rollout"], ["payload", floating, *robot]):
        refused = CliRunner().invoke(app, command)
        assert refused.exit_code == 2
        assert "floating base" in refused.output


def data() -> sdpid.Recording:
    return rows_of(noisy(crawl().log()), slice(0, 1500))


def sealed_again(folder: Path, edit: Callable[[dict[str, Any], dict[str, Any]], None]) -> None:
    """Change certificate and manifest, and make their digests anew."""
    files = [folder / name for name in ("certificate.json", "manifest.json")]
    certificate, manifest = (json.loads(file.read_text(encoding="utf-8")) for file in files)
    edit(certificate, manifest)
    certificate["sha256"] = digest(certificate)
    for file, content in zip(files, (certificate, manifest), strict=True):
        file.write_text(json.dumps(content), encoding="utf-8")


def test_the_chain_from_the_log_holds_with_contacts(tmp_path: Path) -> None:
    result, certificate = identified(), identified().certificate
    record = certificate.to_dict()["origin"]["contacts"]
    assert record["widened_s"] > 0.0
    assert certificate.to_dict()["compression"] is not None
    result.save(tmp_path, figures=False)
    found = sdpid.verify(tmp_path, data=data())
    assert found.passed, found.problems
    assert {"contacts", "compression", "rows", "total"} <= found.log.proven
    assert found.log.equations.gap < 1e-5  # type: ignore[operator]


def _flags(certificate: dict[str, Any], manifest: dict[str, Any]) -> None:
    manifest["recipe"]["processing"]["contact_margin_s"] = 0.01


def _closed(certificate: dict[str, Any], manifest: dict[str, Any]) -> None:
    certificate["origin"]["contacts"]["closed"][0] -= 1


def _none(certificate: dict[str, Any], manifest: dict[str, Any]) -> None:
    certificate["origin"]["contacts"] = None


def _scale(certificate: dict[str, Any], manifest: dict[str, Any]) -> None:
    manifest["recipe"]["force_scale"] = -1.0


@pytest.mark.parametrize(
    ("edit", "link"),
    [(_flags, "compression"), (_closed, "contacts"), (_none, "contacts")],
)
def test_other_contacts_break_the_chain(edit: Any, link: str, tmp_path: Path) -> None:
    identified().save(tmp_path, figures=False)
    sealed_again(tmp_path, edit)
    found = check_log(tmp_path, data())
    wrong = {each.name for each in found.links if each.state == "not proven"}
    assert link in wrong, found.links
    sealed_again(tmp_path, _scale)
    refuses(CertificateError, "force_scale", check_log, tmp_path, data())
