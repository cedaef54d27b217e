"""mujoco.sysid for the benchmark.

Its parametrization of bodies (pseudo-inertia, log-Cholesky) with its default bounds about the
description, and its optimizer with its default settings. Residuals are efforts of MuJoCo's inverse
dynamics on the common rows, weighted alike, with friction of the common terms added. Its usual
residuals, those of simulations, need windows and weights of one's own, and are left out.
"""

# /// script
# dependencies = [
#   "mujoco[sysid]==4.0.0",
#   "numpy==2.4.6",
#   "scipy==1.17.1",
# ]
#
# [tool.benchmark]
# name = "mujoco.sysid"
# methods = [
#   "inverse dynamics",
# ]
#
# [tool.benchmark.bounds]
# "inverse dynamics" = "SDP"
# ///

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import mujoco
import numpy as np
from mujoco import sysid
from mujoco.sysid import model_modifier
from protocol import Answer, Method, Rows, Task, main

# Bounds of friction, N·m and N·m·s/rad, which are wide for these arms.
FRICTION = 200.0
BOUND = 1e-9  # of nothing at all, above zero


def _spec(task: Task) -> Any:
    spec = mujoco.MjSpec.from_file(task.urdf)
    spec.option.gravity = [0.0, 0.0, -9.81]
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    for joint in spec.joints:
        joint.damping = np.zeros(np.shape(joint.damping))
        joint.frictionloss = 0.0
    return spec


def _moved(model: Any) -> list[str]:
    """Return the names of bodies that a joint moves and that have mass."""
    return [
        model.body(k).name
        for k in range(1, model.nbody)
        if model.body_weldid[k] == k and model.body_mass[k] > 0.0
    ]


def _parameters(spec: Any, model: Any, terms: tuple[str, ...]) -> Any:
    params = sysid.ParameterDict()
    kind = sysid.InertiaType.Pseudo
    for name in _moved(model):
        made = sysid.body_inertia_param(
            spec, model, name, inertia_type=kind, modifier=partial(_set_inertia, name)
        )
        params.add(made)
    for term in terms:
        low = -FRICTION if term == "offset" else 0.0
        start = np.zeros(model.nv) + (0.0 if term == "offset" else BOUND)
        params.add(
            sysid.Parameter(
                term,
                start,
                np.full(model.nv, low),
                np.full(model.nv, FRICTION),
                modifier=lambda spec, param: spec,
            )
        )
    # As its optimizer advises.
    params.move_off_bounds()
    return params


def _set_inertia(name: str, spec: Any, param: Any) -> Any:
    """Give a body the inertia of log-Cholesky parameters, about its principal axes.

    The modifier that mujoco.sysid makes by itself sets the full inertia, and the compiler of
    MuJoCo 4.0.0 then refuses the body ("mass and inertia of moving bodies must be larger than
    mjMINVAL").
    """
    pi = model_modifier.pi_from_theta(param.value)
    c = pi[1:4] / pi[0]
    about = pi[4:].reshape(3, 3) - pi[0] * (c @ c * np.eye(3) - np.outer(c, c))
    values, axes = np.linalg.eigh(0.5 * (about + about.T))
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] *= -1.0
    turn = np.zeros(4)
    mujoco.mju_mat2Quat(turn, axes.ravel())
    body = spec.body(name)
    body.explicitinertial = True
    body.fullinertia = np.full(np.shape(body.fullinertia), np.nan)
    body.mass, body.ipos, body.iquat, body.inertia = pi[0], c, turn, values
    return spec


def _bodies(model: Any) -> np.ndarray:
    found = []
    for name in _moved(model):
        k = model.body(name).id
        m, c = float(model.body_mass[k]), np.array(model.body_ipos[k])
        turned = np.zeros(9)
        mujoco.mju_quat2Mat(turned, model.body_iquat[k])
        R = turned.reshape(3, 3)
        about = R @ np.diag(model.body_inertia[k]) @ R.T + m * (c @ c * np.eye(3) - np.outer(c, c))
        xx, xy, yy = about[0, 0], about[0, 1], about[1, 1]
        rest = (about[0, 2], about[1, 2], about[2, 2])
        found.append([m, *(m * c), xx, xy, yy, *rest])
    return np.array(found)


def _links(model: Any, rows: Rows, order: np.ndarray) -> np.ndarray:
    """Return the efforts (K, n) of the bodies, joint by joint as the task has them."""
    data = mujoco.MjData(model)
    out = np.empty_like(rows.position)
    for k in range(len(out)):
        data.qpos[order] = rows.position[k]
        data.qvel[order] = rows.velocity[k]
        data.qacc[order] = rows.acceleration[k]
        mujoco.mj_inverse(model, data)
        out[k] = data.qfrc_inverse[order]
    return out


def _friction(params: Any, rows: Rows, order: np.ndarray) -> np.ndarray:
    v = rows.velocity
    fc, fv = params["coulomb"].value[order], params["viscous"].value[order]
    offset = params["offset"].value[order] if "offset" in params else 0.0
    return np.asarray(fc * np.sign(v) + fv * v + offset)


def _answer(spec: Any, params: Any, order: np.ndarray, result: Any) -> Answer:
    model = sysid.apply_param_modifiers(params, spec)

    def predict(rows: Rows) -> np.ndarray:
        return _links(model, rows, order) + _friction(params, rows, order)

    x, (low, high) = result.x, params.get_bounds()
    near = np.minimum(x - low, high - x) <= 1e-6 * (high - low)
    inertial = x.size - 3 * model.nv if "offset" in params else x.size - 2 * model.nv
    steps = len(result.extras.get("objective", ())) if "extras" in result else 0
    facts = {"at_bounds": float(near[:inertial].sum()), "iterations": float(steps)}
    return Answer(predict, _bodies(model), "", facts)


def _order(task: Task, model: Any) -> np.ndarray:
    return np.array([model.joint(name).dofadr[0] for name in task.joints])


def _optimized(params: Any, missed: Callable[[Any], np.ndarray], **options: Any) -> tuple[Any, Any]:
    """Minimize by its optimizer, which asks for several points at once, as columns."""

    def residual(x: np.ndarray, known: Any) -> Any:
        columns = []
        for point in np.asarray(x).reshape(len(x), -1).T:
            known.update_from_vector(point)
            columns.append(missed(known))
        return [np.stack(columns, axis=1) if np.ndim(x) > 1 else columns[0]], [], []

    return sysid.optimize(params, residual, verbose=False)  # type: ignore[no-any-return]


def inverse(task: Task) -> Answer:
    """Return the fit of efforts."""
    spec = _spec(task)
    model = spec.compile()
    order = _order(task, model)
    params = _parameters(spec, model, ("coulomb", "viscous", "offset"))
    effort = task.common.effort
    assert effort is not None

    def missed(known: Any) -> np.ndarray:
        moved = sysid.apply_param_modifiers(known, spec)
        found = _links(moved, task.common, order) + _friction(known, task.common, order)
        return (found - effort).ravel()

    found, result = _optimized(params, missed)
    return _answer(spec, found, order, result)


METHODS: dict[str, Method] = {
    "inverse dynamics": inverse,
}

if __name__ == "__main__":
    main(METHODS, ("mujoco", "scipy"))
