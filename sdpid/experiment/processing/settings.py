"""`Processing`: the settings of `process`, with their defaults and reasons."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any, Literal, get_args

import numpy as np

from sdpid._common.arrays import Array, is_number
from sdpid._common.tables import Settings
from sdpid.errors import DataError
from sdpid.experiment.processing.filters import (
    Derivative,
    FilterType,
    Weights,
    ZeroPhaseFilter,
    low_pass,
    stencil,
)
from sdpid.experiment.recording.gaps import Timing
from sdpid.experiment.recording.recording import Recording

# What accelerations of a floating base are from.
BaseSource = Literal["auto", "imu", "twist", "pose"]
_UNITS = {"position": "rad", "torque": "N·m", "velocity": "rad/s", "acceleration": "rad/s²"}


@dataclass(frozen=True, eq=False)
class Stages:
    """Signals of one joint in a stretch of a recording.

    Attributes
    ----------
    time : ndarray, shape (K,)
        Seconds.
    before, after : dict of str to ndarray
        ``position``, ``torque``, ``velocity`` and ``acceleration``. Before filtering, the
        derivatives are those of the filtered position.
    """

    time: Array
    before: dict[str, Array]
    after: dict[str, Array]

    def __repr__(self) -> str:
        return f"Stages({', '.join(self.before)}: {len(self.time)} samples)"

    def plot(self, *, title: str | None = None, axes: Any = None) -> Any:
        """Show each signal before and after filtering, and what was taken away (extra ``plot``).

        Parameters
        ----------
        title : str, optional
            Heading of the figure.
        axes : array of matplotlib.axes.Axes, shape (4, 2), optional
            Where to draw; by default in a figure of its own.

        Returns
        -------
        ndarray of matplotlib.axes.Axes, shape (4, 2)
        """
        from sdpid.plots.reconstruction import plot_signals

        return plot_signals(
            self.time, self.before, self.after, units=_UNITS, title=title, axes=axes
        )


@dataclass(frozen=True, kw_only=True)
class Reason:
    """Why a rule gave a setting its value.

    Attributes
    ----------
    field : str
        Name of the setting.
    value : object
        What the rule chose.
    text : str
        Why.
    """

    field: str
    value: Any
    text: str

    def in_words(self, processing: Processing) -> str:
        """Return the reason in words, or that another value was given."""
        chosen, value = _shown(self.value), getattr(processing, self.field)
        if value == self.value:
            return f"{self.field} {chosen}: {self.text}"
        return f"{self.field} {_shown(value)}: as given, for {chosen} ({self.text})"


def _one_of(*allowed: Any) -> dict[str, Any]:
    """Return the metadata of a setting that is one of some values."""

    def check(name: str, value: Any) -> None:
        if value not in allowed:
            raise DataError(f"{name}: is {value!r}, expected one of {allowed}.")

    return {"check": check}


def _within(
    low: float, high: float, *, whole: bool = False, optional: bool = False
) -> dict[str, Any]:
    """Return the metadata of a setting that is a number in a range, with `optional` or None.

    Lower cut-offs and higher orders than anybody uses would overflow.
    """

    def check(name: str, value: Any) -> None:
        if value is None and optional:
            return
        sound = is_number(value) and low <= value <= high
        if not sound or (whole and value != int(value)):
            kind = "a whole number" if whole else "a number"
            # Python refuses to print an int of thousands of digits.
            huge = isinstance(value, int) and abs(value) > high
            shown = f"{float(value):.3g}" if huge else repr(value)
            raise DataError(f"{name}: is {shown}, expected {kind} from {low:g} to {high:g}.")

    return {"check": check}


@dataclass(frozen=True, kw_only=True, repr=False)
class Processing(Settings):
    """Settings of `process`: filter, derivatives, masks, covariance.

    Why each default is what it is: docs/guides/processing.md.

    Parameters
    ----------
    cutoff_hz : float
        Cut-off of one pass of the low-pass filter, in Hz: it loses 3 dB there.
    order : int
        Order of one pass; forward and backward passes double it.
    decimation : int or None
        One sample in `decimation` is kept. None keeps about ten per period of the cut-off
        frequency.
    filter_alike : bool
        True: position, velocity, acceleration and effort pass the same filter once, forward and
        backward, so that the equation of motion still holds between them. False: position and
        effort pass it once, velocity and acceleration twice, as in the paper [denso]_.
    reversal_speed, reversal_time : float, float or None
        A joint's rows within `reversal_time` (s) of a sample slower than `reversal_speed` (rad/s,
        or m/s), or of a change of sign, are masked: there the filter has smeared the Coulomb
        step. None masks nothing.
    kept_share : float
        A joint of which less than this share of the rows would stay is not masked.
    filter_friction : bool
        Whether friction columns pass the filter of the efforts. They are then evaluated at a
        velocity of four times the band. Else they are taken at the filtered velocity.
    covariance : {"period", "pooled", None}
        ``"period"``: Sigma_k, one a sample, from the spread of the periods. ``"pooled"``: its mean
        over the samples, (n, n), for few periods. None: no covariance. Records without periods
        have none either way.
    shrinkage : float
        s in [0, 1]: Sigma_k becomes (1 - s) Sigma_k + s mean_k Sigma_k. With P periods Sigma_k
        has a rank of at most P - 1; s = 0 refuses P <= n.
    derivative : {"central", "central4", "central6"}
        Central differences of order 2, 4 or 6. At low sample rates take a high order.
    velocity : {"differentiated", "measured"}
        Whether the velocity is the derivative of the position, or the recorded one, which passes
        the filter once. The acceleration is the derivative of that.
    trim_s : float, optional
        Time cut off at either end of a record without periods, s; by default five time constants
        of the filter's slowest mode. Records with periods lose nothing.
    timing : {"auto", "nominal", "resample"}
        What to do with time stamps that jitter; see
        `sdpid.experiment.recording.gaps.make_grid`.
    filter : {"butterworth", "finite"}
        Type of the low-pass filter. Recordings with a floating base need ``"finite"``, which sees
        order / (2 cutoff_hz) to either side and nothing beyond.
    base_motion : {"auto", "imu", "twist", "pose"}
        What accelerations of a floating base are from; ``"auto"`` takes the IMU, else what has
        the less noise of recorded velocities and pose.
    contact_force_std, contact_moment_std : float, optional
        Standard deviations of recorded contact forces, N, and moments, N·m, after the filter, bias
        included: of forces about 1 % of the robot's weight. By default forces of contacts are
        unknowns, which are eliminated, recorded or not; with the first they are measurements, and
        with the second moments are.
    contact_margin_s : float
        By how much flags of contacts may be late or early, s: a contact counts as closed within
        this time, and the filter's memory, of a closed one.
    impact_s : float, optional
        Samples whose filter sees this time around a landing are left out, unless less than
        `kept_share` would stay; None keeps all. `identify` chooses 0 where at most a tenth go.
    effort_delay_s, imu_delay_s, base_delay_s, contacts_delay_s : float
        By how much efforts, an IMU, pose and velocities of a base, and contacts were recorded later
        than the joints' positions, s; negative where they are early. They are taken on time.
        `identify` finds them in recordings with a base.
    reasons : tuple of Reason
        Why settings were chosen, where a rule chose them; samples carry them in their notes. They
        do not count when two settings are compared.

    Raises
    ------
    DataError
        When a value is out of its range.

    Examples
    --------
    >>> slower = sdpid.Processing(cutoff_hz=10.0, decimation=20, covariance="pooled")
    >>> sdpid.process(log, slower)
    Samples(500 samples, 6 joints, 2611 rows used, mean of 2 periods)
    >>> sdpid.Processing.paper().cutoff_hz
    10.0
    """

    cutoff_hz: float = field(default=15.0, metadata=_within(1e-4, 1e9))
    order: int = field(default=2, metadata=_within(1, 20, whole=True))
    decimation: int | None = field(default=10, metadata=_within(1, 1e9, whole=True, optional=True))
    filter_alike: bool = field(default=True, metadata=_one_of(True, False))
    reversal_speed: float = field(default=0.02, metadata=_within(0.0, 1e9))
    reversal_time: float | None = field(default=0.1, metadata=_within(0.0, 1e6, optional=True))
    kept_share: float = field(default=0.0, metadata=_within(0.0, 1.0))
    filter_friction: bool = field(default=True, metadata=_one_of(True, False))
    covariance: Literal["period", "pooled"] | None = field(
        default="period", metadata=_one_of("period", "pooled", None)
    )
    shrinkage: float = field(default=0.0, metadata=_within(0.0, 1.0))
    derivative: Derivative = field(default="central", metadata=_one_of(*get_args(Derivative)))
    velocity: Literal["differentiated", "measured"] = field(
        default="differentiated", metadata=_one_of("differentiated", "measured")
    )
    trim_s: float | None = field(default=None, metadata=_within(0.0, 1e9, optional=True))
    timing: Timing = field(default="auto", metadata=_one_of(*get_args(Timing)))
    filter: FilterType = field(default="butterworth", metadata=_one_of(*get_args(FilterType)))
    base_motion: BaseSource = field(default="auto", metadata=_one_of(*get_args(BaseSource)))
    contact_force_std: float | None = field(default=None, metadata=_within(0.0, 1e9, optional=True))
    contact_moment_std: float | None = field(
        default=None, metadata=_within(0.0, 1e9, optional=True)
    )
    contact_margin_s: float = field(default=0.0, metadata=_within(0.0, 1e6))
    impact_s: float | None = field(default=None, metadata=_within(0.0, 1e6, optional=True))
    effort_delay_s: float = field(default=0.0, metadata=_within(-1.0, 1.0))
    imu_delay_s: float = field(default=0.0, metadata=_within(-1.0, 1.0))
    base_delay_s: float = field(default=0.0, metadata=_within(-1.0, 1.0))
    contacts_delay_s: float = field(default=0.0, metadata=_within(-1.0, 1.0))
    reasons: tuple[Reason, ...] = field(default=(), compare=False, repr=False)

    def __post_init__(self) -> None:
        for each in fields(self):
            if (check := each.metadata.get("check")) is not None:
                check(each.name, getattr(self, each.name))

    @property
    def why(self) -> tuple[str, ...]:
        """Why settings were chosen, in words."""
        return tuple(reason.in_words(self) for reason in self.reasons)

    def low_pass(self, rate_hz: float) -> ZeroPhaseFilter:
        """Design the filter for a sample rate in Hz."""
        return low_pass(self.filter, self.cutoff_hz, self.order, rate_hz)

    def stencil(self) -> Weights:
        """Return how filtered signals are differentiated."""
        return stencil(self.derivative)

    def stages(self, log: Recording, joint: int = 0, *, window: tuple[float, float]) -> Stages:
        """Return one joint's signals before and after filtering, in a stretch of a recording.

        Parameters
        ----------
        log : Recording
            The recording.
        joint : int, optional
            Index of the joint, from 0.
        window : (float, float)
            From and to, in the recording's time (s).

        Returns
        -------
        Stages
            ``.time``, and signals by name in ``.before`` and ``.after``; ``.plot()`` draws them.

        Raises
        ------
        DataError
            When the window holds too few samples, or the joint does not exist.
        """
        if not 0 <= joint < log.n:
            raise DataError(
                f"joint {joint} does not exist; the recording has {log.n}, counted from 0."
            )
        smooth, difference = self.low_pass(1.0 / log.step), self.stencil()
        pad = 2 * smooth.reach + 2 * difference.margin
        first, last = map(int, np.searchsorted(log.time, window))
        start, stop = max(0, first - pad), min(log.n_samples, last + pad)
        if last - first < 2 or stop - start <= 2 * pad:
            raise DataError(
                f"window {window[0]:g} … {window[1]:g} s: {last - first} samples, too few to "
                f"filter; the recording runs from {log.time[0]:g} to {log.time[-1]:g} s."
            )
        tables = {"position": log.position, "torque": log.effort}
        raw = {name: np.asarray(table[start:stop, joint]) for name, table in tables.items()}
        once = {name: smooth.apply(signal) for name, signal in raw.items()}
        rates = {
            "velocity": difference.velocity(once["position"], log.step),
            "acceleration": difference.acceleration(once["position"], log.step),
        }
        passed = rates
        if not self.filter_alike:
            passed = {name: smooth.apply(rate) for name, rate in rates.items()}

        def shown(signals: dict[str, Array]) -> dict[str, Array]:
            # Derivatives lack the margin of their differences at either end.
            skipped = {name: (len(raw["position"]) - len(s)) // 2 for name, s in signals.items()}
            begin, end = first - start, last - start
            return {
                name: s[begin - skipped[name] : end - skipped[name]] for name, s in signals.items()
            }

        time = np.array(log.time[first:last])
        return Stages(time=time, before=shown(raw | rates), after=shown(once | passed))

    @staticmethod
    def paper() -> Processing:
        """Return section III-C of the paper to the letter, the periods' covariance included."""
        return Processing(
            cutoff_hz=10.0, order=1, filter_alike=False, reversal_time=None, filter_friction=False
        )


def _shown(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
