"""Drives of a Go2 that hangs, from commands and positions alone: sdpid beside other ways.

Every way sees the first 70 % of the log, its description and the law that ran. MuJoCo then plays
what each found over the rest, which is faster, from one measured state. Times are of one processor.
"""

from __future__ import annotations

import tempfile
import time as clock
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from law_go2 import KD, KP
from mujoco import rollout, sysid
from study import Rows, Study

import sdpid

# MuJoCo's usual step, s.
STEP = 0.002
TRAINED = 0.7
KINDS = ("armature", "damping", "frictionloss")
# Bounds of a search for numbers of every kind, and of the delay, s.
UPPER = {"armature": 0.1, "damping": 2.0, "frictionloss": 2.0}
LONGEST = 0.02
COLUMNS = (
    *("way", "numbers", "trained_mrad", "held_out_mrad", "seconds", "rollouts"),
    *("delay_ms", "lower_ms", "upper_ms"),
)
# Parameters of a link.
LINK = 10
# What a way finds: a model, its delay and the interval of it (s), numbers, seconds, rollouts.
Found = tuple[mujoco.MjModel, float, tuple[float, float] | None, int, float, int]
Way = Callable[[Path, Path], Found]


def spec_of(robot: Path) -> mujoco.MjSpec:
    """Return a robot with the law as actuators, which take commanded positions, and sensors."""
    spec = mujoco.MjSpec.from_file(str(robot))
    spec.option.timestep = STEP
    # In the air; the described shapes touch each other.
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    for each in [*spec.actuators, *spec.sensors]:
        spec.delete(each)
    for joint in spec.joints:
        made = spec.add_actuator(name=joint.name, target=joint.name)
        made.trntype = mujoco.mjtTrn.mjTRN_JOINT
        made.set_to_position(kp=KP, kv=KD)
        spec.add_sensor(
            name=f"{joint.name}_pos",
            type=mujoco.mjtSensor.mjSENS_JOINTPOS,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=joint.name,
        )
    return spec


class Log:
    """A part of the log, and how MuJoCo plays it."""

    def __init__(self, path: Path, *, held_out: bool) -> None:
        with np.load(path) as arrays:
            time, position, self.command = arrays["t"], arrays["q"], arrays["commanded"]
        first = int(TRAINED * len(time))
        rows = slice(first, None) if held_out else slice(first)
        self.last = first
        self.all_times, self.time, self.position = time, time[rows], position[rows]
        around = position[max(rows.start or 0, 2) - 2 :][:5]
        self.velocity = (around[-1] - around[0]) / (time[4] - time[0]) if held_out else 0.0
        self.grid = self.time[0] + STEP * np.arange(int(np.ptp(self.time) / STEP) + 2)

    def control(self, delay: float) -> np.ndarray:
        """Return the mean of the commands, which are held, about the start of every step."""
        ends = np.append(self.all_times, self.all_times[-1] + 1.0)
        area = np.zeros((len(ends), self.command.shape[1]))
        area[1:] = np.cumsum(np.diff(ends)[:, None] * self.command, axis=0)
        when = np.append(self.grid, self.grid[-1] + STEP) - 0.5 * STEP - delay
        early = np.minimum(when - ends[0], 0.0)
        at = [
            np.interp(when, ends, x) + early * c
            for x, c in zip(area.T, self.command[0], strict=True)
        ]
        return np.asarray(np.diff(np.array(at).T, axis=0) / STEP)

    def start(self, model: mujoco.MjModel) -> np.ndarray:
        """Return the state at the first row."""
        data, kind = mujoco.MjData(model), mujoco.mjtState.mjSTATE_FULLPHYSICS
        data.qpos[:], data.qvel[:] = self.position[0], self.velocity
        state = np.empty(mujoco.mj_stateSize(model, kind))
        mujoco.mj_getState(model, data, state, kind)
        return state

    def played(self, states: np.ndarray, delay: float = 0.0) -> np.ndarray:
        """Return positions at the rows of the log, of the states after every step."""
        q = np.vstack([self.position[0], states[:, 1 : 1 + self.position.shape[1]]])
        grid = self.time[0] + STEP * np.arange(len(q))
        return np.stack([np.interp(self.time - delay, grid, x) for x in q.T], axis=1)

    def errors(self, model: mujoco.MjModel, delay: float) -> np.ndarray:
        """Return errors of positions, rad."""
        data = mujoco.MjData(model)
        states, _ = rollout.rollout(model, data, self.start(model), self.control(delay))
        return self.played(states[0]) - self.position

    def mrad(self, model: mujoco.MjModel, delay: float) -> float:
        """Return the rms error of positions, mrad."""
        return 1e3 * float(np.sqrt(np.mean(self.errors(model, delay) ** 2)))


def as_described(robot: Path, log: Path) -> Found:
    """Take the file as it is shipped."""
    return spec_of(robot).compile(), 0.0, None, 0, 0.0, 0


