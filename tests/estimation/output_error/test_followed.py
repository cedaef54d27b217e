"""Sensitivities of a few instants, brought to all stamps."""

from __future__ import annotations

import numpy as np
import pytest

from sdpid.estimation.output_error.followed import _between


@pytest.mark.parametrize("stride", [1, 2, 3, 5])
@pytest.mark.parametrize("count", [50, 51, 52])
def test_between_instants_lie_cubics_and_the_instants_themselves(stride: int, count: int) -> None:
    time = np.arange(count) / 10.0
    last = (count - 1) // stride * stride
    few = np.append(np.arange(0, last, stride), np.arange(last, count))
    values = np.stack([time**3 - time, np.cos(0.3 * time)], axis=1)[:, None]
    found = _between(values[few], stride, count)
    np.testing.assert_allclose(found[few], values[few], rtol=1e-15)
    inside = slice(stride, last - stride)
    np.testing.assert_allclose(found[inside, :, 0], values[inside, :, 0], atol=1e-12)
    np.testing.assert_allclose(found[inside, :, 1], values[inside, :, 1], atol=1e-4)
