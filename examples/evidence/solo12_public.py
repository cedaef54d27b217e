"""Solo12's public recordings: what identification adds to the error of the true description.

A quadruped that others simulated with the inertias of its URDF, standing, trotting and jumping.
Nothing can be gained, so the excess over the description's own error is what matters. All three
recordings are fitted together, with all defaults; five blocks of each are held out in turn.
Residuals of all 18 equations are projected onto what closed contacts leave free, as they are in N
and N·m. *Joints* is the root of the summed mean squares of the twelve joint rows, *base* that of
the three forces.

* ``solo12_public.csv``: description, least squares, and the estimate.

    python examples/evidence/solo12_public.py --data /path/to/data --out results
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from study import Study

import sdpid
from sdpid._common.arrays import Array
from sdpid.assurance.diagnostics.bands import held_out_blocks
from sdpid.estimation.problem import Problem
from sdpid.robot.model.jacobians import contact_jacobians

# First and last row, counted from 1, and the sample rate in Hz: one file holds them all.
RECORDINGS = {
    "stand": ((1, 2000), 200.0),
    "trot": ((2001, 3200), 100.0),
    "jump": ((3201, 4400), 100.0),
}
LEGS = [f"{leg}_{part}" for leg in ("FL", "FR", "HL", "HR") for part in ("HAA", "HFE", "KFE")]
MAPPING = {
    "mapping": False,
    "columns": {
        "position": "q[8:19]",
        "velocity": "dq[7:18]",
        "base_position": "q[1:3]",
        "base_orientation": "q[4:7]",
        "base_linear_velocity": "dq[1:3]",
        "base_angular_velocity": "dq[4:6]",
    },
    # Its source does not say so: velocities agree with the pose's differences in no other axes.
    "base": {"quaternion": "xyzw", "velocity_frame": "base"},
    "contacts": {
        "frames": ["FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT"],
        "offset": [0.0, 0.0, -0.0184],
    },
    "joint_names": LEGS,
}
COLUMNS = (
    "recording", "joints_nm", "above_description_nm", "least_squares_joints_nm",
    "description_joints_nm", "base_force_n", "least_squares_base_force_n",
    "description_base_force_n", "mass_percent",
)  # fmt: skip


def read(folder: Path, name: str) -> sdpid.Recording:
    """Return one of the recordings."""
    rows, rate = RECORDINGS[name]
    return sdpid.read_recording(folder, rows=rows, rate_hz=rate, **MAPPING)


def projected(problem: Problem, base: Array) -> Array:
    """Return residuals (K, 18) that closed contacts do not explain, of parameters a sample."""
    samples = problem.samples
    contacts = samples.contacts
    assert contacts is not None
    J = contact_jacobians(problem.robot, samples.position, contacts.frames, contacts.offset)
    rows = problem.require_rows_here("study")
    off = np.concatenate(
        [effort - np.einsum("knb,kb->kn", W, base[part]) for part, W, effort, _ in rows.chunks()]
    )
    for k, down in enumerate(contacts.down):
        if down.any():
            Q, _ = np.linalg.qr(J[k, down, :3].reshape(-1, samples.n).T)
            off[k] -= Q @ (Q.T @ off[k])
    return off


def size(off: Array) -> float:
    """Return the root of the summed mean squares of some equations."""
    return float(np.sqrt(np.mean(off**2, axis=0).sum()))


def main() -> None:
    """Write the table."""
    study = Study(__doc__, data=True)
    folder = study.data / "solo12_simulated"
    if not folder.is_dir():
        print("solo12_simulated: skipped; docs/evidence/data.md says where it comes from")
        return
    names = ("stand", "trot") if study.quick else tuple(RECORDINGS)
    robot = sdpid.load_robot(folder / "solo12.urdf", root="free_flyer")
    known: dict[str, Any] = {}
    if study.quick:
        known = {"friction": (sdpid.friction.Coulomb(width=0.02), "viscous"), "effects": "none"}
    logs = [read(folder, name) for name in names]
    result = sdpid.identify(robot, logs, intervals=False, **known)
    problem = result.problem
    theta = np.zeros(problem.n_theta)
    theta[: robot.prior.size] = robot.prior.ravel()
    described = np.tile(problem.base_of(theta), (problem.n_samples, 1))
    ours, least = described.copy(), described.copy()
    held_out = held_out_blocks(problem)
    for k, fit in enumerate(held_out.estimates):
        inside = held_out.owner == k
        ours[inside] = fit.base
        least[inside] = sdpid.solve_wls(replace(fit.problem, prior=None)).base
    errors = [projected(problem, base) for base in (ours, least, described)]
    mass = result.estimate.theta[: robot.prior.size : 10].sum() / robot.prior[:, 0].sum()
    table = []
    for name, part in zip(names, problem.samples.parts, strict=True):
        joints = [size(off[part, 6:]) for off in errors]
        base = [size(off[part, :3]) for off in errors]
        gained = joints[0], joints[0] - joints[2], *joints[1:]
        table.append((name, *gained, *base, 100.0 * (mass - 1.0)))
    study.write("solo12_public.csv", COLUMNS, table)


if __name__ == "__main__":
    main()
