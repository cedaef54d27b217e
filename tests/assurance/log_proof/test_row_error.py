"""The bound of the rows' error, against the same rows in 50 digits."""

from __future__ import annotations

import pickle
from dataclasses import replace
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sdpid._common.arrays import Array
from sdpid.assurance.log_proof.enclosure import U
from sdpid.assurance.log_proof.row_error import RowError, row_error
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.problem import Problem, build_problem
from sdpid.experiment.processing.samples import Samples
from sdpid.friction import (
    AsymmetricCoulomb,
    Coulomb,
    Coupling,
    Offset,
    RotorInertia,
    SigmoidFriction,
    SquareRootFriction,
    Stribeck,
    Tilt,
    Viscous,
)
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel
from tests.assurance.log_proof.equations import DIGITS, exact_regressor, numbers
from tests.helpers.data import make_samples, random_covariance, random_theta
from tests.helpers.robots import TREE_MIMIC, small_arm
from tests.helpers.strategies import SEEDS

ARM = small_arm(2)
ONE, TWO = ARM.joint_names
PLAIN = (Coulomb(), Viscous(), Offset())

# What is left open beside the efforts that parameters of size one have, in units of rounding.
SHARP = 20_000 * U


def problem_of(
    friction: tuple[FrictionTerm, ...] = PLAIN,
    *,
    robot: RobotModel = ARM,
    seed: int = 0,
    count: int = 6,
    weighting: Any = "gls",
    **fields: Any,
) -> Problem:
    rng = np.random.default_rng(seed)
    theta = random_theta(robot, rng, friction)
    samples = make_samples(robot, theta, rng, count=count, noise=0.1, friction=friction, **fields)
    return build_problem(
        robot, samples, friction=friction, weighting=weighting, check_excitation=False
    )


def found(problem: Problem) -> RowError:
    result = row_error(
        problem.require_rows("test"), problem.sigma, problem.weighting, problem.feasible
    )
    assert result is not None
    return result


def sign(v: Any, width: float) -> Any:
    return mp.tanh(v / width) if width else mp.sign(v)


def shape(term: Any, v: Any, a: Any) -> Any:
    """Return a term's effort for a unit parameter of one joint."""
    if isinstance(term, Coulomb):
        return mp.mpf(0) if abs(v) < term.dead_zone else sign(v, float(term.width or 0.0))
    if isinstance(term, SigmoidFriction):
        return mp.tanh(v / mp.mpf(term.velocity))
    if isinstance(term, Stribeck):
        peak = mp.exp(-((abs(v) / mp.mpf(term.velocity)) ** term.exponent))
        return peak * sign(v, float(term.width or 0.0))
    simple = {
        Viscous: v,
        Offset: mp.mpf(1),
        RotorInertia: a,
        SquareRootFriction: mp.sign(v) * mp.sqrt(abs(v)),
    }
    return simple[type(term)]


def friction_columns(terms: tuple[Any, ...], v: Any, a: Any) -> Any:
    """Return the friction columns (2, parameters) of a sample of two joints."""
    blocks = []
    for term in terms:
        if isinstance(term, Coupling):
            s = sign(v[0] + v[1], float(term.width or 0.0))
            blocks.append(np.array([[a[1], v[1], s], [a[0], v[0], s]]))
        elif isinstance(term, AsymmetricCoulomb):
            s = [sign(x, float(term.width or 0.0)) for x in v]
            blocks += [np.diag([max(x, 0) for x in s]), np.diag([min(x, 0) for x in s])]
        else:
            blocks.append(np.diag([shape(term, *x) for x in zip(v, a, strict=True)]))
    return np.concatenate(blocks, axis=1) if blocks else np.zeros((2, 0))


def rows_of(problem: Problem) -> tuple[Any, Any]:
    """Return true rows (K, n, p) and computed ones (K, n, b), in 50 digits."""
    s = problem.samples
    true = []
    for q, v, a in zip(s.position, s.velocity, s.acceleration, strict=True):
        inertial = exact_regressor(problem.robot, q, v, a)
        friction = friction_columns(problem.friction.terms, numbers(v), numbers(a))
        true.append(np.concatenate([inertial, friction], axis=1))
    computed = problem.require_rows_here("test").rows(slice(None))[:, :, :-1]
    return np.array(true), numbers(computed)


