"""Friction is believed and bounded by the size of the efforts, not by that of the robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import sdpid
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.prior.prior import Prior
from sdpid.estimation.problem import Problem, build_problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.experiment.processing.samples import Samples
from tests.helpers.robots import LIFT

ROBOT = sdpid.load_robot(LIFT)
LIMITS = Constraints.of_size(ROBOT)
TERMS = ("coulomb", "viscous", "offset")
# A lift of 10 kg with as much friction as lifts have: N·s/m and N.
VISCOUS, COULOMB = 300.0, 6.0


def moved(weight: float = 1.0) -> Samples:
    """Return exact samples; of its weight the lift's motor carries a share."""
    t = np.arange(0.0, 30.0, 0.02)
    shape = ((0.08, 0.3), (1.2, 1.1))
    q, v, a = (
        np.stack([s * w**k * np.sin(w * t + k * np.pi / 2) for s, w in shape], axis=1)
        for k in range(3)
    )
    rigid = ROBOT.inverse_dynamics(ROBOT.prior, q, v, a)
    rigid[:, 0] -= (1.0 - weight) * rigid[:, 0].mean()
    friction = [VISCOUS, 0.3] * v + [COULOMB, 0.0] * np.sign(v)
    return Samples(position=q, velocity=v, acceleration=a, effort=rigid + friction)


def problem_of(samples: Samples, prior: Prior | None, limits: Constraints = LIMITS) -> Problem:
    return build_problem(
        ROBOT, samples, friction=TERMS, weighting="residual", constraints=limits, prior=prior
    )


def test_the_size_of_a_robot_does_not_bound_its_friction() -> None:
    problem = problem_of(moved(), None)
    assert LIMITS.theta_max < VISCOUS < problem.constraints.friction_max <= 1e5
    found = solve_sdp(problem)
    assert found.named()["Fv1"] == pytest.approx(VISCOUS, rel=1e-3)
    assert found.theta[[0, 10]].sum() == pytest.approx(10.0, rel=1e-3)
    assert sdpid.certify(found).passed
    # Other constraints keep it, and a bound that was given is the bound.
    again = problem.constrained(constraints=LIMITS.replace(mass_max=20.0))
    assert again.constraints.friction_max == problem.constraints.friction_max
    tight = solve_sdp(problem_of(moved(), None, LIMITS.replace(friction_max=VISCOUS / 2)))
    assert tight.named()["Fv1"] == pytest.approx(VISCOUS / 2)
    with pytest.raises(sdpid.errors.DataError, match="friction_max is -1"):
        LIMITS.replace(friction_max=-1.0)


def test_friction_of_a_joint_without_rows_is_believed_to_be_small() -> None:
    samples = moved()
    mask = np.tile([False, True], (samples.n_samples, 1))
    found = solve_sdp(problem_of(replace(samples, mask=mask), Prior()))
    values = found.named()
    assert max(abs(values[name]) for name in ("Fs1", "Fv1", "Fo1")) < 0.1
    errors = sdpid.confidence_intervals(found, parameters=("Fs1", "Fv1"), method="gauss_markov")
    # As large as the efforts of the described links, and no more.
    assert 100.0 < errors.upper[0] < 300.0
    assert errors.upper[1] < problem_of(samples, None).constraints.friction_max


@pytest.mark.parametrize("weight", [1.0, 0.0])
def test_an_offset_may_be_of_the_size_of_the_weight(weight: float) -> None:
    """A counterweight leaves little effort to measure, and masses are what they are."""
    samples = moved(weight)
    noise = 0.01 * np.random.default_rng(0).standard_normal(samples.effort.shape)
    found = solve_sdp(problem_of(replace(samples, effort=samples.effort + noise), Prior()))
    assert found.theta[0] == pytest.approx(8.0, rel=0.3)
    assert found.named()["Fo1"] == pytest.approx(-98.1 * (1.0 - weight), abs=25.0)
