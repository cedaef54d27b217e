"""Curves and trajectories: bounds, the paper's rule, files and parts."""

import re
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.experiment.trajectory.curve import Curve, SampledCurve, Spline
from sdpid.experiment.trajectory.drawn import paper_excitation
from sdpid.experiment.trajectory.fourier import FourierSeries
from sdpid.experiment.trajectory.reading import between_rests, read_trajectory
from sdpid.experiment.trajectory.trajectory import Trajectory
from tests.helpers.refusals import refuses

KINDS = ["spline", "fourier", "positions", "velocities", "accelerations"]
HIGHEST, SEEDS = 4, st.integers(0, 2**32 - 1)
ANY = {"kind": st.sampled_from(KINDS), "seed": SEEDS, "derivative": st.integers(0, HIGHEST)}


WORDS = ("position", "velocity", "acceleration")


def series_of(rng: np.random.Generator, period: float, count: int, *, highest: int) -> Any:
    """Return a random series of two joints with some harmonics each."""
    return FourierSeries(
        period=period,
        center=rng.normal(size=2),
        harmonics=rng.integers(1, highest + 1, size=(2, count)),
        amplitudes=rng.normal(size=(2, count)),
        phases=rng.uniform(-7.0, 7.0, size=(2, count)),
    )


def spline_of(rng: np.random.Generator) -> Spline:
    degree = int(rng.integers(1, 6))
    points = rng.normal(scale=rng.uniform(0.01, 3.0), size=(degree + rng.integers(1, 21), 2))
    return Spline(duration=rng.uniform(0.1, 100.0), control_points=points, degree=degree)


def sampled(rng: np.random.Generator, orders: int, time: Any) -> SampledCurve:
    values = rng.normal(size=(3, len(time), 2))
    values[1:, [0, -1]] = 0.0
    return SampledCurve(time=time, **dict(zip(WORDS, values[:orders], strict=False)))


def curve_of(kind: str, seed: int) -> Curve:
    """Return a random curve."""
    rng = np.random.default_rng(seed)
    if kind == "spline":
        return spline_of(rng)
    if kind == "fourier":
        return series_of(rng, rng.uniform(0.2, 30.0), int(rng.integers(1, 7)), highest=14)
    time = rng.uniform(0.0, 9.0) + np.cumsum(rng.uniform(0.2, 1.0, int(rng.integers(4, 30))))
    return sampled(rng, 1 + KINDS.index(kind) - KINDS.index("positions"), time)


def inside(edges: Array, cells: int = 30) -> tuple[Array, Array]:
    """Return times within each cell, ends left out, and the number of each one's cell."""
    share = np.linspace(0.0, 1.0, cells + 2)[1:-1]
    time = edges[:-1, None] + share * np.diff(edges)[:, None]
    return time.ravel(), np.repeat(np.arange(len(edges) - 1), cells)


@settings(deadline=None, max_examples=100)
@given(inner=st.lists(st.floats(0.0, 1.0), max_size=12), **ANY)
def test_bounds_hold_at_every_instant(kind: str, seed: int, derivative: int, inner: list[float]):
    curve = curve_of(kind, seed)
    edges = np.unique(np.concatenate([[0.0, 1.0], inner])) * curve.duration
    edges = edges[np.concatenate([[True], np.diff(edges) > 1e-9])]
    lower, upper = curve.enclose(edges, derivative=derivative)
    assert lower.shape == upper.shape == (len(edges) - 1, curve.n)
    time, cell = inside(edges)
    values = curve.evaluate(time, derivative=derivative)
    assert (lower[cell] <= values).all()
    assert (values <= upper[cell]).all()


