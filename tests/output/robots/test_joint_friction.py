"""Friction in written files predicts the recordings as well as its form allows."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sdpid
from sdpid._common.arrays import Array
from sdpid.assurance.diagnostics.validation import validate_robot
from sdpid.errors import ExportError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem, build_problem
from sdpid.experiment.preparation.for_robot import SMOOTH
from sdpid.friction import AsymmetricCoulomb, Coulomb, RotorInertia, SigmoidFriction, Viscous
from sdpid.output.robots.export_report import Errors, Written
from sdpid.output.robots.joint_friction import joint_attributes
from sdpid.output.robots.places import Kind
from sdpid.output.robots.urdf_errors import urdf_errors
from sdpid.robot.friction.term import FrictionTerm
from tests.helpers import legged
from tests.helpers.data import full_regressor, random_theta
from tests.helpers.robots import small_arm
from tests.helpers.strategies import SEEDS

ARM = small_arm(2)
URDF: dict[Kind, str] = {Coulomb: "friction", Viscous: "damping"}
MJCF: dict[Kind, str] = {Coulomb: "frictionloss", Viscous: "damping", RotorInertia: "armature"}
Terms = tuple[str | FrictionTerm, ...]
SIGN = Coulomb(width=SMOOTH)


def estimate_of(
    terms: Terms, theta: Array, rng: np.random.Generator, velocity: Array, **fields: Any
) -> Estimate:
    """Return an estimate whose parameters are the truth of its samples."""
    q, a = rng.uniform(-2.0, 2.0, (2, *velocity.shape))
    effort = full_regressor(ARM, (q, velocity, a), terms) @ theta
    effort = effort + 0.1 * rng.standard_normal(effort.shape)
    samples = sdpid.Samples(position=q, velocity=velocity, acceleration=a, effort=effort, **fields)
    problem = build_problem(ARM, samples, friction=terms, check_excitation=False)
    return Estimate.of_theta(problem, theta, method="sdp", status="optimal")


def attributes_of(problem: Problem, theta: Array, places: dict[Kind, str]) -> Array:
    """Return the attributes (kinds, n)."""
    found = joint_attributes(problem, theta, places, "file").values
    return np.array([[found[name][key] for name in ARM.joint_names] for key in places.values()])


def theta_with(rng: np.random.Generator, terms: Terms, *friction: float) -> Array:
    """Return parameters with the same friction at both joints."""
    theta = random_theta(ARM, rng, terms)
    theta[20:] = np.repeat(friction, 2)
    return theta


@given(SEEDS, st.sampled_from([URDF, MJCF]))
def test_no_other_coefficients_predict_the_recordings_better(
    seed: int, places: dict[Kind, str]
) -> None:
    rng = np.random.default_rng(seed)
    terms: Terms = (SIGN, SigmoidFriction(velocity=0.5), Viscous(), RotorInertia())[
        : 1 + len(places)
    ]
    theta = theta_with(rng, terms, *rng.uniform(0.1, 2.0, len(terms)))
    estimate = estimate_of(terms, theta, rng, rng.uniform(-2.0, 2.0, (400, 2)))
    samples = estimate.problem.samples
    best = attributes_of(estimate.problem, theta, places)
    assert np.all(best >= 0.0)
    rigid = ARM.inverse_dynamics(theta, samples.position, samples.velocity, samples.acceleration)
    shapes = [np.tanh(samples.velocity / SMOOTH), samples.velocity, samples.acceleration]

    def cost(values: Array, j: int) -> float:
        friction = sum(value * shape[:, j] for value, shape in zip(values, shapes, strict=False))
        return float(np.sum((samples.effort[:, j] - rigid[:, j] - friction) ** 2))

    for j in range(2):
        least = cost(best[:, j], j)
        for step in (1e-3, 0.1):
            for k in range(len(best)):
                for sign in (-1.0, 1.0):
                    other = best[:, j].copy()
                    other[k] = max(other[k] + sign * step, 0.0)
                    assert cost(other, j) >= least * (1.0 - 1e-12)


def test_terms_with_a_place_are_written_as_they_were_identified(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    terms: Terms = (SIGN, Viscous())
    theta = theta_with(rng, terms, 3.0, 4.0)
    estimate = estimate_of(terms, theta, rng, rng.uniform(-1.0, 1.0, (50, 2)))
    # Other values than the data's: none is fitted.
    theta[20:] = [5.0, 6.0, 7.0, 8.0]
    np.testing.assert_array_equal(
        attributes_of(estimate.problem, theta, URDF), [[5.0, 6.0], [7.0, 8.0]]
    )
    report = sdpid.write_urdf(estimate, target=tmp_path / "arm.urdf")
    assert report.headline() is None
    assert "misses" not in report.describe()


def test_only_what_is_written_must_not_be_negative() -> None:
    rng = np.random.default_rng(6)
    terms: Terms = (SIGN, Viscous(), "offset")
    theta = theta_with(rng, terms, 3.0, 1.0, 1.0)
    estimate = estimate_of(terms, theta, rng, rng.uniform(-1.0, 1.0, (200, 2)))
    theta[20] = -0.1
    assert attributes_of(estimate.problem, theta, URDF).min() > 0.9
    with pytest.raises(ExportError, match="Fs1 of joint 'joint_1' is -0"):
        attributes_of(estimate.problem.without_rows(), theta, URDF)


def test_an_offset_is_friction_only_where_the_motion_cannot_tell() -> None:
    rng = np.random.default_rng(1)
    terms: Terms = (SIGN, Viscous(), "offset")
    theta = theta_with(rng, terms, 3.0, 0.0, 1.0)
    velocity = np.column_stack([rng.uniform(0.3, 1.0, 400), rng.uniform(-1.0, 1.0, 400)])
    estimate = estimate_of(terms, theta, rng, velocity)
    found = attributes_of(estimate.problem, theta, URDF)
    np.testing.assert_allclose(found[0], [4.0, 3.0], atol=0.15)
    (lost,) = joint_attributes(estimate.problem, theta, URDF, "file").left_out
    assert (lost.term, lost.parameters) == ("Offset", ("Fo1", "Fo2"))
    assert lost.worst == pytest.approx(1.0)
    effort = estimate.problem.samples.effort
    assert lost.share == pytest.approx(np.sqrt(effort.size) / np.linalg.norm(effort))


def test_curves_become_what_fits_them_best() -> None:
    """A sigmoid that saturates at once is dry friction; a wide one is damping."""
    rng = np.random.default_rng(2)
    terms: Terms = (Viscous(), SigmoidFriction(velocity=(1e-9, 1e3)))
    theta = theta_with(rng, terms, 0.5, 1.0)
    theta[22:] = [3.0, 4e3]
    estimate = estimate_of(terms, theta, rng, rng.uniform(-2.0, 2.0, (800, 2)))
    wanted = [[3.0, 0.0], [0.5, 4.5]]
    np.testing.assert_allclose(attributes_of(estimate.problem, theta, URDF), wanted, atol=0.05)
    # Without rows the curves themselves are fitted.
    bare = estimate.problem.without_rows()
    np.testing.assert_allclose(attributes_of(bare, theta, URDF), wanted, atol=0.01)
    assert joint_attributes(bare, theta, URDF, "file").notes == ()


def test_a_joint_that_hardly_moves_gets_the_curve_at_nominal_speeds() -> None:
    rng = np.random.default_rng(3)
    terms: Terms = (AsymmetricCoulomb(), Viscous(), "offset")
    theta = theta_with(rng, terms, 2.0, 2.0, 0.5, 3.0)
    velocity = rng.uniform(-1.0, 1.0, (200, 2)) * [1.0, 1e-4]
    estimate = estimate_of(terms, theta, rng, velocity)
    found = attributes_of(estimate.problem, theta, URDF)
    np.testing.assert_allclose(found[:, 1], [2.0, 0.5], atol=1e-6)
    np.testing.assert_allclose(found[:, 0], [2.0, 0.5], atol=0.2)


def test_a_joint_without_effort_too() -> None:
    rng = np.random.default_rng(4)
    terms: Terms = (SIGN, Viscous(), "offset")
    theta = theta_with(rng, terms, 2.0, 0.5, 1.0)
    mask = np.array([[True, False]] * 200)
    velocity = rng.uniform(-1.0, 1.0, (200, 2))
    estimate = estimate_of(terms, theta, rng, velocity, mask=mask)
    found = attributes_of(estimate.problem, theta, URDF)
    np.testing.assert_array_equal(found[:, 1], [2.0, 0.5])


def test_the_told_errors_are_those_of_the_file(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    terms: Terms = (SIGN, SigmoidFriction(velocity=0.3), Viscous(), "offset", RotorInertia())
    theta = theta_with(rng, terms, 2.0, 1.0, 0.5, 1.0, 0.3)
    estimate = estimate_of(terms, theta, rng, rng.uniform(-1.0, 1.0, (300, 2)))
    samples = estimate.problem.samples
    pytest.importorskip("mujoco")
    urdf = sdpid.write_urdf(estimate, target=tmp_path / "arm.urdf")
    mjcf = sdpid.write_mjcf(estimate, target=tmp_path / "arm.xml")
    for report in (urdf, mjcf):
        robot = sdpid.load_robot(report.path, gravity=ARM.gravity.tolist())
        assert report.training.file == pytest.approx(validate_robot(robot, samples).relative)
        assert report.training.estimate == pytest.approx(sdpid.validate(estimate).relative)
        assert f"misses the recorded efforts by {report.training}" in report.describe()
        said = f"misses the recorded efforts by {report.training} (no place for Offset"
        assert str(report.headline()).startswith(said)
        again = report.with_validation(samples)
        assert "misses the validation recording's efforts" in str(again.headline())
        assert again.validation == report.training
        assert again.to_dict()["validation"]["file"] == report.training.file
    # The estimate explains these efforts, neither file does: both warn.
    warning = "more than 2 times as much, predict efforts with estimate.model()"
    for report in (urdf, mjcf):
        assert warning in str(report.headline())
        assert warning in report.describe()
        assert warning in report.with_validation(samples).describe().splitlines()[2]
    assert warning in Errors(file=0.051, estimate=0.025).warning
    assert not Errors(file=0.049, estimate=0.025).warning
    assert not Errors(file=0.019, estimate=0.001).warning
    # They are known before the file is written.
    assert urdf_errors(estimate) == urdf.training
    assert urdf_errors(estimate, samples) == urdf.training
    # The rotor's inertia has a place in one of them.
    assert [lost.term for lost in urdf.left_out] == ["Offset", "RotorInertia"]
    assert [lost.term for lost in mjcf.left_out] == ["Offset"]
    assert mjcf.training.file < urdf.training.file  # type: ignore[union-attr]
    assert "dry friction and damping fitted to the recordings" in urdf.describe()


def test_forces_of_contacts_are_no_friction() -> None:
    """What feet push against must not be taken for friction of the joints."""
    rng = np.random.default_rng(7)
    made = legged.gait(400)
    v = made.samples.velocity[:, 6:]
    effort = np.array(made.samples.effort)
    # Wider than what a file means by dry friction, so that it is fitted anew.
    effort[:, 6:] += 0.3 * np.tanh(v / (3.0 * SMOOTH)) + 0.2 * v
    effort[:, 6:] += 1e-3 * rng.standard_normal(v.shape)
    problem = build_problem(
        made.robot,
        replace(made.samples, effort=effort),
        friction=(Coulomb(width=3.0 * SMOOTH), Viscous()),
        weighting="residual",
        check_excitation=False,
    )
    theta = np.concatenate([made.theta, np.full(12, 0.3), np.full(12, 0.2)])
    found = joint_attributes(problem, theta, URDF, "file")
    assert found.fitted
    for joint in made.robot.joint_names[6:]:
        assert found.values[joint]["friction"] == pytest.approx(0.3, abs=0.03)
        assert found.values[joint]["damping"] == pytest.approx(0.2, abs=0.03)
    estimate = Estimate.of_theta(problem, theta, method="sdp", status="optimal")
    numbers = [found.values[joint] for joint in made.robot.joint_names[6:]]
    written = [np.r_[np.zeros(6), [each[key] for each in numbers]] for key in URDF.values()]
    errors = Written(estimate, (written[0], written[1], np.zeros(18))).errors()
    assert errors.estimate < 0.01
    assert errors.file < 0.05
