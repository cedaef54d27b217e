"""Drive gains: their errors, and the file that keeps them."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import t

import sdpid
from sdpid.errors import DataError
from tests.helpers.refusals import refuses


def some(seed: int = 0, n: int = 3) -> sdpid.DriveGains:
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((n, n))
    return sdpid.DriveGains(
        joint_names=[f'joint "{k}" \x7f 🦾' for k in range(n)],
        gains=rng.uniform(1.0, 20.0, n),
        covariance=root @ root.T / 100.0,
        freedom=[*rng.uniform(3.0, 50.0, n - 1), np.inf],
        basis="a load of 2 kg",
        sources={"a.csv": "00ff", "b c.csv": "11"},
        notes=("one", "two\nlines"),
    )


def test_a_file_keeps_every_digit(tmp_path: Path) -> None:
    gains = some()
    gains.to_toml(tmp_path / "gains.toml")
    read = sdpid.DriveGains.from_toml(tmp_path / "gains.toml")
    assert read.source.name == "gains.toml"
    assert {**read.to_dict(), "file": None} == gains.to_dict()
    assert sdpid.DriveGains.from_dict(read.to_dict()).to_dict() == read.to_dict()
    np.testing.assert_array_equal(read.covariance, gains.covariance)
    np.testing.assert_array_equal(read.freedom, gains.freedom)


def test_a_file_of_a_user_is_short(tmp_path: Path) -> None:
    (tmp_path / "g.toml").write_text('joint_names = ["a"]\ngains = [2]\n')
    gains = sdpid.DriveGains.from_toml(tmp_path / "g.toml")
    np.testing.assert_array_equal(gains.intervals(), [[2.0, 2.0]])
    assert gains.common_factor == 0.0


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 6))
def test_the_common_factor_is_the_largest(seed: int, n: int) -> None:
    gains = some(seed, n)
    C, c = gains.relative_covariance, gains.common_factor
    scale = np.linalg.eigvalsh(C)[-1]
    least = [np.linalg.eigvalsh(C - (c * s) ** 2)[0] for s in (0.99, 1.01)]
    assert least[0] > -1e-9 * scale
    assert least[1] < 0.0


def test_a_factor_alone_is_all_common() -> None:
    gains = np.array([10.0, 5.0, 1.0])
    one = sdpid.DriveGains(
        joint_names=("a", "b", "c"), gains=gains, covariance=0.01**2 * np.outer(gains, gains)
    )
    assert one.common_factor == pytest.approx(0.01)


def test_intervals_are_those_of_the_logarithm() -> None:
    gains = some()
    lower, upper = gains.intervals(0.9).T
    np.testing.assert_allclose(lower * upper, gains.gains**2)
    half = t.ppf(0.95, gains.freedom) * gains.standard_errors / gains.gains
    np.testing.assert_allclose(np.log(upper / lower), 2.0 * half)


def test_joints_are_taken_by_name() -> None:
    gains = some()
    last, first = gains.joint_names[2], gains.joint_names[0]
    two = gains.of_joints([last, first])
    np.testing.assert_array_equal(two.gains, gains.gains[[2, 0]])
    assert two.covariance[0, 1] == gains.covariance[2, 0]
    np.testing.assert_allclose(two.torque(np.ones((4, 2))), np.tile(two.gains, (4, 1)))
    refuses(DataError, "none for elbow", gains.of_joints, ["elbow"])


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"gains": [1.0, -2.0]}, "that of b is -2 N·m/A"),
        ({"gains": [1.0]}, "shape"),
        ({"joint_names": ("a", "a")}, "each joint a name"),
        ({"covariance": [[1.0, 2.0], [2.0, 1.0]]}, "covariance is none"),
        ({"freedom": [1.0, 0.0]}, "positive"),
        ({"gains": [1.0, np.nan]}, "not finite"),
        ({"gains": [1e308, 1e-308], "covariance": np.full((2, 2), 1e308)}, "too large beside"),
        ({"sources": ["a.csv"]}, "names and digests"),
    ],
)
def test_what_are_no_gains_is_told(changed: dict[str, object], said: str) -> None:
    given = {"joint_names": ("a", "b"), "gains": [1.0, 2.0], **changed}
    refuses(DataError, said, sdpid.DriveGains, **given)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("gains = [1.0]", "no joint_names"),
        ('joint_names = ["a"]\ngains = [1.0]\ngain = 2', "gain is not known"),
        ('joint_names = ["a"]\ngains = [1.0]\nunit = "A"', "expected 'N.m/A'"),
        ('joint_names = ["a"]\ngains = [true, 2.0]', "shape"),
    ],
)
def test_a_file_that_holds_none_is_told(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "g.toml"
    path.write_text(text)
    refuses(DataError, said, sdpid.DriveGains.from_toml, path)


def test_what_a_file_says_drives_no_terminal() -> None:
    gains = sdpid.DriveGains(
        joint_names=("a\x1b[2J",), gains=[1.0], basis="b\x1b[2J", notes=["c\x1b[2J"]
    )
    assert not {"\x1b"} & {*gains.describe(), *gains.in_words, *repr(gains)}
