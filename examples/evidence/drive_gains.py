"""Drive gains of a UR10e from motor currents: two pairs of recordings, and simulated arms.

    python examples/evidence/drive_gains.py --data /path/to/data --out results
    python examples/evidence/drive_gains.py --data /path/to/data --out results --simulated

Each pair is a run without and a run with a load of 2.805 kg. The gains of one pair weigh the load
of the other. Simulated arms have known gains: how often do intervals hold them? The folder of the
data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from simulated_logs import colored
from study import Rows, Study, grouped, known

import sdpid

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
GAINS_COLUMNS = (
    *("pair", "joint", "gain", "error_percent", "lower", "upper", "unconstrained"),
    *("left_percent", "starts"),
)
# What is done otherwise.
OTHERWISE: dict[str, dict[str, Any]] = {
    "as by default": {},
    "slow motion not masked": {"processing": UNMASKED},
    "friction of both runs alike": {
        "shared": ("rotor_inertia", "load", "coulomb", "viscous", "sigmoid", "offset")
    },
    "no rotor inertia": {"effects": ("load",)},
    "no friction of the load": {"effects": ("rotor_inertia",)},
    "bodies need not exist": {"consistent": False},
}
REGRESSED = "errors in torques: currents as regressors"
CHOICES = (
    *("choice", "gains_february", "gains_january"),
    *("joint_1_percent", "others_percent", "left_percent"),
)
COVERAGE = (
    *("case", "joint", "arms", "held_percent", "error_percent", "off_percent"),
    *("bias_percent", "refused"),
)


@dataclass(frozen=True)
class Runs:
    """The recordings, and the effects that gains of them are identified with."""

    folder: Path
    out: Path
    effects: Any = "auto"

    @cached_property
    def robot(self) -> sdpid.RobotModel:
        """The arm."""
        return sdpid.load_robot(self.folder / "ur10e.urdf")

    def read(self, name: str) -> sdpid.Recording:
        """Return a recording of currents, rubbish left away."""
        path = self.folder / f"{name}.csv"
        if name in RUBBISH:
            lines = path.read_text().splitlines()[RUBBISH[name]]
            path = self.out / f"{name}.csv"
            path.write_text("\n".join(lines) + "\n")
        names = self.robot.joint_names
        return sdpid.read_recording(path, columns=COLUMNS, joint_names=names, currents=True)

    @cached_property
    def pairs(self) -> dict[str, list[sdpid.Recording]]:
        """A run without and one with the load, by day."""
        return {pair: [self.read(name) for name in names] for pair, names in PAIRS.items()}

    @cached_property
    def found(self) -> dict[str, Any]:
        """Gains of each pair, of one with more runs without a load, and of both."""
        first, second = self.pairs.values()
        others = [self.read(name) for name in OTHERS]
        logs: dict[str, Any] = {
            **self.pairs,
            "19 February, five runs": ([first[0], *others], first[1]),
            "both pairs": ([first[0], second[0]], [first[1], second[1]]),
        }
        return {
            name: sdpid.identify_drive_gains(self.robot, *own, load=MASS, effects=self.effects)
            for name, own in logs.items()
        }

    def gains(self) -> Rows:
        """Yield the gains of each joint."""
        for name, each in self.found.items():
            gains = each.gains
            errors, ends = 100.0 * gains.standard_errors / gains.gains, gains.intervals().T
            columns = gains.gains, errors, *ends, each.unconstrained, 100.0 * each.share
            for joint, *own in zip(self.robot.joint_names, *columns, strict=True):
                yield name, joint, *own, f"{each.agreed} of {each.starts}"

    def apart(self) -> Rows:
        """Yield how far the gains of two pairs are apart."""
        one, two = (self.found[pair].gains for pair in PAIRS)
        shift = np.log(one.gains / two.gains)
        errors = np.hypot(*(each.standard_errors / each.gains for each in (one, two)))
        (low, high), (least, most) = one.intervals().T, two.intervals().T
        overlap = np.where((low < most) & (least < high), "yes", "no")
        yield from zip(self.robot.joint_names, 100.0 * shift, shift / errors, overlap, strict=True)

    def choices(self, name: str) -> Rows:
        """Yield how far the gains of two pairs are apart when something is done otherwise."""
        left = None
        if name in OTHERWISE:
            given = {"load": MASS, "effects": EFFECTS, "starts": 0, **OTHERWISE[name]}
            found = [
                sdpid.identify_drive_gains(self.robot, *pair, **given)
                for pair in self.pairs.values()
            ]
            one, two = (each.gains.gains for each in found)
            left = 100.0 * np.mean([each.share[3:] for each in found])
        else:
            one, two = (currents_as_regressors(self.robot, *pair) for pair in self.pairs.values())
        shift = 100.0 * np.abs(np.log(np.maximum(one, 1e-9) / np.maximum(two, 1e-9)))
        gains = [" ".join(f"{gain:.2f}" for gain in each) for each in (one, two)]
        yield *gains, shift[0], shift[1:].max(), left

    def crosswise(self) -> Rows:
        """Yield what gains of others weigh the load of a pair with."""
        for pair in PAIRS:
            sources = {other: self.found[other].gains.gains for other in PAIRS if other != pair}
            for source, gains in {**sources, **PUBLISHED}.items():
                mass, error = weighed(self.found[pair].gains, np.asarray(gains))
                yield pair, source, mass, error, 100.0 * (mass / MASS - 1.0)


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


def simulated(
    robot: sdpid.RobotModel, rng: np.random.Generator, seconds: float
) -> tuple[np.ndarray, list[sdpid.Recording]]:
    """Return the gains of a drawn arm, N·m/A, and its recordings without and with a load.

    Its links are not quite those described, and its friction changes between the recordings.
    """
    gains = GAINS * np.exp(rng.normal(0.0, 0.1, robot.n))
    links = robot.prior * np.exp(rng.normal(0.0, 0.15, (robot.n_links, 1)))
    com = np.array([0.0, 0.0, 0.12]) + rng.uniform(-0.1, 0.1, 3)
    own = MASS * np.diag(rng.uniform(0.002, 0.004, 3))
    loaded = links.copy()
    loaded[-1] += sdpid.Load(mass=MASS, com=com, inertia=own).theta
    warm = rng.uniform(0.85, 1.15, 2)
    each = zip((links, loaded), warm, strict=True)
    return gains, [recorded(robot, gains, bodies, rng, seconds, size) for bodies, size in each]


def recorded(
    robot: sdpid.RobotModel,
    gains: np.ndarray,
    bodies: np.ndarray,
    rng: np.random.Generator,
    seconds: float,
    warm: float,
) -> sdpid.Recording:
    """Return a recording of currents of bodies (links, 10); friction is `warm` times as large."""
    t = np.arange(round(seconds * RATE)) / RATE
    w, c = rng.uniform(0.2, 2.5, (5, robot.n)), rng.uniform(0.0, 6.3, (5, robot.n))
    size = 0.35 * rng.uniform(0.7, 1.3, (5, robot.n)) / np.sqrt(w)
    angle = w * t[:, None, None] + c
    q = (size * np.sin(angle)).sum(axis=1)
    v = (size * w * np.cos(angle)).sum(axis=1)
    a = -(size * w**2 * np.sin(angle)).sum(axis=1)
    torque = robot.inverse_dynamics(bodies.ravel(), q, v, a)
    sign = np.tanh(v / 0.005)
    current = (torque + OF_LOAD * np.abs(torque) * sign) / gains
    current += ROTORS * a + warm * (COULOMB * sign + VISCOUS * v) + 0.02 * rng.normal(size=6)
    unexplained = ERRORS * colored(q.shape, np.exp(-1.0 / (RATE * ALIKE)), rng)
    current += unexplained + NOISE * rng.standard_normal(q.shape)
    return sdpid.Recording(
        time=t,
        position=q + ENCODER * rng.standard_normal(q.shape),
        effort=current,
        joint_names=robot.joint_names,
        currents=True,
    )


def compared(robot: sdpid.RobotModel, seconds: float, seed: int) -> Rows:
    """Yield of each joint of a simulated arm whether its interval holds the gain."""
    gains, logs = simulated(robot, np.random.default_rng(seed), seconds)
    case, options = f"two runs of {seconds:g} s", {"load": MASS, "effects": EFFECTS, "starts": 0}
    try:
        found = sdpid.identify_drive_gains(robot, *logs, **options).gains
    except sdpid.errors.SdpidError as error:
        print(seconds, seed, error, flush=True)
        yield case, "refused", None, None, None
        return
    low, high = found.intervals().T
    columns = (
        (low < gains) & (gains < high),
        100.0 * np.log(found.gains / gains),
        100.0 * found.standard_errors / found.gains,
    )
    for joint, *own in zip(robot.joint_names, *columns, strict=True):
        yield case, joint, *own


def coverage(rows: list[dict[str, Any]], joints: tuple[str, ...]) -> Rows:
    """Yield how often intervals hold the gains of simulated arms, by joint and of all."""
    for (case,), own in grouped(rows, "case"):
        arms, refused = ((own["joint"] == each).sum() for each in (joints[0], "refused"))
        for joint in (*joints, "all joints"):
            which = own["joint"] != "refused" if joint == "all joints" else own["joint"] == joint
            held, shift, error = (known(own[each][which]) for each in ("held", "shift", "error"))
            sizes = np.median(error), np.sqrt(np.mean(shift**2)), np.mean(shift)
            yield case, joint, arms, 100.0 * np.mean(held), *sizes, refused


def main() -> None:
    """Run recordings or simulated arms, and write their tables."""
    study = Study(
        __doc__,
        data=True,
        quick={"arms": 2, "effects": [*EFFECTS]},
        simulated=(False, "simulated arms, no recordings"),
        arms=(100, "simulated arms of each case"),
        effects=(["auto"], "that gains are identified with"),
    )
    effects = "auto" if study.effects == ["auto"] else study.effects
    runs = Runs(study.data / "ur10e_innopolis", study.out, effects)
    if study.simulated:
        header = ("case", "joint", "held", "shift", "error")
        axes = (50.0, 25.0), range(study.arms)
        found = study.rows("arms.csv", header, partial(compared, runs.robot), *axes)
        study.write("coverage.csv", COVERAGE, coverage(found, runs.robot.joint_names))
        return
    study.write("gains.csv", GAINS_COLUMNS, runs.gains())
    study.write("pairs.csv", ("joint", "difference_percent", "in_errors", "overlap"), runs.apart())
    study.rows("choices.csv", CHOICES, runs.choices, [*OTHERWISE, REGRESSED])
    header = ("load_of", "gains_of", "mass_kg", "error_kg", "off_percent")
    study.write("crosswise.csv", header, runs.crosswise())


if __name__ == "__main__":
    main()
