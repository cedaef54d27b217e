"""Draws obey every constraint, and have the distribution that they should."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import sdpid
from sdpid.assurance.sampling.draw import Draws, draw
from sdpid.errors import DataError
from sdpid.estimation.estimate import FEASIBLE, Estimate
from sdpid.robot.inertia import Consistency, margin
from tests.helpers.arm import BODIES, BOTH, CONDITIONS, arm_problem


@cache
def estimate(condition: str = "total", consistency: Consistency = "pseudo_inertia") -> Estimate:
    """Return an estimate on the boundary, under one of the conditions."""
    return sdpid.solve_sdp(arm_problem(*CONDITIONS[condition], consistency=consistency))


@cache
def drawn(condition: str = "total", consistency: Consistency = "pseudo_inertia") -> Draws:
    """Return draws of it."""
    return draw(estimate(condition, consistency), 200, seed=1)


@pytest.mark.parametrize(
    ("condition", "consistency"),
    [(each, BOTH[k % 2]) for k, each in enumerate(("box", "all mass", "symmetric", "fixed link"))],
)
def test_every_draw_obeys_every_constraint(condition: str, consistency: Consistency) -> None:
    found = drawn(condition, consistency)
    feasible = estimate(condition, consistency).problem.feasible
    assert found.theta.shape == (200, len(found.names))
    assert max(feasible.violation(theta) for theta in found.theta) <= FEASIBLE
    moving = [k for k in range(2) if condition != "fixed link" or k == 0]
    margins = margin(found.theta[:, :20].reshape(200, 2, 10)[:, moving], consistency)
    assert np.all(margins > feasible.constraints.margin)
    assert len(np.unique(found.theta, axis=0)) == 200
    assert np.allclose(found.base, found.theta @ estimate(condition).problem.base.matrix.T)


def test_the_same_seed_gives_the_same_draws() -> None:
    again = draw(estimate(), 200, seed=1)
    assert np.array_equal(again.theta, drawn().theta)
    assert not np.array_equal(draw(estimate(), 8, seed=2).theta, again.theta[:8])


def test_fewer_are_the_first_of_more() -> None:
    few = draw(estimate(), 8, seed=1)
    assert np.array_equal(few.theta, drawn().theta[:8])
    assert len(set(few.chain.tolist())) == 8
    assert np.all(few.effective_sizes <= 8)


def test_what_nothing_sees_is_told() -> None:
    (note,) = (each for each in drawn().notes if "neither data nor prior" in each)
    assert "xx_1 in " in note
    prior = sdpid.Prior(bodies=BODIES)
    seen = draw(sdpid.solve_sdp(arm_problem(prior=prior)), 8)
    assert not any("neither data nor prior" in each for each in seen.notes)


def test_what_has_no_posterior_is_refused() -> None:
    problem = estimate().problem
    with pytest.raises(DataError, match="no standard parameters"):
        draw(sdpid.solve_wls(problem), 10)
    with pytest.raises(DataError, match="were not kept with this problem"):
        draw(sdpid.solve_sdp(problem.without_rows()), 10)
    with pytest.raises(DataError, match="nothing but theta_max bounds"):
        draw(sdpid.solve_sdp(problem.constrained(consistency="none")), 10)
    for count in (0, 2.5, True):
        with pytest.raises(DataError, match="count is"):
            draw(estimate(), count)  # type: ignore[arg-type]
