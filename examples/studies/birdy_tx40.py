"""BIRDy's TX40 rebuilt: how far `identify` is from the truth on a clean log of a closed loop.

The robot of the benchmark of Leboutet et al. (github.com/TUM-ICS/BIRDy, MIT), without the coupling
of its wrist: its true inertias, rotor inertias, Coulomb and viscous friction, and its controller, a
proportional and derivative one at 5 kHz that differentiates noisy encoders. Motions are Fourier
series of 20 harmonics that start at rest, the best of random ones by cond(W) + 100/σ_min, within
the limits of position, velocity and acceleration; 10 s are logged at 1 kHz and go through
`sdpid.identify` with the friction terms that the robot has, and a description whose inertias are
off by 15 %, as the benchmark's initial estimates are.

    python examples/studies/birdy_tx40.py --parameters tx40.toml --out results

The TOML file holds the numbers of the benchmark's RobotDescriptionFiles/TX40.m; the environment
variable SDPID_BIRDY may name it too. Joints stick exactly: friction at rest is what it takes to
stay there, up to Coulomb friction. A run takes some three seconds.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
import numpy as np
from simulated_logs import perturbed

import sdpid
from sdpid._common.arrays import Array
from sdpid._common.files import atomic_write_text
from sdpid._common.jobs import parallel
from sdpid._common.tables import Table
from sdpid._common.toml import load_toml

# Standard deviations of the encoders (degrees) and of the measured torque (N·m).
NOISE = {
    "none": (0.0, 0.0),
    "lowPosition": (1e-4, 0.05),
    "standard": (1e-3, 0.05),
    "highPosition": (1e-2, 0.05),
}

DURATION, HARMONICS, CANDIDATES = 10.0, 20, 30
# Steps of the simulation in a period of the controller, and samples that are cut off at either end
# of the log.
SUBSTEPS, CUT = 2, 50

# As the benchmark's initial estimates.
PERTURBED = 0.15

# Sweeps over the joints until their friction agrees with their velocities.
SWEEPS = 20


@dataclass(frozen=True, eq=False)
class Plant:
    """The robot and its controller, as the TOML file has them; arrays are (6,) or (6, …)."""

    robot: sdpid.RobotModel
    coulomb: Array
    viscous: Array
    rotor: Array
    stiffness: Array
    damping: Array
    rate_hz: float
    sample_hz: float
    position: Array
    velocity: Array
    acceleration: float

    @classmethod
    def read(cls, path: Path) -> Plant:
        """Read a plant from a TOML file."""
        data: dict[str, Any] = load_toml(path)
        table, links, control = data["kinematics"], data["links"], data["control"]
        limits = data["limits"]
        position = np.radians([limits["position_deg"][k] for k in ("lower", "upper")])
        columns = {
            "alpha": np.radians(table["alpha_deg"]),
            "d": np.array(table["a"]),
            "theta": np.radians(table["theta_offset_deg"]),
            "r": np.array(table["d"]),
            "lower": position[0],
            "upper": position[1],
        }
        joints = [{key: float(column[j]) for key, column in columns.items()} for j in range(6)]
        order = [0, 1, 3, 2, 4, 5]  # of the file's inertias, for xx xy yy xz yz zz
        inertias = np.column_stack(
            [links["mass"], links["first_moment"], np.array(links["inertia"])[:, order]]
        )
        robot = sdpid.RobotModel.from_mdh(
            joints,
            base_translation=[0.0, 0.0, table["base_height"]],
            inertias=inertias,
            name="tx40",
        )
        gain = np.array(control["drive_gain"])
        return cls(
            robot=robot,
            coulomb=np.array(data["friction"]["coulomb"]),
            viscous=np.array(data["friction"]["viscous"]),
            rotor=np.array(links["rotor_inertia"]),
            stiffness=gain * control["kp"],
            damping=gain * control["kd"],
            rate_hz=control["rate_hz"],
            sample_hz=control["sample_hz"],
            position=position,
            velocity=np.radians(limits["velocity_deg_s"]),
            acceleration=limits["acceleration_rad_s2"],
        )

    def described(self, rng: np.random.Generator, known: bool) -> sdpid.RobotModel:
        """Return the robot as its user has it: inertias off by some 15 %, or none at all."""
        model = self.robot.pin_model.copy()
        bodies = perturbed(self.robot.prior, PERTURBED, rng)
        for i, body in enumerate(bodies, 1):
            if known:
                model.inertias[i] = type(model.inertias[i]).FromDynamicParameters(body)
            else:
                model.inertias[i].setZero()
        return sdpid.RobotModel.from_pinocchio(model)


def excitation(plant: Plant, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return desired positions and velocities (K, 6) at the controller's rate."""
    time = np.arange(round(DURATION * plant.rate_hz)) / plant.rate_hz
    omega = 2.0 * math.pi / DURATION * np.arange(1, HARMONICS + 1)
    coarse = slice(0, None, len(time) // 200)
    best: tuple[float, Array, Array] | None = None
    for _ in range(CANDIDATES):
        # Accelerations of all harmonics alike; at rest at the start: sums of these vanish.
        cosine, sine = rng.standard_normal((2, HARMONICS, plant.robot.n)) / omega[:, None]
        cosine -= cosine.mean(axis=0)
        ends = np.column_stack([1.0 / omega, omega])
        sine -= ends @ np.linalg.solve(ends.T @ ends, ends.T @ sine)
        phase = time[:, None] * omega
        q = np.sin(phase) @ (cosine / omega[:, None]) - np.cos(phase) @ (sine / omega[:, None])
        v = np.cos(phase) @ cosine + np.sin(phase) @ sine
        a = np.cos(phase) @ (sine * omega[:, None]) - np.sin(phase) @ (cosine * omega[:, None])
        low, high = plant.position
        part = 0.95 * np.min(
            [
                (high - low) / np.ptp(q, axis=0),
                plant.velocity / np.abs(v).max(axis=0),
                plant.acceleration / np.abs(a).max(axis=0),
            ],
            axis=0,
        )
        middle = 0.5 * (low + high) - part * 0.5 * (q.max(axis=0) + q.min(axis=0))
        q, v, a = middle + part * q, part * v, part * a
        samples = sdpid.Samples(
            position=q[coarse], velocity=v[coarse], acceleration=a[coarse], effort=0.0 * q[coarse]
        )
        problem = sdpid.build_problem(plant.robot, samples, friction=terms(), weighting="gls")
        singular = np.linalg.svd(problem.A, compute_uv=False)
        score = singular[0] / singular[-1] + 100.0 / singular[-1]
        if best is None or score < best[0]:
            best = score, q, v
    assert best is not None
    return best[1], best[2]


def terms() -> tuple[str, ...]:
    """Return the friction that the robot has."""
    return "coulomb", "viscous", "rotor_inertia"


@numba.njit(cache=True)  # type: ignore[misc]
def stick(velocity: Array, inverse: Array, most: Array, sweeps: int) -> Array:
    """Return velocities (n,) after friction impulses of at most `most` (n,), N·m·s.

    An impulse opposes the velocity that is left, or holds the joint: projected Gauss-Seidel.
    """
    v = velocity.copy()
    impulse = np.zeros_like(v)
    for _ in range(sweeps):
        change = 0.0
        for j in range(len(v)):
            wanted = impulse[j] - v[j] / inverse[j, j]
            new = min(max(wanted, -most[j]), most[j])
            step = new - impulse[j]
            impulse[j] = new
            v += inverse[:, j] * step
            change = max(change, abs(step) / most[j])
        if change < 1e-12:
            break
    return v


def simulate(plant: Plant, noise: str, seed: int) -> sdpid.Recording:
    """Return the log of a run."""
    import pinocchio as pin

    rng = np.random.default_rng(seed)
    wanted, speed = excitation(plant, rng)
    encoder, sensor = np.radians(NOISE[noise][0]), NOISE[noise][1]
    model = plant.robot.pin_model.copy()
    model.armature = plant.rotor
    data = model.createData()
    step = 1.0 / (plant.rate_hz * SUBSTEPS)
    q, v = wanted[0].copy(), np.zeros(plant.robot.n)
    seen, seen_speed = q.copy(), np.zeros_like(v)
    positions, efforts = np.empty_like(wanted), np.empty_like(wanted)
    errors = encoder * rng.standard_normal(wanted.shape)
    for k in range(len(wanted)):
        now = q + errors[k]
        if k:
            seen_speed = (now - seen) * plant.rate_hz
        seen = now
        effort = plant.stiffness * (wanted[k] - seen) + plant.damping * (speed[k] - seen_speed)
        positions[k], efforts[k] = seen, effort
        for _ in range(SUBSTEPS):
            free = v + step * pin.aba(model, data, q, v, effort - plant.viscous * v)
            inverse = pin.computeMinverse(model, data, q)
            v = stick(free, inverse, step * plant.coulomb, SWEEPS)
            q = q + step * v
    every = round(plant.rate_hz / plant.sample_hz)
    kept = slice(CUT * every, -CUT * every, every)
    measured = efforts[kept] + sensor * rng.standard_normal(efforts[kept].shape)
    time = np.arange(len(measured)) / plant.sample_hz
    names = plant.robot.joint_names
    return sdpid.Recording(time=time, position=positions[kept], effort=measured, joint_names=names)


def run(path: Path, noise: str, seed: int, known: bool) -> tuple[object, ...]:
    """Return the errors of a run in %: of all base parameters together, and the median of each."""
    plant = Plant.read(path)
    log = simulate(plant, noise, seed)
    robot = plant.described(np.random.default_rng([seed, 1]), known)
    result = sdpid.identify(robot, log, friction=terms(), intervals=False)
    inertias = plant.robot.prior.ravel()
    theta = np.concatenate([inertias, plant.coulomb, plant.viscous, plant.rotor])
    truth = result.problem.base_of(theta)
    missed = result.estimate.base - truth
    clear = np.abs(truth) > 1e-9
    whole = float(np.linalg.norm(missed) / np.linalg.norm(truth))
    each = float(np.median(np.abs(missed[clear] / truth[clear])))
    plain = float(np.linalg.norm(result.wls.base - truth) / np.linalg.norm(truth))
    note = next((note for note in result.problem.samples.notes if "cutoff" in note), "")
    return noise, seed, 100.0 * whole, 100.0 * each, 100.0 * plain, note


HEADER = ("noise", "seed", "error", "median_of_each", "unconstrained", "cutoff")


def summary(done: Sequence[tuple[object, ...]]) -> str:
    """Return one line a level of noise."""
    lines = [
        "| noise | runs | error of base parameters, % | median of each, % | unconstrained, % |"
    ]
    lines.append("|---|---|---|---|---|")
    for noise in dict.fromkeys(row[0] for row in done):
        own = np.array([row[2:5] for row in done if row[0] == noise], dtype=float)
        middle = " | ".join(f"{value:.3g}" for value in np.median(own, axis=0))
        lines.append(f"| {noise} | {len(own)} | {middle} |")
    return "\n".join(lines) + "\n"


def main() -> int:
    """Run every seed and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--parameters", type=Path, default=os.environ.get("SDPID_BIRDY"))
    parser.add_argument(
        "--noise", action="append", choices=tuple(NOISE), help="default lowPosition"
    )
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--no-prior", action="store_true", help="a description without inertias")
    parser.add_argument("--quick", action="store_true", help="one run")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    text = "Nothing to show: no file of parameters; name one by --parameters or SDPID_BIRDY.\n"
    if options.parameters is not None and Path(options.parameters).is_file():
        from joblib import delayed

        seeds = range(1 if options.quick else options.seeds)
        levels = options.noise or ["lowPosition"]
        path = Path(options.parameters).resolve()
        tasks = [
            delayed(run)(path, noise, seed, not options.no_prior)
            for noise in levels
            for seed in seeds
        ]
        done = parallel(options.jobs)(tasks)
        Table(HEADER, tuple(done)).write(options.out / "birdy_tx40.csv")
        text = summary(done)
    atomic_write_text(options.out / "birdy_tx40.md", text)
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
