"""`Rollout`: how far simulated motion leaves the measured one, model by model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid._common.tables import Shown, Table, plain_dict
from sdpid.assurance.diagnostics.motion.light_joints import LightJoint
from sdpid.assurance.rollouts.models import CLOSED_LOOP
from sdpid.assurance.rollouts.words import level_of, notes_on, verdict_on


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class MotionErrors(Shown):
    """How far one model's motion is off, at instants after many starts.

    Attributes
    ----------
    joint : ndarray, shape (S, L, n)
        Absolute errors of the free joints, rad or m; infinite where a simulation ran away.
    tip : ndarray, shape (S, H)
        Errors of the tip's position at the horizons, m; infinite where a simulation ran away. With
        one joint free at a time the root mean square over the joints.
    at : ndarray of int, shape (H,)
        The instants that are horizons.

    Examples
    --------
    >>> moved = sdpid.rollout(estimate, log, horizons=(0.1, 0.5), free="all", baselines=False)
    >>> own = moved.models["this estimate"]
    >>> own.quantile(0.9).shape, own.joints().shape, own.tips().shape
    ((2,), (2, 6), (2,))
    """

    joint: Array
    tip: Array
    at: Indices

    _facts = ("joint",)

    @property
    def overall(self) -> Array:
        """Root mean square over the joints, (S, L); a meter counts as a radian."""
        return np.asarray(np.sqrt(np.mean(np.square(self.joint), axis=2)))

    def quantile(self, share: float) -> Array:
        """Return a quantile of `overall` over the starts at the horizons, (H,), rad."""
        return _quantile(self.overall[:, self.at], share)

    def joints(self, share: float = 0.5) -> Array:
        """Return a quantile of each joint's errors at the horizons, (H, n), rad or m."""
        return _quantile(self.joint[:, self.at], share)

    def tips(self, share: float = 0.5) -> Array:
        """Return a quantile of the tip's errors at the horizons, (H,), m."""
        return _quantile(self.tip, share)

    @property
    def diverged(self) -> Array:
        """Share of the starts from which a simulation ran away before each horizon, (H,)."""
        return np.asarray(np.isinf(self.joint[:, self.at]).any(axis=2).mean(axis=0))


