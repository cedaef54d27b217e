"""Rows of samples in contact beside MuJoCo's own contact forces, without noise.

States, accelerations, torques and contact forces are the simulator's, parameters are known: what
is left of the equations of motion is the error of the rows. Feet are balls on soft ground, into
which they sink; the ground may resist turning and rolling, too.

* ``legged_rows.csv``: what is left, as a share of the whitened rows.

    python examples/evidence/legged_rows.py --out results
"""

from __future__ import annotations

from functools import partial
from typing import Any

import mujoco
import numpy as np
from study import Rows, Study

import sdpid
from sdpid._common.arrays import Array
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.whitening import weights_and_shares
from sdpid.experiment.plant.legged.model import LeggedModel, MotorGears, build_legged
from sdpid.experiment.plant.legged.simulate import simulate_legged
from sdpid.experiment.plant.legged.truth import TrueMotion
from sdpid.experiment.processing.contact_samples import ContactSamples, Kind
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.legs import Legs, find_legs
from sdpid.robot.model.base_parameters import structural_base

ROBOTS = ("solo12", "go1", "a1")
MOTIONS = ("stand", "trot")
# Every so many samples.
STRIDE = 20
# Friction against turning about the normal and against rolling, in m: MuJoCo's defaults.
SPIN, ROLL = 0.005, 0.0001


class Beside:
    """Samples of a robot as MuJoCo has them, with the forces at its feet."""

    def __init__(self, name: str, motion: str, seconds: float, *, turning: bool) -> None:
        self.robot = sdpid.load_robot(name, root="free_flyer")
        self.legs: Legs = find_legs(self.robot)
        run = simulate_legged(self.robot, motion, duration=seconds, seed=1)
        self.theta = run.theta[: 10 * self.robot.n_links]
        built = build_legged(
            self.legs,
            MotorGears.of(self.robot),
            run.theta,
            held=False,
            timestep=1e-3,
            start=np.zeros(6),
        )
        if turning:
            # Torques about all three axes as well.
            built.model.geom_condim[:] = 6
            built.model.geom_friction[:, 1:] = SPIN, ROLL
        self._rotor = run.theta[10 * self.robot.n_links + 24 :]
        self._evaluate(built, run.motion)

    def _evaluate(self, built: LeggedModel, motion: TrueMotion) -> None:
        """Ask MuJoCo for accelerations and contact forces in states of a motion."""
        picked = slice(None, None, STRIDE)
        q, v = motion.position[picked], motion.velocity[picked]
        torque = motion.effort[picked, 6:] - motion.friction[picked]
        data, K, c = mujoco.MjData(built.model), len(q), len(built.feet)
        self.wrench, self.point = np.zeros((K, c, 6)), np.zeros((K, c, 3))
        self.down = np.zeros((K, c), dtype=bool)
        acceleration = np.zeros_like(v)
        for k in range(K):
            data.qpos[:3], data.qpos[3:7] = q[k, :3], np.roll(q[k, 3:7], 1)
            data.qpos[built.qpos], data.qvel[built.dof] = q[k, 7:], v[k, 6:]
            R = np.zeros(9)
            mujoco.mju_quat2Mat(R, data.qpos[3:7])
            turn = R.reshape(3, 3)
            data.qvel[:3], data.qvel[3:6] = turn @ v[k, :3], v[k, 3:6]
            data.qfrc_applied[built.dof] = torque[k]
            mujoco.mj_forward(built.model, data)
            # Of the components in the base's axes, as Pinocchio has them.
            acceleration[k, :3] = turn.T @ data.qacc[:3] - np.cross(v[k, 3:6], v[k, :3])
            acceleration[k, 3:6], acceleration[k, 6:] = data.qacc[3:6], data.qacc[built.dof]
            self._feel(built, data, k)
        effort = np.zeros_like(v)
        effort[:, 6:] = torque - self._rotor * acceleration[:, 6:]
        self.states = {"position": q, "velocity": v, "acceleration": acceleration, "effort": effort}

    def _feel(self, built: LeggedModel, data: Any, k: int) -> None:
        """Note forces and torques about the foot's origin, and where the ground is touched."""
        own = np.zeros(6)
        for number in range(data.ncon):
            contact = data.contact[number]
            foot = built.feet.index(int(contact.geom[1]))
            mujoco.mj_contactForce(built.model, data, number, own)
            axes = contact.frame.reshape(3, 3).T
            force, arm = axes @ own[:3], contact.pos - data.geom_xpos[built.feet[foot]]
            self.wrench[k, foot, :3] = force
            self.wrench[k, foot, 3:] = axes @ own[3:] + np.cross(arm, force)
            self.point[k, foot], self.down[k, foot] = arm, True

    def left(self, kind: Kind, *, known: bool = False, offset: Any = (0, 0, 0)) -> float | None:
        """Return what is left of the whitened rows, relative to them; None where there are none.

        Parameters
        ----------
        kind : str
            What contacts are said to transmit.
        known : bool
            Whether their forces are inputs; else they are eliminated.
        offset : (3,) array_like or "touched"
            Contact points; those of the simulator, sample by sample.
        """
        K = len(self.down)
        parts = [slice(k, k + 1) for k in range(K)] if isinstance(offset, str) else [slice(0, K)]
        friction = FrictionModel.from_terms((), self.robot.joint_names, first=6)
        base = structural_base(self.robot, friction)
        error = size = count = 0.0
        for part in parts:
            at: Array = self.point[part][0] if isinstance(offset, str) else np.array(offset)
            contacts = ContactSamples(
                frames=self.legs.frames,
                kind=kind,
                offset=at,
                down=self.down[part],
                forces=self.wrench[part] if known else None,
                force_covariance=np.zeros((6, 6)) if known else None,
            )
            states = {name: values[part] for name, values in self.states.items()}
            samples = sdpid.Samples(**states, contacts=contacts)
            rows = RowSource(self.robot, friction, base, samples)
            T, index, shares = weights_and_shares(rows, slice(None), np.eye(self.robot.n))
            needed = rows.regressor(slice(None)) @ (base.matrix @ self.theta)
            residual = rows.effort(slice(None)) - needed
            error += float(np.sum((T[index] @ residual[:, :, None]) ** 2))
            size += float(np.sum((T[index] @ needed[:, :, None]) ** 2))
            count += float(np.sum(shares))
        return float(np.sqrt(error / size)) if count > 0.5 else None


def rows_of(seconds: float, name: str, motion: str, ground: str) -> Rows:
    """Yield the line of a robot in a motion on a ground."""
    made = Beside(name, motion, seconds, turning=ground == GROUNDS[1])
    yield (
        len(made.down),
        made.left("plane", known=True),
        made.left("plane"),
        made.left("point", offset="touched"),
        made.left("point", offset=(0.0, 0.0, -made.legs.radius)),
    )


GROUNDS = ("forces alone", "turning and rolling resisted")
COLUMNS = (
    *("robot", "motion", "ground", "samples", "known", "plane", "point"),
    "point_a_radius_below",
)


def main() -> None:
    """Measure and write the table."""
    quick = {"robots": ["solo12"], "seconds": 0.4}
    study = Study(__doc__, quick=quick, robots=[*ROBOTS], seconds=2.0)
    axes = study.robots, MOTIONS, GROUNDS
    study.rows("legged_rows.csv", COLUMNS, partial(rows_of, study.seconds), *axes)


if __name__ == "__main__":
    main()
