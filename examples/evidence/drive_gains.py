"""Drive gains of a UR10e from motor currents: two pairs of recordings, and simulated arms.

    python examples/evidence/drive_gains.py --data /path/to/data --out results
    python examples/evidence/drive_gains.py --data /path/to/data --out results --simulated

Each pair is a run without and a run with a load of 2.805 kg. The gains of one pair weigh the load
of the other. Simulated arms have known gains: how often do intervals hold them? The folder of the
data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import sdpid
from sdpid._common.tables import Table

MASS = 2.805  # kg
PAIRS = {
    "19 February": ("20_02_19_15harm50sec", "20_02_19_15harm50secLoad"),
    "31 January": ("20_01_31-unload", "20_01_31-load"),
}
# Other runs without load of the days before the first pair.
OTHERS = (
    "20_02_05-20sec_8harm",
    "20_02_05-20sec_12harm",
    "20_02_06-20sec_5harm",
    "20_02_10-30sec_12harm",
)
# Lines at the beginning of one file that hold rubbish, and its last line, which is broken.
RUBBISH = {"20_02_19_15harm50secLoad": slice(10, -1)}
# Gains of two other sources, N·m/A: of another UR10, and of those who recorded the runs.
PUBLISHED = {
    "another UR10": (14.87, 13.26, 11.13, 10.62, 11.03, 11.47),
    "least squares of the source": (10.0, 10.70, 8.46, 9.00, 9.48, 10.12),
}
COLUMNS = {
    "time": 1,
    "position": list(range(2, 8)),
    "velocity": list(range(8, 14)),
    "effort": list(range(14, 20)),
}

# Simulated arms: gains about these, N·m/A; errors that a model never explains, alike for about a
# tenth of a second, A, as large as those of the recordings; noise of the sensors; friction in A.
GAINS = np.array([12.9, 12.2, 10.15, 10.5, 10.1, 10.3])
ERRORS = np.array([0.10, 0.10, 0.06, 0.015, 0.015, 0.012])
ALIKE = 0.1  # s
NOISE, ENCODER = 0.02, 1e-5  # A, rad
COULOMB = np.array([0.7, 0.8, 0.6, 0.15, 0.15, 0.15])
VISCOUS = np.array([0.6, 0.6, 0.4, 0.08, 0.08, 0.08])
ROTORS = np.array([0.15, 0.15, 0.12, 0.02, 0.02, 0.02])
OF_LOAD = 0.07
RATE = 100.0  # Hz
EFFECTS = ("rotor_inertia", "load")
# Masked as `identify` does, close to reversals only.
UNMASKED = {"reversal_speed": 0.02, "reversal_time": 0.0225, "kept_share": 0.1}
CHOICES = (
    *("choice", "gains_february", "gains_january"),
    *("joint_1_percent", "others_percent", "left_percent"),
)
COVERAGE = (
    *("case", "joint", "arms", "held_percent", "error_percent", "off_percent"),
    *("bias_percent", "refused"),
)


def main() -> int:
    """Run both parts and write their tables."""
    options = parse()
    folder = Path(options.data) / "ur10e_innopolis"
    robot = sdpid.load_robot(folder / "ur10e.urdf")
    if options.simulated:
        simulated(robot, 2 if options.quick else options.arms, options.out)
    else:
        real(robot, folder, options.out, quick=options.quick)
    return 0


def parse() -> argparse.Namespace:
    """Return the options."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", default=os.environ.get("SDPID_DATA"), help="public records")
    parser.add_argument("--out", type=Path, default=Path(), help="folder of the tables")
    parser.add_argument("--simulated", action="store_true", help="simulated arms, no recordings")
    parser.add_argument("--arms", type=int, default=100, help="simulated arms of each case")
    parser.add_argument("--quick", action="store_true", help="effects not chosen, two arms")
    options = parser.parse_args()
    if options.data is None:
        parser.error("name the folder of the public records: --data or SDPID_DATA")
    options.out.mkdir(parents=True, exist_ok=True)
    return options


