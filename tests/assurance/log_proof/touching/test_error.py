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
from sdpid.assurance.log_proof.touching.forces import ForceErrors, Near
from sdpid.assurance.log_proof.touching.jacobians import JacobianErrors
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.problem import Problem
from sdpid.experiment.processing.contacts.contact_samples import ContactSamples
from sdpid.robot.model.contacts.jacobians import (
    contact_jacobians,
    frame_axes,
    relative_jacobians,
)
from tests.assurance.log_proof.equations import (
    DIGITS,
    ExactMotion,
    exact_jacobian,
    exact_regressor,
    numbers,
)
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
        bounds = JacobianErrors(robot, joints, states, contacts, given).of_columns
        assert bounds.max() < 1e3 * U + 10.0 * spoil
        for k in range(3):
            off = given[k] - exact_jacobians(samples, k)
            for part in (0, 1):
                rows = off[:, 3 * part : 3 * part + 3]
                norm = np.array([[mp.norm(list(x)) for x in each.T] for each in rows])
                assert np.all(norm <= bounds[k, :, part])


def exact_axes(samples: sdpid.Samples, k: int, name: str) -> Any:
    """Return the axes of a frame in the world, as columns (3, 3)."""
    robot = quadruped()
    tree, frame = robot.tree, robot.pin_model.frames[robot.pin_model.getFrameId(name)]
    assert tree is not None
    still = np.zeros(robot.n)
    turns = ExactMotion(tree, robot.offset, samples.position[k], still, still).R
    R, i = numbers(np.array(frame.placement.rotation)), frame.parentJoint - 1
    while i >= 0:
        R, i = turns[i].dot(R), int(tree.parent[i])
    return R


def test_axes_and_links_that_meet_are_within_their_bounds() -> None:
    samples, robot = gait(3).samples, quadruped()
    assert samples.contacts is not None
    contacts = ContactSamples(
        frames=FEET,
        against=(None, FEET[0], None, "base_link"),
        kind=("line",),
        offset=np.array(RADIUS),
        down=samples.contacts.down,
    )
    tree = robot.tree
    assert tree is not None
    joints = [Joint.of(tree, i) for i in range(len(tree.kind))]
    states = motion(tree, robot.offset, samples.position, samples.velocity, samples.acceleration)
    J = relative_jacobians(robot, samples.position, FEET, contacts.against, RADIUS)
    found = JacobianErrors(robot, joints, states, contacts, J)
    bounds = found.of_eliminated(samples.position, np.ones_like(contacts.down))
    assert bounds.max() < 1e3 * U
    axes = frame_axes(robot, samples.position, FEET)
    others = replace(samples, contacts=replace(contacts, frames=("base_link",) * 4, against=()))
    with mp.workdps(DIGITS):
        for k in range(3):
            exact = exact_jacobians(samples, k)
            exact[1] = exact[1] - exact[0]
            exact[3] = exact[3] - exact_jacobians(others, k)[3]
            # The base carries both links, whose places are not one here.
            exact[1][:, :6] = exact[3][:, :6] = mp.mpf(0)
            for i, name in enumerate(FEET):
                off = J[k, i] - exact[i]
                across = exact_axes(samples, k, name)[:, [0, 2]].T.dot(exact[i, 3:])
                moments = axes[k, i][:, [0, 2]].T @ J[k, i, 3:] - across
                for part, rows in enumerate((off[:3], moments)):
                    norm = np.array([mp.norm(list(x)) for x in rows.T])
                    assert np.all(norm <= bounds[k, i, part])
    assert not found.of_eliminated(samples.position, np.zeros_like(contacts.down)).any()


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
            closed = np.flatnonzero(contacts.down[k]).tolist()
            A = np.concatenate([J[i, :3].T for i in closed], axis=1)
            for i in (i for i in closed if contacts.kind[i] == "line"):
                across = exact_axes(samples, k, contacts.frames[i])[:, [0, 2]].T.dot(J[i, 3:])
                A = np.concatenate([A, across.T], axis=1)
        else:
            r = r + sum(J[i].T.dot(numbers(contacts.forces[k, i])) for i in range(contacts.n))
        true += least(r, A, C)
    return mp.sqrt(computed), mp.sqrt(true)


