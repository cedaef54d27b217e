"""The objectives: their derivatives, and what each is invariant to."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sdpid
from sdpid.errors import DataError
from sdpid.excitation.criterion.criterion import Criterion
from sdpid.excitation.criterion.objectives import Objective
from sdpid.excitation.criterion.rows import BaseRows
from tests.helpers.refusals import refuses

KINDS = ("mixed", "D", "A", "E", "V", "condition")


def matrix(rng: np.random.Generator, b: int) -> np.ndarray:
    root = rng.standard_normal((b + 3, b))
    return root.T @ root


def objective(kind: str, rng: np.random.Generator, b: int) -> Objective:
    functionals = rng.standard_normal((3, b)) if kind == "V" else None
    return Objective(kind=kind, functionals=functionals, scale=rng.uniform(0.5, 2.0, b))


@given(st.sampled_from(KINDS), st.integers(0, 1000))
def test_derivatives_agree_with_differences(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    total, plain, d1, d2 = (matrix(rng, 5) for _ in range(4))
    made = objective(kind, rng, 5)
    _, by_total, by_plain = made.value(total, plain)
    h = 1e-6
    ahead = made.value(total + h * d1, plain + h * d2)[0]
    behind = made.value(total - h * d1, plain - h * d2)[0]
    expected = np.sum(by_total * d1) + np.sum(by_plain * d2)
    # Central differences err by h², and by rounding of the values over h.
    assert (ahead - behind) / (2.0 * h) == pytest.approx(expected, rel=1e-4, abs=1e-6)


@given(st.integers(0, 1000))
def test_more_information_is_never_worse(seed: int) -> None:
    rng = np.random.default_rng(seed)
    total, plain, more = (matrix(rng, 5) for _ in range(3))
    for kind in ("D", "A", "E", "V"):
        made = objective(kind, np.random.default_rng(seed), 5)
        assert made.value(total + more, plain)[0] <= made.value(total, plain)[0] + 1e-9


@given(st.integers(0, 1000))
def test_log_det_does_not_depend_on_the_units(seed: int) -> None:
    rng = np.random.default_rng(seed)
    first, second, plain = (matrix(rng, 5) for _ in range(3))
    units = rng.uniform(0.01, 100.0, 5)
    made = Objective(kind="D")
    before = made.value(first, plain)[0] - made.value(second, plain)[0]
    scaled = [m * np.outer(units, units) for m in (first, second)]
    after = made.value(scaled[0], plain)[0] - made.value(scaled[1], plain)[0]
    assert after == pytest.approx(before, abs=1e-9)


def test_the_smooth_condition_number_is_above_the_true_one_and_near_it() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        plain = matrix(rng, 8)
        smooth = np.exp(Objective(kind="condition").value(plain, plain)[0])
        true = np.sqrt(np.linalg.cond(plain))
        assert true <= smooth <= 8 ** (1 / 32) * true


def test_functionals_of_a_part_are_log_det_of_its_covariance() -> None:
    rng = np.random.default_rng(1)
    total = matrix(rng, 5)
    L = np.eye(5)[:2]
    value = Objective(kind="D", functionals=L).value(total, total)[0]
    expected = np.linalg.slogdet(np.linalg.inv(total)[:2, :2])[1] / 2
    assert value == pytest.approx(expected)


def test_unknown_objectives_are_refused() -> None:
    with pytest.raises(DataError, match="use one of mixed, D"):
        Objective(kind="G")  # type: ignore[arg-type]
    refuses(DataError, "needs functionals", Objective, kind="V")


@pytest.mark.parametrize("friction", [("coulomb", "viscous", "offset"), ("viscous", "tilt"), ()])
def test_the_gradient_of_a_motion_agrees_with_differences(friction: tuple[str, ...]) -> None:
    robot = sdpid.load_robot("denso_vp6242")
    rows = BaseRows.of(robot, friction).smooth()
    rng = np.random.default_rng(2)
    criterion = Criterion(
        rows=rows,
        objective=Objective(),
        rates=rng.uniform(0.5, 2.0, robot.n),
        known=1e-3 * np.eye(rows.count),
    )
    state = list(rng.standard_normal((3, 60, robot.n)))
    _, slopes = criterion.gradient(*state, 20.0)
    for order in range(3):
        step = rng.standard_normal(state[order].shape)
        values = []
        for h in (1e-6, -1e-6):
            moved = list(state)
            moved[order] = state[order] + h * step
            values.append(criterion.value(*moved, 20.0))
        found = (values[0] - values[1]) / 2e-6
        assert found == pytest.approx(float(np.sum(slopes[order] * step)), rel=1e-4, abs=1e-5)


def test_rows_are_the_regressor_of_the_base_parameters() -> None:
    robot = sdpid.load_robot("denso_vp6242")
    rows = BaseRows.of(robot, ("coulomb", "viscous"))
    rng = np.random.default_rng(3)
    q, v, a = rng.standard_normal((3, 10, robot.n))
    theta = np.concatenate([robot.prior.ravel(), rng.uniform(0.0, 1.0, 2 * robot.n)])
    effort = robot.inverse_dynamics(theta, q, v, a)
    effort = effort + np.sign(v) * theta[-2 * robot.n : -robot.n] + v * theta[-robot.n :]
    np.testing.assert_allclose(rows.rows(q, v, a) @ (rows.base.matrix @ theta), effort, atol=1e-9)