def read(robot: sdpid.RobotModel, folder: Path, name: str, out: Path) -> sdpid.Recording:
    """Return a recording of currents, rubbish left away."""
    path = folder / f"{name}.csv"
    if name in RUBBISH:
        lines = path.read_text().splitlines()[RUBBISH[name]]
        path = out / f"{name}.csv"
        path.write_text("\n".join(lines) + "\n")
    names = robot.joint_names
    return sdpid.read_recording(path, columns=COLUMNS, joint_names=names, currents=True)


def real(robot: sdpid.RobotModel, folder: Path, out: Path, *, quick: bool) -> None:
    """Write the gains of both pairs, and the loads that the gains of others weigh."""
    settings = {"load": MASS, "effects": EFFECTS if quick else "auto"}
    logs = {
        pair: [read(robot, folder, name, out) for name in names] for pair, names in PAIRS.items()
    }
    others = [read(robot, folder, name, out) for name in OTHERS]
    found, rows = {}, []
    for pair, (bare, loaded) in logs.items():
        found[pair] = sdpid.identify_drive_gains(robot, bare, loaded, **settings)
    many = [logs["19 February"][0], *others]
    found["19 February, five runs"] = sdpid.identify_drive_gains(
        robot, many, logs["19 February"][1], **settings
    )
    bare, loaded = ([log[k] for log in logs.values()] for k in (0, 1))
    found["both pairs"] = sdpid.identify_drive_gains(robot, bare, loaded, **settings)
    for name, each in found.items():
        print(name, each.describe(), sep="\n", flush=True)
        gains = each.gains
        errors = 100.0 * gains.standard_errors / gains.gains
        ends = gains.intervals()
        columns = gains.gains, errors, ends[:, 0], ends[:, 1], each.unconstrained
        for j, joint in enumerate(robot.joint_names):
            starts = f"{each.agreed} of {each.starts}"
            own = (float(column[j]) for column in columns)
            rows.append((name, joint, *own, 100.0 * float(each.share[j]), starts))
    header = ("pair", "joint", "gain", "error_percent", "lower", "upper", "unconstrained")
    Table((*header, "left_percent", "starts"), tuple(rows)).write(out / "gains.csv")

    one, two = (found[pair].gains for pair in PAIRS)
    shift = np.log(one.gains / two.gains)
    errors = np.hypot(*(each.standard_errors / each.gains for each in (one, two)))
    low, high = one.intervals(), two.intervals()
    rows = [
        (
            joint,
            100.0 * float(shift[j]),
            float(shift[j] / errors[j]),
            "yes" if low[j, 0] < high[j, 1] and high[j, 0] < low[j, 1] else "no",
        )
        for j, joint in enumerate(robot.joint_names)
    ]
    header = ("joint", "difference_percent", "in_errors", "overlap")
    Table(header, tuple(rows)).write(out / "pairs.csv")

    Table(CHOICES, tuple(choices(robot, logs))).write(out / "choices.csv")

    rows = []
    for pair in PAIRS:
        own = found[pair].gains
        sources = {other: found[other].gains.gains for other in PAIRS if other != pair}
        for source, gains in {**sources, **PUBLISHED}.items():
            mass, error = weighed(own, np.asarray(gains))
            rows.append((pair, source, mass, error, 100.0 * (mass / MASS - 1.0)))
    header = ("load_of", "gains_of", "mass_kg", "error_kg", "off_percent")
    Table(header, tuple(rows)).write(out / "crosswise.csv")


def choices(
    robot: sdpid.RobotModel, logs: dict[str, list[sdpid.Recording]]
) -> Iterator[tuple[object, ...]]:
    """Yield how far the gains of two pairs are apart when something is done otherwise."""
    own = ("rotor_inertia", "load", "coulomb", "viscous", "sigmoid", "offset")
    others: dict[str, dict[str, Any]] = {
        "as by default": {},
        "slow motion not masked": {"processing": UNMASKED},
        "friction of both runs alike": {"shared": own},
        "no rotor inertia": {"effects": ("load",)},
        "no friction of the load": {"effects": ("rotor_inertia",)},
        "bodies need not exist": {"consistent": False},
    }
    for name, settings in others.items():
        given = {"load": MASS, "effects": EFFECTS, "starts": 0, **settings}
        found = [sdpid.identify_drive_gains(robot, *pair, **given) for pair in logs.values()]
        left = 100.0 * np.mean([each.share[3:] for each in found])
        yield _apart(name, *(each.gains.gains for each in found), float(left))
    regressed = [currents_as_regressors(robot, *pair) for pair in logs.values()]
    yield _apart("errors in torques: currents as regressors", *regressed, None)