@settings(deadline=None, max_examples=40)
@given(**ANY)
def test_finer_cells_give_closer_bounds(kind: str, seed: int, derivative: int) -> None:
    curve = curve_of(kind, seed)
    excess = []
    for halvings in (0, 1, 3, 5):
        # Cells whose edges are not the breaks' own: pieces are cut, and joined.
        cells = 3 * 2**halvings
        edges = np.linspace(0.0, curve.duration, cells + 1)
        lower, upper = curve.enclose(edges, derivative=derivative)
        time, _ = inside(edges, 64)
        values = curve.evaluate(time, derivative=derivative).reshape(cells, 64, curve.n)
        excess.append((upper - lower - np.ptp(values, axis=1)).max(axis=0))
        if halvings == 0:
            coarse = lower.min(axis=0), upper.max(axis=0)
    size = np.abs(coarse).max() + 1e-300
    # A finer cell's bounds stay within the coarse ones', up to rounding; those of a Fourier series
    # are cut into cells of their own, which exceed the curve by about 1e-3.
    slack = (5e-3 if kind == "fourier" else 1e-9) * size
    assert (lower.min(axis=0) >= coarse[0] - slack).all()
    assert (upper.max(axis=0) <= coarse[1] + slack).all()
    # The samples stop short of the ends of the cells by 1/65 of them on either side.
    if derivative <= getattr(curve, "smooth", HIGHEST):
        assert (excess[-1] <= 0.5 * excess[0] + 0.05 * size).all()


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_are_those_of_the_curve(kind: str) -> None:
    curve = curve_of(kind, 5)
    h = 1e-6 * curve.duration
    time = np.linspace(0.01, 0.985, 11) * curve.duration
    for derivative in range(2):
        ahead, behind = (curve.evaluate(time + s, derivative=derivative) for s in (h, -h))
        rate = curve.evaluate(time, derivative=derivative + 1)
        np.testing.assert_allclose((ahead - behind) / (2 * h), rate, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("kind", KINDS[2:])
def test_samples_are_met(kind: str) -> None:
    curve = curve_of(kind, 7)
    assert isinstance(curve, SampledCurve)
    for derivative, values in enumerate((curve.position, curve.velocity, curve.acceleration)):
        if values is not None:
            met = curve.evaluate(curve.breaks, derivative=derivative)
            np.testing.assert_allclose(met, values, atol=1e-9)
    # Up to the order that it says the curve does not jump at its samples.
    for derivative in range(curve.smooth + 2):
        times = curve.breaks[1:-1]
        after = curve.evaluate(times, derivative=derivative)
        before = curve.evaluate(times * (1 - 1e-12), derivative=derivative)
        jump = np.abs(after - before).max()
        assert (jump < 1e-6) == (derivative <= curve.smooth)


SAMPLES = {"time": [0.0, 1.0, 2.0], "position": np.zeros((3, 2))}
SERIES = {"period": 1.0, "center": [0.0], "harmonics": [[1, 2]]}
SERIES |= {"amplitudes": [[1.0, 1.0]], "phases": [[0.0, 0.0]]}
STILL = {"duration": 1.0, "control_points": np.zeros((6, 2))}


# What makes no curve, or is no argument of one, by what is said of it.
REFUSED: list[tuple[str, Any]] = [
    ("does not increase at sample 2", partial(SampledCurve, **SAMPLES | {"time": [0.0, 1.0, 1.0]})),
    ("at least two", partial(SampledCurve, **SAMPLES | {"time": [0.0]})),
    (r"velocity: has shape \(3, 1\)", partial(SampledCurve, **SAMPLES, velocity=np.zeros((3, 1)))),
    ("not finite", partial(SampledCurve, **SAMPLES | {"position": np.full((3, 2), np.nan)})),
    ("without velocities", partial(SampledCurve, **SAMPLES, acceleration=np.zeros((3, 2)))),
    *(
        ("harmonics", partial(FourierSeries, **SERIES | {"harmonics": [[h, 2]]}))
        for h in (np.nan, 1e300, 1.5, -1)
    ),
    ("harmonic 0", partial(FourierSeries, **SERIES | {"harmonics": [[0, 2]]})),
    ("do not fit", partial(FourierSeries, **SERIES | {"phases": [[0.0]]})),
    ("which no joint does", partial(FourierSeries, **SERIES | {"center": [1e10]})),
    ("period", partial(FourierSeries, **SERIES | {"period": 0.0})),
    ("too few", partial(FourierSeries(**SERIES).one_period, 4)),
    ("duration", partial(Spline, **STILL | {"duration": 0.0})),
    ("degree", partial(Spline, **STILL, degree=0)),
    ("at least 7", partial(Spline, **STILL, degree=6)),
    ("control_points", partial(Spline, **STILL | {"control_points": np.full((6, 2), np.nan)})),
    (r"1\.1 s at index 1 is not within", partial(Spline(**STILL).evaluate, [0.0, 1.1])),
    ("increasing", partial(Spline(**STILL).enclose, [0.0, 0.0])),
    ("derivative", partial(Spline.control_matrix, 6, 1.0, 6)),
    ("at least 6", partial(Spline.expansion, 5)),
    ("not within", lambda: paper_excitation("denso_vp6242", 3, period=12.0).sample(0, 10**9)),
    (r"none\.csv.*no such file", partial(read_trajectory, Path("none.csv"))),
    ("no format of trajectories", partial(read_trajectory, Path("motion.bag"))),
]


@pytest.mark.parametrize(("words", "make"), REFUSED, ids=[words for words, _ in REFUSED])
def test_what_makes_no_curve(words: str, make: Any) -> None:
    refuses(DataError, words, make)


# The paper's excitation keeps its own rule, and every trajectory is smooth.


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
    one = full.with_periods(1)
    assert one.n_samples == 398_000
    np.testing.assert_array_equal(one.sample(20_000, 20_010)[0], full.sample(20_000, 20_010)[0])


@settings(deadline=None, max_examples=10)
@given(seed=SEEDS, period=st.sampled_from([10.0, 37.0, 95.0, 380.0]))
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
@given(seed=SEEDS, periods=st.integers(1, 3))
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
    trajectory, again, other = (
        paper_excitation(ROBOT, seed, period=12.0, periods=2) for seed in (3, 3, 4)
    )
    np.testing.assert_array_equal(trajectory.position_period, again.position_period)
    assert np.abs(trajectory.position_period - other.position_period).max() > 0.1
    whole = trajectory.sample()
    for start, stop in ((0, 10), (3990, 4010), (8990, 9010), (20990, 21010), (32990, 33005)):
        for part, all_of_it in zip(trajectory.sample(start, stop), whole, strict=True):
            np.testing.assert_array_equal(part, all_of_it[start:stop])


def test_velocity_report(full: Trajectory) -> None:
    lines = full.velocity_report()
    assert len(lines) == 6
    assert all("within the limit" in line and "deg/s" in line for line in lines)
    # Speeds of sliding joints are in m/s.
    name, peak, limit = full.joint_names[1], full.velocity_peak[1], full.velocity_limit[1]
    turning, slides, *_ = full.velocity_report([name])
    assert "deg/s" in turning
    assert f"{peak:.4g} m/s, within the limit of {limit:.4g} m/s" in slides
    assert "deg" not in slides
    # Of a limit of next to nothing no motion is a share.
    for limit in (0.0, 1e-308):
        slow = replace(full, velocity_limit=np.full(6, limit)).velocity_report()
        assert all(line.split(", ")[1].startswith("ABOVE the limit") for line in slow)


def test_what_is_no_excitation(tmp_path: Path) -> None:
    for arguments, message in (
        ({"period": 10.00005}, "whole number"),
        ({"period": 10.0, "periods": 0}, "periods"),
        ({"period": -1.0}, "period"),
        ({"period": 4.0}, "joint_1: no harmonic"),
    ):
        refuses(DataError, message, paper_excitation, ROBOT, 0, **arguments)
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
    series = series_of(np.random.default_rng(seed), period, 5, highest=29)
    time = np.arange(samples) * period / samples
    direct = series.evaluate(time, derivative=derivative)
    scale = (2 * np.pi * 30 / period) ** derivative
    np.testing.assert_allclose(
        series.one_period(samples, derivative=derivative), direct, atol=1e-11 * max(scale, 1.0)
    )
    delayed = series.delayed(np.full(2, time[7]))
    np.testing.assert_allclose(delayed.evaluate(time[:1]), series.evaluate(time[7:8]), atol=1e-11)


# Motions are read from files of any tool, and what is wrong with one is named.


NAMES = ("shoulder", "elbow", "rail_2")
TIME = np.linspace(0.0, 4.0, 401)
SPLINE = Spline.from_free(np.random.default_rng(0).normal(size=(8, 3)), 4.0)


def frame(orders: int = 3) -> pd.DataFrame:
    columns = {"time": TIME}
    for order, word in enumerate(("position", "velocity", "acceleration")[:orders]):
        values = SPLINE.evaluate(TIME, derivative=order)
        columns |= {f"{word}_{name}": values[:, j] for j, name in enumerate(NAMES)}
    return pd.DataFrame(columns)


@pytest.mark.parametrize("suffix", [".csv", ".csv.gz", ".tsv", ".parquet", ".npz"])
@pytest.mark.parametrize("orders", [1, 2, 3])
def test_samples_of_a_spline(tmp_path: Path, suffix: str, orders: int) -> None:
    file = tmp_path / f"motion{suffix}"
    table = frame(orders)
    if suffix == ".parquet":
        table.to_parquet(file)
    elif suffix == ".npz":
        np.savez(file, **{name: table[name].to_numpy() for name in table.columns})
    else:
        table.to_csv(file, index=False, sep="\t" if suffix == ".tsv" else ",")
    motion = read_trajectory(file, NAMES)
    assert motion.joint_names == NAMES == read_trajectory(file).joint_names
    assert motion.rate_hz == pytest.approx(100.0)
    assert isinstance(motion.series, SampledCurve)
    assert motion.curves() == ((0.0, motion.series),)
    dense = np.linspace(0.0, 4.0, 3333)
    for derivative, off in enumerate((1e-4, 3e-3)):
        one, other = (c.evaluate(dense, derivative=derivative) for c in (motion.series, SPLINE))
        np.testing.assert_allclose(one, other, atol=off)
    rested = between_rests(motion)
    assert (rested.rate_hz, rested.rest) == pytest.approx((300.0, 1.0))
    assert rested.connection == pytest.approx(2.0 if orders == 1 else 0.0)
    assert rested.closed == (orders > 1)


def test_joints_in_another_order_arrays_and_degrees(tmp_path: Path) -> None:
    q = SPLINE.evaluate(TIME)
    other = ("rail_2", "shoulder", "elbow")
    np.savez(tmp_path / "a.npz", time=TIME, q=q, joint_names=np.array(NAMES))
    frame(1).to_csv(tmp_path / "a.csv", index=False)
    for name in ("a.npz", "a.csv"):
        motion = read_trajectory(tmp_path / name, other)
        assert motion.joint_names == other
        np.testing.assert_allclose(motion.series.evaluate(TIME), q[:, [2, 0, 1]], atol=1e-12)
    # Numbers are no names: columns stand in the robot's order.
    np.savez(tmp_path / "b.npz", t=TIME, **{f"q{j + 1}": q[:, j] for j in range(3)})
    motion = read_trajectory(tmp_path / "b.npz", NAMES)
    assert motion.joint_names == NAMES
    np.testing.assert_allclose(motion.series.evaluate(TIME), q, atol=1e-12)
    table = pd.DataFrame(np.degrees(q), columns=[f"q{j} [deg]" for j in range(3)])
    table.assign(time_ms=1e3 * TIME).to_csv(tmp_path / "deg.csv", index=False)
    motion = read_trajectory(tmp_path / "deg.csv", NAMES)
    np.testing.assert_allclose(motion.series.evaluate(TIME), q, atol=1e-9)


def with_value(column: str, row: Any, value: Any) -> Any:
    def spoil(table: pd.DataFrame) -> pd.DataFrame:
        table.loc[row, column] = value(table) if callable(value) else value
        return table

    return spoil


def without(column: str) -> Any:
    return lambda table: table.drop(columns=[name for name in table if name.startswith(column)])


ELBOW, ALL = "velocity_elbow", slice(None)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (with_value(ELBOW, ALL, lambda table: np.degrees(table[ELBOW])), "elbow is 57.3 times"),
        (with_value("time", 7, 0.06), "line 9: time does not increase: 0.06 s after 0.06 s"),
        (with_value(ELBOW, 41, np.nan), "line 43: velocity_elbow has no finite value"),
        (without("time"), "column time is missing"),
        (lambda table: table[["time"]], "column position_<joint> is missing"),
        (
            lambda table: table.rename(columns={"position_elbow": "position_knee"}),
            "no joint knee; positions of elbow are missing",
        ),
        (without("velocity_elbow"), "give the same joints"),
        (without("acceleration_elbow"), "give the same joints"),
        (without("velocity"), "without velocities"),
    ],
)
def test_what_is_wrong_is_named(
    tmp_path: Path, spoil: Callable[[pd.DataFrame], pd.DataFrame], message: str
) -> None:
    file = tmp_path / "bad.csv"
    spoil(frame()).to_csv(file, index=False)
    with pytest.raises(DataError, match=message) as caught:
        read_trajectory(file, NAMES)
    assert str(file) in str(caught.value)


