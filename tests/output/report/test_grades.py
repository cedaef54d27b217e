"""A joint is trusted on other motion by other motion, or by blocks with a margin."""

from dataclasses import replace

import numpy as np
import pytest

import sdpid
from sdpid.assurance.diagnostics.held_out import HeldOut
from sdpid.assurance.diagnostics.validation import Validation
from sdpid.output.report.grades import EXPLAINED, MARGIN, grades
from sdpid.workflow.result import Identification
from tests.helpers.identified import arm_theta, identified, moved


@pytest.fixture(scope="module")
def alone() -> Identification:
    return identified(moved(arm_theta(), 1))


def with_error(result: Identification, share: float) -> HeldOut:
    """Return blocks whose error is this share of each joint's effort's spread."""
    held_out = result.held_out
    rng = np.random.default_rng(0)
    effort = held_out.samples.effort
    error = share * effort.std(axis=0) * rng.standard_normal(effort.shape)
    fit = Validation.of_prediction(held_out.fit.joint_names, held_out.samples, effort + error)
    return replace(held_out, fit=fit)


def test_blocks_need_a_margin_and_other_motion_does_not(alone: Identification) -> None:
    enough = np.sqrt(1.0 - EXPLAINED)
    for share, expected in (
        (0.9 * enough / MARGIN, [("good", True)]),
        (1.1 * enough / MARGIN, [("caution", False)]),
        (1.1 * enough, [("caution", True)]),
        (3.0 * enough, [("bad", True)]),
    ):
        held_out = with_error(alone, float(share))
        found = grades(alone.estimate, alone.training, held_out)
        assert [(each.level, each.shown) for each in found] == 2 * expected
    other = replace(with_error(alone, float(1.1 * enough / MARGIN)), by="recording")
    found = grades(alone.estimate, alone.training, other)
    assert [(each.level, each.shown) for each in found] == 2 * [("good", True)]


def test_nothing_is_trusted_by_its_training_alone(alone: Identification) -> None:
    found = grades(alone.estimate, alone.training, None)
    assert [(each.level, each.shown) for each in found] == 2 * [("caution", False)]


def test_a_motion_that_leaves_others_open_is_not_trusted() -> None:
    """Its blocks are predicted well, and still other motion within its range is not known."""
    short = identified(moved(arm_theta(), 1, seconds=4.0, noise=20.0, block=10))
    assert short.held_out is not None
    found = grades(short.estimate, short.training, with_error(short, 0.0))
    assert {each.shown for each in found} == {False}


def test_a_joint_without_effort_has_no_grade(alone: Identification) -> None:
    samples = alone.problem.samples
    mask = np.ones(samples.effort.shape, dtype=bool)
    mask[:, 1] = False
    fit = sdpid.validate(alone.estimate, replace(samples, mask=mask))
    assert [each.joint for each in grades(alone.estimate, fit, None)] == [0]