@cache
def identification(robot: Path, log: Path) -> tuple[Any, float]:
    """Return what this package identifies, and the seconds that it took."""
    law, last = sdpid.controllers.PD(kp=KP, kd=KD), Log(log, held_out=False).last
    begin = clock.process_time()
    result = sdpid.identify(robot, sdpid.read_recording(log, rows=[1, last]), law=law)
    return result, clock.process_time() - begin


def identified(*, tendons: bool) -> Way:
    """Return what identifies with this package."""

    def way(robot: Path, log: Path) -> Found:
        result, seconds = identification(robot, log)
        with tempfile.TemporaryDirectory() as folder:
            result.save(Path(folder) / "o", tendons=tendons)
            model = spec_of(Path(folder) / "o" / "identified.xml").compile()
        drives = result.drives
        numbers = LINK * (model.nbody - 1) + (len(drives.names) if tendons else 3 * model.nv + 1)
        return model, drives.delay, drives.delay_interval, numbers, seconds, 0

    return way


def searched(population: int, rounds: int) -> Way:
    """Return a search by CMA-ES over one armature, damping and dry friction a joint and a delay.

    As PACE does it: from the middle of the bounds with deviations of a quarter of their range,
    until the scores of a population differ by less than a percent; the mean counts.
    """

    def way(robot: Path, log: Path) -> Found:
        begin, train, model = (
            clock.process_time(),
            Log(log, held_out=False),
            spec_of(robot).compile(),
        )
        upper = np.append(np.repeat([UPPER[kind] for kind in KINDS], model.nv), LONGEST)

        def put(x: np.ndarray) -> float:
            """Give the model these numbers of 0 to 1, and return the delay."""
            values = upper * np.clip(x, 0.0, 1.0)
            for kind, own in zip(KINDS, np.split(values[:-1], 3), strict=True):
                getattr(model, f"dof_{kind}")[:] = own
            mujoco.mj_setConst(model, mujoco.MjData(model))
            return float(values[-1])

        def score(x: np.ndarray) -> float:
            outside = float(np.sum((x - np.clip(x, 0.0, 1.0)) ** 2))
            return float(np.mean(train.errors(model, put(x)) ** 2)) * (1.0 + outside)

        mean, used = cma_es(score, np.full(len(upper), 0.5), 0.25, population, rounds)
        delay = put(mean)
        return model, delay, None, len(upper), clock.process_time() - begin, used

    return way


def cma_es(
    score: Callable[[np.ndarray], float],
    mean: np.ndarray,
    sigma: float,
    population: int,
    rounds: int,
) -> tuple[np.ndarray, int]:
    """Return the mean that an evolution strategy finds, and how many scores it took.

    The (mu/mu_w, lambda)-CMA-ES with the constants of [hansen2016].
    """
    rng, n = np.random.default_rng(0), len(mean)
    parents = population // 2
    weights = np.log(0.5 * (population + 1)) - np.log(1.0 + np.arange(parents))
    weights /= weights.sum()
    mass = 1.0 / np.sum(weights**2)
    c_path = (4.0 + mass / n) / (n + 4.0 + 2.0 * mass / n)
    c_sigma = (mass + 2.0) / (n + mass + 5.0)
    c_one = 2.0 / ((n + 1.3) ** 2 + mass)
    c_mu = min(1.0 - c_one, 2.0 * (mass - 2.0 + 1.0 / mass) / ((n + 2.0) ** 2 + mass))
    damp = 1.0 + 2.0 * max(0.0, np.sqrt((mass - 1.0) / (n + 1.0)) - 1.0) + c_sigma
    usual = np.sqrt(n) * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n**2))
    covariance, path, path_sigma = np.eye(n), np.zeros(n), np.zeros(n)
    for k in range(1, rounds + 1):
        squares, axes = np.linalg.eigh(covariance)
        lengths = np.sqrt(np.maximum(squares, 1e-20))
        steps = rng.standard_normal((population, n)) * lengths @ axes.T
        scores = np.array([score(mean + sigma * step) for step in steps])
        steps = steps[np.argsort(scores)[:parents]]
        moved = weights @ steps
        mean = mean + sigma * moved
        path_sigma = (1.0 - c_sigma) * path_sigma + np.sqrt(
            c_sigma * (2.0 - c_sigma) * mass
        ) * axes @ ((axes.T @ moved) / lengths)
        length = float(np.linalg.norm(path_sigma))
        grown = np.sqrt(1.0 - (1.0 - c_sigma) ** (2 * k)) * (1.4 + 2.0 / (n + 1.0)) * usual
        on = float(length < grown)
        path = (1.0 - c_path) * path + on * np.sqrt(c_path * (2.0 - c_path) * mass) * moved
        lost = (1.0 - on) * c_path * (2.0 - c_path)
        covariance = (
            (1.0 + c_one * lost - c_one - c_mu) * covariance
            + c_one * np.outer(path, path)
            + c_mu * (weights * steps.T) @ steps
        )
        sigma *= float(np.exp(c_sigma / damp * (length / usual - 1.0)))
        if np.ptp(scores) < 1e-2 * scores.min():
            break
    return mean, k * population


