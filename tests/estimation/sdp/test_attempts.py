"""Problems that one attempt of the semidefinite program proves and no other does.

Take that attempt out of `sdpid.estimation.sdp.solve._ATTEMPTS`, and its problem here fails.
"""

from __future__ import annotations

from collections.abc import Callable

import pytest

from sdpid.assurance.certificate.certificate import certify
from sdpid.estimation.problem import Problem
from sdpid.estimation.sdp.solve import _ATTEMPTS, solve_sdp
from tests.estimation.sdp.test_solve import ROBOTS, noisy


def unbounded_face() -> Problem:
    """Return a problem that the weighted attempt with little regularization proves."""
    return noisy(ROBOTS["pendulum"], 0, weighting="eq9")


def degenerate_inequality() -> Problem:
    """Return a problem that the attempt with much regularization proves."""
    return noisy(ROBOTS["arm2"], 8, consistency="spatial_inertia", margin=0.005, weighting="eq9")


@pytest.mark.parametrize("hard", [unbounded_face, degenerate_inequality])
def test_hard_problems_are_proven(hard: Callable[[], Problem]) -> None:
    assert certify(solve_sdp(hard())).passed


def test_every_attempt_has_a_reason() -> None:
    reasons = [attempt.reason for attempt in _ATTEMPTS]
    assert all(reasons)
    assert len(set(reasons)) == len(reasons)
