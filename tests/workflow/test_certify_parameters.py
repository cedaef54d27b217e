"""Parameters that were found elsewhere, judged against the proven optimum."""

import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid._common.arrays import Array
from sdpid.errors import DataError, ModelError
from sdpid.estimation.constraints.equalities import Fixed
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem
from sdpid.output.tables.parameter_tables import base_table, theta_table
from sdpid.workflow.certify_parameters import (
    GivenParameters,
    Judgment,
    certify_parameters,
    read_given,
)
from tests.helpers import world
from tests.helpers.arm_files import ARM_URDF, write_arm
from tests.helpers.commands import printed, ran, refused, run, told
from tests.helpers.data import make_samples, random_theta
from tests.helpers.forged import written
from tests.helpers.refusals import refuses
from tests.helpers.robots import small_arm

# Costs of two programs with the same optimum agree to this.
SAME = 1e-6


@cache
def solved() -> tuple[Problem, Array, Estimate]:
    """Return a problem, the parameters that made its data, and its optimum."""
    samples, theta = world.samples(small_arm(2), 7, noise=0.1)
    constraints = sdpid.Constraints(margin=1e-4)
    problem = sdpid.build_problem(small_arm(2), samples, constraints=constraints)
    return problem, theta, sdpid.solve_sdp(problem)


def named(theta: Any, **others: float) -> dict[str, float]:
    """Return standard parameters by name, some of them others."""
    values = np.array(theta).tolist()
    return {**dict(zip(solved()[0].base.theta_names, values, strict=True)), **others}


def rigid(theta: Array) -> dict[str, float]:
    """Return the parameters of the links alone."""
    return dict(list(named(theta).items())[:20])


def judged(values: dict[str, float], problem: Problem | None = None) -> Judgment:
    given = GivenParameters(source="other.csv", values=values)
    return certify_parameters(problem or solved()[0], given)


def test_feasible_parameters_have_a_proof_and_a_gap(tmp_path: Path) -> None:
    problem, theta, best = solved()
    found = judged(named(best.theta))
    assert found.feasible is True
    assert found.violations == ()
    assert found.certificate.passed
    assert 0.0 <= found.gap <= 1e-6
    assert "feasible: every constraint holds" in found.summary()
    assert sdpid.verify(written(found.certificate.to_dict(), tmp_path)).passed
    # Worse ones state their own gap.
    found = judged(named(1.2 * theta))
    assert found.feasible is True
    assert found.cost == pytest.approx(problem.cost_of(1.2 * theta), rel=1e-9)
    assert found.gap == pytest.approx(1.0 - best.cost / found.cost, rel=SAME)
    assert found.residuals["given"] > found.residuals["optimum"]
    checked = sdpid.verify(written(found.certificate.to_dict(), tmp_path))
    assert checked.passed
    assert checked.gap == found.gap


def test_broken_constraints_are_named_with_number_and_limit(tmp_path: Path) -> None:
    problem, theta, _ = solved()
    found = judged(named(theta, m_1=-2.0, zz_2=-3.0, Fs1=-0.5))
    assert found.feasible is False
    words = " ".join(found.violations)
    first, second = problem.robot.link_names
    masses = (f"mass of {first} at least", "is -2 kg", "at least 0.0001")
    for each in (*masses, f"consistency of {second}: margin", "Fs1 at least 0: is -0.5"):
        assert each in words
    assert found.summary().splitlines()[1].startswith("not feasible: ")
    # Further conditions, and a link whose mass has no margin.
    others = (Fixed({"m_1": theta[0] + 1.0}),)
    more = problem.constrained(constraints=problem.constraints.replace(others=others))
    words = " ".join(judged(named(theta, m_2=0.0), more).violations)
    assert f"is {theta[0]:.6g}, not {theta[0] + 1.0:g}" in words
    assert f"consistency of {second}: the mass 0 kg has no margin" in words
    # The bound is proven all the same, and the file says what is not.
    checked = sdpid.verify(written(found.certificate.to_dict(), tmp_path))
    assert not checked.passed
    assert any(f"cost less than {found.certificate.lower_bound!r}" in s for s in checked.statements)


def test_parameters_below_the_bound_are_infeasible_and_said_to_be() -> None:
    wide = solved()[0].constraints.replace(margin=0.5)
    problem = solved()[0].constrained(constraints=wide)
    found = judged(named(sdpid.solve_wls(problem).some_theta), problem)
    assert found.feasible is False
    assert found.gap < 0.0
    assert "below the bound" in found.summary()