def _quantile(errors: Array, share: float) -> Array:
    """Return a quantile over the first axis; between a number and infinity it is infinite."""
    return np.asarray(np.quantile(errors, share, axis=0, method="higher"))


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Rollout(Shown):
    """Simulated motion under measured efforts against the measured motion.

    Attributes
    ----------
    robot : str
        Name of the robot.
    joint_names : tuple of str
        The joints that are simulated.
    sliding : ndarray of bool, shape (n,)
        Which of them slide: their errors are in m, mm in tables.
    free : str
        ``"all"``: all at once; ``"closed loop"``: all, under a controller; ``"each"``: one at a
        time, the others on the record; or the names of those that are free
        together.
    horizons : tuple of float
        Times after the start at which errors are told, s.
    time : ndarray, shape (L,)
        All times after the start at which errors are known, s; the horizons are among them.
    start : ndarray, shape (S,)
        Times at which the simulations start, s.
    own : str
        Name of the model that is judged, such as ``"this estimate"``.
    models : dict of str to MotionErrors
        That one, then what stands beside it.
    light : tuple of LightJoint
        Joints whose own inertia is too small for its effort error.
    said : tuple of str
        What was done.

    Examples
    --------
    >>> moved = sdpid.rollout(estimate, log, horizons=(0.1, 0.5), baselines=False)
    >>> moved.horizons, moved.models["this estimate"].joint.shape[2]
    ((0.1, 0.5), 6)
    >>> moved.diverged
    array([0., 0.])
    """

    robot: str
    joint_names: tuple[str, ...]
    sliding: Mask
    free: str
    horizons: tuple[float, ...]
    time: Array
    start: Array
    own: str
    models: Mapping[str, MotionErrors]
    light: tuple[LightJoint, ...] = ()
    said: tuple[str, ...] = ()

    _facts = ("robot", "joint_names", "start", "median, rad", "verdict")

    def _tables(self) -> Iterator[Table]:
        yield self.as_table()
        yield self.joint_table()

    @property
    def median(self) -> Array:
        """Median over the starts of the estimate's error at the horizons, (H,), rad.

        Of the root mean square over the joints; infinite where half of the simulations ran away.
        """
        return self.models[self.own].quantile(0.5)

    @property
    def medians(self) -> dict[str, Array]:
        """Of each model, the median over the starts at all times, (L,), rad."""
        return {name: _quantile(errors.overall, 0.5) for name, errors in self.models.items()}

    @property
    def diverged(self) -> Array:
        """Share of the estimate's simulations that ran away before each horizon, (H,)."""
        return self.models[self.own].diverged

    @property
    def verdict(self) -> str:
        """What it says, in a sentence."""
        return verdict_on(self)

    @property
    def level(self) -> Literal["good", "caution", "bad"]:
        """What `verdict` means for the model."""
        return level_of(self)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done, and what to know about the numbers."""
        return (*self.said, *notes_on(self))

    def as_table(self) -> Table:
        """Return a row a model, with four columns a horizon.

        Median and 90 % quantile of the joints' error over the starts, median of the tip's, and the
        share of starts from which it ran away.
        """
        header = ["model"]
        for horizon in self.horizons:
            named = ("mrad", "90 %", "tip, mm", "away, %")
            header += [f"{horizon:g} s: {each}" for each in named]
        rows = []
        for name, errors in self.models.items():
            row: list[object] = [name]
            columns = errors.quantile(0.5), errors.quantile(0.9), errors.tips(), errors.diverged
            for middle, high, tip, gone in zip(*(c.tolist() for c in columns), strict=True):
                row += [1e3 * middle, 1e3 * high, 1e3 * tip, 100.0 * gone]
            rows.append(tuple(row))
        return Table(tuple(header), tuple(rows))

    def joint_table(self) -> Table:
        """Return a row a joint: median (and 90 %) of the estimate's error at each horizon."""
        columns: dict[str, list[Any]] = {"joint": list(self.joint_names)}
        middle, high = self.models[self.own].joints(0.5), self.models[self.own].joints(0.9)
        if self.sliding.any():
            columns["unit"] = ["mm" if slides else "mrad" for slides in self.sliding]
        for k, horizon in enumerate(self.horizons):
            columns[f"{horizon:g} s"] = (1e3 * middle[k]).tolist()
            columns[f"{horizon:g} s, 90 %"] = (1e3 * high[k]).tolist()
        return Table.of_columns(columns)

    def table(self) -> str:
        """Return aligned text: the models, then the estimate joint by joint.

        A dash stands for what ran away.
        """
        unit = "mrad, mm of sliding joints" if self.sliding.any() else "mrad"
        return (
            f"position errors in {_free_words(self)}: median over {len(self.start)} "
            f"starts\n{self.as_table().text(3)}\n\n{self.own} joint by joint, {unit}\n"
            f"{self.joint_table().text(3)}"
        )

    def to_frame(self) -> Any:
        """Return a pandas DataFrame, one row a model, joint and horizon.

        Columns are ``model``, ``joint``, ``horizon`` (s), ``median``, ``p90`` (rad or m, infinite
        for what ran away) and ``diverged`` (share).
        """
        import pandas

        rows = [
            (name, joint, horizon, middle[k, j], high[k, j], gone[k, j])
            for name, errors in self.models.items()
            for middle, high, gone in [(errors.joints(), errors.joints(0.9), _gone(errors))]
            for j, joint in enumerate(self.joint_names)
            for k, horizon in enumerate(self.horizons)
        ]
        names = ["model", "joint", "horizon", "median", "p90", "diverged"]
        return pandas.DataFrame(rows, columns=names)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; what ran away is null."""
        content = {
            "free": self.free,
            "horizons": self.horizons,
            "starts": len(self.start),
            "joints": self.joint_names,
            "models": {
                name: {
                    "median": errors.quantile(0.5),
                    "p90": errors.quantile(0.9),
                    "tip": errors.tips(),
                    "diverged": errors.diverged,
                    "joints": errors.joints(),
                }
                for name, errors in self.models.items()
            },
            "light_joints": [each.joint for each in self.light],
            "verdict": self.verdict,
            "notes": self.notes,
        }
        return plain_dict(content)

    def plot(self, *, title: str | None = None, axes: Any = None) -> Any:
        """Show the median error of every model over the time since the start (extra ``plot``).

        Parameters
        ----------
        title : str, optional
            Heading of the figure.
        axes : matplotlib.axes.Axes, optional
            Where to draw; by default in a figure of its own.

        Returns
        -------
        matplotlib.axes.Axes
        """
        from sdpid.plots.motion import plot_rollout

        return plot_rollout(self.time, self.medians, own=self.own, title=title, axes=axes)


def _gone(errors: MotionErrors) -> Array:
    """Return the share of simulations that ran away, of each joint, (H, n)."""
    return np.asarray(np.isinf(errors.joint[:, errors.at]).mean(axis=0))


def _free_words(rollout: Rollout) -> str:
    if rollout.free == CLOSED_LOOP:
        return CLOSED_LOOP
    if rollout.free == "each":
        return "open loop, one joint free at a time, the others on the record"
    return f"open loop, {'all joints free' if rollout.free == 'all' else f'free: {rollout.free}'}"
