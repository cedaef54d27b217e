"""Are stiffness of gears and delays of encoders within their intervals? Arms of known truth.

A three-joint arm with random links stands in MuJoCo: a motor with its rotor, a spring to the link
in two of the gears, none in the third. A controller moves the motors; encoders of motors and links
are noisy, and those of links late. The arm is identified from the motors' encoders, with a
description 15 % off, and its gears from both.

    python examples/evidence/elastic_arms.py --out results --seeds 40
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from scipy.stats import binom
from study import Rows, Study, known

import sdpid
from sdpid._common.arrays import Array

RATE, STEPS, SECONDS = 250.0, 16, 20.0
# Steps of the simulation by which links are read late: 3 ms.
LATE = 12
DELAY = LATE / (STEPS * RATE)
# Noise of encoders, rad, and of efforts as a share of their rms.
NOISE, EFFORT_NOISE = 3e-5, 5e-3
# Dry friction as steep as MuJoCo has it.
STEEP = 'solreffriction="0.002 1" solimpfriction="0.999 0.999 0.001"'
ROTORS = (4.0, 5.0, 1.5)
# Of the springs' natural damping.
DAMPING = 0.01
# Powers of ten between which the stiffness lies, N·m/rad.
STIFFNESS = (5.0, 5.6)
AXES = ("0 0 1", "0 1 0", "0 1 0")


def description(links: list[dict[str, Any]], stiffness: Array | None) -> str:
    """Return the arm's MJCF, with motors before the links where there is a stiffness."""
    text, end = "", ""
    for k, (link, axis) in enumerate(zip(links, AXES, strict=True)):
        place = f'pos="0 0 {0.0 if k == 0 else 0.4}"'
        inertial = (
            f'<inertial pos="{link["com"]}" mass="{link["mass"]}" diaginertia="{link["inertia"]}"/>'
        )
        if stiffness is None:
            text += f'<body name="link{k}" {place}><joint name="joint{k}" axis="{axis}"/>{inertial}'
            end += "</body>"
            continue
        text += (
            f'<body name="motor{k}" {place}><joint name="joint{k}" axis="{axis}" damping="6" '
            f'frictionloss="4" armature="{ROTORS[k]}" {STEEP}/>'
            '<inertial pos="0 0 0" mass="1e-9" diaginertia="1e-9 1e-9 1e-9"/>'
        )
        spring = ""
        if np.isfinite(stiffness[k]):
            damping = 2.0 * DAMPING * np.sqrt(stiffness[k] * ROTORS[k])
            spring = (
                f'<joint name="gear{k}" axis="{axis}" stiffness="{stiffness[k]}" '
                f'damping="{damping}"/>'
            )
        text += f'<body name="link{k}">{spring}{inertial}'
        end += "</body></body>"
    drives = "" if stiffness is None else "".join(f'<motor joint="joint{k}"/>' for k in range(3))
    step = 1.0 / (RATE * STEPS)
    return (
        f'<mujoco><compiler angle="radian"/><option timestep="{step}" integrator="implicitfast"/>'
        f"<worldbody>{text}{end}</worldbody><actuator>{drives}</actuator></mujoco>"
    )


def drawn(rng: np.random.Generator) -> list[dict[str, Any]]:
    """Return random links."""
    found = []
    for mass in rng.uniform(0.8, 1.2, 3) * (15.0, 12.0, 8.0):
        com = rng.uniform([-0.03, -0.03, 0.15], [0.03, 0.03, 0.25])
        inertia = mass * rng.uniform(0.015, 0.025, 3)
        found.append(
            {
                "mass": mass,
                "com": " ".join(map(str, com)),
                "inertia": " ".join(map(str, inertia)),
            }
        )
    return found


