"""Parameters that were found elsewhere, judged against the proven optimum."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import sdpid
from sdpid import cli
from sdpid._common.arrays import Array
from sdpid.errors import DataError, ModelError
from sdpid.estimation.constraints.equalities import Fixed
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem
from sdpid.output.tables.parameter_tables import base_table, theta_table
from sdpid.workflow.certify_parameters import certify_parameters
from sdpid.workflow.given_parameters import GivenParameters, read_given
from tests.helpers.arm_files import ARM_URDF, arm_log
from tests.helpers.data import make_samples, random_theta
from tests.helpers.refusals import refuses
from tests.helpers.robots import small_arm

# Costs of two programs with the same optimum agree to this.
SAME = 1e-6


@cache
def arm() -> tuple[Problem, Array, Estimate]:
    """Return a problem, the parameters that made its data, and its optimum."""
    rng = np.random.default_rng(7)
    robot = small_arm(2)
    theta = random_theta(robot, rng)
    samples = make_samples(robot, theta, rng, noise=0.1)
    constraints = sdpid.Constraints(margin=1e-4)
    problem = sdpid.build_problem(robot, samples, constraints=constraints)
    return problem, theta, sdpid.solve_sdp(problem)


def named(problem: Problem, theta: Array) -> dict[str, float]:
    return dict(zip(problem.base.theta_names, theta.tolist(), strict=True))


def given(values: dict[str, float], **more: Any) -> GivenParameters:
    return GivenParameters(source="other.csv", values=values, **more)


def test_the_optimum_itself_is_certified(tmp_path: Path) -> None:
    problem, _, best = arm()
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
    problem, theta, best = arm()
    found = certify_parameters(problem, given(named(problem, 1.2 * theta)))
    assert found.feasible is True
    assert found.cost == pytest.approx(problem.cost_of(1.2 * theta), rel=1e-9)
    assert found.gap == pytest.approx(1.0 - best.cost / found.cost, rel=SAME)
    assert found.residuals["given"] > found.residuals["optimum"]
    found.certificate.to_json(tmp_path / "proof.json")
    checked = sdpid.verify(tmp_path / "proof.json")
    assert checked.passed
    assert checked.gap == found.gap


def test_broken_constraints_are_named_with_number_and_limit(tmp_path: Path) -> None:
    problem, theta, _ = arm()
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
    found.certificate.to_json(tmp_path / "proof.json")
    checked = sdpid.verify(tmp_path / "proof.json")
    assert not checked.passed
    assert any(f"cost less than {found.certificate.lower_bound!r}" in s for s in checked.statements)


def test_parameters_below_the_bound_are_infeasible_and_said_to_be() -> None:
    problem = arm()[0]
    wide = problem.constraints.replace(margin=0.5)
    problem = sdpid.build_problem(problem.robot, problem.samples, constraints=wide)
    wls = sdpid.solve_wls(problem)
    found = certify_parameters(problem, given(named(problem, wls.some_theta)))
    assert found.feasible is False
    assert found.gap < 0.0
    assert "below the bound" in found.summary()


def test_friction_that_is_not_given_is_the_best_beside_the_links() -> None:
    problem, theta, _ = arm()
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
    problem, theta, _ = arm()
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
    problem, _, best = arm()
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
    problem, theta, _ = arm()
    values = named(problem, theta)
    with pytest.raises(DataError, match=r"no parameters Ia1; .*--friction"):
        certify_parameters(problem, given({**values, "Ia1": 0.1}))
    del values["xy_2"]
    with pytest.raises(DataError, match=r"without xy_2\) nor all \d+ base parameters \(without"):
        certify_parameters(problem, given(values))


@pytest.mark.parametrize("wrong", [1e13, -1e300, 5e-324, float("inf"), float("nan")])
def test_numbers_that_no_robot_has_are_refused(wrong: float) -> None:
    problem, theta, _ = arm()
    with pytest.raises(DataError, match=r"other.csv: zz_2 is .*no robot has"):
        certify_parameters(problem, given({**named(problem, theta), "zz_2": wrong}))


# -------------------------------------------------------------------- files


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "arm.urdf").write_text(ARM_URDF)
    t, q, tau = arm_log(tmp_path / "arm.urdf")
    np.savez(tmp_path / "log.npz", t=t, q=q, tau=tau)
    return tmp_path


def run(*arguments: Any) -> Any:
    return CliRunner().invoke(cli.app, [str(argument) for argument in arguments])


def test_every_format_is_read_alike(folder: Path) -> None:
    problem, _, best = arm()
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
    assert run("identify", log, "--robot", robot, "--out", out, "--no-figures").exit_code == 0
    proof = folder / "proof.json"
    config = ("--config", out / "run.toml")
    done = run("certify", out / "parameters.json", *config, "--certificate", proof)
    assert done.exit_code == 0, done.output
    assert "feasible: every constraint holds (proven)" in done.stdout
    assert run("verify", proof).exit_code == 0
    done = run("certify", robot, "--log", log, "--robot", robot, "--json")
    assert done.exit_code == 0, done.output
    assert '"feasible": true' in done.stdout
    broken = (out / "parameters.csv").read_text().splitlines()
    broken = [
        ",".join([*line.split(",")[:2], "-1"]) if line.startswith("m_2,") else line
        for line in broken
    ]
    (folder / "broken.csv").write_text(
        "\n".join(",".join(line.split(",")[:3]) for line in broken) + "\n"
    )
    done = run("certify", folder / "broken.csv", *config)
    assert done.exit_code == 3, done.output
    assert "not feasible: " in done.stdout
    for wrong in (
        ("certify", out / "run.toml", *config),
        ("certify", folder / "missing.json", *config),
        ("certify", out / "parameters.json", *config, "--certificate", out / "parameters.json"),
        ("certify", out / "parameters.json", *config, "--certificate", folder / "no" / "p.json"),
    ):
        done = run(*wrong)
        assert done.exit_code == 2, done.output
        assert done.stderr.startswith("sdpid: ")
        assert "Traceback" not in done.output
    (folder / "odd.toml").write_text("colour = 3\n")
    done = run("certify", out / "parameters.json", "--config", folder / "odd.toml")
    assert done.exit_code == 2
    assert "no option of 'sdpid certify'" in done.stderr
