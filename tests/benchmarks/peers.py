"""From a log to a result, beside FIGAROH: the record of a Staubli TX40 (docs/evidence/data.md).

    python -m tests.benchmarks.peers --figaroh-python env/bin/python --data data/staubli_tx40
        [--repeat 5] [--threads 1] [--csv out.csv]

FIGAROH needs an environment of its own (``pip install figaroh==1.0.2``). Both sides read the same
24750 rows from the NPZ and the robot from the same URDF, and every measurement is a fresh process;
the sides take turns. sdpid's job ends with a certified optimum of the semidefinite program, with
its default settings and the terms of this robot's drives (`sdpid, identify` adds the unconstrained
fit, intervals of all parameters, and residuals); FIGAROH's ends with its unconstrained fit and its
own report of it, with the settings of its example for this robot:

- positions through a median filter of 5 samples and a zero-phase Butterworth filter of order 4 at
  100 Hz, differentiated twice by `numpy.gradient`; efforts not filtered;
- per joint viscous and Coulomb friction, rotor inertia, offset; three columns of the coupled
  wrist, which FIGAROH leaves to its user: added here by array operations, its example loops;
- columns with a squared norm below 0.001 dropped; rows decimated by 10 (`scipy.signal.decimate`);
  base parameters by two QR decompositions; ordinary least squares, or weighted as in the example;
- no plots and no files.

FIGAROH 1.0.2 looks at its fit again at the end, with a regressor that it builds without the
columns of the wrist, and fails there. That step is left out where they are present, to FIGAROH's
advantage; as a third way, its fit runs as it is without those columns (`FIGAROH, without the
wrist`), which costs accuracy at joints 5 and 6.

Four times are compared: the second job in a process (nothing is imported or loaded for the first
time), on the clock and of the processor; the first job (what is imported on first use counts); and
from the start of the process to the first result (interpreter and imports count).
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

_LEAST_REPEATS = 5
_RATE_HZ = 5000.0
_WRIST = ("joint_5", "joint_6")
# As the coupling's friction is smoothed in examples/studies/real_robots.py, rad/s.
_WIDTH = 0.05

# What FIGAROH's example for this robot sets, in the format that 1.0.2 reads.
_FIGAROH = {
    "robot": {
        "name": "tx40",
        "properties": {
            "joints": {"active_joints": [f"joint_{k}" for k in range(1, 7)]},
            "mechanics": {
                "reduction_ratios": [32.0, 32.0, 45.0, -48.0, 45.0, 32.0],
                "friction_coefficients": {
                    "viscous": [8.05, 5.53, 1.97, 1.11, 1.86, 0.65],
                    "static": [7.14, 8.26, 6.34, 2.48, 3.03, 0.282],
                },
                "actuator_inertias": [0.362, 0.362, 0.0988, 0.0313, 0.0468, 0.0105],
                "joint_offsets": [0.392, 1.37, 0.326, -0.102, -0.0288, 0.127],
            },
            "coupling": {
                "has_coupled_wrist": True, "Iam6": 0.00964, "fvm6": 0.616, "fsm6": 1.95
            },
        },
    },
    "tasks": {
        "identification": {
            "enabled": True,
            "problem": {
                "include_external_forces": False,
                "use_joint_torques": True,
                "model_components": {
                    "friction": True, "joint_offset": True, "actuator_inertia": True
                },
            },
            "signal_processing": {
                "sampling_frequency": _RATE_HZ, "cutoff_frequency": 100.0,
                "filter_type": "butterworth", "filter_order": 4,
                "differentiation_method": "gradient",
            },
        }
    },
}  # fmt: skip


def sdpid_job(everything: bool) -> Callable[[str, str], dict[str, Any]]:
    """Import sdpid and return its job: to the certificate, or all that `identify` does."""
    import sdpid

    def job(log_file: str, robot_file: str) -> dict[str, Any]:
        from sdpid.experiment.preparation.for_robot import default_friction
        from sdpid.workflow.formulate import formulate
        from sdpid.workflow.identify import identify

        log = sdpid.read_recording(log_file)
        robot = sdpid.load_robot(robot_file)
        wrist = sdpid.friction.Coupling(*_WRIST, width=_WIDTH)
        friction = (*default_friction(log), "rotor_inertia", wrist)
        if everything:
            found = identify(robot, log, friction=friction)
            problem, estimate, certificate = found.problem, found.estimate, found.certificate
        else:
            problem = formulate(robot, log, friction=friction)
            estimate = sdpid.solve_sdp(problem)
            certificate = sdpid.certify(estimate)
        assert certificate.passed, certificate.summary()
        return {
            "rows": problem.n_rows,
            "columns": problem.base.count,
            "rmse": lambda: sdpid.validate(estimate).rmse.tolist(),
        }

    return job


def figaroh_job(weighted: bool, wrist: bool = True) -> Callable[[str, str], dict[str, Any]]:
    """Import FIGAROH and return its job, with the columns of the wrist or without."""
    import yaml
    from figaroh.identification.base_identification import BaseIdentification
    from figaroh.tools.robot import load_robot

    class Plain(BaseIdentification):  # type: ignore[misc, unused-ignore]
        """The log; everything else is FIGAROH's."""

        log_file = ""

        def load_trajectory_data(self, data_source: str | None = None) -> dict[str, Any]:
            with np.load(self.log_file, allow_pickle=False) as log:
                return {
                    "timestamps": log["t"][:, None],
                    "positions": log["q"],
                    "velocities": None,
                    "accelerations": None,
                    "torques": log["tau"],
                }

    class Wrist(Plain):
        """The columns of the coupled wrist."""

        def calculate_full_regressor(self) -> None:
            super().calculate_full_regressor()
            v, a = self.processed_data["velocities"], self.processed_data["accelerations"]
            extra = np.zeros((6, len(v), 3))
            for joint, other in ((4, 5), (5, 4)):
                extra[joint, :, 0], extra[joint, :, 1] = a[:, other], v[:, other]
                extra[joint, :, 2] = np.sign(v[:, 4] + v[:, 5])
            self.dynamic_regressor = np.hstack([self.dynamic_regressor, extra.reshape(-1, 3)])

        def initialize_standard_parameters(self) -> None:
            super().initialize_standard_parameters()
            for name in ("Iam6", "fvm6", "fsm6"):
                self.standard_parameter[name] = float(self.identif_config[name])

        def _compute_validation_metrics(self) -> None:
            """Leave out the step that fails with columns of one's own, which saves time."""

    kind = Wrist if wrist else Plain

    def job(log_file: str, robot_file: str) -> dict[str, Any]:
        with tempfile.TemporaryDirectory() as folder:
            config = Path(folder) / "tx40.yaml"
            config.write_text(yaml.safe_dump(_FIGAROH), encoding="utf-8")
            fit = kind(load_robot(robot_file), str(config))
        joints = [fit.model.joints[fit.model.getJointId(j)] for j in fit.model.names[1:]]
        fit.identif_config["act_idxq"] = [joint.idx_q for joint in joints]
        fit.identif_config["act_idxv"] = [joint.idx_v for joint in joints]
        fit.log_file = log_file
        # Its report goes to the terminal.
        with contextlib.redirect_stdout(io.StringIO()):
            fit.initialize()
            fit.solve(
                decimate=True, decimation_factor=10, zero_tolerance=0.001, plotting=False,
                save_results=False, wls=weighted,
            )  # fmt: skip
        residual = (fit.tau_noised - fit.tau_identif).reshape(6, -1)
        return {
            "rows": len(fit.tau_noised),
            "columns": len(fit.phi_base),
            "rmse": lambda: np.sqrt(np.mean(residual**2, axis=1)).tolist(),
        }

    return job


