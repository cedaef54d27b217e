"""The call of IPOPT: limits hold at every step, and the best point is kept."""

import numpy as np
import pytest
from scipy.sparse import csr_array

from sdpid.excitation.search.ipopt import minimize


def bowl(x: np.ndarray) -> tuple[float, np.ndarray]:
    target = np.array([2.0, 0.5, -3.0])
    return float(np.sum((x - target) ** 2)), 2.0 * (x - target)


BOX = (csr_array(np.eye(3)), np.full(3, -1.0), np.full(3, 1.0))


class Ball:
    """1 - x² is at least zero."""

    pattern = np.ones((1, 3), dtype=bool)

    def values(self, x: np.ndarray) -> np.ndarray:
        return np.array([1.0 - x @ x])

    def derivative(self, x: np.ndarray) -> np.ndarray:
        return -2.0 * x[None, :]


def test_the_best_point_within_linear_limits_is_found() -> None:
    found = minimize(bowl, np.zeros(3), BOX, None, most_steps=100, stop=lambda *_: False)
    np.testing.assert_allclose(found.x, [1.0, 0.5, -1.0], atol=1e-3)
    assert np.all(np.abs(found.x) <= 1.0)
    assert found.value == bowl(found.x)[0]
    assert not found.stopped


def test_the_best_point_within_nonlinear_limits_is_found() -> None:
    found = minimize(bowl, np.zeros(3), BOX, Ball(), most_steps=100, stop=lambda *_: False)
    target = np.array([2.0, 0.5, -3.0])
    np.testing.assert_allclose(found.x, target / np.linalg.norm(target), atol=1e-2)
    assert found.x @ found.x <= 1.0 + 1e-5


@pytest.mark.parametrize("most", [1, 2, 4])
def test_a_search_stopped_at_any_step_is_within_the_linear_limits(most: int) -> None:
    found = minimize(bowl, np.zeros(3), BOX, None, most_steps=100, stop=lambda k, _: k >= most)
    assert found.stopped
    assert np.all(np.abs(found.x) <= 1.0)
    assert found.value <= bowl(np.zeros(3))[0]


def test_an_interruption_returns_the_best_so_far() -> None:
    calls = 0

    def interrupted(x: np.ndarray) -> tuple[float, np.ndarray]:
        nonlocal calls
        calls += 1
        if calls > 4:
            raise KeyboardInterrupt
        return bowl(x)

    found = minimize(interrupted, np.zeros(3), BOX, None, most_steps=100, stop=lambda *_: False)
    assert found.stopped
    assert found.status == "Interrupted"
    assert np.all(np.abs(found.x) <= 1.0)


def test_exceptions_of_the_function_come_through() -> None:
    def broken(x: np.ndarray) -> tuple[float, np.ndarray]:
        if x.any():
            raise ZeroDivisionError("here")
        return bowl(x)

    with pytest.raises(ZeroDivisionError, match="here"):
        minimize(broken, np.zeros(3), BOX, None, most_steps=100, stop=lambda *_: False)
