from typing import Any

import numpy as np
import pytest

from sdpid.errors import DataError
from sdpid.experiment.processing.samples import Samples
from tests.helpers.refusals import refuses

K, JOINTS = 5, 2


def fields(**changes: Any) -> dict[str, Any]:
    table = np.arange(float(K * JOINTS)).reshape(K, JOINTS)
    values = dict.fromkeys(("position", "velocity", "acceleration", "effort"), table)
    return values | changes


def test_defaults_and_views():
    samples = Samples(**fields())
    assert (samples.n, samples.n_samples, samples.n_rows, samples.block) == (2, 5, 10, 1)
    assert samples.covariance is None
    assert samples.mask is None
    assert samples.notes == ()
    assert samples.names == ("1", "2")
    for name in ("position", "velocity", "acceleration", "effort"):
        assert not getattr(samples, name).flags.writeable
    assert repr(samples) == "Samples(5 samples, 2 joints, 10 rows used)"


def test_everything_given():
    mask = np.ones((K, JOINTS), dtype=bool)
    mask[:3, 1] = False
    samples = Samples(
        **fields(
            covariance=np.tile(np.eye(2), (K, 1, 1)),
            mask=mask,
            time=np.arange(5),
            joint_names=["a", "b"],
            periods=3,
            block=2,
            notes=["filtered"],
            effort_periods=np.zeros((3, K, JOINTS)),
        )
    )
    assert samples.n_rows == 7
    assert samples.joint_names == ("a", "b")
    assert not samples.mask.flags.writeable
    assert Samples(**fields(covariance=np.eye(2))).covariance.shape == (2, 2)


def test_a_free_flyer_has_more_positions():
    assert Samples(**fields(position=np.zeros((K, 3)))).n == 2


def test_a_joint_may_be_masked_altogether():
    # The rows of a floating base: they are in the equation of motion, but they are not measured.
    mask = np.tile([False, True], (K, 1))
    samples = Samples(**fields(mask=mask, position=np.zeros((K, 3))))
    assert samples.n_rows == K
    np.testing.assert_array_equal(samples.mask, mask)


nan = np.full((K, JOINTS), np.nan)
BAD: dict[str, tuple[dict[str, Any], str]] = {
    "nan": ({"acceleration": nan}, "acceleration: 10 of 10 values are not finite"),
    "rows": ({"position": np.zeros((4, 2))}, r"position: has shape \(4, 2\)"),
    "positions": ({"position": np.zeros((K, 1))}, "position: has shape"),
    "velocity": ({"velocity": np.zeros((K, 3))}, r"velocity: has shape \(5, 3\), expected"),
    "empty": ({"effort": np.zeros((0, 2))}, "nothing to fit"),
    "time": ({"time": np.zeros(3)}, "time: has shape"),
    "names": ({"joint_names": ("a",)}, "1 names"),
    "covariance shape": ({"covariance": np.eye(3)}, "covariance: has shape"),
    "covariance count": ({"covariance": np.zeros((2, 2, 2))}, "covariance: has shape"),
    "asymmetric": ({"covariance": [[1.0, 0.5], [0.4, 1.0]]}, "not symmetric"),
    "negative": ({"covariance": [[1.0, 0.0], [0.0, -1.0]]}, "joint 2 has a negative variance"),
    "indefinite": ({"covariance": [[1.0, 2.0], [2.0, 1.0]]}, "not positive semidefinite"),
    "mask shape": ({"mask": np.ones(K, dtype=bool)}, "mask: has shape"),
    "mask type": ({"mask": np.ones((K, JOINTS))}, "expected .* bool"),
    "mask empty": ({"mask": np.zeros((K, JOINTS), dtype=bool)}, "mask: leaves none of 10 rows"),
    "block": ({"block": 0}, "block: is 0"),
    "block nan": ({"block": float("nan")}, "block: is nan, expected a whole number"),
    "block inf": ({"block": float("inf")}, "block: is inf, expected a whole number"),
    "block text": ({"block": "2"}, "block: is 2, expected a whole number"),
    "periods none": ({"periods": 1.5}, "periods: is 1.5, expected a whole number"),
    "periods": ({"periods": 0}, "periods: is 0"),
    "effort_periods": (
        {"periods": 2, "effort_periods": np.zeros((3, K, JOINTS))},
        "effort_periods: has shape",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_refused(case: str):
    changes, message = BAD[case]
    refuses(DataError, message, Samples, **fields(**changes))


def test_pieces_are_joined_in_order():
    first = Samples(**fields(time=np.arange(5.0), notes=["filtered", "short"], block=2))
    mask = np.ones((K, JOINTS), dtype=bool)
    mask[0, 0] = False
    second = Samples(
        **fields(effort=np.full((K, JOINTS), 9.0), time=np.arange(5.0), mask=mask, block=4),
        notes=["filtered"],
    )
    joined = Samples.join([first, second])
    assert joined.starts == (0, 5)
    assert joined.parts == (slice(0, 5), slice(5, 10))
    assert (joined.n_samples, joined.n_rows, joined.block) == (10, 19, 4)
    np.testing.assert_array_equal(joined.effort[5:], second.effort)
    np.testing.assert_array_equal(joined.time, [*range(5), *range(5)])
    assert joined.notes == ("filtered", "2 pieces joined", "piece 1: short")
    assert Samples.join([joined, first]).starts == (0, 5, 10)
    assert Samples.join([first]) is first
    assert "2 pieces" in repr(joined)


def test_covariances_are_kept_sample_by_sample():
    one, other = (Samples(**fields(covariance=c * np.eye(2))) for c in (1.0, 4.0))
    assert Samples.join([one, one]).covariance.shape == (2, 2)
    joined = Samples.join([one, other]).covariance
    assert joined.shape == (2 * K, 2, 2)
    np.testing.assert_array_equal(joined[:, 0, 0], [1.0] * K + [4.0] * K)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"covariance": np.eye(2)}, "1 of 2 pieces have a covariance"),
        ({"joint_names": ("a", "b")}, "the joints of piece 2"),
        ({"periods": 3}, "averages over periods"),
        ({"position": np.zeros((K, 3))}, "position of piece 2 has 3 columns"),
    ],
)
def test_what_does_not_belong_together_is_refused(change, message):
    refuses(DataError, message, Samples.join, [Samples(**fields()), Samples(**fields(**change))])
    refuses(DataError, "none to join", Samples.join, [])


@pytest.mark.parametrize("starts", [(1,), (), (0, 3, 3), (0, 5), (0, 4, 2)])
def test_starts_rise_from_zero(starts):
    refuses(DataError, "rising sample numbers", Samples, **fields(starts=starts))


def test_a_part_may_have_no_row_that_is_used():
    mask = np.zeros((K, JOINTS), dtype=bool)
    mask[3:] = True
    whole = Samples(**fields(mask=mask, starts=(0, 3)))
    first, second = whole.pieces
    assert (first.n_rows, second.n_rows) == (0, 4)
    np.testing.assert_array_equal(Samples.join([first, second]).mask, mask)
    assert not first.mask.flags.writeable