def _apart(name: str, one: np.ndarray, two: np.ndarray, left: float | None) -> tuple[object, ...]:
    """Return a row of the table of choices."""
    shift = 100.0 * np.abs(np.log(np.maximum(one, 1e-9) / np.maximum(two, 1e-9)))
    gains = [" ".join(f"{gain:.2f}" for gain in each) for each in (one, two)]
    return (name, *gains, float(shift[0]), float(shift[1:].max()), left)


def currents_as_regressors(
    robot: sdpid.RobotModel, bare: sdpid.Recording, loaded: sdpid.Recording
) -> np.ndarray:
    """Return gains by least squares of torques: links + friction - gain × current = 0."""
    rows, rhs = [], []
    n, links = robot.n, 10 * robot.n_links
    for number, log in enumerate((bare, loaded)):
        samples = sdpid.process(replace(log, currents=False))
        Y = robot.regressor(samples.position, samples.velocity, samples.acceleration)
        v, a = samples.velocity, samples.acceleration
        shapes = (np.sign(v), v, np.ones_like(v), a, np.abs(Y @ robot.prior.ravel()) * np.sign(v))
        A = np.zeros((len(v), n, links + 9 + n + 2 * len(shapes) * n))
        A[:, :, :links] = Y
        if number:
            A[:, :, links : links + 9] = Y[:, :, -9:]
        joints = np.arange(n)
        A[:, joints, links + 9 + joints] = -samples.effort
        first = links + 9 + n + number * len(shapes) * n
        for k, shape in enumerate(shapes):
            A[:, joints, first + k * n + joints] = shape
        used = samples.used
        rows.append(A[used])
        rhs.append(-number * MASS * Y[used][:, -10])
    stacked = np.vstack(rows)
    size = np.linalg.norm(stacked, axis=0)
    size[size == 0.0] = 1.0
    found = np.linalg.lstsq(stacked / size, np.concatenate(rhs), rcond=1e-10)[0] / size
    return np.asarray(found[links + 9 : links + 9 + n])


def weighed(own: sdpid.DriveGains, gains: np.ndarray) -> tuple[float, float]:
    """Return the mass, kg, of a pair's load by given gains, and its error by the pair's data.

    All gains are in proportion to the mass of the load, so it is the one that makes the pair's own
    gains the given ones, as far as its errors are small.
    """
    inverse = np.linalg.inv(own.relative_covariance)
    weights = inverse.sum(axis=0) / inverse.sum()
    mass = MASS * float(np.exp(weights @ np.log(gains / own.gains)))
    return mass, mass * float(inverse.sum()) ** -0.5


