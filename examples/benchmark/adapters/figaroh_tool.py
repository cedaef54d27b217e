"""FIGAROH for the benchmark: its `BaseIdentification`, configured as its examples are."""

# /// script
# dependencies = [
#   "figaroh==1.0.2",
#   "pin==4.1.0",
#   "numpy==2.4.6",
#   "scipy==1.17.1",
#   "picos==2.6.2",
#   "cvxopt==1.3.3",
# ]
#
# [tool.benchmark]
# name = "FIGAROH"
# wrist = true
# methods = [
#   "own rows, least squares",
#   "own rows, weighted",
#   "own rows, physical fit",
#   "least squares",
#   "weighted",
#   "physical fit",
# ]
#
# [tool.benchmark.bounds]
# "physical fit" = "SDP, free friction"
# ///

from __future__ import annotations

import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from figaroh.identification.base_identification import BaseIdentification
from figaroh.tools.regressor import build_regressor_basic
from figaroh.tools.robot import load_robot
from protocol import Answer, Method, Rows, Task, inside, main

# Its example for the TX40 (a coupled wrist) takes 100 Hz; elsewhere the cut-off of the common rows.
TX40_HZ = 100.0
# Its default, and the fewest samples a period of the cut-off that decimation leaves here.
DECIMATION, LEAST = 10, 4.0


def _settings(task: Task, own: bool, physical: bool) -> dict[str, Any]:
    """Return its settings: nominal values are zero, which only its prior and its report use."""
    zeros = [0.0] * len(task.joints)
    cutoff = TX40_HZ if task.wrist and own else task.cutoff_hz
    # Rotor inertia is part of its default model; on common rows every tool has the same terms.
    rotors = own or bool(task.wrist)
    identification: dict[str, Any] = {
        "enabled": True,
        "problem": {
            "include_external_forces": False,
            "use_joint_torques": True,
            "model_components": {
                "friction": True,
                "joint_offset": True,
                "actuator_inertia": rotors,
            },
        },
        "signal_processing": {
            "sampling_frequency": task.rate_hz,
            "cutoff_frequency": cutoff,
            "filter_type": "butterworth",
            "filter_order": 4,
            "differentiation_method": "gradient",
        },
    }
    if physical:
        identification |= {"select_stage": "physical_fit", "physical_fit": {"enabled": True}}
    return {
        "robot": {
            "name": "arm",
            "properties": {
                "joints": {"active_joints": list(task.joints)},
                "mechanics": {
                    "reduction_ratios": [1.0] * len(task.joints),
                    "friction_coefficients": {"viscous": zeros, "static": zeros},
                    "actuator_inertias": zeros,
                    "joint_offsets": zeros,
                },
                "coupling": {"has_coupled_wrist": bool(task.wrist)},
            },
        },
        "tasks": {"identification": identification},
    }


