"""`Processing`: the settings of `process`, with their defaults and reasons."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from sdpid._common.tables import Settings
from sdpid.errors import DataError
from sdpid.experiment.processing.derivatives import (
    DERIVATIVES,
    Derivative,
    Spectral,
    Stencil,
    stencil,
)
from sdpid.experiment.processing.filters import FILTERS, FilterType, ZeroPhaseFilter, low_pass
from sdpid.experiment.processing.stages import Stages, filter_stages
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.recording.uniform_grid import Timing

# Smallest and largest value of each setting: lower cut-offs and higher orders than anybody uses
# would overflow.
_RANGES: dict[str, tuple[float, float]] = {
    "cutoff_hz": (1e-4, 1e9),
    "order": (1, 20),
    "decimation": (1, 1e9),
    "reversal_speed": (0.0, 1e9),
    "reversal_time": (0.0, 1e6),
    "kept_share": (0.0, 1.0),
    "shrinkage": (0.0, 1.0),
    "trim_s": (0.0, 1e9),
}
_OPTIONAL = ("decimation", "reversal_time", "trim_s")


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


@dataclass(frozen=True, kw_only=True, repr=False)
class Processing(Settings):
    """How `process` turns a recording into samples.

    Parameters
    ----------
    cutoff_hz : float
        Cut-off of one pass of the low-pass filter, in Hz: it loses 3 dB there.
    order : int
        Order of one pass; forward and backward passes double it. The paper's order 1 at 10 Hz
        attenuates motion of 1 Hz by 1 %, which the nonlinear equation of motion does not forgive;
        order 2 at 15 Hz attenuates it by 2e-5 and forgets a Coulomb step as fast.
    filter : {"butterworth", "bessel"}
        Type of the low-pass filter; see `sdpid.experiment.processing.filters.low_pass`.
    decimation : int or None
        One sample in `decimation` is kept. None keeps about ten per period of the cut-off
        frequency, which is the paper's choice (1 kHz, 10 Hz, a factor of 10).
    filter_alike : bool
        True: position, velocity, acceleration and torque all pass the same filter once, forward
        and backward, so that the equation of motion still holds between them to first order, and
        a Coulomb step is smeared no further than one pass smears it. False: as in the paper,
        where position and torque pass it once, velocity and acceleration twice.
    reversal_speed, reversal_time : float, float or None
        A joint's rows within `reversal_time` (s) of a sample slower than `reversal_speed` (rad/s,
        or m/s), or of a change of sign, are masked: there the filter has smeared the Coulomb
        step. None masks nothing.
    kept_share : float
        A joint of which less than this share of the rows would stay is not masked: a joint that
        hardly moves shows what it can.
    filter_friction : bool
        Whether friction columns pass the filter of the efforts: they are then evaluated at a
        velocity of four times the band. Else they are taken at the filtered velocity, although
        the filter smears the Coulomb step in the efforts.
    covariance : {"period", "pooled", None}
        ``"period"``: Sigma_k of the paper's (11), one a sample, from the spread of the periods.
        ``"pooled"``: its mean over the samples, (n, n), which also works with few periods. None:
        no covariance. Records without periods have none either way.
    shrinkage : float
        s in [0, 1]: Sigma_k becomes (1 - s) Sigma_k + s mean_k Sigma_k. With P periods Sigma_k
        has a rank of at most P - 1; s = 0 refuses P <= n. The target is the pooled covariance
        because it has full rank already for two periods, keeps the correlation of the joints,
        and is the exact answer when noise is stationary (s = 1).
    derivative : {"central", "central4", "central6", "savitzky_golay", "spectral"}
        Central differences of order 2, 4 or 6. Order 2 loses (w h)²/6 of a velocity at angular
        frequency w: nothing at 1 kHz, 12 % at 4 Hz sampled at 30 Hz, where order 6 loses 0.4 %.
        Savitzky-Golay: of polynomials of degree 4, over windows whose noise bandwidth is the
        cut-off; see `sdpid.experiment.processing.derivatives.stencil`. Spectral: of the Fourier
        series of the averaged period, without error; only for records with periods.
    velocity : {"differentiated", "measured"}
        Whether the velocity is the derivative of the position, or the recorded one, which passes
        the filter once. The acceleration is then the derivative of that.
    trim_s : float, optional
        Time cut off at either end of a record without periods. By default five time constants of
        the filter (that of its slowest mode), after which the guess made at the ends is forgotten
        to 2 % of the acceleration and 0.7 % of the torque on the outermost samples, and to a
        hundredth of that five time constants further in. Records with periods lose nothing.
    timing : {"auto", "nominal", "resample"}
        What to do with time stamps that jitter; see
        `sdpid.experiment.recording.uniform_grid.make_grid`.
    reasons : tuple of Reason
        Why settings were chosen, where a rule chose them; samples carry them in their notes. They
        are no settings themselves, and do not count when two are compared.

    Raises
    ------
    DataError
        When a value is out of its range.
    """

    cutoff_hz: float = 15.0
    order: int = 2
    decimation: int | None = 10
    filter_alike: bool = True
    reversal_speed: float = 0.02
    reversal_time: float | None = 0.1
    kept_share: float = 0.0
    filter_friction: bool = True
    covariance: Literal["period", "pooled"] | None = "period"
    shrinkage: float = 0.0
    derivative: Derivative = "central"
    velocity: Literal["differentiated", "measured"] = "differentiated"
    trim_s: float | None = None
    timing: Timing = "auto"
    filter: FilterType = "butterworth"
    reasons: tuple[Reason, ...] = field(default=(), compare=False, repr=False)

    def __post_init__(self) -> None:
        choices: dict[str, tuple[Any, ...]] = {
            "covariance": ("period", "pooled", None),
            "velocity": ("differentiated", "measured"),
            "timing": ("auto", "nominal", "resample"),
            "derivative": DERIVATIVES,
            "filter": FILTERS,
            "filter_friction": (True, False),
            "filter_alike": (True, False),
        }
        for name, allowed in choices.items():
            if getattr(self, name) not in allowed:
                raise DataError(f"{name}: is {getattr(self, name)!r}, expected one of {allowed}.")
        for name, (low, high) in _RANGES.items():
            value = getattr(self, name)
            if value is not None or name not in _OPTIONAL:
                _check_number(value, name, low, high, whole=name in ("order", "decimation"))

    def low_pass(self, rate_hz: float) -> ZeroPhaseFilter:
        """Design the filter for a sample rate in Hz."""
        return low_pass(self.filter, self.cutoff_hz, self.order, rate_hz)

    def stencil(self, rate_hz: float) -> Stencil:
        """Return how signals of a sample rate in Hz, once filtered, are differentiated."""
        if self.derivative == "spectral":
            return Spectral()
        return stencil(self.derivative, cutoff_over_rate=self.cutoff_hz / rate_hz)

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
        rate_hz = 1.0 / log.step
        # A stretch is no whole period.
        spectral = self.derivative == "spectral"
        return filter_stages(
            log,
            joint,
            window=window,
            low_pass=self.low_pass(rate_hz),
            difference=stencil("central6") if spectral else self.stencil(rate_hz),
            twice=not self.filter_alike,
        )

    @staticmethod
    def paper() -> Processing:
        """Return section III-C of the paper to the letter, the periods' covariance included."""
        return Processing(
            cutoff_hz=10.0,
            order=1,
            filter_alike=False,
            reversal_time=None,
            filter_friction=False,
        )


def _shown(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _check_number(value: Any, name: str, low: float, high: float, *, whole: bool) -> None:
    """Raise when a setting is no number, out of its range, or should be whole and is not."""
    sound = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    if not (sound and low <= value <= high and (not whole or value == int(value))):
        kind = "a whole number" if whole else "a number"
        # Python refuses to print an int of thousands of digits.
        shown = (
            f"{float(value):.3g}" if isinstance(value, int) and abs(value) > high else repr(value)
        )
        raise DataError(f"{name}: is {shown}, expected {kind} from {low:g} to {high:g}.")
