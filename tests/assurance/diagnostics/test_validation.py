"""Errors of a prediction stay numbers for efforts that are all but zero."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import sdpid
from tests.helpers.identified import arm_theta, identified, moved


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("size", [0.0, 1e-300, 1e-153, 1e-100])
def test_an_effort_that_is_all_but_zero(size: float) -> None:
    samples = moved(arm_theta(), 1)
    estimate = identified(samples).estimate
    effort = np.array(samples.effort)
    effort[:, 0] *= size
    fit = sdpid.validate(estimate, replace(samples, effort=effort))
    assert fit.rmse[0] > 0.0
    assert fit.nrmse[0] > 1e90
    assert fit.r2[0] == -np.inf or fit.r2[0] < -1e90
    assert np.isfinite([fit.nrmse[1], fit.r2[1], fit.relative]).all()
