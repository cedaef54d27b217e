"""Score excitations: those that others published, the paper's, and the best of random ones.

The score is the unscaled condition number of the stacked regressor, and the log determinant of
W^T·W/K, on a grid of 0.01 s over the columns of the data's READMEs: base columns (with rotor
inertias where stated) from Pinocchio's regressor, and sign(v), v and 1 for each joint. Scored are
the published excitations of the UR10e and the LWR 4+, the paper's for the Denso, and the best of
random Fourier series; all are held against their own limits at 10 kHz (`dense_check.py`).

    python examples/evidence/excitation_baselines.py --data DATA --out results

The folder DATA (or SDPID_DATA) is described in docs/evidence/data.md.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from dense_check import Reached, States, curve_states, joints_reached, states_of

import sdpid
from sdpid._common.arrays import Array
from sdpid._common.tables import Table
from sdpid.experiment.trajectory.fourier import FourierSeries

# The grid of the score, Hz; states and tolerance by which independent columns are found.
SCORE_HZ, STATES, INDEPENDENT = 100.0, 600, 1e-6

# Random motions: harmonics of a joint, the grid on which they are scaled, and what of each limit
# is left for what happens between its instants.
HARMONICS, SCALING_HZ, LEFT = 10, 200.0, 0.99


@dataclass(frozen=True, kw_only=True, eq=False)
class Bounds:
    """Limits of every joint, (n,) each; infinite where there are none."""

    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array

    @classmethod
    def of(cls, robot: sdpid.RobotModel, acceleration: float = np.inf) -> Bounds:
        """Return the limits of a description, with one of acceleration."""
        lower, upper = robot.position_limits.T
        return cls(
            lower=lower,
            upper=upper,
            velocity=robot.velocity_limits,
            acceleration=np.full(robot.n, acceleration),
        )

    def reached(self, names: Sequence[str], states: States) -> list[Reached]:
        """Return what a motion reaches of these limits."""
        none = np.full(len(names), np.inf)
        return list(joints_reached(names, states, jerk=none, **vars(self)))


class Columns:
    """The columns over which motions of a robot are scored.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    rotors : bool
        Whether rotor inertias are among the parameters.
    friction : bool
        Whether sign(v), v and 1 of every joint are.
    """

    def __init__(self, robot: sdpid.RobotModel, *, rotors: bool, friction: bool) -> None:
        self.robot, self.rotors, self.friction = robot, rotors, friction
        rng = np.random.default_rng(0)
        position = rng.uniform(-3.0, 3.0, (STATES, robot.n))
        v, a = rng.standard_normal((2, STATES, robot.n))
        self.kept = _independent(self._inertial(position, v, a).reshape(STATES * robot.n, -1))

    @property
    def count(self) -> int:
        """Number of columns."""
        return len(self.kept) + (3 * self.robot.n if self.friction else 0)

    def _inertial(self, position: Array, v: Array, a: Array) -> Array:
        """Return the regressor of the links, and of the rotors, (K, n, p)."""
        import pinocchio as pin

        model, gears = self.robot.pin_model, self.robot.expansion
        data = model.createData()
        states = zip(self.robot.configuration(position), v @ gears.T, a @ gears.T, strict=True)
        Y = np.array([pin.computeJointTorqueRegressor(model, data, *each) for each in states])
        Y = np.einsum("mn,kmp->knp", gears, Y)
        return np.concatenate([Y, _diagonals(a)], axis=2) if self.rotors else Y

    def matrix(self, states: States) -> Array:
        """Return the stacked regressor W, (K·n, columns)."""
        v = states.velocity
        W = self._inertial(states.position, v, states.acceleration)[:, :, self.kept]
        if self.friction:
            W = np.concatenate([W, *map(_diagonals, (np.sign(v), v, np.ones_like(v)))], axis=2)
        return W.reshape(-1, W.shape[2])

    def score(self, states: States) -> tuple[float, float]:
        """Return cond(W), unscaled, and log det(W^T·W/K)."""
        values = np.linalg.svd(self.matrix(states), compute_uv=False)
        log_det = 2.0 * float(np.sum(np.log(values))) - len(values) * np.log(len(states.time))
        return float(values[0] / values[-1]), log_det


def _diagonals(values: Array) -> Array:
    """Return diagonal matrices (K, n, n) of rows (K, n)."""
    return np.asarray(values[:, :, None] * np.eye(values.shape[1]))


def _independent(W: Array) -> Array:
    """Return the columns that are independent of those before them."""
    kept: list[int] = []
    Q = np.zeros((len(W), 0))
    for j, length in enumerate(np.linalg.norm(W, axis=0)):
        column = W[:, j] / max(length, np.finfo(float).tiny)
        for _ in range(2):  # once more for rounding
            column = column - Q @ (Q.T @ column)
        rest = np.linalg.norm(column)
        if length > INDEPENDENT and rest > INDEPENDENT:
            kept.append(j)
            Q = np.column_stack([Q, column / rest])
    return np.array(kept)


@dataclass(frozen=True, eq=False)
class UrMotion:
    """An excitation of shamilmamedov/dynamic_calibration: Fourier series and a polynomial.

    `a`, `b` (6, N) are the cosine and sine coefficients of the velocity, `polynomial` (6, 6) those
    of 1, t, …, t⁵.
    """

    a: Array
    b: Array
    polynomial: Array
    duration: float
    bounds: Bounds

    @classmethod
    def read(cls, path: Path) -> UrMotion:
        """Read a ``.mat`` file with the limits that it was made for."""
        from scipy.io import loadmat

        data = loadmat(path, squeeze_me=True)
        given = {
            key: np.asarray(data["traj_par"][key].item(), dtype=np.float64)
            for key in ("T", "q_min", "q_max", "qd_max", "q2d_max")
        }
        bounds = Bounds(
            lower=given["q_min"],
            upper=given["q_max"],
            velocity=given["qd_max"],
            acceleration=given["q2d_max"],
        )
        return cls(data["a"], data["b"], data["c_pol"].T, float(given["T"]), bounds)

    def evaluate(self, time: Array, *, derivative: int = 0) -> Array:
        """Return a derivative of the positions, (K, 6)."""
        from numpy.polynomial import polynomial

        rate = 2.0 * np.pi / self.duration * np.arange(1, self.a.shape[1] + 1)
        # The velocity is the real part of (a - i·b)·exp(i·rate·t).
        waves = np.exp(1j * np.outer(time, rate)) * (1j * rate) ** (derivative - 1)
        of_time = polynomial.polyval(time, polynomial.polyder(self.polynomial, derivative)).T
        return np.asarray(np.real(waves @ (self.a - 1j * self.b).T) + of_time)


def lwr_peer(path: Path) -> States:
    """Return the states of FloBaRoID's excitation, as published on its grid."""
    data = np.load(path)
    v, a = data["velocity"], data["acceleration"]
    return States(data["time"], data["position"], v, a, np.gradient(a, data["time"], axis=0))


