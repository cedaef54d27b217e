"""Compare predicted with measured efforts, on the estimate's own rows or on fresh ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Indices, frozen, frozen_view
from sdpid._common.tables import Table, facts_html, plain
from sdpid.errors import DataError
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.estimate import Estimate
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.friction.terms import smooth_sign
from sdpid.robot.model.model import RobotModel

# Samples a piece: the regressor of a piece stays below some 100 MB for an arm.
_CHUNK = 20_000


@dataclass(frozen=True, kw_only=True, eq=False)
class Validation:
    """Prediction errors, joint by joint, on the rows that are not masked.

    Attributes
    ----------
    joint_names : tuple of str
        The joints.
    effort_predicted : ndarray, shape (K, n)
        Predicted efforts at every sample, masked ones included, N·m.
    rmse : ndarray, shape (n,)
        Root mean square error, N·m.
    nrmse : ndarray, shape (n,)
        Root mean square error over root mean square effort.
    r2 : ndarray, shape (n,)
        Share of the effort's variance that is explained.
    relative : float
        Norm of all errors over the norm of all efforts.
    rows : ndarray of int, shape (n,)
        Rows that count. Where there are none, of a joint whose effort was not measured,
        the joint's figures say nothing: `rmse` and `nrmse` are 0, `r2` is 1.
    """

    joint_names: tuple[str, ...]
    effort_predicted: Array
    rmse: Array
    nrmse: Array
    r2: Array
    relative: float
    rows: Indices

    def __repr__(self) -> str:
        joints = len(self.joint_names)
        return f"Validation({joints} joints, relative residual {100 * self.relative:.3g} %)"

    def _repr_html_(self) -> str:
        return facts_html("Validation", {"relative residual": self.relative}, self._table())

    def _table(self) -> Table:
        """Return one row a joint."""
        return Table.of_columns(
            {
                "joint": self.joint_names,
                "rmse, N.m": self._counted(self.rmse),
                "nrmse": self._counted(self.nrmse),
                "R2": self._counted(self.r2),
                "rows": self.rows.tolist(),
            }
        )

    def _counted(self, values: Array) -> list[float | None]:
        """Return one value a joint, None where it has no rows."""
        return [
            value if rows else None
            for value, rows in zip(values.tolist(), self.rows.tolist(), strict=True)
        ]

    def table(self) -> str:
        """Return aligned text, one line a joint."""
        return self._table().text()

    def to_dict(self) -> dict[str, object]:
        """Return the figures as plain values, without the predictions."""
        figures = {name: self._counted(getattr(self, name)) for name in ("rmse", "nrmse", "r2")}
        figures["rows"] = self.rows.tolist()
        joints = {
            joint: {name: values[j] for name, values in figures.items()}
            for j, joint in enumerate(self.joint_names)
        }
        found: dict[str, object] = plain({"relative_residual": self.relative, "joints": joints})
        return found


def validate(estimate: Estimate, samples: Samples | None = None) -> Validation:
    """Predict efforts and compare them with measured ones.

    Parameters
    ----------
    estimate : Estimate
        The parameters.
    samples : Samples, optional
        Measurements; by default those of the estimate's own problem.

    Returns
    -------
    Validation

    Raises
    ------
    DataError
        When the samples' joints are not the robot's.
    """
    problem = estimate.problem
    samples = problem.samples if samples is None else samples
    if samples.effort.shape[1] != problem.robot.n:
        raise DataError(
            f"validate: samples have {samples.effort.shape[1]} joints, the robot "
            f"'{problem.robot.name}' has {problem.robot.n}."
        )
    return _errors(problem.robot, samples, problem.predict(estimate.base, samples))


def validate_robot(robot: RobotModel, samples: Samples, *, width: float = 0.0) -> Validation:
    """Predict efforts from a robot's own description and compare them with measured ones.

    The links' inertias are those of the description. Friction is what its ``<dynamics>``
    elements say: ``damping·v + friction·sign(v)``. A joint without one has none.

    Parameters
    ----------
    robot : RobotModel
        On a fixed base.
    samples : Samples
        Measurements.
    width : float, optional
        With a positive width (rad/s), ``tanh(v / width)`` takes the place of the sign.

    Returns
    -------
    Validation

    Raises
    ------
    DataError
        When the samples' joints are not the robot's.
    ModelError
        When the description's friction is not understood.
    """
    if samples.effort.shape[1] != robot.n or robot.free_flyer:
        raise DataError(
            f"validate: samples have {samples.effort.shape[1]} joints, the robot '{robot.name}' "
            f"has {robot.n}{' with its floating base' if robot.free_flyer else ''}."
        )
    v = samples.velocity
    damping, friction = robot.described_friction()
    predicted = damping * v + friction * smooth_sign(v, width, 0.0)
    for first in range(0, len(v), _CHUNK):
        part = slice(first, first + _CHUNK)
        states = samples.position[part], v[part], samples.acceleration[part]
        predicted[part] += robot.inverse_dynamics(robot.prior, *states)
    return _errors(robot, samples, predicted)


def _errors(robot: RobotModel, samples: Samples, predicted: Array) -> Validation:
    """Return how far predicted efforts (K, n) are off on the rows that are not masked."""
    mask = np.ones(samples.effort.shape, dtype=bool) if samples.mask is None else samples.mask
    names = robot.joint_names
    rows = mask.sum(axis=0)
    error = np.where(mask, samples.effort - predicted, 0.0)
    effort = np.where(mask, samples.effort, 0.0)
    count = np.maximum(rows, 1)
    square, power = (error**2).sum(axis=0), (effort**2).sum(axis=0)
    spread = power - effort.sum(axis=0) ** 2 / count
    tiny = np.finfo(float).tiny
    # An effort that is constant up to rounding has nothing to explain.
    varies = spread > count * np.finfo(float).eps * power
    unexplained = np.where(square > 0.0, np.inf, 0.0)
    # Beside an effort that is all but zero a share may exceed what a number holds.
    with np.errstate(over="ignore"):
        np.divide(square, spread, out=unexplained, where=varies)
    return Validation(
        joint_names=names,
        effort_predicted=frozen(predicted),
        rmse=frozen(np.sqrt(square / count)),
        nrmse=frozen(np.sqrt(square) / np.sqrt(np.maximum(power, tiny))),
        r2=frozen(1.0 - unexplained),
        relative=float(np.sqrt(square.sum()) / np.sqrt(max(power.sum(), tiny))),
        rows=frozen_view(rows),
    )


def implied_error(estimate: Estimate, samples: Samples) -> Array:
    """Return the prediction error that the estimate's covariance implies, joint by joint.

    Parameters
    ----------
    estimate : Estimate
        With `covariance`.
    samples : Samples
        Where to predict; masked rows do not count.

    Returns
    -------
    ndarray, shape (n,)
        Root mean square over the rows of the standard deviation of the predicted effort, N·m.
    """
    problem = estimate.problem
    total, rows = np.zeros(problem.robot.n), np.zeros(problem.robot.n)
    factor = np.linalg.cholesky(
        estimate.covariance + np.eye(len(estimate.base)) * np.finfo(float).tiny
    )
    source = RowSource(problem.robot, problem.friction, problem.base, samples)
    for _, W, _, mask in source.chunks():
        variance = np.sum((W @ factor) ** 2, axis=2)
        total += np.where(mask, variance, 0.0).sum(axis=0)
        rows += mask.sum(axis=0)
    return np.asarray(np.sqrt(total / np.maximum(rows, 1.0)))
