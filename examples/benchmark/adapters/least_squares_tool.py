"""Plain least squares for the benchmark: Pinocchio's regressor, and NumPy."""

# /// script
# [tool.benchmark]
# name = "least squares"
# methods = ["least squares"]
# ///

import numpy as np
import pinocchio as pin
from protocol import Answer, Rows, Task, main


def least_squares(task: Task) -> Answer:
    """Fit links, Coulomb and viscous friction and offsets to the common rows."""
    model = pin.buildModelFromUrdf(task.urdf)
    data, zero, n = model.createData(), pin.neutral(model), model.nv
    order = [model.joints[model.getJointId(name)].idx_v for name in task.joints]

    def regressor(rows: Rows) -> np.ndarray:
        found = []
        for q, v, a in zip(rows.position, rows.velocity, rows.acceleration, strict=True):
            q_, v_, a_ = np.empty((3, n))
            q_[order], v_[order], a_[order] = q, v, a
            q_ = pin.integrate(model, zero, q_)
            links = pin.computeJointTorqueRegressor(model, data, q_, v_, a_)[order]
            found.append(np.hstack([links, np.diag(np.sign(v)), np.diag(v), np.eye(n)]))
        return np.vstack(found)

    theta = np.linalg.lstsq(regressor(task.common), task.common.effort.ravel(), rcond=None)[0]
    bodies = theta[: 10 * n].reshape(n, 10)
    return Answer(lambda rows: (regressor(rows) @ theta).reshape(-1, n), bodies)


if __name__ == "__main__":
    main({"least squares": least_squares}, ("pin",))
