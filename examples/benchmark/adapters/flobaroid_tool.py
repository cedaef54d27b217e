"""FloBaRoID for the benchmark, from a checkout.

It is no package: its modules are imported from the checkout. Its settings are those that it ships
for a KUKA LWR 4+ (`configs/kuka_lwr4.yaml`), less what belongs to that arm alone: the mass in all,
which is that of the description instead (what it takes by itself where none is given), and the
samples left out at the start.
"""

# It asks for idyntree 15.0.0, of which PyPI has 15.1.0.

# /// script
# requires-python = ">=3.13"
# dependencies = [
#   "idyntree==15.1.0",
#   "numpy==2.4.6",
#   "scipy==1.17.1",
#   "sympy==1.14.0",
#   "cvxpy==1.9.3",
#   "clarabel==0.11.1",
#   "pyyaml==6.0.3",
#   "colorama==0.4.6",
#   "palettable==3.3.3",
#   "humanize==4.15.0",
#   "tqdm==4.70.1",
#   "jinja2==3.1.6",
#   "matplotlib==3.11.2",
#   "plotly~=6.8.0",
#   "trimesh==4.12.2",
# ]
#
# [tool.benchmark]
# name = "FloBaRoID"
# checkout = "github.com/kjyv/FloBaRoID at 9c06804"
# methods = [
#   "own rows, least squares",
#   "own rows, SDP",
#   "least squares",
#   "SDP",
#   "SDP, no beliefs",
# ]
#
# [tool.benchmark.bounds]
# "SDP, no beliefs" = "SDP 6×6, tanh"
# ///

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from protocol import Answer, Method, Rows, Task, inside, main

FOLDER = Path(os.environ.get("CHECKOUT", ""))
SEED = 0
# Of its parameters of a link (m, h, xx, xy, xz, yy, yz, zz), those of `Answer.bodies`.
ORDER = [0, 1, 2, 3, 4, 5, 7, 6, 8, 9]


def _clear_vectors() -> None:
    """Begin six-vectors of iDynTree at zero.

    FloBaRoID takes new ones for an acceleration of zero. Those of the package on PyPI hold
    whatever was in memory, and efforts of NaN come of it.
    """
    from idyntree import bindings

    plain = bindings.Vector6

    def cleared(*given: Any) -> Any:
        vector = plain(*given)
        if not given:
            vector.zero()
        return vector

    if plain.__name__ == "Vector6":
        bindings.Vector6 = cleared


# Its options that pull towards the description or bound by it, switched off.
NO_BELIEFS = {
    "frictionRegularization": 0,
    "frictionFvRegularizationRelative": 0.0,
    "postIdentifyFriction": 0,
    "identifyClosestToCAD": 0,
    "restrictCOMtoHull": 0,
    "limitOverallMass": 0,
    "limitMassToApriori": 0,
}


def _settings(task: Task, constrained: bool, beliefs: bool) -> dict[str, Any]:
    import yaml

    text = (FOLDER / "configs" / "kuka_lwr4.yaml").read_text(encoding="utf-8")
    found: dict[str, Any] = yaml.safe_load(text)
    found |= {
        "limitMassVal": None,
        "startOffset": 0,
        "createPlots": 0,
        "verbose": 0,
        "num_dofs": len(task.joints),
        "constrainToConsistent": int(constrained),
        "estimateWith": "std" if constrained else "base",
    }
    if not beliefs:
        found |= NO_BELIEFS
    return found


def _stored(rows: Rows, rate_hz: float, order: list[int]) -> dict[str, np.ndarray]:
    effort = np.zeros_like(rows.position) if rows.effort is None else rows.effort
    return {
        "positions": rows.position[:, order],
        "velocities": rows.velocity[:, order],
        "accelerations": rows.acceleration[:, order],
        "torques": effort[:, order],
        "times": np.arange(len(effort)) / rate_hz,
        "frequency": np.array(rate_hz),
    }


def _processed(task: Task, data: Any, order: list[int]) -> dict[str, np.ndarray]:
    """Return the log behind its own filters."""
    q, tau = (np.array(task.log[k][:, order]) for k in ("position", "effort"))
    v, a, q_raw, v_raw, tau_raw = (np.zeros_like(q) for _ in range(5))
    time = task.log["time"]
    data.preprocess(
        Q=q, V=v, Vdot=a, Tau=tau, T=time, Fs=task.rate_hz,
        Q_raw=q_raw, V_raw=v_raw, Tau_raw=tau_raw,
    )  # fmt: skip
    kept = inside(task, float(data.opt["filterLowPass2"][0]))
    found = {
        "positions": q,
        "velocities": v,
        "accelerations": a,
        "torques": tau,
        "velocities_raw": v_raw,
        "times": time,
    }
    return {k: x[kept] for k, x in found.items()} | {"frequency": np.array(task.rate_hz)}


def fit(task: Task, *, own: bool, constrained: bool = True, beliefs: bool = True) -> Answer:
    """Return what it finds."""
    sys.path.insert(0, str(FOLDER.resolve()))
    _clear_vectors()
    from identification.data import Data
    from identifier import Identification

    settings = _settings(task, constrained, beliefs)
    np.random.seed(SEED)  # noqa: NPY002 - of its random regressor
    with tempfile.TemporaryDirectory() as folder:
        # It keeps files beside the description.
        urdf = shutil.copy(task.urdf, folder)
        found = Identification(settings, str(urdf), None, None, None, None)
        model = found.model
        # Its joints may stand in another order.
        order = [task.joints.index(name) for name in model.jointNames]
        taken = (
            _processed(task, found.data, order)
            if own
            else _stored(task.common, task.rate_hz, order)
        )
        found.data.init_from_data(taken)
        found.estimateParameters()
    standard = np.array(model.xStd)
    base = np.array(model.xBase)
    failed = constrained and np.allclose(standard, model.xStdModel)
    if failed:
        raise RuntimeError("the semidefinite program failed; the description is returned")

    def predict(rows: Rows) -> np.ndarray:
        asked = Data(settings)
        asked.init_from_data(_stored(rows, task.rate_hz, order))
        model.computeRegressors(asked)
        efforts = model.YStd @ standard if constrained else model.YBase @ base
        out = np.empty_like(rows.position)
        out[:, order] = efforts.reshape(-1, len(order))
        return out

    bodies = None
    if constrained:
        links = standard[: model.num_model_params].reshape(-1, 10)[:, ORDER]
        # Of links that do not move, and of frames without mass, nothing is identified.
        still = set(model.non_id)
        moving = [
            k
            for k in range(len(links))
            if model.xStdModel[10 * k] > 0.0 and not still.issuperset(range(10 * k, 10 * k + 10))
        ]
        bodies = links[moving]
    return Answer(predict, bodies, str(getattr(found.sdp, "status", "")))


METHODS: dict[str, Method] = {
    "own rows, SDP": partial(fit, own=True),
    "own rows, least squares": partial(fit, own=True, constrained=False),
    "SDP": partial(fit, own=False),
    "SDP, no beliefs": partial(fit, own=False, beliefs=False),
    "least squares": partial(fit, own=False, constrained=False),
}

if __name__ == "__main__":
    main(METHODS, ("idyntree", "cvxpy", "clarabel", "scipy"))
