"""Trajectories along any curve: their samples, their parts and their files."""

import re
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sdpid
from sdpid.errors import DataError
from sdpid.experiment.trajectory.curve import Curve
from sdpid.experiment.trajectory.fourier import FourierSeries
from sdpid.experiment.trajectory.sampled import SampledCurve
from sdpid.experiment.trajectory.spline import Spline
from sdpid.experiment.trajectory.trajectory import Trajectory
from tests.helpers.refusals import refuses


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
    series = FourierSeries(
        period=4.0,
        center=rng.normal(size=2),
        harmonics=[[1, 3], [2, 5]],
        amplitudes=rng.normal(size=(2, 2)),
        phases=rng.uniform(0.0, 7.0, size=(2, 2)),
    )
    return [Spline(duration=4.0, control_points=rng.normal(size=(9, 2))), series]


@settings(deadline=None, max_examples=10)
@given(seed=st.integers(0, 2**32 - 1), kind=st.sampled_from([0, 1]), periods=st.integers(1, 3))
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
    h = 0.01
    for value, rate in pairwise(states):
        bend = np.abs(np.diff(rate, axis=0)).max()
        np.testing.assert_allclose(
            np.diff(value, axis=0), h / 2 * (rate[1:] + rate[:-1]), atol=h * bend
        )


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


def sampled(orders: int) -> SampledCurve:
    values = np.random.default_rng(4).normal(size=(3, 9, 2))
    values[1:, [0, -1]] = 0.0
    names = ("position", "velocity", "acceleration")
    given = dict(zip(names, values[:orders], strict=False))
    return SampledCurve(time=np.linspace(1.0, 5.0, 9), **given)


CURVES = {
    "closed": resting(1),
    "open": resting(1, closed=False),
    "series": moving(1)[1],
    "positions": sampled(1),
    "velocities": sampled(2),
    "accelerations": sampled(3),
}


@pytest.mark.parametrize("kind", CURVES)
def test_every_curve_survives_its_file(tmp_path: Path, kind: str) -> None:
    trajectory = along(CURVES[kind], connection=0.0 if kind in ("closed", "open") else 1.0)
    trajectory.to_toml(tmp_path / "one.toml")
    again = Trajectory.from_toml(tmp_path / "one.toml")
    assert type(again.series) is type(trajectory.series)
    for one, other in zip(again.sample(), trajectory.sample(), strict=True):
        np.testing.assert_array_equal(one, other)
    again.to_toml(tmp_path / "again.toml")
    assert (tmp_path / "again.toml").read_text() == (tmp_path / "one.toml").read_text()


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


@pytest.mark.parametrize("closed", [True, False])
def test_a_robot_follows_a_spline(closed: bool) -> None:
    robot = sdpid.load_robot("ur5_robot")
    trajectory = along(
        resting(2, robot.n, closed=closed), robot.joint_names, periods=2 if closed else 1
    )
    log = sdpid.simulate(robot, trajectory, noise=False, progress=False)
    assert log.n_samples == trajectory.n_samples
    assert log.periods == (2 if closed else None)
    # The loop lags behind by 1/8 s; a closed motion's record starts in the settling period.
    q, v, _ = trajectory.sample()
    rows = slice(trajectory.lead_samples, -trajectory.lead_samples)
    lag = np.abs(log.position[rows] - q[rows]).max()
    assert lag < 0.2 * np.abs(v).max()
