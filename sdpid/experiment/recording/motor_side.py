"""From the motors' side to the joints' side: gears, signs, offsets, and coupled joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, real_array, shaped
from sdpid._common.files import require_known
from sdpid._common.tables import Settings
from sdpid.errors import DataError

# Beyond this condition number (columns scaled) a matrix of gear ratios is a mistake: real ones
# differ from a diagonal by a coupling or two.
_MOST_CONDITION = 1e6
_QUANTITIES = ("position", "velocity", "effort", "reference")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class MotorSide(Settings):
    """Gears, signs, offsets and couplings that convert motor-side logs to the joints.

    With the matrix R of motor turns a joint turn, joint positions are
    ``inv(R) @ motor_position + offsets`` (references too), velocities ``inv(R) @ motor_velocity``,
    and efforts ``T @ (torque_constants * motor_effort)``. Equal power on both sides makes T the
    transpose of R, which is the default. Joints that are coupled at their motors have entries off
    the diagonal.

    Parameters
    ----------
    position_matrix : (n, n) array_like
        R, signs included. For plain gears `from_gears`.
    effort_matrix : (n, n) array_like, optional
        T, where it is not the transpose of R.
    offsets : (n,) array_like, optional
        Joint position in rad (m) where the motors read zero.
    torque_constants : (n,) array_like, optional
        Motor torque in N·m per A, where efforts are logged as currents.
    applies_to : tuple of str
        Which quantities are on the motors' side; the others are on the joints' side already.

    Raises
    ------
    DataError
        When shapes do not agree, or the matrix cannot be inverted.

    Examples
    --------
    >>> side = sdpid.MotorSide.from_gears([100.0, 50.0], signs=[1, -1])
    >>> side.to_joints("position", np.array([[100.0, 100.0]]))
    array([[ 1., -2.]])
    >>> side.to_joints("effort", np.array([[0.1, 0.1]]))
    array([[10., -5.]])
    """

    position_matrix: Array
    effort_matrix: Array | None = None
    offsets: Array | None = None
    torque_constants: Array | None = None
    applies_to: tuple[str, ...] = _QUANTITIES

    def __post_init__(self) -> None:
        n = len(np.atleast_1d(np.asarray(self.position_matrix, dtype=object)))
        axes = {"position_matrix": 2, "effort_matrix": 2, "offsets": 1, "torque_constants": 1}
        for name, ndim in axes.items():
            if (value := getattr(self, name)) is None:
                continue
            what = ": position_matrix has a row for each joint"
            array = shaped(value, f"motors.{name}", (max(n, 1),) * ndim, what)
            object.__setattr__(self, name, array)
            size = np.abs(array).max(axis=0)
            if ndim == 2 and not (size.all() and np.linalg.cond(array / size) <= _MOST_CONDITION):
                raise DataError(f"motors.{name}: cannot be inverted: {array.tolist()}.")
        applies: Any = self.applies_to
        known = isinstance(applies, (list, tuple)) and all(each in _QUANTITIES for each in applies)
        if not known:
            raise DataError(
                f"motors.applies_to: is {applies!r}, expected some of {', '.join(_QUANTITIES)}."
            )
        object.__setattr__(self, "applies_to", tuple(applies))
        if self.torque_constants is not None and "effort" not in applies:
            raise DataError("motors.torque_constants: needs effort in applies_to.")

    @classmethod
    def from_gears(cls, ratios: Any, signs: Any = None, **others: Any) -> MotorSide:
        """Return the side of motors that each drive one joint through a gear.

        Parameters
        ----------
        ratios : (n,) array_like
            Motor turns a joint turn.
        signs : (n,) array_like, optional
            1 or -1: whether motor and joint turn the same way.
        **others : optional
            As in `MotorSide`.
        """
        gears = real_array(ratios, "motors.gear_ratios", ndim=1)
        ways = np.ones_like(gears) if signs is None else real_array(signs, "motors.signs", ndim=1)
        if ways.shape != gears.shape or not np.all(np.abs(ways) == 1.0):
            raise DataError(
                f"motors.signs: is {ways.tolist()}, expected 1 or -1 for each of "
                f"{gears.size} motors."
            )
        return cls(position_matrix=np.diag(gears * ways), **others)

    @classmethod
    def from_mapping(cls, given: Mapping[str, Any]) -> MotorSide:
        """Return the motor side that a table ``[motors]`` describes.

        Keys are ``gear_ratios`` (and ``signs``) or ``position_matrix``, and ``effort_matrix``,
        ``offsets``, ``torque_constants``, ``applies_to``.
        """
        gears = {key: given[key] for key in ("gear_ratios", "signs") if key in given}
        others = {key: value for key, value in given.items() if key not in gears}
        known = ["gear_ratios", "signs", *(each.name for each in fields(cls))]
        require_known(given, known, "motors")
        if ("position_matrix" in given) == bool(gears) or gears.keys() == {"signs"}:
            raise DataError(
                "motors: give either gear_ratios (and signs) or position_matrix, which has signs."
            )
        if not gears:
            return cls(**others)
        return cls.from_gears(gears["gear_ratios"], gears.get("signs"), **others)

    @property
    def n(self) -> int:
        """Number of joints, as many as motors."""
        return int(self.position_matrix.shape[0])

    def to_joints(self, quantity: str, values: Array) -> Array:
        """Convert samples × motors to samples × joints.

        Raises
        ------
        DataError
            When there is another number of columns.
        """
        if quantity not in self.applies_to:
            return values
        if values.ndim != 2 or values.shape[1] != self.n:
            raise DataError(
                f"{quantity}: has shape {values.shape}, motors is for {self.n} columns."
            )
        if quantity == "effort":
            turned = self.position_matrix.T if self.effort_matrix is None else self.effort_matrix
            if self.torque_constants is not None:
                turned = turned * self.torque_constants
            return np.ascontiguousarray(values @ turned.T)
        joints = np.ascontiguousarray(values @ np.linalg.inv(self.position_matrix).T)
        if quantity in ("position", "reference") and self.offsets is not None:
            joints += self.offsets
        return joints