def test_files_without_names_are_no_trajectories(tmp_path: Path) -> None:
    frame().to_csv(tmp_path / "unnamed.csv", index=False, header=False)
    refuses(DataError, "column time is missing", read_trajectory, tmp_path / "unnamed.csv")


# Splines: scipy's B-splines, with bounds that hold at every instant.


SPLINES = SEEDS.map(lambda seed: spline_of(np.random.default_rng(seed)))


def of_scipy(spline: Spline, derivative: int) -> BSpline:
    curve = BSpline(spline.knots, spline.control_points, spline.degree)
    return curve.derivative(derivative) if derivative else curve


@settings(deadline=None, max_examples=50)
@given(spline=SPLINES, data=st.data())
def test_values_and_control_points_are_those_of_scipy(spline: Spline, data: st.DataObject) -> None:
    # The last derivative jumps at the knots, where values are those of one side.
    derivative = data.draw(st.integers(0, spline.degree - 1))
    halvings = data.draw(st.integers(0, 3))
    time = np.linspace(0.0, spline.duration, 97)
    expected = of_scipy(spline, derivative)(time)
    scale = np.abs(expected).max()
    close = {"rtol": 0.0, "atol": 1e-11 * scale}
    np.testing.assert_allclose(spline.evaluate(time, derivative=derivative), expected, **close)
    m, duration = len(spline.control_points), spline.duration
    basis = Spline.basis(m, duration, time, derivative, spline.degree)
    values = basis @ spline.control_points
    np.testing.assert_allclose(values, expected, **close)
    # The control points after halvings are those of the same curve, as a spline of lower degree.
    matrix = Spline.control_matrix(m, duration, derivative, halvings, spline.degree)
    points = matrix @ spline.control_points
    if derivative == 0:
        # They are means of those before.
        assert matrix.min() >= 0.0
        np.testing.assert_allclose(matrix.sum(axis=1), 1.0, rtol=0.0, atol=4e-15)
    lower = spline.degree - derivative
    uniform = np.linspace(0.0, spline.duration, len(points) - lower + 1)
    halved = BSpline(np.pad(uniform, lower, mode="edge"), points, lower)
    np.testing.assert_allclose(halved(time[:-1]), expected[:-1], rtol=0.0, atol=1e-10 * scale)
    assert (points.min(axis=0) <= expected.min(axis=0) + close["atol"]).all()
    assert (points.max(axis=0) >= expected.max(axis=0) - close["atol"]).all()


