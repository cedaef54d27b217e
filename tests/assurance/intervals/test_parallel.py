"""The same results whoever computes them: one thread, several, or a cluster."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid.assurance.intervals.bootstrap import resample
from sdpid.assurance.intervals.intervals import Intervals
from sdpid.errors import DataError
from sdpid.estimation.estimate import Estimate
from tests.helpers.arm import LIGHT, arm_problem


@pytest.fixture(scope="module")
def estimate() -> Estimate:
    return sdpid.solve_sdp(arm_problem(LIGHT))


def profile(estimate: Estimate, n_jobs: int | None = None) -> Intervals:
    return sdpid.confidence_intervals(
        estimate, parameters=estimate.problem.base.names, n_jobs=n_jobs
    )


def test_draws_do_not_depend_on_the_jobs(estimate: Estimate) -> None:
    one = resample(estimate, resamples=60, n_jobs=1)
    two = resample(estimate, resamples=60, n_jobs=2)
    np.testing.assert_array_equal(one.base, two.base)
    # Nor on how many there are: the last job has whatever is left of 25.
    for count in (1, 29, 30):
        fewer = resample(estimate, resamples=count)
        np.testing.assert_array_equal(one.base[:count], fewer.base)
    assert one.lost == 0
    assert one.seconds > 0.0


def test_profile_intervals_do_not_depend_on_the_jobs(estimate: Estimate) -> None:
    one, two = profile(estimate, 1), profile(estimate, 2)
    np.testing.assert_array_equal(one.lower, two.lower)
    np.testing.assert_array_equal(one.upper, two.upper)
    assert one.solves == two.solves >= 2 * len(one)


@pytest.mark.parametrize("n_jobs", [0, 1.5, True])
def test_jobs_that_are_none_are_refused(estimate: Estimate, n_jobs: Any) -> None:
    with pytest.raises(DataError, match="n_jobs"):
        resample(estimate, resamples=5, n_jobs=n_jobs)
    with pytest.raises(DataError, match="n_jobs"):
        sdpid.compare(estimate.problem, starts=1, n_jobs=n_jobs)


@pytest.mark.xdist_group("dask")
@pytest.mark.usefixtures("dask_client")
def test_dask_serves_bootstrap_intervals_and_comparison(
    estimate: Estimate, monkeypatch: pytest.MonkeyPatch
) -> None:
    from joblib import parallel_config
    from joblib._dask import DaskDistributedBackend

    here = resample(estimate, resamples=60), profile(estimate)
    options: dict[str, Any] = {"starts": 2, "max_iterations": 3, "show_progress": False}
    alone = sdpid.compare(estimate.problem, n_jobs=1, **options)
    submit, sent = DaskDistributedBackend.submit, []

    def counted(self: Any, *arguments: Any, **options: Any) -> Any:
        sent.append(self)
        return submit(self, *arguments, **options)

    monkeypatch.setattr(DaskDistributedBackend, "submit", counted)
    with parallel_config(backend="dask"):
        there = resample(estimate, resamples=60), profile(estimate)
        both = sdpid.compare(estimate.problem, **options)
    np.testing.assert_array_equal(here[0].base, there[0].base)
    np.testing.assert_array_equal(here[1].lower, there[1].lower)
    np.testing.assert_array_equal(here[1].upper, there[1].upper)
    assert [row.cost for row in both.rows] == [row.cost for row in alone.rows]
    assert len([row for row in both.rows if row.solver == "slsqp"]) == 2
    # Draws by 25, ends by 8, and local solves: all went to the workers.
    assert len(sent) >= 3 + len(here[1]) // 4 + 2
