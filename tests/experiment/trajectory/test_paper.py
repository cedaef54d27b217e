"""The paper's excitation keeps its own rule, and every trajectory is smooth."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sdpid.errors import DataError
from sdpid.experiment.trajectory.fourier import FourierSeries, quintic
from sdpid.experiment.trajectory.paper import paper_excitation
from sdpid.experiment.trajectory.trajectory import Trajectory
from tests.helpers.refusals import refuses

ROBOT = "denso_vp6242"
LIMITS_HZ = np.array([0.1989, 0.2981, 1.0715, 0.2075, 0.3627, 0.2025])
RANGES_DEG = np.array([[-135, 135], [-45, 90], [-90, -40], [-155, 155], [-90, 90], [-160, 160]])
# Positions come from an FFT of values near 3 rad.
FFT_ROUNDING = 1e-12


@pytest.fixture(scope="module")
def full() -> Trajectory:
    return paper_excitation(ROBOT, 0)


def test_full_size_is_table_ii(full: Trajectory) -> None:
    assert full.n_samples == 4_578_000
    assert full.duration == 4578.0
    assert (full.period, full.periods, full.rest, full.connection) == (380.0, 12, 4.0, 5.0)
    assert full.series.harmonics.shape == (6, 55)
    assert full.notes == ()
    np.testing.assert_allclose(full.position_range, np.radians(RANGES_DEG))
    np.testing.assert_allclose(full.center, np.radians(RANGES_DEG.mean(axis=1)))


@settings(deadline=None, max_examples=10)
@given(seed=st.integers(0, 2**32 - 1), period=st.sampled_from([10.0, 37.0, 95.0, 380.0]))
def test_the_papers_rule(seed: int, period: float) -> None:
    trajectory = paper_excitation(ROBOT, seed, period=period)
    half = np.radians(np.diff(RANGES_DEG, axis=1)[:, 0]) / 2
    excursion = np.abs(trajectory.position_period - trajectory.center).max(axis=0)
    np.testing.assert_allclose(excursion, half, rtol=FFT_ROUNDING)
    for j, limit in enumerate(LIMITS_HZ):
        used = trajectory.series.harmonics[j][trajectory.series.harmonics[j] > 0]
        available = int(np.floor(limit * period))
        assert len(used) == min(55, available)
        assert len(set(used.tolist())) == len(used)
        assert used.min() >= 1
        assert used.max() <= available
        amplitudes = trajectory.series.amplitudes[j][: len(used)]
        assert np.ptp(amplitudes) == 0.0
        shortfall = [note for note in trajectory.notes if note.startswith(f"joint_{j + 1}: only")]
        assert len(shortfall) == (len(used) < 55)
    # Bernstein's inequality, with the table's rounding of the limit frequencies.
    assert np.all(trajectory.velocity_peak <= trajectory.velocity_limit * 1.001)


@settings(deadline=None, max_examples=10)
@given(seed=st.integers(0, 2**32 - 1), periods=st.integers(1, 3))
def test_ends_at_rest_and_is_smooth(seed: int, periods: int) -> None:
    trajectory = paper_excitation(ROBOT, seed, period=20.0, periods=periods)
    q, v, a = trajectory.sample()
    assert q.shape == (trajectory.n_samples, 6)
    for end in (slice(0, 4001), slice(-4000, None)):
        np.testing.assert_array_equal(q[end], np.broadcast_to(trajectory.center, q[end].shape))
        assert not v[end].any()
        assert not a[end].any()
    # Trapezoids: a jump in position, velocity or acceleration would break one of these at once.
    h = 1.0 / trajectory.rate_hz
    np.testing.assert_allclose(np.diff(q, axis=0), h / 2 * (v[1:] + v[:-1]), atol=1e-8)
    np.testing.assert_allclose(np.diff(v, axis=0), h / 2 * (a[1:] + a[:-1]), atol=1e-6)
    # The sharpest change of acceleration is at the resting end of the quintic connection.
    jerk = 60.0 * 3.0 / 5.0**3 + 36.0 * 3.6 / 5.0**2 + 9.0 * 12.0 / 5.0 + 60.0
    assert np.abs(np.diff(a, axis=0)).max() < jerk * h
    assert not any("connection" in note for note in trajectory.notes)
    # Connections stay where the axis may go.
    assert np.all(q >= trajectory.position_range[:, 0] - 1e-9)
    assert np.all(q <= trajectory.position_range[:, 1] + 1e-9)


def test_parts_are_slices_of_the_whole() -> None:
    trajectory = paper_excitation(ROBOT, 3, period=12.0, periods=2)
    whole = trajectory.sample()
    for start, stop in ((0, 10), (3990, 4010), (8990, 9010), (20990, 21010), (32990, 33005)):
        for part, all_of_it in zip(trajectory.sample(start, stop), whole, strict=True):
            np.testing.assert_array_equal(part, all_of_it[start:stop])
    refuses(DataError, "not within", trajectory.sample, 0, trajectory.n_samples + 1)


def test_seeds_decide() -> None:
    first, again, other = (paper_excitation(ROBOT, seed, period=40.0) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.position_period, again.position_period)
    assert np.abs(first.position_period - other.position_period).max() > 0.1


def test_velocity_report(full: Trajectory) -> None:
    lines = full.velocity_report()
    assert len(lines) == 6
    assert all("within the limit" in line for line in lines)
    assert all("deg/s" in line for line in lines)


def test_harmonics_are_whole_numbers() -> None:
    series = {"period": 1.0, "center": [0.0], "amplitudes": [[1.0]], "phases": [[0.0]]}
    for harmonics in (np.nan, 1e300, 1.5, -1.0):
        refuses(DataError, "harmonics", FourierSeries, **series, harmonics=[[harmonics]])


@pytest.mark.parametrize("limit", [0.0, 1e-308])
def test_a_limit_of_next_to_nothing_is_no_share(full: Trajectory, limit: float) -> None:
    slow = replace(full, velocity_limit=np.full(6, limit))
    assert all(line.split(", ")[1].startswith("ABOVE the limit") for line in slow.velocity_report())


def test_velocities_of_sliding_joints_are_in_meters(full: Trajectory) -> None:
    name, peak, limit = full.joint_names[1], full.velocity_peak[1], full.velocity_limit[1]
    turning, slides, *_ = full.velocity_report([name])
    assert "deg/s" in turning
    assert f"{peak:.4g} m/s, within the limit of {limit:.4g} m/s" in slides
    assert "deg" not in slides


def test_with_periods_keeps_the_motion(full: Trajectory) -> None:
    one = full.with_periods(1)
    assert one.n_samples == 398_000
    np.testing.assert_array_equal(one.sample(20_000, 20_010)[0], full.sample(20_000, 20_010)[0])


def test_no_harmonic_below_the_limit() -> None:
    refuses(DataError, "joint_1: no harmonic", paper_excitation, ROBOT, 0, period=4.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"period": 10.00005}, "whole number"),
        ({"periods": 0}, "periods"),
        ({"period": -1.0}, "period"),
    ],
)
def test_bad_timing(arguments: dict[str, float], message: str) -> None:
    with pytest.raises(DataError, match=message):
        paper_excitation(ROBOT, 0, **({"period": 10.0} | arguments))  # type: ignore[arg-type]


def test_missing_folder(tmp_path) -> None:  # type: ignore[no-untyped-def]
    refuses(DataError, "cannot read", paper_excitation, tmp_path, 0)
    (tmp_path / "excitation.toml").write_text("sinusoids = 3\n")
    refuses(DataError, "axis", paper_excitation, tmp_path, 0)


@settings(deadline=None, max_examples=20)
@given(
    seed=st.integers(0, 1000),
    samples=st.integers(60, 200),
    derivative=st.integers(0, 2),
    period=st.floats(0.5, 50.0),
)
def test_fft_equals_the_sum(seed: int, samples: int, derivative: int, period: float) -> None:
    rng = np.random.default_rng(seed)
    series = FourierSeries(
        period=period,
        center=rng.normal(size=2),
        harmonics=rng.integers(1, 30, size=(2, 5)),
        amplitudes=rng.normal(size=(2, 5)),
        phases=rng.uniform(0, 7, size=(2, 5)),
    )
    time = np.arange(samples) * period / samples
    direct = series.evaluate(time, derivative=derivative)
    scale = (2 * np.pi * 30 / period) ** derivative
    np.testing.assert_allclose(
        series.one_period(samples, derivative=derivative), direct, atol=1e-11 * max(scale, 1.0)
    )
    delayed = series.delayed(np.full(2, time[7]))
    np.testing.assert_allclose(delayed.evaluate(time[:1]), series.evaluate(time[7:8]), atol=1e-11)


def test_series_refuses_what_is_no_series() -> None:
    good = {
        "period": 1.0,
        "center": [0.0],
        "harmonics": [[1, 2]],
        "amplitudes": [[1.0, 1.0]],
        "phases": [[0.0, 0.0]],
    }
    for change, message in (
        ({"harmonics": [[1.5, 2]]}, "whole"),
        ({"harmonics": [[0, 2]]}, "harmonic 0"),
        ({"phases": [[0.0]]}, "do not fit"),
        ({"period": 0.0}, "period"),
    ):
        with pytest.raises(DataError, match=message):
            FourierSeries(**(good | change))  # type: ignore[arg-type]
    with pytest.raises(DataError, match="too few"):
        FourierSeries(**good).one_period(4)  # type: ignore[arg-type]


def test_quintic_meets_both_ends() -> None:
    rng = np.random.default_rng(0)
    end = rng.normal(size=(3, 4))
    for duration in (5.0, -2.0):
        motion = quintic(np.array([0.0, 1.0]), duration, *end)
        for values, target in zip(motion, end, strict=True):
            np.testing.assert_allclose(values[0], 0.0, atol=1e-13)
            np.testing.assert_allclose(values[1], target, atol=1e-12)