def exactly(spline: Spline, time: float, derivative: int) -> Fraction:
    """Return a derivative of the first joint in exact arithmetic, by de Boor's algorithm."""
    degree = spline.degree
    knots = [Fraction(knot) for knot in spline.knots]
    points = [Fraction(point) for point in spline.control_points[:, 0]]
    for _ in range(derivative):
        spans = [knots[k + degree + 1] - knots[k + 1] for k in range(len(points) - 1)]
        rises = [after - before for before, after in pairwise(points)]
        points = [degree * rise / span for rise, span in zip(rises, spans, strict=True)]
        knots, degree = knots[1:-1], degree - 1
    span = max(k for k in range(degree, len(points)) if knots[k] <= time)
    local = points[span - degree : span + 1]
    for level in range(1, degree + 1):
        for k in range(degree, level - 1, -1):
            low, high = knots[span - degree + k], knots[span + 1 + k - level]
            share = (Fraction(time) - low) / (high - low)
            local[k] = (1 - share) * local[k - 1] + share * local[k]
    return local[degree]


@settings(deadline=None, max_examples=50)
@given(spline=SPLINES, share=st.floats(0.0, 0.999), data=st.data())
def test_bounds_hold_in_exact_arithmetic(spline: Spline, share: float, data: st.DataObject) -> None:
    derivative = data.draw(st.integers(0, spline.degree))
    time = share * spline.duration
    edges = [time, np.nextafter(time, np.inf)]
    lower, upper = spline.enclose(edges, derivative=derivative)
    assert lower[0, 0] <= exactly(spline, time, derivative) <= upper[0, 0]