class Fit(BaseIdentification):  # type: ignore[misc, unused-ignore]
    """A task; what a subclass must give, and columns of a coupled wrist."""

    task: Task
    own = True

    def load_trajectory_data(self, data_source: str | None = None) -> dict[str, Any]:
        """Return the log, or the common rows."""
        log, rows = self.task.log, self.task.common
        if self.own:
            return {
                "timestamps": log["time"][:, None],
                "positions": log["position"],
                "velocities": None,
                "accelerations": None,
                "torques": log["effort"],
            }
        return {
            "timestamps": np.arange(len(rows.position))[:, None] / self.task.rate_hz,
            "positions": rows.position,
            "velocities": rows.velocity,
            "accelerations": rows.acceleration,
            "torques": rows.effort,
        }

    def filter_kinematics_data(self, filter_config: Any = None) -> None:
        """Leave the common rows as they are; leave out transients of the filter at the ends."""
        if not self.own:
            self.processed_data = dict(self.raw_data)
            return
        super().filter_kinematics_data(filter_config)
        kept = inside(self.task, self.identif_config["cut_off_frequency_butterworth"])
        for held in (self.raw_data, self.processed_data):
            held |= {k: v[kept] for k, v in held.items() if v is not None}

    def columns(self, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Return the columns of the wrist (as its example has them), joint by joint."""
        wrist = [self.task.joints.index(j) for j in self.task.wrist]
        extra = np.zeros((len(self.task.joints), len(v), 3))
        for joint, other in (wrist, wrist[::-1]):
            extra[joint, :, 0], extra[joint, :, 1] = a[:, other], v[:, other]
            extra[joint, :, 2] = np.sign(v[:, wrist].sum(axis=1))
        return extra.reshape(-1, 3)

    def calculate_full_regressor(self) -> None:
        """Add the columns of the wrist."""
        super().calculate_full_regressor()
        if self.task.wrist:
            found = self.processed_data
            extra = self.columns(found["velocities"], found["accelerations"])
            self.dynamic_regressor = np.hstack([self.dynamic_regressor, extra])

    def initialize_standard_parameters(self) -> None:
        """Add the parameters of the wrist."""
        super().initialize_standard_parameters()
        if self.task.wrist:
            self.standard_parameter |= dict.fromkeys(("Iam6", "fvm6", "fsm6"), 0.0)

    def _compute_validation_metrics(self) -> None:
        """Leave out a step that fails with columns of one's own."""

    def predict(self, rows: Rows) -> np.ndarray:
        """Return efforts with the estimate that it selected."""
        q, v, a = rows.position, rows.velocity, rows.acceleration
        full = build_regressor_basic(self.robot, q, v, a, self.identif_config)
        if self.task.wrist:
            full = np.hstack([full, self.columns(v, a)])
        if self.selected is not None:
            efforts = self.selected.predict(full)
        else:
            kept = np.delete(full, self._idx_eliminated, axis=1)
            efforts = kept[:, self._base_indices] @ self.phi_base
        return np.asarray(efforts).reshape(len(self.task.joints), -1).T


def fit(task: Task, *, own: bool, weighted: bool = False, physical: bool = False) -> Answer:
    """Return what it finds; an estimate that it rejects is a failure."""
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "arm.yaml"
        config.write_text(yaml.safe_dump(_settings(task, own, physical)), encoding="utf-8")
        found = Fit(load_robot(task.urdf), str(config))
    joints = [found.model.joints[found.model.getJointId(j)] for j in task.joints]
    found.identif_config["act_idxq"] = [joint.idx_q for joint in joints]
    found.identif_config["act_idxv"] = [joint.idx_v for joint in joints]
    found.task, found.own = task, own
    cutoff = found.identif_config["cut_off_frequency_butterworth"]
    factor = max(1, min(DECIMATION, int(task.rate_hz / (LEAST * cutoff)))) if own else 1
    found.initialize()
    found.solve(
        decimate=factor > 1,
        decimation_factor=factor,
        zero_tolerance=0.001,
        plotting=False,
        save_results=False,
        wls=weighted,
    )
    if not physical:
        return Answer(found.predict)
    selected = found.selected
    if selected is None or not selected.accepted:
        raise RuntimeError(f"rejected by FIGAROH: {selected.reason if selected else 'not run'}")
    bodies = np.array(list(selected.link_p10(list(found.model.names[1:])).values()))
    return Answer(found.predict, bodies, selected.status)


METHODS: dict[str, Method] = {
    "own rows, least squares": partial(fit, own=True),
    "own rows, weighted": partial(fit, own=True, weighted=True),
    "own rows, physical fit": partial(fit, own=True, physical=True),
    "least squares": partial(fit, own=False),
    "weighted": partial(fit, own=False, weighted=True),
    "physical fit": partial(fit, own=False, physical=True),
}

if __name__ == "__main__":
    main(METHODS, ("figaroh", "pin", "picos", "cvxopt", "scipy"))
