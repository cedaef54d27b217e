"""Compare predicted with measured efforts, on the estimate's own rows or on fresh ones."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask, frozen, frozen_view
from sdpid._common.tables import Shown, Table, plain_dict
from sdpid.assurance.diagnostics.bands import effort_band
from sdpid.assurance.diagnostics.described import described_dynamics, predicted_efforts
from sdpid.assurance.diagnostics.rest import moving_and_resting
from sdpid.errors import DataError
from sdpid.estimation.compression.contact_noise import prediction_noise
from sdpid.estimation.compression.covariance import pooled
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.whitening import with_contact_forces
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem
from sdpid.experiment.inspection.inspect import kinds_accepted
from sdpid.experiment.preparation.prepare import (
    Logs,
    ProcessingOf,
    joints_without,
    prepare,
    without_efforts,
)
from sdpid.experiment.processing.robot_contacts import base_held
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.processing.settings import Processing
from sdpid.robot.model.base_parameters import structural_base
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.robot.model.model import RobotModel

Kind = TypeVar("Kind", bound="Errors")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Errors(Shown):
    """Prediction errors, joint by joint, on some of the rows.

    Attributes
    ----------
    joint_names : tuple of str
        The joints.
    rmse : ndarray, shape (n,)
        Root mean square error, N·m.
    nrmse : ndarray, shape (n,)
        Root mean square error over root mean square effort; infinite beside no effort at all, as
        of a joint without a motor, and None or "no effort" where it is told.
    r2 : ndarray, shape (n,)
        Share of the effort's variance that is explained; minus infinity there.
    relative : float
        Norm of all errors over the norm of all efforts.
    rows : ndarray of int, shape (n,)
        Rows that count. Where there are none, of a joint whose effort was not measured,
        the joint's figures say nothing: `rmse` and `nrmse` are 0, `r2` is 1.
    n_base : int
        The first of these are coordinates of a floating base, which are no joints: they have no
        rows here, and stand in no table.
    """

    joint_names: tuple[str, ...]
    rmse: Array
    nrmse: Array
    r2: Array
    relative: float
    rows: Indices
    n_base: int = 0

    _facts = ("relative",)

    @classmethod
    def of(
        cls: type[Kind],
        names: tuple[str, ...],
        effort: Array,
        predicted: Array,
        mask: Mask,
        n_base: int = 0,
        **more: Any,
    ) -> Kind:
        """Return how far predicted efforts (K, n) are off on the rows in a mask (K, n)."""
        # Newtons and newton meters that no motor makes are no joint's errors.
        mask = mask & (np.arange(len(names)) >= n_base)
        rows, tiny = mask.sum(axis=0), np.finfo(float).tiny
        error, effort = (np.where(mask, each, 0.0) for each in (effort - predicted, effort))
        count = np.maximum(rows, 1)
        square, power = (error**2).sum(axis=0), (effort**2).sum(axis=0)
        spread = power - effort.sum(axis=0) ** 2 / count
        # An effort that is constant up to rounding has nothing to explain.
        varies = spread > count * np.finfo(float).eps * power
        unexplained = np.where(square > 0.0, np.inf, 0.0)
        # Beside an effort that is all but zero a share may exceed what a number holds.
        with np.errstate(over="ignore"):
            np.divide(square, spread, out=unexplained, where=varies)
        share = np.sqrt(square) / np.sqrt(np.maximum(power, tiny))
        return cls(
            joint_names=names,
            rmse=frozen(np.sqrt(square / count)),
            nrmse=frozen(np.where((square > 0.0) & (power == 0.0), np.inf, share)),
            r2=frozen(1.0 - unexplained),
            relative=float(np.sqrt(square.sum()) / np.sqrt(max(power.sum(), tiny))),
            rows=frozen_view(rows),
            n_base=n_base,
            **more,
        )

    def _tables(self) -> Iterator[Table]:
        """Yield one row a joint."""
        columns: dict[str, Sequence[object]] = {
            "joint": self.joint_names,
            "rmse, N.m": self._counted(self.rmse),
            "nrmse": self._counted(self.nrmse),
            "R2": self._counted(self.r2),
            "rows": self.rows.tolist(),
        }
        yield Table.of_columns({name: each[self.n_base :] for name, each in columns.items()})

    def _counted(self, values: Array) -> list[float | None]:
        """Return one value a joint, None where it has no rows."""
        counted = zip(values.tolist(), self.rows.tolist(), strict=True)
        return [value if rows else None for value, rows in counted]

    def table(self) -> str:
        """Return aligned text, one line a joint."""
        return next(self._tables()).text()

    def to_dict(self) -> dict[str, object]:
        """Return the figures as plain values."""
        figures = [self._counted(each) for each in (self.rmse, self.nrmse, self.r2)]
        every = list(zip(self.joint_names, *figures, self.rows.tolist(), strict=True))
        told = ("rmse", "nrmse", "r2", "rows")
        joints = {name: dict(zip(told, own, strict=True)) for name, *own in every[self.n_base :]}
        return plain_dict({"relative_residual": self.relative, "joints": joints})


@dataclass(frozen=True, kw_only=True, eq=False)
class BaseErrors:
    """What the equations of a floating base, which nothing drives, are off by.

    Attributes
    ----------
    force : float
        Root mean square of the length of the force that is missing, N.
    torque : float
        The same of the torque, N·m.
    samples : int
        Samples that count.
    """

    force: float
    torque: float
    samples: int

    @classmethod
    def of(cls, effort: Array, predicted: Array, mask: Mask) -> BaseErrors | None:
        """Return the errors of the first six columns where all six count; None without any."""
        whole = mask[:, :6].all(axis=1)
        if not whole.any():
            return None
        square = np.mean((effort - predicted)[whole, :6] ** 2, axis=0)
        force, torque = np.sqrt(square[:3].sum()), np.sqrt(square[3:].sum())
        count = int(np.count_nonzero(whole))
        return cls(force=float(force), torque=float(torque), samples=count)

    def to_dict(self) -> dict[str, object]:
        """Return plain values."""
        return plain_dict(vars(self))

    @property
    def rows(self) -> tuple[tuple[str, float], ...]:
        """What is told of the base beside the joints, units included, and its size."""
        return ("base, force in N", self.force), ("base, torque", self.torque)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Validation(Errors):
    """Predicted efforts, and their errors on the rows that are not masked.

    Attributes
    ----------
    joint_names : tuple of str
        The joints.
    rmse : ndarray, shape (n,)
        Root mean square error, N·m.
    nrmse : ndarray, shape (n,)
        Root mean square error over root mean square effort; infinite beside no effort at all, as
        of a joint without a motor, and None or "no effort" where it is told.
    r2 : ndarray, shape (n,)
        Share of the effort's variance that is explained; minus infinity there.
    relative : float
        Norm of all errors over the norm of all efforts.
    rows : ndarray of int, shape (n,)
        Rows that count. Where there are none, of a joint whose effort was not measured, the
        joint's figures say nothing: `rmse` and `nrmse` are 0, `r2` is 1.
    effort_predicted : ndarray, shape (K, n)
        Predicted efforts at every sample, masked ones included, N·m.
    moving : Errors
        The same figures on the rows in which the joint moves, those around reversals that are
        masked for slowness included.
    resting : Errors or None
        The same on the rows in which the joint rests, masked for slowness or not: stiction, which
        no function of the velocity explains. None where no joint with an effort rests.
    floating : BaseErrors or None
        Of a floating base: forces and torques that the base's equations miss. Its six rows do not
        count among the joints'. Contact forces that were not measured are those that leave the
        least error, so that errors are smaller than with forces that one knew. Samples in which
        the base is held by what measures nothing do not count; None where it always is.
    slides : ndarray of bool, shape (n,)
        Which joints slide: their speeds are in m/s.

    Examples
    --------
    >>> errors = sdpid.validate(estimate, samples)
    >>> errors.joint_names[0], errors.rmse.round(1), errors.r2.round(3)
    ('joint_1', array([0.2, 0.3, 0.1, 0.1, 0.1, 0.1]), array([1., 1., 1., 1., 1., 1.]))
    >>> errors.effort_predicted.shape, errors.effort_band.shape
    ((1000, 6), (1000, 6))
    """

    effort_predicted: Array
    slides: Mask
    moving: Errors
    resting: Errors | None = None
    floating: BaseErrors | None = None
    _estimate: Estimate | None = field(default=None, repr=False)
    _samples: Samples | None = field(default=None, repr=False)

    @classmethod
    def of_prediction(
        cls, robot: RobotModel, samples: Samples, predicted: Array, estimate: Estimate | None = None
    ) -> Validation:
        """Return the errors of predicted efforts (K, n) of samples, by an estimate or not.

        Of a floating base, samples in which it is held do not count.
        """
        effort, used, names, first = samples.effort, samples.used, robot.joint_names, robot.n_base
        moving, still = moving_and_resting(samples, robot.slides)
        # Joints without motors have no effort to compare with, at rest as in motion.
        rests = bool(np.any(effort[:, first:][still[:, first:]]))
        free = used & ~base_held(robot, samples)[:, None]
        return cls.of(
            names,
            effort,
            predicted,
            used,
            first,
            effort_predicted=frozen(predicted),
            moving=Errors.of(names, effort, predicted, moving, first),
            resting=Errors.of(names, effort, predicted, still, first) if rests else None,
            floating=BaseErrors.of(effort, predicted, free) if first else None,
            slides=robot.slides,
            _estimate=estimate,
            _samples=samples,
        )

    @property
    def told(self) -> Errors:
        """The errors that terminal, report and files tell: in motion; all, if nothing moves."""
        return self.moving if self.moving.rows.any() else self

    def _tables(self) -> Iterator[Table]:
        """Yield one row a joint, and two for a floating base."""
        (joints,), base = super()._tables(), self.floating
        rows = joints.rows
        if base is not None:
            rows += tuple((name, size, None, None, base.samples) for name, size in base.rows)
        yield Table(joints.header, rows)

    @cached_property
    def effort_band(self) -> Array | None:
        """Half-width (K, n) of the 95 % band about `effort_predicted`, N·m.

        See `sdpid.assurance.diagnostics.bands`. None for the prediction of a description, which
        tells nothing of its errors.
        """
        if self._estimate is None or self._samples is None:
            return None
        return effort_band(self._estimate, self._samples)

    def plot(self, *, count: int | None = None, title: str | None = None, axes: Any = None) -> Any:
        """Show measured against predicted effort, joint by joint, with the errors beside.

        Needs the extra ``plot``.

        Parameters
        ----------
        count : int, optional
            Draw the first samples only, so that curves can be told apart.
        title : str, optional
            Heading of the figure.
        axes : array of matplotlib.axes.Axes, shape (n, 2), optional
            Where to draw; by default in a figure of its own.

        Returns
        -------
        ndarray of matplotlib.axes.Axes, shape (n, 2)
            Of efforts, and of errors.

        Raises
        ------
        DataError
            When the measurements are not here.
        """
        from sdpid.plots.reconstruction import plot_fit

        if self._samples is None:
            raise DataError("plot: this validation has no samples; call sdpid.validate.")
        return plot_fit(self._samples, self, count=count, title=title, axes=axes)

    def to_dict(self) -> dict[str, object]:
        """Return the figures as plain values, without the predictions."""
        floating = {} if self.floating is None else {"floating": self.floating.to_dict()}
        resting = None if self.resting is None else self.resting.to_dict()
        moving = self.moving.to_dict()
        return {**super().to_dict(), "moving": moving, "resting": resting, **floating}


def validate(
    estimate: Estimate,
    samples: Samples | Logs | None = None,
    *,
    without_effort: Iterable[str] = (),
    processing: ProcessingOf = None,
    accept: str | Iterable[str] = (),
) -> Validation:
    """Predict efforts and compare them with measured ones.

    Parameters
    ----------
    estimate : Estimate
        The parameters.
    samples : Samples, Recording or path, or a sequence of these, optional
        Measurements; by default those of the estimate's own problem. Recordings and files are
        inspected and processed as by `identify`.
    without_effort : iterable of str, optional
        Joints whose effort was not measured, or is wrong: it is predicted and not compared.
    processing : Processing or mapping, optional
        As of `identify`, for recordings and files.
    accept : iterable of str, optional
        As of `identify`, for recordings and files.

    Returns
    -------
    Validation

    Raises
    ------
    DataError
        When the samples' joints are not the robot's, a joint without effort is not one, or a
        recording cannot be used.

    Examples
    --------
    >>> errors = sdpid.validate(estimate, samples)
    >>> errors.rmse.round(2)
    array([0.23, 0.31, 0.15, 0.12, 0.12, 0.11])
    >>> round(100.0 * errors.relative, 2)
    0.13
    >>> errors.effort_predicted.shape
    (1000, 6)
    """
    problem, without = estimate.problem, joints_without(without_effort)
    if samples is None:
        samples = problem.samples
    elif not isinstance(samples, Samples):
        # Prediction needs no covariance: any number of periods will do.
        if isinstance(processing, Processing):
            processing = replace(processing, covariance=None)
        else:
            processing = {**(processing or {}), "covariance": None}
        prepared = prepare(
            problem.robot,
            samples,
            processing,
            without_effort=without,
            accept=kinds_accepted(accept),
            name="validation",
        )
        samples = prepared.samples
    _require_joints(samples, problem.robot)
    if without:
        samples = without_efforts(samples, problem.robot, without)
    predicted = problem.predict(estimate.base, samples)
    return Validation.of_prediction(problem.robot, samples, predicted, estimate)


def validate_robot(robot: RobotModel, samples: Samples) -> Validation:
    """Predict efforts from a robot's own description and compare them with measured ones.

    The links' inertias are those of the description. Friction is what its ``<dynamics>``
    elements say: ``damping·v + friction·sign(v)``. A joint without one has none.

    Parameters
    ----------
    robot : RobotModel
        On a fixed base or a floating one.
    samples : Samples
        Measurements. Where they are no average of periods, a narrow tanh takes the place of the
        sign. Forces of contacts that were not measured are those that leave the least error.

    Returns
    -------
    Validation

    Raises
    ------
    DataError
        When the samples' joints are not the robot's.
    """
    _require_joints(samples, robot)
    return validate_dynamics(described_dynamics(robot, samples), samples)


def validate_dynamics(
    model: RobotDynamics, samples: Samples, problem: Problem | None = None
) -> Validation:
    """Predict efforts with the parameters of a model and compare them with measured ones.

    What forces of contacts explain is weighed as in `problem`, or else as its own errors ask for.
    """
    robot, predicted = model.robot, predicted_efforts(model, samples)
    if samples.contacts is not None:
        if problem is None:
            base = structural_base(robot, model.terms)
            rows = RowSource(robot, model.terms, base, samples.judged)
            sigma = np.diag(prediction_noise(rows, predicted))
        else:
            rows, sigma = problem.rows_of(samples), pooled(problem.sigma)
        predicted = np.concatenate(
            [with_contact_forces(rows, part, sigma, predicted[part]) for part in rows.parts()]
        )
    return Validation.of_prediction(robot, samples, predicted)


def _require_joints(samples: Samples, robot: RobotModel) -> None:
    if samples.effort.shape[1] != robot.n:
        raise DataError(
            f"validate: samples have {samples.effort.shape[1]} joints, the robot '{robot.name}' "
            f"has {robot.n}."
        )
