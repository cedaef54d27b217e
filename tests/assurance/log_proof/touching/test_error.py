"""Errors of contacts' Jacobians, and what they do to a cost, against the same in 50 digits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mpmath as mp
import numpy as np
import pytest

import sdpid
from sdpid._common.arrays import Array
from sdpid.assurance.log_proof.enclosure import U
from sdpid.assurance.log_proof.joints import Joint
from sdpid.assurance.log_proof.regressor import motion
from sdpid.assurance.log_proof.row_error import row_error
from sdpid.assurance.log_proof.touching.jacobians import jacobian_errors
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.problem import Problem
from sdpid.robot.model.contacts.jacobians import contact_jacobians
from tests.assurance.log_proof.equations import DIGITS, exact_jacobian, exact_regressor, numbers
from tests.helpers.legged import FEET, NOISE, RADIUS, gait, quadruped


def exact_jacobians(samples: sdpid.Samples, k: int) -> Any:
    """Return the Jacobians (c, 6, n) of one sample."""
    robot, contacts = quadruped(), samples.contacts
    assert contacts is not None
    found = []
    for name, offset in zip(contacts.frames, contacts.offset, strict=True):
        frame = robot.pin_model.frames[robot.pin_model.getFrameId(name)]
        place = np.array(frame.placement.translation)
        at = frame.parentJoint - 1
        pair = exact_jacobian(robot, samples.position[k], at, place, offset)
        found.append(np.concatenate(pair, axis=1).T)
    return np.array(found, dtype=object)


def test_jacobians_are_within_their_bounds() -> None:
    samples, robot = gait(3).samples, quadruped()
    contacts, tree = samples.contacts, robot.tree
    assert contacts is not None
    assert tree is not None
    joints = [Joint.of(tree, i) for i in range(len(tree.kind))]
    states = motion(tree, robot.offset, samples.position, samples.velocity, samples.acceleration)
    J = contact_jacobians(robot, samples.position, FEET, RADIUS)
    rng = np.random.default_rng(0)
    for spoil in (0.0, 1e-9):
        given = J + spoil * rng.standard_normal(J.shape)
        bounds = jacobian_errors(robot, joints, states, contacts, given)
        assert bounds.max() < 1e3 * U + 10.0 * spoil
        for k in range(3):
            off = given[k] - exact_jacobians(samples, k)
            for part in (0, 1):
                rows = off[:, 3 * part : 3 * part + 3]
                norm = np.array([[mp.norm(list(x)) for x in each.T] for each in rows])
                assert np.all(norm <= bounds[k, :, part])


def least(r: Any, A: Any, C: Any) -> Any:
    """Return the least cost over all forces."""
    n, m = A.shape
    whole = mp.zeros(n + m)
    for i in range(n):
        for j in range(n):
            whole[i, j] = C[i, j]
        for j in range(m):
            whole[i, n + j] = whole[n + j, i] = A[i, j]
    x = mp.lu_solve(whole, mp.matrix([*r, *[0] * m]))
    return sum(r[i] * x[i] for i in range(n))


def costs(problem: Problem, theta: Array) -> tuple[Any, Any]:
    """Return the roots of the cost of the rows as computed, and of the equations of motion."""
    rows = problem.rows
    assert isinstance(rows, RowSource)
    samples = rows.samples
    contacts, touching, block = samples.contacts, rows.contacts(slice(None)), rows.rows(slice(None))
    assert contacts is not None
    assert touching is not None
    computed = true = mp.mpf(0)
    for k in range(samples.n_samples):
        C = numbers(
            problem.sigma
            if touching.covariance is None
            else np.tril(problem.sigma + touching.covariance[k])
            + np.tril(problem.sigma + touching.covariance[k], -1).T
        )
        A = numbers(touching.directions[k][:, touching.active[k]])
        base = numbers(problem.base.matrix).dot(numbers(theta))
        r = numbers(block[k, :, -1]) - numbers(block[k, :, :-1]).dot(base)
        computed += least(r, A, C)
        J = exact_jacobians(samples, k)
        r = numbers(samples.effort[k]) - exact_regressor(
            rows.robot, samples.position[k], samples.velocity[k], samples.acceleration[k]
        ).dot(numbers(theta))
        A = A[:, :0]
        if contacts.forces is None:
            A = np.concatenate([J[i, :3].T for i in np.flatnonzero(contacts.down[k])], axis=1)
        else:
            r = r + sum(J[i].T.dot(numbers(contacts.forces[k, i])) for i in range(contacts.n))
        true += least(r, A, C)
    return mp.sqrt(computed), mp.sqrt(true)


@pytest.mark.parametrize("measured", [False, True])
def test_the_cost_of_the_equations_is_within_the_bound(measured: bool) -> None:
    made = gait(2, seed=3, share=0.7)
    samples = made.measured(0.01 * np.eye(6)) if measured else made.samples
    samples = replace(samples, effort=made.noisy().effort, covariance=np.diag(NOISE**2))
    problem = sdpid.build_problem(
        quadruped(), samples, friction=(), weighting="gls", check_excitation=False
    )
    assert problem.rows is not None
    found = row_error(problem.rows, problem.sigma, "gls", problem.feasible)
    assert found is not None
    rng = np.random.default_rng(1)
    with mp.workdps(DIGITS):
        for theta in (made.theta, rng.standard_normal(len(made.theta))):
            computed, true = costs(problem, theta)
            size = found.at(theta)
            assert abs(computed - true) <= size
            # The bound is worth something.
            assert size < 1e-6 * (1.0 + float(true))


def test_contacts_along_a_line_are_not_bounded() -> None:
    samples = gait(4).samples
    assert samples.contacts is not None
    samples = replace(samples, contacts=replace(samples.contacts, kind="line"))
    problem = sdpid.build_problem(
        quadruped(), samples, friction=(), weighting="gls", check_excitation=False
    )
    assert problem.rows is not None
    found = row_error(problem.rows, problem.sigma, "gls", problem.feasible)
    assert found is not None
    assert found.total == np.inf