def simulated(links: list[dict[str, Any]], stiffness: Array, seed: int) -> sdpid.Recording:
    """Return what is recorded of the arm while a controller moves its motors."""
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(description(links, stiffness))
    data = mujoco.MjData(model)
    motors = [model.joint(f"joint{k}").qposadr[0] for k in range(3)]
    gears = [
        model.joint(f"gear{k}").qposadr[0] if np.isfinite(stiffness[k]) else None for k in range(3)
    ]
    rates = rng.uniform(0.5, 5.0, (3, 5))
    phases, sizes = (
        rng.uniform(0.0, 2.0 * np.pi, (3, 5)),
        rng.uniform(0.2, 0.6, (3, 5)) / rates**0.5,
    )
    count = int(SECONDS * RATE) * STEPS
    motor, link, effort = np.empty((3, count, 3))
    speeds = [model.joint(f"joint{k}").dofadr[0] for k in range(3)]
    gains = np.array([8.0, 8.0, 3.0])
    for i in range(count):
        time = i / (RATE * STEPS)
        angle = rates * time + phases
        # From rest within a second.
        begin = min(time, 1.0) ** 2 * (3.0 - 2.0 * min(time, 1.0))
        wanted = begin * np.sum(sizes * np.sin(angle), axis=1)
        rate = begin * np.sum(sizes * rates * np.cos(angle), axis=1)
        missed, slow = wanted - data.qpos[motors], rate - data.qvel[speeds]
        data.ctrl[:] = gains * (900.0 * missed + 60.0 * slow)
        motor[i], effort[i] = data.qpos[motors], data.ctrl
        link[i] = [
            data.qpos[m] + (0.0 if g is None else data.qpos[g])
            for m, g in zip(motors, gears, strict=True)
        ]
        mujoco.mj_step(model, data)
    # From the second on in which the motion has its size.
    rows = np.arange(int(RATE) * STEPS, count, STEPS)
    noise = NOISE * rng.standard_normal((2, len(rows), 3))
    size = effort[rows].std(axis=0)
    return sdpid.Recording(
        time=np.arange(len(rows)) / RATE,
        position=motor[rows] + noise[0],
        link_position=link[rows - LATE] + noise[1] + rng.normal(0.0, 1e-3, 3),
        effort=effort[rows] + EFFORT_NOISE * size * rng.standard_normal((len(rows), 3)),
        joint_names=[f"joint{k}" for k in range(3)],
    )


def run(study: Study, seed: int) -> Rows:
    """Simulate an arm, identify it, and compare."""
    rng = np.random.default_rng([seed, 1])
    links = drawn(rng)
    stiffness = np.array([np.inf, *10.0 ** rng.uniform(*STIFFNESS, 2)])
    log = simulated(links, stiffness, seed)
    rough = [each | {"mass": each["mass"] * rng.uniform(0.85, 1.15)} for each in links]
    robot = sdpid.load_robot(description(rough, None))
    found = sdpid.identify(robot, log, intervals=False, rotor_inertia=ROTORS).elasticity
    assert found is not None
    reach = 2.093 * found.delay_error_s[0]
    delay = found.delay_s[0]
    yield "delay, s", DELAY, delay, delay - reach, delay + reach
    for k in (1, 2):
        yield f"stiffness of joint {k + 1}", stiffness[k], found.stiffness[k], *found.interval[k]
    # An infinite stiffness, told as none.
    yield "stiffness of joint 1", None, found.stiffness[0], *found.interval[0]


def summary(own: dict[str, Any]) -> float:
    """Return the share of intervals that hold the truth, %: of no stiffness, those not given."""
    none = np.isnan(own["truth"].astype(float))
    low, high = own["lower"].astype(float), own["upper"].astype(float)
    inside = np.where(none, np.isnan(low), (low <= own["truth"]) & (own["truth"] <= high))
    return float(100.0 * np.mean(inside))


def by_chance(own: dict[str, Any]) -> str:
    """Return the range of shares, %, in which exact 95 % intervals end in 95 % of such studies."""
    # An interval can miss a compliance of zero at its lower end only.
    count, one_end = len(own["seed"]), np.isnan(own["truth"].astype(float)).all()
    low, high = 100.0 * binom.ppf([0.025, 0.975], count, 0.975 if one_end else 0.95) / count
    return f"{low:.1f} to {high:.1f}"


def error(own: dict[str, Any]) -> float | None:
    """Return the median error, %."""
    found = known(100.0 * np.abs(own["estimate"] / own["truth"] - 1.0))
    return float(np.median(found)) if len(found) else None


def width(own: dict[str, Any]) -> float | None:
    """Return the median half width of intervals, % of the truth."""
    found = known(50.0 * (own["upper"] - own["lower"]) / own["truth"])
    return float(np.median(found)) if len(found) else None


def main() -> None:
    """Run the study."""
    study = Study(__doc__, quick={"seeds": 2}, seeds=(40, "arms"))
    columns = ("seed", "quantity", "truth", "estimate", "lower", "upper")
    rows = study.rows(
        "elastic_arms_each.csv", columns, lambda seed: run(study, seed), range(study.seeds)
    )
    for each in rows:
        each["of"] = each["quantity"].split(" of ")[0].split(",")[0]
        each["of"] += " of a rigid gear" if each["truth"] is None else ""
    ways = {
        "intervals": "count seed",
        "held_percent": summary,
        "right intervals by chance, %": by_chance,
        "median error, %": error,
        "median half width, %": width,
    }
    study.summary("elastic_arms.csv", rows, ("of",), ways)


if __name__ == "__main__":
    main()