SIDES: dict[str, Callable[[], Callable[[str, str], dict[str, Any]]]] = {
    "sdpid": lambda: sdpid_job(False),
    "sdpid, identify": lambda: sdpid_job(True),
    "FIGAROH, ordinary": lambda: figaroh_job(False),
    "FIGAROH, weighted": lambda: figaroh_job(True),
    "FIGAROH, without the wrist": lambda: figaroh_job(False, wrist=False),
}
_LIBRARIES = ("sdpid", "figaroh", "numpy", "scipy", "pin", "clarabel", "numba")


def apart(side: str, began: float, log_file: str, robot_file: str) -> dict[str, Any]:
    """Do a side's job twice, in the process that is this one."""
    job = SIDES[side]()
    start = time.perf_counter()
    found = job(log_file, robot_file)
    first = time.perf_counter() - start
    whole = time.time() - began
    start, used = time.perf_counter(), time.process_time()
    job(log_file, robot_file)
    second, processor = time.perf_counter() - start, time.process_time() - used
    versions = {"python": platform.python_version()}
    for name in _LIBRARIES:
        with contextlib.suppress(PackageNotFoundError):
            versions[name] = version(name)
    times = {"first": first, "whole": whole, "second": second, "processor": processor}
    return found | times | {"versions": versions, "rmse": found["rmse"]()}