@pytest.mark.parametrize("closed", [True, False])
def test_free_control_points_leave_the_ends_at_rest(closed: bool) -> None:
    free = np.random.default_rng(0).normal(size=(8, 3))
    spline = Spline.from_free(free, 4.0, closed=closed)
    ends = np.array([0.0, 4.0])
    for derivative in (1, 2):
        assert not spline.evaluate(ends, derivative=derivative).any()
    np.testing.assert_array_equal(spline.evaluate(ends), free[[0, 0 if closed else -1]])
    expansion = Spline.expansion(len(spline.control_points), closed=closed)
    np.testing.assert_array_equal(expansion @ free, spline.control_points)
    assert expansion.shape == (len(free) + 4 + closed, len(free))


# Trajectories along any curve: their samples, their parts and their files.


def along(curve: Curve, names: tuple[str, ...] = ("turn", "slide"), **timing: Any) -> Trajectory:
    return Trajectory(
        joint_names=names,
        series=curve,
        position_range=np.tile([-np.inf, np.inf], (curve.n, 1)),
        velocity_limit=np.full(curve.n, np.inf),
        **({"rate_hz": 100.0, "periods": 1, "rest": 0.5, "connection": 0.0} | timing),
    )


def resting(seed: int, n: int = 2, *, closed: bool = True) -> Spline:
    free = np.random.default_rng(seed).normal(scale=0.3, size=(9, n))
    return Spline.from_free(free, 4.0, closed=closed)


