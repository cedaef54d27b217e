"""What was held out is predicted by fits that saw nothing of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import sdpid
from sdpid.assurance.diagnostics import blocks as module
from sdpid.assurance.diagnostics.blocks import held_out_blocks, in_blocks, own, predicted_by
from sdpid.assurance.diagnostics.held_out import (
    DESCRIPTION,
    FRICTION_FITTED,
    LEAST_SQUARES,
    hold_out,
)
from sdpid.estimation.problem import Problem, build_problem
from sdpid.experiment.processing.samples import Samples
from tests.helpers.identified import ARM, FRICTION, arm_theta, identified, moved
from tests.helpers.runs import arm, recorded

BLOCK = 20
GUARD = 5


@pytest.fixture(scope="module")
def problem() -> Problem:
    return identified(moved(arm_theta(), 1, block=BLOCK)).problem


def test_a_block_is_predicted_by_the_fit_to_the_rows_outside_it(problem: Problem) -> None:
    found = held_out_blocks(problem)
    assert len(found) == 5
    for block in found:
        (held,) = block.slices
        mask = np.ones((problem.n_samples, 2), dtype=bool)
        mask[max(held.start - GUARD, 0) : held.stop + GUARD] = False
        samples = replace(problem.samples, mask=mask, covariance=problem.sigma)
        alone = build_problem(ARM, samples, friction=FRICTION, weighting="gls")
        expected = sdpid.solve_sdp(alone).base
        np.testing.assert_allclose(block.estimate.base, expected, rtol=1e-5, atol=1e-7)


def test_what_happens_in_a_block_does_not_reach_its_prediction(problem: Problem) -> None:
    samples = problem.samples
    effort = np.array(samples.effort)
    effort[200:400] += 5.0
    rows = replace(problem.require_rows_here("test"), samples=replace(samples, effort=effort))
    changed = replace(problem, rows=rows)
    before, after = (
        predicted_by(held_out_blocks(each), each, {"": own})[""] for each in (problem, changed)
    )
    np.testing.assert_array_equal(before[200:400], after[200:400])
    assert np.abs(before - after).max() > 0.1


def test_every_recording_is_cut_and_short_ones_are_left_alone() -> None:
    theta = arm_theta()
    pieces = [moved(theta, seed, seconds=s, block=BLOCK) for seed, s in ((1, 20.0), (2, 0.5))]
    samples = Samples.join([pieces[0], pieces[1], moved(theta, 3, block=BLOCK)])
    estimate = identified(samples).estimate
    found = held_out_blocks(estimate.problem)
    assert {len(block.slices) for block in found} == {2}
    inside = in_blocks(found, samples.n_samples)
    assert not inside[1000:1025].any()
    assert inside.sum() == 2000
    held = hold_out(estimate, sdpid.solve_wls(estimate.problem), None)
    assert held is not None
    assert held.fit.rows.tolist() == [2000, 2000]


def test_short_records_get_fewer_blocks_or_none() -> None:
    theta = arm_theta()
    for block, count in ((100, 5), (500, 4), (600, 3), (800, 0)):
        assert len(held_out_blocks(identified(moved(theta, 1, block=block)).problem)) == count


def test_blocks_are_not_held_out_where_they_cannot_be(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    samples = replace(problem.samples, covariance=np.eye(2))
    printed = build_problem(ARM, samples, friction=FRICTION, weighting="eq18")
    assert held_out_blocks(printed) == ()
    monkeypatch.setattr(module, "MOST_ROWS", problem.n_rows - 1)
    assert held_out_blocks(problem) == ()


def test_blocks_without_which_nothing_is_determined() -> None:
    """Joint 2 moves in one block only: without it, friction is not determined."""
    samples = moved(arm_theta(), 1, block=BLOCK)
    fields = {name: np.array(getattr(samples, name)) for name in ("velocity", "acceleration")}
    q = np.array(samples.position)
    for each in (*fields.values(), q):
        each[200:, 1] = 0.0
    still = replace(samples, position=q, **fields)
    assert held_out_blocks(identified(still).problem) == ()


def test_an_estimate_stands_beside_what_costs_less() -> None:
    result = sdpid.identify(arm(), recorded(1), validation=recorded(2), intervals=False)
    for fresh, by in ((result.validation_samples, "recording"), (None, "blocks")):
        held = hold_out(result.estimate, result.wls, fresh)
        assert held is not None
        assert held.by == by
        assert list(held.baselines) == [DESCRIPTION, FRICTION_FITTED, LEAST_SQUARES]
        # The recording is of the description's links, with friction that it does not tell.
        errors = {name: fit.relative for name, fit in held.every.items()}
        assert errors[DESCRIPTION] > 2.0 * errors[FRICTION_FITTED]
        assert held.fit.relative < errors[DESCRIPTION]
        assert held.to_dict()["by"] == by
        assert [row[0] for row in held.as_table().rows] == list(held.every)
    np.testing.assert_allclose(
        hold_out(result.estimate, result.wls, result.validation_samples).fit.rmse,
        result.validation.rmse,
    )


def test_a_robot_without_masses_has_no_baselines_of_its_description() -> None:
    result = identified(moved(arm_theta(), 1), robot=replace(ARM, prior=0.0 * ARM.prior))
    held = hold_out(result.estimate, result.wls, None)
    assert held is not None
    assert list(held.baselines) == [LEAST_SQUARES]