@pytest.mark.parametrize("known", ["nothing", "forces", "lines"])
def test_the_cost_of_the_equations_is_within_the_bound(known: str) -> None:
    made = gait(2, seed=3, share=0.5 if known == "lines" else 0.7)
    samples = made.measured(0.01 * np.eye(6)) if known == "forces" else made.samples
    if known == "lines":
        assert samples.contacts is not None
        lines = replace(samples.contacts, kind=("line", "point", "point", "point"))
        samples = replace(samples, contacts=lines)
    samples = replace(samples, effort=made.noisy().effort, covariance=np.diag(NOISE**2))
    problem = sdpid.build_problem(
        quadruped(), samples, friction=(), weighting="gls", check_excitation=False
    )
    assert problem.rows is not None
    B = problem.base.matrix
    near = Near(A=problem.A, rhs=problem.rhs, relative=1e-9, absolute=1e-6, base=B @ made.theta)
    found = row_error(problem.rows, problem.sigma, "gls", problem.feasible, near=near)
    assert found is not None
    rng = np.random.default_rng(1)
    with mp.workdps(DIGITS):
        for theta in (made.theta, rng.standard_normal(len(made.theta))):
            computed, true = costs(problem, theta)
            size = found.at(theta)
            assert abs(computed - true) <= size
            # The bound is worth something.
            assert size < 1e-6 * (1.0 + float(true))
            if np.all(np.abs(theta) <= found.box.theta):
                assert abs(computed - true) <= found.total + found.share * computed


@pytest.mark.parametrize("rank", [6, 3])
def test_forces_far_from_what_fits_are_told_by_the_cost(rank: int) -> None:
    rng = np.random.default_rng(rank)
    A = np.zeros((6, 6))
    A[:rank] = 1e3 * rng.standard_normal((rank, 6))
    limit = rng.uniform(0.5, 2.0, 6)
    # Forces depend on more than rows show, and hardly on that.
    F = 1e-9 * rng.standard_normal((40, rank)) @ A[:rank]
    F = np.column_stack([F + 1e-15 * rng.standard_normal((40, 6)), rng.standard_normal(40)])
    errors = ForceErrors.of(F)
    base = 0.1 * limit
    rhs = A @ base + 0.1 * rng.standard_normal(6)
    near = Near(A=A, rhs=rhs, relative=0.0, absolute=0.0, base=base)
    share, constant = errors.spread(near, limit)
    assert 0.0 < share < 1e-7
    assert constant < 1e-7
    for _ in range(20):
        beta = rng.uniform(-limit, limit)
        cost = float(np.linalg.norm(A @ beta - rhs))
        assert np.linalg.norm(F[:, :-1] @ (beta - base)) <= share * cost + constant
        assert np.linalg.norm(F @ np.append(beta, -1.0)) <= errors.at(beta, np.zeros(6))
        assert np.linalg.norm(F @ np.append(beta, -1.0)) <= errors.over(limit)


@pytest.mark.parametrize("known", ["depend", "apart"])
def test_errors_of_forces_that_depend_on_each_other_are_not_bounded(known: str) -> None:
    made = gait(4)
    covariance = np.diag([0.01, 0.01, np.inf, 0.0, 0.0, 0.0])
    if known == "depend":
        covariance[0, 1] = covariance[1, 0] = 0.004
    samples = made.measured(covariance)
    problem = sdpid.build_problem(
        quadruped(), samples, friction=(), weighting="gls", check_excitation=False
    )
    assert problem.rows is not None
    found = row_error(problem.rows, problem.sigma, "gls", problem.feasible)
    assert found is not None
    assert np.isfinite(found.total) == (known == "apart")