def moving(seed: int) -> list[Curve]:
    """Curves whose ends are not at rest: an open one and a closed one."""
    rng = np.random.default_rng(seed)
    series = series_of(rng, 4.0, 2, highest=5)
    return [Spline(duration=4.0, control_points=rng.normal(size=(9, 2))), series]


@settings(deadline=None, max_examples=10)
@given(seed=SEEDS, kind=st.sampled_from([0, 1]), periods=st.integers(1, 3))
def test_parts_make_up_the_samples(seed: int, kind: int, periods: int) -> None:
    curve = moving(seed)[kind]
    trajectory = along(curve, connection=1.5, periods=periods if kind else 1)
    states = trajectory.sample()
    time = np.arange(trajectory.n_samples) / 100.0
    seen = np.zeros(len(time), dtype=bool)
    for start, part in trajectory.curves():
        rows = (time >= start - 1e-9) & (time < start + part.duration - 1e-9)
        seen |= rows
        for derivative, values in enumerate(states):
            expected = part.evaluate(time[rows] - start, derivative=derivative)
            np.testing.assert_allclose(values[rows], expected, atol=1e-10)
    # What is left are further periods of the same motion, and rest.
    again = (time >= 6.0 - 1e-9) & (time < 2.0 + 4.0 * trajectory.periods - 1e-9)
    np.testing.assert_allclose(states[0][again], states[0][np.flatnonzero(again) - 400], atol=1e-12)
    still = ~seen & ~again
    assert still.sum() == 100
    assert not states[1][still].any()