def test_friction_that_is_not_given_is_the_best_beside_the_links() -> None:
    problem, theta, _ = solved()
    known = {**rigid(1.3 * theta), "Fv2": 0.7}
    found = judged(known)
    assert found.refitted == ("Fs1", "Fs2", "Fv1")
    values = named(found.estimate.theta)
    assert {name: values[name] for name in known} == known
    fixed = problem.constraints.replace(others=(Fixed(known),))
    same = problem.constrained(constraints=fixed)
    assert found.cost == pytest.approx(sdpid.solve_sdp(same).cost, rel=SAME)
    assert "friction refitted with the links held: Fs1, Fs2, Fv1" in found.summary()
    # It obeys its signs.
    turned = replace(problem.samples, effort=-problem.samples.effort)
    against = sdpid.build_problem(problem.robot, turned, constraints=problem.constraints)
    found = judged(rigid(theta), against)
    assert found.feasible is True
    friction = found.estimate.theta[20:]
    assert (friction >= 0.0).all()
    assert friction.max() < 1e-9


@pytest.mark.parametrize("lacks", [(), ("Fs1", "Fv2")])
def test_base_parameters_are_compared_and_audited(lacks: tuple[str, ...]) -> None:
    own = {name: x for name, x in solved()[2].named().items() if name not in lacks}
    found = judged(own)
    assert found.refitted == lacks
    assert found.feasible is not False
    assert abs(found.gap) <= SAME
    assert found.audit is not None
    assert found.certificate.theta is None
    found = judged({**own, "zz2" if "zz2" in own else "zzr2": -1.0})
    assert found.feasible is False
    assert "bodies that have these base parameters: not realisable: " in found.summary()


def test_base_parameters_are_compared_without_a_prior() -> None:
    rng = np.random.default_rng(3)
    robot = replace(small_arm(2), prior=random_theta(small_arm(2), rng)[:20].reshape(2, 10))
    samples = make_samples(robot, random_theta(robot, rng), rng, noise=0.1)
    problem = sdpid.build_problem(robot, samples, prior=sdpid.Prior())
    best = sdpid.solve_sdp(problem)
    found = judged(best.named(), problem)
    assert found.estimate.problem.prior is None
    assert found.cost == pytest.approx(problem.cost(best.base), rel=1e-9)
    whole = judged(named(best.theta), problem)
    assert whole.estimate.problem.prior is not None
    assert "of it for the prior" in whole.summary()
    assert {"given", "optimum", "unconstrained", "description"} == set(whole.residuals)


def test_names_must_be_the_problems_and_complete_and_numbers_a_robots() -> None:
    theta = solved()[1]
    values = named(theta)
    refuses(DataError, r"no parameters Ia1; .*--friction", judged, {**values, "Ia1": 0.1})
    del values["xy_2"]
    words = r"without xy_2\) nor all \d+ base parameters \(without"
    refuses(DataError, words, judged, values)
    for wrong in (1e13, -1e300, 5e-324, float("inf"), float("nan")):
        words = r"other.csv: zz_2 is .*no robot has"
        refuses(DataError, words, judged, named(theta, zz_2=wrong))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_arm(tmp_path)
    return tmp_path


def test_every_format_is_read_alike(tmp_path: Path) -> None:
    problem, _, best = solved()
    for name in ("p.json", "p.yaml"):
        sdpid.write_parameters(best, tmp_path / name)
    theta_table(best).write(tmp_path / "p.csv")
    base_table(best).write(tmp_path / "base.csv")
    for name in ("p.json", "p.yaml", "p.csv", "base.csv"):
        read, standard = read_given(tmp_path / name, problem.robot), name != "base.csv"
        expected = best.named_theta() if standard else best.named()
        assert read.values == pytest.approx(expected, rel=1e-12)
        assert read.standard(problem) == standard


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
    proof, found, config = folder / "proof.json", out / "parameters.json", out / "run.toml"
    ran("identify", log, "--robot", robot, "--out", out, "--no-figures")
    certify = ("certify", found, "--config")
    assert "feasible: every constraint holds (proven)" in printed(
        *certify, config, "--certificate", proof
    )
    ran("verify", proof)
    assert told("certify", robot, "--log", log, "--robot", robot)["feasible"] is True
    table = (out / "parameters.csv").read_text()
    broken, count = re.subn("(?m)^(m_2,kg,)[^,]*", r"\g<1>-1", table)
    assert count == 1
    (folder / "broken.csv").write_text(broken)
    given = ("certify", folder / "broken.csv", "--config", config)
    assert "not feasible: " in printed(*given, status=3)
    for wrong in (
        ("certify", config, "--config", config),
        ("certify", folder / "missing.json", "--config", config),
        (*certify, config, "--certificate", found),
        (*certify, config, "--certificate", folder / "no" / "p.json"),
    ):
        refused(run(*wrong), 2)
    (folder / "odd.toml").write_text("colour = 3\n")
    refused(run(*certify, folder / "odd.toml"), 2, "no option of 'sdpid certify'")