def random_motion(bounds: Bounds, duration: float, rng: np.random.Generator) -> FourierSeries:
    """Draw a Fourier series that fills the first limit that each joint meets."""
    n = len(bounds.lower)
    harmonics = np.tile(np.arange(1, HARMONICS + 1), (n, 1))
    series = FourierSeries(
        period=duration,
        center=np.zeros(n),
        harmonics=harmonics,
        amplitudes=rng.standard_exponential(harmonics.shape) / harmonics ** rng.uniform(0.5, 1.5),
        phases=rng.uniform(0.0, 2.0 * np.pi, harmonics.shape),
    )
    states = [series.one_period(round(SCALING_HZ * duration), derivative=k) for k in range(3)]
    low, high = states[0].min(axis=0), states[0].max(axis=0)
    room = bounds.upper - bounds.lower
    peaks = [high - low, *(np.abs(values).max(axis=0) for values in states[1:])]
    limits = (room, bounds.velocity, bounds.acceleration)
    size = LEFT * np.min([limit / peak for limit, peak in zip(limits, peaks, strict=True)], axis=0)
    at = np.where(np.isfinite(room), bounds.lower - size * low, 0.0)
    free = np.where(np.isfinite(room), room - size * (high - low), 0.0)
    return FourierSeries(
        period=duration,
        center=at + free * rng.uniform(0.005, 0.995, n),
        harmonics=harmonics,
        amplitudes=series.amplitudes * size[:, None],
        phases=series.phases,
    )