def test_splines_at_rest_need_no_connection() -> None:
    for closed in (True, False):
        spline = resting(3, closed=closed)
        trajectory = along(spline, periods=2 if closed else 1)
        assert trajectory.closed is closed
        assert trajectory.curves() == ((0.5, spline),)
        q, v, a = trajectory.sample()
        np.testing.assert_array_equal(q[:50], np.broadcast_to(spline.control_points[0], (50, 2)))
        np.testing.assert_array_equal(q[-50:], np.broadcast_to(spline.control_points[-1], (50, 2)))
        for rate in (v, a):
            assert not np.concatenate([rate[:51], rate[-50:]]).any()
    refuses(DataError, "periods=1", along, resting(0, closed=False), periods=2)
    refuses(DataError, "connection", along, moving(0)[0])


def at_rest(orders: int) -> SampledCurve:
    return sampled(np.random.default_rng(4), orders, np.linspace(1.0, 5.0, 9))


CURVES = {
    "closed": resting(1),
    "open": resting(1, closed=False),
    "series": moving(1)[1],
    "positions": at_rest(1),
    "velocities": at_rest(2),
    "accelerations": at_rest(3),
}


@pytest.mark.parametrize("kind", CURVES)
def test_every_curve_survives_its_file(tmp_path: Path, kind: str) -> None:
    trajectory = along(CURVES[kind], connection=0.0 if kind in ("closed", "open") else 1.0)
    file = tmp_path / "one.toml"
    trajectory.to_toml(file)
    # What somebody notes at a joint does not matter.
    file.write_text(file.read_text().replace("[[joint]]", "[[joint]]\nseen = 'today'", 1))
    again = Trajectory.from_toml(file)
    assert type(again.series) is type(trajectory.series)
    for one, other in zip(again.sample(), trajectory.sample(), strict=True):
        np.testing.assert_array_equal(one, other)
    again.to_toml(tmp_path / "again.toml")
    trajectory.to_toml(file)
    assert (tmp_path / "again.toml").read_text() == file.read_text()


@pytest.mark.parametrize("kind", ["closed", "series", "velocities"])
@pytest.mark.parametrize("junk", ["nan", '"text"', "[]", "[1.0, 'a']", "-3", "{a = 1}"])
def test_damaged_files_are_refused(tmp_path: Path, kind: str, junk: str) -> None:
    file = tmp_path / "damaged.toml"
    along(CURVES[kind], connection=1.0).to_toml(file)
    good = file.read_text().splitlines()
    for k, line in enumerate(good):
        key = line.partition(" =")[0]
        # These may be negative, and be another motion.
        if " =" in line and key not in ("name", "notes", "velocity_limit", "center"):
            file.write_text("\n".join([*good[:k], f"{key} = {junk}", *good[k + 1 :]]))
            refuses(DataError, re.escape(str(file)), Trajectory.from_toml, file)