@dataclass(frozen=True)
class Arm:
    """A simulated arm with its load.

    Attributes
    ----------
    gains : ndarray, shape (n,)
        N·m/A.
    links : ndarray, shape (links, 10)
        The arm's bodies.
    load : ndarray, shape (10,)
        The load about the last joint.
    """

    gains: np.ndarray
    links: np.ndarray
    load: np.ndarray

    @classmethod
    def drawn(cls, robot: sdpid.RobotModel, rng: np.random.Generator) -> Arm:
        """Return an arm whose links are not quite those described."""
        gains = GAINS * np.exp(rng.normal(0.0, 0.1, robot.n))
        links = robot.prior * np.exp(rng.normal(0.0, 0.15, (robot.n_links, 1)))
        com = np.array([0.0, 0.0, 0.12]) + rng.uniform(-0.1, 0.1, 3)
        own = MASS * np.diag(rng.uniform(0.002, 0.004, 3))
        load = sdpid.Load(mass=MASS, com=com, inertia=own)
        return cls(gains, links, load.theta)

    def log(
        self,
        robot: sdpid.RobotModel,
        rng: np.random.Generator,
        seconds: float,
        *,
        loaded: bool,
        warm: float,
    ) -> sdpid.Recording:
        """Return a recording of currents; friction is `warm` times as large."""
        t = np.arange(round(seconds * RATE)) / RATE
        w, c = rng.uniform(0.2, 2.5, (5, robot.n)), rng.uniform(0.0, 6.3, (5, robot.n))
        size = 0.35 * rng.uniform(0.7, 1.3, (5, robot.n)) / np.sqrt(w)
        angle = w * t[:, None, None] + c
        q = (size * np.sin(angle)).sum(axis=1)
        v = (size * w * np.cos(angle)).sum(axis=1)
        a = -(size * w**2 * np.sin(angle)).sum(axis=1)
        bodies = self.links.copy()
        if loaded:
            bodies[-1] += self.load
        torque = robot.inverse_dynamics(bodies.ravel(), q, v, a)
        sign = np.tanh(v / 0.005)
        current = (torque + OF_LOAD * np.abs(torque) * sign) / self.gains
        current += ROTORS * a + warm * (COULOMB * sign + VISCOUS * v) + 0.02 * rng.normal(size=6)
        current += ERRORS * alike(rng, q.shape) + NOISE * rng.standard_normal(q.shape)
        return sdpid.Recording(
            time=t,
            position=q + ENCODER * rng.standard_normal(q.shape),
            effort=current,
            joint_names=robot.joint_names,
            currents=True,
        )


def alike(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """Return errors of variance one that are alike for about `ALIKE` seconds."""
    keep = np.exp(-1.0 / (RATE * ALIKE))
    noise = rng.standard_normal(shape)
    out = np.empty(shape)
    out[0] = noise[0]
    for k in range(1, len(out)):
        out[k] = keep * out[k - 1] + np.sqrt(1.0 - keep**2) * noise[k]
    return out


def simulated(robot: sdpid.RobotModel, runs: int, out: Path) -> None:
    """Write how often intervals hold the gains of simulated arms."""
    rows = []
    for seconds in (50.0, 25.0):
        held, shifts, errors = [], [], []
        refused = 0
        for seed in range(runs):
            rng = np.random.default_rng(seed)
            arm = Arm.drawn(robot, rng)
            warm = rng.uniform(0.85, 1.15, 2)
            logs = [arm.log(robot, rng, seconds, loaded=bool(k), warm=warm[k]) for k in range(2)]
            try:
                found = sdpid.identify_drive_gains(
                    robot, *logs, load=MASS, effects=EFFECTS, starts=0
                ).gains
            except sdpid.errors.SdpidError as error:
                refused += 1
                print(seconds, seed, error, flush=True)
                continue
            ends = found.intervals()
            held.append((ends[:, 0] < arm.gains) & (arm.gains < ends[:, 1]))
            shifts.append(np.log(found.gains / arm.gains))
            errors.append(found.standard_errors / found.gains)
            if seed % 20 == 19:
                share = 100.0 * np.mean(held, axis=0)
                print(seconds, seed + 1, share.round(1), share.mean().round(1), flush=True)
        parts = {joint: [j] for j, joint in enumerate(robot.joint_names)}
        parts["all joints"] = list(range(robot.n))
        for joint, which in parts.items():
            own = np.asarray(shifts)[:, which]
            rows.append(
                (
                    f"two runs of {seconds:g} s",
                    joint,
                    len(held),
                    100.0 * float(np.mean(np.asarray(held)[:, which])),
                    100.0 * float(np.median(np.asarray(errors)[:, which])),
                    100.0 * float(np.sqrt(np.mean(own**2))),
                    100.0 * float(np.mean(own)),
                    refused,
                )
            )
        Table(COVERAGE, tuple(rows)).write(out / "coverage.csv")


if __name__ == "__main__":
    sys.exit(main())
