"""The strength by evidence: its formula, what it recovers, and that it is said."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from sdpid.errors import DataError
from sdpid.estimation.prior.evidence import (
    STRONGEST,
    WEAKEST,
    negative_log_evidence,
    strength_by_evidence,
)
from sdpid.estimation.prior.prior import Prior
from sdpid.estimation.problem import build_problem
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.inertia import from_pseudo_inertia, pseudo_inertia
from tests.estimation.prior.test_prior import bodies_of, robot_of
from tests.helpers.strategies import SEEDS

# Of the largest number that differences are taken of: the plain formula solves with a covariance
# that weak beliefs make all but singular, which costs it some ten digits.
DIGITS = 1e-5

STRENGTHS = np.array([0.01, 0.3, 1.0, 7.0, 100.0])


def case(rng: np.random.Generator, count: int = 30, links: int = 8, others: int = 3):
    """Return whitened rows, believed rows and others, of theta with links and other entries."""
    p = links + others
    G, h = rng.normal(size=(count, p)), rng.normal(size=count)
    R, r = rng.normal(size=(links, links)), rng.normal(size=links)
    R = np.hstack([R, np.zeros((links, others))])
    F, f = np.hstack([np.zeros((others, links)), np.eye(others)]), rng.normal(size=others)
    return (G, h), (R, r), (F, f)


@given(SEEDS)
def test_it_is_the_density_of_the_data(seed: int):
    (G, h), (R, r), (F, f) = case(np.random.default_rng(seed))
    found = negative_log_evidence((G, h), (R, r), (F, f), STRENGTHS)
    expected = []
    for strength in STRENGTHS:
        # The data are normal: theta's belief seen through G, and noise.
        rows = np.vstack([np.sqrt(strength) * R, F])
        mean = np.linalg.solve(rows, np.concatenate([np.sqrt(strength) * r, f]))
        root = np.linalg.solve(rows.T, G.T)
        covariance = np.eye(len(h)) + root.T @ root
        error = h - G @ mean
        size = np.linalg.slogdet(covariance)[1]
        expected.append(0.5 * (error @ np.linalg.solve(covariance, error) + size))
    close = DIGITS * np.abs(expected).max()
    assert np.diff(found) == pytest.approx(np.diff(expected), abs=close)


@given(SEEDS)
def test_what_nobody_knows_does_not_matter(seed: int):
    rng = np.random.default_rng(seed)
    (G, h), (R, r), (F, f) = case(rng)
    turn = np.linalg.qr(rng.normal(size=(13, 13)))[0]
    plain = negative_log_evidence((G, h), (R, r), (F, f), STRENGTHS)
    wide = [(np.hstack([M, np.zeros((len(M), 2))]) @ turn, v) for M, v in ((G, h), (R, r), (F, f))]
    found = negative_log_evidence(*wide, STRENGTHS)
    close = DIGITS * np.abs(plain).max()
    assert np.diff(found) == pytest.approx(np.diff(plain), abs=close)


@pytest.mark.parametrize("strength", [0.05, 1.0, 20.0])
def test_the_strength_that_made_the_parameters_is_recovered(strength):
    rng = np.random.default_rng(3)
    links = 60
    R = np.eye(links)
    theta = rng.normal(size=links) / np.sqrt(strength)
    G = 10.0 * rng.normal(size=(200, links))
    h = G @ theta + rng.normal(size=200)
    found = strength_by_evidence((G, h), (R, np.zeros(links)), (np.zeros((0, links)), np.zeros(0)))
    # A variance from 60 draws is known to sqrt(2/60), 18 %; three times that.
    assert abs(np.log(found / strength)) < 0.55
    grid = np.geomspace(WEAKEST, STRONGEST, 400)
    values = negative_log_evidence(
        (G, h), (R, np.zeros(links)), (np.zeros((0, links)), np.zeros(0)), grid
    )
    assert found == pytest.approx(grid[np.argmin(values)], rel=0.03)


def samples_of(robot, truth: np.ndarray, seed: int = 0, **fields) -> Samples:
    rng = np.random.default_rng(seed)
    q, v, a = (rng.normal(size=(300, robot.n)) for _ in range(3))
    effort = robot.inverse_dynamics(truth.ravel(), q, v, a) + 0.05 * rng.normal(size=q.shape)
    return Samples(position=q, velocity=v, acceleration=a, effort=effort, **fields)


@pytest.mark.parametrize("kind", ["euclidean", "scaled_euclidean", "pullback", "entropic"])
def test_a_problem_resolves_it_and_says_so(kind):
    belief = bodies_of(0, 3)
    robot = robot_of(belief)
    samples = samples_of(robot, bodies_of(1, 3))
    prior = Prior(strength="evidence", kind=kind)
    problem = build_problem(robot, samples, prior=prior, weighting="residual")
    strength = problem.prior.strength
    assert WEAKEST <= strength <= STRONGEST
    assert f"prior: strength {strength:.2g} nats by evidence" in problem.prior.notes[-1]
    fixed = Prior(strength=strength, kind=kind)
    again = build_problem(robot, samples, prior=fixed, weighting="residual")
    assert np.array_equal(again.squared.matrix, problem.squared.matrix)
    assert np.array_equal(again.squared.rhs, problem.squared.rhs)
    assert len(again.log_det.links) == (3 if kind == "entropic" else 0)
    if kind == "entropic":
        assert again.log_det.strength == problem.log_det.strength == strength


def test_good_descriptions_are_believed_more_than_bad_ones():
    belief = bodies_of(0, 3)
    robot = robot_of(belief)
    found = []
    for size in (0.01, 0.7):
        rng = np.random.default_rng(1)
        L = np.linalg.cholesky(pseudo_inertia(belief))
        U = rng.normal(size=(3, 4, 4))
        U = np.eye(4) + 0.3 * size * (U + np.swapaxes(U, 1, 2))
        truth = from_pseudo_inertia(L @ U @ np.swapaxes(L, 1, 2))
        prior = Prior(strength="evidence")
        problem = build_problem(robot, samples_of(robot, truth), prior=prior, weighting="residual")
        found.append(problem.prior.strength)
    assert found[0] > 3.0 * found[1]
    assert found[0] > 0.9 * STRONGEST
    bad = build_problem(
        robot, samples_of(robot, 50.0 * truth), prior=prior, weighting="residual"
    ).prior
    assert "the least that is tried" in bad.notes[-1]


def test_it_needs_a_likelihood():
    robot = robot_of(bodies_of(0))
    prior = Prior(strength="evidence")
    samples = samples_of(robot, bodies_of(1))
    for weighting in ("gls", "eq9", "eq18"):
        with pytest.raises(DataError, match="likelihood"):
            build_problem(robot, samples, prior=prior, weighting=weighting)
    known = samples_of(robot, bodies_of(1), covariance=0.05**2 * np.eye(2))
    by_covariance = build_problem(robot, known, prior=prior, weighting="gls")
    assert by_covariance.prior.strength > 0.0
