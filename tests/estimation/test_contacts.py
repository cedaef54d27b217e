"""Rows of robots in contact, against dense projections, MuJoCo and measured forces."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.linalg import null_space

import sdpid
from sdpid import RobotModel, Samples
from sdpid._common.arrays import Array
from sdpid.assurance.certificate.rows_digest import rows_digest
from sdpid.assurance.diagnostics.bands import Folds, _left_open, parameter_root, predicted_by
from sdpid.errors import DataError
from sdpid.estimation.compression.contact_noise import contact_noise
from sdpid.estimation.compression.contact_rows import ContactRows
from sdpid.estimation.compression.whitening import weights_and_shares
from sdpid.estimation.problem import Problem
from sdpid.experiment.preparation.prepare import without_efforts
from sdpid.experiment.processing.contact_samples import ContactSamples
from sdpid.experiment.processing.robot_contacts import with_loops
from sdpid.output.report.verdict import _forces
from sdpid.robot.model.closure import close_loops
from sdpid.robot.model.jacobians import contact_jacobians, frame_axes
from tests.helpers import linkages, world
from tests.helpers.legged import FEET, NOISE, RADIUS, gait, quadruped
from tests.helpers.refusals import refuses
from tests.helpers.studies import study

SIGMA = np.diag(NOISE**2)


def problem(samples: Samples, robot: RobotModel | None = None, **given: Any) -> Problem:
    settings: dict[str, Any] = {"friction": (), "weighting": "gls", "check_excitation": False}
    return sdpid.build_problem(robot or quadruped(), samples, **{**settings, **given})


def gram(found: Problem) -> Array:
    """Return the products of the whitened rows, scaled to be compared."""
    rows = np.column_stack([found.A, found.rhs])
    product = rows.T @ rows
    product[-1, -1] += found.floor
    return product


def assert_alike(one: Problem, other: Problem, share: float = 1e-9) -> None:
    a, b = gram(one), gram(other)
    size = np.sqrt(np.diagonal(a))
    np.testing.assert_allclose(a, b, atol=share * np.outer(size, size).max())


def changed(samples: Samples, **given: Any) -> Samples:
    assert samples.contacts is not None
    return replace(samples, contacts=replace(samples.contacts, **given))


def test_the_information_is_that_of_a_dense_projection() -> None:
    made = gait(12)
    rng = np.random.default_rng(1)
    root = rng.normal(size=(18, 18))
    sigma, mask = root @ root.T + np.eye(18), rng.random((12, 18)) < 0.9
    samples = changed(made.samples, kind=("point", "line", "plane", "line"))
    samples = replace(samples, mask=mask)
    robot, contacts = made.robot, samples.contacts
    rows = problem(samples, weighting="gls").rows
    T, index, shares = weights_and_shares(rows, slice(None), sigma)
    touching = rows.contacts(slice(None))
    bases = {k: N for some, Ns in touching.unforced(mask) for k, N in zip(some, Ns, strict=True)}
    J = contact_jacobians(robot, samples.position, FEET, RADIUS)
    axes = frame_axes(robot, samples.position, FEET)
    for k in range(12):
        lost = [np.zeros((0, 18))]
        for i in np.flatnonzero(contacts.down[k]):
            lost.append(J[k, i, :3])
            across = {"point": [], "line": [0, 2], "plane": [0, 1, 2]}[contacts.kind[i]]
            lost.append(axes[k, i].T[across] @ J[k, i, 3:])
        lost.append(np.eye(18)[~mask[k]])
        N = null_space(np.vstack(lost)) if np.vstack(lost).size else np.eye(18)
        expected = N @ np.linalg.solve(N.T @ sigma @ N, N.T)
        np.testing.assert_allclose(T[index[k]].T @ T[index[k]], expected, atol=1e-10)
        assert shares[k].sum() == pytest.approx(N.shape[1])
        np.testing.assert_allclose(bases[k] @ bases[k].T, N @ N.T, atol=1e-12)


def test_samples_without_a_row_in_use_have_no_basis() -> None:
    touching = ContactRows.of(quadruped(), gait(4).samples, slice(None))
    mask = np.repeat([[True], [False], [True], [False]], 18, axis=1)
    assert sorted(np.concatenate([some for some, _ in touching.unforced(mask)])) == [0, 2]


def test_rounding_decides_no_correlation_time() -> None:
    # Beside masked rows of the base, forces take all of a leg's rows: rounding leaves them nothing,
    # or next to nothing.
    samples = gait(240).noisy()
    mask = np.ones((240, 18), dtype=bool)
    mask[::3, :6] = False
    contacts = samples.contacts
    turned = replace(contacts, frames=contacts.frames[::-1], down=contacts.down[:, ::-1])
    rows = problem(replace(samples, mask=mask)).rows
    others = rows.on(replace(rows.samples, contacts=turned))
    found, same = contact_noise(rows), contact_noise(others)
    np.testing.assert_allclose(same[0], found[0], rtol=1e-9)
    assert same[1:] == pytest.approx(found[1:], rel=1e-9)


@pytest.mark.parametrize("std", [0.05, 0.5, 2.0, 20.0, 1e3, 1e6])
def test_measured_forces_are_generalized_least_squares(std: float) -> None:
    """Forces are unknowns of a dense least squares beside their measurements, then eliminated."""
    made = gait(12, seed=5)
    rng = np.random.default_rng(1)
    felt = made.forces + std * rng.normal(size=made.forces.shape)
    samples = replace(made.measured(std**2 * np.eye(6), felt), covariance=SIGMA)
    samples = replace(samples, effort=made.noisy().effort, mask=rng.random((12, 18)) < 0.9)
    found, model = problem(samples), made.robot.pin_model
    data, rows, columns = model.createData(), [], 12 * 12
    for k, (down, used) in enumerate(zip(samples.contacts.down, samples.used, strict=True)):  # type: ignore[union-attr]
        state = (each[k] for each in (samples.position, samples.velocity, samples.acceleration))
        Y = pin.computeJointTorqueRegressor(model, data, *state)[:, found.base.kept]
        pin.computeJointJacobians(model, data, samples.position[k])
        pin.updateFramePlacements(model, data)
        own = np.zeros((18 + 12, columns + found.base.count + 1))
        own[:18, columns:] = np.column_stack([Y, samples.effort[k]]) / NOISE[:, None]
        for i in np.flatnonzero(down):
            frame = model.getFrameId(FEET[i])
            J = pin.getFrameJacobian(model, data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            J = J[:3] - pin.skew(np.array(RADIUS)) @ J[3:]
            at = slice(12 * k + 3 * i, 12 * k + 3 * i + 3)
            own[:18, at] = -J.T / NOISE[:, None]
            own[18 + 3 * i : 21 + 3 * i, at] = np.eye(3) / std
            own[18 + 3 * i : 21 + 3 * i, -1] = felt[k, i] / std
        rows.append(np.vstack([own[:18][used], own[18:]]))
    forces, others = np.split(np.vstack(rows), [columns], axis=1)
    U, s, _ = np.linalg.svd(forces, full_matrices=True)
    left = U[:, np.count_nonzero(s > 1e-12 * s[0]) :].T @ others
    size = np.linalg.norm(left, axis=0)
    np.testing.assert_allclose(gram(found), left.T @ left, atol=1e-10 * np.outer(size, size).max())


def test_a_constant_error_beside_eliminated_forces_is_no_correlation() -> None:
    made, rng = gait(600, seed=3), np.random.default_rng(6)
    poses = [
        pin.integrate(made.robot.pin_model, pin.neutral(made.robot.pin_model), step)
        for step in 0.05 * rng.normal(size=(600, 18))
    ]
    stand = replace(made.samples, position=np.array(poses), velocity=np.zeros((600, 18)))
    stand = changed(stand, down=np.ones((600, 4), dtype=bool))
    found = problem(stand)
    offset = NOISE * np.array([1.0] + [0.0] * 5 + [1.0, -1.0, 1.0] * 4)
    effort = found.rows.regressor(slice(None)) @ found.base_of(made.theta)  # type: ignore[union-attr]
    effort = effort + offset + NOISE * rng.normal(size=(600, 18))
    assert contact_noise(problem(replace(stand, effort=effort)).rows)[1] < 1.5  # type: ignore[arg-type]


def test_fits_are_compared_with_forces_eliminated() -> None:
    made = gait(60)
    felt = replace(made.measured(4.0 * np.eye(6), 1.3 * made.forces), covariance=SIGMA)
    found = problem(replace(felt, effort=made.noisy().effort))
    base, fresh = found.base_of(made.theta), made.noisy(3)
    alike = found.predict(base, replace(felt, effort=fresh.effort)), found.predict(base, fresh)
    assert np.array_equal(*alike)
    folds = Folds((sdpid.solve_wls(found),) * 3, np.arange(60) // 20)
    predicted = predicted_by(folds, found, {"": lambda _: base})[""]
    np.testing.assert_allclose(predicted, found.predict(base, made.noisy()), atol=1e-9)
    # Without efforts, eliminated forces would leave nothing to compare.
    alone = without_efforts(felt, made.robot, made.robot.joint_names[6:])
    assert alone.judged is alone


def test_forces_that_are_not_measured_along_an_axis_are_eliminated_there() -> None:
    made = gait(60)
    wrong = made.forces.copy()
    wrong[:, :, 2] = 1e3
    partly = problem(made.measured(np.diag([0.0, 0.0, np.inf, 0.0, 0.0, 0.0]), wrong))
    contacts = made.samples.contacts
    assert partly.cost(partly.base_of(made.theta)) < 1e-15
    assert partly.n_rows == 60 * 18 - np.count_nonzero(contacts.down)


def test_known_forces_are_efforts() -> None:
    made = gait(60)
    J = contact_jacobians(made.robot, made.samples.position, FEET, RADIUS)
    effort = made.samples.effort + np.einsum("kcin,kci->kn", J[:, :, :3], made.forces)
    without = replace(made.samples, effort=effort, contacts=None)
    found = problem(made.measured(np.zeros((6, 6))))
    assert_alike(found, problem(without))
    assert found.n_rows == problem(without).n_rows
    base = found.base_of(made.theta)
    np.testing.assert_allclose(found.predict(base), made.samples.effort, atol=1e-9)


def test_what_no_foot_feels_and_the_order_of_feet_change_nothing() -> None:
    made = gait(60)
    samples = replace(made.noisy(), covariance=SIGMA)
    # What a sensor shows of a foot in the air, and feet of a robot that flies.
    shown = np.where(made.samples.contacts.down[:, :, None], made.forces, [3.0, -2.0, 5.0])
    known, offset = (problem(made.measured(0.01 * np.eye(6), f)) for f in (made.forces, shown))
    assert np.array_equal(gram(known), gram(offset))
    flying = changed(samples, down=np.zeros((60, 4), dtype=bool))
    assert_alike(problem(flying), problem(replace(samples, contacts=None)))
    # Feet in another order, one of them twice.
    found, contacts = problem(samples), samples.contacts
    order = [2, 0, 3, 1, 2]
    again = ContactSamples(
        frames=[FEET[i] for i in order], offset=RADIUS, down=contacts.down[:, order]
    )
    other = problem(replace(samples, contacts=again))
    assert_alike(found, other)
    assert found.n_rows == other.n_rows
    base = found.base_of(made.theta)
    np.testing.assert_allclose(found.predict(base), other.predict(base), atol=1e-8)


def test_variances_of_joints_base_forces_and_torques_are_found() -> None:
    made = gait(900, seed=3)
    found = problem(made.noisy(4), weighting="residual", prior=sdpid.Prior())
    ratio = np.sqrt(np.diagonal(found.sigma)) / NOISE
    assert 0.9 < ratio.min() < ratio.max() < 1.2
    assert len(np.unique(found.sigma[np.arange(6), np.arange(6)])) == 2
    estimate = sdpid.solve_sdp(found)
    assert sdpid.certify(estimate).passed
    mass = [estimate.theta[0:130:10].sum(), made.theta[0::10].sum()]  # type: ignore[index]
    assert mass[0] == pytest.approx(mass[1], rel=0.01)


@pytest.mark.parametrize("stated", [0.01, 0.1, 2.0, 1000.0])
def test_errors_of_forces_are_found_beside_those_of_efforts(stated: float) -> None:
    made = gait(900, seed=3)
    felt = made.forces + 0.1 * np.random.default_rng(5).normal(size=made.forces.shape)
    fused = replace(made.measured(stated**2 * np.eye(6), felt), effort=made.noisy(4).effort)
    found = problem(fused, weighting="residual", prior=sdpid.Prior())
    ratio = np.sqrt(np.diagonal(found.sigma)) / NOISE
    assert 0.9 < ratio.min() < ratio.max() < 1.2
    _, time, force = contact_noise(found.rows.with_force_scale(1.0))
    assert stated * np.sqrt(force) == pytest.approx(0.1, rel=0.05)
    # Smaller errors than stated are told, and not used.
    assert found.rows.force_scale == pytest.approx(time * max(force, 1.0))
    (told,) = _forces(found)
    assert f"are off by {stated * np.sqrt(force):.2g} N" in told.text
    assert told.level == ("caution" if stated < 0.05 else "good")


def test_the_six_rows_of_the_base_alone_need_no_efforts() -> None:
    made = gait(600, seed=2)
    felt = made.forces + 0.1 * np.random.default_rng(3).normal(size=made.forces.shape)
    known = replace(made.measured(0.01 * np.eye(6), felt), effort=np.zeros((600, 18)))
    joints = made.robot.joint_names[6:]
    alone = without_efforts(known, made.robot, joints)
    found = problem(alone, weighting="residual", prior=sdpid.Prior())
    assert found.n_rows == 600 * 6
    estimate = sdpid.solve_sdp(found)
    assert sdpid.certify(estimate).passed
    assert estimate.theta[:130:10].sum() == pytest.approx(made.theta[::10].sum(), rel=2e-3)
    with pytest.raises(DataError, match="need measured forces of contacts"):
        without_efforts(made.samples, made.robot, joints)


def test_refuses_what_has_no_meaning() -> None:
    samples = gait(12).samples
    refuses(DataError, "'eq18' takes powers of covariances", problem, samples, weighting="eq18")
    refuses(DataError, "'HEEL' is no frame", problem, changed(samples, frames=(*FEET[:3], "HEEL")))
    standing = changed(samples, kind="plane", down=np.ones((12, 4), dtype=bool))
    with pytest.raises(DataError, match="forces of the contacts explain every row"):
        problem(standing, weighting="residual")


def test_what_follows_a_solve_knows_of_contacts(tmp_path: Path) -> None:
    made = gait(400, seed=6)
    noisy = made.noisy(7)
    found = problem(noisy, weighting="residual", prior=sdpid.Prior())
    estimate = sdpid.solve_sdp(found)
    certificate = sdpid.certify(estimate)
    certificate.to_json(tmp_path / "certificate.json")
    assert sdpid.verify(tmp_path / "certificate.json").passed
    assert certificate.passed
    other = changed(noisy, down=~noisy.contacts.down)  # type: ignore[union-attr]
    assert rows_digest(problem(other)) != rows_digest(found)
    errors = sdpid.validate(estimate, gait(200, seed=8).noisy(9))
    # Forces explain a part of the noise of every row.
    assert 0.4 < errors.floating.force / (np.sqrt(3.0) * 0.4) < 1.0
    assert 0.4 < errors.floating.torque / (np.sqrt(3.0) * 0.05) < 1.0
    assert np.all(errors.rows[:6] == 0)
    assert np.all((errors.rmse[6:] / 0.02 > 0.4) & (errors.rmse[6:] / 0.02 < 1.1))
    # What the parameters leave open of predicted efforts is what they move them by, those of
    # gains included: forces explain their part of both.
    fresh, n = gait(20, seed=8).samples, made.robot.n
    deviations = np.where(np.arange(n) < 6, 0.0, 0.02)
    names, covariance = made.robot.joint_names, np.diag(deviations**2)
    gains = sdpid.DriveGains(joint_names=names, gains=np.ones(n), covariance=covariance)
    geared = sdpid.solve_sdp(
        problem(replace(noisy, gains=gains), weighting="residual", prior=sdpid.Prior())
    )
    for each in (estimate, geared):
        root, slopes = parameter_root(each)
        steps = np.hstack([root, slopes * deviations[: slopes.shape[1]]])
        moved = [found.predict(each.base + step, fresh) for step in steps.T]
        open_part = np.linalg.norm(moved - found.predict(each.base, fresh), axis=0)
        np.testing.assert_allclose(_left_open(each, fresh), open_part, rtol=1e-6, atol=1e-9)
    deviations = sdpid.solve_wls(found).standard_errors
    z = (sdpid.solve_wls(found).base - found.base_of(made.theta)) / deviations
    assert 0.7 < np.sqrt(np.mean(z**2)) < 1.3
    with pytest.raises(DataError, match="contacts tie the rows of a sample together"):
        sdpid.cost_of_constraints(estimate)


# ---- Rows of samples in contact beside MuJoCo, with its own contact forces.


# What true parameters may leave of the rows; rounding leaves 1e-12.
EXACT = 1e-8


@pytest.mark.parametrize("turning", [False, True])
def test_the_simulators_contact_forces_leave_nothing(turning: bool) -> None:
    made = study("legged_rows").Beside("solo12", "trot", 0.3, turning=turning)
    assert made.left("plane", known=True) < EXACT
    assert made.left("plane") < EXACT
    if turning:
        # Feet that resist turning are planes.
        assert made.left("point", offset="touched") > 1e-3
        return
    assert 0.3 < made.down.mean() < 0.9
    assert made.left("point", offset="touched") < EXACT
    # Balls sink in by tenths of a millimeter, so that their lowest point is not what is pushed.
    assert EXACT < made.left("point", offset=(0.0, 0.0, -made.legs.radius)) < 2e-3


# ---- A loop that closes is a contact of two links: tests/workflow/test_loops.py identifies such.


def test_truth_leaves_nothing_where_the_loop_is_told() -> None:
    robot, step = sdpid.load_robot(linkages.urdf("four_bar")), 1e-3
    t = np.linspace(0.0, 3.0, 301)

    def closed(t: Array) -> Array:
        crank = 1.0 + t + 0.3 * np.sin(3.0 * t)
        return close_loops(robot, np.outer(crank, [1.0, 0.0, 0.0]), robot.passive)

    before, q, after = (closed(t + k * step) for k in (-1, 0, 1))
    v, a = (after - before) / (2.0 * step), (after - 2.0 * q + before) / step**2
    # What the loop bears does no work: all of it is the motor's.
    power = np.sum(robot.inverse_dynamics(robot.prior.ravel(), q, v, a) * v, axis=1)
    effort = np.outer(power / v[:, 0], [1.0, 0.0, 0.0])
    samples = Samples(position=q, velocity=v, acceleration=a, effort=effort)
    found = problem(with_loops(robot, samples), robot)
    # The pin bears two forces in the plane; across it no joint can move.
    assert found.n_rows == len(effort)
    base, size = found.base_of(robot.prior.ravel()), float(np.sum(effort**2))
    assert found.cost(base) < 1e-9 * size
    assert problem(samples, robot).cost(base) > 0.1 * size
    np.testing.assert_allclose(found.predict(base), effort, atol=1e-4 * np.abs(effort).max())


def test_refuses_a_loop_that_is_open() -> None:
    robot, down = sdpid.load_robot(linkages.urdf("four_bar")), np.ones((60, 1), dtype=bool)
    samples, _ = world.samples(robot, friction=())
    loop = ContactSamples(frames=["coupler"], against=["rocker"], down=down)
    words = "coupler and rocker are up to .* mm apart"
    refuses(DataError, words, problem, replace(samples, contacts=loop), robot)
    own = {"frames": ["a"], "against": ["a"], "down": down}
    refuses(DataError, "expected a frame other than its own", ContactSamples, **own)
