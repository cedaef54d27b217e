"""Whether intervals hold the truth of springs, a differential wrist and a four-bar ankle.

MuJoCo simulates each under a controller, with dry and viscous friction and noisy encoders and
efforts; `identify` has a description whose masses are 15 % off, and finds links, friction and
springs. Counted are intervals of base parameters that are from the data, and those of directions of
base parameters that the data tell apart: one crank's motion shows no parameter of the ankle alone.

    python examples/evidence/mechanisms.py --out results --seeds 10
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from elastic_arms import AXES, drawn, summary
from study import Rows, Study

import sdpid
from sdpid import friction as terms
from sdpid._common.arrays import Array
from sdpid.assurance.intervals.delta_method import half_widths
from sdpid.assurance.intervals.parameters import FROM_DATA
from sdpid.estimation.posterior import Posterior

RATE, STEPS, SECONDS = 250.0, 16, 30.0
# Noise of encoders, rad, of 19 bits and of 17, and of efforts as a share of their rms.
NOISES, EFFORT_NOISE = (1e-5, 3e-5), 5e-3
DRY, VISCOUS = 0.5, 0.8
# MuJoCo's dry friction sets in over a time, of which two steps are the least that it takes.
SHARP = f'solreffriction="{2.0 / (RATE * STEPS)} 1" solimpfriction="0.9999 0.9999 0.001"'
DRAG = f'damping="{VISCOUS}" frictionloss="{DRY}" {SHARP}'
# A loop that hardly opens; its joints without motors have no friction.
PIN = '<connect body1="rod" body2="foot" anchor="0.05 0 -0.28" solref="0.002 1"/>'
WRIST = [[0.5, 0.5], [0.5, -0.5]]


@dataclass(frozen=True)
class Mechanism:
    """What is simulated and identified.

    Attributes
    ----------
    text : str
        MJCF with `{}` for inertias of three links.
    motors : ndarray, shape (n, joints)
        Positions of motors by those of joints.
    size : float
        Of the motion, rad.
    options, friction : dict, tuple
        How the robot is loaded, and its terms.
    truth : dict
        Values of parameters of terms.
    """

    text: str
    motors: Array
    size: float
    options: dict[str, Any]
    friction: tuple[Any, ...]
    truth: dict[str, float]


def mechanisms(rng: np.random.Generator) -> dict[str, Mechanism]:
    """Return the three, with random springs."""
    stiffness, rest = rng.uniform(20.0, 60.0, 3), rng.uniform(-0.5, 0.5, 3)
    springs = [*zip(stiffness, rest, strict=True)]
    drag = {f"F{kind}{j}": value for j in (1, 2, 3) for kind, value in (("v", VISCOUS), ("s", DRY))}
    return {
        "springs": Mechanism(
            arm([f'{DRAG} stiffness="{k}" springref="{r}"' for k, r in springs]),
            *(np.eye(3), 0.5, {}),
            ("coulomb", "viscous", *(terms.Spring(f"joint{k}") for k in range(3))),
            drag
            | {f"K{j}": k for j, (k, _) in enumerate(springs, start=1)}
            | {f"Kr{j}": k * r for j, (k, r) in enumerate(springs, start=1)},
        ),
        "wrist": Mechanism(
            arm([DRAG, "", ""], tendons=True),
            *(np.array([[1.0, 0, 0], [0, 1, 1], [0, 1, -1]]), 0.5),
            {
                "transmission": sdpid.Transmission(
                    WRIST, joints=("joint1", "joint2"), names=("left", "right")
                )
            },
            ("coulomb", "viscous"),
            drag,
        ),
        "ankle": Mechanism(
            ANKLE,
            *(np.array([[0.0, 1.0, 0.0]]), 0.15, {}),
            ("coulomb", "viscous"),
            {"Fv2": VISCOUS, "Fs2": DRY},
        ),
    }


def arm(joints: list[str], *, tendons: bool = False) -> str:
    """Return an arm of three links, its last two behind two tendons or on motors of their own."""
    bodies = "".join(
        f'<body name="link{k}" pos="0 0 {0.4 * (k > 0)}">'
        f'<joint name="joint{k}" axis="{axis}" {own}/>{{}}'
        for k, (axis, own) in enumerate(zip(AXES, joints, strict=True))
    )
    lines = "".join(
        f'<fixed name="{name}" {DRAG}><joint joint="joint1" coef="1"/>'
        f'<joint joint="joint2" coef="{sign}"/></fixed>'
        for name, sign in (("left", 1), ("right", -1))
    )
    return f"<worldbody>{bodies}{'</body>' * 3}</worldbody>" + (
        f"<tendon>{lines}</tendon>" if tendons else ""
    )


# Foot, crank and rod in a plane; the rod's end is pinned to the foot.
ANKLE = (
    f'<worldbody><body name="foot"><joint name="ankle" axis="0 1 0"/>{{}}</body>'
    f'<body name="crank" pos="0 0 0.3"><joint name="crank" axis="0 1 0" {DRAG}/>{{}}'
    f'<body name="rod" pos="0.1 0 0"><joint name="knee" axis="0 1 0"/>{{}}</body></body>'
    f'</worldbody><equality>{PIN}</equality><actuator><motor joint="crank"/></actuator>'
)


def described(mechanism: Mechanism, links: list[dict[str, Any]]) -> str:
    """Return the MJCF with inertias."""
    inertias = [
        f'<inertial pos="{link["com"]}" mass="{link["mass"]}" diaginertia="{link["inertia"]}"/>'
        for link in links
    ]
    return (
        '<mujoco><compiler angle="radian"/><option integrator="RK4" '
        f'timestep="{1.0 / (RATE * STEPS)}"/>{mechanism.text.format(*inertias)}</mujoco>'
    )


def simulated(
    mechanism: Mechanism, text: str, names: tuple[str, ...], noise: float, seed: int
) -> sdpid.Recording:
    """Return what is recorded while a controller moves the motors."""
    rng = np.random.default_rng([seed, 2])
    model = mujoco.MjModel.from_xml_string(text)
    data, n = mujoco.MjData(model), len(mechanism.motors)
    rates, phases = rng.uniform(0.5, 5.0, (n, 5)), rng.uniform(0.0, 2.0 * np.pi, (n, 5))
    sizes = mechanism.size * rng.uniform(0.4, 1.0, (n, 5)) / rates**0.5
    count = int(SECONDS * RATE) * STEPS
    motor, effort = np.empty((2, count, n))
    for i in range(count):
        time = i / (RATE * STEPS)
        begin = min(time, 1.0) ** 2 * (3.0 - 2.0 * min(time, 1.0))
        wanted = begin * np.sum(sizes * np.sin(rates * time + phases), axis=1)
        motor[i] = mechanism.motors @ data.qpos
        effort[i] = 2000.0 * (wanted - motor[i]) - 60.0 * (mechanism.motors @ data.qvel)
        data.qfrc_applied[:] = mechanism.motors.T @ effort[i]
        mujoco.mj_step(model, data)
    rows = np.arange(int(RATE) * STEPS, count, STEPS)
    # A step's effort acts after it was computed.
    effort[1:] = 0.5 * (effort[1:] + effort[:-1])
    size = effort[rows].std(axis=0)
    return sdpid.Recording(
        time=np.arange(len(rows)) / RATE,
        position=motor[rows] + noise * rng.standard_normal((len(rows), n)),
        effort=effort[rows] + EFFORT_NOISE * size * rng.standard_normal((len(rows), n)),
        joint_names=names,
    )


def run(kind: str, noise: float, seed: int) -> Rows:
    """Simulate a mechanism, identify it, and compare its base parameters."""
    rng = np.random.default_rng([seed, 1])
    mechanism, links = mechanisms(rng)[kind], drawn(rng)
    text = described(mechanism, links)
    rough = [each | {"mass": each["mass"] * rng.uniform(0.85, 1.15)} for each in links]
    robot, true = (
        sdpid.load_robot(each, **mechanism.options) for each in (described(mechanism, rough), text)
    )
    names = ("crank",) if kind == "ankle" else robot.joint_names
    log = simulated(mechanism, text, names, noise, seed)
    found = sdpid.identify(robot, log, friction=mechanism.friction, effects="none")
    base, bodies = found.problem.base, true.prior.ravel()
    own = [mechanism.truth.get(name, 0.0) for name in base.theta_names[len(bodies) :]]
    values = base.matrix @ [*bodies, *own]
    truth, ends = dict(zip(base.names, values, strict=True)), found.intervals
    for name, low, high, label in zip(ends.names, ends.lower, ends.upper, ends.label, strict=True):
        # What is not negative and zero is held by its limit.
        if truth.get(name) and label == FROM_DATA:
            yield "parameters", name, truth[name], low, high
    # The directions that the data see best come first.
    ways, estimate = np.linalg.svd(found.problem.A)[2], found.estimate
    half, of_prior = half_widths(Posterior.of(estimate), ways @ base.matrix, ends.level)
    for k in np.flatnonzero(of_prior < 0.5).tolist():
        value = ways[k] @ estimate.base
        yield "directions", k + 1, ways[k] @ values, value - half[k], value + half[k]


def main() -> None:
    """Run the study."""
    study = Study(__doc__, quick={"seeds": 1}, seeds=(10, "of each mechanism"))
    columns = ("mechanism", "noise, rad", "seed", "of", "name", "truth", "lower", "upper")
    kinds = ("springs", "wrist", "ankle")
    rows = study.rows("mechanisms_each.csv", columns, run, kinds, NOISES, range(study.seeds))
    ways = {"intervals": "count seed", "held_percent": summary}
    study.summary("mechanisms.csv", rows, ("mechanism", "noise, rad", "of"), ways)


if __name__ == "__main__":
    main()