def distance(problem: Problem, theta: Array) -> Any:
    """Return the weighted distance of the two rows' efforts."""
    true, computed = rows_of(problem)
    values = numbers(theta)
    errors = true.dot(values) - computed.dot(numbers(problem.base.matrix).dot(values))
    mask = problem.samples.used
    total = mp.mpf(0)
    for k, error in enumerate(errors):
        used = np.flatnonzero(mask[k])
        sigma = problem.sigma if problem.sigma.ndim == 2 else problem.sigma[k]
        part = mp.matrix(sigma[np.ix_(used, used)].tolist())
        e = mp.matrix(error[used].tolist())
        total += (e.T * mp.lu_solve(part, e))[0] if len(used) else 0
    return mp.sqrt(total)


def check(problem: Problem, seed: int = 0) -> None:
    result = found(problem)
    rng = np.random.default_rng(seed)
    p = problem.n_theta
    box = np.maximum(np.abs(problem.feasible.lower), np.abs(problem.feasible.upper))
    effort = np.abs(problem.samples.effort).max()
    with mp.workdps(DIGITS):
        for theta in (rng.standard_normal(p), box, -box * rng.uniform(0.0, 1.0, p)):
            assert distance(problem, theta) <= mp.mpf(result.at(theta))
    assert result.at(np.ones(p)) < SHARP * 100.0 * (1.0 + effort)
    assert result.at(random_theta(problem.robot, rng, problem.friction.terms)) < result.total


TERMS: tuple[tuple[FrictionTerm, ...], ...] = (
    (),
    (Coulomb(width=0.3), Viscous(), Offset()),
    (Coulomb(dead_zone=2.0), RotorInertia()),
    (AsymmetricCoulomb(), SquareRootFriction()),
    (AsymmetricCoulomb(width=0.5), SigmoidFriction(velocity=2.0)),
    (Coulomb(), Stribeck(velocity=1.5), Stribeck(velocity=1.0, exponent=1.0, width=0.2)),
    (Coulomb(), Coupling(ONE, TWO)),
    (Viscous(), Coupling(ONE, TWO, width=0.4)),
)


@pytest.mark.parametrize("terms", TERMS[:5] + TERMS[6:])
def test_the_bound_holds_for_friction(terms: tuple[FrictionTerm, ...]) -> None:
    problem = problem_of(terms)
    check(problem)
    assert not found(problem).taken_as_computed


@pytest.mark.parametrize("exponent", [1.0, 2.0])
def test_the_bound_holds_for_stribeck(exponent: float) -> None:
    check(problem_of((Coulomb(), Stribeck(velocity=1.5, exponent=exponent, width=0.2))))


@settings(max_examples=5)
@given(SEEDS, st.sampled_from(["gls", "gls_per_sample", "residual"]), st.booleans())
def test_the_bound_holds_for_weights(seed: int, weighting: Any, masked: bool) -> None:
    rng = np.random.default_rng(seed)
    count = None if weighting == "gls" else 8
    fields: dict[str, Any] = {}
    if weighting != "residual":
        fields["covariance"] = random_covariance(rng, 2, count)
    if masked:
        fields["mask"] = rng.uniform(size=(8, 2)) < 0.7
        fields["mask"][0] = True
    check(problem_of(seed=seed, count=8, weighting=weighting, **fields), seed)


@pytest.mark.parametrize("weighting", ["eq9", "eq18"])
def test_the_bound_holds_for_normal_equations(weighting: Any) -> None:
    rng = np.random.default_rng(5)
    covariance = random_covariance(rng, 2, 12)
    problem = problem_of(weighting=weighting, covariance=covariance, count=12)
    result = found(problem)
    assert result.share < 1e-6
    exponent = -0.5 if weighting == "eq9" else -1.0
    with mp.workdps(DIGITS):
        true, computed = rows_of(problem)
        effort = numbers(problem.samples.effort)
        for theta in (rng.standard_normal(problem.n_theta), np.full(problem.n_theta, 1e3)):
            values = numbers(theta)
            base = numbers(problem.base.matrix).dot(values)
            costs = []
            for W, e in (
                (true[:, :, problem.base.kept], effort - true.dot(values)),
                (computed, effort - computed.dot(base)),
            ):
                normal = 0
                for k, sigma in enumerate(problem.sigma):
                    w, V = mp.eigsy(mp.matrix(sigma.tolist()))
                    power = np.array((V * mp.diag([x**exponent for x in w]) * V.T).tolist())
                    normal = normal + W[k].T.dot(power.dot(e[k]))
                costs.append(mp.sqrt(np.sum(normal * normal)))
            bound = mp.mpf(result.share) * costs[1] + mp.mpf(result.at(theta))
            assert abs(costs[0] - costs[1]) <= bound