def with_inertia(name: str) -> Callable[[Any, Any], None]:
    """Return what gives a body the inertia of log-Cholesky parameters, about its principal axes.

    The modifier of mujoco.sysid gives the full inertia, which MuJoCo 4.0.0 refuses in a body that
    has its principal axes.
    """

    def put(spec: Any, parameter: Any) -> None:
        pi, body = sysid.model_modifier.pi_from_theta(parameter.value), spec.body(name)
        com = pi[1:4] / pi[0]
        inertia = pi[4:].reshape(3, 3) - pi[0] * (com @ com * np.eye(3) - np.outer(com, com))
        values, axes = np.linalg.eigh(0.5 * (inertia + inertia.T))
        turn = np.zeros(4)
        mujoco.mju_mat2Quat(turn, (axes * np.sign(np.linalg.det(axes))).ravel())
        body.fullinertia = np.full(6, np.nan)
        body.mass, body.ipos, body.iquat, body.inertia = pi[0], com, turn, values

    return put


def with_sysid(iterations: int, *, links: bool) -> Way:
    """Return a fit by mujoco.sysid: the same numbers, and the links where asked.

    A delay of all sensors stands for one of all commands. Residuals are errors of positions in
    rad: its own weights are those of positions about zero, and calves never come near.
    """

    def way(robot: Path, log: Path) -> Found:
        begin, train, spec = clock.process_time(), Log(log, held_out=False), spec_of(robot)
        model, params, calls = spec.compile(), sysid.ParameterDict(), 0
        for kind in KINDS:
            for joint in spec.joints:
                dof = model.joint(joint.name).dofadr[0]
                value = getattr(model, f"dof_{kind}")[dof]

                def put(s: Any, p: Any, name: str = joint.name, kind: str = kind) -> None:
                    old = getattr(s.joint(name), kind)
                    new = float(p.value[0])
                    setattr(s.joint(name), kind, new if np.ndim(old) == 0 else [new, 0.0, 0.0])

                name = f"{joint.name}_{kind}"
                params.add(sysid.Parameter(name, value, 0.0, UPPER[kind], modifier=put))
        for body in spec.bodies[2:] if links else ():
            how = {"inertia_type": sysid.InertiaType.Pseudo, "modifier": with_inertia(body.name)}
            params.add(sysid.body_inertia_param(spec, model, body.name, **how))
        params.add(sysid.Parameter("delay", 0.25 * LONGEST, 0.0, LONGEST))

        def residual(params: Any, *given: Any, state: np.ndarray) -> Any:
            nonlocal calls
            calls += 1
            return train.played(state, params["delay"].value[0]) - train.position, *given[:2]

        seconds = train.grid - train.grid[0]
        data = sysid.ModelSequences(
            "go2",
            spec,
            "log",
            train.start(model),
            sysid.TimeSeries(seconds, train.control(0.0)),
            sysid.TimeSeries.from_names(train.time - train.time[0], train.position, model),
        )
        fit = sysid.build_residual_fn(
            models_sequences=[data], modify_residual=residual, n_threads=1
        )
        found, told = sysid.optimize(params, fit, verbose=False, max_iters=iterations)
        left = fit(found.as_vector(), found)[0]
        _, halves = sysid.calculate_intervals([np.ravel(x) for x in left], told.jac)
        delay, half = float(found["delay"].value[0]), float(halves[-1])
        taken = clock.process_time() - begin
        made = sysid.apply_param_modifiers(found, spec)
        return made, delay, (delay - half, delay + half), found.size, taken, calls

    return way


def main() -> None:
    """Run every way."""
    study = Study(
        __doc__,
        quick={"rounds": 2, "population": 6, "iterations": 1},
        data=True,
        population=(48, "of CMA-ES"),
        rounds=(300, "of CMA-ES, at most"),
        iterations=(200, "of mujoco.sysid, at most"),
    )
    folder = study.data / "go2_hung"
    robot, log = folder / "go2.xml", folder / "first_60_percent.npz"
    ways: dict[str, Way] = {
        "as shipped": as_described,
        "sdpid, constants": identified(tendons=False),
        "sdpid, friction over position": identified(tendons=True),
        "mujoco.sysid": with_sysid(study.iterations, links=False),
        "CMA-ES": searched(study.population, study.rounds),
        # Four times as many numbers.
        "mujoco.sysid, links too": with_sysid(-(-study.iterations // 4), links=True),
    }
    if not hasattr(sysid, "optimize"):
        print("mujoco.sysid lacks what mujoco[sysid] installs; it is left out")
        ways = {name: way for name, way in ways.items() if "sysid" not in name}

    def rows_of(way: str) -> Rows:
        model, delay, ends, numbers, seconds, used = ways[way](robot, log)
        errors = [Log(log, held_out=held).mrad(model, delay) for held in (False, True)]
        low, high = ends or (None, None)
        in_ms = [None if x is None else 1e3 * x for x in (delay, low, high)]
        yield numbers, *errors, seconds, used or None, *in_ms

    study.rows("ways.csv", COLUMNS, rows_of, ways, digits=4)


if __name__ == "__main__":
    main()