def best_random(
    columns: Columns, bounds: Bounds, duration: float, seconds: float, seed: int = 0
) -> tuple[FourierSeries, int]:
    """Return the best random motion by cond(W) that is found in some time, and how many were."""
    rng = np.random.default_rng(seed)
    best, found, count = np.inf, None, 0
    end = time.perf_counter() + seconds
    while found is None or time.perf_counter() < end:
        series = random_motion(bounds, duration, rng)
        score, _ = columns.score(curve_states(series, duration, 10.0))
        count += 1
        if score < best:
            best, found = score, series
    return found, count


# What the least slack is told of.
KINDS = ("position", "velocity", "acceleration", "jerk", "torque", "distance")


@dataclass(frozen=True, kw_only=True)
class Row:
    """One motion: its score over some columns, and what is left of its limits.

    Attributes
    ----------
    seconds : float or None
        What the search took.
    position, velocity, acceleration, jerk, torque, distance : float or None
        The least slack of each kind: a share of the limit, of positions in rad, of distances in m.
    broken, collisions : int or None
        Limits that are broken on a fine grid, and pairs that come closer than the clearance.
    """

    robot: str
    limits: str
    plan: str
    seconds: float | None
    columns: int
    cond: float
    log_det: float
    position: float | None
    velocity: float | None
    acceleration: float | None
    jerk: float | None
    torque: float | None
    distance: float | None
    broken: int
    collisions: int | None


def row_of(
    robot: str,
    limits: str,
    plan: str,
    columns: Columns,
    scored: States,
    reached: Iterable[Reached],
    seconds: float | None = None,
) -> Row:
    """Return the row of a motion: scored on one grid, its limits looked at on another."""
    cond, log_det = columns.score(scored)
    reached = list(reached)
    least = {
        kind: min((slack_of(r) for r in reached if r.kind == kind), default=None) for kind in KINDS
    }
    apart = [r.held for r in reached if r.kind == "distance"]
    return Row(
        robot=robot,
        limits=limits,
        plan=plan,
        seconds=seconds,
        columns=columns.count,
        cond=cond,
        log_det=log_det,
        broken=sum(not r.held for r in reached if r.kind != "distance"),
        collisions=apart.count(False) if apart else None,
        **least,
    )


def slack_of(reached: Reached) -> float:
    """Return what is left of a limit: its share, but rad of positions and m of distances."""
    return reached.slack if reached.kind in ("position", "distance") else reached.share


def ur10e_rows(data: Path, seconds: float, dense_hz: float) -> Iterator[Row]:
    """Yield the published excitations of the UR10e, and random ones under one of their limits."""
    folder = data / "ur10e_innopolis"
    robot = sdpid.load_robot(folder / "ur10e.urdf")
    columns = Columns(robot, rotors=True, friction=True)
    for path in sorted((folder / "optimal_trajectories").glob("*.mat")):
        peer = UrMotion.read(path)
        yield row_of(
            "UR10e",
            f"of {path.stem}",
            "published",
            columns,
            curve_states(peer, peer.duration, SCORE_HZ),
            peer.bounds.reached(robot.joint_names, curve_states(peer, peer.duration, dense_hz)),
        )
        if path.stem.endswith("N10T20QR"):
            yield random_row("UR10e", f"of {path.stem}", robot, columns, peer, seconds, dense_hz)