def test_normal_equations_that_are_singular_have_no_bound() -> None:
    covariance = random_covariance(np.random.default_rng(5), 2, 6)
    assert found(problem_of(weighting="eq9", covariance=covariance)).share == np.inf


def test_a_mimic_joint() -> None:
    robot = load_robot(TREE_MIMIC)
    problem = problem_of((), robot=robot, count=40)
    result = found(problem)
    with mp.workdps(DIGITS):
        true = np.array(
            [
                exact_regressor(robot, q, v, a)
                for q, v, a in zip(
                    problem.samples.position[:3],
                    problem.samples.velocity[:3],
                    problem.samples.acceleration[:3],
                    strict=True,
                )
            ]
        )
        theta = numbers(random_theta(robot, np.random.default_rng(0), ()))
        rows = numbers(problem.require_rows_here("test").rows(slice(0, 3))[:, :, :-1])
        error = true.dot(theta) - rows.dot(numbers(problem.base.matrix).dot(theta))
        assert mp.sqrt(np.sum(error * error)) <= mp.mpf(result.at(theta.astype(float)))


def planted(monkeypatch: pytest.MonkeyPatch, sample: int, joint: int, column: int) -> None:
    """Add 1e-6 to one entry of the rows."""
    rows = RowSource.rows

    def wrong(self: RowSource, part: slice, out: Array | None = None) -> Array:
        block = rows(self, part, out)
        if part.start <= sample < part.stop:
            block[sample - part.start, joint, column] += 1e-6
        return block

    monkeypatch.setattr(RowSource, "rows", wrong)


def test_a_mistake_of_the_regressor_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = problem_of(count=3000)
    before = found(problem)
    column = problem.base.names.index("zz2")
    planted(monkeypatch, 1234, 1, column)
    after = found(problem)
    assert before.total < 1e-6
    assert after.total > 1e-6 * problem.feasible.upper[19]
    assert (after.worst.joint, after.worst.sample) == (TWO, 1234)
    assert after.worst.error == pytest.approx(-1e-6)
    whole = problem.base.matrix[column] != 0.0
    assert after.worst.parameter in np.array(problem.base.theta_names)[whole]


def test_a_mistake_in_a_later_piece_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    one, two = (problem_of(seed=k, count=30).samples for k in (1, 2))
    problem = build_problem(ARM, Samples.join([one, two]), friction=PLAIN)
    planted(monkeypatch, 7, 0, 0)
    worst = found(problem).worst
    assert worst.joint == ONE
    assert worst.sample in (7, 37)  # it is planted in both


@pytest.mark.parametrize("weighting", ["gls", "eq18"])
def test_rows_may_be_elsewhere(weighting: Any) -> None:
    problem = problem_of(weighting=weighting, count=30)
    rows = problem.require_rows_here("test")

    class Sent:
        """Rows of another process: what goes there and comes back is pickled."""

        robot, friction, base, samples, n_samples = ARM, rows.friction, rows.base, rows.samples, 30

        def map(self, function: Any, *arguments: Any, sigma: Array | None = None) -> list[Any]:
            there, given = pickle.loads(pickle.dumps((function, arguments)))
            found: list[Any] = pickle.loads(pickle.dumps(rows.map(there, *given, sigma=sigma)))
            return found

    result = row_error(Sent(), problem.sigma, weighting, problem.feasible)
    assert result is not None
    assert result.total == found(problem).total


def test_a_wrong_regrouping_is_found() -> None:
    problem = problem_of()
    matrix = problem.base.matrix.copy()
    row, column = np.argwhere((matrix != 0.0) & (matrix != 1.0))[0]
    matrix[row, column] *= 1.0 + 1e-7
    base = replace(problem.base, matrix=matrix)
    rows = replace(problem.require_rows_here("test"), base=base)
    wrong = row_error(rows, problem.sigma, problem.weighting, problem.feasible)
    assert wrong is not None
    assert wrong.total > 1e3 * found(problem).total
    assert wrong.worst.parameter == base.theta_names[column]


def test_what_is_taken_as_computed_is_told() -> None:
    problem = problem_of((Coulomb(), Tilt()))
    assert found(problem).taken_as_computed == ("Tilt",)


def test_no_covariance_no_bound() -> None:
    problem = problem_of()
    rows = problem.require_rows("test")
    singular = np.array([[1.0, 1.0], [1.0, 1.0]])
    result = row_error(rows, singular, "gls", problem.feasible)
    assert result.total == np.inf
