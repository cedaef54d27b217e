"""`Rollout`: how far simulated motion leaves the measured one, model by model, and in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid._common.tables import Shown, Table, plain_dict
from sdpid.assurance.diagnostics.held_out import DESCRIPTION, FRICTION_FITTED, LEAST_SQUARES
from sdpid.assurance.diagnostics.light_joints import LightJoint

# What takes the place of the joints that are free.
CLOSED_LOOP = "closed loop"

# What needs no model.
CONSTANT_VELOCITY, STAND_STILL, FLOOR = "constant velocity", "stand still", "noise alone"

# What the reference itself is called, beside the models.
REFERENCE = "reference followed exactly"

# The verdict is on the first horizon from here on, s: before, a motion is mostly its own start, and
# what holds its velocity beats the models of most arms (docs/evidence/rollouts.md).
_JUDGED = 0.3

# Another model does better where its error is below this share of the estimate's: medians over some
# 40 starts differ by a tenth between models that are equally good.
_BETTER = 0.9

# A floor below this, rad, is none: encoders of arms have at most some 24 bits a turn, and noise
# that a simulation does not magnify. The recording was smoothed before it was logged.
_SMOOTHED = 1e-6


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
    def _judged(self) -> tuple[int, float, dict[str, float], list[str]]:
        """The horizon judged, the estimate's median there, others', and which of them are better.

        Better than the estimate are models of the robot, by a tenth.
        """
        k = next((k for k, h in enumerate(self.horizons) if h >= _JUDGED), len(self.horizons) - 1)
        others = {name: float(each.quantile(0.5)[k]) for name, each in self.models.items()}
        own = others.pop(self.own)
        better = [name for name, value in others.items() if value < _BETTER * own]
        return k, own, others, better

    @property
    def verdict(self) -> str:
        """What it says, in a sentence: how far it is off, and what does better or worse."""
        k, own, others, better = self._judged
        horizon, diverged = f"{self.horizons[k]:g} s", self.diverged[k]
        loop = CLOSED_LOOP if self.free == CLOSED_LOOP else "open loop"
        hidden = (DESCRIPTION, REFERENCE, *(FLOOR,) * (others.get(FLOOR, 1.0) < _SMOOTHED))
        told = [f"{name} {_angle(off)}" for name, off in others.items() if name not in hidden]
        beside = f"; {', '.join(told)}" if told else ""
        if not np.isfinite(own):
            return (
                f"Simulated in {loop} it runs away: within {horizon} from {diverged:.0%} of the "
                f"starts{beside}."
            )
        models = [each for each in better if each in (DESCRIPTION, FRICTION_FITTED, LEAST_SQUARES)]
        head = "It moves as the robot does"
        if self.level == "bad":
            head = "It does not move as the robot does"
        elif models:
            head = f"It moves less like the robot than {' and '.join(models)}"
        return f"{head}: after {horizon} in {loop} it is off by {_angle(own)}{beside}."

    @property
    def level(self) -> Literal["good", "caution", "bad"]:
        """What `verdict` means: bad where it runs away or does no better than no model."""
        _, own, others, better = self._judged
        if own >= min(others.get(name, np.inf) for name in (CONSTANT_VELOCITY, STAND_STILL)):
            return "bad"
        return "caution" if any(name != FLOOR for name in better) else "good"

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done, and what to know about the numbers."""
        gone, still, floor = (self.diverged[-1], *map(self.models.get, (CONSTANT_VELOCITY, FLOOR)))
        notes = []
        if self.horizons[0] < _JUDGED and still is not None:
            held, own = (
                f"is off by {_angle(value)}" if np.isfinite(value) else "runs away"
                for value in (float(still.quantile(0.5)[0]), float(self.median[0]))
            )
            notes.append(
                f"never judge at {self.horizons[0]:g} s alone: holding the starting velocity, "
                f"without any model, {held} there, {self.own} {own}"
            )
        if floor is not None and floor.quantile(0.5)[-1] < _SMOOTHED:
            notes.append(
                "the floor of noise is not known: nothing is left of it at high frequencies, as in "
                "a recording that was smoothed before it was logged"
            )
        if gone > 0.0:
            notes.append(
                f"{gone:.0%} of the starts ran away before {self.horizons[-1]:g} s: an arm under "
                "given efforts has nothing that brings it back, so that errors grow with time even "
                "for a good model"
            )
        notes += [each.words for each in self.light]
        if self.light:
            remedy = max(self.light, key=lambda each: each.ratio).remedy
            several = f" ({len(self.light)} joints, this one the worst)"
            notes.append(remedy + several if len(self.light) > 1 else remedy)
        return (*self.said, *notes)

    def as_table(self) -> Table:
        """Return a row a model, with four columns a horizon.

        Median and 90 % quantile of the joints' error over the starts, median of the tip's, and the
        share of starts from which it ran away.
        """
        header = ["model"]
        for horizon in self.horizons:
            header += [f"{horizon:g} s: {each}" for each in ("mrad", "90 %", "tip, mm", "away, %")]
        rows = []
        for name, errors in self.models.items():
            lengths = 1e3 * np.array([errors.quantile(0.5), errors.quantile(0.9), errors.tips()])
            row = np.vstack([lengths, 100.0 * errors.diverged])
            rows.append((name, *row.T.ravel().tolist()))
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
        loop = {
            CLOSED_LOOP: CLOSED_LOOP,
            "each": "open loop, one joint free at a time, the others on the record",
            "all": "open loop, all joints free",
        }.get(self.free, f"open loop, free: {self.free}")
        return (
            f"position errors in {loop}: median over {len(self.start)} "
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
            for middle, high in [(errors.joints(), errors.joints(0.9))]
            for gone in [np.isinf(errors.joint[:, errors.at]).mean(axis=0)]
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


def _angle(value: float) -> str:
    return f"{1e3 * value:.3g} mrad" if np.isfinite(value) else "runs away"