def random_row(
    name: str,
    limits: str,
    robot: sdpid.RobotModel,
    columns: Columns,
    like: Any,
    seconds: float,
    dense_hz: float,
) -> Row:
    """Return the best random motion of the duration and bounds of another."""
    series, count = best_random(columns, like.bounds, like.duration, seconds)
    return row_of(
        name,
        limits,
        f"best of {count} random",
        columns,
        curve_states(series, like.duration, SCORE_HZ),
        like.bounds.reached(robot.joint_names, curve_states(series, like.duration, dense_hz)),
        seconds,
    )


@dataclass(frozen=True, eq=False)
class Task:
    """Bounds and a duration (s)."""

    bounds: Bounds
    duration: float


def lwr_task(robot: sdpid.RobotModel, peer: States) -> Task:
    """Return 12 s under the description's limits and the peer's peak acceleration of each joint."""
    peak = np.abs(peer.acceleration).max(axis=0)
    return Task(Bounds(**{**vars(Bounds.of(robot)), "acceleration": peak}), 12.0)


def lwr_rows(data: Path, seconds: float, dense_hz: float) -> Iterator[Row]:
    """Yield FloBaRoID's excitation of the LWR 4+, and random ones at its peak acceleration."""
    folder = data / "kuka_lwr4plus"
    robot = sdpid.load_robot(folder / "kuka_lwr4.urdf")
    peer = lwr_peer(folder / "flobaroid_excitation.npz")
    task = lwr_task(robot, peer)
    for friction in (False, True):
        columns = Columns(robot, rotors=False, friction=friction)
        reached = task.bounds.reached(robot.joint_names, peer)
        yield row_of("LWR 4+", "peer's acceleration", "published", columns, peer, reached)
        yield random_row("LWR 4+", "peer's acceleration", robot, columns, task, seconds, dense_hz)


def denso_task() -> tuple[sdpid.RobotModel, Task, States]:
    """Return the Denso, its Table II with the paper's peak acceleration, and the paper's motion."""
    robot = sdpid.load_robot("denso_vp6242")
    paper = sdpid.paper_excitation("denso_vp6242", 0, period=20.0, periods=1)
    states = curve_states(paper.series, 20.0, SCORE_HZ)
    lower, upper = paper.position_range.T
    bounds = Bounds(
        lower=lower,
        upper=upper,
        velocity=paper.velocity_limit,
        acceleration=np.abs(states_of(paper).acceleration).max(axis=0),
    )
    return robot, Task(bounds, 20.0), states


def denso_rows(seconds: float) -> Iterator[Row]:
    """Yield the paper's excitation in 20 s, and random ones under the same limits."""
    robot, task, paper = denso_task()
    columns = Columns(robot, rotors=False, friction=True)
    reached = task.bounds.reached(robot.joint_names, paper)
    yield row_of("Denso", "Table II", "paper, one period of 20 s", columns, paper, reached)
    yield random_row("Denso", "Table II", robot, columns, task, seconds, SCORE_HZ)


def table_of(rows: Sequence[Row]) -> Table:
    """Return the rows as a table."""
    return Table.of_columns({key: [vars(row)[key] for row in rows] for key in vars(rows[0])})


def main() -> int:
    """Score every excitation that is there."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--data", type=Path, default=os.environ.get("SDPID_DATA"))
    parser.add_argument("--seconds", type=float, default=10.0, help="of the search at random")
    parser.add_argument("--quick", action="store_true", help="half a second each, 1 kHz")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    seconds, dense_hz = (0.5, 1e3) if options.quick else (options.seconds, 10e3)
    rows = list(denso_rows(seconds))
    if options.data is None:
        print("UR10e and LWR 4+ are left out: name the folder of the data by --data or SDPID_DATA.")
    else:
        rows += ur10e_rows(options.data, seconds, dense_hz)
        rows += lwr_rows(options.data, seconds, dense_hz)
    table = table_of(rows)
    table.write(options.out / "excitation_baselines.csv")
    print(table.text(4))
    return 0


if __name__ == "__main__":
    sys.exit(main())
