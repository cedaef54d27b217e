"""Two-stage least squares as an ordinary problem, against its textbook form on dense rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import fractional_matrix_power

import sdpid
from sdpid._common.arrays import Array
from sdpid.errors import DataError, IdentifiabilityError
from sdpid.estimation.cluster_robust import ScoreBlocks
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.whitening import whiten
from sdpid.estimation.instrumental.hausman import Contrast
from sdpid.estimation.instrumental.moments import Columns
from sdpid.estimation.instrumental.second_stage import FirstStage, require_instrumentable
from sdpid.estimation.problem import Problem
from sdpid.experiment.processing.samples import Samples
from tests.helpers.identified import ARM, FRICTION, arm_theta, moved

SIGMA = np.array([[1.0, 0.3], [0.3, 2.0]])
PRIOR = sdpid.Prior(bodies=arm_theta()[:20].reshape(2, 10))
USED = np.random.default_rng(0).random((1000, 2)) > 0.2


def noisy(samples: Samples, seed: int, size: float = 0.02) -> Samples:
    """Return the samples with noise on their states, the more on the higher derivatives."""
    noise = size * np.random.default_rng(seed).standard_normal((3, *samples.effort.shape))
    return replace(
        samples,
        position=samples.position + noise[0],
        velocity=samples.velocity + 5.0 * noise[1],
        acceleration=samples.acceleration + 20.0 * noise[2],
    )


@pytest.fixture(scope="module")
def clean() -> Samples:
    joined = [moved(arm_theta(), seed, noise=0.05, seconds=10.0) for seed in (1, 2)]
    return replace(Samples.join(joined), block=20, mask=USED, covariance=SIGMA)


@pytest.fixture(scope="module")
def problem(clean: Samples) -> Problem:
    return sdpid.build_problem(ARM, noisy(clean, 3), friction=FRICTION)


def dense(problem: Problem, samples: Samples) -> Array:
    """Return whitened rows (K n, b + 1), efforts last."""
    rows = RowSource(ARM, problem.friction, problem.base, samples).rows(slice(None))
    return whiten(rows, SIGMA, USED).reshape(-1, problem.base.count + 1)


def test_the_second_stage_is_two_stage_least_squares(problem: Problem, clean: Samples) -> None:
    instruments = noisy(clean, 4)
    stage = FirstStage.of_motion(Columns.of(problem), instruments).second("of a test")
    found = stage.problem
    own, Z = dense(problem, problem.samples), dense(problem, instruments)[:, :-1]
    W, y = own[:, :-1], own[:, -1]
    fit = np.linalg.solve(Z.T @ W, Z.T @ y)
    X = Z @ np.linalg.lstsq(Z, W, rcond=None)[0]
    np.testing.assert_allclose(sdpid.solve_wls(found).base, fit, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.A.T @ found.A, X.T @ X, rtol=1e-9, atol=1e-9)
    # Its cost is that of the projected residuals, and the rest of the residuals' at its own fit.
    for base in (fit, 1.1 * fit):
        projected = np.sum((X @ np.linalg.solve(X.T @ X, X.T @ (y - W @ base))) ** 2)
        expected = projected + np.sum((y - W @ fit) ** 2)
        assert found.cost(base) == pytest.approx(expected, rel=1e-9)
    # The sandwich of instruments and residuals; blocks do not cross from piece to piece.
    scores = (X * (y - W @ fit)[:, None]).reshape(-1, 40, X.shape[1]).sum(axis=1)
    inverse = np.linalg.inv(X.T @ X)
    plain = np.sqrt(np.diag(inverse @ scores.T @ scores @ inverse))
    errors = np.sqrt(np.diag(ScoreBlocks.of(found).covariance))
    # Blocks of 20 samples; what is left over of the leverage correction is a few per cent.
    assert np.all((errors > 0.9 * plain) & (errors < 1.5 * plain))
    # Shea's partial R²: the variance of least squares over that with instruments.
    ratio = np.diag(np.linalg.inv(W.T @ W)) / np.diag(inverse)
    np.testing.assert_allclose(stage.relevance, ratio, rtol=1e-6)
    assert stage.weak == ()


def test_block_sums_of_the_test_of_bias_are_corrected_for_leverage(
    problem: Problem, clean: Samples
) -> None:
    instruments = noisy(clean, 4)
    first = FirstStage.of_motion(Columns.of(problem), instruments)
    found = Contrast.of(first, 20).sums
    own, Z = dense(problem, problem.samples), dense(problem, instruments)[:, :-1]
    W, y = own[:, :-1], own[:, -1]
    fit = np.linalg.solve(Z.T @ W, Z.T @ y)
    rows = RowSource(ARM, problem.friction, problem.base, problem.samples)
    unseen = rows.regressor(slice(None)) @ fit
    others = rows.on(instruments).regressor(slice(None))
    unseen -= others @ np.linalg.lstsq(Z, W, rcond=None)[0] @ fit
    v = whiten(unseen[:, :, None] * np.eye(2), SIGMA, USED).reshape(-1, 2)
    v -= W @ np.linalg.lstsq(W, v, rcond=None)[0]
    hat = W @ np.linalg.pinv(W)
    residual = y - hat @ y
    plain, freed = [], []
    for start in range(0, len(W), 40):
        rows_of = slice(start, start + 40)
        root = fractional_matrix_power(np.eye(40) - hat[rows_of, rows_of], -0.5).real
        plain.append(v[rows_of].T @ residual[rows_of])
        freed.append(v[rows_of].T @ root @ residual[rows_of])
    np.testing.assert_allclose(found.sum(axis=0), np.sum(plain, axis=0), rtol=1e-6)
    expected = np.array(freed) - np.mean(freed, axis=0)
    np.testing.assert_allclose(found - found.mean(axis=0), expected, rtol=1e-6, atol=1e-6)


def test_two_halves_correct_least_squares_for_their_difference(
    problem: Problem, clean: Samples
) -> None:
    halves = noisy(clean, 5), replace(noisy(clean, 6), effort=clean.effort[::-1])
    mean = replace(
        clean,
        **{
            name: 0.5 * (getattr(halves[0], name) + getattr(halves[1], name))
            for name in ("position", "velocity", "acceleration", "effort")
        },
    )
    whole = sdpid.build_problem(ARM, mean, friction=FRICTION, base=problem.base)
    found = FirstStage.of_halves(Columns.of(whole), *halves).second("of a test").problem
    A, B = (dense(problem, half) for half in halves)
    cross = A[:, :-1].T @ B[:, :-1]
    target = B[:, :-1].T @ A[:, -1] + A[:, :-1].T @ B[:, -1]
    fit = np.linalg.solve(cross + cross.T, target)
    np.testing.assert_allclose(sdpid.solve_wls(found).base, fit, rtol=1e-8, atol=1e-10)


def test_exact_instruments_take_the_bias_away(clean: Samples) -> None:
    truth = arm_theta()
    errors = []
    for seed in range(20):
        measured = noisy(moved(truth, 1, noise=0.05, noise_seed=seed), 100 + seed, 0.05)
        own = sdpid.build_problem(ARM, replace(measured, block=20), friction=("viscous", "offset"))
        exact = moved(truth, 1, noise=0.0)
        second = sdpid.solve_instrumental(own, instruments=exact, solver=sdpid.solve_wls)
        least = sdpid.solve_wls(own)
        j = own.base.names.index("zz2")
        errors.append(
            [
                e.base[j] - second.problem.base_of(_without_coulomb(truth))[j]
                for e in (least, second)
            ]
        )
    bias = np.abs(np.mean(errors, axis=0))
    assert bias[1] < 0.3 * bias[0]


def _without_coulomb(theta: Array) -> Array:
    bodies = 10 * ARM.n_links
    return np.concatenate([theta[:bodies], theta[bodies + ARM.n :]])


def test_constraints_prior_and_proof_are_those_of_any_problem(
    problem: Problem, clean: Samples
) -> None:
    with_prior = sdpid.build_problem(
        ARM, problem.samples, friction=FRICTION, weighting="residual", prior=PRIOR
    )
    second = sdpid.solve_instrumental(with_prior, instruments=noisy(clean, 4))
    assert (second.method, second.rounds, second.status) == ("instrumental", 1, "optimal")
    assert second.feasible
    certificate = sdpid.certify(second)
    assert certificate.passed
    assert certificate.summary().startswith("of the problem of the last instruments (the motion")
    assert certificate.to_dict()["compression"] is not None
    again = sdpid.certify(sdpid.solve_instrumental(with_prior, instruments=noisy(clean, 5)))
    digests = [each.to_dict()["origin"]["rows_sha256"] for each in (certificate, again)]
    assert digests[0] != digests[1]
    assert len(sdpid.confidence_intervals(second, method="gauss_markov")) > 0
    assert second.compare_to(sdpid.solve_sdp(with_prior)).table()
    assert "no more" in second.problem._repr_html_()


def test_what_the_data_do_not_show_is_left_to_the_prior(clean: Samples) -> None:
    mask = clean.used.copy()
    mask[:, 1] = False
    own = replace(noisy(clean, 3), mask=mask, covariance=None)
    problem = sdpid.build_problem(ARM, own, friction=FRICTION, weighting="residual", prior=PRIOR)
    second = sdpid.solve_instrumental(problem, instruments=noisy(clean, 4))
    relevance = dict(zip(problem.base.names, second.relevance, strict=True))
    assert relevance["Fv2"] == 0.0
    assert relevance["Fv1"] > 0.8
    assert second.weak == ()


def test_instruments_that_do_not_move_with_the_robot_are_refused(
    problem: Problem, clean: Samples
) -> None:
    rng = np.random.default_rng(0)
    other = replace(
        clean,
        position=rng.standard_normal(clean.effort.shape),
        velocity=rng.standard_normal(clean.effort.shape),
        acceleration=rng.standard_normal(clean.effort.shape),
    )
    with pytest.raises(IdentifiabilityError, match="does not move with the measured motion"):
        sdpid.solve_instrumental(problem, instruments=other)


def test_weak_instruments_are_named(problem: Problem, clean: Samples) -> None:
    second = sdpid.solve_instrumental(
        replace(problem), instruments=noisy(clean, 7, size=0.6), solver=sdpid.solve_wls
    )
    assert second.weak
    assert "weak for" in second.message


@pytest.mark.parametrize("weighting", ["eq9", "eq18"])
def test_problems_without_rows_are_refused(problem: Problem, weighting: str) -> None:
    normal = sdpid.build_problem(ARM, problem.samples, friction=FRICTION, weighting=weighting)
    with pytest.raises(DataError, match=f"check_bias: the cost of weighting '{weighting}'"):
        sdpid.check_bias(normal, instruments=problem.samples)


def test_other_problems_are_refused_before_a_solve(problem: Problem, clean: Samples) -> None:
    with pytest.raises(DataError, match="instruments: the rows of the 1000 samples"):
        require_instrumentable(problem.without_rows(), "instruments")
    second = sdpid.solve_instrumental(problem, instruments=clean)
    with pytest.raises(DataError, match="not that of the measured samples"):
        sdpid.solve_instrumental(second.problem, instruments=clean)
    with pytest.raises(DataError, match="robust loss"):
        sdpid.solve_instrumental(sdpid.solve_robust(problem).problem, instruments=clean)
    with pytest.raises(DataError, match="needs the recording that the problem was built of"):
        sdpid.solve_instrumental(problem)
    with pytest.raises(DataError, match="instruments: is 'magic'"):
        sdpid.solve_instrumental(problem, instruments="magic")
    with pytest.raises(DataError, match="do not stand beside"):
        sdpid.solve_instrumental(problem, instruments=clean.between(0, 500))
    with pytest.raises(DataError, match="max_iterations: is 0"):
        sdpid.solve_instrumental(problem, instruments=clean, max_iterations=0)
