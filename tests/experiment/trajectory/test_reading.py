"""Motions are read from files of any tool, and what is wrong with one is named."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from sdpid.errors import DataError
from sdpid.experiment.trajectory.reading import between_rests, read_trajectory
from sdpid.experiment.trajectory.sampled import SampledCurve
from sdpid.experiment.trajectory.spline import Spline
from tests.helpers.refusals import refuses

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


def test_joints_in_another_order_and_arrays(tmp_path: Path) -> None:
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


def test_degrees(tmp_path: Path) -> None:
    q = np.degrees(SPLINE.evaluate(TIME))
    table = pd.DataFrame(q, columns=[f"q{j} [deg]" for j in range(3)])
    table.insert(0, "time_ms", 1e3 * TIME)
    table.to_csv(tmp_path / "deg.csv", index=False)
    motion = read_trajectory(tmp_path / "deg.csv", NAMES)
    np.testing.assert_allclose(motion.series.evaluate(TIME), np.radians(q), atol=1e-9)


def degrees(table: pd.DataFrame) -> pd.DataFrame:
    table["velocity_elbow"] = np.degrees(table["velocity_elbow"])
    return table


def repeated(table: pd.DataFrame) -> pd.DataFrame:
    table.loc[7, "time"] = table.loc[6, "time"]
    return table


def holed(table: pd.DataFrame) -> pd.DataFrame:
    table.loc[41, "velocity_elbow"] = np.nan
    return table


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (degrees, "velocity of elbow is 57.3 times"),
        (repeated, "line 9: time does not increase: 0.06 s after 0.06 s"),
        (holed, "line 43: velocity_elbow has no finite value"),
        (lambda table: table.drop(columns="time"), "column time is missing"),
        (lambda table: table[["time"]], "column position_<joint> is missing"),
        (
            lambda table: table.rename(columns={"position_elbow": "position_knee"}),
            "no joint knee; positions of elbow are missing",
        ),
        (lambda table: table.drop(columns="velocity_elbow"), "give the same joints"),
        (lambda table: table.drop(columns="acceleration_elbow"), "give the same joints"),
        (
            lambda table: table[[name for name in table if not name.startswith("velocity")]],
            "without velocities",
        ),
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


def test_files_that_are_no_trajectories(tmp_path: Path) -> None:
    refuses(DataError, "no such file", read_trajectory, tmp_path / "none.csv")
    refuses(DataError, "no format of trajectories", read_trajectory, tmp_path / "motion.bag")
    frame().to_csv(tmp_path / "unnamed.csv", index=False, header=False)
    refuses(DataError, "column time is missing", read_trajectory, tmp_path / "unnamed.csv")