def _measured(python: str, side: str, data: Path, threads: int) -> dict[str, Any]:
    """Start a side's process, and return what it says."""
    files = [str(data / "tx40_rows_0_24750.npz"), str(data / "tx40.urdf")]
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")
    environment = dict(os.environ) | dict.fromkeys(names, str(threads))
    # Isolated, so that nothing beside this file is found in place of a library.
    command = [python, "-I", __file__, "--apart", side, repr(time.time()), *files]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    if done.returncode:
        raise SystemExit(f"{side}: {' '.join(command)} failed:\n{done.stderr}")
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


TIMES = {
    "second": "second job in a process",
    "processor": "second job, processor time",
    "first": "first job in a process",
    "whole": "start of the process to the result",
}


def measure(
    figaroh_python: str, data: Path, repeats: int = _LEAST_REPEATS, threads: int = 1
) -> dict[str, list[dict[str, Any]]]:
    """Return what every side said in every repeat; all in turn, each first in its turn."""
    pythons = {side: sys.executable if "sdpid" in side else figaroh_python for side in SIDES}
    # Once before: numba compiles into its cache, and files are read from disk.
    for side, python in pythons.items():
        _measured(python, side, data, threads)
    found: dict[str, list[dict[str, Any]]] = {side: [] for side in SIDES}
    order = list(SIDES)
    for repeat in range(repeats):
        for step in range(len(order)):
            side = order[(repeat + step) % len(order)]
            found[side].append(_measured(pythons[side], side, data, threads))
    return found


def rows(found: dict[str, list[dict[str, Any]]]) -> list[Any]:
    """Return the others' times as ratios to sdpid's, a row each (see `timing.Row`)."""
    from tests.benchmarks.timing import Row

    def seconds(side: str, key: str) -> Any:
        return np.array([each[key] for each in found[side]])

    return [
        Row.of(f"{side}: {what}", seconds(side, key), "sdpid, certified", seconds("sdpid", key))
        for side in SIDES
        if side != "sdpid"
        for key, what in TIMES.items()
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.peers")
    parser.add_argument("--figaroh-python", help="interpreter of an environment with figaroh")
    parser.add_argument("--data", type=Path, help="folder of the TX40 record")
    parser.add_argument("--repeat", type=int, default=_LEAST_REPEATS, help="at least 5 (default)")
    parser.add_argument("--threads", type=int, default=1, help="of linear algebra, both sides")
    parser.add_argument("--csv", type=Path, help="write the table here as well")
    parser.add_argument("--apart", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.apart:
        side, began, *files = options.apart
        print(json.dumps(apart(side, float(began), *files)))
        return 0
    if options.figaroh_python is None or options.data is None:
        parser.error("give --figaroh-python and --data.")
    if options.repeat < _LEAST_REPEATS:
        parser.error(f"--repeat: is {options.repeat}; at least {_LEAST_REPEATS} give a spread.")
    from tests.benchmarks.timing import table

    found = measure(options.figaroh_python, options.data, options.repeat, options.threads)
    for side, runs in found.items():
        one = runs[0]
        used = ", ".join(f"{name} {number}" for name, number in one["versions"].items())
        errors = ", ".join(f"{value:.3g}" for value in one["rmse"])
        print(
            f"{side}: {one['rows']} rows fitted, {one['columns']} base parameters, error of each "
            f"joint {errors} N·m\n  {used}"
        )
    print(f"{os.cpu_count()} cores, {options.threads} threads of linear algebra\n")
    result = table(rows(found))
    print(result.text(digits=3))
    if options.csv is not None:
        result.write(options.csv)
    return 0


if __name__ == "__main__":
    sys.exit(main())
