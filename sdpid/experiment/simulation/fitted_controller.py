"""`FittedController`: gains that a log shows, how well, and whether they may be used."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.tables import Table, facts_html, plain
from sdpid.errors import DataError
from sdpid.experiment.simulation.law import Controller


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class FittedController:
    """A controller's gains as a log shows them, with their errors.

    Attributes
    ----------
    kind : str
        Kind of the controller: ``"p"``, ``"pd"``, ``"pid"`` or ``"computed_torque"``.
    joint_names : tuple of str
        The joints.
    gains : mapping of str to ndarray, shape (n,)
        By their names in the controller's class.
    deviations : mapping of str to ndarray, shape (n,)
        Standard deviations over the gains, from blocks of residuals.
    bias : ndarray, shape (n,)
        How much of a gain noise of the positions may take at most, as a part of it, where the
        controller did not see that noise.
    r_squared : ndarray, shape (n,)
        Part of the efforts' variance that the controller explains.
    offset : ndarray, shape (n,)
        Constant effort beside the controller's, N·m (N).
    delay : float
        By how much the efforts are later than the law, s; zero where the log shows none.
    feedforward : bool
        Whether the reference's velocity is in the law.
    method : str
        ``"least_squares"``, or ``"instrumental"`` where noise would bias it.
    cutoff_hz : float
        Cut-off of the filter that all signals passed.
    reasons : tuple of str
        Why the controller is not to be used; empty where it is.
    controller : Controller or None
        Of `sdpid.controllers`; None where gains are not positive.

    Examples
    --------
    >>> run = sdpid.simulate(robot, motion, seed=1)
    >>> fitted = sdpid.controllers.fit_controller(run, "p")
    >>> fitted.usable, fitted.kind, fitted.feedforward
    (True, 'p', False)
    >>> fitted.controller
    P(6 joints, proportional_gain 1.28... to 4.47..., velocity_gain ...)
    """

    kind: str
    joint_names: tuple[str, ...]
    gains: Mapping[str, Array]
    deviations: Mapping[str, Array]
    bias: Array
    r_squared: Array
    offset: Array
    delay: float
    feedforward: bool
    method: str
    cutoff_hz: float
    reasons: tuple[str, ...]
    controller: Controller | None

    @property
    def usable(self) -> bool:
        """Whether gains are known well enough to simulate with, and explain the efforts."""
        return not self.reasons

    def require(self) -> Controller:
        """Return the controller.

        Raises
        ------
        DataError
            When it is not usable, with the reasons.
        """
        if self.reasons or self.controller is None:
            raise DataError(
                f"the controller is not known well enough: {'; '.join(self.reasons)}. Give it, as "
                "one of sdpid.controllers, or use a method that needs none."
            )
        return self.controller

    def table(self) -> Table:
        """Return one row a joint: gains, their deviations in percent, what is explained."""
        columns: dict[str, list[Any]] = {"joint": list(self.joint_names)}
        for name, values in self.gains.items():
            columns[name] = values.tolist()
            columns[f"{name}, deviation %"] = (100.0 * self.deviations[name]).tolist()
        columns["unexplained %"] = (100.0 * (1.0 - self.r_squared)).tolist()
        return Table.of_columns(columns)

    def describe(self) -> str:
        """Return gains and errors as a table, and what they may be used for."""
        law = f"{self.kind}, {'with' if self.feedforward else 'without'} feedforward of velocity"
        delay = f", delay {1e3 * self.delay:.3g} ms" if self.delay else ""
        verdict = "usable" if self.usable else "not usable: " + "; ".join(self.reasons)
        return "\n".join([f"controller {law}{delay}", self.table().text(4), verdict])

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        values = {**vars(self), "gains": dict(self.gains), "deviations": dict(self.deviations)}
        del values["controller"]
        found: dict[str, Any] = plain({**values, "usable": self.usable})
        return found

    def __repr__(self) -> str:
        worst = max(float(np.max(each)) for key, each in self.deviations.items() if key != "ki")
        least = float(self.r_squared.min())
        said = "usable" if self.usable else "not usable"
        return (
            f"FittedController({self.kind}, {len(self.joint_names)} joints, {said}, deviations to "
            f"{100.0 * worst:.2g} %, R² from {least:.3g})"
        )

    def _repr_html_(self) -> str:
        facts: dict[str, object] = {
            "kind": self.kind,
            "usable": self.usable,
            "reasons": "; ".join(self.reasons) or None,
            "feedforward": self.feedforward,
            "delay, ms": 1e3 * self.delay,
            "method": self.method,
            "cutoff, Hz": self.cutoff_hz,
        }
        return facts_html("FittedController", facts, self.table())
